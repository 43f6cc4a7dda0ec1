"""The staged method, an oracle of the joint one: accelerometers by the scalar method on all rests, then the gyros.

Stage 1 is Eqs. (12), (13) in norm form and with covariance, for any number of sensors: the geometric fit of the sphere
of radius g (`sphere_rows`). Iterated to convergence, so that the coefficients are those of
the estimated orientation and the second-order errors of (15) do not remain.

Stage 2, with û = S⁻¹(y − b)/g from stage 1:

    rests   ω̂ = û Ω sin B + (horizontal part of the Earth's rate, azimuth unknown: zero ± Ω cos B/√2 an axis)
    turns   C û_j = exp([ω_i T ×]) û_i, the vertical after a turn carried back by the gyros, two equations each,
            with the Jacobian from the logged rate, §6.6

The first is the dot-product invariant û·ω̂ = Ω sin B where the noise is small against Ω, and the mean of the rests
where it is large; the second is the indirect method for turns of any kind. ω_i, the Earth's rate in the body, is
the measured one, shrunk towards the vertical part in proportion to its noise. More than three gyros also say n − 3
things of themselves at every rest and in every turn: their readings must be those of one rate.

The weight of stage 2 is the covariance of the noise of rests (accelerometers and gyros) and of turns, their scatter,
what stage 1 leaves, and the uncertainty of g, all propagated; rests shared by two turns make their rows correlated.
Turns are integrated again about the parameters after every step. The covariance of the estimate has what both stages
have in common. Scatter between rests and of turns is estimated where the residuals need it.

Let residuals r have the covariance V before a fit and W after it. Then Σ r_i²/V_ii has the mean t = tr w and the
variance 2 tr w², w_ij = W_ij/√(V_ii V_jj). Multiplied by t/tr w², it has those of a χ² of t²/tr w² degrees of freedom
(Satterthwaite 1946).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tumble.earth import EARTH_RATE
from tumble.inference.estimate import UNOBSERVABLE_SHARE, Estimate, Fit
from tumble.methods.least_squares import (
    MAX_ITERATIONS,
    SCATTER_ROUNDS,
    Solution,
    fit_scatter,
    gaussian_sigmas,
    least_squares,
    needs_scatter,
    normal_score,
)
from tumble.recording.session_file import read_session
from tumble.reduction.observations import Observations
from tumble.reduction.turns.turns import Turns
from tumble.rotation import onto_body, rotation_matrix, skew, tangent_basis, unit_vector
from tumble.run.observed import inspect_session
from tumble.sensors.model import Block, SensorModel, left_null_space, tilt_null_space
from tumble.sensors.parameters import limits_of, units_of
from tumble.units import Array, BoolArray

LEAST_SHARE = 1e-3
"""Residuals that retain no more than this part of their variance after the fit show nothing."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Residuals:
    """Residuals (r,) after a fit, their `variance` (r,) before it, and their covariance (r, r) after it, `left`."""

    residual: Array
    variance: Array
    left: Array

    def chi_square(self) -> tuple[float, float]:
        """χ² and its degrees of freedom, matched in mean and variance; zeros if nothing is left."""
        scale = np.sqrt(self.variance)
        share = self.left / np.outer(scale, scale)
        trace, squares = float(np.trace(share)), float((share**2).sum())
        if trace < 1e-6:
            return 0.0, 0.0
        return float(((self.residual / scale) ** 2).sum()) * trace / squares, trace**2 / squares

    def excess(self) -> float:
        """χ² less its expectation."""
        statistic, degrees = self.chi_square()
        return statistic - degrees

    def fit(self, scatter: float, unit: str) -> Fit:
        """χ² as a calibration keeps it."""
        statistic, degrees = self.chi_square()
        return Fit(chi_square=statistic, degrees=degrees, scatter=scatter, unit=unit)

    def sigmas(self, size: int, *, scaled: bool) -> Array:
        """Deviations of residuals, `size` at a time, in sigmas. If `scaled`, their scatter comes from themselves, and
        each is judged by the scatter of all others, given what it shares with them: by Student's t."""
        squares = (self.residual**2 / self.variance).reshape(-1, size).sum(axis=1)
        free = (np.diag(self.left) / self.variance).reshape(-1, size).sum(axis=1)
        z: Array = np.sqrt(squares / np.where(free > LEAST_SHARE, free, np.inf))
        if not scaled:
            return z
        for i in np.flatnonzero(free > LEAST_SHARE).tolist():
            own = np.arange(i * size, (i + 1) * size)
            others = np.setdiff1d(np.arange(len(self.residual)), own)
            by_own = self.left[np.ix_(others, own)] @ np.linalg.pinv(self.left[np.ix_(own, own)])
            rest = Residuals(
                residual=self.residual[others] - by_own @ self.residual[own],
                variance=self.variance[others],
                left=self.left[np.ix_(others, others)] - by_own @ self.left[np.ix_(own, others)],
            )
            statistic, degrees = rest.chi_square()
            if degrees >= 1.0:
                z[i] = normal_score(z[i] * np.sqrt(degrees / max(statistic, 1e-300)), degrees)
        return z


