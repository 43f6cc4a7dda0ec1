"""The registry as it is shown: devices, records, limits, trends, what is due."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from datetime import date
from math import nan
from typing import TYPE_CHECKING

from tumble.lab.conformity import RISK, RULE, Verdict, in_percent
from tumble.lab.registry.records import Due, LimitsRecord, Record
from tumble.lab.registry.registry import logs_of
from tumble.result.calibration import Calibration
from tumble.result.parts import Parameter
from tumble.sensors.parameters import beyond_linear, group_name
from tumble.units import two_digits
from tumble.views.blocks import Block, Items, Table, table
from tumble.views.checks import judged_lines
from tumble.views.numbers import (
    Q,
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


def device_table(records: Sequence[Record]) -> Table:
    """Every device with its latest record, of records in the order in which they were performed."""
    serials = [r.serial for r in records]
    latest = {r.serial: r for r in records}
    rows = (
        (serial, r.model, serials.count(serial), day_of(r.performed), r.number, r.occasion, r.verdict)
        for serial, r in sorted(latest.items())
    )
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
    head = f"limits {limits.number} · type {limits.model} · in force from {day_of(limits.added)}"
    return [head, Items(items=(limits.file.rstrip(),)), RULE, RISK]


def due_table(items: Iterable[Due]) -> Table:
    """What is due when."""
    rows = []
    for i in items:
        r, days = i.record, None if i.day is None else (i.day - i.on).days
        until = "no interval" if days is None else f"in {days} d" if days >= 0 else f"overdue by {-days} d"
        until = f"withdrawn until calibrated again: {r.verdict}" if i.withdrawn else until
        every = None if i.months is None else f"{i.months} months"
        rows.append((r.serial, r.model, day_of(r.performed), r.number, every, i.day, until))
    return _list(("device", "type", "latest", "record", "every", "due", ""), rows)


# -------------------- a record --------------------


def record_blocks(record: Record, calibration: Calibration, verdict: Verdict | None, *, every: bool) -> list[Block]:
    """A record with its parameters and the verdict on each; of those beyond the linear model that have no limits only
    how many there are, unless `every` one is wanted."""
    lines = [
        f"record {record.number} · device {device_name(record.serial, record.model)} · {record.occasion} check · "
        f"{record.state}",
        f"performed {day_of(record.performed)} · method {record.method} · frame {record.frame}",
        *(f"launch {session or 1} · log {log}" for session, log in logs_of(calibration) if log),
        f"content {record.sha256}",
    ]
    judged = {} if verdict is None else {j.name: j for j in verdict.judgements}
    shown, caption = _of_interest(calibration.parameters, judged, every=every)

    def row(p: Parameter, size: float, unit: str) -> dict[str, str]:
        value, U = with_expanded(p, size)
        if not judged:
            return {"value": value, "U": U, "unit": unit}
        j = judged.get(p.name)
        low, high, risk, result = (nan, nan, None, "") if j is None else (j.low, j.high, j.risk, j.result)
        limits = {"lowest": limit_cell(low, size), "highest": limit_cell(high, size), "risk": in_percent(risk)}
        return {"value": value, "U": U, **limits, "unit": unit, "verdict": result}

    sentences = ["no verdict: no limits were in force for this type and check when the record was added"]
    if verdict is not None:
        sentences = [RULE, f"{RISK}.{verdict.whole_risk}", *verdict.reasons, f"verdict: {verdict.result}"]
    parameters = quantity_table(shown, shown_units(shown), row, words=("verdict",), caption=caption)
    return ["\n".join(lines), parameters, Items(items=tuple(sentences))]


def _of_interest(parameters: Sequence[Q], kept: Collection[str], *, every: bool) -> tuple[list[Q], str]:
    """The parameters of the linear model and those that are `kept`, and how many others there are in words; or `every`
    one."""
    shown = [p for p in parameters if every or p.name in kept or not beyond_linear(p.name)]
    groups = len({group_name(p.name) for p in parameters if p not in shown})
    where, further = "1 group" if groups == 1 else f"{groups} groups", len(parameters) - len(shown)
    sentence = f"and {further} parameters beyond bias, scale and axes, in {where}: --all shows them"
    return shown, sentence if further else ""


# -------------------- a trend --------------------


def trend_blocks(trend: Trend, *, every: bool) -> list[Block]:
    """Every parameter of a device over its calibrations: history, latest value, limits, run to run, drift, the last
    change, and the verdict on the latest value; of those beyond the linear model that have no limits and have not
    changed only how many there are, unless `every` one is wanted."""
    shown, caption = _of_interest(trend.parameters, {*trend.limits, *trend.changed}, every=every)
    launched = any(each.run_to_run is not None for each in trend.parameters)

    def row(parameter: ParameterTrend, size: float, unit: str) -> dict[str, str]:
        latest, drift = parameter.points[-1], parameter.drift
        value, U = with_expanded(latest, size)
        row = {"history": sparkline([p.value for p in parameter.points]), "latest": value, "U": U}
        if trend.limits:
            low, high = trend.limits.get(parameter.name, (nan, nan))
            row |= {"lowest": limit_cell(low, size), "highest": limit_cell(high, size)}
        if launched:
            row["run to run"] = _deviation(parameter.run_to_run, size)
        per_year, U = ("", "")
        if drift is not None and drift.expanded is not None:
            per_year, U = cells(drift.per_year, drift.expanded, size)
        row |= {"drift/year": per_year, "U (95 %)": U, **_change_cells(parameter.last_change, size), "unit": unit}
        return row | ({"verdict": trend.verdicts(parameter).get(latest.number, "")} if trend.limits else {})

    days = {p.number: day_of(p.performed) for parameter in trend.parameters for p in parameter.points}
    first, last = min(days.values()), max(days.values())
    since = f"one calibration, of {first}" if len(days) == 1 else f"{len(days)} calibrations from {first} to {last}"
    return [
        f"device {device_name(trend.serial, trend.latest.model)} · {since} · frame {trend.frame}",
        quantity_table(shown, _units(trend), row, words=("history", "verdict"), caption=caption),
        *([Items(items=tuple(change_lines(trend)))] if trend.comparison is not None else []),
    ]


def change_lines(trend: Trend) -> list[str]:
    """What has changed since the calibration before, in sentences."""
    lines = [] if trend.comparison is None else judged_lines(trend.comparison)
    return [f"the latest against the one before: {line}" if i == 0 else line for i, line in enumerate(lines)]


def history_blocks(trend: Trend) -> list[Block]:
    """The one parameter of a trend in every calibration, with verdicts by the limits that are in force."""
    (parameter,) = trend.parameters
    (size, unit), verdicts, drift = _units(trend)[parameter.name], trend.verdicts(parameter), parameter.drift
    changes = {change.later: change for change in parameter.changes}

    def row(point: Point) -> dict[str, str]:
        change, (value, U) = changes.get(point.number), with_expanded(point, size)
        row = {"record": str(point.number), "performed": day_of(point.performed), "state": point.state}
        row |= {"value": value, "U": U, "launches": str(len(point.launches) or 1), **_change_cells(change, size)}
        row |= {"unit": unit, "": "adjusted" if change is not None and change.adjustment else ""}
        return row | ({"verdict": verdicts[point.number]} if verdicts else {})

    lines = []
    if verdicts:
        low, high = (limit_cell(limit, size) for limit in trend.limits[parameter.name])
        lines += [f"limits: {low} to {high} {unit}", RULE]
    if parameter.run_to_run is not None:
        lines.append(
            f"run to run: {_deviation(parameter.run_to_run, size)} {unit}, the standard deviation of launches "
            f"({parameter.run_to_run_degrees} degrees of freedom)"
        )
    if parameter.instability is not None:
        deviation = _deviation(parameter.instability, size)
        lines.append(f"instability beyond the stated u, per power-on: {deviation} {unit}")
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
    device, history = device_name(trend.serial, trend.latest.model), sparkline([p.value for p in parameter.points])
    return [
        f"{parameter.name} of device {device} · frame {trend.frame} · {history}",
        table(map(row, parameter.points), words=("record", "performed", "state", "unit", "", "verdict")),
        Items(items=tuple(lines)),
    ]


def _units(trend: Trend) -> Units:
    """The unit in which each parameter is shown."""
    return units_of_values((t.name, p.value, t.unit) for t in trend.parameters for p in t.points)


def sparkline(values: Sequence[float]) -> str:
    """Values as bars between the lowest and the highest; the last ones, where there are many."""
    shown = values[-_MOST_BARS:]
    low, high = min(shown), max(shown)
    if high == low:
        return _BARS[3] * len(shown)
    return "".join(_BARS[min(int((v - low) / (high - low) * len(_BARS)), len(_BARS) - 1)] for v in shown)


def _change_cells(change: Change | None, size: float) -> dict[str, str]:
    """A change and its E_n number."""
    if change is None:
        return {"change": "", "E_n": ""}
    e_n = "" if change.e_n is None else f"{change.e_n:+z.2f}"
    return {"change": cells(change.value, change.expanded, size)[0], "E_n": e_n}


def _deviation(value: float | None, size: float) -> str:
    """A standard deviation to two digits."""
    return "" if value is None else two_digits(value / size)
