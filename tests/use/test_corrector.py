"""The corrector of live readings: the numbers of `apply` however a log is cut, and what it says beside them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.support.calibrated import HEXAD, calibration, warmed, with_fields
from tests.use.test_applied_model import N, corrected, larger, logged, read, truth
from tumble.errors import InputError
from tumble.inference.estimate import Outcome
from tumble.inference.prediction import Prediction
from tumble.recording.log import open_log
from tumble.recording.session_file import read_session
from tumble.result.calibration import Calibration
from tumble.result.parts import Parameter
from tumble.units import G_STANDARD, ZERO_CELSIUS, Array
from tumble.use.corrector import CLOCK_RESTART, Corrected, Corrector

Readings = tuple[Array, Array, Array, Array]
"""Readings of accelerometers and gyros, stamps, s, and temperatures, K."""


def late(accel: float, gyro: float) -> tuple[Parameter, ...]:
    """Lags of accelerometers and gyros behind their thermometer, s."""
    return tuple(
        Parameter(name=f"{kind}.lag", value=lag, u=0.1, unit="s") for kind, lag in (("accel", accel), ("gyro", gyro))
    )


def moving(*, lag: float = 1.5, gyro_lag: float = 1.5) -> tuple[Calibration, Readings]:
    """A calibration of all groups, with lever arms and lags, and the readings of a device in motion, with lost ones, a
    gap and a step of temperature."""
    made, instrument, values = larger(leave=("accel.delay",))
    parameters = (*made.parameters, *late(lag, gyro_lag))
    made = with_fields(made, parameters=parameters, covariance=None, sample_rate=100.0)
    celsius = np.where(np.arange(N) < 200, 15.0, 40.0) + np.sin(np.arange(N) / 50.0)
    accel, gyro = read(instrument, values, *truth(), celsius)
    time = 0.01 * np.arange(1, N + 1) + 1e-4 * np.random.default_rng(8).uniform(-1.0, 1.0, N)
    time[300:] += 0.4
    accel[50, 1], gyro[120, 2], celsius[260:265] = np.nan, np.nan, np.nan
    return made, (accel, gyro, time, celsius + ZERO_CELSIUS)


def fed(corrector: Corrector, readings: Readings, cuts: list[int]) -> tuple[Array, Array, Array, Array]:
    """Stamps, force, rate and flags of all samples, cut there; single samples come as such."""

    def parts() -> Iterator[Corrected]:
        for start, stop in zip([0, *cuts], [*cuts, len(readings[0])], strict=True):
            some = [each[start] if stop == start + 1 else each[start:stop] for each in readings]
            yield corrector.add(some[0], some[1], time=some[2], temperature=some[3])
        yield corrector.finish()

    copies = [(c.time.copy(), c.force.copy(), np.array(c.rate), c.flags.copy()) for c in parts()]
    time, force, rate, flags = (np.concatenate(each) for each in zip(*copies, strict=True))
    return time, force, rate, flags


@pytest.fixture(scope="module")
def applied(tmp_path_factory: pytest.TempPathFactory) -> tuple[Calibration, Readings, float, Array]:
    """The same as a log, its sample rate, and what `apply` makes of it."""
    made, (accel, gyro, time, kelvin) = moving()
    folder = logged(tmp_path_factory.mktemp("corrector"), time, accel, gyro, kelvin)
    expected = np.hstack(corrected(made, folder))
    return made, (accel, gyro, time, kelvin), open_log(read_session(folder)).rate, expected


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=40)
@given(cuts=st.lists(st.integers(0, N), max_size=30).map(sorted))
def test_any_cutting_into_blocks_gives_the_numbers_of_apply(
    applied: tuple[Calibration, Readings, float, Array], cuts: list[int]
) -> None:
    made, readings, rate, expected = applied
    corrector = Corrector(made, sample_rate=rate)
    time, force, turned, _ = fed(corrector, readings, cuts)
    np.testing.assert_array_equal(time, readings[2])
    np.testing.assert_allclose(np.hstack([force, turned]), expected, rtol=0.0, atol=1e-12)
    assert corrector.dropped == 0


def test_sample_by_sample_gives_the_numbers_of_apply(applied: tuple[Calibration, Readings, float, Array]) -> None:
    made, readings, rate, expected = applied
    _, force, turned, _ = fed(Corrector(made, sample_rate=rate), readings, list(range(1, N)))
    np.testing.assert_allclose(np.hstack([force, turned]), expected, rtol=0.0, atol=1e-12)
    assert np.flatnonzero(np.isnan(force).any(axis=1)).tolist() == [50]


def test_a_long_block_is_that_of_short_ones() -> None:
    """Longer than what is corrected at a time."""
    made, (accel, gyro, _, _) = moving()
    time: Array = 0.01 * np.arange(20.0 * N)
    many = np.tile(accel, (20, 1)), np.tile(gyro, (20, 1)), time, np.full_like(time, 300.0)
    whole = fed(Corrector(made), many, [])
    for ours, theirs in zip(whole, fed(Corrector(made), many, [3, 5000, 5001])):  # noqa: B905  # of four arrays
        np.testing.assert_array_equal(ours, theirs)


def test_nothing_is_allocated_for_the_next_block_of_a_length() -> None:
    made, (accel, gyro, time, _) = moving()
    corrector = Corrector(made)
    corrector.add(accel[:9], gyro[:9], time=time[:9])
    first, second = (corrector.add(accel[k], gyro[k], time=time[k]) for k in (9, 10))
    assert second is first
    corrector.add(accel[11:14], gyro[11:14], time=time[11:14])
    assert np.shares_memory(corrector.add(accel[14], gyro[14], time=time[14]).force, first.force)


def test_without_lever_arms_a_sample_is_correct_at_once() -> None:
    made, instrument, values = larger()
    force, rate = truth()
    accel, gyro = read(instrument, values, force, rate)
    corrector = Corrector(made, sample_rate=100.0)
    assert corrector.delay == 0
    for k in range(5):
        found = corrector.add(accel[k], gyro[k])
        assert found.rate is not None
        np.testing.assert_allclose(found.force[0], force[k], atol=1e-8)
        np.testing.assert_allclose(found.rate[0], rate[k], atol=1e-8)
        assert found.time[0] == pytest.approx(0.01 * k)
    assert len(corrector.finish()) == 0


def lagging(lag: float = 1.5) -> tuple[Calibration, float, float]:
    """A calibration whose sensors follow their thermometer with a lag, s, and its reference temperature, °C."""
    made = warmed(calibration(), curved=False)
    assert made.reference_temperature is not None
    parameters = (*made.parameters, *late(lag, lag))
    return replace(made, parameters=parameters, covariance=None), made.reference_temperature, lag


def test_sensors_follow_a_step_of_the_thermometer_with_the_lag() -> None:
    """1 − e^{−t/λ} after it, a straight line between the two readings of the step."""
    made, reference, lag = lagging()
    kelvin = np.where(np.arange(400) < 10, reference, reference + 20.0) + ZERO_CELSIUS
    still = np.tile([0.0, 0.0, G_STANDARD], (400, 1)), np.zeros((400, 3))
    corrected = Corrector(made, sample_rate=100.0).add(*still, temperature=kelvin)
    found = corrected.rate
    assert found is not None
    step = lag * (1.0 - np.exp(-0.01 / lag)) / 0.01
    risen = np.where(np.arange(400) < 10, 0.0, 1.0 - step * np.exp(-0.01 * (np.arange(400) - 10) / lag))
    _, expected = made.apply(*still, temperature=reference + 20.0 * risen + ZERO_CELSIUS)
    assert expected is not None
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-14)
    sensors = reference + 20.0 * risen + ZERO_CELSIUS
    np.testing.assert_allclose(corrected.temperature, sensors[:, None], rtol=0.0, atol=1e-10)
    assert np.abs(np.ptp(found, axis=0)).max() > 1e-3


def test_the_temperature_last_known_counts_and_before_it_the_reference() -> None:
    made = warmed(calibration())
    reference = made.reference_temperature
    assert reference is not None
    corrector = Corrector(made, sample_rate=100.0)
    accel, gyro = np.array([0.1, 0.2, 9.8]), np.array([0.1, -0.2, 0.3])
    for given_kelvin, celsius in ((None, reference), (np.nan, reference), (310.0, 36.85), (None, 36.85)):
        found = corrector.add(accel, gyro, temperature=given_kelvin)
        force, rate = made.apply(accel[None], gyro[None], temperature=celsius + ZERO_CELSIUS)
        assert found.rate is not None
        assert rate is not None
        np.testing.assert_allclose(found.force, force, rtol=0.0, atol=1e-14)
        np.testing.assert_allclose(found.rate, rate, rtol=0.0, atol=1e-14)


def test_the_angular_acceleration_is_not_known_across_a_gap() -> None:
    """Samples 2 and 3, on its sides, stay where their sensors are; others are moved, those at the ends too."""
    made, (accel, gyro, _, _) = moving()
    time = np.array([0.0, 0.01, 0.02, 0.07, 0.08, 0.09])
    some = accel[:6], gyro[:6], time, np.full(6, 300.0)
    _, force, _, _ = fed(Corrector(made), some, [])
    alone, _ = made.apply(*some[:2], temperature=some[3])
    assert np.flatnonzero(np.abs(force - alone).max(axis=1) > 1e-6).tolist() == [0, 1, 4, 5]


def test_late_samples_are_dropped_and_counted() -> None:
    made, readings = moving()
    order = np.insert(np.arange(100), [11, 40, 40], [9, 39, 30])
    expected = fed(Corrector(made), tuple(each[:100] for each in readings), [])  # type: ignore[arg-type]  # four arrays
    for cuts in ([], [12, 13, 41, 42, 43, 60]):
        corrector = Corrector(made)
        found = fed(corrector, tuple(each[order] for each in readings), cuts)  # type: ignore[arg-type]  # four arrays
        assert corrector.dropped == 3
        for ours, theirs in zip(found, expected, strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_a_clock_that_starts_anew_is_a_gap() -> None:
    made, (accel, gyro, _, _) = moving()
    time = np.concatenate([100.0 + 0.01 * np.arange(10), 0.01 * np.arange(10)])
    assert time[9] - time[10] > CLOCK_RESTART
    some = accel[:20], gyro[:20], time, np.full(20, 300.0)
    corrector = Corrector(made)
    stamps, force, _, _ = fed(corrector, some, [7])
    np.testing.assert_array_equal(stamps, time)
    assert corrector.dropped == 0
    alone, _ = made.apply(*some[:2], temperature=some[3])
    assert np.flatnonzero(np.abs(force - alone).max(axis=1) < 1e-9).tolist() == [9, 10]


def test_another_stream_begins_after_the_last_sample() -> None:
    made, readings = moving()
    corrector = Corrector(made)
    for ours, theirs in zip(fed(corrector, readings, [77]), fed(corrector, readings, [3]), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    corrector.add(readings[0][0], readings[1][0], time=1.0)
    corrector.reset()
    assert len(corrector.finish()) == 0


def test_what_lags_goes_by_the_stamps() -> None:
    """A step, then samples 0.01, 0.02 and 3 s apart: e^{−t/λ} of what is left, whatever the sample rate says."""
    made, reference, lag = lagging()
    time = np.array([0.0, 0.01, 0.02, 0.04, 3.04, 3.05])
    kelvin = reference + ZERO_CELSIUS + 20.0 * np.array([0.0, 1.0, 1.0, 1.0, 1.0, 1.0])
    still = np.tile([0.0, 0.0, G_STANDARD], (6, 1)), np.zeros((6, 3))
    found = Corrector(made, sample_rate=100.0).add(*still, time=time, temperature=kelvin).rate
    assert found is not None
    left = lag * (1.0 - np.exp(-0.01 / lag)) / 0.01 * np.exp(-(time - 0.01) / lag)
    risen = np.where(time < 0.01, 0.0, 1.0 - left)
    _, expected = made.apply(*still, temperature=reference + 20.0 * risen + ZERO_CELSIUS)
    assert expected is not None
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-14)


def test_accelerometers_and_gyros_follow_the_thermometer_each_with_their_lag() -> None:
    """Force as with the lag of the accelerometers for all, rate as with that of the gyros; however the stream is cut,
    with lost temperatures, late samples and gaps."""
    made, readings = moving(lag=1.5, gyro_lag=-4.0)
    order = np.insert(np.arange(400), [11, 40, 40], [9, 39, 30])
    some: Readings = tuple(each[order] for each in readings)  # type: ignore[assignment]  # four arrays
    whole = fed(Corrector(made), some, [])
    for cuts in ([12, 13, 41, 42, 43, 60], [200, 262, 263, 301]):
        for ours, theirs in zip(fed(Corrector(made), some, cuts), whole, strict=True):
            np.testing.assert_array_equal(ours, theirs)
    _, force, _, _ = fed(Corrector(moving(lag=1.5, gyro_lag=1.5)[0]), some, [])
    _, _, rate, _ = fed(Corrector(moving(lag=-4.0, gyro_lag=-4.0)[0]), some, [])
    np.testing.assert_allclose(whole[2], rate, atol=1e-5)  # the gyros feel the force
    assert np.nanmax(np.abs(whole[2] - fed(Corrector(moving(lag=1.5, gyro_lag=1.5)[0]), some, [])[2])) > 1e-3
    np.testing.assert_allclose(whole[1], force, atol=5e-3)  # levers turn with the gyros


def test_samples_outside_of_what_was_calibrated_are_flagged() -> None:
    made = replace(warmed(calibration()), prediction=Prediction(force_u=1e-3, rate_u=1e-4, at_rate=1.0))
    corrector = Corrector(made, sample_rate=100.0)
    assert corrector.ranges.temperature == (-18.5, 57.25)
    accel = np.array([[0.0, 0.0, 9.8], [0.0, 0.0, 12.0], [0.0, 0.0, 9.8], [np.nan, 0.0, 9.8], [8.0, 8.0, 8.0]])
    gyro = np.array([[0.9, 0.0, 0.0], [0.0, 0.0, 0.0], [0.9, 0.9, 0.9], [0.0, 0.0, 0.0], [3.0, 0.0, 0.0]])
    found = corrector.add(accel, gyro, temperature=ZERO_CELSIUS + np.array([20.0, np.nan, 57.0, -30.0, 58.0]))
    assert found.flags.tolist() == [0, 4, 2, 1, 7]
    assert found.outside["temperature"].tolist() == [False, False, False, True, True]
    assert found.outside["rate"].tolist() == [False, False, True, False, True]
    assert found.outside["force"].tolist() == [False, True, False, False, True]


def test_gyros_alone_leave_the_specific_force_unknown() -> None:
    why = ("the accelerometers scatter",)
    made = with_fields(calibration(), outcome=Outcome(reasons=why, concerns={why[0]: ("accel",)}), sample_rate=100.0)
    found = Corrector(made).add([0.1, 0.2, 9.8], [0.1, 0.2, 0.3])
    assert np.isnan(found.force).all()
    _, rate = made.apply([0.1, 0.2, 9.8], [0.1, 0.2, 0.3])
    assert rate is not None
    np.testing.assert_allclose(np.array(found.rate)[0], rate, atol=1e-15)


def test_accelerometers_alone_and_blocks_of_six_are_corrected() -> None:
    made = calibration(accel=HEXAD, with_gyro=False)
    readings = 9.8 * np.random.default_rng(2).standard_normal((50, 6))
    corrector = Corrector(made, sample_rate=100.0)
    found = corrector.add(readings)
    assert found.rate is None
    np.testing.assert_allclose(found.force, made.apply(readings)[0], rtol=0.0, atol=1e-13)


def test_what_does_not_fit_is_refused(tmp_path: Path) -> None:
    made = calibration()
    with pytest.raises(InputError, match="sample_rate: expected samples a second, found None"):
        Corrector(made)
    with pytest.raises(InputError, match="sample_rate: expected samples a second, found -1"):
        Corrector(made, sample_rate=-1.0)
    made.write(tmp_path / "c.json")
    corrector, accel, gyro = Corrector(tmp_path / "c.json", sample_rate=100.0), np.zeros((5, 3)), np.zeros((5, 3))
    with pytest.raises(InputError, match=r"accel readings: expected 3 numbers a sample.*\(5, 2\)"):
        corrector.add(accel[:, :2], gyro)
    with pytest.raises(InputError, match=r"gyro readings: expected 3 numbers a sample.*none"):
        corrector.add(accel)
    with pytest.raises(InputError, match="as many gyro readings and stamps"):
        corrector.add(accel, gyro[:4])
    with pytest.raises(InputError, match="as many gyro readings and stamps"):
        corrector.add(accel, gyro, time=[0.1])
    with pytest.raises(InputError, match="expected kelvin, found 20"):
        corrector.add(accel, gyro, temperature=np.full(5, 20.0))
    with pytest.raises(InputError, match="temperature: expected 1 for each of 5 samples"):
        corrector.add(accel, gyro, temperature=300.0)
    with pytest.raises(InputError, match="gyro readings: expected 0 numbers a sample"):
        Corrector(calibration(with_gyro=False), sample_rate=100.0).add(accel, gyro)
