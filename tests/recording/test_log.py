"""Logs: numbers read as Python reads them, the same for every format and chunk size; lost samples bridged and
reported; everything else refused with file, row and column."""

from __future__ import annotations

import gzip
import hashlib
import math
import sys
import tracemalloc
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tumble.errors import InputError, LogError
from tumble.recording import readers
from tumble.recording.log import Chunk, Log, open_log
from tumble.recording.rows import gaps as bridging
from tumble.recording.rows import timed as timed_rows
from tumble.recording.rows.gaps import Gap
from tumble.recording.session import Session
from tumble.recording.session_file import description_of, read_session, write_session
from tumble.recording.text import pieces as text_pieces
from tumble.recording.text.dialect import Dialect
from tumble.recording.text.text_log import TextLog
from tumble.reduction.blocks.reducer import reduce_log
from tumble.run.observed import inspect_session
from tumble.units import Array

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

NAMES = ["t", "ax", "ay", "az", "gx", "gy", "gz", "T"]
ROWS = 300
INTERVAL = 0.01
Lines = list[list[str]]

RAMP = {"ax": (9.8, 0.003), "ay": (-1.0, 0.002), "az": (0.5, -0.001), "gx": (0.1, 1e-4), "gy": (0.0, 2e-4)}
RAMP |= {"gz": (-0.2, -3e-4), "T": (25.0, 0.01)}
"""Value at row 0 and slope per row of every column: what is linear is interpolated without error."""


def lines(rows: int = ROWS) -> Lines:
    """A good log, 100 Hz, linear in time: header and rows, as text."""
    out = [NAMES.copy()]
    for row in range(1, rows + 1):
        values = [f"{first + slope * row:.6f}" for first, slope in RAMP.values()]
        out.append([f"{row * INTERVAL:.2f}", *values])
    return out


def text(table: Lines, end: str = "\n") -> str:
    return "".join(",".join(row) + end for row in table)


def content(file: str | list[str], **log: Any) -> dict[str, Any]:
    base: dict[str, Any] = {
        "file": file,
        "time": "t",
        "accel": {"columns": ["ax", "ay", "az"], "unit": "m/s^2"},
        "gyro": {"columns": ["gx", "gy", "gz"], "unit": "rad/s"},
        "temperature": {"columns": ["T"]},
    }
    keys = {key: value for key, value in (base | log).items() if value is not None}
    return {"format": 1, "device": {"serial": "A"}, "log": keys}


def opened(folder: Path, file: str | list[str] = "log.csv", **log: Any) -> Log:
    write_session(folder, content(file, **log))
    return open_log(read_session(folder))


def csv_log(folder: Path, table: Lines, **log: Any) -> Log:
    (folder / "log.csv").write_text(text(table), encoding="utf-8")
    return opened(folder, **log)


def numbers(table: Lines) -> pl.DataFrame:
    columns = {name: [float(row[j]) for row in table[1:]] for j, name in enumerate(table[0])}
    return pl.DataFrame(columns, schema=dict.fromkeys(table[0], pl.Float64))


def parquet_log(folder: Path, frame: pl.DataFrame, **log: Any) -> Log:
    frame.write_parquet(folder / "log.parquet")
    return opened(folder, "log.parquet", **log)


def whole(log: Log, rows: int = 65536) -> dict[str, Array]:
    """All chunks put together."""
    chunks = list(log.chunks(rows))
    out = {name: np.concatenate([getattr(c, name) for c in chunks]) for name in ("time", "dt", "accel")}
    for name in ("gyro", "temperature"):
        if getattr(chunks[0], name) is not None:
            out[name] = np.concatenate([getattr(c, name) for c in chunks])
    return out


def equal_to_the_bit(a: dict[str, Array], b: dict[str, Array]) -> bool:
    return a.keys() == b.keys() and all(a[k].tobytes() == b[k].tobytes() for k in a)


def refusal(read: Callable[[], object]) -> str:
    with pytest.raises(LogError) as caught:
        read()
    said = str(caught.value)
    assert "\n" not in said
    return said


# -------------------- what is refused --------------------


def with_value(row: int, column: str, value: str) -> Callable[[Lines], Lines]:
    return with_values(range(row, row + 1), column, value)


def with_values(rows: Sequence[int], column: str, value: str) -> Callable[[Lines], Lines]:
    def change(table: Lines) -> Lines:
        for row in rows:
            table[row][NAMES.index(column)] = value
        return table

    return change


def without(rows: Sequence[int]) -> Callable[[Lines], Lines]:
    return lambda table: [line for row, line in enumerate(table) if row not in rows]


def renamed(**names: str) -> Callable[[Lines], Lines]:
    return lambda table: [[names.get(name, name) for name in table[0]], *table[1:]]


def with_row(row: int, values: list[str]) -> Callable[[Lines], Lines]:
    return lambda table: [*table[:row], values, *table[row + 1 :]]


# name: (what is changed in a good CSV log, what the message says after the file's path)
CSV_FAULTS: dict[str, tuple[Callable[[Lines], Lines], str]] = {
    "missing column": (
        renamed(az="acc_z", ay="a_y"),
        ": expected a column 'ay', found t, ax, a_y, acc_z, gx, gy, gz, T; did you mean 'a_y'?",
    ),
    "semicolons": (
        lambda table: [[";".join(line)] for line in table],
        ": expected a column 't', found t;ax;ay;az;gx;gy;gz;T",
    ),
    "column twice": (renamed(gz="ax"), ": expected a column 'ax', found t, 2, ay, az, gx, gy, 7, T"),
    "text in the first row": (with_value(1, "t", "12:30"), ": row 1 (line 2), column 't': expected a number"),
    "empty value in the first row": (
        with_value(1, "az", ""),
        ": row 1 (line 2), column 'az': expected a number, found an empty value",
    ),
    "text in ten rows": (
        with_values(range(20, 220, 20), "t", "?"),
        ": row 20 (line 21): expected at most 2% of the rows and 3 to be left out, found 10 of 300, the first here",
    ),
    "nan as ten times": (
        with_values(range(20, 220, 20), "t", "nan"),
        ": row 20 (line 21): expected at most 2% of the rows and 3 to be left out, found 10 of 300, the first here (an "
        "empty value in 't': left out)",
    ),
    "header only": (lambda table: table[:1], ": expected a log, found no rows; the file is empty"),
    "49 samples": (lambda table: table[:50], ": expected at least 50 samples, found 49"),
    "less than 2 s": (lambda table: table[:200], ": expected at least 2 s, found 1.99 s"),
    "every time repeated": (
        lambda table: [table[0], *([f"{0.02 * (i // 2):.2f}", *line[1:]] for i, line in enumerate(table[1:]))],
        ": row 2 (line 3), column 't': expected a time after 0 s, found 0 s again; if the rows are equally spaced "
        "whatever their time stamps say, put regular = true in [log], or with arrays give rate= instead of time=",
    ),
    "clock started anew": (
        lambda table: [*table[:250], *table[1:52]],
        ": row 250 (line 251), column 't': expected a time after 2.49 s, found 0.01 s running backwards; list "
        "recordings whose time restarts as separate files",
    ),
    "first row too long": (
        lambda table: with_row(1, [*table[1], "1"])(table),
        ": row 1 (line 2): expected 8 values, one per column, found 9",
    ),
}


