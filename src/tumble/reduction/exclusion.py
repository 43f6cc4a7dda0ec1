"""What a session leaves out, [[exclude]] of session.toml.

Times are taken out of the rests before these are matched to a programme: a rest is what is left of it, if that is
long enough. Rests and turns by number are those of the results, and are left out after the matching, so that a rest
of a programme that is left out is not missing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tumble.errors import SessionError
from tumble.recording.gaps import Gap
from tumble.recording.session import Exclusion
from tumble.reduction.blocks import Reduction
from tumble.reduction.matching import Match
from tumble.reduction.segmentation import RestSpan, Segmentation


def without_times(reduction: Reduction, found: Segmentation, excluded: tuple[Exclusion, ...]) -> Segmentation:
    """The rests of a log without the stretches of time that are left out; of a rest the longest part remains."""
    for one in excluded:
        if one.start is not None and one.stop is not None:
            rests = [_longest(reduction, span, one.file, one.start, one.stop) for span in found.rests]
            found = replace(found, rests=tuple(span for span in rests if span is not None))
    return found


def _longest(reduction: Reduction, span: RestSpan, file: int, start: float, stop: float) -> RestSpan | None:
    """The longer part of a rest before or after a stretch of time; None where none is long enough."""
    if span.file != file or start >= span.stop or stop <= span.start:
        return span
    edges = next(f.edges for f in reduction.files if f.file == file)
    before = span.first, min(span.last, int(np.searchsorted(edges, start + 1e-9, side="right")) - 1)
    after = max(span.first, int(np.searchsorted(edges, stop - 1e-9))), span.last
    first, last = max(before, after, key=lambda part: part[1] - part[0])
    if last <= first or edges[last] - edges[first] < reduction.tuning.rest:
        return None
    return RestSpan(file=file, first=first, last=last, start=float(edges[first]), stop=float(edges[last]))


def without_turns(reduction: Reduction, match: Match, excluded: tuple[Exclusion, ...]) -> Reduction:
    """A reduction in which the turns that are left out by number were not recorded."""
    gaps = [_turn(match, one) for one in excluded if one.turn is not None]
    return replace(reduction, gaps=(*reduction.gaps, *gaps)) if gaps else reduction


def _turn(match: Match, one: Exclusion) -> Gap:
    assert one.turn is not None
    _expect(one, len(match.rests) - 1)
    before, after = match.rests[one.turn - 1], match.rests[one.turn]
    return Gap(
        file=before.file,
        row=0,
        time=before.stop,
        samples=1,
        what="left out",
        stop=after.start,
        integrable=False,
        why="",  # `said` tells it
    )


def without_rests(match: Match, excluded: tuple[Exclusion, ...]) -> Match:
    """The rests to use without those that are left out by number."""
    named = [one for one in excluded if one.rest is not None]
    for one in named:
        _expect(one, len(match.rests))
    numbers = {one.rest for one in named}
    kept = [i for i in range(len(match.rests)) if i + 1 not in numbers]
    if len(kept) == len(match.rests):
        return match
    position = None if match.position is None else match.position[kept]
    return replace(match, rests=tuple(match.rests[i] for i in kept), position=position)


def _expect(one: Exclusion, count: int) -> None:
    what, number = ("rest", one.rest) if one.rest is not None else ("turn", one.turn)
    if number is not None and number > count:
        where = "without" if one.by == "request" else f"session.toml: exclude.{what}"
        raise SessionError(f"{where}: expected a {what} from 1 to {count}, found {number}")


def said(excluded: tuple[Exclusion, ...]) -> tuple[str, ...]:
    """What is left out, as notes."""
    return tuple(_said(one) for one in excluded)


def _said(one: Exclusion) -> str:
    if one.rest is not None:
        what = f"rest {one.rest}"
    elif one.turn is not None:
        what = f"turn {one.turn}"
    else:
        what = f"{one.start:g}–{one.stop:g} s" + (f" of file {one.file + 1}" if one.file else "")
    return f"left out by {one.by}: {what}" + (f": {one.reason}" if one.reason else "")
