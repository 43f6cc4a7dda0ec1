"""PX4 and ArduPilot over temperature, and the table: applied by formulas written down here from what the consumers
publish, and compared with the calibration's own curve."""

from __future__ import annotations

import csv
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tests.support.calibrated import HEXAD, calibration, of_device, values_of, warmed
from tumble.cli import main
from tumble.errors import InputError
from tumble.export import export_calibration
from tumble.export.autopilots import range_of
from tumble.export.tables import temperatures
from tumble.recording.session import AutopilotSensor
from tumble.result.calibration import Calibration
from tumble.result.temperature_curves import curve
from tumble.units import DEGREE, G_STANDARD, Array

AUTOPILOTS = ("px4-thermal", "ardupilot-thermal")
MILLI_G = 1e-3 * G_STANDARD
UNIT = {"accel": MILLI_G, "gyro": DEGREE}


def parameters(made: Calibration, to: str, imu: int | None = None) -> dict[str, float]:
    """Name and value of every line that is not a comment, as the autopilot keeps them."""
    out = {}
    for line in export_calibration(made, to, imu=imu).content.decode().splitlines():
        if line.startswith("#"):
            continue
        if to.startswith("px4"):
            vehicle, component, name, value, kind = line.split("\t")
            assert (vehicle, component) == ("1", "1")
            assert kind == ("6" if name.endswith(("ENABLE", "_ID")) else "9")  # MAV_PARAM_TYPE_INT32, _REAL32
        else:
            name, value = line.split(",")
        assert len(name) <= 16
        out[name] = float(np.float32(value))
    return out


def px4_offset(values: dict[str, float], kind: str, axis: int, T: Array) -> Array:
    """PX4's parameter reference: a polynomial of the third degree in the temperature above TREF, kept between TMIN and
    TMAX; and the offset of the calibration."""
    stem = {"accel": "TC_A0", "gyro": "TC_G0"}[kind]
    d = np.minimum(np.maximum(T, values[f"{stem}_TMIN"]), values[f"{stem}_TMAX"]) - values[f"{stem}_TREF"]
    cubic = sum(values[f"{stem}_X{power}_{axis}"] * d**power for power in range(4))
    return np.asarray(cubic + values[f"CAL_{'ACC' if kind == 'accel' else 'GYRO'}0_{'XYZ'[axis]}OFF"])


def ardupilot_offset(values: dict[str, float], kind: str, axis: int, T: Array) -> Array:
    """ArduPilot's documentation: coefficients in millionths, about 35 °C, without a constant; the value at the
    temperature of the calibration is put back."""
    short = {"accel": "ACC", "gyro": "GYR"}[kind]

    def polynomial(at: Array) -> Array:
        kept = np.clip(at, values["INS_TCAL1_TMIN"], values["INS_TCAL1_TMAX"])
        powers = np.array([(kept - 35.0) ** power for power in (1, 2, 3)])
        C = [values[f"INS_TCAL1_{short}{power}_{'XYZ'[axis]}"] for power in (1, 2, 3)]
        return np.asarray(1e-6 * np.tensordot(C, powers, axes=1))

    at_calibration = polynomial(np.array(values[f"INS_{short}1_CALTEMP"]))
    constant = values[f"INS_{'ACC' if kind == 'accel' else 'GYR'}OFFS_{'XYZ'[axis]}"]
    return np.asarray(polynomial(T) - at_calibration + constant)


OFFSET = {"px4-thermal": px4_offset, "ardupilot-thermal": ardupilot_offset}


def ours(made: Calibration, name: str, T: Array) -> Array:
    """θ + θ₁ d + θ₂ d², from the parameters alone."""
    values, d = values_of(made), T - (made.reference_temperature or 0.0)
    return np.asarray(values[name] + values[f"{name}.t1"] * d + values.get(f"{name}.t2", 0.0) * d**2)


def number(text: str, pattern: str) -> float:
    found = re.search(pattern, text)
    assert found is not None, pattern
    return float(found[1])


