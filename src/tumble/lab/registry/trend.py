"""The trend of a device: run to run, drift a year, as found against as left, and when a drift meets a limit.

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

The u_i are without what all calibrations share: the uncertainty of the same stated gravity, that of the same time
base, and what only priors say of the device. With g_i what one standard uncertainty of these changes in y_i, u_i² is
less by |g_i|² and more by |g_i − ḡ|², for what is the same every time is no part of a drift, nor of a change between
two that share it (`tumble.result.shared_errors`). The level of the line has |ḡ|² in its variance. A parameter of which
no more than its prior is known has neither τ nor drift.

A change has the expanded uncertainty U = t(ν) u with ν by Welch and Satterthwaite (`tumble.result.coverage`).
Whether the last one is beyond chance says the comparison of the two calibrations (`tumble.use.compare`).

On this line the parameter is at the time t, with Δ = t − t̄,

    y(t) = a + b Δ,   u(y)² = u_a² + 2 c Δ + u_b² Δ² + τ²                                                        (1)

c the covariance of a and b, τ the instability from run to run, so that it is the value of a single power-on. The limit
is expected to be met where y(t) is the limit; it may be met, with 95.45 %, between the two times at which
|limit − y(t)| = t(ν) u(y), the roots of a quadratic (Fieller). These are finite where the drift is beyond its U; a
drift that is not gives no forecast.

Sources: Mandel & Paule, Anal. Chem. 42 (1970) 1194, for τ; JCGM 100 (GUM) G.4 for t; ISO 13528, 9.7 for E_n; Fieller,
J. R. Stat. Soc. B 16 (1954) 175.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from itertools import pairwise
from typing import ClassVar

import numpy as np
import scipy

from tumble.lab.conformity import Result, judge_value
from tumble.lab.limits import Limits
from tumble.lab.registry.records import Forecast, Record, State
from tumble.methods.least_squares import scatter_of
from tumble.result.calibration import Calibration
from tumble.result.coverage import apart, by_gravity
from tumble.result.shared_errors import by_priors, of_time_base
from tumble.units import Array
from tumble.use.compare import Comparison, Difference, compare_calibrations

YEAR = timedelta(days=365.25)
HORIZON = 50.0
"""Years after the latest calibration, further than which nothing is forecast."""
COVERED = float(scipy.special.ndtr(2.0))
"""One-sided probability of two standard deviations of a normal distribution."""

Past = Sequence[tuple[Record, Calibration]]
"""The records of a device with their calibrations, all in one frame, in the order in which they were performed."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Point:
    """A parameter in one calibration, SI.

    Parameters
    ----------
    number, performed, state
        Of the record.
    value, u, dof
        Value, standard uncertainty, and its degrees of freedom; None where the uncertainty is known.
    launches
        Value and standard uncertainty in each launch, if the calibration is the mean of several.
    shared
        Change of the value with one standard uncertainty of each source whose error another calibration may share.
    """

    json_fields: ClassVar = ("number", "performed", "state", "value", "u", "dof")

    number: int
    performed: datetime
    state: State
    value: float
    u: float | None
    dof: float | None = None
    launches: tuple[tuple[float, float | None], ...] = ()
    shared: Mapping[Hashable, float] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, slots=True)
class Drift:
    """A drift in SI a year with its standard and its expanded uncertainty.

    Without degrees of freedom nothing shows how unstable the device is from run to run, and there is no expanded
    uncertainty. The line: `level` (SI) at `since` (years since the first calibration) in the last stretch, with its
    standard uncertainty and its covariance with the drift."""

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
    """What changed between two records: by an `adjustment`, or in use."""

    json_fields: ClassVar[tuple[str, ...]] = (*Difference.json_fields, "earlier", "later", "adjustment")

    earlier: int
    later: int
    adjustment: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class ParameterTrend:
    """A parameter over the calibrations that have it.

    Parameters
    ----------
    run_to_run, run_to_run_degrees
        Standard deviation of launches about the means of their calibrations, SI, and its degrees of freedom.
    instability
        τ; None where no two launches or calibrations show it.
    """

    name: str
    unit: str
    points: tuple[Point, ...]
    run_to_run: float | None
    run_to_run_degrees: int
    instability: float | None
    drift: Drift | None
    changes: tuple[Change, ...]

    @property
    def last_change(self) -> Change | None:
        """As left against as found: the last change that was not an adjustment."""
        return next((change for change in reversed(self.changes) if not change.adjustment), None)


