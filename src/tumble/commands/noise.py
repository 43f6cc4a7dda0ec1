"""`tumble noise`: Allan deviations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from tumble.commands.arguments import (
    EXISTING_FOLDER,
    FILE,
    JSON,
    LOG_OPTIONS,
    given_of,
    option,
    say,
    show,
    with_progress,
)
from tumble.errors import InputError


@click.command()
@click.argument("recording", metavar="SESSION|LOG", type=EXISTING_FOLDER)
@option("--plot/picture", "Draw the Allan deviations into this .svg, .png or .pdf.", type=FILE)
@LOG_OPTIONS
@option("--accel-unit", "Of a LOG: unit of the accelerometers, as in session.toml.")
@option("--gyro-unit", "Of a LOG: unit of the gyros.")
@JSON
def noise(
    recording: Path,
    picture: Path | None,
    accel_unit: str | None,
    gyro_unit: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Allan deviation: the noise of every sensor, from the longest rest of SESSION or from all of a LOG at rest.

    LOG is a log in any dialect: its columns, units and times are found as `tumble new` finds them, where no option says
    them.
    """
    from tempfile import TemporaryDirectory

    from tumble.drafting.new_session import new_session
    from tumble.run.quiet_samples import is_session, noise
    from tumble.views.noise import noise_blocks, noise_data, plot

    if is_session(recording):
        found = noise(recording)
    else:
        with TemporaryDirectory() as folder:
            given = given_of(options)
            draft, _ = new_session(Path(folder) / "session", recording, given, progress=with_progress)
            if draft.rate_guessed:
                raise InputError(
                    f"{recording}: expected a time column (--time) or the rate (--sample-rate), found neither"
                )
            layout = dict(draft.content["log"])
            for kind, unit in (("accel", accel_unit), ("gyro", gyro_unit)):
                if unit is not None:
                    layout[kind] = {"columns": layout.get(kind, {"columns": []})["columns"], "unit": unit}
            found = noise(recording, layout)
        for sentence in draft.said:
            say(sentence)
    if picture is not None:
        plot(found.panels, picture)
        say(f"written to {picture}")
    show(as_json, lambda: noise_data(found), lambda: noise_blocks(found.source, found.panels))
