"""Temperatures that come with readings: of one thermometer, or of the accelerometers' and the gyros' own."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from tumble.errors import InputError
from tumble.recording.arrays import Temperatures, celsius_of, check_kinds, numbers_of
from tumble.sensors.compensation import Compensator
from tumble.units import Array


def given_temperatures(
    given: Temperatures | None, compensator: Compensator, shape: tuple[int, ...]
) -> dict[str, Array | None]:
    """Temperatures (N, n) or (N, 1), °C, of the "accel" and "gyro" of samples of a shape (...), N together: of all
    sensors (...), or by kind, (...) or (..., n), K. Raises InputError for others, and for one thermometer where the
    calibration has several."""
    sizes = {block.kind: block.size for block in (compensator.accel, compensator.gyro) if block is not None}
    if given is None:
        return dict.fromkeys(sizes)
    if isinstance(given, Mapping):
        check_kinds(given, sizes)
        return {kind: _by_sample(f"temperature of {kind}", given[kind], shape, n) for kind, n in sizes.items()}
    if compensator.several_thermometers:
        raise InputError(
            "temperature: expected those of the thermometers of the calibration by kind of sensors, "
            f"{{{', '.join(f'{kind!r}: …' for kind in sizes)}}}, found one array"
        )
    every = _by_sample("temperature", given, shape, 1)
    return dict.fromkeys(sizes, every)


def _by_sample(what: str, given: npt.ArrayLike, shape: tuple[int, ...], sensors: int) -> Array:
    numbers = numbers_of(what, given)
    if numbers.shape in ((), shape):
        numbers = np.broadcast_to(numbers, shape)[..., None]
    elif numbers.shape != (*shape, sensors):
        raise InputError(f"{what}: expected a number for each sample, {shape}, found the shape {numbers.shape}")
    return celsius_of(numbers.reshape(-1, numbers.shape[-1]))
