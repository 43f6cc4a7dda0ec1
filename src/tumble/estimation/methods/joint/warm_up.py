"""A warm-up without a thermometer: biases that settle exponentially after the start, with one time constant."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from tumble.estimation.likelihood import WARMING, Problem
from tumble.estimation.methods.joint.fit import TOTAL, Fitted, fit_of
from tumble.estimation.methods.joint.time_constants import TimeConstants, settling_with, without_own
from tumble.estimation.methods.joint.wandering import with_wandering
from tumble.sensors.parameters import Variable
from tumble.units import Array

UNEXPLAINED = 1e-4
"""Where chance alone exceeds all residuals, by the noise within rests, less often, a warm-up is looked for."""
WARM_UPS = np.geomspace(0.03, 1.0, 11)
"""Its time constants that are tried, in parts of the session; the first and the last belong to none."""
SPAN = 0.01, 3.0
"""And within which the most likely one is sought, likewise."""
NEAR = 0.2
"""A change of the logarithm of a time constant over which its likelihood is a parabola."""
FARTHEST = 0.5
"""And the largest change by one parabola."""
SETTLED_TO = 0.2
"""Of its u: by how much it may still move."""
WARM_UP_ROUNDS = 5
MOST_HELD = 0.6
"""Of the distance to the most likely time constant: what priors and scatter of another one keep at most."""
TIME_CONSTANT_KNOWN = 0.5
"""u of the logarithm of a time constant: what is known less well is no warm-up that is seen."""
EVIDENT = 40.0
"""−2 log of the likelihood without a warm-up over that with it: beyond doubt."""
CURVED = 0.0
"""The same without its square over that with it: the likelier of two that both warm."""


def with_warm_up(fitted: Fitted, problem: Problem) -> Fitted:
    """The solution with biases and scale factors that settle exponentially after the start, where that makes a session
    that the noise within rests does not explain far more likely; else that without. A device that warms exponentially
    has, beside e^(−t/τ), its square where these are no straight lines over temperature. What is not known of the time
    constant τ is in the covariance:

        C = C(τ) + (∂θ/∂ log τ)(∂θ/∂ log τ)ᵀ u²(log τ)"""
    first = _time_constant(fitted, problem)
    straight = None if first is None else _warmed(fitted, problem, WARMING[:1], first)
    longest = WARM_UPS[-1] * np.ptp(problem.observations.rests.start)
    if straight is None or straight.settling > longest or fitted.evidence - straight.evidence < EVIDENT:
        return with_wandering(fitted)
    curved = _curved(straight, problem)
    if curved is None or straight.evidence - curved.evidence < CURVED:
        return _apart(straight, problem, WARMING[:1]).spread
    return _apart(curved, problem, WARMING).spread


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Warmed:
    """A solution with a warm-up of a time constant, s, and what a standard deviation of its logarithm makes of gravity
    and the parameters (1 + m,)."""

    fitted: Fitted
    settling: float
    by: Array

    @property
    def evidence(self) -> float:
        """−2 log of the likelihood of the session."""
        return self.fitted.evidence

    @property
    def spread(self) -> Fitted:
        """The solution with what is not known of the time constant in its covariance."""
        solved = self.fitted.solved
        step = replace(solved.step, covariance=solved.step.covariance + np.outer(self.by, self.by))
        return replace(self.fitted, solved=replace(solved, step=step))


def _curved(straight: _Warmed, problem: Problem) -> _Warmed | None:
    """The solution with the square of the exponential too; None where that is far less likely, by the solution without
    it to begin with."""
    of_all = _time_constants(straight.fitted, problem)
    alone, both = (
        of_all.deviance(straight.settling, settling_with(problem, straight.settling, variables))
        for variables in (WARMING[:1], WARMING)
    )
    if both - alone > EVIDENT:
        return None
    hopeless = straight.evidence + EVIDENT
    return _warmed(straight.fitted, problem, WARMING, straight.settling, TIME_CONSTANT_KNOWN, hopeless)


def _apart(warmed: _Warmed, problem: Problem, variables: tuple[Variable, ...]) -> _Warmed:
    """The same with a scatter of their own for sensors that wander, without which the time constant is sought again:
    one that jumps among the first rests may be taken for a device that settles sooner."""
    apart = with_wandering(warmed.fitted)
    if apart is warmed.fitted:
        return warmed
    of_all, warm = _time_constants(apart, problem), settling_with(problem, warmed.settling, variables)
    tried = [warmed.settling, *(WARM_UPS * np.ptp(problem.observations.rests.start)).tolist()]
    first = min(tried, key=lambda each: of_all.deviance(each, warm))
    return _warmed(apart, problem, variables, first) or replace(warmed, fitted=apart)


def _warmed(
    fitted: Fitted,
    problem: Problem,
    variables: tuple[Variable, ...],
    first: float,
    known: float = np.inf,
    hopeless: float = np.inf,
) -> _Warmed | None:
    """The solution with a warm-up of the most likely time constant, sought from the first one, of which the logarithm
    is `known` to so much; None where there is none, and where by the first one −2 log of the likelihood is `hopeless`:
    no other one makes up for that."""
    tried, found, wandering = [first], fitted, fitted.problem.wandering
    closest = list[float]()
    while True:
        warm = replace(settling_with(problem, tried[-1], variables), wandering=wandering)
        found = fit_of(warm, without_own(warm, found.solved), guess=found.scatter)
        if not closest and found.evidence > hopeless:
            return None
        likeliest = _closest(_time_constants(found, problem), tried[-1], found.problem, (first, known))
        if likeliest is None:
            return None
        settling, u, by = likeliest
        closest.append(settling)
        if abs(np.log(settling / tried[-1])) < SETTLED_TO * u or len(tried) == WARM_UP_ROUNDS:
            return _Warmed(fitted=found, settling=settling, by=by)
        tried.append(_further(tried, closest))


def _further(tried: list[float], closest: list[float]) -> float:
    """The time constant, s, at which a solution has itself for the most likely one, as if the logarithms of these that
    are `closest` were linear in those of the solutions that were `tried`: priors and scatter of each hold to its
    own."""
    x, y = np.log(tried[-2:]), np.log(closest[-2:])
    held = float(np.clip(np.diff(y)[0] / np.diff(x)[0], 0.0, MOST_HELD)) if len(x) > 1 else 0.0
    return float(np.exp(y[-1] + held / (1.0 - held) * (y[-1] - x[-1])))


def _time_constants(fitted: Fitted, problem: Problem) -> TimeConstants:
    """What a solution says of the time constants that come into question."""
    span = np.ptp(problem.observations.rests.start)
    return TimeConstants.of(fitted, problem, (SPAN[0] * span, SPAN[1] * span))


def _time_constant(fitted: Fitted, problem: Problem) -> float | None:
    """The time constant, s, of the warm-up that goes best with a solution without one; None where none is needed, where
    a thermometer says more, and where what goes best is none that begins and ends within the session."""
    rests, total = problem.observations.rests, fitted.fits[TOTAL]
    explained = special.chdtrc(max(total.degrees, 1.0), total.chi_square) > UNEXPLAINED
    unknown = "accel.bias.warmup" not in problem.observations.usual
    one = len(rests.start) < 2
    if explained or unknown or one or rests.temperatures is not None or rests.file[0] != rests.file[-1]:
        return None
    tried = (WARM_UPS * np.ptp(rests.start)).tolist()
    of_all, warm = _time_constants(fitted, problem), settling_with(problem, tried[0], WARMING[:1])
    best = int(np.argmin([of_all.deviance(each, warm) for each in tried]))
    return tried[best] if 0 < best < len(tried) - 1 else None


def _closest(
    of_all: TimeConstants, settling: float, warm: Problem, prior: tuple[float, float]
) -> tuple[float, float, Array] | None:
    """The most likely time constant, s, with the scatter and the priors of a solution with one, by parabolas of the
    likelihood over its logarithm, of which another one and its u are known before; u of the logarithm, and what that
    makes of gravity and the parameters (1 + m,). None where there is none."""
    u, near = np.inf, np.array([-NEAR, 0.0, NEAR])
    for _ in range(WARM_UP_ROUNDS):
        off = np.log(settling / prior[0]) + near
        deviances = [of_all.deviance(each, warm) for each in settling * np.exp(near)]
        shorter, here, longer = (np.array(deviances) + (off / prior[1]) ** 2).tolist()
        bend = (shorter - 2.0 * here + longer) / NEAR**2
        if bend <= 2.0 * TIME_CONSTANT_KNOWN**-2:
            return None
        u = float(np.sqrt(2.0 / bend))
        moved = float(np.clip(0.5 * (shorter - longer) / (NEAR * bend), -FARTHEST, FARTHEST))
        last, settling = settling, settling * float(np.exp(moved))
        if abs(moved) < SETTLED_TO * u:
            break
    shorter_by, longer_by = (of_all.values(last * float(np.exp(h)), warm) for h in (-NEAR, NEAR))
    return settling, u, u * (longer_by - shorter_by) / (2.0 * NEAR)
