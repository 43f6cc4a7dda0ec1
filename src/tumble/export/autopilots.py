"""PX4 and ArduPilot: parameter files of one accelerometer and one gyro, also over temperature.

    acceleration = (reading − offset) · factor        rate = reading − offset

in the axes of the sensor, m/s² and rad/s, single precision; board rotations come afterwards. The offsets are the biases
b. The factors are 1/Mᵢᵢ, which gives the accelerometers' matrix a unit diagonal. A magnetometer, in the units of the
autopilot, gauss or milligauss, has a symmetric matrix S: of M⁻¹ = R S, R a rotation, S is exported; R, the mounting of
the magnetometer, is another setting of autopilots. A magnetometer that the autopilot's own procedure would refuse is
not exported, with a note.

The layouts `layouts/px4.params.j2` and `layouts/ardupilot.parm.j2` have a description of each autopilot, its formulas
and limits with their source, and the names of its parameters.

The biases of a calibration are polynomials of degree three at most, so a cubic represents them completely; TMIN and
TMAX are the ends of the measured range. Scale factors have one value each, that at the reference temperature.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain

import numpy as np
from pydantic import BaseModel, ConfigDict
from scipy.linalg import polar

from tumble.documents import text_of_document
from tumble.errors import InputError
from tumble.export import split_template
from tumble.export.exported import MAGNETOMETER, Exported, example_line, in_units, notes_of, origin, shown, triads
from tumble.export.templates import LAYOUTS, render_layout
from tumble.reduction.rests.warming import LEAST_CHANGE
from tumble.reduction.rests.warming import OVER_TEMPERATURE as WIDE
from tumble.result.calibration import Calibration
from tumble.result.correction import linear_example
from tumble.result.temperature_curves import measured_range, rests_with_temperature, thermal_parameters
from tumble.rotation import rotation_vector
from tumble.sensors.model import SensorKind, SensorModel
from tumble.sensors.parameters import OVER_TEMPERATURE, group_name
from tumble.units import DEGREE, TESLA, Array

MIN_CHANGE = 0.01  # offsets (m/s², rad/s) and changes of scale below this are ignored by some releases of PX4
_HELD = frozenset(f"{kind}.bias.{t}" for kind in ("accel", "gyro") for t in OVER_TEMPERATURE)
"""Groups of parameters in the targets over temperature."""


class Autopilot(BaseModel):
    """Front matter of the layout of an autopilot.

    `about`, `formula` and `source` describe the autopilot, `rotation` is the parameter of the board's rotation. Notes:
    over temperature `at_reference`, and `taken_up` with the error of a step; `of_gyros`; on ids that have to be there
    already, `has_ids`, and that are missing over temperature, `lacks_ids`; on corrections too `small`. It calibrates
    `imus` IMUs, and over temperature `compensated` IMUs; `thermometers` are groups of sensors with one
    thermometer. Its polynomials are about the temperature `centre`, °C (None: the reference), with coefficients in
    units of `worth`, SI. For a magnetometer: `unit` and `sign` of the offsets, their largest length, the range of the
    diagonal, and the largest off-diagonal element."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    about: str
    formula: str
    source: str
    at_reference: str
    rotation: str
    of_gyros: str = ""
    taken_up: str = ""
    has_ids: str = ""
    lacks_ids: str = ""
    small: str = ""
    imus: int
    compensated: int
    thermometers: tuple[tuple[SensorKind, ...], ...]
    centre: float | None = None
    worth: float = 1.0
    unit: str
    sign: float
    longest: float
    factors: tuple[float, float]
    most_across: float = math.inf


