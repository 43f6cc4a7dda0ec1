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
observed is the mean over the rests of the session, b + σ mean β (`tumble.inference.step.mean_along`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.inference.likelihood import Problem
from tumble.inference.noise_components import Components
from tumble.units import Array, BoolArray


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
        apart = np.where(rests.file[1:] == rests.file[:-1], np.abs(np.diff(middle)), np.inf)
        passed = np.append(apart, np.inf)[:, None] / tau[..., None, :]
        return InRun(sigma=sigma, rho=np.exp(-passed), passed=passed, follows=follows)

    @property
    def deviation(self) -> Array:
        """√(1 − ρ²) (N, n)."""
        return np.sqrt(-np.expm1(-2.0 * self.passed))

    def write_steps(self, rows: Array, d: int) -> None:
        """The steps, written to rows (N, n, ·) of zeros: unknowns of a rest (d of them, the last n the states), of the
        next, and others."""
        n, deviation = self.sigma.shape[-1], self.deviation[..., self.follows, :]
        c, here = np.arange(n), np.flatnonzero(self.follows)[:, None]
        rows[..., here, c, d - n + c] = -self.rho[..., self.follows, :] / deviation
        rows[..., here, c, 2 * d - n + c] = 1.0 / deviation

    @property
    def log_determinant(self) -> Array:
        """ln |covariance| of all steps."""
        return np.asarray(2.0 * np.log(self.deviation[..., self.follows, :]).sum(axis=(-2, -1)))
