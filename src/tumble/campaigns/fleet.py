"""Fleets: the sessions of many devices, calibrated again by one method, with a row for each whatever becomes of it.

Sessions are folders that every process can open. They come from a glob or from a manifest, a text file with a folder in
each line; relative ones start at the manifest's folder.
"""

from __future__ import annotations

import glob
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Unpack

import polars as pl

from tumble.arguments import checked
from tumble.brief import Brief
from tumble.campaigns.cluster import Place, executor_for
from tumble.campaigns.engine import Job, Progress, Row, run
from tumble.documents import text_of_document
from tumble.errors import InputError
from tumble.files import FilePath
from tumble.recording.session_file import SESSION_FILE, read_session
from tumble.run.calibrate import Method, calibrate

COLUMN = "session"
SCHEMA = {
    COLUMN: pl.String,
    "serial": pl.String,
    "model": pl.String,
    "method": pl.String,
    "accepted": pl.Boolean,
    "reasons": pl.List(pl.String),
    "unobservable": pl.List(pl.String),
    "parameter": pl.List(pl.String),
    "value": pl.List(pl.Float64),
    "u": pl.List(pl.Float64),
    "unit": pl.List(pl.String),
    "covariance": pl.List(pl.Float64),
    "rests": pl.Int64,
    "log_sha256": pl.String,
}
"""Columns of the rows. `parameter`, `value`, `u` and `unit` are lists in one order, SI; `covariance` is the matrix in
that order, row after row."""


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class FleetResult(Brief):
    """The rows of a fleet, a Parquet file, its sessions, and of them how many were accepted and which were not, or
    failed, each with the reason."""

    rows: Path
    sessions: tuple[str, ...]
    accepted: int
    not_accepted: Mapping[str, str]
    failed: Mapping[str, str]


@checked
def fleet(
    sessions: FilePath,
    out: FilePath,
    *,
    method: Method = "joint",
    progress: Progress = lambda _done, _all: None,
    **place: Unpack[Place],
) -> FleetResult:
    """Calibrate many sessions, with a row for each. One that cannot be calibrated does not stop the others.

    Parameters
    ----------
    sessions
        Glob of session folders, or a manifest (.txt) with a folder in each line.
    out
        Folder of the results; what it has already is not computed again.
    method
        See `calibrate`.
    progress
        Function that is called with the number of tasks done and of all.
    **place
        Where to compute, see `tumble.types.Place`.

    Returns
    -------
    FleetResult
        How many sessions were accepted, and why the others were not.

    Raises
    ------
    InputError
        Without sessions, for one that is listed twice, and for a folder of something else.

    Examples
    --------
    >>> import tumble
    >>> request = tumble.Setup.of(grade="mems", positions=12)
    >>> for seed in (1, 2):
    ...     _ = tumble.simulate_session(f"sessions/{seed}", request, seed=seed)
    >>> tumble.fleet("sessions/*", "results", serial=True).accepted
    2
    """
    folders = sessions_of(str(sessions))
    with executor_for(**place) as executor:
        rows = run(job_of(folders, method), Path(out), executor=executor, progress=progress)
    return result_of(rows)


def sessions_of(pattern: str) -> list[str]:
    """The sessions that a manifest (.txt) lists, or the folders with a session.toml that a glob matches, sorted.

    Raises InputError if there are none, or one is there twice."""
    if pattern.lower().endswith(".txt"):
        manifest = Path(pattern)
        lines = (line.strip() for line in text_of_document(manifest).splitlines())
        sessions = [str(manifest.absolute().parent / line) for line in lines if line and not line.startswith("#")]
        expected = "a session in each line"
    else:
        matches = {Path(match) for match in glob.glob(pattern, recursive=True)}  # noqa: PTH207 — absolute ones too
        folders = {path.parent if path.name == SESSION_FILE else path for path in matches}
        sessions = sorted(str(folder.absolute()) for folder in folders if (folder / SESSION_FILE).is_file())
        expected = "a glob that matches folders with a session.toml"
    if not sessions:
        raise InputError(f"{pattern}: expected {expected}, found none")
    if len(set(sessions)) < len(sessions):
        twice = next(session for session in sessions if sessions.count(session) > 1)
        raise InputError(f"{pattern}: expected every session once, found {twice} twice")
    return sessions


def job_of(sessions: Sequence[str], method: Method) -> Job:
    """The sessions to be calibrated, a row each: see `SCHEMA`."""
    return Job(
        definition={"fleet": {"method": method}, "sessions": list(sessions)},
        items=list(sessions),
        task=partial(calibrated, method),
        label=label,
        schema=SCHEMA,
    )


def label(session: str) -> Row:
    """The column that identifies a session."""
    return {COLUMN: session}


def calibrated(method: Method, _number: int, session: str) -> list[Row]:
    """The row of a session."""
    try:
        calibration = calibrate(read_session(Path(session)), method=method)
    except InputError as error:
        return [{"error": str(error)}]
    parameters, covariance, outcome = calibration.parameters, calibration.covariance, calibration.outcome
    row = {name: getattr(calibration, name) for name in ("serial", "model", "method")}
    row |= {"accepted": outcome.accepted, "reasons": list(outcome.reasons), "unobservable": list(outcome.unobservable)}
    row |= {"parameter": [p.name for p in parameters]}
    row |= {name: [getattr(p, name) for p in parameters] for name in ("value", "u", "unit")}
    row["covariance"] = None if covariance is None else covariance.ravel().tolist()
    return [row | {"rests": len(calibration.evidence.rests), "log_sha256": calibration.provenance.log_sha256}]


def result_of(rows: Path) -> FleetResult:
    """How the sessions of a fleet ended, from its rows (the path that `engine.run` returns)."""
    frame = pl.read_parquet(rows, columns=[COLUMN, "accepted", "reasons", "error"])
    refused = frame.filter(pl.col("accepted").not_()).select(COLUMN, "reasons")
    return FleetResult(
        rows=rows,
        sessions=tuple(frame[COLUMN]),
        accepted=int(frame["accepted"].sum()),
        not_accepted={session: "; ".join(reasons) for session, reasons in refused.iter_rows()},
        failed=dict(frame.filter(pl.col("error").is_not_null()).select(COLUMN, "error").iter_rows()),
    )
