"""`tumble noise`: Allan deviations."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import click

from tumble.commands.arguments import (
    EXISTING_FOLDER,
    FILE,
    JSON,
    column_options,
    columns_stated,
    say,
    with_progress,
)
from tumble.errors import InputError


@click.command()
@click.argument("recording", metavar="SESSION|LOG", type=EXISTING_FOLDER)
@click.option("--plot", type=FILE, help="Draw the Allan deviations into this .svg, .png or .pdf.")
@column_options
@click.option("--accel-unit", help="Of a LOG: unit of the accelerometers, as in session.toml.")
@click.option("--gyro-unit", help="Of a LOG: unit of the gyros.")
@click.option("--rate", type=float, metavar="HZ", help="Of a LOG: samples per second, instead of the times in it.")
@JSON
def noise(
    recording: Path,
    plot: Path | None,
    accel: str | None,
    gyro: str | None,
    time: str | None,
    accel_unit: str | None,
    gyro_unit: str | None,
    rate: float | None,
    as_json: bool,
) -> None:
    """Allan deviation: the noise of every sensor, from the longest rest of SESSION or from all of a LOG at rest.

    LOG is a log in any dialect: its columns, units and times are found as `tumble new` finds them, where no option says
    them.
    """
    from tumble.calibration.quiet_samples import is_session, noise
    from tumble.drafting.new_session import Given, new_session
    from tumble.views.noise import noise_blocks, noise_data
    from tumble.views.noise import plot as draw
    from tumble.views.render.data import print_data
    from tumble.views.render.terminal import print_blocks

    if is_session(recording):
        found = noise(recording)
    else:
        with TemporaryDirectory() as folder:
            given = Given(rate=rate, **columns_stated(accel, gyro, time))
            draft, _ = new_session(Path(folder) / "session", recording, given, progress=with_progress)
            if draft.rate_guessed:
                raise InputError(f"{recording}: expected a time column (--time) or the rate (--rate), found neither")
            layout = dict(draft.content["log"])
            for kind, unit in (("accel", accel_unit), ("gyro", gyro_unit)):
                if unit is not None:
                    layout[kind] = {"columns": layout.get(kind, {"columns": []})["columns"], "unit": unit}
            found = noise(recording, layout)
        for sentence in draft.said:
            say(sentence)
    if plot is not None:
        draw(found.panels, plot)
        say(f"written to {plot}")
    if as_json:
        print_data(noise_data(found))
    else:
        print_blocks(*noise_blocks(found.source, found.panels))
