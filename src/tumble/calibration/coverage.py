"""How often a stated uncertainty is right: what ±U with U = k u, k = 2, covers.

The error of a value in units of its u is normal where u is known: ±2u covers 95.4 %. Where u was estimated from
residuals with ν degrees of freedom, it has Student's t distribution, and ±k u covers

    P = 2 T(k; ν) − 1        5 degrees: 89.8 % with k = 2, and 95 % with k = 2.57

The parameters of sensors whose rests or turns show a scatter have the degrees of freedom with which it was estimated,
those of gyros the fewer of the two. Noise that is known and in u as well only raises P. In the mean of launches, u is
either the instability between L launches, with L − 1, or what the launches know of themselves (Welch–Satterthwaite).
Not counted is the scatter of the placements on the faces of the case, which is in the parameters of that frame.

Source: JCGM 100:2008 (GUM), annex G.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import inf

from scipy.special import stdtr, stdtrit

from tumble.calibration.calibration_file import Calibration
from tumble.calibration.results import Launch, Parameter
from tumble.estimation.estimate import Fit

COVERAGE = 2.0
"""The coverage factor k of every expanded uncertainty U = k u."""

WANTED = 0.95
"""What U should cover."""

_KINDS = {"accel": "accelerometers", "gyro": "gyros", "mag": "magnetometer"}


def degrees_of_freedom(calibration: Calibration, name: str) -> float:
    """With how many the u of a parameter was estimated; infinite where the noise is known."""
    if calibration.launches:
        return _of_mean(calibration.launches, calibration[name])
    return _of_fits(calibration.fits, name)


def coverage(calibration: Calibration, name: str) -> float:
    """The probability, at least, that ±2u of a parameter contains its true value."""
    return covered(degrees_of_freedom(calibration, name))


def covered(degrees: float) -> float:
    """The probability of ±2u where u was estimated with so many degrees of freedom; infinitely many: it is known."""
    return float(2.0 * stdtr(degrees, COVERAGE) - 1.0)


def shortfalls(calibration: Calibration) -> tuple[str, ...]:
    """For each kind of sensor of which ±U covers less than 95 % of some parameter: how much, and which k would do."""
    found = []
    for kind, sensors in _KINDS.items():
        names = [p.name for p in calibration.parameters if p.name.startswith(f"{kind}.") and p.u]
        degrees = [degrees_of_freedom(calibration, name) for name in names]
        if names and min(coverage(calibration, name) for name in names) < WANTED:
            found.append(_shortfall(sensors, min(degrees), more=max(degrees) > min(degrees)))
    return tuple(found)


def _shortfall(sensors: str, degrees: float, *, more: bool) -> str:
    factor = stdtrit(degrees, 0.5 + 0.5 * WANTED)
    count = f"{degrees:.3g} degree{'' if degrees == 1.0 else 's'} of freedom{' or more' if more else ''}"
    return (
        f"the u of the {sensors} was estimated with {count}: k = 2 covers at least {100.0 * covered(degrees):.1f} %, "
        f"k = {factor:.2f} at least {100.0 * WANTED:.0f} %"
    )


def _of_fits(fits: Mapping[str, Fit], name: str) -> float:
    """The fewest of the groups of a parameter's kind of sensor that scatter."""
    kind = name.partition(".")[0]
    groups = [fit for group, fit in fits.items() if group.startswith(kind)]
    return min((fit.degrees for fit in groups if fit.scatter > 0.0 and fit.degrees > 0.0), default=inf)


def _of_mean(launches: tuple[Launch, ...], mean: Parameter) -> float:
    """Of the mean of launches (module docstring)."""
    own = [
        (p.u**2, _of_fits(launch.fits, p.name))
        for launch in launches
        for p in launch.parameters
        if p.name == mean.name and p.u
    ]
    variance, count = sum(square for square, _ in own), len(launches)
    if mean.run_to_run is not None and count > 1 and count * mean.run_to_run**2 > variance:
        return count - 1.0
    spread = sum(square**2 / degrees for square, degrees in own)
    return variance**2 / spread if spread > 0.0 else inf
