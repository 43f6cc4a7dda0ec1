"""One clean recording written as instruments, phones and laboratories write it, and with what happens to files.

A writer gets the clean recording in SI (t, ax … gz; 50 Hz) and a folder, writes one file or more into it, and says what
to give to `tumble new`. Nothing here is read by the project: it is made from the published formats.
"""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
import polars as pl
from scipy.io import savemat

from tumble.units import DEGREE, G_STANDARD, Array

RATE = 50.0
ACCEL, GYRO = ("ax", "ay", "az"), ("gx", "gy", "gz")
RNG = np.random.default_rng(7)


@dataclass(frozen=True, kw_only=True, slots=True)
class Case:
    """What writes a log; words for `tumble new` besides the log; what must be said and noted; how far, in u of the
    clean result, the result may be off, which is more where samples are lost or rounded; whether the gyros can be
    compared; and what the log reads for 1 m/s² and 1 rad/s, and at nothing."""

    write: Callable[[pl.DataFrame, Path], str]
    words: tuple[str, ...] = ()
    said: tuple[str, ...] = ()
    within: float = 1.0
    gyro: bool = True
    noted: tuple[str, ...] = ()
    worth: tuple[float, float] = (1.0, 1.0)
    zero: float = 0.0


def table(
    log: pl.DataFrame,
    names: Sequence[str],
    *,
    accel: float = 1.0,
    gyro: float = 1.0,
    time: float = 1.0,
    digits: int = 6,
) -> list[list[str]]:
    """Header and rows: time, accelerometers and gyros times factors."""
    read = [log["t"] * time, *(log[c] * accel for c in ACCEL), *(log[c] * gyro for c in GYRO)]
    rows = np.column_stack([column.to_numpy() for column in read]).tolist()
    return [
        list(names),
        *([f"{v:.{9 if j == 0 else digits}g}" if j else f"{v:.10g}" for j, v in enumerate(r)] for r in rows),
    ]


def written(path: Path, rows: list[list[str]], *, delimiter: str = ",", above: str = "", end: str = "\n") -> str:
    text = above + "".join(delimiter.join(row) + end for row in rows)
    path.write_bytes(text.encode())
    return path.name


NAMES = ("t", "ax", "ay", "az", "gx", "gy", "gz")


def plain(log: pl.DataFrame, folder: Path) -> str:
    return written(folder / "log.csv", table(log, NAMES))


def with_thermometers(log: pl.DataFrame, folder: Path) -> str:
    """A chip with accelerometers, and one with gyros that is warmer; so steady that no lag behind them matters."""
    rows = table(log, [*NAMES, "accel_temp_C", "gyro_temp [C]"])
    settled = 1.0 - np.exp(-np.arange(len(rows) - 1) / 2000.0)
    for row, warmer in zip(rows[1:], settled.tolist(), strict=True):
        row += [f"{27.0 + 0.02 * warmer:.3f}", f"{31.0 + 0.04 * warmer:.3f}"]
    return written(folder / "log.csv", rows)


def with_delimiter(delimiter: str, ending: str = ".txt") -> Callable[[pl.DataFrame, Path], str]:
    return lambda log, folder: written(folder / f"log{ending}", table(log, NAMES), delimiter=delimiter)


def decimal_comma(delimiter: str) -> Callable[[pl.DataFrame, Path], str]:
    def write(log: pl.DataFrame, folder: Path) -> str:
        rows = [[cell.replace(".", ",") for cell in row] for row in table(log, NAMES)]
        return written(folder / "messung.csv", rows, delimiter=delimiter)

    return write


def named(
    names: Sequence[str],
    *,
    accel: float = 1.0,
    gyro: float = 1.0,
    time: float = 1.0,
    delimiter: str = ",",
    above: str = "",
    encoding: str = "utf-8",
    digits: int = 7,
    file: str = "log.csv",
) -> Callable[[pl.DataFrame, Path], str]:
    def write(log: pl.DataFrame, folder: Path) -> str:
        rows = table(log, names, accel=accel, gyro=gyro, time=time, digits=digits)
        text = above + "".join(delimiter.join(row) + "\r\n" for row in rows)
        (folder / file).write_bytes(text.encode(encoding))
        return file

    return write


