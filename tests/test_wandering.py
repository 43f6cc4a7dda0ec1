"""One gyro of six whose bias wanders from rest to rest: it has a scatter of its own, and is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from test_redundant_blocks import DODECAHEDRON
from test_staged import FINE, NAVIGATION, in_the_hand, observations, unit

from tumble.estimation.diagnosis.verdict import verdict
from tumble.inference.joint import joint
from tumble.reduction.observations import Observations


def of_six(seed: int, wanders: float) -> Observations:
    """Twenty positions by hand, with a bias of gyro 4 that wanders by so many times the noise of a rest."""
    rng = np.random.default_rng([401, seed])
    seen = observations(unit(rng, FINE, DODECAHEDRON, DODECAHEDRON), in_the_hand(rng, 20), rng, NAVIGATION)
    gyro = seen.rests.gyro.copy()
    gyro[:, 4] += wanders * np.sqrt(seen.rests.gyro_covariance[:, 4, 4]) * rng.standard_normal(len(gyro))
    return replace(seen, rests=replace(seen.rests, gyro=gyro))


def test_a_gyro_that_wanders_has_a_scatter_of_its_own() -> None:
    seen = of_six(1, 10.0)
    found = joint(seen)
    assert found.linearised is not None
    assert found.linearised.problem.wandering == (6 + 4,)
    scatter, noise = found.linearised.scatter, np.sqrt(np.median(seen.rests.gyro_covariance[:, 4, 4]))
    assert 5.0 * noise < scatter.gyro_wandering < 20.0 * noise
    assert scatter.gyro < 2.0 * noise
    said = verdict(found, seen)
    assert any(remark.startswith("gyro.bias.4 wanders from rest to rest by ") for remark in said.remarks)


def test_sensors_that_are_alike_have_one_scatter() -> None:
    for seed in range(3):
        found = joint(of_six(seed, 0.0))
        assert found.linearised is not None
        assert found.linearised.problem.wandering == ()


def test_a_gyro_that_wanders_beyond_use_is_refused_by_name() -> None:
    seen = of_six(1, 300.0)
    said = verdict(joint(seen), seen)
    assert not said.gyro.accepted
    assert any(reason.startswith("gyro.bias.4 wanders from rest to rest by ") for reason in said.reasons)
