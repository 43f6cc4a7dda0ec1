"""Tables, pictures and single figures of the results for the pages.

    python -m evidence.pages            draws the pictures and writes the figures of evidence/results into the pages

The tables of docs/evidence/simulated.md and real.md are made by this module and `evidence.real.page` when the site is
built (`docs/made.py`). In hand-written pages a figure or table is enclosed by two comments that name it, and the
command above updates it. Results are those of the benchmark and of the studies (studies/results). Examples:

    `<!-- figure: simulated | tumble joint | all | covered -->95.2 %<!-- end -->`
    `<!-- figure: field_check | made | date -->2026-11-26<!-- end -->`
    `<!-- table: field_check | checks --> … <!-- end -->`

A comment at the beginning of a line would end the paragraph, so `with_figures` moves such a figure to the end of the
line before.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from evidence import programs as benchmark
from evidence.run import RESULTS, SESSIONS, Results
from evidence.score import GROUPS, USABLE, Row, Score, as_expected, by, score_of
from evidence.simulated.kinds import FURTHER, KINDS, Kind, seed_of

ROOT = Path(__file__).parents[1]
OURS = "tumble joint"
"""The program to which the others are compared."""
PICTURES = ROOT / "docs" / "pictures"
ASKED = {"rms": 1.15, "beyond_3": 0.01, "covered": 0.92}
"""Required limits: largest rms of z and share beyond 3 u, smallest coverage of 95 % intervals."""
GOOD = "accept"
FIGURE = re.compile(r"(?<!`)(<!-- figure: ([^>]*?) -->)(.*?)(<!-- end -->)", re.S)
AT_START = re.compile(r"[ ]*\n[ ]*(<!-- figure: )")
"""A figure at the beginning of a line, where Markdown takes the comment as a block."""
TABLE = re.compile(r"(?<!`)(<!-- table: ([^>]*?) -->\n)(.*?)(<!-- end -->)", re.S)
G0 = 9.80665
UNITS = {
    "accel.bias": ("µg", 1e6 / G0), "accel.scale": ("ppm", 1e6), "accel.axis": ("mrad", 1e3),
    "gyro.bias": ("°/h", np.degrees(1.0) * 3600.0), "gyro.scale": ("ppm", 1e6), "gyro.axis": ("mrad", 1e3),
}  # fmt: skip
FURTHER_UNITS = {
    "mag.bias": ("µT", 1.0), "mag.scale": ("%", 1e2), "mag.axis": ("mrad", 1e3),
    "accel.change": UNITS["accel.bias"], "gyro.change": UNITS["gyro.bias"],
}  # fmt: skip
WORDS = {
    "accel.bias": "bias", "accel.scale": "scale", "accel.axis": "axes",
    "gyro.bias": "bias", "gyro.scale": "scale", "gyro.axis": "axes",
}  # fmt: skip
FAMILIES = {
    "motion": tuple(UNITS),
    "still": ("accel.change", "gyro.change", "gyro.bias"),
    "magnetometer": ("mag.bias", "mag.scale", "mag.axis"),
}
"""Groups of parameters in the tables of further recordings."""


# -------------------- numbers --------------------


def share(value: float | None) -> str:
    """Format a share as per cent."""
    return "–" if value is None else f"{100.0 * value:.1f} %"


def number(value: float | None, digits: int = 2) -> str:
    """Format a number with the given decimals, fewer if it is large, or a dash for None."""
    if value is None or not np.isfinite(value):
        return "–"
    if abs(value) >= 1000.0:
        return f"{value:.1e}"
    return f"{value:.{0 if abs(value) >= 100.0 else 1 if abs(value) >= 10.0 else digits}f}"


def digits(value: float, count: int = 2) -> str:
    """Format a number with the given count of significant digits, without an exponent."""
    if value == 0.0 or not np.isfinite(value):
        return f"{value:g}"
    places = max(0, count - 1 - int(np.floor(np.log10(abs(value)))))
    return f"{round(value, places):.{places}f}"


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def verdicts(score: Score) -> str:
    """Return the numbers of sessions accepted, accepted with scatter, and not accepted."""
    count = score.verdicts.get
    return f"{count('accepted', 0)}, {count('with scatter', 0)}, {count('not accepted', 0) + count('gave up', 0)}"


def over_ours(rows: Mapping[str, Row], ours: Mapping[str, Row], group: str) -> tuple[float, float, int] | None:
    """Return the geometric mean of the ratio of a group's errors to those of the default method, the standard error of
    its logarithm, and the number of cases; None for fewer than three."""
    logs = [
        np.log(row.errors[group][0] / ours[case].errors[group][0])
        for case, row in rows.items()
        if case in ours and _has(row, group) and _has(ours[case], group)
    ]
    if len(logs) < 3:
        return None
    return float(np.exp(np.mean(logs))), float(np.std(logs, ddof=1) / np.sqrt(len(logs))), len(logs)


def _has(row: Row, group: str) -> bool:
    return row.verdict in USABLE and group in row.errors and row.errors[group][0] > 0.0


# -------------------- tables of simulated sessions --------------------


def losses(results: Results, kinds: Sequence[Kind]) -> str:
    """Return a list of the sessions in which the default method is wrong or worse than others."""
    rows = by([row for row in results.rows if row.program == OURS], "kind")
    silent, unexpected, short = [], [], []
    for row in (row for some in rows.values() for row in some if row.silent_wrong):
        name, z = row.worst
        seed = seed_of(results.made["series"], row.kind, int(row.case.rpartition(" ")[2]))
        silent.append(f"`{row.case}` (seed {seed:016x}), `{name}` by {z:+.1f} u")
    for kind in kinds:
        wrong = [row for row in rows[kind.name] if not as_expected(row, kind.expected, kind.says)]
        if wrong:
            unexpected.append(f"`{kind.name}` {len(wrong)} of {len(rows[kind.name])}")
        for verdict, words in (("accepted", "accepted without a remark"), ("with scatter", "accepted with scatter")):
            some = [row for row in rows[kind.name] if row.verdict == verdict and row.z]
            misses = falls_short(some)
            if misses:
                short.append(f"`{kind.name}` ({len(some)} of {len(rows[kind.name])}, {words}): {', '.join(misses)}")
    good = {kind.name for kind in kinds if kind.expected == GOOD}
    ours = {row.case: row for row in results.rows if row.program == OURS}
    smaller = []
    for program, some in by(results.rows, "program").items():
        for kind_name, of_kind in by([row for row in some if row.kind in good], "kind").items():
            for group in GROUPS if program != OURS else ():
                ratio = over_ours({row.case: row for row in of_kind}, ours, group)
                if ratio is not None and np.log(ratio[0]) < -2.0 * ratio[1] and ratio[0] < 0.95:
                    smaller.append(f"{program} {ratio[0]:.2f} of `{group}` in `{kind_name}` (N = {ratio[2]})")
    return listed({
        "Accepted without a remark although a parameter is wrong by more than 4 u": silent,
        "Unexpected verdicts": unexpected,
        "u too small": short,
        "Programs with smaller errors than the default (ratio of errors)": smaller,
    })  # fmt: skip


def listed(said: Mapping[str, Sequence[str]]) -> str:
    """Return a Markdown list with a line for each heading that has entries."""
    return "\n".join(f"* **{head}**: {'; '.join(lines)}." for head, lines in said.items() if lines)


def falls_short(rows: Sequence[Row]) -> list[str]:
    """Return the limits of ASKED that the rows miss by more than the standard error over sessions."""
    if len(rows) < 2:
        return []
    square, beyond, covered = (
        np.array([value(row) for row in rows])
        for value in (
            lambda row: np.mean(np.square(list(row.z.values()))),
            lambda row: np.mean(np.abs(list(row.z.values())) > 3.0),
            lambda row: row.covered / row.intervals if row.intervals else 1.0,
        )
    )
    error = [each.std(ddof=1) / np.sqrt(len(each)) for each in (square, beyond, covered)]
    rms = float(np.sqrt(square.mean()))
    return [
        words
        for words, misses in (
            (f"rms {number(rms)}", rms - 0.5 * error[0] / rms > ASKED["rms"]),
            (f"{share(float(beyond.mean()))} beyond 3 u", beyond.mean() - error[1] > ASKED["beyond_3"]),
            (f"{share(float(covered.mean()))} covered", covered.mean() + error[2] < ASKED["covered"]),
        )
        if misses
    ]


def kind_table(results: Results, kinds: Sequence[Kind]) -> str:
    """Return the table of the default method, with a row for each kind and one for all."""
    rows = by([row for row in results.rows if row.program == OURS], "kind")
    head = ["kind", "description", "expected", "as expected", "verdicts", "wrong", "rms", "> 3 u", "covered"]
    lines = []
    for name, words, expected in [*((k.name, k.words, k.expected) for k in kinds), ("all", "", "")]:
        score = score_of(rows[name] if name in rows else [r for some in rows.values() for r in some], results.expected)
        lines.append([
            f"`{name}`" if name in rows else "**all**", words, expected, f"{score.as_expected} of {score.sessions}",
            verdicts(score), f"{score.silent_wrong}", number(score.rms), share(score.beyond_3), share(score.covered),
        ])  # fmt: skip
    return table(head, lines)


def program_table(results: Results, kinds: Sequence[Kind]) -> str:
    """Return the table of verdicts and uncertainty on good recordings, with a row for each program."""
    good = {kind.name for kind in kinds if kind.expected == GOOD}
    head = ["program", "N", "calibrated", "wrong", "rms of error/u", "> 3 u", "covered", "s", "MB"]
    lines = []
    for program, rows in by(results.rows, "program").items():
        able = [row for row in rows if row.kind in good and row.verdict != "cannot run"]
        score, cost = score_of(able), results.cost.get(program, {})
        usable = sum(row.verdict in USABLE for row in able)
        lines.append([
            program, f"{len(able)}", f"{usable}", f"{score.silent_wrong}" if score.rms is not None else "–",
            number(score.rms), share(score.beyond_3), share(score.covered),
            number(cost.get("seconds")), number(cost.get("megabytes"), 0),
        ])  # fmt: skip
    return table(head, lines)


def left_table(results: Results, kinds: Sequence[Kind]) -> str:
    """Return the table of errors after over before calibration in good recordings, with a row for each program."""
    good = {kind.name for kind in kinds if kind.expected == GOOD}
    lines = []
    for program, rows in by(results.rows, "program").items():
        score = score_of([row for row in rows if row.kind in good and row.verdict != "cannot run"])
        lines.append([program, *(number(score.left.get(group), 3) for group in GROUPS)])
    return table(["program", *(f"{group.split('.')[0]} {WORDS[group]}" for group in GROUPS)], lines)


def ratio_table(results: Results, kinds: Sequence[Kind]) -> str:
    """Return the table of ratios of every program's errors to those of the default method."""
    good = {kind.name for kind in kinds if kind.expected == GOOD}
    ours = {row.case: row for row in results.rows if row.program == OURS and row.kind in good}
    head = ["program", "N", *(f"{group.split('.')[0]} {WORDS[group]}" for group in GROUPS)]
    lines = []
    for program, rows in by(results.rows, "program").items():
        if program == OURS:
            continue
        theirs = {row.case: row for row in rows if row.kind in good}
        ratios = [over_ours(theirs, ours, group) for group in GROUPS]
        most = max((ratio[2] for ratio in ratios if ratio), default=0)
        lines.append([program, f"{most}", *(f"{number(r[0])} ± {number(r[0] * r[1])}" if r else "–" for r in ratios)])
    return table(head, lines)


