"""Where the operator is: the rests so far, the positions they are, the turn under way, and what is wrong with them.

Nothing is remembered but what the operator has answered: all else follows from the blocks of the log, so that a page
that is started again says the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np

from tumble.bench.chain import Blocks
from tumble.earth import EARTH_RATE
from tumble.programme.positions import Move, Position, Programme
from tumble.reduction.matching import POSITION_LIMIT, SAME_ATTITUDE, TURN_LIMIT
from tumble.rotation import rotation_matrix, rotation_vector
from tumble.units import DEGREE, G_STANDARD, Array, BoolArray

CALM_BLOCKS = 5
"""Half a second without movement is a rest that begins."""
_LOOKED_AT = 256
WRONG_WAY = 30.0 * DEGREE
"""A turn that has gone so far against its sense is wrong, before it ends."""
BIAS_LIMIT = 0.15
PUT_DOWN_BLOCKS = 7
"""Of the beginning and of the end of a rest, which are to agree."""
PUT_DOWN_SIGMAS = 10.0


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
class Fault:
    """What is wrong, from `start` on, s: its kind, and a sentence. `kept` says whether a first part is good."""

    kind: str
    said: str
    start: float
    stop: float
    kept: bool = False
    choices: tuple[str, ...] = ("again", "go_on")


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


def calm_since(blocks: Blocks, limits: StillLimits, most: int = 100_000) -> int | None:
    """The block from which on nothing moves, None if something does now. CALM_BLOCKS are looked at together."""
    last = len(blocks)
    first = last
    while first > max(0, last - most):
        start = max(0, first - _LOOKED_AT)
        moving = np.flatnonzero(~_calm(blocks, start, min(first + CALM_BLOCKS - 1, last), limits))
        if len(moving):
            first = start + int(moving[-1]) + 1
            break
        first = start
    return first if last - first >= CALM_BLOCKS else None


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


def put_down_fault(blocks: Blocks, rest: Rest, number: int, wanted: float) -> Fault | None:
    """Whether a rest began while the unit still moved slowly: its first blocks differ from its last ones by more than
    their scatter allows, and by enough to move its mean by more than the `wanted` u, m/s²."""
    n, force = rest.last - rest.first, blocks.force[rest.first : rest.last]
    if n < 2 * PUT_DOWN_BLOCKS:
        return None
    apart = np.abs(force[:PUT_DOWN_BLOCKS].mean(axis=0) - force[-PUT_DOWN_BLOCKS:].mean(axis=0))
    scatter = np.sqrt(0.5 * (np.diff(force[PUT_DOWN_BLOCKS // 2 :], axis=0) ** 2).mean(axis=0))
    seen = apart > PUT_DOWN_SIGMAS * scatter * np.sqrt(2.0 / PUT_DOWN_BLOCKS)
    effect = float(np.max(apart * seen)) * PUT_DOWN_BLOCKS / n
    if effect <= wanted:
        return None
    off = float(np.max(apart)) / G_STANDARD * 1e3
    said = f"rest {number} was put down with movement: it began {off:.2g} mg from where it is now"
    return Fault(kind="movement", said=said, start=rest.start, stop=rest.stop)


def warmed_fault(blocks: Blocks, first: Rest, limit: float) -> Fault | None:
    """Whether the temperature has changed since the first rest by more than the `limit`, K; named again each time that
    it has changed by as much more."""
    if blocks.temperature is None:
        return None
    reference = float(blocks.temperature[first.first : first.last].mean())
    change = blocks.temperature - reference
    now = float(change[-CALM_BLOCKS:].mean())
    steps = int(abs(now) / limit)
    if steps == 0:
        return None
    since = float(blocks.edges[int(np.argmax(np.abs(change) >= steps * limit))])
    warmer = f"{abs(now):.2g} K {'warmer' if now > 0.0 else 'colder'} than at the first rest"
    said = f"drift of temperature: {warmer}; wait until it is steady, or go on: the change is then one more unknown"
    return Fault(kind="temperature", said=said, start=since, stop=float(blocks.edges[-1]), choices=("go_on",))


def verticals(rests: list[Rest], programme: Programme, gravity: float) -> Array:
    """Verticals (N, 3) in the body, freed from bias by the median difference from the nearest positions."""
    forces = np.array([rest.force for rest in rests]).reshape(-1, 3)
    expected = np.array([position.vertical_b for position in programme.positions])
    unit = forces / np.linalg.norm(forces, axis=1, keepdims=True)
    bias = np.median(forces - gravity * expected[np.argmax(unit @ expected.T, axis=1)], axis=0)
    free = forces - bias if len(rests) > 2 and np.linalg.norm(bias) < BIAS_LIMIT * gravity else forces
    return np.asarray(free / np.linalg.norm(free, axis=1, keepdims=True))


def position_fault(programme: Programme, k: int, vertical: Array, rest: Rest) -> Fault | None:
    """Whether a rest is position k of a programme in order, by its vertical."""
    off = np.array([np.arccos(np.clip(vertical @ p.vertical_b, -1.0, 1.0)) for p in programme.positions])
    if off[k] <= POSITION_LIMIT:
        return None
    nearest = int(np.argmin(off))
    like = f"this is {nearest + 1}" if off[nearest] <= POSITION_LIMIT else "this is none of the programme"
    said = f"wrong position: {like}, wanted {k + 1} ({programme.positions[k].label}); it is {off[k] / DEGREE:.0f}° off"
    return Fault(kind="wrong position", said=said, start=rest.start, stop=rest.stop)


def turn_fault(move: Move, before: Position, turned: Array | None, start: float, stop: float) -> Fault | None:
    """Whether a whole turn is that of the programme, by the gyros."""
    if move.axis is None or move.angle is None or turned is None:
        return None
    axis_b = before.matrix.T @ move.axis
    if float(np.linalg.norm(turned - move.angle * axis_b)) <= TURN_LIMIT:
        return None
    done = float(turned @ axis_b)
    if np.linalg.norm(turned + move.angle * axis_b) <= TURN_LIMIT:
        said = f"turned the wrong way: {_degrees(done)} instead of {_degrees(move.angle)}"
        return Fault(kind="wrong way", said=f"{said}; turn back the way you came", start=start, stop=stop)
    across = float(np.linalg.norm(turned - done * axis_b))
    said = f"another turn than the programme's: {_degrees(done)} about its axis and {across / DEGREE:.0f}° across it"
    return Fault(kind="wrong turn", said=f"{said}, wanted {_degrees(move.angle)}", start=start, stop=stop)


def _degrees(angle: float) -> str:
    """An angle to a degree, with its sign."""
    return f"{angle / DEGREE:+.0f}°".replace("-", "−")


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
