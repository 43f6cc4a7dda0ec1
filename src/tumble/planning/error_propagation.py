"""One pass of a method on a programme: what it leaves of the parameters, to first and to second order in them.

X are the 21 parameters (the order of the calibration file), b of the accelerometers as angles. To first order a pass
leaves (T₀ + Σ τ_k D_k) X of them, with the deviations τ_k of the attitudes from the programme: `first_order`. On an
exact programme it errs by a quadratic form of X besides: `second_order`. Errors of single observations, as by noise,
go through `estimates`. Symbols are those of `tumble.methods.paper.accuracy_formulas`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from tumble.earth import EARTH_RATE, earth_rate
from tumble.errors import ProgrammeError
from tumble.methods.paper.accuracy_formulas import (
    KnownTurns,
    accelerometer_errors,
    applied,
    dot,
    dot_product_error,
    gyro_matrix_rate_error,
    horizontal_differences,
    indirect_accelerometer_matrix,
    indirect_matrix,
    matrix_error,
    modulus_residual,
    reference_rate_error,
    scalar_residuals,
    solved,
    start_error_growth,
    transposed,
    triad_error,
    turn_bias_error,
    turn_earth_error,
    turn_error,
    turns_of,
)
from tumble.methods.paper.scalar import scalar_rows
from tumble.planning.setup import NAMES
from tumble.programme.positions import Programme
from tumble.rotation import rotation_matrix, rotation_vector_near, unit_vector
from tumble.sensors.model import triad_model
from tumble.units import Array, IntArray

_N, _E = 0, 2
_PAIRS = ((0, 1), (0, 2), (1, 2))
"""The accelerometers between whose axes the angles yx, zx, zy are."""

BudgetedMethod = Literal["sequential", "scalar", "staged"]

BUDGETED_METHODS: tuple[BudgetedMethod, ...] = ("sequential", "scalar", "staged")
"""The methods whose errors the formulas predict, of instruments with the linear model."""


# What the programme's positions and turns are good for


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Plan:
    """A programme as the estimators use it: `nominal` attitudes (N, 3, 3); known turns with their `duration` (K,), s,
    and the programme's matrices (2K, 9) for gyros and accelerometers; rests in which each axis is vertical
    (`standing`) and in which each pair is 45° up and down (`oblique`)."""

    nominal: Array
    turns: KnownTurns | None
    duration: Array
    indirect: Array
    indirect_accel: Array
    standing: tuple[IntArray, ...]
    oblique: tuple[IntArray, ...]
    latitude: float


def plan_of(programme: Programme, method: BudgetedMethod, *, turn_rate: float, latitude: float) -> Plan:
    """What a method does with a programme at this rate of the turns, rad/s, and latitude, rad.

    Raises ProgrammeError for a programme without the positions the method needs."""
    nominal = np.array([position.matrix for position in programme.positions])
    u = nominal[:, 1, :]
    standing = tuple(np.flatnonzero(np.abs(u[:, p]) > 1.0 - _NEAR) for p in range(3))
    oblique = tuple(  # on either side of the horizon in a vertical plane
        np.flatnonzero((np.abs(u[:, p] + u[:, q]) < _NEAR) & (np.abs(u[:, 3 - p - q]) < _NEAR)) for p, q in _PAIRS
    )
    if method == "sequential":
        both = [{*np.sign(u[rests, p])} == {-1.0, 1.0} for p, rests in enumerate(standing)]
        there = dict(zip(("X up and down", "Y up and down", "Z up and down"), both, strict=True))
        pairs = ("X and Y", "X and Z", "Y and Z")
        there |= {f"{pair} 45° up and down": len(rests) > 0 for pair, rests in zip(pairs, oblique, strict=True)}
        missing = [name for name, found in there.items() if not found]
        if missing:
            raise ProgrammeError(
                f"programme {programme.name}: expected rests with {missing[0]} for the method sequential, found none; "
                "take rough-table or nine, or another method"
            )
    rank = int(np.linalg.matrix_rank(scalar_rows(u)))
    if rank < 9:
        raise ProgrammeError(
            f"programme {programme.name}: expected positions that determine nine accelerometer parameters, "
            f"found {rank}; take rough-table, nine or cube-26"
        )
    has_turns = any(move.axis is not None for move in programme.moves)
    turns = turns_of(programme) if has_turns else None
    return Plan(
        nominal=nominal,
        turns=turns,
        duration=np.abs(turns.angle) / turn_rate if turns is not None else np.empty(0),
        indirect=indirect_matrix(programme) if has_turns else np.empty((0, 9)),
        indirect_accel=indirect_accelerometer_matrix(programme) if has_turns else np.empty((0, 9)),
        standing=standing,
        oblique=oblique,
        latitude=latitude,
    )


_NEAR = 1e-6


# What is seen, to first order in the parameters, and what the estimators make of it


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Seen:
    """Errors of what is observed, m cases at once: of the accelerometers at rest over g, `accel` (..., m, N, 3), of the
    gyros at rest, `gyro` (..., m, N, 3), rad/s, and of the attitude over each known turn, `turn` (..., m, K, 3)."""

    accel: Array
    gyro: Array
    turn: Array


def _seen(plan: Plan, attitudes: Array) -> Seen:
    """What each of the 21 parameters, taken as 1, makes the sensors show at these attitudes (..., N, 3, 3)."""
    X = np.eye(len(NAMES))[:, None]
    L = attitudes[..., None, :, :, :]
    E = matrix_error(X[..., 12:15], X[..., 15:])
    gyro = X[..., 9:12] + gyro_matrix_rate_error(L, E, plan.latitude)
    turn = np.zeros((*gyro.shape[:-2], 0, 3))
    if plan.turns is not None:
        start = L[..., plan.turns.first, :, :]
        axis, angle = _rotation_between(start, L[..., plan.turns.last, :, :], plan.turns)
        turn = (
            turn_error(start, axis, angle, E)
            + turn_earth_error(start, axis, angle, plan.duration, E, plan.latitude)
            + turn_bias_error(start, axis, angle, plan.duration, X[..., 9:12])
        )
    return Seen(accel=accelerometer_errors(X[..., :9], L[..., 1, :]), gyro=gyro, turn=turn)


def _rotation_between(start: Array, stop: Array, nominal: KnownTurns) -> tuple[Array, Array]:
    """Axis (..., K, 3) and angle (..., K) of the rotations that lead from one attitude to the other, the way round
    that is nearer to the nominal turn."""
    vector = rotation_vector_near(stop @ transposed(start), nominal.angle[:, None] * nominal.axis)
    return unit_vector(vector), np.linalg.norm(vector, axis=-1)


def estimates(plan: Plan, method: BudgetedMethod, attitudes: Array, seen: Seen) -> Array:
    """What one pass of a method makes of what is seen: parameters (..., m, 21), linear in it. Gyro parameters that the
    programme does not give are zero."""
    L = attitudes[..., None, :, :, :]
    u = L[..., 1, :]
    if method == "sequential":
        accel_values = _sequential_accelerometers(plan, u, seen.accel)
    else:
        accel_values = solved(scalar_rows(u), dot(u, seen.accel))
    accel = seen.accel - accelerometer_errors(accel_values[..., None, :], u)
    bias = _gyro_bias(plan, method, L, accel, seen.gyro)
    if plan.turns is None:
        return np.concatenate([accel_values, bias, np.zeros((*bias.shape[:-1], 9))], axis=-1)
    start = L[..., plan.turns.first, :, :]
    axis, angle = _rotation_between(start, L[..., plan.turns.last, :, :], plan.turns)
    by_bias = turn_bias_error(start, axis, angle, plan.duration, bias[..., None, :])
    unbiased = Seen(accel=accel, gyro=seen.gyro - bias[..., None, :], turn=seen.turn - by_bias)
    matrix = plan.indirect
    if method == "staged":  # with the Jacobian from the logged rate, §6.6: Earth's rate and TRIAD at the start included
        of_gyros = _seen(plan, attitudes)
        of_gyros = Seen(
            accel=np.zeros((9, *of_gyros.accel.shape[-2:])),
            gyro=of_gyros.gyro[..., 12:, :, :],
            turn=of_gyros.turn[..., 12:, :, :],
        )
        matrix = transposed(_differences(plan, L, of_gyros))[..., None, :, :]
    return np.concatenate([accel_values, bias, solved(matrix, _differences(plan, L, unbiased))], axis=-1)


def _sequential_accelerometers(plan: Plan, u: Array, accel: Array) -> Array:
    """Stages 1 and 2: b, k, γ (..., m, 9). TRIAD's cosines are ŵ_p/|ŵ|, so that ŵ_p/g − û_p is û_p (|ŵ|/g − 1)."""
    modulus = dot(u, accel)
    b, k = [], []
    for p, rests in enumerate(plan.standing):
        cosine = u[..., rests, p]
        line = np.stack([np.ones_like(cosine), cosine], axis=-1)
        found = solved(line, cosine * modulus[..., rests])
        b.append(found[..., 0])
        k.append(found[..., 1])
    first = np.stack([*b, *k, *(np.zeros_like(b[0]),) * 3], axis=-1)
    left = accel - accelerometer_errors(first[..., None, :], u)
    return np.concatenate([first[..., :6], _oblique_angles(plan, u, left)], axis=-1)


