"""Results as JSON: what the tables of the command line say, in SI and by name, for other programs.

Keys are those of the result's dataclasses and of the calibration file; an angle is in rad, a rate in rad/s, the
temperature of a rest in °C, what is not known is null, days and times are by ISO 8601; `format` is that of the keys.
Rests, turns and files are counted from 0, as in the calibration file.
"""

from __future__ import annotations

import json
import math
from dataclasses import asdict, is_dataclass
from datetime import date
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from tumble.calibration.results import fits_content
from tumble.planning.setup import time_of
from tumble.sensors.grades import spread_of
from tumble.sensors.parameters import group_of, positions_by_group
from tumble.units import ZERO_CELSIUS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from tumble.acceptance.conformity import Verdict
    from tumble.calibration.calibration_file import Calibration
    from tumble.calibration.check import FieldCheck
    from tumble.calibration.compare import Comparison
    from tumble.calibration.observed import Observed
    from tumble.calibration.quiet_samples import RecordedNoise
    from tumble.calibration.verify import Verification
    from tumble.campaigns.fleet import Tally
    from tumble.inference.estimate import GroupFinding
    from tumble.planning.best_positions import Compared, Next, PlanResult
    from tumble.planning.bounds import Bound
    from tumble.planning.budget import Budget
    from tumble.planning.over_temperature import ThermalPlan
    from tumble.planning.requirements import Requirements
    from tumble.planning.setup import Setup
    from tumble.programme.positions import Move, Position
    from tumble.reduction.observations import Observations
    from tumble.registry.due import Due
    from tumble.registry.monitor import Monitored
    from tumble.registry.types import LimitsRecord, Record
    from tumble.units import Array

Content = dict[str, Any]


def print_data(content: Content) -> None:
    """Print a result as JSON on standard output, in characters that every terminal has."""
    click.echo(json.dumps({"format": 1} | _plain(content), indent=1, allow_nan=False))


def _plain(value: Any) -> Any:
    """A value as JSON has it; numbers that are not finite are null."""
    if isinstance(value, dict):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, date):
        return value.isoformat()
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _of(result: object, names: str) -> Content:
    """Fields of a result, by their names."""
    return {name: getattr(result, name) for name in names.split()}


# -------------------- recordings and calibrations --------------------


def calibration_data(calibration: Calibration, *others: Calibration) -> Content:
    """The content of the calibration file; those of other methods, where there are any, under `others`."""
    content = calibration.content()
    return content | {"others": [other.content() for other in others]} if others else content


def inspection_data(observed: Observed) -> Content:
    """Rests, turns and what was rejected."""
    segmentation, observations = observed.segmentation, observed.observations
    return (
        {"rate": observed.rate}
        | _of(segmentation, "scatter_limit rate_limit")
        | {
            "rests": [] if observations is None else _rests(observations),
            "turns": [] if observations is None else _turns(observations),
            "rejected": segmentation.rejected,
            "notes": [] if observations is None else observations.notes,
            "faults": [*observed.faults, *observed.gyro_faults],
        }
    )


def _rests(observations: Observations) -> list[Content]:
    rests = observations.rests
    force = observations.accel_block.nominal().apply(rests.accel)
    vertical = force / np.linalg.norm(force, axis=1, keepdims=True)
    kinds = ["accel", *(["gyro"] if rests.gyro.shape[1] else [])]
    return [
        {
            "file": rests.file[i],
            "start": rests.start[i],
            "stop": rests.stop[i],
            "vertical": vertical[i],
            "temperature": None if rests.temperature is None else rests.temperature[i] - ZERO_CELSIUS,
        }
        | {
            kind: {
                "mean": getattr(rests, kind)[i],
                "u": np.sqrt(np.diag(getattr(rests, f"{kind}_covariance")[i])),
                "drift": getattr(rests, f"{kind}_drift")[i],
                "noise": getattr(rests, f"{kind}_noise")[i],
            }
            for kind in kinds
        }
        for i in range(len(rests))
    ]


def _turns(observations: Observations) -> list[Content]:
    turns = observations.turns
    if turns is None:
        return []
    columns = zip(turns.first, turns.last, turns.duration, turns.C, strict=True)
    return [dict(zip(("first", "last", "duration", "rotation"), row, strict=True)) for row in columns]


