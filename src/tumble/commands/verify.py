"""`tumble verify`: a calibration in check positions."""

from __future__ import annotations

from pathlib import Path

import click

from tumble.commands.arguments import EXISTING_FOLDER, FILE, JSON, end, show


@click.command()
@click.argument("calibration", type=FILE)
@click.argument("readings", metavar="SESSION|READINGS.csv", type=EXISTING_FOLDER)
@JSON
def verify(calibration: Path, readings: Path, as_json: bool) -> None:
    """Test whether CALIBRATION holds in check positions, by g − |corrected reading| in each of them.

    They are every rest of a session, or every row of a table of readings. Where these are the calibration's own,
    each is left out in turn.
    """
    from tumble.use.verify import verify_calibration
    from tumble.views.checks import verification_blocks, verification_data

    found = verify_calibration(calibration, readings)
    show(as_json, lambda: verification_data(found), lambda: verification_blocks(found))
    end(found.reasons, "not accepted: ")
