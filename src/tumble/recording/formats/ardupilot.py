"""ArduPilot flight logs (.bin, or as text, .log): the messages IMU (accelerometers and gyros of an instance), and ACC
and GYR (raw, at the sensors' own rate), an entry for each instance.

ArduPilot subtracts its own offsets and divides by its own scales before it logs: they are to be reset before recording.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from pymavlink.DFReader import DFReader_binary, DFReader_text

from tumble.recording.autopilot import AutopilotSensor
from tumble.recording.formats.message import AXES, TIME, Message, triad
from tumble.recording.panic import COMMAND_LINE

NOTHING = "no messages IMU or ACC; set bit 'IMU' of LOG_BITMASK and record again"

_STDERR = 2
_PARAMETER = "PARM"
_NAMED_INSIDE = 3  # INS_ACC3_ID, but INS4_ACC_ID
_SECOND = 1e-6  # times are in µs
_REMARK = (
    "ArduPilot has applied its own INS_ACCOFFS, INS_ACCSCAL and INS_GYROFFS to these readings: reset them to 0 and 1 "
    "before recording, and set INS_TCAL1_ENABLE to 0"
)
_TEMPERATURE = "temperature"
_ACCEL = {f"accel_{a}": f"Acc{a.upper()}" for a in AXES}
_GYRO = {f"gyro_{a}": f"Gyr{a.upper()}" for a in AXES}
_FIELDS = {"IMU": _ACCEL | _GYRO, "ACC": _ACCEL, "GYR": _GYRO}


def messages(path: Path) -> list[Message]:
    """Messages with inertial sensors, an entry for each instance; read at one pass."""
    kept: dict[tuple[str, int], list[list[float]]] = {}
    ids: dict[str, int] = {}
    with _silent():
        log = DFReader_binary(str(path)) if path.suffix.lower() == ".bin" else DFReader_text(str(path))
        try:
            while (message := log.recv_match(type=[*_FIELDS, _PARAMETER])) is not None:
                kind = message.get_type()
                if kind == _PARAMETER:
                    ids |= {message.Name: int(message.Value)} if message.Name.endswith("_ID") else {}
                    continue
                kept.setdefault((kind, int(message.I)), []).append(_reading(kind, message))
        finally:
            log.close()
    origin = min((rows[0][0] for rows in kept.values()), default=0.0)
    return [_message(kind, instance, np.array(rows), origin, ids) for (kind, instance), rows in sorted(kept.items())]


@contextmanager
def _silent() -> Iterator[None]:
    """In a command, nothing is printed: pymavlink prints a line for every byte that it skips, from Python and from
    C."""
    if not COMMAND_LINE.get():
        yield
        return
    with Path(os.devnull).open("w", encoding="utf-8") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
        kept = os.dup(_STDERR)
        os.dup2(nowhere.fileno(), _STDERR)
        try:
            yield
        finally:
            os.dup2(kept, _STDERR)
            os.close(kept)


def _reading(kind: str, message: Any) -> list[float]:
    taken = getattr(message, "SampleUS", message.TimeUS)
    temperature = [getattr(message, "T", math.nan)] if kind == "IMU" else []
    return [taken, *(getattr(message, field) for field in _FIELDS[kind].values()), *temperature]


def _message(kind: str, instance: int, rows: Any, origin: float, ids: Mapping[str, int]) -> Message:
    """Rows of one instance; its number among the sensors is that of the instance, and their ids are parameters."""
    rows[:, 0] = (rows[:, 0] - origin) * _SECOND
    names = [TIME, *_FIELDS[kind]]
    warm = kind == "IMU" and bool(np.isfinite(rows[:, -1]).all() and rows[:, -1].any())  # 0: no thermometer
    names += [_TEMPERATURE] if warm else []
    number = instance + 1
    prefix, counted = ("INS", "" if number == 1 else str(number)) if number <= _NAMED_INSIDE else (f"INS{number}", "")
    return Message(
        name=f"{kind}.{instance}",
        count=len(rows),
        accel=None if kind == "GYR" else triad("accel", "m/s^2"),
        gyro=None if kind == "ACC" else triad("gyro", "rad/s"),
        temperatures=(_TEMPERATURE,) if warm else (),
        rows=partial(_tables, rows[:, : len(names)], names),
        remark=_REMARK,
        imu={
            sensor: AutopilotSensor(number=number, id=ids.get(f"{prefix}_{word}{counted}_ID") or None)
            for sensor, word in (("accel", "ACC"), ("gyro", "GYR"))
            if kind in ("IMU", word)
        },
    )


def _tables(rows: Any, names: list[str]) -> Iterator[pl.DataFrame]:
    yield pl.DataFrame(rows, schema=names, orient="row")
