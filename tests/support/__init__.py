"""What tests share: made-up calibrations and sessions, plain twins of loops, servers, a browser, corpora of logs."""

import importlib.util
import sys
from functools import cache
from pathlib import Path
from types import ModuleType

ROOT = Path(__file__).parents[2]
"""The repository."""


@cache
def study(name: str) -> ModuleType:
    """A study as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "studies" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module
