"""A device type as its units show it, and as a prior for the next unit.

A recording of a unit says of its parameters together, with the estimate x, C, and what was usual of a grade, the
precisions P about zero, taken out, so that no evidence counts twice,

    Λ = C⁻¹ − P,   h = Λ x + P x                                                                                    (1)

C is a mean over hyperparameters, so that Λ is known but for small parts of it. Of h = C⁻¹ x these would be multiplied
by a whole scale factor error, thousands of times its u, and make a cubic term of it; as it stands, P x has but what the
prior pulled: terms that are small.

Units differ in their parameters by d ~ N(0, B), B = diag(τ²), about the means μ of the type, of which the usual sizes
are all that is known before. (B has no more than its diagonal: n units tell no covariance of n parameters, and one that
is known, with correlations of 0.5, takes 4 % off u: docs/evidence/registry.md.) Given B the means and their covariance
are

    M = (P + Σ Λ_i (1 + B Λ_i)⁻¹)⁻¹,   μ̂ = M Σ (1 + Λ_i B)⁻¹ h_i                                                    (2)

a combination that no recording shows, as of bias and K₂ at rest, stays unknown in M, however many units there are.
Recordings of one unit differ by what changes from power-on to power-on as well, of variance ρ², so that a single one
counts with Λ (1 + diag(ρ²) Λ)⁻¹; the mean of several launches has its share of ρ² in C.

How far units differ is seen in their differences. Beside the type of all other parameters a unit's recordings give the
value y_i of one with the variance v_i, and of these the restricted likelihood (REML) and Jeffreys' prior are

    ℓ(τ²) = ½ Σ ln w_i − ½ ln Σ w_i − ½ Σ w_i (y_i − ȳ)²,   w_i = 1/(τ² + v_i),   π(τ²) ∝ √(Σ w_i²)               (3)

Parameters of a group (the three biases of the gyros) share τ: their ℓ add up, and so do the Σ w_i² under the root, as
long as they do not contradict it (Bartlett's test at 5 %; then each has its own). What is usual of a grade is usual of
units of all types: τ² of a group beyond the linear model is at most that, and P of the means leaves it out. (2) and (3)
are repeated until nothing moves. A recording of another unit has x = μ + d with the means of (2), and for each
parameter a mixture

    d ~ ∫ N(0, τ² + ρ²) p(τ² | y) dτ²                                                                               (4)

over a grid of τ². Of exact values of one parameter π ∝ 1/τ², p(τ² | y) is inverse gamma of shape (n − 1)/2 and scale
Σ(y_i − ȳ)²/2, M = τ²/n, and x is exactly ȳ + s √(1 + 1/n) t, Student's t with n − 1 degrees of freedom: what few units
widen it by. (That M grows with τ² is kept in (4) as its share (τ² − τ̂²)/n beyond the τ̂ of (2).) Fewer than three units
are no type: with two, t has one degree of freedom and not even a mean.

Combined with the likelihood of a recording, Λ, of all parameters together, every (4) is the normal distribution that
gives its parameter the same mean and variance beside all the rest (expectation propagation). Tails as those of t give
way: of a unit that contradicts its type the type says little. Where chance makes a value as unlike in fewer than one of
a hundred units, over all parameters (Holm), it is named, and the type says nothing of it.

Sources: Patterson & Thompson, Biometrika 58 (1971) 545 (REML); Bodnar, Link & Elster, Bayesian Anal. 11 (2016) 25, and
Box & Tiao (1973), 5.2 (the prior of (3)); Bartlett, Proc. R. Soc. A 160 (1937) 268; Minka, UAI (2001) 362.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from tumble.errors import InputError
from tumble.inference.estimate import Estimate
from tumble.inference.prediction import prediction
from tumble.inference.sources import UncertaintyBudget, source
from tumble.lab.type_spread import KnownLaunches, known_launches
from tumble.reduction.observations import Observations
from tumble.result.calibration import Calibration
from tumble.result.parts import Parameter
from tumble.sensors.parameters import (
    Variable,
    group_name,
    group_of,
    limits_of,
    positions_by_group,
    shown_in,
    to_temperature,
    variable_of,
)
from tumble.units import Array

FEWEST_UNITS = 3
LEAST_LEARNED = 0.05
"""Of the variance of a prior: a recording that has taken off less says nothing of a parameter."""
CONTRADICTS = 0.05
"""Parameters of a group have a τ each where chance makes them as different less often."""
UNLIKE = 0.01
"""A value is unlike its type where chance makes any of a unit's as unlike less often."""
MOST_ROUNDS = 30
"""Repetitions of what is learned beside what is learned of the others."""
STILL = 0.02
"""Of its u, by which a mean still moves when that is enough."""
GRID = 300
"""Values of τ²."""
FARTHEST = 1e6
"""Times the largest variance of the values that τ² reaches."""
MOST_STEPS = 60
SETTLED = 1e-4
"""Of the precision of a parameter, by which a step still moves it when it is taken for settled."""

