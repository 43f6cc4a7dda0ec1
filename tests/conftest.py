"""Where the recordings are, and what happens when they are missing."""

from __future__ import annotations

import gc
import os
import shutil
import tempfile
from pathlib import Path

import pytest
from hypothesis import settings

from tests.support import ROOT
from tests.support.seconds import slow_functions
from tests.support.shared import FOLDER

settings.register_profile("tumble", deadline=None)  # timings decide no test
settings.load_profile("tumble")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # matrices are small, and tests run side by side
MEMORY = Path("/dev/shm")  # where there is enough of it, what tests write and sync never waits for a disk
if "TMPDIR" not in os.environ and MEMORY.is_dir() and shutil.disk_usage(MEMORY).free > 4e9:
    os.environ["TMPDIR"] = tempfile.tempdir = str(MEMORY)


def pytest_configure(config: pytest.Config) -> None:
    """The folder of what tests share, one for all workers."""
    if not hasattr(config, "workerinput"):
        os.environ[FOLDER] = tempfile.mkdtemp(prefix="tumble-shared-")


def pytest_unconfigure(config: pytest.Config) -> None:
    """Remove it with the last of them."""
    if not hasattr(config, "workerinput"):
        shutil.rmtree(os.environ.pop(FOLDER), ignore_errors=True)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests that have been measured to be slow."""
    slow = slow_functions()
    for item in items:
        if item.nodeid.partition("[")[0] in slow:
            item.add_marker(pytest.mark.slow)


def pytest_collection_finish() -> None:
    """Nothing of what was imported is garbage: it is not looked through again and again while tests run."""
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of recordings: TUMBLE_DATA, else ../shared/data beside the repository. Tests that want it are skipped
    where neither is there, and fail where TUMBLE_DATA names no folder."""
    stated = os.environ.get("TUMBLE_DATA")
    folder = Path(stated or ROOT.parent / "shared" / "data")
    if not folder.is_dir():
        (pytest.fail if stated else pytest.skip)(f"the recordings are not at {folder}; TUMBLE_DATA names their folder")
    return folder
