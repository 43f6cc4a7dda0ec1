"""What a linearisation says of warm-ups of every time constant.

What is left of a warm-up over a session, e^(−t/τ) at its rests and in its turns, is for all τ that come into question a
combination of a few functions φ of time, c(τ)ᵀ φ. With the columns of biases and scale factors times each of these, the
attitudes and the parameters are eliminated once. What remains, R, says for every τ, of amplitudes with priors S,

    −2 log of the restricted likelihood = log |S⁻² + XᵀX| + |r|² − rᵀX (S⁻² + XᵀX)⁻¹ Xᵀr + constant,   X = R (c(τ) ⊗ 1)
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from tumble.estimation.components import Scatter
from tumble.estimation.elimination import eliminate
from tumble.estimation.likelihood import WARMING, Problem, changing_with
from tumble.estimation.methods.joint.fit import Fitted
from tumble.estimation.methods.joint.iteration import At, Solved
from tumble.estimation.variables import left_of_warm_up
from tumble.reduction.observations import Observations
from tumble.sensors.parameters import Variable
from tumble.units import Array, IntArray

TRIED = 48
"""Time constants, evenly over their logarithm, whose functions of time give the combinations."""
LEAST_FUNCTION = 1e-4
"""Of the largest: a combination that is smaller in all of them is left out."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TimeConstants:
    """What is left once the attitudes are eliminated: a `triangle` (1 + m + B q + 1, ·) of gravity, the parameters,
    of which there are so many with it, the B q amplitudes and the residuals; and the functions of time (B, N + 2 K)."""

    observations: Observations
    triangle: Array
    functions: Array
    parameters: int
    bases: IntArray
    """Where the parameters (q,) stand that the amplitudes are changes of."""

    @staticmethod
    def of(fitted: Fitted, problem: Problem, span: tuple[float, float]) -> TimeConstants:
        """What a solution, its scatter and priors say of time constants within a span, s, and of their halves."""
        observations = problem.observations
        warm = replace(settling_with(problem, span[1], WARMING[:1]), measured=fitted.problem.measured)
        warm = replace(warm, wandering=fitted.problem.wandering)
        at = without_own(warm, fitted.solved)
        functions = _functions(observations, span)
        own, base = (of[warm.changed[0] >= len(warm.instrument.names)] for of in warm.changed)
        rest, merged = _whitened(warm, at, fitted.scatter, functions, (own, base))
        p, q = len(at.rows.prior) - 1, rest.shape[2] - 4 - len(at.rows.prior) + 1
        triangle = np.zeros((p + q + 1, p + q + 1))
        kept = np.r_[:p, p + q]
        triangle[np.ix_(kept, kept)] = at.rows.prior
        part = warm.parts[0]
        eliminate(rest, merged, part.link, part.last, np.empty((len(rest), 3, 6 + p + q + 1)), triangle)
        return TimeConstants(
            observations=observations, triangle=triangle, functions=functions, parameters=p, bases=base
        )

    def deviance(self, settling: float, warm: Problem) -> float:
        """−2 log of the likelihood with a time constant, s, of what changes with the warm-up in a problem, by its
        priors, less a constant."""
        reduced = self._reduced(settling, warm)
        pivots = np.abs(reduced.diagonal()[:-1]) * warm.own_known
        return float(2.0 * np.log(pivots).sum() + reduced[-1, -1] ** 2)

    def values(self, settling: float, warm: Problem) -> Array:
        """The step of gravity and the parameters (1 + m,) with it."""
        reduced, p = self._reduced(settling, warm), self.parameters
        amplitudes = self._combined(settling, warm) @ solve_triangular(reduced[:-1, :-1], reduced[:-1, -1])
        right = self.triangle[:p, -1] - self.triangle[:p, p:-1] @ amplitudes
        first, step = int(self.triangle[0, 0] == 0.0), np.zeros(p)
        step[first:] = solve_triangular(self.triangle[first:p, first:p], right[first:])
        return step

    def _reduced(self, settling: float, warm: Problem) -> Array:
        """The triangle of the amplitudes with their priors, and the residuals."""
        own, q = self.triangle[self.parameters :, self.parameters :], len(warm.own_known)
        rows = np.zeros((len(own) + q, q + 1))
        rows[: len(own) - 1, :-1] = own[:-1, :-1] @ self._combined(settling, warm)
        rows[: len(own), -1] = own[:, -1]
        rows[len(own) :, :-1] = np.diag(1.0 / warm.own_known)
        return np.asarray(np.linalg.qr(rows, mode="r"))

    def _combined(self, settling: float, warm: Problem) -> Array:
        """The amplitudes of the functions by those of the sensors (B q, ·), in the order of a problem."""
        every = np.eye(len(self.bases))
        return np.hstack(
            [
                np.kron(
                    (self.functions @ _left(self.observations, settling / (1 + WARMING.index(variable))))[:, None],
                    every[:, np.isin(self.bases, np.arange(base.start, base.stop))],
                )
                for _, base, variable in warm.changes
                if variable in WARMING
            ]
        )


