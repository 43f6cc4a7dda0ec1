"""What accuracy a set-up gives, and what set-up an accuracy needs: the paper's error formulas and their inverse.

First come the formulas, one function each, as Vodicheva & Parysheva (Giroskopiya i Navigatsiya 27, 2(105), 2019)
number them, with the corrections of the turntable method (§ are its sections). Then `budget`: the same formulas put
together for a whole programme. Then `require`: from wanted errors back to tolerances and rest durations.

How the budget is put together. Let X be the 21 parameters (the order of the calibration file). To first order in X
one pass of a method is a matrix, so that it leaves

    X − X̂ = T X − G n + q(X)         T = T₀ + Σ τ_k D_k

of the parameters: τ_k are the deviations of the attitudes from the programme (table: three per position, about N, U,
E; mounting: three, about X, Y, Z), T₀ what an exact programme leaves (Earth's rate × gyro errors), n the noise of
rests and turns, q the error of second order in the parameters. The next pass sees what is left, so that it leaves
T² X. With parameters and deviations independent of each other and of zero mean,

    pass 1    E (T X)²_p = Σ_j σ_j² [ T₀² + Σ_k v_k D_k² ]_pj
    pass 2    E (T² X)²_p = Σ_j σ_j² [ (c + tr A)² + Σ_k v_k l_k² + 2 Σ_kl v_k v_l S_kl² + Σ_k (μ_k − 3 v_k²) A_kk² ]_pj

where T² = c + Σ τ_k l_k + Σ τ_k τ_l A_kl, S is the symmetric part of A, tr A = Σ v_k A_kk, and v_k, μ_k are the second
and fourth moments of τ_k. Further passes gain as much as the second did: (κσ)^i, §7.

Symbols: b = δw/g, bias of an accelerometer as an angle, rad; k, γ scale-factor error and axis angles; M, E matrix
errors of accelerometers and gyros; u vertical in the body; L attitude body → geographic N, U, E; ψ attitude error,
L̂ = (I + [ψ×]) L; Γ_pq = γ_pq + γ_qp. Arrays of vectors have the components last.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Literal

import numpy as np

from tumble.earth import EARTH_RATE, earth_rate
from tumble.errors import InputError, ProgrammeError
from tumble.model import Block
from tumble.programme import Programme
from tumble.programme import programme as built_in
from tumble.rotation import axes_matrix, rotation_matrix
from tumble.units import ARCSEC, DEGREE, DEGREE_PER_HOUR, Array, IntArray

_N, _U, _E = 0, 1, 2
_UP = np.array([0.0, 1.0, 0.0])
_ACCEL = Block(kind="accel", axes=np.eye(3))
_GYRO = Block(kind="gyro", axes=np.eye(3))
_ACCEL_PAIRS = ((1, 0), (2, 0), (2, 1))
_GYRO_PAIRS = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))

NAMES = _ACCEL.names + _GYRO.names
"""The 21 parameters, in the order of the calibration file."""

GROUPS = ("accel.bias", "accel.scale", "accel.axis", "gyro.bias", "gyro.scale", "gyro.axis")
"""The groups of parameters, in the order of the calibration file."""


# -------------------- bias and scale factor of an accelerometer --------------------


def levelling_scale_error(readings: Array, angles: Array, angle_errors: Array, gravity: float) -> Array:
    """Error Δk (...) of the scale factor from readings (..., 2), m/s², at two angles to the vertical (..., 2), rad,
    that are wrong by `angle_errors` (..., 2), rad (estimated − true). Eq. (5)."""
    w, a, d = np.asarray(readings), np.asarray(angles), np.asarray(angle_errors)
    sines = np.sin(a) * d
    cosines = np.cos(a[..., 0]) - np.cos(a[..., 1])
    return np.asarray((w[..., 0] - w[..., 1]) * (sines[..., 0] - sines[..., 1]) / (gravity * cosines**2))


def levelling_bias_error(readings: Array, angles: Array, angle_errors: Array) -> Array:
    """Error Δδw (...), m/s², of the bias from readings at two angles that are wrong; shapes as in
    `levelling_scale_error`. Eq. (6)."""
    w, a, d = np.asarray(readings), np.asarray(angles), np.asarray(angle_errors)
    crossed = np.sin(a) * np.cos(a[..., ::-1]) * d
    cosines = np.cos(a[..., 1]) - np.cos(a[..., 0])
    return np.asarray((w[..., 1] - w[..., 0]) * (crossed[..., 0] - crossed[..., 1]) / cosines**2)


def assumed_vertical_errors(tilts: Array, gravity: float, scale: float = 0.0) -> tuple[Array, Array]:
    """Errors Δk (...) and Δδw (...), m/s², when an axis up and down is taken for exactly vertical though it is tilted
    by `tilts` (..., 2), rad: of second order in the tilts, and no iteration helps.

    Source: after Eq. (6), where the signs are not legible: both errors have a minus."""
    first, second = np.asarray(tilts)[..., 0] ** 2, np.asarray(tilts)[..., 1] ** 2
    return -0.25 * (first + second) * (1.0 + scale), -0.25 * gravity * (first - second) * (1.0 + scale)


def up_down_errors(axis: int, up: Array, down: Array, bias: Array, angles: Array) -> tuple[Array, Array]:
    """Errors Δk (...) and Δδw/g (...), rad, of accelerometer `axis` from a rest with its axis up and one with it down,
    levelled by the readings (TRIAD). Eq. (7a).

    `up`, `down` (..., 3): the vertical in the body in the two rests; `bias` (..., 3): b, rad; `angles` (..., 3):
    γ_yx, γ_zx, γ_zy, rad. Both errors are parameter × tilt: the levelling error b_q + γ_qp of each horizontal
    accelerometer q, and the axis' own lean γ_pq, which the paper leaves out."""
    u1, u2, b, lean = np.asarray(up), np.asarray(down), np.asarray(bias), _angle_sums(angles)[..., axis, :]
    horizontal = np.arange(3) != axis
    total, difference = u1 + u2, u1 - u2
    scale = 0.5 * ((total * b + difference * lean) @ horizontal)
    return np.asarray(scale), np.asarray(0.5 * ((difference * b + total * lean) @ horizontal))


def up_down_rms(tilt: float, bias: float, angle: float, correlation: float = 0.0) -> tuple[float, float]:
    """Rms of Δk and of Δδw/g, rad, for uncorrelated parameters: the same for the three axes. Eq. (7b).

    `tilt`: rms deviation per horizontal axis, rad; `correlation` of it between up and down (−1 for an error of the
    mounting); `bias`, `angle`: rms of b and γ, rad."""
    more, less = 1.0 + correlation, 1.0 - correlation
    scale = tilt * math.sqrt(more * bias**2 + less * angle**2)
    return scale, tilt * math.sqrt(less * bias**2 + more * angle**2)


def paper_up_down_rms(largest_tilt: float, bias: float, angle: float) -> Array:
    """Rms of Δk = rms of Δδw/g (3,) of the X, Y, Z accelerometer as the paper prints it. Eq. (7).

    `largest_tilt`, rad, in place of an rms makes it a bound, but it lacks the lean of the axis itself: with small
    biases and an error of the mounting Z errs up to six times more. Use `up_down_rms`."""
    return largest_tilt * np.sqrt(bias**2 + np.array([1.0, 0.5, 0.0]) * angle**2)


def two_position_matrix(angles: Array) -> Array:
    """Matrix (..., 2, 2) of Eq. (3) for the unknowns g(1 + k), δw at two angles (..., 2) to the vertical, rad. Up and
    down has the largest determinant (2 in size) and condition number 1."""
    cosines = np.cos(np.asarray(angles))
    return np.stack([cosines, np.ones_like(cosines)], axis=-1)


# -------------------- angles between accelerometer axes --------------------


def angle_variance(first: Array, second: Array, scale_variance: float, bias_variance: float) -> Array:
    """Variance, rad², of the angle between two axes in a vertical plane at the angles `first` and `second`, rad, to
    the vertical, from the variances of k and of b (rad²) of both. Eq. (9)."""
    sines = np.sin(first) ** -2.0 + np.sin(second) ** -2.0
    return np.asarray((sines - 2.0) * scale_variance + sines * bias_variance)


def best_elevations(angle: float) -> tuple[float, float]:
    """Angles to the vertical, rad, at which the variance (9) of the angle between two axes is least: symmetric about
    the horizon up to π/2, about the vertical beyond (the inequalities are not legible in the paper)."""
    middle = 0.5 * math.pi if angle <= 0.5 * math.pi else 0.0
    return middle - 0.5 * angle, middle + 0.5 * angle