def _oblique_angles(plan: Plan, u: Array, accel: Array) -> Array:
    """Stage 2, Eq. (10) to first order in the errors at any tilt: γ_yx, γ_zx, γ_zy (..., m, 3)."""
    out = []
    for (p, q), rests in zip(_PAIRS, plan.oblique, strict=True):
        up, uq, ur = u[..., rests, p], u[..., rests, q], u[..., rests, 3 - p - q]
        ep, eq, er = accel[..., rests, p], accel[..., rests, q], accel[..., rests, 3 - p - q]
        out_of_plane = ur * er / (1.0 - ur**2)
        out.append(((ep + up * out_of_plane) / uq + (eq + uq * out_of_plane) / up).mean(axis=-1))
    return np.stack(out, axis=-1)


def _gyro_bias(plan: Plan, method: BudgetedMethod, L: Array, accel: Array, gyro: Array) -> Array:
    """Stage 3: gyro biases (..., m, 3), rad/s."""
    if method == "sequential":
        shown = gyro - reference_rate_error(L, accel, gyro, plan.latitude)
        return np.stack([shown[..., rests, p].mean(axis=-1) for p, rests in enumerate(plan.standing)], axis=-1)
    if method == "scalar":
        polar = applied(transposed(L), np.array(earth_rate(plan.latitude))) / EARTH_RATE
        return solved(polar, dot(polar, gyro))
    u = L[..., 1, :]
    north = dot(L[..., 0, :], accel)
    return solved(u, dot(u, gyro) + dot_product_error(north, plan.latitude))


