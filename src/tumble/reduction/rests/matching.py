"""Matching of the rests of a log to the positions of a programme, and exclusions of a session.

Verticals are compared, freed from bias by the median difference, and for ordered programmes also the turns according to
the gyros. Consecutive rests without a turn between them are one position. Without gyros, consecutive rests with one
vertical are the consecutive positions that have it, or one position of a programme in any order. A missing or surplus
rest, or one that fits no position, raises a `ProgrammeError` that names it.

Times in [[exclude]] of session.toml are removed from the rests before matching: the longest part of a rest remains, if
it is long enough. Rests and turns excluded by number have the numbers of the results, and are removed after matching,
so that such a rest is not missing from a programme.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby, pairwise

import numpy as np

from tumble.errors import ProgrammeError, SessionError
from tumble.programme.positions import Programme
from tumble.recording.session import Exclusion, ProgrammeSpec, Session
from tumble.reduction.blocks.reducer import BLOCK_SECONDS, FileBlocks, Reduction
from tumble.reduction.rests.segmentation import Segmentation, Stretch, breaking_gap, gap_between
from tumble.rotation import onto_body, unit_vector
from tumble.sensors.model import Block
from tumble.units import DEGREE, Array, IntArray

POSITION_LIMIT = 7.0 * DEGREE  # of a vertical from that of its position: table and mounting up to 5° each, and bias
BIAS_LIMIT = 0.15  # g: a larger difference is due to the programme, not to the sensors
TURN_LIMIT = 25.0 * DEGREE  # of a turn from that of the programme
SAME_ATTITUDE = 2.0 * DEGREE  # turn between rests of one position
SHORTEST_STATED = 1.0  # s: a shorter rest has too few blocks for the noise of its mean


def match_rests(session: Session, reduction: Reduction, segmentation: Segmentation) -> Segmentation:
    """Assign the rests of a session's log to the positions of its programme, if it has one.

    Rests with stated times replace those found there. Raises ProgrammeError if the recording does not follow the
    programme."""
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
        f"was it skipped or shorter than {segmentation.tuning.rest_seconds} s? "
        + "".join(f"{sentence}; " for sentence in segmentation.passed_over())
        + "`tumble inspect` shows what was found and rejected"
    )
    if not listed.ordered:
        return replace(segmentation, position=_match_unordered(listed, rests, verticals, off, why_missing))
    if session.log.gyro is None:
        groups = _groups_by_vertical(expected, verticals)
    else:
        turns = [_rotation_between(session, reduction, *pair) for pair in pairwise(rests)]
        is_next = [turn is None or float(np.linalg.norm(turn)) >= SAME_ATTITUDE for turn in turns]
        groups = [x.tolist() for x in np.split(np.arange(len(rests)), np.flatnonzero(is_next) + 1)]
    first = [group[0] for group in groups]
    _check_order(listed, [rests[i] for i in first], verticals[first], off[:, first], why_missing)
    _check_turns(session, reduction, listed, rests, groups)
    position = np.array([next(k for k, group in enumerate(groups) if i in group) for i in range(len(rests))])
    return replace(segmentation, position=position)


def _with_stated(
    listed: Programme, reduction: Reduction, rests: tuple[Stretch, ...], spec: ProgrammeSpec
) -> tuple[Stretch, ...]:
    """Return the rests, replacing those whose times a position of the programme states, in the first file."""
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
    kept = [s for s in rests if not any(s.file == t.file and s.start < t.stop and t.start < s.stop for t in stated)]
    return tuple(sorted([*kept, *stated], key=lambda s: (s.file, s.start)))


def _rotation_between(session: Session, reduction: Reduction, before: Stretch, after: Stretch) -> Array | None:
    """Return the sum of the gyro increments (3,) between two rests, rad, less the rate at rest: the rotation vector of
    a turn about one axis. None without gyros, and for rests of different files."""
    blocks = reduction.by_file[before.file]
    if session.log.gyro is None or before.file != after.file:
        return None
    level = 0.5 * (blocks.gyro.mean(before.first, before.last) + blocks.gyro.mean(after.first, after.last))
    between = slice(before.last, after.first)
    turn = ((blocks.gyro.means[between] - level) * np.diff(blocks.edges)[between, None]).sum(axis=0)
    return np.asarray(onto_body(session.log.gyro.axes) @ turn)


def _groups_by_vertical(expected: Array, verticals: Array) -> list[list[int]]:
    """Return the indices of the rests of each position, without gyros.

    A turn about the vertical hardly shows, so that consecutive rests with one vertical are divided among the
    consecutive positions that have it."""
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
    """Return the verticals in the body (N, 3) of mean specific forces (N, 3), m/s², freed from accelerometer bias.

    The bias is the median difference from the nearest `expected` vertical (P, 3) times gravity. With one or two
    readings nothing is subtracted, since the difference may be an error of the attitude."""
    bias = np.median(readings - gravity * expected[np.argmax(unit_vector(readings) @ expected.T, axis=1)], axis=0)
    plausible = len(readings) > 2 and np.linalg.norm(bias) < BIAS_LIMIT * gravity
    return unit_vector(readings - bias if plausible else readings)


def _named(listed: Programme, k: int) -> str:
    position = listed.positions[k]
    return f"position {k + 1} of {len(listed.positions)} ({position.attitude!r}, {position.label})"


def _text(vertical: Array) -> str:
    return "(" + ", ".join(f"{v:+.2f}" for v in vertical) + ")"


def _check_order(listed: Programme, rests: list[Stretch], verticals: Array, off: Array, why_missing: str) -> None:
    """Raise ProgrammeError unless every position has its rest, in order; off[k, j], rad, is the angle between the
    verticals of position k and rest j."""
    expected = len(listed.positions)
    if len(rests) == expected:
        for k, (rest, vertical) in enumerate(zip(rests, verticals, strict=True)):
            if off[k, k] > POSITION_LIMIT:
                others = np.flatnonzero(off[:, k] <= POSITION_LIMIT).tolist()
                like = f", which is that of {_named(listed, others[0])}" if others else ""
                raise ProgrammeError(
                    f"programme {listed.name}, {_named(listed, k)}: expected the vertical "
                    f"{_text(listed.positions[k].vertical_b)} in the body, found {_text(vertical)} at "
                    f"{rest.start:.1f}–{rest.stop:.1f} s, {off[k, k] / DEGREE:.1f}° off{like}; at most "
                    f"{POSITION_LIMIT / DEGREE:.0f}° can be the same position"
                )
        return
    # alignment of both lists with the fewest positions without a rest and rests without a position
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
        f"{counted}; the rest at {rest.start:.1f}–{rest.stop:.1f} s with the vertical {_text(verticals[surplus[0]])} "
        "in the body is surplus: list the positions as they were taken under [[programme.position]]"
    )


def _check_turns(
    session: Session, reduction: Reduction, listed: Programme, rests: tuple[Stretch, ...], groups: list[list[int]]
) -> None:
    """Raise ProgrammeError unless the gyros measured the turns of the programme, in their directions."""
    for k, move in enumerate(listed.moves):
        before, after = rests[groups[k][-1]], rests[groups[k + 1][0]]
        if breaking_gap(before, after, reduction.gaps) is not None:
            continue
        turn = _rotation_between(session, reduction, before, after)
        if move.axis is None or move.angle is None or turn is None:
            continue
        axis_b = listed.positions[k].matrix.T @ move.axis
        if np.linalg.norm(turn - move.angle * axis_b) > TURN_LIMIT:
            across = float(np.linalg.norm(turn - axis_b * (turn @ axis_b)))
            raise ProgrammeError(
                f"programme {listed.name}, turn from {_named(listed, k)} to {_named(listed, k + 1)}: expected "
                f"{move.angle / DEGREE:+.0f}° about body {_text(axis_b)}, the gyros saw "
                f"{float(turn @ axis_b) / DEGREE:+.0f}° about it and {across / DEGREE:.0f}° across "
                f"it ({before.stop:.1f}–{after.start:.1f} s); check the direction of the turn, the unit and the "
                "signs of the gyros"
            )


def _match_unordered(
    listed: Programme, rests: tuple[Stretch, ...], verticals: Array, off: Array, why_missing: str
) -> IntArray:
    """Return the position of every rest (N,), and raise ProgrammeError unless every position was taken exactly once.

    Consecutive rests in a position, as of a cube that is turned on its face, count as one."""
    nearest = np.argmin(off, axis=0)
    for j, rest in enumerate(rests):
        k = int(nearest[j])
        if off[k, j] > POSITION_LIMIT:
            raise ProgrammeError(
                f"programme {listed.name}: the rest at {rest.start:.1f}–{rest.stop:.1f} s is in none of the "
                f"{len(listed.positions)} positions; expected the vertical {_text(listed.positions[k].vertical_b)} in "
                f"the body as in the nearest, {_named(listed, k)}, found {_text(verticals[j])}, "
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


def without_times(reduction: Reduction, segmentation: Segmentation, excluded: tuple[Exclusion, ...]) -> Segmentation:
    """Return the rests of a log without excluded times; the longest part of a rest remains."""
    rests = segmentation.rests
    for e in excluded:
        if e.start is not None and e.stop is not None:
            parts = (_longest_part(reduction, rest, (e.file or 1) - 1, e.start, e.stop) for rest in rests)
            rests = tuple(rest for rest in parts if rest is not None)
    return replace(segmentation, rests=rests)


def _longest_part(reduction: Reduction, rest: Stretch, file: int, start: float, stop: float) -> Stretch | None:
    """Return the longer part of a rest before or after a time span, None if both are too short."""
    if rest.file != file or start >= rest.stop or stop <= rest.start:
        return rest
    edges = reduction.by_file[file].edges
    before = rest.first, min(rest.last, int(np.searchsorted(edges, start + 1e-9, side="right")) - 1)
    after = max(rest.first, int(np.searchsorted(edges, stop - 1e-9))), rest.last
    first, last = max(before, after, key=lambda part: part[1] - part[0])
    if last <= first or edges[last] - edges[first] < reduction.tuning.rest:
        return None
    start, stop, reaches_end = float(edges[first]), float(edges[last]), rest.reaches_end and last == rest.last
    return replace(rest, first=first, last=last, start=start, stop=stop, reaches_end=reaches_end)


def without_numbered(
    reduction: Reduction, segmentation: Segmentation, excluded: tuple[Exclusion, ...]
) -> tuple[Reduction, Segmentation]:
    """Exclude rests and turns by number: excluded turns become gaps of the reduction, excluded rests are removed.

    Raises SessionError for a number beyond the last rest or turn."""
    rests, numbers = segmentation.rests, dict[str, list[int]]()
    for what, count in (("turn", len(rests) - 1), ("rest", len(rests))):
        stated = [(e.by, getattr(e, what)) for e in excluded if getattr(e, what) is not None]
        for by, number in stated:
            if number > count:
                where = "without" if by == "request" else f"session.toml: exclude.{what}"
                raise SessionError(f"{where}: expected a {what} from 1 to {count}, found {number}")
        numbers[what] = [number for _, number in stated]
    # `exclusion_notes` explains these gaps
    gaps = [gap_between(rests[k - 1], rests[k], 1, "left out", why="") for k in numbers["turn"]]
    reduction = replace(reduction, gaps=(*reduction.gaps, *gaps)) if gaps else reduction
    if not numbers["rest"]:
        return reduction, segmentation
    kept = [i for i in range(len(rests)) if i + 1 not in numbers["rest"]]
    position = None if segmentation.position is None else segmentation.position[kept]
    return reduction, replace(segmentation, rests=tuple(rests[i] for i in kept), position=position)


def without_jump(reduction: Reduction, segmentation: Segmentation, gyro: Block | None) -> Reduction:
    """Return a reduction without the jump of the gyro biases: it is subtracted from all later readings, and the turn in
    which it happens becomes a gap."""
    rests, jump, before = segmentation.rests, segmentation.jump, segmentation.rests_before_jump
    if jump is None or gyro is None or not before:
        return reduction
    last, first = rests[before - 1 : before + 1]
    step, files = gyro.axes @ jump, list[FileBlocks]()
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
        samples = samples.with_rate_subtracted(reduction.by_file[first.file].sample_at(first.first), jump)
    if last.file == first.file:
        gaps = (*gaps, gap_between(last, first, 1, "left out", why=""))
    return replace(reduction, files=tuple(files), samples=samples, gaps=gaps)


def exclusion_notes(excluded: tuple[Exclusion, ...]) -> tuple[str, ...]:
    """Return notes on what a session excludes."""
    notes = []
    for e in excluded:
        in_file = f" of file {e.file}" if (e.file or 1) > 1 else ""
        what = f"{e.start:g}–{e.stop:g} s{in_file}" if e.start is not None else f"turn {e.turn}"
        what = what if e.rest is None else f"rest {e.rest}"
        notes.append(f"left out by {e.by}: {what}" + (f": {e.reason}" if e.reason else ""))
    return tuple(notes)
