"""`tumble upload`: a calibration into the parameters of an autopilot."""

from __future__ import annotations

from pathlib import Path

import click

from tumble.commands import ask, tell


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
