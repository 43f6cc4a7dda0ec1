"""The published figures of the turntable method, reproduced without noise on simulated launches.

§4, §6.5 and §6.6 give RMS errors over launches whose number is not stated. They are of second and higher order in
Gaussian parameters, so that the RMS over 20 launches varies by 30 % and more. A published figure counts as reproduced
if it lies within the range of the RMS over groups of 20 launches out of 600; our own RMS over all 600 is held to 5 %
beside it. Where a figure does not come out, the test says so and what comes out instead.

Relative errors are in percent of the standard deviation the parameters are drawn with (§6.5). Columns: b, k, γ.
"""

from __future__ import annotations

import numpy as np
import pytest

from rough_launches import (
    COURSE,
    EARTH,
    GRAVITY,
    PROGRAMME,
    SIZES,
    Launches,
    launches,
    passes,
    rough_attitudes,
    rough_launches,
    values_of,
)
from tumble.earth import EARTH_RATE
from tumble.methods.compensation import compensated, composed, perfect, triad_model, triad_parameters
from tumble.methods.four_stages import Method
from tumble.methods.gyro_bias import invariant_bias, vertical_bias
from tumble.methods.indirect import (
    accelerometer_errors,
    gyro_errors,
    horizontal_differences,
    leakage,
    logged_jacobian,
    programme_matrix,
)
from tumble.methods.levelling import triad, vertical
from tumble.methods.scalar import accelerometers as scalar_accelerometers
from tumble.methods.scalar import scalar_differences, scalar_fit, scalar_rows
from tumble.methods.sequential import accelerometers as sequential_accelerometers
from tumble.methods.sequential import check_positions
from tumble.model import SensorModel
from tumble.units import ARCSEC, DEGREE, Array

N = 600
GROUP = 20
NINE = [8, 10, 0, 1, 4, 5, 12, 13, 14]
"""Rests of rough-table that are the programme of nine: X, Y, Z up and down, three at 45°."""

COLUMNS = {"b": slice(0, 3), "k": slice(3, 6), "γ": slice(6, 9), "k gyro": slice(12, 15), "γ gyro": slice(15, 21)}

SEQUENTIAL = Method(
    name="sequential", accelerometers=sequential_accelerometers, gyro_bias=vertical_bias, check=check_positions
)
SCALAR = Method(name="scalar", accelerometers=scalar_accelerometers, gyro_bias=vertical_bias, check=check_positions)


def percent(found: Array, true: Array, column: str) -> Array:
    """Squared relative errors in % (n,): mean over the parameters of a column."""
    relative = 100.0 * (found - true) / SIZES[: true.shape[1]]
    return np.asarray((relative[:, COLUMNS[column]] ** 2).mean(axis=1))


def assert_published(squares: Array, published: float, ours: float) -> None:
    """The figure is within the range of groups of launches, and ours is what it was when this was written."""
    groups = np.sqrt(squares.reshape(-1, GROUP).mean(axis=1))
    assert groups.min() <= published <= groups.max()
    assert np.sqrt(squares.mean()) == pytest.approx(ours, rel=0.05)


# §4: the scalar method on nine orientations, positions ±1.5°


@pytest.fixture(scope="module")
def nine() -> Launches:
    rng = np.random.default_rng(40)
    values = SIZES * rng.standard_normal((N, 21))
    return launches(values, rough_attitudes(N, rng, mounting_deg=0.0, position_deg=1.5))


def scalar_passes(found: Launches, orientation: str, count: int) -> list[SensorModel]:
    """What each pass of the scalar method finds in readings compensated by the passes before."""
    total, out = perfect(), []
    for _ in range(count):
        readings = compensated(total, found.force[:, NINE])
        u = vertical(readings) if orientation == "estimated" else COURSE.nominal[NINE]
        out.append(scalar_fit(readings, u, np.array(GRAVITY)))
        total = composed(total, out[-1])
    return out


@pytest.mark.parametrize(
    ("orientation", "iterations", "column", "published", "ours"),
    [
        ("nominal", 1, "b", 1.8, 1.78),
        ("nominal", 1, "k", 3.6, 3.57),
        ("nominal", 1, "γ", 11.0, 11.1),
        ("nominal", 2, "b", 0.11, 0.105),
        ("nominal", 2, "k", 0.23, 0.214),
        ("nominal", 2, "γ", 0.60, 0.561),
        ("estimated", 1, "b", 0.020, 0.0198),
        ("estimated", 1, "k", 0.052, 0.0616),
        ("estimated", 1, "γ", 0.11, 0.123),
    ],
)
def test_table_of_section_4(
    nine: Launches, orientation: str, iterations: int, column: str, published: float, ours: float
) -> None:
    total = perfect()
    for found in scalar_passes(nine, orientation, iterations):
        total = composed(total, found)
    values = values_of(total, perfect_gyros(nine))
    assert_published(percent(values, nine.values, column), published, ours)


def perfect_gyros(found: Launches) -> SensorModel:
    n = len(found.values)
    return triad_model(np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 6)))
