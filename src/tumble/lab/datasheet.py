"""The data sheet of a device type: what its units in the registry are like, parameter by parameter.

Of the n units of a parameter, each by its own recordings (`tumble.lab.device_type`), the least, the mean and the
largest value, their standard deviation s, and the interval that contains 95 % of all units of the type with 95 %
confidence, where they are normally distributed,

    x̄ ± k s,   k:  √(2n/π) ∫₀^∞ P(χ²_{n−1} > (n − 1) r²(z)/k²) e^{−n z²/2} dz = 0.95                               (1)

r²(z) being the 0.95 quantile of the noncentral χ² of one degree of freedom with noncentrality z². In-run biases, which
are sizes, are judged by their logarithms. s contains what the recordings do not know of the units, u.

Terms are those of IEEE Std 2700 (parameters of MEMS sensors) and of IEEE Std 528 (inertial sensors), as far as their
definitions are public: in 2700 "sensitivity" is the scale factor, in 528 what an output changes by with an input that
is not meant, as in "scale factor temperature sensitivity". An in-run bias is no bias instability, which is flicker
noise: it is the exponentially correlated noise of IEEE Std 952, annex C.

Source: ISO 16269-6:2014, annex of exact factors; Odeh & Owen, Tables for Normal Tolerance Limits (1980).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from tumble.brief import Brief
from tumble.errors import InputError
from tumble.lab.device_type import FEWEST_UNITS
from tumble.lab.registry.series import device_type
from tumble.lab.registry.store.connect import Registry
from tumble.sensors.parameters import group_name, group_of
from tumble.units import Array

CONTENT = CONFIDENCE = 0.95

TERMS: Mapping[str, tuple[str, str]] = {
    "accel.bias": ("zero-g offset", "bias"),
    "accel.scale": ("sensitivity", "scale factor error"),
    "accel.axis": ("cross-axis sensitivity", "input-axis misalignment"),
    "accel.quadratic": ("nonlinearity", "second-order nonlinearity coefficient"),
    "accel.cubic": ("nonlinearity", "third-order nonlinearity coefficient"),
    "accel.asymmetry": ("nonlinearity", "scale factor asymmetry"),
    "accel.bias.t1": ("zero-g offset temperature coefficient", "bias temperature sensitivity"),
    "accel.scale.t1": ("sensitivity temperature coefficient", "scale factor temperature sensitivity"),
    "accel.in_run": ("", "exponentially correlated noise"),
    "gyro.bias": ("zero-rate offset", "bias"),
    "gyro.scale": ("sensitivity", "scale factor error"),
    "gyro.axis": ("cross-axis sensitivity", "input-axis misalignment"),
    "gyro.cubic": ("nonlinearity", "scale factor nonlinearity"),
    "gyro.asymmetry": ("nonlinearity", "scale factor asymmetry"),
    "gyro.g_sensitivity": ("linear acceleration sensitivity", "acceleration-sensitive drift rate"),
    "gyro.bias.t1": ("zero-rate offset temperature coefficient", "bias temperature sensitivity"),
    "gyro.scale.t1": ("sensitivity temperature coefficient", "scale factor temperature sensitivity"),
    "gyro.in_run": ("", "exponentially correlated noise"),
}
"""Of groups of parameters: what IEEE Std 2700 and IEEE Std 528, of in-run biases 952, call them."""


@dataclass(frozen=True, kw_only=True, slots=True)
class DatasheetRow:
    """A parameter of a type, SI: of so many `units` the `least`, the `typical` and the `most`, their standard deviation
    `between` units, what single recordings differ by from power-on to power-on, None where no unit was recorded twice,
    the `u` that the recordings leave, and the tolerance interval from `low` to `high`; the terms of either standard."""

    name: str
    term: str
    inertial_term: str
    unit: str
    units: int
    least: float
    typical: float
    most: float
    between: float
    run_to_run: float | None
    u: float | None
    low: float
    high: float


@dataclass(frozen=True, kw_only=True, slots=True, repr=False)
class Datasheet(Brief):
    """What `units` units of a type are like, of so many `recordings`, at the `reference`, °C, if it is known."""

    model: str
    units: int
    recordings: int
    reference: float | None
    rows: tuple[DatasheetRow, ...]


def datasheet(registry: Registry, model: str) -> Datasheet:
    """The data sheet of a type by all its calibrations that are in force and that no type was a prior of.

    Raises InputError for fewer than three units.

    >>> import tumble
    >>> request = tumble.Setup.of(grade="mems", positions=12)
    >>> with tumble.open_registry("registry.sqlite", create=True) as registry:
    ...     tumble.datasheet(registry, "BCHE-501")
    Traceback (most recent call last):
    ...
    tumble.errors.InputError: type 'BCHE-501': expected at least 3 units in the registry, found 0
    """
    known = device_type(registry, model)
    if known.units < FEWEST_UNITS:
        raise InputError(f"type {model!r}: expected at least {FEWEST_UNITS} units in the registry, found {known.units}")
    temperatures = [each.reference for each in known.known if each.reference is not None]
    reference = float(np.median(temperatures)) if temperatures else None

    def row(name: str, unit: str, values: Array, *, logarithm: bool = False, **u: float | None) -> DatasheetRow:
        """A parameter whose units have these values; or their logarithms are normally distributed."""
        normal = np.log(values) if logarithm else values
        half = tolerance_factor(len(values)) * float(normal.std(ddof=1))
        ends = np.array([normal.mean() - half, normal.mean() + half])
        low, high = (np.exp(ends) if logarithm else ends).tolist()
        term, inertial_term = TERMS.get(name if logarithm else group_name(name), ("", ""))
        return DatasheetRow(
            name=name,
            term=term,
            inertial_term=inertial_term,
            unit=unit,
            units=len(values),
            least=float(values.min()),
            typical=float(values.mean()),
            most=float(values.max()),
            between=float(values.std(ddof=1)),
            run_to_run=u.get("run_to_run"),
            u=u.get("u"),
            low=low,
            high=high,
        )

    rows = [
        row(
            name,
            group_of(name).unit,
            each.values,
            u=float(np.sqrt(each.own_variances.mean())),
            run_to_run=each.run_to_run,
        )
        for name, each in known.learned(reference).parameters.items()
    ]
    for kind, unit in (("accel", "m/s^2"), ("gyro", "rad/s")):
        sizes = np.array([size for size in known.in_run(kind) if size > 0.0])
        if len(sizes) >= FEWEST_UNITS:
            rows.append(row(f"{kind}.in_run", unit, sizes, logarithm=True))
    recordings = len(known.known)
    return Datasheet(model=model, units=known.units, recordings=recordings, reference=reference, rows=tuple(rows))


@cache
def tolerance_factor(n: int, content: float = CONTENT, confidence: float = CONFIDENCE) -> float:
    """The factor k of two-sided tolerance intervals x̄ ± k s of n normal values with unknown mean, Eq. (1)."""
    nodes, weights = np.polynomial.legendre.leggauss(80)
    z = 0.5 * (nodes + 1.0) * 8.5 / np.sqrt(n)
    density = weights * 8.5 / np.sqrt(n) * 0.5 * np.sqrt(2.0 * n / np.pi) * np.exp(-0.5 * n * z**2)
    quantile = ncx2.ppf(content, 1, z**2)

    def confident(k: float) -> float:
        return float(density @ chi2.sf((n - 1) * quantile / k**2, n - 1)) - confidence

    return float(brentq(confident, 1.0, 1e4, xtol=1e-10))
