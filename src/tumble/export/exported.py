"""Common parts of all exports: models of a calibration, worked examples, notes on what a target cannot hold.

A target with only matrix and bias gets those that fit the whole model best (`tumble.result.correction`). An export has
at most three notes: how large the target's errors are, what it has no place for, and what the user has to do. Readings
are those of the calibration file: SI, after nominal scale and offset.
"""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from tumble.brief import Brief
from tumble.errors import InputError
from tumble.result.calibration import Calibration
from tumble.result.correction import Example, best_linear_model, correction_errors, session_rate
from tumble.result.temperature_curves import measured_range
from tumble.sensors.model import UNITS, WORDS, SensorKind, SensorModel
from tumble.sensors.parameters import (
    FORCE,
    THERMAL,
    ParameterGroup,
    group_name,
    groups,
    positions_by_group,
    within_kind,
)
from tumble.units import DEGREE, G_STANDARD, Array

MAGNETOMETER = "mag"
"""Matrix and bias of the magnetometer, as a group of parameters."""
NEGLIGIBLE = 0.1  # relative to the u of a reading; it increases u by less than √(1 + 0.1²) − 1 = 0.5 %
WARMING, HOUR = 10.0, 3600.0  # K and s, over which changes are stated
MOST_STATED = 2  # effects of each kind of sensor, the largest, whose size is in a note
HEATING_RATE = 1.0 / 60.0  # K/s, at which the effect of a lag is stated
ROUNDING = 1e-6  # relative error of single precision, which is not stated


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Exported(Brief):
    """A file in the format of another program.

    Attributes
    ----------
    content
        The bytes of the file.
    losses
        Notes on what the format cannot hold.
    reasons
        Why a certificate in the file states that not everything passes.
    """

    content: bytes
    losses: tuple[str, ...]
    reasons: tuple[str, ...] = ()


def example_line(kind: SensorKind, worked: Example, becomes: Array | None = None, where: str = "") -> str:
    """Return a worked example as a comment, with the result of the target if it differs, SI."""
    result = f"is {shown(worked.true.round(9))}"
    if becomes is not None:
        near, exact = shown(becomes.round(6)), shown(worked.true.round(6))
        result = f"is {exact}" if near == exact else f"becomes {near}; it is {exact}"
    return f"example {kind}{where}: reading {shown(worked.reading)} {result} {UNITS[kind]}"


def models(calibration: Calibration) -> dict[SensorKind, SensorModel]:
    """Return the models of a calibration by kind of sensor. Raises InputError if it has none."""
    both: dict[SensorKind, SensorModel | None] = {"accel": calibration.accel, "gyro": calibration.gyro}
    present = {kind: model for kind, model in both.items() if model is not None}
    if not present:
        raise InputError("calibration: expected a sensor whose parameters are all known, found none; calibrate again")
    return present


def triads(
    calibration: Calibration,
    target: str,
    needed: Sequence[SensorKind] = ("accel", "gyro"),
    held: Container[str] = (),
) -> dict[SensorKind, SensorModel]:
    """Return the linear models of the accelerometers and gyros that fit the whole model best, apart from the groups
    `held` by the target itself.

    Raises InputError if a `needed` kind is missing or has other than three sensors."""
    by_kind = models(calibration)
    for kind in needed:
        if kind not in by_kind:
            absent = "; ".join(calibration.provenance.absent) or "none in the calibration"
            raise InputError(f"export to {target}: expected {kind} parameters, found {absent}")
    for kind, model in by_kind.items():
        if len(model.bias) != 3:
            raise InputError(
                f"export to {target}: expected three {kind} sensors, found {len(model.bias)}; c, csv and mat hold any "
                "number"
            )
    return {kind: best_linear_model(calibration, kind, held) for kind in by_kind}


