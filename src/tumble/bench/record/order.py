"""Rows in the order of their times, where a network may exchange, repeat or lose them, and damage a time.

A row that follows the last one within a second passes. One that leaps farther ahead, or is late, is set apart: if the
next row follows the last one, its time was wrong. If three in succession agree with each other, they are believed: the
stream has paused, or the time of a row that has passed before them was wrong, which the readers of logs leave out. Rows
that agree and are late behind three or more are late, or of a clock that was started anew.
"""

from __future__ import annotations

import heapq
import time
from collections import deque
from collections.abc import Callable

import numpy as np

from tumble.recording.live.lines import Row
from tumble.recording.rows.gaps import JUMP
from tumble.units import Array

WAIT_SECONDS = 0.1
MOST_WAITING = 256
LEAP_SECONDS = 1.0
LEAP_INTERVALS = 10.0
"""A row that comes later than the longer of these after the last one leaps. Less would set rows apart wherever a stream
stutters; a wrong time within it passes, and the three rows after it are believed against it."""
AGREE = 3
"""Rows that agree are believed: of random times within an hour two follow each other within a second once in 3,600
times, three once in 10⁷."""
RESTARTED = 5.0
"""s: a clock that goes back by more has been started anew."""


class Order:
    """Lets rows pass in the order of their times. From an `unordered` source a row after a missing one waits for it,
    a tenth of a second at most. `seconds` is one unit of the log's time in s. `late` counts rows that came too late,
    `leapt` those whose time was too far ahead, `repeated` those that came twice; `restarted` says whether the clock was
    seen to start anew. Rows up to the `last` one of an earlier recording, which a source may send again, are passed
    over, and counted as repeated, until a new one comes."""

    def __init__(
        self,
        *,
        unordered: bool,
        seconds: float,
        refuse: Callable[[bytes], None],
        now: Callable[[], float] = time.monotonic,
        last: float | None = None,
    ) -> None:
        self.unordered, self.seconds, self.last = unordered, seconds, last
        self.late = self.leapt = self.repeated = 0
        self.restarted = False
        self._refuse, self._now = refuse, now
        self._interval: float | None = None
        self._waiting: list[tuple[float, str, float]] = []
        """Times, rows, and when they came: a heap."""
        self._apart: list[tuple[float, str]] = []
        """Times and rows that do not follow the last one, fewer than AGREE."""
        self._times: deque[float] = deque(maxlen=MOST_WAITING)
        """Of the rows that have passed."""
        self._passed: list[str] = []

    def feed(self, rows: list[Row]) -> list[str]:
        """The rows that pass now, as text."""
        for row in rows:
            if row.time is None:
                self._passed.append(row.text)
            elif self._is_repeated(row.time):
                self.repeated += 1
            else:
                self._take(row.time, row.text)
        while self._waiting and (self._now() - self._waiting[0][2] > WAIT_SECONDS or len(self._waiting) > MOST_WAITING):
            self._pass(*heapq.heappop(self._waiting)[:2])
            self._pass_contiguous()
        passed, self._passed = self._passed, []
        return passed

    def passes(self, times: Array) -> bool:
        """Let rows pass whose times follow each other and those before; False, and nothing is done, where one by one
        must be looked at."""
        if self.unordered or self.last is None or self._interval is None or self._waiting or self._apart:
            return False
        steps = np.diff(times, prepend=self.last)
        if not np.all((steps > 0.0) & (steps <= self._longest(self._interval))):
            return False
        for at in times[-MOST_WAITING:].tolist():
            self._pass(at)
        return True

    @property
    def waiting(self) -> list[str]:
        """The rows that wait or are set apart, in the order in which they would pass."""
        return [text for _, text, _ in sorted(self._waiting)] + [text for _, text in self._apart]

    def end(self) -> list[str]:
        """The rows that wait, when nothing comes any more: of those set apart the ones that were the first of all."""
        if self.last is not None or np.any(np.diff([at for at, _ in self._apart]) <= 0.0):
            self._refuse_apart()
        out, self._waiting, self._apart = self.waiting, [], []
        return out

    def _is_repeated(self, at: float) -> bool:
        if any(at == apart for apart, _ in self._apart):
            return True
        if self.last is None or (at > self.last and not self._waiting):
            return False
        before_any_new = self._interval is None and at <= self.last
        return before_any_new or at in self._times or any(at == waiting for waiting, _, _ in self._waiting)

    def _take(self, at: float, text: str) -> None:
        newest = -np.inf if self.last is None else max([self.last, *(waiting for waiting, _, _ in self._waiting)])
        if self.last is None or not self.last < at <= newest + self._longest(self._interval or 0.0):
            self._set_apart(at, text)
            return
        self._refuse_apart()
        if self.unordered and self._leaves_room(at):
            heapq.heappush(self._waiting, (at, text, self._now()))
        else:
            self._pass(at, text)
        self._pass_contiguous()

    def _longest(self, interval: float) -> float:
        """The longest step between rows that follow each other, in units of the log."""
        return max(LEAP_SECONDS / self.seconds, LEAP_INTERVALS * interval)

    def _leaves_room(self, at: float) -> bool:
        """Whether a row may be missing before this time."""
        return self.last is not None and self._interval is not None and at - self.last > JUMP * self._interval

    def _set_apart(self, at: float, text: str) -> None:
        """Keep a row that does not follow the last one until it is known what to think of it."""
        if len(self._apart) == AGREE - 1:
            steps = np.diff([*(apart for apart, _ in self._apart), at])
            interval = float(steps.min()) if self._interval is None else self._interval
            if not np.all((steps > 0.0) & (steps <= self._longest(interval))):
                self._refuse_apart(1)
        self._apart.append((at, text))
        if len(self._apart) < AGREE:
            return
        first = self._apart[0][0]
        behind = sum(passed > first for passed in self._times)
        if self.last is None or first > self.last or (behind < AGREE and any(p < first for p in self._times)):
            agreed, self._apart = self._apart, []
            while self._waiting and self._waiting[0][0] < first:
                self._pass(*heapq.heappop(self._waiting)[:2])
            if self._interval is None:
                self._interval = float(np.diff([when for when, _ in agreed]).min())
            for when, row in agreed:
                self._pass(when, row)
            return
        self.restarted = self.restarted or (self.last - first) * self.seconds > RESTARTED
        self._refuse_apart()

    def _refuse_apart(self, count: int = AGREE) -> None:
        """Refuse the first rows that are set apart: their times are wrong, or they are late."""
        refused, self._apart = self._apart[:count], self._apart[count:]
        for at, text in refused:
            ahead = self.last is None or at > self.last
            self.leapt, self.late = self.leapt + ahead, self.late + (not ahead)
            self._refuse(text.encode())

    def _pass_contiguous(self) -> None:
        """Let pass what waits and follows the last row."""
        while self._waiting and not self._leaves_room(self._waiting[0][0]):
            self._pass(*heapq.heappop(self._waiting)[:2])

    def _pass(self, at: float, *text: str) -> None:
        """Remember a row that passes, which has passed already where there is no text of it: its time, and the
        interval, which follows the steps, of each at most by half of itself."""
        if self.last is not None and self._interval is None:
            self._interval = at - self.last
        elif self.last is not None and self._interval is not None:
            half = 0.5 * self._interval
            self._interval += 0.05 * max(-half, min(half, at - self.last - self._interval))
        self.last = at
        self._times.append(at)
        self._passed += text
