"""Staged method: accelerometers by the scalar method on all rests, then gyros from rests and turns.

Stage 1, Eqs. (12), (13) in norm form and with covariance. At rest y = S g u + b with the vertical u unknown, so a
rest of n accelerometers says n − 2 things: the residual y − b − S g u with the two directions in which u may
turn projected out. For a triad that is |S⁻¹(y − b)| = g. Iterated to convergence, so that the coefficients are
those of the estimated orientation and the second-order errors of (15) do not remain.

Stage 2, with û = S⁻¹(y − b)/g from stage 1:
    rests   ω̂ = û Ω sin B + (horizontal part of the Earth's rate, azimuth unknown: zero ± Ω cos B/√2 an axis)
    turns   C û_j = exp([ω_i T ×]) û_i, the vertical after a turn carried back by the gyros, two equations each,
            with the Jacobian from the logged rate, §6.6
The first is the dot-product invariant û·ω̂ = Ω sin B where the noise is small against Ω, and the mean of the rests
where it is large; the second is the indirect method for turns of any kind. ω_i, the Earth's rate in the body, is
the measured one, shrunk towards the vertical part in proportion to its noise. Turns are integrated again about
the updated parameters until the second-order effect of an update is below 1e-7 rad. More than three gyros also say
n − 3 things of themselves at every rest and in every turn: their readings must be those of one rate.

Uncertainty: noise of rests (accelerometers and gyros) and of turns, their scatter, what stage 1 leaves, and the
uncertainty of g, all propagated; rests shared by two turns make their rows correlated, and the whole covariance
is used as the weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.earth import EARTH_RATE
from tumble.estimate import (
    SCATTER_PROBABILITY,
    Estimate,
    Fit,
    Solution,
    chance_of,
    least_squares,
    scatter_of,
    sigmas,
    spreads,
)
from tumble.model import SensorModel
from tumble.observe import Observations, Turns
from tumble.rotation import rotation_matrix, skew, tangent_basis
from tumble.units import Array

MAX_ITERATIONS = 30
CONVERGED = 1e-3  # of the standard uncertainty
SECOND_ORDER = 1e-7  # rad


@dataclass(frozen=True, kw_only=True, slots=True)
class _Accelerometers:
    """Stage 1: values and their solution, the verticals found, and what the residuals say."""

    values: Array
    model: SensorModel
    solution: Solution
    null: Array
    """(q, m): combinations the data do not determine, each as long as its spread."""
    gain: Array
    """(m, N, n): change of the values with the mean reading of each rest."""
    by_gravity: Array
    """(m,): change of the values with g, per m/s²."""
    vertical: Array
    covariance: Array
    fit: Fit
    sigmas: Array
    increments: tuple[Array, ...]


def staged(observations: Observations) -> Estimate:
    """All parameters of a session by stages, with covariance and outcome."""
    accel = _accelerometers(observations)
    residual = np.linalg.norm(accel.model.apply(observations.rests.accel), axis=1) - observations.site.gravity
    if observations.gyro_block is None:
        return _estimate(observations, accel, residual, None)
    return _estimate(observations, accel, residual, _gyros(observations, accel))


# Stage 1: accelerometers


def _accelerometers(observations: Observations) -> _Accelerometers:
    values = observations.start_values(observations.accel_block)
    scatter = 0.0
    values, system, increments = _accelerometers_at(observations, values, scatter)
    degrees = system.residual.size - (len(values) - len(system.solution().null))
    if degrees > 0 and chance_of(_chi_square(system), degrees) < SCATTER_PROBABILITY:
        start = float(np.sqrt(np.median(np.trace(observations.rests.accel_covariance, axis1=1, axis2=2))))
        for _ in range(3):
            linearised = values

            def excess(trial: float, at: Array = linearised) -> float:
                return _chi_square(_rest_rows(observations, at, trial)) - degrees

            scatter = scatter_of(excess, start)
            values, system, more = _accelerometers_at(observations, values, scatter)
            increments += more
    return _finished(observations, values, system, scatter, float(degrees), increments)


@dataclass(frozen=True, kw_only=True, slots=True)
class _RestRows:
    """Whitened residuals (N, n − 2) and their derivatives with respect to the parameters (N, n − 2, m), to minus
    the readings (N, n − 2, n) and to g (N, n − 2)."""

    values: Array
    residual: Array
    jacobian: Array
    reading: Array
    gravity: Array
    spread: Array

    def solution(self) -> Solution:
        m = self.jacobian.shape[-1]
        return least_squares(self.jacobian.reshape(-1, m), self.residual.ravel(), self.spread)


def _rest_rows(observations: Observations, values: Array, scatter: float) -> _RestRows:
    block, g = observations.accel_block, observations.site.gravity
    model, derivative = block.model(values), block.jacobian(values)
    readings = observations.rests.accel
    force = model.apply(readings)
    vertical = force / np.linalg.norm(force, axis=1, keepdims=True)
    covariance = observations.rests.accel_covariance + scatter**2 * np.eye(block.size)
    lower = np.linalg.cholesky(covariance)
    turning = np.einsum("pk,ijk->ipj", model.matrix, tangent_basis(vertical)) * g
    basis, _ = np.linalg.qr(np.linalg.solve(lower, turning), mode="complete")
    free = np.swapaxes(basis[:, :, 2:], 1, 2)  # the n − 2 directions that no turn of the vertical reaches
    whiten = np.swapaxes(np.linalg.solve(np.swapaxes(lower, 1, 2), np.swapaxes(free, 1, 2)), 1, 2)
    homogeneous = np.concatenate([g * vertical, np.ones((len(vertical), 1))], axis=1)
    return _RestRows(
        values=values,
        residual=np.einsum("irp,ip->ir", whiten, readings - model.predict(g * vertical)),
        jacobian=np.einsum("irp,pqm,iq->irm", whiten, derivative, homogeneous),
        reading=whiten,
        gravity=np.einsum("irp,pk,ik->ir", whiten, model.matrix, vertical),
        spread=spreads(block),
    )


def _accelerometers_at(
    observations: Observations, values: Array, scatter: float
) -> tuple[Array, _RestRows, tuple[Array, ...]]:
    """Gauss–Newton at a given scatter."""
    increments: list[Array] = []
    for _ in range(MAX_ITERATIONS):
        solution = _rest_rows(observations, values, scatter).solution()
        step = _bounded(solution.step, spreads(observations.accel_block))
        values = values + step
        increments.append(step)
        if _negligible(solution):
            break
    return values, _rest_rows(observations, values, scatter), tuple(increments)


def _bounded(step: Array, spread: Array) -> Array:
    """The step, shortened so that no parameter moves by more than its spread: far from any solution the
    linearisation says nothing."""
    return np.asarray(step / max(1.0, float(np.max(np.abs(step) / spread))))


def _negligible(solution: Solution) -> bool:
    u = np.sqrt(np.diag(solution.covariance))
    return bool(np.all(np.abs(solution.step) <= CONVERGED * u + 1e-15))


def _chi_square(rows: _RestRows) -> float:
    m = rows.jacobian.shape[-1]
    after = rows.residual.ravel() - rows.jacobian.reshape(-1, m) @ rows.solution().step
    return float(after @ after)


def _finished(
    observations: Observations,
    values: Array,
    rows: _RestRows,
    scatter: float,
    degrees: float,
    increments: tuple[Array, ...],
) -> _Accelerometers:
    block, site = observations.accel_block, observations.site
    solution = rows.solution()
    m = len(values)
    by_rest = solution.gain.reshape(m, *rows.residual.shape)
    by_gravity = -np.einsum("mir,ir->m", by_rest, rows.gravity)
    model = block.model(values)
    force = model.apply(observations.rests.accel)
    left = np.eye(rows.residual.size) - rows.jacobian.reshape(-1, m) @ solution.gain
    expected = np.maximum(np.diag(left @ left.T), 1e-12)
    normalised = (rows.residual.ravel() / np.sqrt(expected)).reshape(rows.residual.shape)
    normalised[(expected < 1e-6).reshape(normalised.shape)] = 0.0  # a residual the fit has no freedom to show
    worst = np.sqrt((normalised**2).mean(axis=1))
    return _Accelerometers(
        values=values,
        model=model,
        solution=solution,
        null=solution.null * rows.spread,
        gain=np.einsum("mir,irp->mip", by_rest, rows.reading),
        by_gravity=by_gravity,
        vertical=force / np.linalg.norm(force, axis=1, keepdims=True),
        covariance=solution.covariance + site.gravity_u**2 * np.outer(by_gravity, by_gravity),
        fit=Fit(chi_square=_chi_square(rows), degrees=degrees, scatter=scatter, scatter_unit="m/s^2"),
        sigmas=sigmas(worst, degrees, scatter > 0.0),
        increments=increments,
    )


# Stage 2: gyros


@dataclass(frozen=True, kw_only=True, slots=True)
class _Gyros:
    values: Array
    model: SensorModel
    solution: Solution
    covariance: Array
    by_accel: Array
    """(m_gyro, m_accel): covariance of the gyro values with the accelerometer values."""
    fits: dict[str, Fit]
    rest_sigmas: Array
    turn_sigmas: Array
    increments: tuple[Array, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class _Scatter:
    """Scatter between rests (rad/s) and of turns (rad) on top of the noise within rests."""

    rest: float = 0.0
    turn: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class _Rows:
    """Residuals (r,) of rests (three each: along the vertical, then two horizontal) and turns (two each), their
    derivatives (r, m), their covariance (r, r) without scatter, what a unit variance of scatter adds to it, and
    the part shared with the accelerometer values (r, m_a)."""

    residual: Array
    jacobian: Array
    noise: Array
    by_rest_scatter: Array
    by_turn_scatter: Array
    with_accel: Array

    def covariance(self, scatter: _Scatter) -> Array:
        """Covariance (r, r) at a scatter."""
        return self.noise + scatter.rest**2 * self.by_rest_scatter + scatter.turn**2 * self.by_turn_scatter


def _gyros(observations: Observations, accel: _Accelerometers) -> _Gyros:
    block = observations.gyro_block
    assert block is not None
    values, scatter = observations.start_values(block), _Scatter()
    values[: block.size] = np.median(observations.rests.gyro, axis=0)
    start = values
    values, turns, increments = _gyros_at(observations, accel, values, scatter)
    for _ in range(2):
        scatter = _found_scatter(observations, accel, turns, values, scatter)
        values, turns, more = _gyros_at(observations, accel, values, scatter)
        increments += more
    rows = _gyro_rows(observations, accel, turns, values, scatter)
    covariance = rows.covariance(scatter)
    solution, residual, after = _solved(rows, covariance, spreads(block))
    left = _Left(residual=residual, covariance=covariance, after=after)
    return _Gyros(
        values=values,
        model=block.model(values),
        solution=solution,
        covariance=solution.covariance,
        by_accel=solution.gain @ np.linalg.solve(np.linalg.cholesky(covariance), rows.with_accel),
        fits=_fits(observations, left, scatter),
        rest_sigmas=_group_sigmas(observations, left, "rests", scatter.rest > 0),
        turn_sigmas=_group_sigmas(observations, left, "turns", scatter.turn > 0),
        increments=(start, *increments),
    )


def _gyros_at(
    observations: Observations, accel: _Accelerometers, values: Array, scatter: _Scatter
) -> tuple[Array, Turns, tuple[Array, ...]]:
    """Gauss–Newton at a given scatter; the turns are integrated again about every new estimate."""
    block = observations.gyro_block
    assert block is not None
    spread = spreads(block)
    increments: list[Array] = []
    turns = observations.turns_about(block.model(values))
    for _ in range(MAX_ITERATIONS):
        rows = _gyro_rows(observations, accel, turns, values, scatter)
        solution, _, _ = _solved(rows, rows.covariance(scatter), spread)
        step = _bounded(solution.step, spread)
        values = values + step
        increments.append(step)
        turns = observations.turns_about(block.model(values))
        if _negligible(solution):
            break
    return values, turns, tuple(increments)


def _solved(rows: _Rows, covariance: Array, spread: Array) -> tuple[Solution, Array, Array]:
    """The step, the residuals left after it (r,) and their covariance (r, r)."""
    lower = np.linalg.cholesky(covariance)
    whitened = np.asarray(np.linalg.solve(lower, np.column_stack([rows.jacobian, rows.residual])), dtype=float)
    jacobian = whitened[:, :-1]
    solution = least_squares(jacobian, whitened[:, -1], spread)
    left = lower @ (np.eye(len(lower)) - jacobian @ solution.gain)
    return solution, rows.residual - rows.jacobian @ solution.step, left @ left.T


def _gyro_rows(
    observations: Observations, accel: _Accelerometers, turns: Turns, values: Array, scatter: _Scatter
) -> _Rows:
    """Residuals with their first-order dependence on everything uncertain; `turns` integrated about `values`."""
    state = _State.of(observations, accel, values, scatter)
    rests = len(observations.rests)
    spare = state.model.matrix.shape[0] - 3 if observations.turn_readings else 0
    size = 3 * rests + 2 * len(turns) + spare * (rests + len(turns))
    design = _Design(
        residual=np.zeros(size),
        jacobian=np.zeros((size, len(values))),
        by_vertical=np.zeros((size, rests, 3)),
        by_rate=np.zeros((size, rests, 3)),
        by_unseen=np.zeros((size, rests, 3)),
        turning=np.zeros((size, size)),
        by_rest_scatter=np.zeros((size, size)),
        by_turn_scatter=np.zeros((size, size)),
    )
    for i in range(rests):
        _add_rest(design, state, i)
    for j in range(len(turns)):
        _add_turn(design, state, turns, j, slice(3 * rests + 2 * j, 3 * rests + 2 * j + 2))
    if spare:
        _add_spare(design, state, observations, values)
    return _with_covariance(state, design)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Design:
    """The rows while they are put together: residual (r,), derivatives with respect to the values (r, m), to the
    vertical, the measured rate and the unseen Earth's rate of every rest (r, N, 3), the covariance (r, r) from
    the noise of the turns, and what a unit variance of scatter adds to the rows of the turns."""

    residual: Array
    jacobian: Array
    by_vertical: Array
    by_rate: Array
    by_unseen: Array
    turning: Array
    by_rest_scatter: Array
    by_turn_scatter: Array


@dataclass(frozen=True, kw_only=True, slots=True)
class _State:
    """What the rows need: the gyro model, the rates ω (N, 3) it gives at rest with their covariance, the verticals
    and how they depend on noise and on the accelerometer values, and the Earth's rate as far as it is known."""

    accel: _Accelerometers
    model: SensorModel
    derivative: Array
    """(3, 4, m): of the effective triad, in body rate: −dω = derivative · (ω, 1)."""
    rate: Array
    rate_covariance: Array
    vertical: Array
    vertical_by_noise: Array
    vertical_by_values: Array
    accel_covariance: Array
    basis: Array
    """(N, 3, 3): rows û and two horizontal unit vectors."""
    up_rate: float
    unseen: Array
    """(N, 3, 3): covariance of the part of the Earth's rate that is not known in the body."""
    known: Array
    """(N,): how far the measured horizontal rate is to be believed, 0 … 1."""
    gravity_u: float

    @staticmethod
    def of(observations: Observations, accel: _Accelerometers, values: Array, scatter: _Scatter) -> _State:
        block, rests, site = observations.gyro_block, observations.rests, observations.site
        assert block is not None
        model = block.model(values)
        to_body = np.linalg.pinv(block.axes)
        inverse = np.asarray(np.linalg.inv(to_body @ model.matrix), dtype=float) @ to_body
        rate = (rests.gyro - model.bias) @ inverse.T
        rate_covariance = inverse @ rests.gyro_covariance @ inverse.T
        u = accel.vertical
        horizontal = np.eye(3) - u[:, :, None] * u[:, None, :]
        if site.latitude is None:
            up_rate, variance = 0.0, EARTH_RATE**2 / 3.0
            unseen = np.broadcast_to(variance * np.eye(3), (len(u), 3, 3))
        else:
            up_rate, variance = EARTH_RATE * np.sin(site.latitude), 0.5 * (EARTH_RATE * np.cos(site.latitude)) ** 2
            unseen = variance * horizontal
        noise = 0.5 * np.einsum("iab,ibc,ica->i", horizontal, rate_covariance, horizontal) + scatter.rest**2
        force = accel.model.apply(rests.accel)
        by_force = horizontal / np.linalg.norm(force, axis=1)[:, None, None]
        pinv = accel.model.inverse()
        homogeneous = np.concatenate([force, np.ones((len(force), 1))], axis=1)
        by_value = np.einsum("pqm,iq->ipm", observations.accel_block.jacobian(accel.values), homogeneous)
        return _State(
            accel=accel,
            model=model,
            derivative=np.einsum("ap,pqm->aqm", inverse, block.jacobian(values)),
            rate=rate,
            rate_covariance=rate_covariance,
            vertical=u,
            vertical_by_noise=by_force @ pinv,
            vertical_by_values=-by_force @ pinv @ by_value,
            accel_covariance=rests.accel_covariance + accel.fit.scatter**2 * np.eye(rests.accel.shape[1]),
            basis=np.concatenate([u[:, None, :], tangent_basis(u)], axis=1),
            up_rate=float(up_rate),
            unseen=unseen,
            known=variance / (variance + noise),
            gravity_u=site.gravity_u,
        )


