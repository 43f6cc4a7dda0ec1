"""What the tests of accuracy formulas, budget and requirements share: a set-up, and the nonlinear simulation.

The simulation is that of `studies/formulas_against_simulation.py`: exact sensors and readings, TRIAD, integrated
turns; it uses none of the formulas.
"""

from __future__ import annotations

import importlib.util
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from tumble.earth import normal_gravity
from tumble.planning.setup import Setup
from tumble.programme.positions import programme
from tumble.sensors.grades import NoiseModel
from tumble.units import ARCSEC, DEGREE


@cache
def study() -> ModuleType:
    """The study's simulation, as a module."""
    path = Path(__file__).parents[1] / "studies" / "formulas_against_simulation.py"
    spec = importlib.util.spec_from_file_location("formulas_against_simulation", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def device_setup(**known: Any) -> Setup:
    """A set-up with the instrument of the study, gravity known exactly."""
    device = study().DEVICE
    return Setup(**({"noise": device.noise, "accel": device.accel, "gyro": device.gyro, "gravity_u": 0.0} | known))


LATITUDE = 56.8 * DEGREE
GRAVITY = normal_gravity(LATITUDE, 250.0)
SETUP = device_setup(latitude=LATITUDE, gravity=GRAVITY)
SILENT = replace(SETUP, noise=NoiseModel())
BIAS, SCALE, AXIS = 2e-3 / GRAVITY, 1e-4, 25.0 * ARCSEC
NINE = np.array([position.matrix for position in programme("nine").positions])
SEED = 20190211
