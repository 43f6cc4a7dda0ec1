"""The rate of a log's clock by a second one in it: satellite time, or that of a host whose clock is kept.

Where the second clock shows c when the log's shows t,

    c − c̄ = ρ (t − t̄) + jitter                          ρ by least squares, each file about its means

an interval of the log that is called dt is ρ dt long. Stamps come late by what moves slowly, and a receiver's time
stands still between its fixes; so only rows in which the second clock moved count, and the uncertainty of ρ is that of
the jackknife which leaves out one of BLOCKS successive parts at a time,

    u² = (B − 1)/B Σ (ρ_b − mean ρ_b)²

with what the second clock's own rate is uncertain by added. Stamps further than FAR robust standard deviations from the
line, as of a leap second or a fix that was lost, are left out.

Source: H. Künsch, Annals of Statistics 17 (1989) 1217, the delete-a-block jackknife.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tumble.errors import LogError
from tumble.recording.log_source import LogSource
from tumble.recording.session import LogSpec
from tumble.units import Array, BoolArray

BLOCKS = 10
FAR = 6.0
MOST_FAR = 0.2
"""Of the stamps: where more are far from the line, the clocks do not go together."""
FEWEST = 50
"""Stamps at which the second clock moved."""
MOST = 100_000
"""Stamps that are kept: of more every second one, and so on."""
SHORTEST = 30.0
"""s, of all files together."""
FURTHEST = 0.01
"""A rate that is off by more is no clock's, but a wrong unit or column."""


def clock_rate(sources: Sequence[LogSource], spec: LogSpec) -> tuple[float, float]:
    """Seconds of a log's `reference_clock` in a second of its own, with the standard uncertainty. Raises LogError where
    the two cannot be compared."""
    reference, time = spec.reference_clock, spec.time
    assert reference is not None
    assert time is not None
    where = f"{sources[0].path}: log.reference_clock '{reference.column}'"
    t, c, number = np.empty(0), np.empty(0), np.empty(0, dtype=int)
    for file, source in enumerate(sources):
        if reference.column not in source.names:
            raise LogError(
                f"{source.path}: expected the column '{reference.column}' of log.reference_clock, found none"
            )
        last = np.nan
        for table, _ in source.tables([time, reference.column]):
            stamps, shown = (table[name].to_numpy() for name in (time, reference.column))
            sound = np.isfinite(stamps) & np.isfinite(shown)
            stamps, shown = stamps[sound], shown[sound]
            came = np.diff(shown, prepend=last) != 0.0
            last = shown[-1] if len(shown) else last
            if np.isnan(last) or not came.any():
                continue
            t = np.concatenate([t, stamps[came] * spec.time_factor])
            c = np.concatenate([c, shown[came] * reference.factor])
            number = np.concatenate([number, np.full(int(came.sum()), file)])
            while len(t) > MOST:
                t, c, number = t[::2], c[::2], number[::2]
    if len(t) < FEWEST:
        raise LogError(f"{where}: expected at least {FEWEST} stamps at which it moves, found {len(t)}; leave it out")

    def line(kept: BoolArray) -> tuple[float, Array]:
        """ρ by the stamps that are kept, and what all are off the line."""
        count = np.maximum(np.bincount(number[kept], minlength=number.max() + 1), 1)
        about = []
        for values in (t, c):
            means = np.bincount(number[kept], values[kept] - values[0], minlength=number.max() + 1) / count
            about.append(values - values[0] - means[number])
        x, y = about
        rate = float(x[kept] @ y[kept]) / float(x[kept] @ x[kept])
        return rate, np.abs(y - rate * x)

    kept = np.ones(len(t), dtype=bool)
    for _ in range(5):
        rate, off = line(kept)
        far = off > FAR * 1.4826 * float(np.median(off[kept])) + 1e-9
        if np.array_equal(far, ~kept):
            break
        kept = ~far
    seconds = sum(float(np.ptp(t[number == file])) for file in np.unique(number))
    if seconds < SHORTEST:
        raise LogError(
            f"{where}: expected to be compared over {SHORTEST:g} s at least, found {seconds:.3g} s; leave it out"
        )
    if np.mean(~kept) > MOST_FAR or not abs(rate - 1.0) < FURTHEST:
        raise LogError(
            f"{where}: expected a clock that goes as the log's does, to {FURTHEST:.0%}, found a rate of {rate:.4g} "
            f"with {np.mean(~kept):.0%} of its stamps off; check its unit, and that of log.time"
        )
    rates = []
    for part in np.array_split(np.flatnonzero(kept), BLOCKS):
        others = kept.copy()
        others[part] = False
        rates.append(line(others)[0])
    jitter = np.sqrt((BLOCKS - 1.0) / BLOCKS * np.sum((np.array(rates) - np.mean(rates)) ** 2))
    return rate, float(np.hypot(jitter, reference.u))
