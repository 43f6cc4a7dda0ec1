"""`tumble report`: a document of a calibration."""

from __future__ import annotations

from pathlib import Path

import click

from tumble.commands import ask, tell


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
