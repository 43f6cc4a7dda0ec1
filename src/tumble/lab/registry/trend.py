"""Trend of a device over its calibrations: instability from run to run, drift per year, changes.

A parameter y, calibrated at the times t_i (years), is modelled as

    y_i = a_s + b t_i + e_i,    var e_i = v_i = u_i² + τ²            one launch
                                      v_i = max(u_i², Σ_l u_il²/L² + τ²/L)    the mean of L launches

b is the drift; an adjustment (a record `as-left`) begins a new stretch s with its own level a_s. τ is the instability
from power-on to power-on, which a single calibration cannot show. It is the value for which the sum of two chi-squares,
of the residuals about the line and of the launches about their means,

    Σ_i (y_i − a_s − b t_i)²/v_i + Σ_i Σ_l (y_il − ȳ_i)²/(u_il² + τ²) = ν,    ν = n − p + Σ_i (L_i − 1),

equals its degrees of freedom ν (p parameters a_s, b), or zero if the sum is smaller already. Then b and its variance
follow by weighted least squares, and U = t(ν) u(b) with Student's t for 95.45 %, the probability of ±2u of a normal
distribution.

The u_i exclude errors that all calibrations share: those of the same stated gravity, of the same time base, and of
priors. If g_i is the change of y_i by one standard uncertainty of such a source, |g_i|² is subtracted from u_i² and
|g_i − ḡ|² added, because a constant error is not part of a drift (`tumble.result.shared_errors`). A parameter that is
known only by its prior has neither τ nor drift.

The latest change in use, and whether it is significant, are those of the comparison of the last two calibrations
without an adjustment between them (`tumble.use.compare`).

Sources: Mandel & Paule, Anal. Chem. 42 (1970) 1194, for τ; JCGM 100 (GUM) G.4 for t.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from itertools import pairwise
from typing import ClassVar

import numpy as np
import scipy

from tumble.lab.conformity import Verdict, judge_check
from tumble.lab.limits import Limits
from tumble.lab.registry.records import Record, State
from tumble.methods.least_squares import fit_scatter
from tumble.result.calibration import Calibration
from tumble.result.coverage import gravity_sensitivity, unshared_variance
from tumble.result.shared_errors import prior_sensitivities, time_base_sensitivity
from tumble.units import Array
from tumble.use.compare import Comparison, compare_calibrations

YEAR = timedelta(days=365.25)
COVERED = float(scipy.special.ndtr(2.0))
"""One-sided probability within two standard deviations of a normal distribution."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Point:
    """A parameter in one calibration, SI.

    `dof` are the degrees of freedom of `u`, None if these are infinite. `launches` has value and u of each launch where
    the calibration is a mean of several. `shared` is the change of the value by one standard uncertainty of each source
    of error that other calibrations of the device may share."""

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
    """Drift in SI per year with its standard uncertainty; without degrees of freedom the instability of the device is
    unknown, and there is no expanded uncertainty."""

    per_year: float
    u: float
    degrees: int
    expanded: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class ParameterTrend:
    """A parameter over the calibrations of a device. `run_to_run` is the pooled standard deviation of launches about
    the means of their calibrations, SI, with its degrees of freedom; `instability` is τ, None if it is unknown."""

    name: str
    unit: str
    points: tuple[Point, ...]
    run_to_run: float | None
    run_to_run_degrees: int
    instability: float | None
    drift: Drift | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Trend:
    """Trend of all parameters of a device in one `frame`.

    `acceptance` is the verdict on the latest calibration by the limits of the periodic check that are in force now,
    None without any. `comparison` compares two consecutive calibrations, the last ones without an adjustment between
    them, whose records have the numbers `compared`; None without two."""

    json_fields: ClassVar = ("serial", "frame", "acceptance", "parameters", "comparison", "compared", "changed")

    latest: Record
    frame: str
    parameters: tuple[ParameterTrend, ...]
    acceptance: Verdict | None
    comparison: Comparison | None
    compared: tuple[int, int] | None

    @property
    def serial(self) -> str:
        """Serial number of the device."""
        return self.latest.serial

    @property
    def changed(self) -> list[str]:
        """Parameters with a significant change since the calibration before, or "all parameters together"."""
        if self.comparison is None:
            return []
        together = len(self.parameters) > 1 and self.comparison.contradicts
        return [*self.comparison.changed] or ["all parameters together"] * together


