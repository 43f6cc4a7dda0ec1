"""The registry on a terminal: devices, records, limits, trends, what is due."""

from __future__ import annotations

import math
from collections.abc import Collection, Container, Iterable, Mapping, Sequence
from datetime import date

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from tumble.acceptance.conformity import RULE, LimitJudgement, Verdict
from tumble.calibration.calibration_file import Calibration
from tumble.calibration.compare import Comparison
from tumble.calibration.coverage import expanded_of as expanded_uncertainty
from tumble.calibration.results import Parameter
from tumble.calibration.shown import shown_units
from tumble.registry.monitor import Monitored
from tumble.registry.series import SeriesPoint
from tumble.registry.submission import logs_of
from tumble.registry.trend import Change, Trend
from tumble.registry.types import Forecast, LimitsRecord, Record
from tumble.sensors.parameters import beyond_linear, group_name
from tumble.terminal.comparison import judged_lines
from tumble.terminal.table import plain_table
from tumble.units import rounded, two_digits

_BARS = "▁▂▃▄▅▆▇█"
_LONG = 24  # points of a sparkline


def record_report(record: Record, calibration: Calibration, verdict: Verdict | None, *, every: bool) -> RenderableType:
    """A record with its parameters and the verdict on each; of those beyond the linear model that have no limits only
    how many there are, unless `every` one is wanted."""
    lines = [
        f"record {record.number} · device {_device(record)} · {record.occasion} check · {record.state}",
        f"performed {_day(record.performed)} · method {record.method} · frame {record.frame}",
        *(f"launch {session or 1} · log {log}" for session, log in logs_of(calibration) if log),
        f"content {record.sha256}",
    ]
    if record.supersedes is not None:
        lines.append(f"supersedes record {record.supersedes}: {record.reason}")
    if record.superseded_by is not None:
        lines.append(f"superseded by record {record.superseded_by}")
    judged = {} if verdict is None else {j.name: j for j in verdict.judgements}
    further = () if every else further_of((p.name for p in calibration.parameters), judged)
    shown = _verdict_table([p for p in calibration.parameters if p.name not in further], judged)
    return Group(Text("\n".join(lines)), Text(""), shown, *_counted(further), Text(""), Text(_verdict_line(verdict)))


def further_of(names: Iterable[str], judged: Container[str]) -> frozenset[str]:
    """The parameters beyond the linear model of which nothing is `judged`."""
    return frozenset(name for name in names if name not in judged and beyond_linear(name))


def _counted(further: Collection[str]) -> list[Text]:
    """A line for parameters that are not shown."""
    groups = len(set(map(group_name, further)))
    where = "1 group" if groups == 1 else f"{groups} groups"
    said = f"and {len(further)} parameters beyond bias, scale and axes, in {where}: --all shows them"
    return [Text(said)] if further else []


def _verdict_table(rows: Sequence[Parameter], judged: Mapping[str, LimitJudgement]) -> Table:
    table = _table("parameter")
    for heading in ("value", "U", *(("lowest", "highest") if judged else ())):
        table.add_column(heading, justify="right", no_wrap=True)
    for heading in ("unit", *(("verdict",) if judged else ())):
        table.add_column(heading)
    units = _units((row.name, row.unit, row.value) for row in rows)
    for row in rows:
        size, unit = units[row.name]
        own = judged.get(row.name)
        table.add_row(
            Text(row.name),
            *with_expanded(row.value, expanded_of(row), size),
            *_limits_cells(own, size, bool(judged)),
            unit,
            *([own.result if own else ""] if judged else []),
        )
    return table


def _limits_cells(judgement: LimitJudgement | None, size: float, shown: bool) -> list[str]:
    if not shown:
        return []
    return ["", ""] if judgement is None else [limit_cell(judgement.low, size), limit_cell(judgement.high, size)]


def _verdict_line(verdict: Verdict | None) -> str:
    if verdict is None:
        return "no verdict: no limits were in force for this type and check when the record was added"
    over = f", {verdict.over}" if verdict.over else ""
    return "\n".join([RULE, *verdict.reasons(), f"verdict: {verdict.result}{over}"])


def limits_report(limits: LimitsRecord) -> RenderableType:
    """Limits as they were given."""
    named = "" if limits.systematic is None else " · systematic values kept with them"
    return Group(
        Text(f"limits {limits.number} · type {limits.model} · in force from {_day(limits.added)}{named}"),
        Text(""),
        Text(limits.file.rstrip()),
        Text(""),
        Text(RULE),
    )


