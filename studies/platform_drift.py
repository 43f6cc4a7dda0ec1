"""Do gyro biases from the drift of the computed platform about north beat those from mean rates?

The indirect way that the paper names and sets aside, for the time it takes: at rest the gyros carry a computed
platform from a levelled start and an azimuth by gyrocompassing. An azimuth that the gyros found themselves takes up
the bias that points east, so that the platform does not drift about east; what it drifts about north, seen by the
accelerometers as a growing east specific force, is the bias that points north,

    d(f_E/g)/dt = δω_N = n̂·δω,   n̂ = L̂ᵀ e_N,

a row for each rest. Beside it the ways of `tumble.methods.paper.gyros` on the same rests of
rough-table, table and mounting off by up to 1°; the accelerometers are calibrated, and read noise. "North, from
means" is what the drift comes to where the body is known to rest: |ω̂ − û(û·ω̂)| − Ω cos B. Noise is in samples of 1
s, rms errors are over launches and gyros.

    python studies/platform_drift.py [--short]

The answer is printed last.
"""

from __future__ import annotations

import argparse
import sys
import timeit
from collections.abc import Callable
from dataclasses import replace

import formulas_against_simulation as simulation
import numpy as np
from accuracy_formulas import scalar_bias

from tumble.earth import earth_rate, normal_gravity
from tumble.methods.paper.gyros import carried, triad, vertical_bias
from tumble.planning.setup import Setup
from tumble.rotation import rotation_matrix, unit_vector
from tumble.sensors.grades import NoiseModel
from tumble.units import DEGREE, DEGREE_PER_HOUR, Array

LATITUDE = 56.8 * DEGREE
SETUP = Setup(
    latitude=LATITUDE,
    gravity=normal_gravity(LATITUDE, 250.0),
    gravity_u=0.0,
    noise=simulation.DEVICE.noise,
    accel=simulation.DEVICE.accel,
    gyro=simulation.DEVICE.gyro,
)
EARTH = np.array(earth_rate(LATITUDE))
RESTS = (15, 60, 240)
"""Durations of a rest, s."""

Estimator = Callable[[Array, Array, Array], Array]
"""Bias (T, 3) from rates and specific forces (T, N, K, 3) of N rests of K seconds and nominal verticals (N, 3)."""


def drift_about_north(rate: Array, force: Array) -> tuple[Array, Array]:
    """Drift (T, N), rad/s, of the platform about north in every rest, and where north is in the body (T, N, 3)."""
    K = rate.shape[-2]
    start = triad(force.mean(axis=-2), rate.mean(axis=-2))
    attitude, east = start, []
    for k in range(K):
        turned = rotation_matrix(0.5 * rate[..., k, :])  # half a second to the middle of the sample, and half on
        attitude = carried(attitude, turned, EARTH, 0.5)
        east.append((attitude @ unit_vector(force[..., k, :])[..., None])[..., 2, 0])
        attitude = carried(attitude, turned, EARTH, 0.5)
    t = np.arange(K) - 0.5 * (K - 1)
    return np.tensordot(np.array(east), t, (0, 0)) / (t @ t), start[..., 0, :]


def solved(rows: Array, right: Array) -> Array:
    """Least squares (T, 3) of rows (T, r, 3) and right-hand sides (T, r)."""
    return np.asarray((np.linalg.pinv(rows) @ right[..., None])[..., 0])


def invariant_bias(rate: Array, force: Array, earth_rate: Array) -> Array:
    """Bias (T, 3) from the dot-product invariant û·ω̂ − Ω sin B = û·δω by least squares."""
    u = unit_vector(force)
    return solved(u, (u * rate).sum(axis=-1) - earth_rate[1])


def by_drift(rate: Array, force: Array, nominal: Array) -> Array:
    """Bias (T, 3) from the drifts of all rests."""
    del nominal
    drift, north = drift_about_north(rate, force)
    return solved(north, drift)


