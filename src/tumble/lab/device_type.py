"""Distribution of the units of a device type (normal hierarchical model), used as the prior of the next unit.

The calibration of unit i has the estimate x with covariance C, from which the precisions P of its priors about zero are
removed, so that no evidence counts twice:

    Λ_i = C⁻¹ − P,   h_i = Λ_i x + P x                                                                          (1)

Units differ from the mean of their type by d_i ~ N(0, B), B = diag(b), with b common to the parameters of a group. With
W_i = (1 + Λ_i B)⁻¹ Λ_i and w_i = (1 + Λ_i B)⁻¹ h_i, the mean and its covariance are

    M = (P₀ + Σ W_i)⁻¹,   μ = M Σ w_i                                                                           (2)

where P₀ is the precision of the grade's prior less b: a combination of parameters that no recording determines, such as
bias and K₂ at rest, stays unknown for any number of units. The variances b maximise the restricted likelihood (REML) by
the iteration

    b ← b √(Σ q²/Σ p),   q = w_i − W_i μ,   p = diag(W_i − W_i M W_i)                                           (3)

with sums over all units and the parameters of a group. A parameter that differs more than the others of its group gets
its own b, by (3) once without the root. The standard error √(2/Σ p²) is added to every b, and the prior of the grade
bounds it, since b is itself uncertain with few or short recordings. The prior of the next unit is N(μ, M + B), with
Σ b p degrees of freedom. Where units were calibrated as means of several launches, the variance between launches is
added.

Each unit counts once, by its latest calibration. Calibrations with a prior by the type are not used.

Sources: Patterson & Thompson, Biometrika 58 (1971) 545 (REML); Zhou et al., J. Comput. Graph. Stat. 28 (2019) 350,
the iteration (3); Laird & Ware, Biometrics 38 (1982) 963, the model.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tumble.inference.prior import DevicePrior, symmetric_inverse
from tumble.result.calibration import Calibration
from tumble.result.launch_variances import LaunchVariances, launch_variances
from tumble.result.parts import Parameter
from tumble.sensors.parameters import Variable, limits_of, positions_by_group, to_temperature, variable_of
from tumble.units import Array

MIN_UNITS = 3  # the variance of two units would have one degree of freedom
MAX_ITERATIONS = 300
TOLERANCE = 1e-3  # relative change of b at which the iteration ends
MIN_LEARNED = 0.05  # least reduction, relative, of a prior variance by a recording that counts as an estimate

_NOT_OF_DEVICE: tuple[Variable, ...] = ("time", "launch", "lag")
"""Variables of parameters that are not a property of a device, or are not normally distributed (lags)."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Unit:
    """Information on the m parameters of one unit by its calibration, Eq. (1).

    `information` is Λ (m, m) and `shift` h (m,), SI; `usual` the precisions (m,) without a recording: of the priors, or
    of the limits of the values; `reference` the temperature in °C to which the parameters refer, None if it is not
    known; `in_run` the standard deviations of the in-run biases of "accel" and "gyro", SI; `launches` the variances
    between launches, if the calibration is the mean of several."""

    serial: str
    names: tuple[str, ...]
    information: Array
    shift: Array
    usual: Array
    reference: float | None = None
    in_run: Mapping[str, float]
    launches: LaunchVariances | None = None

    def at(self, reference: float | None) -> Unit:
        """Return the information at another temperature in °C, by slopes and curvatures."""
        if reference is None or self.reference is None:
            return self
        back = to_temperature(self.names, self.reference - reference)
        information = back.T @ self.information @ back
        return replace(self, information=information, shift=back.T @ self.shift, reference=reference)

    def estimates(self) -> dict[str, tuple[float, float]]:
        """Return value and variance, SI, of each parameter without its own prior but with the priors of the others."""
        covariance = symmetric_inverse(self.information + np.diag(self.usual))
        values, variances = covariance @ self.shift, np.diag(covariance)
        precision = 1.0 / variances - self.usual
        return {
            name: (float(values[i] / variances[i] / precision[i]), float(1.0 / precision[i]))
            for i, name in enumerate(self.names)
            if precision[i] * variances[i] > MIN_LEARNED
        }


