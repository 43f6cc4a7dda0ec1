"""The result in a report: parameters, how they are applied, the frame, correlations, iterations."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from tumble.acceptance.conformity import RESULTS, LimitJudgement
from tumble.result.accepted import WORDS, accepted_kinds
from tumble.result.calibration import Calibration
from tumble.result.coverage import expanded
from tumble.result.further import (
    SENSORS,
    by_group,
    decided_by_priors,
    described,
    further_parameters,
    left_by_matrix,
    left_said,
    linear_parameters,
    other_factors,
    verdicts,
)
from tumble.result.parts import Parameter
from tumble.sensors.model import SensorModel
from tumble.sensors.parameters import group_name, variable_of
from tumble.units import Array, engineering
from tumble.views.blocks import (
    Block,
    Facts,
    Figure,
    Formula,
    Items,
    Matrices,
    Matrix,
    Section,
    Table,
    Text,
    Tone,
    section,
    table,
)
from tumble.views.calibration import group_table, launch_table, unknown_blocks
from tumble.views.numbers import (
    NONE,
    degrees,
    factor,
    fixed,
    limit_cell,
    percent,
    quantity_table,
    shown_units,
    significant,
    to_digits_of,
    with_expanded,
)
from tumble.views.report import drawings, figures

_TEST_VECTORS = {"accel": (1.0, -2.0, 9.5), "gyro": (0.1, -0.2, 0.3), "mag": (0.4, -0.2, 0.3)}
"""True values (m/s², rad/s, unit of the field) near which the readings of the test vectors are."""
_STRONGEST = 8
_MOST_ROWS = 26
"""Rows of the table of results that the page for the customer has room for."""
_MOST_LARGE, _MOST_WITH_WORDS = 9, 12
"""Columns for which the page has room in the larger type, and in the smaller one with the parameters in words."""
_MOST_UNHALVED = 12
"""Rows of a narrow table from which on it stands in halves."""
MODEL_DIGITS, TRUE_DIGITS = 10, 8
"""Digits behind the point of matrices and biases (SI), and of the true values of test vectors that they give."""
_HEADINGS = {"accel": "Accelerometers", "gyro": "Gyros", "mag": "Magnetometer, in its own frame"}
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


def parameter_table(
    calibration: Calibration,
    as_found: Calibration | None = None,
    judged: Mapping[str, Sequence[LimitJudgement]] | None = None,
    *,
    with_degrees: bool = False,
) -> Table:
    """Parameters of the linear model with U (95 %); where there are such, the values as found before an adjustment,
    coverage factors other than 2 with the degrees of freedom (of all parameters `with_degrees`), the limits and results
    of those that were `judged`, and deviations from the systematic values and from launch to launch."""
    parameters = linear_parameters(calibration.parameters)
    units, judged, rows = shown_units(parameters), judged or {}, []
    before = {} if as_found is None else {p.name: p.value for p in as_found.parameters}
    limited = bool(judged) and all(len(each) == 1 for each in judged.values())
    passport = any(p.deviation is not None for p in parameters)
    for p in parameters:
        (size, unit), own, u = units[p.name], judged.get(p.name, ()), expanded(p)
        value, shown = with_expanded(p, size)
        row = {"parameter": p.name, "": described(p.name), "mean" if calibration.launches else "value": value}
        row |= {"U (95 %)": shown, "unit": unit}
        row |= {"as found": to_digits_of(before.get(p.name), u, size)} if before else {}
        row |= {"k": factor(p), "ν": degrees(p)} if with_degrees or other_factors(parameters) else {}
        row |= {"run to run": to_digits_of(p.run_to_run, u, size)} if calibration.launches else {}
        row |= {"from nominal": to_digits_of(p.deviation, u, size)} if passport else {}
        if limited:
            low, high = (own[0].low, own[0].high) if own else (math.nan, math.nan)
            row |= {"lowest": limit_cell(low, size), "highest": limit_cell(high, size)}
        row |= {"verdict": min((each.result for each in own), key=RESULTS.index, default=NONE)} if judged else {}
        rows.append(row)
    count = max(map(len, rows), default=0)
    if count > _MOST_WITH_WORDS:
        rows = [{heading: cell for heading, cell in row.items() if heading} for row in rows]
    words = ("parameter", "", "unit", "verdict")
    return table(rows, words=words, dense=count > _MOST_LARGE, halves=len(rows) > _MOST_ROWS)


def beyond(calibration: Calibration, *, for_customers: bool = False) -> Section | None:
    """What is beyond the linear model: a line for each group, what its prior decides, and all parameters;
    `for_customers` the parameters alone."""
    further = further_parameters(calibration.parameters)
    parameters = _further_table(further) if further else None
    if for_customers:
        said = (
            "What a reading has beside bias, scale factors and axes. Of each there was a prior, a standard deviation "
            "over such instruments; learned is how much of its variance the recording has taken off: at 0 % only the "
            "prior is known."
        )
        return section("Beyond bias, scale factors and axes", Text(text=said), parameters) if further else None
    said = (
        "Each group has a prior, the standard deviation over instruments of its grade or that of the data sheet; where "
        "the data exceed it, it was widened. Learned is how much of the prior's variance the recording has taken off: "
        "at 0 % only the prior is known."
    )
    decided = decided_by_priors(calibration)
    left = Text(text=f"{decided[0].upper()}{decided[1:]}.") if decided else None
    groups = group_table(calibration, of_a_page=True)
    return section("Beyond the linear model", Text(text=said), groups, left, parameters) if groups.rows else None


def unknown(calibration: Calibration) -> Section | None:
    """What the model did not know about itself, and what the recording says of it."""
    said = (
        "Scatter, in-run biases and the sizes of groups were estimated with the parameters, and U is an average over "
        "what they may be. The middle 68 % of each stands beside its value; a size over the usual one has no unit."
    )
    blocks = unknown_blocks(calibration)
    return section("What the model did not know about itself", Text(text=said), *blocks) if blocks else None


def _further_table(parameters: Sequence[Parameter]) -> Table:
    def learned(p: Parameter, size: float) -> dict[str, str]:
        return {"prior": "" if p.prior is None else significant(p.prior / size, 4), "learned": percent(p.learned)}

    return quantity_table(
        parameters,
        lambda p, _: {"k": factor(p)},
        learned,
        headings=("parameter", "value", "u"),
        caption="u is the standard uncertainty, k u the half width of the interval of 95.45 %, prior a standard "
        "deviation, as widened.",
        dense=True,
    )


def launches(calibration: Calibration) -> Section:
    """Every launch beside the others: bias, scale and axes, then what is beyond the linear model in a table of its
    own."""
    linear, further = linear_parameters(calibration.parameters), further_parameters(calibration.parameters)
    blocks: list[Block] = [
        Text(
            text="The result is the mean of these launches (power-ons). Run to run is the standard deviation from one "
            "launch to another; it is in the uncertainty of the mean."
        ),
        replace(launch_table(calibration, linear, of_a_page=True), dense=len(calibration.launches) > 4),
    ]
    if further:
        beyond_linear = replace(launch_table(calibration, further, of_a_page=True), dense=True)
        blocks += [Text(text="Beyond the linear model:"), beyond_linear]
    digests = tuple(
        (f"log of {launch.session}", f"SHA-256 {launch.log_sha256}" if launch.log_sha256 else NONE)
        for launch in calibration.launches
    )
    return section("Launches", *blocks, Facts(rows=digests))


# How to apply


def application(calibration: Calibration) -> Section:
    """The model, what a reading is, the matrices and a test vector for each block."""
    models = {"accel": calibration.accel, "gyro": calibration.gyro, "mag": calibration.mag}
    known = {kind: model for kind, model in models.items() if model is not None}
    blocks: list[Block] = [
        Text(text="The sensors follow the model"),
        Formula(name="model"),
        *_axes_in_words(calibration, [len(model.matrix) for model in known.values()]),
        *_what_a_reading_is(calibration),
    ]
    left = left_by_matrix(calibration)
    if left is not None:
        blocks.append(
            Text(
                text=f"This is the linear model, {left_said(left)}; the whole correction is at the end of the section."
            )
        )
    if not known:
        blocks.append(Text(text="No matrix can be given: a parameter it needs was not determined."))
    for kind, model in known.items():
        blocks += _applied(kind, model, _unit(calibration, kind))
    if left is not None:
        blocks += _whole_correction(calibration)
    return section("How to apply it", *blocks)


def _axes_in_words(calibration: Calibration, sizes: Sequence[int]) -> Iterator[Block]:
    """What the matrix is of blocks with so many sensors, and how a reading is corrected with it."""
    said = (
        "with the specific force (m/s²; at rest, axis up, +g) or the angular rate (rad/s) in the body frame as the "
        f"true value. {_own_form(calibration)}The rows of the matrix are the sensitivities of the sensors times their "
        "axes"
    )
    triads, more = any(size <= 3 for size in sizes) or not sizes, any(size > 3 for size in sizes)
    if triads:
        yield Text(
            text=f"{said}: for three sensors along the body axes, k being the scale-factor errors and γ the axis "
            "angles,"
        )
        yield Formula(name="axes")
        yield Text(text="A reading is corrected by")
        yield Formula(name="apply")
    if more:
        least = "by least squares, matrix⁺ being the pseudo-inverse:"
        yield Text(text=f"One of more sensors {least}" if triads else f"{said}. A reading is corrected {least}")
        yield Formula(name="apply_redundant")


def _own_form(calibration: Calibration) -> str:
    """Where the accelerometers' parameters are not those of the formula of the axes."""
    if calibration.frame != "paper" or calibration.accel is None:
        return ""
    return (
        "The parameters of the accelerometers are those of the frame “paper”: k belongs to the diagonal of the matrix, "
        "and the angles xy, xz and yz, times the diagonal element of their row, stand above it. Other sensors follow "
        "the formula below. "
    )


