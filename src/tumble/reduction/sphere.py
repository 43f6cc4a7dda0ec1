"""The sphere through points, as readings of a vector of constant length: its centre is their bias, its radius their
scale."""

from __future__ import annotations

import numpy as np

from tumble.units import Array


def sphere_through(points: Array, least: float | None = None) -> tuple[Array, float]:
    """Centre (3,) and radius of the sphere nearest to points (N, 3), |y|² = 2 y·c + r² − |c|² by least squares about
    their mean. Along directions in which they are spread by less than the part `least` of the widest the centre is
    their mean."""
    mean = points.mean(axis=0)
    away = points - mean
    square = (away**2).sum(axis=1)
    offset = np.linalg.lstsq(2.0 * away, square - square.mean(), rcond=least)[0]
    return mean + offset, float(np.sqrt(square.mean() + offset @ offset))
