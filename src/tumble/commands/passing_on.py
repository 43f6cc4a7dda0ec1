"""Commands that write what is passed on and kept: `report`, `export`, `selftest`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from tumble.commands import ask, tell
from tumble.errors import InputError
from tumble.export import FORMATS


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
@ask.option("--sensor-ids", "px4-thermal: the numbers in CAL_ACC0_ID and CAL_GYRO0_ID.", metavar="ACCEL,GYRO")
@ask.option("--full-scale", "firmware: range in fixed point, g and °/s.  [default: 16,2000]", metavar="ACCEL,GYRO")
@ask.option("--counts", "iNav, Betaflight, …: counts a g and a °/s; default: the recording's.", metavar="ACCEL,GYRO")
@ask.force()
def export(
    calibration: Path,
    to: str,
    out: Path,
    sensor_ids: str | None,
    full_scale: str | None,
    counts: str | None,
    force: bool,
    **given: Any,
) -> None:
    """Write CALIBRATION, a calibration file, in the format of another program.

    What that format has no place for is said on standard error, and in the file where it has comments.
    """
    from tumble.export import export_calibration
    from tumble.export.autopilots import sensor_ids_of
    from tumble.export.counts import counts_of
    from tumble.export.firmware import full_scale_of
    from tumble.files import whole_file

    if out.exists() and not force:
        raise InputError(f"{out}: expected a new file, found one that exists; give --force to replace it")
    ids = None if sensor_ids is None else sensor_ids_of(sensor_ids)
    scales = None if full_scale is None else full_scale_of(full_scale)
    in_counts = None if counts is None else counts_of(counts)
    exported = export_calibration(calibration, to, sensor_ids=ids, full_scale=scales, counts=in_counts, **given)
    with whole_file(out) as temporary:
        temporary.write_bytes(exported.content)
    tell.say(f"written to {out}")
    for loss in exported.losses:
        tell.say(f"note: {loss}")


@click.command(epilog=ask.examples("tumble selftest -o record.json"))
@ask.out("Write the record, JSON, with versions, machine, figures and hashes.")
@ask.option("--by", "Who runs it and stands for it; default: the name of the user.", metavar="NAME")
def selftest(out: Path | None, by: str | None) -> None:
    """Run the reference cases on this machine and compare them with published values, closed forms and truth."""
    from tumble.errors import InputError
    from tumble.selftest import run_selftest
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
