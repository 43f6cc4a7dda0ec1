"""`tumble inspect`: what was found in a log."""

from __future__ import annotations

from pathlib import Path

import click

from tumble.commands.arguments import EXISTING_FOLDER, say, with_progress


@click.command()
@click.argument("session", type=EXISTING_FOLDER)
def inspect(session: Path) -> None:
    """Show the rests and turns found in SESSION, and what was rejected and why."""
    from tumble.calibration.observed import inspect_session
    from tumble.terminal.inspection import inspection_report
    from tumble.terminal.text import print_report

    observed = inspect_session(session, progress=with_progress)
    print_report(inspection_report(observed))
    for fault in observed.faults:
        say(f"fault: {fault}")
