"""What a laboratory is accredited for: its calibration and measurement capability (CMC) by quantity and range.

A certificate under an accreditation states no U smaller than the CMC (ILAC-P14:09/2020), and says of what lies outside
the scope that it is not accredited. Where the U of a measurement is smaller, an independent error is added to the value
that makes it the CMC,

    u'² = u² + (CMC/2)² − min u²,    k = 2,

min u² being the least over the temperatures that were measured, so that U is nowhere smaller over temperature either.
All that follows, verdicts among it, is by the U that is stated; the calibration file keeps that of the measurement.

[[laboratory.scope]]
quantity = "accel.bias"     # a group, or one of its parameters
min = "-100 mg"             # optional: the range of its value
max = "100 mg"
cmc = "50 ug"               # U, of 95.45 %
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Self

import numpy as np
from pydantic import BaseModel, ConfigDict, model_validator

from tumble.errors import did_you_mean
from tumble.result.calibration import Calibration
from tumble.result.coverage import expanded
from tumble.result.parts import Parameter, SourceContributions
from tumble.result.temperature_curves import changing, curve, measured_range
from tumble.sensors.parameters import beyond_linear, group_of, groups, meant_by, quantity_of

CMC, OUTSIDE = "CMC", "not accredited"
"""What is said of a U that is the CMC, and of a quantity outside the scope."""
_STATEMENTS = {
    CMC: f"“{CMC}”: the U of the measurement is smaller than the calibration and measurement capability of the "
    "accreditation, which is stated in its place (ILAC-P14:09/2020). ",
    OUTSIDE: f"“{OUTSIDE}”: outside the scope of the accreditation, as is all that is not in the table of results",
}


class Capability(BaseModel):
    """An entry of the scope: the least U, as a text with a unit, of a `quantity` whose value is from min to max."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)

    quantity: str
    cmc: str
    min: str | None = None
    max: str | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        try:
            group_of(self.quantity)
        except KeyError:
            near = did_you_mean(self.quantity, (group.name for group in groups()))
            raise ValueError(
                f'quantity: expected a name such as "accel.bias" or "gyro.axis.xy", found {self.quantity!r}{near}'
            ) from None
        if self._si(self.cmc) <= 0.0:
            raise ValueError(f"cmc: expected more than 0, found {self.cmc!r}")
        if self._si(self.min, -math.inf) >= self._si(self.max, math.inf):
            raise ValueError(f"min: expected less than max, found {self.min!r} and {self.max!r}")
        return self

    def _si(self, text: str | None, otherwise: float = 0.0) -> float:
        return otherwise if text is None else quantity_of(group_of(self.quantity), text)

    def least(self, parameter: Parameter) -> float | None:
        """The CMC, SI, for a parameter; None for what the entry is not about."""
        inside = self._si(self.min, -math.inf) <= parameter.value <= self._si(self.max, math.inf)
        return self._si(self.cmc) if inside and meant_by(self.quantity, parameter.name) else None


def statement_of_scope(said: Mapping[str, str]) -> str:
    """What the words in the column of the scope mean, and what is outside of it in any case."""
    words = "".join(text for word, text in _STATEMENTS.items() if word in said.values())
    return words if OUTSIDE in said.values() else f"{words}What is not in the table of results is outside the scope"


def within_scope(calibration: Calibration, scope: Sequence[Capability]) -> tuple[Calibration, Mapping[str, str]]:
    """A calibration with no U of the linear model below the CMC, and what is to be said of its parameters, by name,
    whose U is the CMC or that are outside the scope; as it is without a scope."""
    if not scope:
        return calibration, {}
    said, added, measured = {}, np.zeros(len(calibration.parameters)), measured_range(calibration)
    over_temperature = set(changing(calibration)) if measured is not None else set()
    for i, p in enumerate(calibration.parameters):
        if beyond_linear(p.name):
            continue
        about = [(len(entry.quantity), cmc) for entry in scope if (cmc := entry.least(p)) is not None]
        U = expanded(p)
        if not about:
            said[p.name] = OUTSIDE
        if not about or U is None or p.k is None:
            continue
        least = max(about)[1]  # of the entry with the longest name, which goes before
        if measured is not None and p.name in over_temperature:
            bands = curve(calibration, p.name, measured.temperatures()).expanded
            U = U if bands is None else min(U, float(bands.min()))
        if least > U:
            said[p.name], added[i] = CMC, least**2 / 4.0 - (U / p.k) ** 2
    parameters = tuple(
        replace(p, u=math.sqrt((p.u or 0.0) ** 2 + more), dof=None) if more > 0.0 else p
        for p, more in zip(calibration.parameters, added.tolist(), strict=True)
    )
    contributions = {p.name: math.sqrt(more) for p, more in zip(parameters, added.tolist(), strict=True) if more > 0.0}
    words = "capability of the laboratory (CMC)"
    budget = calibration.evidence.budget
    capability = SourceContributions(name="capability", words=words, type="B", contributions=contributions)
    stated = replace(
        calibration,
        parameters=parameters,
        covariance=None if calibration.covariance is None else calibration.covariance + np.diag(added),
        evidence=replace(calibration.evidence, budget=(*budget, capability) if budget and contributions else budget),
    )
    return stated, said