def _differences(plan: Plan, L: Array, seen: Seen) -> Array:
    """Horizontal differences y (..., m, 2K), north and east of each turn in order. The attitude is TRIAD's at the first
    rest of a series, held in rests and carried through the turns."""
    assert plan.turns is not None
    y = []
    ψ = np.zeros(3)
    for t, (i, j) in enumerate(zip(plan.turns.first, plan.turns.last, strict=True)):
        if plan.turns.opens[t]:
            ψ = triad_error(L[..., i, :, :], seen.accel[..., i, :], seen.gyro[..., i, :], plan.latitude)
        change = start_error_growth(ψ, plan.duration[t], plan.latitude) + seen.turn[..., t, :]
        α = applied(L[..., j, :, :], seen.accel[..., j, :]) - applied(L[..., i, :, :], seen.accel[..., i, :])
        y.append(horizontal_differences(change, α))
        ψ = ψ + change
    return np.concatenate(y, axis=-1)


# What a pass leaves


def first_order(plan: Plan, method: BudgetedMethod) -> tuple[Array, Array]:
    """What one pass leaves of the parameters: T₀ (21, 21) on an exact programme and its derivatives D (3N + 3, 21, 21)
    with respect to the deviations, per rad, by central differences."""
    N = len(plan.nominal)
    step = 1e-4
    τ = step * np.concatenate([np.eye(3 * N + 3), -np.eye(3 * N + 3), np.zeros((1, 3 * N + 3))])
    table = rotation_matrix(τ[:, : 3 * N].reshape(-1, N, 3))
    attitudes = table @ plan.nominal @ rotation_matrix(τ[:, None, 3 * N :])
    left = np.eye(len(NAMES)) - transposed(estimates(plan, method, attitudes, _seen(plan, attitudes)))
    forward, backward, T0 = np.split(left, [3 * N + 3, 6 * N + 6])
    D = (forward - backward) / (2.0 * step)
    return np.where(np.abs(T0[0]) > _ROUNDING, T0[0], 0.0), np.where(np.abs(D) > _ROUNDING / step, D, 0.0)


