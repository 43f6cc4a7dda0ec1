"""The self-test passes here, and fails where a figure is wrong; its record can be checked by others."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest
from click.testing import CliRunner

import tumble
from tumble.cli import main
from tumble.lab import selftest as module


def test_the_reference_cases_pass_and_are_recorded_with_machine_versions_and_hashes(tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["selftest", "--by", "A. Metrologist", "-o", str(tmp_path / "record.json")])
    assert result.exit_code == 0, result.output
    assert "FAILED" not in result.stdout
    record = json.loads((tmp_path / "record.json").read_text(encoding="utf-8"))
    assert record["by"] == "A. Metrologist"
    assert record["passed"] is True
    named = " ".join(case["name"] for case in record["cases"])
    assert all(what in named for what in ("sequential", "scalar", "scalar-nominal", "ellipsoid", "mean of 3 launches"))
    assert all(case["passed"] and case["low"] <= case["figure"] <= case["high"] for case in record["cases"])
    assert {"numpy", "scipy", "polars"} <= set(record["versions"])
    source, package = Path(module.__file__), Path(tumble.__file__).parent
    assert record["source_sha256"]["lab/selftest.py"] == hashlib.sha256(source.read_bytes()).hexdigest()
    assert record["source_sha256"].keys() == {
        path.relative_to(package).as_posix()
        for path in package.rglob("*")
        if path.suffix in {".py", ".pyi", ".pyx", ".pxd", ".so", ".pyd"}
    }
    again = CliRunner().invoke(main, ["selftest", "-o", str(tmp_path / "record.json")])
    assert (again.exit_code, again.stderr.count("\n")) == (2, 1)
    signed = record.pop("sha256")
    text = json.dumps(record, sort_keys=True, ensure_ascii=False, separators=(",", ":"))
    assert signed == hashlib.sha256(text.encode()).hexdigest()


@pytest.mark.parametrize(("figure", "passed"), [(0.0, True), (1.0, True), (1.1, False), (float("nan"), False)])
def test_a_figure_beyond_its_limit_or_none_at_all_fails(figure: float, passed: bool) -> None:
    case = module.SelftestCase(name="", source="", figure=figure, low=0.0, high=1.0, unit="1")
    assert case.passed is passed


def test_a_case_that_goes_wrong_fails_the_test_and_the_exit_status(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "normal_gravity", lambda latitude, height: 9.8)  # noqa: ARG005
    for name in ("_cube", "_noiseless", "_noisy_table", "_launches", "_exchanged_columns"):
        monkeypatch.setattr(module, name, _none)
    result = CliRunner().invoke(main, ["selftest"])
    assert result.exit_code == 1
    assert "FAILED" in result.stdout


def _none() -> list[module.SelftestCase]:
    """nothing"""
    return []
