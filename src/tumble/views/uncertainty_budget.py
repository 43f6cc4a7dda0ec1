"""The uncertainty budget: shares of sources by group of parameters, and the table of each parameter in the form of
EA-4/02."""

from __future__ import annotations

import math

import numpy as np

from tumble.inference.sources import Source
from tumble.result.calibration import Calibration
from tumble.result.uncertainty_budget import REFERENCES, BudgetLine, shares_by_group, with_references
from tumble.sensors.parameters import beyond_linear, sensor_kind, shown_in
from tumble.views.blocks import Block, Section, Table, section, table
from tumble.views.numbers import cells, percent, shown_units, significant

SHOWN = 0.02
"""Of u²: sources with less in every group are summed up in one line."""
REST = "all others"


def budget_blocks(calibration: Calibration, *, every: bool = False) -> list[Block]:
    """The shares of sources in u² of the groups of the linear model; with `every`, the table of each of its parameters
    too. Nothing without a budget."""
    if not calibration.evidence.budget:
        return []
    blocks: list[Block] = [share_table(calibration)]
    if every:
        blocks += [parameter_budget(calibration, name) for name in calibration if not beyond_linear(name)]
    return blocks


def share_table(calibration: Calibration) -> Table:
    """Sources with type, standard uncertainty and degrees of freedom, and their mean shares in u² of the parameters of
    each group, the largest first; the reference standards however small."""
    shares, budget, rows = shares_by_group(calibration), with_references(calibration), []
    missing = np.zeros(len(budget) - len(calibration.evidence.budget))
    shares = {group: np.append(share, missing) for group, share in shares.items()}
    every = np.array(list(shares.values()))
    order = np.argsort(-every.mean(axis=0)).tolist()
    standards = {name for names in REFERENCES.values() for name in names}
    small = [s for s in order if every[:, s].max() < SHOWN and budget[s].name not in standards]
    for s in (s for s in order if s not in small):
        row, (size, unit) = {"source": _words(budget[s]), "type": budget[s].type}, _unit_of(budget[s])
        u = budget[s].u  # that of its group where it is the prior of one; none where it is of several quantities
        row |= {"u": "", "unit": ""} if u is None else {"u": _two(u / size), "unit": unit}
        row |= {"dof": _degrees(budget[s].dof)}
        rows.append(row | {group: percent(float(share[s])) for group, share in shares.items()})
    if small:
        together = {group: percent(float(share[small].sum())) for group, share in shares.items()}
        rows.append({"source": REST, "type": "", "u": "", "unit": "", "dof": ""} | together)
    caption = "Shares of u² by source, mean over the parameters of a group."
    return table(rows, words=("source", "type", "unit"), dense=True, caption=caption)


def parameter_budget(calibration: Calibration, name: str) -> Table:
    """The budget of a parameter as EA-4/02 has it: input quantity, type, estimate, standard uncertainty, distribution,
    sensitivity, contribution, share of u² and degrees of freedom. What contributes little is one line, but for the
    reference standards."""
    parameter, lines, rows = calibration[name], calibration.uncertainty_budget(name), []
    size, unit = shown_units(calibration.parameters)[name]
    kept = [each for each in lines if each.share >= SHOWN or each.name in REFERENCES[sensor_kind(name)]]
    small = sum(each.share for each in lines if each not in kept)
    if small > 0.0:
        little = math.sqrt(small) * (parameter.u or 0.0)
        others = Source(name=REST, words=REST, type="B", u=little, unit=parameter.unit)
        kept.append(BudgetLine.of(others, estimate=0.0, sensitivity=1.0, contribution=little, share=small))
    for line in kept:
        own_size, in_unit = _unit_of(line)
        if line.estimate != 0.0:
            own_size, in_unit = 1.0, line.unit.replace("^2", "²")
        elif line.unit == parameter.unit and line.sensitivity == 1.0:
            own_size, in_unit = size, unit
        u = line.u or 0.0
        estimate, of_estimate = cells(line.estimate, u, own_size) if u else (significant(line.estimate, 7), "0")
        if line.estimate == 0.0:
            estimate, of_estimate = "0", _two(u / own_size)
        rows.append(
            {
                "input quantity": _words(line),
                "type": "" if line.name == REST else line.type,
                "estimate": estimate,
                "u": of_estimate,
                "unit": in_unit,
                "distribution": line.distribution,
                "sensitivity": _two(line.sensitivity * own_size / size),
                "contribution": _two(line.contribution / size),
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


def _two(value: float) -> str:
    """A number to two digits."""
    return f"{float(f'{value:.1e}'):.0f}" if 10.0 <= value < 1e5 else significant(value, 2)


def _degrees(dof: float | None) -> str:
    return "∞" if dof is None else _two(dof)


def _unit_of(source: Source) -> tuple[float, str]:
    """The unit in which the standard uncertainty of a source is shown: its size in SI, and its name."""
    size, shown = shown_in(source.name.removeprefix("prior."), source.unit, source.u or 0.0)
    return size, "" if shown == "1" else shown


def _words(source: Source) -> str:
    """The words of a source, with what the size of a prior rests on."""
    return f"{source.words}, by the {source.basis}" if source.basis else source.words


def budget_section(calibration: Calibration, *, short: bool = False) -> Section | None:
    """The budget on a page: the shares of all sources and, unless it is to be `short`, the table of each parameter of
    the linear model; nothing without a budget."""
    if not calibration.evidence.budget:
        return None
    blocks = [share_table(calibration)] if short else budget_blocks(calibration, every=True)
    return section("Uncertainty budget", *blocks)
