"""The joint likelihood of everything a session contains: residuals, analytic Jacobians, and the least-squares step with
the attitudes eliminated.

Unknowns: the sensor parameters θ (accelerometers, then gyros), local gravity g, and the attitude L (body → geographic)
of every rest. Minimised is the sum of squares, each over its covariance (turntable method, §8), of

    ŷ − (g S_A u + b_A)                        at rest, u = Lᵀ e_U
    ŷ − (S_G ω + b_G)                          at rest, ω = Lᵀ Ω
    log( C(θ) L_jᵀ e^{−[Ω×]T} L_i )            the turn from rest i to rest j, resolved in the body at its start
    g − g₀                                     the measured gravity

with S_G ω of the turn in C(θ) = exp([φ×]) C, φ = −(M : E + B δ), about the model the turn was integrated with (see
`tumble.reduction.observations`). The turn's residual is §8's log(e^{−[Ω×]T} L_i C L_jᵀ) in other axes, those in
which its covariance is given. Gravity is the same for all rests, so it is an unknown that has been measured; no
table angle has a prior unless a `Prior` is given. The parameters have their spreads (`estimate.SPREAD`) as a prior,
which decides what the data leave open and is nothing beside what they show. What n > 3 gyros say of a turn beyond
its rotation is n − 3 rows more.

Attitudes change in the body, L → L exp([δ×]), with δ in the basis t₁, t₂, u of the rest, so that

    du = u × δ = t₂ δ₁ − t₁ δ₂,   dω = ω × δ,   dr = J_r⁻¹(r) δ_i − J_l⁻¹(r) C δ_j + J_l⁻¹(r) J_l(φ) dφ

J_l(r) is the left Jacobian of the rotation group, J_r(r) = J_l(r)ᵀ. A turn of everything about the vertical leaves the
accelerometers and turns as they are; in this basis its coefficients vanish exactly, so that a heading that the gyros do
not see stays free and takes no information from the others. Without a latitude the Earth's rate is noise, Ω/√3 an axis.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from tumble.earth import EARTH_RATE, earth_rate
from tumble.estimation.elimination import eliminate, left_over, put_back
from tumble.estimation.estimate import spreads_of
from tumble.reduction.observations import Observations, Turns
from tumble.rotation import rotation_matrix, rotation_vector, skew
from tumble.sensors.model import Block, SensorModel
from tumble.units import Array, IntArray

_UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, kw_only=True, slots=True)
class Prior:
    """What is known beforehand: standard deviations, SI, of parameters about their start values, by name (others have
    their spread, `estimate.SPREAD`), and of the attitudes about those of the programme, rad an axis."""

    parameters: Mapping[str, float] = field(default_factory=dict)
    attitude: float | None = None


NO_PRIOR = Prior()


@dataclass(frozen=True, kw_only=True, slots=True)
class Scatter:
    """Scatter on top of the noise within rests: of the accelerometers (m/s²) and gyros (rad/s) from rest to rest, and
    of the turns (rad)."""

    accel: float = 0.0
    gyro: float = 0.0
    turn: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Point:
    """Where the likelihood is taken: parameters (m,), gravity, attitudes (N, 3, 3)."""

    values: Array
    gravity: float
    attitudes: Array

    def moved(self, parameters: Array, angles: Array) -> Point:
        """The point after steps of gravity and the parameters (1 + m,) and of the angles (N, 3) of the attitudes.
        The heading turns everything about the vertical, exactly: it may be off by much."""
        basis = bases(self.attitudes)
        tilt = np.einsum("iab,ib->ia", basis[:, :, :2], angles[:, :2])
        turned = rotation_matrix(angles[:, 2:] * _UP) @ self.attitudes @ rotation_matrix(tilt)
        return Point(values=self.values + parameters[1:], gravity=self.gravity + parameters[0], attitudes=turned)


def bases(attitudes: Array) -> Array:
    """Columns t₁, t₂, u (N, 3, 3) of every rest: north, west and up in the body."""
    return np.stack([attitudes[:, 0], -attitudes[:, 2], attitudes[:, 1]], axis=2)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rows:
    """The linearised residuals, in SI: [coefficients | residual], residual = what is observed less what is predicted,
    columns as `tumble.estimation.elimination` has them, the parameters being gravity, accelerometers, gyros. `prior`
    (1 + p, 1 + p) is whitened, and a triangle."""

    rest: Array
    turn: Array
    prior: Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Weights:
    """Inverses of the Cholesky factors of the covariances of the rows: of the rests (N, r, r) and turns (K, t, t)."""

    rest: Array
    turn: Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Step:
    """The least-squares step: of gravity and the parameters (1 + m,) with their covariance, and of the angles (N, 3);
    and what `left` needs."""

    parameters: Array
    covariance: Array
    angles: Array
    whitened: tuple[Array, Array]
    shared: tuple[Array, Array]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Left:
    """Whitened residuals after a step, and their covariances, 1 where the fit has no part in them: (N, n) and
    (N, n, n) of the accelerometers and of the gyros at rest, (K, t) and (K, t, t) of the turns."""

    accel: tuple[Array, Array]
    gyro: tuple[Array, Array]
    turn: tuple[Array, Array]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Problem:
    """A session as the likelihood sees it: `link` (N,), the turn after each rest or −1, the Earth's rate (3,), zero
    where the latitude is not known, and the programme's attitudes where they have a prior."""

    observations: Observations
    prior: Prior
    link: IntArray
    chain: IntArray
    """The number (N,) of each rest's chain."""
    earth: Array
    spread: Array
    accel_count: int
    """Number of accelerometer parameters."""
    measured: tuple[Array, Array]
    """Gravity and the parameters (1 + m,) as they were known before, with standard deviations; zero where gravity is
    taken as exact."""

    @staticmethod
    def of(observations: Observations, prior: Prior = NO_PRIOR) -> Problem:
        """Raises ValueError unless turns join neighbouring rests, at most one each."""
        accel, gyro, site = observations.accel_block, observations.gyro_block, observations.site
        link = np.full(len(observations.rests), -1, dtype=np.int64)
        turns = observations.turns
        if turns is not None and len(turns):
            if np.any(turns.last != turns.first + 1) or len(np.unique(turns.first)) < len(turns):
                raise ValueError("turns: expected at most one between neighbouring rests, found others")
            link[turns.first] = np.arange(len(turns))
        blocks = [accel] if gyro is None else [accel, gyro]
        names = [name for block in blocks for name in block.names]
        spread = spreads_of(names)
        known = [prior.parameters.get(name, usual) for name, usual in zip(names, spread.tolist(), strict=True)]
        return Problem(
            observations=observations,
            prior=prior,
            link=link,
            chain=np.append(0, np.cumsum(link[:-1] < 0)),
            earth=np.zeros(3) if site.latitude is None else np.array(earth_rate(site.latitude)),
            spread=spread,
            accel_count=len(accel.names),
            measured=(
                np.concatenate([[site.gravity], *(observations.start_values(block) for block in blocks)]),
                np.array([site.gravity_u, *known]),
            ),
        )

    def accel_model(self, values: Array) -> SensorModel:
        """The accelerometers of parameters (m,)."""
        return self.observations.accel_block.model(values[: self.accel_count])

    def gyro_model(self, values: Array) -> SensorModel:
        """The gyros of parameters (m,)."""
        assert self.observations.gyro_block is not None
        return self.observations.gyro_block.model(values[self.accel_count :])


