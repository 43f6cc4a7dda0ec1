"""How a calibration is applied, in a report: frame, model, matrices, and the whole correction with test vectors."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping

from tumble.result.calibration import Calibration
from tumble.result.correction import Example, examples, linear_example
from tumble.result.further import SENSORS, further_parameters, left_by_matrix
from tumble.sensors.model import SensorKind
from tumble.sensors.parameters import group_name, variable_of
from tumble.units import Array
from tumble.views.blocks import Block, Formula, Matrices, Matrix, Section, Text, section, table
from tumble.views.numbers import fixed, significant, unit_text

_WARMER = 10.0
"""K above the reference temperature, of the test vector of a calibration over temperature."""
_MOST_UNHALVED = 12
"""Rows of a narrow table from which on it stands in halves."""
MODEL_DIGITS, TRUE_DIGITS = 10, 8
"""Digits behind the point of matrices and biases (SI), and of the true values of test vectors that they give."""
_HEADINGS = {"accel": "Accelerometers", "gyro": "Gyros", "mag": "Magnetometer, in the frame of the accelerometers"}
_FRAMES = {
    "accelerometer": "X is along the axis of the X accelerometer, Z is normal to the plane of the axes of the X and Y "
    "accelerometers, Y completes. The accelerometer angles xy, xz and yz are zero by definition.",
    "paper": "Z is along the axis of the Z accelerometer, Y in the plane of the axes of the Y and Z accelerometers, X "
    "completes. The matrix of the accelerometers is diag(1 + k) times a unit upper-triangular matrix of the angles.",
    "symmetric": "The frame in which the matrix of the accelerometers is symmetric: the one nearest to the axes of all "
    "three.",
    "case": "X, Y and Z are normal to the mounting faces of the case.",
}
_NUMBERED_FRAME = (
    "Accelerometer 0 is along its nominal axis, and accelerometer 1 in the nominal plane of both. An angle p.1 turns "
    "the axis of sensor p about the perpendicular to the nominal axes of sensors 0 and p, p.2 about the perpendicular "
    "to that and to its own."
)
_TERMS = {
    "accel.quadratic": "K₂ (a·f)² (accel.quadratic)",
    "accel.cubic": "K₃ (a·f)³ (accel.cubic)",
    "accel.asymmetry": "κ |a·f| (accel.asymmetry)",
    "gyro.asymmetry": "κ |a·ω| (gyro.asymmetry)",
    "gyro.cubic": "K₃ (a·ω)³ (gyro.cubic)",
    "gyro.g_sensitivity": "G·f (gyro.g_sensitivity, by the components X, Y, Z of f)",
}
"""What the groups beyond the linear model add to a reading, at rest and at constant rate."""
_OVER_TEMPERATURE = {
    f"{kind}.{what}.t1": f"(T − T₀) θ₁ + (T − T₀)² θ₂ ({kind}.{what}.t1, .t2)"
    for kind in ("accel", "gyro")
    for what in ("bias", "scale")
}
_IN_MOTION = {
    "accel.lever": "a·(ω̇ × l + ω × (ω × l)) with the lever arm l (accel.lever)",
    "accel.delay": "the reading of a time later by accel.delay",
    "accel.single_delay": "single delays (accel.delay.x and so on) likewise",
}


def application(calibration: Calibration) -> Section:
    """The model and its frame, what a reading is, the matrices and a test vector for each block, and what is beyond
    them."""
    models = {"accel": calibration.accel, "gyro": calibration.gyro, "mag": calibration.mag}
    present = {kind: model for kind, model in models.items() if model is not None}
    frame = _FRAMES.get(calibration.frame, "It is described in the documentation of the software.")
    if calibration.frame == "accelerometer" and "accel.bias.0" in calibration:
        frame = _NUMBERED_FRAME
    blocks: list[Block] = [
        f"Body frame “{calibration.frame}”, right-handed. {frame}",
        "The sensors follow the model",
        Formula(name="model"),
    ]
    meant = (
        "with the specific force (m/s²; at rest, axis up, +g) or the angular rate (rad/s) in the body frame as the "
        "true value. "
    )
    if calibration.frame == "paper" and calibration.accel is not None:
        meant += (
            "The parameters of the accelerometers are those of the frame “paper”: k belongs to the diagonal of the "
            "matrix, and the angles xy, xz and yz, times the diagonal element of their row, stand above it. Other "
            "sensors follow the formula below. "
        )
    meant += "The rows of the matrix are the sensitivities of the sensors times their axes"
    triads = any(len(model.matrix) <= 3 for model in present.values()) or not present
    if triads:
        three = (
            f"{meant}: for three sensors along the body axes, k being the scale-factor errors and γ the axis angles,"
        )
        corrected = "A reading is corrected by"
        blocks += [three, Formula(name="axes"), corrected, Formula(name="apply")]
    if any(len(model.matrix) > 3 for model in present.values()):
        least = "by least squares, matrix⁺ being the pseudo-inverse:"
        which = f"One of more sensors {least}" if triads else f"{meant}. A reading is corrected {least}"
        blocks += [which, Formula(name="apply_redundant")]
    blocks += _what_a_reading_is(calibration, present or models)
    left_over = left_by_matrix(calibration)
    if left_over:
        linear = f"This is the linear model, {left_over}; the whole correction is at the end of the section."
        blocks.append(linear)
    if not present:
        blocks.append("No matrix can be given: a parameter it needs was not determined.")
    for kind, model in present.items():  # matrix, its inverse and bias, and a reading with what comes out
        unit = _unit(calibration, kind)
        symbol = "pseudo-inverse matrix⁺" if len(model.matrix) > 3 else "matrix⁻¹"
        bias = Matrix(symbol="bias", rows=_numbers(model.bias[:, None]), unit=unit)
        blocks += [
            Text(text=_HEADINGS[kind], tone="label"),
            Matrices(matrices=(Matrix(symbol="matrix", rows=_numbers(model.matrix)), bias)),
            Matrices(matrices=(Matrix(symbol=symbol, rows=_numbers(model.inverse())),)),
            "Test vector: with these numbers, this reading gives this true value.",
            _test_vector(linear_example(kind, model), unit),
        ]
    return section("How to apply it", *blocks, *(_whole_correction(calibration) if left_over else ()))


def _what_a_reading_is(calibration: Calibration, kinds: Container[str]) -> list[Block]:
    """What the readings of these kinds of sensors are made from."""
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
    meant = "A reading is the output in SI after the nominal scale and offset: (raw − offset) / scale"
    if any(readings.increments for readings in calibration.provenance.readings.values()):
        meant += ", for increments divided by the interval of the sample"
    return [meant + ".", table(rows, words=("column of the log", "sensor", "raw unit"))]


def _unit(calibration: Calibration, kind: str) -> str:
    """The unit of a block's readings and biases."""
    unit = next((p.unit for p in calibration.parameters if group_name(p.name) == f"{kind}.bias"), "")
    return unit_text(unit)