def staged_estimate(folder: Path) -> Estimate:
    """The staged estimate of a session on disk."""
    observations = inspect_session(read_session(folder)).observations
    assert observations is not None
    return staged(observations)


def staged(observations: Observations) -> Estimate:
    """All parameters of a session by stages, with covariance and outcome."""
    block, gyro_block = observations.accel_block, observations.gyro_block
    accel = estimate_accelerometers(observations)
    estimate = Estimate(
        method="staged",
        names=block.names,
        units=units_of(block.names),
        values=accel.values,
        covariance=accel.covariance,
        observable=np.sqrt((accel.solution.null**2).sum(axis=0)) < UNOBSERVABLE_SHARE,
        null=accel.solution.null,
        accel=accel.model,
        gyro=None,
        rest_residual=np.linalg.norm(accel.model.apply(observations.rests.accel), axis=1) - observations.site.gravity,
        rest_sigmas=accel.sigmas,
        turn_sigmas=np.empty(0),
        increments=accel.increments,
        fits={"accelerometers": accel.fit},
        converged=accel.solution.is_negligible(1e-15),
    )
    return estimate if gyro_block is None else _with_gyros(estimate, accel, observations, gyro_block)


# ---- least squares with a scatter, and readings of a vector of known length


def gauss_newton(
    solution_at: Callable[[Array], Solution], values: Array, spread: Array, rounding: Array | float = 1e-15
) -> tuple[Array, tuple[Array, ...]]:
    """Values (m,) after the last step, and all steps, from `values` on, until one is negligible against u;
    `solution_at` linearises about values. No parameter moves by more than its spread (m,) in a step: far from any
    solution the linearisation says nothing."""
    steps: list[Array] = []
    for _ in range(MAX_ITERATIONS):
        solution = solution_at(values)
        steps.append(np.asarray(solution.step / max(1.0, float(np.max(np.abs(solution.step) / spread)))))
        values = values + steps[-1]
        if solution.is_negligible(rounding):
            break
    return values, tuple(steps)


def with_scatter(
    solution_at: Callable[[Array, float], Solution],
    agreement_at: Callable[[Array], tuple[Callable[[float], float], float, float]],
    values: Array,
    spread: Array,
    rounding: Array | float = 1e-15,
) -> tuple[Array, float, tuple[Array, ...]]:
    """Values (m,), the scatter that explains the residuals, zero where they need none, and all steps. `agreement_at`
    values has the chi-square of the residuals by their scatter, its degrees of freedom, and a first guess of it."""
    scatter = 0.0
    values, steps = gauss_newton(lambda at: solution_at(at, 0.0), values, spread, rounding)
    for again in range(SCATTER_ROUNDS):
        chi_square, degrees, size = agreement_at(values)
        if not again and not needs_scatter(chi_square(0.0), degrees):
            break
        scatter = fit_scatter(lambda trial, of=chi_square, expected=degrees: of(trial) - expected, size)  # type: ignore[misc]
        values, more = gauss_newton(lambda at, size=scatter: solution_at(at, size), values, spread, rounding)  # type: ignore[misc]
        steps += more
    return values, scatter, steps


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SphereRows:
    """Whitened residuals (N, n − 2) and their derivatives with respect to the parameters (N, n − 2, m), to minus
    the readings (N, n − 2, n) and to the modulus (N, n − 2)."""

    residual: Array
    jacobian: Array
    reading: Array
    modulus: Array

    def solution(self, spread: Array, used: BoolArray | slice = slice(None)) -> Solution:
        """The step of the parameters, of spreads (m,), by the readings that are used."""
        return least_squares(self.jacobian[used].reshape(-1, len(spread)), self.residual[used].ravel(), spread)


