"""What is wrong with a recording, from what is seen of it: channels, gaps, knocks, positions, turns, what drifts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.bench.follow.rests import (
    CALM_BLOCKS,
    Blocks,
    Progress,
    Rest,
    nearest_positions,
    turned_between,
    verticals,
)
from tumble.bench.follow.wishes import Task
from tumble.programme.positions import Move, Position, Programme
from tumble.programme.sheet_words import move_text
from tumble.reduction.rests.matching import POSITION_LIMIT, TURN_LIMIT
from tumble.units import DEGREE, G_STANDARD, Array

STUCK_SECONDS = 1.0
"""A channel that repeats itself for so long, while others of its kind do not, is stuck."""
FULL = 0.999
_LEAST_RUN = 20
_AGAIN_SECONDS = 10.0
WRONG_WAY = 30.0 * DEGREE
"""A turn that has gone so far against its sense is wrong, before it ends."""
KNOCK_SECONDS = 5.0
"""A rest that was left for longer has been left for another position, and come back to."""
PUT_DOWN_BLOCKS = 7
"""Of the beginning and of the end of a rest, which are to agree."""
PUT_DOWN_SIGMAS = 10.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Fault:
    """What is wrong, from `start` on, s: its kind, and a sentence. `kept` says whether a first part is good; `place`
    which position it is about, from 0, None where that in which the unit is."""

    kind: str
    said: str
    start: float
    stop: float
    place: int | None = None
    kept: bool = False
    choices: tuple[str, ...] = ("again", "go_on")

    @property
    def key(self) -> tuple[str, int]:
        """What an answer to it is kept under."""
        return self.kind, round(self.start)


# -------------------- samples --------------------


class Watch:
    """Looks at every sample of one kind of sensor. `full_scale` in SI, None where it is not known."""

    def __init__(self, columns: tuple[str, ...], full_scale: float | None, interval: float) -> None:
        self._columns, self._full_scale = columns, full_scale
        self._least = max(_LEAST_RUN, round(STUCK_SECONDS / interval))
        self._last: Array | None = None
        self._since = np.zeros(len(columns))
        self._run = np.zeros(len(columns), dtype=np.int64)
        self._repeats = np.zeros(len(columns), dtype=np.int64)
        self._count = 0
        self._named: dict[tuple[str, str], float] = {}

    def look(self, time: Array, values: Array) -> list[Fault]:
        """What is wrong with the next samples (m, n) in SI; of each column a fault once in ten seconds."""
        if not len(time):
            return []
        seen: list[tuple[str, int, float, float]] = []
        if self._full_scale is not None:
            over = np.abs(values) >= FULL * self._full_scale
            for column in np.flatnonzero(over.any(axis=0)):
                first, last = time[over[:, column]][[0, -1]].tolist()
                seen.append(("clipped", int(column), first, last))
        before = values[:1] * np.nan if self._last is None else self._last[None]
        equal = values == np.concatenate([before, values[:-1]])
        self._last = values[-1].copy()
        self._count += len(time)
        self._repeats += equal.sum(axis=0)
        for p in range(len(self._columns)):
            changes = np.flatnonzero(~equal[:, p])
            if len(changes):
                self._run[p], self._since[p] = len(time) - 1 - changes[-1], time[changes[-1]]
            else:
                self._run[p] += len(time)
            coarse = 2 * (self._repeats[p] - self._run[p]) > self._count
            if self._run[p] >= self._least and not coarse and self._run.min() < 0.5 * self._least:
                seen.append(("stuck", p, float(self._since[p]), float(time[-1])))
        return [fault for each in seen if (fault := self._new(*each)) is not None]

    def _new(self, kind: str, p: int, start: float, stop: float) -> Fault | None:
        column = self._columns[p]
        if start < self._named.get((kind, column), -np.inf) + _AGAIN_SECONDS:
            return None
        self._named[kind, column] = start
        more = "turn more slowly" if kind == "clipped" else "look at the sensor and its cable"
        said = f"{column} is {kind} at {start:.1f} s: {more}, and record anew; such a log cannot be calibrated"
        return Fault(kind=kind, said=said, start=start, stop=stop, choices=("anew", "go_on"))


def gap_fault(start: float, stop: float, missing: int) -> Fault:
    """So many samples that are missing between two times, s."""
    said = f"gap of {stop - start:.1f} s at {start:.1f} s: {missing} samples did not arrive"
    return Fault(kind="gap", said=said, start=start, stop=stop)


# -------------------- rests and the turns between them --------------------


def faults_of_rests(task: Task, progress: Progress) -> list[Fault]:
    """What is wrong with the rests and the turns between them: knocks, positions, and what is not steady."""
    if not progress.groups:
        return []
    blocks, groups, current, wanted = progress.blocks, progress.groups, progress.current, task.wanted
    faults = [
        _knocked(progress),
        *_misplaced(task, progress),
        None if current is None else _put_down(blocks, current, len(groups), wanted.accel),
        _warmed(blocks, groups[0][0], wanted.warming),
    ]
    return [fault for fault in faults if fault is not None]


def _knocked(progress: Progress) -> Fault | None:
    """A rest that was cut in two before it was enough."""
    current, group = progress.current, progress.groups[-1]
    if current is None or len(group) < 2:
        return None
    before = group[-2]
    if progress.judged[0].enough or current.start - before.stop > KNOCK_SECONDS:
        return None
    said = f"knock at {before.stop:.1f} s, {before.stop - before.start:.0f} s into this rest"
    choices = ("again", "keep_first", "go_on")
    return Fault(kind="knock", said=said, start=before.start, stop=before.stop, kept=True, choices=choices)


def _misplaced(task: Task, progress: Progress) -> list[Fault | None]:
    """Rests in other positions than those of the programme, and turns that are not its turns."""
    programme, blocks, groups = task.programme, progress.blocks, progress.groups
    if programme is None:
        return []
    last = [group[-1] for group in groups]
    units = verticals(last, programme, task.session.site.gravity)
    if not programme.ordered:
        said = f"this is no position of {programme.name}"
        return [
            Fault(kind="wrong position", said=said, start=rest.start, stop=rest.stop)
            for rest, k in zip(last, nearest_positions(programme, units), strict=True)
            if k is None
        ]
    for k, (unit, rest) in enumerate(zip(units, last, strict=True)):
        if k >= len(programme.positions):
            said = f"one position more than the programme's {k}"
            return [Fault(kind="surplus", said=said, start=rest.start, stop=rest.stop)]
        fault = _wrong_position(programme, k, unit, rest)
        if fault is None and k:
            turned = turned_between(blocks, last[k - 1].last, groups[k][0].first, last[k - 1].rate)
            fault = _wrong_turn(programme, k, turned, groups[k][0].start, rest.stop)
        if fault is not None:
            return [fault]
    return [_going_wrong(programme, progress)]


def _wrong_position(programme: Programme, k: int, vertical: Array, rest: Rest) -> Fault | None:
    """Whether a rest is another than position k of a programme in order, by its vertical."""
    off = np.array([np.arccos(np.clip(vertical @ p.vertical_b, -1.0, 1.0)) for p in programme.positions])
    if off[k] <= POSITION_LIMIT:
        return None
    nearest = int(np.argmin(off))
    like = f"this is {nearest + 1}" if off[nearest] <= POSITION_LIMIT else "this is none of the programme"
    said = f"wrong position: {like}, wanted {k + 1} ({programme.positions[k].label}); it is {off[k] / DEGREE:.0f}° off"
    return Fault(kind="wrong position", said=said, start=rest.start, stop=rest.stop, place=k)


def _turn_vector(programme: Programme, k: int) -> tuple[Array, float] | None:
    """Axis (3,), in the body before it, and angle, rad, of the turn into position k; None where any is as good."""
    move: Move = programme.moves[k - 1]
    before: Position = programme.positions[k - 1]
    return None if move.axis is None or move.angle is None else (before.matrix.T @ move.axis, move.angle)


def _wrong_turn(programme: Programme, k: int, turned: Array | None, start: float, stop: float) -> Fault | None:
    """Whether a whole turn is another than that of the programme into position k, by the gyros."""
    wanted = _turn_vector(programme, k)
    if wanted is None or turned is None:
        return None
    axis_b, angle = wanted
    if float(np.linalg.norm(turned - angle * axis_b)) <= TURN_LIMIT:
        return None
    done = float(turned @ axis_b)
    if np.linalg.norm(turned + angle * axis_b) <= TURN_LIMIT:
        said = f"turned the wrong way: {_degrees(done)} instead of {_degrees(angle)}; turn back the way you came"
        return Fault(kind="wrong way", said=said, start=start, stop=stop, place=k)
    across = float(np.linalg.norm(turned - done * axis_b)) / DEGREE
    said = f"another turn than the programme's: {_degrees(done)} about its axis and {across:.0f}° across it"
    return Fault(kind="wrong turn", said=f"{said}, wanted {_degrees(angle)}", start=start, stop=stop, place=k)


def _going_wrong(programme: Programme, progress: Progress) -> Fault | None:
    """A turn under way that goes against its sense."""
    k, last = len(progress.groups), progress.groups[-1][-1]
    if progress.lasts or k >= len(programme.positions):
        return None
    turned = turned_between(progress.blocks, last.last, len(progress.blocks), last.rate)
    wanted = _turn_vector(programme, k)
    if turned is None or wanted is None or -float(turned @ wanted[0]) * np.sign(wanted[1]) < WRONG_WAY:
        return None
    said = f"this is the wrong way: wanted {move_text(programme.moves[k - 1])}; turn back"
    return Fault(kind="turning wrong", said=said, start=last.stop, stop=last.stop, choices=("go_on",))


def _put_down(blocks: Blocks, rest: Rest, number: int, wanted: float) -> Fault | None:
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


def _warmed(blocks: Blocks, first: Rest, limit: float) -> Fault | None:
    """Whether the temperature has changed since the first rest by more than the `limit`, K; named again each time that
    it has changed by as much more."""
    if blocks.temperature is None:
        return None
    change = blocks.temperature - float(blocks.temperature[first.first : first.last].mean())
    now = float(change[-CALM_BLOCKS:].mean())
    steps = int(abs(now) / limit)
    if steps == 0:
        return None
    since = float(blocks.edges[int(np.argmax(np.abs(change) >= steps * limit))])
    warmer = f"{abs(now):.2g} K {'warmer' if now > 0.0 else 'colder'} than at the first rest"
    said = f"drift of temperature: {warmer}; wait until it is steady, or go on: the change is then one more unknown"
    return Fault(kind="temperature", said=said, start=since, stop=float(blocks.edges[-1]), choices=("go_on",))


def _degrees(angle: float) -> str:
    """An angle to a degree, with its sign."""
    return f"{angle / DEGREE:+.0f}°".replace("-", "−")
