"""The command line. Data to standard output, talk to standard error. Exit status 0 accepted, 1 not accepted (reasons
on standard error), 2 unusable input or arguments."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pkgutil import iter_modules
from typing import Any

import click

from tumble import __version__, commands
from tumble.documents import one_line
from tumble.errors import TumbleError

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices are small: threads would only wait for each other


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


for module in iter_modules(commands.__path__):
    if module.name != "arguments":
        main.add_command(getattr(import_module(f"tumble.commands.{module.name}"), module.name))


if __name__ == "__main__":
    main()
