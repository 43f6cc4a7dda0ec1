"""Bounds, plans, budgets and requirements."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from tumble.diagnosis.observability import in_words, sum_in_words
from tumble.inference.estimate import GroupFinding
from tumble.planning.best_positions import Aim, PlanResult
from tumble.planning.bounds import Bound
from tumble.planning.budget import Budget
from tumble.planning.over_temperature import ThermalPlan
from tumble.planning.requirements import Requirements
from tumble.planning.setup import Setup, time_of
from tumble.programme.positions import Move, Position
from tumble.programme.sheet_words import clock, move_text, short_code
from tumble.sensors.grades import spread_of
from tumble.sensors.parameters import group_name, group_of, positions_by_group, shown_in
from tumble.units import DEGREE, ZERO_CELSIUS, Array
from tumble.views.blocks import Block, Table, table
from tumble.views.numbers import in_engineering, minus
from tumble.views.render.data import Content, fields, judged, rows

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
    if not plan.programmes:  # what one more position would buy
        words = ("one more position", "up and down", "how to get there")
        none = dict.fromkeys(words, "") | {words[0]: "none", "as good": "", "rank": str(plan.bound.rank)}
        shown = [none | {aim.letter: ""} | _by_group(plan.bound)]
        for one in plan.following:
            ratio = "" if len(plan.bound.null) else minus(f"{one.ratio - 1.0:+.1%}")
            where = (short_code(one.position.attitude), one.position.label, move_text(one.move))
            row = {"as good": f"+{one.as_good}" if one.as_good else "", "rank": str(one.bound.rank), aim.letter: ratio}
            shown.append(dict(zip(words, where, strict=True)) | row | _by_group(one.bound))
        return [*_bound_blocks(plan.setup, plan.bound, plan.whole), table(shown, words=words)]
    moves = ("start", *map(move_text, plan.setup.programme.moves))
    positions = [
        {"": str(i), "how to get there": how, "attitude": short_code(position.attitude), "up and down": position.label}
        for i, (position, how) in enumerate(zip(plan.setup.programme.positions, moves, strict=True), 1)
    ]
    compared = []
    for found in plan.programmes:
        row = {"programme": found.programme.name, "positions": str(len(found.programme.positions))}
        row |= {"time": clock(time_of(found.programme, plan.setup)), "rank": str(found.bound.rank)}
        row |= {"condition": _condition(found.bound)} | _by_group(found.bound)
        ratio = "" if len(found.bound.null) else f"{found.value / plan.programmes[0].value:.2f}"
        compared.append(row | {aim.letter: ratio})
    return [
        table(positions, words=("how to get there", "attitude", "up and down")),
        *_bound_blocks(plan.setup, plan.bound, plan.whole),
        table(compared, words=("programme",)),
    ]


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
        largest = np.abs(bound.worst).max()
        worst = bound.worst / largest  # a combination, by its largest coefficients
        small = np.argsort(-np.abs(worst), kind="stable")[LARGEST:]
        words = sum_in_words(np.where(np.isin(np.arange(len(worst)), small), 0.0, worst), bound.names)
        mostly, known = "mostly " if np.any(np.abs(worst[small]) > 0.3) else "", f"{bound.worst_u / largest:.2g}"
        lines.append(f"worst determined: {mostly}{words}, to {known} (of gravity, of the rate of turns, rad)")
    shown = []
    for name, u, with_all in zip(bound.names[: bound.linear], bound.u, whole.u, strict=False):
        share = f"{u / spread_of(setup, name):.2%}" if math.isfinite(u) else ""
        row = {"parameter": name, "bound of u": in_unit(group_name(name), u), "of the spread": share}
        shown.append(row | {"with all groups": in_unit(group_name(name), with_all)})
    return [*lines, table(shown), _further_table(whole.names, whole.u, whole.further)]


def _further_table(names: Sequence[str], u: Array, further: Sequence[GroupFinding]) -> Table:
    """A line for each group beyond the linear model: what is usual, and what is found out about it, from the u of all
    parameters."""
    shown = []
    for group in _further_data(names, u, further):
        name, learned = group["group"], group["learned"]
        row = {"group": name, "usual": in_unit(name, group["usual"]), "bound of u": in_unit(name, group["u"])}
        known = "left to what is usual" if learned < LITTLE else "" if learned > MOSTLY else "in part"
        shown.append(row | {"learned": f"{learned:.1%}", "": known})
    return table(shown, words=("group", ""), columns=("group", "usual", "bound of u", "learned", ""))


def _further_data(names: Sequence[str], u: Array, further: Sequence[GroupFinding]) -> list[Content]:
    places = positions_by_group(names)
    columns = [group.name for group in further], [group.prior for group in further]
    u_of = (float(np.max(u[places[group.name]])) for group in further)
    return rows("group usual u learned", *columns, u_of, (min(group.learned) for group in further))


def short_of(bound: Bound, aim: Aim, setup: Setup) -> list[str]:
    """What a programme does not determine, and wanted accuracies that it cannot give, in sentences."""
    return _not_determined(bound) + [
        f"{group}: expected {in_unit(group, value)} (rms), found at best {in_unit(group, bound.rms(group))}; take more "
        f"positions, or longer rests than {setup.rest:g} s"
        for group, value in (aim.wanted or {}).items()
        if group in bound.groups and bound.rms(group) > value
    ]


def _not_determined(bound: Bound) -> list[str]:
    """What a programme does not determine, in words: a line, or none."""
    return [f"not determined: {', '.join(in_words(bound.null, bound.names))}"] if len(bound.null) else []


def _by_group(bound: Bound) -> dict[str, str]:
    """The rms of every kind of parameter."""
    return {group: in_unit(group, bound.rms(group)) for group in bound.groups}


def _condition(bound: Bound) -> str:
    return f"{bound.condition:.3g}" if math.isfinite(bound.condition) else "–"


def plan_data(plan: PlanResult, reasons: list[str]) -> Content:
    """What a programme can show at best, one more position or other programmes, and what is wanted and not had."""
    setup, bound = plan.setup, plan.bound
    programme, linear = setup.programme, bound.names[: bound.linear]
    share = (u / spread_of(setup, name) for name, u in zip(linear, bound.u, strict=False))
    columns = linear, bound.units[: bound.linear], bound.u[: bound.linear], share, plan.whole.u[: bound.linear]
    return {
        **judged(reasons),
        "programme": programme.name,
        "positions": [_position(*at) for at in zip(programme.positions, (None, *programme.moves), strict=True)],
        "duration": time_of(programme, setup),
        "bound": _bound(bound),
        "parameters": rows("name unit u of_spread u_with_all_groups", *columns),
        "groups": _further_data(plan.whole.names, plan.whole.u, plan.whole.further),
        "following": [
            _position(one.position, one.move) | fields(one, "as_good ratio") | {"bound": _bound(one.bound)}
            for one in plan.following
        ],
        "programmes": [
            {
                "programme": one.programme.name,
                "attitudes": [position.attitude for position in one.programme.positions],
                "duration": time_of(one.programme, setup),
                "value": one.value,
                "bound": _bound(one.bound),
            }
            for one in plan.programmes
        ],
    }


def _position(position: Position, move: Move | None) -> Content:
    """A position and the move that leads to it; of the first position, and where any movement will do, null."""
    turn = None if move is None or move.axis is None else fields(move, "axis angle")
    return fields(position, "attitude label") | {"turn": turn}


def _bound(bound: Bound) -> Content:
    rms = {group: bound.rms(group) for group in bound.groups}
    return {"rank": bound.rank, "of": bound.linear, "condition": bound.condition, "rms": rms}


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
    sessions = []
    for session in plan.sessions:
        span = " to ".join(dict.fromkeys((_celsius(session.low), _celsius(session.high))))
        row = {"recording": session.name, "°C": span, "rests": str(session.rests), "change": clock(session.change)}
        row |= {"soak": clock(session.soak), "in all": clock(session.recording)}
        sessions.append(row | {f"{group} alone": in_unit(group, u) for group, u in session.alone.items()})
    parameters, named = [], positions_by_group(plan.bound.names)
    for group in plan.bound.groups:
        row = {"bound of u (rms)": group}
        for kelvin in dict.fromkeys((plan.low, plan.reference, plan.high)):
            row[f"at {_celsius(kelvin)} °C"] = in_unit(group, plan.rms(group, kelvin))
        for ending in ("t1", "t2"):
            name = f"{group}.{ending}"
            row[ending] = in_unit(name, plan.rms(name)) if name in named else ""
        parameters.append(row)
    return [
        head,
        table(sessions, words=("recording",)),
        table(parameters, words=("bound of u (rms)",)),
        _further_table(plan.bound.names, plan.bound.u, plan.bound.further),
    ]


def short_over_temperature(plan: ThermalPlan, wanted: Mapping[str, float]) -> list[str]:
    """What the recordings do not determine, and wanted accuracies that they cannot give at every temperature, in
    sentences."""
    missing = [name for name, seen in zip(plan.bound.names, plan.bound.observable, strict=True) if not seen]
    out = [f"not determined: {', '.join(missing)}"] if missing else []
    for group, value in wanted.items():
        if group not in positions_by_group(plan.bound.names):
            out.append(f"{group}: expected {in_unit(group, value)} (rms), found nothing that shows it; see the notes")
        elif (worst := plan.worst(group)) > value:
            over = f" from {_celsius(plan.low)} to {_celsius(plan.high)} °C" if group in plan.bound.groups else ""
            out.append(f"{group}: expected {in_unit(group, value)} (rms){over}, found at best {in_unit(group, worst)}")
    return out


def _celsius(kelvin: float) -> str:
    return minus(f"{kelvin - ZERO_CELSIUS:z.1f}")


def thermal_plan_data(plan: ThermalPlan, reasons: list[str]) -> Content:
    """What recordings over temperature can show at best, how long each takes, and what is wanted and not had."""
    units = (group_of(name).unit for name in plan.bound.names)
    columns = plan.bound.names, units, plan.bound.u, plan.at(plan.low), plan.at(plan.high)
    return {
        **judged(reasons),
        "programme": plan.setup.programme.name,
        "duration": plan.seconds,
        **fields(plan, "low reference high"),
        "recordings": plan.sessions,
        "parameters": rows("name unit u u_low u_high", *columns),
        "groups": _further_data(plan.bound.names, plan.bound.u, plan.bound.further),
        "notes": plan.notes,
    }


# -------------------- a budget, and what an accuracy needs --------------------


def budget_table(budget: Budget, bound: Bound | None) -> Table:
    """Expected errors of every method, pass and group of parameters, beside the least that any method can have."""
    shown = []
    for row in budget.rows:
        cells = {"method": row.method, "pass": str(row.iteration), "parameters": row.group, "estimator": row.estimator}
        cells |= {"error (rms)": in_engineering(row.unit, row.error, none=""), "of the spread": f"{row.relative:.2%}"}
        if bound is not None:
            cells["bound"] = in_engineering(row.unit, bound.rms(row.group), none="")
        shown.append(cells | {"mostly from": row.dominating})
    return table(shown, words=("method", "pass", "parameters", "estimator", "mostly from"), named_by=3)


def budget_data(budget: Budget, bound: Bound | None) -> Content:
    """Expected errors by method, pass and group of parameters, with their terms, and the bound."""
    shown = []
    for row in budget.rows:
        keys = fields(row, "group method iteration estimator unit error relative")
        keys |= {"bound": None if bound is None else bound.rms(row.group), "mostly_from": row.dominating}
        shown.append(keys | {"terms": [fields(term, "name error") for term in row.terms]})
    return {"rows": shown, "remarks": budget.remarks}


def requirement_blocks(requirements: Requirements) -> list[Block]:
    """What each wanted accuracy asks of table, mounting and rests, and what meets all of them."""
    shown = []
    for row in requirements.rows:
        cells = {"parameters": row.group, "wanted": in_engineering(row.unit, row.wanted, none="")}
        cells |= {"table within": "no table", "mounting within": "", "rest at least": "", "because": row.reason}
        if row.feasible:
            cells["table within"] = f"±{row.table_error / DEGREE:.2f}°" if row.limited else "any (±5°)"
            cells["mounting within"] = f"±{row.mounting_error / DEGREE:.2f}°" if row.limited else "any (±5°)"
            cells["rest at least"] = f"{row.rest:.3g} s"
        shown.append(cells)
    together = (
        f"together: table within ±{requirements.table_error / DEGREE:.2f}°, mounting within "
        f"±{requirements.mounting_error / DEGREE:.2f}°, rests of at least {requirements.rest:.3g} s"
    )
    met = any(row.feasible for row in requirements.rows)
    return [table(shown, words=("parameters", "because")), *([together] if met else [])]


def requirements_data(requirements: Requirements) -> Content:
    """What each wanted accuracy needs, and what meets all of them."""
    row = "group estimator wanted unit limited table_error mounting_error tilt rest"
    reasons = [[each.reason] if each.reason else [] for each in requirements.rows]
    return {
        **judged([each.reason for each in requirements.rows if each.reason]),
        **fields(requirements, "table_error mounting_error rest"),
        "rows": [judged(why) | fields(each, row) for each, why in zip(requirements.rows, reasons, strict=True)],
    }
