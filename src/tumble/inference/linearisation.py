"""Residuals of the likelihood and their Jacobians, in closed form, at a point.

The residuals are those of `tumble.inference.problem`, docs/explanation/mathematics.md (4), (13) and (15).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tumble.inference.elimination import fold
from tumble.inference.integrated_turns import IntegratedTurns, along_paths
from tumble.inference.magnetometer import OWN as MAGNETIC
from tumble.inference.magnetometer import Magnetometer
from tumble.inference.noise import LINK_SCATTER, NO_COMPONENTS, SCATTER, NoiseModel, VarianceComponents
from tumble.inference.problem import (
    LEAST_FIELD,
    LEVER_COLUMNS,
    MAGNETIC_ROWS,
    SUPPORT_COLUMNS,
    Point,
    Problem,
    bases,
    noise_model,
    support_columns,
    unknown_earth_variance,
)
from tumble.inference.variables import GROWING
from tumble.reduction.turns.links import PARTS, joined_parts, noise_of_links
from tumble.rotation import UP, rotation_matrix, rotation_vector, skew
from tumble.sensors.instrument import functions
from tumble.sensors.model import Block, left_null_space
from tumble.sensors.parameters import CONSTANT, FORCE, OWN_CUBE, OWN_SIZE, PAIRS, PRODUCTS, RATE
from tumble.units import Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Linearisation:
    """Residuals and Jacobians of a problem at a point, SI, not whitened.

    Parameters
    ----------
    problem, point, about
        The problem, the point, and the turns integrated about parameters near it, None without turns.
    rest : (N, r, 3 + p + q + 1)
        Rows of the rests: coefficients of the three angles of the attitude, of p = 1 + m numbers, gravity and the
        common parameters, and of the q parameters of a session; then the residual, observed less predicted.
    turn : (K, t, 6 + p + q + 1)
        Rows of the turns: angles of the rest before and of the rest after, then as above.
    bias : (K, t, n)
        Coefficients of the turns for a bias, during the turn, of the accelerometers and then of the gyros.
    growing : (K, t, c)
        Columns of the turns for the c changes of parameters, if they grow by 1 per second about the middle of the turn.
    link : (J, l, 18 + p + q + 1)
        Rows of the links: angles and velocities of the station before and of that after, displacements of both, then as
        above. l is 9, or 12 with a magnetometer, whose readings at the node before are the last three.
    link_bias : (J, l, n)
        As `bias`.
    gained : (K, 3)
        Velocity, m/s, that gravity gives the turns, in the body at their start.
    prior : (p + 1, p + 1)
        Whitened prior of gravity and the parameters: a triangle with the residual in the last column.
    local_prior : (S, q)
        Whitened residuals of the priors of the parameters of each session.
    array : (R, p + 1)
        Whitened rows of the motion of arrays (`tumble.inference.array_levers`), which `prior` contains.
    noise
        Noise of the rows, with its components of variance.
    """

    problem: Problem
    point: Point
    about: IntegratedTurns | None
    rest: Array
    turn: Array
    bias: Array
    growing: Array
    link: Array
    link_bias: Array
    gained: Array
    prior: Array
    local_prior: Array
    array: Array
    noise: NoiseModel

    @property
    def components(self) -> VarianceComponents:
        """Components of variance."""
        return self.noise.components

    @property
    def residuals(self) -> tuple[Array, Array]:
        """Residuals, observed less predicted, of the rests (N, r) and of the turns (K, t)."""
        return self.rest[..., -1], self.turn[..., -1]

    @property
    def headings(self) -> Array:
        """Coefficients (N, r) of the rests for their heading."""
        return np.asarray(self.rest[..., 2])

    @property
    def rotations(self) -> Array:
        """Rotations (K, 3, 3) of the turns, body at the end → body at the start, with the parameters of the point."""
        about, changes = self.about, self.problem.coefficient_changes(self.point)
        assert about is not None
        return about.rotations(self.problem.instrument, self.point.values, 0.0 if changes is None else changes)

    @cached_property
    def ordered(self) -> tuple[Array, Array, Array]:
        """Rows of rests, turns and links with their columns in the order of the elimination.

        First the unknowns of each station of the row (angles, velocities of a moving device, biases, SI, and
        displacements), then the parameters of the session, gravity, the common parameters, and the residual."""
        problem, q, n = self.problem, self.local_prior.shape[-1], self.bias.shape[2]
        v = 3 if problem.moves else 0

        def zeros(rows: Array) -> Array:
            return np.zeros((*rows.shape[:2], v))

        def common(rows: Array, first: int) -> tuple[Array, Array, Array]:
            last = rows.shape[2] - 1 - q
            return rows[:, :, last:-1], rows[:, :, first:last], rows[:, :, -1:]

        rest, turn, link = self.rest, self.turn, self.link
        biases = np.broadcast_to(np.eye(rest.shape[1], n), (*rest.shape[:2], n))
        rest = np.concatenate([rest[:, :, :3], zeros(rest), biases, zeros(rest), *common(rest, 3)], axis=2)
        parts = list[Array]()
        for angles, share in ((turn[:, :, :3], 1.0 - problem.bias_after), (turn[:, :, 3:6], problem.bias_after)):
            parts += [angles, zeros(turn), share * self.bias, zeros(turn)]
        turn = np.concatenate([*parts, *common(turn, 6)], axis=2)
        if not problem.moves:
            return rest, turn, np.zeros((0, 9, turn.shape[2]))
        bias = 0.5 * self.link_bias
        before, after = (
            [link[:, :, first : first + 6], bias, link[:, :, 12 + first // 2 : 15 + first // 2]] for first in (0, 6)
        )
        return rest, turn, np.concatenate([*before, *after, *common(link, 18)], axis=2)

    def _changed(self, **fields: Any) -> Linearisation:
        """Return the linearisation with other fields that do not change `ordered`, which is computed once."""
        self.ordered  # noqa: B018
        out = object.__new__(Linearisation)
        vars(out).update(vars(self) | fields)
        return out

    def with_components(self, components: VarianceComponents) -> Linearisation:
        """Return the linearisation with other components of variance."""
        return self._changed(noise=self.noise.at(components))

    def with_priors(self, problem: Problem) -> Linearisation:
        """Return the linearisation with the priors of a problem."""
        return self._changed(
            problem=problem,
            prior=prior_rows(problem, self.point, self.array),
            local_prior=-self.point.local / problem.local_u[..., None, :],
        )

    def at_lags(self, problem: Problem, values: Array) -> Linearisation:
        """Return the linearisation with other thermometer lags, to first order in the changes with temperature.

        Parameters
        ----------
        problem
            The problem with these lags held (`Problem.with_lags`).
        values : (m,)
            The parameters, lags included.
        """
        point, (changes, base) = replace(self.point, values=values), problem.change_columns
        regressors, rest, turn = problem.with_lags_at(point).regressors, self.rest.copy(), self.turn.copy()
        for place, rows, first in ((0, rest, 4), (1, turn, 7)):
            columns = regressors[place][:, None] * rows[:, :, first + base]
            if place == 1:
                columns += regressors[GROWING][:, None] * self.growing
            less = (rows[:, :, first + changes] - columns) @ problem.change_values(point, place)[:, :, None]
            rows[:, :, -1] += less[:, :, 0]
            rows[:, :, first + changes] = columns
        prior = prior_rows(problem, point, self.array)
        return replace(self, problem=problem, point=point, rest=rest, turn=turn, prior=prior)

    def with_columns(self, rest: Array, turn: Array) -> Linearisation:
        """Return the linearisation with c further common parameters without prior, after those of the instrument.

        Their columns are `rest` (N, r, c) and `turn` (K, t, c)."""
        before, c = -1 - self.local_prior.shape[1], rest.shape[2]
        wide_rest, wide_turn, wide_link = (
            np.concatenate([rows[..., :before], columns, rows[..., before:]], axis=2)
            for rows, columns in (
                (self.rest, rest),
                (self.turn, turn),
                (self.link, np.zeros((*self.link.shape[:2], c))),
            )
        )
        p = len(self.prior) - 1
        prior = np.zeros((p + c + 1, p + c + 1))
        keep = np.append(np.arange(p), p + c)
        prior[np.ix_(keep, keep)] = self.prior
        array = np.concatenate([self.array[:, :p], np.zeros((len(self.array), c)), self.array[:, p:]], axis=1)
        return replace(self, rest=wide_rest, turn=wide_turn, link=wide_link, prior=prior, array=array)


def linearise(
    problem: Problem, point: Point, about: IntegratedTurns | None, components: VarianceComponents = NO_COMPONENTS
) -> Linearisation:
    """Return the residuals of a problem, their Jacobians and their noise at a point.

    Parameters
    ----------
    problem, point
        The problem, and the point about which it is linearised.
    about
        The turns integrated about parameters near the point; None without turns.
    components
        Components of variance.
    """
    lagged = problem.with_lags_at(point)
    model = problem.instrument.linearised(point.values)
    turn = np.zeros((0, problem.rows_of_turn, 8 + problem.width))
    bias = np.zeros((0, problem.rows_of_turn, problem.sensors))
    growing = np.zeros((0, problem.rows_of_turn, len(problem.change_columns[0])))
    gained = np.zeros((0, 3))
    link, link_bias = np.zeros((0, 9, 20 + problem.width)), np.zeros((0, 9, problem.sensors))
    noise = problem.noise
    if about is not None:
        turn, bias, growing = _turn_rows(lagged, point, about, model)
        if about.links is not None:
            link, link_bias, noise = _link_rows(lagged, point, about.links, model)
    arrays = [array.rows(problem.instrument, point.values) for array in (() if about is None else about.arrays)]
    array = np.concatenate([np.zeros((0, 1 + len(point.values))), *arrays])
    array = np.insert(array, 0, 0.0, axis=1)
    if (turns := problem.observations.turns) is not None:
        gained = point.gravity * turns.duration[:, None] * (UP @ point.attitudes[problem.before_turn])
    return Linearisation(
        problem=problem,
        point=point,
        about=about,
        rest=_rest_rows(lagged, point, model),
        turn=turn,
        bias=bias,
        growing=growing,
        link=link,
        link_bias=link_bias,
        gained=gained,
        prior=prior_rows(problem, point, array),
        local_prior=-point.local / problem.local_u[..., None, :],
        array=array,
        noise=noise_model(problem, noise, gained).at(components),
    )


def _rest_rows(problem: Problem, point: Point, model: tuple[Array, Array]) -> Array:
    """Return the rows of the readings ŷ − Σ K β (4), of the prior of attitudes, and of a magnetometer."""
    instrument, rests, n = problem.instrument, problem.observations.rests, problem.sensors
    L = point.attitudes[problem.station]
    f, w = point.gravity * L[:, 1], problem.earth @ L
    basis, m = bases(L), len(point.values)
    turned = skew(f) @ basis, skew(w) @ basis  # ∂f/∂δ and ∂ω/∂δ
    # exact derivatives by heading: a rounding error would tie the free heading to a direction of the biases
    turned[0][:, :, 2], turned[1][:, :, 2] = 0.0, -problem.earth[0] * basis[:, :, 1]
    attitude = slice(n, n + 3 * (problem.prior.attitude is not None))
    rows = np.zeros((len(L), attitude.stop + 3 * (problem.magnetometer is not None), 5 + problem.width))
    first = 0
    for block, observed in zip(instrument.blocks, (rests.accel, rests.gyro), strict=False):
        at, used, first = slice(first, first + block.size), instrument.used[block.kind], first + block.size
        K, D, beta = model[0][at], model[1][at][:, used], functions(block, f, w)
        by_force, by_rate = _slopes(block, K, f, w)
        rows[:, at, :3] = by_force @ turned[0] + by_rate @ turned[1]
        if problem.observations.site.gravity_u > 0.0:
            rows[:, at, 3] = (by_force @ L[:, 1, :, None])[:, :, 0]
        rows[:, at, 4 : 4 + m] = np.swapaxes(np.swapaxes(beta[:, :, used], 0, 1) @ D, 0, 1)
        rows[:, at, -1] = observed - (beta * K).sum(axis=2)
    _add_changes(problem, point, rows[:, :n], 4, 0)
    if problem.prior.attitude is not None:
        rows[:, attitude] = _attitude_rows(problem, point)
    if problem.magnetometer is not None:
        assert rests.magnetometer is not None
        magnetic = rows[:, attitude.stop :]
        expected, magnetic[:, :, :3], magnetic[:, :, 4 + m : 4 + m + MAGNETIC] = problem.magnetometer.rows(
            point.local[0, :MAGNETIC], L, basis, np.zeros_like(f)
        )
        magnetic[:, :, -1] = rests.magnetometer - expected
    return rows


def _slopes(block: Block, K: Array, f: Array, w: Array) -> tuple[Array, Array]:
    """Return derivatives (N, n, 3) of the readings of a block by specific forces and by rates (N, 3)."""
    square = np.zeros((len(K), 3, 3))
    for (k, other), column in zip(PAIRS, K[:, PRODUCTS].T, strict=True):
        square[:, k, other] += column
        square[:, other, k] += column
    by_force = K[:, FORCE] + np.swapaxes(f @ square, 0, 1)
    by_rate = np.broadcast_to(K[:, RATE], by_force.shape)
    measured = (f if block.kind == "accel" else w) @ block.axes.T
    along = (K[:, OWN_SIZE] * np.sign(measured) + 3.0 * K[:, OWN_CUBE] * measured**2)[:, :, None] * block.axes
    return (by_force + along, by_rate) if block.kind == "accel" else (by_force, by_rate + along)


def _add_changes(
    problem: Problem, point: Point, rows: Array, first: int, place: int, growing: Array | None = None
) -> None:
    """Fill in the columns of changes with time, temperature or launch, and subtract the changes from the residuals.

    The columns, among those of parameters that begin at `first`, are those of the changed parameters times the
    regressors at rest (`place` 0) or in the turns (1), and `growing` (K, r, m) times the growth in the turns."""
    changes, base = problem.change_columns
    if not len(changes):
        return
    values = problem.change_values(point, place)[:, :, None]
    columns = problem.regressors[place][:, None] * rows[:, :, first + base]
    if growing is not None:
        columns = columns + problem.regressors[GROWING][:, None] * growing[:, :, base]
    rows[:, :, first + changes] = columns
    rows[:, :, -1] -= (columns @ values)[:, :, 0]


def at_reference(linearisation: Linearisation) -> Array:
    """Return accelerometer readings (N, n) at rest without their changes by temperature, time and launch."""
    problem, accel = linearisation.problem, linearisation.problem.observations.rests.accel
    columns = linearisation.rest[:, : accel.shape[1], 4 + problem.change_columns[0]]
    return np.asarray(accel - (columns @ problem.change_values(linearisation.point, 0)[:, :, None])[:, :, 0])


def _turn_rows(
    problem: Problem, point: Point, about: IntegratedTurns, model: tuple[Array, Array]
) -> tuple[Array, Array, Array]:
    """Return rows of the turns, (13), (14) and spare gyros, their coefficients for biases, and `growing` columns."""
    turns, instrument, g = problem.observations.turns, problem.instrument, point.gravity
    assert turns is not None
    columns = about.rows(instrument, point.values, model, problem.width)
    G = None if about.growing is None else along_paths(about.growing, model[1])
    _add_changes(problem, point, columns, 0, 1, G)
    (spare, free), t = _spare_rows(problem, point, about, model), 6 if instrument.in_velocities else 3
    rows = np.zeros((len(turns), problem.rows_of_turn, 8 + problem.width))
    bias, by_bias = np.zeros((len(turns), problem.rows_of_turn, problem.sensors)), about.paths[..., CONSTANT]

    before = problem.before_turn
    phi, start, end = columns[:, :3, -1], point.attitudes[before], point.attitudes[before + 1]
    C, basis = rotation_matrix(phi) @ about.C, bases(start)
    r = rotation_vector(C @ np.swapaxes(end, 1, 2) @ problem.earth_turned @ start)
    left = inverse_left_jacobian(r)
    by_rotation = left @ left_jacobian(phi)
    rows[:, :3, :3] = -np.swapaxes(left, 1, 2) @ basis
    rows[:, :3, 3:6] = left @ C @ bases(end)
    rows[:, :3, 7:-1], rows[:, :3, -1] = by_rotation @ columns[:, :3, :-1], r
    bias[:, :3] = by_rotation @ by_bias[:, :3]
    if instrument.in_velocities:  # ∫ e^{[Ω×]s} ds = T (I + [x×]/2 + [x×]²/6), x = Ω T
        x = skew(turns.duration[:, None] * problem.earth)
        gained = g * turns.duration[:, None] * UP
        rows[:, 3:6, :3], predicted = _by_gravity(start, basis, gained, x / 2.0 + x @ x / 6.0)
        rows[:, 3:6, 6] = predicted / g
        rows[:, 3:6, 7:-1], rows[:, 3:6, -1] = columns[:, 3:, :-1], columns[:, 3:, -1] - predicted
        bias[:, 3:6] = by_bias[:, 3:]
    if problem.observations.site.gravity_u == 0.0:
        rows[:, :, 6] = 0.0
    growing = np.zeros((*rows.shape[:2], len(problem.change_columns[1])))
    if G is not None:
        G = G[:, :, problem.change_columns[1]]
        growing[:, :3], growing[:, 3:t] = by_rotation @ G[:, :3], G[:, 3:t]
    rows[:, t:, 7:] = spare
    bias[:, t:, instrument.accel.size :] = turns.duration[:, None, None] * free
    return rows, bias, growing


def _by_gravity(start: Array, basis: Array, gained: Array, sideways: Array) -> tuple[Array, Array]:
    """Return the derivatives (K, 3, 3) by the angles at the `start`, and the value (K, 3), of an increment by gravity.

    The increment in the body at the `start` (K, 3, 3) is Lᵀ (1 + sideways) gained, `gained` (K, 3) being vertical and
    `sideways` (K, 3, 3) the effect of the Earth's rotation, the only part that depends on the heading."""
    turned = (sideways @ gained[:, :, None])[:, :, 0]
    vertical, level = ((each[:, None] @ start)[:, 0] for each in (gained, turned))
    derivatives = np.concatenate([skew(vertical + level) @ basis[:, :, :2], skew(level) @ basis[:, :, 2:]], axis=2)
    return derivatives, vertical + level


