"""What the model does not know about itself: the hyperparameters φ, their priors, and the score of each.

| φ | what | prior |
|---|---|---|
| ln σ of a component of scatter | rests | σ exponential, its mean m the noise it stands beside |
| | turns, velocities …, magnetometer | σ of density m/(m + σ)² |
| ln σ_b, ln τ_b of a kind | in-run bias, a Gauss–Markov process | log-normal about the grade's size and 300 s, ÷× 30 |
| ln σ_p, ln τ_p | displacement of a device in motion, a Gauss–Markov process | log-normal about 2 cm and 0.5 s |
| p of a sensor | its scatter and in-run bias are exp(max(p, 0)) times those of its kind | N(0, ln 3) |
| p of a group | its size is exp(max(p, 0)) times the usual one | N(0, ln k) |

A component of scatter may be small, and is never excluded: no test decides whether it is there. That of
turns falls by a power: with an exponential one turns that are spoilt a hundred times their noise are so unlikely that
sound accelerometers take the blame. With λ = exp(max(p, 0))
half of the prior says that the sheet holds, the other half that it is too small by a factor of the order k: 2 for a
data sheet, 3 for a grade that is stated, 10 for one that is guessed where the next poorer grade has a larger
size. A prior is never narrowed.

The score. All but the correlation times are variances v of rows: of rests, of turns, of the steps of a process, of
priors. With D = ∂V/∂v, P the projector onto residuals and r = y − X x̂, by ln σ, σ² = v (24) to (26),

    ∂ℓ/∂ln σ = v (rᵀPDPr − tr PD),     information 2 v² tr PDPD

For rows of a prior or of a step of unit variance, v rᵀPDPr is the sum of the squares of their residuals, v tr PD that
of 1 − Var e, what the data say of them. Of D by the scatter the part within a rest and within a turn is taken for the
information. Of the correlation time, with e_k the steps over √(1 − ρ²), by Fisher's identity (25)

    ∂ℓ/∂ln τ = Σ ρ Δt/τ · (E[(β_{k+1} − ρ β_k) β_k] + ρ (1 − E e²)) / (1 − ρ²)

Adding a hyperparameter is adding a class of `Hyperparameter` and an entry in `hyperparameters_of`.
"""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from tumble.inference.elimination import along_chains, eliminate, fold
from tumble.inference.linearisation import Linearisation
from tumble.inference.noise import (
    CORRELATION_TIME,
    DISPLACEMENT,
    DISPLACEMENT_TIME,
    LINK_SCATTER,
    SCATTER,
    SCATTER_WORDS,
    TURN_SCATTER,
    NoiseModel,
    VarianceComponents,
    typical_noise,
)
from tumble.inference.normal_equations import (
    NormalEquations,
    Solution,
    add_priors,
    eliminate_rests,
    joint_rows,
    session_links,
    station_rows,
)
from tumble.inference.problem import Problem
from tumble.inference.variables import at_two_temperatures, both_ways
from tumble.sensors.parameters import group_of, poorer, prior_sizes, variable_of
from tumble.units import Array, BoolArray, IntArray

IN_RUN_WITHIN = float(np.log(30.0) / 1.645)
"""Standard deviation of the logarithms of its size and of its correlation time about the usual ones: nine of ten are
within ÷× 30. It is wide enough for the process to take a drift, of which there is no group beside it: with ÷× 5 the
biases of a BMI160 that move by 4 mg in 237 s went into its scale factors."""
SHEET, STATED, GUESSED = 2.0, 3.0, 10.0
"""The factor by which a usual size may be too small where it is from a data sheet, from a grade that is stated, or from
one that is guessed."""
UNLIKE = 3.0
"""The same of the scatter and the in-run bias of a sensor, over those of the others of its kind."""
SENSED = 0.2
"""Of the rests: what the scatter of a single sensor is told by at first, until its curvature is known."""
LEAST_DEGREES = 0.5
"""Of freedom: a component of scatter of which the fit leaves less is not estimated. It is by what is left of it, in the
end by rounding, that its variance would be divided."""


