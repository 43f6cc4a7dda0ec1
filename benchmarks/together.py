"""Sessions together: processor time and memory of 5, 10 and 20 sessions of 30 minutes at 200 samples a second, each at
a temperature of its own, from their logs to the result, each count in a process of its own.
"""

from __future__ import annotations

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tumble.planning.setup import Setup
from tumble.run.together import calibrate_together
from tumble.simulation.session import simulate_session
from tumble.simulation.temperature_profile import TemperatureProfile

COUNTS = (5, 10, 20)
SESSION = Setup.of(grade="tactical", rest=100.0, sample_rate=200.0)


def made(folder: Path) -> None:
    """Write the sessions: one device, launched anew at every temperature."""
    for i, celsius in enumerate(np.linspace(-20.0, 60.0, COUNTS[-1])):
        profile = TemperatureProfile(celsius=(float(celsius),))
        simulate_session(folder / f"session-{i:02d}", SESSION, seed=1, launch=i + 1, temperature=profile)


def measured(folder: Path, count: int) -> None:
    """Print what so many sessions, spread over the temperatures, take."""
    sessions = sorted(folder.iterdir())[:: COUNTS[-1] // count]
    calibrate_together(sessions[:2])  # the compiler, and the files' libraries
    before, wall = time.process_time(), time.perf_counter()
    found = calibrate_together(sessions)
    passed, wall = time.process_time() - before, time.perf_counter() - wall
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    said = f"{passed:5.1f} s of the processor ({wall:.1f} s), {passed / count:.2f} s a session, {memory:.0f} MB"
    print(f"{len(sessions):2d} sessions: {said}, {found.outcome.verdict}", flush=True)


def main() -> None:
    if len(sys.argv) == 3:
        measured(Path(sys.argv[1]), int(sys.argv[2]))
        return
    with tempfile.TemporaryDirectory() as folder:
        made(Path(folder))
        for count in COUNTS:
            subprocess.run([sys.executable, __file__, folder, str(count)], check=True)


if __name__ == "__main__":
    main()
