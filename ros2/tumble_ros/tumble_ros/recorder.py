"""The node `recorder`: sensor_msgs/Imu as lines for `tumble bench --listen tcp:PORT`, t,ax,ay,az,gx,gy,gz in SI.

Topics      imu/data_raw
Parameters  host, port: where the bench listens (localhost, 4242)

Times are those of the messages, from the first second on. While the bench does not answer, samples are kept, up to
KEPT, and what is lost then is said.
"""

from __future__ import annotations

import socket
from collections import deque

import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu

KEPT = 100_000
"""Lines: some minutes."""


class Recorder(Node):
    """Hands on what one IMU publishes."""

    def __init__(self) -> None:
        super().__init__("tumble_recorder")
        self.place = (
            str(self.declare_parameter("host", "localhost").value),
            int(self.declare_parameter("port", 4242).value),
        )
        self.socket: socket.socket | None = None
        self.lines: deque[bytes] = deque([b"t,ax,ay,az,gx,gy,gz\n"])
        self.lost = 0
        self.first: int | None = None
        self.create_subscription(Imu, "imu/data_raw", self.heard, qos_profile_sensor_data)
        self.create_timer(0.1, self.send)

    def heard(self, message: Imu) -> None:
        """A sample."""
        stamp = message.header.stamp
        self.first = stamp.sec if self.first is None else self.first
        a, w = message.linear_acceleration, message.angular_velocity
        numbers = ",".join(repr(float(v)) for v in (a.x, a.y, a.z, w.x, w.y, w.z))
        if len(self.lines) >= KEPT:
            self.lost += 1
            return
        self.lines.append(f"{stamp.sec - self.first}.{stamp.nanosec:09d},{numbers}\n".encode())

    def send(self) -> None:
        """All lines that wait, to the bench."""
        try:
            if self.socket is None:
                self.socket = socket.create_connection(self.place, timeout=1.0)
                self.get_logger().info(f"connected to {self.place[0]}:{self.place[1]}")
            while self.lines:
                self.socket.sendall(self.lines[0])
                self.lines.popleft()
        except OSError as error:
            if self.socket is not None:
                self.socket.close()
            self.socket = None
            lost = f"; {self.lost} samples were lost" if self.lost else ""
            self.get_logger().warning(f"{self.place[0]}:{self.place[1]}: {error}; {len(self.lines)} lines wait{lost}")


def main() -> None:
    """Run the node until it is stopped."""
    rclpy.init()
    node = Recorder()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.send()
        node.destroy_node()
        rclpy.try_shutdown()
