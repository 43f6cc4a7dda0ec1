"""Commands before anything is recorded: `example`, `programme`, `plan`, `simulate`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tumble.commands import console, params
from tumble.errors import InputError
from tumble.usual_setup import BY_HAND, HEIGHT, LATITUDE_DEG, ON_TABLE, PROGRAMME
from tumble.usual_setup import SAMPLE_RATE as USUAL_SAMPLE_RATE

if TYPE_CHECKING:
    from tumble.planning.plan import PlannedMethod
    from tumble.sensors.parameters import Terms
    from tumble.simulation.session import LogFormat


@click.command(epilog=params.examples("tumble programme cube-26 -o sheet.html"))
@click.argument("name", metavar="[NAME]", required=False, shell_complete=params.programmes_like)
@params.option("--attitude/attitudes", "Attitude code of a position, instead of NAME; repeat.", multiple=True)
@params.PACE
@params.out("Write the sheet with a picture of each position: .html, .pdf or .svg.")
@params.option("--serial", "Serial number of the device; default: a blank line.")
@params.option("--number", "Number of the sheet; default: a blank line.")
@params.option("--revision", "Revision of the sheet; default: a blank line.")
def programme(
    name: str | None, attitudes: tuple[str, ...], rest: float, turn_rate: float, out: Path | None, **sheet: str | None
) -> None:
    """The operator's sheet of a built-in programme NAME or of a list of attitudes."""
    from tumble.programme.positions import programme_of, programmes
    from tumble.units import DEGREE
    from tumble.views.render.terminal import print_blocks
    from tumble.views.sheet import sheet_blocks, write_sheet

    if (name is None) == (not attitudes):
        raise InputError(
            f"expected either the NAME of a programme ({', '.join(programmes())}) or --attitude for each position"
        )
    listed = programme_of(attitudes if name is None else name)
    blocks = sheet_blocks(listed, rest=rest, rate=turn_rate * DEGREE)
    if out is not None:
        words: dict[str, Any] = {key: value or "" for key, value in sheet.items()}
        write_sheet(out, listed, rest=rest, rate=turn_rate * DEGREE, **words)
        console.say(f"written to {out}")
    print_blocks(*blocks)


@click.command(
    epilog=params.examples(
        "tumble plan nine --grade mems", "tumble plan --want accel.scale=6ppm", "tumble plan --pivot 120s --grade mems"
    )
)
@click.argument("programme", default=PROGRAMME, shell_complete=params.programmes_like)
@params.option("--attitude/attitudes", "Attitude code of a position, instead of PROGRAMME; repeat.", multiple=True)
@params.method(
    ["joint", "sequential", "scalar"], "joint", "Joint: what `calibrate` will state; the others: formulas of the paper."
)
@params.terms("full")
@params.option("--iterations", "Number of passes of sequential and scalar.", 2, type=click.IntRange(1, 5))
@params.SETUP
@params.WANT
@click.option("--sources", is_flag=True, help="Show u by source.")
@click.option("--accel-only", is_flag=True, help="Plan for accelerometers only, without gyros and turns.")
@params.option("--pivot", "Duration of motion on a tripod head or ball joint, instead of PROGRAMME.", metavar="SECONDS")
@params.option("--hand", "Duration of motion in the hand, instead of PROGRAMME.", metavar="SECONDS")
@params.JSON
def plan(
    programme: str,
    attitudes: tuple[str, ...],
    method: PlannedMethod,
    terms: Terms,
    iterations: int,
    wanted: tuple[str, ...],
    sources: bool,
    accel_only: bool,
    pivot: str | None,
    hand: str | None,
    **options: Any,
) -> None:
    """The u that a calibration by PROGRAMME will state, the best next positions, and what a wanted accuracy needs."""
    from tumble.planning.itinerary import motion_of
    from tumble.planning.plan import plan
    from tumble.planning.setup import wanted_accuracies
    from tumble.programme.positions import from_attitudes
    from tumble.views.planning import plan_blocks

    setup = params.setup_of(options | {"programme": programme})
    if attitudes:
        setup = replace(setup, programme=from_attitudes(attitudes))
    accuracies = wanted_accuracies(wanted)
    with console.working("planning") as progress:
        found = plan(
            setup,
            method=method,
            terms=terms,
            iterations=iterations,
            wanted=accuracies,
            gyros=not accel_only,
            motion=motion_of(pivot, hand),
            progress=progress,
        )
    console.show(found, lambda: plan_blocks(found, sources=sources))
    for remark in found.remarks:
        console.say(f"note: {remark}")
    console.end(found.reasons)


