"""Where the operator is: the rests so far, how good the last one is, the positions they are, and the turn under way.

All of it follows from the blocks of the log and what is left out of it, so that a page that is started again says the
same.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np

from tumble.bench.follow.wishes import Wanted
from tumble.programme.positions import Programme
from tumble.recording.session import Session
from tumble.reduction.blocks.reducer import Reduction
from tumble.reduction.rests.live import RestsSoFar, mean_so_far
from tumble.reduction.rests.matching import POSITION_LIMIT, SAME_ATTITUDE, freed_verticals
from tumble.rotation import onto_body, rotation_matrix, rotation_vector, unit_vector
from tumble.units import Array

LATEST_BLOCKS = 5
"""Half a second: what reads now is the mean of these."""
SHORTEST_REST = 4.0
"""s."""
KNOWN_SECONDS = 300.0
"""For how long gyros of 0.01 °/s carry an attitude to 3°, which is about what a picture shows."""
OPPOSITE = 0.01
"""Sine of the angle between two verticals that are opposite: the way from one to the other is none in particular."""
NOTHING_MORE = 0.93
"""Where twice the time leaves more than this of u, longer gives nothing."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Blocks:
    """The blocks so far, in the body: their `edges` (K + 1,), s; specific force (K, 3), m/s²; angular rate (K, 3),
    rad/s, and temperature (K,), K, where there are any."""

    edges: Array
    force: Array
    rate: Array | None
    temperature: Array | None

    def __len__(self) -> int:
        return len(self.force)

    @staticmethod
    def of(reduction: Reduction, session: Session) -> Blocks:
        """The blocks of a reduction."""
        file, gyro = reduction.files[-1], session.gyro_block
        return Blocks(
            edges=file.edges,
            force=file.accel.means @ onto_body(session.accel_block.axes).T,
            rate=None if gyro is None else file.gyro.means @ onto_body(gyro.axes).T,
            temperature=None if file.temperature is None else file.temperature.mean(axis=1),
        )

    def turned(self, first: int, last: int, level: Array | None) -> Array | None:
        """The gyro increments (K, 3) of blocks first … last − 1, rad, less what the gyros read at rest, the `level`;
        None without gyros."""
        if self.rate is None or level is None:
            return None
        return np.asarray((self.rate[first:last] - level) * np.diff(self.edges[first : last + 1])[:, None])


def attitude_after(increments: Array) -> Array:
    """The rotation (3, 3) over gyro increments (K, 3), body at its end → body at its start."""
    return np.asarray(reduce(np.matmul, rotation_matrix(increments), np.eye(3)))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rest:
    """A rest: its blocks, its times, s, the mean specific force (3,) and rate (3,)."""

    first: int
    last: int
    start: float
    stop: float
    force: Array
    rate: Array | None

    @staticmethod
    def of(blocks: Blocks, first: int, last: int) -> Rest:
        """The rest of blocks first … last − 1."""
        return Rest(
            first=first,
            last=last,
            start=float(blocks.edges[first]),
            stop=float(blocks.edges[last]),
            force=blocks.force[first:last].mean(axis=0),
            rate=None if blocks.rate is None else blocks.rate[first:last].mean(axis=0),
        )

    @property
    def vertical(self) -> Array:
        """Direction of the mean specific force in the body."""
        return unit_vector(self.force)


