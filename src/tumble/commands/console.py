"""Output of the commands: results, messages, progress and exit status."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click
from click.core import ParameterSource

from tumble.commands.params import AS_JSON

if TYPE_CHECKING:
    from tumble.recording.log import Chunk, Log
    from tumble.views.blocks import Block


def wants_json() -> bool:
    """Return True if --json was given."""
    return bool(click.get_current_context().meta.get(AS_JSON))


def show(result: Any, blocks: Callable[[], Iterable[Block]], width: int | None = None) -> None:
    """Print a result, a dataclass, a dictionary or a function that returns one, as JSON with `--json`, else its blocks.

    Without a terminal sentences are broken after `width` characters, or not at all if it is None."""
    if wants_json():
        print_json(result() if callable(result) else result, indent=1)
    else:
        from tumble.views.render.terminal import print_blocks

        print_blocks(*blocks(), width=width)


def print_json(result: Any, indent: int | None = None) -> None:
    """Print a result as ASCII JSON; without `indent` on one line."""
    import json

    from tumble.documents import as_json

    click.echo(json.dumps({"format": 1} | as_json(result), indent=indent, allow_nan=False))


def answer(line: str) -> None:
    """Print a line, without control characters, to standard output."""
    from tumble.documents import plain

    click.echo(plain(line))


def say(line: str) -> None:
    """Print a note to standard error, unless `tumble -q` was given."""
    if not _quiet():
        warn(line)


def warn(line: str) -> None:
    """Print a line, without control characters, to standard error."""
    from tumble.documents import plain

    click.echo(plain(line), err=True)


LONGEST_REASON = 300  # characters of a shortened reason before its last clause, three lines of a terminal


def end(reasons: Iterable[str], kind: str = "", most: int | None = None) -> NoReturn:
    """Print the reasons for a negative result to standard error, and exit with status 1 if there are any, else 0.

    With `most`, at most that many are printed, each shortened to LONGEST_REASON characters."""
    reasons = list(reasons)
    for reason in reasons[:most]:
        warn(f"{kind}{reason if most is None else _shortened(reason)}")
    if most is not None and len(reasons) > most:
        warn(f"{kind}{len(reasons) - most} more reasons: --all")
    sys.exit(1 if reasons else 0)


def _shortened(reason: str) -> str:
    """Return the first clauses of a sentence that fit into LONGEST_REASON characters, at least one, and the last.

    The clauses are those between semicolons. The last is the cause of what was found, or what to do."""
    *first, last = reason.split("; ")
    kept = ""
    for clause in first:
        if kept and len(kept) + len(clause) > LONGEST_REASON:
            return f"{kept}…; {last} (more: --all)"
        kept += f"{clause}; "
    return kept + last


def _quiet() -> bool:
    context = click.get_current_context(silent=True)
    while context is not None and context.get_parameter_source("quiet") is not ParameterSource.COMMANDLINE:
        context = context.parent
    return context is not None


SHOWN = 20  # failed tasks that are listed on standard error
Report = Callable[[int, int], None]
"""Function that receives the number of tasks done and of all."""
_CLEAR_LINE = "\r\x1b[K"
_REDRAW_INTERVAL = 0.2  # s


@contextmanager
def working(what: str) -> Iterator[Report]:
    """Yield a function that receives the amount done, which a terminal shows with elapsed and remaining time.

    The line is cleared at the end."""
    if _quiet() or sys.stderr is None or not sys.stderr.isatty():
        yield lambda _done, _all: None
        return
    started, counts, ended = time.monotonic(), (0, 0), threading.Event()

    def report(done: int, total: int) -> None:
        nonlocal counts
        counts = done, total

    def draw() -> None:
        while True:
            (done, total), elapsed = counts, time.monotonic() - started
            parts = [what, f"{done} of {total}" if total else f"{done}" if done else "", f"{elapsed:.0f} s"]
            parts.append(f"{elapsed * (total - done) / done:.0f} s left" if 0 < done < total and elapsed > 1.0 else "")
            click.echo(_CLEAR_LINE + "  ".join(filter(None, parts)), err=True, nl=False)
            if ended.wait(_REDRAW_INTERVAL):
                return

    drawing = threading.Thread(target=draw, name="progress", daemon=True)
    drawing.start()
    try:
        yield report
    finally:
        ended.set()
        drawing.join()
        click.echo(_CLEAR_LINE, err=True, nl=False)


def with_progress(log: Log) -> Iterator[Chunk]:
    """Yield the chunks of a log; a terminal shows the number of samples read."""
    with working("reading") as report:
        yield from _counted(log, report)


@contextmanager
def estimating() -> Iterator[Callable[[Log], Iterator[Chunk]]]:
    """Yield a function that reads a log for an estimate, whose progress a terminal shows until the end of the block."""
    with working("estimating") as report:
        yield lambda log: _counted(log, report)


def _counted(log: Log, report: Report) -> Iterator[Chunk]:
    samples = 0
    for chunk in log.chunks():
        samples += len(chunk.time)
        report(samples, 0)
        yield chunk
    report(0, 0)


@contextmanager
def task_progress(what: str, out: Path) -> Iterator[Report]:
    """Yield a function that receives how many of the tasks of a folder are done, and shows them on a terminal.

    If it is never called, a note states that all were done before."""
    reports = []
    with working(what) as show_progress:

        def report(done: int, total: int) -> None:
            reports.append(done)
            show_progress(done, total)

        yield report
    if not reports:
        say(f"{out} was complete: no {what} were computed; to compute them anew give another folder")
