"""How much memory and time `tumble apply` takes for 20 million rows, between all formats.

The log has a time and six sensors; it and the corrected ones need about 8 GB in the folder of temporary files. Peak
memory is that of the whole process. Usage: python benchmarks/apply.py [--short]
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

ROWS = 1_000_000 if "--short" in sys.argv else 20_000_000
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


def main() -> None:
    print(machine())
    with tempfile.TemporaryDirectory() as temporary:
        root = Path(temporary)
        request = Setup.of(grade="mems", positions=14, rest=5.0, sample_rate=50.0)
        calibrate(simulate_session(root / "device", request, seed=1)).write(root / "calibration.json")
        for source in ("parquet", "csv"):
            folder = session_of(root / source, source)
            for target in ("parquet", "csv"):
                out = root / f"out.{target}"
                words = [str(TUMBLE), "apply", str(root / "calibration.json"), str(folder), "-o", str(out)]
                run = [sys.executable, "-S", "-c", ONE_RUN, *words]
                code, seconds, peak = subprocess.run(run, capture_output=True, text=True, check=True).stdout.split()
                print(f"{ROWS:,} rows {source} to {target}: exit {code}, {float(seconds):.1f} s, {float(peak):.0f} MB")
                out.unlink()


if __name__ == "__main__":
    main()
