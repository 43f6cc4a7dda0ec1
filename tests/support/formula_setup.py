"""What the tests of plans and of accuracy formulas share: a set-up, the bound, and the nonlinear simulation.

The simulation is that of `studies/formulas_against_simulation.py`: exact sensors and readings, TRIAD, integrated
turns; it uses none of the formulas.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from tests.support import study
from tumble.earth import normal_gravity
from tumble.planning.bounds import Bound, bound_by, linearised_course
from tumble.planning.itinerary import Itinerary, itinerary_of
from tumble.planning.pass_errors import PassErrors
from tumble.planning.setup import MEMBERS, NAMES, Setup
from tumble.programme.positions import programme
from tumble.sensors.grades import NoiseModel, spread_of
from tumble.units import ARCSEC, DEGREE

SIMULATION = study("formulas_against_simulation")


def device_setup(**known: Any) -> Setup:
    """A set-up with the instrument of the study, without groups beyond the linear model, gravity and clock exact."""
    device = SIMULATION.DEVICE
    usual = {"noise": device.noise, "accel": device.accel, "gyro": device.gyro, "gravity_u": 0.0, "clock_u": 0.0}
    return Setup(**(usual | {"instrument": "that of the study"} | known))


LATITUDE = 56.8 * DEGREE
GRAVITY = normal_gravity(LATITUDE, 250.0)
SETUP = device_setup(latitude=LATITUDE, gravity=GRAVITY)
SILENT = replace(SETUP, noise=NoiseModel())
BIAS, SCALE, AXIS = 2e-3 / GRAVITY, 1e-4, 25.0 * ARCSEC
NINE = np.array([position.matrix for position in programme("nine").positions])
SEED = 20190211


def bound_of(course: Itinerary, setup: Setup, *, gyros: bool = True) -> Bound:
    """The Cramér–Rao bound of a course: the covariance of the joint likelihood with known noise and time base."""
    return bound_by(linearised_course(course, setup, gyros=gyros), setup.turn_rate)


def bound(setup: Setup, *, gyros: bool = True) -> Bound:
    """The same of the programme of a set-up."""
    return bound_of(itinerary_of(setup), setup, gyros=gyros)


def indirect_coefficients(setup: Setup) -> dict[str, tuple[float, float]]:
    """c₁ (per rad) and c₂ (per rad²) of "gyro.scale" and "gyro.axis": relative errors c₁ σ after the first pass of the
    indirect method with the programme's matrix and c₂ σ² after the second, when σ, rad, is the rms error per axis of
    the mounting and of the positions each, and accelerometers and gyro biases are perfect. §7.

    They depend on the ratio of scale-factor to axis errors in `setup.gyro`: axis angles suffer from scale factors."""
    pipeline = PassErrors.of(replace(setup, table_error=math.sqrt(3.0), mounting_error=math.sqrt(3.0)), "scalar")
    once, twice = pipeline.by_table + pipeline.by_mounting, pipeline.twice[2]
    out = {}
    for group in ("gyro.scale", "gyro.axis"):
        of = np.ix_(MEMBERS[group], np.arange(12, len(NAMES)))
        c1, c2 = (
            math.sqrt((matrix[of] @ pipeline.spread[12:] ** 2).mean()) / spread_of(setup, group)
            for matrix in (once, twice)
        )
        out[group] = (c1, c2)
    return out
