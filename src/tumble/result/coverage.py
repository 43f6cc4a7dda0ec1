"""What the expanded uncertainty of a parameter is: U = k u, which covers its true value in 95.45 of 100 cases.

The error of a value in units of its u is normal where u is known, and k = 2. Where u was estimated with ν degrees of
freedom, it has Student's t distribution, and

    k = t₉₅.₄₅(ν),   ν = u⁴ / Σ (u_i⁴/ν_i),   u² = Σ u_i²                          (Welch, Satterthwaite)

`Parameter.dof` is ν and `Parameter.k` is k. ν is that of the joint method, or of the scatter of the rests or turns that
a sensor takes part in, the fewest of those that scatter; in another frame that of what a parameter is made of, taken as
fully correlated. In the mean of L launches

    u² = max(s², n²)/L + g²,   ν = u⁴ ν_m / (max(s², n²)/L)²,   t(ν_m) max(s, n) = max( t(L − 1) s, t(ν_n) n )

with s the standard deviation from launch to launch, n² the mean variance that launches know of themselves, with ν_n
degrees of freedom, and g what is common to all of them, the uncertainty of gravity. t(L − 1) s/√L covers as stated
whatever the instability is, and no other function of s and n does so for all (s² is complete); but two launches that
agree by chance are known no better than each of them is. The larger of both never covers less: up to 99 % without
instability, 96 % where it is three times n. With the launches of other devices of the type s has more degrees of
freedom than L − 1 (`tumble.result.launch_variances`).

Where no scatter was detected, u is of the noise within rests; how much scatter could be there unseen is said.

Source: JCGM 100:2008 (GUM), annex G.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import erfc, inf, sqrt

import numpy as np
import scipy

from tumble.inference.estimate import Fit
from tumble.recording.session import Site
from tumble.result.parts import Parameter, coverage_factor, stated_factor
from tumble.sensors.parameters import group_name, sensor_kind
from tumble.units import Array

UNLEARNED = 1e-9
"""Of a variance: where what others do not share is so little, it is none."""
PROBABILITY = 0.9545
"""What U covers, as certificates state it."""

MANY_DEGREES = 1e5
"""Degrees of freedom from which on a u counts as known."""

MOST_NAMED = 6
"""Parameters without U that are named one by one."""

COUNTED = 4.0
"""cᵀ C⁻¹ c above which a covariance is taken not to have the uncertainty of gravity."""


def degrees_of_freedom(parameter: Parameter) -> float:
    """With how many the u of a parameter was estimated; infinite where the noise is known."""
    return inf if parameter.dof is None else parameter.dof


def expanded(parameter: Parameter) -> float | None:
    """U = k u; None where the parameter has no u, or one with too few degrees of freedom for a U."""
    return None if parameter.u is None else expanded_of(parameter.u, parameter.dof)


def expanded_of(u: float, degrees: float | None) -> float | None:
    """U of a standard uncertainty with so many degrees of freedom, None: it is known; None where they are too few."""
    k = stated_factor(degrees)
    return None if k is None else k * u


def welch_satterthwaite(parts: Iterable[tuple[float, float | None]]) -> float | None:
    """Degrees of freedom of a sum of independent errors, from the variance and the degrees of each; None: known."""
    errors = list(parts)
    of_variance = sum(variance**2 / degrees for variance, degrees in errors if degrees is not None and degrees > 0.0)
    total = sum(variance for variance, _ in errors) ** 2
    return None if total >= MANY_DEGREES * of_variance else total / of_variance


def unshared_variance(u: float | None, degrees: float | None, shared: Iterable[float]) -> tuple[float, float | None]:
    """Variance of a parameter of this u without the standard uncertainties that it shares, and its degrees of
    freedom."""
    variance = (u or 0.0) ** 2
    remaining = variance - sum(each**2 for each in shared)
    remaining = remaining if remaining > UNLEARNED * variance else 0.0
    return remaining, None if degrees is None or variance == 0.0 else degrees * (remaining / variance) ** 2


def with_degrees(parameters: Iterable[Parameter], fits: Mapping[str, Fit]) -> tuple[Parameter, ...]:
    """Parameters of a method that gives no degrees of freedom, with those of the fits, the fewest of the groups of
    residuals of a kind of sensor that scatter; unchanged if any has some."""
    parameters = tuple(parameters)
    if any(p.dof is not None for p in parameters):
        return parameters
    scattering = {group: fit.degrees for group, fit in fits.items() if fit.scatter > 0.0 and fit.degrees > 0.0}
    fewest = {
        kind: min((degrees for group, degrees in scattering.items() if group.startswith(kind)), default=None)
        for kind in {sensor_kind(p.name) for p in parameters}
    }
    return tuple(replace(p, dof=fewest[sensor_kind(p.name)]) for p in parameters)


def degrees_through(jacobian: Array, u: Array, degrees: Iterable[float | None]) -> list[float | None]:
    """Degrees of freedom of functions of parameters with the `jacobian` (q, m), from the parameters' u (m,) and degrees
    of freedom: their scatter is the same, so that the variances are wrong together.

        1/√ν = Σ w_j/√ν_j,   w_j = (J_j u_j)²/Σ
    """
    parts = (jacobian * u) ** 2
    inverse = np.array([0.0 if d is None else 1.0 / sqrt(d) for d in degrees])
    weight = parts / np.maximum(parts.sum(axis=1, keepdims=True), 1e-300)
    return [None if root**2 * MANY_DEGREES < 1.0 else 1.0 / root**2 for root in (weight @ inverse).tolist()]


def degrees_of_mean(
    own: Iterable[tuple[float, float | None]], run_to_run: float, common: float, *, degrees: float | None = None
) -> tuple[float, float | None]:
    """u and degrees of freedom of the mean of launches (module docstring), from the variances that they know of
    themselves with their degrees of freedom, what is common left out, the standard deviation from launch to launch,
    and the standard uncertainty that is common to all. `degrees` are those of the standard deviation where more than
    these launches show it (`tumble.result.launch_variances`), else L − 1."""
    parts = list(own)
    L = len(parts)
    between, within = run_to_run**2 / L, sum(variance for variance, _ in parts) / L**2
    of_within = welch_satterthwaite((variance / L**2, degrees) for variance, degrees in parts)
    factors = (coverage_factor(inf if d is None else d) for d in (L - 1.0 if degrees is None else degrees, of_within))
    U = max(k * sqrt(variance) for k, variance in zip(factors, (between, within), strict=True))
    square = max(between, within)
    of_square, factor = None, U / sqrt(square) if square > 0.0 else 0.0
    if factor > coverage_factor(MANY_DEGREES):  # the degrees of freedom with this coverage factor
        behind = float(scipy.special.stdtridf(1.0 - 0.5 * erfc(sqrt(2.0)), factor))
        of_square = behind if behind < MANY_DEGREES else None
    return sqrt(square + common**2), welch_satterthwaite([(square, of_square), (common**2, None)])


def gravity_sensitivity(parameters: Sequence[Parameter], covariance: Array | None, site: Site | None) -> Array:
    """Change (m,) of parameters with one standard uncertainty of g, as far as their covariance (m, m) has it: of the
    scale factors of accelerometers alone, in every frame

        c = −(1 + k) u(g)/g · min(1, 1/√(cᵀ C⁻¹ c))

    cᵀ C⁻¹ c is at most 1 where u(g) is in C, somewhat more where a prior took part of it; zero where it is not in C.
    """
    nothing = np.zeros(len(parameters))
    if site is None or covariance is None or site.gravity_u == 0.0:
        return nothing
    relative = site.gravity_u / site.gravity
    scales = [group_name(p.name) == "accel.scale" for p in parameters]  # and not drifts or slopes over temperature
    change = np.array([-(1.0 + p.value) * relative if s else 0.0 for p, s in zip(parameters, scales, strict=True)])
    u = np.sqrt(np.diag(covariance))
    if not change.any() or not np.all(u > 0.0):
        return nothing
    scaled = change / u
    size = float(scaled @ np.linalg.lstsq(covariance / np.outer(u, u), scaled, rcond=None)[0])
    return nothing if size > COUNTED else change / sqrt(max(size, 1.0))


def shared_gravity(first: Site | None, second: Site | None) -> bool:
    """Whether two calibrations used the same stated gravity, with the same uncertainty, whose error they share."""
    if first is None or second is None:
        return False
    return (first.gravity, first.gravity_u) == (second.gravity, second.gravity_u) and first.gravity_u > 0.0


def notes_without_expanded(parameters: Sequence[Parameter]) -> Iterator[str]:
    """Of which parameters no U is stated, their u having too few degrees of freedom."""
    few = {p.name: p.dof for p in parameters if p.dof is not None and p.k is None}
    if few:
        named = ", ".join(few) if len(few) <= MOST_NAMED else f"{len(few)} parameters, first {next(iter(few))}"
        yield (
            f"no U is stated of {named}: {min(few.values()):.1g} degrees of freedom stand behind u, fewer than one; "
            "more rests or turns would give them"
        )
