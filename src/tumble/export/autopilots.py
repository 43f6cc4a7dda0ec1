"""PX4 and ArduPilot: parameter files of one accelerometer and one gyro, as they are and over temperature.

    acceleration = (reading − offset) · factor        rate = reading − offset

in the sensor's axes, m/s² and rad/s, single precision; board rotations come afterwards. The offsets are the biases b.
The factors are 1/Mᵢᵢ: what is left of the accelerometers' matrix then has a unit diagonal.

PX4, a file as QGroundControl loads it: CAL_ACC0_XOFF, CAL_ACC0_XSCALE, CAL_GYRO0_XOFF of the topics sensor_accel and
sensor_gyro, counted from 0. It uses the numbers for the sensor whose id is in CAL_ACC0_ID and CAL_GYRO0_ID. Over
temperature, which PX4 finds by the ids in TC_A0_ID and TC_G0_ID,

    offset(T) = X0 + X1 d + X2 d² + X3 d³ + CAL_ACC0_XOFF,   d = T − TREF, T kept within TMIN … TMAX, degC

X0 is zero, as PX4's own procedure leaves it. The curves stand in the first place of TC_A and TC_G, or with --imu N in
the N-th, so that files of several IMUs do not overwrite each other. Releases before 2021 had TC_A0_SCL_0 too, a scale
without temperature.

ArduPilot: INS_ACCOFFS_X, INS_ACCSCAL_X, INS_GYROFFS_X of readings before the board's orientation; the second and the
third IMU have their number inside the names, INS_ACC2OFFS_X, the fourth and the fifth before, INS4_ACCOFFS_X. It takes
calibrations of other ids than INS_ACC_ID and INS_GYR_ID for none. Over temperature, that of the IMU itself,

    offset(T) = P(T) − P(CALTEMP) + INS_ACCOFFS_X,   P(T) = (C1 t + C2 t² + C3 t³) · 1e-6,   t = T − 35 degC

with both temperatures kept within TMIN … TMAX; C1 is INS_TCAL1_ACC1_X. CALTEMP is the calibration's reference, so that
a curve about T₀ is turned into one about 35 degC.

A magnetometer, in the units of the autopilot, Gauss or thousandths, has a symmetric matrix:

    PX4        field = S (reading − OFF),   S = (XSCALE, XODIAG, YODIAG; ·, YSCALE, ZODIAG; ·, ·, ZSCALE)
    ArduPilot  field = SCALE · S (reading + OFS),   S likewise of DIA and ODI

so that of M⁻¹ = R S, R a rotation, S is held; the calibration's frame of the magnetometer, which is fixed by its first
channels, is turned by R. What an autopilot's own procedure refuses (PX4: offsets beyond 1.3 Gauss, scales beyond 0.1
to 3; ArduPilot: offsets beyond COMPASS_OFFS_MAX, 1800, DIA beyond 0.2 to 5, ODI beyond 1) is not written, and that is
said.

The biases of a calibration are polynomials of the second degree at most, so a cubic holds them whole; TMIN and TMAX are
the ends of what was measured. Scale factors have one value each, that at the reference temperature.

Source: PX4, parameter reference, libraries sensor_calibration and temperature_compensation, commander's
mag_calibration.cpp; QGroundControl, "Parameters file format". ArduPilot, parameter reference, libraries
AP_InertialSensor and AP_Compass (AP_Compass_Backend::correct_field, CompassCalibrator::fit_acceptable).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain

import numpy as np

from tumble.errors import InputError
from tumble.export.exported import (
    SINGLE_PRECISION,
    Exported,
    ExportedParameter,
    commented,
    example,
    losses_of,
    origin,
    session_rate,
    shown,
    triads,
)
from tumble.recording.session import AutopilotSensor
from tumble.result.calibration import Calibration
from tumble.result.temperature_curves import (
    Range,
    changing,
    coefficients,
    measured_range,
    model_at,
    references,
    warm_rests,
)
from tumble.sensors.model import SensorKind, SensorModel
from tumble.sensors.parameters import group_name
from tumble.units import DEGREE, G_STANDARD, TESLA, Array

NUMBER_INSIDE = 3
"""The last IMU that has its number inside ArduPilot's names, and the last one that it compensates."""
LEAST = 0.01
"""Length of the shortest offset (m/s², rad/s) and of the smallest change of scale that every release of PX4 takes
over."""
_LETTERS: Mapping[SensorKind, str] = {"accel": "A", "gyro": "G"}
"""What PX4 calls the kinds of sensors that it compensates."""
_TOLD_APART = tuple(f"{kind}.{what}.{t}" for kind in _LETTERS for what in ("bias", "scale") for t in ("t1", "t2"))
"""Groups over temperature: held, or not held with a sentence of their own."""
_NOTHING = 1e-12
"""mg or deg/s: rounding of double precision."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Compass:
    """What an autopilot calls the parameters of its first magnetometer, with the axis: offset, diagonal and what is
    beside it; what 1 of its unit is, T; the sign of its offsets; how long they may be, between what the diagonal may
    be, and how large what is beside it; further ones with their values; and the parameter of its device."""

    offset: str
    factor: str
    across: str
    unit: str
    sign: float
    most: float
    factors: tuple[float, float]
    most_across: float
    id: str
    further: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class Autopilot:
    """What an autopilot calls its parameters, and how its temperature curves are: `words` for the kinds of sensors, the
    `stem` of their names for the number of an IMU, and what comes behind it; how many IMUs it calibrates, `most`, and
    compensates; the kinds that have a thermometer together; the temperature, °C, that its polynomials are `about`,
    without one the reference, and what their coefficients are `worth`, SI; and a line of its file, of a real and of a
    whole number."""

    words: Mapping[SensorKind, str]
    stem: Callable[[str, int], str]
    offset: str
    factor: str
    id: str
    most: int
    most_thermal: int
    thermometers: tuple[tuple[SensorKind, ...], ...]
    compass: Compass
    about: float | None = None
    worth: float = 1.0
    real: str = "{name},{value}"
    whole: str = "{name},{value}"
    heading: tuple[str, ...] = ()


def _ardupilot_stem(word: str, number: int) -> str:
    inside = "" if number == 1 else str(number)
    return f"INS_{word}{inside}" if number <= NUMBER_INSIDE else f"INS{number}_{word}"


PX4 = Autopilot(
    words={"accel": "ACC", "gyro": "GYRO"},
    stem=lambda word, number: f"CAL_{word}{number - 1}_",
    offset="{axis}OFF",
    factor="{axis}SCALE",
    id="ID",
    most=4,
    most_thermal=3,
    thermometers=(("accel",), ("gyro",)),
    compass=Compass(
        offset="CAL_MAG0_{}OFF",
        factor="CAL_MAG0_{}SCALE",
        across="CAL_MAG0_{}ODIAG",
        unit="gauss",
        sign=1.0,
        most=1.3,
        factors=(0.1, 3.0),
        most_across=math.inf,
        id="CAL_MAG0_ID",
    ),
    real="1\t1\t{name}\t{value}\t9",  # MAV_PARAM_TYPE_REAL32
    whole="1\t1\t{name}\t{value}\t6",  # MAV_PARAM_TYPE_INT32
    heading=("", "Vehicle-Id Component-Id Name Value Type"),
)
ARDUPILOT = Autopilot(
    words={"accel": "ACC", "gyro": "GYR"},
    stem=_ardupilot_stem,
    offset="OFFS_{axis}",
    factor="SCAL_{axis}",
    id="_ID",
    most=5,
    most_thermal=5,
    thermometers=(("accel", "gyro"),),
    compass=Compass(
        offset="COMPASS_OFS_{}",
        factor="COMPASS_DIA_{}",
        across="COMPASS_ODI_{}",
        unit="mgauss",
        sign=-1.0,
        most=1800.0,
        factors=(0.2, 5.0),
        most_across=1.0,
        id="COMPASS_DEV_ID",
        further=(("COMPASS_SCALE", 1.0),),
    ),
    about=35.0,
    worth=1e-6,
)
PILOTS: Mapping[str, Autopilot] = {"px4": PX4, "ardupilot": ARDUPILOT}


def parameter_lines(pilot: Autopilot, parameters: Iterable[ExportedParameter]) -> list[str]:
    """The lines of a file that the autopilot's ground station loads, numbers with as many digits as it takes to read
    them back in single precision."""
    lines = [f"# {pilot.heading[-1]}"] if pilot.heading else []
    for p in parameters:
        text = f"{p.value:.0f}" if p.whole else np.format_float_positional(np.float32(p.value), trim="0")
        lines.append((pilot.whole if p.whole else pilot.real).format(name=p.name, value=text))
    return lines


# -------------------- what is left of a calibration, and how much that loses --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Held:
    """What an autopilot can hold of a calibration, in single precision: which of its `sensors` it is of, the kinds that
    are `known`, their offsets (3,), and factors (3,), which gyros have none of: 1. Over temperature, the references of
    the calibration being temperatures of the target, also how the biases of a kind change, (3, 2), per K and per K²,
    within the range that was `measured`."""

    pilot: Autopilot
    calibration: Calibration
    imu: int | None
    sensors: Mapping[SensorKind, AutopilotSensor]
    known: Mapping[SensorKind, SensorModel]
    offset: Mapping[SensorKind, Array]
    factor: Mapping[SensorKind, Array]
    losses: tuple[str, ...]
    slopes: Mapping[SensorKind, Array]
    measured: Range

    @staticmethod
    def of(pilot: Autopilot, target: str, calibration: Calibration, imu: int | None, *, thermal: bool = False) -> Held:
        """Offsets and factors of a calibration: with a factor 1/Mᵢᵢ for each axis what comes out is (1 + E) true. They
        are of the sensors that were recorded, else of the first of each kind, or of the number `imu`, from 1.

        Raises InputError unless every channel senses its own axis of the frame, X, Y, Z, positive, where other sensors
        than those of the number were recorded, and over temperature where nothing changes with it."""
        known, losses = triads(calibration, target, needed=()), []
        for kind, model in known.items():
            if (np.argmax(model.matrix, axis=1) != np.arange(3)).any() or (np.diag(model.matrix) <= 0.5).any():
                raise InputError(
                    f"export to {target}: expected {kind} channels along X, Y, Z in this order, found others; {target} "
                    "has no place for another order or sign: name the columns of the session in that order"
                )
            error = model.matrix / np.diag(model.matrix)[:, None] - np.eye(3)
            misalignment = (
                f"misalignment of the accelerometers: up to {1e3 * np.abs(error).max():.3g} mrad, in 1 g an error of "
                f"up to {G_STANDARD * worst(error):.3g} m/s^2"
            )
            losses.append(misalignment if kind == "accel" else gyro_matrix_lost(model))
        most = pilot.most_thermal if thermal else pilot.most
        if imu is not None and not 1 <= imu <= most:
            raise InputError(f"--imu: expected a number from 1 to {most} for {target}, found {imu}")
        for recorded, sensor in calibration.imu.items():
            if imu not in (None, sensor.number):
                device = "" if sensor.id is None else f" with the device id {sensor.id}"
                raise InputError(
                    f"export to {target}: expected the sensors that were recorded, {recorded} {sensor.number}{device}, "
                    f"found --imu {imu}; calibrate a recording of IMU {imu}, or leave --imu out"
                )
        factors = {
            kind: 1.0 / np.diag(model.matrix) if kind == "accel" else np.ones(3) for kind, model in known.items()
        }
        lost = losses_of(calibration, *losses, held=_TOLD_APART if thermal else (), precision=SINGLE_PRECISION)
        slopes, measured = dict[SensorKind, Array](), Range(low=math.nan, high=math.nan)
        if thermal:
            measured = range_of(calibration, target)
            slopes = {kind: coefficients(calibration, kind, "bias") for kind in known}
            own: dict[str, Array] = {kind: references(calibration, kind) for kind in known}
            seen: dict[str, tuple[float, ...]] = {}
            for kinds in ([kind for kind in kinds if kind in own] for kinds in pilot.thermometers):
                seen |= {kind: len(own[kind]) * (float(np.mean(own[kinds[0]])),) for kind in kinds}  # that of the first
            calibration = replace(calibration, temperature=replace(calibration.temperature, references=seen))
        return Held(
            pilot=pilot,
            calibration=calibration,
            imu=imu,
            sensors={kind: calibration.imu.get(kind, AutopilotSensor(number=imu or 1, id=None)) for kind in _LETTERS},
            known=known,
            offset={kind: single(model.bias) for kind, model in known.items()},
            factor={kind: single(factor) for kind, factor in factors.items()},
            losses=lost,
            slopes=slopes,
            measured=measured,
        )

    def name(self, what: str, kind: SensorKind) -> str:
        """The name of a parameter of a kind of sensors."""
        return self.pilot.stem(self.pilot.words[kind], self.sensors[kind].number) + what

    def reference(self, kind: SensorKind) -> float:
        """The temperature of the target, °C, at which sensors of a kind have their values."""
        return float(references(self.calibration, kind)[0])

    def ends(self, kind: SensorKind) -> Array:
        """The reference of a kind of sensors and the ends of the measured range, °C, in single precision."""
        return single(np.array([self.reference(kind), self.measured.low, self.measured.high]))

    def coefficients(self, kind: SensorKind) -> Array:
        """Coefficients (3, 3) of the first to the third power of the temperature, by axis: θ₁ (t − d) + θ₂ (t − d)²
        with d = T₀ − `about`, without what does not depend on t."""
        linear, square = self.slopes[kind].T
        d = 0.0 if self.pilot.about is None else self.reference(kind) - self.pilot.about
        return np.stack([linear - 2.0 * square * d, square, np.zeros(3)], axis=1) / self.pilot.worth

    def offsets(self, kind: SensorKind, temperature: Array) -> Array:
        """The offsets (N, 3), SI, that it takes off at temperatures (N,), °C: P(T) − P(T₀) + offset."""
        (reference, low, high), pilot = self.ends(kind), self.pilot
        C, about = single(self.coefficients(kind)), reference if pilot.about is None else pilot.about

        def P(at: Array) -> Array:
            t = (np.clip(at, low, high) - about)[:, None]
            return np.asarray((C[:, 0] * t + C[:, 1] * t**2 + C[:, 2] * t**3) * pilot.worth)

        return P(temperature) - P(np.array([reference])) + self.offset[kind]

    def steepest(self, kind: SensorKind) -> float:
        """The largest change of a bias per K within the range, m/s²/K or rad/s/K."""
        linear, square = self.slopes[kind].T
        ends = np.array([[self.measured.low], [self.measured.high]]) - references(self.calibration, kind)
        return float(np.abs(linear + 2.0 * square * ends).max())

    def example(self, kind: SensorKind) -> str:
        """A reading, what the autopilot makes of it and what it is; over temperature at the warmer end."""
        model, offset, where = self.known[kind], self.offset[kind], ""
        if self.slopes:
            at = warm_end(self.measured)
            model, where = model_at(self.calibration, kind, at), f" at {at:g} degC"
            offset = self.offsets(kind, np.array([at]))[0]
        worked = example(kind, model)
        target = ((worked.reading - offset) * self.factor[kind]).round(6)
        it_is = shown(worked.true.round(6))
        return f"example {kind}{where}: reading {shown(worked.reading)} becomes {shown(target)}; it is {it_is}"

    def written(
        self,
        told: Iterable[str],
        rows: Iterable[ExportedParameter],
        more: Iterable[str] = (),
        last: Iterable[str] = (),
    ) -> Exported:
        """The file: what is told and lost as comments, offsets and factors, then those of the magnetometer and the
        rows; and what is supposed where neither the calibration nor the user says which IMU it is."""
        parameters, caveats, offset = list[ExportedParameter](), list[str](), self.offset
        for kind in offset:
            parts = [(self.pilot.offset, offset[kind]), (self.pilot.factor, self.factor[kind])]
            for what, values in parts if kind == "accel" else parts[:1]:
                parameters += _reals([self.name(what.format(axis=axis), kind) for axis in "XYZ"], values)
        if self.pilot is PX4:
            changes = {"accelerometer offsets": offset["accel"]} if "accel" in offset else {}
            changes |= {"accelerometer scales": self.factor["accel"] - 1.0} if "accel" in offset else {}
            changes |= {"gyro offsets": offset["gyro"]} if "gyro" in offset else {}
            if small := [name for name, three in changes.items() if np.linalg.norm(three) <= LEAST]:
                caveats.append(
                    "some releases of PX4 ignore corrections shorter than 0.01 (m/s^2, 1, rad/s), as here: "
                    f"{', '.join(small)}; see `sensors status`"
                )
        elif "gyro" in offset:
            caveats.append("gyro offsets are estimated anew at every start unless INS_GYR_CAL is 0")
        compass, told_of_it, lost = _compass(self.pilot, self.calibration)
        whose = "the calibration does not say which IMU it is of: these are parameters of the first, --imu N of another"
        supposed = [whose] if self.imu is None and not self.calibration.imu else []
        thermal = self.over_temperature() if self.slopes else []
        every_loss = (*thermal, *more, *self.losses, *lost, *caveats, *last, *supposed)
        every, examples = (*parameters, *compass, *rows), map(self.example, self.known)
        comments = [*origin(self.calibration, magnetometer=True), *told, *examples, *told_of_it, *every_loss]
        file = commented([*comments, *self.pilot.heading[:1]], parameter_lines(self.pilot, every), every_loss)
        return replace(file, parameters=every, magnetometer=True)

    def over_temperature(self) -> list[str]:
        """What is lost over temperature, and how much of it within the measured range."""
        T, rate, known = self.measured.temperatures(), session_rate(self.calibration), self.known
        span = f"{self.measured.low:.1f} to {self.measured.high:.1f} degC"
        curves, scales, hysteresis = {}, {}, {}
        for kind, model in known.items():
            warmer = (T - self.reference(kind))[:, None]
            linear, square = self.slopes[kind].T
            biases = model.bias + linear * warmer + square * warmer**2
            curves[kind] = float(np.abs(self.offsets(kind, T) - biases).max())
            linear, square = coefficients(self.calibration, kind, "scale").T  # which the target has none for
            unit = model.matrix / np.linalg.norm(model.matrix, axis=1)[:, None]
            applied, felt = (np.diag(model.matrix)[:, None], G_STANDARD) if kind == "accel" else (1.0, rate)
            longer = linear * warmer + square * warmer**2
            scales[kind] = felt * max(worst(each[:, None] * unit / applied) for each in longer)
            of_kind = (p for p in self.calibration.parameters if group_name(p.name) == f"{kind}.bias.hysteresis")
            hysteresis[kind] = max((abs(p.value) for p in of_kind), default=0.0)
        where = " ".join(["in 1 g"] * ("accel" in known) + [f"at {rate / DEGREE:.3g} deg/s"] * ("gyro" in known))
        losses = [
            f"offsets over temperature: from {span} the cubic is within {said(curves)} of the calibration's curve",
            f"scale factors over temperature: no place in this file, from {span} an error of up to {said(scales)} "
            f"{where}",
        ]
        if any(hysteresis.values()):
            losses.append(f"hysteresis of the biases: no place in this file, up to {said(hysteresis)}")
        # sensors that have one temperature in the target: by what they differ at rests other than in the mean, which
        # their references contain
        thermometers = self.calibration.temperature.thermometers
        for kinds in ([kind for kind in kinds if kind in known] for kinds in self.pilot.thermometers):
            names = dict.fromkeys(chain(*(thermometers.get(kind, ()) for kind in kinds)))
            if len(names) < 2:
                continue
            apart = 0.0
            for rest in warm_rests(self.calibration):
                at = {kind: getattr(rest, kind) for kind in kinds}
                off = [
                    np.array(sensors.temperature) - references(self.calibration, kind)
                    for kind, sensors in at.items()
                    if sensors is not None and sensors.temperature
                ]
                apart = max(apart, float(np.ptp(np.concatenate(off))) if off else 0.0)
            losses.append(
                f"thermometers of their own ({', '.join(names)}): the target has one for these sensors; at the rests "
                f"they differ by up to {apart:.1f} K more or less than in the mean, an error of up to "
                f"{said({kind: apart * self.steepest(kind) for kind in kinds})}"
            )
        return [*losses, f"outside {span} nothing was measured: the target keeps the offsets of the nearer end"]


def single(values: Array) -> Array:
    """Numbers as single precision keeps them."""
    return np.asarray(values.astype(np.float32), dtype=float)


def worst(error: Array) -> float:
    """The largest relative error |E v| / |v| of any vector."""
    return float(np.linalg.norm(error, ord=2))


def gyro_matrix_lost(model: SensorModel) -> str:
    """What gyros with nothing but offsets lose."""
    error = worst(model.matrix - np.eye(3))
    return (
        f"scale factors and misalignment of the gyros: an error of up to {100.0 * error:.3g} % of the rate, "
        f"{np.rad2deg(error * np.deg2rad(100.0)):.3g} deg/s in 100 deg/s"
    )


def said(errors: Mapping[SensorKind, float]) -> str:
    """Errors of accelerometers, m/s², and gyros, rad/s, in mg and deg/s, to two digits and not smaller."""
    sizes = []
    for kind, error in errors.items():
        size, unit = (1e-3 * G_STANDARD, "mg") if kind == "accel" else (DEGREE, "deg/s")
        value = error / size
        digit = 10.0 ** (math.floor(math.log10(value)) - 1) if value > _NOTHING else math.inf
        sizes.append(
            f"{math.ceil(value / digit * (1.0 - 1e-12)) * digit:.2g} {unit}" if value > _NOTHING else f"0 {unit}"
        )
    return " and ".join(sizes)


def range_of(calibration: Calibration, target: str) -> Range:
    """The temperatures at which a calibration was measured. Raises InputError where there is nothing over them."""
    measured = measured_range(calibration)
    if calibration.reference_temperature is None or not changing(calibration):
        raise InputError(
            f"export to {target}: expected parameters that change with temperature, such as accel.bias.x.t1, found "
            "none; calibrate a session with a thermometer"
        )
    if measured is None:
        raise InputError(
            f"export to {target}: expected rests at several temperatures, found one; record while it gets warmer"
        )
    return measured


def warm_end(measured: Range) -> float:
    """A tenth of a degree at the warmer end of the range, °C, where examples are."""
    return math.floor(10.0 * measured.high) / 10.0


# -------------------- the files --------------------


def _at_reference(pilot: Autopilot, target: str, calibration: Calibration, imu: int | None = None) -> Exported:
    """The file of a calibration, of the IMU of this number, from 1, or of that which was recorded."""
    held = Held.of(pilot, target, calibration, imu)
    ids = {held.name(pilot.id, kind): held.sensors[kind].id for kind in held.known}
    unknown = [name for name, device in ids.items() if device is None] if pilot is PX4 else []
    plural = "ids of these sensors" if len(unknown) > 1 else "id of this sensor"
    told = [f"{' and '.join(unknown)} have to be the {plural} already"] if unknown else []
    known = {name: device for name, device in ids.items() if device is not None}
    return held.written(told, [_whole(name, _device(pilot, device), identity=True) for name, device in known.items()])


px4, ardupilot = partial(_at_reference, PX4, "px4"), partial(_at_reference, ARDUPILOT, "ardupilot")


def px4_thermal(
    calibration: Calibration, imu: int | None = None, sensor_ids: tuple[int, int] | None = None
) -> Exported:
    """The .params file of a calibration over temperature; `sensor_ids` are the device ids of accelerometer and gyro,
    and `imu` the number of the IMU, from 1, where the recording has not said them."""
    held = Held.of(PX4, "px4-thermal", calibration, imu, thermal=True)
    stems = {kind: f"TC_{_LETTERS[kind]}{0 if imu is None else imu - 1}" for kind in held.slopes}
    given: dict[SensorKind, int | None] = {kind: held.sensors[kind].id for kind in _LETTERS}
    given |= dict(zip(_LETTERS, sensor_ids or (), strict=False))
    ids = {} if None in given.values() else given  # both or none
    names = " and ".join(held.name(PX4.id, kind) for kind in held.slopes)
    at = dict.fromkeys(f"{held.reference(kind):g}" for kind in held.slopes)
    told = [
        f"{names} have to be the ids of these sensors already",
        f"CAL_*OFF and CAL_*SCALE are those at {' and '.join(at)} degC",
    ]
    rows: list[ExportedParameter] = []
    for kind, stem in stems.items():
        rows.append(_whole(f"TC_{_LETTERS[kind]}_ENABLE", 1))
        rows += [_whole(f"{stem}_ID", _device(PX4, ids[kind] or 0))] if ids else []
        rows += _reals([f"{stem}_TREF", f"{stem}_TMIN", f"{stem}_TMAX"], held.ends(kind))
        for degree, column in enumerate((np.zeros(3), *held.coefficients(kind).T)):
            rows += _reals([f"{stem}_X{degree}_{axis}" for axis in range(3)], column)
    jumps = (
        "PX4 takes up new offsets when the temperature has changed by more than 1 degC: until then an error of up to "
        f"{said({kind: held.steepest(kind) for kind in held.slopes})}"
    )
    no_ids = (
        f"{' and '.join(f'{stem}_ID' for stem in stems.values())} are not in this file: set them to {names}, or give "
        "--sensor-ids; without them PX4 compensates nothing"
    )
    return held.written(told, rows, [jumps], [] if ids else [no_ids])


def ardupilot_thermal(calibration: Calibration, imu: int | None = None) -> Exported:
    """The .param file of a calibration over temperature; `imu` is the number of the IMU, from 1, where the recording
    has not said it."""
    held = Held.of(ARDUPILOT, "ardupilot-thermal", calibration, imu, thermal=True)
    numbers = {kind: held.sensors[kind].number for kind in held.slopes}
    if max(numbers.values()) > NUMBER_INSIDE:
        raise InputError(
            f"export to ardupilot-thermal: expected one of the first {NUMBER_INSIDE} IMUs, found a recording of IMU "
            f"{max(numbers.values())}"
        )
    names = {kind: f"INS_{ARDUPILOT.words[kind]}{number}_CALTEMP" for kind, number in numbers.items()}
    each, ends = sorted(set(numbers.values())), np.array([held.measured.low, held.measured.high])
    rows = [_whole(f"INS_TCAL{number}_ENABLE", 1) for number in each]
    for number in each:
        rows += _reals([f"INS_TCAL{number}_TMIN", f"INS_TCAL{number}_TMAX"], ends)
    rows += _reals(list(names.values()), np.array([held.reference(kind) for kind in names]))
    for kind, number in numbers.items():
        for degree, column in enumerate(held.coefficients(kind).T, 1):
            rows += _reals([f"INS_TCAL{number}_{ARDUPILOT.words[kind]}{degree}_{axis}" for axis in "XYZ"], column)
    first = next(iter(names))
    return held.written([f"offsets and scales are those at {held.reference(first):g} degC, {names[first]}"], rows)


def _compass(pilot: Autopilot, calibration: Calibration) -> tuple[list[ExportedParameter], list[str], list[str]]:
    """The parameters of the calibration's magnetometer, what is told of them, and why there are none."""
    model, compass = calibration.mag, pilot.compass
    if model is None:
        return [], [], []
    from scipy.linalg import polar

    R, S = polar(model.inverse())
    offset = compass.sign * model.bias * TESLA[calibration["mag.bias.x"].unit] / TESLA[compass.unit]
    diagonal, across = np.diag(S), S[[0, 0, 1], [1, 2, 2]]
    low, high = compass.factors
    reason = ""
    if np.linalg.det(R) < 0.0:
        reason = "its channels are left-handed: name the columns of the session in the order X, Y, Z"
    elif np.linalg.norm(offset) > compass.most:
        reason = f"its offsets are {np.linalg.norm(offset):.4g} {compass.unit} long, more than {compass.most:g}"
    elif diagonal.min() < low or diagonal.max() > high or np.abs(across).max() > compass.most_across:
        reason = f"its matrix has {shown(diagonal.round(4))} and {shown(across.round(4))}, beyond {low:g} to {high:g}"
        reason += "" if math.isinf(compass.most_across) else f" and {compass.most_across:g}"
    if reason:
        return [], [], [f"magnetometer: not in this file, for the autopilot takes it for damaged: {reason}"]
    angle = math.acos(min(1.0, 0.5 * (float(np.trace(R)) - 1.0))) / DEGREE
    values = {compass.offset: offset, compass.factor: diagonal, compass.across: across}
    named = {
        form.format(axis): value for form, three in values.items() for axis, value in zip("XYZ", three, strict=True)
    }
    named |= dict(compass.further)
    told = (
        f"magnetometer: taken for the first; {compass.id} has to be that of this sensor already, in the axes that were "
        f"recorded; turned by {angle:.2g} deg so that its matrix is symmetric"
    )
    return _reals(list(named), np.array(list(named.values())), magnetometer=True), [told], []


def _reals(names: list[str], values: Array, *, magnetometer: bool = False) -> list[ExportedParameter]:
    """Parameters of single precision."""
    kept = zip(names, single(values).tolist(), strict=True)
    return [ExportedParameter(name=name, value=value, magnetometer=magnetometer) for name, value in kept]


def _whole(name: str, value: int, *, identity: bool = False) -> ExportedParameter:
    """A parameter that is a whole number."""
    return ExportedParameter(name=name, value=float(value), whole=True, identity=identity)


def _device(pilot: Autopilot, device: int) -> int:
    """A device id as a parameter, which PX4 has with a sign."""
    return device - 2**32 if pilot is PX4 and device >= 2**31 else device
