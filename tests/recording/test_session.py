"""session.toml: what is read, what is refused and how it is said, and that the documentation has every key."""

from __future__ import annotations

import math
import re
import tomllib
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pydantic import BaseModel

from tests.support import ROOT
from tumble.documents import table_behind
from tumble.errors import SessionError
from tumble.programme.positions import BUILT_IN
from tumble.recording.session import Session
from tumble.recording.session.document import SessionDocument
from tumble.recording.session.log_tables import AccelTable, GyroTable
from tumble.recording.session_file import read_session, write_session
from tumble.units import TIME_UNITS

DOCUMENT = ROOT / "docs/reference/session-file.md"

GONE = object()
"""In a change: the key is taken out."""

BASE: dict[str, Any] = {
    "format": 1,
    "device": {"serial": "A-0007"},
    "log": {
        "file": "log.csv",
        "time": "t",
        "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s^2"},
        "gyro": {"columns": ["gx", "gy", "gz"], "unit": "rad/s"},
    },
}

RAW = {"unit": "count", "scale": 415.0}
FOUR = ["a0", "a1", "a2", "a3"]
CUBE = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]


def changed(content: dict[str, Any], change: dict[str, Any]) -> dict[str, Any]:
    """The content with the values of `change` in place, table by table."""
    out = dict(content)
    for key, value in change.items():
        if value is GONE:
            out.pop(key)
        elif isinstance(value, dict) and isinstance(out.get(key), dict):
            out[key] = changed(out[key], value)
        else:
            out[key] = value
    return out


def folder_of(folder: Path, change: dict[str, Any]) -> Path:
    """A session folder of the base content with a change, its log empty."""
    folder.mkdir(exist_ok=True)
    (folder / "session.toml").write_text(tomli_w.dumps(changed(BASE, change)), encoding="utf-8")
    (folder / "log.csv").touch()
    return folder


def read(folder: Path, change: dict[str, Any]) -> Session:
    return read_session(folder_of(folder, change))


def refusal(folder: Path) -> str:
    with pytest.raises(SessionError) as caught:
        read_session(folder)
    said = str(caught.value)
    assert "\n" not in said
    return said


def accel(**keys: Any) -> dict[str, Any]:
    return {"log": {"accel": keys}}


def gyro(**keys: Any) -> dict[str, Any]:
    return {"log": {"gyro": keys}}


def positions(*tables: dict[str, Any]) -> dict[str, Any]:
    return {"programme": {"position": list(tables)}}


