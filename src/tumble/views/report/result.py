"""The result in a report: parameters, limits, several calibrations beside each other, correlations, iterations."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tumble.errors import CalibrationError
from tumble.lab.conformity import RESULTS, RULE, LimitJudgement, Verdict
from tumble.lab.limits import Limits
from tumble.result.accepted import WORDS, accepted_kinds
from tumble.result.calibration import Calibration
from tumble.result.coverage import expanded
from tumble.result.further import (
    accepted_groups,
    by_group,
    decided_by_priors,
    described,
    further_parameters,
    left_by_matrix,
    linear_parameters,
    other_factors,
    predicted,
    remarks,
    verdicts,
)
from tumble.result.parts import Parameter
from tumble.units import engineering
from tumble.views.blocks import (
    Block,
    Facts,
    Figure,
    Items,
    Section,
    Table,
    Text,
    Tone,
    section,
    table,
)
from tumble.views.calibration import group_table, launch_table, unknown_blocks
from tumble.views.numbers import (
    NONE,
    cells,
    degrees,
    factor,
    fixed,
    limit_cell,
    percent,
    quantity_table,
    shown_units,
    significant,
    to_digits_of,
    with_expanded,
)
from tumble.views.registry import TONES
from tumble.views.report import figures
from tumble.views.report.application import terms_of

_STRONGEST = 8
_MOST_ROWS = 26
"""Rows of the table of results that the page for the customer has room for."""
_MOST_LARGE, _MOST_WITH_WORDS = 9, 12
"""Columns for which the page has room in the larger type, and in the smaller one with the parameters in words."""
OVER_TEMPERATURE = (
    "Biases and scale factors are judged at the temperature where they are worst, with U there; other parameters are "
    "the same at all temperatures. Beyond what was measured nothing passes."
)
_CHECKS = {"incoming": "Incoming inspection", "periodic": "Periodic check"}


# -------------------- values --------------------


def result(
    calibration: Calibration,
    acceptance: Limits | None,
    checks: Sequence[Verdict],
    as_found: Calibration | None = None,
    *,
    certified: bool = False,
    scope: Mapping[str, str] | None = None,
) -> Section:
    """The verdict, parameters with U, what corrected readings are known to; of a certificate degrees of freedom of all,
    the values as found before an adjustment, what the `scope` says of each parameter, and no causes of a scatter."""
    outcome = calibration.outcome
    tone: Tone
    usable = [*(WORDS[kind] for kind in accepted_kinds(calibration)), *accepted_groups(calibration)]
    if not outcome.accepted and usable:
        these = " and ".join(filter(None, (", ".join(usable[:-1]), usable[-1])))
        tone, verdict = "doubt", f"The {these} alone: values of others must not be used."
    elif not outcome.accepted:
        tone, verdict = "bad", "Not accepted: these values must not be used."
    elif outcome.remarks:
        tone = "doubt"
        verdict = (
            "Accepted with scatter: the noise within the rests does not explain all residuals. Their scatter is in U."
        )
    else:
        tone, unchecked = "good", " and ".join(name for name, fit in calibration.fits.items() if fit.degrees < 0.5)
        verdict = (
            "Accepted: the recording determines every parameter given here, and its residuals agree with the model."
        )
        if unchecked:
            verdict += f" Nothing checks the {unchecked}: there are no more data than unknowns."
    blocks: list[Block] = [Text(text=verdict, tone=tone)]
    *of_kinds, _ = verdicts(calibration)
    if of_kinds:
        blocks.append(f"{'; '.join(of_kinds).capitalize()}.")
    if outcome.reasons:
        blocks.append(Items(items=outcome.reasons, tone="bad"))
    if outcome.remarks and not certified:
        blocks.append(Items(items=outcome.remarks))
    if calibration.parameters:
        in_frame = checks if acceptance is not None and acceptance.frame == calibration.frame else ()
        if len(calibration.launches) > 1:
            next_one = (
                f"It is of the mean of {len(calibration.launches)} power-ons; a single later one lies about the mean "
                "with the standard deviation “run to run”, which comes on top."
            )
        elif calibration.together:
            next_one = "It is of all recorded power-ons together; what changes at the next one comes on top."
        else:
            next_one = "It is of the one power-on that was recorded; what changes at the next one is not in it."
        meant = (
            "U = k u is the expanded uncertainty, which covers 95.45 %: k = 2 where u is known, more, by Student's t "
            f"with ν degrees of freedom, where it was estimated from few residuals. {next_one} "
            '1 µg is 9.80665·10⁻⁶ m/s², " a second of arc.'
        )
        blocks += [
            _parameter_table(calibration, as_found, in_frame, certified, scope or {}),
            Text(text=meant, tone="small"),
        ]
    if calibration.prediction is not None:
        left = left_by_matrix(calibration)
        alone = f", with the whole correction; {left}" if left else ""
        blocks.append(f"Known to (standard uncertainty): {predicted(calibration.prediction)}{alone}.")
        correction = "Matrix and bias: true = matrix⁻¹ · (reading − bias)."
        if left:
            correction += f" The whole correction takes from a reading besides: {terms_of(calibration)}."
        numbers = "Numbers, formulas and test vectors are in the section “How to apply it”."
        blocks.append(Text(text=f"{correction} {numbers}", tone="small"))
    if outcome.unobservable:
        blocks.append(f"Not determined: {', '.join(outcome.unobservable)}.")
    if limits_elsewhere(calibration, acceptance):
        blocks.append("Limits, and the verdict on every parameter: section “Limits and verdict”.")
    return section("Result", *blocks)


def _parameter_table(
    calibration: Calibration,
    as_found: Calibration | None,
    checks: Sequence[Verdict],
    certified: bool,
    scope: Mapping[str, str],
) -> Table:
    """Parameters of the linear model with U (95 %); where there are such, the values as found before an adjustment,
    coverage factors other than 2 with the degrees of freedom (in a certificate those of all), limits and results, what
    the scope of the accreditation says, and deviations from the systematic values and from launch to launch."""
    parameters, judged = linear_parameters(calibration.parameters), dict[str, list[LimitJudgement]]()
    for judgement in (judgement for check in checks for judgement in check.judgements):
        judged.setdefault(judgement.name, []).append(judgement)
    units, rows = shown_units(parameters), []
    before = {} if as_found is None else {p.name: p.value for p in as_found.parameters}
    limited = bool(judged) and all(len(each) == 1 for each in judged.values())
    passport = any(p.deviation is not None for p in parameters)
    for p in parameters:
        (size, unit), of_p, U = units[p.name], judged.get(p.name, ()), expanded(p)
        value, shown = with_expanded(p, size)
        row = {"parameter": p.name, "": described(p.name), "mean" if calibration.launches else "value": value}
        row |= {"U (95 %)": shown, "unit": unit}
        row |= {"as found": to_digits_of(before.get(p.name), U, size)} if before else {}
        row |= {"k": factor(p), "ν": degrees(p)} if certified or other_factors(parameters) else {}
        row |= {"run to run": to_digits_of(p.run_to_run, U, size)} if calibration.launches else {}
        row |= {"from nominal": to_digits_of(p.deviation, U, size)} if passport else {}
        if limited:
            low, high = (of_p[0].low, of_p[0].high) if of_p else (math.nan, math.nan)
            row |= {"lowest": limit_cell(low, size), "highest": limit_cell(high, size)}
        row |= {"verdict": min((each.result for each in of_p), key=RESULTS.index, default=NONE)} if judged else {}
        rows.append(row | ({"scope": scope.get(p.name, "")} if scope else {}))
    count = max(map(len, rows), default=0)
    if count > _MOST_WITH_WORDS:
        rows = [{heading: cell for heading, cell in row.items() if heading} for row in rows]
    words = ("parameter", "", "unit", "verdict", "scope")
    return table(rows, words=words, dense=count > _MOST_LARGE, halves=len(rows) > _MOST_ROWS)


def beyond(calibration: Calibration, *, for_customers: bool = False) -> Section | None:
    """What is beyond the linear model: a line for each group, what its prior decides, and all parameters;
    `for_customers` the parameters alone."""
    further = further_parameters(calibration.parameters)
    priors = any(p.prior is not None for p in further)

    def row(p: Parameter, size: float, unit: str) -> dict[str, str]:
        value, u = cells(p.value, p.u, size)
        prior = "" if p.prior is None else significant(p.prior / size, 4)
        shown = {"value": value, "u": u, "k": factor(p), "unit": unit}
        return shown | ({"prior": prior, "learned": percent(p.learned)} if priors else {})

    caption = "u is the standard uncertainty, k u the half width of the interval of 95.45 %"
    caption += ", prior a standard deviation, as widened." if priors else "."
    parameters = quantity_table(further, shown_units(further), row, caption=caption, dense=True) if further else None
    if for_customers:
        meant = "What a reading has beside bias, scale factors and axes."
        if priors:
            meant += (
                " Of each there was a prior, a standard deviation over such instruments; learned is how much of its "
                "variance the recording has taken off: at 0 % only the prior is known."
            )
        return section("Beyond bias, scale factors and axes", meant, parameters) if parameters else None
    meant = (
        "Each group has a prior, the standard deviation over instruments of its grade or that of the data sheet; where "
        "the data exceed it, it was widened. Learned is how much of the prior's variance the recording has taken off: "
        "at 0 % only the prior is known."
    )
    decided = decided_by_priors(calibration)
    left = f"{decided[0].upper()}{decided[1:]}." if decided else None
    groups = group_table(calibration, of_a_page=True)
    return section("Beyond the linear model", meant, groups, left, parameters) if groups.rows else None


def unknown(calibration: Calibration) -> Section | None:
    """What the model did not know about itself, and what the recording says of it."""
    meant = (
        "Scatter, in-run biases and the sizes of groups were estimated with the parameters, and U is an average over "
        "what they may be. The middle 68 % of each stands beside its value; a size over the usual one has no unit."
    )
    blocks = unknown_blocks(calibration)
    return section("What the model did not know about itself", meant, *blocks) if blocks else None


def launches(calibration: Calibration) -> Section | None:
    """Every launch beside the others: bias, scale and axes, then what is beyond the linear model in a table of its
    own; None without launches."""
    if not calibration.launches:
        return None
    linear, further = linear_parameters(calibration.parameters), further_parameters(calibration.parameters)
    meant = (
        "The result is the mean of these launches (power-ons). Run to run is the standard deviation from one launch to "
        "another; it is in the uncertainty of the mean."
    )
    side_by_side = replace(launch_table(calibration, linear, of_a_page=True), dense=len(calibration.launches) > 4)
    blocks: list[Block] = [meant, side_by_side]
    if further:
        beyond_linear = replace(launch_table(calibration, further, of_a_page=True), dense=True)
        blocks += ["Beyond the linear model:", beyond_linear]
    digests = tuple(
        (f"log of {launch.session}", f"SHA-256 {launch.log_sha256}" if launch.log_sha256 else NONE)
        for launch in calibration.launches
    )
    return section("Launches", *blocks, Facts(rows=digests))


def compared(titles: Sequence[str], calibrations: Sequence[Calibration], name: str) -> Section:
    """Every parameter of several calibrations side by side, in the frame of the first: methods on one log, or launches
    and dates."""
    first, digests = calibrations[0], {calibration.provenance.get("log_sha256") for calibration in calibrations}
    one_log = len(digests) == 1 and None not in digests
    title = "Methods compared" if one_log else "Calibrations compared"
    try:
        alike = [c.in_frame(first.frame) for c in calibrations]
    except CalibrationError as error:
        return section(title, f"They cannot be compared: {error}")
    if not first.parameters:
        return section(title, "The first calibration has no parameters to compare.")
    units, by_name = shown_units(alike[0].parameters), [{p.name: p for p in each.parameters} for each in alike]
    columns = ("parameter", *titles, "range" if one_log else "spread", "unit")

    def side_by_side(parameters: Sequence[Parameter], *, dense: bool) -> Table:
        rows = []
        for p in parameters:
            (size, unit), there = units[p.name], [q.get(p.name) for q in by_name]
            each = ["" if q is None else " ± ".join(x or NONE for x in with_expanded(q, size)) for q in there]
            values = [q.value for q in there if q is not None]
            last = max(values) - min(values) if one_log else float(np.std(values, ddof=1)) if len(values) > 1 else None
            rows.append((p.name, *each, to_digits_of(last, expanded(p), size), unit))
        return Table(columns=columns, rows=tuple(rows), text=(0, len(columns) - 1), caption="Value ± U.", dense=dense)

    meant = (
        "The calibrations are of one log: its noise is common to all of them, so that methods should agree within much "
        "less than U."
        if one_log
        else "The spread is the standard deviation of the values."
    )
    blocks: list[Block] = [
        f"All in the frame “{first.frame}”. {meant}",
        side_by_side(linear_parameters(alike[0].parameters), dense=len(titles) > 2),
        Figure(
            svg=figures.comparison(name, titles, alike),
            caption="Difference of every parameter from the mean of the calibrations, with U.",
        ),
    ]
    if further := further_parameters(alike[0].parameters):
        blocks += ["Beyond the linear model:", side_by_side(further, dense=True)]
    return section(title, *blocks)


# -------------------- limits --------------------


def limits_elsewhere(calibration: Calibration, acceptance: Limits | None) -> bool:
    """Whether the table of results cannot hold the limits with all that is to be said of them."""
    if acceptance is None:
        return False
    return acceptance.frame != calibration.frame or acceptance.temperatures is not None


def limits(calibration: Calibration, acceptance: Limits | None, checks: Sequence[Verdict]) -> Section:
    """The decision rule, and every parameter against the limits of all checks with the verdicts."""
    if acceptance is None:
        none = "No acceptance limits were given: this report states values and uncertainties, not conformity."
        return section("Limits and verdict", none)
    rule = f"{RULE[0].upper()}{RULE[1:]}. Limits hold in the frame “{acceptance.frame}”."
    blocks: list[Block] = [rule]
    if notes := remarks(calibration):
        blocks.append(Items(items=notes))
    units = shown_units(calibration.parameters)
    for verdict in checks:
        reasons = f" ({'; '.join(verdict.reasons())})" if verdict.reasons() else ""
        over = f", {verdict.over}" if verdict.over else ""
        named = f"{_CHECKS[verdict.occasion]}: {verdict.result}{over}{reasons}."
        blocks.append(Text(text=named, tone=TONES[verdict.result]))
        blocks += [OVER_TEMPERATURE] if verdict.temperatures is not None else []
        rows = []
        for j in verdict.judgements:
            finite = [abs(limit) for limit in (j.low, j.high) if math.isfinite(limit)]
            size, unit = units.get(j.name) or engineering(j.unit, max(finite, default=0.0))
            value, U = cells(j.value, j.expanded, size)
            row = {"parameter": j.name, "low": limit_cell(j.low, size), "value": value, "U": U}
            row |= {"high": limit_cell(j.high, size), "unit": unit, "verdict": j.result}
            if verdict.temperatures is not None:
                row["at °C"] = "" if j.at is None else f"{j.at:.1f}"
            rows.append(row)
        blocks.append(table(rows, words=("parameter", "unit", "verdict")))
    return section("Limits and verdict", *blocks)


# -------------------- uncertainty --------------------


def correlations(calibration: Calibration) -> Section | None:
    """What U covers and what not, and the strongest correlations."""
    if calibration.covariance is None:
        return None
    names = [p.name for p in calibration.parameters]
    u = np.sqrt(np.diag(calibration.covariance))
    scale = np.where(u > 0.0, u, 1.0)
    r = np.clip(calibration.covariance / scale[:, None] / scale, -1.0, 1.0)
    p, q = np.tril_indices(len(names), -1)
    order = np.argsort(-np.abs(r[p, q]), kind="stable")[:_STRONGEST]
    rows = [
        {"parameter": names[p[i]], "with": names[q[i]], "coefficient": fixed(float(r[p[i], q[i]]), 3)} for i in order
    ]
    meant = (
        "U is the expanded uncertainty, which covers 95.45 %: the standard uncertainty times the coverage factor k, 2 "
        "where u is known, and more where it was estimated from few residuals. It contains the noise at rest and in "
        "turns, the scatter between rests that the residuals show, and the stated uncertainty of gravity; of several "
        "launches also their instability. "
    )
    if further_parameters(calibration.parameters):
        meant += (
            "It contains what the groups beyond the linear model leave open within their priors. It does not contain "
            "the change from one power-on to the next and with age, effects that no group describes, and an error of "
            "gravity larger than stated."
        )
    else:
        meant += (
            "It does not contain what one recording cannot show: changes with temperature and age, nonlinearity that "
            "is the same in every rest, and an error of gravity larger than stated."
        )
    blocks: list[Block] = [meant]
    if rows:
        strongest = (
            "The covariance of two parameters is their coefficient times both standard uncertainties; all of it is in "
            "the calibration file, which is the data annex. The strongest:"
        )
        blocks += [strongest, table(rows, words=("parameter", "with"))]
    return section("Covariance and correlations", *blocks)


def convergence(calibration: Calibration, name: str) -> Section | None:
    """Root mean square of the increments of every kind of parameter in each iteration."""
    if not calibration.iterations:
        return None
    parameters, rows, picture = linear_parameters(calibration.parameters), [], None
    kinds = by_group(parameters)
    for number, step in enumerate(calibration.iterations, 1):
        row = {"iteration": str(number)}
        for kind, alike in kinds.items():
            rms = float(np.sqrt(np.mean([step.get(p.name, 0.0) ** 2 for p in alike])))
            size, unit = engineering(alike[0].unit, rms)
            row[kind] = f"{significant(rms / size, 3)} {unit}" if rms > 0.0 else ""
        rows.append(row)
    if any(p.u for p in parameters):
        svg = figures.convergence(name, calibration.iterations, parameters)
        caption = "The largest increment of each kind of parameter, in units of its standard uncertainty u."
        picture = Figure(svg=svg, caption=caption)
    caption = "Increments, root mean square of each kind of parameter."
    return section("Convergence", picture, table(rows, words=("iteration",), dense=len(kinds) > 5, caption=caption))
