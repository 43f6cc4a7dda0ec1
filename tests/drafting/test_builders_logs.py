"""Logs as builders have them, from the file to numbers beside the truth of a simulated device: no option beyond the
place. What is rounded to counts is so, and what is lost is lost; no value is off by more than five times its stated
uncertainty."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from datetime import datetime, timedelta
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
from tumble.recording.formats import PX4_CORRECTED
from tumble.units import DEGREE, G_STANDARD, Array

G, D = 1.0 / G_STANDARD, 1.0 / DEGREE
NAMES = "ax,ay,az,gx,gy,gz"
PLACE = ("--latitude", "56.84", "--height", "270")
START = datetime(2026, 6, 15, 23, 59, 30)


@pytest.fixture(scope="module")
def device() -> tuple[Array, dict[str, float]]:
    """Times, s, accelerometers, m/s², and gyros, rad/s, of twelve rests by hand, and the device's parameters."""
    folder = session(Setup.of(grade="mems", positions=12), seed=4)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    return pl.read_parquet(folder / "log.parquet").to_numpy()[::2, :7], truth


def table(
    path: Path, header: str, *columns: Array, digits: int = 8, delimiter: str = ",", times: list[str] | None = None
) -> Path:
    """A text file with a row a sample."""
    numbers = np.column_stack(columns)
    cells = [[f"{x:.{digits}g}" for x in row] for row in numbers.tolist()]
    if times is not None:
        cells = [[time, *row] for time, row in zip(times, cells, strict=True)]
    lines = [header] * bool(header) + [delimiter.join(row) for row in cells]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def counts(rows: Array) -> Array:
    """As an MPU-6050 has them at 4 g and 500 °/s."""
    return np.rint(np.column_stack([rows[:, 1:4] * 8192.0 * G, rows[:, 4:7] * 65.5 * D]))


def dates(rows: Array, written: str, cut: int | None = None) -> list[str]:
    return [(START + timedelta(seconds=t)).strftime(written)[:cut] for t in rows[:, 0].tolist()]


def plain(folder: Path, rows: Array) -> Path:
    return table(folder / "log.csv", f"t,{NAMES}", rows)


def in_g_and_ms(folder: Path, rows: Array) -> Path:
    names = "timestamp_ms,AccX,AccY,AccZ,GyrX,GyrY,GyrZ"
    time = np.rint(1e3 * rows[:, 0] + 73512.0)
    return table(folder / "LOG001.TXT", names, time, rows[:, 1:4] * G, rows[:, 4:7] * D)


def of_st(folder: Path, rows: Array) -> Path:
    axes = ",".join(f"A_{a} [mg]" for a in "XYZ") + "," + ",".join(f"G_{a} [mdps]" for a in "XYZ")
    read = np.rint(np.column_stack([rows[:, 1:4] * 1e3 * G, rows[:, 4:7] * 1e3 * D]))
    return table(folder / "log.csv", f"T [ms],{axes}", np.rint(1e3 * rows[:, 0]), read)


def printed_counts(folder: Path, rows: Array) -> Path:
    return table(folder / "putty.log", "", counts(rows), delimiter=" ")


def counts_at_micros(folder: Path, rows: Array) -> Path:
    return table(folder / "log.csv", f"micros,{NAMES}", np.rint(1e6 * rows[:, 0]) % 2**32, counts(rows), digits=12)


def counter_starts_anew(folder: Path, rows: Array) -> Path:
    time = (np.rint(1e6 * rows[:, 0]) + 2**32 - 4e7) % 2**32
    return table(folder / "log.csv", f"micros,{NAMES}", time, rows[:, 1:], digits=12)


