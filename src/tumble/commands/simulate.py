"""`tumble simulate`: a session folder with known truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import click

from tumble.commands import ask, tell
from tumble.usual_setup import BY_HAND, ON_TABLE, PROGRAMME
from tumble.usual_setup import SAMPLE_RATE as USUAL_SAMPLE_RATE


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
