"""`tumble report`: a document of a calibration."""

from __future__ import annotations

from pathlib import Path

import click

from tumble.commands.arguments import CERTIFICATE, FILE, end, option, out_option, say


@click.command()
@click.argument("calibrations", metavar="CALIBRATION...", type=FILE, nargs=-1, required=True)
@out_option("File to write: .html, or .pdf for the archive.", required=True)
@option("--limits", "Acceptance limits (TOML): judge every parameter by them.", type=FILE)
@CERTIFICATE
def report(calibrations: tuple[Path, ...], out: Path, limits: Path | None, certificate: Path | None) -> None:
    """Report of a calibration, or of several of one device, in one file that needs nothing else."""
    from tumble.views.report.write import write_report

    reasons = write_report(calibrations, out, limits=limits, certificate=certificate)
    say(f"written to {out}")
    end(reasons, "not accepted: ")
