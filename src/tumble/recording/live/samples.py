"""Samples of a live source, processed by the same steps as those of a complete log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import closing, suppress
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np

from tumble.recording.live.lines import Lines
from tumble.recording.live.sources import Ended, LineSource
from tumble.recording.log import Chunk, samples_of
from tumble.recording.log_source import LogSource
from tumble.recording.rows.gaps import Gap, Grid, Tables, is_reading
from tumble.recording.session import LogSpec, Session, Site
from tumble.recording.session_file import session_of
from tumble.units import DEGREE, Array

SI_LOG: Mapping[str, Any] = {
    "file": "log.csv",
    "time": "t",
    "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s^2"},
    "gyro": {"columns": ["gx", "gy", "gz"], "unit": "rad/s"},
}
"""The table [log] of a source that sends t, ax, ay, az, gx, gy, gz in s, m/s² and rad/s."""
_HEAD = 100  # rows from which the interval is taken
READ_SECONDS = 0.2
CLOCK_BACK = 1.0  # s; a time stamp that falls by more is that of a restarted clock
TEMPERATURE = "temperature"
"""Name of the temperature column, °C, of a source in SI."""


class StreamedSamples:
    """Samples of the rows of one file of a log that arrive piece by piece.

    Times are checked, lost samples bridged and units converted as in a log that is read at once; the samples do not
    depend on the size of the pieces. `interval`, s, is by default the median over the first `head` rows, once they have
    arrived; `file` is the number of the file, from 0."""

    def __init__(self, spec: LogSpec, *, head: int = _HEAD, interval: float | None = None, file: int = 0) -> None:
        self.head, self.interval, self.gaps = head, interval, list[Gap]()
        self._spec, self._file = spec, file
        self._waiting = list[Array]()  # rows that have arrived since the last ones were taken
        self._samples: Iterator[Chunk] | None = None

    def feed(self, rows: Array) -> Chunk | None:
        """Add rows (m, columns) as written in the log, and return the samples that are complete, None without.

        Rows whose times can only be checked against the next rows are held back. Raises LogError if too many rows have
        wrong times, as after a restart of the clock."""
        spec, waiting = self._spec, self._waiting
        waiting.append(rows)
        if self._samples is None:
            head = np.concatenate(waiting)
            head = head[int(np.argmax(is_reading(head).all(axis=1))) :]  # a log begins with a complete row
            waiting[:] = [head]
            if len(head) < (self.head if self.interval is None else 1):
                return None
            start = self.interval or 0.0
            if spec.rate is not None:
                start = self.interval = 1.0 / spec.rate
            else:
                time = head[: self.head, spec.columns.index(spec.time or "")] * spec.time_factor
                start, steps = float(time[0]), np.diff(time)
                self.interval = self.interval or float(steps.mean() if spec.regular else np.median(steps))
            grid = Grid(start=start, interval=self.interval)
            received = LogSource(path=Path("what is received"), names=spec.columns)
            self._samples = samples_of(self._tables(), received, spec, self._file, grid, self.gaps)
        chunk = next(self._samples, None)
        return chunk if chunk is not None and len(chunk.time) else None

    def _tables(self) -> Tables:
        """Yield the rows that have arrived; no rows while none have."""
        before = 2 if self._spec.time is None else 1
        while True:
            rows = np.concatenate([np.empty((0, len(self._spec.columns))), *self._waiting])
            self._waiting.clear()
            yield np.asfortranarray(np.column_stack([np.zeros((len(rows), before)), rows])), ()


class SampleStream:
    """Samples of a live source, with columns and sensors as a session describes them.

    Without a session the source sends t, ax, ay, az, gx, gy, gz in s, m/s² and rad/s, without gyros unless `gyros`, and
    a temperature in °C if its first line names such a column."""

    def __init__(
        self,
        source: LineSource,
        session: Session | None,
        *,
        serial: str = "",
        site: Site | None = None,
        gyros: bool = True,
    ) -> None:
        self._source, self._before = source, b""
        if session is None:
            with suppress(Ended):
                while b"\n" not in self._before:
                    self._before += source.read(READ_SECONDS)
            log = {key: value for key, value in SI_LOG.items() if key != "file" and (gyros or key != "gyro")}
            first_line = self._before.partition(b"\n")[0].decode("utf-8", errors="replace")
            if TEMPERATURE in [column.strip() for column in first_line.split(",")]:
                log[TEMPERATURE] = {"columns": [TEMPERATURE], "unit": "degC"}
            tables = [log[key]["columns"] for key in ("accel", "gyro", TEMPERATURE) if key in log]
            columns = [log["time"], *chain.from_iterable(tables)]
            place = dict[str, float]()
            if site is not None:
                place = {"gravity": site.gravity, "gravity_u": site.gravity_u}
                place |= {} if site.height is None else {"height_m": site.height}
                place |= {} if site.latitude is None else {"latitude_deg": site.latitude / DEGREE}
            described = {"format": 1, "device": {"serial": serial}, "site": place, "log": log}
            session = session_of(described, {column: np.zeros(1) for column in columns})
        self.session, spec = session, session.log
        self._lines = Lines(columns=spec.columns, clock=spec.time, refuse=lambda _: None)
        self._samples = StreamedSamples(spec)

    @property
    def interval(self) -> float | None:
        """Time from sample to sample, s; None until enough samples have arrived."""
        return self._samples.interval

    def chunks(self) -> Iterator[Chunk]:
        """Yield the samples until the source ends. A clock that restarts begins another file."""
        spec, file, last, ended = self.session.log, 0, -np.inf, False
        with closing(self._source):
            while not ended:
                try:
                    data, self._before = self._before or self._source.read(READ_SECONDS), b""
                except Ended:
                    data, ended = b"\n", True
                rows = self._lines.numbers(self._lines.cut(data))
                back = np.zeros(0, dtype=int)
                if spec.time is not None and len(rows):
                    time = rows[:, spec.columns.index(spec.time)] * spec.time_factor
                    back = np.flatnonzero(np.diff(time, prepend=last) < -CLOCK_BACK)
                    last = float(time[-1])
                for begin, end in pairwise([0, *back.tolist(), len(rows)]):
                    if begin in back:
                        file += 1
                        self._samples = StreamedSamples(spec, interval=self._samples.interval, file=file)
                    chunk = self._samples.feed(rows[begin:end]) if end > begin else None
                    if chunk is not None:
                        yield chunk
