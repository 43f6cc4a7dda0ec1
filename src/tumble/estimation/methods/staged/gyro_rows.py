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
from tumble.reduction.turns import Turns
from tumble.rotation import onto_body, rotation_matrix, skew, tangent_basis
from tumble.sensors.model import SensorModel
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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _State:
    """What the rows need: the gyro model, the rates ω (N, 3) it gives at rest with their covariance, the verticals
    and how they depend on noise and on the accelerometer values, and the Earth's rate as far as it is known."""

    accel: Accelerometers
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
    def of(observations: Observations, accel: Accelerometers, values: Array, scatter: GyroScatter) -> _State:
        block, rests, site = observations.gyro_block, observations.rests, observations.site
        assert block is not None
        model = block.model(values)
        to_body = onto_body(block.axes)
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


def _with_covariance(state: _State, design: _Design) -> GyroRows:
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
    return GyroRows(
        residual=design.residual,
        jacobian=design.jacobian,
        noise=covariance,
        by_rest_scatter=design.by_rest_scatter + np.einsum("rip,sip->rs", design.by_rate, design.by_rate),
        by_turn_scatter=design.by_turn_scatter,
        with_accel=-(shared + by_common @ common),
    )
