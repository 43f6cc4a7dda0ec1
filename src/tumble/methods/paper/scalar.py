"""The scalar method: |ŵ| at rest is g in whatever attitude, and how it misses it tells the errors apart.

The coefficients need the attitude, Eq. (13): the programme's, when errors are of the order of the parameters times
the deviations from the programme and two iterations reach what the sequential vector method does, or the levelled
one, when they are of second order in the parameters. That is the whole gain: levelled cosines are ŵ_p/|ŵ|, so that
the vector method, too, uses nothing but |ŵ|.

All functions take any leading axes. Source: §4 of the turntable method (Vodicheva & Parysheva 2019).
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from tumble.errors import ProgrammeError
from tumble.inference.estimate import Estimate
from tumble.methods.paper.accuracy_formulas import solved
from tumble.methods.paper.four_stages import PaperMethod, iterated
from tumble.reduction.observations import Observations
from tumble.rotation import unit_vector
from tumble.sensors.model import SensorModel, triad_model
from tumble.units import Array

Form = Literal["quadratic", "norm"]


def scalar(observations: Observations, iterations: int = 2) -> Estimate:
    """The paper's method with the scalar method for the accelerometers, with the estimated orientation and on all
    rests of the programme.

    Raises ProgrammeError if the session's programme has not the positions or the known turns it needs."""
    method = PaperMethod(name="scalar", accelerometers=accelerometers, check=check_positions)
    return iterated(observations, method, iterations)


def scalar_rows(u: Array) -> Array:
    """Rows h (..., 9) of Eq. (13) for verticals u (..., 3) in the body: what δw/g, k, γ_yx, γ_zx, γ_zy add to
    (|ŵ| − g)/g. All three angles have a plus, where the sign in (12) is not legible."""
    products = u[..., [1, 2, 2]] * u[..., [0, 0, 1]]
    return np.concatenate([u, u**2, products], axis=-1)


def scalar_differences(readings: Array, gravity: Array, form: Form) -> Array:
    """Differences z (..., N) of the measured modulus: (ŵ² − g²)/2g², Eq. (12), or in norm form (|ŵ| − g)/g, which
    differs by half the square of the error along the vertical."""
    g = np.asarray(gravity)[..., None]
    square = (readings**2).sum(axis=-1)
    return np.asarray((square - g**2) / (2.0 * g**2) if form == "quadratic" else np.sqrt(square) / g - 1.0)


def scalar_fit(readings: Array, verticals: Array, gravity: Array, form: Form = "quadratic") -> SensorModel:
    """Model of a triad from readings (..., N, 3) at N ≥ 9 rests by least squares, Eq. (13), with the verticals
    (..., N, 3) of the programme or of `unit_vector(readings)`. The model is the exact one of Eq. (1)."""
    X = solved(scalar_rows(verticals), scalar_differences(readings, gravity, form))
    return triad_model(np.asarray(gravity)[..., None] * X[..., :3], X[..., 3:6], X[..., 6:])


def accelerometers(readings: Array, nominal: Array, gravity: Array) -> SensorModel:
    """Stages 1 and 2 at once, with the estimated orientation: the programme's `nominal` is not used."""
    del nominal
    return scalar_fit(readings, unit_vector(readings), gravity)


def check_positions(nominal: Array) -> None:
    """Raise ProgrammeError unless |ŵ| at rests with these verticals (N, 3) determines all nine parameters."""
    rank = int(np.linalg.matrix_rank(scalar_rows(nominal)))
    if rank < 9:
        raise ProgrammeError(
            f"method scalar: expected positions that determine nine accelerometer parameters, found {rank}; "
            "take the programme rough-table or nine, or the method staged"
        )
