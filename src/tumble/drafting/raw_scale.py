"""What a count of a raw sensor is worth, from the recording itself: counts per g from the rests, on whose mean readings
gravity draws a sphere, and what gyros read for a rad/s from the turns, over which they carry the vertical from rest
to rest.

Both are rough, as good as the sensors' own scale errors.
"""

from __future__ import annotations

import numpy as np

from tumble.recording.formats.columns import ACCEL
from tumble.recording.formats.columns_by_data import MIDDLES
from tumble.recording.formats.scales import matched
from tumble.reduction.observations import Observations
from tumble.reduction.sphere import sphere_through
from tumble.sensors.model import SensorModel
from tumble.units import Array

_ALIKE = 0.05
_NO_OFFSET = 0.3
_LEAST_SINGULAR = 0.05
_TURNS = 3
_MISS = 0.15
_MOST_MISSED = 0.5
_SMALLEST, _LARGEST = 0.05, 30.0  # rad, of a turn
_GRID = 160
_SLOW = 1e12


def accel_scale(means: Array) -> tuple[float, list[float]] | None:
    """Counts per g and zeros (3,) of accelerometers from mean readings (N, 3) at rest; about no or a converter's middle
    zero where that is what the centre of their sphere is near to. None where the readings do not tell."""
    found = _sphere(means)
    if found is None or _are_one_attitude(means):
        return None
    radius, zero = found
    middles = MIDDLES if (means > 0.0).all() else ()
    known = next((m for m in (0.0, *middles) if np.abs(zero - m).max() < _NO_OFFSET * radius), None)
    return radius, [known] * 3 if known is not None else [float(f"{z:.5g}") for z in zero]


def _are_one_attitude(means: Array) -> bool:
    """Whether readings at rest are alike, and one g in counts of a data sheet: what they differ by is no sphere."""
    length = float(np.median(np.linalg.norm(means, axis=1)))
    alike = float(np.linalg.norm(means.std(axis=0))) < _ALIKE * length
    return alike and matched(ACCEL, length, whole=True).known


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
    vertical = force / np.linalg.norm(force, axis=1, keepdims=True)

    def misses(log_factor: float) -> Array:
        model = SensorModel(matrix=matrix * np.exp(log_factor), bias=bias)
        carried = observations.turns_about(model).C
        back = np.einsum("kij,kj->ki", carried, vertical[turns.last])
        cosine = np.einsum("ki,ki->k", np.nan_to_num(back, nan=0.0), vertical[turns.first])
        return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))

    def cost(log_factor: float) -> float:
        return float(np.minimum(misses(log_factor), _MOST_MISSED).mean())

    slow = SensorModel(matrix=matrix * _SLOW, bias=bias)  # so that next to nothing turns while it is integrated
    size = _SLOW * float(np.median(np.sqrt((observations.turns_about(slow).M ** 2).sum(axis=(1, 2, 3)))))
    if not size > 0.0:
        return None
    grid = np.log(np.geomspace(size / _LARGEST, size / _SMALLEST, _GRID))
    costs = np.array([cost(x) for x in grid])
    best = min(
        (
            minimize_scalar(cost, bounds=(grid[k] - 0.06, grid[k] + 0.06), method="bounded")
            for k in np.argsort(costs)[:3]
        ),
        key=lambda found: float(found.fun),
    )
    cosine = np.einsum("ki,ki->k", vertical[turns.last], vertical[turns.first])
    moved = float(np.minimum(np.arccos(np.clip(cosine, -1.0, 1.0)), _MOST_MISSED).mean())
    carried = np.median(misses(float(best.x))) < _MISS and best.fun < min(_MISS, 0.5 * moved)
    return float(np.exp(best.x)) if carried else None


def wrapped(columns: Array) -> bool:
    """Whether integers (m, n) are numbers of 16 bits with a sign that were read without it: from 0 to 65535, and hardly
    any in the middle, while they are on both sides."""
    if not np.isfinite(columns).any():
        return False
    low, high = np.nanmin(columns), np.nanmax(columns)
    if low < 0.0 or not 49152.0 < high < 65536.0 or not np.array_equal(columns, np.floor(columns), equal_nan=True):
        return False
    middle = (columns > 24576.0) & (columns < 40960.0)
    return bool(middle.mean() < 0.02 and (columns < 24576.0).any() and (columns > 40960.0).mean() > 1e-3)


def unwrapped(columns: Array) -> Array:
    """What numbers of 16 bits read without their sign were."""
    return np.where(columns >= 32768.0, columns - 65536.0, columns)
