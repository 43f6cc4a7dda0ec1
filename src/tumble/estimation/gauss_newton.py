"""Gauss–Newton: least squares of a model that is linearised again after every step, until a step is negligible against
the uncertainties."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tumble.estimation.estimate import Solution
from tumble.units import Array

MAX_ITERATIONS = 30
CONVERGED = 1e-3  # of the standard uncertainty
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


def bounded(step: Array, spread: Array) -> Array:
    """The step, shortened so that no parameter moves by more than its spread: far from any solution the
    linearisation says nothing."""
    return np.asarray(step / max(1.0, float(np.max(np.abs(step) / spread))))


def negligible(solution: Solution, rounding: Array | float = ROUNDING) -> bool:
    """Whether a step is negligible against the uncertainty."""
    u = np.sqrt(np.diag(solution.covariance))
    return bool(np.all(np.abs(solution.step) <= CONVERGED * u + rounding))
