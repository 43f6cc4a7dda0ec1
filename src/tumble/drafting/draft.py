"""A session.toml as far as it is known, and its text with comments on what has to be filled in."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from tumble.drafting.times import ASSUMED_RATE, Times, at_rate
from tumble.recording.columns.names import Sensors
from tumble.recording.log_source import LogSource
from tumble.recording.session import Session
from tumble.recording.session_file import session_of, session_of_gyros
from tumble.recording.text.dialect import DIALECT_KEYS


@dataclass(frozen=True, kw_only=True, slots=True)
class Draft:
    """Content of a session.toml as far as it is known, and remarks on how each part was determined."""

    content: Mapping[str, Any]
    remarks: tuple[str, ...]
    doubts: tuple[str, ...] = ()
    """What is not sure, each with what hangs on it and how it is settled."""
    magnetometer: Mapping[str, Any] | None = None
    """The table [log.magnetometer], offered as a comment: iron nearby spoils it, and not the rest."""
    triads: Mapping[str, Sensors] = field(default_factory=dict)
    """The columns of the accelerometers, "accel", and of the gyros, "gyro"."""
    times: Times = field(default_factory=lambda: at_rate(ASSUMED_RATE, 0.0))
    """When the rows were taken, and what else it may be."""
    whole: Mapping[str, bool] = field(default_factory=dict)
    """Whether sensors read whole numbers alone, as counts are."""
    rate: float = 1.0
    """Samples per second, Hz."""
    magnitude: float = 1.0
    """The median one of what the accelerometers read in the first rows, as written."""
    largest: float = 0.0
    """What the gyros read at most in the first rows, some single readings aside."""
    step: float | None = None
    """Of data sheets, °/s, of which the gyros' readings are multiples."""
    kept: Mapping[Path, LogSource] = field(default_factory=dict)
    """The files of the log as far as they were read, by their paths."""

    @property
    def log(self) -> Mapping[str, Any]:
        """The table [log]."""
        table: Mapping[str, Any] = self.content["log"]
        return table

    @property
    def rate_guessed(self) -> bool:
        """Whether no column has the times, and no rate is stated."""
        return bool(self.times.rivals) and not self.times.stamped

    @property
    def guessed(self) -> bool:
        """Whether a unit or the times are a guess."""
        return bool(self.times.rivals) or any(sensors.unit is None for sensors in self.triads.values())

    @property
    def files(self) -> tuple[Path, ...]:
        """The files of the log."""
        file = self.log["file"]
        return tuple(map(Path, [file] if isinstance(file, str) else file))

    def unit(self, kind: str) -> str | None:
        """The unit in the names of sensors."""
        return self.triads[kind].unit

    def with_log(self, remarks: Sequence[str] = (), /, **tables: Any) -> Draft:
        """A copy with tables and keys of [log] replaced, and further remarks."""
        return replace(self, content={**self.content, "log": {**self.log, **tables}}, remarks=(*self.remarks, *remarks))

    def session(self) -> Session:
        """The session of the content; files that were read already are not read again."""
        session = session_of(self.content) if "accel" in self.log else session_of_gyros(self.content)
        files = tuple(self.kept.get(Path(str(file)), file) for file in session.log.files)
        return replace(session, log=replace(session.log, files=files))


def session_text(draft: Draft, folder: Path, programme: str | None, *, named: bool) -> str:
    """Text of session.toml, with a comment on what has to be filled in; the serial number too, unless it was
    `named`."""
    log, device = draft.content["log"], draft.content["device"]
    files = [os.path.relpath(file, folder.resolve()) for file in draft.files]
    site = draft.content.get("site", {})
    latitude, height = site.get("latitude_deg"), site.get("height_m")
    comment = "# which sensors of the autopilot these are, from 1, and their device ids: `tumble export` compares them"
    lines = ["format = 1", "", "[device]", _line("serial", device["serial"]) + ("" if named else "   # of the device")]
    lines += ['# model = "…"', ""]
    lines += _table("[device.imu]", device["imu"], comment) if "imu" in device else []
    lines += [
        "[site]",
        "# latitude_deg = 0.0   # of the place; without it the Earth's rate and local gravity are unknown"
        if latitude is None
        else _line("latitude_deg", latitude),
        "# height_m = 0.0       # without it, 1300 m are in the uncertainty of gravity"
        if height is None
        else _line("height_m", height),
        "# gravity = 9.80665    # m/s², where it was measured; gravity_u is its standard uncertainty",
        "",
    ]
    keys = (key for key in (*DIALECT_KEYS, "time", "time_unit", "regular", "rate_hz", "doubt") if key in log)
    settled = ["# a doubt is taken out when it is settled"] if draft.doubts else []
    lines += _table("[log]", {"file": files[0] if len(files) == 1 else files} | {k: log[k] for k in keys}, *settled)
    for kind in ("accel", "gyro", "temperature"):
        lines += _table(f"[log.{kind}]", log[kind]) if kind in log else []
    if draft.magnetometer is not None:
        lines += [f"# {line}".rstrip("# ") for line in _table("[log.magnetometer]", draft.magnetometer)]
    unplanned = [
        "# the positions, if they were planned: see `tumble programme`",
        "# [programme]",
        '# name = "rough-table"',
    ]
    lines += unplanned if programme is None else ["[programme]", _line("name", programme)]
    return "\n".join(lines) + "\n"


def _table(title: str, content: Mapping[str, Any], *comments: str) -> list[str]:
    """Lines of a table, and an empty one."""
    return [title, *comments, *(_line(key, value) for key, value in content.items()), ""]


def _line(key: str, value: Any) -> str:
    """A key with its value: numbers, strings and lists are written alike in TOML and JSON."""
    return f"{key} = {json.dumps(value, ensure_ascii=False)}"
