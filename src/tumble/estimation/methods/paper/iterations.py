"""Iterations of the four stages on a session, with uncertainty.

An iteration is one pass over the same data, with the readings compensated by all passes before it and the turns
integrated about the gyro model of the pass. Its increment measures what the pass before erred by its own method, not
the noise, which is common to all.

Uncertainty is propagated through the passes as they are: the derivative of each pass with respect to every mean
reading, turn, gravity and the values it starts from, by central differences, chained. Noise within rests and turns
comes with the observations; where the residuals need more, scatter between rests and of turns is estimated from them
and included. What the last pass errs by its own method is included, too: it is judged by the passes that would follow,
as the paper judges an iteration by the next; so are the residuals, which speak of the data alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import linalg

from tumble.errors import InputError
from tumble.estimation.agreement import Residuals, explaining
from tumble.estimation.estimate import Estimate
from tumble.estimation.methods.paper.four_stages import (
    PaperMethod,
    ProgrammeCourse,
    accelerometer_pass,
    course_of,
    differences,
    gyro_bias_pass,
    gyro_matrix_pass,
)
from tumble.reduction.observations import Observations
from tumble.reduction.turns.turns import Turns
from tumble.rotation import rotation_matrix, unit_vector
from tumble.sensors.model import ACCEL_ANGLES, PERFECT_TRIAD, Block, SensorModel, triad_model, triad_parameters
from tumble.sensors.parameters import group_name
from tumble.units import Array

MAX_PASSES = 30
NEGLIGIBLE = 1e-2
"""Of the uncertainties, or of the steps of the differences: increments that mean nothing."""


def iterated(observations: Observations, method: PaperMethod, iterations: int) -> Estimate:
    """The estimate after so many iterations, at least one, with covariance. The first starts from what is known of the
    sensors (`Observations.start`). Raises InputError."""
    if iterations < 1:
        raise InputError(f"iterations: expected at least 1, found {iterations}")
    launch = _SessionData.of(observations, method)
    values = np.concatenate([observations.start_values(block) for block in launch.blocks])
    derivative = np.zeros((len(values), len(launch.data)))
    increments = []
    for _ in range(iterations):
        turned = launch.turned(launch.after_pass(launch.data, values, None))
        by_data, by_start = launch.derivatives(launch.after_pass, values, turned)
        after = launch.after_pass(launch.data, values, turned)
        derivative = by_data + by_start @ derivative
        increments.append(after - values)
        values = after
    return _estimate(launch, values, derivative, tuple(increments))


@dataclass(frozen=True, kw_only=True, slots=True)
class _Turned:
    """Turns integrated about a gyro model, and what they are about another near to it, to first order."""

    turns: Turns
    about: SensorModel

    def rotations(self, model: SensorModel) -> Array:
        """C (..., K, 3, 3) about `model`, where rates compensated by `about` are (I + E) ω + δ: exp([−(M : E + B δ)×])
        C."""
        E = np.linalg.solve(self.about.matrix, model.matrix) - np.eye(3)
        δ = np.linalg.solve(self.about.matrix, (model.bias - self.about.bias)[..., None])[..., 0]
        turned = np.einsum("kipq,...pq->...ki", self.turns.M, E) + np.einsum("kip,...p->...ki", self.turns.B, δ)
        return np.asarray(rotation_matrix(-turned) @ self.turns.C)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _SessionData:
    """A session as one vector of data, the mean readings in body axes, the errors of the turns and gravity, and one
    of values, the parameters of the blocks in their order; with either, leading axes for many at once."""

    observations: Observations
    method: PaperMethod
    course: ProgrammeCourse
    data: Array

    @staticmethod
    def of(observations: Observations, method: PaperMethod) -> _SessionData:
        course = course_of(observations, method)
        rests, block = observations.rests, observations.gyro_block
        parts = [(rests.accel @ observations.accel_block.axes).ravel()]
        if block is not None:
            parts += [(rests.gyro @ block.axes).ravel(), np.zeros(3 * len(course.duration))]
        parts.append(np.array([observations.site.gravity]))
        return _SessionData(observations=observations, method=method, course=course, data=np.concatenate(parts))

    @property
    def blocks(self) -> tuple[Block, ...]:
        gyro = self.observations.gyro_block
        return (self.observations.accel_block,) if gyro is None else (self.observations.accel_block, gyro)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(name for block in self.blocks for name in block.names)

    @property
    def kinds(self) -> dict[str, slice]:
        """Where the data of each kind are, by the group of residuals that they make."""
        n, last = 3 * len(self.observations.rests), len(self.data) - 1
        return {"accelerometers": slice(0, n), "gyro rests": slice(n, min(2 * n, last)), "gyro turns": slice(2 * n, -1)}

    @property
    def steps(self) -> Array:
        """Steps of the central differences for the data and the values."""
        data = np.full(len(self.data), 1e-5)
        data[self.kinds["gyro rests"]], data[self.kinds["gyro turns"]] = 1e-9, 1e-6
        values = [{"accel.bias": 1e-5, "gyro.bias": 1e-9}.get(group_name(name), 1e-6) for name in self.names]
        return np.concatenate([data, values])

    def readings(self, data: Array) -> tuple[Array, Array, Array, Array]:
        """Specific forces and rates (..., N, 3), errors of turns (..., K, 3), both empty without gyros, and g (...)."""
        parts = (data[..., kind] for kind in self.kinds.values())
        force, rate, turning = (part.reshape(*part.shape[:-1], -1, 3) for part in parts)
        return force, rate, turning, data[..., -1]

    def models(self, values: Array) -> tuple[SensorModel, SensorModel]:
        """Models in body axes; without gyros those of perfect ones."""
        signs = [block.axes.sum(axis=0) for block in self.blocks]
        accel = triad_model(signs[0] * values[..., :3], values[..., 3:6], values[..., 6:9])
        if len(signs) == 1:
            return accel, PERFECT_TRIAD
        return accel, triad_model(signs[1] * values[..., 9:12], values[..., 12:15], values[..., 15:])

    def values(self, accel: SensorModel, gyro: SensorModel) -> Array:
        """Parameters of models in body axes: `models` inverted."""
        parts = []
        for block, model in zip(self.blocks, (accel, gyro), strict=False):
            bias, scale, angles = triad_parameters(model)
            angles = angles if block.kind == "gyro" else angles[..., ACCEL_ANGLES]
            parts += [block.axes.sum(axis=0) * bias, scale, angles]
        return np.concatenate(parts, axis=-1)

    def turned(self, values: Array) -> _Turned | None:
        """The turns integrated about the gyro model of values (m,)."""
        block = self.observations.gyro_block
        if block is None:
            return None
        about = self.observations.turns_about(block.model(values[9:]))
        return _Turned(turns=about, about=self.models(values)[1])

    def after_pass(self, data: Array, values: Array, turned: _Turned | None) -> Array:
        """Values (..., m) after all stages of a pass over data (..., d) that starts from values (..., m); after the
        stages of the rests where the turns are not integrated."""
        force, rate, turning, gravity = self.readings(data)
        accel, gyro = self.models(values)
        accel = accelerometer_pass(self.method, self.course, force, gravity, accel)
        if len(self.blocks) == 2:
            corrected = accel.apply(force)
            gyro = gyro_bias_pass(self.course, rate, corrected, gyro)
            if turned is not None:
                C = rotation_matrix(turning) @ turned.rotations(gyro)
                gyro = gyro_matrix_pass(self.course, rate, corrected, C, gyro)
        return self.values(accel, gyro)

    def residuals(self, data: Array, values: Array, turned: _Turned | None) -> Array:
        """What is left at values (..., m): |w| − g of every rest, û·ω − Ω sin B of every rest, y of every turn."""
        force, rate, turning, gravity = self.readings(data)
        accel, gyro = self.models(values)
        corrected = accel.apply(force)
        parts = [np.linalg.norm(corrected, axis=-1) - gravity[..., None]]
        if turned is not None:
            C = rotation_matrix(turning) @ turned.rotations(gyro)
            parts.append((unit_vector(corrected) * gyro.apply(rate)).sum(axis=-1) - self.course.earth_rate[1])
            parts.append(differences(self.course, rate, corrected, C, gyro))
        return np.concatenate(parts, axis=-1)

    def derivatives(
        self, function: Callable[[Array, Array, _Turned | None], Array], values: Array, turned: _Turned | None
    ) -> tuple[Array, Array]:
        """Derivatives of `function(data, values, turned)` with respect to data and values, by central differences."""
        d, steps = len(self.data), self.steps
        shifted = np.concatenate([self.data, values]) + np.concatenate([np.diag(steps), -np.diag(steps)])
        high, low = np.split(function(shifted[:, :d], shifted[:, d:], turned), 2)
        both = (high - low).T / (2.0 * steps)
        return both[:, :d], both[:, d:]

    def covariance(self, scatter: _PassScatter) -> Array:
        """Covariance (d, d) of the data: noise within rests and turns, scatter between them, and gravity."""
        rests, (accel, *gyro) = self.observations.rests, self.blocks
        parts = list(accel.axes.T @ rests.accel_covariance @ accel.axes + scatter.accel**2 * np.eye(3))
        if gyro and self.observations.turns is not None:
            turns = self.observations.turns
            parts += list(gyro[0].axes.T @ rests.gyro_covariance @ gyro[0].axes + scatter.rest**2 * np.eye(3))
            drift = (scatter.rest * turns.duration) ** 2 + scatter.turn**2
            parts += list(turns.covariance + drift[:, None, None] * np.eye(3))
        parts.append(np.array([[self.observations.site.gravity_u**2]]))
        return np.asarray(linalg.block_diag(*parts), dtype=float)


# Uncertainty, and how well it fits


@dataclass(frozen=True, kw_only=True, slots=True)
class _PassScatter:
    """Scatter on top of the noise within rests and turns: of accelerometers between rests (m/s²), of gyros between
    rests (rad/s), of turns (rad)."""

    accel: float = 0.0
    rest: float = 0.0
    turn: float = 0.0


_GROUPS = {
    "accelerometers": ("accel", "m/s^2", 1),
    "gyro rests": ("rest", "rad/s", 1),
    "gyro turns": ("turn", "rad", 2),
}
"""Groups of residuals: the scatter they judge, its unit, and how many a rest or a turn has."""


def _estimate(launch: _SessionData, values: Array, derivative: Array, increments: tuple[Array, ...]) -> Estimate:
    """The estimate of values (m,) with their derivative (m, d) with respect to the data."""
    turned, n = launch.turned(values), len(launch.observations.rests)
    u = np.sqrt(np.diag(derivative @ launch.covariance(_PassScatter()) @ derivative.T))
    limit, converged = _limit(launch, values, turned, u)
    direct, by_values = launch.derivatives(launch.residuals, limit, turned)
    residual, total = launch.residuals(launch.data, limit, turned), direct + by_values @ derivative
    rows = {"accelerometers": slice(0, n), "gyro rests": slice(n, 2 * n), "gyro turns": slice(2 * n, None)}
    groups = {name: _GROUPS[name] for name in list(_GROUPS)[: 3 if len(launch.blocks) == 2 else 1]}

    def residuals_of(name: str, scatter: _PassScatter) -> Residuals:
        noise, own = launch.covariance(scatter), rows[name]
        variance = np.einsum("rd,de,re->r", direct[own], noise, direct[own])
        return Residuals(residual=residual[own], variance=variance, left=total[own] @ noise @ total[own].T)

    scatter = _PassScatter()
    for name, (of, _, _) in groups.items():

        def at(trial: float, name: str = name, of: str = of, known: _PassScatter = scatter) -> Residuals:
            return residuals_of(name, replace(known, **{of: trial}))

        noise = np.diag(launch.covariance(_PassScatter()))[launch.kinds[name]]
        scatter = replace(scatter, **{of: explaining(at, float(np.sqrt(np.median(noise))))})
    fits, outliers = {}, {}
    for name, (of, unit, size) in groups.items():
        found, size_of_scatter = residuals_of(name, scatter), getattr(scatter, of)
        fits[name] = found.fit(size_of_scatter, unit)
        outliers[name] = found.sigmas(size, scaled=size_of_scatter > 0.0)
    turn_sigmas = np.zeros(len(launch.course.duration))
    counted = [t.turn for series in launch.course.series for t in series if t.counts]
    if counted:
        turn_sigmas[counted] = outliers.pop("gyro turns")
    noise = derivative @ launch.covariance(scatter) @ derivative.T
    accel, *gyro = launch.blocks
    return Estimate(
        method=launch.method.name,
        names=launch.names,
        units=tuple(unit for block in launch.blocks for unit in block.units),
        values=values,
        covariance=noise + np.outer(limit - values, limit - values),
        observable=np.ones(len(values), dtype=bool),
        null=np.empty((0, len(values))),
        accel=accel.model(values[:9]),
        gyro=gyro[0].model(values[9:]) if gyro else None,
        rest_residual=launch.residuals(launch.data, values, turned)[:n],
        rest_sigmas=np.max(list(outliers.values()), axis=0),
        turn_sigmas=turn_sigmas,
        increments=increments,
        fits=fits,
        converged=converged,
    )


def _limit(launch: _SessionData, values: Array, turned: _Turned | None, u: Array) -> tuple[Array, bool]:
    """Where the passes lead from values (m,) of uncertainty u, with the turns to first order, and whether they get
    there."""
    negligible = NEGLIGIBLE * np.maximum(u, launch.steps[len(launch.data) :])
    for _ in range(MAX_PASSES):
        after = launch.after_pass(launch.data, values, turned)
        if np.all(np.abs(after - values) <= negligible):
            return after, True
        values = after
    return values, False