def north_rows(rate: Array, force: Array) -> tuple[Array, Array]:
    """n̂ (T, N, 3) and |ω̂ − û(û·ω̂)| − Ω cos B (T, N) of mean rates and forces (T, N, 3)."""
    north = triad(force, rate)[..., 0, :]
    return north, (north * rate).sum(axis=-1) - EARTH[0]


def by_north(rate: Array, force: Array, nominal: Array) -> Array:
    """Bias (T, 3) from the horizontal rate of all rests."""
    del nominal
    return solved(*north_rows(rate.mean(axis=-2), force.mean(axis=-2)))


def by_both(rate: Array, force: Array, nominal: Array) -> Array:
    """Bias (T, 3) from the horizontal rate and the dot product, the two things a rest says whatever its azimuth."""
    del nominal
    rate, force = rate.mean(axis=-2), force.mean(axis=-2)
    north, right = north_rows(rate, force)
    up = unit_vector(force)
    rows = np.concatenate([north, up], axis=-2)
    return solved(rows, np.concatenate([right, (up * rate).sum(axis=-1) - EARTH[1]], axis=-1))


METHODS: dict[str, Estimator] = {
    "drift about north": by_drift,
    "north, from means": by_north,
    "vertical axes, Eq. (18)": lambda ω, w, nominal: vertical_bias(ω.mean(axis=-2), w.mean(axis=-2), EARTH, nominal),
    "scalar": lambda ω, w, _: scalar_bias(ω.mean(axis=-2), w.mean(axis=-2), EARTH),
    "dot product": lambda ω, w, _: invariant_bias(ω.mean(axis=-2), w.mean(axis=-2), EARTH),
    "dot product and north": by_both,
}


def errors(seconds: int, launches: int) -> dict[str, tuple[float, float]]:
    """Rms error, rad/s, and time, s, of every method for rests of so many seconds."""
    rng = np.random.default_rng(21)
    found = simulation.simulate(replace(SETUP, noise=NoiseModel()), launches, rng)
    level = SETUP.gravity * found.attitudes[:, :, 1]
    shape = (*level.shape[:2], seconds, 3)
    rate = found.gyro[:, :, None] + SETUP.noise.gyro_white * rng.standard_normal(shape)
    force = level[:, :, None] + SETUP.noise.accel_white * rng.standard_normal(shape)
    nominal = found.nominal[:, 1]
    out = {}
    for name, method in METHODS.items():
        error = method(rate, force, nominal) - found.truth[:, 9:12]
        time = min(timeit.repeat(lambda run=method: run(rate, force, nominal), number=1, repeat=3))
        out[name] = float(np.sqrt((error**2).mean())), time
    return out


def main(arguments: list[str]) -> int:
    """Print the table and the answer."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--short", action="store_true", help="fewer launches")
    launches = 30 if parser.parse_args(arguments).short else 300
    found = {seconds: errors(seconds, launches) for seconds in RESTS}
    print(f"rms errors of gyro biases, °/h, and times as multiples of that of the dot product; {launches} launches")
    print(f"{'15 rests of':<26}" + "".join(f"{f'{seconds} s':>18}" for seconds in RESTS))
    for name in METHODS:
        cells = [(at[name][0] / DEGREE_PER_HOUR, at[name][1] / at["dot product"][1]) for at in found.values()]
        print(f"{name:<26}" + "".join(f"{rms:10.4f}{times:8.1f}" for rms, times in cells))
    worse = [at["drift about north"][0] / at["north, from means"][0] for at in found.values()]
    better = np.mean([at["dot product and north"][0] / at["dot product"][0] for at in found.values()])
    print(
        f"\nDoes the drift of the platform win? {'No' if min(worse) > 1.0 else 'Yes'}: "
        + ", ".join(f"{w:.2f}" for w in worse)
        + " times the error of the mean horizontal rate in rests of "
        + ", ".join(f"{seconds}" for seconds in RESTS)
        + " s, as it adds noise of the accelerometers to the same gyro readings. What it measures, the bias towards "
        f"north, is worth having: beside the dot product it brings the error to {better:.2f} of its own."
    )
    return 0 if min(worse) > 1.0 and better < 1.0 else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
