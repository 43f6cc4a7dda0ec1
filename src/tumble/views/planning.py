"""Plans: expected uncertainties, best next positions, requirements."""

from __future__ import annotations

import math
from collections.abc import Mapping

from tumble.planning.plan import Plan, Requirement, largest_errors, least_rest
from tumble.planning.setup import GROUPS, Setup, time_of
from tumble.programme.sheet_words import clock, move_text, short_code
from tumble.sensors.parameters import group_of, shown_in
from tumble.units import DEGREE
from tumble.views.blocks import Block, Items, table
from tumble.views.numbers import minus

MIN_SHARE = 1e-4  # of u²; smaller sources are not shown


def _in_unit(name: str, value: float) -> str:
    """Format a value of a group in its display unit; a dash if infinite."""
    if not math.isfinite(value):
        return "–"
    size, unit = shown_in(name, group_of(name).unit, value)
    return f"{value / size:.3g} {unit}"


def plan_blocks(plan: Plan, *, sources: bool = False) -> list[Block]:
    """Return u by group, with `sources` also by source, the best next positions, and what wanted accuracies need."""
    setup, programme = plan.setup, plan.setup.programme
    head = (
        f"{programme.name}: {len(programme.positions)} positions in {clock(time_of(programme, setup))}, "
        f"rests of {setup.rest:g} s, turns at {setup.turn_rate / DEGREE:g} °/s"
    )
    if plan.motion is not None:
        where = "on a pivot" if plan.motion.held == "pivot" else "in the hand"
        head = f"{clock(plan.motion.seconds)} of motion {where}"
    blocks: list[Block] = [head]
    if plan.rank is not None and plan.condition is not None:
        linear = sum(len(row.parameters) for row in plan.groups if row.group in GROUPS)
        condition = f", condition {plan.condition:.3g}" if math.isfinite(plan.condition) else ""
        blocks.append(f"determined: {plan.rank} of {linear} linear parameters{condition}")
    rows: list[Mapping[str, str]] = []
    for row in plan.groups:
        cells = {"parameters": row.group, "u (rms)": _in_unit(row.group, row.u)}
        cells |= {"before": _in_unit(row.group, row.spread), "u/before": f"{row.u / row.spread:.2%}"}
        if plan.method != "joint":
            cells = {"pass": str(row.iteration), **cells, "by": row.estimator}
        rows.append(cells | {"mostly from": row.largest if math.isfinite(row.u) else "not determined"})
        for name, u in row.sources.items() if sources else ():
            if u**2 >= MIN_SHARE * row.u**2:
                blank = dict.fromkeys(cells, "")
                rows.append({**blank, "u (rms)": _in_unit(row.group, u), "mostly from": name})
    blocks.append(table(rows, words=("parameters", "by", "mostly from")))
    if plan.following:
        words, rows = ("one more position", "up and down", "how to get there"), []
        equals = any(one.as_good for one in plan.following)
        for one in plan.following:
            place = (short_code(one.position.attitude), one.position.label, move_text(one.move))
            counts = {"as good": f"+{one.as_good}" if one.as_good else ""} if equals else {}
            counts["gain"] = minus(f"{one.ratio - 1.0:+.1%}")
            u_after = {group: _in_unit(group, one.u[group]) for group in GROUPS if group in one.u}
            rows.append(dict(zip(words, place, strict=True)) | counts | u_after)
        blocks.append(table(rows, words=words))
    if plan.requirements:
        needs = (_needs(row, setup) for row in plan.requirements)
        blocks.append(table(needs, words=("parameters", "because")))
    worse = any(row.spread < row.u < math.inf for row in plan.groups)
    above = "u/before above 100 %: " + (
        "the programme does not determine such a group, and u allows for a size larger than usual"
        if plan.method == "joint"
        else "u contains errors of table and mounting and terms beyond the linear model, which the spread before does "
        "not; this pass does not improve such a group"
    )
    return [*blocks, Items(items=(*([above] if worse else []), *plan.assumptions))]


def _needs(row: Requirement, setup: Setup) -> dict[str, str]:
    """Return the cells of a wanted accuracy: what it needs of the table, the mounting, and rests or positions."""
    cells = {"parameters": row.group, "wanted": _in_unit(row.group, row.wanted), "as it is": _in_unit(row.group, row.u)}
    cells |= dict.fromkeys(("table within", "mounting within", "rests of", "or positions"), "")
    if row.reason:
        return cells | {"table within": "no table", "because": row.reason.partition(": ")[2]}
    for what, error, largest in zip(
        ("table within", "mounting within"), (row.table_error, row.mounting_error), largest_errors(setup), strict=True
    ):
        cells[what] = f"±{largest / DEGREE:.2f}° (any)" if error is None else f"±{error / DEGREE:.2f}°"
    cells["rests of"] = f"{row.rest:.3g} s" if math.isfinite(row.rest) else "–"
    if row.rest == least_rest(setup):
        cells["rests of"] += f" (shortest: {_in_unit(row.group, row.reached)})"
    cells["or positions"] = "" if row.positions is None else str(row.positions)
    return cells | {"because": ""}
