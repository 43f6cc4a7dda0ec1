"""Which IMU of an autopilot was recorded, carried from the log through session and calibration to the parameters of
that IMU, in logs of three."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from tests.recording.test_formats import ulog_message
from tests.support.calibrated import calibration, of_device
from tumble.cli import main
from tumble.drafting.new_session import Given, new_session
from tumble.errors import InputError
from tumble.export import export_calibration
from tumble.planning.setup import Setup
from tumble.recording.formats import messages
from tumble.recording.session import AutopilotSensor
from tumble.recording.session_file import description_of, read_session, session_of
from tumble.result.calibration import Calibration, read_calibration
from tumble.run.calibrate import calibrate
from tumble.simulation.session import simulate_session
from tumble.units import Array

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


def values(content: bytes) -> dict[str, float]:
    rows = [line for line in content.decode().splitlines() if line and not line.startswith("#")]
    if "\t" in rows[0]:
        return {row.split("\t")[2]: float(row.split("\t")[3]) for row in rows}
    return {row.split(",")[0]: float(row.split(",")[1]) for row in rows}


def test_the_calibration_of_an_instance_is_that_whose_id_px4_has(px4: tuple[Path, Calibration]) -> None:
    """Instance 1 has calibration 2 of PX4: CAL_ACC2, not CAL_ACC1."""
    session, made = px4
    sensors = {"accel": AutopilotSensor(number=3, id=2490378), "gyro": AutopilotSensor(number=3, id=2490386)}
    assert read_session(session).device.imu == sensors
    assert made.imu == sensors
    assert made.accel is not None
    assert made.gyro is not None
    found = values(export_calibration(made, "px4").content)
    assert (found["CAL_ACC2_ID"], found["CAL_GYRO2_ID"]) == (2490378, 2490386)
    assert {name[:8] for name in found} == {"CAL_ACC2", "CAL_GYRO"}
    assert found["CAL_ACC2_YOFF"] == pytest.approx(made.accel.bias[1], rel=1e-6)
    assert found["CAL_GYRO2_ZOFF"] == pytest.approx(made.gyro.bias[2], rel=1e-6)
    assert found == values(export_calibration(made, "px4", imu=3).content)


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
        (2, "INS_ACC2OFFS_X", "INS_ACC2SCAL_Z", "INS_GYR2OFFS_Y"),
        (3, "INS_ACC3OFFS_X", "INS_ACC3SCAL_Z", "INS_GYR3OFFS_Y"),
        (4, "INS4_ACCOFFS_X", "INS4_ACCSCAL_Z", "INS4_GYROFFS_Y"),
        (5, "INS5_ACCOFFS_X", "INS5_ACCSCAL_Z", "INS5_GYROFFS_Y"),
    ],
)
def test_ardupilots_names_have_the_number_where_it_has_it(imu: int, offset: str, scale: str, gyro: str) -> None:
    made = calibration()
    assert made.accel is not None
    found = values(export_calibration(made, "ardupilot", imu=imu).content)
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
    found = values(export_calibration(of_device(calibration(), imu=third.imu), "ardupilot").content)
    assert (found["INS_ACC3_ID"], found["INS_GYR3_ID"]) == (2753028, 2752772)


def test_a_session_keeps_them(px4: tuple[Path, Calibration]) -> None:
    session = read_session(px4[0])
    again = session_of(description_of(session))
    assert again.device.imu == session.device.imu


def test_without_ids_the_first_is_written_and_that_is_said(tmp_path: Path) -> None:
    made = calibration()
    for to, name in (("px4", "CAL_ACC0_XOFF"), ("ardupilot", "INS_ACCOFFS_X")):
        exported = export_calibration(made, to)
        assert name in values(exported.content)
        assert "--imu N" in " ".join(exported.losses)
        assert "--imu N" not in " ".join(export_calibration(made, to, imu=1).losses)
    with pytest.raises(InputError, match="expected imu with px4 or ardupilot and only there, found it with csv"):
        export_calibration(made, "csv", imu=2)
    with pytest.raises(InputError, match="expected a number from 1 to 4 for px4, found 5"):
        export_calibration(made, "px4", imu=5)
    made.write(tmp_path / "c.json")
    out = ["export", str(tmp_path / "c.json"), "--to", "px4", "--imu", "2", "-o", str(tmp_path / "c.params")]
    assert CliRunner().invoke(main, out).exit_code == 0
    assert "CAL_ACC1_XOFF" in (tmp_path / "c.params").read_text()


def test_kalibr_takes_the_noise_of_the_calibrations_rests(px4: tuple[Path, Calibration]) -> None:
    """The simulated densities, within the scatter of their estimate, and a random walk that bounds the true one, 0."""
    exported = export_calibration(px4[1], "kalibr")
    lines = dict(line.split(": ", 1) for line in exported.content.decode().splitlines() if line.startswith("  acc"))
    gyro = dict(line.split(": ", 1) for line in exported.content.decode().splitlines() if line.startswith("  gyr"))
    assert float(lines["  accelerometer_noise_density"]) == pytest.approx(1.5e-3, rel=0.25)
    assert float(gyro["  gyroscope_noise_density"]) == pytest.approx(np.deg2rad(0.01), rel=0.25)
    assert 0.0 < float(lines["  accelerometer_random_walk"]) < 1e-2
    assert "update_rate: " in exported.content.decode()
    assert "largest that the drifts within the rests allow" in " ".join(exported.losses)