_OF_A_SESSION: tuple[Variable, ...] = ("time", "launch", "lag")
"""What parameters go with that are no property of a device, or are positive."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class KnownCalibration:
    """What one recording of a unit says by itself of its parameters, the `names` (m,): the information Λ (m, m) and
    h (m,), SI, Eq. (1), at the `reference`, °C, if it is known; the `usual` precisions (m,) of the grade; of which it
    says anything, `says`; the standard deviations of the in-run biases of "accel" and "gyro", SI; and the launches
    behind it, where it is the mean of several."""

    serial: str
    logs: frozenset[str]
    names: tuple[str, ...]
    information: Array
    shift: Array
    usual: Array
    says: frozenset[str]
    in_run: Mapping[str, float]
    reference: float | None
    launches: KnownLaunches | None

    @staticmethod
    def of(
        parameters: Sequence[Parameter],
        covariance: Array,
        *,
        serial: str,
        logs: Collection[str],
        in_run: Mapping[str, float],
        reference: float | None = None,
        launches: KnownLaunches | None = None,
    ) -> KnownCalibration:
        """What parameters with their covariance (m, m) say, beside those that are no property of a device."""
        kept = [i for i, p in enumerate(parameters) if p.u and variable_of(p.name) not in _OF_A_SESSION]
        own, C = [parameters[i] for i in kept], covariance[np.ix_(kept, kept)]
        prior = np.array([0.0 if p.prior is None else p.prior**-2 for p in own])
        limits = limits_of(p.name for p in own) ** -2.0
        root, values = np.linalg.cholesky(C), np.array([p.value for p in own])
        share, axes = np.linalg.eigh(root.T @ (prior[:, None] * root))  # of the prior in C⁻¹, at most all
        alone = np.linalg.solve(root.T, axes)
        learned = 1.0 - np.diag(C) * prior
        information = (alone * np.clip(1.0 - share, 0.0, None)) @ alone.T
        return KnownCalibration(
            serial=serial,
            logs=frozenset(logs),
            names=tuple(p.name for p in own),
            information=information,
            shift=information @ values + prior * values,
            usual=np.where(prior > 0.0, prior, limits),
            says=frozenset(p.name for p, part in zip(own, learned.tolist(), strict=True) if part > LEAST_LEARNED),
            in_run=in_run,
            reference=reference,
            launches=launches,
        )

    def at(self, reference: float | None) -> KnownCalibration:
        """The same at another temperature, °C, by its slopes and curvatures."""
        if reference is None or self.reference is None:
            return self
        back = to_temperature(self.names, self.reference - reference)
        information = back.T @ self.information @ back
        return replace(self, information=information, shift=back.T @ self.shift, reference=reference)

    def of_names(self, names: Sequence[str]) -> tuple[Array, Array]:
        """Information and shift of these parameters (n, n), (n,), whatever the others are within their usual sizes; of
        those that it does not have, nothing."""
        at = [self.names.index(name) for name in names if name in self.names]
        others = [i for i in range(len(self.names)) if i not in at]
        whole = self.information[np.ix_(others, others)] + np.diag(self.usual[others])
        across = self.information[np.ix_(at, others)]
        by = across @ _inverse(whole)
        here = [i for i, name in enumerate(names) if name in self.names]
        information, shift = np.zeros((len(names), len(names))), np.zeros(len(names))
        information[np.ix_(here, here)] = self.information[np.ix_(at, at)] - by @ across.T
        shift[here] = self.shift[at] - by @ self.shift[others]
        return information, shift

    def beside(self, sites: Mapping[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        """By parameter of which it says anything the value and its variance beside what else is known of the others:
        normal distributions by their means and precisions, or their usual sizes."""
        means, precisions = np.zeros(len(self.names)), self.usual.copy()
        for i, name in enumerate(self.names):
            means[i], precisions[i] = sites.get(name, (means[i], precisions[i]))
        covariance = _inverse(self.information + np.diag(precisions))
        values, variances = covariance @ (self.shift + precisions * means), np.diag(covariance)
        out = {}
        for i, name in enumerate(self.names):
            alone = 1.0 / variances[i] - precisions[i]
            if name in self.says and alone > 0.0:
                out[name] = float((values[i] / variances[i] - precisions[i] * means[i]) / alone), float(1.0 / alone)
        return out


def known_calibration(calibration: Calibration) -> KnownCalibration | None:
    """What a calibration says by itself, in the frame of the accelerometers; None where it has no covariance, or where
    a type was its prior: what others say of a unit is no evidence of it."""
    framed = calibration.in_frame("accelerometer")
    if "type" in calibration.provenance or framed.covariance is None:
        return None
    logs = {launch.log_sha256 for launch in calibration.launches} | {calibration.provenance.get("log_sha256", "")}
    sizes = {h.name: h.value for h in calibration.hyperparameters}
    return KnownCalibration.of(
        framed.parameters,
        framed.covariance,
        serial=calibration.serial,
        logs=logs - {""},
        in_run={kind: sizes[f"{kind}_in_run"] for kind in ("accel", "gyro") if f"{kind}_in_run" in sizes},
        reference=calibration.reference_temperature,
        launches=known_launches(calibration),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TypeParameter:
    """How far units differ in a parameter, SI: the `values` (n,) and variances (n,) of the units, Eq. (3); the standard
    deviation `between` them by restricted likelihood, and that from run to run, None where no unit was recorded twice;
    and (4) as `weights` (k,) of normal distributions of the `variances` (k,)."""

    name: str
    values: Array
    own_variances: Array
    between: float
    run_to_run: float | None
    weights: Array
    variances: Array

    @property
    def units(self) -> int:
        """How many there are."""
        return len(self.values)

    @property
    def variance(self) -> float:
        """A variance, SI², for (4), whose own may be infinite: its geometric mean over the mixture."""
        return float(np.exp(self.weights @ np.log(self.variances)))

    def beside(self, mean: float, variance: float) -> tuple[float, float]:
        """Mean and variance of the difference of a unit from its type, of which N(mean, variance) is what else is
        known."""
        total = variance + self.variances
        log_weight = np.log(self.weights + 1e-300) - 0.5 * (np.log(total) + mean**2 / total)
        weight = np.exp(log_weight - log_weight.max())
        weight /= weight.sum()
        means = mean * self.variances / total
        whole = float(weight @ means)
        return whole, float(weight @ (variance * self.variances / total + (means - whole) ** 2))

    def chance(self, value: float, variance: float) -> float:
        """How probable it is that a unit of the type, recorded with this variance, differs as much."""
        return 2.0 * float(self.weights @ scipy.special.ndtr(-abs(value) / np.sqrt(variance + self.variances)))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LearnedType:
    """What the units of a type say: the `parameters` by name, and in this order their means (L,) with covariance
    (L, L), SI, Eq. (2)."""

    parameters: Mapping[str, TypeParameter]
    mean: Array
    covariance: Array


@dataclass(frozen=True, kw_only=True, slots=True)
class DeviceType:
    """All recordings that are known of units of a type, in the frame of the accelerometers."""

    model: str
    known: tuple[KnownCalibration, ...]

    @property
    def units(self) -> int:
        """How many units there are."""
        return len({each.serial for each in self.known})

    def without(self, serial: str, logs: Collection[str] = ()) -> DeviceType:
        """Without a unit, and without recordings that have one of these logs."""
        kept = [each for each in self.known if each.serial != serial and not each.logs & set(logs)]
        return replace(self, known=tuple(kept))

    def in_run(self, kind: str) -> list[float]:
        """The standard deviations of the in-run biases of the units' accelerometers or gyros, SI, a unit its median."""
        units: dict[str, list[float]] = {}
        for each in self.known:
            if kind in each.in_run:
                units.setdefault(each.serial, []).append(each.in_run[kind])
        return [float(np.median(own)) for own in units.values()]

    def prior(self, names: Sequence[str]) -> tuple[list[int], Array]:
        """Of these parameters the places (k,) of those of whose whole group the units say anything, and the covariance
        (k, k) of the differences of another unit from the means of the type, SI: for a plan. Raises InputError for
        fewer than FEWEST_UNITS."""
        if self.units < FEWEST_UNITS:
            raise InputError(f"type {self.model!r}: expected at least {FEWEST_UNITS} units, found {self.units}")
        learned = self.learned()
        places = _places(names, list(learned.parameters))
        at, of = list(places), list(places.values())
        own = [learned.parameters[names[i]].variance for i in at]
        return at, learned.covariance[np.ix_(of, of)] + np.diag(own)

    def learned(self, reference: float | None = None) -> LearnedType:
        """What the units say of every parameter of which FEWEST_UNITS say anything, at a temperature, °C."""
        known = [each.at(reference) for each in self.known]
        launches = [each.launches for each in self.known if each.launches is not None]
        says: dict[str, set[str]] = {}
        for each in known:
            for name in each.names:
                says.setdefault(name, set()).update({each.serial} if name in each.says else ())
        names = [name for name, serials in says.items() if len(serials) >= FEWEST_UNITS]
        alone = [(each, *each.of_names(names)) for each in known]
        usual = [min(each.usual[each.names.index(name)] for each in known if name in each.names) for name in names]
        mean, M, parameters = np.zeros(len(names)), np.diag(1.0 / np.array(usual)), dict[str, TypeParameter]()
        widths = dict[str, float]()
        for _ in range(MOST_ROUNDS if names else 0):
            of_mean = dict(zip(names, mean.tolist(), strict=True))
            for name, parameter in parameters.items():  # damped, since two that are seen together narrow by turns
                widths[name] = float(np.sqrt(widths.get(name, parameter.variance) * parameter.variance))
            sites = {name: (of_mean[name], 1.0 / width) for name, width in widths.items()}
            units: dict[str, dict[str, list[tuple[float, float, bool]]]] = {name: {} for name in names}
            for each in known:
                for name, (value, variance) in each.beside(sites).items():
                    if name in units:
                        units[name].setdefault(each.serial, []).append((value, variance, each.launches is None))
            found: dict[str, TypeParameter] = {}
            for members in positions_by_group(names).values():
                group = {names[i]: list(units[names[i]].values()) for i in members}
                most = 1.0 / min(usual[i] for i in members)
                found |= {each.name: each for each in _of_group(group, launches, most)}
            parameters = {name: found[name] for name in names}
            before, (mean, M) = mean, _means(parameters, alone, np.array(usual))
            if np.all(np.abs(mean - before) < STILL * np.sqrt(np.diag(M))):
                break
        return LearnedType(parameters=parameters, mean=mean, covariance=M)


