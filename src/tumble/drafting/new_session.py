"""Writing of a first session.toml for a log.

The steps are: files (`containers`), columns of sensors and times by name and unit, and by numbers where names leave
them open (`columns`), repaired copies (`repairs`), times (`times`), units and scales by rests and turns (`hypotheses`),
and remarks (`conclusions`). Accelerometers at rest read gravity, which determines their unit. Gyros predict the
vertical at the next rest, which determines their unit, the scale of counts, and the rate of a log without times. Serial
number, place and programme are in no log; the user fills them in.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tumble.arguments import checked
from tumble.diagnosis.turn_likelihood import WIDTHS, Widths
from tumble.drafting.columns import identify_log
from tumble.drafting.conclusions import complete_draft
from tumble.drafting.containers import check_format, files_of, unzipped
from tumble.drafting.foreign_log import HEAD_ROWS, Draft, ForeignLog
from tumble.drafting.foreign_log import NOTHING_GIVEN as NOTHING_GIVEN
from tumble.drafting.foreign_log import Given as Given
from tumble.drafting.repairs import repair_log
from tumble.drafting.sensors_apart import log_of_recording
from tumble.errors import InputError, LogError
from tumble.files import FilePath, OutputFolder, nothing_left, whole_file
from tumble.recording.columns.names import ACCEL, GYRO, MAGNETOMETER, NAMED, Sensors, temperature_unit
from tumble.recording.columns.scales import PRIORS
from tumble.recording.formats import MESSAGES, is_recording
from tumble.recording.log import Log
from tumble.recording.session import USUAL_RATE_U, AutopilotSensor, sensors_content
from tumble.recording.session_file import SESSION_FILE
from tumble.recording.text.dialect import DIALECT_KEYS
from tumble.run.observed import Progress
from tumble.units import TEMPERATURE_UNITS

_PX4_COUNTERS = ("accel_calibration_count", "gyro_calibration_count")


@checked
def new_session(
    folder: FilePath,
    logs: FilePath | Sequence[FilePath],
    given: Given = NOTHING_GIVEN,
    *,
    progress: Progress = Log.chunks,
) -> tuple[Draft, list[str]]:
    """Write a first session.toml for a log, with comments on what has to be filled in.

    Names and units are trusted; numbers decide what they do not determine.

    Parameters
    ----------
    folder
        The session's folder, made if need be. Logs that a session file cannot describe, and those in other formats
        than text and Parquet, are copied into it.
    logs
        Files, folders of files, or patterns.
    given
        Statements of the user.
    progress
        Function that shows how much of the log is read.

    Returns
    -------
    draft : Draft
        The content of the file, and in `remarks` how each part was found.
    faults : list of str
        Faults of the recording.

    Raises
    ------
    InputError
        If the folder has a session, and for a log that cannot be read or has no accelerometers; no new folder is
        left behind.

    Examples
    --------
    >>> import tumble
    >>> folder = tumble.simulate_session("simulated", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> draft, faults = tumble.new_session("session", folder / "log.parquet")
    >>> print(draft.remarks[0], faults)
    time: column 't' in s (by its steps), 100 samples per second []
    """
    with nothing_left(Path(folder)) as output:
        return written_session(output, logs, given, progress)


def written_session(
    folder: OutputFolder, logs: FilePath | Sequence[FilePath], given: Given, progress: Progress, widths: Widths = WIDTHS
) -> tuple[Draft, list[str]]:
    """Run `new_session` in a folder; if it fails the caller must remove new files.

    The text is session.toml.j2, in which numbers, strings and lists are written as in JSON and TOML alike."""
    from jinja2 import Environment

    path = folder.path / SESSION_FILE
    if path.exists():
        raise InputError(f"{path}: expected a folder without a session, found one; choose another folder")
    draft, faults = drafted_log(folder, logs, given, progress, widths)
    environment = Environment(trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, autoescape=False)
    environment.filters["toml"] = partial(json.dumps, ensure_ascii=False)
    template = environment.from_string((Path(__file__).parent / "session.toml.j2").read_text(encoding="utf-8"))
    files = [os.path.relpath(file, folder.path.resolve()) for file in draft.files]
    log: dict[str, Any] = {"file": files[0] if len(files) == 1 else files}
    keys = *DIALECT_KEYS, "time", "time_unit", "regular", "rate_hz", "clock_ppm_u", "doubt"
    text = template.render(
        device=draft.content["device"],
        site=draft.content.get("site", {}),
        log=log | {key: draft.log[key] for key in keys if key in draft.log},
        doubted=bool(draft.doubts),
        tables={kind: draft.log[kind] for kind in ("accel", "gyro", "temperature") if kind in draft.log},
        magnetometer=draft.magnetometer,
        programme=given.programme,
        named=bool(given.serial),
    )
    with whole_file(folder.new_file(SESSION_FILE)) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return draft, faults


def drafted_log(
    folder: OutputFolder,
    logs: FilePath | Sequence[FilePath],
    given: Given,
    progress: Progress,
    widths: Widths = WIDTHS,
    *,
    gyros_suffice: bool = False,
) -> tuple[Draft, list[str]]:
    """Return the draft and the faults of `new_session`; with `gyros_suffice` also for a log of gyros alone.

    Copies of logs are written into the folder."""
    listed = [logs] if isinstance(logs, str | os.PathLike) else logs
    files = [file for log in listed for file in files_of(Path(log))]
    files = [inner for file in files for inner in unzipped(file, folder)]
    imu: Mapping[str, AutopilotSensor] = {}
    recordings = [file for file in files if is_recording(file) or file.is_dir()]
    for file in filter(Path.is_file, recordings):
        check_format(file, recording=True)
    if not recordings:
        log = identify_log(files, folder, given)
        log.check_has_sensors(gyros_suffice=gyros_suffice)
    elif given.options:
        raise InputError(
            f"{', '.join(given.options)}: expected a log of text or Parquet, found {recordings[0].name}, whose "
            "messages name their sensors; --message selects one"
        )
    elif len(recordings) < len(files):
        raise InputError(f"{recordings[0]}: expected one recording, found other files too; give each its own session")
    else:
        log, imu = log_of_recording(recordings, folder, given.message)
    draft = _draft_of_raw_numbers(repair_log(log, folder, given.sample_rate), given, widths)
    serial = given.serial or folder.path.resolve().name or "unknown"
    draft.content["device"] = {"serial": serial} | ({"imu": sensors_content(imu)} if imu else {})
    place = {"latitude_deg": given.latitude, "height_m": given.height}
    draft.content["site"] = {key: value for key, value in place.items() if value is not None}
    draft.session()  # checks the content
    faults = complete_draft(draft, progress)
    accel = draft.log.get(ACCEL, {"unit": None})
    if accel["unit"] == "g" and all(map(NAMED["core_motion"].fullmatch, accel["columns"])):
        # a recording cannot determine the sign, because gyros predict both directions of the vertical alike; source:
        # Apple, CMAccelerometerData and CMMotionManager, Core Motion
        counts = {"unit": "count", "scale": -1.0, "scale_per": "g", "offset": 0.0}
        draft.log[ACCEL] = {"columns": accel["columns"], **counts}
        draft.say("accelerometers: as Apple's CoreMotion has them, −1 g where an axis points up: scale = -1 per g")
    return draft, faults


def _draft_of_raw_numbers(log: ForeignLog, given: Given, widths: Widths) -> Draft:
    """Return a draft from names and first numbers, with sensors as raw numbers."""
    columns, rate = log.columns, given.sample_rate
    times = log.times(rate)
    files = [str(file.resolve()) for file in log.files]
    table: dict[str, Any] = {"file": files[0] if len(files) == 1 else files}
    table |= ({} if log.dialect is None else log.dialect.keys()) | times.keys
    content = {"format": 1, "device": {"serial": "unknown"}, "log": table}
    draft = Draft(
        source=log, given=given, widths=widths, times=times, content=content, remarks=log.remarks, doubts=log.doubts
    )
    for name, sentence in MESSAGES["corrected"].items():
        counters = [c for c in _PX4_COUNTERS if c in log.names]  # of calibrations; 0 without any
        uncorrected = len(counters) == len(_PX4_COUNTERS) and not log.read(counters).any()
        if name in columns.sensors and not uncorrected:
            draft.doubts = (sentence, *draft.doubts)
    if rate is not None and columns.time is not None and not times.stamped:
        draft.say(f"time: column {columns.time!r} is not used, since the rate was given")
        shown = [each.rate for each in log.stamped_times()]
        if shown and all(abs(each - rate) > USUAL_RATE_U * rate for each in shown):
            draft.doubts += (
                f"--sample-rate {rate:g} is taken as stated, but the times in {columns.time!r} show {shown[0]:.4g} per "
                "second: the gyros' scale factors depend on it; leave --sample-rate out if the times are right",
            )
    if columns.others:
        draft.say(f"also there, and not used: {', '.join(columns.others)}")
    first = next(iter(draft.triads.values())).columns
    if log.magnitude(first) == 0.0:
        rows = len(log.read(first, rows=HEAD_ROWS))
        raise LogError(f"{log.files[0]}: {', '.join(first)}: expected readings, found none in the first {rows} rows")
    for kind, sensors in draft.triads.items():
        table[kind] = {"columns": list(sensors.columns), "unit": "count", "scale": 1.0, "offset": 0.0}
    if GYRO not in draft.triads:
        draft.say("no gyros were found (--gyro states their columns): the accelerometers alone will be calibrated")
    if columns.temperatures:
        _add_temperature(draft)
    if MAGNETOMETER in columns.triads:
        _add_magnetometer(draft, columns.triads[MAGNETOMETER])
    return draft


def _unit_of_size(kind: str, size: float) -> str | None:
    """Return the first unit in which a reading is of a usual size."""
    return next((unit for unit, (low, high) in PRIORS["sizes"][kind].items() if low <= size <= high), None)


def _add_temperature(draft: Draft) -> None:
    """Add the table [log.temperature], if its unit is known, and a remark.

    The unit is that of the name, or one in which the numbers are air temperatures. Columns in another unit than the
    first are left out."""
    units, remarks = dict[str, str](), list[str]()
    for column in draft.source.columns.temperatures:
        readings = draft.source.readings(column)
        if not len(readings):
            draft.say(f"temperature: {column} is left out, for it reads nothing or cannot be read")
            return
        middle, named = float(np.median(readings)), temperature_unit(column)
        units[column] = named or _unit_of_size("temperature", middle) or ""
        if units[column] not in TEMPERATURE_UNITS:
            draft.say(
                f"temperature: {column}, about {middle:.6g}, is left out, for it is in no unit that is known; to use "
                "it, convert it to °C"
            )
            return
        remarks.append(f"{column} in {units[column]} ({'from the name' if named else 'by its numbers'})")
    unit = next(iter(units.values()))
    listed = [column for column in units if units[column] == unit]
    whose = ", accelerometers and gyros" if len(listed) > 1 else ""
    draft.say(f"temperature: {', '.join(remarks[: len(listed)])}{whose}")
    draft.log["temperature"] = {"columns": listed, "unit": unit}


def _add_magnetometer(draft: Draft, sensors: Sensors) -> None:
    """Add the table [log.magnetometer] and a remark; the unit is that of the name, or fits the field on Earth."""
    field, named = draft.source.magnitude(sensors.columns), ", ".join(sensors.columns)
    unit = sensors.unit or _unit_of_size(MAGNETOMETER, field)
    if field == 0.0:
        draft.say(f"magnetometers: {named} are left out; they have no readings")
    elif unit is None:
        draft.say(f"magnetometers: {named} are left out; their magnitude of {field:.6g} is no field on Earth")
    else:
        draft.magnetometer = {"columns": list(sensors.columns), "unit": unit}
        draft.say(f"magnetometers: {named} in {unit}, as a comment in the file: take the # away to calibrate them too")
