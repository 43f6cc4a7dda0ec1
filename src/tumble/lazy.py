"""Public names that are imported when they are first used, so that the command line starts without NumPy."""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def names_of(module: str, file: str) -> tuple[list[str], Callable[[str], Any]]:
    """Return the names in the stub file of a module, which type checkers read too, and its `__getattr__`."""
    text = Path(file).with_suffix(".pyi").read_text(encoding="utf-8")
    places = {name: place for place, name in re.findall(r"^from (tumble\.\S+) import (\w+) as \2$", text, re.M)}

    def get(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        return getattr(import_module(places[name]), name)

    return sorted(places), get