def axis_angle_error(tilt: Array, turn: Array, bias: Array, scale: Array, angle_sums: Array) -> Array:
    """Error Δφ (...), rad, of the angle between axes ξ (45° above) and η (45° below the horizon) by Eq. (10), of first
    order in the parameters and in `tilt` a, of any order in `turn` c. The axis angle errs by −Δφ. Eq. (11) in general.

    a: rotation about the line where their plane meets the horizon, rad, so that u_ζ = sin a; c: rotation in their
    plane; `bias` (..., 3): b of ξ, η, ζ; `scale` (..., 2): k of ξ, η; `angle_sums` (..., 2): Γ_ζξ, Γ_ζη, rad."""
    first, second = 0.25 * np.pi + np.asarray(turn), 0.75 * np.pi + np.asarray(turn)
    b, k, lean = np.asarray(bias), np.asarray(scale), np.asarray(angle_sums)
    third = tilt * (b[..., 2] + lean[..., 0] * np.cos(first) + lean[..., 1] * np.cos(second))
    above = ((k[..., 0] + third) * np.cos(first) + b[..., 0]) / np.sin(first)
    return np.asarray(above - ((k[..., 1] + third) * np.cos(second) + b[..., 1]) / np.sin(second))


def axis_angle_error_45(tilt: Array, turn: Array, bias: Array, scale: Array, angle_sums: Array) -> Array:
    """As `axis_angle_error`, of first order in `turn` as well: Eq. (11).

    The first three groups agree with what is legible in the paper; the terms with γ and with `turn` are derived."""
    b, k, lean = np.asarray(bias), np.asarray(scale), np.asarray(angle_sums)
    root = math.sqrt(2.0)
    exact = k[..., 0] + k[..., 1] + root * (b[..., 0] - b[..., 1])
    tilted = 2.0 * tilt * (b[..., 2] + (lean[..., 0] - lean[..., 1]) / root)
    turned = 2.0 * turn * (k[..., 0] - k[..., 1]) + root * turn * (b[..., 0] + b[..., 1])
    return np.asarray(exact + tilted - turned)


def axis_angle_rms(tilt: float, bias: float, angle: float) -> float:
    """Rms error, rad, of an axis angle after stages 1 and 2, when k and b have been found from one pair of rests up
    and down each: what (7b) leaves of them goes through (11). §7; arguments as in `up_down_rms`."""
    return tilt * math.sqrt(6.0 * (bias**2 + angle**2) + 4.0 * angle**2)


# -------------------- the scalar method --------------------


def scalar_matrix(verticals: Array) -> Array:
    """Matrix H (..., N, 9) of the scalar method for verticals u (..., N, 3) in the body: Eq. (13). The unknowns are
    b (3), k (3), γ_yx, γ_zx, γ_zy."""
    u = np.asarray(verticals)
    return np.concatenate([u, u**2, u[..., [1, 2, 2]] * u[..., [0, 0, 1]]], axis=-1)


def coefficient_error(matrix: Array, matrix_error: Array, parameters: Array) -> Array:
    """Error ΔX (9,) of the scalar method when H (N, 9) is taken wrong by δH (N, 9): Eq. (14)."""
    return np.asarray(-np.linalg.pinv(matrix) @ (matrix_error @ parameters))


def scalar_residuals(vertical: Array, bias: Array, scale: Array, angles: Array) -> tuple[Array, Array]:
    """What (ŵ² − g²)/2g² − h(û) X is at a rest, to second order in the parameters (..., 3), in two parts (...): from
    linearising Eqs. (1) and (12), and from the estimated orientation û = ŵ/|ŵ| in h. §4; b and γ in rad.

    With (|ŵ| − g)/g in place of the quadratic form the first part has the square of e across the vertical only."""
    u = np.asarray(vertical)
    M = _accel_matrix_error(scale, angles)
    e = bias + _apply(M, u)
    across = e - u * _dot(u, e)[..., None]
    linearisation = 0.5 * _dot(e, e) + _dot(u, _apply(_second_order_matrix(scale, angles), u))
    return linearisation, -_dot(across, across) - _dot(_apply(_transposed(M), u), across)


def orientation_scale_error(bias: Array, angles: Array) -> Array:
    """The part of the scalar method's error Δk (..., 3) that comes from the estimated orientation, for the nine
    positions. Eq. (15), and with the γ² that the paper leaves out though they are of the same size."""
    b2, g2 = np.asarray(bias) ** 2, np.asarray(angles) ** 2
    others = b2.sum(axis=-1, keepdims=True) - b2
    leans = np.stack([g2[..., 0] + g2[..., 1], g2[..., 2], np.zeros(g2.shape[:-1])], axis=-1)
    return np.asarray(-(others + leans))


def scalar_scale_error(bias: Array, scale: Array, angles: Array) -> Array:
    """The whole error Δk (..., 3) of the scalar method with estimated orientation for the nine positions, of second
    order in the parameters: Eq. (15) with the linearisation errors, §4."""
    b2, k2, g2 = np.asarray(bias) ** 2, np.asarray(scale) ** 2, np.asarray(angles) ** 2
    others = b2.sum(axis=-1, keepdims=True) - b2
    yx, zx, zy = np.moveaxis(g2, -1, 0)
    leans = np.stack([yx + zx, zy + yx, zx + zy], axis=-1)
    return np.asarray(0.5 * (b2 + k2 - others - leans))


# -------------------- gyro biases --------------------


def triad_error(attitude: Array, accel_error: Array, gyro_error: Array, latitude: float) -> Array:
    """Attitude error ψ (..., 3), rad, about N, U, E, of TRIAD with the vertical as base vector at a rest.

    `attitude` (..., 3, 3) body → geographic; `accel_error` (..., 3): reading − true over g; `gyro_error` (..., 3):
    reading − true, rad/s, both in the body. §5, before Eq. (16)."""
    north, up, _ = earth_rate(latitude)
    a, d = _apply(attitude, accel_error), _apply(attitude, gyro_error)
    return np.stack([-a[..., _E], d[..., _E] / north - a[..., _E] * up / north, a[..., _N]], axis=-1)


def reference_rate_error(attitude: Array, accel_error: Array, gyro_error: Array, latitude: float) -> Array:
    """Error (..., 3), rad/s, of the Earth's rate in the body as TRIAD gives it: Eq. (16). The bias found is the true
    one less this. Arguments as in `triad_error`; the accelerometers' error to the east cancels."""
    north, up, _ = earth_rate(latitude)
    a, d = _apply(attitude, accel_error), _apply(attitude, gyro_error)
    error = np.stack([up * a[..., _N], -north * a[..., _N], d[..., _E]], axis=-1)
    return _apply(_transposed(attitude), error)


def polar_axis_error(deviation: Array, accel_north: Array, gyro_east: Array, latitude: float) -> Array:
    """Error (...), rad/s, of the Earth's rate along a gyro set along the Earth's axis. Eq. (17).

    `deviation` (..., 3): rotation of the body from there about N, U, E, rad; `accel_north` (...): accelerometer error
    to the north over g; `gyro_east` (...): gyro error to the east, rad/s, both of the body as it stands.
    `azimuth_nonlinearity` comes on top."""
    north, azimuth, east = np.moveaxis(np.asarray(deviation), -1, 0)
    across = north * math.sin(latitude) - azimuth * math.cos(latitude)
    return np.asarray(-east * EARTH_RATE * accel_north + gyro_east * across)


def azimuth_nonlinearity(gyro_east: Array) -> Array:
    """What Eq. (17) lacks, rad/s: TRIAD's azimuth error δω_E/Ω cos B shortens the Earth's rate along its own axis by
    δω_E²/2Ω. It is 0.17, 1.8, 5.9 % of a bias of 0.03, 0.3, 1 °/h (rms), whatever the table."""
    return np.asarray(-(np.asarray(gyro_east) ** 2) / (2.0 * EARTH_RATE))


def vertical_axis_error(deviation: Array, accel_north: Array, gyro_east: Array, latitude: float) -> Array:
    """Error (...), rad/s, of the Earth's rate along a gyro set vertical. Eq. (18); arguments as in
    `polar_axis_error`. An error of azimuth is of second order."""
    north, _, east = np.moveaxis(np.asarray(deviation), -1, 0)
    level = math.cos(latitude) + east * math.sin(latitude)
    return np.asarray(-EARTH_RATE * level * accel_north + north * gyro_east)


def modulus_residual(gyro_error: Array) -> Array:
    """(ω̂² − Ω²)/2Ω − û^Ω·δω (...), rad/s, at a rest, for gyro errors (..., 3) resolved in N, U, E: what the scalar
    method leaves of second order, estimated orientation included. §5. It cancels over a symmetric programme."""
    north, up, east = np.moveaxis(np.asarray(gyro_error), -1, 0)
    return np.asarray((north**2 + up**2 - east**2) / (2.0 * EARTH_RATE))


def dot_product_error(accel_north: Array, latitude: float) -> Array:
    """û·ω̂ − Ω sin B − û·δω (...), rad/s, at a rest: Ω cos B times the accelerometer error to the north over g. §5.
    Nothing else is left of first order, and no azimuth is needed."""
    return np.asarray(earth_rate(latitude)[0] * np.asarray(accel_north))


def gyrocompass_error(accel_error: Array, azimuth: Array, turn_error: Array, latitude: float) -> Array:
    """Error (...), rad/s, of the bias of a horizontal gyro from two rests with a turn by 180° + `turn_error` (rad)
    about the vertical. `accel_error`: error over g of the accelerometer along it; `azimuth`, rad: of its axis before
    the turn, right-handed about U from north. §5. A turn that is off by 1.5° costs half a bias of 0.3 °/h."""
    north, up, _ = earth_rate(latitude)
    return np.asarray(-up * np.asarray(accel_error) + 0.5 * north * np.sin(azimuth) * turn_error)


