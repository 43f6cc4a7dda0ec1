"""Matrix and bias that fit the whole model of a calibration best, and the errors that a linear correction leaves.

A program that has matrix and bias alone is off by what the groups beyond the linear model add to a reading. Part of
that a line fits too: a cubic term adds to the scale factor, a quadratic one to the bias. With the readings y of the
whole model at the reference temperature, M and b minimise

    Σ |y(f, 0) − M f − b|²           accelerometers, over all directions of f, |f| = g                           (1)
    Σ |y(±f, ω) − b₀ − M ω|²         gyros, over all directions of ω, at a third, two thirds and all of the rate  (2)

b₀, the reading at rest in the mean over all attitudes, is kept: a fit that gives it away for the turns is off whenever
the device rests. Lever arms, delays and temperatures need a motion or a warming and are in neither.
"""

from __future__ import annotations

from collections.abc import Callable, Container
from dataclasses import replace

import numpy as np

from tumble.inference.prediction import directions
from tumble.result.record import CalibrationData
from tumble.sensors.instrument import functions
from tumble.sensors.model import SensorKind, SensorModel
from tumble.sensors.parameters import CONSTANT, group_name
from tumble.units import DEGREE, G_STANDARD, Array

USUAL_RATE = 100.0 * DEGREE
"""rad/s, where a calibration does not say how fast its turns were."""
UP, DENSE = (np.concatenate([half, -half]) for half in (directions(), np.concatenate([np.eye(3), directions(1000)])))
"""Unit vectors (N, 3) over the sphere, each with its opposite: for a fit, and for the largest error."""


def session_rate(calibration: CalibrationData) -> float:
    """The rate of the turns of a session, or a usual one, rad/s."""
    prediction = calibration.prediction
    return USUAL_RATE if prediction is None or prediction.at_rate is None else prediction.at_rate


def readings_at(calibration: CalibrationData, kind: SensorKind, force: Array, rate: Array) -> Array:
    """Readings (N, n), SI, by the whole model at specific forces (N, 3), m/s², and rates (N, 3), rad/s."""
    block, K = calibration.compensator.sensors(kind)
    assert block is not None
    return np.asarray(np.einsum("npb,pb->np", functions(block, force, rate), K, optimize=True))


def linear_model(calibration: CalibrationData, kind: SensorKind, held: Container[str] = ()) -> SensorModel:
    """Matrix and bias that fit the whole model best.

    Parameters
    ----------
    calibration
        A calibration of such sensors.
    kind
        "accel" or "gyro".
    held
        Groups beyond the linear model that a program applies itself, and that are not fitted.

    Returns
    -------
    SensorModel
        That of the calibration where it has no other groups.
    """
    model = calibration.accel if kind == "accel" else calibration.gyro
    assert model is not None
    fitted = _without(calibration, held)
    if fitted.compensator.linear:
        return model
    if kind == "accel":  # Eq. (1)
        design = np.column_stack([G_STANDARD * UP, np.ones(len(UP))])
        readings = readings_at(fitted, kind, G_STANDARD * UP, np.zeros_like(UP))
        solution = np.asarray(np.linalg.lstsq(design, readings)[0], dtype=float)
        return SensorModel(matrix=solution[:3].T, bias=solution[3])
    at_rest = fitted.compensator.gyro_coefficients[:, CONSTANT]  # Eq. (2)
    rates = session_rate(calibration) * np.concatenate([UP / 3.0, UP / 1.5, UP])[:, [1, 2, 0]]
    force = G_STANDARD * np.tile(UP, (3, 1))
    both = 0.5 * (readings_at(fitted, kind, force, rates) + readings_at(fitted, kind, -force, rates))
    matrix = np.asarray(np.linalg.lstsq(rates, both - at_rest)[0], dtype=float).T
    return SensorModel(matrix=matrix, bias=at_rest)


def errors_left(
    calibration: CalibrationData, kind: SensorKind, correct: Callable[[Array], Array], held: Container[str] = ()
) -> Array:
    """Errors (N,) of corrected vectors, SI: of the specific force in all attitudes at rest, or of the rate about all
    axes in 1 g, at the rate of the session.

    Parameters
    ----------
    calibration, kind, held
        As in `linear_model`.
    correct
        What is made of readings (N, n): vectors (N, 3).
    """
    rate = np.zeros_like(DENSE) if kind == "accel" else session_rate(calibration) * DENSE[:, [1, 2, 0]]
    true = G_STANDARD * DENSE if kind == "accel" else rate
    readings = readings_at(_without(calibration, held), kind, G_STANDARD * DENSE, rate)
    return np.asarray(np.linalg.norm(correct(readings) - true, axis=1))


def _without(calibration: CalibrationData, held: Container[str]) -> CalibrationData:
    """The calibration without the parameters of some groups."""
    return replace(calibration, parameters=tuple(p for p in calibration.parameters if group_name(p.name) not in held))
