"""The joint likelihood of everything a session contains: residuals, analytic Jacobians, and the least-squares step with
the attitudes eliminated.

Unknowns: the parameters θ of the instrument, local gravity g, and the attitude L (body → geographic) of every rest.
Minimised is the sum of squares, each over its covariance (turntable method §8; dynamics method §3), of

    ŷ − Σ_b K_b(θ) β_b(f, ω)                   at rest, of both blocks: f = g u, u = Lᵀ e_U; ω = Lᵀ Ω
    log( C(θ) L_jᵀ e^{−[Ω×]T} L_i )            the turn from rest i to rest j, resolved in the body at its start
    V(θ) − L_iᵀ ∫ e^{[Ω×]s} g e_U ds           its velocity, likewise, where levers and delay are unknowns        (9)
    g − g₀                                     the measured gravity

C(θ) = exp([φ×]) C and V(θ) are about the parameters the turn was integrated with: φ and V change with the coefficients
K by what `tumble.reduction.moments` has of the turn, to first order; levers and delays enter V linearly. The turn's
rows are (9) in other axes, those in which its covariance is given. The Coriolis term of (9) is left out: it is below
0.1 σ for a table whose axes are within a metre. Gravity is the same for all rests, so it is an unknown that has been
measured; no table angle has a prior unless a `Prior` is given. Parameters have priors: those of the linear model
their limits, which decide what the data leave open and are nothing beside what they show; the others what
instruments usually have. What n > 3 gyros say of a turn beyond its rotation is n − 3 rows more.

Attitudes change in the body, L → L exp([δ×]), with δ in the basis t₁, t₂, u of the rest, so that

    du = u × δ = t₂ δ₁ − t₁ δ₂,   dω = ω × δ,   dr = J_r⁻¹(r) δ_i − J_l⁻¹(r) C δ_j + J_l⁻¹(r) J_l(φ) dφ

J_l(r) is the left Jacobian of the rotation group, J_r(r) = J_l(r)ᵀ. A turn of everything about the vertical leaves the
accelerometers and turns as they are; in this basis its coefficients vanish exactly, so that a heading that the gyros do
not see stays free and takes no information from the others. Without a latitude the Earth's rate is noise, Ω/√3 an axis.

Noise. Beside the noise within rests a session has components of variance (`Scatter`): a bias of the accelerometers and
of the gyros that differs from rest to rest and lasts through the turn that follows, which makes the rows of a rest and
of its turn dependent; a scatter of the rotations and of the velocities of the turns; and the error of integrals over
samples that jump (A3). Rows of a rest and of the turn after it are therefore whitened together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from tumble.earth import EARTH_RATE, earth_rate
from tumble.estimation.elimination import eliminate, left_over, put_back
from tumble.estimation.turns_about import TurnsAbout
from tumble.reduction.observations import Observations
from tumble.rotation import rotation_matrix, rotation_vector, skew
from tumble.sensors.instrument import Instrument, functions, slopes
from tumble.sensors.model import Block, SensorModel
from tumble.sensors.parameters import CONSTANT, limits_of
from tumble.units import Array, IntArray

_UP = np.array([0.0, 1.0, 0.0])

COMPONENTS = ("accel", "gyro", "turn", "velocity", "jumps")
"""The components of variance, in the order of `Scatter`."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Prior:
    """What is known beforehand: standard deviations, SI, of parameters about their start values, by name (others have
    their limit or their usual size), and of the attitudes about those of the programme, rad an axis."""

    parameters: Mapping[str, float] = field(default_factory=dict)
    attitude: float | None = None


NO_PRIOR = Prior()


