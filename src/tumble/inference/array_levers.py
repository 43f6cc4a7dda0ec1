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

import numpy as np

from tumble.reduction.turns.array_motion import ArrayMoments
from tumble.rotation import skew
from tumble.sensors.instrument import Instrument
from tumble.sensors.parameters import PAIRS
from tumble.units import G_STANDARD, Array

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


_SQUARES = np.zeros((3, 3, 6))
"""Ω²_ij as combinations of the products ω_k ω_l."""
_BY_RATE_ERROR = np.zeros((3, 3, 6, 6))
"""∂(ω_i ω_j)/∂E_kl as combinations of the products."""
for _i in range(3):
    _SQUARES[_i, np.arange(3), _PAIR[_i]] += 1.0
    _SQUARES[_i, _i, [0, 3, 5]] -= 1.0
    for _m, (_first, _second) in enumerate(PAIRS):
        _BY_RATE_ERROR[_first, _i, _m, _PAIR[_second, _i]] += 1.0
        _BY_RATE_ERROR[_second, _i, _m, _PAIR[_first, _i]] += 1.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ArrayLevers:
    """The likelihood of q = (lever arms of all accelerometers but the last, in their order, the mean delay, E row by
    row): its rows are `excess` (k,) − `root` (k, q) (q − `about`), whitened."""

    about: Array
    root: Array
    excess: Array

    def rows(self, instrument: Instrument, values: Array) -> Array:
        """[coefficients | residual] (k, m + 1), whitened, for the parameters of the instrument."""
        gyro, levers, delay = instrument.gyro, instrument.turn_only("lever"), instrument.turn_only("delay")
        single = instrument.turn_only("single delay")
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


def array_levers(moments: ArrayMoments, instrument: Instrument, values: Array) -> ArrayLevers:
    """The likelihood, with the sensitivities of the accelerometers that the instrument has at `values` (m,).

    With x the moments of a class of samples, M = Σ x xᵀ over the variances of the classes and N the combinations that
    no force and no ω̇ explain, the rows of all sensors are Nᵀ (left − Σ own a − Σ common b) x of the unknowns a of
    single sensors, lever arms last, and the delay and E, b. What is no lever arm is eliminated from the normal
    equations."""
    accel, K = instrument.accel, instrument.model(instrument.accel, values).matrix
    n, order, E = accel.size, accel.channels[:-1], _rate_error(instrument, values)
    r, delay, variances = np.zeros((n, 3)), 0.0, np.ones(len(moments.counts))
    centre = np.concatenate([np.zeros(3 * n - 3), [delay], E.ravel()])
    known = np.concatenate([np.full(3 * n - 3, LEVER), [DELAY], np.full(9, RATE_ERROR)]) ** -2.0
    s = len(OWN) + 3  # unknowns of a sensor
    place = np.arange(n * s).reshape(n, s)
    kept, out = np.append(place[order, -3:].ravel(), n * s + np.arange(COMMON)), place[:, :-3].ravel()
    for _ in range(ROUNDS):
        left, own, common, free = _linear(moments, K, r, delay, E)
        M = np.tensordot(1.0 / variances, moments.sums, axes=1)
        weighted, freed = own @ M, free @ common
        every, right = np.zeros((n * s + COMMON, n * s + COMMON)), np.zeros(n * s + COMMON)
        by_sensor = np.tensordot(weighted, own, axes=([2], [2])) * free[:, None, :, None]
        every[:-COMMON, :-COMMON] = by_sensor.reshape(n * s, n * s)
        every[:-COMMON, -COMMON:] = np.einsum("pac,epc->pae", weighted, freed).reshape(n * s, COMMON)
        every[-COMMON:, :-COMMON] = every[:-COMMON, -COMMON:].T
        every[-COMMON:, -COMMON:] = np.tensordot(common @ M, freed, axes=([1, 2], [1, 2]))
        right[:-COMMON] = np.einsum("pac,pc->pa", weighted, free @ left).ravel()
        right[-COMMON:] = np.einsum("epc,pc->e", common @ M, free @ left)
        inner, back = every[np.ix_(out, out)] + np.diag(np.tile(OWN**-2.0, n)), every[np.ix_(kept, out)]
        solved = np.linalg.solve(inner, np.column_stack([every[np.ix_(out, kept)], right[out]]))
        normal, gradient = every[np.ix_(kept, kept)] - back @ solved[:, :-1], right[kept] - back @ solved[:, -1]

        about = np.concatenate([r[order].ravel(), [delay], E.ravel()])
        step = np.linalg.solve(normal + np.diag(known), gradient - known * (about - centre))  # reasonable is a prior
        levers = np.zeros((n, 3))
        levers[order] = step[:-COMMON].reshape(-1, 3)
        of_sensors = np.column_stack([(solved[:, -1] - solved[:, :-1] @ step).reshape(n, s - 3), levers])
        residual = left - np.einsum("psc,ps->pc", own, of_sensors) - np.tensordot(step[-COMMON:], common, axes=1)
        shown = np.einsum("pc,bcd,pd->b", free @ residual, moments.sums, residual, optimize=True)
        degrees = np.maximum(moments.counts, 1.0) * np.trace(free)
        variances = np.where(moments.counts > 0.0, shown / degrees, 1.0)
        r, delay, E = r + levers, delay + step[-COMMON], E + step[1 - COMMON :].reshape(3, 3)
        if np.abs(step[:-COMMON]).max() < SETTLED:
            break
    share = (1.0 - 2.0 / (n - 6)) ** 2
    normal, gradient = _with_floor(share * normal, share * gradient)
    size, direction = np.linalg.eigh(normal)
    seen = size > OUT_OF_RANGE * size[-1]
    root = np.sqrt(size[seen])[:, None] * direction[:, seen].T
    excess = (direction[:, seen].T @ gradient) / np.sqrt(size[seen])
    return ArrayLevers(about=about, root=root, excess=excess)


