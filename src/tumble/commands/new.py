"""`tumble new`: a first session.toml for a log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from tumble.commands.arguments import (
    EXISTING_FOLDER,
    LATITUDE,
    LOG_OPTIONS,
    SERIAL,
    given_of,
    option,
    programme_option,
    say,
    warn,
    with_progress,
)


@click.command()
@click.argument("folder", type=EXISTING_FOLDER)
@click.argument("more", metavar="[LOG]...", nargs=-1, type=EXISTING_FOLDER)
@option("--log", "The recording: a log, a folder, a pattern, a bag.", type=EXISTING_FOLDER, multiple=True)
@SERIAL
@LATITUDE
@LOG_OPTIONS
@programme_option("Built-in programme that was gone through.")
@option("--message", "Topic or message of a recording, where there are several.", metavar="NAME")
def new(folder: Path, more: tuple[Path, ...], log: tuple[Path, ...], **options: Any) -> None:
    """Write a commented session.toml for a log into FOLDER, and say what was guessed.

    LOG, or --log, is one or more text files in any dialect, .parquet, .xlsx, .bag, .db3, .mcap, .ulg, .bin, .mat, .h5,
    .npy, a .zip of such, a ROS 2 folder, or a folder or a pattern of files that were recorded one after the other.
    """
    from tumble.drafting.new_session import new_session

    if not log and not more:
        raise click.UsageError("Missing argument 'LOG': the recording")
    given = given_of(options)
    draft, faults = new_session(folder, [*log, *more], given, progress=with_progress)
    for sentence in draft.said:
        say(sentence)
    for fault in faults:
        warn(f"look at this: {fault}")
    told = {"the serial number": given.serial, "the place": given.latitude}
    missing = [what for what, value in told.items() if value is None]
    say(f"written to {folder / 'session.toml'}" + (f"; fill in {' and '.join(missing)}" if missing else ""))
