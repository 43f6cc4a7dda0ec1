"""The calibration file: what every key means, and that it is written whole, or not at all."""

from __future__ import annotations

import copy
import errno
import hashlib
import json
import math
import os
import stat
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner, Result

from tests.support.calibrated import calibration as calibrated
from tests.support.calibrated import with_fields
from tumble import __version__
from tumble.advice import Advised, found_in
from tumble.cli import main
from tumble.errors import CalibrationError
from tumble.inference.estimate import Outcome
from tumble.planning.setup import Setup
from tumble.recording.session import AirConditions, AutopilotSensor, Circumstances
from tumble.recording.session_file import read_session
from tumble.result.calibration import Calibration, json_schema, read_calibration
from tumble.result.parts import CalibratedDevice, CalibratedTemperature, Launch, Member, Parameter
from tumble.run.calibrate import calibrate
from tumble.run.observed import inspect_session
from tumble.sensors.grades import GRADES
from tumble.sensors.model import Block, SensorModel
from tumble.sensors.parameters import group_of
from tumble.simulation.scenario import Scenario, Vibration, draw_parameters
from tumble.simulation.session import simulate_session, write_simulation
from tumble.units import DEGREE

HAND = Setup.of(grade="mems", positions=14, rest=5.0, rate_deg_s=120.0, sample_rate=50.0)

NAMES = (
    *(f"accel.bias.{s}" for s in "xyz"),
    *(f"accel.scale.{s}" for s in "xyz"),
    *(f"accel.axis.{pair}" for pair in ("yx", "zx", "zy")),
    *(f"gyro.bias.{s}" for s in "xyz"),
    *(f"gyro.scale.{s}" for s in "xyz"),
    *(f"gyro.axis.{pair}" for pair in ("xy", "xz", "yx", "yz", "zx", "zy")),
)
UNITS = (*["m/s^2"] * 3, *["1"] * 3, *["rad"] * 3, *["rad/s"] * 3, *["1"] * 3, *["rad"] * 6)


def contents(file: Path) -> Any:
    """What a file says; no number in it is NaN or infinite."""

    def refuse(name: str) -> float:
        raise AssertionError(f"{file}: {name}")

    return json.loads(file.read_text(encoding="utf-8"), parse_constant=refuse)


@pytest.fixture(scope="session")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate_session(tmp_path_factory.mktemp("file") / "session", HAND, seed=1)


@pytest.fixture(scope="session")
def calibration(session: Path) -> Calibration:
    return calibrate(session, terms="linear")


@pytest.fixture
def file(calibration: Calibration, tmp_path: Path) -> Path:
    path = tmp_path / "calibration.json"
    calibration.write(path)
    return path


@pytest.fixture
def content(file: Path) -> Any:
    return contents(file)


# -------------------- what the keys mean --------------------


def test_every_key_of_the_contract_is_there(content: Any) -> None:
    assert content["format"] == 1
    assert content["device"] == {"serial": "mems-1", "model": None}
    assert content["method"] == "joint"
    assert content["frame"] == "accelerometer"
    assert {key: content["outcome"][key] for key in ("accepted", "reasons", "unobservable")} == {
        "accepted": True,
        "reasons": [],
        "unobservable": [],
    }
    assert content["launches"] == []
    assert content["accel"]["unit"] == "m/s^2"
    assert content["gyro"]["unit"] == "rad/s"
    for key in ("parameters", "covariance", "iterations", "rests"):
        assert len(content[key]) > 0


def test_parameters_have_the_names_the_order_and_the_units_of_the_contract(content: Any) -> None:
    assert tuple(p["name"] for p in content["parameters"]) == NAMES
    assert tuple(p["unit"] for p in content["parameters"]) == UNITS
    for parameter in content["parameters"]:
        assert set(parameter) >= {"name", "value", "u", "unit"}
        assert parameter["u"] > 0.0


def test_values_agree_with_the_truth_within_their_uncertainty(content: Any, session: Path) -> None:
    """21 parameters: the mean square of (value − truth)/u is 1 ± 0.31 (1 σ); at 3 σ below 1.93."""
    truth = contents(session / "truth.json")
    z = [(p["value"] - truth[p["name"]]) / p["u"] for p in content["parameters"]]
    assert 0.07 < np.mean(np.square(z)) < 1.93


