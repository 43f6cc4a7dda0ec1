"""`tumble new`: a first session.toml for a log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from tumble.commands import ask, tell


@click.command(epilog=ask.examples("tumble new imu-7 LOG0007.TXT --latitude 56.84 --serial A-7"))
@click.argument("folder", type=ask.PATH)
@click.argument("more", metavar="[LOG]...", nargs=-1, type=ask.PATH)
@ask.option("--log", "The recording: a log, a folder, a pattern, a bag.", type=ask.PATH, multiple=True)
@ask.SERIAL
@ask.LATITUDE
@ask.LOG
@ask.programme("Built-in programme that was gone through.")
@ask.option("--message", "Topic or message of a recording, where there are several.", metavar="NAME")
def new(folder: Path, more: tuple[Path, ...], log: tuple[Path, ...], **options: Any) -> None:
    """Write a commented session.toml for a log into FOLDER, and say what was guessed.

    LOG, or --log, is one or more text files in any dialect, .parquet, .xlsx, .bag, .db3, .mcap, .ulg, .bin, .mat, .h5,
    .npy, a .zip of such, a ROS 2 folder, or a folder or a pattern of files that were recorded one after the other.
    """
    from tumble.drafting.new_session import new_session

    if not log and not more:
        raise click.UsageError("Missing argument 'LOG': the recording")
    given = ask.given_of(options)
    draft, faults = new_session(folder, [*log, *more], given, progress=tell.with_progress)
    for sentence in draft.said:
        tell.say(sentence)
    for fault in faults:
        tell.warn(f"look at this: {fault}")
    told = {"the serial number": given.serial, "the place": given.latitude}
    missing = [what for what, value in told.items() if value is None]
    tell.say(f"written to {folder / 'session.toml'}" + (f"; fill in {' and '.join(missing)}" if missing else ""))
