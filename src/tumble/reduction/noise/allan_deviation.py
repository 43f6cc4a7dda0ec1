"""Allan deviation of recordings at rest, with confidence intervals.

The Allan variance at τ is half the mean square difference of neighbouring means over τ, twice the Haar wavelet
variance. `tumble.reduction.noise.wavelet_moments` identifies the processes of which it is a sum.

Source: IEEE Std 952-1997, annex C; Riley, Handbook of Frequency Stability Analysis (NIST SP 1065).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from tumble.arguments import array_of, checked
from tumble.brief import Brief
from tumble.errors import InputError
from tumble.reduction import kernels as _kernels
from tumble.units import Array, IntArray

SIZES_PER_OCTAVE = 4
MIN_SAMPLES = 32
MIN_CLUSTERS = 4  # clusters of the longest τ in a record


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class AllanDeviation(Brief):
    """Overlapping Allan deviation of c channels at k averaging times.

    `tau` (k,), s. `deviation` (k, c), in the unit of the samples, with its 68 % confidence interval `low` … `high` (k,
    c) from χ² with `degrees` (k, c) equivalent degrees of freedom. `counts`: numbers of samples of the records."""

    tau: Array
    deviation: Array
    degrees: Array
    low: Array
    high: Array
    counts: tuple[int, ...]


@checked
def allan_deviation(samples: Array, rate: float) -> AllanDeviation:
    """Return the overlapping Allan deviation at four averaging times per octave, up to a quarter of the record.

    `samples` are (m,) or (m, c), at a constant rate, Hz. Raises InputError for fewer than 32 samples, and for a value
    that is not finite.

    >>> import numpy as np, tumble
    >>> white = np.random.default_rng(1).normal(size=(10_000, 1))
    >>> found = tumble.allan_deviation(white, 100.0)
    >>> bool(abs(found.deviation[0, 0] * np.sqrt(found.tau[0]) - 0.1) < 0.01)
    True
    """
    samples = array_of("samples", samples)
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
    octaves = np.arange(int(SIZES_PER_OCTAVE * np.log2(count // MIN_CLUSTERS)) + 1) / SIZES_PER_OCTAVE
    sizes = np.unique(np.round(2.0**octaves)).astype(np.int64)  # in samples: 1 … count/4
    sums = np.column_stack([_kernels.allan_sums(_integral(c), sizes) for c in columns.T])
    terms = count + 1 - 2 * sizes
    deviation = np.sqrt(sums / (2.0 * terms * sizes.astype(float) ** 2)[:, None])
    tau = sizes / rate
    degrees, x = np.empty_like(deviation), np.log2(tau)
    for c, column in enumerate(deviation.T):
        # exponent α (0, −1, −2: white noise, flicker, random walk) of the power law S ∝ f^α around each τ, from the
        # slope −α − 1 of σ² over an octave on either side. Steeper slopes at short τ (quantisation) count as white,
        # which understates their many degrees of freedom
        exponents = np.zeros(len(tau), dtype=np.int64)
        for i, centre in enumerate(x if column.all() else ()):
            near = np.abs(x - centre) < 1.01
            slope = np.polyfit(x[near] - centre, 2.0 * np.log2(column[near]), 1)[0]
            exponents[i] = -np.searchsorted([-0.5, 0.5], slope)
        degrees[:, c] = _degrees(count + 1, sizes, exponents)
    return _with_interval(tau, deviation, degrees, (count,))


def _integral(column: Array) -> Array:
    """Return the running sum (m + 1,) of the samples less their mean, from 0."""
    out = np.zeros(len(column) + 1)
    np.subtract(column, column[0], out=out[1:])  # a constant becomes exactly zero
    out[1:] -= out[1:].mean()
    np.cumsum(out[1:], out=out[1:])
    if not np.isfinite(out[-1]):
        raise InputError("Allan deviation: expected finite samples, found NaN or infinity; repair or cut the log")
    return out


def _degrees(points: int, sizes: IntArray, exponents: IntArray) -> Array:
    """Return the equivalent degrees of freedom (k,) of overlapping estimates from this number of points of the
    integral.

    Source: Riley, Handbook of Frequency Stability Analysis (NIST SP 1065), table 5."""
    n, m = float(points), sizes.astype(float)
    white = (1.5 * (n - 1.0) / m - 2.0 * (n - 2.0) / n) * 4.0 * m**2 / (4.0 * m**2 + 5.0)
    flicker = np.where(m == 1.0, 2.0 * (n - 2.0) ** 2 / (2.3 * n - 4.9), 5.0 * n**2 / (4.0 * m * (n + 3.0 * m)))
    walk = (n - 2.0) / m * ((n - 1.0) ** 2 - 3.0 * m * (n - 1.0) + 4.0 * m**2) / (n - 3.0) ** 2
    return np.asarray(np.select([exponents == 0, exponents == -1], [white, flicker], walk))


def pooled(records: Sequence[AllanDeviation]) -> AllanDeviation:
    """Return the Allan deviation of several records of the same sensors at rest.

    At each τ it is the mean of σ² over the records that are long enough, weighted by the number of differences. Raises
    InputError if rates or channels differ."""
    longest = max(records, key=lambda record: record.counts[0])
    for record in records:
        if record.deviation.shape[1] != longest.deviation.shape[1] or not np.isclose(record.tau[0], longest.tau[0]):
            raise InputError("noise: expected records of the same sensors at one rate, found others")
    sums, terms, degrees = np.zeros((3, *longest.deviation.shape))
    for record in records:
        k = len(record.tau)
        sizes = np.round(record.tau / record.tau[0])
        M = sum(np.maximum(count + 1.0 - 2.0 * sizes, 0.0) for count in record.counts)[:, None]
        sums[:k] += M * record.deviation**2
        terms[:k] += M
        degrees[:k] += record.degrees
    return _with_interval(longest.tau, np.sqrt(sums / terms), degrees, sum((r.counts for r in records), ()))


def _with_interval(tau: Array, deviation: Array, degrees: Array, counts: tuple[int, ...]) -> AllanDeviation:
    low, high = (
        deviation * np.sqrt(0.5 * degrees / scipy.special.gammaincinv(0.5 * degrees, scipy.special.ndtr(z)))
        for z in (1.0, -1.0)
    )
    return AllanDeviation(tau=tau, deviation=deviation, degrees=degrees, low=low, high=high, counts=counts)