def _what_a_reading_is(calibration: Calibration) -> list[Block]:
    rows = [
        {
            "column of the log": column,
            "sensor": SENSORS.get(kind, kind),
            "raw unit": readings.unit + (" per sample" if readings.increments else ""),
            "scale (raw per SI unit)": significant(scale, 10),
            "offset (raw)": significant(offset, 10),
        }
        for kind, readings in calibration.readings.items()
        for column, scale, offset in zip(readings.columns, readings.scale, readings.offset, strict=True)
    ]
    if not rows:
        return [Text(text="A reading is the output in SI after the nominal scale and offset of the device.")]
    said = "A reading is the output in SI after the nominal scale and offset: (raw − offset) / scale"
    if any(readings.increments for readings in calibration.readings.values()):
        said += ", for increments divided by the interval of the sample"
    return [Text(text=said + "."), table(rows, words=("column of the log", "sensor", "raw unit"))]


def _unit(calibration: Calibration, kind: str) -> str:
    """The unit of a block's readings and biases."""
    found = next((p.unit for p in calibration.parameters if group_name(p.name) == f"{kind}.bias"), "")
    return {"m/s^2": "m/s²"}.get(found, found)


def _applied(kind: str, model: SensorModel, unit: str) -> list[Block]:
    """Matrix, its inverse and bias of a block, and a reading with what comes out."""
    reading = test_reading(kind, model)
    true = model.apply(reading)
    symbol = "pseudo-inverse matrix⁺" if len(model.matrix) > 3 else "matrix⁻¹"
    return [
        Text(text=_HEADINGS[kind], tone="label"),
        Matrices(
            matrices=(
                Matrix(symbol="matrix", rows=_numbers(model.matrix)),
                Matrix(symbol="bias", rows=_numbers(model.bias[:, None]), unit=unit),
            )
        ),
        Matrices(matrices=(Matrix(symbol=symbol, rows=_numbers(model.inverse())),)),
        Text(text="Test vector: with these numbers, this reading gives this true value."),
        Matrices(matrices=_test_vector(reading, true, unit)),
    ]


