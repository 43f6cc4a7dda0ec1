"""The drift watch: scores of the same cases now and at the last release, and what moved beyond the error of both.

Cases are compared one by one, those that both results have. Of a score that every case has (the logarithm of what is
left of the errors, the mean square of z, the share of intervals that contain the truth) the changes are averaged over
the cases of a program; a mean has moved where it is beyond SIGMAS of its standard error and beyond what matters. Of a
score that is yes or no (the verdict is the expected one, a session is silently wrong) the cases that changed either way
are counted: one way more than the other has moved where a coin would not do so once in twenty. Every case that changed
is named, whether it counts or not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binom

from evidence.score import USABLE, Row, as_expected, by

SIGMAS = 3.0
CHANCE = 0.05
FAILED = "failed, "
"""How the words of a program that ends in an error of its own begin: never chance."""
NAMED = 5
"""Cases that are named of a score."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Moved:
    """A score of a program that is not what it was: before and after, the standard error of the difference (None of
    one that is counted), whether it is beyond that, whether it is for the worse, and the cases that moved most."""

    program: str
    score: str
    before: float
    after: float
    error: float | None
    beyond: bool
    worse: bool
    cases: tuple[str, ...]


def _left(row: Row) -> float | None:
    """The mean logarithm of what is left of the errors, over groups."""
    if row.verdict not in USABLE or not row.errors:
        return None
    return float(np.mean([np.log(max(off, 1e-300) / max(was, 1e-300)) for off, was in row.errors.values()]))


def _square(row: Row) -> float | None:
    return float(np.mean(np.square(list(row.z.values())))) if row.verdict in USABLE and row.z else None


def _covered(row: Row) -> float | None:
    return row.covered / row.intervals if row.verdict in USABLE and row.intervals else None


MEANS: Mapping[str, tuple[Callable[[Row], float | None], float, float]] = {
    "left of the errors, logarithm": (_left, 1.0, 0.01),
    "mean square of z": (_square, 1.0, 0.02),
    "share of intervals that contain the truth": (_covered, -1.0, 0.002),
}
"""The score of a case, which way is worse, and the change that matters."""


def compared(before: Sequence[Row], after: Sequence[Row], expected: Mapping[str, tuple[str, str]]) -> list[Moved]:
    """What moved, for every program that both have."""
    old, moved = by(before, "program"), []
    for program, rows in by(after, "program").items():
        there = {row.case: row for row in old.get(program, ())}
        pairs = [(there[row.case], row) for row in rows if row.case in there]
        for score, (value, worse, matters) in MEANS.items():
            both = [(pair, value(pair[0]), value(pair[1])) for pair in pairs]
            known = [(pair, a, b) for pair, a, b in both if a is not None and b is not None]
            if not known:
                continue
            change = np.array([b - a for _, a, b in known])
            if not change.any():
                continue
            error = float(change.std(ddof=1) / np.sqrt(len(change))) if len(change) > 1 else np.inf
            mean = float(change.mean())
            beyond = abs(mean) > max(SIGMAS * error, matters)
            most = np.argsort(-np.abs(change), kind="stable")[:NAMED]
            moved.append(Moved(
                program=program, score=score, before=float(np.mean([a for _, a, _ in known])),
                after=float(np.mean([b for _, _, b in known])), error=error, beyond=beyond,
                worse=beyond and mean * worse > 0.0,
                cases=tuple(f"{known[i][0][1].case} ({change[i]:+.3g})" for i in most if change[i]),
            ))  # fmt: skip
        for score, holds, good in (
            ("verdicts as expected", lambda row: as_expected(row, *expected[row.kind]), True),
            ("silently wrong", lambda row: row.silent_wrong, False),
            ("ends in an error", lambda row: row.said.startswith(FAILED), False),
        ):
            judged = [(a, b, holds(a), holds(b)) for a, b in pairs if a.kind in expected]
            changed = [(a, b, now) for a, b, was, now in judged if was != now]
            if not changed:
                continue
            worse_ones = sum(now != good for _, _, now in changed)
            more = max(worse_ones, len(changed) - worse_ones)
            beyond = 2.0 * binom.sf(more - 1, len(changed), 0.5) < CHANCE or score == "ends in an error"
            moved.append(Moved(
                program=program, score=score, before=float(sum(was for _, _, was, _ in judged)),
                after=float(sum(now for _, _, _, now in judged)), error=None, beyond=bool(beyond),
                worse=bool(beyond) and 2 * worse_ones > len(changed),
                cases=tuple(f"{b.case} ({a.verdict}, now {b.verdict})" for a, b, _ in changed),
            ))  # fmt: skip
    return moved


def told(moved: Sequence[Moved]) -> str:
    """In lines: what is worse first, then what else moved."""
    lines = []
    for each in sorted(moved, key=lambda m: (not m.worse, not m.beyond)):
        how = "worse" if each.worse else "better" if each.beyond else "within the error"
        error = "" if each.error is None else f" ± {each.error:.2g} of the difference"
        cases = ", ".join(each.cases)
        lines.append(f"{how}: {each.program}, {each.score}: {each.before:.4g}, now {each.after:.4g}{error}: {cases}")
    return "\n".join(lines or ["nothing moved"])
