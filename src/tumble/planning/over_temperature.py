"""What recordings over temperature can show at best, before a chamber is booked, and how long it takes.

The rows are those of several sessions together (`tumble.estimation.likelihood`) at perfect sensors and the attitudes of
their programmes, with the thermometer's course in each, so that the covariance is that which `calibrate_together`, or
`calibrate` of one session, states: common coefficients over temperature, biases of each launch, drifts of each session,
all groups with their priors.

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
from tumble.estimation.estimate import DETERMINED, GroupFinding
from tumble.estimation.likelihood import Point, Problem, Rows, instruments_of, linearise, noise_of, solve
from tumble.estimation.variables import both_ways, lag_is_sought
from tumble.planning.bounds import KEPT, Course, bound_of, course_of, instrument_of, observed, scatter_of
from tumble.planning.setup import Setup, with_all_groups
from tumble.programme.positions import ANY_MOVE, Programme, duration
from tumble.reduction.observations import Observations, Together, Turns
from tumble.reduction.segmentation import MARGIN_FRACTION, MARGIN_SECONDS
from tumble.reduction.thermometer import Thermometer
from tumble.reduction.together import HELD, MOST_PARTS, SHORTEST_PART, WARMED
from tumble.sensors.instrument import Instrument
from tumble.sensors.parameters import group_of, positions_by_group, quantity_of, to_temperature
from tumble.units import ZERO_CELSIUS, Array
from tumble.usual_setup import MOVE

TYPICAL = 0.5
"""The lag of a typical instrument, in parts of the usual size."""
NO_TIME = 1e-6
"""s, of what is between the parts of a rest."""
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

CourseOfTemperature = Callable[[float], tuple[Array, Array]]
"""From how long a recording takes, s, to times (K,), s, from its start and the temperatures (K,), K, of its thermometer,
straight between them."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ChamberSession:
    """A recording that is planned: what it is called, the positions it goes through and its temperature."""

    name: str
    programme: Programme
    course: CourseOfTemperature


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
    """A recording of `rests` rests between the temperatures `low` and `high`, K, changing by `fastest`, K/s; how long, s, the chamber takes to get
    there, the unit to soak and the recording; and `alone`, the u, rms, SI, by group that it would give without the
    others, infinite where it does not determine a group."""

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
    """The least covariance (m, m), SI, of the parameters at the `reference`, K, from recordings between `low` and
    `high`, K; `further` says what they find out about each group beyond the linear model, of whose parameters there are
    `linear`; `notes` what they do not show, and why."""

    setup: Setup
    sessions: tuple[PlannedSession, ...]
    reference: float
    low: float
    high: float
    names: tuple[str, ...]
    linear: int
    covariance: Array
    determined: tuple[bool, ...]
    further: tuple[GroupFinding, ...]
    notes: tuple[str, ...]

    @property
    def u(self) -> Array:
        """Least standard uncertainties (m,) at the reference, SI; infinite where a parameter is not determined."""
        return self.at(self.reference)

    def at(self, kelvin: float) -> Array:
        """The same at another temperature, K."""
        J = to_temperature(self.names, kelvin - self.reference)
        return np.where(self.determined, np.sqrt(np.einsum("ij,jk,ik->i", J, self.covariance, J)), np.inf)

    def rms(self, group: str, kelvin: float | None = None) -> float:
        """The u, root mean square, of a group such as "accel.bias" or "accel.bias.t1", SI, at the reference or at a
        temperature, K. Raises KeyError for a group that is not there."""
        own = positions_by_group(self.names)[group]
        return float(np.sqrt(np.mean(self.at(self.reference if kelvin is None else kelvin)[own] ** 2)))

    def worst(self, group: str) -> float:
        """The largest u, rms, of a group within the range; of coefficients, that at the reference."""
        if group not in self.groups:
            return self.rms(group)
        return max(self.rms(group, kelvin) for kelvin in (self.low, self.reference, self.high))

    @property
    def groups(self) -> tuple[str, ...]:
        """The kinds of linear parameters there are, in order."""
        return tuple(positions_by_group(self.names[: self.linear]))

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
    courses = [course_of(replace(setup, programme=session.programme)) for session in sessions]
    problem, rows = _problem(setup, sessions, courses, gyros=gyros)
    step = solve(problem, rows, noise_of(problem, rows).weights(scatter_of(setup)))
    covariance = step.covariance[1:, 1:]
    planned = tuple(_planned(setup, sessions, courses, chamber, gyros=gyros))
    instrument, kelvin = problem.instrument, problem.observations.rests.temperature
    assert kelvin is not None
    linear = instrument.linear_count
    determined = np.ones(len(covariance), dtype=bool)
    determined[:linear] = np.sqrt(np.diag(covariance)[:linear]) < problem.spread[:linear] / DETERMINED
    further = tuple(_findings(instrument, setup, np.diag(covariance)))
    return ThermalPlan(
        setup=setup,
        sessions=planned,
        reference=float(kelvin.mean()),
        low=float(kelvin.min()),
        high=float(kelvin.max()),
        names=instrument.names,
        linear=linear,
        covariance=covariance,
        determined=tuple(determined.tolist()),
        further=further,
        notes=tuple(_notes(problem, planned, covariance, further, chamber)),
    )


