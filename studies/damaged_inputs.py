"""What becomes of a damaged input file: the fuzzer of the project.

Every case damages one input file of a small set (sessions, with thermometers, priors and what is left out too, logs,
table of readings, calibrations, halves of them, truth, limits, campaign, certificate and laboratory, a
registry, recordings in every format, what a serial port sends, Parquet with nested columns), or another one beside it,
puts something in its place that is no regular file, or gives an absurd value to an option, or the options in another
order, and runs one command in this process. Case n of a seed is always the same, whatever ran before. A case is
a finding where

* an exception comes through, or an exit status that is not 0, 1 or 2;
* exit status 2 comes with anything else than one line on standard error, or leaves a file behind;
* a control character, or one that changes the direction of writing, is printed;
* a warning of Python or NumPy is raised;
* it takes more than 20 s, that of waiting for a processor that is busy left out, or more than 1 GB of memory;
* a log whose rows were damaged is accepted, with nothing said, as a note or a remark of the outcome, that was not said
  of the whole one, with a parameter more than 3 u off.

    python studies/damaged_inputs.py [--short] [--cases N] [--seed S] [--first N] [--seconds S] [--verbose]

With `--seconds` no case is begun after so long. `--first` starts at another case, for long runs in parts and to see one
finding again with `--cases 1 --verbose`. A long run says every 10,000 cases how far it is, so that one that is broken
off counts as far as it went.
"""

from __future__ import annotations

import argparse
import gc
import io
import json
import math
import os
import re
import resource
import shutil
import signal
import sqlite3
import sys
import tempfile
import time
import tomllib
import traceback
import unicodedata
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import FrameType
from typing import Any
from zipfile import ZipFile

import numpy as np
import polars as pl
import tomli_w
from click.testing import CliRunner, Result
from scipy.io import savemat

from tests.recording.test_formats import write_bag1, write_bag2, write_bin, write_mcap, write_ulog
from tumble.cli import main as tumble
from tumble.errors import TumbleError
from tumble.planning.setup import Setup
from tumble.result.calibration import read_calibration
from tumble.simulation.session import simulate_session
from tumble.simulation.temperature_profile import temperature_profile

SHORT, LONG, SAID = 80, 1_000_000, 10_000
LONGEST, MOST, BEGUN = 20.0, 1 << 30, 5.0
"""How long and how large a command may be, and how long a campaign is looked at: s, bytes, s."""
OFF = 3.0
"""How many u an accepted result may be off."""
SETUP = replace(
    Setup.of(grade="mems", positions=12, rest=4.0, rate_deg_s=150.0, sample_rate=20.0, terms="linear"), first_rest=6.0
)
OF_A_LOG = ("look at this: ", "kept in ")
"""How lines begin that `calibrate` says of a log before it is refused."""
LOOKED_AT = 160
"""Rows of the logs of which it is only found out what they are."""
TWO, SHUFFLED, NO_FILE = 0.05, 0.2, 0.01
"""The parts of the cases in which another file is damaged too, of those with absurd options in which the words stand in
any order, and of those in which something else than a regular file is put in the place of one."""
IN_MEMORY = Path("/dev/shm")

Rng = np.random.Generator
Change = Callable[[bytes, Rng], bytes]

ABSURD_NUMBERS = (
    b"0", b"-0", b"-1", b"1", b"2", b"1e308", b"-1e308", b"1e-320", b"nan", b"inf", b"-inf", b"1e999", b"3.5", b"1e15",
    b"99999999999999999999", b"9223372036854775808", b"2147483648", b"1" * 400, b"1" * 5000, b"1.2.3", b"0x10",
    b"1_000", b"", "²".encode(), b"true", b"[]", b"'1'", b'"1"', b"2026-13-45", b"9999-12-31", b"12:61:00",
)  # fmt: skip
ABSURD_TEXTS = (
    b"", b"\0", b"\x1b[31m", b"\x1b]0;title\x07", "\u202e".encode(), "\u2028".encode(), b"\xff\xfe", b"\xed\xa0\x80",
    b"\r", b"\n", b'"', b"'", b",", b";", b"[" * 1000, b"{" * 1000, b"[" * 100_000, b"a" * 5000, b"a" * 200_000,
    b"../../../../etc/passwd", b"file:///etc/passwd", b"http://localhost:9/", b"%s%n", b"{}", b"null", b"NaN",
    b"\\u0000", b"\\ud800", "é".encode("latin-1"), b"#", b"//", b"=", b"<!DOCTYPE x [<!ENTITY e 'e'>]>",
    b"cos\nsystem\n(S'id'\ntR.",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 10**6, 10**18, 10**30, -(10**400), 0.0, -0.0, 1e308, -1e308, 1e-320, 0.5, "", "x",
    "²", "\0", "\x1b[31m", "\u202e", "a\nb", "\ud800", "a" * 5000, [], [[]], [[[[[]]]]], {}, {"x": 1}, [0] * 1000,
    ["x"], [None], "NaN", "1", "2026-01-01", "accel.bias.x", "9999-12-31T23:59:59+14:00",
)  # fmt: skip


# -------------------- damage --------------------


def bytes_changed(text: bytes, rng: Rng) -> bytes:
    """A few bytes changed, or a stretch of them cut out, repeated, or put elsewhere."""
    data = bytearray(text)
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(0, len(data) + 1))
        length = int(min(len(data) - at, rng.integers(1, 1 + 2 ** rng.integers(0, 12))))
        stretch = bytes(data[at : at + length])
        kind = rng.integers(0, 6)
        if kind == 0:
            data[at : at + 1] = bytes([rng.integers(0, 256)])
        elif kind == 1:
            del data[at : at + length]
        elif kind == 2:
            data[at:at] = stretch
        elif kind == 3:
            del data[at:]
        elif kind == 4:
            data[at:at] = ABSURD_TEXTS[rng.integers(len(ABSURD_TEXTS))]
        else:
            to = int(rng.integers(0, len(data) + 1))
            data[to:to] = stretch
    return bytes(data)