# -------------------- quadratic forms --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class QuadraticForms:
    """What the score of a variance v is made of: `square` v rᵀPDPr, `trace` v tr PD, and `double` v² tr PDPD."""

    square: Array
    trace: Array
    double: Array

    def __add__(self, other: QuadraticForms) -> QuadraticForms:
        return QuadraticForms(
            square=self.square + other.square, trace=self.trace + other.trace, double=self.double + other.double
        )

    def sum(self, some: slice | IntArray) -> QuadraticForms:
        """Of some of the variances together, as if each were seen by itself."""
        return QuadraticForms(
            square=self.square[..., some].sum(), trace=self.trace[..., some].sum(), double=self.double[..., some].sum()
        )


class Score:
    """The quadratic forms of a solution, each made when it is first asked for."""

    def __init__(self, solution: Solution) -> None:
        self.solution = solution

    @cached_property
    def _by_direction(self) -> tuple[list[Array], list[Array], list[Array], list[Array]]:
        """Of rests, turns and links squares and traces (q,) by direction of scatter, sums of the squares of all
        products (q, q), and where directions stand in SCATTER."""
        solution, noise = self.solution, self.solution.equations.noise
        out = list[Array](), list[Array](), list[Array](), list[Array]()
        for W, (r, C), (Z, place) in (
            (solution.equations.rest_whitening, solution.rest_residuals, noise.scaled_rest_directions),
            (solution.equations.turn_whitening, solution.turn_residuals, noise.turn_directions),
            (solution.equations.link_whitening, solution.link_residuals, noise.scaled_link_directions),
        ):
            WZ = W @ Z
            products = np.swapaxes(WZ, -1, -2) @ C @ WZ
            out[0].append(((r[:, None, :] @ WZ)[:, 0, :] ** 2).sum(axis=0))
            out[1].append(np.diagonal(products, axis1=1, axis2=2).sum(axis=0))
            out[2].append((products**2).sum(axis=0))
            out[3].append(np.eye(len(SCATTER))[place])
        return out

    @cached_property
    def scatter(self) -> QuadraticForms:
        """By component of scatter (c,), `double` (c, c) with that of two together. Raises LinAlgError where residuals
        are beyond all measure."""
        v = self.solution.components.variances
        squares, traces, _, kinds = self._by_direction
        square = v * sum(each @ kind for each, kind in zip(squares, kinds, strict=True))
        trace = v * sum(each @ kind for each, kind in zip(traces, kinds, strict=True))
        double = np.outer(v, v) * self.scatter_products
        if not (np.isfinite(square - trace).all() and np.isfinite(double).all()):
            raise np.linalg.LinAlgError("residuals are beyond all measure")
        return QuadraticForms(square=square, trace=trace, double=double)

    @cached_property
    def scatter_products(self) -> Array:
        """tr PD_aPD_b (c, c) of the components of scatter, by the parts within a rest and within a turn."""
        _, _, doubles, kinds = self._by_direction
        return np.asarray(sum(kind.T @ each @ kind for each, kind in zip(doubles, kinds, strict=True)))

    @cached_property
    def sensors(self) -> QuadraticForms:
        """By sensor (n,), of its scatter at rest and of its in-run bias."""
        v, (accelerometers, gyros) = self.solution.components.variances, self.solution.equations.noise.sensors
        of_kind = np.repeat(v[:2], [accelerometers, gyros])
        known = np.full(len(of_kind), 0.5 * SENSED * len(self.solution.problem.link))
        scatter = QuadraticForms(
            square=of_kind * self._by_direction[0][0][: len(of_kind)],
            trace=of_kind * self._by_direction[1][0][: len(of_kind)],
            double=known,
        )
        n, of_states = len(of_kind), self.states
        return scatter + QuadraticForms(
            square=of_states.square[:n], trace=of_states.trace[:n], double=of_states.double[:n]
        )

    @cached_property
    def _steps(self) -> tuple[Array, Array, Array]:
        """Squares of the steps of the states and of those that begin a chain, expected from their values (M, s), the
        variances of both, and of each step that follows a station the slope by ln τ."""
        solution, noise = self.solution, self.solution.equations.noise
        states, follows = slice(noise.unknowns - noise.states, None), noise.follows
        first, here = np.append(True, ~follows[:-1]), np.flatnonzero(follows)
        b, root = solution.states, solution.along(states)
        given, with_next = np.diagonal(solution.conditional_covariances, axis1=-2, axis2=-1)[..., states]
        variance = given + (root**2).sum(axis=-1)
        with_next = with_next[here] + (root[here] * root[here + 1]).sum(axis=-1)
        rho, square = noise.state_rho[here], noise.state_step[here] ** 2
        value = np.concatenate([(b[here + 1] - rho * b[here]) ** 2 / square, b[first] ** 2])
        unknown = (variance[here + 1] - 2.0 * rho * with_next + rho**2 * variance[here]) / square
        across = b[here] * b[here + 1] + with_next - rho * (b[here] ** 2 + variance[here])
        lapse = noise.state_lapse[here]
        growth = np.where(np.isfinite(lapse), lapse, 0.0) * rho
        by_time = growth * (across + rho * (1.0 - value[: len(here)] - unknown)) / square
        return value, np.concatenate([unknown, variance[first]]), by_time

    @cached_property
    def states(self) -> QuadraticForms:
        """By state (s,), in-run biases of the sensors first; `double` takes a step for known or unknown."""
        if not self.solution.equations.noise.states:
            nothing = np.zeros(self.solution.problem.sensors)
            return QuadraticForms(square=nothing, trace=nothing, double=nothing)
        square, unknown, _ = self._steps
        known = np.clip(1.0 - unknown, 0.0, 1.0).sum(axis=0)
        return QuadraticForms(square=square.sum(axis=0), trace=(1.0 - unknown).sum(axis=0), double=known)

    @cached_property
    def times(self) -> Array:
        """∂ℓ/∂ln τ by state (s,)."""
        moves = self.solution.equations.noise.states > 0
        return self._steps[2].sum(axis=0) if moves else np.zeros(len(self.states.square))

    @cached_property
    def priors(self) -> QuadraticForms:
        """By parameter (m,), of its prior."""
        solution, problem = self.solution, self.solution.problem
        q = solution.local.shape[-1]
        off = solution.linearisation.point.values + solution.parameters[1:] - problem.prior_mean[1:]
        return _of_priors(off, (solution.roots[0, q + 1 :] ** 2).sum(axis=-1), problem.prior_u[1:])

    @cached_property
    def local_priors(self) -> QuadraticForms:
        """By parameter that sessions have beside (S, q), of its prior."""
        solution = self.solution
        q, off = solution.local.shape[-1], solution.linearisation.point.local + solution.local
        return _of_priors(off, (solution.roots[:, :q] ** 2).sum(axis=-1), solution.problem.local_u)