@dataclass(frozen=True, kw_only=True, slots=True)
class Trend:
    """A device over its calibrations against the limits of the periodic check that are in force now.

    Parameters
    ----------
    latest
        Its latest record.
    frame
        In which all values are.
    limits
        Lowest and highest value by parameter, SI.
    comparison
        The latest calibration that is no adjustment with the one before it; None without two.
    """

    json_fields: ClassVar = ("serial", "frame", "limits", "parameters", "changed", "forecasts")

    latest: Record
    frame: str
    parameters: tuple[ParameterTrend, ...]
    limits: Mapping[str, tuple[float, float]]
    comparison: Comparison | None = None

    @property
    def serial(self) -> str:
        return self.latest.serial

    @property
    def latest_verdicts(self) -> Mapping[str, Result]:
        """The verdict on the latest value of every parameter that has limits."""
        return {t.name: self._verdict(t, t.points[-1]) for t in self.parameters if t.name in self.limits}

    def verdicts(self, trend: ParameterTrend) -> Mapping[int, Result]:
        """The verdicts on a parameter in every record, by number; none without limits."""
        limited = trend.name in self.limits
        return {point.number: self._verdict(trend, point) for point in trend.points} if limited else {}

    def _verdict(self, trend: ParameterTrend, point: Point) -> Result:
        return judge_value(point.value, point.u, *self.limits[trend.name], dof=point.dof)

    @property
    def forecasts(self) -> list[Forecast]:
        """When parameters that are inside their limits meet them by their drift, the earliest first."""
        passing = {name for name, verdict in self.latest_verdicts.items() if verdict == "pass"}
        met = [forecast(trend, self.limits[trend.name]) for trend in self.parameters if trend.name in passing]
        return sorted((each for each in met if each is not None), key=lambda each: each.earliest)

    @property
    def changed(self) -> list[str]:
        """The parameters that have changed by more than chance makes since the calibration before, or where none does
        by itself, that they have together."""
        if self.comparison is None:
            return []
        names = {trend.name for trend in self.parameters}
        together = len(names) > 1 and self.comparison.contradicts
        return [name for name in self.comparison.changed if name in names] or ["all parameters together"] * together


def trend_of(past: Past, limits: Limits | None, names: Iterable[str], comparison: Comparison | None = None) -> Trend:
    """The trend of a device over its past: of the parameters `names`, in the order of the latest calibration."""
    points: dict[str, list[Point]] = {name: [] for name in names}
    units: dict[str, str] = {}
    for record, calibration in reversed(past):
        launches: dict[tuple[str, str], list[tuple[float, float | None]]] = {}
        for p in (p for launch in calibration.evidence.launches for p in launch.parameters):
            launches.setdefault((p.name, p.unit), []).append((p.value, p.u))
        sources = _sources(calibration)
        for i, p in enumerate(calibration.parameters):
            if p.name in points and units.setdefault(p.name, p.unit) == p.unit:
                point = Point(
                    number=record.number,
                    performed=record.performed,
                    state=record.state,
                    value=p.value,
                    u=p.u,
                    dof=p.dof,
                    launches=tuple(launches.get((p.name, p.unit), ())),
                    shared={source: float(change[i]) for source, change in sources.items()},
                )
                points[p.name].append(point)
    (latest, calibration), ends = past[-1], dict[str, tuple[float, float]]()
    if limits is not None:
        ends = {name: between for name in units if (between := limits.of(name, "periodic")) is not None}
    return Trend(
        latest=latest,
        frame=calibration.frame,
        parameters=tuple(parameter_trend(name, unit, points[name][::-1]) for name, unit in units.items()),
        limits=ends,
        comparison=comparison,
    )


