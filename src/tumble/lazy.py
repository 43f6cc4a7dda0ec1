"""Public names that are imported when they are first used, so that the command line starts without NumPy.

The module is imported before a command has taken over Ctrl-C, so it imports nothing that takes time.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any


def names_of(module: str, file: str) -> tuple[list[str], Callable[[str], Any]]:
    """Return the names in the stub file of a module, which type checkers read too, and its `__getattr__`."""
    with open(f"{file.removesuffix('.py')}.pyi", encoding="utf-8") as stub:  # noqa: PTH123
        lines = [line.split() for line in stub]
    places = {words[3]: words[1] for words in lines if words[:1] == ["from"] and words[-2] == "as"}

    def get(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        return getattr(import_module(places[name]), name)

    return sorted(places), get
