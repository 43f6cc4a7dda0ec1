"""Lever arms of an array from its motion alone: what n ≥ 7 accelerometers say of each other, without any attitude.

Sensor p at r_p reads, with k_p its row of the sensitivity matrix,

    y_p = k_pᵀ (f + ω̇ × r_p + Ω² r_p) + own_p,     Ω² = ωωᵀ − |ω|² I                                            (12)

The force f and ω̇ are unknowns of every sample: of y only the n − 6 combinations N count that H = [K, r × K] leaves.
Ω² is that of the rates (I + E) ω at t − τ, to second order in τ: their error E and the delay τ of the accelerometers
are unknowns. own_p is what a calibration at rest does not know of a sensor that is shaken (bias, row of the matrix,
square, delay of its own), and is eliminated. Its row reads all of the acceleration where the sensor is: on a flat board
an angular acceleration reaches accelerometers in the board by their height, 1 mm, and by an error of their axes of
10⁻³ times 10 mm. What is left is a likelihood of lever arms, τ and E, all from the moments of
`tumble.reduction.turns.array_motion`. Translations of all sensors of one direction change nothing but f and remain
open, and a common scale of all lever arms is open as far as E is: turns say both.

What rates change by from sample to sample is no measurement of ω̇: much of what accelerometers of a shaken body read of
it is faster than the samples, and against the gyros' differences it has a scale that depends on how they are formed.

Its noise is that which the residuals show in each class of samples. As the classes are made by these residuals, they
tell of n − 6 directions at once what is left: information is (1 − 2/(n − 6))² of that of known variances (Tyler 1987).

The equation is docs/explanation/mathematics.md (12).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tumble.reduction.turns.array_motion import ArrayMoments
from tumble.rotation import skew
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import Block
from tumble.sensors.parameters import PAIRS
from tumble.units import G_STANDARD, Array, IntArray

ROUNDS = 15
SETTLED = 1e-7  # m
OWN = np.array([0.05 * G_STANDARD, 0.01, 0.01, 0.01, 1e-3 / G_STANDARD, 0.01])
"""How far what a sensor has of its own may reasonably be from zero: m/s², 1, 1, 1, s²/m, s. Rows of the matrix are
known from rests, and are the same to 1 % in motion."""
LEVER, DELAY, RATE_ERROR = 0.03, 0.02, 0.003
"""The same of lever arms, m, the delay, s, and of E from that of the gyros, in the rounds that find where to
linearise."""
COMMON = 10
"""The delay and the nine of E."""
LEVER_FLOOR, DELAY_FLOOR = 5e-6, 5e-5  # m, s
"""No place of a sensor and no delay is taken to be better known: rates between samples are taken for parabolas, and
real filters are no pure delays."""
OUT_OF_RANGE = 1e-12
_FIRST, _SECOND = np.array(PAIRS).T
_PAIR = np.zeros((3, 3), dtype=np.int64)
_PAIR[_FIRST, _SECOND] = _PAIR[_SECOND, _FIRST] = np.arange(len(PAIRS))


def _squares() -> Array:
    """Ω²_ij (3, 3, 6) as combinations of the products ω_k ω_l."""
    out = np.zeros((3, 3, 6))
    for i in range(3):
        out[i, np.arange(3), _PAIR[i]] += 1.0
        out[i, i, [0, 3, 5]] -= 1.0
    return out


def _by_rate_error() -> Array:
    """∂(ω_i ω_j)/∂E_kl (3, 3, 6, 6) as combinations of the products."""
    out = np.zeros((3, 3, 6, 6))
    for m, (i, j) in enumerate(PAIRS):
        for k in range(3):
            out[i, k, m, _PAIR[j, k]] += 1.0
            out[j, k, m, _PAIR[i, k]] += 1.0
    return out


_SQUARES, _BY_RATE_ERROR = _squares(), _by_rate_error()


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ArrayLevers:
    """The likelihood of q = (lever arms of all accelerometers but the last, in their order, the mean delay, E row by
    row): its rows are `excess` (k,) − `root` (k, q) (q − `about`), whitened."""

    about: Array
    root: Array
    excess: Array

    def rows(self, instrument: Instrument, values: Array) -> Array:
        """[coefficients | residual] (k, m + 1), whitened, for the parameters of the instrument."""
        gyro, levers, delay = instrument.gyro, instrument.in_motion("lever"), instrument.in_motion("delay")
        single = instrument.in_motion("single delay")
        assert gyro is not None
        here, by, count = np.zeros(len(self.about)), np.zeros((len(self.about), len(values))), len(self.about) - COMMON
        if levers is not None:
            here[:count], by[:count, levers] = values[levers], np.eye(count)
        if delay is not None:
            here[count], by[count, delay] = instrument.delays(values).mean(), 1.0
        if single is not None:
            by[count, single] = 1.0 / instrument.accel.size
        own, to_rate = instrument.own(gyro), np.linalg.pinv(gyro.axes)
        error = _rate_error(instrument, values)
        right = np.eye(3) + error
        of_matrix = np.einsum("ik,kp,pbm,bj->ijm", right, to_rate, gyro.jacobian(values[own])[:, :3], right)
        here[count + 1 :], by[count + 1 :, own] = error.ravel(), -of_matrix.reshape(9, -1)
        return np.column_stack([self.root @ by, self.excess - self.root @ (here - self.about)])


def _rate_error(instrument: Instrument, values: Array) -> Array:
    """E (3, 3) of gyros with parameters (m,): the rates of the body are (I + E) times those that nominal gyros read."""
    assert instrument.gyro is not None
    read = np.linalg.pinv(instrument.gyro.axes) @ instrument.model(instrument.gyro, values).matrix
    return np.asarray(np.linalg.inv(read) - np.eye(3))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Place:
    """Where the likelihood is taken: lever arms r (n, 3), the delay, s, and the error E (3, 3) of the rates."""

    r: Array
    delay: float
    E: Array

    @property
    def common(self) -> Array:
        """The delay and E (10,)."""
        return np.append(self.delay, self.E)


@dataclass(frozen=True, kw_only=True, eq=False)
class _LinearRows:
    """A sample's rows as linear functions of x: `left` (n, c) of what the readings leave, `own` (n, s, c) of the
    unknowns of a sensor, its lever arm last, `common` (10, n, c) of the delay and of E; and N Nᵀ (n, n), `free`."""

    left: Array
    own: Array
    common: Array
    free: Array

    @cached_property
    def freed(self) -> tuple[Array, Array]:
        """N Nᵀ times `left` and `common`."""
        return self.free @ self.left, self.free @ self.common


def array_levers(moments: ArrayMoments, instrument: Instrument, values: Array) -> ArrayLevers:
    """The likelihood, with the sensitivities of the accelerometers that the instrument has at `values` (m,)."""
    accel = instrument.accel
    K = instrument.model(accel, values).matrix
    at = _Place(r=np.zeros((accel.size, 3)), delay=0.0, E=_rate_error(instrument, values))
    centre = np.concatenate([np.zeros(3 * accel.size - 3), at.common])
    variances = np.ones(len(moments.counts))
    for _ in range(ROUNDS):
        linear = _linear(moments, K, at)
        normal, gradient, nuisance = _normal(moments, accel, linear, variances)
        order = accel.channels[:-1]
        about = np.concatenate([at.r[order].ravel(), at.common])
        step = _step(normal, gradient, about - centre)
        variances = _variances(moments, linear, nuisance.own(step, order), step[-COMMON:])
        r = at.r.copy()
        r[order] += step[:-COMMON].reshape(-1, 3)
        at = _Place(r=r, delay=at.delay + step[-COMMON], E=at.E + step[1 - COMMON :].reshape(3, 3))
        if np.abs(step[:-COMMON]).max() < SETTLED:
            break
    share = (1.0 - 2.0 / (accel.size - 6)) ** 2
    normal, gradient = _with_floor(share * normal, share * gradient)
    size, direction = np.linalg.eigh(normal)
    seen = size > OUT_OF_RANGE * size[-1]
    root = np.sqrt(size[seen])[:, None] * direction[:, seen].T
    excess = (direction[:, seen].T @ gradient) / np.sqrt(size[seen])
    return ArrayLevers(about=about, root=root, excess=excess)


def _linear(moments: ArrayMoments, K: Array, at: _Place) -> _LinearRows:
    """The rows about a point. Without lever arms, at first, the angular acceleration is that of the gyros."""
    where, width = moments.columns, moments.sums.shape[1]
    squared, placed = _squared(moments, at), bool(np.any(at.r))
    pulled = np.einsum("ijc,pj->pic", squared, at.r)
    left = -np.einsum("pi,pic->pc", K, pulled)
    left[:, where["readings"]] += np.eye(len(K))
    H = np.hstack([K, np.cross(at.r, K)]) if placed else K
    seen = np.linalg.pinv(H) @ left
    turning = np.zeros((3, width))
    turning[:, where["turning"]] = np.eye(3)
    turning = seen[3:] if placed else turning
    own = np.zeros((len(K), len(OWN) + 3, width))
    own[:, 0, where["one"]], own[:, 1:4] = 1.0, seen[:3] + pulled - skew(at.r) @ turning
    own[:, 4, where["forces"]] = np.where(_FIRST == _SECOND, 1.0, 2.0) * K[:, _FIRST] * K[:, _SECOND]
    own[:, 5, where["jerk"]] = -K
    own[:, 6:] = np.einsum("pi,ijc->pjc", K, squared)
    own[:, 6:] += np.einsum("pi,kij,kc->pjc", K, skew(np.eye(3)), turning)
    whirl = np.einsum("pi,ijm,pj->pm", K, _SQUARES, at.r)
    common = np.zeros((COMMON, len(K), width))
    common[0][:, where["change"]], common[0][:, where["bend"]] = -whirl, at.delay * whirl
    common[1:, :, where["products"]] = np.einsum("pm,eml->epl", whirl, _BY_RATE_ERROR.reshape(9, 6, 6))
    N = np.linalg.qr(H, mode="complete")[0][:, H.shape[1] :]
    return _LinearRows(left=left, own=own, common=common, free=N @ N.T)


def _squared(moments: ArrayMoments, at: _Place) -> Array:
    """Ω² (3, 3, c) of the rates (I + E) ω at t − τ."""
    where = moments.columns
    out = np.zeros((3, 3, moments.sums.shape[1]))
    out[..., where["products"]] = _SQUARES @ (np.einsum("ijkl,ij->kl", _BY_RATE_ERROR, at.E) + np.eye(6))
    out[..., where["change"]], out[..., where["bend"]] = -at.delay * _SQUARES, 0.5 * at.delay**2 * _SQUARES
    return out


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _OfSensors:
    """What every sensor has of its own (n, s'), `found` less `by` (n, s', q) times the step of the others."""

    found: Array
    by: Array

    def own(self, step: Array, order: IntArray) -> Array:
        """All unknowns (n, s) of the sensors, lever arms included."""
        lever = np.zeros((len(self.found), 3))
        lever[order] = step[:-COMMON].reshape(-1, 3)
        return np.column_stack([self.found - self.by @ step, lever])


def _normal(
    moments: ArrayMoments, accel: Block, linear: _LinearRows, variances: Array
) -> tuple[Array, Array, _OfSensors]:
    """Normal matrix (q, q) and right side (q,) of the lever arms and of what is common, with variances (B,) of the
    classes, and what was eliminated."""
    M = np.tensordot(1.0 / variances, moments.sums, axes=1)
    n, s = linear.own.shape[:2]
    weighted, (left, common) = linear.own @ M, linear.freed
    every = np.zeros((n * s + COMMON, n * s + COMMON))
    own = np.tensordot(weighted, linear.own, axes=([2], [2])) * linear.free[:, None, :, None]
    every[:-COMMON, :-COMMON] = own.reshape(n * s, n * s)
    every[:-COMMON, -COMMON:] = np.einsum("pac,epc->pae", weighted, common).reshape(n * s, COMMON)
    every[-COMMON:, :-COMMON] = every[:-COMMON, -COMMON:].T
    every[-COMMON:, -COMMON:] = np.tensordot(linear.common @ M, common, axes=([1, 2], [1, 2]))
    right = np.zeros(n * s + COMMON)
    right[:-COMMON] = np.einsum("pac,pc->pa", weighted, left).ravel()
    right[-COMMON:] = np.einsum("epc,pc->e", linear.common @ M, left)
    place = np.arange(n * s).reshape(n, s)
    kept = np.concatenate([place[accel.channels[:-1], -3:].ravel(), n * s + np.arange(COMMON)])
    out = place[:, :-3].ravel()
    inner = every[np.ix_(out, out)] + np.diag(np.tile(OWN**-2.0, n))
    solved = np.linalg.solve(inner, np.column_stack([every[np.ix_(out, kept)], right[out]]))
    back = every[np.ix_(kept, out)]
    nuisance = _OfSensors(found=solved[:, -1].reshape(n, s - 3), by=solved[:, :-1].reshape(n, s - 3, -1))
    return every[np.ix_(kept, kept)] - back @ solved[:, :-1], right[kept] - back @ solved[:, -1], nuisance


def _step(normal: Array, gradient: Array, off: Array) -> Array:
    """The step (q,) with what is reasonable as prior of all, which are `off` (q,) its centre."""
    known = np.concatenate([np.full(len(off) - COMMON, LEVER), [DELAY], np.full(9, RATE_ERROR)]) ** -2.0
    return np.asarray(np.linalg.solve(normal + np.diag(known), gradient - known * off))


def _with_floor(normal: Array, gradient: Array) -> tuple[Array, Array]:
    """The same with the floors added to the variances of the delay and of all places, the last one's too, from which
    lever arms count: they gain LEVER_FLOOR² (I + 1 1ᵀ)."""
    others = (len(normal) - COMMON) // 3
    first = slice(0, 3 * others + 1)
    inner = normal[first, first].copy()
    inner[:-1, :-1] += np.kron(np.eye(others) - 1.0 / (others + 1), np.eye(3)) / LEVER_FLOOR**2
    inner[-1, -1] += DELAY_FLOOR**-2.0
    less = np.linalg.solve(inner, np.column_stack([normal[first], gradient[first]]))
    return normal - normal[:, first] @ less[:, :-1], gradient - normal[:, first] @ less[:, -1]


def _variances(moments: ArrayMoments, linear: _LinearRows, own: Array, common: Array) -> Array:
    """The variances (B,) that the residuals after a step show; 1 in a class without samples."""
    residual = linear.left - np.einsum("psc,ps->pc", linear.own, own) - np.tensordot(common, linear.common, axes=1)
    shown = np.einsum("pc,bcd,pd->b", linear.free @ residual, moments.sums, residual, optimize=True)
    degrees = np.maximum(moments.counts, 1.0) * np.trace(linear.free)
    return np.where(moments.counts > 0.0, shown / degrees, 1.0)
