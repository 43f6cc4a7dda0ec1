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
`tumble.methods.rest_chain` has the same of one rest after the other.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import scipy

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
from tumble.units import Array

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
    session, limits = SessionRows(observations, known), limits_of(known.instrument.names)

    def evidence_with(free: Sequence[int]) -> Evidence:
        """Linearised where these parameters are free, within their limits."""
        covariance, opened = known.covariance, np.array(free, dtype=int)
        covariance[1 + opened, 1 + opened] += limits[opened] ** 2
        R, d, squares, degrees = session.left(covariance)
        G, z, gain, A = update(R, d, known.covariance)
        return Evidence(
            z=z,
            G=G,
            values=known.values + (gain @ z)[1:],
            covariance=(A @ known.covariance)[1:, 1:],
            passed_on=A[1:],
            squares=squares,
            degrees=degrees,
        )

    return changes_in(evidence_with, known.instrument, known.doubt)


def update(R: Array, d: Array, P: Array) -> tuple[Array, Array, Array, Array]:
    """G and z of Eq. (1) for an x of covariance P (k, k), the gain P Gᵀ (k, p) with which z changes what is known of x,
    and A = 1 − P Gᵀ G (k, k), by which the covariance becomes A P."""
    L = np.linalg.cholesky(np.eye(len(R)) + R @ P @ R.T)
    both = np.linalg.solve(L, np.column_stack([R, d]))
    G, gain = both[:, :-1], P @ both[:, :-1].T
    return G, both[:, -1], gain, np.eye(len(P)) - gain @ G


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Evidence:
    """What is said beyond what was known: z (p,) and G (p, k) of Eq. (1), of the x at the beginning, of which the first
    1 + m are gravity and the parameters; values (m,) and covariance (m, m) of the parameters by both together, where
    nothing has changed, and by how much a change of x puts these off, `passed_on` (m, k); the sum of squares that no x
    explains, and the degrees of freedom of all of them."""

    z: Array
    G: Array
    values: Array
    covariance: Array
    passed_on: Array
    squares: float
    degrees: float


def changes_in(
    evidence_with: Callable[[Sequence[int]], Evidence],
    instrument: Instrument,
    doubt: Array,
    found: Sequence[ChangedParameter] = (),
) -> CheckResult:
    """The changes beside those that are `found` already, by the evidence where some parameters are free; `doubt` is
    D (1 + m, 1 + m) of what was known of x at the beginning."""
    names, m, limits = instrument.names, len(instrument.names), limits_of(instrument.names)
    already = [names.index(change.name) for change in found]
    free, others, alone = list[int](), list[dict[str, float]](), dict[str, Any]()
    while True:
        evidence = evidence_with(free)
        opened = np.zeros(evidence.G.shape[1])
        opened[[1 + j for j in free]] = limits[free] ** 2
        whole, z, gain, _ = update(evidence.G, evidence.z, np.diag(opened))
        G = whole[:, 1 : 1 + m]
        u = 1.0 / np.maximum(np.linalg.norm(G, axis=0), 1e-300)
        t, q = u * (G.T @ z), whole[:, : 1 + m].T @ G * u
        inverse_degrees = np.einsum("ij,ik,kj->j", q, doubt, q) ** 2
        seen = u[: instrument.linear_count] < limits[: instrument.linear_count] / DETERMINED
        seen[[*free, *already]] = False
        candidates, limit = np.flatnonzero(seen), np.inf
        if len(candidates):
            lower = np.linalg.qr(G[:, candidates] * u[candidates], mode="r")
            drawn = _normal(len(lower) + 1)
            wider = _student(drawn[:, -1:], inverse_degrees[candidates])
            limit = float(np.quantile((np.abs(drawn[:, :-1] @ lower) * wider).max(axis=1), 1.0 - CHANCE))
        largest = float(np.abs(t[candidates]).max(initial=0.0))
        alone = alone or {
            "tests": {names[j]: (float(t[j] * u[j]), float(u[j])) for j in candidates},
            "detectable": {names[j]: float((limit + scipy.special.ndtri(POWER)) * u[j]) for j in candidates},
            "largest": largest,
            "limit": limit,
        }
        if largest <= limit or len(free) + len(already) >= MOST_CHANGES:
            break
        worst, least = int(candidates[np.abs(t[candidates]).argmax()]), max(largest**2 - AS_LIKELY, limit**2) ** 0.5
        free.append(worst)
        others.append({names[j]: float(t[j] * u[j]) for j in candidates if j != worst and abs(t[j]) > least})

    # the changes together, and what they explain of |z|²
    Q, along = np.linalg.qr(evidence.G[:, [1 + j for j in free]])
    inverse, explained = np.linalg.inv(along), Q.T @ evidence.z
    together, together_u = inverse @ explained, np.sqrt((inverse**2).sum(axis=1))
    passed = evidence.passed_on @ gain
    return CheckResult(
        **alone,
        changes=(
            *found,
            *(
                ChangedParameter(name=names[j], unit=instrument.units[j], value=float(a), u=float(a_u), others=alike)
                for j, a, a_u, alike in zip(free, together, together_u, others, strict=True)
            ),
        ),
        misfit=Fit(
            chi_square=evidence.squares + float(evidence.z @ evidence.z - explained @ explained),
            degrees=float(evidence.degrees - len(free)),
            scatter=0.0,
            unit="",
        ),
        values=evidence.values + passed @ z,
        covariance=evidence.covariance + (evidence.passed_on * opened) @ evidence.passed_on.T - passed @ passed.T,
    )


