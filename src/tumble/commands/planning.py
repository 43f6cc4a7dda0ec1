"""Commands before anything is recorded: `programme`, `plan`, `budget`, `require`, `simulate`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from tumble.commands import ask, tell
from tumble.errors import InputError
from tumble.usual_setup import BY_HAND, ON_TABLE, PROGRAMME
from tumble.usual_setup import SAMPLE_RATE as USUAL_SAMPLE_RATE

if TYPE_CHECKING:
    from tumble.planning.best_positions import Letter
    from tumble.planning.budget import PlannedMethod
    from tumble.planning.requirements import BiasEstimator


@click.command(epilog=ask.examples("tumble programme cube-26 -o sheet.html"))
@click.argument("name", metavar="[NAME]", required=False, shell_complete=ask.programmes_like)
@ask.option("--attitude/attitudes", "Instead of NAME: a position's attitude code; repeat.", multiple=True)
@ask.PACE
@ask.out("Write the sheet with a picture of each position: .html, .pdf or .svg.")
@ask.option("--serial", "Of the device, on the sheet; default: a line for it.")
@ask.option("--number", "Of the sheet, likewise.")
@ask.option("--revision", "Of the sheet, likewise.")
def programme(
    name: str | None, attitudes: tuple[str, ...], rest: float, turn_rate: float, out: Path | None, **sheet: str | None
) -> None:
    """The operator's sheet of a built-in programme NAME or of a list of attitudes."""
    from tumble.programme.positions import programme_of
    from tumble.units import DEGREE
    from tumble.views.render.terminal import print_blocks
    from tumble.views.sheet import sheet_blocks, write_sheet

    if (name is None) == (not attitudes):
        raise InputError("expected either the NAME of a programme or --attitude for each position")
    listed = programme_of(attitudes if name is None else name)
    blocks = sheet_blocks(listed, rest=rest, rate=turn_rate * DEGREE)
    if out is not None:
        words: dict[str, Any] = {key: value or "" for key, value in sheet.items()}
        write_sheet(out, listed, rest=rest, rate=turn_rate * DEGREE, **words)
        tell.say(f"written to {out}")
    print_blocks(*blocks)


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
@ask.option(
    "--registry/type_registry", "With --model: its other units here are a prior, not the grade.", metavar="FILE|URL"
)
@ask.option("--model", "Type of the device in the registry.", metavar="MODEL")
def plan(
    attitudes: tuple[str, ...],
    accel_only: bool,
    positions: int | None,
    criterion: Letter,
    wanted: tuple[str, ...],
    axes: str | None,
    step: float,
    recordings: str | None,
    time_constant: float,
    chamber_rate: float,
    type_registry: str | None,
    model: str | None,
    **options: Any,
) -> None:
    """The least uncertainty a programme allows, the best next position, and better programmes; over temperature with
    the time in a chamber."""
    from tumble.programme.positions import from_attitudes

    setup = ask.setup_of(options)
    if (type_registry is None) != (model is None):
        raise click.UsageError("--registry: expected with --model and --model with it, found one of them")
    if model is not None and recordings is not None:
        raise click.UsageError("--model: expected none with --over-temperature, found one")
    prior = None
    if type_registry is not None and model is not None:
        with ask.opened(type_registry) as opened:
            prior = opened.prior(model)
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
        tell.show(lambda: thermal_plan_data(thermal, reasons), lambda: thermal_plan_blocks(thermal))
        for note in () if tell.as_json() else thermal.notes:
            tell.say(f"note: {note}")
        tell.end(reasons)
    from tumble.planning.best_positions import Aim, plan
    from tumble.planning.reachable_attitudes import TurnTable
    from tumble.planning.requirements import wanted_of
    from tumble.views.planning import plan_blocks, plan_data, short_of

    aim = Aim(letter=criterion, wanted=wanted_of(wanted, None, setup) if wanted else {}, gyros=not accel_only)
    with tell.working("planning") as progress:
        turns = TurnTable.of(axes, step)
        found = plan(setup, positions=positions, aim=aim, table=turns, progress=progress, prior=prior)
    reasons = short_of(found.bound, aim, found.setup)
    tell.show(lambda: plan_data(found, reasons), lambda: plan_blocks(found, aim))
    if prior is not None:
        tell.say(f"note: with all groups, by {prior.words} as a prior")
    tell.end(reasons)


