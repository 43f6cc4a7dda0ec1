"""Several thermometers: each sensor goes with its own, from the session file to the calibration and its uses."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tests.export.test_export_c import gcc
from tests.export.test_export_larger_model import run
from tests.support.calibrated import calibration, session_of, warmed, with_fields
from tests.use.test_applied_model import larger, read, truth
from tumble import calibrate
from tumble.errors import InputError
from tumble.export import export_calibration
from tumble.planning.setup import Setup
from tumble.recording.arrays import session_of_arrays
from tumble.recording.log import open_log
from tumble.recording.session_file import description_of, read_session
from tumble.result.calibration import Calibration, read_calibration
from tumble.result.parts import SensorsAtRest
from tumble.result.record import reference_of_parameter
from tumble.result.temperature_curves import measured_range
from tumble.run.observed import inspect_session
from tumble.simulation.session import read_truth, simulate_session
from tumble.simulation.temperature_profile import (
    temperature_profile,
    truth_at,
)
from tumble.units import ZERO_CELSIUS, Array
from tumble.use.apply import apply_to_session
from tumble.use.check import check_calibration
from tumble.use.positions import position_residuals

__all__ = ["gcc"]

SENSORS = ["ax", "ay", "az", "gx", "gy", "gz"]
SIX = ["Ta", "Ta", "Ta", "Tx", "Ty", "Tz"]
"""The accelerometers have a chip in common."""


def log_table(**temperature: object) -> dict[str, object]:
    """[log] with the table of the thermometers."""
    return {
        "time": "t",
        "accel": {"columns": SENSORS[:3], "unit": "m/s^2"},
        "gyro": {"columns": SENSORS[3:], "unit": "rad/s"},
        "temperature": temperature,
    }


# -------------------- in the session --------------------


@pytest.mark.parametrize(
    ("columns", "accel", "gyro"),
    [(["T"], "T T T", "T T T"), (["Ta", "Tg"], "Ta Ta Ta", "Tg Tg Tg"), (SIX, "Ta Ta Ta", "Tx Ty Tz")],
    ids=len,
)
def test_one_column_is_of_all_sensors_two_are_of_the_kinds_and_more_of_a_sensor_each(
    tmp_path: Path, columns: list[str], accel: str, gyro: str
) -> None:
    """What `description_of` makes of them says the same."""
    rows = {"t": 0.01 * np.arange(1, 101), **{name: np.full(100, 1.0) for name in SENSORS}}
    celsius = {name: 20.0 + i for i, name in enumerate(dict.fromkeys(columns))}
    table = pl.DataFrame(rows | {name: np.full(100, value) for name, value in celsius.items()})
    session = read_session(session_of(tmp_path / "s", table.write_csv(), log_table(columns=columns)))
    found = session.log.temperature
    assert found is not None
    assert session.gyro_block is not None
    assert (" ".join(found.names("accel")), " ".join(found.names("gyro"))) == (accel, gyro)
    chunk = next(open_log(session).chunks())
    assert chunk.temperature is not None
    np.testing.assert_allclose(chunk.temperature[7], ZERO_CELSIUS + 20.0 + np.arange(len(celsius)))
    each = chunk.temperature[:, [*session.accel_block.thermometer, *session.gyro_block.thermometer]]
    np.testing.assert_allclose(each[0, 3:] - each[0, 0], [found.columns.index(t) for t in gyro.split()])
    described = description_of(session)["log"]["temperature"]
    assert described["columns"] == columns


def test_arrays_have_temperatures_by_kind_or_by_sensor() -> None:
    still, warm = np.tile([0.0, 0.0, 9.81], (300, 1)), np.full(300, 300.0)
    turning = 0.0 * still
    by_sensor = warm[:, None] + np.arange(3)
    given = {"accel": warm, "gyro": by_sensor}
    session = session_of_arrays(accel=still, gyro=turning, rate=100.0, temperature=given)
    chunk = next(open_log(session).chunks())
    assert chunk.temperature is not None
    np.testing.assert_allclose(chunk.temperature[9], [300.0, 300.0, 301.0, 302.0])
    for wrong, said in (
        ({"accel": warm}, "expected those of accel and gyro, found accel"),
        ({"accel": warm, "gyro": by_sensor[:, :2]}, r"temperature of gyro: expected the shape \(samples,\) or"),
        ({"accel": warm - ZERO_CELSIUS, "gyro": warm}, "expected kelvin"),
    ):
        with pytest.raises(InputError, match=said):
            session_of_arrays(accel=still, gyro=turning, rate=100.0, temperature=wrong)


# -------------------- from a log to the file --------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of every sample in which each kind of sensors has a thermometer."""
    setup = Setup.of(grade="mems", programme="nine", rest=10.0, rate_deg_s=60.0, sample_rate=25.0)
    place, profile = tmp_path_factory.mktemp("thermometers") / "s", temperature_profile("20+2@60+8@120")
    return simulate_session(place, setup, seed=2, temperature=profile)


