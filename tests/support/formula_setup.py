"""What the tests of accuracy formulas, budget and requirements share: a set-up, and the nonlinear simulation.

The simulation is that of `studies/formulas_against_simulation.py`: exact sensors and readings, TRIAD, integrated
turns; it uses none of the formulas.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tests.support import study
from tumble.earth import normal_gravity
from tumble.planning.setup import Setup
from tumble.programme.positions import programme
from tumble.sensors.grades import NoiseModel
from tumble.units import ARCSEC, DEGREE

SIMULATION = study("formulas_against_simulation")


def device_setup(**known: Any) -> Setup:
    """A set-up with the instrument of the study, gravity known exactly."""
    device = SIMULATION.DEVICE
    return Setup(**({"noise": device.noise, "accel": device.accel, "gyro": device.gyro, "gravity_u": 0.0} | known))


LATITUDE = 56.8 * DEGREE
GRAVITY = normal_gravity(LATITUDE, 250.0)
SETUP = device_setup(latitude=LATITUDE, gravity=GRAVITY)
SILENT = replace(SETUP, noise=NoiseModel())
BIAS, SCALE, AXIS = 2e-3 / GRAVITY, 1e-4, 25.0 * ARCSEC
NINE = np.array([position.matrix for position in programme("nine").positions])
SEED = 20190211