def _places(names: Sequence[str], known: Sequence[str]) -> dict[int, int]:
    """By place among the names that among the known, of the groups that are known as a whole."""
    whole = {g: all(names[i] in known for i in members) for g, members in positions_by_group(names).items()}
    return {i: known.index(name) for i, name in enumerate(names) if whole[group_name(name)]}


def _means(
    parameters: Mapping[str, TypeParameter], alone: Sequence[tuple[KnownCalibration, Array, Array]], usual: Array
) -> tuple[Array, Array]:
    """The means of a type (L,) and their covariance (L, L), Eq. (2)."""
    one, units = np.eye(len(usual)), dict[str, tuple[Array, Array]]()
    rho2 = np.array([(each.run_to_run or 0.0) ** 2 for each in parameters.values()])
    B = np.array([each.variance for each in parameters.values()]) - rho2
    for each, information, shift in alone:
        if each.launches is None:
            apart = np.linalg.inv(one + information * rho2)
            information, shift = apart @ information, apart @ shift
        before = units.get(each.serial, (np.zeros_like(one), np.zeros(len(usual))))
        units[each.serial] = before[0] + information, before[1] + shift
    of_types = np.maximum(1.0 / usual - B, 0.1 / usual)  # the usual variance but for what units of a type differ by
    precision, pull = np.diag(1.0 / of_types), np.zeros(len(usual))
    for information, shift in units.values():
        apart = np.linalg.inv(one + information * B)
        precision, pull = precision + apart @ information, pull + apart @ shift
    M = _inverse(0.5 * (precision + precision.T))
    return M @ pull, M