@click.command(epilog=ask.examples("tumble budget --grade mems --table-error 0.5 --rest 10"))
@ask.setup(None)
@ask.method(["joint", *ask.BUDGETED_METHODS], None, "Repeat; default: joint, of the linear model all.", multiple=True)
@ask.option("--iterations", "Passes of the methods.", 2, type=click.IntRange(1, 5))
@ask.JSON
def budget(method: tuple[PlannedMethod, ...], iterations: int, **options: Any) -> None:
    """Expected errors of a calibration before it is made, what they are from, and the least possible."""
    from tumble.planning.bounds import bound
    from tumble.planning.budget import budget
    from tumble.views.planning import budget_data, budget_table

    methods = method
    if not methods:
        linear = options["noiseless"] or options["terms"] == "linear"
        methods = tuple(ask.BUDGETED_METHODS) if linear else ()
        methods = methods if options["noiseless"] else ("joint", *methods)
    options["terms"] = options["terms"] or ("full" if methods == ("joint",) else "linear")
    setup = ask.setup_of(options)
    with tell.working("planning"):
        expected = budget(setup, methods=methods, iterations=iterations)
        least = None if options["noiseless"] else bound(setup)
    tell.show(lambda: budget_data(expected, least), lambda: [budget_table(expected, least)])
    for remark in expected.remarks:
        tell.say(f"note: {remark}")


@click.command(epilog=ask.examples("tumble require --want accel.scale=3.5ppm"))
@ask.setup(None)
@ask.WANT
@ask.option("--relative", "Wanted of every group: part of its spread, %.", type=float, metavar="PERCENT")
@ask.method(["joint", *ask.BUDGETED_METHODS], "joint", "To use; the others are of the linear model.")
@ask.option("--iterations", "Passes of the method.", 1, type=click.IntRange(1, 5))
@ask.option(
    "--gyro-bias",
    "From all rests, or from one with the axis vertical or along the Earth's axis.",
    "programme",
    type=click.Choice(["programme", "vertical", "polar"]),
)
@ask.JSON
def require(
    wanted: tuple[str, ...],
    relative: float | None,
    method: PlannedMethod,
    iterations: int,
    gyro_bias: BiasEstimator,
    **options: Any,
) -> None:
    """The table, the mounting and the rests that a wanted accuracy needs; what no table can give is named."""
    from tumble.planning.requirements import require, wanted_of
    from tumble.views.planning import requirement_blocks, requirements_data

    options["terms"] = options["terms"] or ("full" if method == "joint" else "linear")
    setup = ask.setup_of(options)
    asked = wanted_of(wanted, relative, setup)
    with tell.working("planning"):
        needs = require(asked, setup, method=method, iteration=iterations, gyro_bias=gyro_bias)
    tell.show(lambda: requirements_data(needs), lambda: requirement_blocks(needs))
    tell.end([] if needs.feasible else ["not feasible: no table gives everything that is wanted; see what is limited"])


@click.command(epilog=ask.examples("tumble simulate launch --programme rough-table --seed 1"))
@click.argument("folder", type=ask.PATH)
@ask.programme("Built-in programme to go through.", PROGRAMME)
@ask.option("--positions", "Hand-held instead: this many positions in any attitude.", type=int)
@ask.grade()
@ask.option("--rest", f"Duration of a rest, s; default {ON_TABLE.rest:g}, by hand {BY_HAND.rest:g}.", type=float)
@ask.option(
    "--turn-rate",
    f"Rate of the turns, °/s; default {ON_TABLE.rate_deg_s:g}, by hand {BY_HAND.rate_deg_s:g}.",
    type=float,
)
@ask.option(ask.SAMPLE_RATE[0], f"{ask.SAMPLE_RATE[1]}; default {USUAL_SAMPLE_RATE:g}.", type=float)
@ask.TABLE_ERROR
@ask.MOUNTING_ERROR
@ask.SITE_LATITUDE
@ask.terms()
@ask.NOISELESS
@ask.option("--vibration", "Vibration throughout, m/s² at Hz, e.g. 0.05@30.", metavar="AMPLITUDE@HZ")
@ask.option("--temperature", "A thermometer, °C: 25, -10:60, -10:60:-10 or 22+15@600 (s).", metavar="PROFILE")
@ask.option("--format/log_format", "Of the log.", "parquet", type=click.Choice(["csv", "parquet"]))
@ask.option("--seed", "Number of the device.", 0, type=click.IntRange(min=0))
@ask.option("--launch", "Launch of that device.", 1, type=click.IntRange(min=0))
def simulate(
    folder: Path,
    vibration: str | None,
    temperature: str | None,
    log_format: Literal["csv", "parquet"],
    seed: int,
    launch: int,
    **options: Any,
) -> None:
    """Write a session with known truth (truth.json) into FOLDER."""
    from tumble.simulation.scenario import NO_VIBRATION
    from tumble.simulation.session import simulate_session, vibration_of
    from tumble.simulation.temperature_profile import temperature_profile

    setup = ask.setup_of(options)
    shaken = vibration_of(vibration) if vibration else NO_VIBRATION
    profile = temperature_profile(temperature) if temperature else None
    written = simulate_session(
        folder, setup, seed=seed, launch=launch, vibration=shaken, temperature=profile, log_format=log_format
    )
    tell.say(f"written to {written}")
