"""Expected uncertainties of a calibration, the best next positions, and the requirements of a wanted accuracy.

With the method `joint` (`tumble.planning.bounds.expected_bound`), a wanted accuracy requires longer rests, or more
positions, each the best next one; errors of table and mounting have no effect. With the methods of the turntable paper,
whose accuracy formulas are in `tumble.planning.pass_errors`, it requires tolerances of table and mounting and a
duration T of rests. Shorter rests than `calibrate` finds (`least_rest`) are refused, and never required. With the
wanted u w, the variance f² that no table changes, that of rest noise n²/T, and the part d(s)² by s times the errors of
table and mounting,

    n²/T = ¼ (w² − f²),   d(s)² = ¾ (w² − f²)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

import numpy as np

from tumble.arguments import checked
from tumble.brief import Brief
from tumble.diagnosis.observability import in_words
from tumble.errors import InputError
from tumble.planning.bounds import CLOCK, GRAVITY, Bound, expected_bound
from tumble.planning.itinerary import Motion
from tumble.planning.next_positions import NextPosition, TurnTable, next_positions
from tumble.planning.pass_errors import REST_NOISE, MethodOfPaper, PassErrors, remarks
from tumble.planning.setup import GROUPS, NAMES, UNITS, Setup, check_setup, expect, time_of, with_all_groups
from tumble.recording.session import USUAL_RATE_U
from tumble.recording.session.document import UNKNOWN_HEIGHT_GRAVITY_U
from tumble.reduction.blocks.tuning import USUAL
from tumble.reduction.rests.matching import POSITION_LIMIT
from tumble.rotation import UP
from tumble.sensors.grades import spread_of
from tumble.sensors.parameters import Terms, group_of, positions_by_group
from tumble.units import DEGREE, Array, engineering

PlannedMethod = Literal["joint"] | MethodOfPaper
Progress = Callable[[int, int], None]
"""Receives the number of positions that a search has added, and the largest number."""

NEXT = 5  # next positions in a plan
MOST_ADDED = 30  # positions that are added to a programme for a wanted accuracy
LONGEST_REST = 3600.0  # s: that an operator waits for
REST_SHARE = 0.25  # of the permitted variance for the noise of rests; the rest is for table and mounting
_REMEDY: Mapping[str, str] = {
    GRAVITY: "measure gravity",
    CLOCK: "state how good the time base is (clock_ppm_u)",
    "gyro noise in turns": "turn faster, or average launches",
    "accelerometer instability": "average launches",
    "gyro instability": "average launches",
    "second order in the parameters": "take another pass",
}  # of the largest source, where no set-up gives a wanted accuracy


@dataclass(frozen=True, kw_only=True, slots=True)
class PlannedGroup:
    """Expected standard uncertainty of a group of parameters, SI."""

    group: str
    unit: str
    iteration: int  #: number of passes of the paper's methods
    estimator: str  #: how the group is determined, with the equation of the paper
    u: float  #: root mean square over the parameters, infinite if one is undetermined
    spread: float  #: standard deviation over instruments before calibration
    parameters: Mapping[str, float]  #: u by parameter
    sources: Mapping[str, float]  #: u by source, the largest first; their squares add up to u²

    @property
    def largest(self) -> str:
        """The largest source, or "nothing"."""
        return next(iter(self.sources), "nothing")


@dataclass(frozen=True, kw_only=True, slots=True)
class Requirement:
    """Requirements of a wanted accuracy of a group of parameters, SI."""

    group: str
    unit: str
    wanted: float  #: rms of u
    u: float  #: rms of u with the set-up as it is
    table_error: float | None = None  #: largest one, rad; None if none within `largest_errors` matters
    mounting_error: float | None = None  #: the same for the mounting, in the ratio of the set-up
    rest: float = math.inf  #: shortest rest, s, with the programme as it is; infinite if an hour is too short
    reached: float = math.inf  #: rms of u with these rests and tolerances, less than `wanted` with the least rest
    positions: int | None = None  #: their number with the rests as they are; None if MOST_ADDED more are too few
    reason: str = ""  #: why no set-up gives this accuracy


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Plan(Brief):
    """Expected result of a calibration."""

    json_fields: ClassVar[tuple[str, ...]] = (
        *("verdict", "reasons", "remarks", "assumptions", "setup", "method", "motion", "rank", "condition", "groups"),
        *("following", "requirements"),
    )
    setup: Setup
    method: PlannedMethod
    groups: tuple[PlannedGroup, ...]  #: u by group; for the paper's methods after each pass
    rank: int | None = None  #: for joint, number of determined combinations of the linear parameters
    condition: float | None = None  #: for joint, condition number of the whitened Jacobian
    following: tuple[NextPosition, ...] = ()  #: the best next positions
    requirements: tuple[Requirement, ...] = ()  #: of each wanted accuracy
    motion: Motion | None = None  #: recorded instead of the programme
    reasons: tuple[str, ...] = ()  #: parameters that the programme does not determine, and impossible accuracies
    remarks: tuple[str, ...] = ()  #: on the validity of the formulas

    @property
    def assumptions(self) -> tuple[str, ...]:
        """Information that the session is assumed to state, in sentences."""
        g, usual = self.setup.gravity, UNKNOWN_HEIGHT_GRAVITY_U
        return (
            *(() if self.motion is None else (self.motion.assumption,)),
            f"gravity is taken as known to {1e6 * self.setup.gravity_u / g:.2g} ppm (--gravity-u); in a session that "
            f"states neither gravity nor height, {1e6 * usual / g:.0f} ppm are in u of accel.scale",
            f"the time base is taken as known to {1e6 * self.setup.clock_u:.3g} ppm, which are in u of gyro.scale "
            f"(--clock-ppm-u); in a log without time stamps it is {100.0 * USUAL_RATE_U:.0f} % unless stated",
        )

    @property
    def verdict(self) -> str:
        """Whether all parameters are determined and all wanted accuracies are possible."""
        return "not accepted" if self.reasons else "accepted"

    def group(self, name: str, iteration: int | None = None) -> PlannedGroup:
        """Return a group of parameters after a number of passes, by default the last; raise KeyError without it."""
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
    """Predict the uncertainties of a calibration by a set-up's programme.

    Parameters
    ----------
    setup
        Instrument, programme and site.
    method
        "joint" for the uncertainties that `calibrate` will state on average over instruments; "sequential" or "scalar"
        for the accuracy formulas of the turntable paper.
    terms
        For joint: "full" to estimate all groups of parameters, "linear" for bias, scale factor and axis angles alone,
        with the others in their u.
    iterations
        Number of passes of the paper's methods.
    wanted
        Standard uncertainties, rms by group, SI, for which requirements and next positions are found.
    gyros
        For joint: False for accelerometers alone.
    table
        The turntable that moves the device to a next position, by default that of the programme.
    motion
        A recording of a device that is turned without rests instead of the programme; for joint with gyros, without
        wanted accuracies.
    progress
        Receives the progress of the search for more positions.

    Raises
    ------
    InputError
        For invalid values, for joint without noise, and for wanted groups that are not calibrated.
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
    if method != "joint" and not gyros:
        raise InputError(f"gyros: expected True with the method {method}, found False; take the method joint")

    def state(setup: Setup) -> Bound:
        return expected_bound(setup, gyros=gyros, terms=terms, motion=motion)

    def following(setup: Setup, wanted: Mapping[str, float]) -> tuple[NextPosition, ...]:
        if motion is not None:
            return ()
        return next_positions(setup, wanted=wanted, gyros=gyros, table=table)

    errors = None if method == "joint" else PassErrors.of(setup, method)
    calibrated = list(errors.estimators) if errors is not None else GROUPS if gyros else GROUPS[:3]
    for group in wanted:
        if group not in calibrated:
            raise InputError(f"wanted: expected some of {', '.join(calibrated)}, found {group!r}")
    groups, missing, particular = list[PlannedGroup](), list[str](), dict[str, Any]()
    if errors is None:
        bound = state(setup)
        groups += _groups_of(bound, setup)
        if undetermined := in_words(bound.null, bound.names):
            undetermined.sort(key=lambda text: [name not in text for name in bound.names])
            missing.append(f"not determined: {', '.join(undetermined)}")
        counts = _positions_needed(wanted, setup, state, following, progress)
        requirements = [_joint_requirement(group, w, setup, state, counts.get(group)) for group, w in wanted.items()]
        positions = tuple(
            replace(one, u={row.group: row.u for row in _groups_of(state(one.added(setup)), setup)})
            for one in following(setup, wanted)[:NEXT]
        )
        particular = {"rank": bound.rank, "condition": bound.condition, "following": positions, "motion": motion}
    else:
        for iteration in range(1, iterations + 1):
            sources = {**errors.methodical(iteration), **errors.noise}
            u = np.sqrt(np.sum([*sources.values()], axis=0))
            groups += _planned_groups(NAMES, u, sources, setup, errors.estimators, iteration)
        last = {row.group: row for row in groups}
        if wanted and max(setup.table_error, setup.mounting_error) == 0.0:  # equal tolerances
            errors = PassErrors.of(replace(setup, table_error=DEGREE, mounting_error=DEGREE), errors.method)
        requirements = [_paper_requirement(last[group], w, errors) for group, w in wanted.items()]
        particular = {"remarks": tuple(remarks(setup))}
    impossible = (row.reason for row in requirements if row.reason)
    unfit = () if motion is not None else _unfit(setup)
    return Plan(
        setup=setup,
        method=method,
        groups=tuple(groups),
        requirements=tuple(requirements),
        reasons=(*missing, *unfit, *impossible),
        **particular,
    )


