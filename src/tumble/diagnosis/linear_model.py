"""Uncertainty of a linear model by the groups of parameters that it omits.

Methods of the linear model estimate bias, scale factor and axis angles alone. Omitted groups φ of usual sizes σ, such
as a quadratic term of the accelerometers, add B φ to the data: to readings at rest β ∂K/∂θ φ, to rotations of turns
−∂φ/∂θ φ. With the derivative G of the result with respect to the data, the parameters are shifted by

    ΔX = G B φ,   cov(ΔX) = G B Σ (G B)ᵀ,   cov(ΔX, −φ) = −G B Σ,   Σ = diag(σ²)

which is added to the covariance. The groups are in the result as zero, so −φ is their error. With these covariances,
corrected forces are as certain as the fit in the attitudes of the rests, and in others as uncertain as the groups
allow. If `joint` finds a group larger than usual, σ is the root mean square of its size (`omitted_sizes`). Residuals
are judged about the joint estimate with all groups (`converged_joint`), as scatter that the groups explain would be in
u twice.

G is, for the methods of the turntable paper, the derivative of their passes; for `ellipsoid` A⁺, with the weighted
linear columns A and columns B less their part along rotations of the vertical; for `joint` with linear terms N⁻¹ Aᵀ of
its normal equations, and with those of the whole instrument N_AA⁻¹ N_AB.

This is docs/explanation/mathematics.md (36) with usual sizes; the linear columns are the rows of Eq. (13) of the
turntable paper, for any number of sensors.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tumble.diagnosis.undetermined import linear_names
from tumble.inference.estimate import Estimate, GroupFinding
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.joint import joint, usual_rate
from tumble.inference.linearisation import Linearisation, linearise
from tumble.inference.noise import SCATTER, VarianceComponents
from tumble.inference.normal_equations import solve
from tumble.inference.prediction import prediction
from tumble.inference.problem import Problem, instruments_of
from tumble.inference.sources import source
from tumble.inference.start import initial_linearisation
from tumble.inference.uncertainty_budget import contributions
from tumble.reduction.observations import Observations
from tumble.rotation import unit_vector
from tumble.sensors.instrument import Instrument, functions
from tumble.sensors.model import left_null_space, tilt_null_space
from tumble.sensors.parameters import FORCE, ParameterGroup, group_of
from tumble.units import Array

RELATIVE_RANK = 1e-9  # of the largest singular value; rests do not determine smaller ones


def converged_joint(observations: Observations, intervals: bool = True) -> Estimate | None:
    """Return the estimate by `joint`, integrated with `intervals`; None unless it converges and determines all linear
    parameters."""
    try:
        estimate = joint(observations, intervals=intervals)
    except np.linalg.LinAlgError:
        return None
    return estimate if estimate.converged and not linear_names(estimate.unobservable) else None


def omitted_sizes(problem: Problem, full: Estimate | None) -> Array:
    """Return the standard deviations (k,), SI, of the parameters of a problem beyond the linear model.

    They are the usual ones, times the ratio found by the estimate `full` of the whole instrument. Usual sizes are those
    of a grade: if one group of a kind of sensor is surely larger, the instrument is not of that grade, and groups that
    the session does not show are taken to be as much larger."""
    sizes = problem.usual_u[1:].copy()
    groups = [g for g in (() if full is None else full.groups) if g.name in problem.instrument.members]
    found = {h.name: h for h in (() if full is None else full.hyperparameters)}
    ratios, surely = dict[str, float](), {"accel": 1.0, "gyro": 1.0}
    for finding in groups:
        group = group_of(finding.name)
        size = found.get(group.sized_with or group.name)
        ratios[group.name] = finding.prior_widened if size is None else size.root_mean_square
        if size is not None and group.variable is None:
            surely[group.kind] = max(surely[group.kind], size.low)
    for name, ratio in ratios.items():
        group = group_of(name)
        least = surely[group.kind] if group.variable is None else 0.0
        sizes[problem.instrument.members[name]] *= max(ratio, least)
    return np.asarray(sizes[problem.instrument.linear_count :])


def is_omitted(group: ParameterGroup) -> bool:
    """Return True if methods of the linear model omit a group that affects their data, which lags and the groups of
    velocities (lever arms, delays) do not."""
    return group.variable != "lag" and group.motion is None


def whole_problem(observations: Observations) -> Problem:
    """Return the likelihood of the instrument with all omitted groups whose usual size is known."""
    whole = instruments_of(observations)[0]
    further = tuple(group for group in whole.further if is_omitted(group))
    return Problem.of(observations, instrument=replace(whole, further=further), usual=observations.usual)


def omitted_by_rests(
    observations: Observations, linear: Array, sigma: Array | None = None
) -> tuple[Problem, Array, Array]:
    """Return the effect of omitted groups on a fit of the accelerometers to rests.

    Parameters
    ----------
    observations
        Observations with N rests.
    linear : (m,) array
        Parameters found by the fit. Powers are of the corrected forces, as readings may have a zero of many g.
    sigma : (N,) array, optional
        Standard deviations of the rests, equal by default.

    Returns
    -------
    problem : Problem
        The likelihood with the groups.
    shift : (m, k) array
        Shift of the parameters by one of each parameter of the groups.
    rows : (r, k) array
        Columns of the groups, less the part that the fit absorbs, in units of `sigma`.
    """
    rests_only = observations.of_accelerometers()
    problem = whole_problem(rests_only)
    instrument, block, g = problem.instrument, rests_only.accel_block, rests_only.site.gravity
    values = np.append(linear, np.zeros(len(instrument.names) - len(linear)))
    force = g * unit_vector(block.model(linear).apply(rests_only.rests.accel))
    beta, D = functions(block, force, np.zeros_like(force)), instrument.derivative(block, values)
    changes = np.einsum("ipb,pbm->ipm", beta, D)
    changing, base = problem.change_columns
    changes[:, :, changing] = changes[:, :, base] * problem.regressors[0][:, None]
    across = tilt_null_space(instrument.coefficients(block, values)[:, FORCE], force / g)
    rows = np.einsum("ipr,ipm->irm", across, changes).reshape(-1, len(values))
    if sigma is not None:
        rows = rows / np.repeat(sigma, block.size - 2)[:, None]
    A, B = np.split(rows, [instrument.linear_count], axis=1)
    shift = np.linalg.pinv(A, rcond=RELATIVE_RANK) @ B
    return problem, shift, B - A @ shift


def group_columns(observations: Observations) -> tuple[Problem, Array]:
    """Return the likelihood with all omitted groups, and their columns (d, k) in the data of the paper's methods.

    The data are the readings of accelerometers and gyros at rest (those of triads in body axes), the errors of turns,
    the integrals over them of the readings of more than three gyros, and gravity."""
    problem = whole_problem(observations)
    rows, columns = initial_linearisation(problem).rows, list[Array]()
    k = len(problem.instrument.names) - problem.instrument.linear_count
    for block in problem.instrument.blocks:
        of_rests = rows[block.kind][:, :, -1 - k : -1]
        columns.append(block.axes.T @ of_rests if block.triad else of_rests)
    columns.append(rows["turn"][:, :3, -1 - k : -1])
    if observations.turn_readings is not None:
        free = left_null_space(problem.instrument.blocks[1].axes)
        columns.append(free.T @ rows["turn"][:, -len(free) :, -1 - k : -1])
    return problem, np.concatenate([*(each.reshape(-1, k) for each in columns), np.zeros((1, k))])


def linear_joint(observations: Observations) -> Estimate:
    """Return the estimate of the linear model by `joint`, with the omitted groups in its u.

    Scatter and in-run biases are those of the estimate with all groups, if there is one, by which rests and turns are
    judged too: groups of their usual sizes are many times the noise, and are in u."""
    full, problem = converged_joint(observations), whole_problem(observations)
    estimate = joint(replace(observations, usual={}), components=None if full is None else rms_components(full))
    linear, instrument = estimate.linearised, problem.instrument
    assert linear is not None
    values = np.append(linear.point.values, np.zeros(len(instrument.names) - instrument.linear_count))
    point = replace(linear.point, values=values)
    integrated = None if linear.integrated is None else IntegratedTurns.of(observations, instrument, values)
    shift = shift_by_likelihood(replace(linearise(problem, point, integrated), noise=linear.noise))
    if full is not None and estimate.converged:
        assert full.budget is not None
        assert estimate.budget is not None
        sources = {each.name: each for each in full.budget.sources}
        estimate = replace(
            estimate,
            linearised=full.linearised,
            rest_sigmas=full.rest_sigmas,
            gyro_rest_sigmas=full.gyro_rest_sigmas,
            turn_sigmas=full.turn_sigmas,
            hyperparameters=full.hyperparameters,
            degrees=None if full.degrees is None else full.degrees[: instrument.linear_count],
            budget=replace(estimate.budget, sources=tuple(sources.get(s.name, s) for s in estimate.budget.sources)),
        )
    return with_omitted_groups(estimate, problem, shift, omitted_sizes(problem, full))


def rms_components(estimate: Estimate) -> VarianceComponents:
    """Return scatter and in-run biases of the root mean square size in the posterior."""
    assert estimate.linearised is not None
    names = (*SCATTER, "accel_in_run", "gyro_in_run")
    sizes: dict[str, Any] = {h.name: h.root_mean_square for h in estimate.hyperparameters if h.name in names}
    return replace(estimate.linearised.components, **sizes)


def shift_by_likelihood(rows: Linearisation) -> Array:
    """Return the shift (m, k) of the linear parameters by one of each parameter of the groups, −C_AB C_BB⁻¹ of the
    covariance C by the likelihood of the instrument with all groups, with the noise of a fit of the linear model."""
    covariance = np.sum(list(contributions(solve(rows)).values()), axis=0)[1:, 1:]
    A, B = np.split(covariance[:, rows.problem.instrument.linear_count :], [rows.problem.instrument.linear_count])
    return np.asarray(-np.linalg.solve(B, A.T).T)


def with_omitted_groups(estimate: Estimate, problem: Problem, shift: Array, sizes: Array) -> Estimate:
    """Return an estimate with the omitted groups at zero, and their part in its covariance.

    Parameters
    ----------
    estimate
        Estimate of the m parameters of the linear model.
    problem
        The likelihood with the groups.
    shift : (m, k) array
        Shift of the linear parameters by one of each parameter of the groups.
    sizes : (k,) array
        Standard deviations of the parameters of the groups, SI.
    """
    instrument, first, usual = problem.instrument, problem.instrument.linear_count, problem.usual_u[1:]
    full = _with_parameters(estimate, instrument)
    error = np.vstack([-shift * sizes, np.diag(sizes)])  # by one standard deviation of each parameter of the groups
    covariance, degrees, budget = full.covariance + error @ error.T, full.degrees, full.budget
    groups = list[GroupFinding]()
    if degrees is not None:
        degrees[:first] *= np.diag(covariance)[:first] ** 2 / np.diag(estimate.covariance) ** 2
    for group in instrument.further:
        place = instrument.members[group.name]
        of_group, size = error[:, place.start - first : place.stop - first], float(sizes[place.start - first])
        groups.append(
            GroupFinding(
                name=group.name,
                kept=True,
                prior=float(usual[place.start]),
                prior_widened=size / float(usual[place.start]),
                learned=(0.0,) * of_group.shape[1],
            )
        )
        if budget is not None:
            prior = source(f"prior.{group.name}", size, instrument.units[place.start])
            budget = budget.with_source(prior, of_group @ of_group.T)
    rate = usual_rate(None if estimate.linearised is None else estimate.linearised.integrated)
    gravity = problem.observations.site.gravity
    return replace(
        full,
        budget=budget,
        covariance=covariance,
        groups=tuple(groups),
        degrees=degrees,
        prediction=prediction(instrument, full.values, covariance, gravity=gravity, rate=rate),
    )


def linear_part(estimate: Estimate) -> Estimate:
    """Return an estimate without its omitted groups, whose part in the covariance of the others stays."""
    instrument = estimate.instrument
    return estimate if instrument is None else _with_parameters(estimate, replace(instrument, further=()))


def _with_parameters(estimate: Estimate, instrument: Instrument) -> Estimate:
    """Return an estimate with the parameters of an instrument, of which it has the first, or more; others are zero."""
    n, m = len(instrument.names), len(estimate.names)
    zeros, degrees = np.zeros(max(n - m, 0)), estimate.degrees
    return replace(
        estimate,
        instrument=instrument,
        names=instrument.names,
        units=instrument.units,
        groups=(),
        values=np.append(estimate.values[:n], zeros),
        covariance=np.pad(estimate.covariance[:n, :n], (0, len(zeros))),
        observable=np.append(estimate.observable[:n], zeros == 0.0),
        null=np.pad(estimate.null[:, :n], ((0, 0), (0, len(zeros)))),
        increments=tuple(np.append(step[:n], zeros) for step in estimate.increments),
        degrees=None if degrees is None else np.append(degrees[:n], zeros + np.inf),
        budget=None if estimate.budget is None else estimate.budget.carried(np.eye(n, m)),
    )
