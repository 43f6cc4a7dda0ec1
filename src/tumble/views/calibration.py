"""Calibrations: parameters, groups, launches, iterations, methods, rests and fits.

Several launches have the form of the paper's Tables 1 to 3: every launch, the mean and the standard deviation between
launches, the mean increments of the iterations, and the difference of the methods in per cent.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from html import escape
from itertools import chain
from pathlib import Path

import numpy as np

from tumble.diagnosis.verdict import IN_MOTION, gravity_text
from tumble.errors import IN_MEMORY, tables_at
from tumble.export import target
from tumble.files import FilePath
from tumble.recording.formats import format_of
from tumble.reduction.rests.warming import OVER_TEMPERATURE
from tumble.result.accepted import accepted_kinds
from tumble.result.calibration import Calibration
from tumble.result.coverage import notes_without_expanded
from tumble.result.further import (
    accepted_groups,
    by_group,
    decided_by_priors,
    further_parameters,
    has_other_factors,
    improvement,
    linear_parameters,
    prediction_text,
    rest_summary,
    verdicts,
)
from tumble.result.parts import Parameter
from tumble.run.calibrate import ITERATED_METHODS
from tumble.sensors.parameters import group_name, named_group, shown_in, within_group
from tumble.units import Array, engineering
from tumble.views.blocks import Block, Items, Table, table
from tumble.views.numbers import (
    FROM_DATA,
    cells,
    device_name,
    factor,
    percent,
    quantity_table,
    run_to_run,
    shown_units,
    significant,
    to_digits_of,
    with_expanded,
)
from tumble.views.render.terminal import text_of

MEANING_OF_INCREMENTS = (
    "All iterations work on the same readings. What a later one adds is the error that the one before made by its "
    "method: table, mounting, squares of the parameters. Noise, changes of the sensors between rests and a wrong "
    "gravity are in every iteration alike and in no increment: small increments say that the iterations have "
    "converged, not that the result is as exact as they are small. How exact it is, u says."
)


def _over_temperature(calibration: Calibration) -> list[Block]:
    """State the number of temperature coefficients, which are only in the complete table."""
    count = sum(p.name[-3:-1] == ".t" for p in calibration.parameters)
    measured = calibration.temperature_range
    if not count or measured is None:
        return []
    low, high = measured
    over = f"over temperature, {low:.0f} to {high:.0f} °C"
    if high - low < OVER_TEMPERATURE:
        over += f", only {high - low:.1f} K, in which a drift in time looks like a slope"
    return [f"{over}: {count} coefficients with their u, in the file and by --all"]


def calibration_blocks(
    calibration: Calibration,
    truth: Mapping[str, float] | None = None,
    others: Sequence[Calibration] = (),
    *,
    every: bool = False,
    budget: bool = False,
    file: FilePath = "calibration.json",
    session: FilePath = "SESSION",
    log: FilePath = "LOG",
) -> list[Block]:
    """Return the output of `tumble calibrate`: verdict, improvement, parameters, remarks, and the next command.

    With `every` it has all parameters, tables of groups, rests, turns, fits, launches, iterations and methods, all
    remarks and notes; otherwise the accepted linear parameters, one group per row unless values are compared, a line on
    launches, iterations and other methods, and at most MAX_REMARKS remarks, on MAX_LINES lines. `truth` are true values
    by the names of parameters, `others` calibrations of the same sessions by other methods. `budget` adds the
    uncertainty budget. `file`, `session` and `log` are those of the calibration, for the next command."""
    if every:
        return _complete_blocks(calibration, truth, others, budget=budget)
    outcome = calibration.outcome
    linear = linear_parameters(calibration.parameters)
    parameters = tuple(p for p in linear if outcome.of(group_name(p.name)).accepted or "mag" in p.name)
    *by_kind, verdict = _verdict_lines(calibration)
    compared = bool(truth) or any(p.deviation is not None for p in parameters)
    blocks: list[Block] = [
        _headline(calibration),
        verdict + (f" ({'; '.join(by_kind)})" if by_kind else ""),
        *improvement(calibration),
        *(note for note in calibration.provenance.notes if note.startswith(IN_MOTION)),
        parameter_table(calibration, parameters, truth) if compared else compact_table(parameters),
        *_over_temperature(calibration),
        *_budget_and_sessions(calibration, budget=budget, every=False),
    ]
    lines = _truth_lines(calibration, truth)
    if calibration.evidence.launches:
        lines.append(f"from launch to launch: {', '.join(_spreads(parameters))}")
    for each in _iterated(calibration, others):
        steps = each.evidence.iterations
        done = "one iteration; a second (--iterations 2) would show its error"
        if len(steps) > 1:
            done = f"the last of {len(steps)} iterations added {_largest_change(each, steps[-1])}"
        lines.append(f"{each.method}: {done}")
    for other in others:
        changes = {p.name: other[p.name].value - p.value for p in calibration.parameters if p.name in other}
        lines.append(
            f"{other.method} differs from {calibration.method} by {_largest_change(calibration, changes, other)}"
        )
    lines += notes_without_expanded(parameters)
    if minor := _minor_assumptions(calibration):
        lines.append(f"with less effect on u: {'; '.join(re.split('[:,] ', each)[0] for each in minor)}")
    following = _next_command(calibration, file, session, log)
    height = len(text_of([*blocks, Items(items=(*lines, "")), following], WIDTH).splitlines())
    remarks = _fitting_remarks(calibration, minor, MAX_LINES - height)
    remarks[-1] += tables_at(f"{session}/session.toml", *remarks, *outcome.reasons)
    return [*blocks, Items(items=(*lines, *remarks)), following]


def _complete_blocks(
    calibration: Calibration, truth: Mapping[str, float] | None, others: Sequence[Calibration], *, budget: bool
) -> list[Block]:
    """Return all parameters, tables, remarks and notes."""
    parameters, evidence = calibration.parameters, calibration.evidence
    blocks: list[Block] = [
        _headline(calibration),
        *_verdict_lines(calibration),
        *improvement(calibration),
        parameter_table(calibration, parameters, truth),
        group_table(calibration),
        *unknown_blocks(calibration),
        *_budget_and_sessions(calibration, budget=budget, every=True),
    ]
    if evidence.launches:
        blocks.append(launch_table(calibration, parameters))
        if any(p.deviation is not None for p in parameters):
            blocks.append(launch_table(calibration, parameters, deviations=True))
    iterated = _iterated(calibration, others)
    for each in iterated:
        blocks += [f"method {each.method}"] if others else []
        blocks.append(iteration_table(each, [p for p in each.parameters if p.name in calibration]))
    blocks += [MEANING_OF_INCREMENTS] if iterated else []
    blocks += [method_table(calibration, other, parameters) for other in others]
    lines = _truth_lines(calibration, truth)
    if not evidence.launches:
        from tumble.views.report.recording import recordings, tables_of

        blocks += [shown for shown in tables_of(recordings(calibration)[0]) if shown]
    if calibration.prediction is not None:
        lines.append(prediction_text(calibration.prediction))
    if evidence.rests and not evidence.launches:
        lines.append(rest_summary(evidence))
    lines += [f"remark: {remark}" for remark in remarks_of(calibration)]
    site = calibration.provenance.site
    if site is not None and not site.gravity_is_unit:
        lines.append(gravity_text(site))
    return [*blocks, Items(items=(*lines, *notes_without_expanded(parameters), *calibration.provenance.notes))]


def _headline(calibration: Calibration) -> str:
    device = device_name(calibration.serial, calibration.model)
    return f"device {device} · method {calibration.method} · frame {calibration.frame}"


def _verdict_lines(calibration: Calibration) -> list[str]:
    """Return the verdicts on kinds of sensors and groups that differ, then that on the whole calibration."""
    lines = [*verdicts(calibration)]
    if spared := accepted_groups(calibration):
        lines.insert(-1, f"accepted groups: {', '.join(spared)}")
    return lines


def _budget_and_sessions(calibration: Calibration, *, budget: bool, every: bool) -> Iterator[Block]:
    """Yield the uncertainty budget if `budget`, and a table of the sessions of a common estimate."""
    if budget:
        from tumble.views.uncertainty_budget import budget_blocks

        yield from budget_blocks(calibration, every=every)
    rows = []
    for member in calibration.evidence.together:
        low, high = (f"{celsius:z.1f}" for celsius in member.temperatures)
        counts = {"rests": str(member.rests), "turns": str(member.turns)}
        rows.append({"session": member.session, **counts, "from °C": low, "to °C": high})
    yield table(rows, words=("session",))


def _iterated(calibration: Calibration, others: Sequence[Calibration]) -> list[Calibration]:
    """Return the calibrations by methods of the paper that have iterations."""
    return [each for each in (calibration, *others) if each.method in ITERATED_METHODS and each.evidence.iterations]


def _truth_lines(calibration: Calibration, truth: Mapping[str, float] | None) -> list[str]:
    """Return a sentence on the errors of the parameters in units of u; empty without true values."""
    if truth is None:
        return []
    z = np.array([(p.value - truth[p.name]) / p.u for p in calibration.parameters if p.u and p.name in truth])
    if len(z) == 0:
        return ["truth: no parameter was estimated that it has"]
    rms = float(np.sqrt(np.mean(z**2)))
    return [f"truth: {len(z)} parameters, rms of (value − truth)/u {rms:.2f}, expected about 1"]


def _spreads(parameters: Sequence[Parameter]) -> Iterator[str]:
    """Yield the standard deviation from launch to launch of each group, the root mean square over its parameters."""
    units = shown_units(parameters)
    for name, members in by_group(parameters).items():
        size, unit = units[members[0].name]
        rms = math.sqrt(sum((p.run_to_run or 0.0) ** 2 for p in members) / len(members))
        yield f"{name} {significant(rms / size, 2)} {unit}"


MAX_LINES = 24  # without --all
MAX_REMARKS = 3  # without --all
WIDTH = 100  # characters of a line
_TARGETS = {"ardupilot": "ardupilot", "ulog": "px4", "ros": "kalibr"}  # by the format of a recording
_TARGETS_BY_COLUMN = {"accSmooth[0]": "betaflight", "accelerometer_m_s2[0]": "px4"}  # of decoded logs


def _next_command(calibration: Calibration, file: FilePath, session: FilePath, log: FilePath) -> str:
    """Return the command that follows: the export of an accepted calibration to the target of the format of its log,
    "json" for any other log; else the inspection of its session."""
    if not accepted_kinds(calibration):
        what = (
            "the rests and turns that were found" if calibration.evidence.rests else "what was found in the recording"
        )
        return f"next: tumble inspect {shlex.quote(str(session))} ({what})"
    readings = calibration.provenance.readings.get("accel")
    by_column = (_TARGETS_BY_COLUMN.get(column) for column in (() if readings is None else readings.columns))
    name = _TARGETS.get(format_of(Path(log)) or "") or next(filter(None, by_column), "json")
    others = "others"
    if name == "json" and calibration.imu:  # the recording of an autopilot, converted before
        name, others = "px4", "ardupilot, others"
    elif name == "kalibr" and len(accepted_kinds(calibration)) < 2:
        name = "ros-imu-calib"
    return f"next: tumble export {shlex.quote(str(file))} --to {name} -o imu{target(name).ending} ({others}: --help)"


def remarks_of(calibration: Calibration) -> tuple[str, ...]:
    """Return remarks that call for action, the most harmful first: doubts about the log, unexplained residuals, other
    assumptions on log and place, and biases decided by priors."""
    decided, origin = decided_by_priors(calibration), calibration.provenance
    others = [sentence for sentence in origin.assumptions if sentence not in origin.doubts]
    # what u contains is less harmful, some ppm of time stamps the least
    others.sort(key=lambda sentence: (" in u of " in sentence) + ("usual for time stamps" in sentence))
    if not accepted_kinds(calibration):  # only a misread log may be the cause
        others = []
    return (*origin.doubts, *calibration.outcome.remarks, *others, *([decided] if decided is not None else []))


def _minor_assumptions(calibration: Calibration) -> list[str]:
    """Return the assumptions for what is not stated where stating it would reduce no u by more than 1 − 1/√2.

    Its source then contributes at most half of u² of every parameter, and nothing needs to be done."""
    if not calibration.evidence.budget or not accepted_kinds(calibration):
        return []
    minor, contributions = list[str](), {line.name: line.contributions for line in calibration.evidence.budget}
    for sentence, source in calibration.provenance.unstated.items():
        parts = contributions.get(source, {})
        if all(2.0 * parts.get(p.name, 0.0) ** 2 <= (p.u or 0.0) ** 2 for p in calibration.parameters):
            minor.append(sentence)
    return minor


def _fitting_remarks(calibration: Calibration, minor: Collection[str], max_lines: int) -> list[str]:
    """Return at least one and at most MAX_REMARKS remarks that fit on so many lines, without the `minor` ones, and a
    line on the others.

    Turns that were left out are in u, so they come after doubts and unexplained residuals and before assumptions."""
    remarks = [each for each in remarks_of(calibration) if each not in minor]
    notes, shown = calibration.provenance.notes, list[str]()
    if lost := [note for note in notes if note.startswith("turn ") and " is left out" in note]:
        place = len(calibration.provenance.doubts) + len(calibration.outcome.remarks)
        more = f" (and {len(lost) - 1} more)" if len(lost) > 1 else ""
        remarks.insert(min(place, MAX_REMARKS - 1), lost[0] + more)
    for remark in remarks[:MAX_REMARKS]:
        if shown and len(text_of([Items(items=(*shown, f"remark: {remark}"))], WIDTH).splitlines()) > max_lines:
            break
        shown.append(f"remark: {remark}")
    hidden = {"remark": len(remarks) - len(shown), "note": len(notes) - (len(lost) == 1)}
    counted = [f"{count} {what}{'s' * (count > 1)}" for what, count in hidden.items() if count]
    return [*shown, f"more with --all: {', '.join([*counted, 'all tables'])}"]


def _largest_change(calibration: Calibration, changes: Mapping[str, float], other: Calibration | None = None) -> str:
    """Return the largest change of a parameter in units of u, or of u combined with that of an `other` calibration."""
    sigmas = {
        p.name: abs(changes[p.name]) / math.hypot(p.u, (other[p.name].u if other else None) or 0.0)
        for p in calibration.parameters
        if p.u and p.name in changes
    }
    name, unit = max(sigmas, key=sigmas.__getitem__, default=""), "combined u" if other else "u"
    return f"at most {significant(sigmas[name], 2)} {unit} ({name})" if name else "an amount that cannot be given in u"


# -------------------- tables --------------------


def parameter_table(
    calibration: Calibration,
    parameters: Sequence[Parameter],
    truth: Mapping[str, float] | None = None,
    *,
    whole: bool = False,
) -> Table:
    """Return a table of parameters with u and, if any, coverage factors other than 2 with U, deviations from the
    systematic values and between launches; with `truth` also true values and (value − truth)/u.

    With `whole` it has U, degrees of freedom, priors and what the data told beyond them."""
    several, factors = bool(calibration.evidence.launches), has_other_factors(parameters)
    passport, priors = (any(getattr(p, name) is not None for p in parameters) for name in ("deviation", "prior"))

    def row(p: Parameter, size: float, unit: str) -> dict[str, str]:
        value, u = cells(p.value, p.u, size)
        row = {"mean" if several else "value": value, "u (k=1)": u}
        row |= {"k": factor(p) if p.u else ""} if factors else {}
        row |= {"U (95 %)": with_expanded(p, size)[1]} if factors or whole else {}
        row |= {"run to run": run_to_run(p.run_to_run, size)} if several else {}
        row |= {"deviation": to_digits_of(p.deviation, p.u, size)} if passport else {}
        row |= {"unit": unit}
        if whole:
            row["dof"] = "" if p.dof is None else f"{p.dof:.0f}" if p.k else f"{p.dof:.1g}"
        if whole and priors:
            row |= {"prior": "" if p.prior is None else f"{p.prior / size:.2g}", FROM_DATA: percent(p.learned)}
        if truth is None:
            return row
        true = truth.get(p.name) if p.u else None
        distance = "" if true is None or not p.u else f"{(p.value - true) / p.u:+z.2f}"
        return row | {"truth": to_digits_of(true, p.u, size), "(value − truth)/u": distance}

    return quantity_table(parameters, shown_units(parameters), row)


def compact_table(parameters: Sequence[Parameter]) -> Table:
    """Return a row for each group of the linear model with at most three parameters, each with u."""
    units, rows = shown_units(parameters), []
    for name, members in by_group(parameters).items():
        size, unit = units[members[0].name]
        for first in range(0, len(members), _PER_ROW):
            in_row = members[first : first + _PER_ROW]
            shown = [(within_group(p.name), *cells(p.value, p.u, size)) for p in in_row]
            empty = ("", "", "") * (_PER_ROW - len(in_row))
            rows.append(("" if first else name, *chain.from_iterable(shown), *empty, unit))
    columns = ("parameter", *("", "value", "u (k=1)") * _PER_ROW, "unit")
    words = (0, *range(1, 3 * _PER_ROW, 3), len(columns) - 1)
    return Table(columns=columns, rows=tuple(rows), text=words) if rows else Table(columns=(), rows=())


_PER_ROW = 3  # parameters
WIDENED = 1.05  # factor of a prior above which it counts as widened


def group_table(calibration: Calibration, *, on_page: bool = False) -> Table:
    """Return a table with a row for each group beyond the linear model that the calibration has or tested: largest
    |value| with u, fraction learned from the data, and its size if that is unusual; `on_page` also its meaning and
    prior."""
    findings, rows = {group.name: group for group in calibration.groups}, []
    members_of = {name: list[Parameter]() for name in findings} | by_group(further_parameters(calibration.parameters))
    for name, members in members_of.items():
        finding, entry = findings.get(name), named_group(name)
        prior = next((p.prior for p in members if p.prior), None)
        learned: Sequence[float] = [p.learned for p in members if p.learned is not None]
        if finding is not None:
            prior, learned = finding.prior, finding.learned
        if members:
            largest = max(members, key=lambda p: abs(p.value))
            size, unit = shown_in(name, largest.unit, abs(largest.value))
            value, u = cells(abs(largest.value), largest.u, size)
            ends = [f"{100.0 * end(learned):.0f}" for end in (min, max)] if learned else []
            from_data = "–".join(dict.fromkeys(ends)) + " %" * bool(ends)
            widened = 1.0 if finding is None else finding.prior_widened
            remark = f"{widened:.2g} times the usual size" if widened > WIDENED else ""
        else:
            size, unit = shown_in(name, "" if entry is None else entry.unit, prior or 0.0)
            value, u, from_data, remark = "", "", "", "not determined"
        row = {"group": name}
        row |= {"what it is": name if entry is None else entry.words} if on_page else {}
        row |= {"largest": value, "u (k=1)": u}
        row |= {"prior": "" if prior is None else significant(prior / size, 4)} if on_page else {}
        rows.append(row | {"unit": unit if members or on_page else "", FROM_DATA: from_data, "": remark})
    return table(rows, words=("group", "what it is", "unit", ""), dense=True)


def unknown_blocks(calibration: Calibration) -> list[Block]:
    """Return every hyperparameter with its central 68 % interval and usual value, the quality of the integration over
    them, and the predicted in-run biases; empty if none was estimated."""
    if not calibration.evidence.hyperparameters:
        return []
    rows = []
    for h in calibration.evidence.hyperparameters:
        size, unit = (1.0, "") if h.unit == "1" else engineering(h.unit, h.value)
        row = {"unknown": h.name, "what it is": h.words, "value": significant(h.value / size, 3)}
        row |= {"68 % from": significant(h.low / size, 3), "to": significant(h.high / size, 3)}
        rows.append(row | {"usual": significant(h.usual / size, 3), "unit": unit})
    blocks: list[Block] = [table(rows, words=("unknown", "what it is", "unit"), dense=True)]
    if (integral := calibration.evidence.integral) is not None:
        blocks.append(
            f"results are averages over them at {integral.points} points (effectively {integral.effective:.0f}): "
            f"values and u have a sampling error of up to {100.0 * integral.u_error:.1f} % of u"
        )
    units, rows = shown_units(calibration.parameters), []
    for bias in (each for each in calibration.evidence.process_bias if each.name in units):
        size, unit = units[bias.name]
        value, u = cells(bias.value, bias.u, size)
        next_u = cells(bias.value, bias.next_u, size)[1]
        rows.append({"process mean": bias.name, "value": value, "u": u, "u next minute": next_u, "unit": unit})
    return [*blocks, table(rows, words=("process mean", "unit"))] if calibration.evidence.process_bias else blocks


def launch_table(
    calibration: Calibration, parameters: Sequence[Parameter], *, deviations: bool = False, on_page: bool = False
) -> Table:
    """Return the values of every launch, the mean and the standard deviation between launches, as in the paper's Tables
    1 to 3; `deviations` are, as there, from the systematic values. `on_page` values have the digits of U, without the
    mean."""
    names = [launch.session for launch in calibration.evidence.launches]
    headings = [f"{i}: {name}" if names.count(name) > 1 else name for i, name in enumerate(names, 1)]
    by_name = [{q.name: q for q in launch.parameters} for launch in calibration.evidence.launches]

    def shown(q: Parameter | None, size: float) -> str:
        if q is None or on_page:
            return "" if q is None else with_expanded(q, size)[0]
        return to_digits_of(q.deviation if deviations else q.value, q.u, size)

    def row(p: Parameter, size: float, unit: str) -> dict[str, str]:
        row = {heading: shown(launch.get(p.name), size) for heading, launch in zip(headings, by_name, strict=True)}
        row |= {} if on_page else {"mean": shown(p, size)}
        return row | {"run to run": run_to_run(p.run_to_run, size), "unit": unit}

    name = "deviation of" if deviations else "parameter"
    return quantity_table(parameters, shown_units(calibration.parameters), row, name=name)


def iteration_table(calibration: Calibration, parameters: Sequence[Parameter]) -> Table:
    """Return the increments of every iteration (for several launches their means), the later ones also in per cent of
    the first, as in the paper's Tables 1 to 3, and u."""

    def row(p: Parameter, size: float, unit: str) -> dict[str, str]:
        steps, first = dict[str, str](), calibration.evidence.iterations[0][p.name]
        for i, step in enumerate(calibration.evidence.iterations, 1):
            steps[f"iteration {i}"] = f"{step[p.name] / size:.3g}"
            if i > 1:
                steps[f"{i} in % of 1"] = f"{100.0 * abs(step[p.name] / first):.2g}" if first else ""
        return steps | {"u (k=1)": cells(p.value, p.u or 0.0, size)[1], "unit": unit}

    name = "mean increment of" if calibration.evidence.launches else "increment of"
    return quantity_table(parameters, shown_units(calibration.parameters), row, name=name)