def _test_vector(reading: Array, true: Array, unit: str) -> tuple[Matrix, Matrix]:
    return (
        Matrix(symbol="reading", rows=tuple((fixed(v, 6),) for v in reading), unit=unit),
        Matrix(symbol="true", rows=tuple((fixed(v, TRUE_DIGITS),) for v in true), unit=unit),
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
_IN_MOTION = {
    "accel.lever": "a·(ω̇ × l + ω × (ω × l)) with the lever arm l (accel.lever)",
    "accel.delay": "the reading of a time later by accel.delay",
    "accel.single_delay": "single delays (accel.delay.x and so on) likewise",
}


def _whole_correction(calibration: Calibration) -> Iterator[Block]:
    """What the groups beyond the linear model add to a reading, their values in full, and a test vector."""
    compensator = calibration.compensator
    further = [p for p in further_parameters(calibration.parameters) if variable_of(p.name) != "time"]
    present = {group_name(p.name) for p in further}
    static = "; ".join(said for group, said in _TERMS.items() if group in present)
    moving = "; ".join(said for group, said in _IN_MOTION.items() if group in present)
    said = (
        "A reading has, beside matrix · true + bias, for the specific force f and the rate ω in the body frame and the "
        f"nominal sensing direction a of its sensor: {static}. With these it is corrected by repeating true ← "
        "matrix⁻¹ · (reading − bias − these terms at true), from true = 0, until nothing changes (six times), the "
        "force before the rate."
    )
    said += f" In motion accelerometers have besides: {moving}." if moving else ""
    if compensator.warm:
        said += (
            " Bias and scale factor change with the temperature T of the sensor by (T − T₀) times .t1 and (T − T₀)² "
            "times .t2 from their values at the reference temperature T₀."
        )
    yield Text(text="The whole correction", tone="label")
    yield Text(text=said)
    rows = [{"parameter": p.name, "value, SI": significant(p.value, 8), "unit": p.unit} for p in further]
    yield table(rows, dense=True, halves=len(rows) > _MOST_UNHALVED)
    assert calibration.accel is not None
    readings = {"accel": test_reading("accel", calibration.accel)}
    true = {"accel": compensator.force(readings["accel"][None])}
    if calibration.gyro is not None:
        readings["gyro"] = test_reading("gyro", calibration.gyro)
        true["gyro"] = compensator.rate(readings["gyro"][None], true["accel"])
    yield Text(
        text="Test vector of the whole correction, at a constant rate"
        + (" and the reference temperature" if compensator.warm else "")
        + ": these readings together give these true values."
    )
    for kind, reading in readings.items():
        yield Matrices(matrices=_test_vector(reading, true[kind][0], _unit(calibration, kind)))


def test_reading(kind: str, model: SensorModel) -> Array:
    """The reading (n,) of a test vector, exact to six digits behind the point."""
    return np.asarray(model.predict(np.array(_TEST_VECTORS[kind])).round(6))


def _numbers(matrix: Array) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(fixed(float(v), MODEL_DIGITS) for v in row) for row in matrix)


