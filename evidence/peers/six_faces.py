"""Six faces: what data sheets and application notes advise, and PX4.

Six faces: bias and scale factor of each axis from its own readings up and down, axes taken to be orthogonal. PX4
(github.com/PX4/PX4-Autopilot, accelerometer_calibration.cpp): the same offsets; T from the three faces of one sign,
T (a − b) = g e for each, of which the present version keeps the diagonal. PX4 finds a face where each component is
within 5 m/s² of the expected; here it is 10°, as its instructions demand. PX4 takes 9.80665 m/s² for g; here it is
given the gravity of the case. No uncertainties, no gyros beyond an offset.
"""

from __future__ import annotations

import numpy as np

from evidence.case import Array, Case, Estimate, Program
from evidence.peers.rests import faces

WITHIN = np.radians(10.0)


def own_axes(face: dict[str, Array], gravity: float) -> tuple[Array, Array]:
    """Diagonal matrix (3, 3) and bias (3,): half difference and half sum of each axis' own readings."""
    up = np.array([face[f"{axis}+"][i] for i, axis in enumerate("xyz")])
    down = np.array([face[f"{axis}-"][i] for i, axis in enumerate("xyz")])
    return np.diag((up - down) / (2.0 * gravity)), 0.5 * (up + down)


def px4(face: dict[str, Array], gravity: float) -> tuple[Array, Array, Array]:
    """T (3, 3) as it is computed, what is kept of it, and the offsets (3,)."""
    _, offsets = own_axes(face, gravity)
    rows = np.array([face[f"{axis}+"] - offsets for axis in "xyz"])
    full = gravity * np.linalg.inv(rows)
    return full, np.diag(np.diag(full)), offsets


def estimate_own_axes(case: Case) -> Estimate:
    """Accelerometers alone."""
    matrix, bias = own_axes(faces(case, WITHIN), case.gravity)
    return Estimate(accel=matrix, accel_bias=bias)


def estimate_px4(case: Case) -> Estimate:
    """Accelerometers alone."""
    _, kept, offsets = px4(faces(case, WITHIN), case.gravity)
    return Estimate(accel=np.linalg.inv(kept), accel_bias=offsets)


SIX_FACES = Program(
    name="six faces", needs=frozenset(), estimate=estimate_own_axes, source="half sums and half differences"
)
PX4 = Program(
    name="PX4",
    needs=frozenset(),
    estimate=estimate_px4,
    source="github.com/PX4/PX4-Autopilot, src/modules/commander/accelerometer_calibration.cpp",
)
