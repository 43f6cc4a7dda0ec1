"""Where the operator is: the rests so far, how good the last one is, the positions they are, and the turn under way.

All of it follows from the blocks of the log and what is left out of it, so that a page that is started again says the
same.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np

from tumble.bench.chain import Blocks, MeanUncertainty
from tumble.bench.wishes import Wanted
from tumble.earth import EARTH_RATE
from tumble.programme.positions import Move, Position, Programme
from tumble.reduction.rests.matching import POSITION_LIMIT, SAME_ATTITUDE
from tumble.rotation import rotation_matrix, rotation_vector
from tumble.units import Array, BoolArray

CALM_BLOCKS = 5
"""Half a second without movement is a rest that begins."""
_LOOKED_AT = 256
BIAS_LIMIT = 0.15
SHORTEST_REST = 4.0
KNOWN_SECONDS = 300.0
"""For how long gyros of 0.01 °/s carry an attitude to 3°, which is about what a picture shows."""
OPPOSITE = 0.01
"""Sine of the angle between two verticals that are opposite: the way from one to the other is none in particular."""
NOTHING_MORE = 0.93
"""Where twice the time leaves more than this of u, longer gives nothing."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class StillLimits:
    """What decides whether a block is calm: scatter of the specific force, m/s², and distance of the rate from its
    `level` (3,) at rest, rad/s; the level is None while no rest is known."""

    scatter: float
    rate: float | None
    level: Array | None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rest:
    """A rest: its blocks, its times, s, the mean specific force (3,) and rate (3,)."""

    first: int
    last: int
    start: float
    stop: float
    force: Array
    rate: Array | None

    @property
    def vertical(self) -> Array:
        """Direction of the mean specific force in the body."""
        return np.asarray(self.force / np.linalg.norm(self.force))


@dataclass(frozen=True, kw_only=True, slots=True)
class Judged:
    """A rest as it is now: how well it is known, s that are left to the wanted u, whether it is `enough`, and whether
    longer would give nothing."""

    known: MeanUncertainty | None
    left: float | None
    enough: bool
    nothing_more: bool


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Progress:
    """How far the operator is: the rests by position, `groups`, the last of which `lasts` or has been left; the block
    from which on nothing moves, None where something does; how good the last two rests of the last position are."""

    blocks: Blocks
    limits: StillLimits
    calm_from: int | None
    groups: list[list[Rest]]
    lasts: bool
    judged: tuple[Judged, ...]

    @property
    def now(self) -> float:
        """The time of the last block, s."""
        return float(self.blocks.edges[-1])

    @property
    def current(self) -> Rest | None:
        """The rest that lasts, None while there is none."""
        return self.groups[-1][-1] if self.lasts else None


def judged(known: MeanUncertainty | None, seconds: float, wanted: Wanted) -> Judged:
    """How good a rest of so many seconds is."""
    if known is None:
        return Judged(known=None, left=None, enough=False, nothing_more=False)
    over = known.accel / wanted.accel
    if known.gyro is not None:
        over = max(over, known.gyro / wanted.gyro)
    left = max(seconds * (over**2 - 1.0), SHORTEST_REST - seconds, 0.0)
    flat = known.twice > NOTHING_MORE and seconds > 10.0
    return Judged(known=known, left=left, enough=left <= 0.0 or flat, nothing_more=flat)


def rest_of(blocks: Blocks, first: int, last: int) -> Rest:
    """The rest of blocks first … last − 1."""
    return Rest(
        first=first,
        last=last,
        start=float(blocks.edges[first]),
        stop=float(blocks.edges[last]),
        force=blocks.force[first:last].mean(axis=0),
        rate=None if blocks.rate is None else blocks.rate[first:last].mean(axis=0),
    )


def scatter_now(blocks: Blocks) -> float:
    """Scatter of the specific force, m/s², over the last second."""
    return float(np.sqrt(blocks.force[-10:].var(axis=0).sum()))


def calm_since(blocks: Blocks, limits: StillLimits, calm_from: int = 0, calm_to: int = 0) -> int | None:
    """The block from which on nothing moves, None if something does now. CALM_BLOCKS are looked at together; of those
    between `calm_from` and `calm_to` it is known that nothing moves in them."""
    last = len(blocks)
    unseen = max(calm_from, calm_to - CALM_BLOCKS + 1)
    first = last
    while first > unseen:
        start = max(unseen, first - _LOOKED_AT)
        moving = np.flatnonzero(~_calm(blocks, start, min(first + CALM_BLOCKS - 1, last), limits))
        first = start
        if len(moving):
            calm_from = start + int(moving[-1]) + 1
            break
    return calm_from if last - calm_from >= CALM_BLOCKS else None