def test_the_covariance_is_symmetric_positive_and_that_of_the_uncertainties(content: Any) -> None:
    covariance = np.array(content["covariance"])
    u = np.array([p["u"] for p in content["parameters"]])
    assert covariance.shape == (len(NAMES), len(NAMES))
    np.testing.assert_allclose(covariance, covariance.T, rtol=1e-12)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), u, rtol=1e-12)
    assert np.linalg.eigvalsh(covariance / np.outer(u, u)).min() > 0.0


def test_matrix_and_bias_are_those_of_the_parameters(content: Any) -> None:
    """Reading = matrix @ true + bias, matrix = diag(1 + k) S, S with unit rows whose component towards body axis q is
    the axis angle pq, to first order."""
    value = {p["name"]: p["value"] for p in content["parameters"]}
    for kind in ("accel", "gyro"):
        matrix, bias = np.array(content[kind]["matrix"]), np.array(content[kind]["bias"])
        np.testing.assert_allclose(bias, [value[f"{kind}.bias.{s}"] for s in "xyz"], rtol=1e-15)
        scale = np.array([value[f"{kind}.scale.{s}"] for s in "xyz"])
        np.testing.assert_allclose(np.linalg.norm(matrix, axis=1), 1.0 + scale, rtol=1e-13)
        axes = matrix / (1.0 + scale)[:, None]
        for p, q in ((p, q) for p in range(3) for q in range(3) if p != q):
            angle = value.get(f"{kind}.axis.{'xyz'[p]}{'xyz'[q]}", 0.0)
            assert math.isclose(axes[p, q], angle, rel_tol=1e-4, abs_tol=1e-12)


def test_the_accelerometer_frame_has_x_along_the_first_sensor_and_z_normal_to_the_first_two(content: Any) -> None:
    matrix = np.array(content["accel"]["matrix"])
    assert matrix[0, 1] == matrix[0, 2] == matrix[1, 2] == 0.0


def test_the_residual_of_a_rest_is_the_corrected_reading_less_g(content: Any, session: Path) -> None:
    """From the file alone, applied to the log."""
    log = pl.read_parquet(session / "log.parquet")
    gravity = read_session(session).site.gravity
    accel = SensorModel(matrix=np.array(content["accel"]["matrix"]), bias=np.array(content["accel"]["bias"]))
    observations = inspect_session(read_session(session)).observations
    assert observations is not None
    assert len(content["rests"]) == len(observations.rests) == 14
    for rest, mean in zip(content["rests"], observations.rests.accel, strict=True):
        np.testing.assert_allclose(np.linalg.norm(accel.apply(mean)) - gravity, rest["residual"], atol=1e-9)
    for rest in content["rests"][:-1]:  # the last one also has the samples after its last block
        inside = log.filter((pl.col("t") > rest["start"] + 1e-6) & (pl.col("t") <= rest["stop"] + 1e-6))
        own = inside.select("ax", "ay", "az").mean().to_numpy()[0]
        np.testing.assert_allclose(np.linalg.norm(accel.apply(own)) - gravity, rest["residual"], atol=1e-9)


def test_the_increments_of_the_iterations_add_up_to_the_values(content: Any) -> None:
    steps = [{p["name"]: p["increment"] for p in step["parameters"]} for step in content["iterations"]]
    for parameter in content["parameters"]:
        total = sum(step[parameter["name"]] for step in steps)
        assert math.isclose(total, parameter["value"], rel_tol=1e-9, abs_tol=1e-3 * parameter["u"])


def test_the_provenance_names_the_log_the_software_and_the_time(content: Any, session: Path) -> None:
    provenance = content["provenance"]
    assert provenance["log_sha256"] == hashlib.sha256((session / "log.parquet").read_bytes()).hexdigest()
    assert provenance["software"] == f"tumble {__version__}"
    assert provenance["created"].endswith("+00:00")


