"""`tumble plan`: the best a programme allows, the best next position, and better programmes."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import click

from tumble.commands.arguments import JSON, say, setup_of, setup_options


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
def plan(
    attitudes: tuple[str, ...],
    accel_only: bool,
    positions: int | None,
    criterion: str,
    wanted: tuple[str, ...],
    axes: str | None,
    step: float,
    as_json: bool,
    **options: Any,
) -> None:
    """The least uncertainty a programme allows, the best next position, and better programmes."""
    from tumble.planning.best_positions import Aim
    from tumble.planning.plan import plan as best
    from tumble.planning.reachable_attitudes import TurnTable
    from tumble.planning.requirements import wanted_of
    from tumble.programme.positions import from_attitudes
    from tumble.terminal.data import print_data
    from tumble.terminal.plan import plan_report, short_of
    from tumble.terminal.planning_data import plan_data
    from tumble.terminal.text import print_report

    setup = setup_of(options)
    if attitudes:
        setup = replace(setup, programme=from_attitudes(attitudes))
    wishes = wanted_of(wanted, None, setup) if wanted else {}
    aim = Aim(letter=criterion, wanted=wishes, gyros=not accel_only)  # type: ignore[arg-type]
    table = TurnTable.of(axes, step)
    found = best(setup, positions=positions, aim=aim, table=table)
    reasons = short_of(found.bound, aim, found.setup)
    if as_json:
        print_data(plan_data(found, reasons))
    else:
        print_report(plan_report(found, aim))
    for reason in reasons:
        say(reason)
    sys.exit(1 if reasons else 0)
