"""Gauss–Newton: least squares of a model that is linearised again after every step, until a step is negligible against
the uncertainties."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tumble.inference.estimate import Solution, scatter_of
from tumble.methods.agreement import unexplained
from tumble.units import Array

MAX_ITERATIONS = 30
CONVERGED = 1e-3  # of the standard uncertainty
SCATTER_ROUNDS = 3
ROUNDING = 1e-15
"""SI: steps that are no more than rounding."""


def gauss_newton(
    solution_at: Callable[[Array], Solution], values: Array, spread: Array, rounding: Array | float = ROUNDING
) -> tuple[Array, tuple[Array, ...]]:
    """Values (m,) after the last step, and all steps, from `values` on; `solution_at` linearises about values. No
    parameter moves by more than its spread (m,) in a step."""
    steps: list[Array] = []
    for _ in range(MAX_ITERATIONS):
        solution = solution_at(values)
        step = bounded(solution.step, spread)
        values = values + step
        steps.append(step)
        if negligible(solution, rounding):
            break
    return values, tuple(steps)


def with_scatter(
    solution_at: Callable[[Array, float], Solution],
    agreement_at: Callable[[Array], tuple[Callable[[float], float], float, float]],
    values: Array,
    spread: Array,
    rounding: Array | float = ROUNDING,
) -> tuple[Array, float, tuple[Array, ...]]:
    """Values (m,), the scatter that explains the residuals, zero where they need none, and all steps. `agreement_at`
    values has the chi-square of the residuals by their scatter, its degrees of freedom, and a first guess of it."""
    scatter = 0.0

    def converged(start: Array) -> tuple[Array, tuple[Array, ...]]:
        return gauss_newton(lambda at: solution_at(at, scatter), start, spread, rounding)

    values, steps = converged(values)
    for again in range(SCATTER_ROUNDS):
        chi_square, degrees, size = agreement_at(values)
        if not again and not unexplained(chi_square(0.0), degrees):
            break

        def excess(trial: float, of: Callable[[float], float] = chi_square, expected: float = degrees) -> float:
            return of(trial) - expected

        scatter = scatter_of(excess, size)
        values, more = converged(values)
        steps += more
    return values, scatter, steps


def bounded(step: Array, spread: Array) -> Array:
    """The step, shortened so that no parameter moves by more than its spread: far from any solution the
    linearisation says nothing."""
    return np.asarray(step / max(1.0, float(np.max(np.abs(step) / spread))))


def negligible(solution: Solution, rounding: Array | float = ROUNDING) -> bool:
    """Whether a step is negligible against the uncertainty."""
    u = np.sqrt(np.diag(solution.covariance))
    return bool(np.all(np.abs(solution.step) <= CONVERGED * u + rounding))