def useless_table(results: Results, kinds: Sequence[Kind]) -> str:
    """Return the table of unusable recordings, with a row for each program."""
    expected, lines = {kind.name: kind.expected for kind in kinds}, []
    for program, rows in by(results.rows, "program").items():
        able = useless(rows, expected)
        lines.append([program, f"{len(able)}", f"{sum(row.verdict == 'accepted' for row in able)}"])
    return table(["program", "N", "calibrated without a remark"], lines)


def useless(rows: Sequence[Row], expected: Mapping[str, str]) -> list[Row]:
    """Return the rows of unusable recordings that the program can run."""
    bad = ("refuse", "name the cause")
    return [row for row in rows if expected.get(row.kind) in bad and row.verdict != "cannot run"]


# -------------------- recordings of other kinds --------------------


def family_of(kind: Kind) -> str:
    """Return the table in which a kind is listed."""
    if kind.sensors.sweep is not None or kind.gyros_alone:
        return "still"
    return "motion" if kind.sensors.magnetometer is None else "magnetometer"


def further_table(results: Results, family: str) -> str:
    """Return the table of a family of kinds: rms error of each group, in its unit and in per cent of the true values,
    and error over u, for the programs that calibrate any of it."""
    groups, lines = FAMILIES[family], []
    rows = by(results.rows, "kind")
    for kind in (kind for kind in FURTHER if family_of(kind) == family):
        for program, some in by(rows.get(kind.name, ()), "program").items():
            usable = [row for row in some if row.verdict in USABLE and any(group in row.errors for group in groups)]
            if not usable:
                continue
            score = score_of(usable)
            lines.append([
                f"`{kind.name}`", program, f"{len(usable)} of {len(some)}",
                *(rms_error(usable, group) for group in groups),
                number(score.rms), number(score.largest, 1), share(score.covered),
            ])  # fmt: skip
    units = {**UNITS, **FURTHER_UNITS}
    heads = [f"`{group}`, {units[group][0]}" for group in groups]
    return table(["kind", "program", "calibrated", *heads, "rms of error/u", "largest", "covered"], lines)


