"""What polars prints of itself where a file is damaged, kept off the terminal.

Threads of polars that stop at a damaged Parquet file print where in its sources they did so, past Python, while the
caller gets too few rows, or an error. One line of ours says it then. Standard error is kept from them in a command
alone: it is that of the whole process, and a program that uses the library may write to it meanwhile.
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
"""Whether the process is that of a command, and this its thread."""
_ONE_AT_A_TIME = Lock()
_STANDARD_ERROR = 2
LAST_WORDS = 0.1, 2.0
"""How long other threads that stop at a damaged file may take to begin printing so, and to end: s."""
_MARK = b" panicked at "


@contextmanager
def without_panic(*, silent: bool = False) -> Iterator[None]:
    """In a command, whatever is written to standard error while the block runs appears after it, unless it tells of a
    panic, or is to be `silent`."""
    if not COMMAND_LINE.get():
        yield
        return
    with _ONE_AT_A_TIME, ExitStack() as stack:
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
            wait_for_last_words()
            raise
        finally:
            os.dup2(kept, _STANDARD_ERROR)
            os.close(kept)
            held.seek(0)
            written = held.read()
            if written and not silent and _MARK not in written:
                with suppress(OSError):
                    os.write(_STANDARD_ERROR, written)


def wait_for_last_words() -> None:
    """Waits for other threads to print why they stop: some time, and as long as one of them has work to do, as far as
    the system tells."""
    begun, ended = (time.monotonic() + seconds for seconds in LAST_WORDS)
    at_work = True
    while (now := time.monotonic()) < begun or (now < ended and at_work):
        at_work = False
        for task in Path("/proc/self/task").glob("*/stat"):
            with suppress(OSError):  # ended meanwhile
                state = task.read_text(encoding="ascii", errors="replace").rpartition(")")[2].split()[0]
                at_work |= state == "R" and task.parent.name != str(get_native_id())
        time.sleep(0.01)
