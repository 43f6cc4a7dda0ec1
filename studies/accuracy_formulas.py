"""The paper's accuracy formulas: what errors of table, mounting and sensors do to each estimate, one function each.

They are numbered as in Vodicheva & Parysheva (Giroskopiya i Navigatsiya 27, 2(105), 2019), with the corrections of the
turntable method (§ are its sections). The program differentiates the methods themselves instead
(`tumble.planning.pass_errors`). Here they are held against simulations and the published numbers
(tests/planning/test_accuracy.py, studies/formulas_against_simulation.py).

Symbols: b = δw/g, bias of an accelerometer as an angle, rad; k, γ scale-factor error and axis angles; M, E matrix
errors of accelerometers and gyros; u vertical in the body; L attitude body → geographic N, U, E; ψ attitude error,
L̂ = (I + [ψ×]) L; Γ_pq = γ_pq + γ_qp. Arrays of vectors have the components last.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from tumble.earth import EARTH_RATE, earth_rate
from tumble.methods.least_squares import solve_least_squares
from tumble.methods.paper.gyros import matrix_error, swept, triad
from tumble.rotation import rotation_matrix
from tumble.units import Array

_N, _U, _E = 0, 1, 2


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


def redundant_up_down_errors(
    axes: Array, up: Array, down: Array, bias: Array, scale: Array, leans: Array
) -> tuple[Array, Array]:
    """Errors Δk (n,) and Δδw/g (n,), rad, of n accelerometers along any axes, levelled by all of them: what Eq. (7a) is
    with D⁺ ε, the levelling error by least squares, in place of that of the two horizontal ones,

        Δk = ½ [λ·(t₁ − t₂) + t₁·D⁺ε₁ + t₂·D⁺ε₂],   Δδw/g = ½ [λ·(t₁ + t₂) + t₁·D⁺ε₁ − t₂·D⁺ε₂]

    and ε_q = b_q ± (k_q d_q + λ_q)·d.

    Parameters
    ----------
    axes : (n, 3)
        Nominal sensing axes d, of D the rows.
    up, down : (n, 3)
        Tilts t₁, t₂ of the vertical across each axis in the rests with this axis up and down.
    bias, scale : (n,)
        b, rad, and k.
    leans : (n, 3)
        λ, by which the sensing axes are off the nominal ones, rad.
    """
    along = scale[:, None] * axes @ axes.T + leans @ axes.T  # of sensor q in the rests of sensor p
    first, second = ((bias[:, None] + sign * along).T @ np.linalg.pinv(axes).T for sign in (1.0, -1.0))
    first, second = dot(up, first), dot(down, second)
    return 0.5 * (dot(leans, up - down) + first + second), 0.5 * (dot(leans, up + down) + first - second)


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


def coefficient_error(matrix: Array, change: Array, parameters: Array) -> Array:
    """Error ΔX (9,) of the scalar method when H (N, 9) is taken wrong by δH (N, 9): Eq. (14)."""
    return -solve_least_squares(matrix, change @ parameters)


def scalar_residuals(vertical: Array, bias: Array, scale: Array, angles: Array) -> tuple[Array, Array]:
    """What (ŵ² − g²)/2g² − h(û) X is at a rest, to second order in the parameters (..., 3), in two parts (...): from
    linearising Eqs. (1) and (12), and from the estimated orientation û = ŵ/|ŵ| in h. §4; b and γ in rad.

    With (|ŵ| − g)/g in place of the quadratic form the first part has the square of e across the vertical only."""
    u, M, Γ = np.asarray(vertical), matrix_error(scale, angles), matrix_error(np.zeros(3), angles)
    e = bias + applied(M, u)
    across = e - u * dot(u, e)[..., None]
    second_order = np.asarray(scale)[..., None] * Γ - 0.5 * (Γ**2).sum(axis=-1)[..., None] * np.eye(3)
    linearisation = 0.5 * dot(e, e) + dot(u, applied(second_order, u))  # diag(1 + k) A(γ) beyond I + M
    return linearisation, -dot(across, across) - dot(applied(transposed(M), u), across)


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
    a, d = applied(attitude, accel_error), applied(attitude, gyro_error)
    return np.stack([-a[..., _E], d[..., _E] / north - a[..., _E] * up / north, a[..., _N]], axis=-1)


def reference_rate_error(attitude: Array, accel_error: Array, gyro_error: Array, latitude: float) -> Array:
    """Error (..., 3), rad/s, of the Earth's rate in the body as TRIAD gives it: Eq. (16). The bias found is the true
    one less this. Arguments as in `triad_error`; the accelerometers' error to the east cancels."""
    north, up, _ = earth_rate(latitude)
    a, d = applied(attitude, accel_error), applied(attitude, gyro_error)
    error = np.stack([up * a[..., _N], -north * a[..., _N], d[..., _E]], axis=-1)
    return applied(transposed(attitude), error)


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


