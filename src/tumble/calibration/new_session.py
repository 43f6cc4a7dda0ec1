"""A first session.toml for a log: what its columns, rate and units are, guessed from names and numbers, and said.

Names are taken at their word where they say a unit. Otherwise accelerometers at rest must read gravity, which tells
their unit, and gyros must carry the vertical from rest to rest, which tells theirs (and the rate of a log without
times). What cannot be guessed (serial number, place, programme) is left to be filled in, with a comment.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tumble.calibration.observed import Progress, inspect_session
from tumble.errors import InputError, TumbleError
from tumble.estimation.diagnosis import fitting_gyro_unit
from tumble.files import FilePath, whole_file
from tumble.programme.positions import BUILT_IN
from tumble.recording import formats
from tumble.recording.formats import Sensors
from tumble.recording.formats.columns import ACCEL, GYRO, MAGNETOMETER, columns_by_name
from tumble.recording.formats.message import TIME, Message
from tumble.recording.log import Log
from tumble.recording.readers import log_columns, log_head
from tumble.recording.session import SESSION_FILE, session_of
from tumble.reduction.sphere import sphere_through
from tumble.units import ACCEL_UNITS, G_STANDARD, GYRO_UNITS, TIME_UNITS

LOGS = (".csv", ".gz", ".zst", ".parquet")
"""Endings of files that a session can name as they are."""

_HEAD = 20_000
_LONGEST = 2_000_000
_BLOCK = 50
_TOLERANCE = 0.3
_ASSUMED_RATE = 100.0
_RATES = 2.0, 20_000.0  # Hz, of a log
_FIELDS = {"uT": (15.0, 150.0), "nT": (15e3, 150e3), "gauss": (0.15, 1.5)}  # with iron about


@dataclass(frozen=True, kw_only=True, slots=True)
class Draft:
    """The content of a session.toml as far as it is known, and how each part of it came about, in sentences. A table
    [log.magnetometer] is offered as a comment: iron nearby spoils it, and not the rest."""

    content: Mapping[str, Any]
    said: tuple[str, ...]
    magnetometer: Mapping[str, Any] | None = None


def new_session(
    folder: FilePath,
    log: FilePath,
    *,
    programme: str | None = None,
    message: str | None = None,
    progress: Progress = Log.chunks,
) -> tuple[Draft, list[str]]:
    """Write a commented session.toml for a log into a folder, made if need be; another format than CSV or Parquet
    becomes log.parquet there. Gives what was guessed, and the faults that a look at the recording shows.

    Raises InputError where there is a session already, and for a log that cannot be read or has no accelerometers.

    >>> import tumble
    >>> folder = tumble.simulate_session("simulated", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> draft, faults = tumble.new_session("session", folder / "log.parquet")
    >>> print(draft.said[0], faults)
    time: column 't' in s (by its steps), 100 samples per second []
    """
    folder, log = Path(folder), Path(log)
    path = folder / SESSION_FILE
    if path.exists():
        raise InputError(f"{path}: expected a folder without a session, found one; choose another folder")
    if not log.exists():
        raise InputError(f"{log}: expected a log, found no such file")
    if programme is not None and programme not in BUILT_IN:
        raise InputError(f"--programme: expected one of {', '.join(BUILT_IN)}, found {programme!r}")
    known = log.suffix.lower() in LOGS
    draft = _of_log(log) if known else _of_recording(log, folder / "log.parquet", message)
    draft, faults = _checked(draft, progress)
    folder.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as temporary:
        temporary.write_text(_text(draft, folder, programme), encoding="utf-8")
    return draft, faults


# -------------------- what is known from names and first numbers --------------------


def _of_log(log: Path) -> Draft:
    """From a CSV or Parquet file."""
    names = log_columns(log)
    found = columns_by_name(names)
    if len(names) == 1 and any(mark in names[0] for mark in ";\t"):
        raise InputError(
            f"{log}: expected commas between the columns, found {names[0][:40]!r}; save as CSV with commas"
        )
    if ACCEL not in found.triads:
        raise InputError(
            f"{log}: expected columns named as accelerometers are, such as ax, ay, az or acc_x, acc_y, acc_z; found "
            f"{', '.join(names[:12])}; rename them"
        )
    if len(log_head(log, found.triads[ACCEL].columns[0], 2)) < 2:
        raise InputError(f"{log}: expected rows of readings below the names of the columns, found none")
    time, said = _time(log, found.time, found.time_unit)
    said += [f"also there, and not used: {', '.join(found.others)}"] if found.others else []
    sensors = {kind: found.triads[kind] for kind in (ACCEL, GYRO) if kind in found.triads}
    content, more = _content(log, time, sensors, found.temperature)
    magnetometer, most = _magnetometer(log, found.triads.get(MAGNETOMETER))
    return Draft(content=content, said=(*said, *more, *most), magnetometer=magnetometer)


def _of_recording(recording: Path, log: Path, name: str | None) -> Draft:
    """From another format, whose messages become a Parquet file."""
    found = formats.messages(recording)
    accel = _named(found, name, recording)
    gyro = accel if accel.gyro else next((m for m in found if m.gyro and _pairs(accel, m)), None)
    log.parent.mkdir(parents=True, exist_ok=True)
    formats.as_log(log, accel, gyro)
    said = [f"{recording.name}: message {accel.name}, written to {log}"]
    if gyro is not None and gyro is not accel:
        said.append(f"gyros from {gyro.name}; the accelerometers are interpolated at their times")
    others = [m.name for m in found if m not in (accel, gyro) and m.accel]
    said += [f"also there, and not used: {', '.join(others)} (--message takes another)"] if others else []
    said += [remark for remark in {m.remark: None for m in (accel, gyro) if m is not None} if remark]
    assert accel.accel is not None
    sensors = {ACCEL: accel.accel} | ({GYRO: gyro.gyro} if gyro is not None and gyro.gyro is not None else {})
    time = {"time": TIME} if accel.timed else {"rate_hz": _ASSUMED_RATE}
    content, more = _content(log, time, sensors, accel.temperature)
    magnetometer, most = _magnetometer(log, accel.magnetometer if gyro in (None, accel) else None)
    return Draft(content=content, said=(*said, *more, *most), magnetometer=magnetometer)


def _named(found: list[Message], name: str | None, recording: Path) -> Message:
    with_accel = [m for m in found if m.accel]
    if name is None:
        return max(with_accel, key=lambda m: m.gyro is not None)
    for m in with_accel:
        if m.name == name:
            return m
    raise InputError(f"{recording}: expected a message {name!r}, found {', '.join(m.name for m in with_accel)}")


def _pairs(accel: Message, gyro: Message) -> bool:
    """Whether gyros in another message belong to the accelerometers: of one clock, and the same instance where
    messages are counted."""
    counted = accel.name.rpartition(".")[2], gyro.name.rpartition(".")[2]
    return accel.timed and gyro.timed and (not all(c.isdigit() for c in counted) or counted[0] == counted[1])


def _time(log: Path, column: str | None, unit: str | None) -> tuple[dict[str, Any], list[str]]:
    """The time column and its unit, or a rate."""
    if column is None:
        return {"rate_hz": _ASSUMED_RATE}, [
            f"no time column was found: rate_hz = {_ASSUMED_RATE:g} is a guess, put the log's rate there"
        ]
    step = float(np.median(np.diff(log_head(log, column, _HEAD))))
    likely = [name for name, size in TIME_UNITS.items() if step > 0 and _RATES[0] <= 1.0 / (step * size) <= _RATES[1]]
    taken = unit or next(iter(likely), "s")
    how = "by its name" if unit else "by its steps"
    rate = 1.0 / (step * TIME_UNITS[taken]) if step > 0 else float("nan")
    said = f"time: column {column!r} in {taken} ({how}), {rate:.6g} samples per second"
    return {"time": column, **({"time_unit": taken} if taken != "s" else {})}, [said]


def _content(
    log: Path, time: Mapping[str, Any], sensors: Mapping[str, Sensors], temperature: str | None
) -> tuple[dict[str, Any], list[str]]:
    accel, said = _accel(log, sensors[ACCEL], time)
    table: dict[str, Any] = {"file": str(log.resolve()), **time, "accel": accel}
    if GYRO in sensors:
        table["gyro"], more = _gyro(log, sensors[GYRO], raw=accel["unit"] == "count")
        said += more
    else:
        said.append("no gyros were found: the accelerometers alone will be calibrated")
    if temperature is not None:
        table["temperature"] = {"columns": [temperature], "unit": "degC"}
        said.append(f"temperature: {temperature} in degC")
    return {"format": 1, "device": {"serial": "unknown"}, "log": table}, said


def _accel(log: Path, sensors: Sensors, time: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """The table [log.accel]: the unit in which the median magnitude is gravity."""
    read = np.column_stack([log_head(log, column, _HEAD) for column in sensors.columns])
    magnitude = float(np.nanmedian(np.linalg.norm(read, axis=1)))
    columns = list(sensors.columns)
    named = ", ".join(columns)
    if sensors.unit in ACCEL_UNITS and ACCEL_UNITS[sensors.unit].kind != "raw":
        return {"columns": columns, "unit": sensors.unit}, [
            f"accelerometers: {named} in {sensors.unit} (from the name or the format), magnitude {magnitude:.6g}"
        ]
    for name, unit in ACCEL_UNITS.items():
        rate = _rate(log, time) if unit.kind == "increment" else 1.0
        if unit.kind != "raw" and abs(magnitude * unit.factor * rate / G_STANDARD - 1.0) < _TOLERANCE:
            return {"columns": columns, "unit": name}, [
                f"accelerometers: {named} in {name} (their magnitude is {magnitude:.6g})"
            ]
    offset, scale = _offset_and_scale(log, columns)
    return {"columns": columns, "unit": "count", "scale": scale, "offset": offset}, [
        f"accelerometers: {named} in counts; scale and offset, such that gravity is seen in all positions, are rough: "
        "put those of the data sheet there"
    ]


def _offset_and_scale(log: Path, columns: list[str]) -> tuple[list[float], float]:
    """Centre and radius per m/s² of the sphere of all readings."""
    read = np.column_stack([log_head(log, column, _LONGEST) for column in columns])
    read = read[: len(read) // _BLOCK * _BLOCK].reshape(-1, _BLOCK, 3)
    quiet = read.std(axis=1).max(axis=1)
    a = read.mean(axis=1)[quiet <= np.median(quiet)]
    centre, radius = sphere_through(a)
    return [float(f"{c:.4g}") for c in centre], float(f"{radius / G_STANDARD:.4g}")


def _gyro(log: Path, sensors: Sensors, *, raw: bool) -> tuple[dict[str, Any], list[str]]:
    """The table [log.gyro]; where the accelerometers are in counts, gyros of no named unit are too."""
    columns = list(sensors.columns)
    named = ", ".join(columns)
    if sensors.unit is not None and GYRO_UNITS[sensors.unit].kind != "raw":
        return {"columns": columns, "unit": sensors.unit}, [
            f"gyros: {named} in {sensors.unit} (from the name or the format)"
        ]
    if not raw and sensors.unit is None:
        return {"columns": columns, "unit": "rad/s"}, [f"gyros: {named} in rad/s (a guess)"]
    offset = [float(np.nanmedian(log_head(log, column, _LONGEST))) for column in columns]
    return {"columns": columns, "unit": "count", "scale": 1.0, "scale_per": "deg/s", "offset": offset}, [
        f"gyros: {named} in counts; the offset is their median, the scale is unknown: put that of the data sheet there"
    ]


def _magnetometer(log: Path, sensors: Sensors | None) -> tuple[dict[str, Any] | None, list[str]]:
    """The table [log.magnetometer]: the unit by name, or the one in which the field is one on Earth."""
    if sensors is None:
        return None, []
    read = np.column_stack([log_head(log, column, _HEAD) for column in sensors.columns])
    field = float(np.nanmedian(np.linalg.norm(read, axis=1)))
    likely = [unit for unit, (low, high) in _FIELDS.items() if low <= field <= high]
    unit = sensors.unit or next(iter(likely), None)
    named = ", ".join(sensors.columns)
    if unit is None:
        return None, [f"magnetometers: {named} are left out; their magnitude of {field:.6g} is no field on Earth"]
    said = f"magnetometers: {named} in {unit}, as a comment in the file: take the # away to calibrate them too"
    return {"columns": list(sensors.columns), "unit": unit}, [said]


def _rate(log: Path, time: Mapping[str, Any]) -> float:
    if "rate_hz" in time:
        return float(time["rate_hz"])
    step = float(np.median(np.diff(log_head(log, time["time"], _HEAD))))
    return 1.0 / (step * TIME_UNITS[time.get("time_unit", "s")])


# -------------------- what the recording says of the guesses --------------------


def _checked(draft: Draft, progress: Progress) -> tuple[Draft, list[str]]:
    """A draft with the gyros' unit in which they carry the vertical from rest to rest, and the faults left."""
    unit, faults = _looked_at(draft.content, progress)
    gyro = draft.content["log"].get("gyro")
    if not faults or unit is None or gyro["unit"] == "count":
        return draft, faults
    trial = _with_gyro_unit(draft.content, unit)
    if _looked_at(trial, progress)[1]:
        return draft, faults
    said = f"gyros: in {unit}, not {gyro['unit']}: so they carry the vertical from rest to rest"
    return replace(draft, content=trial, said=(*draft.said, said)), []


def _with_gyro_unit(content: Mapping[str, Any], unit: str) -> dict[str, Any]:
    log = content["log"]
    return {**content, "log": {**log, "gyro": {**log["gyro"], "unit": unit}}}


def _looked_at(content: Mapping[str, Any], progress: Progress) -> tuple[str | None, list[str]]:
    """The unit of the gyros that would fit better than the stated one, and what a look at the recording finds wrong
    with a session of this content."""
    try:
        found = inspect_session(session_of(content), progress=progress)
    except TumbleError as error:
        return None, [str(error)]
    if found.trial is None or not found.faults:
        return None, list(found.faults)
    return fitting_gyro_unit(found.trial, found.session, found.rate), list(found.faults)


# -------------------- the file --------------------


def _text(draft: Draft, folder: Path, programme: str | None) -> str:
    """session.toml with a comment on all that has to be filled in."""
    log = draft.content["log"]
    file = os.path.relpath(log["file"], folder.resolve())
    lines = [
        "format = 1",
        "",
        "[device]",
        f"{_line('serial', folder.resolve().name)}   # the serial number",
        '# model = "…"',
        "",
        "[site]",
        "# latitude_deg = 0.0   # of the place; without it the Earth's rate and local gravity are unknown",
        "# height_m = 0.0",
        "# gravity = 9.80665    # m/s², where it was measured; gravity_u is its standard uncertainty",
        "",
        "[log]",
        _line("file", file),
        *(_line(key, log[key]) for key in ("time", "time_unit", "rate_hz") if key in log),
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


def _line(key: str, value: Any) -> str:
    """A key with its value: numbers, strings and lists are written alike in TOML and JSON."""
    return f"{key} = {json.dumps(value, ensure_ascii=False)}"