def test_all_that_a_calibration_can_hold_is_read_as_it_was_written(calibration: Calibration, tmp_path: Path) -> None:
    """Circumstances, sensors of an autopilot, temperature, sessions together, launches, and notes of a field check."""
    air = AirConditions(temperature_degC=21.5, temperature_u=0.3, humidity_percent=40.0, pressure_hPa=990.0)
    recorded = Circumstances(
        date="2026-03-01T12:00:00+05:00", operator="A. Name", conditions=air, equipment=("table, 2025",)
    )
    further = tuple(
        Parameter(name=name, value=1e-4, u=1e-5, unit=group_of(name).unit)
        for name in ("accel.bias.x.t1", "accel.bias.x.t2", "gyro.bias.z.hysteresis", "gyro.lag")
    )
    parameters = (*calibration.parameters, *further)
    warm = tuple(replace(rest, temperature=20.0 + i) for i, rest in enumerate(calibration.evidence.rests))
    sensors = {"accel": AutopilotSensor(number=2, id=2753028), "gyro": AutopilotSensor(number=1, id=None)}
    whole = with_fields(
        calibration,
        parameters=parameters,
        covariance=np.diag([(p.u or 0.0) ** 2 for p in parameters]),
        rests=warm,
        circumstances=recorded,
        device=replace(calibration.device, imu=sensors),
        sample_rate=399.7,
        temperature=CalibratedTemperature(reference=25.0),
        notes=("the log has a gap of 0.2 s",),
        together=(
            Member(
                session="cold", log_sha256="0" * 64, rests=9, turns=8, temperatures=(-20.0, 5.0), parameters=further[:1]
            ),
        ),
        launches=(
            Launch(session="one", parameters=parameters, covariance=None, log_sha256="1" * 64, circumstances=recorded),
        ),
    )
    whole.write(tmp_path / "whole.json")
    again = read_calibration(tmp_path / "whole.json")
    assert again.content() == whole.content()
    assert again.provenance.circumstances == again.evidence.launches[0].circumstances == recorded
    assert (again.imu, again.provenance.sample_rate, again.evidence.together) == (
        whole.imu,
        399.7,
        whole.evidence.together,
    )
    assert again.content()["temperature"] == {"reference": 25.0, "range": [20.0, 33.0], "lag": {"gyro": 1e-4}}


def test_a_session_without_gyros_gives_the_accelerometer_parameters(session: Path, tmp_path: Path) -> None:
    described = read_session(session)
    calibrate(replace(described, log=replace(described.log, gyro=None)), terms="linear").write(tmp_path / "accel.json")
    content = contents(tmp_path / "accel.json")
    assert tuple(p["name"] for p in content["parameters"]) == NAMES[:9]
    assert content["gyro"] is None
    assert content["accel"] is not None


def test_sensors_of_a_redundant_block_are_numbered_from_zero(tmp_path: Path) -> None:
    corner = np.ones(3) / np.sqrt(3.0)
    accel = Block(kind="accel", axes=np.vstack([np.eye(3), corner]))
    gyro = Block(kind="gyro", axes=np.eye(3))
    scenario = Scenario(
        setup=Setup(
            by_hand=16,
            first_rest=6.0,
            rest=5.0,
            turn_rate=120 * DEGREE,
            ramp=0.5,
            sample_rate=50.0,
            noise=GRADES["mems"].noise,
            latitude=0.9,
            height=0.0,
            gravity=9.81,
            gravity_u=1e-6,
        ),
        accel=accel,
        gyro=gyro,
        truth=draw_parameters(GRADES["mems"], (accel, gyro), np.random.default_rng(2)),
        vibration=Vibration(),
        serial="R-4",
    )
    folder = write_simulation(tmp_path / "session", scenario, np.random.default_rng(3))
    calibrate(folder, terms="linear").write(tmp_path / "redundant.json")
    content = contents(tmp_path / "redundant.json")
    names = [p["name"] for p in content["parameters"]]
    assert names == [
        *(f"accel.bias.{p}" for p in range(4)),
        *(f"accel.scale.{p}" for p in range(4)),
        "accel.axis.1.1",
        *(f"accel.axis.{p}.{j}" for p in (2, 3) for j in (1, 2)),
        *NAMES[9:],
    ]
    assert np.shape(content["accel"]["matrix"]) == (4, 3)


def test_a_refused_recording_has_its_reasons_in_the_file_and_no_values(session: Path, tmp_path: Path) -> None:
    described = read_session(session)
    channels = replace(described.log.accel, columns=("ay", "ax", "az"))
    calibrate(replace(described, log=replace(described.log, accel=channels)), terms="linear").write(
        tmp_path / "refused.json"
    )
    content = contents(tmp_path / "refused.json")
    assert content["outcome"]["accepted"] is False
    assert "are exchanged" in content["outcome"]["reasons"][0]
    assert content["parameters"] == content["rests"] == content["iterations"] == []
    assert content["accel"] is content["gyro"] is content["covariance"] is None
    assert content["provenance"]["log_sha256"]