def rms_error(rows: Sequence[Row], group: str) -> str:
    """Format the rms error of a group in its unit and in per cent of the rms of the true values."""
    pairs = np.array([row.errors[group] for row in rows if group in row.errors])
    if not len(pairs):
        return "–"
    off, was = np.sqrt(np.mean(pairs**2, axis=0))
    return f"{digits({**UNITS, **FURTHER_UNITS}[group][1] * off)} ({digits(100.0 * off / was)} %)"


def further_kinds() -> str:
    """Return the table that describes these kinds."""
    return table(["kind", "description"], [[f"`{kind.name}`", kind.words] for kind in FURTHER])


# -------------------- pictures --------------------


def _axes(width: float, height: float, columns: int) -> tuple[Any, Any]:
    import matplotlib as mpl

    mpl.use("Agg", force=False)
    mpl.rcParams.update({"svg.hashsalt": "tumble", "svg.fonttype": "path", "font.size": 7.5, "axes.linewidth": 0.6})
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, columns, figsize=(width, height), sharey=True, layout="constrained", squeeze=False)
    for each in axes[0]:
        each.grid(axis="x", color="0.85", linewidth=0.5)
        each.set_axisbelow(True)
        for side in ("top", "right", "left"):
            each.spines[side].set_visible(False)
        each.tick_params(axis="y", length=0)
    return figure, axes[0]


