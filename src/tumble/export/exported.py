"""What every export is made of: triads, worked examples, where the numbers come from, and what a target cannot hold.

An export states its target's own formula, an example worked with it, and as `losses` what the target has no place for
and how large that is: of a group of parameters beyond the linear model the largest change of a reading that it makes,
over all attitudes at 1 g, and of what only motion shows at the rate of the session's turns. Readings are those of the
calibration file: SI, after nominal scale and offset.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tumble.errors import InputError
from tumble.inference.prediction import directions
from tumble.result.calibration import Calibration
from tumble.sensors.instrument import Instrument, functions
from tumble.sensors.model import SensorKind, SensorModel
from tumble.sensors.parameters import (
    FORCE,
    ParameterGroup,
    group_name,
    groups,
    positions_by_group,
    sensor_kind,
    within_kind,
)
from tumble.units import DEGREE, G_STANDARD, Array

UNITS: Mapping[SensorKind, str] = {"accel": "m/s^2", "gyro": "rad/s"}
UNSCALED: Mapping[SensorKind, float] = {"accel": 1.0, "gyro": 1.0}
EXAMPLE: Mapping[SensorKind, Array] = {"accel": np.array([0.5, -1.0, 9.7]), "gyro": np.array([0.1, -0.2, 0.3])}
"""True vectors near which the examples are, m/s² and rad/s."""

NO_UNCERTAINTY = "uncertainties and their covariance have no place in this file"
NO_MAGNETOMETER = "matrix and bias of the magnetometer have no place in this file"
SINGLE_PRECISION = "the target computes in single precision: 7 digits of each number"
NO_PLACE = "no place in this file"
NOT_IN_MATRIX = "not in matrix and bias"

USUAL_RATE = 100.0 * DEGREE
"""rad/s, where a calibration does not say how fast its turns were."""
NEGLIGIBLE = 0.1
"""Of the standard uncertainty of a reading: it adds less than √(1 + 0.1²) − 1 = 0.5 % to that."""
WARMER, HOUR = 10.0, 3600.0
"""K and s over which changes are stated."""
HEATING = 1.0 / 60.0
"""K/s at which the effect of a lag is stated."""


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


# -------------------- groups of parameters beyond the linear model --------------------


def losses_of(calibration: Calibration, *own: str, held: Container[str] = (), precision: str = "") -> tuple[str, ...]:
    """What a format of matrices and biases loses: its `own` losses, the groups of parameters that are not `held`, of
    its `precision`, and uncertainties."""
    return (*own, *not_held(calibration, held), *([precision] if precision else []), NO_UNCERTAINTY)


def not_held(calibration: Calibration, held: Container[str] = (), said: str = NO_PLACE) -> tuple[str, ...]:
    """A sentence for each group beyond the linear model that the calibration has and that is not `held`: those of
    accelerometers and those of gyros, of each the largest first; and one for all those that are NEGLIGIBLE."""
    absent = [kind for kind, model in (("accel", calibration.accel), ("gyro", calibration.gyro)) if model is None]
    if len(absent) == 2:
        return ()
    present = positions_by_group(p.name for p in calibration.parameters if sensor_kind(p.name) not in absent)
    lost = [group for group in groups() if not group.linear and group.name in present and group.name not in held]
    effects = [(group, *_largest(calibration, group)) for group in lost]
    effects.sort(key=lambda each: (each[0].kind, -each[1]))
    known, felt, rest = calibration.prediction, [], []
    u = {"accel": 0.0 if known is None else known.force_u, "gyro": 0.0 if known is None else known.rate_u or 0.0}
    for group, size, where in effects:
        words = group.words.partition(",")[0].replace("−", "-")
        if size < NEGLIGIBLE * u[group.kind]:
            rest.append(words)
            continue
        shown = f"{size / (1e-3 * G_STANDARD):.3g} mg" if group.kind == "accel" else f"{size / DEGREE:.3g} deg/s"
        felt.append(f"{words}: {said}, an error of up to {shown} {where}")
    if rest:
        felt.append(f"{'; '.join(rest)}: {said}, errors of less than a tenth of the standard uncertainty of a reading")
    return tuple(felt)


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


def still(sensitivity: Array) -> tuple[str, ...]:
    """What an example of gyros with g-sensitivity supposes."""
    return ("the example of the gyros is without acceleration",) if np.any(sensitivity) else ()
