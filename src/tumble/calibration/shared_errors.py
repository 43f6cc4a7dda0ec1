"""What two calibrations of one device err by alike, so that it is no part of a difference between them.

The uncertainty of gravity, where both used the same stated gravity with the same uncertainty, is in the scale factors
of the accelerometers; that of the time base, where both of one device state the same one, in those of the gyros. With
g₁ and g₂ what one standard uncertainty of such a source changes in either,

    C(first − second) = C₁ + C₂ − Σ (g₁ g₂ᵀ + g₂ g₁ᵀ)
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from tumble.calibration.coverage import by_gravity, shared_gravity
from tumble.estimation.common_errors import by_time_base
from tumble.units import Array

if TYPE_CHECKING:
    from tumble.calibration.calibration_file import Calibration

GRAVITY, TIME_BASE = "gravity", "the time base"


def shared_errors(first: Calibration, second: Calibration) -> dict[str, tuple[Array, Array]]:
    """For every source whose error both share, what one standard uncertainty of it changes in all parameters of the
    first (m₁,) and of the second (m₂,)."""
    found = {}
    if shared_gravity(first.site, second.site):
        found[GRAVITY] = (_of_gravity(first), _of_gravity(second))
    if first.serial == second.serial and shared_time_base(first.clock_u, second.clock_u):
        found[TIME_BASE] = (_of_time_base(first), _of_time_base(second))
    return {source: changes for source, changes in found.items() if changes[0].any() and changes[1].any()}


def shared_time_base(first: float, second: float) -> bool:
    """Whether two calibrations of a device, with these relative uncertainties of the time base, share its error."""
    return first == second > 0.0


def _of_gravity(calibration: Calibration) -> Array:
    return by_gravity(calibration.parameters, calibration.covariance, calibration.site)


def _of_time_base(calibration: Calibration) -> Array:
    return by_time_base([p.name for p in calibration.parameters], calibration.clock_u)


def between(shared: Mapping[str, tuple[Array, Array]], count: int) -> Array:
    """The sum (m, m) of g₁ g₂ᵀ + g₂ g₁ᵀ of `count` parameters."""
    total = np.zeros((count, count))
    for first, second in shared.values():
        both = np.outer(first, second)
        total += both + both.T
    return total