_LAYOUT_FILES = {"px4": "px4.params.j2", "ardupilot": "ardupilot.parm.j2"}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Triad:
    """Correction of the three sensors of one kind by an autopilot.

    `number` is that of the IMU in the autopilot, from 1, `id` that of the device, None if it is not known. `offset`
    (3,) are the biases, SI, `factor` (3,) is 1/Mᵢᵢ, one for gyros. `known` is False if only changes over temperature
    were calibrated.

    Over temperature: the `measured` range (None: the file has no temperature) and the `reference`, °C; `slopes` (3, 3),
    the changes of the biases per K, K² and K³; and `coefficients` (3, 3), those of the autopilot's cubic by axis."""

    kind: SensorKind
    model: SensorModel
    number: int
    id: int | None
    offset: Array
    factor: Array
    known: bool
    measured: tuple[float, float] | None
    reference: float
    slopes: Array
    coefficients: Array

    def steepest(self) -> float:
        """Return the largest slope of a bias within the measured range, SI per K."""
        linear, square, cube = self.slopes.T
        assert self.measured is not None
        d = np.linspace(*self.measured, 201)[:, None] - self.reference
        return float(np.abs(linear + (2.0 * square + 3.0 * cube * d) * d).max())

    def correct(self, readings: Array) -> Array:
        """Return the autopilot's correction of readings (..., 3) at the reference temperature, SI."""
        return np.asarray((readings - self.offset) * self.factor)

    def example(self, calibration: Calibration) -> str:
        """Return a worked example, over temperature at the warm end of the range."""
        model, offset, where = self.model, self.offset, ""
        if self.measured is not None:
            celsius = example_temperature(self.measured)
            model, where = calibration.compensator.model(self.kind, celsius), f" at {celsius:g} degC"
            warmer = celsius - self.reference
            offset = offset + self.slopes @ [warmer, warmer**2, warmer**3]
        worked = linear_example(self.kind, model)
        return example_line(self.kind, worked, (worked.reading - offset) * self.factor, where)


def _triads(pilot: Autopilot, target: str, calibration: Calibration, imu: int | None, *, thermal: bool) -> list[Triad]:
    """Return the corrections of an autopilot, for the IMU that was recorded, else for the first or the `imu`-th.

    Raises InputError unless every channel senses its own axis of the frame, X, Y, Z, positively, if another IMU than
    `imu` was recorded, and over temperature if no parameter changes with it."""
    models, corrections = triads(calibration, target, needed=()), []
    for kind, model in models.items():
        if (np.argmax(model.matrix, axis=1) != np.arange(3)).any() or (np.diag(model.matrix) <= 0.5).any():
            raise InputError(
                f"export to {target}: expected {kind} channels along X, Y, Z in this order, found others; {target} "
                "has no place for another order or sign: name the columns of the session in that order"
            )
    most = pilot.compensated if thermal else pilot.imus
    if imu is not None and not 1 <= imu <= most:
        raise InputError(f"--imu: expected a number from 1 to {most} for {target}, found {imu}")
    for recorded, sensor in calibration.imu.items():
        if imu not in (None, sensor.number):
            device = "" if sensor.id is None else f" with the device id {sensor.id}"
            raise InputError(
                f"export to {target}: expected the sensors that were recorded, {recorded} {sensor.number}{device}, "
                f"found --imu {imu}; calibrate a recording of IMU {imu}, or leave --imu out"
            )
        if sensor.number > most:
            raise InputError(
                f"export to {target}: expected one of the first {most} IMUs, found a recording of IMU {sensor.number}"
            )
    compensator = calibration.compensator
    for kind, model in models.items():
        recorded_as, slopes = calibration.imu.get(kind), compensator.changes(kind, "bias")
        sharing = next(kinds for kinds in pilot.thermometers if kind in kinds)
        reference = float(np.mean(compensator.reference(next(each for each in sharing if each in models))))
        corrections.append(
            Triad(
                kind=kind,
                model=model,
                number=(imu or 1) if recorded_as is None else recorded_as.number,
                id=None if recorded_as is None else recorded_as.id,
                offset=model.bias,
                factor=1.0 / np.diag(model.matrix) if kind == "accel" else np.ones(3),
                known=any(group_name(name) == f"{kind}.bias" for name in calibration),
                measured=temperature_range(calibration, target) if thermal else None,
                reference=reference,
                slopes=slopes,
                coefficients=_cubic(pilot, slopes, reference),
            )
        )
    return corrections


