"""The samples of a log that are stored for the turns."""

from __future__ import annotations

import os
import tempfile
import threading
import weakref
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from copy import copy
from io import BufferedRandom
from itertools import pairwise

import numpy as np

from tumble.units import Array

IN_MEMORY_BYTES = 16 * 2**20  # beyond, samples go to a temporary file


class MotionSamples:
    """Angular rates, rad/s, and specific forces, m/s², in the body from nominal sensors, with the interval, s, of each
    sample and `spare` further numbers; in memory, or in a temporary file if they are many.

    Samples may be added while others are read, also from other threads. Added arrays are not copied; they are written
    to the file column by column."""

    def __init__(self, spare: int = 0) -> None:
        self._columns = 7 + spare  # rate, force, interval, spare
        self._chunks: list[Sequence[Array]] = []
        self._starts: list[int] = []  # first sample of each chunk
        self._file: BufferedRandom | None = None
        self._parts: list[int] = [0]  # first sample of each part of the file, and the first sample after them
        self._lock = threading.Lock()
        self._subtracted: tuple[MotionSamples, int, Array] | None = None
        self.count = 0

    def with_rate_subtracted(self, first: int, rate: Array) -> MotionSamples:
        """Return these samples, less a rate (3,), rad/s, from sample `first` on. Nothing may be added to them."""
        out = copy(self)
        out._subtracted = self, first, rate
        return out

    def since(self, first: int) -> MotionSamples:
        """Return a copy of the samples from `first` on, to which others may be added."""
        out = MotionSamples(self._columns - 7)
        if first < self.count:
            rates, forces, dt, spare = self.read_with_spare(first, self.count)
            out.append(rates, forces, dt, spare if spare.shape[1] else None)
        return out

    def append(self, rates: Array, forces: Array, dt: Array, spare: Array | None = None) -> None:
        """Add mean rates (m, 3) and forces (m, 3) over intervals dt (m,), s, and `spare` numbers (m, ·)."""
        with self._lock:
            self._chunks.append((rates, forces, dt[:, None]) if spare is None else (rates, forces, dt[:, None], spare))
            self._starts.append(self.count)
            self.count += len(dt)
            if 8 * self._columns * (self.count - self._parts[-1]) <= IN_MEMORY_BYTES:
                return
            if self._file is None:
                self._file = tempfile.TemporaryFile()  # noqa: SIM115
                weakref.finalize(self, self._file.close)
            self._file.seek(0, os.SEEK_END)
            columns = ([column for values in chunk for column in values.T] for chunk in self._chunks)
            for column in zip(*columns, strict=True):
                for values in column:
                    self._file.write(np.ascontiguousarray(values).data)
            self._chunks, self._starts = [], []
            self._parts.append(self.count)

    def read(self, start: int, stop: int) -> tuple[Array, Array, Array]:
        """Return rates (m, 3), forces (m, 3) and intervals (m,) of samples start … stop − 1."""
        return self.read_with_spare(start, stop)[:3]

    def read_with_spare(self, start: int, stop: int) -> tuple[Array, Array, Array, Array]:
        """Return the same and the spare numbers (m, ·)."""
        if self._subtracted is not None:
            original, since, rate = self._subtracted
            rates, *others = original.read_with_spare(start, stop)
            rates[max(since - start, 0) :] -= rate
            return rates, others[0], others[1], others[2]
        rows = np.empty((self._columns, stop - start)).T
        with self._lock:
            for first, end in pairwise(self._parts):
                a, b = max(start, first), min(stop, end)
                if self._file is None or a >= b:
                    continue
                for j in range(self._columns):
                    self._file.seek(8 * (self._columns * first + j * (end - first) + a - first))
                    self._file.readinto(rows[a - start : b - start, j].data)
            for i in range(max(bisect_right(self._starts, start) - 1, 0), bisect_left(self._starts, stop)):
                first, chunk = self._starts[i], self._chunks[i]
                a, b = max(start, first), min(stop, first + len(chunk[0]))
                part = [values[a - first : b - first] for values in chunk]
                np.concatenate(part, axis=1, out=rows[a - start : b - start])
        return rows[:, :3], rows[:, 3:6], rows[:, 6], rows[:, 7:]
