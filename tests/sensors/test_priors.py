"""Usual sizes of groups beyond the linear model: which are priors, and how a data sheet states them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from tumble.sensors.grades import GRADES
from tumble.sensors.parameters import (
    TYPICAL_OF_BOUND,
    further_groups,
    next_poorer_grade,
    prior_of,
    prior_sizes,
    variable_of,
)
from tumble.units import DEGREE, G_STANDARD

G = G_STANDARD


@pytest.mark.parametrize(
    ("key", "text", "power", "full_scale"),
    [
        ("accel_quadratic", "0.5 % of 16 g", 2, 16.0 * G),
        ("accel_cubic", "0.2 % of 8 g", 3, 8.0 * G),
        ("gyro_cubic", "100 ppm of 500 deg/s", 3, 500.0 * DEGREE),
    ],
)
def test_a_nonlinearity_of_the_full_scale_is_the_coefficient_that_leaves_the_best_line_by_it(
    key: str, text: str, power: int, full_scale: float
) -> None:
    """The best line is found over the range by least squares on Chebyshev points and its largest deviation, to 1 %."""
    _, size = prior_of(key, text)
    x = full_scale * np.cos(np.pi * (np.arange(2000) + 0.5) / 2000)
    bound = size / TYPICAL_OF_BOUND
    readings = bound * x**power
    line = Polynomial.fit(x, readings, 1)
    share = float(text.split()[0]) * (1e-2 if "%" in text else 1e-6)
    left = readings - line(x)
    left = left - 0.5 * (left.max() + left.min())
    assert np.abs(left).max() == pytest.approx(share * full_scale, rel=0.01)


@pytest.mark.parametrize("text", ["0.5 % of", "0.5 % of 16", "0.5 of 16 g", "0.5 % of 0 g", "1 % of 2 deg"])
def test_a_bad_nonlinearity_is_one_line(text: str) -> None:
    with pytest.raises(ValueError, match=r"^accel_quadratic: expected a positive number"):
        prior_of("accel_quadratic", text)


def test_no_grade_has_a_larger_prior_than_a_poorer_one() -> None:
    """But of lever arms and of lags behind the thermometer, which go by the size and mass of the housing."""
    for grade in GRADES:
        worse = next_poorer_grade(grade)
        if worse is not None:
            sizes, larger = prior_sizes(grade), prior_sizes(worse)
            by_housing = {"accel.lever", "accel.lag", "gyro.lag"}
            assert all(sizes[name] <= larger[name] for name in (sizes.keys() & larger.keys()) - by_housing)


def test_the_drift_of_mems_is_in_their_in_run_process_alone() -> None:
    drifts = {group.name for group in further_groups() if group.variable == "time"}
    assert drifts
    assert not drifts & prior_sizes("mems").keys()
    assert drifts & prior_sizes("tactical").keys()
    assert variable_of("accel.bias.drift") == "time"
    assert prior_sizes("mems", {"accel.bias.drift": 1e-6})["accel.bias.drift"] == 1e-6
