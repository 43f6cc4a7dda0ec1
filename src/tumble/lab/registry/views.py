"""The registry: devices, records, limits, trends, what is due."""

from __future__ import annotations

import math
from collections.abc import Collection, Container, Iterable, Mapping, Sequence
from datetime import date
from typing import TYPE_CHECKING

from tumble.lab.conformity import RISK, RULE, Result, Verdict, in_percent
from tumble.lab.registry.records import Due, LimitsRecord, Record
from tumble.lab.registry.registry import logs_of
from tumble.result.calibration import Calibration
from tumble.result.parts import Parameter
from tumble.sensors.parameters import beyond_linear, group_name
from tumble.units import two_digits
from tumble.views.blocks import Block, Items, Table, Tone, table
from tumble.views.numbers import (
    Units,
    cells,
    device_name,
    limit_cell,
    quantity_table,
    shown_units,
    units_of_values,
    with_expanded,
)

if TYPE_CHECKING:
    from tumble.lab.registry.trend import Change, ParameterTrend, Point, Trend

TONES: Mapping[Result, Tone] = {
    "pass": "good",
    "conditional pass": "doubt",
    "conditional fail": "bad",
    "undecided": "bad",
    "fail": "bad",
}
"""The colour of each result of a check."""
_BARS = "▁▂▃▄▅▆▇█"
_MOST_BARS = 24

# -------------------- lists --------------------


def day_of(moment: date) -> str:
    """A day by ISO 8601."""
    return f"{moment:%Y-%m-%d}"


def _list(columns: tuple[str, ...], rows: Iterable[tuple[object, ...]]) -> Table:
    """A table of words; what is not known is an empty cell."""
    shown = (tuple("" if cell is None else str(cell) for cell in row) for row in rows)
    return Table(columns=columns, rows=tuple(shown), text=tuple(range(len(columns))))


def device_table(records: Iterable[Record]) -> Table:
    """Every device with its latest record, of records in the order in which they were performed."""
    devices: dict[str, list[Record]] = {}
    for record in records:
        devices.setdefault(record.serial, []).append(record)
    rows = []
    for serial, of_device in sorted(devices.items()):
        r = of_device[-1]
        rows.append((serial, r.model, len(of_device), day_of(r.performed), r.number, r.occasion, r.verdict))
    return _list(("device", "type", "calibrations", "latest", "record", "check", "verdict"), rows)


def record_table(records: Iterable[Record]) -> Table:
    """The records of a device."""
    rows = ((r.number, day_of(r.performed), r.occasion, r.state, r.method, r.frame, r.verdict) for r in records)
    return _list(("record", "performed", "check", "state", "method", "frame", "verdict"), rows)


def limits_table(limits: Iterable[LimitsRecord]) -> Table:
    """The limits of all types."""
    rows = ((r.number, r.model, day_of(r.added), "in force" if r.in_force else "replaced") for r in limits)
    return _list(("limits", "type", "added", ""), rows)


def limits_blocks(limits: LimitsRecord) -> list[Block]:
    """Limits as they were given."""
    named = "" if limits.systematic is None else " · systematic values kept with them"
    head = f"limits {limits.number} · type {limits.model} · in force from {day_of(limits.added)}{named}"
    return [head, Items(items=(limits.file.rstrip(),)), RULE, RISK]


def due_table(items: Iterable[Due]) -> Table:
    """What is due when."""
    rows = []
    for i in items:
        r, every = i.record, None if i.months is None else f"{i.months} months"
        days = None if i.day is None else (i.day - i.on).days
        until = "no interval" if days is None else f"in {days} d" if days >= 0 else f"overdue by {-days} d"
        until += f", by the drift of {i.by_drift.name}" if i.drifts and i.by_drift is not None else ""
        until = f"withdrawn until calibrated again: {r.verdict}" if i.withdrawn else until
        rows.append((r.serial, r.model, day_of(r.performed), r.number, every, i.day, until))
    return _list(("device", "type", "latest", "record", "every", "due", ""), rows)


# -------------------- a record --------------------


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
    judged = {} if verdict is None else {j.name: j for j in verdict.judgements}
    further = () if every else further_of((p.name for p in calibration.parameters), judged)
    shown = [p for p in calibration.parameters if p.name not in further]

    def row(p: Parameter, size: float, unit: str) -> dict[str, str]:
        value, U = with_expanded(p, size)
        judgement, cells = judged.get(p.name), {"value": value, "U": U}
        if judged:
            low, high = (math.nan, math.nan) if judgement is None else (judgement.low, judgement.high)
            cells |= {"lowest": limit_cell(low, size), "highest": limit_cell(high, size)}
            cells["risk"] = in_percent(None if judgement is None else judgement.risk)
        return cells | {"unit": unit} | ({"verdict": judgement.result if judgement else ""} if judged else {})

    parameters = quantity_table(shown, shown_units(shown), row, words=("verdict",), caption=_counted(further))
    sentences = ["no verdict: no limits were in force for this type and check when the record was added"]
    if verdict is not None:
        over = f", {verdict.over}" if verdict.over else ""
        sentences = [RULE, f"{RISK}.{verdict.whole_risk}", *verdict.reasons, f"verdict: {verdict.result}{over}"]
    return ["\n".join(lines), parameters, Items(items=tuple(sentences))]


def further_of(names: Iterable[str], judged: Container[str]) -> frozenset[str]:
    """The parameters beyond the linear model of which nothing is `judged`."""
    return frozenset(name for name in names if name not in judged and beyond_linear(name))


def _counted(further: Collection[str]) -> str:
    """How many parameters are not shown."""
    groups = len(set(map(group_name, further)))
    where = "1 group" if groups == 1 else f"{groups} groups"
    sentence = f"and {len(further)} parameters beyond bias, scale and axes, in {where}: --all shows them"
    return sentence if further else ""