def _inverse(matrix: Array) -> Array:
    """The inverse of a symmetric matrix whose rows may be of very different sizes."""
    size = np.sqrt(np.diag(matrix))
    return np.asarray(np.linalg.inv(matrix / np.outer(size, size)) / np.outer(size, size))


_Recordings = Sequence[Sequence[tuple[float, float, bool]]]
"""By unit, of every recording its value, variance, and whether it is a single launch."""


def _of_group(
    group: Mapping[str, _Recordings], launches: Sequence[KnownLaunches], most: float
) -> Iterable[TypeParameter]:
    """What is said of the parameters of a group, Eqs. (3) and (4), whose τ² is `most` at most."""
    rho2 = _run_to_run(group, launches)
    values, variances = [], []
    for units in group.values():
        weights = [np.array([1.0 / (v + (rho2 or 0.0) * single) for _, v, single in own]) for own in units]
        means = [w @ np.array([y for y, _, _ in own]) / w.sum() for w, own in zip(weights, units, strict=True)]
        values.append(np.array(means))
        variances.append(np.array([1.0 / w.sum() for w in weights]))
    largest = max(float(y.var(ddof=1) + v.max()) for y, v in zip(values, variances, strict=True))
    least = max(min(most, *(float(v.min()) for v in variances)), 1e-8 * largest)
    theta = (np.arange(GRID) + 0.5) / GRID * np.log(FARTHEST * largest / least)  # τ² = least (e^θ − 1)
    tau2 = least * np.expm1(theta)
    likelihoods, information = zip(
        *(_restricted(*each, tau2) for each in zip(values, variances, strict=True)), strict=True
    )
    together = np.sum(likelihoods, axis=0)
    degrees = np.array([len(y) - 1.0 for y in values])
    apart = sum(each.max() for each in likelihoods) - together.max()
    correction = 1.0 + (np.sum(1.0 / degrees) - 1.0 / degrees.sum()) / max(3.0 * (len(group) - 1.0), 1.0)
    differ = len(group) > 1 and scipy.special.chdtrc(len(group) - 1, 2.0 * apart / correction) < CONTRADICTS
    for i, name in enumerate(group):
        likelihood = likelihoods[i] if differ else together
        prior = 0.5 * np.log(information[i] if differ else np.sum(information, axis=0)) + theta
        possible = tau2 <= max(most, 2.0 * tau2[0])  # at least the smallest
        density = np.where(possible, np.exp(likelihood + prior - np.max((likelihood + prior)[possible])), 0.0)
        best = int(np.argmax(np.where(possible, likelihood, -np.inf)))
        yield TypeParameter(
            name=name,
            values=values[i],
            own_variances=variances[i],
            between=float(np.sqrt(tau2[best])),
            run_to_run=None if rho2 is None else float(np.sqrt(rho2)),
            weights=density / density.sum(),
            variances=tau2 + np.maximum(tau2 - tau2[best], 0.0) / len(values[i]) + (rho2 or 0.0),
        )


