"""Data made worse never improve a verdict, neither the whole one nor that of accelerometers or gyros."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from hypothesis import Phase, example, given, settings
from hypothesis import strategies as st

from tumble.diagnosis.verdict import verdict
from tumble.inference.joint import joint
from tumble.planning.setup import Setup
from tumble.reduction.observations import Observations
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of

REST_COUNT = 14


@cache
def recorded(state: str) -> Observations:
    """A session of a MEMS unit by hand that is sound, whose rests have four times the noise that they state, or all of
    whose turns lack samples."""
    rng = np.random.default_rng(91)
    setup = Setup.of(grade="mems", positions=REST_COUNT, rest=5.0)
    seen = simulate_observations(scenario_of(setup, rng, serial="sound"), rng)
    if state == "noisy":
        return spoilt(seen, "noisy", 0, 4.0, rng)
    for turn in range(REST_COUNT - 1) if state == "lacking" else ():
        seen = spoilt(seen, "lost", turn, float(rng.integers(0, 50)), rng)
    return seen


@cache
def judged_before(state: str) -> list[int]:
    """The verdicts on it."""
    return judged(recorded(state))


def judged(observations: Observations) -> list[int]:
    """The verdicts on the whole, the accelerometers and the gyros as numbers: larger is worse."""
    order = ["accepted", "accepted with scatter", "not accepted"]
    outcome = verdict(joint(observations, quick=True), observations)
    return [order.index(each.verdict) for each in (outcome, outcome.accel, outcome.gyro)]


def spoilt(seen: Observations, kind: str, rest: int, size: float, rng: np.random.Generator) -> Observations:
    """The same with a spike in the mean of a rest, a rest that is disturbed, rests with more noise than they state, or
    a turn that lacks samples; `size` is in standard deviations of the noise."""
    rests, turns, samples = seen.rests, seen.turns, seen.turn_samples
    noise = {
        name: np.sqrt(np.diagonal(getattr(rests, f"{name}_covariance"), axis1=1, axis2=2)) for name in ("accel", "gyro")
    }
    accel, gyro = rests.accel.copy(), rests.gyro.copy()
    if kind == "spike":
        gyro[rest, rest % 3] += size * noise["gyro"][rest, rest % 3]
    elif kind == "disturbed":
        accel[rest] += size * noise["accel"][rest] * rng.choice([-1.0, 1.0], 3)
        gyro[rest] += size * noise["gyro"][rest] * rng.choice([-1.0, 1.0], 3)
    elif kind == "noisy":
        accel += size * noise["accel"] * rng.standard_normal(accel.shape)
        gyro += size * noise["gyro"] * rng.standard_normal(gyro.shape)
    elif turns is not None and samples is not None:
        k = min(rest, len(turns) - 1)
        lost = max(1, round(0.001 * size * (samples.stop[k] - samples.start[k])))
        stop = samples.stop.copy()
        stop[k] -= lost
        return replace(seen, turn_samples=replace(samples, stop=stop))
    return replace(seen, rests=replace(rests, accel=accel, gyro=gyro))


@settings(max_examples=8, deadline=None, derandomize=True, phases=[Phase.explicit, Phase.generate])
@given(
    state=st.sampled_from(["sound", "noisy", "lacking"]),
    kind=st.sampled_from(["spike", "disturbed", "noisy", "lost"]),
    rest=st.integers(0, REST_COUNT - 2),
    size=st.floats(2.0, 200.0),
)
@example(state="lacking", kind="noisy", rest=9, size=110.6)  # an accelerometer angle is not seen at all then
def test_data_made_worse_never_improve_a_verdict(state: str, kind: str, rest: int, size: float) -> None:
    after = judged(spoilt(recorded(state), kind, rest, size, np.random.default_rng(5)))
    assert all(now >= before for now, before in zip(after, judged_before(state), strict=True))
