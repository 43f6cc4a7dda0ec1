"""The ellipsoid method: a triad whose readings all measure one vector of known length, in unknown orientations.

    y = M t + b,  |t| = m        so that  (y − b)ᵀ H (y − b) = 1,  H = (M Mᵀ)⁻¹/m²

N readings y (N, 3), in units of the true quantity after nominal scale and polarity, lie on an ellipsoid. Its centre is
the bias; its shape gives M Mᵀ, the lengths of the rows of M (scale factors) and the angles between them
(nonorthogonality). M itself is known up to a rotation, which is chosen so that M is in the accelerometer frame (see
`model`); nine parameters. Accelerometers at rest (m = g), magnetometers (m = the field) and gyros on a table that turns
at a constant rate (m = that rate) are the same problem.

The algebraic fit of Li & Griffiths gives the ellipsoid without a start (`quadric`).

Geometric fit: least squares on |M⁻¹(y − b)| − m with the covariances of the readings as weights, Gauss–Newton from the
algebraic fit. In programmes that surround the sphere it changes the values by a hundredth of their uncertainties; it is
there for weights, robustness and covariance.

Readings one after another of a triad that is waved about err alike in neighbours, by noise with a memory and by what
the model does not have, so that their number says nothing of u. Whole blocks of them are then left out in turn (the
jackknife):

    δ_b = −(Σ − Σ_b)⁻¹ J_bᵀ r_b,   Σ = Σ_b Σ_b = JᵀJ,      cov = (B − 1)/B Σ_b (δ_b − δ̄)(δ_b − δ̄)ᵀ

with B − 1 degrees of freedom; and what errs across the vector makes it longer by σ²/m, in u of the modulus.

The polarity of a channel is not in the data, since t and −t have the same length: it comes from the nominal scale or
from roughly known positions (`readings`).

Source: the ellipsoid method (calibration of a triaxial block of navigation accelerometers by ellipsoid fitting), whose
sign of Eq. (13), b = A u0, is lost in print. Jackknife: Efron (1982), The Jackknife, the Bootstrap and Other Resampling
Plans, ch. 3; by blocks Künsch (1989), The Annals of Statistics 17, 1217-1241.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import fdtri, ndtri, stdtr

from tumble.brief import Brief
from tumble.diagnosis.observability import Refusal, undetermined
from tumble.errors import InputError
from tumble.inference.estimate import Fit
from tumble.methods.least_squares import Solution, least_squares, sigmas, with_scatter
from tumble.methods.quadric import fit_many
from tumble.sensors.model import Block, SensorModel, to_accelerometer_frame
from tumble.units import Array, BoolArray, IntArray

TRIAD = Block(kind="accel", axes=np.eye(3))
"""Three sensors along X, Y, Z with the parameters bias, scale and the angles yx, zx, zy of their own frame."""

SPREAD = np.full(9, 10.0)
"""How far the parameters may be from nominal, biases in parts of the modulus: what is known worse than a tenth of it,
the modulus itself, is not determined. Positions that determine less are refused before."""

BAD_SIGMAS = 5.0
"""A position so far from the fit through all others is bad, unless stated otherwise: it is named and left out."""

FLOOR = 1e-13
"""Part of the modulus: no reading is taken to be better known, one without noise included."""

MOST_BAD = 0.2
"""Where more than this part of the positions is bad, none of them can be told from the good ones."""

RIVAL_CHANCE = 1e-3
"""Leaving out another position instead is as good an explanation where the variance of the others is then not larger by
more than chance makes it in this part of all cases."""

_LEFT_OUT_EACH = 50
"""Up to so many positions, each is left out in turn to find a bad one."""


@dataclass(frozen=True, kw_only=True, slots=True)
class WorstPosition:
    """The used position that is furthest, in `sigmas`, from the fit through all others, and the scatter of these; it
    need not be bad. Without one of the `rivals` the others fit about as well: if one is bad, the positions do not tell
    which. So it is with opposite edges of a cube where nothing but edges was taken."""

    position: int
    sigmas: float
    scatter: float
    rivals: tuple[int, ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class EllipsoidFit(Brief):
    """Parameter values (9,) in the order of the block's names with their covariance (9, 9), None where there are no
    more positions than unknowns and the noise is not known, and the `model` they give. In the covariance is what one
    standard uncertainty of the modulus changes, `by_modulus` (9,); behind the rest of it stand `noise_degrees` of
    freedom, infinite where the noise is known. Of each position (N,):
    `residual` |M⁻¹(y − b)| − m; its `leverage`, the part of itself that it explains; `leave_one_out`, the residual
    against the fit through all others, with its standard uncertainty; `sigmas`, how far that is out; and whether it
    was `used`, or left out as bad. `doubtful` are positions one of which is bad where it cannot be told which; they are
    used. `scatter` is that of a reading, estimated on top of the stated noise."""

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
    blocks: IntArray | None = None,
) -> EllipsoidFit | Refusal:
    """The parameters of a triad from readings (N, 3) of a vector of length `modulus` in N unknown orientations, in
    the unit of the modulus after nominal scale and polarity, in the frame that `block` fixes.

    `covariance` (N, 3, 3) is what is known of their noise; a scatter is estimated on top of it. Without it all are
    equally good. A position more than `bad_sigmas` from the fit through the others is left out, and says so. Where the
    readings are samples one after another, `blocks` (N,) are the numbers, from 0, of the blocks they are judged by.

    >>> import numpy as np, tumble
    >>> faces = np.vstack([np.eye(3), -np.eye(3)])
    >>> corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3.0)
    >>> found = tumble.fit_ellipsoid(9.8 * np.vstack([faces, corners]) + [0.1, 0.05, -0.2], modulus=9.8)
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
    task = _Task(
        readings=readings,
        modulus=modulus,
        covariance=np.broadcast_to(noise + (FLOOR * modulus) ** 2 * np.eye(3), (len(readings), 3, 3)),
        block=block,
    )
    found = _fitted(task, np.ones(len(readings), dtype=bool))
    worst = _worst_position(task, found) if blocks is None else None
    while worst is not None and worst.sigmas > bad_sigmas and not worst.rivals:
        if (~found.used).sum() + 1 > max(1, int(MOST_BAD * len(readings))):
            break
        used = found.used.copy()
        used[worst.position] = False
        found = _fitted(task, used)
        worst = _worst_position(task, found)
    solution = found.solution
    if solution is None:
        reason = (
            f"the {len(readings)} readings do not lie on an ellipsoid, with whichever of them left out: look for "
            "exchanged channels, clipped readings or a vector whose length changed"
        )
        return Refusal(reason=reason, null=np.empty((0, 9)))
    doubtful = (worst.position, *worst.rivals) if worst is not None and worst.sigmas > bad_sigmas else ()
    out = found.sigmas
    if worst is not None:
        out[list(doubtful)] = np.maximum(out[list(doubtful)], worst.sigmas)
    noise_covariance, noise_degrees = solution.covariance, float(found.degrees) if found.scatter > 0.0 else np.inf
    if blocks is not None:
        noise_covariance, noise_degrees = _jackknife(found, blocks, task.spread), float(blocks.max())
        modulus_u = float(np.hypot(modulus_u, found.scatter**2 / modulus))
    by_modulus = -modulus_u * (solution.gain / found.sigma[found.used]).sum(axis=1)
    return EllipsoidFit(
        values=found.values,
        covariance=None
        if covariance is None and found.degrees == 0
        else noise_covariance + np.outer(by_modulus, by_modulus),
        by_modulus=by_modulus,
        noise_degrees=noise_degrees,
        model=block.model(found.values),
        residual=found.residual,
        leverage=np.where(found.used, found.leverage, 0.0),
        leave_one_out=found.leave_one_out,
        leave_one_out_u=found.leave_one_out_u,
        sigmas=out,
        used=found.used,
        doubtful=doubtful,
        chi_square=found.chi_square(found.scatter),
        degrees=found.degrees,
        scatter=found.scatter,
        worst=worst,
        increments=found.increments,
        converged=solution.negligible(FLOOR * task.spread),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Task:
    readings: Array
    modulus: float
    covariance: Array
    block: Block

    @property
    def spread(self) -> Array:
        return np.asarray(SPREAD * np.repeat([self.modulus, 1.0, 1.0], 3))

    def start(self, used: BoolArray) -> Array | None:
        """Parameter values of the algebraic fit; None where there is none."""
        found = fit_many(self.readings[None, used])
        if not found.found[0]:
            return None
        some = found.models(self.modulus)
        handed = np.diag([1.0, 1.0, np.sign(np.linalg.det(self.block.axes))])
        own, _ = to_accelerometer_frame(
            self.block, SensorModel(matrix=some.matrix[0] @ handed, bias=some.bias[0]), None
        )
        return np.asarray(self.block.parameters(own))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Fitted:
    """Residuals |t| − m (N,) at `values`, minus their derivatives (N, 9), their variance from noise and what a unit
    variance of scatter adds; the step that the `used` determine, None where they do not."""

    values: Array
    used: BoolArray
    residual: Array
    jacobian: Array
    noise: Array
    by_scatter: Array
    scatter: float = 0.0
    increments: tuple[Array, ...] = ()
    solution: Solution | None = None

    @staticmethod
    def at(task: _Task, values: Array, used: BoolArray) -> _Fitted:
        """Linearised about values."""
        model = task.block.model(values)
        true = model.apply(task.readings)
        length = np.linalg.norm(true, axis=1)
        normal = (true / length[:, None]) @ model.inverse()
        homogeneous = np.concatenate([true, np.ones((len(true), 1))], axis=1)
        return _Fitted(
            values=values,
            used=used,
            residual=length - task.modulus,
            jacobian=np.einsum("ip,pqm,iq->im", normal, task.block.jacobian(values), homogeneous),
            noise=np.einsum("ip,ipq,iq->i", normal, task.covariance, normal),
            by_scatter=np.einsum("ip,ip->i", normal, normal),
        )

    def step(self, scatter: float, spread: Array) -> Solution:
        sigma = np.sqrt(self.noise + scatter**2 * self.by_scatter)[self.used]
        return least_squares(self.jacobian[self.used] / sigma[:, None], self.residual[self.used] / sigma, spread)

    def chi_square(self, scatter: float) -> float:
        variance = self.noise + scatter**2 * self.by_scatter
        return float(np.sum(self.residual[self.used] ** 2 / variance[self.used]))

    @property
    def degrees(self) -> int:
        return int(self.used.sum()) - 9

    @cached_property
    def sigma(self) -> Array:
        """Standard deviations (N,) of the residuals, scatter included."""
        return np.sqrt(self.noise + self.scatter**2 * self.by_scatter)

    @cached_property
    def leverage(self) -> Array:
        """Variances (N,) of what the fit predicts, in parts of those of the residuals."""
        assert self.solution is not None
        whitened = self.jacobian / self.sigma[:, None]
        return np.asarray(np.einsum("im,mn,in->i", whitened, self.solution.covariance, whitened))

    @cached_property
    def free(self) -> Array:
        """The variance of a residual over that against the fit through all others; NaN of one that these do not
        determine, which shows nothing."""
        free = np.where(self.used, np.maximum(1.0 - self.leverage, 0.0), 1.0 / (1.0 + self.leverage))
        return np.where(free > 1e-6, free, np.nan)

    @property
    def leave_one_out(self) -> Array:
        """Residuals (N,) against the fit through all others."""
        return np.where(self.used & np.isfinite(self.free), self.residual / self.free, self.residual)

    @property
    def leave_one_out_u(self) -> Array:
        return np.asarray(self.sigma / np.sqrt(np.nan_to_num(self.free, nan=1.0)))

    @property
    def normalised(self) -> Array:
        """How far each position (N,) is from the fit through all others, in standard uncertainties."""
        return np.where(np.isnan(self.free), 0.0, np.abs(self.leave_one_out) / self.leave_one_out_u)

    @property
    def sigmas(self) -> Array:
        """The same in Gaussian sigmas of equal probability."""
        z, scaled = self.normalised, self.scatter > 0.0
        out = np.where(self.used, sigmas(z, self.degrees, scaled), z)
        if scaled:
            out[~self.used] = -ndtri(np.maximum(stdtr(self.degrees, -z[~self.used]), 1e-300))
        return out


def _fitted(task: _Task, used: BoolArray) -> _Fitted:
    """The geometric fit through the used readings with the scatter that explains its residuals; without a solution
    where the algebraic fit finds no ellipsoid to start from, or where what it finds is not determined."""
    start = task.start(used)
    if start is None:
        return _Fitted.at(task, np.zeros(9), used)

    def agreement_at(values: Array) -> tuple[Callable[[float], float], float, float]:
        at = _Fitted.at(task, values, used)
        return at.chi_square, at.degrees, float(np.sqrt(np.mean(at.residual[used] ** 2 / at.by_scatter[used])))

    values, scatter, steps = with_scatter(
        lambda at, scatter: _Fitted.at(task, at, used).step(scatter, task.spread),
        agreement_at,
        start,
        task.spread,
        FLOOR * task.spread,
    )
    found = _Fitted.at(task, values, used)
    solution = found.step(scatter, task.spread)
    determined = not len(solution.null)
    return replace(found, scatter=scatter, increments=(start, *steps), solution=solution if determined else None)


def _jackknife(found: _Fitted, blocks: IntArray, spread: Array) -> Array:
    """Covariance (9, 9) of the module docstring, of samples judged by blocks."""
    scaled, residual = found.jacobian / found.sigma[:, None] * spread, found.residual / found.sigma
    normal, B = scaled.T @ scaled, int(blocks.max()) + 1
    change = np.empty((B, scaled.shape[1]))
    for b in range(B):
        J = scaled[blocks == b]
        change[b] = -spread * np.linalg.solve(normal - J.T @ J, J.T @ residual[blocks == b])
    away = change - change.mean(axis=0)
    return np.asarray((B - 1.0) / B * away.T @ away)


def _worst_position(task: _Task, found: _Fitted) -> WorstPosition | None:
    """The worst of the used positions: that with the largest residual for its leverage, or, since a gross error bends
    the fit towards itself, that without which the algebraic fit through the others is best. None where nothing would
    check the fit through the others."""
    used = found.used
    if used.sum() < 11:
        return None
    without, suspects = np.full(len(used), np.inf), set()
    if found.solution is not None:
        suspects.add(int(np.argmax(np.where(used, found.normalised, -1.0))))
    if found.solution is None or used.sum() <= _LEFT_OUT_EACH:
        without[used] = _rms_without_each(task.readings[used])
        suspects |= {int(np.argmin(without))} if np.isfinite(without).any() else set()
    judged = []
    for i in suspects:
        others = used & (np.arange(len(used)) != i)
        left = _fitted(task, others)
        if left.solution is not None:
            ratio = fdtri(left.degrees, left.degrees, 1.0 - RIVAL_CHANCE)
            alike = np.isfinite(without) & others & (without**2 < ratio * without[i] ** 2)
            rivals = tuple(np.flatnonzero(alike).tolist())
            judged.append(WorstPosition(position=i, sigmas=float(left.sigmas[i]), scatter=left.scatter, rivals=rivals))
    return max(judged, key=lambda each: each.sigmas, default=None)


def _rms_without_each(readings: Array) -> Array:
    """Rms residual (N,) of the algebraic fit without each reading, in parts of the modulus; infinite without a fit."""
    numbers = np.arange(len(readings))
    without = np.array([readings[numbers != i] for i in numbers])
    found = fit_many(without)
    away = without - found.centre[:, None]
    length = np.sqrt(np.einsum("uni,uij,unj->un", away, found.shape, away))
    return np.where(found.found & found.determined, np.sqrt(((length - 1.0) ** 2).mean(axis=1)), np.inf)
