"""ArduPilot flight logs (.bin, or as text, .log): messages IMU (accelerometers and gyros), ACC and GYR (raw, at the
sensors' own rate), one for each instance. Before ArduPilot 4.1 the instance is in the name: IMU, IMU2 and IMU3, ACC1
and GYR1 to ACC3 and GYR3.

ArduPilot logs readings after its own offsets o and scales s, turned by R of AHRS_ORIENTATION into the board's axes
(AP_InertialSensor_Backend::_rotate_and_correct_accel). If the log states these parameters, they are undone:

    raw = Rᵀ logged / s + o
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from pymavlink import mavutil
from pymavlink.DFReader import DFReader_binary, DFReader_text
from scipy.spatial.transform import Rotation

from tumble.errors import InputError
from tumble.recording.formats import AXES, MESSAGES, TIME, Message, triads_of
from tumble.recording.panic import COMMAND_LINE, without_panic
from tumble.recording.session import AutopilotSensor

NOTHING = "no messages IMU or ACC; set bit 'IMU' of LOG_BITMASK and record again"

_HEAD, _HEAD_WITHIN = b"\xa3\x95", 4096  # before every message; bytes
_PARAMETER = "PARM"
_TIME = "TimeUS"
_NAMED_INSIDE = 3  # INS_ACC3_ID, but INS4_ACC_ID
_SECOND = 1e-6  # times are in µs
_TEMPERATURE = "temperature"
_FIELDS = MESSAGES["ardupilot"]["messages"]
_INSTANCES = {
    **{kind: (kind, 0) for kind in _FIELDS},
    **{f"{kind}{number}": (kind, number - 1) for kind in _FIELDS for number in (1, 2, 3)},
}
"""Kind and instance in the name of a message; for the instance a field I takes precedence."""


def messages(path: Path) -> list[Message]:
    """Return messages with inertial sensors, one for each instance."""
    kept: dict[tuple[str, int], list[list[float]]] = {}
    parameters: dict[str, float] = {}
    with ExitStack() as stack:
        if COMMAND_LINE.get():  # pymavlink prints a line, from Python or from C, for every byte that it skips
            stack.enter_context(without_panic(silent=True))
            nowhere = stack.enter_context(redirect_stdout(StringIO()))
            stack.enter_context(redirect_stderr(nowhere))
        log = DFReader_binary(str(path)) if path.suffix.lower() == ".bin" else DFReader_text(str(path))
        try:
            while (message := log.recv_match(type=[*_INSTANCES, _PARAMETER])) is not None:
                name = message.get_type()
                if name == _PARAMETER:
                    parameters.setdefault(message.Name, float(message.Value))  # at the start of the log
                    continue
                kind, instance = _INSTANCES[name]
                fields, named = _FIELDS[kind].values(), {*message.get_fieldnames()}
                if not {_TIME, *fields} <= named:
                    continue
                taken = message.SampleUS if "SampleUS" in named else message.TimeUS
                instance = int(message.I) if "I" in named else instance
                temperature = [message.T if "T" in named else math.nan] if kind == "IMU" else []
                reading = [taken, *(getattr(message, field) for field in fields), *temperature]
                kept.setdefault((kind, instance), []).append(reading)
        finally:
            log.close()
    if not kept and path.suffix.lower() == ".bin":
        with path.open("rb") as file:
            if _HEAD not in file.read(_HEAD_WITHIN):
                raise InputError(
                    f"{path}: expected a log of ArduPilot, found another binary file; export its readings as CSV"
                )
    origin = min((rows[0][0] for rows in kept.values()), default=0.0)
    return [
        _message(kind, instance, np.array(rows, dtype=float), origin, parameters)
        for (kind, instance), rows in sorted(kept.items())
    ]


def _message(kind: str, instance: int, rows: Any, origin: float, parameters: Mapping[str, float]) -> Message:
    """Return the message of one instance, with the autopilot's corrections undone; device ids are parameters too."""
    rows[:, 0] = (rows[:, 0] - origin) * _SECOND
    names = [TIME, *_FIELDS[kind]]
    warm = kind == "IMU" and bool(np.isfinite(rows[:, -1]).all() and rows[:, -1].any())  # 0: no thermometer
    names += [_TEMPERATURE] if warm else []
    number = instance + 1
    prefix, counted = ("INS", "" if number == 1 else str(number)) if number <= _NAMED_INSIDE else (f"INS{number}", "")
    stems = {"accel": f"{prefix}_ACC{counted}", "gyro": f"{prefix}_GYR{counted}"}
    stems = {sensor: stem for sensor, stem in stems.items() if f"{sensor}_x" in _FIELDS[kind]}
    undone, tcal = _undo(rows, names, stems, parameters), f"INS_TCAL{number}_ENABLE"
    doubt = MESSAGES["ardupilot"]["compensated"].format(tcal) if parameters.get(tcal) else ""
    ids = {sensor: parameters.get(f"{stem}_ID") for sensor, stem in stems.items()}
    return Message(
        name=f"{kind}.{instance}",
        count=len(rows),
        triads=triads_of(names, MESSAGES["ardupilot"]["units"]),
        temperatures=(_TEMPERATURE,) if warm else (),
        rows=lambda: iter([pl.DataFrame(rows[:, : len(names)], schema=names, orient="row")]),
        remark=f"ArduPilot's corrections are undone: {', '.join(undone)}" if undone else "",
        doubt=MESSAGES["ardupilot"]["unknown"] if undone is None else doubt,
        imu={sensor: AutopilotSensor(number=number, id=int(ids[sensor] or 0) or None) for sensor in stems},
    )


def _undo(rows: Any, names: list[str], stems: Mapping[str, str], parameters: Mapping[str, float]) -> list[str] | None:
    """Undo the corrections of the autopilot in the columns with these names, and return them in words; return None if
    the log does not state them."""
    needed = {f"{stem}OFFS_X" for stem in stems.values()}
    needed |= {f"{stems['accel']}SCAL_X"} if "accel" in stems else set()
    number = int(parameters.get("AHRS_ORIENTATION", 0))
    orientation = mavutil.mavlink.enums["MAV_SENSOR_ORIENTATION"].get(number)
    if not needed <= parameters.keys() or orientation is None or "Pitch" not in orientation.description:
        return None
    angles = {axis: float(a) for axis, a in re.findall(r"(Roll|Pitch|Yaw): (\d+)", orientation.description)}
    turned = Rotation.from_euler("ZYX", [angles.get(axis, 0.0) for axis in ("Yaw", "Pitch", "Roll")], degrees=True)
    undone = list[str]()
    for sensor, stem in stems.items():
        columns = [names.index(f"{sensor}_{axis}") for axis in AXES]
        applied = dict[str, Any]()
        for what, usual in (("OFFS", 0.0), ("SCAL", 1.0)):
            applied[what] = np.array([parameters.get(f"{stem}{what}_{axis.upper()}", usual) for axis in AXES])
            if (applied[what] != usual).any():
                undone.append(f"{stem}{what} {' '.join(f'{value:.6g}' for value in applied[what])}")
        rows[:, columns] = (rows[:, columns] @ turned.as_matrix()) / applied["SCAL"] + applied["OFFS"]
    if number:
        undone.append(f"AHRS_ORIENTATION {number} (the readings are in the axes of the sensor)")
    return undone
