"""The accuracy formulas, one by one, against a nonlinear simulation and the published numbers."""

from __future__ import annotations

import math
from itertools import pairwise

import accuracy_formulas as paper
import numpy as np
import pytest

from tests.support.direct import DODECAHEDRON, PYRAMID
from tests.support.formula_setup import AXIS, BIAS, GRAVITY, LATITUDE, NINE, SCALE, SEED, SETUP, SIMULATION
from tumble.earth import EARTH_RATE, earth_rate
from tumble.methods.paper.accelerometers import by_vector, scalar_rows, verticals
from tumble.methods.paper.blocks import model_of, parameters_of
from tumble.methods.paper.gyros import turn_error
from tumble.programme.positions import programme
from tumble.rotation import axes_matrix, rotation_matrix
from tumble.sensors.model import Block
from tumble.units import ARCSEC, DEGREE, DEGREE_PER_HOUR, Array

EARTH = np.array(earth_rate(LATITUDE))


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(SEED)


def accel_matrix(k: Array, γ: Array) -> Array:
    """Exact S of three accelerometers."""
    return (1.0 + k)[:, None] * axes_matrix(0.0, 0.0, γ[0], 0.0, γ[1], γ[2])


def triad(w: Array, ω: Array) -> Array:
    """Attitude by TRIAD with the vertical as base vector, rows N, U, E."""
    up = w / np.linalg.norm(w)
    east = np.cross(ω, up)
    east /= np.linalg.norm(east)
    return np.array([np.cross(up, east), up, east])


def significant(value: float, reference: float, digits: int = 3) -> bool:
    """Whether two numbers agree to so many significant digits."""
    return abs(value - reference) < 0.5 * 10.0 ** (1 - digits) * abs(reference)


# -------------------- bias and scale factor --------------------


@pytest.mark.parametrize("axes", [np.eye(3), PYRAMID, DODECAHEDRON], ids=["three", "four", "six"])
def test_errors_of_accelerometers_along_any_axes_are_those_of_the_method(axes: Array, rng: np.random.Generator) -> None:
    """What the first pass leaves at tilts of ±1°, and of a triad (7a); the difference is of second order."""
    n, block = len(axes), Block(kind="accel", axes=axes)
    names = block.names
    size = np.where(
        ["axis" in name for name in names], AXIS, np.where(["scale" in name for name in names], SCALE, BIAS)
    )
    values = size * rng.standard_normal(len(names))
    nominal = np.array(list(verticals(block).values()))
    u = rotation_matrix(DEGREE * rng.uniform(-1.0, 1.0, nominal.shape)) @ nominal[..., None]
    model = model_of(block, values)
    found = parameters_of(block, by_vector(model.predict(u[..., 0]), nominal, np.array(1.0), block))
    leans = model.matrix / np.linalg.norm(model.matrix, axis=1)[:, None] - axes
    up, down = (u[: 2 * n, :, 0] - nominal[: 2 * n]).reshape(2, n, 3)
    b, k = values[:n], values[n : 2 * n]
    scale, bias = paper.redundant_up_down_errors(axes, up, down, b, k, leans)
    np.testing.assert_allclose(found[n : 2 * n] - k, scale, atol=0.05 * np.abs(scale).max())
    np.testing.assert_allclose(found[:n] - b, bias, atol=0.05 * np.abs(bias).max())
    if n == 3:
        each = [paper.up_down_errors(p, up[p], down[p], b, values[6:]) for p in range(3)]
        np.testing.assert_allclose(np.transpose(each), [scale, bias], atol=0.02 * np.abs(scale).max())


@pytest.mark.parametrize("correlation", [-1.0, -0.4, 0.0, 1.0])
def test_up_down_rms_is_that_of_the_single_errors(correlation: float, rng: np.random.Generator) -> None:
    """(7b) against (7a): 100 000 draws. An rms of that many products of Gaussians is known to 0.4 %; 2.5 % is six
    sigmas."""
    n, tilt = 100_000, 1.0 * DEGREE
    first = rng.standard_normal((n, 3))
    second = correlation * first + math.sqrt(1.0 - correlation**2) * rng.standard_normal((n, 3))
    b, γ = BIAS * rng.standard_normal((n, 3)), AXIS * rng.standard_normal((n, 3))
    expected = paper.up_down_rms(tilt, BIAS, AXIS, correlation)
    for axis in range(3):
        for found, rms in zip(paper.up_down_errors(axis, tilt * first, tilt * second, b, γ), expected, strict=True):
            assert math.sqrt(np.mean(found**2)) == pytest.approx(rms, rel=0.025)