def words_changed(text: bytes, rng: Rng) -> bytes:
    """One or two words or numbers changed for absurd ones, or for another of the file."""
    for _ in range(int(rng.integers(1, 3))):
        found = [m.span() for m in re.finditer(rb"[\w.+-]+", text[:20_000])]
        if not found:
            return text
        a, b = found[rng.integers(len(found))]
        c, d = found[rng.integers(len(found))]
        choice = (ABSURD_NUMBERS, ABSURD_TEXTS, (text[c:d],))[rng.choice(3, p=(0.6, 0.25, 0.15))]
        text = text[:a] + choice[rng.integers(len(choice))] + text[b:]
    return text


def lines_changed(text: bytes, rng: Rng) -> bytes:
    """A stretch of lines cut out, repeated, turned round or put elsewhere."""
    lines = text.splitlines(keepends=True)
    if len(lines) < 3:
        return text
    at = int(rng.integers(0, len(lines)))
    length = int(rng.integers(1, 2 + min(len(lines), 2 ** rng.integers(0, 8))))
    stretch = lines[at : at + length]
    kind = rng.integers(0, 4)
    rest = lines[:at] + lines[at + length :]
    if kind == 0:
        return b"".join(rest)
    if kind == 1:
        return b"".join(lines[:at] + stretch * int(rng.integers(1, 4)) + lines[at:])
    if kind == 2:
        return b"".join(lines[:at] + stretch[::-1] + lines[at + length :])
    to = int(rng.integers(0, len(rest) + 1))
    return b"".join(rest[:to] + stretch + rest[to:])


def _places(content: Any) -> list[tuple[Any, Any]]:
    """Every table or list of a tree with each of its keys; of a list the first 40."""
    keys = list(content) if isinstance(content, dict) else range(min(len(content), 40))
    found = [(content, key) for key in keys]
    for key in keys:
        if isinstance(content[key], dict | list):
            found += _places(content[key])
    return found


def tree_changed(content: Any, rng: Rng) -> Any:
    """One or two values of a tree of tables and lists changed for others, taken away, repeated or renamed."""
    for _ in range(int(rng.integers(1, 3))):
        places = list(_places(content)) if isinstance(content, dict | list) else []
        if not places:
            return content
        part, key = places[rng.integers(len(places))]
        kind = rng.integers(0, 5)
        if kind == 0:
            del part[key]
        elif kind == 1 and isinstance(part, list):
            part.append(part[key])
        elif kind == 2 and isinstance(part, dict):
            part[str(VALUES[rng.integers(len(VALUES))])] = part.pop(key)
        elif kind == 3 and isinstance(part[key], int | float) and not isinstance(part[key], bool):
            factor = 10.0 ** rng.integers(-9, 10) * (-1) ** rng.integers(0, 2)
            part[key] = part[key] * factor if abs(part[key]) < 10**300 else -part[key]
        else:
            part[key] = json.loads(json.dumps(VALUES[rng.integers(len(VALUES))]))
    return content


def json_changed(text: bytes, rng: Rng) -> bytes:
    """A JSON file, or one of its lines, with its tree changed."""
    lines = text.splitlines() if text.count(b"\n}\n") == 0 and text.count(b"\n") > 1 and text[:2] != b"{\n" else [text]
    at = int(rng.integers(len(lines)))
    lines[at] = json.dumps(tree_changed(json.loads(lines[at]), rng)).encode()
    return b"\n".join(lines) + b"\n"


def toml_changed(text: bytes, rng: Rng) -> bytes:
    """A TOML file with its tree changed, as far as TOML can say it."""
    try:
        return tomli_w.dumps(tree_changed(tomllib.loads(text.decode()), rng)).encode("utf-8", "surrogatepass")
    except (TypeError, ValueError, OverflowError):
        return words_changed(text, rng)


def deep(text: bytes, rng: Rng) -> bytes:
    """A document with a key of many parts, or brackets within brackets, at a line of it."""
    count = int(2 ** rng.integers(3, 17))
    nested = b"[" * count + b"]" * count
    added = (b"a." * count + b"a = 1", b"x = " + nested, b'"x": ' + nested + b",", nested)[rng.integers(4)]
    lines = text.splitlines(keepends=True)
    at = int(rng.integers(len(lines) + 1))
    return b"".join([*lines[:at], added, b"\n", *lines[at:]])


def numbers_changed(text: bytes, rng: Rng) -> bytes:
    """A log with one wild number, with a stretch of some columns in another unit, or with a column left empty."""
    head, *rows = [line.split(b",") for line in text.splitlines()]
    column = int(rng.integers(len(head)))
    kind = rng.integers(0, 3)
    if kind == 0:
        wild = (b"900.5", b"1e308", b"-1e9", b"1e12", b"1e150", b"-5", b"1.7e18")
        rows[rng.integers(len(rows))][column if rng.random() < 0.5 else 0] = wild[rng.integers(len(wild))]
    elif kind == 1:
        factor = (9.80665, 1e3, 57.29578, 1e-3, 0.0174533)[rng.integers(5)]
        first, last = sorted(rng.integers(0, len(rows) + 1, 2).tolist())
        for row in rows[first:last]:
            row[1:] = [repr(float(value) * factor).encode() for value in row[1:]]
    else:
        for row in rows:
            row[column] = b""
    return b"\n".join(b",".join(row) for row in (head, *rows)) + b"\n"


