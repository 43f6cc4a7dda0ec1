"""SciPy's compiled functions of probability and linear algebra, without the Python around them.

`import scipy.special` and `import scipy.linalg` load numpy.f2py and numpy.testing on their way: 0.17 s, a third of what
a short command takes to start. Here their extension modules are loaded alone, with an empty package in place of theirs
until they are; `import scipy.special` works afterwards as ever, with the same functions. Where the package has been
imported before, or a release of SciPy keeps its functions elsewhere, they are taken from its public modules.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

import scipy


def _extension(package: str, name: str, public: str) -> Any:
    """The extension module `name` of a package of SciPy; its `public` module where that is not to be had."""
    whole = f"scipy.{package}"
    if whole in sys.modules:
        return import_module(public)
    bare = ModuleType(whole)
    bare.__path__ = [f"{folder}/{package}" for folder in scipy.__path__]
    sys.modules[whole] = bare
    try:
        return import_module(f"{whole}.{name}")
    except ImportError:
        pass
    finally:
        if sys.modules.get(whole) is bare:
            del sys.modules[whole]
    return import_module(public)


special = _extension("special", "_ufuncs", "scipy.special")
lapack = _extension("linalg", "_flapack", "scipy.linalg.lapack")
