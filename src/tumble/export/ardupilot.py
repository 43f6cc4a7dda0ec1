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

ESTIMATED_ANEW = "gyro offsets are estimated anew at every start unless INS_GYR_CAL is 0"


def ardupilot(calibration: Calibration, imu: int | None = None) -> Exported:
    """The .param file of a calibration, of the IMU of this number, from 1, or of that which was recorded."""
    held, sensors = diagonal(calibration, "ardupilot"), sensors_of(calibration, imu, "ardupilot", MOST)
    losses = (*held.losses, *([] if held.gyro_offset is None else [ESTIMATED_ANEW]), *whose(calibration, imu))
    comments = [f"# {line}" for line in (*origin(calibration), *held.examples(), *losses)]
    rows = [f"{name},{value}" for name, value in (*parameters(held, sensors), *_ids(held, sensors))]
    return Exported(content="\n".join([*comments, *rows, ""]).encode(), losses=losses)


def parameters(held: Diagonal, sensors: Mapping[str, AutopilotSensor] = FIRST) -> list[tuple[str, str]]:
    """Names and values of offsets and scales."""
    accel, gyro = (sensors[kind].number for kind in ("accel", "gyro"))
    groups = [(name_of("ACC", accel, "OFFS"), held.accel_offset), (name_of("ACC", accel, "SCAL"), held.accel_factor)]
    groups += [] if held.gyro_offset is None else [(name_of("GYR", gyro, "OFFS"), held.gyro_offset)]
    return [
        (f"{name}_{axis}", value) for name, three in groups for axis, value in zip("XYZ", written(three), strict=True)
    ]


def name_of(kind: str, number: int, what: str) -> str:
    """The name of a parameter of the IMU of this number: INS_ACCOFFS, INS_ACC2OFFS, INS4_ACCOFFS."""
    inside = "" if number == 1 else str(number)
    return f"INS_{kind}{inside}{what}" if number <= NUMBER_INSIDE else f"INS{number}_{kind}{what}"


def _ids(held: Diagonal, sensors: Mapping[str, AutopilotSensor]) -> list[tuple[str, str]]:
    """Names and values of the device ids that are known."""
    kinds = {"accel": "ACC"} | ({} if held.gyro_offset is None else {"gyro": "GYR"})
    return [
        (name_of(word, sensors[kind].number, "_ID"), str(sensors[kind].id))
        for kind, word in kinds.items()
        if sensors[kind].id is not None
    ]