def limits_table(found: Iterable[LimitsRecord], in_force: Mapping[str, LimitsRecord]) -> Table:
    """The limits of all types."""
    table = _table("limits", "type", "added", "")
    for own in found:
        said = "in force" if in_force[own.model] == own else "replaced"
        table.add_row(str(own.number), Text(own.model), _day(own.added), said)
    return table


# -------------------- trend --------------------


def trend_report(found: Monitored, *, every: bool) -> RenderableType:
    """Every parameter of a device over its calibrations, a line each, with verdicts on the latest values; of those
    beyond the linear model that have no limits and have not changed only how many there are, unless `every` one is
    wanted."""
    trends, limits, verdicts = found.trends, found.limits, found.latest_verdicts()
    launches = any(trend.run_to_run is not None for trend in trends)
    table = _table("parameter", "history")
    headings = ["latest", "U", *(["lowest", "highest"] if limits else []), *(["run to run"] if launches else [])]
    for heading in (*headings, "drift/year", "U (95 %)", "change", "E_n"):
        table.add_column(heading, justify="right", no_wrap=True)
    for heading in ("unit", *(["verdict"] if limits else [])):
        table.add_column(heading)
    units = units_of(found)
    kept = {*limits, *found.changed()}
    further = () if every else further_of((trend.series.name for trend in trends), kept)
    for trend in trends:
        name = trend.series.name
        if name in further:
            continue
        size, unit = units[name]
        table.add_row(
            Text(name),
            sparkline([p.value for p in trend.series.points]),
            *with_expanded(trend.series.points[-1].value, expanded_of(trend.series.points[-1]), size),
            *(limit_cell(v, size) for v in (limits.get(name, (math.nan, math.nan)) if limits else ())),
            *([significant(trend.run_to_run, size)] if launches else []),
            *drift_cells(trend, size),
            *change_cells(trend.last_change, size),
            unit,
            *([verdicts.get(name, "")] if limits else []),
        )
    forecasts = [Text(line) for line in forecast_lines(found)]
    return Group(Text(_trend_line(found)), Text(""), table, *_counted(further), *_together(found), *forecasts)


def forecast_lines(found: Monitored) -> list[str]:
    """When parameters meet their limits by their drift, in sentences."""
    units = units_of(found)
    return [_forecast_line(each, *units[each.name]) for each in found.forecasts()]


def units_of(found: Monitored) -> Mapping[str, tuple[float, str]]:
    """Size and name of the unit in which each parameter is shown."""
    return _units((t.series.name, t.series.unit, p.value) for t in found.trends for p in t.series.points)


def _forecast_line(each: Forecast, size: float, unit: str) -> str:
    latest = "more than 50 years on" if each.latest is None else _day(each.latest)
    return (
        f"forecast: {each.name} meets its limit of {limit_cell(each.limit, size)} {unit} on {_day(each.expected)} "
        f"(95 %: {_day(each.earliest)} to {latest})"
    )


def _together(found: Monitored) -> list[RenderableType]:
    """What all parameters together say of a change."""
    return [] if found.comparison is None else [Text(""), *map(Text, change_lines(found.comparison))]


def change_lines(comparison: Comparison) -> list[str]:
    """What has changed since the calibration before, in sentences."""
    first, *others = judged_lines(comparison)
    return [f"the latest against the one before: {first}", *others]


def history_report(found: Monitored) -> RenderableType:
    """The one parameter of `found` in every calibration, with verdicts by the limits that are in force."""
    trend, verdicts = found.trends[0], found.verdicts(found.trends[0])
    name, points = trend.series.name, trend.series.points
    limits = found.limits.get(name)
    size, unit = _units((name, trend.series.unit, p.value) for p in points)[name]
    table = _table("record", "performed", "state")
    for heading in ("value", "U", "launches", "change", "E_n"):
        table.add_column(heading, justify="right", no_wrap=True)
    for heading in ("unit", "", *(["verdict"] if limits else [])):
        table.add_column(heading)
    changes = {change.later: change for change in trend.changes}
    for point in points:
        change = changes.get(point.number)
        table.add_row(
            str(point.number),
            _day(point.performed),
            point.state,
            *with_expanded(point.value, expanded_of(point), size),
            str(len(point.launches) or 1),
            *change_cells(change, size),
            unit,
            "adjusted" if change is not None and change.adjustment else "",
            *([verdicts.get(point.number, "")] if limits else []),
        )
    history = sparkline([p.value for p in points])
    said = f"{name} of device {_device(found.latest)} · frame {found.frame} · {history}"
    lines = [*_conclusions(trend, limits, size, unit), *forecast_lines(found)]
    return Group(Text(said), Text(""), table, Text(""), Text("\n".join(lines)))