def unit_of(calibration: Calibration) -> Unit | None:
    """Return the information of a calibration, in the frame `accelerometer`; None without a covariance or if it has a
    prior by the type."""
    framed = calibration.in_frame("accelerometer")
    if calibration.provenance.prior is not None or framed.covariance is None:
        return None
    sizes = {h.name: h.value for h in calibration.evidence.hyperparameters}
    return unit_of_parameters(
        framed.parameters,
        framed.covariance,
        serial=calibration.serial,
        in_run={kind: sizes[f"{kind}_in_run"] for kind in ("accel", "gyro") if f"{kind}_in_run" in sizes},
        reference=calibration.reference_temperature,
        launches=launch_variances(calibration),
    )


def unit_of_parameters(
    parameters: Sequence[Parameter],
    covariance: Array,
    *,
    serial: str,
    in_run: Mapping[str, float],
    reference: float | None = None,
    launches: LaunchVariances | None = None,
) -> Unit:
    """Return the information, Eq. (1), on those of the parameters that are properties of the device."""
    kept = [i for i, p in enumerate(parameters) if p.u and variable_of(p.name) not in _NOT_OF_DEVICE]
    parameters, C = [parameters[i] for i in kept], covariance[np.ix_(kept, kept)]
    values = np.array([p.value for p in parameters])
    prior = np.array([0.0 if p.prior is None else p.prior**-2 for p in parameters])
    root = np.linalg.cholesky(C)
    share, axes = np.linalg.eigh(root.T @ (prior[:, None] * root))  # share of P in C⁻¹, usually at most 1
    directions = np.linalg.solve(root.T, axes)
    information = (directions * np.clip(1.0 - share, 0.0, None)) @ directions.T
    return Unit(
        serial=serial,
        names=tuple(p.name for p in parameters),
        information=information,
        shift=information @ values + prior * values,
        usual=np.where(prior > 0.0, prior, limits_of(p.name for p in parameters) ** -2.0),
        reference=reference,
        in_run=in_run,
        launches=launches,
    )


def in_run_sizes(units: Sequence[Unit], kind: str) -> Array:
    """Return the standard deviations of the in-run biases of the accelerometers or gyros of units, SI."""
    return np.array([unit.in_run[kind] for unit in units if unit.in_run.get(kind, 0.0) > 0.0])


def mean_temperature(units: Sequence[Unit]) -> float | None:
    """Return the mean of the reference temperatures of units, °C; None if none is known."""
    references = [unit.reference for unit in units if unit.reference is not None]
    return float(np.mean(references)) if references else None


def run_to_run(units: Sequence[Unit], name: str) -> float | None:
    """Return the standard deviation of a parameter between launches, SI; None if no unit has several."""
    launches = [u.launches for u in units if u.launches is not None and name in u.launches.variances]
    degrees = sum(each.degrees for each in launches)
    return float(np.sqrt(sum(e.degrees * e.variances[name] for e in launches) / degrees)) if degrees else None


