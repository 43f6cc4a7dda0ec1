"""What does one thermometer cost where accelerometers and gyros are chips apart that warm themselves differently?

Units of the grade mems, every parameter and coefficient drawn from its usual size; programme cube-14, rests of 60 s,
while the chamber goes from 5 to 35 °C and back. From power-on the accelerometers warm themselves by 3 °C in a time of
200 s, the gyros by 12 °C in 500 s; sensors follow their own thermometer with a lag of |N(0, 60 s)|. Observations are
made directly from the truth and estimated by the method joint: with a thermometer for each chip, and with either alone.

z: root mean square of (value − truth)/u of biases, scale factors and their coefficients over temperature. Coverage: how
often the truth is within the interval of 95 %.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
from scipy import stats
from stored import shown, store

from tumble.inference.joint import joint
from tumble.planning.setup import Setup
from tumble.reduction.observations import Observations
from tumble.reduction.rests.thermometer import Thermometers
from tumble.run.from_estimate import sensor_temperatures
from tumble.sensors.parameters import usual_sizes
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import Scenario, itinerary, scenario_of
from tumble.simulation.temperature_profile import REFERENCE, REFERENCE_NAME, TemperatureProfile, draw_thermal, truth_at
from tumble.units import Array

PROFILE = TemperatureProfile(celsius=(5.0, 35.0, 5.0), heating=((3.0, 200.0), (12.0, 500.0)))
LAG = 60.0
KINDS = ("accel", "gyro")


def unit(number: int) -> tuple[Scenario, Observations]:
    """A unit and what is observed of it."""
    setup = Setup.of(grade="mems", programme="cube-14", rest=60.0, rate_deg_s=60.0)
    rng = np.random.default_rng([77, number])
    scenario = scenario_of(setup, rng, serial=f"unit-{number}")
    accel, gyro = PROFILE.blocks(scenario.accel, scenario.gyro)
    truth = dict(scenario.truth) | draw_thermal({}, "mems", {"accel": accel, "gyro": gyro}, rng)
    duration = float(itinerary(scenario, rng.spawn(1)[0]).rests[-1, 1])
    lag = abs(LAG * float(rng.standard_normal()))
    climate = PROFILE.climate(1.05 * duration, {"accel": lag, "gyro": lag})
    made = scenario.changed(further=usual_sizes("mems"))
    made = replace(made, accel=accel, gyro=gyro, truth=truth, climate=climate)
    return made, simulate_observations(made, rng)


def with_one(observations: Observations, t: int) -> Observations:
    """As if all sensors had one of the thermometers."""
    rests, known, gyro = observations.rests, observations.thermometers, observations.gyro_block
    assert rests.temperatures is not None
    assert known is not None
    assert gyro is not None
    return replace(
        observations,
        accel_block=replace(observations.accel_block, thermometers=()),
        gyro_block=replace(gyro, thermometers=()),
        rests=replace(rests, temperatures=rests.temperatures[:, [t]]),
        thermometers=Thermometers(files={f: (start, kelvin[:, [t]]) for f, (start, kelvin) in known.files.items()}),
    )


def errors(scenario: Scenario, observations: Observations) -> dict[str, Array]:
    """Errors over u by kind of sensors, with Student's t taken to the normal distribution."""
    found, references = joint(observations), sensor_temperatures(observations)
    given = dict(scenario.truth) | {REFERENCE_NAME: REFERENCE}
    true = truth_at(given, REFERENCE, lambda name: references.get(name.partition(".")[0], (REFERENCE,))[0])
    own = {kind: [i for i, n in enumerate(found.names) if n in true and _is_of(n, kind)] for kind in KINDS}
    degrees = np.full(len(found.names), np.inf) if found.degrees is None else found.degrees
    z = {k: np.array([(found.values[i] - true[found.names[i]]) / found.u[i] for i in at]) for k, at in own.items()}
    normal = {k: stats.norm.ppf(stats.t.cdf(-np.abs(each), degrees[own[k]])) for k, each in z.items()}
    # beyond 38 standard deviations the distribution functions are 0 to a computer: z itself
    return {k: np.where(np.isfinite(normal[k]), -np.sign(z[k]) * normal[k], z[k]) for k in KINDS}


def _is_of(name: str, kind: str) -> bool:
    return name.startswith((f"{kind}.bias", f"{kind}.scale"))


def main() -> int:
    count = 1 if "--short" in sys.argv else int(next((a for a in sys.argv[1:] if a.isdecimal()), "100"))
    every: dict[str, list[dict[str, Array]]] = {"each its own": [], "that of accel": [], "that of gyro": []}
    for number in range(count):
        scenario, observations = unit(number)
        every["each its own"].append(errors(scenario, observations))
        for t, kind in enumerate(KINDS):
            every[f"that of {kind}"].append(errors(scenario, with_one(observations, t)))
    rms: dict[tuple[str, str], float] = {}
    rows = [["thermometer", "accelerometers", "gyros"]]
    for way, runs in every.items():
        cells = []
        for kind in KINDS:
            z = np.concatenate([run[kind] for run in runs])
            rms[way, kind] = float(np.sqrt(np.mean(z**2)))
            cells.append(f"{rms[way, kind]:.2f}, {100.0 * np.mean(np.abs(z) < 1.96):.1f} % of {len(z)}")
        rows.append([way, *cells])
    print(f"{count} units; z of accelerometers and gyros, and coverage of intervals of 95 %\n{shown(rows)}")
    if "--store" in sys.argv and count >= 20:
        store("thermometers_apart", {"thermometers": rows}, seed="from 0", N=count)
    honest = max(rms["each its own", kind] for kind in KINDS) < (1.9 if count < 20 else 1.1)
    wrong = min(rms["that of gyro", "accel"], rms["that of accel", "gyro"]) > 1.5
    print(f"\nDoes each chip need its own thermometer? {'Yes' if honest and wrong else 'No'}")
    return 0 if honest and wrong else 1


if __name__ == "__main__":
    sys.exit(main())