def _add_rest(design: _Design, state: _State, i: int) -> None:
    """Ω sin B û − ω in the basis of the vertical; its first row is the dot-product invariant Ω sin B − û·ω."""
    rows, basis, u, rate = slice(3 * i, 3 * i + 3), state.basis[i], state.vertical[i], state.rate[i]
    design.residual[rows] = -basis @ (state.up_rate * u - rate)
    design.jacobian[rows] = basis @ _by_values(state, rate)
    design.by_vertical[rows, i] = state.up_rate * basis
    design.by_vertical[3 * i, i] = u * (u @ rate) - rate
    design.by_rate[rows, i] = -basis
    design.by_unseen[rows, i] = -basis


def _by_values(state: _State, rate: Array) -> Array:
    """−dω/dθ (3, m) of a rate."""
    return np.asarray(np.einsum("aqm,q->am", state.derivative, np.append(rate, 1.0)))


def _add_turn(design: _Design, state: _State, turns: Turns, j: int, rows: slice) -> None:
    """C û_last − exp([ω T×]) û_first, across the vertical."""
    a, b, T, C = int(turns.first[j]), int(turns.last[j]), float(turns.duration[j]), turns.C[j]
    u, known = state.vertical[a], float(state.known[a])
    horizontal = np.eye(3) - np.outer(u, u)
    earth = T * (state.up_rate * u + known * horizontal @ state.rate[a])
    carried = rotation_matrix(earth)
    back = C @ state.vertical[b]
    across = tangent_basis(back)
    by_angle = across @ skew(back)
    by_matrix = np.einsum("ipq,pqm->im", turns.M[j], state.derivative[:, :3]) + turns.B[j] @ state.derivative[:, 3]
    by_earth = T * across @ carried @ skew(u) @ (np.eye(3) - 0.5 * skew(earth)) @ horizontal
    design.residual[rows] = -across @ (back - carried @ u)
    design.jacobian[rows] = by_angle @ by_matrix - known * by_earth @ _by_values(state, state.rate[a])
    design.by_vertical[rows, b] += across @ C
    design.by_vertical[rows, a] -= across @ carried
    design.by_rate[rows, a] += known * by_earth
    design.by_unseen[rows, a] += (known - 1.0) * by_earth
    design.turning[rows, rows] = by_angle @ turns.covariance[j] @ by_angle.T
    design.by_turn_scatter[rows, rows] = by_angle @ by_angle.T
    design.by_rest_scatter[rows, rows] = T**2 * by_angle @ by_angle.T


