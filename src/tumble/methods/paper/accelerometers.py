"""The paper's two methods for accelerometers at rest, stages 1 and 2.

Sequential vector method. Stage 1 takes the bias and the scale-factor error of one accelerometer from rests in which its
axis is up and down, Eqs. (3), (4); stage 2 the angle between two from a rest in which one is 45° above and the other
45° below the horizon, Eqs. (8), (10), and the axis angles γ from it by (2). Nothing is solved for jointly, so the
functions serve redundant blocks with axes of any directions as well.

Scalar method. |ŵ| at rest is g in whatever attitude. The coefficients of Eq. (13) need the attitude: either that of the
programme, with errors of the order of the parameters times the deviations from the programme, or the levelled one, with
errors of second order in the parameters.

All functions take any leading axes. Source: §2 to §4 of the turntable method (Vodicheva & Parysheva 2019).
"""

from __future__ import annotations

import numpy as np

from tumble.errors import ProgrammeError
from tumble.methods.least_squares import solved
from tumble.rotation import unit_vector
from tumble.sensors.model import SensorModel, triad_model
from tumble.units import Array, BoolArray

EXACT = 1e-6
"""By how much nominal cosines may miss what the programme of the vector method asks for."""

PAIRS = ((0, 1), (0, 2), (1, 2))
"""The accelerometers between whose axes the angles yx, zx, zy are."""


# The sequential vector method


def bias_and_scale(readings: Array, cosines: Array, gravity: Array | float) -> tuple[Array, Array]:
    """Bias, m/s², and scale-factor error (...) of one accelerometer from its readings (..., K) in K ≥ 2 rests in
    which its axis has these cosines with the vertical, Eqs. (3), (4).

    For two rests it is (4), for more the straight line of least squares through (3). With cosines of ±1 instead of
    `levelled_cosines`, errors of half the square of the tilt remain, whatever the iterations."""
    mean_cosine = cosines.mean(axis=-1, keepdims=True)
    spread = cosines - mean_cosine
    slope = (spread * readings).sum(axis=-1) / (spread**2).sum(axis=-1)
    bias = readings.mean(axis=-1) - slope * mean_cosine[..., 0]
    return np.asarray(bias), np.asarray(slope / gravity - 1.0)


def levelled_cosines(force: Array, axes: Array) -> Array:
    """Cosines d·û (..., N, n) of sensing axes (n, 3) with the vertical by the accelerometers, with the error of
    Eq. (7)."""
    return np.asarray(unit_vector(force) @ axes.T)


def angle_between(above: Array, below: Array, across: Array | float, gravity: Array | float) -> Array:
    """Angle φ, rad, between two sensing axes on one side of the vertical from their readings at rest, Eq. (10):
    φ = |arccos(ŵ_η/√(g² − ŵ_ζ²)) − arccos(ŵ_ξ/√(g² − ŵ_ζ²))|.

    `across` is the specific force ŵ_ζ along the normal of their plane; with zero it is Eq. (8)."""
    in_plane = np.sqrt(gravity**2 - np.asarray(across) ** 2)
    return np.asarray(np.abs(np.arccos(below / in_plane) - np.arccos(above / in_plane)))


def axis_angles(between_xy: Array, between_xz: Array, between_yz: Array) -> Array:
    """Axis angles γ_yx, γ_zx, γ_zy (..., 3), rad, from the angles between the axes: Eq. (2) inverted, the third line in
    full."""
    yx, zx = 0.5 * np.pi - between_xy, 0.5 * np.pi - between_xz
    sine = (np.cos(between_yz) - np.sin(yx) * np.sin(zx)) / (np.cos(yx) * np.cos(zx))
    return np.stack([yx, zx, np.arcsin(sine)], axis=-1)


