"""Does a recording depend on how it arrives, or on when the bench is killed?

Sessions of several grades and programmes are sent to a bench in pieces of random sizes, and calibrated from the page:
the result must be that of `tumble calibrate` for the recording that was sent, to the last digit. Then benches are
killed (SIGKILL) at random moments and started again on the same folder, while a session is sent to them, until it is
whole. After every kill the log must be a beginning of what was sent, with every row that was acknowledged: a row counts
as received when the bench asks for the next. In the end the log must be what was sent, its result that of the batch.

    python studies/bench_interruptions.py [--short]
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import sys
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from tumble.bench.session_folder import session_to_record
from tumble.bench.station import Station
from tumble.planning.setup import Setup
from tumble.recording.live.sources import Ended, LineSource
from tumble.run.calibrate import calibrate
from tumble.simulation.session import simulate_session

LONGEST_PIECE = 6000  # bytes
LONGEST_LIFE = 0.4  # s from the start of a bench, or of what it receives, to the kill
EARLY = 0.25
LONGEST_PAUSE = 0.03  # s between pieces while benches are killed
KINDS: tuple[dict[str, Any], ...] = (
    {"grade": "mems", "programme": "nine"},
    {"grade": "consumer", "positions": 8},
    {"grade": "tactical", "programme": "rough-table"},
    {"grade": "mems", "positions": 12, "sample_rate": 200.0},
)
"""The sessions, one after the other; each time with another seed."""


class Pieces(LineSource):
    """A source of the bytes of a log, from its beginning, in pieces of random sizes. `acknowledge` gets how many bytes
    of whole rows were received."""

    name, begins_anew = "pieces", True

    def __init__(self, log: Path, seed: int, *, pause: float = 0.0, acknowledge: Connection | None = None) -> None:
        self._data, self._rng = log.read_bytes(), np.random.default_rng(seed)
        self._at, self._first, self._pause, self._acknowledge = 0, 0, pause, acknowledge

    def hurry(self, rows: int) -> None:
        """Begin with a piece of so many rows, which are recorded already."""
        self._first = sum(len(line) for line in self._data.splitlines(keepends=True)[: rows + 1])

    def read(self, timeout: float) -> bytes:
        if self._acknowledge is not None:
            self._acknowledge.send(self._data.rfind(b"\n", 0, self._at) + 1)
        if self._at >= len(self._data):
            raise Ended
        time.sleep(min(self._rng.uniform(0.0, self._pause), timeout) if self._pause else 0.0)
        start = self._at
        self._at += self._first or int(self._rng.integers(1, LONGEST_PIECE))
        self._first = 0
        return self._data[start : self._at]


def simulated(folder: Path, k: int) -> Path:
    """The k-th session."""
    kind = KINDS[k % len(KINDS)]
    setup = Setup.of(**{"rest": 6.0, "rate_deg_s": 60.0, **kind})
    return simulate_session(folder, setup, seed=k, log_format="csv")


def prepared(recorded: Path, folder: Path) -> Path:
    """A session folder like that which was recorded, without its log."""
    folder.mkdir()
    (folder / "session.toml").write_bytes((recorded / "session.toml").read_bytes())
    session_to_record(folder)
    return folder


def without_date(path: Path) -> dict[str, Any]:
    """A calibration but for when it was made."""
    content = dict(json.loads(path.read_text(encoding="utf-8")))
    del content["provenance"]["created"]
    return content


def same_result(recorded: Path, folder: Path) -> bool:
    """Whether log and calibration of a folder are those of the recording."""
    calibrate(recorded).write(recorded / "batch.json", force=True)
    same_log = (folder / "log.csv").read_bytes() == (recorded / "log.csv").read_bytes()
    return same_log and without_date(folder / "calibration.json") == without_date(recorded / "batch.json")


def received_whole(folder: Path, source: Pieces) -> None:
    """Have a bench receive everything that a source sends, and calibrate."""
    station = Station(folder, lambda: source)
    station.start()
    try:
        while not station.state["received"]["ended"]:
            time.sleep(0.02)
        said = station.command("calibrate")
        assert said.startswith("calibrated"), said
    finally:
        station.stop()


def record(folder: Path, log: Path, seed: int, acknowledge: Connection) -> None:
    """A bench that is to be killed."""
    source = Pieces(log, seed, pause=LONGEST_PAUSE, acknowledge=acknowledge)
    station = Station(folder, lambda: source)
    station.start()
    while not station.state["received"]["ended"]:
        time.sleep(0.02)
    station.stop()


def killed(folder: Path, log: Path, rng: np.random.Generator) -> tuple[bool, int]:
    """Start a bench and kill it at a random moment, one in four before it may have begun to receive. Whether it had not
    ended before, and how many bytes it had acknowledged."""
    context = multiprocessing.get_context("forkserver")
    receive, send = context.Pipe(duplex=False)
    bench = context.Process(target=record, args=(folder, log, int(rng.integers(1 << 30)), send))
    bench.start()
    send.close()
    if rng.uniform() > EARLY:
        receive.poll(60.0)
    bench.join(rng.uniform(0.0, LONGEST_LIFE))
    alive = bench.is_alive()
    bench.kill()
    bench.join()
    acknowledged = 0
    try:
        while receive.poll():
            acknowledged = max(acknowledged, receive.recv())
    except EOFError:
        pass
    return alive, acknowledged


def interrupted(recorded: Path, folder: Path, rng: np.random.Generator, most: int) -> tuple[int, int, bool]:
    """Kill benches, at most so many, until the session is recorded, and let the last one end. How many were killed, how
    many lines were cut in two by a kill, and whether each log was a beginning of what was sent with all that was
    acknowledged."""
    log, original = folder / "log.csv", (recorded / "log.csv").read_bytes()
    kills = halves = 0
    sound = True
    while kills < most:
        alive, acknowledged = killed(folder, recorded / "log.csv", rng)
        found = log.read_bytes()
        whole = found[: found.rfind(b"\n") + 1]
        sound = sound and original.startswith(found) and len(whole) >= acknowledged
        kills += alive
        halves += found != whole
        if not alive:
            break
    return kills, halves, sound


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--short", action="store_true", help="one session and six kills")
    given = parser.parse_args()
    sessions, kills, per_session = (1, 6, 6) if given.short else (20, 200, 40)
    multiprocessing.set_forkserver_preload(["tumble.bench.station", __name__])
    rng, sound, same, count, halves, used = np.random.default_rng(1), True, 0, 0, 0, 0
    with tempfile.TemporaryDirectory() as made:
        for k in range(sessions):
            recorded = simulated(Path(made) / f"recorded-{k}", k)
            folder = prepared(recorded, Path(made) / f"received-{k}")
            received_whole(folder, Pieces(recorded / "log.csv", k))
            same += same_result(recorded, folder)
        print(f"{same} of {sessions} sessions in pieces of random sizes have the result of the batch")
        recovered = True
        while count < kills:
            recorded = simulated(Path(made) / f"sent-{used}", used)
            folder = prepared(recorded, Path(made) / f"killed-{used}")
            more, cut, as_sent = interrupted(recorded, folder, rng, min(per_session, kills - count))
            received_whole(folder, Pieces(recorded / "log.csv", used))
            recovered = recovered and same_result(recorded, folder)
            count, halves, sound, used = count + more, halves + cut, sound and as_sent, used + 1
    print(f"{count} benches killed in {used} sessions, {halves} in the middle of a line")
    print(f"nothing acknowledged is lost: {sound}; log and result are those without a kill: {recovered}")
    fine = same == sessions and sound and recovered
    print("Does a recording depend on how it arrives, or on when the bench is killed? " + ("No." if fine else "Yes."))
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main())
