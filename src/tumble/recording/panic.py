"""Suppression of the messages that polars prints for damaged files.

Threads of polars that stop at a damaged Parquet file print the place in polars' sources to standard error, bypassing
Python, while the caller gets too few rows or an error, which is reported in one line. Standard error is redirected in
commands only, because it belongs to the whole process.
"""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from threading import Lock

COMMAND_LINE: ContextVar[bool] = ContextVar("COMMAND_LINE", default=False)
"""Whether the current thread runs a command."""
PANIC_SECONDS = 1.0  # until threads that stop have printed
_REDIRECTION = Lock()
_STANDARD_ERROR = 2
_PANIC_MARK = b" panicked at "


@contextmanager
def without_panic(*, silent: bool = False) -> Iterator[None]:
    """Delay standard error of a command to the end of the block; drop it after a panic or if `silent`."""
    if not COMMAND_LINE.get():
        yield
        return
    with _REDIRECTION, ExitStack() as stack:
        try:
            held = stack.enter_context(tempfile.TemporaryFile())
            kept = os.dup(_STANDARD_ERROR)
        except OSError:  # standard error is closed, or there is no place for temporary files
            yield
            return
        os.dup2(held.fileno(), _STANDARD_ERROR)
        try:
            yield
        except BaseException:
            time.sleep(PANIC_SECONDS)
            raise
        finally:
            os.dup2(kept, _STANDARD_ERROR)
            os.close(kept)
            held.seek(0)
            written = held.read()
            if written and not silent and _PANIC_MARK not in written:
                with suppress(OSError):
                    os.write(_STANDARD_ERROR, written)