def rests_of(programme: Programme, count: int) -> Programme:
    """The first so many positions of a programme; of more than it has, it begins anew."""
    positions = [programme.positions[i % len(programme.positions)] for i in range(count)]
    moves = [*programme.moves, ANY_MOVE]
    return replace(
        programme,
        positions=tuple(positions),
        moves=tuple(moves[i % len(moves)] for i in range(count - 1)),
    )


def wanted_over_temperature(texts: Sequence[str]) -> dict[str, float]:
    """Wanted accuracies, SI, by group, from texts such as "accel.bias=0.1mg" or "accel.bias.t1=1ug/K". Raises
    InputError, one line."""
    wanted: dict[str, float] = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            wanted[name] = quantity_of(group_of(name), value)
        except KeyError:
            known = ", ".join((*CHANGING, *(f"{group}.t1" for group in CHANGING)))
            raise InputError(f"--want {text}: expected a group such as {known} before '=', found {name!r}") from None
        except ValueError as error:
            raise InputError(f"--want {text}: {error}") from None
    return wanted


# What the likelihood sees of it


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Recorded:
    """A session as its log has it: the course with rests that warm in parts, which nothing turns between, and when each
    begins and ends (N,), s."""

    course: Course
    start: Array
    stop: Array


def _problem(
    setup: Setup, sessions: Sequence[ChamberSession], courses: Sequence[Course], *, gyros: bool
) -> tuple[Problem, Rows]:
    """The sessions as one problem, and its rows."""
    recorded = [_recorded(*each, setup, parts=len(sessions) > 1) for each in zip(sessions, courses, strict=True)]
    course = _one_after_the_other([each.course for each in recorded])
    bare = replace(instrument_of(setup, gyros), further=())
    observations = _warmed(observed(course, setup, bare)[0], setup, sessions, recorded)
    instrument, own = instruments_of(observations)
    still = np.where(course.seconds > NO_TIME, 0.5 * setup.ramp + _margin(setup), 0.0)
    fresh, about = observed(course, setup, instrument, still)
    observations = replace(observations, turns=_held(fresh.turns, course))
    problem = Problem.of(observations, instrument=instrument, own=own, usual=setup.further)
    values, of_each = np.zeros(len(instrument.names)), np.zeros((len(problem.parts), len(problem.own_known)))
    if problem.lag is not None:
        values[problem.lag] = TYPICAL * setup.further["temperature.lag"]
    point = Point(values=values, gravity=setup.gravity, attitudes=course.attitudes, own=of_each)
    return problem, _with_lag(problem.warmed(point), linearise(problem, point, about))


