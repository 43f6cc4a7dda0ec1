"""Errors of the parameters after one pass of a method of the turntable paper on a programme, to second order.

A pass is the method itself (`tumble.methods.paper`) on the readings of sensors with the parameters X, in attitudes that
deviate from the programme by τ. It is smooth, and exact to rounding apart from products of Earth's rates in a turn, so
it is differentiated by central differences. X are the 21 parameters in the order of the calibration file; τ are three
rotations of the table for each position, about N, U, E, and three of the mounting, about X, Y, Z.

A turn is about one geographic axis at a constant rate. With its rotation vector v in the body at the start, and its
part R(s) = exp(s [v_n×]) at 0 ≤ s ≤ 1 in the geographic frame, readings compensated by a model are S v + b T plus those
of the Earth's rate, and integrate to

    C = exp([∫ exp(s [w×]) S L₀ᵀ R(s)ᵀ Ω T ds ×]) exp([w×]),   w = S v + b T

Source: Vodicheva & Parysheva 2019, the equations that `tumble.methods.paper` names. Its accuracy formulas, one by one,
are in studies/accuracy_formulas.py.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tumble.earth import EARTH_RATE
from tumble.methods.paper.blocks import TRIAD, model_of
from tumble.methods.paper.four_stages import (
    GYRO_TRIAD,
    SCALAR,
    SEQUENTIAL,
    PaperMethod,
    ProgrammeCourse,
    course_of_programme,
    one_pass,
)
from tumble.methods.paper.gyros import axes_and_angles
from tumble.planning.setup import NAMES, Setup
from tumble.rotation import rotation_matrix, rotation_vector_near
from tumble.sensors.model import ACCEL_ANGLES, PERFECT_TRIAD, SensorModel, triad_parameters
from tumble.units import Array, IntArray

MethodOfPaper = Literal["sequential", "scalar"]
METHODS_OF_PAPER: tuple[MethodOfPaper, ...] = ("sequential", "scalar")
METHODS: Mapping[MethodOfPaper, PaperMethod] = {"sequential": SEQUENTIAL, "scalar": SCALAR}

STEP = 1e-4  # of the central differences: of angles and scale factors, and relative to gravity and Earth's rate
ROUNDING = 1e-6  # smaller errors, relative to the steps, are taken as zero
_NODES = [
    (0.5 * (1.0 + node), 0.5 * weight) for node, weight in zip(*np.polynomial.legendre.leggauss(5), strict=True)
]  # nodes and weights over a turn


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PaperProgramme:
    """A programme as used by a method of the paper."""

    method: MethodOfPaper
    course: ProgrammeCourse
    nominal: Array  # (N, 3, 3): attitudes, body → geographic
    first: IntArray  # (K,): rests before the known turns
    moves: Array  # (K, 3): their rotation vectors, geographic, rad
    gravity: float

    @staticmethod
    def of(setup: Setup, method: MethodOfPaper) -> PaperProgramme:
        """Return the programme of a set-up; raise ProgrammeError unless it has the positions that the method needs."""
        nominal = np.array([position.matrix for position in setup.programme.positions])
        METHODS[method].check(nominal[:, 1], TRIAD)
        course = course_of_programme(setup.programme, turn_rate=setup.turn_rate, latitude=setup.latitude)
        axes, angles = axes_and_angles(setup.programme)
        return PaperProgramme(
            method=method,
            course=course,
            nominal=nominal,
            first=np.array([turn.first for series in course.series for turn in series], dtype=np.int64),
            moves=angles[:, None] * axes,
            gravity=setup.gravity,
        )

    @property
    def steps(self) -> Array:
        """Steps (21,) of the differences of the parameters."""
        steps = np.full(len(NAMES), STEP)
        steps[:3] *= self.gravity
        steps[9:12] *= EARTH_RATE
        return steps

    def estimated(
        self,
        X: Array,
        attitudes: Array,
        *,
        force: Array | float = 0.0,
        rate: Array | float = 0.0,
        drift: Array | float = 0.0,
        turned: Array | float = 0.0,
    ) -> Array:
        """Return the parameters (..., 21) after one pass; zero for gyro parameters that are not determined.

        Sensors have the parameters X (..., 21) and attitudes (..., N, 3, 3). Errors are `force` and `rate` at rest
        (..., N, 3), `drift` of the rates in turns (..., K, 3), and `turned` of the rotations (..., K, 3), rad."""
        accel, gyro = model_of(TRIAD, X[..., :9]), model_of(GYRO_TRIAD, X[..., 9:])
        T, earth = self.course.duration[:, None], self.course.earth_rate
        L0, L1 = (attitudes[..., rests, :, :] for rests in (self.first, self.first + 1))
        vector = rotation_vector_near(L1 @ np.swapaxes(L0, -1, -2), self.moves)
        body = (vector[..., None, :] @ L0)[..., 0, :]
        by_earth = [T * (earth @ (rotation_matrix(node * vector) @ L0)) for node, _ in _NODES]

        def turn(model: SensorModel) -> Array:
            inverse = model.inverse()
            S_t, offset = np.swapaxes(inverse @ gyro.matrix, -1, -2), (gyro.bias - model.bias)[..., None, :] + drift
            w = body @ S_t + T * (offset @ np.swapaxes(inverse, -1, -2))
            ahead = np.zeros_like(w)
            for (node, weight), there in zip(_NODES, by_earth, strict=True):
                ahead += weight * (rotation_matrix(node * w) @ (there @ S_t)[..., None])[..., 0]
            return np.asarray(rotation_matrix(ahead + turned) @ rotation_matrix(w))

        rests = accel.predict(self.gravity * attitudes[..., 1, :]) + force, gyro.predict(earth @ attitudes) + rate
        start, integrated = (PERFECT_TRIAD, PERFECT_TRIAD), turn if len(self.first) else None
        models = one_pass(METHODS[self.method], self.course, rests, integrated, np.array(self.gravity), start)
        (b, k, angles), of_gyro = (triad_parameters(model) for model in models)
        parts = [b, k, angles[..., ACCEL_ANGLES], *of_gyro]
        return np.concatenate([np.broadcast_to(each, (*b.shape[:-1], each.shape[-1])) for each in parts], axis=-1)

    def first_order(self) -> tuple[Array, Array]:
        """Return the errors after one pass per unit of the parameters: T₀ (21, 21) on an exact programme, and its
        derivatives D (3N + 3, 21, 21) by the deviations, per rad."""
        N, steps = len(self.nominal), self.steps
        X = np.concatenate([np.diag(steps), -np.diag(steps)])
        τ = STEP * np.concatenate([np.eye(3 * N + 3), -np.eye(3 * N + 3), np.zeros((1, 3 * N + 3))])
        table = rotation_matrix(τ[:, : 3 * N].reshape(-1, N, 3))
        attitudes = (table @ self.nominal @ rotation_matrix(τ[:, None, 3 * N :]))[:, None]
        up, down = np.split(self.estimated(X, attitudes), 2, axis=1)
        errors = np.eye(len(NAMES)) - np.swapaxes(up - down, 1, 2) / (2.0 * steps)
        forward, backward, T0 = np.split(errors, [3 * N + 3, 6 * N + 6])
        D, least = (forward - backward) / (2.0 * STEP), ROUNDING * steps[:, None] / steps
        return np.where(np.abs(T0[0]) > least, T0[0], 0.0), np.where(np.abs(D) > least, D, 0.0)

    def second_order(self) -> Array:
        """Return Q (21, 21, 21), symmetric in i and j, of the errors q = Σ X_i X_j Q_ij (21,) of second order after a
        pass on an exact programme."""
        (i, j), steps = np.triu_indices(len(NAMES)), self.steps
        single = np.diag(steps)
        X = np.concatenate([np.zeros((1, len(NAMES))), single, single[i] + single[j]])
        even = 0.5 * (self.estimated(X, self.nominal) + self.estimated(-X, self.nominal))
        of_one, of_two = np.split(even[1:] - even[0], [len(NAMES)])
        Q = np.zeros((len(NAMES),) * 3)
        Q[i, j] = Q[j, i] = 0.5 * (of_two - of_one[i] - of_one[j]) / (steps[i] * steps[j])[:, None]
        return Q
