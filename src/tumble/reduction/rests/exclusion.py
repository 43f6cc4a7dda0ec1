"""What a session leaves out, [[exclude]] of session.toml.

Times are taken out of the rests before these are matched to a programme: a rest is what is left of it, if that is
long enough. Rests and turns by number are those of the results, and are left out after the matching, so that a rest
of a programme that is left out is not missing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tumble.errors import SessionError
from tumble.recording.session import Exclusion
from tumble.reduction.blocks.reducer import Reduction
from tumble.reduction.rests.matching import Match
from tumble.reduction.rests.segmentation import RestSpan, Segmentation, unrecorded


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
    gaps = []
    for one in excluded:
        if one.turn is not None:
            _expect(one, "turn", one.turn, len(match.rests) - 1)
            before, after = match.rests[one.turn - 1 : one.turn + 1]
            gaps.append(unrecorded(before, after, 1, "left out", why=""))  # `said` tells it
    return replace(reduction, gaps=(*reduction.gaps, *gaps)) if gaps else reduction


def without_rests(match: Match, excluded: tuple[Exclusion, ...]) -> Match:
    """The rests to use without those that are left out by number."""
    numbers = {one.rest for one in excluded if one.rest is not None}
    for one in excluded:
        if one.rest is not None:
            _expect(one, "rest", one.rest, len(match.rests))
    kept = [i for i in range(len(match.rests)) if i + 1 not in numbers]
    position = None if match.position is None else match.position[kept]
    return replace(match, rests=tuple(match.rests[i] for i in kept), position=position) if numbers else match


def _expect(one: Exclusion, what: str, number: int, count: int) -> None:
    """Raise a SessionError for a rest or turn that there is none of."""
    if number > count:
        where = "without" if one.by == "request" else f"session.toml: exclude.{what}"
        raise SessionError(f"{where}: expected a {what} from 1 to {count}, found {number}")


def said(excluded: tuple[Exclusion, ...]) -> tuple[str, ...]:
    """What is left out, as notes."""
    notes = []
    for one in excluded:
        in_file = f" of file {one.file + 1}" if one.file else ""
        what = f"{one.start:g}–{one.stop:g} s{in_file}" if one.start is not None else f"turn {one.turn}"
        what = what if one.rest is None else f"rest {one.rest}"
        notes.append(f"left out by {one.by}: {what}" + (f": {one.reason}" if one.reason else ""))
    return tuple(notes)