def _test_vector(worked: Example, unit: str) -> Matrices:
    columns = (("reading", worked.reading, 6), ("true", worked.true, TRUE_DIGITS))
    return Matrices(
        matrices=tuple(
            Matrix(symbol=symbol, rows=tuple((fixed(v, digits),) for v in vector), unit=unit)
            for symbol, vector, digits in columns
        )
    )


def added_terms(calibration: Calibration) -> str:
    """What the whole correction takes from a reading beside matrix and bias, in formulas."""
    return "; ".join(_present(calibration, {**_TERMS, **_IN_MOTION, **_OVER_TEMPERATURE}))


def _present(calibration: Calibration, terms: Mapping[str, str]) -> list[str]:
    """The terms of the groups that a calibration has."""
    groups = {group_name(p.name) for p in calibration.parameters}
    return [words for group, words in terms.items() if group in groups]


def _whole_correction(calibration: Calibration) -> Iterator[Block]:
    """What the groups beyond the linear model add to a reading, their values in full, and a test vector."""
    compensator = calibration.compensator
    further = [p for p in further_parameters(calibration.parameters) if variable_of(p.name) != "time"]
    static, moving = ("; ".join(_present(calibration, terms)) for terms in (_TERMS, _IN_MOTION))
    sentences = []
    if static:
        sentences.append(
            "A reading has, beside matrix · true + bias, for the specific force f and the rate ω in the body frame and "
            f"the nominal sensing direction a of its sensor: {static}. With these it is corrected by repeating true ← "
            "matrix⁻¹ · (reading − bias − these terms at true), from true = 0, until nothing changes (six times), the "
            "force before the rate."
        )
    if moving:
        sentences.append(f"In motion accelerometers have besides: {moving}.")
    if compensator.warm:
        sentences.append(
            "Bias and scale factor change with the temperature T of the sensor by (T − T₀) times .t1, (T − T₀)² "
            "times .t2 and (T − T₀)³ times .t3 from their values at the reference temperature T₀: the bias by that, "
            "and the row of the matrix "
            "by that along its own direction."
        )
    yield Text(text="The whole correction", tone="label")
    yield " ".join(sentences)
    rows = [{"parameter": p.name, "value, SI": significant(p.value, 8), "unit": unit_text(p.unit)} for p in further]
    yield table(rows, dense=True, halves=len(rows) > _MOST_UNHALVED)
    kinds: tuple[SensorKind, ...] = ("accel",) if calibration.gyro is None else ("accel", "gyro")
    warm = f" and {_WARMER:.0f} K above the reference temperature" if compensator.warm else ""
    yield (
        f"Test vector of the whole correction, at a constant rate{warm}: these readings together give these true "
        "values."
    )
    for kind, worked in examples(compensator, kinds, _WARMER).items():
        yield _test_vector(worked, _unit(calibration, kind))


def _numbers(matrix: Array) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(fixed(float(v), MODEL_DIGITS) for v in row) for row in matrix)
