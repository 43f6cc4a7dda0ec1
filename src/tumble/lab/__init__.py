"""The laboratory: registry of calibrations, acceptance limits, certificates, self-test.

The core does not import this package; it is loaded by entry points.
"""

from __future__ import annotations

from tumble.lazy import names_of

__all__, __getattr__ = names_of(__name__, __file__)
