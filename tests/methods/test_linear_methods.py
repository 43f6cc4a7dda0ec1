"""What the methods of the linear model say of instruments that are not linear: nothing wrong is accepted in silence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.staged import estimate_accelerometers
from tumble.diagnosis.linear_model import moved_by
from tumble.methods.ellipsoid import ellipsoid
from tumble.planning.setup import Setup
from tumble.reduction.observations import Observations
from tumble.rotation import unit_vector
from tumble.run.calibrate import calibrate
from tumble.sensors.parameters import Terms, usual_sizes
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of
from tumble.simulation.session import simulate_session
from tumble.units import G_STANDARD, Array
from tumble.use.check import check_calibration

SIZES = {
    "accel.quadratic": 1e-5 / G_STANDARD,
    "accel.cubic": 1e-5 / G_STANDARD**2,
    "accel.asymmetry": 1e-5,
}
FUNCTIONS: Mapping[str, Callable[[Array], Array]] = {
    "accel.quadratic": lambda f: f**2,
    "accel.cubic": lambda f: f**3,
    "accel.asymmetry": np.abs,
}


@pytest.fixture(scope="module")
def observed() -> Observations:
    """A navigation unit in fourteen positions, without gyros."""
    rng = np.random.default_rng(3)
    setup = Setup.of(grade="navigation", programme="cube-14")
    return replace(simulate_observations(scenario_of(setup, rng), rng), usual=SIZES).of_accelerometers()


def refitted(observed: Observations, group: str, sensor: int) -> Array:
    """The accelerometer parameters where one sensor has this nonlinearity."""
    force = observed.site.gravity * unit_vector(observed.rests.accel)
    added = np.zeros_like(force)
    added[:, sensor] = SIZES[group] * FUNCTIONS[group](force[:, sensor])
    return estimate_accelerometers(
        replace(observed, rests=replace(observed.rests, accel=observed.rests.accel + added))
    ).values


@pytest.mark.parametrize("group", SIZES)
def test_a_group_left_out_moves_the_fit_by_as_much_as_is_said(observed: Observations, group: str) -> None:
    """Refitting agrees with the linear formula, but for the scatter that it may find."""
    before = estimate_accelerometers(observed).values
    change = np.array([refitted(observed, group, sensor) - before for sensor in range(3)])
    said = moved_by({group}, observed)
    np.testing.assert_allclose(np.linalg.norm(change, axis=0), said, atol=0.05 * said.max(), rtol=0.02)
    np.testing.assert_allclose(ellipsoid(observed).values[:9], before, atol=1e-6)


def test_the_paper_s_methods_do_not_accept_in_silence_what_is_not_linear(tmp_path: Path) -> None:
    """Quadratic terms and g-sensitivity of usual size: the turns contradict 21 parameters, and their size is said."""
    folder = simulate_session(tmp_path / "whole", Setup.of(grade="navigation", sample_rate=20.0, terms="full"), seed=2)
    for method in ("scalar", "sequential"):
        found = calibrate(folder, method=method)
        assert found.outcome.verdict != "accepted"
        assert all(said.startswith("by the method joint, ") for said in found.outcome.remarks)
        assert not any("u contains it" in said for said in found.outcome.remarks)
        assert any(note.startswith("not in the model: quadratic") for note in found.provenance.notes)
    alone = calibrate(folder, method="ellipsoid", terms="linear")
    assert any("they move biases by" in note for note in alone.provenance.notes)
    assert not any("gyros" in said for said in alone.outcome.remarks)


def test_the_ellipsoid_method_has_in_u_what_it_leaves_out() -> None:
    """Navigation units with all terms: the values are those of the method, 43 u off by noise alone, and covered."""
    errors = []
    for seed in range(12):
        rng = np.random.default_rng([31, seed])
        scenario = scenario_of(Setup.of(grade="navigation", terms="full"), rng)
        seen = simulate_observations(scenario, rng)
        linear, full = ellipsoid(replace(seen, usual={})), ellipsoid(replace(seen, usual=usual_sizes("navigation")))
        np.testing.assert_array_equal(full.values[:9], linear.values)
        assert not full.values[9:].any()
        truth = np.array([scenario.truth[name] for name in linear.names])
        errors.append([(estimate.values[:9] - truth) / estimate.u[:9] for estimate in (linear, full)])
    of_noise, of_all = np.abs(np.array(errors)).max(axis=(0, 2))
    assert of_noise > 20.0
    assert of_all < 5.0
    assert 0.6 < np.sqrt(np.mean(np.array(errors)[:, 1] ** 2)) < 1.4


def test_a_linear_instrument_is_accepted_by_all_of_them(tmp_path: Path) -> None:
    """The note stands: nothing in a session tells a bias from what is quadratic with faces up and down alone."""
    folder = simulate_session(tmp_path / "linear", Setup.of(grade="navigation", sample_rate=20.0), seed=3)
    for method in ("sequential", "scalar", "ellipsoid"):
        found = calibrate(folder, method=method, terms="linear")
        assert found.outcome.verdict == "accepted"
        assert any(note.startswith("not in the model: quadratic") for note in found.provenance.notes)
    assert not any(note.startswith("not in the model") for note in calibrate(folder).provenance.notes)


def test_own_positions_are_left_out_alike_with_and_without_the_groups(tmp_path: Path) -> None:
    """The fit is the same; what it leaves out is in u of its own positions, and of others as far as they differ."""
    setup = Setup.of(grade="navigation", programme="cube-14", sample_rate=10.0, rest=20.0)
    folder = simulate_session(tmp_path / "own", setup, seed=4)
    both: tuple[Terms, ...] = ("linear", "full")
    linear, full = (calibrate(folder, method="ellipsoid", terms=terms) for terms in both)
    of_linear, of_full = (check_calibration(made, folder) for made in (linear, full))
    assert of_linear.reasons == of_full.reasons == ()
    for one, other in zip(of_linear.rests, of_full.rests, strict=True):
        assert other.difference == pytest.approx(one.difference, rel=1e-3)
        assert (other.u or 0.0) > 3.0 * (one.u or 0.0)
    u = full["accel.bias.x"].u
    assert u is not None
    assert full.prediction is not None
    assert u > 1.5 * full.prediction.force_u
