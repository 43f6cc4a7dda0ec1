"""Tables of the results on real recordings, computed from evidence/results/real.json."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from evidence.pages import G0, OURS, UNITS, digits, listed, table
from evidence.programs import LINEAR, PROGRAMS
from evidence.real.get import named

RESULTS = Path(__file__).parents[1] / "results" / "real.json"
WAYS: Mapping[str, Callable[[str, str], bool]] = {
    "the next session of the same chip": lambda fitted, _: "mimu4444" in fitted,
    "a quarter of the rests of the same recording": lambda fitted, _: not _is_table(fitted) and "mimu" not in fitted,
    "every second row of a table": lambda fitted, _: _is_table(fitted),
}
"""What is predicted, with the test whether a pair of names belongs to it."""
SHORT = ("next session", "rests held out", "rows held out")
"""Headings of the table columns, in the order of WAYS."""
ASKED = (("force", 1e6 / G0), ("tilt", 1e3))
"""Scores of the predictions with the factors to their units, µg and mrad."""


COLUMNS = ("recordings", "devices", "licence", "address")


def _is_table(name: str) -> bool:
    return name.startswith(("wrona", "rohac"))


def compared(rows: Iterable[Mapping[str, Any]], program: str, score: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the scores of a program (N,) and the logarithms of their ratios to those of the first program."""
    of = {(row["fitted"], row["predicted"], row["program"]): row.get(score) for row in rows}
    own = {key[:2]: value for key, value in of.items() if key[2] == program and value}
    first = {key[:2]: value for key, value in of.items() if key[2] == OURS and value}
    both = [key for key in own if key in first]
    return np.array([own[key] for key in both]), np.log([own[key] / first[key] for key in both])


def score_of(score: str, way: str) -> str:
    """Return the score to use: between sessions of a device the biases are estimated again."""
    return "shape" if score == "force" and "session" in way else score


def ratio(logs: np.ndarray) -> str:
    """Return the geometric mean of ratios with its standard error, as text."""
    if not len(logs):
        return ""
    mean = float(np.exp(logs.mean()))
    if len(logs) < 3:
        return f"{mean:.2f} ({len(logs)})"
    error = mean * logs.std(ddof=1) / np.sqrt(len(logs))
    places = 2 if error >= 0.005 else 3
    return f"{mean:.{places}f} ± {error:.{places}f} ({len(logs)})"


def behind(logs: np.ndarray) -> bool:
    """Return True if the errors of the first program are larger by more than two standard errors."""
    return len(logs) >= 5 and logs.mean() + 2.0 * logs.std(ddof=1) / np.sqrt(len(logs)) < 0.0


def predicted(results: Mapping[str, Any], score: str, unit: float) -> str:
    """Return the table of a score: its median, and its ratio to the first program's with the number of pairs."""
    rows = []
    for program in programs_of(results):
        cells = [program]
        for way, belongs in WAYS.items():
            pairs = [row for row in results["predictions"] if belongs(row["fitted"], row["predicted"])]
            values, logs = compared(pairs, program, score_of(score, way))
            cells += [digits(unit * float(np.median(values))) if len(values) else "", ratio(logs)]
        if any(cells[1:]):
            rows.append(cells)
    return table(["program", *(word for way in SHORT for word in (way, "over default (N)"))], rows)


def real_figure(keys: Sequence[str]) -> str:
    """A figure of the results by its name: recordings, sources, refused, or made | what; first screen; repeated |
    program | group | deviation or over_u; or the score, a program, what is predicted (session, quarter, row) and median
    or ratio. Raises KeyError where there is none."""
    results = read_results()
    match list(keys):
        case ["recordings"]:
            return f"{sum(one['recordings'] for one in results['recordings'])}"
        case ["first screen"]:
            return first_screen(results)
        case ["sources"]:
            return f"{len(results['recordings'])}"
        case ["refused"]:
            return f"{sum('accelerometers' in line for line in refused(results))}"
        case ["made", what]:
            value = f"{results['made'][what]}"
            return value[:12] if what == "commit" else value
        case ["repeated", program, group, ("deviation" | "over_u") as what]:
            made = results["repeatability"][program][group]
            return digits(made[what] * (UNITS[group][1] if what == "deviation" else 1.0))
        case [("force" | "tilt") as score, program, way, ("median" | "ratio") as what]:
            words = next(words for words in WAYS if way in words)
            belongs = WAYS[words]
            pairs = [row for row in results["predictions"] if belongs(row["fitted"], row["predicted"])]
            values, logs = compared(pairs, program, score_of(score, words))
            if not len(values):
                raise KeyError(" | ".join(keys))
            unit = 1e6 / G0 if score == "force" else 1e3
            return digits(unit * float(np.median(values))) if what == "median" else ratio(logs).partition(" (")[0]
    raise KeyError(" | ".join(keys))


def repeated(results: Mapping[str, Any]) -> str:
    """The table of repeatability: standard deviation, mean square over u, degrees of freedom."""
    rows = []
    for program in programs_of(results):
        cells = [program]
        for group, (_, factor) in UNITS.items():
            made = results["repeatability"].get(program, {}).get(group)
            if made is None or not made["deviation"]:  # not estimated
                cells.append("")
                continue
            over = "" if made["over_u"] is None or group.endswith("bias") else f", {digits(made['over_u'])}"
            cells.append(f"{digits(factor * made['deviation'])}{over} ({made['degrees']})")
        if any(cells[1:]):
            rows.append(cells)
    return table(["program", *(f"{group}, {unit}" for group, (unit, _) in UNITS.items())], rows)


