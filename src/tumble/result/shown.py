"""How a calibration shows itself: by the views, which are above it and which it does not know.

The package names them once, in `tumble/__init__`; they are loaded when something is first shown.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from matplotlib.axes import Axes


class Views(Protocol):
    """What shows a calibration."""

    def as_text(self, calibration: Any) -> str:
        """As plain text."""

    def as_html(self, calibration: Any) -> str:
        """As a notebook shows it."""

    def draw(self, calibration: Any, axes: Axes) -> None:
        """As a picture."""


_loaded_by: list[Callable[[], Views]] = []


def shown_by(load: Callable[[], Views]) -> None:
    """Calibrations are shown by what `load` returns."""
    _loaded_by[:] = [load]


def views() -> Views:
    """What shows calibrations."""
    return _loaded_by[0]()
