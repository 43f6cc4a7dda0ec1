"""Acceptance limits in a report: every parameter against them, the verdict and the decision rule."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tumble.acceptance.conformity import RULE, LimitJudgement, Verdict
from tumble.acceptance.limits import Limits
from tumble.result.calibration import Calibration
from tumble.result.further import remarks
from tumble.units import engineering
from tumble.views.blocks import Block, Items, Section, Text, table
from tumble.views.numbers import Units, cells, limit_cell, shown_units
from tumble.views.registry import TONES

OVER_TEMPERATURE = (
    "Biases and scale factors are judged at the temperature where they are worst, with U there; other parameters are "
    "the same at all temperatures. Beyond what was measured nothing passes."
)
_CHECKS = {"incoming": "Incoming inspection", "periodic": "Periodic check"}


def section(calibration: Calibration, limits: Limits | None, checks: Sequence[Verdict]) -> Section:
    """Limits, the verdicts of all checks and the decision rule."""
    if limits is None:
        said = "No acceptance limits were given: this report states values and uncertainties, not conformity."
        return Section(title="Limits and verdict", blocks=(Text(text=said),))
    rule = f"{RULE[0].upper()}{RULE[1:]}. Limits hold in the frame “{limits.frame}”."
    blocks: list[Block] = [Text(text=rule)]
    if notes := remarks(calibration):
        blocks.append(Items(items=notes))
    units = shown_units(calibration.parameters)
    for verdict in checks:
        reasons = f" ({'; '.join(verdict.reasons())})" if verdict.reasons() else ""
        over = f", {verdict.over}" if verdict.over else ""
        said = f"{_CHECKS[verdict.occasion]}: {verdict.result}{over}{reasons}."
        blocks.append(Text(text=said, tone=TONES[verdict.result]))
        rows = [_row(judgement, units) for judgement in verdict.judgements]
        if verdict.temperatures is not None:
            blocks.append(Text(text=OVER_TEMPERATURE))
            for row, judgement in zip(rows, verdict.judgements, strict=True):
                row["at °C"] = "" if judgement.at is None else f"{judgement.at:.1f}"
        blocks.append(table(rows, words=("parameter", "unit", "verdict")))
    return Section(title="Limits and verdict", blocks=tuple(blocks))


def _row(judgement: LimitJudgement, units: Units) -> dict[str, str]:
    finite = [abs(v) for v in (judgement.low, judgement.high) if math.isfinite(v)]
    size, unit = units.get(judgement.name) or engineering(judgement.unit, max(finite, default=0.0))
    value, expanded = cells(judgement.value, judgement.expanded, size)
    row = {"parameter": judgement.name, "low": limit_cell(judgement.low, size), "value": value, "U": expanded}
    return row | {"high": limit_cell(judgement.high, size), "unit": unit, "verdict": judgement.result}
