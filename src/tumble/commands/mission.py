"""`tumble mission`: what a calibration means for a vehicle."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from tumble.commands import ask, tell


@click.command(
    epilog=ask.examples(
        "tumble mission imu-7/calibration.json", "tumble mission imu-7/calibration.json --trajectory flight.csv --level"
    )
)
@click.argument("calibration", type=ask.FILE)
@ask.option("--trajectory", "standing, car, quadrotor, or a file: time, position, attitude.", "car")
@ask.grade(None, "; before calibration; default: the one nearest to the noise")
@ask.option("--warmer/temperature_change", "Sensors warmer than at the calibration by this, K.", 0.0, type=float)
@click.option("--level", "levelled", is_flag=True, help="The start is levelled by the accelerometers, else known.")
@ask.option("--latitude/latitude_deg", "Of the start, ° north; default: that of the calibration.", type=float)
@ask.option("--forward", "Axis of the body that points forward in the vehicle.", "x")
@ask.option("--up", "Axis that points up.", "z")
@ask.option("--plot/picture", "Draw heading and position into this .svg, .png or .pdf.", type=ask.FILE)
@ask.EVERY
@ask.JSON
def mission(calibration: Path, picture: Path | None, every: bool, as_json: bool, **options: Any) -> None:
    """What CALIBRATION, a calibration file, means for a vehicle: heading, tilt and position after 10, 60 and 600 s
    without aid, with what contributes, before and after calibration."""
    from tumble.use.mission import mission
    from tumble.views.mission import mission_blocks, mission_data, plot

    found = mission(calibration, **options)
    if picture is not None:
        plot(found, picture)
        tell.say(f"written to {picture}")
    tell.show(as_json, lambda: mission_data(found), lambda: mission_blocks(found, every=every))
