"""The trend of a device: run to run, drift a year, as found against as left.

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
two that share it (`tumble.result.shared_errors`). A parameter of which no more than its prior is known has neither τ
nor drift.

A change has the expanded uncertainty U = t(ν) u with ν by Welch and Satterthwaite (`tumble.result.coverage`).
Whether the last one is beyond chance says the comparison of the two calibrations (`tumble.use.compare`).

Sources: Mandel & Paule, Anal. Chem. 42 (1970) 1194, for τ; JCGM 100 (GUM) G.4 for t; ISO 13528, 9.7 for E_n.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime, timedelta
from itertools import pairwise
from typing import ClassVar

import numpy as np
import scipy

from tumble.errors import InputError
from tumble.lab.conformity import Result, judge_value
from tumble.lab.limits import Limits
from tumble.lab.registry.records import Record, State
from tumble.methods.least_squares import scatter_of
from tumble.result.calibration import Calibration
from tumble.result.coverage import gravity_sensitivity, unshared_variance
from tumble.result.shared_errors import prior_sensitivities, time_base_sensitivity
from tumble.units import Array
from tumble.use.compare import Comparison, Difference, compare_calibrations

YEAR = timedelta(days=365.25)
COVERED = float(scipy.special.ndtr(2.0))
"""One-sided probability of two standard deviations of a normal distribution."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Point:
    """A parameter in the calibration of a record, SI: its value, its standard uncertainty and the degrees of freedom of
    that, None where it is known; value and standard uncertainty in each launch, if the calibration is the mean of
    several; and the change of the value with one standard uncertainty of each source whose error another calibration
    may have `shared`."""

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
    """A drift in SI a year with its standard and its expanded uncertainty. Without degrees of freedom nothing shows how
    unstable the device is from run to run, and there is no expanded uncertainty."""

    per_year: float
    u: float
    degrees: int
    expanded: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Change(Difference):
    """What changed between two records: by an `adjustment`, or in use."""

    json_fields: ClassVar[tuple[str, ...]] = (*Difference.json_fields, "earlier", "later", "adjustment")

    earlier: int
    later: int
    adjustment: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class ParameterTrend:
    """A parameter over the calibrations that have it. `run_to_run` is the standard deviation of launches about the
    means of their calibrations, SI, with its degrees of freedom; `instability` is τ, None where no two launches or
    calibrations show it."""

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
    """A device by its `latest` record, over its calibrations in one `frame`, against the `limits` of the periodic check
    that are in force now: the lowest and the highest value by parameter, SI. `comparison` is that of the latest
    calibration that is no adjustment with the one before it; None without two."""

    json_fields: ClassVar = ("serial", "frame", "limits", "parameters", "changed")

    latest: Record
    frame: str
    parameters: tuple[ParameterTrend, ...]
    limits: Mapping[str, tuple[float, float]]
    comparison: Comparison | None

    @property
    def serial(self) -> str:
        """Of the device."""
        return self.latest.serial

    def of(self, parameter: str) -> Trend:
        """That of one parameter alone. Raises InputError where there is none of this name."""
        names = [each.name for each in self.parameters]
        if parameter not in names:
            raise InputError(f"device {self.serial!r}: expected one of {', '.join(names)}, found {parameter!r}")
        limits = {name: ends for name, ends in self.limits.items() if name == parameter}
        return replace(self, parameters=(self.parameters[names.index(parameter)],), limits=limits)

    def verdicts(self, trend: ParameterTrend) -> Mapping[int, Result]:
        """The verdicts on a parameter in every record, by number; none without limits."""
        ends = self.limits.get(trend.name)
        return {p.number: judge_value(p.value, p.u, *ends, dof=p.dof) for p in trend.points} if ends else {}

    @property
    def changed(self) -> list[str]:
        """The parameters that have changed by more than chance makes since the calibration before, or where none does
        by itself, that they have together."""
        if self.comparison is None:
            return []
        names = {trend.name for trend in self.parameters}
        together = len(names) > 1 and self.comparison.contradicts
        return [name for name in self.comparison.changed if name in names] or ["all parameters together"] * together


def trend_of(past: Sequence[tuple[Record, Calibration]], limits: Limits | None) -> Trend:
    """The trend of a device over its records with their calibrations, in one frame and in the order in which they were
    performed; parameters in the order of the latest calibration."""
    points, units = dict[str, list[Point]](), dict[str, str]()
    for record, calibration in reversed(past):
        sources = _sources(calibration)
        launches = [q for launch in calibration.evidence.launches for q in launch.parameters]
        for i, p in enumerate(calibration.parameters):
            if units.setdefault(p.name, p.unit) != p.unit:
                continue
            point = Point(
                number=record.number,
                performed=record.performed,
                state=record.state,
                value=p.value,
                u=p.u,
                dof=p.dof,
                launches=tuple((q.value, q.u) for q in launches if (q.name, q.unit) == (p.name, p.unit)),
                shared={source: float(change[i]) for source, change in sources.items()},
            )
            points.setdefault(p.name, []).insert(0, point)
    ends = {} if limits is None else {name: limits.of(name, "periodic") for name in points}
    return Trend(
        latest=past[-1][0],
        frame=past[-1][1].frame,
        parameters=tuple(parameter_trend(name, units[name], each) for name, each in points.items()),
        limits={name: between for name, between in ends.items() if between is not None},
        comparison=_latest_comparison(past),
    )