# Residuals and Jacobians


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TurnsAbout:
    """Turns with the gyro model they were integrated about, and the matrix (3, n) that takes its readings to body rate
    as the integration does: through nominal sensors."""

    turns: Turns
    model: SensorModel
    to_rate: Array

    @staticmethod
    def of(observations: Observations, model: SensorModel) -> TurnsAbout:
        """The turns of a session, integrated about a gyro model."""
        assert observations.gyro_block is not None
        to_body = np.linalg.pinv(observations.gyro_block.axes)
        to_rate = np.asarray(np.linalg.inv(to_body @ model.matrix) @ to_body)
        return TurnsAbout(turns=observations.turns_about(model), model=model, to_rate=to_rate)

    def change(self, now: SensorModel) -> tuple[Array, Array]:
        """Relative error E (3, 3) of the matrix and error δ (3,), rad/s, of the bias of another model about this."""
        return self.to_rate @ (now.matrix - self.model.matrix), self.to_rate @ (now.bias - self.model.bias)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Sensors:
    """A block at a point: its model, the derivative (n, 4, m) of that, and which parameters are its."""

    model: SensorModel
    derivative: Array
    columns: slice

    @staticmethod
    def of(block: Block, values: Array, first: int) -> _Sensors:
        own = slice(first, first + len(block.names))
        return _Sensors(
            model=block.model(values[own]),
            derivative=block.jacobian(values[own]),
            columns=slice(1 + own.start, 1 + own.stop),
        )

    def by_values(self, true: Array) -> Array:
        """Derivative (N, n, m) of the readings of true vectors (N, 3)."""
        return (
            np.asarray(true @ self.derivative[:, :3].swapaxes(0, 1).reshape(3, -1)).reshape(
                len(true), *self.derivative.shape[::2]
            )
            + self.derivative[:, 3]
        )


