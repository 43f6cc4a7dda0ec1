"""Processor time of the maximum of the joint likelihood, of its integral, and of a longer session, against targets.

The set-up of the turntable paper (15 rests, 14 turns), from observations, one thread: with the 21 parameters of the
linear model and with all groups. A longer session is the programme ten times over. Figures are medians over sessions.
Usage: python benchmarks/joint.py
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from tumble.inference.joint import joint
from tumble.planning.setup import Setup
from tumble.programme.positions import from_attitudes, programme
from tumble.reduction.observations import Observations
from tumble.sensors.parameters import usual_sizes
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of
from tumble.units import DEGREE

LINEAR = Setup(latitude=56.8 * DEGREE, gravity=9.815817, rest=120.0, turn_rate=180.0 / 19.0 * DEGREE)
WHOLE = replace(LINEAR, further=usual_sizes("tactical"))
SESSIONS = 20
LONGER = 10


def session(setup: Setup, seed: int) -> Observations:
    """Observations of one simulated session."""
    rng = np.random.default_rng(seed)
    return simulate_observations(scenario_of(setup, rng), rng)


def milliseconds(method: Callable[[Observations], object], sessions: list[Observations]) -> float:
    """Median processor time of an estimate."""
    method(sessions[0])
    times = []
    for observations in sessions:
        start = time.process_time()
        method(observations)
        times.append(time.process_time() - start)
    return 1e3 * statistics.median(times)


def main() -> None:
    """Measure and print."""
    maximum = partial(joint, quick=True)
    codes = [position.attitude for position in programme("rough-table").positions]
    longer = replace(LINEAR, programme=from_attitudes(codes * LONGER))
    linear, whole = ([session(setup, seed) for seed in range(SESSIONS)] for setup in (LINEAR, WHOLE))
    times = {
        "linear, maximum": (milliseconds(maximum, linear), 2.0),
        "all groups, maximum": (milliseconds(maximum, whole), 8.0),
        "all groups, with the integral": (milliseconds(joint, whole), 60.0),
    }
    for what, (found, target) in times.items():
        print(f"{what}: {found:.1f} ms (target {target:.0f})")
    many = milliseconds(maximum, [session(longer, seed) for seed in range(3)])
    ratio = many / times["linear, maximum"][0]
    print(f"ten times the rests, maximum: {many:.1f} ms, {ratio:.1f} times as long (target 12)")


if __name__ == "__main__":
    main()
