"""What a method of the linear model takes as nothing, and what it has of it in its u; and whether the session shows it.

The methods beside `joint`, and `joint` with linear terms, have bias, scale factor and axis angles alone, and take what
else there is for one of these: a quadratic term of the accelerometers for a bias and scale factors. Groups of usual
size σ, beyond bias, scale factor and axis angles, add B φ to what is observed: to readings at rest β ∂K/∂θ φ, to
rotations of turns −∂φ/∂θ φ. With the derivative G of the result by what is observed, the parameters move by

    ΔX = G B φ,   cov(ΔX) = G B Σ (G B)ᵀ,   cov(ΔX, −φ) = −G B Σ,   Σ = diag(σ²)

which is in u, of all of these methods. The groups stay at nothing, so that −φ is their error. With it the corrected
force in the attitudes of the rests is as well known as the fit has it, and in others as badly as the groups allow.
Where the session shows another size than σ, it is the root mean square of what `joint` finds of it (`left_out_sizes`).
Scatter is judged beside the groups: of residuals that these explain none is left for it, else they would be in u twice.

G is of the methods of the paper the derivative of their passes; of `ellipsoid` A⁺, A being the linear columns with the
weights that the fit has and B what no turn of the vertical reaches; and of `joint` with linear terms N⁻¹ Aᵀ of its
normal equations, which gives N_AA⁻¹ N_AB with those of the whole instrument.

Residuals are judged about the estimate that `joint` makes with all groups (`by_joint`): what these explain is in u, and
the turns show most of what rests alone can be fitted to.

This is docs/explanation/mathematics.md (36) with usual sizes; the columns are those of Eq. (12) of the turntable paper,
for any number of sensors.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tumble.diagnosis.undetermined import linear_names
from tumble.inference.estimate import Estimate, GroupFinding
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.joint import joint
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
from tumble.sensors.instrument import functions
from tumble.sensors.model import beyond_body, beyond_turning
from tumble.sensors.parameters import FORCE, ParameterGroup, group_of
from tumble.units import Array

_NOTHING = 1e-9
"""Of the largest singular value: what rests do not determine is moved by nothing that they show."""


def by_joint(observations: Observations, intervals: bool = True) -> Estimate | None:
    """What `joint` makes of observations, integrated for `intervals`; None where it does not converge or leaves a
    linear parameter open."""
    try:
        found = joint(observations, intervals=intervals)
    except np.linalg.LinAlgError:
        return None
    return found if found.converged and not linear_names(found.unobservable) else None


def left_out_sizes(problem: Problem, beside: Estimate | None) -> Array:
    """The standard deviations (k,) of what a problem has beyond the linear model: the usual ones, as many times larger
    as the estimate `beside` says."""
    sizes, posterior = problem.usual_u[1:].copy(), {}
    if beside is not None:
        posterior = {h.name: h.root_mean_square for h in beside.hyperparameters}
    for group in () if beside is None else beside.groups:
        if group.name in problem.instrument.members:
            larger = posterior.get(group_of(group.name).sized_with or group.name, group.prior_widened)
            sizes[problem.instrument.members[group.name]] *= larger
    return np.asarray(sizes[problem.instrument.linear_count :])


def whole_problem(observations: Observations) -> Problem:
    """The likelihood of the instrument with all groups whose usual size the observations know, without those that a
    method of the linear model does not see: lever arms and delays, which act on velocities, and the lag."""
    whole = instruments_of(observations)[0]
    further = tuple(group for group in whole.further if left_out(group))
    return Problem.of(observations, instrument=replace(whole, further=further), usual=observations.usual)


def left_out(group: ParameterGroup) -> bool:
    """Whether a group is one that methods of the linear model leave out and that acts on what they see."""
    return group.variable != "lag" and group.motion is None


def left_out_by_rests(
    observations: Observations, linear: Array, sigma: Array | None = None
) -> tuple[Problem, Array, Array]:
    """The likelihood with what a fit of the accelerometers to rests leaves out that has the parameters `linear` (m,),
    by how much one of each group moves these (m, k), and what it leaves in its rows (r, k), in units of the standard
    deviations `sigma` (N,) of the rests, equal ones where None. Powers are of the forces that the fit makes of the
    readings, which may have a zero of many g."""
    seen = observations.of_accelerometers()
    problem = whole_problem(seen)
    instrument, block, g = problem.instrument, seen.accel_block, seen.site.gravity
    values = np.append(linear, np.zeros(len(instrument.names) - len(linear)))
    force = g * unit_vector(block.model(linear).apply(seen.rests.accel))
    beta, D = functions(block, force, np.zeros_like(force)), instrument.derivative(block, values)
    changes = np.einsum("ipb,pbm->ipm", beta, D)
    changing, base = problem.change_columns
    changes[:, :, changing] = changes[:, :, base] * problem.regressors[0][:, None]
    across = beyond_turning(instrument.coefficients(block, values)[:, FORCE], force / g)
    rows = np.einsum("ipr,ipm->irm", across, changes).reshape(-1, len(values))
    if sigma is not None:
        rows = rows / np.repeat(sigma, block.size - 2)[:, None]
    A, B = np.split(rows, [instrument.linear_count], axis=1)
    moves = np.linalg.pinv(A, rcond=_NOTHING) @ B
    return problem, moves, B - A @ moves


def groups_in_data(observations: Observations) -> tuple[Problem, Array]:
    """The likelihood with all groups, and what one of each group adds (d, k) to the data of the methods of the paper:
    the readings of accelerometers, then gyros, at rest, in body axes those of triads, the errors of the turns, the
    integrals over them of the readings of more than three gyros, and gravity."""
    problem = whole_problem(observations)
    rows, first, shown, last = initial_linearisation(problem), problem.instrument.linear_count, list[Array](), 0
    for block in problem.instrument.blocks:
        of_rests = rows.rest[:, last : last + block.size, 4 + first : -1]
        shown.append(block.axes.T @ of_rests if block.triad else of_rests)
        last += block.size
    shown.append(rows.turn[:, :3, 7 + first : -1])
    if observations.turn_readings is not None:
        free = beyond_body(problem.instrument.blocks[1].axes)
        shown.append(free.T @ rows.turn[:, -len(free) :, 7 + first : -1])
    groups = len(problem.instrument.names) - first
    every = [each.reshape(-1, groups) for each in shown]
    return problem, np.concatenate([*every, np.zeros((1, groups))])


def linear_joint(observations: Observations) -> Estimate:
    """The estimate by `joint` of the linear model, with what it leaves out. Scatter and in-run biases are those that
    stand beside all groups, where there is an estimate with these: else the groups would count twice."""
    beside, problem = by_joint(observations), whole_problem(observations)
    estimate = joint(replace(observations, usual={}), components=None if beside is None else components_in(beside))
    linear, instrument = estimate.linearised, problem.instrument
    assert linear is not None
    values = np.append(linear.point.values, np.zeros(len(instrument.names) - instrument.linear_count))
    point = replace(linear.point, values=values)
    about = None if linear.about is None else IntegratedTurns.of(observations, instrument, values)
    moves = moves_by_likelihood(replace(linearise(problem, point, about), noise=linear.noise))
    if beside is not None and estimate.converged:
        assert beside.budget is not None
        assert estimate.budget is not None
        sources = {each.name: each for each in beside.budget.sources}
        estimate = replace(
            estimate,
            linearised=beside.linearised,
            hyperparameters=beside.hyperparameters,
            degrees=None if beside.degrees is None else beside.degrees[: instrument.linear_count],
            budget=replace(estimate.budget, sources=tuple(sources.get(s.name, s) for s in estimate.budget.sources)),
        )
    return with_left_out(estimate, problem, moves, left_out_sizes(problem, beside))


def components_in(estimate: Estimate) -> VarianceComponents:
    """Scatter and in-run biases of the sizes that count in the u of an estimate, the roots of their mean squares."""
    assert estimate.linearised is not None
    names = (*SCATTER, "accel_in_run", "gyro_in_run")
    sizes: dict[str, Any] = {h.name: h.root_mean_square for h in estimate.hyperparameters if h.name in names}
    return replace(estimate.linearised.components, **sizes)


def moves_by_likelihood(rows: Linearisation) -> Array:
    """By how much one of each group moves the parameters (m, k) of the linear model in a fit by the likelihood:
    −C_AB C_BB⁻¹ of the covariance C that it gives with groups of any size.

    Parameters
    ----------
    rows
        The likelihood of the instrument with all groups, whose priors of the linear parameters count, with the noise of
        a fit of the linear model.
    """
    covariance = np.sum(list(contributions(solve(rows)).values()), axis=0)[1:, 1:]
    A, B = np.split(covariance[:, rows.problem.instrument.linear_count :], [rows.problem.instrument.linear_count])
    return np.asarray(-np.linalg.solve(B, A.T).T)


def with_left_out(estimate: Estimate, problem: Problem, moves: Array, sizes: Array) -> Estimate:
    """An estimate with the groups it leaves out, which are nothing within their sizes, and their part in its
    covariance.

    Parameters
    ----------
    estimate
        Of the m parameters of the linear model.
    problem
        The likelihood with the groups.
    moves : (m, k)
        By how much one of each parameter of the groups moves those of the linear model.
    sizes : (k,)
        Standard deviations of the parameters of the groups, SI.
    """
    instrument, first, moved = problem.instrument, problem.instrument.linear_count, moves * sizes
    k, crossed, usual = len(sizes), -moved * sizes, problem.usual_u[1 + first :]
    linear = estimate.covariance + moved @ moved.T
    covariance = np.block([[linear, crossed], [crossed.T, np.diag(sizes**2)]])
    values = np.append(estimate.values, np.zeros(k))
    degrees = estimate.degrees
    if degrees is not None:
        degrees = np.append(degrees * (np.diag(linear) / np.diag(estimate.covariance)) ** 2, np.full(k, np.inf))
    groups = (
        GroupFinding(
            name=name,
            kept=True,
            prior=float(usual[members.start - first]),
            prior_widened=float((sizes / usual)[members.start - first]),
            learned=(0.0,) * (members.stop - members.start),
        )
        for name, members in ((group.name, instrument.members[group.name]) for group in instrument.further)
    )
    budget = estimate.budget
    if budget is not None:
        wide = np.vstack([np.eye(first), np.zeros((k, first))])
        budget = budget.carried(wide)
        for name, members in instrument.members.items():
            own = slice(members.start - first, members.stop - first)
            by = np.vstack([-moved, np.diag(sizes)])[:, own]
            size, unit = float(sizes[own.start]), instrument.units[members.start]
            budget = budget.with_source(source(f"prior.{name}", size, unit), by @ by.T)
    rate = None if estimate.prediction is None else estimate.prediction.at_rate
    return replace(
        estimate,
        budget=budget,
        names=instrument.names,
        units=instrument.units,
        values=values,
        covariance=covariance,
        observable=np.append(estimate.observable, np.ones(k, dtype=bool)),
        null=np.pad(estimate.null, ((0, 0), (0, k))),
        increments=tuple(np.append(step, np.zeros(k)) for step in estimate.increments),
        instrument=instrument,
        groups=tuple(groups),
        degrees=degrees,
        prediction=prediction(instrument, values, covariance, gravity=problem.observations.site.gravity, rate=rate),
    )


def linear_part(estimate: Estimate) -> Estimate:
    """The bias, scale factor and axis angles of an estimate that takes other groups as nothing, whose part stays in
    their covariance."""
    instrument = estimate.instrument
    if instrument is None:
        return estimate
    m = instrument.linear_count
    return replace(
        estimate,
        names=estimate.names[:m],
        units=estimate.units[:m],
        values=estimate.values[:m],
        covariance=estimate.covariance[:m, :m],
        observable=estimate.observable[:m],
        null=estimate.null[:, :m],
        increments=tuple(step[:m] for step in estimate.increments),
        instrument=replace(instrument, further=()),
        groups=(),
        degrees=None if estimate.degrees is None else estimate.degrees[:m],
        budget=None if estimate.budget is None else estimate.budget.carried(np.eye(m, len(estimate.names))),
    )


def taken_as_nothing(estimate: Estimate) -> tuple[str, ...]:
    """That groups are nothing in an estimate of the linear model and in its u by their size, as a note."""
    if not estimate.groups:
        return ()
    method = f"method {estimate.method}" + (" with linear terms" if estimate.method == "joint" else "")
    return (
        f"the {method} takes what is not bias, scale or axis angle as nothing and has its usual size in u; the method "
        "joint with all terms finds what the session shows of it",
    )
