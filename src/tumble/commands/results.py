"""Commands that take a calibration: `check`, `compare`, `apply`."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tumble.commands import console, params
from tumble.commands.recordings import is_log, session_folders
from tumble.errors import InputError

if TYPE_CHECKING:
    from tumble.result.launch_variances import LaunchVariances
    from tumble.use.stream import Event


@click.command(
    epilog=params.examples(
        "tumble check imu-7/calibration.json today",
        "tumble check imu-7/calibration.json positions.csv",
        "tumble check imu-7/calibration.json --listen serial:/dev/ttyUSB0:115200",
    )
)
@click.argument("calibration", type=params.FILE)
@click.argument("readings", type=params.PATH, required=False)
@params.option("--listen", "Check with a stream instead: file:LOG.csv, stdin, udp:PORT, serial:DEVICE:BAUD, …")
@params.option("--session", "Session that describes columns and units of the stream; default: SI.", type=params.PATH)
@params.registry("Registry with calibrations of the device, which show its changes from launch to launch.")
@params.JSON
def check(
    calibration: Path, readings: Path | None, listen: str | None, session: Path | None, registry: str | None
) -> None:
    """Test whether CALIBRATION still holds for its device, and what has changed.

    READINGS are a session or a log with three or more rests in any attitude, or a table of readings at rest. Each rest
    is compared with gravity, and the rests and turns of a session test every parameter. A session is made beside a log,
    as `tumble calibrate` does, with serial number and place of the calibration.

    A stream is checked rest by rest until it ends or is stopped with Ctrl-C. The file CALIBRATION is never changed.

    Exit status 0: no change is detected; 1: something has changed."""
    from tumble.documents import as_json
    from tumble.recording.session_file import read_session
    from tumble.run.readings_table import is_table
    from tumble.use.check import check_calibration
    from tumble.use.stream import check_stream
    from tumble.views.checks import MOST_SHOWN, check_blocks

    if (readings is None) == (listen is None):
        raise InputError("check: expected READINGS or --listen SOURCE, found both or none of them")
    if listen is None and session is not None:
        raise InputError("check: expected --session with --listen alone, found it with READINGS")
    if listen is not None and registry is not None:
        raise InputError("check: expected --registry with READINGS alone, found it with --listen")
    if listen is None:
        assert readings is not None
        launches: tuple[LaunchVariances, ...] = ()
        of_log = is_log(readings) and not is_table(readings)
        described = session_folders([readings], _serial_and_place(calibration)) if of_log else nullcontext([readings])
        with described as (checked,):
            if registry is not None:
                with params.opened(registry) as opened:
                    launches = opened.launches(read_session(checked).device.serial)
            found = check_calibration(calibration, checked, launches=launches)
    else:
        found = check_stream(calibration, listen, session=session, show=_show)
    if console.wants_json() and listen is not None:
        console.print_json({"event": "check", **as_json(found)})
    else:
        console.show(found, lambda: check_blocks(found, rests=listen is None))
    for note in found.notes:
        console.say(f"note: {note}")
    more = len(found.reasons) - MOST_SHOWN
    console.end([*found.reasons[:MOST_SHOWN], *([f"and {more} more"] if more > 0 else [])], "changed: ")


def _serial_and_place(calibration: Path) -> dict[str, Any]:
    """Return serial number and place of a calibration as options for a log."""
    from tumble.result.calibration import read_calibration
    from tumble.units import DEGREE

    made = read_calibration(calibration)
    site = made.provenance.site
    options = {"serial": made.serial, "latitude": None, "height": None, "accel": None, "gyro": None}
    if site is None or site.latitude is None:
        return options
    return options | {"latitude": site.latitude / DEGREE, "height": site.height}


def _show(event: Event) -> None:
    from tumble.documents import as_json
    from tumble.use.check import CheckedRest, change_text
    from tumble.views.checks import event_line

    """Print a rest or a notice of a stream, and the biases that have moved by a rest."""
    rest = event if isinstance(event, CheckedRest) else None
    if console.wants_json():
        console.print_json({"event": "notice" if rest is None else "rest", **as_json(event)})
    else:
        click.echo(event_line(event))
    for moved in () if rest is None or rest.judged is None else rest.judged.moved:
        console.warn(f"moved: {change_text(moved)}; since about {moved.since:.1f} s, rest {moved.rest + 1}")


@click.command(epilog=params.examples("tumble compare last-year.json imu-7/calibration.json"))
@click.argument("first", type=params.FILE)
@click.argument("second", type=params.FILE)
@params.JSON
def compare(first: Path, second: Path) -> None:
    """Differences of two calibration files in units of their combined uncertainty, and E_n numbers.

    Exit status 0: chance explains the largest |E_n| (probability 0.01 of all together) and χ² (0.001); 1: otherwise."""
    from tumble.use.compare import compare_calibrations
    from tumble.views.checks import comparison_blocks

    found = compare_calibrations(first, second)
    console.show(found, lambda: comparison_blocks(found))
    for remark in found.remarks:
        console.say(f"note: {remark}")
    if found.missing:
        console.say(f"note: only one of them has {', '.join(found.missing)}")
    console.end(found.reasons, "different: ")


@click.command(epilog=params.examples("tumble apply imu-7/calibration.json flight-12 -o corrected.parquet"))
@click.argument("calibration", type=params.FILE)
@click.argument("recording", metavar="SESSION|LOG", type=params.PATH)
@params.out("File to write: .csv or .parquet.", required=True)
@params.force()
def apply(calibration: Path, recording: Path, out: Path, force: bool) -> None:
    """Correct the recording of a session, or a log, with CALIBRATION, a calibration file of the same device.

    Corrected values are in SI under the session's column names, or in the unit that these names say; every other column
    is copied."""
    from tumble.recording.session_file import read_session
    from tumble.use.apply import apply_to_session, correction_notes

    options = _serial_and_place(calibration) if is_log(recording) else {}
    with session_folders([recording], options) if options else nullcontext([recording]) as (folder,):
        session = read_session(folder)
        apply_to_session(calibration, session, out, force=force)
        console.say(f"written to {out}")
        for sentence in correction_notes(calibration, session):
            console.say(sentence)
