"""Commands that make a calibration file: `calibrate`, `ellipsoid`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tumble.commands import console, params
from tumble.commands.recordings import check_recordings, gyros_of, session_folders
from tumble.errors import GyrosAloneError, InputError

if TYPE_CHECKING:
    from tumble.inference.prior import DevicePrior
    from tumble.recording.session import Session
    from tumble.result.calibration import Calibration
    from tumble.run.calibrate import Method
    from tumble.units import Array

_RESTS = params.Numbers("numbers of rests such as 3,7", int)


@click.command(
    epilog=params.examples(
        "tumble calibrate imu-7",
        "tumble calibrate LOG0007.TXT --latitude 56.84 --serial A-7",
        "tumble calibrate monday tuesday --out A-7.json",
        "tumble calibrate cold room hot --together --out A-7.json",
        "tumble calibrate warm.csv --base A-7.json --out A-7-warm.json",
        "tumble calibrate imu-7 --budget",
        "tumble calibrate imu-7 --json",
    )
)
@click.argument("sessions", metavar="SESSION...", type=params.PATH, nargs=-1, required=True)
@params.method(
    params.METHOD_NAMES, params.METHOD_NAMES[:1], "Method of estimation; repeat to compare methods.", multiple=True
)
@params.option("--iterations", "Number of passes of sequential and scalar; default 2.", type=click.IntRange(min=1))
@params.frame()
@params.terms("full")
@params.option(
    "--without", "Rests to leave out, by their numbers in the result, such as 3,7.", metavar="N,N", type=_RESTS
)
@click.option("--together", is_flag=True, help="Make one estimate of sessions at different temperatures.")
@params.option(
    "--base", "Calibration to whose biases a recording at rest adds temperature coefficients.", type=params.FILE
)
@params.out("Calibration file to write; default: calibration.json in the session folder.")
@params.force("Replace a calibration file that came from another log or method.")
@params.option("--truth", "truth.json of a simulated session: show true values beside the result.", type=params.FILE)
@params.LOG
@params.registry("For one session: take the prior from other units of the device type, not from its grade.")
@click.option("--budget", is_flag=True, help="Show the contributions to every u by source.")
@params.JSON
@params.EVERY
def calibrate(
    sessions: tuple[Path, ...],
    method: tuple[Method, ...],
    without: tuple[int, ...] | None,
    together: bool,
    registry: str | None,
    truth: Path | None,
    base: Path | None,
    out: Path | None,
    force: bool,
    **options: Any,
) -> None:
    """Calibrate the device of SESSION, a folder with session.toml and a log.

    Several sessions of one device are launches: the result is their mean, with the standard deviation from launch to
    launch, and --out is required. With --together they give one estimate by the method joint, with temperature
    coefficients. If several methods are given, the result of the first is written. A device that lies still while it
    warms or cools gets temperature coefficients; --base adds them to a calibration.

    A file that is no session.toml, or anything with --latitude, --height, --serial, --sample-rate, --accel, --gyro,
    --time or units, is a LOG in any dialect: a session is made of it first, as `tumble new` does, in the folder
    LOG-session beside it. For the same log it is reused; with other options another is made. Files that are
    positions of one recording are one LOG as a folder or as a 'PATTERN' in quotes; for other logs make a session each.
    """
    from tumble.recording.session_file import read_session
    from tumble.run.calibrate import calibrate as calibrate_session
    from tumble.views.calibration import MAX_REMARKS, WIDTH, calibration_blocks

    check_recordings(sessions)
    methods = tuple(dict.fromkeys(method))
    estimation = _taken(options, "iterations", "frame", "terms")
    shown = _taken(options, "every", "budget")  # the other options describe a log
    frame, linear = estimation["frame"], estimation["terms"] == "linear"
    if len(sessions) > 1 and out is None:
        raise InputError("--out: expected a file for the result of several sessions, found none; give --out FILE.json")
    if truth is not None and frame != "accelerometer":
        raise InputError(f"--truth: expected the frame 'accelerometer', in which truth.json is, found {frame!r}")
    if registry is not None and (len(sessions) > 1 or together or methods != ("joint",) or linear):
        raise InputError(
            "--registry: expected one session and the method joint with all terms, found another kind of calibration"
        )
    if without is not None and len(sessions) > 1:
        raise InputError("--without: expected one session, whose rests are numbered, found several; use [[exclude]]")
    if together and (list(methods) != params.METHOD_NAMES[:1] or estimation["iterations"] is not None or linear):
        raise InputError(
            f"--together: expected the method {params.METHOD_NAMES[0]!r} with all terms and no iterations, found others"
        )
    truth_by_name, true_values = None, None
    if truth is not None:  # read before anything is computed
        from tumble.simulation.session import read_truth

        truth_by_name = read_truth(truth)
    if base is not None:
        if len(sessions) > 1 or together or methods != ("joint",):
            raise InputError("--base: expected one recording and the method joint, found others")
        estimation["base"] = base
    folders_made = session_folders(sessions, dict(options), every=shown["every"])
    with _gyros_alone(sessions, options, out, force=force), folders_made as folders, console.estimating() as progress:
        described = [read_session(folder).without(without or ()) for folder in folders]
        if together:
            from tumble.run.together import calibrate_together

            results = [calibrate_together(described, frame=frame, progress=progress)]
        else:
            if registry is not None:
                estimation["prior"] = _prior_by_type(registry, described[0])
            calibrated: Callable[..., Calibration] = partial(calibrate_session, described[0])
            if len(described) > 1:
                from tumble.run.launches import calibrate_launches

                calibrated = partial(calibrate_launches, described)
            results = [calibrated(method=each, progress=progress, **estimation) for each in methods]
        result, *others = results
        target = out or Path(described[0].name) / "calibration.json"
        result.write(target, force=force)
    if truth_by_name is not None:
        from tumble.result.record import reference_of_parameter
        from tumble.simulation.temperature_profile import truth_at

        true_values = truth_at(truth_by_name, result.reference_temperature, partial(reference_of_parameter, result))
    console.show(
        lambda: result.content() | ({"others": [other.content() for other in others]} if others else {}),
        lambda: calibration_blocks(
            result, true_values, others, file=target, session=described[0].name, log=sessions[0], **shown
        ),
        width=None if shown["every"] else WIDTH,
    )
    console.say(f"written to {target}")
    if result.outcome.reasons and not shown["every"]:
        from tumble.drafting.made_session import remarks_of_made

        for sentence in remarks_of_made(Path(described[0].name)):
            console.say(f"note: {sentence}")
    for other in others:
        for reason in other.outcome.reasons:
            console.warn(f"{other.method}: not accepted: {reason}")
    console.end(result.outcome.reasons, "not accepted: ", most=None if shown["every"] else MAX_REMARKS)


def _taken(options: dict[str, Any], *names: str) -> dict[str, Any]:
    """Remove options and return them."""
    return {name: options.pop(name) for name in names}


def _prior_by_type(registry: str, session: Session) -> DevicePrior:
    """Return the prior of a device by other units of its type in a registry."""
    if session.device.model is None:
        raise InputError("--registry: expected the type of the device, `model` under [device], found none")
    with params.opened(registry) as opened:
        return opened.prior(session.device.model, without=session.device.serial)


@contextmanager
def _gyros_alone(logs: Sequence[Path], stated: dict[str, Any], out: Path | None, *, force: bool) -> Iterator[None]:
    """If a log has only gyros, calibrate their biases, write the file beside it, and exit."""
    try:
        yield
    except GyrosAloneError:
        from tumble.run.gyros_alone import calibrate_gyros
        from tumble.views.calibration import WIDTH, calibration_blocks

        result = calibrate_gyros(gyros_of(logs[0], params.given_of(stated)))
        target = out or logs[0].with_name(f"{logs[0].stem}.calibration.json")
        result.write(target, force=force)
        console.show(result.content, lambda: calibration_blocks(result, file=target, session=logs[0]), width=WIDTH)
        console.say(f"written to {target}")
        console.end(result.outcome.reasons, "not accepted: ")


@click.command(
    epilog=params.examples("tumble ellipsoid positions.csv --unit g", "tumble ellipsoid volts.csv --scale=-2.4")
)
@click.argument("readings", metavar="READINGS.csv", type=params.FILE)
@params.option("--unit", "Unit of the readings: V, count, g or m/s^2.", "V")
@params.option(
    "--scale",
    "Nominal output per unit, signed by polarity; default: from the readings.",
    metavar="K|K,K,K",
    type=params.NUMBERS,
)
@params.option("--scale-per", "Unit of the input in --scale: g (default) or m/s^2.")
@params.GRAVITY
@params.option("--gravity-u", "Standard uncertainty of --gravity; default: 3e-4 from a latitude.", type=float)
@params.option("--position/positions", "Rough direction of up in position N; repeat.", multiple=True, metavar="N=X,Y,Z")
@params.option("--rows-per-position", "Number of consecutive rows per position.", 1, type=int)
@params.grade(None, "; default: any, as far as residuals allow")
@params.terms("full")
@params.frame([frame for frame in params.FRAMES if frame != "case"])
@params.SERIAL
@params.out("Calibration file; default: READINGS.calibration.json beside the table.")
@params.force("Replace a calibration file that came from another table or method.")
@params.JSON
def ellipsoid(readings: Path, positions: tuple[str, ...], out: Path | None, force: bool, **options: Any) -> None:
    """Calibrate three accelerometers from READINGS.csv, their mean readings in nine or more positions.

    The table has a header with the names of three columns, one per channel, and a row per position."""
    from tumble.run.from_readings import calibrate_readings
    from tumble.views.readings import readings_blocks

    result = calibrate_readings(readings, directions=dict(map(_position, positions)), **options)
    target = out or readings.with_suffix(".calibration.json")
    result.calibration.write(target, force=force)
    console.show(result.calibration.content, lambda: readings_blocks(result))
    console.say(f"written to {target}")
    console.end(result.calibration.outcome.reasons, "not accepted: ")


def _position(text: str) -> tuple[int, Array]:
    """Return the position and the direction (3,) of up in it from N=X,Y,Z."""
    import numpy as np

    from tumble.documents import whole_number

    number, _, direction = text.partition("=")
    position = whole_number(number.strip())
    vector = np.array(params.NUMBERS.read("--position", direction)) if direction else np.zeros(0)
    if position is None or vector.shape != (3,) or not np.isfinite(vector).all() or not vector.any():
        raise InputError(f"--position: expected N=X,Y,Z, the number of a position and a direction, found {text!r}")
    return position, vector
