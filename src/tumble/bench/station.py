"""One bench: a unit that is recorded, what the page shows of it, and what the operator answers.

The state follows from the log on disk and from session.toml, so that the page and this process may each be started
again at any time. `state` is replaced as a whole, several times a second, by one thread; another makes the estimates.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import math
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tumble.bench import ending
from tumble.bench import folder as folders
from tumble.bench.chain import Blocks, Chain, Known
from tumble.bench.course import (
    WRONG_WAY,
    Fault,
    Rest,
    StillLimits,
    against,
    calm_since,
    grouped,
    nearest_positions,
    position_fault,
    put_down_fault,
    rest_of,
    scatter_now,
    turn_fault,
    turned_between,
    verticals,
    warmed_fault,
)
from tumble.bench.follow import BRIDGED, Clock, Follower
from tumble.bench.intake import Intake
from tumble.bench.sources import LineSource
from tumble.bench.watch import Watch
from tumble.bench.wishes import DIRECTIONS, better_by, gains, reached, rest_wishes, temperature_limit, wishes
from tumble.errors import TumbleError
from tumble.estimation.estimate import FIT_SIGMAS, Estimate
from tumble.programme.positions import ANY_MOVE, Move, Programme, from_attitudes
from tumble.programme.positions import programme as built_in
from tumble.programme.sheet_words import move_text, points_of, signed_angle
from tumble.recording.session import Exclusion, Session
from tumble.reduction.blocks import Reduction
from tumble.reduction.segmentation import RestSpan, Segmentation
from tumble.units import DEGREE, G_STANDARD, Array

log = logging.getLogger(__name__)

STEP_SECONDS = 0.2
SHORTEST_REST = 4.0
STILL_TURNING = 3.0 * DEGREE
"""s⁻¹: a turn that is nearly done and goes on more slowly is a unit put down with movement."""
NEARLY = 10.0 * DEGREE
KNOCK_SECONDS = 5.0
"""A rest that was left for longer has been left for another position, and come back to."""
NOTHING_MORE = 0.93
"""Where twice the time leaves more than this of u, longer gives nothing."""
_WINDOW = 1200
_TRACE = 600
_PIECES = 32
_SETTLING = 20.0
"""Of u: a drift over a rest that is no noise; that of white noise is √12 u."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Judged:
    """A rest as it is now: how well it is known, s that are left to the wanted u, whether it is `enough`, and whether
    longer would give nothing."""

    known: Known | None
    left: float | None
    enough: bool
    nothing_more: bool


_NO_ESTIMATE: dict[str, Any] = {
    "groups": [], "enough": False, "residuals": [], "gains": None, "cause": "", "next": "", "unknowns": 0,
    "seconds": 0.0,
}  # fmt: skip


