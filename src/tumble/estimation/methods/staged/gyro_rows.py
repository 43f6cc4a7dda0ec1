"""Stage 2 of the staged method, its rows: what rests and turns say of the gyros, linearised, with covariance.

With û = S⁻¹(y − b)/g from stage 1:

    rests   ω̂ = û Ω sin B + (horizontal part of the Earth's rate, azimuth unknown: zero ± Ω cos B/√2 an axis)
    turns   C û_j = exp([ω_i T ×]) û_i, the vertical after a turn carried back by the gyros, two equations each,
            with the Jacobian from the logged rate, §6.6

The first is the dot-product invariant û·ω̂ = Ω sin B where the noise is small against Ω, and the mean of the rests
where it is large; the second is the indirect method for turns of any kind. ω_i, the Earth's rate in the body, is
the measured one, shrunk towards the vertical part in proportion to its noise. More than three gyros also say n − 3
things of themselves at every rest and in every turn: their readings must be those of one rate.

The covariance is that of the noise of rests (accelerometers and gyros) and of turns, their scatter, what stage 1
leaves, and the uncertainty of g, all propagated; rests shared by two turns make their rows correlated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.earth import EARTH_RATE
from tumble.estimation.methods.staged.accelerometers import Accelerometers
from tumble.reduction.observations import Observations
from tumble.reduction.turns.turns import Turns
from tumble.rotation import onto_body, rotation_matrix, skew, tangent_basis
from tumble.sensors.model import beyond_body
from tumble.units import Array


@dataclass(frozen=True, kw_only=True, slots=True)
class GyroScatter:
    """Scatter between rests (rad/s) and of turns (rad) on top of the noise within rests."""

    rest: float = 0.0
    turn: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GyroRows:
    """Residuals (r,) of rests (three each: along the vertical, then two horizontal) and turns (two each), their
    derivatives (r, m), their covariance (r, r) without scatter, what a unit variance of scatter adds to it, and
    the part shared with the accelerometer values (r, m_a)."""

    residual: Array
    jacobian: Array
    noise: Array
    by_rest_scatter: Array
    by_turn_scatter: Array
    with_accel: Array

    def covariance(self, scatter: GyroScatter) -> Array:
        """Covariance (r, r) at a scatter."""
        return self.noise + scatter.rest**2 * self.by_rest_scatter + scatter.turn**2 * self.by_turn_scatter


def gyro_rows(
    observations: Observations, accel: Accelerometers, turns: Turns, values: Array, scatter: GyroScatter
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
    measured = 0.5 * np.einsum("iab,ibc,ica->i", horizontal, rate_covariance, horizontal) + scatter.rest**2
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
        free = beyond_body(model.matrix)
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
    )


def _times(matrices: Array, vectors: Array) -> Array:
    """Matrices (N, p, q) times vectors (N, q)."""
    return np.asarray((matrices @ vectors[:, :, None])[:, :, 0])