def _cubic(pilot: Autopilot, slopes: Array, reference: float) -> Array:
    """Return the coefficients (3, 3) of the first to third power of the autopilot's temperature variable t, by axis.

    They are those of θ₁ (t − d) + θ₂ (t − d)² + θ₃ (t − d)³ with d = T₀ − centre, without the constant term."""
    linear, square, cube = slopes.T
    d = 0.0 if pilot.centre is None else reference - pilot.centre
    first = linear - (2.0 * square - 3.0 * cube * d) * d
    return np.stack([first, square - 3.0 * cube * d, cube], axis=1) / pilot.worth


def _shared_thermometers(pilot: Autopilot, calibration: Calibration, applied: Sequence[Triad]) -> list[str]:
    """Return sentences on the errors of sensors with several thermometers in the calibration and one in the target,
    by the differences between these at the rests, less their mean, which the reference temperatures contain."""
    notes = []
    for sharing in pilot.thermometers:
        by_kind = {each.kind: each for each in applied if each.kind in sharing and each.measured is not None}
        names = dict.fromkeys(chain(*(calibration.temperature.thermometers.get(kind, ()) for kind in by_kind)))
        if len(names) < 2:
            continue
        largest = 0.0
        for rest in rests_with_temperature(calibration):
            sensors = ((kind, getattr(rest, kind)) for kind in by_kind)
            deviations = [
                np.array(at_rest.temperature) - calibration.compensator.reference(kind)
                for kind, at_rest in sensors
                if at_rest is not None and at_rest.temperature
            ]
            largest = max(largest, float(np.ptp(np.concatenate(deviations))) if deviations else 0.0)
        error = " and ".join(in_units(kind, largest * each.steepest()) for kind, each in by_kind.items())
        notes.append(
            f"thermometers of their own ({', '.join(names)}): the target has one for these sensors; at the rests they "
            f"differ by up to {largest:.1f} K more or less than in the mean, an error of up to {error}"
        )
    return notes


def temperature_range(calibration: Calibration, target: str) -> tuple[float, float]:
    """Return the temperatures at which a calibration was measured. Raises InputError if nothing changes over them."""
    measured = measured_range(calibration)
    if calibration.reference_temperature is None or not thermal_parameters(calibration):
        raise InputError(
            f"export to {target}: expected parameters that change with temperature, such as accel.bias.x.t1, found "
            "none; calibrate a session with a thermometer"
        )
    if measured is None:
        raise InputError(
            f"export to {target}: expected rests at several temperatures, found one; record while it gets warmer"
        )
    return measured


def example_temperature(measured: tuple[float, float]) -> float:
    """Return the temperature of worked examples: the warm end of the range, rounded down to 0.1 °C."""
    return math.floor(10.0 * measured[1]) / 10.0


# -------------------- the files --------------------