def sphere_rows(
    block: Block, readings: Array, covariance: Array, modulus: float, values: Array, scatter: float
) -> SphereRows:
    """What readings (N, n) of covariance (N, n, n) and of a scatter say of the sensors of a block that measure a vector
    of this length, linearised about values (m,)."""
    model, covariance = block.model(values), covariance + scatter**2 * np.eye(block.size)
    direction = unit_vector(model.apply(readings))
    if block.size == 3:
        normal = direction @ model.inverse()
        whiten = (normal / np.sqrt(np.einsum("ip,ipq,iq->i", normal, covariance, normal))[:, None])[:, None]
    else:
        lower = np.linalg.cholesky(covariance)
        free = tilt_null_space(np.linalg.solve(lower, model.matrix), direction)
        whiten = np.swapaxes(np.linalg.solve(np.swapaxes(lower, 1, 2), free), 1, 2)
    homogeneous = np.concatenate([modulus * direction, np.ones((len(direction), 1))], axis=1)
    return SphereRows(
        residual=np.einsum("irp,ip->ir", whiten, readings - model.predict(modulus * direction)),
        jacobian=np.einsum("irp,pqm,iq->irm", whiten, block.jacobian(values), homogeneous),
        reading=whiten,
        modulus=np.einsum("irp,pk,ik->ir", whiten, model.matrix, direction),
    )


# ---- stage 1


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Accelerometers:
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


def estimate_accelerometers(observations: Observations) -> Accelerometers:
    """The accelerometers from all rests, with scatter between rests where the residuals need it."""
    block, site, rests = observations.accel_block, observations.site, observations.rests
    spread, size = limits_of(block.names), float(np.sqrt(np.median(np.trace(rests.accel_covariance, axis1=1, axis2=2))))

    def rows_at(values: Array, scatter: float) -> SphereRows:
        return sphere_rows(block, rests.accel, rests.accel_covariance, site.gravity, values, scatter)

    def chi_square(rows: SphereRows) -> float:  # of the residuals after a step
        return float(((rows.residual - rows.jacobian @ rows.solution(spread).step) ** 2).sum())

    def degrees_of(rows: SphereRows) -> float:
        return float(rows.residual.size - (len(spread) - len(rows.solution(spread).null)))

    values, scatter, increments = with_scatter(
        lambda at, scatter: rows_at(at, scatter).solution(spread),
        lambda at: (lambda scatter: chi_square(rows_at(at, scatter)), degrees_of(rows_at(at, 0.0)), size),
        observations.start_values(block),
        spread,
    )
    rows = rows_at(values, scatter)
    solution, degrees, m = rows.solution(spread), degrees_of(rows), len(values)
    by_rest = solution.gain.reshape(m, *rows.residual.shape)
    by_gravity = -np.einsum("mir,ir->m", by_rest, rows.modulus)
    left = np.eye(rows.residual.size) - rows.jacobian.reshape(-1, m) @ solution.gain
    expected = np.maximum(np.diag(left @ left.T), 1e-12).reshape(rows.residual.shape)
    normalised = rows.residual / np.sqrt(expected)
    normalised[expected < 1e-6] = 0.0  # a residual the fit has no freedom to show
    model = block.model(values)
    return Accelerometers(
        values=values,
        model=model,
        solution=solution,
        null=solution.null * spread,
        gain=np.einsum("mir,irp->mip", by_rest, rows.reading),
        by_gravity=by_gravity,
        vertical=unit_vector(model.apply(rests.accel)),
        covariance=solution.covariance + site.gravity_u**2 * np.outer(by_gravity, by_gravity),
        fit=Fit(chi_square=chi_square(rows), degrees=degrees, scatter=scatter, unit="m/s^2"),
        sigmas=gaussian_sigmas(np.sqrt((normalised**2).mean(axis=1)), degrees, scatter > 0.0),
        increments=increments,
    )


# ---- stage 2


