"""In-run bias: the bias of every sensor is a Gauss–Markov process in time, docs/explanation/mathematics.md (19) and
(25).

The bias of a sensor at rest k is b + σ β_k, b its parameter, β a stationary chain of unit variance:

    β_0 ~ N(0, 1),   β_{k+1} − ρ_k β_k ~ N(0, 1 − ρ_k²),   ρ_k = e^{−Δt/τ}

Δt is the time between the middles of two rests; a recording that begins anew begins the chain anew. A turn has
σ (β_k + β_{k+1})/2 or, where biases are anew at every rest and that is likelier, σ β_k or σ β_{k+1}. The β_k are
unknowns of the rests, their steps rows that join neighbouring rests as turns do, so that the elimination from rest to
rest has them at a cost that is linear in rests. τ short makes a scatter from rest to rest, τ long a random walk, in
which a drift is, and a warm-up of any shape.

The score is that of Fisher's identity, from moments of the states given the data: with e_k the steps over √(1 − ρ²),

    ∂ℓ/∂ ln σ = Σ (E e² − 1),   ∂ℓ/∂ ln τ = Σ ρ Δt/τ · (E[(β_{k+1} − ρ β_k) β_k] + ρ (1 − E e²)) / (1 − ρ²)

The parameter b is the mean of the process, what the bias of another day or of the next minute is about; what was
observed is the mean over the rests of the session, b + σ mean β (`mean_along`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tumble.inference.elimination import along_chain
from tumble.inference.hyperparameters import Components
from tumble.units import Array, BoolArray

if TYPE_CHECKING:
    from tumble.inference.likelihood import Problem
    from tumble.inference.step import Step, Told


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class InRun:
    """The process of a problem with components of variance: σ (n,) by sensor, and of every rest that another one of its
    session follows ρ (N, n) and Δt/τ (N, n), `follows` (N,) saying which."""

    sigma: Array
    rho: Array
    passed: Array
    follows: BoolArray

    @staticmethod
    def of(problem: Problem, components: Components) -> InRun:
        """The process at the times of the rests."""
        rests, blocks = problem.observations.rests, problem.instrument.blocks
        sigma, tau = components.in_run(blocks[0].size, sum(block.size for block in blocks[1:]))
        middle, N = 0.5 * (rests.start + rests.stop), len(rests)
        follows = np.zeros(N, dtype=bool)
        follows[:-1] = problem.of_session[0][1:] == problem.of_session[0][:-1]
        passed = np.full((N, len(sigma)), np.inf)
        apart = np.where(rests.file[1:] == rests.file[:-1], np.abs(np.diff(middle)), np.inf)
        passed[:-1] = apart[:, None] / tau
        return InRun(sigma=sigma, rho=np.exp(-passed), passed=passed, follows=follows)

    @property
    def deviation(self) -> Array:
        """√(1 − ρ²) (N, n)."""
        return np.sqrt(-np.expm1(-2.0 * self.passed))

    def write_steps(self, rows: Array, d: int) -> None:
        """The steps, written to rows (N, n, ·) of zeros: unknowns of a rest (d of them, the last n the states), of the
        next, and others."""
        n, deviation = len(self.sigma), self.deviation[self.follows]
        c, here = np.arange(n), np.flatnonzero(self.follows)[:, None]
        rows[here, c, d - n + c] = -self.rho[self.follows] / deviation
        rows[here, c, 2 * d - n + c] = 1.0 / deviation

    @property
    def log_determinant(self) -> float:
        """ln |covariance| of all steps."""
        return float(2.0 * np.log(self.deviation[self.follows]).sum())

    def scores(self, step: Step) -> tuple[Array, Array, Array]:
        """∂ℓ/∂ ln σ and ∂ℓ/∂ ln τ of every sensor (n,), each for itself, and how many independent values the data say
        of its states."""
        states = slice(-len(self.sigma), None)
        b, root, own = step.unknowns[:, states], step.along(states), np.diagonal(step.given, axis1=2, axis2=3)
        variance, with_next = own[0, :, states] + (root**2).sum(axis=2), own[1, :, states].copy()
        with_next[:-1] += (root[:-1] * root[1:]).sum(axis=2)
        here = np.flatnonzero(self.follows)
        first = np.ones(len(b), dtype=bool)
        first[here + 1] = False
        rho, square = self.rho[here], self.deviation[here] ** 2
        before, after = b[here] ** 2 + variance[here], b[here + 1] ** 2 + variance[here + 1]
        across = b[here] * b[here + 1] + with_next[here]
        e2 = (after - 2.0 * rho * across + rho**2 * before) / square
        begins = b[first] ** 2 + variance[first]
        by_size = (e2 - 1.0).sum(axis=0) + (begins - 1.0).sum(axis=0)
        growth = np.where(np.isfinite(self.passed[here]), self.passed[here], 0.0) * rho
        by_time = (growth * ((across - rho * before) + rho * (1.0 - e2)) / square).sum(axis=0)
        unknown = (variance[here + 1] - 2.0 * rho * with_next[here] + rho**2 * variance[here]) / square
        told = (1.0 - np.clip(unknown, 0.0, 1.0)).sum(axis=0) + (1.0 - np.clip(variance[first], 0.0, 1.0)).sum(axis=0)
        return by_size, by_time, told


def mean_along(told: Told) -> tuple[Array, Array]:
    """The mean over the rests of a session of its in-run biases: what it changes with x, what the session has of its
    own, gravity and the common parameters, and its value where x is zero, turned round (n, q + 1 + m + 1); and what it
    changes with the noise e of every rest (N, n, d), followed along the chain of unknowns u_i = A_i u_{i+1} + B_i x +
    a_i + R_i⁻¹ e_i from the first."""
    (inverse, by_next, by), process = told.solved, told.process
    assert process is not None
    (N, d, _), n = inverse.shape, len(process.sigma)
    carried, back = np.zeros((N, d, n)), np.zeros((N, d, d))  # transposed, from the last rest to the first
    carried[:, d - n :] = np.diag(process.sigma) / N
    back[:-1] = np.swapaxes(by_next[-2::-1], 1, 2)
    along_chain(back, carried)
    return process.sigma[:, None] * by[:, d - n :].mean(axis=0), np.swapaxes(carried[::-1], 1, 2) @ inverse
