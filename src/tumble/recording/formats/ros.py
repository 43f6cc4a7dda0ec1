"""ROS 1 bags, ROS 2 bags and MCAP files with ROS messages: sensor_msgs/Imu, sensor_msgs/MagneticField and
sensor_msgs/Temperature.

Time is that of the header, which is when the sample was taken; where headers are empty, that of the recording.
Some drivers (depth cameras) publish accelerometers and gyros as Imu messages of two topics, with zeros in place of the
other: sensors whose first readings are all exactly zero are taken as absent.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from tumble.recording.columns.thermometers import thermometer
from tumble.recording.formats.message import AXES, TIME, Message, triad

NOTHING = "no topic of type sensor_msgs/Imu"

_IMU, _FIELD = "sensor_msgs/msg/Imu", "sensor_msgs/msg/MagneticField"
_TEMPERATURE = "sensor_msgs/msg/Temperature"
_KINDS = (_IMU, _FIELD, _TEMPERATURE)
_CELSIUS = "temperature"
_ROWS = 1 << 15
_LOOK = 100
_MICROTESLA = 1e6  # in a tesla


def messages(path: Path) -> list[Message]:
    """Topics with inertial sensors."""
    with _opened(path) as bag:
        found = [(c.topic, c.msgtype, c.msgcount) for c in bag.connections if c.msgtype in _KINDS]
    filled = [(topic, kind, count) for topic, kind, count in found if count]
    origin = min((next(_stamped(path, topic))[0] for topic, _, _ in filled), default=0)
    return [_message(path, origin, topic, kind, count) for topic, kind, count in filled]


def _opened(path: Path) -> AnyReader:
    return AnyReader([path], default_typestore=get_typestore(Stores.LATEST))


def _message(path: Path, origin: int, topic: str, kind: str, count: int) -> Message:
    rows = partial(_rows, path, origin, topic)
    if kind == _FIELD:
        return Message(name=topic, count=count, accel=None, gyro=None, magnetometer=triad("field", "uT"), rows=rows)
    if kind == _TEMPERATURE:
        column = _column_of(topic)
        named = partial(_renamed, rows, column)
        return Message(name=topic, count=count, accel=None, gyro=None, temperatures=(column,), rows=named)
    look = next(_tables(islice(_readings(path, origin, topic), _LOOK)))
    accel = bool(look.select("accel_x", "accel_y", "accel_z").to_numpy().any())
    gyro = bool(look.select("gyro_x", "gyro_y", "gyro_z").to_numpy().any())
    return Message(
        name=topic,
        count=count,
        accel=triad("accel", "m/s^2") if accel else None,
        gyro=triad("gyro", "rad/s") if gyro else None,
        rows=rows,
    )


def _column_of(topic: str) -> str:
    """What the temperatures of a topic are called: by the sensors, where its name says whose they are."""
    whose, _ = thermometer(re.findall("[a-z]+", topic.lower())) or ("", "")
    return f"{whose}_{_CELSIUS}" if whose else _CELSIUS


def _renamed(rows: Callable[[], Iterator[pl.DataFrame]], column: str) -> Iterator[pl.DataFrame]:
    return (table.rename({_CELSIUS: column}) for table in rows())


def _rows(path: Path, origin: int, topic: str) -> Iterator[pl.DataFrame]:
    return _tables(_readings(path, origin, topic))


def _readings(path: Path, origin: int, topic: str) -> Iterator[dict[str, float]]:
    """Every message of a topic as time (s after `origin`, ns) and readings by column."""
    for stamp, kind, message in _stamped(path, topic):
        yield {TIME: (stamp - origin) * 1e-9} | _READINGS[kind](message)


def _stamped(path: Path, topic: str) -> Iterator[tuple[int, str, Any]]:
    """Every message of a topic with its time, ns, and its type."""
    with _opened(path) as bag:
        wanted = [c for c in bag.connections if c.topic == topic and c.msgtype in _KINDS]
        for connection, recorded, raw in bag.messages(connections=wanted):
            message: Any = bag.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp
            yield stamp.sec * 10**9 + stamp.nanosec or recorded, connection.msgtype, message


def _imu(message: Any) -> dict[str, float]:
    force, rate = message.linear_acceleration, message.angular_velocity
    return {f"accel_{a}": getattr(force, a) for a in AXES} | {f"gyro_{a}": getattr(rate, a) for a in AXES}


def _field(message: Any) -> dict[str, float]:
    return {f"field_{a}": getattr(message.magnetic_field, a) * _MICROTESLA for a in AXES}


def _temperature(message: Any) -> dict[str, float]:
    return {_CELSIUS: message.temperature}  # °C by the definition of the message


_READINGS: Mapping[str, Callable[[Any], dict[str, float]]] = {_IMU: _imu, _FIELD: _field, _TEMPERATURE: _temperature}


def _tables(readings: Iterator[dict[str, float]]) -> Iterator[pl.DataFrame]:
    while piece := list(islice(readings, _ROWS)):
        names = list(piece[0])
        yield pl.DataFrame(np.array([[r[name] for name in names] for r in piece]), schema=names, orient="row")