def linearise(problem: Problem, point: Point, about: TurnsAbout | None) -> Rows:
    """Residuals and Jacobians at a point; `about` is None where there are no turns."""
    observations = problem.observations
    accel = _Sensors.of(observations.accel_block, point.values, 0)
    rest, turn = [_accel_rows(problem, point, accel)], np.zeros((0, 3, 8 + len(point.values)))
    if observations.gyro_block is not None:
        gyro = _Sensors.of(observations.gyro_block, point.values, problem.accel_count)
        rest.append(_gyro_rows(problem, point, gyro))
        if about is not None:
            turn = _turn_rows(problem, point, about, gyro)
    if problem.prior.attitude is not None:
        rest.append(_attitude_rows(problem, point))
    return Rows(rest=np.concatenate(rest, axis=1), turn=turn, prior=_prior_rows(problem, point))


def _accel_rows(problem: Problem, point: Point, accel: _Sensors) -> Array:
    """ŷ − (g S u + b)."""
    g, L, S = point.gravity, point.attitudes, accel.model.matrix
    rows = np.zeros((len(L), len(S), 5 + len(point.values)))
    rows[:, :, 0] = -g * (L[:, 2] @ S.T)
    rows[:, :, 1] = -g * (L[:, 0] @ S.T)
    if problem.observations.site.gravity_u > 0.0:
        rows[:, :, 3] = L[:, 1] @ S.T
    rows[:, :, 3:-1][:, :, accel.columns] = accel.by_values(g * L[:, 1])
    rows[:, :, -1] = problem.observations.rests.accel - accel.model.predict(g * L[:, 1])
    return rows


def _gyro_rows(problem: Problem, point: Point, gyro: _Sensors) -> Array:
    """ŷ − (S ω + b)."""
    omega = problem.earth @ point.attitudes
    rows = np.zeros((len(omega), len(gyro.model.matrix), 5 + len(point.values)))
    rows[:, :, :3] = gyro.model.matrix @ skew(omega) @ bases(point.attitudes)
    rows[:, :, 3:-1][:, :, gyro.columns] = gyro.by_values(omega)
    rows[:, :, -1] = problem.observations.rests.gyro - gyro.model.predict(omega)
    return rows


def _turn_rows(problem: Problem, point: Point, about: TurnsAbout, gyro: _Sensors) -> Array:
    """log(C(θ) L_jᵀ e^{−[Ω×]T} L_i), and what more than three gyros say of themselves."""
    turns, basis = about.turns, bases(point.attitudes)
    start, end = point.attitudes[turns.first], point.attitudes[turns.last]
    K, flat = len(turns), turns.M.reshape(len(turns), 3, 9)
    E, offset = about.change(gyro.model)
    phi = -(flat @ E.ravel() + turns.B @ offset)
    C = rotation_matrix(phi) @ turns.C
    earth = rotation_matrix(-turns.duration[:, None] * problem.earth)
    r = rotation_vector(C @ np.swapaxes(end, 1, 2) @ earth @ start)
    left = inverse_left_jacobian(r)
    derivative = np.tensordot(about.to_rate, gyro.derivative, axes=1)
    by_values = flat @ derivative[:, :3].reshape(9, -1) + turns.B @ derivative[:, 3]
    rows = np.zeros((K, 3, 8 + len(point.values)))
    rows[:, :, :3] = -np.swapaxes(left, 1, 2) @ basis[turns.first]
    rows[:, :, 3:6] = left @ C @ basis[turns.last]
    rows[:, :, 6:-1][:, :, gyro.columns] = left @ left_jacobian(phi) @ by_values
    rows[:, :, -1] = r
    if problem.observations.turn_readings is None:
        return rows
    return np.concatenate([rows, _spare_rows(problem, point, turns, gyro)], axis=1)


