"""PX4 and ArduPilot: parameter files by their column layouts, applied by formulas written down here from what the
autopilots publish, at the reference and over temperature; which IMU they are of; magnetometers."""

from __future__ import annotations

import re
import struct
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from tests.recording.test_formats import ulog_message
from tests.support.calibrated import calibration, of_device, values_of, warmed
from tumble.cli import main
from tumble.drafting.new_session import Given, new_session
from tumble.errors import InputError
from tumble.export import export_calibration
from tumble.planning.setup import Setup
from tumble.recording.formats import messages
from tumble.recording.session import AutopilotSensor
from tumble.recording.session_file import read_session
from tumble.result.calibration import Calibration, read_calibration
from tumble.result.correction import best_linear_model
from tumble.result.parts import Parameter
from tumble.rotation import unit_vector
from tumble.run.calibrate import calibrate
from tumble.sensors.model import SensorModel
from tumble.simulation.session import simulate_session
from tumble.units import DEGREE, G_STANDARD, Array

THERMAL = ("px4-thermal", "ardupilot-thermal")
NAMES = {
    "px4": ("CAL_ACC0_{}OFF", "CAL_ACC0_{}SCALE", "CAL_GYRO0_{}OFF"),
    "ardupilot": ("INS_ACCOFFS_{}", "INS_ACCSCAL_{}", "INS_GYROFFS_{}"),
}
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
        assert len(name) <= 16  # what MAVLink has room for
        out[name] = float(value) if name.endswith("_ID") else float(np.float32(value))
    return out


def three(values: Mapping[str, float], name: str) -> Array:
    return np.array([values[name.format(axis)] for axis in "XYZ"])


def number(text: str, pattern: str) -> float:
    found = re.search(pattern, text)
    assert found is not None, pattern
    return float(found[1])


@pytest.mark.parametrize("to", NAMES)
@pytest.mark.parametrize("seed", range(3))
def test_what_the_autopilot_gets_wrong_is_what_is_said_to_be_lost(to: str, seed: int) -> None:
    """(reading − offset) · scale and reading − offset, in every direction of 1 g and of 100 deg/s."""
    made, rng = calibration(seed), np.random.default_rng(seed)
    assert made.accel is not None
    assert made.gyro is not None
    values = parameters(made, to)
    offset, scale, gyro_offset = (three(values, name) for name in NAMES[to])
    assert len(values) == 9
    directions = unit_vector(rng.standard_normal((100_000, 3)))
    force, rate = G_STANDARD * directions, 100.0 * directions
    force_error = np.linalg.norm((made.accel.predict(force) - offset) * scale - force, axis=1).max()
    rate_error = np.linalg.norm(rate @ made.gyro.matrix.T - rate, axis=1).max()  # deg/s
    text = export_calibration(made, to).losses[0]
    assert number(text, r"accelerometers by up to ([\d.]+) mg") * 1e-3 * G_STANDARD == pytest.approx(force_error, 0.01)
    assert number(text, r"gyros by up to ([\d.]+) deg/s") == pytest.approx(rate_error, rel=0.01)
    np.testing.assert_allclose(made.gyro.predict(np.zeros(3)) - gyro_offset, 0.0, atol=1e-8)


@pytest.mark.parametrize("to", NAMES)
def test_without_cross_terms_nothing_is_lost(to: str) -> None:
    accel = SensorModel(matrix=np.diag([1.01, 0.99, 1.002]), bias=np.array([0.2, -0.1, 0.05]))
    gyro = SensorModel(matrix=np.eye(3), bias=np.array([0.01, 0.02, -0.01]))
    made = replace(calibration(), accel=accel, gyro=gyro)
    values = parameters(made, to)
    offset, scale, gyro_offset = (three(values, name) for name in NAMES[to])
    true = np.array([[0.3, -9.7, 1.0]])
    np.testing.assert_allclose((accel.predict(true) - offset) * scale, true, atol=2e-6)
    np.testing.assert_allclose(gyro.predict(true) - gyro_offset, true, atol=1e-8)
    assert "remaining error" not in " ".join(export_calibration(made, to).losses)


@pytest.mark.parametrize("to", NAMES)
def test_the_example_in_the_file_is_what_the_autopilot_computes(to: str) -> None:
    made = calibration()
    text, values = export_calibration(made, to).content.decode(), parameters(made, to)
    offset, scale, _ = (three(values, name) for name in NAMES[to])
    example = re.search(r"example accel: reading (.*) becomes (.*); it is (.*) m/s", text)
    assert example is not None
    reading, target, true = (np.array(part.split(), dtype=float) for part in example.groups())
    np.testing.assert_allclose((reading - offset) * scale, target, atol=1e-6)
    np.testing.assert_allclose(made.apply(reading)[0], true, atol=1e-6)


