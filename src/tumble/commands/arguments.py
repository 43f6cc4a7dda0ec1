"""What several commands ask for: paths, methods, a set-up; and the progress of reading."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tumble import usual_setup
from tumble.documents import plain

if TYPE_CHECKING:
    from rich.progress import ProgressColumn

    from tumble.planning.error_propagation import BudgetedMethod
    from tumble.planning.setup import Setup
    from tumble.recording.log import Chunk, Log


_Command = Callable[..., None]


class _NamedPath(click.Path):
    """A path that is not empty: an empty one, as of a variable that is not set, would be the working folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "":
            self.fail("expected a path, found an empty one", param, ctx)
        return super().convert(value, param, ctx)


EXISTING_FOLDER = _NamedPath(path_type=Path)
FILE = _NamedPath(path_type=Path, dir_okay=False)
FOLDER = _NamedPath(path_type=Path, file_okay=False)
METHOD_NAMES = ["joint", "staged", "sequential", "scalar", "ellipsoid"]
BUDGETED_METHODS: list[BudgetedMethod] = ["staged", "sequential", "scalar"]
"""Methods whose errors are known before anything is measured."""
FRAMES = ["accelerometer", "case", "paper", "symmetric"]


def with_progress(log: Log) -> Iterator[Chunk]:
    """The chunks of a log; on a terminal, with a progress bar once reading has taken a second."""
    if not _watched():
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


def say(line: str) -> None:
    """A line to standard error, as it can be shown: what was written where, notes. Nothing where `tumble -q` asks for
    results alone."""
    if not _quiet():
        warn(line)