@dataclass(frozen=True, kw_only=True, slots=True)
class Scatter:
    """Standard deviations on top of the noise within rests: of a bias of the accelerometers (m/s²) and gyros (rad/s)
    from rest to rest, of the rotations (rad) and velocities (m/s) of turns, and c of (A3), the error of the integral
    over a jump between samples in parts of its size times the interval."""

    accel: float = 0.0
    gyro: float = 0.0
    turn: float = 0.0
    velocity: float = 0.0
    jumps: float = 0.0

    @property
    def variances(self) -> Array:
        """The squares, in the order of COMPONENTS."""
        return np.array([getattr(self, name) for name in COMPONENTS]) ** 2

    @staticmethod
    def of_variances(variances: Array) -> Scatter:
        """The scatter of these squares."""
        return Scatter(**dict(zip(COMPONENTS, np.sqrt(variances).tolist(), strict=True)))


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
    """The linearised residuals, in SI: [coefficients | residual], residual = observed less predicted, columns as
    `tumble.estimation.elimination` has them with three unknowns a rest, the parameters being gravity and those of the
    instrument. `prior` (1 + p, 1 + p) is whitened, and a triangle. `bias` are the coefficients (K, t, n) of the
    turns for a bias of the accelerometers, then of the gyros, in the turn."""

    rest: Array
    turn: Array
    prior: Array
    bias: Array

    def merged(self, first: IntArray) -> Array:
        """Rows (K, r + t, ·) of every turn together with those of the rest before it."""
        K, t = self.turn.shape[:2]
        r = self.rest.shape[1]
        out = np.zeros((K, r + t, self.turn.shape[2]))
        out[:, :r, :3], out[:, :r, 6:] = self.rest[first, :, :3], self.rest[first, :, 3:]
        out[:, r:] = self.turn
        return out


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Noise:
    """Covariance of the rows without scatter, of the rests (N, r, r) and of the merged rows (K, r + t, r + t), and the
    directions Z (N, r, q), (K, r + t, q) of every component of variance, by COMPONENTS: Σ = N + Σ v Z Zᵀ."""

    rest: Array
    merged: Array
    rest_directions: tuple[Array, ...]
    merged_directions: tuple[Array, ...]

    def weights(self, scatter: Scatter) -> Weights:
        """The weights of the rows with a scatter."""
        return Weights(
            rest=_whitening(self.rest, self.rest_directions, scatter),
            merged=_whitening(self.merged, self.merged_directions, scatter),
        )


