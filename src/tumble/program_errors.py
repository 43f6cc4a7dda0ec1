"""How a command ends that the program itself has failed: one line, the traceback in a file, a status of its own.

It imports nothing that takes time or memory, for it also speaks for a start that failed.
"""

from __future__ import annotations

import sys

PROGRAM_ERROR = 70
"""Exit status of an error of the program: a crash is no verdict."""
STOPPED = 130
"""Exit status of a command that the user has stopped (Ctrl-C)."""


def ended_by(error: BaseException) -> int:
    """Say in one line on standard error what has ended a command; the exit status."""
    if isinstance(error, KeyboardInterrupt):
        print("tumble: stopped", file=sys.stderr)  # noqa: T201
        return STOPPED
    if isinstance(error, MemoryError):
        said = f"the memory does not suffice: {error}; {_kept(error)}"
    else:
        said = f"an error of the program: {type(error).__name__}: {error}; please report it: {_kept(error)}"
    print(f"tumble: {' '.join(said.split())}", file=sys.stderr)  # noqa: T201
    return PROGRAM_ERROR


LEAST_ADDRESS_SPACE = 1.6e9
"""Bytes. Reading a recording of 3 MB maps 1.25 GB with one thread of polars, 1.6 GB with sixteen, 0.13 GB of which are
used; where they cannot be had polars aborts the process or waits for ever, and so may what draws the pictures."""


def check_address_space() -> None:
    """Raise MemoryError where the process may not map what libraries do that read recordings and draw."""
    try:
        import resource
    except ImportError:  # on Windows there is no such limit
        return
    allowed = resource.getrlimit(resource.RLIMIT_AS)[0]
    if allowed != resource.RLIM_INFINITY and allowed < LEAST_ADDRESS_SPACE:
        raise MemoryError(
            f"expected an address space of at least {LEAST_ADDRESS_SPACE / 1e9:.1f} GB, found a limit of "
            f"{allowed / 1e9:.2f} GB; raise it (ulimit -v)"
        )


def _kept(error: BaseException) -> str:
    """Where the traceback is kept."""
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
