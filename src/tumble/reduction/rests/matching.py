"""The rests of a log matched to the positions of a programme, without what a session excludes.

Verticals are compared, freed from bias by the median difference, and for programmes in order also the turns as the
gyros saw them. Rests that follow each other without a turn between them are one position. Without gyros, successive
rests with one vertical are the successive positions that have it; in a programme in any order they are one position. A
rest that cannot be the position of the programme, a missing or a surplus one, is a `ProgrammeError` that names it.

Times that [[exclude]] of session.toml excludes are removed from the rests before: the longest part of a rest remains,
if it is long enough. Rests and turns that are excluded by number have the numbers of the results, and are removed after
the matching, so that such a rest of a programme is not missing.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby

import numpy as np

from tumble.errors import ProgrammeError, SessionError
from tumble.programme.positions import Programme
from tumble.recording.session import Exclusion, ProgrammeSpec, Session
from tumble.reduction.blocks.reducer import BLOCK_SECONDS, FileBlocks, Reduction
from tumble.reduction.rests.segmentation import Segmentation, Stretch, gap_between
from tumble.rotation import onto_body, unit_vector
from tumble.sensors.model import Block
from tumble.units import DEGREE, Array, IntArray

POSITION_LIMIT = 7.0 * DEGREE
"""How far a vertical may be from the programme's: table and mounting errors of up to 5° each, and bias."""

BIAS_LIMIT = 0.15  # of g: beyond, the difference is the programme, not the sensors
TURN_LIMIT = 25.0 * DEGREE
SAME_ATTITUDE = 2.0 * DEGREE
SHORTEST_STATED = 1.0
"""s: below, a rest has too few blocks for the noise of its mean."""


def match_rests(session: Session, reduction: Reduction, segmentation: Segmentation) -> Segmentation:
    """The rests to use: all that were found where no programme is given, else those of the programme's positions.

    Raises
    ------
    ProgrammeError
        If the recording does not go through the programme.
    """
    spec = session.programme
    if spec is None:
        return segmentation
    listed = spec.listed
    rests = _with_stated(listed, reduction, segmentation.rests, spec)
    segmentation = replace(segmentation, rests=rests, programme=listed, position=np.empty(0, dtype=np.int64))
    if not rests:
        return segmentation
    by_file = reduction.by_file
    means = np.array([by_file[s.file].accel.mean(s.first, s.last) for s in rests])
    readings = means @ onto_body(session.log.accel.axes).T
    expected = np.array([p.vertical_b for p in listed.positions])
    verticals = bias_free_verticals(readings, expected, session.site.gravity)
    off = np.arccos(np.clip(expected @ verticals.T, -1.0, 1.0))
    why_missing = (
        f"was it skipped or shorter than {segmentation.tuning.still} s? "
        + "".join(f"{sentence}; " for sentence in segmentation.passed_over())
        + "`tumble inspect` shows what was found and rejected"
    )
    if not listed.ordered:
        return replace(segmentation, position=_any_order(listed, rests, verticals, off, why_missing))
    if session.log.gyro is None:
        groups = _groups_by_vertical(expected, verticals)
    else:
        groups = [[0]]  # those without a turn between them together
        for i in range(1, len(rests)):
            turned = _rotation_between(session, reduction, rests[i - 1], rests[i])
            if turned is not None and float(np.linalg.norm(turned)) < SAME_ATTITUDE:
                groups[-1].append(i)
            else:
                groups.append([i])
    first = [group[0] for group in groups]
    _check_order(listed, [rests[i] for i in first], verticals[first], off[:, first], why_missing)
    _check_turns(session, reduction, listed, rests, groups)
    position = np.array([next(k for k, group in enumerate(groups) if i in group) for i in range(len(rests))])
    return replace(segmentation, position=position)


def _with_stated(
    listed: Programme, reduction: Reduction, found: tuple[Stretch, ...], spec: ProgrammeSpec
) -> tuple[Stretch, ...]:
    """The rests that were found, those replaced whose times a position of the programme states. Stated times are in the
    first file, and long enough for the noise of a mean."""
    file, stated = reduction.files[0], []
    for k, p in enumerate(spec.position or ()):
        if p.start is None or p.stop is None:
            continue
        if p.start < file.edges[0] - BLOCK_SECONDS or p.stop > file.edges[-1] + BLOCK_SECONDS:
            raise ProgrammeError(
                f"programme {listed.name}, {_named(listed, k)}: expected start and stop within the log, "
                f"{file.edges[0]:.1f}–{file.edges[-1]:.1f} s, found {p.start:g}–{p.stop:g} s"
            )
        if p.stop - p.start < SHORTEST_STATED:
            raise ProgrammeError(
                f"programme {listed.name}, {_named(listed, k)}: expected a rest of at least {SHORTEST_STATED:g} s, "
                f"found start {p.start:g} s and stop {p.stop:g} s"
            )
        stated.append(Stretch.between(file, p.start, p.stop))
    kept = [s for s in found if not any(s.file == t.file and s.start < t.stop and t.start < s.stop for t in stated)]
    return tuple(sorted([*kept, *stated], key=lambda s: (s.file, s.start)))


