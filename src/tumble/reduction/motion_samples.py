"""The samples of a log, kept for the turns: in memory while they are few, in a temporary file beyond."""

from __future__ import annotations

import os
import tempfile
import threading
import weakref
from bisect import bisect_left, bisect_right
from typing import IO

import numpy as np

from tumble.units import Array

IN_MEMORY_BYTES = 16 * 2**20


class MotionSamples:
    """Angular rates (rad/s) and specific forces (m/s²) in the body as nominal sensors read them, P_g and P_a times the
    readings, the interval (s) of each sample, and `spare` numbers more. Samples may be added while others are read,
    from other threads too."""

    def __init__(self, spare: int = 0) -> None:
        self._columns = 7 + spare  # rate, force, interval, spare
        self._chunks: list[Array] = []
        self._starts: list[int] = []
        self._file: IO[bytes] | None = None
        self._lock = threading.Lock()
        self.count = 0

    def append(self, rates: Array, forces: Array, dt: Array, spare: Array | None = None) -> None:
        """Add samples: mean rates (m, 3) and mean forces (m, 3) over intervals dt (m,), and what is `spare` (m, ·)."""
        rows = np.empty((len(dt), self._columns))
        rows[:, :3], rows[:, 3:6], rows[:, 6] = rates, forces, dt
        if spare is not None:
            rows[:, 7:] = spare
        with self._lock:
            self._chunks.append(rows)
            self._starts.append(self.count)
            self.count += len(rows)
            if self._file is not None or 8 * self._columns * self.count > IN_MEMORY_BYTES:
                self._spill()

    def _spill(self) -> None:
        """Move what is in memory to the file."""
        if self._file is None:
            self._file = tempfile.TemporaryFile()  # noqa: SIM115
            weakref.finalize(self, self._file.close)
        self._file.seek(0, os.SEEK_END)
        for rows in self._chunks:
            self._file.write(rows.data)
        self._chunks, self._starts = [], []

    def read(self, start: int, stop: int) -> tuple[Array, Array, Array]:
        """Rates (m, 3), forces (m, 3) and intervals (m,) of samples start … stop − 1."""
        return self.read_with_spare(start, stop)[:3]

    def read_with_spare(self, start: int, stop: int) -> tuple[Array, Array, Array, Array]:
        """The same, and what is spare (m, ·)."""
        with self._lock:
            rows = self._in_memory(start, stop) if self._file is None else self._in_file(self._file, start, stop)
        return rows[:, :3], rows[:, 3:6], rows[:, 6], rows[:, 7:]

    def _in_memory(self, start: int, stop: int) -> Array:
        first, last = bisect_right(self._starts, start) - 1, bisect_left(self._starts, stop)
        rows = np.concatenate(self._chunks[first:last])
        return rows[start - self._starts[first] : stop - self._starts[first]]

    def _in_file(self, file: IO[bytes], start: int, stop: int) -> Array:
        file.seek(8 * self._columns * start)
        return np.frombuffer(file.read(8 * self._columns * (stop - start))).reshape(-1, self._columns)
