"""The parameters of a device over time against the limits of the periodic check that are in force now.

The verdict on a record is by the limits that were in force when it was added (`series.verdict_of`); here the whole
history is seen against the present ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date

from tumble.acceptance.conformity import judge_value
from tumble.acceptance.limits import Limits, parse_limits
from tumble.calibration.compare import Comparison
from tumble.errors import InputError
from tumble.registry.connect import Registry
from tumble.registry.forecast import Forecast, forecast
from tumble.registry.records import Record
from tumble.registry.series import latest_comparison, series_of
from tumble.registry.store import latest_record, limits_in_force
from tumble.registry.trend import Trend, trend_of


@dataclass(frozen=True, kw_only=True, slots=True)
class Monitored:
    """The latest record of a device, its trends in a `frame`, and the limits (SI) that are in force, by name;
    `comparison` is that of all parameters in the latest calibration with the one before (`latest_comparison`)."""

    latest: Record
    frame: str
    trends: Sequence[Trend]
    limits: Mapping[str, tuple[float, float]]
    comparison: Comparison | None = None
    by_calendar: date | None = None
    """The day the next calibration is due by the interval of the type."""

    def latest_verdicts(self) -> Mapping[str, str]:
        """The verdict on the latest value of every parameter that has limits."""
        return {t.series.name: self._verdict(t, -1) for t in self.trends if t.series.name in self.limits}

    def verdicts(self, trend: Trend | None = None) -> Mapping[int, str]:
        """The verdicts on a parameter, the first where none is named, in every record, by number; none without
        limits."""
        trend = self.trends[0] if trend is None else trend
        if trend.series.name not in self.limits:
            return {}
        return {point.number: self._verdict(trend, i) for i, point in enumerate(trend.series.points)}

    def forecasts(self) -> list[Forecast]:
        """When parameters that are inside their limits meet them by their drift, the earliest first."""
        passing = {name for name, verdict in self.latest_verdicts().items() if verdict == "pass"}
        found = [forecast(t, self.limits[t.series.name]) for t in self.trends if t.series.name in passing]
        return sorted((each for each in found if each is not None), key=lambda each: each.earliest)

    def changed(self) -> list[str]:
        """The parameters that have changed by more than chance makes since the calibration before, or where none does
        by itself, that they have together."""
        if self.comparison is None:
            return []
        shown = {trend.series.name for trend in self.trends}
        together = len(shown) > 1 and self.comparison.contradicts
        return [name for name in self.comparison.changed if name in shown] or ["all parameters together"] * together

    def drifting(self) -> list[Trend]:
        """The parameters whose drift is beyond its U."""
        return [trend for trend in self.trends if trend.drift is not None and trend.drift.beyond_u]

    def _verdict(self, trend: Trend, i: int) -> str:
        point = trend.series.points[i]
        return judge_value(point.value, point.u, *self.limits[trend.series.name], point.dof)


def monitored(registry: Registry, serial: str, parameter: str | None) -> Monitored:
    """The trends of a device, or of one of its parameters.

    The frame is that of the limits, or without limits that of the latest record. Raises InputError for an unknown
    device or parameter, and for a record in another frame that cannot be taken to this one.

    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> tumble.calibrate(folder).write("calibration.json")
    >>> with tumble.open_registry("registry.sqlite", create=True) as registry:
    ...     _ = tumble.add_calibration(registry, "calibration.json")
    ...     found = tumble.monitored(registry, "mems-1", "accel.bias.x")
    >>> [trend.series.name for trend in found.trends]
    ['accel.bias.x']
    """
    latest = latest_record(registry, serial)
    limits = _in_force(registry, latest)
    frame = latest.frame if limits is None else limits.frame
    series = series_of(registry, serial, frame)
    chosen = [own for own in series if parameter in (None, own.name)]
    if not chosen:
        known = ", ".join(own.name for own in series)
        raise InputError(f"device {serial!r}: expected one of {known}, found {parameter!r}")
    known_limits = {} if limits is None else {own.name: limits.of(own.name, "periodic") for own in chosen}
    return Monitored(
        latest=latest,
        frame=frame,
        trends=[trend_of(own) for own in chosen],
        limits={name: own for name, own in known_limits.items() if own is not None},
        comparison=latest_comparison(registry, serial, frame),
        by_calendar=None if limits is None else limits.schedule.due(serial, latest.performed.date()),
    )


def _in_force(registry: Registry, latest: Record) -> Limits | None:
    own = None if latest.model is None else limits_in_force(registry).get(latest.model)
    return None if own is None else parse_limits(own.file, own.systematic, f"limits {own.number}")
