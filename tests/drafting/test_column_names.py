"""What a name or a unit says of a column is believed: kinds of sensors, their axes and units, times, thermometers."""

from __future__ import annotations

import pytest

from tumble.recording.columns.names import ACCEL, GYRO, MAGNETOMETER, columns_by_name, is_no_sensor, temperature_unit


def axes(*patterns: str, axes: str = "xyz") -> list[str]:
    return [pattern.format(axis) for pattern in patterns for axis in axes]


NAMED: dict[str, tuple[list[str], str | None, str | None]] = {
    # the names of accelerometers and gyros in the order of their axes, and their units
    "letters": (axes("a{}", "g{}"), None, None),
    "forces and rates": (axes("f{}", "w{}"), None, None),
    "counted from 1": (axes("a{}", "w{}", axes="123"), None, None),
    "ArduPilot": (axes("Acc{}", "Gyr{}", axes="XYZ"), None, None),
    "EuRoC": (axes("a_RS_S_{} [m s^-2]", "w_RS_S_{} [rad s^-1]"), "m/s^2", "rad/s"),
    "units behind": (axes("acc_{}_g", "gyr_{}_dps"), "g", "deg/s"),
    "units in words": (axes("acc_{}_m_per_s2", "rate gyro {} deg per sec"), "m/s^2", "deg/s"),
    "per second": (axes("Accel_{}_g", "Gyro_{}_deg_per_s", axes="XYZ"), "g", "deg/s"),
    "ROS": (axes("field.linear_acceleration.{}", "field.angular_velocity.{}"), None, None),
    "units in brackets": (axes("Accel {} (g)", "Gyro {} (deg/s)", axes="XYZ"), "g", "deg/s"),
    "MAVLink": (axes("{}acc", "{}gyro"), None, None),
    "arrays": (axes("imu/accel[{}]", "imu/gyro[{}]", axes="012"), None, None),
    "arrays of a body": (axes("imu/fb[{}]", "imu/wb[{}]", axes="012"), None, None),
    "the axis amid": (axes("Raw {} Accel", "Raw {} Gyro", axes="XYZ"), None, None),
    "the axis before": (axes("{}la", "{}av"), None, None),
    "units alone": (axes("{} (m/s^2)", "{} (rad/s)"), "m/s^2", "rad/s"),
    "other units alone": (axes("{} [mg]", "{} [dps]"), "mg", "deg/s"),
    "times g": (axes("{}_times_g", "{} (°/s)"), "g", "deg/s"),
    "angular": (axes("acc_{}", "angular_{}"), None, None),
    "anglvel": (axes("accel_{}", "anglvel_{}"), None, None),
    "MicroStrain": (axes("scaledAccel{}", "scaledGyro{}", axes="XYZ"), "g", "rad/s"),
    "mechanics of flight": (["Ax", "Ay", "Az", "p", "q", "r"], None, None),
    "vehicle": (["AccLong", "AccLat", "AccVert", "GyroRoll", "GyroPitch", "GyroYaw"], None, None),
    "ship": (
        ["Surge acceleration", "Sway acceleration", "Heave acceleration", "rollspeed", "pitchspeed", "yawspeed"],
        None,
        None,
    ),
    "units of rates in words": (axes("acc_{}", "gyr_{}_deg_per_sec"), None, "deg/s"),
    "units in full": (axes("accel_{} (milli-g)", "gyro_{} (degrees/second)"), "mg", "deg/s"),
    "MicroStrain by name": (axes("inertial:scaledAccel{}", "inertial:scaledGyro{}", axes="XYZ"), "g", "rad/s"),
    "MicroStrain by number": (
        ["X Accel [x8004]", "Y Accel [x8004]", "Z Accel [x8004]", "X Gyro [x8005]", "Y Gyro [x8005]", "Z Gyro [x8005]"],
        "g",
        "rad/s",
    ),
    "turn rates": (axes("sf_{}", "turnrate_{}"), None, None),
    "speeds": (axes("dV{}", "AngularSpeed{}"), None, None),
    "textbooks": (axes("f_ib_b_{}", "ω{}"), None, None),
    "browsers": (
        [*axes("acceleration_with_gravity_{}"), "rotationRate.beta", "rotationRate.gamma", "rotationRate.alpha"],
        None,
        None,
    ),
    "flight in deg/s": (["ax", "ay", "az", "p_dps", "q_dps", "r_dps"], None, "deg/s"),
    "without biases": (axes("accel {} bias corrected", "unbiased_gyro_{}"), None, None),
    "a letter behind": (axes("{}_a", "{}_g"), None, None),
    "Spanish": (axes("aceleracion_{}", "giro_{}"), None, None),
    "Portuguese": (axes("Acelerômetro {}", "Giroscópio {}", axes="XYZ"), None, None),
    "German": (axes("Beschl_{}", "Dreh_{}", axes="XYZ"), None, None),
}