def by_vector(readings: Array, nominal: Array, gravity: Array) -> SensorModel:
    """Stages 1 and 2 for a triad: its model from readings (..., N, 3) at rests whose programmed verticals in the
    body are `nominal` (N, 3). Stage 2 uses readings corrected by stage 1."""
    cosines, of_axes = levelled_cosines(readings, np.eye(3)), []
    for p in range(3):
        standing = np.abs(nominal[:, p]) > 1.0 - EXACT
        of_axes.append(bias_and_scale(readings[..., standing, p], cosines[..., standing, p], gravity))
    bias, scale = (np.stack(values, axis=-1) for values in zip(*of_axes, strict=True))
    corrected, between = (readings - bias[..., None, :]) / (1.0 + scale[..., None, :]), []
    for p, q in PAIRS:  # the mean over the rests made for them
        w = corrected[..., _oblique(nominal, p, q), :]
        angles = angle_between(w[..., p], w[..., q], w[..., 3 - p - q], np.asarray(gravity)[..., None])
        between.append(np.asarray(angles.mean(axis=-1)))
    return triad_model(bias, scale, axis_angles(*between))


def _oblique(nominal: Array, p: int, q: int) -> BoolArray:
    """Rests (N,) in which axes p and q are symmetric about the horizon in a vertical plane."""
    return np.asarray((np.abs(nominal[:, p] + nominal[:, q]) < EXACT) & (np.abs(nominal[:, 3 - p - q]) < EXACT))


def check_for_vector(nominal: Array) -> None:
    """Raise ProgrammeError unless there are rests (N, 3) for every axis and every pair."""
    wanted = [
        (f"{'XYZ'[p]} {side}", np.asarray(sign * nominal[:, p] > 1.0 - EXACT))
        for p in range(3)
        for side, sign in (("up", 1.0), ("down", -1.0))
    ]
    wanted += [
        (f"{'XYZ'[p]} 45° above and {'XYZ'[q]} 45° below the horizon", _oblique(nominal, p, q)) for p, q in PAIRS
    ]
    missing = [name for name, rests in wanted if not rests.any()]
    if missing:
        raise ProgrammeError(
            f"method sequential: expected rests with {'; '.join(missing)}, found none in the programme; "
            "take the programme rough-table or the method joint"
        )


# The scalar method


def scalar_rows(u: Array) -> Array:
    """Rows h (..., 9) of Eq. (13) for verticals u (..., 3) in the body: derivatives of (|ŵ| − g)/g with respect to
    δw/g, k, γ_yx, γ_zx, γ_zy. All three angles have a plus, where the sign in (12) is not legible."""
    products = u[..., [1, 2, 2]] * u[..., [0, 0, 1]]
    return np.concatenate([u, u**2, products], axis=-1)


def scalar_fit(readings: Array, verticals: Array, gravity: Array) -> SensorModel:
    """Model of a triad from readings (..., N, 3) at N ≥ 9 rests by least squares of (ŵ² − g²)/2g², Eqs. (12), (13),
    with the verticals (..., N, 3) of the programme or of `unit_vector(readings)`. The model is exact, Eq. (1)."""
    g = np.asarray(gravity)[..., None]
    X = solved(scalar_rows(verticals), ((readings**2).sum(axis=-1) - g**2) / (2.0 * g**2))
    return triad_model(np.asarray(gravity)[..., None] * X[..., :3], X[..., 3:6], X[..., 6:])


def by_modulus_nominal(readings: Array, nominal: Array, gravity: Array) -> SensorModel:
    """Stages 1 and 2 at once, with the orientation of the programme."""
    return scalar_fit(readings, np.broadcast_to(nominal, readings.shape), gravity)


def by_modulus(readings: Array, nominal: Array, gravity: Array) -> SensorModel:
    """Stages 1 and 2 at once, with the estimated orientation: the programme's `nominal` is not used."""
    del nominal
    return scalar_fit(readings, unit_vector(readings), gravity)


def check_for_modulus(nominal: Array) -> None:
    """Raise ProgrammeError unless |ŵ| at rests with these verticals (N, 3) determines all nine parameters."""
    rank = int(np.linalg.matrix_rank(scalar_rows(nominal)))
    if rank < 9:
        raise ProgrammeError(
            f"method scalar: expected positions that determine nine accelerometer parameters, found {rank}; "
            "take the programme rough-table or nine, or the method joint"
        )
