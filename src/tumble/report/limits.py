"""Acceptance limits in a report: every parameter against them, the verdict and the decision rule."""

from __future__ import annotations

import math
from collections.abc import Mapping

from tumble.acceptance.conformity import RULE, LimitJudgement, verdicts
from tumble.acceptance.limits import Limits
from tumble.calibration.calibration_file import Calibration
from tumble.calibration.coverage import remarks
from tumble.calibration.shown import shown_units
from tumble.report.blocks import Block, Items, ReportTable, Section, Text, Tone
from tumble.report.numbers import NONE, limit_of, minus
from tumble.units import engineering, rounded

OVER_TEMPERATURE = (
    "Biases and scale factors are judged at the temperature where they are worst, with U there; other parameters are "
    "the same at all temperatures. Beyond what was measured nothing passes."
)
TONES: Mapping[str, Tone] = {
    "pass": "good",
    "conditional pass": "doubt",
    "conditional fail": "bad",
    "undecided": "bad",
    "fail": "bad",
}
_CHECKS = {"incoming": "Incoming inspection", "periodic": "Periodic check"}


def section(calibration: Calibration, limits: Limits | None) -> Section:
    """Limits, verdict and decision rule."""
    if limits is None:
        said = "No acceptance limits were given: this report states values and uncertainties, not conformity."
        return Section(title="Limits and verdict", blocks=(Text(text=said),))
    rule = f"{RULE[0].upper()}{RULE[1:]}. Limits hold in the frame “{limits.frame}”."
    blocks: list[Block] = [Text(text=rule)]
    if found := remarks(calibration):
        blocks.append(Items(items=found))
    units = shown_units(calibration.parameters)
    for verdict in verdicts(calibration, limits):
        check = _CHECKS[verdict.occasion]
        reasons = f" ({'; '.join(verdict.reasons())})" if verdict.reasons() else ""
        said = ", ".join(each for each in (f"{check}: {verdict.result}", verdict.over) if each) + reasons
        rows = tuple(_row(j, units) for j in verdict.judgements)
        columns: tuple[str, ...] = ("parameter", "low", "value", "U", "high", "unit", "verdict")
        blocks.append(Text(text=f"{said}.", tone=TONES[verdict.result]))
        if verdict.temperatures is not None:
            blocks.append(Text(text=OVER_TEMPERATURE))
            columns = (*columns, "at °C")
            rows = tuple((*row, _at(j)) for row, j in zip(rows, verdict.judgements, strict=True))
        blocks.append(ReportTable(columns=columns, rows=rows, text=(0, 5, 6)))
    return Section(title="Limits and verdict", blocks=tuple(blocks))


def _row(judgement: LimitJudgement, units: Mapping[str, tuple[float, str]]) -> tuple[str, ...]:
    finite = [abs(v) for v in (judgement.low, judgement.high) if math.isfinite(v)]
    size, unit = units.get(judgement.name) or engineering(judgement.unit, max(finite, default=0.0))
    value, expanded = NONE, NONE
    if judgement.value is not None and judgement.expanded is not None:
        value, expanded = rounded(judgement.value / size, judgement.expanded / size)
    elif judgement.value is not None:
        value = f"{judgement.value / size:.6g}"
    low, high = (limit_of(v, size) for v in (judgement.low, judgement.high))
    return judgement.name, low, minus(value), expanded, high, unit, judgement.result


def _at(judgement: LimitJudgement) -> str:
    return NONE if judgement.at is None else minus(f"{judgement.at:.1f}")
