"""Plans over temperature as text on a terminal."""

from __future__ import annotations

from collections.abc import Mapping

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from tumble.planning.over_temperature import PlannedSession, ThermalPlan
from tumble.programme.sheet_words import clock
from tumble.sensors.parameters import positions_by_group
from tumble.terminal.plan import further_table, in_unit
from tumble.terminal.table import add_numbers, plain_table
from tumble.units import DEGREE, ZERO_CELSIUS


def thermal_plan_report(plan: ThermalPlan) -> RenderableType:
    """The recordings with what each takes and gives alone; what all give together, over the temperatures; and what they
    find out about each group beyond the linear model."""
    setup = plan.setup
    head = (
        f"{setup.programme.name}, {setup.instrument}: rests of {setup.rest:g} s, turns at "
        f"{setup.turn_rate / DEGREE:g} °/s, {_celsius(plan.low)} to {_celsius(plan.high)} °C, in the chamber "
        f"{clock(plan.seconds)}"
    )
    changes = further_table(plan.names, plan.u, plan.further)
    return Group(Text(head), Text(""), _sessions(plan), Text(""), _parameters(plan), Text(""), changes)


def short_over_temperature(plan: ThermalPlan, wanted: Mapping[str, float]) -> list[str]:
    """What the recordings do not determine, and wanted accuracies that they cannot give at every temperature, in
    sentences."""
    missing = [name for name, seen in zip(plan.names, plan.determined, strict=True) if not seen]
    out = [f"not determined: {', '.join(missing)}"] if missing else []
    for group, value in wanted.items():
        if group not in positions_by_group(plan.names):
            out.append(f"{group}: expected {in_unit(group, value)} (rms), found nothing that shows it; see the notes")
        elif (found := plan.worst(group)) > value:
            over = f" from {_celsius(plan.low)} to {_celsius(plan.high)} °C" if group in plan.groups else ""
            out.append(f"{group}: expected {in_unit(group, value)} (rms){over}, found at best {in_unit(group, found)}")
    return out


def _sessions(plan: ThermalPlan) -> Table:
    """A line for each recording."""
    table = plain_table("recording")
    groups = list(plan.sessions[0].alone)
    add_numbers(table, "°C", "rests", "change", "soak", "recording", *(f"{group} alone" for group in groups))
    for session in plan.sessions:
        times = [clock(seconds) for seconds in (session.change, session.soak, session.recording)]
        alone = [in_unit(group, session.alone[group]) for group in groups]
        table.add_row(session.name, _range(session), str(session.rests), *times, *alone)
    return table


def _range(session: PlannedSession) -> str:
    low, high = _celsius(session.low), _celsius(session.high)
    return low if low == high else f"{low} to {high}"


def _parameters(plan: ThermalPlan) -> Table:
    """A line for each kind of linear parameters: the bound of u, rms, at the ends and at the reference, and of its
    coefficients."""
    table = plain_table("bound of u (rms)")
    temperatures = (plan.low, plan.reference, plan.high)
    add_numbers(table, *(f"at {_celsius(kelvin)} °C" for kelvin in temperatures), "t1", "t2")
    there = positions_by_group(plan.names)
    for group in plan.groups:
        at = [in_unit(group, plan.rms(group, kelvin)) for kelvin in temperatures]
        coefficients = [f"{group}.{ending}" for ending in ("t1", "t2")]
        table.add_row(group, *at, *(in_unit(name, plan.rms(name)) if name in there else "" for name in coefficients))
    return table


def _celsius(kelvin: float) -> str:
    return f"{kelvin - ZERO_CELSIUS:z.1f}".replace("-", "−")