def gyro_matrix_rate_error(attitude: Array, matrix_error: Array, latitude: float) -> Array:
    """Gyro error E Lᵀ Ω (..., 3), rad/s, in the body, that scale-factor and axis errors E (..., 3, 3) cause at rest:
    stage 3 takes it for bias before stage 4 has found E.

    The vector method sees of it what lies in the meridian plane (the part to the east turns TRIAD's azimuth), the
    scalar method the part along Ω, the dot product the part along the vertical. For E of 1e-4 it is 1.5e-3 °/h, one
    or two orders less than the bias, as the paper says; up and down it cancels but for E_pq × tilt."""
    L = np.asarray(attitude)
    return _apply(matrix_error, _apply(_transposed(L), np.array(earth_rate(latitude))))


# -------------------- scale factors and axis angles of the gyros: the indirect method --------------------


def turn_error(attitude: Array, axis: Array, angle: Array, matrix_error: Array) -> Array:
    """Attitude error Δψ (..., 3), rad, about N, U, E, that gyro scale-factor and axis errors E (..., 3, 3) make in a
    turn by `angle` (..., rad, signed) about the geographic unit vector `axis` (..., 3) from `attitude` (..., 3, 3):
    Eq. (6.2). Any rate profile gives the same."""
    L, n = np.asarray(attitude), np.asarray(axis)
    Fn = _apply(L, _apply(matrix_error, _apply(_transposed(L), n)))
    return _swept(n, angle, Fn)


def turn_bias_error(attitude: Array, axis: Array, angle: Array, duration: Array, bias: Array) -> Array:
    """Attitude error Δψ (..., 3), rad, that gyro biases (..., 3), rad/s, make in a turn of `duration` (...), s, at
    constant rate; other arguments as in `turn_error`. §6.2."""
    per_radian = np.asarray(duration) / np.asarray(angle)
    return _swept(np.asarray(axis), angle, _apply(attitude, bias)) * per_radian[..., None]


def turn_earth_error(
    attitude: Array, axis: Array, angle: Array, duration: Array, matrix_error: Array, latitude: float
) -> Array:
    """Attitude error Δψ (..., 3), rad, that the Earth's rate times gyro errors E makes in a turn at constant rate, of
    order ΩT E: what the programme's matrix (6.3) leaves out. Arguments as in `turn_error`. §6.2."""
    L, n = np.asarray(attitude), np.asarray(axis)
    F = L @ matrix_error @ _transposed(L)
    earth = np.array(earth_rate(latitude))
    total = np.zeros(np.broadcast_shapes(F.shape[:-1], n.shape))
    for node, weight in zip(*_LEGENDRE, strict=True):
        R = rotation_matrix(np.asarray(0.5 * (1.0 + node) * np.asarray(angle))[..., None] * n)
        total = total + 0.5 * weight * _apply(R @ F @ _transposed(R), earth)
    return np.asarray(total * np.asarray(duration)[..., None])


_LEGENDRE = np.polynomial.legendre.leggauss(10)


def start_error_growth(start_error: Array, duration: Array, latitude: float) -> Array:
    """Change −Ω × ψ₀ T (..., 3), rad, of an attitude error ψ₀ (..., 3) over a turn of `duration` (...), s: what an
    error of azimuth or of the initial levelling adds to the turn. §6.2."""
    rate = np.cross(np.array(earth_rate(latitude)), start_error)
    return np.asarray(-rate * np.asarray(duration)[..., None])


def horizontal_differences(attitude_change: Array, accel_change: Array) -> Array:
    """Differences y (..., 2), rad, to the north and east of the specific force over g in the computed frame, end less
    start of a turn: −Δψ_E + Δα_N and Δψ_N + Δα_E. §6.2. `accel_change` (..., 3): change of the accelerometer errors
    over g, resolved in N, U, E."""
    ψ, α = np.asarray(attitude_change), np.asarray(accel_change)
    return np.stack([-ψ[..., _E] + α[..., _N], ψ[..., _N] + α[..., _E]], axis=-1)


def indirect_matrix(programme: Programme) -> Array:
    """Matrix (2K, 9) of the indirect method for the K known turns of a programme, Earth's rate apart: derivative of y
    (north, east of each turn) with respect to the gyros' k (3) and γ (6). Eq. (6.3)."""
    turns = _turns(programme)
    change = turn_error(turns.start, turns.axis, turns.angle, _GYRO_BASIS[:, None])
    return horizontal_differences(change, np.zeros(3)).reshape(9, -1).T


def indirect_accelerometer_matrix(programme: Programme) -> Array:
    """Matrix (2K, 9) of the derivative of y with respect to the accelerometers' b (3), k (3) and γ (3): the terms of
    Eq. (6.3) with superscript A. An exact turn leaves nothing of k."""
    return _accelerometer_matrix(_turns(programme))


def accelerometer_leakage(programme: Programme) -> Array:
    """Errors (9, 9) of the gyros' k (3) and γ (6), rad, per unit of what is left of the accelerometers' b, k, γ after
    stages 1 and 2 (true − estimated), with the programme's matrix: §6.3."""
    return np.asarray(np.linalg.pinv(indirect_matrix(programme)) @ indirect_accelerometer_matrix(programme))


def misaligned_turn_error(
    axis: Literal["N", "U"], angle: float, F: Array, start: Array, axis_error: Array, angle_error: Array
) -> Array:
    """Change (..., 2) of Δψ_N, Δψ_E, rad, of a turn by ±180° about N or U that is not exact, of first order: §6.4.

    `angle`: ±π; `F` (..., 3, 3): E resolved in N, U, E at the nominal start; `start` (..., 3): η, rotation of the
    body at the start from nominal, rad; `axis_error` (..., 3): ν, of the axis of the turn (across it);
    `angle_error` (...): ΔΘ. So scale factors err by angle × misalignment, and angles by scale factor × misalignment."""
    f = np.moveaxis(np.asarray(F), (-2, -1), (0, 1))
    η, ν, ΔΘ = np.moveaxis(np.asarray(start), -1, 0), np.moveaxis(np.asarray(axis_error), -1, 0), angle_error
    if axis == "N":
        along = (f[_U, _N] + f[_N, _U]) * (ν[_U] - η[_E]) + (f[_E, _N] + f[_N, _E]) * (ν[_E] + η[_U])
        ψ_N = ΔΘ * f[_N, _N] + angle * along + 2.0 * (ν[_U] * f[_E, _N] - ν[_E] * f[_U, _N])
        ψ_E = (
            -ΔΘ * f[_E, _N]
            + angle * ν[_E] * f[_N, _N]
            + 2.0 * (f[_U, _U] - f[_N, _N]) * (ν[_U] - η[_E])
            - 2.0 * η[_N] * f[_E, _N]
            + 2.0 * f[_U, _E] * (η[_U] + ν[_E])
        )
        return np.stack([ψ_N, ψ_E], axis=-1)
    ψ_N = (
        -ΔΘ * f[_N, _U]
        + angle * ν[_N] * f[_U, _U]
        + 2.0 * (f[_E, _E] - f[_U, _U]) * (ν[_E] - η[_N])
        - 2.0 * η[_U] * f[_N, _U]
        + 2.0 * f[_E, _N] * (η[_E] + ν[_N])
    )
    ψ_E = (
        -ΔΘ * f[_E, _U]
        + angle * ν[_E] * f[_U, _U]
        + 2.0 * (f[_U, _U] - f[_N, _N]) * (ν[_N] + η[_E])
        - 2.0 * η[_U] * f[_E, _U]
        - 2.0 * f[_N, _E] * (ν[_E] - η[_N])
    )
    return np.stack([ψ_N, ψ_E], axis=-1)


# -------------------- the budget of a set-up --------------------

Method = Literal["sequential", "scalar", "staged"]

METHODS: tuple[Method, ...] = ("sequential", "scalar", "staged")

