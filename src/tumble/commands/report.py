"""`tumble report`: a document of a calibration."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from tumble.commands.arguments import FILE, say, warn


@click.command()
@click.argument("calibrations", metavar="CALIBRATION...", type=FILE, nargs=-1, required=True)
@click.option("-o", "--out", type=FILE, required=True, help="File to write: .html, or .pdf for the archive.")
@click.option("--limits", type=FILE, help="Acceptance limits (TOML): judge every parameter by them.")
@click.option("--certificate", type=FILE, help="TOML file with laboratory, customer, number: make a certificate.")
def report(calibrations: tuple[Path, ...], out: Path, limits: Path | None, certificate: Path | None) -> None:
    """Report of a calibration, or of several of one device, in one file that needs nothing else."""
    from tumble.views.report.write import write_report

    reasons = write_report(calibrations, out, limits=limits, certificate=certificate)
    say(f"written to {out}")
    for reason in reasons:
        warn(f"not accepted: {reason}")
    sys.exit(1 if reasons else 0)
