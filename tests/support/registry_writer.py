"""A writer of the registry for a process of its own. It imports no more than it needs, to start fast."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tumble.lab.registry.registry import open_registry


def write_all(place: str, files: Sequence[Path]) -> None:
    """Add calibrations, one after the other."""
    with open_registry(place, create=True) as registry:
        for file in files:
            registry.add_calibration(file)
