"""The grade of an instrument that states none: by its noise, and no better than the biases of its gyros."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from tumble.planning.setup import Setup
from tumble.run.calibrate import calibrate
from tumble.sensors.grades import GRADES, guessed_grade
from tumble.simulation.session import simulate_session
from tumble.units import DEGREE_PER_HOUR


@pytest.mark.parametrize("name", GRADES)
def test_noise_and_biases_of_a_grade_tell_it(name: str) -> None:
    grade = GRADES[name]
    white = grade.noise.accel_white, grade.noise.gyro_white
    assert guessed_grade(*white) == (name, "the noise")
    assert guessed_grade(*white, 3.0 * grade.gyro.bias) == (name, "the noise")


@pytest.mark.parametrize(("bias", "name"), [(400.0, "tactical"), (600.0, "mems"), (1e6, "consumer")])
def test_a_quiet_instrument_is_no_better_than_its_biases(bias: float, name: str) -> None:
    noise = GRADES["tactical"].noise
    found = guessed_grade(noise.accel_white, noise.gyro_white, bias * DEGREE_PER_HOUR)
    assert found == (name, "the noise" if name == "tactical" else "the biases of the gyros")


def test_a_quiet_mems_device_has_the_priors_of_its_grade(tmp_path: Path) -> None:
    """Its drifts, of which two minutes say nothing, are as uncertain as those of MEMS devices."""
    setup = Setup.of(grade="mems", positions=12, rest=5.0)
    folder = simulate_session(tmp_path / "s", replace(setup, noise=setup.noise.scaled(0.2)), seed=1)
    session = (folder / "session.toml").read_text()
    assert 'grade = "mems"' not in session
    found = calibrate(folder)
    assert any("the grade mems, guessed from the biases of the gyros" in note for note in found.provenance.notes)
