"""Does a registry lose anything when its writer is killed?

A writer adds calibrations to a registry, one after the other, and acknowledges each when it is committed. At a random
moment it is killed (SIGKILL). After every kill the registry is opened by another process: the database must be whole,
every record complete, its content that of its hash, and every acknowledged record there. Writers are started from a
process that has imported everything, so that a kill may fall into the opening of the registry, the making of its tables
or a record. A file is left for a new one now and then, so that making it is interrupted as well; a database on a server
is kept.

    python studies/registry_interruptions.py [--short] [--registry FILE|URL]
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import count
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
from sqlalchemy import func, select, text

from tumble.lab.registry.database import LOGS
from tumble.lab.registry.registry import open_registry
from tumble.result.calibration import Calibration, calibration_of

PARAMETERS = 3
LONGEST = 0.3  # s from the start of a writer, or from its first record, to the kill
KILLS_OF_A_FILE = 50
IMPORTED = ["numpy", "sqlalchemy.dialects.sqlite", "psycopg", "tumble.lab.registry.registry"]


def calibrations(seed: int) -> Iterator[Calibration]:
    """Calibrations of a device, each with another content and log."""
    rng = np.random.default_rng(seed)
    for i in count():
        parameters = [
            {"name": f"accel.bias.{axis}", "value": float(rng.standard_normal()), "u": 1e-3, "unit": "m/s^2"}
            for axis in "xyz"
        ]
        content = {
            "format": 1,
            "device": {"serial": f"device-{seed}", "model": None},
            "method": "joint",
            "frame": "accelerometer",
            "parameters": parameters,
            "covariance": (1e-6 * np.eye(PARAMETERS)).tolist(),
            "accel": None,
            "gyro": None,
            "outcome": {"accepted": True, "reasons": []},
            "notes": ["x" * 9_000, "y" * 9_000],
            "provenance": {"log_sha256": f"{seed}-{i}", "created": "2026-01-01"},
        }
        yield calibration_of(json.dumps(content), f"{seed}-{i}")


def write(place: str, seed: int, acknowledge: Connection) -> None:
    """Add calibrations until killed."""
    with open_registry(place, create=True) as registry:
        for calibration in calibrations(seed):
            record = registry.add_calibration(calibration, performed=datetime(2026, 1, 1, tzinfo=UTC))
            acknowledge.send_bytes(record.sha256.encode())


def interrupted(place: str, seed: int, delay: float, *, at_work: bool) -> list[str]:
    """Start a writer, kill it `delay` seconds later, counted from its first record where it is to be `at_work`; the
    hashes that it had acknowledged."""
    context = multiprocessing.get_context("forkserver")
    receive, send = context.Pipe(duplex=False)
    writer = context.Process(target=write, args=(place, seed, send))
    writer.start()
    send.close()
    if at_work:
        receive.poll(60.0)
    time.sleep(delay)
    writer.kill()
    writer.join()
    acknowledged = []
    try:
        while True:
            acknowledged.append(receive.recv_bytes().decode())
    except (EOFError, OSError):  # the end, or the middle of a message
        return acknowledged


@dataclass(frozen=True, kw_only=True, slots=True)
class Found:
    """What is in the registry: hashes of all records, and what is wrong."""

    records: set[str]
    faults: list[str]


def look(place: str, contents: bool) -> Found:
    """Open the registry and check it; with `contents` also every file against its hash."""
    faults = []
    with open_registry(place, create=True) as registry:
        with registry.database.reading() as rows:
            if registry.database.engine.dialect.name == "sqlite":
                said = rows.connection.execute(text("PRAGMA integrity_check")).scalars().all()
                faults += [line for line in said if line != "ok"]
            query = select(LOGS.c.calibration, func.count().label("rows")).group_by(LOGS.c.calibration)
            logs = {row.calibration: row.rows for row in rows.connection.execute(query)}
        records = {record.number: record.sha256 for record in registry.records()}
        faults += [f"record {n} has {logs.get(n)} logs" for n in records if logs.get(n) != 1]
        for record in registry.records() if contents else ():
            content = json.dumps(json.loads(registry.file(record)), sort_keys=True, separators=(",", ":"))
            if hashlib.sha256(content.encode()).hexdigest() != record.sha256:
                faults.append(f"another content than {record.sha256}")
    return Found(records=set(records.values()), faults=faults)


@dataclass(kw_only=True, slots=True)
class Tally:
    """What the interruptions did."""

    acknowledged: int = 0
    lost: int = 0
    silent: int = 0
    before: int = 0
    faults: int = 0


def interrupt(place: str | None, kills: int, seed: int) -> Tally:
    """Interrupt writers so many times: of a registry, or of files of their own."""
    multiprocessing.get_context("forkserver").set_forkserver_preload(IMPORTED)
    rng = np.random.default_rng(seed)
    tally = Tally()
    with tempfile.TemporaryDirectory() as folder:
        known: set[str] = set()
        for kill in range(kills):
            at = place or str(Path(folder) / f"{kill // KILLS_OF_A_FILE}.sqlite")
            if place is None and kill % KILLS_OF_A_FILE == 0:
                known = set()
            acknowledged = interrupted(at, kill, float(rng.uniform(0.0, LONGEST)), at_work=kill % 2 == 1)
            known |= set(acknowledged)
            found = look(at, contents=kill % KILLS_OF_A_FILE == KILLS_OF_A_FILE - 1 or kill == kills - 1)
            tally.acknowledged += len(acknowledged)
            tally.before += not acknowledged
            tally.lost += len(known - found.records)
            tally.silent += len(found.records - known)
            tally.faults += len(found.faults)
            known |= found.records
            if found.faults or known - found.records:
                print(f"kill {kill}: {found.faults[:3]}, lost {len(known - found.records)}")
    return tally


def main(arguments: list[str]) -> int:
    """Interrupt, look, answer."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--short", action="store_true", help="20 interruptions in place of 1000")
    parser.add_argument("--registry", help="a file or URL; default: files of its own")
    options = parser.parse_args(arguments)
    kills = 20 if options.short else 1000
    started = time.monotonic()
    tally = interrupt(options.registry, kills, seed=1)
    within = f"{kills} writers killed within {1e3 * LONGEST:.0f} ms of their start or first record"
    print(f"{within}, in {time.monotonic() - started:.0f} s")
    print(f"killed before their first record was acknowledged: {tally.before}")
    print(f"records acknowledged: {tally.acknowledged}; committed in the moment before the kill: {tally.silent}")
    print(f"acknowledged and lost: {tally.lost}; faults of the database: {tally.faults}")
    kept = tally.lost == tally.faults == 0 and tally.acknowledged > 0
    print(f"\nDoes a registry lose anything when its writer is killed? {'No' if kept else 'Yes'}.")
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
