"""Which method, when?

Bias and scatter of every method on the same simulated sessions, on tables and in mountings that are off by up to 0.1°
to 5° about each axis, and by hand; what a method needs, what it gives, and how long it takes. Navigation-grade
instruments in the programme rough-table (rests of 60 s) and a MEMS unit in 20 positions by hand, all with white noise
and in-run instability, drawn anew in every session; observations directly from the truth (`tumble campaign`).

    python studies/which_method_when.py [--short] [--store]

--store keeps the result beside this file, from which studies/methods.md is written. The answer is printed last.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tumble.campaigns.campaign import Campaign, SummaryLine, summary
from tumble.campaigns.engine import run
from tumble.campaigns.trial import random_numbers
from tumble.planning.setup import GROUPS, UNITS, Setup
from tumble.run.calibrate import ITERATED_METHODS, METHODS
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of
from tumble.units import engineering

STORED = Path(__file__).with_suffix(".json")
TABLES = (0.1, 0.5, 1.0, 2.0, 5.0)
"""Largest errors of table and mounting about each axis, degrees."""

ON_TABLE = ("joint", "scalar", "sequential", "ellipsoid")
BY_HAND = ("joint", "ellipsoid")
POSITIONS = 20

NEEDS: Mapping[str, tuple[str, str]] = {
    "joint": ("rests in nine attitudes or more; turns between them", "all parameters"),
    "scalar": ("the positions and known turns of a programme like `rough-table`; triads", "all parameters"),
    "sequential": ("the same", "all parameters"),
    "ellipsoid": ("rests in nine attitudes or more; no gyros", "accelerometers"),
}
"""What each method needs, and what it gives."""

Result = dict[str, Any]


# -------------------- the runs --------------------


def found(sessions: int) -> Result:
    """Everything that is measured, of JSON values."""
    where = {f"±{degrees:g}°": lines_on_table(degrees, sessions) for degrees in TABLES}
    where["by hand"] = lines_of({"method": list(BY_HAND), "grade": "mems", "positions": POSITIONS}, sessions)
    return {
        "sessions": sessions,
        "errors": {place: [_kept(line) for line in lines] for place, lines in where.items()},
        "milliseconds": {method: 1e3 * seconds_of(method) for method in ON_TABLE},
    }


def lines_on_table(degrees: float, sessions: int) -> Sequence[SummaryLine]:
    return lines_of({"method": list(ON_TABLE), "table_error_deg": degrees, "mounting_error_deg": degrees}, sessions)


def lines_of(grid: Mapping[str, Any], sessions: int) -> Sequence[SummaryLine]:
    """The summary of a campaign of one point."""
    with tempfile.TemporaryDirectory() as folder:
        return summary(run(Campaign(seed=19, trials=sessions, grid=grid).job(), Path(folder) / "out"))


def _kept(line: SummaryLine) -> Result:
    names = ("method", "group", "trials", "accepted", "bias", "scatter", "rms", "to_bound", "coverage")
    return {name: getattr(line, name) for name in names}


def seconds_of(method: str, runs: int = 9) -> float:
    """Processor time of a calibration from observations, s: the median of several sessions."""
    setup = Setup.of()
    estimate = METHODS.get(method) or (lambda observations: ITERATED_METHODS[method](observations, 2))
    times = []
    for number in range(runs + 1):
        rng = random_numbers(23, number)
        observations = simulate_observations(scenario_of(setup, rng), rng)
        start = time.process_time()
        estimate(observations)
        times.append(time.process_time() - start)
    return float(np.median(times[1:]))


# -------------------- the tables --------------------


def needs_table(result: Result) -> str:
    """What each method needs and gives, and how long it takes, in Markdown."""
    rows = ["| method | needs | gives | time, ms |", "|---|---|---|---|"]
    for method, (needs, gives) in NEEDS.items():
        rows.append(f"| `{method}` | {needs} | {gives} | {result['milliseconds'][method]:.0f} |")
    return "\n".join(rows)


def errors_table(result: Result) -> str:
    """Bias and scatter of each method at each place, in Markdown."""
    sizes = {group: engineering(UNITS[group], _typical(result, group)) for group in GROUPS}
    rows = [
        "| table, mounting | method | " + " | ".join(f"{g}, {unit}" for g, (_, unit) in sizes.items()) + " |",
        "|---|---|" + "---|" * len(GROUPS),
    ]
    for place, lines in result["errors"].items():
        hand = place == "by hand"
        if hand:
            sizes = {group: engineering(UNITS[group], _typical(result, group, place)) for group in GROUPS}
            rows.append("| **by hand, MEMS** | | " + " | ".join(f"**{unit}**" for _, unit in sizes.values()) + " |")
        for method in BY_HAND if hand else ON_TABLE:
            of = {line["group"]: line for line in lines if line["method"] == method}
            cells = [_cell(of.get(group), sizes[group][0]) for group in GROUPS]
            rows.append(f"| {place} | `{method}` | " + " | ".join(cells) + " |")
    return "\n".join(rows)


def _typical(result: Result, group: str, place: str = "±1°") -> float:
    return max(line["rms"] or 0.0 for line in result["errors"][place] if line["group"] == group)


def _cell(line: Result | None, size: float) -> str:
    """Bias and scatter of a group, to two digits of the scatter."""
    if line is None or line["rms"] is None:
        return ""
    bias, scatter = line["bias"] / size, line["scatter"] / size
    digits = max(0, 1 - math.floor(math.log10(scatter)))
    return f"{bias:.{digits}f}, {scatter:.{digits}f}"


def farthest(result: Result, method: str) -> tuple[float, str, str]:
    """The largest ratio of the rms error of a method to the bound, and at which place and group."""
    return max(
        (line["to_bound"], place, line["group"])
        for place, lines in result["errors"].items()
        for line in lines
        if line["method"] == method and line["to_bound"] is not None
    )


def answer(result: Result) -> str:
    """The answer in a sentence."""
    far = {method: farthest(result, method) for method in ON_TABLE}
    said = "; ".join(f"{m} up to {far[m][0]:.1f} times ({far[m][2]}, {far[m][1]})" for m in ON_TABLE[1:])
    return (
        f"Which method, when? joint wherever there are gyros and turns: its rms errors are at most "
        f"{far['joint'][0]:.2f} times the Cramér–Rao bound, {said}. ellipsoid where there are no gyros; scalar and "
        "sequential to compare with the paper."
    )


def main(arguments: list[str]) -> int:
    """Print the tables and the answer."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--short", action="store_true", help="fewer sessions")
    parser.add_argument("--store", action="store_true", help="keep the result")
    options = parser.parse_args(arguments)
    result = found(4 if options.short else 200)
    if options.store:
        STORED.write_text(json.dumps(result, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    print(needs_table(result))
    print(f"\nBias and scatter (mean and standard deviation of the errors) of {result['sessions']} sessions:\n")
    print(errors_table(result))
    print(f"\n{answer(result)}")
    worst = {method: farthest(result, method)[0] for method in ON_TABLE}
    return 0 if worst["joint"] == min(worst.values()) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
