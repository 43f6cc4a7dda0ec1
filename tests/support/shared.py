"""Recordings and calibrations that tests share: made once in a run of pytest, for all workers, and read by all.

>>> folder = session(Setup.of(grade="mems", positions=12), seed=4)      # of tumble.simulate_session: read only
>>> calibration = calibrated(Setup.of(grade="mems", positions=12), seed=4)      # of tumble.calibrate of that folder
>>> folder = copy_of(folder, tmp_path / "s")      # for a test that writes into it
>>> value = once("a name nobody else has", lambda: anything_that_can_be_pickled())

What was made is kept under a temporary folder of the run, which `tests/conftest.py` makes and removes.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import pickle
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from tumble import Calibration, Setup, calibrate, simulate_session

Made = TypeVar("Made")
FOLDER = "TUMBLE_TEST_SHARED"
"""The variable of the environment that names the folder; workers inherit it."""


def session(setup: Setup, *, seed: int, **more: Any) -> Path:
    """Folder of a simulated session (arguments of `tumble.simulate_session`). Read only."""

    def make(folder: Path) -> None:
        simulate_session(folder, setup, seed=seed, **more)

    return _made_folder(f"session {setup!r} {seed} {sorted(more.items())!r}", make)


def calibrated(setup: Setup, *, seed: int, words: dict[str, Any] | None = None, **more: Any) -> Calibration:
    """Calibration of a simulated session, with `words` for `tumble.calibrate`."""
    words = words or {}
    key = f"calibration {setup!r} {seed} {sorted(more.items())!r} {sorted(words.items())!r}"
    return once(key, lambda: calibrate(session(setup, seed=seed, **more), **words))


def copy_of(folder: Path, target: Path) -> Path:
    """A copy of a shared folder that a test may write into."""
    return Path(shutil.copytree(folder, target))


def once(key: str, make: Callable[[], Made]) -> Made:
    """What `make` returns, called by the first test that asks for this `key`; pickled for the others."""

    def write(folder: Path) -> None:
        folder.mkdir()
        (folder / "value").write_bytes(pickle.dumps(make()))

    made: Made = _value(_made_folder(key, write) / "value")
    return made


@cache
def _value(file: Path) -> Any:
    return pickle.loads(file.read_bytes())


def _made_folder(key: str, make: Callable[[Path], None]) -> Path:
    """The folder of a key, made by the first process that wants it while the others wait."""
    base = Path(os.environ[FOLDER])
    folder = base / hashlib.sha256(key.encode()).hexdigest()[:16]
    if folder.exists():
        return folder
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            unfinished = folder.with_suffix(".new")
            shutil.rmtree(unfinished, ignore_errors=True)
            make(unfinished)
            unfinished.rename(folder)
    return folder
