"""`tumble watch`: a calibration tested by every rest of a flight or a day."""

from __future__ import annotations

from pathlib import Path

import click

from tumble.commands import ask, tell


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
def watch(calibration: Path, source: str, session: Path | None, as_json: bool) -> None:
    """Test CALIBRATION by every rest of a flight or a day, as the readings of SOURCE come.

    SOURCE is a recorded session, or file:LOG.csv, which grows, stdin, udp:PORT, tcp:PORT, serial:DEVICE:BAUD or
    mavlink:udp:PORT, until it ends or is stopped with Ctrl-C. A line for every rest; a bias that has moved is said.
    The calibration is never changed.

    Exit status 0: no change is shown; 1: something has changed.
    """
    from tumble.bench.watching import opened
    from tumble.recording.session_file import read_session
    from tumble.result.calibration import read_calibration
    from tumble.use.watch import Event, WatchedRest
    from tumble.views.checks import field_check_blocks, field_check_data, moved_line, watch_data, watch_line
    from tumble.views.render.data import print_line
    from tumble.views.render.terminal import print_blocks

    def show(events: list[Event]) -> None:
        for event in events:
            if as_json:
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
    if as_json:
        print_line({"event": "check", **field_check_data(found)})
    else:
        print_blocks(*field_check_blocks(found))
    for note in found.notes:
        tell.say(f"note: {note}")
    tell.end(found.reasons, "changed: ")
