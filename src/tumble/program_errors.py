"""Handling of errors of the program: one line on standard error, the traceback in a file, and exit status 70.

The module also handles a failed start, so it imports nothing that takes time or memory.
"""

from __future__ import annotations

import os
import sys

PROGRAM_ERROR = 70  # exit status of an error of the program
STOPPED = 130  # exit status of a command that the user has stopped (Ctrl-C)


def ended_by(error: BaseException) -> int:
    """Print one line on standard error about the exception that ended a command, and return the exit status."""
    if isinstance(error, KeyboardInterrupt):
        print("tumble: stopped", file=sys.stderr)  # noqa: T201
        return STOPPED
    if isinstance(error, MemoryError) or (isinstance(error, ImportError) and "failed to map segment" in str(error)):
        message = f"the memory does not suffice: {error}; {_kept(error)}"
    else:
        message = f"an error of the program: {type(error).__name__}: {error}; please report it: {_kept(error)}"
    print(f"tumble: {' '.join(message.split())}", file=sys.stderr)  # noqa: T201
    return PROGRAM_ERROR


LEAST_MEMORY = {"RLIMIT_AS": (1.6e9, "v"), "RLIMIT_DATA": (0.5e9, "d")}
"""Bytes of address space and of data, with the option of `ulimit` for each. Reading a recording of 3 MB maps 1.59 GB,
0.41 GB of it data and 0.2 GB used, with one thread of polars, and 5 MB of each for every further thread. With less,
polars or matplotlib may abort the process or wait forever."""


def check_memory_limits() -> None:
    """Raise MemoryError if the limits of the process are below LEAST_MEMORY; under a limit polars uses one thread."""
    try:
        import resource
    except ImportError:  # on Windows there is no such limit
        return
    for name, (least, option) in LEAST_MEMORY.items():
        allowed = resource.getrlimit(getattr(resource, name))[0]
        if allowed == resource.RLIM_INFINITY:
            continue
        if allowed < least:
            raise MemoryError(
                f"expected a limit of at least {least / 1e9:.1f} GB, found {allowed / 1e9:.2f} GB; raise it (ulimit "
                f"-{option})"
            )
        os.environ.setdefault("POLARS_MAX_THREADS", "1")


def _kept(error: BaseException) -> str:
    """Write the traceback to a file, and return a sentence with its path."""
    import platform
    import tempfile
    import traceback

    lines = [f"Python {platform.python_version()}, {platform.platform()}\n", *traceback.format_exception(error)]
    try:
        with tempfile.NamedTemporaryFile(
            "w", prefix="tumble-error-", suffix=".txt", delete=False, encoding="utf-8", errors="backslashreplace"
        ) as file:
            file.writelines(lines)
    except OSError as fault:
        return f"the traceback could not be kept ({fault.strerror})"
    return f"the traceback is in {file.name}"
