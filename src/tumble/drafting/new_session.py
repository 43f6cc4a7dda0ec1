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

from tumble.calibration.observed import Progress
from tumble.drafting.archive import is_archive, unzipped
from tumble.drafting.draft import Draft, session_text
from tumble.drafting.draft_trials import tried
from tumble.drafting.found_log import FoundLog, times_of
from tumble.drafting.gyro_unit_by_readings import step_in_deg_s, too_fast_for_rad_s
from tumble.drafting.log_detection import files_of, found_log
from tumble.drafting.log_times import Times
from tumble.drafting.mended_log import mended
from tumble.drafting.opposite_sign import with_sign
from tumble.drafting.workbook import is_workbook, sheets_of
from tumble.errors import InputError, LogError
from tumble.files import FilePath, OutputFolder, nothing_left, whole_file
from tumble.programme.positions import BUILT_IN
from tumble.recording import formats
from tumble.recording.autopilot import sensors_content
from tumble.recording.formats import Sensors
from tumble.recording.formats.columns import ACCEL, GYRO, MAGNETOMETER, TIME_KIND, Columns, temperature_unit
from tumble.recording.formats.message import TIME, Message
from tumble.recording.formats.scales import ACCEL_COUNTS, matched
from tumble.recording.log import Log
from tumble.recording.session import Session
from tumble.recording.session_file import SESSION_FILE, session_of
from tumble.recording.session_keys.temperature import TemperatureTable
from tumble.units import ACCEL_UNITS, DEGREE, G_STANDARD, GYRO_UNITS, TEMPERATURE_UNITS, Array

_HEAD, _FIRST_ROWS = 20_000, 200
_NO_COLUMNS = Columns(time=None, time_unit=None, triads={}, temperatures=(), others=())
_TOLERANCE = 0.3
_SECONDS, _FEWEST_MEANS, _STEADY = 2.0, 3, 0.4
"""Of accelerometers that turn slowly the mean over so long is most of gravity."""
_FIELDS = {
    "uT": (15.0, 150.0),
    "nT": (15e3, 150e3),
    "gauss": (0.15, 1.5),
    "T": (15e-6, 150e-6),
}  # with iron about
_SENSORS = {ACCEL: ("accelerometers", "m/s²", 1.0), GYRO: ("gyros", "°/s", DEGREE)}
_LIKELY = {"degC": (-80.0, 150.0), "K": (190.0, 430.0)}  # of the middle temperature of a recording


@dataclass(frozen=True, kw_only=True, slots=True)
class Given:
    """What the user knows: serial number, latitude (°), rate (Hz), programme and message of a recording; and the
    columns of a text or Parquet log that are its accelerometers, gyros and time, by name or by number from 1."""

    serial: str | None = None
    latitude: float | None = None
    sample_rate: float | None = None
    programme: str | None = None
    message: str | None = None
    accel: Sequence[str] = ()
    gyro: Sequence[str] = ()
    time: str | None = None

    @property
    def columns(self) -> dict[str, Sequence[str]]:
        """The stated columns by what they are."""
        stated = {ACCEL: self.accel, GYRO: self.gyro, TIME_KIND: () if self.time is None else (self.time,)}
        return {kind: columns for kind, columns in stated.items() if columns}


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
    with nothing_left(Path(folder)) as output:
        return written_session(output, logs, given, progress)


def written_session(
    folder: OutputFolder, logs: FilePath | Sequence[FilePath], given: Given, progress: Progress
) -> tuple[Draft, list[str]]:
    """`new_session` into a folder whose new files are left to the caller where it fails."""
    path = folder.path / SESSION_FILE
    if path.exists():
        raise InputError(f"{path}: expected a folder without a session, found one; choose another folder")
    listed = [logs] if isinstance(logs, str | os.PathLike) else logs
    files = [file for log in listed for file in files_of(Path(log))]
    if given.programme is not None and given.programme not in BUILT_IN:
        raise InputError(f"--programme: expected one of {', '.join(BUILT_IN)}, found {given.programme!r}")
    if given.latitude is not None and not -90.0 <= given.latitude <= 90.0:
        raise InputError(f"--latitude: expected a number from -90 to 90, found {given.latitude:g}")
    if given.sample_rate is not None and not 0.0 < given.sample_rate < 1e9:
        raise InputError(f"--sample-rate: expected a positive number, found {given.sample_rate:g}")
    files = [found for file in files for found in (unzipped(file, folder) if is_archive(file) else [file])]
    files = [found for file in files for found in (sheets_of(file, folder) if is_workbook(file) else [file])]
    draft = _of_files(files, folder, given)
    draft = replace(draft, content=_with_given(draft.content, folder.path, given))
    draft, faults = tried(draft, progress)
    content, signed = with_sign(draft.content)
    row = [_row_as_read(session_of(content), draft.rate)] if draft.guessed else []
    draft = replace(draft, content=content, said=(*draft.said, *signed, *row))
    text = session_text(draft, folder.path, given.programme, named=bool(given.serial))
    with whole_file(folder.new_file(SESSION_FILE)) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return draft, faults


