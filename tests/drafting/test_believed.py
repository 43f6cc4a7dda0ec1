"""What a name, a unit or the user says of a log is believed; numbers fill in what that leaves open."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from tests.support.shared import session
from tumble.cli import main
from tumble.drafting.new_session import Given, new_session
from tumble.errors import InputError
from tumble.planning.setup import Setup
from tumble.recording.session_file import read_session
from tumble.units import DEGREE, G_STANDARD, Array


@pytest.fixture(scope="module")
def rows() -> Array:
    """Times, s, accelerometers, g, and gyros, °/s, of twelve rests by hand."""
    log = pl.read_parquet(session(Setup.of(grade="mems", positions=12), seed=4) / "log.parquet").to_numpy()
    return np.round(np.column_stack([log[:, 0], log[:, 1:4] / G_STANDARD, log[:, 4:7] / DEGREE]), 5)


def text(path: Path, header: str, rows: Array) -> Path:
    path.write_text(header + "".join(",".join(f"{x:.10g}" for x in row) + "\n" for row in rows.tolist()))
    return path


def columns_of(folder: Path) -> dict[str, tuple[tuple[str, ...], str]]:
    log = read_session(folder).log
    assert log.gyro is not None
    return {"accel": (log.accel.columns, log.accel.unit_name), "gyro": (log.gyro.columns, log.gyro.unit_name)}


NAMES = "time,ax,ay,az,gx,gy,gz"


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("gyros_first", [False, True])
def test_numbers_of_more_than_three_columns_are_no_axes(
    gyros_first: bool, first: int, rows: Array, tmp_path: Path
) -> None:
    """A0 … A5 are the pins of a converter: A1, A2, A3 of them were taken for x, y and z of the accelerometers."""
    pins, order = [f"A{first + i}" for i in range(6)], [4, 5, 6, 1, 2, 3] if gyros_first else [1, 2, 3, 4, 5, 6]
    log = text(tmp_path / "log.csv", f"t,{','.join(pins)}\n", rows[:, [0, *order]])
    new_session(tmp_path / "s", log)
    accel, gyro = (3, 0) if gyros_first else (0, 3)
    found = {kind: columns for kind, (columns, _) in columns_of(tmp_path / "s").items()}
    assert found == {"accel": tuple(pins[accel : accel + 3]), "gyro": tuple(pins[gyro : gyro + 3])}


def test_gyros_that_no_number_shows_are_doubted(rows: Array, tmp_path: Path) -> None:
    """One of them is stuck, and the accelerometers alone were calibrated without a word."""
    stuck = np.where(np.arange(7) == 5, rows[500], rows)
    log = text(tmp_path / "log.csv", f"t,{','.join(f'A{i}' for i in range(6))}\n", stuck)
    draft, _ = new_session(tmp_path / "s", log)
    assert any(doubt.startswith("columns A3, A4, A5 are not used: the accelerometers alone") for doubt in draft.doubts)


def test_a_refusal_names_what_was_guessed(rows: Array, tmp_path: Path) -> None:
    """Also of the session that the log had before; not of one that is accepted."""
    pins = "t," + ",".join(f"A{i}" for i in range(6))
    for name, order, refused in (("bad.csv", [0, 2, 1, 3, 4, 5, 6], True), ("good.csv", range(7), False)):
        log = text(tmp_path / name, f"{pins}\n", rows[:, list(order)])
        for _ in range(2):
            result = CliRunner().invoke(main, ["calibrate", str(log), "--latitude", "56.8", "--terms", "linear"])
            assert result.exit_code == int(refused), result.stderr
            assert ("note: gyro: columns A3, A4, A5, by their numbers (a guess)" in result.stderr) == refused


@pytest.mark.parametrize(
    ("header", "given", "accel", "gyro"),
    [
        (f"{NAMES},mx,my,mz", Given(), "ax ay az", "gx gy gz"),
        ("t,x,y,z,x,y,z", Given(accel=("2", "3", "4"), gyro=("5", "6", "7")), "2 3 4", "5 6 7"),
        ("t,x,y,z,x,y,z,,,", Given(accel=("2", "3", "4"), gyro=("5", "6", "7")), "2 3 4", "5 6 7"),
        ("\0\0time,ax,ay,az,gx,gy,gz,a,b,c", Given(), "ax ay az", "gx gy gz"),
        (NAMES, Given(), "ax ay az", "gx gy gz"),
        ("t,ax1,ay1,az1,gx1,gy1,gz1,ax2,ay2,az2", Given(), "ax1 ay1 az1", "gx1 gy1 gz1"),
        (NAMES + ",p,q,r", Given(accel=("5", "6", "7"), gyro=("ax", "ay", "az"), time="1"), "gx gy gz", "ax ay az"),
    ],
    ids=["magnetometer off", "same names", "same names, others", "NULs", "short header", "two devices", "exchanged"],
)
def test_columns_are_those_that_names_or_the_user_say(
    header: str, given: Given, accel: str, gyro: str, rows: Array, tmp_path: Path
) -> None:
    log = text(tmp_path / "log.csv", f"{header}\n", np.column_stack([rows, np.zeros((len(rows), 3))]))
    new_session(tmp_path / "s", log, given)
    found = columns_of(tmp_path / "s")
    assert [found[kind][0] for kind in ("accel", "gyro")] == [tuple(accel.split()), tuple(gyro.split())]


@pytest.mark.parametrize(
    ("units", "found", "fault"),
    [
        (("g", "dps"), ("g", "deg/s"), None),
        (("g", "mdps"), ("g", "mdeg/s"), 'the unit of [log.gyro] is not "mdeg/s", "deg/s" would fit'),
        (("V", "dps"), ("V", "deg/s"), None),
    ],
)
def test_units_in_names_stay_and_what_contradicts_them_is_said(
    units: Sequence[str], found: tuple[str, str], fault: str | None, rows: Array, tmp_path: Path
) -> None:
    volts = np.column_stack([rows[:, :1], 1.66 + 0.325 * rows[:, 1:4], rows[:, 4:]]) if units[0] == "V" else rows
    names = ",".join(["t", *(f"a{a} [{units[0]}]" for a in "xyz"), *(f"g{a} [{units[1]}]" for a in "xyz")])
    _, faults = new_session(tmp_path / "s", text(tmp_path / "log.csv", f"{names}\n", volts))
    assert tuple(unit for _, unit in columns_of(tmp_path / "s").values()) == found
    assert any(fault in each for each in faults) if fault else not faults


def test_stated_units_have_every_spelling_that_names_of_columns_have() -> None:
    for accel, gyro, named in (("m/s2", "dps", ("m/s^2", "deg/s")), ("G", "°/s", ("g", "deg/s"))):
        units = Given(accel_unit=accel, gyro_unit=gyro).units
        assert (units["accel"], units["gyro"]) == named
    with pytest.raises(InputError, match=r"expected one of rad/s, .* found 'radd/s'; did you mean 'rad/s'"):
        _ = Given(gyro_unit="radd/s").units


def test_six_columns_without_names_of_a_body_that_is_never_at_rest(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    walk = np.add(np.cumsum(rng.normal(scale=0.02, size=(2000, 3)), axis=0), [0.0, 0.0, 2.0])
    accel = G_STANDARD * walk / np.linalg.norm(walk, axis=1)[:, None] + rng.normal(scale=1.0, size=(2000, 3))
    new_session(tmp_path / "s", text(tmp_path / "log.csv", "", np.column_stack([accel, rng.normal(size=(2000, 3))])))
    assert [columns for columns, _ in columns_of(tmp_path / "s").values()] == [("1", "2", "3"), ("4", "5", "6")]


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ("t,Raw X Gyro,Raw Y Gyro,Raw Z Gyro", "found gyros alone"),
        ("t,axx,axy,axz,gyx,gyy,gyz", r"gyros alone \(gyx.* not understood \(axx, axy, axz\); .*\(accel axx,axy,axz\)"),
        ("t,fx_uT,fy_uT,fz_uT", "found a magnetometer alone .*; log the accelerometers in the same rows"),
        ("t,estLinearAccelX,estLinearAccelY,estLinearAccelZ", "found linear acceleration, which a filter has taken"),
        ("t,LinAccX,LinAccY,LinAccZ", "found linear acceleration, which a filter has taken"),
    ],
)
def test_what_names_say_is_no_accelerometer_is_refused(names: str, said: str, tmp_path: Path) -> None:
    read = np.random.default_rng(4).normal(scale=0.3, size=(600, 3))
    sensors = np.tile(read, names.count(",") // 3)
    log = text(tmp_path / "log.csv", f"{names}\n", np.column_stack([0.1 * np.arange(600), sensors]))
    with pytest.raises(InputError, match=said):
        new_session(tmp_path / "s", log)


def test_of_raw_and_calibrated_readings_the_raw_ones_are_taken(rows: Array, tmp_path: Path) -> None:
    raw = np.rint(rows[:, 1:] * np.repeat([16384.0, 131.0], 3))
    names = ",".join(f"{kind}_{what}_{axis}" for what in ("raw", "cal") for kind in ("acc", "gyro") for axis in "xyz")
    table = np.column_stack([rows[:, 0], raw, rows[:, 1:4] * G_STANDARD, rows[:, 4:7] * DEGREE])
    new_session(tmp_path / "s", text(tmp_path / "log.csv", f"t,{names}\n", table))
    found = columns_of(tmp_path / "s")
    assert [found[kind][0][0] for kind in ("accel", "gyro")] == ["acc_raw_x", "gyro_raw_x"]


@pytest.mark.parametrize("sensors", ["rot{}", "fog_{}", "R{}"])
def test_gyros_whose_names_do_not_tell_them_are_found_by_the_turns(sensors: str, rows: Array, tmp_path: Path) -> None:
    names = f"t,ax,ay,az,{','.join(sensors.format(axis) for axis in 'XYZ')}\n"
    new_session(tmp_path / "s", text(tmp_path / "log.csv", names, rows))
    assert columns_of(tmp_path / "s")["gyro"] == (tuple(sensors.format(axis) for axis in "XYZ"), "deg/s")


@pytest.mark.parametrize("other", [lambda a: 30.0 * a[:, [2, 0, 1]], lambda a: np.cumsum(a, axis=0) / 100.0])
def test_other_columns_beside_accelerometers_are_no_gyros(
    other: Callable[[Array], Array], rows: Array, tmp_path: Path
) -> None:
    """A field, and velocities."""
    table = np.column_stack([rows[:, :4], other(rows[:, 1:4])])
    new_session(tmp_path / "s", text(tmp_path / "log.csv", "t,ax,ay,az,some_x,some_y,some_z\n", table))
    assert read_session(tmp_path / "s").log.gyro is None


@pytest.mark.parametrize("command", ["calibrate", "inspect", "noise"])
def test_a_magnetometer_alone_ends_with_one_line_and_the_next_step(command: str, tmp_path: Path) -> None:
    field = np.random.default_rng(4).normal(loc=[20.0, 0.0, -40.0], scale=0.3, size=(600, 3))
    log = text(tmp_path / "mag.csv", "t,mag_x,mag_y,mag_z\n", np.column_stack([0.1 * np.arange(600), field]))
    done = CliRunner().invoke(main, [command, str(log)])
    assert done.exit_code == 2
    assert done.stderr.count("\n") == 1
    assert "found a magnetometer alone (mag_x, mag_y, mag_z); log the accelerometers in the same rows" in done.stderr
    assert list(tmp_path.iterdir()) == [log]
