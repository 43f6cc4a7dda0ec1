"""Logs of the kinds that boards, phones and laboratories publish: read as their names and units say, in whatever words,
starts, dates and files; what is not sure stands in the session, with what hangs on it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from time import process_time

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from tests.support.shared import session
from tumble.cli import main
from tumble.drafting.new_session import Given, new_session
from tumble.planning.setup import Setup
from tumble.recording.session_file import read_session
from tumble.run.observed import inspect_session
from tumble.units import DEGREE, G_STANDARD, Array

NAMES = "t,ax,ay,az,gx,gy,gz"
SERIAL = [
    "ets Jul 29 2019 12:21:46",
    "rst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST_FLASH_BOOT)",
    "clk_drv:0x00,q_drv:0x00,d_drv:0x00,cs0_drv:0x00,hd_drv:0x00,wp_drv:0x00",
    *(f"[{k:6d}][I][main.cpp:{k}] setup(): step {k} of 40: ok" for k in range(40)),
]


@pytest.fixture(scope="module")
def rows() -> Array:
    """Times, s, accelerometers, m/s², and gyros, rad/s, of twelve rests by hand, every other sample."""
    return pl.read_parquet(session(Setup.of(grade="mems", positions=12), seed=4) / "log.parquet").to_numpy()[::2, :7]


def text(path: Path, header: str, rows: Array, delimiter: str = ",") -> Path:
    body = "".join(delimiter.join(f"{x:.13g}" for x in row) + "\n" for row in rows.tolist())
    path.write_text(f"{header}\n{body}" if header else body, encoding="utf-8")
    return path


def scaled(rows: Array, accel: float, gyro: float) -> Array:
    return np.column_stack([rows[:, :1], rows[:, 1:4] * accel, rows[:, 4:7] * gyro])


def check_read(folder: Path, logs: Path | Sequence[Path], rows: Array) -> str:
    """The log has gravity and turns that carry it, at its rate. Gives the doubt of its session."""
    new_session(folder, logs)
    observed = inspect_session(folder)
    assert observed.faults == ()
    assert observed.rate == pytest.approx(1.0 / np.diff(rows[:, 0]).mean(), rel=0.01)
    assert observed.observations is not None
    assert observed.observations.turns is not None
    return "; ".join(observed.session.log.doubts)


G, D = 1.0 / G_STANDARD, 1.0 / DEGREE
TABLES: dict[str, tuple[str, float, float, str, str]] = {
    # names, units of accelerometers and gyros as written, and as they are found
    "deg_per_s": ("t,ax_g,ay_g,az_g,gx_deg_per_s,gy_deg_per_s,gz_deg_per_s", G, D, "g", "deg/s"),
    "(radians_per_second)": ("t,ax,ay,az,gx (rad_per_s),gy (rad_per_s),gz (rad_per_s)", 1.0, 1.0, "m/s^2", "rad/s"),
    "times g": ("t,x_times_g,y_times_g,z_times_g,wx,wy,wz", G, D, "g", "deg/s"),
    "Drehrate_X": ("Zeit,Beschl_X,Beschl_Y,Beschl_Z,Drehrate_X,Drehrate_Y,Drehrate_Z", G, D, "g", "deg/s"),
    "DrehX": ("Zeit,BeschlX,BeschlY,BeschlZ,DrehX,DrehY,DrehZ", G, D, "g", "deg/s"),
    "гироскоп": ("Время,УскорениеX,УскорениеY,УскорениеZ,ГироскопX,ГироскопY,ГироскопZ", G, D, "g", "deg/s"),
    "gyro_rad[0]": ("t,acc[0],acc[1],acc[2],gyro_rad[0],gyro_rad[1],gyro_rad[2]", 1.0, 1.0, "m/s^2", "rad/s"),
    "CAL": ("t CAL [s],a_x CAL,a_y CAL,a_z CAL,g_x CAL,g_y CAL,g_z CAL", 1.0, D, "m/s^2", "deg/s"),
    "MicroStrain": (
        f"Time,{','.join(f'6254:scaledAccel{a}' for a in 'XYZ')},{','.join(f'6254:scaledGyro{a}' for a in 'XYZ')}",
        G, 1.0, "g", "rad/s",
    ),
    "four of seven named": ("t,ax,ay,az", G, D, "g", "deg/s"),
    "a device above the names": ("A,A,A,A,A,A,A\nt,x,y,z,x,y,z", G, D, "g", "deg/s"),
    "a cut row first": ("12,0.1,0.", G, D, "g", "deg/s"),
    "a time without a name": ("ax [g],ay [g],az [g],gx [dps],gy [dps],gz [dps]", G, D, "g", "deg/s"),
    "two lines of names of pandas": (",accel,accel,accel,gyro,gyro,gyro\n,x,y,z,x,y,z\nt,,,,,,", G, D, "g", "deg/s"),
    "groups with marks behind": ("t,IMU Acc,,,IMU Gyro,,,\n,x,y,z,x,y,z,", G, D, "g", "deg/s"),
}  # fmt: skip


@pytest.mark.parametrize("name", TABLES)
def test_units_and_names_in_many_words(name: str, rows: Array, tmp_path: Path) -> None:
    header, accel, gyro, *units = TABLES[name]
    assert check_read(tmp_path / "s", text(tmp_path / "log.csv", header, scaled(rows, accel, gyro)), rows) == ""
    log = read_session(tmp_path / "s").log
    assert [log.accel.unit_name, log.gyro.unit_name if log.gyro else ""] == units


@pytest.mark.parametrize(
    "written",
    [
        lambda lines: [*SERIAL * 5, *lines],
        lambda lines: [line.replace("\n", "") + ";" for line in lines],
        lambda lines: [f"{line}\0" for line in lines],
        lambda lines: [lines[0], *(f"{500 + k}{',0' * 6}" for k in range(5)), *lines[1:]],
    ],
    ids=["boot text", "semicolons", "NULs at the ends", "a clock set late"],
)
def test_lines_as_some_boards_write_them(
    written: Callable[[list[str]], list[str]], rows: Array, tmp_path: Path
) -> None:
    lines = text(tmp_path / "log.csv", NAMES, rows).read_text(encoding="utf-8").splitlines()
    (tmp_path / "log.csv").write_text("\n".join(written(lines)), encoding="utf-8")
    assert check_read(tmp_path / "s", tmp_path / "log.csv", rows) == ""


def test_names_before_the_values_below_boot_text(rows: Array, tmp_path: Path) -> None:
    lines = [
        f"t={t:.2f} acc=({a:.4f}, {b:.4f}, {c:.4f}) gyro=({p:.4f}, {q:.4f}, {r:.4f})" for t, a, b, c, p, q, r in rows
    ]
    (tmp_path / "log.txt").write_text("\n".join([*SERIAL * 5, *lines]) + "\n", encoding="utf-8")
    assert check_read(tmp_path / "s", tmp_path / "log.txt", rows) == ""


@pytest.mark.parametrize("name", ["delta_ms", "t"])
def test_a_column_of_intervals_by_its_name_or_its_numbers(name: str, rows: Array, tmp_path: Path) -> None:
    intervals = np.rint(1e3 * np.diff(rows[:, 0], prepend=0.0)) + np.resize([-1.0, 1.0, 0.0, 0.0, 0.0], len(rows))
    table = np.column_stack([intervals, rows[:, 1:]])
    log = text(tmp_path / "log.csv", NAMES.replace("t", name, 1), table)
    assert check_read(tmp_path / "s", log, rows) == ""


@pytest.mark.parametrize("late", [False, True], ids=["temperatures", "rows in blocks"])
def test_other_numbers_of_one_size_are_no_intervals(late: bool, rows: Array, tmp_path: Path) -> None:
    blocks = np.arange(len(rows) // 4 * 4).reshape(-1, 4)[:, ::-1].ravel()
    cells = 1e6 + 1e3 * rows[blocks, 0] if late else 25.0 + 0.25 * np.resize([0.0, 1.0, 0.0, 2.0], len(blocks))
    log = text(tmp_path / "log.csv", NAMES, np.column_stack([cells, rows[: len(blocks), 1:]]))
    draft, _ = new_session(tmp_path / "s", log)
    assert "time: column 't' does not grow as a time does and is not used" in draft.remarks


def test_the_first_interval_may_be_that_since_the_start(rows: Array, tmp_path: Path) -> None:
    intervals = np.append(123456.0, np.full(len(rows) - 1, 20.0))
    log = text(tmp_path / "log.csv", NAMES.replace("t", "dt", 1), np.column_stack([intervals, rows[:, 1:]]))
    assert check_read(tmp_path / "s", log, rows) == ""


@pytest.mark.parametrize("newest_first", [True, False], ids=["newest rows first", "rows of others between"])
def test_a_copy_continues_a_clock_past_midnight(newest_first: bool, rows: Array, tmp_path: Path) -> None:
    start = datetime(2026, 6, 15, 23, 59, 30)
    times = [f"{start + timedelta(seconds=t):%H:%M:%S.%f}" for t in rows[:, 0].tolist()]
    lines = [f"{t},{','.join(f'{x:.8g}' for x in row[1:])}" for t, row in zip(times, rows.tolist(), strict=True)]
    pairs = zip(lines, times, strict=True)
    lines = lines[::-1] if newest_first else [line for own, t in pairs for line in (own, f"{t},,,,,,")]
    (tmp_path / "log.csv").write_text("\n".join([NAMES, *lines]) + "\n", encoding="utf-8")
    assert check_read(tmp_path / "s", tmp_path / "log.csv", rows) == ""


def test_a_clock_that_grows_once_is_not_used(rows: Array, tmp_path: Path) -> None:
    """Seconds since 1970 in single precision."""
    table = np.column_stack([np.float32(1.7e9 + rows[:, 0]).astype(float), rows[:, 1:]])
    doubt = check_read(tmp_path / "s", text(tmp_path / "log.csv", NAMES, table), rows)
    assert "samples per second by the turns" in doubt


@pytest.mark.parametrize("names", [NAMES, ""], ids=["names", "no names"])
@pytest.mark.parametrize(
    "broken",
    [
        lambda lines: [*SERIAL, *lines],
        lambda lines: [lines[0], 5000 * "\0" + lines[1], *lines[2:]],
        lambda lines: [5000 * "\0" + lines[0], *lines[1:]],
        lambda lines: [*lines[:900], 700 * "\0" + SERIAL[1], *lines[900:]],
        lambda lines: [*lines, 9000 * "\0"],
    ],
    ids=["start text", "NULs behind the first line", "NULs first", "a reset", "NULs last"],
)
def test_starts_and_resets_of_boards(
    names: str, broken: Callable[[list[str]], list[str]], rows: Array, tmp_path: Path
) -> None:
    lines = text(tmp_path / "log.csv", names, rows).read_text(encoding="utf-8").splitlines()
    (tmp_path / "log.csv").write_text("\n".join(broken(lines)) + "\n", encoding="utf-8")
    assert check_read(tmp_path / "s", tmp_path / "log.csv", rows) == ""
    assert read_session(tmp_path / "s").log.time == ("t" if names else "1")


@pytest.mark.parametrize(
    "written",
    [
        "%d-%b-%Y %H:%M:%S.%f", "%d %B %Y %H:%M:%S.%f", "%b %d %Y %H:%M:%S.%f", "%Y%m%d %H:%M:%S.%f",
        "%Y%m%d_%H%M%S.%f", "%Y-%m-%d-%H-%M-%S-%f", "%m/%d/%Y %I:%M:%S.%f %p", "%Y-%m-%dT%H:%M:%S.%fZ",
    ],
)  # fmt: skip
def test_dates_past_midnight_and_the_end_of_a_year(written: str, rows: Array, tmp_path: Path) -> None:
    start = datetime(2025, 12, 31, 23, 59, 30)
    lines = [NAMES]
    for t, *values in rows.tolist():
        lines.append(f"{(start + timedelta(seconds=t)).strftime(written)},{','.join(map(str, values))}")
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert check_read(tmp_path / "s", tmp_path / "log.csv", rows) == ""
    assert read_session(tmp_path / "s").log.clock


def of_sensor_logger(folder: Path, rows: Array, parts: dict[str, Array]) -> Path:
    """Files as Sensor Logger writes them, a sensor each."""
    folder.mkdir()
    for name, values in parts.items():
        table = np.column_stack([1e9 * (1.7e9 + rows[:, 0]), rows[:, 0], values[:, ::-1]])
        text(folder / f"{name}.csv", "time,seconds_elapsed,z,y,x", table)
    return folder


@pytest.mark.parametrize("named", ["", "TotalAcceleration", "AccelerometerUncalibrated"])
def test_accelerations_that_a_phone_has_parted_are_put_together(named: str, rows: Array, tmp_path: Path) -> None:
    force = rows[:, 1:4]
    gravity = np.column_stack([np.convolve(column, np.ones(25) / 25.0, mode="same") for column in force.T])
    parts = {"Accelerometer": force - gravity, "Gravity": gravity, "Gyroscope": rows[:, 4:7]}
    folder = of_sensor_logger(tmp_path / "phone", rows, parts | ({named: force} if named else {}))
    assert check_read(tmp_path / "s", folder, rows) == ""
    read = pl.read_parquet(tmp_path / "s" / "log.parquet")
    assert read.select(f"accel_{a}" for a in "xyz").to_numpy() == pytest.approx(force, abs=1e-5)


def test_of_several_triads_that_which_reads_gravity_is_taken(rows: Array, tmp_path: Path) -> None:
    """As Physics Toolbox writes them: ax is without gravity."""
    table = np.column_stack([rows[:, 0], 0.01 * rows[:, 4:7], rows[:, 4:7], rows[:, 1:4] * G])
    names = "time,ax,ay,az,wx,wy,wz,gFx,gFy,gFz"
    assert check_read(tmp_path / "s", text(tmp_path / "log.csv", names, table), rows) == ""
    assert read_session(tmp_path / "s").log.accel.columns == ("gFx", "gFy", "gFz")


def test_files_of_a_sensor_each_with_columns_beside_the_axes(rows: Array, tmp_path: Path) -> None:
    """As `ulog2csv` writes them."""
    files = []
    for kind, values in (("accel", rows[:, 1:4]), ("gyro", rows[:, 4:7])):
        beside = np.full(len(rows), 1310988.0)
        table = np.column_stack([1e6 * rows[:, 0], 1e6 * rows[:, 0], beside, 0.0 * beside, values, 0.0 * beside + 30.0])
        names = "timestamp,timestamp_sample,device_id,error_count,x,y,z,temperature"
        files.append(text(tmp_path / f"flight_sensor_{kind}_0.csv", names, table))
    assert check_read(tmp_path / "s", files, rows) == ""


# -------------------- lost samples --------------------


@pytest.mark.parametrize("share", [0.03, 0.1, 0.3])
def test_lost_samples_cost_what_they_cost(share: float, rows: Array, tmp_path: Path) -> None:
    kept = rows[np.random.default_rng(5).random(len(rows)) > share]
    check_read(tmp_path / "s", text(tmp_path / "log.csv", NAMES, kept), rows)
    result = CliRunner().invoke(main, ["calibrate", str(tmp_path / "s")])
    assert result.exit_code == 0, result.stderr


# -------------------- noise of what is at rest --------------------


@pytest.fixture(scope="module")
def still() -> Array:
    """Times, accelerometers, g, and gyros, °/s, of a minute on a table."""
    rng = np.random.default_rng(8)
    read = np.column_stack([rng.normal(scale=2e-3, size=(6000, 3)), rng.normal(scale=0.05, size=(6000, 3))])
    return np.column_stack([0.01 * np.arange(6000), read + np.array([0.01, -0.02, 1.0, 0.4, -0.3, 0.2])])


def noise(*words: object) -> str:
    done = CliRunner().invoke(main, ["noise", *map(str, words)])
    assert done.exit_code == 0, done.stderr
    return done.stdout


def density(shown: str, name: str) -> float:
    line = next(line for line in shown.splitlines() if line.startswith(name) and "white noise" in line)
    return float(line.removeprefix(name).split()[3])


def test_noise_of_gyros_alone_with_and_without_their_unit(still: Array, tmp_path: Path) -> None:
    log = text(tmp_path / "gyro.csv", "time,gyro_x,gyro_y,gyro_z", still[:, [0, 4, 5, 6]])
    expected = 0.05 * math.sqrt(0.01) * 60.0  # °/√h
    guessed, stated = noise(log), noise(log, "--gyro-unit", "deg/s")
    for shown in (guessed, stated):
        assert density(shown, "gyro_y") == pytest.approx(expected, rel=0.06)
    last = " ".join(guessed.splitlines()[-2:])
    assert "doubt: gyros in deg/s by a guess" in last
    assert "state --gyro-unit" in last
    assert "doubt" not in stated
    refused = CliRunner().invoke(main, ["new", str(tmp_path / "s"), str(log)])
    assert refused.exit_code == 2
    assert "of gyros alone tumble calibrate gyro.csv tells the biases, tumble noise the noise" in refused.stderr


def test_noise_of_a_folder_with_a_file_a_sensor_and_of_text_that_is_copied(still: Array, tmp_path: Path) -> None:
    folder = of_sensor_logger(
        tmp_path / "phone", still, {"Accelerometer": still[:, 1:4] / G, "Gyroscope": still[:, 4:7] * DEGREE}
    )
    shown = noise(folder, "--gyro-unit", "rad/s")
    assert density(shown, "gyro_x") == pytest.approx(0.05 * math.sqrt(0.01) * 60.0, rel=0.06)
    assert density(shown, "accel_x") == pytest.approx(2e-3 * math.sqrt(0.01) * 1e6, rel=0.06)
    parts = [
        text(tmp_path / f"{k}.csv", f"t,{k}x,{k}y,{k}z", still[:, c])
        for k, c in (("a", [0, 1, 2, 3]), ("g", [0, 4, 5, 6]))
    ]
    assert density(noise(*parts, "--gyro-unit", "deg/s"), "gyro_z") == pytest.approx(0.3, rel=0.06)
    lines = [f"ax={a:.5f} ay={b:.5f} az={c:.5f}" for a, b, c in still[:, 1:4].tolist()]
    (tmp_path / "putty.txt").write_text("\n".join(lines), encoding="utf-8")
    copied = noise(tmp_path / "putty.txt", "--sample-rate", 100)
    assert density(copied, "ax") == pytest.approx(2e-3 * math.sqrt(0.01) * 1e6, rel=0.06)


def test_noise_of_a_log_with_lost_samples(still: Array, tmp_path: Path) -> None:
    kept = still[np.random.default_rng(5).random(len(still)) > 0.1]
    names = "time,ax [g],ay [g],az [g],gx [dps],gy [dps],gz [dps]"
    shown = noise(text(tmp_path / "log.csv", names, kept))
    assert density(shown, "gx [dps]") == pytest.approx(0.05 * math.sqrt(0.01) * 60.0, rel=0.1)


# -------------------- doubts --------------------


def test_six_faces_in_counts_are_calibrated_without_the_gyros_whose_scale_nothing_tells(tmp_path: Path) -> None:
    rng, faces = np.random.default_rng(2), np.vstack([np.eye(3), -np.eye(3)])
    for k, up in enumerate(faces, 1):
        accel = np.rint(16384.0 * (up + np.array([0.03, -0.01, 0.02])) + rng.normal(scale=60.0, size=(800, 3)))
        gyro = np.rint(rng.normal(scale=6.0, size=(800, 3)) + np.array([-550.0 + 3 * k, 110.0, -70.0 + 2 * k]))
        table = np.column_stack([10_000.0 * np.arange(800), accel, gyro])
        text(tmp_path / f"face-{k}.csv", "timestamp_us,ax,ay,az,gx,gy,gz", table)
    made = CliRunner().invoke(main, ["new", str(tmp_path / "s"), *map(str, sorted(tmp_path.glob("face-*.csv")))])
    doubt = "no turn determines the scale of the gyros' counts: the accelerometers alone are calibrated"
    assert made.stdout.startswith(f"doubt: {doubt}")
    done = CliRunner().invoke(main, ["calibrate", str(tmp_path / "s"), "--json"])
    assert done.exit_code == 0, done.stderr
    assert doubt in done.stdout
    assert "gyro.bias.x" not in done.stdout


def test_a_doubt_ends_where_the_user_states_what_is_known(still: Array, tmp_path: Path) -> None:
    quiet = np.column_stack([still[:, :4], still[:, 4:7] / 50.0])
    log = text(tmp_path / "log.csv", "t,ax,ay,az,gx,gy,gz", quiet)
    for number, (given, doubted) in enumerate(((Given(), True), (Given(gyro_unit="deg/s", accel_unit="g"), False))):
        draft, _ = new_session(tmp_path / str(number), log, given)
        assert bool(draft.doubts) == doubted
        assert read_session(tmp_path / str(number)).log.doubts == draft.doubts


# -------------------- times and rows as some programs write them --------------------


@pytest.mark.parametrize(
    "written", [lambda t: t.strftime("%a %b %d %H:%M:%S %Y"), lambda t: t.strftime("%M:%S.%f")[:7]], ids=["C", "Excel"]
)
def test_times_of_c_and_of_excel(written: Callable[[datetime], str], rows: Array, tmp_path: Path) -> None:
    """Whole seconds with a date, and minutes with tenths of seconds, which pass an hour."""
    start = datetime(2026, 6, 15, 9, 59, 30)
    lines = [f"{written(start + timedelta(seconds=t))},{','.join(map(str, values))}" for t, *values in rows.tolist()]
    (tmp_path / "log.csv").write_text("\n".join([NAMES, *lines]) + "\n", encoding="utf-8")
    assert check_read(tmp_path / "s", tmp_path / "log.csv", rows) == ""
    assert read_session(tmp_path / "s").log.regular


def test_dates_with_empty_cells_are_read_in_no_time(tmp_path: Path) -> None:
    start = datetime(2026, 6, 15, 9, 59, 30)
    lines = [
        f"{start + timedelta(seconds=0.01 * k):%Y-%m-%d %H:%M:%S.%f},{'' if k % 40 == 7 else 0.1},0.2,9.8"
        for k in range(8000)
    ]
    (tmp_path / "log.csv").write_text("\n".join(["t,ax,ay,az", *lines]) + "\n", encoding="utf-8")
    started = process_time()
    new_session(tmp_path / "s", tmp_path / "log.csv")
    assert process_time() - started < 5.0


@pytest.mark.parametrize("others", [["GPS,{t},45.1,7.6"], ["GPS,{t},45.1,7.6,240,9,1.2,3,0", "BARO,{t},1002,3"]])
@pytest.mark.parametrize("names", ["", "kind,t,ax,ay,az,gx,gy,gz,T"])
def test_rows_of_the_imu_among_those_of_others(others: list[str], names: str, rows: Array, tmp_path: Path) -> None:
    lines = [names] if names else []
    for k, (t, *values) in enumerate(rows.tolist()):
        lines.append(f"IMU,{1e3 * t:.0f},{','.join(f'{x:.6g}' for x in values)},25.{k % 10}")
        lines += [line.format(t=f"{1e3 * t:.0f}") for line in others] if k % 5 == 0 else []
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert check_read(tmp_path / "s", tmp_path / "log.csv", rows) == ""
    assert read_session(tmp_path / "s").log.accel.columns == (("ax", "ay", "az") if names else ("3", "4", "5"))


def test_a_body_that_flies_without_names_of_columns(tmp_path: Path) -> None:
    """Gyros whose median length is 1, as that of accelerometers in g, but not most of the time."""
    rng, t = np.random.default_rng(3), 0.005 * np.arange(6000)
    turning = np.column_stack([np.sin(t), np.sin(1.3 * t + 1.0), np.sin(0.7 * t + 2.0)])
    turning *= (1.0 + np.sin(0.5 * t))[:, None]
    force = np.array([0.0, 0.0, 9.8]) + rng.normal(scale=3.0, size=(6000, 3))
    force += 3.0 * np.column_stack([np.cos(t), np.cos(1.1 * t), np.cos(0.4 * t)])
    text(tmp_path / "log.txt", "", np.column_stack([4908.7 + t, turning, force]), " ")
    new_session(tmp_path / "s", tmp_path / "log.txt")
    log = read_session(tmp_path / "s").log
    assert (log.accel.columns, log.accel.unit_name) == (("5", "6", "7"), "m/s^2")


def test_numbers_of_rows_are_no_thousandths_of_a_second(tmp_path: Path) -> None:
    still = np.column_stack([1.0 + np.arange(1000), np.random.default_rng(1).normal(size=(1000, 6))])
    still[:, 1:] = 0.01 * still[:, 1:] + np.array([0.0, 0.0, 9.81, 0.0, 0.0, 0.0])
    draft, _ = new_session(tmp_path / "s", text(tmp_path / "log.csv", NAMES, still))
    assert draft.log["rate_hz"] == 100.0
    assert any("state --sample-rate" in doubt for doubt in draft.doubts)


@pytest.mark.parametrize("name", ["Packet number", "sample"])
def test_a_counter_of_rows_is_no_time(name: str, tmp_path: Path) -> None:
    still = np.random.default_rng(1).normal(scale=0.01, size=(1000, 6)) + np.array([0.0, 0.0, 9.81, 0.0, 0.0, 0.0])
    numbers = np.cumsum(np.random.default_rng(2).choice([1.0, 2.0], size=1000))  # those between are of others
    log = text(tmp_path / "log.csv", NAMES.replace("t", name, 1), np.column_stack([numbers, still]))
    draft, _ = new_session(tmp_path / "s", log)
    assert "time" not in draft.log
    assert any("state --sample-rate" in doubt for doubt in draft.doubts)


def test_motion_about_one_attitude_determines_no_zero_of_accelerometers(tmp_path: Path) -> None:
    """A robot on a floor, whose stops differ by a little tilt and by its own acceleration."""
    rng = np.random.default_rng(6)
    stops = np.array([0.0, 0.0, 10.7]) + rng.normal(scale=[0.25, 0.25, 0.12], size=(14, 3))
    accel = np.repeat(stops, 200, axis=0) + rng.normal(scale=0.02, size=(2800, 3))
    gyro = rng.normal(scale=0.005, size=(2800, 3))
    log = text(tmp_path / "log.csv", NAMES, np.column_stack([0.01 * np.arange(2800), accel, gyro]))
    new_session(tmp_path / "s", log)
    assert read_session(tmp_path / "s").log.accel.unit_name == "m/s^2"
