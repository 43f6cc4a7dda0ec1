"""The joint maximum of the likelihood over the unknowns x and the hyperparameters φ.

x are gravity, the parameters, what each session has of its own, the attitudes and the states of the in-run biases: what
is linear, or nearly so, given φ (`tumble.inference.hyperparameters`). Maximised is

    ℓ(φ) = ln p(φ) − ½ [rᵀV⁻¹r + x̂ᵀP₀x̂ + ln |V| − ln |P₀| + 2 Σ ln |diag R|]

the logarithm of the posterior of φ with x integrated out, r being the residuals at x̂(φ) (`tumble.inference.step`):
docs/explanation/mathematics.md (23), (28) and (29).

    x   Gauss–Newton: x ← x + argmin over the rows linearised at x. Turns are integrated again about the current
        parameters wherever the second-order effect of the change since counts.
    φ   at fixed rows a trust region: s = B⁻¹g, |s|∞ ≤ Δ, with the analytic score g, and B, at first the information of
        the score, then by the updates of Broyden, Fletcher, Goldfarb and Shanno. Sizes λ = exp(max(p, 0)) have p ≥ 0:
        below, p has nothing to do with the data.

It ends where a step of x is negligible beside u (CONVERGED) and ½ gᵀB⁻¹g, what ℓ would still gain, below GAIN
for every element of φ (`Status.converged`); or it runs out, which is said and is no result.

A chain of turns whose heading the gyros hardly see (no better than UNSEEN) keeps it where it is: it is still an unknown
of every step, so that it takes nothing from the parameters. So does gravity of an unknown place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from functools import cached_property

import numpy as np

from tumble.inference.fits import (
    LEAST_WEIGHT,
    LEFT_OUT,
    STANDS_OUT,
    residuals,
    sigmas,
    student,
    weighted,
)
from tumble.inference.hyperparameters import Hyperparameters, components_of, sized, table
from tumble.inference.likelihood import Point, Problem, Rows, noise_of
from tumble.inference.linearisation import linearise, with_priors
from tumble.inference.noise_components import REST_MODES, SCATTER, Components, Noise
from tumble.inference.step import (
    Known,
    Left,
    Step,
    Told,
    completed,
    in_run_scores,
    joined,
    left,
    scatter_score,
    solve,
    tell,
)
from tumble.inference.turns_about import TurnsAbout
from tumble.units import Array, BoolArray

MAX_ITERATIONS = 40
"""Linearisations at most."""
BEYOND = 3.0
"""Times the usual: scatter or a size for which another maximum is looked for."""
USELESS = {"turn": 0.3, "velocity": 3.0}
"""rad and m/s: the scatter of turns that say nothing."""
WIDE = 3.0
"""Standard deviations of p: the sizes of groups that are looked for from above."""
ANEW = 3.0
"""s: a correlation time of biases that are anew at every rest."""
STEPS = 6
"""Steps over φ at one linearisation at most."""
CONVERGED = 1e-3
"""Of the standard uncertainty: a step of x that is negligible."""
SETTLED = 0.05
"""A change of the weight of a row that is none."""
GAIN = 0.5 * 0.05**2
"""What ℓ would still gain by each element of φ where φ counts as settled: they are within 0.05 of their standard
deviations, root mean square."""
NEAR, FAR_STEPS = 1.0, 2
"""Of u: until x is so near, at most for so many linearisations, φ stays as it is, for residuals are of x then."""
FURTHEST = 2.0
"""Δ at first and at most."""
SQUARED = 10.0
"""Error after a step of Gauss–Newton, in units of the spreads, over the square of the step."""
UNSEEN = 0.2
"""rad: a heading that the gyros know to no better."""
TO_AND_FRO = 6
"""Linearisations after which a heading that still moves is one that the gyros do not know either, and weights of rows
go half the way."""
PLACE_UNKNOWN = 1e-3
"""Normal gravity is known to a third of that anywhere."""
SENSED = 0.2
"""Of the rests: what the scatter of a single sensor is told by at first, until its curvature is known."""
LEAST_DEGREES = 0.5
"""Of freedom: a component of scatter of which the fit leaves less is not estimated. It is by what is left of it, in the
end by rounding, that its variance would be divided."""


class Status(Enum):
    """Why the iteration ended."""

    converged = "x and φ settled"
    ran_out = "the steps ran out before x and φ settled"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class At:
    """A point, the turns about parameters near it, the rows linearised there, and their noise."""

    point: Point
    about: TurnsAbout | None
    rows: Rows
    noise: Noise

    @staticmethod
    def of(problem: Problem, point: Point, about: TurnsAbout | None, kept: tuple[Array, Array] | None = None) -> At:
        """The rows of a problem at a point, and their noise, with the square roots of the weights that are `kept`."""
        rows = linearise(problem, point, about)
        noise = noise_of(problem, rows)
        return At(point=point, about=about, rows=rows, noise=noise if kept is None else replace(noise, kept=kept))

    def solved(self, problem: Problem, components: Components) -> Step:
        """The least-squares step from here with the priors of a problem and components of variance."""
        return solve(problem, with_priors(self.rows, problem, self.point, self.about), self.noise.weights(components))


@dataclass(frozen=True, kw_only=True, eq=False)
class Evaluated:
    """ℓ at φ and one linearisation: the `prior` of φ with its derivatives, the `value` of ℓ, the problem with priors of
    that size, what the rows tell and what is known by them and the priors; when they are asked for, the step, what it
    leaves, and the score. Of a stack of φ all of these have an axis more, the first one, that of derivatives the
    second."""

    entries: Hyperparameters
    at: At
    phi: Array
    prior: Array
    value: Array
    problem: Problem
    told: Told
    known: Known

    @staticmethod
    def of(problem: Problem, entries: Hyperparameters, at: At, phi: Array, told: Told | None = None) -> Evaluated:
        """ℓ at φ; what the rows tell may be known where no component of variance is another one."""
        sizes = sized(problem, entries, phi)
        rows = with_priors(at.rows, sizes, at.point, at.about)
        told = told or tell(sizes, rows, at.noise.weights(components_of(entries, phi)))
        known, prior = joined(sizes, rows, told), entries.prior(phi)
        value = prior[0].sum(axis=-1) - 0.5 * known.deviance
        return Evaluated(
            entries=entries, at=at, phi=phi, prior=prior, value=value, problem=sizes, told=told, known=known
        )

    @cached_property
    def step(self) -> Step:
        """The least-squares step."""
        return completed(self.problem, self.told, self.known)

    @cached_property
    def left(self) -> Left:
        """What it leaves of the residuals."""
        return left(self.problem, self.step)

    @property
    def gradient(self) -> Array:
        """∂ℓ/∂φ (D,)."""
        return self.score[0]

    @property
    def information(self) -> Array:
        """The information (D, D) of the score as far as it is had in closed form."""
        return self.score[1]

    @cached_property
    def of_groups(self) -> tuple[Array, Array]:
        """∂ℓ/∂ ln λ of sizes of groups (D,), in common and of each session (26), and how much is learned of them, with
        those of the priors."""
        problem, point, known, entries = self.problem, self.at.point, self.known, self.entries
        expected, s = (each[..., 1:] for each in problem.measured)
        q, variance, (_, by, learned) = len(problem.own_usual), (known.roots**2).sum(axis=-1), self.prior
        for enters, c, v, size in (
            (entries.by_group, (point.values + known.parameters[..., 1:] - expected), variance[..., :1, q + 1 :], s),
            (entries.by_own_group, point.own + known.own, variance[..., :q], problem.own_known),
        ):
            square = np.where(size > 0.0, size, np.inf)[..., None, :] ** 2
            c = c[..., None, :] if c.ndim < v.ndim else c
            by = by + ((c**2 + v) / square - 1.0).sum(axis=-2) @ enters.T
            learned = learned + 2.0 * np.clip(1.0 - v / square, 0.0, 1.0).sum(axis=-2) @ enters.T
        return by, learned

    @cached_property
    def score(self) -> tuple[Array, Array]:
        """Gradient and information: (24) of scatter, (25) of in-run biases, (26) of groups, and those of the priors."""
        step, problem, entries, (gradient, learned) = self.step, self.problem, self.entries, self.of_groups
        by_variance, of_variance, by_sensor = scatter_score(self.at.noise, step, self.left)
        twice, process = 2.0 * self.told.weights.components.variances, self.told.process
        by_size, by_time, states = np.zeros((3, problem.sensors)) if process is None else in_run_scores(process, step)
        kinds = np.repeat([0, 1], [problem.instrument.accel.size, problem.sensors - problem.instrument.accel.size])
        gradient = gradient + (twice * by_variance) @ entries.by_scatter.T + by_time @ entries.by_time.T
        gradient = gradient + by_size @ entries.by_in_run.T
        gradient = gradient + (by_size + twice[..., kinds] * by_sensor) @ entries.by_unlike.T
        learned = learned + 2.0 * states @ entries.by_in_run.T + 0.5 * states @ entries.by_time.T
        learned = learned + (2.0 * states + len(problem.link) * SENSED) @ entries.by_unlike.T
        scatter = entries.by_scatter * twice[..., None, :]
        information = scatter @ of_variance @ np.swapaxes(scatter, -1, -2)
        return gradient, information + learned[..., None] * np.eye(len(entries))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Maximum:
    """The maximum: the problem with groups of usual size, ℓ there, the point after the last step, B (D, D), the changes
    of the parameters by linearisation, and why the iteration ended."""

    free: Problem
    best: Evaluated
    point: Point
    curvature: Array
    increments: tuple[Array, ...]
    status: Status

    @property
    def entries(self) -> Hyperparameters:
        """The hyperparameters."""
        return self.best.entries

    @property
    def at(self) -> At:
        """The linearisation that it is of."""
        return self.best.at

    @property
    def converged(self) -> bool:
        """Whether it is one."""
        return self.status is Status.converged

    @property
    def components(self) -> Components:
        """The components of variance at the maximum."""
        return self.best.told.weights.components

    @property
    def problem(self) -> Problem:
        """The problem with priors of the size at the maximum."""
        return self.best.problem


def maximum(
    problem: Problem, at: At, phi: Array | None = None, iterations: int = MAX_ITERATIONS, robust: bool = False
) -> Maximum:
    """The joint maximum of x and φ from a linearisation on, and from φ where that is known; a `robust` one with
    Student-t rows (`tumble.inference.fits`)."""
    plain = at.solved(problem, Components())
    entries = table(problem, at.noise, _seen(at.noise, left(problem, plain), plain))
    phi, bounded = entries.centre if phi is None or len(phi) != len(entries) else phi, entries.bounded
    near, gain = False, np.inf
    increments, radius, B, enough = list[Array](), FURTHEST, np.zeros((0, 0)), GAIN * max(1, len(entries))
    while True:
        best = Evaluated.of(problem, entries, at, phi)
        near = near or len(increments) >= FAR_STEPS or negligible(best.problem, best.step, NEAR)
        B = best.information if gain == np.inf else B
        for _ in range(STEPS if near else 0):
            held = bounded & (best.phi <= 0.0) & (best.gradient <= 0.0)
            free = np.flatnonzero(~held)
            step = np.zeros(len(phi))
            step[free] = np.linalg.solve(B[np.ix_(free, free)], best.gradient[free])
            gain = 0.5 * float(best.gradient @ step)
            if not np.isfinite(gain):
                raise np.linalg.LinAlgError("a step over what the model does not know of itself is not finite")
            if gain < enough:
                break
            step *= min(1.0, radius / float(np.abs(step).max()))
            wanted = np.where(bounded, np.maximum(best.phi + step, 0.0), best.phi + step)
            tried = Evaluated.of(problem, entries, at, wanted)
            moved_by, change = wanted - best.phi, best.gradient - tried.gradient
            expected = float(best.gradient @ moved_by - 0.5 * moved_by @ B @ moved_by)
            ratio = (tried.value - best.value) / expected if expected > 0.0 else 0.0
            B = _updated(B, moved_by, change)
            radius = 0.3 * float(np.abs(moved_by).max()) if ratio < 0.1 else min(2.0 * radius, FURTHEST)
            if tried.value > best.value:
                best = tried
        phi = best.phi
        point, by = moved(best.problem, at.point, best.step, keep=len(increments) >= TO_AND_FRO)
        increments.append(by)
        about, kept = integrated(problem, point, at.about), at.noise.kept
        if robust:
            shown = residuals(best.problem, at.noise, best.told.weights, best.left)
            kept = weighted(problem, at.noise, student(shown)).kept
        weights_settled = all(np.all(np.abs(a**2 - b**2) < SETTLED) for a, b in zip(kept, at.noise.kept, strict=True))
        if len(increments) >= TO_AND_FRO:  # rows that have the blame by turns share it
            rest, turn = (np.sqrt(0.5 * (a**2 + b**2)) for a, b in zip(kept, at.noise.kept, strict=True))
            kept = rest, turn
        ended = negligible(best.problem, best.step) and about is at.about and gain < enough and weights_settled
        if ended or len(increments) >= iterations:
            status = Status.converged if ended else Status.ran_out
            changes = tuple(increments)
            return Maximum(free=problem, best=best, point=point, curvature=B, increments=changes, status=status)
        at = At.of(problem, point, about, kept)


def likeliest(problem: Problem, at: At, iterations: int = MAX_ITERATIONS) -> Maximum:
    """The likeliest of the maxima from several φ: the usual one and, where it leads to scatter or sizes far beyond the
    usual, turns which nothing is expected of, for where turns are spoilt, parameters and accelerometers may take the
    blame; groups far larger than usual, for scatter may take that of groups, which the readings then no longer show;
    and, where rests scatter, biases that are anew at every rest, of which a turn has that of the rest before or that of
    the rest after."""
    best = maximum(problem, at, iterations=iterations)
    if problem.observations.turns is None:
        return best
    entries = best.entries
    sizes = {h.name: h.value(p) for h, p in zip(entries, best.best.phi.tolist(), strict=True)}
    far = {h.place for h in entries if sizes[h.name] > BEYOND * h.usual}
    starts = list[tuple[Problem, Array]]()
    if far & {"scatter", "group"}:
        useless = np.array([np.log(USELESS[h.name]) if h.name in USELESS else h.centre for h in entries])
        starts.append((problem, useless))
    if far - {"time"} and any(h.place == "group" for h in entries):
        wide = np.array([WIDE * h.within if h.place == "group" else h.centre for h in entries])
        starts.append((problem, wide))
    if "in-run" in far or any(h.name in REST_MODES and sizes[h.name] > h.usual for h in entries):
        anew = best.best.phi.copy()
        for i, h in enumerate(entries):
            if h.place == "time":
                anew[i] = np.log(ANEW)
            elif h.place == "in-run":
                anew[i] = np.log(np.hypot(sizes[h.name], sizes.get(h.name.removesuffix("_in_run"), 0.0)))
            elif h.name in REST_MODES:
                anew[i] = h.centre
        starts += [(replace(problem, bias_after=share), anew) for share in (0.0, 1.0)]
    for of, start in starts:
        other = maximum(of, at, start, iterations)
        if other.converged and other.best.value > best.best.value:
            best = other
    return best


def without_outliers(fitted: Maximum, iterations: int = MAX_ITERATIONS) -> Maximum:
    """The maximum without the rests and turns that do not fit; the same where all do."""
    problem, at = fitted.free, fitted.at
    weights = fitted.best.told.weights
    if max(float(each.max(initial=0.0)) for each in sigmas(problem, at.noise, weights, fitted.best.left)) < STANDS_OUT:
        return fitted
    by_student = maximum(problem, at, fitted.best.phi, iterations, robust=True)
    at, best = by_student.at, by_student.best
    out = [w < LEAST_WEIGHT for w in student(residuals(problem, at.noise, best.told.weights, best.left))]
    if not any(each.any() for each in out):
        return fitted
    noise = weighted(problem, at.noise, [np.where(each, LEFT_OUT, 1.0) for each in out])
    return maximum(problem, replace(at, noise=noise), best.phi, iterations)


def _updated(B: Array, step: Array, change: Array) -> Array:
    """The update of Broyden, Fletcher, Goldfarb and Shanno of a curvature by the change of the gradient over a step,
    damped by Powell so that it stays positive; the same where there was no step."""
    along = B @ step
    square, seen = float(step @ along), float(step @ change)
    if square <= 0.0 or not np.isfinite(seen):
        return B
    share = 1.0 if seen >= 0.2 * square else 0.8 * square / (square - seen)
    mixed = share * change + (1.0 - share) * along
    return np.asarray(B - np.outer(along, along) / square + np.outer(mixed, mixed) / float(step @ mixed))


def _seen(noise: Noise, after: Left, step: Step) -> BoolArray:
    """Whether a fit leaves something of each component (c,) of scatter."""
    degrees, weights = np.zeros(len(SCATTER)), step.told.weights
    rows = (weights.rest, after.rest[1], noise.rest_directions), (weights.turn, after.turn[1], noise.turn_directions)
    for W, covariance, (Z, of) in rows:
        WZ = W @ Z
        whole, left_of = (WZ**2).sum(axis=1), (WZ * (covariance @ WZ)).sum(axis=1)
        share = (left_of / np.where(whole > 0.0, whole, 1.0)).sum(axis=0)
        degrees += np.bincount(of, share, len(degrees))
    return np.asarray(degrees > LEAST_DEGREES)


def negligible(problem: Problem, step: Step, of_u: float = CONVERGED) -> bool:
    """Whether what is left to do after a step is, in parts of u: Gauss–Newton squares the error, in units of the
    spreads."""
    change = np.abs(_with_gravity_kept(problem, step)[0][1:])
    u = np.sqrt(step.covariance.diagonal()[1:])
    after = change * min(1.0, SQUARED * float(np.max(change / problem.spread)))
    return bool(np.all(after <= of_u * u + 1e-15))


def moved(problem: Problem, point: Point, step: Step, keep: bool = False) -> tuple[Point, Array]:
    """The point after a step, shortened so that no parameter moves by more than its spread, and the change of the
    parameters. Chains whose heading is hardly seen `keep` it, or all chains."""
    parameters, angles, own = _with_gravity_kept(problem, step)
    share = 1.0 / max(1.0, float(np.max(np.abs(parameters[1:]) / problem.spread)))
    angles, chain = share * angles, problem.chain
    # chi-square after a step per row, 1 at least: so many times less is known than the noise has it. A heading by
    # residuals that are many times the Earth's rate would turn to and fro.
    rows = sum(each.shape[0] * each.shape[1] for each in step.told.whitened)
    hidden = np.bincount(chain, heading_information(problem, step)) < UNSEEN**-2 * max(1.0, step.square / rows)
    if keep or hidden.any():
        mean = np.bincount(chain, angles[:, 2]) / np.bincount(chain)
        angles[:, 2] -= np.where(hidden | keep, mean, 0.0)[chain]
    return point.moved(share * parameters, angles, share * own), share * parameters[1:]


def _with_gravity_kept(problem: Problem, step: Step) -> tuple[Array, Array, Array]:
    """The step of gravity and the parameters (1 + m,), of the angles (N, 3) and of what each session has of its own.
    Gravity of an unknown place (u above PLACE_UNKNOWN of it) stays what it is: no reading tells it from the scale
    factors, and steps along both, whose product counts, would go to and fro. The step is that of everything else given
    gravity, δ − C_g δ_g / C_gg; what is not known of gravity stays in the covariance."""
    gravity_u = float(problem.measured[1][0])
    if gravity_u < PLACE_UNKNOWN * float(problem.measured[0][0]):
        return step.parameters, step.angles, step.own
    q = len(problem.own_known)
    by_gravity = step.parameters[0] / step.covariance[0, 0]
    with_gravity = zip(step.rests, step.own_covariance[:, :, q], strict=True)
    angles = [step.angles[own] - by_gravity * step.told.solved[2][own, :3, :-1] @ along for own, along in with_gravity]
    own = step.own - by_gravity * step.own_covariance[:, :q, q]
    return step.parameters - by_gravity * step.covariance[:, 0], np.concatenate(angles), own


def heading_information(problem: Problem, step: Step) -> Array:
    """What the gyros of each rest (N,) and of the turn after it say of the heading of both, rad⁻²."""
    (rest, turn), d = step.told.whitened, step.unknowns.shape[1]
    n = problem.observations.accel_block.size
    own = (rest[:, n:, 2] ** 2).sum(axis=1)
    own[problem.before_turn] += ((turn[:, :, 2] + turn[:, :, d + 2]) ** 2).sum(axis=1)
    return np.asarray(own)


def integrated(problem: Problem, point: Point, about: TurnsAbout | None) -> TurnsAbout | None:
    """The turns, integrated again if the parameters have moved too far since."""
    if about is None:
        return None
    changes = problem.changed_in_turns(point)
    of_gyros = slice(problem.instrument.accel.size, None)
    if changes is not None and about.small(changes[:, of_gyros], problem.noise_of_turns):
        changes = None
    gyro_changes = 0.0 if changes is None else changes[:, of_gyros]
    if about.good_for(problem.instrument, point.values, problem.noise_of_turns, gyro_changes):
        return about
    return TurnsAbout.of(problem.observations, problem.instrument, point.values, changes)
