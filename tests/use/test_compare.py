"""`tumble compare`: E_n by hand, one frame for both, and the false alarms that chance makes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner
from scipy.special import ndtr

from tests.support.calibrated import FRAMES, HEXAD, calibration, of_device, with_fields
from tumble.cli import main
from tumble.errors import InputError
from tumble.planning.setup import Setup
from tumble.recording.session import Site
from tumble.result.calibration import Calibration
from tumble.result.parts import Launch, Parameter
from tumble.run.calibrate import calibrate
from tumble.sensors.frames import Frame
from tumble.sensors.model import Block
from tumble.simulation.session import simulate_session
from tumble.units import Array
from tumble.use.compare import compare_calibrations


def moved(made: Calibration, by: dict[str, float]) -> Calibration:
    """The same calibration with some values changed by so many u."""
    parameters = tuple(replace(p, value=p.value + by.get(p.name, 0.0) * (p.u or 0.0)) for p in made.parameters)
    values = np.array([p.value for p in parameters])
    accel = Block(kind="accel", axes=np.eye(3)).model(values[:9])
    gyro = Block(kind="gyro", axes=np.eye(3)).model(values[9:])
    return with_fields(made, parameters=parameters, accel=accel, gyro=gyro, log_sha256="other")


def test_e_n_is_the_difference_over_the_expanded_uncertainty_of_both() -> None:
    """u 3 and 4: u(d) = 5, U = 10; a difference of 20 has E_n 2, and 4 u."""
    made = calibration()
    name = made.parameters[0].name
    one, other = (
        replace(made, parameters=(Parameter(name=name, value=value, u=u, unit="m/s^2"),), covariance=np.array([[u**2]]))
        for value, u in ((25.0, 3.0), (5.0, 4.0))
    )
    found = compare_calibrations(one, other)
    (d,) = found.differences
    assert (d.value, d.u, d.e_n) == pytest.approx((-20.0, 5.0, -2.0))
    assert found.chi_square == pytest.approx(16.0)
    assert found.degrees == 1
    assert found.probability == pytest.approx(6.334e-5, rel=1e-3)  # of ±4 σ
    assert not found.agree


def test_a_calibration_agrees_with_itself_and_it_is_said_that_the_log_is_the_same() -> None:
    made = calibration()
    found = compare_calibrations(made, made)
    assert found.agree
    assert found.chi_square == 0.0
    assert found.degrees == 21
    assert all(d.value == 0.0 for d in found.differences)
    assert any("same log" in remark for remark in found.remarks)
    np.testing.assert_allclose(found.covariance, 2.0 * made.covariance)  # type: ignore[operator,arg-type]


def test_correlations_count_in_chi_square() -> None:
    """Two parameters correlated with 0.9 that move in opposite directions: far rarer than either alone."""
    made = calibration()
    covariance = np.array([[1.0, 0.9], [0.9, 1.0]])
    names = [p.name for p in made.parameters[:2]]
    one, other = (
        replace(
            made,
            parameters=tuple(
                Parameter(name=n, value=v, u=1.0, unit="m/s^2") for n, v in zip(names, values, strict=True)
            ),
            covariance=covariance,
        )
        for values in ((1.0, -1.0), (0.0, 0.0))
    )
    # the eigenvector (1, −1)/√2 has variance 2 · 0.1, and d has √2 along it
    assert compare_calibrations(one, other).chi_square == pytest.approx(2.0 / 0.2)


@pytest.mark.parametrize("frame", [f for f in FRAMES if f != "accelerometer"])
def test_frames_are_made_the_same_before_anything_is_compared(frame: Frame) -> None:
    made = calibration()
    other = made.in_frame(frame)
    assert {p.name for p in other.parameters} != {p.name for p in made.parameters}
    for found, expected in (
        (compare_calibrations(made, other), "accelerometer"),
        (compare_calibrations(other, made), frame),
    ):
        assert found.frame == expected
        assert len(found.differences) == 21
        assert max(abs(d.e_n or 0.0) for d in found.differences) < 1e-6
        assert any("converted" in remark for remark in found.remarks)


def test_e_n_beyond_one_is_as_rare_as_chance_has_it() -> None:
    """N = 1000 pairs of 21 values drawn from their covariance: 4.55 % of |E_n| are beyond 1 (|d| beyond 2 u), and
    chi-square exceeds its 5 % point in 5 % of them. 5 σ: false alarm 6e-7 each."""
    made, rng = calibration(), np.random.default_rng(11)
    assert made.covariance is not None
    N = 1000
    values = np.array([p.value for p in made.parameters])
    drawn = rng.multivariate_normal(values, made.covariance, size=(N, 2), method="cholesky")
    beyond, rare = [], 0
    for pair in drawn:
        one, other = (
            replace(
                made,
                parameters=tuple(replace(p, value=float(v)) for p, v in zip(made.parameters, draw, strict=True)),
            )
            for draw in pair
        )
        found = compare_calibrations(one, other)
        beyond.append(np.mean([abs(d.e_n or 0.0) > 1.0 for d in found.differences]))
        rare += (found.probability or 0.0) < 0.05
    assert abs(np.mean(beyond) - 0.0455) < 5.0 * np.std(beyond) / np.sqrt(N)
    assert abs(rare / N - 0.05) < 5.0 * np.sqrt(0.05 * 0.95 / N)


def test_means_of_launches_contradict_together_as_rarely_as_chance_has_it() -> None:
    """N = 2000 pairs of means of three launches, each of the 21 parameters with its own s (2 degrees of freedom). Below
    5 % and 0.1 % are no more than that, with 4 σ of a binomial on top: false alarm 3e-5 each. A change of all values by
    12 standard deviations of the mean, which F with 2 degrees of freedom does not see, contradicts."""
    made, rng, N = calibration(), np.random.default_rng(4), 2000
    assert made.covariance is not None
    sigma = np.sqrt(np.diag(made.covariance))
    R = made.covariance / np.outer(sigma, sigma)
    launch = Launch(session="1", parameters=made.parameters, covariance=made.covariance, log_sha256="c" * 64)
    made = with_fields(made, site=None, launches=(launch, launch, launch))

    def mean_of_three(shift: float = 0.0) -> Calibration:
        values = sigma * (rng.multivariate_normal(np.zeros(len(sigma)), R, method="cholesky") + shift)
        u = sigma * np.sqrt(rng.chisquare(2.0, len(sigma)) / 2.0)
        parameters = tuple(
            replace(p, value=value, u=size, dof=2.0)
            for p, value, size in zip(made.parameters, values.tolist(), u.tolist(), strict=True)
        )
        return replace(made, parameters=parameters, covariance=R * np.outer(u, u))

    p = np.array([compare_calibrations(mean_of_three(), mean_of_three()).probability for _ in range(N)], float)
    for level in (0.05, 1e-3):
        assert (p < level).mean() < level + 4.0 * np.sqrt(level * (1.0 - level) / N)
    assert compare_calibrations(mean_of_three(), mean_of_three(12.0)).contradicts


def test_one_value_of_many_beyond_one_is_no_disagreement() -> None:
    """3.1 u of one parameter is E_n 1.55, which chance makes in 4 % of comparisons of 21; 4 u in 0.1 %."""
    made = calibration()
    made = with_fields(made, site=None, covariance=np.diag([p.u**2 for p in made.parameters if p.u is not None]))
    name = made.parameters[0].name
    for sigmas, agree in ((3.1, True), (4.0, False)):
        parameters = tuple(
            replace(p, value=p.value + sigmas * np.sqrt(2.0) * (p.u or 0.0)) if p.name == name else p
            for p in made.parameters
        )
        found = compare_calibrations(made, replace(made, parameters=parameters))
        assert found.differences[0].e_n == pytest.approx(0.5 * sigmas)
        assert found.largest_by_chance == pytest.approx(21 * 2.0 * ndtr(-sigmas))
        assert found.agree == agree


def test_parameters_of_one_only_are_named() -> None:
    made = calibration()
    found = compare_calibrations(made, calibration(with_gyro=False))
    assert len(found.differences) == 9
    assert found.missing == tuple(p.name for p in made.parameters[9:])


def test_without_uncertainties_nothing_is_judged() -> None:
    made = calibration()
    bare = replace(made, parameters=tuple(replace(p, u=None) for p in made.parameters), covariance=None)
    found = compare_calibrations(made, bare)
    assert not found.agree
    assert all(d.e_n is None for d in found.differences)
    assert found.chi_square is None
    assert any("no uncertainties" in remark for remark in found.remarks)


def test_devices_with_nothing_in_common_and_blocks_that_cannot_be_converted_are_refused() -> None:
    hexad = calibration(accel=HEXAD, with_gyro=False)
    assert len(compare_calibrations(hexad, hexad).differences) == len(hexad.parameters)
    with pytest.raises(InputError, match="none in both"):
        compare_calibrations(calibration(with_gyro=False), hexad)
    with pytest.raises(InputError, match="one along each body axis"):
        compare_calibrations(replace(hexad, frame="case"), hexad)


def test_the_command_says_different_devices_and_ends_with_1_where_they_differ(tmp_path: Path) -> None:
    made = calibration()
    other = of_device(moved(made, {"accel.bias.x": 20.0}), serial="B-1")
    near = moved(made, {"accel.bias.x": 1.0})
    for name, content in (("made", made), ("other", other), ("near", near)):
        content.write(tmp_path / f"{name}.json")
    words = ["compare", str(tmp_path / "made.json"), str(tmp_path / "other.json")]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 1
    assert "different devices: A-0007 and B-1" in result.stderr
    assert "1 of 21 |E_n| exceed 1" in result.stdout
    assert CliRunner().invoke(main, [*words[:2], str(tmp_path / "near.json")]).exit_code == 0


def of_common_gravity(moved: float) -> tuple[Calibration, Calibration]:
    """Two calibrations at one site whose scale factors are known to 1.2 ppm but for gravity, known to 20 ppm; of the
    second that of x is moved."""
    site = Site(latitude=0.8, height=0.0, gravity=9.8, gravity_u=9.8 * 20e-6)
    one = calibration()
    scales = [p.name.startswith("accel.scale") for p in one.parameters]
    change = np.where(scales, -(1.0 + np.array([p.value for p in one.parameters])) * 20e-6, 0.0)
    return of_common(with_fields(one, site=site), change, "accel.scale.x", moved)


def of_common(one: Calibration, change: np.ndarray, name: str, moved: float) -> tuple[Calibration, Calibration]:
    """A calibration with an error that changes its parameters by `change`, 1.2 ppm of their own in those that it
    changes, and the same with one parameter moved."""
    own = np.where(change != 0.0, 1.2e-6, np.array([p.u for p in one.parameters], dtype=float))
    covariance = np.diag(own**2) + np.outer(change, change)
    u = np.sqrt(np.diag(covariance)).tolist()
    parameters = tuple(replace(p, u=each) for p, each in zip(one.parameters, u, strict=True))
    first = replace(one, parameters=parameters, covariance=covariance)
    other = tuple(replace(p, value=p.value + moved) if p.name == name else p for p in parameters)
    return first, replace(first, parameters=other)


def test_a_common_error_of_gravity_hides_no_step_of_a_scale_factor() -> None:
    first, second = of_common_gravity(40e-6)
    found = compare_calibrations(first, second)
    moved = next(d for d in found.differences if d.name == "accel.scale.x")
    assert moved.u == pytest.approx(1.2e-6 * np.sqrt(2.0), rel=0.01)
    assert moved.e_n == pytest.approx(40e-6 / (2.0 * 1.2e-6 * np.sqrt(2.0)), rel=0.01)
    assert not found.agree
    assert found.probability is not None
    assert found.probability < 1e-100


def of_common_time_base(moved: float) -> tuple[Calibration, Calibration]:
    """The same of the gyros, whose time base is known to 20 ppm."""
    one = calibration()
    change = np.where([p.name.startswith("gyro.scale") for p in one.parameters], 20e-6, 0.0)
    return of_common(with_fields(one, clock_u=20e-6), change, "gyro.scale.y", moved)


def test_a_common_error_of_the_time_base_hides_no_step_of_a_scale_factor() -> None:
    first, second = of_common_time_base(40e-6)
    found = compare_calibrations(first, second)
    moved = next(d for d in found.differences if d.name == "gyro.scale.y")
    assert moved.u == pytest.approx(1.2e-6 * np.sqrt(2.0))
    assert not found.agree
    assert found.probability is not None
    assert found.probability < 1e-100
    assert any("not in u of the differences" in remark and "the time base" in remark for remark in found.remarks)
    of_its_own = (
        with_fields(second, clock_u=10e-6),
        of_device(second, serial="another device"),
    )
    for other in of_its_own:
        alone = next(d for d in compare_calibrations(first, other).differences if d.name == "gyro.scale.y")
        assert alone.u == pytest.approx(np.hypot(20e-6, 1.2e-6) * np.sqrt(2.0))


def test_gravity_of_its_own_for_each_is_in_the_difference() -> None:
    first, second = of_common_gravity(40e-6)
    assert second.provenance.site is not None
    found = compare_calibrations(first, with_fields(second, site=replace(second.provenance.site, gravity=9.80001)))
    moved = next(d for d in found.differences if d.name == "accel.scale.x")
    assert moved.u == pytest.approx(20e-6 * np.sqrt(2.0), rel=0.01)


def test_differences_that_are_small_one_by_one_contradict_together() -> None:
    """All 21 at 0.9 of E_n: χ² is 68 for 21, by chance once in 600 000 cases."""
    first, second = calibration(), calibration()
    apart = tuple(replace(p, value=p.value + 0.9 * 2.0 * np.sqrt(2.0) * (p.u or 0.0)) for p in second.parameters)
    found = compare_calibrations(with_fields(first, site=None), replace(second, parameters=apart))
    assert all(abs(d.e_n or 0.0) < 1.0 for d in found.differences)
    assert not found.agree


def of_prior(rows: Array, s: float) -> tuple[Calibration, Array]:
    """A bias and a quadratic term by readings with these rows (n, 2), of which the second has a prior of size s, and
    their covariance."""
    covariance = np.asarray(np.linalg.inv(rows.T @ rows + np.diag([0.0, s**-2])), dtype=float)
    u = np.sqrt(np.diag(covariance)).tolist()
    bias = Parameter(name="accel.bias.x", value=0.0, u=u[0], unit="m/s^2")
    quadratic = Parameter(name="accel.quadratic.x", value=0.0, u=u[1], unit="1/(m/s^2)", prior=s)
    return replace(calibration(), parameters=(bias, quadratic), covariance=covariance), covariance


def test_what_priors_leave_open_of_a_device_is_no_part_of_a_difference() -> None:
    """θ̂ = C Hᵀ (H θ + n): for one θ the difference is written out, and another device has another θ."""
    rng, s = np.random.default_rng(0), 0.3
    rows = [rng.normal(size=(5, 2)) for _ in range(2)]
    (first, of_first), (second, of_second) = (of_prior(H, s) for H in rows)
    K, L = of_first @ rows[0].T, of_second @ rows[1].T
    by_quadratic = (K @ rows[0] - L @ rows[1])[:, 1] * s
    expected = np.outer(by_quadratic, by_quadratic) + K @ K.T + L @ L.T
    found = compare_calibrations(first, second)
    assert found.covariance is not None
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-9)
    assert [d.u for d in found.differences] == pytest.approx(np.sqrt(np.diag(expected)))
    other = compare_calibrations(first, of_device(second, serial="another device"))
    assert other.covariance is not None
    np.testing.assert_allclose(other.covariance, of_first + of_second)


def test_what_neither_has_learned_is_not_judged() -> None:
    rows = np.array([[1.0, 0.0], [1.0, 0.0]])
    found = compare_calibrations(of_prior(rows, 0.3)[0], of_prior(2.0 * rows, 0.3)[0])
    assert [d.u for d in found.differences] == pytest.approx([np.sqrt(0.5 + 0.125), 0.0])
    assert found.differences[1].e_n is None
    assert found.degrees == 1


def test_an_ellipsoid_that_knows_no_nonlinear_terms_shows_a_step_of_the_bias(tmp_path: Path) -> None:
    """u of its biases is some 100 µg for what it leaves out, and two launches of one device differ by a hundredth."""
    setup = Setup.of(programme="cube-26", grade="navigation", rest=10.0, sample_rate=50.0, terms="full")
    one, other = (simulate_session(tmp_path / f"{k}", setup, seed=1, launch=k) for k in (1, 2))
    first, second = (calibrate(folder, method="ellipsoid") for folder in (one, other))
    assert compare_calibrations(first, second).agree
    log = pl.read_parquet(other / "log.parquet")
    log.with_columns(pl.col("ax") + 3e-4).write_parquet(other / "log.parquet")
    found = compare_calibrations(first, calibrate(other, method="ellipsoid"))
    beyond = [d.name for d in found.differences if d.e_n is not None and abs(d.e_n) > 1.0]
    assert beyond == ["accel.bias.x"]