@pytest.fixture(scope="module")
def made(folder: Path) -> Calibration:
    return calibrate(folder)


def test_the_calibration_names_the_thermometer_of_each_sensor(folder: Path, made: Calibration, tmp_path: Path) -> None:
    assert read_session(folder).log.columns[-2:] == ("T_accel", "T_gyro")
    assert made.outcome.accepted
    assert dict(made.temperature.thermometers) == {"accel": 3 * ("T_accel",), "gyro": 3 * ("T_gyro",)}
    true = truth_at(
        read_truth(folder / "truth.json"), made.reference_temperature, partial(reference_of_parameter, made)
    )
    z = [(p.value - true[p.name]) / p.u for p in made.parameters if p.u and p.name in true]
    assert np.sqrt(np.mean(np.square(z))) < 1.8  # chi-square of 33: one in 10⁹
    made.write(tmp_path / "calibration.json")
    content = json.loads((tmp_path / "calibration.json").read_text())["temperature"]
    assert content["thermometers"] == {"accel": 3 * ["T_accel"], "gyro": 3 * ["T_gyro"]}
    again = read_calibration(tmp_path / "calibration.json")
    assert again.compensator.several_thermometers
    assert again.evidence.rests == made.evidence.rests
    rest = again.evidence.rests[-1]
    assert rest.accel is not None
    assert rest.gyro is not None
    assert rest.gyro.temperature[0] - rest.accel.temperature[0] > 3.0
    of_gyros = [r.gyro.temperature for r in made.evidence.rests if r.gyro is not None]
    np.testing.assert_allclose(made.temperature.references["gyro"], np.mean(of_gyros, axis=0))
    assert made.temperature.references["gyro"][0] - made.temperature.references["accel"][0] > 1.0
    own = [[getattr(r, kind).temperature[0] for r in again.evidence.rests] for kind in ("accel", "gyro")]
    found = measured_range(again)
    assert found is not None
    assert found == (max(map(min, own)), min(map(max, own)))  # where both were


def test_accelerometers_alone_are_calibrated_with_their_thermometer(folder: Path) -> None:
    session = read_session(folder)
    assert session.log.temperature is not None
    alone = replace(session.log, gyro=None, temperature=replace(session.log.temperature, columns=("T_accel",)))
    assert calibrate(replace(session, log=alone))["accel.bias.x"].u


def test_a_session_with_one_thermometer_is_not_for_a_calibration_with_two(
    folder: Path, made: Calibration, tmp_path: Path
) -> None:
    session = read_session(folder)
    known = session.log.temperature
    assert known is not None
    one = replace(known, columns=("T_accel",), accel=(0, 0, 0), gyro=(0, 0, 0))
    other = replace(session, log=replace(session.log, temperature=one))
    said = "expected a thermometer for each sensor gyro as in the calibration, T_gyro, T_gyro, T_gyro, found T_accel"
    with pytest.raises(InputError, match=said):
        apply_to_session(made, other, tmp_path / "out.parquet")
    with pytest.raises(InputError, match=said):
        check_calibration(made, other)
    with pytest.raises(InputError, match="expected those of the thermometers of the calibration by kind of sensors"):
        made.apply(np.ones((2, 3)), np.ones((2, 3)), temperature=np.full(2, 300.0))


def test_positions_are_verified_at_the_temperature_of_their_sensors(made: Calibration, tmp_path: Path) -> None:
    """Of another launch, 20 K warmer; without its thermometers the same readings are refused."""
    setup = Setup.of(grade="mems", programme="nine", rest=10.0, rate_deg_s=60.0, sample_rate=25.0)
    hot = simulate_session(tmp_path / "hot", setup, seed=2, launch=2, temperature=temperature_profile("40+2@60+8@120"))
    observations = inspect_session(hot).observations
    assert observations is not None
    cold = replace(observations, rests=replace(observations.rests, temperatures=None))
    for seen, agrees in ((observations, True), (cold, False)):
        found = position_residuals(made, seen, "hot")
        assert (np.abs(found.sigmas).max() < found.limit) == agrees


# -------------------- what is made of it --------------------


