"""What an estimate leaves of residuals and of the columns of a cause: the projection of dynamics method, Eq. (11).

A heading that the gyros hardly see may be far from where the rows were linearised. The horizontal Earth's rate is
linear in its cosine and sine, so the rows get another unknown, the part along north, for each chain of rests that has
such a heading.
"""

from __future__ import annotations

import math
from functools import cached_property

import numpy as np
from scipy.linalg import solve_triangular

from tumble.inference.hyperparameters import Scatter
from tumble.inference.likelihood import Linearised
from tumble.units import Array

NO_HEADING = 100.0
"""rad: how well every angle of an attitude is known beforehand, so that a heading that nothing shows has a row."""

SEEN_HEADING = 0.05
"""rad: a heading that the gyros at rest know better is where the rows were linearised."""


class Projection:
    """The residuals of an estimate and what its unknowns span, whitened with the noise and a scatter."""

    def __init__(self, linearised: Linearised, scatter: Scatter) -> None:
        problem, rows = linearised.problem, linearised.rows
        turns = problem.observations.turns
        self._weights = linearised.noise.weights(scatter)
        self._link = problem.link
        self.first = np.zeros(0, dtype=np.int64) if turns is None else turns.first
        N, known = len(problem.link), np.abs(rows.prior[:-1, :-1]).sum(axis=0) > 0.0
        stacked = self.whitened(rows.rest[..., 3:], rows.turn[..., 6:])
        angles = np.column_stack([self._angles(rows.rest[..., :3], rows.turn[..., :6]), self._norths(linearised)])
        own = angles.shape[1]
        A = np.zeros((len(stacked) + own + len(rows.prior) - 1, own + int(known.sum())))
        A[: len(stacked), :own], A[: len(stacked), own:] = angles, stacked[:, :-1][:, known]
        A[len(stacked) : len(stacked) + own, :own] = np.diag(np.where(np.arange(own) < 3 * N, 1.0 / NO_HEADING, 1.0))
        A[len(stacked) + own :, own:] = rows.prior[:-1, :-1][:, known]
        right = np.concatenate([stacked[:, -1], np.zeros(own), rows.prior[:-1, -1]])
        self.basis, self._triangle = np.linalg.qr(A)
        self.residual = right - self.basis @ (self.basis.T @ right)
        self._rows, self._parameters = len(stacked), own + int(known[0])
        self.degrees = self._rows - float((self.basis[: self._rows] ** 2).sum())

    def _norths(self, linearised: Linearised) -> Array:
        """The whitened columns of the part of the Earth's rate along north in every chain whose heading is hardly seen,
        (rows, chains)."""
        problem, rows = linearised.problem, linearised.rows
        gyro, n = problem.observations.gyro_block, problem.observations.accel_block.size
        if gyro is None or problem.earth[0] == 0.0:
            return np.zeros((self.whitened(rows.rest[..., :0], rows.turn[..., :0]).shape[0], 0))
        own = problem.chain[:, None, None] == np.arange(problem.chain[-1] + 1)
        heading, none = np.zeros((*rows.rest.shape[:2], own.shape[2])), np.zeros((*rows.turn.shape[:2], own.shape[2]))
        heading[:, n : n + gyro.size] = rows.rest[:, n : n + gyro.size, 2:3] * own
        hardly = (self.whitened(heading, none) ** 2).sum(axis=0) < SEEN_HEADING**-2
        rest, turn = by_north(linearised)
        return self.whitened(rest[:, :, None] * own, turn[:, :, None] * own[self.first])[:, hardly]

    @property
    def chi_square(self) -> float:
        """Sum of the squares of the residuals of the rows."""
        return float((self.residual[: self._rows] ** 2).sum())

    def whitened(self, rest: Array, turn: Array) -> Array:
        """Columns of the rests (N, r, q) and turns (K, t, q), whitened, one below the other."""
        merged = np.concatenate([rest[self.first], turn], axis=1)
        alone = self._link < 0
        parts = (self._weights.rest[alone] @ rest[alone], self._weights.merged @ merged)
        return np.concatenate([part.reshape(part.shape[0] * part.shape[1], rest.shape[2]) for part in parts])

    def _angles(self, rest: Array, turn: Array) -> Array:
        """The whitened columns of the attitudes of all rests, (rows, 3 N)."""
        N, K = len(rest), len(turn)
        wide_rest, wide_turn = np.zeros((N, rest.shape[1], N, 3)), np.zeros((K, turn.shape[1], N, 3))
        wide_rest[np.arange(N), :, np.arange(N)] = rest
        wide_turn[np.arange(K), :, self.first] = turn[..., :3]
        wide_turn[np.arange(K), :, self.first + 1] = turn[..., 3:]
        return self.whitened(_joined(wide_rest), _joined(wide_turn))

    def left_of(self, columns: Array) -> Array:
        """What the unknowns leave of whitened columns: B of (11), over all rows, priors included."""
        padded = np.zeros((len(self.residual), columns.shape[1]))
        padded[: self._rows] = columns
        return np.asarray(padded - self.basis @ (self.basis.T @ padded))

    def apart(self, rest: Array, turn: Array) -> Array:
        """Whitened directions of rests (N, r, q) and turns (K, t, q), a column for each rest or turn and each of the
        q."""
        N, K, q = len(rest), len(turn), max(rest.shape[2], turn.shape[2])
        wide_rest, wide_turn = np.zeros((N, rest.shape[1], N, q)), np.zeros((K, turn.shape[1], N, q))
        if rest.shape[2]:
            wide_rest[np.arange(N), :, np.arange(N)] = rest
        if turn.shape[2]:
            wide_turn[np.arange(K), :, self.first] = turn
        return self.whitened(_joined(wide_rest), _joined(wide_turn))

    def changes(self, columns: Array) -> Array:
        """Δθ (m, …) of the parameters by whitened columns of something that is left out."""
        return np.asarray(solve_triangular(self._triangle, self.basis[: self._rows].T @ columns)[self._parameters :])

    @cached_property
    def u(self) -> Array:
        """Standard uncertainties (m,) of the parameters."""
        inverse = solve_triangular(self._triangle, np.eye(len(self._triangle)))
        return np.asarray(np.sqrt((inverse**2).sum(axis=1))[self._parameters :])


def by_north(linearised: Linearised) -> tuple[Array, Array]:
    """What the part of the Earth's rate along north predicts of the rows of the rests (N, r) and of the turns (K, t):
    the rate that gyros read at rest, T Ω_N along north of a rotation, and ½ T² Ω_N g along east of a velocity."""
    problem, rows, L = linearised.problem, linearised.rows, linearised.point.attitudes
    gyro, n, north = problem.observations.gyro_block, problem.observations.accel_block.size, problem.earth[0]
    assert gyro is not None
    rest, turn = np.zeros(rows.rest.shape[:2]), np.zeros(rows.turn.shape[:2])
    rest[:, n : n + gyro.size] = north * L[:, 0] @ gyro.axes.T
    turns = problem.observations.turns
    if turns is not None:
        T, start = turns.duration[:, None], L[turns.first]
        turn[:, :3] = T * north * start[:, 0]
        if problem.instrument.in_velocities:
            turn[:, 3:6] = 0.5 * T**2 * north * linearised.point.gravity * start[:, 2]
    return rest, turn


def _joined(wide: Array) -> Array:
    """Columns (N, r, …) with all indices after the second as one."""
    return wide.reshape(*wide.shape[:2], math.prod(wide.shape[2:]))
