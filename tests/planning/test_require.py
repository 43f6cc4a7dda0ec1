"""Requirements, the inverse of the budget: the published tolerances, and the way there and back."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from accuracy_formulas import axis_angle_rms, up_down_rms
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support.formula_setup import AXIS, BIAS, SCALE, SETUP, SILENT, indirect_coefficients
from tumble.errors import InputError
from tumble.planning.bounds import bound
from tumble.planning.budget import GROUPS, budget
from tumble.planning.error_propagation import BUDGETED_METHODS, BudgetedMethod
from tumble.planning.requirements import require
from tumble.planning.setup import Setup
from tumble.programme.positions import programme
from tumble.sensors.parameters import Terms
from tumble.units import ARCSEC, DEGREE, DEGREE_PER_HOUR

NINE_ONLY = replace(SILENT, programme=programme("nine"), table_error=DEGREE, mounting_error=0.0)
GYRO_BIAS = SETUP.gyro.bias


@pytest.mark.parametrize(
    ("group", "percent", "tilt_deg"),
    [
        ("accel.scale", 1.0, 0.242),
        ("accel.scale", 3.5, 0.846),
        ("accel.bias", 1.0, 0.492),
        ("accel.bias", 3.5, 1.72),
        ("accel.axis", 3.0, 0.331),
        ("accel.axis", 5.0, 0.552),
        ("accel.axis", 10.0, 1.10),
    ],
)
def test_accelerometer_tolerances_are_those_of_the_reference(group: str, percent: float, tilt_deg: float) -> None:
    """§7, by (7b) and (11), rms deviation per axis, independent in the nine positions."""
    spread = {"accel.scale": SCALE, "accel.bias": 2e-3, "accel.axis": AXIS}[group]
    (row,) = require({group: percent / 100.0 * spread}, NINE_ONLY, method="sequential").rows
    assert (row.feasible, row.limited, row.rest) == (True, True, 0.0)
    assert row.tilt / DEGREE == pytest.approx(tilt_deg, rel=0.01)
    assert row.table_error == pytest.approx(math.sqrt(3.0) * row.tilt)
    assert row.mounting_error == 0.0


def test_closed_forms_invert_to_the_same_tolerances() -> None:
    """(7b) and the rms form of (11) at the reference's tolerances give the wanted errors."""
    assert up_down_rms(0.242 * DEGREE, BIAS, AXIS)[0] == pytest.approx(1e-6, rel=5e-3)
    assert up_down_rms(0.492 * DEGREE, BIAS, AXIS)[1] == pytest.approx(0.01 * BIAS, rel=5e-3)
    assert axis_angle_rms(1.10 * DEGREE, BIAS, AXIS) == pytest.approx(0.1 * AXIS, rel=5e-3)


@pytest.mark.parametrize(("percent", "tilt_deg"), [(1.0, 0.573), (3.0, 1.72)])
def test_vertical_gyro_tolerances_are_those_of_the_reference(percent: float, tilt_deg: float) -> None:
    """§7, by (18)."""
    (row,) = require(
        {"gyro.bias": percent / 100.0 * GYRO_BIAS}, NINE_ONLY, method="sequential", gyro_bias="vertical"
    ).rows
    assert row.tilt / DEGREE == pytest.approx(tilt_deg, rel=0.01)
    assert "(18)" in row.estimator


def test_one_per_cent_along_the_earths_axis_is_infeasible_with_any_table() -> None:
    """§7, by (17): a bias of 0.3 °/h has a floor of 1.7 %."""
    (row,) = require({"gyro.bias": 0.01 * GYRO_BIAS}, NINE_ONLY, method="sequential", gyro_bias="polar").rows
    assert not row.feasible
    assert (row.table_error, row.mounting_error, row.rest) == (0.0, 0.0, math.inf)
    assert {"TRIAD", "(18)"} <= set(row.reason.replace(",", "").split())
    assert "\n" not in row.reason
    found, unit = row.reason.split("at least ")[1].split(",")[0].split(" ")
    assert unit == "°/h"
    assert 100.0 * float(found) * DEGREE_PER_HOUR / GYRO_BIAS == pytest.approx(1.73, abs=0.01)
    assert require({"gyro.bias": 0.03 * GYRO_BIAS}, NINE_ONLY, method="sequential", gyro_bias="polar").feasible


def test_indirect_tolerances_follow_the_coefficients() -> None:
    """§7: relative error c₁ σ after one pass, c₂ σ² after two; with accelerometers of the scalar method nothing else
    counts but what is left of Earth's rate and the squares."""
    setup = replace(SILENT, table_error=DEGREE, mounting_error=DEGREE)
    c1, c2 = indirect_coefficients(setup)["gyro.axis"]
    for iteration, σ in ((1, 0.05 / c1), (2, math.sqrt(0.005 / c2))):
        wanted = {"gyro.axis": (0.05 if iteration == 1 else 0.005) * 10.0 * ARCSEC}
        found = require(wanted, setup, method="scalar", iteration=iteration)
        assert found.table_error / math.sqrt(3.0) == pytest.approx(σ, rel=0.02)
        assert found.table_error == found.mounting_error


