"""An error of the program is a line, a file and a status of its own, and a process that is to end ends."""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import polars as pl
import pytest

COMMAND = "from tumble.cli import main\nmain(['inspect', 'launch'], prog_name='tumble')\n"
FAILS = "import tumble.recording.session_file as module\ndef fails(*_): {}\nmodule.read_session = fails\n"


def ended(code: str, folder: Path, limits: Callable[[], None] | None = None) -> tuple[int, str, list[tuple[Path, str]]]:
    """Status and standard error of a process, and the tracebacks that it has kept."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env=os.environ | {"TMPDIR": str(folder)},
        capture_output=True,
        text=True,
        check=False,
        timeout=100.0,
        preexec_fn=limits,
    )
    assert done.stdout == ""
    return done.returncode, done.stderr, [(path, path.read_text()) for path in folder.glob("tumble-error-*")]


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        ("raise ValueError('Out of range\\nfloat values')", "ValueError: Out of range float values"),
        ("raise EOFError", "RuntimeError: a file ended where more was expected"),
        ("raise type('PanicException', (BaseException,), {})('could not spawn')", "PanicException: could not spawn"),
        ("return [][1]", "IndexError: list index out of range"),
    ],
)
def test_an_error_of_the_program_is_no_verdict(fault: str, said: str, tmp_path: Path) -> None:
    status, line, ((path, traceback),) = ended(FAILS.format(fault) + COMMAND, tmp_path)
    assert status == 70
    expected = f"tumble: an error of the program: {said}; please report it: the traceback is in {path}"
    assert line == f"{expected}\n"
    assert "in fails" in traceback


@pytest.mark.parametrize(
    "error",
    ["MemoryError('Unable to allocate 3 GiB')", "ImportError('libx.so: failed to map segment from shared object')"],
)
def test_memory_that_does_not_suffice_is_said(error: str, tmp_path: Path) -> None:
    status, line, _ = ended(FAILS.format(f"raise {error}") + COMMAND, tmp_path)
    assert status == 70
    assert line.startswith(f"tumble: the memory does not suffice: {error.split(chr(39))[1]}; ")


@pytest.mark.skipif(sys.platform == "win32", reason="no such limit")
@pytest.mark.parametrize(("limited", "kilobytes"), [("AS", 700_000), ("AS", 400_000), ("DATA", 200_000)])
@pytest.mark.parametrize("words", [["inspect", "launch"], ["report", "calibration.json", "--out", "report.html"]])
def test_a_limit_of_memory_that_is_too_small_is_said_before_anything_is_read(
    words: list[str], limited: str, kilobytes: int, tmp_path: Path
) -> None:
    """Polars and what draws abort under it, or wait for ever."""
    import resource

    limit = (1024 * kilobytes,) * 2
    command = f"from tumble.cli import main\nmain({words}, prog_name='tumble')\n"
    kind = getattr(resource, f"RLIMIT_{limited}")
    status, line, _ = ended(command, tmp_path, lambda: resource.setrlimit(kind, limit))
    assert status == 70
    assert re.fullmatch(r"tumble: the memory does not suffice: expected a limit of at least [^\n]+\n", line)
    assert f"(ulimit -{'v' if limited == 'AS' else 'd'})" in line


@pytest.mark.skipif(os.name != "posix", reason="descriptors of POSIX")
@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-", ">&- 2>&- <&-"])
def test_a_closed_output_takes_nothing_and_changes_no_status_and_no_file(closed: str, tmp_path: Path) -> None:
    for words, status in (
        ("simulate s --positions 3 --rest 4 --sample-rate 20", 0),
        ("inspect s", 0),
        ("inspect t", 2),
    ):
        command = f"exec {shlex.quote(sys.executable)} -m tumble {words} {closed}"
        ended_with = subprocess.run(["sh", "-c", command], cwd=tmp_path, check=False, capture_output=True).returncode
        assert ended_with == status
    assert pl.read_parquet(tmp_path / "s" / "log.parquet").height > 100


def test_a_command_that_is_stopped_before_it_has_begun_says_so(tmp_path: Path) -> None:
    code = """
