"""A table is written whole or not at all, also where it is stopped."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import polars as pl
import pytest

from tumble.recording.log_source import one_ahead
from tumble.recording.readers import write_tables

TABLE = pl.DataFrame({"t": [float(row) for row in range(1000)]})
MANY = 20_000
"""Tables; a write that is stopped sees few of them."""


def interrupted_after(few: int) -> Iterator[pl.DataFrame]:
    """Tables, and the signal of Ctrl-C behind the first few."""
    for number in range(MANY):
        if number == few:
            os.kill(os.getpid(), signal.SIGINT)
        yield TABLE


def passed_on(tables: Iterator[pl.DataFrame]) -> Iterator[pl.DataFrame]:
    yield from tables


@pytest.mark.skipif(os.name == "nt", reason="os.kill ends the process on Windows")
@pytest.mark.parametrize("name", ["out.csv", "out.parquet"])
def test_a_stopped_write_leaves_nothing_and_says_no_more_than_that(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    said: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", said.append)
    for few in (5, 10, 20):
        with pytest.raises(KeyboardInterrupt):
            write_tables(tmp_path / name, passed_on(one_ahead(interrupted_after(few))))
    assert not said
    assert not list(tmp_path.iterdir())
