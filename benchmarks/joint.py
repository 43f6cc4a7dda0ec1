"""How many joint estimates of a full session a core makes in a second, and how their time grows with the session.

The set-up of the turntable paper (15 rests, 14 turns, 21 parameters), from observations, one thread; and the
same with all groups of parameters. A longer session is the programme so many times over. A figure is the median over
sessions, or of several estimates of one. The answer is printed last.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import statistics
import time
from dataclasses import replace

import numpy as np

from tests.support.staged import staged
from tumble.inference.joint import joint
from tumble.planning.setup import Setup
from tumble.programme.positions import from_attitudes, programme
from tumble.reduction.observations import Observations
from tumble.sensors.grades import NoiseModel
from tumble.sensors.parameters import usual_sizes
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of
from tumble.units import DEGREE

SETUP = Setup(latitude=56.8 * DEGREE, gravity=9.815817, rest=120.0, turn_rate=180.0 / 19.0 * DEGREE)
WHOLE = replace(SETUP, further=usual_sizes("tactical"))
SESSIONS = 200
RUNS = 9


def session(setup: Setup, seed: int) -> Observations:
    rng = np.random.default_rng(seed)
    return simulate_observations(scenario_of(setup, rng), rng)


def seconds(observations: Observations, method: type[object] | object = joint) -> float:
    """Processor time of an estimate."""
    start = time.process_time()
    method(observations)  # type: ignore[operator]
    return time.process_time() - start


def longer(times: int) -> Setup:
    """The programme so many times over."""
    codes = [position.attitude for position in programme("rough-table").positions]
    return replace(SETUP, programme=from_attitudes(codes * times))


def main() -> None:
    sessions = [session(SETUP, seed) for seed in range(SESSIONS)]
    joint(sessions[0])
    staged(sessions[0])
    each = [seconds(observations) for observations in sessions]
    scattered = [any(fit.scatter > 0.0 for fit in joint(o).fits.values()) for o in sessions]
    with_scatter, without = (
        [t for t, s in zip(each, scattered, strict=True) if s is wanted] for wanted in (True, False)
    )
    print(f"joint: median {1e3 * statistics.median(each):.2f} ms, mean {1e3 * statistics.mean(each):.2f} ms a session")
    for name, times in (("without scatter", without), ("with scatter", with_scatter)):
        print(f"{name}: {1e3 * statistics.median(times):.2f} ms")
    print(f"staged: {1e3 * statistics.median(seconds(o, staged) for o in sessions[:10]):.1f} ms")
    whole = [session(WHOLE, seed) for seed in range(20)]
    unknowns = len(joint(whole[0]).values)
    print(f"{unknowns} parameters: {1e3 * statistics.median(map(seconds, whole)):.1f} ms a session (target 12)")
    quiet = {}
    for times in (1, 10, 100):
        observations = session(replace(longer(times), noise=NoiseModel()), 1)
        joint(observations)
        quiet[times] = statistics.median(seconds(observations) for _ in range(RUNS))
        print(f"{15 * times:5} rests: {1e3 * quiet[times]:.2f} ms")
    print(
        f"{1.0 / statistics.mean(each):.0f} joint estimates a second and core (target 500); ten times the rests take "
        f"{quiet[10] / quiet[1]:.1f} times as long (target 12)"
    )


if __name__ == "__main__":
    main()