def of_a_german_office(folder: Path, rows: Array) -> Path:
    names = ["Zeit [s]", *(f"Beschl_{a} [g]" for a in "XYZ"), *(f"Drehrate_{a} [°/s]" for a in "XYZ")]
    read = np.column_stack([rows[:, 0], rows[:, 1:4] * G, rows[:, 4:7] * D])
    lines = [";".join(names), *(";".join(f"{x:.6f}".replace(".", ",") for x in row) for row in read.tolist())]
    (folder / "Messung.csv").write_text("\r\n".join(lines) + "\r\n", encoding="cp1252")
    return folder / "Messung.csv"


def units_below_names(folder: Path, rows: Array) -> Path:
    header = "Time\tAx\tAy\tAz\tGx\tGy\tGz\ns\tm/s^2\tm/s^2\tm/s^2\tdeg/s\tdeg/s\tdeg/s"
    return table(folder / "log.txt", header, rows[:, :4], rows[:, 4:7] * D, delimiter="\t")


def iso_dates(folder: Path, rows: Array) -> Path:
    return table(folder / "log.csv", f"datetime,{NAMES}", rows[:, 1:], times=dates(rows, "%Y-%m-%dT%H:%M:%S.%f"))


def times_of_day(folder: Path, rows: Array) -> Path:
    return table(folder / "log.csv", f"time,{NAMES}", rows[:, 1:], times=dates(rows, "%H:%M:%S.%f", 12))


def without_times(folder: Path, rows: Array) -> Path:
    return table(folder / "log.csv", NAMES, rows[:, 1:])


def header_after_comments(folder: Path, rows: Array) -> Path:
    header = f"# board: nano 33\n# sample rate: 50 Hz\n#\n# {NAMES.replace(',', ', ')}"
    return table(folder / "log.txt", header, rows[:, 1:], delimiter=", ")


def with_magnetometer_and_temperature(folder: Path, rows: Array) -> Path:
    field = 40.0 * rows[:, 1:4] * G + np.array([3.0, -8.0, 12.0])
    names = f"t,{NAMES},mx,my,mz,temp"
    return table(folder / "log.csv", names, rows, field, 24.0 + 0.001 * rows[:, :1])


def with_quaternions(folder: Path, rows: Array) -> Path:
    around = np.column_stack([rows[:, 1:4], np.full(len(rows), 3.0)])
    around /= np.linalg.norm(around, axis=1)[:, None]
    return table(
        folder / "log.csv",
        f"t,qw,qx,qy,qz,roll,pitch,yaw,{NAMES}",
        rows[:, :1],
        around,
        90 * around[:, :3],
        rows[:, 1:],
    )


def two_imus(folder: Path, rows: Array) -> Path:
    first = ",".join(f"{k}1_{a}" for k in ("acc", "gyr") for a in "xyz")
    return table(folder / "log.csv", f"t,{first},{first.replace('1', '2')}", rows, 1.01 * rows[:, 1:] + 0.01)


def axes_in_another_order(folder: Path, rows: Array) -> Path:
    return table(folder / "log.csv", "gz,gy,gx,az,ay,ax,t", rows[:, ::-1])


def behind_the_start_of_a_board(folder: Path, rows: Array) -> Path:
    header = f"ets Jul 29 2019 12:21:46\nrst:0x1 (POWERON_RESET)\nMPU6050 found!\nt,{NAMES}"
    return table(folder / "serial.log", header, rows)


