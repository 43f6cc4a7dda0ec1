"""The solution of a problem with the scatter and the priors that it shows, and its chi-square by group."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from tumble.estimation.estimate import Fit
from tumble.estimation.likelihood import COMPONENTS, Problem, Scatter, Weights
from tumble.estimation.methods.joint.iteration import MAX_ITERATIONS, At, Out, Solved, iterate
from tumble.estimation.methods.joint.scatter import scatter_of, seen_components
from tumble.estimation.methods.joint.widening import with_wider_priors
from tumble.estimation.step import Left, left
from tumble.units import Array

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


def fit_of(problem: Problem, start: At, most: int = ALL_STEPS) -> Fitted:
    """The solution with the scatter that it shows, after so many steps at most."""
    scatter, components, wide = Scatter(), np.zeros((len(COMPONENTS), len(COMPONENTS))), problem
    solved = iterate(problem, start, scatter, most)
    increments, steps = solved.increments, len(solved.increments)
    after = without = left(problem, solved.step), solved.step.told.weights
    seen = seen_components(problem, solved.last.noise, *without)
    for _ in range(ROUNDS):
        at = solved.last
        found, components, told = scatter_of(wide, at, (solved.step, after[0]), scatter, seen)
        if found.aliased > MOST_ALIASED:
            seen &= np.array(COMPONENTS) != "aliased"
            plain = at.solved(wide, Scatter())
            found, components, told = scatter_of(wide, at, (plain, left(wide, plain)), Scatter(), seen)
        wider = with_wider_priors(wide, at, told)
        if (found == scatter and wider is wide) or steps >= most:
            break
        settled, wide, scatter = wider is wide, wider, found
        solved = iterate(wide, at.with_priors(wide), scatter, most - steps, told)  # the last step again, with scatter
        increments, steps = increments[:-1] + solved.increments, steps + len(solved.increments)
        after = left(wide, solved.step), solved.step.told.weights
        if settled and len(solved.increments) == 1:
            break
    return Fitted(
        problem=wide,
        solved=solved,
        left=after,
        without=without,
        scatter=scatter,
        components=components,
        fits=_fits(wide, after[0], scatter, without[0]),
        increments=increments,
        settled=steps < most,
    )


def _parts(problem: Problem, after: Left) -> Iterator[list[tuple[Array, Array]]]:
    """Residuals and their covariances of the groups, in the order of GROUPS: of the rests that no turn follows, and of
    the others."""
    n = problem.observations.accel_block.size
    stop = n + problem.observations.rests.gyro.shape[1]
    r = after.rest[0].shape[1]
    last = problem.link < 0
    for part in (slice(0, n), slice(n, stop)):
        yield [
            (residual[:, part], covariance[:, part, part])
            for residual, covariance in ((after.rest[0][last], after.rest[1][last]), after.merged)
        ]
    v = r + 6 if problem.instrument.in_velocities else r + 3
    for rows in (np.r_[r : r + 3, v : after.merged[0].shape[1]], np.arange(r + 3, v)):
        yield [(after.merged[0][:, rows], after.merged[1][:, rows[:, None], rows])]


def _fits(problem: Problem, after: Left, scatter: Scatter, without: Left) -> dict[str, Fit]:
    """Chi-square of every group there is, and of everything with the noise within rests alone."""
    found = [
        (name, _fit(part, getattr(scatter, component), unit))
        for name, component, unit, part in zip(GROUPS, SCATTER_OF, SCATTER_UNITS, _parts(problem, after), strict=True)
    ]
    there = 1 if problem.observations.gyro_block is None else 4 if problem.instrument.in_velocities else 3
    out = dict(found[:there])
    return out | {TOTAL: _fit([one for part in _parts(problem, without) for one in part], 0.0, "")}


def _fit(parts: list[tuple[Array, Array]], scatter: float, unit: str) -> Fit:
    squares = float(sum((residual**2).sum() for residual, _ in parts))
    expected = float(sum(np.trace(covariance, axis1=1, axis2=2).sum() for _, covariance in parts))
    return Fit(chi_square=squares, degrees=expected, scatter=scatter, scatter_unit=unit)
