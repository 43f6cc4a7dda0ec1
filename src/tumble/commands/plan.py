"""`tumble plan`: the best a programme allows, the best next position, and better programmes."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from tumble.commands.arguments import setup_of, setup_options

if TYPE_CHECKING:
    from tumble.planning.best_positions import Aim
    from tumble.planning.reachable_attitudes import TurnTable
    from tumble.planning.setup import Setup


@click.command()
@setup_options
@click.option("--attitude", "attitudes", multiple=True, help="Instead of --programme: an attitude code; repeat.")
@click.option("--accel-only", is_flag=True, help="Accelerometers alone, without gyros and turns.")
@click.option("--positions", type=click.IntRange(2, 60), help="Find a programme of so many positions.")
@click.option("--criterion", type=click.Choice(["A", "D"]), default="A", show_default=True, help="What is best.")
@click.option("--want", "wanted", multiple=True, metavar="GROUP=VALUE", help="E.g. accel.scale=3.5ppm; repeat.")
@click.option("--axes", metavar="N,U,E", help="Turns about these alone, the device staying as it is mounted.")
@click.option("--step", type=float, default=45.0, show_default=True, help="Where the table stops: multiples, °.")
def plan(
    attitudes: tuple[str, ...],
    accel_only: bool,
    positions: int | None,
    criterion: str,
    wanted: tuple[str, ...],
    axes: str | None,
    step: float,
    **options: Any,
) -> None:
    """The least uncertainty a programme allows, the best next position, and better programmes."""
    from tumble.planning.best_positions import Aim
    from tumble.planning.reachable_attitudes import TurnTable
    from tumble.planning.requirements import wanted_of
    from tumble.programme.positions import from_attitudes

    setup = setup_of(options)
    if attitudes:
        setup = replace(setup, programme=from_attitudes(attitudes))
    wishes = wanted_of(wanted, None, setup) if wanted else {}
    aim = Aim(letter=criterion, wanted=wishes, gyros=not accel_only)  # type: ignore[arg-type]
    table = TurnTable.of(axes, step)
    reasons = _one_more(setup, aim, table) if positions is None else _found(setup, positions, aim, table)
    for reason in reasons:
        click.echo(reason, err=True)
    sys.exit(1 if reasons else 0)


def _one_more(setup: Setup, aim: Aim, table: TurnTable) -> list[str]:
    """Print what a set-up's programme can show and what one more position would buy; returns what it cannot."""
    from tumble.planning.best_positions import next_positions
    from tumble.planning.bounds import bound
    from tumble.planning.setup import with_all_groups
    from tumble.terminal.plan import bound_report, next_report, short_of
    from tumble.terminal.text import print_report

    best, found = bound(setup, gyros=aim.gyros), next_positions(setup, aim, table)
    print_report(bound_report(setup, best, bound(with_all_groups(setup), gyros=aim.gyros)))
    click.echo()
    print_report(next_report(best, found, aim))
    return short_of(best, aim, setup)


def _found(setup: Setup, positions: int, aim: Aim, table: TurnTable) -> list[str]:
    """Print the best programme that is found, what it can show, and others beside it; returns what it cannot."""
    from tumble.planning.best_positions import compared, of_the_literature, optimised
    from tumble.planning.bounds import bound
    from tumble.planning.setup import with_all_groups
    from tumble.terminal.plan import bound_report, comparison_report, positions_report, short_of
    from tumble.terminal.text import print_report

    setup = replace(setup, programme=optimised(setup, positions, aim, table))
    rows = compared(setup, (setup.programme, *of_the_literature()), aim)
    print_report(positions_report(setup.programme))
    click.echo()
    print_report(bound_report(setup, rows[0].bound, bound(with_all_groups(setup), gyros=aim.gyros)))
    click.echo()
    print_report(comparison_report(setup, rows, aim))
    return short_of(rows[0].bound, aim, setup)
