"""Stage 3, biases of the gyros from rests: what each method errs by, Eqs. (16) to (18) and what the paper leaves out."""

from __future__ import annotations

import numpy as np
import pytest

from rough_launches import EARTH, GRAVITY, LATITUDE, PROGRAMME
from tumble.earth import EARTH_RATE
from tumble.methods.gyro_bias import (
    invariant_bias,
    scalar_bias,
    turned_bias,
    two_position_bias,
    vector_bias,
    vertical_bias,
)
from tumble.programme import attitude
from tumble.rotation import rotation_matrix
from tumble.units import DEGREE, DEGREE_PER_HOUR, Array

NOMINAL = np.array([p.vertical_b for p in PROGRAMME.positions])
Ω_N, Ω_U = EARTH[:2]
POLAR = rotation_matrix(np.array([0.0, 0.0, LATITUDE])) @ attitude("NUE")
"""X along the axis of the Earth: north lifted by the latitude."""


def at_rest(L: Array, bias: Array, accel_bias: Array) -> tuple[Array, Array]:
    """Rates and specific forces (..., 3) in attitudes L (..., 3, 3)."""
    return np.swapaxes(L, -1, -2) @ EARTH + bias, GRAVITY * L[..., 1, :] + accel_bias


def turned(L: Array, degrees: float, rng: np.random.Generator, n: int) -> Array:
    """Attitudes after rotations uniform within ± degrees about each geographic axis."""
    shape = (n, *L.shape[:-2], 3)
    return rotation_matrix(degrees * DEGREE * rng.uniform(-1, 1, shape)) @ L


def rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def test_perfect_accelerometers_make_the_invariant_exact_at_any_tilt() -> None:
    rng = np.random.default_rng(1)
    bias = 100 * DEGREE_PER_HOUR * rng.standard_normal(3)
    rate, force = at_rest(turned(np.array([p.matrix for p in PROGRAMME.positions]), 20.0, rng, 1)[0], bias, np.zeros(3))
    np.testing.assert_allclose(invariant_bias(rate, force, EARTH), bias, atol=1e-14 * DEGREE)


def test_the_reference_errs_by_equation_16() -> None:
    rng = np.random.default_rng(2)
    L = rotation_matrix(rng.uniform(-3, 3, 3))
    bias, accel_bias = 1e-6 * DEGREE_PER_HOUR * rng.standard_normal(3), 1e-8 * rng.standard_normal(3)
    rate, force = at_rest(L, bias, accel_bias)
    w_N, δω_E = (L @ accel_bias)[0] / GRAVITY, (L @ bias)[2]
    reference_error = L.T @ np.array([Ω_U * w_N, -Ω_N * w_N, δω_E])
    found = vector_bias(rate[None], force[None], EARTH)[0]
    np.testing.assert_allclose(bias - found, reference_error, rtol=1e-4)


def test_at_the_polar_axis_deviations_enter_by_equation_17_and_the_bias_squared() -> None:
    w_N, bias = 2e-3, np.array([0.1, -0.2, 0.3]) * DEGREE_PER_HOUR
    θ = np.array([0.4, -0.3, 0.5]) * DEGREE
    L = rotation_matrix(θ) @ POLAR
    rate, force = at_rest(L, bias, L.T @ np.array([w_N, 0.0, 0.0]))
    δω_E = (L @ bias)[2]
    error = bias[0] - vector_bias(rate[None], force[None], EARTH)[0, 0]
    linear = -θ[2] * EARTH_RATE * w_N / GRAVITY + δω_E * (θ[0] * np.sin(LATITUDE) - θ[1] * np.cos(LATITUDE))
    assert error - linear == pytest.approx(-(δω_E**2) / (2 * EARTH_RATE), rel=0.05)
    assert abs(linear) > 0.3 * abs(error)


def test_azimuth_of_triad_leaves_the_squared_bias_that_the_paper_has_not() -> None:
    bias = np.array([0.0, 0.0, 0.3 * DEGREE_PER_HOUR])  # east, at the polar axis
    rate, force = at_rest(POLAR, bias, np.zeros(3))
    found = vector_bias(rate[None], force[None], EARTH)[0, 0]
    assert -found / DEGREE_PER_HOUR == pytest.approx(-3.0e-3, abs=0.1e-3)  # true bias: zero


def test_vertical_axes_err_by_equation_18() -> None:
    w_N, bias = 2e-3, np.array([0.1, -0.2, 0.3]) * DEGREE_PER_HOUR
    θ = np.array([0.4, -0.3, 0.5]) * DEGREE
    L = rotation_matrix(θ) @ attitude("UEN")
    rate, force = at_rest(L, bias, L.T @ np.array([w_N, 0.0, 0.0]))
    error = bias[0] - vector_bias(rate[None], force[None], EARTH)[0, 0]
    δω_E, b = (L @ bias)[2], w_N / GRAVITY
    # the deviation of X from the vertical is +θ_N towards east, −θ_E towards north
    expected = -Ω_N * b - θ[2] * Ω_U * b + θ[0] * δω_E
    assert error == pytest.approx(expected, rel=2e-2)


