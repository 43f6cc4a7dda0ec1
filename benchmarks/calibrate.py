"""How long `tumble calibrate` takes, and how much memory, against reading the same file with polars.

Whole process: start-up of `tumble --help`, and `tumble calibrate` on the Xsens recording (TUMBLE_DATA) and on a
simulated hour at 1 kHz, Parquet and CSV, with peak memory. In process, imports and compilation excluded, by the clock
and in processor time, each ratio the median of five pairs: calibrating the hour against polars reading the same
columns, and reading it until its blocks are reduced against polars reading all columns. With `--long` the memory of 20
million rows, too. Usage: python benchmarks/calibrate.py [--long]
"""

from __future__ import annotations

import os
import platform
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import polars as pl

from tumble.planning.setup import Setup
from tumble.recording.log import open_log
from tumble.recording.session_file import read_session
from tumble.reduction.blocks.reducer import reduce_log
from tumble.run.calibrate import calibrate
from tumble.simulation.session import simulate_session

TUMBLE = Path(sys.executable).with_name("tumble")
DATA = Path(os.environ.get("TUMBLE_DATA") or Path(__file__).parents[2] / "shared" / "data")
CPUINFO = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
RUNS = 5


ONE_RUN = """
import os, subprocess, sys, time
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
start = time.perf_counter()
child = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
_, status, usage = os.wait4(child.pid, 0)
busy = usage.ru_utime + usage.ru_stime
print(os.waitstatus_to_exitcode(status), time.perf_counter() - start, usage.ru_maxrss / 1024, busy)
"""
"""Runs a command from a small process: a child's peak memory counts from what its parent had. Its modules are not
compiled anew, as pip leaves them. Prints exit status, seconds by the clock, peak MB and seconds of the processor."""


def process(*command: str) -> str:
    """Medians over RUNS of the time of a command and of its processor time, after one run to warm up, and its largest
    peak memory."""
    times, peaks = [], []
    for _ in range(RUNS + 1):
        run = [sys.executable, "-S", "-c", ONE_RUN, str(TUMBLE), *command]
        code, wall, peak, busy = subprocess.run(run, capture_output=True, text=True, check=True).stdout.split()
        if code not in ("0", "1"):
            raise SystemExit(f"{' '.join(command)} failed")
        times.append((float(wall), float(busy)))
        peaks.append(float(peak))
    seconds, used = (statistics.median(each) for each in zip(*times[1:], strict=True))
    return f"{seconds:.3f} s, of processor time {used:.3f} s, peak {max(peaks):.0f} MB"


def pairs(ours: Callable[[], object], theirs: Callable[[], object]) -> str:
    """Medians of both times and of their ratio, pair by pair, by the clock and in processor time."""

    def times(work: Callable[[], object]) -> tuple[float, float]:
        start, busy = time.perf_counter(), time.process_time()
        work()
        return time.perf_counter() - start, time.process_time() - busy

    ours()
    measured = [(times(ours), times(theirs)) for _ in range(RUNS)]
    said = []
    for which, name in enumerate(("by the clock", "in processor time")):
        both = [(a[which], b[which]) for a, b in measured]
        first, second = (statistics.median(each) for each in zip(*both, strict=True))
        ratio = statistics.median(a / b for a, b in both)
        said.append(f"{name} {first:.3f} s, polars {second:.3f} s, ratio {ratio:.2f}")
    return "; ".join(said)


def against_polars(folder: Path) -> tuple[str, str]:
    """Times of calibrating a session, and of reading its log until its blocks are reduced, against polars."""
    session = read_session(folder)
    log, columns = session.log.files[0], list(session.log.columns)
    read = pl.read_parquet if log.suffix == ".parquet" else pl.read_csv

    def reduced() -> object:
        return reduce_log(open_log(session), session.accel_block, session.gyro_block)

    whole = pairs(lambda: calibrate(session), lambda: read(log, columns=columns))
    return whole, pairs(reduced, lambda: read(log))


def machine() -> str:
    """The machine in words."""
    cpu = next((line.split(":")[1].strip() for line in CPUINFO if line.startswith("model name")), platform.machine())
    return f"{cpu}, {os.cpu_count()} cores, Python {platform.python_version()}, polars {pl.__version__}"


def rows_of(log: Path) -> int:
    scan = pl.scan_parquet(log) if log.suffix == ".parquet" else pl.scan_csv(log)
    return int(scan.select(pl.len()).collect().item())


def session_of(folder: Path, log_format: Literal["csv", "parquet"], rest: float) -> Path:
    """A session at 1 kHz with 15 rests of so many seconds."""
    request = Setup.of(programme="rough-table", rest=rest, sample_rate=1000.0)
    return simulate_session(folder, request, seed=5, log_format=log_format)


def main() -> None:
    print(machine())
    with tempfile.TemporaryDirectory() as temporary:
        out = str(Path(temporary) / "out.json")
        print(f"tumble --help: {process('--help')}")
        if (DATA / "xsens-mti").is_dir():
            print(
                f"tumble calibrate xsens-mti: {process('calibrate', str(DATA / 'xsens-mti'), '--out', out, '--force')}"
            )
        for log_format in ("parquet", "csv"):
            folder = session_of(Path(temporary) / log_format, log_format, 225.0)
            taken = process("calibrate", str(folder), "--out", out, "--force")
            print(f"tumble calibrate, {rows_of(folder / f'log.{log_format}'):,} rows {log_format}: {taken}")
            whole, reading = against_polars(folder)
            print(f"    in process {whole}\n    until blocks are reduced {reading}")
            shutil.rmtree(folder)
        if "--long" in sys.argv:
            folder = session_of(Path(temporary) / "long", "parquet", 1320.0)
            taken = process("calibrate", str(folder), "--out", out, "--force")
            print(f"tumble calibrate, {rows_of(folder / 'log.parquet'):,} rows: {taken}")


if __name__ == "__main__":
    main()
