"""`tumble noise`: Allan deviations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from tumble.commands.arguments import EXISTING_FOLDER, FILE, JSON, say


@click.command()
@click.argument("recording", metavar="SESSION|LOG", type=EXISTING_FOLDER)
@click.option("--plot", type=FILE, help="Draw the Allan deviations into this .svg, .png or .pdf.")
@click.option("--accel", metavar="COLUMNS", help="LOG: columns of the accelerometers, with commas between them.")
@click.option("--accel-unit", default="m/s^2", show_default=True, help="LOG: their unit.")
@click.option("--gyro", metavar="COLUMNS", help="LOG: columns of the gyros.")
@click.option("--gyro-unit", default="rad/s", show_default=True, help="LOG: their unit.")
@click.option("--time", "time_column", metavar="COLUMN", help="LOG: column of the time, s.")
@click.option("--rate", type=float, metavar="HZ", help="LOG: samples per second, where there is no time column.")
@JSON
def noise(
    recording: Path,
    plot: Path | None,
    accel: str | None,
    accel_unit: str,
    gyro: str | None,
    gyro_unit: str,
    time_column: str | None,
    rate: float | None,
    as_json: bool,
) -> None:
    """Allan deviation: the noise of every sensor, from the longest rest of SESSION or from all of a LOG at rest.

    LOG is a .csv (.gz, .zst) or .parquet file; it needs --accel, and --time or --rate.
    """
    from tumble.calibration.quiet_samples import noise
    from tumble.report.allan_picture import plot as draw
    from tumble.terminal.data import noise_data, print_data
    from tumble.terminal.noise import noise_report
    from tumble.terminal.text import print_report

    layout: dict[str, Any] | None = None
    if accel is not None:
        layout = {"accel": {"columns": accel.split(","), "unit": accel_unit}}
        layout |= {"gyro": {"columns": gyro.split(","), "unit": gyro_unit}} if gyro else {}
        layout |= {"time": time_column} if time_column else {}
        layout |= {"rate_hz": rate} if rate is not None else {}
    found = noise(recording, layout)
    if plot is not None:
        draw(found.panels, plot)
        say(f"written to {plot}")
    if as_json:
        print_data(noise_data(found))
    else:
        print_report(noise_report(found.source, found.panels))
