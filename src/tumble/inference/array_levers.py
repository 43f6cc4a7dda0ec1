"""Likelihood of the lever arms of an array of n ≥ 7 accelerometers from its motion, without attitudes.

Sensor p at r_p reads, with k_p its row of the sensitivity matrix,

    y_p = k_pᵀ (f + ω̇ × r_p + Ω² r_p) + own_p,     Ω² = ωωᵀ − |ω|² I                                            (12)

The force f and ω̇ are unknowns of every sample, so that only the n − 6 combinations N of y have information that are
orthogonal to H = [K, r × K]. Ω² is that of the rates (I + E) ω at t − τ, to second order in τ; the error E of the rates
and the delay τ of the accelerometers are unknowns. own_p are errors of a single sensor in motion that a calibration at
rest does not determine (bias, row of the matrix, square, delay), which are eliminated. The row of a sensor responds to
the whole acceleration at its place: on a flat board an angular acceleration acts on accelerometers in the plane of the
board through their height, 1 mm, and also through an error of their axes, 10⁻³ times 10 mm. The result is a likelihood
of lever arms, τ and E, from the moments of `tumble.reduction.turns.array_motion`. It does not depend on a translation
of all sensors of one direction, which changes only f, and determines the scale of all lever arms only as well as E;
turns determine both.

Differences of the rates from sample to sample are not used for ω̇: much of the angular acceleration of a shaken body is
faster than the samples, and its scale relative to the differences depends on how these are formed.

The noise variance is estimated from the residuals in each class of samples. Because the classes are formed by these
residuals, in n − 6 directions at once, the information is (1 − 2/(n − 6))² of that with known variances (Tyler 1987).

The equation is docs/explanation/mathematics.md (12).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.reduction.turns.array_motion import ArrayMoments
from tumble.rotation import skew
from tumble.sensors.instrument import Instrument
from tumble.sensors.parameters import PAIRS
from tumble.units import G_STANDARD, Array, IntArray

ROUNDS = 15  # largest number of linearisations
CONVERGED = 1e-7  # m: step of the lever arms
# Prior standard deviations of own_p: bias, m/s², row of the matrix, which is the same to 1 % in motion, square, s²/m,
# and delay, s.
OWN = np.array([0.05 * G_STANDARD, 0.01, 0.01, 0.01, 1e-3 / G_STANDARD, 0.01])
# The same for lever arms, m, delay, s, and E relative to that of the gyros, while the point of linearisation is found.
LEVER, DELAY, RATE_ERROR = 0.03, 0.02, 0.003
COMMON = 10  # number of unknowns common to all sensors: the delay and the nine of E
# m and s: least standard deviations of the place of a sensor and of the delay, because rates are interpolated by
# parabolas and real filters are not pure delays.
LEVER_FLOOR, DELAY_FLOOR = 5e-6, 5e-5
OUT_OF_RANGE = 1e-12  # eigenvalue of the information, relative to the largest, below which there is none
_FIRST, _SECOND = np.array(PAIRS).T
_PAIR = np.zeros((3, 3), dtype=np.int64)
_PAIR[_FIRST, _SECOND] = _PAIR[_SECOND, _FIRST] = np.arange(len(PAIRS))


_SQUARES = np.zeros((3, 3, 6))  # Ω²_ij as combinations of the products ω_k ω_l
_BY_RATE_ERROR = np.zeros((3, 3, 6, 6))  # ∂(ω_i ω_j)/∂E_kl as combinations of the products
for _i in range(3):
    _SQUARES[_i, np.arange(3), _PAIR[_i]] += 1.0
    _SQUARES[_i, _i, [0, 3, 5]] -= 1.0
    for _m, (_first, _second) in enumerate(PAIRS):
        _BY_RATE_ERROR[_first, _i, _m, _PAIR[_second, _i]] += 1.0
        _BY_RATE_ERROR[_second, _i, _m, _PAIR[_first, _i]] += 1.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ArrayLevers:
    """Likelihood of q: lever arms of all accelerometers but the last, in their order, mean delay, and E row by row.

    Its whitened residuals are `excess` (k,) − `root` (k, q) (q − `about`)."""

    about: Array
    root: Array
    excess: Array

    def rows(self, instrument: Instrument, values: Array) -> Array:
        """Return whitened rows [coefficients | residual] (k, m + 1) for parameters `values` (m,) of an instrument."""
        gyro, levers, delay = instrument.gyro, instrument.turn_only("lever"), instrument.turn_only("delay")
        single = instrument.turn_only("single delay")
        assert gyro is not None
        size = len(self.about)
        q, derivative, count = np.zeros(size), np.zeros((size, len(values))), size - COMMON
        if levers is not None:
            q[:count], derivative[:count, levers] = values[levers], np.eye(count)
        if delay is not None:
            q[count], derivative[count, delay] = instrument.delays(values).mean(), 1.0
        if single is not None:
            derivative[count, single] = 1.0 / instrument.accel.size
        gyro_places, to_rate = instrument.own(gyro), np.linalg.pinv(gyro.axes)
        error = _rate_error(instrument, values)
        right = np.eye(3) + error
        by_gyros = np.einsum("ik,kp,pbm,bj->ijm", right, to_rate, gyro.jacobian(values[gyro_places])[:, :3], right)
        q[count + 1 :], derivative[count + 1 :, gyro_places] = error.ravel(), -by_gyros.reshape(9, -1)
        return np.column_stack([self.root @ derivative, self.excess - self.root @ (q - self.about)])


def _rate_error(instrument: Instrument, values: Array) -> Array:
    """Return E (3, 3) of gyros with parameters (m,): the rates are (I + E) times those of nominal gyros."""
    assert instrument.gyro is not None
    read = np.linalg.pinv(instrument.gyro.axes) @ instrument.model(instrument.gyro, values).matrix
    return np.asarray(np.linalg.inv(read) - np.eye(3))


def array_levers(moments: ArrayMoments, instrument: Instrument, values: Array) -> ArrayLevers:
    """Return the likelihood of the lever arms, with the accelerometer sensitivities at parameters `values` (m,).

    With x the regressors of a sample, M = Σ x xᵀ weighted by the variances of the classes, and N the combinations
    orthogonal to force and ω̇, the residuals of all sensors are Nᵀ (y − Σ own a − Σ common b) x, where a are the
    unknowns of single sensors, lever arms last, and b are the delay and E. All of a but the lever arms are
    eliminated."""
    accel, K = instrument.accel, instrument.model(instrument.accel, values).matrix
    n, named, E = accel.size, accel.channels[:-1], _rate_error(instrument, values)  # all sensors but the last
    r, delay, variances = np.zeros((n, 3)), 0.0, np.ones(len(moments.counts))
    centre = np.concatenate([np.zeros(3 * n - 3), [delay], E.ravel()])
    precision = np.diag(np.concatenate([np.full(3 * n - 3, LEVER), [DELAY], np.full(9, RATE_ERROR)]) ** -2.0)
    s = len(OWN) + 3  # unknowns of a sensor
    places, own_precision = np.arange(n * s).reshape(n, s), np.diag(np.tile(OWN**-2.0, n))
    kept, eliminated = np.append(places[named, -3:].ravel(), n * s + np.arange(COMMON)), places[:, :-3].ravel()
    for _ in range(ROUNDS):
        # normal equations of all unknowns, with the variances of the round before
        readings, own, common, NNt = _linear(moments, K, r, delay, E)
        M = np.tensordot(1.0 / variances, moments.sums, axes=1)
        weighted, projected = own @ M, NNt @ common
        matrix, right = np.zeros((n * s + COMMON, n * s + COMMON)), np.zeros(n * s + COMMON)
        by_sensor = np.tensordot(weighted, own, axes=([2], [2])) * NNt[:, None, :, None]
        matrix[:-COMMON, :-COMMON] = by_sensor.reshape(n * s, n * s)
        matrix[:-COMMON, -COMMON:] = np.einsum("pac,epc->pae", weighted, projected).reshape(n * s, COMMON)
        matrix[-COMMON:, :-COMMON] = matrix[:-COMMON, -COMMON:].T
        matrix[-COMMON:, -COMMON:] = np.tensordot(common @ M, projected, axes=([1, 2], [1, 2]))
        right[:-COMMON] = np.einsum("pac,pc->pa", weighted, NNt @ readings).ravel()
        right[-COMMON:] = np.einsum("epc,pc->e", common @ M, NNt @ readings)
        normal, gradient, solved = _eliminate(matrix, right, kept, eliminated, own_precision)

        # step, and the variances of the classes by the residuals after it
        about = np.concatenate([r[named].ravel(), [delay], E.ravel()])
        step = np.linalg.solve(normal + precision, gradient - precision.diagonal() * (about - centre))
        levers = np.zeros((n, 3))
        levers[named] = step[:-COMMON].reshape(-1, 3)
        of_sensors = np.column_stack([(solved[:, -1] - solved[:, :-1] @ step).reshape(n, s - 3), levers])
        residual = readings - np.einsum("psc,ps->pc", own, of_sensors) - np.tensordot(step[-COMMON:], common, axes=1)
        squares = np.einsum("pc,bcd,pd->b", NNt @ residual, moments.sums, residual, optimize=True)
        degrees = np.maximum(moments.counts, 1.0) * np.trace(NNt)
        variances = np.where(moments.counts > 0.0, squares / degrees, 1.0)
        r, delay, E = r + levers, delay + step[-COMMON], E + step[1 - COMMON :].reshape(3, 3)
        if np.abs(step[:-COMMON]).max() < CONVERGED:
            break
    share = (1.0 - 2.0 / (n - 6)) ** 2
    # the floors added to the variances of delay and places, where levers, relative to the last, gain FLOOR² (I + 1 1ᵀ)
    floors = np.zeros((3 * n - 2, 3 * n - 2))
    floors[:-1, :-1] = np.kron(np.eye(n - 1) - 1.0 / n, np.eye(3)) / LEVER_FLOOR**2
    floors[-1, -1] = DELAY_FLOOR**-2.0
    normal, gradient, _ = _eliminate(
        share * normal, share * gradient, np.arange(len(step)), np.arange(3 * n - 2), floors
    )
    size, direction = np.linalg.eigh(normal)
    informative = size > OUT_OF_RANGE * size[-1]
    root = np.sqrt(size[informative])[:, None] * direction[:, informative].T
    excess = (direction[:, informative].T @ gradient) / np.sqrt(size[informative])
    return ArrayLevers(about=about, root=root, excess=excess)


def _eliminate(
    matrix: Array, right: Array, kept: IntArray, eliminated: IntArray, precision: Array
) -> tuple[Array, Array, Array]:
    """Eliminate unknowns (e,) of prior `precision` (e, e) from normal equations, whose `kept` unknowns (k,) remain.

    Returns matrix (k, k) and right-hand side (k,) of these, and [D | d] (e, k + 1): the others are d − D kept."""
    coupling = matrix[np.ix_(kept, eliminated)]
    solved = np.linalg.solve(
        matrix[np.ix_(eliminated, eliminated)] + precision,
        np.column_stack([matrix[np.ix_(eliminated, kept)], right[eliminated]]),
    )
    normal, gradient = matrix[np.ix_(kept, kept)] - coupling @ solved[:, :-1], right[kept] - coupling @ solved[:, -1]
    return normal, gradient, np.asarray(solved)


def _linear(moments: ArrayMoments, K: Array, r: Array, delay: float, E: Array) -> tuple[Array, Array, Array, Array]:
    """Return the rows of a sample as linear functions of its c regressors, about lever arms, delay and E.

    These are the residuals (n, c), the derivatives by the unknowns of each sensor (n, s, c) and by delay and E
    (10, n, c); and N Nᵀ (n, n). K and r are (n, 3), E is (3, 3)."""
    where, width, placed = moments.columns, moments.sums.shape[1], bool(np.any(r))
    squared = np.zeros((3, 3, width))  # Ω² of the rates (I + E) ω at t − τ
    squared[..., where["products"]] = _SQUARES @ (np.einsum("ijkl,ij->kl", _BY_RATE_ERROR, E) + np.eye(6))
    squared[..., where["change"]], squared[..., where["bend"]] = -delay * _SQUARES, 0.5 * delay**2 * _SQUARES
    pulled = np.einsum("ijc,pj->pic", squared, r)
    readings = -np.einsum("pi,pic->pc", K, pulled)
    readings[:, where["readings"]] += np.eye(len(K))
    H = np.hstack([K, np.cross(r, K)]) if placed else K
    motion = np.linalg.pinv(H) @ readings
    turning = np.zeros((3, width))  # at first, without lever arms, the angular acceleration is that of the gyros
    turning[:, where["turning"]] = np.eye(3)
    turning = motion[3:] if placed else turning
    own = np.zeros((len(K), len(OWN) + 3, width))
    own[:, 0, where["one"]], own[:, 1:4] = 1.0, motion[:3] + pulled - skew(r) @ turning
    own[:, 4, where["forces"]] = np.where(_FIRST == _SECOND, 1.0, 2.0) * K[:, _FIRST] * K[:, _SECOND]
    own[:, 5, where["jerk"]] = -K
    own[:, 6:] = np.einsum("pi,ijc->pjc", K, squared)
    own[:, 6:] += np.einsum("pi,kij,kc->pjc", K, skew(np.eye(3)), turning)
    whirl = np.einsum("pi,ijm,pj->pm", K, _SQUARES, r)
    common = np.zeros((COMMON, len(K), width))
    common[0][:, where["change"]], common[0][:, where["bend"]] = -whirl, delay * whirl
    common[1:, :, where["products"]] = np.einsum("pm,eml->epl", whirl, _BY_RATE_ERROR.reshape(9, 6, 6))
    N = np.linalg.qr(H, mode="complete")[0][:, H.shape[1] :]
    return readings, own, common, N @ N.T
