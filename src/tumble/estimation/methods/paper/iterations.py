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
from tumble.estimation.estimate import SCATTER_PROBABILITY, Estimate, Fit, chance_of, scatter_of, sigmas
from tumble.estimation.methods.paper.compensation import (
    ACCEL_ANGLES,
    compensated,
    perfect,
    remaining,
    triad_model,
    triad_parameters,
)
from tumble.estimation.methods.paper.four_stages import (
    PaperMethod,
    ProgrammeCourse,
    accelerometer_pass,
    course_of,
    differences,
    gyro_bias_pass,
    gyro_matrix_pass,
)
from tumble.estimation.methods.paper.levelling import vertical
from tumble.reduction.observations import Observations
from tumble.reduction.turns import Turns
from tumble.rotation import rotation_matrix
from tumble.sensors.model import Block, SensorModel
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
        turned = launch.turned(launch.after_rests(values))
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
        """C (..., K, 3, 3) about `model`: exp([−(M : E + B δ)×]) C."""
        E, δ = remaining(model, self.about)
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
    def steps(self) -> Array:
        """Steps of the central differences for the data and the values."""
        rests, turns = 3 * len(self.observations.rests), 3 * len(self.course.duration)
        gyros = [] if self.observations.gyro_block is None else [(rests, 1e-9), (turns, 1e-6)]
        data = [np.full(n, step) for n, step in [(rests, 1e-5), *gyros, (1, 1e-5)]]
        values = [{"accel.bias": 1e-5, "gyro.bias": 1e-9}.get(group_name(name), 1e-6) for name in self.names]
        return np.concatenate([*data, values])

    def readings(self, data: Array) -> tuple[Array, Array, Array, Array]:
        """Specific forces and rates (..., N, 3), errors of turns (..., K, 3), both empty without gyros, and g (...)."""
        n = 3 * len(self.observations.rests)
        force, rest, gravity = np.split(data, [n, data.shape[-1] - 1], axis=-1)
        rate, turning = np.split(rest, [n], axis=-1)
        return _vectors(force), _vectors(rate), _vectors(turning), gravity[..., 0]

    def models(self, values: Array) -> tuple[SensorModel, SensorModel]:
        """Models in body axes; without gyros those of perfect ones."""
        signs = [block.axes.sum(axis=0) for block in self.blocks]
        accel = triad_model(signs[0] * values[..., :3], values[..., 3:6], values[..., 6:9])
        if len(signs) == 1:
            return accel, perfect()
        return accel, triad_model(signs[1] * values[..., 9:12], values[..., 12:15], values[..., 15:])

    def values(self, accel: SensorModel, gyro: SensorModel) -> Array:
        """Parameters of models in body axes: `models` inverted."""
        signs = [block.axes.sum(axis=0) for block in self.blocks]
        bias, scale, angles = triad_parameters(accel)
        parts = [signs[0] * bias, scale, angles[..., ACCEL_ANGLES]]
        if len(signs) == 2:
            bias, scale, angles = triad_parameters(gyro)
            parts += [signs[1] * bias, scale, angles]
        return np.concatenate(parts, axis=-1)

    def turned(self, values: Array) -> _Turned | None:
        """The turns integrated about the gyro model of values (m,)."""
        block = self.observations.gyro_block
        if block is None:
            return None
        about = self.observations.turns_about(block.model(values[9:]))
        return _Turned(turns=about, about=self.models(values)[1])

    def after_rests(self, values: Array) -> Array:
        """Values (m,) after stages 1 to 3 of a pass that starts from values (m,)."""
        force, rate, _, gravity = self.readings(self.data)
        accel, gyro = self.models(values)
        accel = accelerometer_pass(self.method, self.course, force, gravity, accel)
        if len(self.blocks) == 2:
            gyro = gyro_bias_pass(self.course, rate, compensated(accel, force), gyro)
        return self.values(accel, gyro)

    def after_pass(self, data: Array, values: Array, turned: _Turned | None) -> Array:
        """Values (..., m) after all stages of a pass over data (..., d) that starts from values (..., m)."""
        force, rate, turning, gravity = self.readings(data)
        accel, gyro = self.models(values)
        accel = accelerometer_pass(self.method, self.course, force, gravity, accel)
        if turned is not None:
            corrected = compensated(accel, force)
            gyro = gyro_bias_pass(self.course, rate, corrected, gyro)
            C = rotation_matrix(turning) @ turned.rotations(gyro)
            gyro = gyro_matrix_pass(self.course, rate, corrected, C, gyro)
        return self.values(accel, gyro)

    def residuals(self, data: Array, values: Array, turned: _Turned | None) -> Array:
        """What is left at values (..., m): |w| − g of every rest, û·ω − Ω sin B of every rest, y of every turn."""
        force, rate, turning, gravity = self.readings(data)
        accel, gyro = self.models(values)
        corrected = compensated(accel, force)
        parts = [np.linalg.norm(corrected, axis=-1) - gravity[..., None]]
        if turned is not None:
            ω = compensated(gyro, rate)
            C = rotation_matrix(turning) @ turned.rotations(gyro)
            parts.append((vertical(corrected) * ω).sum(axis=-1) - self.course.earth_rate[1])
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


def _vectors(flat: Array) -> Array:
    return flat.reshape(*flat.shape[:-1], -1, 3)


# Uncertainty, and how well it fits


@dataclass(frozen=True, kw_only=True, slots=True)
class _PassScatter:
    """Scatter on top of the noise within rests and turns: of accelerometers between rests (m/s²), of gyros between
    rests (rad/s), of turns (rad)."""

    accel: float = 0.0
    rest: float = 0.0
    turn: float = 0.0


