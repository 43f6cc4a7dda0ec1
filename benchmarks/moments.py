"""How fast are the moments of turns, compensation included?

`tumble.reduction.turns.moments.integrate` on one core: all that a turn needs, with own-axis sums of a triad, and with
nonlinear terms too. All alternate so that they see the same machine. A figure is processor time, the least of several
runs, since whatever else runs on the machine only ever adds. The answer is printed last.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from tumble.reduction.turns.moments import BlockCompensation, Compensation, Moments, OwnAxes, Pieces, integrate
from tumble.sensors.model import SensorModel
from tumble.units import Array

CPUINFO = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
RUNS = 25
TARGET = 36.0
SAMPLES = 500_000
TURN_LENGTHS = {"one turn": SAMPLES, "turns of 2000 samples": 2000, "of 400": 400, "of 200": 200, "of 50": 50}


def machine() -> str:
    """The machine in words."""
    cpu = next((line.split(":")[1].strip() for line in CPUINFO if line.startswith("model name")), platform.machine())
    return f"{cpu}, {os.cpu_count()} cores, Python {platform.python_version()}"


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
    """ns per sample of the moments, with own-axis sums and with nonlinear terms on top, for turns of this length."""
    rng = np.random.default_rng(1)
    rates, dt = 0.5 * rng.standard_normal((SAMPLES + 2, 3)), np.full(SAMPLES + 2, 0.01)
    forces = np.array([1.0, 2.0, 9.0]) + rng.standard_normal((SAMPLES + 2, 3))
    starts = np.arange(2, SAMPLES + 3 - length, length)
    turns = np.arange(len(starts))
    pieces = Pieces(rates=rates, forces=forces, intervals=dt, turn=turns, start=starts, stop=starts + length)
    linear, nonlinear = compensation(rng, 0.0), compensation(rng, 1.0)
    own = OwnAxes(gyro=np.eye(3), accel=np.eye(3))

    def with_moments() -> Moments:
        return integrate([pieces], len(turns), linear)

    def with_own_axes() -> Moments:
        return integrate([pieces], len(turns), linear, own)

    def with_all() -> Moments:
        return integrate([pieces], len(turns), nonlinear, own)

    ways = (with_moments, with_own_axes, with_all)
    for way in ways:
        way()
    times = 1e9 / SAMPLES * np.array([[seconds(way) for way in ways] for _ in range(RUNS)]).min(axis=0)
    print(f"{name:24s}" + "".join(f"{x:10.1f}" for x in times))
    return times


def main() -> None:
    print(machine())
    print(f"{SAMPLES} samples, least of {RUNS} runs, ns of processor time a sample on one core")
    print(f"{'':24s}{'moments':>10s}{'own axes':>10s}{'nonlinear':>10s}")
    results = np.array([compare(name, length) for name, length in TURN_LENGTHS.items()])
    fast, own, _ = np.median(results, axis=0)
    print(f"moments: {fast:.1f} ns a sample (target {TARGET:.0f}); with own axes {own:.1f}")


if __name__ == "__main__":
    main()