def largest_errors(setup: Setup) -> tuple[float, float]:
    """Return the largest errors of table and mounting, rad, in the ratio of a set-up, with which `calibrate` matches
    every rest with its position. Each tilts a rest by up to √2 times its error about an axis."""
    table, mounting = setup.table_error, setup.mounting_error
    if table + mounting == 0.0:
        table = mounting = 1.0
    most = POSITION_LIMIT / math.sqrt(2.0) / (table + mounting)
    return most * table, most * mounting


def least_rest(setup: Setup) -> float:
    """Return the shortest rest, whole s, with which `calibrate` finds every rest of a set-up's programme.

    A rest has its least duration between its margins. Of N rests of r s the windows of w s within a rest last r − w.
    Beside moves of M s they must be the share q of the recording from which the search starts, and twice as much as in
    the longest turn of T s about the vertical, which is as quiet and as steady as a rest (with 1.5 to 1.8 times as
    much, 3 of 8 simulated sessions were refused):

        N (r − w) ≥ q (N r + M),   N (r − w) ≥ 2 (T − w)
    """
    programme, q, w = setup.programme, USUAL.quiet_share, USUAL.window
    N = len(programme.positions)
    M = time_of(programme, setup) - N * setup.rest
    about_vertical = (
        abs(m.angle) for m in programme.moves if m.angle and m.axis is not None and abs(m.axis @ UP) > 0.5
    )
    T = max(about_vertical, default=0.0) / setup.turn_rate
    return max(USUAL.rest_seconds, math.ceil((w + q * M / N) / (1.0 - q)), math.ceil(w + 2.0 * (T - w) / N))


