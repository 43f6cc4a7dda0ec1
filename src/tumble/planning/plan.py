"""What a calibration will state, the best next positions, and what a wanted accuracy needs.

Of the method `joint`, whose answer is `tumble.planning.bounds.stated`, a wanted accuracy needs longer rests, or more
positions, each the best next one; errors of table and mounting do not count. Of the methods of the turntable paper,
whose answer are its accuracy formulas (`tumble.planning.pass_errors`), it needs tolerances of table and mounting and
rests of some length: with w the wanted u, f² what no table changes, n²/T the noise of rests of T s, and d(s)² the part
of s times the errors of table and mounting, without what they leave at zero,

    n²/T = ¼ (w² − f²),   d(s)² = ¾ (w² − f²)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from tumble.arguments import checked
from tumble.brief import Brief
from tumble.diagnosis.observability import in_words
from tumble.errors import InputError
from tumble.planning.bounds import CLOCK, GRAVITY, Bound, stated
from tumble.planning.error_propagation import MethodOfPaper
from tumble.planning.in_motion import Motion
from tumble.planning.next_positions import NextPosition, TurnTable, next_positions
from tumble.planning.pass_errors import ESTIMATORS, REST_NOISE, PassErrors, remarks
from tumble.planning.setup import MEMBERS, NAMES, UNITS, Setup, check_setup, expect, with_all_groups
from tumble.recording.session import USUAL_RATE_U
from tumble.recording.session.document import UNKNOWN_HEIGHT_GRAVITY_U
from tumble.reduction.rests.matching import POSITION_LIMIT
from tumble.sensors.grades import spread_of
from tumble.sensors.parameters import Terms, positions_by_group
from tumble.units import DEGREE, engineering

PlannedMethod = Literal["joint"] | MethodOfPaper
Progress = Callable[[int, int], None]
"""Receives how many positions a search has added, and how many at most."""

NEXT = 5
"""How many next positions are given."""
MOST_ADDED = 30
"""Positions that are added to a programme for a wanted accuracy."""
LONGEST_REST = 3600.0
"""s: of a rest that an operator waits for."""
REST_SHARE = 0.25
"""Part of the permitted variance that is given to the noise of rests; table and mounting get the others."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PlannedGroup:
    """Expected standard uncertainty u of a group of parameters, SI: the root mean square over its parameters, infinite
    where one is not determined. It is that after `iteration` passes of the paper's methods, of which `estimator` says
    how the group is found, with the equation. `spread` is the standard deviation over instruments before calibration,
    `parameters` are u by parameter, `sources` u by source alone, the largest first, whose squares add up to u²."""

    group: str
    unit: str
    iteration: int
    estimator: str
    u: float
    spread: float
    parameters: Mapping[str, float]
    sources: Mapping[str, float]

    @property
    def largest(self) -> str:
        """The largest source; nothing where the formulas leave nothing."""
        return next(iter(self.sources), "nothing")