GROUPS = {"rests": ("rad/s", 3), "turns": ("rad", 2)}
"""Groups of rows: the unit of the scatter they judge, on top of the noise within rests, and how many rows a rest or a
turn has."""
Scatter = Mapping[str, float]
"""That of each group."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GyroRows:
    """Residuals (r,) of rests (three each: along the vertical, then two horizontal) and turns (two each), their
    derivatives (r, m), their covariance (r, r) without scatter, what a unit variance of scatter adds to it, and
    the part shared with the accelerometer values (r, m_a); `ends` of the rows of rests, and of turns."""

    residual: Array
    jacobian: Array
    noise: Array
    by_rest_scatter: Array
    by_turn_scatter: Array
    with_accel: Array
    ends: tuple[int, int]

    def covariance(self, scatter: Scatter) -> Array:
        """Covariance (r, r) at a scatter."""
        return self.noise + scatter["rests"] ** 2 * self.by_rest_scatter + scatter["turns"] ** 2 * self.by_turn_scatter

    def solved(self, scatter: Scatter, spread: Array) -> tuple[Solution, Array]:
        """The step, and the covariance (r, r) of the residuals left after it."""
        lower = np.linalg.cholesky(self.covariance(scatter))
        whitened = np.asarray(np.linalg.solve(lower, np.column_stack([self.jacobian, self.residual])), dtype=float)
        solution = least_squares(whitened[:, :-1], whitened[:, -1], spread)
        left = lower @ (np.eye(len(lower)) - whitened[:, :-1] @ solution.gain)
        return solution, left @ left.T

    def residuals(self, name: str, scatter: Scatter, spread: Array) -> Residuals:
        """What a step leaves of the rows of a group at a scatter."""
        solution, left = self.solved(scatter, spread)
        group = slice(0, self.ends[0]) if name == "rests" else slice(*self.ends)
        residual, variance = self.residual - self.jacobian @ solution.step, np.diag(self.covariance(scatter))
        return Residuals(residual=residual[group], variance=variance[group], left=left[group, group])


def _with_gyros(estimate: Estimate, accel: Accelerometers, observations: Observations, block: Block) -> Estimate:
    """Stage 2: the gyros from rests and turns, with scatter of both where the residuals need it, beside the estimate of
    the accelerometers."""
    turns, values, spread = observations.turns, observations.start_values(block), limits_of(block.names)
    values[: block.size] = np.median(observations.rests.gyro, axis=0)
    scatter, increments = dict.fromkeys(GROUPS, 0.0), [values]
    no_turns = np.zeros((0, 3, 3))
    noises = observations.rests.gyro_covariance, no_turns if turns is None else turns.covariance

    def rows_at(at: Array, scatter: Scatter) -> GyroRows:
        return gyro_rows(observations, accel, observations.turns_about(block.model(at)), at, scatter)

    def solution_at(at: Array) -> Solution:
        return rows_at(at, scatter).solved(scatter, spread)[0]

    for again in range(3):
        if again:  # the scatter that explains the residuals of the rests, then that of the turns
            rows = rows_at(values, scatter)
            for name, noise in zip(GROUPS, noises, strict=True):

                def residuals_at(trial: float, rows: GyroRows = rows, name: str = name) -> Residuals:
                    return rows.residuals(name, {**scatter, name: trial}, spread)

                size = float(np.sqrt(np.trace(noise, axis1=1, axis2=2).mean())) if len(noise) else 0.0
                if scatter[name] > 0.0 or needs_scatter(*residuals_at(0.0).chi_square()):
                    scatter[name] = fit_scatter(lambda trial, of=residuals_at: of(trial).excess(), size)  # type: ignore[misc]
        values, steps = gauss_newton(solution_at, values, spread)
        increments += steps
    rows = rows_at(values, scatter)
    solution, _ = rows.solved(scatter, spread)
    by_accel = solution.gain @ np.linalg.solve(np.linalg.cholesky(rows.covariance(scatter)), rows.with_accel)
    left = {name: rows.residuals(name, scatter, spread) for name in GROUPS}
    rests, in_turns = (left[name].sigmas(size, scaled=scatter[name] > 0.0) for name, (_, size) in GROUPS.items())
    m, n, names = len(accel.values), len(values), estimate.names + block.names
    return replace(
        estimate,
        names=names,
        units=units_of(names),
        values=np.concatenate([accel.values, values]),
        covariance=np.block([[accel.covariance, by_accel.T], [by_accel, solution.covariance]]),
        observable=np.concatenate([estimate.observable, np.sqrt((solution.null**2).sum(axis=0)) < UNOBSERVABLE_SHARE]),
        null=np.vstack([np.pad(estimate.null, ((0, 0), (0, n))), np.pad(solution.null, ((0, 0), (m, 0)))]),
        gyro=block.model(values),
        rest_sigmas=np.maximum(accel.sigmas, rests),
        turn_sigmas=in_turns,
        gyro_rest_sigmas=rests,
        increments=(
            *(np.append(step, np.zeros(n)) for step in accel.increments),
            *(np.append(np.zeros(m), step) for step in increments),
        ),
        fits={
            "accelerometers": accel.fit,
            **{f"gyro {name}": left[name].fit(scatter[name], unit) for name, (unit, _) in GROUPS.items()},
        },
        converged=estimate.converged and solution.is_negligible(1e-15),
    )


def gyro_rows(
    observations: Observations, accel: Accelerometers, turns: Turns, values: Array, scatter: Scatter
) -> GyroRows:
    """Residuals with their first-order dependence on everything uncertain; `turns` integrated about `values`."""
    block, rests, site, u = observations.gyro_block, observations.rests, observations.site, accel.vertical
    assert block is not None
    N, K, m = len(rests), len(turns), len(values)
    spare = block.size - 3 if observations.turn_readings else 0
    of_turns, size = 3 * N, 3 * N + 2 * K + spare * (N + K)
    residual, jacobian = np.zeros(size), np.zeros((size, m))
    by_vertical, by_rate, by_unseen = np.zeros((3, size, N, 3))
    noise, by_rest_scatter, by_turn_scatter = np.zeros((3, size, size))

    # the rates at rest, ω, and −dω/dθ; the Earth's rate, of which the measured horizontal part is believed as `known`
    model, to_body = block.model(values), onto_body(block.axes)
    inverse = np.asarray(np.linalg.inv(to_body @ model.matrix), dtype=float) @ to_body
    derivative = np.einsum("ap,pqm->aqm", inverse, block.jacobian(values))
    rate, rate_covariance = (rests.gyro - model.bias) @ inverse.T, inverse @ rests.gyro_covariance @ inverse.T
    by_values = np.einsum("aqm,iq->iam", derivative, np.column_stack([rate, np.ones(N)]))
    horizontal = np.eye(3) - u[:, :, None] * u[:, None, :]
    if site.latitude is None:
        up_rate, variance = 0.0, EARTH_RATE**2 / 3.0
        unseen = np.broadcast_to(variance * np.eye(3), (N, 3, 3))
    else:
        up_rate, variance = EARTH_RATE * np.sin(site.latitude), 0.5 * (EARTH_RATE * np.cos(site.latitude)) ** 2
        unseen = variance * horizontal
    measured = 0.5 * np.einsum("iab,ibc,ica->i", horizontal, rate_covariance, horizontal) + scatter["rests"] ** 2
    known = (variance / (variance + measured))[:, None, None]

    # rests: Ω sin B û − ω along û, the dot-product invariant, and two horizontal axes
    i, at_rest = np.arange(N), np.arange(3 * N).reshape(N, 3)
    basis = np.concatenate([u[:, None, :], tangent_basis(u)], axis=1)
    residual[:of_turns] = -_times(basis, up_rate * u - rate).ravel()
    jacobian[:of_turns] = (basis @ by_values).reshape(-1, m)
    by_vertical[at_rest, i[:, None]] = up_rate * basis
    by_vertical[at_rest[:, 0], i] = u * (u * rate).sum(axis=1)[:, None] - rate
    by_rate[at_rest, i[:, None]] = by_unseen[at_rest, i[:, None]] = -basis

    # turns: C û_b − exp([ω T×]) û_a, across the vertical
    a, b, T = turns.first, turns.last, turns.duration
    in_turn = of_turns + np.arange(2 * K).reshape(K, 2)
    earth = T[:, None] * (up_rate * u[a] + _times(known[a] * horizontal[a], rate[a]))
    carried, back = rotation_matrix(earth), _times(turns.C, u[b])
    across = tangent_basis(back)
    by_angle = across @ skew(back)
    by_matrix = np.einsum("kipq,pqm->kim", turns.M, derivative[:, :3]) + turns.B @ derivative[:, 3]
    by_earth = T[:, None, None] * across @ carried @ skew(u[a]) @ (np.eye(3) - 0.5 * skew(earth)) @ horizontal[a]
    residual[in_turn] = -_times(across, back - _times(carried, u[a]))
    jacobian[in_turn] = by_angle @ by_matrix - known[a] * by_earth @ by_values[a]
    by_vertical[in_turn, b[:, None]] += across @ turns.C
    by_vertical[in_turn, a[:, None]] -= across @ carried
    by_rate[in_turn, a[:, None]] += known[a] * by_earth
    by_unseen[in_turn, a[:, None]] += (known[a] - 1.0) * by_earth
    own = in_turn[:, :, None], in_turn[:, None, :]
    noise[own] = by_angle @ turns.covariance @ np.swapaxes(by_angle, 1, 2)
    by_turn_scatter[own] = by_angle @ np.swapaxes(by_angle, 1, 2)
    by_rest_scatter[own] = T[:, None, None] ** 2 * by_turn_scatter[own]

    if spare:  # what n gyros say of themselves: nothing in the directions that no rate explains, at rest or in a turn
        readings = observations.turn_readings
        assert readings is not None
        seconds = np.concatenate([np.ones(N), T])
        y = np.concatenate([rests.gyro, readings.integral]) - np.outer(seconds, model.bias)
        free = left_null_space(model.matrix)
        of_body = np.column_stack([y @ model.inverse().T, seconds])
        rows = of_turns + 2 * K + np.arange(spare * (N + K)).reshape(N + K, spare)
        residual[rows], own = y @ free.T, (rows[:, :, None], rows[:, None, :])
        jacobian[rows] = free @ np.einsum("pqm,iq->ipm", block.jacobian(values), of_body)
        noise[own] = free @ np.concatenate([rests.gyro_covariance, readings.covariance]) @ free.T
        by_rest_scatter[rows[:N, :, None], rows[:N, None, :]] = np.eye(spare)
        by_turn_scatter[rows[N:, :, None], rows[N:, None, :]] = np.eye(spare)

    # the covariance of the rows from all that is uncertain, and what of it the accelerometer values share
    force, to_force = accel.model.apply(rests.accel), accel.model.inverse()
    by_force = horizontal / np.linalg.norm(force, axis=1)[:, None, None]
    reading_by_value = np.einsum(
        "pqm,iq->ipm", observations.accel_block.jacobian(accel.values), np.column_stack([force, np.ones(N)])
    )
    by_accel = np.einsum("rik,ikm->rm", by_vertical, -by_force @ to_force @ reading_by_value)
    by_noise = np.einsum("rik,ikp->rip", by_vertical, by_force @ to_force)
    by_noise += np.einsum("rm,mip->rip", by_accel, accel.gain)
    common = np.vstack([accel.null, accel.by_gravity * site.gravity_u])  # unseen combinations, and g
    by_common = by_accel @ common.T
    accel_covariance = rests.accel_covariance + accel.fit.scatter**2 * np.eye(rests.accel.shape[1])
    noise += by_common @ by_common.T
    for by, covariance in ((by_noise, accel_covariance), (by_rate, rate_covariance), (by_unseen, unseen)):
        noise += np.einsum("rip,ipq,siq->rs", by, covariance, by, optimize=True)
    shared = np.einsum("rip,ipq,miq->rm", by_noise, accel_covariance, accel.gain, optimize=True)
    return GyroRows(
        residual=residual,
        jacobian=jacobian,
        noise=noise,
        by_rest_scatter=by_rest_scatter + np.einsum("rip,sip->rs", by_rate, by_rate),
        by_turn_scatter=by_turn_scatter,
        with_accel=-(shared + by_common @ common),
        ends=(of_turns, of_turns + 2 * K),
    )


def _times(matrices: Array, vectors: Array) -> Array:
    """Matrices (N, p, q) times vectors (N, q)."""
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])
