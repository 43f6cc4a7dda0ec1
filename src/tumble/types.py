"""Types of the arguments, fields and results of public functions, for annotations: `from tumble.types import Site`."""

from __future__ import annotations

from tumble.lazy import names_of

__all__, __getattr__ = names_of(__name__, __file__)
__dir__ = __all__.copy  # the names, imported or not
