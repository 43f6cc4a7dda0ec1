"""The launches of a device, or of all devices of a type: how unstable they are from power-on to power-on."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress

from tumble.calibration.type_spread import KnownLaunches, TypeSpread, known_launches
from tumble.errors import InputError
from tumble.registry.records import records
from tumble.registry.series import calibration_in
from tumble.registry.store.connect import Registry
from tumble.registry.types import Record


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
    found = _launches(registry, [record for record in records(registry) if record.model == model], frame)
    if not found:
        raise InputError(f"type {model!r}: expected calibrations of several launches in the registry, found none")
    return TypeSpread(model=model, frame=frame, known=found)


def device_launches(registry: Registry, serial: str, frame: str = "accelerometer") -> tuple[KnownLaunches, ...]:
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
    found = _launches(registry, records(registry, serial), frame)
    if not found:
        raise InputError(f"device {serial!r}: expected a calibration of several launches in the registry, found none")
    return found


def _launches(registry: Registry, of: Iterable[Record], frame: str) -> tuple[KnownLaunches, ...]:
    """The launches behind those records that are in force."""
    known = []
    for record in of:
        if record.superseded_by is None:
            with suppress(InputError):  # another frame
                known.append(known_launches(calibration_in(registry, record, frame)))
    return tuple(launches for launches in known if launches is not None)