def test_the_printed_formula_is_no_bound_for_small_biases_and_an_error_of_the_mounting() -> None:
    """RMS/(7) of the reference: 0.99 (X), 1.35 (Y), 5.86 (Z) for 2e-4 m/s², 25″, a tilt of the mounting (the tilt has
    any direction, so its rms per axis is a root of two smaller)."""
    b = 2e-4 / GRAVITY
    ratio = paper.up_down_rms(DEGREE / math.sqrt(2.0), b, AXIS, correlation=-1.0)[0] / paper.paper_up_down_rms(
        DEGREE, b, AXIS
    )
    np.testing.assert_allclose(ratio, [0.99, 1.35, 5.86], rtol=0.025)
    usual = paper.up_down_rms(DEGREE / math.sqrt(2.0), BIAS, AXIS)[0] / paper.paper_up_down_rms(DEGREE, BIAS, AXIS)
    assert np.all((usual > 0.5) & (usual < 1.0))


def test_up_and_down_conditions_the_two_positions_best() -> None:
    matrix = paper.two_position_matrix(np.array([[0.0, 180.0], [45.0, 135.0], [0.0, 90.0]]) * DEGREE)
    np.testing.assert_allclose(np.linalg.cond(matrix), [1.0, 1.414, 2.618], atol=5e-4)
    assert np.abs(np.linalg.det(matrix)) == pytest.approx([2.0, math.sqrt(2.0), 1.0])


# -------------------- angles between axes --------------------


def test_angle_variance_is_that_of_the_simulated_angles(rng: np.random.Generator) -> None:
    """(9) against (8): 400 000 draws, of which the variance is known to 0.22 %; 1.4 % is six sigmas."""
    α, β, n = 0.6, 2.3, 400_000
    k, b = SCALE * rng.standard_normal((n, 2)), BIAS * rng.standard_normal((n, 2))
    readings = (1.0 + k) * np.cos([α, β]) + b
    φ = np.arccos(readings[:, 1]) - np.arccos(readings[:, 0])
    assert np.var(φ) == pytest.approx(
        float(paper.angle_variance(np.array(α), np.array(β), SCALE**2, BIAS**2)), rel=0.014
    )


@pytest.mark.parametrize("angle_deg", [60, 75, 90, 105, 120])
def test_best_elevations_have_the_least_variance(angle_deg: int) -> None:
    """Against a grid search over the plane, both variances positive."""
    angle = angle_deg * DEGREE
    first = np.linspace(-math.pi, math.pi, 20_001)
    with np.errstate(divide="ignore"):
        grid = paper.angle_variance(first, first + angle, SCALE**2, BIAS**2)
    α, β = paper.best_elevations(angle)
    best = float(paper.angle_variance(np.array(α), np.array(β), SCALE**2, BIAS**2))
    assert best == pytest.approx(float(np.min(grid)), rel=1e-6)
    if angle_deg == 90:
        assert best == pytest.approx(2.0 * SCALE**2 + 4.0 * BIAS**2, rel=1e-12)
        np.testing.assert_allclose(paper.best_elevations(angle), [math.pi / 4, 3 * math.pi / 4])


def test_single_errors_are_explained_by_their_formulas() -> None:
    """All Monte Carlo comparisons of single errors at once, 20 000 draws; the angle error is the reference's: rms 88.6″
    of which (11) leaves 0.10″. What a formula leaves is of second order in the parameters."""
    allowed = {"(7a) k": 0.05, "(7a) δw": 0.05, "(11) φ": 0.002, "(15) k, whole": 0.005, "(16) vertical": 0.07}
    singles = SIMULATION.single_formulas(SETUP, 20_000, np.random.default_rng(SEED))
    assert {single.name for single in singles} == set(allowed)
    for single in singles:
        left = np.sqrt(np.mean((single.simulated - single.formula) ** 2) / np.mean(single.simulated**2))
        assert left < allowed[single.name], single.name
        if single.name == "(11) φ":
            assert np.sqrt(np.mean(single.simulated**2)) == pytest.approx(88.6 * ARCSEC, rel=0.02)
            assert np.sqrt(np.mean((single.simulated - single.formula) ** 2)) < 0.11 * ARCSEC


