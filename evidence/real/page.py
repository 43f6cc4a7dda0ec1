"""The page of the results on real recordings: every number in it is computed from evidence/results/real.json."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from evidence.pages import page, table
from evidence.real.get import named

FIRST = "tumble joint"
G0 = 9.80665
WAYS: Mapping[str, Callable[[str, str], bool]] = {
    "the next session of the same chip": lambda fitted, _: "mimu4444" in fitted,
    "a quarter of the rests of the same recording": lambda fitted, _: not _is_table(fitted) and "mimu" not in fitted,
    "every second row of a table": lambda fitted, _: _is_table(fitted),
}
"""What is predicted, and which pairs of names are that."""
UNITS = {
    "accel.bias": ("µg", 1e6 / G0), "accel.scale": ("ppm", 1e6), "accel.axis": ("mrad", 1e3),
    "gyro.bias": ("°/h", np.degrees(1.0) * 3600.0), "gyro.scale": ("ppm", 1e6), "gyro.axis": ("mrad", 1e3),
}  # fmt: skip


COLUMNS = ("recordings", "devices", "licence", "address")


def _is_table(name: str) -> bool:
    return name.startswith(("wrona", "rohac"))


def digits(value: float, count: int = 2) -> str:
    """A number with so many significant digits, without an exponent."""
    if value == 0.0 or not np.isfinite(value):
        return f"{value:g}"
    places = max(0, count - 1 - int(np.floor(np.log10(abs(value)))))
    return f"{round(value, places):.{places}f}"


def compared(rows: Iterable[Mapping[str, Any]], program: str, score: str) -> tuple[np.ndarray, np.ndarray]:
    """Values of a program (N,), and the logarithms of its ratios to the first program where both have one."""
    of = {(row["fitted"], row["predicted"], row["program"]): row.get(score) for row in rows}
    own = {key[:2]: value for key, value in of.items() if key[2] == program and value}
    first = {key[:2]: value for key, value in of.items() if key[2] == FIRST and value}
    return np.array(list(own.values())), np.log([own[key] / first[key] for key in own if key in first])


def ratio(logs: np.ndarray) -> str:
    """The geometric mean of ratios with its standard error."""
    if not len(logs):
        return ""
    mean = float(np.exp(logs.mean()))
    if len(logs) < 3:
        return f"{mean:.2f} ({len(logs)})"
    return f"{mean:.2f} ± {mean * logs.std(ddof=1) / np.sqrt(len(logs)):.2f} ({len(logs)})"


def behind(logs: np.ndarray) -> bool:
    """Whether the first program is behind beyond two standard errors."""
    return len(logs) >= 5 and logs.mean() + 2.0 * logs.std(ddof=1) / np.sqrt(len(logs)) < 0.0


def predicted(results: Mapping[str, Any], score: str, unit: float) -> tuple[str, list[str]]:
    """The table of a score, and who is ahead of the first program where."""
    programs, ahead, rows = results["made"]["programs"], [], []
    for program in programs:
        cells = [program]
        for way, belongs in WAYS.items():
            pairs = [row for row in results["predictions"] if belongs(row["fitted"], row["predicted"])]
            values, logs = compared(pairs, program, score)
            cells += [digits(unit * float(np.median(values))) if len(values) else "", ratio(logs)]
            if program != FIRST and behind(logs):
                ahead.append(f"{program} ({way}, {ratio(logs)})")
        if any(cells[1:]):
            rows.append(cells)
    head = ["program", *(word for way in WAYS for word in (way, f"over {FIRST} (N)"))]
    return table(head, rows), ahead


def repeated(results: Mapping[str, Any]) -> tuple[str, list[str]]:
    """The table of repeatability, and who repeats better than the first program where."""
    rows, ahead = [], []
    first = results["repeatability"].get(FIRST, {})
    for program, groups in results["repeatability"].items():
        cells = [program]
        for group, (unit, factor) in UNITS.items():
            made = groups.get(group)
            if made is None:
                cells.append("")
                continue
            over = "" if made["over_u"] is None else f", {digits(made['over_u'])}"
            cells.append(f"{digits(factor * made['deviation'])}{over} ({made['degrees']})")
            other = first.get(group)
            if (
                program != FIRST
                and other
                and not group.endswith("bias")
                and made["deviation"] < 0.9 * other["deviation"]
            ):
                ahead.append(f"{program}, {group}: {digits(factor * made['deviation'])} {unit}, {FIRST} "
                             f"{digits(factor * other['deviation'])} {unit}")  # fmt: skip
        if any(cells[1:]):
            rows.append(cells)
    return table(["program", *(f"{group}, {unit}" for group, (unit, _) in UNITS.items())], rows), ahead


def real_page(results: Mapping[str, Any]) -> str:
    """The whole page."""
    made = results["made"]
    force, force_ahead = predicted(results, "force", 1e6 / G0)
    tilt, tilt_ahead = predicted(results, "tilt", 1e3)
    repeats, repeats_ahead = repeated(results)
    sources = results["recordings"]
    count = sum(one["recordings"] for one in sources)
    shown = [[named(one["source"]).title, *(f"{one[what]}" for what in COLUMNS)] for one in sources]
    return page(
        "# Real recordings",
        f"By `python -m evidence.real.run`, commit {made['commit'][:12]}, {made['date']}, {made['machine']}, "
        f"{made['system']}: {count} recordings of {len(sources)} sources, {made['cases']} cases, "
        f"{len(made['programs'])} programs. This page is made from `evidence/results/real.json`. Programs of others "
        "are rewritten from what they publish, each tested against its own example or its published numbers "
        "(`tests/evidence/test_peers.py`); they are given the gravity of the place instead of their constants.",
        "## Where tumble is not ahead",
        where(force_ahead, tilt_ahead, repeats_ahead),
        "## Recordings",
        table(["source", "recordings", "devices", "licence", "published at"], shown),
        "Chips of an array are devices; what they record together is one recording. `python -m evidence.real.get` "
        "brings the files into a cache, by address and digest; none is part of this repository. None has a reference "
        "that is better than what is to be judged: two scores need none.",
        "## What is calibrated",
        table(["program", "cases", "accelerometers", "gyros", "neither", "s, median"], answered(results)),
        "A case counts where the program has numbers for the sensors and stands by them. Only tumble and ArduPilot "
        "have a verdict. Among the cases are some of no use, such as two attitudes, or three.",
        "## Rests that were not seen",
        "What the length of the corrected specific force misses g by, µg (rms over rests, median over pairs), and the "
        f"geometric mean of the ratio to `{FIRST}` over the pairs that both have, with its standard error and N. "
        "Readings are corrected by all that a program knows, of tumble by the whole model. The noise of the rests that "
        "are predicted is in it, of all programs alike.",
        force,
        "## Turns that were not seen",
        "What the vertical carried through a turn by the corrected rates misses that of the rest after it by, mrad. "
        "The biases are read anew in the rests before and after, so that scale factors and axes are what is judged.",
        tilt,
        "## Repeatability",
        "Standard deviation over the sessions of a chip, mean square of the deviations over u where u is stated, and "
        "the degrees of freedom, of what is accepted. Biases change from one power-on to another, scale factors and "
        "axes should not.",
        repeats,
        "## Simulated by others",
        "Sessions whose truth is known because others simulated them: the rms of (value − truth)/u over the "
        "parameters, the largest, and how many of the stated 95 % intervals contain the truth.",
        table(["session", "program", "verdict", "rms", "largest", "covered"], of_others(results)),
    )


def where(force: Sequence[str], tilt: Sequence[str], repeats: Sequence[str]) -> str:
    """What comes first, as a list."""
    heads = {
        "Unseen rests, beyond two standard errors": force,
        "Unseen turns, beyond two standard errors": tilt,
        "Repeatability, by more than a tenth": repeats,
    }
    lines = [f"* {head}: {'; '.join(said)}." for head, said in heads.items() if said]
    return "\n".join(lines) or "Nowhere beyond the scatter of these recordings."


def answered(results: Mapping[str, Any]) -> list[list[str]]:
    """By program, of how many cases it gives what."""
    out = []
    for program in results["made"]["programs"]:
        rows = [row for row in results["rows"] if row["program"] == program and row["kind"] != "simulated by others"]
        accel, gyro = (sum(row[kind] for row in rows) for kind in ("accel", "gyro"))
        neither = sum(not (row["accel"] or row["gyro"]) for row in rows)
        seconds = float(np.median([row["seconds"] for row in rows]))
        out.append([program, f"{len(rows)}", f"{accel}", f"{gyro}", f"{neither}", digits(seconds)])
    return out


def of_others(results: Mapping[str, Any]) -> list[list[str]]:
    """By session and program, errors over u."""
    out = []
    for row in results["simulated_by_others"]:
        z = np.array([value for value in row["z"] if value is not None])
        if row["verdict"] in ("cannot run", "gave up"):
            continue
        errors = (digits(float(np.sqrt(np.mean(z**2)))), digits(float(np.abs(z).max()))) if len(z) else ("", "")
        covered = f"{row['covered']} of {row['intervals']}" if row["intervals"] else ""
        out.append([row["case"], row["program"], row["verdict"], *errors, covered])
    return out