_ROUNDING = 1e-12
"""What a pass leaves of a parameter relative to another is nothing below this."""


# Errors of second order in the parameters


def second_order(plan: Plan, method: BudgetedMethod, X: Array) -> Array:
    """Errors (..., 21) of second order in the parameters X (..., 21) that a method makes on an exact programme."""
    b, k, γ = X[..., 0:3], X[..., 3:6], X[..., 6:9]
    u = plan.nominal[:, 1, :]
    linearised, orientation = scalar_residuals(u, b[..., None, :], k[..., None, :], γ[..., None, :])
    if method == "sequential":
        along = dot(u, accelerometer_errors(X[..., None, :9], u))
        modulus = linearised - 0.5 * along**2  # |ŵ|/g − 1 in place of the quadratic form
        accel = _sequential_accelerometers(plan, u, modulus[..., None] * u)
        left = np.concatenate([accel[..., :6], np.zeros((*accel.shape[:-1], 3))], axis=-1)
        accel[..., 6:] = -_oblique_angles(plan, u, accelerometer_errors(left[..., None, :], u))
    else:
        accel = solved(scalar_rows(u), linearised + orientation)
    bias = np.zeros((*X.shape[:-1], 3))
    if method == "scalar":
        E = matrix_error(X[..., None, 12:15], X[..., None, 15:])
        error = X[..., None, 9:12] + gyro_matrix_rate_error(plan.nominal, E, plan.latitude)
        polar = transposed(plan.nominal) @ np.array(earth_rate(plan.latitude)) / EARTH_RATE
        bias = solved(polar, modulus_residual(applied(plan.nominal, error)))
    gyro = np.zeros((*X.shape[:-1], 9))
    if plan.turns is not None:
        by_accel = solved(plan.indirect, -applied(plan.indirect_accel, accel))
        beyond = [_turns_beyond(plan.turns, method, sign * X[..., 12:]) for sign in (1.0, -1.0)]
        gyro = solved(plan.indirect, 0.5 * (beyond[0] + beyond[1])) + by_accel  # what is of even order
    return np.concatenate([accel, bias, gyro], axis=-1)


def _turns_beyond(turns: KnownTurns, method: BudgetedMethod, values: Array) -> Array:
    """Differences y (..., 2K) of exact turns without Earth's rate, less those the method's matrix gives.

    In such a turn the rate is constant in the body, and so is what the gyros make of it."""
    k, γ = values[..., :3], values[..., 3:]
    S, E = triad_model(np.zeros(3), k, γ).matrix, matrix_error(k, γ)
    out = []
    computed = turns.start[0]
    for t, (start, stop) in enumerate(zip(turns.start, turns.stop, strict=True)):
        computed = start if turns.opens[t] else computed
        turned = applied(S, start.T @ (turns.axis[t] * turns.angle[t]))
        after = computed @ rotation_matrix(turned)
        found = applied(after, stop[1]) - applied(computed, start[1])
        if method == "staged":
            angle = np.linalg.norm(turned, axis=-1)
            axis = applied(computed, turned) / angle[..., None]
            expected = turn_error(computed, axis, angle, E)
        else:
            expected = turn_error(start, turns.axis[t], turns.angle[t], E)
        out.append(found[..., [_N, _E]] - horizontal_differences(expected, np.zeros(3)))
        computed = after
    return np.concatenate(out, axis=-1)