@pytest.mark.parametrize("name", CSV_FAULTS)
def test_fault_of_a_csv_log_is_named_with_its_place_however_the_file_is_cut(name: str, tmp_path: Path) -> None:
    change, said = CSV_FAULTS[name]
    (tmp_path / "log.csv").write_text(text(change(lines())), encoding="utf-8")
    write_session(tmp_path, content("log.csv"))
    session = read_session(tmp_path)
    for size in (1 << 18, 60):
        with mock.patch.multiple(text_pieces, _PIECE_BYTES=size, _FIRST_PIECE_BYTES=size):
            message = refusal(lambda: whole(open_log(session)))
        assert message.startswith(f"{tmp_path / 'log.csv'}:")
        assert said in message


def test_faultless_base_reads_without_a_gap(tmp_path: Path) -> None:
    log = csv_log(tmp_path, lines())
    assert len(whole(log)["time"]) == ROWS
    assert log.gaps == ()


def test_a_log_of_which_gaps_leave_nothing_is_refused(tmp_path: Path) -> None:
    log = csv_log(tmp_path, lines())
    said = refusal(lambda: reduce_log(log, log.session.accel_block, None, [next(log.chunks(5))]))
    assert "log.csv: expected stretches of 0.1 s and longer without a gap, found none" in said


PARQUET_FAULTS: dict[str, tuple[Callable[[pl.DataFrame], pl.DataFrame], str]] = {
    "missing column": (
        lambda frame: frame.rename({"gx": "g_x"}),
        ": expected a column 'gx', found t, ax, ay, az, g_x, gy, gz, T; did you mean 'g_x'?",
    ),
    "strings": (
        lambda frame: frame.with_columns(pl.col("ay").cast(pl.String)),
        ": column 'ay': expected numbers, found the type String",
    ),
    "booleans": (lambda frame: frame.with_columns(gz=pl.col("gz") > 0), "column 'gz': expected numbers, found the"),
    "dates": (
        lambda frame: frame.with_columns(t=pl.col("t").cast(pl.Int64).cast(pl.Datetime)),
        "column 't': expected numbers, found the type Datetime",
    ),
    "no rows": (lambda frame: frame.head(0), ": expected a log, found no rows"),
    "49 rows": (lambda frame: frame.head(49), ": expected at least 50 samples, found 49"),
    "time backwards": (
        lambda frame: frame.with_columns(t=-pl.col("t")),
        ": row 2, column 't': expected a time after -0.01 s, found -0.02 s running backwards",
    ),
}


@pytest.mark.parametrize("name", PARQUET_FAULTS)
def test_fault_of_a_parquet_log_is_named_with_its_place(name: str, tmp_path: Path) -> None:
    change, said = PARQUET_FAULTS[name]
    message = refusal(lambda: whole(parquet_log(tmp_path, change(numbers(lines())))))
    assert message.startswith(f"{tmp_path / 'log.parquet'}:")
    assert said in message


@pytest.mark.parametrize(("column", "said"), [("az", "nan in 'az'"), ("t", "an empty value in 't': left out")])
def test_a_null_of_a_parquet_log_is_a_lost_sample(column: str, said: str, tmp_path: Path) -> None:
    null = pl.when(pl.arange(ROWS) == 16).then(None).otherwise(pl.col(column)).alias(column)
    log = parquet_log(tmp_path, numbers(lines()).with_columns(null))
    check_ramp(whole(log))
    assert log.gaps[0].what == said