def named_values(folder: Path, rows: Array) -> Path:
    lines = [
        " ".join(f"{name}={x:.6g}" for name, x in zip(["t", *NAMES.split(",")], row, strict=True))
        for row in rows.tolist()
    ]
    (folder / "serial.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder / "serial.txt"


def objects_of_json(folder: Path, rows: Array) -> Path:
    lines = [
        json.dumps({"ts": round(t, 6), "acc": a, "gyro": g})
        for t, a, g in ((r[0], r[1:4], r[4:]) for r in rows.tolist())
    ]
    (folder / "log.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder / "log.jsonl"


def rows_of_a_sensor_each(folder: Path, rows: Array) -> Path:
    lines = []
    for t, *r in rows.tolist():
        lines.append(f"ACC,{1e3 * t:.0f},{r[0]:.6f},{r[1]:.6f},{r[2]:.6f}")
        lines.append(f"GYR,{1e3 * t:.0f},{r[3]:.7f},{r[4]:.7f},{r[5]:.7f}")
    (folder / "log.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder / "log.csv"


def files_of_a_phone(folder: Path, rows: Array) -> Path:
    for name, values in (("TotalAcceleration", rows[:, 1:4]), ("Gyroscope", rows[:, 4:7])):
        times = 1e9 * (1.78e9 + rows[:, 0])
        table(folder / f"{name}.csv", "time,seconds_elapsed,z,y,x", times, rows[:, 0], values[:, ::-1], digits=19)
    return folder


def with_lost_samples(folder: Path, rows: Array) -> Path:
    kept = np.random.default_rng(5).random(len(rows)) > 0.01
    kept[2000:2060] = False
    return table(folder / "log.csv", f"t,{NAMES}", rows[kept])


def of_a_buffer(folder: Path, rows: Array) -> Path:
    """Eight samples are read at once, and have the time when they are."""
    time = rows[np.minimum(np.arange(len(rows)) // 8 * 8 + 7, len(rows) - 1), 0]
    return table(folder / "log.csv", f"t,{NAMES}", np.round(time, 3), rows[:, 1:])


def whole_seconds(folder: Path, rows: Array) -> Path:
    return table(folder / "log.csv", f"time,{NAMES}", rows[:, 1:], times=dates(rows, "%H:%M:%S"))


def of_a_vehicle(folder: Path, rows: Array) -> Path:
    names = "t,LongAcc_g,LatAcc_g,VertAcc_g,RollRate,PitchRate,YawRate"
    return table(folder / "log.csv", names, rows[:, :1], rows[:, 1:4] * G, rows[:, 4:7] * D)


def tuples_of_python(folder: Path, rows: Array) -> Path:
    lines = [str((t, tuple(r[:3]), tuple(r[3:]))) for t, *r in rows.tolist()]
    (folder / "log.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder / "log.txt"


def array_of_numpy(folder: Path, rows: Array) -> Path:
    """In a file whose name is that of accelerometers."""
    np.save(folder / "a.npy", rows)
    return folder / "a.npy"


def newest_first(folder: Path, rows: Array) -> Path:
    return table(folder / "log.csv", f"t,{NAMES}", rows[::-1])


def newest_first_by_the_clock(folder: Path, rows: Array) -> Path:
    back = rows[::-1]
    return table(folder / "log.csv", f"time,{NAMES}", back[:, 1:], times=dates(back, "%H:%M:%S.%f", 12))


def in_minutes(folder: Path, rows: Array) -> Path:
    return table(folder / "log.csv", f"Time (min),{NAMES}", rows[:, 0] / 60.0, rows[:, 1:], digits=12)


def in_hours_without_a_unit(folder: Path, rows: Array) -> Path:
    return table(folder / "log.csv", f"time,{NAMES}", rows[:, 0] / 3600.0, rows[:, 1:], digits=14)


def a_time_for_each_sensor(folder: Path, rows: Array) -> Path:
    """As phyphox exports one table of sensors at rates of their own: the shorter columns end in empty cells."""
    names = [f"Time (s),{kind} x ({u}),{kind} y ({u}),{kind} z ({u})" for kind, u in
             (("Acceleration", "m/s^2"), ("Gyroscope", "rad/s"))]  # fmt: skip
    accel, gyro = rows[::2, :4], np.column_stack([rows[:, 0] + 0.003, rows[:, 4:]])
    lines = []
    for k, of_gyro in enumerate(gyro.tolist()):
        of_accel = [f"{x:.9g}" for x in accel[k]] if k < len(accel) else [""] * 4
        lines.append(",".join([*of_accel, *(f"{x:.9g}" for x in of_gyro)]))
    (folder / "log.csv").write_text("\n".join([",".join(names), *lines]) + "\n", encoding="utf-8")
    return folder / "log.csv"


def devices_one_after_the_other(folder: Path, rows: Array) -> Path:
    return two_devices(folder / "log.csv", "TimeUS,I", rows, devices_first=True)


def devices_in_turn(folder: Path, rows: Array) -> Path:
    return two_devices(folder / "log.csv", "TimeUS,id", rows)


def devices_without_a_name(folder: Path, rows: Array) -> Path:
    return two_devices(folder / "log.csv", "micros,k", rows)


def two_devices(path: Path, first: str, rows: Array, *, devices_first: bool = False) -> Path:
    """Rows of two devices 40 µs apart, the second with other errors; the number of each is the second column."""
    time = np.rint(1e6 * rows[:, 0]) + 4e7
    each = np.column_stack([time, np.full(len(rows), 3.0), rows[:, 1:]])
    other = np.column_stack([time + 40.0, np.full(len(rows), 7.0), 0.9 * rows[:, 1:] + 0.05])
    both = np.concatenate([each, other])
    return table(path, f"{first},{NAMES}", both if devices_first else both[np.argsort(both[:, 0])], digits=12)


def rows_of_one_kind(folder: Path, rows: Array) -> Path:
    """As Android's events are merged: blanks for the sensors that a row is not of."""
    lines = ["time,accX,accY,accZ,gyroX,gyroY,gyroZ"]
    for t, *read in rows.tolist():
        accel, gyro = ([f"{x:.9g}" for x in part] for part in (read[:3], read[3:]))
        lines += [f"{t:.4f},{','.join(accel)},,,", f"{t + 0.003:.4f},,,,{','.join(gyro)}"]
    (folder / "log.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder / "log.csv"


def joined_at_two_rates(folder: Path, rows: Array) -> Path:
    """Frames joined by their times: nulls in each second row of the accelerometers, and rows of a magnetometer."""
    names = ["t", *NAMES.split(",")]
    accel, gyro = (
        pl.DataFrame(rows[::2, :4], schema=names[:4]),
        pl.DataFrame(rows[:, [0, 4, 5, 6]], schema=["t", *names[4:]]),
    )
    field = pl.DataFrame(rows[::10, :1] + [0.002, 20.0, 0.0, -40.0], schema=["t", "mx", "my", "mz"])
    both = accel.join(gyro, on="t", how="full", coalesce=True).join(field, on="t", how="full", coalesce=True)
    both.sort("t").write_parquet(folder / "log.parquet")
    return folder / "log.parquet"


LOGS: list[Callable[[Path, Array], Path]] = [
    plain, in_g_and_ms, of_st, counts_at_micros, counter_starts_anew, of_a_german_office,
    units_below_names, iso_dates, times_of_day, without_times, header_after_comments, with_magnetometer_and_temperature,
    with_quaternions, two_imus, axes_in_another_order, behind_the_start_of_a_board, named_values, objects_of_json,
    rows_of_a_sensor_each, files_of_a_phone, with_lost_samples, of_a_buffer, whole_seconds, of_a_vehicle,
    tuples_of_python, array_of_numpy, newest_first, newest_first_by_the_clock, in_minutes,
    in_hours_without_a_unit, a_time_for_each_sensor,
    devices_one_after_the_other, devices_in_turn, devices_without_a_name, rows_of_one_kind,
    joined_at_two_rates,
]  # fmt: skip


@pytest.mark.parametrize("written", LOGS, ids=lambda written: written.__name__)
def test_from_the_file_to_the_truth(
    written: Callable[[Path, Array], Path], device: tuple[Array, dict[str, float]], tmp_path: Path
) -> None:
    rows, truth = device
    (tmp_path / "logs").mkdir()
    log = written(tmp_path / "logs", rows)
    done = CliRunner().invoke(main, ["calibrate", str(log), *PLACE, "-o", str(tmp_path / "c.json"), "--json"])
    assert done.exit_code == 0, done.stderr
    found = json.loads((tmp_path / "c.json").read_text(encoding="utf-8"))["parameters"]
    off = {p["name"]: (p["value"] - truth[p["name"]]) / p["u"] for p in found if p["name"] in truth}
    assert {"accel.scale.x", "gyro.scale.x"} <= off.keys()
    assert max(map(abs, off.values())) < 5.0, off


def test_counts_printed_without_times_need_the_rate_for_the_gyros_alone(
    device: tuple[Array, dict[str, float]], tmp_path: Path
) -> None:
    """65.5 counts at 50 Hz and 32.8 at 100 Hz turn alike: both cannot be accepted."""
    rows, truth = device
    log = printed_counts(tmp_path, rows)
    for rate, kinds in ((), {"accel"}), (("--sample-rate", "50"), {"accel", "gyro"}):
        done = CliRunner().invoke(main, ["calibrate", str(log), *PLACE, *rate, "--json"])
        assert done.exit_code == 0, done.stderr
        found = [p for p in json.loads(done.stdout)["parameters"] if p["name"] in truth]
        assert {p["name"].partition(".")[0] for p in found} == kinds
        assert max(abs(p["value"] - truth[p["name"]]) / p["u"] for p in found) < 5.0


@pytest.mark.parametrize(("name", "message", "taken"), [("I", None, "I.3"), ("imu_id", "imu_id.7", "imu_id.7")])
def test_one_of_several_devices_is_taken_and_the_others_are_said(
    device: tuple[Array, dict[str, float]], name: str, message: str | None, taken: str, tmp_path: Path
) -> None:
    log = two_devices(tmp_path / "log.csv", f"TimeUS,{name}", device[0])
    draft, _ = new_session(tmp_path / "s", log, Given(message=message))
    other = {"I.3": "I.7", "imu_id.7": "imu_id.3"}[taken]
    said = (
        f"several devices by column {name!r}, of which {taken} is taken; also there, and not used: {other} (--message"
    )
    assert any(remark.startswith(said) for remark in draft.remarks)
    with pytest.raises(InputError, match=f"expected a message 'x', found {name}.3, {name}.7"):
        new_session(tmp_path / "x", log, Given(message="x"))


@pytest.mark.parametrize(
    ("accel", "gyro", "groups"),
    [
        ("{}_a{}", "{}_g{}", ("left", "right")),
        ("{}.acc.{}", "{}.gyro.{}", ("imu0", "imu1")),
        ("{}_linear_acceleration_{}", "{}_angular_velocity_{}", ("primary", "secondary")),
        ("a{1}_{0}", "g{1}_{0}", ("front", "rear")),
        ("a{1}{0}", "g{1}{0}", ("1", "2")),
    ],
)
@pytest.mark.parametrize("message", [False, True])
def test_one_of_several_groups_by_the_names_of_columns_is_taken(
    accel: str,
    gyro: str,
    groups: tuple[str, str],
    message: bool,
    device: tuple[Array, dict[str, float]],
    tmp_path: Path,
) -> None:
    """The gyros of the second are before those of the first."""
    rows, _ = device
    first, second = ([name.format(k, axis) for name in (accel, gyro) for axis in "xyz"] for k in groups)
    other = np.column_stack([-rows[:, 2], rows[:, 1], rows[:, 3], -rows[:, 5], rows[:, 4], rows[:, 6]])
    names = ["t", *first[:3], *second, *first[3:], "T", f"temp_{groups[1]}"]
    columns = np.column_stack([rows[:, :4], other, rows[:, 4:], rows[:, :1] * 0.0 + 20.0, rows[:, :1] * 0.0 + 30.0])
    taken, unused = groups[::-1] if message else groups
    log = table(tmp_path / "log.csv", ",".join(names), columns)
    draft, faults = new_session(tmp_path / "s", log, Given(message=taken if message else None))
    assert [draft.log["accel"]["columns"], draft.log["gyro"]["columns"]] == (
        [second[:3], second[3:]] if message else [first[:3], first[3:]]
    )
    assert draft.log["temperature"]["columns"] == ["T"]
    assert not faults
    said = f"of which {taken} is taken; also there, and not used: {unused} (--message takes another)"
    assert any(remark.endswith(said) for remark in draft.remarks)
    with pytest.raises(InputError, match=f"expected a message 'x', found {groups[0]}, {groups[1]}"):
        new_session(tmp_path / "x", log, Given(message="x"))


@pytest.mark.parametrize(("limit", "columns"), [(-32768, range(6)), (32767, [4]), (-(2**31), range(3, 6))])
def test_integers_that_stand_for_no_reading_are_lost_samples(
    limit: int, columns: Sequence[int], device: tuple[Array, dict[str, float]], tmp_path: Path
) -> None:
    readings = counts(device[0])
    lost = np.arange(100, len(readings), 97)
    for row in range(3):  # several in a row
        readings[np.ix_(lost + row, np.array(columns))] = limit
    draft, faults = new_session(
        tmp_path / "s", table(tmp_path / "l.csv", f"t,{NAMES}", device[0][:, 0], readings, digits=12)
    )
    assert (draft.log["accel"]["scale"], draft.log["gyro"]["scale"]) == (8192.0, 65.5)
    assert not faults
    assert any(f"{limit} in {3 * len(lost)} rows" in r and "stand for no reading" in r for r in draft.remarks)
    written = pl.read_parquet(draft.files[0]).select(NAMES.split(",")).to_numpy()
    np.testing.assert_array_equal(np.isnan(written), readings == limit)


@pytest.mark.parametrize("gain", [8.0, 40.0])
def test_turns_beyond_the_range_are_clipped_and_not_lost(
    gain: float, device: tuple[Array, dict[str, float]], tmp_path: Path
) -> None:
    readings = counts(device[0])
    readings[:, 3:] = np.clip(gain * 131.0 / 65.5 * readings[:, 3:], -32768.0, 32767.0).round()
    _, faults = new_session(
        tmp_path / "s", table(tmp_path / "l.csv", f"t,{NAMES}", device[0][:, 0], readings, digits=12)
    )
    assert sum("is clipped" in fault for fault in faults) == 3


@pytest.mark.parametrize("twice", [lambda rows: np.repeat(rows, 2, axis=0), lambda rows: np.concatenate([rows, rows])])
@pytest.mark.parametrize("rate", [None, 50.0])
def test_rows_that_are_twice_in_a_log_are_read_once(
    twice: Callable[[Array], Array], rate: float | None, device: tuple[Array, dict[str, float]], tmp_path: Path
) -> None:
    rows = device[0]
    draft, faults = new_session(
        tmp_path / "s", table(tmp_path / "l.csv", f"t,{NAMES}", twice(rows)), Given(sample_rate=rate)
    )
    assert not faults
    assert draft.rate == pytest.approx(50.0)
    assert draft.times.stamped
    said = f"rows: {len(rows)} of {2 * len(rows)} are in the log twice, with the same time and readings: left out"
    assert said in draft.remarks


@pytest.mark.parametrize(("name", "rows_each"), [("k", 1), ("k", 300), ("id", 300), ("id", 100_000)])
def test_labels_and_states_of_one_log_separate_no_devices(
    device: tuple[Array, dict[str, float]], name: str, rows_each: int, tmp_path: Path
) -> None:
    rows, _ = device
    state = np.arange(float(len(rows))) // min(rows_each, len(rows) // 2 + 1) % 2
    draft, _ = new_session(
        tmp_path / "s", table(tmp_path / "l.csv", f"t,{name},{NAMES}", rows[:, 0], state, rows[:, 1:])
    )
    assert draft.files == (tmp_path / "l.csv",)


def test_gyros_beside_acceleration_without_gravity_are_not_calibrated_alone(
    device: tuple[Array, dict[str, float]], tmp_path: Path
) -> None:
    names = "t,userAccelX,userAccelY,userAccelZ,gx_dps,gy_dps,gz_dps"
    done = CliRunner().invoke(main, ["calibrate", str(table(tmp_path / "log.csv", names, device[0]))])
    assert done.exit_code == 2
    assert "found linear acceleration, which a filter has taken gravity off (userAccelX, userAccelY" in done.stderr


@pytest.mark.parametrize("names", ["gyro_rad_{}", "gyr{} [rad/s]"])
def test_gyros_in_degrees_under_names_of_radians_are_refused_with_the_unit_that_fits(
    device: tuple[Array, dict[str, float]], names: str, tmp_path: Path
) -> None:
    """A clock in microseconds stays one: no rate of thousands of hertz is made up for the name."""
    rows, _ = device
    header = ",".join(["timestamp", *(f"acc_{a}_m_s2" for a in "xyz"), *(names.format(a) for a in "xyz")])
    log = table(
        tmp_path / "log.csv", header, np.rint(1e6 * rows[:, 0] + 4e7), rows[:, 1:4], rows[:, 4:7] * D, digits=12
    )
    done = CliRunner().invoke(main, ["calibrate", str(log), *PLACE])
    assert done.exit_code == 1
    assert 'the unit of [log.gyro] is not "rad/s", "deg/s" would fit' in done.stderr


@pytest.mark.parametrize("name", ["time", "time (us)"])
def test_a_black_box_with_quotes_and_blanks_is_doubted_for_what_the_board_has_applied(
    device: tuple[Array, dict[str, float]], name: str, tmp_path: Path
) -> None:
    rows, _ = device
    names = ["loopIteration", name, *(f"{kind}[{i}]" for kind in ("gyroADC", "accSmooth") for i in range(3))]
    read = np.rint(np.column_stack([rows[:, 4:7] * D, rows[:, 1:4] * 2048.0 * G]))
    time = np.rint(1e6 * rows[:, 0] + 4e7)
    header = ", ".join(f'"{each}"' for each in names)
    log = table(tmp_path / "LOG1.01.csv", header, np.arange(float(len(rows))), time, read, digits=12, delimiter=", ")
    done = CliRunner().invoke(main, ["calibrate", str(log), *PLACE])
    assert done.exit_code == 0, done.stderr
    assert "remark: doubt: Betaflight has corrected accSmooth by align_board_*" in done.stdout
    exported = CliRunner().invoke(
        main,
        ["export", str(tmp_path / "LOG1.01-session" / "calibration.json"), "--to", "inav", "-o", str(tmp_path / "i")],
    )
    assert exported.exit_code == 0, exported.stderr
    assert "# doubt: Betaflight has corrected accSmooth" in (tmp_path / "i").read_text(encoding="utf-8")


def test_readings_that_px4_has_not_corrected_are_not_doubted(
    device: tuple[Array, dict[str, float]], tmp_path: Path
) -> None:
    rows, _ = device
    names = ["timestamp", *(f"gyro_rad[{i}]" for i in range(3)), *(f"accelerometer_m_s2[{i}]" for i in range(3))]
    names += ["accel_calibration_count", "gyro_calibration_count"]
    for count in (0, 1):
        counters = np.full((len(rows), 2), count)
        columns = np.rint(1e6 * rows[:, 0]), rows[:, 4:7], rows[:, 1:4], counters
        log = table(tmp_path / f"{count}.csv", ",".join(names), *columns, digits=12)
        draft, _ = new_session(tmp_path / f"s{count}", log)
        assert draft.doubts == ((PX4_CORRECTED,) if count else ())
