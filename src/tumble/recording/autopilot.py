"""Which sensor of an autopilot was recorded: its number there, and its device id."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, kw_only=True, slots=True)
class AutopilotSensor:
    """An accelerometer or a gyro of an autopilot, three axes: its number among those, from 1, and its device id, None
    where the recording does not have it."""

    number: int
    id: int | None


def sensors_content(sensors: Mapping[str, AutopilotSensor]) -> dict[str, int]:
    """The sensors "accel" and "gyro" as [device.imu] and the calibration file have them."""
    content: dict[str, int] = {}
    for kind, sensor in sensors.items():
        content[f"{kind}_number"] = sensor.number
        content |= {} if sensor.id is None else {f"{kind}_id": sensor.id}
    return content


def sensors_from(content: Mapping[str, Any]) -> dict[str, AutopilotSensor]:
    """The sensors of what `sensors_content` gives."""
    kinds = [kind for kind in ("accel", "gyro") if content.get(f"{kind}_number") is not None]
    return {kind: AutopilotSensor(number=content[f"{kind}_number"], id=content.get(f"{kind}_id")) for kind in kinds}
