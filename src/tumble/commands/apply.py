"""`tumble apply`: a recording corrected with a calibration."""

from __future__ import annotations

from pathlib import Path

import click

from tumble.commands import ask, tell


@click.command(epilog=ask.examples("tumble apply imu-7/calibration.json flight-12 -o corrected.parquet"))
@click.argument("calibration", type=ask.FILE)
@click.argument("session", type=ask.PATH)
@ask.out("File to write: .csv or .parquet.", required=True)
@ask.force()
@click.option("--verify", is_flag=True, help="Print the residuals |f| − g of the rests before and after.")
def apply(calibration: Path, session: Path, out: Path, force: bool, verify: bool) -> None:
    """Correct the recording of SESSION with CALIBRATION, a calibration file of the same device.

    Corrected values are in SI under the session's column names, or in the unit that these names say; every other column
    is copied.
    """
    from tumble.recording.session_file import read_session
    from tumble.use.apply import applied, apply_to_session, rest_residuals
    from tumble.views.checks import residual_table
    from tumble.views.render.terminal import print_blocks

    described = read_session(session)
    described.check_new(out, force=force)
    residuals = rest_residuals(calibration, described) if verify else ()
    apply_to_session(calibration, described, out, force=force)
    tell.say(f"written to {out}")
    for sentence in applied(calibration, described):
        tell.say(sentence)
    if verify:
        print_blocks(residual_table(residuals))