def _link_rows(
    problem: Problem, point: Point, parts: IntegratedTurns, model: tuple[Array, Array]
) -> tuple[Array, Array, NoiseModel]:
    """Return the rows of the links, their coefficients for biases, and the noise of the problem with that of the links.

    With v the velocity in the body, s the displacement and r the lever, the residuals of rotation, velocity and
    position are

        log(C L_jᵀ e^{−[Ω×]T} L_i)
        V − C v_j + v_i − L_iᵀ ∫ e^{[Ω×]s} g e_U ds
        P − (C − 1) r − L_iᵀ (s_j − s_i) + v_i T − L_iᵀ ∬ e^{[Ω×]s} g e_U ds²

    Coriolis forces are left out: they are below 5 µg at velocities of a hand. At a rest the velocity is zero, and
    positions are not compared, because a device is put down anywhere. The support bends by `support_columns`, whose
    derivatives by the attitude are left out."""
    links, instrument = problem.observations.links, problem.instrument
    assert links is not None
    i, T, J = links.before, links.duration, len(links)
    columns = parts.rows(instrument, point.values, model, problem.width)
    columns = np.concatenate([columns[:, :, :-1], parts.paths[..., CONSTANT], columns[:, :, -1:]], axis=2)
    moments = parts.moments
    columns, C_p, V_p, P_p, T_p = (
        x.reshape(J, PARTS, *x.shape[1:]) for x in (columns, moments.C, moments.V, moments.P, moments.T)
    )
    total = joined_parts(columns, C_p, V_p, P_p, T_p)
    C, start, end, basis = total.C, point.attitudes[i], point.attitudes[i + 1], bases(point.attitudes[i])
    moves = np.ones((len(point.attitudes), 1))
    moves[problem.station] = 0.0
    v_i, v_j = (moves * point.velocities)[i], (moves * point.velocities)[i + 1]
    support = np.diff(support_columns(point.attitudes), axis=0)[i]
    lever, bending = np.split(point.local[0, -LEVER_COLUMNS - SUPPORT_COLUMNS :], [LEVER_COLUMNS])
    free = np.where(links.free, 1.0, 0.0)[:, None, None]
    apart = (np.swapaxes(start, 1, 2) @ (point.displacements[i + 1] - point.displacements[i])[:, :, None])[:, :, 0]
    turned = (C @ v_j[:, :, None])[:, :, 0]
    columns, by_rotation = total.columns.copy(), total.columns[:, :3]
    columns[:, 3:6] += skew(turned) @ by_rotation
    columns[:, 6:] += skew(C @ lever) @ by_rotation

    r = rotation_vector(C @ np.swapaxes(end, 1, 2) @ rotation_matrix(-T[:, None] * problem.earth) @ start)
    left, rows = inverse_left_jacobian(r), np.zeros((J, 9, 20 + problem.width))
    columns[:, :3] = left @ by_rotation
    rows[:, :3, :3], rows[:, :3, 6:9], rows[:, :3, -1] = -np.swapaxes(left, 1, 2) @ basis, left @ C @ bases(end), r
    x, up = skew(T[:, None] * problem.earth), point.gravity * T[:, None] * UP
    for at, gained, sideways in (
        (slice(3, 6), up, x / 2.0 + x @ x / 6.0),
        (slice(6, 9), 0.5 * T[:, None] * up, x / 3.0 + x @ x / 12.0),
    ):
        rows[:, at, :3], predicted = _by_gravity(start, basis, gained, sideways)
        if problem.observations.site.gravity_u > 0.0:
            rows[:, at, 18] = predicted / point.gravity
        rows[:, at, -1] = -predicted
    rows[:, 3:6, 3:6], rows[:, 3:6, 9:12] = -moves[i, :, None] * np.eye(3), moves[i + 1, :, None] * C
    rows[:, 3:6, -1] += total.V - turned + v_i
    rows[:, 6:, :2] += skew(apart) @ basis[:, :, :2]  # zero by heading: displacements turn with it
    rows[:, 6:, 3:6] = -T[:, None, None] * np.eye(3)
    rows[:, 6:, 12:15], rows[:, 6:, 15:18] = -np.swapaxes(start, 1, 2), np.swapaxes(start, 1, 2)
    rows[:, 6:, -1] += total.P - (C @ lever) + lever + v_i * T[:, None]
    rows[:, :, 19 : 19 + problem.width] += columns[:, :, : problem.width]
    support = np.swapaxes(start, 1, 2) @ support
    rows[:, 6:, -1] -= support @ bending
    rows[:, 6:, -1 - LEVER_COLUMNS - SUPPORT_COLUMNS : -1 - SUPPORT_COLUMNS], rows[:, 6:, -1 - SUPPORT_COLUMNS : -1] = (
        C - np.eye(3),
        support,
    )
    rows[:, 6:] *= free
    bias = columns[:, :, problem.width :]
    bias[:, 6:] *= free
    if problem.magnetometer is not None:
        magnetic = _magnetic_link_rows(problem, problem.magnetometer, point, basis)
        rows, bias = (
            np.concatenate([a, b], axis=1) for a, b in ((rows, magnetic), (bias, np.zeros((J, 3, bias.shape[2]))))
        )
    roots = noise_of_links(C_p, V_p, P_p, T_p, (links.gyro_density, links.accel_density))
    return rows, bias, _with_link_noise(problem, np.concatenate(roots, axis=2))