# key: (what is changed in a good session, what the message says)
FAULTS: dict[str, tuple[dict[str, Any], str]] = {
    "format 2": ({"format": 2}, "format: expected 1, the format of this file, found 2"),
    "format as text": ({"format": "1"}, 'format: expected 1, the format of this file, found "1"'),
    "format true": ({"format": True}, "format: expected 1, the format of this file, found true"),
    "no format": ({"format": GONE}, "format: expected 1, the format of this file, found none"),
    "no device": ({"device": GONE}, "device: expected the table [device], found none"),
    "no serial": (
        {"device": {"serial": GONE}},
        "device.serial: expected the serial number, a string that is not empty, found none",
    ),
    "serial a number": ({"device": {"serial": 7}}, "not empty, found 7"),
    "serial empty": ({"device": {"serial": ""}}, 'not empty, found ""'),
    "model a list": ({"device": {"model": ["a"]}}, 'device.model: expected a string, found ["a"]'),
    "no passport": (
        {"device": {"systematic": "passport.json"}},
        "device.systematic: expected a calibration file at",
    ),
    "latitude": (
        {"site": {"latitude_deg": 145.5}},
        "session.toml: site.latitude_deg: expected a number from -90 to 90, found 145.5",
    ),
    "latitude as text": (
        {"site": {"latitude_deg": "45.5"}},
        'site.latitude_deg: expected a number from -90 to 90, found "45.5"',
    ),
    "latitude true": ({"site": {"latitude_deg": True}}, "from -90 to 90, found true"),
    "latitude nan": ({"site": {"latitude_deg": math.nan}}, "from -90 to 90, found NaN"),
    "latitude misspelt": (
        {"site": {"latitud_deg": 45.5}},
        "unknown key 'latitud_deg' in [site]; did you mean 'latitude_deg'?",
    ),
    "height": (
        {"site": {"height_m": 27000.0}},
        "site.height_m: expected a number from -1000 to 10000 (m), found 27000.0",
    ),
    "gravity in g": (
        {"site": {"gravity": 1.0}},
        "site.gravity: expected a number from 9.7 to 9.9 (m/s^2, on Earth), found 1.0",
    ),
    "gravity_u negative": ({"site": {"gravity_u": -1e-6}}, "site.gravity_u: expected a number from 0 to 0.1"),
    "gravity_u next to nothing": (
        {"site": {"gravity": 9.81, "gravity_u": 1e-320}},
        "site.gravity_u: expected 0 or at least 1e-15 m/s^2, found 9.99989e-321",
    ),
    "prior next to nothing": (
        {"device": {"serial": "A", "prior": {"accel_quadratic": "1e-300 ug/g^2"}}},
        "accel_quadratic: expected a positive number and one of",
    ),
    "gravity_u of nothing": (
        {"site": {"gravity_u": 1e-6}},
        "site.gravity_u: expected site.gravity or site.latitude_deg with it, found neither",
    ),
    "unknown table": ({"sight": {}}, "unknown key 'sight' at the top level; did you mean 'site'?"),
    "unknown key like no other": ({"log": {"zzz": 1}}, "unknown key 'zzz' in [log]"),
    "site not a table": ({"site": 3}, "site: expected the table [site], found 3"),
    "no log": ({"log": GONE}, "log: expected the table [log], found none"),
    "no file": ({"log": {"file": GONE}}, "log.file: expected a file name or a list of file names, found none"),
    "empty list": ({"log": {"file": []}}, "log.file: expected a file name or a list of file names, found []"),
    "file missing": ({"log": {"file": "lgo.csv"}}, "log.file: expected a log at"),
    "one of the files missing": ({"log": {"file": ["log.csv", "b.csv"]}}, "b.csv, found no such file"),
    "file twice": ({"log": {"file": ["log.csv", "log.csv"]}}, 'different files, found "log.csv" twice'),
    "neither time nor rate": (
        {"log": {"time": GONE}},
        "log.time: expected either log.time, a column, or log.rate_hz, found neither",
    ),
    "time and rate": ({"log": {"rate_hz": 100.0}}, "or log.rate_hz, found both"),
    "clock beyond measure": (
        {"log": {"clock_ppm_u": 1e308}},
        "log.clock_ppm_u: expected a number from 0 to 1000000, found 1e+308",
    ),
    "rate zero": ({"log": {"time": GONE, "rate_hz": 0}}, "log.rate_hz: expected a positive number, found 0"),
    "rate infinite": (
        {"log": {"time": GONE, "rate_hz": math.inf}},
        "log.rate_hz: expected a positive number, found Infinity",
    ),
    "time_unit": (
        {"log": {"time_unit": "usec"}},
        "log.time_unit: expected one of s, ms, us, ns, min, h, iso8601, found \"usec\"; did you mean 'us'?",
    ),
    "time_unit with rate": (
        {"log": {"time": GONE, "rate_hz": 10, "time_unit": "ms"}},
        "log.time_unit: expected only with log.time, found log.rate_hz",
    ),
    "two sensors": (
        accel(columns=["ax", "ay"]),
        'log.accel.columns: expected a list of at least three column names, found ["ax", "ay"]',
    ),
    "columns a string": (gyro(columns="gx"), "log.gyro.columns: expected a list of at least three column names"),
    "a column a number": (gyro(columns=["gx", 2, "gz"]), 'found ["gx", 2, "gz"]'),
    "column twice": (
        accel(columns=["ax", "ay", "ay"]),
        'log.accel.columns: expected every column once, found "ay" twice',
    ),
    "column in both": (
        gyro(columns=["gx", "ay", "gz"]),
        'log.gyro.columns: expected every column once, found "ay" in log.accel.columns too',
    ),
    "time as temperature": (
        {"log": {"temperature": {"columns": ["t"]}}},
        'log.temperature.columns: expected every column once, found "t" in log.time too',
    ),
    "three temperatures": (
        {"log": {"temperature": {"columns": ["T1", "T2", "T3"]}}},
        "log.temperature.columns: expected one column for all sensors, two for the accelerometers and the gyros, or 6, "
        "one a sensor, accelerometers first, found 3",
    ),
    "one thermometer as two": (
        {"log": {"temperature": {"columns": ["T", "T"]}}},
        'log.temperature.columns: expected every column once, found "T" twice',
    ),
    "no thermometer": (
        {"log": {"temperature": {"columns": []}}},
        "log.temperature.columns: expected a list of column names",
    ),
    "temperature unit": (
        {"log": {"temperature": {"columns": ["T"], "unit": "C"}}},
        'log.temperature.unit: expected one of degC, K, degF, found "C"',
    ),
    "accel unit": (
        accel(unit="m/s2"),
        "expected one of m/s^2, g, mg, cm/s^2, mm/s^2, m/s, count, V, found \"m/s2\"; did you mean 'm/s^2'?",
    ),
    "gyro unit": (
        gyro(unit="degs/s"),
        "0.1 deg/s, deg/h, rad, deg, arcsec, count, V, found \"degs/s\"; did you mean 'deg/s'?",
    ),
    "gyro unit of an accel": (gyro(unit="g"), "log.gyro.unit: expected one of rad/s,"),
    "no scale": (
        accel(unit="V"),
        'log.accel.scale: expected the nominal output per unit for unit "V", found none',
    ),
    "scale of SI": (
        accel(scale=1.0),
        'log.accel.scale: expected only with unit "count" or "V", found unit "m/s^2"',
    ),
    "scale_per of SI": (gyro(scale_per="deg/s"), "log.gyro.scale_per: expected only with unit"),
    "offset of SI": (accel(offset=0.0), "log.accel.offset: expected only with unit"),
    "scale length": (
        accel(unit="count", scale=[1.0, 2.0]),
        "log.accel.scale: expected a number or 3 numbers, one per column, found 2",
    ),
    "offset length": (accel(**RAW, offset=[1.0] * 4), "log.accel.offset: expected a number or 3 numbers"),
    "scale zero": (
        accel(unit="count", scale=[1.0, 0.0, 2.0]),
        "log.accel.scale: expected numbers other than zero, found [1.0, 0.0, 2.0]",
    ),
    "scale as text": (accel(unit="count", scale="415"), "log.accel.scale: expected a number or a list of numbers"),
    "scale true": (accel(unit="count", scale=True), "expected a number or a list of numbers, found true"),
    "accel scale_per": (
        accel(**RAW, scale_per="mg"),
        'log.accel.scale_per: expected one of m/s^2, g, m/s, found "mg"',
    ),
    "gyro scale_per": (
        gyro(**RAW, scale_per="deg/h"),
        "log.gyro.scale_per: expected one of rad/s, deg/s, rad, deg, arcsec",
    ),
    "axes missing": (
        accel(columns=FOUR),
        "log.accel.axes: expected 4 unit vectors for a redundant block, found none",
    ),
    "axes too few": (
        accel(columns=FOUR, axes=CUBE),
        "log.accel.axes: expected 4 vectors, one per column, found 3",
    ),
    "axis of two numbers": (
        accel(axes=[[1, 0, 0], [0, 1], [0, 0, 1]]),
        "log.accel.axes: expected vectors [x, y, z], found 2 numbers in vector 2",
    ),
    "axis not a unit vector": (
        accel(columns=FOUR, axes=[*CUBE, [0.577, 0.577, 0.577]]),
        "log.accel.axes: expected unit vectors within 1e-06, found norm 0.9993933 of vector 4",
    ),
    "axis zero": (accel(axes=[[1, 0, 0], [0, 1, 0], [0, 0, 0]]), "found norm 0 of vector 3"),
    "axes in a plane": (
        gyro(axes=[[1, 0, 0], [0, 1, 0], [0.6, 0.8, 0]]),
        "log.gyro.axes: expected directions that span three dimensions, found them in one plane",
    ),
    "first two parallel": (
        accel(columns=FOUR, axes=[[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        "log.accel.axes: expected the first two accelerometers, which fix the body frame, in different",
    ),
    "range": (accel(range=-1), "log.accel.range: expected a positive number, found -1"),
    "range of an increment": (
        accel(unit="m/s", range=1.0),
        "log.accel.range: expected log.rate_hz with the full scale of an increment per sample",
    ),
    "programme empty": (
        {"programme": {}},
        "programme.name: expected either programme.name or [[programme.position]], found neither",
    ),
    "programme both": ({"programme": {"name": "nine", "position": [{"attitude": "NUE"}]}}, "found both"),
    "programme name": (
        {"programme": {"name": "rough_table"}},
        "cube-26, cube-12, faces-edges-18, found \"rough_table\"; did you mean 'rough-table'?",
    ),
    "no positions": ({"programme": {"position": []}}, "expected one or more tables [[programme.position]], found []"),
    "left-handed attitude": (
        positions({"attitude": "NUE"}, {"attitude": "UNE"}),
        'programme.position[2].attitude "UNE": expected a right-handed triple',
    ),
    "attitude a number": (
        positions({"attitude": 45}),
        "programme.position[1].attitude: expected an attitude code, a string, found 45",
    ),
    "start alone": (
        positions({"attitude": "NUE", "start": 1.0}),
        "programme.position[1].start: expected start and stop together, found start alone",
    ),
    "stop before start": (
        positions({"attitude": "NUE", "start": 180.0, "stop": 120.0}),
        "programme.position[1].start: expected a start before the stop 120 s, found 180 s",
    ),
    "key of a position": (
        positions({"attitude": "NUE", "begin": 1.0}),
        "unknown key 'begin' in [programme.position[1]]",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_fault_is_named_with_its_key_and_what_was_expected_and_found(name: str, tmp_path: Path) -> None:
    change, said = FAULTS[name]
    message = refusal(folder_of(tmp_path / "s", change))
    assert message.startswith(str(tmp_path / "s" / "session.toml: "))
    assert said in message
    assert "; and " not in message  # one fault was made and one is reported
    assert message.count("expected") <= 1


def test_faultless_base_reads(tmp_path: Path) -> None:
    session = read(tmp_path, {})
    assert session.device.serial == "A-0007"
    assert session.programme is None
    assert session.log.columns == ("t", "ax", "ay", "az", "gx", "gy", "gz")


def test_three_faults_are_told_and_the_others_counted(tmp_path: Path) -> None:
    wrong = {
        "format": 3,
        "device": {"serial": 1},
        "site": {"latitude_deg": 99, "gravity": 98, "heigth_m": 3},
    }
    message = refusal(folder_of(tmp_path, wrong))
    assert message.count("expected") == 3
    assert message.endswith("; and 2 more")


def test_syntax_error_is_told_with_its_line(tmp_path: Path) -> None:
    (tmp_path / "session.toml").write_text('format = 1\n\n[device\nserial = "A"\n')
    assert "session.toml: expected TOML" in refusal(tmp_path)
    assert "line 3" in refusal(tmp_path)


def test_key_given_twice_is_a_syntax_error(tmp_path: Path) -> None:
    (tmp_path / "session.toml").write_text("format = 1\nformat = 1\n")
    assert "line 2" in refusal(tmp_path)


def test_other_encoding_is_told(tmp_path: Path) -> None:
    (tmp_path / "session.toml").write_bytes("format = 1 # Größe\n".encode("latin-1"))
    assert "expected UTF-8 text" in refusal(tmp_path)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("", "session.toml: expected a session folder with a session.toml, found none"),
        ("nowhere", "nowhere: expected a session folder or its session.toml, found no such file or folder"),
        ("session.toml", "session.toml: expected a session folder with a session.toml, found none"),
        ("log.csv", "log.csv: expected a session folder or its session.toml, found another file"),
    ],
)
def test_path_that_is_no_session_is_told(given: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "log.csv").touch()
    assert said in refusal(tmp_path / given)


def test_session_is_read_from_its_folder_and_from_its_file(tmp_path: Path) -> None:
    by_folder = read(tmp_path, {})
    by_file = read_session(tmp_path / "session.toml")
    assert by_file.folder == by_folder.folder == tmp_path
    assert by_file.log.files == by_folder.log.files == (tmp_path / "log.csv",)


# -------------------- what the values become --------------------


def test_gravity_of_the_file_is_known_to_its_last_digit_unless_its_uncertainty_is_given(tmp_path: Path) -> None:
    site = read(tmp_path, {"site": {"latitude_deg": 56.84, "gravity": 9.81594}}).site
    assert site.gravity == 9.81594
    assert site.gravity_u == pytest.approx(1e-5 / 12**0.5)
    computed = read(tmp_path, {"site": {"gravity": 9.815943216842}}).site
    assert computed.gravity_u == 0.0
    site = read(tmp_path, {"site": {"gravity": 9.81594, "gravity_u": 2e-6}}).site
    assert (site.latitude, site.gravity, site.gravity_u) == (None, 9.81594, 2e-6)


def test_gravity_comes_from_latitude_and_height_else(tmp_path: Path) -> None:
    # WGS-84: 9.7803253359 on the equator, 9.8321849378 at the poles; 0.3086 mGal less per metre of height
    site = read(tmp_path, {"site": {"latitude_deg": 0, "height_m": 0}}).site
    assert site.gravity == pytest.approx(9.7803253359, abs=1e-10)
    assert (site.latitude, site.height, site.gravity_u) == (0.0, 0.0, 3e-4)
    anywhere = read(tmp_path, {"site": {"latitude_deg": 0}}).site
    assert anywhere.gravity == site.gravity
    assert anywhere.gravity_u == 4e-3  # of 1300 m
    site = read(tmp_path, {"site": {"latitude_deg": -90, "height_m": 100, "gravity_u": 1e-5}}).site
    assert site.gravity == pytest.approx(9.8321849378 - 100 * 3.086e-6, abs=3e-7)
    assert site.latitude == pytest.approx(-math.pi / 2)
    assert site.gravity_u == 1e-5


def test_unknown_site_has_standard_gravity_that_is_hardly_known(tmp_path: Path) -> None:
    site = read(tmp_path, {}).site
    assert (site.latitude, site.gravity, site.gravity_u) == (None, 9.80665, 0.03)


# the numbers below by hand: 1 g = 9.80665, pi/180 = 0.017453292519943295, pi/648000 = 4.84813681109536e-6
DT = 0.02
ACCEL_CASES: list[tuple[dict[str, Any], float, float]] = [
    ({"unit": "m/s^2"}, 9.81, 9.81),
    ({"unit": "g"}, 2.0, 19.6133),
    ({"unit": "mg"}, -500.0, -4.903325),
    ({"unit": "cm/s^2"}, 980.0, 9.8),
    ({"unit": "mm/s^2"}, -9800.0, -9.8),
    ({"unit": "m/s"}, 0.196, 9.8),
    ({"unit": "count", "scale": 415.0, "offset": 32768.0}, 36838.55, 9.808554216867478),
    ({"unit": "count", "scale": 4096.0, "scale_per": "g"}, 2048.0, 4.903325),
    ({"unit": "V", "scale": -0.25, "offset": 2.5}, 0.05, 9.8),
    ({"unit": "V", "scale": 2.0, "scale_per": "g", "offset": -1.0}, 3.0, 19.6133),
    ({"unit": "count", "scale": 1000.0, "scale_per": "m/s"}, 196.0, 9.8),
]
GYRO_CASES: list[tuple[dict[str, Any], float, float]] = [
    ({"unit": "rad/s"}, 0.5, 0.5),
    ({"unit": "deg/s"}, 90.0, 1.5707963267948966),
    ({"unit": "mdeg/s"}, 90_000.0, 1.5707963267948966),
    ({"unit": "0.1 deg/s"}, 900.0, 1.5707963267948966),
    ({"unit": "deg/h"}, 15.0, 7.27220521664304e-5),
    ({"unit": "rad"}, 0.001, 0.05),
    ({"unit": "deg"}, 0.9, 0.7853981633974483),
    ({"unit": "arcsec"}, 100.0, 0.0242406840554768),
    ({"unit": "count", "scale": 4770.0, "offset": 32768.0}, 37538.0, 1.0),
    ({"unit": "count", "scale": 131.0, "scale_per": "deg/s"}, 131.0, 0.017453292519943295),
    ({"unit": "V", "scale": 0.02, "scale_per": "deg/s", "offset": 1.35}, 1.55, 0.17453292519943295),
    ({"unit": "count", "scale": 2.0, "scale_per": "arcsec"}, -200.0, -0.0242406840554768),
    ({"unit": "count", "scale": 100.0, "scale_per": "deg"}, 90.0, 0.7853981633974483),
    ({"unit": "count", "scale": 1e6, "scale_per": "rad"}, 1000.0, 0.05),
]


@pytest.mark.parametrize(
    ("kind", "keys", "raw", "expected"),
    [("accel", *case) for case in ACCEL_CASES] + [("gyro", *case) for case in GYRO_CASES],
)
def test_unit_is_worth_the_number_computed_by_hand(
    kind: str, keys: dict[str, Any], raw: float, expected: float, tmp_path: Path
) -> None:
    log = read(tmp_path, {"log": {kind: keys}}).log
    channels = log.accel if kind == "accel" else log.gyro
    assert channels is not None
    assert channels.unit_name == keys["unit"]
    si = channels.to_si(np.full((2, 3), raw), np.array([DT, 2 * DT]))
    increment = keys.get("scale_per", keys["unit"]) in ("m/s", "rad", "deg", "arcsec")
    np.testing.assert_allclose(si[0], expected, rtol=1e-14)
    np.testing.assert_allclose(si[1], expected / 2 if increment else expected, rtol=1e-14)


def test_every_unit_is_among_the_numbers_computed_by_hand() -> None:
    cases = ((AccelTable, ACCEL_CASES), (GyroTable, GYRO_CASES))
    for table, computed in cases:
        assert {keys["unit"] for keys, _, _ in computed} == set(table.UNITS)
        raw = [keys for keys, _, _ in computed if "scale" in keys]
        assert {keys.get("scale_per", table.SCALE_PER[0]) for keys in raw} == set(table.SCALE_PER)


def test_negative_scale_is_the_polarity_of_its_channel(tmp_path: Path) -> None:
    keys = accel(unit="count", scale=[100.0, -100.0, 200.0], offset=[0.0, 10.0, 20.0])
    si = read(tmp_path, keys).log.accel.to_si(np.array([[100.0, 110.0, 220.0]]), np.array([DT]))
    assert si.tolist() == [[1.0, -1.0, 1.0]]


@given(arrays(float, (4, 3), elements=st.floats(allow_nan=False, allow_infinity=False)))
def test_si_numbers_are_kept_to_the_bit(raw: np.ndarray[Any, np.dtype[np.float64]]) -> None:
    channels = AccelTable(**BASE["log"]["accel"]).si(None)
    assert channels.to_si(raw, np.full(4, DT)).tobytes() == raw.tobytes()


def test_range_is_the_smallest_full_scale_in_si(tmp_path: Path) -> None:
    log = read(tmp_path, {"log": {"accel": {"unit": "g", "range": 10.0}, "gyro": {"unit": "deg/s", "range": 180}}}).log
    assert log.gyro is not None
    assert log.accel.range == pytest.approx(98.0665, rel=1e-15)
    assert log.gyro.range == pytest.approx(math.pi, rel=1e-15)
    raw = accel(unit="count", scale=[100.0, -200.0, 100.0], offset=32768.0, range=32000.0)
    assert read(tmp_path, raw).log.accel.range == 160.0
    pulses = {"time": GONE, "rate_hz": 50.0, "accel": {"unit": "m/s", "range": 2.0}}
    assert read(tmp_path, {"log": pulses}).log.accel.range == 100.0
    assert read(tmp_path, {}).log.accel.range is None


def test_default_axes_are_the_body_axes(tmp_path: Path) -> None:
    session = read(tmp_path, {})
    assert session.gyro_block is not None
    assert session.accel_block.names[-3:] == ("accel.axis.yx", "accel.axis.zx", "accel.axis.zy")
    assert session.gyro_block.triad
    assert np.array_equal(session.accel_block.axes, np.eye(3))


def test_redundant_block_has_axes_of_exactly_unit_length(tmp_path: Path) -> None:
    axes = [*CUBE, [0.5773503, 0.5773503, 0.5773502]]
    block = read(tmp_path, accel(columns=FOUR, axes=axes)).accel_block
    assert block.size == 4
    assert not block.triad
    np.testing.assert_allclose(np.linalg.norm(block.axes, axis=1), 1.0, rtol=0, atol=1e-15)
    assert np.array_equal(block.axes[:3], np.eye(3))


def test_session_without_gyros_has_no_gyro_block(tmp_path: Path) -> None:
    session = read(tmp_path, {"log": {"gyro": GONE}})
    assert session.gyro_block is None
    assert session.log.columns == ("t", "ax", "ay", "az")


def test_time_unit_is_worth_seconds(tmp_path: Path) -> None:
    for unit, factor in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)):
        assert read(tmp_path, {"log": {"time_unit": unit}}).log.time_factor == factor


def test_positions_are_read_in_order(tmp_path: Path) -> None:
    spec = read(
        tmp_path, positions({"attitude": "NUE"}, {"attitude": "NUE N+45", "start": 120, "stop": 180.0})
    ).programme
    assert spec is not None
    assert spec.name is None
    assert [(p.attitude, p.start, p.stop) for p in spec.position or ()] == [
        ("NUE", None, None),
        ("NUE N+45", 120.0, 180.0),
    ]


def test_passport_is_found_beside_the_session(tmp_path: Path) -> None:
    (tmp_path / "passport.json").touch()
    session = read(tmp_path, {"device": {"systematic": "passport.json", "model": "BCHE-501"}})
    assert session.device.systematic == tmp_path / "passport.json"
    assert session.device.model == "BCHE-501"


# -------------------- writing --------------------


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    content = changed(BASE, {"site": {"latitude_deg": 1 / 3}, "programme": {"name": "cube-14"}})
    before = deepcopy(content)
    write_session(tmp_path / "new" / "folder", content)
    assert content == before
    assert tomllib.loads((tmp_path / "new" / "folder" / "session.toml").read_text()) == content
    (tmp_path / "new" / "folder" / "log.csv").touch()
    assert read_session(tmp_path / "new" / "folder").site.latitude == pytest.approx(math.pi / 540)


def test_what_could_not_be_read_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match=r"session\.toml: site\.latitude_deg: expected .* found 91"):
        write_session(tmp_path / "new", changed(BASE, {"site": {"latitude_deg": 91}}))
    assert not (tmp_path / "new").exists()


