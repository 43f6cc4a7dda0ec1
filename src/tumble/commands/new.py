"""`tumble new`: a first session.toml for a log."""

from __future__ import annotations

from pathlib import Path

import click

from tumble.commands.arguments import (
    EXISTING_FOLDER,
    column_options,
    columns_stated,
    programme_option,
    say,
    warn,
    with_progress,
)


@click.command()
@click.argument("folder", type=EXISTING_FOLDER)
@click.argument("more", metavar="[LOG]...", nargs=-1, type=EXISTING_FOLDER)
@click.option("--log", type=EXISTING_FOLDER, multiple=True, help="The recording: a log, a folder, a pattern, a bag.")
@click.option("--serial", metavar="NUMBER", help="Serial number of the device; default: the name of FOLDER.")
@click.option("--latitude", type=float, metavar="DEGREES", help="Of the place, ° north.")
@click.option("--rate", type=float, metavar="HZ", help="Samples per second, instead of the times in the log.")
@column_options
@programme_option("Built-in programme that was gone through.")
@click.option("--message", metavar="NAME", help="Topic or message of a recording, where there are several.")
def new(
    folder: Path,
    more: tuple[Path, ...],
    log: tuple[Path, ...],
    serial: str | None,
    latitude: float | None,
    rate: float | None,
    accel: str | None,
    gyro: str | None,
    time: str | None,
    programme: str | None,
    message: str | None,
) -> None:
    """Write a commented session.toml for a log into FOLDER, and say what was guessed.

    LOG, or --log, is one or more text files in any dialect, .parquet, .xlsx, .bag, .db3, .mcap, .ulg, .bin, .mat, .h5,
    .npy, a .zip of such, a ROS 2 folder, or a folder or a pattern of files that were recorded one after the other.
    """
    from tumble.drafting.new_session import Given, new_session

    if not log and not more:
        raise click.UsageError("Missing argument 'LOG': the recording")
    columns = columns_stated(accel, gyro, time)
    given = Given(serial=serial, latitude=latitude, rate=rate, programme=programme, message=message, **columns)
    draft, faults = new_session(folder, [*log, *more], given, progress=with_progress)
    for sentence in draft.said:
        say(sentence)
    for fault in faults:
        warn(f"look at this: {fault}")
    missing = [what for what, value in (("the serial number", serial), ("the place", latitude)) if value is None]
    say(f"written to {folder / 'session.toml'}" + (f"; fill in {' and '.join(missing)}" if missing else ""))