# -------------------- what a session leaves --------------------


class SessionRows:
    """The rows of a session, with attitudes that are unknown, about parameters that are found from them again and
    again, from what was known on."""

    def __init__(self, observations: Observations, known: KnownBefore) -> None:
        instrument, turns, values = known.instrument, observations.turns, known.values
        start = dict(zip(instrument.names, values.tolist(), strict=True))
        observations = replace(observations, start=start)
        self._components = known.components
        self._problem = Problem.of(observations, Prior(covariance=known.covariance), instrument=instrument)
        self._about = None if turns is None or not len(turns) else TurnsAbout.of(observations, instrument, values)
        vertical = unit_vector(specific_force(instrument, values, observations.rests.accel))
        attitudes = headings(self._problem, vertical, values, self._about)
        self._point = Point(values=values, gravity=observations.site.gravity, attitudes=attitudes)

    def left(self, covariance: Array) -> tuple[Array, Array, float, int]:
        """What the session leaves where x has this covariance, by Gauss–Newton: R (p, p) and d (p,) of Eq. (1) with
        p = 1 + m, about what was known, of its own rows at the end; the sum of squares that no x explains, and the
        degrees of freedom of all of them."""
        self._problem = problem = replace(self._problem, prior=Prior(covariance=covariance))
        for _ in range(MAX_ITERATIONS):
            rows = linearise(problem, self._point, self._about)
            step = solve(problem, rows, weights(problem, rows, self._components))
            point, change = moved(problem, self._point, step)
            about = integrated(problem, point, self._about)
            u = np.sqrt(np.diag(step.covariance)[1:])
            if about is self._about and np.all(np.abs(change) <= CONVERGED * u):
                break
            self._point, self._about = point, about
        rows = linearise(problem, self._point, self._about)
        told = tell(problem, rows, weights(problem, rows, self._components))
        session, off = told.sessions[0], np.append(self._point.gravity, self._point.values) - problem.measured[0]
        angles = int(np.count_nonzero(np.diagonal(told.factor, axis1=1, axis2=2)[:, :3]))
        R = session[:-1, :-1]
        degrees = sum(each.shape[0] * each.shape[1] for each in told.whitened) - angles
        return R, session[:-1, -1] + R @ off, session[-1, -1] ** 2, degrees


def _student(normal: Array, inverse_degrees: Array) -> Array:
    """√(ν/χ²_ν) by which a normal number becomes one of Student's t, from another normal number (Wilson & Hilferty)."""
    ninth = 2.0 / 9.0 * inverse_degrees
    return np.asarray(np.maximum(1.0 - ninth + np.sqrt(ninth) * normal, _LEAST_ROOT) ** -1.5)


@cache
def _normal(size: int) -> Array:
    """The same normal numbers (DRAWS, size) for every check."""
    return np.random.default_rng(20190).standard_normal((DRAWS, size))
