"""The parameters of a device over time against the limits of the periodic check that are in force now.

The verdict on a record is by the limits that were in force when it was added (`series.verdict_of`); here the whole
history is seen against the present ones.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from typing import Any

from tumble.errors import InputError
from tumble.lab.conformity import judge_value
from tumble.lab.limits import Limits, parse_limits
from tumble.lab.registry.series import Past, Series, latest_comparison, past_of, series_of
from tumble.lab.registry.store import rows
from tumble.lab.registry.store.connect import Registry
from tumble.lab.registry.trend import Trend, forecast, trend_of
from tumble.lab.registry.types import Forecast, LimitsRecord, Record
from tumble.use.compare import Comparison


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
        met = [forecast(t, self.limits[t.series.name]) for t in self.trends if t.series.name in passing]
        return sorted((each for each in met if each is not None), key=lambda each: each.earliest)

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
    with registry.reading() as connection:
        latest = next(iter(rows.latest_records(connection, [serial])), None)
        model = None if latest is None else latest.record.model
        given = None if model is None else rows.limits_in_force(connection).get(model)
    limits = None if given is None else parse_limits(given.file, given.systematic, given.name)
    past = past_of(registry, serial, None if limits is None else limits.frame)
    series = series_of(past)
    chosen = [each for each in series if parameter in (None, each.name)]
    if not chosen:
        known = ", ".join(each.name for each in series)
        raise InputError(f"device {serial!r}: expected one of {known}, found {parameter!r}")
    by_calendar = None if limits is None else limits.due(serial, past[-1][0].performed.date())
    return _of_past(past, chosen, limits, comparison=latest_comparison(past), by_calendar=by_calendar)


def first_forecast(registry: Registry, serial: str, given: LimitsRecord) -> Forecast | None:
    """The parameter of a device that may meet these limits first; None without one, and for a device of which a record
    cannot be taken to the frame of the limits."""
    limits = parse_limits(given.file, given.systematic, given.name)
    try:
        past = past_of(registry, serial, limits.frame)
    except InputError:
        return None
    series = [each for each in series_of(past) if limits.of(each.name, "periodic") is not None]
    return next(iter(_of_past(past, series, limits).forecasts()), None)


def _of_past(past: Past, series: Sequence[Series], limits: Limits | None, **others: Any) -> Monitored:
    """Series of a device against limits; `others` are the other fields."""
    between = {} if limits is None else {each.name: limits.of(each.name, "periodic") for each in series}
    record, calibration = past[-1]
    return Monitored(
        latest=record,
        frame=calibration.frame,
        trends=[trend_of(each) for each in series],
        limits={name: ends for name, ends in between.items() if ends is not None},
        **others,
    )