def _spare_rows(problem: Problem, point: Point, turns: Turns, gyro: _Sensors) -> Array:
    """What n gyros say of themselves: ∫ ŷ dt − b T has nothing in the directions that no rate explains."""
    readings = problem.observations.turn_readings
    assert readings is not None
    free = _free(gyro.model)
    y = readings.integral - np.outer(turns.duration, gyro.model.bias)
    rows = np.zeros((len(y), len(free), 8 + len(point.values)))
    by_rate = np.einsum("pqm,kq->kpm", gyro.derivative[:, :3], y @ gyro.model.inverse().T)
    rows[:, :, 6:-1][:, :, gyro.columns] = free @ (by_rate + turns.duration[:, None, None] * gyro.derivative[:, 3])
    rows[:, :, -1] = y @ free.T
    return rows


def _free(model: SensorModel) -> Array:
    """Orthonormal rows (n − 3, n): the directions of readings that no rate explains."""
    return np.asarray(np.linalg.qr(model.matrix, mode="complete")[0][:, 3:].T)


def _attitude_rows(problem: Problem, point: Point) -> Array:
    """log(Lᵀ L_nominal); of a programme in any order, where only the vertical is known, its tilt."""
    programme, position = problem.observations.programme, problem.observations.position
    assert programme is not None
    assert position is not None
    nominal = np.array([programme.positions[i].matrix for i in position])
    basis = bases(point.attitudes)
    rows = np.zeros((len(nominal), 3, 3 + 1 + len(point.values) + 1))
    if programme.ordered:
        e = rotation_vector(np.swapaxes(point.attitudes, 1, 2) @ nominal)
        rows[:, :, :3] = inverse_left_jacobian(e) @ basis
        rows[:, :, -1] = e
    else:
        across = -point.attitudes[:, [2, 0]]
        rows[:, :2, :3] = -np.cross(nominal[:, None, 1], across) @ basis
        rows[:, :2, -1] = np.einsum("iab,ib->ia", across, nominal[:, 1])
    return rows


def _prior_rows(problem: Problem, point: Point) -> Array:
    """Measured gravity and the prior of the parameters: a diagonal and a right-hand side, whitened."""
    expected, u = problem.measured
    known = u > 0.0
    weight = np.where(known, 1.0 / np.where(known, u, 1.0), 0.0)
    rows = np.zeros((len(u) + 1, len(u) + 1))
    rows[np.arange(len(u)), np.arange(len(u))] = weight
    rows[:-1, -1] = weight * (expected - np.append(point.gravity, point.values))
    return rows


def left_jacobian(r: Array) -> Array:
    """J_l(r) (..., 3, 3): exp([(r + dr)×]) = exp([J_l dr×]) exp([r×]) to first order in dr."""
    angle = np.linalg.norm(r, axis=-1)[..., None, None]
    K = skew(r)
    small = angle < 1e-2
    safe = np.where(small, 1.0, angle)
    second = np.where(small, 1.0 / 6.0 - angle**2 / 120.0, (safe - np.sin(safe)) / safe**3)
    return np.asarray(np.eye(3) + 0.5 * np.sinc(0.5 * angle / np.pi) ** 2 * K + second * (K @ K))


def inverse_left_jacobian(r: Array) -> Array:
    """J_l⁻¹(r) (..., 3, 3); its transpose is J_r⁻¹(r)."""
    angle = np.linalg.norm(r, axis=-1)[..., None, None]
    K = skew(r)
    small = angle < 1e-2
    safe = np.where(small, 1.0, angle)
    series = 1.0 / 12.0 + angle**2 / 720.0
    second = np.where(small, series, 1.0 / safe**2 - 0.5 / (safe * np.tan(0.5 * safe)))
    return np.asarray(np.eye(3) - 0.5 * K + second * (K @ K))


