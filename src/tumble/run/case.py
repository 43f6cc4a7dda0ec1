"""Alignment of the accelerometers to the case of the device, from rests on its faces.

The accelerometers give the vertical in their frame b at every rest, u_i, to a few µrad. If the device stands on a face,
the vertical is along ±X, ±Y or ±Z of the case, n_i, except for the tilt of the plate and the seating. With the attitude
L_i of the case, case → geographic, and the lean t of the plate's normal to north and east,

    C_cb u_i = n_i − L_iᵀ t − ψ × n_i,     |t|, |ψ| ≪ 1

Wahba's problem (SVD) gives C_cb without t; ψ and t are then the least-squares solution of 2N equations, iterated. The
azimuth resolves the tilt in the case: a second placement on the same face, turned by 180°, has −L_iᵀ t, so that the
tilt cancels and is determined. Azimuths need not be true: any common north will do. They come from the gyros or from
a programme in order. Where they are not known, the tilt of each placement is part of the scatter, which is estimated
from the residuals.

Wahba's problem: Markley (1988), The Journal of the Astronautical Sciences 36, 245-258.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tumble.errors import InputError
from tumble.inference.estimate import Estimate
from tumble.inference.sources import source
from tumble.reduction.observations import Observations
from tumble.rotation import UP, rotation_matrix, skew, tangent_basis, unit_vector
from tumble.sensors.compensation import specific_force
from tumble.sensors.frames import Alignment, Frame, carried_further, convert
from tumble.sensors.instrument import Instrument, functions
from tumble.sensors.model import SensorModel
from tumble.units import DEGREE, Array, IntArray

_ON_A_FACE = np.cos(1.0 * DEGREE)
_ITERATIONS = 5  # each leaves the square of ψ and t, which are below 0.2 rad
_SINGULAR = 1e-6  # of the largest singular value
_WAYS = (("up", 1.0), ("down", -1.0))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CaseAlignment:
    """The case in the frame b of the accelerometers: rotation `mat_cb`, covariance and derivative as in
    `frames.Alignment`; `tilt` and `tilt_u` (2,), rad, the lean of the plate's normal to north and east, empty where
    the azimuths are not known; `scatter`, rad, of a placement about each horizontal axis; `rests` (N,), the numbers of
    the placements."""

    alignment: Alignment
    tilt: Array
    tilt_u: Array
    scatter: float
    rests: IntArray


def vertical_by_parameters(model: SensorModel, force: Array, change: Array) -> Array:
    """Derivative (N, 3, m) of the vertical in specific forces (N, 3) at rest with respect to parameters, by that of the
    readings, `change` (N, n, m)."""
    u = unit_vector(force)
    length = np.linalg.norm(force, axis=1)[:, None, None]
    return np.asarray(-(np.eye(3) - u[:, :, None] * u[:, None, :]) @ model.inverse() / length @ change)


def rotation_between(first: Array, second: Array) -> Array:
    """The rotation (3, 3) that best takes unit vectors (N, 3) `second` to `first` (Wahba)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.align_vectors(first, second)[0].as_matrix())


# -------------------- the case --------------------


def align_case(
    vertical: Array, by_parameters: Array, normals_c: Array, *, rests: IntArray, attitudes: Array | None = None
) -> CaseAlignment:
    """Align the accelerometers to the case by N placements on its faces, of these numbers among the `rests`: by the
    `vertical` (N, 3) in b with its derivative (N, 3, m) with respect to the parameters, the same (N, 3) in the case,
    and attitudes (N, 3, 3) body → geographic if the azimuths are known.

    Raises InputError unless the faces are in three different directions.
    """
    if len(normals_c) < 3 or np.linalg.svd(normals_c, compute_uv=False)[2] < _SINGULAR:
        raise InputError(
            f"case: expected placements on faces in three directions, found {len(normals_c)} placements in fewer"
        )
    basis = tangent_basis(normals_c)
    turned = np.einsum("irk,ikj->irj", basis, skew(normals_c))

    def rows_of(mat_cb: Array, attitudes: Array | None) -> Array:
        """Derivative (2N, 3 or 5) of C_cb u − n across n with respect to ψ and, where azimuths are known, t."""
        every = [turned]
        if attitudes is not None:
            every.append(np.einsum("irk,ikj->irj", basis, -np.swapaxes(attitudes @ mat_cb.T, 1, 2)[:, :, [0, 2]]))
        return np.asarray(np.concatenate(every, axis=2).reshape(2 * len(normals_c), -1))

    mat_cb = rotation_between(normals_c, vertical)
    if attitudes is not None:  # do the placements tell the plate's tilt from the rotation?
        singular = np.linalg.svd(rows_of(mat_cb, attitudes), compute_uv=False)
        if len(normals_c) < 4 or singular[-1] <= 1e-2 * singular[0]:
            attitudes = None
    for _ in range(_ITERATIONS):
        rows = rows_of(mat_cb, attitudes)
        misfit = np.einsum("irk,ik->ir", basis, vertical @ mat_cb.T - normals_c).ravel()
        gain = np.linalg.solve(rows.T @ rows, rows.T)
        step = gain @ misfit
        mat_cb = rotation_matrix(step[:3]) @ mat_cb
        residual = misfit - rows @ step
        scatter = float(np.sqrt(residual @ residual / max(len(residual) - rows.shape[1], 1)))
    covariance = scatter**2 * np.asarray(np.linalg.inv(rows.T @ rows), dtype=float)
    moved = np.einsum("irk,kj,ijm->irm", basis, mat_cb, by_parameters).reshape(len(residual), -1)
    return CaseAlignment(
        alignment=Alignment(mat_cb=mat_cb, covariance=covariance[:3, :3], by_parameters=gain[:3] @ moved),
        tilt=step[3:],
        tilt_u=np.sqrt(np.diag(covariance)[3:]),
        scatter=scatter,
        rests=rests,
    )


