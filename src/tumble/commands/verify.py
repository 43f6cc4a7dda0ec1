"""`tumble verify`: a calibration in check positions."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from tumble.commands.arguments import EXISTING_FOLDER, FILE, JSON, warn


@click.command()
@click.argument("calibration", type=FILE)
@click.argument("readings", metavar="SESSION|READINGS.csv", type=EXISTING_FOLDER)
@JSON
def verify(calibration: Path, readings: Path, as_json: bool) -> None:
    """Test whether CALIBRATION holds in check positions, by g − |corrected reading| in each of them.

    They are every rest of a session, or every row of a table of readings. Where these are the calibration's own,
    each is left out in turn.
    """
    from tumble.calibration.verify import verify_calibration
    from tumble.views.checks import verification_blocks, verification_data
    from tumble.views.render.data import print_data
    from tumble.views.render.terminal import print_blocks

    verification = verify_calibration(calibration, readings)
    if as_json:
        print_data(verification_data(verification))
    else:
        print_blocks(*verification_blocks(verification))
    for reason in verification.reasons:
        warn(f"not accepted: {reason}")
    sys.exit(1 if verification.reasons else 0)