@click.command(epilog=params.examples("tumble simulate launch --programme rough-table --seed 1"))
@click.argument("folder", type=params.PATH)
@params.programme("Built-in programme of the session.", PROGRAMME)
@params.option("--positions", "Number of positions by hand, in any attitude, instead of a programme.", type=int)
@params.grade()
@params.option("--rest", f"Duration of a rest, s; default {ON_TABLE.rest:g}, by hand {BY_HAND.rest:g}.", type=float)
@params.option(
    "--turn-rate",
    f"Rate of the turns, °/s; default {ON_TABLE.rate_deg_s:g}, by hand {BY_HAND.rate_deg_s:g}.",
    type=float,
)
@params.option(params.SAMPLE_RATE[0], f"{params.SAMPLE_RATE[1]}; default {USUAL_SAMPLE_RATE:g}.", type=float)
@params.TABLE_ERROR
@params.MOUNTING_ERROR
@params.SITE_LATITUDE
@params.terms("linear")
@params.NOISELESS
@params.option("--vibration", "Vibration throughout, m/s² at Hz, e.g. 0.05@30.", metavar="AMPLITUDE@HZ")
@params.option("--temperature", "Temperature, °C: 25, -10:60, -10:60:-10 or 22+15@600 (s).", metavar="PROFILE")
@params.option("--format/log_format", "Format of the log.", "parquet", type=click.Choice(["csv", "parquet", "counts"]))
@params.option("--seed", "Number of the device.", 0, type=click.IntRange(min=0))
@params.option("--launch", "Number of the launch of that device.", 1, type=click.IntRange(min=0))
def simulate(
    folder: Path,
    vibration: str | None,
    temperature: str | None,
    log_format: LogFormat,
    seed: int,
    launch: int,
    **options: Any,
) -> None:
    """Write a session with known truth (truth.json) into FOLDER."""
    from tumble.simulation.scenario import NO_VIBRATION
    from tumble.simulation.session import simulate_session, vibration_of
    from tumble.simulation.temperature_profile import temperature_profile

    setup = params.setup_of(options)
    shaken = vibration_of(vibration) if vibration else NO_VIBRATION
    profile = temperature_profile(temperature) if temperature else None
    written = simulate_session(
        folder, setup, seed=seed, launch=launch, vibration=shaken, temperature=profile, log_format=log_format
    )
    console.say(f"written to {written}")


@click.command(epilog=params.examples("tumble example first"))
@click.argument("folder", type=params.PATH)
def example(folder: Path) -> None:
    """Write an example into FOLDER: a log in counts as a cheap logger writes it, and truth.json with its true values.

    The log is always the same: a simulated MEMS device that was put down by hand in 30 positions."""
    from tumble.planning.setup import Setup
    from tumble.simulation.session import simulate_session

    setup = Setup.of(grade="mems", positions=30, sample_rate=100.0, terms="full")
    simulate_session(folder, setup, seed=7, log_format="counts")
    log = folder / "log.csv"
    console.say(f"written to {log} and {folder / 'truth.json'}")
    console.say(f"next: tumble calibrate {log} --latitude {LATITUDE_DEG:g} --height {HEIGHT:g}")
