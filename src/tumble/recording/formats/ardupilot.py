"""ArduPilot flight logs (.bin, or as text, .log): messages IMU (accelerometers and gyros), ACC and GYR (raw, at the
sensors' own rate), one for each instance. Before ArduPilot 4.1 the instance is in the name: IMU, IMU2 and IMU3, ACC1
and GYR1 to ACC3 and GYR3.

ArduPilot logs readings after its own offsets and scales, which have to be reset before recording.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import ExitStack, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from pymavlink.DFReader import DFReader_binary, DFReader_text

from tumble.errors import InputError
from tumble.recording.formats import AXES, TIME, Message, triads_of
from tumble.recording.panic import COMMAND_LINE, without_panic
from tumble.recording.session import AutopilotSensor

NOTHING = "no messages IMU or ACC; set bit 'IMU' of LOG_BITMASK and record again"

_HEAD, _HEAD_WITHIN = b"\xa3\x95", 4096  # before every message; bytes
_PARAMETER = "PARM"
_TIME = "TimeUS"
_NAMED_INSIDE = 3  # INS_ACC3_ID, but INS4_ACC_ID
_SECOND = 1e-6  # times are in µs
_REMARK = (
    "ArduPilot has applied its own INS_ACCOFFS, INS_ACCSCAL and INS_GYROFFS to these readings: reset them to 0 and 1 "
    "before recording, and set INS_TCAL1_ENABLE to 0"
)
_TEMPERATURE = "temperature"
_ACCEL = {f"accel_{a}": f"Acc{a.upper()}" for a in AXES}
_GYRO = {f"gyro_{a}": f"Gyr{a.upper()}" for a in AXES}
_FIELDS = {"IMU": _ACCEL | _GYRO, "ACC": _ACCEL, "GYR": _GYRO}
_INSTANCES = {
    **{kind: (kind, 0) for kind in _FIELDS},
    **{f"{kind}{number}": (kind, number - 1) for kind in _FIELDS for number in (1, 2, 3)},
}
"""Kind and instance in the name of a message; for the instance a field I takes precedence."""


def messages(path: Path) -> list[Message]:
    """Return messages with inertial sensors, one for each instance."""
    kept: dict[tuple[str, int], list[list[float]]] = {}
    ids: dict[str, int] = {}
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
                    ids |= {message.Name: int(message.Value)} if message.Name.endswith("_ID") else {}
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
    if not kept and path.suffix.lower() == ".bin" and _HEAD not in path.read_bytes()[:_HEAD_WITHIN]:
        raise InputError(f"{path}: expected a log of ArduPilot, found another binary file; export its readings as CSV")
    origin = min((rows[0][0] for rows in kept.values()), default=0.0)
    return [
        _message(kind, instance, np.array(rows, dtype=float), origin, ids)
        for (kind, instance), rows in sorted(kept.items())
    ]


def _message(kind: str, instance: int, rows: Any, origin: float, ids: Mapping[str, int]) -> Message:
    """Return the message of one instance; device ids are parameters of the log."""
    rows[:, 0] = (rows[:, 0] - origin) * _SECOND
    names = [TIME, *_FIELDS[kind]]
    warm = kind == "IMU" and bool(np.isfinite(rows[:, -1]).all() and rows[:, -1].any())  # 0: no thermometer
    names += [_TEMPERATURE] if warm else []
    number = instance + 1
    prefix, counted = ("INS", "" if number == 1 else str(number)) if number <= _NAMED_INSIDE else (f"INS{number}", "")
    return Message(
        name=f"{kind}.{instance}",
        count=len(rows),
        triads=triads_of(names, {"accel": "m/s^2", "gyro": "rad/s"}),
        temperatures=(_TEMPERATURE,) if warm else (),
        rows=lambda: iter([pl.DataFrame(rows[:, : len(names)], schema=names, orient="row")]),
        remark=_REMARK,
        imu={
            sensor: AutopilotSensor(number=number, id=ids.get(f"{prefix}_{word}{counted}_ID") or None)
            for sensor, word in (("accel", "ACC"), ("gyro", "GYR"))
            if kind in ("IMU", word)
        },
    )
