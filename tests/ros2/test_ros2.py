"""The package for ROS 2, without ROS: its nodes by stubs of rclpy's interface with the messages of rosbags."""

from __future__ import annotations

import importlib
import json
import socket
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import polars as pl
import pytest

import tumble
from tests.support import ROOT
from tumble.simulation.temperature_profile import temperature_profile
from tumble.units import Array

PACKAGE = ROOT / "ros2/tumble_ros"
COLUMNS = ["ax", "ay", "az", "gx", "gy", "gz"]


@pytest.fixture(scope="module")
def corrected(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, pl.DataFrame, pl.DataFrame]:
    """A calibration of an instrument with everything, over temperature, and its log before and after `apply`."""
    folder = tmp_path_factory.mktemp("ros2")
    setup = tumble.Setup.of(grade="mems", positions=16, terms="full", rest=5.0)
    session = tumble.simulate_session(folder / "s", setup, seed=4, temperature=temperature_profile("10:35"))
    calibration = tumble.calibrate(session)
    calibration.write(folder / "calibration.json")
    tumble.apply_to_session(calibration, session, folder / "corrected.parquet")
    return (
        folder / "calibration.json",
        pl.read_parquet(session / "log.parquet"),
        pl.read_parquet(folder / "corrected.parquet"),
    )


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> Iterator[SimpleNamespace]:
    """The modules of ROS as far as the nodes use them: what they publish is kept by topic, and what they listen to can
    be called by topic."""
    pytest.importorskip("rosbags")
    from rosbags.typesys import Stores, get_typestore

    types: dict[str, Any] = dict(get_typestore(Stores.ROS2_HUMBLE).types)
    zero = {
        "Time": lambda: types["builtin_interfaces/msg/Time"](sec=0, nanosec=0),
        "Vector": lambda: types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0),
    }

    def imu() -> Any:
        header = types["std_msgs/msg/Header"](stamp=zero["Time"](), frame_id="")
        return types["sensor_msgs/msg/Imu"](
            header=header,
            orientation=types["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
            orientation_covariance=np.zeros(9),
            angular_velocity=zero["Vector"](),
            angular_velocity_covariance=np.zeros(9),
            linear_acceleration=zero["Vector"](),
            linear_acceleration_covariance=np.zeros(9),
        )

    parameters: dict[str, Any] = {}
    published: dict[str, list[Any]] = {}
    heard: dict[str, Callable[[Any], None]] = {}

    class Node:
        def __init__(self, name: str) -> None:
            self.name = name

        def declare_parameter(self, name: str, default: object) -> SimpleNamespace:
            return SimpleNamespace(value=parameters.get(name, default))

        def create_publisher(self, _: object, topic: str, __: object) -> SimpleNamespace:
            return SimpleNamespace(publish=published.setdefault(topic, []).append)

        def create_subscription(self, _: object, topic: str, callback: Callable[[Any], None], __: object) -> None:
            heard[topic] = callback

        def create_timer(self, _: float, callback: Callable[[], None]) -> None:
            heard["timer"] = lambda _: callback()

        def get_clock(self) -> SimpleNamespace:
            return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: 0))

        def get_logger(self) -> SimpleNamespace:
            return SimpleNamespace(info=lambda _: None, warning=lambda _: None)

    class DiagnosticStatus(SimpleNamespace):
        OK, WARN = b"\0", b"\1"

    modules: dict[str, dict[str, Any]] = {
        "rclpy": {},
        "rclpy.node": {"Node": Node},
        "rclpy.qos": {"qos_profile_sensor_data": None},
        "sensor_msgs": {},
        "sensor_msgs.msg": {"Imu": imu, "Temperature": SimpleNamespace},
        "diagnostic_msgs": {},
        "diagnostic_msgs.msg": {
            "DiagnosticArray": lambda: SimpleNamespace(header=SimpleNamespace()),
            "DiagnosticStatus": DiagnosticStatus,
            "KeyValue": SimpleNamespace,
        },
    }
    for name, content in modules.items():
        module = ModuleType(name)
        module.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.syspath_prepend(str(PACKAGE))
    yield SimpleNamespace(parameters=parameters, published=published, heard=heard, imu=imu)
    for name in [name for name in sys.modules if name.partition(".")[0] == "tumble_ros"]:
        del sys.modules[name]


def samples(log: pl.DataFrame) -> Iterator[tuple[float, list[float], float]]:
    for row in log.select("t", *COLUMNS, "T").iter_rows():
        yield row[0], list(row[1:7]), row[7]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": 2}, "expected"),
        ({"outcome": {"accepted": False, "reasons": ["too few rests"]}}, "found: too few rests"),
        ({"gyro": None}, "expected three gyros, found none"),
    ],
)
def test_another_calibration_is_refused_in_one_line(
    change: dict[str, object],
    words: str,
    corrected: tuple[Path, pl.DataFrame, pl.DataFrame],
    ros: SimpleNamespace,
    tmp_path: Path,
) -> None:
    other = tmp_path / "other.json"
    other.write_text(json.dumps(json.loads(corrected[0].read_text()) | change))
    ros.parameters["calibration"] = str(other)
    with pytest.raises((ValueError, tumble.TumbleError), match=words) as error:
        importlib.import_module("tumble_ros.corrector").Corrector()
    assert "\n" not in str(error.value)


