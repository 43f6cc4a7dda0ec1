"""Two processes of a local cluster."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tumble.campaigns.cluster import executor_for
from tumble.campaigns.engine import Executor


@pytest.fixture(scope="module")
def processes() -> Iterator[Executor]:
    """They take seconds to start, and are busy even when idle: the tests of a module share them."""
    with executor_for(workers=2) as executor:
        yield executor
