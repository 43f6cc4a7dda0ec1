"""The command line: data on standard output, messages on standard error.

Exit status 0: accepted; 1: not accepted, with the reasons on standard error; 2: unusable input or arguments; 70: an
error of the program; 130: stopped (Ctrl-C); 143: ended by SIGTERM.
"""

from __future__ import annotations

import atexit
import errno
import gc
import os
import signal
import sys
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from importlib import import_module
from types import FrameType
from typing import Any

import click

from tumble import __version__
from tumble.documents import one_line
from tumble.errors import TumbleError, did_you_mean
from tumble.files import is_removing
from tumble.plugins import entry_points_of, load, package_of
from tumble.program_errors import check_memory_limits, ended_by

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices are small: threads would only wait for each other
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # the search goes through all installed packages
gc.set_threshold(200_000)  # a short command makes about as many objects, all in use
atexit.register(gc.freeze)  # a last collection would take a fifth of the time of a short command


class _Refused(click.ClickException):
    """Error that is one line on standard error, with exit status 2."""

    exit_code = 2

    def show(self, file: Any = None) -> None:
        click.echo(f"tumble: {one_line(self.message)}", file=file, err=True)


@contextmanager
def _in_one_line() -> Iterator[None]:
    """Turn errors of tumble, of arguments and of files into one line."""
    try:
        yield
    except TumbleError as error:
        raise _Refused(error.for_command_line) from error
    except click.UsageError as error:
        if isinstance(error, click.exceptions.NoArgsIsHelpError):
            raise
        command = error.ctx.command_path if error.ctx else "tumble"
        raise _Refused(f"{error.format_message().rstrip('.')}; see `{command} --help`") from None
    except KeyboardInterrupt:
        click.echo("tumble: stopped", err=True)
        raise SystemExit(128 + signal.SIGINT) from None
    except EOFError as error:  # click would take it for the end of typed input, and exit with status 1
        raise RuntimeError("a file ended where more was expected") from error
    except OSError as error:
        if error.errno == errno.EPIPE:
            raise
        raise _Refused(f"{error.filename or 'standard output'}: {error.strerror or error}") from error


STUCK_SECONDS = 5.0  # s, allowed for a command to react to a signal
_ENDING = (signal.SIGINT, signal.SIGTERM)
_AGAIN = b"\0"  # requests that the last signal be sent again; no signal has this number
_AGAIN_SECONDS = 0.02  # s, before it is

COMMANDS: Mapping[str, str] = {
    "Most used": (
        "recordings.new recordings.inspect calibrate.calibrate results.check passing_on.export passing_on.report"
    ),
    "Before anything is recorded": "planning.example planning.programme planning.plan planning.simulate",
    "With a calibration": "results.apply results.compare",
    "Of other recordings": "calibrate.ellipsoid recordings.noise",
    "Many at once": "many.campaign many.fleet",
}
"""Built-in commands by purpose, in the order of the help, each as file.function of `commands/`."""
OWN_PLUGINS = "Laboratory and live page"
"""Heading of the commands of `lab` and `bench`."""
_FILES = dict(place.split(".")[::-1] for group in COMMANDS.values() for place in group.split())
"""File of each built-in command."""


def first_sentence(docstring: str) -> str:
    """Return the summary of a command in the list of commands."""
    return " ".join(docstring.split("\n\n")[0].split()).partition(". ")[0].removesuffix(".") + "."


