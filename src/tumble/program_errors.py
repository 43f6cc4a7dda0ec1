"""How a command ends that the program itself has failed: one line, the traceback in a file, a status of its own.

It imports nothing that takes time or memory, for it also speaks for a start that failed.
"""

from __future__ import annotations

import platform
import sys
import tempfile
import traceback

PROGRAM_ERROR = 70
"""Exit status of an error of the program: a crash is no verdict."""
STOPPED = 130
"""Exit status of a command that the user has stopped (Ctrl-C)."""


def ended_by(error: BaseException) -> int:
    """Say in one line on standard error what has ended a command; the exit status."""
    if isinstance(error, KeyboardInterrupt):
        print("tumble: stopped", file=sys.stderr)  # noqa: T201
        return STOPPED
    what = "the memory does not suffice" if isinstance(error, MemoryError) else "an error of the program"
    said = " ".join(f"{type(error).__name__}: {error}".split())[:400]
    print(f"tumble: {what}: {said}; {_kept(error)}", file=sys.stderr)  # noqa: T201
    return PROGRAM_ERROR


def _kept(error: BaseException) -> str:
    """Where the traceback is kept."""
    lines = [f"Python {platform.python_version()}, {platform.platform()}\n", *traceback.format_exception(error)]
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="tumble-error-", suffix=".txt", delete=False, encoding="utf-8", errors="backslashreplace"
        ) as file:
            file.writelines(lines)
    except OSError as fault:
        return f"the traceback could not be kept ({fault.strerror})"
    return f"please report it with the traceback in {file.name}"
