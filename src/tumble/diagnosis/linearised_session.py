"""Building blocks for the columns of candidate causes, at the linearisation of an estimate."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from tumble.inference.linearisation import Linearisation
from tumble.inference.problem import SessionSpan
from tumble.reduction.observations import Observations, extract_session
from tumble.rotation import rotation_matrix, rotation_vector
from tumble.sensors.model import Block, SensorKind
from tumble.units import Array

PATH_STEPS = 24  # steps into which the path of a turn is divided
SHORTEST_TURN = 1e-6  # s: shorter turns only join the parts of one rest


class LinearisedSession:
    """One or several sessions with the forces and rates of their estimate."""

    def __init__(self, linearised: Linearisation) -> None:
        self.linearised = linearised
        self.problem = linearised.problem.with_lags_at(linearised.point)
        self.observations = self.problem.observations
        L = linearised.point.attitudes
        self.force = linearised.point.gravity * L[:, 1]  # (N, 3), in the body at rest
        self.rate = self.problem.earth @ L  # (N, 3), of the Earth
        self.accel: Block = self.observations.accel_block
        self.first_rests = {part.rests.start for part in self.problem.parts}
        gyro, about = self.observations.gyro_block, linearised.about
        self.kinds: list[tuple[SensorKind, Block]] = [("accel", self.accel)]
        if gyro is not None:
            self.kinds.append(("gyro", gyro))
        moved = np.zeros(0, dtype=bool) if about is None else about.moments.T >= SHORTEST_TURN
        # the parts of one rest are joined by turns of no duration
        self.has_turns = [bool(moved[part.turns].any()) for part in self.problem.parts]

    @cached_property
    def observed(self) -> list[Observations]:
        """The observations of each session."""
        if self.observations.together is None:
            return [self.observations]
        return [extract_session(self.observations, part.rests, part.turns) for part in self.problem.parts]

    @cached_property
    def _path_rotations(self) -> Array:
        """Rotations (K, steps, 3, 3) of the body since the start of each turn, taken as about one axis in the body."""
        about = self.linearised.about
        if about is None:
            return np.zeros((0, PATH_STEPS, 3, 3))
        path = rotation_vector(about.C)
        angle = np.linalg.norm(path, axis=1, keepdims=True)
        beyond_half = np.einsum("ka,ka->k", path, about.moments.body[:, 1:4]) < 0.0
        path = np.where(beyond_half[:, None], path * (1.0 - 2.0 * np.pi / np.maximum(angle, 1e-9)), path)
        share = (np.arange(PATH_STEPS) + 0.5) / PATH_STEPS
        back = rotation_matrix(-(share[None, :, None] * path[:, None]).reshape(-1, 3))
        return np.asarray(back.reshape(-1, PATH_STEPS, 3, 3))

    @cached_property
    def path_forces(self) -> Array:
        """Specific forces (K, steps, 3) in the body during each turn."""
        turns = self.observations.turns
        if turns is None:
            return np.zeros((0, PATH_STEPS, 3))
        return np.asarray(np.einsum("ksab,kb->ksa", self._path_rotations, self.force[turns.first]))

    def zero_columns(self, q: int) -> tuple[Array, Array]:
        """Return zero columns (N, r, q) of the rests and (K, t, q) of the turns."""
        rows = self.linearised
        return np.zeros((*rows.rest.shape[:2], q)), np.zeros((*rows.turn.shape[:2], q))

    def after_rest(self, last: int, part: SessionSpan) -> tuple[Array, Array]:
        """Return which rests (N,) and turns (K,) of a session follow one of its rests, 0 or 1; ½ for the next turn."""
        before = self.problem.before_turn[part.turns]
        after = np.arange(part.rests.start, part.rests.stop) > last
        return after.astype(float), 0.5 * (1.0 + np.sign(before - last))

    def bias_columns(self, kind: str, at_rest: Array, in_turn: Array) -> tuple[Array, Array]:
        """Return the columns of biases of a kind of sensor that vary by factors `at_rest` (N, n) and `in_turn`
        (K, steps, n)."""
        n, about = at_rest.shape[1], self.linearised.about
        first = 0 if kind == "accel" else self.accel.size
        rest, turn = self.zero_columns(n)
        rest[:, first : first + n] = at_rest[:, :, None] * np.eye(n)
        if len(turn):
            turn = self.linearised.bias[:, :, first : first + n] * in_turn.mean(axis=1)[:, None, :]
        if kind == "accel" and about is not None:
            turned = np.swapaxes(self._path_rotations, 2, 3) @ np.linalg.pinv(self.accel.axes)  # C s_p
            self.set_velocity(turn, np.einsum("ksip,ksp,k->kip", turned, in_turn, about.moments.T / PATH_STEPS))
        return rest, turn

    def set_velocity(self, turn: Array, columns: Array) -> None:
        """Set the rows of the velocities to columns (K, 3, q), if the estimate uses velocities."""
        if self.problem.instrument.in_velocities:
            turn[:, 3:6] = columns
