"""Uncertainty budget of a calibration: the contributions to the u of every parameter by source.

u² = Σ c_s² u_s² over independent sources, as EA-4/02 lists them: the estimate x_s of the input quantity, its standard
uncertainty u_s and distribution, the sensitivity |c_s| = contribution/u_s, the contribution |c_s| u_s and its share of
u². The reference standards, gravity, the Earth's rate and the time base, have a line even if they contribute nothing.
All other input quantities are errors with the estimate 0. A source of several quantities, such as the limits of all
biases, scale factors and angles, enters as one correction of the parameter: u_s is its contribution, c_s is 1. In the
mean of L launches the changes from launch to launch have u_s = s/√L with L − 1 degrees of freedom, which U uses
(`tumble.result.coverage`), and contribute the part of s²/L that exceeds the launches' own noise.

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
from tumble.sensors.parameters import beyond_linear, positions_by_group, sensor_kind
from tumble.units import Array

ROUNDING = 1e-15  # of a variance; a smaller contribution is zero
REFERENCES: Mapping[str, tuple[str, ...]] = {"accel": ("gravity",), "gyro": ("gravity", "earth", "clock"), "mag": ()}
"""Reference standards of each kind of sensor."""


@dataclass(frozen=True, kw_only=True, slots=True)
class BudgetLine(Source):
    """Contribution of a source to the u of a parameter, SI: the `estimate` of its input quantity, the `sensitivity`
    |c_s|, the `contribution` |c_s| u_s and its `share` of u²."""

    estimate: float
    sensitivity: float
    contribution: float
    share: float

    @staticmethod
    def of(each: Source, **others: Any) -> BudgetLine:
        """Return the line of a source with the other fields."""
        return BudgetLine(**_as_source(each), **others)


def contributions_of(
    budget: UncertaintyBudget | None, names: Sequence[str], basis: Mapping[str, str] | None = None
) -> tuple[SourceContributions, ...]:
    """Return the sources of a budget with their contributions to the u of its parameters, which have these `names`.

    `basis` is the origin of the size of the prior by group of parameters."""
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
    """Return the budget of a parameter, the largest contribution first.

    Raises KeyError for an unknown name, and CalibrationError if the calibration has no budget."""
    parameter = calibration[name]
    if not calibration.evidence.budget:
        raise CalibrationError(
            f"calibration of {calibration.serial}: expected one with its budget, found none: it states no u, was "
            f"made by hand, or was converted to the frame {calibration.frame!r}; calibrate again with this --frame"
        )
    site, lines = calibration.provenance.site, list[BudgetLine]()
    estimates = {"earth": EARTH_RATE, "gravity": 0.0 if site is None else site.gravity}
    for each in with_references(calibration):
        contribution = each.contributions.get(name, 0.0)
        u = contribution if each.u is None else each.u
        if each.name == "launches":
            u = (parameter.run_to_run or 0.0) / sqrt(1.0 + (each.dof or 0.0))
        elif contribution == 0.0 and each.name not in REFERENCES[sensor_kind(name)]:
            continue
        line = BudgetLine.of(
            replace(each, u=u, unit=parameter.unit if each.u is None else each.unit),
            estimate=0.0 if each.u is None else estimates.get(each.name, 0.0),
            sensitivity=contribution / u if u else float(each.u is None),
            contribution=contribution,
            share=(contribution / (parameter.u or np.inf)) ** 2,
        )
        lines.append(line)
    return tuple(sorted(lines, key=lambda line: -line.contribution))


def with_references(calibration: CalibrationData) -> tuple[SourceContributions, ...]:
    """Return the budget, and after it the reference standards that contribute to no parameter."""
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
    """Return the mean share (S,) of every source in u² over each group of the linear model, by its name."""
    budget, names = calibration.evidence.budget, list(calibration)
    contributions = [[source.contributions.get(name, 0.0) for name in names] for source in budget]
    variances = np.reshape(contributions, (len(budget), len(names))) ** 2
    share = variances / np.maximum(variances.sum(axis=0), 1e-300)
    groups = positions_by_group(names).items()
    return {name: share[:, group].mean(axis=1) for name, group in groups if not beyond_linear(names[group[0]])}


def shares_of_priors(calibration: CalibrationData) -> dict[str, dict[str, float]]:
    """Return the mean share of priors in u² over each group of the linear model, by the basis of their sizes.

    A basis is a data sheet, a guessed grade or other units of the type."""
    shares, by_basis = shares_by_group(calibration), dict[str, dict[str, float]]()
    for s, each in enumerate(calibration.evidence.budget):
        basis = "other units of the type" if each.name == "type" else each.basis
        for group, share in shares.items() if basis else ():
            groups = by_basis.setdefault(basis, {})
            groups[group] = groups.get(group, 0.0) + float(share[s])
    return by_basis
