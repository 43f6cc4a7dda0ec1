"""Section of a report on the correction: frame, model, matrices, the whole correction, test vectors."""

from __future__ import annotations

import tomllib
from collections.abc import Container, Iterator, Mapping
from pathlib import Path
from typing import Any

from tumble.result.calibration import Calibration
from tumble.result.correction import Example, examples, linear_example
from tumble.result.further import SENSORS, further_parameters, linear_errors_text
from tumble.sensors.model import UNITS, SensorKind, SensorModel
from tumble.sensors.parameters import THERMAL, group_name, variable_of
from tumble.units import Array
from tumble.views.blocks import Block, Formula, Matrices, Matrix, Section, Text, section, table
from tumble.views.numbers import fixed, significant, unit_text

BEYOND = "Beyond bias, scale factors and axes"  # section on the further groups
_WARMING = 10.0  # K above the reference temperature, of test vectors over temperature
MODEL_DIGITS, TRUE_DIGITS = 10, 8  # decimals of matrices and biases (SI), and of true values of test vectors
_WORDS: Mapping[str, Any] = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
_OVER_TEMPERATURE = {
    f"{kind}.{what}.t1": f"(T − T₀) θ₁ + (T − T₀)² θ₂ ({kind}.{what}.t1, .t2)"
    for kind in ("accel", "gyro")
    for what in ("bias", "scale")
}


def application(calibration: Calibration) -> Section:
    """Return the section: model and frame, definition of a reading, matrices with test vectors, and further terms."""
    models: dict[SensorKind, SensorModel | None]
    models = {"accel": calibration.accel, "gyro": calibration.gyro, "mag": calibration.mag}
    present = {kind: model for kind, model in models.items() if model is not None}
    frame = _WORDS["frames"].get(calibration.frame, "It is described in the documentation of the software.")
    if calibration.frame == "accelerometer" and "accel.bias.0" in calibration:
        frame = _WORDS["numbered_frame"]
    blocks: list[Block] = [
        f"Body frame “{calibration.frame}”, right-handed. {frame}",
        "The sensors follow the model",
        Formula(name="model"),
    ]
    model_text = (
        "with the specific force (m/s²; at rest, axis up, +g) or the angular rate (rad/s) in the body frame as the "
        "true value. "
    )
    if calibration.frame == "paper" and calibration.accel is not None:
        model_text += (
            "The parameters of the accelerometers are those of the frame “paper”: k belongs to the diagonal of the "
            "matrix, and the angles xy, xz and yz, times the diagonal element of their row, stand above it. Other "
            "sensors follow the formula below. "
        )
    model_text += "The rows of the matrix are the sensitivities of the sensors times their axes"
    triads = any(len(model.matrix) <= 3 for model in present.values()) or not present
    if triads:
        blocks += [
            f"{model_text}: for three sensors along the body axes, k being the scale-factor errors and γ the axis "
            "angles,",
            Formula(name="axes"),
            "A reading is corrected by",
            Formula(name="apply"),
        ]
    if any(len(model.matrix) > 3 for model in present.values()):
        least = "by least squares, matrix⁺ being the pseudo-inverse:"
        redundant = f"One of more sensors {least}" if triads else f"{model_text}. A reading is corrected {least}"
        blocks += [redundant, Formula(name="apply_redundant")]
    blocks += _reading_blocks(calibration, present or models)
    errors = linear_errors_text(calibration)
    if errors:
        blocks.append(f"This is the linear model, {errors}; the whole correction is at the end of the section.")
    if not present:
        blocks.append("No matrix can be given: a parameter it needs was not determined.")
    for kind, model in present.items():
        unit = _unit(calibration, kind)
        symbol = "pseudo-inverse matrix⁺" if len(model.matrix) > 3 else "matrix⁻¹"
        bias = Matrix(symbol="bias", rows=_numbers(model.bias[:, None]), unit=unit)
        blocks += [
            Text(text=_WORDS["headings"][kind], tone="label"),
            Matrices(matrices=(Matrix(symbol="matrix", rows=_numbers(model.matrix)), bias)),
            Matrices(matrices=(Matrix(symbol=symbol, rows=_numbers(model.inverse())),)),
            "Test vector: with these numbers, this reading gives this true value.",
            _test_vector(linear_example(kind, model), unit),
        ]
    return section("How to apply it", *blocks, *(_whole_correction(calibration) if errors else ()))


