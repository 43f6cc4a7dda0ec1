"""Is the standard uncertainty of the mean of a rest right, for white, Gauss-Markov and flicker noise?

A set is what a session has: 15 rests of 60 s, or 30 rests of 5 s, of block means over 0.1 s, three channels.
`fit_coloured_noise` says how uncertain the mean of each rest is; the means of the rests of a set scatter about
their own mean. The reduced chi-square of that scatter, averaged over many sets, is 1 if the uncertainties are
right. Its standard error is that of the average over the sets and channels.

White noise and Gauss-Markov noise of correlation time τ are independent from rest to rest. Flicker noise is one
record through all rests, with pauses of a third of a rest: the mean of a rest is then not the mean of what the
rest itself shows, and no method that looks inside the rests can know it. Scatter between rests, which the
calibration estimates from the residuals, has to cover the difference.

A drift along a line, in every rest another, does not move the means at all; white noise is all there is to them.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from tumble.reduction.noise.coloured_noise import fit_coloured_noise
from tumble.units import Array

BLOCK = 0.1  # s
CHANNELS = 3
PAUSE = 1 / 3  # of a rest

Noise = Callable[[np.random.Generator, int, int], Array]


@dataclass(frozen=True, kw_only=True, slots=True)
class Sets:
    """So many rests of so many seconds."""

    rests: int
    seconds: float

    @property
    def blocks(self) -> int:
        """Blocks in a rest."""
        return round(self.seconds / BLOCK)


HONEST = 0.25
"""How far the reduced chi-square may be from 1 where the uncertainty from within the rests is taken to be right."""

SIGMAS = 4.0

LONG, SHORT = Sets(rests=15, seconds=60.0), Sets(rests=30, seconds=5.0)


def white(rng: np.random.Generator, rests: int, blocks: int) -> Array:
    """White noise (rests, blocks, channels) of variance 1."""
    return rng.standard_normal((rests, blocks, CHANNELS))


def gauss_markov(share: float) -> Noise:
    """Gauss-Markov noise of variance 1 whose correlation time is this share of the rest."""

    def noise(rng: np.random.Generator, rests: int, blocks: int) -> Array:
        memory = np.exp(-1.0 / (share * blocks))
        driven = np.sqrt(1.0 - memory**2) * rng.standard_normal((rests, blocks, CHANNELS))
        driven[:, 0] = rng.standard_normal((rests, CHANNELS))
        return np.asarray(lfilter([1.0], [1.0, -memory], driven, axis=1))

    return noise


def with_white(noise: Noise, amplitude: float) -> Noise:
    """White noise of variance 1 and another noise of this amplitude."""
    return lambda rng, rests, blocks: white(rng, rests, blocks) + amplitude * noise(rng, rests, blocks)


def flicker(rng: np.random.Generator, rests: int, blocks: int) -> Array:
    """Rests cut from one record of 1/f noise, with pauses between them."""
    pitch = round((1.0 + PAUSE) * blocks)
    length = 1 << (2 * rests * pitch - 1).bit_length()
    frequency = np.fft.rfftfreq(length)[1:]
    spectrum = rng.standard_normal((len(frequency), CHANNELS)) + 1j * rng.standard_normal((len(frequency), CHANNELS))
    spectrum /= np.sqrt(frequency)[:, None]
    record = np.fft.irfft(np.vstack([np.zeros(CHANNELS), spectrum]), length, axis=0)
    return np.asarray(record[: rests * pitch].reshape(rests, pitch, CHANNELS)[:, :blocks])


def with_lines(size: float) -> Noise:
    """White noise of variance 1, and in every rest a line through zero in its middle, of this size from end to end."""

    def noise(rng: np.random.Generator, rests: int, blocks: int) -> Array:
        line = (np.arange(blocks) - 0.5 * (blocks - 1)) / blocks
        return white(rng, rests, blocks) + size * line[:, None] * rng.standard_normal((rests, 1, CHANNELS))

    return noise


def reduced_chi_square(noise: Noise, sets: Sets, repetitions: int, seed: int) -> tuple[float, float]:
    """Mean over sets and channels of the reduced chi-square of the means of the rests, and its standard error."""
    rng = np.random.default_rng(seed)
    out = np.empty((repetitions, CHANNELS))
    for i in range(repetitions):
        rests = noise(rng, sets.rests, sets.blocks)
        variance = fit_coloured_noise(list(rests)).variance_of_mean(sets.blocks)
        out[i] = rests.mean(axis=1).var(axis=0, ddof=1) / variance
    return float(out.mean()), float(out.std(ddof=1) / np.sqrt(out.size))


CASES: dict[str, Noise] = {
    "white": white,
    "Gauss-Markov, τ = T/200": gauss_markov(1 / 200),
    "Gauss-Markov, τ = T/50": gauss_markov(1 / 50),
    "Gauss-Markov, τ = T/20": gauss_markov(1 / 20),
    "white + Gauss-Markov, τ = T/50, equal": with_white(gauss_markov(1 / 50), 1.0),
    "white + Gauss-Markov, τ = T/20, equal": with_white(gauss_markov(1 / 20), 1.0),
    "white + Gauss-Markov, τ = T/20, 0.3 of it": with_white(gauss_markov(1 / 20), 0.3),
    "beyond: Gauss-Markov, τ = T/10": gauss_markov(1 / 10),
    "beyond: Gauss-Markov, τ = T/3": gauss_markov(1 / 3),
    "white + lines, 4": with_lines(4.0),
    "flicker": flicker,
}


def main(repetitions: int) -> int:
    """Print the table and the answer."""
    print(f"reduced chi-square of the means of rests, average over {repetitions} sets")
    print(f"{'noise':44s}{'15 × 60 s':>18s}{'30 × 5 s':>18s}")
    found = {}
    for name, noise in CASES.items():
        found[name] = [reduced_chi_square(noise, sets, repetitions, seed=1) for sets in (LONG, SHORT)]
        print(f"{name:44s}" + "".join(f"{f'{value:.3f} ± {u:.3f}':>18s}" for value, u in found[name]))
    within = [value for name in list(CASES)[:4] for value, _ in found[name]]
    coarse = [value for name in list(CASES)[4:7] for value, _ in found[name]]
    honest = all(abs(value - 1.0) < HONEST + SIGMAS * u for name in list(CASES)[:7] for value, u in found[name])
    short_of = all(value - SIGMAS * u > 2.0 for value, u in found["flicker"])
    lines = [value for value, _ in found["white + lines, 4"]]
    print(
        f"\nFor white noise, and Gauss-Markov noise of up to a twentieth of the rest, it is {min(within):.2f} to "
        f"{max(within):.2f}; where white noise hides\nthe Gauss-Markov noise, {min(coarse):.2f} to {max(coarse):.2f}; "
        f"with lines {lines[0]:.2f} and {lines[1]:.2f}.\n"
        f"For flicker noise it is {found['flicker'][0][0]:.1f} and {found['flicker'][1][0]:.1f}: the uncertainty from "
        f"within the rests is\n{np.sqrt(found['flicker'][0][0]):.1f} and {np.sqrt(found['flicker'][1][0]):.1f} times "
        "too small, and the scatter between rests has to be estimated."
    )
    return 0 if honest and short_of else 1


if __name__ == "__main__":
    sys.exit(main(repetitions=20 if "--short" in sys.argv[1:] else 300))
