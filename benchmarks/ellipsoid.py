"""How many units a second does the algebraic ellipsoid fit do, and how far is that from one fit after another?

Readings of thousands of units in 14 positions, each unit with errors of its own; one core (OPENBLAS_NUM_THREADS=1).
Compared with the same pencil solved for one unit at a time by `numpy.linalg.eig`, as the formulas are written. A figure
is the median of several runs, which alternate so that both see the same machine; time is that of the processor, so that
what else runs on the machine does not count. The answer is printed last.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import platform
import statistics
import time
from collections.abc import Callable
from itertools import product

import numpy as np

from tumble.methods.quadric import fit_many
from tumble.units import Array

UNITS, ALONE, RUNS, TARGET = 50_000, 1_000, 7, 100_000
NOISE = 3e-5


def cube_14() -> Array:
    """Verticals of the faces and vertices of a cube."""
    each = np.array([p for p in product((1.0, 0.0, -1.0), repeat=3) if sum(map(abs, p)) in (1, 3)])
    return np.asarray(each / np.linalg.norm(each, axis=1, keepdims=True))


def readings(rng: np.random.Generator) -> Array:
    """Readings (UNITS, 14, 3) in positions off by about a degree, of units of different errors."""
    vertical = cube_14() + 0.02 * rng.standard_normal((UNITS, 14, 3))
    vertical /= np.linalg.norm(vertical, axis=2, keepdims=True)
    matrix = np.eye(3) + 0.01 * rng.standard_normal((UNITS, 3, 3))
    bias = 0.01 * rng.standard_normal((UNITS, 1, 3))
    return np.asarray(vertical @ matrix + bias + NOISE * rng.standard_normal(vertical.shape))


def alone(unit: Array) -> Array:
    """Centre (3,) of one unit's ellipsoid, Eqs. (9)–(20) as they are written."""
    x, y, z = ((unit - unit.mean(axis=0)) / unit.std(axis=0)).T
    D = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * y * z, 2 * x * z, x, y, z, np.ones_like(x)], axis=1)
    S = D.T @ D
    C = np.zeros((6, 6))
    C[:3, :3] = 1.0 - 2.0 * np.eye(3)
    C[3:, 3:] = -4.0 * np.eye(3)
    down = -np.linalg.solve(S[6:, 6:], S[6:, :6])
    eigenvalues, vectors = np.linalg.eig(np.linalg.solve(C, S[:6, :6] + S[:6, 6:] @ down))
    xi1 = vectors[:, np.argmax(eigenvalues.real)].real
    H = xi1[[[0, 3, 5], [3, 1, 4], [5, 4, 2]]]
    return np.asarray(unit.mean(axis=0) - 0.5 * unit.std(axis=0) * np.linalg.solve(H, (down @ xi1)[:3]))


def seconds(run: Callable[[], object]) -> float:
    """Processor time of a call."""
    start = time.process_time()
    run()
    return time.process_time() - start


def main() -> None:
    """Measure and print."""
    every = readings(np.random.default_rng(0))
    found = fit_many(every)
    centres = np.array([alone(unit) for unit in every[:ALONE]])
    print(f"found {found.found.mean():.1%}, determined {found.determined.mean():.1%} of {UNITS} units")
    print(
        f"largest difference of the centres from one fit at a time: {np.abs(centres - found.centre[:ALONE]).max():.1e}"
    )
    together, one = [], []
    for _ in range(RUNS):
        together.append(UNITS / seconds(lambda: fit_many(every)))
        one.append(ALONE / seconds(lambda: [alone(unit) for unit in every[:ALONE]]))
    rate, single = statistics.median(together), statistics.median(one)
    print(f"one after another: {single:,.0f} fits/s")
    print(f"{platform.processor() or platform.machine()}, NumPy {np.__version__}, one core")
    verdict = "met" if rate >= TARGET else "missed"
    print(f"fit_many, 14 positions: {rate:,.0f} fits/s ({rate / single:.0f} times), target {TARGET:,}: {verdict}")


if __name__ == "__main__":
    main()
