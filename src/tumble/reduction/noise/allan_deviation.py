"""Allan deviation of a recording at rest, and the noise of the sensors that it shows.

The Allan variance at τ is half the mean square of the difference of neighbouring means over τ. Noise terms that
are independent add in it, each with its own slope:

    σ²(τ) = 3 Q²/τ² + N²/τ + (2 ln 2/π) B² + K² τ/3 + σ² A(τ/T)                                        (1)
    A(x) = 2/x [1 − (3 − 4e⁻ˣ + e⁻²ˣ)/(2x)]

    Q  quantisation of the angle or velocity             rad, m/s
    N  white noise: angle or velocity random walk        rad/√s = rad/s/√Hz, m/s/√s = m/s²/√Hz
    B  bias instability (flicker noise, S = B²/2πf)      rad/s, m/s²; the flat part is 0.664 B
    K  random walk of the rate (S = K²/(2πf)²)           rad/s/√s, m/s²/√s
    σ  Gauss–Markov noise (S = 2σ²T/(1 + (2πfT)²)) of correlation time T, exponentially correlated      rad/s, m/s²

Source: IEEE Std 952-1997, annex C; IEEE Std 1554-2005, annex D. S are two-sided spectral densities.

Estimates of σ² at neighbouring τ come from the same samples and are strongly correlated. The fit of (1) is
weighted by their variances 2σ⁴/ν, with ν the equivalent degrees of freedom; its uncertainties follow from their
full covariance, with the correlations ∫ S² W_i W_j df of the fitted spectrum S, where W is the transfer function
of the Allan variance.

Gauss–Markov noise has a bump, 0.62 σ at 1.9 T, which passes for a flat part where T is in the middle of the record,
and for a random walk where it is long. It is a term where it lowers the deviance, −2 ln of the likelihood, of the
fit of all others by GAUSS_MARKOV at its best T; then the terms that nothing is left for are no longer significant.

A steady drift (warm-up) is not a noise. It makes σ grow with τ and passes for a random walk.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import gammaincinv, ndtr

from tumble.brief import Brief
from tumble.errors import InputError
from tumble.reduction import kernels as _kernels
from tumble.units import ARCSEC, DEGREE, DEGREE_PER_HOUR, G_STANDARD, Array, rounded

SIZES_PER_OCTAVE = 4
MIN_SAMPLES = 32
MIN_CLUSTERS = 4
"""The longest τ is this part of the record."""
MIN_SIZE = 4
"""Shorter clusters, in samples, are shown but not fitted: filters and the way samples are taken bend (1)."""
SLOPE_ERROR = 0.03
"""How far real sensors follow (1), as a part of σ²: filters and vibration bend it at short τ, where the
statistical error is far smaller."""
SIGNIFICANCE = 4.0
"""A term is reported when its square is so many of the standard uncertainties it would have if it were absent."""

GAUSS_MARKOV = 25.0
"""By so much the deviance has to fall. In records of 1 to 3 hours it fell by up to 14 by chance, of white noise,
flicker noise and both with a random walk (about 80 records each); of a random walk alone by more than 25 in 2 of 82,
whose long clusters are few. By Gauss–Markov noise of 20 °/h beside 0.15 °/√h it fell in one hour by 100 to 180 (T = 5
and 30 s) and by 8 to 37 (T = 200 s), in two hours and this T by 43 in the median, in three by 45 to 104."""

FLICKER = 2.0 * np.log(2.0) / np.pi

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class AllanDeviation(Brief):
    """Overlapping Allan deviation of c channels at k averaging times.

    tau (k,) s; deviation (k, c) in the unit of the samples, with its 68 % confidence interval low … high (k, c)
    from χ² with `degrees` (k, c) equivalent degrees of freedom."""

    tau: Array
    deviation: Array
    degrees: Array
    low: Array
    high: Array


@dataclass(frozen=True, kw_only=True, slots=True)
class Coefficient:
    """A noise coefficient in SI and its standard uncertainty."""

    value: float
    u: float


@dataclass(frozen=True, kw_only=True, slots=True)
class NoiseParameters:
    """The terms of (1) that one channel shows, in SI; None: the record does not show it."""

    quantisation: Coefficient | None
    white_noise: Coefficient | None
    bias_instability: Coefficient | None
    rate_random_walk: Coefficient | None
    gauss_markov: Coefficient | None = None
    correlation_time: Coefficient | None = None
    """That of the Gauss–Markov noise, s; None without it."""

    def variances(self, tau: Array) -> dict[str, Array]:
        """The terms of (1), (k,) each, by name: what each noise contributes to σ²(τ)."""
        found = {name: getattr(self, name) for name in _TERMS}
        slopes = _slopes(tau, None if self.correlation_time is None else self.correlation_time.value).T
        return {
            name: column * coefficient.value**2
            for (name, coefficient), column in zip(found.items(), slopes, strict=False)
            if coefficient is not None
        }


_TERMS = ("quantisation", "white_noise", "bias_instability", "rate_random_walk", "gauss_markov")


def _slopes(tau: Array, correlation_time: float | None) -> Array:
    """Columns (k, 4 or 5) of (1): what unit Q, N, B, K and, of a correlation time, σ contribute to σ²(τ)."""
    columns = [3.0 / tau**2, 1.0 / tau, np.full_like(tau, FLICKER), tau / 3.0]
    if correlation_time is not None:
        x = tau / correlation_time
        columns.append(
            np.where(x < 1e-3, 2.0 * x / 3.0, 2.0 / x * (1.0 + (4.0 * np.exp(-x) - np.exp(-2.0 * x) - 3.0) / (2.0 * x)))
        )
    return np.column_stack(columns)


def allan_deviation(samples: Array, rate: float) -> AllanDeviation:
    """Overlapping Allan deviation of samples (m,) or (m, c) taken at a constant `rate` (Hz), at four averaging
    times an octave up to a quarter of the record. One channel is worked on at a time.

    Raises InputError for fewer than 32 samples or a value that is not a number.

    >>> import numpy as np, tumble
    >>> white = np.random.default_rng(1).normal(size=(10_000, 1))
    >>> found = tumble.allan_deviation(white, 100.0)
    >>> bool(abs(found.deviation[0, 0] * np.sqrt(found.tau[0]) - 0.1) < 0.01)
    True
    """
    if not 0.0 < rate < np.inf or np.ndim(samples) not in (1, 2):
        raise InputError(
            f"Allan deviation: expected samples of shape (m,) or (m, c) and a rate above 0 Hz, found the shape "
            f"{np.shape(samples)} and {rate:g} Hz"
        )
    columns = samples if samples.ndim == 2 else samples[:, None]
    count = len(columns)
    if count < MIN_SAMPLES:
        raise InputError(
            f"Allan deviation: expected at least {MIN_SAMPLES} samples at rest, found {count}; record longer"
        )
    sizes = _cluster_sizes(count)
    sums = np.column_stack([_kernels.allan_sums(_integral(c), sizes) for c in columns.T])
    terms = count + 1 - 2 * sizes
    deviation = np.sqrt(sums / (2.0 * terms * sizes.astype(float) ** 2)[:, None])
    tau = sizes / rate
    degrees = np.column_stack([_degrees(count + 1, sizes, _exponents(tau, d)) for d in deviation.T])
    low, high = (deviation * np.sqrt(0.5 * degrees / gammaincinv(0.5 * degrees, ndtr(z))) for z in (1.0, -1.0))
    return AllanDeviation(tau=tau, deviation=deviation, degrees=degrees, low=low, high=high)


def _cluster_sizes(count: int) -> IntArray:
    """Cluster sizes in samples: 1 … count/4, four an octave."""
    octaves = np.log2(count // MIN_CLUSTERS)
    steps = np.arange(int(SIZES_PER_OCTAVE * octaves) + 1)
    return np.unique(np.round(2.0 ** (steps / SIZES_PER_OCTAVE))).astype(np.int64)


def _integral(column: Array) -> Array:
    """Running sum (m + 1,) of the samples less their mean, from 0."""
    out = np.zeros(len(column) + 1)
    np.subtract(column, column[0], out=out[1:])  # a constant becomes exactly zero
    out[1:] -= out[1:].mean()
    np.cumsum(out[1:], out=out[1:])
    if not np.isfinite(out[-1]):
        raise InputError("Allan deviation: expected finite samples, found NaN or infinity; repair or cut the log")
    return out


def _exponents(tau: Array, deviation: Array) -> IntArray:
    """Exponent α (0, −1, −2: white noise, flicker, random walk) of the power law S ∝ f^α around each τ, from the
    slope −α − 1 of σ² over an octave to either side. Steeper slopes at short τ (quantisation) count as white,
    which understates their degrees of freedom where there are plenty."""
    if not deviation.all():
        return np.zeros(len(tau), dtype=np.int64)
    x, y = np.log2(tau), 2.0 * np.log2(deviation)
    slope = np.empty(len(tau))
    for i, centre in enumerate(x):
        near = np.abs(x - centre) < 1.01
        slope[i] = np.polyfit(x[near] - centre, y[near], 1)[0]
    return -np.searchsorted([-0.5, 0.5], slope)


def _degrees(points: int, sizes: IntArray, exponents: IntArray) -> Array:
    """Equivalent degrees of freedom (k,) of overlapping estimates from so many points of the integral.

    Source: Riley, Handbook of Frequency Stability Analysis (NIST SP 1065), table 5."""
    n, m = float(points), sizes.astype(float)
    white = (1.5 * (n - 1.0) / m - 2.0 * (n - 2.0) / n) * 4.0 * m**2 / (4.0 * m**2 + 5.0)
    flicker = np.where(m == 1.0, 2.0 * (n - 2.0) ** 2 / (2.3 * n - 4.9), 5.0 * n**2 / (4.0 * m * (n + 3.0 * m)))
    walk = (n - 2.0) / m * ((n - 1.0) ** 2 - 3.0 * m * (n - 1.0) + 4.0 * m**2) / (n - 3.0) ** 2
    return np.asarray(np.select([exponents == 0, exponents == -1], [white, flicker], walk))


def identify(adev: AllanDeviation) -> tuple[NoiseParameters, ...]:
    """The noise terms of each channel: non-negative weighted least squares of (1), in which every term has to
    prove itself significant. Uncertainties come from the full covariance of the estimates of σ², and are
    enlarged where (1) does not fit."""
    used = adev.tau > (MIN_SIZE - 0.5) * adev.tau[0]
    transfer = _Transfer.of(adev.tau[0], adev.tau[used])
    return tuple(
        _identify(_Fit(variance=variance, degrees=degrees, transfer=transfer))
        for variance, degrees in zip(adev.deviation[used].T ** 2, adev.degrees[used].T, strict=True)
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Transfer:
    """Integrals `products` (f, k, k) of W_i W_j over bands of frequency an eighth of an octave wide, over which no
    spectrum changes much, W being the transfer functions of the Allan variance at averaging times tau (k,); in the
    middle of each band, Hz, the `spectra` (f, n) of the terms of (1) at unit coefficients, four or with the
    Gauss–Markov noise five; and what these contribute to σ², the `columns` (k, n)."""

    tau: Array
    products: Array
    frequencies: Array
    spectra: Array
    columns: Array

    @classmethod
    def of(cls, interval: float, tau: Array) -> _Transfer:
        """For averaging times `tau` that are multiples of the interval of the samples."""
        lowest, highest, each = 0.01 / tau[-1], 0.5 / interval, 8
        bands = int(8 * np.log2(highest / lowest))
        edges = np.geomspace(lowest, highest, each * bands + 1)
        f = np.sqrt(edges[1:] * edges[:-1])
        sine = np.sin(np.pi * f * interval)
        W = np.sin(np.pi * np.outer(tau, f)) ** 4 / np.outer(tau / interval, sine) ** 2
        parts = W.reshape(len(tau), bands, each)
        products = np.einsum("ibf,jbf->bij", parts * np.diff(edges).reshape(bands, each), parts)
        middle = np.sqrt(edges[:-each:each] * edges[each::each])
        omega, sine = 2.0 * np.pi * middle, np.sin(np.pi * middle * interval)
        spectra = np.column_stack([4.0 * sine**2 / interval, np.ones_like(omega), 1.0 / omega, 1.0 / omega**2])
        columns = _slopes(tau, None)
        return cls(tau=tau, products=products, frequencies=middle, spectra=spectra, columns=columns)

    def with_gauss_markov(self, T: float) -> _Transfer:
        """The same with Gauss–Markov noise of correlation time T."""
        spectrum = 2.0 * T / (1.0 + (2.0 * np.pi * self.frequencies * T) ** 2)
        spectra = np.column_stack([self.spectra[:, :4], spectrum])
        return replace(self, spectra=spectra, columns=_slopes(self.tau, T))

    def correlation(self, squares: Array) -> Array:
        """Correlation matrix (k, k) of the estimates of σ² for the squares (n,) of the coefficients."""
        covariance = np.einsum("b,bij->ij", (self.spectra @ squares) ** 2, self.products)
        scale = np.sqrt(np.diag(covariance))
        return np.asarray(covariance / np.outer(scale, scale)) if scale.all() else np.eye(len(scale))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Fit:
    """Estimates of σ² of one channel and their degrees of freedom (k,), to be fitted by (1), with Gauss–Markov noise
    of a correlation time, s, or without it."""

    variance: Array
    degrees: Array
    transfer: _Transfer
    correlation_time: float | None = None

    def squares(self, active: Sequence[int]) -> Array:
        """Squares (n,) of the coefficients, zero where not active: non-negative least squares, weighted by the
        fitted σ² and not by the data, where an estimate that is low by chance would gain weight by it."""
        from scipy.optimize import nnls

        columns = self.transfer.columns[:, active]
        model, out = self.variance, np.zeros(self.transfer.columns.shape[1])
        for _ in range(8):
            weight = 1.0 / (self._relative() * model)
            design = columns * weight[:, None]
            size = np.linalg.norm(design, axis=0)
            scaled, _ = nnls(design / size, self.variance * weight)
            out[active] = scaled / size
            model = np.maximum(columns @ out[active], 1e-300)
        return out

    def about(self, squares: Array, active: Sequence[int]) -> tuple[Array, Array, float]:
        """Least squares with weights and covariance as the noise `squares` (n,) would have them: estimates of the
        active squares, their standard uncertainties, and χ² over what it should be. A correlation time is estimated
        with the squares: the last standard uncertainty is that of its logarithm."""
        model = self.transfer.columns @ squares
        weight = 1.0 / (self._relative() * model)
        columns = self.transfer.columns[:, active]
        if 4 in active and self.correlation_time is not None and squares[4] > 0.0:
            longer, shorter = (
                _slopes(self.transfer.tau, self.correlation_time * np.exp(d))[:, 4] for d in (0.01, -0.01)
            )
            columns = np.column_stack([columns, squares[4] * (longer - shorter) / 0.02])
        design = columns * weight[:, None]
        size = np.linalg.norm(design, axis=0)
        solver = np.linalg.pinv(design / size)
        covariance = self._covariance(squares) * np.outer(1.0 / self._relative(), 1.0 / self._relative())
        residual_of = np.eye(len(model)) - design / size @ solver
        misfit = np.sum((residual_of @ (self.variance * weight)) ** 2) / np.trace(residual_of @ covariance)
        u = np.sqrt(np.diag(solver @ covariance @ solver.T))
        return solver @ (self.variance * weight) / size, u / size, float(misfit)

    def gauss_markov(self) -> _Fit:
        """The fit with Gauss–Markov noise among its terms, of the most likely correlation time, where that lowers the
        deviance of the four others by GAUSS_MARKOV; the same fit where it does not."""
        from scipy.optimize import minimize_scalar

        def of_time(log_time: float) -> _Fit:
            T = float(np.exp(log_time))
            return replace(self, transfer=self.transfer.with_gauss_markov(T), correlation_time=T)

        first, last = np.log(self.transfer.tau[0]), np.log(0.5 * self.transfer.tau[-1])
        times = np.arange(first, max(last, first + 1e-9), np.log(2.0))
        nearest = times[int(np.argmin([of_time(t).deviance() for t in times]))]
        bounds = max(first, nearest - 1.0), min(last, nearest + 1.0)
        likeliest = of_time(minimize_scalar(lambda t: of_time(t).deviance(), bounds=bounds, options={"xatol": 0.02}).x)
        return likeliest if self.deviance() - likeliest.deviance() > GAUSS_MARKOV else self

    def deviance(self) -> float:
        """−2 ln of the likelihood of the estimates of σ², as if they were normal with the covariance that the fitted
        noise gives them; all terms may be there."""
        squares = self.squares(range(self.transfer.columns.shape[1]))
        model = self.transfer.columns @ squares
        root = np.linalg.cholesky(self._covariance(squares))
        away = np.linalg.solve(root, self.variance / model - 1.0)
        return float(away @ away + 2.0 * np.log(np.diag(root) * model).sum())

    def _covariance(self, squares: Array) -> Array:
        """Relative covariance (k, k) of the estimates of σ² where the noise has these squares, with SLOPE_ERROR."""
        statistical = np.sqrt(2.0 / self.degrees)
        return np.asarray(
            self.transfer.correlation(squares) * np.outer(statistical, statistical)
            + SLOPE_ERROR**2 * np.eye(len(statistical))
        )

    def _relative(self) -> Array:
        """Relative standard uncertainty (k,) of the estimates of σ²."""
        return np.asarray(np.sqrt(2.0 / self.degrees + SLOPE_ERROR**2))


def _identify(fit: _Fit) -> NoiseParameters:
    """The terms of one channel: the least significant are left out one by one."""
    active: list[int] = []
    if fit.variance.all():
        fit = fit.gauss_markov()
        active = list(range(fit.transfer.columns.shape[1]))
    while True:
        squares, u, excess = _estimates(fit, active)
        significance = [
            _significance(fit, active, j) / excess if squares[j] > w else 0.0 for j, w in zip(active, u, strict=False)
        ]
        if min(significance, default=np.inf) >= SIGNIFICANCE:
            break
        del active[int(np.argmin(significance))]
    values = np.sqrt(squares[active])
    found = {
        _TERMS[j]: Coefficient(value=float(value), u=float(0.5 * w / value))
        for j, value, w in zip(active, values, u, strict=False)
    }
    T = None
    if fit.correlation_time is not None and 4 in active:
        T = Coefficient(value=fit.correlation_time, u=float(fit.correlation_time * u[-1]))
    return NoiseParameters(**{name: found.get(name) for name in _TERMS}, correlation_time=T)


def _estimates(fit: _Fit, active: Sequence[int]) -> tuple[Array, Array, float]:
    """Squares (n,) of the coefficients, standard uncertainties of the active ones and of the logarithm of a correlation
    time, and by how much these were enlarged: √χ² where it is larger than it should be."""
    if not active:
        return np.zeros(fit.transfer.columns.shape[1]), np.zeros(0), 1.0
    squares = fit.squares(active)
    _, u, misfit = fit.about(squares, active)
    excess = np.sqrt(max(1.0, misfit))
    return squares, u * excess, float(excess)


def _significance(fit: _Fit, active: Sequence[int], term: int) -> float:
    """The square of a coefficient over what its standard uncertainty would be without the term: few degrees of
    freedom say little of how large a noise is, but may well say that it is there."""
    others = [j for j in active if j != term]
    if not others:
        return np.inf
    squares, u, _ = fit.about(fit.squares(others), active)
    at = list(active).index(term)
    return float(squares[at] / u[at])


# Figures and a picture --------------------------------------------------------------------------------------

_SHOWN = {
    # name: symbol, then for "rad/s" and for "m/s^2" one of the shown unit in SI, and its name
    "quantisation": ("Q", (ARCSEC, '"'), (1e-3, "mm/s")),
    "white_noise": ("N", (DEGREE / 60.0, "°/√h"), (1e-6 * G_STANDARD, "µg/√Hz")),
    "bias_instability": ("B", (DEGREE_PER_HOUR, "°/h"), (1e-6 * G_STANDARD, "µg")),
    "rate_random_walk": ("K", (DEGREE_PER_HOUR / 60.0, "°/h/√h"), (1e-6 * G_STANDARD / 60.0, "µg/√h")),
    "gauss_markov": ("σ", (DEGREE_PER_HOUR, "°/h"), (1e-6 * G_STANDARD, "µg")),
    "correlation_time": ("T", (1.0, "s"), (1.0, "s")),
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Shown:
    """A noise coefficient as it is shown: "N", "white noise", "0.0030", "0.0002", "°/√h"."""

    symbol: str
    name: str
    value: str
    u: str
    unit: str


def shown(parameters: NoiseParameters, unit: str) -> tuple[Shown, ...]:
    """The coefficients a channel shows, rounded by their uncertainties, in the units of data sheets; `unit` is
    that of the samples, "rad/s" or "m/s^2"."""
    out = []
    for name, (symbol, gyro, accel) in _SHOWN.items():
        coefficient = getattr(parameters, name)
        if coefficient is not None:
            size, unit_name = gyro if unit == "rad/s" else accel
            value, u = rounded(coefficient.value / size, coefficient.u / size)
            words = "Gauss–Markov noise" if name == "gauss_markov" else name.replace("_", " ")
            out.append(Shown(symbol=symbol, name=words, value=value, u=u, unit=unit_name))
    return tuple(out)


@dataclass(frozen=True, kw_only=True, slots=True)
class Panel:
    """What one panel of the picture shows: the sensors `channels` (c,) of one kind, in "rad/s" or "m/s^2"."""

    title: str
    unit: str
    channels: tuple[str, ...]
    deviation: AllanDeviation
    parameters: tuple[NoiseParameters, ...]
