"""What recordings over temperature can show at best, before a chamber is booked, and how long it takes.

The rows are those of several sessions together (`tumble.inference.likelihood`) at perfect sensors and the attitudes of
their programmes, with the thermometer's course in each, so that the covariance is that which `calibrate_together`, or
`calibrate` of one session, states: common coefficients over temperature, biases of each launch, drifts of each session,
all groups with their priors, in-run biases, what will be said of the noise, and the time base. Rests and turns are
those that a log gives: the segmentation takes a margin off each end of a rest, which belongs to the turn, a turn has
its ramps, and rests that warm are taken in parts where several sessions are one estimate.

A lag λ acts through the slopes, and perfect sensors have none: it is taken to act on a typical instrument, all of whose
slopes are of the usual size, and which lags by TYPICAL of the usual,

    ∂ŷ/∂λ = Σ_m ∂ŷ/∂θ_m t1_m ∂T/∂λ

so that what it adds to u² is what it adds on the average over instruments. Without any lag a ramp would not show it
where it begins.

A chamber that has changed by ΔT leaves a unit of time constant τ with (ΔT/τ) e^(−t/τ) of drift, and sensors that lag by
λ with λ times this of error: it soaks until that is SETTLED.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tumble.errors import InputError
from tumble.inference.likelihood import Linearised, Point, Problem, instruments_of
from tumble.inference.linearisation import linearised
from tumble.inference.turns_about import TurnsAbout
from tumble.inference.variables import both_ways, over_a_range
from tumble.planning.bounds import (
    Bound,
    bound_by,
    bound_of,
    components_of,
    instrument_of,
    observed,
)
from tumble.planning.expected_sizes import expected
from tumble.planning.itinerary import NO_TIME, Itinerary, itinerary_of
from tumble.planning.setup import Setup, time_of, wanted_accuracies, with_all_groups
from tumble.programme.positions import ANY_MOVE, Programme
from tumble.reduction.blocks.tuning import USUAL
from tumble.reduction.observations import Observations, Together
from tumble.reduction.rests.thermometer import Thermometers
from tumble.reduction.together import MOST_PARTS, SHORTEST_PART, WARMED, held
from tumble.sensors.instrument import Instrument
from tumble.sensors.parameters import THERMAL, positions_by_group, to_temperature, variable_of
from tumble.units import ZERO_CELSIUS, Array

SETTLED = 0.1
"""K: what sensors may be off their thermometer by where a recording begins."""
ROOM = 20.0 + ZERO_CELSIUS
"""K: how warm the unit is before."""
APART = 1.0
"""K: recordings whose temperatures are closer are at one level."""
PASSED = 2.0
"""K: a recording whose temperature changes by more is a ramp."""
LITTLE = 0.05
"""Learned fraction below which a group is left to what is usual."""
CHANGING = ("accel.bias", "accel.scale", "gyro.bias", "gyro.scale")
"""The groups that change with temperature."""
SCALES = ("accel.scale", "gyro.scale")
"""Those that want more than rests."""
POOR = 10.0
"""How many times less than the best of them a recording says of scale factors that it hardly determines."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Chamber:
    """How fast the chamber changes, K/s, and the thermal time constant, s, of the unit in it."""

    rate: float = 2.0 / 60.0
    time_constant: float = 600.0

    @staticmethod
    def of(*, per_minute: float, time_constant: float) -> Chamber:
        """The chamber of a rate in K a minute. Raises InputError, one line, for one that is none."""
        for what, value, unit in (("chamber rate", per_minute, "K a minute"), ("time constant", time_constant, "s")):
            if not 0.0 < value < math.inf:
                raise InputError(f"{what}: expected more than 0, in {unit}, found {value:g}")
        return Chamber(rate=per_minute / 60.0, time_constant=time_constant)