def _sources(calibration: Calibration) -> dict[Hashable, Array]:
    """Changes (m,) of the parameters with one standard uncertainty of each source of error that another calibration of
    the device shares if it has the same: the stated gravity, the time base, what priors are of."""
    parameters, covariance, site = calibration.parameters, calibration.covariance, calibration.provenance.site
    changes = prior_sensitivities(parameters, covariance, calibration.evidence.budget)
    sources: dict[Hashable, Array] = {("prior", name): g for name, g in changes.items()}
    if site is not None and site.gravity_u > 0.0:
        sources["gravity", site.gravity, site.gravity_u] = gravity_sensitivity(parameters, covariance, site)
    if calibration.provenance.clock_u > 0.0:
        sources["time base", calibration.provenance.clock_u] = time_base_sensitivity(calibration)
    return sources


def _latest_comparison(past: Sequence[tuple[Record, Calibration]]) -> Comparison | None:
    """The last calibration of a device that is no adjustment compared with the one before it; None where there are no
    two with parameters in common."""
    pairs = [(first, second) for (_, first), (record, second) in pairwise(past) if record.state != "as-left"]
    if not pairs or not set(pairs[-1][0]) & set(pairs[-1][1]):
        return None
    return compare_calibrations(*pairs[-1])


def parameter_trend(name: str, unit: str, points: Sequence[Point]) -> ParameterTrend:
    """Run-to-run instability, drift and changes of a parameter."""
    launches = [np.array([value for value, _ in p.launches]) for p in points if p.launches]
    degrees = sum(len(values) - 1 for values in launches)
    squares = sum(float(np.sum((values - values.mean()) ** 2)) for values in launches)
    instability, drift = _instability_and_drift(points)
    changes = []
    for first, second in pairwise(points):
        of_records = Change.between(
            first,
            second,
            *_shared([first, second]),
            name=name,
            unit=unit,
            earlier=first.number,
            later=second.number,
            adjustment=second.state == "as-left",
        )
        changes.append(of_records)
    return ParameterTrend(
        name=name,
        unit=unit,
        points=tuple(points),
        run_to_run=math.sqrt(squares / degrees) if degrees else None,
        run_to_run_degrees=degrees,
        instability=instability,
        drift=drift,
        changes=tuple(changes),
    )


def _shared(points: Sequence[Point]) -> Array:
    """Changes (n, k) of the points with one standard uncertainty of every source that all of them share."""
    common = [source for source in points[0].shared if all(source in p.shared for p in points)]
    return np.array([[p.shared[source] for source in common] for p in points]).reshape(len(points), len(common))


def _instability_and_drift(points: Sequence[Point]) -> tuple[float | None, Drift | None]:
    """τ and the drift, as far as the points say anything about them (module docstring)."""
    if not points or not all(p.u and all(u for _, u in p.launches) for p in points):
        return None, None
    shared = _shared(points)
    common = ((shared - shared.mean(axis=0)) ** 2).sum(axis=1)
    variance = np.array([unshared_variance(p.u, None, g)[0] for p, g in zip(points, shared, strict=True)]) + common
    of_launches = [
        [unshared_variance(u, None, g)[0] for _, u in p.launches] for p, g in zip(points, shared, strict=True)
    ]
    within = np.array([each for several in of_launches for each in several])  # a launch
    squares = np.array([(y - np.mean([x for x, _ in p.launches])) ** 2 for p in points for y, _ in p.launches])
    if not variance.all() or not within.all():
        return None, None
    count = np.array([max(len(each), 1) for each in of_launches])
    # variances of the points without τ²: of the mean of launches, and the least that there is
    of_mean = np.array(
        [sum(each) / len(each) ** 2 if each else v for each, v in zip(of_launches, variance, strict=True)]
    )
    least = np.array([v if each else 0.0 for each, v in zip(of_launches, variance, strict=True)])

    # a column for the level of each stretch between adjustments and, where any has two times, one of the years
    stretch = np.cumsum([i > 0 and p.state == "as-left" for i, p in enumerate(points)])
    t = np.array([(p.performed - points[0].performed) / YEAR for p in points], dtype=float)
    y = np.array([p.value for p in points])
    X = (stretch[:, None] == np.arange(stretch[-1] + 1)).astype(float)
    drifts = any(np.ptp(t[stretch == s]) > 0.0 for s in range(X.shape[1]))
    X = np.column_stack([X, t - t.mean()]) if drifts else X

    def line(tau: float) -> tuple[Array, Array, float]:
        """Weighted least squares: Qᵀy and R of the whitened columns, and chi-square of the residuals."""
        u = np.sqrt(np.maximum(least, of_mean + tau**2 / count))
        Q, R = np.linalg.qr(X / u[:, None])
        z = Q.T @ (y / u)
        return z, R, float(np.sum((y / u - Q @ z) ** 2))

    degrees, tau = len(points) - X.shape[1] + int((count - 1).sum()), None
    if degrees > 0:
        start = float(np.median(np.sqrt(variance)))
        tau = scatter_of(lambda s: line(s)[2] + float(np.sum(squares / (within + s**2))) - degrees, start)
    if not drifts:
        return tau, None
    z, R, _ = line(tau or 0.0)
    of_drift = np.linalg.inv(R)[-1]
    u = float(np.linalg.norm(of_drift))
    expanded = float(scipy.special.stdtrit(degrees, COVERED)) * u if degrees > 0 else None
    return tau, Drift(per_year=float(of_drift @ z), u=u, degrees=degrees, expanded=expanded)