def _rotation_between(session: Session, reduction: Reduction, before: Stretch, after: Stretch) -> Array | None:
    """Sum of the gyro increments (3,) between two rests, rad, without the rate at rest: the rotation vector of a turn
    about one axis. None where there are no gyros, or another file."""
    blocks = reduction.by_file[before.file]
    if session.log.gyro is None or before.file != after.file:
        return None
    level = 0.5 * (blocks.gyro.mean(before.first, before.last) + blocks.gyro.mean(after.first, after.last))
    between = slice(before.last, after.first)
    turned = ((blocks.gyro.means[between] - level) * np.diff(blocks.edges)[between, None]).sum(axis=0)
    return np.asarray(onto_body(session.log.gyro.axes) @ turned)


def _groups_by_vertical(expected: Array, verticals: Array) -> list[list[int]]:
    """Indices of rests by position, without gyros. A turn about the vertical hardly shows, so that successive rests
    with one vertical belong to all successive positions that have it."""
    same = np.argmax(expected @ expected.T > 1.0 - 1e-9, axis=1)
    nearest = same[np.argmax(verticals @ expected.T, axis=1)]
    lengths: dict[int, list[int]] = {}
    for vertical, run in groupby(same.tolist()):
        lengths.setdefault(vertical, []).append(len(list(run)))
    groups: list[list[int]] = []
    for vertical, members in groupby(range(len(verticals)), key=nearest.tolist().__getitem__):
        rests, runs = list(members), lengths[vertical]
        positions = runs.pop(0) if len(runs) > 1 else runs[0]
        parts = np.array_split(rests, positions) if len(rests) >= positions else [np.array(rests)] * positions
        groups += [part.tolist() for part in parts]
    return groups


def bias_free_verticals(readings: Array, expected: Array, gravity: float) -> Array:
    """Directions of the vertical in the body (N, 3), freed from bias by the median difference from the nearest expected
    ones. With one or two readings nothing is subtracted: the difference may be an error of the attitude."""
    bias = np.median(readings - gravity * expected[np.argmax(unit_vector(readings) @ expected.T, axis=1)], axis=0)
    plausible = len(readings) > 2 and np.linalg.norm(bias) < BIAS_LIMIT * gravity
    return unit_vector(readings - bias if plausible else readings)


def _named(listed: Programme, k: int) -> str:
    position = listed.positions[k]
    return f"position {k + 1} of {len(listed.positions)} ({position.attitude!r}, {position.label})"


def _seen(vertical: Array) -> str:
    return "(" + ", ".join(f"{v:+.2f}" for v in vertical) + ")"


def _check_order(listed: Programme, rests: list[Stretch], verticals: Array, off: Array, why_missing: str) -> None:
    """Raise ProgrammeError unless every position has its rest, in order. off[k, j], rad, is the angle between the
    verticals of position k and rest j."""
    expected = len(listed.positions)
    if len(rests) == expected:
        for k, (rest, vertical) in enumerate(zip(rests, verticals, strict=True)):
            if off[k, k] > POSITION_LIMIT:
                others = np.flatnonzero(off[:, k] <= POSITION_LIMIT).tolist()
                like = f", which is that of {_named(listed, others[0])}" if others else ""
                raise ProgrammeError(
                    f"programme {listed.name}, {_named(listed, k)}: expected the vertical "
                    f"{_seen(listed.positions[k].vertical_b)} in the body, found {_seen(vertical)} at "
                    f"{rest.start:.1f}–{rest.stop:.1f} s, {off[k, k] / DEGREE:.1f}° off{like}; at most "
                    f"{POSITION_LIMIT / DEGREE:.0f}° can be the same position"
                )
        return
    # positions without a rest and rests without a position, by the alignment of both lists that leaves the fewest
    i, j = off.shape
    cost = np.where(off <= POSITION_LIMIT, off, np.inf)
    total = np.add.outer(np.arange(i + 1.0), np.arange(j + 1.0))
    for k, m in np.ndindex(i, j):
        total[k + 1, m + 1] = min(total[k, m] + cost[k, m], total[k, m + 1] + 1.0, total[k + 1, m] + 1.0)
    missing, surplus = list[int](), list[int]()
    while i or j:
        if i and j and total[i, j] == total[i - 1, j - 1] + cost[i - 1, j - 1]:
            i, j = i - 1, j - 1
        elif i and total[i, j] == total[i - 1, j] + 1.0:
            i -= 1
            missing.insert(0, i)
        else:
            j -= 1
            surplus.insert(0, j)
    counted = f"programme {listed.name}: expected {expected} rests, found {len(rests)}"
    if missing:
        raise ProgrammeError(f"{counted}; no rest for {_named(listed, missing[0])}: {why_missing}")
    rest = rests[surplus[0]]
    raise ProgrammeError(
        f"{counted}; the rest at {rest.start:.1f}–{rest.stop:.1f} s with the vertical {_seen(verticals[surplus[0]])} "
        "in the body is surplus: list the positions as they were taken under [[programme.position]]"
    )