def _add_spare(design: _Design, state: _State, observations: Observations, values: Array) -> None:
    """What n gyros say of themselves: y − b, at rest or integrated over a turn, has nothing in the directions that
    no rate explains."""
    block, rests, turns = observations.gyro_block, observations.rests, observations.turns
    readings = observations.turn_readings
    assert block is not None
    assert turns is not None
    assert readings is not None
    basis, _ = np.linalg.qr(state.model.matrix, mode="complete")
    free, inverse, derivative = basis[:, 3:].T, state.model.inverse(), block.jacobian(values)
    seconds = np.concatenate([np.ones(len(rests)), turns.duration])
    readings_of_all = np.concatenate([rests.gyro, readings.integral]) - np.outer(seconds, state.model.bias)
    covariances = np.concatenate([rests.gyro_covariance, readings.covariance])
    first, size = 3 * len(rests) + 2 * len(turns), len(free)
    for i, (y, covariance) in enumerate(zip(readings_of_all, covariances, strict=True)):
        rows = slice(first + size * i, first + size * (i + 1))
        design.residual[rows] = free @ y
        design.jacobian[rows] = free @ np.einsum("pqm,q->pm", derivative, np.append(inverse @ y, seconds[i]))
        design.turning[rows, rows] = free @ covariance @ free.T
        scatter = design.by_rest_scatter if i < len(rests) else design.by_turn_scatter
        scatter[rows, rows] = np.eye(size)