def _of_priors(off: Array, variance: Array, size: Array) -> QuadraticForms:
    """The forms of priors of standard deviations `size` by values and variances."""
    square = np.where(size > 0.0, size, np.inf) ** 2
    learned = 1.0 - variance / square
    return QuadraticForms(square=off**2 / square, trace=learned, double=np.clip(learned, 0.0, 1.0))


# -------------------- components --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Scales:
    """What hyperparameters set: standard deviations and times of `VarianceComponents` by name, and factors of sensors
    (n,), of parameters (m,) and of those that sessions have beside (q,)."""

    components: dict[str, Any]
    sensors: Array
    groups: Array
    local: Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class WorkingVariates:
    """Working variates D P r of D hyperparameters (…, D), whitened: of rows of rests (N, r), turns (K, t) and links
    (J, 9), of steps of the states (M, s) and of the first ones of each session (S, s), of priors (m,) and (S, q)."""

    solution: Solution
    rest: Array
    turn: Array
    link: Array
    steps: Array
    begins: Array
    prior: Array
    local: Array

    @staticmethod
    def of(solution: Solution, count: int) -> WorkingVariates:
        """Zeros, of so many hyperparameters."""
        equations, problem, n = solution.equations, solution.problem, solution.equations.noise.states
        shapes = {
            "rest": equations.rest_rows.shape[:2],
            "turn": equations.turn_rows.shape[:2],
            "link": equations.link_rows.shape[:2],
            "steps": (len(problem.link), n),
            "begins": (len(problem.parts), n),
            "prior": problem.prior_u[1:].shape,
            "local": solution.local.shape,
        }
        return WorkingVariates(solution=solution, **{name: np.zeros((*of, count)) for name, of in shapes.items()})

    def add_scatter(self, column: int, rest: BoolArray, turn: BoolArray, link: BoolArray) -> None:
        """Those of some directions of scatter: v Z Zᵀ W r."""
        solution, noise = self.solution, self.solution.equations.noise
        for out, W, (r, _), (Z, place), some in (
            (self.rest, solution.equations.rest_whitening, solution.rest_residuals, noise.scaled_rest_directions, rest),
            (self.turn, solution.equations.turn_whitening, solution.turn_residuals, noise.turn_directions, turn),
            (self.link, solution.equations.link_whitening, solution.link_residuals, noise.scaled_link_directions, link),
        ):
            if some.any():
                WZ = W @ Z[:, :, some]
                along = (r[:, None, :] @ WZ)[:, 0] * solution.components.variances[place[some]]
                out[..., column] += 2.0 * (WZ @ along[:, :, None])[:, :, 0]

    def add_sizes(self, column: int, sensors: slice | IntArray) -> None:
        """Those of the size of states: the residuals of the steps."""
        if self.solution.equations.noise.states:
            steps, begins = self._residual_steps
            self.steps[:, sensors, column] += 2.0 * steps[:, sensors]
            self.begins[:, sensors, column] += 2.0 * begins[:, sensors]

    def add_times(self, column: int, sensors: slice | IntArray) -> None:
        """Those of the correlation time. With S β the steps, of variances V, and w = V⁻¹ S β, it changes the covariance
        S⁻¹ V S⁻ᵀ of the states so that the variate is −V^{−½} (−∂S β − V S⁻ᵀ ∂Sᵀ w + ∂V w)."""
        noise, first = self.solution.equations.noise, [part.stations.start for part in self.solution.problem.parts]
        b, follows = self.solution.states, noise.follows[:, None]
        lapse = np.where(follows & np.isfinite(noise.state_lapse), noise.state_lapse, 0.0)
        rho, step = np.where(follows, noise.state_rho, 0.0), np.where(follows, noise.state_step, 1.0)
        slope, residual = rho * lapse, np.zeros_like(b)
        residual[:-1] = (b[1:] - rho[:-1] * b[:-1]) / step[:-1] ** 2  # w of the step that follows a rest
        back = np.ascontiguousarray(-slope * residual)
        along_chains(rho[:, :, None] * np.eye(b.shape[1]), back[:, :, None])
        after = np.append(back[1:], np.zeros((1, b.shape[1])), axis=0)
        changed = slope * b - step**2 * after - 2.0 * rho * slope * residual
        self.steps[:, sensors, column] -= np.where(follows, changed / step, 0.0)[:, sensors]
        self.begins[:, sensors, column] += back[first][:, sensors]

    @property
    def _residual_steps(self) -> tuple[Array, Array]:
        """Whitened residuals of the steps that follow stations (M, s) and of the first states of sessions (S, s)."""
        noise, b = self.solution.equations.noise, self.solution.states
        steps, here = np.zeros_like(b), np.flatnonzero(noise.follows)
        steps[here] = -(b[here + 1] - noise.state_rho[here] * b[here]) / noise.state_step[here]
        return steps, -b[[part.stations.start for part in self.solution.problem.parts]]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Hyperparameter:
    """An element of φ: its name, unit and words, its usual value, SI, about which its prior is, and the standard
    deviation `within` of that in the logarithm; `members` are the sensors or parameters that it concerns.

    Subclasses say where it enters, what it scales, its score, and its working variate."""

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

    def log_prior(self, phi: Array) -> tuple[Array, Array, Array]:
        """The logarithm of the prior density of φ less a constant, its derivative, and the curvature of its negative:
        normal."""
        z = (phi - self.centre) / self.within
        return -0.5 * z * z, -z / self.within, np.broadcast_to(self.within**-2.0, z.shape)

    def apply(self, value: Array, scales: Scales) -> None:
        """Enter a value, or a stack of them."""
        raise NotImplementedError

    def forms(self, score: Score) -> QuadraticForms:
        """The quadratic forms of its variance."""
        raise NotImplementedError

    def slope(self, score: Score) -> tuple[float, float]:
        """∂ ln L/∂φ of the restricted likelihood, and its information as far as it is had in closed form."""
        forms = self.forms(score)
        return float(forms.square - forms.trace), 2.0 * float(forms.double)

    def write_variate(self, column: int, variates: WorkingVariates) -> None:
        """Enter its working variate."""
        raise NotImplementedError


