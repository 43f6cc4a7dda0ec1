"""When the drift of a parameter carries it to a limit, and how well that is known.

On the line of a trend (`tumble.registry.trend`) the parameter is at the time t, with Δ = t − t̄,

    y(t) = a + b Δ,   u(y)² = u_a² + 2 c Δ + u_b² Δ² + τ²                                                        (1)

c the covariance of a and b, τ the instability from run to run, so that it is the value of a single power-on. The limit
is expected to be met where y(t) is the limit; it may be met, with 95.45 %, between the two times at which
|limit − y(t)| = t(ν) u(y), the roots of a quadratic (Fieller). These are finite where the drift is beyond its U; a
drift that is not gives no forecast.
"""

from __future__ import annotations

import math
from datetime import datetime, timedelta

from tumble.registry.trend import YEAR, Drift, Trend
from tumble.registry.types import Forecast

HORIZON = 50.0
"""Years after the latest calibration, further than which nothing is forecast."""


def forecast(trend: Trend, limits: tuple[float, float]) -> Forecast | None:
    """When the last stretch of a trend meets the limit (SI) towards which it drifts; None without a drift beyond its U,
    without a limit on that side, where the limit is met already, and beyond HORIZON."""
    drift, points = trend.drift, trend.series.points
    if drift is None or not drift.beyond_u:
        return None
    limit = limits[1] if drift.per_year > 0.0 else limits[0]
    now = (points[-1].performed - points[0].performed) / YEAR
    expected = drift.since + (limit - drift.level) / drift.per_year
    if not math.isfinite(limit) or not now < expected <= now + HORIZON:
        return None
    earliest, latest = _between(drift, limit, trend.instability or 0.0)

    def at(years: float) -> datetime:
        moment: timedelta = years * YEAR
        return points[0].performed + moment

    return Forecast(
        name=trend.series.name,
        unit=trend.series.unit,
        limit=limit,
        expected=at(expected),
        earliest=at(max(earliest, now)),
        latest=at(latest) if latest <= now + HORIZON else None,
    )


def _between(drift: Drift, limit: float, instability: float) -> tuple[float, float]:
    """The roots of |limit − y(t)| = t(ν) u(y), Eq. (1), years since the first calibration."""
    k = (drift.expanded or 0.0) / drift.u
    off, b = limit - drift.level, drift.per_year
    A = b**2 - (k * drift.u) ** 2
    half = off * b + k**2 * drift.level_with_drift
    C = off**2 - k**2 * (drift.level_u**2 + instability**2)
    root = math.sqrt(max(half**2 - A * C, 0.0))
    return drift.since + (half - root) / A, drift.since + (half + root) / A