def _check_turns(
    session: Session, reduction: Reduction, listed: Programme, rests: tuple[Stretch, ...], groups: list[list[int]]
) -> None:
    """Raise ProgrammeError unless the gyros saw the turns of the programme, in their directions."""
    for k, move in enumerate(listed.moves):
        before, after = rests[groups[k][-1]], rests[groups[k + 1][0]]
        turned = _rotation_between(session, reduction, before, after)
        if move.axis is None or move.angle is None or turned is None:
            continue
        axis_b = listed.positions[k].matrix.T @ move.axis
        if np.linalg.norm(turned - move.angle * axis_b) > TURN_LIMIT:
            across = float(np.linalg.norm(turned - axis_b * (turned @ axis_b)))
            raise ProgrammeError(
                f"programme {listed.name}, turn from {_named(listed, k)} to {_named(listed, k + 1)}: expected "
                f"{move.angle / DEGREE:+.0f}° about body {_seen(axis_b)}, the gyros saw "
                f"{float(turned @ axis_b) / DEGREE:+.0f}° about it and {across / DEGREE:.0f}° across "
                f"it ({before.stop:.1f}–{after.start:.1f} s); check the direction of the turn, the unit and the "
                "signs of the gyros"
            )


def _any_order(
    listed: Programme, rests: tuple[Stretch, ...], verticals: Array, off: Array, why_missing: str
) -> IntArray:
    """The position (N,) of every rest. Every position has to have one, once: successive rests in it, as of a cube that
    is turned on its face, count as one."""
    nearest = np.argmin(off, axis=0)
    for j, rest in enumerate(rests):
        k = int(nearest[j])
        if off[k, j] > POSITION_LIMIT:
            raise ProgrammeError(
                f"programme {listed.name}: the rest at {rest.start:.1f}–{rest.stop:.1f} s is in none of the "
                f"{len(listed.positions)} positions; expected the vertical {_seen(listed.positions[k].vertical_b)} in "
                f"the body as in the nearest, {_named(listed, k)}, found {_seen(verticals[j])}, "
                f"{off[k, j] / DEGREE:.1f}° off; at most {POSITION_LIMIT / DEGREE:.0f}° can be the same position"
            )
    taken: dict[int, list[Stretch]] = {}
    for k, members in groupby(range(len(rests)), key=nearest.tolist().__getitem__):
        taken.setdefault(k, []).append(rests[next(members)])
    missing = [_named(listed, k) for k in range(len(listed.positions)) if k not in taken]
    doubled = [
        f"{_named(listed, k)} was taken {len(times)} times, at {' s, '.join(f'{rest.start:.1f}' for rest in times)} s"
        for k, times in taken.items()
        if len(times) > 1
    ]
    count = f"programme {listed.name}: expected {len(listed.positions)} positions, each once, found {len(taken)}"
    if missing:
        also = f"; {doubled[0]}" if doubled else ""
        raise ProgrammeError(f"{count}; no rest for {' and '.join(missing)}{also}: {why_missing}")
    if doubled:
        raise ProgrammeError(
            f"{count}; {doubled[0]}: one of these rests is surplus; cut it from the log, or leave [programme] out to "
            "use every rest as it is found"
        )
    return np.asarray(nearest)


# What a session excludes


