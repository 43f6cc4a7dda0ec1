"""Moments of a turn: parameter-free integrals over its samples, from which the columns of any parameter follow.

A turn is described in the non-rotating frame that is the body frame at its start, to which C(t) rotates the body frame
at t. With the compensated rate ω and specific force f of the body and the regressors β = (1, ω_k, f_k, f_k f_l), k ≤ l,

    Φ_ijb = ∫ C_ij β_b dt,     Ψ_jb = ∫ Φ_jb × dV  (b < 7),     W_ij,kl = ∫ C_ij ω_k ω_l dt,     V = ∫ C f dt,

together with C and the sweep ∫ (C[ω×])_im f_l dt, are the statistic of the turn: docs/explanation/mathematics.md (8).
Let sensor p read a_pᵀω or a_pᵀf plus Σ_m θ_m Σ_b w_pbm β_b, and let s_p be column p of the left inverse with which the
readings were compensated. A group of parameters then enters only through the constant array w:

    gyros           ∂φ = −Φ_ijb s_jp w_pbm,   ∂V = −Ψ_ijb s_jp w_pbm                                    (9)
    accelerometers  ∂V = −Φ_ijb s_jp w_pbm

with C(θ) = exp([∂φ δθ ×]) C. Terms in |a_p·x| and (a_p·x)³, x = ω or f, of the component along the axis of the sensor
itself need sums for every axis a_p. They are computed for the sensors that have such terms (`OwnAxes`).

The columns neglect the effect of accelerometer parameters on the rate through g-sensitivity, and of gyro parameters on
the force through the delay. It is of second order, and vanishes when the turn is integrated about the new values.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from tumble.reduction.turns import moment_kernels as _kernels
from tumble.rotation import onto_body, skew
from tumble.sensors.model import SensorModel
from tumble.sensors.parameters import PAIRS
from tumble.units import Array, IntArray

NO_AXES: Array = np.empty((0, 3))
GROWTH_PARTS = 8  # parts of a turn with constant time weight: n steps have 1 − 1/n² of the effect of a line


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class BlockCompensation:
    """Compensation of a block of sensors: the body vector x from the body vector y of nominal sensors,

        x = A (y − c − Σ_p P_p (K₂ u² + K₃ u³ + κ |u|)),     u = a_pᵀx.

    `axes`: a_p (n, 3). `to_body`: P = pinv(axes) (3, n). `matrix`: A (3, 3). `bias`: c (3,). `terms`: K₂, K₃ and κ of
    every sensor (n, 3), in the units of its reading per power of u."""

    axes: Array
    to_body: Array
    matrix: Array
    bias: Array
    terms: Array

    @classmethod
    def of(cls, axes: Array, model: SensorModel, terms: Array | None = None) -> BlockCompensation:
        """Return the compensation of sensors with nominal `axes` (n, 3) for a sensor model and nonlinear `terms`."""
        to_body = np.asarray(onto_body(axes), dtype=float)
        return cls(
            axes=np.ascontiguousarray(axes, dtype=float),
            to_body=to_body,
            matrix=np.asarray(np.linalg.inv(to_body @ model.matrix), dtype=float),
            bias=to_body @ model.bias,
            terms=np.zeros((len(axes), 3)) if terms is None else terms,
        )

    @property
    def left_inverse(self) -> Array:
        """s (3, n), whose column p is the derivative of the body vector by the reading of sensor p."""
        return np.asarray(self.matrix @ self.to_body)

    def _kernel_terms(self) -> _kernels.Terms:
        """Return the arguments of the compiled loops; only sensors with nonlinear terms are listed."""
        affine, nonlinear = np.empty((3, 4)), self.terms.any(axis=1)
        affine[:, :3], affine[:, 3] = self.matrix, -self.matrix @ self.bias
        return affine, np.hstack([self.axes[nonlinear], self.terms[nonlinear], self.left_inverse.T[nonlinear]])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Compensation:
    """Values about which a turn is integrated: gyros, accelerometers, the `g_sensitivity` G (3, 3) of the body rate,
    rad/s per m/s², and the `delay` τ of the accelerometers, s.

    The order is: f from its readings; ω; f moved by −τ ω̄×f + ½τ² ω̄×(ω̄×f), ω̄ = ω − ½τ ω̇; then ω again, with G times
    the moved f. Nonlinear terms are solved by two fixed-point steps."""

    gyro: BlockCompensation
    accel: BlockCompensation
    g_sensitivity: Array
    delay: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Moments:
    """Moments of K turns or pieces of turns, resolved in the body frame at the start of the turn.

    n and m are the numbers of gyros and accelerometers in `OwnAxes`."""

    C: Array  # rotation (K, 3, 3) from the body at the end to the body at the start
    V: Array  # velocity increment ∫ C f dt (K, 3), m/s
    P: Array  # position increment ∫ V dt (K, 3), m
    Phi: Array  # ∫ C_ij β_b dt (K, 3, 3, 13), of 1, ω, f, f f
    Psi: Array  # (∫ Φ_jb × dV)_i (K, 3, 3, 7), of 1, ω, f
    W: Array  # ∫ C_ij ω_k ω_l dt (K, 3, 3, 6), kl = 11, 12, 13, 22, 23, 33
    sweep: Array  # ∫ (C [ω×])_im f_l dt (K, 3, 3, 3)
    Phi_gyro: Array  # ∫ C_ij |a_p·ω| dt, and then ∫ C_ij (a_p·ω)³ dt (K, 3, 3, 2, n)
    Psi_gyro: Array  # Ψ for |a_p·ω|, and then for (a_p·ω)³ (K, 3, 3, 2, n)
    Phi_accel: Array  # ∫ C_ij |a_p·f| dt, and then ∫ C_ij (a_p·f)³ dt (K, 3, 3, 2, m)
    body: Array  # ∫ β_b dt (K, 13) in the rotating body frame; the first is the duration, s
    body_rates: Array  # ∫ ω_k ω_l dt (K, 6)
    body_gyro: Array  # ∫ |a_p·ω| dt, ∫ (a_p·ω)³ dt (K, 2, n)
    jumps: Array  # Σ Δt² |f − f'|² (K,), m²/s², f' being the previous sample: docs/explanation/mathematics.md (18)

    def __len__(self) -> int:
        return len(self.C)

    @property
    def T(self) -> Array:
        """Duration (K,), s."""
        return np.asarray(self.body[:, 0])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class OwnAxes:
    """Axes a_p of the gyros (n, 3) and accelerometers (m, 3) with asymmetry κ |a_p·x| or a cubic term K₃ (a_p·x)³."""

    gyro: Array
    accel: Array


NO_OWN_AXES = OwnAxes(gyro=NO_AXES, accel=NO_AXES)


@dataclass(frozen=True, kw_only=True, eq=False)
class Pieces:
    """Samples of pieces of turns: samples start[j] … stop[j] − 1 for piece j, which belongs to turn[j].

    `rates` (S, 3), rad/s, and `forces` (S, 3), m/s², in the body from nominal sensors; `intervals` (S,), s. Unless a
    piece starts at sample 0 or 1, the two samples before it are also those before it in time: the last one gives the
    coning and sculling terms of the first step, both of them the derivative of the rate."""

    rates: Array
    forces: Array
    intervals: Array
    turn: IntArray
    start: IntArray
    stop: IntArray


def integrate(
    batches: Iterable[Pieces],
    turns: int,
    compensation: Compensation | Sequence[Compensation],
    own: OwnAxes = NO_OWN_AXES,
) -> Moments:
    """Return moments of `turns` turns by the step about the middle attitude, docs/explanation/mathematics.md (6).

    There is one `compensation`, or one for each turn. Every batch has at most one piece of a turn, in order of time.
    Rounding errors are below 1e-12 while a sample turns by less than 0.5 rad."""
    count, n, m, linear = turns, len(own.gyro), len(own.accel), _kernels.LINEAR
    # regressors: 1, ω, f; own axes of the gyros; f f; ω ω; own axes of the accelerometers
    firsts = np.cumsum([0, linear, 2 * n, 6, 6, 2 * m])
    linears, own_gyro, forces_2, rates_2, own_accel = (slice(a, b) for a, b in pairwise(firsts.tolist()))
    # numbers of all regressors, and of those before f f, rounded up to whole BLOCKs
    rows, moved_rows = (-(-width // _kernels.BLOCK) * _kernels.BLOCK for width in firsts[[-1, 2]].tolist())
    attitude, jumps = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1)), np.zeros(count)
    V, P = np.zeros((count, 3)), np.zeros((count, 3))
    products, moved = np.zeros((count, 10, rows)), np.zeros((count, 9, moved_rows))
    sweep = np.zeros((count, 9, _kernels.BLOCK))
    sums = attitude, V, P, products, moved, sweep, jumps
    axes = np.ascontiguousarray(own.gyro, dtype=float), np.ascontiguousarray(own.accel, dtype=float)
    for pieces in batches:
        rates, forces, intervals = (
            np.ascontiguousarray(x, dtype=float) for x in (pieces.rates, pieces.forces, pieces.intervals)
        )
        turn, start, stop = (np.ascontiguousarray(x, dtype=np.int64) for x in (pieces.turn, pieces.start, pieces.stop))
        if isinstance(compensation, Compensation):
            parts = [(slice(None), compensation)]
        else:
            parts = [(slice(i, i + 1), compensation[k]) for i, k in enumerate(turn)]
        for part, values in parts:
            where = turn[part], start[part], stop[part]
            G = np.ascontiguousarray(values.gyro.matrix @ values.g_sensitivity)
            model = values.gyro._kernel_terms(), values.accel._kernel_terms(), G, float(values.delay)
            _kernels.integrate_pieces((rates, forces, intervals), where, model, axes, sums)
        del pieces, rates, forces, intervals  # free the memory before the next batch is read
    cross = skew(attitude[:, 1:])  # of unit quaternions, scalar first
    Phi, body = products[:, :9].reshape(count, 3, 3, rows), products[:, 9]
    with np.errstate(over="ignore", invalid="ignore"):  # damaged samples are judged later
        Psi = _crossed(Phi[..., :moved_rows], V) - moved.reshape(count, 3, 3, moved_rows)
        return Moments(
            C=np.eye(3) + 2.0 * (attitude[:, 0, None, None] * cross + cross @ cross),
            V=V,
            P=P,
            Phi=np.concatenate([Phi[..., linears], Phi[..., forces_2]], axis=-1),
            Psi=Psi[..., linears],
            W=Phi[..., rates_2],
            sweep=sweep[..., :3].reshape(count, 3, 3, 3),
            Phi_gyro=Phi[..., own_gyro].reshape(count, 3, 3, 2, n),
            Psi_gyro=Psi[..., own_gyro].reshape(count, 3, 3, 2, n),
            Phi_accel=Phi[..., own_accel].reshape(count, 3, 3, 2, m),
            body=np.hstack([body[:, linears], body[:, forces_2]]),
            body_rates=body[:, rates_2],
            body_gyro=body[:, own_gyro].reshape(count, 2, n),
            jumps=jumps,
        )


def _crossed(matrices: Array, V: Array) -> Array:
    """Return (M_jb × V)_i = −([V×] M_jb)_i of the columns M_jb (K, 3, 3, R) and V (K, 3) of each turn."""
    return _rotated(-skew(V), matrices)


def _rotated(C: Array, matrices: Array) -> Array:
    """Return C (K, 3, 3) times the columns of (K, 3, …)."""
    flat = matrices.reshape(*matrices.shape[:2], math.prod(matrices.shape[2:]))
    return np.asarray((C @ flat).reshape(matrices.shape))


def integrate_in_parts(
    batches: Iterable[Pieces], lengths: IntArray, parts: int, compensation: Compensation
) -> tuple[Moments, Array, Array]:
    """Return moments of equal parts of turns, and the path of each turn.

    `batches` are as for `integrate`, `lengths` the numbers of samples of the K turns, each of which has n `parts`. The
    moments of the K n parts are resolved in the body at the start of each, turn after turn. The path, before each part
    and at the end, is the rotation C from the body to the body at the start of the turn (K, n + 1, 3, 3), and the
    velocity increment V (K, n + 1, 3), m/s."""

    def split() -> Iterator[Pieces]:
        """Yield the samples in pieces that do not exceed a part."""
        done = np.zeros(len(lengths), dtype=np.int64)
        for pieces in batches:
            spans = []
            for k, start, stop in zip(pieces.turn.tolist(), pieces.start.tolist(), pieces.stop.tolist(), strict=True):
                edges = np.clip(start - done[k] + lengths[k] * np.arange(parts + 1) // parts, start, stop).tolist()
                spans += [(parts * k + j, a, b) for j, (a, b) in enumerate(pairwise(edges)) if b > a]
                done[k] += stop - start
            turn, first, last = np.array(spans, dtype=np.int64).reshape(-1, 3).T
            yield replace(pieces, turn=turn, start=first, stop=last)

    moments = integrate(split(), parts * len(lengths), compensation)
    rotation, velocity = moments.C.reshape(-1, parts, 3, 3), moments.V.reshape(-1, parts, 3)
    C, V = np.empty((len(lengths), parts + 1, 3, 3)), np.zeros((len(lengths), parts + 1, 3))
    C[:, 0] = np.eye(3)
    for j in range(parts):
        C[:, j + 1] = C[:, j] @ rotation[:, j]
        V[:, j + 1] = V[:, j] + _rotated(C[:, j], velocity[:, j])
    return moments, C, V


def growing_moments(batches: Iterable[Pieces], lengths: IntArray, compensation: Compensation) -> tuple[Array, Array]:
    """Return Φ (K, 3, 3, 13) and Ψ (K, 3, 3, 7) of turns with these numbers of samples (K,), weighted with the time
    from the middle of each turn, s: the effect of a coefficient that grows by 1 per second within a turn.

    The weight t is constant within each of GROWTH_PARTS parts. With C of the turn before a part, and V′ of what follows
    it, the sums are Σ t C Φ and Σ t (C Ψ + C Φ × V′)."""
    moments, C, V = integrate_in_parts(batches, lengths, GROWTH_PARTS, compensation)
    T, before = moments.T.reshape(-1, GROWTH_PARTS), C[:, :-1].reshape(-1, 3, 3)
    weight = np.cumsum(T, axis=1) - 0.5 * T - 0.5 * T.sum(axis=1, keepdims=True)
    Phi = _rotated(before, moments.Phi)
    after = (V[:, -1:] - V[:, 1:]).reshape(-1, 3)
    Psi = _rotated(before, moments.Psi) + _crossed(Phi[..., : _kernels.LINEAR], after)
    Phi, Psi = (np.einsum("kp,kp...->k...", weight, x.reshape(-1, GROWTH_PARTS, *x.shape[1:])) for x in (Phi, Psi))
    return Phi, Psi


def lever_columns(moments: Moments, left_inverse: Array, sensitivities: Array, rates: tuple[Array, Array]) -> Array:
    """Return ∂V = −A_r (K, 3, 3 n), s⁻¹, of the lever arms r_p (three numbers a sensor) of accelerometers.

    This is Eq. (10) of docs/explanation/mathematics.md, integrated by parts, with the terms at both ends:

        A_r = ∫ C (s_p a_pᵀ [ω×] − [ω×] s_p a_pᵀ) [ω×] dt + [C s_p a_pᵀ [ω×]]

    with the rows (1 + k) a_p of `sensitivities` (n, 3) and the columns s_p of their `left_inverse` (3, n). `rates` are
    those of the body at the start and at the end (K, 3), the Earth's rate at rest. Turns of duration 0 have zeros."""
    along = np.einsum("jp,pa->pja", left_inverse, sensitivities)
    # W has every product ω_k ω_l with k ≤ l once: for k < l the coefficients of kl and of lk are added
    first, second = (skew(np.eye(3)[list(axes)]) for axes in zip(*PAIRS, strict=True))
    weights = np.zeros((3, len(PAIRS), len(sensitivities), 3))
    for G, H, which in ((first, second, slice(None)), (second, first, [1, 2, 4])):
        kernel = np.einsum("pja,kab,kbr->jkpr", along, G, H) - np.einsum("kja,pab,kbr->jkpr", G, along, H)
        weights[:, which] += kernel[:, which]
    flat = weights.reshape(3 * len(PAIRS), -1)
    columns = -np.asarray(moments.W.reshape(len(moments), 3, len(flat)) @ flat)
    first, last = (
        np.einsum("pja,kab->kjpb", along, skew(rate)).reshape(len(rate), *columns.shape[1:]) for rate in rates
    )
    return np.asarray(columns - (moments.C @ last - first) * np.sign(moments.T)[:, None, None])


def delay_column(moments: Moments) -> Array:
    """Return ∂V = −∫ C (ω × f) dt (K, 3), m/s², of a delay common to all accelerometers: the sum in Eq. (11)."""
    return np.asarray(-np.einsum("kijj->ki", moments.sweep))


def single_delay_columns(
    moments: Moments, left_inverse: Array, sensitivities: Array, ends: tuple[Array, Array]
) -> Array:
    """Return ∂V = −A_τ (K, 3, n), m/s², of the delays of single accelerometers: Eq. (11), integrated by parts.

        A_τ = ∫ C (ω × s_p)(a_p·f) dt − [C s_p (a_p·f)]

    `ends` are the specific forces in the body at rest, at the start and at the end (K, 3). Turns of duration 0 have
    zeros."""
    swept = np.einsum("kiml,mp,pl->kip", moments.sweep, left_inverse, sensitivities)
    first, last = ((force @ sensitivities.T)[:, None, :] for force in ends)
    return np.asarray(
        ((moments.C @ left_inverse) * last - left_inverse * first - swept) * np.sign(moments.T)[:, None, None]
    )
