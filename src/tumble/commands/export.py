"""`tumble export`: a calibration as other programs read it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from tumble.commands import ask, tell
from tumble.errors import InputError
from tumble.export import FORMATS


@click.command(epilog=ask.examples("tumble export imu-7/calibration.json --to px4 -o imu-7.params"))
@click.argument("calibration", type=ask.FILE)
@ask.option("--to", "What to write.", type=click.Choice(list(FORMATS)), required=True)
@ask.out("File to write.", required=True)
@ask.option("--noise", "kalibr: noise from this session's longest rest.", metavar="SESSION", type=ask.PATH)
@ask.CERTIFICATE
@ask.option("--imu", "px4, ardupilot, also thermal: of the N-th IMU, from 1.", metavar="N", type=int)
@ask.option("--sensor-ids", "px4-thermal: the numbers in CAL_ACC0_ID and CAL_GYRO0_ID.", metavar="ACCEL,GYRO")
@ask.option("--full-scale", "firmware: range in fixed point, g and °/s.  [default: 16,2000]", metavar="ACCEL,GYRO")
@ask.force()
def export(
    calibration: Path,
    to: str,
    out: Path,
    sensor_ids: str | None,
    full_scale: str | None,
    force: bool,
    **given: Any,
) -> None:
    """Write CALIBRATION, a calibration file, in the format of another program.

    What that format has no place for is said on standard error, and in the file where it has comments.
    """
    from tumble.export import export_calibration
    from tumble.export.autopilots import sensor_ids_of
    from tumble.export.firmware import full_scale_of
    from tumble.files import whole_file

    if out.exists() and not force:
        raise InputError(f"{out}: expected a new file, found one that exists; give --force to replace it")
    ids = None if sensor_ids is None else sensor_ids_of(sensor_ids)
    scales = None if full_scale is None else full_scale_of(full_scale)
    exported = export_calibration(calibration, to, sensor_ids=ids, full_scale=scales, **given)
    with whole_file(out) as temporary:
        temporary.write_bytes(exported.content)
    tell.say(f"written to {out}")
    for loss in exported.losses:
        tell.say(f"note: {loss}")
