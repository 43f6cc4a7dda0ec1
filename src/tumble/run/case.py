"""Alignment of the accelerometers to the case of the device, from rests on its faces.

The accelerometers give the vertical in their frame b at every rest, u_i, to a few µrad. Where the device stands on a
face, the vertical is along ±X, ±Y or ±Z of the case, n_i, except for the tilt of the plate and the seating. The
rotation C_cb that takes u_i to n_i best is the solution of Wahba's problem. With a_i = C_cb u_i, from Σ a_i × n_i = 0
follow the rotation ψ by which it changes with u_i, and, with the scatter s of the placements, its covariance,

    J ψ = Σ (C_cb δu_i) × n_i,     J = Σ [(a_i·n_i) I − ½(a_i n_iᵀ + n_i a_iᵀ)],     Cov ψ = s² J⁻¹

A second placement on the same face, turned by 180°, cancels the tilt of the plate.

Wahba's problem: Markley (1988), The Journal of the Astronautical Sciences 36, 245-258.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tumble.errors import InputError
from tumble.inference.estimate import Estimate
from tumble.inference.sources import source
from tumble.reduction.observations import Observations
from tumble.rotation import unit_vector
from tumble.sensors.compensation import specific_force
from tumble.sensors.frames import Alignment, Frame, convert, further_rotation
from tumble.sensors.instrument import Instrument, functions
from tumble.sensors.model import SensorModel
from tumble.units import DEGREE, Array

_ON_A_FACE = np.cos(1.0 * DEGREE)  # least component of the nominal vertical along an axis of the case
_SINGULAR = 1e-6  # smallest singular value of normals in three directions
_WAYS = (("up", 1.0), ("down", -1.0))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CaseAlignment:
    """The case in the frame b of the accelerometers, found from `placements` on its faces.

    `scatter`, rad, is the standard deviation of a placement about each horizontal axis."""

    alignment: Alignment
    scatter: float
    placements: int

    @property
    def note(self) -> str:
        """The placements and the uncertainty of the alignment in words."""
        u = ", ".join(f"{each:.2g}°" for each in np.sqrt(np.diag(self.alignment.covariance)) / DEGREE)
        return (
            f"case: from {self.placements} rests on its six faces, which scatter by {self.scatter / DEGREE:.2g}° an "
            f"axis; standard uncertainty of its alignment {u} about X, Y, Z; the tilt of the plate is part of the "
            "scatter"
        )


def vertical_by_parameters(model: SensorModel, force: Array, change: Array) -> Array:
    """Return the derivative (N, 3, m) of the vertical at rest with respect to parameters.

    `force` (N, 3) are specific forces, `change` (N, n, m) the derivative of the readings."""
    u = unit_vector(force)
    length = np.linalg.norm(force, axis=1)[:, None, None]
    return np.asarray(-(np.eye(3) - u[:, :, None] * u[:, None, :]) @ model.inverse() / length @ change)


def align_case(vertical: Array, by_parameters: Array, normals_c: Array) -> CaseAlignment:
    """Align the accelerometers to the case by N placements on its faces, with nominal verticals `normals_c` (N, 3).

    `vertical` (N, 3) in b has derivatives (N, 3, m) with respect to parameters of the accelerometers. Raises InputError
    unless the faces are in three different directions."""
    from scipy.spatial.transform import Rotation

    if len(normals_c) < 3 or np.linalg.svd(normals_c, compute_uv=False)[2] < _SINGULAR:
        raise InputError(
            f"case: expected placements on faces in three directions, found {len(normals_c)} placements in fewer"
        )
    mat_cb = np.asarray(Rotation.align_vectors(normals_c, vertical)[0].as_matrix())  # Wahba
    vertical_c = vertical @ mat_cb.T
    scatter = float(np.sqrt((np.cross(vertical_c, normals_c) ** 2).sum() / (2 * len(normals_c) - 3)))
    products = vertical_c.T @ normals_c
    information = np.trace(products) * np.eye(3) - 0.5 * (products + products.T)
    moment = np.cross(mat_cb @ by_parameters, normals_c[:, :, None], axis=1).sum(axis=0)
    return CaseAlignment(
        alignment=Alignment(
            mat_cb=mat_cb,
            covariance=scatter**2 * np.asarray(np.linalg.inv(information), dtype=float),
            by_parameters=np.linalg.solve(information, moment),
        ),
        scatter=scatter,
        placements=len(normals_c),
    )


def case_of(observations: Observations, vertical: Array, by_parameters: Array) -> CaseAlignment:
    """Align the accelerometers to the case in a session whose programme stands on all six faces.

    `vertical` (N, 3) are those of all rests, `by_parameters` (N, 3, m) their derivative. Raises InputError if the
    session does not determine the case."""
    programme, position = observations.programme, observations.position
    if programme is None or position is None:
        raise InputError(
            "frame 'case': expected a session with a [programme] that stands on all six faces, such as cube-14 or "
            "nine, found none: without it no rest is known to be on a face"
        )
    nominal = np.array([p.vertical_b for p in programme.positions])
    faces = {f"{axis} {sense}": sign * row for axis, row in zip("XYZ", np.eye(3), strict=True) for sense, sign in _WAYS}
    if missing := [name for name, face in faces.items() if np.max(nominal @ face) < _ON_A_FACE]:
        raise InputError(
            f"frame 'case': expected a programme that stands on all six faces, such as cube-14 or nine, found "
            f"{programme.name!r} without {', '.join(missing)}"
        )
    nominal = nominal[position]
    on_face = np.abs(nominal).max(axis=1) > _ON_A_FACE
    return align_case(vertical[on_face], by_parameters[on_face], np.round(nominal[on_face]))


def estimate_in(frame: Frame, estimate: Estimate, observations: Observations) -> tuple[Estimate, CaseAlignment | None]:
    """Convert an estimate from the frame of the accelerometers to another; for `case` return also the alignment.

    All parameters of the estimate must be observable. Raises InputError if the session does not determine the case."""
    from scipy.linalg import block_diag

    accel, alignment = observations.accel_block, None
    if frame == "case":
        instrument = estimate.instrument or Instrument(accel=accel, gyro=None)
        values = estimate.values[: len(instrument.names)]
        force = specific_force(instrument, values, observations.rests.accel)
        derivative = instrument.derivative(accel, values)[:, :, : len(accel.names)]
        change = np.einsum("npb,pbm->npm", functions(accel, force, np.zeros_like(force)), derivative)
        by_parameters = vertical_by_parameters(estimate.accel, force, change)
        alignment = case_of(observations, unit_vector(force), by_parameters)
    linear = len(estimate.names) if estimate.instrument is None else estimate.instrument.linear_count
    framed = convert(
        accel,
        None if estimate.gyro is None else observations.gyro_block,
        source="accelerometer",
        values=estimate.values[:linear],
        covariance=estimate.covariance[:linear, :linear],
        target=frame,
        alignment=None if alignment is None else alignment.alignment,
    )
    assert framed.covariance is not None
    names = framed.names + estimate.names[linear:]
    further = np.eye(len(estimate.names) - linear)
    if estimate.instrument is not None:
        further = further_rotation(estimate.instrument, framed.rotation)
    jacobian = block_diag(framed.jacobian, further)
    covariance = jacobian @ estimate.covariance @ jacobian.T
    covariance[: len(framed.names), : len(framed.names)] = framed.covariance
    budget = None if estimate.budget is None else estimate.budget.carried(jacobian)
    if budget is not None and alignment is not None:
        by_case = np.zeros_like(covariance)
        part = slice(len(framed.names))
        by_case[part, part] = framed.covariance - budget.covariances[:, part, part].sum(axis=0)
        budget = budget.with_source(source("case", alignment.scatter, "rad"), by_case)
    degrees = estimate.degrees  # the conversion mixes the linear parameters: all get the fewest
    if degrees is not None:
        degrees = np.append(np.full(len(framed.names), degrees[:linear].min()), degrees[linear:])
    converted = replace(
        estimate,
        budget=budget,
        names=names,
        units=framed.units + estimate.units[linear:],
        values=np.append(framed.values, further @ estimate.values[linear:]),
        covariance=covariance,
        observable=np.array([name not in estimate.unobservable for name in names]),
        accel=framed.accel,
        gyro=framed.gyro,
        increments=tuple(jacobian @ step for step in estimate.increments),
        degrees=degrees,
    )
    return converted, alignment
