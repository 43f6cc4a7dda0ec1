"""How much devices of a type change from launch to launch, by all their calibrations of several launches.

Two launches show the instability of a device with one degree of freedom, for which k is 14. Devices of a type are
alike: of the calibrations i, with variances s_i² from launch to launch of ν_i degrees of freedom and n_i² the mean
variance that their launches know of themselves,

    s_p² = Σ ν_i s_i²/ν_p,   n_p² = Σ ν_i n_i²/ν_p,   ν_p = Σ ν_i

and launches of another device, whose own variance is n², scatter by

    s² = max(s_p² − n_p², 0) + n²,   ν = ν_p (s²/s_p²)²                                                          (1)

with the degrees of freedom of s_p², the only part of s² that was estimated (GUM, G.4.1).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from tumble.result.calibration import Calibration
from tumble.scipy_compiled import special

UNLIKE = 1e-3
"""Probability below which a device is more unstable than its type."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LaunchSpread:
    """Variances from launch to launch behind one calibration.

    Parameters
    ----------
    serial
        The device.
    logs
        SHA-256 of the logs of its launches.
    degrees
        Degrees of freedom, one fewer than there are launches.
    variances
        By parameter the variance from launch to launch and the mean variance that launches know of themselves, SI.
    """

    serial: str
    logs: frozenset[str]
    degrees: int
    variances: Mapping[str, tuple[float, float]]


def launch_spread(calibration: Calibration) -> LaunchSpread | None:
    """The variances from launch to launch behind a calibration; None unless it is the mean of several launches."""
    count = len(calibration.launches)
    if count < 2:
        return None
    within = [{p.name: (p.u or 0.0) ** 2 for p in launch.parameters} for launch in calibration.launches]
    return LaunchSpread(
        serial=calibration.serial,
        logs=frozenset(launch.log_sha256 for launch in calibration.launches),
        degrees=count - 1,
        variances={
            p.name: (p.run_to_run**2, sum(each[p.name] for each in within) / count)
            for p in calibration.parameters
            if p.run_to_run is not None and all(p.name in each for each in within)
        },
    )


def spread_of_type(spreads: Iterable[LaunchSpread], name: str, noise: float) -> tuple[float, float]:
    """Variance from launch to launch of a parameter by the launches of other devices, and its degrees of freedom.

    Parameters
    ----------
    spreads
        The launches of devices of the type.
    name
        The parameter.
    noise
        Variance that the launches in question know of themselves, SI.

    Returns
    -------
    variance, degrees
        Eq. (1); (0, 0) if nothing is known.
    """
    seen = [(each.degrees, *each.variances[name]) for each in spreads if name in each.variances]
    degrees = sum(count for count, _, _ in seen)
    between = sum(count * variance for count, variance, _ in seen)
    if between <= 0.0:
        return 0.0, 0.0
    within = sum(count * variance for count, _, variance in seen)
    s2 = max(between - within, 0.0) / degrees + noise
    return s2, degrees * (s2 * degrees / between) ** 2


def pooled(variance: float, degrees: float, of_type: tuple[float, float]) -> tuple[float, float] | None:
    """Pool the variance of a device with that of its type (variance, degrees of freedom).

    None if the device is more unstable than chance makes one of its type in UNLIKE of all cases.
    """
    type_variance, type_degrees = of_type
    if type_degrees == 0.0:
        return variance, degrees
    if special.fdtrc(degrees, type_degrees, variance / type_variance) < UNLIKE:
        return None
    return (degrees * variance + type_degrees * type_variance) / (degrees + type_degrees), degrees + type_degrees
