"""The result in a report: parameters, how they are applied, the frame, correlations, iterations."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from tumble.calibration.calibration_file import Calibration
from tumble.calibration.further import (
    GroupLine,
    by_group,
    decided_by_priors,
    further_parameters,
    group_lines,
    linear_parameters,
    other_factors,
    verdicts,
)
from tumble.calibration.half import WORDS, accepted_kinds
from tumble.calibration.results import Launch, Parameter
from tumble.calibration.shown import shown_units
from tumble.report import drawings, figures
from tumble.report.blocks import (
    Block,
    Facts,
    Figure,
    Formula,
    Items,
    Matrices,
    Matrix,
    ReportTable,
    Section,
    Text,
    Tone,
)
from tumble.report.numbers import NONE, as_value, factor, fixed, significant, with_expanded, with_standard
from tumble.sensors.model import SensorModel
from tumble.sensors.parameters import beyond_linear, group_name, sensor_kind, within_kind
from tumble.units import Array, engineering

_BLOCKS = {"accel": "accelerometer", "gyro": "gyro", "mag": "magnetometer"}
_TEST_VECTORS = {"accel": (1.0, -2.0, 9.5), "gyro": (0.1, -0.2, 0.3), "mag": (0.4, -0.2, 0.3)}
"""True values (m/s², rad/s, unit of the field) near which the readings of the test vectors are."""
_NAME = re.compile(
    r"(?P<kind>accel|gyro|mag)\.(?:axis\.(?P<pair>[xyz]{2})|(?P<what>bias|scale|axis)\."
    r"(?:(?P<letter>[xyz])|(?P<number>\d+))(?:\.(?P<angle>[12]))?)"
)
_STRONGEST = 8
_MOST_ROWS = 26
"""Rows of the table of results that the page for the customer has room for."""
_MOST_COLUMNS = 14
"""Columns of a covariance that a page has room for."""
_MOST_KINDS = 2
"""Kinds of sensors whose covariances fit on one page."""
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


def described(name: str) -> str:
    """A parameter in words: "X accelerometer, bias", "angle of the Y accelerometer towards X"."""
    found = _NAME.fullmatch(name)
    if found is None:
        return ""
    block = _BLOCKS[found["kind"]]
    if found["pair"]:
        return f"{found['pair'][0].upper()} {block}, axis towards {found['pair'][1].upper()}"
    sensor = f"{block} {found['number']}" if found["number"] else f"{found['letter'].upper()} {block}"
    said = {"bias": "bias", "scale": "scale-factor error", "axis": f"axis angle {found['angle']}"}
    return f"{sensor}, {said[found['what']]}"


def parameter_table(
    calibration: Calibration, as_found: Calibration | None = None, outcomes: Mapping[str, str] | None = None
) -> ReportTable:
    """Parameters of the linear model with U (95 %); where there are such, the values as found before an adjustment,
    coverage factors other than 2, deviations from the systematic values and from launch to launch, and the outcomes
    of the checks by parameter."""
    parameters = linear_parameters(calibration.parameters)
    units = shown_units(parameters)
    launches, factors = bool(calibration.launches), other_factors(parameters)
    passport = any(p.deviation is not None for p in parameters)
    before = {} if as_found is None else {p.name: p.value for p in as_found.parameters}
    columns = ["parameter", "", "mean" if launches else "value", "U (95 %)", "unit"]
    columns += ["as found"] if before else []
    columns += ["k"] if factors else []
    columns += ["verdict"] if outcomes else []
    columns += (["run to run"] if launches else []) + (["from nominal"] if passport else [])
    rows = []
    for p in parameters:
        size, unit = units[p.name]
        row = [p.name, described(p.name), *with_expanded(p, size), unit]
        row += [as_value(before.get(p.name), p, size)] if before else []
        row += [factor(p)] if factors else []
        row += [outcomes.get(p.name, NONE)] if outcomes else []
        row += [as_value(p.run_to_run, p, size)] if launches else []
        row += [as_value(p.deviation, p, size)] if passport else []
        rows.append(tuple(row))
    words = (0, 1, 4, columns.index("verdict")) if outcomes else (0, 1, 4)
    return ReportTable(columns=tuple(columns), rows=tuple(rows), text=words, halves=len(rows) > _MOST_ROWS)


def beyond(calibration: Calibration) -> Section | None:
    """A line for each group beyond the linear model, what its prior decides, and all its parameters."""
    lines = group_lines(calibration)
    if not lines:
        return None
    blocks: list[Block] = [
        Text(
            text="Each group has a prior, the standard deviation over instruments of its grade or that of the data "
            "sheet; where the data exceed it, it was widened. Learned is how much of the prior's variance the "
            "recording has taken off: at 0 % only the prior is known."
        ),
        _group_table(lines),
    ]
    if decided := decided_by_priors(calibration):
        blocks.append(Text(text=f"{decided[0].upper()}{decided[1:]}."))
    if further := further_parameters(calibration.parameters):
        blocks.append(_further_table(further))
    return Section(title="Beyond the linear model", blocks=tuple(blocks))


def _group_table(lines: Sequence[GroupLine]) -> ReportTable:
    rows = []
    for line in lines:
        value, u = (NONE, NONE) if line.largest is None else with_standard(line.largest, line.size)
        prior = NONE if line.prior is None else significant(line.prior / line.size, 4)
        rows.append((line.name, line.words, value.lstrip("−"), u, prior, line.shown, line.learned_percent, line.remark))
    columns = ("group", "what it is", "largest", "u", "prior", "unit", "learned", "")
    return ReportTable(columns=columns, rows=tuple(rows), text=(0, 1, 5, 7), dense=True)


def _further_table(parameters: Sequence[Parameter]) -> ReportTable:
    units = shown_units(parameters)
    rows = []
    for p in parameters:
        size, unit = units[p.name]
        prior = NONE if p.prior is None else significant(p.prior / size, 4)
        learned = NONE if p.learned is None else f"{100.0 * p.learned:.0f} %"
        rows.append((p.name, *with_standard(p, size), factor(p), unit, prior, learned))
    return ReportTable(
        columns=("parameter", "value", "u", "k", "unit", "prior", "learned"),
        rows=tuple(rows),
        text=(0, 4),
        caption="u is the standard uncertainty, k u the half width of the interval of 95.45 %, prior a standard "
        "deviation, as widened.",
        dense=True,
    )


def launches(calibration: Calibration) -> Section:
    """Every launch beside the others: bias, scale and axes, then what is beyond the linear model in a table of its
    own."""
    blocks: list[Block] = [
        Text(
            text="The result is the mean of these launches (power-ons). Run to run is the standard deviation from one "
            "launch to another; it is in the uncertainty of the mean."
        ),
        _launch_table(calibration, linear_parameters(calibration.parameters), dense=len(calibration.launches) > 4),
    ]
    if further := further_parameters(calibration.parameters):
        blocks += [Text(text="Beyond the linear model:"), _launch_table(calibration, further, dense=True)]
    blocks.append(Facts(rows=tuple((f"log of {launch.session}", _digest(launch)) for launch in calibration.launches)))
    return Section(title="Launches", blocks=tuple(blocks))


def _launch_table(calibration: Calibration, parameters: Sequence[Parameter], *, dense: bool) -> ReportTable:
    units = shown_units(calibration.parameters)
    found = [{p.name: p for p in launch.parameters} for launch in calibration.launches]
    rows = []
    for p in parameters:
        size, unit = units[p.name]
        values = [with_expanded(own[p.name], size)[0] if p.name in own else NONE for own in found]
        rows.append((p.name, *values, as_value(p.run_to_run, p, size), unit))
    return ReportTable(
        columns=("parameter", *(launch.session for launch in calibration.launches), "run to run", "unit"),
        rows=tuple(rows),
        text=(0, len(found) + 2),
        dense=dense,
    )


def _digest(launch: Launch) -> str:
    return f"SHA-256 {launch.log_sha256}" if launch.log_sha256 else NONE


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
    if further_parameters(calibration.parameters):
        blocks.append(
            Text(
                text="This is the linear model. The terms of the groups beyond it are to be taken off the reading "
                "before, as “tumble apply” does; the test vectors are without them."
            )
        )
    if not known:
        blocks.append(Text(text="No matrix can be given: a parameter it needs was not determined."))
    for kind, model in known.items():
        blocks += _applied(kind, model, _unit(calibration, kind))
    return Section(title="How to apply it", blocks=tuple(blocks))


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
    rows = []
    for kind, readings in calibration.readings.items():
        for column, scale, offset in zip(readings.columns, readings.scale, readings.offset, strict=True):
            unit = readings.unit + (" per sample" if readings.increments else "")
            rows.append((column, _BLOCKS.get(kind, kind), unit, significant(scale, 10), significant(offset, 10)))
    if not rows:
        return [Text(text="A reading is the output in SI after the nominal scale and offset of the device.")]
    said = "A reading is the output in SI after the nominal scale and offset: (raw − offset) / scale"
    if any(readings.increments for readings in calibration.readings.values()):
        said += ", for increments divided by the interval of the sample"
    columns = ("column of the log", "sensor", "raw unit", "scale (raw per SI unit)", "offset (raw)")
    return [Text(text=said + "."), ReportTable(columns=columns, rows=tuple(rows), text=(0, 1, 2))]


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
        Matrices(
            matrices=(
                Matrix(symbol="reading", rows=tuple((fixed(v, 6),) for v in reading), unit=unit),
                Matrix(symbol="true", rows=tuple((fixed(v, TRUE_DIGITS),) for v in true), unit=unit),
            )
        ),
    ]


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
        factor = drawings.lean_factor(models)
        caption = "The body frame X, Y, Z and the sensing axes in it."
        if factor > 1.0:
            caption = f"{caption[:-1]}, their deviations from the body axes drawn {factor:.0f} times larger."
        svg = drawings.frame(name, calibration.accel, calibration.gyro)
        blocks.append(Figure(svg=svg, caption=caption, width=drawings.FRAME))
    return Section(title="The frame", blocks=tuple(blocks))


# Uncertainty


def correlations(calibration: Calibration, name: str) -> Section | None:
    """What U covers, the heat map and the strongest correlations."""
    if calibration.covariance is None:
        return None
    names = [p.name for p in calibration.parameters]
    u = np.sqrt(np.diag(calibration.covariance))
    scale = np.where(u > 0.0, u, 1.0)
    r = np.clip(calibration.covariance / scale[:, None] / scale, -1.0, 1.0)
    p, q = np.tril_indices(len(names), -1)
    order = np.argsort(-np.abs(r[p, q]), kind="stable")[:_STRONGEST]
    rows = tuple((names[p[i]], names[q[i]], fixed(float(r[p[i], q[i]]), 3)) for i in order)
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
            "the calibration file. The strongest:"
        )
        blocks += [Text(text=said), ReportTable(columns=("parameter", "with", "coefficient"), rows=rows, text=(0, 1))]
    blocks.append(
        Figure(
            svg=figures.correlations(name, names, r),
            caption="Correlation coefficients of the parameters"
            + (", in hundredths." if len(names) <= figures.MOST_WITH_NUMBERS else "."),
            width=figures.MAP,
        )
    )
    return Section(title="Covariance and correlations", blocks=tuple(blocks))


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


def covariance(calibration: Calibration) -> Section | None:
    """The whole covariance matrix, a table for each pair of kinds of sensor; none where a page has no room for it."""
    if calibration.covariance is None:
        return None
    names = [p.name for p in calibration.parameters]
    linear = [name for name in names if not beyond_linear(name)]
    said = "In products of SI units (m/s², 1, rad, rad/s), in the order of the file."
    if len(linear) < len(names):
        said += f" Of the linear model; that of all {len(names)} parameters is in the calibration file."
    kinds = list(dict.fromkeys(sensor_kind(name) for name in linear))
    members = {kind: [names.index(name) for name in linear if sensor_kind(name) == kind] for kind in kinds}
    blocks: list[Block] = [Text(text=said)]
    if any(len(own) > _MOST_COLUMNS for own in members.values()):
        return None
    for n, first in enumerate(kinds):
        for second in kinds[: n + 1]:
            rows = tuple(
                (names[i], *(_entry(calibration.covariance, i, j, lower=first == second) for j in members[second]))
                for i in members[first]
            )
            columns = (first, *(within_kind(names[j]) for j in members[second]))
            blocks.append(ReportTable(columns=columns, rows=rows, dense=True, caption=f"{first} with {second}"))
    return Section(title="Covariance matrix", blocks=tuple(blocks), one_page=len(kinds) <= _MOST_KINDS)


def _entry(covariance: Array, i: int, j: int, *, lower: bool) -> str:
    if lower and j > i:
        return ""
    mantissa, exponent = f"{covariance[i, j]:.2e}".split("e")
    return f"{mantissa}e{int(exponent)}".replace("-", "−")


def convergence(calibration: Calibration, name: str) -> Section | None:
    """Root mean square of the increments of every kind of parameter in each iteration."""
    if not calibration.iterations:
        return None
    parameters = linear_parameters(calibration.parameters)
    kinds = by_group(parameters)
    rows = []
    for number, step in enumerate(calibration.iterations, 1):
        row = [str(number)]
        for alike in kinds.values():
            rms = float(np.sqrt(np.mean([step.get(p.name, 0.0) ** 2 for p in alike])))
            size, unit = engineering(alike[0].unit, rms)
            row.append(f"{significant(rms / size, 3)} {unit}" if rms > 0.0 else NONE)
        rows.append(tuple(row))
    table = ReportTable(
        columns=("iteration", *kinds),
        rows=tuple(rows),
        dense=len(kinds) > 5,
        caption="Increments, root mean square of each kind of parameter.",
    )
    blocks: list[Block] = []
    if any(p.u for p in parameters):
        svg = figures.convergence(name, calibration.iterations, parameters)
        caption = "The largest increment of each kind of parameter, in units of its standard uncertainty u."
        blocks.append(Figure(svg=svg, caption=caption))
    return Section(title="Convergence", blocks=(*blocks, table))


def verdict(calibration: Calibration) -> list[Block]:
    """Whether the calibration is accepted, the reasons against it, and the remarks with what they are caused by."""
    outcome = calibration.outcome
    if not outcome.accepted and (usable := accepted_kinds(calibration)):
        tone: Tone = "doubt"
        said = f"The {' and '.join(WORDS[kind] for kind in usable)} alone: values of others must not be used."
    elif not outcome.accepted:
        tone = "bad"
        said = "Not accepted: these values must not be used."
    elif outcome.remarks:
        tone = "doubt"
        said = "Accepted with scatter: the noise within the rests does not explain all residuals."
    else:
        tone = "good"
        said = _agreement(calibration)
    blocks: list[Block] = [Text(text=said, tone=tone)]
    *parts, _ = verdicts(calibration)
    if parts:
        blocks.append(Text(text=f"{'; '.join(parts).capitalize()}."))
    if outcome.reasons:
        blocks.append(Items(items=outcome.reasons, tone="bad"))
    return [*blocks, *([Items(items=outcome.remarks)] if outcome.remarks else [])]


def _agreement(calibration: Calibration) -> str:
    """That it is accepted, and what nothing checks."""
    unchecked = " and ".join(name for name, fit in calibration.fits.items() if fit.degrees < 0.5)
    said = "Accepted: the recording determines every parameter given here, and its residuals agree with the model."
    if unchecked:
        said += f" Nothing checks the {unchecked}: there are no more data than unknowns."
    return said
