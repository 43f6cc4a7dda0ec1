"""Noise of the sensors from samples at rest: the longest rest of a session, or a whole log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from tumble.arguments import checked
from tumble.brief import Brief
from tumble.errors import InputError, SessionError
from tumble.files import FilePath
from tumble.recording.log import Chunk, Log, open_log
from tumble.recording.session import Session
from tumble.recording.session_file import SESSION_FILE, session_from, session_of, session_of_gyros
from tumble.reduction.noise.allan_deviation import allan_deviation, pooled
from tumble.reduction.noise.wavelet_moments import Panel, identify
from tumble.run.observed import Progress, inspect_session
from tumble.units import DEGREE, G_STANDARD, Array

_MARGIN = 1e-9  # s, of the ends of a rest
PARTS = 100  # parts of a record whose verticals are compared
LARGEST_TILT = 10.0 * DEGREE  # rad, between the verticals of a record at rest


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class QuietRecord:
    """Samples at rest, SI: accelerometers (m, n), gyros (m, n) or (m, 0), sample `rate`, Hz, and `source` in words."""

    session: Session
    accel: Array
    gyro: Array
    rate: float
    source: str


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class RecordedNoise(Brief):
    """Allan deviations and noise coefficients of accelerometers and gyros.

    `rate` is the sample rate, Hz, `source` the origin of the samples in words, and `doubt` an uncertainty about the
    log."""

    json_fields: ClassVar = ("source", "rate", "panels", "doubt")

    panels: tuple[Panel, ...]
    rate: float
    source: str
    doubt: str = ""


@checked
def noise_of(*recordings: Session | FilePath, layout: Mapping[str, Any] | None = None) -> RecordedNoise:
    """Allan deviation and noise coefficients of every sensor at rest.

    Parameters
    ----------
    *recordings
        Sessions, or the paths of their folders, whose longest rests are used; or, with `layout`, logs of a device at
        rest. Several recordings of one device are evaluated together.
    layout
        Table [log] of session.toml, less the file.

    Raises
    ------
    InputError
        If nothing rests, a recording cannot be read, or several have different sensors.

    Examples
    --------
    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=4), seed=3)
    >>> found = tumble.noise_of(folder)
    >>> found.source, [panel.title for panel in found.panels]
    ('the longest rest, 0.0–39.0 s', ['accelerometers', 'gyros'])
    """
    records = []
    for recording in recordings:
        if isinstance(recording, Session) or is_session(Path(recording)):
            records.append(longest_rest(session_from(recording)))
        elif layout is not None:
            records.append(whole_log(Path(recording), layout))
        else:
            without = "expected a session, or `layout`, the table [log], with a log; found neither"
            raise InputError(f"{recording}: {without}")
    if not records:
        raise InputError("noise: expected a recording, found none")
    several = f"{len(records)} records: " if len(records) > 1 else ""
    doubts = dict.fromkeys([*records[0].session.log.doubts, *map(_turned, records)])
    return RecordedNoise(
        panels=noise_panels(records),
        rate=records[0].rate,
        source=several + "; ".join(record.source for record in records),
        doubt="; ".join(filter(None, doubts)),
    )


def _turned(record: QuietRecord) -> str:
    """Return a sentence if the device was turned during a record; empty if it lay still."""
    if record.accel.shape[1] != 3:
        return ""
    means = np.array([part.mean(axis=0) for part in np.array_split(record.accel, min(PARTS, len(record.accel)))])
    lengths = np.linalg.norm(means, axis=1)
    if not lengths.min() > 0.5 * G_STANDARD:
        return ""
    angle = float(np.arccos(np.clip((means @ means[0] / (lengths * lengths[0])).min(), -1.0, 1.0)))
    if angle < LARGEST_TILT:
        return ""
    return (
        f"the device was turned by up to {angle / DEGREE:.0f}° in {record.source}: these numbers are not its noise; "
        "give a log at rest, or the folder of its session (tumble calibrate, tumble new), of which the longest rest is "
        "taken"
    )


def noise_panels(records: Sequence[QuietRecord]) -> tuple[Panel, ...]:
    """Return Allan deviation and noise coefficients of accelerometers and gyros from all records together."""
    panels, log = [], records[0].session.log
    for title, unit, kind, channels in (
        ("accelerometers", "m/s^2", "accel", log.accel),
        ("gyros", "rad/s", "gyro", log.gyro),
    ):
        if channels is not None and getattr(records[0], kind).size:
            deviation = pooled([allan_deviation(getattr(record, kind), record.rate) for record in records])
            noise, columns = identify(deviation), channels.columns
            panels.append(Panel(title=title, unit=unit, channels=columns, deviation=deviation, parameters=noise))
    return tuple(panels)


def is_session(path: Path) -> bool:
    """Return True for the path of a session, False for that of a log."""
    if not path.exists():
        raise InputError(f"{path}: expected a session folder or a log, found no such file")
    return (path / SESSION_FILE).exists() or path.suffix == ".toml"


def longest_rest(session: Session, *, progress: Progress = Log.chunks) -> QuietRecord:
    """Return the longest rest of a session. Raises InputError if nothing rests."""
    observed = inspect_session(session, progress=progress)
    if not observed.segmentation.rests:
        raise InputError(f"{session.name}: expected a rest to take the noise from, found none; see `tumble inspect`")
    rest = max(observed.segmentation.rests, key=lambda rest: rest.stop - rest.start)
    ends = np.array([rest.start, rest.stop]) + _MARGIN
    chunks = (chunk for chunk in open_log(session).chunks() if chunk.file == rest.file)
    at_rest = [chunk.part(slice(*np.searchsorted(chunk.time, ends, side="right"))) for chunk in chunks]
    return _record(session, at_rest, observed.rate, f"the longest rest, {rest.start:z.1f}–{rest.stop:z.1f} s")


def whole_log(file: Path, layout: Mapping[str, Any]) -> QuietRecord:
    """Return all samples of a log file at rest; `layout` is the table [log] of session.toml without the file.

    The accelerometers may be missing. Raises InputError if the log does not fit the layout."""
    described = {"format": 1, "device": {"serial": file.name}, "log": {"file": str(file.resolve()), **layout}}
    gyros_alone = "accel" not in layout and "gyro" in layout
    try:
        session = session_of_gyros(described) if gyros_alone else session_of(described)
    except SessionError as error:
        raise InputError(f"{file}: {str(error).split(': ', 1)[1]}; describe the log with the options") from None
    log = open_log(session)
    record = _record(session, list(log.chunks()), log.rate, f"all of {file.name}")
    if not gyros_alone:
        return record
    of_gyros = replace(session, log=replace(session.log, gyro=session.log.accel))
    return replace(record, session=of_gyros, accel=record.gyro, gyro=record.accel)


def _record(session: Session, chunks: Sequence[Chunk], rate: float, source: str) -> QuietRecord:
    accel = np.concatenate([each.accel for each in chunks])
    gyro = np.concatenate([np.empty((len(each.accel), 0)) if each.gyro is None else each.gyro for each in chunks])
    return QuietRecord(session=session, accel=accel, gyro=gyro, rate=rate, source=source)