# -------------------- a trend --------------------


def trend_table(device: Trend, shown: Sequence[ParameterTrend], caption: str = "") -> Table:
    """Parameters of a device over its calibrations, a line each: history, latest value, limits, run to run, drift, the
    last change, and the verdict on the latest value."""
    limited, launched = bool(device.limits), any(each.run_to_run is not None for each in device.parameters)

    def row(trend: ParameterTrend, size: float, unit: str) -> dict[str, str]:
        value, U = with_expanded(trend.points[-1], size)
        low, high = (limit_cell(limit, size) for limit in device.limits.get(trend.name, (math.nan, math.nan)))
        known = trend.drift is not None and trend.drift.expanded is not None
        drift, drift_u = cells(trend.drift.per_year, trend.drift.expanded, size) if trend.drift and known else ("", "")
        change, e_n = _change_cells(trend.last_change, size)
        return {
            "history": sparkline([p.value for p in trend.points]),
            "latest": value,
            "U": U,
            **({"lowest": low, "highest": high} if limited else {}),
            **({"run to run": deviation_cell(trend.run_to_run, size)} if launched else {}),
            "drift/year": drift,
            "U (95 %)": drift_u,
            "change": change,
            "E_n": e_n,
            "unit": unit,
            **({"verdict": device.latest_verdicts.get(trend.name, "")} if limited else {}),
        }

    return quantity_table(shown, units_of(device), row, words=("history", "verdict"), caption=caption)


def trend_blocks(found: Trend, *, every: bool) -> list[Block]:
    """Every parameter of a device over its calibrations, with verdicts on the latest values; of those beyond the linear
    model that have no limits and have not changed only how many there are, unless `every` one is wanted."""
    kept = {*found.limits, *found.changed}
    further = () if every else further_of((trend.name for trend in found.parameters), kept)
    shown = [trend for trend in found.parameters if trend.name not in further]
    conclusions = (*change_lines(found), *forecast_lines(found))
    device = device_name(found.latest.serial, found.latest.model)
    days = {p.number: day_of(p.performed) for trend in found.parameters for p in trend.points}
    first, last = min(days.values()), max(days.values())
    since = f"one calibration, of {first}" if len(days) == 1 else f"{len(days)} calibrations from {first} to {last}"
    return [
        f"device {device} · {since} · frame {found.frame}",
        trend_table(found, shown, _counted(further)),
        *([Items(items=conclusions)] if conclusions else []),
    ]


def forecast_lines(device: Trend) -> list[str]:
    """When parameters meet their limits by their drift, in sentences."""
    units, lines = units_of(device), []
    for each in device.forecasts:
        size, unit = units[each.name]
        latest = "more than 50 years on" if each.latest is None else day_of(each.latest)
        lines.append(
            f"forecast: {each.name} meets its limit of {limit_cell(each.limit, size)} {unit} on "
            f"{day_of(each.expected)} (95 %: {day_of(each.earliest)} to {latest})"
        )
    return lines


def units_of(device: Trend) -> Units:
    """The unit in which each parameter is shown."""
    return units_of_values((t.name, p.value, t.unit) for t in device.parameters for p in t.points)


def change_lines(device: Trend) -> list[str]:
    """What has changed since the calibration before, in sentences."""
    from tumble.views.checks import judged_lines

    if device.comparison is None:
        return []
    first, *others = judged_lines(device.comparison)
    return [f"the latest against the one before: {first}", *others]


def history_blocks(found: Trend) -> list[Block]:
    """The one parameter of `found` in every calibration, with verdicts by the limits that are in force."""
    (trend,), drift = found.parameters, found.parameters[0].drift
    limits, (size, unit), verdicts = found.limits.get(trend.name), units_of(found)[trend.name], found.verdicts(trend)
    changes = {change.later: change for change in trend.changes}

    def row(point: Point) -> dict[str, str]:
        change, (value, U) = changes.get(point.number), with_expanded(point, size)
        difference, e_n = _change_cells(change, size)
        return {
            "record": str(point.number),
            "performed": day_of(point.performed),
            "state": point.state,
            "value": value,
            "U": U,
            "launches": str(len(point.launches) or 1),
            "change": difference,
            "E_n": e_n,
            "unit": unit,
            "": "adjusted" if change is not None and change.adjustment else "",
            **({"verdict": verdicts.get(point.number, "")} if limits else {}),
        }

    lines = []
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
    device, history = device_name(found.latest.serial, found.latest.model), sparkline([p.value for p in trend.points])
    return [
        f"{trend.name} of device {device} · frame {found.frame} · {history}",
        table(map(row, trend.points), words=("record", "performed", "state", "unit", "", "verdict")),
        Items(items=(*lines, *forecast_lines(found))),
    ]


def sparkline(values: Sequence[float]) -> str:
    """Values as bars between the lowest and the highest; the last ones, where there are many."""
    shown = values[-_MOST_BARS:]
    low, high = min(shown), max(shown)
    if high == low:
        return _BARS[3] * len(shown)
    return "".join(_BARS[min(int((v - low) / (high - low) * len(_BARS)), len(_BARS) - 1)] for v in shown)


def _change_cells(change: Change | None, size: float) -> tuple[str, str]:
    """A change and its E_n number."""
    if change is None:
        return "", ""
    return cells(change.value, change.expanded, size)[0], "" if change.e_n is None else f"{change.e_n:+z.2f}"


def deviation_cell(value: float | None, size: float) -> str:
    """A standard deviation to two digits."""
    return "" if value is None else two_digits(value / size)
