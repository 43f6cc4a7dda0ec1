"""The exceptions of tumble, as a tree.

    TumbleError
    ├── InputError            the input cannot be used; the command line exits with 2
    │   ├── GyrosAloneError   a log without accelerometers
    │   ├── SessionError      session.toml: a key, a value, a missing file
    │   ├── LogError          a log: a column, a row, a number, the time
    │   ├── ProgrammeError    an attitude code or a programme that does not exist
    │   └── CalibrationError  a calibration file
    └── MissingExtraError     an optional dependency that is not installed

A message is one line: the place, what was expected, what was found, what to do. It names arguments as options of the
command line, `--gravity-u`; for users of the library `str()` shows `gravity_u`. Tables of session.toml are in brackets,
and those who wrote no such file are told where it is (`tables_at`). A poor result is no exception: it is an
`Estimate` whose outcome gives the reasons.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

IN_MEMORY = "session.toml; for arrays use the argument of that name without unit, or tumble.session_of"
_TABLE = re.compile(r"\[\[?(?:device|site|log|programme|exclude)[.\w]*\]")
_OPTION = re.compile(r"(?<![\w-])--([a-z][a-z-]*)")


def tables_at(place: str, *sentences: str) -> str:
    """Return the end of sentences that name a table of session.toml: that it is at a place; else nothing."""
    return f"; names in [ ] are tables of {place}" if any(map(_TABLE.search, sentences)) else ""


class TumbleError(Exception):
    """Base of all errors that tumble raises on purpose."""

    def __str__(self) -> str:
        """Return the message with options named as arguments."""
        message = _OPTION.sub(lambda option: option[1].replace("-", "_"), self.for_command_line)
        return message if "session.toml" in message else message + tables_at(IN_MEMORY, message)

    @property
    def for_command_line(self) -> str:
        """Message with arguments named as options."""
        return super().__str__()


class InputError(TumbleError):
    """The input cannot be used."""


class GyrosAloneError(InputError):
    """A log has gyros and no accelerometers."""


class SessionError(InputError):
    """session.toml cannot be used."""


class LogError(InputError):
    """A log cannot be read as the session describes it."""


class ProgrammeError(InputError):
    """An attitude code or a programme does not exist."""


class CalibrationError(InputError):
    """A calibration file cannot be read or written."""


class MissingExtraError(TumbleError):
    """A function needs an optional dependency that is not installed."""


@contextmanager
def needs_extra(what: str, extra: str, *libraries: str) -> Iterator[None]:
    """Raise MissingExtraError if one of the libraries imported in the block is missing.

    The message names `what` (in the singular) needs it, and the extra of tumble that installs it."""
    try:
        yield
    except ModuleNotFoundError as error:
        library = (error.name or "").partition(".")[0]
        if library not in libraries:
            raise
        raise MissingExtraError(
            f"{what} needs {library}; install it with: pip install 'tumble[{extra}]', or in the folder of its source: "
            f"pip install '.[{extra}]'"
        ) from error


def did_you_mean(name: str, known: Iterable[str], *, alike: float = 0.6) -> str:
    """Return the end of a message about an unknown name: the most similar known name, or nothing."""
    from difflib import get_close_matches

    near = get_close_matches(name, list(known), n=1, cutoff=alike)
    return f"; did you mean '{near[0]}'?" if near else ""