def frame(calibration: Calibration, name: str) -> Section:
    """The body frame in words and as a picture."""
    said = _FRAMES.get(calibration.frame, "It is described in the documentation of the software.")
    if calibration.frame == "accelerometer" and any(p.name == "accel.bias.0" for p in calibration.parameters):
        said = _NUMBERED_FRAME
    blocks: list[Block] = [Text(text=f"Body frame “{calibration.frame}”, right-handed. {said}")]
    if calibration.accel is not None:
        models = [m for m in (calibration.accel, calibration.gyro) if m is not None]
        times = drawings.lean_factor(models)
        caption = "The body frame X, Y, Z and the sensing axes in it."
        if times > 1.0:
            caption = f"{caption[:-1]}, their deviations from the body axes drawn {times:.0f} times larger."
        svg = drawings.frame(name, calibration.accel, calibration.gyro)
        blocks.append(Figure(svg=svg, caption=caption, width=drawings.FRAME))
    return section("The frame", *blocks)


# Uncertainty


def correlations(calibration: Calibration) -> Section | None:
    """What U covers, and the strongest correlations."""
    if calibration.covariance is None:
        return None
    names = [p.name for p in calibration.parameters]
    u = np.sqrt(np.diag(calibration.covariance))
    scale = np.where(u > 0.0, u, 1.0)
    r = np.clip(calibration.covariance / scale[:, None] / scale, -1.0, 1.0)
    p, q = np.tril_indices(len(names), -1)
    order = np.argsort(-np.abs(r[p, q]), kind="stable")[:_STRONGEST]
    rows = [
        {"parameter": names[p[i]], "with": names[q[i]], "coefficient": fixed(float(r[p[i], q[i]]), 3)} for i in order
    ]
    blocks: list[Block] = [
        Text(
            text="U is the expanded uncertainty, which covers 95.45 %: the standard uncertainty times the coverage "
            "factor k, 2 where u is known, and more where it was estimated from few residuals. It contains the "
            "noise at rest and in turns, the scatter between rests that the residuals show, and the stated uncertainty "
            "of gravity; of several launches also their instability. " + _not_contained(calibration)
        ),
    ]
    if rows:
        said = (
            "The covariance of two parameters is their coefficient times both standard uncertainties; all of it is in "
            "the calibration file, which is the data annex. The strongest:"
        )
        blocks += [Text(text=said), table(rows, words=("parameter", "with"))]
    return section("Covariance and correlations", *blocks)


