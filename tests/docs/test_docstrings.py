"""The examples in the docstrings of the public names run, each in an empty folder."""

from __future__ import annotations

import contextlib
import doctest
import inspect
from pathlib import Path

import pytest

import tumble
from tumble.lab import open_registry
from tumble.methods.ellipsoid_fit import fit_ellipsoid
from tumble.recording.arrays import session_of_arrays
from tumble.recording.columns.names import unit_of_name
from tumble.recording.log import open_log
from tumble.recording.session_file import description_of

CALLS = [name for name in tumble.__all__ if inspect.isfunction(getattr(tumble, name))]
OTHERS = (description_of, fit_ellipsoid, open_log, open_registry, session_of_arrays, unit_of_name)
EXAMPLES = [
    example
    for item in (*(getattr(tumble, name) for name in tumble.__all__ if name != "__version__"), *OTHERS)
    if callable(item) and item.__module__.startswith("tumble")
    for example in doctest.DocTestFinder().find(item, item.__name__, globs={item.__name__: item})
    if example.examples
]


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.name)
def test_the_example_runs_as_it_is_printed(example: doctest.DocTest, tmp_path: Path) -> None:
    said: list[str] = []
    with contextlib.chdir(tmp_path):
        doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(example, out=said.append)
    assert not said, "".join(said)


def test_every_public_call_has_an_example() -> None:
    assert {name.partition(".")[0] for name in (example.name for example in EXAMPLES)} >= set(CALLS)