# -------------------- what is known from names and first numbers --------------------


def _of_files(files: list[Path], folder: OutputFolder, given: Given) -> Draft:
    recordings = [f for f in files if formats.is_recording(f) or f.is_dir()]
    if not recordings:
        log = mended(found_log(files, folder, given.columns), folder, given.sample_rate)
        return _of_log(log, times_of(log, given.sample_rate), given.sample_rate)
    if given.columns:
        raise InputError(
            f"--{', --'.join(given.columns)}: expected a log of text or Parquet, found {recordings[0].name}, whose "
            "messages say what is what; --message takes one"
        )
    if len(files) > 1 and len(recordings) < len(files):
        raise InputError(f"{recordings[0]}: expected one recording, found other files too; give each its own session")
    return _of_recording(recordings, folder, given)


def _of_log(log: FoundLog, times: Times, rate: float | None) -> Draft:
    """From text and Parquet files."""
    found = log.columns
    said = [*log.said, *times.said]
    if rate is not None and found.time is not None:
        said.append(f"time: column {found.time!r} is not used, since the rate was given")
    said += [f"also there, and not used: {', '.join(found.others)}"] if found.others else []
    magnitude = _magnitude(log, found.triads[ACCEL])
    content, more, unknown = _content(log, times, found, magnitude)
    more += _without_gravity(log, found.triads[ACCEL], times.rate)
    table = content["log"]
    magnetometer, most = _magnetometer(log, found.triads.get(MAGNETOMETER))
    return Draft(
        content=content,
        said=(*said, *more, *most),
        magnetometer=magnetometer,
        rate_guessed=times.guessed,
        gyro_unknown=unknown,
        time_guessed=times.unit_guessed,
        rate=times.rate,
        gyro_whole=GYRO in found.triads and _is_whole(log.read(found.triads[GYRO].columns, rows=_HEAD)),
        accel_whole=_is_whole(log.read(found.triads[ACCEL].columns, rows=_HEAD)),
        accel_magnitude=magnitude,
        guessed=times.guessed
        or times.unit_guessed
        or any(found.triads[k].unit is None for k in table if k in _SENSORS),
    )


def _without_gravity(log: FoundLog, accel: Sensors, rate: float) -> list[str]:
    """A remark where what accelerometers read is nearly nothing at the mean over two seconds, as without gravity."""
    read = log.read(accel.columns, rows=_HEAD)
    read = read[np.isfinite(read).all(axis=1)]
    rows = max(int(_SECONDS * rate), 2)
    whole = len(read) // rows * rows
    if whole < _FEWEST_MEANS * rows:
        return []
    means = np.linalg.norm(read[:whole].reshape(-1, rows, 3).mean(axis=1), axis=1)
    share = float(np.median(means) / max(np.median(np.linalg.norm(read, axis=1)), 1e-300))
    if share > _STEADY:
        return []
    return [
        f"accelerometers: at the mean over {_SECONDS:g} s they read {share:.0%} of what they read at a time: gravity "
        "is not in them; what a filter has left of the readings cannot be calibrated"
    ]


def _row_as_read(session: Session, rate: float) -> str:
    """The first row of a session's log that is whole: its numbers, and what they are taken for."""
    log = session.log
    time = [] if log.time is None else [log.time]
    sensors = {kind: channels for kind, channels in ((ACCEL, log.accel), (GYRO, log.gyro)) if channels is not None}
    columns = [*time, *(c for channels in sensors.values() for c in channels.columns)]
    files = tuple(file for file in log.files if isinstance(file, Path))
    found = FoundLog(files=files, keys={}, columns=_NO_COLUMNS, dialect=log.dialect)
    read = found.read(columns, rows=_FIRST_ROWS, clock=log.time if log.clock else None)
    whole = np.flatnonzero(np.isfinite(read).all(axis=1))
    if not len(whole):
        return f"no row of the first {len(read)} is whole"
    row = dict(zip(columns, read[whole[0]].tolist(), strict=True))
    parts = [f"time {row[name] * log.time_factor:.10g} s ({name}: {row[name]:.10g})" for name in time]
    for kind, channels in sensors.items():
        name, unit, one = _SENSORS[kind]
        numbers = np.array([[row[c] for c in channels.columns]])
        values = channels.to_si(numbers, np.array([1.0 / rate]))[0] / one
        written = ", ".join(f"{c}: {row[c]:.6g}" for c in channels.columns)
        parts.append(f"{name} {', '.join(f'{v:.4g}' for v in values)} {unit} ({written})")
    return f"row {whole[0] + 1} as it is read: {'; '.join(parts)}"


