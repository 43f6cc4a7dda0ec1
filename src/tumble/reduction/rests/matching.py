"""Rests found in a log, matched to the positions of a programme.

Verticals are compared (bias taken off by the median difference), for programmes in order also the turns as the
gyros saw them. Rests that follow each other without a turn between them are one position; without gyros, rests in a
row with one vertical are the positions in a row that have it; in a programme in any order rests in a row with one
vertical are one position. A rest that cannot be the programme's position, a
missing or a surplus one, is a `ProgrammeError` that names the position.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

import numpy as np

from tumble.errors import ProgrammeError
from tumble.programme.positions import Position, Programme, from_attitudes, programme
from tumble.recording.session import ProgrammeSpec, Session
from tumble.reduction.blocks.reducer import BLOCK_SECONDS, FileBlocks, Reduction
from tumble.reduction.rests.segmentation import RestSpan, Segmentation
from tumble.units import DEGREE, Array, IntArray

POSITION_LIMIT = 7.0 * DEGREE
"""How far a vertical may be from the programme's: table and mounting errors of up to 5° each, and bias."""

BIAS_LIMIT = 0.15  # of g: beyond, the difference is the programme, not the sensors
TURN_LIMIT = 25.0 * DEGREE
SAME_ATTITUDE = 2.0 * DEGREE
SHORTEST_STATED = 1.0
"""s: below, a rest has too few blocks for the noise of its mean."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Match:
    """The rests to use, and where there is a programme, it and the index of each rest's position in it (N,)."""

    rests: tuple[RestSpan, ...]
    programme: Programme | None
    position: IntArray | None


def match_rests(session: Session, reduction: Reduction, segmentation: Segmentation) -> Match:
    """The rests to use: all that were found where no programme is given, else those of the programme's positions."""
    spec = session.programme
    if spec is None:
        return Match(rests=segmentation.rests, programme=None, position=None)
    listed = programme(spec.name) if spec.name is not None else from_attitudes([p.attitude for p in spec.positions])
    _check_stated(listed, reduction.files[0], spec)
    rests = _with_stated(reduction, segmentation.rests, spec)
    if not rests:
        return Match(rests=(), programme=listed, position=np.empty(0, dtype=np.int64))
    by_file = reduction.by_file
    means = np.array([by_file[s.file].accel.mean(s.first, s.last) for s in rests])
    readings = means @ np.linalg.pinv(session.log.accel.axes).T
    verticals = _verticals(readings, listed, session.site.gravity)
    why_missing = (
        f"was it skipped or shorter than {segmentation.tuning.still} s? "
        + "".join(f"{sentence}; " for sentence in segmentation.passed_over())
        + "`tumble inspect` shows what was found and rejected"
    )
    if not listed.ordered:
        return Match(rests=rests, programme=listed, position=_any_order(listed, rests, verticals, why_missing))
    seen = session.log.gyro is not None
    groups = _groups(session, reduction, rests) if seen else _groups_by_vertical(listed, verticals)
    first = [group[0] for group in groups]
    _check_order(listed, [rests[i] for i in first], verticals[first], why_missing)
    _check_turns(session, reduction, listed, rests, groups)
    position = np.array([next(k for k, group in enumerate(groups) if i in group) for i in range(len(rests))])
    return Match(rests=rests, programme=listed, position=position)


def _check_stated(listed: Programme, file: FileBlocks, spec: ProgrammeSpec) -> None:
    """Stated rests are in the (first) file, and long enough to have a mean."""
    for k, p in enumerate(spec.positions):
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


def _with_stated(reduction: Reduction, found: tuple[RestSpan, ...], spec: ProgrammeSpec) -> tuple[RestSpan, ...]:
    """Rests found, with those that a position states by its times in their place."""
    stated = [
        RestSpan.between(reduction.files[0], p.start, p.stop)
        for p in spec.positions
        if p.start is not None and p.stop is not None
    ]
    kept = [s for s in found if not any(s.file == t.file and s.start < t.stop and t.start < s.stop for t in stated)]
    return tuple(sorted([*kept, *stated], key=lambda s: (s.file, s.start)))


def _rotation_between(session: Session, reduction: Reduction, before: RestSpan, after: RestSpan) -> Array | None:
    """Sum of the gyro increments (3,) between two rests, rad, less the rate at rest; None where no gyro saw it. For a
    turn about one axis it is the rotation vector."""
    blocks = reduction.by_file[before.file]
    if session.log.gyro is None or before.file != after.file:
        return None
    level = 0.5 * (blocks.gyro.mean(before.first, before.last) + blocks.gyro.mean(after.first, after.last))
    between = slice(before.last, after.first)
    seconds = np.diff(blocks.edges)[between, None]
    turned = ((blocks.gyro.means[between] - level) * seconds).sum(axis=0)
    return np.asarray(np.linalg.pinv(session.log.gyro.axes) @ turned)


def _groups(session: Session, reduction: Reduction, rests: tuple[RestSpan, ...]) -> list[list[int]]:
    """Indices of rests, those without a turn between them together."""
    groups = [[0]]
    for i in range(1, len(rests)):
        turned = _rotation_between(session, reduction, rests[i - 1], rests[i])
        still = turned is not None and float(np.linalg.norm(turned)) < SAME_ATTITUDE
        if still:
            groups[-1].append(i)
        else:
            groups.append([i])
    return groups


