"""`tumble export`: a calibration as other programs read it."""

from __future__ import annotations

from pathlib import Path

import click

from tumble.commands.arguments import EXISTING_FOLDER, FILE, say
from tumble.errors import InputError
from tumble.export import FORMATS


@click.command()
@click.argument("calibration", type=FILE)
@click.option("--to", type=click.Choice(list(FORMATS)), required=True, help="What to write.")
@click.option("-o", "--out", type=FILE, required=True, help="File to write.")
@click.option(
    "--noise", metavar="SESSION", type=EXISTING_FOLDER, help="kalibr: noise from this session's longest rest."
)
@click.option("--certificate", type=FILE, help="dcc: TOML file with laboratory, customer, number and dates.")
@click.option("--imu", metavar="N", type=int, help="px4, ardupilot, also thermal: of the N-th IMU, from 1.")
@click.option("--sensor-ids", metavar="ACCEL,GYRO", help="px4-thermal: the numbers in CAL_ACC0_ID and CAL_GYRO0_ID.")
@click.option("--force", is_flag=True, help="Replace an existing file.")
def export(
    calibration: Path,
    to: str,
    out: Path,
    noise: Path | None,
    certificate: Path | None,
    imu: int | None,
    sensor_ids: str | None,
    force: bool,
) -> None:
    """Write CALIBRATION, a calibration file, in the format of another program.

    What that format has no place for is said on standard error, and in the file where it has comments.
    """
    from tumble.export import export_calibration
    from tumble.export.autopilots import sensor_ids_of
    from tumble.files import whole_file

    if out.exists() and not force:
        raise InputError(f"{out}: expected a new file, found one that exists; give --force to replace it")
    ids = None if sensor_ids is None else sensor_ids_of(sensor_ids)
    exported = export_calibration(calibration, to, noise=noise, certificate=certificate, imu=imu, sensor_ids=ids)
    with whole_file(out) as temporary:
        temporary.write_bytes(exported.content)
    say(f"written to {out}")
    for loss in exported.losses:
        say(f"note: {loss}")