def _recorded(session: ChamberSession, course: Course, setup: Setup, *, parts: bool) -> _Recorded:
    """A session with its rests as a log has them, cut off at both ends, in `parts` where several are one estimate."""
    start, margin = _starts(course, setup), _margin(setup)
    time, kelvin = session.course(float(start[-1]) + setup.rest)
    begin, end = start + margin, start + setup.rest - margin
    change = np.abs(np.interp(end, time, kelvin) - np.interp(begin, time, kelvin))
    most = max(min(MOST_PARTS, int((setup.rest - 2.0 * margin) / SHORTEST_PART)), 1) if parts else 1
    count = np.clip(np.ceil(change / WARMED), 1, most).astype(np.int64)
    last = np.cumsum(count) - 1
    moves, seconds = np.zeros((count.sum() - 1, 3)), np.full(count.sum() - 1, NO_TIME)
    at = last[course.first]
    moves[at], seconds[at] = course.moves, course.seconds
    still = np.setdiff1d(last[:-1], at)
    first = np.setdiff1d(np.arange(len(seconds)), still)
    edges = [np.linspace(a, b, n + 1) for a, b, n in zip(begin, end, count, strict=True)]
    return _Recorded(
        course=Course(
            attitudes=np.repeat(course.attitudes, count, axis=0),
            first=first,
            moves=moves[first],
            seconds=seconds[first],
        ),
        start=np.concatenate([each[:-1] for each in edges]),
        stop=np.concatenate([each[1:] for each in edges]),
    )


def _one_after_the_other(courses: Sequence[Course]) -> Course:
    """Several courses as one, without a turn from one to the next."""
    before = np.cumsum([0, *(len(course.attitudes) for course in courses)])
    return Course(
        attitudes=np.concatenate([course.attitudes for course in courses]),
        first=np.concatenate([course.first + n for course, n in zip(courses, before, strict=False)]).astype(np.int64),
        moves=np.concatenate([course.moves for course in courses]),
        seconds=np.concatenate([course.seconds for course in courses]),
    )


def _starts(course: Course, setup: Setup) -> Array:
    """When the rests of a course begin (N,), s."""
    moved = np.zeros(len(course.attitudes))
    moved[course.first + 1] = course.seconds + setup.ramp
    return np.asarray(setup.rest * np.arange(len(moved)) + np.cumsum(moved))


def _margin(setup: Setup) -> float:
    """What of a rest the segmentation takes off at each end, s."""
    return float(np.clip(MARGIN_FRACTION * setup.rest, *MARGIN_SECONDS))


def _warmed(
    observations: Observations, setup: Setup, sessions: Sequence[ChamberSession], recorded: Sequence[_Recorded]
) -> Observations:
    """The observations of sessions with times of their own and temperatures."""
    start, stop = (np.concatenate([getattr(each, end) for each in recorded]) for end in ("start", "stop"))
    counts = [len(each.start) for each in recorded]
    file = np.repeat(np.arange(len(sessions)), counts)
    thermometer = Thermometer.of({i: session.course(recorded[i].stop[-1]) for i, session in enumerate(sessions)})
    longer = (setup.rest / (stop - start))[:, None, None]
    rests = observations.rests
    return replace(
        observations,
        rests=replace(
            rests,
            file=file,
            start=start,
            stop=stop,
            accel_covariance=longer * rests.accel_covariance,
            gyro_covariance=longer * rests.gyro_covariance,
            temperature=thermometer.at(file, 0.5 * (start + stop)),
        ),
        thermometer=thermometer,
        together=Together(
            names=tuple(session.name for session in sessions),
            session=file,
            number=np.concatenate([np.arange(count) for count in counts]),
        )
        if len(sessions) > 1
        else None,
    )


def _held(turns: Turns | None, course: Course) -> Turns | None:
    """The turns with those between the parts of a rest as what they are: of no duration, and known to HELD."""
    if turns is None:
        return None
    held = course.seconds <= NO_TIME
    covariance = np.where(held[:, None, None], HELD**2 * np.eye(3), turns.covariance)
    return replace(turns, duration=np.where(held, 0.0, turns.duration), covariance=covariance)


def _with_lag(problem: Problem, rows: Rows) -> Rows:
    """The rows with the derivative by the lag of a typical instrument."""
    if problem.lag is None:
        return rows
    rest, turn = rows.rest.copy(), rows.turn.copy()
    for by, place in ((rest[:, :, 4:-1], 0), (turn[:, :, 7:-1], 1)):
        for own, base, variable in problem.changes:
            if variable == "temperature" and len(by):
                warmer = problem.by_lag[variable][place][:, None]
                slopes = problem.measured[1][1:][own]
                by[:, :, problem.lag] += warmer * (by[:, :, base] @ slopes)
    return replace(rows, rest=rest, turn=turn)


