"""Test of a calibration with a few rests of its device and the turns between them.

The likelihood is that of the method joint, with one prior of all parameters. Let x be the deviation of gravity and the
parameters from the calibration, and P its prior covariance. With attitudes and in-run biases eliminated, the session
gives

    d = R x + n,   n ~ N(0, 1),   S = 1 + R P Rᵀ = L Lᵀ,   z = L⁻¹ d,   G = L⁻¹ R                                (1)

and residuals that no x explains. If nothing has changed, z ~ N(0, 1). A change a of parameter j beyond P has the
estimate, standard uncertainty and test statistic

    a = g_jᵀ z / g_jᵀ g_j,   u = 1/|g_j|,   t_j = a/u   (2)

The t_j of the parameters that the session determines are correlated as the columns g_j are. If P were exact they would
be normal. As P is estimated, t_j has Student's t distribution with ν_j degrees of freedom,

    1/√ν_j = q_jᵀ D q_j,   q_j = Gᵀ g_j u_j   (3)

where D is the uncertainty of P (`tumble.use.check`, Eq. (1)), with all its parts fully correlated. The largest |t_j| is
compared with the quantile of the maximum of such numbers that is exceeded with the probability CHANCE. If it is larger,
its parameter gets a wide prior and everything is solved again, and so on, which estimates the changes together. By
Bonferroni's inequality, the p-value of the largest of m statistics is at most 2 m T_ν(−|t|), with T_ν the distribution
function of Student's t. What no change explains is judged by χ² = |z|² and the residuals, at MISFIT_CHANCE. Changes
that are smaller than those of turning the device on again are not detected.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import scipy

from tumble.inference.estimate import DETERMINED, Fit
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.linearisation import linearise
from tumble.inference.maximum import reintegrated_turns, take_step
from tumble.inference.noise import VarianceComponents
from tumble.inference.normal_equations import eliminate_rests, solve
from tumble.inference.problem import Point, Prior, Problem
from tumble.inference.start import headings
from tumble.reduction.observations import Observations
from tumble.rotation import unit_vector
from tumble.sensors.compensation import specific_force
from tumble.sensors.instrument import Instrument
from tumble.sensors.parameters import group_name, limits_of, positions_by_group
from tumble.units import Array

CHANCE = 0.009  # probability that the largest statistic finds a change if there is none
MISFIT_CHANCE = 0.001  # probability that the test of χ² fails if nothing is wrong
POWER = 0.9  # probability of finding a change of the detectable size
MOST_CHANGES = 6
RIVAL_CHI_SQUARE = 4.0  # another change is named too if it explains χ² as well as the best to within this
DRAWS = 20_000
LEAST_ROOT = 1e-2  # of χ²/ν
CONVERGED = 1e-2  # of the standard uncertainty
MAX_ITERATIONS = 12


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CheckPrior:
    """Prior of gravity and the m parameters of an instrument at the time of a check, SI."""

    instrument: Instrument
    values: Array  # (m,), of the parameters by the calibration at the temperature of the check
    calibrated: Array  # (1 + m, 1 + m): their covariance Σ, with gravity
    turned_on: Array  # (1 + m,): variances of the changes when the device is turned on again
    inverse_degrees: Array  # (1 + m,): inverse degrees of freedom of the covariance
    turned_on_inverse_degrees: Array  # (1 + m,): and of these variances
    to_temperature: Array  # (1 + m, 1 + m): takes gravity and the parameters to the temperature of the check
    components: VarianceComponents  # variances beside the noise

    @property
    def covariance(self) -> Array:
        """P (1 + m, 1 + m)."""
        return np.asarray(self.calibrated + np.diag(self.turned_on))

    @property
    def covariance_u(self) -> Array:
        """D (1 + m, 1 + m), the uncertainty of P, Eq. (3)."""
        return self.u_of_calibrated(self.calibrated) + np.diag(self.turned_on * np.sqrt(self.turned_on_inverse_degrees))

    def u_of_calibrated(self, calibrated: Array) -> Array:
        """Return the part of D due to a covariance Σ of the calibration."""
        N = self.inverse_degrees**0.25
        return np.asarray(N[:, None] * calibrated * N)


@dataclass(frozen=True, kw_only=True, slots=True)
class ChangedParameter:
    """A parameter that has changed.

    Attributes
    ----------
    value, u : float
        The change and its standard uncertainty, SI.
    probability : float
        Upper bound of the probability that chance makes the largest of all tests as large.
    others : mapping of str to float
        Changes of other parameters, by name, that explain the session nearly as well.
    """

    name: str
    unit: str
    value: float
    u: float
    probability: float
    others: Mapping[str, float]


@dataclass(frozen=True, kw_only=True, slots=True)
class ParameterTest:
    """Test of a parameter as if it alone had changed, SI."""

    name: str
    unit: str
    change: float
    u: float
    detectable: float  #: change that is found with the probability POWER


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CheckResult:
    """Result of the test of a calibration with a session."""

    changes: tuple[ChangedParameter, ...]
    tests: Mapping[str, ParameterTest]  # of all parameters that the session determines, by name
    largest: float  # of all |change|/u
    limit: float  # quantile with which it is compared
    unseen: tuple[str, ...]  # groups of linear parameters that the session does not determine
    misfit: Fit  # of the residuals that no change explains
    values: Array  # (m,), of the parameters by calibration and check together
    covariance: Array  # (m, m)

    @property
    def explained(self) -> bool:
        """True if chance and the changes explain the session."""
        return self.misfit.probability >= MISFIT_CHANCE

    @property
    def valid(self) -> bool:
        """True if the session shows no change."""
        return self.explained and not self.changes


def field_check(observations: Observations, prior: CheckPrior) -> CheckResult:
    """Test a calibration with a session (see the module)."""
    limits = limits_of(prior.instrument.names)

    def evidence_with(free: Sequence[int]) -> Evidence:
        """Return the evidence with these parameters free within their limits."""
        covariance, freed = prior.covariance, 1 + np.array(free, dtype=int)
        covariance[freed, freed] += limits[freed - 1] ** 2
        R, d, squares, degrees = session_information(observations, prior, covariance)
        G, z, gain, A = measurement_update(R, d, prior.covariance)
        return Evidence(
            z=z,
            G=G,
            values=prior.values + (gain @ z)[1:],
            covariance=(A @ prior.covariance)[1:, 1:],
            by_x=A[1:],
            squares=squares,
            degrees=degrees,
        )

    return changes_in(evidence_with, prior.instrument, prior.covariance_u)


def measurement_update(R: Array, d: Array, P: Array) -> tuple[Array, Array, Array, Array]:
    """Update an x of covariance P (k, k) with d = R x + n as in a Kalman filter, Eq. (1).

    Returns
    -------
    G, z : (p, k) and (p,) array
        Whitened sensitivities and whitened innovation.
    gain : (k, p) array
        P Gᵀ, by which z changes the estimate of x.
    A : (k, k) array
        1 − P Gᵀ G; the covariance becomes A P.
    """
    L = np.linalg.cholesky(np.eye(len(R)) + R @ P @ R.T)
    both = np.linalg.solve(L, np.column_stack([R, d]))
    G, gain = both[:, :-1], P @ both[:, :-1].T
    return G, both[:, -1], gain, np.eye(len(P)) - gain @ G


def change_statistics(G: Array, z: Array, changes: Array, covariance_u: Array) -> tuple[Array, Array, Array]:
    """Return tests of changes (k, q) of x from whitened sensitivities G (p, k) and innovation z (p,), Eqs. (2), (3).

    They are |μ| (q,) of the effects μ = G · changes, the statistics t = μᵀz/|μ| and their inverse degrees of freedom,
    with D the uncertainty `covariance_u` of the prior covariance of the first elements of x."""
    effects = G @ changes
    size = np.maximum(np.linalg.norm(effects, axis=0), 1e-300)
    q = (G.T @ (effects / size))[: len(covariance_u)]
    return size, effects.T @ z / size, np.einsum("ik,ij,jk->k", q, covariance_u, q) ** 2


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Evidence:
    """A session whitened by the prior of x, whose first 1 + m elements are gravity and the parameters."""

    z: Array  # (p,), Eq. (1)
    G: Array  # (p, k), Eq. (1)
    values: Array  # (m,), of the parameters by prior and session if nothing has changed
    covariance: Array  # (m, m)
    by_x: Array  # (m, k): derivative of the values with respect to x before the session
    squares: float  # sum of squares that no x explains
    degrees: float  # degrees of freedom of this sum and |z|² together


def changes_in(
    evidence_with: Callable[[Sequence[int]], Evidence],
    instrument: Instrument,
    covariance_u: Array,
    already: Sequence[ChangedParameter] = (),
) -> CheckResult:
    """Find the changes of parameters.

    The parameter with the largest statistic gets a wide prior, until none is larger than chance makes it or there are
    MOST_CHANGES. `CheckResult.tests`, `largest` and `limit` are those before the first change.

    Parameters
    ----------
    evidence_with
        Returns the evidence with a wide prior of the parameters of these indices.
    instrument
        The instrument with its m parameters.
    covariance_u
        D (1 + m, 1 + m), the uncertainty of the prior covariance.
    already
        Changes found before, whose parameters are not tested.
    """
    names, m, linear = instrument.names, len(instrument.names), instrument.linear_count
    limits, untested = limits_of(names), [names.index(change.name) for change in already]
    free, others, probabilities = list[int](), list[dict[str, float]](), list[float]()
    while True:
        evidence = evidence_with(free)
        free_variance = np.zeros(evidence.G.shape[1])
        free_variance[[1 + j for j in free]] = limits[free] ** 2
        updated, z, gain, _ = measurement_update(evidence.G, evidence.z, np.diag(free_variance))
        G = updated[:, 1 : 1 + m]
        size, t, inverse_degrees = change_statistics(updated, z, np.eye(updated.shape[1])[:, 1 : 1 + m], covariance_u)
        u = 1.0 / size
        determined = u[:linear] < limits[:linear] / DETERMINED
        determined[[*free, *untested]] = False
        candidates = np.flatnonzero(determined)
        limit = _largest_by_chance(G[:, candidates] * u[candidates], inverse_degrees[candidates])
        largest = float(np.abs(t[candidates]).max(initial=0.0))
        if not free:
            first_largest, first_limit, seen = largest, limit, {group_name(names[j]) for j in candidates}
            tests = {
                names[j]: ParameterTest(
                    name=names[j],
                    unit=instrument.units[j],
                    change=float(t[j] * u[j]),
                    u=float(u[j]),
                    detectable=float((limit + scipy.special.ndtri(POWER)) * u[j]),
                )
                for j in candidates
            }
        if largest <= limit or len(free) + len(untested) >= MOST_CHANGES:
            break
        worst = int(candidates[np.abs(t[candidates]).argmax()])
        least = max(largest**2 - RIVAL_CHI_SQUARE, limit**2) ** 0.5
        free.append(worst)
        others.append({names[j]: float(t[j] * u[j]) for j in candidates if j != worst and abs(t[j]) > least})
        tail = scipy.special.stdtr(1.0 / max(inverse_degrees[worst], 1e-12), -largest)
        probabilities.append(min(1.0, 2.0 * len(candidates) * float(tail)))

    # the changes together, and the part of |z|² that they explain
    Q, triangle = np.linalg.qr(evidence.G[:, [1 + j for j in free]])
    inverse, explained = np.linalg.inv(triangle), Q.T @ evidence.z
    together, together_u = inverse @ explained, np.sqrt((inverse**2).sum(axis=1))
    changes = [
        ChangedParameter(name=names[j], unit=instrument.units[j], value=float(a), u=float(a_u), probability=p, others=o)
        for j, a, a_u, p, o in zip(free, together, together_u, probabilities, others, strict=True)
    ]
    shift = evidence.by_x @ gain
    return CheckResult(
        changes=(*already, *changes),
        tests=tests,
        largest=first_largest,
        limit=first_limit,
        unseen=tuple(group for group in positions_by_group(names[:linear]) if group not in seen),
        misfit=Fit(
            chi_square=evidence.squares + float(evidence.z @ evidence.z - explained @ explained),
            degrees=float(evidence.degrees - len(free)),
            scatter=0.0,
            unit="",
        ),
        values=evidence.values + shift @ z,
        covariance=evidence.covariance + (evidence.by_x * free_variance) @ evidence.by_x.T - shift @ shift.T,
    )


def session_information(
    observations: Observations, prior: CheckPrior, covariance: Array
) -> tuple[Array, Array, float, int]:
    """Return the information of a session with unknown attitudes about x.

    It is linearised by Gauss–Newton from the prior values, with this prior covariance of x.

    Returns
    -------
    R, d : (p, p) and (p,) array
        Eq. (1) with p = 1 + m, about the prior values, linearised at the estimate.
    squares : float
        Sum of squares that no x explains.
    degrees : int
        Degrees of freedom of this sum and |d|² together.
    """
    instrument, turns, values = prior.instrument, observations.turns, prior.values
    start = dict(zip(instrument.names, values.tolist(), strict=True))
    problem = Problem.of(replace(observations, start=start), Prior(covariance=covariance), instrument=instrument)
    integrated = None if turns is None or not len(turns) else IntegratedTurns.of(observations, instrument, values)
    vertical = unit_vector(specific_force(instrument, values, observations.rests.accel))
    attitudes = headings(problem, vertical, values, integrated)
    point = Point(values=values, gravity=observations.site.gravity, attitudes=attitudes)
    for _ in range(MAX_ITERATIONS):
        solution = solve(linearise(problem, point, integrated, prior.components))
        next_point, change = take_step(solution)
        reintegrated = reintegrated_turns(problem, next_point, integrated)
        small = np.all(np.abs(change) <= CONVERGED * np.sqrt(np.diag(solution.covariance)[1:]))
        if small and reintegrated is integrated:
            break
        point, integrated = next_point, reintegrated
    equations = eliminate_rests(linearise(problem, point, integrated, prior.components))
    triangle, off = equations.session_factors[0], np.append(point.gravity, point.values) - problem.prior_mean
    R, right = triangle[:-1, :-1], triangle[:-1, -1]
    angles = int(np.count_nonzero(np.diagonal(equations.rest_factors, axis1=1, axis2=2)[:, :3]))
    degrees = sum(each.shape[0] * each.shape[1] for each in equations.rows.values()) - angles
    return R, right + R @ off, triangle[-1, -1] ** 2, degrees


def _largest_by_chance(effects: Array, inverse_degrees: Array) -> float:
    """Return the quantile of the largest of Student's t numbers |t| that is exceeded with the probability CHANCE.

    They are correlated as the columns of `effects` (p, q), of unit length, with these inverse degrees of freedom (q,).
    Infinite without any."""
    if not len(inverse_degrees):
        return np.inf
    triangle = np.linalg.qr(effects, mode="r")
    normal = _normal_numbers(len(triangle) + 1)
    ninth = 2.0 / 9.0 * inverse_degrees  # √(ν/χ²_ν) from a normal number (Wilson & Hilferty)
    factor = np.maximum(1.0 - ninth + np.sqrt(ninth) * normal[:, -1:], LEAST_ROOT) ** -1.5
    return float(np.quantile((np.abs(normal[:, :-1] @ triangle) * factor).max(axis=1), 1.0 - CHANCE))


@cache
def _normal_numbers(size: int) -> Array:
    """Return the same normal numbers (DRAWS, size) for every check."""
    return np.random.default_rng(20190).standard_normal((DRAWS, size))