def trend_of(past: Sequence[tuple[Record, Calibration]], limits: Limits | None) -> Trend:
    """Return the trend of a device from its records with their calibrations, in one frame and in chronological order,
    and the limits that are in force now."""
    points, units = dict[str, list[Point]](), dict[str, str]()
    for record, calibration in reversed(past):  # parameters in the order of the latest calibration
        # changes (m,) by one standard uncertainty of errors that another calibration of the device may share
        known, covariance, origin = calibration.parameters, calibration.covariance, calibration.provenance
        changes = prior_sensitivities(known, covariance, calibration.evidence.budget)
        sources: dict[Hashable, Array] = {("prior", name): g for name, g in changes.items()}
        if (site := origin.site) is not None and site.gravity_u > 0.0:
            sources["gravity", site.gravity, site.gravity_u] = gravity_sensitivity(known, covariance, site)
        if origin.clock_u > 0.0:
            sources["time base", origin.clock_u] = time_base_sensitivity(calibration)
        launches = [q for launch in calibration.evidence.launches for q in launch.parameters]
        for i, p in enumerate(known):
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
    comparison: Comparison | None = None
    compared: tuple[int, int] | None = None
    if in_use := [pair for pair in pairwise(past) if pair[1][0].state != "as-left"]:
        (earlier, first), (later, second) = in_use[-1]
        if set(first) & set(second):
            comparison, compared = compare_calibrations(first, second), (earlier.number, later.number)
    return Trend(
        latest=past[-1][0],
        frame=past[-1][1].frame,
        parameters=tuple(parameter_trend(name, units[name], series) for name, series in points.items()),
        acceptance=None if limits is None else judge_check(past[-1][1], limits, "periodic"),
        comparison=comparison,
        compared=compared,
    )


def parameter_trend(name: str, unit: str, points: Sequence[Point]) -> ParameterTrend:
    """Return the instability from run to run and the drift of a parameter."""
    launches = [np.array([value for value, _ in p.launches]) for p in points if p.launches]
    degrees = sum(len(values) - 1 for values in launches)
    squares = sum(float(np.sum((values - values.mean()) ** 2)) for values in launches)
    instability, drift = _instability_and_drift(points)
    return ParameterTrend(
        name=name,
        unit=unit,
        points=tuple(points),
        run_to_run=math.sqrt(squares / degrees) if degrees else None,
        run_to_run_degrees=degrees,
        instability=instability,
        drift=drift,
    )


def _instability_and_drift(points: Sequence[Point]) -> tuple[float | None, Drift | None]:
    """Return τ and the drift (module docstring), each None if the points do not determine it."""
    if not points or not all(p.u and all(u for _, u in p.launches) for p in points):
        return None, None
    # changes (n, k) of the points by one standard uncertainty of each source that all of them share
    sources = [source for source in points[0].shared if all(source in p.shared for p in points)]
    shared = np.array([[p.shared[source] for source in sources] for p in points]).reshape(len(points), len(sources))
    variance = ((shared - shared.mean(axis=0)) ** 2).sum(axis=1)  # u_i² (n,)
    variance += [unshared_variance(p.u, None, g)[0] for p, g in zip(points, shared, strict=True)]
    without_tau = variance.copy()  # v_i (n,) for τ = 0
    count = np.ones(len(points))  # L_i (n,)
    within, squares = list[float](), list[float]()  # u_il² and (y_il − ȳ_i)² of all launches behind means
    for i, p in enumerate(points):
        if p.launches:
            of_launches = [unshared_variance(u, None, shared[i])[0] for _, u in p.launches]
            values = np.array([value for value, _ in p.launches])
            count[i] = len(values)
            without_tau[i] = sum(of_launches) / len(values) ** 2
            within += of_launches
            squares += ((values - values.mean()) ** 2).tolist()
    if not variance.all() or not all(within):
        return None, None

    # design matrix: a column for the level of each stretch, and one for the years if any stretch has two times
    stretch = np.cumsum([i > 0 and p.state == "as-left" for i, p in enumerate(points)])
    t = np.array([(p.performed - points[0].performed) / YEAR for p in points], dtype=float)
    y = np.array([p.value for p in points])
    X = (stretch[:, None] == np.arange(stretch[-1] + 1)).astype(float)
    has_drift = any(np.ptp(t[stretch == s]) > 0.0 for s in range(X.shape[1]))
    X = np.column_stack([X, t - t.mean()]) if has_drift else X

    def fit_line(tau: float) -> tuple[Array, Array, float]:
        """Return Qᵀy and R of the whitened columns, and the chi-square of the residuals."""
        u = np.sqrt(np.maximum(variance, without_tau + tau**2 / count))
        Q, R = np.linalg.qr(X / u[:, None])
        z = Q.T @ (y / u)
        return z, R, float(np.sum((y / u - Q @ z) ** 2))

    def excess(tau: float) -> float:
        """Return the sum of both chi-squares less its degrees of freedom."""
        return float(fit_line(tau)[2] + np.sum(np.array(squares) / (np.array(within) + tau**2)) - degrees)

    degrees = len(points) - X.shape[1] + int((count - 1.0).sum())
    tau = fit_scatter(excess, float(np.median(np.sqrt(variance)))) if degrees > 0 else None
    if not has_drift:
        return tau, None
    z, R, _ = fit_line(tau or 0.0)
    drift_row = np.linalg.inv(R)[-1]
    u = float(np.linalg.norm(drift_row))
    expanded = float(scipy.special.stdtrit(degrees, COVERED)) * u if degrees > 0 else None
    return tau, Drift(per_year=float(drift_row @ z), u=u, degrees=degrees, expanded=expanded)
