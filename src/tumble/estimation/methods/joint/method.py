"""Joint method: maximum likelihood over everything a session contains.

All parameters of the instrument, the attitudes of all rests and local gravity are found at once from the rest means of
both blocks, the rotations and velocities of the turns, the Earth's rate and the measured gravity
(`tumble.estimation.likelihood`), by Gauss–Newton. The table's angles are not used. The estimate reaches the Cramér–Rao
bound.

How many degrees of freedom stand behind a u is by Welch–Satterthwaite: ν = 2 u⁴ / Var(u²), with the variance from that
of the components of scatter.

What is seen: a parameter of the linear model counts as determined when it is known DETERMINED times better than its
limit; so does a combination of them.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from tumble.estimation.causes.neighbouring_rests import common_to_neighbours
from tumble.estimation.common_errors import common_covariance
from tumble.estimation.estimate import DETERMINED, Estimate, GroupFinding, OwnEstimate
from tumble.estimation.likelihood import NO_PRIOR, Linearised, Prior, Problem, instruments_of
from tumble.estimation.linearisation import at_reference
from tumble.estimation.methods.joint.fit import ALL_STEPS, Fitted
from tumble.estimation.methods.joint.iteration import negligible
from tumble.estimation.methods.joint.lag import KEPT, fit_with_lag, with_lag, with_posterior
from tumble.estimation.methods.joint.leaving_out import MOST_LEFT_OUT, sigmas_of, without_misfits
from tumble.estimation.methods.joint.start import start_of
from tumble.estimation.methods.joint.warm_up import with_warm_up
from tumble.estimation.prediction import prediction
from tumble.estimation.step import variance_slopes
from tumble.estimation.turns_about import TurnsAbout
from tumble.reduction.observations import Observations
from tumble.sensors.compensation import specific_force
from tumble.sensors.instrument import Instrument
from tumble.units import Array

QUICK_STEPS = 20
"""Steps that the fit of a quick estimate may take: that of a sound session takes ten."""
QUICK_LEFT_OUT = 1
"""Rests and turns that a quick estimate leaves out at most: each costs as much as the estimate with them."""
MOST_DEGREES = 1e6


def joint(
    observations: Observations,
    *,
    prior: Prior = NO_PRIOR,
    robust: bool = False,
    instrument: Instrument | None = None,
    quick: bool = False,
) -> Estimate:
    """All parameters of a session by maximum likelihood, with covariance and outcome. The `instrument` says which;
    where None, the groups whose usual size the observations know. With `robust`, the estimate is that without the
    rests and turns that do not fit; their sigmas say which they are. A `quick` one ends after
    QUICK_STEPS, settled or not; of what does not fit it looks for QUICK_LEFT_OUT, where it has not settled for nothing:
    it is for a page that follows a session and cannot wait for one that contradicts itself."""
    usual, own = instruments_of(observations)
    instrument = instrument or usual
    problem = Problem.of(observations, prior, instrument=instrument, own=own, usual=observations.usual)
    at, first = start_of(problem)
    held, at = with_lag(problem, at)
    everything = fit_with_lag(problem, held, at, QUICK_STEPS if quick else ALL_STEPS)
    if not quick and own is None:
        everything = with_warm_up(everything, problem)
    most = (QUICK_LEFT_OUT if everything.settled else 0) if quick else MOST_LEFT_OUT
    fitting = without_misfits(everything, most)
    shown = with_posterior(fitting if robust else everything, problem)
    return _estimate(shown, first + shown.increments, sigmas_of(fitting, everything.scatter))


def _estimate(fitted: Fitted, increments: tuple[Array, ...], sigmas: tuple[Array, Array, Array]) -> Estimate:
    accel_sigmas, gyro_sigmas, turn_sigmas = sigmas
    problem, instrument = fitted.problem, fitted.problem.instrument
    observations, linear = problem.observations, instrument.linear_count
    values, last = fitted.solved.point.values, fitted.solved.last
    linearised = _linearised(fitted)
    covariance = fitted.solved.step.covariance[1:, 1:] + common_covariance(observations, instrument)
    covariance += common_to_neighbours(linearised)
    spread = problem.spread[:linear]
    observable = np.ones(len(values), dtype=bool)
    observable[:linear] = np.sqrt(np.diag(covariance)[:linear]) < spread / DETERMINED
    findings = tuple(_findings(fitted, covariance))
    for finding in findings:
        observable[instrument.members[finding.name]] = finding.kept
    accel = problem.accel_model(values)
    return Estimate(
        method="joint",
        names=instrument.names,
        units=instrument.units,
        values=values,
        covariance=covariance,
        observable=observable,
        null=_undetermined(covariance[:linear, :linear] / np.outer(spread, spread)),
        accel=accel,
        gyro=None if observations.gyro_block is None else problem.gyro_model(values),
        rest_residual=np.linalg.norm(_force(fitted), axis=1) - observations.site.gravity,
        rest_sigmas=np.maximum(accel_sigmas, gyro_sigmas),
        gyro_rest_sigmas=gyro_sigmas,
        turn_sigmas=turn_sigmas,
        increments=increments,
        fits=fitted.fits,
        converged=fitted.settled and negligible(problem, fitted.solved.step),
        instrument=instrument,
        groups=findings,
        degrees=_degrees(fitted, covariance),
        prediction=prediction(
            instrument,
            values,
            covariance,
            gravity=observations.site.gravity,
            rate=_usual_rate(last.about),
        ),
        linearised=linearised,
        own=_own(fitted),
    )


def _undetermined(covariance: Array) -> Array:
    """The combinations (q, n) of parameters whose variance is too large, of their covariance in units of the spreads.
    None has one larger than the sum of all."""
    if np.trace(covariance) <= DETERMINED**-2:
        return np.zeros((0, len(covariance)))
    variance, combinations = np.linalg.eigh(covariance)
    return np.asarray(combinations[:, variance > DETERMINED**-2].T)


def _linearised(fitted: Fitted) -> Linearised:
    """The likelihood about the solution."""
    last = fitted.solved.last
    return Linearised(
        problem=fitted.problem,
        point=last.point,
        about=last.about,
        rows=last.rows,
        noise=last.noise,
        scatter=fitted.scatter,
    )


def _usual_rate(about: TurnsAbout | None) -> float | None:
    """The rate of the session's turns, rad/s, root mean square; None without turns."""
    if about is None or not len(about.moments):
        return None
    moments = about.moments
    return float(np.sqrt(moments.body_rates[:, [0, 3, 5]].sum() / moments.T.sum()))