@dataclass(frozen=True, kw_only=True, slots=True)
class Requirement:
    """What a wanted accuracy, u rms by group, SI, needs, where u is that with the set-up as it is.

    `table_error` and `mounting_error` are the largest tolerances, rad, in the ratio of the set-up, None where they do
    not matter within `largest_errors`. `rest` is the shortest rest, s, with the programme as it is, infinite where no
    rest of an hour is enough; `positions` the number of positions with the rests as they are, None where MOST_ADDED
    more are too few. `reason` says why no set-up gives this accuracy; it is empty where one does."""

    group: str
    unit: str
    wanted: float
    u: float
    table_error: float | None = None
    mounting_error: float | None = None
    rest: float = math.inf
    positions: int | None = None
    reason: str = ""


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Plan(Brief):
    """What a set-up gives: u by group, of the paper's methods after each pass; the best next positions, and what each
    wanted accuracy needs. `reasons` are what the programme does not determine and what no set-up gives, `remarks` where
    the set-up is outside the range of the formulas, in sentences. Of joint, `rank` is how many combinations of the
    linear parameters are determined, and `condition` that of the whitened Jacobian. `assumptions` are what `calibrate`
    has otherwise where a session does not state it. `motion` is what is recorded in place of the programme."""

    json_fields: ClassVar[tuple[str, ...]] = (
        *("verdict", "reasons", "remarks", "assumptions", "setup", "method", "motion", "rank", "condition", "groups"),
        *("following", "requirements"),
    )
    setup: Setup
    method: PlannedMethod
    groups: tuple[PlannedGroup, ...]
    rank: int | None = None
    condition: float | None = None
    following: tuple[NextPosition, ...] = ()
    requirements: tuple[Requirement, ...] = ()
    motion: Motion | None = None
    reasons: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What the plan takes the session to state, in sentences."""
        g, usual = self.setup.gravity, UNKNOWN_HEIGHT_GRAVITY_U
        return (
            *(() if self.motion is None else (self.motion.assumption,)),
            f"the session states gravity, or height, to {1e6 * self.setup.gravity_u / g:.2g} ppm of accel.scale "
            f"(--gravity-u); where it states neither, {1e6 * usual / g:.0f} ppm are in u",
            f"its time base is known to {1e6 * self.setup.clock_u:.3g} ppm of gyro.scale (--clock-ppm-u); a sample "
            f"rate without time stamps to {100.0 * USUAL_RATE_U:.0f} % unless that is stated",
        )

    @property
    def verdict(self) -> str:
        """Whether the programme determines everything and some set-up gives all that is wanted."""
        return "not accepted" if self.reasons else "accepted"

    def group(self, name: str, iteration: int | None = None) -> PlannedGroup:
        """A group of parameters after so many passes, by default the last. Raises KeyError where there is none."""
        for row in reversed(self.groups):
            if row.group == name and iteration in (None, row.iteration):
                return row
        raise KeyError(name)


@checked
def plan(
    setup: Setup,
    *,
    method: PlannedMethod = "joint",
    terms: Terms = "full",
    iterations: int = 2,
    wanted: Mapping[str, float] | None = None,
    gyros: bool = True,
    table: TurnTable | None = None,
    motion: Motion | None = None,
    progress: Progress = lambda _added, _most: None,
) -> Plan:
    """What a calibration by a set-up's programme will state, before it is made.

    Parameters
    ----------
    setup
        Instrument, programme and site.
    method
        With "joint", what `calibrate` will state on the average over instruments; with "sequential" or "scalar", the
        accuracy formulas of the turntable paper, of instruments with the linear model.
    terms
        Of joint: with "full" all groups of parameters are estimated, with "linear" bias, scale factor and axis angles
        alone, and the others are in their u.
    iterations
        Passes of the paper's methods.
    wanted
        Standard uncertainties, rms by group, SI: `Plan.requirements` says what they need, and the next positions are
        those that serve them.
    gyros
        Of joint: with False, accelerometers alone.
    table
        How the device can be turned to a next position; by default as the programme turns it.
    motion
        A recording of a device that is turned without rests, in place of the programme; of joint with gyros, without
        wanted accuracies.
    progress
        Receives how far the search for more positions is.

    Raises
    ------
    InputError
        For values that make no sense, where joint has no noise, and for groups that are not calibrated.
    ProgrammeError
        For a programme without the positions that a method of the paper needs.

    Examples
    --------
    >>> import tumble
    >>> found = tumble.plan(tumble.Setup.of(rest=120.0), wanted={"accel.scale": 10e-6})
    >>> found.group("accel.scale").u < 10e-6, found.reasons, len(found.following)
    (True, (), 5)
    """
    check_setup(setup)
    setup, wanted = with_all_groups(setup), wanted or {}
    if iterations < 1:
        raise InputError(f"iterations: expected at least 1, found {iterations}")
    for group, value in wanted.items():
        expect(group, value, least="more than 0")
    if motion is not None and (method != "joint" or not gyros or wanted):
        raise InputError(f"{motion.held}: expected the method joint, gyros and no wanted accuracies, found others")
    if method != "joint":
        if not gyros:
            raise InputError(f"gyros: expected True with the method {method}, found False; take the method joint")
        return _plan_of_paper(setup, method, iterations, wanted)

    def state(setup: Setup) -> Bound:
        return stated(setup, gyros=gyros, terms=terms, motion=motion)

    def following(setup: Setup, wanted: Mapping[str, float]) -> tuple[NextPosition, ...]:
        if motion is not None:
            return ()
        return next_positions(setup, wanted=wanted, gyros=gyros, table=table)

    found = state(setup)
    groups = tuple(_groups_of(found, setup))
    _check_wanted(wanted, groups)
    counts = _positions_needed(wanted, setup, state, following, progress)
    needs = tuple(_joint_requirement(g, w, setup, state, counts.get(g)) for g, w in wanted.items())
    unseen = sorted(in_words(found.null, found.names), key=lambda said: [name not in said for name in found.names])
    missing = [f"not determined: {', '.join(unseen)}"] if unseen else []
    return Plan(
        setup=setup,
        method="joint",
        groups=groups,
        rank=found.rank,
        condition=found.condition,
        following=tuple(
            replace(one, u={row.group: row.u for row in _groups_of(state(one.added(setup)), setup)})
            for one in following(setup, wanted)[:NEXT]
        ),
        requirements=needs,
        motion=motion,
        reasons=(*missing, *(() if motion else _tilted(setup)), *(row.reason for row in needs if row.reason)),
    )


def largest_errors(setup: Setup) -> tuple[float, float]:
    """The largest errors of table and mounting, rad, in the ratio of a set-up, with which every rest is near enough to
    its position for `calibrate`: each tilts by up to √2 times its error about an axis."""
    table, mounting = setup.table_error, setup.mounting_error
    if table + mounting == 0.0:
        table = mounting = 1.0
    most = POSITION_LIMIT / math.sqrt(2.0) / (table + mounting)
    return most * table, most * mounting


def _tilted(setup: Setup) -> tuple[str, ...]:
    """That errors of table and mounting may take a rest out of its position, where they may."""
    tilt = math.sqrt(2.0) * (setup.table_error + setup.mounting_error)
    if tilt <= 1.001 * POSITION_LIMIT:
        return ()
    return (
        f"errors of table and mounting of up to {setup.table_error / DEGREE:.3g}° and "
        f"{setup.mounting_error / DEGREE:.3g}° may tilt a position by {tilt / DEGREE:.2g}°, and `calibrate` takes "
        f"rests within {POSITION_LIMIT / DEGREE:.0f}° of the positions of a programme; the method joint needs none: "
        "leave [programme] out of the session",
    )


def _check_wanted(wanted: Mapping[str, float], groups: tuple[PlannedGroup, ...]) -> None:
    """Raise InputError for a group that is not calibrated."""
    names = dict.fromkeys(row.group for row in groups if row.group in UNITS)
    for group in wanted:
        if group not in names:
            raise InputError(f"wanted: expected some of {', '.join(names)}, found {group!r}")


def _by_size(variances: Mapping[str, float]) -> dict[str, float]:
    """The u of sources that contribute, the largest first."""
    by_size = sorted(variances.items(), key=lambda item: -item[1])
    return {name: math.sqrt(variance) for name, variance in by_size if variance > 0.0}


# The method joint


def _groups_of(found: Bound, setup: Setup) -> Iterator[PlannedGroup]:
    """The groups of a bound, with their sources."""
    for group, members in positions_by_group(found.names).items():
        seen = bool(np.all(found.observable[members]))
        yield PlannedGroup(
            group=group,
            unit=found.units[members[0]],
            iteration=1,
            estimator="maximum likelihood",
            u=found.rms(group),
            spread=setup.further[group] if group in setup.further else spread_of(setup, group),
            parameters={found.names[p]: float(found.u[p]) for p in members},
            sources=_by_size({name: float(np.mean(v[members])) for name, v in found.sources.items() if seen}),
        )


def _positions_needed(
    wanted: Mapping[str, float],
    setup: Setup,
    state: Callable[[Setup], Bound],
    following: Callable[[Setup, Mapping[str, float]], tuple[NextPosition, ...]],
    progress: Progress,
) -> dict[str, int]:
    """The number of positions by group with which a wanted accuracy is stated, where MOST_ADDED more are enough; of
    what gravity and time base alone do not allow, none is."""
    counts, left = dict[str, int](), dict(wanted)
    for added in range(MOST_ADDED + 1 if wanted else 0):
        rows = {row.group: row for row in _groups_of(state(setup), setup)}
        for group, value in wanted.items():
            if rows[group].u <= value:
                counts.setdefault(group, len(setup.programme.positions))
            fixed = math.hypot(*(rows[group].sources.get(name, 0.0) for name in (GRAVITY, CLOCK)))
            if group in counts or fixed > value:
                left.pop(group, None)
        progress(added, MOST_ADDED)
        candidates = following(setup, left) if left else ()
        if not candidates:
            break
        setup = candidates[0].added(setup)
    return counts


def _joint_requirement(
    group: str, wanted: float, setup: Setup, state: Callable[[Setup], Bound], positions: int | None
) -> Requirement:
    """The shortest rests of at most LONGEST_REST with which a wanted accuracy is stated, to 1 %; u falls with the rests
    until in-run instability, gravity and other groups are all there is, or drifts grow."""

    def u(rest: float) -> float:
        return state(replace(setup, rest=rest)).rms(group)

    row = Requirement(group=group, unit=UNITS[group], wanted=wanted, u=u(setup.rest), positions=positions)
    rests = [min(2.0**i, LONGEST_REST) for i in range(math.ceil(math.log2(LONGEST_REST)) + 1)]
    tried = dict[float, float]()
    for rest in rests:
        if (found := u(rest)) <= wanted:
            short = max(tried, default=rest)
            while rest > 1.01 * short:
                middle = math.sqrt(short * rest)
                short, rest = (short, middle) if u(middle) <= wanted else (middle, rest)
            return replace(row, rest=rest)
        tried[rest] = found
    if positions is not None:
        return row
    longest = min(tried, key=lambda rest: tried[rest])
    if math.isinf(tried[longest]):
        return replace(row, reason=f"{group}: this programme does not determine it; take another one")
    best = replace(setup, rest=longest)
    cause = next(each.largest for each in _groups_of(state(best), best) if each.group == group)
    size, unit = engineering(row.unit, tried[longest])
    remedies = {GRAVITY: "measure gravity", CLOCK: "state how good the time base is (clock_ppm_u)"}
    reason = (
        f"{group}: expected an accuracy of at least {tried[longest] / size:.3g} {unit}, which the method joint states "
        f"with rests of {longest:.0f} s (mostly {cause}), and no {MOST_ADDED} more positions give, found "
        f"{wanted / size:.3g} {unit}; {remedies.get(cause, 'average launches, or take a better grade')}"
    )
    return replace(row, reason=reason)


# The methods of the paper


def _plan_of_paper(setup: Setup, method: MethodOfPaper, iterations: int, wanted: Mapping[str, float]) -> Plan:
    """The accuracy formulas of a method, after each of so many passes."""
    errors, groups = PassErrors.of(setup, method), []
    for iteration in range(1, iterations + 1):
        variances = {**errors.methodical(iteration), **errors.noise}
        u = np.sqrt(sum(variances.values()))
        for group in errors.groups:
            of_group = errors.of_group(group, variances)
            groups.append(
                PlannedGroup(
                    group=group,
                    unit=UNITS[group],
                    iteration=iteration,
                    estimator=ESTIMATORS[method][group],
                    u=math.sqrt(sum(of_group.values())),
                    spread=spread_of(setup, group),
                    parameters={NAMES[p]: float(u[p]) for p in MEMBERS[group]},
                    sources=_by_size(of_group),
                )
            )
    found = Plan(
        setup=setup, method=method, groups=tuple(groups), reasons=_tilted(setup), remarks=tuple(remarks(setup))
    )
    _check_wanted(wanted, found.groups)
    if wanted and max(setup.table_error, setup.mounting_error) == 0.0:  # equal tolerances are asked for
        errors = PassErrors.of(replace(setup, table_error=DEGREE, mounting_error=DEGREE), method)
    needs = tuple(_paper_requirement(found.group(g), value, errors) for g, value in wanted.items())
    impossible = (row.reason for row in needs if row.reason)
    return replace(found, requirements=needs, reasons=(*found.reasons, *impossible))


_REMEDY: Mapping[str, str] = {
    "gyro noise in turns": "turn faster, or average launches",
    "accelerometer instability": "average launches",
    "gyro instability": "average launches",
    "uncertainty of gravity": "measure gravity",
    "second order in the parameters": "take another pass",
}


def _paper_requirement(planned: PlannedGroup, wanted: float, errors: PassErrors) -> Requirement:
    """Tolerances, in the ratio of the set-up of `errors`, and rests for a wanted accuracy, see the module."""
    from scipy.optimize import brentq

    group, setup = planned.group, errors.setup

    def by_deviations(scale: float) -> float:
        return sum(errors.of_group(group, errors.methodical(planned.iteration, scale)).values())

    noise = errors.of_group(group, errors.noise)
    rest_noise = setup.rest * sum(noise.pop(name) for name in REST_NOISE)
    fixed = errors.of_group(group, errors.methodical(planned.iteration, 0.0)) | noise
    least, floor = sum(fixed.values()), by_deviations(0.0)
    free = wanted**2 - least
    row = Requirement(group=group, unit=planned.unit, wanted=wanted, u=planned.u)
    if free <= 0.0:
        cause = max(fixed, key=lambda name: fixed[name])
        size, name = engineering(planned.unit, math.sqrt(least))
        reason = (
            f"{group}: expected an accuracy of at least {math.sqrt(least) / size:.3g} {name}, which an exact table and "
            f"endless rests leave (mostly {cause}), found {wanted / size:.3g} {name}; "
            f"{_REMEDY.get(cause, 'take another pass or method')}"
        )
        return replace(row, reason=reason)
    permitted = (1.0 - REST_SHARE) * free if rest_noise > 0.0 else free
    row = replace(row, rest=rest_noise / (REST_SHARE * free))
    largest = max(largest_errors(setup)) / max(setup.table_error, setup.mounting_error)
    if by_deviations(largest) - floor <= permitted:
        return row
    scale = float(brentq(lambda x: by_deviations(x) - floor - permitted, 0.0, largest, rtol=1e-9))
    return replace(row, table_error=scale * setup.table_error, mounting_error=scale * setup.mounting_error)
