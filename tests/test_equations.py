"""The index of equations is true: what it names exists and cites the number, and what cites a number is in it."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "equations.md").read_text(encoding="utf-8")
ROW = re.compile(r"^\| (?P<numbers>[^|]*\([\w.]+\)[^|]*) \| [^|]* \| (?P<names>`[^|]*`) \|$", re.MULTILINE)
CITED = re.compile(r"Eqs?\.\s((?:\([\w.]+\)(?:,\s|\sand\s)?)+)")
LISTED = [
    (name, tuple(re.findall(r"\(([\w.]+)\)", row["numbers"])))
    for row in ROW.finditer(PAGE)
    for name in re.findall(r"`([\w.]+)`", row["names"])
]
PAPER = ROOT / "src" / "tumble" / "estimation" / "methods" / "paper"


def description(name: str) -> str:
    """The docstring of a module, or of a function in one."""
    module, _, function = name.rpartition(".")
    whole, part = (ROOT / "src" / (each.replace(".", "/") + ".py") for each in (name, module))
    if whole.is_file():
        return ast.get_docstring(ast.parse(whole.read_text(encoding="utf-8"))) or ""
    for node in ast.parse(part.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef) and node.name == function:
            return ast.get_docstring(node) or ""
    raise AssertionError(f"{name}: no such function")


@pytest.mark.parametrize(("name", "numbers"), LISTED)
def test_what_the_index_names_exists_and_cites_the_equation(name: str, numbers: tuple[str, ...]) -> None:
    said = description(name)
    for number in numbers:
        assert f"({number})" in said


def test_every_function_of_the_paper_that_cites_an_equation_is_in_the_index() -> None:
    names = {name for name, _ in LISTED}
    missing = []
    for path in sorted(PAPER.glob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            name = f"tumble.estimation.methods.paper.{path.stem}.{getattr(node, 'name', '')}"
            if isinstance(node, ast.FunctionDef) and CITED.search(ast.get_docstring(node) or "") and name not in names:
                missing.append(name)
    assert missing == []
