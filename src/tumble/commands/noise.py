"""`tumble noise`: Allan deviations."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from tumble.commands import ask, tell
from tumble.errors import InputError


@click.command(
    epilog=ask.examples(
        "tumble noise imu-7", "tumble noise still.csv --accel ax,ay,az --gyro gx,gy,gz --sample-rate 100"
    )
)
@click.argument("recording", metavar="SESSION|LOG", type=ask.PATH)
@ask.option("--plot/picture", "Draw the Allan deviations into this .svg, .png or .pdf.", type=ask.FILE)
@ask.LOG
@ask.option("--accel-unit", "Of a LOG: unit of the accelerometers, as in session.toml.")
@ask.option("--gyro-unit", "Of a LOG: unit of the gyros.")
@ask.JSON
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
            given = ask.given_of(options)
            draft, _ = new_session(Path(folder) / "session", recording, given, progress=tell.with_progress)
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
            tell.say(sentence)
    if picture is not None:
        plot(found.panels, picture)
        tell.say(f"written to {picture}")
    tell.show(as_json, lambda: noise_data(found), lambda: noise_blocks(found.source, found.panels))
