"""Commands that write what is passed on and kept: `report`, `export`, `upload`, `selftest`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from tumble.commands import ask, tell
from tumble.errors import InputError
from tumble.export import FORMATS

_IDS = ask.Numbers("the numbers in CAL_ACC0_ID and CAL_GYRO0_ID with a comma between", int, count=2)
_RANGE = ask.Numbers("g and deg/s with a comma between", count=2)
_COUNTS = ask.Numbers("counts a g and a deg/s with a comma between", count=2, above=0.0)


@click.command(epilog=ask.examples("tumble report imu-7/calibration.json -o imu-7.pdf --limits limits.toml"))
@click.argument("calibrations", metavar="CALIBRATION...", type=ask.FILE, nargs=-1, required=True)
@ask.out("File to write: .html, or .pdf for the archive.", required=True)
@ask.option("--limits", "Acceptance limits (TOML): judge every parameter by them.", type=ask.FILE)
@ask.CERTIFICATE
def report(calibrations: tuple[Path, ...], out: Path, limits: Path | None, certificate: Path | None) -> None:
    """Report of a calibration, or of several of one device, in one file that needs nothing else."""
    from tumble.views.report.write import write_report

    reasons = write_report(calibrations, out, limits=limits, certificate=certificate)
    tell.say(f"written to {out}")
    tell.end(reasons, "not accepted: ")


@click.command(epilog=ask.examples("tumble export imu-7/calibration.json --to px4 -o imu-7.params"))
@click.argument("calibration", type=ask.FILE)
@ask.option("--to", "What to write.", type=click.Choice(list(FORMATS)), required=True)
@ask.out("File to write.", required=True)
@ask.option("--noise", "kalibr: noise from this session's longest rest.", metavar="SESSION", type=ask.PATH)
@ask.CERTIFICATE
@ask.option("--imu", "px4, ardupilot, also thermal: of the N-th IMU, from 1.", metavar="N", type=int)
@ask.option(
    "--sensor-ids", "px4-thermal: the numbers in CAL_ACC0_ID and CAL_GYRO0_ID.", metavar="ACCEL,GYRO", type=_IDS
)
@ask.option(
    "--full-scale", "firmware: range in fixed point, g and °/s.  [default: 16,2000]", metavar="ACCEL,GYRO", type=_RANGE
)
@ask.option(
    "--counts",
    "iNav, Betaflight, …: counts a g and a °/s; default: the recording's.",
    metavar="ACCEL,GYRO",
    type=_COUNTS,
)
@ask.force()
def export(calibration: Path, to: str, out: Path, force: bool, **given: Any) -> None:
    """Write CALIBRATION, a calibration file, in the format of another program.

    What that format has no place for is said on standard error, and in the file where it has comments.
    """
    from tumble.export import export_calibration
    from tumble.files import whole_file

    if out.exists() and not force:
        raise InputError(f"{out}: expected a new file, found one that exists; give --force to replace it")
    exported = export_calibration(calibration, to, **given)
    with whole_file(out) as temporary:
        temporary.write_bytes(exported.content)
    tell.say(f"written to {out}")
    for loss in exported.losses:
        tell.say(f"note: {loss}")


@click.command(epilog=ask.examples("tumble upload imu-7/calibration.json --mavlink serial:/dev/ttyACM0:115200"))
@click.argument("calibration", type=ask.FILE)
@ask.option("--mavlink", "udp:[HOST:]PORT, tcp:HOST:PORT or serial:DEVICE:BAUD.", metavar="LINK", required=True)
@ask.option("--backup", "File for the values before.  [default: CALIBRATION.before.params]", type=ask.FILE)
@click.option("--thermal", is_flag=True, help="Curves over temperature too.")
@ask.option("--imu", "Of the N-th IMU, from 1, where the calibration does not say which.", metavar="N", type=int)
@click.option("--magnetometer", is_flag=True, help="Its parameters too, as the autopilot's first one.")
@click.option("--dry-run", is_flag=True, help="Compare, and write nothing.")
def upload(
    calibration: Path,
    mavlink: str,
    backup: Path | None,
    thermal: bool,
    imu: int | None,
    magnetometer: bool,
    dry_run: bool,
) -> None:
    """Write CALIBRATION, a calibration file, into PX4 or ArduPilot over MAVLink.

    Refused while it is armed, and where it has other sensors. What it has is kept in a backup file first; what was
    written is read back, and what cannot be finished is taken back.
    """
    from tumble.export.upload import upload as upload_calibration

    done = upload_calibration(
        calibration,
        mavlink,
        backup=backup or calibration.with_name(f"{calibration.stem}.before.params"),
        thermal=thermal,
        imu=imu,
        magnetometer=magnetometer,
        dry_run=dry_run,
    )
    for loss in done.losses:
        tell.say(f"note: {loss}")
    for change in done.changes:
        click.echo(f"{change.name}\t{change.before:.9g}\t{change.after:.9g}")
    changed = sum(change.before != change.after for change in done.changes)
    what = "would change" if dry_run else f"changed and read back; values before: {done.backup}"
    tell.say(f"{done.autopilot}: {changed} of {len(done.changes)} parameters {what}")


@click.command(epilog=ask.examples("tumble selftest -o record.json"))
@ask.out("Write the record, JSON, with versions, machine, figures and hashes.")
@ask.option("--by", "Who runs it and stands for it; default: the name of the user.", metavar="NAME")
def selftest(out: Path | None, by: str | None) -> None:
    """Run the reference cases on this machine and compare them with published values, closed forms and truth."""
    from tumble.lab.selftest import run_selftest
    from tumble.views.checks import selftest_table
    from tumble.views.render.terminal import print_blocks

    if out is not None and out.exists():
        raise InputError(f"{out}: expected a new file for the record, found one that exists; records are kept")
    record = run_selftest(by=by, progress=lambda name: tell.say(f"running: {name}"))
    print_blocks(selftest_table(record))
    click.echo(f"{record.software} on {record.machine['system']}, {record.date}, run by {record.by}")
    click.echo(f"loops over samples: {record.machine['loops']}")
    click.echo("passed" if record.passed else "FAILED")
    if out is not None:
        record.write(out)
        tell.say(f"written to {out}")
    sys.exit(0 if record.passed else 1)