def verification_data(verification: Verification) -> Content:
    """Check positions and the verdict."""
    v, names = verification, ("label", "difference", "u", "sigmas")
    return (
        {"accepted": not v.reasons}
        | _of(v, "reasons left_out limit")
        | {
            "positions": [
                dict(zip(names, row, strict=True)) for row in zip(v.labels, v.difference, v.u, v.sigmas, strict=True)
            ],
        }
    )


def field_check_data(check: FieldCheck) -> Content:
    """What has changed since a calibration, and what would have been found."""
    result = check.result
    return {
        **_of(check, "valid reasons rests turns"),
        "changes": result.changes,
        "parameters": [
            {"name": name, "change": change, "u": u, "detectable": result.detectable[name]}
            for name, (change, u) in result.tests.items()
        ],
        **_of(result, "largest limit"),
        "misfit": fits_content({"misfit": result.misfit})["misfit"],
        "notes": check.notes,
    }


def comparison_data(comparison: Comparison) -> Content:
    """Differences of two calibrations."""
    return {
        **_of(comparison, "agree frame"),
        "parameters": [asdict(d) | {"difference": d.value, "e_n": d.e_n} for d in comparison.differences],
        **_of(comparison, "covariance chi_square degrees probability largest_by_chance missing remarks"),
    }


def noise_data(noise: RecordedNoise) -> Content:
    """Noise coefficients of every channel."""
    return _of(noise, "source rate") | {
        "channels": [
            {"name": name, "unit": panel.unit, "noise": parameters}
            for panel in noise.panels
            for name, parameters in zip(panel.channels, panel.parameters, strict=True)
        ],
    }


# -------------------- plans, budgets, requirements, fleets --------------------


def plan_data(plan: PlanResult, reasons: list[str]) -> Content:
    """What a programme can show at best, one more position or other programmes, and what is wanted and not had."""
    programme, bound = plan.setup.programme, plan.bound
    moves: tuple[Move | None, ...] = (None, *programme.moves)
    columns = zip(bound.names[: bound.linear], bound.units, bound.u, plan.whole.u, strict=False)
    return {
        "reasons": reasons,
        "programme": programme.name,
        "positions": [_position(p, m) for p, m in zip(programme.positions, moves, strict=True)],
        "duration": time_of(programme, plan.setup),
        "bound": _bound(bound),
        "parameters": [
            {
                "name": name,
                "unit": unit,
                "u": u,
                "of_spread": u / spread_of(plan.setup, name),
                "u_with_all_groups": whole,
            }
            for name, unit, u, whole in columns
        ],
        "groups": _further(plan.whole.names, plan.whole.u, plan.whole.further),
        "following": [_next(one) for one in plan.following],
        "programmes": [_compared(one, plan.setup) for one in plan.programmes],
    }


def _position(position: Position, move: Move | None) -> Content:
    """A position and the move that leads to it; of the first position, and where any movement will do, null."""
    turn = None if move is None or move.axis is None else _of(move, "axis angle")
    return _of(position, "attitude label") | {"turn": turn}


def _bound(bound: Bound) -> Content:
    rms = {group: bound.rms(group) for group in bound.groups}
    return {"rank": bound.rank, "of": bound.linear, "condition": bound.condition, "rms": rms}


def _further(names: Sequence[str], u: Array, further: Sequence[GroupFinding]) -> list[Content]:
    places = positions_by_group(names)
    return [
        {
            "group": group.name,
            "usual": group.prior,
            "u": float(np.max(u[places[group.name]])),
            "learned": min(group.learned),
        }
        for group in further
    ]


def _next(one: Next) -> Content:
    return _position(one.position, one.move) | _of(one, "as_good ratio") | {"bound": _bound(one.bound)}


def _compared(one: Compared, setup: Setup) -> Content:
    return {
        "programme": one.programme.name,
        "attitudes": [position.attitude for position in one.programme.positions],
        "duration": time_of(one.programme, setup),
        "value": one.value,
        "bound": _bound(one.bound),
    }


