"""Does the bench last a day?

Eight hours of a unit with accelerometers, gyros and a magnetometer at 1 kHz, 29 million samples in 60 positions, are
received as fast as they can be followed, by the threads that follow a bench. Counted are the samples in the log and
those followed, the memory of the process and its processor time. Then the unit goes on in real time: from the moment a
sample is sent to that when a state with it can be fetched by a page, and from a changed set of rests to the state with
their estimate.

    python studies/bench_endurance.py [--short] [--hours 8]
"""

from __future__ import annotations

import argparse
import resource
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tumble.bench.session_folder import begin
from tumble.bench.station import Station
from tumble.earth import earth_rate
from tumble.recording.live.samples import SI_LOG
from tumble.recording.live.sources import LineSource
from tumble.rotation import rotation_matrix, rotation_vector
from tumble.units import DEGREE, Array
from tumble.usual_setup import LATITUDE_DEG

RATE = 1000
POSITIONS = 60
TURN = 10  # s
POOL = 4000  # rows of noise of a rest
GRAVITY = 9.81579
NOISE = np.array([3e-3] * 3 + [1e-3] * 3 + [0.1] * 3)
FIELD = np.array([18.0, -46.0, 3.0])  # µT: N, U, E
MEMORY = 400.0  # MB
AHEAD = 8 << 20  # bytes that may be sent and not yet followed
REAL_TIME = 10.0  # s
COLUMNS = ("t", "ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz")


class Unit(LineSource):
    """A source: what the unit sends in so many seconds, no faster than it is followed, and then in real time."""

    name = "unit"

    def __init__(self, seconds: float) -> None:
        self.seconds, self.sent, self.bytes, self.followed = seconds, 0, 0, 0
        self.times: list[tuple[int, float]] = []
        self._rng = np.random.default_rng(1)
        self._rows = self._moving(seconds / POSITIONS)
        self._real_since: tuple[float, int] | None = None

    def _moving(self, period: float) -> Iterator[list[str]]:
        """The readings of a second as text, without their times."""
        L = np.eye(3)
        while True:
            still = np.broadcast_to(L, (POOL, 3, 3))
            pool = self._text(still, np.zeros((POOL, 3)))
            for _ in range(max(round(period) - TURN, TURN)):
                yield [pool[i] for i in self._rng.integers(0, POOL, RATE).tolist()]
            target = rotation_matrix(self._rng.uniform(-2.0, 2.0, 3)) @ L
            v, part = rotation_vector(target @ L.T), (np.arange(TURN * RATE) + 0.5) / (TURN * RATE)
            angle = part - np.sin(2.0 * np.pi * part) / (2.0 * np.pi)
            rate = (1.0 - np.cos(2.0 * np.pi * part)) / TURN
            turning = self._text(rotation_matrix(angle[:, None] * v) @ L, rate[:, None] * v)
            for at in range(0, TURN * RATE, RATE):
                yield turning[at : at + RATE]
            L = target

    def _text(self, L: Array, rate: Array) -> list[str]:
        earth = np.array(earth_rate(LATITUDE_DEG * DEGREE))
        seen = [
            np.einsum("kij,ki->kj", L, np.broadcast_to(x, rate.shape))
            for x in (GRAVITY * np.eye(3)[1], rate + earth, FIELD)
        ]
        values = np.concatenate(seen, axis=1) + NOISE * self._rng.standard_normal((len(rate), 9))
        return [",".join(f"{x:.6g}" for x in row) for row in values.tolist()]

    def read(self, timeout: float) -> bytes:
        if self.sent >= self.seconds * RATE:
            return self._in_real_time(timeout)
        if self.bytes - self.followed > AHEAD:
            time.sleep(min(timeout, 0.01))
            return b""
        return self._lines(next(self._rows))

    def _in_real_time(self, timeout: float) -> bytes:
        if self._real_since is None:
            self._real_since, self._left = (time.monotonic(), self.sent), iter(next(self._rows))
        began, first = self._real_since
        time.sleep(min(timeout, 0.02))
        due = int((time.monotonic() - began) * RATE) - (self.sent - first)
        rows: list[str] = []
        while len(rows) < due:
            rows += list(self._left) or []
            self._left = iter(next(self._rows))
        rows, rest = rows[:due], rows[due:]
        self._left = iter([*rest, *self._left])
        data = self._lines(rows)
        self.times.append((self.sent, time.monotonic()))
        return data

    def _lines(self, rows: list[str]) -> bytes:
        times = range(self.sent + 1, self.sent + len(rows) + 1)
        data = "".join(f"{k / RATE:.3f},{row}\n" for k, row in zip(times, rows, strict=True)).encode("ascii")
        self.sent += len(rows)
        self.bytes += len(data)
        return data


