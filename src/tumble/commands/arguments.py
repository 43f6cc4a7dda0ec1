"""What several commands ask for, each option declared once with one meaning; and how results and progress are shown."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from tumble import usual_setup

if TYPE_CHECKING:
    from rich.progress import ProgressColumn

    from tumble.drafting.new_session import Given
    from tumble.planning.error_propagation import BudgetedMethod
    from tumble.planning.setup import Setup
    from tumble.recording.log import Chunk, Log
    from tumble.views.blocks import Block


_Command = Callable[..., None]
_Option = Callable[[_Command], _Command]


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


# -------------------- options --------------------


def option(name: str, says: str, default: Any = None, **settings: Any) -> _Option:
    """An option, whose default is shown where it has one."""
    if default is not None:
        settings |= {"default": default, "show_default": True}
    return click.option(*name.split("/"), help=says, **settings)


def together(*options: _Option) -> _Option:
    """Several options as one."""

    def with_all(command: _Command) -> _Command:
        for each in reversed(options):
            command = each(command)
        return command

    return with_all


def programmes_like(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[str]:
    """The built-in programmes that begin with what was typed, for the tab key."""
    from tumble.programme.positions import BUILT_IN

    return [name for name in BUILT_IN if name.startswith(typed)]


def _grades_like(_context: click.Context, _parameter: click.Parameter, typed: str) -> list[str]:
    """The grades that begin with what was typed, for the tab key."""
    from tumble.sensors.grades import GRADES

    return [name for name in GRADES if name.startswith(typed)]


def out_option(says: str, kind: click.Path = FILE, **settings: Any) -> _Option:
    """Where a result is written."""
    return click.option("-o", "--out", type=kind, help=says, **settings)


def force_option(says: str = "Replace an existing file.") -> _Option:
    """Whether a file is replaced."""
    return click.option("--force", is_flag=True, help=says)


def programme_option(says: str, default: str | None = None) -> _Option:
    """A built-in programme."""
    return option("--programme", says, default, shell_complete=programmes_like)


def grade_option(default: str | None = usual_setup.GRADE, says: str = "") -> _Option:
    """The grade of the instrument."""
    return option("--grade", f"navigation, tactical, mems or consumer{says}.", default, shell_complete=_grades_like)


def terms_option(default: str | None = "linear") -> _Option:
    """The groups of parameters that the instrument has."""
    says = "Groups of parameters: all (full), or bias, scale factor and axis angles alone (linear)."
    further = "" if default else " Default: full for joint, linear for the others."
    return option("--terms", says + further, default, type=click.Choice(["full", "linear"]))


def frame_option(frames: list[str] = FRAMES) -> _Option:
    """The frame of a result."""
    return option("--frame", "Of the result.", frames[0], type=click.Choice(frames))


def method_option(methods: list[str], default: str | list[str] | None, says: str, **settings: Any) -> _Option:
    """How to estimate."""
    return option("--method", says, default, type=click.Choice(methods), **settings)


WANT = option("--want/wanted", "E.g. accel.scale=3.5ppm; repeat.", multiple=True, metavar="GROUP=VALUE")
JSON = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON, in SI, instead of tables.")
EVERY = click.option("--all", "every", is_flag=True, help="Show every parameter and every table.")
CERTIFICATE = option("--certificate", "TOML file with laboratory, customer, number: of a certificate.", type=FILE)
REGISTRY = option(
    "--registry/place",
    "An SQLite file or postgresql://USER@HOST/NAME; default: TUMBLE_REGISTRY, else a file of the user's.",
    metavar="FILE|URL",
    envvar="TUMBLE_REGISTRY",
)


def known_launches_option(says: str) -> _Option:
    """The registry whose launches a result is judged by."""
    return option("--known-launches", says, metavar="FILE|URL")


GRAVITY = option("--gravity", "Measured gravity, m/s²; default: normal gravity.", type=float)
LATITUDE = option("--latitude", "Of the place, ° north.", type=float, metavar="DEGREES")
SERIAL = option("--serial", "Serial number of the device; default: the name of FOLDER or LOG.", metavar="NUMBER")
SAMPLE_RATE = "--sample-rate", "Samples per second"
LOG_OPTIONS = together(
    option(SAMPLE_RATE[0], f"Of a LOG: {SAMPLE_RATE[1]}, instead of the times in it.", type=float, metavar="HZ"),
    option("--accel", "Of a LOG: columns of the accelerometers, names or numbers from 1.", metavar="N,N,N"),
    option("--gyro", "Of a LOG: columns of the gyros, names or numbers from 1.", metavar="N,N,N"),
    option("--time", "Of a LOG: column of the time, its name or number from 1.", metavar="N"),
)
"""What is known of a log that no session describes."""


def given_of(options: dict[str, Any]) -> Given:
    """What is said of a log, of options that are taken out of all."""
    from tumble.drafting.new_session import Given

    of_log = {name: options.pop(name, None) for name in ("serial", "latitude", "sample_rate", "programme", "message")}
    columns = {name: tuple((options.pop(name) or "").split(",")) for name in ("accel", "gyro")}
    stated: dict[str, Any] = of_log | {name: () if one == ("",) else one for name, one in columns.items()}
    return Given(time=options.pop("time"), **stated)


TABLE_ERROR = option("--table-error", "Largest error of a position, °.", usual_setup.TABLE_ERROR_DEG, type=float)
MOUNTING_ERROR = option(
    "--mounting-error", "Largest error of the mounting, °.", usual_setup.MOUNTING_ERROR_DEG, type=float
)
SITE_LATITUDE = option("--latitude", "Of the site, ° north.", usual_setup.LATITUDE_DEG, type=float)
NOISELESS = click.option("--noiseless", is_flag=True, help="No noise and no instability: errors of the method alone.")
PACE = together(
    option("--rest", "Duration of a rest, s.", usual_setup.ON_TABLE.rest, type=float),
    option("--turn-rate", "Rate of the turns, °/s.", usual_setup.ON_TABLE.rate_deg_s, type=float),
)


def setup_options(terms: str | None) -> _Option:
    """The options that describe a set-up before anything is measured."""
    return together(
        programme_option("Built-in programme.", usual_setup.PROGRAMME),
        grade_option(),
        TABLE_ERROR,
        MOUNTING_ERROR,
        PACE,
        SITE_LATITUDE,
        GRAVITY,
        option("--gravity-u", "Its uncertainty, m/s².", usual_setup.GRAVITY_U, type=float),
        terms_option(terms),
        NOISELESS,
    )


def setup_of(options: dict[str, Any]) -> Setup:
    """A set-up from the options of `setup_options` and of `simulate`, which leaves some out and has others."""
    from tumble.planning.setup import Setup

    named = {"turn_rate": "rate_deg_s", "table_error": "table_error_deg", "mounting_error": "mounting_error_deg"}
    named |= {"latitude": "latitude_deg"}
    words = {named.get(name, name): value for name, value in options.items() if name != "noiseless"}
    return Setup.of(**words, noise_factor=0.0 if options["noiseless"] else 1.0)


CLUSTER = together(
    out_option("Folder for the results; resumed if begun.", FOLDER, required=True),
    option("--workers", "Processes here; default: one a core.", type=click.IntRange(min=1)),
    option("--cluster", "Compute on a dask cluster that is there.", metavar="tcp://HOST:PORT"),
    click.option("--in-process", "serial", is_flag=True, help="Compute in this process."),
)
"""Where many tasks are computed, and into which folder."""


# -------------------- what is shown --------------------


def show(as_json: bool, data: Callable[[], dict[str, Any]], blocks: Callable[[], Iterable[Block]]) -> None:
    """Print a result as data or as tables."""
    if as_json:
        from tumble.views.render.data import print_data

        print_data(data())
    else:
        from tumble.views.render.terminal import print_blocks

        print_blocks(*blocks())


def say(line: str) -> None:
    """A line to standard error, as it can be shown: what was written where, notes. Nothing where `tumble -q` asks for
    results alone."""
    if not _quiet():
        warn(line)


def warn(line: str) -> None:
    """A line to standard error, as it can be shown: why a result is not accepted."""
    from tumble.documents import plain

    click.echo(plain(line), err=True)


def end(reasons: Iterable[str], kind: str = "") -> NoReturn:
    """End with the reasons for a negative answer on standard error, and the exit status that says whether there are."""
    every = list(reasons)
    for reason in every:
        warn(f"{kind}{reason}")
    sys.exit(1 if every else 0)


def _quiet() -> bool:
    """Whether `tumble -q` asks for results alone."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.find_root().params.get("quiet"))


