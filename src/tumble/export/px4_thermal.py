"""PX4 over temperature: the parameter file of `px4`, of the sensors that were recorded, with their thermal
compensation, which PX4 finds by their ids, in its first place, or with --imu N in the N-th, so that the files of
several IMUs do not overwrite each other.

    TC_A0_X1_0 and so on: offset(T) = X0 + X1 d + X2 d² + X3 d³, d = T − TREF, T kept within TMIN … TMAX, degC
    (reading − offset(T) − CAL_ACC0_XOFF) · CAL_ACC0_XSCALE        reading − offset(T) − CAL_GYRO0_XOFF

in m/s² and rad/s; T is the temperature in the topic of the sensor itself. X0 is zero, as PX4's own procedure leaves it:
CAL_* hold the values at TREF. PX4 uses the numbers for the sensor whose id is in TC_A0_ID and TC_G0_ID. Releases before
2021 had TC_A0_SCL_0 too, a scale without temperature.

Source: PX4, parameter reference, "Thermal Compensation"; module temperature_compensation.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tumble.calibration.calibration_file import Calibration
from tumble.errors import InputError
from tumble.export.autopilot import sensors_of, single, whose, written
from tumble.export.exported import Exported, origin
from tumble.export.px4 import INT32, REAL32, parameters, signed, too_small
from tumble.export.thermal import Thermal, said, thermal
from tumble.recording.autopilot import AutopilotSensor
from tumble.units import Array

LETTERS = {"accel": "A", "gyro": "G"}
MOST_PLACES = 3
"""So many sensors of a kind PX4 compensates."""


def px4_thermal(calibration: Calibration, ids: tuple[int, int] | None = None, imu: int | None = None) -> Exported:
    """The .params file of a calibration over temperature; `ids` are the device ids of accelerometer and gyro, and `imu`
    the number of the IMU, from 1, where the recording has not said them."""
    ids, place = ids or _recorded(calibration), 0 if imu is None else imu - 1
    found, sensors = (
        thermal(calibration, "px4-thermal", (("accel",), ("gyro",))),
        sensors_of(calibration, imu, "px4-thermal", MOST_PLACES),
    )
    held = found.held

    def offsets(kind: str, temperature: Array) -> Array:
        return _offsets(found, kind, temperature)

    losses = (
        *found.losses(offsets),
        _in_steps(found),
        *held.losses,
        *too_small(held),
        *([] if ids is not None else [_no_ids(found, sensors, place)]),
        *whose(calibration, imu),
    )
    at = dict.fromkeys(f"{found.reference(kind):g}" for kind in found.slopes)
    comments = [
        *origin(calibration),
        f"{' and '.join(_ids(found, sensors).values())} have to be the ids of these sensors already",
        f"CAL_*OFF and CAL_*SCALE are those at {' and '.join(at)} degC",
        *found.examples(offsets),
        *losses,
        "",
        "Vehicle-Id Component-Id Name Value Type",
    ]
    rows = [(name, value, REAL32) for name, value in parameters(held, sensors)]
    for kind in found.slopes:
        rows += _of_kind(found, (kind, place), None if ids is None else ids[("accel", "gyro").index(kind)])
    lines = [f"1\t1\t{name}\t{value}\t{kind}" for name, value, kind in rows]
    return Exported(content="\n".join([*(f"# {c}".rstrip() for c in comments), *lines, ""]).encode(), losses=losses)


def _recorded(calibration: Calibration) -> tuple[int, int] | None:
    """The device ids of accelerometer and gyro that came with the recording."""
    known = [calibration.imu[kind].id for kind in ("accel", "gyro") if kind in calibration.imu]
    accel, gyro = known if len(known) == 2 else (None, None)
    return None if accel is None or gyro is None else (accel, gyro)


def sensor_ids(text: str) -> tuple[int, int]:
    """The device ids of accelerometer and gyro of a text such as "1310988,1310988". Raises InputError."""
    try:
        accel, gyro = map(int, text.split(","))
    except ValueError:
        raise InputError(
            f"--sensor-ids: expected the numbers in CAL_ACC0_ID and CAL_GYRO0_ID with a comma between, found {text!r}"
        ) from None
    return accel, gyro


def _ids(found: Thermal, sensors: Mapping[str, AutopilotSensor]) -> dict[str, str]:
    """The names of the parameters with the ids of the sensors, by what is compensated."""
    words = {"accel": "ACC", "gyro": "GYRO"}
    return {LETTERS[kind]: f"CAL_{words[kind]}{sensors[kind].number - 1}_ID" for kind in found.slopes}


def _no_ids(found: Thermal, sensors: Mapping[str, AutopilotSensor], place: int) -> str:
    ids = _ids(found, sensors)
    return (
        f"{' and '.join(f'TC_{letter}{place}_ID' for letter in ids)} are not in this file: set them to "
        f"{' and '.join(ids.values())}, or give --sensor-ids; without them PX4 compensates nothing"
    )


def _of_kind(found: Thermal, of: tuple[str, int], device: int | None) -> list[tuple[str, str, int]]:
    """The parameters of the accelerometer or the gyro in a place."""
    kind, place = of
    stem = f"TC_{LETTERS[kind]}{place}"
    rows = [(f"TC_{LETTERS[kind]}_ENABLE", "1", INT32)]
    rows += [] if device is None else [(f"{stem}_ID", str(signed(device)), INT32)]
    ends = {"TREF": found.reference(kind), "TMIN": found.measured.low, "TMAX": found.measured.high}
    rows += [(f"{stem}_{name}", value, REAL32) for name, value in zip(ends, written(_row(ends)), strict=True)]
    for degree, column in enumerate(_coefficients(found, kind).T):
        rows += [(f"{stem}_X{degree}_{axis}", value, REAL32) for axis, value in enumerate(written(column))]
    return rows


def _row(values: dict[str, float]) -> Array:
    return np.array(list(values.values()))


def _coefficients(found: Thermal, kind: str) -> Array:
    """X0, X1, X2, X3 (3, 4) of the axes."""
    zero = np.zeros((3, 1))
    return np.hstack([zero, found.slopes[kind], zero])


def _offsets(found: Thermal, kind: str, temperature: Array) -> Array:
    """Everything that PX4 takes off the readings, (N, 3), from the numbers in the file."""
    reference, low, high = np.array(
        [found.reference(kind), found.measured.low, found.measured.high], dtype=np.float32
    ).astype(float)
    d = (np.clip(temperature, low, high) - reference)[:, None]
    X = single(_coefficients(found, kind))
    return np.asarray(X[:, 0] + X[:, 1] * d + X[:, 2] * d**2 + X[:, 3] * d**3 + found.held.offset[kind])


def _in_steps(found: Thermal) -> str:
    return (
        "PX4 takes up new offsets when the temperature has changed by more than 1 degC: until then an error of up to "
        f"{said(found.steepest())}"
    )
