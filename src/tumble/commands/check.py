"""`tumble check`: whether a calibration still holds, from a few rests."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tumble.commands.arguments import EXISTING_FOLDER, FILE, JSON, say, warn

if TYPE_CHECKING:
    from tumble.calibration.type_spread import KnownLaunches


@click.command()
@click.argument("calibration", type=FILE)
@click.argument("session", type=EXISTING_FOLDER)
@click.option("-o", "--out", type=FILE, help="Write the calibration, updated by the check, into this file.")
@click.option("--force", is_flag=True, help="Replace an existing file whatever it is.")
@click.option(
    "--registry",
    "place",
    metavar="FILE|URL",
    help="Judge by how much the device changes from launch to launch in all its calibrations in this registry.",
)
@JSON
def check(calibration: Path, session: Path, out: Path | None, force: bool, place: str | None, as_json: bool) -> None:
    """Test from a few rests of its device what has changed since CALIBRATION, and by how much.

    SESSION has three to five rests in any attitude, and the turns between them.

    Exit status 0: no change is shown; 1: something has changed.
    """
    from tumble.calibration.check import check_calibration
    from tumble.recording.session_file import read_session
    from tumble.views.checks import field_check_blocks, field_check_data
    from tumble.views.render.data import print_data
    from tumble.views.render.terminal import print_blocks

    described = read_session(session)
    launches = () if place is None else _launches(place, described.device.serial)
    found = check_calibration(calibration, described, launches=launches)
    written = out is not None and found.result.explained
    if out is not None and written:
        found.updated().write(out, force=force)
    if as_json:
        print_data(field_check_data(found))
    else:
        print_blocks(*field_check_blocks(found))
    for note in found.notes:
        say(f"note: {note}")
    for reason in found.reasons:
        warn(f"changed: {reason}")
    if written:
        say(f"written to {out}")
    sys.exit(0 if found.valid else 1)


def _launches(place: str, serial: str) -> tuple[KnownLaunches, ...]:
    """The launches of a device in a registry."""
    from tumble.registry.store.connect import extra_named

    with extra_named():
        from tumble.registry.store.connect import open_registry
        from tumble.registry.type_launches import device_launches

        with open_registry(place) as opened:
            return device_launches(opened, serial)
