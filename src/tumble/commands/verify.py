"""`tumble verify`: a calibration in check positions."""

from __future__ import annotations

from pathlib import Path

import click

from tumble.commands import ask, tell


@click.command(epilog=ask.examples("tumble verify imu-7/calibration.json check-session"))
@click.argument("calibration", type=ask.FILE)
@click.argument("readings", metavar="SESSION|READINGS.csv", type=ask.PATH)
@ask.JSON
def verify(calibration: Path, readings: Path, as_json: bool) -> None:
    """Test whether CALIBRATION holds in check positions, by g − |corrected reading| in each of them.

    They are every rest of a session, or every row of a table of readings. Where these are the calibration's own,
    each is left out in turn.
    """
    from tumble.use.verify import verify_calibration
    from tumble.views.checks import verification_blocks, verification_data

    found = verify_calibration(calibration, readings)
    tell.show(as_json, lambda: verification_data(found), lambda: verification_blocks(found))
    tell.end(found.reasons, "not accepted: ")