def without_times(reduction: Reduction, found: Segmentation, excluded: tuple[Exclusion, ...]) -> Segmentation:
    """The rests of a log without excluded stretches of time; the longest part of a rest remains."""
    rests = list(found.rests)
    for one in excluded:
        if one.start is not None and one.stop is not None:
            parts = [_longest(reduction, span, (one.file or 1) - 1, one.start, one.stop) for span in rests]
            rests = [span for span in parts if span is not None]
    return replace(found, rests=tuple(rests))


def _longest(reduction: Reduction, span: Stretch, file: int, start: float, stop: float) -> Stretch | None:
    """The longer part of a rest before or after a stretch of time. None where neither is long enough."""
    if span.file != file or start >= span.stop or stop <= span.start:
        return span
    edges = reduction.by_file[file].edges
    before = span.first, min(span.last, int(np.searchsorted(edges, start + 1e-9, side="right")) - 1)
    after = max(span.first, int(np.searchsorted(edges, stop - 1e-9))), span.last
    first, last = max(before, after, key=lambda part: part[1] - part[0])
    if last <= first or edges[last] - edges[first] < reduction.tuning.rest:
        return None
    reaches_end = span.reaches_end and last == span.last
    return replace(
        span, first=first, last=last, start=float(edges[first]), stop=float(edges[last]), reaches_end=reaches_end
    )


def without_numbered(
    reduction: Reduction, found: Segmentation, excluded: tuple[Exclusion, ...]
) -> tuple[Reduction, Segmentation]:
    """Exclude turns and rests by their numbers: the reduction has the excluded turns as gaps, the segmentation has no
    excluded rests. Raises SessionError for a number beyond the last."""
    counts, numbers = {"turn": len(found.rests) - 1, "rest": len(found.rests)}, dict[str, list[int]]()
    for what, count in counts.items():
        stated = [(one.by, getattr(one, what)) for one in excluded if getattr(one, what) is not None]
        for by, number in stated:
            if number > count:
                where = "without" if by == "request" else f"session.toml: exclude.{what}"
                raise SessionError(f"{where}: expected a {what} from 1 to {count}, found {number}")
        numbers[what] = [number for _, number in stated]
    ends = [found.rests[turn - 1 : turn + 1] for turn in numbers["turn"]]
    gaps = [
        gap_between(before, after, 1, "left out", why="") for before, after in ends
    ]  # the note is `exclusion_notes`
    reduction = replace(reduction, gaps=(*reduction.gaps, *gaps)) if gaps else reduction
    if not numbers["rest"]:
        return reduction, found
    kept = [i for i in range(len(found.rests)) if i + 1 not in numbers["rest"]]
    position = None if found.position is None else found.position[kept]
    return reduction, replace(found, rests=tuple(found.rests[i] for i in kept), position=position)


def without_jump(reduction: Reduction, found: Segmentation, gyro: Block | None) -> Reduction:
    """A reduction without the jump of the biases of the gyros: it is subtracted from all that follows, and the turn in
    which they jump is a gap."""
    rests, jump = found.rests, found.jump
    before = 0 if jump is None else sum((rest.file, rest.start) < (jump.file, jump.time) for rest in rests)
    if jump is None or gyro is None or not 0 < before < len(rests):
        return reduction
    last, first = rests[before - 1 : before + 1]
    step, files = gyro.axes @ jump.step, list[FileBlocks]()
    for file in reduction.files:
        series, since = file.gyro, first.first if file.file == first.file else 0
        if file.file >= first.file:
            later = np.arange(len(file))[:, None] >= since
            tail = series.tail_total - series.tail_weight * step
            means, ends = series.means - later * step, series.ends - later * step
            series = replace(series, means=means, ends=ends, tail_total=tail)
        files.append(replace(file, gyro=series))
    samples, gaps = reduction.samples, reduction.gaps
    if samples is not None:
        samples = samples.less(reduction.by_file[first.file].sample_at(first.first), jump.step)
    if last.file == first.file:
        gaps = (*gaps, gap_between(last, first, 1, "left out", why=""))
    return replace(reduction, files=tuple(files), samples=samples, gaps=gaps)


def exclusion_notes(excluded: tuple[Exclusion, ...]) -> tuple[str, ...]:
    """Notes on what a session excludes."""
    notes = []
    for one in excluded:
        in_file = f" of file {one.file}" if (one.file or 1) > 1 else ""
        what = f"{one.start:g}–{one.stop:g} s{in_file}" if one.start is not None else f"turn {one.turn}"
        what = what if one.rest is None else f"rest {one.rest}"
        notes.append(f"left out by {one.by}: {what}" + (f": {one.reason}" if one.reason else ""))
    return tuple(notes)
