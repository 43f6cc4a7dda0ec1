"""What the operator has answered: the faults that are seen to, and what is left out of the log."""

from __future__ import annotations

import math
from pathlib import Path

from tumble.bench import session_folder
from tumble.bench.follow.faults import Fault
from tumble.documents import whole_number
from tumble.recording.session import Exclusion

_HERE = ("knock", "movement")
"""Faults of a rest that begins anew in the same place."""


class Answers:
    """The answers of one session, written into the session.toml of its `folder`, which left out `before` what it did.
    `answered` are the keys of faults that are seen to; `go_on` says whether the operator wants more positions than are
    needed."""

    def __init__(self, folder: Path, before: tuple[Exclusion, ...]) -> None:
        self.answered: set[tuple[str, int]] = set()
        self.go_on = False
        self._folder, self._before = folder, before
        self._added: list[Exclusion] = []
        self._open: Exclusion | None = None
        """The one that lasts until the unit is moved."""

    @property
    def excluded(self) -> tuple[Exclusion, ...]:
        """What is left out, last what has no end yet."""
        ended = tuple(one for one in (*self._before, *self._added) if one != self._open)
        return ended if self._open is None else (*ended, self._open.model_copy(update={"stop": math.inf}))

    def moved(self, now: float) -> None:
        """End what is left out until the unit is moved."""
        if self._open is None:
            return
        ended = self._open.model_copy(update={"stop": now})
        session_folder.leave_out(self._folder, ended, instead_of=self._open)
        self._added = [ended if one == self._open else one for one in self._added]
        self._open = None

    def again(self, fault: Fault | None, now: float) -> str:
        if fault is None:
            return "nothing is wrong"
        here = fault.kind in _HERE
        self._leave_out(fault, fault.start, now, until_moved=not here)
        return "left out; hold still, this rest begins anew" if here else "left out; take it again"

    def keep_first(self, fault: Fault | None, now: float) -> str:
        """Leave out what is wrong and what follows it, and keep what was before."""
        if fault is None or "keep_first" not in fault.choices:
            return "there is no first part"
        self._leave_out(fault, fault.stop, now, until_moved=True)
        return "the first part is kept; go on to the next position"

    def going_on(self, fault: Fault | None) -> str:
        if fault is not None:
            self.answered.add(fault.key)
            return "noted; nothing is left out"
        self.go_on = True
        return "going on"

    def leave_out_rest(self, number: str, rests: int) -> str:
        rest = whole_number(number)
        if rest is None or not 0 < rest <= rests:
            return f"expected the number of a rest from 1 to {rests}"
        self._add(Exclusion(rest=rest, reason="left out at the bench"))
        return f"rest {rest} is left out"

    def take_back(self) -> str:
        if not self._added:
            return "nothing was left out here"
        one = self._added.pop()
        session_folder.leave_out(self._folder, None, instead_of=one)
        self._open = None if self._open == one else self._open
        return "taken back"

    def _leave_out(self, fault: Fault, start: float, now: float, *, until_moved: bool) -> None:
        self.answered.add(fault.key)
        one = Exclusion(start=start, stop=max(now, start + 1e-3), reason=fault.said)
        self._add(one)
        if until_moved:
            self._open = one

    def _add(self, one: Exclusion) -> None:
        session_folder.leave_out(self._folder, one)
        self._added.append(one)
