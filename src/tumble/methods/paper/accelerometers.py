"""Stages 1 and 2 of the methods of the turntable paper: accelerometers at rest.

Sequential vector method. Stage 1 gives bias and scale-factor error of one accelerometer from rests in which its axis is
up and down, Eqs. (3), (4). Stage 2 gives the angle between two axes from a rest in which one is 45° above and the other
45° below the horizon, Eqs. (8), (10), and from it the axis angles γ, Eq. (2). As nothing is solved jointly, the
functions also serve redundant blocks with axes of any directions.

Scalar method. |ŵ| at rest is g in any attitude. The coefficients of Eq. (13) need the attitude: that of the programme,
with errors of the order of the parameters times the deviations from the programme, or the estimated one, with errors of
second order in the parameters.

All functions take any leading axes. Source: §2 to §4 of the turntable paper (Vodicheva & Parysheva 2019).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from tumble.errors import ProgrammeError
from tumble.methods.least_squares import solve_least_squares
from tumble.methods.paper.blocks import TRIAD, axis_rotations, in_body, sensing_axes, turned_axes
from tumble.programme.positions import code_of_vertical
from tumble.rotation import unit_vector
from tumble.sensors.model import Block, SensorModel, triad_model
from tumble.units import Array, BoolArray

VERTICAL = 1e-6  # largest 1 − cosine of a nominal axis that counts as vertical, 0.08°
SYMMETRIC = 1e-3  # largest difference of the cosines of two nominal axes that count as symmetric
LEAST_SINE = 0.1  # of the angle between axes that span a plane
INDEPENDENT = 0.05  # least singular value of angles between axes, per axis angle, that determine these
ROUNDS = 12  # corrections of axis angles of some degrees down to rounding

Pair = tuple[int, int]
PAIRS: tuple[Pair, ...] = ((0, 1), (0, 2), (1, 2))  # axes between which the angles yx, zx, zy are


# The sequential vector method


def bias_and_scale(readings: Array, cosines: Array, gravity: Array | float) -> tuple[Array, Array]:
    """Return bias, m/s², and scale-factor error (...) of one accelerometer, Eqs. (3), (4).

    The readings (..., K) are from K ≥ 2 rests in which its axis has these cosines with the vertical. Two rests give
    (4), more the least-squares line through (3). With cosines of ±1 instead of `levelled_cosines`, errors of half the
    square of the tilt remain in all iterations."""
    mean_cosine = cosines.mean(axis=-1, keepdims=True)
    spread = cosines - mean_cosine
    slope = (spread * readings).sum(axis=-1) / (spread**2).sum(axis=-1)
    bias = readings.mean(axis=-1) - slope * mean_cosine[..., 0]
    return np.asarray(bias), np.asarray(slope / gravity - 1.0)


def levelled_cosines(force: Array, axes: Array) -> Array:
    """Return the cosines d·û (..., N, n) of sensing axes (n, 3) with the vertical by the accelerometers, which have
    the error of Eq. (7)."""
    return np.asarray(unit_vector(force) @ axes.T)


def angle_between(above: Array, below: Array, across: Array | float, gravity: Array | float) -> Array:
    """Return the angle φ, rad, between two sensing axes on one side of the vertical, Eq. (10):
    φ = |arccos(ŵ_η/√(g² − ŵ_ζ²)) − arccos(ŵ_ξ/√(g² − ŵ_ζ²))|.

    `across` is the specific force ŵ_ζ along the normal of their plane; zero gives Eq. (8)."""
    in_plane = np.sqrt(gravity**2 - np.asarray(across) ** 2)
    return np.asarray(np.abs(np.arccos(below / in_plane) - np.arccos(above / in_plane)))


def axis_angles(between_xy: Array, between_xz: Array, between_yz: Array) -> Array:
    """Return the axis angles γ_yx, γ_zx, γ_zy (..., 3), rad, from the angles between the axes: the inverse of Eq. (2),
    whose third line is exact here."""
    yx, zx = 0.5 * np.pi - between_xy, 0.5 * np.pi - between_xz
    sine = (np.cos(between_yz) - np.sin(yx) * np.sin(zx)) / (np.cos(yx) * np.cos(zx))
    return np.stack([yx, zx, np.arcsin(sine)], axis=-1)


def by_vector(readings: Array, nominal: Array, gravity: Array, block: Block = TRIAD) -> SensorModel:
    """Return the model of a block of accelerometers by stages 1 and 2; stage 2 uses readings corrected by stage 1.

    Parameters
    ----------
    readings : (..., N, n)
        Specific forces at rest along the sensing axes, m/s².
    nominal : (N, 3)
        Verticals of the programme in the body.
    gravity : (...)
        Gravity, m/s².
    block
        The accelerometers, three or more with axes of any directions.
    """
    axes, biases, scales = sensing_axes(block), list[Array](), list[Array]()
    cosines = levelled_cosines(in_body(axes, readings), axes)
    for p, along in enumerate((nominal @ axes.T).T):
        vertical = np.abs(along) > 1.0 - VERTICAL
        bias, scale = bias_and_scale(readings[..., vertical, p], cosines[..., vertical, p], gravity)
        biases.append(bias)
        scales.append(scale)
    bias, scale = np.stack(biases, axis=-1), np.stack(scales, axis=-1)
    corrected, between = (readings - bias[..., None, :]) / (1.0 + scale[..., None, :]), dict[Pair, Array]()
    for pair in oblique_pairs(nominal, axes):  # the mean over its rests
        rests, side = oblique(nominal, axes, pair)
        w, normal = corrected[..., rests, :], normal_of(axes, pair)
        across = in_body(axes, w) @ normal
        angles = angle_between(w[..., pair[0]], side * w[..., pair[1]], across, np.asarray(gravity)[..., None])
        between[pair] = np.asarray(np.where(side > 0.0, angles, np.pi - angles).mean(axis=-1))
    if block.triad:
        return triad_model(bias, scale, axis_angles(*(between[pair] for pair in PAIRS)))
    turned = turned_axes(block, angles_of_pairs(block, between))
    return SensorModel(matrix=(1.0 + scale)[..., None] * turned, bias=bias)


def normal_of(axes: Array, pair: Pair) -> Array:
    """Return the unit normal (3,) of the plane of two sensing axes."""
    return unit_vector(np.cross(axes[pair[0]], axes[pair[1]]))


def oblique(nominal: Array, axes: Array, pair: Pair) -> tuple[BoolArray, float]:
    """Return the rests (N,) in which two axes are in a vertical plane and symmetric, and about what they are so.

    By Eq. (9) it is best about the horizon (side 1) for angles of at most 90° between them, and about the vertical
    (side −1) for larger ones."""
    first, second = nominal @ axes[pair[0]], nominal @ axes[pair[1]]
    side = 1.0 if axes[pair[0]] @ axes[pair[1]] > -SYMMETRIC else -1.0
    symmetric = np.abs(first + side * second) < SYMMETRIC
    return np.asarray(symmetric & (np.abs(nominal @ normal_of(axes, pair)) < SYMMETRIC)), side


def every_pair(axes: Array) -> list[Pair]:
    """Return the pairs of sensing axes (n, 3) that span a plane."""
    pairs = combinations(range(len(axes)), 2)
    return [(p, q) for p, q in pairs if np.linalg.norm(np.cross(axes[p], axes[q])) > LEAST_SINE]


def oblique_pairs(nominal: Array, axes: Array) -> list[Pair]:
    """Return the pairs of sensing axes between which a programme measures the angle."""
    return [pair for pair in every_pair(axes) if oblique(nominal, axes, pair)[0].any()]


def by_axis_angles(block: Block, pairs: Sequence[Pair]) -> Array:
    """Return the derivatives (r, a) of the angles between pairs of axes by the axis angles, at the nominal axes."""
    moved = np.cross(np.swapaxes(axis_rotations(block), 1, 2), block.axes[:, None])  # (n, a, 3)
    p, q = np.array(pairs, dtype=int).reshape(-1, 2).T
    axes = block.axes[:, :, None]
    changed = (moved[p] @ axes[q] + moved[q] @ axes[p])[..., 0]  # of the cosines
    return np.asarray(-changed / np.linalg.norm(np.cross(block.axes[p], block.axes[q]), axis=1)[:, None])


def angles_of_pairs(block: Block, between: Mapping[Pair, Array]) -> Array:
    """Return the axis angles (..., a), rad, of a block from the angles (...) between pairs of axes by least squares, as
    Eq. (2) does for a triad."""
    p, q = np.array(list(between)).T
    measured = np.stack(list(between.values()), axis=-1)
    inverse = np.linalg.pinv(by_axis_angles(block, list(between)))
    angles = np.zeros((*measured.shape[:-1], len(inverse)))
    for _ in range(ROUNDS):
        axes = turned_axes(block, angles)
        cosines = (axes[..., p, :] * axes[..., q, :]).sum(axis=-1)
        angles = angles + (measured - np.arccos(cosines)) @ inverse.T
    return angles


def verticals(block: Block) -> dict[str, Array]:
    """Return the verticals (3,) in the body of the paper's programme for a block, by their purpose: every axis up and
    down, and the fewest pairs of axes that determine the axis angles, each in a vertical plane."""
    axes, names = sensing_axes(block), list("XYZ") if block.triad else [f"accelerometer {p}" for p in block.sensors]
    out = {f"{name} up": axis for name, axis in zip(names, axes, strict=True)}
    out |= {f"{name} down": -axis for name, axis in zip(names, axes, strict=True)}
    pairs = list[Pair]()
    for pair in every_pair(axes):
        rows = by_axis_angles(block, [*pairs, pair])
        if len(rows) <= len(block.angles) and np.linalg.svd(rows, compute_uv=False)[-1] > INDEPENDENT:
            pairs.append(pair)
    oblique_verticals: dict[str, Array] = {}
    for p, q in pairs:
        side = oblique(axes, axes, (p, q))[1]
        vertical = unit_vector(axes[p] - side * axes[q])
        above = f"{np.degrees(np.arcsin(axes[p] @ vertical)):.0f}°"
        name = f"{names[p]} {above} above and {names[q]} {above} {'below' if side > 0.0 else 'above'} the horizon"
        if all(
            abs(vertical @ other) < 1.0 - VERTICAL for other in oblique_verticals.values()
        ):  # one may serve two pairs
            oblique_verticals[name] = vertical
    return out | oblique_verticals


def check_for_vector(nominal: Array, block: Block = TRIAD) -> None:
    """Raise ProgrammeError unless verticals (N, 3) are along every axis, and oblique to pairs for all axis angles."""
    block = TRIAD if block.triad else block
    axes, wanted = block.axes, verticals(block)
    rows = by_axis_angles(block, oblique_pairs(nominal, axes))
    determined = len(rows) > 0 and np.linalg.matrix_rank(rows, INDEPENDENT) == len(block.angles)
    needed = list(wanted.items())[: 2 * len(axes) if determined else None]
    missing = [name for name, vertical in needed if (nominal @ vertical).max() <= 1.0 - VERTICAL]
    if missing:
        codes = ", ".join(f'"{code_of_vertical(vertical)}"' for vertical in wanted.values())
        advice = "take the programme rough-table" if block.triad else f"list the positions {codes}"
        raise ProgrammeError(
            f"method sequential: expected rests with {'; '.join(missing)}, found none in the programme; "
            f"{advice}, or take the method joint"
        )


# The scalar method


def scalar_rows(u: Array) -> Array:
    """Return the rows h (..., 9) of Eq. (13) for verticals u (..., 3) in the body: derivatives of (|ŵ| − g)/g with
    respect to δw/g, k, γ_yx, γ_zx, γ_zy. All angles have a plus; the sign in (12) is not legible."""
    products = u[..., [1, 2, 2]] * u[..., [0, 0, 1]]
    return np.concatenate([u, u**2, products], axis=-1)


def scalar_fit(readings: Array, verticals: Array, gravity: Array) -> SensorModel:
    """Return the model of a triad by least squares of (ŵ² − g²)/2g², Eqs. (12), (13).

    Readings (..., N, 3) are from N ≥ 9 rests, with the verticals (..., N, 3) of the programme or of
    `unit_vector(readings)`. The model is exact, Eq. (1)."""
    g = np.asarray(gravity)[..., None]
    X = solve_least_squares(scalar_rows(verticals), ((readings**2).sum(axis=-1) - g**2) / (2.0 * g**2))
    return triad_model(np.asarray(gravity)[..., None] * X[..., :3], X[..., 3:6], X[..., 6:])


def by_modulus_nominal(readings: Array, nominal: Array, gravity: Array, _: Block = TRIAD) -> SensorModel:
    """Return the model of stages 1 and 2 together, with the orientation of the programme."""
    return scalar_fit(readings, np.broadcast_to(nominal, readings.shape), gravity)


def by_modulus(readings: Array, _: Array, gravity: Array, __: Block = TRIAD) -> SensorModel:
    """Return the model of stages 1 and 2 together, with the estimated orientation."""
    return scalar_fit(readings, unit_vector(readings), gravity)


def check_for_modulus(nominal: Array, _: Block = TRIAD) -> None:
    """Raise ProgrammeError unless |ŵ| at rests with these verticals (N, 3) determines all nine parameters."""
    rank = int(np.linalg.matrix_rank(scalar_rows(nominal)))
    if rank < 9:
        raise ProgrammeError(
            f"method scalar: expected positions that determine nine accelerometer parameters, found {rank}; "
            "take the programme rough-table or nine, or the method joint"
        )
