"""`tumble` and `python -m tumble`: the command line, also where it is ended before it has begun."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TextIO

from tumble.program_errors import ended_by

_STANDARD_ERROR = 2


def _nowhere() -> TextIO:
    return Path(os.devnull).open("w", encoding="utf-8")


def run() -> None:
    """The command line, as the process it is in. No process that it starts takes a module of the working folder for one
    of Python's, and no file that it opens the place of an output that is closed."""
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
