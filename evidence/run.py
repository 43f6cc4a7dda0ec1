"""Is what is accepted right? Recordings of the independent generator, kind by kind, calibrated as a user would.

    python evidence/run.py 40                 40 recordings of each kind
    python evidence/run.py 40 'lag*' clean-*  of some kinds

Every recording is a line of `results.jsonl` (those that are there are not made again); the table says of each kind
how many were accepted, accepted with scatter and refused, and of the 21 parameters of those accepted without a remark,
and of those with scatter, the rms of (value − truth)/u, the share beyond 3 u, the coverage of U (95 %) and the largest.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections import defaultdict
from dataclasses import replace
from fnmatch import fnmatch
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from generator import DEG, G0, NAMES, Spec, record

MICRO = 1e-6 * G0
HAND = Spec()
TABLE = Spec(grade="navigation", programme="table", rest=40.0, first_rest=40.0, turn=18.0, rate=50.0)
CUBE = Spec(programme="cube")
UNSTATED = {"log": '=file = "log.csv"\ntime = "t"'}

KINDS: dict[str, Spec] = {
    "clean-hand": HAND,
    "clean-hand-12": replace(HAND, rests=12),
    "clean-table": TABLE,
    "clean-cube": CUBE,
    "instantaneous": replace(HAND, instantaneous=True),
    "groups-3-hand": replace(HAND, groups=3.0),
    "groups-10-hand": replace(HAND, groups=10.0),
    "groups-3-table": replace(TABLE, groups=3.0),
    "grade-wrong-table": replace(TABLE, grade="tactical", stated={"device": 'grade = "navigation"'}),
    "grade-wrong-hand": replace(HAND, stated={"device": 'grade = "tactical"'}),
    **{f"lag-{lag}-{warm}K": replace(HAND, warming=(float(warm), 100.0, float(lag)))
       for lag in (0, 15, 30, 60) for warm in (2, 8, 14)},
    "lag-300-6K-table": replace(TABLE, warming=(6.0, 300.0, 300.0)),
    **{f"spike-{g}g": replace(HAND, spikes=1, spike=g * G0) for g in (0.5, 1, 5, 20, 50)},
    "spike-rail": replace(HAND, spikes=1, spike=np.inf),
    **{f"gyro-spike-{rate}": replace(HAND, spikes=1, spike=rate * DEG, spiked="gyro") for rate in (3, 10, 100, 500)},
    "gyro-spike-rail": replace(HAND, spikes=1, spike=np.inf, spiked="gyro"),
    "held": replace(HAND, held=1),
    "held-table": replace(TABLE, held=1),
    **{f"clock-{ppm}-table": replace(TABLE, clock_ppm=float(ppm), stated=UNSTATED) for ppm in (0, 5, 50, 500)},
    **{f"dead-zone-{zone}": replace(HAND, dead_zone=zone * DEG) for zone in (0.02, 0.1, 0.15, 0.3, 0.5)},
    **{f"jump-{jump}": replace(HAND, jump=jump * DEG) for jump in (0.05, 0.3, 3.0)},
    "normalised": replace(HAND, normalised=True),
    "one-scatters-table": replace(TABLE, scatter_of_one=25.0 * MICRO),
    "one-scatters-hand": replace(HAND, scatter_of_one=3e-3),
    **{f"in-run-{what}": replace(HAND, in_run=what, in_run_size=6.0) for what in ("white", "walk", "flicker")},
    **{f"in-run-markov-{tau}": replace(HAND, in_run="markov", in_run_size=6.0, in_run_time=float(tau))
       for tau in (30, 100, 300)},
    "in-run-exponential-100": replace(HAND, in_run="exponential", in_run_size=40.0),
    "rounded": replace(HAND, step=(4.8e-3, 1.0 / 16.4 * DEG)),
}  # fmt: skip
RESULTS = Path(__file__).parent / "results.jsonl"


def tried(job: tuple[str, int]) -> dict[str, object]:
    """One recording of a kind: the verdict, why, and the errors in units of u and of half U (95 %)."""
    import tumble

    kind, seed = job
    with tempfile.TemporaryDirectory() as scratch:
        made = record(KINDS[kind], seed)
        found = tumble.calibrate(made.write(Path(scratch) / "session"))
    z = {
        name: (found[name].value - made.truth[name]) / found[name].u
        for name in NAMES
        if name in found and found[name].u
    }
    covered = {name: abs(value) <= 1.95996 * (found[name].k or 2.0) / 2.0 for name, value in z.items()}
    said = [*found.outcome.reasons, *found.outcome.remarks]
    return {
        "kind": kind, "seed": seed, "verdict": found.outcome.verdict, "said": said[:2],
        "z": {name: round(value, 3) for name, value in z.items()}, "covered": sum(covered.values()),
    }  # fmt: skip


def table(rows: list[dict[str, object]]) -> None:
    """A line of Markdown for each kind: of those accepted, and of those with scatter, rms, share beyond 3 u, coverage
    and the largest."""
    of_kind = defaultdict(list)
    for row in rows:
        of_kind[row["kind"]].append(row)
    print("| kind | N | accepted, with scatter, not | accepted: rms, > 3 u, covered, largest | with scatter |")
    print("|---|---|---|---|---|")
    for kind in (kind for kind in KINDS if kind in of_kind):
        every = of_kind[kind]
        by = {v: [r for r in every if r["verdict"] == v] for v in ("accepted", "accepted with scatter", "not accepted")}
        cells = [kind, f"{len(every)}", ", ".join(f"{len(each)}" for each in by.values())]
        for verdict in ("accepted", "accepted with scatter"):
            z = np.array([value for row in by[verdict] for value in row["z"].values()])
            if len(z):
                covered = sum(row["covered"] for row in by[verdict]) / len(z)
                beyond, largest = 100.0 * np.mean(np.abs(z) > 3.0), np.abs(z).max()
                cells.append(f"{np.sqrt(np.mean(z**2)):.2f}, {beyond:.1f} %, {100.0 * covered:.1f} %, {largest:.1f}")
            else:
                cells.append("")
        print(f"| {' | '.join(cells)} |")


def main() -> None:
    count, patterns = int(sys.argv[1]), sys.argv[2:] or ["*"]
    there = [json.loads(line) for line in RESULTS.read_text().splitlines()] if RESULTS.exists() else []
    done = {(row["kind"], row["seed"]) for row in there}
    kinds = [kind for kind in KINDS if any(fnmatch(kind, pattern) for pattern in patterns)]
    jobs = [(kind, seed) for seed in range(count) for kind in kinds if (kind, seed) not in done]
    with get_context("spawn").Pool(2) as pool, RESULTS.open("a", encoding="utf-8") as out:
        for row in pool.imap_unordered(tried, jobs):
            out.write(json.dumps(row) + "\n")
            out.flush()
            there.append(row)
    table([row for row in there if row["kind"] in kinds and row["seed"] < count])


if __name__ == "__main__":
    main()
