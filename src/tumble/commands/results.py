"""Commands that take a calibration: `verify`, `check`, `watch`, `compare`, `apply`, `mission`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tumble.commands import ask, tell

if TYPE_CHECKING:
    from tumble.lab.type_spread import KnownLaunches


@click.command(epilog=ask.examples("tumble verify imu-7/calibration.json check-session"))
@click.argument("calibration", type=ask.FILE)
@click.argument("readings", metavar="SESSION|READINGS.csv", type=ask.PATH)
@ask.JSON
def verify(calibration: Path, readings: Path) -> None:
    """Test whether CALIBRATION holds in check positions, by g − |corrected reading| in each of them.

    They are every rest of a session, or every row of a table of readings. Where these are the calibration's own,
    each is left out in turn.
    """
    from tumble.use.verify import verify_calibration
    from tumble.views.checks import verification_blocks, verification_data

    found = verify_calibration(calibration, readings)
    tell.show(lambda: verification_data(found), lambda: verification_blocks(found))
    tell.end(found.reasons, "not accepted: ")


@click.command(epilog=ask.examples("tumble check imu-7/calibration.json today -o today.json"))
@click.argument("calibration", type=ask.FILE)
@click.argument("session", type=ask.PATH)
@ask.out("Write the calibration, updated by the check, into this file.")
@ask.force("Replace an existing file whatever it is.")
@ask.known_launches("Judge by how much the device changes from launch to launch, by its calibrations in a registry.")
@ask.JSON
def check(calibration: Path, session: Path, out: Path | None, force: bool, known_launches: str | None) -> None:
    """Test from a few rests of its device what has changed since CALIBRATION, and by how much.

    SESSION has three to five rests in any attitude, and the turns between them.

    Exit status 0: no change is shown; 1: something has changed.
    """
    from tumble.recording.session_file import read_session
    from tumble.use.check import check_calibration
    from tumble.views.checks import field_check_blocks, field_check_data

    described = read_session(session)
    launches: tuple[KnownLaunches, ...] = ()
    if known_launches is not None:
        with ask.opened(known_launches) as opened:
            from tumble.lab.registry.series import device_launches

            launches = device_launches(opened, described.device.serial)
    found = check_calibration(calibration, described, launches=launches)
    written = out is not None and found.result.explained
    if out is not None and written:
        found.updated().write(out, force=force)
    tell.show(lambda: field_check_data(found), lambda: field_check_blocks(found))
    for note in found.notes:
        tell.say(f"note: {note}")
    if written:
        tell.say(f"written to {out}")
    tell.end(found.reasons, "changed: ")


@click.command(
    epilog=ask.examples(
        "tumble watch imu-7/calibration.json flight-12",
        "tumble watch imu-7/calibration.json serial:/dev/ttyUSB0:115200 --json",
    )
)
@click.argument("calibration", type=ask.FILE)
@click.argument("source")
@ask.option("--session", "Its [log] says the columns and units of a SOURCE that does not send SI.", type=ask.PATH)
@ask.JSON
def watch(calibration: Path, source: str, session: Path | None) -> None:
    """Test CALIBRATION by every rest of a flight or a day, as the readings of SOURCE come.

    SOURCE is a recorded session, or file:LOG.csv, which grows, stdin, udp:PORT, tcp:PORT, serial:DEVICE:BAUD or
    mavlink:udp:PORT, until it ends or is stopped with Ctrl-C. A line for every rest; a bias that has moved is said.
    The calibration is never changed.

    Exit status 0: no change is shown; 1: something has changed.
    """
    from tumble.recording.session_file import read_session
    from tumble.result.calibration import read_calibration
    from tumble.use.listening import opened
    from tumble.use.watch import Event, WatchedRest
    from tumble.views.checks import field_check_blocks, field_check_data, moved_line, watch_data, watch_line
    from tumble.views.render.data import print_line
    from tumble.views.render.terminal import print_blocks

    def show(events: list[Event]) -> None:
        for event in events:
            if tell.as_json():
                print_line(watch_data(event))
            else:
                click.echo(watch_line(event))
            for moved in event.moved if isinstance(event, WatchedRest) else ():
                tell.warn(f"moved: {moved_line(moved)}")

    described = None if session is None else read_session(session)
    watching, chunks = opened(source, read_calibration(calibration), described)
    try:
        for chunk in chunks:
            show(watching.feed(chunk))
    except KeyboardInterrupt:
        tell.say("stopped")
    show(watching.finish())
    found = watching.check()
    if tell.as_json():
        print_line({"event": "check", **field_check_data(found)})
    else:
        print_blocks(*field_check_blocks(found))
    for note in found.notes:
        tell.say(f"note: {note}")
    tell.end(found.reasons, "changed: ")


@click.command(epilog=ask.examples("tumble compare last-year.json imu-7/calibration.json"))
@click.argument("first", type=ask.FILE)
@click.argument("second", type=ask.FILE)
@ask.option("--gyro-file", "SECOND is the file of the accelerometers of imu_tk: that of its gyros.", type=ask.FILE)
@ask.JSON
def compare(first: Path, second: Path, gyro_file: Path | None) -> None:
    """Differences of two calibration files in units of their combined uncertainty, and E_n numbers.

    SECOND may also be a result of Kalibr (YAML, with scale and misalignment) or of imu_tk, for the same readings.

    Exit status 0: the largest |E_n| and χ² are within chance (probability 0.01 of so many, and 0.001); 1: otherwise.
    """
    from tumble.use.compare import compare_calibrations
    from tumble.views.checks import comparison_blocks, comparison_data

    found = compare_calibrations(first, second, gyro=gyro_file)
    tell.show(lambda: comparison_data(found), lambda: comparison_blocks(found))
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
def mission(calibration: Path, picture: Path | None, every: bool, **options: Any) -> None:
    """What CALIBRATION, a calibration file, means for a vehicle: heading, tilt and position after 10, 60 and 600 s
    without aid, with what contributes, before and after calibration."""
    from tumble.use.mission import mission
    from tumble.views.mission import mission_blocks, mission_data, plot

    found = mission(calibration, **options)
    if picture is not None:
        plot(found, picture)
        tell.say(f"written to {picture}")
    tell.show(lambda: mission_data(found), lambda: mission_blocks(found, every=every))
