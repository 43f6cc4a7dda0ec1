"""A session in memory is a session like any other: the same numbers, the same refusals, no file anywhere."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from tests.support.shared import session
from tumble.errors import InputError
from tumble.planning.setup import Setup
from tumble.recording.arrays import session_of_arrays
from tumble.recording.log import Chunk, Log, open_log
from tumble.recording.session import Session
from tumble.recording.session_file import description_of, read_session, session_of
from tumble.run.calibrate import calibrate
from tumble.run.observed import inspect_session
from tumble.run.quiet_samples import longest_rest
from tumble.units import ARCSEC, DEGREE, G_STANDARD, ZERO_CELSIUS, Array
from tumble.use.apply import apply_to_session

REQUEST = Setup.of(grade="mems", positions=12, rest=3.0)


@pytest.fixture(scope="module")
def folder() -> Path:
    return session(REQUEST, seed=4)


@pytest.fixture(scope="module")
def on_disk(folder: Path) -> Session:
    return read_session(folder)


@pytest.fixture(scope="module")
def columns(folder: Path) -> dict[str, Array]:
    return {c.name: c.to_numpy() for c in pl.read_parquet(folder / "log.parquet")}


def described(session: Session) -> dict[str, Any]:
    """The description of a session on disk, less its files."""
    content = description_of(session)
    return content | {"log": {key: value for key, value in content["log"].items() if key != "file"}}


class OtherFrame:
    """A frame of another library: columns by name, as pandas has them."""

    def __init__(self, columns: Mapping[str, Array]) -> None:
        self._columns = columns
        self.columns = list(columns)

    def __getitem__(self, name: str) -> Array:
        return self._columns[name]

    def __array__(self, dtype: Any = None, copy: Any = None) -> Array:
        return np.array(np.column_stack(list(self._columns.values())), dtype=dtype, copy=copy or True)


@pytest.mark.parametrize("kind", [dict, pl.DataFrame, OtherFrame])
def test_arrays_and_frames_give_the_calibration_of_the_folder(
    on_disk: Session, columns: dict[str, Array], kind: Callable[[dict[str, Array]], Any]
) -> None:
    in_memory = calibrate(session_of(described(on_disk), kind(columns)))
    expected = calibrate(on_disk)
    assert [p.value for p in in_memory.parameters] == [p.value for p in expected.parameters]
    assert in_memory.outcome == expected.outcome


def test_readings_in_si_give_the_calibration_of_the_folder(on_disk: Session, columns: dict[str, Array]) -> None:
    found = calibrate(
        accel=np.column_stack([columns[f"a{axis}"] for axis in "xyz"]),
        gyro=pl.DataFrame({f"g{axis}": columns[f"g{axis}"] for axis in "xyz"}),
        time=columns["t"],
        latitude=on_disk.site.latitude,
        gravity=on_disk.site.gravity,
        gravity_u=on_disk.site.gravity_u,
        serial="mems-4",
    )
    for p, expected in zip(found.parameters, calibrate(on_disk).parameters, strict=True):
        assert expected.u is not None
        assert abs(p.value - expected.value) < 1e-9 * expected.u


def test_a_description_says_what_the_session_says(on_disk: Session) -> None:
    again = session_of(description_of(on_disk))
    assert again.log.files == on_disk.log.files
    assert again.site.latitude == pytest.approx(on_disk.site.latitude)
    assert replace(again.site, latitude=None) == replace(on_disk.site, latitude=None)
    assert again.log.columns == on_disk.log.columns


def test_a_description_keeps_what_is_left_out_and_the_priors(on_disk: Session) -> None:
    content = description_of(on_disk)
    content["device"] |= {"grade": "mems", "prior": {"accel_quadratic": "20 ug/g^2"}}
    content |= {"exclude": [{"rest": 2, "reason": "knocked"}]}
    again = session_of(content)
    assert description_of(again) == content
    assert [(left_out.rest, left_out.reason) for left_out in again.excluded] == [(2, "knocked")]


def test_several_tables_are_several_files(on_disk: Session, columns: dict[str, Array]) -> None:
    half = len(columns["t"]) // 2
    parts = [{n: v[:half] for n, v in columns.items()}, {n: v[half:] for n, v in columns.items()}]
    chunks = list(open_log(session_of(described(on_disk), parts)).chunks())
    assert sorted({chunk.file for chunk in chunks}) == [0, 1]
    assert sum(len(chunk.time) for chunk in chunks) == len(columns["t"])


def test_lost_samples_are_bridged_as_in_a_file(on_disk: Session, columns: dict[str, Array]) -> None:
    broken = columns | {"ax": columns["ax"].copy()}
    broken["ax"][100:103] = np.nan
    observed = inspect_session(session_of(described(on_disk), broken))
    (gap,) = observed.log.gaps
    assert (gap.row, gap.samples) == (101, 3)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"ax": None}, "samples: expected a column 'ax', found t, ay, az"),
        ({"t": lambda t: t[::-1]}, "samples: row 2, column 't': expected a time after"),
        ({"ay": lambda a: a[:-1]}, "samples: expected as many numbers in every column"),
        ({"gz": lambda g: g.astype(str)}, "samples: column 'gz': expected numbers, found the type String"),
        ({"gz": lambda g: g[:, None]}, "samples: column 'gz': expected an array of one dimension"),
    ],
)
def test_a_table_that_is_not_as_described_is_refused_in_one_line(
    on_disk: Session, columns: dict[str, Array], change: dict[str, Any], expected: str
) -> None:
    made: dict[str, Any] = dict(columns)
    for name, how in change.items():
        if how is None:
            del made[name]
        else:
            made[name] = how(columns[name])
    with pytest.raises(InputError, match=re.escape(expected)) as refused:
        list(open_log(session_of(described(on_disk), made)).chunks())
    assert "\n" not in str(refused.value)


def test_the_description_is_checked_as_session_toml_is(on_disk: Session, columns: dict[str, Array]) -> None:
    content = described(on_disk)
    content["site"]["latitude_deg"] = 145.5
    with pytest.raises(InputError, match=r"session: site.latitude_deg: expected a number from -90 to 90, found 145.5"):
        session_of(content, columns)
    with pytest.raises(InputError, match=r"session: log.file: expected none beside samples in memory"):
        session_of(description_of(on_disk), columns)
    with pytest.raises(InputError, match="samples: expected columns by name"):
        session_of(content, 42)


def test_the_hash_is_that_of_the_columns_that_are_read(on_disk: Session, columns: dict[str, Array]) -> None:
    def digest(data: dict[str, Array]) -> str:
        return open_log(session_of(described(on_disk), data)).sha256()

    changed = columns["gz"].copy()
    changed[5] += ARCSEC
    assert digest(columns) == digest(columns | {"other": columns["t"]})
    assert digest(columns) != digest(columns | {"gz": changed})


def test_the_longest_rest_is_found_in_one_reading(on_disk: Session, columns: dict[str, Array]) -> None:
    read: list[str] = []

    def noted(log: Log) -> Iterable[Chunk]:
        read.append("log")
        return log.chunks()

    record = longest_rest(session_of(described(on_disk), columns), progress=noted)
    assert read == ["log"]
    rests = inspect_session(on_disk).segmentation.rests
    longest = max(rests, key=lambda rest: rest.stop - rest.start)
    inside = (columns["t"] > longest.start + 1e-9) & (columns["t"] <= longest.stop + 1e-9)
    np.testing.assert_array_equal(record.accel[:, 1], columns["ay"][inside])
    np.testing.assert_array_equal(record.gyro[:, 2], columns["gz"][inside])


STILL = np.tile([0.0, 0.0, G_STANDARD], (300, 1))


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"accel": STILL.T}, "accel: expected an array of shape (samples, sensors) with three sensors or more, found"),
        ({"accel": STILL[:0]}, "accel: expected an array of shape (samples, sensors)"),
        ({"temperature": []}, "temperature: expected 300 samples, as many as accel_x has, found 0"),
        ({"accel": STILL / G_STANDARD}, "accel: expected m/s^2, about 9.8 at rest, found 1 at the median"),
        ({"accel": [["a", "b", "c"]]}, "accel: expected an array of numbers"),
        ({"gyro": STILL[:-1]}, "gyro_x: expected 300 samples, as many as accel_x has, found 299"),
        ({"gyro": np.where(STILL > 0, np.nan, 0)}, "gyro: expected finite numbers, found nan in sample 0 of sensor 2"),
        ({"gyro": pl.DataFrame(STILL, schema=["gx_dps", "gy_dps", "gz_dps"])}, "a column 'gx_dps' in deg/s; multiply"),
        ({"accel": pl.DataFrame(STILL, schema=["ax [g]", "ay [g]", "az [g]"])}, "a column 'ax [g]' in g; multiply it"),
        ({"temperature": np.full(300, 23.5)}, "temperature: expected kelvin, found 23.5; add 273.15"),
        ({"latitude": 56.84}, "latitude: expected radians from -π/2 to π/2, found 56.84"),
        ({"rate": None}, "time, rate: expected one of them"),
        ({"time": np.arange(300.0)}, "time, rate: expected one of them"),
        ({"rate": "100"}, "rate: expected a number, found '100'"),
        ({"gravity": 1.0}, "site.gravity: expected a number from 9.7 to 9.9 (m/s^2, on Earth), found 1"),
        ({"programme": "nain"}, "programme.name: expected one of"),
    ],
)
def test_readings_that_are_not_as_expected_are_refused_in_one_line(given: dict[str, Any], expected: str) -> None:
    merged: dict[str, Any] = {"accel": STILL, "rate": 100.0} | given
    with pytest.raises(InputError, match=re.escape(expected)) as refused:
        session_of_arrays(**merged)
    assert "\n" not in str(refused.value)


def test_calibrate_says_what_it_takes() -> None:
    with pytest.raises(InputError, match="calibrate: expected a session or readings accel=…, gyro=…, found nothing"):
        calibrate()
    with pytest.raises(InputError, match="session: expected Session or a path or None, found 42; see help"):
        calibrate(42)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="found accel beside a session"):
        calibrate("session", accel=STILL)


def test_gyros_alone_give_their_biases_as_by_the_command() -> None:
    """Three of them at rest; another number has no command either."""
    bias, rng = np.array([0.01, -0.02, 0.005]), np.random.default_rng(5)
    rates = bias + 1e-3 * rng.standard_normal((6000, 3))
    made = calibrate(gyro=rates, rate=100.0, serial="G-1")
    assert (made.serial, made.accel, made.outcome.accepted) == ("G-1", None, True)
    assert all(abs(made[f"gyro.bias.{x}"].value - b) < 1e-4 for x, b in zip("xyz", bias, strict=True))
    assert {"gyro.scale.x", "gyro.axis.zy"} <= set(made.outcome.unobservable)
    with pytest.raises(InputError, match="gyro: expected three without accelerometers, found 4"):
        calibrate(gyro=np.hstack([rates, rates[:, :1]]), gyro_axes=np.eye(3)[[0, 1, 2, 0]], rate=100.0)


# -------------------- temperature --------------------


def test_temperature_is_celsius_in_the_calibration_and_kelvin_inside(
    on_disk: Session, columns: dict[str, Array], tmp_path: Path
) -> None:
    content = described(on_disk)
    content["log"]["temperature"] = {"columns": ["T"], "unit": "degC"}
    session = session_of(content, columns | {"T": np.full(len(columns["t"]), 23.5)})
    observations = inspect_session(session).observations
    assert observations is not None
    assert observations.rests.temperature == pytest.approx(23.5 + ZERO_CELSIUS)
    calibration = calibrate(session, terms="linear")
    assert [rest.temperature for rest in calibration.evidence.rests] == pytest.approx(
        [23.5] * len(calibration.evidence.rests)
    )
    calibration.write(tmp_path / "calibration.json")
    assert '"temperature": 23.5' in (tmp_path / "calibration.json").read_text()


# -------------------- what apply writes can be read again --------------------


NAMES = {
    "m/s^2": {"ax": "ax", "ay": "ay", "az": "az", "gx": "gx", "gy": "gy", "gz": "gz"},
    "g": {"ax": "ax [g]", "ay": "ay [g]", "az": "az [g]", "gx": "gyro_x_dps", "gy": "gyro_y_dps", "gz": "gyro_z_dps"},
}


@pytest.mark.parametrize("named", [False, True])
@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_a_corrected_log_is_a_session_of_a_perfect_device(
    on_disk: Session, columns: dict[str, Array], tmp_path: Path, named: bool, ending: str
) -> None:
    """Columns whose names say g and dps stay in them; others become SI. Either way what is left of the parameters is
    far below their uncertainty."""
    content = described(on_disk)
    data = {"t": columns["t"]}
    for kind, unit, factor in (("accel", "g", G_STANDARD), ("gyro", "deg/s", DEGREE)):
        old = [f"{kind[0]}{axis}" for axis in "xyz"]
        new = [NAMES["g" if named else "m/s^2"][name] for name in old]
        content["log"][kind] = {"columns": new, "unit": unit}
        data |= {n: columns[o] / factor for o, n in zip(old, new, strict=True)}
    session = session_of(content, data)
    calibration = calibrate(session, terms="linear")
    description = apply_to_session(calibration, session, tmp_path / f"out.{ending}")
    assert description["log"]["accel"]["unit"] == ("g" if named else "m/s^2")
    assert description["log"]["gyro"]["unit"] == ("deg/s" if named else "rad/s")
    assert description["log"]["accel"]["columns"] == list(session.log.accel.columns)
    again = calibrate(session_of(description), terms="linear")
    assert again.outcome.accepted, again.outcome.reasons
    for p in again.parameters:
        assert p.u is not None
        assert abs(p.value) < 0.05 * p.u, p.name  # the integral of another session is over other points


def test_one_rest_with_gyros_far_off_has_an_outcome() -> None:
    rng = np.random.default_rng(3)
    accel = np.array([-0.5, 9.8, -5.0]) + 0.01 * rng.normal(size=(900, 3))
    gyro = np.array([-20.0, -5.0, 4.0]) + rng.normal(size=(900, 3))
    session = session_of_arrays(accel=accel, gyro=gyro, rate=100.0, latitude=0.9)
    assert any("the device lay in one attitude" in reason for reason in calibrate(session).outcome.reasons)
