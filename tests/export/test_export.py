"""`tumble export`: what every target has in common; what only some can get wrong is in the other files here."""

from __future__ import annotations

import stat
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tests.support.calibrated import HEXAD, calibration, warmed
from tests.support.exports import FORMATS, NOISE, TEXT, THERMAL, beside
from tests.use.test_applied_model import larger
from tumble.cli import main
from tumble.errors import InputError
from tumble.export import export_calibration, target
from tumble.inference.estimate import Outcome
from tumble.result.calibration import Calibration
from tumble.result.parts import CalibratedDevice, Parameter

IN_COMMENTS = tuple(name for name in TEXT if name != "dcc")
"""Targets whose notes are in the file, in the words of standard error but for what JSON and C escape."""


def made_for(to: str) -> Calibration:
    """The test calibration, which changes with temperature where the format is about that."""
    return warmed(calibration()) if to in THERMAL else calibration()


def content_of(to: str, **changes: object) -> str:
    """An export of the test calibration as text."""
    made = replace(made_for(to), **changes)  # type: ignore[arg-type]
    return export_calibration(made, to, **beside(to)).content.decode("utf-8" if to in TEXT else "latin-1")


@pytest.mark.parametrize("to", FORMATS)
def test_an_unaccepted_calibration_is_not_exported(to: str) -> None:
    with pytest.raises(InputError, match="expected an accepted one, found: a reason"):
        content_of(to, outcome=Outcome(reasons=("a reason",)))


@pytest.mark.parametrize("to", FORMATS)
def test_a_calibration_without_a_model_is_not_exported(to: str) -> None:
    with pytest.raises(InputError, match=r"calibration: expected a sensor|expected accel parameters"):
        content_of(to, accel=None, gyro=None)


@pytest.mark.parametrize("to", IN_COMMENTS)
def test_what_is_lost_is_said_in_few_notes_and_in_the_file_too(to: str) -> None:
    for made in (made_for(to), warmed(larger(leave=())[0])):
        exported = export_calibration(made, to, **beside(to))
        assert 1 <= len(exported.losses) <= 4
        text = exported.content.decode()
        assert all(loss in text for loss in exported.losses)
        assert "uncertaint" in text or to in ("csv", "csv-thermal")


@pytest.mark.parametrize("to", ["px4", "ardupilot", "c", "csv", "json", "mat", "ros-imu-calib"])
def test_gyros_that_are_not_known_are_said_to_be_left_as_they_are(to: str) -> None:
    losses = export_calibration(calibration(with_gyro=False), to, **beside(to)).losses
    assert sum("gyros: not known, left as they are" in loss for loss in losses) == 1
    assert not any("not known" in loss for loss in export_calibration(calibration(), to, **beside(to)).losses)


def test_the_first_letters_of_a_target_are_enough_for_a_hint() -> None:
    with pytest.raises(InputError, match="found 'arduino'; did you mean 'c'"):
        export_calibration(calibration(), "arduino")
    with pytest.raises(InputError, match="found 'ros'; did you mean 'ros-imu-calib'"):
        target("ros")


@pytest.mark.parametrize("to", FORMATS)
def test_device_and_log_are_named(to: str) -> None:
    text = content_of(to)
    assert "A-0007" in text
    assert f"{1:064x}" in text


@pytest.mark.parametrize("to", TEXT)
def test_a_hostile_serial_number_stays_text(to: str) -> None:
    """Comments end with their line; so what would end them earlier, or go on after them, must not be in them."""
    serial = "A\n1\t1\tCAL_ACC0_XOFF\t9\t9 */ int x; \\\n<script>&\u2028SM: [0]"
    plain, hostile = (content_of(to, device=CalibratedDevice(serial=each, model="test")) for each in ("A", serial))
    assert len(hostile.splitlines()) == len(plain.splitlines())
    assert "*/ int x" not in hostile or to in ("dcc", "json")  # which have no such comments