def _force(fitted: Fitted) -> Array:
    """Specific forces (N, 3) at rest by the whole model."""
    problem, last = fitted.problem, fitted.solved.last
    accel = problem.observations.rests.accel
    if "temperature" in problem.variables:
        accel = at_reference(problem, last.point, last.rows)
    return specific_force(problem.instrument, fitted.solved.point.values, accel)


def _own(fitted: Fitted) -> OwnEstimate | None:
    """What each of several sessions has of its own."""
    own = fitted.problem.own
    if own is None:
        return None
    first, q = own.linear_count, len(fitted.problem.own_known)
    variance = np.diagonal(fitted.solved.step.own_covariance, axis1=1, axis2=2)[:, :q]
    return OwnEstimate(
        names=own.names[first:],
        units=own.units[first:],
        values=fitted.solved.point.own,
        u=np.sqrt(variance),
        priors=fitted.problem.own_known,
    )


def _findings(fitted: Fitted, covariance: Array) -> Iterator[GroupFinding]:
    """What the session says of each further group."""
    instrument, widened = fitted.problem.instrument, fitted.problem.measured[1][1:]
    usual = fitted.problem.observations.usual
    for group in instrument.further:
        own = instrument.members[group.name]
        prior = usual.get(group.name, group.limit)
        learned = np.clip(1.0 - np.diag(covariance)[own] / widened[own] ** 2, 0.0, 1.0)
        yield GroupFinding(
            name=group.name,
            kept=bool(learned.max() > KEPT),
            prior=prior,
            widened=float(widened[own][0] / prior),
            learned=tuple(learned.tolist()),
        )


def _degrees(fitted: Fitted, covariance: Array) -> Array:
    """Degrees of freedom (m,) behind the u of the parameters: ν = 2 u⁴ / Var(u²)."""
    problem, variance = fitted.problem, fitted.scatter.variances
    degrees = np.full(len(covariance), MOST_DEGREES)
    if not variance.any():
        return degrees
    slopes = variance_slopes(problem, fitted.solved.step, fitted.solved.last.noise)[:, 1:] * (variance > 0.0)[:, None]
    of_u = np.einsum("am,ab,bm->m", slopes, fitted.components, slopes)
    least = 2.0 * np.diag(covariance) ** 2 / MOST_DEGREES
    return np.asarray(MOST_DEGREES * least / np.maximum(of_u, least))