def latency(unit: Unit, station: Station, seconds: float) -> Array:
    """Times, s, from a sample to the first state with it: of each state the longest."""
    found, end, state = [], time.monotonic() + seconds, station.state
    while time.monotonic() < end:
        if station.state is state:
            time.sleep(0.002)
            continue
        before, state = state, station.state
        now, shown, seen = time.monotonic(), before["received"]["samples"], state["received"]["samples"]
        found += [now - next(at for count, at in unit.times if count > shown)] if seen > shown else []
    return np.array(found)


def until_estimated(station: Station) -> float:
    """The time, s, from a rest that is left out to the state with the estimate without it, while samples come."""
    before, began = station.state["estimate"], time.monotonic()
    station.command("leave_out", "1")
    while station.state["estimate"] is before:
        time.sleep(0.01)
    return time.monotonic() - began


def memory() -> float:
    """The most memory the process has had, MB; where there is no /proc, or of the process that started it if that is
    more."""
    status = Path("/proc/self/status")
    if not status.exists():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    (peak,) = (line.split()[1] for line in status.read_text().splitlines() if line.startswith("VmHWM:"))
    return float(peak) / 1e3


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--short", action="store_true", help="a minute and a half of log")
    parser.add_argument("--hours", type=float, default=8.0)
    given = parser.parse_args()
    seconds = 90.0 if given.short else 3600.0 * given.hours
    folder = Path(tempfile.mkdtemp())
    log = {**SI_LOG} | {"magnetometer": {"columns": list(COLUMNS[7:]), "unit": "uT"}}
    begin(folder / "launch", log=log, serial="endurance", site={"latitude_deg": LATITUDE_DEG}, programme=None)
    unit = Unit(seconds)
    station = Station(folder / "launch", lambda: unit)
    before, began, cpu = memory(), time.monotonic(), time.process_time()
    station.start()
    try:
        hour = 1
        while station.state["received"]["samples"] < seconds * RATE - 1:
            time.sleep(0.05)
            unit.followed = station.followed
            if station.state.get("seconds", 0.0) > 3600.0 * hour:
                said = f"{hour} h: {memory():.0f} MB, {time.process_time() - cpu:.0f} s of processor time"
                print(f"{said}, {(station.state['estimate'] or {}).get('rests')} rests", flush=True)
                hour += 1
        spent, passed = time.process_time() - cpu, time.monotonic() - began
        while station.state["estimating"]:
            time.sleep(0.05)
        late = latency(unit, station, 2.0 if given.short else REAL_TIME)
        state, waited = station.state, until_estimated(station)
    finally:
        station.stop()
    with (folder / "launch" / "log.csv").open("rb") as file:
        rows = sum(piece.count(b"\n") for piece in iter(lambda: file.read(1 << 20), b"")) - 1
    shutil.rmtree(folder)
    estimate, received = state["estimate"], state["received"]
    print(f"{seconds / 3600.0:.2f} h of log in {passed / 60.0:.1f} min, {spent:.0f} s of processor time")
    print(f"{unit.sent} samples sent, {rows} in the log, {received['lost']} lost, {received['refused']} refused")
    print(f"memory {memory():.0f} MB at most, {before:.0f} MB before the first sample")
    found = f"{estimate['rests']} rests with {estimate['unknowns']} unknowns"
    print(f"an estimate of {found} takes {estimate['seconds']:.2f} s of processor time")
    print(f"from a rest that is left out to the estimate without it on the state: {waited:.2f} s")
    print(f"from a sample to the state with it: {np.median(late):.2f} s in the middle, {late.max():.2f} s at most")
    kept = rows == unit.sent and received["lost"] == 0 and memory() < MEMORY
    print("Does the bench last a day? " + ("Yes: no sample is lost, in less than 400 MB" if kept else "No"))
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
