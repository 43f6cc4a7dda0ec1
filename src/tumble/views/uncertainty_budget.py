"""Uncertainty budgets: shares of sources by parameter group, and the budget of a parameter in the form of EA-4/02."""

from __future__ import annotations

import math
from itertools import chain

import numpy as np

from tumble.inference.sources import Source
from tumble.result.calibration import Calibration
from tumble.result.uncertainty_budget import REFERENCES, BudgetLine, shares_by_group, with_references
from tumble.sensors.parameters import beyond_linear, sensor_kind, shown_in
from tumble.views.blocks import Block, Table, table
from tumble.views.numbers import cells, percent, shown_units, significant

MIN_SHARE = 0.02  # of u²; sources with a smaller share in every group are summed in one line
OTHERS = "all others"
ALWAYS_LISTED = {"launches", *chain(*REFERENCES.values())}
"""Sources with a line of their own however small: reference standards, changes from launch to launch."""
DEGREES_OF_MEAN = (
    "Mean of L launches: s is the standard deviation from launch to launch, n the noise of one launch. The line of "
    "changes from launch to launch has u = s/√L with L − 1 degrees of freedom and contributes the part of s² above n². "
    "U is the larger of t(L − 1) s/√L and U by Welch and Satterthwaite, where max(s, n) has the degrees of freedom of "
    "the larger of t(L − 1) s and t(ν_n) n; ν of the value is that with t(ν) u = U."
)


def budget_blocks(calibration: Calibration, *, every: bool = False) -> list[Block]:
    """Return the shares of sources in u² of the linear groups; with `every` also the budget of each of their
    parameters.

    Empty without a budget."""
    if not (calibration.evidence.budget and calibration.parameters):
        return []
    blocks: list[Block] = [share_table(calibration)]
    blocks += [DEGREES_OF_MEAN] if calibration.evidence.launches else []
    if every:
        blocks += [parameter_budget(calibration, name) for name in calibration if not beyond_linear(name)]
    return blocks


def share_table(calibration: Calibration) -> Table:
    """Return a table of the sources with their mean shares in u² of each group, the largest first."""
    budget = with_references(calibration)
    no_shares = np.zeros(len(budget) - len(calibration.evidence.budget))  # of references, which contribute nothing
    shares = {group: np.append(share, no_shares) for group, share in shares_by_group(calibration).items()}
    by_group = np.array(list(shares.values()))
    order = np.argsort(-by_group.mean(axis=0)).tolist()
    small = [s for s in order if by_group[:, s].max() < MIN_SHARE and budget[s].name not in ALWAYS_LISTED]
    rows = []
    for s in (s for s in order if s not in small):
        source = budget[s]
        row = {"source": _words(source), "type": source.type, "u": "", "unit": ""}
        if source.u is not None:  # of a prior: that of its group; None for a source of several quantities
            size, unit = _unit_of(source)
            row |= {"u": _two_digits(source.u / size), "unit": unit}
        row["dof"] = _degrees(source.dof)
        rows.append(row | {group: percent(float(share[s])) for group, share in shares.items()})
    if small:
        sums = {group: percent(float(share[small].sum())) for group, share in shares.items()}
        rows.append({"source": OTHERS, "type": "", "u": "", "unit": "", "dof": ""} | sums)
    caption = "Shares of u² by source, mean over the parameters of a group."
    return table(rows, words=("source", "type", "unit"), dense=True, caption=caption)


def parameter_budget(calibration: Calibration, name: str) -> Table:
    """Return the budget of a parameter in the form of EA-4/02, with small contributions in one line."""
    parameter, lines = calibration[name], calibration.uncertainty_budget(name)
    size, unit = shown_units(calibration.parameters)[name]
    always = ("launches", *REFERENCES[sensor_kind(name)])
    kept = [each for each in lines if each.share >= MIN_SHARE or each.name in always]
    small = sum(each.share for each in lines if each not in kept)
    if small > 0.0:
        u = math.sqrt(small) * (parameter.u or 0.0)
        others = Source(name=OTHERS, words=OTHERS, type="B", u=u, unit=parameter.unit)
        kept.append(BudgetLine.of(others, estimate=0.0, sensitivity=1.0, contribution=u, share=small))
    rows = []
    for line in kept:
        u = line.u or 0.0
        if line.estimate != 0.0:  # a quantity with a value of its own, such as gravity, in SI
            line_size, line_unit = 1.0, line.unit.replace("^2", "²")
            estimate, estimate_u = cells(line.estimate, u, 1.0) if u else (significant(line.estimate, 7), "0")
        else:  # an error, whose estimate is zero; if it adds to the parameter, in the unit of that
            adds = line.unit == parameter.unit and (line.sensitivity == 1.0 or line.name == "launches")
            line_size, line_unit = (size, unit) if adds else _unit_of(line)
            estimate, estimate_u = "0", _two_digits(u / line_size)
        rows.append(
            {
                "input quantity": _words(line),
                "type": "" if line.name == OTHERS else line.type,
                "estimate": estimate,
                "u": estimate_u,
                "unit": line_unit,
                "distribution": line.distribution,
                "sensitivity": _two_digits(line.sensitivity * line_size / size),
                "contribution": _two_digits(line.contribution / size),
                "share": percent(line.share),
                "dof": _degrees(line.dof),
            }
        )
    value, whole_u = cells(parameter.value, parameter.u, size)
    distribution = "normal" if parameter.dof is None else "t"
    total = {"estimate": value, "u": whole_u, "unit": unit, "distribution": distribution, "sensitivity": ""}
    total |= {"contribution": whole_u, "share": percent(1.0), "dof": _degrees(parameter.dof)}
    rows.append({"input quantity": name, "type": ""} | total)
    caption = f"Uncertainty budget of {name}; contributions in {unit}, sensitivities in {unit} over the unit."
    return table(rows, words=("input quantity", "type", "unit", "distribution"), dense=True, caption=caption)


def _two_digits(value: float) -> str:
    """Format a number to two digits."""
    return f"{float(f'{value:.1e}'):.0f}" if 10.0 <= value < 1e5 else significant(value, 2)


def _degrees(dof: float | None) -> str:
    return "∞" if dof is None else _two_digits(dof)


def _unit_of(source: Source) -> tuple[float, str]:
    """Return the display unit of the standard uncertainty of a source: size in SI, name."""
    size, shown = shown_in(source.name.removeprefix("prior."), source.unit, source.u or 0.0)
    return size, "" if shown == "1" else shown


def _words(source: Source) -> str:
    """Return the description of a source, with the basis of a prior."""
    return f"{source.words}, by the {source.basis}" if source.basis else source.words
