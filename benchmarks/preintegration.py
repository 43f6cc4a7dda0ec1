"""How fast are turns preintegrated, and what does cutting them into lanes bring?

Compares `tumble.reduction.kernels.preintegrate` with the same recursion written as one plain loop over the samples of
a turn, unrolled, with sine and cosine from the mathematical library. A figure is the median of several runs,
which alternate so that all see the same machine; one core, except where two threads take half of the turns each.
The answer is printed last.
"""

from __future__ import annotations

import platform
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from math import cos, sin, sqrt
from pathlib import Path

import numba
import numpy as np

from tumble.reduction.kernels import preintegrate
from tumble.units import Array

RUNS = 15
SAMPLES = 2_000_000
TURN_LENGTHS = {"one turn": SAMPLES, "turns of 2000 samples": 2000, "turns of 200 samples": 200}


@numba.njit
def plain(
    increment: Array, dt: Array, starts: Array, stops: Array, A: Array, c: Array, C: Array, M: Array, B: Array
) -> None:
    """The recursion of `preintegrate`, sample after sample, with all sums in local variables."""
    a00, a01, a02 = A[0]
    a10, a11, a12 = A[1]
    a20, a21, a22 = A[2]
    b0, b1, b2 = c
    for k in range(len(starts)):
        q0, q1, q2, q3 = 1.0, 0.0, 0.0, 0.0
        s00 = s01 = s02 = s03 = s10 = s11 = s12 = s13 = s20 = s21 = s22 = s23 = 0.0
        s30 = s31 = s32 = s33 = s40 = s41 = s42 = s43 = s50 = s51 = s52 = s53 = 0.0
        s60 = s61 = s62 = s63 = s70 = s71 = s72 = s73 = s80 = s81 = s82 = s83 = 0.0
        px = py = pz = 0.0
        if starts[k] > 0:
            u, v, w = increment[starts[k] - 1]
            d = dt[starts[k] - 1]
            px = a00 * u + a01 * v + a02 * w + b0 * d
            py = a10 * u + a11 * v + a12 * w + b1 * d
            pz = a20 * u + a21 * v + a22 * w + b2 * d
        for j in range(starts[k], stops[k]):
            u, v, w, d = increment[j, 0], increment[j, 1], increment[j, 2], dt[j]
            x = a00 * u + a01 * v + a02 * w + b0 * d
            y = a10 * u + a11 * v + a12 * w + b1 * d
            z = a20 * u + a21 * v + a22 * w + b2 * d
            fx = x + (py * z - pz * y) * (1.0 / 12.0)
            fy = y + (pz * x - px * z) * (1.0 / 12.0)
            fz = z + (px * y - py * x) * (1.0 / 12.0)
            px, py, pz = x, y, z
            angle = sqrt(fx * fx + fy * fy + fz * fz)
            e0, s = cos(0.25 * angle), sin(0.25 * angle) / angle if angle > 0.0 else 0.25
            e1, e2, e3 = s * fx, s * fy, s * fz
            m0 = q0 * e0 - q1 * e1 - q2 * e2 - q3 * e3
            m1 = q0 * e1 + q1 * e0 + q2 * e3 - q3 * e2
            m2 = q0 * e2 - q1 * e3 + q2 * e0 + q3 * e1
            m3 = q0 * e3 + q1 * e2 - q2 * e1 + q3 * e0
            q0 = m0 * e0 - m1 * e1 - m2 * e2 - m3 * e3
            q1 = m0 * e1 + m1 * e0 + m2 * e3 - m3 * e2
            q2 = m0 * e2 - m1 * e3 + m2 * e0 + m3 * e1
            q3 = m0 * e3 + m1 * e2 - m2 * e1 + m3 * e0
            c00, c01, c02 = 1 - 2 * (m2 * m2 + m3 * m3), 2 * (m1 * m2 - m3 * m0), 2 * (m1 * m3 + m2 * m0)
            c10, c11, c12 = 2 * (m1 * m2 + m3 * m0), 1 - 2 * (m1 * m1 + m3 * m3), 2 * (m2 * m3 - m1 * m0)
            c20, c21, c22 = 2 * (m1 * m3 - m2 * m0), 2 * (m2 * m3 + m1 * m0), 1 - 2 * (m1 * m1 + m2 * m2)
            s00, s01, s02, s03 = s00 + c00 * x, s01 + c00 * y, s02 + c00 * z, s03 + c00 * d
            s10, s11, s12, s13 = s10 + c01 * x, s11 + c01 * y, s12 + c01 * z, s13 + c01 * d
            s20, s21, s22, s23 = s20 + c02 * x, s21 + c02 * y, s22 + c02 * z, s23 + c02 * d
            s30, s31, s32, s33 = s30 + c10 * x, s31 + c10 * y, s32 + c10 * z, s33 + c10 * d
            s40, s41, s42, s43 = s40 + c11 * x, s41 + c11 * y, s42 + c11 * z, s43 + c11 * d
            s50, s51, s52, s53 = s50 + c12 * x, s51 + c12 * y, s52 + c12 * z, s53 + c12 * d
            s60, s61, s62, s63 = s60 + c20 * x, s61 + c20 * y, s62 + c20 * z, s63 + c20 * d
            s70, s71, s72, s73 = s70 + c21 * x, s71 + c21 * y, s72 + c21 * z, s73 + c21 * d
            s80, s81, s82, s83 = s80 + c22 * x, s81 + c22 * y, s82 + c22 * z, s83 + c22 * d
        M[k, 0] = np.array([[s00, s01, s02], [s10, s11, s12], [s20, s21, s22]])
        M[k, 1] = np.array([[s30, s31, s32], [s40, s41, s42], [s50, s51, s52]])
        M[k, 2] = np.array([[s60, s61, s62], [s70, s71, s72], [s80, s81, s82]])
        B[k] = np.array([[s03, s13, s23], [s33, s43, s53], [s63, s73, s83]])
        C[k, 0] = np.array([1 - 2 * (q2 * q2 + q3 * q3), 2 * (q1 * q2 - q3 * q0), 2 * (q1 * q3 + q2 * q0)])
        C[k, 1] = np.array([2 * (q1 * q2 + q3 * q0), 1 - 2 * (q1 * q1 + q3 * q3), 2 * (q2 * q3 - q1 * q0)])
        C[k, 2] = np.array([2 * (q1 * q3 - q2 * q0), 2 * (q2 * q3 + q1 * q0), 1 - 2 * (q1 * q1 + q2 * q2)])


