"""The index of equations is true: what it names exists and cites the number, and what cites a number is in it."""

from __future__ import annotations

import ast
import re

import pytest

from tests.docs.test_named import exists
from tests.support import ROOT

PAGE = (ROOT / "docs/reference/equations.md").read_text(encoding="utf-8")
ROW = re.compile(r"^\| (?P<numbers>[^|]*\([\w.]+\)[^|]*) \| [^|]* \| (?P<names>`[^|]*`) \|$", re.MULTILINE)
CITED = re.compile(r"Eqs?\.\s((?:\([\w.]+\)(?:,\s|\sand\s)?)+)")
LISTED = [
    (name, tuple(re.findall(r"\(([\w.]+)\)", row["numbers"])))
    for row in ROW.finditer(PAGE)
    for name in re.findall(r"`([\w.]+)`", row["names"])
]
PAPER = {
    f"tumble.methods.paper.{path.stem}": path for path in sorted((ROOT / "src/tumble/methods/paper").glob("*.py"))
} | {"studies.accuracy_formulas": ROOT / "studies/accuracy_formulas.py"}
"""Where functions cite the equations of the paper."""


def description(name: str) -> str:
    """The docstring of a module, or of a function in one."""
    module, _, function = name.rpartition(".")
    root = ROOT / "src" if name.startswith("tumble.") else ROOT
    whole, part = (root / (each.replace(".", "/") + ".py") for each in (name, module))
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
    assert len(PAPER) > 3
    for module, path in PAPER.items():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            name = f"{module}.{getattr(node, 'name', '')}"
            if isinstance(node, ast.FunctionDef) and CITED.search(ast.get_docstring(node) or "") and name not in names:
                missing.append(name)
    assert missing == []


MATHEMATICS = (ROOT / "docs/explanation/mathematics.md").read_text(encoding="utf-8")


def test_every_equation_of_the_joint_method_is_in_its_index_and_names_what_exists() -> None:
    index = MATHEMATICS.partition("## 16.")[2]
    numbered = re.findall(r"\\tag\{(\d+)\}", MATHEMATICS)
    assert numbered == [str(i + 1) for i in range(len(numbered))]
    assert set(re.findall(r"\((\d+)\)", index)) == set(numbered)
    assert [name for name in re.findall(r"`(tumble[\w.]+)`", index) if not exists(name)] == []


CITATION = re.compile(r"docs/explanation/mathematics\.md \(\d+(?:\),? (?:and )?\(\d+)*\)")


def test_what_the_source_cites_of_the_joint_method_is_an_equation_of_the_page() -> None:
    numbered = set(re.findall(r"\\tag\{(\d+)\}", MATHEMATICS))
    for path in sorted((ROOT / "src").rglob("*.py")):
        text = " ".join(path.read_text(encoding="utf-8").split())
        for cited in CITATION.findall(text):
            assert set(re.findall(r"\((\d+)\)", cited)) <= numbered, f"{path.name}: {cited}"
