"""Screens of the page as a function of the task, the progress, the fault, and the estimate (None before the first)."""

from __future__ import annotations

import hashlib
import math
import tomllib
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from tumble.bench.follow.faults import Fault
from tumble.bench.follow.progress import SHORTEST_REST, Blocks, Progress, attitude_now, nearest_positions, verticals
from tumble.bench.follow.task import Task
from tumble.bench.state import Answer, EstimateShown, PositionShown, RestShown, Screen, State, Trace
from tumble.programme.positions import ANY_MOVE
from tumble.programme.sheet import ghost
from tumble.programme.sheet_words import move_text, points_of, signed_angle
from tumble.reduction.rests.rests import drift
from tumble.units import DEGREE, G_STANDARD, ZERO_CELSIUS
from tumble.usual_setup import MOVE

SETTLING_RATE = 3.0 * DEGREE  # rad/s; a nearly complete turn below it is the motion of a unit just put down
NEARLY_DONE = 10.0 * DEGREE  # rad, from the end of a turn
_SETTLING_DRIFT = 20.0  # in units of u, drift over a rest that noise does not explain; white noise gives √12
_TRACE_BLOCKS = 600
MAX_FORECAST = 9.0
"""Longest forecast of the end of a rest, in units of its duration. At its beginning u is known to about 20 %, so the
required time, proportional to u², only to about half."""
_FURTHER_RESTS = 5  # for which the improvement of the estimate is predicted by the root of the number of rests

WAITING: Screen = {"screen": "waiting", "headline": "Waiting for data", "fault": None}
"""Screen before there are enough data to find rests."""


def screen(
    task: Task, progress: Progress, fault: Fault | None, estimate: EstimateShown | None, *, go_on: bool
) -> Screen:
    """Return the screen with the content common to all. With `go_on` recording continues though all wanted u are
    reached."""
    blocks, groups, current = progress.blocks, progress.groups, progress.current
    complete = task.positions is not None and len(groups) >= task.positions
    specific: Screen
    if fault is not None:
        specific = {"screen": "fault", "headline": "Not good", **_position_content(task, progress, fault.place)}
        specific["fault"] = asdict(fault)
    elif not groups:
        specific = {"screen": "waiting", "headline": "Waiting for rest", **_position_content(task, progress)}
    elif current is not None and not progress.judged[-1].enough:
        specific = _at_rest(task, progress)
    elif complete or (current is not None and estimate is not None and estimate["enough"] and not go_on):
        specific = _done(task, len(groups), estimate, complete=complete)
    else:
        specific = _turn(task, progress)

    # remaining time of the programme, s: a position takes the median of its planned time (rest and move) and the times
    # of earlier positions; the first rest, which may be a warm-up, counts at most as planned
    to_go = None
    if task.positions is not None and groups:
        rest = max(task.wanted.rest, SHORTEST_REST)
        starts = [group[0].start for group in groups]
        starts[0] = max(starts[0], groups[0][-1].stop - rest)
        per_position = float(np.median([rest + MOVE, *np.diff(starts)]))
        remaining, since = max(0, task.positions - len(groups)), progress.now - groups[-1][0].start
        to_go = max(0.0, rest - since)
        if remaining:
            to_go = max(0.0, per_position - since) + (remaining - 1) * per_position + rest
    common: Screen = {
        "seconds": progress.now,
        "scatter": {
            "now": float(np.sqrt(blocks.force[-10:].var(axis=0).sum())),
            "limit": math.inf if progress.so_far is None else progress.so_far.scatter_limit,
        },
        "sphere": {
            "taken": [group[-1].vertical.tolist() for group in groups],
            "gains": None if estimate is None else estimate["gains"],
        },
        "temperature": None if blocks.temperature is None else float(blocks.temperature[-10:].mean() - ZERO_CELSIUS),
        "to_go": to_go,
        "fault": None,
    }
    return common | specific


