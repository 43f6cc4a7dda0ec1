"""ArduPilot: a parameter file of one IMU.

    INS_ACCOFFS_X, INS_ACCSCAL_X and so on: (reading − offset) · scale        INS_GYROFFS_X and so on: reading − offset

reading being that of the sensor, m/s² and rad/s, before the board's orientation. The second and the third IMU have
their number inside the names, INS_ACC2OFFS_X, the fourth and the fifth before, INS4_ACCOFFS_X. Offsets of the gyros are
estimated anew at every start unless INS_GYR_CAL is 0. INS_ACC_ID and INS_GYR_ID are in the file where the recording had
them: ArduPilot takes calibrations of other ids for none.

Source: ArduPilot, parameter reference; library AP_InertialSensor.
"""

from __future__ import annotations

from collections.abc import Mapping

from tumble.calibration.calibration_file import Calibration
from tumble.export.autopilot import FIRST, Diagonal, diagonal, sensors_of, whose, written
from tumble.export.exported import Exported, origin
from tumble.recording.autopilot import AutopilotSensor

MOST = 5
"""IMUs that ArduPilot keeps calibrations of."""
NUMBER_INSIDE = 3
"""The last IMU that has its number inside the names."""

WORDS = {"accel": "ACC", "gyro": "GYR"}
"""What the kinds of sensors are called in names."""

ESTIMATED_ANEW = "gyro offsets are estimated anew at every start unless INS_GYR_CAL is 0"


def ardupilot(calibration: Calibration, imu: int | None = None) -> Exported:
    """The .param file of a calibration, of the IMU of this number, from 1, or of that which was recorded."""
    held, sensors = diagonal(calibration, "ardupilot"), sensors_of(calibration, imu, "ardupilot", MOST)
    losses = (*held.losses, *([ESTIMATED_ANEW] if "gyro" in held.known else []), *whose(calibration, imu))
    comments = [f"# {line}" for line in (*origin(calibration), *held.examples(), *losses)]
    rows = [f"{name},{value}" for name, value in (*parameters(held, sensors), *_ids(held, sensors))]
    return Exported(content="\n".join([*comments, *rows, ""]).encode(), losses=losses)


def parameters(held: Diagonal, sensors: Mapping[str, AutopilotSensor] = FIRST) -> list[tuple[str, str]]:
    """Names and values of offsets and scales."""
    groups = []
    for kind, offset in held.offset.items():
        word, number = WORDS[kind], sensors[kind].number
        groups += [(name_of(word, number, "OFFS"), offset)]
        groups += [(name_of(word, number, "SCAL"), held.factor[kind])] if kind == "accel" else []
    return [
        (f"{name}_{axis}", value) for name, three in groups for axis, value in zip("XYZ", written(three), strict=True)
    ]


def name_of(kind: str, number: int, what: str) -> str:
    """The name of a parameter of the IMU of this number: INS_ACCOFFS, INS_ACC2OFFS, INS4_ACCOFFS."""
    inside = "" if number == 1 else str(number)
    return f"INS_{kind}{inside}{what}" if number <= NUMBER_INSIDE else f"INS{number}_{kind}{what}"


def _ids(held: Diagonal, sensors: Mapping[str, AutopilotSensor]) -> list[tuple[str, str]]:
    """Names and values of the device ids that are known."""
    return [
        (name_of(WORDS[kind], sensors[kind].number, "_ID"), str(sensors[kind].id))
        for kind in held.known
        if sensors[kind].id is not None
    ]
