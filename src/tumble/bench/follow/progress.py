"""Progress of a session: rests by position, the quality of the last rest, and the present turn.

It follows from the blocks of the log and the exclusions alone, so that a restarted page shows the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np

from tumble.bench.follow.task import Wanted
from tumble.programme.positions import Programme
from tumble.recording.session import Session
from tumble.reduction.blocks.reducer import Reduction
from tumble.reduction.rest_stream import mean_so_far
from tumble.reduction.rests.matching import POSITION_LIMIT, SAME_ATTITUDE, bias_free_verticals
from tumble.reduction.rests.segmentation import Segmentation
from tumble.rotation import onto_body, rotation_matrix, rotation_vector, unit_vector
from tumble.units import Array

LATEST_BLOCKS = 5  # 0.5 s, whose mean is the present reading
DETECTION_BLOCKS = 10  # 1 s, in which a rest is detected
SHORTEST_REST = 4.0  # s
ATTITUDE_SECONDS = 300.0  # in which gyros with a bias of 0.01 °/s turn by 3°, about the resolution of a picture
OPPOSITE = 0.01  # sine of the angle between opposite verticals, between which the turn is undefined
MAX_REDUCTION = 0.93  # ratio of u after twice the time to u now, above which a longer rest is useless


@dataclass(frozen=True, kw_only=True, slots=True)
class File:
    """A file of the log: its number, from 0, its first block, and the shift from its times to those of the page, s."""

    number: int
    first: int
    shift: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Blocks:
    """The blocks so far, in the body frame: `edges` (K + 1,), s; specific force (K, 3), m/s²; angular rate (K, 3),
    rad/s, and temperature (K,), K, or None. The times of a file continue those of the file before."""

    files: tuple[File, ...]
    edges: Array
    force: Array
    rate: Array | None
    temperature: Array | None

    def __len__(self) -> int:
        return len(self.force)

    @staticmethod
    def of(reduction: Reduction, session: Session) -> Blocks:
        """Return the blocks of a reduction."""
        parts, gyro = [file for file in reduction.files if len(file)], session.gyro_block
        files, edges = list[File](), np.empty(0)
        for part in parts:
            shift = float(edges[-1] - part.edges[0]) if len(edges) else 0.0
            files.append(File(number=part.file, first=max(len(edges) - 1, 0), shift=shift))
            edges = np.concatenate([edges[:-1], part.edges + shift])
        temperature = [part.temperature.mean(axis=1) for part in parts if part.temperature is not None]
        return Blocks(
            files=tuple(files),
            edges=edges,
            force=np.concatenate([part.accel.means for part in parts]) @ onto_body(session.accel_block.axes).T,
            rate=None if gyro is None else np.concatenate([part.gyro.means for part in parts]) @ onto_body(gyro.axes).T,
            temperature=np.concatenate(temperature) if temperature else None,
        )

    def file_of(self, block: int) -> File:
        """Return the file of a block."""
        return next(file for file in reversed(self.files) if file.first <= block)

    def in_files(self, start: float, stop: float) -> list[tuple[int, float, float]]:
        """Return the files between two times of the page, s: their numbers, and the times by their clocks."""
        begins = [-np.inf, *(float(self.edges[file.first]) for file in self.files[1:]), np.inf]
        spans = zip(self.files, begins, begins[1:], strict=False)
        return [
            (file.number, max(start, begin) - file.shift, min(stop, end) - file.shift)
            for file, begin, end in spans
            if start < end and begin < stop
        ]

    def turned(self, first: int, last: int, level: Array | None) -> Array | None:
        """Return the gyro increments (K, 3) of blocks first … last − 1, rad, less the readings at rest (`level`).

        None without gyros, and if another file begins in between."""
        if self.rate is None or level is None or any(first <= file.first <= last for file in self.files[1:]):
            return None
        return np.asarray((self.rate[first:last] - level) * np.diff(self.edges[first : last + 1])[:, None])


def attitude_after(increments: Array) -> Array:
    """Return the rotation (3, 3) of gyro increments (K, 3), body at the end → body at the start."""
    return np.asarray(reduce(np.matmul, rotation_matrix(increments), np.eye(3)))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rest:
    """A rest: blocks, times, s, mean specific force (3,) and rate (3,)."""

    first: int
    last: int
    start: float
    stop: float
    force: Array
    rate: Array | None

    @staticmethod
    def of(blocks: Blocks, first: int, last: int) -> Rest:
        """Return the rest of blocks first … last − 1."""
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
    """Quality of a rest so far.

    `accel` and `gyro` are u of its mean, m/s² and rad/s, None without such sensors and for a short rest; `left` is the
    time until the wanted u in white noise, s. It is long `enough` if the wanted u is reached or a longer rest is
    useless (`nothing_more`)."""

    accel: float | None
    gyro: float | None
    left: float | None
    enough: bool
    nothing_more: bool

    @staticmethod
    def of(reduction: Reduction, file: File, rest: Rest, wanted: Wanted) -> Judged:
        """Compare u of the mean of a rest in this file with the wanted one."""
        mean = mean_so_far(reduction.by_file[file.number], rest.first - file.first, rest.last - file.first)
        seconds = rest.stop - rest.start
        levels = {"accel": wanted.accel, "gyro": wanted.gyro}
        kinds = [(max(u, 1e-12), twice, levels[kind]) for kind, (u, twice) in mean.items()]
        left, flat = None, False
        if kinds:
            over = max(u / level for u, _, level in kinds)
            left = max(seconds * (over**2 - 1.0), SHORTEST_REST - seconds, 0.0)
            flat = seconds > 10.0 and max(twice / u for u, twice, _ in kinds) > MAX_REDUCTION
        u = {kind: each for kind, (each, _) in mean.items()}
        return Judged(
            accel=u.get("accel"), gyro=u.get("gyro"), left=left, enough=left == 0.0 or flat, nothing_more=flat
        )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Progress:
    """Progress of a recording: its reduction and blocks; the rests `so_far`, None while the log is too short to find
    rests, in `groups` by position in chronological order; and the quality of the last two rests of the last position
    (`judged`)."""

    reduction: Reduction
    blocks: Blocks
    so_far: Segmentation | None
    groups: list[list[Rest]]
    judged: tuple[Judged, ...]

    @property
    def now(self) -> float:
        """Time of the last block, s."""
        return float(self.blocks.edges[-1])

    @property
    def still(self) -> bool:
        """Whether nothing moves, or a file has begun too recently to decide."""
        is_new_file = len(self.blocks) - self.blocks.files[-1].first < DETECTION_BLOCKS
        return is_new_file or (self.so_far is not None and self.so_far.still_at_end)

    @property
    def current(self) -> Rest | None:
        """The rest that lasts, or None."""
        return self.groups[-1][-1] if self.so_far is not None and self.so_far.lasting else None

    @property
    def turned(self) -> Array | None:
        """Sum of the gyro increments (3,) since the last rest, rad; None without gyros."""
        last = self.groups[-1][-1]
        increments = self.blocks.turned(last.last, len(self.blocks), last.rate)
        return None if increments is None else increments.sum(axis=0)


def grouped(blocks: Blocks, rests: list[Rest]) -> list[list[Rest]]:
    """Group consecutive rests by position: those without a turn between them or, without gyros, with the same vertical.

    Rests of different files are of different positions, since the turn between them is not known."""
    groups: list[list[Rest]] = []
    for rest in rests:
        angle = np.inf
        if groups:
            before = groups[-1][-1]
            angle = float(np.arccos(np.clip(before.vertical @ rest.vertical, -1.0, 1.0)))
            if angle < SAME_ATTITUDE and before.rate is not None and rest.rate is not None:
                increments = blocks.turned(before.last, rest.first, 0.5 * (before.rate + rest.rate))
                turned = np.inf if increments is None else rotation_vector(attitude_after(increments))
                angle = float(np.linalg.norm(turned))
        if angle < SAME_ATTITUDE:
            groups[-1].append(rest)
        else:
            groups.append([rest])
    return groups


# -------------------- positions of a programme --------------------


def verticals(rests: list[Rest], programme: Programme, gravity: float) -> Array:
    """Return the verticals (N, 3) of rests in the body frame, corrected for the bias by the positions of a
    programme."""
    expected = np.array([position.vertical_b for position in programme.positions])
    return bias_free_verticals(np.array([rest.force for rest in rests]).reshape(-1, 3), expected, gravity)


def nearest_positions(programme: Programme, units: Array) -> list[int | None]:
    """Return for each vertical (N, 3) its position in an unordered programme, or None."""
    cosines = units @ np.array([position.vertical_b for position in programme.positions]).T
    near = cosines.max(axis=1) >= np.cos(POSITION_LIMIT)
    return [int(k) if is_near else None for k, is_near in zip(np.argmax(cosines, axis=1), near, strict=True)]


def attitude_now(programme: Programme, progress: Progress, index: int, at: int) -> Array | None:
    """Return the present attitude, body → geographic (3, 3), on the way into position `index`, the `at`-th of the
    session.

    In an ordered programme it is that of the position before, turned by the gyros since. Without order or gyros, or
    long after that position, it is the attitude nearest to the wanted position that has the present vertical; None if
    there is no nearest one."""
    blocks, groups, wanted = progress.blocks, progress.groups, programme.positions[index]
    if programme.ordered and index and 0 < at <= len(groups):
        before = groups[at - 1][-1]
        increments = blocks.turned(before.last, len(blocks), before.rate)
        if increments is not None and progress.now - before.stop < ATTITUDE_SECONDS:
            return np.asarray(programme.positions[index - 1].matrix @ attitude_after(increments))
    vertical = unit_vector(blocks.force[-LATEST_BLOCKS:].mean(axis=0))
    across, cosine = np.cross(vertical, wanted.vertical_b), float(vertical @ wanted.vertical_b)
    sine = float(np.linalg.norm(across))
    if sine < OPPOSITE and cosine < 0.0:
        return None
    return np.asarray(wanted.matrix @ rotation_matrix(np.arctan2(sine, cosine) * across / max(sine, OPPOSITE)))