@pytest.mark.parametrize("case", NAMED)
def test_sensors_are_identified_by_their_names(case: str) -> None:
    names, accel, gyro = NAMED[case]
    found = columns_by_name(["roll", "yaw", *reversed(names), "pitch", "mx", "my", "mz"]).triads
    assert [found[kind].columns for kind in (ACCEL, GYRO)] == [tuple(names[:3]), tuple(names[3:])]
    assert [found[kind].unit for kind in (ACCEL, GYRO)] == [accel, gyro]


@pytest.mark.parametrize(
    ("names", "kinds"),
    [
        (axes("lacc_{}", "gyro_{}"), {GYRO}),
        (axes("{}_g", axes="XYZ"), {ACCEL}),
        (axes("gyro_bias_{}"), set()),
        (axes("angular_acceleration_{}"), set()),
        (["ax", "ay", "az", "p", "q"], {ACCEL}),
        (["ax", "ay", "az", "roll_setpoint", "pitch_setpoint", "yaw_setpoint"], {ACCEL}),
        (["lat_accuracy", "long_accuracy", "vert_accuracy"], set()),
        (axes("acc_{}", "mag_{}_uT"), {ACCEL, MAGNETOMETER}),
        (axes("f{}_uT"), {MAGNETOMETER}),
        (axes("Accelerometer {} (g)", "Magnetometer {} (G)", axes="XYZ"), {ACCEL, MAGNETOMETER}),
    ],
)
def test_what_names_and_units_say_otherwise_is_no_sensor(names: list[str], kinds: set[str]) -> None:
    assert set(columns_by_name(names).triads) == kinds


def test_of_several_devices_the_first_is_taken() -> None:
    pairs = [("imu0_acc_{}", "imu1_acc_{}"), ("a{}1", "a{}2"), ("gyro{}1", "gyro{}2"), ("acc{}_1", "acc{}_2")]
    for first, second in [*pairs, ("gyro_{}_0", "gyro_{}_1")]:
        found = columns_by_name(axes(first, second))
        (sensors,) = found.triads.values()
        assert sensors.columns == tuple(axes(first))
        assert len(found.others) == 1
    both = columns_by_name([*axes("a{}1", "g{}1", "a{}2", "g{}2")]).triads
    assert [both[kind].columns[0] for kind in (ACCEL, GYRO)] == ["ax1", "gx1"]


@pytest.mark.parametrize(
    ("names", "time", "unit"),
    [
        (["TimeUS"], "TimeUS", "us"),
        (["timestamp [ns]"], "timestamp [ns]", "ns"),
        (["timestamp_seconds"], "timestamp_seconds", "s"),
        (["time_boot_ms"], "time_boot_ms", "ms"),
        (["field.header.stamp"], "field.header.stamp", None),
        (["server_time", "device_timestamp_ms"], "device_timestamp_ms", "ms"),
        (["%time", "seq", "stamp"], "stamp", None),
        (["t (milliseconds)"], "t (milliseconds)", "ms"),
        (["elapsed-time-system", "elapsed-time-sensor"], "elapsed-time-system", None),
        (["uptime nav"], "uptime nav", None),
    ],
)
def test_the_time_of_a_sample_is_that_of_the_device(names: list[str], time: str, unit: str | None) -> None:
    found = columns_by_name([*names, "ax", "ay", "az"])
    assert (found.time, found.time_unit) == (time, unit)


@pytest.mark.parametrize(
    ("name", "unit"),
    [("Temp [K]", "K"), ("imu_temp_c", "degC"), ("Temperature (°F)", "degF"), ("T", None), ("temp_raw", "raw")],
)
def test_thermometers_are_known_with_the_unit_of_their_name(name: str, unit: str | None) -> None:
    assert columns_by_name(["t", *axes("acc_{}"), name]).temperatures == (name,)
    assert temperature_unit(name) == unit


@pytest.mark.parametrize(
    ("names", "taken"),
    [
        ("temp_accel temp_gyro", "temp_accel temp_gyro"),
        ("gyro_temperature accel_temperature", "accel_temperature gyro_temperature"),
        ("chip_temp_C temp", "chip_temp_C"),
        ("temp gyro_temp", "gyro_temp"),
        ("template tempo T_x T_y T_z T1_x", ""),
        ("temp_x temp_y temp_z", "temp_x"),
        ("T0 T1", "T0"),
        ("gyro_z_temp gyro_y_temp gyro_x_temp acc_temp", "acc_temp gyro_z_temp"),
    ],
)
def test_of_several_thermometers_each_kind_of_sensor_has_its_own(names: str, taken: str) -> None:
    found = columns_by_name(["t", *names.split(), *axes("acc_{}", "gyro_{}")])
    assert found.temperatures == tuple(taken.split())
    assert [found.triads[kind].columns[0] for kind in (ACCEL, GYRO)] == ["acc_x", "gyro_x"]


def test_names_of_other_things_are_no_sensors() -> None:
    assert all(map(is_no_sensor, ("calib_accel", "seconds_elapsed", "RSSI (dB)", "attitude_roll(radians)")))
    assert not any(map(is_no_sensor, ("ch3", "v1")))
