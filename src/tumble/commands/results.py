"""Commands that take a calibration: `verify`, `check`, `compare`, `apply`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from tumble.commands import ask, tell

if TYPE_CHECKING:
    from tumble.run.type_spread import KnownLaunches


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


@click.command(epilog=ask.examples("tumble compare last-year.json imu-7/calibration.json"))
@click.argument("first", type=ask.FILE)
@click.argument("second", type=ask.FILE)
@ask.option("--gyro-file", "SECOND is the file of the accelerometers of imu_tk: that of its gyros.", type=ask.FILE)
@ask.JSON
def compare(first: Path, second: Path, gyro_file: Path | None, as_json: bool) -> None:
    """Differences of two calibration files in units of their combined uncertainty, and E_n numbers.

    SECOND may also be a result of Kalibr (YAML, with scale and misalignment) or of imu_tk, for the same readings.

    Exit status 0: the largest |E_n| and χ² are within chance (probability 0.01 of so many, and 0.001); 1: otherwise.
    """
    from tumble.use.compare import compare_calibrations
    from tumble.views.checks import comparison_blocks, comparison_data

    found = compare_calibrations(first, second, gyro=gyro_file)
    tell.show(as_json, lambda: comparison_data(found), lambda: comparison_blocks(found))
    for remark in found.remarks:
        tell.say(f"note: {remark}")
    if found.missing:
        tell.say(f"note: only one of them has {', '.join(found.missing)}")
    tell.end(found.reasons, "different: ")


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