def _with_covariance(state: _State, design: _Design) -> _Rows:
    """The covariance of the rows from all that is uncertain, and what of it the accelerometer values share."""
    accel = state.accel
    by_values = np.einsum("rik,ikm->rm", design.by_vertical, state.vertical_by_values)
    by_noise = np.einsum("rik,ikp->rip", design.by_vertical, state.vertical_by_noise)
    by_noise += np.einsum("rm,mip->rip", by_values, accel.gain)
    common = np.vstack([accel.null, accel.by_gravity * state.gravity_u])  # unseen combinations, and g
    by_common = by_values @ common.T
    covariance = design.turning + by_common @ by_common.T
    for by, of in (
        (by_noise, state.accel_covariance),
        (design.by_rate, state.rate_covariance),
        (design.by_unseen, state.unseen),
    ):
        covariance += np.einsum("rip,ipq,siq->rs", by, of, by, optimize=True)
    shared = np.einsum("rip,ipq,miq->rm", by_noise, state.accel_covariance, accel.gain, optimize=True)
    return _Rows(
        residual=design.residual,
        jacobian=design.jacobian,
        noise=covariance,
        by_rest_scatter=design.by_rest_scatter + np.einsum("rip,sip->rs", design.by_rate, design.by_rate),
        by_turn_scatter=design.by_turn_scatter,
        with_accel=-(shared + by_common @ common),
    )


