"""`tumble simulate`: a session folder with known truth."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from tumble.commands.arguments import EXISTING_FOLDER


@click.command()
@click.argument("folder", type=EXISTING_FOLDER)
@click.option("--programme", default="rough-table", show_default=True, help="Built-in programme to go through.")
@click.option("--positions", type=int, help="Hand-held instead: this many positions in any attitude.")
@click.option("--grade", default="navigation", show_default=True, help="navigation, tactical, mems or consumer.")
@click.option("--rest", type=float, help="Duration of a rest, s; default 60, by hand 5.")
@click.option("--rate", type=float, help="Rate of the turns, °/s; default 10, by hand 80.")
@click.option("--sample-rate", type=float, help="Samples per second; default 100.")
@click.option("--table-error", type=float, default=1.0, show_default=True, help="Largest error of a position, °.")
@click.option("--mounting-error", type=float, default=1.0, show_default=True, help="Largest error of the mounting, °.")
@click.option("--latitude", type=float, default=56.84, show_default=True, help="Latitude of the site, °.")
@click.option("--noiseless", is_flag=True, help="No noise and no instability.")
@click.option("--vibration", metavar="AMPLITUDE@HZ", help="Vibration throughout, m/s² at Hz, e.g. 0.05@30.")
@click.option("--format", "log_format", type=click.Choice(["csv", "parquet"]), default="parquet", show_default=True)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Number of the device.")
@click.option("--launch", type=click.IntRange(min=0), default=1, show_default=True, help="Launch of that device.")
def simulate(
    folder: Path,
    programme: str,
    positions: int | None,
    grade: str,
    rest: float | None,
    rate: float | None,
    sample_rate: float | None,
    table_error: float,
    mounting_error: float,
    latitude: float,
    noiseless: bool,
    vibration: str | None,
    log_format: Literal["csv", "parquet"],
    seed: int,
    launch: int,
) -> None:
    """Write a session with known truth (truth.json) into FOLDER."""
    from tumble.simulation.scenario import Vibration
    from tumble.simulation.session import Request, simulate_session, vibration_of

    request = Request(
        grade=grade,
        programme=programme,
        positions=positions,
        rest=rest,
        rate_deg_s=rate,
        sample_rate=sample_rate,
        table_error_deg=table_error,
        mounting_error_deg=mounting_error,
        latitude_deg=latitude,
        noiseless=noiseless,
        vibration=vibration_of(vibration) if vibration else Vibration(),
    )
    written = simulate_session(folder, request, seed=seed, launch=launch, log_format=log_format)
    click.echo(f"written to {written}", err=True)
