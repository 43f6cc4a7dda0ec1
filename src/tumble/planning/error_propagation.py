"""One pass of a method on a programme: what it leaves of the parameters, to second order in them.

A pass is the method itself (`tumble.methods.paper`) on what sensors with the parameters X observe in attitudes that
deviate from the programme by τ. To be differentiated by central differences it is smooth, and exact to rounding but
for products of Earth's rates in a turn. X are the 21 parameters in the order of the calibration file, b of the
accelerometers over g as angles; τ are three rotations of the table per position, about N, U, E, and three of the
mounting, about X, Y, Z. Of the method `staged` the accelerometers are those of the scalar method, the biases those of
the dot product, and the turns are solved with the Jacobian from the logged rate, §6.6.

A turn is about one geographic axis at a constant rate. With v its rotation vector in the body at the start and
R(s) = exp(s [v_n×]) what has turned of it in the geographic frame, readings compensated by a model are S v + b T plus
those of the Earth's rate, and integrate to

    C = exp([∫ exp(s [w×]) S L₀ᵀ R(s)ᵀ Ω T ds ×]) exp([w×]),   w = S v + b T,   0 ≤ s ≤ 1
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tumble.earth import EARTH_RATE
from tumble.errors import ProgrammeError
from tumble.methods.paper.accelerometers import check_for_vector, scalar_rows
from tumble.methods.paper.four_stages import (
    SCALAR,
    SEQUENTIAL,
    PaperMethod,
    ProgrammeCourse,
    course_of_programme,
    differences,
    one_pass,
)
from tumble.methods.paper.gyros import carried_attitudes, invariant_bias, scalar_bias, triad
from tumble.planning.setup import NAMES
from tumble.programme.positions import Programme
from tumble.rotation import rotation_matrix, rotation_vector_near
from tumble.sensors.model import ACCEL_ANGLES, PERFECT_TRIAD, SensorModel, triad_model, triad_parameters
from tumble.units import Array, IntArray

BudgetedMethod = Literal["sequential", "scalar", "staged"]

BUDGETED_METHODS: tuple[BudgetedMethod, ...] = ("sequential", "scalar", "staged")
"""The methods whose errors are predicted, of instruments with the linear model."""

_METHODS: Mapping[BudgetedMethod, PaperMethod] = {
    "sequential": SEQUENTIAL,
    "scalar": replace(SCALAR, gyro_bias=lambda rate, force, earth, _: scalar_bias(rate, force, earth)),
    "staged": replace(SCALAR, gyro_bias=lambda rate, force, earth, _: invariant_bias(rate, force, earth)),
}

STEP = 1e-4
"""Of the central differences: of angles and scale factors, and of rates in parts of the Earth's."""
STEPS = np.full(len(NAMES), STEP)
STEPS[9:12] *= EARTH_RATE
_ROUNDING = 1e-6
"""What a pass leaves of a parameter relative to another, in units of the steps, is nothing below this."""
_NODES = [(0.5 * (1.0 + node), 0.5 * weight) for node, weight in zip(*np.polynomial.legendre.leggauss(5), strict=True)]
"""Of sums over a turn: nodes within it, and weights."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Plan:
    """A programme as a method uses it: its course, `nominal` attitudes (N, 3, 3), and the known turns after the rests
    `first` (K,) with their rotation vectors `moves` (K, 3), geographic, rad."""

    method: BudgetedMethod
    course: ProgrammeCourse
    nominal: Array
    first: IntArray
    moves: Array


def plan_of(programme: Programme, method: BudgetedMethod, *, turn_rate: float, latitude: float) -> Plan:
    """What a method does with a programme at this rate of the turns, rad/s, and latitude, rad.

    Raises ProgrammeError for a programme without the positions the method needs."""
    nominal = np.array([position.matrix for position in programme.positions])
    if method == "sequential":
        check_for_vector(nominal[:, 1])
    rank = int(np.linalg.matrix_rank(scalar_rows(nominal[:, 1])))
    if rank < 9:
        raise ProgrammeError(
            f"programme {programme.name}: expected positions that determine nine accelerometer parameters, "
            f"found {rank}; take rough-table, nine or cube-26"
        )
    course = course_of_programme(programme, turn_rate=turn_rate, latitude=latitude)
    moves = [m.angle * m.axis for m in programme.moves if m.axis is not None and m.angle is not None]
    return Plan(
        method=method,
        course=course,
        nominal=nominal,
        first=np.array([turn.first for series in course.series for turn in series], dtype=np.int64),
        moves=np.array(moves).reshape(-1, 3),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PlanObservations:
    """What sensors observe of a plan, many cases at once: specific forces over g and rates, rad/s, at rest
    (..., N, 3); `turn` takes a model to the rotations (..., K, 3, 3) integrated about it."""

    force: Array
    rate: Array
    turn: Callable[[SensorModel], Array]


def observed(
    plan: Plan,
    X: Array,
    attitudes: Array,
    *,
    force: Array | float = 0.0,
    rate: Array | float = 0.0,
    drift: Array | float = 0.0,
    turned: Array | float = 0.0,
) -> PlanObservations:
    """What sensors with the parameters X (..., 21) observe in attitudes (..., N, 3, 3), with errors of the forces and
    rates at rest (..., N, 3), of the rates in turns, `drift` (..., K, 3), and of what has `turned` (..., K, 3), rad."""
    accel = triad_model(X[..., :3], X[..., 3:6], X[..., 6:9])
    gyro = triad_model(X[..., 9:12], X[..., 12:15], X[..., 15:])
    T, earth = plan.course.duration[:, None], plan.course.earth_rate
    L0, L1 = (attitudes[..., rests, :, :] for rests in (plan.first, plan.first + 1))
    vector = rotation_vector_near(L1 @ np.swapaxes(L0, -1, -2), plan.moves)
    body = (vector[..., None, :] @ L0)[..., 0, :]
    by_earth = [T * (earth @ (rotation_matrix(node * vector) @ L0)) for node, _ in _NODES]

    def turn(model: SensorModel) -> Array:
        inverse = model.inverse()
        S_t, offset = np.swapaxes(inverse @ gyro.matrix, -1, -2), (gyro.bias - model.bias)[..., None, :] + drift
        w = body @ S_t + T * (offset @ np.swapaxes(inverse, -1, -2))
        ahead = np.zeros_like(w)
        for (node, weight), there in zip(_NODES, by_earth, strict=True):
            ahead += weight * _rotated(node * w, there @ S_t)
        return np.asarray(rotation_matrix(ahead + turned) @ rotation_matrix(w))

    return PlanObservations(
        force=accel.predict(attitudes[..., 1, :]) + force, rate=gyro.predict(earth @ attitudes) + rate, turn=turn
    )


def estimated(plan: Plan, seen: PlanObservations, rows: Array | None = None) -> Array:
    """The parameters (..., 21) that one pass makes of what is seen; those of gyros that the programme does not give are
    zero. `rows` (..., 2K, 9) are those that the turns are solved with, of the programme where None."""
    start, turn = (PERFECT_TRIAD, PERFECT_TRIAD), seen.turn if len(plan.first) else None
    models = one_pass(_METHODS[plan.method], plan.course, (seen.force, seen.rate), turn, np.array(1.0), start, rows)
    (b, k, angles), of_gyro = (triad_parameters(model) for model in models)
    parts = [b, k, angles[..., ACCEL_ANGLES], *of_gyro]
    return np.concatenate([np.broadcast_to(each, (*b.shape[:-1], each.shape[-1])) for each in parts], axis=-1)


def logged_rows(plan: Plan, X: Array, attitudes: Array) -> Array | None:
    """The Jacobian (..., 2K, 9) from the rates that sensors with the parameters X log, §6.6, of the method staged: by
    how much y falls with what the model takes out of the gyros, were the force vertical in the carried attitudes."""
    if plan.method != "staged" or not len(plan.first):
        return None
    course, seen = plan.course, observed(plan, X[..., None, :], attitudes[..., None, :, :, :])
    rests = seen.force, seen.rate
    accel, model = one_pass(_METHODS[plan.method], course, rests, None, np.array(1.0), (PERFECT_TRIAD, PERFECT_TRIAD))
    corrected = accel.apply(seen.force)
    attitude, C, level = triad(corrected, model.apply(seen.rate)), seen.turn(model), corrected.copy()
    for series in course.series:
        L = carried_attitudes(series, attitude, C, course.duration, course.earth_rate)
        level[..., [series[0].first, *(t.last for t in series)], :] = np.stack([each[..., 1, :] for each in L], axis=-2)
    y = []
    for change in (STEP * np.eye(9), -STEP * np.eye(9)):
        other = triad_model(model.bias, change[:, :3], change[:, 3:])
        y.append(differences(course, seen.rate, level, seen.turn(other), other))
    return np.asarray(np.swapaxes(y[1] - y[0], -1, -2) / (2.0 * STEP))


def first_order(plan: Plan) -> tuple[Array, Array]:
    """What one pass leaves of the parameters: T₀ (21, 21) on an exact programme and its derivatives D (3N + 3, 21, 21)
    with respect to the deviations, per rad."""
    N, X = len(plan.nominal), np.concatenate([np.diag(STEPS), -np.diag(STEPS)])
    τ = STEP * np.concatenate([np.eye(3 * N + 3), -np.eye(3 * N + 3), np.zeros((1, 3 * N + 3))])
    table = rotation_matrix(τ[:, : 3 * N].reshape(-1, N, 3))
    attitudes = (table @ plan.nominal @ rotation_matrix(τ[:, None, 3 * N :]))[:, None]
    rows = logged_rows(plan, np.zeros(len(NAMES)), attitudes)
    up, down = np.split(estimated(plan, observed(plan, X, attitudes), rows), 2, axis=1)
    left = np.eye(len(NAMES)) - np.swapaxes(up - down, 1, 2) / (2.0 * STEPS)
    forward, backward, T0 = np.split(left, [3 * N + 3, 6 * N + 6])
    D, nothing = (forward - backward) / (2.0 * STEP), _ROUNDING * STEPS[:, None] / STEPS
    return np.where(np.abs(T0[0]) > nothing, T0[0], 0.0), np.where(np.abs(D) > nothing, D, 0.0)


def second_order(plan: Plan) -> Array:
    """Q (21, 21, 21), symmetric in the first two: the errors q = Σ X_i X_j Q_ij (21,) of second order in the parameters
    that a method makes on an exact programme."""
    i, j = np.triu_indices(len(NAMES))
    single = np.diag(STEPS)
    X = np.concatenate([np.zeros((1, len(NAMES))), single, single[i] + single[j]])
    values = [estimated(plan, observed(plan, x, plan.nominal), logged_rows(plan, x, plan.nominal)) for x in (X, -X)]
    even = 0.5 * (values[0] + values[1])
    of_one, of_two = np.split(even[1:] - even[0], [len(NAMES)])
    Q = np.zeros((len(NAMES),) * 3)
    Q[i, j] = Q[j, i] = 0.5 * (of_two - of_one[i] - of_one[j]) / (STEPS[i] * STEPS[j])[:, None]
    return Q


def _rotated(by: Array, vectors: Array) -> Array:
    """Vectors (..., 3) rotated by rotation vectors (..., 3), Rodrigues."""
    angle, once = np.linalg.norm(by, axis=-1, keepdims=True), np.cross(by, vectors)
    half = np.sinc(0.5 * angle / np.pi)
    return np.asarray(vectors + np.sinc(angle / np.pi) * once + 0.5 * half**2 * np.cross(by, once))