class Scatter(Hyperparameter):
    """ln σ of a component of scatter."""

    __slots__ = ()

    def log_prior(self, phi: Array) -> tuple[Array, Array, Array]:
        """That of σ exponential with the mean `usual`; of the scatter of turns, of links and of a magnetometer of
        density m/(m + σ)²."""
        z = phi - self.centre
        x = np.exp(z)
        if self.name in (*TURN_SCATTER, *LINK_SCATTER, "mag"):
            return z - 2.0 * np.log1p(x), (1.0 - x) / (1.0 + x), 2.0 * x / (1.0 + x) ** 2
        return z - x, 1.0 - x, x

    def apply(self, value: Array, scales: Scales) -> None:
        """Set the standard deviation."""
        scales.components[self.name] = value

    def forms(self, score: Score) -> QuadraticForms:
        """Those of its directions."""
        i, of = SCATTER.index(self.name), score.scatter
        return QuadraticForms(square=of.square[i], trace=of.trace[i], double=of.double[i, i])

    def write_variate(self, column: int, variates: WorkingVariates) -> None:
        """Along its directions."""
        noise = variates.solution.equations.noise
        every = noise.rest_directions, noise.turn_directions, noise.link_directions
        places = (place == SCATTER.index(self.name) for _, place in every)
        variates.add_scatter(column, *places)


