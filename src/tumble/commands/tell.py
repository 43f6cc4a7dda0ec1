"""How commands show results, say what they did and how far they are, and end."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from tumble.commands.ask import AS_JSON

if TYPE_CHECKING:
    from tumble.recording.log import Chunk, Log
    from tumble.views.blocks import Block


def as_json() -> bool:
    """Whether --json asks for the result as data."""
    return bool(click.get_current_context().meta.get(AS_JSON))


def show(result: Any, blocks: Callable[[], Iterable[Block]], width: int | None = None) -> None:
    """Print a result, a dataclass or a dictionary, on standard output: as JSON with `--json`, else the blocks that are
    made of it; where there is no terminal sentences are broken after `width` characters, without it not at all."""
    if as_json():
        print_json(result, indent=1)
    else:
        from tumble.views.render.terminal import print_blocks

        print_blocks(*blocks(), width=width)


def print_json(result: Any, indent: int | None = None) -> None:
    """Print a result as JSON, in characters that every terminal has; without `indent` on one line."""
    import json

    from tumble.documents import as_json as data_of

    click.echo(json.dumps({"format": 1} | data_of(result), indent=indent, allow_nan=False))


def answer(line: str) -> None:
    """A line to standard output, as it can be shown."""
    from tumble.documents import plain

    click.echo(plain(line))


def say(line: str) -> None:
    """A line to standard error, as it can be shown: what was written where, notes. Nothing where `tumble -q` asks for
    results alone."""
    if not _quiet():
        warn(line)


def warn(line: str) -> None:
    """A line to standard error, as it can be shown: why a result is not accepted."""
    from tumble.documents import plain

    click.echo(plain(line), err=True)


LONGEST_REASON = 300
"""Characters of a reason where not all of them are shown: three lines of a terminal."""


def end(reasons: Iterable[str], kind: str = "", most: int | None = None) -> NoReturn:
    """End with the reasons for a negative answer on standard error, and the exit status that says whether there are.
    With `most`, at most so many, each without the clauses beyond LONGEST_REASON."""
    every = list(reasons)
    for reason in every[:most]:
        warn(f"{kind}{reason if most is None else _first_clauses(reason)}")
    if most is not None and len(every) > most:
        warn(f"{kind}{len(every) - most} more reasons: --all")
    sys.exit(1 if every else 0)


def _first_clauses(reason: str) -> str:
    """The clauses of a sentence, with semicolons between them, that fit into LONGEST_REASON characters."""
    kept, *others = reason.split("; ")
    for clause in others:
        if len(kept) + len(clause) > LONGEST_REASON:
            return f"{kept} (more: --all)"
        kept += f"; {clause}"
    return kept


def _quiet() -> bool:
    """Whether `tumble -q` asks for results alone."""
    context = click.get_current_context(silent=True)
    return context is not None and bool(context.find_root().params.get("quiet"))


SHOWN = 20
"""Of many tasks that went wrong, so many are named on standard error."""

Tell = Callable[[int, int], None]
"""What is told the number of tasks that are done and of all."""


_CLEARED = "\r\x1b[K"
"""The beginning of a line of the terminal, which is empty then."""
_REDRAWN = 0.2  # s


@contextmanager
def working(what: str) -> Iterator[Tell]:
    """A function that is told how much is done; on a terminal a line that says so, with the time that has passed and,
    as far as it can be told, the time that is left. It is gone at the end."""
    if _quiet() or sys.stderr is None or not sys.stderr.isatty():
        yield lambda _done, _all: None
        return
    started, counts, ended = time.monotonic(), (0, 0), threading.Event()

    def tell(done: int, every: int) -> None:
        nonlocal counts
        counts = done, every

    def draw() -> None:
        while True:
            (done, every), passed = counts, time.monotonic() - started
            parts = [what, f"{done} of {every}" if every else f"{done}" if done else "", f"{passed:.0f} s"]
            parts.append(f"{passed * (every - done) / done:.0f} s left" if 0 < done < every and passed > 1.0 else "")
            click.echo(_CLEARED + "  ".join(filter(None, parts)), err=True, nl=False)
            if ended.wait(_REDRAWN):
                return

    drawing = threading.Thread(target=draw, name="progress", daemon=True)
    drawing.start()
    try:
        yield tell
    finally:
        ended.set()
        drawing.join()
        click.echo(_CLEARED, err=True, nl=False)


def with_progress(log: Log) -> Iterator[Chunk]:
    """The chunks of a log; on a terminal with the samples that are read."""
    with working("reading") as tell:
        yield from _counted(log, tell)


@contextmanager
def estimating() -> Iterator[Callable[[Log], Iterator[Chunk]]]:
    """What reads a log for an estimate; a terminal shows the samples that are read, and for how long the estimate has
    gone on."""
    with working("estimating") as tell:
        yield lambda log: _counted(log, tell)


def _counted(log: Log, tell: Tell) -> Iterator[Chunk]:
    read = 0
    for chunk in log.chunks():
        read += len(chunk.time)
        tell(read, 0)
        yield chunk
    tell(0, 0)


@contextmanager
def task_progress(what: str, out: Path) -> Iterator[Tell]:
    """A function that is told how many of the tasks of a folder are done; on a terminal it shows them, with the
    remaining time. Where it is told nothing, all were done before: that is said."""
    news = []
    with working(what) as tell_bar:

        def tell(done: int, every: int) -> None:
            news.append(done)
            tell_bar(done, every)

        yield tell
    if not news:
        say(f"{out} was complete: no {what} were computed; to compute them anew give another folder")
