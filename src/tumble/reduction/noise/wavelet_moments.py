"""Sensor noise as a sum of processes, by the generalised method of wavelet moments.

The Haar wavelet variance at a scale of τ is half the Allan variance σ²(τ). Independent processes add up in it:

    σ²(τ) = 3 Q²/τ² + N²/τ + (2 ln 2/π) B² + K² τ/3 + R² τ²/2 + Σ σ² A(τ/T)                                     (1)
    A(x) = 2/x [1 − (3 − 4e⁻ˣ + e⁻²ˣ)/(2x)]

    Q  quantisation of the angle or velocity                                   rad, m/s
    N  white noise: angle or velocity random walk                              rad/√s, m/s/√s
    B  bias instability: flicker noise, S = B²/2πf                             rad/s, m/s²
    K  random walk of the rate, S = K²/(2πf)²                                  rad/s/√s, m/s²/√s
    R  ramp: a linear drift                                                    rad/s², m/s³
    σ, T  Gauss–Markov noise of this standard deviation and correlation time, S = 2σ²T/(1 + (2πfT)²); at most two

(IEEE Std 952-1997, annex C; S are two-sided). Means of neighbouring stretches differ by d_i(t), a second difference of
the integral x of the noise over m_i samples. With the generalised covariance G(h) of x, which is Q² δ, −N²|h|/2,
K²|h|³/12, B² h² ln|h|/2π, −σ²T (|h| + T e^{−|h|/T}), and w = (1, −2, 1),

    γ_ij(h) = E d_i(t) d_j(t + h) = Σ_ab w_a w_b G(h + b m_j − a m_i) / (m_i m_j)                               (2)
    C_ij = cov(σ̂_i², σ̂_j²) = Σ_h c_ij(h) (½ γ_ij(h)² + μ_i μ_j γ_ij(h)) / (M_i M_j)                            (3)

μ_i is the contribution of a ramp to d_i, M_i the number of d_i and c_ij(h) the number of pairs with lag h, both over
all records. (3) is exact for normal noise. The sum over h is divided into panels that begin at the kinks of (2) and
grow away from them; wide panels use Gauss's rule.

Moments σ̂² at octaves of τ are fitted by generalised least squares with C of the fitted noise (Guerrier et al.,
Wavelet-variance-based estimation for composite stochastic processes, JASA 108, 2013), in Wilson and Hilferty's cube
roots, which are normal even for few degrees of freedom ν:

    g_i = 3 s_i² [(σ̂_i²/s_i²)^⅓ − (σ_i²/s_i²)^⅓ (1 − 2/(9 ν_i))],  ν_i = 2 s_i⁴/C_ii,  Q = gᵀ C⁻¹ g → min      (4)

where C belongs to a sum with moments s_i², which is finally the fitted one, s_i = σ_i.

The processes are selected by the data: of all sums, the one with the least Q + ln det C, −2 ln of the likelihood, plus
PENALTY for every process. The runner-up and its margin are part of the result. If no sum fits (probability of Q below
MISFIT_PROBABILITY), the sensor does not follow (1), because of filters and vibration: then C gets (MODEL_ERROR σ_i²)²
on its diagonal, and u is enlarged by the remaining misfit.

Navigation filters have two processes, white noise of density n and a bias random walk k (`filter_densities`):

    n² = N² + 3 Q²/Δ                                quantisation Q as white noise over one sample interval Δ
    k² = K² + Σ 2 σ²/T + 3 (2 ln 2/π)² B⁴/N²        initial growth of Gauss–Markov noise; a walk through the flat part
                                                    where it meets the white noise

and for several channels the largest of each. A ramp, as of a warm-up, is no noise: a filter follows it as a bias. If
no slow process was found, k is the largest that the Allan deviation allows, k² ≤ 3 σ²(τ)/τ for all τ.
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

MIN_SIZE = 4  # samples: shorter clusters are not fitted, since filters and the sampling bend (1)
CLUSTERS = 8
"""Clusters of the longest fitted τ in the longest record: with fewer, neighbouring moments are not jointly normal, and
one that is low by chance would count as a Gauss–Markov process."""
MODEL_ERROR = 0.03  # deviation of real sensors from (1), relative to σ²
MISFIT_PROBABILITY = 1e-3  # probability of Q below which no sum fits
LINEAR = ("quantisation", "white_noise", "bias_instability", "rate_random_walk", "ramp")
PENALTY = {"linear": 12.0, "gauss_markov": 28.0}  # in −2 ln of the likelihood per process: studies/noise_processes.py
MAX_FITTED = 6  # kinds of sums that are fitted, the best on a grid of correlation times
MAX_GAUSS_MARKOV = 2
VANISHED = 0.01  # contribution to Q below which a process counts as zero
FLICKER = 2.0 * np.log(2.0) / np.pi
LAG_BY_LAG = 4  # samples: panels of (3) up to this width are summed lag by lag
_W = np.array([1.0, -2.0, 1.0])
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True, kw_only=True, slots=True)
class Coefficient:
    """A positive noise coefficient in SI and its standard uncertainty."""

    value: float
    u: float

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval; the logarithm is normal."""
        wide = float(np.exp(1.96 * self.u / self.value))
        return self.value / wide, self.value * wide


