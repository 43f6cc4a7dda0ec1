"""How often a watch calls a bias moved that has not, and after how many rests it finds one that has.

Each day draws a device of MEMS grade with all groups of parameters, calibrates it by hand (18 rests, joint method, full
model), turns it on again, by which its parameters change as is usual of the grade, and lets it rest every ten minutes
for five seconds in any attitude, 100 times. In-run biases are a
Gauss–Markov process of the usual instability. What turning on has changed wanders about its mean in some days, as fast
as is usual of a drift; in some it stays.

False alarms are counted at the threshold of the watch, and at lower ones, where the bound N / RESTS_APART has something
to hold: there the sums go on as they would without a decision. Then the bias of one axis, drawn, moves after 30 rests:
at once, or by a ramp.

    python studies/watched_days.py [--short] [--store]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from field_check import GRADE, device, turned_on_again
from stored import shown, store

from tumble.methods.rest_chain import BIASES, HOUR, RESTS_APART, RestChain
from tumble.reduction.observations import Observations
from tumble.result.calibration import Calibration
from tumble.sensors.grades import GRADES, TURN_ON, spread_of
from tumble.sensors.parameters import group_name, usual_sizes
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import Scenario
from tumble.units import DEGREE, G_STANDARD, Array
from tumble.use.check import prior_at_check

Way = Literal["wanders", "stays"]
WAYS: tuple[Way, ...] = ("wanders", "stays")
RESTS, EVERY = 100, 600.0
MOVES_AT = 30
CHANGES = {
    "accel.bias step of 5 mg": ("accel", 5e-3 * G_STANDARD, 0.0),
    "gyro.bias step of 0.2 °/s": ("gyro", 0.2 * DEGREE, 0.0),
    "gyro.bias ramp of 0.1 °/s an hour": ("gyro", 0.0, 0.1 * DEGREE),
}
"""The bias of one axis: by how much it moves at once, and in an hour, SI."""
APART = (1e2, 1e3, 1e4, RESTS_APART)
SIGMAS = 4.0
"""By how much a count may miss its bound."""


def wandering(rng: np.random.Generator, size: float, time: float, shape: tuple[int, int]) -> Array:
    """A stationary Gauss–Markov process of this standard deviation at the rests (N, n)."""
    rho, out = np.exp(-EVERY / time), rng.standard_normal(shape)
    for k in range(1, len(out)):
        out[k] = rho * out[k - 1] + np.sqrt(1.0 - rho**2) * out[k]
    return np.asarray(size * out)


def day(scenario: Scenario, rng: np.random.Generator, way: Way) -> Observations:
    """The rests of a day of a device that was turned on again."""
    usual, noise = usual_sizes(GRADE), GRADES[GRADE].noise
    truth = turned_on_again(scenario, rng)
    if way == "wanders":  # then what turning on changes in biases is in the process
        truth |= {name: value for name, value in scenario.truth.items() if group_name(name) in BIASES}
    quiet = replace(scenario.setup.noise, accel_instability=0.0, gyro_instability=0.0)
    again = replace(scenario.changed(noise=quiet, by_hand=RESTS), truth=truth)
    observations = simulate_observations(again, rng, only_programmed=True)
    rests, start = observations.rests, EVERY * np.arange(RESTS)
    moved = {"start": start, "stop": start + rests.stop - rests.start}
    for kind in ("accel", "gyro"):
        readings, bias = getattr(rests, kind), f"{kind}.bias"
        instability, drift = getattr(noise, f"{kind}_instability"), usual[f"{bias}.drift"]
        readings = readings + wandering(rng, instability, noise.instability_time, readings.shape)
        if way == "wanders":
            s = np.sqrt(2.0) * spread_of(TURN_ON[GRADE], bias)
            readings = readings + wandering(rng, s, 2.0 * s**2 / (drift**2 * HOUR), readings.shape)
        moved[kind] = readings
    return replace(observations, rests=replace(rests, **moved), turns=None, turn_samples=None)


def watched(calibration: Calibration, observations: Observations, *, rests_apart: float) -> tuple[RestChain, list[int]]:
    """The chain of the rests of a day, and with which of them a bias was said to have moved."""
    chain, said = None, list[int]()
    for k in range(len(observations.rests)):
        alone = observations.of_rest(k)
        known = prior_at_check(calibration, alone, GRADE, {})
        chain = chain or RestChain(known, usual_sizes(GRADE), rests_apart=rests_apart)
        judged = chain.add(alone, known)
        said += [k] * len(judged.moved)
    assert chain is not None
    return chain, said


@dataclass(kw_only=True, slots=True)
class Quiet:
    """Days in which nothing moved: how many, and in how many a sum came beyond the threshold of each of APART."""

    days: int = 0
    beyond: dict[float, int] | None = None


def quiet_days(count: int, way: Way, *, seed: int) -> Quiet:
    """False alarms."""
    out = Quiet(beyond=dict.fromkeys(APART, 0))
    assert out.beyond is not None
    for trial in range(count):
        rng = np.random.default_rng([seed, trial])
        scenario, calibration = device(rng)
        observations, most, chain = day(scenario, rng, way), 0.0, None
        for k in range(RESTS):
            alone = observations.of_rest(k)
            known = prior_at_check(calibration, alone, GRADE, {})
            chain = chain or RestChain(known, usual_sizes(GRADE), rests_apart=1e30)
            chain.add(alone, known)
            most = max(most, float(chain.sums.max()))
        assert chain is not None
        out.days += 1
        for apart in APART:
            out.beyond[apart] += most >= np.log(len(chain.sums) * apart)
    return out


def delays(count: int, change: str, *, seed: int) -> tuple[list[int | None], int]:
    """After how many rests each change is found, None where it is not within the day, and alarms before it moved."""
    kind, step, ramp = CHANGES[change]
    out, false = list[int | None](), 0
    for trial in range(count):
        rng = np.random.default_rng([seed, trial])
        scenario, calibration = device(rng)
        observations = day(scenario, rng, "wanders")
        readings = getattr(observations.rests, kind).copy()
        hours = EVERY / HOUR * np.arange(1, RESTS - MOVES_AT + 1)
        readings[MOVES_AT:, rng.integers(3)] += rng.choice([-1.0, 1.0]) * (step + ramp * hours)
        changed = replace(observations, rests=replace(observations.rests, **{kind: readings}))
        _, said = watched(calibration, changed, rests_apart=RESTS_APART)
        after = [k - MOVES_AT + 1 for k in said if k >= MOVES_AT]
        out.append(min(after) if after else None)
        false += len(said) - len(after)
    return out, false


def main() -> int:
    """Print counts and delays, and whether the bound holds."""
    quiet, moved = (2, 1) if "--short" in sys.argv else (60, 20)
    quiet_rows = [["what turning on changed", "days", *(f"one in {apart:g}" for apart in APART)]]
    moved_rows = [["change", "found", "rests until found, median", "most"]]
    holds = True
    for way in WAYS:
        found = quiet_days(quiet, way, seed=1)
        assert found.beyond is not None
        row = []
        for apart, days in found.beyond.items():
            allowed = found.days * min(1.0, RESTS / apart)
            holds &= days <= allowed + SIGMAS * np.sqrt(max(allowed, 1.0))
            row.append(f"{days}, at most {allowed:g}")
        quiet_rows.append([way, f"{found.days}", *row])
    for change in CHANGES:
        after, false = delays(moved, change, seed=2)
        found_after = [k for k in after if k is not None]
        times = [f"{np.median(found_after):.0f}", f"{max(found_after)}"] if found_after else ["", ""]
        moved_rows.append([change, f"{len(found_after)} of {len(after)}", *times])
        holds &= false == 0 and len(found_after) >= 0.9 * len(after) - SIGMAS * np.sqrt(0.09 * len(after))
    print(f"{shown(quiet_rows)}\n\n{shown(moved_rows)}")
    if "--store" in sys.argv and "--short" not in sys.argv:
        store("watched_days", {"quiet": quiet_rows, "moved": moved_rows}, seed="1, 2", N=f"{quiet}, {moved}")
    answer = "Yes" if holds else "No"
    print(f"Does a watch alarm no oftener than it says, and find these changes? {answer}")
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
