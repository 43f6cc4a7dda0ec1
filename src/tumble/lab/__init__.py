"""The laboratory: what keeps, judges and certifies calibrations. It comes into tumble by entry points alone.

limits, conformity    acceptance limits of a type; the decision rule, and the verdict on every parameter
registry              devices, calibrations and limits over years: trends, and what is due
device_type           what the units of a type have in common, as a prior for the next one; datasheet shows it
certificate           who calibrated what for whom
report, dcc           reports by limits and certificates; the Digital Calibration Certificate
selftest              reference cases on the user's machine, and a record of them
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