def _reading_blocks(calibration: Calibration, kinds: Container[str]) -> list[Block]:
    """Return the definition of readings of these kinds of sensors."""
    rows = [
        {
            "column of the log": column,
            "sensor": SENSORS.get(kind, kind),
            "raw unit": unit_text(readings.unit) + (" per sample" if readings.increments else ""),
            "scale (raw per SI unit)": significant(scale, 10),
            "offset (raw)": significant(offset, 10),
        }
        for kind, readings in calibration.provenance.readings.items()
        if kind in kinds
        for column, scale, offset in zip(readings.columns, readings.scale, readings.offset, strict=True)
    ]
    if not rows:
        return ["A reading is the output in SI after the nominal scale and offset of the device."]
    definition = "A reading is the output in SI after the nominal scale and offset: (raw − offset) / scale"
    if any(readings.increments for readings in calibration.provenance.readings.values()):
        definition += ", for increments divided by the interval of the sample"
    return [definition + ".", table(rows, words=("column of the log", "sensor", "raw unit"))]


def _unit(calibration: Calibration, kind: SensorKind) -> str:
    """Return the unit of the readings and biases of a block."""
    return unit_text(calibration["mag.bias.x"].unit if kind == "mag" else UNITS[kind])


def _test_vector(worked: Example, unit: str) -> Matrices:
    columns = (("reading", worked.reading, 6), ("true", worked.true, TRUE_DIGITS))
    return Matrices(
        matrices=tuple(
            Matrix(symbol=symbol, rows=tuple((fixed(v, digits),) for v in vector), unit=unit)
            for symbol, vector, digits in columns
        )
    )


def added_terms(calibration: Calibration) -> str:
    """Return formulas of the terms of the whole correction beyond matrix and bias."""
    return "; ".join(_present(calibration, {**_WORDS["terms"], **_WORDS["in_motion"], **_OVER_TEMPERATURE}))


def _present(calibration: Calibration, terms: Mapping[str, str]) -> list[str]:
    """Return the terms of the groups that a calibration has."""
    groups = {group_name(p.name) for p in calibration.parameters}
    return [words for group, words in terms.items() if group in groups]


def _whole_correction(calibration: Calibration) -> Iterator[Block]:
    """Yield the formulas of the groups beyond the linear model, and a test vector."""
    compensator = calibration.compensator
    static, moving = ("; ".join(_present(calibration, terms)) for terms in (_WORDS["terms"], _WORDS["in_motion"]))
    sentences = []
    if static:
        sentences.append(
            "A reading has, beside matrix · true + bias, for the specific force f and the rate ω in the body frame and "
            f"the nominal sensing direction a of its sensor: {static}. With these it is corrected by repeating true ← "
            "matrix⁻¹ · (reading − bias − these terms at true), from true = 0, until nothing changes (six times), the "
            "force before the rate."
        )
    if moving:
        sentences.append(f"In motion, readings of accelerometers also have: {moving}.")
    if compensator.warm:
        sentences.append(
            "Bias and scale factor change with the temperature T of the sensor by (T − T₀) times .t1, (T − T₀)² "
            "times .t2 and (T − T₀)³ times .t3 from their values at the reference temperature T₀: the bias by that, "
            "and the row of the matrix by that along its own direction."
        )
    yield Text(text="The whole correction", tone="label")
    variables = {variable_of(p.name) for p in further_parameters(calibration.parameters)}
    places = ["“Result”"] if compensator.warm else []
    places += [f"“{BEYOND}”"] if variables.difference(THERMAL) else []
    yield " ".join([*sentences, f"The values in SI are in the tables of {' and '.join(places)}."])
    kinds: tuple[SensorKind, ...] = ("accel",) if calibration.gyro is None else ("accel", "gyro")
    warm = f" and {_WARMING:.0f} K above the reference temperature" if compensator.warm else ""
    yield (
        f"Test vector of the whole correction, at a constant rate{warm}: these readings together give these true "
        "values."
    )
    for kind, worked in examples(compensator, kinds, _WARMING).items():
        yield _test_vector(worked, _unit(calibration, kind))


def _numbers(matrix: Array) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(fixed(float(v), MODEL_DIGITS) for v in row) for row in matrix)
