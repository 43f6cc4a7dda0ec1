"""Variances of the parameters of a device from launch to launch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tumble.result.calibration import Calibration
from tumble.result.parts import CalibratedTemperature
from tumble.result.record import to_references
from tumble.units import Array


@dataclass(frozen=True, kw_only=True, slots=True)
class LaunchVariances:
    """Variances of the parameters of a device from launch to launch.

    `logs` are the SHA-256 of the launches' logs, `degrees` is one less than their number; `variances` are by parameter,
    SI."""

    serial: str
    logs: frozenset[str]
    degrees: int
    variances: Mapping[str, float]


def launch_variances(calibration: Calibration) -> LaunchVariances | None:
    """Return the variances from launch to launch of a calibration; None unless it has several launches."""
    count = len(calibration.evidence.launches)
    if count < 2:
        return None
    return LaunchVariances(
        serial=calibration.serial,
        logs=frozenset(launch.log_sha256 for launch in calibration.evidence.launches),
        degrees=count - 1,
        variances={p.name: p.run_to_run**2 for p in calibration.parameters if p.run_to_run is not None},
    )


def variances_between(calibrations: Sequence[Calibration]) -> LaunchVariances | None:
    """Return the variances between calibrations of one launch each, at the reference temperatures of the last.

    None if there are fewer than two. They contain drifts in the time between the calibrations."""
    count = len(calibrations)
    if count < 2:
        return None
    names = [name for name in calibrations[0] if all(name in each for each in calibrations)]
    between = np.var(at_temperature(calibrations, names, calibrations[-1].temperature)[0], axis=0, ddof=1)
    return LaunchVariances(
        serial=calibrations[0].serial,
        logs=frozenset(each.provenance.log_sha256 or "" for each in calibrations),
        degrees=count - 1,
        variances=dict(zip(names, between.tolist(), strict=True)),
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
