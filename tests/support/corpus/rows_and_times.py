"""Logs whose times, rates and side columns must not be taken otherwise than they are written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import polars as pl

SENSORS = ("ax", "ay", "az", "gx", "gy", "gz")
Write = Callable[[pl.DataFrame, Path], list[str]]


def steps_of(seconds: float, unit: float, gyro: float) -> Write:
    """Stamps in even steps, and gyros in a unit that nobody names."""

    def write(log: pl.DataFrame, folder: Path) -> list[str]:
        stamps = np.round(np.arange(log.height) * seconds * unit, 6)
        whole = bool((stamps == np.floor(stamps)).all())
        time = pl.Series("time", stamps.astype(np.int64) if whole else stamps)
        log.select(time, "ax", "ay", "az", pl.col("gx", "gy", "gz") * gyro).write_csv(folder / "log.csv")
        return ["log.csv"]

    return write


def intervals(name: str, unit: float) -> Write:
    def write(log: pl.DataFrame, folder: Path) -> list[str]:
        steps = np.diff(log["t"].to_numpy(), prepend=0.0) * unit
        log.select(pl.Series(name, np.round(steps, 6)), *SENSORS).write_csv(folder / "log.csv")
        return ["log.csv"]

    return write


def no_times(*columns: str) -> Write:
    def write(log: pl.DataFrame, folder: Path) -> list[str]:
        log.select(columns).write_csv(folder / "log.csv")
        return ["log.csv"]

    return write


def two_thermometers(ending: str) -> Write:
    """One that reads nothing, and says its unit, before one that does."""

    def write(log: pl.DataFrame, folder: Path) -> list[str]:
        rows = log.with_columns(
            pl.lit(None, dtype=pl.Float64).alias("temp[C]"), (25.0 + pl.int_range(pl.len()) * 1e-4).alias("imu_temp")
        )
        (rows.write_csv if ending == "csv" else rows.write_parquet)(folder / f"log.{ending}")
        return [f"log.{ending}"]

    return write


def rows_of_a_network(at_once: bool) -> Write:
    """Rows of another kind, as wide as those of the sensors, at the times of samples."""

    def write(log: pl.DataFrame, folder: Path) -> list[str]:
        text = log.write_csv().splitlines(keepends=True)
        rows = range(99) if at_once else range(5, log.height, log.height // 99)
        for row in reversed(rows):
            text.insert(row + 1, f"{log['t'][row]},WIFI,aa:bb:cc:dd,-70,home,2412,x\n")
        (folder / "log.csv").write_text("".join(text))
        return ["log.csv"]

    return write


def sentences_named_as_a_recording(log: pl.DataFrame, folder: Path) -> list[str]:
    lines = []
    for _, *read in log.iter_rows():
        body = "VNIMU,+0.1,+0.2,+0.3," + ",".join(f"{v:+.6f}" for v in read) + ",+21.0,+101.3"
        lines.append(f"${body}*{np.bitwise_xor.reduce(np.frombuffer(body.encode(), dtype=np.uint8)):02X}\r\n")
    (folder / "log.bin").write_text("".join(lines))
    return ["log.bin"]


def a_file_a_sensor(time: Callable[[np.ndarray], np.ndarray]) -> Write:
    """A time, x, y and z without names, as phone loggers and imu_tk write them."""

    def write(log: pl.DataFrame, folder: Path) -> list[str]:
        stamps = time(log["t"].to_numpy())
        for name, columns in (("accelerometer.txt", SENSORS[:3]), ("gyroscope.txt", SENSORS[3:])):
            np.savetxt(folder / name, np.column_stack([stamps, log.select(columns).to_numpy()]), fmt="%.9f")
        return ["accelerometer.txt", "gyroscope.txt"]

    return write


def in_other_order(t: np.ndarray) -> np.ndarray:
    """Two rows in a thousand arrive after the next one."""
    out = t.copy()
    for row in range(300, len(t) - 1, 1000):
        out[[row, row + 1]] = out[[row + 1, row]]
    return out
