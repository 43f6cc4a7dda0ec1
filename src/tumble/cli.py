"""The command line. Data to standard output, talk to standard error. Exit status 0 accepted, 1 not accepted (reasons
on standard error), 2 unusable input or arguments, 70 an error of the program, 130 stopped."""

from __future__ import annotations

import atexit
import errno
import gc
import os
import signal
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from importlib import import_module
from typing import Any, NoReturn

import click

from tumble import __version__
from tumble.documents import one_line
from tumble.errors import TumbleError
from tumble.plugins import entry_points_of, load, package_of
from tumble.program_errors import check_memory_limits, ended_by

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices are small: threads would only wait for each other
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # which looks for them in all that is installed
gc.set_threshold(200_000)  # objects, all in use, that a short command makes: searches for garbage among them find none
atexit.register(gc.freeze)  # nor does a process that ends need one, which takes a fifth of a short command


class _Refused(click.ClickException):
    """One line on standard error and exit status 2."""

    exit_code = 2

    def show(self, file: Any = None) -> None:
        click.echo(f"tumble: {one_line(self.message)}", file=file, err=True)


@contextmanager
def _in_one_line() -> Iterator[None]:
    """Errors of tumble, of arguments and of files, in one line."""
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
    except EOFError as error:  # which click would take for the end of what is typed, and end with the status 1
        raise RuntimeError("a file ended where more was expected") from error
    except OSError as error:
        if error.errno == errno.EPIPE:
            raise
        raise _Refused(f"{error.filename or 'standard output'}: {error.strerror or error}") from error


STUCK_SECONDS = 5.0
"""How long a command may take to notice that it is to end."""

COMMANDS: Mapping[str, str] = {
    "Most used": (
        "recordings.new recordings.inspect calibrate.calibrate results.check passing_on.export passing_on.report"
    ),
    "Before anything is recorded": "planning.example planning.programme planning.plan planning.simulate",
    "With a calibration": "results.apply results.compare",
    "Of other recordings": "calibrate.ellipsoid recordings.noise",
    "Many at once": "many.campaign many.fleet",
}
"""The built-in commands by what they are for, in the order of the list, each as file.function of `commands/`."""

OWN_PLUGINS = "Laboratory and live page"
"""Heading of the commands that `lab` and `bench` bring."""

_FILES = dict(place.split(".")[::-1] for group in COMMANDS.values() for place in group.split())
"""The file of each built-in command."""


def first_sentence(docstring: str) -> str:
    """What the list of commands says of one."""
    return " ".join(docstring.split("\n\n")[0].split()).partition(". ")[0].removesuffix(".") + "."


class _Commands(click.Group):
    """Commands whose errors are one line on standard error, with exit status 2; those of the program itself with 70."""

    def __call__(self, *args: Any, **extra: Any) -> Any:
        try:
            return super().__call__(*args, **extra)
        except (SystemExit, GeneratorExit):
            raise
        except BaseException as error:  # a panic of polars is no Exception
            raise SystemExit(ended_by(error)) from None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The commands by what they are for, each with its first sentence; those of other packages below the name of
        the package."""
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
        """The first sentence of the help of a command."""
        try:
            command = self.get_command(ctx, name)
        except TumbleError:  # of a package that is broken or gone
            return "Cannot be imported."
        return first_sentence("" if command is None else command.help or "")

    def list_commands(self, ctx: click.Context) -> list[str]:
        del ctx
        return [*dict.fromkeys([*_FILES, *entry_points_of("commands")])]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """A command, imported when it is first asked for; None where there is none of this name."""
        if cmd_name not in self.commands:
            command: click.Command | None
            try:
                if cmd_name in _FILES:
                    command = getattr(import_module(f"tumble.commands.{_FILES[cmd_name]}"), cmd_name)
                else:
                    command = load("commands", cmd_name, click.Command)
            except TumbleError:
                if ctx.resilient_parsing:  # the shell completes what is typed
                    return None
                raise
            if command is None:
                return None
            for part in getattr(command, "commands", {}).values():
                part.short_help = first_sentence(part.help or "")
            self.add_command(command, cmd_name)
        return self.commands[cmd_name]

    def make_context(self, *args: Any, **extra: Any) -> click.Context:
        with _in_one_line():
            return super().make_context(*args, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        with _in_one_line():
            return super().invoke(ctx)


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.option("-q", "--quiet", is_flag=True, help="Results, reasons and errors alone: no notes on standard error.")
@click.version_option(__version__, prog_name="tumble")
@click.pass_context
def main(context: click.Context, quiet: bool) -> None:  # noqa: ARG001 (`tell` reads it)
    """Calibrate strapdown inertial measurement units on equipment that is not precise."""
    from tumble.recording.panic import COMMAND_LINE

    check_memory_limits()
    context.call_on_close(_ended_in_order())
    context.call_on_close(partial(COMMAND_LINE.reset, COMMAND_LINE.set(True)))
    warnings.filterwarnings("ignore", message="(Duplicate|Unreadable) variable")  # of scipy, on a damaged MATLAB file


def _ended_in_order() -> Callable[[], object]:
    """Ends the command where the system asks it to (SIGTERM) as an error does: nothing half written is left. Where the
    command does not get to it, as in a library whose threads wait for each other, it ends without that. Gives a
    function that undoes this."""
    import socket
    import threading

    ending = threading.Event()

    def end(number: int, _frame: object) -> NoReturn:
        ending.set()
        raise SystemExit(128 + number)

    def end_if_stuck() -> None:
        with heard:
            while number := heard.recv(1):
                asked = number[0] == signal.SIGTERM and signal.getsignal(signal.SIGTERM) is end
                if asked and not ending.wait(STUCK_SECONDS):
                    with suppress(OSError):
                        os.write(2, b"tumble: stopped\n")
                    os._exit(128 + signal.SIGTERM)

    if threading.current_thread() is not threading.main_thread():
        return lambda: None
    heard, told = socket.socketpair()
    told.setblocking(False)
    undo = ExitStack()
    undo.enter_context(told)
    undo.callback(signal.set_wakeup_fd, signal.set_wakeup_fd(told.fileno(), warn_on_full_buffer=False))
    undo.callback(signal.signal, signal.SIGTERM, signal.signal(signal.SIGTERM, end))
    threading.Thread(target=end_if_stuck, name="stuck", daemon=True).start()
    return undo.close
