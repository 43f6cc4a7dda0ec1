"""A first session.toml for a log: what its columns, rate and units are, guessed from names and numbers, and said.

Names are taken at their word where they say a unit. Otherwise accelerometers at rest must read gravity, which tells
their unit, and gyros must carry the vertical from rest to rest, which tells theirs, the scale of counts, and the rate
of a log without times. What cannot be guessed (serial number, place, programme) is left to be filled in, with a
comment.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tumble.calibration.found_log import FoundLog, files_of, found_log, mended, times_of
from tumble.calibration.log_times import Times
from tumble.calibration.observed import Progress, inspect_session
from tumble.calibration.raw_scale import accel_scale, counts_per_deg_s, counts_per_g, gyro_factor
from tumble.errors import InputError, TumbleError
from tumble.estimation.diagnosis import fitting_gyro_unit
from tumble.files import FilePath, nothing_left, whole_file
from tumble.programme.positions import BUILT_IN
from tumble.recording import formats
from tumble.recording.autopilot import sensors_content
from tumble.recording.formats import Sensors
from tumble.recording.formats.columns import ACCEL, GYRO, MAGNETOMETER, Columns, temperature_unit
from tumble.recording.formats.message import TIME, Message
from tumble.recording.log import Log
from tumble.recording.session import SESSION_FILE, session_of
from tumble.recording.session_keys import TemperatureTable
from tumble.reduction.observations import Observations
from tumble.units import ACCEL_UNITS, DEGREE, G_STANDARD, GYRO_UNITS, TEMPERATURE_UNITS

_HEAD = 20_000
_TOLERANCE = 0.3
_SOFT = 0.03
_FIELDS = {"uT": (15.0, 150.0), "nT": (15e3, 150e3), "gauss": (0.15, 1.5)}  # with iron about
_LIKELY = {"degC": (-80.0, 150.0), "K": (190.0, 430.0)}  # of the middle temperature of a recording
_LOW_RATES = 10, 12.5, 20, 25, 26, 50, 51.2, 52, 60, 62.5, 64, 100, 102.4, 104, 119, 120, 125, 128, 200, 204.8, 208
_HIGH_RATES = 238, 240, 250, 256, 300, 400, 416, 476, 500, 512, 800, 833, 952, 1000, 1024, 1600, 1660, 2000, 4000, 8000
_USUAL_RATES = np.array([*_LOW_RATES, *_HIGH_RATES])  # Hz
_RATE_NEAR = 0.04
_SLOW_RATE = 25.0  # Hz
_LARGEST_BIAS = 20.0  # deg/s: what reads more at rest has an offset


@dataclass(frozen=True, kw_only=True, slots=True)
class Draft:
    """The content of a session.toml as far as it is known, and how each part of it came about, in sentences. A table
    [log.magnetometer] is offered as a comment: iron nearby spoils it, and not the rest. Whether the rate is a guess,
    and whether the unit of the gyros is."""

    content: Mapping[str, Any]
    said: tuple[str, ...]
    magnetometer: Mapping[str, Any] | None = None
    rate_guessed: bool = False
    gyro_unknown: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class Given:
    """What the user knows: serial number, latitude (°), rate (Hz), programme and message of a recording."""

    serial: str | None = None
    latitude: float | None = None
    rate: float | None = None
    programme: str | None = None
    message: str | None = None


NOTHING_GIVEN = Given()


def new_session(
    folder: FilePath,
    logs: FilePath | Sequence[FilePath],
    given: Given = NOTHING_GIVEN,
    *,
    progress: Progress = Log.chunks,
) -> tuple[Draft, list[str]]:
    """Write a commented session.toml for logs into a folder, made if need be: files, folders of files, patterns. What a
    session file cannot say of them is mended in a copy there, and so are other formats than text and Parquet. Gives
    what was guessed, and the faults that a look at the recording shows.

    Raises InputError, and leaves no folder behind, where there is a session already, and for a log that cannot be
    read or has no accelerometers.

    >>> import tumble
    >>> folder = tumble.simulate_session("simulated", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> draft, faults = tumble.new_session("session", folder / "log.parquet")
    >>> print(draft.said[0], faults)
    time: column 't' in s (by its steps), 100 samples per second []
    """
    folder = Path(folder)
    path = folder / SESSION_FILE
    if path.exists():
        raise InputError(f"{path}: expected a folder without a session, found one; choose another folder")
    listed = [logs] if isinstance(logs, str | os.PathLike) else logs
    files = [file for log in listed for file in files_of(Path(log))]
    if given.programme is not None and given.programme not in BUILT_IN:
        raise InputError(f"--programme: expected one of {', '.join(BUILT_IN)}, found {given.programme!r}")
    if given.latitude is not None and not -90.0 <= given.latitude <= 90.0:
        raise InputError(f"--latitude: expected a number from -90 to 90, found {given.latitude:g}")
    if given.rate is not None and not 0.0 < given.rate < 1e9:
        raise InputError(f"--rate: expected a positive number, found {given.rate:g}")
    with nothing_left(folder):
        draft = _of_files(files, folder, given)
        draft, faults = _checked(_scaled(draft, progress), progress)
        draft, faults = _with_rate(draft, faults, progress)
        draft = replace(draft, content=_with_given(draft.content, folder, given))
        folder.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as temporary:
            temporary.write_text(_text(draft, folder, given), encoding="utf-8")
    return draft, faults


# -------------------- what is known from names and first numbers --------------------


def _of_files(files: list[Path], folder: Path, given: Given) -> Draft:
    recordings = [f for f in files if f.suffix.lower() in formats.ENDINGS or f.is_dir()]
    if not recordings:
        log = mended(found_log(files, folder), folder, given.rate)
        return _of_log(log, times_of(log, given.rate), given.rate)
    if len(files) > 1:
        raise InputError(
            f"{recordings[0]}: expected one recording, found {len(files)} files; give each its own session"
        )
    return _of_recording(recordings[0], folder, given)


def _of_log(log: FoundLog, times: Times, rate: float | None) -> Draft:
    """From text and Parquet files."""
    found = log.columns
    said = [*log.said, *times.said]
    if rate is not None and found.time is not None:
        said.append(f"time: column {found.time!r} is not used, since the rate was given")
    said += [f"also there, and not used: {', '.join(found.others)}"] if found.others else []
    content, more, unknown = _content(log, times, found)
    magnetometer, most = _magnetometer(log, found.triads.get(MAGNETOMETER))
    return Draft(
        content=content,
        said=(*said, *more, *most),
        magnetometer=magnetometer,
        rate_guessed=times.guessed,
        gyro_unknown=unknown,
    )


def _of_recording(recording: Path, folder: Path, given: Given) -> Draft:
    """From another format, whose messages become a Parquet file."""
    found = formats.messages(recording)
    accel = _named(found, given.message, recording)
    gyro = accel if accel.gyro else next((m for m in found if m.gyro and _pairs(accel, m)), None)
    log = folder / "log.parquet"
    folder.mkdir(parents=True, exist_ok=True)
    apart = [] if _temperatures(accel, gyro, None) else [m for m in found if m.thermometer]
    thermometer = max(apart, key=lambda m: _shared(m.name, accel.name), default=None)
    formats.as_log(log, accel, gyro, thermometer)
    said = [f"{recording.name}: message {accel.name}, written to {log}"]
    said += [] if thermometer is None else [f"temperature from {thermometer.name}, interpolated"]
    unused = [m.name for m in apart if m is not thermometer]
    said += [f"other thermometers, not used: {', '.join(unused)}"] if unused else []
    if gyro is not None and gyro is not accel:
        said.append(f"gyros from {gyro.name}; the accelerometers are interpolated at their times")
    others = [m.name for m in found if m not in (accel, gyro) and m.accel]
    said += [f"also there, and not used: {', '.join(others)} (--message takes another)"] if others else []
    said += [remark for remark in {m.remark: None for m in (accel, gyro) if m is not None} if remark]
    triads = {ACCEL: accel.accel, GYRO: gyro.gyro if gyro is not None else None}
    triads |= {MAGNETOMETER: accel.magnetometer if gyro in (None, accel) else None}
    columns = Columns(
        time=TIME if accel.timed else None,
        time_unit=None,
        triads={kind: sensors for kind, sensors in triads.items() if sensors is not None},
        temperatures=_temperatures(accel, gyro, thermometer),
        others=(),
    )
    written = mended(FoundLog(files=(log,), keys={}, columns=columns, said=tuple(said)), folder, given.rate)
    draft = _of_log(written, times_of(written, given.rate), given.rate)
    imu = {kind: sensor for m in (gyro, accel) if m is not None for kind, sensor in m.imu.items()}
    return replace(draft, content={**draft.content, "device": {"imu": sensors_content(imu)}} if imu else draft.content)


def _shared(name: str, other: str) -> int:
    """How many parts, between slashes, two topics begin with alike."""
    alike = [a == b for a, b in zip(name.split("/"), other.split("/"), strict=False)]
    return next((i for i, same in enumerate(alike) if not same), len(alike))


def _temperatures(accel: Message, gyro: Message | None, thermometer: Message | None) -> tuple[str, ...]:
    """The columns of the temperatures: beside the accelerometers and beside the gyros, or in a message of its own."""
    beside = [m.temperatures for m in {id(m): m for m in (accel, gyro) if m is not None}.values() if m.temperatures]
    if len(beside) == 2 and max(map(len, beside)) == 1:
        return beside[0] + beside[1]
    return next(iter(beside), () if thermometer is None else thermometer.temperatures)


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
    return accel.timed and gyro.timed and (not all(c.isdecimal() for c in counted) or counted[0] == counted[1])


def _content(log: FoundLog, times: Times, found: Columns) -> tuple[dict[str, Any], list[str], bool]:
    """The tables of session.toml, what there is to say, and whether the unit of the gyros is unknown."""
    accel, said = _accel(log, found.triads[ACCEL], times)
    files = [str(file.resolve()) for file in log.files]
    table: dict[str, Any] = {"file": files[0] if len(files) == 1 else files, **log.keys, **times.keys, "accel": accel}
    unknown = False
    if GYRO in found.triads:
        table["gyro"], more, unknown = _gyro(found.triads[GYRO], raw=accel["unit"] == "count")
        said += more
    else:
        said.append("no gyros were found: the accelerometers alone will be calibrated")
    if found.temperatures:
        thermometers, remark = _thermometers(log, found.temperatures)
        table |= {} if thermometers is None else {"temperature": thermometers}
        said.append(remark)
    return {"format": 1, "device": {"serial": "unknown"}, "log": table}, said, unknown


def _thermometers(log: FoundLog, columns: Sequence[str]) -> tuple[dict[str, Any] | None, str]:
    """The table [log.temperature], None where numbers are raw. Columns in several units are, as raw ones, with what
    their numbers are worth."""
    found = {column: _temperature_unit(log, column) for column in columns}
    listed, units = list(columns), [found[column][0] for column in columns]
    whose = {1: "", 2: ", accelerometers and gyros"}.get(len(listed), ", one a sensor, accelerometers first")
    said = ", ".join(f"{column} in {unit} ({how})" for column, (unit, how, _) in found.items())
    if TemperatureTable.RAW in units:
        column = listed[units.index(TemperatureTable.RAW)]
        return None, (
            f"temperature: {column}, about {found[column][2]:.6g}, in no unit that is known; to use it, add "
            f'[log.temperature] with columns = {json.dumps(listed)}, unit = "raw", scale, raw numbers per degC, and '
            "offset, that at 0 degC"
        )
    table: dict[str, Any] = {"columns": listed, "unit": units[0]}
    if len(set(units)) > 1:
        worth = [TEMPERATURE_UNITS[unit] for unit in units]
        scale, offset = [1.0 / gain for gain, _ in worth], [-shift / gain for gain, shift in worth]
        table |= {"unit": TemperatureTable.RAW, "scale": scale, "offset": offset}
    return table, f"temperature: {said}{whose}"


def _temperature_unit(log: FoundLog, column: str) -> tuple[str, str, float]:
    """The unit that the name of a column says, or in which its numbers are temperatures of the air on Earth or of a
    chamber; how it was found; and their median."""
    middle = float(np.nanmedian(log.read([column], rows=_HEAD)))
    named = temperature_unit(column)
    if named is not None:
        return named, "from the name", middle
    likely = next((unit for unit, (low, high) in _LIKELY.items() if low <= middle <= high), TemperatureTable.RAW)
    return likely, "by its numbers", middle


def _accel(log: FoundLog, sensors: Sensors, times: Times) -> tuple[dict[str, Any], list[str]]:
    """The table [log.accel]: the unit in which the median magnitude is gravity; of counts, with a scale of one."""
    read = log.read(sensors.columns, rows=_HEAD)
    magnitude = float(np.nanmedian(np.linalg.norm(read, axis=1)))
    columns = list(sensors.columns)
    named = ", ".join(columns)
    if sensors.unit in ACCEL_UNITS and ACCEL_UNITS[sensors.unit].kind != "raw":
        said = [f"accelerometers: {named} in {sensors.unit} (from the name or the format), magnitude {magnitude:.6g}"]
        unit = ACCEL_UNITS[sensors.unit]
        rate = times.rate if unit.kind == "increment" else 1.0
        if abs(magnitude * unit.factor * rate / G_STANDARD - 1.0) > _TOLERANCE:
            said.append(f"accelerometers: their magnitude is not that of gravity in {sensors.unit}: is the unit right?")
        return {"columns": columns, "unit": sensors.unit}, said
    for name, unit in ACCEL_UNITS.items():
        rate = times.rate if unit.kind == "increment" else 1.0
        named_raw = sensors.unit is not None and ACCEL_UNITS[sensors.unit].kind == "raw"
        if named_raw or unit.kind == "raw" or abs(magnitude * unit.factor * rate / G_STANDARD - 1.0) >= _TOLERANCE:
            continue
        also = "; 1024 counts per g are possible too" if name == "mg" and abs(magnitude / 1024.0 - 1.0) < _SOFT else ""
        found = f"accelerometers: {named} in {name} (their magnitude is {magnitude:.6g}){also}"
        return {"columns": columns, "unit": name}, [found]
    return {"columns": columns, "unit": "count", "scale": 1.0, "scale_per": "m/s^2", "offset": 0.0}, []


def _gyro(sensors: Sensors, *, raw: bool) -> tuple[dict[str, Any], list[str], bool]:
    """The table [log.gyro]; where the accelerometers are in counts, gyros of no named unit are too."""
    columns = list(sensors.columns)
    named = ", ".join(columns)
    if sensors.unit == "mdps":
        return (
            {"columns": columns, "unit": "count", "scale": 1000.0, "scale_per": "deg/s"},
            [f"gyros: {named} in thousandths of deg/s (from the name)"],
            False,
        )
    if sensors.unit is not None and GYRO_UNITS[sensors.unit].kind != "raw":
        return (
            {"columns": columns, "unit": sensors.unit},
            [f"gyros: {named} in {sensors.unit} (from the name or the format)"],
            False,
        )
    if not raw and sensors.unit is None:
        return {"columns": columns, "unit": "rad/s"}, [f"gyros: {named} in rad/s (a guess)"], True
    table = {"columns": columns, "unit": "count", "scale": 1.0, "scale_per": "deg/s", "offset": 0.0}
    return table, [], True


def _magnetometer(log: FoundLog, sensors: Sensors | None) -> tuple[dict[str, Any] | None, list[str]]:
    """The table [log.magnetometer]: the unit by name, or the one in which the field is one on Earth."""
    if sensors is None:
        return None, []
    read = log.read(sensors.columns, rows=_HEAD)
    field = float(np.nanmedian(np.linalg.norm(read, axis=1)))
    likely = [unit for unit, (low, high) in _FIELDS.items() if low <= field <= high]
    unit = sensors.unit or next(iter(likely), None)
    named = ", ".join(sensors.columns)
    if unit is None:
        return None, [f"magnetometers: {named} are left out; their magnitude of {field:.6g} is no field on Earth"]
    said = f"magnetometers: {named} in {unit}, as a comment in the file: take the # away to calibrate them too"
    return {"columns": list(sensors.columns), "unit": unit}, [said]


def _with_given(content: Mapping[str, Any], folder: Path, given: Given) -> dict[str, Any]:
    """A content with serial number and latitude: as given, the former else by the folder's name."""
    site = {"site": {"latitude_deg": given.latitude}} if given.latitude is not None else {}
    device = {**content.get("device", {}), "serial": given.serial or folder.resolve().name or "unknown"}
    out = {**content, "device": device, **site}
    session_of(out)  # checked as a session is
    return out


# -------------------- counts and rates, from rests and turns --------------------


def _scaled(draft: Draft, progress: Progress) -> Draft:
    """A draft with the scales of counts, and the rate of a log without times, as rests and turns show them."""
    log = draft.content["log"]
    gyro = log.get("gyro")
    raw_gyro = gyro is not None and draft.gyro_unknown and gyro["unit"] == "count"
    raw_accel = log["accel"]["unit"] == "count"
    if not (raw_accel or raw_gyro):
        return draft
    observations = _observed(draft.content, progress)
    said: list[str] = []
    if raw_accel:
        log, more = _accel_scaled(log, observations, progress, draft)
        said += more
    if raw_gyro:
        content = {**draft.content, "log": log}
        observations = _observed(content, progress) if raw_accel else observations
        log, more = _gyro_scaled(content, observations, progress)
        said += more
    return replace(draft, content={**draft.content, "log": log}, said=(*draft.said, *said))


def _observed(content: Mapping[str, Any], progress: Progress) -> Observations | None:
    """Rests and turns of a session of this content; None where there are none."""
    try:
        return inspect_session(session_of(content), progress=progress).observations
    except (TumbleError, np.linalg.LinAlgError):
        return None


def _accel_scaled(
    log: Mapping[str, Any], observations: Observations | None, progress: Progress, draft: Draft
) -> tuple[dict[str, Any], list[str]]:
    """[log] with the scale and offset of accelerometers in counts, from the rests."""
    accel, named = log["accel"], ", ".join(log["accel"]["columns"])
    if observations is None and "gyro" in log:  # gyros in counts can hide the rests: the accelerometers alone show them
        alone = {key: value for key, value in log.items() if key != "gyro"}
        observations = _observed({**draft.content, "log": alone}, progress)
    means = observations.rests.accel if observations is not None else np.empty((0, 3))
    sphere = accel_scale(means)
    if sphere is None:
        radius = float(np.median(np.linalg.norm(means, axis=1))) if len(means) else 1.0
        sphere = radius, [0.0] * 3
    scale = counts_per_g(sphere[0])
    seen = f"from {len(means)} rests" if len(means) >= 4 else "a guess from too few rests: state the data sheet's"
    offset: Any = sphere[1][0] if len(set(sphere[1])) == 1 else sphere[1]
    made = {"columns": accel["columns"], "unit": "count", "scale": scale.value, "scale_per": "g", "offset": offset}
    return {**log, "accel": made}, [f"accelerometers: {named} in counts: {scale.said}, zero at {offset} ({seen})"]


def _gyro_scaled(
    content: Mapping[str, Any], observations: Observations | None, progress: Progress
) -> tuple[dict[str, Any], list[str]]:
    """[log] with the scale of gyros in counts, from the turns; the offset is none or the mean at rest."""
    log = content["log"]
    gyro, named = log["gyro"], ", ".join(log["gyro"]["columns"])
    bias = np.zeros(3) if observations is None else np.median(observations.rests.gyro, axis=0) / DEGREE
    centred = {**gyro, "offset": [float(f"{b:.6g}") for b in bias]}
    observations = _observed({**content, "log": {**log, "gyro": centred}}, progress)
    factor = None if observations is None else gyro_factor(observations)
    if factor is None:
        said = (
            f"gyros: {named} in counts; the offset is their reading at rest, the scale is unknown, for no turns show "
            "it: put that of the data sheet there"
        )
        return {**log, "gyro": centred}, [said]
    scale = counts_per_deg_s(factor / DEGREE)
    high = float(np.abs(bias).max()) > _LARGEST_BIAS * scale.value
    made = {**(centred if high else gyro), "scale": scale.value}
    return {**log, "gyro": made}, [f"gyros: {named} in counts: {scale.said} (from the turns)"]


def _with_rate(draft: Draft, faults: list[str], progress: Progress) -> tuple[Draft, list[str]]:
    """A draft whose rate, if it is a guess, is that at which gyros in a known unit carry the vertical from rest to
    rest."""
    log = draft.content["log"]
    if not draft.rate_guessed or "gyro" not in log or log["gyro"]["unit"] == "count":
        return draft, faults
    found = None
    for trial in (log["rate_hz"], _SLOW_RATE):  # at too high a rate rests would be too short to be any
        observations = _observed({**draft.content, "log": {**log, "rate_hz": trial}}, progress)
        factor = None if observations is None else gyro_factor(observations)
        found = trial * factor if found is None and factor is not None else found
    if found is None:
        return draft, faults
    near = _USUAL_RATES[np.argmin(np.abs(np.log(_USUAL_RATES / found)))]
    rate = float(near) if abs(near / found - 1.0) < _RATE_NEAR else float(f"{found:.4g}")
    seen = f"rate_hz = {rate:g} from the turns ({found:.4g} found)"
    said = f"time: {seen}: a guess to some percent"
    said += "; put the log's rate there"
    content = {**draft.content, "log": {**log, "rate_hz": rate}}
    return replace(draft, content=content, said=(*draft.said, said)), _looked_at(content, progress)[1]


# -------------------- what the recording says of the guesses --------------------


def _checked(draft: Draft, progress: Progress) -> tuple[Draft, list[str]]:
    """A draft with the gyros' unit in which they carry the vertical from rest to rest, and the faults left."""
    unit, faults = _looked_at(draft.content, progress)
    if faults and draft.gyro_unknown and unit is None and draft.content["log"]["gyro"]["unit"] == "rad/s":
        return _in_counts(draft, faults, progress)
    gyro = draft.content["log"].get("gyro")
    if not faults or unit is None or gyro["unit"] == "count":
        return draft, faults
    trial = _with_gyro_unit(draft.content, unit)
    if _looked_at(trial, progress)[1]:
        return draft, faults
    said = f"gyros: in {unit}, not {gyro['unit']}: so they carry the vertical from rest to rest"
    return replace(draft, content=trial, said=(*draft.said, said)), []


def _in_counts(draft: Draft, faults: list[str], progress: Progress) -> tuple[Draft, list[str]]:
    """A draft with the gyros in counts, where that makes them carry the vertical and no unit does."""
    log = draft.content["log"]
    factor = None if (observations := _observed(draft.content, progress)) is None else gyro_factor(observations)
    if factor is None:
        return draft, faults
    scale = counts_per_deg_s(factor)
    gyro = {
        "columns": log["gyro"]["columns"],
        "unit": "count",
        "scale": scale.value,
        "scale_per": "deg/s",
        "offset": 0.0,
    }
    trial = {**draft.content, "log": {**log, "gyro": gyro}}
    _, left = _looked_at(trial, progress)
    if left:
        return draft, faults
    said = f"gyros: not in rad/s but in counts: {scale.said}: so they carry the vertical from rest to rest"
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


def _text(draft: Draft, folder: Path, given: Given) -> str:
    """session.toml with a comment on all that has to be filled in."""
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
        _line("serial", serial) + ("" if given.serial else "   # the serial number"),
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
    if given.programme is None:
        lines += [
            "# the positions, if they were planned: see `tumble programme`",
            "# [programme]",
            '# name = "rough-table"',
        ]
    else:
        lines += ["[programme]", _line("name", given.programme)]
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