def _whitening(noise: Array, directions: tuple[Array, ...], scatter: Scatter) -> Array:
    """Inverse Cholesky factors of N + Σ v Z Zᵀ."""
    total = noise
    for variance, Z in zip(scatter.variances, directions, strict=True):
        if variance > 0.0 and Z.shape[2]:
            total = total + variance * (Z @ np.swapaxes(Z, 1, 2))
    return np.asarray(np.linalg.inv(np.linalg.cholesky(total)))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Weights:
    """Inverses of the Cholesky factors of the covariances of the rows: of the rests (N, r, r), which count where no
    turn follows, and of the merged rows of rests and turns (K, r + t, r + t)."""

    rest: Array
    merged: Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Step:
    """The least-squares step: of gravity and the parameters (1 + m,) with their covariance, and of the angles (N, 3);
    twice the negative logarithm of the restricted likelihood, less its constant; and what `left` needs."""

    parameters: Array
    covariance: Array
    angles: Array
    deviance: float
    whitened: tuple[Array, Array]
    shared: tuple[Array, Array]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Left:
    """Whitened residuals after a step, and their covariances, 1 where the fit has no part in them: (N, r) and (N, r, r)
    of the rests, which count where no turn follows, (K, r + t) and (K, r + t, r + t) of the merged rows."""

    rest: tuple[Array, Array]
    merged: tuple[Array, Array]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Problem:
    """A session as the likelihood sees it: `link` (N,), the turn after each rest or −1, `chain` (N,), the number of
    each rest's chain, the Earth's rate (3,), zero where the latitude is not known, and `measured`, gravity and the
    parameters (1 + m,) as they were known before, with standard deviations; zero where gravity is taken as exact."""

    observations: Observations
    instrument: Instrument
    prior: Prior
    link: IntArray
    chain: IntArray
    earth: Array
    measured: tuple[Array, Array]
    variables: Mapping[str, tuple[Array, Array]]
    """What parameters may change with, in the middle of the rests (N,) and of the turns (K,)."""

    @staticmethod
    def of(
        observations: Observations,
        prior: Prior = NO_PRIOR,
        *,
        instrument: Instrument | None = None,
        usual: Mapping[str, float] | None = None,
    ) -> Problem:
        """A session with the parameters of an instrument (those of the linear model where None); `usual` are the priors
        of its further groups by name. Raises ValueError unless turns join neighbouring rests, at most one each."""
        accel, gyro, site = observations.accel_block, observations.gyro_block, observations.site
        instrument = instrument or Instrument(accel=accel, gyro=gyro)
        link = np.full(len(observations.rests), -1, dtype=np.int64)
        turns = observations.turns
        if turns is not None and len(turns):
            if np.any(turns.last != turns.first + 1) or len(np.unique(turns.first)) < len(turns):
                raise ValueError("turns: expected at most one between neighbouring rests, found others")
            link[turns.first] = np.arange(len(turns))
        known = limits_of(instrument.names)
        for name, members in instrument.members.items():
            known[members] = (usual or {}).get(name, known[members])
        known = np.array([prior.parameters.get(n, k) for n, k in zip(instrument.names, known.tolist(), strict=True)])
        start = np.array([observations.start.get(name, 0.0) for name in instrument.names])
        return Problem(
            observations=observations,
            instrument=instrument,
            prior=prior,
            link=link,
            chain=np.append(0, np.cumsum(link[:-1] < 0)),
            earth=np.zeros(3) if site.latitude is None else np.array(earth_rate(site.latitude)),
            measured=(np.append(site.gravity, start), np.append(site.gravity_u, known)),
            variables=variables_of(observations),
        )

    @property
    def spread(self) -> Array:
        """How far the parameters (m,) may reasonably be from nominal."""
        return limits_of(self.instrument.names)

    def accel_model(self, values: Array) -> SensorModel:
        """The accelerometers of parameters (m,)."""
        return self.instrument.model(self.observations.accel_block, values)

    def gyro_model(self, values: Array) -> SensorModel:
        """The gyros of parameters (m,)."""
        assert self.observations.gyro_block is not None
        return self.instrument.model(self.observations.gyro_block, values)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Linearised:
    """The likelihood about the estimate: the point, the turns about it, the rows there, their noise, and the scatter
    on top of it."""

    problem: Problem
    point: Point
    about: TurnsAbout | None
    rows: Rows
    noise: Noise
    scatter: Scatter


def variables_of(observations: Observations) -> dict[str, tuple[Array, Array]]:
    """What parameters may change with: time from the middle of the session, s, and temperature from its mean, K, in the
    middle of the rests (N,) and of the turns (K,)."""
    rests, turns = observations.rests, observations.turns
    time = 0.5 * (rests.start + rests.stop)
    at_rest = {"time": time - 0.5 * (time.min() + time.max())}
    if rests.temperature is not None:
        at_rest["temperature"] = rests.temperature - rests.temperature.mean()
    if turns is None:
        return {name: (values, np.zeros(0)) for name, values in at_rest.items()}
    return {name: (v, 0.5 * (v[turns.first] + v[turns.last])) for name, v in at_rest.items()}


# Residuals and Jacobians


def linearise(problem: Problem, point: Point, about: TurnsAbout | None) -> Rows:
    """Residuals and Jacobians at a point; `about` is None where there are no turns."""
    observations = problem.observations
    rest = [_rest_rows(problem, point, observations.accel_block, observations.rests.accel)]
    p = 2 + len(point.values)
    turn, bias = np.zeros((0, 6, 6 + p)), np.zeros((0, 6, 0))
    if observations.gyro_block is not None:
        rest.append(_rest_rows(problem, point, observations.gyro_block, observations.rests.gyro))
        if about is not None:
            turn, bias = _turn_rows(problem, point, about)
    if problem.prior.attitude is not None:
        rest.append(_attitude_rows(problem, point))
    return Rows(rest=np.concatenate(rest, axis=1), turn=turn, prior=_prior_rows(problem, point), bias=bias)