def case_of(
    observations: Observations, vertical: Array, by_parameters: Array, gyro: SensorModel | None
) -> CaseAlignment:
    """Align the accelerometers to the case in a session whose programme stands on all six faces, by the verticals
    (N, 3) of all its rests and their derivative (N, 3, m) with respect to parameters.

    Raises InputError, one line, where the session does not give the case."""
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
    rests = np.flatnonzero(np.abs(nominal).max(axis=1) > _ON_A_FACE)
    attitudes = _attitudes(observations, vertical, gyro)
    return align_case(
        vertical[rests],
        by_parameters[rests],
        np.round(nominal[rests]),
        rests=rests,
        attitudes=None if attitudes is None else attitudes[rests],
    )


def _attitudes(observations: Observations, verticals: Array, gyro: SensorModel | None) -> Array | None:
    """Attitudes (N, 3, 3) body → geographic with one common north: from rest to rest by the gyros, or as a programme
    in order has them; None where neither tells the azimuths. The Earth's turn during the moves, 0.25° a minute, is
    left out: it turns the tilt by as little."""
    turns = observations.turns
    if turns is not None and gyro is not None and len(turns) == len(verticals) - 1:
        C = observations.turns_about(gyro).C
        out = [_levelled(np.eye(3), verticals[0])]
        for turn, vertical in zip(C, verticals[1:], strict=True):
            out.append(_levelled(out[-1] @ turn, vertical))
        return np.array(out)
    programme, position = observations.programme, observations.position
    if programme is not None and position is not None and programme.ordered:
        return np.array([p.matrix for p in programme.positions])[position]
    return None


def _levelled(attitude: Array, vertical: Array) -> Array:
    """An attitude turned the shortest way so that the vertical is up in it."""
    up = attitude @ vertical
    cross = np.cross(up, UP)
    sine = float(np.linalg.norm(cross))
    if sine < _SINGULAR and up @ UP < 0.0:
        return np.asarray(np.diag([1.0, -1.0, -1.0]) @ attitude)
    scale = np.arctan2(sine, float(up @ UP)) / sine if sine > 0.0 else 1.0
    return rotation_matrix(scale * cross) @ attitude


def estimate_in(frame: Frame, estimate: Estimate, observations: Observations) -> tuple[Estimate, CaseAlignment | None]:
    """An estimate in the frame of the accelerometers, of which all parameters are observable, as one in another frame,
    with the alignment of the case where that is the frame.

    Raises InputError, one line, where the session does not give the case."""
    from scipy.linalg import block_diag

    accel, alignment = observations.accel_block, None
    if frame == "case":
        alignment = case_of(observations, *_verticals_of_rests(estimate, observations), estimate.gyro)
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
    unseen = set(estimate.unobservable)
    names = framed.names + estimate.names[linear:]
    further = np.eye(len(estimate.names) - linear)
    if estimate.instrument is not None:
        further = carried_further(estimate.instrument, framed.rotation)
    jacobian = block_diag(framed.jacobian, further)
    covariance = jacobian @ estimate.covariance @ jacobian.T
    covariance[: len(framed.names), : len(framed.names)] = framed.covariance
    budget = None if estimate.budget is None else estimate.budget.carried(jacobian)
    if budget is not None and alignment is not None:
        of_case = np.zeros_like(covariance)
        part = slice(len(framed.names))
        of_case[part, part] = framed.covariance - budget.covariances[:, part, part].sum(axis=0)
        budget = budget.with_source(source("case", alignment.scatter, "rad"), of_case)
    degrees = estimate.degrees  # parameters of the linear model mix: they have the fewest
    if degrees is not None:
        degrees = np.append(np.full(len(framed.names), degrees[:linear].min()), degrees[linear:])
    moved = replace(
        estimate,
        budget=budget,
        names=names,
        units=framed.units + estimate.units[linear:],
        values=np.append(framed.values, further @ estimate.values[linear:]),
        covariance=covariance,
        observable=np.array([name not in unseen for name in names]),
        accel=framed.accel,
        gyro=framed.gyro,
        increments=tuple(jacobian @ step for step in estimate.increments),
        degrees=degrees,
    )
    return moved, alignment


def _verticals_of_rests(estimate: Estimate, observations: Observations) -> tuple[Array, Array]:
    """The verticals (N, 3) by the whole model, and their derivative (N, 3, m) with respect to the parameters of the
    accelerometers that define the frame."""
    block, rests = observations.accel_block, observations.rests
    instrument = estimate.instrument or Instrument(accel=block, gyro=None)
    values = estimate.values[: len(instrument.names)]
    force = specific_force(instrument, values, rests.accel)
    change = np.einsum(
        "npb,pbm->npm",
        functions(block, force, np.zeros_like(force)),
        instrument.derivative(block, values)[:, :, : len(block.names)],
    )
    return unit_vector(force), vertical_by_parameters(estimate.accel, force, change)