@dataclass(frozen=True, kw_only=True, slots=True)
class PlannedSession:
    """A recording of `rests` rests between the temperatures `low` and `high`, K, changing by `fastest`, K/s; how long,
    s, the chamber takes to get there, the unit to soak, and the recording; and `alone`, the u, rms, SI, of the scale
    factors by group that it would give without the others, infinite where it does not determine them."""

    name: str
    rests: int
    low: float
    high: float
    fastest: float
    change: float
    soak: float
    recording: float
    alone: Mapping[str, float]

    @property
    def seconds(self) -> float:
        """How long all of it takes, s."""
        return self.change + self.soak + self.recording


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ThermalPlan:
    """The `bound` of the parameters at the `reference`, K, from recordings between `low` and `high`, K; `notes` say
    what they do not show, and why."""

    setup: Setup
    sessions: tuple[PlannedSession, ...]
    reference: float
    low: float
    high: float
    bound: Bound
    notes: tuple[str, ...]

    def at(self, kelvin: float) -> Array:
        """Least standard uncertainties (m,) at a temperature, K, SI; infinite where a parameter is not determined."""
        J = to_temperature(self.bound.names, kelvin - self.reference)
        return np.where(self.bound.observable, np.sqrt(np.einsum("ij,jk,ik->i", J, self.bound.covariance, J)), np.inf)

    def rms(self, group: str, kelvin: float | None = None) -> float:
        """The u, root mean square, of a group such as "accel.bias" or "accel.bias.t1", SI, at the reference or at a
        temperature, K. Raises KeyError for a group that is not there."""
        own = positions_by_group(self.bound.names)[group]
        return float(np.sqrt(np.mean(self.at(self.reference if kelvin is None else kelvin)[own] ** 2)))

    def worst(self, group: str) -> float:
        """The largest u, rms, of a group within the range; of coefficients, that at the reference."""
        if group not in self.bound.groups:
            return self.rms(group)
        return max(self.rms(group, kelvin) for kelvin in (self.low, self.reference, self.high))

    @property
    def seconds(self) -> float:
        """Chamber time, s."""
        return sum(session.seconds for session in self.sessions)


def plan_over_temperature(
    setup: Setup, sessions: Sequence[ChamberSession], *, chamber: Chamber | None = None, gyros: bool = True
) -> ThermalPlan:
    """The least uncertainty that recordings over temperature allow, of an instrument with all groups of parameters of
    the usual size, and the time they take in a chamber; the positions are those of the sessions.

    Raises InputError for values that make no sense, and where there is no noise."""
    if not sessions:
        raise InputError("temperature: expected at least one recording, found none")
    setup, chamber = with_all_groups(setup), chamber or Chamber()
    courses = [itinerary_of(replace(setup, programme=session.programme)) for session in sessions]
    seen = expected(view_of(setup, sessions, courses, gyros=gyros))
    bound = bound_by(seen, setup.turn_rate, setup.clock_u)
    planned = tuple(_planned(setup, sessions, courses, chamber, gyros=gyros))
    kelvin = seen.problem.observations.rests.temperature
    assert kelvin is not None
    return ThermalPlan(
        setup=setup,
        sessions=planned,
        reference=float(kelvin.mean()),
        low=float(kelvin.min()),
        high=float(kelvin.max()),
        bound=bound,
        notes=tuple(_notes(seen.problem, planned, bound, chamber)),
    )


def wanted_over_temperature(texts: Sequence[str]) -> dict[str, float]:
    """Wanted accuracies, SI, by group, from texts such as "accel.bias=0.1mg" or "accel.bias.t1=1ug/K". Raises
    InputError, one line."""
    return wanted_accuracies(texts, (*CHANGING, *(f"{group}.t1" for group in CHANGING)), others=True)


# The chamber