def _position_content(task: Task, progress: Progress, place: int | None = None) -> Screen:
    """Return rest number and position of the unit at a place in the course, from 0, by default the present one."""
    at = len(progress.groups) - (1 if progress.current is not None else 0) if place is None else place
    index = _position_index(task, progress, at)
    rest: RestShown = {"number": at + 1, "of": task.positions}
    if task.programme is None or index is None:
        return {"rest": rest, "position": None}
    position, move = task.programme.positions[index], task.move(index) if at else ANY_MOVE
    x, y, z = points_of(position)
    attitude = attitude_now(task.programme, progress, index, at)
    shown: PositionShown = {
        "number": index + 1,
        "label": position.label,
        "points": {"X": x, "Y": y, "Z": z},
        "move": "" if not at else "any way you like" if move is ANY_MOVE else move_text(move),
        "angle": None if move.angle is None else signed_angle(move.angle),
        "picture": f"picture/{index}.svg?{hashlib.sha256(position.attitude.encode()).hexdigest()[:8]}",
        "ghost": None if attitude is None else ghost(attitude),
    }
    return {"rest": rest, "position": shown}


def _position_index(task: Task, progress: Progress, at: int) -> int | None:
    """Return the index of the programme's position for group `at` of rests."""
    programme, rests = task.programme, [group[-1] for group in progress.groups]
    if programme is None or (programme.ordered and at >= len(programme.positions)):
        return None
    if programme.ordered:
        return at
    taken: list[int | None] = []
    if rests:
        taken = nearest_positions(programme, verticals(rests, programme, task.session.site.gravity))
    return taken[at] if at < len(taken) else next((k for k in range(len(programme.positions)) if k not in taken), None)


def _at_rest(task: Task, progress: Progress) -> Screen:
    current, judged, wanted = progress.groups[-1][-1], progress.judged[-1], task.wanted
    content, seconds = _position_content(task, progress), current.stop - current.start
    drifted = float(np.abs(drift([progress.blocks.force[current.first : current.last]])).max())
    has_forecast = judged.left is not None and judged.left <= MAX_FORECAST * seconds
    content["rest"] |= {
        "seconds": seconds,
        "left": judged.left if has_forecast else None,
        "u": None if judged.accel is None else judged.accel / G_STANDARD * 1e6,
        "wanted": wanted.accel / G_STANDARD * 1e6,
        "gyro_u": None if judged.gyro is None else judged.gyro / DEGREE * 3600.0,
        "gyro_wanted": wanted.gyro / DEGREE * 3600.0,
        "drift": drifted / G_STANDARD * 1e6,
        "settling": judged.accel is not None and drifted > _SETTLING_DRIFT * judged.accel,
        "nothing_more": judged.nothing_more,
    }
    total = f" of {task.positions}" if task.positions else ""
    return {"screen": "rest", "headline": f"At rest {content['rest']['number']}{total}: hold still", **content}


def _turn(task: Task, progress: Progress) -> Screen:
    """Return the screen of a turn, with its angle about the axis of the programme's turn, if there is one."""
    blocks, last, at = progress.blocks, progress.groups[-1][-1], len(progress.groups)
    index = _position_index(task, progress, at)
    turn, turned, rate = task.turn_b(index), progress.turned, None
    done = None if turned is None else float(np.linalg.norm(turned) if turn is None else turned @ turn[0])
    angle = None if turn is None else turn[1]
    if blocks.rate is not None and last.rate is not None:
        rate = float(np.linalg.norm(blocks.rate[-3:].mean(axis=0) - last.rate))
    arrived = False
    if done is not None and rate is not None and rate < SETTLING_RATE and not progress.still:
        arrived = abs(done - angle) < NEARLY_DONE if angle is not None else done > 2.0 * NEARLY_DONE
    label = "to any new position, the long way round" if index is None else f"to position {index + 1}"
    full = None if task.session.log.gyro is None else task.session.log.gyro.range
    degrees = [None if value is None else value / DEGREE for value in (done, angle, rate, full)]
    return {
        "screen": "turn",
        "headline": "Hold still: the unit is not yet at rest" if arrived else f"Turn now {label}",
        **_position_content(task, progress, at),
        "early": "" if progress.judged[-1].enough else f"rest {at} was left before its mean was known well enough",
        "turn": {"done": degrees[0], "angle": degrees[1], "rate": degrees[2], "full_scale": degrees[3]},
    }