# -------------------- the scalar method --------------------


def test_nine_positions_have_the_published_condition() -> None:
    """§3: det 1, cond 6.48, noise gains 0.707, 0.707, 2.646; both axes up: 7.29; 18 positions: 2.45 and 1.41."""
    H = scalar_rows(NINE[:, 1])
    assert abs(np.linalg.det(H)) == pytest.approx(1.0)
    assert np.linalg.cond(H) == pytest.approx(6.48, abs=0.005)
    gains = np.sqrt(np.diag(np.linalg.inv(H.T @ H)))
    np.testing.assert_allclose(gains, np.repeat([0.707, 0.707, 2.646], 3), atol=5e-4)
    up = NINE[:, 1].copy()
    up[6:] = np.abs(up[6:])
    assert np.linalg.cond(scalar_rows(up)) == pytest.approx(7.29, abs=0.005)
    eighteen = np.array([p.vertical_b for name in ("cube-14", "cube-12") for p in programme(name).positions])
    eighteen = eighteen[np.abs(eighteen).min(axis=1) < 1e-9]
    H = scalar_rows(eighteen)
    assert H.shape == (18, 9)
    assert np.linalg.cond(H) == pytest.approx(2.45, abs=0.005)
    assert math.sqrt(np.diag(np.linalg.inv(H.T @ H))[8] * 18 / 9) == pytest.approx(1.41, abs=0.005)


def test_coefficient_error_is_that_of_the_nominal_matrix(rng: np.random.Generator) -> None:
    """(14): all nine components of the scalar method's error when the programme's attitudes are taken for true, tilts
    1.5°. The parameters are small, so that their squares do not count: what is left is rounding, 1e-16 of 1e-8."""
    X = 1e-5 * np.concatenate([s * rng.standard_normal(3) for s in (BIAS, SCALE, AXIS)])
    u = (rotation_matrix(1.5 * DEGREE * rng.uniform(-1, 1, (9, 3))) @ NINE)[:, 1]
    w = u @ accel_matrix(X[3:6], X[6:]).T + X[:3]
    taken = scalar_rows(NINE[:, 1])
    found = np.linalg.solve(taken, 0.5 * ((w**2).sum(axis=1) - 1.0)) - X
    formula = paper.coefficient_error(taken, taken - scalar_rows(u), X)
    np.testing.assert_allclose(found, formula, atol=2e-15)
    assert np.max(np.abs(formula)) > 1e-11


def test_scalar_residual_is_of_second_order(rng: np.random.Generator) -> None:
    """Exact residual − formula falls with the cube of the parameters: a thousandfold for a tenth."""
    u = rotation_matrix(rng.standard_normal(3)) @ np.array([0.0, 1.0, 0.0])
    left = []
    for size in (1.0, 0.1):
        X = (
            30.0
            * size
            * np.concatenate([BIAS * np.array([1, -2, 1]), SCALE * np.array([2, 1, -1]), AXIS * np.array([1, 2, 3])])
        )
        w = accel_matrix(X[3:6], X[6:]) @ u + X[:3]
        exact = 0.5 * (w @ w - 1.0) - scalar_rows(w / np.linalg.norm(w)) @ X
        linearised, orientation = paper.scalar_residuals(u, X[:3], X[3:6], X[6:])
        assert significant(float(linearised + orientation), float(exact), 1)
        left.append(abs(exact - linearised - orientation))
    assert left[0] / left[1] == pytest.approx(1000.0, rel=0.2)


@pytest.mark.parametrize("trial", range(5))
def test_scalar_scale_errors_are_the_squares(trial: int) -> None:
    """(15) and the whole second-order error against the nonlinear scalar method on the nine positions: 1 %, better than
    the two digits of the paper. The orientation part is what the true orientation would have saved."""
    rng = np.random.default_rng(trial)
    b, k, γ = (s * rng.standard_normal(3) for s in (BIAS, SCALE, AXIS))
    w = NINE[:, 1] @ accel_matrix(k, γ).T + b
    z = 0.5 * ((w**2).sum(axis=1) - 1.0)
    estimated = np.linalg.solve(scalar_rows(w / np.linalg.norm(w, axis=1, keepdims=True)), z)[3:6] - k
    true = np.linalg.solve(scalar_rows(NINE[:, 1]), z)[3:6] - k
    np.testing.assert_allclose(estimated, paper.scalar_scale_error(b, k, γ), atol=0.01 * BIAS**2)
    np.testing.assert_allclose(estimated - true, paper.orientation_scale_error(b, γ), atol=0.01 * BIAS**2)


