"""The clean recording as programs and data sets have it, in their published formats. Nothing here is read by the
project."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import polars as pl

from tests.support.corpus.dialects import ACCEL, GYRO, NAMES, table, written
from tumble.units import DEGREE, G_STANDARD, Array

Write = Callable[[pl.DataFrame, Path], str]
EPOCH_NS = 1_700_000_000_123_456_789


def text(columns: Array, digits: int = 9) -> list[list[str]]:
    return [[f"{v:.{digits}g}" for v in column] for column in np.atleast_2d(columns.T)]


def joined(path: Path, names: Sequence[str], columns: Sequence[Sequence[str]], delimiter: str = ",") -> str:
    path.parent.mkdir(parents=True, exist_ok=True)
    rows = [list(row) for row in zip(*columns, strict=True)]
    return written(path, [list(names), *rows] if names else rows, delimiter=delimiter)


def parts(log: pl.DataFrame) -> tuple[Array, Array, Array]:
    """Times, specific forces and rates."""
    return log["t"].to_numpy(), log.select(ACCEL).to_numpy(), log.select(GYRO).to_numpy()


def nanoseconds(t: Array) -> list[str]:
    return [str(EPOCH_NS + round(v * 1e9)) for v in t]


def vertical(a: Array) -> Array:
    return np.asarray(a / np.linalg.norm(a, axis=1, keepdims=True))


def field(a: Array) -> Array:
    """A magnetic field about three sides, µT, with iron nearby: of one length about a zero that is far off."""
    u = vertical(a)
    return np.column_stack([20.0 + 30.0 * u[:, 1], -5.0 + 30.0 * u[:, 0], 4.0 - 30.0 * u[:, 2]])


def quaternions(t: Array) -> Array:
    half = 0.1 * t
    return np.column_stack([np.cos(half), 0.6 * np.sin(half), 0.8 * np.sin(half), 0.0 * t])


def ros_messages(log: pl.DataFrame, folder: Path) -> str:
    """What `rostopic echo` prints: a message of several lines for every sample."""
    lines = []
    for k, (t, *v) in enumerate(log.select("t", *ACCEL, *GYRO).iter_rows()):
        ns = EPOCH_NS + round(t * 1e9)
        lines += [f"header: \n  seq: {k}\n  stamp: \n    secs: {ns // 10**9}\n    nsecs: {ns % 10**9}\n"]
        for name, three in (("angular_velocity", v[3:]), ("linear_acceleration", v[:3])):
            lines.append(f"{name}: \n" + "".join(f"  {a}: {x!r}\n" for a, x in zip("xyz", three, strict=True)))
        lines.append("---\n")
    (folder / "imu.yaml").write_text("".join(lines), encoding="utf-8")
    return "imu.yaml"


def phyphox_archive(log: pl.DataFrame, folder: Path) -> str:
    t, a, g = parts(log)
    with zipfile.ZipFile(folder / "phyphox 2026-11-22.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        for name, unit, values, late in (("Accelerometer", "m/s^2", a, 0.0), ("Gyroscope", "rad/s", g, 0.003)):
            names = ["Time (s)", *(f"{axis} ({unit})" for axis in "XYZ")]
            joined(folder / "part", [f'"{n}"' for n in names], [*text(t + late), *text(values)])
            archive.write(folder / "part", f"{name}.csv")
        archive.writestr("meta/device.csv", '"property","value"\n"version","1.1"\n')
    return "phyphox 2026-11-22.zip"


def everything_without_names(log: pl.DataFrame, folder: Path) -> str:
    """Time, quaternion, magnetometers, accelerometers, a thermometer, gyros, and no word of it."""
    t, a, g = parts(log)
    warm = np.round(2500.0 + 3.0 * np.random.default_rng(5).normal(size=len(t)))
    columns = [t, quaternions(t), field(a), a / G_STANDARD, warm, g / DEGREE]
    return joined(folder / "all.txt", [], [c for column in columns for c in text(column)], " ")


def ticks(per_second: float) -> Write:
    """A counter of ticks in place of the time."""

    def write(log: pl.DataFrame, folder: Path) -> str:
        t, a, g = parts(log)
        stamps = [str(round(v * per_second)) for v in t]
        return joined(folder / "ticks.csv", ["tick", *NAMES[1:]], [stamps, *text(a), *text(g / DEGREE)])

    return write


# -------------------- found by their names and first numbers --------------------


def ros_table(log: pl.DataFrame, folder: Path) -> str:
    """`rostopic echo -p`: the time of arrival first, covariances between."""
    t, a, g = parts(log)
    wide = [["0.0"] * len(t)] * 9
    names = ["%time", "field.header.seq", "field.header.stamp", *(f"field.angular_velocity.{x}" for x in "xyz")]
    names += [f"field.angular_velocity_covariance{k}" for k in range(9)]
    names += [*(f"field.linear_acceleration.{x}" for x in "xyz")]
    arrival = [str(int(ns) + 5_000_000 + k % 7 * 1_000_000) for k, ns in enumerate(nanoseconds(t))]
    count = [str(k) for k in range(len(t))]
    return joined(folder / "imu.csv", names, [arrival, count, nanoseconds(t), *text(g), *wide, *text(a)])


def bagpy(log: pl.DataFrame, folder: Path) -> str:
    t, a, g = parts(log)
    names = ["Time", "header.stamp.secs", "header.stamp.nsecs"]
    names += [f"{n}.{x}" for n in ("angular_velocity", "linear_acceleration") for x in "xyz"]
    stamps = [(ns[:10], str(int(ns[10:]))) for ns in nanoseconds(t)]
    late = [f"{1.7e9 + v + 0.003 * (k % 5):.4f}" for k, v in enumerate(t)]
    return joined(folder / "imu.csv", names, [late, *zip(*stamps, strict=True), *text(g), *text(a)])


def gopro(log: pl.DataFrame, folder: Path) -> str:
    """The axes in brackets, z first."""
    t, a, g = parts(log)
    names = ["cts", *(f"Accelerometer ({x}) [m/s2]" for x in "zxy"), *(f"Gyroscope ({x}) [rad/s]" for x in "zxy")]
    order = [2, 0, 1]
    return joined(folder / "gopro.csv", names, [*text(1e3 * t), *text(a[:, order]), *text(g[:, order])])


def unnamed_axes_in_another_order(log: pl.DataFrame, folder: Path) -> str:
    t, a, g = parts(log)
    names = ["t", *(f"first {x}" for x in "zyx"), *(f"second {x}" for x in "zyx")]
    return joined(folder / "zyx.csv", names, [*text(t), *text(a[:, ::-1]), *text(g[:, ::-1])])


def ridi(log: pl.DataFrame, folder: Path) -> str:
    """A file for each sensor without names, and what a phone made of them beside."""
    t, a, g = parts(log)
    for name, values in (("acce", a), ("gyro", g), ("linacce", 0.1 * g), ("gravity", 9.8 * vertical(a))):
        joined(folder / "ridi" / f"{name}.txt", [], [nanoseconds(t), *text(values)], " ")
    joined(folder / "ridi" / "orientation.txt", [], [nanoseconds(t), *text(quaternions(t))], " ")
    return "ridi"


def sensor_logger(log: pl.DataFrame, folder: Path) -> str:
    """What the phone calls accelerometer is without gravity."""
    t, a, g = parts(log)
    without = a - 9.80665 * vertical(a)
    for name, values in (("Accelerometer", without), ("TotalAcceleration", a), ("Gyroscope", g), ("Gravity", a)):
        columns = [nanoseconds(t), *text(t), *text(values[:, ::-1])]
        joined(folder / "sl" / f"{name}.csv", ["time", "seconds_elapsed", "z", "y", "x"], columns)
    return "sl"


def numpy_matrix(log: pl.DataFrame, folder: Path) -> str:
    """Gyros before accelerometers."""
    np.save(folder / "imu.npy", log.select("t", *GYRO, *ACCEL).to_numpy())
    return "imu.npy"


def numpy_arrays(log: pl.DataFrame, folder: Path) -> str:
    t, a, g = parts(log)
    np.savez(folder / "imu.npz", t=t, acc=a, gyro=g)
    return "imu.npz"


def sparkfun(log: pl.DataFrame, folder: Path) -> str:
    lines = []
    for *v, _ in log.select(*ACCEL, *GYRO, "t").iter_rows():
        acc = ", ".join(f"{1e3 * x / G_STANDARD:012.5f}" for x in v[:3])
        gyr = ", ".join(f"{x / DEGREE:012.5f}" for x in v[3:])
        lines.append(f"Scaled. Acc (mg) [ {acc} ], Gyr (DPS) [ {gyr} ], Tmp (C) [ 00024.1 ]\n")
    (folder / "serial.txt").write_text("".join(lines), encoding="ascii")
    return "serial.txt"


def adafruit(log: pl.DataFrame, folder: Path) -> str:
    """A line for each kind of sensor, whose axes alone are named."""
    lines = []
    for *v, _ in log.select(*ACCEL, *GYRO, "t").iter_rows():
        for word, unit, three in (("Acceleration", "m/s^2", v[:3]), ("Rotation", "rad/s", v[3:])):
            values = ", ".join(f"{x}: {y:.7f}" for x, y in zip("XYZ", three, strict=True))
            lines.append(f"{word} {values} {unit}\n")
        lines.append("Temperature: 25.31 degC\n\n")
    (folder / "serial.txt").write_text("".join(lines), encoding="ascii")
    return "serial.txt"


def thousands(mark: str) -> Write:
    """Marks between the thousands."""

    def write(log: pl.DataFrame, folder: Path) -> str:
        rows = table(log, ["t [s]", *(f"A{x} [mg]" for x in "xyz"), *(f"G{x} [mdps]" for x in "xyz")])
        for row in rows[1:]:
            values = [float(v) * (1e3 / G_STANDARD if j < 3 else 1e3 / DEGREE) for j, v in enumerate(row[1:])]
            row[1:] = [f"{v:,.3f}".replace(",", mark) for v in values]
            row[1:] = [f'"{v}"' if "," in v else v for v in row[1:]]
        return written(folder / "thousands.csv", rows, delimiter="," if mark == "," else ";")

    return write


def core_motion(log: pl.DataFrame, folder: Path) -> str:
    """An app on Apple's devices: −1 g where an axis points up; when it was written before when it was read."""
    t, a, g = parts(log)
    names = ["loggingTime(txt)", "accelerometerTimestamp_sinceReboot(s)"]
    names += [f"accelerometerAcceleration{x}(G)" for x in "XYZ"] + [f"gyroRotation{x}(rad/s)" for x in "XYZ"]
    names += [f"motionRotationRate{x}(rad/s)" for x in "XYZ"] + [f"motionGravity{x}(G)" for x in "XYZ"]
    late = [f"2026-11-22 10:{int(v // 60):02d}:{v % 60:06.3f} +0100" for v in t]
    columns = [late, *text(9999.0 + t, 12), *text(-a / G_STANDARD), *text(g), *text(g + 0.01), *text(-vertical(a))]
    return joined(folder / "iphone.csv", names, columns)


# -------------------- no recordings of accelerometers --------------------


def oxiod(log: pl.DataFrame, folder: Path) -> str:
    """Attitude, rates, gravity and what is left without it, magnetometers; no names."""
    t, a, g = parts(log)
    columns = [t, quaternions(t)[:, :3], g, vertical(a), a / G_STANDARD - vertical(a), field(a)]
    return joined(folder / "imu1.csv", [], [c for column in columns for c in text(column)])


def positions_of_a_camera(log: pl.DataFrame, folder: Path) -> str:
    t = log["t"].to_numpy()
    path = np.column_stack([0.1 * np.sin(0.3 * t), 0.2 * np.cos(0.2 * t), 1.1 + 0.0 * t])
    return joined(folder / "pose.csv", ["t", "x", "y", "z"], [*text(t), *text(path)])


def gyros_alone(log: pl.DataFrame, folder: Path) -> str:
    t, _, g = parts(log)
    return joined(folder / "Gyroscope.csv", ["Time (s)", *(f"{x} (rad/s)" for x in "XYZ")], [*text(t), *text(g)])