_GROUPS = {
    "accelerometers": ("accel", "m/s^2"),
    "gyro rests": ("rest", "rad/s"),
    "gyro turns": ("turn", "rad"),
}
"""Groups of residuals: the scatter they judge, and its unit."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _PassResiduals:
    """The residuals that a pipeline leaves, and their derivatives with respect to the data: at fixed values, and with
    what the values take up."""

    launch: _SessionData
    residual: Array
    direct: Array
    total: Array

    def rows(self, group: str) -> slice:
        """Residuals of a group."""
        n = len(self.launch.observations.rests)
        return {"accelerometers": slice(0, n), "gyro rests": slice(n, 2 * n), "gyro turns": slice(2 * n, None)}[group]

    def agreement(self, group: str, scatter: _PassScatter) -> tuple[float, float]:
        """Sum of the squared residuals of a group in units of their variances, scaled so that it has the mean of a
        chi-square with the degrees of freedom that are also returned (matched in mean and variance)."""
        rows, noise = self.rows(group), self.launch.covariance(scatter)
        scale = np.sqrt(np.einsum("rd,de,re->r", self.direct[rows], noise, self.direct[rows]))
        normalised = self.total[rows] / scale[:, None]
        left = normalised @ noise @ normalised.T
        trace, squares = float(np.trace(left)), float((left**2).sum())
        if trace < 1e-6:
            return 0.0, 0.0
        return float(((self.residual[rows] / scale) ** 2).sum()) * trace / squares, trace**2 / squares

    def normalised(self, group: str, scatter: _PassScatter, size: int) -> Array:
        """Residuals of a group, `size` at a time, in units of their standard deviation; zero where the method takes
        them up whatever they are."""
        rows, noise = self.rows(group), self.launch.covariance(scatter)
        raw = np.einsum("rd,de,re->r", self.direct[rows], noise, self.direct[rows])
        left = np.einsum("rd,de,re->r", self.total[rows], noise, self.total[rows])
        squares = (self.residual[rows] ** 2 / raw).reshape(-1, size).sum(axis=1)
        expected = (left / raw).reshape(-1, size).sum(axis=1)
        return np.asarray(np.sqrt(squares / np.where(expected > 1e-3, expected, np.inf)))

    def groups(self) -> tuple[str, ...]:
        return tuple(_GROUPS) if len(self.launch.blocks) == 2 else ("accelerometers",)

    def found_scatter(self) -> _PassScatter:
        """The scatter that explains the residuals of each group in turn, where they need one."""
        scatter = _PassScatter()
        for group in self.groups():
            statistic, degrees = self.agreement(group, scatter)
            if degrees < 0.5 or chance_of(statistic, degrees) > SCATTER_PROBABILITY:
                continue

            def excess(trial: float, name: str = group, known: _PassScatter = scatter) -> float:
                statistic, degrees = self.agreement(name, replace(known, **{_GROUPS[name][0]: trial}))
                return statistic - degrees

            start = float(np.sqrt(np.median(np.diag(self._noise(group)))))
            scatter = replace(scatter, **{_GROUPS[group][0]: scatter_of(excess, start)})
        return scatter

    def _noise(self, group: str) -> Array:
        """Covariance of the data of one kind, without scatter."""
        n, noise = 3 * len(self.launch.observations.rests), self.launch.covariance(_PassScatter())
        kind = {"accelerometers": slice(0, n), "gyro rests": slice(n, 2 * n), "gyro turns": slice(2 * n, -1)}[group]
        return noise[kind, kind]

    def fits(self, scatter: _PassScatter) -> dict[str, Fit]:
        found = {}
        for group in self.groups():
            name, unit = _GROUPS[group]
            statistic, degrees = self.agreement(group, scatter)
            found[group] = Fit(chi_square=statistic, degrees=degrees, scatter=getattr(scatter, name), scatter_unit=unit)
        return found

    def rest_sigmas(self, scatter: _PassScatter) -> Array:
        """How many sigmas each rest is out, (N,): the worse of accelerometers and gyros."""
        groups = [group for group in self.groups() if group != "gyro turns"]
        return np.asarray(np.max([self._sigmas(group, scatter, 1) for group in groups], axis=0))

    def turn_sigmas(self, scatter: _PassScatter) -> Array:
        """How many sigmas each recorded turn is out, (K,); zero for those the method does not use."""
        out = np.zeros(len(self.launch.course.duration))
        counted = [t.turn for series in self.launch.course.series for t in series if t.counts]
        if counted:
            out[counted] = self._sigmas("gyro turns", scatter, 2)
        return out

    def _sigmas(self, group: str, scatter: _PassScatter, size: int) -> Array:
        degrees = self.agreement(group, scatter)[1]
        return sigmas(self.normalised(group, scatter, size), degrees, getattr(scatter, _GROUPS[group][0]) > 0.0)


def _estimate(launch: _SessionData, values: Array, derivative: Array, increments: tuple[Array, ...]) -> Estimate:
    """The estimate of values (m,) with their derivative (m, d) with respect to the data."""
    turned = launch.turned(values)
    u = np.sqrt(np.diag(derivative @ launch.covariance(_PassScatter()) @ derivative.T))
    limit, converged = _limit(launch, values, turned, u)
    direct, by_values = launch.derivatives(launch.residuals, limit, turned)
    residual = launch.residuals(launch.data, limit, turned)
    left = _PassResiduals(launch=launch, residual=residual, direct=direct, total=direct + by_values @ derivative)
    scatter = left.found_scatter()
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
        rest_residual=launch.residuals(launch.data, values, turned)[left.rows("accelerometers")],
        rest_sigmas=left.rest_sigmas(scatter),
        turn_sigmas=left.turn_sigmas(scatter),
        increments=increments,
        fits=left.fits(scatter),
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