def _findings(instrument: Instrument, setup: Setup, variance: Array) -> Iterator[GroupFinding]:
    for name, members in instrument.members.items():
        learned = np.clip(1.0 - variance[members] / setup.further[name] ** 2, 0.0, 1.0)
        yield GroupFinding(
            name=name,
            kept=bool(learned.max() > KEPT),
            prior=setup.further[name],
            widened=1.0,
            learned=tuple(learned.tolist()),
        )


# The chamber


def _planned(
    setup: Setup, sessions: Sequence[ChamberSession], courses: Sequence[Course], chamber: Chamber, *, gyros: bool
) -> Iterator[PlannedSession]:
    """The recordings one after the other, from room temperature."""
    now, lag = ROOM, setup.further.get("temperature.lag", 0.0)
    for session, course in zip(sessions, courses, strict=True):
        takes = duration(session.programme, rest=setup.rest, rate=setup.turn_rate, move=MOVE)
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
            alone={group: alone.rms(group) for group in CHANGING if group in alone.groups},
        )
        now = float(kelvin[-1])


def soak_of(chamber: Chamber, difference: float, lag: float) -> float:
    """How long, s, a unit soaks after the chamber has changed by so many K, until what its sensors lag behind their
    thermometer by is SETTLED: t = τ ln(λ ΔT / (τ · SETTLED))."""
    ratio = lag * difference / (chamber.time_constant * SETTLED)
    return chamber.time_constant * math.log(ratio) if ratio > 1.0 else 0.0


# What is said


def _notes(
    problem: Problem,
    planned: Sequence[PlannedSession],
    covariance: Array,
    further: Sequence[GroupFinding],
    chamber: Chamber,
) -> Iterator[str]:
    """What the recordings do not show, and why."""
    observations, names = problem.observations, problem.instrument.names
    ramps = [session for session in planned if session.high - session.low > PASSED]
    left = [g.name for g in further if g.name.endswith((".t1", ".t2")) and max(g.learned) < LITTLE]
    if left:
        yield f"left to what is usual: {', '.join(left)}; {_remedy(planned, ramps)}"
    yield from _scales(planned)
    if not lag_is_sought(observations):
        yield (
            "the temperatures span less than 10 K: neither the lag behind the thermometer nor hysteresis is looked for"
        )
    elif ramps and not both_ways(observations):
        at = problem.lag
        assert at is not None
        yield (
            "no temperature is passed both ways in a recording: a lag behind the thermometer shows only where a ramp "
            f"begins, a typical one to {math.sqrt(covariance[at, at]):.0f} s, which is in u, and hysteresis not at all; ramp "
            "there and back in one recording"
        )
    elif not ramps:
        yield (
            "at levels neither lag nor hysteresis is seen: soak until the thermometer in the unit stands still, and come "
            "from the same side as in use"
        )
    for session in ramps:
        if session.fastest > chamber.rate:
            yield (
                f"{session.name}: the temperature changes faster than the chamber can, {60.0 * chamber.rate:.2g} K/min; "
                "take longer rests, or more of them"
            )
    if len(names) and len(planned) > 1:
        yield "a launch each: u of the biases contains what they change by from one power-on to the next"


def _remedy(planned: Sequence[PlannedSession], ramps: Sequence[PlannedSession]) -> str:
    """What would show them."""
    levels = sorted({round(0.5 * (session.low + session.high) / APART) for session in planned})
    if ramps:
        return "take more rests along the ramp, each axis up and down"
    if len(levels) < 2:
        return "there is one temperature; take three, or a ramp there and back"
    if len(levels) < 3:
        return "at two temperatures slopes are seen and no curvature; take a third between them"
    return "take temperatures further apart"


def _scales(planned: Sequence[PlannedSession]) -> Iterator[str]:
    """Recordings that say little of scale factors: ten times less than the best of them."""
    best = {group: min(session.alone.get(group, math.inf) for session in planned) for group in CHANGING}
    for session in planned:
        poor = [g for g in ("accel.scale", "gyro.scale") if session.alone.get(g, 0.0) > 10.0 * best[g]]
        if poor:
            yield (
                f"{session.name}: its {session.rests} rests determine biases, and {' and '.join(poor)} hardly: these want "
                "each axis up and down and a turn about each, at every temperature"
            )