def half_changed(text: bytes, rng: Rng) -> bytes:
    """A calibration of which a half is refused or both are, with its tree changed in one place or nowhere."""
    content = json.loads(text)
    bad = [kind for kind in ("accel", "gyro") if rng.random() < 0.6]
    for kind in bad:
        content["outcome"][kind] = {"verdict": "not accepted", "reasons": ["bad"], "remarks": []}
    content["outcome"] |= {"accepted": not bad, "reasons": ["bad"] if bad else []}
    content["outcome"]["verdict"] = "not accepted: bad" if bad else "accepted"
    if rng.random() < 0.3:
        content["gyro" if rng.random() < 0.5 else "accel"] = None
    return json.dumps(tree_changed(content, rng) if rng.random() < 0.5 else content).encode()


SQL_VALUES = (None, "x", b"\0\1", -1, 10**18, 1.5, "", b"", "\0", "9999-12-31", "v9999")


def database_changed(text: bytes, rng: Rng) -> bytes:
    """An SQLite database with a column changed in some rows, or a table without rows, renamed or taken away."""
    with tempfile.TemporaryDirectory(dir=IN_MEMORY if IN_MEMORY.is_dir() else None) as folder:
        path = Path(folder) / "d.sqlite"
        path.write_bytes(text)
        with closing(sqlite3.connect(path, isolation_level=None)) as opened, suppress(sqlite3.Error):
            opened.execute("PRAGMA journal_mode = DELETE")
            for kind, name in opened.execute("SELECT type, name FROM sqlite_master WHERE type = 'trigger'").fetchall():
                opened.execute(f'DROP {kind} "{name}"')
            tables = [row[0] for row in opened.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
            table = tables[rng.integers(len(tables))]
            columns = [row[1] for row in opened.execute(f"PRAGMA table_info('{table}')")]
            column, value = columns[rng.integers(len(columns))], SQL_VALUES[rng.integers(len(SQL_VALUES))]
            kind = rng.integers(0, 8)
            if kind == 0:
                opened.execute(f'DELETE FROM "{table}"')
            elif kind == 1:
                opened.execute(f'ALTER TABLE "{table}" RENAME TO "other"')
            elif kind == 2:
                opened.execute(f'DROP TABLE "{table}"')
            else:
                opened.execute("PRAGMA ignore_check_constraints = ON")
                opened.execute(f'UPDATE "{table}" SET "{column}" = ? WHERE rowid % {rng.integers(1, 4)} = 0', (value,))
        return path.read_bytes()


def hdf5_changed(text: bytes, rng: Rng) -> bytes:
    """An HDF5 file in which a data set is a huge one of which nothing is stored, or has another shape or type."""
    import h5py

    held = io.BytesIO(text)
    with h5py.File(held, "r+") as file:
        name = ("accel", "gyro", "time")[rng.integers(3)]
        width = int(rng.choice([1, 3, 3, 4]))
        del file[name]
        kind = rng.integers(0, 3)
        if kind == 0:
            rows = int(2 ** rng.integers(10, 40))
            file.create_dataset(name, shape=(rows, width), chunks=(min(rows, 1024), width), dtype="f8")
        elif kind == 1:
            file.create_dataset(name, data=np.zeros((160, width), dtype=("i1", "f2", "c16", "S4")[rng.integers(4)]))
        else:
            file[name] = h5py.SoftLink("/nowhere") if rng.random() < 0.5 else h5py.ExternalLink("/etc/passwd", "/x")
    return held.getvalue()


def archive_changed(text: bytes, rng: Rng) -> bytes:
    """An archive with one of its files changed."""
    held = io.BytesIO()
    with ZipFile(io.BytesIO(text)) as archive, ZipFile(held, "w") as changed:
        names = archive.namelist()
        at = int(rng.integers(len(names)))
        for number, name in enumerate(names):
            content = archive.read(name)
            changed.writestr(name, ANY[rng.integers(len(ANY))](content, rng) if number == at else content)
    return held.getvalue()


ANY: tuple[Change, ...] = (bytes_changed, words_changed, lines_changed)
BY_ENDING: dict[str, tuple[Change, ...]] = {
    ".json": (json_changed, json_changed, json_changed, half_changed, deep),
    ".jsonl": (json_changed,),
    ".toml": (toml_changed, toml_changed, toml_changed, deep),
    ".csv": (numbers_changed,),
    ".db3": (database_changed,),
    ".sqlite": (database_changed,),
    ".h5": (hdf5_changed,),
    ".npz": (archive_changed,),
    ".zip": (archive_changed,),
}
"""What is done to files of an ending in the larger part of their cases."""


def in_place_of(path: Path, rng: Rng) -> None:
    """Something that is no regular file in the place of one: a pipe that nobody writes to, a device, a folder, a link
    to nothing or to itself, or nothing."""
    path.unlink()
    kind = rng.integers(0, 6)
    if kind == 0:
        os.mkfifo(path)
    elif kind == 1:
        path.symlink_to("/dev/zero")
    elif kind == 2:
        path.mkdir()
    elif kind == 3:
        path.symlink_to(path.with_name("nothing"))
    elif kind == 4:
        path.symlink_to(path.name)


def put_right(path: Path, content: bytes) -> None:
    """A file as it was, whatever is in its place."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
    path.write_bytes(content)


# -------------------- inputs and commands --------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class Target:
    """An input file, below the folder of inputs, and the commands that read it, in words; {} is that folder, {out} an
    empty one, {kept} a registry with records. Of a `log` an accepted result is compared with that of the whole one."""

    file: str
    commands: tuple[str, ...]
    weight: float = 1.0
    log: bool = False


EXPORTS = ("ros-imu-calib", "px4", "ardupilot", "imucal", "c", "mat", "csv")
CERTIFY = "export {}/calibration.json --to dcc --certificate {}/certificate.toml -o {out}/e"
TARGETS = (
    Target(
        file="csv/session.toml",
        weight=3.0,
        commands=(
            "calibrate {}/csv --terms linear --out {out}/c.json",
            "inspect {}/csv",
            "inspect {}/csv",
            "apply {}/calibration.json {}/csv -o {out}/a.csv",
            "check {}/calibration.json {}/csv",
            "noise {}/csv",
        ),
    ),
    Target(
        file="csv/log.csv",
        weight=0.8,
        log=True,
        commands=("calibrate {}/csv --terms linear --out {out}/c.json",),
    ),
    Target(
        file="rate/log.csv",
        weight=0.5,
        log=True,
        commands=("calibrate {}/rate --terms linear --out {out}/c.json",),
    ),
    Target(
        file="csv/log.csv",
        weight=0.8,
        commands=(
            "new {out}/new {}/csv/log.csv",
            "inspect {}/csv",
            "apply {}/calibration.json {}/csv -o {out}/a.parquet",
            "noise {}/csv/log.csv --accel ax,ay,az --time t",
        ),
    ),
    Target(
        file="warm/session.toml",
        commands=(
            "inspect {}/warm",
            "calibrate {}/warm --terms linear --out {out}/c.json",
            "calibrate {}/warm --out {out}/c.json",
            "apply {}/warm.json {}/warm -o {out}/a.csv",
            "check {}/warm.json {}/warm",
        ),
    ),
    Target(
        file="warm.json",
        weight=0.5,
        commands=(
            "compare {}/warm.json {}/calibration.json",
            "apply {}/warm.json {}/warm -o {out}/a.csv",
            "check {}/warm.json {}/warm",
            "export {}/warm.json --to px4 -o {out}/e",
            "export {}/warm.json --to csv -o {out}/e",
            "export {}/warm.json --to c -o {out}/e",
            "registry add {}/warm.json --registry {kept}",
        ),
    ),
    Target(file="messung.txt", weight=0.5, commands=("new {out}/new {}/messung.txt --latitude 50",)),
    Target(file="parquet/log.parquet", commands=("inspect {}/parquet", "new {out}/new {}/parquet/log.parquet")),
    Target(file="imu.mat", weight=0.6, commands=("new {out}/new {}/imu.mat",)),
    Target(file="imu.h5", weight=0.8, commands=("new {out}/new {}/imu.h5",)),
    *(
        Target(file=f"imu.{ending}", commands=(f"new {{out}}/new {{}}/imu.{ending}",))
        for ending in ("bag", "mcap", "ulg", "bin", "npz", "zip")
    ),
    Target(
        file="serial.txt",
        weight=2.0,
        commands=(
            "new {out}/new {}/serial.txt",
            "noise {}/serial.txt --sample-rate 20",
            "calibrate {}/serial.txt --latitude 50 --terms linear --out {out}/c.json",
        ),
    ),
    Target(file="ros2/ros2.db3", weight=1.0, commands=("new {out}/new {}/ros2",)),
    Target(file="ros2/metadata.yaml", weight=0.4, commands=("new {out}/new {}/ros2",)),
    Target(
        file="nested/log.parquet",
        weight=0.5,
        commands=(
            "apply {}/calibration.json {}/nested -o {out}/a.parquet",
            "apply {}/calibration.json {}/nested -o {out}/a.csv",
            "new {out}/new {}/nested/log.parquet",
        ),
    ),
    Target(
        file="warm/log.csv",
        weight=0.8,
        commands=(
            "new {out}/new {}/warm/log.csv",
            "calibrate {}/warm --terms linear --out {out}/c.json",
            "inspect {}/warm",
        ),
    ),
    Target(
        file="r.sqlite",
        weight=1.5,
        commands=(
            "registry list --registry {}/r.sqlite",
            "registry list mems-7 --registry {}/r.sqlite",
            "registry show 1 --registry {}/r.sqlite",
            "registry due --registry {}/r.sqlite",
            "registry trend mems-7 --registry {}/r.sqlite",
            "registry limits --registry {}/r.sqlite",
            "registry add {}/warm.json --registry {}/r.sqlite",
        ),
    ),
    Target(file="log.csv.gz", commands=("new {out}/new {}/log.csv.gz",)),
    Target(file="log.csv.zst", commands=("new {out}/new {}/log.csv.zst",)),
    Target(
        file="calibration.json",
        weight=5.0,
        commands=(
            "compare {}/calibration.json {}/other.json",
            "check {}/calibration.json {}/csv",
            "check {}/calibration.json {}/readings.csv",
            "apply {}/calibration.json {}/csv -o {out}/a.csv",
            *(f"export {{}}/calibration.json --to {to} -o {{out}}/e" for to in EXPORTS),
            "export {}/calibration.json --to kalibr --noise {}/csv -o {out}/e",
            CERTIFY,
            "registry add {}/calibration.json --registry {kept}",
            "calibrate {}/passport --terms linear --out {out}/c.json",
        ),
    ),
    Target(file="calibration.json", weight=0.05, commands=("report {}/calibration.json -o {out}/r.html",)),
    Target(
        file="csv/truth.json",
        weight=0.6,
        commands=("calibrate {}/csv --terms linear --truth {}/csv/truth.json --out {out}/c.json",),
    ),
    Target(
        file="limits.toml",
        weight=2.0,
        commands=(
            "registry limits BCHE-501 {}/limits.toml --registry {out}/r.sqlite",
            *("registry limits BCHE-501 {}/limits.toml --registry {kept}",) * 3,
        ),
    ),
    Target(
        file="warm-limits.toml",
        weight=0.5,
        commands=("registry limits mems {}/warm-limits.toml --registry {kept}",),
    ),
    Target(file="certificate.toml", commands=(CERTIFY,)),
    Target(file="laboratory.toml", weight=0.5, commands=(CERTIFY.replace("certificate.toml", "by-laboratory.toml"),)),
    Target(file="campaign.toml", weight=0.25, commands=("campaign {}/campaign.toml --in-process -o {out}/campaign",)),
    Target(
        file="readings.csv",
        weight=2.0,
        commands=(
            "ellipsoid {}/readings.csv --unit m/s^2 --out {out}/c.json",
            "check {}/calibration.json {}/readings.csv",
        ),
    ),
)
OPTIONS = (
    "simulate {out}/s --positions 3 --rest _ --sample-rate 20",
    "simulate {out}/s --positions 3 --rest 3 --sample-rate _ --turn-rate 200",
    "simulate {out}/s --positions _ --rest 3 --sample-rate 20 --turn-rate _ --latitude _",
    "simulate {out}/s --positions 3 --rest 3 --sample-rate 20 --table-error _ --mounting-error _ --vibration _@_",
    "simulate {out}/s --positions 3 --rest 3 --sample-rate 20 --seed _ --launch _",
    "plan --rest _ --turn-rate _ --latitude _",
    "plan --gravity _ --gravity-u _ --table-error _ --mounting-error _",
    "plan --method sequential --sources --rest _ --turn-rate _ --latitude _ --gravity _ --iterations _",
    "plan --attitude _",
    "plan --want accel.scale=_ppm",
    "ellipsoid {}/readings.csv --scale _,_,_ --gravity _ --out {out}/c.json",
    "ellipsoid {}/readings.csv --unit m/s^2 --position _=_,_,_ --serial _ --out {out}/c.json",
    "noise {}/csv/log.csv --accel ax,ay,_ --sample-rate _",
    "new {out}/new {}/csv/log.csv --latitude _ --sample-rate _ --serial _",
    "calibrate {}/csv --terms linear --iterations _ --out {out}/c.json",
    "calibrate {}/csv --terms linear --method scalar --iterations _ --out {out}/c.json",
    "programme --attitude _",
    "registry show _ --registry {}/r.sqlite",
    "registry due --on _ --registry {}/r.sqlite",
    "registry trend _ _ --registry {}/r.sqlite",
)
LIMITS = """format = 1
interval_months = 12
[incoming]
"accel.bias" = "10 mg"
"accel.scale.x" = { min = "-5000 ppm", max = "5000 ppm" }
[periodic]
"gyro.bias" = "5 deg/s"
"""
WARM_LIMITS = """format = 1
temperature_degC = [12, 28]
systematic = "warm.json"
[incoming]
"accel.bias" = "50 mg"
[periodic]
"accel.scale" = { min = "-1 %", max = "1 %" }
"""
WARM: dict[str, dict[str, Any]] = {
    "device": {
        "prior": {
            "accel_quadratic": "20 ug/g^2",
            "accel_temperature": {"bias": "0.1 mg/K", "scale": "50 ppm/K"},
        }
    },
    "session": {"conditions": {"temperature_degC": 22.5, "temperature_u": 0.5}},
}
EXCLUDED = [{"rest": 3, "reason": "touched"}, {"start": 20.0, "stop": 20.5}]
"""What the session with a thermometer has beside what is simulated."""
CAMPAIGN = """seed = 1
trials = 2
[grid]
method = ["joint"]
grade = ["mems"]
programme = ["rough-table"]
rest = [10.0]
"""
CERTIFICATE = """number = "1"
country = "DE"
begin = 2026-03-01
end = 2026-03-02
[laboratory]
name = "Laboratory"
country = "DE"
city = "Bonn"
postcode = "53113"
[customer]
name = "Customer"
city = "Bonn"
country = "DE"
[[person]]
name = "A. Person"
"""


LABORATORY = CERTIFICATE[CERTIFICATE.index("[laboratory]") : CERTIFICATE.index("[customer]")]
PERSON = CERTIFICATE[CERTIFICATE.index("[[person]]") :]
BY_LABORATORY = (
    CERTIFICATE.replace(LABORATORY, "")
    .replace(PERSON, "")
    .replace("[customer]", 'laboratory = "laboratory.toml"\n[customer]')
)
TEXTS = {
    "laboratory": LABORATORY + PERSON,
    "by-laboratory": BY_LABORATORY,
    "limits": LIMITS,
    "warm-limits": WARM_LIMITS,
    "campaign": CAMPAIGN,
    "certificate": CERTIFICATE,
}


def write_inputs(folder: Path) -> None:
    """All inputs, below a folder."""
    for name, launch, seed in (("csv", 1, 7), ("other", 2, 7), ("parquet", 1, 8)):
        form = "parquet" if name == "parquet" else "csv"
        simulate_session(folder / name, SETUP, seed=seed, launch=launch, log_format=form)
    _invoked(f"calibrate {folder}/csv --terms linear --out {folder}/calibration.json")
    _invoked(f"calibrate {folder}/other --terms linear --out {folder}/other.json")
    _invoked(f"calibrate {folder}/csv --out {folder}/full.json")
    log = pl.read_csv(folder / "csv/log.csv")
    (folder / "rate").mkdir()
    session = tomllib.loads((folder / "csv/session.toml").read_text(encoding="utf-8"))
    without = {key: value for key, value in session["log"].items() if key != "time"} | {"rate_hz": 20.0}
    (folder / "rate/session.toml").write_text(tomli_w.dumps(session | {"log": without}), encoding="utf-8")
    log.drop("t").write_csv(folder / "rate/log.csv")
    shutil.copytree(folder / "csv", folder / "passport")
    passport = session | {"device": session["device"] | {"systematic": "../calibration.json"}}
    (folder / "passport/session.toml").write_text(tomli_w.dumps(passport), encoding="utf-8")
    _write_warm(folder)
    head = log.head(LOOKED_AT)
    rounded = head.with_columns(pl.all().round(5))
    rounded.write_csv(folder / "messung.txt", separator=";", decimal_comma=True)
    savemat(folder / "imu.mat", {"data": log.head(400).to_numpy()})  # without names: it takes some rests to tell
    _written_h5(folder / "imu.h5", head)
    _written_recordings(folder, head)
    shutil.copytree(folder / "parquet", folder / "nested")
    nested = pl.read_parquet(folder / "parquet/log.parquet").with_columns(
        both=pl.struct("ax", "ay"), listed=pl.concat_list("ax", "ay"), bytes=pl.lit(b"\0\xff")
    )
    nested.write_parquet(folder / "nested/log.parquet")
    of_parquet = (folder / "parquet/session.toml").read_text(encoding="utf-8")
    (folder / "nested/session.toml").write_text(of_parquet.replace("mems-8", "mems-7"), encoding="utf-8")
    for ending in ("gz", "zst"):
        head.lazy().sink_csv(folder / f"log.csv.{ending}", compression={"gz": "gzip", "zst": "zstd"}[ending])
    rests = read_calibration(folder / "calibration.json").evidence.rests
    means = np.array([rest.accel.mean for rest in rests if rest.accel is not None])
    pl.DataFrame(means, schema=["ax", "ay", "az"]).write_csv(folder / "readings.csv")
    for name, text in TEXTS.items():
        (folder / f"{name}.toml").write_text(text, encoding="utf-8")
    _of_accelerometers(folder / "csv", folder / "still")
    registry = f"--registry {folder}/r.sqlite"
    _invoked(f"registry limits BCHE-501 {folder}/limits.toml {registry}")
    for name in ("calibration", "other"):
        _invoked(f"registry add {folder}/{name}.json {registry}")


def _write_warm(folder: Path) -> None:
    """A session with thermometers, priors of the data sheet and what is left out, and its calibration."""
    by_hand = replace(SETUP, by_hand=20)
    simulate_session(folder / "warm", by_hand, seed=9, temperature=temperature_profile("10:30"), log_format="csv")
    path = folder / "warm/session.toml"
    session = _of_accelerometers(folder / "warm", folder / "warm")
    session["log"]["temperature"]["columns"] *= 3
    merged = {key: session.get(key, {}) | more for key, more in WARM.items()}
    path.write_text(tomli_w.dumps(session | merged | {"exclude": EXCLUDED}), encoding="utf-8")
    _invoked(f"calibrate {folder}/warm --out {folder}/warm.json")


def _of_accelerometers(source: Path, target: Path) -> dict[str, Any]:
    """Write a session without its gyros, and return what its file says."""
    session = tomllib.loads((source / "session.toml").read_text(encoding="utf-8"))
    del session["log"]["gyro"]
    log = pl.read_csv(source / "log.csv").drop("gx", "gy", "gz")
    target.mkdir(exist_ok=True)
    log.write_csv(target / "log.csv")
    (target / "session.toml").write_text(tomli_w.dumps(session), encoding="utf-8")
    return session


def _written_h5(path: Path, log: pl.DataFrame) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for name, columns in (("accel", ["ax", "ay", "az"]), ("gyro", ["gx", "gy", "gz"])):
            file[name] = log.select(columns).to_numpy()
        file["time"] = log["t"].to_numpy()


def _written_recordings(folder: Path, log: pl.DataFrame) -> None:
    """A recording in every other format, with a thermometer in that of ROS 2, and the text of a serial port, which is
    not emptied when it begins and a device that starts anew."""
    record = log.select("ax", "ay", "az", "gx", "gy", "gz").to_numpy()
    for ending, write in (("bag", write_bag1), ("mcap", write_mcap), ("ulg", write_ulog), ("bin", write_bin)):
        write(folder / f"imu.{ending}", record)
    write_bag2(folder / "ros2", record)
    np.savez(folder / "imu.npz", time=log["t"].to_numpy(), accel=record[:, :3], gyro=record[:, 3:])
    with ZipFile(folder / "imu.zip", "w") as archive:
        for name, columns in (("Accelerometer", ["ax", "ay", "az"]), ("Gyroscope", ["gx", "gy", "gz"])):
            archive.writestr(f"{name}.csv", log.select("t", *columns).write_csv())
    rows = [f"a/g:\t{k * 50}" + "".join(f"\t{v * 1000:.0f}" for v in row) for k, row in enumerate(record)]
    begun = ["Initializing I2C devices...", "MPU6050 connection successful", "ms\tax\tay\taz\tgx\tgy\tgz"]
    (folder / "serial.txt").write_text("\r\n".join(["12\t3", *begun, *rows, "", "\0\0", *begun, *rows[:20]]), "utf-8")


# -------------------- one case --------------------


def _invoked(words: str | list[str]) -> Result:
    words = words.split() if isinstance(words, str) else words
    return CliRunner(catch_exceptions=True).invoke(tumble, words, prog_name="tumble")


class _TooLong(BaseException):
    """A command runs longer than it may. Not an Exception: nothing may take it for one of its own."""


def _passed() -> float:
    """Seconds on a clock that stands still while something else has the processor, as far as the system tells."""
    with suppress(OSError, ValueError, IndexError):
        return time.monotonic() - 1e-9 * float(Path("/proc/self/schedstat").read_text(encoding="ascii").split()[1])
    return time.monotonic()


@contextmanager
def _stopped_after(seconds: float) -> Iterator[None]:
    if not hasattr(signal, "setitimer"):
        yield
        return
    until = _passed() + seconds

    def stop(_signal: int, _frame: FrameType | None) -> None:
        if (left := until - _passed()) <= 0.0:
            raise _TooLong
        signal.setitimer(signal.ITIMER_REAL, max(left, 0.1))

    signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


class _Memory:
    """The most memory that this process held since the object was made, as far as the system tells, less what the
    cases before have left in it."""

    begun: int | None = None

    def __init__(self) -> None:
        with suppress(OSError):
            Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
        if _Memory.begun is None:
            _Memory.begun = self._of("VmRSS")
        self._left = max(self._of("VmRSS") - _Memory.begun, 0)

    @property
    def most(self) -> int:
        return self._of("VmHWM") - self._left

    @staticmethod
    def _of(name: str) -> int:
        try:
            status = Path("/proc/self/status").read_text(encoding="ascii")
            return int(re.findall(rf"{name}:\s+(\d+)", status)[0]) * 1024
        except (OSError, IndexError):
            return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


@dataclass(frozen=True, kw_only=True, slots=True)
class Finding:
    """What was found in a case; `kind` is the same for all of one cause."""

    case: int
    kind: str
    words: str
    more: str


class Inputs:
    """The inputs, in a folder; one of them is damaged at a time, and put right again."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.out, self.kept = folder / "in", folder / "out", folder / "kept"
        self.folder.mkdir()
        write_inputs(self.folder)
        self.clean = {target.file: (self.folder / target.file).read_bytes() for target in TARGETS}
        self.weights = np.array([*(t.weight for t in TARGETS), 2.0])
        self.said = {log: self._calibrated(log) for log in ("csv", "rate")}
        self.ended: Counter[tuple[str, str]] = Counter()
        """How many cases of an input, or of options, ended how."""

    def _calibrated(self, log: str) -> tuple[Any, int]:
        self._emptied()
        result = _invoked(self._words(f"calibrate {{}}/{log} --terms linear --out {{out}}/c.json"))
        return read_calibration(self.out / "c.json"), len(result.stderr.splitlines())

    def _emptied(self) -> None:
        shutil.rmtree(self.out, ignore_errors=True)
        self.out.mkdir()

    def _words(self, command: str) -> list[str]:
        if "{kept}" in command:
            shutil.rmtree(self.kept, ignore_errors=True)
            self.kept.mkdir()
            shutil.copy(self.folder / "r.sqlite", self.kept)
        places = {"{out}": self.out, "{kept}": self.kept / "r.sqlite", "{}": self.folder}
        for name, place in places.items():
            command = command.replace(name, str(place))
        return command.split()

    def case(self, seed: int, number: int, verbose: bool = False) -> Finding | None:
        """A case, and what was found in it."""
        rng = np.random.default_rng([seed, number])
        at = int(rng.choice(len(self.weights), p=self.weights / self.weights.sum()))
        self._emptied()
        if at == len(TARGETS):
            return self._run(number, _options(self._words(OPTIONS[rng.integers(len(OPTIONS))]), rng), None, verbose)
        target = TARGETS[at]
        words = self._words(target.commands[rng.integers(len(target.commands))])
        damaged = [target]
        others = [t for t in TARGETS if t.file != target.file and self._reads(words, t.file)]
        if others and rng.random() < TWO:
            damaged.append(others[rng.integers(len(others))])
        for each in damaged:
            path = self.folder / each.file
            if rng.random() < NO_FILE:
                in_place_of(path, rng)
                continue
            text = self._damaged(each, rng)
            if verbose:
                print(each.file, text[:3000])
            path.write_bytes(text)
        try:
            return self._run(number, words, target, verbose)
        finally:
            for each in damaged:
                put_right(self.folder / each.file, self.clean[each.file])
            for left in self.folder.rglob("*.sqlite-*"):
                left.unlink()
            shutil.rmtree(self.folder / "serial-session", ignore_errors=True)

    def _reads(self, words: list[str], file: str) -> bool:
        """Whether a command is given an input file, or its folder."""
        path = self.folder / file
        return str(path) in words or (path.parent != self.folder and str(path.parent) in words)

    def _damaged(self, target: Target, rng: Rng) -> bytes:
        text = self.clean[target.file]
        if target.log and rng.random() < 0.7:
            return lines_changed(text, rng)
        changes = BY_ENDING.get(Path(target.file).suffix, ())
        if changes and rng.random() < 0.6:
            with suppress(KeyError, TypeError, ValueError):  # a change of calibrations or logs, and another document
                return changes[rng.integers(len(changes))](text, rng)
        return ANY[rng.integers(len(ANY))](text, rng)

    def _run(self, number: int, words: list[str], target: Target | None, verbose: bool) -> Finding | None:
        memory, started = _Memory(), _passed()
        finding, result, shown = "", None, ""
        warned: list[tuple[Any, traceback.StackSummary]] = []
        campaign = words[0] == "campaign"  # may be a large one, and is then only begun
        with warnings.catch_warnings():
            warnings.simplefilter("always")
            warnings.showwarning = lambda *said, **_: warned.append((said, traceback.extract_stack()))
            try:
                with _stopped_after(BEGUN if campaign else LONGEST):
                    result = _invoked(words)
            except _TooLong:
                finding = "" if campaign else f"longer than {LONGEST:g} s: {words[0]} {target.file if target else ''}"
                shown = traceback.format_exc()
        taken = _passed() - started
        if result is not None:
            shown = f"{result.stdout[-2000:]}\n--- {result.exit_code}\n{result.stderr[-2000:]}"
            finding = self._fault(result, target).replace(str(self.folder.parent), "")
            if result.exception is not None:
                shown += "".join(traceback.format_exception(result.exception))
        ended = "stopped" if result is None else f"exit {result.exit_code}"
        self.ended[target.file if target is not None else "options", ended] += 1
        if not finding and taken > LONGEST:
            finding = f"longer than {LONGEST:g} s: {words[0]}"
        if not finding and memory.most > MOST:
            finding = f"more than 1 GB: {words[0]} {target.file if target else ''}"
        for said, stack in warned:
            if not finding and not issubclass(said[1], ResourceWarning):
                finding = f"{said[1].__name__} {_innermost(stack)}: {str(said[0])[:80]}"
        if verbose:
            print(" ".join(words), shown, finding, sep="\n")
        if not finding:
            return None
        return Finding(case=number, kind=finding, words=" ".join(words), more=shown)

    def _fault(self, result: Result, target: Target | None) -> str:
        error = result.exception
        if error is not None and not isinstance(error, SystemExit):
            return f"{type(error).__name__} {_innermost(traceback.extract_tb(error.__traceback__))}: {str(error)[:80]}"
        if result.exit_code not in (0, 1, 2):
            return f"exit status {result.exit_code}"
        strange = sorted({repr(c) for c in result.stdout + result.stderr if _strange(c)})
        if strange:
            return f"printed {' '.join(strange[:3])}"
        if result.exit_code == 2:
            return self._refusal(result)
        return self._silent(result, target) if target is not None and target.log else ""

    def _refusal(self, result: Result) -> str:
        lines = [each for each in result.stderr.splitlines() if not each.startswith(OF_A_LOG)]
        if len(lines) != 1 or not lines[0].startswith("tumble: "):
            return f"{len(lines)} lines where one is promised: {' | '.join(lines)[:150]}"
        if len(lines[0]) > 1500:
            return f"a line of {len(lines[0])} characters: {lines[0][:80]}"
        left = sorted(str(path.relative_to(self.out)) for path in self.out.rglob("*"))
        if left:
            return f"left behind: {' '.join(left[:3])}"[:100]
        python = re.search(r"'NoneType'|object (has no|is not)|__\w+__|got an unexpected|NoneType", lines[0])
        return f"quotes Python: {lines[0][-150:]}" if python else ""

    def _silent(self, result: Result, target: Target) -> str:
        if result.exit_code != 0:
            return ""
        whole, said = self.said[target.file.split("/")[0]]
        try:
            found = read_calibration(self.out / "c.json")
        except TumbleError as error:
            return f"wrote a file that it does not read: {error}"
        more = (found.provenance.notes, whole.provenance.notes), (found.outcome.remarks, whole.outcome.remarks)
        if len(result.stderr.splitlines()) > said or any(len(ours) > len(those) for ours, those in more):
            return ""
        off = {p.name: abs(p.value - whole[p.name].value) / p.u for p in found.parameters if p.u and whole[p.name].u}
        name = max(off, key=lambda name: off[name])
        return f"accepted without a word: {name}" if off[name] > OFF else ""


def _options(words: list[str], rng: Rng) -> list[str]:
    """Words with absurd values for some options, usual ones for the others."""

    def value() -> str:
        if rng.random() < 0.4:
            return "3"
        choice = (ABSURD_NUMBERS, ABSURD_TEXTS)[rng.choice(2, p=(0.8, 0.2))]
        return choice[rng.integers(len(choice))][:2000].decode("utf-8", "replace").replace("\0", "")

    words = [re.sub("_", lambda _: value(), word) if re.search(r"(^|[=,@])_", word) else word for word in words]
    return words if rng.random() > SHUFFLED else [words[0], *rng.permutation(words[1:]).tolist()]


def _innermost(stack: traceback.StackSummary) -> str:
    """The innermost line of the project."""
    frames = [f for f in stack if f"{Path('src') / 'tumble'}" in f.filename]
    return f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else "outside"


def _strange(character: str) -> bool:
    """Whether a character does something to a terminal, or to the direction of writing."""
    return character not in "\n\t" and unicodedata.category(character) in ("Cc", "Cf", "Cs", "Zl", "Zp")


# -------------------- the study --------------------


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--short", action="store_true")
    parser.add_argument("--cases", type=int)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=math.inf)
    parser.add_argument("--verbose", action="store_true")
    given = parser.parse_args()
    most, done = given.cases or (SHORT if given.short else LONG), 0
    kinds: Counter[str] = Counter()
    first: dict[str, Finding] = {}
    with tempfile.TemporaryDirectory(dir=IN_MEMORY if IN_MEMORY.is_dir() else None) as folder:
        inputs = Inputs(Path(folder))
        gc.freeze()  # what all cases share need not be gone through again and again
        started, worked = time.monotonic(), time.process_time()
        while done < most and time.monotonic() - started < given.seconds:
            number, done = given.first + done, done + 1
            finding = inputs.case(given.seed, number, given.verbose)
            if done % SAID == 0:
                print(f"{done} cases, {time.monotonic() - started:.0f} s", flush=True)
            if finding is not None:
                kinds[finding.kind] += 1
                if finding.kind not in first:
                    first[finding.kind] = finding
                    if not given.short:
                        print(f"case {number}: {finding.kind}\n  {finding.words}", flush=True)
    taken, each = time.monotonic() - started, (time.process_time() - worked) / max(done, 1)
    print(
        f"{done} cases of seed {given.seed} from {given.first}, {taken:.0f} s, {1e3 * each:.0f} ms of a processor each"
    )
    for kind in () if given.short else sorted({file for file, _ in inputs.ended}):
        counts = {ended: count for (file, ended), count in sorted(inputs.ended.items()) if file == kind}
        print(f"  {kind}: {sum(counts.values())} cases, {', '.join(f'{n} {ended}' for ended, n in counts.items())}")
    for kind, count in kinds.most_common():
        print(f"  {count:6d}  {kind}  (case {first[kind].case})")
    found = sum(kinds.values())
    print(f"Does a damaged input end otherwise than it should? {f'Yes, {found} times' if found else 'No.'}")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
