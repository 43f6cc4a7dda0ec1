"""`tumble new`: a first session.toml for a log."""

from __future__ import annotations

from pathlib import Path

import click

from tumble.commands.arguments import EXISTING_FOLDER, with_progress


@click.command()
@click.argument("folder", type=EXISTING_FOLDER)
@click.option("--log", type=EXISTING_FOLDER, required=True, help="The recording: a log, a bag, a flight log, arrays.")
@click.option("--programme", help="Built-in programme that was gone through.")
@click.option("--message", metavar="NAME", help="Topic or message of a recording, where there are several.")
def new(folder: Path, log: Path, programme: str | None, message: str | None) -> None:
    """Write a commented session.toml for a log into FOLDER, and say what was guessed.

    A log is .csv (.gz, .zst) or .parquet; .bag, .db3, .mcap, .ulg, .bin, .mat, .h5 and ROS 2 folders are converted.
    """
    from tumble.calibration.new_session import new_session

    draft, faults = new_session(folder, log, programme=programme, message=message, progress=with_progress)
    for sentence in draft.said:
        click.echo(sentence, err=True)
    for fault in faults:
        click.echo(f"look at this: {fault}", err=True)
    click.echo(f"written to {folder / 'session.toml'}; fill in the serial number and the place", err=True)
