"""Which test functions are slow: a plugin of pytest that measures them all and writes `tests/slow.txt`.

    .venv/bin/python -m pytest -p tests.support.slow

`tests/conftest.py` marks what is listed there as `slow`, and `make test-quick` leaves it out. Children count, since
many tests start a process; seconds of a processor hardly depend on what else the machine does.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

from tests.support import ROOT

LISTED = ROOT / "tests/slow.txt"
CASE, ALL_CASES, WAITING = 0.25, 1.0, 2.0
"""Seconds of a processor of the slowest case of a function and of all its cases; seconds by the clock."""

_spent: dict[str, list[tuple[float, float]]] = {}


def function_of(nodeid: str) -> str:
    """A test without its parameters."""
    return nodeid.partition("[")[0]


def slow_functions() -> set[str]:
    """The functions that are listed."""
    return set(LISTED.read_text(encoding="utf-8").split()) if LISTED.exists() else set()


def _processor_seconds() -> float:
    import resource  # not on Windows, where nothing is measured

    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Measure a test with its fixtures."""
    processor, clock = _processor_seconds(), time.monotonic()
    result = yield
    spent = (_processor_seconds() - processor, time.monotonic() - clock)
    _spent.setdefault(function_of(item.nodeid), []).append(spent)
    return result


def pytest_sessionfinish() -> None:
    """Write the list."""
    listed = [
        name
        for name, cases in _spent.items()
        if max(processor for processor, _ in cases) > CASE
        or sum(processor for processor, _ in cases) > ALL_CASES
        or max(clock for _, clock in cases) > WAITING
    ]
    LISTED.write_text("\n".join(sorted(listed)) + "\n", encoding="utf-8")
