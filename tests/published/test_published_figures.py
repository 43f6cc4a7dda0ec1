"""The published figures of the turntable method, reproduced without noise on simulated launches.

§4, §6.5 and §6.6 give RMS errors over launches whose number is not stated. They are of second and higher order in
Gaussian parameters: the RMS over 20 launches varies by 30 % and more. A published figure counts as reproduced if it
is within the range of the RMS over groups of 20 launches out of N = 600, and the RMS over all 600 within 25 % of it.
Where a figure does not come out so, the test says what comes out instead.

Relative errors are in percent of the standard deviation the parameters are drawn with (§6.5). Columns: b, k, γ of the
accelerometers, k and γ of the gyros.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.paper_variants import accelerometer_errors, gyro_errors, invariant_bias, logged_jacobian
from tests.support.rough_launches import (
    COURSE,
    EARTH,
    GRAVITY,
    PROGRAMME,
    SIZES,
    Launches,
    launches,
    passes,
    rough_attitudes,
    rough_launches,
    values_of,
)
from tumble.earth import EARTH_RATE
from tumble.methods.paper.accelerometers import by_modulus as scalar_accelerometers
from tumble.methods.paper.accelerometers import by_vector as sequential_accelerometers
from tumble.methods.paper.accelerometers import check_for_vector as check_positions
from tumble.methods.paper.accelerometers import scalar_fit, scalar_rows
from tumble.methods.paper.four_stages import PaperMethod
from tumble.methods.paper.gyros import (
    accelerometer_leakage,
    horizontal_differences,
    programme_matrix,
    triad,
)
from tumble.rotation import unit_vector
from tumble.sensors.model import PERFECT_TRIAD, SensorModel, triad_model, triad_parameters
from tumble.units import ARCSEC, DEGREE, Array

N = 600
GROUP = 20
NINE = [8, 10, 0, 1, 4, 5, 12, 13, 14]
"""Rests of rough-table that are the programme of nine: X, Y, Z up and down, three at 45°."""

PERFECT_GYROS = triad_model(np.zeros((N, 3)), np.zeros((N, 3)), np.zeros((N, 6)))
COLUMNS = {"b": slice(0, 3), "k": slice(3, 6), "γ": slice(6, 9), "k gyro": slice(12, 15), "γ gyro": slice(15, 21)}

SEQUENTIAL = PaperMethod(name="sequential", accelerometers=sequential_accelerometers, check=check_positions)
SCALAR = PaperMethod(name="scalar", accelerometers=scalar_accelerometers, check=check_positions)


def percent(found: Array, true: Array, column: str) -> Array:
    """Squared relative errors in % (n,): mean over the parameters of a column."""
    relative = 100.0 * (found - true) / SIZES[: true.shape[1]]
    return np.asarray((relative[:, COLUMNS[column]] ** 2).mean(axis=1))


def assert_published(squares: Array, published: float, *, within: float = 0.25) -> None:
    """The figure is within the range of groups of launches, and the RMS over all of them not far from it."""
    groups = np.sqrt(squares.reshape(-1, GROUP).mean(axis=1))
    assert groups.min() <= published <= groups.max()
    assert np.sqrt(squares.mean()) == pytest.approx(published, rel=within)


# §4: the scalar method on nine orientations, positions ±1.5°


@pytest.fixture(scope="module")
def nine() -> Launches:
    rng = np.random.default_rng(40)
    values = SIZES * rng.standard_normal((N, 21))
    return launches(values, rough_attitudes(N, rng, mounting_deg=0.0, position_deg=1.5))


def scalar_passes(found: Launches, orientation: str, count: int) -> list[SensorModel]:
    """What each pass of the scalar method finds in readings compensated by the passes before."""
    total, out = PERFECT_TRIAD, []
    for _ in range(count):
        readings = total.apply(found.force[:, NINE])
        u = unit_vector(readings) if orientation == "estimated" else COURSE.nominal[NINE]
        out.append(scalar_fit(readings, u, np.array(GRAVITY)))
        total = total.composed(out[-1])
    return out


@pytest.mark.parametrize(
    ("orientation", "iterations", "column", "published"),
    [
        ("nominal", 1, "b", 1.8),
        ("nominal", 1, "k", 3.6),
        ("nominal", 1, "γ", 11.0),
        ("nominal", 2, "b", 0.11),
        ("nominal", 2, "k", 0.23),
        ("nominal", 2, "γ", 0.60),
        ("estimated", 1, "b", 0.020),
        ("estimated", 1, "k", 0.052),
        ("estimated", 1, "γ", 0.11),
    ],
)
def test_table_of_section_4(nine: Launches, orientation: str, iterations: int, column: str, published: float) -> None:
    total = PERFECT_TRIAD
    for found in scalar_passes(nine, orientation, iterations):
        total = total.composed(found)
    assert_published(percent(values_of(total, PERFECT_GYROS), nine.values, column), published)


@pytest.mark.parametrize(("column", "published"), [("b", 4e-6), ("k", 2e-5), ("γ", 1e-5)])
def test_published_second_iterations_of_section_4_are_sums_of_the_increments(
    nine: Launches, column: str, published: float
) -> None:
    """With the estimated orientation the table has 4e-6, 2e-5, 1e-5 % after two iterations. That is what the sum of
    both increments errs by; composed exactly, as here, 100 times less is left."""
    first, second = scalar_passes(nine, "estimated", 2)
    added = values_of(first, PERFECT_GYROS) + values_of(second, PERFECT_GYROS)
    exact = values_of(first.composed(second), PERFECT_GYROS)
    assert_published(percent(added, nine.values, column), published, within=0.6)
    assert np.sqrt(percent(exact, nine.values, column).mean()) < 0.01 * published


def test_the_vector_method_uses_nothing_but_the_modulus(nine: Launches) -> None:
    """The identity of §4: k̂_p = (W₁û₁ − W₂û₂)/(g(û₁ − û₂)) − 1, δŵ_p = û₁û₂ (W₂ − W₁)/(û₁ − û₂), W = |ŵ|."""
    readings = nine.force[:, NINE]
    W, u = np.linalg.norm(readings, axis=-1), unit_vector(readings)
    bias, scale, _ = triad_parameters(sequential_accelerometers(readings, COURSE.nominal[NINE], np.array(GRAVITY)))
    for p, (up, down) in enumerate(((0, 1), (2, 3), (4, 5))):
        W1, W2, u1, u2 = W[:, up], W[:, down], u[:, up, p], u[:, down, p]
        np.testing.assert_allclose(scale[:, p], (W1 * u1 - W2 * u2) / (GRAVITY * (u1 - u2)) - 1.0, atol=1e-14)
        np.testing.assert_allclose(bias[:, p], u1 * u2 * (W2 - W1) / (u1 - u2), atol=1e-13)


def test_biases_and_scales_of_the_vector_method_are_those_of_the_nominal_scalar_method(nine: Launches) -> None:
    """To first order, and only these: its angles are better than those of the nominal scalar method, since (10) uses
    the third reading (7.9 % instead of 11 %, Eq. (11))."""
    readings = nine.force[:, NINE]
    vector = values_of(sequential_accelerometers(readings, COURSE.nominal[NINE], np.array(GRAVITY)), PERFECT_GYROS)
    modulus = values_of(scalar_fit(readings, COURSE.nominal[NINE], np.array(GRAVITY)), PERFECT_GYROS)
    for column in ("b", "k"):
        error = np.sqrt(percent(vector, nine.values, column).mean())
        apart = np.sqrt(percent(vector - modulus, 0 * nine.values, column).mean())
        assert apart < 0.05 * error
    assert np.sqrt(percent(vector, nine.values, "γ").mean()) == pytest.approx(7.9, rel=0.1)
    assert np.sqrt(percent(modulus, nine.values, "γ").mean()) == pytest.approx(11.1, rel=0.1)


def test_stage_1_alone_stalls_where_both_stages_converge(nine: Launches) -> None:
    """§2: k 3.6 % → 0.05 % … with the angles corrected between the passes; 1.8 % (k), 0.9 % (b) without. We find 0.16 %
    after the second pass, since stage 2 is then 8 % wrong; 0.05 % is what is left with the angles known."""
    readings, nominal, gravity = nine.force[:, NINE], COURSE.nominal[NINE], np.array(GRAVITY)
    both, alone = PERFECT_TRIAD, PERFECT_TRIAD
    errors: dict[str, list[float]] = {"both": [], "alone b": [], "alone k": []}
    for _ in range(4):
        both = both.composed(sequential_accelerometers(both.apply(readings), nominal, gravity))
        found = sequential_accelerometers(alone.apply(readings), nominal, gravity)
        bias, scale, _ = triad_parameters(found)
        alone = alone.composed(triad_model(bias, scale, np.zeros_like(bias)))
        errors["both"].append(np.sqrt(percent(values_of(both, PERFECT_GYROS), nine.values, "k").mean()))
        for column in ("b", "k"):
            error = percent(values_of(alone, PERFECT_GYROS), nine.values, column)
            errors[f"alone {column}"].append(np.sqrt(error.mean()))
    assert errors["both"][0] == pytest.approx(3.6, rel=0.1)
    assert errors["both"][3] < 1e-3
    assert errors["alone k"][3] == pytest.approx(1.8, rel=0.15)
    assert errors["alone b"][3] == pytest.approx(0.9, rel=0.15)


# §6.3: the programme matrix


def test_rank_and_condition_of_the_programme_matrix() -> None:
    H_G, H_A = programme_matrix(PROGRAMME)
    assert H_G.shape == (18, 9)
    assert np.linalg.matrix_rank(H_G) == 9
    assert np.linalg.cond(H_G) == pytest.approx(np.sqrt(2) * np.pi / 2, abs=1e-12)
    assert np.linalg.cond(H_G) == pytest.approx(2.2214, abs=1e-4)
    assert np.linalg.matrix_rank(np.hstack([H_G, H_A])) == 15
    assert np.abs(H_A[:, 3:6]).max() < 1e-15  # all but the accelerometer scale factors
    σ = np.sqrt(np.diag(np.linalg.inv(H_G.T @ H_G)))
    np.testing.assert_allclose(σ, [0.225] * 3 + [0.5, 0.289, 0.289, 0.5, 0.5, 0.289], atol=5e-4)


def test_the_programme_matrix_is_the_table_of_section_6_3() -> None:
    π = np.pi
    kx, ky, kz, xy, xz, yx, yz, zx, zy = np.eye(9)
    by_gyros = [
        [-2 * yx, π * kx],
        [-2 * xy, 2 * zy],
        [-2 * yx, -π * kx],
        [-2 * zy, π * ky],
        [-2 * yz, 2 * xz],
        [-2 * zy, -π * ky],
        [-2 * xz, π * kz],
        [-2 * zx, 2 * yx],
        [-2 * xz, -π * kz],
    ]
    bx, by, bz, _, _, _, ayx, azx, azy = np.eye(9)
    none = np.zeros(9)
    by_accelerometers = [
        [none, -2 * bz],
        [-2 * bx, 2 * bz - 2 * azy],
        [none, -2 * bz],
        [none, -2 * bx],
        [-2 * by, 2 * bx],
        [none, -2 * bx],
        [-2 * azx, -2 * by],
        [-2 * bz + 2 * azx, 2 * by - 2 * ayx],
        [-2 * azx, -2 * by],
    ]
    H_G, H_A = programme_matrix(PROGRAMME)
    np.testing.assert_allclose(H_G, np.reshape(by_gyros, (18, 9)), atol=1e-14)
    np.testing.assert_allclose(H_A, np.reshape(by_accelerometers, (18, 9)), atol=1e-14)


def test_leakage_of_accelerometer_errors_is_that_of_section_6_3() -> None:
    bx, by, bz, _, _, _, ayx, azx, azy = np.eye(9)
    none = np.zeros(9)
    expected = [none, none, none]  # scale factors
    expected += [bx, bx / 3 + azx * 2 / 3, by / 3 - ayx / 3, by, bz - azx, bz / 3 - azy / 3]  # xy xz yx yz zx zy
    np.testing.assert_allclose(accelerometer_leakage(PROGRAMME), expected, atol=1e-14)


# §6.5: all four stages, mounting and positions ±amplitude


@pytest.fixture(scope="module", params=[0.5, 1.0, 1.5])
def rough(request: pytest.FixtureRequest) -> tuple[float, dict[str, list[Array]], Launches]:
    """Parameters after each of three passes, by method."""
    amplitude = float(request.param)
    found = rough_launches(N, 65, mounting_deg=amplitude, position_deg=amplitude)
    runs = {
        "perfect accelerometers": passes(found, SEQUENTIAL, 3, accel=found.accel),
        "sequential": passes(found, SEQUENTIAL, 3),
        "scalar": passes(found, SCALAR, 3),
    }
    return amplitude, {name: [values_of(*models) for models in run] for name, run in runs.items()}, found


SECTION_6_5 = {  # k and γ of the gyros, %, iterations 1, 2 and 3 where published
    ("perfect accelerometers", 0.5): [(0.61, 2.0), (0.02, 0.03)],
    ("perfect accelerometers", 1.0): [(1.2, 4.0), (0.08, 0.11), (0.002, 0.006)],
    ("perfect accelerometers", 1.5): [(1.8, 6.0), (0.19, 0.24), (0.008, 0.02)],
    ("sequential", 0.5): [(0.61, 5.7), (0.03, 0.11)],
    ("sequential", 1.0): [(1.2, 11.4), (0.11, 0.44), (0.004, 0.018)],
    ("sequential", 1.5): [(1.8, 17.0), (0.25, 0.99), (0.013, 0.06)],
    ("scalar", 1.0): [(1.2, 4.0), (0.08, 0.11), (0.002, 0.006)],
}


def test_rows_of_section_6_5(rough: tuple[float, dict[str, list[Array]], Launches]) -> None:
    """Iterations 1 and 2 within 25 %, the third, of third order and published with one digit, within 60 %."""
    amplitude, runs, found = rough
    rows = {method: rows for (method, at), rows in SECTION_6_5.items() if at == amplitude}
    assert len(rows) >= 2
    for method, published in rows.items():
        for iteration, figures in enumerate(published):
            for column, figure in zip(("k gyro", "γ gyro"), figures, strict=True):
                squares = percent(runs[method][iteration], found.values, column)
                assert_published(squares, figure, within=0.25 if iteration < 2 else 0.6)


def test_first_and_second_iterations_follow_the_coefficients_of_section_6_5(
    rough: tuple[float, dict[str, list[Array]], Launches],
) -> None:
    """1.9 %/° (k) and 7.8 %/° (γ) of rms deviation, then 0.28 and 0.34 %/°². At ±1° that is 4.5 % for γ, where the
    table has 4.0 %: the figures of a few launches."""
    amplitude, runs, found = rough
    σ = amplitude / np.sqrt(3.0)
    for iteration, figures in ((0, (1.9 * σ, 7.8 * σ)), (1, (0.28 * σ**2, 0.34 * σ**2))):
        for column, figure in zip(("k gyro", "γ gyro"), figures, strict=True):
            squares = percent(runs["perfect accelerometers"][iteration], found.values, column)
            assert np.sqrt(squares.mean()) == pytest.approx(figure, rel=0.1 if iteration == 0 else 0.2)


# §6.6: the Jacobian from the logged rate


def joint_linear(found: Launches) -> tuple[SensorModel, SensorModel]:
    """One weighted linear solution for all 21 parameters (§8): from readings as they are, rows for |ŵ|, û·ω̂ and |ω̂|
    of every rest and the 18 differences with the logged Jacobian. Weights: 120 s of 1e-4 m/s²/√Hz and 0.003 °/√h,
    0.80″ a turn."""
    force, rate, turns, n = found.force, found.rate, found.turns(PERFECT_TRIAD), len(found.values)
    u, attitude, Ω = unit_vector(force), triad(force, rate), np.linalg.norm(rate, axis=-1)
    A = accelerometer_errors(u)
    G = np.concatenate([np.broadcast_to(np.eye(3), (n, 15, 3, 3)), gyro_errors(rate)], axis=-1)
    across = rate - u * (u * rate).sum(axis=-1, keepdims=True)
    none = np.zeros((n, 15, 12))
    blocks = [
        (np.concatenate([scalar_rows(u), none], -1), np.linalg.norm(force, axis=-1) / GRAVITY - 1.0),
        (np.concatenate([_along(across, A), _along(u, G)], -1), (u * rate).sum(axis=-1) - EARTH[1]),
        (np.concatenate([none[..., :9], _along(rate / Ω[..., None], G)], -1), Ω - EARTH_RATE),
        (
            logged_jacobian(COURSE.series, attitude, force, rate, turns, EARTH),
            horizontal_differences(COURSE.series, attitude, force, turns.C, turns.duration, EARTH),
        ),
    ]
    σ_a, σ_g = 1e-4 / np.sqrt(120) / GRAVITY, 0.003 * DEGREE / 60 / np.sqrt(120)
    scale = np.repeat([1e-4, 1e-6, 1e-4], [9, 3, 9])
    rows = np.concatenate([J * scale / σ for (J, _), σ in zip(blocks, (σ_a, σ_g, σ_g, 0.80 * ARCSEC), strict=True)], 1)
    z = np.concatenate([y / σ for (_, y), σ in zip(blocks, (σ_a, σ_g, σ_g, 0.80 * ARCSEC), strict=True)], 1)
    x = (np.linalg.pinv(rows) @ z[..., None])[..., 0] * scale
    return triad_model(GRAVITY * x[:, :3], x[:, 3:6], x[:, 6:9]), triad_model(x[:, 9:12], x[:, 12:15], x[:, 15:])


def _along(direction: Array, columns: Array) -> Array:
    return np.asarray(np.einsum("...i,...ij->...j", direction, columns))


def test_with_the_logged_jacobian_one_pass_is_independent_of_the_table() -> None:
    """0.058 % (k) and 0.53 % (γ) at 1° and at 1.5°; at 15° 0.08 % and 0.28 %, of which we find 0.08 % and 0.44 %: the
    method file does not say for which pass it has 0.28 %. It is the joint one that gives 0.53 %."""
    γ = {}
    for degrees, k_published in ((1.0, 0.058), (1.5, 0.058), (15.0, 0.08)):
        found = rough_launches(N, 5, mounting_deg=degrees, position_deg=degrees)
        values = values_of(*joint_linear(found))
        assert_published(percent(values, found.values, "k gyro"), k_published)
        γ[degrees] = percent(values, found.values, "γ gyro")
    assert_published(γ[1.0], 0.53)
    assert_published(γ[1.5], 0.53)
    assert np.sqrt(γ[15.0].mean()) == pytest.approx(np.sqrt(γ[1.0].mean()), rel=0.15)


def test_scalar_dot_product_and_logged_jacobian_in_one_pass() -> None:
    """§6.5 has 0.032 % (k) and 0.37 % (γ). We find 0.023 % and 0.20 %, with the turns integrated about the biases of
    stage 3; it is 0.023 % and 0.29 % with the biases put in through the Jacobian, 0.046 % and 0.32 % with the
    accelerometer errors as well, so that the published pass will have been one of these."""
    found = rough_launches(N, 5, mounting_deg=1.0, position_deg=1.0)
    accel = scalar_fit(found.force, unit_vector(found.force), np.array(GRAVITY))
    force = accel.apply(found.force)
    bias = invariant_bias(found.rate, force, EARTH)
    stage_3 = SensorModel(matrix=np.broadcast_to(np.eye(3), (N, 3, 3)), bias=bias)
    rate, turns = stage_3.apply(found.rate), found.turns(stage_3)
    attitude = triad(force, rate)
    y = horizontal_differences(COURSE.series, attitude, force, turns.C, turns.duration, EARTH)
    J = logged_jacobian(COURSE.series, attitude, force, rate, turns, EARTH)[..., 12:]
    x = (np.linalg.pinv(J) @ y[..., None])[..., 0]
    gyro = stage_3.composed(triad_model(np.zeros((N, 3)), x[:, :3], x[:, 3:]))
    values = values_of(accel, gyro)
    assert np.sqrt(percent(values, found.values, "k gyro").mean()) == pytest.approx(0.023, rel=0.15)
    assert np.sqrt(percent(values, found.values, "γ gyro").mean()) == pytest.approx(0.20, rel=0.15)
