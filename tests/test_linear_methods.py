"""What the methods of the linear model say of instruments that are not linear: nothing wrong is accepted in silence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tumble.calibration.calibrate import calibrate
from tumble.estimation.diagnosis.linear_model import moved_by
from tumble.estimation.methods.ellipsoid import ellipsoid
from tumble.estimation.methods.staged.accelerometers import estimate_accelerometers
from tumble.planning.setup import Setup
from tumble.reduction.observations import Observations
from tumble.rotation import unit_vector
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of
from tumble.simulation.session import simulate_session
from tumble.units import G_STANDARD, Array

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
    np.testing.assert_allclose(ellipsoid(observed).values, before, atol=1e-6)


def test_the_paper_s_methods_do_not_accept_in_silence_what_is_not_linear(tmp_path: Path) -> None:
    """Quadratic terms and g-sensitivity of usual size: the turns contradict 21 parameters, and their size is said."""
    folder = simulate_session(tmp_path / "whole", Setup.of(grade="navigation", sample_rate=20.0, terms="full"), seed=2)
    for method in ("staged", "sequential"):
        found = calibrate(folder, method=method)
        assert found.outcome.verdict != "accepted"
        assert all(said.startswith("by the method joint, ") for said in found.outcome.remarks)
        assert not any("u contains it" in said for said in found.outcome.remarks)
        assert any(note.startswith("not in the model: quadratic") for note in found.notes)
    alone = calibrate(folder, method="ellipsoid")
    assert any("they move biases by" in note for note in alone.notes)
    assert not any("gyros" in said for said in alone.outcome.remarks)


def test_a_linear_instrument_is_accepted_by_all_of_them(tmp_path: Path) -> None:
    """The note stands: nothing in a session tells a bias from what is quadratic with faces up and down alone."""
    folder = simulate_session(tmp_path / "linear", Setup.of(grade="navigation", sample_rate=20.0), seed=3)
    for method in ("staged", "scalar", "ellipsoid"):
        found = calibrate(folder, method=method)
        assert found.outcome.verdict == "accepted"
        assert any(note.startswith("not in the model: quadratic") for note in found.notes)
    assert not any(note.startswith("not in the model") for note in calibrate(folder).notes)
