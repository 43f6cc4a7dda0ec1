"""The uncertainty budget of a calibration: by source what every u is made of.

u² = Σ c_s² u_s² over independent sources, as EA-4/02 lists them: the estimate x_s of the input quantity, its standard
uncertainty u_s and distribution, the sensitivity |c_s| = contribution/u_s, the contribution |c_s| u_s and its share of
u². The reference standards, gravity, the Earth's rate and the time base, have a line even where they contribute
nothing. All other input quantities are errors, whose estimate is 0. A source of several quantities, such as the limits
of all biases, scale factors and angles, enters as one correction of the parameter: u_s is its contribution, c_s is 1.

Source: EA-4/02 M:2022, section 4; JCGM 100:2008 (GUM), 5.1 and G.4.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import sqrt
from typing import Any

import numpy as np

from tumble.earth import EARTH_RATE
from tumble.errors import CalibrationError
from tumble.inference.sources import Source, UncertaintyBudget, source
from tumble.result.parts import SourceContributions
from tumble.result.record import CalibrationData
from tumble.sensors.parameters import beyond_linear, group_name, sensor_kind
from tumble.units import Array

ROUNDING = 1e-15
"""Of a variance: less is none."""
REFERENCES: Mapping[str, tuple[str, ...]] = {
    "accel": ("gravity",),
    "gyro": ("gravity", "earth", "clock"),
    "mag": (),
}
"""The reference standards that the sensors of a kind are compared with."""


@dataclass(frozen=True, kw_only=True, slots=True)
class BudgetLine(Source):
    """What a source has in the u of a parameter, SI: the `estimate` of its input quantity, the `sensitivity` |c_i|, the
    `contribution` |c_i| u_i and its `share` of u²."""

    estimate: float
    sensitivity: float
    contribution: float
    share: float

    @staticmethod
    def of(each: Source, **others: Any) -> BudgetLine:
        """The line of a source, with the other fields."""
        return BudgetLine(**_as_source(each), **others)


def contributions_of(
    budget: UncertaintyBudget | None, names: Sequence[str], basis: Mapping[str, str] | None = None
) -> tuple[SourceContributions, ...]:
    """The sources of a budget with what they have in the u of its parameters, which are these; `basis` says by group
    what the size of its prior rests on."""
    if budget is None:
        return ()
    variances = np.diagonal(budget.covariances, axis1=1, axis2=2)
    variances = np.where(variances > ROUNDING * variances.sum(axis=0), variances, 0.0)
    return tuple(
        SourceContributions(
            **_as_source(replace(each, basis=(basis or {}).get(each.name.removeprefix("prior."), each.basis))),
            contributions={
                n: sqrt(variance) for n, variance in zip(names, row.tolist(), strict=True) if variance > 0.0
            },
        )
        for each, row in zip(budget.sources, variances, strict=True)
    )


def _as_source(each: Source) -> dict[str, Any]:
    return {field.name: getattr(each, field.name) for field in fields(Source)}


def uncertainty_budget(calibration: CalibrationData, name: str) -> tuple[BudgetLine, ...]:
    """The budget of a parameter, the largest contribution first. Raises KeyError for a name that is none, and
    CalibrationError where the calibration has no budget."""
    parameter = calibration[name]
    if not calibration.evidence.budget:
        raise CalibrationError(
            f"calibration of {calibration.serial}: expected one with its budget, found one that was turned into the "
            f"frame {calibration.frame!r}, or made by hand; calibrate again with this --frame"
        )
    site, lines = calibration.provenance.site, list[BudgetLine]()
    estimates = {"earth": EARTH_RATE, "gravity": 0.0 if site is None else site.gravity}
    for each in with_references(calibration):
        contribution = each.contributions.get(name, 0.0)
        if contribution == 0.0 and each.name not in REFERENCES[sensor_kind(name)]:
            continue
        line = BudgetLine.of(
            replace(each, u=contribution, unit=parameter.unit) if each.u is None else each,
            estimate=0.0 if each.u is None else estimates.get(each.name, 0.0),
            sensitivity=contribution / each.u if each.u else float(each.u is None),
            contribution=contribution,
            share=(contribution / (parameter.u or np.inf)) ** 2,
        )
        lines.append(line)
    return tuple(sorted(lines, key=lambda line: -line.contribution))


def with_references(calibration: CalibrationData) -> tuple[SourceContributions, ...]:
    """The budget, and after it the reference standards that have nothing in the u of any parameter."""
    site, budget = calibration.provenance.site, calibration.evidence.budget
    standards = (
        source("gravity", 0.0 if site is None else site.gravity_u, "m/s^2"),
        source("earth", 0.0, "rad/s"),
        source("clock", calibration.provenance.clock_u, "1"),
    )
    compared = {name for kind in {sensor_kind(name) for name in calibration} for name in REFERENCES[kind]}
    missing = (each for each in standards if each.name in compared - {line.name for line in budget})
    return (*budget, *(SourceContributions(**_as_source(each), contributions={}) for each in missing))


def shares_by_group(calibration: CalibrationData) -> dict[str, Array]:
    """The mean share (S,) of every source in u² of the parameters of each group of the linear model, by its name."""
    variances = _variances(calibration)
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(calibration):
        if not beyond_linear(name):
            groups.setdefault(group_name(name), []).append(i)
    total = np.maximum(variances.sum(axis=0), 1e-300)
    return {group: (variances[:, members] / total[members]).mean(axis=1) for group, members in groups.items()}


def shares_of_priors(calibration: CalibrationData) -> dict[str, dict[str, float]]:
    """What the sizes of priors rest on, such as a data sheet or a guessed grade or other units of the type, each with
    the mean share of u² by group of the linear model that rests on it."""
    shares, by_basis = shares_by_group(calibration), dict[str, dict[str, float]]()
    for s, each in enumerate(calibration.evidence.budget):
        basis = "other units of the type" if each.name == "type" else each.basis
        for group, share in shares.items() if basis else ():
            of_basis = by_basis.setdefault(basis, {})
            of_basis[group] = of_basis.get(group, 0.0) + float(share[s])
    return by_basis


def _variances(calibration: CalibrationData) -> Array:
    """The variances (S, m) that sources have in parameters."""
    every = [[source.contributions.get(name, 0.0) for name in calibration] for source in calibration.evidence.budget]
    return np.array(every).reshape(len(every), len(calibration)) ** 2