def _is_whole(read: Array) -> bool:
    """Whether readings are whole numbers."""
    return bool((read == np.floor(read))[np.isfinite(read)].all())


def _of_recording(recordings: Sequence[Path], folder: OutputFolder, given: Given) -> Draft:
    """From another format, whose messages become a Parquet file. Several files are one recording where the
    accelerometers are in the one and the gyros in the other."""
    recording, found = recordings[0], formats.messages(*recordings)
    if len(recordings) > 1 and (len(found) > len(recordings) or sum(m.accel is not None for m in found) > 1):
        raise InputError(f"{recording}: expected one recording, found {len(recordings)}; give each its own session")
    accel = _named(found, given.message, recording)
    gyro = accel if accel.gyro else next((m for m in found if m.gyro and _pairs(accel, m)), None)
    log = folder.new_file("log.parquet")
    apart = [] if _temperatures(accel, gyro) else [m for m in found if m.thermometer]
    thermometers = _thermometers_of(accel, gyro, apart)
    formats.as_log(log, accel, gyro, thermometers)
    said = [f"{recording.name}: message {accel.name}, written to {log}"]
    said += [f"temperature from {thermometer.name}, interpolated" for thermometer in thermometers]
    unused = [m.name for m in apart if m not in thermometers]
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
        temperatures=_temperatures(accel, gyro) or tuple(t for m in thermometers for t in m.temperatures),
        others=(),
    )
    written = mended(FoundLog(files=(log,), keys={}, columns=columns, said=tuple(said)), folder, given.sample_rate)
    draft = _of_log(written, times_of(written, given.sample_rate), given.sample_rate)
    imu = {kind: sensor for m in (gyro, accel) if m is not None for kind, sensor in m.imu.items()}
    return replace(draft, content={**draft.content, "device": {"imu": sensors_content(imu)}} if imu else draft.content)


def _shared(name: str, other: str) -> int:
    """How many parts, between slashes, two topics begin with alike."""
    alike = [a == b for a, b in zip(name.split("/"), other.split("/"), strict=False)]
    return next((i for i, same in enumerate(alike) if not same), len(alike))


def _thermometers_of(accel: Message, gyro: Message | None, apart: Sequence[Message]) -> list[Message]:
    """Of messages with nothing but temperatures, that of the accelerometers and that of the gyros, where each have one,
    else that whose name is most like that of the accelerometers."""
    near = sorted(apart, key=lambda m: _shared(m.name, accel.name), reverse=True)
    own = [next((m for m in near if m.temperatures == (f"{kind}_temperature",)), None) for kind in (ACCEL, GYRO)]
    both = [m for m in own if m is not None]
    return both if gyro is not None and len(both) == 2 else near[:1]


def _temperatures(accel: Message, gyro: Message | None) -> tuple[str, ...]:
    """The columns of the temperatures beside the accelerometers and beside the gyros."""
    beside = [m.temperatures for m in {id(m): m for m in (accel, gyro) if m is not None}.values() if m.temperatures]
    if len(beside) == 2 and max(map(len, beside)) == 1:
        return beside[0] + beside[1]
    return next(iter(beside), ())


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


def _content(log: FoundLog, times: Times, found: Columns, magnitude: float) -> tuple[dict[str, Any], list[str], bool]:
    """The tables of session.toml, what there is to say, and whether the unit of the gyros is unknown; `magnitude` is
    the median one of the accelerometers."""
    accel, said = _accel(found.triads[ACCEL], times, magnitude)
    files = [str(file.resolve()) for file in log.files]
    table: dict[str, Any] = {"file": files[0] if len(files) == 1 else files, **log.keys, **times.keys, "accel": accel}
    unknown = False
    if GYRO in found.triads:
        rates = log.read(found.triads[GYRO].columns, rows=_HEAD)
        counted = accel["unit"] == "count" and (_is_whole(rates) or matched(ACCEL, magnitude, whole=False).unit is None)
        table["gyro"], more, unknown = _gyro(found.triads[GYRO], rates, raw=counted)
        said += more
    else:
        said.append("no gyros were found (--gyro states their columns): the accelerometers alone will be calibrated")
    if found.temperatures:
        thermometers, remark = _thermometers(log, found.temperatures)
        table |= {} if thermometers is None else {"temperature": thermometers}
        said.append(remark)
    return {"format": 1, "device": {"serial": "unknown"}, "log": table}, said, unknown


