"""`tumble campaign`: many simulated calibrations over a grid."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from tumble.commands.arguments import CLUSTER, FILE, SHOWN, end, say, task_progress, warn
from tumble.errors import TumbleError


@click.command()
@click.argument("file", metavar="FILE.toml", type=FILE)
@CLUSTER
def campaign(file: Path, out: Path, **place: Any) -> None:
    """Simulate and calibrate many times over the grid of FILE.toml.

    It shows errors against the truth, their ratio to the Cramér–Rao bound, coverage and failures. A campaign that
    was interrupted goes on where it was when the same command is given again.
    """
    from tumble.campaigns.run import campaign
    from tumble.campaigns.summary import varying
    from tumble.views.campaign import plot, summary_blocks
    from tumble.views.render.terminal import print_blocks

    with task_progress("trials", out) as progress:
        result = campaign(file, out, progress=progress, **place)
    print_blocks(*summary_blocks(result.lines))
    short = {(*line.point.values(), line.method): line for line in result.lines if line.why}
    for line in list(short.values())[:SHOWN]:
        where = ", ".join([*(f"{axis} {line.point[axis]}" for axis in varying(result.lines)), line.method])
        warn(f"{where}: {line.trials - line.accepted} of {line.trials} not accepted or failed, the first: {line.why}")
    written = [result.rows.name, result.summary.name]
    try:
        plot(result.lines, out / "rms.svg")
        written.append("rms.svg")
    except TumbleError as error:
        say(f"not drawn: {error}")
    say(f"written to {out}: {', '.join(written)}")
    end([] if any(line.accepted for line in result.lines) else ["not accepted: none of the trials"])
