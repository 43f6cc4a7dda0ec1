"""Sections of a report on the result: verdict, parameters, launches, correlations."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from tumble.result.accepted import accepted_kinds
from tumble.result.calibration import Calibration
from tumble.result.correction import session_rate
from tumble.result.coverage import expanded
from tumble.result.further import (
    accepted_groups,
    decided_by_priors,
    further_parameters,
    has_other_factors,
    improvement,
    linear_errors_text,
    linear_parameters,
    parameter_words,
    prediction_text,
    verdicts,
)
from tumble.result.parts import Parameter
from tumble.run.calibrate import ITERATED_METHODS
from tumble.sensors.model import WORDS
from tumble.sensors.parameters import THERMAL, group_name, sensor_kind, variable_of, within_kind
from tumble.units import DEGREE, G_STANDARD, engineering, two_digits
from tumble.views.blocks import Block, Facts, Figure, Items, Section, Table, Text, Tone, section, table
from tumble.views.calibration import MEANING_OF_INCREMENTS, group_table, iteration_table, launch_table, unknown_blocks
from tumble.views.numbers import (
    FROM_DATA,
    NONE,
    cells,
    degrees,
    factor,
    fixed,
    percent,
    quantity_table,
    run_to_run,
    shown_units,
    significant,
    to_digits_of,
    unit_text,
    with_expanded,
)
from tumble.views.render.pictures import COLOURS, FAINT, GREY, PAGE_WIDTH, svg_of
from tumble.views.report.application import BEYOND, added_terms

if TYPE_CHECKING:
    from matplotlib.figure import Figure as Canvas

Cells = Callable[[Parameter, float], dict[str, str]]
"""Function that returns further cells by heading for a parameter and the size of its display unit in SI."""

_LISTED_CORRELATIONS = 8
_MAX_ROWS = 26  # rows of the table of results on the first page
_MAX_LARGE_COLUMNS = 9  # columns that fit on a page in the larger type


def result(calibration: Calibration, name: str) -> Section:
    """Return the result: verdict, remarks, errors before and after as a figure of this `name`, parameters with U."""
    blocks: list[Block] = []
    if sentences := improvement(calibration):
        blocks.append(Items(items=tuple(f"{each[0].upper()}{each[1:]}" for each in sentences)))
    usable = accepted_kinds(calibration)
    if any(p.u and sensor_kind(p.name) in usable for p in linear_parameters(calibration.parameters)):
        caption = (
            "What each parameter makes a reading wrong by: before the calibration, as it is (grey), and afterwards, "
            "by its standard uncertainty (colour)."
        )
        blocks.append(Figure(svg=before_and_after(name, calibration), caption=caption))
    return section("Result", *verdict_blocks(calibration), *blocks, *value_blocks(calibration))


def before_and_after(name: str, calibration: Calibration) -> str:
    """Draw, for each parameter, its error of a reading at 1 g or at the rate of the session before the calibration, and
    its standard uncertainty afterwards."""
    rate, linear = session_rate(calibration), [p for p in linear_parameters(calibration.parameters) if p.u]
    shown = {kind: [p for p in linear if sensor_kind(p.name) == kind] for kind in accepted_kinds(calibration)}
    kinds = [kind for kind, parameters in shown.items() if parameters]

    def draw(figure: Canvas) -> None:
        for axes, kind in zip(figure.subplots(1, len(kinds), squeeze=False)[0], kinds, strict=True):
            unit, full = ("m/s^2", G_STANDARD) if kind == "accel" else ("rad/s", rate)
            in_reading = [1.0 if within_kind(group_name(p.name)) == "bias" else full for p in shown[kind]]
            before = np.array([abs(p.value) * w for p, w in zip(shown[kind], in_reading, strict=True)])
            after = np.array([(p.u or 0.0) * w for p, w in zip(shown[kind], in_reading, strict=True)])
            (size, per), rows = engineering(unit, float(np.median(before))), -np.arange(len(before))
            axes.set_ylim(0.5 - len(before), 0.5)  # whole dots in the first and the last row
            axes.hlines(rows, after / size, before / size, color=FAINT, linewidth=2.0)
            axes.plot(before / size, rows, "o", color=GREY, markersize=4, label="before: the error")
            axes.plot(after / size, rows, "o", color=COLOURS[kind == "gyro"], markersize=4, label=f"after: u, {kind}")
            where = "in 1 g" if kind == "accel" else f"at {two_digits(rate / DEGREE)} °/s"
            axes.set(xscale="log", xlabel=per, title=f"{WORDS[kind]}, {where}")
            axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
            axes.set_yticks(rows, [within_kind(p.name) for p in shown[kind]])
            axes.grid(axis="x", color=FAINT, linewidth=0.5)
        handles = {label: h for axes in figure.axes for h, label in zip(*axes.get_legend_handles_labels(), strict=True)}
        figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=3)

    return svg_of(name, PAGE_WIDTH, 0.8 + 0.15 * max(map(len, shown.values())), draw)


def verdict_blocks(calibration: Calibration, sentence_for: Callable[[str], str] = str) -> list[Block]:
    """State whether the values may be used, with the reasons if not and the remarks, each as `sentence_for` returns
    it."""
    outcome = calibration.outcome
    tone: Tone = "good"
    usable = [*(WORDS[kind] for kind in accepted_kinds(calibration)), *accepted_groups(calibration)]
    if not outcome.accepted and usable:
        names = " and ".join(filter(None, (", ".join(usable[:-1]), usable[-1])))
        tone, verdict = "doubt", f"The {names} alone: values of others must not be used."
    elif not outcome.accepted:
        tone, verdict = "bad", "Not accepted: these values must not be used."
    elif outcome.remarks:
        tone, verdict = "doubt", "Accepted with scatter, with what is remarked here:"
    else:
        verdict = "Accepted: every parameter given here is observable, and the residuals agree with the model."
        if unchecked := " and ".join(name for name, fit in calibration.evidence.fits.items() if fit.degrees < 0.5):
            verdict += f" Nothing checks the {unchecked}: there are no more data than unknowns."
    blocks: list[Block] = [Text(text=verdict, tone=tone)]
    *by_kind, _ = verdicts(calibration)
    if by_kind:
        blocks.append(f"{'; '.join(by_kind).capitalize()}.")
    reasons = tuple(filter(None, map(sentence_for, outcome.reasons)))
    remarks = tuple(f"{each[0].upper()}{each[1:]}" for each in map(sentence_for, outcome.remarks) if each)
    blocks += [Items(items=reasons, tone="bad")] if reasons else []
    blocks += [Items(items=remarks, tone="doubt")] if remarks else []
    return blocks


def value_blocks(calibration: Calibration, further: Cells | None = None) -> list[Block]:
    """Return the linear parameters with U and `further` cells, the meaning of U, and the u of corrected readings."""
    blocks: list[Block] = []
    if calibration.parameters:
        meaning = (
            "U = k u is the expanded uncertainty, which covers 95.45 %: k = 2 where u is known, more, by Student's t "
            f"with ν degrees of freedom, where it was estimated from few residuals. {scope_of_u(calibration)} "
            '1 µg is 9.80665·10⁻⁶ m/s², " a second of arc.'
        )
        blocks.append(_parameter_table(calibration, linear_parameters(calibration.parameters), further))
        if coefficients := [p for p in calibration.parameters if variable_of(p.name) in THERMAL]:
            caption = (
                "Coefficients of temperature: a parameter at T is its value at the reference temperature T₀ plus "
                "t1 (T − T₀) + t2 (T − T₀)² + t3 (T − T₀)³."
            )
            blocks.append(_parameter_table(calibration, coefficients, lambda p, _: _in_si(p), caption))
        blocks.append(Text(text=meaning, tone="small"))
    if calibration.prediction is not None:
        errors = linear_errors_text(calibration)
        linear = f", with the whole correction; {errors}" if errors else ""
        blocks.append(f"Known to (standard uncertainty): {prediction_text(calibration.prediction)}{linear}.")
        correction = "Matrix and bias: true = matrix⁻¹ · (reading − bias)."
        if errors:
            correction += f" The whole correction also removes from a reading: {added_terms(calibration)}."
        numbers = "Numbers, formulas and test vectors are in the section “How to apply it”."
        blocks.append(Text(text=f"{correction} {numbers}", tone="small"))
    if calibration.outcome.unobservable:
        blocks.append(f"Not determined: {', '.join(calibration.outcome.unobservable)}.")
    return blocks


def scope_of_u(calibration: Calibration) -> str:
    """Return a sentence on the power-ons to which U applies."""
    if count := len(calibration.evidence.launches):
        return (
            f"It is of the mean of {count} power-ons; a single later one lies about the mean with the standard "
            "deviation “run to run”, which comes on top."
        )
    if calibration.evidence.together:
        return "It is of all recorded power-ons together; what changes at the next one comes on top."
    return "It is of the one power-on that was recorded; what changes at the next one is not in it."


def _parameter_table(
    calibration: Calibration, parameters: Sequence[Parameter], further: Cells | None, caption: str = ""
) -> Table:
    """Return parameters with U and, if any, coverage factors other than 2, and deviations from the systematic values
    and between launches."""
    factors = has_other_factors(parameters)
    passport = any(p.deviation is not None for p in parameters)

    def row(p: Parameter, size: float, unit: str) -> dict[str, str]:
        (value, shown), U = with_expanded(p, size), expanded(p)
        row = {} if caption else {"": parameter_words(p.name)}
        row |= {"mean" if calibration.evidence.launches else "value": value, "U (95 %)": shown, "unit": unit}
        row |= {"k": factor(p), "ν": degrees(p)} if factors else {}
        row |= {"run to run": run_to_run(p.run_to_run, size)} if calibration.evidence.launches else {}
        row |= {"from nominal": to_digits_of(p.deviation, U, size)} if passport else {}
        return row | ({} if further is None else further(p, size))

    halves = len(parameters) > _MAX_ROWS and not caption
    units = shown_units(parameters)
    shown = quantity_table(parameters, units, row, words=("", "SI unit"), caption=caption, halves=halves)
    return replace(shown, dense=len(shown.columns) > _MAX_LARGE_COLUMNS or bool(caption))


def _in_si(p: Parameter) -> dict[str, str]:
    """Return the value as the correction applies it."""
    return {"value, SI": significant(p.value, 8), "SI unit": unit_text(p.unit)}


def beyond(calibration: Calibration, *, groups: bool) -> Section | None:
    """Return the parameters beyond the linear model other than coefficients of temperature; with `groups` also a row
    for each group and the biases decided by priors."""
    further = [p for p in further_parameters(calibration.parameters) if variable_of(p.name) not in THERMAL]
    group_rows = group_table(calibration, on_page=True)
    if not (group_rows.rows if groups else further):
        return None

    def row(p: Parameter, size: float, unit: str) -> dict[str, str]:
        value, u = cells(p.value, p.u, size)
        prior = "" if p.prior is None else significant(p.prior / size, 4)
        row = {"value": value, "u": u, "k": factor(p), "unit": unit, "prior": prior, FROM_DATA: percent(p.learned)}
        return row | _in_si(p)

    meaning = (
        "Each group has a prior, its usual size: the standard deviation over instruments of its grade or that of the "
        "data sheet, or as many times that as the data show. From data is how much of the prior's variance the "
        "recording has taken off: at 0 % only the prior is known."
    )
    caption = "u: standard uncertainty; k u: half width of the interval of 95.45 %; prior: standard deviation."
    blocks: list[Block] = [meaning]
    if groups:
        decided = decided_by_priors(calibration)
        blocks += [group_rows, *([f"{decided[0].upper()}{decided[1:]}."] if decided else [])]
    if further:
        units = shown_units(further)
        blocks.append(quantity_table(further, units, row, words=("SI unit",), caption=caption, dense=True))
    return section(BEYOND, *blocks)


def unknown(calibration: Calibration) -> Section | None:
    """Return the hyperparameters of the model: scatter, in-run biases, sizes of groups."""
    meaning = (
        "Scatter, in-run biases and the sizes of groups were estimated with the parameters, and U is an average over "
        "what they may be. The middle 68 % of each stands beside its value; a size over the usual one has no unit."
    )
    blocks = unknown_blocks(calibration)
    return section("Hyperparameters", meaning, *blocks) if blocks else None


def launches(calibration: Calibration) -> Section | None:
    """Return the launches side by side: linear parameters, then the others."""
    if not calibration.evidence.launches:
        return None
    linear, further = linear_parameters(calibration.parameters), further_parameters(calibration.parameters)
    meaning = (
        "The result is the mean of these launches (power-ons). Run to run is the standard deviation from one launch to "
        "another; it is in the uncertainty of the mean."
    )
    dense = len(calibration.evidence.launches) > 4
    blocks: list[Block] = [meaning, replace(launch_table(calibration, linear, on_page=True), dense=dense)]
    if further:
        blocks += ["Beyond the linear model:", replace(launch_table(calibration, further, on_page=True), dense=True)]
    digests = tuple(
        (f"log of {launch.session}", f"SHA-256 {launch.log_sha256}" if launch.log_sha256 else NONE)
        for launch in calibration.evidence.launches
    )
    return section("Launches", *blocks, Facts(rows=digests))


def iterations(calibration: Calibration) -> Section | None:
    """Return the increments of every iteration of a method of the paper."""
    if calibration.method not in ITERATED_METHODS or not calibration.evidence.iterations:
        return None
    steps = iteration_table(calibration, linear_parameters(calibration.parameters))
    count = f"{len(calibration.evidence.iterations)} iterations of the method {calibration.method}. "
    return section("Iterations", count + MEANING_OF_INCREMENTS, replace(steps, dense=True))


def contents_of_u(calibration: Calibration) -> str:
    """Return sentences on what U contains, by the sources of its budget, and what it leaves out."""
    evidence = calibration.evidence
    priors = {source.name for source in evidence.budget if source.name.startswith("prior.")} - {"prior.linear"}
    contents = ["the noise at rest and in turns", "the scatter between rests that the residuals show"]
    contents += ["the uncertainties of gravity and of the time base"]
    left_out = ["ageing", "an error of gravity larger than stated"]
    if priors or further_parameters(calibration.parameters):
        contents.append("the groups beyond the linear model, as far as the recording does not determine them")
        left_out.append("effects that no group describes")
    else:
        left_out.append("nonlinearity that is the same in every rest")
    if evidence.launches:
        contents.append("the changes between the launches")
    else:
        left_out.insert(0, "the change from one power-on to the next")
    if calibration.reference_temperature is None:
        left_out.append("changes with temperature")
    return f"U contains {'; '.join(contents)}. It does not contain {'; '.join(left_out)}."


def correlations(calibration: Calibration) -> Section | None:
    """State what U covers, with the strongest correlations."""
    if calibration.covariance is None:
        return None
    names = [p.name for p in calibration.parameters]
    u = np.sqrt(np.diag(calibration.covariance))
    scale = np.where(u > 0.0, u, 1.0)
    r = np.clip(calibration.covariance / scale[:, None] / scale, -1.0, 1.0)
    pairs = np.column_stack(np.tril_indices(len(names), -1)).tolist()
    strong = sorted(pairs, key=lambda pair: -abs(r[*pair]))[:_LISTED_CORRELATIONS]
    rows = [{"parameter": names[p], "with": names[q], "coefficient": fixed(float(r[p, q]), 3)} for p, q in strong]
    strongest = (
        "The covariance of two parameters is their coefficient times both standard uncertainties; all of it is in "
        "the calibration file, which is the data annex. The strongest:"
    )
    listed: list[Block] = [strongest, table(rows, words=("parameter", "with"))] if rows else []
    return section("Covariance and correlations", contents_of_u(calibration), *listed)
