"""Recordings over temperature that are planned, as the likelihood sees them.

The rows are those of several sessions together (`tumble.inference.likelihood`) at perfect sensors and the attitudes of
their programmes, with the thermometer's course in each. Rests and turns are those that a log gives: the segmentation
takes a margin off each end of a rest, which belongs to the turn, a turn has its ramps, and rests that warm are taken in
parts where several sessions are one estimate.

A lag λ acts through the slopes, and perfect sensors have none: it is taken to act on a typical instrument, all of whose
slopes are of the usual size, and which lags by TYPICAL of the usual,

    ∂ŷ/∂λ = Σ_m ∂ŷ/∂θ_m t1_m ∂T/∂λ

so that what it adds to u² is what it adds on the average over instruments. Without any lag a ramp would not show it
where it begins.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from tumble.inference.likelihood import Point, Problem, Rows, instruments_of
from tumble.inference.linearisation import linearise
from tumble.inference.turns_about import TurnsAbout
from tumble.planning.bounds import Course, instrument_of, observed
from tumble.planning.setup import Setup
from tumble.programme.positions import ANY_MOVE, Programme
from tumble.reduction.blocks.tuning import USUAL
from tumble.reduction.observations import Observations, Together
from tumble.reduction.rests.thermometer import Thermometers
from tumble.reduction.together import MOST_PARTS, SHORTEST_PART, WARMED, held
from tumble.sensors.instrument import Instrument
from tumble.units import Array

TYPICAL = 0.5
"""The lag of a typical instrument, in parts of the usual size."""
NO_TIME = 1e-6
"""s, of what is between the parts of a rest."""

CourseOfTemperature = Callable[[float], tuple[Array, Array]]
"""From how long a recording takes, s, to times (K,), s, from its start and the temperatures (K,), K, of its
thermometer, straight between them."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ChamberSession:
    """A recording that is planned: what it is called, the positions it goes through and its temperature."""

    name: str
    programme: Programme
    course: CourseOfTemperature


def rests_of(programme: Programme, count: int) -> Programme:
    """The first so many positions of a programme; of more than it has, it begins anew."""
    positions = [programme.positions[i % len(programme.positions)] for i in range(count)]
    moves = [*programme.moves, ANY_MOVE]
    return replace(
        programme,
        positions=tuple(positions),
        moves=tuple(moves[i % len(moves)] for i in range(count - 1)),
    )


def problem_of(
    setup: Setup, sessions: Sequence[ChamberSession], courses: Sequence[Course], *, gyros: bool
) -> tuple[Problem, Rows, Point]:
    """The sessions as one problem, its rows, and the point at which they are."""
    recorded = [_recorded(*each, setup, parts=len(sessions) > 1) for each in zip(sessions, courses, strict=True)]
    counts, bare = [len(each.attitudes) for each in recorded], replace(instrument_of(setup, gyros), further=())
    joined = {each.name: np.concatenate([getattr(one, each.name) for one in recorded]) for each in fields(Course)}
    joined["first"] += np.repeat(np.cumsum([0, *counts[:-1]]), [len(each.first) for each in recorded])
    course = Course(**joined)  # one after the other, without a turn from one to the next
    file = np.repeat(np.arange(len(sessions)), counts)
    temperatures = [session.course(own.stop[-1]) for session, own in zip(sessions, recorded, strict=True)]
    thermometers = Thermometers.of({i: (time, kelvin[:, None]) for i, (time, kelvin) in enumerate(temperatures)})
    together = Together(
        names=tuple(session.name for session in sessions),
        session=file,
        number=np.concatenate([np.arange(count) for count in counts]),
    )

    def seen(instrument: Instrument) -> tuple[Observations, TurnsAbout | None]:
        observations, about = observed(course, setup, instrument)
        rests, turns = observations.rests, observations.turns
        kelvin = thermometers.means(file, course.start, course.stop).kelvin
        if turns is not None:  # those between the parts of a rest are of no duration
            turns = replace(turns, duration=np.where(course.seconds > NO_TIME, turns.duration, 0.0))
        return replace(
            observations,
            rests=replace(rests, file=file, temperatures=kelvin),
            turns=turns,
            thermometers=thermometers,
            together=together if len(sessions) > 1 else None,
        ), about

    instrument, own = instruments_of(seen(bare)[0])
    observations, about = seen(instrument)
    problem = Problem.of(held(observations), instrument=instrument, own=own, usual=setup.further)
    values, of_each = np.zeros(len(instrument.names)), np.zeros((len(problem.parts), len(problem.own_known)))
    if problem.lag is not None:
        values[problem.lag] = TYPICAL * setup.further["temperature.lag"]
    point = Point(values=values, gravity=setup.gravity, attitudes=course.attitudes, own=of_each)
    return problem, _with_lag(problem.warmed(point), linearise(problem, point, about)), point


def _recorded(session: ChamberSession, course: Course, setup: Setup, *, parts: bool) -> Course:
    """A session as its log has it: the course with moves that are reached and left in a ramp, rests cut off at both
    ends, which the turns have, and, in `parts` where several sessions are one estimate, rests that warm divided, which
    nothing turns between."""
    moved, margin = np.isin(np.arange(len(course.attitudes)), course.first + 1), USUAL.margin_of(setup.rest)
    start = course.start + setup.ramp * np.cumsum(moved)
    time, kelvin = session.course(float(start[-1]) + setup.rest)
    begin, end = start + margin, start + setup.rest - margin
    change = np.abs(np.interp(end, time, kelvin) - np.interp(begin, time, kelvin))
    most = max(min(MOST_PARTS, int((setup.rest - 2.0 * margin) / SHORTEST_PART)), 1) if parts else 1
    count = np.clip(np.ceil(change / WARMED), 1, most).astype(np.int64)
    last = np.cumsum(count) - 1
    moves, seconds = np.zeros((count.sum() - 1, 3)), np.full(count.sum() - 1, NO_TIME)
    at = last[course.first]
    moves[at], seconds[at] = course.moves, course.seconds
    first = np.setdiff1d(np.arange(len(seconds)), np.setdiff1d(last[:-1], at))
    edges = [np.linspace(a, b, n + 1) for a, b, n in zip(begin, end, count, strict=True)]
    return Course(
        attitudes=np.repeat(course.attitudes, count, axis=0),
        start=np.concatenate([each[:-1] for each in edges]),
        stop=np.concatenate([each[1:] for each in edges]),
        first=first,
        moves=moves[first],
        seconds=seconds[first],
        still=np.where(seconds[first] > NO_TIME, 0.5 * setup.ramp + margin, 0.0),
    )


def _with_lag(problem: Problem, rows: Rows) -> Rows:
    """The rows with the derivative by the lag of a typical instrument."""
    if problem.lag is None:
        return rows
    rest, turn = rows.rest.copy(), rows.turn.copy()
    for by, place in ((rest[:, :, 4:-1], 0), (turn[:, :, 7:-1], 1)):
        for own, base, variable in problem.changes:
            if variable == "temperature" and len(by):
                warmer = problem.goes_with(problem.by_lag, variable, own, place)[:, None]
                slopes = problem.measured[1][1:][own]
                by[:, :, problem.lag] += (warmer * by[:, :, base]) @ slopes
    return replace(rows, rest=rest, turn=turn)
