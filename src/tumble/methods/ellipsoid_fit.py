"""Calibration of a triad from readings of one vector of known length in unknown orientations.

    y = M t + b,  |t| = m        so that  (y − b)ᵀ H (y − b) = 1,  H = (M Mᵀ)⁻¹/m²        Eqs. (1), (6), (7)

N readings y (N, 3), in units of the true quantity after nominal scale and polarity, lie on an ellipsoid. Its centre is
the bias; its shape gives M Mᵀ, the lengths of the rows of M (scale factors) and the angles between them
(nonorthogonality). M is determined up to a rotation, which is chosen so that M is in the accelerometer frame. For
accelerometers at rest, m is g.

The algebraic fit of Li & Griffiths (`quadric`) needs no start. From it, the geometric fit minimises |M⁻¹(y − b)| − m by
Gauss–Newton, weighted by the covariances of the readings. In programmes that surround the sphere it changes the values
by a hundredth of their uncertainties; it adds weights, robustness and the covariance.

The polarity of a channel is not in the data, as t and −t have the same length. It comes from the nominal scale or from
roughly known positions (`tumble.run.readings_table`).

Source, with its equation numbers: the ellipsoid paper (calibration of a triaxial block of navigation accelerometers by
ellipsoid fitting). The sign of its Eq. (13), b = A u0, is lost in print.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy

from tumble.brief import Brief
from tumble.diagnosis.observability import Refusal, undetermined_by_positions
from tumble.errors import InputError
from tumble.inference.estimate import Fit
from tumble.methods.least_squares import (
    MAX_ITERATIONS,
    SCATTER_ROUNDS,
    fit_scatter,
    gaussian_sigmas,
    least_squares,
    needs_scatter,
    normal_score,
)
from tumble.methods.quadric import fit_many
from tumble.sensors.model import Block, SensorModel, to_accelerometer_frame
from tumble.units import Array, BoolArray

TRIAD = Block(kind="accel", axes=np.eye(3))  # parameters bias, scale and the angles yx, zx, zy of the sensor frame

SPREAD = np.full(9, 10.0)
"""Spreads of the parameters, biases relative to the modulus: a parameter is undetermined if its u exceeds a tenth of
it."""
BAD_SIGMAS = 5.0  # distance of a bad position from the fit through all others, by default
FLOOR = 1e-13  # least standard uncertainty of a reading, relative to the modulus
MOST_BAD = 0.2  # largest share of bad positions; beyond it, good and bad ones cannot be distinguished
RIVAL_P_VALUE = 1e-3
"""Two positions are rivals if the variances of the fits without one or the other differ by no more than chance does
with this probability."""
LEAST_REDUNDANCY = 1e-6  # part of the variance of a residual that remains after the fit; a smaller one shows no error
MOST_TRIED = 50  # up to this number of positions, each is left out in turn to find a bad one


@dataclass(frozen=True, kw_only=True, slots=True)
class WorstPosition:
    """The used position that is furthest from the fit through all others."""

    position: int
    sigmas: float  # distance from that fit
    scatter: float  # of the other positions
    rivals: tuple[int, ...]
    """Positions without which the others fit about as well, such as the opposite edge of a cube if only edges were
    taken: then the bad one is not known."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class EllipsoidFit(Brief):
    """Parameters of a triad by the ellipsoid through its readings."""

    values: Array  # (9,), in the order of the names of the block
    covariance: Array | None  # (9, 9); None if no noise is given and there are no more positions than unknowns
    by_modulus: Array  # (9,): change by one standard uncertainty of the modulus, which is part of the covariance
    noise_degrees: float  # degrees of freedom of the rest of the covariance, infinite if the noise is given
    model: SensorModel
    residual: Array  # (N,): |M⁻¹(y − b)| − m of each position
    leverage: Array  # (N,): part of its own residual that each position explains
    leave_one_out: Array  # (N,): residual against the fit through all others
    leave_one_out_u: Array
    sigmas: Array  # (N,): leave_one_out / leave_one_out_u as Gaussian sigmas
    used: BoolArray  # (N,): False for positions that are left out as bad
    doubtful: tuple[int, ...]  # positions of which one is bad, but it is not known which; they are used
    chi_square: float
    degrees: int
    scatter: float  # of a reading, in addition to the noise
    worst: WorstPosition | None
    increments: tuple[Array, ...]
    converged: bool

    def fit(self, unit: str) -> Fit:
        """Return chi-square and scatter as in a calibration; `unit` is that of the modulus."""
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
    """Calibrate a triad from readings of a vector of known length in unknown orientations.

    Parameters
    ----------
    readings : (N, 3) array
        Readings in the unit of the modulus, after nominal scale and polarity.
    modulus, modulus_u
        Length of the vector, and its standard uncertainty.
    covariance : (N, 3, 3) array, optional
        Covariance of the noise, beside which a scatter is estimated; by default all readings are equally good.
    block
        The sensors, whose frame the parameters have.
    bad_sigmas
        Distance from the fit through the others beyond which a position is left out.

    Returns
    -------
    EllipsoidFit or Refusal
        The fit, or why there is none.

    Raises
    ------
    InputError
        For readings or a modulus that are not finite.

    Examples
    --------
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
    refusal = undetermined_by_positions(readings, block=block)
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
        fit = _fit(sphere, used)
        worst = _worst_position(sphere, fit, used)
        bad = worst is not None and worst.sigmas > bad_sigmas
        most = max(1, int(MOST_BAD * len(readings)))
        if worst is None or not bad or worst.rivals or (~used).sum() + 1 > most:
            break
        used = used & (np.arange(len(readings)) != worst.position)
    if fit is None:
        reason = (
            f"the {len(readings)} readings do not lie on an ellipsoid, with whichever of them left out: look for "
            "exchanged channels, clipped readings or a vector whose length changed"
        )
        return Refusal(reason=reason, null=np.empty((0, 9)))
    sigmas = fit.sigmas
    doubtful = (worst.position, *worst.rivals) if worst is not None and bad else ()
    if worst is not None:
        sigmas[list(doubtful)] = np.maximum(sigmas[list(doubtful)], worst.sigmas)
    return replace(fit, worst=worst, doubtful=doubtful)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Sphere:
    """Arguments of `fit_ellipsoid`; `noisy` is whether the covariance of the readings is given."""

    readings: Array
    modulus: float
    modulus_u: float
    covariance: Array
    noisy: bool
    block: Block

    def start(self, used: BoolArray) -> Array | None:
        """Return the parameters (9,) of the algebraic fit; None if there is none."""
        algebraic = fit_many(self.readings[None, used])
        if not algebraic.found[0]:
            return None
        models = algebraic.models(self.modulus)
        handedness = np.diag([1.0, 1.0, np.sign(np.linalg.det(self.block.axes))])
        model = SensorModel(matrix=models.matrix[0] @ handedness, bias=models.bias[0])
        return np.asarray(self.block.parameters(to_accelerometer_frame(self.block, model, None)[0]))

    def rows(self, values: Array) -> tuple[Array, Array, Array, Array]:
        """Return residuals |M⁻¹(y − b)| − m (N,), minus their derivative (N, 9), their variance (N,) by noise, and the
        variance (N,) by a scatter of the readings of unit variance."""
        model = self.block.model(values)
        true = model.apply(self.readings)
        length = np.linalg.norm(true, axis=1)
        direction = true / length[:, None]
        normal = direction @ model.inverse()
        homogeneous = np.concatenate([self.modulus * direction, np.ones((len(direction), 1))], axis=1)
        jacobian = np.einsum("ip,pqm,iq->im", normal, self.block.jacobian(values), homogeneous)
        variance = np.einsum("ip,ipq,iq->i", normal, self.covariance, normal)
        return length - self.modulus, jacobian, variance, (normal**2).sum(axis=1)

    def excess_chi_square(self, values: Array, used: BoolArray) -> tuple[Callable[[float], float], float]:
        """Return χ² of the used residuals less its expectation, as a function of the scatter, and a first scatter."""
        residual, _, variance, by_scatter = (each[used] for each in self.rows(values))
        degrees = int(used.sum()) - 9

        def excess(scatter: float) -> float:
            return float((residual**2 / (variance + scatter**2 * by_scatter)).sum()) - degrees

        return excess, float(np.sqrt(np.mean(residual**2 / by_scatter)))

    def whitened(self, values: Array, scatter: float) -> tuple[Array, Array, Array]:
        """Return whitened residuals (N,), minus their derivative (N, 9), and standard uncertainties (N,)."""
        residual, jacobian, variance, by_scatter = self.rows(values)
        sigma = np.sqrt(variance + scatter**2 * by_scatter)
        return residual / sigma, jacobian / sigma[:, None], sigma


def _fit(sphere: _Sphere, used: BoolArray) -> EllipsoidFit | None:
    """Fit the used readings geometrically, with the scatter that explains their residuals.

    Return None if the algebraic fit finds no ellipsoid, or the readings do not determine the parameters."""
    values, degrees = sphere.start(used), int(used.sum()) - 9
    if values is None:
        return None
    spread = SPREAD * np.repeat([sphere.modulus, 1.0, 1.0], 3)
    scatter, increments = 0.0, [values]
    for scatter_round in range(1 + SCATTER_ROUNDS):
        if scatter_round:  # the first round is without scatter
            excess, size = sphere.excess_chi_square(values, used)
            if scatter_round == 1 and not needs_scatter(excess(0.0) + degrees, degrees):
                break
            scatter = fit_scatter(excess, size)
        for _ in range(MAX_ITERATIONS):
            residual, jacobian, _ = sphere.whitened(values, scatter)
            solution = least_squares(jacobian[used], residual[used], spread)
            # far from the solution the linearisation is poor: no parameter moves by more than its spread
            increments.append(solution.step / max(1.0, float(np.max(np.abs(solution.step) / spread))))
            values = values + increments[-1]
            if solution.is_negligible(FLOOR * spread):
                break
    residual, jacobian, sigma = sphere.whitened(values, scatter)
    solution = least_squares(jacobian[used], residual[used], spread)
    if len(solution.null):
        return None
    leverage = np.einsum("im,mn,in->i", jacobian, solution.covariance, jacobian)
    # variance of a residual relative to that against the fit through all others
    redundancy = np.where(used, np.maximum(1.0 - leverage, 0.0), 1.0 / (1.0 + leverage))
    checked = redundancy > LEAST_REDUNDANCY
    redundancy = np.where(checked, redundancy, 1.0)
    leave_one_out = np.where(used, residual / redundancy, residual) * sigma
    leave_one_out_u = sigma / np.sqrt(redundancy)
    z = np.where(checked, np.abs(leave_one_out) / leave_one_out_u, 0.0)
    sigmas = np.where(used, gaussian_sigmas(z, degrees, scatter > 0.0), z)
    if scatter > 0.0:
        sigmas[~used] = normal_score(z[~used], degrees)
    by_modulus = -sphere.modulus_u * (solution.gain / sigma[used]).sum(axis=1)
    return EllipsoidFit(
        values=values,
        covariance=solution.covariance + np.outer(by_modulus, by_modulus) if sphere.noisy or degrees else None,
        by_modulus=by_modulus,
        noise_degrees=float(degrees) if scatter > 0.0 else np.inf,
        model=sphere.block.model(values),
        residual=residual * sigma,
        leverage=np.where(used, leverage, 0.0),
        leave_one_out=leave_one_out,
        leave_one_out_u=leave_one_out_u,
        sigmas=sigmas,
        used=used,
        doubtful=(),
        chi_square=float((residual[used] ** 2).sum()),
        degrees=degrees,
        scatter=scatter,
        worst=None,
        increments=tuple(increments),
        converged=solution.is_negligible(FLOOR * spread),
    )


def _worst_position(sphere: _Sphere, fit: EllipsoidFit | None, used: BoolArray) -> WorstPosition | None:
    """Return the worst of the used positions; None if nothing would check the fit through the others.

    It has the largest residual for its leverage or, as a gross error bends the fit towards itself, is the one without
    which the algebraic fit through the others is best."""
    if used.sum() < 11:
        return None
    without, suspects = np.full(len(used), np.inf), set()
    if fit is not None:
        distance = np.abs(fit.leave_one_out) / fit.leave_one_out_u
        distance = np.where(1.0 - fit.leverage > LEAST_REDUNDANCY, distance, 0.0)
        suspects.add(int(np.argmax(np.where(used, distance, -1.0))))
    if fit is None or used.sum() <= MOST_TRIED:
        readings = sphere.readings[used]
        others = np.array([np.delete(readings, i, axis=0) for i in range(len(readings))])
        fits = fit_many(others)
        off = others - fits.centre[:, None]
        length = np.sqrt(np.einsum("uni,uij,unj->un", off, fits.shape, off))
        rms = np.sqrt(((length - 1.0) ** 2).mean(axis=1))  # relative to the modulus
        without[used] = np.where(fits.found & fits.determined, rms, np.inf)
        suspects |= {int(np.argmin(without))} if np.isfinite(without).any() else set()
    judged = []
    for i in suspects:
        rest = used & (np.arange(len(used)) != i)
        refit = _fit(sphere, rest)
        if refit is not None:
            ratio = scipy.special.fdtri(refit.degrees, refit.degrees, 1.0 - RIVAL_P_VALUE)
            alike = np.isfinite(without) & rest & (without**2 < ratio * without[i] ** 2)
            rivals = tuple(np.flatnonzero(alike).tolist())
            judged.append(
                WorstPosition(position=i, sigmas=float(refit.sigmas[i]), scatter=refit.scatter, rivals=rivals)
            )
    return max(judged, key=lambda each: each.sigmas, default=None)
