"""Plans, budgets, requirements and fleets as JSON, in SI: keys as in `data`; what is not determined is null."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tumble.planning.setup import time_of
from tumble.programme.positions import Move, Position
from tumble.sensors.grades import spread_of
from tumble.sensors.parameters import positions_by_group

if TYPE_CHECKING:
    from pathlib import Path

    from tumble.campaigns.fleet import Tally
    from tumble.planning.best_positions import Compared, Next
    from tumble.planning.bounds import Bound
    from tumble.planning.budget import Budget
    from tumble.planning.plan import PlanResult
    from tumble.planning.requirements import Requirements
    from tumble.planning.setup import Setup


def plan_data(plan: PlanResult, reasons: list[str]) -> dict[str, Any]:
    """What a programme can show at best, one more position or other programmes, and what is wanted and not had."""
    programme, linear = plan.setup.programme, slice(plan.bound.linear)
    moves: tuple[Move | None, ...] = (None, *programme.moves)
    return {
        "reasons": reasons,
        "programme": programme.name,
        "positions": [_position(p, m) for p, m in zip(programme.positions, moves, strict=True)],
        "duration": time_of(programme, plan.setup),
        "bound": _bound(plan.bound),
        "parameters": [
            {
                "name": name,
                "unit": unit,
                "u": u,
                "of_spread": u / spread_of(plan.setup, name),
                "u_with_all_groups": whole,
            }
            for name, unit, u, whole in zip(
                plan.bound.names[linear],
                plan.bound.units[linear],
                plan.bound.u[linear],
                plan.whole.u[linear],
                strict=True,
            )
        ],
        "groups": _further(plan.whole),
        "following": [_next(one) for one in plan.following],
        "programmes": [_compared(one, plan.setup) for one in plan.programmes],
    }


def _position(position: Position, move: Move | None) -> dict[str, Any]:
    """A position and the move that leads to it; of the first position, and where any movement will do, null."""
    turn = None if move is None or move.axis is None else {"axis": move.axis, "angle": move.angle}
    return {"attitude": position.attitude, "label": position.label, "turn": turn}


def _bound(bound: Bound) -> dict[str, Any]:
    return {
        "rank": bound.rank,
        "of": bound.linear,
        "condition": bound.condition,
        "rms": {group: bound.rms(group) for group in bound.groups},
    }


def _further(whole: Bound) -> list[dict[str, Any]]:
    places = positions_by_group(whole.names)
    return [
        {
            "group": group.name,
            "usual": group.prior,
            "u": float(np.max(whole.u[places[group.name]])),
            "learned": min(group.learned),
        }
        for group in whole.further
    ]


def _next(one: Next) -> dict[str, Any]:
    return _position(one.position, one.move) | {"as_good": one.as_good, "ratio": one.ratio, "bound": _bound(one.bound)}


def _compared(one: Compared, setup: Setup) -> dict[str, Any]:
    return {
        "programme": one.programme.name,
        "attitudes": [position.attitude for position in one.programme.positions],
        "duration": time_of(one.programme, setup),
        "value": one.value,
        "bound": _bound(one.bound),
    }


def budget_data(budget: Budget, bound: Bound | None) -> dict[str, Any]:
    """Expected errors by method, pass and group of parameters, with their terms, and the bound."""
    return {
        "rows": [
            {
                "group": row.group,
                "method": row.method,
                "iteration": row.iteration,
                "estimator": row.estimator,
                "unit": row.unit,
                "error": row.error,
                "relative": row.relative,
                "bound": None if bound is None else bound.rms(row.group),
                "mostly_from": row.dominating,
                "terms": [{"name": term.name, "error": term.error} for term in row.terms],
            }
            for row in budget.rows
        ],
        "remarks": list(budget.remarks),
    }


def requirements_data(requirements: Requirements) -> dict[str, Any]:
    """What each wanted accuracy needs, and what meets all of them."""
    return {
        "feasible": requirements.feasible,
        "table_error": requirements.table_error,
        "mounting_error": requirements.mounting_error,
        "rest": requirements.rest,
        "rows": list(requirements.rows),
    }


def fleet_data(sessions: int, tally: Tally, rows: Path) -> dict[str, Any]:
    """How the sessions of a fleet ended, and where the rows are."""
    return {
        "sessions": sessions,
        "accepted": tally.accepted,
        "refused": dict(tally.refused),
        "failed": dict(tally.failed),
        "rows": str(rows),
    }
