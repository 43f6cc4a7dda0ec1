"""What autopilots make of a board that lies still while its temperature changes.

PX4 (docs.px4.io, Thermal Calibration and Compensation; Tools/process_sensor_caldata.py): a median over 31 samples, the
means of readings and thermometer in 2000 equal steps of its range, and a polynomial of the third order about the middle
of the range by least squares over these means.

ArduPilot (ardupilot.org, IMU Temperature Calibration; Tools/scripts/tempcal_IMU.py): a moving average over 2 s, and a
polynomial of the third order about 35 °C by least squares over all of it.

Both take the thermometer for the temperature of the sensors. No uncertainties.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from scipy.signal import medfilt

from evidence.case import Array, Case, Estimate, Program

MEDIAN = 31
STEPS = 2000
AVERAGED = 2.0  # s
REFERENCE = 35.0  # °C

Fit = Callable[[Array, Array, float], tuple[Array, float]]
"""Coefficients (4,), highest power first, and the temperature about which they are, °C, of thermometer (N,), readings
(N,) and samples a second."""


def px4(celsius: Array, readings: Array, rate: float) -> tuple[Array, float]:  # noqa: ARG001
    """About the middle of the range."""
    low, high = float(celsius.min()), float(celsius.max())
    number = np.minimum((STEPS * (celsius - low) / max(high - low, 1e-9)).astype(int), STEPS - 1)
    count = np.bincount(number, minlength=STEPS)
    seen = count > 0
    about = 0.5 * (low + high)
    x, y = (np.bincount(number, v, minlength=STEPS)[seen] / count[seen] for v in (celsius, medfilt(readings, MEDIAN)))
    return cubic(x - about, y), about


def ardupilot(celsius: Array, readings: Array, rate: float) -> tuple[Array, float]:
    """About 35 °C."""
    window = max(1, round(AVERAGED * rate))
    x, y = (np.convolve(v, np.full(window, 1.0 / window), mode="valid") for v in (celsius, readings))
    return cubic(x - REFERENCE, y), REFERENCE


def cubic(x: Array, y: Array) -> Array:
    """Of least squares."""
    return np.asarray(np.polyfit(x, y, 3), dtype=float)


def estimate(case: Case, fit: Fit) -> Estimate:
    """Changes of the readings from the middle of the range to its ends."""
    assert case.temperature is not None
    assert case.ends is not None
    changes = dict[str, float]()
    for kind, readings in (("accel", case.accel), ("gyro", case.gyro)):
        for axis, read in zip("xyz", [] if readings is None else readings.T, strict=False):
            coefficients, about = fit(case.temperature, read, case.rate)
            low, middle, high = np.polyval(coefficients, np.array(case.ends) - about)
            changes |= {f"{kind}.change.{axis}.low": float(low - middle)}
            changes |= {f"{kind}.change.{axis}.high": float(high - middle)}
    return Estimate(changes=changes)


PX4 = Program(
    name="PX4 thermal",
    needs=frozenset({"temperatures"}),
    estimate=partial(estimate, fit=px4),
    source="github.com/PX4/PX4-Autopilot, Tools/process_sensor_caldata.py",
)
ARDUPILOT = Program(
    name="ArduPilot thermal",
    needs=frozenset({"temperatures"}),
    estimate=partial(estimate, fit=ardupilot),
    source="github.com/ArduPilot/ardupilot, Tools/scripts/tempcal_IMU.py",
)