class InRunSize(Hyperparameter):
    """ln σ_b of a kind of sensors."""

    __slots__ = ()

    def apply(self, value: Array, scales: Scales) -> None:
        """Set the standard deviation."""
        scales.components[self.name] = value

    def forms(self, score: Score) -> QuadraticForms:
        """Those of its steps."""
        return score.states.sum(self.members)

    def write_variate(self, column: int, variates: WorkingVariates) -> None:
        """In the steps of the states."""
        variates.add_sizes(column, self.members)


class CorrelationTime(Hyperparameter):
    """ln τ_b of a kind of sensors."""

    __slots__ = ()

    def apply(self, value: Array, scales: Scales) -> None:
        """Set the time."""
        scales.components[self.name] = value

    def slope(self, score: Score) -> tuple[float, float]:
        """Eq. (25)."""
        return float(score.times[self.members].sum()), 0.5 * float(score.states.double[self.members].sum())

    def write_variate(self, column: int, variates: WorkingVariates) -> None:
        """In the steps of the states."""
        variates.add_times(column, self.members)


class SensorFactor(Hyperparameter):
    """p of the scatter at rest and the in-run bias of a sensor over those of its kind."""

    __slots__ = ()
    bounded = True

    def apply(self, value: Array, scales: Scales) -> None:
        """Multiply them."""
        scales.sensors[..., self.members] *= value[..., None]

    def forms(self, score: Score) -> QuadraticForms:
        """Those of its scatter and of its steps."""
        return score.sensors.sum(self.members)

    def write_variate(self, column: int, variates: WorkingVariates) -> None:
        """Along its direction at rest, and in the steps of its state."""
        noise = variates.solution.equations.noise
        rest = np.zeros(len(noise.rest_directions[1]), dtype=bool)
        rest[self.members] = True
        none = (np.zeros(len(place), dtype=bool) for _, place in (noise.turn_directions, noise.link_directions))
        variates.add_scatter(column, rest, *none)
        variates.add_sizes(column, self.members)


