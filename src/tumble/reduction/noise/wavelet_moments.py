"""The noise of a sensor as a sum of processes: the generalised method of wavelet moments.

The Haar wavelet variance at a scale of τ is half the Allan variance σ²(τ). Independent processes add in it:

    σ²(τ) = 3 Q²/τ² + N²/τ + (2 ln 2/π) B² + K² τ/3 + R² τ²/2 + Σ σ² A(τ/T)                                     (1)
    A(x) = 2/x [1 − (3 − 4e⁻ˣ + e⁻²ˣ)/(2x)]

    Q  quantisation of the angle or velocity                                   rad, m/s
    N  white noise: angle or velocity random walk                              rad/√s, m/s/√s
    B  bias instability: flicker noise, S = B²/2πf                             rad/s, m/s²
    K  random walk of the rate, S = K²/(2πf)²                                  rad/s/√s, m/s²/√s
    R  ramp: a drift along a line                                              rad/s², m/s³
    σ, T  Gauss–Markov noise of this standard deviation and correlation time, S = 2σ²T/(1 + (2πfT)²); up to two

(IEEE Std 952-1997, annex C; S are two-sided). Means of neighbouring stretches differ by d_i(t), a second difference of
the integral x of the noise over m_i samples. With the generalised covariance G(h) of x, Q² δ, −N²|h|/2, K²|h|³/12,
B² h² ln|h|/2π, −σ²T (|h| + T e^{−|h|/T}), and w = (1, −2, 1),

    γ_ij(h) = E d_i(t) d_j(t + h) = Σ_ab w_a w_b G(h + b m_j − a m_i) / (m_i m_j)                               (2)
    C_ij = cov(σ̂_i², σ̂_j²) = Σ_h c_ij(h) (½ γ_ij(h)² + μ_i μ_j γ_ij(h)) / (M_i M_j)                            (3)

μ_i is what a ramp adds to d_i, M_i the number of d_i and c_ij(h) that of pairs h apart, both over all records: several
of them are one longer one. (3) is exact for normal noise. The sum over h is taken over panels that begin at the kinks
of (2) and grow away from them, by Gauss's rule where they are wide.

Moments σ̂² at octaves of τ are fitted by generalised least squares with C of the fitted noise (Guerrier et al.,
Wavelet-variance-based estimation for composite stochastic processes, JASA 108, 2013), in Wilson and Hilferty's cube
roots, which are normal with few degrees of freedom ν too:

    g_i = 3 s_i² [(σ̂_i²/s_i²)^⅓ − (σ_i²/s_i²)^⅓ (1 − 2/(9 ν_i))],  ν_i = 2 s_i⁴/C_ii,  Q = gᵀ C⁻¹ g → min      (4)

C being that of a sum with moments s_i², in the end that of the fitted one itself, s_i = σ_i.

Which processes there are, the data choose: of all sums, the one with the least Q + ln det C, −2 ln of the likelihood,
plus PENALTY for every process. The runner-up and by how much it is worse are part of the result. Where no sum fits
(probability of Q below MISFIT), the sensor does not follow (1), by filters and vibration: then C gets (MODEL_ERROR
σ_i²)² on its diagonal, and u is enlarged by what is left.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, combinations

import numpy as np
import scipy

from tumble.reduction.noise.allan_deviation import AllanDeviation
from tumble.units import Array, IntArray

MIN_SIZE = 4
"""Shorter clusters, in samples, are shown but not fitted: filters and the way samples are taken bend (1)."""
CLUSTERS = 8
"""The longest τ of the fit is this part of the longest record: with fewer, neighbouring moments are not normal
together, and one that is low by chance is taken for a Gauss–Markov process."""
MODEL_ERROR = 0.03
"""How far real sensors follow (1), as a part of σ²."""
MISFIT = 1e-3
"""Probability of Q below which no sum fits."""
LINEAR = ("quantisation", "white_noise", "bias_instability", "rate_random_walk", "ramp")
PENALTY = {"linear": 12.0, "gauss_markov": 28.0}
"""By so much −2 ln of the likelihood has to fall for a process: studies/noise_processes.py."""
TRIED = 6
"""Kinds of sums that are fitted, those that are best on a grid of correlation times."""
MOST_GAUSS_MARKOV = 2
VANISHED = 0.01
"""A process that adds less to Q has gone to zero: the sum is that of the others."""
FLICKER = 2.0 * np.log(2.0) / np.pi
EVERY_LAG = 4
"""Panels of (3) that are no wider, in samples, are summed lag by lag."""
_W = np.array([1.0, -2.0, 1.0])
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True, kw_only=True, slots=True)
class Coefficient:
    """A positive noise coefficient in SI and its standard uncertainty."""

    value: float
    u: float

    @property
    def interval(self) -> tuple[float, float]:
        """Of 95 %, the logarithm being normal."""
        wide = float(np.exp(1.96 * self.u / self.value))
        return self.value / wide, self.value * wide


@dataclass(frozen=True, kw_only=True, slots=True)
class GaussMarkov:
    """A bias that wanders about its mean: standard deviation σ and correlation time T, s."""

    sigma: Coefficient
    time: Coefficient


@dataclass(frozen=True, kw_only=True, slots=True)
class NoiseParameters:
    """The processes of (1) that one channel shows, in SI; None: it does not show it. `probability` is that of so large
    a misfit by chance; `runner_up` the next best sum in words, by `margin` worse, in −2 ln of the
    likelihood."""

    quantisation: Coefficient | None = None
    white_noise: Coefficient | None = None
    bias_instability: Coefficient | None = None
    rate_random_walk: Coefficient | None = None
    ramp: Coefficient | None = None
    gauss_markov: tuple[GaussMarkov, ...] = ()
    probability: float = 1.0
    runner_up: str = ""
    margin: float = 0.0

    @property
    def words(self) -> str:
        """Which processes these are."""
        return in_words([name for name in LINEAR if getattr(self, name) is not None], len(self.gauss_markov))

    def variances(self, tau: Array) -> dict[str, Array]:
        """What each process contributes to σ²(τ), (k,) each, by name."""
        named = zip(LINEAR, _slopes(tau, ()).T, strict=True)
        out = {name: a * c.value**2 for name, a in named if (c := getattr(self, name)) is not None}
        for i, process in enumerate(self.gauss_markov, 1):
            out[f"gauss_markov {i}"] = _slopes(tau, (process.time.value,))[:, -1] * process.sigma.value**2
        return out


def in_words(linear: Sequence[str], gauss_markov: int) -> str:
    """A sum of processes in words."""
    words = [name.replace("_", " ") for name in linear]
    words += [] if not gauss_markov else ["Gauss–Markov noise" if gauss_markov == 1 else "two Gauss–Markov processes"]
    return " + ".join(words) or "no noise"


def _slopes(tau: Array, times: Sequence[float]) -> Array:
    """Columns (k, n) of (1): what processes of unit coefficients contribute to σ²(τ)."""
    columns = [3.0 / tau**2, 1.0 / tau, np.full_like(tau, FLICKER), tau / 3.0, 0.5 * tau**2]
    for T in times:
        x = tau / T
        bump = 2.0 / x * (1.0 + (4.0 * np.exp(-x) - np.exp(-2.0 * x) - 3.0) / (2.0 * x))
        columns.append(np.where(x < 1e-3, 2.0 * x / 3.0, bump))
    return np.column_stack(columns)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Moments:
    """Octaves `sizes` (k,) of records of so many samples each, in units of the interval of the samples."""

    sizes: IntArray
    counts: tuple[int, ...]

    @property
    def tau(self) -> Array:
        """The octaves (k,) as numbers."""
        return self.sizes.astype(float)

    @cached_property
    def pairs(self) -> tuple[Array, Array]:
        """The sizes m_i and m_j (p, 1) of every pair i ≤ j."""
        i, j = np.triu_indices(len(self.sizes))
        return self.tau[i, None], self.tau[j, None]

    @cached_property
    def lags(self) -> tuple[Array, Array, Array]:
        """For every pair of sizes the lags h of (3) and their weights c dh/(M_i M_j), both (p, n), and the lags
        (p, n, 9) of G in (2)."""
        m_i, m_j = self.pairs
        far = 2.0 * max(self.counts)
        growth = np.concatenate([[0.25, 0.5, 0.75, 1.0, 1.5], 2.0 ** np.arange(1, 1 + np.ceil(np.log2(far)))])
        grids, dense = [], np.arange(EVERY_LAG)
        for m, n in np.hstack([m_i, m_j]).tolist():
            kinks = np.unique([a * m - b * n for a in range(3) for b in range(3)])
            steps = np.concatenate([[1.0], np.round(m * growth[m * growth < far])])
            edges = np.unique(np.concatenate([kinks, *(kinks + s for s in steps), *(kinks - s for s in steps)]))
            start, width = edges[:-1], np.diff(edges)
            each, wide = width <= EVERY_LAG, width > EVERY_LAG
            single = start[each, None] + np.where(dense < width[each, None], dense, np.nan)
            half = 0.5 * width[wide, None]
            nodes = start[wide, None] - 0.5 + half * (1.0 + _NODES)  # from half a lag before: sums are midpoint rules
            lag = np.concatenate([single.ravel(), nodes.ravel()])
            dh = np.concatenate([np.ones(single.size), (half * _WEIGHTS).ravel()])
            grids.append((lag[np.isfinite(lag)], dh[np.isfinite(lag)]))
        longest = max(len(lag) for lag, _ in grids)
        h, dh = (np.array([np.pad(g[i], (0, longest - len(g[i]))) for g in grids]) for i in (0, 1))
        M = [[np.maximum(count + 1.0 - 2.0 * m, 0.0) for m in self.pairs] for count in self.counts]
        pairs_apart = sum(np.maximum(np.minimum(M_i, M_j - h) - np.maximum(0.0, -h), 0.0) for M_i, M_j in M)
        M_i, M_j = (sum(each) for each in zip(*M, strict=True))
        weight = pairs_apart * dh / (M_i * M_j)
        kept = weight.any(axis=0)
        shifts = (m_j[..., None] * np.arange(3) - m_i[..., None] * np.arange(3)[:, None]).reshape(-1, 1, 9)
        return h[:, kept], weight[:, kept], h[:, kept, None] + shifts

    def _second_differences(self, G: Array) -> Array:
        """γ (p, n) of values of G (p, n, 9)."""
        m_i, m_j = self.pairs
        return np.asarray(G @ np.outer(_W, _W).ravel() / (m_i * m_j))

    @cached_property
    def linear(self) -> Array:
        """γ (4, p, n) of unit Q, N, B and K. Where the stretches of (2) do not overlap γ of N and K is exactly zero."""
        (h, _, shifted), (m_i, m_j) = self.lags, self.pairs
        size, overlap = np.abs(shifted), np.where((h > -2.0 * m_j) & (h < 2.0 * m_i), 1.0, 0.0)
        near = np.where(size < 0.5, 1.0, 0.0)  # δ of whole lags, whose squares have to add up too
        logarithm = size**2 * np.log(np.maximum(size, 1e-12)) / (2.0 * np.pi)
        Q, N, B, K = map(self._second_differences, (near, -0.5 * size, logarithm, size**3 / 12.0))
        return np.array([Q, N * overlap, B, K * overlap])

    def gauss_markov(self, T: float) -> Array:
        """γ (p, n) of Gauss–Markov noise of unit variance."""
        tail = self._second_differences(-(T**2) * np.exp(-np.abs(self.lags[2]) / T))
        return np.asarray(2.0 * T * self.linear[1] + tail)

    def covariance(self, squares: Array, times: Sequence[float]) -> Array:
        """C (k, k) of (3) for squares of the coefficients, and correlation times in samples."""
        gamma = np.tensordot(squares[:4], self.linear, 1)
        for square, T in zip(squares[5:], times, strict=True):
            if square > 0.0:
                gamma = gamma + square * self.gauss_markov(T)
        by_ramps, out = squares[4] * np.multiply(*self.pairs), np.empty((len(self.sizes),) * 2)
        i, j = np.triu_indices(len(self.sizes))
        out[i, j] = out[j, i] = np.sum(self.lags[1] * (0.5 * gamma**2 + by_ramps * gamma), axis=1)
        return out


def identify(deviation: AllanDeviation) -> tuple[NoiseParameters, ...]:
    """Find the noise processes of each channel of one record, or of several records together.

    Parameters
    ----------
    deviation : AllanDeviation
        Of one record, or pooled over several (`pooled`).

    Returns
    -------
    tuple of NoiseParameters
        The processes of each channel.
    """
    sizes = np.round(deviation.tau / deviation.tau[0]).astype(np.int64)
    longest = max(2 * MIN_SIZE, max(deviation.counts) // CLUSTERS)
    used = (sizes >= MIN_SIZE) & (sizes <= longest) & (sizes & (sizes - 1) == 0)
    moments = _Moments(sizes=sizes[used], counts=deviation.counts)
    return tuple(_identify(variance, moments, float(deviation.tau[0])) for variance in deviation.deviation[used].T ** 2)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Fit:
    """A fitted sum of processes.

    `squares`: squares (5 + n,) of the coefficients, those of LINEAR, zero where the sum has none, and of n
    Gauss–Markov processes. `times`: correlation times of these, in samples. `misfit`: Q. `deviance`: −2 ln of the
    likelihood. `u`: standard uncertainties of the logarithms of the squares that are not zero, and of the times."""

    squares: Array
    times: tuple[float, ...]
    misfit: float = 0.0
    deviance: float = 0.0
    u: Array = field(default_factory=lambda: np.empty(0))

    @property
    def active(self) -> IntArray:
        """The indices of the squares that are not zero."""
        return np.flatnonzero(self.squares)

    @property
    def cost(self) -> float:
        """The deviance with the penalties of the processes, which is least for the sum that is chosen."""
        linear = len(self.active) - len(self.times)
        return self.deviance + PENALTY["linear"] * linear + PENALTY["gauss_markov"] * len(self.times)

    @property
    def words(self) -> str:
        """The names of the processes."""
        return in_words([LINEAR[j] for j in self.active if j < len(LINEAR)], len(self.times))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Weighting:
    """The weighting of moments by the covariance C of a sum with variances `model` (k,).

    `root`: Cholesky factor of C. `freedom`: degrees of freedom (k,) of the moments."""

    root: Array
    freedom: Array
    model: Array

    @staticmethod
    def by(fit: _Fit, moments: _Moments, error: float) -> _Weighting:
        """The weighting by C of a sum, which describes a sensor to the part `error` of σ²."""
        model = _slopes(moments.tau, fit.times) @ fit.squares
        C, least = moments.covariance(fit.squares, fit.times) + np.diag((error * model) ** 2), 0.0
        while True:  # of readings in motion, moments may be those of one movement: C is singular but for rounding
            try:
                regular = C + least * np.diag(model**2)
                root = np.asarray(np.linalg.cholesky(regular))
                return _Weighting(root=root, freedom=2.0 * model**2 / np.diag(regular), model=model)
            except np.linalg.LinAlgError:
                if least > 1.0:
                    raise
                least = max(10.0 * least, 1e-12)

    def residuals(self, variance: Array, model: Array) -> tuple[Array, Array]:
        """g (k,) of (4) for a model, and minus its derivative by that (k,)."""
        cube, scale = 1.0 - 2.0 / (9.0 * self.freedom), np.cbrt(self.model) ** 2
        g = 3.0 * scale * (np.cbrt(variance) - cube * np.cbrt(model))
        return g, cube * scale / np.cbrt(model) ** 2


def _identify(variance: Array, moments: _Moments, interval: float) -> NoiseParameters:
    """The processes of one channel, of moments (k,) at octaves; `interval` of the samples, s."""
    if not variance.all():
        return NoiseParameters()
    for error in (0.0, MODEL_ERROR):
        best, runner_up = _best_two(variance, moments, error)
        freedom = len(variance) - len(best.u)
        probability = float(scipy.special.chdtrc(freedom, best.misfit)) if freedom > 0 else 1.0
        if probability > MISFIT:
            break
    wider = np.sqrt(best.misfit / freedom) if probability < MISFIT else 1.0
    units = interval ** np.array([1.0, 0.5, 0.0, -0.5, -1.0, *(0.0 for _ in best.times)])  # from those of one sample
    values = np.sqrt(best.squares) * units
    coefficients = {
        int(j): Coefficient(value=float(values[j]), u=float(0.5 * u * wider * values[j]))
        for j, u in zip(best.active, best.u, strict=False)
    }
    processes = [
        GaussMarkov(sigma=coefficients[5 + i], time=Coefficient(value=T * interval, u=float(T * interval * u * wider)))
        for i, (T, u) in enumerate(zip(best.times, best.u[len(best.active) :], strict=True))
    ]
    return NoiseParameters(
        **{LINEAR[j]: coefficient for j, coefficient in coefficients.items() if j < len(LINEAR)},
        gauss_markov=tuple(sorted(processes, key=lambda process: process.time.value)),
        probability=probability,
        runner_up="" if runner_up is None else runner_up.words,
        margin=0.0 if runner_up is None else runner_up.cost - best.cost,
    )


def _best_two(variance: Array, moments: _Moments, error: float) -> tuple[_Fit, _Fit | None]:
    """The sum of least cost, and the next best of another kind, each fitted with its own C.

    The kinds that are fitted are the TRIED best on a grid of correlation times, first with C of a smooth curve, which
    is the non-negative fit of all processes together, and then with C of the best of them."""
    from scipy.optimize import nnls

    tau, grid = moments.tau, tuple(moments.tau[:-1].tolist())
    columns = _slopes(tau, grid) / (np.sqrt(tau) * variance)[:, None]
    size = np.linalg.norm(columns, axis=0)
    smooth = _Fit(squares=nnls(columns / size, 1.0 / np.sqrt(tau))[0] / size, times=grid)
    weighting, begun, fitted = _Weighting.by(smooth, moments, error), set[str](), dict[str, tuple[_Fit, _Weighting]]()
    for _ in range(2):
        for start in sorted(_by_grid(variance, tau, grid, weighting), key=lambda each: each.cost)[:TRIED]:
            if start.words not in begun:
                begun.add(start.words)
                fit, by_itself = _refitted(variance, moments, error, start, weighting)
                if fit.words not in fitted or fit.cost < fitted[fit.words][0].cost:
                    fitted[fit.words] = fit, by_itself
        ordered = sorted(fitted.values(), key=lambda each: each[0].cost)
        weighting = ordered[0][1]
    return ordered[0][0], ordered[1][0] if len(ordered) > 1 else None


def _refitted(
    variance: Array, moments: _Moments, error: float, start: _Fit, weighting: _Weighting
) -> tuple[_Fit, _Weighting]:
    """The fit of a sum with its own C, without the processes whose coefficients go to zero, and the weighting by C."""
    fit, last = _fitted(variance, moments.tau, start, weighting), np.inf
    for _ in range(6):
        contributions = np.linalg.solve(weighting.root, _slopes(moments.tau, fit.times) * fit.squares)
        stays = np.sum(contributions**2, axis=0) > VANISHED
        stays_in_time = stays[len(LINEAR) :]
        squares = np.where(stays, fit.squares, 0.0)[np.r_[np.full(len(LINEAR), True), stays_in_time]]
        fit = replace(fit, squares=squares, times=tuple(np.array(fit.times)[stays_in_time].tolist()))
        if set(fit.active.tolist()) <= {LINEAR.index("ramp")}:  # which is no noise
            return replace(fit, deviance=np.inf, u=np.empty(0)), weighting
        weighting = _Weighting.by(fit, moments, error)
        fit = _fitted(variance, moments.tau, fit, weighting)
        if abs(fit.deviance - last) < 0.02:
            break
        last = fit.deviance
    return fit, weighting


def _by_grid(variance: Array, tau: Array, grid: tuple[float, ...], weighting: _Weighting) -> list[_Fit]:
    """Of every kind of sum the best with correlation times of the grid, by linear least squares."""
    A = np.linalg.solve(weighting.root, _slopes(tau, grid))
    y = np.linalg.solve(weighting.root, weighting.residuals(variance, weighting.model)[0] + weighting.model)
    size = np.linalg.norm(A, axis=0)
    A = A / size
    normal, right, out = A.T @ A + 1e-12 * np.eye(len(size)), A.T @ y, []
    for n in range(1 + MOST_GAUSS_MARKOV):
        chosen = list(combinations(range(5, 5 + len(grid)), n))
        times = np.array(chosen, dtype=int).reshape(len(chosen), n)
        for linear in chain.from_iterable(combinations(range(5), r) for r in range(6)):
            if not 0 < len(linear) + 2 * n <= len(y) - (n > 0) or not len(times):
                continue
            at = np.hstack([np.tile(np.array(linear, dtype=int), (len(times), 1)), times])
            squares = np.linalg.solve(normal[at[:, :, None], at[:, None, :]], right[at][..., None])[..., 0]
            Q = y @ y - np.sum(squares * right[at], axis=1)
            k = int(np.argmin(np.where(np.all(squares > 0.0, axis=1), Q, np.inf)))
            if np.all(squares[k] > 0.0):
                every = np.zeros(5 + n)
                every[list(linear)], every[5:] = np.split(squares[k] / size[at[k]], [len(linear)])
                out.append(_Fit(squares=every, times=tuple(grid[j - 5] for j in times[k]), deviance=float(Q[k])))
    return out


def _fitted(variance: Array, tau: Array, start: _Fit, weighting: _Weighting) -> _Fit:
    """The fit of a sum by steps of Gauss and Newton in the logarithms of squares and times."""
    active, squares, logs = start.active, start.squares.copy(), np.log(np.array(start.times))
    for _ in range(40):
        columns = _slopes(tau, tuple(np.exp(logs)))
        D = (columns * squares)[:, active]
        if len(logs):
            later = _slopes(tau, tuple(1.001 * np.exp(logs)))
            D = np.hstack([D, (later - columns)[:, 5:] * squares[5:] / np.log(1.001)])
        g, derivative = weighting.residuals(variance, columns @ squares)
        design, residuals = np.linalg.solve(weighting.root, derivative[:, None] * D), np.linalg.solve(weighting.root, g)
        step = np.clip(np.linalg.lstsq(design, residuals, rcond=1e-10)[0], -0.7, 0.7)
        if np.abs(step).max() < 1e-4:
            break
        squares[active] *= np.exp(step[: len(active)])
        logs = np.clip(logs + step[len(active) :], np.log(0.5 * tau[0]), np.log(tau[-1]))
    u = np.linalg.norm(np.linalg.pinv(design), axis=1)
    misfit = float(residuals @ residuals)
    deviance = misfit + 2.0 * float(np.log(np.diag(weighting.root)).sum())
    return _Fit(squares=squares, times=tuple(np.exp(logs).tolist()), misfit=misfit, deviance=deviance, u=u)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Panel:
    """Noise of the sensors `channels` (c,) of one kind, in "rad/s" or "m/s^2": deviation and processes."""

    title: str
    unit: str
    channels: tuple[str, ...]
    deviation: AllanDeviation
    parameters: tuple[NoiseParameters, ...]
