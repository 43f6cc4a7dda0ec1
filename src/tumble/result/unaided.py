"""Tilt, heading and position errors of a vehicle without aid, before and after calibration.

The vehicle stands with one axis of the body up, levels itself by its accelerometers, turns to any heading, and is then
navigated by its inertial sensors alone for a time t, without turning. To first order the horizontal errors are

    tilt      φ = f/g + ω t                                                                                      (1)
    heading   ψ = ω_u t                                                                                          (2)
    position  r = ½ (f + g f/g) t² + g ω t³/6                                                                    (3)

f is the horizontal error of the specific force at rest, and ω and ω_u the errors of the rate about the horizontal axes
and the vertical. Levelling tilts the attitude by f/g, so that f and the gravity that the tilt feigns cancel in the
heading of the levelling. After the turn f has turned with the body and the tilt has not: over all headings the two are
uncorrelated, and add up in quadrature. ω t tilts the attitude further, which feigns g ω t, integrated twice in (3).

With the biases b and the axis angles α of the accelerometers, and the gyro biases β, over all three axes up or down,

    f² = (2/3) Σ b² + (g²/3) Σ α²,   ω² = (2/3) Σ β²,   ω_u² = (1/3) Σ β²                                        (4)

summed over both horizontal axes. Before calibration these are the values of the parameters themselves, and after it
their variances in the next recording, with in-run bias and, if it is known, with the changes from launch to launch.
Noise, scale factors (which need a motion) and the Earth's rate times the errors of the gyros are left out.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, sqrt

from tumble.result.calibration import Calibration
from tumble.sensors.parameters import beyond_linear, group_name
from tumble.units import DEGREE, G_STANDARD, two_digits

SECONDS = 60.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Unaided:
    """Root mean square errors: `tilt` about both horizontal axes and `heading`, rad, and horizontal `position`, m."""

    tilt: float
    heading: float
    position: float

    @staticmethod
    def of(force: float, rate: float, rate_up: float, gravity: float, seconds: float) -> Unaided:
        """Eq. (1) to (3), of root mean squares of f (m/s²), ω and ω_u (rad/s)."""
        return Unaided(
            tilt=hypot(force / gravity, rate * seconds),
            heading=rate_up * seconds,
            position=hypot(sqrt(0.5) * force * seconds**2, gravity * rate * seconds**3 / 6.0),
        )


def unaided(calibration: Calibration, seconds: float = SECONDS) -> tuple[Unaided, Unaided] | None:
    """Errors of a vehicle without aid, before and after calibration.

    Parameters
    ----------
    calibration
        A calibration of accelerometers and gyros.
    seconds
        Time without aid, s.

    Returns
    -------
    tuple of Unaided, or None
        None if the calibration has no gyros, no uncertainties, or more than three sensors of a kind.
    """
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
    results = []
    for squares in (before, after):  # Eq. (4)
        force = sqrt(2.0 / 3.0 * squares["accel.bias"] + gravity**2 / 3.0 * squares["accel.axis"])
        rate = sqrt(squares["gyro.bias"] / 3.0)
        results.append(Unaided.of(force, sqrt(2.0) * rate, rate, gravity, seconds))
    return results[0], results[1]


def unaided_lines(calibration: Calibration) -> tuple[str, ...]:
    """Two sentences with the errors after SECONDS without aid; none where they are not known."""
    both = unaided(calibration)
    lines = []
    for what, errors in zip(("uncalibrated", "calibrated"), both or (), strict=False):
        size, unit = (1e3, "km") if errors.position >= 1e3 else (1.0, "m")
        lines.append(
            f"{what}, {SECONDS:.0f} s without aid: tilt {two_digits(errors.tilt / DEGREE)}°, heading "
            f"{two_digits(errors.heading / DEGREE)}°, position {two_digits(errors.position / size)} {unit}"
        )
    return tuple(lines)
