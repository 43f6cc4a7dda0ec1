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

Source: PX4, parameter reference, and libraries sensor_calibration and temperature_compensation; QGroundControl,
"Parameters file format". ArduPilot, parameter reference, and library AP_InertialSensor.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from tumble.errors import InputError
from tumble.export.diagonal import Diagonal, Thermal, diagonal, said, single, thermal
from tumble.export.exported import Exported, commented, origin
from tumble.recording.autopilot import AutopilotSensor
from tumble.result.calibration import Calibration
from tumble.sensors.model import SensorKind
from tumble.units import Array

Sensors = Mapping[SensorKind, AutopilotSensor]
Row = tuple[str, str, bool]
"""Name and value of a parameter, and whether it is a whole number."""

NUMBER_INSIDE = 3
"""The last IMU that has its number inside ArduPilot's names, and the last one that it compensates."""
LEAST = 0.01
"""Length of the shortest offset (m/s², rad/s) and of the smallest change of scale that every release of PX4 takes
over."""
_LETTERS: Mapping[SensorKind, str] = {"accel": "A", "gyro": "G"}
"""What PX4 calls the kinds of sensors that it compensates."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Autopilot:
    """What an autopilot calls its parameters, and how its temperature curves are: `words` for the kinds of sensors, the
    `stem` of their names for the number of an IMU, and what comes behind it; how many IMUs it calibrates, `most`, and
    compensates; the kinds that have a thermometer together; the temperature, °C, that its polynomials are `about`,
    without one the reference, and what their coefficients are `worth`, SI; a line of its file, of a real and of a whole
    number; and what is lost beside."""

    words: Mapping[SensorKind, str]
    stem: Callable[[str, int], str]
    offset: str
    factor: str
    id: str
    most: int
    most_thermal: int
    thermometers: tuple[tuple[SensorKind, ...], ...]
    caveats: Callable[[Diagonal], list[str]]
    about: float | None = None
    worth: float = 1.0
    real: str = "{name},{value}"
    whole: str = "{name},{value}"
    heading: tuple[str, ...] = ()

    def name(self, what: str, kind: SensorKind, sensors: Sensors) -> str:
        """The name of a parameter of a kind of sensors."""
        return self.stem(self.words[kind], sensors[kind].number) + what

    def coefficients(self, found: Thermal, kind: SensorKind) -> Array:
        """Coefficients (3, 3) of the first to the third power of the temperature, by axis: θ₁ (t − d) + θ₂ (t − d)²
        with d = T₀ − `about`, without what does not depend on t."""
        linear, square = found.slopes[kind].T
        d = 0.0 if self.about is None else found.reference(kind) - self.about
        return np.stack([linear - 2.0 * square * d, square, np.zeros(3)], axis=1) / self.worth

    def offsets(self, found: Thermal, kind: SensorKind, temperature: Array) -> Array:
        """The offsets (N, 3), SI, that it takes off at temperatures (N,), °C: P(T) − P(T₀) + offset."""
        reference, low, high = found.ends(kind)
        C, about = single(self.coefficients(found, kind)), reference if self.about is None else self.about

        def P(at: Array) -> Array:
            t = (np.clip(at, low, high) - about)[:, None]
            return np.asarray((C[:, 0] * t + C[:, 1] * t**2 + C[:, 2] * t**3) * self.worth)

        return P(temperature) - P(np.array([reference])) + found.held.offset[kind]


def _ardupilot_stem(word: str, number: int) -> str:
    inside = "" if number == 1 else str(number)
    return f"INS_{word}{inside}" if number <= NUMBER_INSIDE else f"INS{number}_{word}"


def _too_small(held: Diagonal) -> list[str]:
    """Corrections that some releases of PX4 do not take over."""
    changes = {}
    if "accel" in held.known:
        changes = {"accelerometer offsets": held.offset["accel"], "accelerometer scales": held.factor["accel"] - 1.0}
    if "gyro" in held.known:
        changes["gyro offsets"] = held.offset["gyro"]
    small = [name for name, three in changes.items() if np.linalg.norm(three) <= LEAST]
    return [
        "some releases of PX4 ignore corrections shorter than 0.01 (m/s^2, 1, rad/s), as here: "
        f"{', '.join(small)}; see `sensors status`"
    ] * bool(small)


def _estimated_anew(held: Diagonal) -> list[str]:
    return ["gyro offsets are estimated anew at every start unless INS_GYR_CAL is 0"] if "gyro" in held.known else []


PX4 = Autopilot(
    words={"accel": "ACC", "gyro": "GYRO"},
    stem=lambda word, number: f"CAL_{word}{number - 1}_",
    offset="{axis}OFF",
    factor="{axis}SCALE",
    id="ID",
    most=4,
    most_thermal=3,
    thermometers=(("accel",), ("gyro",)),
    caveats=_too_small,
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
    caveats=_estimated_anew,
    about=35.0,
    worth=1e-6,
)


def _at_reference(pilot: Autopilot, target: str, calibration: Calibration, imu: int | None = None) -> Exported:
    """The file of a calibration, of the IMU of this number, from 1, or of that which was recorded."""
    held, sensors = diagonal(calibration, target), _sensors(calibration, imu, target, pilot.most)
    ids = {kind: pilot.name(pilot.id, kind, sensors) for kind in held.known}
    unknown = [name for kind, name in ids.items() if sensors[kind].id is None] if pilot is PX4 else []
    plural = "ids of these sensors" if len(unknown) > 1 else "id of this sensor"
    told = [f"{' and '.join(unknown)} have to be the {plural} already"] if unknown else []
    rows = _parameters(pilot, held, sensors)
    rows += [
        (name, _device(pilot, device), True) for kind, name in ids.items() if (device := sensors[kind].id) is not None
    ]
    losses = (*held.losses, *pilot.caveats(held), *_whose(calibration, imu))
    return _written(pilot, [*origin(calibration), *told, *held.examples()], rows, losses)


px4, ardupilot = partial(_at_reference, PX4, "px4"), partial(_at_reference, ARDUPILOT, "ardupilot")


def px4_thermal(
    calibration: Calibration, imu: int | None = None, sensor_ids: tuple[int, int] | None = None
) -> Exported:
    """The .params file of a calibration over temperature; `sensor_ids` are the device ids of accelerometer and gyro,
    and `imu` the number of the IMU, from 1, where the recording has not said them."""
    found = thermal(calibration, "px4-thermal", PX4.thermometers)
    sensors = _sensors(calibration, imu, "px4-thermal", PX4.most_thermal)
    place = 0 if imu is None else imu - 1
    given: dict[SensorKind, int | None] = {kind: sensors[kind].id for kind in _LETTERS}
    given |= dict(zip(_LETTERS, sensor_ids or (), strict=False))
    ids = {} if None in given.values() else given  # both or none
    names = " and ".join(PX4.name(PX4.id, kind, sensors) for kind in found.slopes)
    unset = " and ".join(f"TC_{_LETTERS[kind]}{place}_ID" for kind in found.slopes)
    no_ids = (
        f"{unset} are not in this file: set them to {names}, or give --sensor-ids; without them PX4 compensates nothing"
    )
    at = dict.fromkeys(f"{found.reference(kind):g}" for kind in found.slopes)
    told = (
        f"{names} have to be the ids of these sensors already",
        f"CAL_*OFF and CAL_*SCALE are those at {' and '.join(at)} degC",
    )
    rows = []
    for kind in found.slopes:
        stem = f"TC_{_LETTERS[kind]}{place}"
        rows.append((f"TC_{_LETTERS[kind]}_ENABLE", "1", True))
        rows += [(f"{stem}_ID", _device(PX4, ids[kind] or 0), True)] if ids else []
        rows += _reals([f"{stem}_TREF", f"{stem}_TMIN", f"{stem}_TMAX"], found.ends(kind))
        for degree, column in enumerate((np.zeros(3), *PX4.coefficients(found, kind).T)):
            rows += _reals([f"{stem}_X{degree}_{axis}" for axis in range(3)], column)
    jumps = (
        "PX4 takes up new offsets when the temperature has changed by more than 1 degC: until then an error of up to "
        f"{said(found.steepest())}"
    )
    after = (*([] if ids else [no_ids]), *_whose(calibration, imu))
    return _over_temperature(PX4, found, sensors, told, rows, ((jumps,), after))


def ardupilot_thermal(calibration: Calibration, imu: int | None = None) -> Exported:
    """The .param file of a calibration over temperature; `imu` is the number of the IMU, from 1, where the recording
    has not said it."""
    found = thermal(calibration, "ardupilot-thermal", ARDUPILOT.thermometers)
    sensors = _sensors(calibration, imu, "ardupilot-thermal", ARDUPILOT.most_thermal)
    numbers = {kind: sensors[kind].number for kind in found.slopes}
    if max(numbers.values()) > NUMBER_INSIDE:
        raise InputError(
            f"export to ardupilot-thermal: expected one of the first {NUMBER_INSIDE} IMUs, found a recording of IMU "
            f"{max(numbers.values())}"
        )
    names = {kind: f"INS_{ARDUPILOT.words[kind]}{number}_CALTEMP" for kind, number in numbers.items()}
    first = next(iter(names))
    each, ends = sorted(set(numbers.values())), np.array([found.measured.low, found.measured.high])
    rows: list[Row] = [(f"INS_TCAL{number}_ENABLE", "1", True) for number in each]
    for number in each:
        rows += _reals([f"INS_TCAL{number}_TMIN", f"INS_TCAL{number}_TMAX"], ends)
    rows += _reals(list(names.values()), np.array([found.reference(kind) for kind in names]))
    for kind, number in numbers.items():
        for degree, column in enumerate(ARDUPILOT.coefficients(found, kind).T, 1):
            rows += _reals([f"INS_TCAL{number}_{ARDUPILOT.words[kind]}{degree}_{axis}" for axis in "XYZ"], column)
    told = (f"offsets and scales are those at {found.reference(first):g} degC, {names[first]}",)
    return _over_temperature(ARDUPILOT, found, sensors, told, rows, ((), _whose(calibration, imu)))


def _over_temperature(
    pilot: Autopilot,
    found: Thermal,
    sensors: Sensors,
    told: Sequence[str],
    curves: Sequence[Row],
    more: tuple[Sequence[str], Sequence[str]],
) -> Exported:
    """The file with what is told, the rows of the `curves`, and what `more` is lost: over temperature, and at last."""

    def offsets(kind: SensorKind, temperature: Array) -> Array:
        return pilot.offsets(found, kind, temperature)

    held = found.held
    losses = (*found.losses(offsets), *more[0], *held.losses, *pilot.caveats(held), *more[1])
    comments = [*origin(found.calibration), *told, *found.examples(offsets)]
    return _written(pilot, comments, [*_parameters(pilot, held, sensors), *curves], losses)


def sensor_ids_of(text: str) -> tuple[int, int]:
    """The device ids of accelerometer and gyro of a text such as "1310988,1310988". Raises InputError."""
    try:
        accel, gyro = map(int, text.split(","))
    except ValueError:
        raise InputError(
            f"--sensor-ids: expected the numbers in CAL_ACC0_ID and CAL_GYRO0_ID with a comma between, found {text!r}"
        ) from None
    return accel, gyro


def _sensors(calibration: Calibration, imu: int | None, target: str, most: int) -> Sensors:
    """Which sensors of an autopilot the calibration is of: those that were recorded, else the first of each kind, or
    those of the number `imu`, from 1 to `most`. Raises InputError where others were recorded."""
    if imu is not None and not 1 <= imu <= most:
        raise InputError(f"--imu: expected a number from 1 to {most} for {target}, found {imu}")
    for kind, sensor in calibration.imu.items():
        if imu not in (None, sensor.number):
            device = "" if sensor.id is None else f" with the device id {sensor.id}"
            raise InputError(
                f"export to {target}: expected the sensors that were recorded, {kind} {sensor.number}{device}, found "
                f"--imu {imu}; calibrate a recording of IMU {imu}, or leave --imu out"
            )
    return {kind: calibration.imu.get(kind, AutopilotSensor(number=imu or 1, id=None)) for kind in _LETTERS}


def _whose(calibration: Calibration, imu: int | None) -> list[str]:
    """What is supposed where neither the calibration nor the user says which IMU it is."""
    told = "the calibration does not say which IMU it is of: these are parameters of the first, --imu N of another"
    return [told] if imu is None and not calibration.imu else []


def _parameters(pilot: Autopilot, held: Diagonal, sensors: Sensors) -> list[Row]:
    """Offsets and factors."""
    rows = []
    for kind, offset in held.offset.items():
        groups = [(pilot.offset, offset)] + ([(pilot.factor, held.factor[kind])] if kind == "accel" else [])
        for what, values in groups:
            rows += _reals([pilot.name(what.format(axis=axis), kind, sensors) for axis in "XYZ"], values)
    return rows


def _reals(names: list[str], values: Array) -> list[Row]:
    """Numbers of single precision, with as many digits as it takes to read them back in single precision."""
    texts = [np.format_float_positional(value, trim="0") for value in values.astype(np.float32)]
    return [(name, text, False) for name, text in zip(names, texts, strict=True)]


def _device(pilot: Autopilot, device: int) -> str:
    """A device id as a parameter, which PX4 has with a sign."""
    return str(device - 2**32 if pilot is PX4 and device >= 2**31 else device)


def _written(pilot: Autopilot, comments: list[str], rows: list[Row], losses: tuple[str, ...]) -> Exported:
    lines = [(pilot.whole if whole else pilot.real).format(name=name, value=value) for name, value, whole in rows]
    return commented([*comments, *losses, *pilot.heading], lines, losses)