class GroupSize(Hyperparameter):
    """p of the size of a group of parameters."""

    __slots__ = ()
    bounded = True

    def apply(self, value: Array, scales: Scales) -> None:
        """Multiply the standard deviations of the priors."""
        scales.groups[..., self.members] *= value[..., None]

    def forms(self, score: Score) -> QuadraticForms:
        """Those of its priors (26)."""
        return score.priors.sum(self.members)

    def write_variate(self, column: int, variates: WorkingVariates) -> None:
        """In its priors."""
        problem, solution = variates.solution.problem, variates.solution
        off = solution.linearisation.point.values + solution.parameters[1:] - problem.prior_mean[1:]
        variates.prior[self.members, column] = -2.0 * (off / problem.prior_u[1:])[self.members]


class LocalGroupSize(Hyperparameter):
    """p of the size of a group of which each session has its own."""

    __slots__ = ()
    bounded = True

    def apply(self, value: Array, scales: Scales) -> None:
        """Multiply the standard deviations of the priors."""
        scales.local[..., self.members] *= value[..., None]

    def forms(self, score: Score) -> QuadraticForms:
        """Those of its priors in all sessions."""
        return score.local_priors.sum(self.members)

    def write_variate(self, column: int, variates: WorkingVariates) -> None:
        """In its priors."""
        solution = variates.solution
        off = (solution.linearisation.point.local + solution.local) / solution.problem.local_u
        variates.local[:, self.members, column] = -2.0 * off[:, self.members]


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


