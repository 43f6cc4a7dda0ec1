"""Stage 4, the indirect method: its two Jacobians against the nonlinear truth, and the directions of the turns."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.paper_variants import accelerometer_errors, gyro_errors, logged_jacobian
from tests.support.rough_launches import (
    COURSE,
    EARTH,
    GRAVITY,
    PROGRAMME,
    SIZES,
    TURN_SECONDS,
    Launches,
    launches,
    rough_attitudes,
)
from tumble.errors import ProgrammeError
from tumble.methods.paper.gyros import (
    accelerometer_leakage,
    check_directions,
    horizontal_differences,
    known_turns,
    programme_matrix,
    triad,
)
from tumble.programme.positions import ANY_MOVE, Move, Position, Programme, attitude
from tumble.sensors.model import PERFECT_TRIAD
from tumble.units import DEGREE, Array

AXES = {"N": np.array([1.0, 0.0, 0.0]), "U": np.array([0.0, 1.0, 0.0])}


def table(*turns: str) -> Programme:
    """Three series with the same turns by 180°, from the attitudes of rough-table."""
    positions, moves = [], []
    for start in ("NUE", "ENU", "UEN"):
        codes = [" ".join((start, *turns[:k])) for k in range(len(turns) + 1)]
        positions += [Position(attitude=code, matrix=attitude(code), label="") for code in codes]
        moves += [Move(axis=AXES[t[0]], angle=float(t[1:]) * DEGREE) for t in turns] + [ANY_MOVE]
    return Programme(name="test", positions=tuple(positions), moves=tuple(moves[:-1]), ordered=True)


# The programme matrix


def test_columns_of_errors_are_those_of_equation_1() -> None:
    ω, u = np.array([0.3, -0.4, 0.5]), np.array([0.6, 0.0, -0.8])
    kx, ky, kz, xy, xz, yx, yz, zx, zy = values = 1e-3 * np.arange(1.0, 10.0)
    E = np.array([[kx, xy, xz], [yx, ky, yz], [zx, zy, kz]])
    np.testing.assert_allclose(gyro_errors(ω) @ values, E @ ω, atol=1e-18)
    M = np.array([[xy, 0, 0], [yx, xz, 0], [zx, zy, yz]])
    b = values[:3]
    found = accelerometer_errors(u) @ np.array([*b, xy, xz, yz, yx, zx, zy])
    np.testing.assert_allclose(found, b + M @ u, atol=1e-18)


@pytest.fixture(scope="module")
def jacobian_at_the_programme() -> Array:
    return finite_differences(rough_attitudes(1, np.random.default_rng(0), mounting_deg=0.0, position_deg=0.0))


def differences_of(found: Launches) -> Array:
    """y (n, 18) of launches, from readings as they are."""
    C = found.turns(PERFECT_TRIAD).C
    return horizontal_differences(COURSE.series, triad(found.force, found.rate), found.force, C, COURSE.duration, EARTH)


def finite_differences(attitudes: Array) -> Array:
    """∂y/∂(21 parameters) at perfect sensors by central differences of the simulation; accelerometer biases in rad."""
    steps = 1e-2 * SIZES
    values = np.concatenate([np.diag(steps), -np.diag(steps)])
    high, low = np.split(differences_of(launches(values, np.broadcast_to(attitudes, (42, 15, 3, 3)))), 2)
    return np.asarray((high - low).T / (2 * steps) * np.repeat([GRAVITY, 1.0], [3, 18]))


def test_the_programme_matrix_is_that_of_the_nonlinear_simulation_but_for_the_earths_rate(
    jacobian_at_the_programme: Array,
) -> None:
    H_G, H_A = programme_matrix(PROGRAMME)
    found = np.delete(jacobian_at_the_programme, [9, 10, 11], axis=1)
    assert np.abs(found - np.hstack([H_A, H_G])).max() < 4e-3  # O(Ω T): the largest coefficient found is 3.8e-3


def test_biases_and_azimuth_disturb_the_differences_as_section_6_2_says(jacobian_at_the_programme: Array) -> None:
    """+180° about N at constant rate from X north, Y up: Δψ_N = T δω_x, Δψ_E = 2T/π δω_y, and TRIAD's azimuth error
    δω_z/Ω_N adds T δω_z to y_N."""
    T = TURN_SECONDS
    y_N, y_E = jacobian_at_the_programme[:2, 9:12]
    np.testing.assert_allclose(y_N, [0.0, -2 * T / np.pi, T], atol=4e-3 * T)
    np.testing.assert_allclose(y_E, [T, 0.0, 0.0], atol=4e-3 * T)


# The logged rate


@pytest.mark.parametrize("degrees", [0.0, 1.5, 15.0])
def test_the_logged_jacobian_is_that_of_the_nonlinear_simulation_whatever_the_table_did(degrees: float) -> None:
    rng = np.random.default_rng(3)
    attitudes = rough_attitudes(1, rng, mounting_deg=degrees, position_deg=degrees)
    perfect_launch = launches(np.zeros((1, 21)), attitudes)
    found = logged_jacobian(
        COURSE.series,
        triad(perfect_launch.force, perfect_launch.rate),
        perfect_launch.force,
        perfect_launch.rate,
        perfect_launch.turns(PERFECT_TRIAD),
        EARTH,
    )[0]
    expected = finite_differences(attitudes)
    scale = np.repeat([1.0, TURN_SECONDS, 1.0], [9, 3, 9])
    assert np.abs((found - expected) / scale).max() < 3e-5  # sums of M at 0.9° a sample


# Directions of the turns


@pytest.mark.parametrize(
    "turns", [("N+180", "U+180", "N-180"), ("N+180", "N+180", "U+180"), ("U+180", "N+180", "N+180")]
)
def test_directions_in_which_biases_cancel_are_accepted(turns: tuple[str, ...]) -> None:
    listed = table(*turns)
    check_directions(listed)
    assert np.abs(accelerometer_leakage(listed)[:3, :3]).max() < 1e-15
    H_G, H_A = programme_matrix(listed)
    assert np.linalg.matrix_rank(np.hstack([H_G, H_A])) - np.linalg.matrix_rank(H_A) == 9


@pytest.mark.parametrize(
    "turns", [("N+180", "U+180", "N+180"), ("N+180", "N-180", "U+180"), ("U+180", "N+180", "N-180")]
)
def test_directions_that_leak_biases_into_scale_factors_are_named(turns: tuple[str, ...]) -> None:
    listed = table(*turns)
    H_G, H_A = programme_matrix(listed)
    assert np.linalg.matrix_rank(H_G) == 9
    assert np.linalg.matrix_rank(np.hstack([H_G, H_A])) - np.linalg.matrix_rank(H_A) == 6
    assert np.abs(accelerometer_leakage(listed)[:3, :3]).max() == pytest.approx(2 / np.pi, abs=1e-12)
    with pytest.raises(ProgrammeError, match=rf"found {', '.join(turns)}; .* 0\.64 of a bias".replace("+", r"\+")):
        check_directions(listed)


def test_turns_that_do_not_determine_the_gyros_are_refused() -> None:
    with pytest.raises(ProgrammeError, match=r"nine gyro scale factors and angles, found 0 from none"):
        check_directions(Programme(name="still", positions=(), moves=(ANY_MOVE,), ordered=True))
    with pytest.raises(ProgrammeError, match=r"found \d from N\+180; N\+180; N\+180"):
        check_directions(table("N+180"))


def test_series_are_runs_of_known_turns() -> None:
    assert known_turns(PROGRAMME) == ((0, 1, 2), (4, 5, 6), (8, 9, 10))