def thermal_plan_data(plan: ThermalPlan, reasons: list[str]) -> Content:
    """What recordings over temperature can show at best, how long each takes, and what is wanted and not had."""
    columns = zip(plan.names, plan.u, plan.at(plan.low), plan.at(plan.high), strict=True)
    return {
        "reasons": reasons,
        "programme": plan.setup.programme.name,
        "duration": plan.seconds,
        **_of(plan, "low reference high"),
        "recordings": plan.sessions,
        "parameters": [
            {"name": name, "unit": group_of(name).unit, "u": u, "u_low": low, "u_high": high}
            for name, u, low, high in columns
        ],
        "groups": _further(plan.names, plan.u, plan.further),
        "notes": plan.notes,
    }


def budget_data(budget: Budget, bound: Bound | None) -> Content:
    """Expected errors by method, pass and group of parameters, with their terms, and the bound."""
    return {
        "rows": [
            {
                **_of(row, "group method iteration estimator unit error relative"),
                "bound": None if bound is None else bound.rms(row.group),
                "mostly_from": row.dominating,
                "terms": [_of(term, "name error") for term in row.terms],
            }
            for row in budget.rows
        ],
        "remarks": budget.remarks,
    }


def requirements_data(requirements: Requirements) -> Content:
    """What each wanted accuracy needs, and what meets all of them."""
    row = "group estimator wanted unit feasible limited table_error mounting_error tilt rest reason"
    return _of(requirements, "feasible table_error mounting_error rest") | {
        "rows": [_of(each, row) for each in requirements.rows]
    }


def fleet_data(sessions: int, tally: Tally, rows: Path) -> Content:
    """How the sessions of a fleet ended, and where the rows are."""
    ended = {"accepted": tally.accepted, "refused": dict(tally.refused), "failed": dict(tally.failed)}
    return {"sessions": sessions, **ended, "rows": str(rows)}


# -------------------- the registry --------------------


def devices_data(latest: Sequence[Due]) -> Content:
    """Every device with its latest record."""
    return {
        "devices": [
            _of(item.record, "serial model")
            | {"calibrations": item.calibrations, "due": item.day, "latest": item.record}
            for item in latest
        ]
    }


def records_data(records: Sequence[Record]) -> Content:
    """The records of a device."""
    return {"records": records}


def record_data(record: Record, calibration: Calibration, verdict: Verdict | None) -> Content:
    """A record with its launches, its parameters (of the result: launch 0), and the verdict."""
    from tumble.registry.adding import logs_of

    numbered = [(0, calibration.parameters), *((i, x.parameters) for i, x in enumerate(calibration.launches, 1))]
    parameters = [{"launch": launch} | _of(p, "name value u unit dof") for launch, several in numbered for p in several]
    launches = [{"session": session, "log_sha256": log} for session, log in logs_of(calibration)]
    judged = None
    if verdict is not None:
        said = {"reasons": verdict.reasons(), "parameters": verdict.judgements}
        judged = _of(verdict, "result occasion frame") | said
    return {"record": record, "launches": launches, "parameters": parameters, "verdict": judged}


def trend_data(found: Monitored) -> Content:
    """The parameters of a device over its calibrations."""
    return {
        "serial": found.latest.serial,
        "frame": found.frame,
        "limits": dict(found.limits),
        "parameters": [
            {
                **_of(trend.series, "name unit"),
                "calibrations": [
                    {"record": p.number} | _of(p, "performed state value u dof") for p in trend.series.points
                ],
                **_of(trend, "run_to_run instability drift changes"),
            }
            for trend in found.trends
        ],
        "changed": found.changed(),
        "forecasts": found.forecasts(),
    }


def limits_data(records: Sequence[LimitsRecord], in_force: Mapping[str, LimitsRecord]) -> Content:
    """Acceptance limits of device types, as TOML texts."""
    return {
        "limits": [
            {
                **_of(own, "number model added"),
                "in_force": in_force[own.model].number == own.number,
                "file": own.file,
            }
            for own in records
        ]
    }


def due_data(items: Sequence[Due], today: date) -> Content:
    """When which device is to be calibrated again."""
    return {
        "on": today,
        "devices": [
            {
                **_of(item.record, "serial model"),
                "record": item.record.number,
                "performed": item.record.performed,
                "months": item.months,
                "due": item.day,
                "by_drift": item.by_drift if item.drifts else None,
                "overdue": item.day is not None and item.day < today,
            }
            for item in items
        ],
    }
