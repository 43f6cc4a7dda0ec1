"""imucal: the calibration of F. Ferraris, U. Grimaldi and M. Parvis, Procedure for effortless in-field calibration of
three-axial rate gyro and accelerometers, Sensors and Materials 7 (1995) 311, as github.com/mad-lab-fau/imucal
(ferraris_calibration.py) has it.

Accelerometers, Eq. (19) to (23): bᵢ is half the sum of the readings of axis i with it up and down; U₋ (3, 3), column j
the difference of the mean readings with axis j up and down, is 2 g K R. Gyros, Eq. (9) to (15): the bias is the mean
over the six faces, the sensitivity to specific force half the differences over g, and with both taken out the integrals
over the full turns about the three axes, as columns, are K R times the angle. No uncertainties; the Earth's rate is
neglected; faces and turns are taken to be exact.
"""

from __future__ import annotations

import numpy as np

from evidence.case import Array, Case, Estimate, Program
from evidence.peers.rests import faces


def accelerometers(face: dict[str, Array], gravity: float) -> tuple[Array, Array]:
    """K R (3, 3) and b (3,) from the mean readings of the six faces."""
    up, down = (np.column_stack([face[f"{axis}{sign}"] for axis in "xyz"]) for sign in "+-")
    return (up - down) / (2.0 * gravity), np.diag(0.5 * (up + down)).copy()


def gyros(case: Case, matrix: Array, bias: Array) -> tuple[Array, Array, Array]:
    """K R (3, 3), b (3,), and the sensitivity to specific force (3, 3), rad/s per m/s², of the gyros."""
    assert case.turn_angle is not None
    names = [f"{axis}{sign}" for sign in "+-" for axis in "xyz"]
    still = {name: case.between(*case.sections[name]).gyro for name in names}
    every = np.concatenate([gyro for gyro in still.values() if gyro is not None])
    means = {name: gyro.mean(axis=0) for name, gyro in still.items() if gyro is not None}
    up, down = (np.column_stack([means[f"{axis}{sign}"] for axis in "xyz"]) for sign in "+-")
    sensitivity = (up - down) / (2.0 * case.gravity)
    turned = np.empty((3, 3))
    for column, axis in enumerate("xyz"):
        part = case.between(*case.sections[f"{axis} turn"])
        assert part.gyro is not None
        force = np.linalg.solve(matrix, (part.accel - bias).T)
        turned[:, column] = (part.gyro.T - every.mean(axis=0)[:, None] - sensitivity @ force).sum(axis=1) / case.rate
    return turned / case.turn_angle, every.mean(axis=0), sensitivity


def estimate(case: Case) -> Estimate:
    """Accelerometers from faces, noted or found within 10°; gyros where full turns are noted."""
    matrix, bias = accelerometers(faces(case, np.radians(10.0)), case.gravity)
    noted = all(f"{axis} turn" in case.sections for axis in "xyz") and case.turn_angle is not None
    if case.gyro is None or not noted:
        return Estimate(accel=matrix, accel_bias=bias)
    gyro, gyro_bias, _ = gyros(case, matrix, bias)
    return Estimate(accel=matrix, accel_bias=bias, gyro=gyro, gyro_bias=gyro_bias)


PROGRAM = Program(
    name="imucal",
    needs=frozenset(),
    estimate=estimate,
    source="Ferraris, Grimaldi and Parvis 1995; github.com/mad-lab-fau/imucal",
)
