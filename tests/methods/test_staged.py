"""The staged method, which tests of the others compare with: exact without noise, honest with it.

Statistical limits are at least five standard errors wide, so that a false alarm is rarer than 1e-6.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.support.direct import (
    FIVE_PERCENT,
    PERMUTED,
    QUIET,
    SETUP,
    TETRAD,
    TRIAD,
    error_of,
    in_the_hand,
    observed,
    scenario,
)
from tests.support.staged import Residuals, staged
from tumble.inference.estimate import Estimate
from tumble.methods.least_squares import normal_score
from tumble.planning.setup import Setup
from tumble.sensors.grades import NoiseModel
from tumble.simulation.scenario import Scenario
from tumble.units import Array


@pytest.mark.parametrize("axes", [TRIAD, PERMUTED, TETRAD], ids=["xyz", "permuted", "four"])
@pytest.mark.parametrize("setup", [QUIET, replace(FIVE_PERCENT, noise=NoiseModel())], ids=["fine", "5 %"])
def test_noiseless_parameters_are_recovered(axes: Array, setup: Setup) -> None:
    """On a table and in the hand; without gyros those of the accelerometers."""
    table = scenario(setup, 71, axes)
    for chosen in (table, in_the_hand(table, 15)):
        seen = observed(chosen, 71)
        alone = replace(seen, gyro_block=None, turns=None, turn_samples=None, turn_readings=None)
        for estimate in (staged(seen), staged(alone)):
            assert estimate.unobservable == ()
            np.testing.assert_allclose(error_of(estimate, chosen), 0.0, atol=1e-9)


@pytest.fixture(scope="module")
def trials() -> list[tuple[Scenario, Estimate]]:
    """100 sessions of §8, no scatter looked for."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tumble.methods.least_squares.SCATTER_PROBABILITY", 0.0)
        chosen = [scenario(SETUP, seed) for seed in range(100)]
        return [(each, staged(observed(each, seed))) for seed, each in enumerate(chosen)]


def test_uncertainties_and_correlations_are_those_of_the_errors(trials: list[tuple[Scenario, Estimate]]) -> None:
    """Each of the 21 parameters: rms z 1, standard error 1/√(2 N), and mean 0; the Mahalanobis distance of all has the
    mean 21, standard error √(42/N); each chi-square the mean ν, standard error at most √(2 ν/N)."""
    N = len(trials)
    errors = np.array([error_of(estimate, chosen) for chosen, estimate in trials])
    z = errors / [estimate.u for _, estimate in trials]
    np.testing.assert_allclose(np.sqrt((z**2).mean(axis=0)), 1.0, atol=5.5 / np.sqrt(2.0 * N))
    np.testing.assert_allclose(z.mean(axis=0), 0.0, atol=5.5 / np.sqrt(N))
    distance = [e @ np.linalg.solve(found.covariance, e) for e, (_, found) in zip(errors, trials, strict=True)]
    assert np.mean(distance) == pytest.approx(21.0, abs=5.5 * np.sqrt(42.0 / N))
    fits = np.array([[(f.chi_square, f.degrees) for f in estimate.fits.values()] for _, estimate in trials])
    chi_square, degrees = fits.mean(axis=0).T
    assert np.all(np.abs(chi_square - degrees) < 5.5 * np.sqrt(2.0 * degrees / N))


def test_scatter_between_rests_is_found_and_counts() -> None:
    """Biases that differ from rest to rest by 20 times the noise of a mean: 25 sessions. Six degrees of freedom know
    the scatter of the accelerometers to 30 %, so that their errors are Student's: rms 1.22."""
    noise, z, scatter = SETUP.noise, [], []
    sizes = [20.0 * white / np.sqrt(SETUP.rest) for white in (noise.accel_white, noise.gyro_white)]
    scattered = replace(noise, accel_instability=sizes[0], gyro_instability=sizes[1], instability_time=0.0)
    for seed in range(25):
        chosen = scenario(replace(SETUP, noise=scattered), seed)
        estimate = staged(observed(chosen, seed))
        z.append(error_of(estimate, chosen) / estimate.u)
        scatter.append([estimate.fits[name].scatter for name in ("accelerometers", "gyro rests")])
    accel, gyro = np.mean(scatter, axis=0) / sizes
    assert accel == pytest.approx(0.92, abs=0.35)
    assert gyro == pytest.approx(1.0, abs=0.15)
    assert 0.9 < np.sqrt(np.mean(np.square(z)[:, :9])) < 1.5
    assert 0.8 < np.sqrt(np.mean(np.square(z)[:, 9:])) < 1.25


def test_residuals_are_judged_by_the_scatter_of_the_others() -> None:
    """Of a fit by least squares that is the externally studentised residual; of residuals that are none, one that has
    most of χ² is as far off as Student's t says, not beyond all bounds."""
    rng = np.random.default_rng(15)
    A = rng.normal(size=(9, 4))
    left, r = np.eye(9) - A @ np.linalg.pinv(A), rng.normal(size=9)
    judged = Residuals(residual=left @ r, variance=np.ones(9), left=left).sigmas(1, scaled=True)
    z2 = (left @ r) ** 2 / np.diag(left)
    studentised = np.sqrt(z2 * 4.0 / (r @ left @ r - z2))
    np.testing.assert_allclose(judged, normal_score(studentised, 4.0), rtol=1e-9)
    most = Residuals(residual=np.array([2.3, 0.1, 0.2, 0.1, 0.1, 0.1]), variance=np.ones(6), left=0.9 * np.eye(6))
    assert 3.0 < most.sigmas(1, scaled=True).max() < 5.0
