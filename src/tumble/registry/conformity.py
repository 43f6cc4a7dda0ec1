"""What acceptance limits say of a calibration, at its reference temperature or at every temperature between two.

Over temperature a bias or a scale factor is the whole sum θ + θ₁ (T − T₀) + θ₂ (T − T₀)² with U of the sum
(`tumble.calibration.temperature_curves`). It is judged at the temperature where it is worst: where it fails, else where
it is nearest to failing. What was not measured passes nowhere: beyond the range of the rests there is no U. Other
parameters are the same at all temperatures.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tumble.calibration.calibration_file import Calibration
from tumble.calibration.half import accepted_kinds, accepted_part
from tumble.calibration.temperature_curves import Range, changing, curve, measured_range
from tumble.registry.limits import LimitJudgement, Limits, Result, Verdict, judge, result_inside
from tumble.registry.records import OCCASIONS, Occasion, parameter_rows
from tumble.sensors.parameters import FURTHER, group_name
from tumble.units import Array

STEP = 0.25
"""K, between the temperatures at which a parameter is judged."""
SLACK = 1.0
"""K: so near to an end of the wanted temperatures a rest counts as being there."""
CHANGING = {group.base for group in FURTHER if group.variable == "temperature"}
"""The groups of parameters that may change with temperature."""


def verdicts(calibration: Calibration, limits: Limits) -> list[Verdict]:
    """What the limits say of a calibration, for each check that they are for. Of one whose accelerometers or gyros
    alone are accepted, the others are not determined.

    Raises CalibrationError where it cannot be taken to the frame of the limits."""
    found = [verdict_at(calibration, limits, occasion) for occasion in OCCASIONS if limits.checks.get(occasion)]
    return [verdict for verdict in found if verdict is not None]


def verdict_at(calibration: Calibration, limits: Limits, occasion: Occasion) -> Verdict | None:
    """What the limits say of a calibration at a check; None where they have none for it. Raises as `verdicts`."""
    if len(accepted_kinds(calibration)) == 1:
        calibration = accepted_part(calibration)
    if calibration.frame != limits.frame:
        calibration = calibration.in_frame(limits.frame)
    verdict = judge(limits, occasion, list(parameter_rows(calibration.parameters)), calibration.outcome.unobservable)
    return None if verdict is None else over_temperature(verdict, calibration, limits)


def over_temperature(verdict: Verdict, calibration: Calibration, limits: Limits) -> Verdict:
    """The verdict at every temperature between which the limits hold; the same where these are not given."""
    wanted, measured = limits.temperatures, measured_range(calibration)
    if wanted is None:
        return verdict
    known = set(changing(calibration))
    judged = tuple(
        _worst(one, calibration, wanted, measured, known=one.name in known)
        if one.value is not None and group_name(one.name) in CHANGING
        else one
        for one in verdict.judgements
    )
    return replace(verdict, judgements=judged, temperatures=wanted, unmeasured=_unmeasured(wanted, measured))


def _unmeasured(wanted: tuple[float, float], measured: Range | None) -> str:
    """Which of the wanted temperatures were not measured, in words."""
    low, high = wanted
    if measured is None or measured.low >= high or measured.high <= low:
        return f"from {_celsius(low)} to {_celsius(high)} °C"
    gaps = [(low, measured.low)] if measured.low > low + SLACK else []
    gaps += [(measured.high, high)] if measured.high < high - SLACK else []
    return " and ".join(f"from {_celsius(a)} to {_celsius(b)} °C" for a, b in gaps)


def _worst(
    one: LimitJudgement, calibration: Calibration, wanted: tuple[float, float], measured: Range | None, *, known: bool
) -> LimitJudgement:
    """A parameter judged where it is worst; undecided where it would not fail and not all was measured."""
    beyond = not known or bool(_unmeasured(wanted, measured))
    if known and measured is not None and max(wanted[0], measured.low) < min(wanted[1], measured.high):
        at = _temperatures(max(wanted[0], measured.low), min(wanted[1], measured.high))
        one = _judged(one, at, *_values(calibration, one.name, at))
    if beyond and one.result in ("pass", "conditional pass"):
        return replace(one, result="undecided", beyond=True)
    return one


def _values(calibration: Calibration, name: str, at: Array) -> tuple[Array, Array | None]:
    found = curve(calibration, name, at)
    return found.value, found.expanded


def _judged(one: LimitJudgement, at: Array, value: Array, expanded: Array | None) -> LimitJudgement:
    """The judgement at the worst of temperatures (N,) with values (N,) and U (N,)."""
    U = np.zeros(len(at)) if expanded is None else expanded
    inside = np.minimum(value - one.low, one.high - value)
    outside = inside + U if np.any(inside < -U) else inside if np.any(inside < 0.0) else inside - U
    i = int(np.argmin(outside))
    result: Result = "undecided" if expanded is None else result_inside(float(inside[i]), float(U[i]))
    return replace(
        one,
        value=float(value[i]),
        expanded=None if expanded is None else float(U[i]),
        result=result,
        at=float(at[i]),
    )


def _temperatures(low: float, high: float) -> Array:
    return np.linspace(low, high, max(int(np.ceil((high - low) / STEP)), 1) + 1)


def _celsius(value: float) -> str:
    return f"{value:.1f}".replace("-", "−")
