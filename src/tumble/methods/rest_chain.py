"""Whether a calibration still holds, rest after rest for a day: a field check of one rest at a time, with what the
rests before it have said, and a sequential test of whether the bias of a sensor has moved.

The state x is the deviation, from the calibration, of gravity and the parameters at its reference temperature, with
what turning on has changed, of the standard deviation s of `tumble.use.check` Eq. (1); of the in-run bias of every
sensor, a Gauss–Markov process of the usual σ and τ; and of how far biases and scale factors have wandered since,
another one, of the size s too, and so fast that within an hour it changes by what is usual of a drift d:

    x_{k+1} = F x_k + n,   F = diag(1, e^{−Δt/τ}, e^{−Δt/τ_s}),   τ_s = 2 s²/(d² · 1 h)                           (1)

So a bias that stays where it was turned on, and one that goes about as far within the day, are both as predicted; one
that leaves what turning on changes is not, however slowly. A rest leaves d = R x + n of
`tumble.methods.field_check` Eq. (1), and with the x̂ and P that are known before it

    z = L⁻¹ (d − R x̂),   G = L⁻¹ R,   L Lᵀ = 1 + R P Rᵀ,   x̂ ← x̂ + P Gᵀ z,   P ← A P,   A = 1 − P Gᵀ G       (2)

are of unit variance, and independent from rest to rest, as long as nothing has changed. Without the wandering the
first rest is judged as a field check of it alone; all together, with the information Γ = Σ Φᵀ Gᵀ G Φ and
γ = Σ Φᵀ Gᵀ z about x at the first, Φ the product of all F A before, as a field check of all of them in one session.

A change of a bias by a from some rest on is seen in the next ones as μ = G m, m the mean of what x̂ errs by: a in that
bias at the first, then F A m, for what is learned takes it up. The logarithm of the likelihood ratio of a rest is

    ℓ = |μ| ζ − |μ|²/2,   ζ = Φ⁻¹(T_ν(t)),   t = μᵀz / |μ|                                                        (3)

with Student's T_ν as in a field check, so that ζ is normal. For every bias, both signs and a of DETECTED times the u of
one rest, the ℓ are added from where the sum was last below zero (Page's CUSUM). As E e^ℓ = 1 given what was before, a
sum begun at any one of N rests exceeds h with a probability of at most e^−h (Ville), so that any of D sums does so
within N rests with at most N D e^−h: with

    h = ln(D · RESTS_APART)                                                                                       (4)

a false alarm comes in N rests with a probability of at most N / RESTS_APART: of 1000 rests, a long day, 1 %. ℓ is cut
at ALONE h, which makes E e^ℓ smaller: no single rest decides. A rest that is off by more than SUSPECT is not learned
from: where the next ones agree with it, that is a change, and the bias is set free within its limits; where they do
not, it was no rest. `studies/watched_days.py` counts false alarms, and rests until a change is found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from tumble.inference.estimate import DETERMINED, Fit
from tumble.methods.field_check import (
    AS_LIKELY,
    ChangedParameter,
    CheckPrior,
    CheckResult,
    Evidence,
    changes_in,
    measurement_update,
    session_information,
)
from tumble.methods.least_squares import normal_score
from tumble.reduction.observations import Observations
from tumble.sensors.parameters import group_name, limits_of, sensor_kind
from tumble.units import Array

RESTS_APART = 1e5
"""Rests from one false alarm to the next, on average, at least."""
DETECTED = (1.0, 2.0, 4.0)
"""Changes that are looked for, in u of one rest."""
ALONE = 0.6
"""Of what decides: so much of it one rest can say."""
SUSPECT = 5.0
"""|ζ| beyond which a rest is not learned from: by chance one of some 100,000 with six biases."""
HOUR = 3600.0
BIASES = ("accel.bias", "gyro.bias")
_LEAST = 1e-9
"""Of the largest eigenvalue of Γ: smaller ones are rounding."""


@dataclass(frozen=True, kw_only=True, slots=True)
class BiasTest:
    """By how much one rest has a bias off what is predicted for it, SI, with the standard uncertainty of that, and the
    deviation in standard normal numbers."""

    change: float
    u: float
    sigmas: float


@dataclass(frozen=True, kw_only=True, slots=True)
class MovedBias(ChangedParameter):
    """A bias that has moved: from which rest on, counted from 0, and since when, s."""

    rest: int
    since: float


@dataclass(frozen=True, kw_only=True, slots=True)
class JudgedRest:
    """One rest: its `tests` by bias as far as it sees them, χ² of what no change explains, whether it was learned from,
    and what is now known to have `moved`."""

    tests: Mapping[str, BiasTest]
    misfit: Fit
    learned: bool
    moved: tuple[MovedBias, ...] = ()


class RestChain:
    """Tests the rests of one power-on, one after the other.

    Parameters
    ----------
    prior
        The prior of the parameters before the first rest.
    drift
        Usual size of drifts by group of parameters, SI per s.
    rests_apart
        Mean number of rests from one false alarm to the next, at least.
    """

    def __init__(self, prior: CheckPrior, drift: Mapping[str, float], *, rests_apart: float = RESTS_APART) -> None:
        instrument, components = prior.instrument, prior.components
        names, m, linear = instrument.names, len(instrument.names), instrument.linear_count
        self.instrument, self._limits = instrument, limits_of(names)
        self._biases = biases = np.array([i for i, n in enumerate(names) if group_name(n) in BIASES], dtype=int)

        # x: what does not change within a power-on, in-run biases, wandering; of each what it is made anew by, and when
        kinds = [sensor_kind(names[i]) for i in biases]
        in_run, in_run_time = (
            np.array([getattr(components, f"{kind}_{what}") for kind in kinds]) for what in ("in_run", "time")
        )
        rate = np.array([drift.get(f"{group_name(name)}.drift", 0.0) for name in names[:linear]]) ** 2 * HOUR
        wanders = np.where(rate > 0.0, prior.turned_on[1 : 1 + linear], 0.0)
        wanders_time = np.maximum(2.0 * wanders / np.where(rate > 0.0, rate, np.inf), 1.0)
        turned_on_doubt = prior.turned_on * np.sqrt(prior.turned_on_inverse_degrees)
        self._constant = 1 + m
        self._time = np.concatenate([np.full(1 + m, np.inf), in_run_time, wanders_time])
        self._steady = np.concatenate([prior.turned_on, in_run**2, wanders])
        unsure = np.where(rate > 0.0, turned_on_doubt[1 : 1 + linear], 0.0)
        self._steady_doubt = np.concatenate([turned_on_doubt, 0.0 * in_run, unsure])
        self._columns = np.concatenate([np.arange(1 + m), 1 + biases, np.arange(1, 1 + linear)])
        """Which of gravity and the parameters each of x adds to."""
        back = np.linalg.inv(prior.to_temperature)
        calibrated = back @ prior.calibrated @ back.T
        n = len(self._steady)
        rest = np.zeros((n - 1 - m,) * 2)
        self._P = block_diag(calibrated, rest) + np.diag(self._steady)
        self._D = block_diag(prior.u_of_calibrated(calibrated), rest) + np.diag(self._steady_doubt)
        self._doubt, self._values = self._D[: 1 + m, : 1 + m], back[1:, 1:] @ prior.values
        self._x, self._Phi = np.zeros(n), np.eye(n)
        self._information, self._score = np.zeros((n, n)), np.zeros(n)
        self._squares = self._degrees = 0.0
        self._last: float | None = None
        self.rests = 0

        # the sums: of every bias, both signs, and every size
        signed = [sign * size for sign in (1.0, -1.0) for size in DETECTED]
        self._of = np.repeat(np.arange(len(biases)), len(signed))
        self._sizes = np.tile(signed, len(biases))
        self.threshold = float(np.log(len(self._of) * rests_apart))
        self._finest = np.full(len(biases), np.inf)
        self._forget()

    def _forget(self) -> None:
        """Begin all sums anew."""
        count = len(self._of)
        self.sums, self._mean = np.zeros(count), np.zeros((len(self._P), count))
        self._said, self._weight, self._change = np.zeros(count), np.zeros(count), np.zeros(count)
        self._begun: list[tuple[int, float]] = [(0, 0.0)] * count

    def add(self, observations: Observations, prior: CheckPrior, *, apart: float | None = None) -> JudgedRest:
        """Test the next rest.

        Parameters
        ----------
        observations
            The rest, alone.
        prior
            The prior of the parameters by the calibration at the temperature of the rest.
        apart
            Time (s) since the rest before, infinite after another power-on. By default the difference of their times.
        """
        rests = observations.rests
        start, middle = float(rests.start[0]), 0.5 * float(rests.start[0] + rests.stop[0])
        if self._last is not None:  # the processes go on for some time, Eq. (1)
            seconds = max(middle - self._last if apart is None else apart, 0.0)
            F = np.exp(-seconds / self._time) if np.isfinite(seconds) else np.where(np.isinf(self._time), 1.0, 0.0)
            anew = 1.0 - F**2
            anew[: self._constant] = 0.0 if np.isfinite(seconds) else 1.0
            self._x = F * self._x
            self._P = F[:, None] * self._P * F + np.diag(anew * self._steady)
            self._D = F[:, None] * self._D * F + np.diag(anew * self._steady_doubt)
            self._Phi, self._mean = F[:, None] * self._Phi, F[:, None] * self._mean
        self._last = middle
        still = replace(prior.components, accel_in_run=0.0, gyro_in_run=0.0)
        known = replace(prior, components=still)
        R, d, squares, degrees = session_information(observations, known, prior.covariance)
        R = (R @ prior.to_temperature)[:, self._columns]
        G, z, gain, A = measurement_update(R, d - R @ self._x, self._P)

        # the rest alone
        n = len(self._biases)
        alone = np.zeros((G.shape[1], n))
        alone[1 + self._biases, np.arange(n)] = 1.0
        size, t, zeta = self._along(G, z, alone)
        u = 1.0 / np.maximum(size, 1e-300)
        seen = u < self._limits[self._biases] / DETERMINED
        tests = {
            self.instrument.names[i]: BiasTest(change=float(t[k] * u[k]), u=float(u[k]), sigmas=float(zeta[k]))
            for k, i in enumerate(self._biases.tolist())
            if seen[k]
        }
        misfit = Fit(chi_square=squares + float(z @ z), degrees=float(degrees), scatter=0.0, unit="")
        learned = bool(np.all(np.abs(zeta[seen]) <= SUSPECT))

        # the sums
        self._finest = np.minimum(self._finest, np.where(seen, u, np.inf))
        change = self._sizes * self._finest[self._of]
        anew_sums = (self.sums <= 0.0) & np.isfinite(change)
        self._change[anew_sums], self._mean[:, anew_sums] = change[anew_sums], 0.0
        self._mean[1 + self._biases[self._of[anew_sums]], anew_sums] = change[anew_sums]
        for k in np.flatnonzero(anew_sums):
            self.sums[k] = self._said[k] = self._weight[k] = 0.0
            self._begun[k] = self.rests, start
        size, t, zeta = self._along(G, z, self._mean)
        self.sums += np.minimum(size * zeta - 0.5 * size**2, ALONE * self.threshold)
        self._said += size * t
        self._weight += size**2
        self.rests += 1

        # what is learned
        if learned:
            self._squares, self._degrees = self._squares + misfit.chi_square, self._degrees + degrees
            GPhi = G @ self._Phi
            self._information += GPhi.T @ GPhi
            self._score += GPhi.T @ z
            self._x = self._x + gain @ z
            P = A @ self._P
            self._P, self._D = 0.5 * (P + P.T), A @ self._D @ A.T
            self._Phi, self._mean = A @ self._Phi, A @ self._mean
        return JudgedRest(tests=tests, misfit=misfit, learned=learned, moved=self._moved())

    def _along(self, G: Array, z: Array, of: Array) -> tuple[Array, Array, Array]:
        """|μ|, t and ζ (k,) of Eq. (3) of changes (n, k) of the state."""
        mu = G @ of
        size = np.linalg.norm(mu, axis=0)
        along = mu / np.maximum(size, 1e-300)
        t = along.T @ z
        q = G.T @ along
        inverse = np.einsum("ik,ij,jk->k", q, self._D, q) ** 2
        return size, t, normal_score(t, 1.0 / np.maximum(inverse, 1e-12))

    def _moved(self) -> tuple[MovedBias, ...]:
        """What has moved where a sum decides: the bias that explains most of what came since its own sum began, with
        others that explain nearly as much, as Eq. (2) of a field check has it. All of these are set free."""
        if self.sums.max() < self.threshold:
            return ()
        t = np.where(self.sums > 0.5 * self.threshold, self._said / np.sqrt(np.maximum(self._weight, 1e-300)), 0.0)
        k = int(np.argmax(np.abs(t)))
        near = np.flatnonzero(np.abs(t) > np.sqrt(max(t[k] ** 2 - AS_LIKELY, 0.0)))
        changes = self._change * self._said / np.maximum(self._weight, 1e-300)
        best: dict[int, float] = {}  # of each bias that which explains most
        for i in sorted(near.tolist(), key=lambda i: -abs(t[i])):
            best.setdefault(int(self._biases[self._of[i]]), float(changes[i]))
        names, (worst, *others) = self.instrument.names, best
        moved = MovedBias(
            name=names[worst],
            unit=self.instrument.units[worst],
            value=best[worst],
            u=float(abs(self._change[k]) / np.sqrt(self._weight[k])),
            probability=min(1.0, self.rests * len(self.sums) * float(np.exp(-self.sums.max()))),
            others={names[j]: best[j] for j in others},
            rest=self._begun[k][0],
            since=self._begun[k][1],
        )
        free = np.array(list(best))
        self._P[1 + free, 1 + free] += self._limits[free] ** 2
        self._forget()
        return (moved,)

    def result(self, moved: tuple[MovedBias, ...] = ()) -> CheckResult:
        """What all rests so far say together, as a field check of one session with them; `moved` has what is known to
        have moved. Its parameters are those at the reference temperature as they are now."""
        values, vectors = np.linalg.eigh(self._information)
        kept = values > _LEAST * max(float(values[-1]), 1e-300)
        root, inverse = np.sqrt(values[kept]), vectors[:, kept]
        z = (inverse.T @ self._score) / root
        now = (self._columns == np.arange(1, self._constant)[:, None]).astype(float)
        in_run = slice(self._constant, self._constant + len(self._biases))
        now[:, in_run] = 0.0  # which a recording that is corrected has anew

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

        return changes_in(evidence_with, self.instrument, self._doubt, moved)