def scalar_bias(rate: Array, force: Array, earth_rate: Array) -> Array:
    """Bias (..., 3) by the scalar method, as Eqs. (12), (13) with the estimated orientation: least squares of
    (ω̂² − Ω²)/2Ω = û^Ω·δω, û^Ω = L̂ᵀΩ/Ω.

    Its error (δω_N² + δω_U² − δω_E²)/2Ω cancels over a programme in which the sensors stand both ways."""
    Ω = float(np.linalg.norm(earth_rate))
    polar = earth_rate @ triad(force, rate) / Ω
    return solve_least_squares(polar, ((rate**2).sum(axis=-1) - Ω**2) / (2.0 * Ω))


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


def gyro_matrix_rate_error(attitude: Array, E: Array, latitude: float) -> Array:
    """Gyro error E Lᵀ Ω (..., 3), rad/s, in the body, that scale-factor and axis errors E (..., 3, 3) cause at rest:
    stage 3 takes it for bias before stage 4 has found E.

    The vector method sees of it what lies in the meridian plane (the part to the east turns TRIAD's azimuth), the
    scalar method the part along Ω, the dot product the part along the vertical. For E of 1e-4 it is 1.5e-3 °/h, one
    or two orders less than the bias, as the paper says; up and down it cancels but for E_pq × tilt."""
    L = np.asarray(attitude)
    return applied(E, applied(transposed(L), np.array(earth_rate(latitude))))


# -------------------- scale factors and axis angles of the gyros: the indirect method --------------------


def turn_bias_error(attitude: Array, axis: Array, angle: Array, duration: Array, bias: Array) -> Array:
    """Attitude error Δψ (..., 3), rad, that gyro biases (..., 3), rad/s, make in a turn of `duration` (...), s, at
    constant rate; other arguments as in `turn_error`. §6.2."""
    per_radian = np.asarray(duration) / np.asarray(angle)
    return swept(np.asarray(axis), angle, applied(attitude, bias)) * per_radian[..., None]


def turn_earth_error(attitude: Array, axis: Array, angle: Array, duration: Array, E: Array, latitude: float) -> Array:
    """Attitude error Δψ (..., 3), rad, that the Earth's rate times gyro errors E makes in a turn at constant rate, of
    order ΩT E: what the programme's matrix (6.3) leaves out. Arguments as in `turn_error`. §6.2."""
    L, n = np.asarray(attitude), np.asarray(axis)
    F = L @ E @ transposed(L)
    earth = np.array(earth_rate(latitude))
    total = np.zeros(np.broadcast_shapes(F.shape[:-1], n.shape))
    for node, weight in zip(*_LEGENDRE, strict=True):
        R = rotation_matrix(np.asarray(0.5 * (1.0 + node) * np.asarray(angle))[..., None] * n)
        total = total + 0.5 * weight * applied(R @ F @ transposed(R), earth)
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


# -------------------- linear pieces --------------------


def applied(matrix: Array, vector: Array) -> Array:
    """Matrices (..., p, q) times vectors (..., q)."""
    return np.asarray(np.einsum("...pq,...q->...p", matrix, vector))


def dot(left: Array, right: Array) -> Array:
    return np.asarray(np.einsum("...p,...p->...", left, right))


def transposed(matrix: Array) -> Array:
    return np.swapaxes(np.asarray(matrix), -1, -2)


def _angle_sums(angles: Array) -> Array:
    """Γ (..., 3, 3) of γ_yx, γ_zx, γ_zy: γ_pq + γ_qp."""
    lower = matrix_error(np.zeros(3), np.asarray(angles))
    return lower + transposed(lower)


def accelerometer_errors(values: Array, vertical: Array) -> Array:
    """Errors over g (..., 3) at rest of accelerometers with b, k, γ (..., 9), for verticals (..., 3) in the body."""
    v = np.asarray(values)
    return v[..., :3] + applied(matrix_error(v[..., 3:6], v[..., 6:]), vertical)