def test_the_accelerometer_floor_is_that_of_the_paper() -> None:
    L = attitude("UEN")
    rate, force = at_rest(L, np.zeros(3), L.T @ np.array([1e-4, 0.0, 0.0]))
    found = vector_bias(rate[None], force[None], EARTH)[0, 0]
    arcsec_per_second = 1.53e-4 * np.cos(LATITUDE)
    assert found / (DEGREE / 3600) == pytest.approx(arcsec_per_second, rel=2e-3)


def test_the_scalar_method_leaves_squares_that_cancel_over_the_programme() -> None:
    bias = np.array([0.3, -0.2, 0.1]) * DEGREE_PER_HOUR
    L = np.array([p.matrix for p in PROGRAMME.positions])
    rate, force = at_rest(L, bias, np.zeros(3))
    δω = L @ bias
    z = ((rate**2).sum(axis=-1) - EARTH_RATE**2) / (2 * EARTH_RATE)
    east = np.cross(rate, L[:, 1])
    east /= np.linalg.norm(east, axis=-1, keepdims=True)
    polar = (np.cross(L[:, 1], east) * Ω_N + L[:, 1] * Ω_U) / EARTH_RATE
    left = (δω[:, 0] ** 2 + δω[:, 1] ** 2 - δω[:, 2] ** 2) / (2 * EARTH_RATE)
    np.testing.assert_allclose(z - polar @ bias, left, rtol=0.1, atol=2e-2 * np.abs(left).max())
    error = scalar_bias(rate[:12], force[:12], EARTH) - bias
    assert np.abs(error).max() < 0.1 * np.abs(left).max()


def test_one_pass_of_the_methods_errs_as_section_5_says() -> None:
    """RMS relative errors, 200 launches, tilts ±1.5°, biases 0.03 … 1 °/h rms, perfect accelerometers but for 1e-6 g:
    published 0.7 % vector, 0.05–1.4 % scalar, 0.002–0.04 % dot product."""
    rng = np.random.default_rng(6)
    L = turned(np.array([p.matrix for p in PROGRAMME.positions]), 1.5, rng, 200)
    direction = rng.standard_normal((200, 1, 3))
    relative = {}
    for degrees_per_hour in (0.03, 1.0):
        bias = degrees_per_hour * DEGREE_PER_HOUR * direction
        rate, force = at_rest(L, bias, np.zeros(3))
        found = {
            "vector": vertical_bias(rate, force, EARTH, NOMINAL),
            "scalar": scalar_bias(rate, force, EARTH),
            "dot": invariant_bias(rate, force, EARTH),
        }
        for name, value in found.items():
            relative[name, degrees_per_hour] = rms(value - bias[:, 0]) / (degrees_per_hour * DEGREE_PER_HOUR)
    assert relative["vector", 0.03] == pytest.approx(0.007, rel=0.3)
    assert relative["vector", 1.0] == pytest.approx(0.007, rel=0.3)
    assert relative["scalar", 0.03] == pytest.approx(0.0005, rel=0.5)
    assert relative["scalar", 1.0] == pytest.approx(0.014, rel=0.5)
    assert max(relative["dot", 0.03], relative["dot", 1.0]) < 1e-8


def two_positions(turn_deg: float, bias: Array, accel_bias: Array) -> tuple[Array, Array, Array]:
    """Rates and forces (2, 3) before and after a turn about the vertical, and the turn in the non-rotating frame."""
    first = rotation_matrix(np.array([0.01, 0.4, -0.02])) @ attitude("NUE")
    second = rotation_matrix(np.array([0.0, turn_deg * DEGREE, 0.0])) @ first
    rate, force = at_rest(np.array([first, second]), bias, accel_bias)
    return rate, force, first.T @ rotation_matrix(EARTH * 20.0) @ second


def test_two_positions_at_exactly_180_degrees_err_by_the_levelling_alone() -> None:
    bias, accel_bias = np.array([0.1, -0.2, 0.3]) * DEGREE_PER_HOUR, np.array([1e-4, 0.0, -2e-4])
    rate, force, _ = two_positions(180.0, bias, accel_bias)
    found = two_position_bias(rate, force, EARTH)
    expected = bias[[0, 2]] - Ω_U * accel_bias[[0, 2]] / GRAVITY
    np.testing.assert_allclose(found[[0, 2]], expected, atol=2e-7 * DEGREE_PER_HOUR)


def test_a_turn_that_is_not_180_degrees_spoils_two_positions_unless_it_is_integrated() -> None:
    bias = np.array([0.1, -0.2, 0.3]) * DEGREE_PER_HOUR
    errors = []
    for Δ in np.linspace(-1.5, 1.5, 31):
        rate, force, C = two_positions(180.0 + Δ, bias, np.zeros(3))
        errors.append((two_position_bias(rate, force, EARTH) - bias)[[0, 2]])
        np.testing.assert_allclose(turned_bias(rate, force, C, EARTH), bias, atol=1e-10 * DEGREE_PER_HOUR)
    spread = np.hypot(*np.array(errors).T)  # of the horizontal gyros together
    np.testing.assert_allclose(spread, np.abs(0.5 * Ω_N * np.linspace(-1.5, 1.5, 31) * DEGREE), rtol=0.05, atol=1e-10)
