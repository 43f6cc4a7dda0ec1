"""Faults of a recording: stuck and clipped channels, knocks, wrong positions and turns, drift of temperature."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tumble.bench.follow.progress import LATEST_BLOCKS, Progress, nearest_positions, verticals
from tumble.bench.follow.task import Task
from tumble.programme.positions import Programme
from tumble.programme.sheet_words import move_text
from tumble.reduction.rests.matching import POSITION_LIMIT, TURN_LIMIT
from tumble.units import ACCEL_UNITS, DEGREE, Array

STUCK_SECONDS = 1.0  # during which a stuck channel repeats itself while others of its kind do not
CLIPPED_FRACTION = 0.999  # of the full scale
_MIN_RUN = 20  # samples of a stuck channel
_REPORT_SECONDS = 10.0  # between two reports of a fault of one channel
SAME_SECONDS = 1.0  # between the beginnings of two reports of one fault
WRONG_WAY = 30.0 * DEGREE  # rad; a larger turn in the wrong sense is reported before it ends
KNOCK_SECONDS = 5.0  # of motion within a rest; after longer motion the unit may be in another position
PASSING = ("wrong position", "wrong way", "wrong turn")
"""Faults of a rest that pass when the right position follows; the rest is then left out."""

UNIT_FACTOR = 2.0  # error of measured gravity, above which the stated unit is doubted
UNIT_TOLERANCE = 0.25  # relative error of measured gravity in the suggested unit


@dataclass(frozen=True, kw_only=True, slots=True)
class Fault:
    """A fault of the recording.

    It has a `kind`, such as "knock", a sentence for the page (`said`), and times, s. `place` is the number of its
    position in the course, from 0, None for the present one; `choices` are the commands that answer it; `unit` is the
    suggested unit of the accelerometers."""

    kind: str
    said: str
    start: float
    stop: float
    place: int | None = None
    choices: tuple[str, ...] = ("again", "go_on")
    unit: str = ""

    def is_like(self, other: Fault) -> bool:
        """Return True for the same fault. The beginning of a rest may change by some blocks while it lasts."""
        return self.kind == other.kind and abs(self.start - other.start) < SAME_SECONDS


# -------------------- samples --------------------


class SampleWatch:
    """Search for stuck and clipped channels in the samples of one kind of sensor; `full_scale` in SI, or None."""

    def __init__(self, columns: tuple[str, ...], full_scale: float | None, interval: float) -> None:
        self._columns, self._full_scale = columns, full_scale
        self._min_run = max(_MIN_RUN, round(STUCK_SECONDS / interval))
        self._last: Array | None = None
        self._since = np.zeros(len(columns))
        self._run = np.zeros(len(columns), dtype=np.int64)
        self._repeats = np.zeros(len(columns), dtype=np.int64)
        self._count = 0
        self._reported: dict[tuple[str, str], float] = {}

    def look(self, time: Array, values: Array) -> list[Fault]:
        """Return the faults of the next samples (m, n), SI; each fault of a column at most once in ten seconds."""
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
        coarse = 2 * (self._repeats - self._run) > self._count
        stuck = (self._run >= self._min_run) & ~coarse & (self._run.min() < 0.5 * self._min_run)
        full, faults = CLIPPED_FRACTION * (np.inf if self._full_scale is None else self._full_scale), list[Fault]()
        for p, column in enumerate(self._columns):
            clipped = time[np.abs(values[:, p]) >= full]
            seen = [("clipped", clipped[0], clipped[-1], "turn more slowly")] if len(clipped) else []
            seen += [("stuck", self._since[p], time[-1], "look at the sensor and its cable")] if stuck[p] else []
            for kind, first, last, remedy in seen:
                start, stop = float(first), float(last)
                if start < self._reported.get((kind, column), -np.inf) + _REPORT_SECONDS:
                    continue
                self._reported[kind, column] = start
                text = (
                    f"{column} is {kind} at {start:.1f} s: {remedy}, and record anew; such a log cannot be calibrated"
                )
                faults.append(Fault(kind=kind, said=text, start=start, stop=stop, choices=("anew", "go_on")))
        return faults


# -------------------- rests and the turns between them --------------------


def faults_of_rests(task: Task, progress: Progress) -> Iterator[Fault]:
    """Yield the faults of the rests and of the turns between them."""
    blocks, groups, current, programme = progress.blocks, progress.groups, progress.current, task.programme
    if not groups:
        return

    # a rest that was interrupted before it was long enough
    if current is not None and len(groups[-1]) > 1 and not progress.judged[0].enough:
        start, stop = groups[-1][-2].start, groups[-1][-2].stop
        if current.start - stop <= KNOCK_SECONDS:
            text = f"knock at {stop:.1f} s, {stop - start:.0f} s into this rest"
            yield Fault(kind="knock", said=text, start=start, stop=stop, choices=("again", "keep_first", "go_on"))

    # wrong positions and turns
    if programme is not None and programme.ordered:
        yield from _off_course(task, programme, progress)
    elif programme is not None:
        rests = [group[-1] for group in groups]
        units = verticals(rests, programme, task.session.site.gravity)
        text = f"this is no position of {programme.name}"
        for rest, k in zip(rests, nearest_positions(programme, units), strict=True):
            if k is None:
                yield Fault(kind="wrong position", said=text, start=rest.start, stop=rest.stop)

    # temperature, reported again after each further change by the limit
    if blocks.temperature is not None:
        first, limit = groups[0][0], task.wanted.warming
        change = blocks.temperature - float(blocks.temperature[first.first : first.last].mean())
        now = float(change[-LATEST_BLOCKS:].mean())
        if steps := int(abs(now) / limit):
            since = float(blocks.edges[int(np.argmax(np.abs(change) >= steps * limit))])
            text = (
                f"drift of temperature: {abs(now):.2g} K {'warmer' if now > 0.0 else 'colder'} than at the first rest"
            )
            text += "; wait until it is steady, or go on: the change is then one more unknown"
            yield Fault(kind="temperature", said=text, start=since, stop=progress.now, choices=("go_on",))


def wrong_unit(task: Task, progress: Progress) -> Iterator[Fault]:
    """Suggest another unit if the accelerometers do not measure gravity in the first rest."""
    if not progress.groups:
        return
    rest, accel, gravity = progress.groups[0][-1], task.session.log.accel, task.session.site.gravity
    length = float(np.linalg.norm(rest.force))
    if gravity / UNIT_FACTOR < length < gravity * UNIT_FACTOR or not length:
        return
    stated = "m/s^2" if accel.raw else accel.unit_name
    read = length / ACCEL_UNITS[stated].factor
    rates = ((name, unit.factor) for name, unit in ACCEL_UNITS.items() if unit.kind == "rate")
    unit = next((name for name, factor in rates if abs(read * factor / gravity - 1.0) < UNIT_TOLERANCE), "")
    text = f"at rest the accelerometers read {read:.3g} {stated.replace('^2', '²')}"
    text += f": are they in {unit}?" if unit else ", which is not gravity: state their unit and scale in session.toml"
    choices = ("unit", "go_on") if unit else ("go_on",)
    yield Fault(kind="unit", said=text, start=rest.start, stop=rest.stop, choices=choices, unit=unit)


def is_over(fault: Fault, task: Task, progress: Progress) -> bool:
    """Return True for a fault that has passed: a good rest, or two of any length, follow a gap, or the
    right position a wrong one."""
    groups, programme = progress.groups, task.programme
    if fault.kind == "gap":
        taken = sum(group[0].start > fault.start for group in groups)
        return taken > 1 or (bool(groups) and groups[-1][-1].start > fault.start and progress.judged[-1].enough)
    if fault.kind == "restart":
        return True
    if fault.kind not in PASSING or programme is None:
        return False
    later = [group[-1] for group in groups if group[0].start > fault.stop]
    expected = np.array([position.vertical_b for position in programme.positions])
    wanted = expected if fault.place is None else expected[fault.place : fault.place + 1]
    return any(float((wanted @ rest.vertical).max()) > np.cos(POSITION_LIMIT) for rest in later[:1])


def _off_course(task: Task, programme: Programme, progress: Progress) -> Iterator[Fault]:
    """Yield the first departure from an ordered programme.

    It is the first rest whose vertical is not that of its position, or that was reached by another turn than the
    programme's according to the gyros; otherwise a turn under way in the wrong sense."""
    groups, rests = progress.groups, [group[-1] for group in progress.groups]
    expected = np.array([position.vertical_b for position in programme.positions])
    for k, vertical in enumerate(verticals(rests, programme, task.session.site.gravity)):
        start, stop = rests[k].start, rests[k].stop
        if k >= len(expected):
            text = f"one position more than the programme's {k}"
            yield Fault(kind="surplus", said=text, start=start, stop=stop)
            return
        off = np.arccos(np.clip(expected @ vertical, -1.0, 1.0))
        nearest = int(np.argmin(off))
        if off[k] > POSITION_LIMIT:
            like = f"this is {nearest + 1}" if off[nearest] <= POSITION_LIMIT else "this is none of the programme"
            wanted = f"wanted {k + 1} ({programme.positions[k].label})"
            text = f"wrong position: {like}, {wanted}; it is {off[k] / DEGREE:.0f}° off"
            yield Fault(kind="wrong position", said=text, start=start, stop=stop, place=k)
            return
        turn, increments = task.turn_b(k), None
        if turn is not None:
            increments = progress.blocks.turned(rests[k - 1].last, groups[k][0].first, rests[k - 1].rate)
        if turn is None or increments is None:
            continue
        (axis_b, angle), turned = turn, increments.sum(axis=0)
        if np.linalg.norm(turned - angle * axis_b) <= TURN_LIMIT:
            continue
        done = float(turned @ axis_b)
        across = float(np.linalg.norm(turned - done * axis_b)) / DEGREE
        kind, about = "wrong turn", f"{_degrees(done)} about its axis and {across:.0f}° across it"
        text = f"another turn than the programme's: {about}, wanted {_degrees(angle)}"
        if np.linalg.norm(turned + angle * axis_b) <= TURN_LIMIT:
            kind = "wrong way"
            text = f"turned the wrong way: {_degrees(done)} instead of {_degrees(angle)}; turn back the way you came"
        yield Fault(kind=kind, said=text, start=groups[k][0].start, stop=stop, place=k)
        return
    turn, turned_now = task.turn_b(len(groups)), progress.turned
    if progress.current is not None or turn is None or turned_now is None:
        return
    if -float(turned_now @ turn[0]) * np.sign(turn[1]) >= WRONG_WAY:
        text = f"this is the wrong way: wanted {move_text(task.move(len(groups)))}; turn back"
        yield Fault(kind="turning wrong", said=text, start=rests[-1].stop, stop=rests[-1].stop, choices=("go_on",))


def _degrees(angle: float) -> str:
    return f"{angle / DEGREE:+.0f}°".replace("-", "−")
