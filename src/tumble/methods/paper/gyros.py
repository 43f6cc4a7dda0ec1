"""Stages 3 and 4 of the methods of the turntable paper: biases of gyros from rests, and their scale factors and axis
angles from turns.

Stage 3 compares the readings of gyros at rest with the Earth's rate Ω in the attitude by TRIAD, Eq. (16). A bias is the
reading less ω = L̂ᵀΩ if the axis of the gyro is vertical, Eq. (18). An error δw of the accelerometers leaves
Ω cos B δw/g. The scalar method for gyros of the paper holds for small biases only (studies/accuracy_formulas.py).

Stage 4, the indirect method, uses the error of the horizontal after a turn. A series of turns starts from an attitude
by TRIAD, which the gyros carry through the turns and which is held during rests. Each turn by 180° gives
y = (Δf_N, Δf_E)/g, the change of the horizontal specific force from its start to its end in the carried attitude:

    y_N = −Δψ_E + Δα_N,   y_E = Δψ_N + Δα_E,   α = L(b + M Lᵀe_U)

where ψ is the error of the carried attitude, L̂ = (I + [ψ×]) L, and α that of the accelerometers (b = δw/g, M = S − I).
`programme_matrix` is Eq. (6.3), for the attitudes of the programme. The paper does not state the directions of its
turns, which decide whether biases of the accelerometers affect scale factors of the gyros: see `check_directions`.

All functions take any leading axes: rates ω̂ and specific forces (..., N, 3) of N rests in the body frame, `earth_rate`
(3,) Ω in N, U, E. Columns of the gyros are k_x, k_y, k_z, γ_xy, γ_xz, γ_yx, γ_yz, γ_zx, γ_zy; of the accelerometers
b_x, b_y, b_z (rad), k_x, k_y, k_z, γ_yx, γ_zx, γ_zy. Source: §5, §6 of the turntable paper.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice, pairwise

import numpy as np

from tumble.errors import ProgrammeError
from tumble.methods.paper.accelerometers import VERTICAL
from tumble.methods.paper.blocks import in_body
from tumble.programme.positions import Programme
from tumble.rotation import rotation_matrix, unit_vector
from tumble.sensors.model import ACCEL_ANGLES, PERFECT_TRIAD
from tumble.units import DEGREE, Array, BoolArray

LEAK = 1e-6  # largest coefficient with which biases that cancel enter scale factors
_LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # selects north and east
_PAIRS = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))  # of γ_xy, γ_xz, γ_yx, γ_yz, γ_zx, γ_zy in E and M


# Stage 3


def triad(force: Array, rate: Array) -> Array:
    """Return the attitude body → geographic N, U, E (..., 3, 3) from specific force and Earth's rate at rest:
    e_U ∥ ŵ, e_E ∥ ω̂ × e_U, e_N = e_U × e_E."""
    east = unit_vector(np.cross(rate, unit_vector(force)))
    up = np.broadcast_to(unit_vector(force), east.shape)
    return np.stack([np.cross(up, east), up, east], axis=-2)


def vector_bias(rate: Array, force: Array, earth_rate: Array, axes: Array = PERFECT_TRIAD.matrix) -> Array:
    """Return the bias (..., N, n), rad/s, of every gyro in every rest: ω̂ − L̂ᵀΩ with L̂ by TRIAD, Eq. (16).

    Rates (..., N, n) are along sensing axes (n, 3). The bias holds along the polar axis, where sensor errors are
    multiplied by deviations from the programme, Eq. (17), and along the vertical, Eq. (18). At the polar axis TRIAD
    leaves −δω_E²/2Ω, which is not in the paper (1.8 % of 0.3 °/h)."""
    return np.asarray(rate - earth_rate @ triad(force, in_body(axes, rate)) @ axes.T)


def vertical_bias(
    rate: Array, force: Array, earth_rate: Array, nominal: Array, axes: Array = PERFECT_TRIAD.matrix
) -> Array:
    """Return the bias (..., n) by the vector method, Eq. (18): the mean over rests with the nominal vertical (N, 3)
    along the axis of the gyro. Rates (..., N, n) are along sensing axes (n, 3)."""
    bias, vertical = vector_bias(rate, force, earth_rate, axes), along_vertical(nominal, axes)
    return np.stack([bias[..., vertical[:, q], q].mean(axis=-1) for q in range(len(axes))], axis=-1)


def along_vertical(nominal: Array, axes: Array) -> BoolArray:
    """Return whether axes (n, 3) are up or down in positions with verticals (N, 3) in the body: (N, n)."""
    return np.asarray(np.abs(nominal @ axes.T) > 1.0 - VERTICAL)


# Stage 4: the turns of a programme


def known_turns(programme: Programme) -> tuple[tuple[int, ...], ...]:
    """Return the indices of the moves of each series of consecutive turns with known axis and angle."""
    known = [k for k, move in enumerate(programme.moves) if move.axis is not None and move.angle is not None]
    starts = [i for i, k in enumerate(known) if i == 0 or known[i - 1] != k - 1]
    return tuple(tuple(known[i:j]) for i, j in pairwise([*starts, len(known)]))


def axes_and_angles(programme: Programme) -> tuple[Array, Array]:
    """Return the geographic axes (K, 3) and angles (K,), rad, of the known turns of a programme."""
    moves = [programme.moves[k] for series in known_turns(programme) for k in series]
    axes, angles = [move.axis for move in moves], [move.angle for move in moves]
    return np.array(axes, dtype=float).reshape(-1, 3), np.array(angles, dtype=float)


def matrix_error(scale: Array, angles: Array) -> Array:
    """Return M or E (..., 3, 3), to first order, for k (..., 3) and angles γ_yx, γ_zx, γ_zy (..., 3) of accelerometers
    or γ_xy, γ_xz, γ_yx, γ_yz, γ_zx, γ_zy (..., 6) of gyros."""
    pairs = [_PAIRS[i] for i in (ACCEL_ANGLES if angles.shape[-1] == len(ACCEL_ANGLES) else range(6))]
    out = np.zeros((*angles.shape[:-1], 3, 3))
    out[..., [0, 1, 2], [0, 1, 2]] = scale
    out[..., [p for p, _ in pairs], [q for _, q in pairs]] = angles
    return out


def turn_error(attitude: Array, axis: Array, angle: Array, E: Array) -> Array:
    """Return the attitude error Δψ = ∫ R dΘ L E Lᵀ n (..., 3), rad, about N, U, E, Eq. (6.2).

    It is due to errors E (..., 3, 3) of the gyros in a turn by `angle` (...), rad, about the geographic unit vector
    `axis` n (..., 3) from `attitude` L (..., 3, 3), at any rate."""
    L, n = np.asarray(attitude), np.asarray(axis)
    return swept(n, angle, (L @ E @ np.swapaxes(L, -1, -2) @ n[..., None])[..., 0])


def swept(axis: Array, angle: Array, vector: Array) -> Array:
    """Return ∫ R v dΘ (..., 3) over a rotation by `angle` Θ about `axis` n:
    [Θ n nᵀ + sin Θ (I − n nᵀ) + (1 − cos Θ) [n×]] v."""
    along = axis * (axis * vector).sum(axis=-1, keepdims=True)
    Θ = np.asarray(angle)[..., None]
    return np.asarray(Θ * along + np.sin(Θ) * (vector - along) + (1.0 - np.cos(Θ)) * np.cross(axis, vector))


def programme_matrix(programme: Programme) -> tuple[Array, Array]:
    """Return the derivatives H_G and H_A (2T, 9) of y of T known turns by the errors of gyros and accelerometers.

    They are at the attitudes of the programme, Eq. (6.3), without terms of the order of Ω T (1.5e-3), as in the paper.
    """
    first = np.array([k for series in known_turns(programme) for k in series], dtype=np.int64)
    L = np.array([position.matrix for position in programme.positions]).reshape(-1, 3, 3)
    axis, angle = axes_and_angles(programme)
    unit = np.eye(9)[:, None]
    ψ = turn_error(L[first], axis, angle, matrix_error(unit[..., :3], unit[..., 3:]))
    M, up = matrix_error(unit[..., 3:6], unit[..., 6:]), np.broadcast_to(L[:, 1], (9, len(L), 3))
    α = (L @ (unit[..., :3] + (M @ up[..., None])[..., 0])[..., None])[..., 0]
    tilt = np.stack([-ψ[..., 2], ψ[..., 0]], axis=-1)
    return tilt.reshape(9, -1).T, ((α[:, first + 1] - α[:, first]) @ _LEVEL.T).reshape(9, -1).T


def recorded_matrix(course: Sequence[Series], attitude: Array, M: Array) -> Array:
    """Return the derivatives (2T, 9) of y of recorded turns by the errors of gyros, Eq. (6.1): ψ = L (M : E).

    `attitude` (N, 3, 3) are those of the rests, M (K, 3, 3, 3) the sensitivities of the turns."""
    counted = [t for series in course for t in series if t.counts]
    first, k = [t.first for t in counted], [t.turn for t in counted]
    p, q = np.transpose([*((i, i) for i in range(3)), *_PAIRS])
    ψ = attitude[first] @ M[k][..., p, q]
    return np.stack([-ψ[:, 2], ψ[:, 0]], axis=1).reshape(-1, 9)


def spare_sensitivities(integral: Array, axes: Array) -> Array:
    """Return the sensitivity errors (..., n, 3) of n gyros that no rate explains, zero for three gyros.

    They are fitted to the integrals (..., K, n), rad, of compensated readings along `axes` (n, 3) over turns, by least
    squares over the rotations about the body axes."""
    turned = in_body(axes, integral)
    spare = integral - turned @ axes.T
    across = np.swapaxes(turned, -1, -2)
    return np.swapaxes(np.linalg.solve(across @ turned, across @ spare), -1, -2)


def accelerometer_leakage(programme: Programme) -> Array:
    """Return the errors (9, 9) of k (3) and γ (6) of the gyros per unit error of b, k, γ of the accelerometers, by the
    matrix of the programme, §6.3."""
    H_G, H_A = programme_matrix(programme)
    return np.asarray(np.linalg.pinv(H_G) @ H_A)


def check_directions(programme: Programme) -> None:
    """Raise ProgrammeError unless the known turns of a programme determine the nine gyro parameters and accelerometer
    biases cancel in the scale factors. With (+N, +U, +N), k takes up 2/π of them."""
    H_G, _ = programme_matrix(programme)
    rank = int(np.linalg.matrix_rank(H_G)) if len(H_G) else 0
    known = axes_and_angles(programme)
    turns = (f"{'NUE'[int(np.argmax(np.abs(n)))]}{Θ / DEGREE:+.0f}" for n, Θ in zip(*known, strict=True))
    described = "; ".join(", ".join(islice(turns, len(series))) for series in known_turns(programme))
    advice = "take the programme rough-table or the method joint"
    if rank < 9:
        raise ProgrammeError(
            f"programme {programme.name}: expected known turns that determine nine gyro scale factors and angles, "
            f"found {rank} from {described or 'none'}; {advice}"
        )
    leak = float(np.abs(accelerometer_leakage(programme)[:3, :3]).max())
    if leak > LEAK:
        raise ProgrammeError(
            f"programme {programme.name}: expected turns in whose directions accelerometer biases cancel in the gyro "
            f"scale factors, found {described}, which pass on {leak:.2f} of a bias in g; turn back the second time "
            "about the same axis, as in N+180, U+180, N-180"
        )


# Stage 4: recorded turns


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordedTurn:
    """A recorded turn of a series."""

    turn: int  # index of the turn
    first: int  # rest before it
    last: int  # rest after it
    counts: bool  # False if both rests are in the same position


Series = tuple[RecordedTurn, ...]


def carried(attitude: Array, C: Array, earth_rate: Array, seconds: Array | float) -> Array:
    """Return the attitude exp(−[Ω T×]) L C (..., 3, 3) after a move by C in T `seconds`.

    C is body at the end → body at the start in the inertial frame; the geographic frame turns by Ω T."""
    return np.asarray(rotation_matrix(-earth_rate * seconds) @ attitude @ C)


def horizontal_differences(
    course: Sequence[Series], attitude: Array, force: Array, C: Array, duration: Array, earth_rate: Array
) -> Array:
    """Return y (..., 2T), the change of the north and east specific force relative to its modulus, in every turn that
    counts, §6.2.

    `attitude` (..., N, 3, 3) is by TRIAD. That before the first turn of a series is held during rests and carried by
    the turns C (..., K, 3, 3); `force` (..., N, 3) is that of the rests."""
    f, rows = unit_vector(force), []
    for series in course:
        after = attitude[..., series[0].first, :, :]
        for t in series:
            before, after = after, carried(after, C[..., t.turn, :, :], earth_rate, float(duration[t.turn]))
            if t.counts:
                change = after @ f[..., t.last, :, None] - before @ f[..., t.first, :, None]
                rows.append((_LEVEL @ change)[..., 0])
    return np.concatenate(rows, axis=-1)
