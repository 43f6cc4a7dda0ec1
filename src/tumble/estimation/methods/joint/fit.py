"""The solution of a problem with the scatter and the priors that it shows, and its chi-square by group."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tumble.estimation.components import COMPONENTS, Scatter, Weights
from tumble.estimation.estimate import Fit
from tumble.estimation.likelihood import Problem
from tumble.estimation.methods.joint.iteration import MAX_ITERATIONS, At, Out, Solved, iterate
from tumble.estimation.methods.joint.scatter import CLOSELY, ROUGHLY, Scattered, scatter_of, seen_components
from tumble.estimation.methods.joint.widening import has_groups, with_wider_priors
from tumble.estimation.step import Left, completed
from tumble.units import Array, BoolArray, IntArray

ROUNDS = 6
ALL_STEPS = MAX_ITERATIONS * (ROUNDS + 2)  # more than there can be
MOST_ALIASED = 2.0
"""Times what independent samples would make: rotations that err by more lack samples, or something else."""
GROUPS = ("accelerometers", "gyro rests", "gyro turns", "velocities of turns")
SCATTER_OF = ("accel", "gyro", "turn", "velocity")
SCATTER_UNITS = ("m/s^2", "rad/s", "rad", "m/s")
TOTAL = "noise within rests"
"""The name of the fit of everything before any scatter."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Fitted:
    """The solution of a problem, whose priors are as wide as the data ask for: with its scatter, what it leaves of the
    residuals with scatter and what without, each with the weights, the covariance of the variances of the scatter, and
    whether it `settled` within its steps."""

    problem: Problem
    solved: Solved
    left: tuple[Left, Weights]
    without: tuple[Left, Weights]
    scatter: Scatter
    components: Array
    fits: Mapping[str, Fit]
    increments: tuple[Array, ...]
    settled: bool

    @property
    def out(self) -> Out:
        """What was left out."""
        return self.solved.last.out

    @property
    def evidence(self) -> float:
        """−2 log of the likelihood with what is not known of the parameters by their priors, less a constant."""
        priors = np.concatenate([self.problem.measured[1][1:], self.problem.own_known])
        return self.solved.step.deviance + 2.0 * float(np.log(priors[priors > 0.0]).sum())


def fit_of(problem: Problem, start: At, most: int = ALL_STEPS, guess: Scatter | None = None) -> Fitted:
    """The solution with the scatter that it shows, after so many steps at most; a `guess` of the scatter saves time."""
    wide, solved = problem, iterate(problem, start, Scatter(), most)
    increments, steps = solved.increments, len(solved.increments)
    found = Scattered.of(problem, solved.last, Scatter(), solved.step)
    without = found.left, solved.step.told.weights
    seen = seen_components(problem, solved.last.noise, *without)
    for _ in range(ROUNDS):
        at = solved.last
        shown, wider, seen = _shown(wide, at, found, seen, guess)
        if (shown.scatter == found.scatter and wider is wide) or steps >= most:
            break
        found, settled, wide = shown, wider is wide, wider
        if not settled:
            at = at.with_priors(wide)
            step = completed(wide, at.rows, found.step.told)
            found = Scattered.of(wide, at, found.scatter, step, found.share)
        solved = iterate(wide, at, found.scatter, most - steps, found.step)  # the last step again, with scatter
        increments, steps = increments[:-1] + solved.increments, steps + len(solved.increments)
        if solved.step is not found.step:
            found = Scattered.of(wide, solved.last, found.scatter, solved.step, found.share)
        if settled and len(solved.increments) == 1:
            break
    return Fitted(
        problem=wide,
        solved=solved,
        left=(found.left, solved.step.told.weights),
        without=without,
        scatter=found.scatter,
        components=found.components,
        fits=_fits(wide, found.left, found.scatter, without[0]),
        increments=increments,
        settled=steps < most,
    )


def _shown(
    problem: Problem, at: At, begun: Scattered, seen: BoolArray, guess: Scatter | None
) -> tuple[Scattered, Problem, BoolArray]:
    """The scatter that a linearisation shows, the problem with the priors that go with it, and the components seen."""
    within = ROUGHLY if has_groups(problem) else CLOSELY
    found = scatter_of(problem, at, begun, seen, within, guess)
    if found.scatter.aliased > MOST_ALIASED:
        seen = seen & (np.array(COMPONENTS) != "aliased")
        plain = Scattered.of(problem, at, Scatter(), at.solved(problem, Scatter()))
        found = scatter_of(problem, at, plain, seen, within)
    wider = with_wider_priors(problem, at, found.step.told)
    if wider is problem and within > CLOSELY:
        found = scatter_of(problem, at, found, seen, CLOSELY)
    return found, wider, seen


def _rows_of(problem: Problem, after: Left) -> list[IntArray]:
    """The rows, of a turn with the rest before it, of the groups, in the order of GROUPS."""
    n, r, rows = problem.observations.accel_block.size, after.rest[0].shape[1], np.arange(after.merged[0].shape[1])
    stop, v = n + problem.observations.rests.gyro.shape[1], r + 6 if problem.instrument.in_velocities else r + 3
    return [rows[:n], rows[n:stop], np.r_[r : r + 3, v : len(rows)], rows[r + 3 : v]]


def _fits(problem: Problem, after: Left, scatter: Scatter, without: Left) -> dict[str, Fit]:
    """Chi-square of every group there is, and of everything with the noise within rests alone."""
    rows, (squares, expected) = _rows_of(problem, after), _sums(after)
    there = 1 if problem.observations.gyro_block is None else 4 if problem.instrument.in_velocities else 3
    out = {
        name: _fit(squares[own], expected[own], getattr(scatter, component), unit)
        for name, component, unit, own in zip(GROUPS[:there], SCATTER_OF, SCATTER_UNITS, rows, strict=False)
    }
    squares, expected = (of[np.concatenate(rows)] for of in _sums(without))
    return out | {TOTAL: _fit(squares, expected, 0.0, "")}


def _sums(after: Left) -> tuple[Array, Array]:
    """Sums (r + t,) over the rests and turns of the squares of residuals, and of their variances."""
    (rest, at_rest), (merged, of_merged) = after.rest, after.merged
    squares, expected = np.einsum("ka,ka->a", merged, merged), np.einsum("kaa->a", of_merged)
    squares[: rest.shape[1]] += np.einsum("ka,ka->a", rest, rest)
    expected[: rest.shape[1]] += np.einsum("kaa->a", at_rest)
    return squares, expected


def _fit(squares: Array, expected: Array, scatter: float, unit: str) -> Fit:
    return Fit(chi_square=float(squares.sum()), degrees=float(expected.sum()), scatter=scatter, scatter_unit=unit)
