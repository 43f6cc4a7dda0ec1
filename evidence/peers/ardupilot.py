"""ArduPilot's AccelCalibrator (github.com/ArduPilot/ardupilot, libraries/AP_AccelCal): Gauss and Newton's iteration for
the least sum of (g − ‖M (a + o)‖)², M symmetric.

By default M is diagonal and there are six samples, of the vehicle on its six sides; the general ellipsoid, nine
unknowns, is there too and is given all rests here. A sample is refused that is nearer to another than a regular body
of so many corners allows. The result is accepted where the mean square is below 0.1 (m/s²)², no offset exceeds g and
the diagonal is within 0.8 and 1.2. The program's own iteration ends as soon as a step makes the sum less, which is
after the first; here it goes on to the minimum. It takes 9.80665 m/s² for g; here it is given the gravity of the case.
"""

from __future__ import annotations

import numpy as np

from evidence.case import Array, Case, Estimate, GaveUpError, Program
from evidence.peers.rests import faces, found

MOST_STEPS = 50
TOLERANCE = 0.1  # (m/s²)²


def matrix_of_unknowns(p: Array) -> Array:
    """M (3, 3) of offsets, diagonal and, of nine, the rest."""
    xy, xz, yz = p[6:9] if len(p) == 9 else (0.0, 0.0, 0.0)
    return np.array([[p[3], xy, xz], [xy, p[4], yz], [xz, yz, p[5]]])


def residuals(p: Array, samples: Array, gravity: float) -> tuple[Array, Array]:
    """(N,) and their Jacobian (N, 6 or 9)."""
    matrix, moved = matrix_of_unknowns(p), samples + p[:3]
    corrected = moved @ matrix.T
    length = np.linalg.norm(corrected, axis=1)
    unit = corrected / length[:, None]
    x, y, z = moved.T
    columns = [*(unit @ matrix).T, *(unit * moved).T]
    if len(p) == 9:
        columns += [unit[:, 0] * y + unit[:, 1] * x, unit[:, 0] * z + unit[:, 2] * x, unit[:, 1] * z + unit[:, 2] * y]
    return gravity - length, -np.column_stack(columns)


def fitted(samples: Array, gravity: float, unknowns: int) -> tuple[Array, float]:
    """The unknowns (6 or 9) with the least mean square, and that."""
    p = np.concatenate([np.zeros(3), np.ones(3), np.zeros(unknowns - 6)])
    best, least = p, float(np.mean(residuals(p, samples, gravity)[0] ** 2))
    for _ in range(MOST_STEPS):
        r, jacobian = residuals(p, samples, gravity)
        p = p - np.linalg.solve(jacobian.T @ jacobian, jacobian.T @ r)
        mean_square = float(np.mean(residuals(p, samples, gravity)[0] ** 2))
        if not np.isfinite(mean_square):
            raise GaveUpError("the iteration diverges")
        settled = abs(mean_square - least) < 1e-15 * gravity**2
        if mean_square < least:
            best, least = p, mean_square
        if settled:
            break
    return best, least


def least_distance(samples: int, gravity: float) -> float:
    """m/s²: half the side of a regular body with triangular faces and so many corners, at the length of gravity."""
    angle = (4.0 * np.pi / (2.0 * samples - 4.0) + np.pi) / 3.0
    side = np.arccos(np.cos(angle) / (1.0 - np.cos(angle)))
    return float(2.0 * gravity * np.sin(0.25 * side))


def calibrated(samples: Array, gravity: float, unknowns: int) -> Estimate:
    """The fit and the program's own verdict."""
    p, mean_square = fitted(samples, gravity, unknowns)
    matrix = matrix_of_unknowns(p)
    diagonal = np.diag(matrix)
    good = (
        mean_square < TOLERANCE and np.abs(p[:3]).max() <= gravity and diagonal.min() >= 0.8 and diagonal.max() <= 1.2
    )
    return Estimate(accel=np.linalg.inv(matrix), accel_bias=-p[:3], accepted=bool(good))


def estimate_six(case: Case) -> Estimate:
    """By default: six samples, on the sides or what is nearest to them."""
    samples = np.array(list(faces(case, np.radians(45.0)).values()))
    apart = np.linalg.norm(samples[:, None] - samples[None], axis=2) + 1e9 * np.eye(6)
    if apart.min() < least_distance(6, case.gravity):
        raise GaveUpError("two of the six samples are too near to each other")
    return calibrated(samples, case.gravity, 6)


def estimate_ellipsoid(case: Case) -> Estimate:
    """The general ellipsoid through all rests."""
    samples = found(case).accel
    if len(samples) < 9:
        raise GaveUpError(f"{len(samples)} rests for nine unknowns")
    return calibrated(samples, case.gravity, 9)


SIX = Program(
    name="ArduPilot",
    needs=frozenset(),
    estimate=estimate_six,
    source="github.com/ArduPilot/ardupilot, libraries/AP_AccelCal/AccelCalibrator.cpp",
)
ELLIPSOID = Program(
    name="ArduPilot ellipsoid", needs=frozenset(), estimate=estimate_ellipsoid, source="the same, ACCEL_CAL_ELLIPSOID"
)