def _not_contained(calibration: Calibration) -> str:
    """What U has nothing of."""
    if further_parameters(calibration.parameters):
        return (
            "It contains what the groups beyond the linear model leave open within their priors. It does not contain "
            "the change from one power-on to the next and with age, effects that no group describes, and an error of "
            "gravity larger than stated."
        )
    return (
        "It does not contain what one recording cannot show: changes with temperature and age, nonlinearity that is "
        "the same in every rest, and an error of gravity larger than stated."
    )


def convergence(calibration: Calibration, name: str) -> Section | None:
    """Root mean square of the increments of every kind of parameter in each iteration."""
    if not calibration.iterations:
        return None
    parameters = linear_parameters(calibration.parameters)
    kinds = by_group(parameters)
    rows = []
    for number, step in enumerate(calibration.iterations, 1):
        row = {"iteration": str(number)}
        for kind, alike in kinds.items():
            rms = float(np.sqrt(np.mean([step.get(p.name, 0.0) ** 2 for p in alike])))
            size, unit = engineering(alike[0].unit, rms)
            row[kind] = f"{significant(rms / size, 3)} {unit}" if rms > 0.0 else ""
        rows.append(row)
    caption = "Increments, root mean square of each kind of parameter."
    increments = table(rows, words=("iteration",), dense=len(kinds) > 5, caption=caption)
    picture = None
    if any(p.u for p in parameters):
        svg = figures.convergence(name, calibration.iterations, parameters)
        caption = "The largest increment of each kind of parameter, in units of its standard uncertainty u."
        picture = Figure(svg=svg, caption=caption)
    return section("Convergence", picture, increments)


def verdict(calibration: Calibration, *, opinions: bool = True) -> list[Block]:
    """Whether the calibration is accepted, the reasons against it, and with `opinions` the remarks and what they are
    caused by."""
    outcome = calibration.outcome
    if not outcome.accepted and (usable := accepted_kinds(calibration)):
        tone: Tone = "doubt"
        said = f"The {' and '.join(WORDS[kind] for kind in usable)} alone: values of others must not be used."
    elif not outcome.accepted:
        tone = "bad"
        said = "Not accepted: these values must not be used."
    elif outcome.remarks:
        tone = "doubt"
        said = (
            "Accepted with scatter: the noise within the rests does not explain all residuals. Their scatter is in U."
        )
    else:
        tone = "good"
        said = _agreement(calibration)
    blocks: list[Block] = [Text(text=said, tone=tone)]
    *parts, _ = verdicts(calibration)
    if parts:
        blocks.append(Text(text=f"{'; '.join(parts).capitalize()}."))
    if outcome.reasons:
        blocks.append(Items(items=outcome.reasons, tone="bad"))
    return [*blocks, *([Items(items=outcome.remarks)] if opinions and outcome.remarks else [])]


def _agreement(calibration: Calibration) -> str:
    """That it is accepted, and what nothing checks."""
    unchecked = " and ".join(name for name, fit in calibration.fits.items() if fit.degrees < 0.5)
    said = "Accepted: the recording determines every parameter given here, and its residuals agree with the model."
    if unchecked:
        said += f" Nothing checks the {unchecked}: there are no more data than unknowns."
    return said
