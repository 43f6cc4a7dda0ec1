"""The calibrations of a device, and each parameter over them, in one frame; and the verdict on a record.

Values in different frames are not compared: those of another frame are converted, their uncertainties with them.
Superseded records are left out.

The launches of a device, or of all devices of a type: how unstable they are from power-on to power-on.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from typing import TypeVar

from tumble.errors import InputError
from tumble.lab.conformity import Verdict, verdict_at
from tumble.lab.device_type import DeviceType, known_calibration
from tumble.lab.limits import parse_limits
from tumble.lab.registry.due import records
from tumble.lab.registry.store import rows
from tumble.lab.registry.store.connect import Registry
from tumble.lab.registry.types import Record, State
from tumble.lab.type_spread import TypeSpread
from tumble.recording.session import Site
from tumble.result.calibration import Calibration, calibration_of
from tumble.result.coverage import by_gravity
from tumble.result.launch_variances import LaunchVariances, launch_variances
from tumble.result.shared_errors import by_priors, of_time_base
from tumble.use.compare import Comparison, compare_calibrations

_Known = TypeVar("_Known")
Past = Sequence[tuple[Record, Calibration]]
"""The records of a device that are in force with what is in their files, in the order in which they were performed."""


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


def past_of(registry: Registry, serial: str, frame: str | None = None) -> Past:
    """The past of a device in a frame, that of the latest record where none is named.

    Raises InputError for an unknown device, and for a record that cannot be taken to the frame."""
    standing = [record for record in records(registry, serial) if record.superseded_by is None]
    if not standing:
        raise InputError(f"device {serial!r}: expected a record in force, found none; its records are superseded")
    frame = standing[-1].frame if frame is None else frame
    return [(record, calibration_in(registry, record, frame)) for record in standing]


def calibration_in(registry: Registry, record: Record, frame: str) -> Calibration:
    """The calibration of a record in a frame."""
    with registry.reading() as connection:
        text = rows.file_of(connection, record.number)
    calibration = calibration_of(text, f"record {record.number}")
    try:
        return calibration.in_frame(frame)
    except InputError as error:
        raise InputError(
            f"record {record.number}: is in the frame {record.frame!r} and cannot be compared in the frame {frame!r}: "
            f"{error}"
        ) from error


def series_of(past: Past) -> list[Series]:
    """The parameters of a device over its past."""
    points: dict[tuple[str, str], list[SeriesPoint]] = {}
    for record, calibration in past:
        parameters, covariance = calibration.parameters, calibration.covariance
        gravity = by_gravity(parameters, covariance, calibration.site).tolist()
        clock = of_time_base(calibration).tolist()
        priors = {of: change.tolist() for of, change in by_priors(parameters, covariance).items()}
        launches: dict[tuple[str, str], list[tuple[float, float | None]]] = {}
        for p in (p for launch in calibration.launches for p in launch.parameters):
            launches.setdefault((p.name, p.unit), []).append((p.value, p.u))
        for i, p in enumerate(parameters):
            point = SeriesPoint(
                number=record.number,
                performed=record.performed,
                state=record.state,
                value=p.value,
                u=p.u,
                launches=tuple(launches.get((p.name, p.unit), ())),
                dof=p.dof,
                site=calibration.site,
                by_gravity=gravity[i],
                clock_u=calibration.clock_u,
                by_clock=clock[i],
                by_priors={of: change[i] for of, change in priors.items()},
            )
            points.setdefault((p.name, p.unit), []).append(point)
    units = {p.name: p.unit for _, calibration in reversed(past) for p in calibration.parameters}
    return [Series(name=name, unit=unit, points=tuple(points[name, unit])) for name, unit in units.items()]


def latest_comparison(past: Past) -> Comparison | None:
    """The last calibration of a device that is no adjustment against the one before it; None where there are no two
    with parameters in common."""
    at = next((i for i in range(len(past) - 1, 0, -1) if past[i][0].state != "as-left"), None)
    if at is None:
        return None
    earlier, later = past[at - 1][1], past[at][1]
    if not {p.name for p in later.parameters} & {p.name for p in earlier.parameters}:
        return None
    return compare_calibrations(earlier, later)


def verdict_of(registry: Registry, record: Record) -> Verdict | None:
    """The verdict on a record by the limits that were in force when it was added, parameter by parameter; None without
    any."""
    if record.limits is None:
        return None
    with registry.reading() as connection:
        limits = next(each for each in rows.every_limits(connection) if each.number == record.limits)
    parsed = parse_limits(limits.file, limits.systematic, limits.name)
    return verdict_at(calibration_in(registry, record, parsed.frame), parsed, record.occasion)


def type_spread(registry: Registry, model: str, frame: str = "accelerometer") -> TypeSpread:
    """The launches behind all calibrations of devices of a type that are in force, in a frame; those that cannot be
    taken to it are left out. For `tumble.mean_of_launches`.

    Raises InputError where there is no calibration of several launches of the type.

    >>> import tumble
    >>> request = tumble.Setup.of(grade="mems", positions=12)
    >>> folders = [tumble.simulate_session(f"launch-{i}", request, seed=1, launch=i) for i in (1, 2)]
    >>> with tumble.open_registry("registry.sqlite", create=True) as registry:
    ...     tumble.type_spread(registry, "BCHE-501")
    Traceback (most recent call last):
    ...
    tumble.errors.InputError: type 'BCHE-501': expected calibrations of several launches in the registry, found none
    """
    of_type = [record for record in records(registry) if record.model == model]
    found = _known(registry, of_type, frame, launch_variances)
    if not found:
        raise InputError(f"type {model!r}: expected calibrations of several launches in the registry, found none")
    return TypeSpread(model=model, frame=frame, known=found)


def device_type(registry: Registry, model: str) -> DeviceType:
    """What all calibrations of devices of a type that are in force say of their units; those in the frame of a case,
    and those of which a type was a prior, are left out. For `tumble.calibrate`.

    >>> import tumble
    >>> with tumble.open_registry("registry.sqlite", create=True) as registry:
    ...     tumble.device_type(registry, "BCHE-501").units
    0
    """
    of_type = [record for record in records(registry) if record.model == model]
    return DeviceType(model=model, known=_known(registry, of_type, "accelerometer", known_calibration))


def device_launches(registry: Registry, serial: str, frame: str = "accelerometer") -> tuple[LaunchVariances, ...]:
    """The launches behind all calibrations of a device that are in force, in a frame; those that cannot be taken to it
    are left out. For `tumble.check_calibration`.

    Raises InputError for an unknown device, and where no calibration of it is of several launches.

    >>> import tumble
    >>> request = tumble.Setup.of(grade="mems", positions=12)
    >>> folders = [tumble.simulate_session(f"launch-{i}", request, seed=1, launch=i) for i in (1, 2)]
    >>> tumble.calibrate_launches(folders).write("calibration.json")
    >>> with tumble.open_registry("registry.sqlite", create=True) as registry:
    ...     _ = tumble.add_calibration(registry, "calibration.json")
    ...     (known,) = tumble.device_launches(registry, "mems-1")
    >>> known.degrees
    1
    """
    found = _known(registry, records(registry, serial), frame, launch_variances)
    if not found:
        raise InputError(f"device {serial!r}: expected a calibration of several launches in the registry, found none")
    return found


def _known(
    registry: Registry, of: Iterable[Record], frame: str, known: Callable[[Calibration], _Known | None]
) -> tuple[_Known, ...]:
    """What is known of the calibrations of those records that are in force and can be taken to a frame, if anything."""
    found = []
    for record in of:
        if record.superseded_by is None:
            with suppress(InputError):  # another frame
                found.append(known(calibration_in(registry, record, frame)))
    return tuple(each for each in found if each is not None)
