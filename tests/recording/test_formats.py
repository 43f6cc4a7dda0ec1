"""Recordings of other programs: each format is written by another library or by hand from its published layout, and
must come back as the same numbers."""

from __future__ import annotations

import math
import os
import re
import sqlite3
import struct
import subprocess
import sys
import warnings
from collections.abc import Callable
from contextlib import closing, suppress
from itertools import count
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import polars as pl
import pytest
from mcap_ros2.writer import Writer as McapWriter
from pyulog import ULog
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

from tumble.drafting.new_session import new_session
from tumble.errors import InputError
from tumble.recording.formats import Message, is_recording, messages, write_log
from tumble.recording.panic import COMMAND_LINE
from tumble.units import Array

RATE = 100
START = 1_700_000_000_000_000_000  # ns
NAMES = ["accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z"]


@pytest.fixture(scope="module")
def record() -> Array:
    """300 samples of accelerometers and gyros, with no two numbers alike."""
    return np.random.default_rng(1).normal(size=(300, 6))


def stamps(count: int) -> list[int]:
    return [START + i * 10**9 // RATE for i in range(count)]


# -------------------- writers --------------------

IMU_DEFINITION = """std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
"""


def vector(values: Array) -> dict[str, float]:
    return dict(zip("xyz", map(float, values), strict=True))


def write_mcap(path: Path, record: Array) -> None:
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        schema = writer.register_msgdef("sensor_msgs/msg/Imu", IMU_DEFINITION)
        for stamp, row in zip(stamps(len(record)), record, strict=True):
            message = {
                "header": {"stamp": {"sec": stamp // 10**9, "nanosec": stamp % 10**9}, "frame_id": "imu"},
                "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
                "orientation_covariance": [0.0] * 9,
                "angular_velocity": vector(row[3:]),
                "angular_velocity_covariance": [0.0] * 9,
                "linear_acceleration": vector(row[:3]),
                "linear_acceleration_covariance": [0.0] * 9,
            }
            writer.write_message("/imu", schema, message, log_time=stamp, publish_time=stamp)
        writer.finish()  # type: ignore[no-untyped-call]


def imu_message(store: object, row: Array, stamp: int, *, ros1: bool) -> object:
    types = store.types  # type: ignore[attr-defined]
    time = types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
    extra = {"seq": 0} if ros1 else {}
    three, no = types["geometry_msgs/msg/Vector3"], np.zeros(9)
    return types["sensor_msgs/msg/Imu"](
        header=types["std_msgs/msg/Header"](stamp=time, frame_id="imu", **extra),
        orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=no,
        angular_velocity=three(**vector(row[3:])),
        angular_velocity_covariance=no,
        linear_acceleration=three(**vector(row[:3])),
        linear_acceleration_covariance=no,
    )


def write_bag1(path: Path, record: Array) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    with Bag1Writer(path) as bag:
        topic = bag.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=store)
        for stamp, row in zip(stamps(len(record)), record, strict=True):
            message = imu_message(store, row, stamp, ros1=True)
            bag.write(topic, stamp + 1234, store.serialize_ros1(message, "sensor_msgs/msg/Imu"))


def write_bag2(path: Path, record: Array, topics: dict[str, Array] | None = None) -> None:
    store = get_typestore(Stores.ROS2_JAZZY)
    with Bag2Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as bag:
        for name, rows in (topics or {"/imu": record}).items():
            topic = bag.add_connection(name, "sensor_msgs/msg/Imu", typestore=store)
            for stamp, row in zip(stamps(len(rows)), rows, strict=True):
                message = imu_message(store, row, stamp, ros1=False)
                bag.write(topic, stamp, store.serialize_cdr(message, "sensor_msgs/msg/Imu"))


def ulog_message(kind: str, content: bytes) -> bytes:
    return struct.pack("<HB", len(content), ord(kind)) + content


def write_ulog(
    path: Path, record: Array, warmth: tuple[float, float] = (25.0, 26.0), *, every: int = 1, combined: bool = False
) -> None:
    """By the published layout of ULog: header, flags, formats, subscriptions, data; a barometer at 31 °C. Raw messages
    of `every` so many samples, and with `combined` the message that PX4 makes of them of all."""
    layout = "uint64_t timestamp;uint64_t timestamp_sample;float x;float y;float z;float temperature;"
    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 10)
    out += ulog_message("B", bytes(40))
    out += ulog_message("F", f"sensor_accel:{layout}".encode()) + ulog_message("F", f"sensor_gyro:{layout}".encode())
    out += ulog_message("F", b"sensor_baro:uint64_t timestamp;float pressure;float temperature;")
    fields = "uint64_t timestamp;float[3] gyro_rad;float[3] accelerometer_m_s2;"
    out += ulog_message("F", f"sensor_combined:{fields}".encode())
    out += ulog_message("A", struct.pack("<BH", 0, 2) + b"sensor_baro")
    out += ulog_message("A", struct.pack("<BH", 0, 0) + b"sensor_accel")
    out += ulog_message("A", struct.pack("<BH", 0, 1) + b"sensor_gyro")
    if combined:
        out += ulog_message("A", struct.pack("<BH", 0, 3) + b"sensor_combined")
    for i, row in enumerate(record):
        taken = 5_000_000 + i * 10**6 // RATE
        if i % every == 0:
            out += ulog_message("D", struct.pack("<HQQ4f", 0, taken + 300, taken, *row[:3], warmth[0]))
            out += ulog_message("D", struct.pack("<HQQ4f", 1, taken + 400, taken, *row[3:], warmth[1]))
        if combined:
            out += ulog_message("D", struct.pack("<HQ6f", 3, taken, *row[3:], *row[:3]))
        out += ulog_message("D", struct.pack("<HQ2f", 2, taken, 101325.0, 31.0))
    path.write_bytes(out)


def write_bin(
    path: Path, record: Array, celsius: tuple[float, float] | None = None, *, names: tuple[str, ...] = ("IMU", "IMU")
) -> None:
    """By the published layout of ArduPilot logs: FMT messages, then data, each after the two bytes A3 95. The instance
    is in a field, or before 4.1 in the name."""

    def kind_of(number: int, name: str, types: str, columns: str) -> bytes:
        length = 3 + struct.calcsize("<" + types.replace("Q", "q"))
        return b"\xa3\x95\x80" + struct.pack(
            "<BB4s16s64s", number, length, name.encode(), types.encode(), columns.encode()
        )

    out = b"\xa3\x95\x80" + struct.pack("<BB4s16s64s", 0x80, 89, b"FMT", b"BBnNZ", b"Type,Length,Name,Format,Columns")
    more, counted = "" if celsius is None else ",T", names[0] == names[1]
    for k, name in enumerate(dict.fromkeys(names)):
        types, fields = ("QBffffff", "TimeUS,I,") if counted else ("Qffffff", "TimeUS,")
        out += kind_of(7 + k, name, types + "f" * len(more[1:]), f"{fields}GyrX,GyrY,GyrZ,AccX,AccY,AccZ{more}")
    for i, row in enumerate(record):
        for instance in (0, 1):
            shown = row + instance
            out += b"\xa3\x95" + bytes([7 if counted else 7 + instance]) + struct.pack("<Q", 10**6 + i * 10**6 // RATE)
            out += bytes([instance] if counted else []) + struct.pack("<6f", *shown[3:], *shown[:3])
            out += b"" if celsius is None else struct.pack("<f", celsius[instance])
    path.write_bytes(out)


def write_mat(path: Path, record: Array) -> None:
    time = np.arange(len(record)) / RATE
    savemat(path, {"imu": {"time": time, "acc": record[:, :3], "gyro": record[:, 3:].T}, "note": "as recorded"})


def write_hdf5(path: Path, record: Array) -> None:
    with h5py.File(path, "w") as file:
        file["imu/timestamp_us"] = np.arange(len(record)) * (10**6 // RATE)
        file["imu/accel"] = record[:, :3]
        for j, name in enumerate(("gyr_x", "gyr_y", "gyr_z")):
            file[f"imu/{name}"] = record[:, 3 + j]


Writer = Callable[[Path, Array], None]
WRITERS: dict[str, Writer] = {
    "r.mcap": write_mcap,
    "r.bag": write_bag1,
    "ros2": write_bag2,
    "r.ulg": write_ulog,
    "r.bin": write_bin,
    "r.mat": write_mat,
    "r.h5": write_hdf5,
}
SINGLE = ("r.ulg", "r.bin")  # float32


def sensors(found: list[Message]) -> tuple[Message, Message]:
    accel = next(m for m in found if m.accel)
    return accel, accel if accel.gyro else next(m for m in found if m.gyro)


def test_numbers_of_more_bits_than_others_hold_are_lost(record: Array, tmp_path: Path) -> None:
    wide: Any = record.astype(np.longdouble)
    wide[7, 1] = np.longdouble(10.0) ** 400
    write_hdf5(tmp_path / "r.h5", wide)
    accel, _ = sensors(messages(tmp_path / "r.h5"))
    write_log(tmp_path / "log.parquet", accel, accel)
    lost = ~np.isfinite(pl.read_parquet(tmp_path / "log.parquet").select(pl.selectors.float()).to_numpy())
    assert lost.sum() == lost[7].sum() > 0


def test_structures_that_are_not_alike_are_left_aside(record: Array, tmp_path: Path) -> None:
    runs = np.zeros((1, 3), dtype=[("t", object), ("name", object)])
    for i in range(3):
        runs[0, i]["t"], runs[0, i]["name"] = np.arange(5.0 + i), "a" * i
    savemat(tmp_path / "r.mat", {"acc": record[:, :3], "gyro": record[:, 3:], "runs": runs})
    accel, gyro = sensors(messages(tmp_path / "r.mat"))
    assert accel is gyro


def test_an_array_without_sensors_is_called_so(tmp_path: Path) -> None:
    np.save(tmp_path / "imu.npy", np.random.default_rng(1).normal(scale=50.0, size=(310, 6)))
    with pytest.raises(InputError, match="expected messages with accelerometers, found no arrays named as"):
        messages(tmp_path / "imu.npy")


@pytest.mark.parametrize("name", WRITERS)
def test_a_recording_comes_back_as_it_was_written(name: str, record: Array, tmp_path: Path) -> None:
    WRITERS[name](tmp_path / name, record)
    accel, gyro = sensors(messages(tmp_path / name))
    write_log(tmp_path / "log.parquet", accel, gyro)
    table = pl.read_parquet(tmp_path / "log.parquet")
    assert accel.accel is not None
    assert gyro.gyro is not None
    read = table.select(*accel.accel.columns, *gyro.gyro.columns).to_numpy()
    np.testing.assert_allclose(read, record, rtol=1e-6 if name in SINGLE else 0.0, atol=0.0)
    np.testing.assert_allclose(table["t"].to_numpy(), np.arange(len(record)) / RATE, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("name", ["r.mcap", "r.bag", "ros2", "r.ulg", "r.bin"])
def test_formats_that_define_their_units_say_them(name: str, record: Array, tmp_path: Path) -> None:
    WRITERS[name](tmp_path / name, record)
    accel, gyro = sensors(messages(tmp_path / name))
    assert (accel.accel and accel.accel.unit, gyro.gyro and gyro.gyro.unit) == ("m/s^2", "rad/s")


def test_sensors_of_two_topics_become_one_log_at_the_times_of_the_gyros(record: Array, tmp_path: Path) -> None:
    force, rate = record.copy(), record.copy()
    force[:, :3] = np.arange(len(record))[:, None] * [1.0, 2.0, 3.0]  # linear in time: interpolation is exact
    force[:, 3:], rate[:, :3] = 0.0, 0.0
    write_bag2(tmp_path / "two", record, {"/accel/sample": force, "/gyro/sample": rate[5:-5]})
    accel, gyro = messages(tmp_path / "two")
    assert [(m.name, bool(m.accel), bool(m.gyro)) for m in (accel, gyro)] == [
        ("/accel/sample", True, False),
        ("/gyro/sample", False, True),
    ]
    write_log(tmp_path / "log.parquet", accel, gyro)
    table = pl.read_parquet(tmp_path / "log.parquet")
    assert table.height == len(record) - 10
    np.testing.assert_allclose(table["accel_z"].to_numpy(), 3.0 * RATE * table["t"].to_numpy(), rtol=1e-12, atol=1e-9)
    np.testing.assert_array_equal(table["gyro_x"].to_numpy(), rate[5:-5, 3])


def test_every_instance_of_a_flight_log_is_offered_with_what_its_autopilot_did(record: Array, tmp_path: Path) -> None:
    write_bin(tmp_path / "r.bin", record)
    first, second = messages(tmp_path / "r.bin")
    assert (first.name, second.name) == ("IMU.0", "IMU.1")
    assert "INS_ACCOFFS" in first.doubt
    read = pl.concat(second.rows()).select("gyro_y").to_numpy()[:, 0]
    np.testing.assert_allclose(read, record[:, 4] + 1.0, rtol=1e-6, atol=1e-6)


def write_dataflash(path: Path, parameters: dict[str, float], force: Array, rate: Array) -> None:
    """A text log of ArduPilot with parameters and one IMU."""
    lines = [
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
        "FMT, 69, 60, IMU, QBffffff, TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ",
        "FMT, 70, 31, PARM, QNf, TimeUS,Name,Value",
        *(f"PARM, 950000, {name}, {value:.9g}" for name, value in parameters.items()),
    ]
    for i, values in enumerate(np.hstack([rate, force])):
        lines.append(f"IMU, {10**6 + 10**4 * i}, 0, {', '.join(f'{v:.9g}' for v in values)}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


@pytest.mark.parametrize(
    ("orientation", "R"),
    [
        (0, [[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        (2, [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),  # yaw 90: (x, y, z) becomes (-y, x, z)
        (10, [[0, 1, 0], [1, 0, 0], [0, 0, -1]]),  # roll 180, yaw 90: (y, x, -z)
        (28, [[0, 1, 0], [0, 0, -1], [-1, 0, 0]]),  # roll 90, pitch 90: (x, -z, y), then (z, y, -x) of it
    ],
)
def test_what_an_ardupilot_has_applied_and_states_is_undone(
    orientation: int, R: list[list[int]], tmp_path: Path
) -> None:
    """AP_InertialSensor_Backend::_rotate_and_correct_accel and Vector3::rotate, forwards."""
    rng = np.random.default_rng(3)
    force, rate = rng.normal(0.0, 9.8, (60, 3)), rng.normal(0.0, 1.0, (60, 3))
    offset, scale, bias = np.array([0.1, -0.05, 0.2]), np.array([1.002, 0.999, 1.004]), np.array([0.01, 0.0, -0.02])
    stated = {f"INS_{name}_{axis}": v for name, values in (("ACCOFFS", offset), ("ACCSCAL", scale), ("GYROFFS", bias))
              for axis, v in zip("XYZ", values.tolist(), strict=True)}  # fmt: skip
    turned = np.array(R)
    logged = ((force - offset) * scale) @ turned.T, (rate - bias) @ turned.T
    write_dataflash(tmp_path / "1.log", stated | {"AHRS_ORIENTATION": orientation}, *logged)
    (message,) = messages(tmp_path / "1.log")
    read = pl.concat(message.rows())
    np.testing.assert_allclose(read.select("accel_x", "accel_y", "accel_z").to_numpy(), force, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(read.select("gyro_x", "gyro_y", "gyro_z").to_numpy(), rate, rtol=0.0, atol=1e-7)
    assert message.remark.startswith("ArduPilot's corrections are undone: INS_ACCOFFS 0.1 -0.05 0.2")
    assert ("AHRS_ORIENTATION" in message.remark) == (orientation != 0)
    assert message.doubt == ""


def test_parameters_of_an_ardupilot_that_change_nothing_are_not_said(tmp_path: Path) -> None:
    names = [f"INS_{name}_{axis}" for name in ("ACCOFFS", "ACCSCAL", "GYROFFS") for axis in "XYZ"]
    stated = {name: float("SCAL" in name) for name in names}
    write_dataflash(tmp_path / "1.log", stated, np.ones((60, 3)), np.ones((60, 3)))
    (message,) = messages(tmp_path / "1.log")
    assert (message.remark, message.doubt) == ("", "")
    write_dataflash(tmp_path / "2.log", stated | {"INS_TCAL1_ENABLE": 1}, np.ones((60, 3)), np.ones((60, 3)))
    assert "INS_TCAL1_ENABLE" in messages(tmp_path / "2.log")[0].doubt
    write_dataflash(tmp_path / "3.log", stated | {"AHRS_ORIENTATION": 101}, np.ones((60, 3)), np.ones((60, 3)))
    assert "an export is wrong unless" in messages(tmp_path / "3.log")[0].doubt


def temperature_of(path: Path) -> tuple[str | None, Array]:
    """The columns of the thermometers that `tumble new` finds in a recording, and what they read."""
    draft, _ = new_session(path.parent / f"{path.name}-session", path)
    keys = draft.content["log"].get("temperature")
    if keys is None:
        return None, np.empty(0)
    assert keys["unit"] == "degC"
    log = pl.read_parquet(path.parent / f"{path.name}-session" / "log.parquet")
    celsius = np.squeeze(log.select(keys["columns"]).to_numpy())
    return " ".join(keys["columns"]), celsius


@pytest.fixture(scope="module")
def at_rest() -> Array:
    """Half a minute at rest."""
    rows = np.zeros((3000, 6))
    rows[:, 2] = 9.81
    return rows + 1e-3 * np.random.default_rng(2).normal(size=rows.shape)


def test_px4_has_the_thermometers_of_the_accelerometers_and_of_the_gyros(at_rest: Array, tmp_path: Path) -> None:
    for warmth, name, celsius in (
        ((25.0, 26.0), "accel_temperature gyro_temperature", (25.0, 26.0)),
        ((math.nan, 26.0), "gyro_temperature", 26.0),
        ((math.nan, math.nan), None, ()),
    ):
        path = tmp_path / f"{name}.ulg"
        write_ulog(path, at_rest, warmth)
        found, temperatures = temperature_of(path)
        assert found == name
        np.testing.assert_array_equal(temperatures, np.broadcast_to(celsius, temperatures.shape))


def test_ardupilot_before_4_1_has_the_instance_in_the_name(record: Array, tmp_path: Path) -> None:
    read = {}
    for file, names in (("new.bin", ("IMU", "IMU")), ("old.bin", ("IMU", "IMU2"))):
        write_bin(tmp_path / file, record, names=names)
        read[file] = messages(tmp_path / file)
    assert [m.name for m in read["old.bin"]] == [m.name for m in read["new.bin"]] == ["IMU.0", "IMU.1"]
    for old, new in zip(read["old.bin"], read["new.bin"], strict=True):
        assert next(old.rows()).equals(next(new.rows()))
        assert (old.triads, old.imu) == (new.triads, new.imu)


def test_an_error_of_the_program_is_not_called_damage(
    record: Array, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_bin(tmp_path / "r.bin", record)
    monkeypatch.setattr("tumble.recording.formats.ardupilot.triads_of", lambda *_: record.no_such_name)  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match="no_such_name"):
        messages(tmp_path / "r.bin")


def test_ardupilot_has_the_thermometer_of_the_imu_unless_it_reads_zero(at_rest: Array, tmp_path: Path) -> None:
    write_bin(tmp_path / "warm.bin", at_rest, (41.5, 0.0))
    name, temperatures = temperature_of(tmp_path / "warm.bin")
    assert name == "temperature"
    np.testing.assert_array_equal(temperatures, 41.5)
    first, second = messages(tmp_path / "warm.bin")
    assert (first.temperatures, second.temperatures) == (("temperature",), ())


@pytest.mark.parametrize("name", WRITERS)
def test_a_damaged_recording_is_refused_in_one_line(name: str, record: Array, tmp_path: Path) -> None:
    path = tmp_path / name
    WRITERS[name](path, record)
    if path.is_dir():
        (path / "metadata.yaml").write_text("rosbag2_bagfile_information: 3\n")
    else:
        path.write_bytes(b"\x07" * 100)
    with pytest.raises(InputError) as refused:
        messages(path)
    assert str(path) in str(refused.value)
    assert "\n" not in str(refused.value)


def test_what_python_says_of_a_damaged_recording_stays_away(record: Array, tmp_path: Path) -> None:
    write_bag2(tmp_path / "bag", record)
    metadata = tmp_path / "bag" / "metadata.yaml"
    text = metadata.read_text()
    assert re.search(r"\n  version: \d", text)
    metadata.write_text(re.sub(r"\n  version: \d", "\n  version:", text))
    with pytest.raises(InputError, match="found it damaged or incomplete: Invalid bag metadata: TypeError"):
        messages(tmp_path / "bag")


def test_what_a_library_prints_of_a_damaged_recording_stays_away(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "r.bin").write_bytes(b"abc" * 1000)
    token = COMMAND_LINE.set(True)
    try:
        with pytest.raises(InputError):
            messages(tmp_path / "r.bin")
    finally:
        COMMAND_LINE.reset(token)
    said = capfd.readouterr()
    assert said.out == said.err == ""


def test_a_recording_without_inertial_sensors_is_refused(tmp_path: Path) -> None:
    savemat(tmp_path / "r.mat", {"depth": np.arange(50.0)})
    with pytest.raises(InputError, match="expected messages with accelerometers, found no arrays named"):
        messages(tmp_path / "r.mat")
    with pytest.raises(InputError, match="expected a recording that ends in"):
        messages(tmp_path / "r.xyz")
    with pytest.raises(InputError, match="found no such file"):
        messages(tmp_path / "none.mat")


@pytest.mark.parametrize(
    ("module", "name"), [("rosbags", "r.mcap"), ("pyulog", "r.ulg"), ("pymavlink", "r.bin"), ("h5py", "r.h5")]
)
def test_a_missing_extra_is_named(module: str, name: str, record: Array, tmp_path: Path) -> None:
    WRITERS[name](tmp_path / name, record)
    code = f"import sys; sys.modules[{module!r}] = None\nfrom pathlib import Path\n"
    code += "from tumble.recording.formats import messages\n"
    code += f"from tumble.errors import MissingExtraError\ntry: messages(Path({str(tmp_path / name)!r}))\n"
    code += "except MissingExtraError as error: print(error)"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert f"needs {module}; install it with: pip install 'tumble[formats]'" in said


def test_a_binary_file_of_another_logger_is_no_damaged_flight_log(tmp_path: Path) -> None:
    (tmp_path / "pod.bin").write_bytes(np.random.default_rng(3).integers(0, 160, size=20_000, dtype=np.uint8).tobytes())
    with pytest.raises(InputError, match=r"pod.bin: expected a log of ArduPilot, .*; export its readings as CSV"):
        messages(tmp_path / "pod.bin")


def test_an_array_of_four_is_a_time_and_three_sensors(tmp_path: Path) -> None:
    t = np.arange(500) * 0.01
    noise = np.random.default_rng(1).normal(size=(500, 3))
    savemat(tmp_path / "accelerometer.mat", {"accelBuffer": np.column_stack([t, noise + 9.8 * np.eye(3)[2]]).T})
    savemat(tmp_path / "gyroscope.mat", {"gyroBuffer": np.column_stack([0.1 * noise, t])})
    (accel,) = messages(tmp_path / "accelerometer.mat")
    assert accel.timed
    assert accel.accel is not None
    rows = next(accel.rows())
    np.testing.assert_array_equal(rows["t"], t)
    np.testing.assert_array_equal(rows[accel.accel.columns[2]], noise[:, 2] + 9.8)
    with pytest.raises(InputError, match="found gyros alone"):
        messages(tmp_path / "gyroscope.mat")
    both = messages(tmp_path / "accelerometer.mat", tmp_path / "gyroscope.mat")
    write_log(tmp_path / "log.parquet", both[0], both[1])
    assert pl.read_parquet(tmp_path / "log.parquet").columns == ["t", *both[1].columns, *both[0].columns]


def test_named_arrays_come_before_those_told_by_their_numbers(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    up = np.repeat(np.vstack([np.eye(3), -np.eye(3)]), 100, axis=0)
    read = np.column_stack([9.8 * up + rng.normal(scale=0.01, size=(600, 3)), rng.normal(scale=0.01, size=(600, 3))])
    savemat(tmp_path / "r.mat", {"s_read": read, "SENSacc": read[:500, :3], "SENSgyro": read[:500, 3:]})
    named, guessed = messages(tmp_path / "r.mat")
    assert (named.count, guessed.count) == (500, 600)
    assert named.accel is not None
    assert named.accel.columns == ("SENSacc[0]", "SENSacc[1]", "SENSacc[2]")


def test_text_with_the_ending_of_matlab_is_no_recording(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "imu.mat", np.arange(40.0).reshape(10, 4), fmt="%16.7e")
    assert not is_recording(tmp_path / "imu.mat")
    savemat(tmp_path / "imu.mat", {"acc": np.zeros((10, 3))})
    assert is_recording(tmp_path / "imu.mat")


@pytest.mark.skipif(sys.platform == "win32", reason="no such files")
def test_a_pipe_in_the_folder_of_a_bag_is_refused_and_not_waited_for(record: Array, tmp_path: Path) -> None:
    write_bag2(tmp_path / "bag", record)
    (data,) = (tmp_path / "bag").glob("*.db3")
    data.unlink()
    os.mkfifo(data)
    with pytest.raises(InputError, match="expected a file, found a device or a pipe"):
        messages(tmp_path / "bag")


def test_times_that_are_said_to_be_floating_point_numbers_give_no_warning(record: Array, tmp_path: Path) -> None:
    """As of a flight log whose layout is damaged."""
    path = tmp_path / "r.ulg"
    write_ulog(path, record)
    path.write_bytes(
        path.read_bytes().replace(b"uint64_t timestamp_sample;float x", b"double   timestamp_sample;float x")
    )
    with suppress(InputError):
        new_session(tmp_path / "s", path)


def test_a_flight_log_that_is_cut_in_a_damaged_message_is_not_read_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, headers, read = tmp_path / "r.ulg", count(), ULog._unpack_ushort_byte
    often = "the same message is read again and again"
    monkeypatch.setattr(ULog, "_unpack_ushort_byte", lambda d: read(d) if next(headers) < 999 else pytest.fail(often))
    path.write_bytes(b"ULog\x01\x12\x35\x01" + struct.pack("<QHB", 10, 20000, 0) + bytes(100))
    with pytest.raises(InputError, match="no messages sensor_accel or sensor_combined"):
        new_session(tmp_path / "s", path)


@pytest.mark.parametrize("damage", ["data = x'0001'", "data = 5"])
def test_a_bag_whose_rows_are_damaged_is_refused_in_one_line(damage: str, record: Array, tmp_path: Path) -> None:
    """The first rows, by which it is found out what it holds, are sound."""
    write_bag2(tmp_path / "bag", record)
    with closing(sqlite3.connect(next((tmp_path / "bag").glob("*.db3")), isolation_level=None)) as bag:
        bag.execute(f"UPDATE messages SET {damage} WHERE id > 250")
    with pytest.raises(InputError, match="expected an intact recording, found it damaged or incomplete") as refused:
        new_session(tmp_path / "session", tmp_path / "bag")
    assert "\n" not in str(refused.value)
    assert not (tmp_path / "session").exists()


def test_accelerometers_that_read_zeros_are_refused(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(
        "\n".join(["t,ax,ay,az,gx,gy,gz", *(f"{k / 100},0,0,0,0.1,0.2,{k % 7}" for k in range(400))]), encoding="utf-8"
    )
    with pytest.raises(InputError, match="ax, ay, az: expected readings, found none in the first"):
        new_session(tmp_path / "session", tmp_path / "log.csv")


def test_an_empty_column_of_accelerometers_gives_no_warning(tmp_path: Path) -> None:
    rows = ["t,ax,ay,az", *(f"{k / 100},{0.01 * (k % 7)},,9.8{k % 5}" for k in range(400))]
    (tmp_path / "log.csv").write_text("\n".join(rows), encoding="utf-8")
    with warnings.catch_warnings(), suppress(InputError):
        warnings.simplefilter("error")
        new_session(tmp_path / "session", tmp_path / "log.csv")


@pytest.mark.parametrize(("every", "taken"), [(1, "sensor_accel.0"), (50, "sensor_combined.0")])
def test_raw_messages_of_px4_are_taken_where_they_are_all_there(
    every: int, taken: str, at_rest: Array, tmp_path: Path
) -> None:
    """By default PX4 logs them once a second."""
    write_ulog(tmp_path / "r.ulg", at_rest, every=every, combined=True)
    draft, _ = new_session(tmp_path / "s", tmp_path / "r.ulg")
    assert any(taken in line for line in draft.remarks)
    assert any("in s (by its name)" in line for line in draft.remarks)
    assert draft.rate == pytest.approx(RATE, rel=1e-3)


def test_arrays_of_a_magnetometer_alone_are_named_with_the_next_step(tmp_path: Path) -> None:
    field = np.random.default_rng(1).normal(size=(500, 3))
    np.savez(tmp_path / "field.npz", t=0.01 * np.arange(500), mag=field)
    with pytest.raises(InputError, match="found a magnetometer alone; record the accelerometers with it"):
        messages(tmp_path / "field.npz")
