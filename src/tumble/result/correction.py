"""The correction of a calibration: as any program can apply it, by a formula with its numbers and a worked example; as
a matrix and a bias alone, with the errors that these leave; and as it is computed here, by `Compensator`.

Of the sensors j of a kind, with readings y (n,), SI, x the specific force or the rate in the frame of the calibration,
a_j the nominal axis of a sensor and s_j = a_j · x,

    x = inverse · (y − bias − terms(x))                                                                          (1)
    terms_j = quadratic_j · (x₁², x₁x₂, x₁x₃, x₂², x₂x₃, x₃²) + cubic_j s_j³ + asymmetry_j |s_j| + by_force_j · f

from x = inverse · (y − bias), repeated. At d = T − reference, °C, the bias is greater by
d (bias_slope + d (bias_curve + d bias_cube)), the cube where it is not zero, and what stands in the brackets is divided
by 1 + d (scale_slope + d scale_curve), sensor by sensor. Lever arms and delays need the motion and are not in it.

A program that has matrix and bias alone is off by what the groups beyond the linear model add to a reading. Part of
that a line fits too: a cubic term adds to the scale factor, a quadratic one to the bias. With the readings y of the
whole model at the reference temperature, M and b minimise

    Σ |y(f, 0) − M f − b|²           accelerometers, over all directions of f, |f| = g                           (2)
    Σ |y(±f, ω) − b₀ − M ω|²         gyros, over all directions of ω, at a third, two thirds and all of the rate  (3)

b₀, the reading at rest in the mean over all attitudes, is kept: a fit that gives it away for the turns is off whenever
the device rests. Lever arms, delays and temperatures need a motion or a warming and are in neither.

Increments are divided by their interval, corrected and multiplied again: the mean over an interval is taken for what
the sensor felt in all of it.
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
from tumble.result.temperature_curves import thermal_parameters
from tumble.sensors.compensation import FIXED_POINT_STEPS, Compensator
from tumble.sensors.instrument import functions, is_linear
from tumble.sensors.model import UNITS, Block, SensorKind, SensorModel
from tumble.sensors.parameters import CONSTANT, FORCE, OWN_CUBE, OWN_SIZE, PRODUCTS, group_name
from tumble.units import DEGREE, G_STANDARD, Array

# -------------------- as a matrix and a bias --------------------


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


def best_linear_model(calibration: CalibrationData, kind: SensorKind, held: Container[str] = ()) -> SensorModel:
    """Matrix and bias that fit the whole model of "accel" or "gyro" best: those of the calibration where it has no
    other groups. Groups beyond the linear model that are `held`, which a program applies itself, are not fitted."""
    model = calibration.accel if kind == "accel" else calibration.gyro
    assert model is not None
    fitted = _without(calibration, held)
    if fitted.compensator.linear:
        return model
    if kind == "accel":  # Eq. (2)
        design = np.column_stack([G_STANDARD * UP, np.ones(len(UP))])
        readings = readings_at(fitted, kind, G_STANDARD * UP, np.zeros_like(UP))
        solution = np.asarray(np.linalg.lstsq(design, readings)[0], dtype=float)
        return SensorModel(matrix=solution[:3].T, bias=solution[3])
    at_rest = fitted.compensator.gyro_coefficients[:, CONSTANT]  # Eq. (3)
    rates = session_rate(calibration) * np.concatenate([UP / 3.0, UP / 1.5, UP])[:, [1, 2, 0]]
    force = G_STANDARD * np.tile(UP, (3, 1))
    both = 0.5 * (readings_at(fitted, kind, force, rates) + readings_at(fitted, kind, -force, rates))
    matrix = np.asarray(np.linalg.lstsq(rates, both - at_rest)[0], dtype=float).T
    return SensorModel(matrix=matrix, bias=at_rest)


def correction_errors(
    calibration: CalibrationData, kind: SensorKind, correct: Callable[[Array], Array], held: Container[str] = ()
) -> Array:
    """Errors (N,), SI, of the vectors (N, 3) that `correct` makes of readings (N, n), without the groups that are
    `held`: of the specific force in all attitudes at rest, or of the rate about all axes in 1 g, at the rate of the
    session."""
    rate = np.zeros_like(DENSE) if kind == "accel" else session_rate(calibration) * DENSE[:, [1, 2, 0]]
    true = G_STANDARD * DENSE if kind == "accel" else rate
    readings = readings_at(_without(calibration, held), kind, G_STANDARD * DENSE, rate)
    return np.asarray(np.linalg.norm(correct(readings) - true, axis=1))


def _without(calibration: CalibrationData, held: Container[str]) -> CalibrationData:
    """The calibration without the parameters of some groups."""
    return replace(calibration, parameters=tuple(p for p in calibration.parameters if group_name(p.name) not in held))


# -------------------- as any program can apply it --------------------


_SYMBOLS: dict[SensorKind, str] = {"accel": "f", "gyro": "w"}
"""The symbol of the vector of each kind."""
_EXAMPLES = {"accel": (0.5, -1.0, 9.7), "gyro": (0.1, -0.2, 0.3), "mag": (0.4, -0.2, 0.3)}
"""True vectors near which the examples are, SI or in the unit of the field."""
_TERMS = {
    "quadratic": "quadratic · ({0}x², {0}x {0}y, {0}x {0}z, {0}y², {0}y {0}z, {0}z²)",
    "cubic": "cubic s³",
    "asymmetry": "asymmetry |s|",
    "by_force": "by_force · f",
}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Example:
    """A reading (n,), the true vector (3,) that it is corrected to, and the specific force (3,) in which gyros read it,
    all SI."""

    reading: Array
    true: Array
    force: Array


def linear_example(kind: str, model: SensorModel) -> Example:
    """A reading of six decimals, and what matrix and bias alone make of it."""
    reading = np.round(model.predict(np.array(_EXAMPLES[kind])), 6)
    return Example(reading=reading, true=model.apply(reading), force=np.zeros(3))


def examples(compensator: Compensator, kinds: Sequence[SensorKind], warmer: float = 0.0) -> dict[SensorKind, Example]:
    """Readings of six decimals of these kinds of sensors, "accel" before "gyro", and what the whole correction makes of
    them where the sensors are `warmer` than their references, K. The example of gyros is in the force of that of the
    accelerometers, or in none without them."""
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
    """The terms of Eq. (1) of the sensors of a kind by name, a row a sensor; none of a linear model, and "by_force" of
    gyros that feel the specific force."""
    block, K = compensator.sensors(kind)
    if block is None or is_linear(block, K):
        return {}
    tables = {"axis": block.axes, "asymmetry": K[:, OWN_SIZE], "cubic": K[:, OWN_CUBE]}
    if kind == "accel":
        return tables | {"quadratic": K[:, PRODUCTS]}
    return tables | ({"by_force": K[:, FORCE]} if np.any(K[:, FORCE]) else {})


def thermal_tables(compensator: Compensator, kind: SensorKind) -> dict[str, Array]:
    """What changes with temperature of the sensors of a kind, by name, a number a sensor."""
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
    """The correction of the accepted sensors of a calibration, by kind, for its file: `formula` with its numbers, an
    `example`, and where the formula is not linear the `linear` one that fits it best, with the errors it leaves."""
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
        if thermal_parameters(calibration) and compensator.warm:
            tables |= thermal_tables(compensator, kind)
            curve = "(bias_curve + d bias_cube)" if "bias_cube" in tables else "bias_curve"
            formula += (
                f"; at d = T − reference, °C: bias + d (bias_slope + d {curve}), and what stands in the brackets is "
                "divided by 1 + d (scale_slope + d scale_curve)"
            )
        content = {"formula": formula, "unit": UNITS[kind]} | {name: table.tolist() for name, table in tables.items()}
        example = {"y": worked.reading.tolist(), symbol: worked.true.tolist()}
        if "by_force" in tables:
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


# -------------------- as it is computed --------------------


def corrected_readings(
    calibration: CalibrationData,
    accel: npt.ArrayLike,
    gyro: npt.ArrayLike | None,
    *,
    dt: npt.ArrayLike | None,
    temperature: Temperatures | None,
) -> tuple[Array, Array | None]:
    """Specific force and angular rate (..., 3) of readings (..., n), see `Calibration.apply`."""
    outcome = calibration.outcome
    if not outcome.accel and (gyro is None or not outcome.gyro):
        raise CalibrationError(
            f"calibration: expected accepted accelerometers or gyros, found: {'; '.join(outcome.reasons)}"
        )
    compensator, readings = calibration.compensator, dict[str, Array]()
    for kind, given in (("accel", accel), ("gyro", gyro)):
        block: Block | None = getattr(compensator, kind)
        if given is None:
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
    shape, interval = readings["accel"].shape[:-1], np.ones(1)
    if dt is not None:  # an interval for each sample; one for all of them is repeated
        intervals = numbers_of("dt", dt)
        if intervals.shape not in ((), shape):
            raise InputError(f"dt: expected a number for each sample, {shape}, found the shape {intervals.shape}")
        if not (intervals > 0.0).all():
            raise InputError(f"dt: expected intervals above 0 s, found {intervals.min():g}")
        interval = np.ravel(np.broadcast_to(intervals, shape))[:, None]
    celsius = given_temperatures(temperature, compensator, shape)
    force = compensator.force(readings["accel"].reshape(-1, compensator.accel.size) / interval, celsius["accel"])
    felt = np.full((*shape, 3), np.nan) if calibration.accel is None else (force * interval).reshape(*shape, 3)
    if gyro is None:
        return felt, None
    turned = readings["gyro"]
    if turned.shape[:-1] != shape and not (compensator.linear and dt is None):
        raise InputError(
            f"gyro readings: expected as many samples as of the accelerometers, {shape}, found the shape {turned.shape}"
        )
    rate = compensator.rate(turned.reshape(-1, turned.shape[-1]) / interval, force, celsius["gyro"]) * interval
    return felt, rate.reshape(*turned.shape[:-1], 3)


def given_temperatures(
    given: Temperatures | None, compensator: Compensator, shape: tuple[int, ...]
) -> dict[str, Array | None]:
    """Temperatures (N, n) or (N, 1), °C, of the "accel" and "gyro" of samples of a shape (...), N together: of all
    sensors (...), or by kind, (...) or (..., n), K. Raises InputError for others, and for one thermometer where the
    calibration has several."""

    def by_sample(what: str, kelvin: npt.ArrayLike, sensors: int) -> Array:
        numbers = numbers_of(what, kelvin)
        if numbers.shape in ((), shape):
            numbers = np.broadcast_to(numbers, shape)[..., None]
        elif numbers.shape != (*shape, sensors):
            raise InputError(f"{what}: expected a number for each sample, {shape}, found the shape {numbers.shape}")
        return celsius_of(numbers.reshape(-1, numbers.shape[-1]))

    sizes = {block.kind: block.size for block in (compensator.accel, compensator.gyro) if block is not None}
    if given is None:
        return dict.fromkeys(sizes)
    if isinstance(given, Mapping):
        check_kinds(given, sizes)
        return {kind: by_sample(f"temperature of {kind}", given[kind], n) for kind, n in sizes.items()}
    if compensator.several_thermometers:
        raise InputError(
            "temperature: expected those of the thermometers of the calibration by kind of sensors, "
            f"{{{', '.join(f'{kind!r}: …' for kind in sizes)}}}, found one array"
        )
    return dict.fromkeys(sizes, by_sample("temperature", given, 1))
