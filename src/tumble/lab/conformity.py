"""What acceptance limits say of a calibration.

The decision rule is RULE. With the limits low, high and the expanded uncertainty U = t₉₅.₄₅(ν) u:

    pass                inside the limits by at least U: low + U ≤ value ≤ high − U
    conditional pass    inside by less
    conditional fail    outside by no more than U
    fail                outside by more

The risk of a statement is the probability that it is wrong, of a true value that the calibration alone tells of:
Student's t with ν degrees of freedom about the value, scaled by u. With F its distribution function,

    p = F((high − value)/u) − F((low − value)/u)

is the probability of conformity; a value that is said to be inside is outside with the risk 1 − p, one that is said to
be outside is inside with the risk p. After "pass" 1 − p is at most 2.3 % for each limit. That all values are inside is
wrong with at most the sum of the risks; that not all are, with at most the least of those that are said to be outside.

Source: ILAC-G8:09/2019, 4.2.3 (guard band w = U on either side of a limit, JCGM 106:2012, 8.3); JCGM 106:2012, 7.4
(probability of conformity), 9.3.2 (specific risk).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

import numpy as np
import scipy

from tumble.lab.limits import OCCASIONS, Limits, Occasion
from tumble.result.accepted import accepted_kinds, accepted_part
from tumble.result.calibration import Calibration
from tumble.result.coverage import expanded_of
from tumble.result.parts import Parameter
from tumble.sensors.parameters import group_of, name_covers
from tumble.units import two_digits

RULE = (
    "decision rule: pass where the value is inside its limits by at least U (95.45 %), conditional pass where it is "
    "inside by less, conditional fail where it is outside by no more than U, fail where it is outside by more (guard "
    "band w = U: ILAC-G8:09/2019, 4.2.3)"
)
RISK = (
    "risk: the probability that the statement on a value is wrong, that it is outside where it is said to be inside, "
    "or inside where it is said to be outside, as far as this calibration tells (JCGM 106:2012, 9.3.2)"
)
Result = Literal["fail", "undecided", "conditional fail", "conditional pass", "pass"]
RESULTS: tuple[Result, ...] = get_args(Result)
"""The worst first; undecided is what has no value or no U."""
LEAST_RISK = 1e-4
"""A smaller risk is not stated: it is one of a model of distributions far from their middle."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LimitJudgement:
    """A parameter (SI) against its limits; `expanded` is U, `risk` the probability that the result is wrong. A
    parameter that was not determined has no value."""

    name: str
    unit: str
    value: float | None
    expanded: float | None
    low: float
    high: float
    result: Result
    risk: float | None


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdict:
    """Every parameter that has a limit, judged in the frame of the limits."""

    json_fields: ClassVar = ("occasion", "frame", "result", "risk", "reasons", "judgements")

    occasion: Occasion
    frame: str
    judgements: tuple[LimitJudgement, ...]

    @property
    def result(self) -> Result:
        """The worst of the results."""
        return min((j.result for j in self.judgements), key=RESULTS.index)

    @property
    def risk(self) -> float | None:
        """The largest probability that the result is wrong; None where it is undecided."""
        if self.result.endswith("pass"):
            return min(sum(j.risk or 0.0 for j in self.judgements), 1.0)
        outside = [j.risk for j in self.judgements if j.result.endswith("fail") and j.risk is not None]
        return min(outside, default=None)

    @property
    def whole_risk(self) -> str:
        """The risk as a sentence after others; nothing where the result is undecided."""
        if self.risk is None:
            return ""
        return f" Risk of the verdict “{self.result}” as a whole: at most {in_percent(max(self.risk, LEAST_RISK))}."

    @property
    def reasons(self) -> list[str]:
        """Which parameters do not pass, and why, in words."""
        groups: dict[str, list[str]] = {"fail": [], "conditional fail": [], "conditional pass": [], "without U": []}
        for j in self.judgements:
            undecided = "not determined" if j.value is None else "without U"
            groups.setdefault(undecided if j.result == "undecided" else j.result, []).append(j.name)
        return [f"{what}: {', '.join(names)}" for what, names in groups.items() if names and what != "pass"]


def verdicts(calibration: Calibration, limits: Limits) -> list[Verdict]:
    """What the limits say of a calibration, for each check that they are for. Of one whose accelerometers or gyros
    alone are accepted, the others are not determined.

    Raises CalibrationError where it cannot be taken to the frame of the limits."""
    every = (verdict_at(calibration, limits, occasion) for occasion in OCCASIONS)
    return [verdict for verdict in every if verdict is not None]


def verdict_at(calibration: Calibration, limits: Limits, occasion: Occasion) -> Verdict | None:
    """What the limits say of a calibration at a check; None where they have none for it. Raises as `verdicts`."""
    if len(accepted_kinds(calibration)) == 1:
        calibration = accepted_part(calibration)
    calibration = calibration.in_frame(limits.frame)
    return judge(limits, occasion, calibration.parameters, calibration.outcome.unobservable)


def judge(
    limits: Limits, occasion: Occasion, parameters: Sequence[Parameter], unobservable: Sequence[str] = ()
) -> Verdict | None:
    """The verdict on the parameters of a calibration in the frame of the limits; None where the limits have none for
    such a check. Parameters that have a limit and were not determined do not pass: those that the calibration calls
    `unobservable`, and a kind without any parameter."""
    by_key = limits.checks.get(occasion)
    if not by_key:
        return None
    values = {p.name: p for p in parameters}
    named = [*values, *unobservable]
    judged = []
    for name in [*named, *(key for key in by_key if not any(name_covers(key, each) for each in named))]:
        ends = limits.of(name, occasion)
        if ends is None:
            continue
        p = values.get(name)
        value, u, dof = (None, None, None) if p is None else (p.value, p.u, p.dof)
        result = "undecided" if value is None else judge_value(value, u, *ends, dof=dof)
        judgement = LimitJudgement(
            name=name,
            unit=group_of(name).unit if p is None else p.unit,
            value=value,
            expanded=None if u is None else expanded_of(u, dof),
            low=ends[0],
            high=ends[1],
            result=result,
            risk=None if value is None or u is None else _risk(result, value, u, *ends, dof),
        )
        judged.append(judgement)
    return Verdict(occasion=occasion, frame=limits.frame, judgements=tuple(judged))


def judge_value(value: float, u: float | None, low: float, high: float, dof: float | None = None) -> Result:
    """The verdict on a value with its standard uncertainty and degrees of freedom (module docstring); undecided without
    one, or with too few for a U."""
    U = None if u is None else expanded_of(u, dof)
    if U is None:
        return "undecided"
    inside = min(value - low, high - value)
    if inside >= 0.0:
        return "pass" if inside >= U else "conditional pass"
    return "conditional fail" if inside >= -U else "fail"


def _risk(result: Result, value: float, u: float, low: float, high: float, dof: float | None) -> float | None:
    """The probability that the result on a value is wrong; None where it is undecided."""
    if result == "undecided" or u == 0.0:
        return None if result == "undecided" else 0.0
    ends = np.array([low - value, value - high]) / u
    outside = float(scipy.special.stdtr(math.inf if dof is None else dof, ends).sum())
    return outside if result.endswith("pass") else max(1.0 - outside, 0.0)


def in_percent(risk: float | None) -> str:
    """A risk in per cent, to two digits; nothing where there is none."""
    if risk is None:
        return ""
    return f"< {100.0 * LEAST_RISK:g} %" if risk < LEAST_RISK else f"{two_digits(100.0 * risk)} %"