def hyperparameters_of(problem: Problem, noise: NoiseModel, seen: BoolArray) -> tuple[Hyperparameter, ...]:
    """The hyperparameters of a problem: the components of scatter (c,) that are `seen`, the in-run biases, and the
    groups whose size is by a prior."""
    observations, blocks, out = problem.observations, problem.instrument.blocks, list[Hyperparameter]()

    # components of scatter: each stands beside the noise along its directions
    both = (
        (noise.rest, *noise.rest_directions),
        (noise.turn, *noise.turn_directions),
        (noise.link, *noise.link_directions),
    )
    for number, (name, (unit, words)) in enumerate(SCATTER_WORDS.items()):
        beside = [np.zeros(0)]
        for covariance, Z, place in both if seen[number] else ():
            along = Z[:, :, place == number]
            length = (along**2).sum(axis=1)
            size = np.einsum("kaq,kab,kbq->kq", along, covariance, along)
            beside.append(size[length > 0.0] / length[length > 0.0] ** 2)
        if len(every := np.concatenate(beside)):
            usual = 1.0 if name in LINK_SCATTER else float(np.sqrt(np.median(every)))
            out.append(Scatter(name=name, unit=unit, words=words, usual=usual))

    # in-run biases of both kinds, and sensors whose bias wanders more than that of the others
    rests, first = observations.rests, 0
    covariances = (rests.accel_covariance, rests.gyro_covariance) if len(problem.link) > 1 else ()
    for block, covariance in zip(blocks, covariances, strict=False):
        kind, words = block.kind, "accelerometers" if block.kind == "accel" else "gyros"
        process: dict[str, Any] = {"within": IN_RUN_WITHIN, "members": slice(first, first + block.size)}
        usual, unit = observations.in_run.get(kind, typical_noise(covariance)), SCATTER_WORDS[kind][0]
        words_of_bias = f"in-run bias of the {words}"
        out.append(InRunSize(name=f"{kind}_in_run", unit=unit, words=words_of_bias, usual=usual, **process))
        words_of_time = f"correlation time of the {words_of_bias}"
        out.append(
            CorrelationTime(name=f"{kind}_time", unit="s", words=words_of_time, usual=CORRELATION_TIME, **process)
        )
        for c, sensor in enumerate(block.sensors if block.size > 1 else ()):
            words_of_sensor = f"scatter and in-run bias of {kind} {sensor} over those of the others"
            size = _factor(f"{kind}.in_run.{sensor}", words_of_sensor, UNLIKE, slice(first + c, first + c + 1))
            out.append(SensorFactor(**size))
        first += block.size
    if problem.moves:
        out += _displacement(first)

    # groups of parameters beyond the linear model. A lag multiplies others: a wide prior would let both grow.
    # Curvatures are not wider than usual where there are but two temperatures, nor is a hysteresis where they came one
    # way: what a bias has beyond its usual size would be taken for one.
    two, both_sides = at_two_temperatures(observations), both_ways(observations)
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
    return tuple(out)


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


def scaled(
    problem: Problem, hyperparameters: Sequence[Hyperparameter], phi: Array
) -> tuple[Problem, VarianceComponents]:
    """The problem with the priors of its groups as large as φ (D,) says, and the components of variance; or stacks."""
    stack, m = phi.shape[:-1], len(problem.usual_u) - 1
    scales = Scales(
        components=dict.fromkeys(SCATTER, np.zeros(stack)[()]),
        sensors=np.ones((*stack, problem.sensors)),
        groups=np.ones((*stack, m)),
        local=np.ones((*stack, len(problem.usual_local_u))),
    )
    for i, h in enumerate(hyperparameters):
        h.apply(np.asarray(h.value(phi[..., i])), scales)
    known = np.broadcast_to(problem.usual_u, (*stack, 1 + m)).copy()
    known[..., 1:] *= scales.groups
    components = VarianceComponents(**scales.components, unlike=scales.sensors)
    return replace(problem, prior_u=known, local_u=problem.usual_local_u * scales.local), components


def log_prior(hyperparameters: Sequence[Hyperparameter], phi: Array) -> Array:
    """Of every element the logarithm of the prior density of φ (D,), less a constant, its derivative, and the curvature
    of its negative (3, D)."""
    every = [h.log_prior(phi[..., i]) for i, h in enumerate(hyperparameters)]
    return np.stack([np.stack(each, axis=-1) for each in zip(*every, strict=True)]) if every else np.zeros((3, 0))


def restricted_likelihood(
    linearisation: Linearisation,
    hyperparameters: Sequence[Hyperparameter],
    phi: Array,
    equations: NormalEquations | None = None,
) -> Solution:
    """The solution, with ℓ, at φ (D,) or at a stack (P, D) of them.

    Parameters
    ----------
    linearisation
        The rows, with priors of any size.
    hyperparameters, phi
        The elements of φ, and their values.
    equations
        The normal equations, where these are known: no component of variance differs from those that they have.
    """
    problem, components = scaled(linearisation.problem, hyperparameters, phi)
    here = linearisation.with_priors(problem).with_components(components)
    prior = log_prior(hyperparameters, phi)[0].sum(axis=-1)
    return add_priors(here, equations or eliminate_rests(here), phi, prior)


