"""A draft of session.toml, and its text with comments on what has to be filled in."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
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
    """Known content of a session.toml, and how each part was found.

    `doubts` are uncertainties, each with its consequence and the option that settles it. `magnetometer` is the table
    [log.magnetometer], written as a comment because nearby iron disturbs its readings. `whole` is True for kinds of
    sensors that read whole numbers only; `rate` is in Hz. `magnitude` is the median length of accelerometer readings in
    the first rows, `largest` that of large gyro readings, both as written; `step` is the resolution of a data sheet,
    °/s, of which their readings are multiples. `kept` are readers of files by path."""

    content: Mapping[str, Any]
    remarks: tuple[str, ...]
    doubts: tuple[str, ...] = ()
    magnetometer: Mapping[str, Any] | None = None
    triads: Mapping[str, Sensors] = field(default_factory=dict)
    times: Times = field(default_factory=lambda: at_rate(ASSUMED_RATE, 0.0))
    whole: Mapping[str, bool] = field(default_factory=dict)
    rate: float = 1.0
    magnitude: float = 1.0
    largest: float = 0.0
    step: float | None = None
    kept: Mapping[Path, LogSource] = field(default_factory=dict)

    @property
    def log(self) -> Mapping[str, Any]:
        """The table [log]."""
        table: Mapping[str, Any] = self.content["log"]
        return table

    @property
    def rate_guessed(self) -> bool:
        """Whether neither a column nor the user states the rate."""
        return bool(self.times.rivals) and not self.times.stamped

    @property
    def files(self) -> tuple[Path, ...]:
        """Paths of the files of the log."""
        file = self.log["file"]
        return tuple(map(Path, [file] if isinstance(file, str) else file))

    def unit(self, kind: str) -> str | None:
        """Return the unit in the column names of a kind of sensor."""
        return self.triads[kind].unit

    def with_log(self, remarks: Sequence[str] = (), /, **tables: Any) -> Draft:
        """Return a copy with tables and keys of [log] replaced, and further remarks."""
        return replace(self, content={**self.content, "log": {**self.log, **tables}}, remarks=(*self.remarks, *remarks))

    def session(self) -> Session:
        """Return the session of the content, without reading files again."""
        session = session_of(self.content) if "accel" in self.log else session_of_gyros(self.content)
        files = tuple(self.kept.get(Path(str(file)), file) for file in session.log.files)
        return replace(session, log=replace(session.log, files=files))


def session_text(draft: Draft, folder: Path, programme: str | None, *, named: bool) -> str:
    """Return the text of session.toml (session.toml.j2); `named` if the user has stated the serial number.

    Numbers, strings and lists are written alike in TOML and JSON."""
    from jinja2 import Environment

    environment = Environment(trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, autoescape=False)
    environment.filters["toml"] = partial(json.dumps, ensure_ascii=False)
    files = [os.path.relpath(file, folder.resolve()) for file in draft.files]
    keys = (
        key
        for key in (*DIALECT_KEYS, "time", "time_unit", "regular", "rate_hz", "clock_ppm_u", "doubt")
        if key in draft.log
    )
    return environment.from_string((Path(__file__).parent / "session.toml.j2").read_text(encoding="utf-8")).render(
        device=draft.content["device"],
        site=draft.content.get("site", {}),
        log={"file": files[0] if len(files) == 1 else files} | {key: draft.log[key] for key in keys},
        doubted=bool(draft.doubts),
        tables={kind: draft.log[kind] for kind in ("accel", "gyro", "temperature") if kind in draft.log},
        magnetometer=draft.magnetometer,
        programme=programme,
        named=named,
    )
