"""A device that lies still while it warms or cools, by recordings of another program (`tests.support.warming`)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.calibrated import calibration
from tests.support.warming import G, Warming, cubic_fit, known_u, warming
from tumble import Calibration, InputError, calibrate, read_calibration
from tumble.export import export_calibration
from tumble.inference.sources import earth_at_rest
from tumble.recording.arrays import session_of_arrays
from tumble.reduction.rests.thermometer_errors import curve_through, level_crossings
from tumble.result.parts import CalibratedTemperature
from tumble.result.temperature_curves import temperature_curve
from tumble.sensors.model import SensorModel
from tumble.units import Array
from tumble.views.report.over_temperature import rest_in_parts

POWERS = (1, 2, 3)
KINDS = ("accel", "gyro")


def slopes(made: Calibration, kind: str) -> Array:
    """Coefficients (3, 3) of the biases, by sensor and power."""
    return np.array([[made[f"{kind}.bias.{x}.t{k}"].value for k in POWERS] for x in "xyz"])


def off(made: Calibration, true: Warming, kind: str) -> Array:
    """Errors (41, 3) of the changes of the readings in this attitude over the range, less their mean."""
    T = np.linspace(*(made.temperature_range or (0.0, 0.0)), 41)
    d = T - (made.reference_temperature or 0.0)
    error = np.stack([d, d**2, d**3], axis=1) @ slopes(made, kind).T - true.changes(kind, T)
    return np.asarray(error - error.mean(axis=0))


def off_by_fit(made: Calibration, true: Warming, kind: str) -> Array:
    """The same of a plain cubic over the thermometer."""
    T = np.linspace(*(made.temperature_range or (0.0, 0.0)), 41)
    read = cubic_fit(true.celsius, getattr(true, kind))
    fitted = np.stack([np.polyval(read[:, i], T - true.celsius.mean()) for i in range(3)], axis=1)
    error = fitted - true.changes(kind, T)
    return np.asarray(error - error.mean(axis=0))


@pytest.fixture(scope="module")
def recorded() -> Warming:
    """A board that warms by 40 K behind whose thermometer the sensors are by a minute."""
    return warming(11, span=40.0, lag=60.0, seconds=1200.0)


@pytest.fixture(scope="module")
def alone(recorded: Warming) -> Calibration:
    """What it says by itself."""
    return calibrate(**recorded.arrays)


def test_the_parts_of_a_rest_lie_on_the_curve_of_the_sensors_that_lag(alone: Calibration) -> None:
    """In the picture of a report: at the temperature of the thermometer they are off by a tenth of the change."""
    reference = alone.reference_temperature or 0.0
    for name in ("accel.bias.y", "gyro.bias.z"):
        ((celsius, read),) = rest_in_parts(alone, name, reference)
        curve = temperature_curve(alone, name, np.append(celsius, reference)).value
        off = read - (curve[:-1] - curve[-1])
        assert np.sqrt(np.mean(off**2)) < 0.03 * np.ptp(curve)


def test_coefficients_and_lags_are_right_and_better_than_a_plain_fit(recorded: Warming, alone: Calibration) -> None:
    assert alone.outcome.accepted
    for kind in KINDS:
        lag = alone[f"{kind}.lag"]
        assert abs(lag.value - recorded.lag[kind]) < 4.0 * (lag.u or 0.0)
        assert np.linalg.norm(off(alone, recorded, kind)) < 0.5 * np.linalg.norm(off_by_fit(alone, recorded, kind))
        T = np.array(alone.temperature_range)
        for i, x in enumerate("xyz"):
            found, d = temperature_curve(alone, f"{kind}.bias.{x}", T), T - recorded.middle
            at = (alone.reference_temperature or 0.0) - recorded.middle
            b = recorded.biases[kind][i]
            true = b @ [d, d**2, d**3] - b @ [at, at**2, at**3]
            change = found.value - (alone[f"{kind}.bias.{x}"].value if kind == "gyro" else 0.0)
            assert (np.abs(change - true) < 2.0 * np.array(found.expanded)).all()


def test_what_one_attitude_does_not_show_is_said_and_left_out_of_files(alone: Calibration) -> None:
    assert {"accel.bias.x", "accel.scale.z", "gyro.axis.xy"} <= set(alone.outcome.unobservable)
    assert not any(name.startswith(("accel.bias.x.h", "accel.scale")) for name in alone)
    assert any("taken as 0; tumble calibrate LOG --base" in said for said in alone.provenance.assumptions)
    u_reading, u_usual = 30e-6 * G, 150e-6 * np.abs(G)
    assert all((alone[f"accel.bias.{x}.t1"].u or 0.0) < u_reading + u_usual for x in "xyz")
    px4 = export_calibration(alone, "px4-thermal").content.decode()
    assert "CAL_GYRO0_XOFF" in px4
    assert "CAL_ACC0_XOFF" not in px4
    assert "TC_A0_X3_0" in px4
    ardupilot = export_calibration(alone, "ardupilot-thermal").content.decode()
    assert "INS_TCAL1_ACC3_X" in ardupilot
    assert "INS_ACCOFFS_X" not in ardupilot
    assert "INS_ACC1_CALTEMP" not in ardupilot
    assert "accel.bias.x" in export_calibration(alone, "csv-thermal").content.decode()
    assert "bias_cube" in export_calibration(alone, "c").content.decode()


def test_files_of_autopilots_say_the_curves_of_the_estimate(alone: Calibration) -> None:
    """PX4's polynomial above TREF, ArduPilot's in millionths about 35 °C, both of the third degree."""

    def parameters(to: str, separator: str, name: int) -> dict[str, float]:
        lines = export_calibration(alone, to).content.decode().splitlines()
        every = (line.split(separator) for line in lines if not line.startswith("#"))
        return {fields[name]: float(fields[name + 1]) for fields in every}

    px4, ardupilot = parameters("px4-thermal", "\t", 2), parameters("ardupilot-thermal", ",", 0)
    T = np.linspace(*(alone.temperature_range or (0.0, 0.0)), 9)
    for kind, stem, short in (("accel", "TC_A0", "ACC"), ("gyro", "TC_G0", "GYR")):
        for i, x in enumerate("xyz"):
            told = temperature_curve(alone, f"{kind}.bias.{x}", T).value
            d = T - px4[f"{stem}_TREF"]
            by_px4 = [px4[f"{stem}_X{k}_{i}"] * d**k for k in POWERS]
            by_ardupilot = [1e-6 * ardupilot[f"INS_TCAL1_{short}{k}_{x.upper()}"] * (T - 35.0) ** k for k in POWERS]
            for terms in (by_px4, by_ardupilot):
                found = np.sum(terms, axis=0)
                assert found - found[0] == pytest.approx(told - told[0], abs=1e-4 * float(np.ptp(told)))


def test_gyro_biases_have_the_earths_rate_of_unknown_heading_in_them(recorded: Warming, alone: Calibration) -> None:
    up = recorded.accel.mean(axis=0) / G
    mean, covariance = earth_at_rest(up / np.linalg.norm(up), np.radians(50.0))
    for i, x in enumerate("xyz"):
        assert (alone[f"gyro.bias.{x}"].u or 0.0) > np.sqrt(covariance[i, i])
    assert np.linalg.norm(mean) == pytest.approx(7.292115e-5 * np.sin(np.radians(50.0)))
    assert np.trace(covariance) == pytest.approx((7.292115e-5 * np.cos(np.radians(50.0))) ** 2)
    assert np.trace(earth_at_rest(None, 0.5)[1]) == pytest.approx(7.292115e-5**2)


def test_u_of_gyro_biases_includes_gravity_by_the_usual_g_sensitivity(recorded: Warming) -> None:
    """With a g-sensitivity of 100 °/h/g, three times the usual one of MEMS, the biases are off by what u says."""
    up = recorded.accel.mean(axis=0) / G
    by_force = np.radians(100.0 / 3600.0) * np.array([up[2], -up[2], up[2]])
    made = calibrate(**{**recorded.arrays, "gyro": recorded.arrays["gyro"] + by_force})
    without = calibrate(**recorded.arrays)
    for name in ("gyro.bias.x", "gyro.bias.y", "gyro.bias.z"):
        assert abs(made[name].value - without[name].value) < 4.0 * (made[name].u or 0.0)
    assert "prior.gyro.g_sensitivity" in {line.name for line in made.evidence.budget}


def test_the_doubt_of_a_draft_is_repeated_with_the_result(recorded: Warming) -> None:
    session = session_of_arrays(**recorded.arrays)
    made = calibrate(replace(session, log=replace(session.log, doubt="gyros in deg/s by a guess")))
    assert "doubt: gyros in deg/s by a guess" in made.provenance.doubts


@pytest.fixture(scope="module")
def base() -> Calibration:
    """A calibration at 20 °C."""
    return replace(calibration(1), temperature=CalibratedTemperature(reference=20.0))


def test_a_calibration_gets_coefficients_and_stays_what_it_is(base: Calibration, tmp_path: Path) -> None:
    models = {kind: SensorModel(matrix=m.matrix, bias=m.bias) for kind in KINDS if (m := getattr(base, kind))}
    recorded = warming(12, span=30.0, lag=30.0, seconds=1200.0, models=models)
    made = calibrate(base=base, **recorded.arrays)
    linear = [name for name in base if name.count(".") == 2]
    assert all(made[name].value == base[name].value and made[name].u == base[name].u for name in linear)
    assert made.reference_temperature == base.reference_temperature
    at = (made.reference_temperature or 0.0) - recorded.middle
    for kind in KINDS:
        for i, x in enumerate("xyz"):
            b1, b2, b3 = recorded.biases[kind][i]
            true = b1 + 2.0 * b2 * at + 3.0 * b3 * at**2, b2 + 3.0 * b3 * at, b3
            found = [made[f"{kind}.bias.{x}.t{k}"] for k in POWERS]
            assert all(abs(p.value - v) < 4.0 * (p.u or 0.0) for p, v in zip(found, true, strict=True))
    made.write(tmp_path / "made.json")
    assert read_calibration(tmp_path / "made.json") == made
    assert "CAL_ACC0_XOFF" in export_calibration(made, "px4-thermal").content.decode()
    warm = np.full(2, 313.15)
    force, _ = made.apply(recorded.accel[:2], recorded.gyro[:2], temperature=warm)
    assert np.isfinite(force).all()


def test_a_calibration_of_unknown_temperature_gets_no_coefficients(base: Calibration, recorded: Warming) -> None:
    unknown = replace(base, temperature=type(base.temperature)())
    with pytest.raises(InputError, match="expected one that states its temperature"):
        calibrate(base=unknown, **recorded.arrays)


def test_two_attitudes_tell_scale_factors_and_biases_apart(base: Calibration) -> None:
    models = {kind: SensorModel(matrix=m.matrix, bias=m.bias) for kind in KINDS if (m := getattr(base, kind))}
    recorded = warming(2, span=30.0, lag=40.0, seconds=1200.0, turns=3, models=models)
    made = calibrate(base=base, **recorded.arrays)
    for i, x in enumerate("xyz"):
        scale = made[f"accel.scale.{x}.t1"]
        assert abs(scale.value - recorded.scales[i]) < 4.0 * (scale.u or 0.0) < 600e-6


def test_whole_degrees_are_no_steps_of_the_sensors() -> None:
    seconds = np.arange(1000.0)
    for true in (290.0 + 0.01 * seconds, 300.0 - 10.0 * np.exp(-seconds / 250.0), 295.0 - 0.02 * abs(seconds - 480.0)):
        read = np.round(true)
        off_by = np.abs(curve_through(*level_crossings(seconds, read), seconds, read) - true)
        assert np.median(off_by) < 0.05
        assert off_by.max() < 0.51  # where it turns back between two levels
    noisy = np.round(true + 0.05 * np.random.default_rng(1).standard_normal(1000))
    assert np.abs(curve_through(*level_crossings(seconds, noisy), seconds, noisy) - true).std() < 0.1
    recorded = warming(13, span=25.0, lag=60.0, seconds=1200.0, whole_degrees=True)
    made = calibrate(**recorded.arrays)
    for kind in KINDS:
        assert np.linalg.norm(off(made, recorded, kind)) < 0.8 * np.linalg.norm(off_by_fit(made, recorded, kind))


def test_readings_interpolated_between_whole_degrees_are_no_levels() -> None:
    """A thermometer read every 5 s, whose readings a log has interpolated; and before the first of its levels and
    after the last the temperature goes on as it bends."""
    seconds = np.arange(0.0, 1200.0, 0.5)
    true = 300.0 - 20.0 * np.exp(-seconds / 300.0)
    read = np.interp(seconds, seconds[::10], np.round(true[::10]))
    time, level = level_crossings(seconds, read)
    assert (level % 1.0 == 0.5).all()
    assert len(level) == 20
    assert np.abs(curve_through(time, level, seconds, read) - true).max() < 0.2


def test_readings_that_change_too_fast_to_repeat_are_levels() -> None:
    """A chip of fine resolution that warms by more than a step between readings at first, and hardly later."""
    seconds = np.arange(0.0, 1200.0, 0.1)
    true = 350.0 - 50.0 * np.exp(-seconds / 150.0)
    for step in (0.02, 1.0 / 132.48):
        read = np.round(np.round(true / step) * step, 4)
        time, level = level_crossings(seconds, read)
        assert time[0] < 1.0
        assert np.abs(curve_through(time, level, seconds, read) - true).max() < step


@pytest.mark.parametrize("seed", [21, 22])
def test_u_holds_where_the_thermometer_reads_whole_degrees(seed: int) -> None:
    """Between two of its readings a record at whole seconds has values that are none: levels were seen that were not
    passed then, the curve was 0.2 K off, and so were the lags."""
    recorded = warming(seed, span=25.0, lag=60.0, seconds=1200.0, whole_degrees=True)
    made, z = calibrate(**recorded.arrays), list[float]()
    for kind in KINDS:
        lag = made[f"{kind}.lag"]
        z.append((lag.value - recorded.lag[kind]) / (lag.u or np.inf))
    low, high = made.temperature_range or (0.0, 0.0)
    at = made.reference_temperature or 0.0
    error = off(made, recorded, "gyro")
    for i, x in enumerate("xyz"):
        d = np.array([low, high]) - at
        powers = np.array([d**k for k in POWERS])
        change = powers[:, 1] - powers[:, 0]
        u = np.sqrt(change @ made.covariance_of([f"gyro.bias.{x}.t{k}" for k in POWERS]) @ change)
        z.append(float((error[-1, i] - error[0, i]) / u))
    assert np.abs(z).max() < 3.0, np.round(z, 1)


def test_accelerometers_that_tilt_the_vertical_by_their_temperature_lie_still(recorded: Warming) -> None:
    """A metre per second squared over 40 K moves it by 3°, more than it may move in a rest: a board that lay still
    was taken for one that moves, of which the estimate broke down."""
    across = np.cross(recorded.accel.mean(axis=0), [0.0, 0.0, 1.0])
    tilted = np.outer((recorded.celsius - recorded.celsius.mean()) / 40.0, across / np.linalg.norm(across))
    made = calibrate(**recorded.arrays | {"accel": recorded.accel + tilted})
    assert made.outcome.accepted, made.outcome
    assert "accel.bias.x.t1" in made


def test_u_is_hardly_less_than_with_sizes_that_are_known() -> None:
    """The wandering of biases is learned from forty parts: with scatter and sensors unlike others beside it the
    integral rested on a few points, and u was half of what it has to be."""
    recorded = warming(28, span=35.0, course="cooling", seconds=2700.0)
    made = calibrate(**recorded.arrays)
    low, high = made.temperature_range or (0.0, 0.0)
    middle, u = 0.5 * (low + high) - (made.reference_temperature or 0.0), []
    for x in "xyz":
        covariance = made.covariance_of([f"gyro.bias.{x}.t{k}" for k in POWERS])
        ends = np.array(
            [[(middle + d) ** k - middle**k for k in POWERS] for d in (0.5 * (low - high), 0.5 * (high - low))]
        )
        u.append(np.sqrt(np.diag(ends @ covariance @ ends.T)))
    ratio = np.median(np.array(u) / known_u(recorded, "gyro"), axis=0)
    assert ((ratio > 0.65) & (ratio < 1.5)).all()


def test_three_kelvin_say_little_and_a_log_without_thermometer_nothing(base: Calibration) -> None:
    recorded = warming(14, span=3.0, seconds=600.0)
    made = calibrate(**recorded.arrays)
    assert any(
        "temperatures span 2." in said and "have their usual sizes" in said for said in made.provenance.assumptions
    )
    arrays = {name: value for name, value in recorded.arrays.items() if name != "temperature"}
    with pytest.raises(InputError, match="expected the temperature beside the readings"):
        calibrate(base=base, **arrays)
    assert not calibrate(**arrays).outcome.accepted
