"""The corrector for one IMU: `ros2 launch tumble_ros correct.launch.py calibration:=/path/calibration.json imu:=/imu`.

`imu` is the topic of the raw samples without /data_raw, the output is beside it as /data_corrected.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {"calibration": None, "imu": "imu", "device": "", "temperature": "temperature"}


def generate_launch_description() -> LaunchDescription:
    """The node with its topics and parameters."""
    declared = [DeclareLaunchArgument(name, default_value=default) for name, default in ARGUMENTS.items()]
    imu = LaunchConfiguration("imu")
    node = Node(
        package="tumble_ros",
        executable="corrector",
        parameters=[
            {name: ParameterValue(LaunchConfiguration(name), value_type=str) for name in ("calibration", "device")}
        ],
        remappings=[
            ("imu/data_raw", [imu, "/data_raw"]),
            ("imu/data_corrected", [imu, "/data_corrected"]),
            ("temperature", LaunchConfiguration("temperature")),
        ],
    )
    return LaunchDescription([*declared, node])
