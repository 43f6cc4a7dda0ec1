"""A session as session.toml would say it: the way back from `Session` to the keys and values of the file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from datetime import datetime
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from tumble.recording.autopilot import sensors_content
from tumble.recording.circumstances import circumstances_content
from tumble.recording.session import Channels, LogSpec, Session, TemperatureChannels
from tumble.recording.session.log_tables import CLOCK, RAW
from tumble.units import ACCEL_UNITS, DEGREE, GYRO_UNITS, TIME_UNITS, Unit


def description_of(session: Session) -> dict[str, Any]:
    """The content of session.toml of a session, paths absolute; without log.file where its samples are in memory.
    Channels with nominal scale and offset have them in the log's unit; full scales are left out.

    >>> import numpy as np, tumble
    >>> session = tumble.session_of_arrays(accel=np.tile([0.0, 0.0, 9.81], (300, 1)), rate=100.0)
    >>> tumble.description_of(session)["log"]
    {'rate_hz': 100.0, 'accel': {'columns': ['accel_x', 'accel_y', 'accel_z'], 'unit': 'm/s^2'}}
    """
    device, site, spec, given = session.device, session.site, session.log, session.circumstances
    content: dict[str, Any] = {
        "format": 1,
        "device": {
            "serial": device.serial,
            "model": device.model,
            "imu": sensors_content(device.imu) or None,
            "systematic": None if device.systematic is None else str(device.systematic.resolve()),
        },
        "site": {
            "latitude_deg": None if site.latitude is None else site.latitude / DEGREE,
            "height_m": site.height,
            "gravity": site.gravity,
            "gravity_u": site.gravity_u,
            "field": site.field,
        },
        "log": _log(spec),
        "programme": None,
        "session": circumstances_content(given) or None,
    }
    if given.date is not None:
        content["session"]["date"] = datetime.fromisoformat(given.date) if "T" in given.date else given.day
    if session.programme is not None:
        name, positions = session.programme.name, session.programme.positions
        listed = [{"attitude": p.attitude, "start": p.start, "stop": p.stop} for p in positions]
        content["programme"] = {"name": name, "position": None if name is not None else listed}
    stated: dict[str, Any] = _stated(content)
    return stated


def _stated(value: Any) -> Any:
    """What is not None of a table and those within it."""
    if isinstance(value, list):
        return [_stated(part) for part in value]
    if not isinstance(value, dict):
        return value
    return {key: _stated(part) for key, part in value.items() if part is not None}


def _log(spec: LogSpec) -> dict[str, Any]:
    files = [str(file.resolve()) for file in spec.files if isinstance(file, Path)]
    unit = CLOCK if spec.clock else next(name for name, factor in TIME_UNITS.items() if factor == spec.time_factor)
    magnetometer = spec.magnetometer
    return {
        "file": files[0] if len(files) == 1 else files or None,
        "time": spec.time,
        "time_unit": None if spec.time is None or unit == "s" else unit,
        "regular": spec.regular or None,
        "rate_hz": spec.rate,
        "clock_ppm_u": None if spec.clock_u is None else 1e6 * spec.clock_u,
        "accel": _channels(spec.accel, ACCEL_UNITS),
        "gyro": None if spec.gyro is None else _channels(spec.gyro, GYRO_UNITS),
        "temperature": None if spec.temperature is None else _thermometers(spec.temperature),
        "magnetometer": magnetometer and {"columns": list(magnetometer.columns), "unit": magnetometer.unit},
    } | ({} if spec.dialect is None else asdict(spec.dialect))


def _thermometers(given: TemperatureChannels) -> dict[str, Any]:
    of_kinds = [list(dict.fromkeys(numbers)) for numbers in (given.accel, given.gyro)]
    one_each = max(map(len, of_kinds)) == 1
    listed = list(dict.fromkeys(chain(*of_kinds))) if one_each else [*given.accel, *given.gyro]
    content: dict[str, Any] = {"columns": [given.columns[t] for t in listed], "unit": given.unit_name}
    if given.unit_name == RAW:
        scale = 1.0 / given.gain
        content |= {"scale": scale[listed].tolist(), "offset": (-given.shift * scale)[listed].tolist()}
    return content


def _channels(channels: Channels, units: Mapping[str, Unit]) -> dict[str, Any]:
    content: dict[str, Any] = {"columns": list(channels.columns), "unit": channels.unit_name}
    if units[channels.unit_name].kind == "raw":
        content["scale"] = channels.scale.tolist()
        content["scale_per"] = next(name for name, unit in units.items() if unit == channels.unit)
        content["offset"] = channels.offset.tolist()
    if not np.array_equal(channels.axes, np.eye(3)):
        content["axes"] = channels.axes.tolist()
    return content
