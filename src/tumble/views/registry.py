"""The registry: devices, records, limits, trends, what is due."""

from __future__ import annotations

import math
from collections.abc import Collection, Container, Iterable, Mapping, Sequence

from tumble.lab.conformity import RULE, Verdict
from tumble.lab.registry.adding import logs_of
from tumble.lab.registry.monitor import Monitored
from tumble.lab.registry.trend import Change, Trend
from tumble.lab.registry.types import LimitsRecord, Record
from tumble.result.calibration import Calibration
from tumble.sensors.parameters import beyond_linear, group_name
from tumble.units import two_digits
from tumble.use.compare import Comparison
from tumble.views.blocks import Block, Items, Tone, table
from tumble.views.checks import judged_lines
from tumble.views.numbers import Units, cells, device_name, limit_cell, shown_units, units_of_values, with_expanded
from tumble.views.registry_lists import day_of
from tumble.views.render.data import Content, fields

TONES: Mapping[str, Tone] = {
    "pass": "good",
    "conditional pass": "doubt",
    "conditional fail": "bad",
    "undecided": "bad",
    "fail": "bad",
}
"""The colour of each result of a check."""
_BARS = "▁▂▃▄▅▆▇█"
_LONG = 24  # points of a sparkline


def record_blocks(record: Record, calibration: Calibration, verdict: Verdict | None, *, every: bool) -> list[Block]:
    """A record with its parameters and the verdict on each; of those beyond the linear model that have no limits only
    how many there are, unless `every` one is wanted."""
    device = device_name(record.serial, record.model)
    lines = [
        f"record {record.number} · device {device} · {record.occasion} check · {record.state}",
        f"performed {day_of(record.performed)} · method {record.method} · frame {record.frame}",
        *(f"launch {session or 1} · log {log}" for session, log in logs_of(calibration) if log),
        f"content {record.sha256}",
    ]
    if record.supersedes is not None:
        lines.append(f"supersedes record {record.supersedes}: {record.reason}")
    if record.superseded_by is not None:
        lines.append(f"superseded by record {record.superseded_by}")
    judged = {} if verdict is None else {j.name: j for j in verdict.judgements}
    further = () if every else further_of((p.name for p in calibration.parameters), judged)
    shown = [p for p in calibration.parameters if p.name not in further]
    units, rows = shown_units(shown), []
    for p in shown:
        (size, unit), judgement = units[p.name], judged.get(p.name)
        row = dict(zip(("parameter", "value", "U"), (p.name, *with_expanded(p, size)), strict=True))
        if judged:
            limits = (math.nan, math.nan) if judgement is None else (judgement.low, judgement.high)
            row |= dict(zip(("lowest", "highest"), (limit_cell(limit, size) for limit in limits), strict=True))
        rows.append(row | {"unit": unit} | ({"verdict": judgement.result if judgement else ""} if judged else {}))
    words, columns = ("parameter", "unit", "verdict"), () if rows else ("parameter", "value", "U")
    judgements = ["no verdict: no limits were in force for this type and check when the record was added"]
    if verdict is not None:
        over = f", {verdict.over}" if verdict.over else ""
        judgements = [RULE, *verdict.reasons(), f"verdict: {verdict.result}{over}"]
    parameters = table(rows, words=words, columns=columns, caption=_counted(further))
    return ["\n".join(lines), parameters, Items(items=tuple(judgements))]


def further_of(names: Iterable[str], judged: Container[str]) -> frozenset[str]:
    """The parameters beyond the linear model of which nothing is `judged`."""
    return frozenset(name for name in names if name not in judged and beyond_linear(name))


def _counted(further: Collection[str]) -> str:
    """How many parameters are not shown."""
    groups = len(set(map(group_name, further)))
    where = "1 group" if groups == 1 else f"{groups} groups"
    said = f"and {len(further)} parameters beyond bias, scale and axes, in {where}: --all shows them"
    return said if further else ""


