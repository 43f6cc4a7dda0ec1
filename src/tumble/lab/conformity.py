"""What acceptance limits say of a calibration, at its reference temperature or at every temperature between two.

The decision rule is RULE. With the limits low, high and the expanded uncertainty U = t₉₅.₄₅(ν) u:

    pass                inside the limits by at least U: low + U ≤ value ≤ high − U
    conditional pass    inside by less
    conditional fail    outside by no more than U
    fail                outside by more

Over temperature a bias or a scale factor is the whole sum θ + θ₁ (T − T₀) + θ₂ (T − T₀)² with U of the sum
(`tumble.result.temperature_curves`). It is judged at the temperature where it is worst: where it fails, else where
it is nearest to failing. What was not measured passes nowhere: beyond the range of the rests there is no U. Other
parameters are the same at all temperatures.

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
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Literal, get_args

import numpy as np
import scipy

from tumble.lab.limits import OCCASIONS, Limits, Occasion
from tumble.result.accepted import accepted_kinds, accepted_part
from tumble.result.calibration import Calibration
from tumble.result.coverage import expanded, expanded_of
from tumble.result.parts import Parameter, stated_factor
from tumble.result.temperature_curves import changing, curve, measured_range
from tumble.sensors.parameters import FURTHER, group_name, group_of, meant_by
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
"""The worst first; undecided is what has no value or no U, or was not measured at all temperatures."""
_OF_A_VALUE: tuple[Result, ...] = ("fail", "conditional fail", "conditional pass")
_INSIDE, _OUTSIDE = ("pass", "conditional pass"), ("fail", "conditional fail")

LEAST_RISK = 1e-4
"""A smaller risk is not stated: it is one of a model of distributions far from their middle."""
STEP = 0.25
"""K, between the temperatures at which a parameter is judged."""
SLACK = 1.0
"""K: so near to an end of the wanted temperatures a rest counts as being there."""
CHANGING = {group.base for group in FURTHER if group.variable == "temperature"}
"""The groups of parameters that may change with temperature."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LimitJudgement:
    """A parameter (SI) against its limits; `expanded` is U, `risk` the probability that the result is wrong. A
    parameter that was not determined has no value. Over temperature it is that `at` the temperature, °C, where it is
    worst; `beyond` says that not all temperatures were measured."""

    name: str
    unit: str
    value: float | None
    expanded: float | None
    low: float
    high: float
    result: Result
    risk: float | None = None
    at: float | None = None
    beyond: bool = False

    @property
    def named(self) -> str:
        """The parameter, with the temperature at which it is worst."""
        return self.name if self.at is None else f"{self.name} at {self.at:.1f} °C".replace("at -", "at −")


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdict:
    """Every parameter that has a limit, judged in the frame of the limits; over the `temperatures`, °C, between which
    these hold, and what of them was not measured, in words."""

    json_fields: ClassVar = ("occasion", "frame", "result", "risk", "reasons", "judgements")

    occasion: Occasion
    frame: str
    judgements: tuple[LimitJudgement, ...]
    temperatures: tuple[float, float] | None = None
    unmeasured: str = ""

    @property
    def over(self) -> str:
        """Between which temperatures a verdict stands, in words; nothing where it is that at the reference."""
        if self.temperatures is None:
            return ""
        low, high = (f"{end:g}".replace("-", "−") for end in self.temperatures)
        return (
            f"{'within limits' if self.result == 'pass' else 'not shown to be within limits'} from {low} to {high} °C"
        )

    @property
    def result(self) -> Result:
        """The worst of the results."""
        return min((j.result for j in self.judgements), key=RESULTS.index)

    @property
    def risk(self) -> float | None:
        """The largest probability that the result is wrong; None where it is undecided."""
        risks = {j.name: j.risk for j in self.judgements if j.risk is not None}
        if self.result in _INSIDE:
            return min(sum(risks.values()), 1.0)
        outside = [j.risk for j in self.judgements if j.result in _OUTSIDE and j.risk is not None]
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
        unmeasured = f"not measured {self.unmeasured}" if self.unmeasured else "not known over temperature"
        undecided = [j for j in self.judgements if j.result == "undecided"]
        groups: dict[str, list[LimitJudgement]] = {
            **{worse: [j for j in self.judgements if j.result == worse] for worse in _OF_A_VALUE},
            unmeasured: [j for j in undecided if j.beyond],
            "without U": [j for j in undecided if j.expanded is None and j.value is not None and not j.beyond],
            "not determined": [j for j in undecided if j.value is None],
        }
        return [f"{what}: {', '.join(j.named for j in judged)}" for what, judged in groups.items() if judged]


def verdicts(calibration: Calibration, limits: Limits) -> list[Verdict]:
    """What the limits say of a calibration, for each check that they are for. Of one whose accelerometers or gyros
    alone are accepted, the others are not determined.

    Raises CalibrationError where it cannot be taken to the frame of the limits."""
    every = (verdict_at(calibration, limits, occasion) for occasion in OCCASIONS if limits.checks.get(occasion))
    return [verdict for verdict in every if verdict is not None]


def verdict_at(calibration: Calibration, limits: Limits, occasion: Occasion) -> Verdict | None:
    """What the limits say of a calibration at a check; None where they have none for it. Raises as `verdicts`."""
    if len(accepted_kinds(calibration)) == 1:
        calibration = accepted_part(calibration)
    if calibration.frame != limits.frame:
        calibration = calibration.in_frame(limits.frame)
    verdict = judge(limits, occasion, calibration.parameters, calibration.outcome.unobservable)
    return None if verdict is None else over_temperature(verdict, calibration, limits)