def _planned(
    setup: Setup, sessions: Sequence[ChamberSession], courses: Sequence[Itinerary], chamber: Chamber, *, gyros: bool
) -> Iterator[PlannedSession]:
    """The recordings one after the other, from room temperature."""
    now, lag = ROOM, setup.further.get("temperature.lag", 0.0)
    for session, course in zip(sessions, courses, strict=True):
        takes = time_of(session.programme, setup)
        time, kelvin = session.course(takes)
        difference = abs(float(kelvin[0]) - now)
        alone = bound_of(course, setup, gyros=gyros)
        yield PlannedSession(
            name=session.name,
            rests=len(course.attitudes),
            low=float(kelvin.min()),
            high=float(kelvin.max()),
            fastest=float(np.max(np.abs(np.diff(kelvin) / np.diff(time)))),
            change=difference / chamber.rate,
            soak=soak_of(chamber, difference, lag),
            recording=takes,
            alone={group: alone.rms(group) for group in SCALES if group in alone.groups},
        )
        now = float(kelvin[-1])


def soak_of(chamber: Chamber, difference: float, lag: float) -> float:
    """How long, s, a unit soaks after the chamber has changed by so many K, until what its sensors lag behind their
    thermometer by is SETTLED: t = τ ln(λ ΔT / (τ · SETTLED))."""
    ratio = lag * difference / (chamber.time_constant * SETTLED)
    return chamber.time_constant * math.log(ratio) if ratio > 1.0 else 0.0


# The recordings as the likelihood sees them

TYPICAL = 0.5
"""The lag of a typical instrument, in parts of the usual size."""

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


def view_of(
    setup: Setup, sessions: Sequence[ChamberSession], courses: Sequence[Itinerary], *, gyros: bool
) -> Linearised:
    """The sessions as the likelihood sees them."""
    recorded = [_recorded(*each, setup, parts=len(sessions) > 1) for each in zip(sessions, courses, strict=True)]
    counts, bare = [len(each.attitudes) for each in recorded], replace(instrument_of(setup, gyros), further=())
    course = Itinerary.joined(recorded)
    file = np.repeat(np.arange(len(sessions)), counts)
    temperatures = [session.course(own.rests[-1, 1]) for session, own in zip(sessions, recorded, strict=True)]
    thermometers = Thermometers.of({i: (time, kelvin[:, None]) for i, (time, kelvin) in enumerate(temperatures)})
    together = Together(
        names=tuple(session.name for session in sessions),
        session=file,
        number=np.concatenate([np.arange(count) for count in counts]),
    )

    def observed_by(instrument: Instrument) -> tuple[Observations, TurnsAbout | None]:
        observations, about = observed(course, setup, instrument)
        rests, turns = observations.rests, observations.turns
        kelvin = thermometers.means(file, *course.rests.T).kelvin
        if turns is not None:  # those between the parts of a rest are of no duration
            turns = replace(turns, duration=np.where(course.seconds > NO_TIME, turns.duration, 0.0))
        return replace(
            observations,
            rests=replace(rests, file=file, temperatures=kelvin),
            turns=turns,
            thermometers=thermometers,
            together=together if len(sessions) > 1 else None,
        ), about

    instrument, own = instruments_of(observed_by(bare)[0])
    observations, about = observed_by(instrument)
    problem = Problem.of(held(observations), instrument=instrument, own=own, usual=setup.further)
    values, of_each = np.zeros(len(instrument.names)), np.zeros((len(problem.parts), len(problem.own_known)))
    if problem.lag is not None:
        values[problem.lag] = TYPICAL * setup.further["temperature.lag"]
    point = Point(values=values, gravity=setup.gravity, attitudes=course.attitudes, own=of_each)
    seen, warmed = linearised(problem, point, about, components_of(setup.noise)), problem.warmed(point)
    if warmed.lag is None:
        return seen
    rest, turn = seen.rows.rest.copy(), seen.rows.turn.copy()
    for by, place in ((rest[:, :, 4:-1], 0), (turn[:, :, 7:-1], 1)):
        for of, base, variable in warmed.changes:
            if variable == "temperature" and len(by):
                warmer = warmed.goes_with(warmed.by_lag, variable, of, place)[:, None]
                by[:, :, warmed.lag] += (warmer * by[:, :, base]) @ warmed.measured[1][1:][of]
    return replace(seen, rows=replace(seen.rows, rest=rest, turn=turn))