def test_px4_is_told_of_corrections_too_small_for_some_releases() -> None:
    made = calibration()
    assert made.gyro is not None
    assert made.accel is not None
    (small,) = [loss for loss in export_calibration(made, "px4").losses if "releases" in loss]
    for name, change in (("gyro offsets", made.gyro.bias), ("accel offsets", made.accel.bias)):
        assert (name in small) == (np.linalg.norm(change) <= 0.01)


# -------------------- which IMU --------------------

ACCEL_IDS, GYRO_IDS = (1310988, 2490378, 3000000001), (1310996, 2490386, 3000000009)
"""Device ids of the instances."""
SLOTS = (1, 2, 0)
"""Which calibration of PX4, from 0, each instance has."""


def write_px4(path: Path, time: Array, force: Array, rate: Array, recorded: int) -> None:
    """A log of three IMUs by the published layout of ULog; the two that are not `recorded` read otherwise."""
    layout = "uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;float x;float y;float z;"
    out = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 10) + ulog_message("B", bytes(40))
    out += ulog_message("F", f"sensor_accel:{layout}".encode()) + ulog_message("F", f"sensor_gyro:{layout}".encode())
    for instance, slot in enumerate(SLOTS):
        for name, device in ((f"CAL_ACC{slot}_ID", ACCEL_IDS[instance]), (f"CAL_GYRO{slot}_ID", GYRO_IDS[instance])):
            key = f"int32_t {name}".encode()
            out += ulog_message("P", bytes([len(key)]) + key + struct.pack("<I", device))
    for instance in range(3):
        out += ulog_message("A", struct.pack("<BH", instance, 2 * instance) + b"sensor_accel")
        out += ulog_message("A", struct.pack("<BH", instance, 2 * instance + 1) + b"sensor_gyro")
    pieces = [out]
    for t, f, w in zip((1e6 * time).round().astype(int) + 10**6, force, rate, strict=True):
        for instance in range(3):
            turned = 1.0 if instance == recorded else -1.0
            pieces.append(
                ulog_message("D", struct.pack("<HQQI3f", 2 * instance, t, t, ACCEL_IDS[instance], *(turned * f)))
            )
            pieces.append(
                ulog_message("D", struct.pack("<HQQI3f", 2 * instance + 1, t, t, GYRO_IDS[instance], *(turned * w)))
            )
    path.write_bytes(b"".join(pieces))


