"""Fleets: the sessions of many devices, calibrated again by one method, with a row for each whatever becomes of it.

Sessions are folders of this machine or URLs that fsspec reads (s3://bucket/launch, sftp://host/launch); those are
copied to a temporary folder by the process that calibrates them. They come from a glob or from a manifest: a text file
with a folder or URL in each line, or a CSV file with a column `session`; relative ones start at the manifest's folder.
"""

from __future__ import annotations

import csv
import glob
import io
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import polars as pl

from tumble.brief import Brief
from tumble.campaigns.cluster import executor_for
from tumble.campaigns.engine import Job, Progress, Row, run
from tumble.documents import text_of_document
from tumble.errors import InputError, needs_extra
from tumble.files import FilePath
from tumble.recording.session_file import SESSION_FILE, read_session
from tumble.run.calibrate import Method, calibrate

MANIFESTS = (".txt", ".csv")
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
    """The column that tells a session from others."""
    return {COLUMN: session}


@dataclass(frozen=True, kw_only=True, slots=True)
class Tally:
    """How the sessions of a fleet ended: accepted; not accepted, and failed, each with why, by session."""

    accepted: int
    refused: Mapping[str, str]
    failed: Mapping[str, str]


def tally(rows: Path) -> Tally:
    """The tally of a fleet's rows (the path of `engine.run`)."""
    frame = pl.read_parquet(rows, columns=[COLUMN, "accepted", "reasons", "error"])
    refused = frame.filter(pl.col("accepted").not_())
    failed = frame.filter(pl.col("error").is_not_null())
    return Tally(
        accepted=int(frame["accepted"].sum()),
        refused={session: "; ".join(reasons) for session, reasons in refused.select(COLUMN, "reasons").iter_rows()},
        failed=dict(failed.select(COLUMN, "error").iter_rows()),
    )


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class FleetResult(Brief):
    """The rows of a fleet, a Parquet file, its sessions, and how they ended."""

    rows: Path
    sessions: tuple[str, ...]
    tally: Tally


def fleet(
    sessions: FilePath,
    out: FilePath,
    *,
    method: Method = "joint",
    serial: bool = False,
    cluster: str | None = None,
    workers: int | None = None,
    progress: Progress = lambda _done, _all: None,
) -> FleetResult:
    """Calibrate all sessions that a glob matches or a manifest lists, with a row for each, into a folder; what is there
    already is not computed again. A session that cannot be calibrated does not stop the others: its row says why.

    >>> import tumble
    >>> request = tumble.Setup.of(grade="mems", positions=12)
    >>> for seed in (1, 2):
    ...     _ = tumble.simulate_session(f"sessions/{seed}", request, seed=seed)
    >>> tumble.fleet("sessions/*", "results", serial=True).tally.accepted
    2
    """
    found = sessions_of(str(sessions))
    with executor_for(serial=serial, cluster=cluster, workers=workers) as executor:
        rows = run(job_of(found, method), Path(out), executor=executor, progress=progress)
    return FleetResult(rows=rows, sessions=tuple(found), tally=tally(rows))


# Which sessions


def sessions_of(pattern: str) -> list[str]:
    """The sessions that a manifest (.txt, .csv) lists, or the folders that hold a session.toml among those that a glob
    matches, sorted. Raises InputError if there are none."""
    listed = pattern.lower().endswith(MANIFESTS)
    found = _listed(pattern) if listed else _matching(pattern)
    if not found:
        what = "a session in each line" if listed else "a glob that matches folders with a session.toml"
        raise InputError(f"{pattern}: expected {what}, found none")
    twice = next((s for s in found if found.count(s) > 1), None) if len(set(found)) < len(found) else None
    if twice is not None:
        raise InputError(f"{pattern}: expected every session once, found {twice} twice")
    return found


