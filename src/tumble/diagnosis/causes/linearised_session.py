"""Sessions at the linearisation of their estimate, as the columns of causes are made of it."""

from __future__ import annotations

from functools import cached_property
from typing import Literal

import numpy as np

from tumble.inference.likelihood import Linearised
from tumble.reduction.observations import Observations
from tumble.reduction.together import apart
from tumble.rotation import rotation_matrix, rotation_vector
from tumble.sensors.model import Block
from tumble.units import Array

PATH_STEPS = 24
"""Steps a turn is followed in."""

SHORTEST_TURN = 1e-6
"""s: what is shorter is no turn."""


class LinearisedSession:
    """What candidate causes of one or several sessions are made of: own forces of the accelerometers at rest (N, n) and
    on the way to the next (K, steps, n), and where the rows of a kind of sensor stand."""

    def __init__(self, linearised: Linearised) -> None:
        self.linearised = linearised
        self.problem = linearised.problem.warmed(linearised.point)
        self.observations = self.problem.observations
        L = linearised.point.attitudes
        self.force = linearised.point.gravity * L[:, 1]
        self.rate = self.problem.earth @ L
        self.rest_shape = linearised.rows.rest.shape[:2]
        self.turn_shape = linearised.rows.turn.shape[:2]

    @cached_property
    def observed(self) -> list[Observations]:
        """The observations of each session."""
        if self.observations.together is None:
            return [self.observations]
        return [apart(self.observations, part.rests, part.turns) for part in self.problem.parts]

    @cached_property
    def begins(self) -> set[int]:
        """The first rest of each session."""
        return {part.rests.start for part in self.problem.parts}

    @cached_property
    def accel(self) -> Block:
        return self.observations.accel_block

    @property
    def turned(self) -> bool:
        """Whether anything is turned in any session."""
        return any(self.turned_in(s) for s in range(len(self.problem.parts)))

    def turned_in(self, s: int) -> bool:
        """Whether anything is turned in a session: the parts of a rest are joined by turns of no duration."""
        about = self.linearised.about
        return about is not None and bool(np.any(about.moments.T[self.problem.parts[s].turns] >= SHORTEST_TURN))

    @cached_property
    def steps(self) -> Array:
        """Rotations (K, steps, 3, 3), body at the start → body on the way of each turn, taken as one about one axis of
        the body."""
        about = self.linearised.about
        if about is None:
            return np.zeros((0, PATH_STEPS, 3, 3))
        path = rotation_vector(about.C)
        angle = np.linalg.norm(path, axis=1, keepdims=True)
        beyond = np.einsum("ka,ka->k", path, about.moments.body[:, 1:4]) < 0.0
        path = np.where(beyond[:, None], path * (1.0 - 2.0 * np.pi / np.maximum(angle, 1e-9)), path)
        share = (np.arange(PATH_STEPS) + 0.5) / PATH_STEPS
        back = rotation_matrix(-(share[None, :, None] * path[:, None]).reshape(-1, 3))
        return np.asarray(back.reshape(-1, PATH_STEPS, 3, 3))

    @cached_property
    def paths(self) -> Array:
        """Specific forces (K, steps, 3) on the way of each turn."""
        turns = self.observations.turns
        if turns is None:
            return np.zeros((0, PATH_STEPS, 3))
        return np.asarray(np.einsum("ksab,kb->ksa", self.steps, self.force[turns.first]))

    def biased(self, kind: str, at_rest: Array, in_turn: Array) -> tuple[Array, Array]:
        """Columns of a bias of every sensor of a kind that is so many times as large at rest (N, n) and on the way of
        the turns (K, steps, n)."""
        n = at_rest.shape[1]
        first = 0 if kind == "accel" else self.accel.size
        rest = np.zeros((*self.rest_shape, n))
        rest[:, first : first + n] = at_rest[:, :, None] * np.eye(n)
        about = self.linearised.about
        turn = np.zeros((*self.linearised.rows.turn.shape[:2], n))
        if len(turn):
            turn = self.linearised.rows.bias[:, :, first : first + n] * in_turn.mean(axis=1)[:, None, :]
        if kind == "accel" and about is not None:
            nominal = np.linalg.pinv(self.accel.axes)
            each = np.swapaxes(self.steps, 2, 3) @ nominal  # C s_p
            self.put_velocity(turn, np.einsum("ksip,ksp,k->kip", each, in_turn, about.moments.T / PATH_STEPS))
        return rest, turn

    def put_velocity(self, turn: Array, columns: Array) -> None:
        """Put columns (K, 3, q) into the rows of the velocities, where there are any."""
        if self.problem.instrument.in_velocities:
            turn[:, 3:6] = columns

    def nothing(self, q: int) -> tuple[Array, Array]:
        """Columns of nothing."""
        return np.zeros((*self.rest_shape, q)), np.zeros((*self.turn_shape, q))


def kinds(session: LinearisedSession) -> list[tuple[Literal["accel", "gyro"], Block]]:
    """The sensors of a session, by kind."""
    gyro = session.observations.gyro_block
    return [("accel", session.accel), *([("gyro", gyro)] if gyro is not None else [])]  # type: ignore[list-item]