def origin(calibration: Calibration) -> list[str]:
    """Return comments on the device, the calibration and its recording."""
    made_by = calibration.provenance
    device = calibration.serial if calibration.model is None else f"{calibration.serial} ({calibration.model})"
    lines = [
        f"device {device}, frame {calibration.frame}, method {calibration.method}",
        f"{made_by.software or 'tumble'}, {made_by.created or 'no date'}, log sha256 {made_by.log_sha256 or 'unknown'}",
    ]
    for kind in UNITS:
        readings = calibration.provenance.readings.get(kind)
        if readings is not None and readings.unit in ("count", "V"):
            scale, offset = (" ".join(f"{number:g}" for number in row) for row in (readings.scale, readings.offset))
            lines.append(f"{kind} readings in {UNITS[kind]} are (raw - offset) / scale: offset {offset}, scale {scale}")
    return [one_line(line) for line in (*lines, *made_by.absent, *made_by.doubts)]


def one_line(text: str) -> str:
    """Return a text that can stand in a comment of any format: one line, with nothing that ends or continues it."""
    shown = "".join(c if c.isprintable() else " " for c in text)
    return " ".join(shown.replace("*/", "* /").replace("\\", "/").split())


def shown(values: Array) -> str:
    """Format numbers so that they read back exactly."""
    return " ".join(map(repr, np.ravel(values).tolist()))


def yaml_number(value: float) -> str:
    """Format a number for every YAML reader: PyYAML (YAML 1.1) reads 2e-05 as a text."""
    mantissa, e, exponent = repr(float(value)).partition("e")
    return mantissa + (".0" if e and "." not in mantissa else "") + e + exponent


# -------------------- what a target cannot hold --------------------


Correct = Callable[[Array], Array]
"""Correction of readings (N, 3) by a target, SI."""


def notes_of(
    calibration: Calibration,
    *,
    corrections: Mapping[SensorKind, Correct] = MappingProxyType({}),
    remarks: Iterable[str] = (),
    held: Container[str] = (),
    lacks: Iterable[str] = ("uncertainties",),
    see_to: Iterable[str] = (),
) -> tuple[str, ...]:
    """Return at most three notes on what a target cannot hold, with the largest errors in physical units.

    `corrections` are those of readings by the target, `remarks` further sentences on what it does not correct. Beyond
    matrix and bias it holds the groups of parameters `held` (MAGNETOMETER among them), and `lacks` a place for other
    things; `see_to` is what the user has to do."""
    largest = (_largest_errors(calibration, kind, correct, held) for kind, correct in corrections.items())
    errors = ", ".join(filter(None, largest))
    first = [
        *remarks,
        *_missing_kinds(calibration),
        *([f"remaining error: {errors}"] if errors else []),
    ]
    lost = [*lacks, *_groups_not_held(calibration, held)]
    no_place = f"not in this file: {'; '.join(lost)}" if lost else ""
    return tuple(note for note in ("; ".join(first), no_place, "; ".join(see_to)) if note)


def _missing_kinds(calibration: Calibration) -> list[str]:
    known = models(calibration)
    return [f"{words}: not known, left as they are" for kind, words in WORDS.items() if kind in UNITS.keys() - known]


def table_notes(calibration: Calibration) -> tuple[str, ...]:
    """Return notes on a table of all parameters: missing sensors, and errors of matrices and biases."""
    by_kind = models(calibration).items()
    errors = filter(None, (_largest_errors(calibration, kind, model.apply, ()) for kind, model in by_kind))
    lost = [*errors, *_groups_not_held(calibration)]
    return (*_missing_kinds(calibration), *([f"not in matrices and biases: {'; '.join(lost)}"] if lost else []))


def _largest_errors(calibration: Calibration, kind: SensorKind, correct: Correct, held: Container[str]) -> str:
    """Describe the errors of corrected readings at 1 g and at the rate of the session, at the reference temperature;
    empty if they are mere rounding."""
    errors = correction_errors(calibration, kind, correct, held)
    rate = session_rate(calibration)
    if errors.max() < ROUNDING * (G_STANDARD if kind == "accel" else rate):
        return ""
    where = "in 1 g" if kind == "accel" else f"at {rate / DEGREE:.3g} deg/s in 1 g"
    most, rms = in_units(kind, float(errors.max())), in_units(kind, float(np.sqrt(np.mean(errors**2))))
    return f"{WORDS[kind]} by up to {most} (rms {rms}) {where}"