def machine() -> str:
    """What this runs on, in one line."""
    processor = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        fields = dict(line.split("\t:", 1) for line in cpuinfo.read_text().splitlines() if "\t:" in line)
        processor = fields.get("model name", processor).strip()
    return (
        f"{processor}, {platform.system()}, Python {platform.python_version()}, "
        f"NumPy {np.__version__}, numba {numba.__version__}"
    )


def seconds(function: Callable[[], object]) -> float:
    """Duration of one call."""
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def compare(name: str, length: int) -> tuple[float, float]:
    """Median ns per sample of the plain loop and of the kernel for turns of so many samples."""
    rng = np.random.default_rng(1)
    increment, dt = 1e-3 * rng.standard_normal((SAMPLES, 3)), np.full(SAMPLES, 0.01)
    transform = np.eye(3) + 1e-3 * rng.standard_normal((3, 3))
    offset = 1e-4 * rng.standard_normal(3)
    starts = np.arange(0, SAMPLES - length + 1, length)
    stops, k = starts + length, len(starts)
    C, M, B = np.empty((k, 3, 3)), np.empty((k, 3, 3, 3)), np.empty((k, 3, 3))

    def by_plain() -> None:
        plain(increment, dt, starts, stops, transform, offset, C, M, B)

    def by_kernel() -> tuple[Array, Array, Array]:
        return preintegrate(increment, dt, starts, stops, transform, offset)

    def half(turns: slice) -> tuple[Array, Array, Array]:
        return preintegrate(increment, dt, starts[turns], stops[turns], transform, offset)

    def by_threads() -> None:
        with ThreadPoolExecutor(2) as pool:
            list(pool.map(half, (slice(0, k // 2), slice(k // 2, k))))

    by_plain()
    by_hand = (C, M, B)
    for ours, theirs in zip(by_kernel(), by_hand, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-11, atol=1e-11 * np.abs(theirs).max())
    times = np.array([(seconds(by_plain), seconds(by_kernel), seconds(by_threads)) for _ in range(RUNS)])
    slow, fast, both = (1e9 * statistics.median(column) / SAMPLES for column in times.T)
    print(
        f"{name:24s} plain loop {slow:6.1f}   kernel {fast:6.1f} ns a sample   ratio {fast / slow:.2f}"
        + (f"   two threads {both:6.1f}" if k > 1 else "")
    )
    return slow, fast


def main() -> None:
    print(machine())
    print(f"{SAMPLES} samples, medians of {RUNS} runs")
    results = [compare(name, length) for name, length in TURN_LENGTHS.items()]
    slow, fast = (statistics.median(column) for column in zip(*results, strict=True))
    print(f"preintegration: {fast:.1f} ns a sample, {fast / slow:.2f} of the plain loop with libm ({slow:.1f})")


if __name__ == "__main__":
    main()