# Weights


def weights(problem: Problem, scatter: Scatter) -> Weights:
    """The weights of the rows from the noise within rests and a scatter, which for the gyros lasts through the turn
    that follows."""
    observations, rests = problem.observations, problem.observations.rests
    blocks = [rests.accel_covariance + scatter.accel**2 * np.eye(rests.accel.shape[1])]
    unseen = EARTH_RATE**2 / 3.0 if observations.site.latitude is None else 0.0
    if observations.gyro_block is not None:
        axes = observations.gyro_block.axes
        blocks.append(rests.gyro_covariance + scatter.gyro**2 * np.eye(len(axes)) + unseen * axes @ axes.T)
    if problem.prior.attitude is not None:
        blocks.append(np.broadcast_to(problem.prior.attitude**2 * np.eye(3), (len(rests), 3, 3)))
    return Weights(rest=_joined(blocks), turn=_turn_weights(problem, scatter, unseen))


def _turn_weights(problem: Problem, scatter: Scatter, unseen: float) -> Array:
    turns, readings = problem.observations.turns, problem.observations.turn_readings
    if turns is None:
        return np.zeros((0, 3, 3))
    T = turns.duration[:, None, None]
    blocks = [turns.covariance + (scatter.turn**2 + T**2 * (scatter.gyro**2 + unseen)) * np.eye(3)]
    if readings is not None:
        assert problem.observations.gyro_block is not None
        free = _free(problem.observations.gyro_block.nominal())
        blocks.append(free @ readings.covariance @ free.T + scatter.turn**2 * np.eye(len(free)))
    return _joined(blocks)


def _joined(blocks: list[Array]) -> Array:
    """Inverse Cholesky factors of covariances (N, n, n), as one block-diagonal matrix each."""
    size = sum(b.shape[-1] for b in blocks)
    out, first = np.zeros((len(blocks[0]), size, size)), 0
    for block in blocks:
        last = first + block.shape[-1]
        out[:, first:last, first:last] = np.linalg.inv(np.linalg.cholesky(block))
        first = last
    return out


# The step


def solve(problem: Problem, rows: Rows, weight: Weights) -> Step:
    """The least-squares step with the attitudes eliminated."""
    rest, turn = weight.rest @ rows.rest, weight.turn @ rows.turn
    N, p = len(rest), len(rows.prior) - 1
    factor, triangle = np.empty((N, 3, 7 + p)), rows.prior.copy()
    eliminate(rest, turn, problem.link, factor, triangle)
    parameters, covariance = _solved(triangle)
    angles = np.empty((N, 3))
    shared = put_back(factor, problem.link, parameters, covariance, angles)
    return Step(parameters=parameters, covariance=covariance, angles=angles, whitened=(rest, turn), shared=shared)


def _solved(triangle: Array) -> tuple[Array, Array]:
    """Step (1 + m,) and covariance of gravity and the parameters; of gravity zero where it is taken as exact."""
    first = int(triangle[0, 0] == 0.0)
    p = len(triangle) - 1
    step, covariance = np.zeros(p), np.zeros((p, p))
    inverse = np.linalg.inv(triangle[first:p, first:p])
    step[first:] = inverse @ triangle[first:p, p]
    covariance[first:, first:] = inverse @ inverse.T
    return step, covariance


def left(problem: Problem, step: Step) -> Left:
    """What a step leaves of the residuals."""
    rest, turn = step.whitened
    residual, covariance, turn_residual, turn_covariance = left_over(
        rest, turn, problem.link, step.angles, step.parameters, (step.covariance, *step.shared)
    )
    n = problem.observations.accel_block.size
    stop = n + problem.observations.rests.gyro.shape[1]
    return Left(
        accel=(residual[:, :n], covariance[:, :n, :n]),
        gyro=(residual[:, n:stop], covariance[:, n:stop, n:stop]),
        turn=(turn_residual, turn_covariance),
    )