def _listed(manifest: str) -> list[str]:
    """What the lines of a manifest name, or the column of its table."""
    if _is_url(manifest):
        system, path = _file_system(manifest)
        try:
            text = str(system.cat_file(path).decode("utf-8-sig"))
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{manifest}: cannot be read: {error}") from None
    else:
        text = text_of_document(Path(manifest))
    lines = [line for line in text.splitlines() if not line.lstrip().startswith("#")]
    if manifest.lower().endswith(".csv"):
        table = csv.DictReader(io.StringIO(text))
        try:
            if COLUMN not in (table.fieldnames or ()):
                raise InputError(f"{manifest}: expected a column {COLUMN!r}, found {', '.join(table.fieldnames or ())}")
            lines = [row[COLUMN] or "" for row in table]
        except csv.Error as error:
            said = f"{manifest}: expected rows of a CSV table, found in row {table.line_num}: {error}"
            raise InputError(said) from None
    return [_from(manifest, line.strip()) for line in lines if line.strip()]


def _from(manifest: str, session: str) -> str:
    """A session of a manifest; a relative one starts at the manifest's folder. A manifest at a URL lists what is at its
    own place alone: it does not make this machine open its own files, or those of its network."""
    if _is_url(session):
        if _is_url(manifest) and _place(session) != _place(manifest):
            raise InputError(
                f"{manifest}: expected sessions at {'://'.join(_place(manifest))}, where the manifest is, found "
                f"{session}; copy the manifest to this machine if it is meant"
            )
        return session
    if _is_url(manifest):
        return f"{manifest.rpartition('/')[0]}/{session}"
    return str(Path(manifest).absolute().parent / session)


def _place(url: str) -> tuple[str, str]:
    """Protocol and host, or bucket, of a URL."""
    kind, _, rest = url.partition("://")
    return kind.lower(), rest.partition("/")[0].lower()


def _matching(pattern: str) -> list[str]:
    """Folders with a session.toml that a glob matches, themselves or through the file."""
    if not _is_url(pattern):
        found = {Path(match) for match in glob.glob(pattern, recursive=True)}  # noqa: PTH207 — absolute ones too
        folders = {p.parent if p.name == SESSION_FILE else p for p in found}
        held = (p for p in folders if p / SESSION_FILE in found or (p / SESSION_FILE).is_file())
        return sorted(str(folder.absolute()) for folder in held)
    system, path = _file_system(pattern)
    matches = [str(match).removesuffix(f"/{SESSION_FILE}") for match in system.glob(path)]
    return sorted({system.unstrip_protocol(m) for m in matches if system.isfile(f"{m}/{SESSION_FILE}")})


def _is_url(name: str) -> bool:
    return "://" in name


def _file_system(url: str) -> tuple[Any, str]:
    """The file system of a URL, and the path in it."""
    with needs_extra("a session at a URL", "cluster", "fsspec"):
        from fsspec.core import url_to_fs
    try:
        system, path = url_to_fs(url)
    except (ImportError, ValueError) as error:
        raise InputError(f"{url}: expected a URL that fsspec can read, found: {error}") from error
    return system, str(path)


# One session


def calibrated(method: Method, _number: int, session: str) -> list[Row]:
    """The row of a session."""
    with _at_hand(session) as folder:
        try:
            calibration = calibrate(read_session(folder), method=method)
        except InputError as error:
            return [{"error": str(error).replace(str(folder), session)}]
    parameters, covariance, outcome = calibration.parameters, calibration.covariance, calibration.outcome
    row = {name: getattr(calibration, name) for name in ("serial", "model", "method")}
    row |= {"accepted": outcome.accepted, "reasons": list(outcome.reasons), "unobservable": list(outcome.unobservable)}
    row |= {"parameter": [p.name for p in parameters]}
    row |= {name: [getattr(p, name) for p in parameters] for name in ("value", "u", "unit")}
    row["covariance"] = None if covariance is None else covariance.ravel().tolist()
    return [row | {"rests": len(calibration.evidence.rests), "log_sha256": calibration.provenance.log_sha256}]


@contextmanager
def _at_hand(session: str) -> Iterator[Path]:
    """The folder of a session, copied to this machine if it is at a URL."""
    if not _is_url(session):
        yield Path(session)
        return
    system, path = _file_system(session)
    with tempfile.TemporaryDirectory(prefix="tumble-") as temporary:
        folder = Path(temporary) / "session"
        try:
            system.get(f"{path.rstrip('/')}/", f"{folder}/", recursive=True)
        except OSError as error:
            raise InputError(f"{session}: expected a session folder, found: {error.strerror or error}") from error
        yield folder