def test_the_description_of_the_file_has_the_keys_that_are_written_and_documented(content: Any) -> None:
    described = json_schema()
    page = (Path(__file__).parents[2] / "docs/reference/calibration-file.md").read_text(encoding="utf-8")
    assert set(described["properties"]) == set(content)
    assert [key for key in content if f"`{key}`" not in page] == []
    assert {"device", "method", "frame", "parameters", "covariance", "accel", "gyro", "outcome"} == set(
        described["required"]
    )


# -------------------- read again --------------------


def test_what_was_found_and_what_to_do_are_apart_in_the_file(tmp_path: Path) -> None:
    sentence = Advised("the gyros drift", "let the device warm up")
    made = with_fields(calibrated(), outcome=Outcome(remarks=(sentence,)), notes=("as it is", sentence))
    made.write(tmp_path / "c.json")
    written = contents(tmp_path / "c.json")
    assert written["outcome"]["remarks"] == ["the gyros drift; let the device warm up"]
    assert written["remedies"] == {"the gyros drift; let the device warm up": "let the device warm up"}
    again = read_calibration(tmp_path / "c.json")
    assert [found_in(each) for each in (*again.outcome.remarks, *again.provenance.notes)] == [
        "the gyros drift",
        "as it is",
        "the gyros drift",
    ]
    written["remedies"] = {sentence: "switch it off"}
    (tmp_path / "c.json").write_text(json.dumps(written), encoding="utf-8")
    with pytest.raises(CalibrationError, match="remedies: expected the end of"):
        read_calibration(tmp_path / "c.json")


def equal(one: Calibration, other: Calibration) -> bool:
    """Field by field; arrays to the last bit."""

    def flat(made: Calibration) -> dict[str, Any]:
        records = (made, made.evidence, made.provenance)
        return {f.name: plain(getattr(record, f.name)) for record in records for f in fields(record)}

    def plain(value: Any) -> Any:
        if isinstance(value, SensorModel):
            return value.matrix.tolist(), value.bias.tolist()
        return value.tolist() if isinstance(value, np.ndarray) else value

    alike = {"evidence": None, "provenance": None}
    return flat(one) | alike == flat(other) | alike


