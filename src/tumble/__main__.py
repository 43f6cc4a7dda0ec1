"""`tumble` and `python -m tumble`: the command line, also where it is ended before it has begun."""

from __future__ import annotations

import os

from tumble.program_errors import ended_by


def run() -> None:
    """The command line, as the process it is in. No process that it starts takes a module of the working folder for one
    of Python's."""
    os.environ.setdefault("PYTHONSAFEPATH", "1")
    try:
        from tumble.cli import main
    except (Exception, KeyboardInterrupt) as error:
        raise SystemExit(ended_by(error)) from None
    main()


if __name__ == "__main__":
    run()
