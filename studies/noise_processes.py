"""Sums of noise processes: how often the data choose the right ones, and how often the intervals of their coefficients
hold the truth.

    python studies/noise_processes.py [RUNS [CASE ...]]

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
    case("N + K + R", N=1.0, K=0.1, R=0.05),
    case("Q + N + σ, T 5 s", (1.0, 5.0), Q=0.1, N=0.5),
    case("N + K + σ, T 2 s", (1.0, 2.0), N=0.3, K=0.15),
    case("N + σ, T 0.5 s + σ, T 10 s", (1.0, 0.5), (1.0, 10.0), N=0.1),
    case("N + σ, T 1 s + σ, T 60 s", (1.0, 1.0), (1.0, 60.0), N=0.3),
)
"""The last is beyond what a record of 22 T can tell from a random walk."""


def records(of: Case, count: int, rng: np.random.Generator, samples: int = SAMPLES) -> Array:
    """Records (samples, count) of a sum."""
    a = {letter: of.linear.get(name, 0.0) for letter, name in zip("QNBKR", LINEAR, strict=True)}
    out = a["N"] * np.sqrt(RATE) * rng.standard_normal((samples, count))
    out += a["Q"] * RATE * np.diff(rng.standard_normal((samples + 1, count)), axis=0)
    out += a["K"] / np.sqrt(RATE) * np.cumsum(rng.standard_normal((samples, count)), axis=0)
    out += a["R"] * np.arange(samples)[:, None] / RATE
    for sigma, time in of.gauss_markov:
        kept = np.exp(-1.0 / (RATE * time))
        steps = np.sqrt(1.0 - kept**2) * rng.standard_normal((samples, count))
        steps[0] = rng.standard_normal(count)
        out += sigma * lfilter([1.0], [1.0, -kept], steps, axis=0)
    return np.asarray(out)


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


def main() -> None:
    runs, wanted = int((*sys.argv[1:], "200")[0]), sys.argv[2:]
    print("| sum | right | else | of each coefficient, of 95 % intervals, with its median u |")
    print("|---|---|---|---|")
    for of in CASES:
        if wanted and not any(word in of.name for word in wanted):
            continue
        named, rows = run(of, runs)
        others = ", ".join(f"{count} {words}" for words, count in named.most_common() if words != "right")
        held = ", ".join(
            f"{name.replace('_', ' ')} {each[:, 0].mean():.1%} ({np.median(each[:, 1]):.1%})"
            for name, each in rows.items()
        )
        print(f"| {of.name} | {named['right']} of {runs} | {others} | {held} |", flush=True)


if __name__ == "__main__":
    main()