def _magnetic_link_rows(problem: Problem, magnetometer: Magnetometer, point: Point, basis: Array) -> Array:
    """Return the rows (J, 3, ·) of magnetometer readings at the node before each link; zero without a reading."""
    links = problem.observations.links
    assert links is not None
    rows = np.zeros((len(links), 3, 20 + problem.width))
    if links.magnetometer is None:
        return rows
    first = 19 + len(point.values)
    expected, rows[:, :, :3], rows[:, :, first : first + MAGNETIC] = magnetometer.rows(
        point.local[0, :MAGNETIC], point.attitudes[links.before], basis, links.rates[::PARTS, 0]
    )
    rows[:, :, -1] = links.magnetometer - expected
    rows[~links.magnetic] = 0.0
    return rows


def _with_link_noise(problem: Problem, Z: Array) -> NoiseModel:
    """Return the noise of a problem with that of its links, by a root Z (J, 9, ·) of their covariance.

    Z has columns for gyros, then for accelerometers; both are also directions of components of variance."""
    links = problem.observations.links
    assert links is not None
    Z[~links.free, 6:] = 0.0
    N, places = Z @ np.swapaxes(Z, 1, 2), np.repeat([SCATTER.index(name) for name in LINK_SCATTER], Z.shape[2] // 2)
    N[~links.free, 6:, 6:] = np.eye(3)
    N[:, :3, :3] += (links.duration**2 * unknown_earth_variance(problem))[:, None, None] * np.eye(3)
    if problem.magnetometer is not None:
        variance = links.magnetometer_variance + (LEAST_FIELD * problem.magnetometer.field) ** 2
        has_reading, wide = links.magnetic[:, None, None] * np.eye(3), np.zeros((len(N), 12, 12))
        wide[:, :9, :9], wide[:, MAGNETIC_ROWS, MAGNETIC_ROWS] = N, np.eye(3) + (variance - 1.0) * has_reading
        along = np.zeros((len(N), 12, Z.shape[2] + 3))
        along[:, :9, :-3], along[:, MAGNETIC_ROWS, -3:] = Z, has_reading
        N, Z, places = wide, along, np.append(places, 3 * [SCATTER.index("mag")])
    return replace(problem.noise, link=N, link_directions=(Z, places))


def left_jacobian(r: Array) -> Array:
    """Return J_l(r) (…, 3, 3) = I + (1 − cos a)/a² [r×] + (a − sin a)/a³ [r×]², a = |r|; by its series if small."""
    a, cross = np.linalg.norm(r, axis=-1)[..., None, None], skew(r)
    second, wide = 1.0 / 6.0 - a**2 / 120.0, a >= 1e-2
    np.divide(a - np.sin(a), a**3, out=second, where=wide)
    return np.asarray(np.eye(3) + 0.5 * np.sinc(0.5 * a / np.pi) ** 2 * cross + second * (cross @ cross))


def inverse_left_jacobian(r: Array) -> Array:
    """Return J_l⁻¹(r) (…, 3, 3) = I − [r×]/2 + (1/a² − 1/(2 a tan(a/2))) [r×]²; its transpose is J_r⁻¹(r)."""
    a, cross = np.linalg.norm(r, axis=-1)[..., None, None], skew(r)
    wide = np.where(a >= 1e-2, a, 1.0)
    second = np.where(a >= 1e-2, wide**-2 - 0.5 / (wide * np.tan(0.5 * wide)), 1.0 / 12.0 + a**2 / 720.0)
    return np.asarray(np.eye(3) - 0.5 * cross + second * (cross @ cross))


def _spare_rows(
    problem: Problem, point: Point, about: IntegratedTurns, model: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Return rows (K, n − 3, ·) of turns in the directions of n gyros that no rate explains, and these directions.

    The residual is ∫ (ŷ − Σ_b K_b β_b) dt over all functions b but the rate."""
    readings, gyro, turns = problem.observations.turn_readings, problem.instrument.gyro, problem.observations.turns
    assert gyro is not None
    assert turns is not None
    if readings is None:
        return np.zeros((len(turns), 0, 1 + problem.width)), np.zeros((0, gyro.size))
    K, D = (of[problem.instrument.accel.size :] for of in model)
    free, beta = left_null_space(K[:, RATE]), about.in_body(gyro.size)
    beta[..., CONSTANT], beta[..., RATE] = turns.duration[:, None], 0.0
    y = readings.integral - np.einsum("kpb,pb->kp", beta, K)
    beta[..., RATE] = (y @ np.linalg.pinv(K[:, RATE]).T)[:, None]
    rows = np.zeros((len(y), gyro.size, 1 + problem.width))
    rows[:, :, : len(point.values)] = np.einsum("kpb,pbm->kpm", beta, D)
    rows[:, :, -1] = y
    _add_changes(problem, point, rows, 0, 1)
    return free @ rows, free


def _attitude_rows(problem: Problem, point: Point) -> Array:
    """Return rows of log(Lᵀ L_nominal), or of the tilt if the programme is unordered and fixes only the vertical."""
    programme, position = problem.observations.programme, problem.observations.position
    assert programme is not None
    assert position is not None
    nominal = np.array([programme.positions[i].matrix for i in position])
    attitudes = point.attitudes[problem.station]
    basis = bases(attitudes)
    rows = np.zeros((len(nominal), 3, 5 + problem.width))
    if programme.ordered:
        e = rotation_vector(np.swapaxes(attitudes, 1, 2) @ nominal)
        rows[:, :, :3] = inverse_left_jacobian(e) @ basis
        rows[:, :, -1] = e
    else:
        across = -attitudes[:, [2, 0]]
        rows[:, :2, :3] = -np.cross(nominal[:, None, 1], across) @ basis
        rows[:, :2, -1] = np.einsum("iab,ib->ia", across, nominal[:, 1])
    return rows


def prior_rows(problem: Problem, point: Point, array: Array) -> Array:
    """Return the whitened priors of gravity and the parameters, with the rows (R, p + 1) of arrays, as a triangle."""
    expected, u = problem.prior_mean.copy(), problem.prior_u
    expected[0] -= point.gravity
    expected[1:] -= point.values
    rows, i = np.swapaxes(np.zeros((*u.shape[:-1], u.shape[-1] + 1, u.shape[-1] + 1)), -1, -2), np.arange(u.shape[-1])
    if problem.prior.covariance is None:
        weight = np.divide(1.0, u, out=np.zeros_like(u), where=u > 0.0)
        rows[..., i, i], rows[..., :-1, -1] = weight, weight * expected
    else:
        rows[..., :-1, :-1] = root_of_inverse(problem.prior.covariance)
        rows[..., :-1, -1] = rows[..., :-1, :-1] @ expected
    if len(array):
        for at in np.ndindex(u.shape[:-1]):
            fold(array.copy(), rows[at])
    return rows


def root_of_inverse(covariance: Array) -> Array:
    """Return the triangle W with WᵀW = C⁻¹; rows of exact quantities are zero."""
    uncertain = np.flatnonzero(np.diag(covariance) > 0.0)
    index = np.ix_(uncertain, uncertain)
    size = np.sqrt(np.diag(covariance)[uncertain])
    lower = np.linalg.cholesky(covariance[index] / np.outer(size, size))
    out = np.zeros_like(covariance)
    out[index] = np.linalg.qr(np.linalg.inv(lower), mode="r") / size
    return out
