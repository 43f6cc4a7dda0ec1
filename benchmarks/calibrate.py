"""How long `tumble calibrate` takes, and how much memory, against reading the same file with polars.

Whole process: start-up of `tumble --help`, and `tumble calibrate` on the Xsens recording (TUMBLE_DATA) and on a
simulated hour at 1 kHz, Parquet and CSV, with peak memory. In process, imports and compilation excluded: calibrating
the hour against the time polars takes to read the same columns into memory, pair by pair; and reading it until its
blocks are reduced against polars reading the file with all columns, the least of three each, by the clock and in
processor time. With `--long` the memory of 20 million rows,
too. Usage: python benchmarks/calibrate.py [--long]
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
READINGS = 3


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


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


def process(*command: str) -> tuple[float, float]:
    """Median wall time (s) of a command over RUNS, after one run to warm up, and its largest peak memory (MB)."""
    times, peaks = [], []
    for _ in range(RUNS + 1):
        run = [sys.executable, "-S", "-c", ONE_RUN, str(TUMBLE), *command]
        code, seconds, peak, _ = subprocess.run(run, capture_output=True, text=True, check=True).stdout.split()
        if code not in ("0", "1"):
            raise SystemExit(f"{' '.join(command)} failed")
        times.append(float(seconds))
        peaks.append(float(peak))
    return statistics.median(times[1:]), max(peaks)


def against_polars(folder: Path) -> tuple[float, float, float]:
    """Median of the ratio calibrate / polars, pair by pair, and the medians of both (s)."""
    session = read_session(folder)
    log, columns = session.log.files[0], list(session.log.columns)
    read = pl.read_parquet if log.suffix == ".parquet" else pl.read_csv
    calibrate(session)
    pairs = [(seconds(lambda: calibrate(session)), seconds(lambda: read(log, columns=columns))) for _ in range(RUNS)]
    ours, theirs = zip(*pairs, strict=True)
    return statistics.median(a / b for a, b in pairs), statistics.median(ours), statistics.median(theirs)


def reading_against_polars(folder: Path) -> tuple[tuple[float, float], tuple[float, float]]:
    """Seconds by the clock and of processor time, the least of READINGS in turn, until the blocks of a log are reduced,
    and until polars has read all of the file."""
    session = read_session(folder)
    log = session.log.files[0]
    read = pl.read_parquet if log.suffix == ".parquet" else pl.read_csv

    def both(work: Callable[[], object]) -> tuple[float, float]:
        start, busy = time.perf_counter(), time.process_time()
        work()
        return time.perf_counter() - start, time.process_time() - busy

    def least(times: list[tuple[float, float]]) -> tuple[float, float]:
        return min(wall for wall, _ in times), min(busy for _, busy in times)

    def reduced() -> object:
        return reduce_log(open_log(session), session.accel_block, session.gyro_block)

    reduced()
    pairs = [(both(reduced), both(lambda: read(log))) for _ in range(READINGS)]
    return least([ours for ours, _ in pairs]), least([theirs for _, theirs in pairs])


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
    lines = [machine()]
    with tempfile.TemporaryDirectory() as temporary:
        out = str(Path(temporary) / "out.json")
        wall, _ = process("--help")
        lines.append(f"tumble --help {wall:.3f} s")
        if (DATA / "xsens-mti").is_dir():
            wall, peak = process("calibrate", str(DATA / "xsens-mti"), "--out", out, "--force")
            lines.append(f"tumble calibrate xsens-mti: {wall:.2f} s, peak {peak:.0f} MB")
        for log_format in ("parquet", "csv"):
            folder = session_of(Path(temporary) / log_format, log_format, 225.0)
            wall, peak = process("calibrate", str(folder), "--out", out, "--force")
            rows = rows_of(folder / f"log.{log_format}")
            lines.append(f"tumble calibrate, {rows:,} rows {log_format}: {wall:.2f} s, peak {peak:.0f} MB")
            ratio, ours, theirs = against_polars(folder)
            lines.append(f"    in process {ours:.3f} s; polars reads it in {theirs:.3f} s; ratio {ratio:.2f}")
            (wall, busy), (its_wall, its_busy) = reading_against_polars(folder)
            lines.append(
                f"    until blocks are reduced {wall:.3f} s, of processor time {busy:.3f} s; polars reads all of it in "
                f"{its_wall:.3f} s, {its_busy:.3f} s; ratios {wall / its_wall:.2f}, {busy / its_busy:.2f}"
            )
            shutil.rmtree(folder)
        if "--long" in sys.argv:
            folder = session_of(Path(temporary) / "long", "parquet", 1320.0)
            wall, peak = process("calibrate", str(folder), "--out", out, "--force")
            lines.append(
                f"tumble calibrate, {rows_of(folder / 'log.parquet'):,} rows: {wall:.2f} s, peak {peak:.0f} MB"
            )
    print(*lines, sep="\n")


if __name__ == "__main__":
    main()
