"""Bounds and plans as text on a terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from tumble.estimation.estimate import GroupFinding
from tumble.estimation.observability import in_words, sum_in_words
from tumble.planning.best_positions import Aim, Compared, Next
from tumble.planning.bounds import Bound
from tumble.planning.plan import PlanResult
from tumble.planning.setup import Setup, time_of
from tumble.programme.positions import Programme
from tumble.programme.sheet_words import clock, move_text, short_code
from tumble.sensors.grades import spread_of
from tumble.sensors.parameters import group_name, group_of, positions_by_group, shown_in
from tumble.terminal.table import plain_table
from tumble.units import DEGREE, Array

LARGEST = 4
"""So many parameters of a combination are named."""

LITTLE, MOSTLY = 0.05, 0.75
"""Learned fractions below which a programme leaves a group to what is usual, and above which it is determined: u is
97 % and half of the prior."""


def plan_report(plan: PlanResult, aim: Aim) -> RenderableType:
    """What a programme can show at best, with what one more position would add; or the best programme that was found,
    what it can show, and others beside it."""
    best = bound_report(plan.setup, plan.bound, plan.whole)
    if not plan.programmes:
        return Group(best, Text(""), next_report(plan.bound, plan.following, aim))
    found = positions_report(plan.setup.programme)
    return Group(found, Text(""), best, Text(""), comparison_report(plan.setup, plan.programmes, aim))


def bound_report(setup: Setup, bound: Bound, whole: Bound) -> RenderableType:
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
    table = plain_table()
    table.add_column("parameter")
    for heading in ("bound of u", "of the spread", "with all groups"):
        table.add_column(heading, justify="right")
    linear = slice(bound.linear)
    for name, u, with_all in zip(bound.names[linear], bound.u[linear], whole.u[linear], strict=True):
        share = f"{u / spread_of(setup, name):.2%}" if math.isfinite(u) else ""
        group = group_name(name)
        table.add_row(name, in_unit(group, u), share, in_unit(group, with_all))
    return Group(*map(Text, lines), Text(""), table, Text(""), further_table(whole.names, whole.u, whole.further))


def further_table(names: Sequence[str], u: Array, further: Sequence[GroupFinding]) -> RenderableType:
    """A line for each group beyond the linear model: what is usual, and what is found out about it, from the u of all
    parameters."""
    table = plain_table()
    table.add_column("group")
    for heading in ("usual", "bound of u", "learned"):
        table.add_column(heading, justify="right")
    table.add_column("")
    places = positions_by_group(names)
    for group in further:
        worst, learned = float(u[places[group.name]].max()), min(group.learned)
        said = "left to what is usual" if learned < LITTLE else "" if learned > MOSTLY else "in part"
        cells = [in_unit(group.name, value) for value in (group.prior, worst)]
        table.add_row(group.name, *cells, f"{learned:.1%}", said)
    return table


def in_unit(name: str, value: float) -> str:
    """A value in the unit its group is shown in; a dash where it is infinite."""
    if not math.isfinite(value):
        return "–"
    size, unit = shown_in(name, group_of(name).unit, value)
    return f"{value / size:.3g} {unit}"


def next_report(before: Bound, found: Sequence[Next], aim: Aim) -> RenderableType:
    """What one more position would buy, the best first."""
    table = plain_table()
    for heading in ("one more position", "up and down", "how to get there"):
        table.add_column(heading)
    for heading in ("as good", "rank", aim.letter, *before.groups):
        table.add_column(heading, justify="right")
    table.add_row("none", "", "", "", str(before.rank), "", *_groups(before))
    for one in found:
        table.add_row(
            short_code(one.position.attitude),
            one.position.label,
            move_text(one.move),
            f"+{one.as_good}" if one.as_good else "",
            str(one.bound.rank),
            "" if len(before.null) else f"{one.ratio - 1.0:+.1%}".replace("-", "−"),
            *_groups(one.bound),
        )
    return table


def positions_report(programme: Programme) -> RenderableType:
    """The positions of a programme and how they are reached."""
    table = plain_table()
    table.add_column("", justify="right")
    for heading in ("how to get there", "attitude", "up and down"):
        table.add_column(heading)
    moves = ("start", *map(move_text, programme.moves))
    for i, (position, how) in enumerate(zip(programme.positions, moves, strict=True)):
        table.add_row(str(i + 1), how, short_code(position.attitude), position.label)
    return table


def comparison_report(setup: Setup, rows: Sequence[Compared], aim: Aim) -> RenderableType:
    """Programmes beside each other; the criterion over that of the first."""
    table = plain_table()
    table.add_column("programme")
    for heading in ("positions", "time", "rank", "condition", *rows[0].bound.groups, aim.letter):
        table.add_column(heading, justify="right")
    for row in rows:
        table.add_row(
            row.programme.name,
            str(len(row.programme.positions)),
            clock(time_of(row.programme, setup)),
            str(row.bound.rank),
            _condition(row.bound),
            *_groups(row.bound),
            f"{row.value / rows[0].value:.2f}" if not len(row.bound.null) else "",
        )
    return table


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


def _groups(bound: Bound) -> list[str]:
    """The rms of every kind of parameter."""
    return [in_unit(group, bound.rms(group)) for group in bound.groups]


def _condition(bound: Bound) -> str:
    return f"{bound.condition:.3g}" if math.isfinite(bound.condition) else "–"