# How well it fits


def _groups(observations: Observations) -> dict[str, tuple[slice, int]]:
    """Rows of the rests and of the turns, and how many belong to one of them."""
    n, k = 3 * len(observations.rests), 0 if observations.turns is None else len(observations.turns)
    return {"rests": (slice(0, n), 3), "turns": (slice(n, n + 2 * k), 2)}


@dataclass(frozen=True, kw_only=True, slots=True)
class _Left:
    """Residuals (r,) after the fit, the covariance (r, r) of the rows, and that of what is left of them."""

    residual: Array
    covariance: Array
    after: Array


def _agreement(left: _Left, group: slice) -> tuple[float, float]:
    """Sum of the squared residuals of a group of rows in units of their variances, scaled so that it has the mean
    of a chi-square with the degrees of freedom that are also returned (matched in mean and variance)."""
    scale = np.sqrt(np.diag(left.covariance)[group])
    share = left.after[group, group] / np.outer(scale, scale)
    trace, squares = float(np.trace(share)), float((share**2).sum())
    if trace < 1e-6 or squares == 0.0:
        return 0.0, 0.0
    return float(np.sum((left.residual[group] / scale) ** 2)) * trace / squares, trace**2 / squares


def _found_scatter(
    observations: Observations, accel: _Accelerometers, turns: Turns, values: Array, scatter: _Scatter
) -> _Scatter:
    """The scatter that explains the residuals of the rests, then that of the turns, where they need one."""
    assert observations.gyro_block is not None
    spread = spreads(observations.gyro_block)
    groups = _groups(observations)
    rows = _gyro_rows(observations, accel, turns, values, scatter)

    def agreement(trial: _Scatter, group: slice) -> tuple[float, float]:
        covariance = rows.covariance(trial)
        _, residual, after = _solved(rows, covariance, spread)
        return _agreement(_Left(residual=residual, covariance=covariance, after=after), group)

    def needed(name: str, trial: _Scatter) -> bool:
        statistic, degrees = agreement(trial, groups[name][0])
        return degrees > 0.5 and chance_of(statistic, degrees) < SCATTER_PROBABILITY

    def excess(name: str, trial: _Scatter) -> float:
        statistic, degrees = agreement(trial, groups[name][0])
        return statistic - degrees

    rest, turn = scatter.rest, scatter.turn
    noise = float(np.sqrt(np.trace(observations.rests.gyro_covariance, axis1=1, axis2=2).mean()))
    if rest > 0.0 or needed("rests", _Scatter(rest=0.0, turn=turn)):
        rest = scatter_of(lambda s: excess("rests", _Scatter(rest=s, turn=turn)), noise)
    if turn > 0.0 or needed("turns", _Scatter(rest=rest, turn=0.0)):
        angle = float(np.sqrt(np.trace(turns.covariance, axis1=1, axis2=2).mean()))
        turn = scatter_of(lambda s: excess("turns", _Scatter(rest=rest, turn=s)), angle)
    return _Scatter(rest=rest, turn=turn)


