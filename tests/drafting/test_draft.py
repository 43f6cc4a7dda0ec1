"""A first session.toml: what is guessed is right, and what is not known is said."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner, Result

from tests.support.moving import Motion, record
from tumble.cli import main
from tumble.planning.setup import Setup
from tumble.recording.session import USUAL_CLOCK_U, USUAL_RATE_U, Session
from tumble.recording.session_file import read_session
from tumble.recording.text.text_log import TextLog
from tumble.run.calibrate import calibrate
from tumble.run.observed import inspect_session
from tumble.simulation.session import simulate_session
from tumble.units import ACCEL_UNITS, DEGREE, G_STANDARD, GYRO_UNITS


def named(*stems: str, unit: str = "") -> list[str]:
    return [f"{stem}{axis}{unit}" for stem in stems for axis in "xyz"]


# -------------------- logs --------------------


@pytest.fixture(scope="module")
def handheld(tmp_path_factory: pytest.TempPathFactory) -> pl.DataFrame:
    """A recording by hand in SI, columns t, ax … gz."""
    folder = tmp_path_factory.mktemp("draft") / "s"
    simulate_session(folder, Setup.of(grade="mems", positions=12, rest=3.0), seed=3)
    return pl.read_parquet(folder / "log.parquet")


def new(*words: str | Path) -> Result:
    return CliRunner().invoke(main, ["new", *map(str, words)])


def drafted(log: pl.DataFrame, folder: Path, *words: str) -> tuple[Session, str]:
    log.write_parquet(folder / "in.parquet")
    result = new(folder / "session", "--log", folder / "in.parquet", *words)
    assert result.exit_code == 0, result.stderr
    return read_session(folder / "session"), result.stderr


def scaled(log: pl.DataFrame, accel: float, gyro: float) -> pl.DataFrame:
    return log.with_columns(pl.col("ax", "ay", "az") * accel, pl.col("gx", "gy", "gz") * gyro)


@pytest.mark.parametrize(
    ("accel", "gyro"),
    [
        ("m/s^2", "rad/s"),
        ("g", "deg/s"),
        ("mg", "deg/h"),
        ("m/s", "rad"),
        ("m/s", "deg"),
        ("m/s^2", "arcsec"),
    ],
)
def test_units_are_found_from_gravity_and_from_the_vertical_the_gyros_carry(
    accel: str, gyro: str, handheld: pl.DataFrame, tmp_path: Path
) -> None:
    interval = 0.01
    per = {"rate": 1.0, "increment": interval, "raw": 1.0}
    a, g = ACCEL_UNITS[accel], GYRO_UNITS[gyro]
    log = scaled(handheld, per[a.kind] / a.factor, per[g.kind] / g.factor)
    session, said = drafted(log, tmp_path)
    assert session.log.accel.unit_name == accel
    assert session.log.gyro is not None
    assert session.log.gyro.unit_name == gyro
    assert f"in {accel} " in said
    assert "look at this" not in said


@pytest.mark.parametrize(("unit", "size"), [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9)])
def test_the_unit_of_the_time_is_found_from_its_steps(
    unit: str, size: float, handheld: pl.DataFrame, tmp_path: Path
) -> None:
    session, said = drafted(handheld.with_columns(pl.col("t") / size), tmp_path)
    assert session.log.time_factor == size
    assert f"in {unit} (by its steps), 100 samples per second" in said


def test_a_log_is_parsed_once_whatever_is_tried(
    handheld: pl.DataFrame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scaled(handheld, 1.0 / G_STANDARD, 1.0 / DEGREE).write_csv(tmp_path / "log.csv", separator=";")
    parsed: list[int] = []
    pieces = TextLog.pieces

    def counted(log: TextLog) -> Iterator[bytes]:
        for piece in pieces(log):
            parsed.append(len(piece))
            yield piece

    monkeypatch.setattr(TextLog, "pieces", counted)
    result = new(tmp_path / "session", "--log", tmp_path / "log.csv")
    assert result.exit_code == 0, result.stderr
    assert 0 < sum(parsed) <= (tmp_path / "log.csv").stat().st_size


def test_a_log_in_counts_gets_the_scales_of_data_sheets_from_its_rests_and_turns(
    handheld: pl.DataFrame, tmp_path: Path
) -> None:
    log = handheld.with_columns(pl.col("ax", "ay", "az") * 415.0 + 32768.0, pl.col("gx", "gy", "gz") * 4770.0 + 32000.0)
    session, said = drafted(log, tmp_path)
    assert (session.log.accel.unit_name, session.log.gyro and session.log.gyro.unit_name) == ("count", "count")
    np.testing.assert_array_equal(session.log.accel.scale, 4096.0)  # per g; 415 per m/s² are 4070
    np.testing.assert_array_equal(session.log.accel.offset, 32768.0)
    assert session.log.gyro is not None
    np.testing.assert_allclose(session.log.gyro.scale, 4770.0 * DEGREE, rtol=0.02)
    np.testing.assert_allclose(session.log.gyro.offset, 32000.0, atol=0.05 * 4770.0)  # the bias
    assert "4096 counts per g as in data sheets" in said
    assert "no data sheet has a value near it" in said
    assert "look at this" not in said


@pytest.mark.parametrize("motion", [Motion(), Motion(sway=0.05, frequency=0.6, rests=4)], ids=["pivot", "hand"])
def test_a_device_in_motion_shows_the_units_and_columns_of_its_gyros(motion: Motion, tmp_path: Path) -> None:
    """Between few or no rests the accelerometers read the vertical to within what moves the device."""
    made = record(motion, 3, rate=100.0)
    names, readings = named("a", "g"), np.hstack([made.accel, made.gyro])
    log = pl.DataFrame(readings, schema=names).with_row_index("t").with_columns(pl.col("t") / made.rate)
    counts = scaled(log, 4096.0 / G_STANDARD, 65.5 / DEGREE).with_columns(pl.col(names).round().cast(pl.Int64))
    exchanged = log.rename({"gx": "gy", "gy": "gx"}).select("t", *names)
    for folder in ("counts", "rad", "deg", "exchanged"):
        (tmp_path / folder).mkdir()
    session, said = drafted(counts, tmp_path / "counts")
    assert session.log.gyro is not None
    np.testing.assert_array_equal(session.log.gyro.scale, 65.5)
    assert not session.log.doubts
    for unit, per in (("rad/s", 1.0), ("deg/s", 1.0 / DEGREE)):
        session, said = drafted(scaled(log, 1.0, per), tmp_path / unit[:3])
        assert session.log.gyro is not None
        assert session.log.gyro.unit_name == unit
        assert not session.log.doubts
        assert "look at this" not in said
    assert "only where the gyro columns x and y are exchanged" in drafted(exchanged, tmp_path / "exchanged")[1]


def test_the_doubt_about_a_unit_ends_where_the_recording_determines_the_scale(tmp_path: Path) -> None:
    """A hand moves too much to show the vertical, but the calibration determines the scale to 0.01 %."""
    made = record(Motion(sway=0.1, frequency=1.5, lever=(0.0, 0.0, 0.0)), 3, rate=100.0)
    readings = np.hstack([made.accel / G_STANDARD, made.gyro / DEGREE])
    log = pl.DataFrame(readings, schema=named("a", "g")).with_row_index("t").with_columns(pl.col("t") / made.rate)
    session, _ = drafted(log, tmp_path, "--latitude", "55", "--height", "100")
    assert session.log.gyro is not None
    assert session.log.gyro.doubt.startswith("gyros in deg/s by a guess, rad/s would fit too")
    calibration = calibrate(session)
    assert calibration.outcome.verdict == "accepted"
    assert calibration.provenance.doubts == ()


def test_counts_of_gyros_without_turns_get_no_scale_and_the_user_is_told(
    handheld: pl.DataFrame, tmp_path: Path
) -> None:
    still = handheld.head(300).with_columns(pl.col("ax", "ay", "az") * 1670.0, pl.col("gx", "gy", "gz") * 939.0)
    session, said = drafted(still, tmp_path)
    assert session.log.gyro is not None
    assert not session.log.gyro.scale_stated  # and no number that stands for it
    assert session.log.doubt.startswith(
        "no turn determines the scale of the gyros' counts: the accelerometers alone are"
    )
    assert "the scale is unknown, for no turns show it: put that of the data sheet there" in said
    assert "a guess from too few rests" in said


@pytest.mark.parametrize("size", [0.68, 2.0])
def test_gravity_in_no_unit_that_rests_in_several_attitudes_show_can_be_calibrated(
    size: float, handheld: pl.DataFrame, tmp_path: Path
) -> None:
    """`new` said that it cannot be, and `calibrate` accepted it."""
    log = handheld.with_columns(pl.col("ax", "ay", "az") * (size / G_STANDARD))
    session, said = drafted(log, tmp_path)
    assert session.log.accel.unit_name == "count"
    assert session.log.accel.scale == pytest.approx(np.full(3, size), rel=0.05)
    assert "rests in several attitudes read" in session.log.doubt
    assert "cannot be calibrated" not in said + session.log.doubt


@pytest.mark.parametrize(("rate", "stated"), [(104.0, 104.0), (62.5, 62.5), (50.0, 50.0)])
def test_the_rate_of_a_log_without_times_is_found_from_its_turns_and_said_to_be_a_guess(
    rate: float, stated: float, handheld: pl.DataFrame, tmp_path: Path
) -> None:
    turned = handheld.with_columns(pl.col("gx", "gy", "gz") * (rate / 100.0))  # the same turns at another rate
    names = {f"g{a}": f"g{a} [rad/s]" for a in "xyz"}
    session, said = drafted(turned.drop("t").rename(names), tmp_path)
    assert session.log.rate == stated
    assert "rate_hz = 100 is a guess" in said
    assert "a guess to some percent" in said


def test_what_the_user_knows_is_written_down(handheld: pl.DataFrame, tmp_path: Path) -> None:
    known = "--serial", "A-7", "--latitude", "56.84", "--sample-rate", "100"
    session, said = drafted(handheld.drop("t"), tmp_path, *known)
    assert (session.device.serial, session.log.rate, session.log.time) == ("A-7", 100.0, None)
    assert session.site.latitude == pytest.approx(56.84 * DEGREE)
    assert "fill in" not in said


@pytest.mark.parametrize(
    ("made", "rate", "shown"),
    [(100.0, "100", True), (104.17, "104", True), (100.0, "100.4", False), (104.17, "104.0001", False)],
)
def test_a_rate_that_the_times_show_is_known_as_they_are(
    made: float, rate: str, shown: bool, handheld: pl.DataFrame, tmp_path: Path
) -> None:
    """Times in whole milliseconds; the rate that is stated is the one that they show, rounded, or another one."""
    stamps = (pl.col("t") * (1e3 * 100.0 / made)).round().cast(pl.Int64).alias("time_ms")
    log = handheld.select(stamps, pl.all().exclude("t"))
    session, said = drafted(log, tmp_path, "--sample-rate", rate)
    found = (session.log.time, session.log.rate, session.log.time_base_u)
    assert found == (("time_ms", None, USUAL_CLOCK_U) if shown else (None, float(rate), USUAL_RATE_U))
    assert ("time: the column shows the rate given, " in said) == shown
    assert ("column 'time_ms' is not used, since the rate was given" in said) == (not shown)
    assert "leave --sample-rate out" not in said


@pytest.mark.parametrize("column", ["gx", "gy", "gz"])
def test_one_gyro_in_another_unit_than_the_others_is_named(column: str, handheld: pl.DataFrame, tmp_path: Path) -> None:
    """A common scale by the turns of all three would be neither unit."""
    session, _ = drafted(handheld.with_columns(pl.col(column) / DEGREE), tmp_path)
    (said,) = inspect_session(session).faults
    factor = re.search(rf"column {column!r} reads about ([\d.]+) times what it should, as in another unit", said)
    assert factor is not None, said
    assert float(factor[1]) == pytest.approx(1.0 / DEGREE, rel=0.1)


def test_names_of_accelerometers_and_gyros_that_are_exchanged_are_refused(
    handheld: pl.DataFrame, tmp_path: Path
) -> None:
    other = dict(zip(named("a", "g"), named("g", "a"), strict=True))
    handheld.rename(other).write_parquet(tmp_path / "in.parquet")
    result = new(tmp_path / "session", "--log", tmp_path / "in.parquet")
    assert result.exit_code != 0
    assert "their names are exchanged; state --accel gx,gy,gz --gyro ax,ay,az" in result.stderr


def test_a_log_without_times_or_gyros_is_drafted_and_says_so(handheld: pl.DataFrame, tmp_path: Path) -> None:
    session, said = drafted(handheld.select("ax", "ay", "az"), tmp_path, "--programme", "cube-14")
    assert session.log.gyro is None
    assert session.log.rate == 100.0
    assert session.programme is not None
    assert session.programme.name == "cube-14"
    assert "rate_hz = 100 is a guess" in said
    assert "the accelerometers alone" in said


def test_turns_whose_middle_is_lost_are_no_jumps_from_position_to_position(tmp_path: Path) -> None:
    """Each is left out by itself, and those around it are used."""
    setup = Setup.of(grade="mems", positions=14, rest=5.0, sample_rate=50.0, rate_deg_s=30.0)
    log = pl.read_parquet(simulate_session(tmp_path / "s", setup, seed=3) / "log.parquet")
    rests = inspect_session(tmp_path / "s").segmentation.rests
    for before, behind in list(pairwise(rests))[:10]:
        log = log.filter((pl.col("t") - 0.5 * (before.stop + behind.start)).abs() > 0.2)
    session, said = drafted(log, tmp_path)
    assert len(session.log.files) == 1
    assert "a file each" not in said


def test_magnetometers_are_offered_as_a_comment_that_works(handheld: pl.DataFrame, tmp_path: Path) -> None:
    field = np.random.default_rng(1).normal([30.0, 5.0, -40.0], 0.1, (handheld.height, 3))
    log = handheld.with_columns(mag_x=field[:, 0], mag_y=field[:, 1], mag_z=field[:, 2])
    session, said = drafted(log, tmp_path)
    assert "magnetometers: mag_x, mag_y, mag_z in uT" in said
    assert session.log.magnetometer is None
    path = tmp_path / "session" / "session.toml"
    text = path.read_text()
    path.write_text(text.replace("# [log.mag", "[log.mag").replace("# columns", "columns").replace("# unit", "unit"))
    found = read_session(tmp_path / "session").log.magnetometer
    assert found is not None
    assert found.columns == ("mag_x", "mag_y", "mag_z")


@pytest.mark.parametrize(
    ("name", "value", "found", "said"),
    [
        ("T", 21.0, {"columns": ["T"], "unit": "degC"}, "temperature: T in degC (by its numbers)"),
        ("T", 294.0, {"columns": ["T"], "unit": "K"}, "temperature: T in K (by its numbers)"),
        ("temp_f", 70.0, {"columns": ["temp_f"], "unit": "degF"}, "temperature: temp_f in degF (from the name)"),
        (
            "T",
            -5200.0,
            None,
            "temperature: T, about -5200, is left out, for it is in no unit that is known",
        ),
    ],
)
def test_the_unit_of_a_thermometer_is_found_or_asked_for(
    handheld: pl.DataFrame, tmp_path: Path, name: str, value: float, found: dict[str, Any] | None, said: str
) -> None:
    session, printed = drafted(handheld.with_columns(pl.lit(value).alias(name)), tmp_path)
    thermometer = session.log.temperature
    assert (thermometer is None) == (found is None)
    if thermometer is not None:
        assert {"columns": list(thermometer.columns), "unit": thermometer.unit_name} == found
    assert said in printed


def test_a_drafted_session_calibrates_once_its_place_is_filled_in(handheld: pl.DataFrame, tmp_path: Path) -> None:
    drafted(handheld, tmp_path)
    path = tmp_path / "session" / "session.toml"
    path.write_text(path.read_text().replace("# latitude_deg = 0.0", "latitude_deg = 56.84"))
    result = CliRunner().invoke(main, ["calibrate", str(tmp_path / "session")])
    assert result.exit_code == 0, result.output


def test_a_recording_of_another_format_becomes_a_log_of_the_session(handheld: pl.DataFrame, tmp_path: Path) -> None:
    from scipy.io import savemat

    log = {name: handheld[name].to_numpy() for name in handheld.columns}
    savemat(tmp_path / "r.mat", {"imu": {"time_s": log.pop("t"), **log}})
    result = new(tmp_path / "session", "--log", tmp_path / "r.mat")
    assert result.exit_code == 0, result.stderr
    session = read_session(tmp_path / "session")
    assert session.log.files == (tmp_path / "session" / "log.parquet",)
    read = pl.read_parquet(session.log.files[0])
    np.testing.assert_array_equal(read["imu/gz"].to_numpy(), handheld["gz"].to_numpy())


def test_what_cannot_be_drafted_is_refused_in_one_line(handheld: pl.DataFrame, tmp_path: Path) -> None:
    drafted(handheld, tmp_path)
    log = tmp_path / "in.parquet"
    pl.DataFrame({"depth": [1.0, 2.0]}).write_parquet(tmp_path / "other.parquet")
    (tmp_path / "semicolons.csv").write_text("t;ax;ay;az\n0;0;0;9.8\n")
    (tmp_path / "rowless.csv").write_text("t,ax,ay,az\n")
    (tmp_path / "wide.csv").write_text("t,ax,ay,az\n" + "9" * 200_000)
    (tmp_path / "cr.csv").write_text("t,a\rx,ay,az\n1,2,x,3\n")
    (tmp_path / "damaged.ulg").write_bytes(b"\xfe\x01c" * 1000)  # text would be read as such
    for words, said in [
        ((tmp_path / "session", "--log", log), "expected a folder without a session"),
        ((tmp_path / "n", "--log", tmp_path / "none.csv"), "expected a log, found no such file"),
        ((tmp_path / "n", "--log", log, "--programme", "wobble"), "--programme: expected one of"),
        ((tmp_path / "n", "--log", tmp_path / "other.parquet"), "expected columns named as accelerometers are"),
        ((tmp_path / "n", "--log", tmp_path / "semicolons.csv"), "expected rows of readings below the names"),
        ((tmp_path / "n", tmp_path / "wide.csv"), "found something else"),
        ((tmp_path / "n", tmp_path / "cr.csv"), "expected"),
        ((tmp_path / "n", tmp_path / "none*.csv"), "expected files that fit this pattern, found none"),
        ((tmp_path / "n", log, "--latitude", "95"), "--latitude: expected a number from -90 to 90, found 95"),
        (
            (tmp_path / "n", log, "--sample-rate", "-1"),
            "--sample-rate: expected a number from 1e-6 to 1e9 (Hz), found -1",
        ),
        (
            (tmp_path / "n", log, "--sample-rate", "1e-320"),
            "--sample-rate: expected a number from 1e-6 to 1e9 (Hz), fo",
        ),
        ((tmp_path / "n", "--log", tmp_path / "rowless.csv"), "expected rows of readings below the names"),
        ((tmp_path / "n", "--log", tmp_path / "damaged.ulg"), "damaged or incomplete"),
    ]:
        result = new(*words)
        assert result.exit_code == 2
        assert said in result.stderr
        assert result.stderr.count("\n") == 1
        assert not (tmp_path / "n").exists()