def write_ardupilot(path: Path, samples: int = 50) -> None:
    """A log of three IMUs with parameters, by the published layout of ArduPilot's logs."""

    def layout(number: int, name: str, types: str, columns: str, length: int) -> bytes:
        return b"\xa3\x95\x80" + struct.pack(
            "<BB4s16s64s", number, length, name.encode(), types.encode(), columns.encode()
        )

    out = layout(0x80, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns", 89)
    out += layout(7, "IMU", "QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ", 36)
    out += layout(8, "PARM", "QNf", "TimeUS,Name,Value", 31)
    for name, device in (("INS_ACC_ID", 11), ("INS_ACC3_ID", 2753028), ("INS_GYR3_ID", 2752772), ("INS_ACC2_ID", 0)):
        out += b"\xa3\x95\x08" + struct.pack("<Q16sf", 10**6, name.encode(), device)
    for i in range(samples):
        for instance in range(3):
            out += b"\xa3\x95\x07" + struct.pack("<QB6f", 10**6 + 10**4 * i, instance, 0, 0, 0, 0, 0, -9.8)
    path.write_bytes(out)


@pytest.fixture(scope="module")
def px4(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Calibration]:
    """The session of the third instance of a PX4 log, and its calibration, from its file."""
    folder = tmp_path_factory.mktemp("px4")
    simulated = simulate_session(folder / "simulated", Setup.of(grade="mems", positions=10, rest=3.0), seed=4)
    table = pl.read_parquet(simulated / "log.parquet")
    described = read_session(simulated)
    assert described.log.time is not None
    assert described.log.gyro is not None
    time = table[described.log.time].to_numpy()
    force, rate = (table.select(c.columns).to_numpy() for c in (described.log.accel, described.log.gyro))
    write_px4(folder / "r.ulg", time, force, rate, recorded=1)
    new_session(folder / "session", folder / "r.ulg", Given(message="sensor_accel.1", latitude=56.84))
    calibrate(folder / "session").write(folder / "calibration.json")
    return folder / "session", read_calibration(folder / "calibration.json")


def test_the_calibration_of_an_instance_is_that_whose_id_px4_has(px4: tuple[Path, Calibration]) -> None:
    """Instance 1 has calibration 2 of PX4: CAL_ACC2, not CAL_ACC1."""
    session, made = px4
    sensors = {"accel": AutopilotSensor(number=3, id=2490378), "gyro": AutopilotSensor(number=3, id=2490386)}
    assert read_session(session).device.imu == sensors
    assert made.imu == sensors
    assert made.accel is not None
    assert made.gyro is not None
    found = parameters(made, "px4")
    assert (found["CAL_ACC2_ID"], found["CAL_GYRO2_ID"]) == (2490378, 2490386)
    assert {name[:8] for name in found} == {"CAL_ACC2", "CAL_GYRO"}
    assert found["CAL_ACC2_YOFF"] == pytest.approx(best_linear_model(made, "accel").bias[1], rel=1e-6)
    assert found["CAL_GYRO2_ZOFF"] == pytest.approx(made.gyro.bias[2], rel=1e-6)
    assert found == parameters(made, "px4", imu=3)


@pytest.mark.parametrize("to", ["px4", "ardupilot"])
@pytest.mark.parametrize("imu", [1, 2])
def test_another_imu_than_was_recorded_is_refused(to: str, imu: int, px4: tuple[Path, Calibration]) -> None:
    with pytest.raises(InputError, match=rf"accel 3 with the device id 2490378, found imu {imu}"):
        export_calibration(px4[1], to, imu=imu)


def test_ids_with_the_highest_bit_are_written_with_a_sign() -> None:
    imu = {"accel": AutopilotSensor(number=1, id=ACCEL_IDS[2]), "gyro": AutopilotSensor(number=1, id=5)}
    content = export_calibration(of_device(calibration(), imu=imu), "px4").content
    assert f"CAL_ACC0_ID\t{ACCEL_IDS[2] - 2**32}\t6" in content.decode()
    assert "have to be" not in content.decode()


@pytest.mark.parametrize(
    ("imu", "offset", "scale", "gyro"),
    [
        (1, "INS_ACCOFFS_X", "INS_ACCSCAL_Z", "INS_GYROFFS_Y"),
        (3, "INS_ACC3OFFS_X", "INS_ACC3SCAL_Z", "INS_GYR3OFFS_Y"),
        (4, "INS4_ACCOFFS_X", "INS4_ACCSCAL_Z", "INS4_GYROFFS_Y"),
    ],
)
def test_ardupilots_names_have_the_number_where_it_has_it(imu: int, offset: str, scale: str, gyro: str) -> None:
    made = calibration()
    assert made.accel is not None
    found = parameters(made, "ardupilot", imu=imu)
    assert len(found) == 9
    assert found[offset] == pytest.approx(made.accel.bias[0], rel=1e-6)
    assert found[scale] == pytest.approx(1.0 / made.accel.matrix[2, 2], rel=1e-6)
    assert gyro in found


def test_ids_of_an_ardupilot_log_are_those_among_its_parameters(tmp_path: Path) -> None:
    write_ardupilot(tmp_path / "r.bin")
    first, second, third = messages(tmp_path / "r.bin")
    assert first.imu == {"accel": AutopilotSensor(number=1, id=11), "gyro": AutopilotSensor(number=1, id=None)}
    assert second.imu["accel"] == AutopilotSensor(number=2, id=None)
    assert third.imu == {
        "accel": AutopilotSensor(number=3, id=2753028),
        "gyro": AutopilotSensor(number=3, id=2752772),
    }
    found = parameters(of_device(calibration(), imu=third.imu), "ardupilot")
    assert (found["INS_ACC3_ID"], found["INS_GYR3_ID"]) == (2753028, 2752772)


def test_without_ids_the_first_is_written_and_that_is_said(tmp_path: Path) -> None:
    made = calibration()
    for to, name in (("px4", "CAL_ACC0_XOFF"), ("ardupilot", "INS_ACCOFFS_X")):
        exported = export_calibration(made, to)
        assert name in parameters(made, to)
        assert "--imu N" in " ".join(exported.losses)
        assert "--imu N" not in " ".join(export_calibration(made, to, imu=1).losses)
    with pytest.raises(InputError, match="export to csv: expected no options, found imu"):
        export_calibration(made, "csv", imu=2)
    with pytest.raises(InputError, match="expected a number from 1 to 4 for px4, found 5"):
        export_calibration(made, "px4", imu=5)
    made.write(tmp_path / "c.json")
    out = ["export", str(tmp_path / "c.json"), "--to", "px4", "--imu", "2", "-o", str(tmp_path / "c.params")]
    assert CliRunner().invoke(main, out).exit_code == 0
    assert "CAL_ACC1_XOFF" in (tmp_path / "c.params").read_text()


# -------------------- over temperature --------------------


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


@pytest.mark.parametrize("to", THERMAL)
@pytest.mark.parametrize("curved", [True, False], ids=["with t2", "slopes alone"])
@pytest.mark.parametrize("seed", range(2))
def test_the_cubic_is_our_curve_to_single_precision(to: str, curved: bool, seed: int) -> None:
    made = warmed(calibration(seed), curved=curved, seed=seed)
    values, T = parameters(made, to), np.linspace(-18.5, 57.25, 1001)
    for kind, axis in ((kind, axis) for kind in UNIT for axis in range(3)):
        error = OFFSET[to](values, kind, axis, T) - ours(made, f"{kind}.bias.{'xyz'[axis]}", T)
        assert np.abs(error).max() < 1e-3 * UNIT[kind]


@pytest.mark.parametrize("to", THERMAL)
def test_outside_what_was_measured_the_offsets_stay_where_they_are(to: str) -> None:
    made = warmed(calibration())
    values, text = parameters(made, to), " ".join(export_calibration(made, to).losses)
    assert "outside -18.5 to 57.2 degC nothing was measured" in text
    for kind in ("accel", "gyro"):
        cold, colder, hot, hotter = OFFSET[to](values, kind, 0, np.array([-18.5, -60.0, 57.25, 90.0]))
        assert (colder, hotter) == (cold, hot)


@pytest.mark.parametrize("to", THERMAL)
def test_the_example_at_a_temperature_is_what_the_autopilot_computes(to: str) -> None:
    made = warmed(calibration())
    text, values = export_calibration(made, to).content.decode(), parameters(made, to)
    for kind in ("accel", "gyro"):
        pattern = rf"example {kind} at ([\d.-]+) degC: reading (.*) becomes (.*); it is (.*) (?:m|rad)/s"
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
    px4, ardupilot = (parameters(made, to) for to in THERMAL)
    assert {name for name in px4 if name.startswith("CAL_")} == {
        *(f"CAL_ACC2_{axis}{what}" for axis in "XYZ" for what in ("OFF", "SCALE")),
        *(f"CAL_GYRO2_{axis}OFF" for axis in "XYZ"),
    }
    assert px4["TC_A0_ID"] == px4["TC_G0_ID"] == 2**20 - 2**31
    assert {name for name in ardupilot if "TCAL" in name and "TCAL3_" not in name} == set()
    assert {"INS_ACC3OFFS_X", "INS_GYR3OFFS_X", "INS_ACC3_CALTEMP", "INS_TCAL3_ENABLE"} <= set(ardupilot)
    for to, most in zip(THERMAL, (3, 3), strict=True):
        with pytest.raises(InputError, match=f"expected a number from 1 to {most} for {to}, found 7"):
            export_calibration(warmed(calibration()), to, imu=7)
    fourth = of_device(made, imu={"accel": AutopilotSensor(number=4, id=None)})
    with pytest.raises(InputError, match="expected one of the first 3 IMUs, found a recording of IMU 4"):
        export_calibration(fourth, "ardupilot-thermal")


@pytest.mark.parametrize("to", THERMAL)
def test_slopes_over_less_than_a_kelvin_are_no_compensation(to: str) -> None:
    with pytest.raises(
        InputError, match=r"span at least 1 K, found 0\.7 K, over which a drift in time looks like a sl"
    ):
        export_calibration(warmed(calibration(), low=41.3, high=42.0), to)
    text = " ".join(export_calibration(warmed(calibration(), low=38.0, high=42.0), to).losses)
    assert "outside 38.0 to 42.0 degC nothing was measured (only 4.0 K: warm it" in text
    plain = " ".join(export_calibration(warmed(calibration(), low=41.3, high=42.0), to.removesuffix("-thermal")).losses)
    assert "mg in 0.7 K)" in plain  # and not what the slopes would make of ten
    assert "in 10 K" not in plain


def test_px4_says_what_its_steps_of_one_degree_cost() -> None:
    made = warmed(calibration())
    text = " ".join(export_calibration(made, "px4-thermal").losses)
    T = np.linspace(-18.5, 57.25, 10_001)
    steepest = max(float(np.abs(np.gradient(ours(made, f"accel.bias.{s}", T), T)).max()) for s in "xyz")
    assert number(text, r"until then an error of up to ([\d.]+) mg") == pytest.approx(steepest / MILLI_G, rel=0.01)


@pytest.mark.parametrize("to", [*THERMAL, "csv-thermal"])
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
    assert "outside -18.5 to 57.2 degC nothing was measured" in result.stderr


# -------------------- magnetometers --------------------


def with_magnetometer(matrix: Array, bias: Array, unit: str) -> Calibration:
    """A calibration with a magnetometer: reading = matrix true + bias, in a unit."""
    made = calibration(1)
    field = Parameter(name="mag.bias.x", value=float(bias[0]), u=0.5, unit=unit)
    assert made.covariance is not None
    covariance = np.pad(made.covariance, (0, 1))
    covariance[-1, -1] = 0.25
    mag = SensorModel(matrix=matrix, bias=bias)
    return replace(made, parameters=(*made.parameters, field), covariance=covariance, mag=mag)


SOFT_IRON = np.array([[1.05, 0.0, 0.0], [0.04, 0.93, 0.0], [-0.06, 0.03, 1.02]])


@pytest.mark.parametrize(("unit", "size"), [("uT", 1.0), ("mgauss", 10.0), ("gauss", 0.01), ("nT", 1e3)])
def test_px4_corrects_the_field_as_its_library_does(unit: str, size: float) -> None:
    """Magnetometer.hpp: scale · (data − offset), scale symmetric, in Gauss."""
    bias = np.array([12.0, -30.0, 7.0]) * size  # in the unit
    values = parameters(with_magnetometer(SOFT_IRON, bias, unit), "px4")
    off, scale, odiag = (three(values, f"CAL_MAG0_{{}}{what}") for what in ("OFF", "SCALE", "ODIAG"))
    S = np.diag(scale) + np.array([[0, odiag[0], odiag[1]], [odiag[0], 0, odiag[2]], [odiag[1], odiag[2], 0]])
    field = 0.48 * unit_vector(np.random.default_rng(0).standard_normal((50, 3)))  # Gauss
    raw = field @ SOFT_IRON.T + bias / size * 0.01
    corrected = (raw - off) @ S
    np.testing.assert_allclose(np.linalg.norm(corrected, axis=1), 0.48, rtol=1e-6)
    turned = np.linalg.lstsq(corrected, field, rcond=None)[0]  # what is left is one rotation
    np.testing.assert_allclose(corrected @ turned, field, atol=1e-6)
    np.testing.assert_allclose(turned @ turned.T, np.eye(3), atol=1e-5)


def test_ardupilot_corrects_the_field_as_its_library_does() -> None:
    """AP_Compass_Backend::correct_field: mag += offsets, then COMPASS_SCALE, then a symmetric matrix, in mGauss."""
    bias = np.array([12.0, -30.0, 7.0])  # µT
    values = parameters(with_magnetometer(SOFT_IRON, bias, "uT"), "ardupilot")
    off, diagonal, odi = (three(values, f"COMPASS_{what}_{{}}") for what in ("OFS", "DIA", "ODI"))
    S = np.diag(diagonal) + np.array([[0, odi[0], odi[1]], [odi[0], 0, odi[2]], [odi[1], odi[2], 0]])
    field = 480.0 * unit_vector(np.random.default_rng(0).standard_normal((50, 3)))
    corrected = values["COMPASS_SCALE"] * ((field @ SOFT_IRON.T + 10.0 * bias) + off) @ S
    np.testing.assert_allclose(np.linalg.norm(corrected, axis=1), 480.0, rtol=1e-6)


@pytest.mark.parametrize(
    ("to", "matrix", "bias", "why"),
    [
        ("px4", np.eye(3), np.array([140.0, 0.0, 0.0]), "offsets are 1.4 gauss long, more than 1.3"),
        ("ardupilot", np.eye(3), np.array([190.0, 0.0, 0.0]), "offsets are 1900 mgauss long, more than 1800"),
        ("ardupilot", np.diag([1.0, 1.0, 6.0]), np.zeros(3), "beyond 0.2 to 5"),
        ("px4", np.diag([1.0, -1.0, 1.0]), np.zeros(3), "left-handed"),
    ],
)
def test_a_magnetometer_beyond_the_limits_of_the_autopilot_is_left_out_and_said(
    to: str, matrix: Array, bias: Array, why: str
) -> None:
    exported = export_calibration(with_magnetometer(matrix, bias, "uT"), to)
    assert "MAG0_XOFF\t" not in exported.content.decode()
    assert "\nCOMPASS_" not in exported.content.decode()
    assert any(why in loss for loss in exported.losses)
