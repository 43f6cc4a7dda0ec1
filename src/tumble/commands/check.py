"""`tumble check`: whether a calibration still holds, from a few rests."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from tumble.commands.arguments import EXISTING_FOLDER, FILE, JSON, say, warn


@click.command()
@click.argument("calibration", type=FILE)
@click.argument("session", type=EXISTING_FOLDER)
@click.option("-o", "--out", type=FILE, help="Write the calibration, updated by the check, into this file.")
@click.option("--force", is_flag=True, help="Replace an existing file whatever it is.")
@JSON
def check(calibration: Path, session: Path, out: Path | None, force: bool, as_json: bool) -> None:
    """Test from a few rests of its device whether CALIBRATION still holds, or what has changed and by how much.

    SESSION has three to five rests in any attitude, and the turns between them.

    Exit status 0: it holds; 1: something has changed.
    """
    from tumble.calibration.check import check_calibration
    from tumble.terminal.data import field_check_data, print_data
    from tumble.terminal.field_check import field_check_report
    from tumble.terminal.text import print_report

    found = check_calibration(calibration, session)
    written = out is not None and found.result.explained
    if out is not None and written:
        found.updated().write(out, force=force)
    if as_json:
        print_data(field_check_data(found))
    else:
        print_report(field_check_report(found))
    for note in found.notes:
        say(f"note: {note}")
    for reason in found.reasons:
        warn(f"changed: {reason}")
    if written:
        say(f"written to {out}")
    sys.exit(0 if found.valid else 1)
