"""Stages 1 and 2, the sequential vector method: bias and scale of one axis, the angle between two.

Figures are those of §2 and §3 of the turntable method; formulas under test are written out here from the method's
text, the simulated readings come from the sensor model alone."""

from __future__ import annotations

import accuracy_formulas as paper
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tumble.errors import ProgrammeError
from tumble.methods.paper.accelerometers import (
    angle_between,
    axis_angles,
    bias_and_scale,
    by_vector,
    check_for_vector,
    levelled_cosines,
)
from tumble.programme.positions import programme
from tumble.rotation import axes_matrix, rotation_matrix, unit_vector
from tumble.sensors.model import SensorModel, triad_model, triad_parameters
from tumble.units import ARCSEC, DEGREE, Array

g = 9.815817
UP = np.array([0.0, 1.0, 0.0])
NOMINAL = np.array([p.vertical_b for p in programme("rough-table").positions])


def tilted(nominal: Array, amplitude: float, rng: np.random.Generator, n: int) -> Array:
    """Verticals (n, N, 3) in the body after rotations uniform within ± amplitude (rad) about each axis."""
    return np.asarray(
        (rotation_matrix(rng.uniform(-amplitude, amplitude, (n, len(nominal), 3))) @ nominal[..., None])[..., 0]
    )


# Stage 1


@given(st.floats(-0.05, 0.05), st.floats(-0.2, 0.2), st.floats(0.0, 3.1), st.floats(0.0, 3.1))
def test_two_rests_give_equation_4(k: float, bias: float, first: float, second: float) -> None:
    c1, c2 = np.cos(first), np.cos(second)
    if abs(c1 - c2) < 0.05:
        return
    w1, w2 = (1 + k) * g * c1 + bias, (1 + k) * g * c2 + bias
    found_bias, found_k = bias_and_scale(np.array([w1, w2]), np.array([c1, c2]), g)
    assert found_k == pytest.approx((w1 - w2) / (g * (c1 - c2)) - 1, abs=1e-12)
    assert found_bias == pytest.approx((w2 * c1 - w1 * c2) / (c1 - c2), abs=1e-11)
    assert found_k == pytest.approx(k, abs=1e-12)
    assert found_bias == pytest.approx(bias, abs=1e-11)


@given(st.floats(0.0, 1.4), st.floats(1.7, 3.1), st.floats(-0.01, 0.01), st.floats(-0.1, 0.1))
def test_errors_of_the_angles_enter_by_equations_5_and_6(first: float, second: float, k: float, bias: float) -> None:
    α, error = np.array([first, second]), np.array([3e-6, -5e-6])
    w = (1.0 + k) * g * np.cos(α) + bias
    high, low = (np.array(bias_and_scale(w, np.cos(α + s * error), g)) for s in (0.5, -0.5))
    formula = paper.levelling_bias_error(w, α, error), paper.levelling_scale_error(w, α, error, g)
    np.testing.assert_allclose(high - low, formula, rtol=1e-6, atol=1e-12)


def test_an_axis_assumed_vertical_errs_by_half_the_squared_tilt_and_stays_there() -> None:
    k, bias, ε = 1e-4, 2e-3, np.array([1.0, 0.3]) * DEGREE
    w = (1 + k) * g * np.cos(ε) * [1, -1] + bias
    signs = np.array([1.0, -1.0])
    found_bias, found_k = bias_and_scale(w, signs, g)
    k_error, bias_error = paper.assumed_vertical_errors(ε, g, k)
    assert found_k - k == pytest.approx(-8.3015e-5, abs=0.5e-9)
    assert found_k - k == pytest.approx(k_error, rel=2e-4)
    assert found_bias - bias == pytest.approx(bias_error, rel=2e-4)
    again_bias, again_k = bias_and_scale((w - found_bias) / (1 + found_k), signs, g)
    assert abs(again_k) < 1e-12
    assert abs(again_bias) < 1e-12


def test_levelled_cosines_err_by_equation_7a_whatever_the_axis() -> None:
    rng = np.random.default_rng(7)
    small = 1e-3  # of usual errors, at small tilts: what is of second order in either disappears
    bias, scale = small * np.array([2e-3, -1e-3, 3e-3]), small * np.array([1e-4, -2e-4, 1e-4])
    yx, zx, zy = small * np.array([1e-4, -2e-4, 1.5e-4])
    model = triad_model(bias, scale, np.array([yx, zx, zy]))
    for p in range(3):
        u = tilted(np.array([1.0, -1.0])[:, None] * np.eye(3)[p], 0.1 * DEGREE, rng, 1)[0]
        w = g * u @ model.matrix.T + model.bias
        found_bias, found_k = bias_and_scale(w[:, p], levelled_cosines(w, np.eye(3))[:, p], g)
        k_error, bias_error = paper.up_down_errors(p, u[0], u[1], bias / g, np.array([yx, zx, zy]))
        assert found_k - scale[p] == pytest.approx(k_error, rel=1e-2)
        assert (found_bias - bias[p]) / g == pytest.approx(bias_error, rel=1e-2)


def test_the_errors_of_every_axis_are_alike_where_equation_7_of_the_paper_has_none_for_z() -> None:
    n, σ_γ, tilt = 20_000, 25 * ARCSEC, 1.5 * DEGREE
    rng = np.random.default_rng(8)
    model = triad_model(np.zeros((n, 3)), np.zeros((n, 3)), σ_γ * rng.standard_normal((n, 3)))
    u = tilted(NOMINAL, tilt, rng, n)
    readings = g * u @ np.swapaxes(model.matrix, -1, -2)
    found = np.stack(triad_parameters(by_vector(readings, NOMINAL, np.array(g)))[:2], axis=-1)
    # four rests an axis: two of them up, two down, tilts independent
    expected = tilt / np.sqrt(3) * σ_γ / np.sqrt(2)
    np.testing.assert_allclose(np.sqrt((found[..., 1] ** 2).mean(axis=0)), expected, rtol=0.05)
    np.testing.assert_allclose(np.sqrt((found[..., 0] ** 2).mean(axis=0)) / g, expected, rtol=0.05)


