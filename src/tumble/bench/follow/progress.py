"""How far a session is: its rests by position, how good the last one is, and the turn since.

All of it follows from the blocks of the log and what is left out of it, so that a page that is started again shows the
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
from tumble.reduction.rest_stream import mean_so_far
from tumble.reduction.rests.matching import POSITION_LIMIT, SAME_ATTITUDE, bias_free_verticals
from tumble.reduction.rests.segmentation import Segmentation
from tumble.rotation import onto_body, rotation_matrix, rotation_vector, unit_vector
from tumble.units import Array

LATEST_BLOCKS = 5
"""Half a second: what reads now is the mean of these."""
TELLING_BLOCKS = 10
"""In a second a rest is found."""
SHORTEST_REST = 4.0
"""s."""
KNOWN_SECONDS = 300.0
"""For how long gyros of 0.01 °/s carry an attitude to 3°, which is about what a picture shows."""
OPPOSITE = 0.01
"""Sine of the angle between two verticals that are opposite: the way from one to the other is none in particular."""
NOTHING_MORE = 0.93
"""Where twice the time leaves more than this of u, longer gives nothing."""


@dataclass(frozen=True, kw_only=True, slots=True)
class File:
    """A file of the log: its number, from 0, its first block, and by how much times are later on the page, s."""

    number: int
    first: int
    shift: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Blocks:
    """The blocks so far, in the body: their `edges` (K + 1,), s; specific force (K, 3), m/s²; angular rate (K, 3),
    rad/s, and temperature (K,), K, where there are any. The times of a further file go on where those before it end."""

    files: tuple[File, ...]
    edges: Array
    force: Array
    rate: Array | None
    temperature: Array | None

    def __len__(self) -> int:
        return len(self.force)

    @staticmethod
    def of(reduction: Reduction, session: Session) -> Blocks:
        """The blocks of a reduction."""
        parts, gyro = [file for file in reduction.files if len(file)], session.gyro_block
        files, edges = list[File](), np.empty(0)
        for part in parts:
            shift = float(edges[-1] - part.edges[0]) if len(edges) else 0.0
            files.append(File(number=part.file, first=max(len(edges) - 1, 0), shift=shift))
            edges = np.concatenate([edges[:-1], part.edges + shift])
        warmth = [part.temperature.mean(axis=1) for part in parts if part.temperature is not None]
        return Blocks(
            files=tuple(files),
            edges=edges,
            force=np.concatenate([part.accel.means for part in parts]) @ onto_body(session.accel_block.axes).T,
            rate=None if gyro is None else np.concatenate([part.gyro.means for part in parts]) @ onto_body(gyro.axes).T,
            temperature=np.concatenate(warmth) if warmth else None,
        )

    def file_of(self, block: int) -> File:
        """The file of a block."""
        return next(file for file in reversed(self.files) if file.first <= block)

    def in_files(self, start: float, stop: float) -> list[tuple[int, float, float]]:
        """The number of each file between two times of the page, s, and these by the clock of the file."""
        begins = [-np.inf, *(float(self.edges[file.first]) for file in self.files[1:]), np.inf]
        spans = zip(self.files, begins, begins[1:], strict=False)
        return [
            (file.number, max(start, begin) - file.shift, min(stop, end) - file.shift)
            for file, begin, end in spans
            if start < end and begin < stop
        ]

    def turned(self, first: int, last: int, level: Array | None) -> Array | None:
        """The gyro increments (K, 3) of blocks first … last − 1, rad, less what the gyros read at rest, the `level`;
        None without gyros, and where another file begins on the way."""
        if self.rate is None or level is None or any(first <= file.first <= last for file in self.files[1:]):
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
    """How good a rest is so far: the standard uncertainty of its mean, m/s² and rad/s, None without such sensors and
    while the rest is too short; the time `left` to the wanted uncertainty if the noise is white, s; whether that is
    reached, or a longer rest would not reach it (`enough`), and whether a longer rest hardly lowers it
    (`nothing_more`)."""

    accel: float | None
    gyro: float | None
    left: float | None
    enough: bool
    nothing_more: bool

    @staticmethod
    def of(reduction: Reduction, file: File, rest: Rest, wanted: Wanted) -> Judged:
        """Compare the uncertainty of the mean of a rest, which is in this file, with the wanted one."""
        mean = mean_so_far(reduction.by_file[file.number], rest.first - file.first, rest.last - file.first)
        seconds = rest.stop - rest.start
        levels = {"accel": wanted.accel, "gyro": wanted.gyro}
        kinds = [(max(u, 1e-12), twice, levels[kind]) for kind, (u, twice) in mean.items()]
        left, flat = None, False
        if kinds:
            over = max(u / level for u, _, level in kinds)
            left = max(seconds * (over**2 - 1.0), SHORTEST_REST - seconds, 0.0)
            flat = seconds > 10.0 and max(twice / u for u, twice, _ in kinds) > NOTHING_MORE
        u = {kind: each for kind, (each, _) in mean.items()}
        return Judged(
            accel=u.get("accel"), gyro=u.get("gyro"), left=left, enough=left == 0.0 or flat, nothing_more=flat
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Progress:
    """A session that is being recorded: the reduction of its log so far and its blocks in the body; its rests `so_far`,
    None while the log is too short to find any, in `groups` by position in the order of time; and how good the last two
    rests of the last position are (`judged`)."""

    reduction: Reduction
    blocks: Blocks
    so_far: Segmentation | None
    groups: list[list[Rest]]
    judged: tuple[Judged, ...]

    @property
    def now(self) -> float:
        """The time of the last block, s."""
        return float(self.blocks.edges[-1])

    @property
    def still(self) -> bool:
        """Whether nothing moves now, or a file has begun so lately that nobody can tell."""
        lately = len(self.blocks) - self.blocks.files[-1].first < TELLING_BLOCKS
        return lately or (self.so_far is not None and self.so_far.still)

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
    """Group the rests between which nothing was turned: one position. Without gyros, those of one vertical. What was
    turned before another file began is not known, and its rests are of another position."""
    groups: list[list[Rest]] = []
    for rest in rests:
        apart = np.inf
        if groups:
            before = groups[-1][-1]
            apart = float(np.arccos(np.clip(before.vertical @ rest.vertical, -1.0, 1.0)))
            if apart < SAME_ATTITUDE and before.rate is not None and rest.rate is not None:
                increments = blocks.turned(before.last, rest.first, 0.5 * (before.rate + rest.rate))
                turned = np.inf if increments is None else rotation_vector(attitude_after(increments))
                apart = float(np.linalg.norm(turned))
        if apart < SAME_ATTITUDE:
            groups[-1].append(rest)
        else:
            groups.append([rest])
    return groups


# -------------------- positions of a programme --------------------


def verticals(rests: list[Rest], programme: Programme, gravity: float) -> Array:
    """Verticals (N, 3) in the body, corrected for the bias that the positions of a programme show."""
    expected = np.array([position.vertical_b for position in programme.positions])
    return bias_free_verticals(np.array([rest.force for rest in rests]).reshape(-1, 3), expected, gravity)


def nearest_positions(programme: Programme, units: Array) -> list[int | None]:
    """Position of a programme without an order that each vertical (N, 3) belongs to, or None."""
    cosines = units @ np.array([position.vertical_b for position in programme.positions]).T
    near = cosines.max(axis=1) >= np.cos(POSITION_LIMIT)
    return [int(k) if is_near else None for k, is_near in zip(np.argmax(cosines, axis=1), near, strict=True)]


def attitude_now(programme: Programme, progress: Progress, index: int, at: int) -> Array | None:
    """Attitude now, body → geographic (3, 3), of a unit on its way into position `index` of a programme, its `at`-th.

    In a programme with an order it is that of the position before, turned by what the gyros have read since. Without
    an order, without gyros, or long after that position, it is the attitude nearest to the position that has the
    vertical of the present reading. None if there is no nearest one."""
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
