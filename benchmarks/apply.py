"""How much memory and time `tumble apply` takes for two million rows, between all formats, and polars for the same.

The log has a time and six sensors. Peak memory is that of the whole process; it does not grow with the log, which
`--long` shows with 20 million rows (8 GB in the folder of temporary files). Time is that of the processor.
Usage: python benchmarks/apply.py [--long]
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import polars as pl
from calibrate import ONE_RUN, TUMBLE, machine

from tumble.planning.setup import Setup
from tumble.recording.readers import write_tables
from tumble.recording.session_file import write_session
from tumble.run.calibrate import calibrate
from tumble.simulation.session import simulate_session

ROWS = 20_000_000 if "--long" in sys.argv else 2_000_000
UNITS = {"accel": "m/s^2", "gyro": "rad/s"}
COLUMNS = ("ax", "ay", "az", "gx", "gy", "gz")


def tables(rows: int, size: int = 1 << 16) -> Iterator[pl.DataFrame]:
    """A log of noise, table after table."""
    rng = np.random.default_rng(1)
    for first in range(0, rows, size):
        count = min(size, rows - first)
        sensors = rng.standard_normal((len(COLUMNS), count))
        yield pl.DataFrame({"t": 0.01 * np.arange(first, first + count), **dict(zip(COLUMNS, sensors, strict=True))})


def session_of(folder: Path, ending: str) -> Path:
    """A session folder with a log of that format."""
    parts = {kind: {"columns": [f"{kind[0]}{axis}" for axis in "xyz"], "unit": unit} for kind, unit in UNITS.items()}
    content = {"format": 1, "device": {"serial": "mems-1"}, "log": {"file": f"log.{ending}", "time": "t", **parts}}
    write_session(folder, content)
    write_tables(folder / f"log.{ending}", tables(ROWS))
    return folder


COPY = """
import sys, polars
log, out = sys.argv[1:]
table = polars.scan_parquet(log) if log.endswith("parquet") else polars.scan_csv(log)
(table.sink_parquet if out.endswith("parquet") else table.sink_csv)(out)
"""
"""What polars needs to read a log and to write it."""


def processed(*command: str) -> list[float]:
    """Exit status, seconds by the clock, peak MB and seconds of the processor of a command."""
    run = [sys.executable, "-S", "-c", ONE_RUN, *command]
    return [float(word) for word in subprocess.run(run, capture_output=True, text=True, check=True).stdout.split()]


def main() -> None:
    print(machine())
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        request = Setup.of(grade="mems", positions=14, rest=5.0, sample_rate=50.0)
        calibration = root / "calibration.json"
        calibrate(simulate_session(root / "device", request, seed=1)).write(calibration)
        for source in ("parquet", "csv"):
            folder = session_of(root / source, source)
            for target in ("parquet", "csv"):
                out = root / f"out.{target}"
                log = folder / f"log.{source}"
                code, _, peak, ours = processed(str(TUMBLE), "apply", str(calibration), str(folder), "-o", str(out))
                _, _, _, theirs = processed(sys.executable, "-c", COPY, str(log), str(out))
                print(
                    f"{ROWS:,} rows {source} to {target}: exit {code:.0f}, {ours:.1f} s, {peak:.0f} MB; polars "
                    f"{theirs:.1f} s, {ours / theirs:.1f} times (target 2)"
                )
                out.unlink()


if __name__ == "__main__":
    main()