def _groups_not_held(calibration: Calibration, held: Container[str] = ()) -> list[str]:
    """Return what a target does not hold, the magnetometer and effects of motion, temperature and time, if not
    negligible against the uncertainty of a reading."""
    prediction, present = calibration.prediction, positions_by_group(p.name for p in calibration.parameters)
    by_kind = {
        "accel": (calibration.accel, 0.0 if prediction is None else prediction.force_u),
        "gyro": (calibration.gyro, 0.0 if prediction is None else prediction.rate_u or 0.0),
    }
    out = ["matrix and bias of the magnetometer"] if calibration.mag and MAGNETOMETER not in held else []
    for kind, (model, u) in by_kind.items():
        # groups with regressors are in the errors of corrected readings (`_largest_errors`)
        further = [g for g in groups() if g.kind == kind and g.regressors is None and not g.linear]
        lost = [g for g in further if model is not None and g.name in present and g.name not in held]
        effects = sorted(((*_largest_effect(calibration, group), group) for group in lost), key=lambda each: -each[0])
        for place, (error, where, group) in enumerate(each for each in effects if each[0] >= NEGLIGIBLE * u):
            size = f" ({in_units(group.kind, error)} {where})" if place < MOST_STATED else ""
            out.append(group.words.partition(",")[0] + size)
    return [words.replace("−", "-") for words in out]


def in_units(kind: SensorKind, error: float) -> str:
    """Format an error of accelerometers or gyros, SI, in mg or deg/s."""
    return f"{error / (1e-3 * G_STANDARD):.3g} mg" if kind == "accel" else f"{error / DEGREE:.3g} deg/s"


def _largest_effect(calibration: Calibration, group: ParameterGroup) -> tuple[float, str]:
    """Return the largest effect of a group on a reading, SI, and under which conditions."""
    rate = session_rate(calibration)
    at_rate = f"at {rate / DEGREE:.3g} deg/s"
    input_size, where = (G_STANDARD, "in 1 g") if group.kind == "accel" else (rate, at_rate)
    values = {p.name: p.value for p in calibration.parameters}
    members = np.array([value for name, value in values.items() if group_name(name) == group.name])
    if group.motion == "lever":
        return rate**2 * float(np.linalg.norm(members.reshape(-1, 3), axis=1).max()), at_rate
    if group.motion is not None:  # delays
        return rate * G_STANDARD * float(np.abs(members).max()), f"in 1 g {at_rate}"
    if group.base is None:  # a lag, by its effect on the bias
        slopes = [abs(value) for name, value in values.items() if group_name(name) == f"{group.kind}.bias.t1"]
        return abs(float(members[0])) * HEATING_RATE * max(slopes, default=0.0), "at 1 K/min"
    measured = measured_range(calibration)
    warming = WARMING if measured is None else min(WARMING, measured[1] - measured[0])  # no extrapolation
    span, over = (HOUR, "after an hour") if group.variable == "time" else (warming, f"in {warming:.2g} K")
    if group.variable == "hysteresis":
        span, over = 1.0, "on the way up or down"
    power = 1 + THERMAL.index(group.variable) if group.variable in THERMAL else 1
    change = float(np.abs(members).max()) * span**power
    return (change, over) if within_kind(group.base) == "bias" else (change * input_size, f"{over} {where}")


def g_sensitivity(calibration: Calibration) -> Array:
    """Return the g-sensitivity (n, 3) of the gyros, rad/s per m/s²; zero if it is not known."""
    return np.array(calibration.compensator.gyro_coefficients[:, FORCE])
