"""How much the parameters of a device change from launch to launch, by one of its calibrations or by those of its type.

Two launches show the instability of a device with one degree of freedom, for which k is 14. Devices of a type are
alike: of the calibrations i, with variances s_i² from launch to launch of ν_i degrees of freedom and n_i² the mean
variance of the estimate in one launch,

    s_p² = Σ ν_i s_i²/ν_p,   n_p² = Σ ν_i n_i²/ν_p,   ν_p = Σ ν_i

and launches of another device, in which the estimate has the variance n², scatter by

    s² = max(s_p² − n_p², 0) + n²,   ν = ν_p (s²/s_p²)²                                                          (1)

with the degrees of freedom of s_p², the only part of s² that was estimated (GUM, G.4.1).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import scipy

from tumble.result.calibration import Calibration

UNLIKE = 1e-3
"""Probability by chance below which a device is more unstable than its type."""


@dataclass(frozen=True, kw_only=True, slots=True)
class LaunchVariances:
    """Variances from launch to launch of the launches behind one calibration.

    Attributes
    ----------
    serial : str
        Serial number of the device.
    logs : frozenset of str
        SHA-256 of the logs of the launches.
    degrees : int
        One fewer than there are launches.
    variances : mapping of str to (float, float)
        By parameter the variance from launch to launch, and the mean variance of the estimate in one launch, SI.
    """

    serial: str
    logs: frozenset[str]
    degrees: int
    variances: Mapping[str, tuple[float, float]]


def launch_variances(calibration: Calibration) -> LaunchVariances | None:
    """The variances from launch to launch of a calibration; None unless it has several launches."""
    count = len(calibration.evidence.launches)
    if count < 2:
        return None
    own = [{p.name: (p.u or 0.0) ** 2 for p in launch.parameters} for launch in calibration.evidence.launches]
    return LaunchVariances(
        serial=calibration.serial,
        logs=frozenset(launch.log_sha256 for launch in calibration.evidence.launches),
        degrees=count - 1,
        variances={
            p.name: (p.run_to_run**2, sum(each[p.name] for each in own) / count)
            for p in calibration.parameters
            if p.run_to_run is not None and all(p.name in each for each in own)
        },
    )


def variance_of_type(launches: Iterable[LaunchVariances], name: str, noise: float) -> tuple[float, float]:
    """Variance from launch to launch of a parameter by the launches of other devices, and its degrees of freedom.

    Parameters
    ----------
    launches
        Those of other devices of the type.
    name
        The parameter.
    noise
        Variance of the estimate in one launch of the device in question, SI.

    Returns
    -------
    variance, degrees
        Eq. (1); (0, 0) if nothing is known.
    """
    seen = [(each.degrees, *each.variances[name]) for each in launches if name in each.variances]
    degrees = sum(count for count, _, _ in seen)
    between = sum(count * variance for count, variance, _ in seen)
    if between <= 0.0:
        return 0.0, 0.0
    within = sum(count * variance for count, _, variance in seen)
    s2 = max(between - within, 0.0) / degrees + noise
    return s2, degrees * (s2 * degrees / between) ** 2


def pooled(variance: float, degrees: float, of_type: tuple[float, float]) -> tuple[float, float] | None:
    """Pool the variance of a device from launch to launch with that of its type.

    Parameters
    ----------
    variance, degrees
        Of the device, SI, with its degrees of freedom.
    of_type
        The same of its type.

    Returns
    -------
    variance, degrees
        Or None if the device is more unstable than its type: by chance in fewer than UNLIKE of all cases.
    """
    type_variance, type_degrees = of_type
    if type_degrees == 0.0:
        return variance, degrees
    if scipy.special.fdtrc(degrees, type_degrees, variance / type_variance) < UNLIKE:
        return None
    return (degrees * variance + type_degrees * type_variance) / (degrees + type_degrees), degrees + type_degrees