def _unfit(setup: Setup) -> tuple[str, ...]:
    """Return reasons why `calibrate` does not find the rests of a set-up, or does not match them with positions."""
    reasons = list[str]()
    if setup.rest < (least := least_rest(setup)):
        reasons.append(f"rests of {setup.rest:g} s: expected at least {least:g} s, so that `calibrate` finds every one")
    tilt = math.sqrt(2.0) * (setup.table_error + setup.mounting_error)
    if tilt > 1.001 * POSITION_LIMIT:
        reasons.append(
            f"errors of table and mounting of up to {setup.table_error / DEGREE:.3g}° and "
            f"{setup.mounting_error / DEGREE:.3g}° may tilt a position by {tilt / DEGREE:.2g}°, and `calibrate` takes "
            f"rests within {POSITION_LIMIT / DEGREE:.0f}° of the positions of a programme; the method joint needs "
            "none: leave [programme] out of the session"
        )
    return tuple(reasons)


def _planned_groups(
    names: Sequence[str],
    u: Array,
    sources: Mapping[str, Array],
    setup: Setup,
    estimators: Mapping[str, str] | None = None,
    iteration: int = 1,
) -> list[PlannedGroup]:
    """Return the groups of parameters with u (m,), infinite if undetermined, and variances (m,) by source.

    `estimators` are the groups that a method of the paper determines, and how."""
    groups = list[PlannedGroup]()
    for group, members in positions_by_group(names).items():
        if group not in (estimators or {group}):
            continue
        rms = float(np.sqrt(np.mean(u[members] ** 2)))
        variances = {name: float(np.mean(v[members])) for name, v in sources.items() if math.isfinite(rms)}
        by_size = sorted(variances.items(), key=lambda item: -item[1])
        groups.append(
            PlannedGroup(
                group=group,
                unit=group_of(group).unit,
                iteration=iteration,
                estimator="maximum likelihood" if estimators is None else estimators[group],
                u=rms,
                spread=setup.further[group] if group in setup.further else spread_of(setup, group),
                parameters={names[p]: float(u[p]) for p in members},
                sources={name: math.sqrt(variance) for name, variance in by_size if variance > 0.0},
            )
        )
    return groups


