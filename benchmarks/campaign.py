"""Campaigns: two processes against one, what the engine adds to a task, and trials a second.

Two against one: the same campaign of sessions from observations by a cluster of one process and by one of two, pair
after pair, processes started and code loaded beforehand. Added: tasks that do nothing, each sent by itself (the worst)
and in chunks, as the engine does; and what the engine costs in this process, parts and table included.

Usage: python benchmarks/campaign.py
"""

from __future__ import annotations

import os
import platform
import statistics
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, cast

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import polars as pl
import psutil

from tumble.campaigns import engine
from tumble.campaigns.campaign import Campaign
from tumble.campaigns.cluster import executor_for
from tumble.campaigns.engine import Executor, Job, Row, run, serially

PAIRS, TRIALS, EMPTY = 3, 60, 5000


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def nothing(number: int, item: Any) -> list[Row]:  # noqa: ARG001
    """A task that does nothing."""
    return [{}]


def empty(tasks: int) -> Job:
    """A job that does nothing."""
    return Job(definition={}, items=[{}] * tasks, task=nothing, schema={"x": pl.Float64})


def wall(job: Job, executor: Executor) -> float:
    """How long a job takes in a new folder, s."""
    with tempfile.TemporaryDirectory() as folder:
        return seconds(lambda: run(job, Path(folder) / "out", executor=executor))


def two_against_one() -> tuple[list[float], float, float]:
    """Ratios of the wall times of one process and of two, pair by pair; trials a second with two; and the processor
    time of one process over the longest of two, which other work on the machine does not change."""
    job = Campaign(trials=TRIALS, grid={"method": "joint"}).job()
    warm = Campaign(trials=4, grid={"method": "joint"}).job()
    with executor_for(workers=1) as one, executor_for(workers=2) as two:
        for executor in (one, two):
            wall(warm, executor)
        pairs = [(wall(job, one), wall(job, two)) for _ in range(PAIRS)]
        longest = [max(processor_times(executor, lambda e=executor: wall(job, e))) for executor in (one, two)]
    return [a / b for a, b in pairs], len(job.items) / min(b for _, b in pairs), longest[0] / longest[1]


def processor_times(executor: Executor, work: Callable[[], object]) -> list[float]:
    """Processor time of each process of a cluster while something is done, s."""
    (client,) = cast("partial[Any]", executor).args
    workers = [psutil.Process(pid) for pid in client.run(os.getpid).values()]
    before = [sum(worker.cpu_times()[:2]) for worker in workers]
    work()
    return [sum(worker.cpu_times()[:2]) - b for worker, b in zip(workers, before, strict=True)]


def overheads() -> dict[str, float]:
    """Seconds a task that does nothing."""
    out = {}
    with executor_for(workers=2) as executor:
        wall(empty(10), executor)
        out["in chunks, on two processes"] = wall(empty(EMPTY), executor) / EMPTY
        usual, engine.LARGEST_CHUNK = engine.LARGEST_CHUNK, 1
        out["sent by itself, to two processes"] = wall(empty(500), executor) / 500
        engine.LARGEST_CHUNK = usual
    out["in this process"] = wall(empty(EMPTY), serially) / EMPTY
    return out


def show(ratios: Sequence[float]) -> str:
    return f"{statistics.median(ratios):.2f} times ({min(ratios):.2f} … {max(ratios):.2f} in {len(ratios)} pairs)"


def main() -> None:
    cpus, load = os.cpu_count(), os.getloadavg()[0]
    print(f"{platform.machine()}, {cpus} cores, Python {platform.python_version()}, load before {load:.1f}")
    ratios, rate, processor = two_against_one()
    print(f"two processes against one, sessions from observations: {show(ratios)}; {rate:.0f} trials/s with two")
    print(f"processor time of one over the longest of two: {processor:.2f} times")
    for what, overhead in overheads().items():
        print(f"overhead of a task {what}: {1e3 * overhead:.3f} ms")


if __name__ == "__main__":
    main()