def counts(log: pl.DataFrame, accel: float, gyro: float) -> tuple[Array, Array]:
    """Readings as a converter gives them, counts per m/s² and per rad/s, with the noise that makes their mean finer."""
    read = [np.round(log.select(c).to_numpy() * k).astype(int) for c, k in ((ACCEL, accel), (GYRO, gyro))]
    return read[0], read[1]


def raw(
    accel_per_g: float,
    gyro_per_deg: float,
    *,
    unsigned: bool = False,
    names: Sequence[str] = NAMES,
    time: float = 1e3,
    offset: int = 0,
) -> Callable[[pl.DataFrame, Path], str]:
    def write(log: pl.DataFrame, folder: Path) -> str:
        a, g = counts(log, accel_per_g / G_STANDARD, gyro_per_deg / DEGREE)
        if unsigned:
            a, g = a % 65536, g % 65536
        stamps = np.round(log["t"].to_numpy() * time).astype(int)
        rows = np.column_stack([stamps, a + offset, g + offset]).astype(str).tolist()
        return written(folder / "raw.csv", [list(names), *rows])

    return write


def without_names(log: pl.DataFrame, folder: Path) -> str:
    return written(folder / "LOG00012.TXT", table(log, NAMES)[1:], delimiter="\t")


def ends_with_comma(of: str) -> Callable[[pl.DataFrame, Path], str]:
    """A comma behind the last name, or behind the last value of each row."""

    def write(log: pl.DataFrame, folder: Path) -> str:
        names, *rows = table(log, NAMES)
        more = {"names": ([*names, ""], rows), "rows": (names, [[*row, ""] for row in rows])}[of]
        return written(folder / "log.csv", [more[0], *more[1]])

    return write


def of_r(log: pl.DataFrame, folder: Path) -> str:
    """A table of R: its rows are numbered, and the column of numbers has no name."""
    names, *rows = table(log, NAMES)
    quoted = [f'"{name}"' for name in names]
    numbered = [[f'"{k}"', *row] for k, row in enumerate(rows, 1)]
    return written(folder / "log.txt", [quoted, *numbered], delimiter=" ")


def arduino(log: pl.DataFrame, folder: Path) -> str:
    rows = table(log, NAMES, time=1e3)[1:]
    above = "Initializing I2C devices...\nTesting device connections...\nMPU6050 connection successful\n"
    return written(folder / "putty.log", rows, delimiter="\t", above=above)


def xsens(log: pl.DataFrame, folder: Path) -> str:
    names = ["PacketCounter", "SampleTimeFine", "Acc_X", "Acc_Y", "Acc_Z", "Gyr_X", "Gyr_Y", "Gyr_Z", ""]
    rows = [
        [str(i % 65536), str(10_000 + 200 * i), *row[1:], ""] for i, row in enumerate(table(log, NAMES, digits=8)[1:])
    ]
    above = (
        "// Start Time: Unknown\r\n// Update Rate: 50.0Hz\r\n// Filter Profile: general\r\n// Option Flags: none\r\n"
    )
    return written(folder / "MT_0680.txt", [names, *rows], delimiter="\t", above=above, end="\r\n")


def movella_dot(log: pl.DataFrame, folder: Path) -> str:
    names = ["PacketCounter", "SampleTimeFine", "Acc_X", "Acc_Y", "Acc_Z", "Gyr_X", "Gyr_Y", "Gyr_Z"]
    rows = table(log, NAMES, gyro=1 / DEGREE, digits=8)[1:]
    lines = [[str(i + 1), str(4_000_000 + 20_000 * i), *row[1:]] for i, row in enumerate(rows)]
    above = "sep=,\nDeviceTag:,DOT 1\nFirmwareVersion:,2.0.0\nOutputRate:,50Hz\n\n"
    return written(folder / "dot.csv", [names, *lines], above=above)


