"""`tumble campaign`: many simulated calibrations over a grid."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from tumble.commands import ask, tell
from tumble.errors import TumbleError


@click.command(epilog=ask.examples("tumble campaign methods.toml -o methods"))
@click.argument("file", metavar="FILE.toml", type=ask.FILE)
@ask.CLUSTER
def campaign(file: Path, out: Path, **place: Any) -> None:
    """Simulate and calibrate many times over the grid of FILE.toml.

    It shows errors against the truth, their ratio to the Cramér–Rao bound, coverage and failures. A campaign that
    was interrupted goes on where it was when the same command is given again.
    """
    from tumble.campaigns.run import campaign
    from tumble.campaigns.summary import varying
    from tumble.views.campaign import plot, summary_blocks
    from tumble.views.render.terminal import print_blocks

    with tell.task_progress("trials", out) as progress:
        result = campaign(file, out, progress=progress, **place)
    print_blocks(*summary_blocks(result.lines))
    short = {(*line.point.values(), line.method): line for line in result.lines if line.why}
    for line in list(short.values())[: tell.SHOWN]:
        where = ", ".join([*(f"{axis} {line.point[axis]}" for axis in varying(result.lines)), line.method])
        tell.warn(
            f"{where}: {line.trials - line.accepted} of {line.trials} not accepted or failed, the first: {line.why}"
        )
    written = [result.rows.name, result.summary.name]
    try:
        plot(result.lines, out / "rms.svg")
        written.append("rms.svg")
    except TumbleError as error:
        tell.say(f"not drawn: {error}")
    tell.say(f"written to {out}: {', '.join(written)}")
    tell.end([] if any(line.accepted for line in result.lines) else ["not accepted: none of the trials"])
