"""The clean recording as logs whose names say little or nothing, with what boards write beside the sensors: a wrong
reading of them would be a plausible one. Nothing here is read by the project."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import polars as pl

from tests.support.corpus.dialects import NAMES, written
from tests.support.corpus.programs import Write, field, joined, parts, text
from tumble.units import DEGREE, G_STANDARD


def whole(values: npt.NDArray[np.floating[Any]]) -> list[list[str]]:
    """Columns of whole numbers."""
    return [[str(v) for v in column] for column in np.round(np.atleast_2d(values.T)).astype(np.int64).tolist()]


def bno055(log: pl.DataFrame, folder: Path) -> str:
    """Counts of Bosch's BNO055: 100 per m/s² and 16 per °/s."""
    t, a, g = parts(log)
    return joined(
        folder / "bno.csv", ["ms", *NAMES[1:]], [*whole(1e3 * t), *whole(100.0 * a), *whole(16.0 / DEGREE * g)]
    )


def scaled(accel: float, gyro: float, names: Sequence[str] = NAMES) -> Write:
    """Numbers that read so much for one m/s² and one rad/s, in a unit that nothing says."""

    def write(log: pl.DataFrame, folder: Path) -> str:
        t, a, g = parts(log)
        return joined(folder / "log.csv", names, [*text(t), *text(accel * a), *text(gyro * g)])

    return write


def biased_gyros_first(_log: pl.DataFrame, folder: Path) -> str:
    """Counts without names at rest: gyros whose bias has the length of a data sheet's counts per g, then the
    accelerometers."""
    rng = np.random.default_rng(1)
    rows = 6000
    drift = np.cumsum(rng.normal(scale=0.05, size=(rows, 3)), axis=0)
    gyro = np.array([-109.0, 19.0, 65.0]) + drift + rng.normal(scale=4.0, size=(rows, 3))
    accel = np.array([120.0, -310.0, 16100.0]) + rng.normal(scale=40.0, size=(rows, 3))
    return joined(folder / "still.txt", [], [*whole(20.0 * np.arange(rows)), *whole(gyro), *whole(accel)])


def magnetometers_behind(log: pl.DataFrame, folder: Path) -> str:
    """Time, gyros, accelerometers, magnetometers, no names."""
    t, a, g = parts(log)
    counted = [whole(1e3 * t), whole(131.0 / DEGREE * g), whole(16384.0 / G_STANDARD * a), whole(field(a) / 0.15)]
    return joined(folder / "nine.txt", [], [c for columns in counted for c in columns])


def magnetometers_between(log: pl.DataFrame, folder: Path) -> str:
    """Time, accelerometers, magnetometers, and no gyros nor names."""
    t, a, _ = parts(log)
    return joined(folder / "six.txt", [], [*whole(1e3 * t), *text(a / G_STANDARD, 5), *text(field(a), 5)])


def epoch_seconds(log: pl.DataFrame, folder: Path) -> str:
    """The second of the day's date that changes once in 50 rows, then milliseconds since the start, no names."""
    t, a, g = parts(log)
    counted = [1_747_000_000 + np.floor(t), *(4096.0 / G_STANDARD * a).T, *(65.5 / DEGREE * g).T]
    return joined(folder / "epoch.txt", [], whole(np.array(counted).T))


def housekeeping(log: pl.DataFrame, folder: Path) -> str:
    """A counter of eight bits, pressure, volts and degrees, then gyros and accelerometers; no names."""
    t, a, g = parts(log)
    rng = np.random.default_rng(2)
    count = [str(k % 256) for k in range(len(t))]
    beside = [
        1000.9 + 0.05 * rng.normal(size=len(t)),
        3.71 + 0.004 * rng.normal(size=len(t)),
        24.0 + 0.01 * t + 0.1 * rng.normal(size=len(t)),
    ]
    columns = [count, *text(np.column_stack(beside), 6), *text(g / DEGREE, 5), *text(a, 5)]
    return joined(folder / "station.txt", [], columns, " ")


def housekeeping_alone(log: pl.DataFrame, folder: Path) -> str:
    """Time, pressure, volts and a counter, and no accelerometers: no recording."""
    t = log["t"].to_numpy()
    rng = np.random.default_rng(2)
    beside = [1000.9 + 0.05 * rng.normal(size=len(t)), 3.71 + 0.004 * rng.normal(size=len(t)), np.arange(len(t)) % 256]
    return joined(folder / "station.txt", [], text(np.column_stack([t, *beside]), 6), " ")


def two_files_of_other_names(log: pl.DataFrame, folder: Path) -> str:
    """A recording in two parts, in files that are called after the sensors."""
    half = log.height // 2
    for number, part in enumerate((log[:half], log[half:]), 1):
        t, a, g = parts(part)
        names = ["ts", *(f"v{k}" for k in range(1, 7))]
        joined(folder / "two" / f"accel_gyro_{number}.csv", names, [*text(t), *text(a), *text(g)])
    return "two"


def linear_accelerations(log: pl.DataFrame, folder: Path) -> str:
    """What a filter has left without gravity, its words before the axes."""
    _, a, _ = parts(log)
    without = a - 9.80665 * a / np.linalg.norm(a, axis=1, keepdims=True)
    rows = [[f"Linear Accel X = {x:.4f}, Linear Accel Y = {y:.4f}, Linear Accel Z = {z:.4f}"] for x, y, z in without]
    return written(folder / "serial.log", rows)


def field_alone(log: pl.DataFrame, folder: Path) -> str:
    t, a, _ = parts(log)
    return joined(folder / "mag.csv", ["Time (s)", *(f"{x} (µT)" for x in "XYZ")], [*text(t), *text(field(a))])


def euler_angles(log: pl.DataFrame, folder: Path) -> str:
    t, a, _ = parts(log)
    angles = (
        np.column_stack([np.arctan2(a[:, 1], a[:, 2]), np.arcsin(np.clip(a[:, 0] / 10.0, -1, 1)), 0.1 * t]) / DEGREE
    )
    return joined(folder / "euler.csv", ["t", "roll", "pitch", "yaw"], [*text(t), *text(angles)])