ESTIMATORS: Mapping[Method, Mapping[str, str]] = MappingProxyType(
    {
        "sequential": {
            "accel.bias": "up and down, levelled, Eq. (4)",
            "accel.scale": "up and down, levelled, Eq. (4)",
            "accel.axis": "axes 45° up and down, Eq. (10)",
            "gyro.bias": "vertical axes, Eq. (18)",
            "gyro.scale": "indirect, programme matrix",
            "gyro.axis": "indirect, programme matrix",
        },
        "scalar": {
            "accel.bias": "scalar, estimated orientation, Eq. (13)",
            "accel.scale": "scalar, estimated orientation, Eq. (13)",
            "accel.axis": "scalar, estimated orientation, Eq. (13)",
            "gyro.bias": "scalar, estimated orientation",
            "gyro.scale": "indirect, programme matrix",
            "gyro.axis": "indirect, programme matrix",
        },
        "staged": {
            "accel.bias": "scalar, estimated orientation, Eq. (13)",
            "accel.scale": "scalar, estimated orientation, Eq. (13)",
            "accel.axis": "scalar, estimated orientation, Eq. (13)",
            "gyro.bias": "dot product",
            "gyro.scale": "indirect, logged Jacobian",
            "gyro.axis": "indirect, logged Jacobian",
        },
    }
)
"""How each method finds each group of parameters."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Spread:
    """Rms of the parameters before calibration: `bias`, m/s² or rad/s; `scale`; `axis`, rad."""

    bias: float
    scale: float
    axis: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Setup:
    """What is known of a calibration before it is made.

    `table_error`, `mounting_error`: every position, and the whole launch, off by up to so much, rad, uniform within ±
    about each axis, as in `tumble simulate`. `rest`: duration of a rest, s; `turn_rate`, rad/s. `accel_white`,
    m/s²/√Hz, `gyro_white`, rad/s/√Hz: densities of the white noise; `accel_instability`, m/s², `gyro_instability`,
    rad/s: rms of what a bias changes by from rest to rest. `accel`, `gyro`: spreads before calibration. `latitude`,
    rad; `gravity`, m/s², with its standard uncertainty `gravity_u` (`earth.NORMAL_GRAVITY_U` if it is not measured)."""

    table_error: float = DEGREE
    mounting_error: float = DEGREE
    rest: float = 60.0
    turn_rate: float = 10.0 * DEGREE
    accel_white: float = 1e-4
    gyro_white: float = 0.003 * DEGREE / 60.0
    accel_instability: float = 0.0
    gyro_instability: float = 0.0
    accel: Spread = Spread(bias=2e-3, scale=1e-4, axis=25.0 * ARCSEC)
    gyro: Spread = Spread(bias=0.3 * DEGREE_PER_HOUR, scale=1e-4, axis=10.0 * ARCSEC)
    latitude: float
    gravity: float
    gravity_u: float = 0.0
    programme: Programme = field(default_factory=lambda: built_in("rough-table"))


@dataclass(frozen=True, kw_only=True, slots=True)
class Term:
    """One cause of a group's error, and the rms error it makes alone, SI."""

    name: str
    error: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Row:
    """Expected error of a group of parameters after `iteration` passes of a method.

    `error`: rms over the group's parameters and over instruments and set-ups, in `unit` (SI); `relative`: the same
    over the spread before calibration; `errors`: rms by parameter name; `terms`: what it is made of, largest first."""

    group: str
    method: Method
    estimator: str
    iteration: int
    unit: str
    error: float
    relative: float
    errors: Mapping[str, float]
    terms: tuple[Term, ...]

    @property
    def dominating(self) -> str:
        """The largest term's name; nothing where nothing is left, to the order of the formulas."""
        return self.terms[0].name if self.terms else "nothing"


@dataclass(frozen=True, kw_only=True, slots=True)
class Budget:
    """The rows of a set-up: by method, then by iteration, then by group; `remarks` say, in sentences, where the set-up
    is outside what the formulas hold for."""

    setup: Setup
    rows: tuple[Row, ...]
    remarks: tuple[str, ...]

    def row(self, method: Method, group: str, iteration: int) -> Row:
        """The row of this method, group and iteration. Raises KeyError if there is none."""
        for row in self.rows:
            if (row.method, row.group, row.iteration) == (method, group, iteration):
                return row
        raise KeyError((method, group, iteration))


def budget(setup: Setup, methods: Sequence[Method] = METHODS, iterations: int = 2) -> Budget:
    """Expected errors of every group of parameters after each of so many passes of these methods.

    Groups that the programme cannot give (gyro scale factors without known turns) have no row. Raises InputError for
    values that make no sense, ProgrammeError for a programme without the positions a method needs."""
    _check(setup, iterations)
    rows: list[Row] = []
    for method in methods:
        pipeline = _pipeline(setup, method)
        for iteration in range(1, iterations + 1):
            rows += _rows(setup, pipeline, iteration)
    return Budget(setup=setup, rows=tuple(rows), remarks=_remarks(setup, methods))


def _remarks(setup: Setup, methods: Sequence[Method]) -> tuple[str, ...]:
    """What a set-up has that the formulas do not hold for."""
    out = []
    if max(setup.table_error, setup.mounting_error) > LARGEST_DEVIATION:
        out.append(
            f"errors of table and mounting up to {max(setup.table_error, setup.mounting_error) / DEGREE:.3g}°: the "
            f"formulas are of first order in them and hold up to {LARGEST_DEVIATION / DEGREE:g}°"
        )
    rate = math.hypot(setup.gyro.bias, setup.gyro_white / math.sqrt(setup.rest), setup.gyro_instability)
    north = earth_rate(setup.latitude)[0]
    if rate > LARGEST_AZIMUTH * north and set(methods) != {"staged"}:
        out.append(
            f"gyros off by {rate / DEGREE_PER_HOUR:.3g} °/h at rest, with {north / DEGREE_PER_HOUR:.3g} °/h of Earth's "
            "rate to find north by: the methods sequential and scalar do worse in gyro parameters than predicted, "
            "take staged"
        )
    return tuple(out)


LARGEST_DEVIATION = 5.0 * DEGREE
"""Largest table and mounting error, rad, for which formulas of first order in them are taken to hold."""

LARGEST_AZIMUTH = 0.1
"""Largest azimuth error of TRIAD, rad, likewise; the paper, too, wants biases an order below the Earth's rate."""


def _rows(setup: Setup, pipeline: _Pipeline, iteration: int) -> list[Row]:
    """The rows of one method after so many passes."""
    variances = pipeline.variances(iteration)
    out = []
    for group in pipeline.groups:
        members, size, unit = _members(group), _size(setup, group), _UNITS[group]
        total = sum((v[members] for v in variances.values()), np.zeros(len(members)))
        terms = [Term(name=n, error=size * _rms(v[members])) for n, v in variances.items() if v[members].any()]
        error = size * math.sqrt(total.mean())
        out.append(
            Row(
                group=group,
                method=pipeline.method,
                estimator=ESTIMATORS[pipeline.method][group],
                iteration=iteration,
                unit=unit,
                error=error,
                relative=error / _spread(setup, group),
                errors={NAMES[p]: size * math.sqrt(v) for p, v in zip(members, total, strict=True)},
                terms=tuple(sorted(terms, key=lambda term: -term.error)),
            )
        )
    return out


_UNITS = {".".join(name.split(".")[:2]): unit for name, unit in zip(NAMES, _ACCEL.units + _GYRO.units, strict=True)}


def _members(group: str) -> IntArray:
    """Indices of a group's parameters."""
    return np.array([i for i, name in enumerate(NAMES) if name.startswith(group)])


def _size(setup: Setup, group: str) -> float:
    """One internal unit of a group in SI: biases of accelerometers are angles inside."""
    return setup.gravity if group == "accel.bias" else 1.0


def _spread(setup: Setup, group: str) -> float:
    """Spread of a group before calibration, SI."""
    kind, what = group.split(".")
    return float(getattr(setup.accel if kind == "accel" else setup.gyro, what))


def _rms(variance: Array) -> float:
    return math.sqrt(float(variance.mean()))


# The plan: what the programme's positions and turns are good for


@dataclass(frozen=True, kw_only=True, slots=True)
class _Turns:
    """K known turns: rests `first` and `last` (K,), whether each `opens` a series, geographic `axis` (K, 3), signed
    `angle` (K,), rad, and nominal attitudes at its `start` and `stop` (K, 3, 3)."""

    first: IntArray
    last: IntArray
    opens: tuple[bool, ...]
    axis: Array
    angle: Array
    start: Array
    stop: Array