def _rest_rows(problem: Problem, point: Point, block: Block, observed: Array) -> Array:
    """ŷ − Σ K β of one block."""
    g, L, instrument = point.gravity, point.attitudes, problem.instrument
    force, rate, basis = g * L[:, 1], problem.earth @ L, bases(L)
    K, beta = instrument.coefficients(block, point.values), functions(block, force, rate)
    by_force, by_rate = slopes(block, K, force, rate)
    used = instrument.used[block.kind]
    rows = np.zeros((len(L), block.size, 5 + len(point.values)))
    rows[:, :, :2] = by_force @ (skew(force) @ basis)[:, :, :2]
    rows[:, :, :3] += by_rate @ skew(rate) @ basis
    if problem.observations.site.gravity_u > 0.0:
        rows[:, :, 3] = np.einsum("npk,nk->np", by_force, L[:, 1])
    D = instrument.derivative(block, point.values)
    rows[:, :, 4:-1] = np.einsum("npb,pbm->npm", beta[:, :, used], D[:, used], optimize=True)
    rows[:, :, -1] = observed - np.einsum("npb,pb->np", beta, K)
    for own, base, variable in instrument.changes:
        rows[:, :, 4:-1][:, :, own] = problem.variables[variable][0][:, None, None] * rows[:, :, 4:-1][:, :, base]
        rows[:, :, -1] -= rows[:, :, 4:-1][:, :, own] @ point.values[own]
    return rows


def _turn_rows(problem: Problem, point: Point, about: TurnsAbout) -> tuple[Array, Array]:
    """Rotation and velocity of the turns, what more than three gyros say of themselves, and the coefficients of all for
    a bias of the accelerometers and gyros."""
    observations, instrument = problem.observations, problem.instrument
    turns, gyro = observations.turns, observations.gyro_block
    assert turns is not None
    assert gyro is not None
    basis, start, end = bases(point.attitudes), point.attitudes[turns.first], point.attitudes[turns.last]
    phi, V = about.moved(instrument, point.values)
    by_phi, by_V = about.columns(instrument, point.values)
    for own, base, variable in instrument.changes:
        for by, changed in ((by_phi, phi), (by_V, V)):
            by[:, :, own] = problem.variables[variable][1][:, None, None] * by[:, :, base]
            changed -= by[:, :, own] @ point.values[own]
    C = rotation_matrix(phi) @ about.C
    earth = rotation_matrix(-turns.duration[:, None] * problem.earth)
    r = rotation_vector(C @ np.swapaxes(end, 1, 2) @ earth @ start)
    left = inverse_left_jacobian(r)
    phi_bias, V_bias = about.bias_columns()
    rows = np.zeros((len(turns), 6, 8 + len(point.values)))
    rows[:, :3, :3] = -np.swapaxes(left, 1, 2) @ basis[turns.first]
    rows[:, :3, 3:6] = left @ C @ basis[turns.last]
    rows[:, :3, 7:-1] = left @ left_jacobian(phi) @ by_phi
    rows[:, :3, -1] = r
    bias = np.zeros((len(turns), 6, phi_bias.shape[2]))
    bias[:, :3], bias[:, 3:] = left @ left_jacobian(phi) @ phi_bias, V_bias
    if instrument.in_velocities:
        predicted, by_turning = _velocity(problem, point, turns.duration)
        rows[:, 3:, :3] = by_turning
        if observations.site.gravity_u > 0.0:
            rows[:, 3:, 6] = predicted / point.gravity
        rows[:, 3:, 7:-1], rows[:, 3:, -1] = by_V, V - predicted
    else:
        rows, bias = rows[:, :3], bias[:, :3]
    if observations.turn_readings is None:
        return rows, bias
    spare, spare_bias = _spare_rows(problem, point)
    return np.concatenate([rows, spare], axis=1), np.concatenate([bias, spare_bias], axis=1)


