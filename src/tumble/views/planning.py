"""Bounds, plans, budgets and requirements."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from tumble.diagnosis.observability import in_words, sum_in_words
from tumble.inference.estimate import GroupFinding
from tumble.planning.best_positions import Aim, Compared, Next, PlanResult
from tumble.planning.bounds import Bound
from tumble.planning.budget import Budget
from tumble.planning.over_temperature import PlannedSession, ThermalPlan
from tumble.planning.requirements import Requirements
from tumble.planning.setup import Setup, time_of
from tumble.programme.positions import Programme
from tumble.programme.sheet_words import clock, move_text, short_code
from tumble.sensors.grades import spread_of
from tumble.sensors.parameters import group_name, group_of, positions_by_group, shown_in
from tumble.units import DEGREE, ZERO_CELSIUS, Array, engineering
from tumble.views.blocks import Block, Table, Text, table

LARGEST = 4
"""So many parameters of a combination are named."""

LITTLE, MOSTLY = 0.05, 0.75
"""Learned fractions below which a programme leaves a group to what is usual, and above which it is determined: u is
97 % and half of the prior."""


def in_unit(name: str, value: float) -> str:
    """A value in the unit its group is shown in; a dash where it is infinite."""
    if not math.isfinite(value):
        return "–"
    size, unit = shown_in(name, group_of(name).unit, value)
    return f"{value / size:.3g} {unit}"


# -------------------- a plan --------------------


def plan_blocks(plan: PlanResult, aim: Aim) -> list[Block]:
    """What a programme can show at best, with what one more position would add; or the best programme that was found,
    what it can show, and others beside it."""
    best = _bound_blocks(plan.setup, plan.bound, plan.whole)
    if not plan.programmes:
        return [*best, _next_table(plan.bound, plan.following, aim)]
    return [_position_table(plan.setup.programme), *best, _programme_table(plan.setup, plan.programmes, aim)]


def _bound_blocks(setup: Setup, bound: Bound, whole: Bound) -> list[Block]:
    """What a set-up's programme can show at best: rank, condition, the worst combination, every linear parameter with
    others known and as the `whole` instrument allows, then a line for each group of others."""
    programme = setup.programme
    lines = [
        f"{programme.name}: {len(programme.positions)} positions in {clock(time_of(programme, setup))}, "
        f"rests of {setup.rest:g} s, turns at {setup.turn_rate / DEGREE:g} °/s",
        f"rank {bound.rank} of {bound.linear}, condition {_condition(bound)}",
        *_not_determined(bound),
    ]
    if not len(bound.null):
        lines.append(f"worst determined: {_worst(bound)} (of gravity, of the rate of turns, rad)")
    rows = []
    for name, u, with_all in zip(bound.names[: bound.linear], bound.u, whole.u, strict=False):
        share = f"{u / spread_of(setup, name):.2%}" if math.isfinite(u) else ""
        row = {"parameter": name, "bound of u": in_unit(group_name(name), u), "of the spread": share}
        rows.append(row | {"with all groups": in_unit(group_name(name), with_all)})
    further = _further_table(whole.names, whole.u, whole.further)
    return [*(Text(text=line) for line in lines), table(rows), further]


def _further_table(names: Sequence[str], u: Array, further: Sequence[GroupFinding]) -> Table:
    """A line for each group beyond the linear model: what is usual, and what is found out about it, from the u of all
    parameters."""
    places, rows = positions_by_group(names), []
    for group in further:
        worst, learned = float(u[places[group.name]].max()), min(group.learned)
        row = {"group": group.name, "usual": in_unit(group.name, group.prior)}
        row |= {"bound of u": in_unit(group.name, worst), "learned": f"{learned:.1%}"}
        rows.append(row | {"": "left to what is usual" if learned < LITTLE else "" if learned > MOSTLY else "in part"})
    return table(rows, words=("group", ""), columns=("group", "usual", "bound of u", "learned", ""))


def _next_table(before: Bound, following: Sequence[Next], aim: Aim) -> Table:
    """What one more position would buy, the best first."""
    words = ("one more position", "up and down", "how to get there")
    rows = [dict.fromkeys(words, "") | {words[0]: "none", "as good": "", "rank": str(before.rank), aim.letter: ""}]
    rows[0] |= _by_group(before)
    for one in following:
        ratio = "" if len(before.null) else f"{one.ratio - 1.0:+.1%}".replace("-", "−")
        where = (short_code(one.position.attitude), one.position.label, move_text(one.move))
        row = {"as good": f"+{one.as_good}" if one.as_good else "", "rank": str(one.bound.rank), aim.letter: ratio}
        rows.append(dict(zip(words, where, strict=True)) | row | _by_group(one.bound))
    return table(rows, words=words)


def _position_table(programme: Programme) -> Table:
    """The positions of a programme and how they are reached."""
    moves = ("start", *map(move_text, programme.moves))
    rows = [
        {"": str(i), "how to get there": how, "attitude": short_code(position.attitude), "up and down": position.label}
        for i, (position, how) in enumerate(zip(programme.positions, moves, strict=True), 1)
    ]
    return table(rows, words=("how to get there", "attitude", "up and down"))


def _programme_table(setup: Setup, rows: Sequence[Compared], aim: Aim) -> Table:
    """Programmes beside each other; the criterion over that of the first."""
    return table(
        [
            {
                "programme": row.programme.name,
                "positions": str(len(row.programme.positions)),
                "time": clock(time_of(row.programme, setup)),
                "rank": str(row.bound.rank),
                "condition": _condition(row.bound),
            }
            | _by_group(row.bound)
            | {aim.letter: f"{row.value / rows[0].value:.2f}" if not len(row.bound.null) else ""}
            for row in rows
        ],
        words=("programme",),
    )


def short_of(bound: Bound, aim: Aim, setup: Setup) -> list[str]:
    """What a programme does not determine, and wanted accuracies that it cannot give, in sentences."""
    out = _not_determined(bound)
    for group, value in (aim.wanted or {}).items():
        if group in bound.groups and bound.rms(group) > value:
            out.append(
                f"{group}: expected {in_unit(group, value)} (rms), found at best "
                f"{in_unit(group, bound.rms(group))}; take more positions, or longer rests than {setup.rest:g} s"
            )
    return out


def _worst(bound: Bound) -> str:
    """The combination determined worst, by its largest coefficients, and how well it is."""
    worst = bound.worst / np.abs(bound.worst).max()
    small = np.argsort(-np.abs(worst), kind="stable")[LARGEST:]
    words = sum_in_words(np.where(np.isin(np.arange(len(worst)), small), 0.0, worst), bound.names)
    mostly = "mostly " if np.any(np.abs(worst[small]) > 0.3) else ""
    return f"{mostly}{words}, to {bound.worst_u / np.abs(bound.worst).max():.2g}"


def _not_determined(bound: Bound) -> list[str]:
    """What a programme does not determine, in words: a line, or none."""
    return [f"not determined: {', '.join(in_words(bound.null, bound.names))}"] if len(bound.null) else []


def _by_group(bound: Bound) -> dict[str, str]:
    """The rms of every kind of parameter."""
    return {group: in_unit(group, bound.rms(group)) for group in bound.groups}


def _condition(bound: Bound) -> str:
    return f"{bound.condition:.3g}" if math.isfinite(bound.condition) else "–"


# -------------------- over temperature --------------------


def thermal_plan_blocks(plan: ThermalPlan) -> list[Block]:
    """The recordings with what each takes and gives alone; what all give together, over the temperatures; and what they
    find out about each group beyond the linear model."""
    setup = plan.setup
    head = (
        f"{setup.programme.name}, {setup.instrument}: rests of {setup.rest:g} s, turns at "
        f"{setup.turn_rate / DEGREE:g} °/s, {_celsius(plan.low)} to {_celsius(plan.high)} °C, in the chamber "
        f"{clock(plan.seconds)}"
    )
    sessions = table(
        [
            {"recording": session.name, "°C": _range(session), "rests": str(session.rests)}
            | {"change": clock(session.change), "soak": clock(session.soak), "in all": clock(session.recording)}
            | {f"{group} alone": in_unit(group, u) for group, u in session.alone.items()}
            for session in plan.sessions
        ],
        words=("recording",),
    )
    parameters, named = [], positions_by_group(plan.names)
    for group in plan.groups:
        row = {"bound of u (rms)": group}
        for kelvin in dict.fromkeys((plan.low, plan.reference, plan.high)):
            row[f"at {_celsius(kelvin)} °C"] = in_unit(group, plan.rms(group, kelvin))
        for ending in ("t1", "t2"):
            name = f"{group}.{ending}"
            row[ending] = in_unit(name, plan.rms(name)) if name in named else ""
        parameters.append(row)
    further = _further_table(plan.names, plan.u, plan.further)
    return [Text(text=head), sessions, table(parameters, words=("bound of u (rms)",)), further]


def short_over_temperature(plan: ThermalPlan, wanted: Mapping[str, float]) -> list[str]:
    """What the recordings do not determine, and wanted accuracies that they cannot give at every temperature, in
    sentences."""
    missing = [name for name, seen in zip(plan.names, plan.determined, strict=True) if not seen]
    out = [f"not determined: {', '.join(missing)}"] if missing else []
    for group, value in wanted.items():
        if group not in positions_by_group(plan.names):
            out.append(f"{group}: expected {in_unit(group, value)} (rms), found nothing that shows it; see the notes")
        elif (worst := plan.worst(group)) > value:
            over = f" from {_celsius(plan.low)} to {_celsius(plan.high)} °C" if group in plan.groups else ""
            out.append(f"{group}: expected {in_unit(group, value)} (rms){over}, found at best {in_unit(group, worst)}")
    return out


def _range(session: PlannedSession) -> str:
    return " to ".join(dict.fromkeys((_celsius(session.low), _celsius(session.high))))


def _celsius(kelvin: float) -> str:
    return f"{kelvin - ZERO_CELSIUS:z.1f}".replace("-", "−")


# -------------------- a budget, and what an accuracy needs --------------------


def budget_table(budget: Budget, bound: Bound | None) -> Table:
    """Expected errors of every method, pass and group of parameters, beside the least that any method can have."""
    rows = []
    for row in budget.rows:
        cells = {"method": row.method, "pass": str(row.iteration), "parameters": row.group, "estimator": row.estimator}
        cells |= {"error (rms)": _quantity(row.error, row.unit), "of the spread": f"{row.relative:.2%}"}
        cells |= {} if bound is None else {"bound": _quantity(bound.rms(row.group), row.unit)}
        rows.append(cells | {"mostly from": row.dominating})
    return table(rows, words=("method", "pass", "parameters", "estimator", "mostly from"), named_by=3)


def _quantity(value: float, unit: str) -> str:
    """A value, SI, in its engineering unit; nothing where it is infinite."""
    size, shown = engineering(unit, value)
    return f"{value / size:.3g} {shown}" if math.isfinite(value) else ""


def requirement_blocks(requirements: Requirements) -> list[Block]:
    """What each wanted accuracy asks of table, mounting and rests, and what meets all of them."""
    rows = []
    for row in requirements.rows:
        cells = {"parameters": row.group, "wanted": _quantity(row.wanted, row.unit), "table within": "no table"}
        cells |= {"mounting within": "", "rest at least": "", "because": row.reason}
        if row.feasible:
            cells |= {"table within": _within(row.table_error, row.limited), "rest at least": f"{row.rest:.3g} s"}
            cells["mounting within"] = _within(row.mounting_error, row.limited)
        rows.append(cells)
    together = (
        f"together: table within ±{requirements.table_error / DEGREE:.2f}°, mounting within "
        f"±{requirements.mounting_error / DEGREE:.2f}°, rests of at least {requirements.rest:.3g} s"
    )
    met = any(row.feasible for row in requirements.rows)
    return [table(rows, words=("parameters", "because")), *([Text(text=together)] if met else [])]


def _within(angle: float, limited: bool) -> str:
    return f"±{angle / DEGREE:.2f}°" if limited else "any (±5°)"
