"""Reading beside the work on what was read."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")


def one_ahead(parts: Iterator[T]) -> Iterator[T]:
    """The same parts; the next one is read while this one is worked on."""
    with ThreadPoolExecutor(max_workers=1) as beside:
        ahead = beside.submit(next, parts, None)
        while (part := ahead.result()) is not None:
            ahead = beside.submit(next, parts, None)
            yield part
