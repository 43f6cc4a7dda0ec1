"""How long a recording of an hour takes to be shown as it stands: rests so far, the open rest, turns.

An hour at 1 kHz has 3.6e4 blocks; so has this one at 10 Hz, with 120 rests. Processor time, best of several. The answer
is printed last.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import time
from dataclasses import replace

import numpy as np

from tumble.planning.setup import Setup
from tumble.recording.log import Chunk
from tumble.reduction.blocks import Reducer
from tumble.reduction.snapshot import snapshot
from tumble.sensors.model import Block
from tumble.simulation.recording import record
from tumble.simulation.scenario import scenario_of

RATE = 10.0
RUNS = 5


def hour() -> Reducer:
    """A reducer that was fed the recording."""
    setup = Setup.of(grade="mems", positions=120, rest=28.0, sample_rate=RATE)
    scenario = scenario_of(setup, np.random.default_rng(6), serial="S")
    made = record(replace(scenario, profile=replace(scenario.profile, first_rest=28.0)), np.random.default_rng(7))
    accel, gyro = (Block(kind=kind, axes=np.eye(3)) for kind in ("accel", "gyro"))
    reducer = Reducer(rate=RATE, accel=accel, gyro=gyro)
    step = np.full(len(made.time), 1.0 / RATE)
    reducer.feed(Chunk(file=0, time=made.time, dt=step, accel=made.accel, gyro=made.gyro, temperature=None))
    return reducer


def seconds(reducer: Reducer) -> float:
    """Processor time of one look."""
    start = time.process_time()
    snapshot(reducer)
    return time.process_time() - start


def main() -> None:
    reducer = hour()
    best = min(seconds(reducer) for _ in range(RUNS))
    print(f"An hour is shown in {best:.2f} s of the processor.")


if __name__ == "__main__":
    main()