def _saved(figure: Any, path: Path, of: str) -> None:
    from matplotlib import pyplot as plt

    figure.savefig(path, format="svg", metadata={"Date": None, "Creator": None, "Description": f"results {of}"})
    plt.close(figure)


def draw_kinds(results: Results, path: Path) -> None:
    """Draw rms of error over u and coverage of 95 % intervals of the default method, by kind, with standard errors over
    the sessions; filled markers are sessions accepted without a remark."""
    rows = by([row for row in results.rows if row.program == OURS], "kind")
    kinds = [kind for kind in KINDS if any(row.z and row.verdict in USABLE for row in rows.get(kind.name, ()))]
    figure, (left, right) = _axes(6.3, 0.155 * len(kinds) + 0.9, 2)
    for i, kind in enumerate(kinds):
        for verdict, colour in (("accepted", "#1f4e8c"), ("with scatter", "#c7681c")):
            some = [row for row in rows[kind.name] if row.verdict == verdict and row.z]
            if not some:
                continue
            at = -i + (0.12 if verdict == "accepted" else -0.12)
            style = {"color": colour, "marker": "o", "markersize": 3.2, "linewidth": 0.8, "capsize": 0}
            face = {} if verdict == "accepted" else {"markerfacecolor": "white"}
            square = np.array([np.mean(np.square(list(row.z.values()))) for row in some])
            rms = np.sqrt(square.mean())
            spread = square.std(ddof=1) / np.sqrt(len(square)) / (2.0 * rms) if len(square) > 1 else 0.0
            left.errorbar(min(rms, 3.0), at, xerr=spread if rms < 3.0 else 0.0, **style, **face)
            if rms > 3.0:
                left.annotate(f"{rms:.1f} →", (2.95, at), ha="right", va="center", color=colour, fontsize=6.5)
            of_session = np.array([row.covered / row.intervals for row in some if row.intervals])
            error = of_session.std(ddof=1) / np.sqrt(len(of_session)) if len(of_session) > 1 else 0.0
            right.errorbar(100.0 * max(of_session.mean(), 0.7), at, xerr=100.0 * error, **style, **face)
    left.set_yticks(-np.arange(len(kinds)), [kind.name for kind in kinds])
    left.set_ylim(-len(kinds) + 0.3, 0.7)
    left.axvline(1.0, color="0.4", linewidth=0.7)
    right.axvline(95.0, color="0.4", linewidth=0.7)
    left.set_xlim(0.0, 3.05)
    right.set_xlim(69.0, 101.0)
    left.set_xlabel("rms of error over u")
    right.set_xlabel("95 % intervals that contain the truth, %")
    from matplotlib.lines import Line2D

    marks = [
        Line2D([], [], color="#1f4e8c", marker="o", markersize=3.2, linewidth=0.8, label="accepted"),
        Line2D([], [], color="#c7681c", marker="o", markersize=3.2, linewidth=0.8, markerfacecolor="white",
               label="accepted with scatter"),
    ]  # fmt: skip
    figure.legend(handles=marks, loc="outside upper right", ncols=2, frameon=False)
    _saved(figure, path, digest(results))


