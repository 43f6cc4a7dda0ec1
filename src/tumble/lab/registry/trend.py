"""What the calibrations of a device say together: run to run, drift a year, as found against as left.

A parameter y, calibrated at the times t_i (years), is modelled as

    y_i = a_s + b t_i + e_i,    var e_i = v_i = u_i² + τ²            one launch
                                      v_i = max(u_i², Σ_l u_il²/L² + τ²/L)    the mean of L launches

b is the drift; an adjustment (a record `as-left`) begins a new stretch s with its own a_s. τ is the instability from
run to run (power-on to power-on): what one calibration cannot know of the next one. It is the scatter at which the
chi-squares of the residuals about the line and of the launches about their means,

    Σ_i (y_i − a_s − b t_i)²/v_i + Σ_i Σ_l (y_il − ȳ_i)²/(u_il² + τ²) = ν,    ν = n − p + Σ_i (L_i − 1),

are together what their degrees of freedom ν expect (p parameters a_s, b); zero where they are less already. Then b and
its variance follow by weighted least squares, and U = t(ν) u(b) with Student's t for 95.45 %, the probability of ±2u of
a normal distribution.

The u_i are without the uncertainty of gravity where all calibrations used the same stated gravity, without that of the
time base where all state the same, and without what only priors say of the device: with g_i what one standard
uncertainty of these changes in y_i, u_i² is less by |g_i|² and more by |g_i − ḡ|², for what is the same every time is
no part of a drift, nor of a change between two that share it (`tumble.result.shared_errors`). The level of the
line has |ḡ|² in its variance. A parameter of which no more than its prior is known has neither τ nor drift.

A change has the expanded uncertainty U = t(ν) u with ν by Welch and Satterthwaite (`tumble.result.coverage`).
Whether the last one is beyond chance says the comparison of the two calibrations (`tumble.use.compare`).

Source: Mandel & Paule, Anal. Chem. 42 (1970) 1194, for τ; JCGM 100 (GUM) G.4 for t; ISO 13528, 9.7 for E_n.

When the drift of a parameter carries it to a limit, and how well that is known.

On the line of a trend (`tumble.lab.registry.trend`) the parameter is at the time t, with Δ = t − t̄,

    y(t) = a + b Δ,   u(y)² = u_a² + 2 c Δ + u_b² Δ² + τ²                                                        (1)

c the covariance of a and b, τ the instability from run to run, so that it is the value of a single power-on. The limit
is expected to be met where y(t) is the limit; it may be met, with 95.45 %, between the two times at which
|limit − y(t)| = t(ν) u(y), the roots of a quadratic (Fieller). These are finite where the drift is beyond its U; a
drift that is not gives no forecast.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from itertools import pairwise

import numpy as np
import scipy

from tumble.lab.registry.series import Series, SeriesPoint
from tumble.lab.registry.types import Forecast
from tumble.methods.least_squares import scatter_of
from tumble.result.coverage import apart, shared_gravity
from tumble.result.shared_errors import shared_time_base
from tumble.units import Array
from tumble.use.compare import Difference

YEAR = timedelta(days=365.25)
COVERED = 0.5 + 0.5 * math.erf(2.0 / math.sqrt(2.0))
"""One-sided probability of two standard deviations of a normal distribution."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Drift:
    """A drift in SI a year with its standard and its expanded uncertainty; without degrees of freedom nothing says how
    unstable the device is from run to run, and there is no expanded one. The line: `level` (SI) at `since` (years
    since the first calibration) in the last stretch, with its standard uncertainty and its covariance with the
    drift."""

    per_year: float
    u: float
    degrees: int
    expanded: float | None
    level: float
    level_u: float
    level_with_drift: float
    since: float

    @property
    def beyond_u(self) -> bool:
        """Whether it is larger than its U."""
        return self.expanded is not None and abs(self.per_year) > self.expanded


@dataclass(frozen=True, kw_only=True, slots=True)
class Change(Difference):
    """What changed between two records. Not by `adjustment`: in use."""

    earlier: int
    later: int
    adjustment: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Trend:
    """A parameter over time. `run_to_run` is the standard deviation of launches about the means of their calibrations,
    SI, with its degrees of freedom; `instability` is τ; None where no two launches or calibrations show it."""

    series: Series
    run_to_run: float | None
    run_to_run_degrees: int
    instability: float | None
    drift: Drift | None
    changes: tuple[Change, ...]

    @property
    def last_change(self) -> Change | None:
        """As left against as found: the last change that was not an adjustment."""
        return next((change for change in reversed(self.changes) if not change.adjustment), None)


def trend_of(series: Series) -> Trend:
    """Run-to-run instability, drift and changes of a parameter."""
    points = series.points
    spreads = [np.array([value for value, _ in p.launches]) for p in points if len(p.launches) > 1]
    degrees = sum(len(values) - 1 for values in spreads)
    squares = sum(float(np.sum((values - values.mean()) ** 2)) for values in spreads)
    instability, drift = _instability_and_drift(points)
    return Trend(
        series=series,
        run_to_run=math.sqrt(squares / degrees) if degrees else None,
        run_to_run_degrees=degrees,
        instability=instability,
        drift=drift,
        changes=tuple(
            Change.between(
                earlier,
                later,
                *_shared([earlier, later]),
                name=series.name,
                unit=series.unit,
                earlier=earlier.number,
                later=later.number,
                adjustment=later.state == "as-left",
            )
            for earlier, later in pairwise(points)
        ),
    )


