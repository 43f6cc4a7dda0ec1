"""PX4 flight logs (ULog): the uncorrected messages sensor_accel and sensor_gyro, one per instance, and sensor_mag; of
sensor_baro the temperature.

sensor_combined and vehicle_imu are left aside where the others are there: they hold values that PX4 has corrected with
its own calibration and averaged.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from pyulog import ULog

from tumble.recording.autopilot import AutopilotSensor
from tumble.recording.formats.message import TIME, Message, Sensors, triad

NOTHING = "no messages sensor_accel or sensor_combined; set SDLOG_PROFILE to log the raw sensors"

_SECOND = 1e-6  # times are in µs
_CORRECTED = (
    "PX4 has corrected these readings with its own calibration: reset it (CAL_ACC*, CAL_GYRO*) before recording"
)
_SENSORS = {
    "sensor_accel": ("accel", ("x", "y", "z")),
    "sensor_gyro": ("gyro", ("x", "y", "z")),
    "sensor_mag": ("field", ("x", "y", "z")),
}
_CALIBRATED = {"sensor_accel": ("accel", "CAL_ACC{}_ID"), "sensor_gyro": ("gyro", "CAL_GYRO{}_ID")}
_MOST = 4  # sensors of a kind that PX4 has calibrations of
_BAROMETER = "sensor_baro"
_COMBINED = {
    "accel": ("accelerometer_m_s2[0]", "accelerometer_m_s2[1]", "accelerometer_m_s2[2]"),
    "gyro": ("gyro_rad[0]", "gyro_rad[1]", "gyro_rad[2]"),
}


def messages(path: Path) -> list[Message]:
    """Messages with inertial sensors, an entry for each instance."""
    with path.open("rb") as stream:
        log = ULog(stream, [*_SENSORS, _BAROMETER, "sensor_combined"])
    kept = sorted(log.data_list, key=lambda d: (d.name, d.multi_id))
    kept = [data for data in kept if data.name != _BAROMETER or _has_temperature(data.data)]
    origin = min((int(_taken(data.data)[0]) for data in kept), default=0)
    found = [replace(_message(data, origin), imu=_sensors(data, log.initial_parameters)) for data in kept]
    raw = [m for m in found if not m.name.startswith("sensor_combined")]
    return raw if any(m.accel for m in raw) else found


def _sensors(data: Any, parameters: Mapping[str, Any]) -> dict[str, AutopilotSensor]:
    """Which accelerometer or gyro a message is of: that whose calibration has its device id (CAL_ACC2_ID is that of the
    third), else by the number of its instance."""
    kind, parameter = _CALIBRATED.get(data.name, ("", ""))
    if not kind:
        return {}
    ids = data.data.get("device_id")
    device = None if ids is None or not int(ids[0]) else int(ids[0])
    slots = [k for k in range(_MOST) if device is not None and _unsigned(parameters.get(parameter.format(k))) == device]
    return {kind: AutopilotSensor(number=1 + (slots[0] if slots else data.multi_id), id=device)}


def _unsigned(parameter: Any) -> int | None:
    """A device id, which parameters have as a number with a sign."""
    return None if parameter is None else int(parameter) % 2**32


def _message(data: Any, origin: int) -> Message:
    values, count = data.data, len(data.data["timestamp"])
    name = f"{data.name}.{data.multi_id}"
    if data.name == "sensor_combined":
        fields = {f"{kind}_{axis}": f for kind, fs in _COMBINED.items() for axis, f in zip("xyz", fs, strict=True)}
        accel, gyro = triad("accel", "m/s^2"), triad("gyro", "rad/s")
        return Message(
            name=name,
            count=count,
            accel=accel,
            gyro=gyro,
            rows=partial(_rows, values, fields, origin),
            remark=_CORRECTED,
        )
    if data.name == _BAROMETER:
        fields = {"baro_temperature": "temperature"}
        rows = partial(_rows, values, fields, origin)
        return Message(name=name, count=count, accel=None, gyro=None, temperatures=("baro_temperature",), rows=rows)
    kind, columns = _SENSORS[data.name]
    fields = {f"{kind}_{axis}": f for axis, f in zip("xyz", columns, strict=True)}
    warmth = {f"{kind}_temperature": "temperature"} if _has_temperature(values) else {}
    return Message(
        name=name,
        count=count,
        accel=_only("accel", kind, "m/s^2"),
        gyro=_only("gyro", kind, "rad/s"),
        magnetometer=_only("field", kind, "gauss"),
        temperatures=tuple(warmth),
        rows=partial(_rows, values, fields | warmth, origin),
    )


def _only(wanted: str, kind: str, unit: str) -> Sensors | None:
    return triad(kind, unit) if kind == wanted else None


def _has_temperature(values: dict[str, Any]) -> bool:
    return "temperature" in values and bool(np.isfinite(values["temperature"]).all())


def _taken(values: dict[str, Any]) -> Any:
    """When the samples were taken, µs."""
    return values.get("timestamp_sample", values["timestamp"])


def _rows(values: dict[str, Any], fields: dict[str, str], origin: int) -> Iterator[pl.DataFrame]:
    """The whole message: a flight log is in memory anyway."""
    time = (_taken(values).astype(np.int64) - origin) * _SECOND
    yield pl.DataFrame({TIME: time} | {name: values[field].astype(np.float64) for name, field in fields.items()})
