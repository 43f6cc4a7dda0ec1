"""What every export is made of: triads, worked examples, where the numbers come from, and what a target cannot hold.

An export states its target's own formula, an example worked with it, and as `losses` what the target has no place for
and how large that is. Readings are those of the calibration file: SI, after nominal scale and offset.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tumble.errors import InputError
from tumble.result.calibration import Calibration
from tumble.sensors.model import SensorKind, SensorModel
from tumble.units import Array

UNITS: Mapping[SensorKind, str] = {"accel": "m/s^2", "gyro": "rad/s"}
UNSCALED: Mapping[SensorKind, float] = {"accel": 1.0, "gyro": 1.0}
EXAMPLE: Mapping[SensorKind, Array] = {"accel": np.array([0.5, -1.0, 9.7]), "gyro": np.array([0.1, -0.2, 0.3])}
"""True vectors near which the examples are, m/s² and rad/s."""

NO_UNCERTAINTY = "uncertainties and their covariance have no place in this file"
NO_MAGNETOMETER = "matrix and bias of the magnetometer have no place in this file"
SINGLE_PRECISION = "the target computes in single precision: 7 digits of each number"


@dataclass(frozen=True, kw_only=True, slots=True)
class ExportedParameter:
    """A parameter of an autopilot: its value as the autopilot keeps it, whether that is a whole number, whether it says
    which sensor there is, and whether it is of a magnetometer."""

    name: str
    value: float
    whole: bool = False
    identity: bool = False
    magnetometer: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class Exported:
    """The bytes of a file, and in sentences what its format cannot hold; of an autopilot the `parameters` in it; and
    whether a magnetometer has its place."""

    content: bytes
    losses: tuple[str, ...]
    parameters: tuple[ExportedParameter, ...] = ()
    magnetometer: bool = False


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Example:
    """A reading (n,) and the true vector (3,) it stands for, SI."""

    reading: Array
    true: Array


def example(kind: SensorKind, model: SensorModel) -> Example:
    """A reading of six decimals, and what the calibration makes of it."""
    reading = np.round(model.predict(EXAMPLE[kind]), 6)
    return Example(reading=reading, true=model.apply(reading))


def examples(
    known: Mapping[SensorKind, SensorModel],
    form: str = "example {kind}: {reading} is {true}",
    sizes: Mapping[SensorKind, float] = UNSCALED,
) -> list[str]:
    """A worked example of each kind of sensors, a line each, in units that are so large (SI)."""
    lines = []
    for kind, model in known.items():
        worked, size = example(kind, model), sizes[kind]
        reading = worked.reading if size == 1.0 else (worked.reading / size).round(9)  # of six decimals in SI
        true = (worked.true / size).round(9)
        lines.append(form.format(kind=kind, reading=shown(reading), true=shown(true), unit=UNITS[kind]))
    return lines


def commented(comments: Iterable[str], lines: Iterable[str], losses: Iterable[str]) -> Exported:
    """A file of lines below comments that begin with #."""
    text = "\n".join([*(f"# {comment}".rstrip() for comment in comments), *lines, ""])
    return Exported(content=text.encode(), losses=tuple(losses))


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
            found = "; ".join(calibration.absent) or "none in the calibration"
            raise InputError(f"export to {target}: expected {kind} parameters, found {found}")
    for kind, model in known.items():
        if len(model.bias) != 3:
            raise InputError(
                f"export to {target}: expected three {kind} sensors, found {len(model.bias)}; c, csv, dcc and mat hold "
                "any number"
            )
    return known


def origin(calibration: Calibration, *, magnetometer: bool = False) -> list[str]:
    """Where the numbers come from, line by line, of a format that has a place for a magnetometer or not."""
    made = calibration.provenance
    device = calibration.serial if calibration.model is None else f"{calibration.serial} ({calibration.model})"
    lines = [
        f"device {device}, frame {calibration.frame}, method {calibration.method}",
        f"{made.get('software', 'tumble')}, {made.get('created', 'no date')}, "
        f"log sha256 {made.get('log_sha256', 'unknown')}",
    ]
    for kind in UNITS:
        readings = calibration.readings.get(kind)
        if readings is not None and readings.unit in ("count", "V"):
            scale, offset = (" ".join(f"{number:g}" for number in row) for row in (readings.scale, readings.offset))
            lines.append(f"{kind} readings in {UNITS[kind]} are (raw - offset) / scale: offset {offset}, scale {scale}")
    lines += calibration.absent
    lines += [NO_MAGNETOMETER] if calibration.mag is not None and not magnetometer else []
    return [one_line(line) for line in lines]


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
