"""How much of tumble one `tumble calibrate` goes through: the files and the distinct functions whose code runs.

What runs while a module is imported is not counted, nor are the bodies of classes and of comprehensions, nor methods
that a decorator wrote (dataclasses), for nobody reads them. Usage: python benchmarks/trace.py [SESSION] [--functions],
SESSION a folder, by default the Xsens recording (TUMBLE_DATA); with --functions a line for each function: its lines,
how often it ran, the functions that called it.
"""

from __future__ import annotations

import inspect
import io
import os
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import tumble

DATA = Path(os.environ.get("TUMBLE_DATA") or Path(__file__).parents[2] / "shared" / "data")
ROOT = str(Path(tumble.__file__).parent) + os.sep
CALLS: Counter[CodeType] = Counter()
CALLERS: defaultdict[CodeType, set[str]] = defaultdict(set)


def name(code: CodeType) -> str:
    """File and function, as a reader would look for it."""
    return f"{code.co_filename.removeprefix(ROOT)}:{code.co_firstlineno} {code.co_qualname}"


def within(frame: FrameType | None) -> Iterator[FrameType]:
    """A frame and those that called it."""
    while frame is not None:
        yield frame
        frame = frame.f_back


def watch(frame: FrameType, event: str, _: Any) -> None:
    """Counts a call of one of tumble's functions, unless a module is being imported."""
    code = frame.f_code
    if event != "call" or not code.co_filename.startswith(ROOT) or not code.co_flags & inspect.CO_NEWLOCALS:
        return
    if code.co_name.startswith("<") and code.co_name != "<lambda>":
        return
    if any(outer.f_code.co_name == "<module>" and outer.f_code.co_filename.startswith(ROOT) for outer in within(frame)):
        return
    CALLS[code] += 1
    caller = next((f.f_code for f in within(frame.f_back) if f.f_code.co_filename.startswith(ROOT)), None)
    if caller is not None:
        CALLERS[code].add(name(caller))


def main() -> None:
    arguments = [argument for argument in sys.argv[1:] if not argument.startswith("-")]
    session = arguments[0] if arguments else str(DATA / "xsens-mti")
    if not Path(session).exists():
        raise SystemExit(f"{session}: no recording to trace; state a session, or TUMBLE_DATA")
    from tumble.cli import main as command  # after the counters, as the command itself imports it

    nowhere = io.StringIO()
    with tempfile.TemporaryDirectory() as folder, redirect_stdout(nowhere), redirect_stderr(nowhere):
        sys.setprofile(watch)
        try:
            command(["calibrate", session, "--out", str(Path(folder) / "out.json")])
        except SystemExit as ended:
            if ended.code not in (0, 1):
                raise
        finally:
            sys.setprofile(None)
    if "--functions" in sys.argv:
        for code in sorted(CALLS, key=lambda code: (code.co_filename, code.co_firstlineno)):
            last = max(line for _, _, line in code.co_lines() if line is not None)
            lines = last - code.co_firstlineno + 1
            print(f"{name(code)}  {lines} lines  {CALLS[code]} calls  from {', '.join(sorted(CALLERS[code]))}")
    files = {code.co_filename for code in CALLS}
    print(f"{len(files)} files entered, {len(CALLS)} functions called")


if __name__ == "__main__":
    main()
