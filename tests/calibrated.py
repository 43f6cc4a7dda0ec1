"""Calibrations and sessions for the tests of apply, compare and export: small, exact, made without an estimate."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from tumble.calibration.calibration_file import Calibration
from tumble.calibration.results import Parameter
from tumble.estimation.estimate import Outcome
from tumble.recording.session import write_session
from tumble.sensors.frames import Frame
from tumble.sensors.model import Block
from tumble.units import Array

HEXAD = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.6, 0.8, 0], [0, 0.6, 0.8], [0.8, 0, 0.6]], dtype=float)
"""Nominal axes of six sensors."""

SPREAD = {"bias": 0.03, "scale": 0.005, "axis": 0.004}


def calibration(
    seed: int = 1,
    *,
    accel: Array | None = None,
    gyro: Array | None = None,
    with_gyro: bool = True,
    serial: str = "A-0007",
) -> Calibration:
    """An accepted calibration in the frame `accelerometer`: errors as of a MEMS device, correlated uncertainties, and
    nominal axes (n, 3), by default those of the body."""
    rng = np.random.default_rng(seed)
    blocks = [Block(kind="accel", axes=np.eye(3) if accel is None else accel)]
    if with_gyro:
        blocks.append(Block(kind="gyro", axes=np.eye(3) if gyro is None else gyro))
    names = [name for block in blocks for name in block.names]
    units = [unit for block in blocks for unit in block.units]
    spread = np.array([SPREAD[name.split(".")[1]] for name in names])
    values = spread * rng.uniform(-1.0, 1.0, len(names))
    mixing = np.eye(len(names)) + 0.2 * rng.standard_normal((len(names), len(names)))
    covariance = np.outer(spread, spread) * (mixing @ mixing.T) * 1e-4
    u = np.sqrt(np.diag(covariance))
    count = len(blocks[0].names)
    models = [blocks[0].model(values[:count]), blocks[1].model(values[count:]) if with_gyro else None]
    return Calibration(
        serial=serial,
        model="test",
        method="staged",
        frame="accelerometer",
        parameters=tuple(
            Parameter(name=n, value=float(v), u=float(s), unit=unit)
            for n, v, s, unit in zip(names, values, u, units, strict=True)
        ),
        covariance=covariance,
        accel=models[0],
        gyro=models[1],
        outcome=Outcome(),
        provenance={"log_sha256": f"{seed:064x}", "software": "tumble 0.1.0", "created": "2026-05-04T12:00:00+00:00"},
    )


def values_of(made: Calibration) -> dict[str, float]:
    """Parameter values by name."""
    return {p.name: p.value for p in made.parameters}


FRAMES: tuple[Frame, ...] = ("accelerometer", "paper", "symmetric")


def session_of(folder: Path, table: str, log: Mapping[str, object], *, serial: str = "A-0007") -> Path:
    """A session folder around a log table, `log` being [log] of session.toml less the file; returns the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "log.csv").write_text(table, encoding="utf-8")
    write_session(folder, {"format": 1, "device": {"serial": serial}, "log": {"file": "log.csv", **log}})
    return folder


def written(path: Path) -> dict[str, object]:
    """A JSON file."""
    content: dict[str, object] = json.loads(path.read_text(encoding="utf-8"))
    return content