def _restricted(y: Array, v: Array, tau2: Array) -> tuple[Array, Array]:
    """ℓ of Eq. (3) of values y (n,) with variances v (n,) for each τ² (k,), and Σ w²."""
    w = 1.0 / (tau2[:, None] + v)
    total = w.sum(axis=1)
    off = y - (w @ y / total)[:, None]
    return 0.5 * (np.log(w).sum(axis=1) - np.log(total) - (w * off**2).sum(axis=1)), (w**2).sum(axis=1)


def _run_to_run(group: Mapping[str, _Recordings], launches: Sequence[KnownLaunches]) -> float | None:
    """ρ² of a group, by the restricted likelihood of single launches about the mean of their unit, and of launches
    about the mean of a calibration; None where there are no two of a unit."""
    repeated = [
        np.array([(y, v) for y, v, single in own if single]).T
        for units in group.values()
        for own in units
        if sum(single for _, _, single in own) > 1
    ]
    behind = [(each.degrees, *each.variances[name]) for each in launches for name in group if name in each.variances]
    sizes = [float(y.var(ddof=1) + v.mean()) for y, v in repeated] + [s2 + n2 for _, s2, n2 in behind]
    if not sizes or max(sizes) == 0.0:
        return None
    grid = np.append(0.0, np.geomspace(1e-8, 1e2, GRID)) * max(sizes)
    log = np.zeros(len(grid))
    floor = 1e-12 * max(sizes)
    for y, v in repeated:
        log += 2.0 * _restricted(y, v + floor, grid)[0]
    for degrees, s2, n2 in behind:
        log -= degrees * (np.log(grid + n2 + floor) + s2 / (grid + n2 + floor))
    return float(grid[np.argmax(log)])


