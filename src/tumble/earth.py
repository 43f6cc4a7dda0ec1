"""Normal gravity and the Earth's rotation at a site.

Source: WGS-84 (NIMA TR8350.2, 3rd edition): Somigliana's closed formula on the ellipsoid, eq. (4-1), and the
second-order expansion in height, eq. (4-3).
"""

from __future__ import annotations

import math

from tumble.arguments import checked
from tumble.errors import InputError

EARTH_RATE = 7.292115e-5
"""Angular velocity of the Earth, rad/s (WGS-84)."""

_POLE = 0.5 * math.pi * (1.0 + 1e-12)
_SEMI_MAJOR_AXIS = 6378137.0
_FLATTENING = 1.0 / 298.257223563
_GM = 3.986004418e14
_GRAVITY_EQUATOR = 9.7803253359
_GRAVITY_POLE = 9.8321849378
_ECCENTRICITY_2 = _FLATTENING * (2.0 - _FLATTENING)

NORMAL_GRAVITY_U = 3e-4
"""Standard uncertainty of normal gravity as local gravity, m/s², by gravity anomalies."""


@checked
def normal_gravity(latitude: float, height: float) -> float:
    """Return normal gravity, m/s², at a geodetic latitude (rad) and a height over the ellipsoid (m).

    Within 20 ng of the closed form up to 2 km. Source: TR8350.2 (4-1), (4-3). Raises InputError for a latitude beyond
    ±π/2, such as one in degrees.

    >>> import tumble
    >>> round(tumble.normal_gravity(0.992, 270.0), 5)
    9.81579
    """
    if not abs(latitude) <= _POLE:
        raise InputError(
            f"--latitude: expected radians from -π/2 to π/2, found {latitude:g}; for degrees, math.radians"
        )
    s2 = math.sin(latitude) ** 2
    a = _SEMI_MAJOR_AXIS
    semi_minor = a * (1.0 - _FLATTENING)
    k = semi_minor * _GRAVITY_POLE / (a * _GRAVITY_EQUATOR) - 1.0
    on_ellipsoid = _GRAVITY_EQUATOR * (1.0 + k * s2) / math.sqrt(1.0 - _ECCENTRICITY_2 * s2)
    m = EARTH_RATE**2 * a**2 * semi_minor / _GM
    linear = 2.0 / a * (1.0 + _FLATTENING + m - 2.0 * _FLATTENING * s2) * height
    return on_ellipsoid * (1.0 - linear + 3.0 * (height / a) ** 2)


def earth_rate(latitude: float) -> tuple[float, float, float]:
    """Return the Earth's rotation in geographic axes N, U, E, rad/s: (Ω cos B, Ω sin B, 0)."""
    return EARTH_RATE * math.cos(latitude), EARTH_RATE * math.sin(latitude), 0.0