def test_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(SessionError, match="expected a folder to write to"):
        write_session(tmp_path / "file", BASE)


# -------------------- the documentation --------------------


def documented_examples() -> list[str]:
    return re.findall(r"```toml\n(format.*?)```", DOCUMENT.read_text(encoding="utf-8"), flags=re.DOTALL)


def test_every_key_is_documented() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    tables: dict[str, type[BaseModel]] = {"": SessionDocument}
    waiting: list[type[BaseModel]] = [SessionDocument]
    while waiting:
        inner = {key: table_behind(field.annotation) for key, field in waiting.pop().model_fields.items()}
        tables |= {key: table for key, table in inner.items() if table is not None}
        waiting += [table for table in inner.values() if table is not None]
    keys = [(table, key) for table, model in tables.items() for key in model.model_fields]
    assert len(keys) > 30
    # every key has its own entry: a table in brackets, another key at the start of a row
    missing = [
        f"{table}.{key}"
        for table, key in keys
        if not re.search(rf"^\| `{key}`|\[{key}\]|\.{key}\]", text, flags=re.MULTILINE)
    ]
    assert not missing


def test_every_unit_and_programme_is_documented() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    names = [*AccelTable.UNITS, *GyroTable.UNITS, *TIME_UNITS]
    for name in [*names, *BUILT_IN]:
        assert f"`{name}`" in text, name


