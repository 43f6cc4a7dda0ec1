"""Parts of pages that are made when the site is built, from the program itself or from stored results.

Each function gives Markdown for the directive `made` of `site_tools.py`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any

import click
import numpy as np

from evidence import pages
from evidence.real import page as real
from evidence.real import waved
from evidence.simulated.kinds import KINDS


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    return pages.table(head, [[cell.replace("|", "\\|").replace("\n", " ") for cell in row] for row in rows])


# -------------------- commands --------------------

LONGEST = 48
"""Characters of an option with its choices that fit into its column."""


def walk(group: click.Group, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], click.Command]]:
    """All commands with the words that call them."""
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if command is not None and not command.hidden:
            yield (*path, name), command
            if isinstance(command, click.Group):
                yield from walk(command, (*path, name))


def commands() -> str:
    """A section for each command: usage, description, options, examples."""
    from tumble.cli import main

    return "\n\n".join(command_section(path, command) for path, command in walk(main))


def command_section(path: tuple[str, ...], command: click.Command) -> str:
    """The section of one command."""
    words = " ".join(("tumble", *path))
    context = click.Context(command, info_name=words)
    usage = " ".join([words, *command.collect_usage_pieces(context)])
    parts = [f"{'#' * (1 + len(path))} {words}", f"```text\n{usage}\n```", paragraphs(command.help or "")]
    rows = [
        [f"`{spelling(option, context)}`", option_help(option, context)]
        for option in command.params
        if isinstance(option, click.Option) and not option.hidden
    ]
    parts += [table(["option", "meaning"], rows)] if rows else []
    parts += [examples(command.epilog)] if command.epilog else []
    return "\n\n".join(part for part in parts if part)


def paragraphs(text: str) -> str:
    """The description of a command, paragraph by paragraph."""
    plain = re.sub(r"\n *\b\n", "\n", text.replace("\b", "")).strip()
    return "\n\n".join(literal(" ".join(part.split())) for part in re.split(r"\n\s*\n", plain))


def literal(text: str) -> str:
    """Text whose option names and session tables are code, so that Markdown leaves them alone."""
    text = re.sub(r"(?<![\w`-])(--?[a-z][\w-]*)", r"`\1`", text)
    return re.sub(r"(\[\[?[a-z][\w. ]*\]\]?)", r"`\1`", text).replace("*", "\\*").replace("<", "\\<")


def spelling(option: click.Option, context: click.Context) -> str:
    """How an option is spelt, with what it takes; many choices are among its words."""
    record = option.get_help_record(context)
    spelt = " ".join((record[0] if record else ", ".join(option.opts)).split())
    return spelt if len(spelt) <= LONGEST else f"{', '.join(option.opts)} NAME"


def option_help(option: click.Option, context: click.Context) -> str:
    """What an option means, its default, and its choices where they are many."""
    record = option.get_help_record(context)
    text = " ".join((record[1] if record else (option.help or "")).split())
    words = literal(text.replace("[required]", "(required)"))
    if isinstance(option.type, click.Choice) and spelling(option, context).endswith(" NAME"):
        words += f" One of {', '.join(f'`{choice}`' for choice in option.type.choices)}."
    return words


def examples(epilog: str) -> str:
    """The examples of a command."""
    lines = [line.strip() for line in epilog.replace("\b", "").splitlines() if line.strip()]
    calls = [line for line in lines if line.startswith("tumble ")]
    return "```sh\n" + "\n".join(calls) + "\n```" if calls else ""


# -------------------- tables of the program --------------------


def grades() -> str:
    """Spread of the parameters and noise of each grade."""
    from tumble.sensors.grades import GRADES
    from tumble.units import G_STANDARD
    from tumble.views.numbers import in_engineering

    rows, white = [], []
    for name, grade in GRADES.items():
        noise, accel, gyro = grade.noise, grade.accel, grade.gyro
        sizes = (
            (accel.bias, "m/s^2"), (accel.scale, "1"), (accel.axis, "rad"), (noise.accel_instability, "m/s^2"),
            (gyro.bias, "rad/s"), (gyro.scale, "1"), (gyro.axis, "rad"), (noise.gyro_instability, "rad/s"),
        )  # fmt: skip
        rows.append([name, *(in_engineering(unit, value, 2) for value, unit in sizes)])
        densities = 1e6 * noise.accel_white / G_STANDARD, 60.0 * np.degrees(noise.gyro_white)
        white.append([name, f"{densities[0]:.3g} µg/√Hz", f"{densities[1]:.3g} °/√h"])
    head = ["grade", "accel. bias", "scale", "axes", "in-run", "gyro bias", "scale", "axes", "in-run"]
    return table(head, rows) + "\n\n" + table(["grade", "white noise, accelerometers", "gyros"], white)


def groups() -> str:
    """The groups of parameters beyond the linear model, with their usual sizes and where those of MEMS are from."""
    from tumble.sensors.grades import GRADES
    from tumble.sensors.parameters import FURTHER

    rows = [
        [f"`{group.name}`", group.words, f"`{group.unit}`", *(usual(group, grade) for grade in GRADES), group.source]
        for group in FURTHER
    ]
    return table(["group", "meaning", "SI unit", *GRADES, "source of mems, consumer"], rows)


def usual(group: Any, grade: str) -> str:
    """The usual size of a group in a unit in which it is a handy number."""
    from tumble.units import coarsest, engineering

    value = group.usual.get(grade)
    if not value:
        return "–"
    size, unit = coarsest(group.shown, value) if group.shown else engineering(group.unit, value)
    digits = ".0f" if value / size >= 100.0 else ".2g"
    return f"{value / size:{digits}}\N{NO-BREAK SPACE}{unit}"


def thresholds() -> str:
    """The thresholds of the reduction: value, meaning, reason."""
    from tumble.reduction.blocks.tuning import USUAL

    rows = []
    for each in fields(USUAL):
        value = "{value:.3g} {unit}".format(**each.metadata).strip()
        rows.append([f"`{each.name}`", value, each.metadata["words"], each.metadata["why"]])
    return table(["threshold", "value", "meaning", "reason"], rows)


def programmes() -> str:
    """What every built-in programme, and two that are not enough, show of accelerometers at rest."""
    from tumble.programme.positions import BUILT_IN, from_attitudes, programme
    from tumble.programme.sheet_words import clock, sheet_rows

    corners = [position.attitude for position in programme("cube-14").positions[6:]]
    made = [(f"`{name}`", programme(name)) for name in BUILT_IN]
    made += [
        ("faces only", from_attitudes(["UEN", "DWN", "NUE", "NDW", "ENU", "WND"])),
        ("corners only", from_attitudes(corners)),
    ]
    rows = []
    for name, listed in made:
        u = np.array([position.vertical_b for position in listed.positions])
        H = np.column_stack([u, u**2, u[:, 0] * u[:, 1], u[:, 0] * u[:, 2], u[:, 1] * u[:, 2]])
        rank = int(np.linalg.matrix_rank(H))
        cells = ["–"] * 4
        if rank == 9:
            sizes = np.sqrt(np.diag(np.linalg.inv(H.T @ H))).reshape(3, 3).max(axis=1)
            cells = [f"{np.linalg.cond(H):.2f}", *(f"{size:.2f}" for size in sizes)]
        order = ("as listed" if listed.ordered else "any") if name.startswith("`") else ""
        rows.append([name, f"{len(listed.positions)}", order, clock(sheet_rows(listed)[-1].stop), f"{rank}", *cells])
    return table(["programme", "positions", "order", "time", "rank", "condition", "bias", "scale", "angle"], rows)


def positions() -> str:
    """The positions of every built-in programme, a section each."""
    from tumble.programme.positions import BUILT_IN, programme
    from tumble.programme.sheet_words import sheet_rows

    parts = []
    for name in BUILT_IN:
        rows = [
            [f"{row.number}", row.how, f"`{row.attitude}`", *row.points, row.position.label, row.when]
            for row in sheet_rows(programme(name))
        ]
        head = ["", "how to get there", "attitude", "X", "Y", "Z", "up and down", "rest"]
        parts.append(f"### {name}\n\n{table(head, rows)}")
    return "\n\n".join(parts)


# -------------------- results --------------------


def simulated(which: str) -> str:
    """A table or list of the simulated sessions, by the function of `evidence.pages` that makes it."""
    results = pages.all_results()["simulated"]
    if which == "simulated_summary":
        return pages.simulated_summary(results)
    kinds = [kind for kind in KINDS if any(row.kind == kind.name for row in results.rows)]
    makers: Mapping[str, Any] = {
        name: getattr(pages, name)
        for name in ("losses", "kind_table", "program_table", "left_table", "ratio_table", "useless_table")
    }
    return str(makers[which](results, kinds))


def further(which: str) -> str:
    """A table of the simulated recordings of other kinds, or what these are."""
    return pages.further_kinds() if which == "kinds" else pages.further_table(pages.all_results()["further"], which)


def recorded(which: str) -> str:
    """A table or list of the real recordings, by its name."""
    results = real.read_results()
    units = dict(real.ASKED)
    heads = ["session", "program", "verdict", "after/before, accel", "gyro", "rms of error/u", "largest", "covered"]
    return {
        "losses": lambda: real.real_losses(results),
        "sources": lambda: real.sources(results),
        "rests": lambda: real.predicted(results, "force", units["force"]),
        "turns": lambda: real.predicted(results, "tilt", units["tilt"]),
        "repeated": lambda: real.repeated(results),
        "answered": lambda: table(
            ["program", "cases", "accelerometers", "gyros", "neither", "s, median"], real.answered(results)
        ),
        "waved": lambda: waved.waved_table(waved.read_results()),
        "simulated_by_others": lambda: table(heads, real.of_others(results)),
    }[which]()


def study(name: str, which: str) -> str:
    """A table that a study has stored."""
    head, *rows = pages.of_study(name)["tables"][which]
    return table(head, rows)


def departures() -> str:
    """The departures from the model that are accepted without a remark and have errors larger than u says."""
    head, *rows = pages.of_study("departures")["tables"]["verdicts"]
    at = head.index("rms")
    return table(head, [row for row in rows if row[at] and float(row[at]) > pages.ASKED["rms"]])


def exports() -> str:
    """The exports that are templates: what they are for, their formula and its source."""
    from tumble.export import TEMPLATES
    from tumble.export.templates import read_template

    rows = []
    for path in sorted(TEMPLATES.glob("*.tmpl")):
        front = read_template(path, path.stem).front
        rows.append([f"`{path.stem}`", front.about, front.formula, front.source])
    return table(["`--to`", "for", "formula", "source"], rows)
