"""The pages of the exports show what is written for docs/reference/export/example.json and example-thermal.json."""

from __future__ import annotations

import re

import numpy as np
import pytest

from tests.docs.test_docs import lines_of, same_output
from tests.support import ROOT
from tests.support.exports import beside
from tumble.export import FORMATS, export_calibration
from tumble.result.calibration import read_calibration
from tumble.sensors.model import Block

PAGES = ROOT / "docs/reference/export"
BLOCK = re.compile(r"<!-- example: (\S+) -->\n```text\n(.*?)^```$", re.M | re.S)
EXAMPLE, WARMED = (read_calibration(PAGES / f"{name}.json") for name in ("example", "example-thermal"))


@pytest.mark.parametrize("to", FORMATS)
def test_every_format_has_a_page_with_what_is_written_for_the_example(to: str) -> None:
    text = (PAGES / f"{to}.md").read_text(encoding="utf-8")
    assert "## What is lost" in text
    assert f"(../reference/export/{to}.md)" in (ROOT / "docs/howto/export.md").read_text(encoding="utf-8")
    blocks = BLOCK.findall(text)
    assert [name for name, _ in blocks] == [to] * FORMATS[to].text
    made = WARMED if to.endswith("thermal") else EXAMPLE
    found = export_calibration(made, to, **beside(to)).content.decode("latin-1").encode("latin-1")
    for _, shown in blocks:
        assert same_output(lines_of(shown), lines_of(found.decode()))


def test_the_examples_matrices_are_those_of_its_parameters() -> None:
    for kind, model in (("accel", EXAMPLE.accel), ("gyro", EXAMPLE.gyro)):
        values = np.array([p.value for p in EXAMPLE.parameters if p.name.startswith(kind)])
        made = Block(kind=kind, axes=np.eye(3)).model(values)  # type: ignore[arg-type]
        assert model is not None
        np.testing.assert_allclose(model.matrix, made.matrix, atol=1e-16)
        np.testing.assert_array_equal(model.bias, made.bias)
