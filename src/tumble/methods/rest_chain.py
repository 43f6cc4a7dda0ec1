"""Continuous test of a calibration with one rest after the other, and detection of biases that change.

The state x is the deviation from the calibration of (a) gravity and the parameters at its reference temperature, with
the changes of turning on, of the standard deviation s of `tumble.use.check` Eq. (1); (b) the in-run bias of every
sensor, a Gauss–Markov process of the usual σ and τ; (c) slow changes of biases and scale factors, a Gauss–Markov
process of the size s, so fast that within an hour it changes by the usual drift d:

    x_{k+1} = F x_k + n,   F = diag(1, e^{−Δt/τ}, e^{−Δt/τ_s}),   τ_s = 2 s²/(d² · 1 h)                           (1)

Biases that stay, or that change within a day as much as by turning on, agree with this prediction; larger changes do
not, however slow they are. A rest gives d = R x + n of `tumble.methods.field_check` Eq. (1). With x̂ and P before it,

    z = L⁻¹ (d − R x̂),   G = L⁻¹ R,   L Lᵀ = 1 + R P Rᵀ,   x̂ ← x̂ + P Gᵀ z,   P ← A P,   A = 1 − P Gᵀ G       (2)

z has unit variance and is independent from rest to rest as long as nothing has changed. Apart from (c), the first rest
is judged as by a field check of it alone, and all rests together as by a field check of one session, with the
information Γ = Σ Φᵀ Gᵀ G Φ and γ = Σ Φᵀ Gᵀ z about x at the first rest, Φ being the product of all F A before.

A change of a bias by a at some rest has the mean μ = G m in the following ones, where m is the mean error of x̂: a in
that bias at first, then F A m, as the update takes it up. The logarithm of the likelihood ratio of a rest is

    ℓ = |μ| ζ − |μ|²/2,   ζ = Φ⁻¹(T_ν(t)),   t = μᵀz / |μ|                                                        (3)

with Student's T_ν as in a field check, so that ζ is normal. For every bias, both signs and sizes a of DETECTED times
the u of one rest, ℓ is summed from where the sum was last below zero (Page's CUSUM). As E e^ℓ = 1 given the past, a sum
that begins at any one of N rests exceeds h with a probability of at most e^−h (Ville), and any of D sums within N rests
with at most N D e^−h. With

    h = ln(D · RESTS_APART)                                                                                       (4)

the probability of a false alarm in N rests is at most N / RESTS_APART: 1 % for 1000 rests, a long day. ℓ is limited to
LARGEST_SHARE h, which makes E e^ℓ smaller, so that no single rest decides. A rest that is off by more than SUSPECT does
not update x. If the next ones agree with it, this is a change, and the bias is set free within its limits; otherwise it
was no rest. `studies/watched_days.py` counts false alarms, and rests until a change is found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from tumble.inference.estimate import DETERMINED, Fit
from tumble.methods.field_check import (
    RIVAL_CHI_SQUARE,
    ChangedParameter,
    CheckPrior,
    CheckResult,
    Evidence,
    change_statistics,
    changes_in,
    measurement_update,
    session_information,
)
from tumble.methods.least_squares import normal_score
from tumble.reduction.observations import Observations
from tumble.sensors.parameters import group_name, limits_of, sensor_kind
from tumble.units import Array

RESTS_APART = 1e5  # least mean number of rests between false alarms
DETECTED = (1.0, 2.0, 4.0)  # changes that are looked for, in u of one rest
LARGEST_SHARE = 0.6  # of the threshold by one rest
SUSPECT = 5.0  # |ζ| beyond which a rest does not update the state: by chance one in some 100,000 with six biases
HOUR = 3600.0
BIASES = ("accel.bias", "gyro.bias")
RELATIVE_RANK = 1e-9  # smaller eigenvalues of Γ, relative to the largest, are rounding


@dataclass(frozen=True, kw_only=True, slots=True)
class BiasTest:
    """Deviation of a bias in one rest from its prediction, SI."""

    change: float
    u: float
    sigmas: float  # the deviation as a standard normal number


@dataclass(frozen=True, kw_only=True, slots=True)
class MovedBias(ChangedParameter):
    """A bias that has changed."""

    rest: int  # first rest with the change, counted from 0
    since: float  # its start, s


@dataclass(frozen=True, kw_only=True, slots=True)
class JudgedRest:
    """Result of the test of one rest."""

    tests: Mapping[str, BiasTest]  # of the biases that the rest determines, by name
    misfit: Fit  # of the residuals that no change explains
    learned: bool  # whether it updated the state
    moved: tuple[MovedBias, ...] = ()  # changes that are now detected


class RestChain:
    """Sequential test of the rests of one power-on.

    Parameters
    ----------
    prior
        The prior of the parameters before the first rest.
    drift
        Usual size of drifts by group of parameters, SI per s.
    rests_apart
        Least mean number of rests between false alarms.
    """

    def __init__(self, prior: CheckPrior, drift: Mapping[str, float], *, rests_apart: float = RESTS_APART) -> None:
        instrument, components = prior.instrument, prior.components
        names, m, linear = instrument.names, len(instrument.names), instrument.linear_count
        self.instrument, self._limits = instrument, limits_of(names)
        self._biases = biases = np.array([i for i, n in enumerate(names) if group_name(n) in BIASES], dtype=int)

        # x: parameters, in-run biases, slow changes; time constants and stationary variances of each
        kinds = [sensor_kind(names[i]) for i in biases]
        in_run = np.array([getattr(components, f"{kind}_in_run") for kind in kinds])
        in_run_time = np.array([getattr(components, f"{kind}_time") for kind in kinds])
        rate = np.array([drift.get(f"{group_name(name)}.drift", 0.0) for name in names[:linear]]) ** 2 * HOUR
        slow = np.where(rate > 0.0, prior.turned_on[1 : 1 + linear], 0.0)
        slow_time = np.maximum(2.0 * slow / np.where(rate > 0.0, rate, np.inf), 1.0)
        turned_on_u = prior.turned_on * np.sqrt(prior.turned_on_inverse_degrees)
        self._constant = 1 + m
        self._time = np.concatenate([np.full(1 + m, np.inf), in_run_time, slow_time])
        self._stationary = np.concatenate([prior.turned_on, in_run**2, slow])
        slow_u = np.where(rate > 0.0, turned_on_u[1 : 1 + linear], 0.0)
        self._stationary_u = np.concatenate([turned_on_u, 0.0 * in_run, slow_u])
        self._columns = np.concatenate([np.arange(1 + m), 1 + biases, np.arange(1, 1 + linear)])
        """Index among gravity and the parameters to which each element of x adds."""
        back = np.linalg.inv(prior.to_temperature)
        calibrated = back @ prior.calibrated @ back.T
        n = len(self._stationary)
        not_calibrated = np.zeros((n - 1 - m,) * 2)
        self._P = block_diag(calibrated, not_calibrated) + np.diag(self._stationary)
        self._D = block_diag(prior.u_of_calibrated(calibrated), not_calibrated) + np.diag(self._stationary_u)
        self._calibrated_u, self._values = self._D[: 1 + m, : 1 + m], back[1:, 1:] @ prior.values
        self._x, self._Phi = np.zeros(n), np.eye(n)
        self._information, self._score = np.zeros((n, n)), np.zeros(n)
        self._squares = self._degrees = 0.0
        self._last: float | None = None
        self.rests = 0

        # a sum for every bias, both signs, and every size
        signed = [sign * size for sign in (1.0, -1.0) for size in DETECTED]
        self._sum_bias = np.repeat(np.arange(len(biases)), len(signed))
        self._sizes = np.tile(signed, len(biases))
        self.threshold = float(np.log(len(self._sum_bias) * rests_apart))
        self._finest = np.full(len(biases), np.inf)
        count = len(self._sum_bias)
        self.sums, self._sum_score, self._sum_weight, self._change = np.zeros((4, count))
        self._mean, self._first = np.zeros((n, count)), np.zeros(count, dtype=int)
        self._since = np.zeros(count)

    def add(self, observations: Observations, prior: CheckPrior, *, apart: float | None = None) -> JudgedRest:
        """Test the next rest.

        Parameters
        ----------
        observations
            The rest, alone.
        prior
            The prior of the parameters by the calibration at the temperature of the rest.
        apart
            Time since the rest before, s, infinite after another power-on. By default the difference of their times.
        """
        rests = observations.rests
        start, middle = float(rests.start[0]), 0.5 * float(rests.start[0] + rests.stop[0])
        if self._last is not None:  # prediction, Eq. (1)
            seconds = max(middle - self._last if apart is None else apart, 0.0)
            F = np.exp(-seconds / self._time) if np.isfinite(seconds) else np.where(np.isinf(self._time), 1.0, 0.0)
            added = 1.0 - F**2
            added[: self._constant] = 0.0 if np.isfinite(seconds) else 1.0
            self._x = F * self._x
            self._P = F[:, None] * self._P * F + np.diag(added * self._stationary)
            self._D = F[:, None] * self._D * F + np.diag(added * self._stationary_u)
            self._Phi, self._mean = F[:, None] * self._Phi, F[:, None] * self._mean
        self._last = middle
        constant_biases = replace(prior.components, accel_in_run=0.0, gyro_in_run=0.0)
        constant = replace(prior, components=constant_biases)
        R, d, squares, degrees = session_information(observations, constant, prior.covariance)
        R = (R @ prior.to_temperature)[:, self._columns]
        G, z, gain, A = measurement_update(R, d - R @ self._x, self._P)

        # test of the rest
        n = len(self._biases)
        changes = np.zeros((G.shape[1], n))
        changes[1 + self._biases, np.arange(n)] = 1.0
        size, t, zeta = self._statistics(G, z, changes)
        u = 1.0 / np.maximum(size, 1e-300)
        is_determined = u < self._limits[self._biases] / DETERMINED
        tests = {
            self.instrument.names[i]: BiasTest(change=float(t[k] * u[k]), u=float(u[k]), sigmas=float(zeta[k]))
            for k, i in enumerate(self._biases.tolist())
            if is_determined[k]
        }
        misfit = Fit(chi_square=squares + float(z @ z), degrees=float(degrees), scatter=0.0, unit="")
        learned = bool(np.all(np.abs(zeta[is_determined]) <= SUSPECT))

        # sums
        self._finest = np.minimum(self._finest, np.where(is_determined, u, np.inf))
        change = self._sizes * self._finest[self._sum_bias]
        restarted = (self.sums <= 0.0) & np.isfinite(change)
        self._change[restarted], self._mean[:, restarted] = change[restarted], 0.0
        self._mean[1 + self._biases[self._sum_bias[restarted]], restarted] = change[restarted]
        self.sums[restarted] = self._sum_score[restarted] = self._sum_weight[restarted] = 0.0
        self._first[restarted], self._since[restarted] = self.rests, start
        size, t, zeta = self._statistics(G, z, self._mean)
        self.sums += np.minimum(size * zeta - 0.5 * size**2, LARGEST_SHARE * self.threshold)
        self._sum_score += size * t
        self._sum_weight += size**2
        self.rests += 1

        # update
        if learned:
            self._squares, self._degrees = self._squares + misfit.chi_square, self._degrees + degrees
            GPhi = G @ self._Phi
            self._information += GPhi.T @ GPhi
            self._score += GPhi.T @ z
            self._x = self._x + gain @ z
            P = A @ self._P
            self._P, self._D = 0.5 * (P + P.T), A @ self._D @ A.T
            self._Phi, self._mean = A @ self._Phi, A @ self._mean
        return JudgedRest(tests=tests, misfit=misfit, learned=learned, moved=self._detected())

    def _statistics(self, G: Array, z: Array, changes: Array) -> tuple[Array, Array, Array]:
        """Return |μ|, t and ζ (q,) of Eq. (3) for changes (n, q) of the state."""
        size, t, inverse_degrees = change_statistics(G, z, changes, self._D)
        return size, t, normal_score(t, 1.0 / np.maximum(inverse_degrees, 1e-12))

    def _detected(self) -> tuple[MovedBias, ...]:
        """Return the bias that has changed, if a sum exceeds the threshold, and set it free.

        It is the one that explains most since its sum began. Others that explain nearly as much by Eq. (2) of a field
        check are named with it and set free as well."""
        if self.sums.max() < self.threshold:
            return ()
        t = np.where(
            self.sums > 0.5 * self.threshold, self._sum_score / np.sqrt(np.maximum(self._sum_weight, 1e-300)), 0.0
        )
        k = int(np.argmax(np.abs(t)))
        near = np.flatnonzero(np.abs(t) > np.sqrt(max(t[k] ** 2 - RIVAL_CHI_SQUARE, 0.0)))
        changes = self._change * self._sum_score / np.maximum(self._sum_weight, 1e-300)
        best: dict[int, float] = {}  # change of each bias that explains most
        for i in sorted(near.tolist(), key=lambda i: -abs(t[i])):
            best.setdefault(int(self._biases[self._sum_bias[i]]), float(changes[i]))
        names, (worst, *others) = self.instrument.names, best
        moved = MovedBias(
            name=names[worst],
            unit=self.instrument.units[worst],
            value=best[worst],
            u=float(abs(self._change[k]) / np.sqrt(self._sum_weight[k])),
            probability=min(1.0, self.rests * len(self.sums) * float(np.exp(-self.sums.max()))),
            others={names[j]: best[j] for j in others},
            rest=int(self._first[k]),
            since=float(self._since[k]),
        )
        free = np.array(list(best))
        self._P[1 + free, 1 + free] += self._limits[free] ** 2
        self.sums[:] = 0.0  # all begin anew
        return (moved,)

    def result(self, moved: tuple[MovedBias, ...] = ()) -> CheckResult:
        """Return the result of all rests so far as of a field check of one session with them.

        `moved` are the changes detected before. The parameters are the present ones at the reference temperature."""
        values, vectors = np.linalg.eigh(self._information)
        kept = values > RELATIVE_RANK * max(float(values[-1]), 1e-300)
        root, inverse = np.sqrt(values[kept]), vectors[:, kept]
        z = (inverse.T @ self._score) / root
        now = (self._columns == np.arange(1, self._constant)[:, None]).astype(float)
        in_run = slice(self._constant, self._constant + len(self._biases))
        now[:, in_run] = 0.0  # a recording that is corrected has other in-run biases

        def evidence_with(_: Sequence[int]) -> Evidence:
            return Evidence(
                z=z,
                G=(root * inverse).T,
                values=self._values + now @ self._x,
                covariance=now @ self._P @ now.T,
                by_x=now @ self._Phi,
                squares=self._squares - float(z @ z),
                degrees=self._degrees,
            )

        return changes_in(evidence_with, self.instrument, self._calibrated_u, moved)