@pytest.mark.parametrize("to", AUTOPILOTS)
@pytest.mark.parametrize("curved", [True, False], ids=["with t2", "slopes alone"])
@pytest.mark.parametrize("seed", range(3))
def test_the_cubic_is_our_curve_within_the_error_stated(to: str, curved: bool, seed: int) -> None:
    made = warmed(calibration(seed), curved=curved, seed=seed)
    values, text = parameters(made, to), " ".join(export_calibration(made, to).losses)
    T = np.linspace(-18.5, 57.25, 1001)
    for kind, said in (("accel", r"cubic is within ([\d.e-]+) mg"), ("gyro", r"mg and ([\d.e-]+) deg/s of the cal")):
        error = max(
            float(np.abs(OFFSET[to](values, kind, axis, T) - ours(made, f"{kind}.bias.{'xyz'[axis]}", T)).max())
            for axis in range(3)
        )
        assert error / UNIT[kind] <= 1.01 * number(text, said)
        assert number(text, said) < 1e-3  # single precision, no more


@pytest.mark.parametrize("to", AUTOPILOTS)
def test_outside_what_was_measured_the_offsets_stay_where_they_are(to: str) -> None:
    made = warmed(calibration())
    values, text = parameters(made, to), " ".join(export_calibration(made, to).losses)
    assert "outside -18.5 to 57.2 degC nothing was measured" in text
    for kind in ("accel", "gyro"):
        cold, colder, hot, hotter = OFFSET[to](values, kind, 0, np.array([-18.5, -60.0, 57.25, 90.0]))
        assert (colder, hotter) == (cold, hot)


