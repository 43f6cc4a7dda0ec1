"""`tumble inspect`: what was found in a log."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from tumble.commands.arguments import EXISTING_FOLDER, FILE, JSON, option, say, show, warn, with_progress


@click.command()
@click.argument("session", type=EXISTING_FOLDER)
@option("--plot/picture", "Draw the recording with its rests into .svg, .png or .pdf.", type=FILE)
@JSON
def inspect(session: Path, picture: Path | None, as_json: bool) -> None:
    """Show the rests and turns found in SESSION, and what was rejected and why."""
    from tumble.run.observed import inspect_session
    from tumble.views.inspection import inspection_blocks, inspection_data
    from tumble.views.recording_picture import plot

    observed = inspect_session(session, progress=with_progress)
    if picture is not None:
        plot(observed, picture)
        say(f"written to {picture}")
    show(as_json, lambda: inspection_data(observed), lambda: inspection_blocks(observed))
    for fault in (*observed.faults, *observed.gyro_faults):
        warn(f"fault: {fault}")
    sys.exit(1 if observed.faults else 0)
