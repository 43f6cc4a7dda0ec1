"""`tumble plan`: the best a programme allows, the best next position, and better programmes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from tumble.commands import ask, tell

if TYPE_CHECKING:
    from tumble.planning.best_positions import Letter


@click.command(epilog=ask.examples("tumble plan --grade mems", "tumble plan --positions 12 --axes N,U"))
@ask.setup("linear")
@ask.option("--attitude/attitudes", "Instead of --programme: an attitude code; repeat.", multiple=True)
@click.option("--accel-only", is_flag=True, help="Accelerometers alone, without gyros and turns.")
@ask.option("--positions", "Find a programme of so many positions.", type=click.IntRange(2, 60))
@ask.option("--criterion", "What is best.", "A", type=click.Choice(["A", "D"]))
@ask.WANT
@ask.option("--axes", "Turns about these alone, the device staying as it is mounted.", metavar="N,U,E")
@ask.JSON
@ask.option("--step", "Where the table stops: multiples, °.", 45.0, type=float)
@ask.option("--over-temperature/recordings", "In a chamber, °C: -20/4,20,60/4 or -20:60:-20/30.", metavar="RECORDINGS")
@ask.option("--time-constant", "Of the unit in a chamber, s.", 600.0, type=float)
@ask.option("--chamber-rate", "Of the chamber, K a minute.", 2.0, type=float)
def plan(
    attitudes: tuple[str, ...],
    accel_only: bool,
    positions: int | None,
    criterion: Letter,
    wanted: tuple[str, ...],
    axes: str | None,
    step: float,
    as_json: bool,
    recordings: str | None,
    time_constant: float,
    chamber_rate: float,
    **options: Any,
) -> None:
    """The least uncertainty a programme allows, the best next position, and better programmes; over temperature with
    the time in a chamber."""
    from tumble.programme.positions import from_attitudes

    setup = ask.setup_of(options)
    if attitudes:
        setup = replace(setup, programme=from_attitudes(attitudes))
    if recordings is not None:
        if positions is not None:
            raise click.UsageError(
                "--positions: expected none with --over-temperature, found one; plan the positions first"
            )
        from tumble.planning.over_temperature import Chamber, plan_over_temperature, wanted_over_temperature
        from tumble.simulation.temperature_profile import chamber_sessions
        from tumble.views.planning import short_over_temperature, thermal_plan_blocks, thermal_plan_data

        wishes_over_temperature = wanted_over_temperature(wanted)
        chamber = Chamber.of(per_minute=chamber_rate, time_constant=time_constant)
        with tell.working("planning"):
            sessions = chamber_sessions(recordings, setup)
            thermal = plan_over_temperature(setup, sessions, chamber=chamber, gyros=not accel_only)
        reasons = short_over_temperature(thermal, wishes_over_temperature)
        tell.show(as_json, lambda: thermal_plan_data(thermal, reasons), lambda: thermal_plan_blocks(thermal))
        for note in () if as_json else thermal.notes:
            tell.say(f"note: {note}")
        tell.end(reasons)
    from tumble.planning.best_positions import Aim, plan
    from tumble.planning.reachable_attitudes import TurnTable
    from tumble.planning.requirements import wanted_of
    from tumble.views.planning import plan_blocks, plan_data, short_of

    aim = Aim(letter=criterion, wanted=wanted_of(wanted, None, setup) if wanted else {}, gyros=not accel_only)
    with tell.working("planning") as progress:
        found = plan(setup, positions=positions, aim=aim, table=TurnTable.of(axes, step), progress=progress)
    reasons = short_of(found.bound, aim, found.setup)
    tell.show(as_json, lambda: plan_data(found, reasons), lambda: plan_blocks(found, aim))
    tell.end(reasons)