def score(hyperparameters: Sequence[Hyperparameter], solution: Solution) -> tuple[Array, Array]:
    """Gradient (D,) of ℓ, and its information (D, D) as far as it is had in closed form: of components of scatter that
    of two together, else each for itself."""
    forms, prior = Score(solution), log_prior(hyperparameters, solution.phi)
    slopes = np.array([h.slope(forms) for h in hyperparameters]).reshape(-1, 2).T
    information = np.diag(slopes[1] + prior[2])
    scatter = [i for i, h in enumerate(hyperparameters) if isinstance(h, Scatter)]
    places = [SCATTER.index(hyperparameters[i].name) for i in scatter]
    information[np.ix_(scatter, scatter)] = 2.0 * forms.scatter.double[np.ix_(places, places)] + np.diag(
        prior[2, scatter]
    )
    return slopes[0] + prior[1], information


def average_information(hyperparameters: Sequence[Hyperparameter], solution: Solution) -> Array:
    """The average of observed and expected information (D, D) of ℓ, with the curvature of the prior.

    With the working variates Q = [∂V/∂φ_a P r] of all rows it is ½ QᵀPQ (Gilmour, Thompson and Cullis 1995): Q are
    further right-hand sides of the elimination, of which its triangle has what no unknown explains.
    """
    linearisation, equations, problem = solution.linearisation, solution.equations, solution.problem
    D, point = len(hyperparameters), solution.linearisation.point
    variates = WorkingVariates.of(solution, D)
    for column, h in enumerate(hyperparameters):
        h.write_variate(column, variates)

    def beside(rows: Array, columns: Array) -> Array:
        return np.concatenate([rows[..., :-1], columns, rows[..., -1:]], axis=-1)

    d, q, sides = equations.unknowns, solution.local.shape[-1], slice(-1 - D, -1)
    rest, turn, link = (
        beside(rows, columns)
        for rows, columns in (
            (equations.rest_rows, variates.rest),
            (equations.turn_rows, variates.turn),
            (equations.link_rows, variates.link),
        )
    )
    states = equations.noise.states
    rest, joints = station_rows(problem, rest), turn
    if states:
        joints = joint_rows(linearisation, turn, link)
        joints[:, -states:, sides] = variates.steps
    width, p = rest.shape[2] - d, len(problem.prior_u)
    common = np.zeros((p + D + 1, p + D + 1), order="F")
    u, expected = problem.prior_u, problem.prior_mean - np.append(point.gravity, point.values)
    rows = np.zeros((p, p + D + 1))
    np.fill_diagonal(rows, np.divide(1.0, u, out=np.zeros(p), where=u > 0.0))
    rows[:, -1] = rows.diagonal() * expected
    rows[1:, p:-1] = variates.prior
    fold(rows, common)
    for array in () if linearisation.about is None else linearisation.about.arrays:
        in_motion = array.rows(problem.instrument, point.values)
        fold(np.hstack([np.zeros((len(in_motion), 1)), beside(in_motion, np.zeros((len(in_motion), D)))]), common)
    for s, part in enumerate(problem.parts):
        begins, triangle = np.zeros((d, d + rest.shape[2])), np.zeros((width, width), order="F")
        begins[d - states :, d - states : d] = np.eye(states)
        begins[d - states :, sides] = variates.begins[s]
        between, links = joints[part.stations if states else part.turns], session_links(part, chained=states > 0)
        eliminate(rest[part.stations], between, links, np.empty((len(part.link), *begins.shape)), triangle, begins)
        if q:
            local = np.zeros((q, width))
            local[:, :q], local[:, sides] = np.diag(1.0 / problem.local_u), variates.local[s]
            local[:, -1] = linearisation.local_prior[s]
            fold(local, triangle)
        fold(triangle[q:, q:].copy(order="F"), common)
    R = np.triu(common)[p : p + D, p : p + D]
    return np.asarray(0.5 * R.T @ R + np.diag(log_prior(hyperparameters, solution.phi)[2]))