def sources(results: Mapping[str, Any]) -> str:
    """The table of the recordings."""
    shown = [[named(one["source"]).title, *(f"{one[what]}" for what in COLUMNS)] for one in results["recordings"]]
    return table(["source", "recordings", "devices", "licence", "published at"], shown)


def read_results() -> dict[str, Any]:
    """Return the stored results of the real recordings."""
    return json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}


def real_losses(results: Mapping[str, Any]) -> str:
    """Return a list of the scores in which the first program is worse than others."""
    lost = listed({**behind_in(results), **repeats_better(results), "Refused": refused(results)})
    none = "* **None** of the programs is better by two standard errors or calibrates sensors that the default refuses."
    return lost or none


def behind_in(results: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the programs better than the first one by more than two standard errors, by what is predicted."""
    said: dict[str, list[str]] = {}
    for (score, _), what in zip(ASKED, ("rests", "turns"), strict=True):
        for way, belongs in WAYS.items():
            pairs = [row for row in results["predictions"] if belongs(row["fitted"], row["predicted"])]
            for program in programs_of(results):
                _, logs = compared(pairs, program, score_of(score, way))
                if program != OURS and behind(logs):
                    said.setdefault(f"Ratio of errors to those of the default, {what} of {way}", []).append(
                        f"{program} {ratio(logs)}"
                    )
    return said


def first_screen(results: Mapping[str, Any]) -> str:
    """Return the sentence of the README that names the programs with smaller errors than the first one."""
    ahead = [f"{head.partition('default, ')[2]}: {', '.join(each)}" for head, each in behind_in(results).items()]
    if not ahead:
        words = (
            "no program of the comparison predicts held-out rests and turns better than the default method by more "
            "than two standard errors."
        )
    else:
        words = (
            "the following programs predict held-out rests or turns better than the default method by more than two "
            f"standard errors (ratio of the errors to those of the default, number of pairs): {'; '.join(ahead)}."
        )
    return textwrap.fill(words, 110, break_on_hyphens=False)


def repeats_better(results: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the programs whose scale factors and axes repeat better than those of the first one."""
    said: dict[str, list[str]] = {}
    for program in programs_of(results):
        for group, made in results["repeatability"].get(program, {}).items():
            over = made["over_first"]
            if program != OURS and not group.endswith("bias") and over is not None and over < 0.9:
                head = f"Ratio of the standard deviation of `{group}` from session to session to that of the default"
                said.setdefault(head, []).append(f"{program} {digits(over)}")
    return said


def programs_of(results: Mapping[str, Any]) -> list[str]:
    """Return the programs of the results that the benchmark still has."""
    there = {program.name for program in (*PROGRAMS, LINEAR)}
    return [program for program in results["made"]["programs"] if program in there]


def refused(results: Mapping[str, Any]) -> list[str]:
    """Return the accelerometers that the first program refuses although method `ellipsoid` accepts them, and the number
    of recordings whose gyros it refuses although imu_tk calibrates them."""
    of = {(row["case"], row["program"]): row for row in results["rows"] if row["kind"] != "simulated by others"}
    cases = [case for case, program in of if program == OURS]
    out = []
    for case in cases:
        first, other = of[case, OURS], of[case, "tumble ellipsoid"]
        if not first["accel"] and other["accel"]:
            reason = first["said"].removeprefix("not accepted; ").partition(";")[0]
            out.append(f"accelerometers of {case}, which `ellipsoid` accepts: {reason}")
    gyros = [case for case in cases if of[case, "imu_tk"]["gyro"]]
    without = sum(not of[case, OURS]["gyro"] for case in gyros)
    if without:
        out.append(f"gyros in {without} of the {len(gyros)} cases that imu_tk calibrates")
    return out


def answered(results: Mapping[str, Any]) -> list[list[str]]:
    """Return a row for each program: numbers of cases, of calibrated sensors, and seconds."""
    out = []
    for program in programs_of(results):
        rows = [row for row in results["rows"] if row["program"] == program and row["kind"] != "simulated by others"]
        accel, gyro = (sum(row[kind] for row in rows) for kind in ("accel", "gyro"))
        neither = sum(not (row["accel"] or row["gyro"]) for row in rows)
        out.append([program, f"{len(rows)}", f"{accel}", f"{gyro}", f"{neither}", digits(results["seconds"][program])])
    return out


def of_others(results: Mapping[str, Any]) -> list[list[str]]:
    """Return a row for each session and program: ratio of errors after and before calibration, and error over u."""
    out = []
    for row in results["simulated_by_others"]:
        z = np.array([value for value in row["z"] if value is not None])
        if row["verdict"] in ("cannot run", "gave up") or row["program"] not in programs_of(results):
            continue
        cells = []
        for kind in ("accel", "gyro"):
            groups = [each for group, each in row["errors"].items() if group.startswith(kind)]
            left = [np.log(off / was) for off, was in groups if off and was]
            cells.append(digits(float(np.exp(np.mean(left)))) if left else "")
        cells += [digits(float(np.sqrt(np.mean(z**2)))), digits(float(np.abs(z).max()))] if len(z) else ["", ""]
        covered = f"{row['covered']} of {row['intervals']}" if row["intervals"] else ""
        out.append([row["case"], row["program"], row["verdict"] if len(z) else "", *cells, covered])
    return out
