"""Sessions at the linearisation of their estimate, as the columns of causes are made of it."""

from __future__ import annotations

from functools import cached_property
from typing import Literal

import numpy as np

from tumble.inference.linearisation import Linearisation
from tumble.inference.problem import SessionSpan
from tumble.reduction.observations import Observations
from tumble.reduction.together import apart
from tumble.rotation import rotation_matrix, rotation_vector
from tumble.sensors.model import Block
from tumble.units import DEGREE, G_STANDARD, Array

Kind = Literal["accel", "gyro"]
Concerns = Literal["accel", "gyro", "both"]
UNITS: dict[str, tuple[float, str]] = {"accel": (1e-6 * G_STANDARD, "µg"), "gyro": (DEGREE / 3600.0, "°/h")}
"""In which biases and their like are said, (SI, name)."""
WORDS = {"accel": "accelerometers", "gyro": "gyros"}

PATH_STEPS = 24
"""Steps a turn is followed in."""
SHORTEST_TURN = 1e-6
"""s: what is shorter is no turn."""


def sized(value: float, unit: tuple[float, str], digits: int = 2) -> str:
    """A quantity (SI) in a unit (SI, name)."""
    size, name = unit
    return f"{value / size:.{digits}g} {name}".replace(" °", "°")


class LinearisedSession:
    """What candidate causes of one or several sessions are made of: own forces of the accelerometers at rest (N, n) and
    on the way to the next (K, steps, n), and where the rows of a kind of sensor stand."""

    def __init__(self, linearised: Linearisation) -> None:
        self.linearised = linearised
        self.problem = linearised.problem.with_lags_at(linearised.point)
        self.observations = self.problem.observations
        L = linearised.point.attitudes
        self.force = linearised.point.gravity * L[:, 1]
        self.rate = self.problem.earth @ L
        self.accel: Block = self.observations.accel_block
        self.begins = {part.rests.start for part in self.problem.parts}  # the first rest of each session
        gyro, about = self.observations.gyro_block, linearised.about
        self.kinds: list[tuple[Kind, Block]] = [("accel", self.accel)]
        if gyro is not None:
            self.kinds.append(("gyro", gyro))
        # of each session whether anything is turned: the parts of a rest are joined by turns of no duration
        moved = np.zeros(0, dtype=bool) if about is None else about.moments.T >= SHORTEST_TURN
        self.turned = [bool(moved[part.turns].any()) for part in self.problem.parts]

    @cached_property
    def observed(self) -> list[Observations]:
        """The observations of each session."""
        if self.observations.together is None:
            return [self.observations]
        return [apart(self.observations, part.rests, part.turns) for part in self.problem.parts]

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

    def nothing(self, q: int) -> tuple[Array, Array]:
        """Columns (N, r, q) and (K, t, q) of nothing."""
        rows = self.linearised
        return np.zeros((*rows.rest.shape[:2], q)), np.zeros((*rows.turn.shape[:2], q))

    def since(self, last: int, part: SessionSpan) -> tuple[Array, Array]:
        """Which rests (N,) and turns (K,) of a session come after one of its rests: 1, and half of the turn between."""
        before = self.problem.before_turn[part.turns]
        after = np.arange(part.rests.start, part.rests.stop) > last
        return after.astype(float), 0.5 * (1.0 + np.sign(before - last))

    def biased(self, kind: str, at_rest: Array, in_turn: Array) -> tuple[Array, Array]:
        """Columns of a bias of every sensor of a kind that is so many times as large at rest (N, n) and on the way of
        the turns (K, steps, n)."""
        n, about = at_rest.shape[1], self.linearised.about
        first = 0 if kind == "accel" else self.accel.size
        rest, turn = self.nothing(n)
        rest[:, first : first + n] = at_rest[:, :, None] * np.eye(n)
        if len(turn):
            turn = self.linearised.bias[:, :, first : first + n] * in_turn.mean(axis=1)[:, None, :]
        if kind == "accel" and about is not None:
            turned = np.swapaxes(self.steps, 2, 3) @ np.linalg.pinv(self.accel.axes)  # C s_p
            self.put_velocity(turn, np.einsum("ksip,ksp,k->kip", turned, in_turn, about.moments.T / PATH_STEPS))
        return rest, turn

    def put_velocity(self, turn: Array, columns: Array) -> None:
        """Put columns (K, 3, q) into the rows of the velocities, where there are any."""
        if self.problem.instrument.in_velocities:
            turn[:, 3:6] = columns