@pytest.mark.parametrize("to", AUTOPILOTS)
def test_what_scale_factors_over_temperature_cost_is_what_is_said(to: str) -> None:
    """What the autopilot makes of 1 g and of 100 deg/s in all directions, less what it does at the reference."""
    made, rng = warmed(calibration()), np.random.default_rng(1)
    assert made.accel is not None
    assert made.gyro is not None
    assert made.reference_temperature is not None
    directions = rng.standard_normal((20_000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    text, values = " ".join(export_calibration(made, to).losses), values_of(made)
    for kind, model, size in (("accel", made.accel, G_STANDARD), ("gyro", made.gyro, 100.0 * DEGREE)):
        largest = 0.0
        for T in np.linspace(-18.5, 57.25, 31):
            d = T - made.reference_temperature
            longer = [values[f"{kind}.scale.{s}.t1"] * d + values[f"{kind}.scale.{s}.t2"] * d**2 for s in "xyz"]
            row = model.matrix / np.linalg.norm(model.matrix, axis=1)[:, None] * np.array(longer)[:, None]
            row = row / np.diag(model.matrix)[:, None] if kind == "accel" else row
            largest = max(largest, float(np.linalg.norm(size * directions @ row.T, axis=1).max()))
        said = {"accel": r"error of up to ([\d.]+) mg and", "gyro": r"mg and ([\d.]+) deg/s in 1 g at 100 deg/s"}[kind]
        assert number(text, said) == pytest.approx(largest / UNIT[kind], rel=0.06)  # two digits, rounded up
        assert number(text, said) > 0.99 * largest / UNIT[kind]


@pytest.mark.parametrize("to", AUTOPILOTS)
def test_the_example_at_a_temperature_is_what_the_autopilot_computes(to: str) -> None:
    made = warmed(calibration())
    text, values = export_calibration(made, to).content.decode(), parameters(made, to)
    for kind in ("accel", "gyro"):
        pattern = rf"example {kind} at ([\d.-]+) degC: reading (.*) becomes (.*); it is (.*)"
        found = re.search(pattern, text)
        assert found is not None
        T = np.array(float(found[1]))
        reading, target, true = (np.array(part.split(), dtype=float) for part in found.groups()[1:])
        factor = "CAL_ACC0_{}SCALE" if to == "px4-thermal" else "INS_ACCSCAL_{}"
        scale = np.array([values[factor.format(axis)] for axis in "XYZ"]) if kind == "accel" else 1.0
        offset = np.array([OFFSET[to](values, kind, axis, T) for axis in range(3)])
        np.testing.assert_allclose((reading - offset) * scale, target, atol=2e-6)
        model, values_si = made.accel if kind == "accel" else made.gyro, values_of(made)
        assert model is not None
        d = float(T) - (made.reference_temperature or 0.0)
        powers = [values_si[f"{kind}.scale.{s}.t1"] * d + values_si[f"{kind}.scale.{s}.t2"] * d**2 for s in "xyz"]
        matrix = model.matrix * (1.0 + np.array(powers) / np.linalg.norm(model.matrix, axis=1))[:, None]
        bias = np.array([ours(made, f"{kind}.bias.{s}", T) for s in "xyz"])
        np.testing.assert_allclose(np.linalg.solve(matrix, reading - bias), true, atol=1e-6)


def test_px4_is_given_the_ids_it_finds_the_numbers_by() -> None:
    made = warmed(calibration())
    without = export_calibration(made, "px4-thermal")
    assert "TC_A0_ID\t" not in without.content.decode()
    assert any("PX4 compensates nothing" in loss for loss in without.losses)
    with_ids = export_calibration(made, "px4-thermal", sensor_ids=(1310988, 2359596))
    rows = with_ids.content.decode().splitlines()
    assert "1\t1\tTC_A0_ID\t1310988\t6" in rows
    assert "1\t1\tTC_G0_ID\t2359596\t6" in rows
    assert not any("compensates nothing" in loss for loss in with_ids.losses)


def test_the_numbers_are_those_of_the_sensors_that_were_recorded() -> None:
    third = {kind: AutopilotSensor(number=3, id=2**31 + 2**20) for kind in ("accel", "gyro")}
    made = of_device(warmed(calibration()), imu=third)
    px4, ardupilot = (parameters(made, to) for to in AUTOPILOTS)
    assert {name for name in px4 if name.startswith("CAL_")} == {
        *(f"CAL_ACC2_{axis}{what}" for axis in "XYZ" for what in ("OFF", "SCALE")),
        *(f"CAL_GYRO2_{axis}OFF" for axis in "XYZ"),
    }
    assert px4["TC_A0_ID"] == px4["TC_G0_ID"] == 2**20 - 2**31
    assert {name for name in ardupilot if "TCAL" in name and "TCAL3_" not in name} == set()
    assert {"INS_ACC3OFFS_X", "INS_GYR3OFFS_X", "INS_ACC3_CALTEMP", "INS_TCAL3_ENABLE"} <= set(ardupilot)
    fourth = of_device(made, imu={"accel": AutopilotSensor(number=4, id=None)})
    with pytest.raises(InputError, match="expected one of the first 3 IMUs, found a recording of IMU 4"):
        export_calibration(fourth, "ardupilot-thermal")


def test_of_another_imu_the_file_has_its_numbers_and_its_place() -> None:
    px4, ardupilot = (parameters(warmed(calibration()), to, imu=2) for to in AUTOPILOTS)
    assert {"CAL_ACC1_XOFF", "CAL_GYRO1_XOFF", "TC_A1_TREF", "TC_G1_X1_0"} <= set(px4)
    assert not any(name.startswith(("TC_A0", "TC_G0", "CAL_ACC0")) for name in px4)
    assert {"INS_ACC2OFFS_X", "INS_TCAL2_ENABLE", "INS_ACC2_CALTEMP"} <= set(ardupilot)
    for to, most in zip(AUTOPILOTS, (3, 5), strict=True):
        with pytest.raises(InputError, match=f"expected a number from 1 to {most} for {to}, found 7"):
            export_calibration(warmed(calibration()), to, imu=7)


def test_px4_says_what_its_steps_of_one_degree_cost() -> None:
    made = warmed(calibration())
    text = " ".join(export_calibration(made, "px4-thermal").losses)
    T = np.linspace(-18.5, 57.25, 10_001)
    steepest = max(float(np.abs(np.gradient(ours(made, f"accel.bias.{s}", T), T)).max()) for s in "xyz")
    assert number(text, r"until then an error of up to ([\d.]+) mg") == pytest.approx(steepest / MILLI_G, rel=0.06)


def test_the_table_reads_back_to_the_curves_and_names_its_example() -> None:
    made = warmed(calibration())
    exported = export_calibration(made, "csv-thermal")
    lines = exported.content.decode().splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    T = np.array([float(row["temperature_degC"]) for row in rows])
    assert made.reference_temperature is not None
    assert {-18.5, made.reference_temperature, 57.25, 20.0} <= set(T.tolist())
    assert T.min() == -18.5
    assert T.max() == 57.25
    for name in (f"{kind}.{what}.{s}" for kind in ("accel", "gyro") for what in ("bias", "scale") for s in "xyz"):
        np.testing.assert_allclose([float(row[name]) for row in rows], ours(made, name, T), rtol=1e-8)
        d, u = T - made.reference_temperature, {p.name: p.u or 0.0 for p in made.parameters}
        own = np.sqrt(u[name] ** 2 + (u[f"{name}.t1"] * d) ** 2 + (u[f"{name}.t2"] * d**2) ** 2)
        np.testing.assert_allclose([float(row[f"U({name})"]) for row in rows], 2.0 * own, rtol=1e-3)
    assert any(line.startswith("# example gyro at 57.2 degC: reading") for line in lines)
    fine = np.linspace(T[0], T[-1], 5001)
    error = max(
        float(np.abs(np.interp(fine, T, ours(made, n, T)) - ours(made, n, fine)).max())
        for n in (f"accel.bias.{s}" for s in "xyz")
    )
    assert error <= 1.001 * MILLI_G * number(exported.losses[0], r"within ([\d.e-]+) mg")


def test_the_table_holds_six_sensors_and_accelerometers_alone() -> None:
    axes = HEXAD / np.linalg.norm(HEXAD, axis=1)[:, None]
    for made in (warmed(calibration(accel=axes, gyro=axes)), warmed(calibration(with_gyro=False))):
        assert b"temperature_degC,accel.bias." in export_calibration(made, "csv-thermal").content


def test_the_rows_of_the_table_are_round_and_few() -> None:
    for low, high in ((20.0, 23.1), (-40.0, 85.0), (21.95, 22.05)):
        made = warmed(calibration(), low=low, high=high)
        T = temperatures(range_of(made, "csv-thermal"), made.reference_temperature or 0.0)
        assert 3 <= len(T) <= 29
        assert (T[0], T[-1]) == (low, high)


@pytest.mark.parametrize("to", [*AUTOPILOTS, "csv-thermal"])
def test_without_slopes_or_with_one_temperature_the_command_says_what_is_missing(to: str) -> None:
    with pytest.raises(InputError, match=f"export to {to}: expected parameters that change with temperature"):
        export_calibration(calibration(), to)
    with pytest.raises(InputError, match=f"export to {to}: expected rests at several temperatures, found one"):
        export_calibration(warmed(calibration(), low=22.0, high=22.0), to)


def test_the_command_takes_sensor_ids_and_refuses_what_is_none(tmp_path: Path) -> None:
    warmed(calibration()).write(tmp_path / "c.json")
    words = ["export", str(tmp_path / "c.json"), "--to", "px4-thermal", "-o", str(tmp_path / "imu.params")]
    result = CliRunner().invoke(main, [*words, "--sensor-ids", "1310988;1310988"])
    assert result.exit_code == 2
    assert "--sensor-ids: expected the numbers in CAL_ACC0_ID and CAL_GYRO0_ID" in result.stderr
    result = CliRunner().invoke(main, [*words, "--sensor-ids", "1310988,1310988"])
    assert result.exit_code == 0
    assert "note: offsets over temperature: from -18.5 to 57.2 degC the cubic is within" in result.stderr


def test_hysteresis_is_named_with_its_size() -> None:
    made = warmed(calibration())
    h = replace(made["accel.bias.x"], name="accel.bias.x.hysteresis", value=-0.02)
    covariance = None if made.covariance is None else np.pad(made.covariance, (0, 1))
    with_h = replace(made, parameters=(*made.parameters, h), covariance=covariance)
    losses = " ".join(export_calibration(with_h, "px4-thermal").losses)
    assert "hysteresis of the biases: no place in this file, up to 2.1 mg and 0 deg/s" in losses


def test_a_curve_without_covariance_has_no_band() -> None:
    made = replace(warmed(calibration()), covariance=None)
    assert curve(made, "accel.bias.x", np.array([0.0, 20.0])).expanded is None