def _groups_by_vertical(listed: Programme, verticals: Array) -> list[list[int]]:
    """Indices of rests by position where no gyro sees the turns between them: a turn about the vertical hardly shows,
    so that rests in a row with one vertical belong to all positions in a row that have it."""
    expected = np.array([p.vertical_b for p in listed.positions])
    same = np.argmax(expected @ expected.T > 1.0 - 1e-9, axis=1)
    nearest = same[np.argmax(verticals @ expected.T, axis=1)]
    lengths: dict[int, list[int]] = {}
    for vertical, run in groupby(same.tolist()):
        lengths.setdefault(vertical, []).append(len(list(run)))
    groups: list[list[int]] = []
    for vertical, members in groupby(range(len(verticals)), key=nearest.tolist().__getitem__):
        rests, left = list(members), lengths[vertical]
        positions = left.pop(0) if len(left) > 1 else left[0]
        parts = np.array_split(rests, positions) if len(rests) >= positions else [np.array(rests)] * positions
        groups += [part.tolist() for part in parts]
    return groups


def _verticals(readings: Array, listed: Programme, gravity: float) -> Array:
    """Directions of the vertical in the body (N, 3), freed from bias by the median difference from the nearest
    position of the programme."""
    expected = np.array([p.vertical_b for p in listed.positions])
    unit = readings / np.linalg.norm(readings, axis=1, keepdims=True)
    nearest = expected[np.argmax(unit @ expected.T, axis=1)]
    bias = np.median(readings - gravity * nearest, axis=0)
    free = readings - bias if np.linalg.norm(bias) < BIAS_LIMIT * gravity else readings
    return np.asarray(free / np.linalg.norm(free, axis=1, keepdims=True))


def _off(vertical: Array, position: Position) -> float:
    """Angle, rad, between a vertical and a position's."""
    return float(np.arccos(np.clip(vertical @ position.vertical_b, -1.0, 1.0)))


def _named(listed: Programme, k: int) -> str:
    position = listed.positions[k]
    return f"position {k + 1} of {len(listed.positions)} ({position.attitude!r}, {position.label})"


def _seen(vertical: Array) -> str:
    return "(" + ", ".join(f"{v:+.2f}" for v in vertical) + ")"


def _check_order(listed: Programme, rests: list[RestSpan], verticals: Array, why_missing: str) -> None:
    """Every position has its rest, in order."""
    expected = len(listed.positions)
    if len(rests) == expected:
        for k, (rest, vertical) in enumerate(zip(rests, verticals, strict=True)):
            off = _off(vertical, listed.positions[k])
            if off > POSITION_LIMIT:
                others = [j for j, p in enumerate(listed.positions) if _off(vertical, p) <= POSITION_LIMIT]
                like = f", which is that of {_named(listed, others[0])}" if others else ""
                raise ProgrammeError(
                    f"programme {listed.name}, {_named(listed, k)}: expected the vertical "
                    f"{_seen(listed.positions[k].vertical_b)} in the body, found {_seen(vertical)} at "
                    f"{rest.start:.1f}–{rest.stop:.1f} s, {off / DEGREE:.1f}° off{like}; at most "
                    f"{POSITION_LIMIT / DEGREE:.0f}° can be the same position"
                )
        return
    missing, surplus = _alignment(listed, verticals)
    counted = f"programme {listed.name}: expected {expected} rests, found {len(rests)}"
    if missing:
        raise ProgrammeError(f"{counted}; no rest for {_named(listed, missing[0])}: {why_missing}")
    rest = rests[surplus[0]]
    raise ProgrammeError(
        f"{counted}; the rest at {rest.start:.1f}–{rest.stop:.1f} s with the vertical {_seen(verticals[surplus[0]])} "
        "in the body is surplus: list the positions as they were taken under [[programme.position]]"
    )


def _alignment(listed: Programme, verticals: Array) -> tuple[list[int], list[int]]:
    """Positions without a rest and rests without a position, by the alignment of both lists that leaves the fewest."""
    n, m = len(listed.positions), len(verticals)
    off = np.array([[_off(v, p) for v in verticals] for p in listed.positions])
    cost = np.where(off <= POSITION_LIMIT, off, np.inf)
    total = np.full((n + 1, m + 1), np.inf)
    total[:, 0], total[0, :] = np.arange(n + 1.0), np.arange(m + 1.0)
    for i in range(1, n + 1):
        for j in range(1, m + 1):
            total[i, j] = min(total[i - 1, j - 1] + cost[i - 1, j - 1], total[i - 1, j] + 1.0, total[i, j - 1] + 1.0)
    missing: list[int] = []
    surplus: list[int] = []
    i, j = n, m
    while i or j:
        if i and j and total[i, j] == total[i - 1, j - 1] + cost[i - 1, j - 1]:
            i, j = i - 1, j - 1
        elif i and total[i, j] == total[i - 1, j] + 1.0:
            i -= 1
            missing.insert(0, i)
        else:
            j -= 1
            surplus.insert(0, j)
    return missing, surplus


def _check_turns(
    session: Session, reduction: Reduction, listed: Programme, rests: tuple[RestSpan, ...], groups: list[list[int]]
) -> None:
    """The gyros saw the programmed turns, about their axes and in their directions."""
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


def _any_order(listed: Programme, rests: tuple[RestSpan, ...], verticals: Array, why_missing: str) -> IntArray:
    """The position of every rest. Every position must have one, and once: rests that follow each other in it, as of a
    cube turned on its face, count as one."""
    off = np.array([[_off(v, p) for v in verticals] for p in listed.positions])
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
    taken: dict[int, list[RestSpan]] = {}
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