def clock(
    pattern: Callable[[float], str], name: str = "time", delimiter: str = ","
) -> Callable[[pl.DataFrame, Path], str]:
    def write(log: pl.DataFrame, folder: Path) -> str:
        rows = table(log, [name, *NAMES[1:]])
        stamps = [pattern(float(t)) for t in log["t"]]
        return written(
            folder / "log.csv",
            [rows[0], *([s, *r[1:]] for s, r in zip(stamps, rows[1:], strict=True))],
            delimiter=delimiter,
        )

    return write


def of_day(seconds: float, start: float = 86370.0) -> str:
    """A time of day that passes midnight."""
    ms = round((start + seconds) * 1000) % 86_400_000
    return f"{ms // 3_600_000:02d}:{ms // 60_000 % 60:02d}:{ms // 1000 % 60:02d}.{ms % 1000:03d}"


def iso(seconds: float) -> str:
    return str(np.datetime64("2026-11-21T09:30:00.000") + np.timedelta64(round(seconds * 1000), "ms"))


def german_date(seconds: float) -> str:
    date, time = iso(seconds).split("T")
    year, month, day = date.split("-")
    return f"{day}.{month}.{year} {time.replace('.', ',')}"


def matrix(log: pl.DataFrame, folder: Path) -> str:
    savemat(folder / "imu.mat", {"data": log.select(NAMES).to_numpy()})
    return "imu.mat"


def matrix_without_time(log: pl.DataFrame, folder: Path) -> str:
    gyro = log.select(pl.col(GYRO) / DEGREE).to_numpy()
    savemat(folder / "imu.mat", {"acc": log.select(ACCEL).to_numpy(), "gyr_dps": gyro})
    return "imu.mat"


def phone(log: pl.DataFrame, folder: Path) -> str:
    """Sensor Logger: a file a sensor, nanoseconds of the epoch, z before y before x."""
    (folder / "phone").mkdir()
    for name, columns in (("TotalAcceleration", ACCEL), ("Gyroscope", GYRO)):
        rows = [
            [str(1_700_000_000_000_000_000 + round(t * 1e9)), f"{t:.6f}", f"{z:.9g}", f"{y:.9g}", f"{x:.9g}"]
            for t, x, y, z in log.select("t", *columns).iter_rows()
        ]
        written(folder / "phone" / f"{name}.csv", [["time", "seconds_elapsed", "z", "y", "x"], *rows])
    return "phone"


def meta_wear(log: pl.DataFrame, folder: Path) -> str:
    """A file a sensor, times as milliseconds, as a date and as seconds, and axes that say nothing of the sensor."""
    (folder / "wear").mkdir()
    for name, columns, unit, one in (
        ("Accelerometer", ACCEL, "g", 1.0 / G_STANDARD),
        ("Gyroscope", GYRO, "deg/s", 1.0 / DEGREE),
    ):
        names = ["epoch (ms)", "time (-13:00)", "elapsed (s)", *(f"{axis}-axis ({unit})" for axis in "xyz")]
        rows = [
            [f"{1_600_000_000_000 + round(1e3 * t)}", iso(t), f"{t:.3f}", *(f"{one * v:.9g}" for v in read)]
            for t, *read in log.select("t", *columns).iter_rows()
        ]
        written(folder / "wear" / f"unit_{name}.csv", [names, *rows])
    return "wear"


