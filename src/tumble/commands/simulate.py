"""`tumble simulate`: a session folder with known truth."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from tumble import usual_setup
from tumble.commands.arguments import EXISTING_FOLDER, GRADE, TERMS, programme_option, say
from tumble.usual_setup import BY_HAND, ON_TABLE


@click.command()
@click.argument("folder", type=EXISTING_FOLDER)
@programme_option("Built-in programme to go through.", usual_setup.PROGRAMME)
@click.option("--positions", type=int, help="Hand-held instead: this many positions in any attitude.")
@GRADE
@click.option("--rest", type=float, help=f"Duration of a rest, s; default {ON_TABLE.rest:g}, by hand {BY_HAND.rest:g}.")
@click.option(
    "--turn-rate",
    type=float,
    help=f"Rate of the turns, °/s; default {ON_TABLE.rate_deg_s:g}, by hand {BY_HAND.rate_deg_s:g}.",
)
@click.option("--sample-rate", type=float, help=f"Samples per second; default {usual_setup.SAMPLE_RATE:g}.")
@click.option(
    "--table-error",
    type=float,
    default=usual_setup.TABLE_ERROR_DEG,
    show_default=True,
    help="Largest error of a position, °.",
)
@click.option(
    "--mounting-error",
    type=float,
    default=usual_setup.MOUNTING_ERROR_DEG,
    show_default=True,
    help="Largest error of the mounting, °.",
)
@click.option(
    "--latitude", type=float, default=usual_setup.LATITUDE_DEG, show_default=True, help="Latitude of the site, °."
)
@TERMS
@click.option("--noiseless", is_flag=True, help="No noise and no instability.")
@click.option("--vibration", metavar="AMPLITUDE@HZ", help="Vibration throughout, m/s² at Hz, e.g. 0.05@30.")
@click.option("--temperature", metavar="PROFILE", help="A thermometer, °C: 25, -10:60, -10:60:-10 or 22+15@600 (s).")
@click.option("--format", "log_format", type=click.Choice(["csv", "parquet"]), default="parquet", show_default=True)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Number of the device.")
@click.option("--launch", type=click.IntRange(min=0), default=1, show_default=True, help="Launch of that device.")
def simulate(
    folder: Path,
    programme: str,
    positions: int | None,
    grade: str,
    rest: float | None,
    turn_rate: float | None,
    sample_rate: float | None,
    table_error: float,
    mounting_error: float,
    latitude: float,
    terms: Literal["linear", "full"],
    noiseless: bool,
    vibration: str | None,
    temperature: str | None,
    log_format: Literal["csv", "parquet"],
    seed: int,
    launch: int,
) -> None:
    """Write a session with known truth (truth.json) into FOLDER."""
    from tumble.planning.setup import Setup
    from tumble.simulation.scenario import NO_VIBRATION
    from tumble.simulation.session import simulate_session, vibration_of
    from tumble.simulation.temperature_profile import temperature_profile

    setup = Setup.of(
        grade=grade,
        programme=programme,
        positions=positions,
        rest=rest,
        rate_deg_s=turn_rate,
        sample_rate=sample_rate,
        table_error_deg=table_error,
        mounting_error_deg=mounting_error,
        latitude_deg=latitude,
        noise_factor=0.0 if noiseless else 1.0,
        terms=terms,
    )
    shaken = vibration_of(vibration) if vibration else NO_VIBRATION
    profile = temperature_profile(temperature) if temperature else None
    written = simulate_session(
        folder, setup, seed=seed, launch=launch, vibration=shaken, temperature=profile, log_format=log_format
    )
    say(f"written to {written}")