def _linear(moments: ArrayMoments, K: Array, r: Array, delay: float, E: Array) -> tuple[Array, Array, Array, Array]:
    """A sample's rows about lever arms r (n, 3), a delay and an error E (3, 3) of the rates, as linear functions of x:
    what the readings leave (n, c), of the unknowns of a sensor (n, s, c), of the delay and of E (10, n, c); and N Nᵀ
    (n, n)."""
    where, width, placed = moments.columns, moments.sums.shape[1], bool(np.any(r))
    squared = np.zeros((3, 3, width))  # Ω² of the rates (I + E) ω at t − τ
    squared[..., where["products"]] = _SQUARES @ (np.einsum("ijkl,ij->kl", _BY_RATE_ERROR, E) + np.eye(6))
    squared[..., where["change"]], squared[..., where["bend"]] = -delay * _SQUARES, 0.5 * delay**2 * _SQUARES
    pulled = np.einsum("ijc,pj->pic", squared, r)
    left = -np.einsum("pi,pic->pc", K, pulled)
    left[:, where["readings"]] += np.eye(len(K))
    H = np.hstack([K, np.cross(r, K)]) if placed else K
    seen = np.linalg.pinv(H) @ left
    turning = np.zeros((3, width))  # without lever arms, at first, the angular acceleration is that of the gyros
    turning[:, where["turning"]] = np.eye(3)
    turning = seen[3:] if placed else turning
    own = np.zeros((len(K), len(OWN) + 3, width))
    own[:, 0, where["one"]], own[:, 1:4] = 1.0, seen[:3] + pulled - skew(r) @ turning
    own[:, 4, where["forces"]] = np.where(_FIRST == _SECOND, 1.0, 2.0) * K[:, _FIRST] * K[:, _SECOND]
    own[:, 5, where["jerk"]] = -K
    own[:, 6:] = np.einsum("pi,ijc->pjc", K, squared)
    own[:, 6:] += np.einsum("pi,kij,kc->pjc", K, skew(np.eye(3)), turning)
    whirl = np.einsum("pi,ijm,pj->pm", K, _SQUARES, r)
    common = np.zeros((COMMON, len(K), width))
    common[0][:, where["change"]], common[0][:, where["bend"]] = -whirl, delay * whirl
    common[1:, :, where["products"]] = np.einsum("pm,eml->epl", whirl, _BY_RATE_ERROR.reshape(9, 6, 6))
    N = np.linalg.qr(H, mode="complete")[0][:, H.shape[1] :]
    return left, own, common, N @ N.T


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