def draw_programs(results: Results, path: Path) -> None:
    """Draw the ratios of every program's errors to those of the default method in the same good sessions, by group."""
    good = {kind.name for kind in KINDS if kind.expected == GOOD}
    ours = {row.case: row for row in results.rows if row.program == OURS and row.kind in good}
    others = [name for name in by(results.rows, "program") if name != OURS]
    figure, panels = _axes(6.3, 0.2 * len(others) + 1.1, len(GROUPS))
    for axes, group in zip(panels, GROUPS, strict=True):
        for i, program in enumerate(others):
            theirs = {row.case: row for row in results.rows if row.program == program and row.kind in good}
            ratio = over_ours(theirs, ours, group)
            if ratio is None:
                continue
            shade = "#1f4e8c" if benchmark.named(program).ours else "#7a7a7a"
            low, high = ratio[0] * np.exp(-ratio[1]), ratio[0] * np.exp(ratio[1])
            axes.plot([low, high], [-i, -i], color=shade, linewidth=0.8)
            axes.plot([ratio[0]], [-i], color=shade, marker="o", markersize=3.5)
        axes.set_xscale("log")
        axes.axvline(1.0, color="0.4", linewidth=0.7)
        axes.set_title(f"{group.split('.')[0]} {WORDS[group]}", fontsize=7.5)
        axes.set_xlim(0.4, 2000.0)
        axes.set_xticks([1.0, 10.0, 100.0, 1000.0], ["1", "10", "100", ""])
        axes.minorticks_off()
    panels[0].set_yticks(-np.arange(len(others)), others)
    panels[0].set_ylim(-len(others) + 0.4, 0.6)
    figure.supxlabel("errors over those of tumble joint (logarithmic)", fontsize=7.5)
    _saved(figure, path, digest(results))


def digest(results: Results) -> str:
    """Return a digest of the rows, from which the pictures are drawn."""
    return hashlib.sha256(repr(results.rows).encode()).hexdigest()[:16]


# -------------------- figures --------------------


def all_results() -> dict[str, Results]:
    """Return the stored results of the simulated cases; those of real recordings are in `evidence.real.page`."""
    paths = (RESULTS / f"{name}.json" for name in SESSIONS)
    return {path.stem: of_today(Results.read(path)) for path in paths if path.exists()}


def of_today(results: Results) -> Results:
    """Return the results without programs that the benchmark no longer has."""
    there = {program.name for program in (*benchmark.PROGRAMS, *benchmark.FURTHER)}
    return replace(results, rows=tuple(row for row in results.rows if row.program in there))


def with_figures(text: str, results: Mapping[str, Results]) -> str:
    """Return a page with the present figures and tables between its comments. Raises KeyError for an unknown one."""

    def put(match: re.Match[str]) -> str:
        return f"{match[1]}{figure(match[2], results)}{match[4]}"

    def put_table(match: re.Match[str]) -> str:
        return f"{match[1]}\n{table_of(match[2])}\n\n{match[4]}"

    return TABLE.sub(put_table, FIGURE.sub(put, AT_START.sub(r" \1", text)))


