"""Fleets: recalibration of many recorded sessions by one method, with a row for each.

Sessions are folders that every process can open, given by a glob.
"""

from __future__ import annotations

import glob
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Unpack

import polars as pl

from tumble.arguments import checked
from tumble.brief import Brief
from tumble.campaigns.cluster import Place, executor_for
from tumble.campaigns.engine import Job, Progress, Row, run
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
that order, row by row."""


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class FleetResult(Brief):
    """Result of a fleet: its Parquet file, its sessions, the number of accepted ones, and why others were not
    accepted."""

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
    """Calibrate many sessions, with a row for each. A session that cannot be calibrated does not stop the others.

    Parameters
    ----------
    sessions
        Glob of session folders.
    out
        Folder of the results; finished sessions are not computed again.
    method
        See `calibrate`.
    progress
        Function of the number of finished tasks and the number of all tasks.
    **place
        Where to compute, see `tumble.types.Place`.

    Returns
    -------
    FleetResult
        The number of accepted sessions, and why the others were not accepted.

    Raises
    ------
    InputError
        Without sessions, and if the folder has other content.

    Examples
    --------
    >>> import tumble
    >>> request = tumble.Setup.of(grade="mems", positions=12)
    >>> for seed in (1, 2):
    ...     _ = tumble.simulate_session(f"sessions/{seed}", request, seed=seed)
    >>> tumble.fleet("sessions/*", "results", serial=True).accepted
    2
    """
    folders = find_sessions(str(sessions))
    job = Job(
        definition={"fleet": {"method": method}, "sessions": folders},
        items=[{COLUMN: folder} for folder in folders],
        task=partial(calibrate_row, method),
        schema=SCHEMA,
    )
    with executor_for(**place) as executor:
        rows = run(job, Path(out), executor=executor, progress=progress)
    frame = pl.read_parquet(rows, columns=[COLUMN, "accepted", "reasons", "error"])
    refused = frame.filter(pl.col("accepted").not_()).select(COLUMN, "reasons")
    return FleetResult(
        rows=rows,
        sessions=tuple(frame[COLUMN]),
        accepted=int(frame["accepted"].sum()),
        not_accepted={session: "; ".join(reasons) for session, reasons in refused.iter_rows()},
        failed=dict(frame.filter(pl.col("error").is_not_null()).select(COLUMN, "error").iter_rows()),
    )


def find_sessions(pattern: str) -> list[str]:
    """Return the session folders that a glob matches, sorted. Raises InputError if there is none."""
    matches = {Path(match) for match in glob.glob(pattern, recursive=True)}  # noqa: PTH207 — absolute ones too
    folders = {path.parent if path.name == SESSION_FILE else path for path in matches}
    sessions = sorted(str(folder.absolute()) for folder in folders if (folder / SESSION_FILE).is_file())
    if not sessions:
        raise InputError(f"{pattern}: expected a glob that matches folders with a session.toml, found none")
    return sessions


def calibrate_row(method: Method, _number: int, item: Row) -> list[Row]:
    """Calibrate a session and return its row."""
    try:
        calibration = calibrate(read_session(Path(item[COLUMN])), method=method)
    except InputError as error:
        return [{"error": str(error)}]
    parameters, covariance, outcome = calibration.parameters, calibration.covariance, calibration.outcome
    row = {name: getattr(calibration, name) for name in ("serial", "model", "method")}
    row |= {"accepted": outcome.accepted, "reasons": list(outcome.reasons), "unobservable": list(outcome.unobservable)}
    row |= {"parameter": [p.name for p in parameters]}
    row |= {name: [getattr(p, name) for p in parameters] for name in ("value", "u", "unit")}
    row["covariance"] = None if covariance is None else covariance.ravel().tolist()
    return [row | {"rests": len(calibration.evidence.rests), "log_sha256": calibration.provenance.log_sha256}]
