"""`tumble check`: whether a calibration still holds, from a few rests."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from tumble.commands import ask, tell

if TYPE_CHECKING:
    from tumble.run.type_spread import KnownLaunches


@click.command(epilog=ask.examples("tumble check imu-7/calibration.json today -o today.json"))
@click.argument("calibration", type=ask.FILE)
@click.argument("session", type=ask.PATH)
@ask.out("Write the calibration, updated by the check, into this file.")
@ask.force("Replace an existing file whatever it is.")
@ask.known_launches("Judge by how much the device changes from launch to launch, by its calibrations in a registry.")
@ask.JSON
def check(
    calibration: Path, session: Path, out: Path | None, force: bool, known_launches: str | None, as_json: bool
) -> None:
    """Test from a few rests of its device what has changed since CALIBRATION, and by how much.

    SESSION has three to five rests in any attitude, and the turns between them.

    Exit status 0: no change is shown; 1: something has changed.
    """
    from tumble.recording.session_file import read_session
    from tumble.registry.store.connect import extra_named
    from tumble.use.check import check_calibration
    from tumble.views.checks import field_check_blocks, field_check_data

    described = read_session(session)
    launches: tuple[KnownLaunches, ...] = ()
    if known_launches is not None:
        with extra_named():
            from tumble.registry.series import device_launches
            from tumble.registry.store.connect import open_registry

            with open_registry(known_launches) as opened:
                launches = device_launches(opened, described.device.serial)
    found = check_calibration(calibration, described, launches=launches)
    written = out is not None and found.result.explained
    if out is not None and written:
        found.updated().write(out, force=force)
    tell.show(as_json, lambda: field_check_data(found), lambda: field_check_blocks(found))
    for note in found.notes:
        tell.say(f"note: {note}")
    if written:
        tell.say(f"written to {out}")
    tell.end(found.reasons, "changed: ")