@dataclass(frozen=True, kw_only=True, slots=True)
class Judged:
    """A rest as it is now: u of its mean by the accelerometers, m/s², and gyros, rad/s (None without, and while there is
    too little to tell it from); s that are left to the wanted u; whether it is `enough`, and whether longer would give
    nothing."""

    accel: float | None
    gyro: float | None
    left: float | None
    enough: bool
    nothing_more: bool

    @staticmethod
    def of(reduction: Reduction, rest: Rest, wanted: Wanted) -> Judged:
        """u of the mean of a rest against the wanted ones, and what twice the time would leave of it."""
        mean, seconds = mean_so_far(reduction, rest.first, rest.last), rest.stop - rest.start
        kinds = [
            (max(u, 1e-12), twice, level)
            for u, twice, level in (
                (mean.accel_u, mean.accel_twice, wanted.accel),
                (mean.gyro_u, mean.gyro_twice, wanted.gyro),
            )
            if u is not None and twice is not None
        ]
        left, flat = None, False
        if kinds:
            over = max(u / level for u, _, level in kinds)
            left = max(seconds * (over**2 - 1.0), SHORTEST_REST - seconds, 0.0)
            flat = seconds > 10.0 and max(twice / u for u, twice, _ in kinds) > NOTHING_MORE
        return Judged(accel=mean.accel_u, gyro=mean.gyro_u, left=left, enough=left == 0.0 or flat, nothing_more=flat)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Progress:
    """A session under way: what the log is reduced to; what of it rests, `so_far`, None while there is too little to
    find rests in; the rests by position, `groups`; and how good the last two rests of the last position are."""

    reduction: Reduction
    blocks: Blocks
    so_far: RestsSoFar | None
    groups: list[list[Rest]]
    judged: tuple[Judged, ...]

    @property
    def now(self) -> float:
        """The time of the last block, s."""
        return float(self.blocks.edges[-1])

    @property
    def still(self) -> bool:
        """Whether nothing moves now."""
        return self.so_far is not None and self.so_far.still

    @property
    def current(self) -> Rest | None:
        """The rest that lasts, None while there is none."""
        return self.groups[-1][-1] if self.so_far is not None and self.so_far.lasting else None

    @property
    def turned(self) -> Array | None:
        """Sum of the gyro increments (3,) since the last rest, rad; None without gyros."""
        last = self.groups[-1][-1]
        increments = self.blocks.turned(last.last, len(self.blocks), last.rate)
        return None if increments is None else increments.sum(axis=0)


def grouped(blocks: Blocks, rests: list[Rest]) -> list[list[Rest]]:
    """Rests without a turn between them together: one position. Without gyros, those of one vertical."""
    groups: list[list[Rest]] = []
    for rest in rests:
        apart = np.inf
        if groups:
            before = groups[-1][-1]
            apart = float(np.arccos(np.clip(before.vertical @ rest.vertical, -1.0, 1.0)))
            if apart < SAME_ATTITUDE and before.rate is not None and rest.rate is not None:
                increments = blocks.turned(before.last, rest.first, 0.5 * (before.rate + rest.rate))
                assert increments is not None
                apart = float(np.linalg.norm(rotation_vector(attitude_after(increments))))
        if apart < SAME_ATTITUDE:
            groups[-1].append(rest)
        else:
            groups.append([rest])
    return groups


# -------------------- positions of a programme --------------------


def verticals(rests: list[Rest], programme: Programme, gravity: float) -> Array:
    """Verticals (N, 3) in the body, freed from bias by the positions of a programme."""
    expected = np.array([position.vertical_b for position in programme.positions])
    return freed_verticals(np.array([rest.force for rest in rests]).reshape(-1, 3), expected, gravity)


def nearest_positions(programme: Programme, units: Array) -> list[int | None]:
    """Which position of a programme in any order each vertical (N, 3) is; None where it is none."""
    cosines = units @ np.array([position.vertical_b for position in programme.positions]).T
    near = cosines.max(axis=1) >= np.cos(POSITION_LIMIT)
    return [int(k) if is_near else None for k, is_near in zip(np.argmax(cosines, axis=1), near, strict=True)]


def attitude_now(programme: Programme, progress: Progress, index: int, at: int) -> Array | None:
    """Body → geographic (3, 3) now, of a unit that is to be in position `index` of a programme, its `at`-th, from 0:
    from the position before by what the gyros read since. In any order, without gyros, or long after it, the attitude
    nearest to that position with the vertical as it is read; None where that is none."""
    blocks, groups, wanted = progress.blocks, progress.groups, programme.positions[index]
    if programme.ordered and index and 0 < at <= len(groups):
        before = groups[at - 1][-1]
        increments = blocks.turned(before.last, len(blocks), before.rate)
        if increments is not None and progress.now - before.stop < KNOWN_SECONDS:
            return np.asarray(programme.positions[index - 1].matrix @ attitude_after(increments))
    vertical = unit_vector(blocks.force[-LATEST_BLOCKS:].mean(axis=0))
    across, cosine = np.cross(vertical, wanted.vertical_b), float(vertical @ wanted.vertical_b)
    sine = float(np.linalg.norm(across))
    if sine < OPPOSITE and cosine < 0.0:
        return None
    return np.asarray(wanted.matrix @ rotation_matrix(np.arctan2(sine, cosine) * across / max(sine, OPPOSITE)))