def _velocity(problem: Problem, point: Point, T: Array) -> tuple[Array, Array]:
    """L_iᵀ ∫ e^{[Ω×]s} g e_U ds (K, 3) over the turns, and its derivative (K, 3, 3) with the attitude of the rest
    before: ∫ = T (I + [x×]/2 + [x×]²/6) with x = Ω T. The heading has a part in it through the Earth's rate alone."""
    turns = problem.observations.turns
    assert turns is not None
    L, basis = point.attitudes[turns.first], bases(point.attitudes)[turns.first]
    X = skew(T[:, None] * problem.earth)
    by_earth = (point.gravity * T)[:, None] * np.einsum("kia,ki->ka", L, (X / 2.0 + X @ X / 6.0) @ _UP)
    straight = (point.gravity * T)[:, None] * L[:, 1]
    by_turning = skew(by_earth) @ basis
    by_turning[:, :, :2] += (skew(straight) @ basis)[:, :, :2]
    return straight + by_earth, by_turning


def _spare_rows(problem: Problem, point: Point) -> tuple[Array, Array]:
    """What n gyros say of themselves: ∫ ŷ dt − b T has nothing in the directions that no rate explains."""
    observations, instrument = problem.observations, problem.instrument
    readings, gyro, turns = observations.turn_readings, observations.gyro_block, observations.turns
    assert readings is not None
    assert gyro is not None
    assert turns is not None
    model = problem.gyro_model(point.values)
    free = _free(model)
    y = readings.integral - np.outer(turns.duration, model.bias)
    by_rate = np.zeros((len(y), 1, 15))
    by_rate[:, 0, 1:4] = y @ model.inverse().T
    by_rate[:, 0, CONSTANT] = turns.duration
    rows = np.zeros((len(y), len(free), 8 + len(point.values)))
    D = instrument.derivative(gyro, point.values)
    rows[:, :, 7:-1] = free @ np.einsum("kb,pbm->kpm", by_rate[:, 0, :4], D[:, :4])
    rows[:, :, -1] = y @ free.T
    none = np.zeros((len(y), len(free), observations.accel_block.size))
    bias = turns.duration[:, None, None] * np.broadcast_to(free, (len(y), *free.shape))
    return rows, np.concatenate([none, bias], axis=2)


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


# Noise


def noise_of(problem: Problem, rows: Rows) -> Noise:
    """Covariance of the rows without scatter, and the directions of the components of variance."""
    observations, rests = problem.observations, problem.observations.rests
    gyro, n = observations.gyro_block, rests.accel.shape[1]
    unseen = EARTH_RATE**2 / 3.0 if observations.site.latitude is None else 0.0
    blocks = [rests.accel_covariance]
    if gyro is not None:
        blocks.append(rests.gyro_covariance + unseen * gyro.axes @ gyro.axes.T)
    if problem.prior.attitude is not None:
        blocks.append(np.broadcast_to(problem.prior.attitude**2 * np.eye(3), (len(rests), 3, 3)))
    rest = _diagonal(blocks)
    r, stop = rest.shape[1], n + rests.gyro.shape[1]
    selected = np.broadcast_to(np.eye(r), rest.shape)
    none = np.zeros((len(rests), r, 0))
    at_rest = (selected[:, :, :n], selected[:, :, n:stop], none, none, none)
    turns = observations.turns
    if turns is None or not len(turns):
        t = r + rows.turn.shape[1]
        empty = (np.zeros((0, t, 0)),) * len(COMPONENTS)
        return Noise(rest=rest, merged=np.zeros((0, t, t)), rest_directions=at_rest, merged_directions=empty)
    bias = np.zeros((len(turns), r + rows.turn.shape[1], stop))
    bias[:, :stop] = np.eye(stop)
    bias[:, r:] = rows.bias
    v = 3 if problem.instrument.in_velocities else 0
    spare = rows.turn.shape[1] - 3 - v
    rotation, velocity, jumps = (np.zeros((len(turns), bias.shape[1], q)) for q in (3 + spare, v, v))
    rotation[:, r : r + 3, :3] = np.eye(3)
    rotation[:, r + 3 + v :, 3:] = np.eye(spare)
    velocity[:, r + 3 : r + 3 + v] = np.eye(v)
    jumps[:, r + 3 : r + 3 + v] = np.sqrt(turns.jumps)[:, None, None] * np.eye(v)
    return Noise(
        rest=rest,
        merged=_diagonal([rest[turns.first], _turn_noise(problem, unseen)]),
        rest_directions=at_rest,
        merged_directions=(bias[:, :, :n], bias[:, :, n:], rotation, velocity, jumps),
    )