def _conclusions(trend: Trend, limits: tuple[float, float] | None, size: float, unit: str) -> list[str]:
    lines = []
    if limits is not None:
        lines += [f"limits: {limit_cell(limits[0], size)} to {limit_cell(limits[1], size)} {unit}", RULE]
    if trend.run_to_run is not None:
        lines.append(
            f"run to run: {significant(trend.run_to_run, size)} {unit}, the standard deviation of launches "
            f"({trend.run_to_run_degrees} degrees of freedom)"
        )
    if trend.instability is not None:
        lines.append(f"instability beyond the stated u, per power-on: {significant(trend.instability, size)} {unit}")
    drift = trend.drift
    if drift is None:
        lines.append(
            "drift: not known; it takes two calibrations at different times without an adjustment between them"
        )
    elif drift.expanded is None:
        value, u = rounded(drift.per_year / size, drift.u / size)
        lines.append(f"drift: {value} {unit} a year, u = {u} of the measurement alone: nothing shows the instability")
    else:
        value, expanded = rounded(drift.per_year / size, drift.expanded / size)
        lines.append(
            f"drift: {value} ± {expanded} {unit} a year (95 %, Student's t with {drift.degrees} degrees of freedom)"
        )
    return lines


def sparkline(values: Sequence[float]) -> str:
    """Values as bars between the lowest and the highest; the last ones, where there are many."""
    shown = values[-_LONG:]
    low, high = min(shown), max(shown)
    if high == low:
        return _BARS[3] * len(shown)
    return "".join(_BARS[min(int((v - low) / (high - low) * len(_BARS)), len(_BARS) - 1)] for v in shown)


def _trend_line(found: Monitored) -> str:
    numbers = {p.number: p.performed for t in found.trends for p in t.series.points}
    first, last = _day(min(numbers.values())), _day(max(numbers.values()))
    one = f"one calibration, of {first}"
    said = one if len(numbers) == 1 else f"{len(numbers)} calibrations from {first} to {last}"
    return f"device {_device(found.latest)} · {said} · frame {found.frame}"


def drift_cells(trend: Trend, size: float) -> list[str]:
    """The drift a year and its U, where there is one."""
    if trend.drift is None:
        return ["", ""]
    expanded = trend.drift.expanded
    return with_expanded(trend.drift.per_year, expanded, size) if expanded is not None else ["", ""]


def change_cells(change: Change | None, size: float) -> list[str]:
    """A change and its E_n number."""
    if change is None:
        return ["", ""]
    value = with_expanded(change.value, change.expanded, size)[0]
    return [value, "" if change.e_n is None else f"{change.e_n:+z.2f}"]


# -------------------- cells --------------------


def _table(*headings: str) -> Table:
    table = plain_table()
    for heading in headings:
        table.add_column(heading, no_wrap=True)
    return table


def _device(record: Record) -> str:
    return record.serial if record.model is None else f"{record.serial} ({record.model})"


def _day(moment: date) -> str:
    return f"{moment:%Y-%m-%d}"


def _units(values: Iterable[tuple[str, str, float]]) -> Mapping[str, tuple[float, str]]:
    """The units in which parameters are shown, by name; from names, SI units and values."""
    return shown_units([Parameter(name=name, value=value, u=None, unit=unit) for name, unit, value in values])


def expanded_of(result: SeriesPoint | Parameter) -> float | None:
    """U, SI."""
    return None if result.u is None else expanded_uncertainty(result.u, result.dof)


def with_expanded(value: float, expanded: float | None, size: float) -> list[str]:
    """A value to the digits of its U, and U."""
    if expanded is None:
        return [f"{value / size:.6g}", ""]
    return list(rounded(value / size, expanded / size))


def limit_cell(value: float, size: float) -> str:
    """A limit, where there is one."""
    return f"{value / size:.6g}" if math.isfinite(value) else ""


def significant(value: float | None, size: float) -> str:
    """A standard deviation to two digits."""
    return "" if value is None else two_digits(value / size)
