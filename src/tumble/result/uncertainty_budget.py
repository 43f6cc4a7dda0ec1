"""The uncertainty budget of a calibration: by source what every u is made of, and what would make it smaller.

u² = Σ c_s² u_s² over independent sources, as EA-4/02 lists them: the standard uncertainty u_s of the source, the
sensitivity |c_s| = contribution/u_s, the contribution |c_s| u_s and its share of u². A source of several quantities,
such as the limits of all biases, scale factors and angles, has contributions and no single u_s.

Source: EA-4/02 M:2022, section 4; JCGM 100:2008 (GUM), 5.1 and G.4.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from math import sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from tumble.errors import CalibrationError
from tumble.inference.sources import Source, UncertaintyBudget
from tumble.result.parts import SourceContributions
from tumble.sensors.parameters import beyond_linear, group_name
from tumble.units import Array

if TYPE_CHECKING:
    from tumble.result.calibration import Calibration

LESS = 0.25
"""Of a variance: what four times as much of something leaves of it."""
ROUNDING = 1e-15
"""Of a variance: less is none."""
HELPS = 1.02
"""A mean u that becomes smaller by less than this factor does not."""
_OF_RESTS = ("accel.noise", "gyro.noise")
_REMEDIES: Mapping[str, tuple[str, ...]] = {
    "rests four times as long": _OF_RESTS,
    "four times as many rests and turns": (
        *_OF_RESTS,
        *("turn.gyro.noise", "turn.accel.noise", "fit", "launches", "within launches"),
        *("accel.scatter", "gyro.scatter", "turn.scatter", "velocity.scatter", "apart.scatter"),
        *("jumps.scatter", "aliased.scatter", "aliased_apart.scatter", "accel.in_run", "gyro.in_run"),
    ),
    "half the u of gravity": ("gravity",),
    "half the u of the time base": ("clock",),
    "half the usual sizes, as by a data sheet": ("prior.", "priors"),
}
"""What takes three quarters off the variances of sources; a name that ends in a point stands for all that begin so."""


@dataclass(frozen=True, kw_only=True, slots=True)
class BudgetLine(Source):
    """What a source has in the u of a parameter, SI: `contribution` u_i, its `share` of u², and the `sensitivity`
    |c_i|, contribution over the u of the source, None where that is of several quantities."""

    contribution: float
    share: float
    sensitivity: float | None


def contributions_of(budget: UncertaintyBudget | None, names: Sequence[str]) -> tuple[SourceContributions, ...]:
    """The sources of a budget with what they have in the u of its parameters, which are these."""
    if budget is None:
        return ()
    variances = np.diagonal(budget.covariances, axis1=1, axis2=2)
    variances = np.where(variances > ROUNDING * variances.sum(axis=0), variances, 0.0)
    return tuple(
        SourceContributions(
            **_as_source(each),
            contributions={
                n: sqrt(variance) for n, variance in zip(names, own.tolist(), strict=True) if variance > 0.0
            },
        )
        for each, own in zip(budget.sources, variances, strict=True)
    )


def _as_source(each: Source) -> dict[str, Any]:
    return {field.name: getattr(each, field.name) for field in fields(Source)}


def uncertainty_budget(calibration: Calibration, name: str) -> tuple[BudgetLine, ...]:
    """The budget of a parameter, the largest contribution first. Raises KeyError for a name that is none, and
    CalibrationError where the calibration has no budget."""
    parameter = calibration[name]
    if not calibration.evidence.budget:
        raise CalibrationError(
            f"calibration of {calibration.serial}: expected one with its budget, found one that was turned into the "
            f"frame {calibration.frame!r}, or made by hand; calibrate again with this --frame"
        )
    lines = [
        BudgetLine(
            **_as_source(each),
            contribution=each.contributions[name],
            share=(each.contributions[name] / (parameter.u or np.inf)) ** 2,
            sensitivity=each.contributions[name] / each.u if each.u else None,
        )
        for each in calibration.evidence.budget
        if name in each.contributions
    ]
    return tuple(sorted(lines, key=lambda line: -line.contribution))


def shares_by_group(calibration: Calibration) -> dict[str, Array]:
    """The mean share (S,) of every source in u² of the parameters of each group of the linear model, by its name."""
    variances = _variances(calibration)
    groups: dict[str, list[int]] = {}
    for i, name in enumerate(calibration):
        if not beyond_linear(name):
            groups.setdefault(group_name(name), []).append(i)
    whole = np.maximum(variances.sum(axis=0), 1e-300)
    return {group: (variances[:, own] / whole[own]).mean(axis=1) for group, own in groups.items()}


def what_would_help(calibration: Calibration) -> str:
    """One sentence: by how much u of bias, scale factors and axis angles would be smaller, the geometric mean, if there
    were more of something, or something were known better; empty without a budget."""
    variances = _variances(calibration)[:, [not beyond_linear(name) for name in calibration]]
    variances = variances[:, variances.any(axis=0)]
    if not variances.size:
        return ""
    whole, gains = variances.sum(axis=0), list[tuple[float, str]]()
    for remedy, names in _REMEDIES.items():
        own = [
            any(s.name == n or (n.endswith(".") and s.name.startswith(n)) for n in names)
            for s in calibration.evidence.budget
        ]
        if any(own):
            left = whole - (1.0 - LESS) * variances[own].sum(axis=0)
            gains.append((float(np.exp(0.5 * np.mean(np.log(whole / left)))), remedy))
    helping = [f"{gain:.2f} times with {remedy}" for gain, remedy in sorted(gains, reverse=True) if gain >= HELPS]
    idle = [remedy for gain, remedy in gains if gain < HELPS]
    parts = [f"u would be smaller {', '.join(helping)}"] if helping else []
    return ". ".join([*parts, *([f"Next to nothing would be gained by {', '.join(idle)}"] if idle else [])])


def _variances(calibration: Calibration) -> Array:
    """The variances (S, m) that sources have in parameters."""
    every = [[source.contributions.get(name, 0.0) for name in calibration] for source in calibration.evidence.budget]
    return np.array(every).reshape(len(every), len(calibration)) ** 2
