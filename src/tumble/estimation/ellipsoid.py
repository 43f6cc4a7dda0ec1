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

from dataclasses import dataclass, replace

import numpy as np

from tumble.brief import Brief
from tumble.errors import InputError
from tumble.estimation.estimate import SCATTER_PROBABILITY, Fit, Solution, chance_of, least_squares, scatter_of, sigmas
from tumble.estimation.gauss_newton import gauss_newton, negligible
from tumble.estimation.observability import Refusal, undetermined
from tumble.estimation.quadric import fit_many
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
        return Fit(chi_square=self.chi_square, degrees=float(self.degrees), scatter=self.scatter, scatter_unit=unit)


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
    used = np.ones(len(readings), dtype=bool)
    found = _found(task, used)
    worst = _worst_position(task, used, found) if blocks is None else None
    while worst is not None and worst.sigmas > bad_sigmas and not worst.rivals and _may_leave_out(used):
        used[worst.position] = False
        found = _found(task, used)
        worst = _worst_position(task, used, found)
    if found is None:
        reason = (
            f"the {len(used)} readings do not lie on an ellipsoid, with whichever of them left out: look for exchanged "
            "channels, clipped readings or a vector whose length changed"
        )
        return Refusal(reason=reason, null=np.empty((0, 9)))
    bad = worst is not None and worst.sigmas > bad_sigmas
    doubtful = (worst.position, *worst.rivals) if worst is not None and bad else ()
    finished = _finished(task, used, found, worst, modulus_u, unknown_noise=covariance is None, blocks=blocks)
    return replace(finished, doubtful=doubtful, sigmas=_raised(finished.sigmas, doubtful, worst))


def _may_leave_out(used: BoolArray) -> bool:
    return int((~used).sum()) < max(1, int(MOST_BAD * len(used)))


def _raised(each: Array, doubtful: tuple[int, ...], worst: WorstPosition | None) -> Array:
    """Sigmas of the positions where those of the doubtful ones are not less than that of the worst."""
    out = each.copy()
    if worst is not None and doubtful:
        out[list(doubtful)] = np.maximum(out[list(doubtful)], worst.sigmas)
    return out


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Task:
    readings: Array
    modulus: float
    covariance: Array
    block: Block

    @property
    def spread(self) -> Array:
        return np.asarray(SPREAD * np.repeat([self.modulus, 1.0, 1.0], 3))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _EllipsoidRows:
    """Of each reading: the residual |t| − m, minus its derivatives with respect to the values (N, 9), its variance
    from noise, and what a unit variance of scatter adds."""

    residual: Array
    jacobian: Array
    noise: Array
    by_scatter: Array

    def solution(self, used: BoolArray, scatter: float, spread: Array) -> Solution:
        sigma = self.sigma(scatter)[used]
        return least_squares(self.jacobian[used] / sigma[:, None], self.residual[used] / sigma, spread)

    def sigma(self, scatter: float) -> Array:
        return np.sqrt(self.noise + scatter**2 * self.by_scatter)


