"""The samples of a live source, for a watch: rows in the order of their times, SI, without a file on disk.

Without a session that says otherwise, a source sends t, ax, ay, az, gx, gy, gz, in s, m/s² and rad/s, and where its
first line names such a column a temperature, °C.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing, suppress
from itertools import chain, pairwise
from pathlib import Path

import numpy as np

from tumble.errors import InputError
from tumble.recording.live.lines import Lines
from tumble.recording.live.samples import SI_LOG, StreamedSamples
from tumble.recording.live.sources import Ended, LineSource, source_of
from tumble.recording.log import Chunk, open_log
from tumble.recording.session import Session
from tumble.recording.session_file import read_session, session_of
from tumble.result.calibration import Calibration
from tumble.units import DEGREE
from tumble.use.corrector import LATEST
from tumble.use.watch import Watch

READ_SECONDS = 0.2
ROWS = 8192
TEMPERATURE = "temperature"


class LiveSamples:
    """The samples of a source: `session` says its columns, sensors and site, or None, of a source in SI that is of a
    calibrated device, at the calibration's site."""

    def __init__(self, source: LineSource, calibration: Calibration, session: Session | None = None) -> None:
        self.source, self._before = source, b""
        if session is None:
            with suppress(Ended):
                while b"\n" not in self._before:
                    self._before += source.read(READ_SECONDS)
            session = _in_si(self._before.partition(b"\n")[0], source.name, calibration)
        self.session, spec = session, session.log
        self._lines = Lines(columns=spec.columns, clock=spec.time, refuse=lambda _: None)
        self._streamed = StreamedSamples(spec)

    @property
    def interval(self) -> float | None:
        """s from sample to sample, None while too few have come."""
        return self._streamed.interval

    def chunks(self) -> Iterator[Chunk]:
        """What comes, until the source ends; a clock that goes back begins another file."""
        spec, file, last, ended = self.session.log, 0, -np.inf, False
        with closing(self.source):
            while not ended:
                try:
                    data, self._before = self._before or self.source.read(READ_SECONDS), b""
                except Ended:
                    data, ended = b"\n", True
                rows = self._lines.numbers(self._lines.cut(data))
                back = np.zeros(0, dtype=int)
                if spec.time is not None and len(rows):
                    time = rows[:, 0] * spec.time_factor
                    back = np.flatnonzero(np.diff(time, prepend=last) < -LATEST)
                    last = float(time[-1])
                for begin, end in pairwise([0, *back.tolist(), len(rows)]):
                    if begin in back:
                        file += 1
                        self._streamed = StreamedSamples(spec, interval=self._streamed.interval, file=file)
                    chunk = self._streamed.feed(rows[begin:end]) if end > begin else None
                    if chunk is not None:
                        yield chunk


def _in_si(first: bytes, name: str, calibration: Calibration) -> Session:
    """The session of a source in SI, by its first line."""
    site = calibration.site
    if site is None:
        raise InputError(
            f"{name}: expected a calibration with its site, found none; name a session with --session, which has the "
            "latitude and the columns"
        )
    log = {key: value for key, value in SI_LOG.items() if key != "file"}
    columns = [log["time"], *log["accel"]["columns"]]
    if calibration.gyro is None:
        del log["gyro"]
    else:
        columns += log["gyro"]["columns"]
    if TEMPERATURE in [column.strip() for column in first.decode("utf-8", errors="replace").split(",")]:
        log[TEMPERATURE] = {"columns": [TEMPERATURE], "unit": "degC"}
        columns.append(TEMPERATURE)
    at = {"height_m": site.height, "gravity": site.gravity, "gravity_u": site.gravity_u}
    if site.latitude is not None:
        at["latitude_deg"] = site.latitude / DEGREE
    described = {"format": 1, "device": {"serial": calibration.serial}, "site": at, "log": log}
    return session_of(described, {column: np.zeros(1) for column in columns})


def opened(source: str, calibration: Calibration, session: Session | None) -> tuple[Watch, Iterator[Chunk]]:
    """The watch of a calibration by a recorded session, the path of its folder, or by a live source, and the samples
    that it is to be fed. Waits for the first of these. Raises InputError."""
    if Path(source).exists():
        log = open_log(read_session(source))
        return Watch(calibration, log.session, sample_rate=log.rate), log.chunks(rows=ROWS)
    samples = LiveSamples(source_of(source), calibration, session)
    chunks = samples.chunks()
    first = next(chunks, None)
    if first is None or samples.interval is None:
        raise InputError(f"{source}: expected rows of numbers, found fewer than tell the interval of samples")
    return Watch(calibration, samples.session, sample_rate=1.0 / samples.interval), chain([first], chunks)