def test_a_calibration_written_and_read_is_the_same(calibration: Calibration, file: Path, tmp_path: Path) -> None:
    again = read_calibration(file)
    assert equal(again, calibration)
    again.write(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == file.read_bytes()


def test_a_refused_calibration_written_and_read_is_the_same(calibration: Calibration, tmp_path: Path) -> None:
    outcome = replace(calibration.outcome, reasons=("the turn 3 – 4 misses by 5°",), unobservable=("gyro.scale.x",))
    refused = with_fields(calibration, parameters=(), covariance=None, accel=None, gyro=None, outcome=outcome, rests=())
    refused.write(tmp_path / "refused.json")
    assert equal(read_calibration(tmp_path / "refused.json"), refused)


CONTRACT = """{
  "format": 1,
  "device": {"serial": "A-0007", "model": null},
  "method": "joint",
  "frame": "accelerometer",
  "parameters": [{"name": "accel.bias.x", "value": 0.00135, "u": 4.2e-06, "unit": "m/s^2"}],
  "covariance": [[1.764e-11]],
  "accel": {"matrix": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "bias": [0.00135, 0, 0], "unit": "m/s^2"},
  "gyro": null,
  "outcome": {"accepted": true, "reasons": []},
  "iterations": [{"parameters": [{"name": "accel.bias.x", "increment": 0.00135}]}],
  "rests": [{"start": 0.0, "stop": 60.0, "residual": 1.1e-6}],
  "launches": [{"session": "one", "parameters": [{"name": "accel.bias.x", "value": 0, "u": null, "unit": "m/s^2"}],
                "covariance": null}],
  "provenance": {"log_sha256": "00", "software": "tumble 0.1.0", "created": "2024-01-01T00:00:00+00:00"}
}"""


def test_a_file_with_only_the_keys_of_the_contract_is_read(tmp_path: Path) -> None:
    (tmp_path / "other.json").write_text(CONTRACT, encoding="utf-8")
    read = read_calibration(tmp_path / "other.json")
    assert read["accel.bias.x"].value == 0.00135
    assert read.evidence.launches[0].parameters[0].u is None
    assert read.outcome.accepted


def test_keys_that_were_added_by_others_are_ignored(tmp_path: Path) -> None:
    content = json.loads(CONTRACT)
    content["colour"] = content["parameters"][0]["colour"] = content["rests"][0]["colour"] = "red"
    (tmp_path / "other.json").write_text(json.dumps(content), encoding="utf-8")
    assert read_calibration(tmp_path / "other.json")["accel.bias.x"].u == 4.2e-06


def damaged(change: Callable[[Any], None]) -> bytes:
    content = json.loads(CONTRACT)
    change(content)
    return json.dumps(content).encode()


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"", "found"),
        (b"hello", "found"),
        (b"\xff\xfe\x00", "found"),
        (b"[1, 2]", "found"),
        (b"{}", "found no key 'format'"),
        (damaged(lambda c: c.pop("accel")), "accel: expected this key, found none"),
        (damaged(lambda c: c.update(format=2)), "expected format 1, found 2"),
        (damaged(lambda c: c.update(format="1")), "expected format 1, found '1'"),
        (damaged(lambda c: c["parameters"][0].pop("value")), "parameters[1].value: expected this key, found none"),
        (damaged(lambda c: c["parameters"][0].update(value="much")), "found"),
        (damaged(lambda c: c["parameters"][0].update(value=math.nan)), "NaN in place of a number"),
        (damaged(lambda c: c["parameters"][0].update(value=math.inf)), "Infinity in place of a number"),
        (damaged(lambda c: c.update(parameters=3)), "found"),
        (damaged(lambda c: c.update(parameters=[3])), "found"),
        (damaged(lambda c: c.update(covariance=[[1.0], [1.0, 2.0]])), "found"),
        (damaged(lambda c: c.update(fits=[])), "found"),
        (damaged(lambda c: c.update(outcome=None)), "found"),
        (damaged(lambda c: c.update(accel=7)), "found"),
        (damaged(lambda c: c.update(device="A-7")), "found"),
        (damaged(lambda c: c["accel"]["bias"].append(0.0)), "accel: expected a matrix of three columns"),
        (
            damaged(lambda c: c.update(axes={"accel": [[1.0, 0.0, 0.0]] * 4})),
            "axes.accel: expected 3 sensors, as accel.b",
        ),
        (damaged(lambda c: c["covariance"][0].__setitem__(0, -1.0)), "covariance[1][1]: expected no variance below 0"),
        (damaged(lambda c: c["covariance"][0].__setitem__(0, 1e-300)), "covariance[1][1]: expected zero or a variance"),
        (
            damaged(lambda c: c["parameters"][0].__setitem__("prior", 0.0)),
            "parameters[1].prior: expected a larger number",
        ),
    ],
)
def test_a_file_that_is_none_is_refused_in_one_line(tmp_path: Path, text: bytes, said: str) -> None:
    path = tmp_path / "calibration.json"
    path.write_bytes(text)
    with pytest.raises(CalibrationError) as caught:
        read_calibration(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert said in message
    assert "\n" not in message


def test_a_file_that_cannot_be_opened_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"none\.json: cannot be read: No such file"):
        read_calibration(tmp_path / "none.json")
    with pytest.raises(CalibrationError, match="cannot be read: Is a directory"):
        read_calibration(tmp_path)


# -------------------- replaced only by its like --------------------


def command(*arguments: object) -> Result:
    result = CliRunner().invoke(main, ["calibrate", *map(str, arguments)])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def test_the_file_goes_beside_the_session_and_nothing_else_does(session: Path, tmp_path: Path) -> None:
    folder = tmp_path / "session"
    folder.mkdir()
    for name in ("session.toml", "log.parquet"):
        (folder / name).write_bytes((session / name).read_bytes())
    assert command(folder).exit_code == 0
    assert {path.name for path in folder.iterdir()} == {"session.toml", "log.parquet", "calibration.json"}


