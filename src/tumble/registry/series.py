"""Each parameter over the calibrations of a device, in one frame; and the verdict on a record.

Values in different frames are not compared: those of another frame are converted, their uncertainties with them.
Superseded records are left out.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from tumble.errors import InputError
from tumble.registry.connect import Registry
from tumble.registry.limits import Verdict, judge, parse_limits
from tumble.registry.records import ParameterRow, Record, State, all_parameter_rows
from tumble.registry.store import LimitsRecord, file_of, parameters_of, records


@dataclass(frozen=True, kw_only=True, slots=True)
class SeriesPoint:
    """A parameter in one calibration: value and standard uncertainty (SI), and both in each of its launches, where
    it is the mean of several."""

    number: int
    performed: datetime
    state: State
    value: float
    u: float | None
    launches: tuple[tuple[float, float | None], ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Series:
    """A parameter over the calibrations that have it, in the order in which they were performed."""

    name: str
    unit: str
    points: tuple[SeriesPoint, ...]


def series_of(registry: Registry, serial: str, frame: str) -> list[Series]:
    """The parameters of a device over all records that are in force, in a frame.

    Raises InputError for an unknown device, and for a record that cannot be taken to the frame."""
    found = [record for record in records(registry, serial) if record.superseded_by is None]
    rows = parameters_of(registry, [record.number for record in found])
    same = {record.number: rows_in_frame(registry, record, rows[record.number], frame) for record in found}
    names = {row.name: row.unit for record in reversed(found) for row in same[record.number] if row.launch == 0}
    return [
        Series(name=name, unit=unit, points=tuple(_points(name, unit, found, same))) for name, unit in names.items()
    ]


def _points(
    name: str, unit: str, found: Iterable[Record], rows: Mapping[int, Sequence[ParameterRow]]
) -> Iterable[SeriesPoint]:
    for record in found:
        own = [row for row in rows[record.number] if (row.name, row.unit) == (name, unit)]
        for row in own:
            if row.launch == 0:
                yield SeriesPoint(
                    number=record.number,
                    performed=record.performed,
                    state=record.state,
                    value=row.value,
                    u=row.u,
                    launches=tuple((x.value, x.u) for x in own if x.launch > 0),
                )


def verdict_of(
    registry: Registry, record: Record, rows: Sequence[ParameterRow], limits: Mapping[int, LimitsRecord]
) -> Verdict | None:
    """The verdict on a record by the limits (by number) that were in force when it was added; None without any."""
    if record.limits is None:
        return None
    own = limits[record.limits]
    parsed = parse_limits(own.file, own.systematic, f"limits {own.number}")
    unobservable = json.loads(file_of(registry, record.number))["outcome"].get("unobservable", [])
    return judge(parsed, record.occasion, rows_in_frame(registry, record, rows, parsed.frame), unobservable)


# -------------------- frames --------------------


def rows_in_frame(
    registry: Registry, record: Record, rows: Sequence[ParameterRow], frame: str
) -> Sequence[ParameterRow]:
    """The parameters of a record, and of its launches, in a frame."""
    if record.frame == frame:
        return rows
    from tumble.calibration.calibration_file import calibration_of

    calibration = calibration_of(file_of(registry, record.number), f"record {record.number}")
    try:
        return list(all_parameter_rows(calibration.in_frame(frame)))
    except InputError as error:
        raise InputError(
            f"record {record.number}: is in the frame {record.frame!r} and cannot be compared in the frame {frame!r}: "
            f"{error}"
        ) from error
