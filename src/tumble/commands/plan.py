"""`tumble plan`: the best a programme allows, the best next position, and better programmes."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NoReturn

import click

from tumble.commands.arguments import JSON, say, setup_of, setup_options, warn, working

if TYPE_CHECKING:
    from tumble.planning.best_positions import Letter
    from tumble.planning.setup import Setup


@click.command()
@setup_options
@click.option("--attitude", "attitudes", multiple=True, help="Instead of --programme: an attitude code; repeat.")
@click.option("--accel-only", is_flag=True, help="Accelerometers alone, without gyros and turns.")
@click.option("--positions", type=click.IntRange(2, 60), help="Find a programme of so many positions.")
@click.option("--criterion", type=click.Choice(["A", "D"]), default="A", show_default=True, help="What is best.")
@click.option("--want", "wanted", multiple=True, metavar="GROUP=VALUE", help="E.g. accel.scale=3.5ppm; repeat.")
@click.option("--axes", metavar="N,U,E", help="Turns about these alone, the device staying as it is mounted.")
@JSON
@click.option("--step", type=float, default=45.0, show_default=True, help="Where the table stops: multiples, °.")
@click.option("--temperature", metavar="RECORDINGS", help="Over temperature, °C: -20/4,20,60/4 or -20:60:-20/30.")
@click.option("--time-constant", type=float, default=600.0, show_default=True, help="Of the unit in a chamber, s.")
@click.option("--chamber-rate", type=float, default=2.0, show_default=True, help="Of the chamber, K a minute.")
def plan(
    attitudes: tuple[str, ...],
    accel_only: bool,
    positions: int | None,
    criterion: Letter,
    wanted: tuple[str, ...],
    axes: str | None,
    step: float,
    as_json: bool,
    temperature: str | None,
    time_constant: float,
    chamber_rate: float,
    **options: Any,
) -> None:
    """The least uncertainty a programme allows, the best next position, and better programmes; over temperature with
    the time in a chamber."""
    from tumble.planning.best_positions import Aim
    from tumble.planning.plan import plan as best
    from tumble.planning.reachable_attitudes import TurnTable
    from tumble.planning.requirements import wanted_of
    from tumble.programme.positions import from_attitudes
    from tumble.views.planning import plan_blocks, plan_data, short_of
    from tumble.views.render.data import print_data
    from tumble.views.render.terminal import print_blocks

    setup = setup_of(options)
    if attitudes:
        setup = replace(setup, programme=from_attitudes(attitudes))
    if temperature is not None:
        if positions is not None:
            raise click.UsageError("--positions: expected none with --temperature, found one; plan the positions first")
        chamber = chamber_rate, time_constant
        _over_temperature(setup, temperature, chamber, wanted, gyros=not accel_only, as_json=as_json)
    wishes = wanted_of(wanted, None, setup) if wanted else {}
    aim = Aim(letter=criterion, wanted=wishes, gyros=not accel_only)
    table = TurnTable.of(axes, step)
    with working("planning") as progress:
        found = best(setup, positions=positions, aim=aim, table=table, progress=progress)
    reasons = short_of(found.bound, aim, found.setup)
    if as_json:
        print_data(plan_data(found, reasons))
    else:
        print_blocks(*plan_blocks(found, aim))
    for reason in reasons:
        warn(reason)
    sys.exit(1 if reasons else 0)


def _over_temperature(
    setup: Setup, text: str, chamber: tuple[float, float], wanted: tuple[str, ...], *, gyros: bool, as_json: bool
) -> NoReturn:
    """Print the plan of recordings over temperature, and exit."""
    from tumble.planning.over_temperature import Chamber, plan_over_temperature, wanted_over_temperature
    from tumble.simulation.chamber import chamber_sessions
    from tumble.views.planning import short_over_temperature, thermal_plan_blocks, thermal_plan_data
    from tumble.views.render.data import print_data
    from tumble.views.render.terminal import print_blocks

    wishes, (rate, time_constant) = wanted_over_temperature(wanted), chamber
    chosen = Chamber.of(per_minute=rate, time_constant=time_constant)
    with working("planning"):
        found = plan_over_temperature(setup, chamber_sessions(text, setup), chamber=chosen, gyros=gyros)
    reasons = short_over_temperature(found, wishes)
    if as_json:
        print_data(thermal_plan_data(found, reasons))
    else:
        print_blocks(*thermal_plan_blocks(found))
        for note in found.notes:
            say(f"note: {note}")
    for reason in reasons:
        warn(reason)
    sys.exit(1 if reasons else 0)
