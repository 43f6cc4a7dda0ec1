"""The command line: each command parses, calls one function and prints. Data to standard output, talk to standard
error. Exit status 0 accepted, 1 not accepted (reasons on standard error), 2 unusable input or arguments."""

from __future__ import annotations

import errno
import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from tumble import __version__
from tumble.errors import InputError, TumbleError

if TYPE_CHECKING:
    from tumble.budget import Setup
    from tumble.log import Chunk, Log

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices are small: threads would only wait for each other


class _NamedPath(click.Path):
    """A path that is not empty: an empty one, as of a variable that is not set, would be the working folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "":
            self.fail("expected a path, found an empty one", param, ctx)
        return super().convert(value, param, ctx)


EXISTING_FOLDER = _NamedPath(path_type=Path)
FILE = _NamedPath(path_type=Path, dir_okay=False)
METHODS = ["staged", "sequential", "scalar"]


class _Refused(click.ClickException):
    """One line on standard error and exit status 2."""

    exit_code = 2

    def show(self, file: Any = None) -> None:
        click.echo(f"tumble: {' '.join(self.message.split())}", file=file, err=True)


@contextmanager
def _in_one_line() -> Iterator[None]:
    """Errors of tumble, of arguments and of files, in one line."""
    try:
        yield
    except TumbleError as error:
        raise _Refused(str(error)) from error
    except click.UsageError as error:
        if "\n" in error.message:
            raise  # no arguments: the help
        command = error.ctx.command_path if error.ctx else "tumble"
        raise _Refused(f"{error.format_message().rstrip('.')}; see `{command} --help`") from None
    except OSError as error:
        if error.errno == errno.EPIPE:
            raise
        raise _Refused(f"{error.filename or 'standard output'}: {error.strerror or error}") from error


class _Commands(click.Group):
    """Commands whose errors are one line on standard error, with exit status 2."""

    def make_context(self, *args: Any, **extra: Any) -> click.Context:
        with _in_one_line():
            return super().make_context(*args, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        with _in_one_line():
            return super().invoke(ctx)


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="tumble")
def main() -> None:
    """Calibrate strapdown inertial measurement units on equipment that is not precise."""


def _with_progress(log: Log) -> Iterator[Chunk]:
    """The chunks of a log; on a terminal, with a progress bar once reading has taken a second."""
    if not sys.stderr.isatty():
        yield from log.chunks()
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    started = time.monotonic()
    columns = TextColumn("reading"), BarColumn(), TextColumn("{task.completed:,.0f} samples"), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=None, visible=False)
        for chunk in log.chunks():
            bar.update(task, advance=len(chunk.time), visible=time.monotonic() - started > 1.0)
            yield chunk


@main.command()
@click.argument("sessions", metavar="SESSION...", type=EXISTING_FOLDER, nargs=-1, required=True)
@click.option("--method", type=click.Choice(METHODS), default=METHODS[0], show_default=True, help="How to estimate.")
@click.option("--iterations", type=click.IntRange(min=1), help="Passes of sequential and scalar; default 2.")
@click.option("--out", type=FILE, help="Calibration file to write; default: calibration.json in the session folder.")
@click.option("--force", is_flag=True, help="Replace a calibration file that came from another log or method.")
@click.option("--truth", type=FILE, help="truth.json of a simulated session: show true values beside the result.")
def calibrate(
    sessions: tuple[Path, ...], method: str, iterations: int | None, out: Path | None, force: bool, truth: Path | None
) -> None:
    """Calibrate the device of SESSION, a folder with session.toml and a log.

    Several sessions of one device are launches: every launch is shown with the mean and the standard deviation from
    launch to launch, and --out is required.
    """
    from tumble.calibration import calibrate
    from tumble.launches import Run, mean_of_launches
    from tumble.session import read_session
    from tumble.text import calibration_report, print_report

    if len(sessions) > 1 and out is None:
        raise InputError("--out: expected a file for the result of several sessions, found none; give --out FILE.json")
    known = _read_truth(truth) if truth else None
    described = [read_session(session) for session in sessions]
    runs = [
        Run(
            session=session,
            calibration=calibrate(session, method=method, iterations=iterations, progress=_with_progress),
        )
        for session in described
    ]
    result = mean_of_launches(runs) if len(runs) > 1 else runs[0].calibration
    target = out or described[0].folder / "calibration.json"
    result.write(target, force=force)
    print_report(calibration_report(result, known))
    click.echo(f"written to {target}", err=True)
    for reason in result.outcome.reasons:
        click.echo(f"not accepted: {reason}", err=True)
    sys.exit(0 if result.outcome.accepted else 1)


def _read_truth(path: Path) -> dict[str, float]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: expected a truth.json as `tumble simulate` writes it: {error.strerror}") from error
    except ValueError as error:
        raise InputError(f"{path}: expected a truth.json as `tumble simulate` writes it: {error}") from error
    if not isinstance(content, dict) or not all(map(_finite, content.values())):
        raise InputError(f"{path}: expected an object of parameter names and numbers, found something else")
    return content


def _finite(value: object) -> bool:
    return isinstance(value, float | int) and not isinstance(value, bool) and math.isfinite(value)


@main.command()
@click.argument("folder", type=EXISTING_FOLDER)
@click.option("--programme", default="rough-table", show_default=True, help="Built-in programme to go through.")
@click.option("--positions", type=int, help="Hand-held instead: this many positions in any attitude.")
@click.option("--grade", default="navigation", show_default=True, help="navigation, tactical, mems or consumer.")
@click.option("--rest", type=float, help="Duration of a rest, s; default 60, by hand 5.")
@click.option("--rate", type=float, help="Rate of the turns, °/s; default 10, by hand 80.")
@click.option("--sample-rate", type=float, help="Samples per second; default 100.")
@click.option("--table-error", type=float, default=1.0, show_default=True, help="Largest error of a position, °.")
@click.option("--mounting-error", type=float, default=1.0, show_default=True, help="Largest error of the mounting, °.")
@click.option("--latitude", type=float, default=56.84, show_default=True, help="Latitude of the site, °.")
@click.option("--noiseless", is_flag=True, help="No noise and no instability.")
@click.option("--vibration", metavar="AMPLITUDE@HZ", help="Vibration throughout, m/s² at Hz, e.g. 0.05@30.")
@click.option("--format", "log_format", type=click.Choice(["csv", "parquet"]), default="parquet", show_default=True)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Number of the device.")
@click.option("--launch", type=click.IntRange(min=0), default=1, show_default=True, help="Launch of that device.")
def simulate(
    folder: Path,
    programme: str,
    positions: int | None,
    grade: str,
    rest: float | None,
    rate: float | None,
    sample_rate: float | None,
    table_error: float,
    mounting_error: float,
    latitude: float,
    noiseless: bool,
    vibration: str | None,
    log_format: Literal["csv", "parquet"],
    seed: int,
    launch: int,
) -> None:
    """Write a session with known truth (truth.json) into FOLDER."""
    from tumble.simulate import Request, Vibration, simulate_session, vibration_of

    request = Request(
        grade=grade,
        programme=programme,
        positions=positions,
        rest=rest,
        rate_deg_s=rate,
        sample_rate=sample_rate,
        table_error_deg=table_error,
        mounting_error_deg=mounting_error,
        latitude_deg=latitude,
        noiseless=noiseless,
        vibration=vibration_of(vibration) if vibration else Vibration(),
    )
    written = simulate_session(folder, request, seed=seed, launch=launch, log_format=log_format)
    click.echo(f"written to {written}", err=True)


@main.command()
@click.argument("session", type=EXISTING_FOLDER)
def inspect(session: Path) -> None:
    """Show the rests and turns found in SESSION, and what was rejected and why."""
    from tumble.calibration import inspect_session
    from tumble.session import read_session
    from tumble.text import inspection_report, print_report

    segmentation, observations, faults = inspect_session(read_session(session), progress=_with_progress)
    print_report(inspection_report(segmentation, observations))
    for fault in faults:
        click.echo(f"fault: {fault}", err=True)


@main.command()
@click.argument("recording", metavar="SESSION|LOG", type=EXISTING_FOLDER)
@click.option("--plot", type=FILE, help="Draw the Allan deviations into this .svg, .png or .pdf.")
@click.option("--accel", metavar="COLUMNS", help="LOG: columns of the accelerometers, with commas between them.")
@click.option("--accel-unit", default="m/s^2", show_default=True, help="LOG: their unit.")
@click.option("--gyro", metavar="COLUMNS", help="LOG: columns of the gyros.")
@click.option("--gyro-unit", default="rad/s", show_default=True, help="LOG: their unit.")
@click.option("--time", "time_column", metavar="COLUMN", help="LOG: column of the time, s.")
@click.option("--rate-hz", type=float, help="LOG: sample rate, where there is no time column.")
def noise(
    recording: Path,
    plot: Path | None,
    accel: str | None,
    accel_unit: str,
    gyro: str | None,
    gyro_unit: str,
    time_column: str | None,
    rate_hz: float | None,
) -> None:
    """Allan deviation: the noise of every sensor, from the longest rest of SESSION or from all of a LOG at rest.

    LOG is a .csv (.gz, .zst) or .parquet file; it needs --accel, and --time or --rate-hz.
    """
    from tumble.noise import plot as draw
    from tumble.quiet_record import longest_rest, noise_panels, whole_log
    from tumble.session import read_session
    from tumble.text import noise_report, print_report

    if not recording.exists():
        raise InputError(f"{recording}: expected a session folder or a log, found no such file")
    if recording.is_dir() or recording.suffix == ".toml":
        record = longest_rest(read_session(recording))
    else:
        if accel is None:
            raise InputError(f"{recording}: expected --accel with the columns of the accelerometers, found none")
        layout: dict[str, Any] = {"accel": {"columns": accel.split(","), "unit": accel_unit}}
        layout |= {"gyro": {"columns": gyro.split(","), "unit": gyro_unit}} if gyro else {}
        layout |= {"time": time_column} if time_column else {}
        layout |= {"rate_hz": rate_hz} if rate_hz is not None else {}
        record = whole_log(recording, layout)
    panels = noise_panels(record)
    if plot is not None:
        draw(panels, plot)
        click.echo(f"written to {plot}", err=True)
    print_report(noise_report(record.source, panels))


@main.command()
@click.argument("name", metavar="[NAME]", required=False)
@click.option("--attitude", "attitudes", multiple=True, help="Instead of NAME: a position's attitude code; repeat.")
@click.option("--rest", type=float, default=60.0, show_default=True, help="Duration of a rest, s.")
@click.option("--rate", type=float, default=10.0, show_default=True, help="Rate of the turns, °/s.")
@click.option("-o", "--out", type=FILE, help="Write the sheet with a picture of each position: .html or .svg.")
def programme(name: str | None, attitudes: tuple[str, ...], rest: float, rate: float, out: Path | None) -> None:
    """The operator's sheet of a built-in programme NAME or of a list of attitudes."""
    from tumble.programme import from_attitudes
    from tumble.programme import programme as built_in
    from tumble.sheet import sheet_table, write_sheet
    from tumble.text import print_report
    from tumble.units import DEGREE

    if (name is None) == (not attitudes):
        raise InputError("expected either the NAME of a programme or --attitude for each position")
    listed = from_attitudes(list(attitudes)) if name is None else built_in(name)
    table = sheet_table(listed, rest=rest, rate=rate * DEGREE)
    if out is not None:
        write_sheet(out, listed, rest=rest, rate=rate * DEGREE)
        click.echo(f"written to {out}", err=True)
    print_report(table)