def test_a_file_from_the_same_log_and_method_is_replaced(session: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.json"
    assert command(session, "--out", out).exit_code == 0
    content = contents(out)
    content["provenance"]["created"] = "yesterday"
    out.write_text(json.dumps(content), encoding="utf-8")
    assert command(session, "--out", out).exit_code == 0
    assert contents(out)["provenance"]["created"] != "yesterday"


@pytest.mark.parametrize(
    "change",
    [
        lambda content: content["provenance"].update(log_sha256="0" * 64),
        lambda content: content.update(method="scalar"),
        lambda content: content["outcome"]["accel"].update(reasons=["bad accelerometers"]),
    ],
)
def test_another_file_is_replaced_only_by_force(
    session: Path, file: Path, content: Any, change: Callable[[Any], None]
) -> None:
    other = copy.deepcopy(content)
    other["method"] = "scalar"
    change(other)
    file.write_text(json.dumps(other), encoding="utf-8")
    before = file.read_bytes()
    result = command(session, "--out", file)
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.startswith(f"tumble: {file}: ")
    assert "--force" in result.stderr
    assert result.stderr.count("\n") == 1
    assert file.read_bytes() == before
    assert command(session, "--out", file, "--force").exit_code == 0
    assert contents(file)["provenance"] == content["provenance"] | {"created": contents(file)["provenance"]["created"]}


@pytest.mark.parametrize("kinds", [("accel", "gyro"), ("accel",)])
def test_a_calibration_that_was_refused_gives_way_to_one_by_another_method(
    session: Path, file: Path, content: Any, kinds: Sequence[str]
) -> None:
    """Of accelerometers without gyros too."""
    other = {**copy.deepcopy(content), "method": "scalar", **{k: None for k in ("accel", "gyro") if k not in kinds}}
    for kind in kinds:
        other["outcome"][kind]["reasons"] = ["the rests scatter"]
    file.write_text(json.dumps(other), encoding="utf-8")
    assert command(session, "--out", file).exit_code == 0
    assert contents(file)["method"] == content["method"]


@pytest.mark.parametrize("text", [b"a letter", b"\xff\x00", b"[]", b"{}"])
@pytest.mark.parametrize("options", [(), ("--force",)])
def test_a_file_that_is_no_calibration_is_not_replaced(
    session: Path, tmp_path: Path, text: bytes, options: Sequence[str]
) -> None:
    out = tmp_path / "letter.json"
    out.write_bytes(text)
    result = command(session, "--out", out, *options)
    assert result.exit_code == 2
    assert "expected a calibration to replace, found another file" in result.stderr
    assert result.stderr.count("\n") == 1
    assert out.read_bytes() == text


def test_an_empty_file_holds_nothing_and_is_replaced(session: Path, tmp_path: Path) -> None:
    (tmp_path / "made.json").touch()
    assert command(session, "--out", tmp_path / "made.json").exit_code == 0
    assert contents(tmp_path / "made.json")["method"]


def test_a_folder_is_not_replaced(session: Path, tmp_path: Path) -> None:
    assert command(session, "--out", tmp_path).exit_code == 2
    assert command(session, "--out", tmp_path, "--force").exit_code == 2
    assert list(tmp_path.iterdir()) == []


# -------------------- whole or not at all --------------------


def no_space(*_: object, **__: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def interrupted(*_: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize("call", [(os, "fsync"), (Path, "write_text"), (os, "open"), (Path, "replace")])
def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(
    calibration: Calibration, file: Path, monkeypatch: pytest.MonkeyPatch, call: tuple[Any, str]
) -> None:
    before = file.read_bytes()
    with monkeypatch.context() as patched:
        patched.setattr(*call, no_space)
        with pytest.raises(
            CalibrationError, match=r"calibration\.json: cannot be written: No space left on device; choose"
        ):
            calibration.write(file)
    assert file.read_bytes() == before
    assert list(file.parent.iterdir()) == [file]


@pytest.mark.parametrize("call", [(os, "fsync"), (os, "open"), (Path, "replace")])
def test_a_write_that_is_interrupted_leaves_the_old_file_and_nothing_else(
    calibration: Calibration, file: Path, monkeypatch: pytest.MonkeyPatch, call: tuple[Any, str]
) -> None:
    before = file.read_bytes()
    with monkeypatch.context() as patched:
        patched.setattr(*call, interrupted)
        with pytest.raises(KeyboardInterrupt):
            calibration.write(file)
    assert file.read_bytes() == before
    assert list(file.parent.iterdir()) == [file]


def test_what_is_not_a_number_is_never_written(calibration: Calibration, tmp_path: Path) -> None:
    first = replace(calibration.parameters[0], value=math.nan)
    with pytest.raises(CalibrationError, match=r"^mems-\d: expected an estimate in numbers, found one beyond measure"):
        replace(calibration, parameters=(first, *calibration.parameters[1:])).write(tmp_path / "nan.json")
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_said_in_one_line(session: Path, tmp_path: Path) -> None:
    out = tmp_path / "no" / "out.json"
    result = command(session, "--out", out)
    assert result.exit_code == 2
    assert (
        result.stderr
        == f"tumble: {out}: cannot be written: the folder {out.parent} does not exist; choose another --out\n"
    )
    assert result.stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_a_file_is_said_in_one_line(session: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    result = command(session, "--out", tmp_path / "file" / "out.json")
    assert result.exit_code == 2
    assert "cannot be written: Not a directory" in result.stderr


def test_a_folder_that_may_not_be_written_is_said_in_one_line(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def forbidden(path: str, flags: int, mode: int = 0o777) -> int:
        if flags & os.O_EXCL:
            raise PermissionError(errno.EACCES, "Permission denied")
        return opened(path, flags, mode)

    opened = os.open
    monkeypatch.setattr(os, "open", forbidden)
    result = command(session, "--out", tmp_path / "out.json")
    assert result.exit_code == 2
    assert (
        result.stderr
        == f"tumble: {tmp_path / 'out.json'}: cannot be written: Permission denied; choose another --out\n"
    )


def test_a_read_only_file_is_not_replaced_even_by_force(
    session: Path, file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = file.read_bytes()
    file.chmod(0o444)
    monkeypatch.setattr(os, "access", lambda path, mode: not (mode == os.W_OK and Path(path) == file))  # as not root
    for options in ((), ("--force",)):
        result = command(session, "--out", file, *options)
        assert result.exit_code == 2
        assert result.stderr == f"tumble: {file}: cannot be replaced: it is read-only; choose another --out\n"
    assert file.read_bytes() == before


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
@pytest.mark.parametrize(("umask", "mode"), [(0o022, 0o644), (0o027, 0o640), (0o077, 0o600)])
def test_the_file_has_the_permissions_of_any_new_file(
    calibration: Calibration, tmp_path: Path, umask: int, mode: int
) -> None:
    before = os.umask(umask)
    try:
        calibration.write(tmp_path / "calibration.json")
        assert os.umask(umask) == umask
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "calibration.json").stat().st_mode) == mode


def test_the_file_is_utf_8_whatever_the_locale(
    calibration: Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("locale.getpreferredencoding", lambda *_: "ascii")
    monkeypatch.setattr("locale.getencoding", lambda: "ascii")
    outcome = replace(calibration.outcome, reasons=("off by 5° – 7″",))
    replace(calibration, device=CalibratedDevice(serial="№ 7"), outcome=outcome).write(tmp_path / "calibration.json")
    assert "off by 5° – 7″" in (tmp_path / "calibration.json").read_bytes().decode("utf-8")
    assert read_calibration(tmp_path / "calibration.json").serial == "№ 7"


@pytest.mark.parametrize(
    ("correlations", "said"),
    [
        ({(0, 1): 0.5}, "covariance: expected a symmetric matrix"),
        ({(0, 1): 7.0, (1, 0): 7.0}, "covariance: expected correlations from -1 to 1, found one of 7"),
        (
            {(0, 1): 0.9, (1, 0): 0.9, (0, 2): 0.9, (2, 0): 0.9, (1, 2): -0.9, (2, 1): -0.9},
            "covariance: expected correlations that can be together",
        ),
        ({(0, 0): 0.0}, "covariance: expected zeros beside a variance of 0"),
    ],
)
def test_a_covariance_that_no_parameters_have_is_refused(
    file: Path, tmp_path: Path, correlations: dict[tuple[int, int], float], said: str
) -> None:
    content = contents(file)
    covariance = np.array(content["covariance"])
    u = np.sqrt(np.diag(covariance))
    for (i, j), correlation in correlations.items():
        covariance[i, j] = correlation * u[i] * u[j]
    path = tmp_path / "c.json"
    path.write_text(json.dumps(content | {"covariance": covariance.tolist()}), encoding="utf-8")
    with pytest.raises(CalibrationError) as refused:
        read_calibration(path)
    assert said in str(refused.value)
