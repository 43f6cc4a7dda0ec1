"""Accuracy formulas of the turntable paper for a programme: variances of the parameters after each pass, by source.

Let X be the 21 parameters in the order of the calibration file. After one pass their errors are

    X − X̂ = T X − G n + q(X)         T = T₀ + Σ τ_k D_k

where τ_k are the deviations of the attitudes from the programme, three rotations of the table for each position, about
N, U, E, and three of the mounting, about X, Y, Z; T₀ are the errors on an exact programme (Earth's rate × gyro errors),
n the noise of rests and turns, and q the error of second order in the parameters. The next pass starts from these
errors and leaves T² X. For independent parameters and deviations of zero mean,

    pass 1    E (T X)²_p = Σ_j σ_j² [ T₀² + Σ_k v_k D_k² ]_pj
    pass 2    E (T² X)²_p = Σ_j σ_j² [ (c + tr A)² + Σ_k v_k l_k² + 2 Σ_kl v_k v_l S_kl² + Σ_k (μ_k − 3 v_k²) A_kk² ]_pj

where T² = c + Σ τ_k l_k + Σ τ_k τ_l A_kl, S is the symmetric part of A, tr A = Σ v_k A_kk, and v_k, μ_k are the second
and fourth moments of τ_k. Further passes reduce them as much as the second: (κσ)^i, §7 of the paper.

A pass is the method itself (`tumble.methods.paper`) on the readings of sensors with the parameters X. It is smooth, and
exact to rounding apart from products of Earth's rates in a turn, so that T₀, D, G and q are central differences. A turn
is about one geographic axis at a constant rate. With its rotation vector v in the body at the start, and its part
R(s) = exp(s [v_n×]) at 0 ≤ s ≤ 1 in the geographic frame, readings compensated by a model are S v + b T plus those of
the Earth's rate, and integrate to

    C = exp([∫ exp(s [w×]) S L₀ᵀ R(s)ᵀ Ω T ds ×]) exp([w×]),   w = S v + b T

Source: Vodicheva & Parysheva 2019, the equations that `tumble.methods.paper` names. Its accuracy formulas, one by one,
are in studies/accuracy_formulas.py.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tumble import usual_setup
from tumble.earth import EARTH_RATE, earth_rate
from tumble.inference.noise import CORRELATION_TIME
from tumble.methods.paper.blocks import TRIAD, model_of
from tumble.methods.paper.four_stages import (
    GYRO_TRIAD,
    LARGEST_AZIMUTH,
    SCALAR,
    SEQUENTIAL,
    PaperMethod,
    ProgrammeCourse,
    course_of_programme,
    one_pass,
    shift_by_groups,
    weak_north,
)
from tumble.methods.paper.gyros import axes_and_angles, known_turns
from tumble.planning.bounds import CLOCK, GRAVITY, linearised_course
from tumble.planning.itinerary import itinerary_of
from tumble.planning.setup import GROUPS, MEMBERS, NAMES, Setup, check_setup
from tumble.rotation import rotation_matrix, rotation_vector_near
from tumble.sensors.grades import GRADES
from tumble.sensors.model import ACCEL_ANGLES, PERFECT_TRIAD, SensorModel, triad_parameters
from tumble.units import Array, IntArray

MethodOfPaper = Literal["sequential", "scalar"]
METHODS_OF_PAPER: tuple[MethodOfPaper, ...] = ("sequential", "scalar")
METHODS: Mapping[MethodOfPaper, PaperMethod] = {"sequential": SEQUENTIAL, "scalar": SCALAR}

STEP = 1e-4  # of the central differences: of angles and scale factors, and relative to gravity and Earth's rate
ROUNDING = 1e-6  # smaller errors, relative to the steps, are taken as zero
_NODES = [
    (0.5 * (1.0 + node), 0.5 * weight) for node, weight in zip(*np.polynomial.legendre.leggauss(5), strict=True)
]  # nodes and weights over a turn

_OF_ACCELEROMETERS: Mapping[MethodOfPaper, tuple[str, ...]] = {
    "sequential": (*("up and down, levelled, Eq. (4)",) * 2, "axes 45° up and down, Eq. (10)"),
    "scalar": ("scalar, estimated orientation, Eq. (13)",) * 3,
}
_OF_GYROS = ("vertical axes, Eq. (18)", *("indirect, programme matrix",) * 2)
REST_NOISE = ("accelerometer noise at rest", "gyro noise at rest")  # sources that longer rests reduce


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PaperProgramme:
    """A programme as used by a method of the paper."""

    method: MethodOfPaper
    course: ProgrammeCourse
    nominal: Array  # (N, 3, 3): attitudes, body → geographic
    first: IntArray  # (K,): rests before the known turns
    moves: Array  # (K, 3): their rotation vectors, geographic, rad
    gravity: float

    @staticmethod
    def of(setup: Setup, method: MethodOfPaper) -> PaperProgramme:
        """Return the programme of a set-up; raise ProgrammeError unless it has the positions that the method needs."""
        nominal = np.array([position.matrix for position in setup.programme.positions])
        METHODS[method].check(nominal[:, 1], TRIAD)
        course = course_of_programme(setup.programme, turn_rate=setup.turn_rate, latitude=setup.latitude)
        axes, angles = axes_and_angles(setup.programme)
        return PaperProgramme(
            method=method,
            course=course,
            nominal=nominal,
            first=np.array([turn.first for series in course.series for turn in series], dtype=np.int64),
            moves=angles[:, None] * axes,
            gravity=setup.gravity,
        )

    @property
    def steps(self) -> Array:
        """Steps (21,) of the differences of the parameters."""
        steps = np.full(len(NAMES), STEP)
        steps[:3] *= self.gravity
        steps[9:12] *= EARTH_RATE
        return steps

    def estimated(
        self,
        X: Array,
        attitudes: Array,
        *,
        force: Array | float = 0.0,
        rate: Array | float = 0.0,
        drift: Array | float = 0.0,
        turned: Array | float = 0.0,
    ) -> Array:
        """Return the parameters (..., 21) after one pass; zero for gyro parameters that are not determined.

        Sensors have the parameters X (..., 21) and attitudes (..., N, 3, 3). Errors are `force` and `rate` at rest
        (..., N, 3), `drift` of the rates in turns (..., K, 3), and `turned` of the rotations (..., K, 3), rad."""
        accel, gyro = model_of(TRIAD, X[..., :9]), model_of(GYRO_TRIAD, X[..., 9:])
        T, earth = self.course.duration[:, None], self.course.earth_rate
        L0, L1 = (attitudes[..., rests, :, :] for rests in (self.first, self.first + 1))
        vector = rotation_vector_near(L1 @ np.swapaxes(L0, -1, -2), self.moves)
        body = (vector[..., None, :] @ L0)[..., 0, :]
        by_earth = [T * (earth @ (rotation_matrix(node * vector) @ L0)) for node, _ in _NODES]

        def turn(model: SensorModel) -> Array:
            inverse = model.inverse()
            S_t, offset = np.swapaxes(inverse @ gyro.matrix, -1, -2), (gyro.bias - model.bias)[..., None, :] + drift
            w = body @ S_t + T * (offset @ np.swapaxes(inverse, -1, -2))
            ahead = np.zeros_like(w)
            for (node, weight), there in zip(_NODES, by_earth, strict=True):
                ahead += weight * (rotation_matrix(node * w) @ (there @ S_t)[..., None])[..., 0]
            return np.asarray(rotation_matrix(ahead + turned) @ rotation_matrix(w))

        rests = accel.predict(self.gravity * attitudes[..., 1, :]) + force, gyro.predict(earth @ attitudes) + rate
        start, integrated = (PERFECT_TRIAD, PERFECT_TRIAD), turn if len(self.first) else None
        models = one_pass(METHODS[self.method], self.course, rests, integrated, np.array(self.gravity), start)
        (b, k, angles), of_gyro = (triad_parameters(model) for model in models)
        parts = [b, k, angles[..., ACCEL_ANGLES], *of_gyro]
        units = np.broadcast_shapes(*(each.shape[:-1] for each in parts))
        return np.concatenate([np.broadcast_to(each, (*units, each.shape[-1])) for each in parts], axis=-1)

    def first_order(self) -> tuple[Array, Array]:
        """Return the errors after one pass per unit of the parameters: T₀ (21, 21) on an exact programme, and its
        derivatives D (3N + 3, 21, 21) by the deviations, per rad."""
        N, steps = len(self.nominal), self.steps
        X = np.concatenate([np.diag(steps), -np.diag(steps)])
        τ = STEP * np.concatenate([np.eye(3 * N + 3), -np.eye(3 * N + 3), np.zeros((1, 3 * N + 3))])
        table = rotation_matrix(τ[:, : 3 * N].reshape(-1, N, 3))
        attitudes = (table @ self.nominal @ rotation_matrix(τ[:, None, 3 * N :]))[:, None]
        up, down = np.split(self.estimated(X, attitudes), 2, axis=1)
        errors = np.eye(len(NAMES)) - np.swapaxes(up - down, 1, 2) / (2.0 * steps)
        forward, backward, T0 = np.split(errors, [3 * N + 3, 6 * N + 6])
        D, least = (forward - backward) / (2.0 * STEP), ROUNDING * steps[:, None] / steps
        return np.where(np.abs(T0[0]) > least, T0[0], 0.0), np.where(np.abs(D) > least, D, 0.0)

    def second_order(self) -> Array:
        """Return Q (21, 21, 21), symmetric in i and j, of the errors q = Σ X_i X_j Q_ij (21,) of second order after a
        pass on an exact programme."""
        (i, j), steps = np.triu_indices(len(NAMES)), self.steps
        single = np.diag(steps)
        X = np.concatenate([np.zeros((1, len(NAMES))), single, single[i] + single[j]])
        even = 0.5 * (self.estimated(X, self.nominal) + self.estimated(-X, self.nominal))
        of_one, of_two = np.split(even[1:] - even[0], [len(NAMES)])
        Q = np.zeros((len(NAMES),) * 3)
        Q[i, j] = Q[j, i] = 0.5 * (of_two - of_one[i] - of_one[j]) / (steps[i] * steps[j])[:, None]
        return Q


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PassErrors:
    """Errors of the parameters after passes of a method; matrices (21, 21) convert variances of parameters to them."""

    setup: Setup
    method: MethodOfPaper
    estimators: Mapping[str, str]
    """How each group is determined that the programme determines; without known turns, gyro scale factors and angles
    are not."""
    exact: Array  # after the first pass, on an exact programme
    by_table: Array  # by table errors
    by_mounting: Array  # by mounting errors
    twice: tuple[Array, Array, Array]  # after the second pass, with the 0th, 2nd and 4th power of the deviations
    second_order: Array  # (21,): variances of second order in the parameters
    noise: Mapping[str, Array]  # variances (21,) by source
    spread: Array  # (21,): standard deviations of the parameters

    @staticmethod
    def of(setup: Setup, method: MethodOfPaper) -> PassErrors:
        """Return the errors of a method on the programme of a set-up; raise ProgrammeError unless it has the positions
        that the method needs."""
        check_setup(setup)
        plan = PaperProgramme.of(setup, method)
        groups = GROUPS if len(plan.first) else GROUPS[:4]
        T0, D = plan.first_order()
        table = 3 * len(plan.nominal)
        width = np.repeat([setup.table_error, setup.mounting_error], [table, 3])
        v, fourth = width**2 / 3.0, width**4 / 5.0  # uniform
        sizes = [(each.bias, each.scale, each.axis) for each in (setup.accel, setup.gyro)]
        spread = np.repeat(np.ravel(sizes), [3, 3, 3, 3, 3, 6])
        # T² = c + Σ τ_k l_k + Σ τ_k τ_l A_kl
        c, linear = T0 @ T0, T0 @ D + D @ T0
        A = np.einsum("kpj,ljq->klpq", D, D)
        S, diagonal = 0.5 * (A + A.swapaxes(0, 1)), np.einsum("kkpq->kpq", A)
        trace = np.tensordot(v, diagonal, axes=1)
        square = trace**2 + 2.0 * np.einsum("k,l,klpq->pq", v, v, S**2, optimize=True)
        square += np.tensordot(fourth - 3.0 * v**2, diagonal**2, axes=1)
        # q(X) = Xᵀ Q X, with the mean square (tr Q)² + 2 Σ Q_ij² for independent Gaussian X of unit spread
        Q = np.outer(spread, spread)[:, :, None] * plan.second_order()
        return PassErrors(
            setup=setup,
            method=method,
            estimators=dict(zip(groups, (*_OF_ACCELEROMETERS[method], *_OF_GYROS), strict=False)),
            exact=T0**2,
            by_table=np.tensordot(v[:table], D[:table] ** 2, axes=1),
            by_mounting=np.tensordot(v[table:], D[table:] ** 2, axes=1),
            twice=(c**2, 2.0 * c * trace + np.tensordot(v, linear**2, axes=1), square),
            second_order=np.trace(Q) ** 2 + 2.0 * (Q**2).sum(axis=(0, 1)),
            noise=_noise(setup, plan) | _omitted_groups(setup, method),
            spread=spread,
        )

    def methodical(self, iteration: int, scale: float = 1.0) -> dict[str, Array]:
        """Return the variances (21,) after a number of passes by source, without noise, with table and mounting errors
        multiplied by `scale`."""
        if iteration == 1:
            return {
                **self._by_group("{} × table error", scale**2 * self.by_table),
                **self._by_group("{} × mounting error", scale**2 * self.by_mounting),
                **self._by_group("{} × Earth's rate", self.exact),
                "second order in the parameters": self.second_order,
            }
        fixed, linear, square = self.twice
        second = self._by_group("{} left by the pass before", fixed + scale**2 * linear + scale**4 * square)
        if iteration == 2:
            return second
        gain, first = np.zeros(len(NAMES)), np.sum([*self.methodical(1, scale).values()], axis=0)
        for members in MEMBERS.values():
            before = float(np.mean(first[members]))
            gain[members] = np.mean(np.sum([*second.values()], axis=0)[members]) / before if before > 0.0 else 0.0
        return {name: gain ** (iteration - 2) * variance for name, variance in second.items()}

    def of_group(self, group: str, variances: Mapping[str, Array]) -> dict[str, float]:
        """Return the mean variances of a group, SI, by source."""
        members = MEMBERS[group]
        return {name: float(np.mean(v[members])) for name, v in variances.items()}

    def _by_group(self, name: str, matrix: Array) -> dict[str, Array]:
        """Return the variances (21,) by each group of parameters through a matrix."""
        return {name.format(g): matrix[:, places] @ self.spread[places] ** 2 for g, places in MEMBERS.items()}


def remarks(setup: Setup) -> Iterator[str]:
    """Yield sentences on the validity of the formulas for a set-up."""
    rate = math.hypot(setup.gyro.bias, setup.noise.gyro_white / math.sqrt(setup.rest), setup.noise.gyro_instability)
    north = earth_rate(setup.latitude)[0]
    if rate > LARGEST_AZIMUTH * north:
        yield (
            f"{weak_north(rate, north)}: the methods sequential and scalar do worse in gyro parameters than predicted, "
            "take joint"
        )


def _omitted_groups(setup: Setup, method: MethodOfPaper) -> dict[str, Array]:
    """Return the variances (21,) by omitted groups; without known turns, of the accelerometers alone."""
    if not setup.further:
        return {}
    noisy = replace(setup, noise=GRADES[usual_setup.GRADE].noise)  # of any size, as the shift does not depend on it
    observations = linearised_course(itinerary_of(noisy), noisy, gyros=True).problem.observations
    observations = observations if known_turns(setup.programme) else observations.of_accelerometers()
    problem, shift = shift_by_groups(observations, METHODS[method])
    first, variances = problem.instrument.linear_count, np.zeros((len(NAMES), shift.shape[1]))
    variances[: len(shift)] = (shift * problem.usual_u[1 + first :]) ** 2
    groups = problem.instrument.members.items()
    return {name: variances[:, members.start - first : members.stop - first].sum(axis=1) for name, members in groups}


def _noise(setup: Setup, plan: PaperProgramme) -> dict[str, Array]:
    """Return the variances (21,) of the parameters by each source of noise, by gravity and by the time base, on an
    exact programme."""
    N, K, noise, g = len(plan.nominal), len(plan.first), setup.noise, setup.gravity
    rest, turn = np.eye(3 * N).reshape(3 * N, N, 3), np.eye(3 * K).reshape(3 * K, K, 3)

    def gains(step: float, **errors: Array) -> Array:
        """Return the errors of the parameters (m, 21) by unit errors of readings."""
        signed = ({name: sign * step * error for name, error in errors.items()} for sign in (1.0, -1.0))
        high, low = (plan.estimated(np.zeros(len(NAMES)), plan.nominal, **each) for each in signed)
        return np.asarray((high - low) / (2.0 * step))

    correlation = np.exp(-np.abs(np.subtract.outer(*[itinerary_of(setup).rests[:, 0]] * 2)) / CORRELATION_TIME)

    def by_in_run(gains: Array, bias: str) -> Array:
        """Return the variances (21,) by in-run biases of unit variance from the gains (3N, 21); a `bias` is about its
        mean over the session."""
        of_rests = gains.reshape(N, 3, -1).copy()
        of_rests[:, np.arange(3), MEMBERS[bias]] -= 1.0 / N
        return np.asarray(np.einsum("icp,ij,jcp->p", of_rests, correlation, of_rests))

    by_accel, by_gyro = gains(STEP * g, force=rest), gains(STEP * EARTH_RATE, rate=rest)
    by_turn = gains(STEP, turned=turn) if K else np.zeros((0, len(NAMES)))
    between = 0.5 * (rest[:, plan.first] + rest[:, plan.first + 1])  # the bias in a turn: mean of those at its ends
    by_change = gains(STEP * EARTH_RATE, rate=rest, drift=between)
    accel_scale, gyro_scale = (np.isin(np.arange(len(NAMES)), MEMBERS[f"{kind}.scale"]) for kind in ("accel", "gyro"))
    return {
        REST_NOISE[0]: (by_accel**2).sum(axis=0) * noise.accel_white**2 / setup.rest,
        REST_NOISE[1]: (by_gyro**2).sum(axis=0) * noise.gyro_white**2 / setup.rest,
        "gyro noise in turns": np.repeat(plan.course.duration, 3) @ by_turn**2 * noise.gyro_white**2,
        "accelerometer instability": by_in_run(by_accel, "accel.bias") * noise.accel_instability**2,
        "gyro instability": by_in_run(by_change, "gyro.bias") * noise.gyro_instability**2,
        GRAVITY: accel_scale * (setup.gravity_u / g) ** 2,
        CLOCK: gyro_scale * setup.clock_u**2,
    }