def test_documented_examples_are_enough_to_be_read() -> None:
    assert len(documented_examples()) >= 4


@pytest.mark.parametrize("number", range(len(documented_examples())))
def test_documented_example_reads(number: int, tmp_path: Path) -> None:
    text = documented_examples()[number]
    (tmp_path / "session.toml").write_text(text, encoding="utf-8")
    files = tomllib.loads(text)["log"]["file"]
    for file in [files] if isinstance(files, str) else files:
        (tmp_path / file).touch()
    (tmp_path / "passport.json").touch()
    assert read_session(tmp_path).log.files


# -------------------- recordings --------------------


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "unit", "programme"),
    [
        ("xsens-mti", "count", None),
        ("truth-turntable", "m/s^2", "rough-table"),
        ("truth-handheld", "m/s^2", None),
    ],
)
def test_session_of_the_recordings_reads(data: Path, name: str, unit: str, programme: str | None) -> None:
    session = read_session(data / name)
    assert session.log.accel.unit_name == unit
    assert (session.programme.name if session.programme else None) == programme
    assert session.site.latitude is not None


@pytest.mark.parametrize("value", ["9" * 5000, "[" * 1000 + "]" * 1000], ids=["5,000 digits", "1,000 brackets"])
def test_a_value_without_measure_is_refused_in_one_line(value: str, tmp_path: Path) -> None:
    (tmp_path / "session.toml").write_text(f"format = {value}\n")
    with pytest.raises(SessionError, match="expected TOML, found") as caught:
        read_session(tmp_path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 300 + len(str(tmp_path))
