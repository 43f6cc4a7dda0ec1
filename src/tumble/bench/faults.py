"""What is wrong with a recording, from what is seen of it: channels, gaps, knocks, positions, turns, what drifts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tumble.bench.chain import Blocks
from tumble.bench.course import (
    CALM_BLOCKS,
    Progress,
    Rest,
    against,
    nearest_positions,
    turned_between,
    verticals,
)
from tumble.bench.task import Task
from tumble.bench.watch import ChannelFault
from tumble.bench.wishes import Wanted
from tumble.programme.positions import Move, Position, Programme
from tumble.programme.sheet_words import move_text
from tumble.reduction.rests.matching import POSITION_LIMIT, TURN_LIMIT
from tumble.units import DEGREE, G_STANDARD, Array

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


def channel_fault(seen: ChannelFault) -> Fault:
    """A channel that is clipped or stuck."""
    said = f"{seen.column} is {seen.what} at {seen.start:.1f} s"
    more = "turn more slowly" if seen.what == "clipped" else "look at the sensor and its cable"
    text = f"{said}: {more}, and record anew; such a log cannot be calibrated"
    return Fault(kind=seen.what, said=text, start=seen.start, stop=seen.stop, choices=("anew", "go_on"))


def gap_fault(stop: float, missing: int, interval: float) -> Fault:
    """So many samples that are missing before one at `stop`, s."""
    seconds = (missing + 1) * interval
    said = f"gap of {seconds:.1f} s at {stop - seconds:.1f} s: {missing} samples did not arrive"
    return Fault(kind="gap", said=said, start=stop - seconds, stop=stop)


def faults_of_rests(task: Task, progress: Progress) -> list[Fault]:
    """What is wrong with the rests and the turns between them: knocks, positions, and what is not steady."""
    if not progress.groups:
        return []
    return [*_knocks(progress), *_misplaced(task, progress), *_unsteady(task.wanted, progress)]


def _knocks(progress: Progress) -> list[Fault]:
    """A rest that was cut in two before it was enough."""
    current, group = progress.current, progress.groups[-1]
    if current is None or len(group) < 2:
        return []
    before = group[-2]
    if progress.judged[0].enough or current.start - before.stop > KNOCK_SECONDS:
        return []
    said = f"knock at {before.stop:.1f} s, {before.stop - before.start:.0f} s into this rest"
    choices = ("again", "keep_first", "go_on")
    return [Fault(kind="knock", said=said, start=before.start, stop=before.stop, kept=True, choices=choices)]


def _unsteady(wanted: Wanted, progress: Progress) -> list[Fault]:
    """A rest put down with movement, and a temperature that has drifted since the first rest."""
    blocks, groups, current = progress.blocks, progress.groups, progress.current
    moved = None if current is None else put_down_fault(blocks, current, len(groups), wanted.accel)
    return [fault for fault in (moved, warmed_fault(blocks, groups[0][0], wanted.warming)) if fault]


def _misplaced(task: Task, progress: Progress) -> list[Fault]:
    """Rests in other positions than those of the programme, and turns that are not its turns."""
    listed = task.programme
    if listed is None:
        return []
    last = [group[-1] for group in progress.groups]
    units = verticals(last, listed, task.session.site.gravity)
    if not listed.ordered:
        return _unordered_faults(listed, last, units)
    found = _first_misplaced(listed, progress, last, units)
    return [found] if found is not None else _going_wrong(listed, progress)


def _first_misplaced(listed: Programme, progress: Progress, last: list[Rest], units: Array) -> Fault | None:
    """The first position that is not that of a programme in order, or was not turned into as it says."""
    blocks, groups = progress.blocks, progress.groups
    for k, (unit, rest) in enumerate(zip(units, last, strict=True)):
        if k >= len(listed.positions):
            said = f"one position more than the programme's {len(listed.positions)}"
            return Fault(kind="surplus", said=said, start=rest.start, stop=rest.stop)
        found = position_fault(listed, k, unit, rest)
        if found is None and k:
            turned = turned_between(blocks, last[k - 1].last, groups[k][0].first, last[k - 1].rate)
            before, move = listed.positions[k - 1], listed.moves[k - 1]
            found = turn_fault(move, before, turned, groups[k][0].start, rest.stop)
        if found is not None:
            return replace(found, place=k)
    return None


def _going_wrong(listed: Programme, progress: Progress) -> list[Fault]:
    """A turn under way that goes against its sense."""
    k = len(progress.groups)
    if progress.lasts or k >= len(listed.positions):
        return []
    last = progress.groups[-1][-1]
    turned = turned_between(progress.blocks, last.last, len(progress.blocks), last.rate)
    if turned is None or against(listed.moves[k - 1], listed.positions[k - 1], turned) < WRONG_WAY:
        return []
    said = f"this is the wrong way: wanted {move_text(listed.moves[k - 1])}; turn back"
    return [Fault(kind="turning wrong", said=said, start=last.stop, stop=last.stop, choices=("go_on",))]


def _unordered_faults(listed: Programme, rests: list[Rest], units: Array) -> list[Fault]:
    """Rests that are no position of a programme in any order."""
    return [
        Fault(kind="wrong position", said=f"this is no position of {listed.name}", start=rest.start, stop=rest.stop)
        for rest, k in zip(rests, nearest_positions(listed, units), strict=True)
        if k is None
    ]


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