def of_six() -> tuple[Calibration, Array, list[Array], list[Array]]:
    """A calibration with the thermometers SIX, temperatures (N, 6), °C, and readings and truth at these."""
    made, instrument, values = larger()
    force, rate = (each[:80] for each in truth())
    at = np.arange(80)[:, None] / 9.0
    celsius = (20.0 + 15.0 * np.sin(at + np.arange(4)))[:, [0, 0, 0, 1, 2, 3]]
    each = [read(instrument, values, force, rate, own) for own in celsius.T]
    accel = np.column_stack([each[j][0][:, j] for j in range(3)])
    gyro = np.column_stack([each[3 + j][1][:, j] for j in range(3)])
    thermometers = {"accel": tuple(SIX[:3]), "gyro": tuple(SIX[3:])}
    return (
        replace(made, temperature=replace(made.temperature, thermometers=thermometers)),
        celsius,
        [accel, gyro],
        [force, rate],
    )


def test_readings_are_corrected_at_the_temperature_of_each_sensor(tmp_path: Path) -> None:
    made, celsius, (accel, gyro), (force, rate) = of_six()
    kelvin = celsius + ZERO_CELSIUS
    found_f, found_w = made.apply(accel, gyro, temperature={"accel": kelvin[:, 0], "gyro": kelvin[:, 3:]})
    assert found_w is not None
    np.testing.assert_allclose(found_f, force, atol=1e-8)
    np.testing.assert_allclose(found_w, rate, atol=2e-9)
    rows = dict(zip([*SENSORS, *SIX[2:]], [*accel.T, *gyro.T, *celsius[:, 2:].T], strict=True))
    table = pl.DataFrame({"t": 0.01 * np.arange(1, 81)} | rows)
    folder = session_of(tmp_path / "s", table.write_csv(), log_table(columns=SIX))
    description = apply_to_session(made, folder, tmp_path / "out.parquet")
    out = pl.read_parquet(tmp_path / "out.parquet")
    np.testing.assert_allclose(out.select(SENSORS[:3]).to_numpy(), force, atol=1e-8)
    np.testing.assert_allclose(out.select(SENSORS[3:]).to_numpy(), rate, atol=2e-9)
    assert description["log"]["temperature"]["columns"] == SIX


def test_the_c_header_takes_the_temperature_of_each_sensor(tmp_path: Path, gcc: str) -> None:
    made, celsius, (accel, gyro), (force, rate) = of_six()
    text = export_calibration(made, "c").content.decode()
    assert "imu_correct_accel_at(const double reading[3], double celsius, double out[3])" in text
    assert "const double force[3], const double celsius[3], double out[3])" in text
    assert "its own thermometer: of accel that of Ta; of gyro those of Tx, Ty, Tz, one a sensor" in text
    given = np.hstack([accel, celsius[:, :1]])
    np.testing.assert_allclose(run(gcc, tmp_path, made, "accel", given, warm=True), force, atol=1e-8)
    given = np.hstack([gyro, force, celsius[:, 3:]])
    np.testing.assert_allclose(run(gcc, tmp_path, made, "gyro", given, warm=True), rate, atol=2e-9)


def test_autopilots_say_which_thermometers_they_have_no_place_for() -> None:
    """PX4 has one for the accelerometers and one for the gyros, ArduPilot one for both; the size of the error is that
    of the steepest bias over what the thermometers differ by."""
    made = warmed(calibration())
    zero = SensorsAtRest(mean=(0.0,) * 3, noise=(0.0,) * 3, drift=(0.0,) * 3)
    rests = []
    for rest in made.evidence.rests:
        assert rest.temperature is not None
        each = (rest.temperature - 2.0, rest.temperature + 2.0)
        accel, gyro = (replace(zero, temperature=3 * (celsius,)) for celsius in each)
        rests.append(replace(rest, accel=accel, gyro=gyro))
    thermometers = {"accel": 3 * ("Ta",), "gyro": 3 * ("Tg",)}
    made = with_fields(made, rests=tuple(rests), temperature=replace(made.temperature, thermometers=thermometers))
    losses = {to: export_calibration(made, to).losses for to in ("px4-thermal", "ardupilot-thermal")}
    assert not any("thermometers" in said for said in losses["px4-thermal"])
    (said,) = (said for said in losses["ardupilot-thermal"] if "thermometers" in said)
    said = said.partition("thermometers of their own ")[2]
    assert "(Ta, Tg): the target has one for these sensors; at the rests they differ by up to 4.0 K" in said
    ends = made.temperature_range
    assert ends is not None
    assert ends == pytest.approx((-18.5 + 2.0, 57.25 - 2.0))
    bias = [made.compensator.model("accel", T).bias for T in (ends[1], ends[1] - 1e-3, ends[0] + 1e-3, ends[0])]
    steepest = np.abs([(bias[0] - bias[1]) / 1e-3, (bias[2] - bias[3]) / 1e-3]).max()
    stated = float(said.split("an error of up to ")[1].split()[0])
    assert stated == pytest.approx(4.0 * steepest / 9.80665e-3, rel=0.06)
    assert "of accel that of Ta; of gyro that of Tg" in export_calibration(made, "csv-thermal").content.decode()