SHOWN = 20
"""Of many tasks that went wrong, so many are named on standard error."""

Tell = Callable[[int, int], None]
"""What is told the number of tasks that are done and of all."""


@contextmanager
def working(what: str, *columns: type[ProgressColumn]) -> Iterator[Tell]:
    """A function that is told how much is done; on a terminal a bar, which is gone at the end, with the time that has
    passed or these columns."""
    if _quiet() or sys.stderr is None or not sys.stderr.isatty():
        yield lambda _done, _all: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    shown = TextColumn(what), BarColumn(), *(column() for column in columns or (TimeElapsedColumn,))
    with Progress(*shown, console=Console(stderr=True), transient=True, speed_estimate_period=120.0) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, every: bar.update(task, completed=done, total=every or None)


def with_progress(log: Log) -> Iterator[Chunk]:
    """The chunks of a log; on a terminal, with a progress bar once reading has taken a second."""
    started, read = time.monotonic(), 0
    chunks = iter(log.chunks())
    for chunk in chunks:
        yield chunk
        read += len(chunk.time)
        if time.monotonic() - started > 1.0:
            break
    with working("reading") as tell:
        for chunk in chunks:
            read += len(chunk.time)
            tell(read, 0)
            yield chunk


@contextmanager
def task_progress(what: str, out: Path) -> Iterator[Tell]:
    """A function that is told how many of the tasks of a folder are done; on a terminal it shows a progress bar with
    the remaining time. Where it is told nothing, all were done before: that is said."""
    from rich.progress import MofNCompleteColumn, TimeElapsedColumn, TimeRemainingColumn

    news = []
    with working(what, MofNCompleteColumn, TimeElapsedColumn, TimeRemainingColumn) as tell_bar:

        def tell(done: int, every: int) -> None:
            news.append(done)
            tell_bar(done, every)

        yield tell
    if not news:
        say(f"{out} was complete: no {what} were computed; to compute them anew give another folder")
