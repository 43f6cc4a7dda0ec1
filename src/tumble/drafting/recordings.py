"""Recordings in other formats than text and Parquet: their messages become a Parquet file, which is a log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import takewhile
from operator import eq
from pathlib import Path

from tumble.drafting.found_log import FoundLog
from tumble.errors import InputError
from tumble.files import OutputFolder
from tumble.recording import formats
from tumble.recording.autopilot import AutopilotSensor
from tumble.recording.columns.names import ACCEL, GYRO, MAGNETOMETER, Columns
from tumble.recording.formats.message import TIME, Message


def log_of_recording(
    recordings: Sequence[Path], folder: OutputFolder, message: str | None
) -> tuple[FoundLog, Mapping[str, AutopilotSensor]]:
    """The log of a message of a recording, that of this name or the first with most sensors, and the sensors of an
    autopilot that it is of. Several files are one recording where the accelerometers are in the one and the gyros in
    the other."""
    recording, found = recordings[0], formats.messages(*recordings)
    if len(recordings) > 1 and (len(found) > len(recordings) or sum(m.accel is not None for m in found) > 1):
        raise InputError(f"{recording}: expected one recording, found {len(recordings)}; give each its own session")
    accel = _named(found, message, recording)
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
    )
    imu = {kind: sensor for m in (gyro, accel) if m is not None for kind, sensor in m.imu.items()}
    return FoundLog(files=(log,), keys={}, columns=columns, said=tuple(said)), imu


def _thermometers_of(accel: Message, gyro: Message | None, apart: Sequence[Message]) -> list[Message]:
    """Of messages with nothing but temperatures, that of the accelerometers and that of the gyros, where each have one,
    else that whose name begins, between slashes, most like that of the accelerometers."""

    def shared(message: Message) -> int:
        alike = map(eq, message.name.split("/"), accel.name.split("/"))
        return sum(1 for _ in takewhile(bool, alike))

    near = sorted(apart, key=shared, reverse=True)
    each = [next((m for m in near if m.temperatures == (f"{kind}_temperature",)), None) for kind in (ACCEL, GYRO)]
    both = [m for m in each if m is not None]
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
