"""Calibration files for the tests of the registry."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from tumble.lab.registry.records import Record, State
from tumble.lab.registry.registry import Registry
from tumble.result.calibration import Calibration, calibration_of
from tumble.sensors.model import Block
from tumble.sensors.parameters import units_of

ACCEL = Block(kind="accel", axes=np.eye(3))
GYRO = Block(kind="gyro", axes=np.eye(3))
NAMES = (*ACCEL.names, *GYRO.names)
UNITS = units_of(NAMES)
U = {"m/s^2": 1e-5, "1": 2e-6, "rad": 3e-6, "rad/s": 1e-7}
"""Standard uncertainties by SI unit, where a test gives none."""


def content(
    *,
    serial: str = "A-0007",
    model: str | None = "BCHE-501",
    values: Mapping[str, float] | None = None,
    u: Mapping[str, float] | None = None,
    created: str = "2026-03-01T12:00:00+00:00",
    log: str = "log",
    launches: Sequence[Mapping[str, float]] = (),
    frame: str = "accelerometer",
) -> dict[str, Any]:
    """What is in a calibration file: parameters are zero but for `values`, of the result and of each launch. `log`
    stands for the log and makes its hash."""
    parameters = _parameters(values or {}, u or {})
    covariance = np.diag([p["u"] ** 2 for p in parameters]).tolist()
    vector = np.array([p["value"] for p in parameters])
    accel, gyro = ACCEL.model(vector[:9]), GYRO.model(vector[9:])
    return {
        "format": 1,
        "device": {"serial": serial, "model": model},
        "method": "scalar",
        "frame": frame,
        "parameters": parameters,
        "covariance": covariance,
        "accel": {"matrix": accel.matrix.tolist(), "bias": accel.bias.tolist(), "unit": "m/s^2"},
        "gyro": {"matrix": gyro.matrix.tolist(), "bias": gyro.bias.tolist(), "unit": "rad/s"},
        "outcome": {"accepted": True, "reasons": [], "unobservable": []},
        "iterations": [],
        "rests": [],
        "launches": [
            {
                "session": f"run-{i}",
                "parameters": _parameters(own, u or {}),
                "covariance": covariance,
                "log_sha256": digest(f"{log}-{i}"),
            }
            for i, own in enumerate(launches, 1)
        ],
        "provenance": {"log_sha256": digest(log), "software": "tumble 0.1.0", "created": created},
    }


def _parameters(values: Mapping[str, float], u: Mapping[str, float]) -> list[dict[str, Any]]:
    assert set(values) | set(u) <= set(NAMES)
    return [
        {"name": name, "value": values.get(name, 0.0), "u": u.get(name, U[unit]), "unit": unit}
        for name, unit in zip(NAMES, UNITS, strict=True)
    ]


def digest(text: str) -> str:
    """SHA-256 of a text."""
    return hashlib.sha256(text.encode()).hexdigest()


def write(path: Path, whole: Mapping[str, Any]) -> Path:
    """A calibration file with this content."""
    path.write_text(json.dumps(whole), encoding="utf-8")
    return path


def added(
    registry: Registry,
    *,
    performed: datetime | None = None,
    occasion: Any = None,
    state: State = "unchanged",
    **what: Any,
) -> Record:
    """The record of a calibration with `what` in it."""
    made = calibration(**what)
    return registry.add_calibration(made, performed=performed, occasion=occasion, state=state)


def calibration(**what: Any) -> Calibration:
    """The calibration of a content."""
    return calibration_of(json.dumps(content(**what)), "file")
