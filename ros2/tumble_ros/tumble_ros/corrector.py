"""The node `corrector`: sensor_msgs/Imu in, corrected sensor_msgs/Imu out.

Topics      imu/data_raw → imu/data_corrected; temperature (sensor_msgs/Temperature) where the calibration changes with
            it; magnetic_field (sensor_msgs/MagneticField) → magnetic_field_corrected where it has a magnetometer;
            diagnostics once a second
Parameters  calibration: the file; device: a serial number that must be the calibration's; sample_rate: Hz, of the
            recording unless given; noise_accel, noise_gyro: variances of a sample added to those of the calibration;
            expires: a date YYYY-MM-DD after which the calibration is old

Accelerometers with lever arms are moved to one point, for which a sample waits for the next one.
"""

from __future__ import annotations

import datetime
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu, Temperature

from tumble_ros.correction import Sample, read

LATE = 3.0
"""Times of samples that go back more than so many usual intervals are those of a clock that was started anew."""


class Corrector(Node):
    """Corrects what one IMU publishes."""

    def __init__(self) -> None:
        super().__init__("tumble_corrector")
        file = str(self.declare_parameter("calibration", "").value)
        device = str(self.declare_parameter("device", "").value)
        rate = float(self.declare_parameter("sample_rate", 0.0).value)
        noise = [float(self.declare_parameter(f"noise_{kind}", 0.0).value) for kind in ("accel", "gyro")]
        self.expires = str(self.declare_parameter("expires", "").value)
        self.correction = read(file, rate or None)
        if device and device != self.correction.serial:
            raise ValueError(
                f"{file}: expected the device {device!r}, found a calibration of {self.correction.serial!r}"
            )
        self.covariances = [
            [c + (extra if i % 4 == 0 else 0.0) for i, c in enumerate(self.correction.covariance[kind])]
            for kind, extra in zip(("accel", "gyro"), noise)  # noqa: B905
        ]
        self.celsius: float | None = None
        self.waiting: list[Any] = []
        self.last: float | None = None
        self.counts = {"corrected": 0, "late": 0, "outside": 0}
        self.outside = ""
        self.out = self.create_publisher(Imu, "imu/data_corrected", qos_profile_sensor_data)
        self.said = self.create_publisher(DiagnosticArray, "diagnostics", 10)
        self.create_subscription(Imu, "imu/data_raw", self.heard, qos_profile_sensor_data)
        if self.correction.warm:
            self.create_subscription(Temperature, "temperature", self.warmed, qos_profile_sensor_data)
        self.create_timer(1.0, self.diagnose)

    def warmed(self, message: Temperature) -> None:
        """A temperature, °C."""
        self.celsius = float(message.temperature)

    def heard(self, message: Imu) -> None:
        """A sample: corrected, and with lever arms the one before it."""
        time = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
        if self.last is not None and time <= self.last:
            if self.last - time < LATE * self.correction.interval:
                self.counts["late"] += 1
                return
            self.correction.reset()
            self.waiting.clear()
        self.last = time
        a, w = message.linear_acceleration, message.angular_velocity
        self.waiting.append(message)
        corrected = self.correction.add(Sample(time, (a.x, a.y, a.z), (w.x, w.y, w.z), self.celsius))
        if corrected is not None:
            self.publish(self.waiting.pop(0), corrected)

    def finish(self) -> None:
        """Publish what waits for a next sample that does not come."""
        corrected = self.correction.finish()
        if corrected is not None and self.waiting:
            self.publish(self.waiting.pop(0), corrected)

    def publish(self, message: Imu, corrected: Sample) -> None:
        """The corrected message: all but the two vectors and their covariances is that of the raw one."""
        out = Imu()
        out.header = message.header
        out.orientation, out.orientation_covariance = message.orientation, message.orientation_covariance
        for vector, values in ((out.linear_acceleration, corrected.force), (out.angular_velocity, corrected.rate)):
            vector.x, vector.y, vector.z = values
        for name, raw, own in (
            ("linear_acceleration_covariance", message.linear_acceleration_covariance, self.covariances[0]),
            ("angular_velocity_covariance", message.angular_velocity_covariance, self.covariances[1]),
        ):
            known = [float(c) for c in raw]
            setattr(out, name, [a + b for a, b in zip(known, own)] if known[0] >= 0.0 else own)  # noqa: B905
        self.outside = self.correction.outside(corrected)
        self.counts["outside"] += bool(self.outside)
        self.counts["corrected"] += 1
        self.out.publish(out)

    def diagnose(self) -> None:
        """What there is to say, once a second."""
        status = DiagnosticStatus()
        status.name, status.hardware_id = "tumble: IMU calibration", self.correction.serial
        expired = bool(self.expires) and datetime.date.today().isoformat() > self.expires
        without = self.correction.warm and self.celsius is None
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
        self.said.publish(message)


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