def _turn_noise(problem: Problem, unseen: float) -> Array:
    """Covariance (K, t, t) of the rows of the turns: Eq. (8) with the variance of a mean over the turn in place of that
    of white noise (A3)."""
    turns, readings = problem.observations.turns, problem.observations.turn_readings
    assert turns is not None
    T = turns.duration[:, None, None]
    rotation = turns.covariance + T**2 * unseen * np.eye(3)
    across = skew(-0.5 * turns.velocity)
    by_rotation = across @ rotation @ np.swapaxes(across, 1, 2)
    out = np.zeros((len(turns), 6, 6))
    out[:, :3, :3] = rotation
    out[:, 3:, :3] = across @ rotation
    out[:, :3, 3:] = np.swapaxes(out[:, 3:, :3], 1, 2)
    out[:, 3:, 3:] = turns.velocity_covariance + 4.0 / 3.0 * by_rotation
    if not problem.instrument.in_velocities:
        out = out[:, :3, :3]
    if readings is None:
        return out
    assert problem.observations.gyro_block is not None
    free = _free(problem.observations.gyro_block.nominal())
    return _diagonal([out, free @ readings.covariance @ free.T])


def _diagonal(blocks: list[Array]) -> Array:
    """Covariances (N, n, n) joined as blocks on the diagonal."""
    size = sum(b.shape[-1] for b in blocks)
    out, first = np.zeros((len(blocks[0]), size, size)), 0
    for block in blocks:
        last = first + block.shape[-1]
        out[:, first:last, first:last] = block
        first = last
    return out


def weights(problem: Problem, rows: Rows, scatter: Scatter) -> Weights:
    """The weights of the rows from the noise within rests and a scatter."""
    return noise_of(problem, rows).weights(scatter)


# The step


def solve(problem: Problem, rows: Rows, weight: Weights) -> Step:
    """The least-squares step with the attitudes eliminated."""
    turns = problem.observations.turns
    first = np.zeros(0, dtype=np.int64) if turns is None else turns.first
    rest, merged = weight.rest @ rows.rest, weight.merged @ rows.merged(first)
    N, p = len(rest), len(rows.prior) - 1
    factor, triangle = np.empty((N, 3, 7 + p)), rows.prior.copy()
    eliminate(rest, merged, problem.link, problem.link < 0, factor, triangle)
    parameters, covariance = _solved(triangle)
    angles = np.empty((N, 3))
    shared = put_back(factor, problem.link, parameters, covariance, angles)
    return Step(
        parameters=parameters,
        covariance=covariance,
        angles=angles,
        deviance=_deviance(problem, weight, factor, triangle),
        whitened=(rest, merged),
        shared=shared,
    )


def _deviance(problem: Problem, weight: Weights, factor: Array, triangle: Array) -> float:
    """−2 log of the restricted likelihood, less its constant: log |Σ| + log |Aᵀ Σ⁻¹ A| + rᵀ P r."""
    last = weight.rest[problem.link < 0]
    own = sum(-2.0 * np.log(np.diagonal(w, axis1=1, axis2=2)).sum() for w in (last, weight.merged))
    pivots = np.abs(np.concatenate([np.diagonal(factor, axis1=1, axis2=2).ravel(), np.diag(triangle)[:-1]]))
    return float(own + 2.0 * np.log(pivots[pivots > 0.0]).sum() + triangle[-1, -1] ** 2)


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
    rest, merged = step.whitened
    residual, covariance, merged_residual, merged_covariance = left_over(
        rest, merged, problem.link, problem.link < 0, step.angles, step.parameters, (step.covariance, *step.shared)
    )
    return Left(rest=(residual, covariance), merged=(merged_residual, merged_covariance))