def test_printed_scalar_error_lacks_the_angles() -> None:
    """The reference: 9.6 → 14.4e-8 for X. Same biases, same size of the angles' part."""
    b, γ = np.array([0.0, 3.1e-4 / math.sqrt(2), 3.1e-4 / math.sqrt(2)]), np.array([1.55e-4, 1.55e-4, 0.0])
    assert -paper.orientation_scale_error(b, 0.0 * γ)[0] == pytest.approx(9.6e-8, rel=0.01)
    assert -paper.orientation_scale_error(b, γ)[0] == pytest.approx(14.4e-8, rel=0.01)


# -------------------- gyro biases --------------------


def test_polar_axis_errs_by_a_few_per_cent_and_vertical_by_one() -> None:
    """The paper: at 1° not more than 3 % (worst case 2.4 %); 1e-4 m/s² costs a vertical gyro 1.53e-4 cos B ″/s."""
    bias = 0.3 * DEGREE_PER_HOUR
    worst = paper.polar_axis_error(np.array([1.0, -1.0, 0.0]) * DEGREE, np.array(0.0), np.array(bias), LATITUDE)
    assert float(worst / bias) == pytest.approx(0.024, abs=5e-4)
    level = paper.vertical_axis_error(np.zeros(3), np.array(1e-4 / GRAVITY), np.array(0.0), LATITUDE)
    assert float(-level / math.cos(LATITUDE) / ARCSEC) == pytest.approx(1.53e-4, rel=2e-3)


def test_gyro_matrix_passes_for_bias_at_rest(rng: np.random.Generator) -> None:
    """Against TRIAD, modulus and dot product with exact accelerometers: the meridian part, the parts along Ω and u."""
    E = 1e-9 * rng.standard_normal((3, 3))
    L = rotation_matrix(rng.standard_normal(3))
    up, earth = L.T @ [0.0, 1.0, 0.0], L.T @ EARTH
    ω = (np.eye(3) + E) @ earth
    seen = paper.gyro_matrix_rate_error(L, E, LATITUDE)
    tolerance = 1e-5 * 1e-9 * EARTH_RATE
    meridian = L.T @ (L @ seen * [1.0, 1.0, 0.0])
    np.testing.assert_allclose(ω - triad(up, ω).T @ EARTH, meridian, atol=tolerance)
    assert (ω @ ω - EARTH_RATE**2) / (2 * EARTH_RATE) == pytest.approx(earth @ seen / EARTH_RATE, abs=tolerance)
    assert up @ ω - EARTH[1] == pytest.approx(up @ seen, abs=tolerance)
    assert np.linalg.norm(paper.gyro_matrix_rate_error(L, 1e-4 * np.eye(3), LATITUDE)) == pytest.approx(
        1.5e-3 * DEGREE_PER_HOUR, rel=0.01
    )


# -------------------- the indirect method --------------------


def integrated_error(
    L: Array, axis: Array, angle: float, duration: float, E: Array, bias: Array, earth: Array, bumpy: bool
) -> Array:
    """Attitude error over a turn in N, U, E by fine midpoint steps, but for its precession with the Earth; the rate
    may be far from constant."""
    steps = 1500
    edges = np.linspace(0.0, 1.0, steps + 1)
    θ = angle * (edges + 0.1 * np.sin(6 * math.pi * edges) if bumpy else edges)
    h = duration / steps
    error = np.zeros(3)
    for first, last in pairwise(θ):
        middle = rotation_matrix(0.5 * (first + last) * axis) @ L
        rate = axis * (last - first) / h + earth
        error = error + h * (middle @ (E @ middle.T @ rate + bias))
    return error