@settings(max_examples=12, deadline=None)
@given(
    group=st.sampled_from(GROUPS),
    part=st.floats(0.005, 0.2),
    method=st.sampled_from(BUDGETED_METHODS),
    iteration=st.sampled_from([1, 2, 3]),
    mounting=st.just(0.0) | st.floats(1e-9, 2.0),
)
def test_a_budget_of_what_is_required_meets_the_wish(
    group: str, part: float, method: BudgetedMethod, iteration: int, mounting: float
) -> None:
    """Round trip: at the tolerances and the rest asked for, the predicted error is the wanted one, or less if the table
    does not matter within 5°."""
    setup = replace(SETUP, mounting_error=mounting * DEGREE)
    spread = setup.accel if group.startswith("accel") else setup.gyro
    wanted = part * float(getattr(spread, group.split(".")[1]))
    found = require({group: wanted}, setup, method=method, iteration=iteration)
    (row,) = found.rows
    if not row.feasible:
        exact = replace(setup, table_error=0.0, mounting_error=0.0, rest=1e12)
        assert budget(exact, (method,), iteration).row(method, group, iteration).error > 0.999 * wanted
        return
    met = replace(setup, table_error=row.table_error, mounting_error=row.mounting_error, rest=row.rest)
    error = budget(met, (method,), iteration).row(method, group, iteration).error
    assert error <= wanted * (1.0 + 1e-5)
    if row.limited:
        assert error == pytest.approx(wanted, rel=1e-5)


def test_requirements_take_the_strictest_of_those_that_can_be_met() -> None:
    wanted = {"accel.scale": 3.5e-6, "accel.bias": 5e-5, "gyro.axis": 0.1 * ARCSEC}
    found = require(wanted, SETUP, method="sequential")
    assert not found.feasible
    met = [row for row in found.rows if row.feasible]
    assert [row.group for row in met] == ["accel.scale", "accel.bias"]
    assert found.table_error == min(row.table_error for row in met)
    assert found.rest == max(row.rest for row in met)
    assert "turn faster" in found.rows[2].reason or "average" in found.rows[2].reason


def test_equal_tolerances_where_the_setup_has_none() -> None:
    found = require({"accel.scale": 3.5e-6}, replace(SETUP, table_error=0.0, mounting_error=0.0), method="sequential")
    assert found.table_error == found.mounting_error > 0.0


def test_impossible_wishes_are_refused_in_one_line() -> None:
    for wanted, words in (({"gyro.colour": 1.0}, "gyro.colour"), ({"accel.bias": 0.0}, "more than 0")):
        with pytest.raises(InputError, match=words):
            require(wanted, SETUP)
    with pytest.raises(InputError, match=r"gyro\.scale"):
        require({"gyro.scale": 1e-6}, NINE_ONLY, method="sequential")
    with pytest.raises(InputError, match="iterations"):
        budget(SETUP, iterations=0)


@pytest.mark.parametrize("terms", ["linear", "full"])
def test_the_default_method_is_promised_what_it_has(terms: Terms) -> None:
    """The bound at the rest that is stated is what is wanted, with all groups 5.04 ppm after a minute; what no rest
    gives is refused with what the method has."""
    setup = Setup.of(terms=terms)
    least = bound(setup).rms("accel.scale")
    assert least == pytest.approx({"linear": 0.645e-6, "full": 5.04e-6}[terms], rel=0.01)
    (row,) = require({"accel.scale": 1.02 * least}, setup).rows
    assert row.feasible
    assert 0.0 < row.rest <= 60.0
    assert bound(replace(setup, rest=row.rest)).rms("accel.scale") == pytest.approx(1.02 * least, rel=0.01)
    (refused,) = require({"accel.scale": 0.1 * least}, setup).rows
    assert not refused.feasible
    assert "which the method joint has with rests of" in refused.reason


def test_single_rests_are_not_for_the_default_method() -> None:
    with pytest.raises(InputError, match="gyro_bias: expected programme with the method joint, found 'polar'"):
        require({"gyro.bias": 1e-6}, SETUP, gyro_bias="polar")


def test_formulas_of_the_linear_model_are_not_given_for_other_instruments() -> None:
    """Beside the least that any method can have, 5.07 ppm, stood an error of 0.7 ppm."""
    full = Setup.of(terms="full")
    for method in BUDGETED_METHODS:
        with pytest.raises(InputError, match=f"expected linear for the method {method}"):
            budget(full, (method,))
        with pytest.raises(InputError, match=f"expected linear for the method {method}"):
            require({"accel.scale": 1e-5}, full, method=method)
    rows = budget(full, ("joint",)).rows
    least = bound(full)
    assert [row.error for row in rows] == [least.rms(row.group) for row in rows]
    assert next(row for row in rows if row.group == "accel.scale").dominating == "groups beyond the linear model"
