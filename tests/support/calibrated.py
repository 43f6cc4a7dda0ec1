"""Calibrations and sessions for the tests of apply, compare and export: small, exact, made without an estimate."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tumble.inference.estimate import Outcome
from tumble.recording.session_file import write_session
from tumble.result.calibration import Calibration
from tumble.result.parts import CalibratedDevice, CalibratedTemperature, Parameter, Provenance, RestResult
from tumble.sensors.frames import Frame
from tumble.sensors.model import Block
from tumble.sensors.parameters import units_of
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
    units = units_of(names)
    spread = np.array([SPREAD[name.split(".")[1]] for name in names])
    values = spread * rng.uniform(-1.0, 1.0, len(names))
    mixing = np.eye(len(names)) + 0.2 * rng.standard_normal((len(names), len(names)))
    covariance = np.outer(spread, spread) * (mixing @ mixing.T) * 1e-4
    u = np.sqrt(np.diag(covariance))
    count = len(blocks[0].names)
    models = [blocks[0].model(values[:count]), blocks[1].model(values[count:]) if with_gyro else None]
    return Calibration(
        device=CalibratedDevice(serial=serial, model="test"),
        method="scalar",
        frame="accelerometer",
        parameters=tuple(
            Parameter(name=n, value=float(v), u=float(s), unit=unit)
            for n, v, s, unit in zip(names, values, u, units, strict=True)
        ),
        covariance=covariance,
        accel=models[0],
        gyro=models[1],
        outcome=Outcome(),
        provenance=Provenance(log_sha256=f"{seed:064x}", software="tumble 0.1.0", created="2026-05-04T12:00:00+00:00"),
    )


def with_fields(calibration: Calibration, **changes: Any) -> Calibration:
    """The calibration with other fields, also of its evidence and its provenance."""

    def part(record: Any) -> dict[str, Any]:
        return {name: value for name, value in changes.items() if name in record.__dataclass_fields__}

    evidence, provenance = calibration.evidence, calibration.provenance
    parts: dict[str, Any] = {
        "evidence": replace(evidence, **part(evidence)),
        "provenance": replace(provenance, **part(provenance)),
    }
    return replace(calibration, **parts | part(calibration))


def of_device(calibration: Calibration, **changes: Any) -> Calibration:
    """The calibration, as that of a device with these changes."""
    return replace(calibration, device=replace(calibration.device, **changes))


SLOPES = {
    "accel.bias": (3e-3, 2e-5, "m/s^2"),
    "accel.scale": (1.5e-4, 8e-7, "1"),
    "gyro.bias": (4e-4, 3e-6, "rad/s"),
    "gyro.scale": (2e-4, 1e-6, "1"),
}
"""Largest change per K and per K², as of a MEMS device, and the unit."""


def warmed(
    made: Calibration, *, low: float = -18.5, high: float = 57.25, curved: bool = True, seed: int = 7
) -> Calibration:
    """A calibration whose biases and scale factors change with temperature, linearly or also with its square, measured
    at four rests from `low` to `high`, °C; its values are those at the rests' mean."""
    rng = np.random.default_rng(seed)
    more = []
    for p in made.parameters:
        slope, square, unit = SLOPES.get(".".join(p.name.split(".")[:2]), (0.0, 0.0, ""))
        for degree, size in enumerate((slope, square) if curved else (slope,), 1):
            if size:
                value = float(size * rng.uniform(-1.0, 1.0))
                per = "K" if degree == 1 else "K^2"
                unit_of_it = f"{unit}/{per}" if unit != "1" else f"1/{per}"
                more.append(Parameter(name=f"{p.name}.t{degree}", value=value, u=0.05 * size, unit=unit_of_it))
    covariance = made.covariance
    if covariance is not None:
        covariance = np.pad(covariance, (0, len(more)))
        at = np.arange(len(made.parameters), len(covariance))
        covariance[at, at] = [(p.u or 0.0) ** 2 for p in more]
    degrees = np.linspace(low, high, 4)
    rests = tuple(
        RestResult(file=0, start=60.0 * i, stop=60.0 * i + 50.0, residual=0.0, sigmas=0.0, temperature=float(T))
        for i, T in enumerate(degrees)
    )
    return with_fields(
        made,
        parameters=(*made.parameters, *more),
        covariance=covariance,
        rests=rests,
        temperature=CalibratedTemperature(reference=float(degrees.mean())),
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