def _turns(programme: Programme) -> _Turns:
    """The turns of a programme whose axis and angle are known. Raises ProgrammeError if there are none."""
    known = [(i, m) for i, m in enumerate(programme.moves) if m.axis is not None and m.angle is not None]
    if not known:
        raise ProgrammeError(
            f"programme {programme.name}: expected turns with known axis and angle, found none; take rough-table"
        )
    first = np.array([i for i, _ in known])
    nominal = np.array([position.matrix for position in programme.positions])
    return _Turns(
        first=first,
        last=first + 1,
        opens=tuple(bool(i - 1 not in first) for i in first),
        axis=np.array([m.axis for _, m in known], dtype=float),
        angle=np.array([m.angle for _, m in known], dtype=float),
        start=nominal[first],
        stop=nominal[first + 1],
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class _Plan:
    """A set-up as the estimators use it: `nominal` attitudes (N, 3, 3), known turns with their `duration` (K,), s, and
    the programme's matrix; rests in which each axis is vertical (`standing`) and in which each pair is 45° up and down
    (`oblique`)."""

    nominal: Array
    turns: _Turns | None
    duration: Array
    indirect: Array
    standing: tuple[IntArray, ...]
    oblique: tuple[IntArray, ...]
    latitude: float


def _plan(setup: Setup, method: Method) -> _Plan:
    programme = setup.programme
    nominal = np.array([position.matrix for position in programme.positions])
    u = nominal[:, 1, :]
    has_turns = any(move.axis is not None for move in programme.moves)
    turns = _turns(programme) if has_turns else None
    plan = _Plan(
        nominal=nominal,
        turns=turns,
        duration=np.abs(turns.angle) / setup.turn_rate if turns is not None else np.empty(0),
        indirect=indirect_matrix(programme) if has_turns else np.empty((0, 9)),
        standing=tuple(np.flatnonzero(np.abs(u[:, p]) > 1.0 - _NEAR) for p in range(3)),
        oblique=tuple(np.flatnonzero(_astride(u, *pair)) for pair in _ACCEL_PAIRS),
        latitude=setup.latitude,
    )
    _check_positions(programme, method, u, plan)
    return plan


_NEAR = 1e-6


def _astride(u: Array, p: int, q: int) -> Array:
    """Which rests have axes p and q 45° on either side of the horizon in a vertical plane."""
    return np.asarray((np.abs(u[:, p] + u[:, q]) < _NEAR) & (np.abs(u[:, 3 - p - q]) < _NEAR))


def _check_positions(programme: Programme, method: Method, u: Array, plan: _Plan) -> None:
    """Raise ProgrammeError unless a method finds the positions it needs."""
    if method == "sequential":
        both = [{*np.sign(u[rests, p])} == {-1.0, 1.0} for p, rests in enumerate(plan.standing)]
        wanted = dict(zip(("X up and down", "Y up and down", "Z up and down"), both, strict=True))
        pairs = ("X and Y", "X and Z", "Y and Z")
        wanted |= {f"{n} 45° up and down": len(r) > 0 for n, r in zip(pairs, plan.oblique, strict=True)}
        missing = [name for name, there in wanted.items() if not there]
        if missing:
            raise ProgrammeError(
                f"programme {programme.name}: expected rests with {missing[0]} for the method sequential, found none; "
                "take rough-table or nine, or another method"
            )
    rank = int(np.linalg.matrix_rank(scalar_matrix(u)))
    if rank < 9:
        raise ProgrammeError(
            f"programme {programme.name}: expected positions that determine nine accelerometer parameters, "
            f"found {rank}; take rough-table, nine or cube-26"
        )


# What is seen, to first order in the parameters, and what the estimators make of it


@dataclass(frozen=True, kw_only=True, slots=True)
class _Seen:
    """Errors of what is observed, m cases at once: of the accelerometers at rest over g, `accel` (..., m, N, 3), of the
    gyros at rest, `gyro` (..., m, N, 3), rad/s, and of the attitude over each known turn, `turn` (..., m, K, 3)."""

    accel: Array
    gyro: Array
    turn: Array


def _seen(plan: _Plan, attitudes: Array) -> _Seen:
    """What each of the 21 parameters, taken as 1, makes the sensors show at these attitudes (..., N, 3, 3)."""
    X = np.eye(len(NAMES))[:, None]
    L = attitudes[..., None, :, :, :]
    E = _gyro_matrix_error(X[..., 12:15], X[..., 15:])
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
    return _Seen(accel=_accelerometer_errors(X[..., :9], L[..., 1, :]), gyro=gyro, turn=turn)


def _rotation_between(start: Array, stop: Array, nominal: _Turns) -> tuple[Array, Array]:
    """Axis (..., K, 3) and angle (..., K) of the rotations that lead from one attitude to the other, the way round
    that is nearer to the nominal turn."""
    R = stop @ _transposed(start)
    trace = np.trace(R, axis1=-2, axis2=-1)
    along = R + _transposed(R) + (1.0 - trace)[..., None, None] * np.eye(3)  # 2 (1 − cos Θ) n nᵀ
    axis = _apply(along, nominal.axis)
    axis = axis / np.linalg.norm(axis, axis=-1, keepdims=True)
    sine = 0.5 * _dot(axis, _vee(R - _transposed(R)))
    angle = np.arctan2(sine, 0.5 * (trace - 1.0))
    return axis, angle + 2.0 * np.pi * np.round((nominal.angle - angle) / (2.0 * np.pi))


def _estimates(plan: _Plan, method: Method, attitudes: Array, seen: _Seen) -> Array:
    """What one pass of a method makes of what is seen: parameters (..., m, 21), linear in it. Gyro parameters that the
    programme does not give are zero."""
    L = attitudes[..., None, :, :, :]
    u = L[..., 1, :]
    if method == "sequential":
        accel_values = _sequential_accelerometers(plan, u, seen.accel)
    else:
        accel_values = _solved(scalar_matrix(u), _dot(u, seen.accel))
    accel = seen.accel - _accelerometer_errors(accel_values[..., None, :], u)
    bias = _gyro_bias(plan, method, L, accel, seen.gyro)
    if plan.turns is None:
        return np.concatenate([accel_values, bias, np.zeros((*bias.shape[:-1], 9))], axis=-1)
    corrected = _without_bias(plan, L, _Seen(accel=accel, gyro=seen.gyro, turn=seen.turn), bias)
    matrix = plan.indirect if method != "staged" else _logged_matrix(plan, attitudes)
    gyro_values = _solved(matrix, _differences(plan, L, corrected))
    return np.concatenate([accel_values, bias, gyro_values], axis=-1)


def _sequential_accelerometers(plan: _Plan, u: Array, accel: Array) -> Array:
    """Stages 1 and 2: b, k, γ (..., m, 9). TRIAD's cosines are ŵ_p/|ŵ|, so that ŵ_p/g − û_p is û_p (|ŵ|/g − 1)."""
    modulus = _dot(u, accel)
    b, k = [], []
    for p, rests in enumerate(plan.standing):
        cosine = u[..., rests, p]
        line = np.stack([np.ones_like(cosine), cosine], axis=-1)
        found = _solved(line, cosine * modulus[..., rests])
        b.append(found[..., 0])
        k.append(found[..., 1])
    first = np.stack([*b, *k, *(np.zeros_like(b[0]),) * 3], axis=-1)
    left = accel - _accelerometer_errors(first[..., None, :], u)
    return np.concatenate([first[..., :6], _oblique_angles(plan, u, left)], axis=-1)


def _oblique_angles(plan: _Plan, u: Array, accel: Array) -> Array:
    """Stage 2, Eq. (10) to first order in the errors at any tilt: γ_yx, γ_zx, γ_zy (..., m, 3)."""
    out = []
    for (p, q), rests in zip(_ACCEL_PAIRS, plan.oblique, strict=True):
        up, uq, ur = u[..., rests, p], u[..., rests, q], u[..., rests, 3 - p - q]
        ep, eq, er = accel[..., rests, p], accel[..., rests, q], accel[..., rests, 3 - p - q]
        out_of_plane = ur * er / (1.0 - ur**2)
        out.append(((ep + up * out_of_plane) / uq + (eq + uq * out_of_plane) / up).mean(axis=-1))
    return np.stack(out, axis=-1)


def _gyro_bias(plan: _Plan, method: Method, L: Array, accel: Array, gyro: Array) -> Array:
    """Stage 3: gyro biases (..., m, 3), rad/s."""
    if method == "sequential":
        shown = gyro - reference_rate_error(L, accel, gyro, plan.latitude)
        return np.stack([shown[..., rests, p].mean(axis=-1) for p, rests in enumerate(plan.standing)], axis=-1)
    if method == "scalar":
        polar = _apply(_transposed(L), np.array(earth_rate(plan.latitude))) / EARTH_RATE
        return _solved(polar, _dot(polar, gyro))
    u = L[..., 1, :]
    north = _dot(L[..., 0, :], accel)
    return _solved(u, _dot(u, gyro) + dot_product_error(north, plan.latitude))


def _without_bias(plan: _Plan, L: Array, seen: _Seen, bias: Array) -> _Seen:
    """What is seen when gyro biases (..., m, 3) are taken off."""
    assert plan.turns is not None
    start = L[..., plan.turns.first, :, :]
    axis, angle = _rotation_between(start, L[..., plan.turns.last, :, :], plan.turns)
    by_bias = turn_bias_error(start, axis, angle, plan.duration, bias[..., None, :])
    return _Seen(accel=seen.accel, gyro=seen.gyro - bias[..., None, :], turn=seen.turn - by_bias)


def _differences(plan: _Plan, L: Array, seen: _Seen) -> Array:
    """Horizontal differences y (..., m, 2K), north and east of each turn in order. The attitude is TRIAD's at the first
    rest of a series, held in rests and carried through the turns."""
    assert plan.turns is not None
    y = []
    ψ = np.zeros(3)
    for t, (i, j) in enumerate(zip(plan.turns.first, plan.turns.last, strict=True)):
        if plan.turns.opens[t]:
            ψ = triad_error(L[..., i, :, :], seen.accel[..., i, :], seen.gyro[..., i, :], plan.latitude)
        change = start_error_growth(ψ, plan.duration[t], plan.latitude) + seen.turn[..., t, :]
        α = _apply(L[..., j, :, :], seen.accel[..., j, :]) - _apply(L[..., i, :, :], seen.accel[..., i, :])
        y.append(horizontal_differences(change, α))
        ψ = ψ + change
    return np.concatenate(y, axis=-1)


def _logged_matrix(plan: _Plan, attitudes: Array) -> Array:
    """Matrix (..., 1, 2K, 9) of the indirect method with the Jacobian from the logged rate, §6.6: of the real turns,
    Earth's rate and TRIAD at the start of the series included."""
    seen = _seen(plan, attitudes)
    no_accel = np.zeros((9, *seen.accel.shape[-2:]))
    gyro_only = _Seen(accel=no_accel, gyro=seen.gyro[..., 12:, :, :], turn=seen.turn[..., 12:, :, :])
    return _transposed(_differences(plan, attitudes[..., None, :, :, :], gyro_only))[..., None, :, :]


# The pipeline: what a method leaves of the parameters


@dataclass(frozen=True, kw_only=True, slots=True)
class _Pipeline:
    """What passes of a method leave of the parameters. Matrices (21, 21) are to be applied to the variances of the
    parameters: `exact`, `by_table` and `by_mounting` for the first pass, and for the second the parts that grow with
    the 0th, 2nd and 4th power of the deviations, `twice`. `second_order` (21,) and `noise` (21,) by cause are variances
    themselves; `spread` (21,) the rms of the parameters."""

    method: Method
    groups: tuple[str, ...]
    exact: Array
    by_table: Array
    by_mounting: Array
    twice: tuple[Array, Array, Array]
    second_order: Array
    noise: Mapping[str, Array]
    spread: Array

    def variances(self, iteration: int) -> dict[str, Array]:
        """Variances (21,) of the errors after so many passes, by the name of their cause."""
        return self.methodical(iteration, 1.0) | dict(self.noise)

    def methodical(self, iteration: int, scale: float) -> dict[str, Array]:
        """The part of `variances` that is not noise, with table and mounting errors multiplied by `scale`."""
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
        gain = _gain(_total(self.methodical(1, scale)), _total(second)) ** (iteration - 2)
        return {name: gain * variance for name, variance in second.items()}

    def _by_group(self, name: str, matrix: Array) -> dict[str, Array]:
        """Variances (21,) that each group of parameters contributes through a matrix."""
        out = {}
        for group in GROUPS:
            members = _members(group)
            out[name.format(group)] = matrix[:, members] @ self.spread[members] ** 2
        return out


def _total(variances: Mapping[str, Array]) -> Array:
    return sum(variances.values(), np.zeros(len(NAMES)))


def _gain(first: Array, second: Array) -> Array:
    """By how much the second pass reduced the variance of each parameter's group (21,)."""
    gain = np.zeros(len(NAMES))
    for members in map(_members, GROUPS):
        before = float(first[members].mean())
        gain[members] = second[members].mean() / before if before > 0.0 else 0.0
    return gain


def _pipeline(setup: Setup, method: Method) -> _Pipeline:
    """A method on the programme of a set-up."""
    plan = _plan(setup, method)
    T0, D = _passes(plan, method)
    table = 3 * len(plan.nominal)
    width = np.repeat([setup.table_error, setup.mounting_error], [table, 3])
    v = width**2 / 3.0  # uniform
    spread = np.concatenate(
        [
            np.repeat([setup.accel.bias / setup.gravity, setup.accel.scale, setup.accel.axis], 3),
            np.repeat([setup.gyro.bias, setup.gyro.scale, setup.gyro.axis], [3, 3, 6]),
        ]
    )
    return _Pipeline(
        method=method,
        groups=GROUPS if plan.turns is not None else GROUPS[:4],
        exact=T0**2,
        by_table=np.tensordot(v[:table], D[:table] ** 2, axes=1),
        by_mounting=np.tensordot(v[table:], D[table:] ** 2, axes=1),
        twice=_twice(T0, D, v, width**4 / 5.0),
        second_order=_mean_square(lambda X: _second_order(plan, method, X), spread),
        noise=_noise(setup, plan, method),
        spread=spread,
    )


def _passes(plan: _Plan, method: Method) -> tuple[Array, Array]:
    """What one pass leaves of the parameters: T₀ (21, 21) on an exact programme and its derivatives D (3N + 3, 21, 21)
    with respect to the deviations, per rad, by central differences."""
    N = len(plan.nominal)
    step = 1e-4
    τ = step * np.concatenate([np.eye(3 * N + 3), -np.eye(3 * N + 3), np.zeros((1, 3 * N + 3))])
    table = rotation_matrix(τ[:, : 3 * N].reshape(-1, N, 3))
    attitudes = table @ plan.nominal @ rotation_matrix(τ[:, None, 3 * N :])
    left = np.eye(len(NAMES)) - _transposed(_estimates(plan, method, attitudes, _seen(plan, attitudes)))
    forward, backward, T0 = np.split(left, [3 * N + 3, 6 * N + 6])
    D = (forward - backward) / (2.0 * step)
    return np.where(np.abs(T0[0]) > _ROUNDING, T0[0], 0.0), np.where(np.abs(D) > _ROUNDING / step, D, 0.0)


_ROUNDING = 1e-12
"""What a pass leaves of a parameter relative to another is nothing below this."""


def _twice(T0: Array, D: Array, v: Array, fourth: Array) -> tuple[Array, Array, Array]:
    """Mean squares (21, 21) of T² with T = T₀ + Σ τ_k D_k, in parts that grow with the 0th, 2nd and 4th power of τ; `v`
    and `fourth` are the second and fourth moments of the independent τ_k. See the module's docstring."""
    fixed = T0 @ T0
    linear = T0 @ D + D @ T0
    A = np.einsum("kpj,ljq->klpq", D, D)
    S = 0.5 * (A + A.swapaxes(0, 1))
    own = np.einsum("kkpq->kpq", A)
    trace = np.tensordot(v, own, axes=1)
    square = trace**2 + 2.0 * np.einsum("k,l,klpq->pq", v, v, S**2, optimize=True)
    square += np.tensordot(fourth - 3.0 * v**2, own**2, axes=1)
    return fixed**2, 2.0 * fixed * trace + np.tensordot(v, linear**2, axes=1), square


def _noise(setup: Setup, plan: _Plan, method: Method) -> dict[str, Array]:
    """Variances (21,) of the parameters from noise, by cause, on an exact programme: each noise as if alone."""
    N, K = len(plan.nominal), len(plan.duration)
    accel = np.eye(3 * N).reshape(3 * N, N, 3)
    turn = np.eye(3 * K).reshape(3 * K, K, 3)
    by_accel = _gains(plan, method, _Seen(accel=accel, gyro=0.0 * accel, turn=np.zeros((3 * N, K, 3))))
    by_gyro = _gains(plan, method, _Seen(accel=0.0 * accel, gyro=accel, turn=np.zeros((3 * N, K, 3))))
    by_turn = _gains(plan, method, _Seen(accel=np.zeros((3 * K, N, 3)), gyro=np.zeros((3 * K, N, 3)), turn=turn))
    by_change = _gains(plan, method, _Seen(accel=0.0 * accel, gyro=accel, turn=_held(plan, accel)))
    seconds = np.repeat(plan.duration, 3)
    return {
        REST_NOISE[0]: (by_accel**2).sum(axis=0) * (setup.accel_white / setup.gravity) ** 2 / setup.rest,
        REST_NOISE[1]: (by_gyro**2).sum(axis=0) * setup.gyro_white**2 / setup.rest,
        "gyro noise in turns": seconds @ by_turn**2 * setup.gyro_white**2,
        "accelerometer instability": (by_accel**2).sum(axis=0) * (setup.accel_instability / setup.gravity) ** 2,
        "gyro instability": (by_change**2).sum(axis=0) * setup.gyro_instability**2,
        "uncertainty of gravity": np.isin(np.arange(len(NAMES)), _members("accel.scale"))
        * (setup.gravity_u / setup.gravity) ** 2,
    }


REST_NOISE = ("accelerometer noise at rest", "gyro noise at rest")
"""The causes that longer rests reduce."""


def _gains(plan: _Plan, method: Method, seen: _Seen) -> Array:
    """Estimates (m, 21) that m unit errors of what is seen lead to."""
    return _estimates(plan, method, plan.nominal, seen)


def _held(plan: _Plan, gyro: Array) -> Array:
    """Attitude errors (m, K, 3) that gyro errors (m, N, 3) make when they stay through the turn after a rest."""
    if plan.turns is None:
        return np.zeros((len(gyro), 0, 3))
    turns = plan.turns
    return turn_bias_error(turns.start, turns.axis, turns.angle, plan.duration, gyro[:, turns.first])


# Errors of second order in the parameters


def _mean_square(form: Callable[[Array], Array], spread: Array) -> Array:
    """Mean squares (p,) of quadratic forms q(X) = Xᵀ Q X of independent Gaussian X with rms `spread` (m,):
    (tr Q)² + 2 Σ Q_ij². `form` takes (..., m) to (..., p); Q is found by polarisation."""
    m = len(spread)
    single = np.diag(spread)
    pair = single[:, None] + single[None, :]
    diagonal = form(single)
    Q = 0.5 * (form(pair) - diagonal[:, None] - diagonal[None, :])
    Q[np.arange(m), np.arange(m)] = diagonal
    return np.asarray(diagonal.sum(axis=0) ** 2 + 2.0 * (Q**2).sum(axis=(0, 1)))


def _second_order(plan: _Plan, method: Method, X: Array) -> Array:
    """Errors (..., 21) of second order in the parameters X (..., 21) that a method makes on an exact programme."""
    b, k, γ = X[..., 0:3], X[..., 3:6], X[..., 6:9]
    u = plan.nominal[:, 1, :]
    linearised, orientation = scalar_residuals(u, b[..., None, :], k[..., None, :], γ[..., None, :])
    if method == "sequential":
        along = _dot(u, _accelerometer_errors(X[..., None, :9], u))
        modulus = linearised - 0.5 * along**2  # |ŵ|/g − 1 in place of the quadratic form
        accel = _sequential_accelerometers(plan, u, modulus[..., None] * u)
        left = np.concatenate([accel[..., :6], np.zeros((*accel.shape[:-1], 3))], axis=-1)
        accel[..., 6:] = -_oblique_angles(plan, u, _accelerometer_errors(left[..., None, :], u))
    else:
        accel = _solved(scalar_matrix(u), linearised + orientation)
    bias = np.zeros((*X.shape[:-1], 3))
    if method == "scalar":
        E = _gyro_matrix_error(X[..., None, 12:15], X[..., None, 15:])
        error = X[..., None, 9:12] + gyro_matrix_rate_error(plan.nominal, E, plan.latitude)
        polar = _transposed(plan.nominal) @ np.array(earth_rate(plan.latitude)) / EARTH_RATE
        bias = _solved(polar, modulus_residual(_apply(plan.nominal, error)))
    gyro = np.zeros((*X.shape[:-1], 9))
    if plan.turns is not None:
        by_accel = _solved(plan.indirect, -_apply(_accelerometer_matrix(plan.turns), accel))
        gyro = _solved(plan.indirect, _turns_second_order(plan.turns, method, X[..., 12:])) + by_accel
    return np.concatenate([accel, bias, gyro], axis=-1)


def _accelerometer_matrix(turns: _Turns) -> Array:
    """`indirect_accelerometer_matrix` of these turns."""

    def seen(attitudes: Array) -> Array:
        return _apply(attitudes, _accelerometer_errors(np.eye(9)[:, None], attitudes[..., 1, :]))

    return horizontal_differences(np.zeros(3), seen(turns.stop) - seen(turns.start)).reshape(9, -1).T


def _turns_second_order(turns: _Turns, method: Method, values: Array) -> Array:
    """What the differences y (..., 2K) of exact turns have beyond the matrix of the method times the gyros' k and γ
    (..., 9), to second order: half the sum for these values and their opposites."""
    return 0.5 * (_turns_beyond(turns, method, values) + _turns_beyond(turns, method, -values))


def _turns_beyond(turns: _Turns, method: Method, values: Array) -> Array:
    """Differences y (..., 2K) of exact turns without Earth's rate, less those the method's matrix gives.

    In such a turn the rate is constant in the body, and so is what the gyros make of it."""
    k, γ = values[..., :3], values[..., 3:]
    S = (1.0 + k)[..., None] * np.moveaxis(axes_matrix(*np.moveaxis(γ, -1, 0)), (0, 1), (-2, -1))
    E = _gyro_matrix_error(k, γ)
    out = []
    computed = turns.start[0]
    for t, (start, stop) in enumerate(zip(turns.start, turns.stop, strict=True)):
        computed = start if turns.opens[t] else computed
        turned = _apply(S, start.T @ (turns.axis[t] * turns.angle[t]))
        after = computed @ rotation_matrix(turned)
        found = _apply(after, stop[1]) - _apply(computed, start[1])
        if method == "staged":
            angle = np.linalg.norm(turned, axis=-1)
            axis = _apply(computed, turned) / angle[..., None]
            expected = turn_error(computed, axis, angle, E)
        else:
            expected = turn_error(start, turns.axis[t], turns.angle[t], E)
        out.append(found[..., [_N, _E]] - horizontal_differences(expected, np.zeros(3)))
        computed = after
    return np.concatenate(out, axis=-1)


# -------------------- requirements: the inverse --------------------

REST_SHARE = 0.25
"""Part of the permitted variance that `require` gives to the noise of rests; table and mounting get the others."""

BiasEstimator = Literal["programme", "vertical", "polar"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Requirement:
    """What one wanted accuracy asks of the set-up: largest `table_error` and `mounting_error`, rad (uniform within ±,
    in the ratio of the set-up), their rms together per axis, `tilt`, rad, and the shortest `rest`, s. `limited` says
    whether the table matters at all within 5°. If not `feasible` the tolerances are zero, `rest` is infinite, and
    `reason` says what stands in the way of any table."""

    group: str
    estimator: str
    wanted: float
    unit: str
    feasible: bool
    limited: bool
    table_error: float
    mounting_error: float
    tilt: float
    rest: float
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Requirements:
    """All requirements, and what meets those that can be met: the smallest tolerances and the longest rest."""

    setup: Setup
    method: Method
    iteration: int
    rows: tuple[Requirement, ...]

    @property
    def feasible(self) -> bool:
        """Whether some set-up meets all of them."""
        return all(row.feasible for row in self.rows)

    @property
    def table_error(self) -> float:
        """Largest error of the table, rad, that meets every requirement that can be met."""
        return min((row.table_error for row in self.rows if row.feasible), default=0.0)

    @property
    def mounting_error(self) -> float:
        """Largest error of the mounting, rad, that meets every requirement that can be met."""
        return min((row.mounting_error for row in self.rows if row.feasible), default=0.0)

    @property
    def rest(self) -> float:
        """Shortest rest, s, that meets every requirement that can be met."""
        return max((row.rest for row in self.rows if row.feasible), default=0.0)


def require(
    wanted: Mapping[str, float],
    setup: Setup,
    *,
    method: Method = "sequential",
    iteration: int = 1,
    gyro_bias: BiasEstimator = "programme",
) -> Requirements:
    """Tolerances of table and mounting, and duration of the rests, for wanted rms errors by group of parameters, SI.

    Of `setup` the programme, noises, spreads, turn rate and site are used, and the ratio of table to mounting error;
    if both are zero they get equal tolerances. `gyro_bias`: instead of what the method does with the whole programme,
    "vertical" is one rest per gyro with its axis vertical, Eq. (18), and "polar" one along the Earth's axis, Eq. (17).
    Raises InputError for a group that does not exist or values that make no sense."""
    _check(setup, iteration)
    pipeline = _pipeline(_unit_ratio(setup), method)
    _check_wanted(wanted, pipeline)
    rows = []
    for group, value in wanted.items():
        if group == "gyro.bias" and gyro_bias != "programme":
            demand = _single_rest_demand(setup, pipeline, iteration, gyro_bias)
        else:
            demand = _demand(setup, pipeline, iteration, group)
        rows.append(_requirement(_unit_ratio(setup), group, value, demand))
    return Requirements(setup=setup, method=method, iteration=iteration, rows=tuple(rows))


@dataclass(frozen=True, kw_only=True, slots=True)
class _Demand:
    """What a group's variance is made of, SI: `fixed` by cause, whatever the table; `rest_noise` (variance × s); and
    what `deviations` of so many times the unit ratio add."""

    estimator: str
    fixed: Mapping[str, float]
    rest_noise: float
    deviations: Callable[[float], float]


def _demand(setup: Setup, pipeline: _Pipeline, iteration: int, group: str) -> _Demand:
    """Of the method with the whole programme."""
    members, square = _members(group), _size(setup, group) ** 2

    def variance(causes: Mapping[str, Array]) -> dict[str, float]:
        return {name: square * float(v[members].mean()) for name, v in causes.items()}

    still = variance(pipeline.methodical(iteration, 0.0))
    noise = variance(pipeline.noise)
    floor = sum(still.values())
    return _Demand(
        estimator=ESTIMATORS[pipeline.method][group],
        fixed=still | {name: v for name, v in noise.items() if name not in REST_NOISE},
        rest_noise=setup.rest * sum(noise[name] for name in REST_NOISE),
        deviations=lambda scale: sum(variance(pipeline.methodical(iteration, scale)).values()) - floor,
    )


def _single_rest_demand(setup: Setup, pipeline: _Pipeline, iteration: int, estimator: BiasEstimator) -> _Demand:
    """Of one rest per gyro, vertical (18) or polar (17), with the accelerometers as each pass leaves them: the bias
    that a pass has left is what the next one sees."""
    accel = _members("accel.bias")
    ratio = _unit_ratio(setup)
    tilt = math.sqrt((ratio.table_error**2 + ratio.mounting_error**2) / 3.0)
    north, up, _ = earth_rate(setup.latitude)
    level, steep = (north, up) if estimator == "vertical" else (0.0, EARTH_RATE)

    def variance(scale: float) -> float:
        left = setup.gyro.bias**2
        for i in range(1, iteration + 1):
            b2 = float(_total(pipeline.methodical(i, scale))[accel].mean())
            curved = 3.0 * (left / (2.0 * EARTH_RATE)) ** 2 if estimator == "polar" else 0.0
            left = level**2 * b2 + (scale * tilt) ** 2 * (steep**2 * b2 + left) + curved
        return left

    floor = variance(0.0)
    return _Demand(
        estimator=_SINGLE_REST[estimator],
        fixed={_FLOOR[estimator]: floor, "gyro instability": setup.gyro_instability**2},
        rest_noise=setup.gyro_white**2,
        deviations=lambda scale: variance(scale) - floor,
    )


_SINGLE_REST = {"vertical": "one rest, axis vertical, Eq. (18)", "polar": "one rest, axis along the Earth's, Eq. (17)"}
_FLOOR = {
    "vertical": "accelerometer error × horizontal Earth's rate",
    "polar": "azimuth error of TRIAD, δω²/2Ω",
}


def _requirement(unit: Setup, group: str, wanted: float, demand: _Demand) -> Requirement:
    """The inverse: what of wanted² is left over what no table can help goes to deviations and to the noise of rests."""
    free = wanted**2 - sum(demand.fixed.values())
    estimator, gives = demand.estimator, _UNITS[group]
    if free <= 0.0:
        cause = max(demand.fixed, key=lambda name: demand.fixed[name])
        floor = math.sqrt(sum(demand.fixed.values()))
        reason = (
            f"{group}: expected an accuracy of at least {floor:.3g} {gives}, which an exact table and endless rests "
            f"leave (mostly {cause}), found {wanted:.3g}; {_REMEDY.get(cause, 'take another pass or method')}"
        )
        return Requirement(
            group=group, estimator=estimator, wanted=wanted, unit=gives, feasible=False, limited=True,
            table_error=0.0, mounting_error=0.0, tilt=0.0, rest=math.inf, reason=reason,
        )  # fmt: skip
    noisy = demand.rest_noise > 0.0
    rest = demand.rest_noise / (REST_SHARE * free) if noisy else 0.0
    largest = LARGEST_DEVIATION / max(unit.table_error, unit.mounting_error)
    scale = _largest(demand.deviations, (1.0 - REST_SHARE) * free if noisy else free, largest)
    table, mounting = scale * unit.table_error, scale * unit.mounting_error
    tilt = math.sqrt((table**2 + mounting**2) / 3.0)
    return Requirement(
        group=group, estimator=estimator, wanted=wanted, unit=gives, feasible=True, limited=scale < largest,
        table_error=table, mounting_error=mounting, tilt=tilt, rest=rest, reason="",
    )  # fmt: skip


_REMEDY: Mapping[str, str] = MappingProxyType(
    {
        "gyro noise in turns": "turn faster, or average launches",
        "accelerometer instability": "average launches",
        "gyro instability": "average launches",
        "uncertainty of gravity": "measure gravity",
        "second order in the parameters": "take another pass",
        "azimuth error of TRIAD, δω²/2Ω": "take vertical axes, Eq. (18), or another pass",
    }
)


def _largest(function: Callable[[float], float], limit: float, most: float) -> float:
    """The largest x up to `most` with function(x) ≤ limit, of a function that grows from zero."""
    if function(most) <= limit:
        return most
    low, high = 0.0, most
    while high - low > 1e-6 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if function(middle) <= limit else (low, middle)
    return low


def _unit_ratio(setup: Setup) -> Setup:
    """The set-up with the larger of table and mounting error 1 rad, in its ratio, or both if they are zero."""
    larger = max(setup.table_error, setup.mounting_error)
    table, mounting = (setup.table_error / larger, setup.mounting_error / larger) if larger > 0.0 else (1.0, 1.0)
    return replace(setup, table_error=table, mounting_error=mounting)


def _check(setup: Setup, iterations: int) -> None:
    """Raise InputError for values that make no sense."""
    if iterations < 1:
        raise InputError(f"iterations: expected at least 1, found {iterations}")
    if not abs(setup.latitude) < 0.5 * math.pi - DEGREE:
        found = setup.latitude / DEGREE
        raise InputError(f"latitude: expected within ±89 degrees, where TRIAD has an azimuth, found {found:g}")
    for name in ("rest", "turn_rate", "gravity"):
        _expect(name, getattr(setup, name), least="more than 0")
    for name in _MAY_BE_ZERO:
        _expect(name, getattr(setup, name), least="0 or more")
    for kind in ("accel", "gyro"):
        for what in ("bias", "scale", "axis"):
            _expect(f"{kind}.{what}", getattr(getattr(setup, kind), what), least="more than 0")


_MAY_BE_ZERO = (
    "table_error",
    "mounting_error",
    "accel_white",
    "gyro_white",
    "accel_instability",
    "gyro_instability",
    "gravity_u",
)


def _expect(name: str, value: float, *, least: str) -> None:
    if not (0.0 < value < math.inf or (value == 0.0 and least == "0 or more")):
        raise InputError(f"{name}: expected {least}, in SI, found {value:g}")


def _check_wanted(wanted: Mapping[str, float], pipeline: _Pipeline) -> None:
    """Raise InputError for a group the programme does not give or an accuracy that is none."""
    for group, value in wanted.items():
        if group not in pipeline.groups:
            raise InputError(f"wanted: expected some of {', '.join(pipeline.groups)}, found {group!r}")
        _expect(group, value, least="more than 0")


def indirect_coefficients(setup: Setup) -> dict[str, tuple[float, float]]:
    """c₁ (per rad) and c₂ (per rad²) of "gyro.scale" and "gyro.axis": relative errors c₁ σ after the first pass of the
    indirect method with the programme's matrix and c₂ σ² after the second, when σ, rad, is the rms error per axis of
    the mounting and of the positions each, and accelerometers and gyro biases are perfect. §7.

    They depend on the ratio of scale-factor to axis errors in `setup.gyro`: axis angles suffer from scale factors."""
    _check(setup, 1)
    pipeline = _pipeline(replace(setup, table_error=math.sqrt(3.0), mounting_error=math.sqrt(3.0)), "scalar")
    once, twice = pipeline.by_table + pipeline.by_mounting, pipeline.twice[2]
    out = {}
    for group in ("gyro.scale", "gyro.axis"):
        of = np.ix_(_members(group), np.arange(12, len(NAMES)))
        c1, c2 = (_rms(matrix[of] @ pipeline.spread[12:] ** 2) / _spread(setup, group) for matrix in (once, twice))
        out[group] = (c1, c2)
    return out


# -------------------- linear pieces --------------------


def _apply(matrix: Array, vector: Array) -> Array:
    """Matrices (..., p, q) times vectors (..., q)."""
    return np.asarray(np.einsum("...pq,...q->...p", matrix, vector))


def _dot(left: Array, right: Array) -> Array:
    return np.asarray(np.einsum("...p,...p->...", left, right))


def _transposed(matrix: Array) -> Array:
    return np.swapaxes(np.asarray(matrix), -1, -2)


def _solved(rows: Array, right: Array) -> Array:
    """Least squares (..., m) of rows (..., r, m) for right-hand sides (..., r)."""
    return _apply(np.asarray(np.linalg.pinv(rows), dtype=float), right)


def _swept(axis: Array, angle: Array, vector: Array) -> Array:
    """∫ R v dΘ (..., 3) over a rotation by `angle` about `axis`: [Θ n nᵀ + sin Θ (I − n nᵀ) + (1 − cos Θ) [n×]] v."""
    along = axis * _dot(axis, vector)[..., None]
    Θ = np.asarray(angle)[..., None]
    return np.asarray(Θ * along + np.sin(Θ) * (vector - along) + (1.0 - np.cos(Θ)) * np.cross(axis, vector))


def _vee(matrix: Array) -> Array:
    """v (..., 3) of an antisymmetric matrix [v×] (..., 3, 3)."""
    return np.stack([matrix[..., 2, 1], matrix[..., 0, 2], matrix[..., 1, 0]], axis=-1)


def _placed(values: Array, places: Sequence[tuple[int, int]]) -> Array:
    """Matrices (..., 3, 3), zero but for values (..., m) at m places."""
    v = np.asarray(values, dtype=float)
    out = np.zeros((*v.shape[:-1], 3, 3))
    for i, (p, q) in enumerate(places):
        out[..., p, q] = v[..., i]
    return out


_DIAGONAL = ((0, 0), (1, 1), (2, 2))


def _accel_matrix_error(scale: Array, angles: Array) -> Array:
    """M (..., 3, 3) of k (..., 3) and γ_yx, γ_zx, γ_zy (..., 3)."""
    return _placed(scale, _DIAGONAL) + _placed(angles, _ACCEL_PAIRS)


def _gyro_matrix_error(scale: Array, angles: Array) -> Array:
    """E (..., 3, 3) of k (..., 3) and γ_xy, γ_xz, γ_yx, γ_yz, γ_zx, γ_zy (..., 6)."""
    return _placed(scale, _DIAGONAL) + _placed(angles, _GYRO_PAIRS)


def _angle_sums(angles: Array) -> Array:
    """Γ (..., 3, 3) of γ_yx, γ_zx, γ_zy: γ_pq + γ_qp."""
    lower = _placed(angles, _ACCEL_PAIRS)
    return lower + _transposed(lower)


def _second_order_matrix(scale: Array, angles: Array) -> Array:
    """What diag(1 + k) A(γ) has beyond I + M, to second order (..., 3, 3)."""
    Γ = _placed(angles, _ACCEL_PAIRS)
    return np.asarray(scale)[..., None] * Γ - 0.5 * _placed((Γ**2).sum(axis=-1), _DIAGONAL)


def _accelerometer_errors(values: Array, vertical: Array) -> Array:
    """Errors over g (..., 3) at rest of accelerometers with b, k, γ (..., 9), for verticals (..., 3) in the body."""
    v = np.asarray(values)
    return v[..., :3] + _apply(_accel_matrix_error(v[..., 3:6], v[..., 6:]), vertical)


_GYRO_BASIS = _gyro_matrix_error(np.eye(9)[:, :3], np.eye(9)[:, 3:])
"""E (9, 3, 3) of each of the gyros' k and γ, taken as 1."""