def _fits(observations: Observations, left: _Left, scatter: _Scatter) -> dict[str, Fit]:
    out = {}
    for name, (group, _) in _groups(observations).items():
        statistic, degrees = _agreement(left, group)
        value, unit = (scatter.rest, "rad/s") if name == "rests" else (scatter.turn, "rad")
        out[f"gyro {name}"] = Fit(chi_square=statistic, degrees=degrees, scatter=value, scatter_unit=unit)
    return out


def _group_sigmas(observations: Observations, left: _Left, name: str, scaled: bool) -> Array:
    """How far each rest or turn is from the fit, in sigmas."""
    group, size = _groups(observations)[name]
    scale = np.diag(left.covariance)[group].reshape(-1, size)
    expected = np.diag(left.after)[group].reshape(-1, size) / scale
    squares = left.residual[group].reshape(-1, size) ** 2 / scale
    free = expected.sum(axis=1)
    z = np.sqrt(squares.sum(axis=1) / np.where(free > 1e-3, free, np.inf))
    return sigmas(z, _agreement(left, group)[1], scaled)


# Both together


def _estimate(observations: Observations, accel: _Accelerometers, residual: Array, gyro: _Gyros | None) -> Estimate:
    block, gyro_block = observations.accel_block, observations.gyro_block
    m = len(accel.values)
    values, covariance = accel.values, accel.covariance
    names, units, observable, null = block.names, block.units, accel.solution.observable, accel.solution.null
    converged = _negligible(accel.solution)
    increments = accel.increments
    fits = {"accelerometers": accel.fit}
    rest_sigmas, turn_sigmas = accel.sigmas, np.empty(0)
    if gyro is not None and gyro_block is not None:
        values = np.concatenate([values, gyro.values])
        covariance = np.block([[covariance, gyro.by_accel.T], [gyro.by_accel, gyro.covariance]])
        names, units = names + gyro_block.names, units + gyro_block.units
        observable = np.concatenate([observable, gyro.solution.observable])
        null = np.vstack([np.pad(null, ((0, 0), (0, len(gyro.values)))), np.pad(gyro.solution.null, ((0, 0), (m, 0)))])
        converged = converged and _negligible(gyro.solution)
        increments = tuple(np.append(step, np.zeros(len(gyro.values))) for step in increments) + tuple(
            np.append(np.zeros(m), step) for step in gyro.increments
        )
        fits |= gyro.fits
        rest_sigmas = np.maximum(rest_sigmas, gyro.rest_sigmas)
        turn_sigmas = gyro.turn_sigmas
    return Estimate(
        method="staged",
        names=names,
        units=units,
        values=values,
        covariance=covariance,
        observable=observable,
        null=null,
        accel=accel.model,
        gyro=None if gyro is None else gyro.model,
        rest_residual=residual,
        rest_sigmas=rest_sigmas,
        turn_sigmas=turn_sigmas,
        increments=increments,
        fits=fits,
        converged=converged,
    )
