"""What do instantaneous samples of jerky turns by hand do to a calibration, and does u contain it?

A unit of the grade consumer, 20 positions by hand, rests of 10 s, 62.5 samples a second. Wherever it is taken up or put
down the hand shakes it: oscillations of 10 to 120 Hz that die out in 30 to 100 ms, of some 10 °/s and 4 m/s², twelve a
turn, that end as they began, at rest. The same motion is sampled as means over the intervals between samples, as a
filter before the sampling gives them, and as instantaneous values, in which whatever is above 31 Hz comes out at
another frequency, down to zero, where it is a rotation that never was.
"""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np

import tumble
from tumble.earth import earth_rate, normal_gravity
from tumble.planning.setup import Setup
from tumble.result.calibration import Calibration
from tumble.rotation import rotation_matrix, rotation_vector
from tumble.sensors.instrument import Instrument, readings
from tumble.sensors.parameters import FURTHER
from tumble.simulation.scenario import scenario_of
from tumble.units import DEGREE, Array

LATITUDE = 59.35 * DEGREE
RATE, FINE = 62.5, 32
"""Samples a second, and steps of the simulation within the interval of one."""
POSITIONS, REST, TURN, STILL = 20, 10.0, 3.0, 0.2
OSCILLATIONS = 12
SHAKEN_RATE, SHAKEN_FORCE = 10.0 * DEGREE, 4.0
ACCEL_NOISE, GYRO_NOISE = 2e-3, 0.01 * DEGREE
"""m/s²/√Hz and rad/s/√Hz."""


def shaken(rng: np.random.Generator, time: Array, size: float) -> Array:
    """Accelerations, or rates, (N, 3) of oscillations that begin and end with nothing, and whose integral does."""
    step, out = time[1] - time[0], np.zeros((len(time), 3))
    for _ in range(OSCILLATIONS):
        begin = rng.choice([0.0, TURN - 0.6]) + rng.uniform(0.0, 0.1)
        passed = np.maximum(time - begin, 0.0)
        pulse = (
            passed
            / 0.01
            * np.exp(-passed / rng.uniform(0.03, 0.1))
            * np.sin(2.0 * np.pi * rng.uniform(10.0, 120.0) * passed)
        )
        pulse[time > TURN - 2.0 * step] = 0.0
        swing = np.gradient(pulse, step)  # of what returns to where it was
        out += size * rng.uniform() * np.outer(swing / np.abs(swing).max(), rng.standard_normal(3) / np.sqrt(3.0))
    return out


def turned(rng: np.random.Generator, L: Array, gravity: float) -> tuple[Array, Array, Array]:
    """Rates and forces (N · FINE, 3) in the body of a turn by hand from an attitude, in steps, and the attitude after
    it."""
    earth, step = np.array(earth_rate(LATITUDE)), 1.0 / (RATE * FINE)
    time = (np.arange(round(TURN * RATE) * FINE) + 0.5) * step
    share = np.clip((time - STILL) / (TURN - 2.0 * STILL), 0.0, 1.0)
    axis = rng.standard_normal(3)
    speed = rng.uniform(0.8, 2.6) * np.sin(np.pi * share) ** 2 / (0.5 * (TURN - 2.0 * STILL))
    swung = np.outer(speed, axis / np.linalg.norm(axis)) + shaken(rng, time, SHAKEN_RATE)
    moved = shaken(rng, time, SHAKEN_FORCE)
    half, whole = rotation_matrix(0.5 * step * swung), rotation_matrix(step * swung)
    attitudes = np.empty((len(time), 3, 3))
    for i in range(len(time)):
        attitudes[i] = L @ half[i]
        L = L @ whole[i]
    down = np.swapaxes(attitudes, 1, 2)
    return swung + down @ earth, down @ np.array([0.0, gravity, 0.0]) + moved, rotation_matrix(rotation_vector(L))


def motion(rng: np.random.Generator) -> tuple[Array, Array]:
    """Rates and forces (N, FINE, 3) of the body in the intervals of a session."""
    earth, gravity = np.array(earth_rate(LATITUDE)), normal_gravity(LATITUDE, 0.0)
    L = rotation_matrix(rng.uniform(-np.pi, np.pi, 3))
    still, parts = np.ones((round(REST * RATE) * FINE, 1)), []
    for k in range(POSITIONS):
        parts.append((still * (L.T @ earth), still * (gravity * L[1])))
        if k < POSITIONS - 1:
            rates, forces, L = turned(rng, L, gravity)
            parts.append((rates, forces))
    rates, forces = (np.concatenate(each).reshape(-1, FINE, 3) for each in zip(*parts, strict=True))
    return rates, forces


def unit(number: int) -> tuple[dict[str, Calibration], dict[str, float]]:
    """The calibrations of a session of instantaneous samples and of one of means, and the truth."""
    rng = np.random.default_rng([41, number])
    scenario = scenario_of(Setup.of(grade="consumer", positions=POSITIONS), rng, serial=f"unit-{number}")
    steady = [g.name for g in FURTHER if g.regressors is not None and g.name in scenario.setup.further]
    instrument = Instrument.of(scenario.accel, scenario.gyro, steady)
    values = np.array([scenario.truth[name] for name in instrument.names])
    rates, forces = motion(rng)
    noise = rng.standard_normal((2, len(rates), 3)) * np.sqrt(RATE)
    found = {}
    for way, of in (("instantaneous", lambda x: x[:, FINE // 2]), ("means", lambda x: x.mean(axis=1))):
        accel, gyro = (
            readings(block, instrument.coefficients(block, values), of(forces), of(rates)) + size * own
            for block, size, own in zip((scenario.accel, scenario.gyro), (ACCEL_NOISE, GYRO_NOISE), noise, strict=True)
        )
        found[way] = tumble.calibrate(accel=accel, gyro=gyro, rate=RATE, latitude=LATITUDE)
    return found, dict(zip(instrument.names, values.tolist(), strict=True))


def errors(found: Calibration, truth: dict[str, float]) -> Array:
    """Errors over u of the parameters whose truth is known."""
    return np.array([(p.value - truth[p.name]) / p.u for p in found.parameters if p.name in truth and p.u])


def main() -> int:
    count, fine, least = 1 if "--short" in sys.argv else 40, True, {"means": 0.9, "instantaneous": 0.7}
    units = [unit(number) for number in range(count)]
    for way in ("means", "instantaneous"):
        off = [errors(found[way], truth) for found, truth in units if found[way].outcome.accepted]
        verdicts = Counter(found[way].outcome.verdict for found, _ in units)
        z = np.concatenate(off) if off else np.zeros(0)
        u = np.median(
            [p.u for found, _ in units for p in found[way].parameters if p.name.startswith("gyro.scale") and p.u]
        )
        print(f"{way}: {dict(verdicts)}; errors over u of what is accepted, rms {np.sqrt(np.mean(z**2)):.2f},", end=" ")
        print(f"{100.0 * np.mean(np.abs(z) > 3.0):.1f} % of {len(z)} beyond 3; u of gyro scale {1e6 * u:.0f} ppm")
        fine &= len(off) >= least[way] * count and bool(np.sqrt(np.mean(z**2)) < 1.25)
    print(f"\nDoes u contain what instantaneous samples do to jerky turns? {'Yes' if fine else 'No'}")
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main())
