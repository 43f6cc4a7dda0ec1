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
from pathlib import Path
from threading import Lock, get_native_id

COMMAND_LINE: ContextVar[bool] = ContextVar("COMMAND_LINE", default=False)
"""Whether the current thread runs a command."""
_REDIRECTION = Lock()
_STANDARD_ERROR = 2
PANIC_SECONDS = 0.1, 2.0
"""Times allowed for stopping threads to begin printing and to end, s."""
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
            wait_for_panic()
            raise
        finally:
            os.dup2(kept, _STANDARD_ERROR)
            os.close(kept)
            held.seek(0)
            written = held.read()
            if written and not silent and _PANIC_MARK not in written:
                with suppress(OSError):
                    os.write(_STANDARD_ERROR, written)


def wait_for_panic() -> None:
    """Wait until no other thread of the process is running, within a least and a longest time."""
    begun, ended = (time.monotonic() + seconds for seconds in PANIC_SECONDS)
    at_work = True
    while (now := time.monotonic()) < begun or (now < ended and at_work):
        at_work = False
        for task in Path("/proc/self/task").glob("*/stat"):
            with suppress(OSError):  # the thread has ended
                state = task.read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()[0]
                at_work |= state == "R" and task.parent.name != str(get_native_id())
        time.sleep(0.01)
