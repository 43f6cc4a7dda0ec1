"""Half a calibration is one: accelerometers without the gyros that were refused, and gyros without accelerometers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import tumble
from tests.export.test_export_c import gcc
from tests.export.test_export_larger_model import run
from tests.support.calibrated import calibration, session_of, warmed
from tests.support.exports import FORMATS, TEXT, THERMAL, beside
from tests.use.test_applied_model import larger, read, truth
from tumble.errors import CalibrationError, InputError
from tumble.export import export_calibration
from tumble.inference.estimate import Outcome
from tumble.lab import open_registry
from tumble.result.accepted import accepted_part
from tumble.result.calibration import Calibration, read_calibration
from tumble.sensors.parameters import sensor_kind
from tumble.use.apply import apply_to_session, correction_notes

__all__ = ["gcc"]

WHY = "the others are bad"
ONE_KIND = {
    "accel": ("autoware", "imucal", "kalibr"),
    "gyro": ("betaflight", "imucal", "inav", "kalibr", "ros-imu-calib"),
}
"""Formats that have no place for a calibration of this kind of sensors alone."""
ABSENT = {"accel": "gyros are absent, they were not accepted", "gyro": "accelerometers are absent, they were not"}


def half(made: Calibration, kind: str) -> Calibration:
    """A calibration of which one kind of sensors is accepted."""
    other = "gyro" if kind == "accel" else "accel"
    return replace(made, outcome=Outcome(reasons=(WHY,), concerns={WHY: (other,)}))


@pytest.mark.parametrize("kind", ["accel", "gyro"])
@pytest.mark.parametrize("to", FORMATS)
def test_a_half_is_exported_by_every_format_that_can_hold_it_and_the_other_is_named_absent(to: str, kind: str) -> None:
    made = half(warmed(calibration()) if to in THERMAL else larger()[0], kind)
    if to in ONE_KIND[kind]:
        with pytest.raises(InputError, match=f"export to {to}: expected .* parameters, found .* absent"):
            export_calibration(made, to, **beside(to))
        return
    exported = export_calibration(made, to, **beside(to))
    assert exported.losses[0].startswith(ABSENT[kind])
    if to != "mat":
        text = exported.content.decode("utf-8" if to in TEXT else "latin-1")
        assert ABSENT[kind] in text
        refused = made.gyro if kind == "accel" else made.accel
        assert refused is not None
        assert repr(float(refused.bias[0])) not in text


@pytest.mark.parametrize("to", ["csv", "mat"])
def test_accelerometers_are_exported_where_gyro_parameters_are_not_determined(to: str) -> None:
    made = replace(larger()[0], gyro=None, outcome=Outcome(reasons=(WHY,), concerns={WHY: ("gyro",)}))
    assert export_calibration(made, to).losses[0].startswith(ABSENT["accel"])


def test_gyros_alone_in_a_header_do_what_the_library_does(tmp_path: Path, gcc: str) -> None:
    made, instrument, values = larger()
    force, rate = truth()
    gyro = read(instrument, values, force, rate)[1]
    alone = accepted_part(half(made, "gyro"))
    felt, found = alone.apply(force, gyro)
    assert np.isnan(felt).all()
    assert found is not None
    np.testing.assert_allclose(found, rate, atol=1e-6)
    np.testing.assert_allclose(run(gcc, tmp_path, alone, "gyro", np.hstack([gyro, force])), found, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("kind", ["accel", "gyro"])
def test_a_half_is_applied_and_the_columns_of_the_other_stay_as_they_are(tmp_path: Path, kind: str) -> None:
    made, instrument, values = larger(leave=())
    force, rate = truth()
    readings = read(instrument, values, force, rate)
    columns = dict(zip(["ax", "ay", "az", "gx", "gy", "gz"], np.hstack(readings).T, strict=True))
    table = pl.DataFrame({"t": 0.01 * np.arange(1, 1 + len(force)), **columns})
    log = {
        "time": "t",
        "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s^2"},
        "gyro": {"columns": ["gx", "gy", "gz"], "unit": "rad/s"},
    }
    session, out = session_of(tmp_path / "s", table.write_csv(), log), tmp_path / "out.csv"
    apply_to_session(half(made, kind), session, out)
    corrected, own, other = pl.read_csv(out), ["ax", "ay", "az"], ["gx", "gy", "gz"]
    own, other = (own, other) if kind == "accel" else (other, own)
    assert corrected[other].equals(pl.read_csv(session / "log.csv")[other])
    assert not corrected[own].equals(table[own])
    expected = accepted_part(half(made, kind)).apply(*readings) if kind == "gyro" else None
    if expected is not None and expected[1] is not None:
        np.testing.assert_allclose(corrected[own].to_numpy(), expected[1], rtol=0.0, atol=1e-9)
    assert correction_notes(half(made, kind), session)[0].startswith(ABSENT[kind])


def test_what_belongs_to_the_refused_sensors_is_taken_out_and_nothing_else() -> None:
    made = half(larger()[0], "accel")
    part = accepted_part(made)
    assert [p.name for p in part.parameters] == [p.name for p in made.parameters if sensor_kind(p.name) != "gyro"]
    assert part.covariance is not None
    np.testing.assert_allclose(np.sqrt(np.diag(part.covariance)), [p.u or 0.0 for p in part.parameters])
    assert (part.gyro, part.outcome.verdict) == (None, "accepted")
    assert accepted_part(calibration()).parameters == calibration().parameters
    with pytest.raises(CalibrationError, match="expected an accepted one, found: all is bad"):
        accepted_part(replace(made, outcome=Outcome(reasons=("all is bad",))))


@pytest.fixture(scope="module")
def spoiled(tmp_path_factory: pytest.TempPathFactory) -> Calibration:
    """The calibration of a device whose X gyro changes its scale over the session."""
    folder = tmp_path_factory.mktemp("spoiled") / "s"
    tumble.simulate_session(folder, tumble.Setup.of(grade="mems", positions=18), seed=1)
    log = pl.read_parquet(folder / "log.parquet")
    wave = 1.0 + 0.05 * np.sin(np.arange(len(log)) / 3000.0)
    log.with_columns(pl.col("gx") * wave).write_parquet(folder / "log.parquet")
    return tumble.calibrate(folder)


def test_bad_gyros_leave_the_accelerometers_to_check_report_and_register(spoiled: Calibration, tmp_path: Path) -> None:
    assert (spoiled.outcome.accel.accepted, spoiled.outcome.gyro.accepted) == (True, False)
    clean = tumble.simulate_session(tmp_path / "s", tumble.Setup.of(grade="mems", positions=6), seed=1, launch=2)
    spoiled.write(tmp_path / "calibration.json")
    made = read_calibration(tmp_path / "calibration.json")
    checked = tumble.check_calibration(made, clean)
    assert checked.valid
    assert checked.rest_limit is not None
    assert all(abs(rest.sigmas or 0.0) < checked.rest_limit for rest in checked.rests)
    assert checked.notes[0].startswith(ABSENT["accel"])
    with open_registry(tmp_path / "r.sqlite", create=True) as registry:
        registry.add_calibration(tmp_path / "calibration.json")
    tumble.write_report([tmp_path / "calibration.json"], tmp_path / "r.html")
    assert "accelerometers: accepted; gyros: not accepted" in (tmp_path / "r.html").read_text()


def test_gyros_alone_are_not_checked_in_one_line(tmp_path: Path) -> None:
    clean = tumble.simulate_session(tmp_path / "s", tumble.Setup.of(grade="mems", positions=4), seed=1)
    made = half(calibration(serial="mems-1"), "gyro")
    with pytest.raises(CalibrationError, match=r"expected accepted accelerometers, by which .* absent"):
        tumble.check_calibration(made, clean)
