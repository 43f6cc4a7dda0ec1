"""Entry point of `tumble` and `python -m tumble`."""

from __future__ import annotations

import os
import signal
import sys

from tumble.program_errors import ended_by

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import TextIO

_STANDARD_ERROR = 2


def _nowhere() -> TextIO:
    from pathlib import Path

    return Path(os.devnull).open("w", encoding="utf-8")


def run() -> None:
    """Run the command line.

    Before a command has begun and after its end there is nothing to clean up, so that Ctrl-C ends the process at once.
    Processes that it starts do not import modules from the working folder (PYTHONSAFEPATH), and the descriptors of
    closed standard streams are occupied, so that no file takes their place."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    os.environ.setdefault("PYTHONSAFEPATH", "1")
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= _STANDARD_ERROR:
        pass
    os.close(descriptor)
    sys.stdout, sys.stderr = sys.stdout or _nowhere(), sys.stderr or _nowhere()
    try:
        from tumble.cli import main
    except (Exception, KeyboardInterrupt) as error:
        raise SystemExit(ended_by(error)) from None
    main()


if __name__ == "__main__":
    run()
