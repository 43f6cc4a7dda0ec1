"""Where each public name is: type checkers read this file, and `tumble/lab/__init__.py` imports from it."""

from tumble.lab.registry.registry import Registry as Registry
from tumble.lab.registry.registry import open_registry as open_registry
