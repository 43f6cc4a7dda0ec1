"""The launches of all devices of a type: how unstable such devices are from power-on to power-on."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from tumble.calibration.type_spread import KnownLaunches, TypeSpread
from tumble.errors import InputError
from tumble.registry.connect import Registry
from tumble.registry.series import calibration_in
from tumble.registry.store import records

if TYPE_CHECKING:
    from tumble.calibration.calibration_file import Calibration


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
    of_type = [record for record in records(registry) if record.model == model and record.superseded_by is None]
    found: list[KnownLaunches] = []
    for record in of_type:
        try:
            found += _launches(calibration_in(registry, record, frame))
        except InputError:  # another frame
            continue
    if not found:
        raise InputError(f"type {model!r}: expected calibrations of several launches in the registry, found none")
    return TypeSpread(model=model, frame=frame, known=tuple(found))


def _launches(calibration: Calibration) -> Iterable[KnownLaunches]:
    """The launches behind a calibration, where there are several."""
    count = len(calibration.launches)
    if count < 2:
        return
    own = [{p.name: (p.u or 0.0) ** 2 for p in launch.parameters} for launch in calibration.launches]
    yield KnownLaunches(
        serial=calibration.serial,
        logs=frozenset(launch.log_sha256 for launch in calibration.launches),
        degrees=count - 1,
        variances={
            p.name: (p.run_to_run**2, sum(each[p.name] for each in own) / count)
            for p in calibration.parameters
            if p.run_to_run is not None and all(p.name in each for each in own)
        },
    )
