"""The node `corrector`: sensor_msgs/Imu in, corrected sensor_msgs/Imu out.

Topics      imu/data_raw → imu/data_corrected; temperature (sensor_msgs/Temperature) where the calibration changes with
            it; diagnostics once a second
Parameters  calibration: the file; device: a serial number that must be the calibration's; sample_rate: Hz, of the
            recording unless given; noise_accel, noise_gyro: variances of a sample added to those of the calibration;
            expires: a date YYYY-MM-DD after which the calibration is old

The correction is `tumble.Corrector`. Accelerometers with lever arms are moved to one point, for which a sample waits
for the next one.
"""

from __future__ import annotations

import datetime
from collections import deque
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu, Temperature

import tumble

ZERO_CELSIUS = 273.15


class Corrector(Node):
    """Corrects what one IMU publishes."""

    def __init__(self) -> None:
        super().__init__("tumble_corrector")
        file = str(self.declare_parameter("calibration", "").value)
        device = str(self.declare_parameter("device", "").value)
        rate = float(self.declare_parameter("sample_rate", 0.0).value)
        noise = [float(self.declare_parameter(f"noise_{kind}", 0.0).value) for kind in ("accel", "gyro")]
        self.expires = str(self.declare_parameter("expires", "").value)
        self.correction = tumble.Corrector(file, sample_rate=rate or None)
        calibration = self.correction.calibration
        if device and device != calibration.serial:
            raise ValueError(f"{file}: expected the device {device!r}, found a calibration of {calibration.serial!r}")
        for kind, model in (("accelerometers", calibration.accel), ("gyros", calibration.gyro)):
            if model is None or len(model.bias) != 3:
                raise ValueError(f"{file}: expected three {kind}, found {'none' if model is None else len(model.bias)}")
        self.serial = calibration.serial
        self.warm = any(parameter.name.endswith((".t1", ".t2")) for parameter in calibration.parameters)
        self.temperatures = calibration.temperature_range
        known = calibration.prediction
        u = (0.0, 0.0) if known is None else (known.force_u, known.rate_u or 0.0)
        self.covariances = [
            [variance if i % 4 == 0 else 0.0 for i in range(9)]
            for variance in (u[0] ** 2 + noise[0], u[1] ** 2 + noise[1])
        ]
        self.celsius: float | None = None
        self.waiting: deque[Any] = deque()
        self.counts = {"corrected": 0, "late": 0, "outside": 0}
        self.outside = ""
        self.out = self.create_publisher(Imu, "imu/data_corrected", qos_profile_sensor_data)
        self.diagnostics = self.create_publisher(DiagnosticArray, "diagnostics", 10)
        self.create_subscription(Imu, "imu/data_raw", self.correct, qos_profile_sensor_data)
        if self.warm:
            self.create_subscription(Temperature, "temperature", self.warmed, qos_profile_sensor_data)
        self.create_timer(1.0, self.diagnose)

    def warmed(self, message: Temperature) -> None:
        """A temperature, °C."""
        self.celsius = float(message.temperature)

    def correct(self, message: Imu) -> None:
        """A sample: corrected, and with lever arms the one before it. Late ones are dropped."""
        a, w = message.linear_acceleration, message.angular_velocity
        kelvin = None if self.celsius is None else [self.celsius + ZERO_CELSIUS] * self.correction.thermometers
        self.waiting.append((message, self.celsius))
        stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        corrected = self.correction.add([a.x, a.y, a.z], [w.x, w.y, w.z], time=stamp, temperature=kelvin)
        if self.correction.dropped > self.counts["late"]:
            self.waiting.pop()
            self.counts["late"] = self.correction.dropped
        self.publish(corrected)

    def finish(self) -> None:
        """Publish what waits for a next sample that does not come."""
        self.publish(self.correction.finish())

    def publish(self, corrected: tumble.Corrected) -> None:
        """Corrected messages: all but the two vectors and their covariances is that of the raw ones."""
        for force, rate in zip(corrected.force.tolist(), corrected.rate.tolist(), strict=True):
            message, celsius = self.waiting.popleft()
            out = Imu()
            out.header = message.header
            out.orientation, out.orientation_covariance = message.orientation, message.orientation_covariance
            for vector, values in ((out.linear_acceleration, force), (out.angular_velocity, rate)):
                vector.x, vector.y, vector.z = values
            for name, added in zip(("linear_acceleration", "angular_velocity"), self.covariances, strict=True):
                raw = [float(c) for c in getattr(message, f"{name}_covariance")]
                both = [a + b for a, b in zip(raw, added, strict=True)] if raw[0] >= 0.0 else added
                setattr(out, f"{name}_covariance", both)
            self.outside = self.outside_of(celsius)
            self.counts["outside"] += bool(self.outside)
            self.counts["corrected"] += 1
            self.out.publish(out)

    def outside_of(self, celsius: float | None) -> str:
        """In words, that a temperature is outside of what was calibrated; empty where it is not."""
        limits = self.temperatures
        if celsius is None or limits is None or limits[0] <= celsius <= limits[1]:
            return ""
        return f"{celsius:.1f} °C, calibrated from {limits[0]:.1f} to {limits[1]:.1f} °C"

    def diagnose(self) -> None:
        """What there is to say, once a second."""
        status = DiagnosticStatus()
        status.name, status.hardware_id = "tumble: IMU calibration", self.serial
        expired = bool(self.expires) and datetime.date.today().isoformat() > self.expires
        without = self.warm and self.celsius is None
        status.level = DiagnosticStatus.WARN if expired or self.outside or without else DiagnosticStatus.OK
        status.message = (
            f"expired on {self.expires}: calibrate again"
            if expired
            else f"outside of what was calibrated: {self.outside}"
            if self.outside
            else "no temperature: corrected as at the reference temperature"
            if without
            else "corrected"
        )
        status.values = [KeyValue(key=key, value=str(value)) for key, value in self.counts.items()]
        message = DiagnosticArray()
        message.header.stamp = self.get_clock().now().to_msg()
        message.status = [status]
        self.diagnostics.publish(message)


def main() -> None:
    """Run the node until it is stopped."""
    rclpy.init()
    node = Corrector()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.finish()
        node.destroy_node()
        rclpy.try_shutdown()