# The prior of another unit


def with_in_run(observations: Observations, device_type: DeviceType) -> Observations:
    """The observations with the usual size of in-run biases by the type, where enough units say it."""
    sizes = {kind: device_type.in_run(kind) for kind in ("accel", "gyro")}
    known = {kind: float(np.exp(np.mean(np.log(own)))) for kind, own in sizes.items() if len(own) >= FEWEST_UNITS}
    return replace(observations, in_run={**observations.in_run, **known})


def with_type(
    estimate: Estimate, observations: Observations, device_type: DeviceType, reference: float | None = None
) -> tuple[Estimate, tuple[str, ...]]:
    """An estimate of the method joint of another unit of a type, at the temperature `reference`, °C, with what the type
    says in the place of what is usual of a grade; and sentences on it: how many units, what is unlike them. The same
    estimate where there are fewer than FEWEST_UNITS."""
    model, units = device_type.model, device_type.units
    if units < FEWEST_UNITS or estimate.budget is None or estimate.linearised is None:
        few = f"the type {model!r} has {units} other units in the registry: no prior by fewer than {FEWEST_UNITS}"
        return estimate, (few,)
    learned, names = device_type.learned(reference), estimate.names
    further, places = {group.name for group in estimate.groups}, _places(names, list(learned.parameters))
    if not places:
        return estimate, (f"the {units} other units of the type {model!r} say nothing of these parameters",)

    # the information Λ and h of the recording alone, with the usual sizes that the type replaces taken out
    C, budget, m = estimate.covariance, estimate.budget, len(names)
    replaced = {f"prior.{group_name(names[i])}" for i in places if group_name(names[i]) in further}
    own = np.array([each.name not in replaced for each in budget.sources])
    precision = _inverse(C)
    data = precision @ budget.covariances[own].sum(axis=0) @ precision
    is_replaced = np.array([f"prior.{group_name(name)}" in replaced for name in names])
    pulled = np.where(is_replaced, estimate.values - [observations.start.get(name, 0.0) for name in names], 0.0)
    shift = data @ estimate.values + (precision - data) @ pulled

    # how it differs from the means of the type: their covariance is that of a common error
    at, of = list(places), list(places.values())
    mean, M = np.zeros(m), np.zeros((m, m))
    mean[at], M[np.ix_(at, at)] = learned.mean[of], learned.covariance[np.ix_(of, of)]
    apart = np.linalg.inv(np.eye(m) + data @ M)
    parameters = {i: learned.parameters[names[i]] for i in places}
    differs = 0.5 * (apart @ data + (apart @ data).T), apart @ (shift - data @ mean)
    sites, beside = _propagated(*differs, parameters)
    probabilities = {i: each.chance(*beside[i]) for i, each in parameters.items()}
    unlike = []
    for place, i in enumerate(sorted(parameters, key=lambda i: probabilities[i])):
        if probabilities[i] * (len(parameters) - place) >= UNLIKE:
            break
        unlike.append(i)
    if unlike:
        sites, _ = _propagated(*differs, {i: each for i, each in parameters.items() if i not in unlike})

    # beside the type, which is N(mean, variances); and the covariance by source, of the recording as it moves
    # the estimate now, and of the type
    at = list(sites)
    own_variances, own_means = np.array(list(sites.values())).T
    variances, by_type = M[np.ix_(at, at)] + np.diag(own_variances), np.zeros((m, m))
    mean[at] += own_means
    by_type[np.ix_(at, at)] = _inverse(variances)
    covariance = _inverse(data + by_type)
    values, moves = covariance @ (shift + by_type @ mean), covariance @ precision
    kept = UncertaintyBudget(
        sources=tuple(each for each, is_own in zip(budget.sources, own, strict=True) if is_own),
        covariances=moves @ budget.covariances[own] @ moves.T,
    ).beside(source("type"), covariance @ by_type @ covariance)
    covariance = kept.covariances.sum(axis=0)
    problem, before = estimate.linearised.problem, estimate.prediction
    instrument, observable = problem.instrument, estimate.observable.copy()
    observable[[i for i in at if group_name(names[i]) in further]] = True
    gravity, rate = observations.site.gravity, None if before is None else before.at_rate
    made = replace(
        estimate,
        values=values,
        covariance=covariance,
        observable=observable,
        accel=problem.accel_model(values),
        gyro=None if estimate.gyro is None else problem.gyro_model(values),
        prediction=prediction(instrument, values, covariance, gravity=gravity, rate=rate),
        budget=kept,
        of_type={names[i]: float(np.sqrt(v)) for i, v in zip(at, np.diag(variances), strict=True)},
    )
    said = f"{units} other units of the type {model!r} are a prior of {len(sites)} parameters"
    said += f", in the place of what is usual of {len(replaced)} groups" if replaced else ""
    sentences = [said]
    for i in unlike:
        (off, variance), each = beside[i], parameters[i]
        size, unit = shown_in(each.name, group_of(each.name).unit, off)
        times = abs(off) / float(np.sqrt(each.variance + variance))
        sentences.append(
            f"unlike its type: {each.name} is {off / size:+.3g} {unit} from the mean of {each.units} other units, "
            f"{times:.1f} times what these differ by (by chance with probability {probabilities[i]:.1g}); the type "
            "says nothing of it here"
        )
    return made, tuple(sentences)