def in_two_files(log: pl.DataFrame, folder: Path) -> str:
    """Two halves of a recording, cut in a rest."""
    (folder / "parts").mkdir()
    for k, part in enumerate((log.head(log.height // 2), log.tail(log.height - log.height // 2)), 1):
        written(folder / "parts" / f"part{k}.txt", table(part, NAMES), delimiter=";")
    return "parts"


# -------------------- what happens to files --------------------

Lines = list[list[str]]


def blemished(
    change: Callable[[Lines], Lines], *, time: bool = True, delimiter: str = ","
) -> Callable[[pl.DataFrame, Path], str]:
    def write(log: pl.DataFrame, folder: Path) -> str:
        rows = change(table(log, NAMES, digits=9))
        rows = rows if time else [row[1:] or row for row in rows]
        return written(folder / "log.csv", rows, delimiter=delimiter)

    return write


def bad_values(rows: Lines) -> Lines:
    for k, text in ((100, "###"), (700, ""), (1300, "1.2.3"), (1700, "nan")):
        rows[k][1 + k % 6] = text
    return rows


def messages_between(rows: Lines) -> Lines:
    for k in (1900, 1200, 300):
        rows.insert(k, ["MPU6050 connection successful"])
    return rows


def cut(log: pl.DataFrame, folder: Path) -> str:
    rows = table(log, NAMES)
    (folder / "log.csv").write_bytes("".join(",".join(row) + "\n" for row in rows).encode()[:-37])
    return "log.csv"


def repeated(rows: Lines) -> Lines:
    for k in range(200, len(rows) - 50, 301):
        rows[k][0] = rows[k - 1][0]
    return rows


def lost(rows: Lines) -> Lines:
    keep = np.random.default_rng(3).random(len(rows)) > 0.01
    keep[:3] = True
    return [row for row, kept in zip(rows, keep, strict=True) if kept]


def out_of_line(rows: Lines) -> Lines:
    """Stamps that fall back, to nothing too, or have a digit too many, and pairs of rows in the wrong order."""
    for k, change in ((211, -0.3), (602, -1e9), (1003, 1e4), (1404, -0.05)):
        rows[k][0] = f"{max(float(rows[k][0]) + change, 0.0):.6f}"
    for k in (305, 906, 1507):
        rows[k], rows[k + 1] = rows[k + 1], rows[k]
    return rows


def doubled(rows: Lines) -> Lines:
    out = []
    for k, row in enumerate(rows):
        out += [row, row] if k and k % 250 == 0 else [row]
    return out


def restamped(change: Callable[[Array], Array]) -> Callable[[Lines], Lines]:
    def changed(rows: Lines) -> Lines:
        stamps = change(np.array([float(row[0]) for row in rows[1:]]))
        return [rows[0], *([f"{t:.6f}", *row[1:]] for t, row in zip(stamps, rows[1:], strict=True))]

    return changed


def jitter(t: Array) -> Array:
    return np.asarray(np.sort(t + np.random.default_rng(4).uniform(-0.45, 0.45, len(t)) / RATE))


def coarse(t: Array) -> Array:
    return np.asarray(np.floor(t / 0.1) * 0.1)


def bursts(t: Array) -> Array:
    """Ten rows at a time, 0.2 ms apart, when the tenth has come."""
    k = np.arange(len(t))
    return np.asarray(t[0] + (k // 10 + 1) * 10 / RATE + k % 10 * 2e-4)


def gap(start: int, rows: int = 20) -> Callable[[Lines], Lines]:
    return lambda lines: lines[: start + 1] + lines[start + 1 + rows :]


def gap_in_a_rest(log: pl.DataFrame, folder: Path) -> str:
    return blemished(gap(middle_of_rest(log, 5)))(log, folder)


def gap_in_a_turn(log: pl.DataFrame, folder: Path) -> str:
    return blemished(gap(_turns(log)[5]))(log, folder)


def set_back_in_a_turn(log: pl.DataFrame, folder: Path) -> str:
    """A clock that is set back by 0.2 s in the third turn."""
    k = _turns(log)[2] + 1
    return blemished(lambda rows: [*rows[:k], *([f"{float(r[0]) - 0.2:.6f}", *r[1:]] for r in rows[k:])])(log, folder)


def moving(log: pl.DataFrame) -> Array:
    """Which rows are in a turn, of the clean recording."""
    rate = np.linalg.norm(log.select(GYRO).to_numpy(), axis=1)
    smooth = np.convolve(rate, np.ones(9) / 9, mode="same")
    return np.asarray(smooth > 0.2)


def _edges(log: pl.DataFrame) -> list[tuple[int, int]]:
    """First and last + 1 row of each rest."""
    at = np.flatnonzero(np.diff(np.concatenate([[True], moving(log), [True]]).astype(int)))
    spans = [(int(a), int(b)) for a, b in at.reshape(-1, 2)]
    return [(a, b) for a, b in spans if b - a > 2 * RATE]


def middle_of_rest(log: pl.DataFrame, rest: int) -> int:
    a, b = _edges(log)[rest]
    return (a + b) // 2 - 10


def _turns(log: pl.DataFrame) -> list[int]:
    """A row in the middle of each turn."""
    rests = _edges(log)
    return [(rests[i][1] + rests[i + 1][0]) // 2 for i in range(len(rests) - 1)]


def compressed(log: pl.DataFrame, folder: Path) -> str:
    name = with_delimiter(";")(log, folder)
    (folder / "log.txt.gz").write_bytes(gzip.compress((folder / name).read_bytes()))
    return "log.txt.gz"


def rate_above(log: pl.DataFrame, folder: Path) -> str:
    rows = [row[1:] for row in table(log, NAMES)]
    return written(folder / "log.txt", rows, delimiter="\t", above="% Sampling rate: 50 Hz\n")


def a_file_a_position(log: pl.DataFrame, folder: Path) -> str:
    (folder / "positions").mkdir()
    for k, (a, b) in enumerate(_edges(log), 1):
        written(folder / "positions" / f"pos{k}.txt", table(log[a + 15 : b - 15], NAMES), delimiter="\t")
    return "positions"


def positions_below(log: pl.DataFrame, folder: Path) -> str:
    parts = [log[(a + b) // 2 - 55 : (a + b) // 2 + 55] for a, b in _edges(log)]
    rows = [row[1:] for row in table(pl.concat(parts), NAMES)]
    return written(folder / "log.csv", rows)


def rounded(log: pl.DataFrame, folder: Path) -> str:
    rows = table(log, ["t", *(f"{c} [m/s^2]" for c in ACCEL), *(f"{c} [deg/s]" for c in GYRO)], gyro=1 / DEGREE)
    for row in rows[1:]:
        row[1:] = [f"{float(v):.2f}" for v in row[1:]]
    return written(folder / "log.csv", rows)


def printed(pattern: str, *, time: float = 1e3, gyro: float = 1.0) -> Callable[[pl.DataFrame, Path], str]:
    """A line of print() for each sample."""

    def write(log: pl.DataFrame, folder: Path) -> str:
        lines = [
            pattern.format(t=round(t * time), a=a, g=[gyro * w for w in g])
            for t, *read in log.select(NAMES).iter_rows()
            for a, g in [(read[:3], read[3:])]
        ]
        (folder / "putty.log").write_text("\n".join(lines) + "\n", encoding="utf-8")
        return "putty.log"

    return write


def counter_of(bits: int, unit: float, name: str) -> Callable[[pl.DataFrame, Path], str]:
    """Time stamps of a counter that starts anew in the middle of the recording, and as often as it must."""

    def write(log: pl.DataFrame, folder: Path) -> str:
        rows = table(log, [name, *NAMES[1:]], digits=7)
        counts = np.round(log["t"].to_numpy() / unit).astype(np.int64)
        counts = (counts + 2**bits - counts[len(counts) // 2]) % 2**bits
        return written(
            folder / "log.csv", [rows[0], *([str(c), *r[1:]] for c, r in zip(counts, rows[1:], strict=True))]
        )

    return write


def vectornav_sentences(log: pl.DataFrame, folder: Path) -> str:
    """Asynchronous output of a VectorNav: no time, and a checksum behind every line."""
    lines = []
    for row in log.select(NAMES[1:]).iter_rows():
        numbers = ",".join(f"{v:+010.6f}" for v in row)
        body = f"VNYMR,-009.283,-007.204,-008.681,+01.0640,-00.2531,+03.0614,{numbers}"
        lines.append(f"${body}*{reduce(xor, body.encode()):02X}\r\n")
    (folder / "vn100.txt").write_text("".join(lines), encoding="ascii", newline="")
    return "vn100.txt"


def sensor_logger(log: pl.DataFrame, folder: Path) -> str:
    """A folder of a phone: metadata, and sensors apart, z first."""
    (folder / "phone").mkdir()
    for name, columns in (("AccelerometerUncalibrated", ACCEL), ("GyroscopeUncalibrated", GYRO)):
        rows = [["time", "seconds_elapsed", "z", "y", "x"]]
        for t, x, y, z in log.select("t", *columns).iter_rows():
            rows.append([str(1683195142000000000 + round(t * 1e9)), f"{t:.9f}", f"{z:.7g}", f"{y:.7g}", f"{x:.7g}"])
        written(folder / "phone" / f"{name}.csv", rows)
    (folder / "phone" / "Metadata.csv").write_text("version,device name\n3,phone\n", encoding="utf-8")
    return "phone"


def sbg_logger(log: pl.DataFrame, folder: Path) -> str:
    """The text log of SBG's logger: units in a line of their own, and a status word."""
    rows = [["timestamp", "status", "accelX", "accelY", "accelZ", "gyroX", "gyroY", "gyroZ", "temp"]]
    rows.append(["(us)", "(na)", *["(m.s^-2)"] * 3, *["(rad.s^-1)"] * 3, "(degC)"])
    rows += [[t, "0x0000013F", *read, "31.2"] for t, *read in table(log, NAMES, time=1e6, digits=8)[1:]]
    return written(folder / "imu.txt", rows, delimiter="\t")


def objects_of_json(log: pl.DataFrame, folder: Path) -> str:
    """Lists of three, and an object within the object; a time that is a number."""
    with (folder / "imu.jsonl").open("w", encoding="utf-8") as out:
        for t, *v in log.select("t", *ACCEL, *GYRO).iter_rows():
            gyro = dict(zip("xyz", v[3:], strict=True))
            out.write(json.dumps({"ts": round(1.6e9 + t, 3), "board": "A", "acc": v[:3], "imu": {"gyr": gyro}}) + "\n")
    return "imu.jsonl"


def array_of_json(log: pl.DataFrame, folder: Path) -> str:
    """One array over all lines, with times of day."""
    rows = [
        json.dumps({"time": f"10:{int(t // 60):02d}:{t % 60:06.3f}", "accel": v[:3], "gyro": v[3:]})
        for t, *v in log.select("t", *ACCEL, *GYRO).iter_rows()
    ]
    (folder / "imu.json").write_text("[\n" + ",\n".join(rows) + "\n]\n", encoding="utf-8")
    return "imu.json"


def shimmer(log: pl.DataFrame, folder: Path) -> str:
    """The separator named above, units with brackets within, and a tab at the end of every row."""
    names = ["Timestamp_Unix_CAL", *(f"Accel_LN_{a}_CAL" for a in "XYZ"), *(f"Gyro_{a}_CAL" for a in "XYZ")]
    rows = table(log, [f"Shimmer_3A4B_{name}" for name in names], gyro=1.0 / DEGREE, time=1000.0)
    rows[1:1] = [["ms", *["m/(s^2)"] * 3, *["deg/s"] * 3]]
    return written(folder / "shimmer.csv", rows, delimiter="\t", above='"sep=\t"\n', end="\t\n")


def board_sentences(log: pl.DataFrame, folder: Path) -> str:
    """Sentences of a board's own with a counter, milliseconds and a checksum."""
    rows = table(log, NAMES, gyro=1.0 / DEGREE, time=1000.0)[1:]
    with (folder / "serial.log").open("w", encoding="utf-8") as out:
        for count, row in enumerate(rows):
            body = f"IMU,{count},{','.join(row)}"
            out.write(f"${body}*{reduce(xor, body.encode(), 0):02X}\n")
    return "serial.log"


def row_for_each_sensor(delimiter: str, header: bool) -> Callable[[pl.DataFrame, Path], str]:
    """A row for accelerometers, and one for gyros 1 ms later."""

    def write(log: pl.DataFrame, folder: Path) -> str:
        rows = [["time", "sensor", "x", "y", "z"]] if header else []
        for t, *v in log.select("t", *ACCEL, *GYRO).iter_rows():
            rows.append([f"{1e3 * t:.0f}", "ACC", *(f"{x:.9g}" for x in v[:3])])
            rows.append([f"{1e3 * t + 1.0:.0f}", "GYRO", *(f"{x:.9g}" for x in v[3:])])
        return written(folder / "stream.txt", rows, delimiter=delimiter)

    return write


def dataflash_as_text(log: pl.DataFrame, folder: Path) -> str:
    """An ArduPilot log as its ground stations write it as text."""
    lines = [
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns",
        "FMT, 130, 50, IMU, QBffffff, TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ",
        "PARM, 1000, INS_GYROFFS_X, 0.0",
    ]
    for t, *v in log.select("t", *GYRO, *ACCEL).iter_rows():
        lines.append(f"IMU, {1e6 * t:.0f}, 0, {', '.join(f'{x:.9g}' for x in v)}")
    (folder / "00000012.log").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return "00000012.log"


def betaflight(log: pl.DataFrame, folder: Path) -> str:
    """A blackbox decoded: what the firmware says of itself above, accelerometers in counts, gyros in deg/s."""
    names = ["loopIteration", "time", *(f"gyroADC[{i}]" for i in range(3)), *(f"accSmooth[{i}]" for i in range(3))]
    above = '"Product","Blackbox flight data recorder"\n"Firmware revision","Betaflight 4.3.1"\n"acc_1G",2048\n'
    rows = [[f'"{name}"' for name in names]]
    for i, (t, *v) in enumerate(log.select("t", *GYRO, *ACCEL).iter_rows()):
        gyro, accel = [f"{x / DEGREE:.4f}" for x in v[:3]], [f"{2048.0 * x / G_STANDARD:.0f}" for x in v[3:]]
        rows.append([str(8 * i), f"{1e6 * t:.0f}", *gyro, *accel])
    return written(folder / "LOG00007.01.csv", rows, above=above)


def imu_tk(log: pl.DataFrame, folder: Path) -> str:
    """Matrices saved as text: time and counts about 32768, accelerometers and gyros in a file each."""
    (folder / "tk").mkdir()
    read = counts(log, 4096.0 / G_STANDARD, 131.0 / DEGREE)
    for name, values in zip(("imu_acc.mat", "imu_gyro.mat"), read, strict=True):
        with_time = np.column_stack([log["t"].to_numpy(), values + 32768])
        np.savetxt(folder / "tk" / name, with_time, fmt="%16.7e")
    return "tk"


def several_at_once(log: pl.DataFrame, folder: Path) -> str:
    """A byte order mark, decimal commas, a clock of twelve hours that passes midnight, stamps that repeat, a restart
    with its message and the header once more, and a last line that is cut."""
    rows = table(log, NAMES, digits=9)
    for row in rows[1:]:
        hour, rest = of_day(float(row[0])).split(":", 1)
        row[0] = f"{int(hour) % 12 or 12}:{rest} {'AM' if int(hour) < 12 else 'PM'}"
    rows = repeated(rows)
    rows[900:900] = [["MPU6050 connection successful"], rows[0]]
    text = "\r\n".join(";".join(row).replace(".", ",") for row in rows)
    (folder / "LOG.TXT").write_bytes(text.encode("utf-8-sig")[:-31])
    return "LOG.TXT"


def merged_topics(log: pl.DataFrame, folder: Path) -> str:
    """Two topics in one table: seconds and nanoseconds, rows of a receiver between, and units in words."""
    names = ["header.stamp.secs", "header.stamp.nsecs", "latitude"]
    names += [f"accel_{a}_m_per_s2" for a in "xyz"] + [f"gyro_{a}_deg_per_s" for a in "xyz"]
    rows = [names]
    for k, (t, *read) in enumerate(log.select("t", *ACCEL, *(pl.col(c) / DEGREE for c in GYRO)).iter_rows()):
        ns = 1_700_000_000_250_000_000 + round(t * 1e9)
        stamp = [str(ns // 10**9), str(ns % 10**9)]
        rows.append([*stamp, "", *(f"{v:.9g}" for v in read)])
        rows += [[*stamp, "56.84", *[""] * 6]] * (k % 20 == 10)
    return written(folder / "merged.csv", rows)
