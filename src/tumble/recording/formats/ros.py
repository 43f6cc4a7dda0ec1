"""ROS 1 bags, ROS 2 bags and MCAP files with ROS messages: sensor_msgs/Imu, sensor_msgs/MagneticField and
sensor_msgs/Temperature.

Time is that of the header, which is when the sample was taken; where headers are empty, that of the recording.
Some drivers (depth cameras) publish accelerometers and gyros as Imu messages of two topics, with zeros in place of the
other: sensors whose first readings are all exactly zero are taken as absent.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
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
_COLUMNS: Mapping[str, tuple[str, ...]] = {
    _IMU: (*triad("accel", None).columns, *triad("gyro", None).columns),
    _FIELD: triad("field", None).columns,
    _TEMPERATURE: ("temperature",),
}
_ROWS = 1 << 15
_LOOK = 100
_MICROTESLA = 1e6  # in a tesla


def messages(path: Path) -> list[Message]:
    """Topics with inertial sensors."""
    with _opened(path) as bag:
        found = [(c.topic, c.msgtype, c.msgcount) for c in bag.connections if c.msgtype in _COLUMNS]
    filled = [(topic, kind, count) for topic, kind, count in found if count]
    origin = min((next(_stamped(path, topic))[0] for topic, _, _ in filled), default=0)
    return [_message(path, origin, topic, kind, count) for topic, kind, count in filled]


def _opened(path: Path) -> AnyReader:
    return AnyReader([path], default_typestore=get_typestore(Stores.LATEST))


def _message(path: Path, origin: int, topic: str, kind: str, count: int) -> Message:
    columns = _COLUMNS[kind]
    if kind == _TEMPERATURE:  # called by the sensors, where the name of the topic says whose it is
        whose, _ = thermometer(re.findall("[a-z]+", topic.lower())) or ("", "")
        columns = (f"{whose}_temperature",) if whose else columns
    rows = partial(_rows, path, origin, topic, columns)
    look = next(_tables(islice(_readings(path, origin, topic), _LOOK), columns))
    read = [bool(look.select(columns[at : at + 3]).to_numpy().any()) for at in (0, 3)]
    imu = kind == _IMU
    return Message(
        name=topic,
        count=count,
        accel=triad("accel", "m/s^2") if imu and read[0] else None,
        gyro=triad("gyro", "rad/s") if imu and read[1] else None,
        magnetometer=triad("field", "uT") if kind == _FIELD else None,
        temperatures=columns if kind == _TEMPERATURE else (),
        rows=rows,
    )


def _rows(path: Path, origin: int, topic: str, columns: Sequence[str]) -> Iterator[pl.DataFrame]:
    return _tables(_readings(path, origin, topic), columns)


def _tables(readings: Iterator[list[float]], columns: Sequence[str]) -> Iterator[pl.DataFrame]:
    while piece := list(islice(readings, _ROWS)):
        yield pl.DataFrame(np.array(piece), schema=[TIME, *columns], orient="row")


def _readings(path: Path, origin: int, topic: str) -> Iterator[list[float]]:
    """Every message of a topic as time (s after `origin`, ns) and its readings."""
    for stamp, kind, message in _stamped(path, topic):
        if kind == _TEMPERATURE:
            readings = [message.temperature]  # °C by the definition of the message
        elif kind == _FIELD:
            readings = [getattr(message.magnetic_field, axis) * _MICROTESLA for axis in AXES]
        else:
            vectors = (message.linear_acceleration, message.angular_velocity)
            readings = [getattr(vector, axis) for vector in vectors for axis in AXES]
        yield [(stamp - origin) * 1e-9, *readings]


def _stamped(path: Path, topic: str) -> Iterator[tuple[int, str, Any]]:
    """Every message of a topic with its time, ns, and its type."""
    with _opened(path) as bag:
        wanted = [c for c in bag.connections if c.topic == topic and c.msgtype in _COLUMNS]
        for connection, recorded, raw in bag.messages(connections=wanted):
            message: Any = bag.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp
            yield stamp.sec * 10**9 + stamp.nanosec or recorded, connection.msgtype, message
