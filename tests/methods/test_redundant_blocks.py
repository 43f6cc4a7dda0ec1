"""Redundant blocks: four sensors of a kind on a pyramid, and six with axes normal to the faces of a dodecahedron.

By the method joint, from observations made directly and through the whole pipeline. Statistical limits are at least
five standard errors wide.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.direct import DODECAHEDRON, PYRAMID, QUIET, SETUP, error_of, in_the_hand, observed, scenario
from tests.support.linear_instrument import stated_linear
from tumble.inference.joint import joint
from tumble.planning.setup import Setup
from tumble.rotation import unit_vector
from tumble.run.calibrate import calibrate
from tumble.sensors.grades import GRADES
from tumble.sensors.model import Block
from tumble.simulation.scenario import draw_parameters, scenario_of
from tumble.simulation.session import write_simulation
from tumble.units import Array

BLOCKS = pytest.mark.parametrize("axes", [PYRAMID, DODECAHEDRON], ids=["four", "six"])
g = 9.8159


def test_the_axes_are_those_of_a_dodecahedron() -> None:
    """Any two of its faces that are not parallel have normals with the cosine ±1/√5; together they see all directions
    alike."""
    cosines = DODECAHEDRON @ DODECAHEDRON.T
    np.testing.assert_allclose(np.abs(cosines[~np.eye(6, dtype=bool)]), 5.0**-0.5, atol=1e-15)
    np.testing.assert_allclose(DODECAHEDRON.T @ DODECAHEDRON, 2.0 * np.eye(3), atol=1e-15)


@pytest.mark.parametrize("gyro_axes", [DODECAHEDRON, PYRAMID], ids=["six gyros", "four gyros"])
def test_six_noiseless_accelerometers_and_gyros_are_recovered(gyro_axes: Array) -> None:
    """6 + 6 + 9 and 6 + 6 + 12 parameters, or those of four gyros."""
    table = scenario(QUIET, 101, DODECAHEDRON, gyro_axes)
    for chosen in (table, in_the_hand(table, 15)):
        found = joint(observed(chosen, 101))
        assert len(found.values) == len(chosen.truth)
        assert found.unobservable == ()
        np.testing.assert_allclose(error_of(found, chosen), 0.0, atol=1e-9)


@pytest.mark.weekly
def test_normalised_errors_of_six_have_unit_rms() -> None:
    """20 sessions of §8: rms of (value − truth)/u of biases, scale factors and angles of either kind, each group taken
    for as informative as three independent errors a session."""
    normalised = []
    for seed in range(20):
        chosen = scenario(SETUP, seed, DODECAHEDRON)
        found = joint(observed(chosen, seed))
        normalised.append(error_of(found, chosen) / found.u)
    for group in np.split(np.array(normalised), np.cumsum([6, 6, 9, 6, 6]), axis=1):
        assert np.sqrt((group**2).mean()) == pytest.approx(1.0, abs=5.5 / np.sqrt(2.0 * 20 * 3))


@BLOCKS
def test_a_session_with_redundant_blocks_is_calibrated(axes: Array, tmp_path: Path) -> None:
    """From the log to the file, noise and instability of tactical grade: sensors by number, every value near its truth,
    and readings that become the specific force again."""
    request = Setup.of(grade="tactical", rest=10.0, rate_deg_s=30.0, sample_rate=50.0)
    rng = np.random.default_rng(104)
    accel, gyro = Block(kind="accel", axes=axes), Block(kind="gyro", axes=axes)
    scenario = replace(
        scenario_of(request, rng, serial="redundant"),
        accel=accel,
        gyro=gyro,
        truth=draw_parameters(GRADES["tactical"], (accel, gyro), rng),
    )
    found = calibrate(stated_linear(write_simulation(tmp_path / "session", scenario, rng)), terms="linear")
    assert found.outcome.accepted, found.outcome.reasons
    assert [p.name for p in found.parameters] == [*accel.names, *gyro.names]
    truth = json.loads((tmp_path / "session" / "truth.json").read_text())
    z = np.array([(p.value - truth[p.name]) / p.u for p in found.parameters if p.u])
    assert len(z) == len(truth)
    assert np.abs(z).max() < 5.5
    assert 0.5 < np.sqrt((z**2).mean()) < 1.5
    assert found.accel is not None
    up = unit_vector(rng.standard_normal((100, 3)))
    read = accel.model(np.array([truth[name] for name in accel.names])).predict(g * up)
    np.testing.assert_allclose(found.accel.apply(read), g * up, atol=5e-4)
