"""The samples of a log that are stored for the turns."""

from __future__ import annotations

import os
import tempfile
import threading
import weakref
from copy import copy
from io import BufferedRandom

import numpy as np

from tumble.units import Array

IN_MEMORY_BYTES = 16 * 2**20  # beyond, samples go to a temporary file


class MotionSamples:
    """Angular rates, rad/s, and specific forces, m/s², in the body from nominal sensors, with the interval, s, of each
    sample and `spare` further numbers; in memory, or in a temporary file if they are many.

    Samples may be added while others are read, also from other threads."""

    def __init__(self, spare: int = 0) -> None:
        self._columns = 7 + spare  # rate, force, interval, spare
        self._recent: list[Array] = []  # rows that are not in the file
        self._file: BufferedRandom | None = None
        self._in_file = 0  # number of samples in the file
        self._lock = threading.Lock()
        self._subtracted: tuple[MotionSamples, int, Array] | None = None  # whose file stays open, from where, and rate
        self.count = 0

    def with_rate_subtracted(self, first: int, rate: Array) -> MotionSamples:
        """Return these samples, less a rate (3,), rad/s, from sample `first` on. Nothing may be added to them."""
        out = copy(self)
        out._subtracted = self, first, rate
        return out

    def append(self, rates: Array, forces: Array, dt: Array, spare: Array | None = None) -> None:
        """Add mean rates (m, 3) and forces (m, 3) over intervals dt (m,), s, and `spare` numbers (m, ·)."""
        parts = (rates, forces, dt[:, None]) if spare is None else (rates, forces, dt[:, None], spare)
        rows = np.concatenate(parts, axis=1, out=np.empty((len(dt), self._columns)))
        with self._lock:
            self._recent.append(rows)
            self.count += len(rows)
            if rows.itemsize * self._columns * (self.count - self._in_file) <= IN_MEMORY_BYTES:
                return
            if self._file is None:
                self._file = tempfile.TemporaryFile()  # noqa: SIM115
                weakref.finalize(self, self._file.close)
            self._file.seek(0, os.SEEK_END)
            for rows in self._recent:
                self._file.write(rows.data)
            self._recent, self._in_file = [], self.count

    def read(self, start: int, stop: int) -> tuple[Array, Array, Array]:
        """Return rates (m, 3), forces (m, 3) and intervals (m,) of samples start … stop − 1."""
        return self.read_with_spare(start, stop)[:3]

    def read_with_spare(self, start: int, stop: int) -> tuple[Array, Array, Array, Array]:
        """Return the same and the spare numbers (m, ·)."""
        rows = np.empty((stop - start, self._columns))
        with self._lock:
            n_filed = min(max(self._in_file - start, 0), len(rows))
            if self._file is not None and n_filed:
                self._file.seek(rows.itemsize * self._columns * start)
                self._file.readinto(rows[:n_filed].data)
            if n_filed < len(rows):
                if len(self._recent) > 1:
                    self._recent = [np.concatenate(self._recent)]
                rows[n_filed:] = self._recent[0][start + n_filed - self._in_file : stop - self._in_file]
        rates, forces, intervals, spare = rows[:, :3], rows[:, 3:6], rows[:, 6], rows[:, 7:]
        if self._subtracted is not None:
            _, first, rate = self._subtracted
            rates[max(first - start, 0) :] -= rate
        return rates, forces, intervals, spare
