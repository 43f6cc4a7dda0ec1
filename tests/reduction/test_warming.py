"""Temperatures within rests: their means by the record of the thermometer, and the noise of rests that warm."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tumble.inference.joint import joint
from tumble.planning.setup import Setup
from tumble.reduction.noise.coloured_noise import fit_coloured_noise
from tumble.reduction.rests.thermometer import STEP, Thermometers, Warmth, followed
from tumble.reduction.rests.warming import without_warming
from tumble.sensors.parameters import usual_sizes
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of
from tumble.simulation.temperature_profile import Climate
from tumble.units import ZERO_CELSIUS, Array


@pytest.mark.parametrize("lag", [0.0, 40.0])
def test_means_are_those_of_the_temperature_at_every_instant(lag: float) -> None:
    """Of a ramp up and down, in stretches that contain its peak, a moment, and what is beyond the record; of a second
    thermometer that reads twice the change."""
    time = np.arange(0.0, 601.0)
    kelvin = 280.0 + 0.1 * np.minimum(time, 600.0 - time)
    thermometers = Thermometers.of({0: (time, np.column_stack([kelvin, 2.0 * kelvin - 280.0]))})
    sensors_at = partial(np.interp, xp=STEP * np.arange(601), fp=followed(kelvin, STEP, lag))
    start, stop = np.array([10.0, 250.5, 290.0, 340.0, 595.0]), np.array([70.0, 280.0, 310.0, 340.0, 605.0])
    both = thermometers.means(np.zeros(5, dtype=np.int64), start, stop, lag)
    found = Warmth(kelvin=both.kelvin[:, 0], variance=both.variance[:, 0], hysteresis=both.hysteresis[:, 0])
    np.testing.assert_allclose(both.kelvin[:, 1] - 280.0, 2.0 * (found.kelvin - 280.0), rtol=1e-12)
    np.testing.assert_allclose(both.variance[:, 1], 4.0 * found.variance, rtol=1e-9, atol=1e-9)
    beside = np.array([0, 1, 3, 4])  # at the peak it has turned sooner
    np.testing.assert_allclose(both.hysteresis[beside, 1], found.hysteresis[beside], rtol=1e-9)
    for i, (a, b) in enumerate(zip(start, np.maximum(stop, start + 1.0), strict=True)):
        fine = np.linspace(a, b, 20001) - (0.5 if start[i] == stop[i] else 0.0)
        sensors = sensors_at(fine)
        assert found.kelvin[i] == pytest.approx(sensors.mean(), abs=2e-3)
        assert found.variance[i] == pytest.approx(sensors.var(), abs=2e-2)
    came = thermometers.direction(np.zeros(3, dtype=np.int64), np.array([1.0, 200.0, 400.0]))[:, 0]
    np.testing.assert_array_equal(came, [0.0, 1.0, -1.0])
    np.testing.assert_array_equal(np.sign(found.hysteresis[[0, 1, 4]]), [1.0, 1.0, -1.0])
    x = (float(sensors_at(340.0)) - 295.0) / 15.0
    assert abs(found.hysteresis[3]) == pytest.approx(1.0 - x**2, abs=1e-3)


def test_noise_of_rests_that_warm_is_that_of_their_sensors() -> None:
    """Slopes and curvatures of biases and scale factors, as MEMS units have them, leave it as it is; the third sensor
    goes with a thermometer of its own."""
    rng = np.random.default_rng(4)
    once = 1.0 - np.exp(-np.linspace(0.0, 3.0, 120))
    kelvin = [300.0 + 4.0 * np.column_stack([i + once, i + 2.0 * once**3]) for i in range(12)]
    thermometer = np.array([0, 0, 1])
    force = 9.8 * rng.uniform(-1.0, 1.0, (12, 3))
    noise = [1e-3 * rng.standard_normal((120, 3)) for _ in kelvin]
    warmer = [(each - 320.0)[:, thermometer] for each in kelvin]
    series = [
        (1.0 + 1.5e-4 * w + 2.5e-6 * w**2) * f + 3e-3 * w + 5e-5 * w**2 + e
        for w, f, e in zip(warmer, force, noise, strict=True)
    ]
    quiet = without_warming(series, lambda _: np.concatenate(kelvin), thermometer)
    np.testing.assert_allclose([q.mean(axis=0) for q in quiet], [s.mean(axis=0) for s in series], rtol=1e-12)
    white = 1e-3**2 / 120.0
    np.testing.assert_allclose(fit_coloured_noise(quiet).variance_of_mean(120), white, rtol=0.15)
    assert np.all(fit_coloured_noise(series).variance_of_mean(120) > 2.0 * white)
    assert without_warming(series, None, thermometer)[3] is series[3]
    assert without_warming(series, lambda _: np.full((1440, 2), 300.0), thermometer)[3] is series[3]


@pytest.mark.parametrize("lag", [90.0, -40.0])
def test_sensors_that_fall_behind_the_thermometer_are_no_noise(lag: float) -> None:
    """Where a ramp begins and where it turns back, the sensors bend away from it."""
    rng, time = np.random.default_rng(5), np.arange(0.5, 1440.0)
    course = np.arange(0.0, 1441.0), 290.0 + 0.05 * np.minimum(np.arange(1441.0), 1440.0 - np.arange(1441.0))
    course_of, file = Thermometers.of({0: (course[0], course[1][:, None])}), np.zeros(len(time), dtype=np.int64)

    def kelvin(lag: float) -> Array:
        return course_of.means(file, time, time, lag).kelvin

    warm, noise, first = kelvin(lag), 1e-3 * rng.standard_normal((1440, 3)), np.zeros(3, dtype=np.int64)
    series = np.split(1e-2 * (warm - 308.0) + noise, 12)
    expected = fit_coloured_noise(np.split(noise, 12)).variance_of_mean(120)
    quiet = without_warming(series, kelvin, first)
    np.testing.assert_allclose(fit_coloured_noise(quiet).variance_of_mean(120), expected, rtol=0.1)
    of_thermometer = without_warming(series, lambda _: kelvin(0.0), first)
    assert np.all(fit_coloured_noise(of_thermometer).variance_of_mean(120) > 2.0 * expected)


def test_a_turn_is_followed_while_it_warms() -> None:
    """At 8 K a minute biases change within a turn by several times its noise."""
    setup = Setup.of(grade="navigation", terms="full", rest=20.0)
    rng = np.random.default_rng(3)
    scenario = scenario_of(setup, rng).changed(further=usual_sizes("navigation"))
    slopes = {f"{kind}.{what}.{x}.t1": 0.0 for kind in ("accel", "gyro") for what in ("bias", "scale") for x in "xyz"}
    for name in slopes:
        slopes[name] = scenario.setup.further[f"{name[:-5]}.t1"] * rng.choice([-1.0, 1.0])
    kelvin = np.array([[-20.0], [60.0]]) + ZERO_CELSIUS
    climate = Climate(time=np.array([0.0, 600.0]), kelvin=kelvin, reference=float(kelvin.mean()))
    scenario = replace(scenario, truth=dict(scenario.truth) | slopes, climate=climate)
    fit = joint(simulate_observations(scenario, rng)).fits["noise within rests"]
    assert fit.chi_square < fit.degrees + 5.0 * np.sqrt(2.0 * fit.degrees)
