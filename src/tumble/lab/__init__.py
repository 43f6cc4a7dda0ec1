"""Acceptance: whether a calibration is within the limits of its device type, and what a certificate states of that.

limits       the file of limits of a type, and when its devices are due
conformity   the decision rule; the verdict on every parameter, at the reference or over temperature
scope        what a laboratory is accredited for, and no U below its capability
certificate  who calibrated what for whom, when, and by which limits it is judged
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tumble.lab.registry.registry import Registry as Registry
    from tumble.lab.registry.registry import open_registry as open_registry

__all__ = ["Registry", "open_registry"]


def __getattr__(name: str) -> Any:
    """The registry is imported when it is first used."""
    if name not in __all__:
        raise AttributeError(f"module 'tumble.lab' has no attribute {name!r}")
    return getattr(import_module("tumble.lab.registry.registry"), name)
