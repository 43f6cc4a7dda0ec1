"""How many samples a second `tumble.Corrector` takes, one by one and in blocks, by the clock and by processor time.

The calibration has the whole instrument with lever arms, then the linear model alone; least time of five runs.
Usage: python benchmarks/corrector.py
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from calibrate import machine

import tumble

SINGLE, SAMPLES = 20_000, 1_000_000


def least(run: Callable[[], None], samples: int) -> str:
    """Samples a second by the clock and by processor time."""
    taken = []
    for _ in range(5):
        start, used = time.perf_counter(), time.process_time()
        run()
        taken.append((time.perf_counter() - start, time.process_time() - used))
    clock, used = (min(each) for each in zip(*taken, strict=True))
    return f"{samples / clock:12,.0f} {samples / used:12,.0f}"


def measure(calibration: tumble.Calibration) -> None:
    """Print the rates of one calibration."""
    rng = np.random.default_rng(1)
    accel, gyro = 9.8 * rng.standard_normal((SAMPLES, 3)), rng.standard_normal((SAMPLES, 3))
    stamps, kelvin = 0.005 * np.arange(SAMPLES), np.full(SAMPLES, 300.0)
    corrector = tumble.Corrector(calibration, sample_rate=200.0)

    def in_blocks(size: int, samples: int = SAMPLES) -> None:
        corrector.reset()
        for i in range(0, samples, size):
            block = slice(i, i + size)
            corrector.add(accel[block], gyro[block], time=stamps[block], temperature=kelvin[block])

    def one_by_one() -> None:
        corrector.reset()
        for k in range(SINGLE):
            corrector.add(accel[k], gyro[k], time=stamps[k], temperature=300.0)

    print(f"  one by one          {least(one_by_one, SINGLE)}")
    for size in (10, 1000, SAMPLES):
        count = min(SAMPLES, 20_000 * size)
        print(f"  blocks of {size:<9,} {least(lambda s=size, n=count: in_blocks(s, n), count)}")


def main() -> None:
    print(machine())
    with tempfile.TemporaryDirectory() as temporary:
        request = tumble.Setup.of(grade="mems", positions=14, rest=5.0, sample_rate=50.0)
        folder = tumble.simulate_session(Path(temporary) / "device", request, seed=1)
        for terms in ("all", "linear"):
            made = tumble.calibrate(folder, **({} if terms == "all" else {"terms": terms}))
            print(
                f"{terms} terms, delay {tumble.Corrector(made).delay}: samples a second by the clock, by processor time"
            )
            measure(made)


if __name__ == "__main__":
    main()
