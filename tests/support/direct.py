"""Sessions simulated as observations, without a log, so that one takes milliseconds: the device of §8 of the turntable
method, and others, on a table and in the hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tests.support.formula_setup import device_setup
from tumble.inference.estimate import Estimate
from tumble.planning.setup import Setup
from tumble.reduction.observations import Observations
from tumble.sensors.grades import NoiseModel, Spread
from tumble.sensors.model import Block
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import Scenario, scenario_of
from tumble.units import DEGREE, Array

SETUP = device_setup(latitude=56.8 * DEGREE, gravity=9.815817, rest=120.0, turn_rate=180.0 / 19.0 * DEGREE)
"""§8 of the turntable method."""
QUIET = replace(SETUP, noise=NoiseModel())
FIVE_PERCENT = replace(
    SETUP,
    table_error=5.0 * DEGREE,
    mounting_error=5.0 * DEGREE,
    accel=Spread(bias=0.5, scale=0.05, axis=0.05),
    gyro=Spread(bias=0.01, scale=0.05, axis=0.05),
)

TRIAD = np.eye(3)
PERMUTED = np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
TETRAD = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [3**-0.5] * 3])
PYRAMID = np.array([[0.8 * np.cos(a), 0.8 * np.sin(a), 0.6] for a in np.arange(4) * np.pi / 2.0])
_GOLDEN = 0.5 * (1.0 + 5.0**0.5)
DODECAHEDRON = np.array(
    [
        [1.0, _GOLDEN, 0.0],
        [-1.0, _GOLDEN, 0.0],
        [0.0, 1.0, _GOLDEN],
        [0.0, -1.0, _GOLDEN],
        [_GOLDEN, 0.0, 1.0],
        [_GOLDEN, 0.0, -1.0],
    ]
) / np.hypot(1.0, _GOLDEN)
"""Normals of the faces of a dodecahedron."""


def scenario(setup: Setup, seed: int, axes: Array = TRIAD, gyro_axes: Array | None = None) -> Scenario:
    """A session of a set-up; of blocks with other axes, the gyros' by default those of the accelerometers, with errors
    of the same spreads."""
    rng = np.random.default_rng([seed, 1])
    plain = scenario_of(setup, rng)
    if axes is TRIAD and gyro_axes is None:
        return plain
    accel, gyro = Block(kind="accel", axes=axes), Block(kind="gyro", axes=axes if gyro_axes is None else gyro_axes)
    truth: dict[str, float] = {}
    for block, spread in ((accel, setup.accel), (gyro, setup.gyro)):
        truth |= {name: getattr(spread, name.split(".")[1]) * rng.standard_normal() for name in block.names}
    return replace(plain, accel=accel, gyro=gyro, truth=truth)


def in_the_hand(chosen: Scenario, positions: int = 30) -> Scenario:
    """The same by hand."""
    usual = Setup.of(positions=positions)
    times = {name: getattr(usual, name) for name in ("first_rest", "rest", "turn_rate", "ramp", "sample_rate")}
    return chosen.changed(by_hand=positions, **times)


def observed(chosen: Scenario, seed: int, *, only_programmed: bool = False) -> Observations:
    """What is left of a log of it."""
    return simulate_observations(chosen, np.random.default_rng([seed, 2]), only_programmed=only_programmed)


def error_of(estimate: Estimate, chosen: Scenario) -> Array:
    """Estimate less truth."""
    return np.asarray(estimate.values - [chosen.truth[name] for name in estimate.names])