def _rows(task: _Task, values: Array) -> _EllipsoidRows:
    model = task.block.model(values)
    true = model.apply(task.readings)
    length = np.linalg.norm(true, axis=1)
    normal = (true / length[:, None]) @ model.inverse()
    homogeneous = np.concatenate([true, np.ones((len(true), 1))], axis=1)
    return _EllipsoidRows(
        residual=length - task.modulus,
        jacobian=np.einsum("ip,pqm,iq->im", normal, task.block.jacobian(values), homogeneous),
        noise=np.einsum("ip,ipq,iq->i", normal, task.covariance, normal),
        by_scatter=np.einsum("ip,ip->i", normal, normal),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Found:
    values: Array
    rows: _EllipsoidRows
    solution: Solution
    chi_square: float
    degrees: int
    scatter: float
    increments: tuple[Array, ...]


def _found(task: _Task, used: BoolArray) -> _Found | None:
    """The geometric fit through the used readings with the scatter that explains its residuals; None where the
    algebraic fit finds no ellipsoid to start from, or where what it finds is not determined."""
    start = _algebraic(task, used)
    if start is None:
        return None
    scatter, degrees = 0.0, int(used.sum()) - 9
    values, rows, increments = _iterated(task, start, used, scatter)
    if degrees > 0 and chance_of(_chi_square(rows, used, scatter), degrees) < SCATTER_PROBABILITY:
        for _ in range(3):
            size = float(np.sqrt(np.mean(rows.residual[used] ** 2 / rows.by_scatter[used])))

            def excess(trial: float, at: _EllipsoidRows = rows) -> float:
                return _chi_square(at, used, trial) - degrees

            scatter = scatter_of(excess, size)
            values, rows, more = _iterated(task, values, used, scatter)
            increments += more
    solution = rows.solution(used, scatter, task.spread)
    if len(solution.null):
        return None
    chi_square = _chi_square(rows, used, scatter)
    return _Found(
        values=values,
        rows=rows,
        solution=solution,
        chi_square=chi_square,
        degrees=degrees,
        scatter=scatter,
        increments=(start, *increments),
    )


def _algebraic(task: _Task, used: BoolArray) -> Array | None:
    """Parameter values of the algebraic fit."""
    found = fit_many(task.readings[None, used])
    if not found.found[0]:
        return None
    some = found.models(task.modulus)
    handed = np.diag([1.0, 1.0, np.sign(np.linalg.det(task.block.axes))])
    own, _ = to_accelerometer_frame(task.block, SensorModel(matrix=some.matrix[0] @ handed, bias=some.bias[0]), None)
    return np.asarray(task.block.parameters(own))


def _iterated(
    task: _Task, values: Array, used: BoolArray, scatter: float
) -> tuple[Array, _EllipsoidRows, tuple[Array, ...]]:
    """Gauss–Newton at a given scatter."""
    values, increments = gauss_newton(
        lambda at: _rows(task, at).solution(used, scatter, task.spread), values, task.spread, FLOOR * task.spread
    )
    return values, _rows(task, values), increments


def _chi_square(rows: _EllipsoidRows, used: BoolArray, scatter: float) -> float:
    """Of the residuals of a fit that has converged."""
    return float(np.sum((rows.residual[used] / rows.sigma(scatter)[used]) ** 2))


def _finished(
    task: _Task,
    used: BoolArray,
    found: _Found,
    worst: WorstPosition | None,
    modulus_u: float,
    *,
    unknown_noise: bool,
    blocks: IntArray | None,
) -> EllipsoidFit:
    sigma, residual = found.rows.sigma(found.scatter), found.rows.residual
    whitened = found.rows.jacobian / sigma[:, None]
    leverage = np.einsum("im,mn,in->i", whitened, found.solution.covariance, whitened)
    free = np.where(used, np.maximum(1.0 - leverage, 0.0), 1.0 / (1.0 + leverage))
    told = free > 1e-6  # a position that the others do not determine shows no residual
    leave_one_out = np.where(used & told, residual / np.where(told, free, 1.0), residual)
    judged = np.where(told, residual / (sigma * np.sqrt(np.where(told, free, 1.0))), 0.0)
    judged[~used] = residual[~used] / (sigma[~used] * np.sqrt(1.0 + leverage[~used]))
    out = np.empty(len(used))
    out[used] = sigmas(judged[used], found.degrees, found.scatter > 0.0)
    out[~used] = [_predicted_sigmas(found, int(i)) for i in np.flatnonzero(~used)]
    covariance, degrees = found.solution.covariance, float(found.degrees) if found.scatter > 0.0 else np.inf
    if blocks is not None:
        covariance, degrees = _jackknife(whitened, residual / sigma, blocks, task.spread), float(blocks.max())
        modulus_u = float(np.hypot(modulus_u, found.scatter**2 / task.modulus))
    by_modulus = -modulus_u * (found.solution.gain / sigma[used]).sum(axis=1)
    covariance = covariance + np.outer(by_modulus, by_modulus)
    return EllipsoidFit(
        values=found.values,
        covariance=None if unknown_noise and found.degrees == 0 else covariance,
        by_modulus=by_modulus,
        noise_degrees=degrees,
        model=task.block.model(found.values),
        residual=residual,
        leverage=np.where(used, leverage, 0.0),
        leave_one_out=leave_one_out,
        leave_one_out_u=sigma / np.sqrt(np.where(told, free, 1.0)),
        sigmas=out,
        used=used,
        doubtful=(),
        chi_square=found.chi_square,
        degrees=found.degrees,
        scatter=found.scatter,
        worst=worst,
        increments=found.increments,
        converged=negligible(found.solution, FLOOR * task.spread),
    )


def _jackknife(whitened: Array, residual: Array, blocks: IntArray, spread: Array) -> Array:
    """Covariance (9, 9) of the module docstring, of rows (N, 9) and residuals (N,) in units of their noise."""
    scaled = whitened * spread
    normal, B = scaled.T @ scaled, int(blocks.max()) + 1
    change = np.empty((B, scaled.shape[1]))
    for b in range(B):
        J = scaled[blocks == b]
        change[b] = -spread * np.linalg.solve(normal - J.T @ J, J.T @ residual[blocks == b])
    away = change - change.mean(axis=0)
    return np.asarray((B - 1.0) / B * away.T @ away)


# -------------------- bad positions --------------------


def _worst_position(task: _Task, used: BoolArray, found: _Found | None) -> WorstPosition | None:
    """The worst of the used positions: that with the largest residual for its leverage, or, since a gross error bends
    the fit towards itself, that without which the algebraic fit through the others is best. None where nothing would
    check the fit through the others."""
    if used.sum() < 11:
        return None
    numbers = np.flatnonzero(used)
    without = np.full(len(used), np.inf)
    suspects = set()
    if found is not None:
        suspects.add(int(numbers[np.argmax(_studentised(found, used))]))
    if found is None or len(numbers) <= _LEFT_OUT_EACH:
        without[used] = _rms_without_each(task.readings[used])
        suspects |= {int(np.argmin(without))} if np.isfinite(without).any() else set()
    judged = [each for i in suspects if (each := _judged(task, used, i, without)) is not None]
    return max(judged, key=lambda each: each.sigmas, default=None)


def _judged(task: _Task, used: BoolArray, i: int, without: Array) -> WorstPosition | None:
    from scipy.special import fdtri

    others = used.copy()
    others[i] = False
    found = _found(task, others)
    if found is None:
        return None
    ratio = fdtri(found.degrees, found.degrees, 1.0 - RIVAL_CHANCE)
    alike = np.isfinite(without) & others & (without**2 < ratio * without[i] ** 2)
    rivals = tuple(np.flatnonzero(alike).tolist())
    return WorstPosition(position=i, sigmas=_predicted_sigmas(found, i), scatter=found.scatter, rivals=rivals)


def _studentised(found: _Found, used: BoolArray) -> Array:
    """Residuals of the used positions in units of their own standard uncertainties, but for a common factor."""
    jacobian, sigma = found.rows.jacobian[used], found.rows.sigma(found.scatter)[used]
    leverage = np.einsum("im,mn,in->i", jacobian, found.solution.covariance, jacobian) / sigma**2
    free = np.where(1.0 - leverage > 1e-6, 1.0 - leverage, np.inf)
    return np.asarray(np.abs(found.rows.residual[used]) / sigma / np.sqrt(free))


def _rms_without_each(readings: Array) -> Array:
    """Rms residual (N,) of the algebraic fit without each reading, in parts of the modulus; infinite without a fit."""
    numbers = np.arange(len(readings))
    without = np.array([readings[numbers != i] for i in numbers])
    found = fit_many(without)
    away = without - found.centre[:, None]
    length = np.sqrt(np.einsum("uni,uij,unj->un", away, found.shape, away))
    return np.where(found.found & found.determined, np.sqrt(((length - 1.0) ** 2).mean(axis=1)), np.inf)


def _predicted_sigmas(found: _Found, i: int) -> float:
    """How far reading i is from a fit in which it took no part, in Gaussian sigmas of equal probability."""
    from scipy.special import ndtri, stdtr

    row = found.rows.jacobian[i]
    variance = found.rows.sigma(found.scatter)[i] ** 2 + row @ found.solution.covariance @ row
    z = abs(float(found.rows.residual[i])) / float(np.sqrt(variance))
    if found.scatter == 0.0:
        return z
    return float(-ndtri(max(stdtr(found.degrees, -z), 1e-300)))