def of_study(name: str) -> Mapping[str, Any]:
    """Return the stored results of a study. Raises KeyError if there are none."""
    path = ROOT / "studies" / "results" / f"{name}.json"
    if not path.exists():
        raise KeyError(name)
    return cast("Mapping[str, Any]", json.loads(path.read_text(encoding="utf-8")))


def table_of(name: str) -> str:
    """Return a table by its name: study | table."""
    study, table_name = (word.strip() for word in name.split("|"))
    head, *rows = of_study(study)["tables"][table_name]
    return table(head, rows)


def figure(name: str, results: Mapping[str, Results]) -> str:
    """Return a figure by its name: set | program | kind or all | score; set | over joint | program | group, the
    ratio of errors to those of the default method; set | useless | program, the number of unusable recordings
    calibrated without a remark; set | made | item of the run; study | figures or made | item."""
    of_set, *keys = (word.strip() for word in name.split("|"))
    if of_set == "real":
        from evidence.real.page import real_figure

        return real_figure(keys)
    if of_set == "waved":
        from evidence.real.waved import read_results

        return str(read_results()["made"][keys[1]])[:12]
    if of_set not in SESSIONS:
        part, key = keys
        value = of_study(of_set)[part][key]
        return f"{value[:12]}" if key == "commit" else f"{value}"
    if keys[0] == "made":
        value = results[of_set].made[keys[1]]
        return f"{value[:12]}" if keys[1] == "commit" else f"{value}"
    rows, expected = results[of_set].rows, {kind.name: kind.expected for kind in KINDS}
    if keys[0] == "over joint":
        good = [row for row in rows if expected[row.kind] == GOOD]
        of = {name: {row.case: row for row in good if row.program == name} for name in (OURS, keys[1])}
        ratio = over_ours(of[keys[1]], of[OURS], keys[2])
        if ratio is None:
            raise KeyError(name)
        return f"{number(ratio[0])} ± {number(ratio[0] * ratio[1])}"
    if keys[0] == "useless":
        bad = useless([row for row in rows if row.program == keys[1]], expected)
        return f"{sum(row.verdict == 'accepted' for row in bad)} of {len(bad)}"
    value = results[of_set].scores()
    for key in keys:
        value = value[key]
    shares = ("beyond_2", "beyond_3", "covered")
    return share(value) if keys[-1] in shares else f"{value}" if isinstance(value, int) else number(value)


def simulated_summary(results: Results) -> str:
    """Return the summary: good recordings, and unusable ones, with a row for each program."""
    expected = {kind.name: kind.expected for kind in KINDS}
    lines = []
    for program, rows in by(results.rows, "program").items():
        able = [row for row in rows if row.verdict != "cannot run"]
        good = [row for row in able if expected[row.kind] == GOOD]
        bad, score = useless(rows, expected), score_of(good)
        usable, silent = sum(row.verdict in USABLE for row in good), sum(row.silent_wrong for row in able)
        lines.append([
            program, f"{usable} of {len(good)}", number(score.rms), share(score.covered),
            f"{silent}" if score.rms is not None else "–",
            f"{sum(row.verdict == 'accepted' for row in bad)} of {len(bad)}",
        ])  # fmt: skip
    head = ["program", "good, calibrated", "rms of error/u", "covered", "wrong", "unusable, calibrated"]
    return table(head, lines)


def written_by_hand() -> list[Path]:
    """Return the pages that may contain figures."""
    patterns = ("paper/*.md", "docs/**/*.md", "studies/*.md")
    return sorted([ROOT / "README.md", *(path for pattern in patterns for path in ROOT.glob(pattern))])


def write() -> None:
    """Draw the pictures and update the figures of the pages."""
    results = all_results()
    if "simulated" in results:
        draw_kinds(results["simulated"], PICTURES / "evidence-kinds.svg")
        draw_programs(results["simulated"], PICTURES / "evidence-programs.svg")
    for path in written_by_hand():
        text = path.read_text(encoding="utf-8")
        if (new := with_figures(text, results)) != text:
            path.write_text(new, encoding="utf-8")


if __name__ == "__main__":
    write()