def truncated(data: bytes) -> bytes:
    return data[: len(data) * 2 // 3]


def overwritten(data: bytes) -> bytes:
    middle = len(data) // 2
    return data[:middle] + bytes(200) + data[middle + 200 :]


DAMAGED: dict[str, tuple[str, Callable[[], bytes]]] = {
    "gz cut off": ("log.csv.gz", lambda: truncated(gzip.compress(text(lines()).encode()))),
    "gz overwritten": ("log.csv.gz", lambda: overwritten(gzip.compress(text(lines()).encode()))),
    "gz by name only": ("log.csv.gz", lambda: text(lines()).encode()),
    "zst cut off": ("log.csv.zst", lambda: truncated(zstd.compress(text(lines()).encode()))),
    "zst overwritten": ("log.csv.zst", lambda: overwritten(zstd.compress(text(lines()).encode()))),
    "zst by name only": ("log.csv.zst", lambda: text(lines()).encode()),
    "parquet by name only": ("log.parquet", lambda: text(lines()).encode()),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_file_is_told(name: str, tmp_path: Path) -> None:
    file, data = DAMAGED[name]
    (tmp_path / file).write_bytes(data())
    message = refusal(lambda: whole(opened(tmp_path, file)))
    ending = file.removeprefix("log")
    assert message.startswith(f"{tmp_path / file}: expected a readable {ending} file, found it damaged")


@pytest.mark.parametrize("part", [0.01, 0.5, 0.9, 0.999])
def test_parquet_file_that_is_cut_off_is_told(part: float, tmp_path: Path) -> None:
    log = parquet_log(tmp_path, numbers(lines()))
    path = tmp_path / "log.parquet"
    path.write_bytes(path.read_bytes()[: int(path.stat().st_size * part)])
    said = "expected a readable .parquet file, found it damaged"
    assert said in refusal(lambda: whole(log))
    assert said in refusal(lambda: open_log(log.session))


def test_parquet_file_that_lost_rows_since_it_was_opened_is_told(tmp_path: Path) -> None:
    log = parquet_log(tmp_path, numbers(lines()))
    numbers(lines(250)).write_parquet(tmp_path / "log.parquet")
    assert "log.parquet: expected 300 rows, found 250" in refusal(lambda: whole(log))


@pytest.mark.parametrize("file", ["log.csv", "log.csv.gz", "log.csv.zst", "log.parquet"])
def test_empty_file_is_told(file: str, tmp_path: Path) -> None:
    (tmp_path / file).touch()
    assert "expected a log, found an empty file" in refusal(lambda: opened(tmp_path, file))


@pytest.mark.parametrize("file", ["log.txt", "log", "log.gz", "log.parquet.gz", "csv"])
def test_other_format_is_told_with_those_that_are_read(file: str, tmp_path: Path) -> None:
    (tmp_path / file).write_text(text(lines()))
    message = refusal(lambda: opened(tmp_path, file))
    assert f"{file}: expected a file that ends in .csv, .csv.gz, .csv.zst, .parquet" in message


def test_file_without_lines_is_refused_before_it_is_in_memory(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_bytes(",".join(NAMES).encode() + b"\n" + b"1" * 3_000_000)
    assert "expected lines of numbers, found one of more than" in refusal(lambda: opened(tmp_path))


def test_files_of_different_rates_are_told(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text(lines()))
    other = [NAMES, *(line for line in lines()[1::2])]
    (tmp_path / "b.csv").write_text(text(other))
    message = refusal(lambda: opened(tmp_path, ["a.csv", "b.csv"]))
    assert "b.csv: expected the sample rate of a.csv, 100 Hz, found 50 Hz" in message


def test_chunks_have_at_least_a_row(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="rows: expected at least 1, found 0"):
        next(csv_log(tmp_path, lines()).chunks(0))


def test_archive_that_unpacks_to_a_thousand_times_its_size_is_refused_in_little_memory(tmp_path: Path) -> None:
    (tmp_path / "log.csv.gz").write_bytes(gzip.compress(",".join(NAMES).encode() + b"\n" + b"1" * 200_000_000, 9))
    tracemalloc.start()
    try:
        message = refusal(lambda: opened(tmp_path, "log.csv.gz"))
        assert "a packed file of 0.194 MB holds at most 19.4 MB, found 200 MB; if they are readings" in message
        assert tracemalloc.get_traced_memory()[1] < 1e6
    finally:
        tracemalloc.stop()


def test_archive_that_does_not_state_its_size_is_refused_while_it_is_read(tmp_path: Path) -> None:
    table = [NAMES, *([row[0], *(f"{float(value):.500f}" for value in row[1:])] for row in lines()[1:])]
    stream = zstd.ZstdCompressor()
    unstated = stream.compress(text(table).encode()) + stream.flush()
    (tmp_path / "log.csv.zst").write_bytes(unstated)
    (tmp_path / "log.csv.gz").write_bytes(gzip.compress(text(table).encode()) + gzip.compress(b"\n"))
    for file in ("log.csv.zst", "log.csv.gz"):
        log = opened(tmp_path, file)
        assert len(whole(log)["time"]) == ROWS
        with mock.patch.multiple(text_pieces, SMALL_BYTES=1 << 19, LARGEST_RATIO=1):
            message = refusal(lambda: whole(opened(tmp_path, file)))  # noqa: B023
            assert "holds at most 0.524 MB, found 1.0" in message


@pytest.mark.parametrize("names", ["t,ax,a\ry", "t," + "x" * 200_000])
def test_first_line_that_is_none_is_refused_in_one_line(names: str, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(names + "\n" + text(lines()[1:]), newline="")
    assert len(refusal(lambda: opened(tmp_path))) < 400 + len(str(tmp_path))


# -------------------- times and rates --------------------


def test_a_column_that_a_damaged_text_no_longer_has_is_named(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    text = TextLog(path=tmp_path / "log.csv", names=("a", "b"), dialect=Dialect(), top=1)
    with pytest.raises(LogError, match=r"log.csv: expected a column c, found a, b"):
        next(text.tables(["a", "c"]))


def test_interval_is_the_difference_of_time_stamps(tmp_path: Path) -> None:
    table = with_value(150, "t", "1.496")(lines())
    log = csv_log(tmp_path, table)
    samples = whole(log)
    time = np.array([float(line[0]) for line in table[1:]])
    assert samples["time"].tobytes() == time.tobytes()
    assert samples["dt"][1:].tobytes() == np.diff(time).tobytes()
    assert samples["dt"][0] == np.median(np.diff(time))
    assert log.rate == pytest.approx(100.0, rel=1e-12)


def test_rate_is_that_of_the_first_thousand_rows(tmp_path: Path) -> None:
    time = np.cumsum(np.where(np.arange(5000) < 1000, 0.01, 0.012))
    frame = pl.DataFrame({"t": time, **{name: np.zeros(5000) for name in NAMES[1:]}})
    log = parquet_log(tmp_path, frame)
    assert log.rate == pytest.approx(100.0, rel=1e-9)
    assert len(whole(log)["time"]) == 5000


def test_log_without_time_column_has_the_nominal_rate(tmp_path: Path) -> None:
    log = csv_log(tmp_path, lines(), time=None, rate_hz=128.0)
    samples = whole(log, 7)
    assert log.rate == 128.0
    assert samples["time"].tolist() == [k / 128.0 for k in range(1, ROWS + 1)]
    assert set(samples["dt"]) == {1 / 128.0}


@pytest.mark.parametrize(("unit", "in_second"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_time_unit_becomes_seconds(unit: str, in_second: float, tmp_path: Path) -> None:
    frame = numbers(lines()).with_columns(t=(pl.arange(1, ROWS + 1) * int(in_second * INTERVAL)))
    assert frame["t"].dtype.is_integer()
    samples = whole(parquet_log(tmp_path, frame, time_unit=unit))
    np.testing.assert_allclose(samples["time"], INTERVAL * np.arange(1, ROWS + 1), rtol=1e-14)
    np.testing.assert_allclose(samples["dt"], INTERVAL, rtol=1e-11)


def test_files_are_read_each_by_itself(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text(lines()))
    (tmp_path / "b.csv").write_text(text(lines(250)))
    log = opened(tmp_path, ["a.csv", "b.csv"])
    chunks = list(log.chunks(100))
    files = [chunk.file for chunk in chunks]
    assert files == sorted(files)
    assert [sum(len(c.time) for c in chunks if c.file == file) for file in (0, 1)] == [ROWS, 250]
    again = chunks[files.index(1)]
    assert again.time[0] == chunks[0].time[0]
    assert again.dt[0] == pytest.approx(INTERVAL)


def test_digest_is_that_of_all_bytes_in_order(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text(lines()))
    (tmp_path / "b.csv").write_text(text(lines(250)))
    both = (tmp_path / "a.csv").read_bytes() + (tmp_path / "b.csv").read_bytes()
    assert opened(tmp_path, ["a.csv", "b.csv"]).sha256() == hashlib.sha256(both).hexdigest()


# -------------------- numbers --------------------


def test_every_format_gives_the_same_to_the_bit(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    frame = numbers(lines()).with_columns(pl.Series(n, rng.normal(size=ROWS)) for n in NAMES[1:])
    plain = frame.write_csv().encode()
    (tmp_path / "log.csv").write_bytes(plain)
    (tmp_path / "log.csv.gz").write_bytes(gzip.compress(plain))
    (tmp_path / "log.csv.zst").write_bytes(zstd.compress(plain))
    frame.write_parquet(tmp_path / "log.parquet")
    expected = whole(opened(tmp_path))
    for j, name in enumerate(("ax", "ay", "az")):
        assert np.array_equal(expected["accel"][:, j], frame[name].to_numpy())
    for file in ("log.csv.gz", "log.csv.zst", "log.parquet"):
        assert equal_to_the_bit(whole(opened(tmp_path, file)), expected), file


def test_compressed_file_of_several_members_is_read_to_its_end(tmp_path: Path) -> None:
    plain = text(lines()).encode()
    for file, compress in (("log.csv.gz", gzip.compress), ("log.csv.zst", zstd.compress)):
        (tmp_path / file).write_bytes(compress(plain[:5000]) + compress(plain[5000:]))
        assert len(whole(opened(tmp_path, file))["time"]) == ROWS


PLAIN_NUMBERS = st.floats(-9e18, 9e18).flatmap(
    lambda x: st.sampled_from([repr(x), f"{x:.17e}", f"{x:.5g}", f"{x:+.3f}"])
)
LONG_NUMBERS = st.from_regex(r"[+-]?[0-9]{1,25}\.?[0-9]{0,25}([eE][+-]?[0-9]{1,2})?", fullmatch=True).filter(
    lambda text: abs(float(text)) <= 9e18
)


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """A session of one CSV file, which may be written anew."""
    return csv_log(tmp_path_factory.mktemp("good"), lines()).session


@settings(max_examples=60, deadline=None)
@given(st.lists(st.one_of(PLAIN_NUMBERS, LONG_NUMBERS), min_size=20, max_size=60))
def test_numbers_are_those_of_python(good: Session, values: list[str]) -> None:
    table = lines()
    for row, value in enumerate(values, 100):
        table[row][1] = value
    (file,) = good.log.files
    assert isinstance(file, Path)
    file.write_text(text(table), encoding="utf-8")
    accel = whole(open_log(good))["accel"][:, 0]
    expected = np.array([float(line[1]) for line in table[1:]])
    assert np.isfinite(expected).all()
    assert accel.tobytes() == expected.tobytes()


NO_NUMBERS = ["-9223372036854775808", "9223372036854775807", "1e19", "-1e308", "nan", "-inf"]
"""Those of a logger without a value, the first two of one that counts in 64 bits."""


@pytest.mark.parametrize("value", NO_NUMBERS)
def test_a_reading_beyond_64_bits_is_a_lost_sample(value: str, tmp_path: Path) -> None:
    log = csv_log(tmp_path, with_value(17, "ax", value)(lines()))
    check_ramp(whole(log))
    assert [gap.samples for gap in log.gaps] == [1]


@pytest.mark.parametrize("time", [{}, {"time": None, "rate_hz": 100.0}], ids=["times", "no times"])
@pytest.mark.parametrize("value", ["0", "-1"])
def test_a_row_in_which_all_sensors_read_one_number_is_lost(value: str, time: dict[str, Any], tmp_path: Path) -> None:
    """A driver that could not read the chip writes 0, or −1 in counts: three rows in motion moved a scale factor by 4
    u. The thermometer may have been read. A turn across them can be integrated, as each is a sample."""
    table = lines()
    for name in NAMES[1:7]:
        table = with_values((17, 101, 102), name, value)(table)
    log = csv_log(tmp_path, table, **time)
    check_ramp(whole(log))
    assert [(gap.row, gap.samples, gap.what) for gap in log.gaps] == [
        (17, 1, f"{value} in every column"),
        (101, 2, f"{value} in every column"),
    ]
    assert all(gap.integrable for gap in log.gaps)


@pytest.mark.parametrize("value", NO_NUMBERS)
@pytest.mark.parametrize("rows", [(1, 2, 3), (17,), (298, 299, 300)])
def test_a_row_whose_time_is_none_is_left_out(rows: tuple[int, ...], value: str, tmp_path: Path) -> None:
    """In a unit in which it could be a time."""
    table = [line if line[0] == "t" else [str(round(1e6 * float(line[0]))), *line[1:]] for line in lines()]
    log = csv_log(tmp_path, with_values(rows, "t", value)(table), time_unit="us")
    time = whole(log)["time"]
    np.testing.assert_allclose(np.diff(time), INTERVAL, rtol=0, atol=1e-9)
    assert (time[0], time[-1]) == pytest.approx((0.04 if 1 in rows else 0.01, 2.97 if 300 in rows else 3.0))
    assert sum("an empty value in 't': left out" in gap.what for gap in log.gaps) == len(rows)


@pytest.mark.parametrize("value", [" 1.5", "1.5 ", "\t1.5", '"1.5"', "+1.5", ".5", "5.", "1E3", "-0"])
def test_number_that_python_reads_is_read(value: str, tmp_path: Path) -> None:
    samples = whole(csv_log(tmp_path, with_value(17, "ax", value)(lines())))
    expected = np.float64(float(value.strip('"')))
    assert samples["accel"][16, 0].tobytes() == expected.tobytes()


@pytest.mark.parametrize("value", ["0x10", "1d5", "1;5", "1f", "None", "true", "1e", "--1", "1 2", "٫5", "²", "1_5"])
def test_what_is_no_number_is_a_lost_sample(value: str, tmp_path: Path) -> None:
    """1_5 is one in Python's own language, and in a log what is left of a date."""
    log = csv_log(tmp_path, with_value(17, "ax", value)(lines()))
    check_ramp(whole(log))
    assert log.gaps == (Gap(file=0, row=17, time=0.17, samples=1, what=f"{value!r} in 'ax'"),)
    message = refusal(lambda: whole(csv_log(tmp_path, with_value(1, "ax", value)(lines()))))
    assert f"row 1 (line 2), column 'ax': expected a number, found {value!r}" in message


@pytest.mark.parametrize(
    "change",
    [
        lambda plain: plain.replace("\n", "\r\n"),
        lambda plain: plain.removesuffix("\n"),
        lambda plain: plain + "\n\n  \n",
        lambda plain: plain.replace("\n", "\r\n") + "\r\n\r\n",
        lambda plain: "\ufeff" + plain,
        lambda plain: plain.replace(",", ", "),
        lambda plain: plain.replace(",", " ,"),
        lambda plain: plain.replace("t,ax", '"t","ax"'),
    ],
    ids=["CRLF", "no last newline", "blank end", "CRLF blank end", "BOM", "blank after", "blank before", "quotes"],
)
def test_other_ways_to_write_a_csv_file_are_the_same(change: Callable[[str], str], tmp_path: Path) -> None:
    plain = text(lines())
    expected = whole(csv_log(tmp_path, lines()))
    for size in (50, 1 << 24):
        (tmp_path / "log.csv").write_bytes(change(plain).encode())
        with mock.patch.multiple(text_pieces, _PIECE_BYTES=size, _FIRST_PIECE_BYTES=size):
            assert equal_to_the_bit(whole(opened(tmp_path)), expected)


@pytest.mark.parametrize("extra", ["", "note", '"a, b"', "naïve"])
def test_columns_that_are_not_named_do_not_matter(extra: str, tmp_path: Path) -> None:
    expected = whole(csv_log(tmp_path, lines()))
    table = [[("" if row else "note"), *line, (extra if row else "")] for row, line in enumerate(lines())]
    assert equal_to_the_bit(whole(csv_log(tmp_path, table)), expected)
    short = [*table[:17], table[17][:-1], *table[18:]]
    log = csv_log(tmp_path, short)
    check_ramp(whole(log))
    assert [gap.what for gap in log.gaps] == ["9 values: left out", "missing samples"]


def test_integer_and_single_precision_columns_are_exact(tmp_path: Path) -> None:
    frame = numbers(lines()).with_columns(
        ax=pl.arange(ROWS).cast(pl.Int16), ay=pl.arange(ROWS).cast(pl.UInt32), gz=pl.col("gz").cast(pl.Float32)
    )
    samples = whole(parquet_log(tmp_path, frame))
    assert np.array_equal(samples["accel"][:, 0], np.arange(ROWS))
    assert np.array_equal(samples["accel"][:, 1], np.arange(ROWS))
    assert samples["gyro"][:, 2].tobytes() == frame["gz"].to_numpy().astype(float).tobytes()


def test_units_of_a_log_become_si(tmp_path: Path) -> None:
    raw = csv_log(
        tmp_path,
        lines(),
        accel={"columns": ["ax", "ay", "az"], "unit": "count", "scale": [2.0, -4.0, 8.0], "offset": 1.0},
        gyro={"columns": ["gx", "gy", "gz"], "unit": "deg"},
    )
    samples = whole(raw)
    row = [float(value) for value in lines()[200]]
    expected = [(row[1] - 1) / 2, -(row[2] - 1) / 4, (row[3] - 1) / 8]
    np.testing.assert_allclose(samples["accel"][199], expected, rtol=1e-15)
    rate = np.array(row[4:7]) / 0.01 * math.pi / 180
    np.testing.assert_allclose(samples["gyro"][199], rate, rtol=1e-12)
    assert samples["temperature"][199, 0] == row[7] + 273.15


@pytest.mark.parametrize(
    ("keys", "celsius"),
    [
        ({"unit": "K"}, 300.0 - 273.15),
        ({"unit": "degF"}, (300.0 - 32.0) / 1.8),
    ],
    ids=str,
)
def test_a_thermometer_has_the_unit_that_is_said(tmp_path: Path, keys: dict[str, Any], celsius: float) -> None:
    log = csv_log(tmp_path, with_values(range(1, ROWS + 1), "T", "300")(lines()), temperature={"columns": ["T"]} | keys)
    np.testing.assert_allclose(whole(log)["temperature"], celsius + 273.15, rtol=0, atol=1e-9)
    assert description_of(log.session)["log"]["temperature"]["unit"] == keys["unit"]


def test_the_samples_of_a_sensor_are_contiguous(tmp_path: Path) -> None:
    chunk = next(parquet_log(tmp_path, numbers(lines())).chunks(100))
    assert chunk.gyro is not None
    assert chunk.accel.shape == chunk.gyro.shape == (100, 3)
    assert all(sensor.flags.c_contiguous for sensor in (*chunk.accel.T, *chunk.gyro.T))


def test_log_without_gyros_and_temperature_has_none(tmp_path: Path) -> None:
    chunk = next(csv_log(tmp_path, lines(), gyro=None, temperature=None).chunks())
    assert chunk.gyro is None
    assert chunk.temperature is None


# -------------------- lost samples --------------------


def check_ramp(samples: dict[str, Array], rows: int = ROWS) -> None:
    """Every sample is where the linear log has it: lost ones are back."""
    k = np.arange(1, rows + 1)
    np.testing.assert_allclose(samples["time"], k * INTERVAL, rtol=0, atol=1e-12)
    np.testing.assert_allclose(samples["dt"], INTERVAL, rtol=0, atol=1e-12)
    for j, name in enumerate(("ax", "ay", "az")):
        np.testing.assert_allclose(samples["accel"][:, j], RAMP[name][0] + RAMP[name][1] * k, rtol=0, atol=1e-6)
    for j, name in enumerate(("gx", "gy", "gz")):
        np.testing.assert_allclose(samples["gyro"][:, j], RAMP[name][0] + RAMP[name][1] * k, rtol=0, atol=1e-6)
    np.testing.assert_allclose(samples["temperature"][:, 0], 298.15 + 0.01 * k, rtol=0, atol=1e-6)


def test_not_finite_numbers_are_bridged_and_reported(tmp_path: Path) -> None:
    table = with_values(range(101, 106), "gx", "nan")(lines())
    table = with_value(103, "T", "-inf")(table)
    log = csv_log(tmp_path, table)
    check_ramp(whole(log))
    what = "nan in 'gx' and -inf in 'T'"
    assert log.gaps == (Gap(file=0, row=101, time=1.01, samples=5, what=what),)


def test_missing_samples_are_put_in_and_reported(tmp_path: Path) -> None:
    log = csv_log(tmp_path, without([50, 100, 101, 102, 103, 104])(lines()))
    check_ramp(whole(log))
    first, second = log.gaps
    assert (first.row, first.samples, first.what) == (50, 1, "missing samples")
    assert (second.row, second.samples, second.what) == (99, 5, "missing samples")
    assert first.time == pytest.approx(0.50, abs=1e-12)
    assert second.time == pytest.approx(1.00, abs=1e-12)


def test_missing_and_not_finite_samples_in_a_row_are_one_gap(tmp_path: Path) -> None:
    table = without([99, 101, 103])(with_values([100, 102], "az", "inf")(lines()))
    log = csv_log(tmp_path, table)
    check_ramp(whole(log))
    (gap,) = log.gaps
    assert (gap.row, gap.samples, gap.what) == (99, 5, "inf in 'az' and missing samples")


def test_sound_numbers_beside_a_lost_one_are_kept(tmp_path: Path) -> None:
    table = with_value(102, "ax", "7.25")(with_values([101, 102, 103], "gy", "nan")(lines()))
    samples = whole(csv_log(tmp_path, table))
    assert samples["accel"][101, 0] == 7.25


def test_interpolation_is_linear_in_time(tmp_path: Path) -> None:
    table = with_value(100, "t", "1.003")(with_value(100, "ax", "nan")(lines()))
    table = with_value(99, "ax", "1.0")(with_value(101, "ax", "3.0")(table))
    value = whole(csv_log(tmp_path, table))["accel"][99, 0]
    assert value == pytest.approx(1.0 + 2.0 * (1.003 - 0.99) / 0.02, rel=1e-12)


@pytest.mark.parametrize("every", [43, 3])
def test_short_gaps_are_bridged_however_many_there_are(every: int, tmp_path: Path) -> None:
    lost = list(range(100, 2000, every))
    log = csv_log(tmp_path, with_values(lost, "gz", "nan")(lines(2000)))
    check_ramp(whole(log), 2000)
    assert [gap.row for gap in log.gaps] == lost
    assert all(gap.integrable for gap in log.gaps)


def test_rows_of_a_coarse_clock_are_left_out_where_they_repeat_its_stamp(tmp_path: Path) -> None:
    """Every third row has the stamp of the row before, and the rows between have gaps."""
    table = [line for k, line in enumerate(lines(900)) if k % 5]
    stamps = [f"{math.floor(k * 0.012 * 50.0) / 50.0:.2f}" for k in range(1, len(table))]
    log = csv_log(tmp_path, [NAMES, *([t, *line[1:]] for t, line in zip(stamps, table[1:], strict=True))])
    samples = whole(log)
    assert len(samples["time"]) == len(set(stamps))
    assert {gap.what for gap in log.gaps} == {"the time stamp of the row before: left out"}


@pytest.mark.parametrize(("value", "what"), [("END", "'END' in 'T'"), ("", "an empty value in 'T'")])
def test_what_cannot_be_read_in_the_last_row_is_left_out(value: str, what: str, tmp_path: Path) -> None:
    log = csv_log(tmp_path, with_value(ROWS, "T", value)(lines()))
    check_ramp(whole(log), ROWS - 1)
    assert [(gap.row, gap.samples, gap.what) for gap in log.gaps] == [(ROWS, 1, what)]


@pytest.mark.parametrize("size", [1, 50, 1000])
@pytest.mark.parametrize("lost", [[1], [1, 2, 3], [300], [*range(280, 301)], [1, 2, 299, 300]])
def test_lost_samples_at_the_ends_are_left_out(lost: list[int], size: int, tmp_path: Path) -> None:
    log = parquet_log(tmp_path, numbers(with_values(lost, "ax", "nan")(lines())))
    with mock.patch.object(readers, "_PARQUET_ROWS", size):
        samples = whole(log)
    sound = [row for row in range(1, ROWS + 1) if row not in lost]
    np.testing.assert_allclose(samples["accel"][:, 0], RAMP["ax"][0] + RAMP["ax"][1] * np.array(sound), atol=1e-6)
    assert sum(gap.samples for gap in log.gaps) == len(lost)


def test_gaps_in_memory_are_bounded(tmp_path: Path) -> None:
    frame = pl.DataFrame({"t": np.arange(30_000) / 100, **{name: np.ones(30_000) for name in NAMES[1:]}})
    frame = frame.with_columns(ax=pl.when(pl.arange(30_000) % 2 == 1).then(math.nan).otherwise(1.0))
    log = parquet_log(tmp_path, frame)
    with mock.patch.object(readers, "_PARQUET_ROWS", 1000), mock.patch.object(bridging, "MOST_GAPS", 700):
        assert "expected at most 700 gaps in a file" in refusal(lambda: whole(log))
    assert len(log.gaps) < 1700


def test_rows_behind_in_memory_are_bounded(tmp_path: Path) -> None:
    time = np.arange(30_000) / 100.0
    time[1000:] -= 20.0
    log = parquet_log(tmp_path, pl.DataFrame({"t": time, **{name: np.ones(30_000) for name in NAMES[1:]}}))
    with mock.patch.object(readers, "_PARQUET_ROWS", 500), mock.patch.object(timed_rows, "MOST_GAPS", 300):
        assert "row 1001, column 't': expected a time after 9.99 s, found -10 s running" in refusal(lambda: whole(log))


def test_gaps_are_those_of_the_latest_reading(tmp_path: Path) -> None:
    log = csv_log(tmp_path, with_values([50, 250], "ax", "nan")(lines()))
    for _ in range(2):
        whole(log)
        assert [gap.row for gap in log.gaps] == [50, 250]


def test_gaps_are_reported_for_every_file(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text(with_value(50, "ax", "nan")(lines())))
    (tmp_path / "b.csv").write_text(text(with_values([20, 40, 60], "ax", "nan")(lines())))
    log = opened(tmp_path, ["a.csv", "b.csv"])
    whole(log)
    assert [(gap.file, gap.row) for gap in log.gaps] == [(0, 50), (1, 20), (1, 40), (1, 60)]


def test_gap_in_a_log_without_time_column_is_bridged(tmp_path: Path) -> None:
    table = with_values([100, 101], "ax", "nan")(lines())
    log = csv_log(tmp_path, table, time=None, rate_hz=100.0)
    samples = whole(log)
    check_ramp(samples)
    assert set(samples["dt"]) == {0.01}
    assert [gap.row for gap in log.gaps] == [100]


def test_increments_of_a_bridged_gap_are_those_of_their_samples(tmp_path: Path) -> None:
    table = without([100, 101])(lines())
    samples = whole(csv_log(tmp_path, table, accel={"columns": ["ax", "ay", "az"], "unit": "m/s"}))
    k = np.arange(1, ROWS + 1)
    np.testing.assert_allclose(samples["accel"][:, 0], (9.8 + 0.003 * k) / INTERVAL, rtol=1e-6)


Change = Callable[[Lines], Lines]
BLEMISHES: dict[str, tuple[Change, str]] = {
    "text": (with_value(17, "gy", "overflow"), "'overflow' in 'gy'"),
    "decimal point twice": (with_value(17, "ax", "9.8.1"), "'9.8.1' in 'ax'"),
    "empty value": (with_value(17, "az", ""), "an empty value in 'az'"),
    "blank value": (with_value(17, "T", "  "), "an empty value in 'T'"),
    "quotation mark that does not end": (with_value(17, "ax", '"9.8'), "2 values: left out"),
    "time that is none": (with_value(17, "t", "12:30"), "'12:30' in 't': left out"),
    "time repeated": (with_value(17, "t", "0.16"), "the time stamp of the row before: left out"),
    "time that falls back": (with_value(17, "t", "0.10"), "a time stamp before that of the row before: left out"),
    "time of nothing": (with_value(17, "t", "0"), "a time stamp before that of the row before: left out"),
    "time with a digit too many": (with_value(17, "t", "1.7"), "a time stamp beyond that of a row behind it: left out"),
    "row too short": (with_row(17, ["0.17", "1"]), "2 values: left out"),
    "row short by one": (lambda table: with_row(17, table[17][:-1])(table), "7 values: left out"),
    "row too long": (lambda table: with_row(17, [*table[17], "1"])(table), "9 values: left out"),
    "message in place of a row": (with_row(17, ["MPU6050 connection successful"]), "'MPU6050 connection successful'"),
    "field of 200,000 characters": (with_row(17, ["9" * 200_000]), "field larger than field limit"),
}


@pytest.mark.parametrize("name", BLEMISHES)
@pytest.mark.parametrize("size", [60, 1 << 24])
def test_isolated_bad_row_is_a_lost_sample_that_is_named(name: str, size: int, tmp_path: Path) -> None:
    change, said = BLEMISHES[name]
    log = csv_log(tmp_path, change(lines()))
    with mock.patch.multiple(text_pieces, _PIECE_BYTES=size, _FIRST_PIECE_BYTES=size):
        check_ramp(whole(log))
    assert {gap.row for gap in log.gaps} <= {17, 18}
    assert said in log.gaps[0].what
    assert all(gap.integrable for gap in log.gaps)


def test_two_rows_in_the_wrong_order_cost_one(tmp_path: Path) -> None:
    log = csv_log(tmp_path, [*(table := lines())[:17], table[18], table[17], *table[19:]])
    check_ramp(whole(log))
    assert [(gap.row, gap.samples) for gap in log.gaps] == [(17, 0), (19, 1)]


def test_a_first_row_with_an_older_time_than_the_next_is_left_out(tmp_path: Path) -> None:
    samples = whole(log := csv_log(tmp_path, with_value(1, "t", "73.2")(lines())))
    assert len(samples["time"]) == ROWS - 1
    assert [(gap.row, gap.samples, gap.integrable) for gap in log.gaps] == [(1, 0, True)]


@pytest.mark.parametrize("rows", [1, 3, 8])
@pytest.mark.parametrize("size", [60, 1 << 24])
def test_stamps_that_fall_back_while_time_passes_are_missing_samples(rows: int, size: int, tmp_path: Path) -> None:
    table = lines()
    for row in range(100, 100 + rows):
        table[row][0] = f"{0.5 + 0.01 * (row - 100):.2f}"
    log = csv_log(tmp_path, table)
    with mock.patch.multiple(text_pieces, _PIECE_BYTES=size, _FIRST_PIECE_BYTES=size):
        samples = whole(log)
    assert len(samples["time"]) == (ROWS if rows <= 5 else ROWS - rows)
    assert sorted((gap.row, gap.samples) for gap in log.gaps)[-1] == (100 + rows, rows)
    assert all(gap.integrable for gap in log.gaps) == (rows <= 5)


@pytest.mark.parametrize("rows", [1, 3, 20])
@pytest.mark.parametrize("size", [60, 1 << 24])
def test_rows_that_agree_on_a_time_ahead_cost_themselves(rows: int, size: int, tmp_path: Path) -> None:
    table = lines(5000)
    for row in range(100, 100 + rows):
        table[row][0] = f"{900.5 + 0.01 * row:.2f}"
    log = csv_log(tmp_path, table)
    with mock.patch.multiple(text_pieces, _PIECE_BYTES=size, _FIRST_PIECE_BYTES=size):
        samples = whole(log)
    assert len(samples["time"]) == (5000 if rows <= 5 else 5000 - rows)
    assert samples["time"].max() < 100.0
    assert sum(gap.samples for gap in log.gaps) == rows


SET_BACK: dict[str, Change] = {
    "a clock that is set back": lambda table: [
        *table[:100],
        *([f"{float(line[0]) - 0.04:.2f}", *line[1:]] for line in table[100:]),
    ],
    "rows there twice": lambda table: [*table[:100], *table[96:100], *table[100:]],
}


@pytest.mark.parametrize("name", SET_BACK)
@pytest.mark.parametrize("size", [60, 1 << 24])
def test_nothing_is_integrated_where_a_clock_falls_back(name: str, size: int, tmp_path: Path) -> None:
    log = csv_log(tmp_path, SET_BACK[name](lines()))
    with mock.patch.multiple(text_pieces, _PIECE_BYTES=size, _FIRST_PIECE_BYTES=size):
        samples = whole(log)
    (gap,) = log.gaps
    assert (gap.row, gap.samples, gap.integrable, gap.why) == (100, 4, False, "the clock falls back in it")
    assert (gap.time, gap.stop) == pytest.approx((0.99, 1.0))
    assert np.diff(samples["time"]).min() > 0.0


@pytest.mark.parametrize(
    "change",
    [
        lambda table: [*table[:17], [""], *table[17:]],
        lambda table: [*table[:17], ["MPU6050 connection successful"], *table[17:]],
        lambda table: [*table[:17], table[16], *table[17:]],
        lambda table: [*table, ["3.0"]],
        lambda table: [*table, ["3.01", "9.8", "1.0", "2."]],
    ],
    ids=["blank line", "message", "row twice", "cut in the time", "cut in a number"],
)
def test_line_that_is_no_sample_is_left_out(change: Change, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text(text(change(lines())).removesuffix("\n"), encoding="utf-8")
    log = opened(tmp_path)
    check_ramp(whole(log))
    assert all(gap.samples == 0 for gap in log.gaps)


@pytest.mark.parametrize(
    ("rows", "gaps"), [((17,), 1), ((17, 40, 120), 3), (tuple(range(20, 280, 20)), 0)], ids=["one", "few", "layout"]
)
def test_a_blank_line_may_have_been_a_sample_where_no_time_says_so(
    rows: tuple[int, ...], gaps: int, tmp_path: Path
) -> None:
    table = lines()
    for row in reversed(rows):
        table.insert(row, [""])
    log = csv_log(tmp_path, table, time=None, rate_hz=100.0)
    check_ramp(whole(log))
    assert [(gap.samples, gap.integrable) for gap in log.gaps] == gaps * [(0, False)]
    assert [gap.time for gap in log.gaps] == pytest.approx([0.01 * (row - 1) for row in rows[:gaps]])


LONG_GAPS: dict[str, tuple[Change, int, float, str]] = {
    "nan in six rows": (with_values(range(101, 107), "gx", "nan"), 6, 1.01, "nan in 'gx'"),
    "infinity in six rows": (with_values(range(101, 107), "ay", "-inf"), 6, 1.01, "-inf in 'ay'"),
    "six samples missing": (without(range(100, 106)), 6, 1.0, "missing samples"),
    "four samples missing and two lost": (
        lambda table: without(range(100, 104))(with_values([104, 105], "gz", "inf")(table)),
        6,
        1.0,
        "inf in 'gz'",
    ),
    "twenty samples missing": (without(range(100, 120)), 20, 1.0, "missing samples"),
    "half a minute missing": (
        lambda table: [*table[:100], *([f"{float(line[0]) + 30:.2f}", *line[1:]] for line in table[100:])],
        3000,
        1.0,
        "missing samples",
    ),
}


@pytest.mark.parametrize("name", LONG_GAPS)
@pytest.mark.parametrize("size", [60, 1 << 24])
def test_longer_gap_is_left_out_and_nothing_is_integrated_across_it(name: str, size: int, tmp_path: Path) -> None:
    change, samples, time, what = LONG_GAPS[name]
    table = change(lines())
    log = csv_log(tmp_path, table)
    with mock.patch.multiple(text_pieces, _PIECE_BYTES=size, _FIRST_PIECE_BYTES=size):
        found = whole(log)
    (gap,) = log.gaps
    assert (gap.samples, gap.what, gap.integrable) == (samples, what, False)
    assert gap.time == pytest.approx(time, abs=1e-9)
    assert gap.stop == pytest.approx(time + samples * INTERVAL, abs=1e-9)
    np.testing.assert_allclose(found["dt"], INTERVAL, rtol=0, atol=1e-9)
    expected = np.array([float(line[0]) for line in table[1:] if not {"nan", "inf", "-inf"} & set(line)])
    np.testing.assert_allclose(found["time"], expected, rtol=0, atol=1e-12)


def test_lost_row_without_a_time_is_no_bridge_for_a_turn_if_it_may_have_been_none(tmp_path: Path) -> None:
    table = with_row(100, ["MPU6050 connection successful"])(lines())
    log = csv_log(tmp_path, table, time=None, rate_hz=100.0)
    check_ramp(whole(log))
    assert [(gap.row, gap.samples, gap.integrable) for gap in log.gaps] == [(100, 1, False)]


def test_regular_rows_have_the_times_of_their_number(tmp_path: Path) -> None:
    coarse = [lines()[0], *([f"{0.05 * (i // 5):.2f}", *line[1:]] for i, line in enumerate(lines()[1:]))]
    log = csv_log(tmp_path, coarse, regular=True)
    samples = whole(log)
    assert log.rate == pytest.approx(100.0, rel=5e-4)  # a step of 50 ms over 3 s
    np.testing.assert_allclose(np.diff(samples["time"]), 1.0 / log.rate, rtol=0, atol=1e-12)
    assert samples["time"][0] == pytest.approx(-0.02, abs=2e-3)  # the stamps are 20 ms early at the mean
    assert set(samples["dt"]) == {1.0 / log.rate}


INCREMENTS = {"columns": ["ax", "ay", "az"], "unit": "m/s"}


def stamped(stamps: Array) -> pl.DataFrame:
    """Rows with these time stamps and what is read a second, times the interval."""
    readings = {name: INTERVAL * first * np.ones(len(stamps)) for name, (first, _) in RAMP.items()}
    return pl.DataFrame({"t": stamps, **readings})


@pytest.mark.parametrize("rounding", ["thousandths", "32 bits", "thousandths, in Unix time"])
def test_increments_with_rounded_stamps_have_the_times_of_even_rows(tmp_path: Path, rounding: str) -> None:
    """Lost rows are found as ever, by their stamps."""
    start = 1.7e9 if "Unix" in rounding else 0.0
    true = start + 300.0 + np.delete(np.arange(3000.0), [700, 701, 2000]) * 0.0100713
    stamps = np.asarray(true.astype(np.float32), dtype=float) if rounding == "32 bits" else np.round(true, 3)
    log = parquet_log(tmp_path, stamped(stamps), accel=INCREMENTS)
    samples = whole(log)
    assert log.rate == pytest.approx(1.0 / 0.0100713, rel=1e-6)
    assert [(gap.row, gap.samples) for gap in log.gaps] == [(701, 2), (1999, 1)]
    even = start + 300.0 + np.arange(3000.0) * 0.0100713
    np.testing.assert_allclose(samples["time"], even, rtol=0, atol=6e-5)
    np.testing.assert_allclose(samples["dt"][1:], 0.0100713, rtol=1e-4)


@pytest.mark.parametrize("departure", ["jitter", "a slow clock", "a long row"])
def test_increments_keep_stamps_that_no_even_rows_round_to(tmp_path: Path, departure: str) -> None:
    true = np.arange(1.0, 3001.0) * INTERVAL
    true += {"jitter": 1e-3 * np.sin(true * 77.0), "a slow clock": 1e-5 * true**2, "a long row": 2e-3 * (true > 9.0)}[
        departure
    ]
    stamps = np.round(true, 3)
    samples = whole(parquet_log(tmp_path, stamped(stamps), accel=INCREMENTS))
    np.testing.assert_array_equal(samples["time"], stamps)


def test_rates_keep_their_stamps(tmp_path: Path) -> None:
    stamps = np.round(np.arange(1.0, 3001.0) * 0.0100713, 3)
    np.testing.assert_array_equal(whole(parquet_log(tmp_path, stamped(stamps)))["time"], stamps)


# -------------------- the cut of the stream does not matter --------------------


@pytest.fixture(scope="module")
def gappy(tmp_path_factory: pytest.TempPathFactory) -> tuple[Log, Log]:
    """The same log as CSV and as Parquet, with three gaps of different kinds."""
    folder = tmp_path_factory.mktemp("gappy")
    table = with_values([50, 51, 203], "gx", "nan")(lines())
    table = without([52, 53, 54, 130])(table)
    csv = csv_log(folder, table)
    return csv, parquet_log(folder, numbers(table))


@pytest.fixture(scope="module")
def gappy_whole(gappy: tuple[Log, Log]) -> tuple[dict[str, Array], tuple[Gap, ...]]:
    samples = whole(gappy[0])
    check_ramp(samples)
    assert len(gappy[0].gaps) == 3
    return samples, gappy[0].gaps


@settings(max_examples=40, deadline=None)
@given(rows=st.integers(1, 400), piece=st.integers(40, 30_000), batch=st.integers(1, 400), csv=st.booleans())
def test_chunks_together_are_the_same_to_the_bit_for_any_size(
    gappy: tuple[Log, Log],
    gappy_whole: tuple[dict[str, Array], tuple[Gap, ...]],
    rows: int,
    piece: int,
    batch: int,
    csv: bool,
) -> None:
    log = gappy[0 if csv else 1]
    cut: Any = {"_PIECE_BYTES": piece, "_FIRST_PIECE_BYTES": piece // 2 + 1}
    with mock.patch.multiple(text_pieces, **cut), mock.patch.object(readers, "_PARQUET_ROWS", batch):
        chunks = list(log.chunks(rows))
        samples = whole(log, rows)
    assert max(len(chunk.time) for chunk in chunks) <= rows
    assert equal_to_the_bit(samples, gappy_whole[0])
    assert log.gaps == gappy_whole[1]


def test_reading_can_be_given_up(gappy: tuple[Log, Log]) -> None:
    for log in gappy:
        chunk: Chunk = next(log.chunks(10))
        assert len(chunk.time) == 10


# -------------------- recordings --------------------


@pytest.mark.data
@pytest.mark.parametrize(
    ("name", "samples", "rate"),
    [("xsens-mti", 51175, 100.0), ("truth-turntable", 56796, 50.0), ("truth-handheld", 25721, 100.0)],
)
def test_log_of_the_recordings_reads(data: Path, name: str, samples: int, rate: float) -> None:
    log = open_log(read_session(data / name))
    found = whole(log)
    assert log.rate == pytest.approx(rate, rel=1e-9)
    assert len(found["time"]) == samples
    assert log.gaps == ()
    assert np.median(np.linalg.norm(found["accel"], axis=1)) == pytest.approx(9.8, abs=1.0)


@pytest.mark.data
def test_recording_without_time_column_reads(data: Path, tmp_path: Path) -> None:
    file = data / "imucal-ferraris" / "example_ferraris_session.csv"
    (tmp_path / "log.csv").write_bytes(file.read_bytes())
    log = opened(
        tmp_path,
        time=None,
        rate_hz=102.4,
        accel={"columns": ["acc_x", "acc_y", "acc_z"], "unit": "m/s^2"},
        gyro={"columns": ["gyr_x", "gyr_y", "gyr_z"], "unit": "deg/s"},
        temperature=None,
    )
    samples = whole(log)
    assert len(samples["time"]) == 10376
    assert samples["time"][-1] == 10376 / 102.4
    # the first row of the file, its gyro columns first: -0.6103515625 deg/s, 10.332114257812501 m/s²
    assert samples["gyro"][0, 0] == pytest.approx(-0.6103515625 * math.pi / 180, rel=1e-15)
    assert samples["accel"][0, 0] == 10.332114257812501
    # x_rot, rows 6770 to 7093: one turn of 360° about X, negative
    turn = samples["gyro"][6770:7093] * samples["dt"][6770:7093, None]
    assert abs(turn[:, 0].sum()) == pytest.approx(2 * math.pi, rel=0.1)


@pytest.mark.data
def test_recording_in_two_files_reads(data: Path, tmp_path: Path) -> None:
    for name in ("x_up", "x_down"):
        (tmp_path / f"{name}.csv").write_bytes((data / "ln100-updown" / f"ln100_{name}.csv").read_bytes())
    log = opened(
        tmp_path,
        ["x_up.csv", "x_down.csv"],
        accel={"columns": ["acc_x", "acc_y", "acc_z"], "unit": "m/s^2"},
        gyro={"columns": ["gyr_x", "gyr_y", "gyr_z"], "unit": "deg/s"},
        temperature=None,
    )
    chunks = list(log.chunks())
    up, down = (np.concatenate([c.accel for c in chunks if c.file == file]).mean(axis=0) for file in (0, 1))
    # as published with the data: half difference 9.80672 m/s², bias −43.6 µg
    assert (up[0] - down[0]) / 2 == pytest.approx(9.80672, abs=1e-5)
    assert (up[0] + down[0]) / 2 / 9.80665e-6 == pytest.approx(-43.6, abs=0.1)
    up, down = (
        np.concatenate([c.gyro for c in chunks if c.file == file and c.gyro is not None]).mean(axis=0)
        for file in (0, 1)
    )
    assert (up[0] + down[0]) / 2 * 3600 * 180 / math.pi == pytest.approx(-0.254, abs=1e-3)
    assert log.rate == pytest.approx(64.0, rel=2e-3)


@pytest.mark.data
def test_recording_of_increments_reads(data: Path, tmp_path: Path) -> None:
    (tmp_path / "log.parquet").write_bytes((data / "psins-systematic" / "log.parquet").read_bytes())
    log = opened(
        tmp_path,
        "log.parquet",
        accel={"columns": ["dv_x", "dv_y", "dv_z"], "unit": "m/s"},
        gyro={"columns": ["dtheta_x", "dtheta_y", "dtheta_z"], "unit": "rad"},
        temperature=None,
    )
    samples = whole(log)
    frame = pl.read_parquet(tmp_path / "log.parquet")
    velocity = (samples["accel"] * samples["dt"][:, None]).sum(axis=0)
    expected = frame.select("dv_x", "dv_y", "dv_z").to_numpy().astype(float).sum(axis=0)
    np.testing.assert_allclose(velocity, expected, rtol=1e-12)
    # float32 time stamps, 6e-5 s apart at the end: a mean over a rest must be weighted with dt
    last = samples["accel"][-2000:]
    rest = np.average(last, axis=0, weights=samples["dt"][-2000:])
    assert np.linalg.norm(rest) == pytest.approx(9.797, abs=3e-3)
    assert log.gaps == ()


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ('delimiter = ";"', "expected rows of numbers with log.delimiter"),
        ('decimal = ","', "expected"),
        ('encoding = "utf-16"', "expected text in utf-16"),
    ],
)
def test_a_stated_dialect_that_is_not_that_of_the_log_is_refused(tmp_path: Path, keys: str, said: str) -> None:
    rows = "\n".join(f"{0.01 * i:.2f},0.1,0.2,9.8,0.001,0.002,0.003" for i in range(300))
    (tmp_path / "log.csv").write_text(f"t,ax,ay,az,gx,gy,gz\n{rows}\n")
    sensors = "".join(
        f'[log.{kind}]\ncolumns = ["{kind[0]}x", "{kind[0]}y", "{kind[0]}z"]\nunit = "{unit}"\n'
        for kind, unit in (("accel", "m/s^2"), ("gyro", "rad/s"))
    )
    head = f'format = 1\n[device]\nserial = "A"\n[log]\nfile = "log.csv"\ntime = "t"\n{keys}\n'
    (tmp_path / "session.toml").write_text(head + sensors)
    with pytest.raises(InputError, match=said):
        inspect_session(tmp_path)
