"""A writer of the registry for a process of its own. It imports no more than it needs, to start fast."""

from __future__ import annotations

from collections.abc import Sequence

from tumble.lab.registry.adding import Submission, add
from tumble.lab.registry.store.connect import open_registry


def write_all(place: str, submissions: Sequence[Submission]) -> None:
    """Add calibrations, one after the other."""
    with open_registry(place, create=True) as registry:
        for submission in submissions:
            add(registry, submission)