def _done(task: Task, taken: int, estimate: EstimateShown | None, *, complete: bool) -> Screen:
    """Return the last screen; `complete` if all positions of the programme are taken.

    `missed` are the groups whose wanted u is not reached, None while no estimate has all rests."""
    missed = None
    if estimate is not None and estimate["rests"] >= taken:
        missed = [group["group"] for group in estimate["groups"] if not group["enough"]]
    if estimate is not None and estimate["enough"]:
        better = math.sqrt((taken + _FURTHER_RESTS) / taken)
        headline = f"All that is wanted is reached at rest {taken}; five more would make it {better:.1f} times better"
    elif missed:
        headline = f"All {taken} positions taken; not reached: {', '.join(missed)}"
    else:
        headline = f"All {taken} positions taken; the estimate is being made"
    return {
        "screen": "done",
        "headline": headline,
        "rest": {"number": taken, "of": task.positions},
        "position": None,
        "complete": complete,
        "missed": missed,
    }


# -------------------- buttons --------------------

_ANEW = "Record this unit anew", "in a folder of its own beside this one"
_WORDS: Mapping[str, Any] = tomllib.loads((Path(__file__).parent / "answers.toml").read_text(encoding="utf-8"))
"""Texts of the buttons that answer a fault."""


def answers(state: State) -> list[Answer]:
    """Return the buttons of a state with their effects; at most one, the usual answer, is `primary`."""
    if state["calibrating"]:
        return []
    offered: dict[str, tuple[str, str]] = {}
    fault, ended, usual = state["fault"], state["received"]["ended"], ""
    if state["result"] is not None:
        if state["can_record"] and not ended:
            offered["resume"] = "Record on", "in the same folder; this result is dropped"
        if state["can_record"] and not state["result"]["accepted"]:
            offered["anew"] = _ANEW
    elif state["can_record"] and not state["listening"] and not ended:
        offered["resume"] = "Record on", "in the same folder, where it stopped"
        offered["calibrate"] = "Calibrate", "what is recorded so far"
        usual = "resume"
    elif fault is not None:
        position = state.get("position")
        label, says = _WORDS["left_out"].get(fault["kind"], ("Leave this out", ""))
        wanted = f"position {position['number']}" if position else "a new position"
        buttons = {
            "again": (label, says.format(wanted=wanted)),
            "unit": (f"Yes, in {fault['unit']}", "the session is changed, and what is recorded is read anew"),
            "keep_first": ("Keep the first part", "the rest ends at the knock; go on to the next position"),
            "anew": _ANEW,
            "go_on": ("Go on", _WORDS["going_on"].get(fault["kind"], "nothing is left out: where the page is wrong")),
        }
        offered = {name: buttons[name] for name in fault["choices"]}
        usual = _WORDS["usual"].get(fault["kind"], fault["choices"][0])
    elif state["screen"] == "done":
        offered["calibrate"] = "Stop and calibrate", "recording ends"
        if not state["complete"]:
            offered["go_on"] = "Go on", "for more positions"
        usual = "calibrate"
    elif ended:
        offered["calibrate"] = "Calibrate", "the source has ended"
        usual = "calibrate"
    if state["result"] is None and state["estimate"] and "calibrate" not in offered:
        rest = state.get("rest") or {"number": 0, "of": None}
        total, number = rest["of"], rest["number"]
        short = f"; {total - number + 1} of {total} positions are not taken" if total and number <= total else ""
        offered["calibrate"] = "Stop and calibrate", f"recording ends{short}"
    return [{"do": do, "label": label, "says": says, "primary": do == usual} for do, (label, says) in offered.items()]


# -------------------- trace --------------------


def trace(blocks: Blocks | None, since: int) -> Trace:
    """Return block means from number `since` on, at most the last minute: s, m/s² and °/s."""
    if blocks is None:
        return {"next": 0, "anew": True, "t": [], "a": [], "g": []}
    anew = since == 0 or since > len(blocks)
    first = max(0 if anew else since, len(blocks) - _TRACE_BLOCKS)
    rate = blocks.rate
    return {
        "next": len(blocks),
        "anew": anew,
        "t": np.round(blocks.edges[first + 1 : len(blocks) + 1], 3).tolist(),
        "a": np.round(blocks.force[first:].T, 5).tolist(),
        "g": [] if rate is None else np.round(rate[first:].T / DEGREE, 4).tolist(),
    }
