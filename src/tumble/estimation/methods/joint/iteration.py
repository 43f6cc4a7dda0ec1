"""Gauss–Newton of the joint method: a point, the rows there, the step, and what is left out of it.

Turns are integrated again about the current parameters wherever the second-order effect of the change since counts
(`TurnsAbout.good_for`). A chain of turns whose heading the gyros hardly see (no better than UNSEEN) keeps it where it
is: it is still an unknown of every step, so that it takes nothing from the parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tumble.estimation.components import Noise, Scatter
from tumble.estimation.likelihood import Point, Problem, Rows, noise_of
from tumble.estimation.linearisation import linearise, with_priors
from tumble.estimation.step import Step, solve
from tumble.estimation.turns_about import TurnsAbout
from tumble.units import Array, BoolArray

MAX_ITERATIONS = 30
CONVERGED = 1e-3  # of the standard uncertainty
SQUARED = 10.0  # error after a step, in units of the spreads, over the square of the step
UNSEEN = 0.2  # rad: a heading that the gyros know to no better
TO_AND_FRO = 6  # steps after which a heading that still moves is one that the gyros do not know either
PLACE_UNKNOWN = 1e-3
"""Normal gravity is known to a third of that anywhere."""
LEFT_OUT = 1e6  # times its variance: what a rest or turn that is left out has on top


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Out:
    """Rests (N,) and turns (K,) that are left out."""

    rest: BoolArray
    turn: BoolArray

    @staticmethod
    def nothing(problem: Problem) -> Out:
        """Of a problem from which nothing is left out."""
        turns = problem.observations.turns
        return Out(
            rest=np.zeros(len(problem.link), dtype=bool), turn=np.zeros(0 if turns is None else len(turns), dtype=bool)
        )

    @property
    def any(self) -> bool:
        """Whether something is left out."""
        return bool(self.rest.any() or self.turn.any())

    def noise(self, problem: Problem, rows: Rows) -> Noise:
        """The noise of the rows, large where they are left out."""
        noise = noise_of(problem, rows)
        if not self.any:
            return noise
        rest, merged, r = noise.rest.copy(), noise.merged.copy(), noise.rest.shape[1]
        rest[self.rest] += LEFT_OUT * _diagonals(rest[self.rest])
        if len(merged):
            turns = problem.observations.turns
            assert turns is not None
            more = LEFT_OUT * _diagonals(merged)
            more[:, :r] *= self.rest[turns.first][:, None, None]
            more[:, r:] *= self.turn[:, None, None]
            merged += more
        return replace(noise, rest=rest, merged=merged)


def _diagonals(matrices: Array) -> Array:
    """The diagonals of matrices (N, n, n), as matrices."""
    return np.asarray(matrices * np.eye(matrices.shape[1]))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class At:
    """A point, the turns about parameters near it, the rows linearised there, and their noise, large where they are
    `out`."""

    point: Point
    about: TurnsAbout | None
    rows: Rows
    noise: Noise
    out: Out

    @staticmethod
    def of(problem: Problem, point: Point, about: TurnsAbout | None, out: Out) -> At:
        """The rows of a problem at a point, and their noise."""
        rows = linearise(problem, point, about)
        return At(point=point, about=about, rows=rows, noise=out.noise(problem, rows), out=out)

    def solved(self, problem: Problem, scatter: Scatter) -> Step:
        """The least-squares step from here with a scatter."""
        return solve(problem, self.rows, self.noise.weights(scatter))

    def with_priors(self, problem: Problem) -> At:
        """The same with the priors of a problem."""
        return replace(self, rows=with_priors(self.rows, problem, self.point, self.about))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Solved:
    """The point where the iteration ended, the last step, where that began, and the changes of the parameters."""

    point: Point
    last: At
    step: Step
    increments: tuple[Array, ...]


def iterate(
    problem: Problem, at: At, scatter: Scatter, most: int = MAX_ITERATIONS, first: Step | None = None
) -> Solved:
    """Gauss–Newton with this scatter, by so many steps at most, of which the `first` may be known already."""
    increments: list[Array] = []
    step = at.solved(problem, scatter) if first is None else first
    while True:
        point, change = moved(problem, at.point, step, keep=len(increments) >= TO_AND_FRO)
        increments.append(change)
        about = integrated(problem, point, at.about)
        if (negligible(problem, step) and about is at.about) or len(increments) == min(most, MAX_ITERATIONS):
            return Solved(point=point, last=at, step=step, increments=tuple(increments))
        at = At.of(problem, point, about, at.out)
        step = at.solved(problem, scatter)


def negligible(problem: Problem, step: Step) -> bool:
    """Whether what is left to do after a step is: Gauss–Newton squares the error, in units of the spreads."""
    change = np.abs(_with_gravity_kept(problem, step)[0][1:])
    u = np.sqrt(step.covariance.diagonal()[1:])
    after = change * min(1.0, SQUARED * float(np.max(change / problem.spread)))
    return bool(np.all(after <= CONVERGED * u + 1e-15))


def moved(problem: Problem, point: Point, step: Step, keep: bool = False) -> tuple[Point, Array]:
    """The point after a step, shortened so that no parameter moves by more than its spread, and the change of the
    parameters. Chains whose heading is hardly seen `keep` it, or all chains."""
    parameters, angles, own = _with_gravity_kept(problem, step)
    share = 1.0 / max(1.0, float(np.max(np.abs(parameters[1:]) / problem.spread)))
    angles, chain = share * angles, problem.chain
    hidden = np.bincount(chain, heading_information(problem, step)) < UNSEEN**-2 * _overshot(problem, step)
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
    angles = step.angles - by_gravity * step.shared[1][:, :, q]
    own = step.own - by_gravity * step.own_covariance[:, :q, q]
    return step.parameters - by_gravity * step.covariance[:, 0], angles, own


def _overshot(problem: Problem, step: Step) -> float:
    """Chi-square after a step per row, 1 at least: so many times less is known than the noise has it. A heading by
    residuals that are many times the Earth's rate would turn to and fro."""
    rest, merged = step.told.whitened
    rows = np.count_nonzero(problem.unlinked) * rest.shape[1] + merged.shape[0] * merged.shape[1]
    return float(max(1.0, step.square / rows))


def heading_information(problem: Problem, step: Step) -> Array:
    """What the gyros of each rest (N,) and of the turn after it say of the heading of both, rad⁻²."""
    rest, merged = step.told.whitened
    n = problem.observations.accel_block.size
    own = (rest[:, n:, 2] ** 2).sum(axis=1)
    of_both = merged[:, n:, 2] + merged[:, n:, 5]
    own[problem.before_turn] = (of_both**2).sum(axis=1)
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
