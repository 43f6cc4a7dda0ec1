"""PX4 flight logs (ULog): the uncorrected messages sensor_accel, sensor_gyro and sensor_mag, one per instance.

sensor_combined, which PX4 has corrected with its calibration and averaged, is used only where the others are slower;
by default PX4 logs them once a second.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from pyulog import ULog

from tumble.recording.formats import MESSAGES, PX4_CORRECTED, TIME, Message, triads_of
from tumble.recording.session import AutopilotSensor

NOTHING = "no messages sensor_accel or sensor_combined; set SDLOG_PROFILE to log the raw sensors"

_SECOND = 1e-6  # times are in µs
_COMBINED = "sensor_combined"
_APPLIED = re.compile(r"CAL_(ACC|GYRO)\d_[XYZ](OFF|SCALE)|SENS_BOARD_(ROT|[XYZ]_OFF)")
_FIELDS = MESSAGES["ulog"]["messages"]
_THERMOMETERS = {"sensor_accel": "accel", "sensor_gyro": "gyro", "sensor_mag": "field"}
_CALIBRATED = {"sensor_accel": ("accel", "CAL_ACC{}_ID"), "sensor_gyro": ("gyro", "CAL_GYRO{}_ID")}
_MOST = 4  # sensors of a kind that PX4 has calibrations of


class _PastTheEnd(io.BufferedReader):
    """A file whose position advances by the requested size also at its end.

    pyulog steps back by the requested size, and would never end otherwise."""

    def read(self, size: int | None = -1) -> bytes:
        start, read = self.tell(), super().read(size)
        if size is not None and len(read) < size:
            self.seek(start + size)
        return read


def messages(path: Path) -> list[Message]:
    """Return messages with inertial sensors, one for each instance."""
    with io.FileIO(path) as file, _PastTheEnd(file) as stream:
        log = ULog(stream, list(_FIELDS))
    kept = sorted(log.data_list, key=lambda d: (d.name, d.multi_id))
    origin = min((int(_taken(data.data)[0]) for data in kept), default=0)
    candidates = [_message(data, origin, log.initial_parameters) for data in kept]
    combined = max((m.count for m in candidates if m.name.startswith(_COMBINED)), default=0)
    slow = [m for m in candidates if (m.accel or m.gyro) and m.count < combined // 2]
    raw = [m for m in candidates if m not in slow and not m.name.startswith(_COMBINED)]
    return raw if any(m.accel for m in raw) else [m for m in candidates if m not in slow]


def _message(data: Any, origin: int, parameters: Mapping[str, Any]) -> Message:
    values, fields = data.data, dict(_FIELDS[data.name])
    warmth = {}
    if data.name in _THERMOMETERS and np.isfinite(values.get("temperature", np.nan)).all():
        warmth = {f"{_THERMOMETERS[data.name]}_temperature": "temperature"}
    applied = {name: float(value) for name, value in parameters.items() if _APPLIED.fullmatch(name)}
    corrected = not applied or any(value != name.endswith("SCALE") for name, value in applied.items())
    return Message(
        name=f"{data.name}.{data.multi_id}",
        count=len(values["timestamp"]),
        triads=triads_of(fields, MESSAGES["ulog"]["units"]),
        temperatures=tuple(warmth),
        rows=partial(_rows, values, fields | warmth, origin),
        doubt=PX4_CORRECTED if data.name == _COMBINED and corrected else "",
        imu=_sensors(data, parameters),
    )


def _sensors(data: Any, parameters: Mapping[str, Any]) -> dict[str, AutopilotSensor]:
    """Return the accelerometer or gyro of a message: the one whose calibration has its device id, else by instance.

    CAL_ACC2_ID belongs to the third accelerometer; parameters have ids as signed numbers."""
    kind, parameter = _CALIBRATED.get(data.name, ("", ""))
    if not kind:
        return {}
    ids = data.data.get("device_id")
    device = None if ids is None or not int(ids[0]) else int(ids[0])
    calibrated = {slot: parameters.get(parameter.format(slot)) for slot in range(_MOST)}
    slots = [slot for slot, stated in calibrated.items() if stated is not None and int(stated) % 2**32 == device]
    return {kind: AutopilotSensor(number=1 + (slots[0] if slots else data.multi_id), id=device)}


def _taken(values: dict[str, Any]) -> Any:
    """Return the times of the samples, µs."""
    return values.get("timestamp_sample", values["timestamp"])


def _rows(values: dict[str, Any], fields: dict[str, str], origin: int) -> Iterator[pl.DataFrame]:
    """Yield the whole message; a flight log is in memory anyway."""
    with np.errstate(invalid="ignore"):  # of a damaged log
        time = (_taken(values).astype(np.int64) - origin) * _SECOND
        readings = {name: values[field].astype(np.float64) for name, field in fields.items()}
    yield pl.DataFrame({TIME: time} | readings)
