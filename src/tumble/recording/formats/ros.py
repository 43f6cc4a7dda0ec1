"""ROS 1 bags, ROS 2 bags and MCAP files with ROS messages: sensor_msgs/Imu and sensor_msgs/MagneticField.

The time is that of the header, when the sample was taken, or that of the recording if headers are empty. Some drivers
(depth cameras) publish accelerometers and gyros as Imu messages of two topics, with zeros in place of the other:
sensors whose first readings are all exactly zero are absent.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from itertools import islice
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from tumble.documents import check_regular
from tumble.recording.formats import AXES, MESSAGES, TIME, Message, triads_of
from tumble.recording.text.pieces import check_unpacked

NOTHING = "no topic of type sensor_msgs/Imu"

_IMU = "sensor_msgs/msg/Imu"
_FIELDS, _UNITS = MESSAGES["ros"]["messages"], MESSAGES["ros"]["units"]
_FACTORS = {"field": 1e6}  # from the unit of a field to that of its columns
_ROWS = 1 << 15
_FIRST_ROWS = 100
_MCAP, _MCAP_CHUNK, _BAG = b"\x89MCAP0\r\n", 6, b"#ROSBAG V2.0\n"


def messages(path: Path) -> list[Message]:
    """Return the topics with inertial sensors."""
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        check_regular(file)
        check_unpacked(file, _bytes_of_chunks(file))
    with _opened(path) as bag:
        filled = [(c.topic, c.msgtype, c.msgcount) for c in bag.connections if c.msgtype in _FIELDS and c.msgcount]
    origin = min((next(_stamped(path, topic))[0] for topic, _, _ in filled), default=0)
    return [_message(path, origin, topic, kind, count) for topic, kind, count in filled]


def _opened(path: Path) -> AnyReader:
    return AnyReader([path], default_typestore=get_typestore(Stores.LATEST))


def _bytes_of_chunks(path: Path) -> int:
    """Return the stated unpacked size of the chunks of an MCAP file or a ROS 1 bag, bytes; 0 for another file."""
    unpacked = 0
    with path.open("rb") as stream:
        if stream.read(len(_MCAP)) == _MCAP:
            while len(record := stream.read(9)) == 9:
                kind, size = struct.unpack("<BQ", record)
                begin = stream.tell()
                unpacked += int.from_bytes(stream.read(24)[16:], "little") if kind == _MCAP_CHUNK else 0
                stream.seek(begin + size)
            return unpacked
        stream.seek(0)
        if stream.read(len(_BAG)) == _BAG:
            while size := stream.read(4):
                header = stream.read(int.from_bytes(size, "little"))
                stated = header.find(b"size=") + 5 if b"op=\x05" in header else len(header)
                unpacked += int.from_bytes(header[stated : stated + 4], "little")
                stream.seek(int.from_bytes(stream.read(4), "little"), 1)
    return unpacked


def _message(path: Path, origin: int, topic: str, kind: str, count: int) -> Message:
    columns = tuple(_FIELDS[kind])
    head = next(_tables(islice(_readings(path, origin, topic), _FIRST_ROWS), columns))
    present = [n for n in columns if kind != _IMU or head.select(f"{n[:-1]}{a}" for a in AXES).to_numpy().any()]
    return Message(
        name=topic,
        count=count,
        triads=triads_of(present, _UNITS),
        rows=lambda: _tables(_readings(path, origin, topic), columns),
    )


def _tables(readings: Iterator[list[float]], columns: Sequence[str]) -> Iterator[pl.DataFrame]:
    while piece := list(islice(readings, _ROWS)):
        yield pl.DataFrame(np.array(piece), schema=[TIME, *columns], orient="row")


def _readings(path: Path, origin: int, topic: str) -> Iterator[list[float]]:
    """Yield the messages of a topic as the time after `origin` (ns), s, and the readings."""
    getters = {
        kind: [(attrgetter(field), _FACTORS.get(column[:-2], 1.0)) for column, field in columns.items()]
        for kind, columns in _FIELDS.items()
    }
    for stamp, kind, message in _stamped(path, topic):
        yield [(stamp - origin) * 1e-9, *(get(message) * factor for get, factor in getters[kind])]


def _stamped(path: Path, topic: str) -> Iterator[tuple[int, str, Any]]:
    """Yield the messages of a topic with their times, ns, and types."""
    with _opened(path) as bag:
        wanted = [c for c in bag.connections if c.topic == topic and c.msgtype in _FIELDS]
        for connection, recorded, raw in bag.messages(connections=wanted):
            message: Any = bag.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp
            yield stamp.sec * 10**9 + stamp.nanosec or recorded, connection.msgtype, message
