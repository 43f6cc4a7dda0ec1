"""Correction of readings by a calibration: as a formula for any program, as matrix and bias alone, and by
`Compensator`.

For the sensors j of a kind, with readings y (n,), SI, let x be the specific force or the rate in the frame of the
calibration, a_j the nominal axis of a sensor and s_j = a_j · x. The correction evaluates, once if it is linear, else
FIXED_POINT_STEPS + 1 times,

    x = inverse · (y − bias − terms(x))                                                                          (1)
    terms_j = quadratic_j · (x₁², x₁x₂, x₁x₃, x₂², x₂x₃, x₃²) + cubic_j s_j³ + asymmetry_j |s_j| + by_force_j · f
              + by_products_j · (f₁², f₁f₂, f₁f₃, f₂², f₂f₃, f₃²)

from terms = 0. At d = T − reference, °C, the bias of each sensor is greater by d (bias_slope + d (bias_curve + d
bias_cube)), and the difference in parentheses is divided by 1 + d (scale_slope + d scale_curve). Lever arms and delays
need the motion and are not in (1).

For a program that applies only matrix and bias, the best linear model also takes up part of the other groups: a cubic
term adds to the scale factor, a quadratic one to the bias. With the readings y of the whole model at the reference
temperature, M and b minimise

    Σ |y(f, 0) − M f − b|²           accelerometers, over all directions of f, |f| = g                           (2)
    Σ |y(±f, ω) − b₀ − M ω|²         gyros, over all directions of ω, at a third, two thirds and all of the rate  (3)

b₀, the mean reading at rest over all attitudes, is fixed: a fit that changes it in favour of the turns is wrong at
every rest. (2) and (3) contain no lever arms, delays and temperatures.

Increments are divided by their interval, corrected and multiplied again, as if the input had been constant over the
interval.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from tumble.errors import CalibrationError, InputError
from tumble.inference.prediction import directions
from tumble.recording.arrays import Temperatures, celsius_of, check_kinds, numbers_of
from tumble.result.accepted import accepted_kinds
from tumble.result.record import CalibrationData
from tumble.sensors.compensation import FIXED_POINT_STEPS, Compensator
from tumble.sensors.instrument import functions, is_linear
from tumble.sensors.model import UNITS, Block, SensorKind, SensorModel
from tumble.sensors.parameters import CONSTANT, FORCE, OWN_CUBE, OWN_SIZE, PRODUCTS, group_name
from tumble.units import DEGREE, G_STANDARD, Array

# -------------------- as a matrix and a bias --------------------

USUAL_RATE = 100.0 * DEGREE  # rad/s, for calibrations without the rate of their turns
UP = np.concatenate([directions(), -directions()])
DENSE = np.concatenate([np.eye(3), directions(1000), -np.eye(3), -directions(1000)])
"""Unit vectors (N, 3) over the sphere, each with its opposite, for fits and for the largest error."""


def session_rate(calibration: CalibrationData) -> float:
    """Return the rate of the turns of a session, or a usual one, rad/s."""
    prediction = calibration.prediction
    return USUAL_RATE if prediction is None or prediction.at_rate is None else prediction.at_rate


def readings_at(compensator: Compensator, kind: SensorKind, force: Array, rate: Array) -> Array:
    """Return readings (N, n), SI, by the whole model at specific forces (N, 3), m/s², and rates (N, 3), rad/s."""
    block, K = compensator.sensors(kind)
    assert block is not None
    return np.asarray(np.einsum("npb,pb->np", functions(block, force, rate), K, optimize=True))


def best_linear_model(calibration: CalibrationData, kind: SensorKind, held: Container[str] = ()) -> SensorModel:
    """Return matrix and bias that fit the whole model of "accel" or "gyro" best, Eq. (2) and (3).

    Groups beyond the linear model that are `held`, because a program applies them itself, are not fitted."""
    model = calibration.accel if kind == "accel" else calibration.gyro
    assert model is not None
    fitted = _without(calibration, held)
    if fitted.linear:
        return model
    if kind == "accel":  # Eq. (2)
        design = np.column_stack([G_STANDARD * UP, np.ones(len(UP))])
        readings = readings_at(fitted, kind, G_STANDARD * UP, np.zeros_like(UP))
        solution = np.asarray(np.linalg.lstsq(design, readings)[0], dtype=float)
        return SensorModel(matrix=solution[:3].T, bias=solution[3])
    at_rest = fitted.gyro_coefficients[:, CONSTANT]  # Eq. (3)
    rates = session_rate(calibration) * np.concatenate([UP / 3.0, UP / 1.5, UP])[:, [1, 2, 0]]
    force = G_STANDARD * np.tile(UP, (3, 1))
    mean_readings = 0.5 * (readings_at(fitted, kind, force, rates) + readings_at(fitted, kind, -force, rates))
    matrix = np.asarray(np.linalg.lstsq(rates, mean_readings - at_rest)[0], dtype=float).T
    return SensorModel(matrix=matrix, bias=at_rest)


def correction_errors(
    calibration: CalibrationData, kind: SensorKind, correct: Callable[[Array], Array], held: Container[str] = ()
) -> Array:
    """Return the errors (N,), SI, of a function that corrects readings (N, n) to vectors (N, 3).

    They are those of the specific force in all attitudes at rest, or of the rate about all axes in 1 g, at the rate of
    the session, without the groups that are `held`."""
    rate = np.zeros_like(DENSE) if kind == "accel" else session_rate(calibration) * DENSE[:, [1, 2, 0]]
    true = G_STANDARD * DENSE if kind == "accel" else rate
    readings = readings_at(_without(calibration, held), kind, G_STANDARD * DENSE, rate)
    return np.asarray(np.linalg.norm(correct(readings) - true, axis=1))


def _without(calibration: CalibrationData, held: Container[str]) -> Compensator:
    kept = tuple(p for p in calibration.parameters if group_name(p.name) not in held)
    return replace(calibration, parameters=kept).compensator


# -------------------- as any program can apply it --------------------

_SYMBOLS: dict[SensorKind, str] = {"accel": "f", "gyro": "w"}
_EXAMPLES = {"accel": (0.5, -1.0, 9.7), "gyro": (0.1, -0.2, 0.3), "mag": (0.4, -0.2, 0.3)}
"""True vectors of the examples, roughly, SI or in the unit of the field."""
BY_FORCE = {"by_force": FORCE, "by_products": PRODUCTS}  # terms of the gyros in the specific force, and their columns
_TERMS = {
    "quadratic": "quadratic · ({0}x², {0}x {0}y, {0}x {0}z, {0}y², {0}y {0}z, {0}z²)",
    "cubic": "cubic s³",
    "asymmetry": "asymmetry |s|",
    "by_force": "by_force · f",
    "by_products": "by_products · (fx², fx fy, fx fz, fy², fy fz, fz²)",
}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Example:
    """A reading (n,), the vector (3,) that it is corrected to, and the specific force (3,) on gyros, SI."""

    reading: Array
    true: Array
    force: Array


def linear_example(kind: str, model: SensorModel) -> Example:
    """Return a reading of six decimals with its correction by matrix and bias alone."""
    reading = np.round(model.predict(np.array(_EXAMPLES[kind])), 6)
    return Example(reading=reading, true=model.apply(reading), force=np.zeros(3))


def examples(compensator: Compensator, kinds: Sequence[SensorKind], warmer: float = 0.0) -> dict[SensorKind, Example]:
    """Return readings of six decimals with their correction by the whole model, "accel" before "gyro".

    The sensors are `warmer` than their references, K. The specific force on the gyros is that of the example of the
    accelerometers, or zero without it."""
    out, force = dict[SensorKind, Example](), np.zeros((1, 3))
    for kind in kinds:
        reading, celsius = linear_example(kind, compensator.model(kind)).reading, compensator.reference(kind) + warmer
        if kind == "accel":
            true = force = compensator.force(reading[None], celsius)
        else:
            true = compensator.rate(reading[None], force, celsius)
        out[kind] = Example(reading=reading, true=true[0], force=force[0])
    return out


def nonlinear_tables(compensator: Compensator, kind: SensorKind) -> dict[str, Array]:
    """Return the tables of the terms of Eq. (1) by name, one row per sensor; empty for a linear model."""
    block, K = compensator.sensors(kind)
    if block is None or is_linear(block, K):
        return {}
    tables = {"axis": block.axes, "asymmetry": K[:, OWN_SIZE], "cubic": K[:, OWN_CUBE]}
    if kind == "accel":
        return tables | {"quadratic": K[:, PRODUCTS]}
    return tables | {name: K[:, columns] for name, columns in BY_FORCE.items() if np.any(K[:, columns])}


def thermal_tables(compensator: Compensator, kind: SensorKind) -> dict[str, Array]:
    """Return the temperature coefficients of the sensors of a kind by name, one number per sensor."""
    bias, scale = (compensator.changes(kind, what) for what in ("bias", "scale"))
    scale = scale / np.linalg.norm(compensator.model(kind).matrix, axis=1)[:, None]
    tables = {
        "reference": compensator.reference(kind),
        "bias_slope": bias[:, 0],
        "bias_curve": bias[:, 1],
        "scale_slope": scale[:, 0],
        "scale_curve": scale[:, 1],
    }
    return tables | ({"bias_cube": bias[:, 2]} if np.any(bias[:, 2]) else {})


def correction_content(calibration: CalibrationData) -> dict[str, Any]:
    """Return the correction of the accepted sensors of a calibration, by kind, as its file has it.

    It has the `formula` with its numbers and an `example`; for a nonlinear formula also the `linear` one that fits
    best, with its errors."""
    out, kinds = dict[str, Any](), accepted_kinds(calibration)
    if not kinds:
        return out
    compensator = calibration.compensator
    for kind, worked in examples(compensator, kinds).items():
        symbol = _SYMBOLS[kind]
        model = compensator.model(kind)
        tables = {"bias": model.bias, "inverse": model.inverse()} | nonlinear_tables(compensator, kind)
        terms = [words.format(symbol) for name, words in _TERMS.items() if np.any(tables.get(name, 0.0))]
        tables = {name: table for name, table in tables.items() if name in ("bias", "axis") or np.any(table)}
        formula = f"{symbol} = inverse · (y − bias{' − terms' if terms else ''})"
        if terms:
            formula += f", {FIXED_POINT_STEPS + 1} times from terms = 0, terms = {' + '.join(terms)}"
            formula += ", s = axis · " + symbol if {"cubic", "asymmetry"} & tables.keys() else ""
        if compensator.warm:
            tables |= thermal_tables(compensator, kind)
            curve = "(bias_curve + d bias_cube)" if "bias_cube" in tables else "bias_curve"
            formula += (
                f"; at d = T − reference, °C: bias + d (bias_slope + d {curve}), and what stands in the brackets is "
                "divided by 1 + d (scale_slope + d scale_curve)"
            )
        content = {"formula": formula, "unit": UNITS[kind]} | {name: table.tolist() for name, table in tables.items()}
        example = {"y": worked.reading.tolist(), symbol: worked.true.tolist()}
        if BY_FORCE.keys() & tables.keys():
            example["f"] = worked.force.tolist()
        out[kind] = content | {"example": example}
        if terms:
            best = best_linear_model(calibration, kind)
            off = correction_errors(calibration, kind, best.apply)
            out[kind]["linear"] = {
                "formula": f"{symbol} = inverse · (y − bias)",
                "inverse": best.inverse().tolist(),
                "bias": best.bias.tolist(),
                "off_by": {"rms": float(np.sqrt(np.mean(off**2))), "most": float(off.max())},
            }
    return out


# -------------------- by a compensator --------------------


def corrected_readings(
    calibration: CalibrationData,
    accel: npt.ArrayLike,
    gyro: npt.ArrayLike | None,
    *,
    dt: npt.ArrayLike | None,
    temperature: Temperatures | None,
) -> tuple[Array, Array | None]:
    """Return specific force and angular rate (..., 3) for readings (..., n), see `Calibration.apply`."""
    outcome = calibration.outcome
    if not outcome.accel and (gyro is None or not outcome.gyro):
        raise CalibrationError(
            f"calibration: expected accepted accelerometers or gyros, found: {'; '.join(outcome.reasons)}"
        )
    compensator, readings = calibration.compensator, dict[str, Array]()
    for kind, given in (("accel", accel), ("gyro", gyro)):
        block: Block | None = getattr(compensator, kind)
        if given is None and kind == "gyro":
            continue
        numbers = numbers_of(kind, given, increments=dt is not None)
        if block is None:
            raise InputError(f"{kind} readings: expected none, for the calibration has no {kind}, found some")
        if numbers.shape[-1:] != (block.size,):
            raise InputError(
                f"{kind} readings: expected {block.size} numbers a sample, one for each sensor of the calibration, "
                f"found an array of shape {numbers.shape}"
            )
        readings[kind] = numbers
    shape, interval = readings["accel"].shape[:-1], np.ones((1, 1))
    if dt is not None:
        interval = _by_sample("dt", dt, shape)
        if not (interval > 0.0).all():
            raise InputError(f"dt: expected intervals above 0 s, found {interval.min():g}")
    celsius = _temperatures(temperature, compensator, shape)
    force = compensator.force(readings["accel"].reshape(-1, compensator.accel.size) / interval, celsius["accel"])
    corrected = np.full((*shape, 3), np.nan) if calibration.accel is None else (force * interval).reshape(*shape, 3)
    if gyro is None:
        return corrected, None
    rates = readings["gyro"]
    if rates.shape[:-1] != shape and not (compensator.linear and dt is None):
        raise InputError(
            f"gyro readings: expected as many samples as of the accelerometers, {shape}, found the shape {rates.shape}"
        )
    rate = compensator.rate(rates.reshape(-1, rates.shape[-1]) / interval, force, celsius["gyro"]) * interval
    return corrected, rate.reshape(*rates.shape[:-1], 3)


def _by_sample(what: str, given: npt.ArrayLike, shape: tuple[int, ...], sensors: int | None = None) -> Array:
    """Return numbers (N, 1) or (N, n) of N samples of a shape (...), given for all, for each, or for each of n sensors.

    Raises InputError for other shapes."""
    numbers = numbers_of(what, given)
    if numbers.shape in ((), shape):
        numbers = np.broadcast_to(numbers, shape)[..., None]
    elif sensors is None or numbers.shape != (*shape, sensors):
        raise InputError(f"{what}: expected a number for each sample, {shape}, found the shape {numbers.shape}")
    return numbers.reshape(-1, numbers.shape[-1])


def _temperatures(
    given: Temperatures | None, compensator: Compensator, shape: tuple[int, ...]
) -> dict[str, Array | None]:
    """Return the temperatures (N, n) or (N, 1), °C, of "accel" and "gyro" from those in K, for all sensors or by kind.

    Raises InputError for one thermometer if the calibration has several."""
    sizes = {block.kind: block.size for block in (compensator.accel, compensator.gyro) if block is not None}
    if given is None:
        return dict.fromkeys(sizes)
    if isinstance(given, Mapping):
        check_kinds(given, sizes)
        by_kind = ((kind, _by_sample(f"temperature of {kind}", given[kind], shape, n)) for kind, n in sizes.items())
        return {kind: celsius_of(kelvin) for kind, kelvin in by_kind}
    if compensator.several_thermometers:
        raise InputError(
            "temperature: expected those of the thermometers of the calibration by kind of sensors, "
            f"{{{', '.join(f'{kind!r}: …' for kind in sizes)}}}, found one array"
        )
    return dict.fromkeys(sizes, celsius_of(_by_sample("temperature", given, shape, 1)))
