"""Tables of a registry: devices, records, limits, trends, due dates."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from datetime import date
from math import nan
from typing import TYPE_CHECKING

from tumble.lab.conformity import DECISION_RULE, RISK_DEFINITION, LimitJudgement, Verdict, risk_text
from tumble.lab.registry.records import Due, LimitsRecord, Record
from tumble.lab.registry.registry import logs_of
from tumble.result.calibration import Calibration
from tumble.result.parts import Parameter
from tumble.sensors.parameters import beyond_linear, group_name
from tumble.views.blocks import Block, Items, Table
from tumble.views.checks import comparison_lines
from tumble.views.numbers import (
    Q,
    cells,
    device_name,
    limit_cell,
    quantity_table,
    run_to_run,
    shown_units,
    units_of_values,
    with_expanded,
)

if TYPE_CHECKING:
    from tumble.lab.registry.trend import ParameterTrend, Trend

_BARS = "▁▂▃▄▅▆▇█"
_MAX_BARS = 24

# -------------------- lists --------------------


def _day(moment: date) -> str:
    return f"{moment:%Y-%m-%d}"


def _text_table(columns: tuple[str, ...], rows: Iterable[tuple[object, ...]]) -> Table:
    """Return a table of words, with empty cells for None."""
    texts = (tuple("" if cell is None else str(cell) for cell in row) for row in rows)
    return Table(columns=columns, rows=tuple(texts), text=tuple(range(len(columns))))


def device_table(records: Sequence[Record]) -> Table:
    """Return a table of the devices with their latest records, from records in chronological order."""
    serials = [r.serial for r in records]
    rows = []
    for serial, r in sorted({r.serial: r for r in records}.items()):
        verdict = f"{r.verdict}: withdrawn" if r.withdrawn else r.verdict
        rows.append((serial, r.model, serials.count(serial), _day(r.performed), r.number, r.occasion, verdict))
    return _text_table(("device", "type", "calibrations", "latest", "record", "check", "verdict"), rows)


def record_table(records: Iterable[Record]) -> Table:
    """Return a table of the records of a device."""
    rows = ((r.number, _day(r.performed), r.occasion, r.state, r.method, r.frame, r.verdict) for r in records)
    return _text_table(("record", "performed", "check", "state", "method", "frame", "verdict"), rows)


def limits_table(limits: Iterable[LimitsRecord]) -> Table:
    """Return a table of the limits of all device types."""
    rows = ((r.number, r.model, _day(r.added), "in force" if r.in_force else "replaced") for r in limits)
    return _text_table(("limits", "type", "added", ""), rows)


def limits_blocks(limits: LimitsRecord) -> list[Block]:
    """Return the text of a limits file with its number, type and date."""
    head = f"limits {limits.number} · type {limits.model} · in force from {_day(limits.added)}"
    return [head, Items(items=(limits.file.rstrip(),)), DECISION_RULE, RISK_DEFINITION]


def due_table(items: Iterable[Due]) -> Table:
    """Return a table of due dates."""
    rows = []
    for item in items:
        r, days = item.record, None if item.day is None else (item.day - item.on).days
        status = "no interval" if days is None else f"in {days} d" if days >= 0 else f"overdue by {-days} d"
        status = f"withdrawn until calibrated again: {r.verdict}" if item.withdrawn else status
        interval = None if item.months is None else f"{item.months} months"
        rows.append((r.serial, r.model, _day(r.performed), r.number, interval, item.day, status))
    return _text_table(("device", "type", "latest", "record", "every", "due", ""), rows)


# -------------------- a record --------------------


def record_blocks(record: Record, calibration: Calibration, verdict: Verdict | None, *, every: bool) -> list[Block]:
    """Return a record with its parameters and their verdicts. Unless `every`, parameters beyond the linear model that
    have no limits are only counted."""
    lines = [
        f"record {record.number} · device {device_name(record.serial, record.model)} · {record.occasion} check · "
        f"{record.state}",
        f"performed {_day(record.performed)} · method {record.method} · frame {record.frame}",
        *(f"launch {session or 1} · log {log}" for session, log in logs_of(calibration) if log),
        f"content {record.sha256}",
    ]
    judged = _by_name(verdict)
    shown, caption = _select_parameters(calibration.parameters, judged, every=every)

    def row(p: Parameter, size: float, unit: str) -> dict[str, str]:
        row = dict(zip(("value", "U"), with_expanded(p, size), strict=True))
        if not judged:
            return row | {"unit": unit}
        j = judged.get(p.name)
        risk, result = ("", "") if j is None else (risk_text(j.risk), j.result)
        return row | _limit_cells(judged, p.name, size) | {"risk": risk, "unit": unit, "verdict": result}

    sentences = ["no verdict: no limits were in force for this type and check when the record was added"]
    if not record.accepted:
        sentences = [*calibration.outcome.reasons, f"verdict: {record.verdict}"]
    elif verdict is not None:
        risk = f"{RISK_DEFINITION}.{verdict.risk_sentence}"
        sentences = [DECISION_RULE, risk, *verdict.reasons, f"verdict: {verdict.result}"]
    remarks = [f"remark: {remark}" for remark in calibration.outcome.remarks]
    parameters = quantity_table(shown, shown_units(shown), row, words=("verdict",), caption=caption)
    return ["\n".join(lines), parameters, Items(items=(*remarks, *sentences))]


def _by_name(verdict: Verdict | None) -> Mapping[str, LimitJudgement]:
    """Return the judgements of a verdict by the names of their parameters."""
    return {} if verdict is None else {j.name: j for j in verdict.judgements}


def _limit_cells(judged: Mapping[str, LimitJudgement], name: str, size: float) -> dict[str, str]:
    """Return the cells with the limits of a parameter, empty without limits."""
    low, high = (judged[name].low, judged[name].high) if name in judged else (nan, nan)
    return {"lowest": limit_cell(low, size), "highest": limit_cell(high, size)}


def _select_parameters(parameters: Sequence[Q], kept: Collection[str], *, every: bool) -> tuple[list[Q], str]:
    """Return the parameters of the linear model and those named in `kept`, or all with `every`, and a sentence with the
    number of the others."""
    shown = [p for p in parameters if every or p.name in kept or not beyond_linear(p.name)]
    groups = len({group_name(p.name) for p in parameters if p not in shown})
    where, further = "1 group" if groups == 1 else f"{groups} groups", len(parameters) - len(shown)
    sentence = f"and {further} parameters beyond bias, scale and axes, in {where}: --all shows them"
    return shown, sentence if further else ""


# -------------------- a trend --------------------


def trend_blocks(trend: Trend, *, every: bool) -> list[Block]:
    """Return a table of the parameters of a device over its calibrations, with the verdict on the latest value. Unless
    `every`, parameters beyond the linear model that have no limits and have not changed are only counted."""
    judged = _by_name(trend.acceptance)
    differences = {} if trend.comparison is None else {d.name: d for d in trend.comparison.differences}
    shown, caption = _select_parameters(trend.parameters, {*judged, *trend.changed}, every=every)
    has_launches = any(parameter.run_to_run is not None for parameter in trend.parameters)
    units = units_of_values((t.name, p.value, t.unit) for t in trend.parameters for p in t.points)

    def row(parameter: ParameterTrend, size: float, unit: str) -> dict[str, str]:
        latest, drift = parameter.points[-1], parameter.drift
        value, U = with_expanded(latest, size)
        row = {"history": _sparkline([p.value for p in parameter.points]), "latest": value, "U": U}
        if judged:
            row |= _limit_cells(judged, parameter.name, size)
        if has_launches:
            row["run to run"] = run_to_run(parameter.run_to_run, size)
        per_year, U = ("", "")
        if drift is not None and drift.expanded is not None:
            per_year, U = cells(drift.per_year, drift.expanded, size)
        row |= {"drift/year": per_year, "U (95 %)": U, "change": "", "E_n": "", "unit": unit}
        if (change := differences.get(parameter.name)) is not None:
            row["change"] = cells(change.value, change.expanded, size)[0]
            row["E_n"] = "" if change.e_n is None else f"{change.e_n:+z.2f}"
        if judged:
            row["verdict"] = judged[parameter.name].result if parameter.name in judged else ""
        return row

    days = {p.number: _day(p.performed) for parameter in trend.parameters for p in parameter.points}
    first, last = min(days.values()), max(days.values())
    since = f"one calibration, of {first}" if len(days) == 1 else f"{len(days)} calibrations from {first} to {last}"
    return [
        f"device {device_name(trend.serial, trend.latest.model)} · {since} · frame {trend.frame}",
        quantity_table(shown, units, row, words=("history", "verdict"), caption=caption),
        *([Items(items=tuple(change_lines(trend)))] if trend.comparison is not None else []),
    ]


def change_lines(trend: Trend) -> list[str]:
    """Return sentences on the changes between the compared calibrations."""
    if trend.comparison is None or trend.compared is None:
        return []
    earlier, later = trend.compared
    compared, latest = "the latest against the one before", trend.latest.number
    if later != latest:
        adjusted = f"before the adjustment (record {latest} is after it, and is not compared)"
        compared = f"record {later} against record {earlier}, {adjusted}"
    first, *others = comparison_lines(trend.comparison)
    return [f"{compared}: {first}", *others]


def _sparkline(values: Sequence[float]) -> str:
    """Draw the last values as bars between the lowest and the highest."""
    shown = values[-_MAX_BARS:]
    low, high = min(shown), max(shown)
    if high == low:
        return _BARS[3] * len(shown)
    return "".join(_BARS[min(int((v - low) / (high - low) * len(_BARS)), len(_BARS) - 1)] for v in shown)
