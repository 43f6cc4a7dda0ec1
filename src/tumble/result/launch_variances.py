"""How much the parameters of a device change from launch to launch, by one of its calibrations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from tumble.result.calibration import Calibration


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
    count = len(calibration.launches)
    if count < 2:
        return None
    own = [{p.name: (p.u or 0.0) ** 2 for p in launch.parameters} for launch in calibration.launches]
    return LaunchVariances(
        serial=calibration.serial,
        logs=frozenset(launch.log_sha256 for launch in calibration.launches),
        degrees=count - 1,
        variances={
            p.name: (p.run_to_run**2, sum(each[p.name] for each in own) / count)
            for p in calibration.parameters
            if p.run_to_run is not None and all(p.name in each for each in own)
        },
    )
