"""Changes of the parameters of a device from launch to launch, by one of its calibrations or those of its type.

Two launches show the instability of a device with one degree of freedom, for which k is 14. Devices of one type are
pooled: if calibrations i have variances s_i² from launch to launch with ν_i degrees of freedom, and n_i² is the mean
variance of the estimate in one launch,

    s_p² = Σ ν_i s_i²/ν_p,   n_p² = Σ ν_i n_i²/ν_p,   ν_p = Σ ν_i

and launches of another device, whose estimate in one launch has the variance n², scatter by

    s² = max(s_p² − n_p², 0) + n²,   ν = ν_p (s²/s_p²)²                                                          (1)

with the degrees of freedom of s_p², the only part of s² that was estimated (GUM, G.4.1).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from tumble.result.calibration import Calibration
from tumble.result.parts import CalibratedTemperature
from tumble.result.record import to_references
from tumble.units import Array

UNLIKE_PROBABILITY = 1e-3  # of such an instability by chance, below which a device is unlike its type
_SHARED = ("gravity", "clock", "type", "launches")  # sources that do not scatter from launch to launch


@dataclass(frozen=True, kw_only=True, slots=True)
class LaunchVariances:
    """Variances of the parameters of a device from launch to launch.

    `logs` are the SHA-256 of the logs of the launches, `degrees` is one fewer than their number, and `variances` has,
    by parameter, the variance from launch to launch and the mean variance of the estimate in one launch, SI."""

    serial: str
    logs: frozenset[str]
    degrees: int
    variances: Mapping[str, tuple[float, float]]


def launch_variances(calibration: Calibration) -> LaunchVariances | None:
    """Return the variances from launch to launch of a calibration; None unless it has several launches."""
    count = len(calibration.evidence.launches)
    if count < 2:
        return None
    u2 = [{p.name: (p.u or 0.0) ** 2 for p in launch.parameters} for launch in calibration.evidence.launches]
    has_budget = bool(calibration.evidence.budget)
    return LaunchVariances(
        serial=calibration.serial,
        logs=frozenset(launch.log_sha256 for launch in calibration.evidence.launches),
        degrees=count - 1,
        variances={
            p.name: (
                p.run_to_run**2,
                count * estimate_variance(calibration, p.name)
                if has_budget
                else sum(each[p.name] for each in u2) / count,
            )
            for p in calibration.parameters
            if p.run_to_run is not None and all(p.name in each for each in u2)
        },
    )


def estimate_variance(calibration: Calibration, name: str) -> float:
    """Return the variance of a parameter, SI, without shared errors (gravity, time base, priors) and changes from
    launch to launch; the whole variance if there is no budget."""
    budget = calibration.evidence.budget
    if not budget:
        return (calibration[name].u or 0.0) ** 2
    sources = (s for s in budget if s.name not in _SHARED and not s.name.startswith("prior."))
    return sum(source.contributions.get(name, 0.0) ** 2 for source in sources)


def variances_between(calibrations: Sequence[Calibration]) -> LaunchVariances | None:
    """Return the variances between calibrations of one launch each, at the reference temperatures of the last.

    None if there are fewer than two. They contain drifts in the time between the calibrations."""
    count = len(calibrations)
    if count < 2:
        return None
    names = [name for name in calibrations[0] if all(name in each for each in calibrations)]
    between = np.var(at_temperature(calibrations, names, calibrations[-1].temperature)[0], axis=0, ddof=1)
    noise = np.mean([[estimate_variance(each, name) for name in names] for each in calibrations], axis=0)
    return LaunchVariances(
        serial=calibrations[0].serial,
        logs=frozenset(each.provenance.log_sha256 or "" for each in calibrations),
        degrees=count - 1,
        variances=dict(zip(names, zip(between.tolist(), noise.tolist(), strict=True), strict=True)),
    )


def at_temperature(
    launches: Sequence[Calibration], names: Sequence[str], temperature: CalibratedTemperature
) -> tuple[Array, Array]:
    """Return values (L, m) and covariances (L, m, m) of launches at other reference temperatures."""
    values, covariances = [], []
    for launch in launches:
        move, C = np.eye(len(names)), launch.covariance_of(names)
        if temperature.reference is not None:
            move = to_references(launch, names, temperature)
        values.append(move @ [launch[n].value for n in names])
        covariances.append(move @ (np.zeros_like(move) if C is None else C) @ move.T)
    return np.array(values), np.array(covariances)


def variance_of_type(launches: Iterable[LaunchVariances], name: str, noise: float) -> tuple[float, float]:
    """Return the variance of a parameter from launch to launch by other devices of the type, and its degrees of
    freedom, Eq. (1); zeros without any.

    `noise` is the variance of the estimate in one launch of the device in question, SI."""
    variances = [(each.degrees, *each.variances[name]) for each in launches if name in each.variances]
    degrees = sum(count for count, _, _ in variances)
    between = sum(count * variance for count, variance, _ in variances)
    if between <= 0.0:
        return 0.0, 0.0
    within = sum(count * variance for count, _, variance in variances)
    s2 = max(between - within, 0.0) / degrees + noise
    return s2, degrees * (s2 * degrees / between) ** 2


def pool_with_type(variance: float, degrees: float, of_type: tuple[float, float]) -> tuple[float, float] | None:
    """Return the variance of a device from launch to launch pooled with that of its type, and its degrees of freedom.

    None if the device is significantly more unstable than its type (UNLIKE_PROBABILITY)."""
    type_variance, type_degrees = of_type
    if type_degrees == 0.0:
        return variance, degrees
    if scipy.special.fdtrc(degrees, type_degrees, variance / type_variance) < UNLIKE_PROBABILITY:
        return None
    return (degrees * variance + type_degrees * type_variance) / (degrees + type_degrees), degrees + type_degrees