def _impossible(row: Requirement, least: float, how: str, remedy: str) -> Requirement:
    """Return a requirement with the reason why its accuracy is impossible; `least` is the u that is reached `how`."""
    size, unit = engineering(row.unit, least)
    found = f"{row.wanted / size:.3g} {unit}"
    expected = f"an accuracy of at least {least / size:.3g} {unit}, which {how}"
    return replace(row, reason=f"{row.group}: expected {expected}, found {found}; {remedy}")


# The method joint


def _groups_of(found: Bound, setup: Setup) -> list[PlannedGroup]:
    return _planned_groups(found.names, found.u, found.sources, setup)


def _positions_needed(
    wanted: Mapping[str, float],
    setup: Setup,
    state: Callable[[Setup], Bound],
    following: Callable[[Setup, Mapping[str, float]], tuple[NextPosition, ...]],
    progress: Progress,
) -> dict[str, int]:
    """Return the number of positions by group that give a wanted accuracy, if MOST_ADDED more are enough.

    The search ignores accuracies that gravity and time base make impossible."""
    counts, remaining = dict[str, int](), dict(wanted)
    for added in range(MOST_ADDED + 1 if wanted else 0):
        rows = {row.group: row for row in _groups_of(state(setup), setup)}
        for group, value in wanted.items():
            if rows[group].u <= value:
                counts.setdefault(group, len(setup.programme.positions))
            fixed = math.hypot(*(rows[group].sources.get(name, 0.0) for name in (GRAVITY, CLOCK)))
            if group in counts or fixed > value:
                remaining.pop(group, None)
        progress(added, MOST_ADDED)
        candidates = following(setup, remaining) if remaining else ()
        if not candidates:
            break
        setup = candidates[0].added(setup)
    return counts


def _joint_requirement(
    group: str, wanted: float, setup: Setup, state: Callable[[Setup], Bound], positions: int | None
) -> Requirement:
    """Return the shortest rests, to 1 %, that give a wanted accuracy. u decreases with the duration of rests until
    in-run instability, gravity, other groups or drifts dominate."""

    def u(rest: float) -> float:
        return state(replace(setup, rest=rest)).rms(group)

    row = Requirement(group=group, unit=UNITS[group], wanted=wanted, u=u(setup.rest), positions=positions)
    least = least_rest(setup)
    rests = [min(2.0**i * least, LONGEST_REST) for i in range(math.ceil(math.log2(LONGEST_REST / least)) + 1)]
    tried = dict[float, float]()
    for rest in rests:
        if (found := u(rest)) <= wanted:
            short = max(tried, default=rest)
            while rest > 1.01 * short:
                middle = math.sqrt(short * rest)
                short, rest = (short, middle) if u(middle) <= wanted else (middle, rest)
            return replace(row, rest=rest, reached=u(rest))
        tried[rest] = found
    if positions is not None:
        return row
    longest = min(tried, key=lambda rest: tried[rest])
    if math.isinf(tried[longest]):
        return replace(row, reason=f"{group}: this programme does not determine it; take another one")
    best = replace(setup, rest=longest)
    cause = next(each.largest for each in _groups_of(state(best), best) if each.group == group)
    remedy = _REMEDY.get(cause, "average launches, or take a better grade")
    how = f"the method joint states with rests of {longest:.0f} s (mostly {cause}), and no {MOST_ADDED} more positions"
    return _impossible(row, tried[longest], f"{how} give", remedy)


# The methods of the paper


def _paper_requirement(planned: PlannedGroup, wanted: float, errors: PassErrors) -> Requirement:
    """Return tolerances, in the ratio of the set-up, and rests for a wanted accuracy (see the module)."""
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
        remedy = _REMEDY.get(cause, "take another pass or method")
        return _impossible(row, math.sqrt(least), f"an exact table and endless rests leave (mostly {cause})", remedy)
    permitted = (1.0 - REST_SHARE) * free if rest_noise > 0.0 else free
    rest = max(rest_noise / (REST_SHARE * free), least_rest(setup))
    largest = max(largest_errors(setup)) / max(setup.table_error, setup.mounting_error)
    by_table = min(by_deviations(largest) - floor, permitted)
    row = replace(row, rest=rest, reached=math.sqrt(least + rest_noise / rest + by_table))
    if by_table < permitted:
        return row
    scale = float(brentq(lambda x: by_deviations(x) - floor - permitted, 0.0, largest, rtol=1e-9))
    return replace(row, table_error=scale * setup.table_error, mounting_error=scale * setup.mounting_error)
