"""Statements of conformity of a calibration with acceptance limits.

The decision rule is DECISION_RULE. With the limits low, high and the expanded uncertainty U = t₉₅.₄₅(ν) u:

    pass                low + U ≤ value ≤ high − U
    conditional pass    inside the limits, but by less than U
    conditional fail    outside by no more than U
    fail                outside by more than U

The risk of a statement is the probability that it is wrong. The true value is taken to be distributed as Student's t
with ν degrees of freedom about the value, scaled by u. With its distribution function F,

    p = F((high − value)/u) − F((low − value)/u)

is the probability of conformity; a value judged inside is outside with the risk 1 − p, one judged outside is inside
with the risk p. After "pass" 1 − p is at most 2.3 % for each limit. If all values were judged inside, the risk that not
all are is at most the sum of their risks; if some were judged outside, the risk that all are inside is at most the
smallest of their risks.

Source: ILAC-G8:09/2019, 4.2.3 (guard band w = U on either side of a limit, JCGM 106:2012, 8.3); JCGM 106:2012, 7.4
(probability of conformity), 9.3.2 (specific risk).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, get_args

import numpy as np
import scipy

from tumble.lab.limits import OCCASIONS, Limits, Occasion
from tumble.recording.session.document import UNKNOWN_SITE_GRAVITY_U
from tumble.result.accepted import accepted_kinds, accepted_part
from tumble.result.calibration import Calibration
from tumble.result.coverage import expanded_of, welch_satterthwaite
from tumble.result.parts import Parameter
from tumble.sensors.parameters import group_name, group_of, name_covers
from tumble.units import two_digits

DECISION_RULE = (
    "decision rule: pass where the value is inside its limits by at least U (95.45 %), conditional pass where it is "
    "inside by less, conditional fail where it is outside by no more than U, fail where it is outside by more (guard "
    "band w = U: ILAC-G8:09/2019, 4.2.3)"
)
RISK_DEFINITION = (
    "risk: the probability that the statement on a value is wrong, that it is outside where it is said to be inside, "
    "or inside where it is said to be outside, by the uncertainty of this calibration (JCGM 106:2012, 9.3.2)"
)
Result = Literal["fail", "undecided", "conditional fail", "conditional pass", "pass"]
RESULTS_WORST_FIRST: tuple[Result, ...] = get_args(Result)
"""A parameter without a value or without U, or that changed while it was recorded, is undecided."""
SMALLEST_RISK = 1e-4  # smaller ones depend on the far tails of a distribution that is only a model


@dataclass(frozen=True, kw_only=True, slots=True)
class LimitJudgement:
    """A parameter (SI) judged by its limits. The value is None if the parameter was not determined; `unsteady` is
    whether it changed while it was recorded."""

    json_fields: ClassVar = ("name", "unit", "value", "expanded", "low", "high", "result", "risk")

    name: str
    unit: str
    value: float | None = None
    u: float | None = None
    dof: float | None = None
    low: float
    high: float
    unsteady: bool = False

    @property
    def expanded(self) -> float | None:
        """Expanded uncertainty U."""
        return None if self.u is None else expanded_of(self.u, self.dof)

    @property
    def result(self) -> Result:
        """The result by the decision rule; undecided without a value or U."""
        if self.value is None or self.expanded is None or self.unsteady:
            return "undecided"
        inside = min(self.value - self.low, self.high - self.value)
        if inside >= 0.0:
            return "pass" if inside >= self.expanded else "conditional pass"
        return "conditional fail" if inside >= -self.expanded else "fail"

    @property
    def risk(self) -> float | None:
        """Probability that the result is wrong; None if it is undecided."""
        if self.value is None or self.result == "undecided":
            return None
        if not self.u:
            return 0.0
        ends = np.array([self.low - self.value, self.value - self.high]) / self.u
        outside = float(scipy.special.stdtr(math.inf if self.dof is None else self.dof, ends).sum())
        return outside if self.result.endswith("pass") else max(1.0 - outside, 0.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class Verdict:
    """The judgements on all parameters that have a limit, in the `frame` of the limits."""

    json_fields: ClassVar = ("occasion", "frame", "result", "risk", "reasons", "judgements")

    occasion: Occasion
    frame: str
    judgements: tuple[LimitJudgement, ...]

    @property
    def result(self) -> Result:
        """The worst of the results."""
        return min((j.result for j in self.judgements), key=RESULTS_WORST_FIRST.index)

    @property
    def risk(self) -> float | None:
        """Upper bound of the probability that the result is wrong; None if it is undecided."""
        if self.result == "undecided":
            return None
        if self.result.endswith("pass"):
            return min(sum(j.risk or 0.0 for j in self.judgements), 1.0)
        return min(j.risk for j in self.judgements if j.result.endswith("fail") and j.risk is not None)

    @property
    def risk_sentence(self) -> str:
        """The risk as a sentence with a leading blank; empty if the result is undecided."""
        if self.risk is None:
            return ""
        return f" Risk of the verdict “{self.result}” as a whole: at most {risk_text(max(self.risk, SMALLEST_RISK))}."

    @property
    def reasons(self) -> list[str]:
        """Names of the parameters that do not pass, by result, or by the cause if they are undecided."""
        names: dict[str, list[str]] = {"fail": [], "conditional fail": [], "conditional pass": [], "without U": []}
        for j in self.judgements:
            result: str = j.result
            if result == "undecided" and j.expanded is not None:
                result = "changed while it was recorded"
            elif result == "undecided":
                result = "not determined" if j.value is None else "without U"
            names.setdefault(result, []).append(j.name)
        return [f"{result}: {', '.join(each)}" for result, each in names.items() if each and result != "pass"]


def judge_calibration(calibration: Calibration, limits: Limits) -> list[Verdict]:
    """Judge a calibration in each check that has limits.

    Sensors that are not accepted count as not determined, and parameters that changed are undecided. Raises
    CalibrationError if it cannot be converted to the frame of the limits. U of scale factors in gravity at the place
    includes what is not known of it."""
    judged = (judge_check(calibration, limits, occasion) for occasion in OCCASIONS)
    return [verdict for verdict in judged if verdict is not None]


def judge_check(calibration: Calibration, limits: Limits, occasion: Occasion) -> Verdict | None:
    """Judge a calibration in one check; None if that has no limits. Raises as `judge_calibration`."""
    accepted = accepted_kinds(calibration)
    if len(accepted) == 1:
        calibration = accepted_part(calibration)
    calibration = calibration.in_frame(limits.frame)
    unobservable, parameters = calibration.outcome.unobservable, calibration.parameters
    if not accepted:
        unobservable, parameters = (*calibration, *unobservable), ()
    site = calibration.provenance.site
    if site is not None and site.gravity_is_unit:  # limits are in SI
        parameters = tuple(_with_unknown_gravity(p, UNKNOWN_SITE_GRAVITY_U / site.gravity) for p in parameters)
    unsteady = {p.name for p in parameters if calibration.outcome.is_unsteady(group_name(p.name))}
    return judge_parameters(limits, occasion, parameters, unobservable, unsteady)


def _with_unknown_gravity(p: Parameter, relative_u: float) -> Parameter:
    """Add the relative standard uncertainty of gravity to u if the parameter is a scale factor of an accelerometer."""
    if not p.u or group_name(p.name) != "accel.scale":
        return p
    dof = welch_satterthwaite([(p.u**2, p.dof), (relative_u**2, None)])
    return replace(p, u=math.hypot(p.u, relative_u), dof=dof)


def judge_parameters(
    limits: Limits,
    occasion: Occasion,
    parameters: Sequence[Parameter],
    unobservable: Sequence[str] = (),
    unsteady: Collection[str] = (),
) -> Verdict | None:
    """Judge parameters in the frame of the limits, except the `unsteady` ones; None if the check has no limits.

    Parameters with a limit that were not determined do not pass: those that are `unobservable`, and groups without any
    parameter."""
    if occasion not in limits.checks:
        return None
    determined = {p.name: {"unit": p.unit, "value": p.value, "u": p.u, "dof": p.dof} for p in parameters}
    names = [*determined, *unobservable]
    names += [key for key in getattr(limits, occasion) if not any(name_covers(key, name) for name in names)]
    judgements = []
    for name in names:
        if (interval := limits.of(name, occasion)) is not None:
            known: dict[str, Any] = determined.get(name) or {"unit": group_of(name).unit}
            low, high = interval
            judgements.append(LimitJudgement(name=name, low=low, high=high, unsteady=name in unsteady, **known))
    return Verdict(occasion=occasion, frame=limits.frame, judgements=tuple(judgements))


def risk_text(risk: float | None) -> str:
    """Return a risk in per cent, to two digits; empty for None."""
    if risk is None:
        return ""
    return f"< {100.0 * SMALLEST_RISK:g} %" if risk < SMALLEST_RISK else f"{two_digits(100.0 * risk)} %"
