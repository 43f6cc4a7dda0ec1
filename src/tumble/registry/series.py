"""Each parameter over the calibrations of a device, in one frame; and the verdict on a record.

Values in different frames are not compared: those of another frame are converted, their uncertainties with them.
Superseded records are left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import TYPE_CHECKING

from tumble.acceptance.conformity import Verdict, verdict_at
from tumble.acceptance.limits import parse_limits
from tumble.calibration.compare import Comparison, compare_calibrations
from tumble.calibration.coverage import by_gravity
from tumble.calibration.shared_errors import by_priors, of_time_base
from tumble.errors import InputError
from tumble.recording.session import Site
from tumble.registry.connect import Registry
from tumble.registry.records import Record, State
from tumble.registry.store import LimitsRecord, file_of, records

if TYPE_CHECKING:
    from tumble.calibration.calibration_file import Calibration


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
    dof: float | None = None
    """Degrees of freedom of u; None where it is known."""
    site: Site | None = None
    by_gravity: float = 0.0
    """Change of the value with one standard uncertainty of the site's gravity."""
    clock_u: float = 0.0
    """Relative standard uncertainty of the time base."""
    by_clock: float = 0.0
    """Change of the value with it."""
    by_priors: Mapping[str, float] = field(default_factory=dict)
    """And where a property of the device is a standard deviation of its prior off, by the name of this parameter."""


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
    alike = {record.number: calibration_in(registry, record, frame) for record in found}
    names = {p.name: p.unit for record in reversed(found) for p in alike[record.number].parameters}
    return [
        Series(name=name, unit=unit, points=tuple(_points(name, unit, found, alike))) for name, unit in names.items()
    ]


def _points(name: str, unit: str, found: Iterable[Record], alike: Mapping[int, Calibration]) -> Iterable[SeriesPoint]:
    for record in found:
        calibration = alike[record.number]
        change = by_gravity(calibration.parameters, calibration.covariance, calibration.site)
        changes, by_clock = by_priors(calibration.parameters, calibration.covariance), of_time_base(calibration)
        for i, own in enumerate(calibration.parameters):
            if (own.name, own.unit) == (name, unit):
                launches = [p for x in calibration.launches for p in x.parameters if (p.name, p.unit) == (name, unit)]
                yield SeriesPoint(
                    number=record.number,
                    performed=record.performed,
                    state=record.state,
                    value=own.value,
                    u=own.u,
                    launches=tuple((p.value, p.u) for p in launches),
                    dof=own.dof,
                    site=calibration.site,
                    by_gravity=float(change[i]),
                    clock_u=calibration.clock_u,
                    by_clock=float(by_clock[i]),
                    by_priors={of: float(each[i]) for of, each in changes.items()},
                )


def latest_comparison(registry: Registry, serial: str, frame: str) -> Comparison | None:
    """The last calibration of a device in force that is no adjustment against the one before it, in a frame; None
    where there are no two with parameters in common."""
    found = [record for record in records(registry, serial) if record.superseded_by is None]
    at = next((i for i in range(len(found) - 1, 0, -1) if found[i].state != "as-left"), None)
    if at is None:
        return None
    earlier, later = (calibration_in(registry, found[i], frame) for i in (at - 1, at))
    if not {p.name for p in later.parameters} & {p.name for p in earlier.parameters}:
        return None
    return compare_calibrations(earlier, later)


def verdict_of(registry: Registry, record: Record, limits: Mapping[int, LimitsRecord]) -> Verdict | None:
    """The verdict on a record by the limits (by number) that were in force when it was added, parameter by parameter;
    None without any."""
    if record.limits is None:
        return None
    own = limits[record.limits]
    parsed = parse_limits(own.file, own.systematic, f"limits {own.number}")
    return verdict_at(calibration_in(registry, record, parsed.frame), parsed, record.occasion)


# -------------------- frames --------------------


def calibration_in(registry: Registry, record: Record, frame: str) -> Calibration:
    """The calibration of a record in a frame."""
    from tumble.calibration.calibration_file import calibration_of

    calibration = calibration_of(file_of(registry, record.number), f"record {record.number}")
    try:
        return calibration.in_frame(frame)
    except InputError as error:
        raise InputError(
            f"record {record.number}: is in the frame {record.frame!r} and cannot be compared in the frame {frame!r}: "
            f"{error}"
        ) from error