@dataclass(frozen=True, kw_only=True, slots=True)
class GaussMarkov:
    """A bias that varies about its mean, with standard deviation σ and correlation time T, s."""

    sigma: Coefficient
    time: Coefficient


@dataclass(frozen=True, kw_only=True, slots=True)
class NoiseParameters:
    """The processes of (1) identified in one channel, in SI; None for those that are not.

    `probability`: of so large a misfit by chance. `runner_up`: the next best sum in words. `margin`: by how much it is
    worse, in −2 ln of the likelihood."""

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
        """Names of the processes."""
        return in_words([name for name in LINEAR if getattr(self, name) is not None], len(self.gauss_markov))

    def variances(self, tau: Array) -> dict[str, Array]:
        """Return the contribution of each process to σ²(τ) (k,), by name."""
        named = zip(LINEAR, _slopes(tau, ()).T, strict=True)
        out = {name: a * c.value**2 for name, a in named if (c := getattr(self, name)) is not None}
        for i, process in enumerate(self.gauss_markov, 1):
            out[f"gauss_markov {i}"] = _slopes(tau, (process.time.value,))[:, -1] * process.sigma.value**2
        return out


def in_words(linear: Sequence[str], gauss_markov: int) -> str:
    """Return a sum of processes in words."""
    words = [name.replace("_", " ") for name in linear]
    words += [] if not gauss_markov else ["Gauss–Markov noise" if gauss_markov == 1 else "two Gauss–Markov processes"]
    return " + ".join(words) or "no noise"