class _Commands(click.Group):
    """Group of commands that take its options too. Errors are one line on standard error: exit status 2, or 70 for
    errors of the program."""

    def __call__(self, *args: Any, **extra: Any) -> Any:
        try:
            return super().__call__(*args, **extra)
        except (SystemExit, GeneratorExit):
            raise
        except BaseException as error:  # a panic of polars is no Exception
            raise SystemExit(ended_by(error)) from None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands by purpose, each with its first sentence; those of other packages by package."""
        points = {name: point for name, point in entry_points_of("commands").items() if name not in _FILES}
        listed = {title: [place.partition(".")[2] for place in places.split()] for title, places in COMMANDS.items()}
        for name, point in points.items():
            package = package_of(point)
            listed.setdefault(OWN_PLUGINS if package == "tumble" else f"From {package}", []).append(name)
        with formatter.section("Commands"):
            for title, names in listed.items():
                formatter.write_text(title)
                with formatter.indentation():
                    formatter.write_dl([(name, self._sentence(ctx, name)) for name in names])

    def _sentence(self, ctx: click.Context, name: str) -> str:
        try:
            command = self.get_command(ctx, name)
        except TumbleError:  # its package is broken or missing
            return "Cannot be imported."
        return first_sentence("" if command is None else command.help or "")

    def list_commands(self, ctx: click.Context) -> list[str]:
        del ctx
        return [*dict.fromkeys([*_FILES, *entry_points_of("commands")])]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command; None if there is none of this name."""
        if cmd_name not in self.commands:
            command: click.Command | None
            try:
                if cmd_name in _FILES:
                    command = getattr(import_module(f"tumble.commands.{_FILES[cmd_name]}"), cmd_name)
                else:
                    command = load("commands", cmd_name, click.Command)
            except TumbleError:
                if ctx.resilient_parsing:  # completion by the shell
                    return None
                raise
            if command is None:
                return None
            for part in (command, *getattr(command, "commands", {}).values()):
                part.short_help = first_sentence(part.help or "")
                own = {name for option in part.params for name in option.opts}
                part.params += [option for option in self.params if own.isdisjoint(option.opts)]
            self.add_command(command, cmd_name)
        return self.commands[cmd_name]

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if self.get_command(ctx, args[0]) is None and not ctx.resilient_parsing:
            ctx.fail(f"No such command {args[0]!r}{did_you_mean(args[0], self.list_commands(ctx))}")
        return super().resolve_command(ctx, args)

    def make_context(self, *args: Any, **extra: Any) -> click.Context:
        with _in_one_line():
            return super().make_context(*args, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        with _in_one_line(), _ended_by_signals():
            return super().invoke(ctx)


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option(
    *("-q", "--quiet"), is_flag=True, expose_value=False, help="Print only results, reasons and errors, no notes."
)
@click.version_option(__version__, prog_name="tumble")
@click.pass_context
def main(context: click.Context) -> None:
    """Calibrate strapdown inertial measurement units on equipment that is not precise."""
    from tumble.recording.panic import COMMAND_LINE

    check_memory_limits()
    context.call_on_close(partial(COMMAND_LINE.reset, COMMAND_LINE.set(True)))
    warnings.filterwarnings("ignore", message="(Duplicate|Unreadable) variable")  # of scipy, on a damaged MATLAB file


@contextmanager
def _ended_by_signals() -> Iterator[None]:
    """Make SIGINT and SIGTERM end the block like an error, so that nothing half written is left.

    The block ends with KeyboardInterrupt or SystemExit even if a library turns these into an error of its own. A signal
    that comes while files are removed, or whose exception is lost in a destructor, is sent again a moment later. A
    command that does not react within STUCK_SECONDS, as in a library whose threads wait for each other, is ended at
    once. Signals that the process ignores, as under `nohup`, stay ignored."""
    import socket
    import threading

    if threading.current_thread() is not threading.main_thread():
        yield
        return
    reacted, received = threading.Event(), list[int]()

    def interruption() -> BaseException:
        return KeyboardInterrupt() if received[-1] == signal.SIGINT else SystemExit(128 + received[-1])

    def end(number: int, frame: FrameType | None) -> None:
        received.append(number)
        reacted.set()
        if not is_removing(frame):
            raise interruption()
        sender.send(_AGAIN)

    def repeat_if_lost(lost: sys.UnraisableHookArgs) -> None:
        if received and isinstance(lost.exc_value, KeyboardInterrupt | SystemExit):
            sender.send(_AGAIN)
        else:
            former_hook(lost)

    def watch() -> None:
        with receiver:
            while byte := receiver.recv(1):
                number = received[-1] if byte == _AGAIN else byte[0]
                if number not in _ENDING or signal.getsignal(number) is not end:
                    continue
                if byte == _AGAIN:
                    time.sleep(_AGAIN_SECONDS)
                    reacted.clear()
                    os.kill(os.getpid(), number)
                elif not reacted.wait(STUCK_SECONDS):
                    with suppress(OSError):
                        os.write(2, b"tumble: stopped\n")
                    os._exit(128 + number)

    receiver, sender = socket.socketpair()
    sender.setblocking(False)
    former_hook, sys.unraisablehook = sys.unraisablehook, repeat_if_lost
    with ExitStack() as undo:
        undo.enter_context(sender)
        undo.callback(setattr, sys, "unraisablehook", former_hook)
        undo.callback(signal.set_wakeup_fd, signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False))
        threading.Thread(target=watch, name="signals", daemon=True).start()
        for number in _ENDING:
            if signal.getsignal(number) not in (signal.SIG_IGN, None):
                undo.callback(signal.signal, number, signal.signal(number, end))
        try:
            yield
        except BaseException as error:
            if received and not isinstance(error, KeyboardInterrupt | SystemExit):
                raise interruption() from error
            raise
