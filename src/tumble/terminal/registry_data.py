"""Devices, records, limits and trends of a registry as JSON, in SI: keys as in `data`; days and times by ISO 8601."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date
from typing import Any

from tumble.acceptance.conformity import Verdict
from tumble.registry.due import Due
from tumble.registry.monitor import Monitored
from tumble.registry.records import LaunchRow, ParameterRow, Record
from tumble.registry.store import LimitsRecord
from tumble.registry.trend import Trend


def devices_data(latest: Sequence[Due]) -> dict[str, Any]:
    """Every device with its latest record."""
    return {
        "devices": [
            {
                "serial": item.record.serial,
                "model": item.record.model,
                "calibrations": item.calibrations,
                "due": item.day,
                "latest": _record(item.record),
            }
            for item in latest
        ]
    }


def records_data(records: Sequence[Record]) -> dict[str, Any]:
    """The records of a device."""
    return {"records": [_record(record) for record in records]}


def record_data(
    record: Record, launches: Sequence[LaunchRow], rows: Sequence[ParameterRow], verdict: Verdict | None
) -> dict[str, Any]:
    """A record with its launches, its parameters (of the result: launch 0), and the verdict."""
    return {
        "record": _record(record),
        "launches": list(launches),
        "parameters": list(rows),
        "verdict": None if verdict is None else _verdict(verdict),
    }


def _record(record: Record) -> dict[str, Any]:
    return {name: getattr(record, name) for name in record.__dataclass_fields__}


def _verdict(verdict: Verdict) -> dict[str, Any]:
    return {
        "result": verdict.result,
        "occasion": verdict.occasion,
        "frame": verdict.frame,
        "reasons": verdict.reasons(),
        "parameters": list(verdict.judgements),
    }


def trend_data(found: Monitored) -> dict[str, Any]:
    """The parameters of a device over its calibrations."""
    return {
        "serial": found.latest.serial,
        "frame": found.frame,
        "limits": {name: list(limits) for name, limits in found.limits.items()},
        "parameters": [_trend(trend) for trend in found.trends],
        "changed": found.changed(),
        "forecasts": found.forecasts(),
    }


def _trend(trend: Trend) -> dict[str, Any]:
    return {
        "name": trend.series.name,
        "unit": trend.series.unit,
        "calibrations": [
            {"record": p.number, "performed": p.performed, "state": p.state, "value": p.value, "u": p.u, "dof": p.dof}
            for p in trend.series.points
        ],
        "run_to_run": trend.run_to_run,
        "instability": trend.instability,
        "drift": trend.drift,
        "changes": list(trend.changes),
    }


def limits_data(found: Sequence[LimitsRecord], in_force: Mapping[str, LimitsRecord]) -> dict[str, Any]:
    """Acceptance limits of device types, as TOML texts."""
    return {
        "limits": [
            {
                "number": own.number,
                "model": own.model,
                "added": own.added,
                "in_force": in_force[own.model].number == own.number,
                "file": own.file,
            }
            for own in found
        ]
    }


def due_data(found: Sequence[Due], today: date) -> dict[str, Any]:
    """When which device is to be calibrated again."""
    return {
        "on": today,
        "devices": [
            {
                "serial": item.record.serial,
                "model": item.record.model,
                "record": item.record.number,
                "performed": item.record.performed,
                "months": item.months,
                "due": item.day,
                "by_drift": item.by_drift if item.drifts else None,
                "overdue": item.day is not None and item.day < today,
            }
            for item in found
        ],
    }