def method_table(calibration: Calibration, other: Calibration, parameters: Sequence[Parameter]) -> Table:
    """Return the parameters by two methods and the difference other − this, also in per cent, as in the paper's Table
    1."""

    def row(p: Parameter, size: float, unit: str) -> dict[str, str]:
        value = other[p.name].value
        return {
            calibration.method: to_digits_of(p.value, p.u, size),
            other.method: to_digits_of(value, p.u, size),
            "difference": to_digits_of(value - p.value, 0.1 * (p.u or 0.0), size),
            "%": f"{difference_percent(value, p.value):+z.2f}" if p.value else "",
            "unit": unit,
        }

    both = [p for p in parameters if p.name in other]
    return quantity_table(both, shown_units(calibration.parameters), row)


def difference_percent(value: Array | float, reference: Array | float) -> Array:
    """Return the difference from values of another method in per cent of these, as in the paper's Table 1."""
    return np.asarray(100.0 * (np.asarray(value) - reference) / reference)


# -------------------- notebooks --------------------


def as_text(calibration: Calibration) -> str:
    """Return headline, reasons, remarks, all parameters, and notes as text."""
    return "\n".join(filter(None, text_of(_notebook_blocks(calibration)).splitlines()))


def as_html(calibration: Calibration) -> str:
    """Return the content of `as_text` as escaped HTML."""

    def elements(tag: str, texts: Iterable[str]) -> str:
        return "".join(f"<{tag}>{escape(text)}</{tag}>" for text in texts)

    html = []
    for block in _notebook_blocks(calibration):
        if isinstance(block, Table):
            rows = "".join(f"<tr>{elements('td', row)}</tr>" for row in block.rows)
            html.append(f"<table><tr>{elements('th', block.columns)}</tr>{rows}</table>")
        else:
            items = f"<ul>{elements('li', block.items)}</ul>" if isinstance(block, Items) else ""
            html.append(items or elements("h4", [str(block)]))
    return f"<div>{''.join(html)}</div>"


def _notebook_blocks(calibration: Calibration) -> list[Block]:
    outcome = calibration.outcome
    sentences = (*outcome.reasons, *remarks_of(calibration))
    notes = calibration.provenance.notes
    notes += tuple(filter(None, [tables_at(IN_MEMORY, *sentences, *notes).removeprefix("; ")]))
    return [
        calibration.headline,
        *([Items(items=sentences)] if sentences else []),
        parameter_table(calibration, calibration.parameters, whole=True),
        *([Items(items=tuple(f"note: {note}" for note in notes))] if notes else []),
    ]
