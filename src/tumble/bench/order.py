"""Rows in the order of their times, where a network may exchange, repeat or lose them."""

from __future__ import annotations

import heapq
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tumble.bench.lines import Row
from tumble.units import Array

WAIT_SECONDS = 0.1
MOST_WAITING = 256
JUMP = 1.5
"""Intervals: a longer step leaves room for rows that may still come."""
RESTARTED = 5.0
"""s: a clock that goes back by more has been started anew."""


@dataclass(kw_only=True, slots=True)
class Order:
    """Lets rows pass in the order of their times. From an `unordered` source a row after a missing one waits for it,
    a tenth of a second at most. `seconds` is one unit of the log's time in s. `late` counts rows that came too late,
    `repeated` those that came twice; `restarted` says whether the clock was seen to start anew. Rows up to
    the `last` one of an earlier recording, which a
    source may send again, are passed over until a new one comes."""

    unordered: bool
    seconds: float
    refuse: Callable[[bytes], None]
    now: Callable[[], float] = time.monotonic
    last: float | None = None
    late: int = 0
    repeated: int = 0
    restarted: bool = False
    _interval: float | None = None
    _waiting: list[tuple[float, str, float]] = field(default_factory=list)
    """Times, rows, and when they came."""
    _passed: deque[float] = field(default_factory=lambda: deque(maxlen=MOST_WAITING))

    def feed(self, rows: list[Row]) -> list[str]:
        """The rows that pass now, as text."""
        out: list[str] = []
        for row in rows:
            if row.time is None:
                out.append(row.text)
            elif self._is_new(row):
                self._take(row.time, row.text, out)
        self._release(out)
        return out

    def passes(self, times: Array) -> bool:
        """Let rows pass whose times rise, after those before; False, and nothing is done, where one by one must be
        looked at."""
        if self.unordered or self._waiting or len(times) < 2 or not np.all(np.diff(times) > 0.0):
            return False
        if self.last is not None and times[0] <= self.last:
            return False
        for at in times[-MOST_WAITING:].tolist():
            self._note(at)
        return True

    @property
    def waiting(self) -> list[str]:
        """The rows that wait, in order."""
        return [text for _, text, _ in sorted(self._waiting)]

    def end(self) -> list[str]:
        """The rows that wait, when nothing comes any more."""
        out, self._waiting = self.waiting, []
        return out

    def _is_new(self, row: Row) -> bool:
        assert row.time is not None
        if self.last is None or (row.time > self.last and not self._waiting):
            return True
        if self.last is not None and self._interval is None and row.time <= self.last:
            return False
        if row.time in self._passed or any(row.time == waiting for waiting, _, _ in self._waiting):
            self.repeated += 1
            return False
        if self.last is not None and row.time < self.last:
            self.restarted = self.restarted or (self.last - row.time) * self.seconds > RESTARTED
            self.late += 1
            self.refuse(row.text.encode())
            return False
        return True

    def _take(self, at: float, text: str, out: list[str]) -> None:
        if not self.unordered or not self._leaves_room(at):
            self._pass(at, text, out)
            self._contiguous(out)
            return
        heapq.heappush(self._waiting, (at, text, self.now()))
        self._contiguous(out)

    def _contiguous(self, out: list[str]) -> None:
        while self._waiting and not self._leaves_room(self._waiting[0][0]):
            self._pass(*heapq.heappop(self._waiting)[:2], out)

    def _leaves_room(self, at: float) -> bool:
        """Whether a row may be missing before this time."""
        return self.last is not None and self._interval is not None and at - self.last > JUMP * self._interval

    def _pass(self, at: float, text: str, out: list[str]) -> None:
        self._note(at)
        out.append(text)

    def _note(self, at: float) -> None:
        """Remember a row that passes."""
        if self.last is not None:
            step = at - self.last
            self._interval = step if self._interval is None else self._interval + 0.05 * _clipped(step, self._interval)
        self.last = at
        self._passed.append(at)

    def _release(self, out: list[str]) -> None:
        """Let pass what has waited long enough."""
        while self._waiting and (self.now() - self._waiting[0][2] > WAIT_SECONDS or len(self._waiting) > MOST_WAITING):
            self._pass(*heapq.heappop(self._waiting)[:2], out)
            self._contiguous(out)


def _clipped(step: float, interval: float) -> float:
    """How much a step differs from the interval, at most by half of it."""
    return max(-0.5 * interval, min(0.5 * interval, step - interval))
