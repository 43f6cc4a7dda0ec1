"""Uncertainties that `calibrate` will state for a recording that has not been made.

The rows are those of `tumble.inference.problem`, linearised at perfect sensors and at the attitudes of the programme,
which are unknowns and are eliminated. The noise of the instrument is white, with in-run biases as Gauss–Markov
processes (`tumble.inference.noise`); a bias is the mean over the session. With the usual sizes of the groups beyond the
linear model as priors, the covariance is the Cramér–Rao bound of the joint likelihood. `expected_bound` adds the
effects of quantities that `calibrate` does not know exactly:

* the noise, and the sizes of groups in this instrument;
* the time base, which is common to all gyro scale factors;
* the ends of the rests: the segmentation leaves their margins to the turns.

All moves between rests are in the log, each about one axis at a constant rate (`tumble.planning.itinerary`). Errors
of table and mounting have no effect, as the attitudes are unknowns: one degree changes u by parts of a thousand.

The noise and the sizes of groups are those that `joint` is expected to find (`with_expected_sizes`): it estimates
hyperparameters (`tumble.inference.hyperparameters`) with the parameters, and integrates over them. For a session with
noise of standard deviation s and no other scatter, and for parameters of the usual size s, each observed with the
variance v, the posterior of each hyperparameter alone is

    x = σ/s of a component of scatter with ν degrees of freedom    p(x) (1 + x²)^{−ν/2} exp[−½ χ²/(1 + x²)]
    λ of the sizes of a group of parameters                        p(λ) Π (λ²s² + v)^{−1/2} exp[−½ y²/(λ²s² + v)]

with random χ² of ν degrees of freedom, and estimates y of variance s² + v. For scatter, σ is taken as the root mean
square of x s over the posterior of the median session. For a group, the size λs is that with which a parameter has its
variance averaged over sessions, as this is much larger in a few: the mean of 1/(1/λ²s² + 1/v), plus the variance of its
estimate y λ²s²/(λ²s² + v) with λ. A group about which the session says little (`INFORMATIVE_GROUP`) keeps its usual
size, as in the integral. Each hyperparameter is found with the expected sizes of all others. An in-run bias is a group
with as many members as states, whose prior is log-normal about the size of the set-up.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from tumble.brief import Brief
from tumble.diagnosis.linear_model import is_omitted, shift_by_likelihood
from tumble.earth import earth_rate
from tumble.errors import InputError
from tumble.inference.estimate import DETERMINED, UNOBSERVABLE_SHARE
from tumble.inference.hyperparameters import LEAST_DEGREES, hyperparameters_of, quadratic_forms, size_factors
from tumble.inference.integral import INFORMATIVE_GROUP
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.linearisation import Linearisation, linearise
from tumble.inference.noise import SCATTER, TURN_SCATTER, VarianceComponents
from tumble.inference.normal_equations import Solution, solve
from tumble.inference.problem import Point, Problem
from tumble.inference.sources import clock_effects, clock_errors
from tumble.inference.uncertainty_budget import contributions
from tumble.planning.itinerary import (
    Itinerary,
    Motion,
    inertial_turns,
    itinerary_of,
    observed_in_motion,
    steady_samples,
    white_turns,
)
from tumble.planning.setup import ACCEL, GYRO, Setup, check_setup
from tumble.recording.session import Site
from tumble.reduction.blocks.tuning import USUAL
from tumble.reduction.observations import Observations
from tumble.reduction.rests.rests import Rests
from tumble.reduction.turns.turns import TURN_FLOOR, VELOCITY_FLOOR
from tumble.sensors.grades import GRADES, NoiseModel
from tumble.sensors.instrument import Instrument
from tumble.sensors.parameters import Terms, positions_by_group, prior_sizes
from tumble.units import Array, BoolArray

NOISE, GRAVITY, CLOCK = "noise and in-run biases", "gravity of the site", "time base of the log"  # names of sources
ORDERS = 8  # random orders of the positions over which u is averaged, if any order is allowed
SHORTEST_TIME = 1e-3  # s: correlation time of biases that are independent from rest to rest
POINTS = 400  # of an integral over a hyperparameter
RANGE = 4.0  # limit of such an integral, in standard deviations of the prior
ROUNDS = 2  # of the sizes of groups, each with the sizes of the others from the round before
QUANTILES = (np.arange(64) + 0.5) / 64  # of χ², each a session; as many random sessions for a group


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Bound(Brief):
    """Expected covariance of a calibration, SI."""

    names: tuple[str, ...]  # of m parameters
    units: tuple[str, ...]
    linear: int  # number of parameters of the linear model, which come first
    covariance: Array  # (m, m)
    observable: BoolArray  # (m,): whether determined; further groups always are, by their priors
    null: Array
    """Undetermined combinations (q, linear), of unit length in natural units: biases relative to gravity and to the
    rate of the turns, angles in rad."""
    condition: float
    """Condition number of the whitened Jacobian of the linear parameters in natural units, infinite if a combination is
    undetermined. For accelerometers alone it is that of H, Eq. (13) of the turntable paper."""
    sources: Mapping[str, Array]  # variances (m,) by source, which add up to those of the parameters

    @property
    def u(self) -> Array:
        """Standard uncertainties (m,), SI; infinite for undetermined parameters."""
        return np.where(self.observable, np.sqrt(np.diag(self.covariance)), np.inf)

    @property
    def rank(self) -> int:
        """Number of combinations of the linear parameters that are determined."""
        return self.linear - len(self.null)

    def rms(self, group: str) -> float:
        """Return the root mean square of u over a group such as "accel.bias", SI; raise KeyError if there is none."""
        return float(np.sqrt(np.mean(self.u[positions_by_group(self.names)[group]] ** 2)))


def expected_bound(setup: Setup, *, gyros: bool = True, terms: Terms = "full", motion: Motion | None = None) -> Bound:
    """Return the uncertainties that `calibrate` will state on average over instruments.

    Parameters
    ----------
    setup
        Instrument, programme and site. The groups beyond the linear model are those of `setup.further`.
    gyros
        Whether gyros are calibrated, or accelerometers alone.
    terms
        With "linear", only bias, scale factor and axis angles are estimated, with the groups in their u.
    motion
        A recording in motion instead of the programme.

    Raises
    ------
    InputError
        For invalid values, and if there is no noise.
    """
    if motion is not None:
        return _mean([_bound_of_course(course, setup, gyros=True, terms=terms) for course in motion.courses])
    if not setup.programme.ordered:
        rng, bounds = np.random.default_rng(0), list[Bound]()
        for _ in range(ORDERS):
            order = rng.permutation(len(setup.programme.positions)).tolist()
            positions = tuple(setup.programme.positions[i] for i in order)
            ordered = replace(setup, programme=replace(setup.programme, positions=positions, ordered=True))
            bounds.append(expected_bound(ordered, gyros=gyros, terms=terms))
        return _mean(bounds)
    course = itinerary_of(setup).as_logged(setup.ramp, USUAL.margin_of(setup.rest))
    return _bound_of_course(course, setup, gyros=gyros, terms=terms)


def _bound_of_course(course: Itinerary | Motion, setup: Setup, *, gyros: bool, terms: Terms) -> Bound:
    """Return the uncertainties that `calibrate` will state for a course."""
    full = linearised_course(course, setup, gyros=gyros)
    full = with_expected_sizes(full.with_components(_with_drifts(full, setup.further)))
    if terms == "full":
        return bound_by(full, setup.turn_rate, setup.clock_u)
    # with linear terms, omitted groups and scatter have the sizes that are expected with all terms
    linear = linearised_course(course, replace(setup, further={}), gyros=gyros).with_components(full.components)
    bound = bound_by(linear, setup.turn_rate, setup.clock_u)
    groups = {g.name: setup.further[g.name] for g in full.problem.instrument.further if is_omitted(g)}
    if not groups:
        return bound
    rows = linearised_course(course, replace(setup, further=groups), gyros=gyros).with_components(full.components)
    shift, sizes = shift_by_likelihood(rows), full.problem.prior_u[1:]
    covariance = bound.covariance
    sources = dict(bound.sources)
    for name in groups:
        members = rows.problem.instrument.members[name]
        by_member = shift[:, members.start - bound.linear : members.stop - bound.linear]
        by_member = by_member * sizes[full.problem.instrument.members[name]]
        covariance = covariance + by_member @ by_member.T
        sources[name] = (by_member**2).sum(axis=1)
    return replace(bound, covariance=covariance, sources=sources)


def _mean(bounds: list[Bound]) -> Bound:
    """Return the mean of bounds of one instrument, with the undetermined combinations of the first."""
    return replace(
        bounds[0],
        covariance=np.mean([each.covariance for each in bounds], axis=0),
        condition=float(np.mean([each.condition for each in bounds])),
        sources={name: np.mean([each.sources[name] for each in bounds], axis=0) for name in bounds[0].sources},
    )


def instrument_of(setup: Setup, gyros: bool) -> Instrument:
    """Return the instrument of a set-up, triads along the body axes, with its groups of parameters."""
    return Instrument.of(ACCEL, GYRO if gyros else None, tuple(prior_sizes(setup.instrument, usual=setup.further)))


def bound_by(rows: Linearisation, rate: float, clock_u: float = 0.0) -> Bound:
    """Return the covariance of the parameters from a linearised likelihood of one session.

    Parameters
    ----------
    rows
        Rows at the true parameters, with their noise.
    rate
        Rate of the turns, rad/s, which is the natural unit of gyro biases.
    clock_u
        Relative standard uncertainty of the time base.
    """
    problem, instrument = rows.problem, rows.problem.instrument
    linear, m = instrument.linear_count, len(instrument.names)
    by_source = contributions(solve(rows.with_priors(problem)))
    covariance = np.sum(list(by_source.values()), axis=0)[1:, 1:]

    # combinations with a u of more than 1/DETERMINED of their spread are undetermined
    spread, of_linear = problem.spread[:linear], covariance[:linear, :linear]
    variance, vectors = np.linalg.eigh(of_linear / np.outer(spread, spread))
    undetermined = vectors[:, variance > DETERMINED**-2].T
    observable = np.ones(m, dtype=bool)
    observable[:linear] = np.sqrt((undetermined**2).sum(axis=0)) < UNOBSERVABLE_SHARE
    natural_sizes = {"m/s^2": problem.observations.site.gravity, "rad/s": rate, "1": 1.0, "rad": 1.0}
    natural = np.array([natural_sizes[unit] for unit in instrument.units[:linear]])
    null = undetermined * spread / natural
    axes = np.sqrt(np.linalg.eigvalsh(of_linear / np.outer(natural, natural)))  # of the ellipsoid of uncertainty

    # the time base affects the scale factors of sensors that read rates, not of those that read increments
    clock = clock_errors(instrument.names, clock_effects(clock_u, {"accel": False, "gyro": False}))
    covariance = covariance + np.outer(clock, clock)
    key_of = {GRAVITY: "gravity"} | {name: f"prior.{name}" for name in instrument.members}
    sources = {name: np.diag(by_source[key])[1:] for name, key in key_of.items() if key in by_source}
    sources[CLOCK] = clock**2
    return Bound(
        names=instrument.names,
        units=instrument.units,
        linear=linear,
        covariance=covariance,
        observable=observable,
        null=null / np.linalg.norm(null, axis=1, keepdims=True),
        condition=np.inf if len(null) else float(axes[-1] / axes[0]),
        sources={NOISE: np.maximum(np.diag(covariance) - sum(sources.values()), 0.0), **sources},
    )


def components_of(noise: NoiseModel) -> VarianceComponents:
    """Return the in-run instability of an instrument as variance components."""
    time = max(noise.instability_time, SHORTEST_TIME)
    return VarianceComponents(
        accel_in_run=noise.accel_instability, gyro_in_run=noise.gyro_instability, accel_time=time, gyro_time=time
    )


def _with_drifts(rows: Linearisation, further: Mapping[str, float]) -> VarianceComponents:
    """Return in-run biases that include the drift of sensors, if the estimate has no group for it.

    A drift d over a session of length T has the variance (d T)²/12 and changes by d Δt from rest to rest. The process
    in its place has the sum of this variance and that of the bias, and of the variances of the changes from rest to
    rest: σ² = σ_b² + (d T)²/12 and 2 σ² Δt/τ = 2 σ_b² Δt/τ_b + (d Δt)²."""
    observations, components = rows.problem.observations, rows.components
    rests, links = observations.rests, observations.links
    middle = 0.5 * (rests.start + rests.stop) if links is None else links.time
    length = float(np.ptp(middle))
    interval = float(np.median(np.diff(middle))) if len(middle) > 1 else 0.0
    for kind in ("accel", "gyro"):
        drift = further.get(f"{kind}.bias.drift", 0.0)
        if drift == 0.0 or f"{kind}.bias.drift" in observations.usual:
            continue
        size, time = getattr(components, f"{kind}_in_run"), getattr(components, f"{kind}_time")
        variance = size**2 + (drift * length) ** 2 / 12.0
        variance_over_time = size**2 / time + 0.5 * drift**2 * interval
        process: dict[str, Any] = {f"{kind}_in_run": math.sqrt(variance), f"{kind}_time": variance / variance_over_time}
        components = replace(components, **process)
    return components


def linearised_course(course: Itinerary | Motion, setup: Setup, *, gyros: bool) -> Linearisation:
    """Return the likelihood of a course, linearised at perfect sensors and its attitudes.

    Raises InputError for invalid values, and if there is no noise."""
    check_setup(setup)
    noise = setup.noise
    for sensors, level in (
        ("accelerometers", noise.accel_white + noise.accel_instability),
        ("gyros", noise.gyro_white),
    ):
        if level == 0.0 and (gyros or sensors == "accelerometers"):
            raise InputError(f"noise: expected {sensors} with noise, found none; without it there is no bound")
    instrument, components = instrument_of(setup, gyros), components_of(noise)
    if isinstance(course, Motion):
        assert instrument.gyro is not None
        observations, attitudes = observed_in_motion(course, setup, instrument.gyro)
        size, time = course.displacement
        components = replace(components, displacement=size, displacement_time=time)
    else:
        observations, attitudes = _observed_on_table(course, setup, instrument), course.attitudes
    usual = prior_sizes(setup.instrument, usual=setup.further)
    observations = replace(
        observations,
        usual=usual,
        too_small=size_factors(setup.instrument, usual, guessed=True) if setup.instrument in GRADES else {},
        in_run={"accel": noise.accel_instability, "gyro": noise.gyro_instability},
    )
    problem = Problem.of(observations, instrument=instrument, usual=usual)
    values = np.zeros(len(instrument.names))
    still = np.zeros((len(attitudes) if problem.moves else 0, 3))
    point = Point(
        values=values,
        gravity=setup.gravity,
        attitudes=attitudes,
        local=np.zeros((1, len(problem.local_u))),
        velocities=still,
        displacements=still,
    )
    turns = None if observations.turns is None else IntegratedTurns.of(observations, instrument, values)
    return linearise(problem, point, turns, components)


def _observed_on_table(course: Itinerary, setup: Setup, instrument: Instrument) -> Observations:
    """Return the observations of rests and turns by perfect sensors with white noise."""
    noise, g = setup.noise, setup.gravity
    earth = np.array(earth_rate(setup.latitude))
    gyros, first = instrument.gyro is not None, course.first
    turns, samples = None, None
    if gyros and len(first) > 0:
        start, still, T = course.attitudes[first], course.still[first], course.seconds
        vector = inertial_turns(start, course.attitudes[first + 1], course.moves[first], T, setup.latitude)
        samples = steady_samples(vector, T, start, setup, still)
        T = T + 2.0 * still
        rotation = (noise.gyro_white**2 * T + TURN_FLOOR**2)[:, None, None] * np.eye(3)
        turns = white_turns(first, T, rotation, noise.accel_white**2 * T + VELOCITY_FLOOR**2)
    return Observations(
        accel_block=ACCEL,
        gyro_block=instrument.gyro,
        site=Site(latitude=setup.latitude, height=0.0, gravity=g, gravity_u=setup.gravity_u),
        rests=Rests.of_white_noise(
            *course.rests.T,
            accel=g * course.attitudes[:, 1],
            gyro=(earth @ course.attitudes)[:, : 3 if gyros else 0],
            densities=(noise.accel_white, noise.gyro_white),
        ),
        turns=turns,
        turn_samples=samples,
        programme=setup.programme,
        position=np.arange(len(course.rests)),
    )


def with_expected_sizes(rows: Linearisation) -> Linearisation:
    """Return a linearised likelihood with the scatter and the sizes of groups that `joint` is expected to find.

    `rows` are at perfect sensors, with the noise of the set-up."""
    problem, components, solution = rows.problem, rows.components, solve(rows)
    products = _products(solution)
    hyperparameters = hyperparameters_of(problem, rows.noise, products > 0.0)

    sizes_of_noise: dict[str, Any] = {}
    for h, trace in zip(hyperparameters, quadratic_forms(hyperparameters, solution)[1].tolist(), strict=True):
        if h.kind == "scatter":
            degrees = float(products[SCATTER.index(h.name)]) * h.usual**4
            if degrees > LEAST_DEGREES:
                sizes_of_noise[h.name] = h.usual * _expected_scatter(degrees, of_turns=h.name in TURN_SCATTER)
        elif h.kind == "process" and solution.equations.wanders:
            states = np.ones(len(np.arange(rows.noise.unknowns)[h.members]) * len(problem.chain))
            share = float(np.clip(trace / len(states), 1e-6, 1.0 - 1e-6))  # that the session determines, of a state
            factor = _expected_size(states, (1.0 - share) * states, h.within, two_sided=True)[0]
            sizes_of_noise[h.name] = getattr(components, h.name) * float(factor)
    components = replace(components, **sizes_of_noise)

    usual = problem.prior_u[1:]
    for _ in range(ROUNDS):
        sizes = problem.prior_u.copy()
        variances = np.diag(solve(rows.with_priors(problem), components).covariance)
        for h in hyperparameters:
            if h.kind == "group":
                s, precision = usual[h.members], 1.0 / variances[1:][h.members]
                variance = 1.0 / (precision - 1.0 / sizes[1:][h.members] ** 2 + 1.0 / s**2)  # with a prior of size s
                is_large = _information(s, variance, h.within) > INFORMATIVE_GROUP
                sizes[1:][h.members] = s * _expected_size(s, variance, h.within) if is_large else s
        problem = replace(problem, prior_u=sizes)
    return replace(rows, problem=problem).with_components(components)


def _information(usual: Array, variance: Array, within: float) -> float:
    """Return twice the sum of 1 − u²/(λs)² over a group, whose parameters (k,) have the `variance` (k,) with a prior of
    the `usual` size s, for a size λ as large as the session permits: one standard deviation of ln λ above 0."""
    share = np.clip(1.0 - variance / usual**2, 0.0, 1.0)
    factor2 = np.exp(2.0 * (2.0 * share.sum() + within**-2) ** -0.5)
    return float(2.0 * (factor2 * share / (factor2 * share + 1.0 - share)).sum())


def _products(solution: Solution) -> Array:
    """Return tr (PD)² (c,) of the components of scatter, from the parts within a rest and within a turn."""
    out = np.zeros(len(SCATTER))
    for _, _, C, WZ, place in solution.scatter:
        squares = ((np.swapaxes(WZ, 1, 2) @ C @ WZ) ** 2).sum(axis=0)
        for number in np.unique(place):
            out[number] += squares[np.ix_(place == number, place == number)].sum()
    return out


def _expected_scatter(degrees: float, *, of_turns: bool = False) -> float:
    """Return the root mean square of x = σ/s in the median session for ν `degrees` of freedom.

    The prior p(x) is e^{−x}, that of turns (1 + x)⁻²."""
    x = np.linspace(0.0, 12.0, 4 * POINTS)
    chi2 = scipy.special.gammaincinv(0.5 * degrees, QUANTILES)[:, None] * 2.0
    log_prior = -2.0 * np.log1p(x) if of_turns else -x
    log_density = log_prior - 0.5 * (degrees * np.log1p(x**2) + chi2 / (1.0 + x**2))
    density = np.exp(log_density - log_density.max(axis=1, keepdims=True))
    return float(np.sqrt(np.median(density @ x**2 / density.sum(axis=1))))


def _expected_size(usual: Array, variance: Array, within: float, *, two_sided: bool = False) -> Array:
    """Return the factor (k,) by which the priors of the parameters of a group are widened.

    `usual` (k,) are their usual sizes s, `variance` (k,) their variances with priors of these sizes, and `within` the
    standard deviation of ln λ. With `two_sided` the factor may be less than 1."""
    s2 = usual**2
    v = 1.0 / np.maximum(1.0 / variance - 1.0 / s2, 1e-9 / s2)
    y2 = (s2 + v) * np.random.default_rng(0).standard_normal((len(QUANTILES), len(usual))) ** 2
    log_size = np.linspace(-RANGE * within if two_sided else 0.0, RANGE * within, POINTS)
    size2 = np.exp(2.0 * log_size)[:, None] * s2  # λ²s²
    log_likelihood = -0.5 * (np.log(size2 + v).sum(axis=1) + y2 @ (1.0 / (size2 + v)).T)
    likelihood = np.exp(log_likelihood - log_likelihood.max(axis=1, keepdims=True))
    density = likelihood * np.exp(-0.5 * (log_size / within) ** 2)
    if not two_sided:  # half of the prior is on the usual size
        density /= np.sqrt(0.5 * np.pi) * within / (log_size[1] - log_size[0])
        density[:, 0] += likelihood[:, 0]
    weight = density / density.sum(axis=1, keepdims=True)
    share = size2 / (size2 + v)  # the estimate is y times this, its variance v times this
    mean_share = weight @ share
    variance_of_share = weight @ share**2 - mean_share**2
    mean_variance = np.mean(mean_share * v + variance_of_share * y2, axis=0)
    factor2 = 1.0 / np.maximum(1.0 / mean_variance - 1.0 / v, 1e-9 / s2) / s2
    return np.asarray(np.sqrt(np.clip(factor2, 0.0 if two_sided else 1.0, np.mean(weight @ np.exp(2.0 * log_size)))))
