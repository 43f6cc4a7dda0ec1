"""What `calibrate` will state of a recording that has not been made: the one answer for every question of planning.

The rows are those of `tumble.inference.problem`, linearised at perfect sensors and at the attitudes of the
programme, which are unknowns and are eliminated. With the white noise of the instrument, with its in-run biases as
Gauss–Markov processes (`tumble.inference.noise`), of which a bias is the mean over the session, and with the usual
sizes of the groups beyond the linear model as priors, the covariance is the Cramér–Rao bound of the joint likelihood.
`stated` adds what `calibrate` does not know of a recording:

* the noise and the sizes of groups in this instrument (`tumble.planning.expected_sizes`);
* the time base, which is common to all gyro scale factors;
* where the rests end: the segmentation leaves their margins to the turns.

All moves between rests are in the log, about one axis each at a constant rate (`tumble.planning.steady_turns`). Errors
of table and mounting are not in the answer, as the attitudes are unknowns: a degree changes it by parts of a thousand.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tumble.brief import Brief
from tumble.diagnosis.linear_model import is_omitted, shift_by_likelihood
from tumble.earth import earth_rate
from tumble.errors import InputError
from tumble.inference.estimate import DETERMINED, UNOBSERVABLE_SHARE
from tumble.inference.hyperparameters import size_factors
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.linearisation import Linearisation, linearise
from tumble.inference.noise import VarianceComponents
from tumble.inference.normal_equations import solve
from tumble.inference.problem import Point, Problem
from tumble.inference.sources import clock_effects, clock_errors
from tumble.inference.uncertainty_budget import contributions
from tumble.planning.expected_sizes import expected
from tumble.planning.in_motion import Motion, observed_in_motion
from tumble.planning.itinerary import Itinerary, itinerary_of
from tumble.planning.setup import ACCEL, GYRO, Setup, check_setup
from tumble.planning.steady_turns import inertial_turns, steady_samples, white_turns
from tumble.recording.session import Site
from tumble.reduction.blocks.tuning import USUAL
from tumble.reduction.observations import Observations
from tumble.reduction.rests.rests import Rests
from tumble.reduction.turns.turns import TURN_FLOOR, VELOCITY_FLOOR
from tumble.sensors.grades import GRADES, NoiseModel
from tumble.sensors.instrument import Instrument
from tumble.sensors.parameters import Terms, positions_by_group, prior_sizes
from tumble.units import Array, BoolArray

NOISE, GRAVITY, CLOCK = "noise and in-run biases", "gravity of the site", "time base of the log"
"""Names of sources; those of groups of parameters are the names of the groups."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Bound(Brief):
    """Expected covariance of a calibration, SI, of parameters `names` (m), the first `linear` of the linear model.

    `observable` (m,) says which are determined; those of further groups always are, by their priors. `null` (q, linear)
    are the combinations of linear parameters that are not, of unit length in natural units: biases as parts of gravity
    and of the rate of the turns, angles in rad. `condition` is that of the whitened Jacobian of the linear parameters
    in these units, infinite where a combination is not determined; of accelerometers alone it is the condition of H,
    Eq. (13) of the turntable paper. `sources` are variances (m,) by source, which add up to those of the parameters.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    linear: int
    covariance: Array
    observable: BoolArray
    null: Array
    condition: float
    sources: Mapping[str, Array]

    @property
    def u(self) -> Array:
        """Standard uncertainties (m,), SI; infinite where a parameter is not determined."""
        return np.where(self.observable, np.sqrt(np.diag(self.covariance)), np.inf)

    @property
    def rank(self) -> int:
        """How many combinations of the linear parameters are determined."""
        return self.linear - len(self.null)

    def rms(self, group: str) -> float:
        """Root mean square of u over a group such as "accel.bias", SI. Raises KeyError for a group that is not
        there."""
        return float(np.sqrt(np.mean(self.u[positions_by_group(self.names)[group]] ** 2)))


def stated(setup: Setup, *, gyros: bool = True, terms: Terms = "full", motion: Motion | None = None) -> Bound:
    """What `calibrate` will state of a recording by a set-up's programme, on the average over instruments.

    Parameters
    ----------
    setup
        The instrument, whose groups beyond the linear model are those of `setup.further`, programme and site.
    gyros
        Whether gyros are calibrated, or accelerometers alone.
    terms
        With "linear" the estimate has bias, scale factor and axis angles alone, and the groups in their u.
    motion
        A recording in motion in place of the programme.

    Raises
    ------
    InputError
        For values that make no sense, and where there is no noise.
    """
    if motion is not None:
        return _mean([_stated(course, setup, gyros=True, terms=terms) for course in motion.courses])
    if not setup.programme.ordered:
        return _mean_over_orders(setup, lambda each: stated(each, gyros=gyros, terms=terms))
    course = itinerary_of(setup).as_logged(setup.ramp, USUAL.margin_of(setup.rest))
    return _stated(course, setup, gyros=gyros, terms=terms)


def _stated(course: Itinerary | Motion, setup: Setup, *, gyros: bool, terms: Terms) -> Bound:
    """What `calibrate` will state of a course."""
    seen = view(course, setup, gyros=gyros)
    seen = expected(seen.with_components(_with_drifts(seen, setup.further)))
    if terms == "linear":
        return _stated_linear(course, setup, seen)
    return bound_by(seen, setup.turn_rate, setup.clock_u)


def _stated_linear(course: Itinerary | Motion, setup: Setup, whole: Linearisation) -> Bound:
    """What an estimate of the linear model states, with what it leaves out, of sizes, and beside scatter, as the
    `whole` likelihood expects them."""
    gyros, components = whole.problem.observations.gyro_block is not None, whole.components
    linear = view(course, replace(setup, further={}), gyros=gyros).with_components(components)
    found = bound_by(linear, setup.turn_rate, setup.clock_u)
    groups = {g.name: setup.further[g.name] for g in whole.problem.instrument.further if is_omitted(g)}
    if not groups:
        return found
    seen = view(course, replace(setup, further=groups), gyros=gyros).with_components(components)
    instrument, sizes = seen.problem.instrument, whole.problem.prior_u[1:]
    sources, covariance, moves = dict(found.sources), found.covariance, shift_by_likelihood(seen)
    for name in groups:
        own = instrument.members[name]
        moved = (
            moves[:, own.start - found.linear : own.stop - found.linear] * sizes[whole.problem.instrument.members[name]]
        )
        covariance, sources[name] = covariance + moved @ moved.T, (moved**2).sum(axis=1)
    return replace(found, covariance=covariance, sources=sources)


ORDERS = 8
"""Of positions that come in any order, over which is averaged."""


def _mean_over_orders(setup: Setup, state: Callable[[Setup], Bound]) -> Bound:
    """The mean of bounds over several orders of the positions of a programme."""
    listed, rng = setup.programme, np.random.default_rng(0)
    orders = [rng.permutation(len(listed.positions)).tolist() for _ in range(ORDERS)]
    programmes = (replace(listed, positions=tuple(listed.positions[i] for i in o), ordered=True) for o in orders)
    return _mean([state(replace(setup, programme=each)) for each in programmes])


def _mean(bounds: list[Bound]) -> Bound:
    """The mean of bounds."""
    return replace(
        bounds[0],
        covariance=np.mean([each.covariance for each in bounds], axis=0),
        condition=float(np.mean([each.condition for each in bounds])),
        sources={name: np.mean([each.sources[name] for each in bounds], axis=0) for name in bounds[0].sources},
    )


def instrument_of(setup: Setup, gyros: bool) -> Instrument:
    """The instrument of a set-up: triads along the body axes with the groups of parameters it has."""
    return Instrument.of(ACCEL, GYRO if gyros else None, tuple(prior_sizes(setup.instrument, usual=setup.further)))


def bound_by(seen: Linearisation, rate: float, clock_u: float = 0.0) -> Bound:
    """The covariance of the parameters that a linearised likelihood of one session gives.

    Parameters
    ----------
    seen
        Rows at the true parameters, with their noise.
    rate
        Rate of the turns, rad/s: the natural unit of gyro biases.
    clock_u
        Relative standard uncertainty of the time base.
    """
    problem, instrument = seen.problem, seen.problem.instrument
    linear, m = instrument.linear_count, len(instrument.names)
    parts = {name: covariance[1:, 1:] for name, covariance in contributions(solve(seen.with_priors(problem))).items()}
    covariance = np.sum(list(parts.values()), axis=0)

    # what the data determine no better than to DETERMINED times their spread is left to the limits of parameters
    spread, of_linear = problem.spread[:linear], covariance[:linear, :linear]
    variance, vectors = np.linalg.eigh(of_linear / np.outer(spread, spread))
    unseen = vectors[:, variance > DETERMINED**-2].T
    natural_sizes = {"m/s^2": problem.observations.site.gravity, "rad/s": rate, "1": 1.0, "rad": 1.0}
    natural = np.array([natural_sizes[unit] for unit in instrument.units[:linear]])
    null = unseen * spread / natural
    lengths = np.sqrt(np.linalg.eigvalsh(of_linear / np.outer(natural, natural)))

    # sensors that read rates and forces have the time base in their scale factors; increments would not
    clock = clock_errors(instrument.names, clock_effects(clock_u, {"accel": False, "gyro": False}))
    covariance = covariance + np.outer(clock, clock)
    priors = {name: f"prior.{name}" for name in instrument.members}
    sources = {name: np.diag(parts[part]) for name, part in {GRAVITY: "gravity", **priors}.items() if part in parts}
    sources[CLOCK] = clock**2
    return Bound(
        names=instrument.names,
        units=instrument.units,
        linear=linear,
        covariance=covariance,
        observable=np.append(np.sqrt((unseen**2).sum(axis=0)) < UNOBSERVABLE_SHARE, np.ones(m - linear, dtype=bool)),
        null=null / np.linalg.norm(null, axis=1, keepdims=True),
        condition=np.inf if len(null) else float(lengths[-1] / lengths[0]),
        sources={NOISE: np.maximum(np.diag(covariance) - sum(sources.values()), 0.0), **sources},
    )


SHORTEST_TIME = 1e-3
"""s: of the correlation of biases that are drawn anew at every rest."""


def components_of(noise: NoiseModel) -> VarianceComponents:
    """The in-run instability of an instrument."""
    time = max(noise.instability_time, SHORTEST_TIME)
    return VarianceComponents(
        accel_in_run=noise.accel_instability, gyro_in_run=noise.gyro_instability, accel_time=time, gyro_time=time
    )


def _with_drifts(seen: Linearisation, further: Mapping[str, float]) -> VarianceComponents:
    """The in-run biases of sensors that drift too, for which the estimate has no group: its process takes it.

    A line d t over a session of length T has the variance σ₁² = (d T)²/12, and from rest to rest changes by d Δt, as a
    process with τ₁ = 2 σ₁²/(d² Δt) does. Variances add up, and so do those of the changes, 2 σ² Δt/τ."""
    rests, links, components = seen.problem.observations.rests, seen.problem.observations.links, seen.components
    middle = 0.5 * (rests.start + rests.stop) if links is None else links.time
    length, interval = float(np.ptp(middle)), float(np.median(np.diff(middle))) if len(middle) > 1 else 0.0
    for kind in ("accel", "gyro"):
        drift, size = further.get(f"{kind}.bias.drift", 0.0), getattr(components, f"{kind}_in_run")
        if drift == 0.0 or f"{kind}.bias.drift" in seen.problem.observations.usual:
            continue
        changes = size**2 / getattr(components, f"{kind}_time") + 0.5 * drift**2 * interval
        square = size**2 + (drift * length) ** 2 / 12.0
        changed: dict[str, Any] = {f"{kind}_in_run": math.sqrt(square), f"{kind}_time": square / changes}
        components = replace(components, **changed)
    return components


def view(course: Itinerary | Motion, setup: Setup, *, gyros: bool) -> Linearisation:
    """The likelihood of a course, linearised at perfect sensors and its attitudes, with white noise and in-run biases.
    Raises InputError for values that make no sense, and where there is no noise."""
    check_setup(setup)
    noise = setup.noise
    for sensors, level in (
        ("accelerometers", noise.accel_white + noise.accel_instability),
        ("gyros", noise.gyro_white),
    ):
        if level == 0.0 and (gyros or sensors == "accelerometers"):
            raise InputError(f"noise: expected {sensors} with noise, found none; without it there is no bound")
    instrument, about, components = instrument_of(setup, gyros), None, components_of(noise)
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
    values, still = np.zeros(len(instrument.names)), np.zeros((len(attitudes) if problem.moves else 0, 3))
    point = Point(
        values=values,
        gravity=setup.gravity,
        attitudes=attitudes,
        local=np.zeros((1, len(problem.local_u))),
        velocities=still,
        displacements=still,
    )
    if observations.turns is not None:
        about = IntegratedTurns.of(observations, instrument, values)
    return linearise(problem, point, about, components)


def _observed_on_table(course: Itinerary, setup: Setup, instrument: Instrument) -> Observations:
    """Observations of a course of rests and turns as perfect sensors make them, in white noise."""
    turns, samples, noise, gyros = None, None, setup.noise, instrument.gyro is not None
    earth, g, first = np.array(earth_rate(setup.latitude)), setup.gravity, course.first
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