def _sources(calibration: Calibration) -> dict[Hashable, Array]:
    """Changes (m,) of the parameters with one standard uncertainty of each source of error that another calibration of
    the device shares if it has the same: the stated gravity, the time base, what priors are of."""
    parameters, covariance, site = calibration.parameters, calibration.covariance, calibration.provenance.site
    changes = by_priors(parameters, covariance, calibration.evidence.budget)
    sources: dict[Hashable, Array] = {("prior", name): g for name, g in changes.items()}
    if site is not None and site.gravity_u > 0.0:
        sources["gravity", site.gravity, site.gravity_u] = by_gravity(parameters, covariance, site)
    if calibration.provenance.clock_u > 0.0:
        sources["time base", calibration.provenance.clock_u] = of_time_base(calibration)
    return sources


def latest_comparison(past: Past) -> Comparison | None:
    """The last calibration of a device that is no adjustment compared with the one before it; None where there are no
    two with parameters in common."""
    latest = next((i for i in range(len(past) - 1, 0, -1) if past[i][0].state != "as-left"), None)
    if latest is None:
        return None
    earlier, later = past[latest - 1][1], past[latest][1]
    if not {p.name for p in later.parameters} & {p.name for p in earlier.parameters}:
        return None
    return compare_calibrations(earlier, later)


def parameter_trend(name: str, unit: str, points: Sequence[Point]) -> ParameterTrend:
    """Run-to-run instability, drift and changes of a parameter."""
    spreads = [np.array([value for value, _ in p.launches]) for p in points if len(p.launches) > 1]
    degrees = sum(len(values) - 1 for values in spreads)
    squares = sum(float(np.sum((values - values.mean()) ** 2)) for values in spreads)
    instability, drift = _instability_and_drift(points)
    return ParameterTrend(
        name=name,
        unit=unit,
        points=tuple(points),
        run_to_run=math.sqrt(squares / degrees) if degrees else None,
        run_to_run_degrees=degrees,
        instability=instability,
        drift=drift,
        changes=tuple(
            Change.between(
                earlier,
                later,
                *_shared([earlier, later]),
                name=name,
                unit=unit,
                earlier=earlier.number,
                later=later.number,
                adjustment=later.state == "as-left",
            )
            for earlier, later in pairwise(points)
        ),
    )


def _shared(points: Sequence[Point]) -> Array:
    """Changes (n, k) of the points with one standard uncertainty of every source that all of them share."""
    common = [source for source in points[0].shared if all(source in p.shared for p in points)]
    return np.array([[p.shared[source] for source in common] for p in points]).reshape(len(points), len(common))


# -------------------- drift --------------------


def _instability_and_drift(points: Sequence[Point]) -> tuple[float | None, Drift | None]:
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
        variances = np.array([apart(u, None, g.tolist())[0] for _, u in p.launches])
        if variance[i] == 0.0 or not np.all(variances > 0.0):
            return None, None
        of_mean[i] = variances.sum() / max(count[i], 1) ** 2
        if count[i] > 1:
            values = np.array([value for value, _ in p.launches])
            launch_variance.append(variances)
            launch_square.append((values - values.mean()) ** 2)
    within, squares = (np.concatenate(each) if each else np.empty(0) for each in (launch_variance, launch_square))

    # a column for the level of each stretch between adjustments and, where any has two times, one of the years
    stretch = np.cumsum([i > 0 and p.state == "as-left" for i, p in enumerate(points)])
    t = np.array([(p.performed - points[0].performed) / YEAR for p in points], dtype=float)
    y = np.array([p.value for p in points])
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


def forecast(trend: ParameterTrend, limits: tuple[float, float]) -> Forecast | None:
    """When the last stretch of a trend meets the limit (SI) towards which it drifts; None without a drift beyond its U,
    without a limit on that side, where the limit is met already, and beyond HORIZON."""
    drift, points = trend.drift, trend.points
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
        name=trend.name,
        unit=trend.unit,
        limit=limit,
        expected=at(expected),
        earliest=at(max(earliest, now)),
        latest=at(latest) if latest <= now + HORIZON else None,
    )