def _slopes(tau: Array, times: Sequence[float]) -> Array:
    """Return the columns (k, n) of (1): contributions of processes of unit coefficients to σ²(τ)."""
    columns = [3.0 / tau**2, 1.0 / tau, np.full_like(tau, FLICKER), tau / 3.0, 0.5 * tau**2]
    for T in times:
        x = tau / T
        bump = 2.0 / x * (1.0 + (4.0 * np.exp(-x) - np.exp(-2.0 * x) - 3.0) / (2.0 * x))
        columns.append(np.where(x < 1e-3, 2.0 * x / 3.0, bump))
    return np.column_stack(columns)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Moments:
    """Moments at octaves `sizes` (k,) of records with these numbers of samples, in units of the sample interval."""

    sizes: IntArray
    counts: tuple[int, ...]

    @property
    def tau(self) -> Array:
        """The octaves (k,) as numbers."""
        return self.sizes.astype(float)

    @cached_property
    def pairs(self) -> tuple[Array, Array]:
        """The sizes m_i and m_j (p, 1) of all pairs i ≤ j."""
        i, j = np.triu_indices(len(self.sizes))
        return self.tau[i, None], self.tau[j, None]

    @cached_property
    def lags(self) -> tuple[Array, Array, Array]:
        """For all pairs of sizes, the lags h of (3) and their weights c dh/(M_i M_j), both (p, n), and the lags (p, n,
        9) of G in (2)."""
        m_i, m_j = self.pairs
        far = 2.0 * max(self.counts)
        growth = np.concatenate([[0.25, 0.5, 0.75, 1.0, 1.5], 2.0 ** np.arange(1, 1 + np.ceil(np.log2(far)))])
        grids, each = [], np.arange(LAG_BY_LAG)
        for m, n in np.hstack([m_i, m_j]).tolist():
            kinks = np.unique([a * m - b * n for a in range(3) for b in range(3)])
            steps = np.concatenate([[0.0, 1.0], np.round(m * growth[m * growth < far])])
            edges = np.unique([np.add.outer(kinks, steps), np.subtract.outer(kinks, steps)])
            start, width = edges[:-1, None], np.diff(edges)[:, None]
            # nodes from half a lag before the start: sums are midpoint rules
            lag = np.where(width <= LAG_BY_LAG, start + each, start - 0.5 + 0.5 * width * (1.0 + _NODES))
            dh = np.where(width <= LAG_BY_LAG, each < width, 0.5 * width * _WEIGHTS)
            grids.append((lag[dh > 0.0], dh[dh > 0.0]))
        longest = max(len(lag) for lag, _ in grids)
        h, dh = (np.array([np.pad(g[i], (0, longest - len(g[i]))) for g in grids]) for i in (0, 1))
        M = [[np.maximum(count + 1.0 - 2.0 * m, 0.0) for m in self.pairs] for count in self.counts]
        pairs_apart = sum(np.maximum(np.minimum(M_i, M_j - h) - np.maximum(0.0, -h), 0.0) for M_i, M_j in M)
        M_i, M_j = (sum(counts) for counts in zip(*M, strict=True))
        weight = pairs_apart * dh / (M_i * M_j)
        kept = weight.any(axis=0)
        shifts = (m_j[..., None] * np.arange(3) - m_i[..., None] * np.arange(3)[:, None]).reshape(-1, 1, 9)
        return h[:, kept], weight[:, kept], h[:, kept, None] + shifts

    def _second_differences(self, G: Array) -> Array:
        """Return γ (p, n) from values of G (p, n, 9)."""
        m_i, m_j = self.pairs
        return np.asarray(G @ np.outer(_W, _W).ravel() / (m_i * m_j))

    @cached_property
    def linear(self) -> Array:
        """γ (4, p, n) of unit Q, N, B and K; exactly zero for N and K if the stretches of (2) do not overlap."""
        (h, _, shifted), (m_i, m_j) = self.lags, self.pairs
        size, overlap = np.abs(shifted), np.where((h > -2.0 * m_j) & (h < 2.0 * m_i), 1.0, 0.0)
        near = np.where(size < 0.5, 1.0, 0.0)  # δ of whole lags, whose squares have to add up too
        logarithm = size**2 * np.log(np.maximum(size, 1e-12)) / (2.0 * np.pi)
        Q, N, B, K = map(self._second_differences, (near, -0.5 * size, logarithm, size**3 / 12.0))
        return np.array([Q, N * overlap, B, K * overlap])

    def gauss_markov(self, T: float) -> Array:
        """Return γ (p, n) of Gauss–Markov noise of unit variance."""
        tail = self._second_differences(-(T**2) * np.exp(-np.abs(self.lags[2]) / T))
        return np.asarray(2.0 * T * self.linear[1] + tail)

    def covariance(self, squares: Array, times: Sequence[float]) -> Array:
        """Return C (k, k) of (3) for squared coefficients and correlation times in samples."""
        gamma = np.tensordot(squares[:4], self.linear, 1)
        for square, T in zip(squares[5:], times, strict=True):
            if square > 0.0:
                gamma = gamma + square * self.gauss_markov(T)
        by_ramps, out = squares[4] * np.multiply(*self.pairs), np.empty((len(self.sizes),) * 2)
        i, j = np.triu_indices(len(self.sizes))
        out[i, j] = out[j, i] = np.sum(self.lags[1] * (0.5 * gamma**2 + by_ramps * gamma), axis=1)
        return out