def prior_of(units: Sequence[Unit], model: str) -> DevicePrior:
    """Return the prior of another unit of a type, called `model` in messages, from other units (module docstring).

    It has the parameters of at least MIN_UNITS units for which it is narrower than the prior of the grade, if any."""
    words = f"{len(units)} other units of the type {model!r}"
    if len(units) < MIN_UNITS:
        nothing, words = np.zeros(0), f"{words}, fewer than {MIN_UNITS}"
        return DevicePrior(words=words, names=(), mean=nothing, covariance=np.zeros((0, 0)), degrees=nothing)
    reference = mean_temperature(units)
    units = [unit.at(reference) for unit in units]
    counts = Counter(name for unit in units for name in unit.names)
    names = tuple(name for name in counts if counts[name] >= MIN_UNITS)
    usual = [[u.usual[u.names.index(name)] for u in units if name in u.names] for name in names]
    size = np.array([min(each) for each in usual]) ** -0.5  # parameters in units of their usual sizes
    marginals = [_marginal(unit, names) for unit in units]
    information = np.array([each * np.outer(size, size) for each, _ in marginals])
    shift = np.array([each * size for _, each in marginals])

    groups = list(positions_by_group(names).values())
    b = np.full(len(names), 0.1)  # in units of the variances of the grade, which bound it
    for _ in range(MAX_ITERATIONS):
        _, _, q, p = _mean(information, shift, b)
        before = b.copy()
        for members in groups:
            b[members] *= np.sqrt((q[:, members] ** 2).sum() / max(p[:, members].sum(), 1e-300))
        b = np.clip(b, 1e-14, 1.0)
        if np.all(np.abs(b - before) < TOLERANCE * before):
            break
    _, _, q, p = _mean(information, shift, b)
    b = np.maximum(b, b * (q**2).sum(axis=0) / np.maximum(p.sum(axis=0), 1e-300))
    error, degrees = np.zeros(len(b)), np.zeros(len(b))
    for members in groups:
        error[members] = np.sqrt(2.0 / max((p[:, members] ** 2).sum(), 1e-300))
        degrees[members] = (b[members] * p[:, members]).sum()
    b = np.minimum(b + error, 1.0)
    mean, M, _, _ = _mean(information, shift, b)

    launches = np.array([(run_to_run(units, name) or 0.0) ** 2 for name in names])
    covariance = (M + np.diag(b)) * np.outer(size, size) + np.diag(launches)
    kept = np.flatnonzero(np.diag(covariance) < [1.0 / max(each) for each in usual])  # better than the grade
    sizes = {kind: in_run_sizes(units, kind) for kind in ("accel", "gyro")}
    return DevicePrior(
        words=words,
        names=tuple(names[i] for i in kept),
        mean=(mean * size)[kept],
        covariance=covariance[np.ix_(kept, kept)],
        degrees=degrees[kept],
        reference=reference,
        in_run={kind: float(np.exp(np.log(s).mean())) for kind, s in sizes.items() if len(s) >= MIN_UNITS},
    )


def _marginal(unit: Unit, names: Sequence[str]) -> tuple[Array, Array]:
    """Return information (n, n) and shift (n,) on the parameters `names`; the others are eliminated with their
    priors."""
    rows = [i for i, name in enumerate(names) if name in unit.names]
    kept = [unit.names.index(names[i]) for i in rows]
    others = [i for i in range(len(unit.names)) if i not in kept]
    gain = unit.information[np.ix_(kept, others)] @ symmetric_inverse(
        unit.information[np.ix_(others, others)] + np.diag(unit.usual[others])
    )
    information, shift = np.zeros((len(names), len(names))), np.zeros(len(names))
    information[np.ix_(rows, rows)] = (
        unit.information[np.ix_(kept, kept)] - gain @ unit.information[np.ix_(others, kept)]
    )
    shift[rows] = unit.shift[kept] - gain @ unit.shift[others]
    return information, shift


def _mean(information: Array, shift: Array, b: Array) -> tuple[Array, Array, Array, Array]:
    """Return μ (m,) and M (m, m) by Eq. (2), and q and p (n, m) of Eq. (3), of units (n, m, m), (n, m)."""
    one = np.eye(len(b))
    W = np.linalg.solve(one + information * b, information)
    w = np.linalg.solve(one + information * b, shift[..., None])[..., 0]
    P0 = np.diag(
        1.0 / np.maximum(1.0 - b, 0.1)
    )  # at most ten times that of the grade, also where b is nearly all of it
    M = symmetric_inverse(P0 + W.sum(axis=0))
    mean = M @ w.sum(axis=0)
    p = np.diagonal(W, axis1=1, axis2=2) - np.einsum("ijk,kl,ilj->ij", W, M, W)
    return mean, M, w - W @ mean, np.maximum(p, 0.0)
