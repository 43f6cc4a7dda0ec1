"""What rests and turns show of sensors of an unknown unit or scale.

Counts per g: on the mean readings at rest gravity draws a sphere. What gyros read for a rad/s: over the turns they
carry the vertical from rest to rest. Both are rough, as good as the sensors' own scale errors. Where nothing turned, a
unit is told by what no gyro reads at rest, or by the rate of the Earth: 15.04 °/h whatever the attitude, and about the
vertical as much of it as the latitude says, or, where that is not known, as much in one attitude as in another.
"""

from __future__ import annotations

import math

import numpy as np

from tumble.earth import EARTH_RATE
from tumble.recording.columns.names import ACCEL
from tumble.recording.columns.numbers import MIDDLES
from tumble.recording.columns.scales import matched
from tumble.reduction.observations import Observations
from tumble.reduction.rests.rests import sphere_through
from tumble.rotation import unit_vector
from tumble.sensors.model import SensorModel
from tumble.units import DEGREE, DEGREE_PER_HOUR, Array

_ALIKE = 0.05
_NO_OFFSET = 0.3
_LEAST_SINGULAR = 0.05
_TURNS = 3
_MISS = 0.15
_MOST_MISSED = 0.5
_SMALLEST, _LARGEST = 0.05, 30.0  # rad, of a turn
_GRID = 160
_SLOW = 1e12
_LARGEST_BIAS = 20.0 * DEGREE
_LARGEST_NOISE = 0.17 * DEGREE  # rad/s in a second
_ON_A_TABLE = 0.015
"""m/s² in a second: accelerometers that scatter more are held in a hand, or on a machine that runs."""
_NEAR_EARTH = 0.15
"""Of the Earth's rate: what a reading of it may be off, and how well it must be known."""
_APART = math.cos(20.0 * DEGREE)
"""Cosine between verticals in the body: attitudes that differ."""
_TURNED = math.cos(8.0 * DEGREE)


def accel_scale(means: Array) -> tuple[float, list[float]] | None:
    """Counts per g and zeros (3,) of accelerometers from mean readings (N, 3) at rest; about no or a converter's middle
    zero where that is what the centre of their sphere is near to. None where the readings do not tell."""
    sphere = _sphere(means)
    length = float(np.median(np.linalg.norm(means, axis=1))) if len(means) else 0.0
    alike = len(means) > 0 and float(np.linalg.norm(means.std(axis=0))) < _ALIKE * length
    if sphere is None or (alike and matched(ACCEL, length, whole=True).known):  # one g in one attitude is no sphere
        return None
    radius, zero = sphere
    middles = MIDDLES if (means > 0.0).all() else ()
    known = next((m for m in (0.0, *middles) if np.abs(zero - m).max() < _NO_OFFSET * radius), None)
    return radius, [known] * 3 if known is not None else [float(f"{z:.5g}") for z in zero]


def _sphere(points: Array) -> tuple[float, Array] | None:
    """Radius and centre (3,) of the sphere through points (N, 3); None where they do not tell."""
    if len(points) < 4:
        return None
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if not spread[2] > _LEAST_SINGULAR * spread[0]:
        return None
    centre, radius = sphere_through(points)
    return radius, centre


@np.errstate(invalid="ignore", over="ignore")  # rates without measure carry nothing
def gyro_factor(observations: Observations) -> float | None:
    """What the gyros of observations read for one rad/s: the factor with which they carry the vertical best, where that
    is well, and better than gyros would which read nothing. None where it is not, or with fewer than three turns."""
    from scipy.optimize import minimize_scalar

    turns, block = observations.turns, observations.gyro_block
    if turns is None or block is None or len(turns) < _TURNS:
        return None
    bias, matrix = np.median(observations.rests.gyro, axis=0), block.nominal().matrix
    force = observations.accel_block.nominal().apply(observations.rests.accel)
    sphere = _sphere(force)  # its centre is the bias
    force = force if sphere is None else force - sphere[1]
    vertical = unit_vector(force)

    def misses(log_factor: float) -> Array:
        model = SensorModel(matrix=matrix * np.exp(log_factor), bias=bias)
        carried = observations.turns_about(model).C
        back = np.einsum("kij,kj->ki", carried, vertical[turns.last])
        return _angles(np.nan_to_num(back, nan=0.0), vertical[turns.first])

    def cost(log_factor: float) -> float:
        return float(np.minimum(misses(log_factor), _MOST_MISSED).mean())

    slow = SensorModel(matrix=matrix * _SLOW, bias=bias)  # so that next to nothing turns while it is integrated
    size = _SLOW * float(np.median(np.sqrt((observations.turns_about(slow).M ** 2).sum(axis=(1, 2, 3)))))
    if not size > 0.0:
        return None
    grid = np.log(np.geomspace(size / _LARGEST, size / _SMALLEST, _GRID))
    costs = np.array([cost(x) for x in grid])
    minima = (
        minimize_scalar(cost, bounds=(grid[k] - 0.06, grid[k] + 0.06), method="bounded") for k in np.argsort(costs)[:3]
    )
    best = min(minima, key=lambda minimum: float(minimum.fun))
    moved = float(np.minimum(_angles(vertical[turns.last], vertical[turns.first]), _MOST_MISSED).mean())
    carried = np.median(misses(float(best.x))) < _MISS and best.fun < min(_MISS, 0.5 * moved)
    return float(np.exp(best.x)) if carried else None