@pytest.mark.parametrize("to", sorted({*FORMATS} - {"c", "csv", "json", "mat", "dcc", *THERMAL}))
def test_targets_with_three_axes_refuse_a_redundant_block(to: str) -> None:
    with pytest.raises(InputError, match="expected three accel sensors, found 6; c, csv and mat hold any number"):
        export_calibration(calibration(accel=HEXAD), to, **beside(to))


@pytest.mark.parametrize("to", [name for name in FORMATS if "imu" in target(name).takes])
def test_targets_without_a_matrix_refuse_channels_in_another_order(to: str) -> None:
    for axes in ([[0, 1, 0], [1, 0, 0], [0, 0, -1]], [[-1, 0, 0], [0, -1, 0], [0, 0, 1]]):
        with pytest.raises(InputError, match=f"export to {to}: expected accel channels along X, Y, Z in this order"):
            export_calibration(warmed(calibration(accel=np.array(axes, dtype=float), with_gyro=False)), to)


def test_what_a_target_does_not_take_or_lacks_is_refused() -> None:
    with pytest.raises(InputError, match="export to kalibr: expected noise, found none, nor rests"):
        export_calibration(calibration(), "kalibr")
    with pytest.raises(InputError, match="export to px4: expected imu, found noise"):
        export_calibration(calibration(), "px4", noise=NOISE)
    with pytest.raises(InputError, match="export to dcc: expected certificate, found none"):
        export_calibration(calibration(), "dcc")
    with pytest.raises(InputError, match="export to px4-thermal: expected imu and sensor_ids, found counts"):
        export_calibration(calibration(), "px4-thermal", counts=(1.0, 1.0))
    with pytest.raises(InputError, match=r"expected one of px4, .*, found 'pix4'; did you mean 'px4'\?"):
        export_calibration(calibration(), "pix4")
    with pytest.raises(InputError, match="expected one of px4"):
        export_calibration(calibration(), "../targets/inav")


def test_of_a_folder_its_calibration_is_named(tmp_path: Path) -> None:
    file = tmp_path / "calibration.json"
    calibration().write(file)
    result = CliRunner().invoke(main, ["export", str(tmp_path), "--to", "px4", "-o", str(tmp_path / "imu.params")])
    assert result.exit_code == 2
    assert f"expected a file, found a folder; its calibration is {file}" in result.stderr


def test_the_command_writes_the_file_and_says_what_is_lost(tmp_path: Path) -> None:
    calibration().write(tmp_path / "c.json")
    words = ["export", str(tmp_path / "c.json"), "--to", "px4", "-o", str(tmp_path / "imu.params")]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0
    assert result.stdout == ""
    assert "note: remaining error: accelerometers by up to" in result.stderr
    out = tmp_path / "imu.params"
    assert out.read_bytes() == export_calibration(calibration(), "px4").content
    assert stat.S_IMODE(out.stat().st_mode) & 0o444 == 0o444
    assert CliRunner().invoke(main, words).exit_code == 2
    assert CliRunner().invoke(main, [*words, "--force"]).exit_code == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["c.json", "imu.params"]


@pytest.mark.parametrize("to", FORMATS)
def test_a_magnetometer_is_named_as_lost_and_disturbs_nothing(to: str) -> None:
    """Its parameters are there or not, the numbers of the others are the same."""
    made = made_for(to)
    assert made.covariance is not None
    field = Parameter(name="mag.bias.x", value=3.0, u=0.5, unit="uT")
    covariance = np.pad(made.covariance, (0, 1))
    covariance[-1, -1] = 0.25
    with_mag = replace(made, parameters=(*made.parameters, field), covariance=covariance, mag=made.accel)
    one, other = export_calibration(made, to, **beside(to)), export_calibration(with_mag, to, **beside(to))
    held = to.startswith(("px4", "ardupilot"))
    assert any("matrix and bias of the magnetometer" in loss for loss in other.losses) != held
    if to not in ("mat", "csv"):
        assert b"uT" not in other.content
        lines = [len(each.content.splitlines()) for each in (one, other)]
        assert lines[1] - lines[0] in (0, 1) or to not in TEXT or held