def _thermometers(log: FoundLog, columns: Sequence[str]) -> tuple[dict[str, Any] | None, str]:
    """The table [log.temperature], None where numbers are raw. Columns in several units are, as raw ones, with what
    their numbers are worth."""
    empty = [column for column in columns if not len(log.readings(column))]
    if empty:
        return None, f"temperature: {', '.join(empty)} is left out, for it reads nothing or cannot be read"
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
    middle = float(np.median(log.readings(column)))
    named = temperature_unit(column)
    if named is not None:
        return named, "from the name", middle
    likely = next((unit for unit, (low, high) in _LIKELY.items() if low <= middle <= high), TemperatureTable.RAW)
    return likely, "by its numbers", middle


def _magnitude(log: FoundLog, sensors: Sensors) -> float:
    """The median magnitude of what sensors read in the first rows. Raises LogError where they read nothing."""
    read = np.linalg.norm(log.read(sensors.columns, rows=_HEAD), axis=1)
    median = float(np.nanmedian(read)) if np.isfinite(read).any() else 0.0
    if median == 0.0:
        raise LogError(
            f"{log.files[0]}: {', '.join(sensors.columns)}: expected readings, found none in the first {len(read)} rows"
        )
    return median


def _accel(sensors: Sensors, times: Times, magnitude: float) -> tuple[dict[str, Any], list[str]]:
    """The table [log.accel]: the unit in which the median magnitude is gravity; with a scale of one where it may be
    that of counts, so that the rests tell."""
    columns = list(sensors.columns)
    named = ", ".join(columns)
    if sensors.unit in ACCEL_UNITS and ACCEL_UNITS[sensors.unit].kind != "raw":
        said = [f"accelerometers: {named} in {sensors.unit} (from the name or the format), magnitude {magnitude:.6g}"]
        if abs(magnitude * ACCEL_UNITS[sensors.unit].per_second(times.rate) / G_STANDARD - 1.0) > _TOLERANCE:
            asked = "is the unit right?"
            if "lin" in columns[0].lower():
                asked = "linear acceleration, which a filter has taken gravity off, cannot be calibrated"
            said.append(f"accelerometers: their magnitude is not that of gravity in {sensors.unit}: {asked}")
        return {"columns": columns, "unit": sensors.unit}, said
    named_raw = sensors.unit is not None and ACCEL_UNITS[sensors.unit].kind == "raw"
    worth = {name: unit.per_second(times.rate) for name, unit in ACCEL_UNITS.items() if unit.kind != "raw"}
    fits = [name for name, one in worth.items() if abs(magnitude * one / G_STANDARD - 1.0) < _TOLERANCE]
    if fits and not named_raw and magnitude < (1.0 - _TOLERANCE) * ACCEL_COUNTS[0]:
        also = f"; {' or '.join(fits[1:])} would fit too" if fits[1:] else ""
        found = f"accelerometers: {named} in {fits[0]} (their magnitude is {magnitude:.6g}){also}"
        return {"columns": columns, "unit": fits[0]}, [found]
    return {"columns": columns, "unit": "count", "scale": 1.0, "scale_per": "m/s^2", "offset": 0.0}, []


def _gyro(sensors: Sensors, read: Array, *, raw: bool) -> tuple[dict[str, Any], list[str], bool]:
    """The table [log.gyro]; where the accelerometers are `raw`, gyros of no named unit are too, and whole numbers which
    no gyro reads in rad/s."""
    columns = list(sensors.columns)
    named = ", ".join(columns)
    if sensors.unit is not None and GYRO_UNITS[sensors.unit].kind != "raw":
        return (
            {"columns": columns, "unit": sensors.unit},
            [f"gyros: {named} in {sensors.unit} (from the name or the format)"],
            False,
        )
    fast, whole = too_fast_for_rad_s(read), _is_whole(read)
    if not raw and sensors.unit is None and not (fast and whole):
        step = step_in_deg_s(read)
        if step is not None:
            said = f"gyros: {named} in deg/s (a guess): their steps are {step:.4g} °/s, a count of data sheets"
            return {"columns": columns, "unit": "deg/s"}, [said], False
        if fast:
            said = f"gyros: {named} in deg/s, not rad/s (a guess): no gyro reads so much in that"
            return {"columns": columns, "unit": "deg/s"}, [said], True
        return {"columns": columns, "unit": "rad/s"}, [f"gyros: {named} in rad/s (a guess)"], True
    table = {"columns": columns, "unit": "count", "scale": 1.0, "scale_per": "deg/s", "offset": 0.0}
    return table, [], True


def _magnetometer(log: FoundLog, sensors: Sensors | None) -> tuple[dict[str, Any] | None, list[str]]:
    """The table [log.magnetometer]: the unit by name, or the one in which the field is one on Earth."""
    if sensors is None:
        return None, []
    if not np.isfinite(log.read(sensors.columns, rows=_HEAD)).all(axis=1).any():
        return None, [f"magnetometers: {', '.join(sensors.columns)} are left out; they have no readings"]
    field = _magnitude(log, sensors)
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