def identify(deviation: AllanDeviation) -> tuple[NoiseParameters, ...]:
    """Identify the noise processes of each channel of one record, or of several pooled records (`pooled`)."""
    sizes = np.round(deviation.tau / deviation.tau[0]).astype(np.int64)
    longest = max(2 * MIN_SIZE, max(deviation.counts) // CLUSTERS)
    used = (sizes >= MIN_SIZE) & (sizes <= longest) & (sizes & (sizes - 1) == 0)
    moments = _Moments(sizes=sizes[used], counts=deviation.counts)
    return tuple(_identify(variance, moments, float(deviation.tau[0])) for variance in deviation.deviation[used].T ** 2)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Fit:
    """A fitted sum of processes.

    `squares`: squared coefficients (5 + n,) of LINEAR, zero for those not in the sum, and of n Gauss–Markov processes.
    `times`: correlation times of these, in samples. `misfit`: Q. `deviance`: −2 ln of the likelihood. `u`: standard
    uncertainties of the logarithms of the nonzero squares and of the times."""

    squares: Array
    times: tuple[float, ...]
    misfit: float = 0.0
    deviance: float = 0.0
    u: Array = field(default_factory=lambda: np.empty(0))

    @property
    def active(self) -> IntArray:
        """Indices of the nonzero squares."""
        return np.flatnonzero(self.squares)

    @property
    def cost(self) -> float:
        """Deviance with the penalties of the processes, which the selected sum minimises."""
        linear = len(self.active) - len(self.times)
        return self.deviance + PENALTY["linear"] * linear + PENALTY["gauss_markov"] * len(self.times)

    @property
    def words(self) -> str:
        """Names of the processes."""
        return in_words([LINEAR[j] for j in self.active if j < len(LINEAR)], len(self.times))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Weighting:
    """Weighting of moments by the covariance C of a sum with variances `model` (k,).

    `root`: Cholesky factor of C. `freedom`: degrees of freedom of the moments (k,)."""

    root: Array
    freedom: Array
    model: Array

    @staticmethod
    def by(fit: _Fit, moments: _Moments, error: float) -> _Weighting:
        """Return the weighting by C of a fit, which describes a sensor up to the relative `error` of σ²."""
        model = _slopes(moments.tau, fit.times) @ fit.squares
        C, least = moments.covariance(fit.squares, fit.times) + np.diag((error * model) ** 2), 0.0
        while True:  # C may be singular if all moments stem from a single motion
            try:
                regular = C + least * np.diag(model**2)
                root = np.asarray(np.linalg.cholesky(regular))
                return _Weighting(root=root, freedom=2.0 * model**2 / np.diag(regular), model=model)
            except np.linalg.LinAlgError:
                if least > 1.0:
                    raise
                least = max(10.0 * least, 1e-12)

    def residuals(self, variance: Array, model: Array) -> tuple[Array, Array]:
        """Return g (k,) of (4) for a model, and minus its derivative by the model (k,)."""
        cube, scale = 1.0 - 2.0 / (9.0 * self.freedom), np.cbrt(self.model) ** 2
        g = 3.0 * scale * (np.cbrt(variance) - cube * np.cbrt(model))
        return g, cube * scale / np.cbrt(model) ** 2


def _identify(variance: Array, moments: _Moments, interval: float) -> NoiseParameters:
    """Return the processes of one channel from moments at octaves (k,); `interval` of the samples, s."""
    if not variance.all():
        return NoiseParameters()
    for error in (0.0, MODEL_ERROR):
        best, runner_up = _select(variance, moments, error)
        freedom = len(variance) - len(best.u)
        probability = float(scipy.special.chdtrc(freedom, best.misfit)) if freedom > 0 else 1.0
        if probability > MISFIT_PROBABILITY:
            break
    wider = np.sqrt(best.misfit / freedom) if probability < MISFIT_PROBABILITY else 1.0
    units = interval ** np.array([1.0, 0.5, 0.0, -0.5, -1.0, *(0.0 for _ in best.times)])  # from sample intervals to s
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


def _select(variance: Array, moments: _Moments, error: float) -> tuple[_Fit, _Fit | None]:
    """Return the sum of least cost, and the next best of another kind, each fitted with its own C.

    The MAX_FITTED best kinds on a grid of correlation times are fitted, first with C of a smooth curve, the
    non-negative fit of all processes together, and then with C of the best of them."""
    from scipy.optimize import nnls

    tau, grid = moments.tau, tuple(moments.tau[:-1].tolist())
    columns = _slopes(tau, grid) / (np.sqrt(tau) * variance)[:, None]
    size = np.linalg.norm(columns, axis=0)
    smooth = _Fit(squares=nnls(columns / size, 1.0 / np.sqrt(tau))[0] / size, times=grid)
    weighting = _Weighting.by(smooth, moments, error)
    tried, fitted = set[str](), dict[str, tuple[_Fit, _Weighting]]()  # sums in words; their fits with their weightings
    for _ in range(2):
        for start in sorted(_by_grid(variance, tau, grid, weighting), key=lambda fit: fit.cost)[:MAX_FITTED]:
            if start.words not in tried:
                tried.add(start.words)
                fit, own_weighting = _refitted(variance, moments, error, start, weighting)
                if fit.words not in fitted or fit.cost < fitted[fit.words][0].cost:
                    fitted[fit.words] = fit, own_weighting
        ordered = sorted(fitted.values(), key=lambda pair: pair[0].cost)
        weighting = ordered[0][1]
    return ordered[0][0], ordered[1][0] if len(ordered) > 1 else None


def _refitted(
    variance: Array, moments: _Moments, error: float, start: _Fit, weighting: _Weighting
) -> tuple[_Fit, _Weighting]:
    """Return the fit of a sum with its own C, without processes whose coefficients go to zero, and its weighting."""
    fit, last = _fitted(variance, moments.tau, start, weighting), np.inf
    for _ in range(6):
        contributions = np.linalg.solve(weighting.root, _slopes(moments.tau, fit.times) * fit.squares)
        kept = np.sum(contributions**2, axis=0) > VANISHED
        kept_times = kept[len(LINEAR) :]
        squares = np.where(kept, fit.squares, 0.0)[np.r_[np.full(len(LINEAR), True), kept_times]]
        fit = replace(fit, squares=squares, times=tuple(np.array(fit.times)[kept_times].tolist()))
        if set(fit.active.tolist()) <= {LINEAR.index("ramp")}:  # a ramp is no noise
            return replace(fit, deviance=np.inf, u=np.empty(0)), weighting
        weighting = _Weighting.by(fit, moments, error)
        fit = _fitted(variance, moments.tau, fit, weighting)
        if abs(fit.deviance - last) < 0.02:
            break
        last = fit.deviance
    return fit, weighting


def _by_grid(variance: Array, tau: Array, grid: tuple[float, ...], weighting: _Weighting) -> list[_Fit]:
    """Return the best sum of every kind with correlation times of the grid, by linear least squares."""
    A = np.linalg.solve(weighting.root, _slopes(tau, grid))
    y = np.linalg.solve(weighting.root, weighting.residuals(variance, weighting.model)[0] + weighting.model)
    size = np.linalg.norm(A, axis=0)
    A = A / size
    normal, right, out = A.T @ A + 1e-12 * np.eye(len(size)), A.T @ y, []
    for n in range(1 + MAX_GAUSS_MARKOV):
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
                coefficients = np.zeros(5 + n)
                coefficients[list(linear)], coefficients[5:] = np.split(squares[k] / size[at[k]], [len(linear)])
                out.append(_Fit(squares=coefficients, times=tuple(grid[j - 5] for j in times[k]), deviance=float(Q[k])))
    return out


def _fitted(variance: Array, tau: Array, start: _Fit, weighting: _Weighting) -> _Fit:
    """Return the Gauss–Newton fit of a sum in the logarithms of squares and times."""
    active, squares, logs = start.active, start.squares.copy(), np.log(np.array(start.times))
    for _ in range(40):
        columns = _slopes(tau, tuple(np.exp(logs)))
        D = (columns * squares)[:, active]
        if len(logs):
            shifted = _slopes(tau, tuple(1.001 * np.exp(logs)))
            D = np.hstack([D, (shifted - columns)[:, 5:] * squares[5:] / np.log(1.001)])
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
    """Noise of the sensors `channels` (c,) of one kind, in "rad/s" or "m/s^2": Allan deviation and processes."""

    title: str
    unit: str
    channels: tuple[str, ...]
    deviation: AllanDeviation
    parameters: tuple[NoiseParameters, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class FilterDensities:
    """White noise, SI/√Hz, and random walk of the bias, SI/s/√Hz, of one kind of sensor, the largest of its channels,
    and a sentence on each that is only an upper bound."""

    white: float
    walk: float
    bounds: tuple[str, ...] = ()


def filter_densities(panel: Panel, rate: float) -> FilterDensities:
    """Return the white noise and bias random walk that represent the noise of a kind of sensors."""
    high, tau = panel.deviation.high, panel.deviation.tau[:, None]
    white, walk, bounds = list[float](), list[float](), list[str]()
    for p in panel.parameters:
        coefficients = (p.quantisation, p.white_noise, p.bias_instability, p.rate_random_walk)
        Q, N, B, K = (0.0 if c is None else c.value for c in coefficients)
        white.append(N**2 + 3.0 * Q**2 * rate)
        walk.append(K**2 + sum(2.0 * process.sigma.value**2 / process.time.value for process in p.gauss_markov))
        walk[-1] += 3.0 * (FLICKER * B**2 / N) ** 2 if N else 0.0
    largest = []
    for term, squares, limits in (
        ("white noise", white, (high * np.sqrt(tau)).min(axis=0)),
        ("random walk", walk, (high * np.sqrt(3.0 / tau)).min(axis=0)),
    ):
        largest.append(float(np.where(squares, np.sqrt(squares), limits).max()))
        if 0.0 in squares:
            bounds.append(
                f"{term} of the {panel.title}: not seen in every channel, so the largest that the record allows is "
                "written; record longer"
            )
    return FilterDensities(white=largest[0], walk=largest[1], bounds=tuple(bounds))
