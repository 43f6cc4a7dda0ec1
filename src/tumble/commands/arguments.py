"""What several commands ask for: paths, methods, a set-up; and the progress of reading."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from tumble.planning.budget import Setup
    from tumble.recording.log import Chunk, Log


class _NamedPath(click.Path):
    """A path that is not empty: an empty one, as of a variable that is not set, would be the working folder."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value == "":
            self.fail("expected a path, found an empty one", param, ctx)
        return super().convert(value, param, ctx)


EXISTING_FOLDER = _NamedPath(path_type=Path)
FILE = _NamedPath(path_type=Path, dir_okay=False)
FOLDER = _NamedPath(path_type=Path, file_okay=False)
METHODS = ["joint", "staged", "sequential", "scalar", "ellipsoid"]
BUDGETED_METHODS = ["staged", "sequential", "scalar"]
"""Methods whose errors are known before anything is measured."""
FRAMES = ["accelerometer", "case", "paper", "symmetric"]


def with_progress(log: Log) -> Iterator[Chunk]:
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


def setup_options(command: Callable[..., None]) -> Callable[..., None]:
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


def setup_of(options: dict[str, Any]) -> Setup:
    """A set-up from the options of `setup_options`."""
    from tumble.earth import normal_gravity
    from tumble.planning.budget import Setup
    from tumble.programme.positions import programme
    from tumble.sensors.grades import NoiseModel, grade
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


def cluster_options(command: Callable[..., None]) -> Callable[..., None]:
    """The options that say where many tasks are computed, and into which folder."""
    for option in reversed(
        [
            click.option("--serial", is_flag=True, help="Compute in this process."),
            click.option("--cluster", metavar="tcp://HOST:PORT", help="Compute on a dask cluster that is there."),
            click.option("--workers", type=click.IntRange(min=1), help="Processes here; default: one a core."),
            click.option("-o", "--out", type=FOLDER, required=True, help="Folder for the results; resumed if begun."),
        ]
    ):
        command = option(command)
    return command


@contextmanager
def task_progress(what: str) -> Iterator[Callable[[int, int], None]]:
    """A function to be called with the number of tasks that are done and of all; on a terminal it shows a progress bar
    with the remaining time."""
    if not sys.stderr.isatty():
        yield lambda _done, _all: None
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    left = TextColumn("left"), TimeRemainingColumn()
    columns = TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), *left
    with Progress(*columns, console=Console(stderr=True), transient=True, speed_estimate_period=120.0) as bar:
        task = bar.add_task("", total=None)
        yield lambda done, every: bar.update(task, completed=done, total=every)