class Station:
    """A bench: `listen` makes the source of what is recorded, None where another program writes the log."""

    def __init__(
        self,
        folder: Path,
        listen: Callable[[], LineSource] | None,
        *,
        wanted: tuple[str, ...] = (),
        grade: str = "mems",
        registry: str | None = None,
    ) -> None:
        """`registry` is where the button registers, None for the user's."""
        self.folder, self._listen, self._grade, self._registry = folder, listen, grade, registry
        self.wanted = wishes(wanted, grade)
        self.rest_wanted = rest_wishes(self.wanted, grade)
        self._temperature_limit = temperature_limit(self.wanted, grade)
        self._changed = threading.Condition()
        self._guard = threading.RLock()
        self._stop = threading.Event()
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="estimate")
        self._thread = threading.Thread(target=self._run, name="station", daemon=True)
        self.intake: Intake | None = None
        self._begin(folder)
        self.state = self._state()

    def _begin(self, folder: Path) -> None:
        """Open the session of a folder, from its beginning."""
        self.folder = folder
        self.session: Session = folders.session_to_record(folder)
        self.programme = _programme_of(self.session)
        self._follower = Follower.of(self.session.log)
        self._clock = Clock(spec=self.session.log)
        self._chain: Chain | None = None
        self._blocks: Blocks | None = None
        self._reduction: Reduction | None = None
        self._watches: list[Watch] = []
        self._spans: tuple[RestSpan, ...] = ()
        self._limits: StillLimits | None = None
        self._faults: list[Fault] = []
        self._answered: set[tuple[str, int]] = set()
        self._open: Exclusion | None = None
        self._cut: list[Exclusion] = []
        self._closed: dict[tuple[int, int], Rest] = {}
        self._judged: dict[tuple[int, int], Judged] = {}
        self._estimated: tuple[object, ...] = ()
        self._future: Future[dict[str, Any]] | None = None
        self._estimate: dict[str, Any] | None = None
        self._result: dict[str, Any] | None = None
        self._message = ""
        self._wrong: tuple[str, int] | None = None
        self._calibrating = False
        self._go_on_after = -1
        self._samples = self._lost = 0

    # -------------------- running --------------------

    def start(self) -> None:
        """Begin to record and to follow."""
        self._record()
        self._thread.start()

    def _record(self) -> None:
        if self._listen is not None:
            self.intake = Intake(self._listen(), self.session)
            self.intake.start()

    def _run(self) -> None:
        while not self._stop.wait(STEP_SECONDS):
            try:
                self.step()
            except OSError as error:
                self._say(f"{self.folder}: cannot be read: {error.strerror}")
            except Exception:
                log.exception("the state could not be made")

    def _say(self, message: str) -> None:
        """Show the state as it was, with a message."""
        with self._changed:
            self.state = {**self.state, "message": message}
            self._changed.notify_all()

    def stop(self) -> None:
        """End following and recording."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()
        if self.intake is not None:
            self.intake.stop()
        self._worker.shutdown(wait=True)

    def step(self) -> None:
        """Read what has come and make the state anew."""
        with self._guard:
            self._take()
            if self._future is not None and self._future.done():
                self._estimate, self._future = self._future.result(), None
            state = self._state()
        with self._changed:
            self.state = state
            self._changed.notify_all()

    @property
    def followed(self) -> int:
        """Bytes of the log that are in the state."""
        return self._follower.at

    def wait(self, before: Mapping[str, Any], timeout: float) -> dict[str, Any]:
        """The state, as soon as it is another one than that of `before`."""
        with self._changed:
            self._changed.wait_for(lambda: self.state is not before, timeout)
            return self.state

    # -------------------- the log --------------------

    def _take(self) -> None:
        for _ in range(_PIECES):
            rows = self._follower.rows()
            if not len(rows):
                break
            samples = self._clock.samples(rows)
            if samples is None or self._clock.interval is None:
                continue
            if self._chain is None:
                self._chain = Chain(self.session, self._clock.interval, self._grade)
                self._watches = self._new_watches(self._clock.interval)
            accel, gyro = self._chain.feed(samples)
            self._samples += len(samples.time)
            self._lost += int(samples.lost.sum())
            self._look(samples.time, accel, gyro, samples.lost, samples.dt)
        if self._chain is not None:
            self._reduction = self._chain.now()
            if self._reduction.files:
                self._blocks = self._chain.blocks(self._reduction)
                self._segment(self._chain, self._reduction, self._blocks)

    def _new_watches(self, interval: float) -> list[Watch]:
        kinds = [channels for channels in (self.session.log.accel, self.session.log.gyro) if channels is not None]
        return [Watch(channels.columns, channels.range, interval) for channels in kinds]

    def _look(self, time: Array, accel: Array, gyro: Array | None, lost: Array, dt: Array) -> None:
        for watch, values in zip(self._watches, (accel, gyro), strict=False):
            for seen in watch.look(time, values) if values is not None else ():
                said = f"{seen.column} is {seen.what} at {seen.start:.1f} s"
                more = "turn more slowly" if seen.what == "clipped" else "look at the sensor and its cable"
                text = f"{said}: {more}, and record anew; such a log cannot be calibrated"
                self._faults.append(
                    Fault(kind=seen.what, said=text, start=seen.start, stop=seen.stop, choices=("anew", "go_on"))
                )
        for i in np.flatnonzero(lost > BRIDGED):
            stop, missing = float(time[i]), int(lost[i])
            seconds = (missing + 1) * float(dt[i])
            said = f"gap of {seconds:.1f} s at {stop - seconds:.1f} s: {missing} samples did not arrive"
            self._faults.append(Fault(kind="gap", said=said, start=stop - seconds, stop=stop))

    @property
    def _excluded(self) -> tuple[Exclusion, ...]:
        """What is left out, the open one without an end."""
        own = [one for one in self.session.excluded + tuple(self._cut) if one != self._open]
        return (*own, replace(self._open, stop=math.inf)) if self._open is not None else tuple(own)

    def _segment(self, chain: Chain, reduction: Reduction, blocks: Blocks) -> None:
        first = max(0, len(blocks) - _WINDOW)
        if len(blocks) > 5 * _WINDOW:
            first = max([span.last for span in self._spans if span.last <= first], default=first)
        else:
            first = 0
        found = chain.rests(reduction, self._excluded, first)
        if found is None:
            return
        kept = tuple(span for span in self._spans if span.last <= first)
        self._spans = (*kept, *found.rests)
        self._limits = self._limits_of(found, blocks)

    def _limits_of(self, found: Segmentation, blocks: Blocks) -> StillLimits:
        level = None
        if blocks.rate is not None and self._spans:
            last = self._spans[-1]
            level = blocks.rate[last.first : last.last].mean(axis=0)
        return StillLimits(scatter=found.scatter_limit, rate=found.rate_limit, level=level)

    # -------------------- rests and positions --------------------

    def _rests(self, blocks: Blocks) -> tuple[list[Rest], Rest | None]:
        """The rests so far with the one that lasts, and this."""
        now = calm_since(blocks, self._limits) if self._limits is not None else None
        current = None
        if now is not None:
            cut = self._after_cuts(blocks, now)
            current = rest_of(blocks, cut, len(blocks)) if cut is not None else None
        ended = [(span.first, span.last) for span in self._spans if now is None or span.last <= now]
        self._closed = {each: self._closed.get(each) or rest_of(blocks, *each) for each in ended}
        closed = list(self._closed.values())
        return (closed if current is None else [*closed, current]), current

    def _after_cuts(self, blocks: Blocks, first: int) -> int | None:
        """The first block of a rest that lasts after what is left out of it; None if nothing is left."""
        for one in self._excluded:
            if one.start is not None and one.stop is not None and one.stop > blocks.edges[first]:
                if math.isinf(one.stop) and one.start <= blocks.edges[-1]:
                    return None
                if one.start < blocks.edges[-1]:
                    first = max(first, int(np.searchsorted(blocks.edges, one.stop - 1e-9)))
        return first if len(blocks) - first >= 3 else None

    def _judge(self, rest: Rest) -> Judged:
        """How good a rest is; of a rest that lasts, anew from second to second."""
        key = rest.first, rest.last // 5
        if key not in self._judged:
            self._judged = {k: v for k, v in self._judged.items() if k[0] != rest.first}
            self._judged[key] = self._judged_now(rest)
        return self._judged[key]

    def _judged_now(self, rest: Rest) -> Judged:
        assert self._chain is not None
        assert self._reduction is not None
        known = self._chain.known(self._reduction, rest.first, rest.last)
        seconds = rest.stop - rest.start
        if known is None:
            return Judged(known=None, left=None, enough=False, nothing_more=False)
        over = known.accel / self.rest_wanted[0]
        if known.gyro is not None:
            over = max(over, known.gyro / self.rest_wanted[1])
        left = max(seconds * (over**2 - 1.0), SHORTEST_REST - seconds, 0.0)
        flat = known.twice > NOTHING_MORE and seconds > 10.0
        return Judged(known=known, left=left, enough=left <= 0.0 or flat, nothing_more=flat)

    # -------------------- the state --------------------

    def _state(self) -> dict[str, Any]:
        state = self._header()
        blocks = self._blocks
        if blocks is None or len(blocks) < 10 or self._limits is None:
            return state | {"screen": "waiting", "headline": "Waiting for data", "fault": None}
        rests, current = self._rests(blocks)
        self._close_exclusion(blocks, current)
        groups = grouped(blocks, rests)
        fault = self._fault(blocks, groups, current)
        self._ask_for_estimate(current)
        state |= {
            "seconds": float(blocks.edges[-1]),
            "scatter": {"now": scatter_now(blocks), "limit": self._limits.scatter},
            "sphere": self._sphere(groups),
            "temperature": None if blocks.temperature is None else float(blocks.temperature[-10:].mean() - 273.15),
            "to_go": self._to_go(groups, current),
            "message": self._still_said(fault),
        }
        if fault is not None:
            said = {"kind": fault.kind, "said": fault.said, "at": fault.start, "choices": list(fault.choices)}
            return state | {"screen": "fault", "headline": "Not good", "fault": said, **self._where(groups, current)}
        return state | {"fault": None} | self._screen(blocks, groups, current)

    def _still_said(self, fault: Fault | None) -> str:
        """What was answered last, until something else is wrong."""
        if fault is not None and _key(fault) != self._wrong:
            self._message = ""
        self._wrong = None if fault is None else _key(fault)
        return self._message

    def _header(self) -> dict[str, Any]:
        intake = self.intake.received if self.intake is not None else None
        return {
            "unit": {"serial": self.session.device.serial, "model": self.session.device.model},
            "session": self.folder.name,
            "listening": intake is not None and not intake.ended,
            "received": {
                "source": self._source_name(),
                "samples": self._samples,
                "rate": None if self._clock.interval is None else 1.0 / self._clock.interval,
                "lost": self._lost,
                "refused": 0 if intake is None else intake.refused,
                "why": "" if intake is None else intake.last_refused,
                "late": 0 if intake is None else intake.late,
                "repeated": 0 if intake is None else intake.repeated,
                "ended": intake is not None and intake.ended,
                "trouble": [] if intake is None else list(intake.trouble),
            },
            "programme": None if self.programme is None else self.programme.name,
            "positions": None if self.programme is None else len(self.programme.positions),
            "estimate": self._estimate,
            "estimating": self._future is not None,
            "result": self._result,
            "calibrating": self._calibrating,
            "message": self._message,
            "excluded": len(self.session.excluded) + len(self._cut),
            "table": hasattr(self.intake.source, "knock") if self.intake is not None else False,
        }

    def _source_name(self) -> str:
        if self.intake is not None:
            return self.intake.source.name
        return "the log of another program" if self._listen is None else "recording has stopped"

    def _where(self, groups: list[list[Rest]], current: Rest | None) -> dict[str, Any]:
        """Which position the unit is in, or is to be in next."""
        taken, total = len(groups), None if self.programme is None else len(self.programme.positions)
        at = taken - 1 if current is not None else taken
        return {"rest": {"number": at + 1, "of": total}, "position": self._position(self._index(groups, at), at)}

    def _index(self, groups: list[list[Rest]], at: int) -> int | None:
        """The position of the programme that group `at` is, or is to be."""
        if self.programme is None:
            return None
        if self.programme.ordered:
            return at if at < len(self.programme.positions) else None
        if not groups:
            return 0
        units = verticals([group[-1] for group in groups], self.programme, self.session.site.gravity)
        seen = nearest_positions(self.programme, units)
        if at < len(seen):
            return seen[at]
        return next((k for k in range(len(self.programme.positions)) if k not in seen), None)

    def _position(self, index: int | None, at: int) -> dict[str, Any] | None:
        if self.programme is None or index is None:
            return None
        position = self.programme.positions[index]
        move = self._move(index) if at else ANY_MOVE
        x, y, z = points_of(position)
        return {
            "number": index + 1,
            "label": position.label,
            "points": {"X": x, "Y": y, "Z": z},
            "move": move_text(move),
            "angle": None if move.angle is None else signed_angle(move.angle),
            "picture": f"picture/{index}.svg?{hashlib.sha256(position.attitude.encode()).hexdigest()[:8]}",
        }

    def _move(self, index: int) -> Move:
        ordered = self.programme is not None and self.programme.ordered and 0 < index <= len(self.programme.moves)
        return self.programme.moves[index - 1] if ordered and self.programme is not None else ANY_MOVE

    def _screen(self, blocks: Blocks, groups: list[list[Rest]], current: Rest | None) -> dict[str, Any]:
        total = None if self.programme is None else len(self.programme.positions)
        if current is None:
            done = total is not None and len(groups) >= total
            if not groups:
                return {"screen": "waiting", "headline": "Waiting for rest", **self._where(groups, current)}
            return self._done(groups) if done else self._turn(blocks, groups)
        judged = self._judge(current)
        if not judged.enough:
            return self._at_rest(blocks, groups, current, judged)
        enough = bool(self._estimate and self._estimate["enough"]) and len(groups) > self._go_on_after
        if enough or (total is not None and len(groups) >= total):
            return self._done(groups)
        return self._turn(blocks, groups)

    def _at_rest(self, blocks: Blocks, groups: list[list[Rest]], current: Rest, judged: Judged) -> dict[str, Any]:
        where = self._where(groups, current)
        drift = _drift(blocks.force[current.first : current.last])
        known = judged.known
        settling = known is not None and float(np.abs(drift).max()) > _SETTLING * known.accel
        of = f" of {where['rest']['of']}" if where["rest"]["of"] else ""
        return {
            "screen": "rest",
            "headline": f"At rest {where['rest']['number']}{of}: hold still",
            "position": where["position"],
            "rest": where["rest"]
            | {
                "seconds": current.stop - current.start,
                "left": judged.left,
                "u": None if known is None else known.accel / G_STANDARD * 1e6,
                "wanted": self.rest_wanted[0] / G_STANDARD * 1e6,
                "gyro_u": None if known is None or known.gyro is None else known.gyro / DEGREE * 3600.0,
                "gyro_wanted": self.rest_wanted[1] / DEGREE * 3600.0,
                "drift": float(np.abs(drift).max()) / G_STANDARD * 1e6,
                "settling": settling,
                "nothing_more": judged.nothing_more,
            },
        }

    def _turn(self, blocks: Blocks, groups: list[list[Rest]]) -> dict[str, Any]:
        last, at = groups[-1][-1], len(groups)
        index = self._index(groups, at)
        turned = turned_between(blocks, last.last, len(blocks), last.rate)
        rate = None if blocks.rate is None or last.rate is None else blocks.rate[-3:].mean(axis=0) - last.rate
        move = ANY_MOVE if index is None else self._move(index)
        full = None if self.session.log.gyro is None else self.session.log.gyro.range
        before = None if index is None or self.programme is None or not index else self.programme.positions[index - 1]
        done = None if turned is None else float(np.linalg.norm(turned))
        if turned is not None and before is not None and move.axis is not None:
            done = float(turned @ (before.matrix.T @ move.axis))
        label = "to any new position" if index is None else f"to position {index + 1}"
        early = not self._judge(last).enough
        slow = None if rate is None or turned is None else float(np.linalg.norm(rate))
        calm = self._limits is not None and calm_since(blocks, self._limits) is not None
        slowly = slow is not None and slow < STILL_TURNING and not calm
        arrived = slowly and done is not None and _arrived(move, done)
        headline = "Hold still: the unit is not yet at rest" if arrived else f"Turn now {label}"
        return {
            "screen": "turn",
            "headline": headline,
            "rest": {"number": at + 1, "of": None if self.programme is None else len(self.programme.positions)},
            "position": self._position(index, at),
            "early": f"rest {at} was left before the wanted u" if early else "",
            "turn": {
                "done": None if done is None else done / DEGREE,
                "angle": None if move.angle is None else move.angle / DEGREE,
                "rate": None if rate is None else float(np.linalg.norm(rate)) / DEGREE,
                "full_scale": None if full is None else full / DEGREE,
            },
        }

    def _to_go(self, groups: list[list[Rest]], current: Rest | None) -> float | None:
        """The time, s, that the positions of the programme still take, as long each as those before were on average;
        None where that is not known."""
        if self.programme is None or not groups:
            return None
        left = self._judge(current).left if current is not None else 0.0
        further = max(0, len(self.programme.positions) - len(groups))
        if left is None or (further and len(groups) < 2):
            return None
        each = (groups[-1][0].start - groups[0][0].start) / (len(groups) - 1) if further else 0.0
        return left + further * each

    def _done(self, groups: list[list[Rest]]) -> dict[str, Any]:
        count = len(groups)
        enough = bool(self._estimate and self._estimate["enough"])
        all_taken = self.programme is not None and count >= len(self.programme.positions)
        said = f"All wanted u reached at rest {count}" if enough else f"All {count} positions taken"
        return {
            "screen": "done",
            "headline": f"{said}; five more would make it {better_by(count):.1f} times better",
            "rest": {"number": count, "of": None if self.programme is None else len(self.programme.positions)},
            "position": None,
            "complete": all_taken,
        }

    def _sphere(self, groups: list[list[Rest]]) -> dict[str, Any]:
        """Directions of the vertical that were taken, and those of DIRECTIONS that were not, with what each leaves."""
        taken = [group[-1].vertical.tolist() for group in groups]
        return {"taken": taken, "gains": None if self._estimate is None else self._estimate["gains"]}

    # -------------------- faults --------------------

    def _fault(self, blocks: Blocks, groups: list[list[Rest]], current: Rest | None) -> Fault | None:
        """The first fault that is not answered."""
        every = [
            *self._faults,
            *self._knocks(groups, current),
            *self._misplaced(blocks, groups, current),
            *self._unsteady(blocks, groups, current),
        ]
        return next((fault for fault in every if _key(fault) not in self._answered), None)

    def _knocks(self, groups: list[list[Rest]], current: Rest | None) -> list[Fault]:
        if current is None or not groups or len(groups[-1]) < 2:
            return []
        before = groups[-1][-2]
        if self._judge(before).enough or current.start - before.stop > KNOCK_SECONDS:
            return []
        said = f"knock at {before.stop:.1f} s, {before.stop - before.start:.0f} s into this rest"
        choices = ("again", "keep_first", "go_on")
        return [Fault(kind="knock", said=said, start=before.start, stop=before.stop, kept=True, choices=choices)]

    def _unsteady(self, blocks: Blocks, groups: list[list[Rest]], current: Rest | None) -> list[Fault]:
        """A rest put down with movement, and a temperature that has drifted since the first rest."""
        if not groups:
            return []
        moved = None
        if current is not None:
            moved = put_down_fault(blocks, current, len(groups), self.rest_wanted[0])
        return [fault for fault in (moved, warmed_fault(blocks, groups[0][0], self._temperature_limit)) if fault]

    def _misplaced(self, blocks: Blocks, groups: list[list[Rest]], current: Rest | None) -> list[Fault]:
        listed = self.programme
        if listed is None or not groups:
            return []
        last = [group[-1] for group in groups]
        units = verticals(last, listed, self.session.site.gravity)
        if not listed.ordered:
            return [*_unordered_faults(listed, last, units)]
        out = []
        for k, (unit, rest) in enumerate(zip(units, last, strict=True)):
            if k >= len(listed.positions):
                said = f"one position more than the programme's {len(listed.positions)}"
                out.append(Fault(kind="surplus", said=said, start=rest.start, stop=rest.stop))
                break
            found = position_fault(listed, k, unit, rest)
            if found is None and k:
                turned = turned_between(blocks, last[k - 1].last, groups[k][0].first, last[k - 1].rate)
                before, move = listed.positions[k - 1], listed.moves[k - 1]
                found = turn_fault(move, before, turned, groups[k][0].start, rest.stop)
            if found is not None:
                out.append(found)
                break
        return out or self._going_wrong(blocks, groups, current)

    def _going_wrong(self, blocks: Blocks, groups: list[list[Rest]], current: Rest | None) -> list[Fault]:
        """A turn under way that goes against its sense."""
        listed, k = self.programme, len(groups)
        if listed is None or current is not None or k >= len(listed.positions):
            return []
        last = groups[-1][-1]
        turned = turned_between(blocks, last.last, len(blocks), last.rate)
        if turned is None or against(listed.moves[k - 1], listed.positions[k - 1], turned) < WRONG_WAY:
            return []
        said = f"this is the wrong way: wanted {move_text(listed.moves[k - 1])}; turn back"
        return [Fault(kind="turning wrong", said=said, start=last.stop, stop=last.stop, choices=("go_on",))]

    def _close_exclusion(self, blocks: Blocks, current: Rest | None) -> None:
        """End what is left out until the unit is moved, when it is."""
        now = None if self._limits is None else calm_since(blocks, self._limits)
        if self._open is None or now is not None or current is not None:
            return
        ended = replace(self._open, stop=float(blocks.edges[-1]))
        folders.leave_out(self.folder, ended, instead_of=self._open)
        self._cut = [ended if one == self._open else one for one in self._cut]
        self._open = None

    # -------------------- estimates --------------------

    def _ask_for_estimate(self, current: Rest | None) -> None:
        """Have an estimate made when there is another rest to make it from."""
        if self._future is not None or self._chain is None or self._reduction is None:
            return
        spans = self._spans
        if current is not None and spans and spans[-1].last > current.first and not self._judge(current).enough:
            spans = spans[:-1]
        key = tuple(span.first for span in spans), len(self._excluded)
        if key == self._estimated or len(spans) < 2:
            return
        self._estimated = key
        self._future = self._worker.submit(self._made, self._chain, self._reduction, spans, self._excluded)

    def _made(
        self, chain: Chain, reduction: Reduction, spans: tuple[RestSpan, ...], excluded: tuple[Exclusion, ...]
    ) -> dict[str, Any]:
        began = time.thread_time()
        estimate = chain.estimate(reduction, spans, excluded)
        if estimate is None:
            return _NO_ESTIMATE | {"rests": len(spans)}
        found = reached(estimate, self.wanted)
        site, wanted = self.session.site, self.wanted
        left = gains(estimate, wanted, self.session.accel_block, self.rest_wanted[0], site.gravity)
        best = int(np.argmin(left))
        return {
            "rests": len(spans),
            "groups": [group.shown() for group in found],
            "enough": all(group.enough for group in found),
            "residuals": _residuals(estimate),
            "gains": left.tolist(),
            "next": f"{_upwards(DIRECTIONS[best])}: accelerometers to {100.0 * left[best]:.0f} % of u",
            "cause": _cause(estimate, spans),
            "unknowns": len(estimate.names),
            "seconds": time.thread_time() - began,
        }

    # -------------------- what the operator says --------------------

    def command(self, name: str, value: str = "") -> str:
        """Do what a button asks for; what came of it, in a sentence."""
        if name == "calibrate":
            return self._calibrate()
        with self._guard:
            action = getattr(self, f"_do_{name}", None)
            if action is None:
                return "no such command"
            if self._calibrating:
                return "calibrating: wait until it is done"
            try:
                self._message = action(value)
            except (TumbleError, OSError) as error:
                self._message = " ".join(str(error).split())
            return self._message

    def _calibrate(self) -> str:
        """Stop recording and calibrate; the page goes on meanwhile."""
        with self._guard:
            if self._calibrating:
                return "calibrating: wait until it is done"
            self._do_stop("")
            self._calibrating, self._message = True, "calibrating …"
        result = None
        try:
            calibration = ending.calibrated(self.folder)
            said = "calibrated: accepted" if calibration.outcome.accepted else "calibrated: not accepted"
            result = {
                "accepted": calibration.outcome.accepted,
                "reasons": list(calibration.outcome.reasons),
                "parameters": len(calibration.parameters),
                "files": [ending.CALIBRATION_FILE],
                "registered": "",
            }
        except (TumbleError, OSError) as error:
            said = " ".join(str(error).split())
        with self._guard:
            self._calibrating, self._message = False, said
            self._result = result or self._result
        return said

    def _present_fault(self) -> Fault | None:
        if self._blocks is None or self._limits is None:
            return None
        rests, current = self._rests(self._blocks)
        return self._fault(self._blocks, grouped(self._blocks, rests), current)

    def _leave_out(self, start: float, reason: str, *, until_moved: bool) -> None:
        assert self._blocks is not None
        one = Exclusion(start=start, stop=max(float(self._blocks.edges[-1]), start + 1e-3), reason=reason)
        folders.leave_out(self.folder, one)
        self._cut.append(one)
        if until_moved:
            self._open = one

    def _do_again(self, _: str) -> str:
        fault = self._present_fault()
        if fault is None:
            return "nothing is wrong"
        self._answered.add(_key(fault))
        here = fault.kind in ("knock", "movement")
        self._leave_out(fault.start, fault.said, until_moved=not here)
        return "left out; hold still, this rest begins anew" if here else "left out; take it again"

    def _do_keep_first(self, _: str) -> str:
        fault = self._present_fault()
        if fault is None or not fault.kept:
            return "there is no first part"
        self._answered.add(_key(fault))
        self._leave_out(fault.stop, fault.said, until_moved=True)
        return "the first part is kept; go on to the next position"

    def _do_go_on(self, _: str) -> str:
        fault = self._present_fault()
        if fault is not None:
            self._answered.add(_key(fault))
            return "noted; nothing is left out"
        self._go_on_after = 10**6
        return "going on"

    def _do_leave_out(self, number: str) -> str:
        if not number.isdigit() or not 0 < int(number) <= len(self._spans):
            return f"expected the number of a rest from 1 to {len(self._spans)}"
        one = Exclusion(rest=int(number), reason="left out at the bench")
        folders.leave_out(self.folder, one)
        self._cut.append(one)
        return f"rest {number} is left out"

    def _do_take_back(self, _: str) -> str:
        if not self._cut:
            return "nothing was left out here"
        one = self._cut.pop()
        folders.take_back(self.folder, one)
        self._open = None if self._open == one else self._open
        return "taken back"

    def _do_stop(self, _: str) -> str:
        if self.intake is not None:
            self.intake.stop()
            self.intake = None
        return "recording has stopped"

    def _do_resume(self, _: str) -> str:
        if self.intake is None:
            self._result = None
            self._record()
        return "recording goes on"

    def _do_report(self, _: str) -> str:
        return self._filed(ending.report_of(self.folder))

    def _do_export(self, to: str) -> str:
        return self._filed(ending.exported(self.folder, to))

    def _do_register(self, _: str) -> str:
        if self._result is None:
            return "nothing is calibrated yet"
        said = ending.registered(self.folder, self._registry)
        self._result = self._result | {"registered": said}
        return said

    def _filed(self, name: str) -> str:
        if self._result is not None and name not in self._result["files"]:
            self._result = self._result | {"files": [*self._result["files"], name]}
        return f"written: {name}"

    def _do_next_unit(self, serial: str) -> str:
        if not serial.strip():
            return "expected the serial number of the next unit"
        self._do_stop("")
        made = folders.begin_next(self.folder, serial.strip())
        self._begin(made)
        self._record()
        return f"next unit: {serial.strip()}"

    def _do_table(self, what: str) -> str:
        """Turn the virtual table: "N+90", "to 3", "knock", "lose", "stick"."""
        table: Any = None if self.intake is None else self.intake.source
        if not hasattr(table, "knock"):
            return "there is no virtual table"
        if what in ("knock", "lose", "stick"):
            getattr(table, what)()
        elif what.startswith("to ") and what[3:].isdigit() and 0 < int(what[3:]) <= len(table.programme.positions):
            table.go_to(int(what[3:]) - 1)
        elif what[:1] in ("N", "U", "E"):
            with contextlib.suppress(ValueError):
                table.turn(what[0], float(what[1:]))
        return ""

    # -------------------- what is fetched beside the state --------------------

    def trace(self, since: int) -> dict[str, Any]:
        """Block means from number `since` on, at most the last minute: s, m/s² and °/s."""
        blocks = self._blocks
        if blocks is None:
            return {"next": 0, "anew": True, "t": [], "a": [], "g": []}
        anew = since == 0 or since > len(blocks)
        first = max(0 if anew else since, len(blocks) - _TRACE)
        rate = blocks.rate
        return {
            "next": len(blocks),
            "anew": anew,
            "t": np.round(blocks.edges[first + 1 : len(blocks) + 1], 3).tolist(),
            "a": np.round(blocks.force[first:].T, 5).tolist(),
            "g": [] if rate is None else np.round(rate[first:].T / DEGREE, 4).tolist(),
        }

    def file(self, name: str) -> Path | None:
        """A result that can be fetched."""
        known = self._result is not None and name in self._result["files"]
        return self.folder / name if known else None


def _programme_of(session: Session) -> Programme | None:
    spec = session.programme
    if spec is None:
        return None
    return built_in(spec.name) if spec.name is not None else from_attitudes([p.attitude for p in spec.positions])


def _arrived(move: Move, done: float) -> bool:
    """Whether a turn has gone so far that it may be over."""
    return abs(done - move.angle) < NEARLY if move.angle is not None else done > 2.0 * NEARLY


def _key(fault: Fault) -> tuple[str, int]:
    return fault.kind, round(fault.start)


def _unordered_faults(listed: Programme, rests: list[Rest], units: Array) -> list[Fault]:
    """Rests that are no position of a programme in any order."""
    return [
        Fault(kind="wrong position", said=f"this is no position of {listed.name}", start=rest.start, stop=rest.stop)
        for rest, k in zip(rests, nearest_positions(listed, units), strict=True)
        if k is None
    ]


def _drift(series: Array) -> Array:
    """Change of block means (K, n) over their time: least-squares slope times duration."""
    x = np.arange(len(series)) - 0.5 * (len(series) - 1)
    return np.asarray(x @ series / max(float(x @ x), 1.0) * len(series))


def _residuals(estimate: Estimate) -> list[dict[str, float]]:
    return [
        {"sigmas": float(s), "residual": float(r) / G_STANDARD * 1e6}
        for s, r in zip(estimate.rest_sigmas, estimate.rest_residual, strict=True)
        if math.isfinite(s)
    ]


def _cause(estimate: Estimate, spans: tuple[RestSpan, ...]) -> str:
    """What does not fit, and what may be the cause."""
    if not estimate.converged:
        return "the readings contradict each other: are the axes, their senses and the units right?"
    rest, turn = np.nan_to_num(estimate.rest_sigmas), np.nan_to_num(estimate.turn_sigmas)
    if len(rest) and rest.max() > FIT_SIGMAS:
        k = int(np.argmax(rest))
        return f"rest {k + 1} ({spans[k].start:.0f} s) does not fit by {rest[k]:.0f}σ: moved, knocked or still settling"
    if len(turn) and turn.max() > FIT_SIGMAS:
        k = int(np.argmax(turn))
        return f"turn {k + 1} does not fit by {turn[k]:.0f}σ: clipped, samples lost, or a knock in it"
    return ""


def _upwards(d: Array) -> str:
    """A direction of the vertical in the body, in words: "X up, Z down"."""
    return ", ".join(f"{name} {'up' if v > 0 else 'down'}" for name, v in zip("XYZ", d, strict=True) if abs(v) > 0.1)
