"""The samples of a recording at rest, for the Allan deviation: the longest rest of a session, or all of a log."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tumble.errors import InputError, SessionError
from tumble.recording.log import Chunk, open_log
from tumble.recording.session import Session, read_session, write_session
from tumble.reduction.allan_deviation import Panel, allan_deviation, identify
from tumble.reduction.blocks import reduce_log
from tumble.reduction.segmentation import RestSpan, find_rests
from tumble.units import Array


@dataclass(frozen=True, kw_only=True, slots=True)
class QuietRecord:
    """Samples at rest, SI: accelerometers (m, n), gyros (m, n) or (m, 0), `rate` in Hz, where they are from in words,
    and the columns they came from."""

    accel: Array
    gyro: Array
    rate: float
    source: str
    accel_columns: tuple[str, ...]
    gyro_columns: tuple[str, ...]


def longest_rest(session: Session) -> QuietRecord:
    """The longest rest of a session. Raises InputError where nothing rests."""
    log = open_log(session)
    reduction = reduce_log(log, session.accel_block, session.gyro_block)
    rests = find_rests(reduction, session.accel_block, session.gyro_block).rests
    if not rests:
        raise InputError(f"{session.folder}: expected a rest to take the noise from, found none; see `tumble inspect`")
    longest = max(rests, key=lambda rest: rest.stop - rest.start)
    return _record(session, longest, f"the longest rest, {longest.start:z.1f}–{longest.stop:z.1f} s")


def whole_log(file: Path, layout: Mapping[str, Any]) -> QuietRecord:
    """All of a log file at rest, with `layout` as the table [log] of session.toml has it, less the file. Raises
    InputError like a session would."""
    with tempfile.TemporaryDirectory() as folder:
        described = {"format": 1, "device": {"serial": file.name}, "log": {"file": str(file.resolve()), **layout}}
        try:
            write_session(Path(folder), described)
            session = read_session(Path(folder))
        except SessionError as error:
            raise InputError(f"{file}: {str(error).split(': ', 1)[1]}; describe the log with the options") from None
        return _record(session, None, f"all of {file.name}")


def _record(session: Session, span: RestSpan | None, source: str) -> QuietRecord:
    """The samples of a stretch, or of the first file."""
    log = open_log(session)
    chunks: list[Chunk] = []
    for chunk in log.chunks():
        if span is None or (chunk.file == span.file and chunk.time[-1] > span.start):
            chunks.append(chunk)
        if span is not None and (chunk.file, chunk.time[-1]) >= (span.file, span.stop):
            break
    time = np.concatenate([c.time for c in chunks])
    inside = slice(None) if span is None else (time > span.start + 1e-9) & (time <= span.stop + 1e-9)
    gyros = [c.gyro if c.gyro is not None else np.empty((len(c.time), 0)) for c in chunks]
    return QuietRecord(
        accel=np.concatenate([c.accel for c in chunks])[inside],
        gyro=np.concatenate(gyros)[inside],
        rate=log.rate,
        source=source,
        accel_columns=session.log.accel.columns,
        gyro_columns=session.log.gyro.columns if session.log.gyro else (),
    )


def noise_panels(record: QuietRecord) -> tuple[Panel, ...]:
    """Allan deviation and noise coefficients of the accelerometers and of the gyros."""
    kinds = (
        ("accelerometers", "m/s^2", record.accel_columns, record.accel),
        ("gyros", "rad/s", record.gyro_columns, record.gyro),
    )
    panels = []
    for title, unit, columns, samples in kinds:
        if samples.shape[1]:
            deviation = allan_deviation(samples, record.rate)
            parameters = identify(deviation)
            panels.append(
                Panel(title=title, unit=unit, channels=columns, deviation=deviation, parameters=tuple(parameters))
            )
    return tuple(panels)
