"""Devices, records, limits and trends of a registry as JSON, in SI: keys as in `data`; days and times by ISO 8601."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import date
from typing import Any

from tumble.acceptance.conformity import Verdict
from tumble.calibration.calibration_file import Calibration
from tumble.registry.due import Due
from tumble.registry.monitor import Monitored
from tumble.registry.submission import logs_of
from tumble.registry.trend import Trend
from tumble.registry.types import LimitsRecord, Record


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


def record_data(record: Record, calibration: Calibration, verdict: Verdict | None) -> dict[str, Any]:
    """A record with its launches, its parameters (of the result: launch 0), and the verdict."""
    numbered = [(0, calibration.parameters), *((i, x.parameters) for i, x in enumerate(calibration.launches, 1))]
    return {
        "record": _record(record),
        "launches": [{"session": session, "log_sha256": log} for session, log in logs_of(calibration)],
        "parameters": [
            {"launch": launch, "name": p.name, "value": p.value, "u": p.u, "unit": p.unit, "dof": p.dof}
            for launch, parameters in numbered
            for p in parameters
        ],
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
