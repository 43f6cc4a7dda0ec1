"""Expanded uncertainty U = k u of a parameter, with a coverage probability of 95.45 %.

If u is known, the error of a value is normal and k = 2. If u was estimated with ν degrees of freedom, the error in
units of u has Student's t distribution, and

    k = t₉₅.₄₅(ν),   ν = u⁴ / Σ (u_i⁴/ν_i),   u² = Σ u_i²                          (Welch, Satterthwaite)

`Parameter.dof` is ν and `Parameter.k` is k. ν is that of the joint method, or the fewest degrees of freedom of the
rests or turns of a sensor that scatter; after conversion to another frame it is that of the original parameters, taken
as fully correlated. In the mean of L launches

    u² = max(s², n²)/L + g²,   U = max( t(ν) u, U_m ),   U_m = max( t(L − 1) s, t(ν_n) n )/√L,
    ν = u⁴ ν_m / (max(s², n²)/L)²,   t(ν_m) max(s, n)/√L = U_m

with s the standard deviation from launch to launch, n² the mean variance of a launch, with ν_n degrees of freedom, and
g the uncertainty that is common to all launches, such as that of gravity. t(L − 1) s/√L has the stated coverage for any
instability, and no other function of s and n has it (s² is complete); but where launches agree by chance it is far too
small, hence the term of n. The larger of both never covers less: up to 99 % without instability, 96 % if it
is three times n. t(ν) u alone covers as little as 88 % for two launches and 93 % for three, where g is about 0.3 s/√L,
because ν is too large there; the larger of t(ν) u and U_m covers at least 95 %. `Parameter.dof` is that of U/u.

Source: JCGM 100:2008 (GUM), annex G.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from math import erfc, inf, sqrt

import numpy as np
import scipy

from tumble.advice import Advised
from tumble.inference.estimate import Fit
from tumble.recording.session import Site
from tumble.result.parts import Parameter, coverage_factor, stated_factor
from tumble.sensors.parameters import group_name, sensor_kind
from tumble.units import Array

UNLEARNED = 1e-9  # of a variance; a smaller unshared part counts as zero
PROBABILITY = 0.9545  # coverage probability of U
MANY_DEGREES = 1e5  # degrees of freedom; with more, u counts as known
MOST_NAMED = 6  # parameters without U that are listed
GRAVITY_EXCLUDED = 4.0  # cᵀ C⁻¹ c; above it a covariance does not contain the uncertainty of gravity


def expanded(parameter: Parameter) -> float | None:
    """Return U = k u; None if the parameter has no u, or too few degrees of freedom."""
    return None if parameter.u is None else expanded_of(parameter.u, parameter.dof)


def expanded_of(u: float, degrees: float | None) -> float | None:
    """Return U of a standard uncertainty; None if its degrees of freedom are too few. `degrees` None means known."""
    k = stated_factor(degrees)
    return None if k is None else k * u


def welch_satterthwaite(parts: Iterable[tuple[float, float | None]]) -> float | None:
    """Return the degrees of freedom of a sum of independent errors from their variances and degrees; None: known."""
    errors = list(parts)
    spread = sum(variance**2 / degrees for variance, degrees in errors if degrees is not None and degrees > 0.0)
    total = sum(variance for variance, _ in errors) ** 2
    return None if total >= MANY_DEGREES * spread else total / spread


def unshared_variance(u: float | None, degrees: float | None, shared: Iterable[float]) -> tuple[float, float | None]:
    """Return the variance of a parameter without shared standard uncertainties, and its degrees of freedom.

    These are the more of two: of the sum with the shared part by Welch and Satterthwaite, and of the same U (module
    docstring), so that in the mean of launches they are ν_m."""
    variance = (u or 0.0) ** 2
    remaining = variance - sum(each**2 for each in shared)
    remaining = remaining if remaining > UNLEARNED * variance else 0.0
    if degrees is None or remaining == 0.0:
        return remaining, None if degrees is None or variance == 0.0 else 0.0
    ratio = remaining / variance
    of_same_U = degrees_of_factor(coverage_factor(degrees) / sqrt(ratio))
    return remaining, None if of_same_U is None else max(degrees * ratio**2, of_same_U)


def with_degrees(parameters: Iterable[Parameter], fits: Mapping[str, Fit]) -> tuple[Parameter, ...]:
    """Return parameters with the fewest degrees of freedom of the residuals of their kind of sensor that scatter.

    They are unchanged if any of them has degrees of freedom."""
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
    """Return the degrees of freedom of functions of m parameters with the `jacobian` (q, m).

    The variances of the parameters come from the same scatter, so that their errors are fully correlated:

        1/√ν = Σ w_j/√ν_j,   w_j = (J_j u_j)²/Σ
    """
    parts = (jacobian * u) ** 2
    inverse = np.array([0.0 if d is None else 1.0 / sqrt(d) for d in degrees])
    weight = parts / np.maximum(parts.sum(axis=1, keepdims=True), 1e-300)
    return [None if root**2 * MANY_DEGREES < 1.0 else 1.0 / root**2 for root in (weight @ inverse).tolist()]


def u_and_degrees_of_mean(
    launches: Iterable[tuple[float, float | None]], run_to_run: float, common: float
) -> tuple[float, float | None]:
    """Return u and degrees of freedom of the mean of launches (module docstring).

    Parameters
    ----------
    launches
        Variance of each launch without its shared part, and its degrees of freedom.
    run_to_run
        Standard deviation from launch to launch.
    common
        Standard uncertainty that all launches share.
    """
    parts = list(launches)
    L = len(parts)
    between, within = run_to_run**2 / L, sum(variance for variance, _ in parts) / L**2
    within_degrees = welch_satterthwaite((variance / L**2, degrees) for variance, degrees in parts)
    factors = (coverage_factor(inf if d is None else d) for d in (L - 1.0, within_degrees))
    U = max(k * sqrt(variance) for k, variance in zip(factors, (between, within), strict=True))
    variance = max(between, within)
    u = sqrt(variance + common**2)
    if u == 0.0:
        return u, None
    degrees_m = None if variance == 0.0 else degrees_of_factor(U / sqrt(variance))
    dof = welch_satterthwaite([(variance, degrees_m), (common**2, None)])
    return u, dof if coverage_factor(inf if dof is None else dof) * u >= U else degrees_of_factor(U / u)


def degrees_of_factor(factor: float) -> float | None:
    """Return the degrees of freedom with a coverage factor; None if u counts as known."""
    if factor <= coverage_factor(MANY_DEGREES):
        return None
    found = float(scipy.special.stdtridf(1.0 - 0.5 * erfc(sqrt(2.0)), factor))
    return found if found < MANY_DEGREES else None


def gravity_sensitivity(parameters: Sequence[Parameter], covariance: Array | None, site: Site | None) -> Array:
    """Return the change (m,) of parameters by one standard uncertainty of g.

    In every frame only the scale factors k of accelerometers change,

        c = −(1 + k) u(g)/g · min(1, 1/√(cᵀ C⁻¹ c))

    cᵀ C⁻¹ c is at most 1 if u(g) is in the covariance C, and somewhat more if priors reduced it. The change is
    zero if u(g) is not in C."""
    zeros = np.zeros(len(parameters))
    if site is None or covariance is None or site.gravity_u == 0.0:
        return zeros
    relative = site.gravity_u / site.gravity
    scales = [group_name(p.name) == "accel.scale" for p in parameters]  # and not their drifts or slopes
    change = np.array([-(1.0 + p.value) * relative if s else 0.0 for p, s in zip(parameters, scales, strict=True)])
    u = np.sqrt(np.diag(covariance))
    if not change.any() or not np.all(u > 0.0):
        return zeros
    scaled = change / u
    size = float(scaled @ np.linalg.lstsq(covariance / np.outer(u, u), scaled, rcond=None)[0])
    return zeros if size > GRAVITY_EXCLUDED else change / sqrt(max(size, 1.0))


def shared_gravity(first: Site | None, second: Site | None) -> bool:
    """Return True if two calibrations used the same stated gravity with the same uncertainty."""
    if first is None or second is None:
        return False
    return (first.gravity, first.gravity_u) == (second.gravity, second.gravity_u) and first.gravity_u > 0.0


def notes_without_expanded(parameters: Sequence[Parameter]) -> Iterator[str]:
    """Return a note on parameters without U because their u has too few degrees of freedom."""
    few = {p.name: p.dof for p in parameters if p.dof is not None and p.k is None}
    if few:
        named = ", ".join(few) if len(few) <= MOST_NAMED else f"{len(few)} parameters, first {next(iter(few))}"
        yield Advised(
            f"no U is stated for {named}: u has {min(few.values()):.1g} degrees of freedom, fewer than one",
            "record more rests or turns",
        )