def judge(
    limits: Limits, occasion: Occasion, parameters: Sequence[Parameter], unobservable: Sequence[str] = ()
) -> Verdict | None:
    """The verdict on the parameters of a calibration in the frame of the limits; None where the limits have none for
    such a check. Parameters that have a limit and were not determined do not pass: those that the calibration calls
    `unobservable`, and a kind without any parameter."""
    by_key = limits.checks.get(occasion)
    if not by_key:
        return None
    values = [
        (p.name, p.unit, p.value, expanded(p), p.dof) for p in parameters if limits.of(p.name, occasion) is not None
    ]
    named = [*unobservable, *(p.name for p in parameters)]
    missing = [name for name in unobservable if limits.of(name, occasion) is not None]
    missing += [key for key in by_key if not any(meant_by(key, name) for name in named)]
    judged = []
    for name, unit, value, U, dof in [*values, *((name, group_of(name).unit, None, None, None) for name in missing)]:
        low, high = limits.of(name, occasion) or (-math.inf, math.inf)
        judgement = LimitJudgement(
            name=name, unit=unit, value=value, expanded=U, low=low, high=high, result=_result(value, U, low, high)
        )
        judged.append(replace(judgement, risk=_risk(judgement, dof)))
    return Verdict(occasion=occasion, frame=limits.frame, judgements=tuple(judged))


def judge_value(value: float, u: float | None, low: float, high: float, dof: float | None = None) -> Result:
    """The verdict on a value with its standard uncertainty and degrees of freedom (module docstring); undecided without
    one, with too few for a U, or where a limit is not a number."""
    return _result(value, None if u is None else expanded_of(u, dof), low, high)


def _result(value: float | None, U: float | None, low: float, high: float) -> Result:
    if value is None or U is None or math.isnan(low) or math.isnan(high):
        return "undecided"
    inside = min(value - low, high - value)
    if inside >= 0.0:
        return "pass" if inside >= U else "conditional pass"
    return "conditional fail" if inside >= -U else "fail"


def _risk(judgement: LimitJudgement, dof: float | None) -> float | None:
    """The probability that a judgement of a value, whose u has so many degrees of freedom, is wrong; None without U."""
    k, value, U = stated_factor(dof), judgement.value, judgement.expanded
    if k is None or value is None or U is None or judgement.result == "undecided":
        return None
    below, above = judgement.low - value, judgement.high - value
    if U == 0.0:
        return 0.0
    of_t = partial(scipy.special.stdtr, math.inf if dof is None else dof)
    outside = float(of_t(below * k / U) + of_t(-above * k / U))
    return outside if judgement.result in _INSIDE else max(1.0 - outside, 0.0)


def in_percent(risk: float | None) -> str:
    """A risk in per cent, to two digits; nothing where there is none."""
    if risk is None:
        return ""
    return f"< {100.0 * LEAST_RISK:g} %" if risk < LEAST_RISK else f"{two_digits(100.0 * risk)} %"


# -------------------- over temperature --------------------


def over_temperature(verdict: Verdict, calibration: Calibration, limits: Limits) -> Verdict:
    """The verdict at every temperature between which the limits hold; the same where these are not given."""
    if limits.temperatures is None:
        return verdict
    low, high = limits.temperatures
    measured, with_slopes = measured_range(calibration), set(changing(calibration))
    reached = measured is not None and max(low, measured.low) < min(high, measured.high)
    if measured is None or not reached:
        unmeasured = f"from {_celsius(low)} to {_celsius(high)} °C"
    else:
        gaps = [(low, measured.low)] if measured.low > low + SLACK else []
        gaps += [(measured.high, high)] if measured.high < high - SLACK else []
        unmeasured = " and ".join(f"from {_celsius(a)} to {_celsius(b)} °C" for a, b in gaps)
    judged = []
    for judgement in verdict.judgements:
        if judgement.value is not None and group_name(judgement.name) in CHANGING:
            if judgement.name in with_slopes and measured is not None and reached:
                judgement = _worst(judgement, calibration, max(low, measured.low), min(high, measured.high))
            if (unmeasured or judgement.name not in with_slopes) and judgement.result in ("pass", "conditional pass"):
                judgement = replace(judgement, result="undecided", risk=None, beyond=True)
        judged.append(judgement)
    return replace(verdict, judgements=tuple(judged), temperatures=limits.temperatures, unmeasured=unmeasured)


def _worst(judgement: LimitJudgement, calibration: Calibration, low: float, high: float) -> LimitJudgement:
    """A parameter judged at the temperature, °C, between two where it fails by most, or is nearest to failing."""
    celsius = np.linspace(low, high, max(int(np.ceil((high - low) / STEP)), 1) + 1)
    over = curve(calibration, judgement.name, celsius)
    U = np.zeros(len(celsius)) if over.expanded is None else over.expanded
    inside = np.minimum(over.value - judgement.low, judgement.high - over.value)
    i = int(np.argmin(inside + U if np.any(inside < -U) else inside if np.any(inside < 0.0) else inside - U))
    value, U_there = float(over.value[i]), None if over.expanded is None else float(U[i])
    result = _result(value, U_there, judgement.low, judgement.high)
    judgement = replace(judgement, value=value, expanded=U_there, result=result, at=float(celsius[i]))
    return replace(judgement, risk=None if over.degrees is None else _risk(judgement, float(over.degrees[i])))


def _celsius(value: float) -> str:
    return f"{value:.1f}".replace("-", "−")
