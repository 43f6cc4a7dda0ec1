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
"""What is predicted, and which pairs of names are that."""
SHORT = ("next session", "rests held out", "rows held out")
"""The same in the heads of tables."""
ASKED = (("force", 1e6 / G0), ("tilt", 1e3))
"""Scores of what is predicted, with the unit in which they are shown: µg, mrad."""


COLUMNS = ("recordings", "devices", "licence", "address")


def _is_table(name: str) -> bool:
    return name.startswith(("wrona", "rohac"))


def compared(rows: Iterable[Mapping[str, Any]], program: str, score: str) -> tuple[np.ndarray, np.ndarray]:
    """Values of a program (N,) and the logarithms of their ratios to the first program's, where both have one."""
    of = {(row["fitted"], row["predicted"], row["program"]): row.get(score) for row in rows}
    own = {key[:2]: value for key, value in of.items() if key[2] == program and value}
    first = {key[:2]: value for key, value in of.items() if key[2] == OURS and value}
    both = [key for key in own if key in first]
    return np.array([own[key] for key in both]), np.log([own[key] / first[key] for key in both])


def score_of(score: str, way: str) -> str:
    """Of another session of a device the biases are found anew."""
    return "shape" if score == "force" and "session" in way else score


def ratio(logs: np.ndarray) -> str:
    """The geometric mean of ratios with its standard error."""
    if not len(logs):
        return ""
    mean = float(np.exp(logs.mean()))
    if len(logs) < 3:
        return f"{mean:.2f} ({len(logs)})"
    error = mean * logs.std(ddof=1) / np.sqrt(len(logs))
    places = 2 if error >= 0.005 else 3
    return f"{mean:.{places}f} ± {error:.{places}f} ({len(logs)})"


def behind(logs: np.ndarray) -> bool:
    """Whether the first program is behind beyond two standard errors."""
    return len(logs) >= 5 and logs.mean() + 2.0 * logs.std(ddof=1) / np.sqrt(len(logs)) < 0.0


def predicted(results: Mapping[str, Any], score: str, unit: float) -> str:
    """The table of a score: its median, and its ratio to the first program's with the number of pairs."""
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
    """What is stored of the real recordings."""
    return json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}


def real_losses(results: Mapping[str, Any]) -> str:
    """Where the first program is behind, as a list with a line for each score."""
    lost = listed({**behind_in(results), **repeats_better(results), "Refused": refused(results)})
    none = "* **None** of the programs is ahead by two standard errors, or has numbers of sensors that are refused."
    return lost or none


def behind_in(results: Mapping[str, Any]) -> dict[str, list[str]]:
    """Programs ahead of the first one beyond two standard errors, by what is predicted."""
    said: dict[str, list[str]] = {}
    for (score, _), what in zip(ASKED, ("rests", "turns"), strict=True):
        for way, belongs in WAYS.items():
            pairs = [row for row in results["predictions"] if belongs(row["fitted"], row["predicted"])]
            for program in programs_of(results):
                _, logs = compared(pairs, program, score_of(score, way))
                if program != OURS and behind(logs):
                    said.setdefault(f"Errors over those of the default, {what} of {way}", []).append(
                        f"{program} {ratio(logs)}"
                    )
    return said


def first_screen(results: Mapping[str, Any]) -> str:
    """What the first screen of the README says of programs that are ahead of the first one: all of them, or none."""
    ahead = [f"{head.partition('default, ')[2]}: {', '.join(each)}" for head, each in behind_in(results).items()]
    if not ahead:
        words = (
            "no program of the comparison predicts rests and turns that it has not seen better than the default method "
            "by more than two standard errors."
        )
    else:
        words = (
            "these predict what they have not seen better than the default method by more than two standard errors "
            f"(errors over those of the default, number of pairs): {'; '.join(ahead)}."
        )
    return textwrap.fill(words, 110, break_on_hyphens=False)


def repeats_better(results: Mapping[str, Any]) -> dict[str, list[str]]:
    """Programs whose scale factors and axes repeat better than those of the first one in the same sessions."""
    said: dict[str, list[str]] = {}
    for program in programs_of(results):
        for group, made in results["repeatability"].get(program, {}).items():
            over = made["over_first"]
            if program != OURS and not group.endswith("bias") and over is not None and over < 0.9:
                head = f"Standard deviation of `{group}` from session to session, over that of the default"
                said.setdefault(head, []).append(f"{program} {digits(over)}")
    return said


def programs_of(results: Mapping[str, Any]) -> list[str]:
    """Programs of the results that the benchmark still has."""
    there = {program.name for program in (*PROGRAMS, LINEAR)}
    return [program for program in results["made"]["programs"] if program in there]


def fewer(made: Mapping[str, Any]) -> str:
    """Which programs had only some chips of the array."""
    given = made.get("fewer", {}).items()
    return "".join(
        f"{program}, which takes long, had {' and '.join(chips)} of the array alone. " for program, chips in given
    )


def refused(results: Mapping[str, Any]) -> list[str]:
    """Accelerometers that the first program refuses and another method of tumble accepts, and in how many recordings
    gyros are refused of which imu_tk has numbers."""
    of = {(row["case"], row["program"]): row for row in results["rows"] if row["kind"] != "simulated by others"}
    cases = [case for case, program in of if program == OURS]
    out = []
    for case in cases:
        first, other = of[case, OURS], of[case, "tumble ellipsoid"]
        if not first["accel"] and other["accel"]:
            reason = first["said"].removeprefix("not accepted; ").partition(";")[0]
            out.append(f"{case}, accelerometers, which `ellipsoid` accepts: {reason}")
    gyros = [case for case in cases if of[case, "imu_tk"]["gyro"]]
    without = sum(not of[case, OURS]["gyro"] for case in gyros)
    if without:
        out.append(f"gyros of {without} of the {len(gyros)} recordings of which imu_tk has numbers, by {OURS}")
    return out


def answered(results: Mapping[str, Any]) -> list[list[str]]:
    """By program, of how many cases it gives what."""
    out = []
    for program in programs_of(results):
        rows = [row for row in results["rows"] if row["program"] == program and row["kind"] != "simulated by others"]
        accel, gyro = (sum(row[kind] for row in rows) for kind in ("accel", "gyro"))
        neither = sum(not (row["accel"] or row["gyro"]) for row in rows)
        out.append([program, f"{len(rows)}", f"{accel}", f"{gyro}", f"{neither}", digits(results["seconds"][program])])
    return out


def of_others(results: Mapping[str, Any]) -> list[list[str]]:
    """By session and program, errors over u and what is left of the errors of the device."""
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
