"""What is wrong with a recording, from what is seen of it: channels, gaps, knocks, positions, turns, what drifts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.bench.follow.rests import CALM_BLOCKS, Progress, nearest_positions, verticals
from tumble.bench.follow.wishes import Task
from tumble.programme.positions import Programme
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
    """What is wrong, from `start` on, s: its kind, a sentence, and the commands that answer it; `place` is the position
    it is about, from 0, None where that in which the unit is."""

    kind: str
    said: str
    start: float
    stop: float
    place: int | None = None
    choices: tuple[str, ...] = ("again", "go_on")

    @property
    def key(self) -> tuple[str, int]:
        """What an answer to it is kept under."""
        return self.kind, round(self.start)


# -------------------- samples --------------------


class SampleWatch:
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
        seen: list[Fault] = []
        for p, column in enumerate(self._columns):
            clipped = time[np.abs(values[:, p]) >= FULL * (np.inf if self._full_scale is None else self._full_scale)]
            if len(clipped):
                seen += self._named_anew("clipped", column, float(clipped[0]), float(clipped[-1]), "turn more slowly")
            coarse = 2 * (self._repeats[p] - self._run[p]) > self._count
            if self._run[p] >= self._least and not coarse and self._run.min() < 0.5 * self._least:
                remedy = "look at the sensor and its cable"
                seen += self._named_anew("stuck", column, float(self._since[p]), float(time[-1]), remedy)
        return seen

    def _named_anew(self, kind: str, column: str, start: float, stop: float, remedy: str) -> list[Fault]:
        """The fault of a column; none where it was named a short time before."""
        if start < self._named.get((kind, column), -np.inf) + _AGAIN_SECONDS:
            return []
        self._named[kind, column] = start
        said = f"{column} is {kind} at {start:.1f} s: {remedy}, and record anew; such a log cannot be calibrated"
        return [Fault(kind=kind, said=said, start=start, stop=stop, choices=("anew", "go_on"))]


def gap_fault(start: float, stop: float, missing: int) -> Fault:
    """So many samples that are missing between two times, s."""
    said = f"gap of {stop - start:.1f} s at {start:.1f} s: {missing} samples did not arrive"
    return Fault(kind="gap", said=said, start=start, stop=stop)


# -------------------- rests and the turns between them --------------------


def faults_of_rests(task: Task, progress: Progress) -> list[Fault]:
    """What is wrong with the rests and the turns between them: knocks, positions, and what is not steady."""
    if not progress.groups:
        return []
    faults = [_knocked(progress)]
    if task.programme is not None and task.programme.ordered:
        faults.append(_off_course(task, task.programme, progress))
    elif task.programme is not None:
        rests = [group[-1] for group in progress.groups]
        units = verticals(rests, task.programme, task.session.site.gravity)
        said = f"this is no position of {task.programme.name}"
        for rest, k in zip(rests, nearest_positions(task.programme, units), strict=True):
            if k is None:
                faults.append(Fault(kind="wrong position", said=said, start=rest.start, stop=rest.stop))
    faults += [_put_down(progress, task.wanted.accel), _warmed(progress, task.wanted.warming)]
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
    return Fault(kind="knock", said=said, start=before.start, stop=before.stop, choices=choices)


def _off_course(task: Task, programme: Programme, progress: Progress) -> Fault | None:
    """The first rest that is not the next position of a programme in order, by its vertical, or that was reached by
    another turn than the programme's, by the gyros; else the turn under way where it goes against its sense."""
    blocks, groups = progress.blocks, progress.groups
    rests = [group[-1] for group in groups]
    expected = np.array([position.vertical_b for position in programme.positions])
    for k, vertical in enumerate(verticals(rests, programme, task.session.site.gravity)):
        if k >= len(expected):
            said = f"one position more than the programme's {k}"
            return Fault(kind="surplus", said=said, start=rests[k].start, stop=rests[k].stop)
        off = np.arccos(np.clip(expected @ vertical, -1.0, 1.0))
        nearest = int(np.argmin(off))
        if off[k] > POSITION_LIMIT:
            like = f"this is {nearest + 1}" if off[nearest] <= POSITION_LIMIT else "this is none of the programme"
            wanted = f"wanted {k + 1} ({programme.positions[k].label})"
            said = f"wrong position: {like}, {wanted}; it is {off[k] / DEGREE:.0f}° off"
            return Fault(kind="wrong position", said=said, start=rests[k].start, stop=rests[k].stop, place=k)
        turn, increments = task.turn_b(k), None
        if turn is not None:
            increments = blocks.turned(rests[k - 1].last, groups[k][0].first, rests[k - 1].rate)
        if turn is None or increments is None:
            continue
        (axis_b, angle), turned = turn, increments.sum(axis=0)
        if np.linalg.norm(turned - angle * axis_b) <= TURN_LIMIT:
            continue
        done = float(turned @ axis_b)
        across = float(np.linalg.norm(turned - done * axis_b)) / DEGREE
        kind = "wrong turn"
        said = (
            f"another turn than the programme's: {_degrees(done)} about its axis and {across:.0f}° across it, wanted "
        )
        said += _degrees(angle)
        if np.linalg.norm(turned + angle * axis_b) <= TURN_LIMIT:
            kind = "wrong way"
            said = f"turned the wrong way: {_degrees(done)} instead of {_degrees(angle)}; turn back the way you came"
        return Fault(kind=kind, said=said, start=groups[k][0].start, stop=rests[k].stop, place=k)
    turn, turned = task.turn_b(len(groups)), progress.turned
    if progress.lasts or turn is None or turned is None or -float(turned @ turn[0]) * np.sign(turn[1]) < WRONG_WAY:
        return None
    said = f"this is the wrong way: wanted {move_text(task.move(len(groups)))}; turn back"
    return Fault(kind="turning wrong", said=said, start=rests[-1].stop, stop=rests[-1].stop, choices=("go_on",))


def _put_down(progress: Progress, wanted: float) -> Fault | None:
    """Whether the rest that lasts began while the unit still moved slowly: its first blocks differ from its last ones
    by more than their scatter allows, and by enough to move its mean by more than the `wanted` u, m/s²."""
    rest = progress.current
    if rest is None or rest.last - rest.first < 2 * PUT_DOWN_BLOCKS:
        return None
    force = progress.blocks.force[rest.first : rest.last]
    apart = np.abs(force[:PUT_DOWN_BLOCKS].mean(axis=0) - force[-PUT_DOWN_BLOCKS:].mean(axis=0))
    scatter = np.sqrt(0.5 * (np.diff(force[PUT_DOWN_BLOCKS // 2 :], axis=0) ** 2).mean(axis=0))
    seen = apart > PUT_DOWN_SIGMAS * scatter * np.sqrt(2.0 / PUT_DOWN_BLOCKS)
    if float(np.max(apart * seen)) * PUT_DOWN_BLOCKS / len(force) <= wanted:
        return None
    off = float(np.max(apart)) / G_STANDARD * 1e3
    said = f"rest {len(progress.groups)} was put down with movement: it began {off:.2g} mg from where it is now"
    return Fault(kind="movement", said=said, start=rest.start, stop=rest.stop)


def _warmed(progress: Progress, limit: float) -> Fault | None:
    """Whether the temperature has changed since the first rest by more than the `limit`, K; named again each time that
    it has changed by as much more."""
    blocks, first = progress.blocks, progress.groups[0][0]
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
    return Fault(kind="temperature", said=said, start=since, stop=progress.now, choices=("go_on",))


def _degrees(angle: float) -> str:
    return f"{angle / DEGREE:+.0f}°".replace("-", "−")
