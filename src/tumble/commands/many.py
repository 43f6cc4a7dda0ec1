"""Commands of many calibrations at once: `campaign`, `fleet`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tumble.commands import console, params

if TYPE_CHECKING:
    from tumble.run.calibrate import Method


@click.command(epilog=params.examples("tumble campaign methods.toml -o methods"))
@click.argument("file", metavar="FILE.toml", type=params.FILE)
@params.JSON
@params.CLUSTER
def campaign(file: Path, out: Path, **place: Any) -> None:
    """Simulate and calibrate many times over the grid of FILE.toml.

    It shows errors against the truth, their ratio to the Cramér–Rao bound, coverage and failures. The same command
    resumes a campaign that was interrupted."""
    from tumble.campaigns.campaign import campaign, varying
    from tumble.views.campaign import summary_blocks

    with console.task_progress("trials", out) as progress:
        result = campaign(file, out, progress=progress, **place)
    console.show(result, lambda: summary_blocks(result.lines))
    short = {(*line.point.values(), line.method): line for line in result.lines if line.why}
    for line in list(short.values())[: console.SHOWN]:
        where = ", ".join([*(f"{axis} {line.point[axis]}" for axis in varying(result.lines)), line.method])
        console.warn(
            f"{where}: {line.trials - line.accepted} of {line.trials} not accepted or failed, the first: {line.why}"
        )
    console.say(f"written to {out}: {result.rows.name}, {result.summary.name}")
    console.end([] if any(line.accepted for line in result.lines) else ["not accepted: none of the trials"])


@click.command(epilog=params.examples("tumble fleet 'sessions/*' -o results"))
@click.argument("sessions", metavar="GLOB")
@params.method(params.METHOD_NAMES, params.METHOD_NAMES[0], "Method of estimation.")
@params.JSON
@params.CLUSTER
def fleet(sessions: str, method: Method, out: Path, **place: Any) -> None:
    """Calibrate all sessions that GLOB matches, with a row for each.

    A session that cannot be calibrated does not stop the others: its row has the reason. The same command resumes a run
    that was interrupted."""
    from tumble.campaigns.fleet import fleet

    with console.task_progress("sessions", out) as progress:
        result = fleet(sessions, out, method=method, progress=progress, **place)
    outcomes = {"not accepted": result.not_accepted, "failed": result.failed}
    counts = ", ".join(f"{len(reasons)} {outcome}" for outcome, reasons in outcomes.items())
    console.show(result, lambda: [f"{len(result.sessions)} sessions: {result.accepted} accepted, {counts}"])
    lines = [
        f"{outcome}: {session}: {why.replace(f'{session}/', '')}"
        for outcome, reasons in outcomes.items()
        for session, why in reasons.items()
    ]
    for line in lines[: console.SHOWN]:
        console.warn(line)
    if len(lines) > console.SHOWN:
        console.say(f"and {len(lines) - console.SHOWN} more, in the columns reasons and error of the rows")
    console.say(f"written to {result.rows}")
    sys.exit(1 if lines else 0)