def settling_with(problem: Problem, settling: float, variables: tuple[Variable, ...]) -> Problem:
    """The problem with what settles with a time constant, s."""
    observations = replace(problem.observations, warm_up=settling)
    own = changing_with(observations, variables)
    return Problem.of(observations, problem.prior, instrument=problem.instrument, own=own, usual=observations.usual)


def without_own(problem: Problem, solved: Solved) -> At:
    """The start of a solution from one with another warm-up, or without."""
    point = replace(solved.point, own=np.zeros((len(problem.parts), len(problem.own_known))))
    return At.of(problem, point, solved.last.about, solved.last.out)


def _left(observations: Observations, settling: float) -> Array:
    """What is left of a warm-up at rests and in turns, and by how much it grows in these, of the time constant
    (N + 2 K,)."""
    rest, turn, grows = left_of_warm_up(observations, settling)
    return np.concatenate([rest, turn, settling * grows])[:, 0]


def _functions(observations: Observations, span: tuple[float, float]) -> Array:
    """The functions of time (B, N + 2 K) of which those of all time constants within a span, s, and of their halves
    are combinations."""
    every = [_left(observations, float(each)) for each in np.geomspace(0.5 * span[0], span[1], TRIED)]
    _, size, functions = np.linalg.svd(np.array(every), full_matrices=False)
    return np.asarray(functions[size > LEAST_FUNCTION * size[0]])


def _whitened(
    problem: Problem, at: At, scatter: Scatter, functions: Array, changed: tuple[IntArray, IntArray]
) -> tuple[Array, Array]:
    """The whitened rows of rests and turns with the functions' amplitudes in the place of those of the warm-up;
    `changed` is where these stand, and the parameters that they are changes of."""
    weights, first, (own, base) = at.noise.weights(scatter), problem.before_turn, changed
    N, K, r = len(at.rows.rest), len(at.rows.turn), at.rows.rest.shape[1]
    by_rest, by_turn, by_growth = np.split(functions, [N, N + K], axis=1)
    rest = weights.rest @ at.rows.rest
    alone = _over_time(rest[:, :, 4 + base], by_rest)
    merged = weights.merged @ at.rows.merged(first)
    W, turn = weights.merged[:, :, r:], at.rows.turn
    settling = problem.observations.warm_up
    assert settling is not None
    _, left, grows = left_of_warm_up(problem.observations, settling)
    growing = (turn[:, :, 7 + own] - left[:, None] * turn[:, :, 7 + base]) / (settling * grows[:, None])
    along = _over_time(weights.merged[:, :, :r] @ at.rows.rest[first][:, :, 4 + base], by_rest[:, first])
    along += _over_time(W @ turn[:, :, 7 + base], by_turn) + _over_time(W @ growing, by_growth)
    rest, merged = (
        np.concatenate([rows[:, :, : -1 - len(own)], columns, rows[:, :, -1:]], axis=2)
        for rows, columns in ((rest, alone), (merged, along))
    )
    return rest, merged


def _over_time(columns: Array, functions: Array) -> Array:
    """Columns (M, r, q) times every one of the functions of time (B, M): (M, r, B q)."""
    M, r, q = columns.shape
    return np.asarray(columns[:, :, None, :] * functions.T[:, None, :, None]).reshape(M, r, len(functions) * q)
