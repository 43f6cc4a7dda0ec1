"""Is u honest for instruments that are not what their data sheet says?

Every group of parameters beyond the linear model has a prior of its usual size, whose own width is estimated and
integrated over (docs/explanation/mathematics.md, section 11). Instruments are drawn with groups of so many times that
size, the estimate being told the usual one. From observations, with full terms: the verdict, and of what is accepted
the errors over u of bias, scale and axes, and how often intervals of 95 % contain them. Coverage may be as low as
92 % where groups are larger than the data sheet has them, and 94 % otherwise. Nothing can be said of what no rest or
turn shows: it keeps the u of the data sheet, and of such a parameter three times the data sheet is 3 u.

    python studies/populations.py 40        40 instruments a line, in Markdown
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import replace

import numpy as np
from scipy import special

from tumble.diagnosis.verdict import verdict
from tumble.inference.joint import joint
from tumble.planning.setup import Setup
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of
from tumble.units import Array

BY_HAND = {f"MEMS by hand, {rests} rests": Setup.of(grade="mems", positions=rests, terms="full") for rests in
           (9, 12, 20, 40)}  # fmt: skip
SETUPS = {
    "MEMS by hand, 30 rests": Setup.of(grade="mems", positions=30, terms="full"),
    "rough table": Setup.of(grade="tactical", terms="full"),
    "rough table, one more turn a series": Setup.of(grade="tactical", programme="rough-table-18", terms="full"),
    "cube-26": Setup.of(grade="tactical", programme="cube-26", terms="full"),
}
TIMES = (0.3, 1.0, 3.0, 10.0)
"""Times the usual size of groups."""
FIRST = 1000
"""Seed of the first instrument."""


def unit(setup: Setup, times: float, seed: int) -> tuple[str, Array, Array]:
    """The verdict on an instrument so many times worse, and of its linear parameters the errors over u and whether
    intervals of 95 % contain them."""
    rng = np.random.default_rng(seed)
    scenario = scenario_of(replace(setup, further={name: times * size for name, size in setup.further.items()}), rng)
    observations = replace(
        simulate_observations(scenario, rng),
        usual=setup.further,
        too_small=dict.fromkeys(setup.further, 3.0),
        in_run={"accel": setup.noise.accel_instability, "gyro": setup.noise.gyro_instability},
    )
    estimate = joint(observations)
    truth = np.array([scenario.truth[name] for name in estimate.names])
    instrument, degrees = estimate.instrument, estimate.degrees
    assert instrument is not None
    assert degrees is not None
    linear = instrument.linear_count
    off = ((estimate.values - truth) / np.sqrt(np.diag(estimate.covariance)))[:linear]
    return verdict(estimate, observations).verdict, off, np.abs(off) <= special.stdtrit(degrees[:linear], 0.975)


def measured(name: str, times: float, count: int) -> float:
    """Print a line of what so many instruments give; the coverage of what is accepted."""
    runs = [unit((SETUPS | BY_HAND)[name], times, seed) for seed in range(FIRST, FIRST + count)]
    by = Counter(said for said, *_ in runs)
    off = np.concatenate([off for said, off, _ in runs if said.startswith("accepted")])
    covered = float(np.mean(np.concatenate([inside for said, _, inside in runs if said.startswith("accepted")])))
    print(
        f"| {name} | {times:g} | {count} | {by['accepted']}, {by['accepted with scatter']}, {by['not accepted']} | "
        f"{np.sqrt(np.mean(off**2)):.2f} | {100.0 * covered:.1f} % | {100.0 * np.mean(np.abs(off) > 3.0):.1f} % | "
        f"{np.abs(off).max():.1f} |",
        flush=True,
    )
    return covered


def main() -> None:
    short = "--short" in sys.argv
    count = 3 if short else int(sys.argv[1])
    lines = [(setup, times) for setup in SETUPS for times in TIMES] + [(setup, 1.0) for setup in BY_HAND]
    print("| set-up | times | N | accepted, with scatter, not | rms | covered | beyond 3 u | largest |")
    print("|---|---|---|---|---|---|---|---|")
    missed = [
        f"{name} at {times:g} times"
        for name, times in (lines[1:2] if short else lines)
        if measured(name, times, count) < (0.8 if short else 0.94 if times <= 1.0 else 0.92)
    ]
    print(f"Is u honest beyond the data sheet? {'Yes' if not missed else 'No: ' + '; '.join(missed)}")
    if missed:
        sys.exit(1)


if __name__ == "__main__":
    main()
