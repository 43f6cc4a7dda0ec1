"""Whether accelerometers at rest read gravity, and if not, which unit, scale, offset or columns would make them."""

from __future__ import annotations

import numpy as np

from tumble.diagnosis.channels import block_means
from tumble.recording.session import Channels, Session
from tumble.reduction.blocks.reducer import Reduction
from tumble.rotation import onto_body
from tumble.units import ACCEL_UNITS, Array

UNIT_TOLERANCE = 0.25
"""|a| at rest may differ from g by this part before the unit is doubted: bias and scale errors are less."""


def accelerometer_faults(reduction: Reduction, session: Session) -> list[str]:
    """Accelerometers that do not read gravity at the median: exchanged with gyros, or in a unit or with a scale or
    offset that cannot be right."""
    channels, gyro, g, rate = session.log.accel, session.log.gyro, session.site.gravity, reduction.rate
    accel, gyros = block_means(reduction)
    force = accel @ onto_body(channels.axes).T
    magnitude = float(np.median(np.linalg.norm(force, axis=1)))
    if _near(magnitude, g):
        return []
    if gyro is not None:  # what the columns of the gyros would read as accelerometers, as vectors in SI
        n = min(gyros.shape[1], len(channels.columns))
        logged = gyros[:, :n] / gyro.unit.factor * gyro.scale[:n] + gyro.offset[:n]
        meant = (logged - channels.offset[:n]) / channels.scale[:n] * channels.unit.factor
        meant = meant @ onto_body(channels.axes[:n]).T
        of_gyros = float(np.median(np.linalg.norm(meant, axis=1)))
        in_a_unit = magnitude < 0.5 * g and _fitting_units(of_gyros, channels, g, rate, ("rate",))
        if (_near(of_gyros, g) and _like_gravity(meant)) or in_a_unit:
            return [
                f"accelerometer and gyro columns are exchanged: the accelerometers read {magnitude:.3g} m/s^2 and the "
                f"gyro columns have the magnitude of gravity; exchange [log.accel] columns and [log.gyro] columns"
            ]
    read = f"the accelerometers read {magnitude:.4g} m/s^2 at the median, expected {g:.4g} m/s^2"
    if channels.raw:
        return [f"{read}: {_scale_or_offset(force, magnitude, channels, g)}"]
    units = _fitting_units(magnitude, channels, g, rate, ("rate", "increment") if _like_gravity(force) else ("rate",))
    if units:
        return [f'{read}: the unit of [log.accel] is not "{channels.unit_name}"; {" or ".join(units)} would fit']
    if magnitude < UNIT_TOLERANCE * g:
        return [f"{read}: gravity has been removed from the log; record the raw specific force"]
    return [f'{read}: the unit "{channels.unit_name}" of [log.accel] is not right, and no other known unit fits']


def _near(magnitude: float, g: float) -> bool:
    return abs(magnitude / g - 1.0) < UNIT_TOLERANCE


def _scale_or_offset(force: Array, magnitude: float, channels: Channels, g: float) -> str:
    """What is wrong with raw accelerometers: the offset where gravity shows about the middle of the readings, else
    the scale."""
    middle = 0.5 * (force.min(axis=0) + force.max(axis=0))
    about = float(np.median(np.linalg.norm(force - middle, axis=1)))
    if np.linalg.norm(middle) > 2.0 * g and abs(about / g - 1.0) < 2.0 * UNIT_TOLERANCE:
        raw = channels.offset + channels.scale * (channels.axes @ middle) / channels.unit.factor
        return f"the offset of [log.accel] is wrong; about {', '.join(f'{v:.4g}' for v in raw)} would fit"
    for name in ("m/s^2", "g"):
        if _near(magnitude / channels.unit.factor * ACCEL_UNITS[name].factor, g):
            return f'the scale of [log.accel] would fit with scale_per = "{name}"'
    return f"the nominal scale of [log.accel] is about {times_wrong(magnitude / g)}, or its offset is wrong"


def times_wrong(ratio: float) -> str:
    """How wrong a nominal scale is whose readings are `ratio` times what they should be."""
    return f"{ratio:.3g} times too small" if ratio > 1.0 else f"{1.0 / ratio:.3g} times too large"


def _fitting_units(magnitude: float, channels: Channels, g: float, rate: float, kinds: tuple[str, ...]) -> list[str]:
    """Units of accelerometers of these kinds in which a magnitude logged in the stated unit would be g."""
    stated = channels.unit.per_second(rate)
    return [
        f'"{name}"'
        for name, unit in ACCEL_UNITS.items()
        if not channels.raw and unit.kind in kinds and _near(magnitude * unit.per_second(rate) / stated, g)
    ]


def _like_gravity(force: Array) -> bool:
    """Whether vectors (K, 3) have one length and many directions: not what is left where gravity was removed."""
    length = np.linalg.norm(force, axis=1)
    low, median, high = np.quantile(length, [0.25, 0.5, 0.75])
    about = float(np.median(np.linalg.norm(force - np.median(force, axis=0), axis=1)))
    return bool(high - low < UNIT_TOLERANCE * median and about > UNIT_TOLERANCE * median)
