"""The samples of a live source, for a watch: rows in the order of their times, SI, without a file on disk.

Without a session that says otherwise, a source sends t, ax, ay, az, gx, gy, gz, in s, m/s² and rad/s, and where its
first line names such a column a temperature, °C.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from itertools import chain, pairwise
from pathlib import Path

import numpy as np

from tumble.bench.follow.samples import Clock
from tumble.bench.record.lines import Lines
from tumble.bench.record.sources import Ended, LineSource, source_of
from tumble.bench.session_folder import in_si
from tumble.errors import InputError
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
    calibrated device, at the calibration's site. `refused` counts lines that were no rows."""

    def __init__(self, source: LineSource, calibration: Calibration, session: Session | None = None) -> None:
        self.source, self.refused = source, 0
        self._before = b""
        self.session = session if session is not None else self._in_si(calibration)
        self._spec = self.session.log
        self._lines = Lines(columns=self._spec.columns, clock=self._spec.time, refuse=self._refuse)
        self._clock = Clock(spec=self._spec)
        self._file = 0
        self._last = -np.inf

    def _refuse(self, _: bytes) -> None:
        self.refused += 1

    def _in_si(self, calibration: Calibration) -> Session:
        """The session of a source in SI, by its first line."""
        ended = False
        while b"\n" not in self._before and not ended:
            try:
                self._before += self.source.read(READ_SECONDS)
            except Ended:
                ended = True
        site = calibration.site
        if site is None:
            raise InputError(
                f"{self.source.name}: expected a calibration with its site, found none; name a session with "
                "--session, which has the latitude and the columns"
            )
        log = {key: value for key, value in in_si().items() if key != "file"}
        first = self._before.partition(b"\n")[0].decode("utf-8", errors="replace")
        if TEMPERATURE in [name.strip() for name in first.split(",")]:
            log[TEMPERATURE] = {"columns": [TEMPERATURE], "unit": "degC"}
        if calibration.gyro is None:
            del log["gyro"]
        at = {"height_m": site.height, "gravity": site.gravity, "gravity_u": site.gravity_u}
        if site.latitude is not None:
            at["latitude_deg"] = site.latitude / DEGREE
        columns = [log["time"], *log["accel"]["columns"], *log.get("gyro", {}).get("columns", [])]
        columns += log.get(TEMPERATURE, {}).get("columns", [])
        described = {"format": 1, "device": {"serial": calibration.serial}, "site": at, "log": log}
        return session_of(described, {name: np.zeros(1) for name in columns})

    @property
    def interval(self) -> float | None:
        """s from sample to sample, None while too few have come."""
        return self._clock.interval

    def chunks(self) -> Iterator[Chunk]:
        """What comes, until the source ends; a clock that goes back begins another file."""
        with closing(self.source):
            try:
                while True:
                    data = self._before or self.source.read(READ_SECONDS)
                    self._before = b""
                    yield from self._samples(data)
            except Ended:
                yield from self._samples(b"\n")

    def _samples(self, data: bytes) -> Iterator[Chunk]:
        spec, rows = self._spec, self._lines.numbers(self._lines.cut(data))
        time = np.zeros(0) if spec.time is None or not len(rows) else rows[:, 0] * spec.time_factor
        back = np.flatnonzero(np.diff(time, prepend=self._last) < -LATEST) if len(time) else np.zeros(0, dtype=int)
        self._last = float(time[-1]) if len(time) else self._last
        for begin, end in pairwise([0, *back.tolist(), len(rows)]):
            if begin in back:
                self._clock, self._file = Clock(spec=spec, interval=self._clock.interval), self._file + 1
            samples = self._clock.samples(rows[begin:end]) if end > begin else None
            if samples is not None and len(samples.time):
                yield samples.chunk(spec, self._file)


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
