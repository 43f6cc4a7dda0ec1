"""The ellipsoid method: a triad whose readings all measure one vector of known length, in unknown orientations.

    y = M t + b,  |t| = m        so that  (y − b)ᵀ H (y − b) = 1,  H = (M Mᵀ)⁻¹/m²        Eqs. (1), (6), (7)

N readings y (N, 3), in units of the true quantity after nominal scale and polarity, lie on an ellipsoid. Its centre is
the bias; its shape gives M Mᵀ, the lengths of the rows of M (scale factors) and the angles between them
(nonorthogonality). M is determined up to a rotation, which is chosen so that M is in the accelerometer frame.
Of accelerometers at rest m is g.

The algebraic fit of Li & Griffiths gives the ellipsoid without a start (`quadric`).

Geometric fit: least squares on |M⁻¹(y − b)| − m with the covariances of the readings as weights, Gauss–Newton from the
algebraic fit. In programmes that surround the sphere it changes the values by a hundredth of their uncertainties; it is
there for weights, robustness and covariance.

The polarity of a channel is not in the data, since t and −t have the same length: it comes from the nominal scale or
from roughly known positions (`readings`).

Source, with its numbers: the ellipsoid paper (calibration of a triaxial block of navigation accelerometers by ellipsoid
fitting), whose sign of Eq. (13), b = A u0, is lost in print.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import scipy

from tumble.brief import Brief
from tumble.diagnosis.observability import Refusal, undetermined
from tumble.errors import InputError
from tumble.inference.estimate import Fit
from tumble.methods.least_squares import (
    MAX_ITERATIONS,
    SCATTER_ROUNDS,
    as_normal,
    least_squares,
    scatter_of,
    sigmas,
    unexplained,
)
from tumble.methods.quadric import fit_many
from tumble.sensors.model import Block, SensorModel, to_accelerometer_frame
from tumble.units import Array, BoolArray

TRIAD = Block(kind="accel", axes=np.eye(3))
"""Three sensors along X, Y, Z with the parameters bias, scale and the angles yx, zx, zy of their own frame."""

SPREAD = np.full(9, 10.0)
"""Spreads of the parameters, biases in parts of the modulus: a parameter with a larger u than a tenth of its spread,
the modulus itself, is not determined."""

BAD_SIGMAS = 5.0
"""Distance from the fit through all others at which a position is bad, unless stated otherwise."""

FLOOR = 1e-13
"""Least standard uncertainty of a reading, in parts of the modulus."""

MOST_BAD = 0.2
"""Largest part of the positions that is left out as bad: beyond it, good and bad ones cannot be distinguished."""

RIVAL_CHANCE = 1e-3
"""Leaving out another position explains as much if the variance of the others is then not larger by more than chance
makes it with this probability."""

SHOWN = 1e-6
"""Part of the variance of a residual that must remain after the fit for it to show anything."""

_LEFT_OUT_EACH = 50
"""Up to so many positions, each is left out in turn to find a bad one."""


@dataclass(frozen=True, kw_only=True, slots=True)
class WorstPosition:
    """The used position that is furthest, in `sigmas`, from the fit through all others, and the scatter of these.
    Without one of the `rivals` instead, the others fit about as well, as with opposite edges of a cube if only edges
    were taken: the positions do not tell which one is bad, if any is."""

    position: int
    sigmas: float
    scatter: float
    rivals: tuple[int, ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class EllipsoidFit(Brief):
    """Parameters of a triad by the ellipsoid through its readings.

    `values` (9,) are in the order of the names of the block, with `covariance` (9, 9), None if there are no more
    positions than unknowns and no noise is given. It includes `by_modulus` (9,), the change by one standard uncertainty
    of the modulus; the rest has `noise_degrees` of freedom, infinite if the noise is given. `scatter` is that of a
    reading, estimated in addition to the noise. `residual` (N,) is |M⁻¹(y − b)| − m of each position; `leverage` the
    part of itself that it explains; `leave_one_out` the residual against the fit through all others, with its standard
    uncertainty and, in `sigmas`, their ratio. Positions that are not `used` are left out as bad. One of the `doubtful`
    positions is bad, but the others do not tell which; they are used."""

    values: Array
    covariance: Array | None
    by_modulus: Array
    noise_degrees: float
    model: SensorModel
    residual: Array
    leverage: Array
    leave_one_out: Array
    leave_one_out_u: Array
    sigmas: Array
    used: BoolArray
    doubtful: tuple[int, ...]
    chi_square: float
    degrees: int
    scatter: float
    worst: WorstPosition | None
    increments: tuple[Array, ...]
    converged: bool

    def fit(self, unit: str) -> Fit:
        """Chi-square and scatter as a calibration keeps them; `unit` is that of the modulus."""
        return Fit(chi_square=self.chi_square, degrees=float(self.degrees), scatter=self.scatter, unit=unit)


def fit_ellipsoid(
    readings: Array,
    *,
    modulus: float,
    modulus_u: float = 0.0,
    covariance: Array | None = None,
    block: Block = TRIAD,
    bad_sigmas: float = BAD_SIGMAS,
) -> EllipsoidFit | Refusal:
    """Calibrate a triad from readings (N, 3) of a vector of length `modulus` in N unknown orientations, in the unit of
    the modulus after nominal scale and polarity, in the frame that `block` fixes.

    `covariance` (N, 3, 3) is that of their noise, in addition to which a scatter is estimated; without it all are
    equally good. A position more than `bad_sigmas` from the fit through the others is left out.

    >>> import numpy as np, tumble
    >>> faces = np.vstack([np.eye(3), -np.eye(3)])
    >>> corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3.0)
    >>> found = fit_ellipsoid(9.8 * np.vstack([faces, corners]) + [0.1, 0.05, -0.2], modulus=9.8)
    >>> found.values[:3].round(6).tolist()
    [0.1, 0.05, -0.2]
    """
    if np.ndim(readings) != 2 or np.shape(readings)[1] != len(block.axes) or not np.isfinite(readings).all():
        raise InputError(
            f"readings: expected finite numbers of shape (positions, {len(block.axes)}), found the shape "
            f"{np.shape(readings)}" + ("" if np.isfinite(readings).all() else " with some that are not finite")
        )
    if not 0.0 < modulus < np.inf or not 0.0 <= modulus_u < np.inf:
        raise InputError(f"modulus: expected a length above 0 and its u, found {modulus:g} and {modulus_u:g}")
    refusal = undetermined(readings, block=block)
    if refusal is not None:
        return refusal
    noise = np.zeros((3, 3)) if covariance is None else covariance
    sphere = _Sphere(
        readings=readings,
        modulus=modulus,
        modulus_u=modulus_u,
        covariance=np.broadcast_to(noise + (FLOOR * modulus) ** 2 * np.eye(3), (len(readings), 3, 3)),
        noisy=covariance is not None,
        block=block,
    )
    used = np.ones(len(readings), dtype=bool)
    while True:
        found = _fitted(sphere, used)
        worst = _worst_position(sphere, found, used)
        bad = worst is not None and worst.sigmas > bad_sigmas
        most = max(1, int(MOST_BAD * len(readings)))
        if worst is None or not bad or worst.rivals or (~used).sum() + 1 > most:
            break
        used = used & (np.arange(len(readings)) != worst.position)
    if found is None:
        reason = (
            f"the {len(readings)} readings do not lie on an ellipsoid, with whichever of them left out: look for "
            "exchanged channels, clipped readings or a vector whose length changed"
        )
        return Refusal(reason=reason, null=np.empty((0, 9)))
    sigmas = found.sigmas
    doubtful = (worst.position, *worst.rivals) if worst is not None and bad else ()
    if worst is not None:
        sigmas[list(doubtful)] = np.maximum(sigmas[list(doubtful)], worst.sigmas)
    return replace(found, worst=worst, doubtful=doubtful)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Sphere:
    """Arguments of `fit_ellipsoid`; `noisy` if the covariance of the readings is given."""

    readings: Array
    modulus: float
    modulus_u: float
    covariance: Array
    noisy: bool
    block: Block

    def start(self, used: BoolArray) -> Array | None:
        """Parameter values of the algebraic fit; None where there is none."""
        found = fit_many(self.readings[None, used])
        if not found.found[0]:
            return None
        some = found.models(self.modulus)
        handed = np.diag([1.0, 1.0, np.sign(np.linalg.det(self.block.axes))])
        model = SensorModel(matrix=some.matrix[0] @ handed, bias=some.bias[0])
        return np.asarray(self.block.parameters(to_accelerometer_frame(self.block, model, None)[0]))

    def rows(self, values: Array) -> tuple[Array, Array, Array, Array]:
        """Residuals |M⁻¹(y − b)| − m (N,) at parameter values (9,), minus their derivative (N, 9), their variance (N,)
        by noise, and what a scatter of the readings of unit variance adds to it (N,)."""
        model = self.block.model(values)
        true = model.apply(self.readings)
        length = np.linalg.norm(true, axis=1)
        direction = true / length[:, None]
        normal = direction @ model.inverse()
        homogeneous = np.concatenate([self.modulus * direction, np.ones((len(direction), 1))], axis=1)
        jacobian = np.einsum("ip,pqm,iq->im", normal, self.block.jacobian(values), homogeneous)
        variance = np.einsum("ip,ipq,iq->i", normal, self.covariance, normal)
        return length - self.modulus, jacobian, variance, (normal**2).sum(axis=1)

    def whitened(self, values: Array, scatter: float) -> tuple[Array, Array, Array]:
        """Whitened residuals (N,), minus their derivative (N, 9), and standard uncertainties (N,), with a scatter."""
        residual, jacobian, variance, by_scatter = self.rows(values)
        sigma = np.sqrt(variance + scatter**2 * by_scatter)
        return residual / sigma, jacobian / sigma[:, None], sigma


def _fitted(sphere: _Sphere, used: BoolArray) -> EllipsoidFit | None:
    """Geometric fit through the used readings, with the scatter that explains its residuals.

    None if the algebraic fit finds no ellipsoid to start from, or the readings do not determine the parameters."""
    values, degrees = sphere.start(used), int(used.sum()) - 9
    if values is None:
        return None
    spread, scatter, increments = SPREAD * np.repeat([sphere.modulus, 1.0, 1.0], 3), 0.0, [values]
    for scatter_round in range(1 + SCATTER_ROUNDS):
        if scatter_round:
            residual, _, variance, by_scatter = (each[used] for each in sphere.rows(values))
            excess = partial(_excess, residual**2, variance, by_scatter)
            if scatter_round == 1 and not unexplained(excess(0.0) + degrees, degrees):
                break
            scatter = scatter_of(excess, float(np.sqrt(np.mean(residual**2 / by_scatter))))
        for _ in range(MAX_ITERATIONS):
            residual, jacobian, sigma = sphere.whitened(values, scatter)
            solution = least_squares(jacobian[used], residual[used], spread)
            # far from any solution the linearisation says nothing: no parameter moves by more than its spread
            increments.append(solution.step / max(1.0, float(np.max(np.abs(solution.step) / spread))))
            values = values + increments[-1]
            if solution.negligible(FLOOR * spread):
                break
    residual, jacobian, sigma = sphere.whitened(values, scatter)
    solution = least_squares(jacobian[used], residual[used], spread)
    if len(solution.null):
        return None
    leverage = np.einsum("im,mn,in->i", jacobian, solution.covariance, jacobian)
    # variance of a residual relative to that against the fit through all others; if these do not determine it, the
    # residual shows nothing
    free = np.where(used, np.maximum(1.0 - leverage, 0.0), 1.0 / (1.0 + leverage))
    shown = free > SHOWN
    free = np.where(shown, free, 1.0)
    alone, alone_u = np.where(used, residual / free, residual) * sigma, sigma / np.sqrt(free)
    z = np.where(shown, np.abs(alone) / alone_u, 0.0)
    out = np.where(used, sigmas(z, degrees, scatter > 0.0), z)
    if scatter > 0.0:
        out[~used] = as_normal(z[~used], degrees)
    by_modulus = -sphere.modulus_u * (solution.gain / sigma[used]).sum(axis=1)
    return EllipsoidFit(
        values=values,
        covariance=solution.covariance + np.outer(by_modulus, by_modulus) if sphere.noisy or degrees else None,
        by_modulus=by_modulus,
        noise_degrees=float(degrees) if scatter > 0.0 else np.inf,
        model=sphere.block.model(values),
        residual=residual * sigma,
        leverage=np.where(used, leverage, 0.0),
        leave_one_out=alone,
        leave_one_out_u=alone_u,
        sigmas=out,
        used=used,
        doubtful=(),
        chi_square=float((residual[used] ** 2).sum()),
        degrees=degrees,
        scatter=scatter,
        worst=None,
        increments=tuple(increments),
        converged=solution.negligible(FLOOR * spread),
    )


def _excess(square: Array, variance: Array, by_scatter: Array, scatter: float) -> float:
    """χ² of residuals less its mean of nine fewer than there are, with a scatter."""
    return float((square / (variance + scatter**2 * by_scatter)).sum()) - (len(square) - 9)


def _worst_position(sphere: _Sphere, found: EllipsoidFit | None, used: BoolArray) -> WorstPosition | None:
    """The worst of the used positions: that with the largest residual for its leverage, or, since a gross error bends
    the fit towards itself, that without which the algebraic fit through the others is best. None where nothing would
    check the fit through the others."""
    if used.sum() < 11:
        return None
    without, suspects = np.full(len(used), np.inf), set()
    if found is not None:
        far = np.where(1.0 - found.leverage > SHOWN, np.abs(found.leave_one_out) / found.leave_one_out_u, 0.0)
        suspects.add(int(np.argmax(np.where(used, far, -1.0))))
    if found is None or used.sum() <= _LEFT_OUT_EACH:
        without[used] = _rms_without_each(sphere.readings[used])
        suspects |= {int(np.argmin(without))} if np.isfinite(without).any() else set()
    judged = []
    for i in suspects:
        others = used & (np.arange(len(used)) != i)
        fit = _fitted(sphere, others)
        if fit is not None:
            ratio = scipy.special.fdtri(fit.degrees, fit.degrees, 1.0 - RIVAL_CHANCE)
            alike = np.isfinite(without) & others & (without**2 < ratio * without[i] ** 2)
            rivals = tuple(np.flatnonzero(alike).tolist())
            judged.append(WorstPosition(position=i, sigmas=float(fit.sigmas[i]), scatter=fit.scatter, rivals=rivals))
    return max(judged, key=lambda each: each.sigmas, default=None)


def _rms_without_each(readings: Array) -> Array:
    """Rms residual (N,) of the algebraic fit without each reading, in parts of the modulus; infinite without a fit."""
    numbers = np.arange(len(readings))
    without = np.array([readings[numbers != i] for i in numbers])
    found = fit_many(without)
    away = without - found.centre[:, None]
    length = np.sqrt(np.einsum("uni,uij,unj->un", away, found.shape, away))
    return np.where(found.found & found.determined, np.sqrt(((length - 1.0) ** 2).mean(axis=1)), np.inf)
