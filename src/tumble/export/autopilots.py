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
from typing import NamedTuple

import numpy as np

from tumble.errors import InputError
from tumble.export.exported import (
    MAGNETOMETER,
    SINGLE_PRECISION,
    Exported,
    commented,
    example,
    left_of_model,
    notes_of,
    origin,
    session_rate,
    shown,
    triads,
    worst,
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
_OVER_TEMPERATURE = frozenset(
    f"{kind}.{what}.{t}" for kind in _LETTERS for what in ("bias", "scale") for t in ("t1", "t2")
)
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


class Row(NamedTuple):
    """A parameter of an autopilot, and whether it is a whole number."""

    name: str
    value: float
    whole: bool = False


def parameter_lines(pilot: Autopilot, rows: Iterable[Row]) -> list[str]:
    """The lines of a file that the autopilot's ground station loads, numbers with as many digits as it takes to read
    them back in single precision."""
    lines = [f"# {pilot.heading[-1]}"] if pilot.heading else []
    for name, value, whole in rows:
        text = f"{value:.0f}" if whole else np.format_float_positional(np.float32(value), trim="0")
        lines.append((pilot.whole if whole else pilot.real).format(name=name, value=text))
    return lines


# -------------------- what an autopilot applies --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Held:
    """What an autopilot can hold of a calibration, in single precision.

    Attributes
    ----------
    pilot, calibration, imu
        The autopilot, what is exported, and the number of the IMU that the user gave.
    sensors
        The sensors of the autopilot whose parameters are written, by kind.
    known
        The models of the calibration, by kind.
    offset, factor
        (3,) by kind; the factors of gyros are 1.
    left
        What is left of the matrices.
    slopes
        (3, 2) by kind: how biases change per K and per K² about the target's reference; empty unless over temperature.
    measured
        The range of temperatures in which that was measured.
    """

    pilot: Autopilot
    calibration: Calibration
    imu: int | None
    sensors: Mapping[SensorKind, AutopilotSensor]
    known: Mapping[SensorKind, SensorModel]
    offset: Mapping[SensorKind, Array]
    factor: Mapping[SensorKind, Array]
    left: tuple[str, ...]
    slopes: Mapping[SensorKind, Array]
    measured: Range

    @staticmethod
    def of(pilot: Autopilot, target: str, calibration: Calibration, imu: int | None, *, thermal: bool = False) -> Held:
        """Offsets and factors of a calibration: with a factor 1/Mᵢᵢ for each axis what comes out is (1 + E) true. They
        are of the sensors that were recorded, else of the first of each kind, or of the number `imu`, from 1.

        Raises InputError unless every channel senses its own axis of the frame, X, Y, Z, positive, where other sensors
        than those of the number were recorded, and over temperature where nothing changes with it."""
        known, left, factors = triads(calibration, target, needed=()), list[str](), dict[SensorKind, Array]()
        for kind, model in known.items():
            if (np.argmax(model.matrix, axis=1) != np.arange(3)).any() or (np.diag(model.matrix) <= 0.5).any():
                raise InputError(
                    f"export to {target}: expected {kind} channels along X, Y, Z in this order, found others; {target} "
                    "has no place for another order or sign: name the columns of the session in that order"
                )
            factors[kind] = 1.0 / np.diag(model.matrix) if kind == "accel" else np.ones(3)
            left += left_of_model(kind, factors[kind][:, None] * model.matrix - np.eye(3))
        _check_imu(pilot.most_thermal if thermal else pilot.most, target, calibration, imu)
        slopes, measured = dict[SensorKind, Array](), Range(low=math.nan, high=math.nan)
        if thermal:
            measured = range_of(calibration, target)
            slopes = {kind: coefficients(calibration, kind, "bias") for kind in known}
            calibration = _at_common_references(pilot, calibration, known)
        return Held(
            pilot=pilot,
            calibration=calibration,
            imu=imu,
            sensors={kind: calibration.imu.get(kind, AutopilotSensor(number=imu or 1, id=None)) for kind in _LETTERS},
            known=known,
            offset={kind: single(model.bias) for kind, model in known.items()},
            factor={kind: single(factor) for kind, factor in factors.items()},
            left=tuple(left),
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

    def written(self, remarks: Iterable[str], rows: Iterable[Row], see_to: Iterable[str] = ()) -> Exported:
        """The file: remarks, examples and notes as comments, offsets and factors, then the parameters of the
        magnetometer and further rows."""
        every, offset = list[Row](), self.offset
        for kind in offset:
            parts = [(self.pilot.offset, offset[kind]), (self.pilot.factor, self.factor[kind])]
            for what, values in parts if kind == "accel" else parts[:1]:
                every += _reals([self.name(what.format(axis=axis), kind) for axis in "XYZ"], values)
        compass, about_it, lost = _compass(self.pilot, self.calibration)
        notes = notes_of(
            self.calibration,
            left=[*(self._left_over_temperature() if self.slopes else []), *self.left],
            held={MAGNETOMETER} | (_OVER_TEMPERATURE if self.slopes else set()),
            lacks=["uncertainties and their covariance", *lost],
            see_to=[*see_to, *self._caveats(), SINGLE_PRECISION],
        )
        examples = map(self.example, self.known)
        comments = [*origin(self.calibration), *remarks, *examples, *about_it, *notes, *self.pilot.heading[:1]]
        return Exported(
            content=commented(comments, parameter_lines(self.pilot, [*every, *compass, *rows])), losses=notes
        )

    def _caveats(self) -> list[str]:
        """What the user has to see to, whatever the file."""
        out = []
        if self.imu is None and not self.calibration.imu:
            out.append(
                "the calibration does not say which IMU it is of: these are parameters of the first, --imu N of another"
            )
        if self.pilot is PX4:
            changes = {f"{kind} offsets": values for kind, values in self.offset.items()}
            changes |= {"accel scales": self.factor["accel"] - 1.0} if "accel" in self.factor else {}
            if small := [name for name, three in changes.items() if np.linalg.norm(three) <= LEAST]:
                out.append(
                    "some releases of PX4 ignore corrections shorter than 0.01 (m/s^2, 1, rad/s), as here: "
                    f"{', '.join(small)}; see `sensors status`"
                )
        elif "gyro" in self.offset:
            out.append("gyro offsets are estimated anew at every start unless INS_GYR_CAL is 0")
        return out

    def _left_over_temperature(self) -> list[str]:
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


def _check_imu(most: int, target: str, calibration: Calibration, imu: int | None) -> None:
    """Raises InputError for a number that the target has no IMU of, or that is not that of the recording."""
    if imu is not None and not 1 <= imu <= most:
        raise InputError(f"--imu: expected a number from 1 to {most} for {target}, found {imu}")
    for recorded, sensor in calibration.imu.items():
        if imu not in (None, sensor.number):
            device = "" if sensor.id is None else f" with the device id {sensor.id}"
            raise InputError(
                f"export to {target}: expected the sensors that were recorded, {recorded} {sensor.number}{device}, "
                f"found --imu {imu}; calibrate a recording of IMU {imu}, or leave --imu out"
            )


def _at_common_references(pilot: Autopilot, calibration: Calibration, kinds: Iterable[SensorKind]) -> Calibration:
    """The calibration with one reference temperature for all sensors that have a thermometer together in the target:
    that of the first kind."""
    own: dict[str, Array] = {kind: references(calibration, kind) for kind in kinds}
    common: dict[str, tuple[float, ...]] = {}
    for together in ([kind for kind in each if kind in own] for each in pilot.thermometers):
        common |= {kind: len(own[kind]) * (float(np.mean(own[together[0]])),) for kind in together}
    return replace(calibration, temperature=replace(calibration.temperature, references=common))


def single(values: Array) -> Array:
    """Numbers as single precision keeps them."""
    return np.asarray(values.astype(np.float32), dtype=float)


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


def _at_reference(pilot: Autopilot, target: str, calibration: Calibration, *, imu: int | None = None) -> Exported:
    """The file of a calibration, of the IMU of this number, from 1, or of that which was recorded."""
    held = Held.of(pilot, target, calibration, imu)
    ids = {held.name(pilot.id, kind): held.sensors[kind].id for kind in held.known}
    unknown = [name for name, device in ids.items() if device is None] if pilot is PX4 else []
    plural = "ids of these sensors" if len(unknown) > 1 else "id of this sensor"
    remarks = [f"{' and '.join(unknown)} have to be the {plural} already"] if unknown else []
    known = [Row(name, _device(pilot, device), whole=True) for name, device in ids.items() if device is not None]
    return held.written(remarks, known)


px4, ardupilot = partial(_at_reference, PX4, "px4"), partial(_at_reference, ARDUPILOT, "ardupilot")


def px4_thermal(
    calibration: Calibration, *, imu: int | None = None, sensor_ids: tuple[int, int] | None = None
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
    remarks = [
        f"{names} have to be the ids of these sensors already",
        f"CAL_*OFF and CAL_*SCALE are those at {' and '.join(at)} degC",
    ]
    rows: list[Row] = []
    for kind, stem in stems.items():
        rows.append(Row(f"TC_{_LETTERS[kind]}_ENABLE", 1, whole=True))
        rows += [Row(f"{stem}_ID", _device(PX4, ids[kind] or 0), whole=True)] if ids else []
        rows += _reals([f"{stem}_TREF", f"{stem}_TMIN", f"{stem}_TMAX"], held.ends(kind))
        for degree, column in enumerate((np.zeros(3), *held.coefficients(kind).T)):
            rows += _reals([f"{stem}_X{degree}_{axis}" for axis in range(3)], column)
    no_ids = (
        f"{' and '.join(f'{stem}_ID' for stem in stems.values())} are not in this file: set them to {names}, or give "
        "--sensor-ids; without them PX4 compensates nothing"
    )
    jumps = (
        "PX4 takes up new offsets when the temperature has changed by more than 1 degC: until then an error of up to "
        f"{said({kind: held.steepest(kind) for kind in held.slopes})}"
    )
    return held.written(remarks, rows, [*([] if ids else [no_ids]), jumps])


def ardupilot_thermal(calibration: Calibration, *, imu: int | None = None) -> Exported:
    """The .parm file of a calibration over temperature; `imu` is the number of the IMU, from 1, where the recording
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
    rows = [Row(f"INS_TCAL{number}_ENABLE", 1, whole=True) for number in each]
    for number in each:
        rows += _reals([f"INS_TCAL{number}_TMIN", f"INS_TCAL{number}_TMAX"], ends)
    rows += _reals(list(names.values()), np.array([held.reference(kind) for kind in names]))
    for kind, number in numbers.items():
        for degree, column in enumerate(held.coefficients(kind).T, 1):
            rows += _reals([f"INS_TCAL{number}_{ARDUPILOT.words[kind]}{degree}_{axis}" for axis in "XYZ"], column)
    first = next(iter(names))
    return held.written([f"offsets and scales are those at {held.reference(first):g} degC, {names[first]}"], rows)


def _compass(pilot: Autopilot, calibration: Calibration) -> tuple[list[Row], list[str], list[str]]:
    """The parameters of the calibration's magnetometer, a remark on them, and why there are none."""
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
        return [], [], [f"the magnetometer, which the autopilot takes for damaged: {reason}"]
    angle = math.acos(min(1.0, 0.5 * (float(np.trace(R)) - 1.0))) / DEGREE
    values = {compass.offset: offset, compass.factor: diagonal, compass.across: across}
    named = {
        form.format(axis): value for form, three in values.items() for axis, value in zip("XYZ", three, strict=True)
    }
    named |= dict(compass.further)
    remark = (
        f"magnetometer: taken for the first; {compass.id} has to be that of this sensor already, in the axes that were "
        f"recorded; turned by {angle:.2g} deg so that its matrix is symmetric"
    )
    return _reals(list(named), np.array(list(named.values()))), [remark], []


def _reals(names: list[str], values: Array) -> list[Row]:
    """Parameters of single precision."""
    return [Row(name, value) for name, value in zip(names, single(values).tolist(), strict=True)]


def _device(pilot: Autopilot, device: int) -> int:
    """A device id as a parameter, which PX4 has with a sign."""
    return device - 2**32 if pilot is PX4 and device >= 2**31 else device
