"""The records of a device, or of all devices. Imports nothing that looks into calibrations, to list them at once."""

from __future__ import annotations

from tumble.errors import InputError
from tumble.registry.store import rows
from tumble.registry.store.connect import Registry
from tumble.registry.types import Record


def records(registry: Registry, serial: str | None = None) -> list[Record]:
    """The records of a device, or of all of them, superseded ones too, in the order in which they were performed.

    Raises InputError for a device that has none.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> tumble.calibrate(folder).write("calibration.json")
    >>> with tumble.open_registry("registry.sqlite", create=True) as registry:
    ...     _ = tumble.add_calibration(registry, "calibration.json")
    ...     found = tumble.records(registry, "mems-1")
    >>> [record.method for record in found]
    ['joint']
    """
    with registry.reading() as connection:
        listed = rows.every_record(connection) if serial is None else rows.records_of_device(connection, serial)
    if serial is not None and not listed:
        raise InputError(f"device {serial!r}: expected a device of the registry, found none of this serial number")
    return sorted(listed, key=lambda record: (record.performed, record.number))