def _autopilot(
    target: str, calibration: Calibration, *, imu: int | None = None, sensor_ids: tuple[int, int] | None = None
) -> Exported:
    """Return the file of a calibration, for the recorded IMU or the `imu`-th, with remarks, examples and notes as
    comments. `sensor_ids` are the device ids of accelerometer and gyro, if the recording has none."""
    name, thermal = target.removesuffix("-thermal"), target.endswith("-thermal")
    layout = _LAYOUT_FILES[name]
    front, _ = split_template(text_of_document(LAYOUTS / layout), layout)
    pilot = Autopilot(**front)
    applied = _triads(pilot, target, calibration, imu, thermal=thermal)
    measured = applied[0].measured
    if measured is not None and (span := measured[1] - measured[0]) < LEAST_CHANGE:
        raise InputError(
            f"export to {target}: expected temperatures that span at least {LEAST_CHANGE:g} K, found {span:.1f} K, "
            f"over which a drift in time looks like a slope; record while it warms up, or export to {name}"
        )
    ids: dict[str, int | None] = {kind: sensor.id for kind, sensor in calibration.imu.items()}
    ids |= {} if sensor_ids is None else dict(zip(("accel", "gyro"), sensor_ids, strict=True))
    signed = {kind: n - 2**32 if n >= 2**31 else n for kind, n in ids.items() if n is not None}  # int32, as in PX4
    both = signed if len(signed) == 2 else None
    see_to = list[str]()
    remarks = [pilot.has_ids] if pilot.has_ids and (thermal or both is None) else []
    if imu is None and not calibration.imu:
        see_to.append(
            "the calibration does not say which IMU it is of: these are parameters of the first (--imu N of another), "
            f"for readings before the board's rotation ({pilot.rotation})"
        )
    if pilot.of_gyros and "gyro" in (each.kind for each in applied):
        see_to.append(pilot.of_gyros)
    if measured is not None:
        references = dict.fromkeys(f"{each.reference:g}" for each in applied)
        remarks.append(pilot.at_reference.format(" and ".join(references)))
        if pilot.taken_up:
            see_to.append(pilot.taken_up.format(" and ".join(in_units(each.kind, each.steepest()) for each in applied)))
        few = f" (only {span:.1f} K: warm it through the temperatures of its use)" if span < WIDE else ""
        see_to.append(
            f"outside {measured[0]:.1f} to {measured[1]:.1f} degC nothing was measured{few}: the target keeps the "
            "offsets of the nearer end"
        )
        if pilot.lacks_ids and both is None:
            see_to.append(pilot.lacks_ids)
    known = [each for each in applied if each.known]
    changes = {f"{each.kind} offsets": each.offset for each in known}
    changes |= {f"{each.kind} scales": each.factor - 1.0 for each in known if each.kind == "accel"}
    small = [name for name, change in changes.items() if np.linalg.norm(change) <= MIN_CHANGE]
    if pilot.small and small:
        see_to.append(pilot.small.format(", ".join(small)))
    compass, compass_remarks, lost = _compass(pilot, calibration)
    notes = notes_of(
        calibration,
        corrections={each.kind: each.correct for each in applied},
        remarks=_shared_thermometers(pilot, calibration, applied),
        held={MAGNETOMETER} | (_HELD if thermal else set()),
        lacks=["uncertainties", *lost],
        see_to=see_to,
    )
    examples = (each.example(calibration) for each in applied)
    comments = [*origin(calibration), *remarks, *examples, *compass_remarks, *notes]
    place = 0 if imu is None else imu - 1
    text = render_layout(layout, comments=comments, triads=applied, compass=compass, place=place, ids=signed, both=both)
    return Exported(content=text.encode(), losses=notes)


px4, px4_thermal = partial(_autopilot, "px4"), partial(_autopilot, "px4-thermal")
ardupilot, ardupilot_thermal = partial(_autopilot, "ardupilot"), partial(_autopilot, "ardupilot-thermal")


def _compass(pilot: Autopilot, calibration: Calibration) -> tuple[Mapping[str, Array] | None, list[str], list[str]]:
    """Return the parameters of the magnetometer with a remark, or the reason why they are not exported."""
    model = calibration.mag
    if model is None:
        return None, [], []
    R, S = polar(model.inverse())
    offset = pilot.sign * model.bias * TESLA[calibration["mag.bias.x"].unit] / TESLA[pilot.unit]
    diagonal, across = np.diag(S), S[[0, 0, 1], [1, 2, 2]]
    low, high = pilot.factors
    reason = ""
    if np.linalg.det(R) < 0.0:
        reason = "its channels are left-handed: name the columns of the session in the order X, Y, Z"
    elif np.linalg.norm(offset) > pilot.longest:
        reason = f"its offsets are {np.linalg.norm(offset):.4g} {pilot.unit} long, more than {pilot.longest:g}"
    elif diagonal.min() < low or diagonal.max() > high or np.abs(across).max() > pilot.most_across:
        reason = f"its matrix has {shown(diagonal.round(4))} and {shown(across.round(4))}, beyond {low:g} to {high:g}"
        reason += "" if math.isinf(pilot.most_across) else f" and {pilot.most_across:g}"
    if reason:
        return None, [], [f"the magnetometer, which the autopilot takes for damaged: {reason}"]
    angle = float(np.linalg.norm(rotation_vector(R))) / DEGREE
    remark = (
        "magnetometer: taken for the first; its id in the autopilot has to be that of this sensor already, in the axes "
        f"that were recorded; turned by {angle:.2g} deg so that its matrix is symmetric"
    )
    return {"offset": offset, "diagonal": diagonal, "across": across}, [remark], []
