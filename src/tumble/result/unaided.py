"""Tilt, heading and position errors of a vehicle without aid, before and after calibration.

The vehicle stands with one axis of the body up, levels itself by its accelerometers, turns to any heading, and is then
navigated by its inertial sensors alone for a time t, without turning. To first order the horizontal errors are

    tilt      φ = f/g + ω t                                                                                      (1)
    heading   ψ = ω_u t                                                                                          (2)
    position  r = ½ (f + g f/g) t² + g ω t³/6                                                                    (3)

f is the horizontal error of the specific force at rest, and ω and ω_u are the errors of the rate about the horizontal
axes and the vertical. Levelling tilts the attitude by f/g; at that heading the component of gravity added by the tilt
cancels f. In the turn f turns with the body but the tilt does not: over all headings the two are uncorrelated and add
in quadrature. The drift ω t adds the acceleration g ω t, integrated twice in (3).

With the biases b and the axis angles α of the accelerometers, and the gyro biases β, over all three axes up or down,

    f² = (2/3) Σ b² + (g²/3) Σ α²,   ω² = (2/3) Σ β²,   ω_u² = (1/3) Σ β²                                        (4)

summed over both horizontal axes. Before calibration the squares are those of the parameters themselves, after it their
variances in the next recording, with in-run bias and, where known, changes from launch to launch. Noise, errors of
scale factors (which need motion) and products of the Earth's rate and gyro errors are neglected.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, sqrt

import numpy as np

from tumble.result.accepted import accepted_kinds
from tumble.result.calibration import Calibration
from tumble.result.correction import correction_errors
from tumble.rotation import left_inverse
from tumble.sensors.model import SensorKind
from tumble.sensors.parameters import beyond_linear, group_name
from tumble.units import DEGREE, G_STANDARD, coarsest, two_digits

SECONDS = 60.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Unaided:
    """Root mean square errors: `tilt` about both horizontal axes and `heading`, rad, and horizontal `position`, m."""

    tilt: float
    heading: float
    position: float


def unaided(calibration: Calibration, seconds: float = SECONDS) -> tuple[Unaided, Unaided] | None:
    """Return the errors of a vehicle without aid for some seconds, before and after calibration.

    None if the calibration lacks accelerometers, gyros, uncertainties, biases or axis angles, or has more than three
    sensors of a kind."""
    accel, gyro, site = calibration.accel, calibration.gyro, calibration.provenance.site
    if accel is None or gyro is None or len(accel.bias) != 3 or len(gyro.bias) != 3:
        return None
    gravity = G_STANDARD if site is None else site.gravity
    next_u = {bias.name: bias.next_u for bias in calibration.evidence.process_bias}
    before, after = dict[str, float](), dict[str, float]()
    for p in calibration.parameters:
        if beyond_linear(p.name):
            continue
        if p.u is None:
            return None
        group = group_name(p.name)
        variance = max(p.u, next_u.get(p.name, 0.0)) ** 2 + (p.run_to_run or 0.0) ** 2
        before[group] = before.get(group, 0.0) + p.value**2
        after[group] = after.get(group, 0.0) + variance
    if not {"accel.bias", "accel.axis", "gyro.bias"} <= before.keys():
        return None
    results = []
    for squares in (before, after):  # Eq. (4), and (1) to (3)
        force = sqrt(2.0 / 3.0 * squares["accel.bias"] + gravity**2 / 3.0 * squares["accel.axis"])
        rate_up = sqrt(squares["gyro.bias"] / 3.0)
        rate = sqrt(2.0) * rate_up
        results.append(
            Unaided(
                tilt=hypot(force / gravity, rate * seconds),
                heading=rate_up * seconds,
                position=hypot(sqrt(0.5) * force * seconds**2, gravity * rate * seconds**3 / 6.0),
            )
        )
    return results[0], results[1]


def improvement(calibration: Calibration) -> tuple[str, ...]:
    """Return up to two sentences on what the calibration improves: errors of readings, and of a vehicle without aid.

    After calibration the error of a reading is its standard uncertainty, before it also the correction, root mean
    square over all attitudes at rest or over all axes at the rate of the session's turns. Sensors that are not accepted
    are left out."""
    prediction, accepted, clauses = calibration.prediction, accepted_kinds(calibration), list[str]()
    if prediction is not None and "accel" in accepted:
        before, after = _off_by(calibration, "accel", prediction.force_u)
        open_angles = any(group_name(name) == "accel.axis" for name in calibration.outcome.unobservable)
        why = " (these rests do not determine the axis angles)" if open_angles else ""
        clauses.append(f"at rest off by {_change(before, after, _FORCES, 0.01)}{why}")
    if prediction is not None and prediction.rate_u is not None and prediction.at_rate and "gyro" in accepted:
        before, after = _off_by(calibration, "gyro", prediction.rate_u)
        rate = prediction.at_rate
        clauses.append(
            f"rates off by {_change(before / rate, after / rate, _PARTS, 0.01)} of {two_digits(rate / DEGREE)} °/s"
        )
    lines = ["; ".join(clauses)] if clauses else []
    if (before_and_after := unaided(calibration)) is not None and len(accepted) == len(before_and_after):
        errors = (("tilt", _ANGLES), ("heading", _ANGLES), ("position", _LENGTHS))
        first, last = before_and_after
        changes = (f"{name} {_change(getattr(first, name), getattr(last, name), units)}" for name, units in errors)
        lines.append(f"after {SECONDS:.0f} s without aid: {', '.join(changes)}")
    return tuple(lines)


_FORCES = ((1e-6 * G_STANDARD, " µg"), (1e-3 * G_STANDARD, " mg"))
_PARTS = ((1e-6, " ppm"), (1e-2, " %"))
_ANGLES = ((DEGREE / 3600.0, "″"), (DEGREE / 60.0, "′"), (DEGREE, "°"))
_LENGTHS = ((1e-2, " cm"), (1.0, " m"), (1e3, " km"))


def _change(corrected: float, remaining: float, units: Sequence[tuple[float, str]], limit: float = 1.0) -> str:
    """Return both errors with an arrow between, each in the largest unit in which it is at least `limit`.

    The error before calibration contains the correction and the remaining error."""
    shown = ((value, *coarsest(units, value, limit=limit)) for value in (hypot(corrected, remaining), remaining))
    return " → ".join(f"{two_digits(value / size)}{name}" for value, size, name in shown)


def _off_by(calibration: Calibration, kind: SensorKind, u: float) -> tuple[float, float]:
    """Return the root mean square error of uncorrected vectors, and the standard uncertainty of corrected vectors if
    that of each sensor is u, SI."""
    block, _ = calibration.compensator.sensors(kind)
    assert block is not None
    nominal = left_inverse(block.axes)
    off = correction_errors(calibration, kind, lambda readings: readings @ nominal.T)
    return float(np.sqrt(np.mean(off**2))), u * float(np.linalg.norm(nominal))