def years(points: Sequence[SeriesPoint]) -> Array:
    """When points were measured, years since the first."""
    return np.array([(p.performed - points[0].performed) / YEAR for p in points], dtype=float)


def _shared(points: Sequence[SeriesPoint]) -> Array:
    """Changes (n, k) of the points with one standard uncertainty of all that they share: gravity, the time base, and
    what only priors say of the device."""
    columns = []
    if all(shared_gravity(points[0].site, p.site) for p in points):
        columns.append([p.by_gravity for p in points])
    if all(shared_time_base(points[0].clock_u, p.clock_u) for p in points):
        columns.append([p.by_clock for p in points])
    names = [name for name in points[0].by_priors if all(name in p.by_priors for p in points)]
    columns += [[p.by_priors[name] for p in points] for name in names]
    return np.array(columns, dtype=float).reshape(-1, len(points)).T


# -------------------- drift --------------------


def _instability_and_drift(points: Sequence[SeriesPoint]) -> tuple[float | None, Drift | None]:
    """τ and the drift, as far as the points say anything about them (module docstring)."""
    if not points or not all(p.u and all(u for _, u in p.launches) for p in points):
        return None, None
    shared = _shared(points)
    mean = shared.mean(axis=0)
    variance = np.empty(len(points))  # of the points, and that of the means of their launches, without τ²
    of_mean, count = np.zeros(len(points)), np.array([len(p.launches) for p in points])
    launch_variance, launch_square = [], []
    for i, (p, g) in enumerate(zip(points, shared, strict=True)):
        variance[i] = apart(p.u, None, g.tolist())[0] + float((g - mean) @ (g - mean))
        own = np.array([apart(u, None, g.tolist())[0] for _, u in p.launches])
        if variance[i] == 0.0 or not np.all(own > 0.0):
            return None, None
        of_mean[i] = own.sum() / max(count[i], 1) ** 2
        if count[i] > 1:
            values = np.array([value for value, _ in p.launches])
            launch_variance.append(own)
            launch_square.append((values - values.mean()) ** 2)
    within, squares = (np.concatenate(each) if each else np.empty(0) for each in (launch_variance, launch_square))

    # a column for the level of each stretch between adjustments and, where any has two times, one of the years
    stretch = np.cumsum([i > 0 and p.state == "as-left" for i, p in enumerate(points)])
    t, y = years(points), np.array([p.value for p in points])
    X = (stretch[:, None] == np.arange(stretch[-1] + 1)).astype(float)
    levels = X.shape[1]
    drifts = any(np.ptp(t[stretch == s]) > 0.0 for s in range(levels))
    X = np.column_stack([X, t - t.mean()]) if drifts else X

    def line(tau: float) -> tuple[Array, Array, float]:
        """Weighted least squares: Q and R of the whitened columns, and chi-square of the residuals."""
        u = np.sqrt(
            np.where(count > 0, np.maximum(variance, of_mean + tau**2 / np.maximum(count, 1)), variance + tau**2)
        )
        Q, R = np.linalg.qr(X / u[:, None])
        z = Q.T @ (y / u)
        return z, R, float(np.sum((y / u - Q @ z) ** 2))

    degrees = len(points) - X.shape[1] + int(np.maximum(count - 1, 0).sum())
    tau = None
    if degrees > 0:
        start = float(np.median(np.sqrt(variance)))
        tau = scatter_of(lambda s: line(s)[2] + float(np.sum(squares / (within + s**2))) - degrees, start)
    if not drifts:
        return tau, None
    z, R, _ = line(tau or 0.0)
    inverse = np.linalg.inv(R)
    values, covariance = inverse @ z, inverse @ inverse.T
    u, last = math.sqrt(float(covariance[-1, -1])), levels - 1
    return tau, Drift(
        per_year=float(values[-1]),
        u=u,
        degrees=degrees,
        expanded=float(scipy.special.stdtrit(degrees, COVERED)) * u if degrees > 0 else None,
        level=float(values[last]),
        level_u=math.sqrt(float(covariance[last, last] + mean @ mean)),
        level_with_drift=float(covariance[last, -1]),
        since=float(t.mean()),
    )


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
    # the roots of |limit − y(t)| = t(ν) u(y), Eq. (1)
    k, off, b = (drift.expanded or 0.0) / drift.u, limit - drift.level, drift.per_year
    A = b**2 - (k * drift.u) ** 2
    half = off * b + k**2 * drift.level_with_drift
    C = off**2 - k**2 * (drift.level_u**2 + (trend.instability or 0.0) ** 2)
    root = math.sqrt(max(half**2 - A * C, 0.0))
    earliest, latest = drift.since + (half - root) / A, drift.since + (half + root) / A

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