def _calm(blocks: Blocks, start: int, stop: int, limits: StillLimits) -> BoolArray:
    """Whether each CALM_BLOCKS in a row of blocks start … stop − 1 are calm."""
    if stop - start < CALM_BLOCKS:
        return np.empty(0, dtype=bool)
    calm = np.sqrt(_windows(blocks.force[start:stop]).var(axis=-1).sum(axis=-1)) <= limits.scatter
    if blocks.rate is None or limits.rate is None or limits.level is None:
        return np.asarray(calm)
    wide = limits.rate + 2.0 * EARTH_RATE
    off = _windows(blocks.rate[start:stop]).mean(axis=-1) - limits.level
    return np.asarray(calm & (np.linalg.norm(off, axis=-1) < 1.5 * wide))


def _windows(series: Array) -> Array:
    return np.lib.stride_tricks.sliding_window_view(series, CALM_BLOCKS, axis=0)


def turned_between(blocks: Blocks, first: int, last: int, level: Array | None) -> Array | None:
    """Sum of the gyro increments (3,) over blocks first … last − 1, rad, less the rate at rest; None without gyros."""
    if blocks.rate is None or level is None:
        return None
    seconds = np.diff(blocks.edges[first : last + 1])[:, None]
    return np.asarray(((blocks.rate[first:last] - level) * seconds).sum(axis=0))


def grouped(blocks: Blocks, rests: list[Rest]) -> list[list[Rest]]:
    """Rests without a turn between them together: one position. Without gyros, those of one vertical."""
    groups: list[list[Rest]] = []
    for rest in rests:
        if groups and _still(blocks, groups[-1][-1], rest):
            groups[-1].append(rest)
        else:
            groups.append([rest])
    return groups


def _still(blocks: Blocks, before: Rest, after: Rest) -> bool:
    if float(np.arccos(np.clip(before.vertical @ after.vertical, -1.0, 1.0))) >= SAME_ATTITUDE:
        return False
    if blocks.rate is None or before.rate is None or after.rate is None:
        return True
    between = slice(before.last, after.first)
    seconds = np.diff(blocks.edges[before.last : after.first + 1])[:, None]
    turns = rotation_matrix((blocks.rate[between] - 0.5 * (before.rate + after.rate)) * seconds)
    back = reduce(np.matmul, turns, np.eye(3))
    return float(np.linalg.norm(rotation_vector(back))) < SAME_ATTITUDE


def verticals(rests: list[Rest], programme: Programme, gravity: float) -> Array:
    """Verticals (N, 3) in the body, freed from bias by the median difference from the nearest positions."""
    forces = np.array([rest.force for rest in rests]).reshape(-1, 3)
    expected = np.array([position.vertical_b for position in programme.positions])
    unit = forces / np.linalg.norm(forces, axis=1, keepdims=True)
    bias = np.median(forces - gravity * expected[np.argmax(unit @ expected.T, axis=1)], axis=0)
    free = forces - bias if len(rests) > 2 and np.linalg.norm(bias) < BIAS_LIMIT * gravity else forces
    return np.asarray(free / np.linalg.norm(free, axis=1, keepdims=True))


def attitude_now(programme: Programme, progress: Progress, index: int, at: int) -> Array | None:
    """Body → geographic (3, 3) now, of a unit that is to be in position `index` of a programme, its `at`-th, from 0:
    from the position before by what the gyros read since. In any order, without gyros, or long after it, the attitude
    nearest to that position with the vertical as it is read; None where that is none."""
    blocks, groups, wanted = progress.blocks, progress.groups, programme.positions[index].matrix
    before = groups[at - 1][-1] if 0 < at <= len(groups) else None
    if programme.ordered and index and before is not None and before.rate is not None and blocks.rate is not None:
        since = slice(before.last, len(blocks))
        seconds = np.diff(blocks.edges[since.start : since.stop + 1])[:, None]
        if seconds.sum() < KNOWN_SECONDS:
            turns = rotation_matrix((blocks.rate[since] - before.rate) * seconds)
            return np.asarray(reduce(np.matmul, turns, programme.positions[index - 1].matrix))
    vertical = blocks.force[-CALM_BLOCKS:].mean(axis=0)
    vertical = vertical / np.linalg.norm(vertical)
    across = np.cross(vertical, expected := programme.positions[index].vertical_b)
    sine = float(np.linalg.norm(across))
    if sine < OPPOSITE and vertical @ expected < 0.0:
        return None
    angle = float(np.arctan2(sine, vertical @ expected))
    return np.asarray(wanted @ rotation_matrix(angle * across / max(sine, OPPOSITE)))


def against(move: Move, before: Position, turned: Array) -> float:
    """How far, rad, a turn under way has gone against its sense; 0 where it goes the right way."""
    if move.axis is None or move.angle is None:
        return 0.0
    return max(0.0, -float(turned @ (before.matrix.T @ move.axis)) * float(np.sign(move.angle)))


def nearest_positions(programme: Programme, units: Array) -> list[int | None]:
    """Which position of a programme in any order each vertical (N, 3) is; None where it is none."""
    expected = np.array([position.vertical_b for position in programme.positions])
    cosines = units @ expected.T
    nearest = np.argmax(cosines, axis=1)
    return [
        int(k) if cosine >= np.cos(POSITION_LIMIT) else None
        for k, cosine in zip(nearest, cosines.max(axis=1), strict=True)
    ]
