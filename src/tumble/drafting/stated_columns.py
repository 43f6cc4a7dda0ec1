"""Columns that the user states, by name or by number from 1, in place of those that names or numbers tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from tumble.drafting.found_log import SHOWN, FoundLog
from tumble.errors import InputError, did_you_mean
from tumble.recording.formats.columns import TIME_KIND, time_unit, unit_of_name
from tumble.recording.formats.message import Sensors

Stated = Mapping[str, Sequence[str]]
"""Columns by what they are: three of "accel" and of "gyro", one of "time"; nothing where none are stated."""


def with_stated(log: FoundLog, stated: Stated) -> FoundLog:
    """A log whose sensors and time are as stated; what was taken for something else of these columns is so no more.
    Raises InputError for columns that it does not have."""
    names = next(iter(log.sources())).names
    columns = {kind: tuple(_named(log, kind, c.strip(), names) for c in listed) for kind, listed in stated.items()}
    taken = [c for listed in columns.values() for c in listed]
    if not taken:
        return log
    twice = next((c for c in taken if taken.count(c) > 1), None)
    for kind, listed in columns.items():
        if len(listed) != (1 if kind == TIME_KIND else 3) or twice in listed:
            wanted = "one column" if kind == TIME_KIND else "three columns that are nothing else, with commas between"
            raise InputError(f"--{kind}: expected {wanted}, found {','.join(stated[kind])}")
    known = log.columns
    triads = {kind: s for kind, s in known.triads.items() if kind not in columns and not {*s.columns} & {*taken}}
    for kind in columns.keys() - {TIME_KIND}:
        x, y, z = columns[kind]
        triads[kind] = Sensors(columns=(x, y, z), unit=unit_of_name(kind, x))
    time = columns.get(TIME_KIND, (None if known.time in taken else known.time,))[0]
    stayed = time == known.time
    return replace(
        log,
        columns=replace(
            known,
            triads=triads,
            time=time,
            time_unit=known.time_unit if stayed else None if time is None else time_unit(time),
            times=known.times if stayed else (),
            temperatures=tuple(c for c in known.temperatures if c not in taken),
            counter=None if known.counter in taken else known.counter,
        ),
        said=(*log.said, *(f"{kind}: {', '.join(listed)}, as stated" for kind, listed in columns.items())),
    )


def _named(log: FoundLog, kind: str, column: str, names: Sequence[str]) -> str:
    """The name of a column that is given by that, or by its number from 1."""
    if column in names:
        return column
    if column.isdecimal() and 0 < int(column) <= len(names):
        return names[int(column) - 1]
    raise InputError(
        f"{log.files[0]}: --{kind}: expected names of columns, or numbers from 1 to {len(names)}, found {column!r}; "
        f"there are {', '.join(names[:SHOWN])[:200]}{did_you_mean(column, names)}"
    )