def _setup_options(command: Callable[..., None]) -> Callable[..., None]:
    """The options that describe a set-up before anything is measured."""
    for option in reversed(
        [
            click.option("--programme", default="rough-table", show_default=True, help="Built-in programme."),
            click.option("--grade", default="navigation", show_default=True, help="Class of the instrument."),
            click.option("--table-error", type=float, default=1.0, show_default=True, help="Of a position, ±°."),
            click.option("--mounting-error", type=float, default=1.0, show_default=True, help="Of the launch, ±°."),
            click.option("--rest", type=float, default=60.0, show_default=True, help="Duration of a rest, s."),
            click.option("--rate", type=float, default=10.0, show_default=True, help="Rate of the turns, °/s."),
            click.option("--latitude", type=float, default=56.84, show_default=True, help="Of the site, °."),
            click.option("--gravity", type=float, help="Measured gravity, m/s²; default: normal gravity."),
            click.option("--gravity-u", type=float, default=0.0, show_default=True, help="Its uncertainty, m/s²."),
            click.option("--noiseless", is_flag=True, help="Errors of the method alone."),
        ]
    ):
        command = option(command)
    return command


def _setup(options: dict[str, Any]) -> Setup:
    """A set-up from the options of `_setup_options`."""
    from tumble.budget import Setup
    from tumble.earth import normal_gravity
    from tumble.grades import NoiseModel, grade
    from tumble.programme import programme
    from tumble.units import DEGREE

    kind = grade(options["grade"])
    latitude = options["latitude"] * DEGREE
    return Setup(
        table_error=options["table_error"] * DEGREE,
        mounting_error=options["mounting_error"] * DEGREE,
        rest=options["rest"],
        turn_rate=options["rate"] * DEGREE,
        noise=NoiseModel() if options["noiseless"] else kind.noise,
        accel=kind.accel,
        gyro=kind.gyro,
        latitude=latitude,
        gravity=options["gravity"] if options["gravity"] is not None else normal_gravity(latitude, 0.0),
        gravity_u=options["gravity_u"],
        programme=programme(options["programme"]),
    )


