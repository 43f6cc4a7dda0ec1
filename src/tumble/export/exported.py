"""What every export is made of: the models of a calibration, worked examples, and notes on what a target cannot hold.

An export has at most three notes: what the target leaves of matrices and biases, what it has no place for, and what the
user has to see to. Errors are the largest over all attitudes at 1 g, and for effects of motion at the rate of the
session's turns. Readings are those of the calibration file: SI, after nominal scale and offset.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tumble.brief import Brief
from tumble.errors import InputError
from tumble.inference.prediction import directions
from tumble.result.accepted import WORDS
from tumble.result.calibration import Calibration
from tumble.sensors.instrument import Instrument, functions
from tumble.sensors.model import SensorKind, SensorModel
from tumble.sensors.parameters import (
    FORCE,
    ParameterGroup,
    group_name,
    groups,
    positions_by_group,
    within_kind,
)
from tumble.units import DEGREE, G_STANDARD, Array

UNITS: Mapping[SensorKind, str] = {"accel": "m/s^2", "gyro": "rad/s"}
EXAMPLE: Mapping[SensorKind, Array] = {"accel": np.array([0.5, -1.0, 9.7]), "gyro": np.array([0.1, -0.2, 0.3])}
"""True vectors near which the examples are, m/s² and rad/s."""

MAGNETOMETER = "mag"
"""In the groups that a target holds: matrix and bias of the magnetometer."""
SINGLE_PRECISION = "the target computes in single precision: 7 digits of each number"
NO_PLACE = "no place in this file for"
NOT_IN_MATRIX = "not in matrix and bias:"

USUAL_RATE = 100.0 * DEGREE
"""rad/s, where a calibration does not say how fast its turns were."""
NEGLIGIBLE = 0.1
"""Of the standard uncertainty of a reading: it adds less than √(1 + 0.1²) − 1 = 0.5 % to that."""
MOST_NAMED = 2
"""Groups of a kind of sensors that are named with their errors; all others have a common bound."""
WARMER, HOUR = 10.0, 3600.0
"""K and s over which changes are stated."""
HEATING = 1.0 / 60.0
"""K/s at which the effect of a lag is stated."""
ROUNDING = 1e-6
"""Relative errors of single precision, which are not stated one by one."""


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Exported(Brief):
    """A file in the format of another program.

    Attributes
    ----------
    content
        The bytes of the file.
    losses
        What the format cannot hold, one sentence each.
    """

    content: bytes
    losses: tuple[str, ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Example:
    """A reading (n,) and the true vector (3,) it stands for, SI."""

    reading: Array
    true: Array


def example(kind: SensorKind, model: SensorModel) -> Example:
    """A reading of six decimals, and what the calibration makes of it."""
    reading = np.round(model.predict(EXAMPLE[kind]), 6)
    return Example(reading=reading, true=model.apply(reading))


def example_line(kind: SensorKind, reading: Array, true: Array, becomes: Array | None = None, where: str = "") -> str:
    """A worked example as a comment: a reading, what the target makes of it where that is something else, and what it
    is, SI."""
    what = f"is {shown(true.round(9))}"
    if becomes is not None:
        near, exact = shown(becomes.round(6)), shown(true.round(6))
        what = f"is {exact}" if near == exact else f"becomes {near}; it is {exact}"
    return f"example {kind}{where}: reading {shown(reading)} {what} {UNITS[kind]}"


def models(calibration: Calibration) -> dict[SensorKind, SensorModel]:
    """The models a calibration has, by kind. Raises InputError where it has none."""
    both: dict[SensorKind, SensorModel | None] = {"accel": calibration.accel, "gyro": calibration.gyro}
    known = {kind: model for kind, model in both.items() if model is not None}
    if not known:
        raise InputError("calibration: expected a sensor whose parameters are all known, found none; calibrate again")
    return known


def triads(
    calibration: Calibration, target: str, needed: Sequence[SensorKind] = ("accel", "gyro")
) -> dict[SensorKind, SensorModel]:
    """The accelerometers and the gyros that there are, three of each, those that are `needed` among them. Raises
    InputError otherwise."""
    known = models(calibration)
    for kind in needed:
        if kind not in known:
            found = "; ".join(calibration.provenance.absent) or "none in the calibration"
            raise InputError(f"export to {target}: expected {kind} parameters, found {found}")
    for kind, model in known.items():
        if len(model.bias) != 3:
            raise InputError(
                f"export to {target}: expected three {kind} sensors, found {len(model.bias)}; c, csv and mat hold any "
                "number"
            )
    return known


def origin(calibration: Calibration) -> list[str]:
    """Where the numbers come from, line by line."""
    made = calibration.provenance
    device = calibration.serial if calibration.model is None else f"{calibration.serial} ({calibration.model})"
    lines = [
        f"device {device}, frame {calibration.frame}, method {calibration.method}",
        f"{made.software or 'tumble'}, {made.created or 'no date'}, log sha256 {made.log_sha256 or 'unknown'}",
    ]
    for kind in UNITS:
        readings = calibration.provenance.readings.get(kind)
        if readings is not None and readings.unit in ("count", "V"):
            scale, offset = (" ".join(f"{number:g}" for number in row) for row in (readings.scale, readings.offset))
            lines.append(f"{kind} readings in {UNITS[kind]} are (raw - offset) / scale: offset {offset}, scale {scale}")
    return [one_line(line) for line in (*lines, *calibration.provenance.absent)]


def one_line(text: str) -> str:
    """A text that can stand in a comment of any format: one line, nothing that ends or continues it."""
    shown = "".join(c if c.isprintable() else " " for c in text)
    return " ".join(shown.replace("*/", "* /").replace("\\", "/").split())


def numbers(values: Array) -> list[float]:
    """An array as plain floats, row by row."""
    return [float(value) for value in np.ravel(values)]


def shown(values: Array) -> str:
    """Numbers as text that reads back to the same ones."""
    return " ".join(map(repr, numbers(values)))


def yaml_number(value: float) -> str:
    """A number as every YAML reader takes it for one: YAML 1.1, and so PyYAML, reads 2e-05 as a text."""
    mantissa, e, exponent = repr(float(value)).partition("e")
    return mantissa + (".0" if e and "." not in mantissa else "") + e + exponent


def yaml_list(values: Array) -> str:
    """Numbers as a list in YAML, on one line."""
    return f"[{', '.join(map(yaml_number, numbers(values)))}]"


# -------------------- what a target cannot hold --------------------


def notes_of(
    calibration: Calibration,
    *,
    left: Iterable[str] = (),
    held: Container[str] = (),
    lacks: Iterable[str] = ("uncertainties and their covariance",),
    place: str = NO_PLACE,
    see_to: Iterable[str] = (),
) -> tuple[str, ...]:
    """What a target cannot hold, in at most three notes.

    Parameters
    ----------
    calibration
        What is exported.
    left
        What the target leaves of matrices and biases.
    held
        Names of the groups of parameters beyond matrix and bias that it holds, and MAGNETOMETER where it holds that.
    lacks
        What else it has no place for.
    place
        The words before all that.
    see_to
        What the user has to see to.

    Returns
    -------
    tuple of str
        The notes, with the largest errors in physical units.
    """
    lost = [*lacks]
    if calibration.mag is not None and MAGNETOMETER not in held:
        lost.append("matrix and bias of the magnetometer")
    lost += groups_not_held(calibration, held)
    first, last = "; ".join(left), "; ".join(see_to)
    return tuple(note for note in (first, f"{place} {'; '.join(lost)}" if lost else "", last) if note)


def not_held(calibration: Calibration, held: Container[str] = ()) -> tuple[str, ...]:
    """The note on what a table of parameters with matrices and biases does not apply; none where that is nothing."""
    return notes_of(calibration, held=held, lacks=(), place=NOT_IN_MATRIX)


def groups_not_held(calibration: Calibration, held: Container[str] = ()) -> list[str]:
    """The groups of parameters beyond the linear model that a calibration has and a target does not hold: of each kind
    of sensors the largest with their errors, and how many others there are and how large they are at most. Errors far
    below the uncertainty of a reading are not named."""
    known, out = calibration.prediction, []
    u = {"accel": 0.0 if known is None else known.force_u, "gyro": 0.0 if known is None else known.rate_u or 0.0}
    present = positions_by_group(p.name for p in calibration.parameters)
    models_of: dict[SensorKind, SensorModel | None] = {"accel": calibration.accel, "gyro": calibration.gyro}
    for kind, model in models_of.items():
        lost = [g for g in groups() if g.kind == kind and not g.linear and g.name in present and g.name not in held]
        if model is None or not lost:
            continue
        errors = sorted(((*_largest(calibration, group), group) for group in lost), key=lambda each: -each[0])
        named = [each for each in errors[:MOST_NAMED] if each[0] >= NEGLIGIBLE * u[kind]]
        words = [f"{_plain_words(group)} ({in_units(kind, error)} {where})" for error, where, group in named]
        if others := errors[len(named) :]:
            plural = "group" if len(others) == 1 else "groups"
            words.append(f"{len(others)} {'more ' if named else ''}{plural} of at most {in_units(kind, others[0][0])}")
        out.append(f"of the {WORDS[kind]} {' and '.join(filter(None, [', '.join(words[:-1]), words[-1]]))}")
    return out


def in_units(kind: SensorKind, error: float) -> str:
    """An error of accelerometers or gyros, SI, in mg or deg/s."""
    return f"{error / (1e-3 * G_STANDARD):.3g} mg" if kind == "accel" else f"{error / DEGREE:.3g} deg/s"


def _plain_words(group: ParameterGroup) -> str:
    """What reports call a group, in ASCII and without the kind of sensors."""
    words = group.words.partition(",")[0].replace("−", "-")
    return words.replace(f" of the {WORDS[group.kind]}", "")


def left_of_model(kind: SensorKind, error: Array, bias: Array | None = None) -> list[str]:
    """What a target leaves of the model of one kind of sensors.

    Parameters
    ----------
    kind
        Accelerometers or gyros.
    error
        (3, 3): corrected vector less true vector, by the true vector.
    bias
        (3,): corrected vector at zero, m/s² or rad/s; None where it is not stated.

    Returns
    -------
    list of str
        Nothing where single precision is all that is lost.
    """
    out = []
    if (relative := worst(error)) > ROUNDING:
        felt = (
            f"in 1 g an error of up to {G_STANDARD * relative:.3g} m/s^2"
            if kind == "accel"
            else f"an error of up to {100.0 * relative:.3g} % of the rate"
        )
        out.append(f"scale factors and misalignment of the {WORDS[kind]}: {felt}")
    off = 0.0 if bias is None else float(np.abs(bias).max())
    if off > ROUNDING * (G_STANDARD if kind == "accel" else 1.0):
        out.append(f"biases of the {WORDS[kind]}: up to {off:.3g} {UNITS[kind]} off")
    return out


def worst(error: Array) -> float:
    """The largest relative error |E v| / |v| of any vector."""
    return float(np.linalg.norm(error, ord=2))


def session_rate(calibration: Calibration) -> float:
    """The rate, rad/s, of the turns of a session, or a usual one."""
    if calibration.prediction is None or calibration.prediction.at_rate is None:
        return USUAL_RATE
    return calibration.prediction.at_rate


def _largest(calibration: Calibration, group: ParameterGroup) -> tuple[float, str]:
    """The largest effect of a group on a reading, SI, and where."""
    rate = session_rate(calibration)
    at_rate = f"at {rate / DEGREE:.3g} deg/s"
    felt, where = (G_STANDARD, "in 1 g") if group.kind == "accel" else (rate, at_rate)
    compensator, values = calibration.compensator, {p.name: p.value for p in calibration.parameters}
    block = compensator.accel if group.kind == "accel" else compensator.gyro
    names = () if block is None else group.names(block)
    own = np.array([values[name] for name in values if name in names])
    if group.motion == "lever":
        return rate**2 * float(np.linalg.norm(own.reshape(-1, 3), axis=1).max()), at_rate
    if group.motion in ("delay", "single delay"):
        return rate * G_STANDARD * float(np.abs(own).max()), f"in 1 g {at_rate}"
    if group.variable == "lag":  # on a bias of the accelerometers
        slopes = [abs(value) for name, value in values.items() if group_name(name) == "accel.bias.t1"]
        return abs(float(own[0])) * HEATING * max(slopes, default=0.0), "at 1 K/min"
    if group.base is not None:  # a change of a bias or of a scale factor
        span, over = (HOUR, "after an hour") if group.variable == "time" else (WARMER, f"in {WARMER:.0f} K")
        if group.variable == "hysteresis":
            span, over = 1.0, "on the way up or down"
        change = float(np.abs(own).max()) * (WARMER**2 if group.variable == "temperature²" else span)
        return (change, over) if within_kind(group.base) == "bias" else (change * felt, f"{over} {where}")
    instrument = Instrument.of(compensator.accel, compensator.gyro, {group.name}, variables=())
    block = instrument.block(group)
    assert group.regressors is not None
    K = group.regressors(block) @ np.array([values.get(name, 0.0) for name in group.names(block)])
    up = np.concatenate([np.eye(3), -np.eye(3), directions()])  # in all attitudes at 1 g and at a rate about all axes
    effects = np.einsum("npb,pb->np", functions(block, G_STANDARD * up, rate * up), K)
    return float(np.abs(effects).max()), "in 1 g" if group.name == "gyro.g_sensitivity" else where


def g_sensitivity(calibration: Calibration) -> Array:
    """The g-sensitivity (n, 3) of the gyros by channel, rad/s per m/s²; zero where it is not known."""
    return np.array(calibration.compensator.gyro_coefficients[:, FORCE])