# Stage 2


def in_plane(tilt_deg: float, φ: float = np.pi / 2, turn: float = 0.0) -> tuple[Array, Array, Array]:
    """Readings of two axes with the angle φ between them, 45° above and below, in a plane that leans by the tilt, and
    the specific force along its normal."""
    α, β = paper.best_elevations(φ)
    u = rotation_matrix(np.array([tilt_deg * DEGREE, 0.0, 0.0])) @ UP  # about north, in which the plane U–N lies
    axes = [np.array([np.sin(a + turn), np.cos(a + turn), 0.0]) for a in (α, β)]
    return np.asarray(g * axes[0] @ u), np.asarray(g * axes[1] @ u), np.asarray(g * u[2])


def test_the_third_reading_makes_the_angle_exact_in_a_leaning_plane() -> None:
    above, below, across = in_plane(2.0)
    assert angle_between(above, below, 0.0, g) - np.pi / 2 == pytest.approx(-251 * ARCSEC, abs=1 * ARCSEC)
    assert angle_between(above, below, across, g) - np.pi / 2 == pytest.approx(0.0, abs=1e-9 * ARCSEC)


@given(st.floats(0.3, np.pi / 2), st.floats(-5.0, 5.0), st.floats(-0.1, 0.1))
def test_any_angle_up_to_a_right_one_is_exact_from_perfect_readings(φ: float, tilt: float, turn: float) -> None:
    above, below, across = in_plane(tilt, φ, turn)
    assert angle_between(above, below, across, g) == pytest.approx(φ, abs=1e-12)


def test_the_angle_errs_by_equation_11() -> None:
    rng = np.random.default_rng(11)
    n = 2000
    b, k, γ = 2e-4 * rng.standard_normal((n, 3)), 1e-4 * rng.standard_normal((n, 3)), 1e-4 * rng.standard_normal((n, 3))
    model = triad_model(g * b, k, γ)
    yx, zx, zy = γ.T
    axes = model.matrix / np.linalg.norm(model.matrix, axis=-1, keepdims=True)
    true = axes @ np.swapaxes(axes, -1, -2)
    Γ = np.zeros((n, 3, 3))
    Γ[:, 0, 1], Γ[:, 0, 2], Γ[:, 1, 2] = yx, zx, zy
    Γ += np.swapaxes(Γ, 1, 2)
    for ξ, η in ((0, 1), (0, 2), (1, 2)):
        ζ = 3 - ξ - η
        a, c = (2 * DEGREE * rng.uniform(-1, 1, n) for _ in range(2))
        u = np.zeros((n, 3))
        u[:, ξ], u[:, η] = np.cos(a) * np.cos(np.pi / 4 + c), np.cos(a) * np.cos(3 * np.pi / 4 + c)
        u[:, ζ] = np.sin(a)
        w = g * (u[:, None] @ np.swapaxes(model.matrix, -1, -2))[:, 0] + model.bias
        found = angle_between(w[:, ξ], w[:, η], w[:, ζ], g)
        error = np.arccos(true[:, ξ, η]) - found
        sums = np.stack([Γ[:, ζ, ξ], Γ[:, ζ, η]], axis=-1)
        expected = paper.axis_angle_error_45(a, c, b[:, [ξ, η, ζ]], k[:, [ξ, η]], sums)
        assert np.sqrt((error**2).mean()) > 60 * ARCSEC
        assert np.sqrt(((error + expected) ** 2).mean()) < 0.2 * ARCSEC  # (11) is estimated less true


@given(*[st.floats(-0.02, 0.02)] * 3)
def test_axis_angles_invert_equation_2(yx: float, zx: float, zy: float) -> None:
    x, y, z = axes_matrix(0.0, 0.0, yx, 0.0, zx, zy)
    found = axis_angles(*(np.arccos(np.array(a @ b)) for a, b in ((x, y), (x, z), (y, z))))
    np.testing.assert_allclose(found, [yx, zx, zy], atol=1e-13)


def test_iterations_on_compensated_readings_converge() -> None:
    rng = np.random.default_rng(3)
    true = triad_model(2e-3 * rng.standard_normal(3), 1e-4 * rng.standard_normal(3), 1e-4 * rng.standard_normal(3))
    readings = g * tilted(NOMINAL, 1.5 * DEGREE, rng, 1)[0] @ true.matrix.T + true.bias
    found = SensorModel(matrix=np.eye(3), bias=np.zeros(3))
    errors = []
    for _ in range(6):
        found = found.composed(by_vector(found.apply(readings), NOMINAL, np.array(g)))
        errors.append(float(np.abs(found.matrix - true.matrix).max()))
    assert errors[0] > 1e-6
    assert errors[1] < 0.2 * errors[0]
    assert errors[-1] < 1e-12


def test_positions_that_are_missing_are_named() -> None:
    check_for_vector(NOMINAL)
    with pytest.raises(ProgrammeError, match="Y down; X 45° above and Y 45° below the horizon, found none"):
        check_for_vector(NOMINAL[[0, 4, 5, 8, 9, 10, 13, 14]])


def test_levelling_is_the_direction_of_the_readings() -> None:
    np.testing.assert_allclose(unit_vector(np.array([[0.0, 3.0, 4.0]])), [[0.0, 0.6, 0.8]])
