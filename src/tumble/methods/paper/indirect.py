"""The indirect method, stage 4: what errors of the gyros do to the horizontal after a turn.

A series of turns starts from an attitude by TRIAD, which the gyros carry through the turns and which is held during
rests. Each turn by 180° leaves y = (Δf_N, Δf_E)/g, the change of the horizontal specific force from its start to its
end, computed with the carried attitude:

    y_N = −Δψ_E + Δα_N,   y_E = Δψ_N + Δα_E,   α = L(b + M Lᵀe_U)

with ψ the error of the carried attitude, L̂ = (I + [ψ×]) L, and α that of the accelerometers (b = δw/g, M = S − I).
A turn by Θ about the geographic unit vector n adds Eq. (6.2)

    Δψ = [Θ nnᵀ + sin Θ (I − nnᵀ) + (1 − cos Θ)[n×]] F n,   F = L₀ E L₀ᵀ,   E = S_G − I.

`programme_matrix` says it for the programmed attitudes, Eq. (6.3). The paper does not say in which directions it turns;
they decide whether biases of the accelerometers pass for scale-factor errors of the gyros: `check_directions`.

Arrays may have leading axes, for many launches at once. Columns of the gyros are k_x, k_y, k_z, γ_xy, γ_xz, γ_yx,
γ_yz, γ_zx, γ_zy; of the accelerometers b_x, b_y, b_z (rad), k_x, k_y, k_z, γ_yx, γ_zx, γ_zy.
Source: §6 of the turntable method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tumble.errors import ProgrammeError
from tumble.methods.paper.accuracy_formulas import (
    accelerometer_leakage,
    indirect_accelerometer_matrix,
    indirect_matrix,
)
from tumble.methods.paper.gyro_bias import carried
from tumble.programme.positions import Programme
from tumble.rotation import unit_vector
from tumble.units import DEGREE, Array

LEAK = 1e-6
"""Biases that enter scale factors with less than this coefficient cancel."""

_LEVEL = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""What of ψ and of α the two rows y_N, y_E are."""


# The programmed turns


def known_turns(programme: Programme) -> tuple[tuple[int, ...], ...]:
    """Series of turns with known axis and angle that follow each other: indices of the moves."""
    series: list[list[int]] = []
    for k, move in enumerate(programme.moves):
        if move.axis is None or move.angle is None:
            continue
        if series and series[-1][-1] == k - 1:
            series[-1].append(k)
        else:
            series.append([k])
    return tuple(tuple(s) for s in series)


def programme_matrix(programme: Programme) -> tuple[Array, Array]:
    """H_G and H_A (2T, 9), by which y of the T known turns depends on the errors of gyros and accelerometers, at
    the programmed attitudes: Eq. (6.3) for the turns by 180° of the rough-table programme. Terms of the order of
    Ω T (1.5e-3) are left out, as in the paper."""
    if not known_turns(programme):
        return np.empty((0, 9)), np.empty((0, 9))
    return indirect_matrix(programme), indirect_accelerometer_matrix(programme)


# Directions of the turns


def check_directions(programme: Programme) -> None:
    """Raise ProgrammeError if the known turns of a programme do not determine the nine gyro parameters, or if
    accelerometer biases leak into the gyro scale factors, as with (+N, +U, +N), (+N, −N, +U) and (+U, +N, −N), where
    k takes up 2/π of them. The paper does not state the directions of its turns."""
    H_G, _ = programme_matrix(programme)
    rank = int(np.linalg.matrix_rank(H_G)) if len(H_G) else 0
    described = "; ".join(
        ", ".join(
            f"{'NUE'[int(np.argmax(np.abs(move.axis)))]}{move.angle / DEGREE:+.0f}"
            for move in (programme.moves[k] for k in series)
            if move.axis is not None and move.angle is not None
        )
        for series in known_turns(programme)
    )
    advice = "take the programme rough-table or the method staged"
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


# The turns as they were


@dataclass(frozen=True, kw_only=True, slots=True)
class RecordedTurn:
    """One recorded turn of a series: its index, the rests before and after it, and whether it is a turn of the
    programme, which counts, or what happened between two rests in the same position."""

    turn: int
    first: int
    last: int
    counts: bool


Series = tuple[RecordedTurn, ...]


def carried_attitudes(series: Series, attitude: Array, C: Array, duration: Array, earth_rate: Array) -> list[Array]:
    """Attitudes (..., 3, 3) of a series before its first turn and after each: the start is that of the rest before
    the first turn, of attitudes (..., N, 3, 3), held during rests and carried by the turns C (..., K, 3, 3)."""
    found = [attitude[..., series[0].first, :, :]]
    for t in series:
        found.append(carried(found[-1], C[..., t.turn, :, :], earth_rate, float(duration[t.turn])))
    return found


def horizontal_differences(
    course: Sequence[Series], attitude: Array, force: Array, C: Array, duration: Array, earth_rate: Array
) -> Array:
    """y (..., 2T): change of the north and east specific force, in units of its modulus, over every turn that counts.
    `attitude` (..., N, 3, 3) by TRIAD and `force` (..., N, 3) are those of the rests. §6.2."""
    f = unit_vector(force)
    rows = []
    for series in course:
        L = carried_attitudes(series, attitude, C, duration, earth_rate)
        for j, t in enumerate(series):
            if t.counts:
                change = L[j + 1] @ f[..., t.last, :, None] - L[j] @ f[..., t.first, :, None]
                rows.append((_LEVEL @ change)[..., 0])
    return np.concatenate(rows, axis=-1)