def record_data(record: Record, calibration: Calibration, verdict: Verdict | None) -> Content:
    """A record with its launches, its parameters (of the result: launch 0), and the verdict."""
    launches = enumerate([calibration.parameters, *(launch.parameters for launch in calibration.launches)])
    judged = None
    if verdict is not None:
        of_p = [
            fields(j, "name unit value expanded low high at beyond") | {"verdict": j.result} for j in verdict.judgements
        ]
        judged = {"verdict": verdict.result, **fields(verdict, "occasion frame")}
        judged |= {"reasons": verdict.reasons(), "parameters": of_p}
    return {
        "record": record,
        "launches": [{"session": session, "log_sha256": log} for session, log in logs_of(calibration)],
        "parameters": [{"launch": i} | fields(p, "name value u unit dof") for i, own in launches for p in own],
        "acceptance": judged,
    }


def limits_blocks(limits: LimitsRecord) -> list[Block]:
    """Limits as they were given."""
    named = "" if limits.systematic is None else " · systematic values kept with them"
    head = f"limits {limits.number} · type {limits.model} · in force from {day_of(limits.added)}{named}"
    return [head, Items(items=(limits.file.rstrip(),)), RULE]


# -------------------- trend --------------------


def trend_row(found: Monitored, trend: Trend, unit: tuple[float, str]) -> dict[str, str]:
    """All that one line says of a parameter: history, latest value, limits, run to run, drift, the last change, and the
    verdict on the latest value."""
    (size, name), parameter, points = unit, trend.series.name, trend.series.points
    value, U = with_expanded(points[-1], size)
    low, high = (limit_cell(limit, size) for limit in found.limits.get(parameter, (math.nan, math.nan)))
    row = {"parameter": parameter, "history": sparkline([p.value for p in points]), "latest": value, "U": U}
    row |= {"lowest": low, "highest": high, "run to run": deviation_cell(trend.run_to_run, size)}
    row |= dict(zip(("drift/year", "U (95 %)"), drift_cells(trend, size), strict=True))
    row |= dict(zip(("change", "E_n"), change_cells(trend.last_change, size), strict=True))
    return row | {"unit": name, "verdict": found.latest_verdicts().get(parameter, "")}


def trend_blocks(found: Monitored, *, every: bool) -> list[Block]:
    """Every parameter of a device over its calibrations, a line each, with verdicts on the latest values; of those
    beyond the linear model that have no limits and have not changed only how many there are, unless `every` one is
    wanted."""
    units, without = units_of(found), [] if found.limits else ["lowest", "highest", "verdict"]
    without += [] if any(trend.run_to_run is not None for trend in found.trends) else ["run to run"]
    kept = {*found.limits, *found.changed()}
    further = () if every else further_of((trend.series.name for trend in found.trends), kept)
    shown = [trend for trend in found.trends if trend.series.name not in further]
    rows = [trend_row(found, trend, units[trend.series.name]) for trend in shown]
    rows = [{heading: cell for heading, cell in row.items() if heading not in without} for row in rows]
    numbers = {p.number: p.performed for t in found.trends for p in t.series.points}
    first, last = day_of(min(numbers.values())), day_of(max(numbers.values()))
    one = f"one calibration, of {first}"
    said = one if len(numbers) == 1 else f"{len(numbers)} calibrations from {first} to {last}"
    device = device_name(found.latest.serial, found.latest.model)
    conclusions = (*([] if found.comparison is None else change_lines(found.comparison)), *forecast_lines(found))
    return [
        f"device {device} · {said} · frame {found.frame}",
        table(rows, words=("parameter", "history", "unit", "verdict"), caption=_counted(further)),
        *([Items(items=conclusions)] if conclusions else []),
    ]


def trend_data(found: Monitored) -> Content:
    """The parameters of a device over its calibrations."""
    parameters = [
        fields(trend.series, "name unit")
        | {
            "calibrations": [
                {"record": p.number} | fields(p, "performed state value u dof") for p in trend.series.points
            ]
        }
        | fields(trend, "run_to_run instability drift changes")
        for trend in found.trends
    ]
    return {
        "serial": found.latest.serial,
        "frame": found.frame,
        "limits": dict(found.limits),
        "parameters": parameters,
        "changed": found.changed(),
        "forecasts": found.forecasts(),
    }


