"""What does the warm-up of a MEMS unit after power-on do to a calibration, with a thermometer in the log and without?

Units of the grade mems with errors drawn from its spreads, 24 positions by hand, rests of 10 s, 50 samples a second,
five minutes from the log of every sample to the result. From power-on the unit warms by 15 °C, exponentially in a time
that differs from unit to unit, 60 to 200 s. Two kinds of units: biases that settle by 2 mg and 0.2 °/s, each of either
sign, and nothing else that changes; and biases that settle by a Gaussian number of that standard deviation, with
curvatures and scale factors over temperature of the usual size. The log has a thermometer; then the same recording is
calibrated without it: parameters are then those of the settled device, if anything is accepted at all.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import replace

import numpy as np

from tumble.calibration.calibrate import calibrate
from tumble.calibration.calibration_file import Calibration
from tumble.planning.setup import Setup
from tumble.simulation.scenario import itinerary, scenario_of
from tumble.simulation.session import session_in_memory
from tumble.simulation.temperature_profile import REFERENCE, REFERENCE_NAME, TemperatureProfile, draw_thermal, truth_at
from tumble.units import DEGREE, G_STANDARD

START, RISE = 22.0, 15.0
SETTLES = {"accel": 2e-3 * G_STANDARD, "gyro": 0.2 * DEGREE}
FASTEST, SLOWEST = 60.0, 200.0


def unit(number: int, *, drawn: bool) -> tuple[Calibration, Calibration, dict[str, float]]:
    """The calibrations of a recording with its thermometer and without it, and the truth at the reference
    temperature."""
    rng = np.random.default_rng([23, number])
    setup = Setup.of(grade="mems", positions=24, rest=10.0, sample_rate=50.0)
    scenario = scenario_of(setup, rng, serial=f"unit-{number}")
    duration = float(itinerary(scenario, rng.spawn(1)[0]).rests[-1, 1])
    profile = TemperatureProfile(celsius=(START,), heating=((RISE, rng.uniform(FASTEST, SLOWEST)),))
    blocks = {"accel": scenario.accel, "gyro": scenario.gyro}
    thermal = draw_thermal(setup.further, "mems", blocks, rng) if drawn else {}
    for kind, size in SETTLES.items():
        for axis in "xyz":
            of_size = rng.standard_normal() if drawn else rng.choice([-1.0, 1.0])
            thermal[f"{kind}.bias.{axis}.t1"] = float(of_size * size / RISE)
    scenario = replace(scenario, truth=dict(scenario.truth) | thermal, climate=profile.climate(1.2 * duration))
    session = session_in_memory(scenario, rng)
    truth = {name: scenario.truth[name] for name in scenario.names} | {REFERENCE_NAME: REFERENCE}
    blind = replace(session, log=replace(session.log, temperature=None))
    return calibrate(session), calibrate(blind), truth


def errors(found: Calibration, truth: dict[str, float], celsius: float | None = None) -> tuple[list[float], list[bool]]:
    """Errors in units of u of the parameters whose truth is known, at a temperature or that of the calibration, and
    whether U contains them."""
    true = truth_at(truth, found.reference_temperature if celsius is None else celsius)
    known = [p for p in found.parameters if p.name in true and p.u]
    return [(p.value - true[p.name]) / p.u for p in known], [abs(p.value - true[p.name]) < p.k * p.u for p in known]


def measured(count: int, *, drawn: bool) -> tuple[bool, bool]:
    """Print what so many units give; whether the uncertainty with a thermometer is honest, and whether the warm-up is
    named without one."""
    runs = [unit(number, drawn=drawn) for number in range(count)]
    z, within = (np.concatenate(each) for each in zip(*(errors(seen, truth) for seen, _, truth in runs), strict=True))
    with_it, without = (Counter(run[i].outcome.verdict for run in runs) for i in (0, 1))
    print(f"{count} units, {'Gaussian, all that changes' if drawn else '± 2 mg and ± 0.2 °/s'}")
    print(f"  with a thermometer: {dict(with_it)}; errors over u, rms {np.sqrt(np.mean(z**2)):.2f};", end=" ")
    print(f"truth within U (95.45 %): {100.0 * within.mean():.1f} % of {len(z)}")
    said = [" ".join((*run[1].outcome.reasons, *run[1].outcome.remarks)) for run in runs]
    named = sum("settle by" in each for each in said)
    print(f"  without it: {dict(without)}; {named} name the warm-up", end="")
    settled = [errors(blind, truth, START + RISE) for _, blind, truth in runs if blind.outcome.accepted]
    off = np.concatenate([each[0] for each in settled]) if settled else np.zeros(0)
    if len(off):
        far = 100.0 * np.mean(np.abs(off) > 3.0)
        print(f"; errors over u of what is accepted, rms {np.sqrt(np.mean(off**2)):.2f}, {far:.1f} % beyond 3", end="")
    print()
    for number, each in enumerate(said):
        if runs[number][1].outcome.verdict == "accepted" or "settle by" not in each:
            print(f"    unit {number}: {runs[number][1].outcome.verdict}: {each}")
    honest = with_it["not accepted"] <= 0.05 * count and np.sqrt(np.mean(z**2)) < (1.5 if count < 40 else 1.1)
    covered = not len(off) or bool(np.sqrt(np.mean(off**2)) < (1.6 if count < 40 else 1.25))
    return bool(honest) and covered, without["accepted"] == 0 and named >= 0.9 * count


def main() -> int:
    short = "--short" in sys.argv
    found = [measured(1 if short else 40, drawn=drawn) for drawn in ((False,) if short else (False, True))]
    fine = all(all(each) for each in found)
    print(f"\nDoes a thermometer take the warm-up off, and is it named without one? {'Yes' if fine else 'No'}")
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main())
