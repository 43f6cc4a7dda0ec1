"""Fit of an estimate: chi-square by group of residuals, and outlying rests and turns.

The distance of a rest or turn from the fit is the fall of chi-square without it, with as many degrees of freedom as it
has residuals. A spoilt one must neither determine a parameter nor hide in the scatter that it causes. Therefore, if one
stands out, the maximum is found with residuals of a Student-t distribution of ν degrees of freedom, as a scale mixture:
the accelerometers of each rest, its gyros, and each turn have the weight

    w = (ν + q)/(ν + χ²)

with q residuals, updated at every linearisation, docs/explanation/mathematics.md (30). Those with a weight below
LEAST_WEIGHT are left out, and the estimate is that of all others with full weight.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy

from tumble.inference.estimate import Fit
from tumble.inference.noise import SCATTER_WORDS
from tumble.inference.normal_equations import Solution
from tumble.units import Array, BoolArray

MAGNETOMETER = "magnetometer"  # group of the readings of a magnetometer
# groups of residuals, with the kind of rows and the component of variance of each
GROUPS = {
    "accelerometers": ("accel", "accel"),
    "gyro rests": ("gyro", "gyro"),
    "gyro turns": ("turn", "turn"),
    "velocities of turns": ("turn", "velocity"),
    MAGNETOMETER: ("mag", "mag"),
}
JUDGED = "accel", "gyro", "turn", "mag"  # kinds of rows whose blocks may be outliers
TOTAL = "noise within rests"  # fit of all residuals without scatter
NU = 4.0  # ν: degrees of freedom of a robust fit
LEAST_WEIGHT = 0.1  # weight below which rows are left out
# Probability of the farthest of all rests and turns by chance, below which a robust fit is made. If one turn of
# fourteen spoils the scale of all, it is never beyond 3.9 sigmas.
OUTLIER_PROBABILITY = 0.1
OUTLIER_WEIGHT, DISTURBED_WEIGHT = 1e-6, 1e-12  # of rows left out; a magnetometer near steel errs by 1000 σ
INFORMATIVE_VARIANCE = 0.01  # variance of a residual, relative to its noise, below which a direction has no information
ROUNDING_VARIANCE = 1e-9  # variance, relative to the largest, below which a direction is rounding
LEAST_CHANCE = 1e-300

# By kind of rows in JUDGED: falls of chi-square (K,), and degrees of freedom (K,). For rows left out, the fall is the
# chi-square of their readings relative to the prediction by all others.
Falls = dict[str, tuple[Array, Array]]


def chi_square_falls(solution: Solution) -> Falls:
    """Return by how much chi-square falls without each block of rows.

    With its whitening W, whitened residual r of covariance C, p = Wᵀr and Q = WᵀCW, the fall is pᵀQ⁻¹p. Q⁻¹p is the
    difference of the readings from their prediction by all others, of covariance Q⁻¹ with the noise N = (WᵀW)⁻¹. That
    of a block of weight w is too large by 1/w, so that the covariance is Q⁻¹ − (1 − w) N."""
    out = Falls()
    for kind in (kind for kind in JUDGED if kind in solution.residuals):
        W, (residual, covariance) = solution.equations.whitening[kind], solution.residuals[kind]
        out[kind] = np.zeros(len(W)), np.zeros(len(W), dtype=np.int64)
        if not W.size:
            continue
        fall, count = out[kind]
        Wt = np.swapaxes(W, 1, 2)
        Q, N = Wt @ covariance @ W, np.linalg.inv(Wt @ W)
        size = np.sqrt(np.diagonal(N, axis1=1, axis2=2))
        p = (Wt @ residual[:, :, None])[:, :, 0] * size  # from here on in units of the noise
        variance, directions = np.linalg.eigh(Q * size[:, :, None] * size[:, None, :])
        informative = variance > INFORMATIVE_VARIANCE
        square = (p[:, None] @ directions)[:, 0] ** 2
        fall[:] = (square / np.where(informative, variance, np.inf)).sum(axis=1)
        count[:] = informative.sum(axis=1)
        weight = solution.linearisation.noise.rows[kind].weight
        if len(o := np.flatnonzero(weight < 1.0)):
            valid = variance[o] > ROUNDING_VARIANCE * variance[o].max(axis=1, keepdims=True)
            inverse, along = 1.0 / np.where(valid, variance[o], 1.0), directions[o] * valid[:, None]
            excess = (1.0 - weight[o])[:, None, None] * N[o] / size[o][:, :, None] / size[o][:, None, :]
            difference = inverse * (p[o][:, None] @ along)[:, 0]
            by_others = inverse[:, :, None] * np.eye(inverse.shape[1]) - np.swapaxes(along, 1, 2) @ excess @ along
            fall[o] = (difference * np.linalg.solve(by_others, difference[:, :, None])[:, :, 0]).sum(axis=1)
            count[o] = valid.sum(axis=1)
    return out


def student_weights(falls: Falls) -> dict[str, Array]:
    """Return the weights of a Student-t distribution, by kind of rows."""
    return {kind: np.minimum((NU + count) / (NU + fall), 1.0) for kind, (fall, count) in falls.items()}


def outlier_weights(outliers: Mapping[str, BoolArray]) -> dict[str, Array]:
    """Return weights that leave out the `outliers` (K,), by kind of rows."""
    least = {"mag": DISTURBED_WEIGHT}
    return {kind: np.where(out, least.get(kind, OUTLIER_WEIGHT), 1.0) for kind, out in outliers.items()}


def left_out(weights: Mapping[str, Array]) -> dict[str, BoolArray]:
    """Return True for blocks (K,) of rows with such weights that are left out, by kind of rows."""
    return {kind: weights[kind] < LEAST_WEIGHT for kind in JUDGED if kind in weights}


def sigmas(solution: Solution) -> dict[str, Array]:
    """Return distances (K,) from the fit, by kind of rows, as Gaussian sigmas of the same probability.

    The probability is that of Fisher's F, because the scale is estimated from all others."""
    fits, out = chi_squares(solution), dict[str, Array]()
    degrees = {kind: fits[name].degrees for name, (kind, scatter) in GROUPS.items() if name in fits and scatter == kind}
    omitted = left_out(solution.linearisation.noise.weights)
    for kind, (fall, count) in chi_square_falls(solution).items():
        k = np.maximum(count, 1)
        others = np.maximum(degrees.get(kind, 0.0) - k * max(1, omitted[kind].sum()), 1.0)
        chance = scipy.special.fdtrc(k, others, fall / k)
        out[kind] = 0.0 - scipy.special.ndtri(0.5 * np.maximum(chance, LEAST_CHANCE))
    return out


def chi_squares(solution: Solution) -> dict[str, Fit]:
    """Return the fit of every group of residuals, by name."""
    instrument, out = solution.problem.instrument, dict[str, Fit]()
    velocity = slice(3, 6 if instrument.in_velocities else 3)
    for name, (kind, component) in GROUPS.items():
        if kind not in solution.residuals or (kind == "turn" and instrument.gyro is None):
            continue
        residual, covariance = solution.residuals[kind]
        rows = np.arange(residual.shape[1])
        rows = rows[velocity] if component == "velocity" else np.delete(rows, velocity) if component == "turn" else rows
        if len(rows):
            out[name] = Fit(
                chi_square=float((residual[:, rows] ** 2).sum()),
                degrees=float(np.diagonal(covariance, axis1=1, axis2=2)[:, rows].sum()),
                scatter=float(getattr(solution.components, component)),
                unit=SCATTER_WORDS[component][0],
            )
    return out
