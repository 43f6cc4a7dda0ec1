"""How much devices of one type change from launch to launch, by all the launches that are known of them.

Two launches show the instability of a device with one degree of freedom, for which k is 14. Devices of a type are
alike; of the calibrations i of several launches, with standard deviations s_i from launch to launch of ν_i degrees of
freedom and n_i² the mean variance that their launches know of themselves,

    s_p² = Σ ν_i s_i²/ν_p,   n_p² = Σ ν_i n_i²/ν_p,   ν_p = Σ ν_i

and launches of the variance n² of their own scatter by

    s² = max(s_p² − n_p², 0) + n²,   ν = ν_p (s²/s_p²)²                                                          (1)

the degrees of freedom being those of s_p², the only part of s² that was estimated (GUM, G.4.1). That and the device's
own s with L − 1 degrees are pooled. A device whose own s is larger than chance makes it in UNLIKE of all cases is not
like its type, and judged by itself.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import scipy

from tumble.result.calibration import Calibration

UNLIKE = 1e-3
"""A device is not like its type where chance makes it as unstable less often."""


@dataclass(frozen=True, kw_only=True, slots=True)
class KnownLaunches:
    """The launches behind a calibration of a device: the SHA-256 of their logs, one fewer than there are as `degrees`,
    and by parameter the variance from launch to launch and the mean variance that launches know of themselves, SI."""

    serial: str
    logs: frozenset[str]
    degrees: int
    variances: Mapping[str, tuple[float, float]]


def known_launches(calibration: Calibration) -> KnownLaunches | None:
    """The launches behind a calibration; None where there are not several."""
    count = len(calibration.launches)
    if count < 2:
        return None
    own = [{p.name: (p.u or 0.0) ** 2 for p in launch.parameters} for launch in calibration.launches]
    return KnownLaunches(
        serial=calibration.serial,
        logs=frozenset(launch.log_sha256 for launch in calibration.launches),
        degrees=count - 1,
        variances={
            p.name: (p.run_to_run**2, sum(each[p.name] for each in own) / count)
            for p in calibration.parameters
            if p.run_to_run is not None and all(p.name in each for each in own)
        },
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class TypeSpread:
    """All launches that are known of devices of a type, in a frame."""

    model: str
    frame: str
    known: tuple[KnownLaunches, ...]

    @property
    def devices(self) -> int:
        """How many there are."""
        return len({each.serial for each in self.known})

    @property
    def degrees(self) -> int:
        """ν_p of a parameter that all calibrations have."""
        return sum(each.degrees for each in self.known)

    def without(self, logs: Collection[str]) -> TypeSpread:
        """Without calibrations that have one of these logs: launches count once."""
        return replace(self, known=tuple(each for each in self.known if not each.logs & set(logs)))

    def of(self, name: str, noise: float) -> tuple[float, float]:
        """The variance from launch to launch of a parameter of which launches have the variance `noise`, SI², and its
        degrees of freedom, Eq. (1); (0, 0) where nothing is known."""
        found = [(each.degrees, *each.variances[name]) for each in self.known if name in each.variances]
        degrees = sum(count for count, _, _ in found)
        between = sum(count * variance for count, variance, _ in found)
        if between <= 0.0:
            return 0.0, 0.0
        within = sum(count * variance for count, _, variance in found)
        s2 = max(between - within, 0.0) / degrees + noise
        return s2, degrees * (s2 * degrees / between) ** 2


def pooled(own: float, degrees: float, alike: tuple[float, float]) -> tuple[float, float] | None:
    """The variance from launch to launch and its degrees of freedom from a device's own and that of its type; None
    where the device is not like its type."""
    variance, known = alike
    if known == 0.0:
        return own, degrees
    if scipy.special.fdtrc(degrees, known, own / variance) < UNLIKE:
        return None
    return (degrees * own + known * variance) / (degrees + known), degrees + known