def test_a_turn_integrates_to_equation_6_2(rng: np.random.Generator) -> None:
    """The bracket of (6.2), column by column: E = e nᵀ makes the error e per radian at the start."""
    n = rng.standard_normal(3)
    n /= np.linalg.norm(n)
    angle = 2.3
    nodes, weights = np.polynomial.legendre.leggauss(20)
    θ = 0.5 * angle * (nodes + 1)
    numeric = np.einsum("s,sij->ij", 0.5 * angle * weights, rotation_matrix(θ[:, None] * n))
    columns = [turn_error(np.eye(3), n, np.array(angle), np.outer(e, n)) for e in np.eye(3)]
    np.testing.assert_allclose(np.stack(columns, axis=-1), numeric, atol=1e-13)


@pytest.mark.parametrize("angle", [math.pi, -math.pi, 1.0])
def test_turn_errors_are_those_of_the_integrated_turn(angle: float, rng: np.random.Generator) -> None:
    """(6.2) for any rate profile; bias, Earth's rate and the two together at constant rate. Steps of 1/1500."""
    L, axis = rotation_matrix(rng.standard_normal(3)), np.array([0.6, 0.0, 0.8])
    E, bias, T, none = rng.standard_normal((3, 3)), rng.standard_normal(3), 20.0, np.zeros(3)
    of_matrix = integrated_error(L, axis, angle, T, E, none, none, bumpy=True)
    np.testing.assert_allclose(turn_error(L, axis, np.array(angle), E), of_matrix, atol=1e-5)
    of_bias = integrated_error(L, axis, angle, T, 0 * E, bias, none, bumpy=False)
    np.testing.assert_allclose(paper.turn_bias_error(L, axis, np.array(angle), np.array(T), bias), of_bias, atol=1e-4)
    both = integrated_error(L, axis, angle, T, E, none, EARTH, bumpy=False)
    alone = integrated_error(L, axis, angle, T, E, none, none, bumpy=False)
    of_earth = paper.turn_earth_error(L, axis, np.array(angle), np.array(T), E, LATITUDE)
    np.testing.assert_allclose(of_earth, both - alone, atol=1e-8)
    assert np.linalg.norm(of_earth) > 1e-4


def test_errors_at_the_start_grow_with_the_earths_rotation() -> None:
    """798.579e-9 rad for an azimuth error of 1e-3 rad and 20 s; the initial tilt likewise with Ω sin B."""
    change = paper.start_error_growth(np.array([0.0, 1e-3, 0.0]), np.array(20.0), LATITUDE)
    y = paper.horizontal_differences(change, np.zeros(3))
    assert f"{1e9 * y[0]:.3f}" == "798.579"
    tilted = paper.start_error_growth(np.array([2e-3, 0.0, 3e-3]), np.array(20.0), LATITUDE)
    np.testing.assert_allclose(
        paper.horizontal_differences(tilted, np.zeros(3)), -20.0 * EARTH[1] * np.array([2e-3, 3e-3])
    )
    exact = rotation_matrix(-20.0 * EARTH) @ np.array([2e-3, 1e-3, 3e-3])
    linear = paper.start_error_growth(np.array([2e-3, 1e-3, 3e-3]), np.array(20.0), LATITUDE)
    np.testing.assert_allclose(exact - [2e-3, 1e-3, 3e-3], linear, rtol=3e-3)


@pytest.mark.parametrize("axis", ["N", "U"])
@pytest.mark.parametrize("angle", [math.pi, -math.pi])
def test_misaligned_turns_err_as_published(axis: str, angle: float, rng: np.random.Generator) -> None:
    """§6.4 against (6.2) for the turn that really was, less the exact one: what is left is of second order."""
    n = np.array([1.0, 0.0, 0.0]) if axis == "N" else np.array([0.0, 1.0, 0.0])
    F = rng.standard_normal((3, 3))
    η, ν, ΔΘ = rng.standard_normal(3), rng.standard_normal(3) * (1.0 - n), float(rng.standard_normal())
    left = []
    for size in (1e-3, 1e-4):
        real = rotation_matrix(size * η)
        axis_now = (n + size * ν) / np.linalg.norm(n + size * ν)
        sense = np.array(angle + size * ΔΘ)
        change = turn_error(real, axis_now, sense, F) - turn_error(np.eye(3), n, np.array(angle), F)
        formula = paper.misaligned_turn_error(
            "N" if axis == "N" else "U", angle, F, size * η, size * ν, np.array(size * ΔΘ)
        )
        left.append(np.linalg.norm(change[[0, 2]] - formula))
        assert np.linalg.norm(formula) > size * 0.1
    assert left[0] / left[1] == pytest.approx(100.0, rel=0.1)
