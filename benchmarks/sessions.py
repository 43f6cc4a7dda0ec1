"""Processor time of whole sessions, from their logs or observations to the result.

An array of 24 accelerometers and 24 gyros (a recording of mimu4444, TUMBLE_DATA), a session that warms with a
thermometer, `tumble calibrate` of the Xsens recording as a process, twenty sessions of one device together, and a trial
of a campaign. Run with PYTHONPATH at the source of another commit it measures that one.
Usage: python benchmarks/sessions.py [array | warm | process | together | trial] …
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import tumble
from tumble.campaigns.campaign import Campaign
from tumble.campaigns.engine import run, serially
from tumble.planning.setup import Setup
from tumble.run.together import calibrate_together
from tumble.simulation.session import simulate_session
from tumble.simulation.temperature_profile import TemperatureProfile, temperature_profile

DATA = Path(os.environ.get("TUMBLE_DATA") or Path(__file__).parents[2] / "shared" / "data")
TOGETHER, TRIALS = 20, 20
DOWN = [[0, -1, 0], [-1, 0, 0], [0, 0, -1]]


def seconds(work: Callable[[], object], runs: int = 2) -> float:
    """The least processor time of some runs after a first one."""
    work()
    times = []
    for _ in range(runs):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def array(folder: Path) -> float:
    """Eight chips of a board as one array."""
    axes = [*np.eye(3).tolist(), *DOWN] * 4
    tables = "".join(
        f"[log.{kind}]\ncolumns = {[f'{kind[0]}{chip}{axis}' for chip in range(1, 9) for axis in 'xyz']}\n"
        f"unit = 'count'\nscale = {scale}\nscale_per = '{per}'\naxes = {axes}\n"
        for kind, scale, per in (("accel", 2048.0, "g"), ("gyro", 16.4, "deg/s"))
    )
    log = (DATA / "mimu4444" / "exp_3.parquet").as_posix()
    text = f"format = 1\n[device]\nserial = 'array'\n[site]\nlatitude_deg = 59.35\n[log]\nfile = '{log}'\ntime = 't'\n"
    (folder / "session.toml").write_text(text + tables)
    return seconds(lambda: tumble.calibrate(folder), 1)


def warm(folder: Path) -> float:
    """A session that warms while it is recorded, with its thermometer."""
    setup = Setup.of(grade="mems", positions=24, rest=5.0)
    simulate_session(folder / "warm", setup, seed=1, temperature=temperature_profile("20+15@300"))
    return seconds(lambda: tumble.calibrate(folder / "warm"))


def process(folder: Path) -> float:
    """The command itself."""
    command = [sys.executable, "-m", "tumble", "calibrate", str(DATA / "xsens-mti"), "--out", str(folder / "out.json")]
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # modules are not compiled anew, as pip leaves them
    times = []
    for _ in range(4):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run(command, check=True, capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(times[1:])


def together(folder: Path) -> float:
    """Sessions of one device over temperature."""
    setup = Setup.of(grade="tactical", rest=100.0, sample_rate=200.0)
    for i, celsius in enumerate(np.linspace(-20.0, 60.0, TOGETHER)):
        profile = TemperatureProfile(celsius=(float(celsius),))
        simulate_session(folder / f"session-{i:02d}", setup, seed=1, launch=i + 1, temperature=profile)
    sessions = sorted(folder.iterdir())
    calibrate_together(sessions[:2])
    start = time.process_time()
    calibrate_together(sessions)
    return time.process_time() - start


def trial(folder: Path) -> float:
    """One of a campaign of sessions from observations."""
    job = Campaign(trials=TRIALS, grid={"method": "joint"}).job()
    return seconds(lambda: run(job, Path(tempfile.mkdtemp(dir=folder)) / "out", executor=serially), 1) / TRIALS


def main() -> None:
    """Measure and print."""
    every = {"array": array, "warm": warm, "process": process, "together": together, "trial": trial}
    for name in sys.argv[1:] or every:
        with tempfile.TemporaryDirectory() as folder:
            print(f"{name}: {every[name](Path(folder)):.4f} s", flush=True)


if __name__ == "__main__":
    main()
