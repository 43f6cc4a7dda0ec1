"""How fast are the moments of turns, compensation included, and what does a plain rotation loop take?

Compares `tumble.reduction.moments.moments_of` with the plain loop of `preintegration.py`, which carries rotation and
its twelve sensitivities only, and with `tumble.reduction.kernels.preintegrate`, which does the same in lanes. One core;
all alternate so that they see the same machine. A figure is processor time, the least of several runs, since whatever
else runs on the machine only ever adds. The answer is printed last.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from preintegration import machine, plain

from tumble.reduction.kernels import preintegrate
from tumble.reduction.moments import BlockCompensation, Compensation, Moments, OwnAxes, Pieces, moments_of
from tumble.sensors.model import SensorModel
from tumble.units import Array

RUNS = 25
SAMPLES = 500_000
TURN_LENGTHS = {"one turn": SAMPLES, "turns of 2000 samples": 2000, "of 400": 400, "of 200": 200, "of 50": 50}


def seconds(function: Callable[[], object]) -> float:
    """Processor time of one call."""
    start = time.thread_time()
    function()
    return time.thread_time() - start


def compensation(rng: np.random.Generator, nonlinear: float) -> Compensation:
    """Errors of a triad of MEMS, delay and g-sensitivity included; nonlinear terms where wanted."""
    gyro, accel = (
        BlockCompensation.of(
            np.eye(3),
            SensorModel(matrix=np.eye(3) + 5e-3 * rng.standard_normal((3, 3)), bias=bias * rng.standard_normal(3)),
            nonlinear * rng.standard_normal((3, 3)) * terms,
        )
        for bias, terms in ((0.01, [0.0, 0.0, 1e-3]), (0.1, [5e-5, 1e-6, 1e-3]))
    )
    return Compensation(gyro=gyro, accel=accel, g_sensitivity=2e-4 * rng.standard_normal((3, 3)), delay=3e-3)


def compare(name: str, length: int) -> Array:
    """ns per sample of the plain loop, of `preintegrate`, of the moments, with own-axis sums and with nonlinear terms
    on top, for turns of so many samples."""
    rng = np.random.default_rng(1)
    rates, dt = 0.5 * rng.standard_normal((SAMPLES + 2, 3)), np.full(SAMPLES + 2, 0.01)
    forces = np.array([1.0, 2.0, 9.0]) + rng.standard_normal((SAMPLES + 2, 3))
    starts = np.arange(2, SAMPLES + 3 - length, length)
    turns, k, increments = np.arange(len(starts)), len(starts), rates * 0.01
    pieces = Pieces(rates=rates, forces=forces, intervals=dt, turn=turns, start=starts, stop=starts + length)
    linear, nonlinear = compensation(rng, 0.0), compensation(rng, 1.0)
    own = OwnAxes(gyro=np.eye(3), accel=np.eye(3))
    C, M, B = np.empty((k, 3, 3)), np.empty((k, 3, 3, 3)), np.empty((k, 3, 3))

    def by_plain() -> None:
        plain(increments, dt, starts, starts + length, np.eye(3), np.zeros(3), C, M, B)

    def by_lanes() -> tuple[Array, Array, Array]:
        return preintegrate(increments, dt, starts, starts + length, np.eye(3), np.zeros(3))

    def with_moments() -> Moments:
        return moments_of(pieces, linear)

    def with_own_axes() -> Moments:
        return moments_of(pieces, linear, own)

    def with_all() -> Moments:
        return moments_of(pieces, nonlinear, own)

    ways = (by_plain, by_lanes, with_moments, with_own_axes, with_all)
    for way in ways:
        way()
    times = 1e9 / SAMPLES * np.array([[seconds(way) for way in ways] for _ in range(RUNS)]).min(axis=0)
    print(f"{name:24s}" + "".join(f"{x:10.1f}" for x in times) + f"{times[2] / times[0]:10.2f}")
    return times


def main() -> None:
    print(machine())
    print(f"{SAMPLES} samples, least of {RUNS} runs, ns of processor time a sample on one core")
    print(f"{'':24s}{'plain':>10s}{'lanes':>10s}{'moments':>10s}{'own axes':>10s}{'nonlinear':>10s}{'ratio':>10s}")
    results = np.array([compare(name, length) for name, length in TURN_LENGTHS.items()])
    slow, _, fast, own, _ = np.median(results, axis=0)
    print(f"moments: {fast:.1f} ns a sample, {fast / slow:.2f} of the plain rotation loop; with own axes {own:.1f}")


if __name__ == "__main__":
    main()
