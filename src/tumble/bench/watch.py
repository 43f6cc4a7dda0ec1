"""Channels that are clipped or stuck, seen as their samples come."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.units import Array

STUCK_SECONDS = 1.0
"""A channel that repeats itself for so long, while others of its kind do not, is stuck."""
FULL = 0.999
_LEAST_RUN = 20


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelFault:
    """What was seen of a column: "clipped" or "stuck", from `start` to `stop`, s."""

    what: str
    column: str
    start: float
    stop: float


class Watch:
    """Looks at every sample of one kind of sensor. `full_scale` in SI, None where it is not known."""

    def __init__(self, columns: tuple[str, ...], full_scale: float | None, interval: float) -> None:
        self.columns, self.full_scale = columns, full_scale
        self._least = max(_LEAST_RUN, round(STUCK_SECONDS / interval))
        self._last: Array | None = None
        self._since = np.zeros(len(columns))
        self._run = np.zeros(len(columns), dtype=np.int64)
        self._repeats = np.zeros(len(columns), dtype=np.int64)
        self._count = 0
        self._said: dict[tuple[str, str], float] = {}

    def look(self, time: Array, values: Array) -> list[ChannelFault]:
        """What is seen in the next samples (m, n) in SI; of each column a fault once in ten seconds."""
        if not len(time):
            return []
        return [*self._clipped(time, values), *self._stuck(time, values)]

    def _clipped(self, time: Array, values: Array) -> list[ChannelFault]:
        if self.full_scale is None:
            return []
        over = np.abs(values) >= FULL * self.full_scale
        return [
            seen
            for p in np.flatnonzero(over.any(axis=0))
            for seen in self._new("clipped", int(p), float(time[over[:, p]][0]), float(time[over[:, p]][-1]))
        ]

    def _stuck(self, time: Array, values: Array) -> list[ChannelFault]:
        before = values[:1] * np.nan if self._last is None else self._last[None]
        equal = values == np.concatenate([before, values[:-1]])
        self._last = values[-1].copy()
        self._count += len(time)
        self._repeats += equal.sum(axis=0)
        out = []
        for p in range(len(self.columns)):
            changes = np.flatnonzero(~equal[:, p])
            if len(changes):
                self._run[p], self._since[p] = len(time) - 1 - changes[-1], time[changes[-1]]
            else:
                self._run[p] += len(time)
            coarse = 2 * (self._repeats[p] - self._run[p]) > self._count
            if self._run[p] >= self._least and not coarse and self._run.min() < 0.5 * self._least:
                out += self._new("stuck", p, float(self._since[p]), float(time[-1]))
        return out

    def _new(self, what: str, p: int, start: float, stop: float) -> list[ChannelFault]:
        key = what, self.columns[p]
        if start < self._said.get(key, -np.inf) + 10.0:
            return []
        self._said[key] = start
        return [ChannelFault(what=what, column=self.columns[p], start=start, stop=stop)]
