"""Text logs in the dialects of the world: each through `tumble new` and `calibrate` without editing, to the result of
the clean file within its u."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from tests.support.corpus import dialects as d
from tests.support.corpus import doubtful as q
from tests.support.corpus import programs as p
from tests.support.corpus.dialects import Case
from tumble.cli import main
from tumble.drafting.columns import identify_log
from tumble.drafting.containers import files_of, unzipped
from tumble.drafting.new_session import new_session
from tumble.drafting.repairs import repair_log
from tumble.drafting.times import Stamps, times_of_column
from tumble.errors import InputError
from tumble.files import OutputFolder
from tumble.planning.setup import Setup
from tumble.recording.log import open_log
from tumble.recording.session import Channels
from tumble.recording.session_file import read_session
from tumble.result.calibration import Calibration, read_calibration
from tumble.run.calibrate import calibrate
from tumble.sensors.model import SensorModel
from tumble.simulation.session import simulate_session
from tumble.units import DEGREE, G_STANDARD, Array

LATITUDE = "56.84"
DEG = 1.0 / DEGREE
G = 1.0 / G_STANDARD
WORDS = ("--latitude", LATITUDE, "--serial", "mems-3")
PHYPHOX = ["Time (s)", *(f"Acceleration {a} (m/s^2)" for a in "xyz"), *(f"Gyroscope {a} (rad/s)" for a in "xyz")]
WIT = ["Time(s)", *(f"Acc{a}(g)" for a in "XYZ"), *(f"As{a}(deg/s)" for a in "XYZ")]
VEHICLE = [
    "Time [s]",
    *(f"{a} acceleration [g]" for a in ("Longitudinal", "Lateral", "Vertical")),
    *(f"{a} rate [deg/s]" for a in ("Roll", "Pitch", "Yaw")),
]
WIT_CN = ["时间(秒)", *(f"加速度{a}(g)" for a in "XYZ"), *(f"角速度{a}(°/s)" for a in "XYZ")]
VECTORNAV = ["TimeStartup [ns]", *(f"Accel{a} [m/s^2]" for a in "XYZ"), *(f"Gyro{a} [rad/s]" for a in "XYZ")]
SBG = [
    "Time since reset (us)",
    *(f"Accelerometer {a} (m.s^-2)" for a in "XYZ"),
    *(f"Gyroscope {a} (rad.s^-1)" for a in "XYZ"),
]
OPENAXES = ["TIMESTAMP", *(f"ACCELEROMETER_{a}" for a in "XYZ"), *(f"GYROSCOPE_{a}" for a in "XYZ")]
GERMAN = ["Zeit [s]", *(f"Beschleunigung {a} [m/s²]" for a in "XYZ"), *(f"Drehrate {a} [°/s]" for a in "XYZ")]
RUSSIAN = ["Время, с", *(f"Ускорение {a}, м/с^2" for a in "XYZ"), *(f"Угловая скорость {a}, град/с" for a in "XYZ")]
UKRAINIAN = [
    "Час (мс)",
    *(f"Прискорення по осі {a} (м/с^2)" for a in "XYZ"),
    *(f"Кутова швидкість по осі {a} (рад/с)" for a in "XYZ"),
]
CHINESE = ["时间(s)", *(f"加速度计{a}" for a in "XYZ"), *(f"陀螺仪{a}" for a in "XYZ")]
ST = ["Time [us]", *(f"A_{a} [mg]" for a in "XYZ"), *(f"G_{a} [mdps]" for a in "XYZ")]
MATLAB_MOBILE = ["Timestamp", *(f"accelerometer{a}" for a in "XYZ"), *(f"gyroscope{a}" for a in "XYZ")]
AVR = ["millis", *d.NAMES[1:]]
MPU = (16384.0 * G, 131.0 * DEG)
GOOD = "50 samples per second"

CASES: dict[str, Case] = {
    # how it is written
    "plain": Case(write=d.plain, said=(GOOD,)),
    "semicolons": Case(write=d.with_delimiter(";"), said=("semicolons",)),
    "tabs": Case(write=d.with_delimiter("\t", ".dat"), said=("tabs",)),
    "blanks": Case(write=d.with_delimiter("   ", ".asc"), said=("blanks",)),
    "bars": Case(write=d.with_delimiter("|", ""), said=("bars",)),
    "decimal comma, semicolons": Case(write=d.decimal_comma(";"), said=("decimal commas",)),
    "decimal comma, tabs": Case(write=d.decimal_comma("\t"), said=("decimal commas",)),
    "decimal comma, blanks": Case(write=d.decimal_comma("  "), said=("decimal commas",)),
    "comments": Case(write=d.named(d.NAMES, above="# device: imu\n# firmware 1.2\n"), said=("lines above",)),
    "names in a comment": Case(write=d.named(["# t", *d.NAMES[1:]], delimiter=" ", file="np.txt")),
    "a line of units": Case(
        write=d.named(["s", *["m/s²"] * 3, *["deg/s"] * 3], gyro=DEG, delimiter=";", above=";".join(d.NAMES) + "\n"),
        said=("semicolons", "gx [deg/s], gy [deg/s], gz [deg/s] in deg/s (from the name"),
        worth=(1.0, DEG),
    ),
    "names of sensors above those of axes": Case(
        write=d.named(["", *"xyzxyz"], above="time,Accelerometer,,,Gyroscope,,\n"), said=("Gyroscope x", GOOD)
    ),
    "names of sensors, axes and units": Case(
        write=d.named(
            ["[s]", *["[g]"] * 3, *["[°/s]"] * 3],
            accel=G,
            gyro=DEG,
            delimiter="\t",
            above="Time\tAccel\tAccel\tAccel\tGyro\tGyro\tGyro\n\tX\tY\tZ\tX\tY\tZ\n",
        ),
        said=("Gyro X [°/s]", "3 lines above", GOOD),
        worth=(G, DEG),
    ),
    "no names": Case(write=d.without_names, said=("columns without names", "by their numbers (a guess)")),
    "names end with a comma": Case(write=d.ends_with_comma("names"), said=(GOOD,)),
    "rows end with a comma": Case(write=d.ends_with_comma("rows"), said=(GOOD,)),
    "a table of R": Case(write=d.of_r, said=("blanks", GOOD)),
    "key=value": Case(
        write=d.printed("t={t} ax={a[0]:.7g} ay={a[1]:.7g} az={a[2]:.7g} gx={g[0]:.7g} gy={g[1]:.7g} gz={g[2]:.7g}"),
        said=("names before the numbers (t, ax, ay, az, gx, gy, gz): copied to putty.csv",),
    ),
    "key: value, units": Case(
        write=d.printed(
            "[{t}] accX: {a[0]:.7g} m/s^2, accY: {a[1]:.7g} m/s^2, accZ: {a[2]:.7g} m/s^2, "
            "gyroX: {g[0]:.7g} dps, gyroY: {g[1]:.7g} dps, gyroZ: {g[2]:.7g} dps",
            gyro=DEG,
        ),
        said=("names before the numbers (time, accX",),
        worth=(1.0, DEG),
    ),
    "key: three values": Case(
        write=d.printed(
            "t: {t}; acc: [{a[0]:.7g}, {a[1]:.7g}, {a[2]:.7g}]; gyro: [{g[0]:.7g}, {g[1]:.7g}, {g[2]:.7g}]"
        ),
        said=("names before the numbers (t, acc_x",),
    ),
    "utf-16": Case(write=d.named(d.NAMES, encoding="utf-16", delimiter="\t"), said=("utf-16",)),
    "latin-1": Case(
        write=d.named(GERMAN, gyro=DEG, encoding="latin-1", delimiter=";"),
        said=("latin-1",),
        worth=(1.0, DEG),
    ),
    "byte order mark": Case(write=d.named(d.NAMES, encoding="utf-8-sig"), said=(GOOD,)),
    "two thermometers": Case(
        write=d.with_thermometers,
        said=("temperature: accel_temp_C in degC (from the name), gyro_temp [C] in degC (from the name), ",),
    ),
    "compressed": Case(write=d.compressed, said=("semicolons",)),
    # who writes it
    "phyphox": Case(write=d.named(PHYPHOX), said=("m/s^2 (from the name", "rad/s (from the name")),
    "phone, a file a sensor": Case(write=d.phone, said=("one log at the times of the gyros",)),
    "MetaWear": Case(write=d.meta_wear, said=("one log at the times of the gyros",), worth=(1.0 / G_STANDARD, DEG)),
    "MATLAB Mobile": Case(write=d.named(MATLAB_MOBILE)),
    "WitMotion": Case(
        write=d.named(WIT, accel=G, gyro=DEG, delimiter="\t", file="wit.txt"),
        said=("in g (from",),
        worth=(G, DEG),
    ),
    "WitMotion, Chinese": Case(
        write=d.named(WIT_CN, accel=G, gyro=DEG),
        said=("in deg/s (from the name",),
        worth=(G, DEG),
    ),
    "VectorNav": Case(write=d.named(VECTORNAV, time=1e9), said=("in ns (by its name)",)),
    "VectorNav, sentences": Case(
        write=d.vectornav_sentences, words=("--sample-rate", "50"), said=("sentences $VNYMR",)
    ),
    "sentences of a board": Case(
        write=d.board_sentences, said=("sentences $IMU", "column '2' in ms"), worth=(1.0, DEG)
    ),
    "objects of JSON": Case(write=d.objects_of_json, said=("objects of JSON (ts, acc_x",)),
    "an array of JSON": Case(write=d.array_of_json, said=("objects of JSON (time, accel_x", GOOD)),
    "a row for each sensor": Case(write=d.row_for_each_sensor(",", True), said=("stream-ACC.csv and stream-GYRO.csv",)),
    "a row for each sensor, no names": Case(write=d.row_for_each_sensor(" ", False), said=("stream-ACC.csv and",)),
    "ArduPilot, text": Case(write=d.dataflash_as_text, said=("message IMU.0",)),
    "Betaflight": Case(
        write=d.betaflight,
        said=(
            "gyros: gyroADC[0], gyroADC[1], gyroADC[2] in deg/s (a guess): one deg/s reads",
            "2048 counts per g as in data sheets",
        ),
        worth=(2048.0 * G, DEG),
        within=2.0,
    ),
    "Shimmer": Case(write=d.shimmer, said=("in ms (by its name)", "in deg/s (from the name"), worth=(1.0, DEG)),
    "Sensor Logger, uncalibrated": Case(write=d.sensor_logger, said=("Metadata.csv has no rows of readings",)),
    "SBG, its logger": Case(write=d.sbg_logger, said=("in us (by its name)",)),
    "Xsens MT Manager": Case(write=d.xsens, said=("ticks of 0.0001 s", GOOD)),
    "Movella DOT": Case(
        write=d.movella_dot,
        said=("in us (by its steps)", "in deg/s (a guess): one deg/s reads"),
        worth=(1.0, DEG),
    ),
    "increments of angle": Case(
        write=d.named(["t", "dv_x", "dv_y", "dv_z", "dth_x", "dth_y", "dth_z"], accel=1.0 / d.RATE, gyro=1.0 / d.RATE),
        said=("m/s (", "in rad (a guess): one deg/s reads"),
    ),
    "SBG": Case(write=d.named(SBG, time=1e6), said=("in us (by its name)",)),
    "vehicle": Case(
        write=d.named(VEHICLE, accel=G, gyro=DEG), said=("Longitudinal acceleration", "Yaw rate", GOOD), worth=(G, DEG)
    ),
    "OpenAXES": Case(write=d.named(OPENAXES, gyro=DEG, time=1e3), said=("in ms",), worth=(1.0, DEG)),
    "Arduino, AVR": Case(
        write=d.raw(16384.0, 131.0, names=AVR),
        said=("16384 counts per g", "131", "counts per deg/s"),
        worth=(16384.0 * G, 131.0 * DEG),
    ),
    "Arduino monitor": Case(write=d.arduino, said=("3 lines above",)),
    "German": Case(
        write=d.named(GERMAN, gyro=DEG),
        said=("m/s^2 (from the name", "deg/s (from the name"),
        worth=(1.0, DEG),
    ),
    "Russian, cp1251": Case(
        write=d.named(RUSSIAN, gyro=DEG, delimiter=";", encoding="cp1251"),
        said=("cp1251",),
        worth=(1.0, DEG),
    ),
    "Ukrainian": Case(write=d.named(UKRAINIAN, time=1e3, delimiter=";"), said=("in ms (by its name)",)),
    "Chinese, gb18030": Case(write=d.named(CHINESE, encoding="gb18030"), said=("gb18030",)),
    # units and counts
    "mg and mdps": Case(
        write=d.named(ST, accel=1e3 * G, gyro=1e3 * DEG, time=1e6, digits=9),
        said=("in mdeg/s (from the name",),
        worth=(1e3 * G, 1e3 * DEG),
    ),
    "g and deg/s without a word": Case(
        write=d.named(d.NAMES, accel=G, gyro=DEG),
        said=("deg/s (a guess): one deg/s reads",),
        worth=(G, DEG),
    ),
    "counts of 2 g and 250 deg/s": Case(
        write=d.raw(16384.0, 131.0),
        said=("16384 counts", "131"),
        worth=(16384.0 * G, 131.0 * DEG),
    ),
    "counts of 8 g and 500 deg/s": Case(
        write=d.raw(4096.0, 65.5),
        said=("4096 counts", "65.5"),
        worth=(4096.0 * G, 65.5 * DEG),
    ),
    "counts of 16 g and 2000 deg/s": Case(
        write=d.raw(2048.0, 16.4),
        said=("2048 counts", "16.4"),
        within=2.0,
        worth=(2048.0 * G, 16.4 * DEG),
    ),
    "counts of 800 per g and 40 per deg/s": Case(
        write=d.raw(800.0, 40.0),
        said=("800 counts per g", "40 counts per deg/s"),
        within=2.0,
        worth=(800.0 * G, 40.0 * DEG),
    ),
    "counts of 70 mdps": Case(
        write=d.raw(1e3 / 0.732, 1e3 / 70.0),
        said=("1366", "14.28"),
        within=2.0,
        worth=(1e3 / 0.732 * G, 1e3 / 70.0 * DEG),
    ),
    "counts about 32768": Case(
        write=d.raw(8192.0, 114.286, offset=32768),
        said=("zero at 32768",),
        worth=(8192.0 * G, 114.286 * DEG),
        zero=32768.0,
    ),
    "16 bits read without their sign": Case(
        write=d.raw(8192.0, 65.5, unsigned=True),
        said=("65536 taken off",),
        worth=(8192.0 * G, 65.5 * DEG),
    ),
    "BNO055": Case(
        write=q.bno055,
        said=(
            "in cm/s^2 (a guess): one g reads 979.",
            "16 counts per deg/s as in data sheets",
        ),
        within=2.0,
        worth=(100.0, 16.0 * DEG),
    ),
    "cm/s^2 without a word": Case(
        write=q.scaled(100.0, DEG),
        said=("in cm/s^2 (a guess): one g reads", "in deg/s (a guess): one deg/s reads"),
        worth=(100.0, DEG),
    ),
    "mm/s^2 and mdeg/s without a word": Case(
        write=q.scaled(1e3, 1e3 * DEG),
        said=("in mm/s^2 (a guess): one g reads", "in mdeg/s (a guess): one deg/s reads"),
        worth=(1e3, 1e3 * DEG),
    ),
    "mdeg/s without a word": Case(
        write=q.scaled(1.0, 1e3 * DEG),
        said=("in mdeg/s (a guess): one deg/s reads",),
        worth=(1.0, 1e3 * DEG),
    ),
    # which column is what
    "columns as stated": Case(
        write=d.without_names,
        words=("--accel", "2,3,4", "--gyro", "5,6,7", "--time", "1"),
        said=("accel: 2, 3, 4, as stated", "gyro: 5, 6, 7, as stated", "time: 1, as stated", GOOD),
    ),
    "gyros, accelerometers and magnetometers, no names": Case(
        write=q.magnetometers_behind,
        said=(
            "accel: columns 5, 6, 7, by",
            "gyro: columns 2, 3, 4, by",
        ),
        worth=MPU,
    ),
    "the date's seconds, no names": Case(
        write=q.epoch_seconds,
        said=("accel: columns 2, 3, 4, by", "column '1' in s (by its dates)", "50.003 samples per second"),
        within=2.0,
        worth=(4096.0 * G, 65.5 * DEG),
    ),
    "a counter, pressure, volts and degrees, no names": Case(
        write=q.housekeeping,
        words=("--sample-rate", "50"),
        said=("accel: columns 8, 9, 10, by", "gyro: columns 5, 6, 7, by"),
        worth=(1.0, DEG),
    ),
    "two files whose names say nothing": Case(
        write=q.two_files_of_other_names,
        said=("accel: columns v1, v2, v3, by", "gyro: columns v4, v5, v6, by", "2 files"),
        within=3.0,
    ),
    # when
    "ISO 8601": Case(write=d.clock(d.iso), said=("times of day",)),
    "German dates": Case(write=d.clock(d.german_date, "Datum Zeit", ";"), said=("times of day",)),
    "a clock past midnight": Case(write=d.clock(d.of_day), said=("times of day",)),
    "micros": Case(write=d.named(["micros", *d.NAMES[1:]], time=1e6), said=("in us (by its name)",)),
    "no time, rate given": Case(
        write=d.blemished(list, time=False), words=("--sample-rate", "50"), said=("50 as given",)
    ),
    "no time, rate above": Case(write=d.rate_above, said=("rate_hz = 50, from the line",)),
    "micros() that start anew": Case(write=d.counter_of(32, 1e-6, "micros"), said=("starts anew at 4294967296",)),
    "millis() of 16 bits": Case(write=d.counter_of(16, 1e-3, "ms"), said=("starts anew at 65536",)),
    "matrix of MATLAB": Case(write=d.matrix, said=(GOOD,)),
    "matrices of MATLAB, no time": Case(
        write=d.matrix_without_time,
        said=("rate_hz = 100 is a guess", "rate_hz = 50 from the turns"),
        worth=(1.0, DEG),
    ),
    "imu_tk, two files": Case(
        write=d.imu_tk,
        said=("imu_acc.mat and imu_gyro.mat: one log", "zero at 32768", "4096 counts per g", "131 counts per deg/s"),
        worth=(4096.0 * G, 131.0 * DEG),
        zero=32768.0,
    ),
    "topics of ROS in one table": Case(
        write=d.merged_topics,
        said=("as rows of others: left out", "seconds and nanoseconds", GOOD),
        worth=(1.0, DEG),
    ),
    # programs of others
    "quaternions, magnetometers, a thermometer, no names": Case(
        write=p.everything_without_names,
        said=("accel: columns 9, 10, 11, by", "gyro: columns 13, 14, 15, by", "in deg/s (a guess): one deg/s reads"),
        worth=(G, DEG),
    ),
    "ticks of 25 us": Case(
        write=p.ticks(4e4),
        said=(
            "column 'tick' counts samples or ticks",
            "rate_hz = 50 from the turns",
            "in deg/s (a guess): one deg/s reads",
        ),
        worth=(1.0, DEG),
    ),
    # several files
    "two files": Case(write=d.in_two_files, said=("2 files",), within=3.0),
    "a file a position": Case(write=d.a_file_a_position, said=("14 files",), within=3.0, gyro=False),
    "positions one below the other": Case(
        write=d.positions_below,
        words=("--sample-rate", "50"),
        said=("14 positions",),
        within=3.0,
        gyro=False,
    ),
    # blemishes
    "bad values": Case(write=d.blemished(d.bad_values), noted=("'###'",)),
    "messages between": Case(write=d.blemished(d.messages_between), noted=("MPU6050",)),
    "messages between, no time": Case(
        write=d.blemished(d.messages_between, time=False), words=("--sample-rate", "50"), within=3.0, noted=("MPU6050",)
    ),
    "several at once": Case(
        write=d.several_at_once,
        said=("decimal commas", "times of day", GOOD),
        within=2.0,
        noted=("missing samples",),
    ),
    "cut last line": Case(write=d.cut, noted=("the last line is cut",)),
    "stamps repeated": Case(write=d.blemished(d.repeated), noted=("the time stamp of the row before",)),
    "stamps out of line": Case(
        write=d.blemished(d.out_of_line),
        within=2.0,
        noted=("before that of the row before", "beyond that of a row behind it"),
    ),
    "clock set back in a turn": Case(write=d.set_back_in_a_turn, within=3.0, noted=("the clock falls back in it",)),
    "rows twice": Case(write=d.blemished(d.doubled), noted=("the time stamp of the row before",)),
    "1 % lost": Case(write=d.blemished(d.lost), within=2.0, noted=("missing samples",)),
    "stamps jitter": Case(write=d.blemished(d.restamped(d.jitter)), said=("regular = true",)),
    "stamps too coarse": Case(write=d.blemished(d.restamped(d.coarse)), said=("time stamps repeat", "regular = true")),
    "stamps in bursts": Case(write=d.blemished(d.restamped(d.bursts)), said=("bursts", "regular = true")),
    "gap in a rest": Case(write=d.gap_in_a_rest, noted=("20 samples",)),
    "gap in a turn": Case(write=d.gap_in_a_turn, within=3.0, noted=("20 samples", "is left out: samples are lost")),
    "rounded to 0.01": Case(write=d.rounded, within=2.0, worth=(1.0, DEG)),
}


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("corpus") / "clean"
    setup = Setup.of(grade="mems", positions=14, rest=3.5, sample_rate=d.RATE, rate_deg_s=90.0)
    simulate_session(folder, setup, seed=3)
    stated = (folder / "session.toml").read_text().splitlines()
    kept = [line for line in stated if not line.startswith(("height_m", "gravity"))]  # as who writes only --latitude
    (folder / "session.toml").write_text("\n".join(kept))
    return folder


@pytest.fixture(scope="module")
def log(session: Path) -> pl.DataFrame:
    return pl.read_parquet(session / "log.parquet")


@pytest.fixture(scope="module")
def clean(session: Path) -> Calibration:
    return calibrate(session)


def per_reading(model: SensorModel, channels: Channels) -> tuple[Array, Array]:
    """Readings for an input in SI: their matrix (3, 3) and their value (3,) at none, as the log has them."""
    gain = channels.scale / channels.unit.factor
    return gain[:, None] * model.matrix, gain * model.bias + channels.offset


def off(found: SensorModel | None, channels: Channels, clean: Calibration, case: Case, kind: str) -> float:
    """How far a result is from the clean one, in u of that, at the worst element of matrix and bias."""
    assert found is not None
    reference = clean.accel if kind == "accel" else clean.gyro
    assert reference is not None
    matrix, zero = per_reading(found, channels)
    u = {p.name: p.u for p in clean.parameters}
    scale = np.array([u[f"{kind}.scale.{a}"] for a in "xyz"])
    bias = np.array([u[f"{kind}.bias.{a}"] for a in "xyz"])
    angle = np.mean([v for name, v in u.items() if name.startswith(f"{kind}.axis")])
    units = np.where(np.eye(3) > 0, scale[:, None], angle)
    worth = case.worth[0 if kind == "accel" else 1]
    in_matrix = (matrix / worth - reference.matrix) / units
    in_bias = ((zero - case.zero) / worth - reference.bias) / bias
    return float(max(np.abs(in_matrix).max(), np.abs(in_bias).max()))


def samples(folder: Path) -> list[Array]:
    """Intervals (m, 1), s, specific forces and rates (m, 3) of a session, and temperatures, where there are any."""
    chunks = list(open_log(read_session(folder)).chunks())
    every = [[c.dt[:, None], c.accel, *(a for a in (c.gyro, c.temperature) if a is not None)] for c in chunks]
    return [np.concatenate(parts) for parts in zip(*every, strict=True)]


def are_alike(one: list[Array], other: list[Array]) -> bool:
    """Whether samples are the same but for what digits leave, a hundredth of the noise of a sample at most."""
    small = (1e-9, 1e-5, 1e-5, 1e-3)
    return [a.shape for a in one] == [b.shape for b in other] and all(
        np.abs(a - b).max() < limit for a, b, limit in zip(one, other, small, strict=False)
    )


@pytest.mark.parametrize("name", CASES)
def test_a_log_of_the_world_gives_the_result_of_the_clean_one(
    name: str, session: Path, log: pl.DataFrame, clean: Calibration, tmp_path: Path
) -> None:
    case = CASES[name]
    given = case.write(log, tmp_path)
    folder = tmp_path / "session"
    made = CliRunner().invoke(main, ["new", str(folder), "--log", str(tmp_path / given), *WORDS, *case.words])
    assert made.exit_code == 0, made.stderr
    for words in case.said:
        assert words in made.stderr
    assert "look at this" not in made.stderr, made.stderr
    if case.gyro and not case.noted and are_alike(samples(folder), samples(session)):
        return  # the same samples give the same result
    result = CliRunner().invoke(main, ["calibrate", str(folder)])
    if case.gyro:
        assert result.exit_code == 0, (result.stderr, result.exception)
    found = read_calibration(folder / "calibration.json")
    for words in case.noted:
        assert any(words in note for note in found.provenance.notes), found.provenance.notes
    spec = read_session(folder).log
    assert off(found.accel, spec.accel, clean, case, "accel") < case.within
    if case.gyro:
        assert spec.gyro is not None
        assert off(found.gyro, spec.gyro, clean, case, "gyro") < case.within


def test_rows_of_two_sensors_read_as_those_of_one_are_refused(log: pl.DataFrame, tmp_path: Path) -> None:
    d.row_for_each_sensor(",", True)(log, tmp_path)
    (tmp_path / "session.toml").write_text(
        'format = 1\n[device]\nserial = "a"\n[site]\nlatitude_deg = 56.84\n'
        f'[log]\nfile = "stream.txt"\ndelimiter = ","\nrate_hz = {2 * d.RATE}\n'
        '[log.accel]\ncolumns = ["x", "y", "z"]\nunit = "count"\nscale = 4.9\nscale_per = "g"\n'
    )
    result = CliRunner().invoke(main, ["calibrate", str(tmp_path)])
    assert result.exit_code == 1
    assert "have rows of several sensors, or the device was shaken throughout" in result.stderr


READ: dict[str, tuple[p.Write, str, str | None, str | None]] = {
    # what is said of it, and the units that names say
    "ROS, messages as text": (p.ros_messages, "several lines a sample (header_seq,", None, None),
    "ROS, rostopic echo -p": (p.ros_table, "", None, None),
    "ROS, a table with the time of arrival": (p.bagpy, "seconds and nanoseconds, added", None, None),
    "axes in brackets, z first": (p.gopro, "", "m/s^2", "rad/s"),
    "names without a sensor, z first": (p.unnamed_axes_in_another_order, "by their numbers (a guess)", None, None),
    "RIDI": (p.ridi, "gravity.txt, linacce.txt, orientation.txt", None, None),
    "Sensor Logger": (p.sensor_logger, "TotalAcceleration.csv and Gyroscope.csv", None, None),
    "phyphox, its archive": (p.phyphox_archive, "device.csv has no rows of readings", "m/s^2", "rad/s"),
    "SparkFun": (p.sparkfun, "names before the numbers (Acc_x [mg],", "mg", "deg/s"),
    "Adafruit": (p.adafruit, "several lines a sample (Acceleration X", "m/s^2", "rad/s"),
    "1'000": (p.thousands("'"), "marks between thousands", "mg", "mdeg/s"),
    "1,000": (p.thousands(","), "marks between thousands", "mg", "mdeg/s"),
}
SHORT = 1000
"""Rows with a few rests, enough for what names say."""

WORTH = {
    None: 1.0,
    "m/s^2": 1.0,
    "mg": 1e3 * G,
    "rad/s": 1.0,
    "deg/s": DEG,
    "mdeg/s": 1e3 * DEG,
}


@pytest.mark.parametrize("name", READ)
def test_columns_units_and_times_are_those_of_the_format(name: str, log: pl.DataFrame, tmp_path: Path) -> None:
    write, said, accel, gyro = READ[name]
    log = log.head(SHORT)
    given = tmp_path / write(log, tmp_path)
    output = OutputFolder(tmp_path / "session")
    files = unzipped(given, output) if given.suffix == ".zip" else files_of(given)
    found = repair_log(identify_log(files, output), output, None)
    assert said in "; ".join(found.remarks)
    for kind, unit, columns in (("accel", accel, d.ACCEL), ("gyro", gyro, d.GYRO)):
        sensors = found.columns.triads[kind]
        assert sensors.unit == unit
        read = found.read(sensors.columns) / WORTH[unit]
        truth = log.select(columns).to_numpy()
        # the first and last samples of one of two clocks may have no other beside them
        starts = [truth[k : k + 40].mean(axis=0) for k in range(3)]
        lead = next(k for k, start in enumerate(starts) if np.allclose(read[:40].mean(axis=0), start, atol=2e-3))
        assert read == pytest.approx(truth[lead : lead + len(read)], abs=0.5 if "archive" in name else 1e-4)
    stamps = found.stamps()
    assert (stamps is None) == (name in ("SparkFun", "Adafruit"))
    if stamps is not None:
        step = np.diff(stamps.values) * (1e-9 if np.median(np.diff(stamps.values)) > 1e6 else 1.0)
        assert step * (1e-3 if name.startswith("axes") else 1.0) == pytest.approx(1.0 / d.RATE, abs=2e-5)


@pytest.mark.parametrize("write", [p.numpy_matrix, p.numpy_arrays])
def test_arrays_of_numpy_are_read(write: p.Write, log: pl.DataFrame, tmp_path: Path) -> None:
    folder = tmp_path / "session"
    draft, _ = new_session(folder, tmp_path / write(log, tmp_path))
    spec = read_session(folder).log
    assert spec.gyro is not None
    copied = pl.read_parquet(folder / "log.parquet")
    assert np.array_equal(copied.select(spec.accel.columns).to_numpy(), log.select(d.ACCEL).to_numpy())
    assert np.array_equal(copied.select(spec.gyro.columns).to_numpy(), log.select(d.GYRO).to_numpy())
    assert any("by their numbers (a guess)" in said for said in draft.remarks) == (write is p.numpy_matrix)


def test_the_sign_of_core_motion_is_taken_off(log: pl.DataFrame, tmp_path: Path) -> None:
    draft, faults = new_session(tmp_path / "session", tmp_path / p.core_motion(log, tmp_path))
    assert not faults
    table = draft.content["log"]
    assert (table["accel"]["scale"], table["accel"]["scale_per"]) == (-1.0, "g")
    assert table["time"] == "accelerometerTimestamp_sinceReboot(s)"
    assert table["gyro"]["columns"][0] == "gyroRotationX(rad/s)"
    assert "−1 g where an axis points up" in draft.remarks[-1]
    plain = (tmp_path / "iphone.csv").read_text(encoding="utf-8").splitlines()
    with_times = [
        ",".join([*(c := line.split(","))[:5], c[1].replace("accelerometer", "gyro"), *c[5:8]]) for line in plain
    ]
    (tmp_path / "times.csv").write_text("\n".join(with_times) + "\n", encoding="utf-8")
    draft, _ = new_session(tmp_path / "apart", tmp_path / "times.csv")
    assert draft.log["accel"]["unit"] == "g"
    read = (
        pl.read_parquet(tmp_path / "apart" / "log.parquet").select(draft.log["accel"]["columns"]).to_numpy()
        * G_STANDARD
    )
    np.testing.assert_allclose(read, log.select(d.ACCEL).to_numpy()[: len(read)], atol=0.01)


@pytest.mark.parametrize(
    ("write", "said"),
    [
        (p.oxiod, "expected columns named as accelerometers are"),
        (p.positions_of_a_camera, "expected columns named as accelerometers are"),
        (p.gyros_alone, "expected columns named as accelerometers are"),
        (q.field_alone, "found a magnetometer alone .X .µT., Y .µT., Z .µT..; log the accelerometers in the same rows"),
        (q.euler_angles, "found t, roll, pitch, yaw; log the readings of the accelerometers too"),
        (q.housekeeping_alone, "found 1, 2, 3, 4; state which they are .accel N,N,N, names or numbers from 1."),
    ],
)
def test_what_has_no_accelerometers_is_refused(write: p.Write, said: str, log: pl.DataFrame, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=said):
        new_session(tmp_path / "session", tmp_path / write(log.head(SHORT), tmp_path))
    assert not (tmp_path / "session").exists()


def test_arrays_of_objects_are_not_run(tmp_path: Path) -> None:
    np.save(tmp_path / "imu.npy", np.array([{"acc": 1.0}], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="found objects of Python; save the arrays themselves"):
        new_session(tmp_path / "session", tmp_path / "imu.npy")


def test_a_last_stamp_that_was_cut_is_no_fall() -> None:
    values = np.append(5.0 + 0.02 * np.arange(100), 6.9)
    times = times_of_column(Stamps(column="t", values=values, unit=None))
    assert times is not None
    assert times.rate == pytest.approx(50.0)


def test_a_field_in_tesla_is_one_on_earth(log: pl.DataFrame, tmp_path: Path) -> None:
    short = log.head(SHORT)
    field = 1e-6 * p.field(short.select(d.ACCEL).to_numpy())
    short.hstack(pl.DataFrame(field, schema=[f"magnetic_field.{a}" for a in "xyz"])).write_csv(tmp_path / "imu.csv")
    draft, _ = new_session(tmp_path / "session", tmp_path / "imu.csv")
    assert draft.magnetometer is not None
    assert draft.magnetometer["unit"] == "T"


def test_what_a_still_body_leaves_open_is_said(log: pl.DataFrame, tmp_path: Path) -> None:
    draft, _ = new_session(tmp_path / "session", tmp_path / q.biased_gyros_first(log, tmp_path))
    assert draft.content["log"]["accel"]["columns"] == ["5", "6", "7"]
    assert draft.content["log"]["accel"]["scale"] == 16384.0
    assert any("identified by their numbers, and others would fit too" in doubt for doubt in draft.doubts)


def test_words_before_the_axes_stay(log: pl.DataFrame, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"taken gravity off \(Linear Accel X, Linear Accel Y, Linear Accel Z\)"):
        new_session(tmp_path / "session", tmp_path / q.linear_accelerations(log, tmp_path))


def test_columns_that_are_stated_are_those_of_the_log(log: pl.DataFrame, tmp_path: Path) -> None:
    d.plain(log.head(SHORT), tmp_path)
    for accel, said in (
        ("2,3", "--accel: expected three columns that are nothing else, with commas between, found 2,3"),
        ("2,3,5", "--accel: expected three columns that are nothing else"),
        ("2,3,9", "--accel: expected names of columns, or numbers from 1 to 7, found '9'; there are t, ax"),
        ("ax,ay,azz", "found 'azz'; there are t, ax, ay, az, gx, gy, gz; did you mean 'az'?"),
    ):
        words = ["--accel", accel, "--gyro", "5,gy,gz", "--time", "t"]
        made = CliRunner().invoke(main, ["new", str(tmp_path / "session"), str(tmp_path / "log.csv"), *words])
        assert (made.exit_code, made.stderr.count("\n")) == (2, 1)
        assert said in made.stderr
        assert not (tmp_path / "session").exists()


def test_a_log_is_calibrated_with_its_columns_stated(log: pl.DataFrame, tmp_path: Path) -> None:
    file = tmp_path / d.without_names(log, tmp_path)
    words = ["--accel", "2,3,4", "--gyro", "5,6,7", "--time", "1", "--latitude", LATITUDE, "--all"]
    result = CliRunner().invoke(main, ["calibrate", str(file), *words])
    assert result.exit_code == 0, result.stderr
    assert "gyro: 5, 6, 7, as stated" in result.stderr


def test_the_noise_of_a_log_is_that_of_the_columns_that_new_finds(log: pl.DataFrame, tmp_path: Path) -> None:
    file = str(tmp_path / d.without_names(log, tmp_path))
    alike = [
        CliRunner().invoke(main, ["noise", file, "--json", *words])
        for words in ([], ["--accel", "2,3,4", "--gyro", "5,6,7", "--accel-unit", "m/s^2", "--gyro-unit", "rad/s"])
    ]
    assert [result.exit_code for result in alike] == [0, 0], alike[0].stderr
    assert alike[0].stdout == alike[1].stdout
    assert "gyro: columns 5, 6, 7, by their numbers (a guess)" in alike[0].stderr