@main.command()
@_setup_options
@click.option("--method", "methods", type=click.Choice(METHODS), multiple=True, help="Default: all of them; repeat.")
@click.option("--iterations", type=click.IntRange(1, 5), default=2, show_default=True, help="Passes.")
def budget(methods: tuple[str, ...], iterations: int, **options: Any) -> None:
    """Expected errors of a calibration before it is made, from the accuracy formulas."""
    from tumble.budget import budget
    from tumble.text import budget_report, print_report

    expected = budget(_setup(options), methods=methods or METHODS, iterations=iterations)  # type: ignore[arg-type]
    print_report(budget_report(expected))
    for remark in expected.remarks:
        click.echo(f"note: {remark}", err=True)


@main.command()
@_setup_options
@click.option("--want", "wanted", multiple=True, metavar="GROUP=VALUE", help="E.g. accel.scale=3.5ppm; repeat.")
@click.option("--relative", type=float, metavar="PERCENT", help="Wanted of every group: part of its spread, %.")
@click.option("--method", type=click.Choice(METHODS), default="sequential", show_default=True, help="Method to use.")
@click.option("--iterations", type=click.IntRange(1, 5), default=1, show_default=True, help="After so many passes.")
@click.option(
    "--gyro-bias",
    type=click.Choice(["programme", "vertical", "polar"]),
    default="programme",
    show_default=True,
    help="From all rests, or from one with the axis vertical or along the Earth's axis.",
)
def require(
    wanted: tuple[str, ...], relative: float | None, method: str, iterations: int, gyro_bias: str, **options: Any
) -> None:
    """The table, the mounting and the rests that a wanted accuracy needs; what no table can give is named."""
    from tumble.require import require, wanted_of
    from tumble.text import print_report, requirements_report

    setup = _setup(options)
    asked = wanted_of(wanted, relative, setup)
    needs = require(asked, setup, method=method, iteration=iterations, gyro_bias=gyro_bias)  # type: ignore[arg-type]
    print_report(requirements_report(needs))
    sys.exit(0 if needs.feasible else 1)


if __name__ == "__main__":
    main()
