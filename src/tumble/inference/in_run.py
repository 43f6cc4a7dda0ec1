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

from tumble.inference.elimination import along_chains
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

    def scores(self, step: Step) -> tuple[Array, Array, Array]:
        """∂ℓ/∂ ln σ and ∂ℓ/∂ ln τ of every sensor (n,), each for itself, and how many independent values the data say
        of its states."""
        states, follows = slice(-self.sigma.shape[-1], None), self.follows
        first = np.append(True, ~follows[:-1])
        here, following = np.flatnonzero(follows), np.flatnonzero(follows) + 1
        b, root = step.unknowns[..., states], step.along(states)
        own, with_next = np.moveaxis(np.diagonal(step.given, axis1=-2, axis2=-1)[..., states], -3, 0)
        variance = own + (root**2).sum(axis=-1)
        with_next = with_next[..., here, :] + (root[..., here, :, :] * root[..., following, :, :]).sum(axis=-1)
        rho, square = self.rho[..., here, :], self.deviation[..., here, :] ** 2
        moment = b**2 + variance
        before, after, begins = moment[..., here, :], moment[..., following, :], moment[..., first, :]
        across = b[..., here, :] * b[..., following, :] + with_next
        e2 = (after - 2.0 * rho * across + rho**2 * before) / square
        by_size = (e2 - 1.0).sum(axis=-2) + (begins - 1.0).sum(axis=-2)
        passed = self.passed[..., here, :]
        growth = np.where(np.isfinite(passed), passed, 0.0) * rho
        by_time = (growth * ((across - rho * before) + rho * (1.0 - e2)) / square).sum(axis=-2)
        unknown = (variance[..., following, :] - 2.0 * rho * with_next + rho**2 * variance[..., here, :]) / square
        told = sum((1.0 - np.clip(each, 0.0, 1.0)).sum(axis=-2) for each in (unknown, variance[..., first, :]))
        return by_size, by_time, np.asarray(told)


def mean_along(told: Told) -> tuple[Array, Array]:
    """The mean over the rests of a session of its in-run biases: what it changes with x, what the session has of its
    own, gravity and the common parameters, and its value where x is zero, turned round (n, q + 1 + m + 1); and what it
    changes with the noise e of every rest (N, n, d), followed along the chain of unknowns u_i = A_i u_{i+1} + B_i x +
    a_i + R_i⁻¹ e_i from the first."""
    (inverse, by_next, by), process = told.solved, told.process
    assert process is not None
    (*stack, N, d, _), n = inverse.shape, process.sigma.shape[-1]
    carried, back = np.zeros((*stack, N, d, n)), np.zeros((*stack, N, d, d))  # transposed, from the last rest on
    carried[..., d - n :, :] = process.sigma[..., None, None, :] * np.eye(n) / N
    back[..., :-1, :, :] = np.swapaxes(by_next[..., -2::-1, :, :], -1, -2)
    along_chains(back, carried)
    of_rests = np.swapaxes(carried[..., ::-1, :, :], -1, -2) @ inverse
    return process.sigma[..., None] * by[..., d - n :, :].mean(axis=-3), of_rests
