"""What the model does not know about itself: the hyperparameters φ, their priors, and the score of each.

| φ | what | prior |
|---|---|---|
| ln σ of a component of scatter | rests | σ exponential, its mean m the noise it stands beside |
| | turns, velocities …, magnetometer | σ of density m/(m + σ)² |
| ln σ_b, ln τ_b of a kind | in-run bias, a Gauss–Markov process | log-normal about the grade's size and 300 s, ÷× 30 |
| ln σ_p, ln τ_p | displacement of a device in motion, a Gauss–Markov process | log-normal about 2 cm and 0.5 s |
| p of a sensor | its scatter and in-run bias are exp(max(p, 0)) times those of its kind | N(0, ln 3) |
| p of a group | its size is exp(max(p, 0)) times the usual one | N(0, ln k) |

Of a device that lies still while it warms ÷× 5 takes the place of ÷× 30, nothing scatters from one part of the rest to
the next, and sensors of a kind are alike.

A component of scatter may be small, and is never excluded: no test decides whether it is there. That of
turns falls by a power: with an exponential one turns that are spoilt a hundred times their noise are so unlikely that
sound accelerometers take the blame. With λ = exp(max(p, 0))
half of the prior says that the sheet holds, the other half that it is too small by a factor of the order k: 2 for a
data sheet, 3 for a grade that is stated, 10 for one that is guessed where the next poorer grade has a larger
size. A prior is never narrowed.

The score. All but the correlation times are variances v of rows: of rests, of turns, of the steps of a process, of
priors. With D = ∂V/∂v, P the projector onto residuals and r = y − X x̂, by ln σ, σ² = v (24) to (26),

    ∂ℓ/∂ln σ = v (rᵀPDPr − tr PD)

For rows of a prior or of a step of unit variance, v rᵀPDPr is the sum of the squares of their residuals, v tr PD that
of 1 − Var e, what the data say of them. Of the correlation time, with e_k the steps over √(1 − ρ²), by Fisher's
identity (25)

    ∂ℓ/∂ln τ = Σ ρ Δt/τ · (E[(β_{k+1} − ρ β_k) β_k] + ρ (1 − E e²)) / (1 − ρ²)

Adding a hyperparameter is adding a class of `Hyperparameter` and an entry in `hyperparameters_of`.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from tumble.inference.elimination import eliminate, fold, recur_backwards
from tumble.inference.elimination_kernels import scatter_forms, state_forms
from tumble.inference.linearisation import Linearisation
from tumble.inference.noise import (
    CORRELATION_TIME,
    DISPLACEMENT,
    DISPLACEMENT_TIME,
    LINK_SCATTER,
    REST_SCATTER,
    SCATTER,
    SCATTER_WORDS,
    NoiseModel,
    VarianceComponents,
    typical_noise,
)
from tumble.inference.normal_equations import (
    Solution,
    add_priors,
    eliminate_rests,
    joint_rows,
    session_links,
    station_rows,
)
from tumble.inference.problem import Problem
from tumble.inference.variables import at_two_temperatures, ramps_up_and_down
from tumble.sensors.parameters import group_of, poorer, prior_sizes, variable_of
from tumble.units import Array, BoolArray, IntArray

IN_RUN_WITHIN = float(np.log(30.0) / 1.645)
"""Standard deviation of the logarithms of its size and of its correlation time about the usual ones: nine of ten are
within ÷× 30. It is wide enough for the process to take a drift, of which there is no group beside it: with ÷× 5 the
biases of a BMI160 that move by 4 mg in 237 s went into its scale factors."""
UNDISTURBED_WITHIN = float(np.log(5.0) / 1.645)
"""The same of a device that lies still, whose drift with temperature has parameters: ÷× 5, as instruments of a grade
differ."""
SHEET, STATED, GUESSED = 2.0, 3.0, 10.0
"""The factor by which a usual size may be too small where it is from a data sheet, from a grade that is stated, or from
one that is guessed."""
UNLIKE = 3.0
"""The same of the scatter and the in-run bias of a sensor, over those of the others of its kind."""
LEAST_DEGREES = 0.5
"""Of freedom: a component of scatter of which the fit leaves less is not estimated. It is by what is left of it, in the
end by rounding, that its variance would be divided."""


# -------------------- components --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Hyperparameter:
    """An element of φ: its name, unit and words, its usual value, SI, about which its prior is, and the standard
    deviation `within` of that in the logarithm; `members` are the sensors or parameters that it concerns. Subclasses
    say what it is."""

    bounded: ClassVar[bool] = False
    """Whether values below zero are those at zero: p of λ = exp(max(p, 0))."""

    name: str
    unit: str
    words: str
    usual: float
    within: float = 0.0
    members: slice | IntArray = field(default_factory=lambda: slice(None))

    @property
    def centre(self) -> float:
        """The most likely φ by the prior alone."""
        return 0.0 if self.bounded else float(np.log(self.usual))

    def value(self, phi: Any) -> Any:
        """The quantity, SI."""
        return np.exp(np.maximum(phi, 0.0) if self.bounded else phi)

    def log_prior(self, phi: Array) -> Array:
        """The logarithm of its prior density less a constant, its derivative, and the curvature of its negative (3, …)
        at values (…) of it alone."""
        return Hyperparameters((self,)).log_prior(phi[..., None])[..., 0]


class Scatter(Hyperparameter):
    """ln σ of a component of scatter."""

    __slots__ = ()


class InRunSize(Hyperparameter):
    """ln σ_b of a kind of sensors."""

    __slots__ = ()


class CorrelationTime(Hyperparameter):
    """ln τ_b of a kind of sensors."""

    __slots__ = ()


class SensorFactor(Hyperparameter):
    """p of the scatter at rest and the in-run bias of a sensor over those of its kind."""

    __slots__ = ()
    bounded = True


class GroupSize(Hyperparameter):
    """p of the size of a group of parameters."""

    __slots__ = ()
    bounded = True


class LocalGroupSize(Hyperparameter):
    """p of the size of a group of which each session has its own."""

    __slots__ = ()
    bounded = True


class Hyperparameters(tuple[Hyperparameter, ...]):
    """φ, with what its elements have as arrays."""

    @cached_property
    def bounded(self) -> BoolArray:
        """Which elements (D,) are p of λ = exp(max(p, 0))."""
        return np.array([h.bounded for h in self], dtype=bool)

    @cached_property
    def centre(self) -> Array:
        """The most likely φ (D,) by the prior alone."""
        return np.array([h.centre for h in self])

    @cached_property
    def _priors(self) -> tuple[Array, IntArray, IntArray]:
        """1/within (D,), 0 where the prior is not normal, and the scatter of rests, and that of turns and links."""
        scatter = [i for i, h in enumerate(self) if isinstance(h, Scatter)]
        at_rest, others = (
            np.array([i for i in scatter if (self[i].name in REST_SCATTER) is rests], dtype=int)
            for rests in (True, False)
        )
        return np.array([0.0 if i in scatter else 1.0 / h.within for i, h in enumerate(self)]), at_rest, others

    def log_prior(self, phi: Array) -> Array:
        """Of every element the logarithm of the prior density of φ (D,), less a constant, its derivative, and the
        curvature of its negative (3, D): normal; of scatter σ exponential with the mean `usual`, of that of turns and
        links of density m/(m + σ)²."""
        (narrow, at_rest, others), off = self._priors, phi - self.centre
        out, z = np.empty((3, *phi.shape)), off * narrow
        out[0], out[1], out[2] = -0.5 * z * z, -z * narrow, narrow * narrow
        z = off[..., at_rest]
        x = np.exp(z)
        out[..., at_rest] = z - x, 1.0 - x, x
        z = off[..., others]
        x = np.exp(z)
        out[..., others] = z - 2.0 * np.log1p(x), (1.0 - x) / (1.0 + x), 2.0 * x / (1.0 + x) ** 2
        return out

    @cached_property
    def _selections(self) -> dict[tuple[tuple[type[Hyperparameter], int], ...], Array]:
        return {}

    @cached_property
    def _members(self) -> dict[tuple[type[Hyperparameter], int], Array]:
        return {}

    def members(self, kind: type[Hyperparameter], count: int) -> Array:
        """Which of so many components, sensors, states or parameters the elements of a kind concern (D, count)."""
        if (kind, count) not in self._members:
            out = self._members[kind, count] = np.zeros((len(self), count))
            for i, h in enumerate(self):
                if isinstance(h, kind):
                    out[i, h.members] = 1.0
        return self._members[kind, count]

    def selection(self, counts: tuple[tuple[type[Hyperparameter], int], ...]) -> Array:
        """The same (D, Σ) of several kinds, side by side."""
        if counts not in self._selections:
            self._selections[counts] = np.hstack([self.members(*each) for each in counts])
        return self._selections[counts]


# -------------------- score --------------------


def quadratic_forms(hyperparameters: Hyperparameters, solution: Solution) -> Array:
    """The squares v rᵀPDPr and the traces v tr PD (2, D) of the variances of which the elements of φ are; of a
    correlation time their difference is its slope.

    Raises
    ------
    LinAlgError
        Where residuals are beyond all measure.
    """
    problem, equations, point = solution.problem, solution.equations, solution.linearisation.point
    noise = equations.noise
    n, s, q = problem.sensors, noise.states, solution.local.shape[-1]

    # scatter, and that of each sensor at rest
    of_scatter, of_directions = np.zeros((2, len(SCATTER))), list[Array]()
    for W, (r, C), (Z, place) in solution.by_kind:
        of_directions.append(np.zeros((2, len(place))))
        scatter_forms(W, Z, r, C, np.empty(Z.shape[1]), of_directions[-1])
        of_directions[-1] *= noise.variances[place]
        of_scatter += of_directions[-1] @ (place[:, None] == np.arange(len(SCATTER)))
    if not np.isfinite(of_scatter.sum()):
        raise np.linalg.LinAlgError("residuals are beyond all measure")

    # first states of all sessions and their steps
    of_states = np.zeros((3, max(s, n)))
    if s:
        work = np.empty((2, s, solution.shared.shape[1] + 1))
        follow, (own, with_next) = equations.sensitivity, solution.conditional_covariances
        every = follow, own, with_next, noise.state_rho, noise.state_step, noise.state_lapse
        for part, root, shared in zip(problem.parts, solution.roots, solution.shared, strict=True):
            by, given, with_following, rho, step, lapse = (each[part.stations] for each in every)
            state_forms(by, given, with_following, root, shared, rho, step, lapse, work, of_states)
    of_times = np.stack([of_states[2], np.zeros(of_states.shape[1])])

    # priors
    off = point.values + solution.parameters[1:] - problem.prior_mean[1:]
    of_priors = _forms_of_priors(off, (solution.roots[0, q + 1 :] ** 2).sum(axis=-1), problem.prior_u[1:])
    of_local = _forms_of_priors(
        point.local + solution.local, (solution.roots[:, :q] ** 2).sum(axis=-1), problem.local_u
    )

    forms = (
        (Scatter, of_scatter),
        (InRunSize, of_states[:2]),
        (CorrelationTime, of_times),
        (SensorFactor, of_directions[0][:, :n] + of_states[:2, :n]),
        (GroupSize, of_priors),
        (LocalGroupSize, of_local.sum(axis=1)),
    )
    some = hyperparameters.selection(tuple((kind, of.shape[1]) for kind, of in forms))
    return np.asarray(np.concatenate([of for _, of in forms], axis=1) @ some.T)


def _forms_of_priors(off: Array, variance: Array, size: Array) -> Array:
    """Squares and traces (2, …) of priors of standard deviations `size` by values and variances."""
    information = np.divide(1.0, size**2, out=np.zeros_like(size), where=size > 0.0)
    return np.stack([off**2 * information, 1.0 - variance * information])


def score(hyperparameters: Hyperparameters, solution: Solution) -> Array:
    """The gradient (D,) of ℓ."""
    square, trace = quadratic_forms(hyperparameters, solution)
    return np.asarray(square - trace + solution.prior_terms[1])


def size_factors(
    grade: str, sizes: Mapping[str, float], sheet: Container[str] = (), *, guessed: bool
) -> dict[str, float]:
    """Factors by which the sizes of groups in instruments of a grade may be too small, by where each is from: a data
    `sheet`, or a grade that is stated or guessed. A guess between grades of equal sizes cannot be wrong by it."""
    worse = poorer(grade) if guessed else None
    in_worse = {} if worse is None else prior_sizes(worse)
    return {
        name: SHEET if name in sheet else GUESSED if in_worse.get(name, 0.0) > size else STATED
        for name, size in sizes.items()
    }


def hyperparameters_of(problem: Problem, noise: NoiseModel, seen: BoolArray) -> Hyperparameters:
    """The hyperparameters of a problem: the components of scatter (c,) that are `seen`, the in-run biases, and the
    groups whose size is by a prior."""
    observations, blocks, out = problem.observations, problem.instrument.blocks, list[Hyperparameter]()
    undisturbed = problem.prior.undisturbed

    # components of scatter: each stands beside the noise along its directions
    beside: list[list[Array]] = [[] for _ in SCATTER]
    for covariance, (Z, place) in (
        (noise.rest, noise.rest_directions),
        (noise.turn, noise.turn_directions),
        (noise.link, noise.link_directions),
    ):
        length, size = (Z**2).sum(axis=1), ((covariance @ Z) * Z).sum(axis=1)
        for number in set(place.tolist()):
            own = (place == number) & (length > 0.0)
            beside[number].append(size[own] / length[own] ** 2)
    for number, (name, (unit, words)) in enumerate(SCATTER_WORDS.items()):
        every = np.concatenate([np.zeros(0), *beside[number]])
        if seen[number] and len(every) and not (undisturbed and name in REST_SCATTER):
            usual = 1.0 if name in LINK_SCATTER else float(np.sqrt(np.median(every)))
            out.append(Scatter(name=name, unit=unit, words=words, usual=usual, members=slice(number, number + 1)))

    # in-run biases of both kinds, and sensors whose bias wanders more than that of the others
    rests, first = observations.rests, 0
    covariances = (rests.accel_covariance, rests.gyro_covariance) if len(problem.link) > 1 else ()
    for block, covariance in zip(blocks, covariances, strict=False):
        kind, words = block.kind, "accelerometers" if block.kind == "accel" else "gyros"
        within = UNDISTURBED_WITHIN if undisturbed else IN_RUN_WITHIN
        process: dict[str, Any] = {"within": within, "members": slice(first, first + block.size)}
        usual, unit = observations.in_run.get(kind, typical_noise(covariance)), SCATTER_WORDS[kind][0]
        words_of_bias = f"in-run bias of the {words}"
        out.append(InRunSize(name=f"{kind}_in_run", unit=unit, words=words_of_bias, usual=usual, **process))
        words_of_time = f"correlation time of the {words_of_bias}"
        out.append(
            CorrelationTime(name=f"{kind}_time", unit="s", words=words_of_time, usual=CORRELATION_TIME, **process)
        )
        for c, sensor in enumerate(block.sensors if block.size > 1 and not undisturbed else ()):
            words_of_sensor = f"scatter and in-run bias of {kind} {sensor} over those of the others"
            size = _factor(f"{kind}.in_run.{sensor}", words_of_sensor, UNLIKE, slice(first + c, first + c + 1))
            out.append(SensorFactor(**size))
        first += block.size
    if problem.moves:
        out += _displacement(first)

    # groups of parameters beyond the linear model. A lag multiplies others: a wide prior would let both grow.
    # Curvatures are not wider than usual where there are but two temperatures, nor is a hysteresis where they came one
    # way: what a bias has beyond its usual size would be taken for one.
    two, both_sides = at_two_temperatures(observations), ramps_up_and_down(observations)
    held = {"lag", "temperature²" if two else "lag", "lag" if both_sides else "hysteresis"}
    common = {name: members for name, members in problem.instrument.members.items() if variable_of(name) not in held}
    for kind_of_size, groups in ((GroupSize, common), (LocalGroupSize, problem.local_members)):
        for name in groups:
            if group_of(name).sized_with in groups:
                continue
            with_it = [groups[other] for other in groups if other == name or group_of(other).sized_with == name]
            members = np.concatenate([np.arange(each.start, each.stop) for each in with_it])
            too_small = observations.too_small.get(name, STATED)
            out.append(kind_of_size(**_factor(name, f"size of {name} over the usual one", too_small, members)))
    return Hyperparameters(out)


def _displacement(first: int) -> tuple[Hyperparameter, Hyperparameter]:
    """Size and correlation time of the displacement, whose three states stand behind so many others."""
    words, members = "displacement of the device in motion", slice(first, first + 3)
    return (
        InRunSize(name="displacement", unit="m", words=words, usual=DISPLACEMENT, within=2.0, members=members),
        CorrelationTime(
            name="displacement_time",
            unit="s",
            words=f"correlation time of the {words}",
            usual=DISPLACEMENT_TIME,
            within=1.0,
            members=members,
        ),
    )


def _factor(name: str, words: str, too_small: float, members: slice | IntArray) -> dict[str, Any]:
    """The fields of p of a size λ = exp(max(p, 0)) that may be too small by a factor."""
    within = float(np.log(too_small))
    return {"name": name, "unit": "1", "words": words, "usual": 1.0, "within": within, "members": members}


# -------------------- likelihood --------------------


def scaled(problem: Problem, hyperparameters: Hyperparameters, phi: Array) -> tuple[Problem, VarianceComponents]:
    """The problem with the priors of its groups as large as φ (D,) says, and the components of variance; or stacks."""
    values, m, q, n = np.exp(phi), len(problem.usual_u) - 1, len(problem.usual_local_u), problem.sensors
    some = hyperparameters.selection(((GroupSize, m), (LocalGroupSize, q), (SensorFactor, n)))
    factors = np.exp(np.maximum(phi, 0.0) @ some)
    prior_u = np.empty((*phi.shape[:-1], 1 + m))
    prior_u[..., 0], prior_u[..., 1:] = problem.usual_u[0], problem.usual_u[1:] * factors[..., :m]
    local_u, unlike = problem.usual_local_u * factors[..., m : m + q], factors[..., m + q :]
    components: dict[str, Any] = {h.name: values[..., i] for i, h in enumerate(hyperparameters) if not h.bounded}
    none = dict.fromkeys(SCATTER, np.zeros(phi.shape[:-1])[()])
    return problem.with_sizes(prior_u, local_u), VarianceComponents(**(none | components), unlike=unlike)


def solution_at(linearisation: Linearisation, hyperparameters: Hyperparameters, phi: Array) -> Solution:
    """The solution, with ℓ, at φ (D,) or at a stack (P, D) of them; the linearisation has priors of any size."""
    problem, components = scaled(linearisation.problem, hyperparameters, phi)
    here = linearisation.with_priors(problem).with_components(components)
    return add_priors(here, eliminate_rests(here), phi=phi, prior_terms=hyperparameters.log_prior(phi))


def average_information(hyperparameters: Hyperparameters, solution: Solution) -> Array:
    """The average of observed and expected information (D, D) of ℓ, with the curvature of the prior.

    With the working variates Q = [∂V/∂φ_a P r] of all rows it is ½ QᵀPQ (Gilmour, Thompson and Cullis 1995): Q are
    further right-hand sides of the elimination, of which its triangle has what no unknown explains.
    """
    linearisation, equations, problem = solution.linearisation, solution.equations, solution.problem
    noise, point, D = equations.noise, solution.linearisation.point, len(hyperparameters)
    d, q, sides, states = equations.unknowns, solution.local.shape[-1], slice(-1 - D, -1), equations.noise.states

    # working variates, whitened: along the directions of scatter v Z Zᵀ W r, of priors their residuals
    of_scatter = hyperparameters.members(Scatter, len(SCATTER))
    of_sensors = hyperparameters.members(SensorFactor, problem.sensors)
    variates = list[Array]()
    for number, (W, (r, _), (Z, place)) in enumerate(solution.by_kind):
        WZ, some = W @ Z, of_scatter[:, place]
        some[:, : problem.sensors] += of_sensors if number == 0 else 0.0
        variates.append((2.0 * noise.variances[place] * (r[:, None] @ WZ) * WZ) @ some.T)
    off = point.values + solution.parameters[1:] - problem.prior_mean[1:]
    of_prior = -2.0 * (off / problem.prior_u[1:])[:, None] * hyperparameters.members(GroupSize, len(off)).T
    off_local = (point.local + solution.local) / problem.local_u
    of_local = -2.0 * off_local[..., None] * hyperparameters.members(LocalGroupSize, q).T

    def beside(rows: Array, columns: Array) -> Array:
        return np.concatenate([rows[..., :-1], columns, rows[..., -1:]], axis=-1)

    every = equations.rest_rows, equations.turn_rows, equations.link_rows
    rest, turn, link = (beside(rows, columns) for rows, columns in zip(every, variates, strict=True))
    rest, joints, of_begins = station_rows(problem, rest), turn, np.zeros((len(problem.parts), 0, D))
    if states:
        joints = joint_rows(linearisation, turn, link)
        joints[:, -states:, sides], of_begins = _variates_of_states(hyperparameters, solution)
    width, p = rest.shape[2] - d, len(problem.prior_u)
    common = np.zeros((p + D + 1, p + D + 1), order="F")
    rows = np.zeros((p, p + D + 1))
    np.fill_diagonal(rows, np.divide(1.0, problem.prior_u, out=np.zeros(p), where=problem.prior_u > 0.0))
    rows[:, -1] = rows.diagonal() * (problem.prior_mean - np.append(point.gravity, point.values))
    rows[1:, p:-1] = of_prior
    fold(rows, common)
    fold(beside(linearisation.array, np.zeros((len(linearisation.array), D))), common)
    for s, part in enumerate(problem.parts):
        begins, triangle = np.zeros((d, d + rest.shape[2])), np.zeros((width, width), order="F")
        begins[d - states :, d - states : d] = np.eye(states)
        begins[d - states :, sides] = of_begins[s]
        between, links = joints[part.stations if states else part.turns], session_links(part, states > 0)
        eliminate(rest[part.stations], between, links, np.empty((len(part.link), *begins.shape)), triangle, begins)
        if q:
            local = np.zeros((q, width))
            local[:, :q], local[:, sides] = np.diag(1.0 / problem.local_u), of_local[s]
            local[:, -1] = linearisation.local_prior[s]
            fold(local, triangle)
        fold(triangle[q:, q:].copy(order="F"), common)
    R = np.triu(common)[p : p + D, p : p + D]
    return np.asarray(0.5 * R.T @ R + np.diag(solution.prior_terms[2]))


def _variates_of_states(hyperparameters: Hyperparameters, solution: Solution) -> tuple[Array, Array]:
    """Working variates of the steps of the states that follow stations (M, s, D), and of the first states of sessions
    (S, s, D): of sizes the whitened residuals. With S β the steps, of variances V, and w = V⁻¹ S β, a correlation time
    changes the covariance S⁻¹ V S⁻ᵀ of the states so that its variate is −V^{−½} (−∂S β − V S⁻ᵀ ∂Sᵀ w + ∂V w)."""
    noise, b, first = (
        solution.equations.noise,
        solution.states,
        [part.stations.start for part in solution.problem.parts],
    )
    follows, s, n = noise.follows[:, None], b.shape[1], solution.problem.sensors
    lapse = np.where(follows & np.isfinite(noise.state_lapse), noise.state_lapse, 0.0)
    rho, step = np.where(follows, noise.state_rho, 0.0), np.where(follows, noise.state_step, 1.0)
    residual, slope = np.zeros_like(b), rho * lapse
    residual[:-1] = np.where(follows[:-1], b[1:] - rho[:-1] * b[:-1], 0.0) / step[:-1] ** 2  # w
    back = np.ascontiguousarray(-slope * residual)
    recur_backwards(rho[:, :, None] * np.eye(s), back[:, :, None])
    after = np.append(back[1:], np.zeros((1, s)), axis=0)
    by_time = np.where(follows, (slope * b - step**2 * after) / step - 2.0 * rho * slope * residual / step, 0.0)
    sizes = hyperparameters.members(InRunSize, s).T.copy()
    sizes[:n] += hyperparameters.members(SensorFactor, n).T
    times = hyperparameters.members(CorrelationTime, s).T
    of_steps = -2.0 * (residual * step)[:, :, None] * sizes - by_time[:, :, None] * times
    return of_steps, -2.0 * b[first][:, :, None] * sizes + back[first][:, :, None] * times