def _angles(first: Array, second: Array) -> Array:
    """Angles (K,), rad, between unit vectors (K, 3)."""
    return np.asarray(np.arccos(np.clip(np.einsum("ki,ki->k", first, second), -1.0, 1.0)))


def tilts(observations: Observations | None) -> Array:
    """Which turns (K,) end with another side up; gyros taken for too small carry the vertical of the others too."""
    if observations is None or not observations.turns:
        return np.empty(0, dtype=bool)
    vertical = unit_vector(observations.rests.accel)
    cosine = (vertical[observations.turns.first] * vertical[observations.turns.last]).sum(axis=1)
    return np.asarray(cosine < _TURNED)


def telling_turns(observations: Observations) -> int:
    """How many turns end with another side up and have no clipped gyro, one that reads the most it reads in any turn
    in two samples in a row."""
    samples = observations.turn_samples
    if samples is None or not observations.turns:
        return 0
    spans = zip(samples.start.tolist(), samples.stop.tolist(), strict=True)
    rates = [np.abs(samples.samples.read_with_spare(start, stop)[0]) for start, stop in spans]
    limit = np.max([rate.max(axis=0) for rate in rates], axis=0)
    clipped = np.array([bool(((rate == limit)[1:] & (rate == limit)[:-1]).any()) for rate in rates])
    return int(np.count_nonzero(tilts(observations) & ~clipped))


def more_than_gyros_read(observations: Observations) -> str | None:
    """Why gyros read more at rest than they do in rad/s, in words: no gyro has a bias of 20 °/s, nor scatters by 0.17
    °/s in a second on a table. None where they do not."""
    rests = observations.rests
    bias = float(np.median(np.linalg.norm(rests.gyro, axis=1)))
    of_gyro, of_accel = (
        float(np.median(np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 3.0 * (rests.stop - rests.start))))
        for covariance in (rests.gyro_covariance, rests.accel_covariance)
    )
    if bias > _LARGEST_BIAS:
        return f"at rest they read {bias:.3g}, which in rad/s would be {bias / DEGREE:.3g} °/s"
    if of_gyro > _LARGEST_NOISE and of_accel < _ON_A_TABLE:
        return f"at rest they scatter by {of_gyro:.2g} in a second, which in rad/s would be {of_gyro / DEGREE:.2g} °/s"
    return None


def reads_the_earth(observations: Observations, latitude_deg: float | None) -> str | None:
    """How gyros at rest show the rate of the Earth, in words; None where they do not. Biases would have to have that
    length, and follow the attitude as the Earth does."""
    rests = observations.rests
    if rests.gyro.shape[1] != 3 or rests.accel.shape[1] != 3:
        return None
    up = unit_vector(rests.accel)
    length, about = np.linalg.norm(rests.gyro, axis=1), (rests.gyro * up).sum(axis=1)
    u = np.sqrt(np.trace(rests.gyro_covariance, axis1=1, axis2=2) / 3.0)
    if latitude_deg is not None:
        expected = EARTH_RATE * math.sin(latitude_deg * DEGREE)
        likewise = f"the Earth: {expected / DEGREE_PER_HOUR:.1f} at this latitude"
    elif (up @ up.T).min() < _APART:
        expected, likewise = float(about.mean()), "alike in attitudes that differ"
    else:
        return None
    if np.max([np.abs(length - EARTH_RATE), np.abs(about - expected), u]) > _NEAR_EARTH * EARTH_RATE:
        return None
    read, vertical = float(length.mean()) / DEGREE_PER_HOUR, float(about.mean()) / DEGREE_PER_HOUR
    return (
        f"at rest they read {read:.1f} °/h (the Earth: {EARTH_RATE / DEGREE_PER_HOUR:.1f}), {vertical:.1f} about the "
        f"vertical ({likewise}); a guess, right where their biases are below 2 °/h"
    )
