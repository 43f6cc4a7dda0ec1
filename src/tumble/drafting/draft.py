"""A session.toml as far as it is known, and how it is written with comments on all that has to be filled in."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any


@dataclass(frozen=True, kw_only=True, slots=True)
class Draft:
    """The content of a session.toml as far as it is known, and how each part of it came about, in sentences. A table
    [log.magnetometer] is offered as a comment: iron nearby spoils it, and not the rest. Whether the rate is a guess,
    whether the unit of the gyros is, and that of a time column; whether the gyros and the
    accelerometers are whole numbers, as counts are; the rate, Hz, by the times; the median magnitude of what the
    accelerometers read, as written; and whether anything of it is `guessed`: a unit, a time or a column."""

    content: Mapping[str, Any]
    said: tuple[str, ...]
    magnetometer: Mapping[str, Any] | None = None
    rate_guessed: bool = False
    gyro_unknown: bool = False
    time_guessed: bool = False
    gyro_whole: bool = False
    accel_whole: bool = False
    rate: float = 1.0
    accel_magnitude: float = 1.0
    guessed: bool = False


def session_text(draft: Draft, folder: Path, programme: str | None, *, named: bool) -> str:
    """session.toml of a folder, with a comment on all that has to be filled in: the serial number too, unless it was
    `named`."""
    log = draft.content["log"]
    stated = [log["file"]] if isinstance(log["file"], str) else log["file"]
    files = [os.path.relpath(file, folder.resolve()) for file in stated]
    serial = draft.content["device"]["serial"]
    latitude = draft.content.get("site", {}).get("latitude_deg")
    place = "of the place; without it the Earth's rate and local gravity are unknown"
    lines = [
        "format = 1",
        "",
        "[device]",
        _line("serial", serial) + ("" if named else "   # the serial number"),
        '# model = "…"',
        "",
        *_imu_lines(draft.content["device"].get("imu", {})),
        "[site]",
        f"# latitude_deg = 0.0   # {place}" if latitude is None else _line("latitude_deg", latitude),
        "# height_m = 0.0",
        "# gravity = 9.80665    # m/s², where it was measured; gravity_u is its standard uncertainty",
        "",
        "[log]",
        _line("file", files[0] if len(files) == 1 else files),
        *(_line(key, log[key]) for key in _LOG_KEYS if key in log),
        "",
    ]
    for kind in ("accel", "gyro", "temperature"):
        if kind in log:
            lines += [f"[log.{kind}]", *(_line(key, value) for key, value in log[kind].items()), ""]
    if draft.magnetometer is not None:
        lines += ["# [log.magnetometer]", *(f"# {_line(key, value)}" for key, value in draft.magnetometer.items()), ""]
    if programme is None:
        lines += [
            "# the positions, if they were planned: see `tumble programme`",
            "# [programme]",
            '# name = "rough-table"',
        ]
    else:
        lines += ["[programme]", _line("name", programme)]
    return "\n".join(lines) + "\n"


def _imu_lines(imu: Mapping[str, int]) -> list[str]:
    """The table [device.imu]."""
    if not imu:
        return []
    said = "# which sensors of the autopilot these are, from 1, and their device ids: `tumble export` compares them"
    return ["[device.imu]", said, *(_line(key, value) for key, value in imu.items()), ""]


_LOG_KEYS = (
    "delimiter", "decimal", "comment", "header", "encoding", "time", "time_unit", "regular", "rate_hz"
)  # fmt: skip


def _line(key: str, value: Any) -> str:
    """A key with its value: numbers, strings and lists are written alike in TOML and JSON."""
    return f"{key} = {json.dumps(value, ensure_ascii=False)}"
