"""Samples of rows as they come, by the same chain as those of a log that has ended."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from tumble.recording.log import Chunk, samples_of_file
from tumble.recording.log_source import LogSource, Tables
from tumble.recording.rows.gaps import Gap, Grid, is_reading
from tumble.recording.session import LogSpec
from tumble.units import Array

SI_LOG: Mapping[str, Any] = {
    "file": "log.csv",
    "time": "t",
    "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s^2"},
    "gyro": {"columns": ["gx", "gy", "gz"], "unit": "rad/s"},
}
"""The table [log] of a source that sends t, ax, ay, az, gx, gy, gz in s, m/s² and rad/s."""
_HEAD = 100


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _ComingRows(LogSource):
    """A log of which rows may come at any time: while none has, its tables are empty."""

    waiting: list[Array] = field(default_factory=list)

    def read(self, columns: Sequence[str], clock: str | None) -> Tables:
        del clock
        while True:
            rows = np.concatenate([np.empty((0, len(self.names))), *self.waiting])
            self.waiting.clear()
            yield pl.DataFrame(rows, schema=list(self.names), orient="row").select(columns), []


class StreamedSamples:
    """Samples of the rows of one file of a log, which come piece by piece.

    Times are judged, lost samples bridged and units converted as in a log that is read at once. In pieces of any size
    the samples are the same.

    Parameters
    ----------
    spec
        The log, as its session describes it.
    head
        Rows from which the interval is taken.
    interval
        From sample to sample, s. None: the median over the first `head` rows.
    file
        Number of the file, from 0.

    Attributes
    ----------
    interval : float or None
        None while fewer than `head` rows have come.
    gaps : list of Gap
        What was bridged or left out.
    """

    def __init__(self, spec: LogSpec, *, head: int = _HEAD, interval: float | None = None, file: int = 0) -> None:
        self.head, self.interval, self.gaps = head, interval, list[Gap]()
        self._spec, self._file = spec, file
        self._coming = _ComingRows(path=Path("what is received"), names=spec.columns)
        self._samples: Iterator[Chunk] | None = None

    def feed(self, rows: Array) -> Chunk | None:
        """Add rows (m, columns) as the log has them, and return the samples that are settled with them.

        Returns
        -------
        Chunk or None
            None where no sample is settled. Rows whose times are to be judged by the next are held back.

        Raises
        ------
        LogError
            Where too many rows have wrong times, as when the clock has started anew.
        """
        spec, waiting = self._spec, self._coming.waiting
        waiting.append(rows)
        if self._samples is None:
            head = np.concatenate(waiting)
            head = head[int(np.argmax(is_reading(head).all(axis=1))) :]  # a log begins with a whole row
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
            self._samples = samples_of_file(self._coming, spec, self._file, grid, self.gaps)
        chunk = next(self._samples, None)
        return chunk if chunk is not None and len(chunk.time) else None