def forecast_lines(found: Monitored) -> list[str]:
    """When parameters meet their limits by their drift, in sentences."""
    units, lines = units_of(found), []
    for each in found.forecasts():
        size, unit = units[each.name]
        latest = "more than 50 years on" if each.latest is None else day_of(each.latest)
        lines.append(
            f"forecast: {each.name} meets its limit of {limit_cell(each.limit, size)} {unit} on "
            f"{day_of(each.expected)} (95 %: {day_of(each.earliest)} to {latest})"
        )
    return lines


def units_of(found: Monitored) -> Units:
    """The unit in which each parameter is shown."""
    return units_of_values((t.series.name, p.value, t.series.unit) for t in found.trends for p in t.series.points)


def change_lines(comparison: Comparison) -> list[str]:
    """What has changed since the calibration before, in sentences."""
    first, *others = judged_lines(comparison)
    return [f"the latest against the one before: {first}", *others]


def history_blocks(found: Monitored) -> list[Block]:
    """The one parameter of `found` in every calibration, with verdicts by the limits that are in force."""
    trend, verdicts = found.trends[0], found.verdicts(found.trends[0])
    name, points = trend.series.name, trend.series.points
    limits, (size, unit) = found.limits.get(name), units_of(found)[name]
    changes, rows = {change.later: change for change in trend.changes}, []
    for point in points:
        change = changes.get(point.number)
        value, U = with_expanded(point, size)
        row = {"record": str(point.number), "performed": day_of(point.performed), "state": point.state, "value": value}
        row |= {"U": U, "launches": str(len(point.launches) or 1)}
        row |= dict(zip(("change", "E_n"), change_cells(change, size), strict=True))
        row |= {"unit": unit, "": "adjusted" if change is not None and change.adjustment else ""}
        rows.append(row | ({"verdict": verdicts.get(point.number, "")} if limits else {}))
    lines, drift = [], trend.drift
    if limits is not None:
        lines += [f"limits: {limit_cell(limits[0], size)} to {limit_cell(limits[1], size)} {unit}", RULE]
    if trend.run_to_run is not None:
        lines.append(
            f"run to run: {deviation_cell(trend.run_to_run, size)} {unit}, the standard deviation of launches "
            f"({trend.run_to_run_degrees} degrees of freedom)"
        )
    if trend.instability is not None:
        lines.append(f"instability beyond the stated u, per power-on: {deviation_cell(trend.instability, size)} {unit}")
    if drift is None:
        lines.append(
            "drift: not known; it takes two calibrations at different times without an adjustment between them"
        )
    elif drift.expanded is None:
        value, u = cells(drift.per_year, drift.u, size)
        lines.append(f"drift: {value} {unit} a year, u = {u} of the measurement alone: nothing shows the instability")
    else:
        value, U = cells(drift.per_year, drift.expanded, size)
        lines.append(f"drift: {value} ± {U} {unit} a year (95 %, Student's t with {drift.degrees} degrees of freedom)")
    device, history = device_name(found.latest.serial, found.latest.model), sparkline([p.value for p in points])
    return [
        f"{name} of device {device} · frame {found.frame} · {history}",
        table(rows, words=("record", "performed", "state", "unit", "", "verdict")),
        Items(items=(*lines, *forecast_lines(found))),
    ]


def sparkline(values: Sequence[float]) -> str:
    """Values as bars between the lowest and the highest; the last ones, where there are many."""
    shown = values[-_LONG:]
    low, high = min(shown), max(shown)
    if high == low:
        return _BARS[3] * len(shown)
    return "".join(_BARS[min(int((v - low) / (high - low) * len(_BARS)), len(_BARS) - 1)] for v in shown)


def drift_cells(trend: Trend, size: float) -> tuple[str, str]:
    """The drift a year and its U, where there is one."""
    known = trend.drift is not None and trend.drift.expanded is not None
    return cells(trend.drift.per_year, trend.drift.expanded, size) if known and trend.drift is not None else ("", "")


def change_cells(change: Change | None, size: float) -> tuple[str, str]:
    """A change and its E_n number."""
    if change is None:
        return "", ""
    return cells(change.value, change.expanded, size)[0], "" if change.e_n is None else f"{change.e_n:+z.2f}"


def deviation_cell(value: float | None, size: float) -> str:
    """A standard deviation to two digits."""
    return "" if value is None else two_digits(value / size)
