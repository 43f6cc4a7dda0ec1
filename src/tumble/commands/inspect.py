"""`tumble inspect`: what was found in a log."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from tumble.commands import ask, tell


@click.command(epilog=ask.examples("tumble inspect imu-7"))
@click.argument("session", type=ask.PATH)
@ask.option("--plot/picture", "Draw the recording with its rests into .svg, .png or .pdf.", type=ask.FILE)
@ask.JSON
def inspect(session: Path, picture: Path | None, as_json: bool) -> None:
    """Show the rests and turns found in SESSION, and what was rejected and why."""
    from tumble.run.observed import inspect_session
    from tumble.views.inspection import inspection_blocks, inspection_data
    from tumble.views.recording_picture import plot

    observed = inspect_session(session, progress=tell.with_progress)
    if picture is not None:
        plot(observed, picture)
        tell.say(f"written to {picture}")
    tell.show(as_json, lambda: inspection_data(observed), lambda: inspection_blocks(observed))
    for fault in (*observed.faults, *observed.gyro_faults):
        tell.warn(f"fault: {fault}")
    sys.exit(1 if observed.faults else 0)
