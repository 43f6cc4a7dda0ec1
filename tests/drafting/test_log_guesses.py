"""What `tumble new` tells of a log from its names, numbers and lines, piece by piece."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tumble.diagnosis.turn_likelihood import WIDTHS
from tumble.drafting.dialects import copy_as_tables, values_by_name
from tumble.drafting.foreign_log import Draft, ForeignLog
from tumble.drafting.hypotheses import Evidence, length_and_zero, ranked_hypotheses
from tumble.drafting.new_session import Given, new_session
from tumble.drafting.times import (
    Stamps,
    at_rate,
    overflow_of,
    recordings_of,
    times_of_column,
    times_without_column,
)
from tumble.errors import InputError, LogError
from tumble.files import OutputFolder
from tumble.planning.setup import Setup
from tumble.recording.columns.names import ACCEL, GYRO, Columns, Sensors, columns_by_name
from tumble.recording.columns.numbers import columns_by_data
from tumble.recording.columns.scales import resolution_in_deg_s
from tumble.recording.text.clock import is_clock, seconds_of
from tumble.recording.text.dialect import Dialect, top_of
from tumble.simulation.session import simulate_session
from tumble.units import DEGREE, G_STANDARD, Array

FACES = np.vstack([np.eye(3), -np.eye(3)])


@pytest.fixture(scope="module")
def read() -> Array:
    """Accelerometers on six faces and gyros beside them, with noise; columns 1 to 6."""
    rng = np.random.default_rng(4)
    accel = np.repeat(G_STANDARD * FACES, 100, axis=0) + rng.normal(scale=0.01, size=(600, 3))
    return np.column_stack([accel, rng.normal(scale=0.01, size=(600, 3))])


def triads_of(read: Array) -> dict[str, tuple[str, ...]]:
    found = columns_by_data([str(j + 1) for j in range(read.shape[1])], read)
    return {kind: sensors.columns for kind, sensors in found.triads.items()}


def test_unread_rows_do_not_hide_what_columns_are(read: Array) -> None:
    blemished = read.copy()
    blemished[[17, 400]] = np.nan
    assert triads_of(blemished) == triads_of(read) == {ACCEL: ("1", "2", "3"), GYRO: ("4", "5", "6")}


def test_sensors_are_not_of_two_arrays(read: Array) -> None:
    found = columns_by_data(["fb[0]", "fb[1]", "fb[2]", "wb[0]", "wb[1]", "wb[2]"], read)
    assert found.triads[ACCEL].columns == ("fb[0]", "fb[1]", "fb[2]")
    assert not columns_by_data(["a[0]", "fb[0]", "fb[1]", "wb[0]", "wb[1]", "wb[2]"], read).triads


def test_columns_of_which_no_stretch_is_whole_are_told_by_gravity(read: Array) -> None:
    holed = read.copy()
    holed[::7, 0] = np.nan
    assert triads_of(holed) == {ACCEL: ("1", "2", "3"), GYRO: ("4", "5", "6")}
    assert triads_of(0.7 * holed) == {}


def test_accelerometers_that_read_nothing_or_zero_are_refused(tmp_path: Path) -> None:
    rows = {"t": 0.01 * np.arange(400), "ax": np.zeros(400), "ay": np.zeros(400), "az": np.zeros(400)}
    pl.DataFrame(rows).write_csv(tmp_path / "zero.csv")
    with pytest.raises(LogError, match="ax, ay, az: expected readings, found none in the first 400 rows"):
        new_session(tmp_path / "zero", tmp_path / "zero.csv")


def test_a_counter_that_starts_anew_is_a_time(read: Array) -> None:
    micros = (np.arange(600) * 10_000.0 + 2.0**32 - 3e6) % 2.0**32
    found = columns_by_data([str(j) for j in range(7)], np.column_stack([micros, read]))
    assert found.time == "0"
    assert found.triads[ACCEL].columns == ("1", "2", "3")


def test_of_a_body_that_never_moves_the_accelerometers_read_gravity(read: Array) -> None:
    still = np.column_stack([read[:, 3:], read[:, 3:] + [0.6, 0.0, 0.8]])
    assert triads_of(still) == {ACCEL: ("4", "5", "6"), GYRO: ("1", "2", "3")}
    assert triads_of(still + 0.5) == {}


def test_a_converter_has_its_zero_in_the_middle_where_it_writes_nothing_negative() -> None:
    zero = np.array([20.0, 850.0, 1020.0])
    assert length_and_zero(2048.0 * FACES + zero)[2] == [20.0, 850.0, 1020.0]
    length, u, middle, _ = length_and_zero(250.0 * FACES + 520.0)
    assert middle == [512.0] * 3
    assert length == pytest.approx(250.0, rel=2.0 * u)


@pytest.mark.parametrize(
    ("found", "unit", "doubted"),
    [
        (9.78, "m/s^2", False),
        (1.01, "g", False),
        (995.0, "mg", True),
        (1020.0, None, True),
        (974.8, "cm/s^2", True),
        (9790.0, "mm/s^2", False),
        (4.2, None, False),
    ],
)
def test_readings_of_one_g_tell_a_unit_from_counts(found: float, unit: str | None, doubted: bool) -> None:
    triads = {ACCEL: Sensors(columns=("x", "y", "z"), unit=None)}
    source = ForeignLog(files=(), columns=Columns(time=None, time_unit=None, triads=triads))
    draft = Draft(source=source, times=at_rate(100.0, 0.0), content={})
    evidence = Evidence(rate=100.0, length=found, length_u=0.005, whole={ACCEL: True})
    best, *rivals = ranked_hypotheses(evidence, draft)
    assert best.accel.unit == unit
    assert any(rival.cost - best.cost < WIDTHS.near for rival in rivals) == doubted


def test_pauses_are_no_part_of_the_rate() -> None:
    t = np.cumsum(np.tile([0.002, 0.018], 2000))
    t[2000:] += 900.0
    times = times_of_column(Stamps(column="t", values=t, unit="s"))
    assert times is not None
    assert times.rate == pytest.approx(100.0, rel=0.02)


def test_a_time_that_counts_the_rows_is_remarked_on() -> None:
    times = times_of_column(Stamps(column="t", values=np.arange(1.0, 500.0), unit=None))
    assert times is not None
    assert times.keys["time_unit"] == "ms"
    assert any("as a counter of samples does too" in said for said in times.remarks)


def test_a_clock_may_be_one_of_twelve_hours() -> None:
    cells = ["11:59:59.5 AM", "12:00:01 PM", "1:02:03 pm", "12:00:00 a.m.", "2024-03-01 01:00 PM", "13:00:00"]
    assert all(map(is_clock, cells))
    seconds = [43199.5, 43201.0, 46923.0, 0.0, 46800.0, 46800.0]
    assert (seconds_of(pl.Series(cells), 0) % 86400).to_list() == seconds


@pytest.mark.parametrize(
    ("lines", "copied"),
    [
        (["[1, 0.5, -2]", "[2, 0.6, -2],", "[3, 0.7, -2]"], "1, 0.5, -2\n2, 0.6, -2\n3, 0.7, -2\n"),
        (
            ["13:02:11.345 -> ms\tax\tay", "13:02:11.350 -> 5\t0.1\t0.2", "13:02:11.355 -> 10\t0.1\t0.3"],
            "clock\tms\tax\tay\n13:02:11.350\t5\t0.1\t0.2\n13:02:11.355\t10\t0.1\t0.3\n",
        ),
    ],
    ids=["brackets", "serial monitor"],
)
def test_rows_come_out_of_what_is_about_them(lines: list[str], copied: str, tmp_path: Path) -> None:
    log = tmp_path / "log.txt"
    log.write_text("\n".join([*lines, ""]))
    found = copy_as_tables(log, log.read_bytes(), OutputFolder(tmp_path / "session"))
    assert found is not None
    (table,), _ = found
    assert table.read_text() == copied


def test_dates_tell_the_unit_of_a_time() -> None:
    for size, unit in ((1.0, "s"), (1e3, "ms"), (1e6, "us"), (1e9, "ns")):
        times = times_of_column(Stamps(column="t", values=(1.586e9 + 0.6 * np.arange(100.0)) * size, unit=None))
        assert times is not None
        assert times.rate == pytest.approx(1 / 0.6, rel=1e-3)
        assert times.keys.get("time_unit", "s") == unit
        assert not times.rivals
    for start, step, unit in ((1.2e9, 1e4, "us"), (1.3e15, 2e6, "ns")):  # that a processor has been running for
        running = times_of_column(Stamps(column="t", values=start + step * np.arange(2000.0), unit=None))
        assert running is not None
        assert running.keys["time_unit"] == unit


def test_a_counter_starts_anew_only_where_it_can() -> None:
    stamps: Array = np.asarray(1e7 + 8500.0 * np.arange(400))
    stamps[160] -= 14_000.0
    assert overflow_of(stamps) is None
    counter: Array = np.asarray(np.arange(1000.0) * 100.0 % 65536.0)
    assert overflow_of(counter) == 65536.0
    of_second: Array = np.asarray(np.arange(1.0, 1000.0) * 10.0 % 1000.0)
    assert overflow_of(of_second) == 1000.0
    assert overflow_of(np.array([3.0, 2.0, 1.0])) is None


@pytest.mark.parametrize("line", ["# ODR: 62.5 Hz", "odr_hz = 62.5", "Sampling Frequency (Hz),62.5"])
def test_the_rate_above_the_rows_is_believed(line: str) -> None:
    assert times_without_column(None, [line]).rate == 62.5


def test_clocks_that_are_started_anew_part_a_log() -> None:
    stamps = np.concatenate([68.0 + 0.1 * np.arange(300), 4.5 + 0.1 * np.arange(200)])
    assert recordings_of(stamps) == [(0, 300), (300, 500)]
    assert recordings_of(np.sort(stamps)) is None
    assert recordings_of(np.concatenate([stamps, 1.0 + 0.1 * np.arange(20)])) is None
    set_late = np.concatenate([500.0 + 0.1 * np.arange(5), stamps])
    assert recordings_of(set_late) == [(5, 305), (305, 505)]
    late = np.sort(stamps)
    late[100] -= 0.15
    assert recordings_of(late) is None
    for single in (0.0, 1e6):
        wrong = np.sort(stamps)
        wrong[100] = single
        assert recordings_of(wrong) is None
        wrong = stamps.copy()
        wrong[100] = single
        assert recordings_of(wrong) == [(0, 300), (300, 500)]


def test_a_log_whose_clock_starts_anew_becomes_files(read: Array, tmp_path: Path) -> None:
    stamps = np.concatenate([60.0 + 0.02 * np.arange(350), 3.0 + 0.02 * np.arange(250)])
    names = ["t_s", *(f"a{a}" for a in "xyz"), *(f"g{a}" for a in "xyz")]
    pl.DataFrame(np.column_stack([stamps, read]), schema=names).write_csv(tmp_path / "log.csv")
    draft, _ = new_session(tmp_path / "session", tmp_path / "log.csv")
    assert len(draft.content["log"]["file"]) == 2
    assert any("there are 2 recordings" in said for said in draft.remarks)


def test_what_is_in_no_unit_is_no_accelerometer_beside_what_is(read: Array) -> None:
    still = np.tile([-17.0, -53.0, 981.0], (600, 1)) + np.round(300.0 * read[:, 3:])
    field = np.repeat([[-823.0, -18.0, -337.0], [-799.0, -24.0, -327.0]], 300, axis=0)
    gyro = np.array([-20.0, 5.0, 4.0]) + np.round(3000.0 * read[::-1, 3:])
    assert triads_of(np.column_stack([still, field, gyro])) == {ACCEL: ("1", "2", "3"), GYRO: ("7", "8", "9")}


@pytest.mark.parametrize(
    ("bias", "noise", "shaken", "unit"),
    [
        (0.64, 0.001, 0.002, "deg/s"),
        (0.01, 0.1, 0.002, "deg/s"),
        (0.01, 0.1, 0.3, "rad/s"),
        (0.02, 0.001, 0.002, "rad/s"),
    ],
    ids=["bias", "noise", "noise in a hand", "neither"],
)
def test_gyros_that_nothing_turns_are_told_by_what_they_read_at_rest(
    bias: float, noise: float, shaken: float, unit: str, tmp_path: Path
) -> None:
    rng = np.random.default_rng(8)
    accel = np.array([0.0, 0.0, G_STANDARD]) + shaken * rng.normal(size=(800, 3))
    gyro = np.array([bias, 0.0, 0.0]) + noise * rng.normal(size=(800, 3))
    names = ["t_s", *(f"a{a}" for a in "xyz"), *(f"g{a}" for a in "xyz")]
    pl.DataFrame(np.column_stack([0.01 * np.arange(800), accel, gyro]), schema=names).write_csv(tmp_path / "log.csv")
    draft, _ = new_session(tmp_path / "session", tmp_path / "log.csv")
    assert draft.content["log"]["gyro"]["unit"] == unit


def test_where_one_axis_reads_all_of_gravity_columns_are_counted_in_threes() -> None:
    rng = np.random.default_rng(6)
    noise = 1e-3 * rng.normal(size=(400, 6))
    still = np.array([-0.008, -0.007, 0.009, -0.98, 0.121, 0.009]) + noise
    assert triads_of(still) == {ACCEL: ("4", "5", "6"), GYRO: ("1", "2", "3")}


def test_rests_in_one_attitude_draw_no_sphere() -> None:
    means = np.array([20.0, 470.0, 16250.0]) + 60.0 * np.random.default_rng(2).normal(size=(6, 3))
    length, u, zero, _ = length_and_zero(means)
    assert zero == [0.0] * 3
    assert u > 0.02
    length, u, zero, _ = length_and_zero(means + 16384.0 * np.vstack([FACES]) - [0.0, 0.0, 16250.0])
    assert length == pytest.approx(16384.0, rel=2.0 * u)
    assert u < 0.01


def test_magnetometers_without_readings_are_left_out(read: Array, tmp_path: Path) -> None:
    names = [f"{kind}_{a}" for kind in ("acc", "gyr", "mag") for a in "xyz"]
    table = pl.DataFrame(np.column_stack([read[:300], np.ones((300, 3))]), schema=names)
    table.with_columns(pl.lit("").alias("mag_y")).write_csv(tmp_path / "log.csv")
    draft, _ = new_session(tmp_path / "session", tmp_path / "log.csv", Given(sample_rate=100.0))
    assert draft.magnetometer is None
    assert "magnetometers: mag_x, mag_y, mag_z are left out; they have no readings" in draft.remarks


@pytest.mark.filterwarnings("error")
def test_times_that_are_no_numbers_are_none(read: Array, tmp_path: Path) -> None:
    np.savez(tmp_path / "imu.npz", t=np.full(600, np.nan), acc=read[:, :3], gyro=read[:, 3:])
    with pytest.raises(InputError, match="expected readings, found none"):
        new_session(tmp_path / "session", tmp_path / "imu.npz")


def test_a_date_between_underscores_is_a_time_and_no_number(tmp_path: Path) -> None:
    seconds = 0.02 * np.arange(500) + 55.0
    stamps = [f"2026_06_15_18_{21 + int(t // 60):02d}_{t % 60:06.3f}" for t in seconds]
    rows = [f"{stamp},{0.01 * (k % 7)},0.02,9.81,0,0.001,{0.001 * (k % 5)}" for k, stamp in enumerate(stamps)]
    (tmp_path / "log.csv").write_text("\n".join(["UTC_Time,ax,ay,az,gx,gy,gz", *rows, ""]))
    draft, _ = new_session(tmp_path / "session", tmp_path / "log.csv")
    assert draft.content["log"]["time_unit"] == "iso8601"
    assert draft.rate == pytest.approx(50.0)
    assert is_clock("2026_06_15_18_21_44.624")
    assert not is_clock("2026_06_15")


@pytest.mark.parametrize(
    ("scale", "step", "decimals", "unit"),
    [
        (1.0, 1 / 16.4, 2, "deg/s"),
        (1.0, 2000 / 32768, 6, "deg/s"),
        (1.0, 0.00875, 5, "deg/s"),
        (np.pi / 180, 1 / 16.4, 6, "rad/s"),
        (1.0, 1e-3, 3, "rad/s"),
        (1.0, 30.0, 1, "deg/s"),
        (1.0, 30.0, 0, "count"),
    ],
    ids=["16.4 counts", "2000 °/s", "8.75 mdps", "rad/s", "thousandths", "too fast", "too fast and whole"],
)
def test_gyros_are_told_by_their_steps_and_by_what_none_reads(
    scale: float, step: float, decimals: int, unit: str, read: Array, tmp_path: Path
) -> None:
    rng = np.random.default_rng(9)
    counts = rng.integers(-40, 40, size=(600, 3))
    gyro = (scale * step * (counts + (0.11 if (step, decimals) == (30.0, 1) else 0.0))).round(decimals)
    table = pl.DataFrame(np.column_stack([read[:, :3], gyro]), schema=["ax", "ay", "az", "gx", "gy", "gz"])
    table.write_csv(tmp_path / "log.csv")
    draft, _ = new_session(tmp_path / "session", tmp_path / "log.csv", Given(sample_rate=100.0))
    assert draft.content["log"]["gyro"]["unit"] == unit


def test_accelerations_that_read_no_gravity_are_doubted(tmp_path: Path) -> None:
    table = np.random.default_rng(3).normal(scale=2.0, size=(600, 3)).round(2)
    pl.DataFrame(table, schema=["acc_x", "acc_y", "acc_z"]).write_csv(tmp_path / "log.csv")
    draft, _ = new_session(tmp_path / "session", tmp_path / "log.csv", Given(sample_rate=100.0))
    assert any("a filter has left without gravity cannot be calibrated" in doubt for doubt in draft.doubts)


def test_names_may_stand_behind_that_of_their_sensor() -> None:
    line = "2025-10-04 16:35:12.186,EULER(deg): R=1.70,P=9.24,GYRO: X=-0.001,Y=0.002,Z=0.003,ACCEL: X=1.5,Y=-0.2,Z=9.6"
    found = values_by_name(line)
    assert found["time"] == "2025-10-04 16:35:12.186"
    assert [found[f"GYRO_{a}"] for a in "XYZ"] == ["-0.001", "0.002", "0.003"]
    assert {ACCEL, GYRO} <= set(columns_by_name(found).triads)


def test_a_row_with_much_text_in_it_is_no_line_of_names() -> None:
    rows = ["in,swim,sea,1,0.81,0.56,0.17,-0.40,raw,a", ",swim,,2,0.81,0.56,0.17,-0.40,,", ",,,3,0.81,0.5,0.1,-0.4,,"]
    top = top_of(("event,what,place,t,depth,x,y,z,behaviour,note", *rows), Dialect())
    assert top is not None
    assert top.names[5:8] == ("x", "y", "z")


def test_names_that_come_twice_have_the_word_before_them() -> None:
    found = values_by_name(
        "20518269: |Acc X:-0.22, Acc Y:-0.11, Acc Z:9.19 |Gyr X:0.02, Gyr Y:0.1, Gyr Z:-0.01 |Mag X:-0.03"
    )
    assert list(found) == ["time", "Acc X", "Acc Y", "Acc Z", "Gyr X", "Gyr Y", "Gyr Z", "Mag X"]
    assert (found["time"], found["Acc Z"], found["Gyr X"]) == ("20518269", "9.19", "0.02")
    assert list(values_by_name("Acc X: 1.0 g Y: 2.0 g Gyr X: 3.0 dps Y: 4.0 dps")) == [
        "Acc X",
        "Acc Y",
        "Gyr X",
        "Gyr Y",
    ]


@pytest.mark.parametrize("decimals", [2, 3, 4])
def test_quaternions_that_are_rounded_are_no_accelerometers(decimals: int) -> None:
    angle = np.cumsum(np.full((600, 4), [0.02, 0.031, 0.013, 0.007]), axis=0)
    quaternion = np.sin(angle)
    quaternion = np.round(quaternion / np.linalg.norm(quaternion, axis=1)[:, None], decimals)
    assert triads_of(quaternion) == {}


def test_columns_of_other_names_are_no_sensor_by_their_numbers(read: Array) -> None:
    for names in (["RSSI (dB)", "LQ (%)", "SNR (dB)"], ["sitting", "standing", "walking"], ["room", "y", "z"]):
        assert columns_by_data(names, read[:, :3]).triads == {}
    for names in (["fz1", "fz2", "fz3"], ["Kanal X", "Kanal Y", "Kanal Z"], ["9", "10", "11"]):
        assert columns_by_data(names, read[:, :3]).triads[ACCEL].columns == tuple(names)


def test_steps_of_six_digits_are_those_of_data_sheets() -> None:
    counts = np.random.default_rng(5).normal(scale=900.0, size=(3000, 3)).round()
    written = np.array([[float(f"{value:.6g}") for value in row] for row in (0.00875 * counts).tolist()])
    assert resolution_in_deg_s(written) == 0.00875
    assert resolution_in_deg_s(written * 1.0003) is None


def test_names_are_those_of_the_first_columns_where_the_others_are_empty() -> None:
    text = ("a,t,ax,ay,az", *(f"0,{0.01 * k:.2f},0.1,0.2,9.8,,," for k in range(20)))
    top = top_of(text, Dialect())
    assert top is not None
    assert top.names == ("a", "t", "ax", "ay", "az", "6", "7", "8")


def test_a_line_of_the_numbers_of_columns_is_no_row() -> None:
    text = (",0,1,2,3,4,5", *(f"{k},0.1,0.2,9.8,0,0,{k % 3}" for k in range(20)))
    top = top_of(text, Dialect())
    assert top is not None
    assert (top.lines, top.names) == (1, ("1", "2", "3", "4", "5", "6", "7"))


def test_a_quantity_has_the_word_before_it() -> None:
    line = "[IMU] Orientation: (0, 0.1, -0.7, 0.6), Angular Velocity: (0.1, 0.2, 0.3), Linear Acceleration: (1, 2, 9.1)"
    assert list(values_by_name(line)) == [
        f"{name}_{a}" for name in ("Angular Velocity", "Linear Acceleration") for a in "xyz"
    ]


@pytest.mark.parametrize(("first", "taken"), [("Timestamp", "Milliseconds"), ("received time", "device time")])
def test_of_several_times_that_is_taken_which_grows_from_row_to_row(
    first: str, taken: str, read: Array, tmp_path: Path
) -> None:
    passed = 10.0 * np.arange(600)
    coarse = np.floor(passed / 1000.0) if first == "Timestamp" else np.full(600, 1.57e18)
    names = [first, taken, *(f"a{a}" for a in "xyz"), *(f"g{a}" for a in "xyz")]
    pl.DataFrame(np.column_stack([coarse, passed, read]), schema=names).write_csv(tmp_path / "log.csv")
    draft, _ = new_session(tmp_path / "session", tmp_path / "log.csv")
    assert draft.content["log"]["time"] == taken
    assert "regular" not in draft.content["log"]


@pytest.fixture(scope="module")
def two_turns(tmp_path_factory: pytest.TempPathFactory) -> pl.DataFrame:
    """Three rests and two turns by hand, in SI, 50 samples per second."""
    setup = Setup.of(grade="mems", positions=3, rest=4.0, sample_rate=50.0, rate_deg_s=90.0)
    return pl.read_parquet(simulate_session(tmp_path_factory.mktemp("few") / "s", setup, seed=4) / "log.parquet")


def written(log: pl.DataFrame, path: Path, *, accel: float = 1.0, gyro: float = 1.0, digits: int = 9) -> Path:
    """A log that reads so much for 1 m/s² and for 1 rad/s, rounded, in a file."""
    scaled = log.with_columns(pl.col("ax", "ay", "az") * accel, pl.col("gx", "gy", "gz") * gyro)
    scaled.with_columns(pl.exclude("t").round(digits)).write_csv(path)
    return path


@pytest.mark.parametrize(
    ("accel", "gyro", "digits", "units", "scale"),
    [
        (1.0, 1.0 / DEGREE, 9, ("m/s^2", "deg/s"), None),
        (1.0 / G_STANDARD, 1e3 / DEGREE, 9, ("g", "mdeg/s"), None),
        (1e3, 3600.0 / DEGREE, 0, ("mm/s^2", "deg/h"), None),
        (4096.0 / G_STANDARD, 65.5 / DEGREE, 0, ("count", "count"), 65.5),
    ],
)
def test_two_turns_tell_units_and_counts(
    accel: float,
    gyro: float,
    digits: int,
    units: tuple[str, str],
    scale: float | None,
    two_turns: pl.DataFrame,
    tmp_path: Path,
) -> None:
    log = written(two_turns, tmp_path / "log.csv", accel=accel, gyro=gyro, digits=digits)
    draft, faults = new_session(tmp_path / "session", log)
    assert (draft.log[ACCEL]["unit"], draft.log[GYRO]["unit"]) == units
    assert draft.log[GYRO].get("scale") == scale
    assert not faults


@pytest.mark.parametrize(
    ("order", "sign", "said"),
    [
        (("gy", "gx", "gz"), -1.0, "the gyro columns x and y are exchanged and the sign of gyro z is wrong"),
        (("gy", "gz", "gx"), 1.0, "the gyro columns are in the order y, z, x"),
    ],
)
def test_gyros_whose_columns_are_exchanged_are_told_and_said(
    order: tuple[str, ...], sign: float, said: str, two_turns: pl.DataFrame, tmp_path: Path
) -> None:
    columns = dict(zip(("gx", "gy", "gz"), order, strict=True))
    exchanged = two_turns.with_columns(pl.col(column).alias(name) for name, column in columns.items())
    exchanged = exchanged.with_columns(pl.col("gz") * sign)
    log = written(exchanged, tmp_path / "log.csv", gyro=1.0 / DEGREE)
    draft, faults = new_session(tmp_path / "session", log)
    assert draft.log[GYRO]["unit"] == "deg/s"
    assert "only where the gyro columns" in faults[0]
    assert said in faults[0]


def test_counts_without_a_time_are_said_with_the_rates_that_would_fit_too(
    two_turns: pl.DataFrame, tmp_path: Path
) -> None:
    log = written(two_turns.drop("t").with_columns(t=pl.lit(0.0)), tmp_path / "log.csv", gyro=131.0 / DEGREE, digits=0)
    draft, _ = new_session(tmp_path / "session", log)
    assert any("rate_hz" in said and "from the turns" in said for said in draft.remarks)
    assert "scale" not in draft.log[GYRO]
    (doubt,) = draft.doubts
    fitting = re.findall(r"([\d.]+) per deg/s at ([\d.]+) Hz", doubt)
    assert len(fitting) == 3
    assert float(fitting[0][0]) * float(fitting[0][1]) == pytest.approx(131.0 * 50.0, rel=0.06)
    assert doubt.endswith("the accelerometers alone are calibrated, state --sample-rate")
    stated, _ = new_session(tmp_path / "stated", log, Given(sample_rate=50.0))
    assert stated.log[GYRO]["scale"] == 131.0
