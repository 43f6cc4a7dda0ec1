"""Whether a calibration still holds, from a few rests in any attitude and the turns between them.

The likelihood is that of the method joint, with all that is known of the parameters as one prior. With x the deviation
of gravity and the parameters from what was known, of covariance P, and attitudes and in-run biases eliminated, the
session leaves

    d = R x + n,   n of unit variance,   S = 1 + R P Rᵀ = L Lᵀ,   z = L⁻¹ d,   G = L⁻¹ R                         (1)

and residuals that no x explains. If nothing has changed, z is of unit variance too. A change of parameter j by a,
beyond what P allows, has the estimate, standard uncertainty and test

    a = g_jᵀ z / g_jᵀ g_j,   u = 1/|g_j|,   t_j = a/u   (2)

The t_j of all parameters that the session sees have the correlations of the columns g_j. They would be normal if P were
known. As it is an estimate, they have Student's t distribution with ν_j degrees of freedom,

    1/√ν_j = q_jᵀ D q_j,   q_j = Gᵀ g_j u_j   (3)

with D of `tumble.use.check`: as a part of P is wrong, so is that part of the variance of t_j, all parts
together. The largest |t_j| is compared with what the largest of such numbers exceeds in CHANCE of all cases. Where it
is larger, its parameter is set free, everything is solved again, and so on: that gives the changes together. What no
change explains is judged by χ² = |z|² and the residuals, against MISFIT_CHANCE.

The prior decides nothing of a change: it is beyond it. A change smaller than what turning on again may do is none.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy import special

from tumble.inference.estimate import DETERMINED, Fit
from tumble.inference.hyperparameters import Components
from tumble.inference.likelihood import Point, Prior, Problem, weights
from tumble.inference.linearisation import linearise
from tumble.inference.maximum import integrated, moved
from tumble.inference.start import headings
from tumble.inference.step import solve, tell
from tumble.inference.turns_about import TurnsAbout
from tumble.reduction.observations import Observations
from tumble.rotation import unit_vector
from tumble.sensors.compensation import specific_force
from tumble.sensors.instrument import Instrument
from tumble.sensors.parameters import limits_of
from tumble.units import Array, IntArray

CHANCE = 0.009
"""How often the largest of the tests calls a calibration changed that is not."""
MISFIT_CHANCE = 0.001
"""How often χ² says so."""
POWER = 0.9
"""A change is called detectable that is found as often."""
MOST_CHANGES = 6
AS_LIKELY = 4.0
"""χ² by which another change may explain less and still be named beside the one that explains most."""
DRAWS = 20_000
_LEAST_ROOT = 1e-2  # of χ²/ν
CONVERGED = 1e-2  # of the standard uncertainty
MAX_ITERATIONS = 12


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class KnownBefore:
    """What was known before, SI: values (m,) of the parameters of an instrument; Σ, the covariance (1 + m, 1 + m) of
    gravity and of them as they were `calibrated`, and the variances (1 + m,) of what turning on again changes; for both
    1/ν (1 + m,), ν the degrees of freedom with which they are known; the matrix (1 + m, 1 + m) that took the former to
    the temperature they are for; and the components of variance beside the noise."""

    instrument: Instrument
    values: Array
    calibrated: Array
    turned_on: Array
    inverse_degrees: Array
    turned_on_inverse_degrees: Array
    to_temperature: Array
    components: Components

    @property
    def covariance(self) -> Array:
        """P (1 + m, 1 + m)."""
        return np.asarray(self.calibrated + np.diag(self.turned_on))

    @property
    def doubt(self) -> Array:
        """D (1 + m, 1 + m) of Eq. (3)."""
        return self.doubt_of(self.calibrated) + np.diag(self.turned_on * np.sqrt(self.turned_on_inverse_degrees))

    def doubt_of(self, calibrated: Array) -> Array:
        """The part of D that is of the calibration, for a Σ."""
        N = self.inverse_degrees**0.25
        return np.asarray(N[:, None] * calibrated * N)


@dataclass(frozen=True, kw_only=True, slots=True)
class ChangedParameter:
    """A parameter that has changed by `value`, SI, with standard uncertainty; `others` have changes, by name, that
    explain the session nearly as well."""

    name: str
    unit: str
    value: float
    u: float
    others: Mapping[str, float]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CheckResult:
    """The `changes` that were found; of every parameter that the session sees, by name, (change, its u) as if it alone
    had changed, and the size that is detectable; `largest` of |change|/u and what it may be, `limit`; the `misfit`
    that no change explains; values (m,) and covariance (m, m) of the parameters by calibration and check together."""

    changes: tuple[ChangedParameter, ...]
    tests: Mapping[str, tuple[float, float]]
    detectable: Mapping[str, float]
    largest: float
    limit: float
    misfit: Fit
    values: Array
    covariance: Array

    @staticmethod
    def of(
        instrument: Instrument,
        alone: Tests,
        candidates: IntArray,
        limit: float,
        *,
        changes: tuple[ChangedParameter, ...],
        misfit: Fit,
        values: Array,
        covariance: Array,
    ) -> CheckResult:
        """That of the tests of each of the candidates alone."""
        names = instrument.names
        return CheckResult(
            changes=changes,
            tests={names[j]: (float(alone.t[j] * alone.u[j]), float(alone.u[j])) for j in candidates},
            detectable={names[j]: float((limit + special.ndtri(POWER)) * alone.u[j]) for j in candidates},
            largest=float(np.abs(alone.t[candidates]).max()) if len(candidates) else 0.0,
            limit=limit,
            misfit=misfit,
            values=values,
            covariance=covariance,
        )

    @property
    def explained(self) -> bool:
        """Whether chance and the changes explain the session."""
        return self.misfit.probability >= MISFIT_CHANCE

    @property
    def valid(self) -> bool:
        """Whether nothing has changed, as far as the session sees."""
        return self.explained and not self.changes


def field_check(observations: Observations, known: KnownBefore) -> CheckResult:
    """What a session says of a calibration, see the module's docstring."""
    instrument, limits = known.instrument, limits_of(known.instrument.names)
    free, others = list[int](), list[dict[int, float]]()  # the changed parameters, and what is as likely instead
    problem, point, about = _begun(observations, known)
    first = None
    while True:
        covariance, which = known.covariance.copy(), np.array(free, dtype=int)
        covariance[1 + which, 1 + which] += limits[which] ** 2  # those set free, within their limits
        problem = replace(problem, prior=Prior(covariance=covariance))
        point, about, left = _iterated(problem, point, about, known.components)
        tests = Tests.of(left, covariance, known.doubt)
        candidates, limit, worst = tests.standing_out(instrument, free)
        first = first or (tests, candidates, limit)
        if worst is None or len(free) == MOST_CHANGES:
            break
        free.append(worst)
        least = np.sqrt(max(tests.t[worst] ** 2 - AS_LIKELY, limit**2))
        near = [int(j) for j in candidates if j != worst and abs(tests.t[j]) > least]
        others.append({j: float(tests.t[j] * tests.u[j]) for j in near})
    unfreed = Tests.of(left, known.covariance, known.doubt)
    change, change_u, explained = unfreed.together(free)
    S, PR = np.eye(len(left.d)) + left.R @ covariance @ left.R.T, covariance @ left.R.T
    names = instrument.names
    return CheckResult.of(
        instrument,
        *first,
        changes=tuple(
            ChangedParameter(
                name=names[j],
                unit=instrument.units[j],
                value=float(change[i]),
                u=float(change_u[i]),
                others={names[k]: a for k, a in others[i].items()},
            )
            for i, j in enumerate(free)
        ),
        misfit=Fit(
            chi_square=left.squares + float(unfreed.z @ unfreed.z) - explained,
            degrees=float(left.degrees - len(free)),
            scatter=0.0,
            unit="",
        ),
        values=known.values + (PR @ np.linalg.solve(S, left.d))[1:],
        covariance=(covariance - PR @ np.linalg.solve(S, PR.T))[1:, 1:],
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class WhatIsLeft:
    """R (p, p) and d (p,) of Eq. (1) with p = 1 + m, about what was known; the sum of squares that no x explains, and
    the degrees of freedom of all of them."""

    R: Array
    d: Array
    squares: float
    degrees: int


def left_by(observations: Observations, known: KnownBefore) -> WhatIsLeft:
    """What a session leaves of Eq. (1), with attitudes that are unknown, where nothing has changed."""
    problem, point, about = _begun(observations, known)
    return _iterated(problem, point, about, known.components)[2]


def _begun(observations: Observations, known: KnownBefore) -> tuple[Problem, Point, TurnsAbout | None]:
    """What was known, and attitudes of the verticals that it gives."""
    instrument, turns = known.instrument, observations.turns
    start = dict(zip(instrument.names, known.values.tolist(), strict=True))
    problem = Problem.of(replace(observations, start=start), Prior(covariance=known.covariance), instrument=instrument)
    about = None if turns is None or not len(turns) else TurnsAbout.of(observations, instrument, known.values)
    vertical = unit_vector(specific_force(instrument, known.values, observations.rests.accel))
    attitudes = headings(problem, vertical, known.values, about)
    return problem, Point(values=known.values, gravity=observations.site.gravity, attitudes=attitudes), about


def _iterated(
    problem: Problem, point: Point, about: TurnsAbout | None, components: Components
) -> tuple[Point, TurnsAbout | None, WhatIsLeft]:
    """Gauss–Newton, and what the session's own rows leave at the end."""
    for _ in range(MAX_ITERATIONS):
        rows = linearise(problem, point, about)
        step = solve(problem, rows, weights(problem, rows, components))
        new, change = moved(problem, point, step)
        integral = integrated(problem, new, about)
        u = np.sqrt(np.diag(step.covariance)[1:])
        if integral is about and np.all(np.abs(change) <= CONVERGED * u):
            break
        point, about = new, integral
    rows = linearise(problem, point, about)
    told = tell(problem, rows, weights(problem, rows, components))
    session, off = told.sessions[0], np.append(point.gravity, point.values) - problem.measured[0]
    angles = int(np.count_nonzero(np.diagonal(told.factor, axis1=1, axis2=2)[:, :3]))
    left = WhatIsLeft(
        R=session[:-1, :-1],
        d=session[:-1, -1] + session[:-1, :-1] @ off,
        squares=session[-1, -1] ** 2,
        degrees=sum(each.shape[0] * each.shape[1] for each in told.whitened) - angles,
    )
    return point, about, left


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Tests:
    """z (p,) and G (p, m) of Eq. (1), without the column of gravity; 1/ν (m,) of Eq. (3), and the tests t (m,) of
    Eq. (2) with their u, infinite where the session says nothing."""

    z: Array
    G: Array
    inverse_degrees: Array
    t: Array
    u: Array

    @staticmethod
    def of(left: WhatIsLeft, covariance: Array, doubt: Array) -> Tests:
        """Those of what a session leaves."""
        S = np.eye(len(left.d)) + left.R @ covariance @ left.R.T
        both = np.linalg.solve(np.linalg.cholesky(S), np.column_stack([left.R, left.d]))
        return Tests.whitened(both[:, :-1], both[:, -1], doubt)

    @staticmethod
    def whitened(with_gravity: Array, z: Array, doubt: Array) -> Tests:
        """Those of z and G, with the column of gravity."""
        G = with_gravity[:, 1:]
        u = 1.0 / np.maximum(np.linalg.norm(G, axis=0), 1e-300)
        q = with_gravity.T @ G * u
        inverse = np.einsum("ij,ik,kj->j", q, doubt, q) ** 2
        return Tests(z=z, G=G, inverse_degrees=inverse, t=u * (G.T @ z), u=u)

    def together(self, free: Sequence[int]) -> tuple[Array, Array, float]:
        """The changes (k,) of some parameters together, their u (k,), and how much of |z|² they explain."""
        Q, R = np.linalg.qr(self.G[:, free])
        along, inverse = Q.T @ self.z, np.linalg.inv(R)
        return inverse @ along, np.sqrt((inverse**2).sum(axis=1)), float(along @ along)

    def standing_out(self, instrument: Instrument, without: Container[int]) -> tuple[IntArray, float, int | None]:
        """The parameters of the linear model that the session sees, beside some that are free; what the largest |t| of
        them exceeds by chance; and the one that exceeds it most, None where none does."""
        known = self.u < limits_of(instrument.names) / DETERMINED
        candidates = np.array([j for j in range(instrument.linear_count) if known[j] and j not in without], dtype=int)
        limit = self.limit(candidates)
        if not len(candidates):
            return candidates, limit, None
        worst = int(candidates[np.argmax(np.abs(self.t[candidates]))])
        return candidates, limit, worst if abs(self.t[worst]) > limit else None

    def limit(self, candidates: IntArray) -> float:
        """What the largest |t| of the candidates exceeds in CHANCE of all cases."""
        if not len(candidates):
            return np.inf
        lower = np.linalg.qr(self.G[:, candidates] * self.u[candidates], mode="r")
        drawn = _normal(len(lower) + 1)
        wider = _student(drawn[:, -1:], self.inverse_degrees[candidates])
        return float(np.quantile((np.abs(drawn[:, :-1] @ lower) * wider).max(axis=1), 1.0 - CHANCE))


def _student(normal: Array, inverse_degrees: Array) -> Array:
    """√(ν/χ²_ν) by which a normal number becomes one of Student's t, from another normal number (Wilson & Hilferty)."""
    ninth = 2.0 / 9.0 * inverse_degrees
    return np.asarray(np.maximum(1.0 - ninth + np.sqrt(ninth) * normal, _LEAST_ROOT) ** -1.5)


@cache
def _normal(size: int) -> Array:
    """The same normal numbers (DRAWS, size) for every check."""
    return np.random.default_rng(20190).standard_normal((DRAWS, size))