def _propagated(
    data: Array, shift: Array, parameters: Mapping[int, TypeParameter]
) -> tuple[dict[int, tuple[float, float]], dict[int, tuple[float, float]]]:
    """Variance and mean of the normal distribution that the difference of each parameter, by its place, is taken for,
    where it is of any weight, by the information (m, m) and its right-hand side (m,) on all differences; and what is
    known of a difference beside its own distribution, mean and variance."""
    site, pull, beside = np.zeros(len(shift)), np.zeros(len(shift)), dict[int, tuple[float, float]]()
    for i, each in parameters.items():
        site[i] = 1.0 / each.variance
    for _ in range(MOST_STEPS):
        covariance = _inverse(data + np.diag(site))
        values, variances = covariance @ (shift + pull), np.diag(covariance)
        moved = 0.0
        for i, each in parameters.items():
            variance = 1.0 / max(1.0 / variances[i] - site[i], 1e-12 / variances[i])
            mean = variance * (values[i] / variances[i] - pull[i])
            beside[i] = float(mean), float(variance)
            whole, own = each.beside(*beside[i])
            new = max(1.0 / own - 1.0 / variance, 0.0)
            new_pull = whole / own - mean / variance if new > 0.0 else 0.0
            moved = max(moved, abs(new - site[i]) * variances[i], abs(new_pull - pull[i]) * np.sqrt(variances[i]))
            site[i], pull[i] = 0.5 * (site[i] + new), 0.5 * (pull[i] + new_pull)
        if moved < SETTLED:
            break
    weighty = [i for i in parameters if site[i] * variances[i] > SETTLED]
    return {i: (float(1.0 / site[i]), float(pull[i] / site[i])) for i in weighty}, beside