import sys
class Stopped:
    def find_spec(self, name, *_):
        if name == "tumble.documents":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Stopped())
from tumble.__main__ import run
run()
"""
    assert ended(code, tmp_path) == (130, "tumble: stopped\n", [])


@pytest.mark.skipif(sys.platform != "linux", reason="a lock of the C library that is waited for without end")
def test_a_command_that_is_stuck_in_a_library_ends_when_it_is_asked_to(tmp_path: Path) -> None:
    stuck = """
import ctypes, os, signal, threading, tumble.cli
tumble.cli.STUCK_SECONDS = 0.1
library, lock = ctypes.CDLL(None), ctypes.create_string_buffer(64)
import tumble.recording.session_file as module
def fails(*_):
    threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGTERM)).start()
    library.pthread_mutex_lock(lock)
    library.pthread_mutex_lock(lock)
module.read_session = fails
"""
    assert ended(stuck + COMMAND, tmp_path) == (143, "tumble: stopped\n", [])


def test_a_command_that_is_asked_to_end_leaves_nothing_half_written(tmp_path: Path) -> None:
    code = """
import os, signal
from pathlib import Path
from tumble.files import whole_file
def writes(*_):
    with whole_file(Path("result")) as temporary:
        os.kill(os.getpid(), signal.SIGTERM)
        temporary.write_text("half")
import tumble.recording.session_file as module
module.read_session = writes
"""
    assert ended(code + COMMAND, tmp_path) == (143, "", [])
    assert list(tmp_path.iterdir()) == []


STOPPED: list[tuple[str, tuple[int, str, list[object]]]] = [
    ("SIGINT", (130, "tumble: stopped\n", [])),
    ("SIGTERM", (143, "", [])),
]
"""Signals that end a command, each with how the command ends."""


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize(("name", "expected"), STOPPED)
@pytest.mark.parametrize(
    "library",
    [
        "try:\n        stopped()\n    except BaseException:\n        raise ValueError('no serializer') from None",
        "Lost()\n    time.sleep(60.0)",
    ],
    ids=["made another error", "lost in a destructor"],
)
def test_a_command_is_stopped_whatever_a_library_makes_of_it(
    library: str, name: str, expected: object, tmp_path: Path
) -> None:
    code = f"""
import os, signal, time
def stopped(*_):
    os.kill(os.getpid(), signal.{name})
class Lost:
    __del__ = stopped
import tumble.recording.session_file as module
def fails(*_):
    {library}
module.read_session = fails
"""
    assert ended(code + COMMAND, tmp_path) == expected


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_command_that_is_stopped_while_it_cleans_up_has_cleaned_up(name: str, tmp_path: Path) -> None:
    code = f"""
import os, signal
from pathlib import Path
from tumble.errors import InputError
from tumble.files import nothing_left
unlink = Path.unlink
def stopped(*words, **how):
    os.kill(os.getpid(), signal.{name})
    unlink(*words, **how)
def writes(*_):
    with nothing_left(Path("folder")) as output:
        for name in "abc":
            output.new_file(name).write_text("half")
        Path.unlink = stopped
        raise InputError("refused")
import tumble.recording.session_file as module
module.read_session = writes
"""
    status, line, tracebacks = ended(code + COMMAND, tmp_path)
    assert (status in (2, 130, 143, -signal.SIGINT, -signal.SIGTERM), tracebacks) == (True, [])
    assert line in ("tumble: refused\n", "tumble: stopped\n", "")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_process_that_is_stopped_after_its_command_says_nothing_more(tmp_path: Path) -> None:
    code = """
import atexit, os, signal, sys
atexit.register(os.kill, os.getpid(), signal.SIGINT)
from tumble.__main__ import run
sys.argv = ["tumble", "inspect", "launch"]
run()
"""
    status, line, tracebacks = ended(code, tmp_path)
    assert (status, line.count("\n"), tracebacks) == (-signal.SIGINT, 1, [])
    assert line.startswith("tumble: launch: expected ")
