"""The packages for ROS 2, without ROS: samples as `apply` corrects them, the nodes by stubs of rclpy's interface with
the messages of rosbags, the C++ component compiled against stubs of rclcpp."""

from __future__ import annotations

import importlib
import json
import shutil
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, Literal

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


def test_the_correction_gives_the_numbers_of_apply(
    corrected: tuple[Path, pl.DataFrame, pl.DataFrame], monkeypatch: pytest.MonkeyPatch
) -> None:
    file, log, true = corrected
    monkeypatch.syspath_prepend(str(PACKAGE))
    correction = importlib.import_module("tumble_ros.correction")
    of = correction.read(file)
    assert of.delay == 1
    assert of.warm
    out = [of.add(correction.Sample(t, tuple(v[:3]), tuple(v[3:]), T)) for t, v, T in samples(log)]
    rows = [s for s in (*out, of.finish()) if s is not None]
    found = np.array([[s.time, *s.force, *s.rate] for s in rows])
    expected = true.select("t", *COLUMNS).to_numpy()
    assert found.shape == expected.shape
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_the_correction_needs_the_library_of_python_alone() -> None:
    words = "import sys; sys.path[:0] = ['.']; import tumble_ros.correction; sys.exit('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-S", "-c", words], cwd=PACKAGE, check=False, env={"PATH": "/usr/bin:/bin"})
    assert done.returncode == 0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"format": 2}, "expected a calibration file of tumble, format 1"),
        (
            {"outcome": {"accepted": False, "reasons": ["too few rests"]}},
            "expected an accepted calibration, found: too few rests",
        ),
        ({"gyro": None}, "expected three accelerometers and three gyros"),
    ],
)
def test_another_calibration_is_refused_in_one_line(
    change: dict[str, object],
    words: str,
    corrected: tuple[Path, pl.DataFrame, pl.DataFrame],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(PACKAGE))
    correction = importlib.import_module("tumble_ros.correction")
    other = tmp_path / "other.json"
    other.write_text(json.dumps(json.loads(corrected[0].read_text()) | change))
    with pytest.raises(ValueError, match=words) as error:
        correction.read(other)
    assert "\n" not in str(error.value)


def test_a_parameter_that_is_not_known_is_refused(
    corrected: tuple[Path, pl.DataFrame, pl.DataFrame], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(PACKAGE))
    correction = importlib.import_module("tumble_ros.correction")
    content = json.loads(corrected[0].read_text())
    content["parameters"].append(content["parameters"][0] | {"name": "accel.quartic.x"})
    (tmp_path / "other.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"found accel\.quartic\.x"):
        correction.read(tmp_path / "other.json")


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
        node.heard(message)
    assert node.counts["late"] == 3
    for message, _ in messages(ros, log.slice(200, 2)):
        node.heard(message)
    node.heard(first)  # two seconds back
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
        node.heard(message)
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


STUBS = {
    "rclcpp/rclcpp.hpp": """
#pragma once
#include <functional>
#include <memory>
#include <string>
namespace rclcpp {
struct NodeOptions {};
struct SensorDataQoS {};
template<class T> struct Publisher {
  using SharedPtr = std::shared_ptr<Publisher>;
  std::function<void(const T &)> sink;
  void publish(std::unique_ptr<T> message) { if (sink) sink(*message); }
};
template<class T> struct Subscription {
  using SharedPtr = std::shared_ptr<Subscription>;
  std::function<void(std::unique_ptr<T>)> callback;
};
struct Node {
  Node(const std::string &, const NodeOptions &) {}
  virtual ~Node() = default;
  template<class T> std::shared_ptr<Publisher<T>> create_publisher(const std::string &, SensorDataQoS);
  template<class T, class F>
  std::shared_ptr<Subscription<T>> create_subscription(const std::string &, SensorDataQoS, F);
};
}
""",
    "sensor_msgs/msg/imu.hpp": """
#pragma once
#include <memory>
namespace sensor_msgs { namespace msg {
struct Vector { double x, y, z; };
struct Imu {
  using UniquePtr = std::unique_ptr<Imu>;
  Vector linear_acceleration, angular_velocity;
};
} }
""",
    "rclcpp_components/register_node_macro.hpp": """
#pragma once
#define RCLCPP_COMPONENTS_REGISTER_NODE(name)
""",
    "main.cpp": """
#include <cstdio>
#include "rclcpp/rclcpp.hpp"
#include "sensor_msgs/msg/imu.hpp"
using Imu = sensor_msgs::msg::Imu;
static std::function<void(std::unique_ptr<Imu>)> in;
namespace rclcpp {
template<class T>
std::shared_ptr<Publisher<T>> Node::create_publisher(const std::string &, SensorDataQoS) {
  auto out = std::make_shared<Publisher<T>>();
  out->sink = [](const Imu & m) {
    auto a = m.linear_acceleration, w = m.angular_velocity;
    std::printf("%.17g %.17g %.17g %.17g %.17g %.17g\\n", a.x, a.y, a.z, w.x, w.y, w.z);
  };
  return out;
}
template<class T, class F>
std::shared_ptr<Subscription<T>> Node::create_subscription(const std::string &, SensorDataQoS, F f) {
  auto out = std::make_shared<Subscription<T>>();
  in = out->callback = f;
  return out;
}
}
#include "corrector.cpp"
int main() {
  tumble::Corrector node{rclcpp::NodeOptions{}};
  double v[6];
  while (std::scanf("%lf %lf %lf %lf %lf %lf", v, v + 1, v + 2, v + 3, v + 4, v + 5) == 6)
    in(std::make_unique<Imu>(Imu{{v[0], v[1], v[2]}, {v[3], v[4], v[5]}}));
}
""",
}


@pytest.mark.parametrize("terms", ["linear", "full"])
def test_the_component_compiles_and_corrects(terms: Literal["linear", "full"], tmp_path: Path) -> None:
    compiler = shutil.which("g++") or shutil.which("c++")
    if compiler is None:
        pytest.skip("no C++ compiler: install g++")
    setup = tumble.Setup.of(grade="mems", positions=16, terms=terms, rest=5.0)
    session = tumble.simulate_session(tmp_path / "s", setup, seed=5)
    calibration = tumble.calibrate(session, terms=terms)
    header = tmp_path / "imu_calibration.h"
    header.write_bytes(tumble.export_calibration(calibration, "c").content)
    for name, text in STUBS.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    source, program = ROOT / "ros2/tumble_ros_cpp/src", tmp_path / "program"
    words = [compiler, "-std=c++17", "-Wall", "-Wextra", "-Werror", "-Wno-unused-function", "-ffp-contract=off"]
    words += [f"-I{tmp_path}", f"-I{source}", f'-DTUMBLE_CALIBRATION="{header}"']
    subprocess.run([*words, str(tmp_path / "main.cpp"), "-o", str(program)], check=True)
    log = pl.read_parquet(session / "log.parquet").head(500)
    given = "\n".join(" ".join(f"{v:.17g}" for v in row) for row in log.select(COLUMNS).iter_rows())
    printed = subprocess.run([str(program)], input=given, capture_output=True, text=True, check=True).stdout
    found = np.array([[float(v) for v in line.split()] for line in printed.splitlines()])
    force, rate = calibration.apply(log.select(COLUMNS[:3]).to_numpy(), log.select(COLUMNS[3:]).to_numpy())
    assert rate is not None
    np.testing.assert_allclose(found, np.column_stack([force, rate]), rtol=1e-12, atol=1e-12)
