"""`tumble calibrate`: from sessions to a calibration file."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tumble.commands.arguments import (
    EXISTING_FOLDER,
    FILE,
    FRAMES,
    JSON,
    METHOD_NAMES,
    column_options,
    columns_stated,
    say,
    warn,
    with_progress,
)
from tumble.errors import InputError

if TYPE_CHECKING:
    from tumble.calibration.calibrate import Method, Terms
    from tumble.calibration.calibration_file import Calibration
    from tumble.calibration.type_spread import TypeSpread
    from tumble.recording.session import Session
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
@click.option("--without", metavar="N,N", help="Rests to leave out, by their numbers in the result, such as 3,7.")
@click.option("--together", is_flag=True, help="Several sessions, at other temperatures, as one estimate.")
@click.option(
    "-o", "--out", type=FILE, help="Calibration file to write; default: calibration.json in the session folder."
)
@click.option("--force", is_flag=True, help="Replace a calibration file that came from another log or method.")
@click.option("--truth", type=FILE, help="truth.json of a simulated session: show true values beside the result.")
@click.option("--latitude", type=float, metavar="DEGREES", help="Of a LOG: where it was recorded, ° north.")
@click.option("--serial", metavar="NUMBER", help="Of a LOG: serial number of the device; default: the log's name.")
@click.option("--rate", type=float, metavar="HZ", help="Of a LOG: samples per second, instead of the times in it.")
@column_options
@click.option(
    "--registry",
    "place",
    metavar="FILE|URL",
    help="Several launches: their instability together with that of all devices of the type in this registry.",
)
@JSON
@click.option("--all", "every", is_flag=True, help="Show every parameter, and tables of groups, rests and fits.")
def calibrate(
    sessions: tuple[Path, ...],
    methods: tuple[Method, ...],
    iterations: int | None,
    frame: Frame,
    terms: Terms,
    without: str | None,
    together: bool,
    out: Path | None,
    force: bool,
    truth: Path | None,
    latitude: float | None,
    serial: str | None,
    rate: float | None,
    accel: str | None,
    gyro: str | None,
    time: str | None,
    place: str | None,
    as_json: bool,
    every: bool,
) -> None:
    """Calibrate the device of SESSION, a folder with session.toml and a log.

    Several sessions of one device are launches: every launch is shown with the mean and the standard deviation from
    launch to launch, and --out is required. With --together they are one estimate by the method joint, with
    coefficients over temperature. Several methods are compared: the first one's result is the one written.

    A file that is no session.toml, or anything with --latitude, --serial, --rate, --accel, --gyro or --time, is a LOG
    in any dialect: a session is made of it first, as `tumble new` does, in the folder LOG-session beside it.
    """
    from tumble.recording.session_file import read_session

    if len(sessions) > 1 and out is None:
        raise InputError("--out: expected a file for the result of several sessions, found none; give --out FILE.json")
    if truth is not None and frame != "accelerometer":
        raise InputError(f"--truth: expected the frame 'accelerometer', in which truth.json is, found {frame!r}")
    if place is not None and (len(sessions) < 2 or together):
        raise InputError(
            "--registry: expected several launches, whose instability it is about, found another kind of calibration"
        )
    if without is not None and len(sessions) > 1:
        raise InputError("--without: expected one session, whose rests are numbered, found several; use [[exclude]]")
    left_out = () if without is None else _numbers(without)
    true = _truth(truth) if truth else None
    request = CalibrationRequest(methods=methods, iterations=iterations, frame=frame, terms=terms, together=together)
    given = {"latitude": latitude, "serial": serial, "rate": rate, **columns_stated(accel, gyro, time)}
    is_log = bool({*given.values()} - {None, ()}) or (len(sessions) == 1 and _is_log(sessions[0]))
    with _session_of(sessions, given) if is_log else nullcontext(sessions) as folders:
        described = [read_session(folder).without(left_out) for folder in folders]
        alike = None if place is None else _of_type(place, described[0].device.model, frame)
        result, *others = request.calibrations(described, alike)
        target = out or Path(described[0].name) / "calibration.json"
        result.write(target, force=force)
    _show(result, others, true, as_json=as_json, every=every)
    say(f"written to {target}")
    for other in others:
        for reason in other.outcome.reasons:
            warn(f"{other.method}: not accepted: {reason}")
    for reason in result.outcome.reasons:
        warn(f"not accepted: {reason}")
    sys.exit(0 if result.outcome.accepted else 1)


@dataclass(frozen=True, kw_only=True, slots=True)
class CalibrationRequest:
    """What is asked of the calibration of some sessions. Raises InputError for --together with what it has not."""

    methods: tuple[Method, ...]
    iterations: int | None
    frame: Frame
    terms: Terms
    together: bool

    def __post_init__(self) -> None:
        other = list(self.methods) != METHOD_NAMES[:1] or self.iterations is not None or self.terms != "full"
        if self.together and other:
            raise InputError(
                f"--together: expected the method {METHOD_NAMES[0]!r} with all terms and no iterations, found others"
            )

    def calibrations(self, sessions: list[Session], alike: TypeSpread | None) -> list[Calibration]:
        """The calibration by each method, as launches, their instability with that of devices `alike`; or all
        sessions as one estimate."""
        from tumble.calibration.launches import calibrate_launches
        from tumble.calibration.together import calibrate_together

        if self.together:
            return [calibrate_together(sessions, frame=self.frame, progress=with_progress)]
        return [
            calibrate_launches(
                sessions,
                method=method,
                iterations=self.iterations,
                frame=self.frame,
                terms=self.terms,
                alike=alike,
                progress=with_progress,
            )
            for method in dict.fromkeys(self.methods)
        ]


def _show(
    result: Calibration, others: list[Calibration], true: dict[str, float] | None, *, as_json: bool, every: bool
) -> None:
    """Print a calibration, beside those of other methods and the truth: as JSON, or in tables of `every` parameter."""
    if as_json:
        from tumble.views.render.data import print_data

        content = result.content()
        print_data(content | {"others": [other.content() for other in others]} if others else content)
    else:
        from tumble.views.calibration import calibration_blocks
        from tumble.views.render.terminal import print_blocks

        known = None if true is None else _true_at(result, true)
        print_blocks(*calibration_blocks(result, known, others, every=every))


def _truth(path: Path) -> dict[str, float]:
    """The true parameters of a simulated session."""
    from tumble.simulation.session import read_truth

    return read_truth(path)


def _true_at(result: Calibration, true: dict[str, float]) -> dict[str, float]:
    """True parameters at the temperatures at which a result has them."""
    from tumble.simulation.temperature_profile import truth_at

    return truth_at(true, result.reference_temperature, result.reference_of)


def _numbers(text: str) -> tuple[int, ...]:
    """The numbers of rests such as "3,7"."""
    try:
        return tuple(int(number) for number in text.split(","))
    except ValueError:
        raise InputError(f"--without: expected numbers of rests such as 3,7, found {text!r}") from None


def _of_type(place: str, model: str | None, frame: Frame) -> TypeSpread:
    """The launches of all devices of a type in a registry."""
    from tumble.registry.store.connect import extra_named

    if model is None:
        raise InputError("--registry: expected the type of the device, `model` under [device], found none")
    with extra_named():
        from tumble.registry.store.connect import open_registry
        from tumble.registry.type_launches import type_spread

        with open_registry(place) as opened:
            return type_spread(opened, model, frame)


def _is_log(path: Path) -> bool:
    return path.is_file() and path.suffix != ".toml"


@contextmanager
def _session_of(logs: Sequence[Path], said: Mapping[str, Any]) -> Iterator[list[Path]]:
    """The folder of a session made of a log, of which this is said; it is there no more where the block fails."""
    from tumble.drafting.new_session import Given, written_session
    from tumble.files import nothing_left

    if len(logs) > 1 or (logs[0].is_dir() and (logs[0] / "session.toml").exists()) or logs[0].suffix == ".toml":
        raise InputError(
            "--latitude, --serial, --rate, --accel, --gyro, --time: expected one log with them, found a session; they "
            "stand in its session.toml"
        )
    name = logs[0].name.partition(".")[0]
    folder = logs[0].with_name(f"{name}-session")
    if (folder / "session.toml").exists():
        raise InputError(
            f"{folder}: expected none yet, found the session that was made of this log before; calibrate that "
            f"(tumble calibrate {folder}), or remove it to make it anew"
        )
    with nothing_left(folder) as output:
        given = Given(**said)
        draft, faults = written_session(output, logs[0], replace(given, serial=given.serial or name), with_progress)
        for sentence in draft.said:
            say(sentence)
        for fault in faults:
            warn(f"look at this: {fault}")
        say(f"kept in {folder / 'session.toml'}")
        yield [folder]
