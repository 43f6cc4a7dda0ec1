"""Joint method: the posterior of all parameters given everything recorded in a session.

The parameters of the instrument, the attitudes of all rests, in-run biases and local gravity are estimated together
from the rest means of accelerometers and gyros, the rotations and velocities of the turns, the Earth's rate and the
measured gravity (`tumble.inference.problem`). First the hyperparameters φ are found that maximise their posterior ℓ(φ),
all other unknowns integrated out (`tumble.inference.maximum`). Then the posterior of the parameters is integrated over
φ (`tumble.inference.integral`); values and u are those of this posterior. Table angles are not used. The estimate
reaches the Cramér–Rao bound.

A parameter of the linear model, or a combination of them, is determined if its u is DETERMINED times smaller than its
limit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from tumble.inference.estimate import (
    DETERMINED,
    Estimate,
    Fit,
    GroupFinding,
    HyperparameterEstimate,
    Omitted,
    OwnEstimate,
    ProcessBias,
)
from tumble.inference.fits import MAGNETOMETER, TOTAL, chi_squares, left_out, sigmas
from tumble.inference.hyperparameters import Hyperparameters
from tumble.inference.integral import Posterior, posterior
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.lag import maximum_with_lags
from tumble.inference.linearisation import at_reference
from tumble.inference.magnetic_estimate import magnetometer_estimate, with_magnetometer
from tumble.inference.maximum import MAX_ITERATIONS, Maximum, without_outliers
from tumble.inference.noise import NO_COMPONENTS, SCATTER, VarianceComponents, typical_noise
from tumble.inference.normal_equations import solve
from tumble.inference.prediction import prediction
from tumble.inference.problem import NO_PRIOR, Prior, Problem, instruments_of
from tumble.inference.sources import UncertaintyBudget, common_covariances, source
from tumble.inference.start import initial_linearisation
from tumble.reduction.observations import Observations
from tumble.sensors.compensation import specific_force
from tumble.sensors.instrument import Instrument
from tumble.units import Array

QUICK_STEPS = 12  # linearisations of a quick estimate; a valid session takes six


def joint(
    observations: Observations,
    *,
    prior: Prior = NO_PRIOR,
    instrument: Instrument | None = None,
    components: VarianceComponents | None = None,
    intervals: bool = True,
    quick: bool = False,
) -> Estimate:
    """Estimate all parameters of a session, or of several sessions together.

    Rests and turns that are outliers are left out; `Estimate.left_out` and the sigmas show which.

    Parameters
    ----------
    observations, prior
        Observations and prior knowledge.
    instrument
        The parameters; if None, all groups whose usual size the observations state.
    components
        Components of variance, if they are known; hyperparameters are not estimated then.
    intervals
        False for the posterior at the maximum, not integrated over the hyperparameters.
    quick
        True for the maximum alone after few steps, converged or not, without outlier test and budget: for a display
        that follows a session.
    """
    usual, local = instruments_of(observations)
    problem = Problem.of(observations, prior, instrument=instrument or usual, local=local, usual=observations.usual)
    start = initial_linearisation(problem)
    first = start.point.values
    start, refused = with_magnetometer(start)
    fitted, by_lag = maximum_with_lags(start, QUICK_STEPS if quick else MAX_ITERATIONS)
    if fitted.converged and not quick:
        fitted = without_outliers(fitted)
    if components is not None:
        fitted = replace(fitted, hyperparameters=Hyperparameters(()), solution=solve(fitted.linearisation, components))
    marginal = posterior(fitted, integrate=intervals and not quick and components is None, by_source=not quick)
    magnetometer = magnetometer_estimate(fitted, marginal.step)
    if magnetometer is not None and magnetometer.refused:  # estimate all other parameters without it
        estimate = joint(
            observations.without_magnetometer(), prior=prior, instrument=instrument, intervals=intervals, quick=quick,
            components=components,
        )  # fmt: skip
        return replace(estimate, magnetometer=magnetometer)
    estimate = _estimate(fitted, marginal, (first, *fitted.increments[:-1], marginal.step[1:]), by_lag)
    return replace(estimate, magnetometer=magnetometer or refused or None)


def _estimate(fitted: Maximum, marginal: Posterior, increments: tuple[Array, ...], by_lag: Array) -> Estimate:
    """Return the estimate by the posterior of the parameters, with the covariance (m, m) added by the lags."""
    problem, linearisation, best = fitted.problem, fitted.linearisation, fitted.solution
    instrument = problem.instrument
    distances = sigmas(best)
    gyro_sigmas = distances.get("gyro", np.zeros_like(distances["accel"]))
    omitted, nothing = left_out(linearisation.noise.weights), np.zeros(len(gyro_sigmas), dtype=bool)
    without_scatter = chi_squares(solve(linearisation.with_priors(problem), NO_COMPONENTS))
    inertial = [fit for name, fit in without_scatter.items() if name != MAGNETOMETER]
    chi_square, degrees = sum(fit.chi_square for fit in inertial), sum(fit.degrees for fit in inertial)
    total = Fit(chi_square=chi_square, degrees=degrees, scatter=0.0, unit="")
    observations, linear = problem.observations, instrument.linear_count
    values = linearisation.point.values + marginal.step[1:]
    common = {**common_covariances(observations, instrument), "lag": by_lag}
    budget = _budget(fitted, marginal, common) if marginal.sources else None
    common_covariance = np.sum(list(common.values()), axis=0)
    covariance = marginal.covariance[1:, 1:] + common_covariance
    # without the errors of time base and rounding, which no further rest or turn would reduce
    reducible = (marginal.covariance[1:, 1:] + by_lag)[:linear, :linear]
    spread = problem.spread[:linear]
    observable = np.ones(len(values), dtype=bool)
    observable[:linear] = np.sqrt(np.diag(reducible)) < spread / DETERMINED
    findings = tuple(_findings(fitted, np.diag(by_lag)))
    for finding in findings:
        observable[instrument.members[finding.name]] = finding.kept
    accel = problem.accel_model(values)
    readings = at_reference(linearisation) if "temperature" in problem.variables else observations.rests.accel
    force = specific_force(instrument, values, readings)
    variance, combinations = np.linalg.eigh(reducible / np.outer(spread, spread))
    of_sessions = None  # parameters of each of several sessions
    if (local := problem.local) is not None:
        local_variance = np.diagonal(best.session_covariances, axis1=1, axis2=2)[:, : len(problem.local_u)]
        of_sessions = OwnEstimate(
            names=local.names[local.linear_count :],
            units=local.units[local.linear_count :],
            values=fitted.point.local,
            u=np.sqrt(local_variance),
            priors=problem.local_u,
        )
    return Estimate(
        method="joint",
        names=instrument.names,
        units=instrument.units,
        values=values,
        covariance=covariance,
        observable=observable,
        null=combinations[:, variance > DETERMINED**-2].T,
        accel=accel,
        gyro=None if observations.gyro_block is None else problem.gyro_model(values),
        rest_residual=np.linalg.norm(force, axis=1) - observations.site.gravity,
        rest_sigmas=np.maximum(distances["accel"], gyro_sigmas),
        gyro_rest_sigmas=gyro_sigmas,
        turn_sigmas=distances["turn"],
        increments=increments,
        fits={**chi_squares(best), TOTAL: total},
        converged=fitted.converged,
        instrument=instrument,
        groups=findings,
        degrees=marginal.degrees,
        prediction=prediction(
            instrument,
            values,
            covariance,
            gravity=observations.site.gravity,
            rate=usual_rate(fitted.linearisation.integrated),
        ),
        linearised=linearisation.with_priors(problem).with_components(fitted.components),
        own=of_sessions,
        hyperparameters=tuple(_hyperparameters(fitted, marginal)),
        integral=marginal.integral,
        process_bias=tuple(_process_bias(fitted, marginal, common_covariance)),
        budget=budget,
        left_out=Omitted(accel=omitted["accel"], gyro=omitted.get("gyro", nothing), turn=omitted["turn"]),
    )


def _hyperparameters(fitted: Maximum, marginal: Posterior) -> Iterator[HyperparameterEstimate]:
    for h, (value, low, high) in zip(fitted.hyperparameters, marginal.hyperparameters.tolist(), strict=True):
        yield HyperparameterEstimate(
            name=h.name, unit=h.unit, words=h.words, value=value, low=low, high=high, usual=h.usual
        )


def _budget(fitted: Maximum, marginal: Posterior, common: Mapping[str, Array]) -> UncertaintyBudget:
    """Return the covariance by source, with the standard uncertainty of each source that is a single quantity.

    A standard deviation with relative uncertainty σ counts as 1/(2 σ²) degrees of freedom (GUM E.4.3, G.4.2); σ is half
    the width of the middle 68 % of its logarithm."""
    problem = fitted.problem
    observations, instrument, rests = problem.observations, problem.instrument, problem.observations.rests
    sizes = dict[str, tuple[float, str, float | None]]()
    turns, units = observations.turns, ("m/s^2", "rad/s", "rad", "m/s")
    covariances = [rests.accel_covariance, rests.gyro_covariance]
    covariances += [] if turns is None else [turns.covariance, turns.velocity_covariance]
    names = "accel.noise", "gyro.noise", "turn.gyro.noise", "turn.accel.noise"
    for name, covariance, unit in zip(names, covariances, units, strict=False):
        if covariance.size:
            sizes[name] = typical_noise(covariance), unit, None
    for h in _hyperparameters(fitted, marginal):
        name = f"{h.name}.scatter" if h.name in SCATTER else h.name.replace("_in_run", ".in_run")
        relative = 0.5 * np.log(h.high / h.low)
        sizes[name] = h.value, h.unit, float(0.5 / relative**2) if relative > 0.0 else None
    site, clock = observations.site, max(map(abs, observations.by_clock.values()), default=0.0)
    sizes |= {"gravity": (site.gravity_u, "m/s^2", None), "clock": (clock, "1", None)}
    for name, members in instrument.members.items():
        sizes[f"prior.{name}"] = float(problem.prior_u[1:][members][0]), instrument.units[members.start], None
    by_source = {name: covariance[1:, 1:] for name, covariance in marginal.sources.items()} | dict(common)
    by_source = {name: covariance for name, covariance in by_source.items() if covariance.any()}
    return UncertaintyBudget(
        sources=tuple(source(name, *sizes.get(name, ())) for name in by_source),
        covariances=np.array(list(by_source.values())),
    )


def _process_bias(fitted: Maximum, marginal: Posterior, common: Array) -> Iterator[ProcessBias]:
    problem, biases, components = fitted.problem, fitted.problem.biases, fitted.components
    accelerometers = problem.instrument.accel.size
    sigma, _ = components.of_states(accelerometers, problem.sensors - accelerometers)
    variances = np.diag(marginal.process_covariance) + np.diag(common)[biases]
    values = fitted.linearisation.point.values[biases] + marginal.process_step
    for i, value, variance, in_run in zip(biases.tolist(), values.tolist(), variances.tolist(), sigma, strict=True):
        u, next_u = np.sqrt(variance), np.sqrt(variance + in_run**2)
        yield ProcessBias(name=problem.instrument.names[i], value=value, u=float(u), next_u=float(next_u))


def usual_rate(integrated: IntegratedTurns | None) -> float | None:
    """Return the root mean square rate of the turns, rad/s; None without turns."""
    if integrated is None or not len(integrated.moments):
        return None
    moments = integrated.moments
    return float(np.sqrt(moments.body_rates[:, [0, 3, 5]].sum() / moments.T.sum()))


def _findings(fitted: Maximum, by_lag: Array) -> Iterator[GroupFinding]:
    """Yield the finding on each further group, given its size at the maximum; `by_lag` (m,) has the variances of
    lags."""
    variance, problem = fitted.solution.covariance.diagonal()[1:], fitted.problem
    for group in problem.instrument.further:
        members = problem.instrument.members[group.name]
        if group.variable == "lag":
            prior = np.array([problem.observations.usual[group.name]])
            yield GroupFinding.of(group.name, prior, prior, by_lag[members])
        else:
            usual, size = problem.usual_u[1:][members], problem.prior_u[1:][members]
            yield GroupFinding.of(group.name, usual, size, variance[members])