def _recorded(session: ChamberSession, course: Itinerary, setup: Setup, *, parts: bool) -> Itinerary:
    """A session as its log has it, and, in `parts` where several sessions are one estimate, rests that warm divided,
    which nothing turns between."""
    margin = USUAL.margin_of(setup.rest)
    logged = course.as_logged(setup.ramp, margin)
    if not parts:
        return logged
    time, kelvin = session.course(float(logged.rests[-1, 1]) + margin)
    change = np.abs(np.diff(np.interp(logged.rests, time, kelvin), axis=1)[:, 0])
    most = max(min(MOST_PARTS, int((setup.rest - 2.0 * margin) / SHORTEST_PART)), 1)
    count = np.clip(np.ceil(change / WARMED), 1, most).astype(np.int64)
    edges = [np.linspace(a, b, n + 1) for (a, b), n in zip(logged.rests, count, strict=True)]
    last, N = np.cumsum(count)[:-1] - 1, count.sum()
    moves, turned, still = np.zeros((N - 1, 3)), np.ones(N - 1, dtype=bool), np.zeros(N - 1)
    moves[last], turned[last], still[last] = logged.moves, logged.turned, logged.still
    return Itinerary(
        attitudes=np.repeat(logged.attitudes, count, axis=0),
        rests=np.concatenate([np.column_stack([each[:-1], each[1:]]) for each in edges]),
        moves=moves,
        turned=turned,
        still=still,
    )


# What is said


def _notes(problem: Problem, planned: Sequence[PlannedSession], bound: Bound, chamber: Chamber) -> Iterator[str]:
    """What the recordings do not show, and why."""
    observations = problem.observations
    ramps = [session for session in planned if session.high - session.low > PASSED]
    usual = [g.name for g in bound.further if variable_of(g.name) in THERMAL and max(g.learned) < LITTLE]
    if usual:
        levels = len({round(0.5 * (session.low + session.high) / APART) for session in planned})
        remedy = {
            1: "there is one temperature; take three, or a ramp there and back",
            2: "at two temperatures slopes are seen and no curvature; take a third between them",
        }.get(levels, "take temperatures further apart")
        remedy = "take more rests along the ramp, each axis up and down" if ramps else remedy
        yield f"left to what is usual: {', '.join(usual)}; {remedy}"
    best = {group: min(session.alone.get(group, math.inf) for session in planned) for group in SCALES}
    for session in planned:
        if poor := [g for g in SCALES if session.alone.get(g, 0.0) > POOR * best[g]]:
            yield (
                f"{session.name}: its {session.rests} rests determine biases, and {' and '.join(poor)} hardly: these "
                "want each axis up and down and a turn about each, at every temperature"
            )
    if not over_a_range(observations):
        yield ("the temperatures span less than 10 K: hysteresis is not looked for")
    elif ramps and (at := problem.lag) is not None and not both_ways(observations):
        yield (
            "no temperature is passed both ways in a recording: a lag behind the thermometer shows only where a ramp "
            f"begins, a typical one to {bound.u[at]:.0f} s, which is in u, and hysteresis not at "
            "all, which is in u by its usual size; ramp there and back in one recording"
        )
    elif not ramps:
        yield (
            "at levels neither lag nor hysteresis is seen: soak until the thermometer in the unit stands still, and "
            "come from the same side as in use"
        )
    for session in ramps:
        if session.fastest > chamber.rate:
            yield (
                f"{session.name}: the temperature changes faster than the chamber can, {60.0 * chamber.rate:.2g} "
                "K/min; take longer rests, or more of them"
            )
    if len(planned) > 1:
        yield "a launch each: u of the biases contains what they change by from one power-on to the next"
