"""The correction in the calibration file is the one that the library applies, by the formula that stands beside it."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.support.calibrated import HEXAD, calibration, warmed
from tests.use.test_applied_model import larger, read, truth
from tumble.export import export_calibration
from tumble.inference.estimate import Outcome
from tumble.result.calibration import Calibration
from tumble.result.correction import correction_content
from tumble.units import ZERO_CELSIUS, Array

PRODUCTS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def by_formula(of: dict[str, Any], y: Array, force: Array | None = None, celsius: float | None = None) -> Array:
    """What the documented formula makes of readings (N, n), with nothing but the numbers of the file."""
    number = {key: np.array(value) for key, value in of.items() if isinstance(value, list)}
    bias, gain = number["bias"], 1.0
    if celsius is not None:
        d = celsius - number["reference"]
        bias = bias + d * (number["bias_slope"] + d * number["bias_curve"])
        gain = 1.0 + d * (number["scale_slope"] + d * number["scale_curve"])
    terms, x = np.zeros_like(y), np.zeros((len(y), 3))
    for _ in range(6):
        x = (y - bias - terms) / gain @ number["inverse"].T
        s = x @ number["axis"].T if "axis" in number else np.zeros_like(y)
        terms = number.get("cubic", 0.0) * s**3 + number.get("asymmetry", 0.0) * np.abs(s)
        if "quadratic" in number:
            terms = terms + np.stack([x[:, k] * x[:, m] for k, m in PRODUCTS], axis=1) @ number["quadratic"].T
        if "by_force" in number:
            assert force is not None
            terms = terms + force @ number["by_force"].T
        if "by_products" in number:
            assert force is not None
            terms = terms + np.stack([force[:, k] * force[:, m] for k, m in PRODUCTS], axis=1) @ number["by_products"].T
    return x


@pytest.mark.parametrize("axes", [None, HEXAD / np.linalg.norm(HEXAD, axis=1)[:, None]], ids=["triad", "six sensors"])
@pytest.mark.parametrize("celsius", [None, 45.0])
def test_the_formula_with_its_numbers_corrects_as_the_library_does(axes: Array | None, celsius: float | None) -> None:
    made, instrument, values = larger(accel=axes, gyro=axes)
    force, rate = truth(1)
    accel, gyro = read(instrument, values, force, rate)
    warm = None if celsius is None else np.full(len(accel), celsius + ZERO_CELSIUS)
    found_f, found_w = made.apply(accel, gyro, temperature=warm)
    assert found_w is not None
    content = json.loads(export_calibration(made, "json").content)["correction"]
    f = by_formula(content["accel"], accel, celsius=celsius)
    np.testing.assert_allclose(f, found_f, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(by_formula(content["gyro"], gyro, f, celsius), found_w, rtol=0.0, atol=1e-9)


def test_the_examples_are_what_the_formula_gives() -> None:
    for made in (larger()[0], calibration(), warmed(calibration())):
        for kind, symbol in (("accel", "f"), ("gyro", "w")):
            of = correction_content(made)[kind]
            y, true = np.array([of["example"]["y"]]), np.array([of["example"][symbol]])
            force = np.array([of["example"]["f"]]) if "by_force" in of else None
            np.testing.assert_allclose(by_formula(of, y, force), true, rtol=0.0, atol=1e-12)


def test_a_linear_calibration_has_a_matrix_and_a_bias_alone() -> None:
    made = calibration()
    of = correction_content(made)["accel"]
    assert set(of) == {"formula", "unit", "bias", "inverse", "example"}
    assert of["formula"] == "f = inverse · (y − bias)"
    assert made.accel is not None
    np.testing.assert_allclose(np.array(of["inverse"]) @ made.accel.matrix, np.eye(3), atol=1e-14)


def test_the_file_has_it_and_a_refused_calibration_has_none(tmp_path: Any) -> None:
    made = larger()[0]
    made.write(tmp_path / "calibration.json")
    content = json.loads((tmp_path / "calibration.json").read_text(encoding="utf-8"))
    assert content["correction"] == correction_content(made)
    off = content["correction"]["accel"]["linear"]["off_by"]
    assert 0.0 < off["rms"] < off["most"]
    assert Calibration.content(replace(made, outcome=Outcome(reasons=("no",))))["correction"] == {}
