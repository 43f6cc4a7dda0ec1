"""Sums of noise processes: how often the data choose the right ones, and how often the intervals of their coefficients
hold the truth.

    python studies/noise_processes.py [RUNS [SUM ...]]

Records of 2^17 samples at 100 Hz, 22 minutes, of known sums, 200 of each. Printed is, of each sum, in how many records
`tumble noise` names exactly its processes, what else it names, and of each coefficient in those records how often its
interval of 95 % holds the truth, and its median relative u.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from tumble.reduction.noise.allan_deviation import allan_deviation
from tumble.reduction.noise.wavelet_moments import LINEAR, Coefficient, NoiseParameters, identify, in_words
from tumble.units import Array

RATE = 100.0
SAMPLES = 2**17
FINE = 4
"""Steps of a wandering bias in a sample."""
TOGETHER = 10
"""Records that are channels of one."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Case:
    """A sum: coefficients by the names of (1), and (σ, T) of Gauss–Markov processes."""

    name: str
    linear: Mapping[str, float]
    gauss_markov: tuple[tuple[float, float], ...] = ()


def case(name: str, *gauss_markov: tuple[float, float], **letters: float) -> Case:
    names = dict(zip("QNBKR", LINEAR, strict=True))
    return Case(name=name, linear={names[k]: value for k, value in letters.items()}, gauss_markov=gauss_markov)


CASES = (
    case("Q + N", Q=0.1, N=0.3),
    case("N + K", N=1.0, K=0.3),
    case("N + R", N=1.0, R=0.005),
    case("N + σ, T 5 s", (1.0, 5.0), N=1.0),
    case("Q + N + K", Q=0.1, N=0.5, K=0.3),
    case("Q + N + σ, T 5 s", (1.0, 5.0), Q=0.1, N=0.5),
    case("N + K + σ, T 2 s", (1.0, 2.0), N=0.3, K=0.15),
    case("N + σ, T 0.5 s + σ, T 10 s", (1.0, 0.5), (1.0, 10.0), N=0.1),
    case("N + K + R", N=1.0, K=0.1, R=0.05),
    case("N + σ, T 1 s + σ, T 60 s", (1.0, 1.0), (1.0, 60.0), N=0.3),
)
BEYOND = 2
"""The last ones are beyond what such a record can tell: a random walk with u of 18 % beside a ramp, and a process of T
in a record of 22 T."""


def records(of: Case, count: int, rng: np.random.Generator, samples: int = SAMPLES) -> Array:
    """Records (samples, count) of a sum."""
    a = {letter: of.linear.get(name, 0.0) for letter, name in zip("QNBKR", LINEAR, strict=True)}
    out = a["N"] * np.sqrt(RATE) * rng.standard_normal((samples, count))
    out += a["Q"] * RATE * np.diff(rng.standard_normal((samples + 1, count)), axis=0)
    out += a["R"] * np.arange(samples)[:, None] / RATE
    fine = FINE * RATE  # what wanders is averaged over a sample
    if a["K"]:
        out += a["K"] / np.sqrt(fine) * _means(np.cumsum(rng.standard_normal((FINE * samples, count)), axis=0))
    for sigma, time in of.gauss_markov:
        kept = np.exp(-1.0 / (fine * time))
        steps = rng.standard_normal((FINE * samples, count))
        steps[1:] *= np.sqrt(1.0 - kept**2)
        out += sigma * _means(lfilter([1.0], [1.0, -kept], steps, axis=0))
    return np.asarray(out)


def _means(values: Array) -> Array:
    """Means of every FINE rows."""
    return np.asarray(values.reshape(-1, FINE, values.shape[1]).mean(axis=1))


def coefficients(of: Case, found: NoiseParameters) -> list[tuple[str, Coefficient, float]]:
    """Name, estimate and truth of every coefficient of a channel that has the processes of the case."""
    out = [(name, getattr(found, name), value) for name, value in of.linear.items()]
    for i, ((sigma, time), process) in enumerate(zip(of.gauss_markov, found.gauss_markov, strict=True), 1):
        out += [(f"σ{i}", process.sigma, sigma), (f"T{i}", process.time, time)]
    return out


def run(of: Case, runs: int, samples: int = SAMPLES) -> tuple[Counter[str], dict[str, Array]]:
    """What was named how often, and of each coefficient rows (n, 2): whether the interval holds it, and relative u."""
    right = in_words([name for name in LINEAR if name in of.linear], len(of.gauss_markov))
    rng, named, rows = (
        np.random.default_rng([29, CASES.index(of)]),
        Counter[str](),
        dict[str, list[tuple[float, float]]](),
    )
    for _ in range(runs // TOGETHER):
        for found in identify(allan_deviation(records(of, TOGETHER, rng, samples), RATE)):
            named[found.words] += 1
            if found.words != right:
                continue
            for name, estimate, truth in coefficients(of, found):
                low, high = estimate.interval
                rows.setdefault(name, []).append((float(low <= truth <= high), estimate.u / estimate.value))
    return Counter({"right": named.pop(right, 0), **named}), {name: np.array(each) for name, each in rows.items()}


def main(runs: int, wanted: list[str]) -> int:
    """Print the table and the answer."""
    print("| sum | right | else | of each coefficient, of 95 % intervals, with its median u |")
    print("|---|---|---|---|")
    shares, covered, least = [], [], 1.0
    for of in CASES:
        if wanted and of.name not in wanted:
            continue
        named, rows = run(of, runs)
        others = ", ".join(f"{count} {words}" for words, count in named.most_common() if words != "right")
        held = ", ".join(
            f"{name.replace('_', ' ')} {each[:, 0].mean():.1%} ({np.median(each[:, 1]):.1%})"
            for name, each in rows.items()
        )
        print(f"| {of.name} | {named['right']} of {runs} | {others} | {held} |", flush=True)
        if of not in CASES[-BEYOND:]:
            shares.append(named["right"] / runs)
            covered += [float(each[:, 0].mean()) for each in rows.values()]
            least = min(least, *(len(each) / runs for each in rows.values()))
    chance = 3.0 * np.sqrt(0.95 * 0.05 / (least * runs))
    right = min(shares) >= 0.9
    honest = min(covered) > 0.95 - chance and max(covered) <= min(1.0, 0.95 + chance)
    print(
        f"Are the right processes named, and are the intervals honest? {'Yes' if right and honest else 'No'}: right in "
        f"{min(shares):.0%} or more, intervals of 95 % hold the truth in {min(covered):.1%} to {max(covered):.1%} "
        f"(by chance within {chance:.1%})."
    )
    return 0 if right and honest else 1


if __name__ == "__main__":
    short = "--short" in sys.argv
    words = [word for word in sys.argv[1:] if word != "--short"]
    sys.exit(main(10 if short else int((*words, "200")[0]), [CASES[0].name, CASES[3].name] if short else words[1:]))