def _quiet() -> bool:
    """Whether `tumble -q` asks for results alone."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.find_root().params.get("quiet"))


def _watched() -> bool:
    """Whether progress is shown: on a terminal, unless results alone are asked for."""
    return sys.stderr is not None and sys.stderr.isatty() and not _quiet()


def warn(line: str) -> None:
    """A line to standard error, as it can be shown: why a result is not accepted."""
    click.echo(plain(line), err=True)


def programmes_like(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[str]:
    """The built-in programmes that begin with what was typed, for the tab key."""
    from tumble.programme.positions import BUILT_IN

    return [name for name in BUILT_IN if name.startswith(typed)]


def grades_like(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[str]:
    """The grades that begin with what was typed, for the tab key."""
    from tumble.sensors.grades import GRADES

    return [name for name in GRADES if name.startswith(typed)]


_Option = Callable[[_Command], _Command]


def programme_option(says: str, default: str | None = None) -> _Option:
    """The option for a built-in programme."""
    return click.option(
        "--programme", default=default, show_default=default is not None, shell_complete=programmes_like, help=says
    )


GRADE = click.option(
    "--grade",
    default=usual_setup.GRADE,
    show_default=True,
    shell_complete=grades_like,
    help="navigation, tactical, mems or consumer.",
)

JSON = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON, in SI, instead of tables.")


def number(name: str, default: float, says: str) -> _Option:
    """An option for a number that has a usual value."""
    return click.option(name, type=float, default=default, show_default=True, help=says)


def column_options(command: _Command) -> _Command:
    """The options that say which columns of a log are what."""
    for kind, many, what in (
        ("time", "N", "column of the time, its name or number"),
        ("gyro", "N,N,N", "columns of the gyros, names or numbers"),
        ("accel", "N,N,N", "columns of the accelerometers, names or numbers"),
    ):
        command = click.option(f"--{kind}", metavar=many, help=f"Of a LOG: {what} from 1.")(command)
    return command


def columns_stated(accel: str | None, gyro: str | None, time: str | None) -> dict[str, Any]:
    """What these options say, as `Given` has it."""
    return {
        "accel": () if accel is None else tuple(accel.split(",")),
        "gyro": () if gyro is None else tuple(gyro.split(",")),
        "time": time,
    }


def terms_option(default: str | None) -> _Option:
    """The option for the groups of parameters that an instrument has; without a default by the method."""
    return click.option(
        "--terms",
        type=click.Choice(["linear", "full"]),
        default=default,
        show_default=default is not None,
        help="Bias, scale and axes alone, or all groups of parameters."
        + ("" if default else " Default: full for joint, linear for the others."),
    )


TERMS = terms_option("linear")


def setup_options(command: _Command, terms: str | None = "linear") -> _Command:
    """The options that describe a set-up before anything is measured."""
    options: list[_Option] = [
        programme_option("Built-in programme.", usual_setup.PROGRAMME),
        GRADE,
        number("--table-error", usual_setup.TABLE_ERROR_DEG, "Of a position, ±°."),
        number("--mounting-error", usual_setup.MOUNTING_ERROR_DEG, "Of the launch, ±°."),
        number("--rest", usual_setup.ON_TABLE.rest, "Duration of a rest, s."),
        number("--turn-rate", usual_setup.ON_TABLE.rate_deg_s, "Rate of the turns, °/s."),
        number("--latitude", usual_setup.LATITUDE_DEG, "Of the site, °."),
        click.option("--gravity", type=float, help="Measured gravity, m/s²; default: normal gravity."),
        number("--gravity-u", usual_setup.GRAVITY_U, "Its uncertainty, m/s²."),
        terms_option(terms),
        click.option("--noiseless", is_flag=True, help="Errors of the method alone."),
    ]
    for option in reversed(options):
        command = option(command)
    return command


def setup_of(options: dict[str, Any]) -> Setup:
    """A set-up from the options of `setup_options`."""
    from tumble.planning.setup import Setup

    return Setup.of(
        grade=options["grade"],
        programme=options["programme"],
        rest=options["rest"],
        rate_deg_s=options["turn_rate"],
        table_error_deg=options["table_error"],
        mounting_error_deg=options["mounting_error"],
        latitude_deg=options["latitude"],
        gravity=options["gravity"],
        gravity_u=options["gravity_u"],
        noise_factor=0.0 if options["noiseless"] else 1.0,
        terms=options["terms"],
    )


def cluster_options(command: Callable[..., None]) -> Callable[..., None]:
    """The options that say where many tasks are computed, and into which folder."""
    for option in reversed(
        [
            click.option("--in-process", "serial", is_flag=True, help="Compute in this process."),
            click.option("--cluster", metavar="tcp://HOST:PORT", help="Compute on a dask cluster that is there."),
            click.option("--workers", type=click.IntRange(min=1), help="Processes here; default: one a core."),
            click.option("-o", "--out", type=FOLDER, required=True, help="Folder for the results; resumed if begun."),
        ]
    ):
        command = option(command)
    return command


SHOWN = 20
"""Of many tasks that went wrong, so many are named on standard error."""

Tell = Callable[[int, int], None]
"""What is told the number of tasks that are done and of all."""


@contextmanager
def task_progress(what: str, out: Path) -> Iterator[Tell]:
    """A function that is told how many of the tasks of a folder are done; on a terminal it shows a progress bar with
    the remaining time. Where it is told nothing, all were done before: that is said."""
    news = []

    def tell(done: int, every: int) -> None:
        news.append(done)
        show(done, every)

    with _task_bar(what) as show:
        yield tell
    if not news:
        say(f"{out} was complete: no {what} were computed; to compute them anew give another folder")


@contextmanager
def _task_bar(what: str) -> Iterator[Tell]:
    """On a terminal, a bar with the number of tasks and the remaining time."""
    if not _watched():
        yield _untold
        return
    from rich.progress import MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

    columns = MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn()
    with _bar(what, *columns) as told:
        yield told


@contextmanager
def working(what: str) -> Iterator[Tell]:
    """The same from the start for what takes seconds and may not know of how many parts it is: on a terminal a bar
    with the time that has passed."""
    if not _watched():
        yield _untold
        return
    from rich.progress import TimeElapsedColumn

    with _bar(what, TimeElapsedColumn()) as told:
        yield told


def _untold(_done: int, _all: int) -> None:
    """Nobody watches."""


@contextmanager
def _bar(what: str, *columns: ProgressColumn) -> Iterator[Tell]:
    """A bar with these columns on standard error, which is gone at the end."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    shown = TextColumn(what), BarColumn(), *columns
    with Progress(*shown, console=Console(stderr=True), transient=True, speed_estimate_period=120.0) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, every: bar.update(task, completed=done, total=every)
