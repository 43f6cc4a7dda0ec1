"""`tumble simulate`: a session folder with known truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import click

from tumble.commands.arguments import (
    EXISTING_FOLDER,
    MOUNTING_ERROR,
    NOISELESS,
    SAMPLE_RATE,
    SITE_LATITUDE,
    TABLE_ERROR,
    grade_option,
    option,
    programme_option,
    say,
    setup_of,
    terms_option,
)
from tumble.usual_setup import BY_HAND, ON_TABLE, PROGRAMME
from tumble.usual_setup import SAMPLE_RATE as USUAL_SAMPLE_RATE


@click.command()
@click.argument("folder", type=EXISTING_FOLDER)
@programme_option("Built-in programme to go through.", PROGRAMME)
@option("--positions", "Hand-held instead: this many positions in any attitude.", type=int)
@grade_option()
@option("--rest", f"Duration of a rest, s; default {ON_TABLE.rest:g}, by hand {BY_HAND.rest:g}.", type=float)
@option(
    "--turn-rate",
    f"Rate of the turns, °/s; default {ON_TABLE.rate_deg_s:g}, by hand {BY_HAND.rate_deg_s:g}.",
    type=float,
)
@option(SAMPLE_RATE[0], f"{SAMPLE_RATE[1]}; default {USUAL_SAMPLE_RATE:g}.", type=float)
@TABLE_ERROR
@MOUNTING_ERROR
@SITE_LATITUDE
@terms_option()
@NOISELESS
@option("--vibration", "Vibration throughout, m/s² at Hz, e.g. 0.05@30.", metavar="AMPLITUDE@HZ")
@option("--temperature", "A thermometer, °C: 25, -10:60, -10:60:-10 or 22+15@600 (s).", metavar="PROFILE")
@option("--format/log_format", "Of the log.", "parquet", type=click.Choice(["csv", "parquet"]))
@option("--seed", "Number of the device.", 0, type=click.IntRange(min=0))
@option("--launch", "Launch of that device.", 1, type=click.IntRange(min=0))
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

    setup = setup_of(options)
    shaken = vibration_of(vibration) if vibration else NO_VIBRATION
    profile = temperature_profile(temperature) if temperature else None
    written = simulate_session(
        folder, setup, seed=seed, launch=launch, vibration=shaken, temperature=profile, log_format=log_format
    )
    say(f"written to {written}")
