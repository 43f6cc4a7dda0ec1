"""Hyperparameters φ of the model, their priors, and the gradient and average information of ℓ(φ).

| φ | quantity | prior |
|---|---|---|
| ln σ of a component of variance | rests | σ exponential, with the noise it is added to, m, as mean |
| | turns, velocities …, magnetometer | σ of density m/(m + σ)² |
| ln σ_b, ln τ_b of a kind of sensor | in-run bias, a Gauss–Markov process | log-normal about grade and 300 s, ÷× 30 |
| ln σ_p, ln τ_p | displacement of a moving device, a Gauss–Markov process | log-normal about 2 cm and 0.5 s |
| p of a sensor | factor exp(max(p, 0)) on its scatter and in-run bias, relative to its kind | N(0, ln 3) |
| p of a group of parameters | factor exp(max(p, 0)) on its usual size | N(0, ln k) |

For a device that lies still while it warms up, ÷× 30 is ÷× 5, there is no scatter from one part of the rest to the
next, and all sensors of a kind are alike.

k is 2 for a data sheet, 3 for a stated grade, 10 for a guessed grade if the next poorer grade has a larger size. The
reasons for these priors are in docs/explanation/mathematics.md, section 8.

Gradient. All hyperparameters but the correlation times are variances v of rows: of rests, of turns, of the steps of a
process, or of priors. With D = ∂V/∂v, P the projection onto residuals and r = y − X x̂, for ln σ with σ² = v, (24) to
(26),

    ∂ℓ/∂ln σ = v (rᵀPDPr − tr PD)

For rows of a prior or of a step, with unit variance, v rᵀPDPr is the sum of their squared residuals e and v tr PD the
sum of 1 − Var e. For a correlation time, with e_k the steps divided by √(1 − ρ²), Fisher's identity (25) gives

    ∂ℓ/∂ln τ = Σ ρ Δt/τ · (E[(β_{k+1} − ρ β_k) β_k] + ρ (1 − E e²)) / (1 − ρ²)

To add a hyperparameter, add an entry in `hyperparameters_of`, and its forms in `quadratic_forms`.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np

from tumble.inference.elimination import recur_backwards
from tumble.inference.elimination_kernels import state_forms
from tumble.inference.linearisation import Linearisation
from tumble.inference.noise import (
    CORRELATION_TIME,
    DISPLACEMENT,
    DISPLACEMENT_TIME,
    LINK_SCATTER,
    REST_SCATTER,
    SCATTER,
    SCATTER_WORDS,
    STATIONS,
    NoiseModel,
    VarianceComponents,
    typical_noise,
)
from tumble.inference.normal_equations import (
    Solution,
    add_priors,
    eliminate_rests,
    explained,
    times_root,
)
from tumble.inference.problem import Problem
from tumble.inference.variables import at_two_temperatures, ramps_up_and_down
from tumble.sensors.parameters import group_of, next_poorer_grade, prior_sizes, variable_of
from tumble.units import Array, BoolArray, IntArray

# Prior standard deviation of ln σ_b and ln τ_b: 90 % within ÷× 30, so that the process can follow a drift, which has no
# parameters. With ÷× 5, biases of a BMI160 that move by 4 mg in 237 s changed its scale factors.
IN_RUN_WITHIN = float(np.log(30.0) / 1.645)
# The same for a device that lies still, whose drift with temperature has parameters: 90 % of a grade within ÷× 5.
UNDISTURBED_WITHIN = float(np.log(5.0) / 1.645)
# Factor by which a usual size may be too small, from a data sheet, a stated grade, or a guessed grade.
SHEET, STATED, GUESSED = 2.0, 3.0, 10.0
UNLIKE = 3.0  # the same for the scatter and in-run bias of a sensor, relative to others of its kind
# Residual degrees of freedom below which a component of variance is not estimated; it would be divided by rounding.
LEAST_DEGREES = 0.5


Members = slice | IntArray
Kind = Literal["scatter", "process", "time", "sensor", "group", "local group"]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Hyperparameter:
    """Element of φ.

    It is ln σ of a component of variance in SCATTER ("scatter"), ln σ or ln τ of a Gauss–Markov process ("process",
    "time"), or p of a factor λ = exp(max(p, 0)): on scatter at rest and in-run bias of one sensor ("sensor"), or on the
    size of a group of common parameters ("group") or of those of each session ("local group"). `usual` is the quantity,
    SI, about which the prior is, `within` its standard deviation in the logarithm, and `members` the components,
    sensors, states or parameters concerned."""

    kind: Kind
    name: str
    unit: str
    words: str
    usual: float
    within: float = 0.0
    members: Members = field(default_factory=lambda: slice(None))

    @property
    def bounded(self) -> bool:
        """True for p of λ = exp(max(p, 0))."""
        return self.kind in {"sensor", "group", "local group"}

    @property
    def centre(self) -> float:
        """Centre of the prior of φ."""
        return 0.0 if self.bounded else float(np.log(self.usual))

    def value(self, phi: Any) -> Any:
        """Return the quantity, SI, at φ."""
        return np.exp(np.maximum(phi, 0.0) if self.bounded else phi)

    def log_prior(self, phi: Array) -> Array:
        """Return `Hyperparameters.log_prior` (3, …) of this element alone, at values (…)."""
        return Hyperparameters((self,)).log_prior(phi[..., None])[..., 0]


class Hyperparameters(tuple[Hyperparameter, ...]):
    """Elements of φ."""

    @cached_property
    def bounded(self) -> BoolArray:
        """Which elements (D,) are p of λ = exp(max(p, 0))."""
        return np.array([h.bounded for h in self], dtype=bool)

    def variances(self, phi: Array) -> BoolArray:
        """Return which elements (D,) are logarithms of standard deviations that matter at φ (D,)."""
        times = np.array([h.kind == "time" for h in self], dtype=bool)
        return ~times & ~(self.bounded & (phi <= 0.0))

    @cached_property
    def centre(self) -> Array:
        """Centre (D,) of the prior of φ."""
        return np.array([h.centre for h in self])

    @cached_property
    def _priors(self) -> tuple[Array, IntArray, IntArray]:
        """1/within (D,), 0 unless the prior is normal, and the indices of scatter of rests, and of turns and links."""
        scatter = [i for i, h in enumerate(self) if h.kind == "scatter"]
        at_rest, others = (
            np.array([i for i in scatter if (self[i].name in REST_SCATTER) is rests], dtype=int)
            for rests in (True, False)
        )
        return np.array([0.0 if i in scatter else 1.0 / h.within for i, h in enumerate(self)]), at_rest, others

    def log_prior(self, phi: Array) -> Array:
        """Return, for every element, the logarithm of the prior density at φ (D,) up to a constant, its derivative, and
        minus its second derivative (3, D)."""
        (inverse_width, at_rest, others), off = self._priors, phi - self.centre
        out, z = np.empty((3, *phi.shape)), off * inverse_width
        out[0], out[1], out[2] = -0.5 * z * z, -z * inverse_width, inverse_width * inverse_width
        z = off[..., at_rest]
        x = np.exp(z)
        out[..., at_rest] = z - x, 1.0 - x, x
        z = off[..., others]
        x = np.exp(z)
        out[..., others] = z - 2.0 * np.log1p(x), (1.0 - x) / (1.0 + x), 2.0 * x / (1.0 + x) ** 2
        return out

    @cached_property
    def _members(self) -> dict[tuple[tuple[Kind, int], ...], Array]:
        return {}

    def members(self, *counts: tuple[Kind, int]) -> Array:
        """Return a matrix (D, Σ count), 1 where an element of a kind concerns one of the `count` members, else 0."""
        if counts not in self._members:
            out = self._members[counts] = np.zeros((len(self), sum(count for _, count in counts)))
            for i, h in enumerate(self):
                first = 0
                for kind, count in counts:
                    if h.kind == kind:
                        out[i, first : first + count][h.members] = 1.0
                    first += count
        return self._members[counts]


# -------------------- score --------------------


def quadratic_forms(hyperparameters: Hyperparameters, solution: Solution) -> Array:
    """Return v rᵀPDPr and v tr PD (2, D) of the variance v of every element of φ.

    For a correlation time they are the derivative of ℓ and 0. Raises LinAlgError if residuals are not finite."""
    problem, equations, point = solution.problem, solution.equations, solution.linearisation.point
    noise = equations.noise
    n, s, q = problem.sensors, noise.states, solution.local.shape[-1]

    # components of variance, and directions of single sensors at rest
    scatter, of_sensors = np.zeros((2, len(SCATTER))), np.zeros((2, n))
    for kind, r, C, WZ, component in solution.scatter:
        square, trace = ((r[:, None] @ WZ) ** 2).sum(axis=(0, 1)), (WZ * (C @ WZ)).sum(axis=(0, 1))
        forms = noise.variances[component] * np.stack([square, trace])
        scatter += forms @ (component[:, None] == np.arange(len(SCATTER)))
        if kind in noise.places:
            of_sensors[:, noise.places[kind]] = forms
    if not np.isfinite(scatter.sum()):
        raise np.linalg.LinAlgError("residuals are beyond all measure")

    # initial states of all sessions and their steps
    states = np.zeros((3, max(s, n)))
    if s:
        work = np.empty((2, s, 2))
        arrays = equations.sensitivity, *solution.conditional_covariances
        for part, root, shared in zip(problem.session_spans, solution.roots, solution.shared, strict=True):
            sensitivity, here, with_next = (array[part.stations] for array in arrays)
            process = noise.state_rho[part.stations], noise.state_step[part.stations], noise.state_lapse[part.stations]
            along = times_root(sensitivity[:, -s:, :-1], root)
            state_forms(sensitivity, here, with_next, along, shared, *process, work, states)
    times = np.stack([states[2], np.zeros(states.shape[1])])

    def prior_forms(off: Array, variance: Array, size: Array) -> Array:
        information = np.divide(1.0, size**2, out=np.zeros_like(size), where=size > 0.0)
        return np.stack([off**2 * information, 1.0 - variance * information])

    off = point.values + solution.parameters[1:] - problem.prior_mean[1:]
    off_local = point.local + solution.local
    priors = prior_forms(off, (solution.roots[0, q + 1 :] ** 2).sum(axis=-1), problem.prior_u[1:])
    local_priors = prior_forms(off_local, (solution.roots[:, :q] ** 2).sum(axis=-1), problem.local_u)

    of_kinds: tuple[tuple[Kind, Array], ...] = (
        ("scatter", scatter),
        ("process", states[:2]),
        ("time", times),
        ("sensor", of_sensors + states[:2, :n]),
        ("group", priors),
        ("local group", local_priors.sum(axis=1)),
    )
    members = hyperparameters.members(*((kind, form.shape[1]) for kind, form in of_kinds))
    return np.asarray(np.concatenate([form for _, form in of_kinds], axis=1) @ members.T)


def derivatives(hyperparameters: Hyperparameters, solution: Solution) -> tuple[Array, Array, Array]:
    """Return the gradient (D,) of ℓ, its average information (D, D), and B (D, D), minus its second derivative.

    For ln σ of a variance v = σ², with D = ∂V/∂v,

        −∂²ℓ/∂(ln σ)² = 2a − e + 2v (tr PD − rᵀPDPr),   a = 2v² rᵀPDPDPr,   e = 2v² tr PDPD

    a is the average information. e is taken as a tr PD/rᵀPDPr, which is exact where the variance is all there is. Where
    the likelihood rises along ln σ, B is the average information, so that it stays positive definite.
    """
    forms, information = quadratic_forms(hyperparameters, solution), average_information(hyperparameters, solution)
    square, trace = np.where(hyperparameters.variances(solution.phi), forms, 0.0)
    likelihood = np.maximum(information.diagonal() - solution.prior_terms[2], 0.0)
    share = likelihood / np.maximum(np.maximum(2.0 * square, likelihood), 1e-300)
    B = information + np.diag(2.0 * np.maximum(trace - square, 0.0) * (1.0 - share))
    return forms[0] - forms[1] + solution.prior_terms[1], information, B


def size_factors(
    grade: str, sizes: Mapping[str, float], sheet: Container[str] = (), *, guessed: bool
) -> dict[str, float]:
    """Return the factors by which the usual sizes of groups may be too small.

    Parameters
    ----------
    grade, guessed
        Grade of the instrument, and True if it is guessed. Where the next poorer grade has the same size, a wrong guess
        makes no difference.
    sizes
        Usual sizes of the groups, by name.
    sheet
        Names of groups whose sizes are from a data sheet.
    """
    worse = next_poorer_grade(grade) if guessed else None
    in_worse = {} if worse is None else prior_sizes(worse)
    return {
        name: SHEET if name in sheet else GUESSED if in_worse.get(name, 0.0) > size else STATED
        for name, size in sizes.items()
    }


def hyperparameters_of(problem: Problem, noise: NoiseModel, estimable: BoolArray) -> Hyperparameters:
    """Return the hyperparameters of a problem, with the `estimable` (c,) components of variance."""
    observations, blocks, out = problem.observations, problem.instrument.blocks, list[Hyperparameter]()
    undisturbed = problem.prior.undisturbed

    def add(kind: Kind, name: str, unit: str, words: str, usual: float, within: float, members: Members) -> None:
        out.append(
            Hyperparameter(kind=kind, name=name, unit=unit, words=words, usual=usual, within=within, members=members)
        )

    # components of variance, whose usual value is the noise along their directions
    noise_along: list[list[Array]] = [[] for _ in SCATTER]
    for rows in noise.rows.values():
        Z = rows.directions
        length, size = (Z**2).sum(axis=1), ((rows.covariance @ Z) * Z).sum(axis=1)
        for number in set(rows.component.tolist()):
            at = (rows.component == number) & (length > 0.0)
            noise_along[number].append(size[at] / length[at] ** 2)
    for number, (name, (unit, words)) in enumerate(SCATTER_WORDS.items()):
        variances = np.concatenate([np.zeros(0), *noise_along[number]])
        if estimable[number] and len(variances) and not (undisturbed and name in REST_SCATTER):
            usual = 1.0 if name in LINK_SCATTER else float(np.sqrt(np.median(variances)))
            add("scatter", name, unit, words, usual, 0.0, slice(number, number + 1))

    # in-run biases of both kinds, and factors of single sensors
    rests, first = observations.rests, 0
    covariances = (rests.accel_covariance, rests.gyro_covariance) if len(problem.chain) > 1 else ()
    for block, covariance in zip(blocks, covariances, strict=False):
        kind, words = block.kind, "accelerometers" if block.kind == "accel" else "gyros"
        within = UNDISTURBED_WITHIN if undisturbed else IN_RUN_WITHIN
        usual, members = observations.in_run.get(kind, typical_noise(covariance)), slice(first, first + block.size)
        words = f"in-run bias of the {words}"
        add("process", f"{kind}_in_run", SCATTER_WORDS[kind][0], words, usual, within, members)
        add("time", f"{kind}_time", "s", f"correlation time of the {words}", CORRELATION_TIME, within, members)
        for c, sensor in enumerate(block.sensors if block.size > 1 and not undisturbed else ()):
            name = f"{kind}.in_run.{sensor}"
            words = f"scatter and in-run bias of {kind} {sensor} over those of the others"
            add("sensor", name, "1", words, 1.0, float(np.log(UNLIKE)), slice(first + c, first + c + 1))
        first += block.size
    if problem.moves:
        words, members = "displacement of the device in motion", slice(first, first + 3)
        add("process", "displacement", "m", words, DISPLACEMENT, 2.0, members)
        words = f"correlation time of the {words}"
        add("time", "displacement_time", "s", words, DISPLACEMENT_TIME, 1.0, members)

    # Groups beyond the linear model. A lag keeps its size, because it multiplies other parameters and both could grow
    # together. So does a curvature at only two temperatures, and a hysteresis if these were approached from one side:
    # it would absorb the excess of a bias over its usual size.
    two, both_sides = at_two_temperatures(observations), ramps_up_and_down(observations)
    held = {"lag", "temperature²" if two else "lag", "lag" if both_sides else "hysteresis"}
    common = {name: at for name, at in problem.instrument.members.items() if variable_of(name) not in held}
    of_kinds: tuple[tuple[Kind, Mapping[str, slice]], ...] = ("group", common), ("local group", problem.local_members)
    for kind_of_size, groups in of_kinds:
        for name in groups:
            if group_of(name).sized_with in groups:
                continue
            sized = [groups[other] for other in groups if other == name or group_of(other).sized_with == name]
            places = np.concatenate([np.arange(group.start, group.stop) for group in sized])
            within = float(np.log(observations.too_small.get(name, STATED)))
            add(kind_of_size, name, "1", f"size of {name} over the usual one", 1.0, within, places)
    return Hyperparameters(out)


# -------------------- likelihood --------------------


def scaled(problem: Problem, hyperparameters: Hyperparameters, phi: Array) -> tuple[Problem, VarianceComponents]:
    """Return the problem with prior sizes at φ (D,), and the components of variance; stacks for φ (P, D)."""
    values, m, q, n = np.exp(phi), len(problem.usual_u) - 1, len(problem.usual_local_u), problem.sensors
    members = hyperparameters.members(("group", m), ("local group", q), ("sensor", n))
    factors = np.exp(np.maximum(phi, 0.0) @ members)
    prior_u = np.empty((*phi.shape[:-1], 1 + m))
    prior_u[..., 0], prior_u[..., 1:] = problem.usual_u[0], problem.usual_u[1:] * factors[..., :m]
    local_u, unlike = problem.usual_local_u * factors[..., m : m + q], factors[..., m + q :]
    components: dict[str, Any] = {h.name: values[..., i] for i, h in enumerate(hyperparameters) if not h.bounded}
    zero = dict.fromkeys(SCATTER, np.zeros(phi.shape[:-1])[()])
    return problem.with_sizes(prior_u, local_u), VarianceComponents(**(zero | components), unlike=unlike)


def solution_at(linearisation: Linearisation, hyperparameters: Hyperparameters, phi: Array) -> Solution:
    """Return the solution, with ℓ, at φ (D,) or at a stack (P, D), whatever prior sizes the linearisation has."""
    problem, components = scaled(linearisation.problem, hyperparameters, phi)
    here = linearisation.with_priors(problem).with_components(components)
    return add_priors(here, eliminate_rests(here), phi=phi, prior_terms=hyperparameters.log_prior(phi))


def average_information(hyperparameters: Hyperparameters, solution: Solution) -> Array:
    """Return the average of observed and expected information (D, D) of ℓ, with the curvature of the prior.

    It is ½ QᵀPQ with the working variates Q = [∂V/∂φ_a P r] (Gilmour, Thompson and Cullis 1995). With whitened variates
    Z, rows X, and the covariance C of all unknowns,

        QᵀPQ = ZᵀZ − (XᵀZ)ᵀ C (XᵀZ)
    """
    equations, problem, D = solution.equations, solution.problem, len(hyperparameters)
    if D == 0:
        return np.zeros((0, 0))
    noise, point, q = equations.noise, solution.linearisation.point, solution.local.shape[-1]
    M, d, width = equations.sensitivity.shape
    at_stations, square = np.zeros((M, d, D)), np.zeros((D, D))  # of XᵀZ and of ZᵀZ
    of_sessions = np.zeros((len(problem.session_spans), width - 1, D))

    def add_square(Z: Array) -> None:
        square[:] += Z.reshape(-1, D).T @ Z.reshape(-1, D)

    # rows: Z of a component of variance is 2 v W z zᵀ Wᵀ r
    of_scatter = hyperparameters.members(("scatter", len(SCATTER)))
    of_sensors = hyperparameters.members(("sensor", problem.sensors))
    for kind, r, _, along, component in solution.scatter:
        members, rows = of_scatter[:, component], equations.rows[kind]
        if kind in noise.places:
            members += of_sensors[:, noise.places[kind]]
        Z = (2.0 * noise.variances[component] * (r[:, None] @ along) * along) @ members.T
        add_square(Z)
        products = np.swapaxes(rows[:, :, :-1], 1, 2) @ Z
        for e in range(STATIONS[kind]):
            at_stations[problem.first_station[kind] + e] += products[:, e * d : (e + 1) * d]
        for s, part in enumerate(problem.session_spans):
            of_sessions[s] += products[part.rows[kind], 1 - width :].sum(axis=0)

    # steps of states, and their initial values
    if states := noise.states:
        Z, of_initial = _variates_of_states(hyperparameters, solution)
        add_square(Z)
        add_square(of_initial)
        by_step = np.divide(Z, noise.state_step[:, :, None], out=np.zeros_like(Z), where=noise.follows[:, None, None])
        at_stations[:, d - states :] -= noise.state_rho[:, :, None] * by_step
        at_stations[1:, d - states :] += by_step[:-1]
        at_stations[[part.stations.start for part in problem.session_spans], d - states :] += of_initial

    # priors
    off = point.values + solution.parameters[1:] - problem.prior_mean[1:]
    u, off_local, local_u = problem.prior_u[1:, None], point.local + solution.local, problem.local_u[:, None]
    Z = -2.0 * (off[:, None] / u) * hyperparameters.members(("group", len(off))).T
    Z_local = -2.0 * (off_local[..., None] / local_u) * hyperparameters.members(("local group", q)).T
    add_square(Z)
    add_square(Z_local)
    of_sessions[:, :q] += Z_local / local_u
    of_sessions[0, q + 1 :] += Z / u
    square -= explained(solution, at_stations, of_sessions)
    return np.asarray(0.5 * square + np.diag(solution.prior_terms[2]))


def _variates_of_states(hyperparameters: Hyperparameters, solution: Solution) -> tuple[Array, Array]:
    """Return working variates of the steps of states after each station (M, s, D) and of initial states (S, s, D).

    For sizes they are the whitened residuals. With S β the steps of the states, of variances V, and w = V⁻¹ S β, those
    for a correlation time, which changes the covariance S⁻¹ V S⁻ᵀ of β, are −V^{−½} (−∂S β − V S⁻ᵀ ∂Sᵀ w + ∂V w)."""
    noise, b = solution.equations.noise, solution.states
    first = [part.stations.start for part in solution.problem.session_spans]
    follows, s, n = noise.follows[:, None], b.shape[1], solution.problem.sensors
    lapse = np.where(follows & np.isfinite(noise.state_lapse), noise.state_lapse, 0.0)
    rho, step = np.where(follows, noise.state_rho, 0.0), np.where(follows, noise.state_step, 1.0)
    residual, slope = np.zeros_like(b), rho * lapse
    residual[:-1] = np.where(follows[:-1], b[1:] - rho[:-1] * b[:-1], 0.0) / step[:-1] ** 2  # w
    back = np.ascontiguousarray(-slope * residual)
    recur_backwards(rho[:, :, None] * np.eye(s), back[:, :, None])
    after = np.append(back[1:], np.zeros((1, s)), axis=0)
    by_time = np.where(follows, (slope * b - step**2 * after) / step - 2.0 * rho * slope * residual / step, 0.0)
    sizes = hyperparameters.members(("process", s)).T.copy()
    if noise.biases:
        sizes[:n] += hyperparameters.members(("sensor", n)).T
    times = hyperparameters.members(("time", s)).T
    of_steps = -2.0 * (residual * step)[:, :, None] * sizes - by_time[:, :, None] * times
    return of_steps, -2.0 * b[first][:, :, None] * sizes + back[first][:, :, None] * times
