"""`tumble plan`: the best a programme allows, the best next position, and better programmes."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from tumble.commands.arguments import setup_of, setup_options

if TYPE_CHECKING:
    from tumble.budget import Setup
    from tumble.places import Table
    from tumble.plan import Aim


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
    from tumble.bounds import bound
    from tumble.places import Table
    from tumble.plan import Aim
    from tumble.plan_text import bound_report, not_determined, unmet
    from tumble.programme import from_attitudes
    from tumble.require import wanted_of
    from tumble.text import print_report

    setup = setup_of(options)
    if attitudes:
        setup = replace(setup, programme=from_attitudes(attitudes))
    wishes = wanted_of(wanted, None, setup) if wanted else {}
    aim = Aim(letter=criterion, wanted=wishes, gyros=not accel_only)  # type: ignore[arg-type]
    if positions is not None:
        setup = _found(setup, positions, aim, Table.of(axes, step))
    best = bound(setup, gyros=aim.gyros)
    print_report(bound_report(setup, best))
    click.echo()
    _beside(setup, aim) if positions is not None else _one_more(setup, aim, Table.of(axes, step))
    reasons = [*not_determined(best), *unmet(best, wishes, setup)]
    for reason in reasons:
        click.echo(reason, err=True)
    sys.exit(1 if reasons else 0)


def _found(setup: Setup, positions: int, aim: Aim, table: Table) -> Setup:
    """The set-up with the best programme that is found, which is printed."""
    from tumble.plan import optimised
    from tumble.plan_text import positions_report
    from tumble.text import print_report

    programme = optimised(setup, positions, aim, table)
    print_report(positions_report(programme))
    click.echo()
    return replace(setup, programme=programme)


def _beside(setup: Setup, aim: Aim) -> None:
    """Print a set-up's programme beside those of the literature."""
    from tumble.plan import compared, of_the_literature
    from tumble.plan_text import comparison_report
    from tumble.text import print_report

    print_report(comparison_report(setup, compared(setup, (setup.programme, *of_the_literature()), aim), aim))


def _one_more(setup: Setup, aim: Aim, table: Table) -> None:
    """Print what one more position would buy."""
    from tumble.bounds import bound
    from tumble.plan import next_positions
    from tumble.plan_text import next_report
    from tumble.text import print_report

    print_report(next_report(bound(setup, gyros=aim.gyros), next_positions(setup, aim, table), aim))
