"""`tumble calibrate`: from sessions to a calibration file."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tumble.commands.arguments import EXISTING_FOLDER, FILE, FRAMES, METHOD_NAMES, with_progress
from tumble.errors import InputError

if TYPE_CHECKING:
    from tumble.calibration.calibrate import Terms
    from tumble.sensors.frames import Frame


@click.command()
@click.argument("sessions", metavar="SESSION...", type=EXISTING_FOLDER, nargs=-1, required=True)
@click.option(
    "--method",
    "methods",
    type=click.Choice(METHOD_NAMES),
    multiple=True,
    default=METHOD_NAMES[:1],
    show_default=True,
    help="How to estimate; given again: another method beside it.",
)
@click.option("--iterations", type=click.IntRange(min=1), help="Passes of sequential and scalar; default 2.")
@click.option("--frame", type=click.Choice(FRAMES), default=FRAMES[0], show_default=True, help="Of the result.")
@click.option(
    "--terms",
    type=click.Choice(["full", "linear"]),
    default="full",
    show_default=True,
    help="Of joint: all groups of parameters, or bias, scale factor and axis angles alone.",
)
@click.option("--together", is_flag=True, help="Several sessions, at other temperatures, as one estimate.")
@click.option("--out", type=FILE, help="Calibration file to write; default: calibration.json in the session folder.")
@click.option("--force", is_flag=True, help="Replace a calibration file that came from another log or method.")
@click.option("--truth", type=FILE, help="truth.json of a simulated session: show true values beside the result.")
@click.option("--all", "every", is_flag=True, help="Show every parameter, not a line for each further group.")
def calibrate(
    sessions: tuple[Path, ...],
    methods: tuple[str, ...],
    iterations: int | None,
    frame: Frame,
    terms: Terms,
    together: bool,
    out: Path | None,
    force: bool,
    truth: Path | None,
    every: bool,
) -> None:
    """Calibrate the device of SESSION, a folder with session.toml and a log.

    Several sessions of one device are launches: every launch is shown with the mean and the standard deviation from
    launch to launch, and --out is required. With --together they are one estimate by the method joint, with
    coefficients over temperature. Several methods are compared: the first one's result is the one written.
    """
    from tumble.calibration.launches import calibrate_launches
    from tumble.calibration.together import calibrate_together
    from tumble.recording.session import read_session
    from tumble.simulation.session import read_truth
    from tumble.simulation.temperature_profile import truth_at
    from tumble.terminal.calibration import calibration_report
    from tumble.terminal.text import print_report

    if len(sessions) > 1 and out is None:
        raise InputError("--out: expected a file for the result of several sessions, found none; give --out FILE.json")
    if truth is not None and frame != "accelerometer":
        raise InputError(f"--truth: expected the frame 'accelerometer', in which truth.json is, found {frame!r}")
    if together and (list(methods) != METHOD_NAMES[:1] or iterations is not None or terms != "full"):
        raise InputError(
            f"--together: expected the method {METHOD_NAMES[0]!r} with all terms and no iterations, found others"
        )
    true = read_truth(truth) if truth else None
    described = [read_session(session) for session in sessions]
    result, *others = (
        [calibrate_together(described, frame=frame, progress=with_progress)]
        if together
        else [
            calibrate_launches(
                described, method=method, iterations=iterations, frame=frame, terms=terms, progress=with_progress
            )
            for method in dict.fromkeys(methods)
        ]
    )
    target = out or Path(described[0].name) / "calibration.json"
    result.write(target, force=force)
    known = None if true is None else truth_at(true, result.reference_temperature)
    print_report(calibration_report(result, known, others, every=every))
    click.echo(f"written to {target}", err=True)
    for other in others:
        for reason in other.outcome.reasons:
            click.echo(f"{other.method}: not accepted: {reason}", err=True)
    for reason in result.outcome.reasons:
        click.echo(f"not accepted: {reason}", err=True)
    sys.exit(0 if result.outcome.accepted else 1)
