"""Corrects sensor_msgs/Imu with a calibration of tumble, in ROS 2, without tumble."""