def messages(ros: SimpleNamespace, log: pl.DataFrame) -> Iterator[tuple[Any, float]]:
    for t, values, celsius in samples(log):
        message, stamp = ros.imu(), round(1e9 * t)
        message.header.stamp.sec, message.header.stamp.nanosec = stamp // 10**9, stamp % 10**9
        for vector, three in ((message.linear_acceleration, values[:3]), (message.angular_velocity, values[3:])):
            vector.x, vector.y, vector.z = three
        yield message, celsius


def vectors(published: list[Any]) -> Array:
    return np.array(
        [
            [getattr(m.linear_acceleration, c) for c in "xyz"] + [getattr(m.angular_velocity, c) for c in "xyz"]
            for m in published
        ]
    )


def test_the_corrector_publishes_what_apply_writes(
    corrected: tuple[Path, pl.DataFrame, pl.DataFrame], ros: SimpleNamespace
) -> None:
    file, log, true = corrected
    ros.parameters |= {"calibration": str(file), "noise_accel": 1e-4}
    node = importlib.import_module("tumble_ros.corrector").Corrector()
    for message, celsius in messages(ros, log):
        ros.heard["temperature"](SimpleNamespace(temperature=celsius))
        ros.heard["imu/data_raw"](message)
    node.finish()
    out = ros.published["imu/data_corrected"]
    np.testing.assert_allclose(vectors(out), true.select(COLUMNS).to_numpy(), rtol=1e-9, atol=1e-9)
    assert [m.header.stamp for m in out[:2]] == [m.header.stamp for m, _ in messages(ros, log.head(2))]
    u = json.loads(file.read_text())["prediction"]["force_u"]
    assert out[0].linear_acceleration_covariance[4] == pytest.approx(u**2 + 1e-4)
    assert out[0].linear_acceleration_covariance[1] == 0.0
    ros.heard["timer"](None)
    (status,) = ros.published["diagnostics"][-1].status
    assert status.message.startswith("outside of what was calibrated: 35.0 °C")  # the ramp ends after the last rest
    low, high = json.loads(file.read_text())["temperature"]["range"]
    outside = log.filter(~pl.col("T").is_between(low, high)).height
    counts = {"corrected": str(len(log)), "late": "0", "outside": str(outside)}
    assert {pair.key: pair.value for pair in status.values} == counts


def test_late_samples_are_dropped_and_a_clock_that_begins_anew_is_followed(
    corrected: tuple[Path, pl.DataFrame, pl.DataFrame], ros: SimpleNamespace
) -> None:
    file, log, _ = corrected
    ros.parameters["calibration"] = str(file)
    node = importlib.import_module("tumble_ros.corrector").Corrector()
    first, second, third, *_ = (m for m, _ in messages(ros, log.head(5)))
    for message in (first, third, second, third, first):
        node.correct(message)
    assert node.counts["late"] == 3
    for message, _ in messages(ros, log.slice(200, 2)):
        node.correct(message)
    node.correct(first)  # two seconds back
    assert node.counts["late"] == 3
    assert len(node.waiting) == 1


def test_diagnostics_name_what_is_wrong(
    corrected: tuple[Path, pl.DataFrame, pl.DataFrame], ros: SimpleNamespace
) -> None:
    file, log, _ = corrected
    module = importlib.import_module("tumble_ros.corrector")
    ros.parameters |= {"calibration": str(file), "device": "another"}
    with pytest.raises(ValueError, match="expected the device 'another'"):
        module.Corrector()
    ros.parameters |= {"device": "", "expires": "2020-01-01"}
    node = module.Corrector()
    node.diagnose()
    assert ros.published["diagnostics"][-1].status[0].message.startswith("expired on 2020-01-01")
    ros.parameters["expires"] = ""
    node = module.Corrector()
    node.diagnose()
    assert ros.published["diagnostics"][-1].status[0].message.startswith("no temperature")
    node.warmed(SimpleNamespace(temperature=90.0))
    for message, _ in messages(ros, log.head(3)):
        node.correct(message)
    node.diagnose()
    assert ros.published["diagnostics"][-1].status[0].message.startswith("outside of what was calibrated: 90.0 °C")


def test_the_recorder_sends_rows_to_a_bench(
    corrected: tuple[Path, pl.DataFrame, pl.DataFrame], ros: SimpleNamespace
) -> None:
    _, log, _ = corrected
    with socket.create_server(("localhost", 0)) as server:
        ros.parameters |= {"host": "localhost", "port": server.getsockname()[1]}
        node = importlib.import_module("tumble_ros.recorder").Recorder()
        for message, _ in messages(ros, log.head(50)):
            node.heard(message)
        node.send()
        connection, _ = server.accept()
        node.socket.close()
        with connection, connection.makefile() as lines:
            header, *rows = lines.read().splitlines()
    assert header == "t,ax,ay,az,gx,gy,gz"
    found = np.array([[float(n) for n in row.split(",")] for row in rows])
    np.testing.assert_allclose(found, log.head(50).select("t", *COLUMNS).to_numpy(), rtol=0.0, atol=1e-9)
