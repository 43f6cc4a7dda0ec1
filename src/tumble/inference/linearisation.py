"""Residuals of the likelihood and their Jacobians, in closed form, at a point.

The residuals are those of `tumble.inference.problem`, docs/explanation/mathematics.md (4), (13) and (15).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from tumble.inference.elimination import fold
from tumble.inference.integrated_turns import IntegratedTurns, along_paths
from tumble.inference.magnetometer import OWN as MAGNETIC
from tumble.inference.noise import LINK_SCATTER, NO_COMPONENTS, SCATTER, NoiseModel, RowNoise, VarianceComponents
from tumble.inference.problem import (
    LEVER_COLUMNS,
    SUPPORT_COLUMNS,
    Point,
    Problem,
    bases,
    support_columns,
    unknown_earth_variance,
    with_errors_of_velocity,
)
from tumble.inference.variables import GROWING
from tumble.reduction.turns.links import PARTS, Increments, joined_parts, noise_of_links
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
    problem, point, integrated
        The problem, the point, and the turns, integrated at parameters near the point; None without turns.
    rows : (K, r, ·)
        Rows by kind: coefficients of the unknowns of their stations and of the shared unknowns, and the residual,
        observed less predicted. Columns are those of `Problem.zero_rows`.
    growing : (K, t, c)
        Columns of the turns for the c changes of parameters, if they grow by 1 per second about the middle of the turn;
        None if no parameter does.
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
    integrated: IntegratedTurns | None
    rows: Mapping[str, Array]
    growing: Array | None
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
        """Residuals, observed less predicted, of the readings at rest (N, n) and of the turns (K, t)."""
        at_rest = [self.rows[block.kind][..., -1] for block in self.problem.instrument.blocks]
        return np.concatenate(at_rest, axis=1), self.rows["turn"][..., -1]

    @property
    def bias(self) -> Array:
        """Coefficients (K, t, n) of the turns for a bias during the turn, of accelerometers and then of gyros."""
        columns, turn, d = self.problem.bias_columns, self.rows["turn"], self.problem.station_columns
        return np.asarray(turn[:, :, columns] + turn[:, :, columns.start + d : columns.stop + d])

    @property
    def rotations(self) -> Array:
        """Rotations (K, 3, 3) of the turns, body at the end → body at the start, with the parameters of the point."""
        integrated, changes = self.integrated, self.problem.coefficient_changes(self.point)
        assert integrated is not None
        return integrated.rotations(self.problem.instrument, self.point.values, 0.0 if changes is None else changes)

    def again(self, problem: Problem, point: Point) -> Linearisation:
        """Linearise a problem at a point with the same integrated turns and the same weights of the rows."""
        there = linearise(problem, point, self.integrated)
        return replace(there, noise=there.noise.weighted(self.noise.weights))

    def with_components(self, components: VarianceComponents) -> Linearisation:
        """Return the linearisation with other components of variance."""
        return replace(self, noise=replace(self.noise, components=components))

    def with_priors(self, problem: Problem) -> Linearisation:
        """Return the linearisation with the priors of a problem."""
        return replace(
            self,
            problem=problem,
            prior=prior_rows(problem, self.point, self.array),
            local_prior=-self.point.local / problem.local_u[..., None, :],
        )

    def with_lags(self, problem: Problem, values: Array) -> Linearisation:
        """Return the linearisation with other thermometer lags, to first order in the changes with temperature.

        Parameters
        ----------
        problem
            The problem with these lags held (`Problem.with_held_lags`).
        values : (m,)
            The parameters, lags included.
        """
        point, rows = replace(self.point, values=values), dict(self.rows)
        lagged, columns = problem.with_lagged_temperatures(point), problem.columns_of(problem.change_columns[0])
        for kind in rows.keys() & {"accel", "gyro", "turn"}:
            rows[kind] = changed = rows[kind].copy()
            changes = problem.change_values(point, problem.first_station[kind])
            changed[:, :, -1] += (changed[:, :, columns] @ changes[:, :, None])[:, :, 0]
            _add_changes(lagged, point, changed, int(kind == "turn"), self.growing if kind == "turn" else None)
        return replace(self, problem=problem, point=point, rows=rows, prior=prior_rows(problem, point, self.array))

    def with_columns(self, rest: Array, turn: Array) -> Linearisation:
        """Return the linearisation with c further common parameters without prior, after those of the instrument.

        Their columns are `rest` (N, n, c) of the readings at rest and `turn` (K, t, c)."""
        p, c, n = len(self.prior) - 1, rest.shape[2], self.problem.instrument.accel.size
        columns, rows = {"accel": rest[:, :n], "gyro": rest[:, n:], "turn": turn}, dict[str, Array]()
        for kind, before in self.rows.items():
            added = columns.get(kind, np.zeros((*before.shape[:2], c)))
            rows[kind] = np.concatenate([before[:, :, :-1], added, before[:, :, -1:]], axis=2)
        prior = np.zeros((p + c + 1, p + c + 1))
        keep = np.append(np.arange(p), p + c)
        prior[np.ix_(keep, keep)] = self.prior
        array = np.concatenate([self.array[:, :p], np.zeros((len(self.array), c)), self.array[:, p:]], axis=1)
        return replace(self, rows=rows, prior=prior, array=array)


def linearise(
    problem: Problem, point: Point, integrated: IntegratedTurns | None, components: VarianceComponents = NO_COMPONENTS
) -> Linearisation:
    """Return the residuals of a problem, their Jacobians and their noise at a point.

    Parameters
    ----------
    problem, point
        The problem, and the point about which it is linearised.
    integrated
        The turns, integrated at parameters near the point; None without turns.
    components
        Components of variance.
    """
    lagged = problem.with_lagged_temperatures(point)
    model, noise = problem.instrument.linearised(point.values), problem.noise
    rows, of_rows = _rows_at_stations(lagged, point, model), dict(noise.rows)
    rows["turn"], growing = problem.zero_rows("turn", problem.rows_of_turn), None
    of_rows["turn"] = with_errors_of_velocity(problem, noise.rows["turn"], gained_in_turns(problem, point))
    if integrated is not None:
        rows["turn"], growing = _turn_rows(lagged, point, integrated, model)
        if integrated.links is not None:
            rows["link"], of_rows["link"] = _link_rows(lagged, point, integrated.links, model)
    arrays = [
        array.rows(problem.instrument, point.values) for array in (() if integrated is None else integrated.arrays)
    ]
    array = np.concatenate([np.zeros((0, 1 + len(point.values))), *arrays])
    array = np.insert(array, 0, 0.0, axis=1)
    return Linearisation(
        problem=problem,
        point=point,
        integrated=integrated,
        rows=rows,
        growing=growing,
        prior=prior_rows(problem, point, array),
        local_prior=-point.local / problem.local_u[..., None, :],
        array=array,
        noise=replace(noise, rows=of_rows, components=components),
    )


def gained_in_turns(problem: Problem, point: Point) -> Array:
    """Return the velocity (K, 3), m/s, that gravity gives the turns, in the body at their start."""
    turns, start = problem.observations.turns, point.attitudes[problem.before_turn]
    return np.zeros((0, 3)) if turns is None else point.gravity * turns.duration[:, None] * (UP @ start)


def _rows_at_stations(problem: Problem, point: Point, model: tuple[Array, Array]) -> dict[str, Array]:
    """Return the rows of the readings ŷ − Σ K β (4), of the prior of attitudes, and of a magnetometer."""
    instrument, rests, biases = problem.instrument, problem.observations.rests, problem.bias_columns
    L, m, out = point.attitudes[problem.station], len(point.values), dict[str, Array]()
    f, w = point.gravity * L[:, 1], problem.earth @ L
    basis = bases(L)
    turned = skew(f) @ basis, skew(w) @ basis  # ∂f/∂δ and ∂ω/∂δ
    # exact derivatives by heading: a rounding error would tie the free heading to a direction of the biases
    turned[0][:, :, 2], turned[1][:, :, 2] = 0.0, -problem.earth[0] * basis[:, :, 1]
    first = 0
    for block, observed in zip(instrument.blocks, (rests.accel, rests.gyro), strict=False):
        at, used = slice(first, first + block.size), instrument.used[block.kind]
        rows = problem.zero_rows(block.kind, block.size)
        K, D, beta = model[0][at], model[1][at][:, used], functions(block, f, w)
        by_force, by_rate = _slopes(block, K, f, w)
        rows[:, :, :3] = by_force @ turned[0] + by_rate @ turned[1]
        rows[:, :, biases][:, :, at] = np.eye(block.size)
        if problem.observations.site.gravity_u > 0.0:
            rows[:, :, -2 - m] = (by_force @ L[:, 1, :, None])[:, :, 0]
        rows[:, :, -1 - m : -1] = np.swapaxes(np.swapaxes(beta[:, :, used], 0, 1) @ D, 0, 1)
        rows[:, :, -1] = observed - (beta * K).sum(axis=2)
        _add_changes(problem, point, rows, 0)
        out[block.kind], first = rows, at.stop
    if problem.prior.attitude is not None:
        out["attitude"] = _attitude_rows(problem, point)
    if problem.magnetometer is not None and (magnetic := problem.magnetic) is not None:
        out["mag"] = rows = problem.zero_rows("mag", 3)
        L, own = point.attitudes[magnetic.station], rows.shape[2] - 2 - m - len(problem.local_u)
        expected, rows[:, :, :3], rows[:, :, own : own + MAGNETIC] = problem.magnetometer.rows(
            point.local[0, :MAGNETIC], L, bases(L), magnetic.rates
        )
        rows[:, :, -1] = magnetic.values - expected
    return out


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


def _add_changes(problem: Problem, point: Point, rows: Array, place: int, growing: Array | None = None) -> None:
    """Fill in the columns of changes with time, temperature or launch, and subtract the changes from the residuals.

    The columns are those of the changed parameters times the regressors at rest (`place` 0) or in the turns (1), and
    `growing` (K, r, c) times the growth in the turns."""
    columns, base = map(problem.columns_of, problem.change_columns)
    if not len(columns):
        return
    rows[:, :, columns] = problem.regressors[place][:, None] * rows[:, :, base]
    if growing is not None:
        rows[:, :, columns] += problem.regressors[GROWING][:, None] * growing
    values = problem.change_values(point, problem.station if place == 0 else problem.before_turn)
    rows[:, :, -1] -= (rows[:, :, columns] @ values[:, :, None])[:, :, 0]


def at_reference(linearisation: Linearisation) -> Array:
    """Return accelerometer readings (N, n) at rest without their changes by temperature, time and launch."""
    problem = linearisation.problem
    columns = linearisation.rows["accel"][:, :, problem.columns_of(problem.change_columns[0])]
    changes = columns @ problem.change_values(linearisation.point, problem.station)[:, :, None]
    return np.asarray(problem.observations.rests.accel - changes[:, :, 0])


def _turn_rows(
    problem: Problem, point: Point, integrated: IntegratedTurns, model: tuple[Array, Array]
) -> tuple[Array, Array | None]:
    """Return the rows of the turns, (13) and (14), and of spare gyros, and the columns `Linearisation.growing`."""
    turns, instrument, v = problem.observations.turns, problem.instrument, 6 if problem.instrument.in_velocities else 3
    assert turns is not None
    rows, growing = integrated.rows(instrument, point.values, model), None
    if integrated.growing is not None:
        growing = along_paths(integrated.growing, model[1])[:, :, problem.change_columns[1]]
    shared = np.concatenate([np.zeros((len(rows), 6, 1 + len(problem.local_u))), rows], axis=2)
    _add_changes(problem, point, shared, 1, growing)
    phi, (spare, free) = shared[:, :3, -1], _spare_rows(problem, point, integrated, model)
    by_turn = left_jacobian(phi)
    columns = np.concatenate([shared[:, :, :-1], integrated.paths[..., CONSTANT]], axis=2)
    columns[:, :3] = by_turn @ columns[:, :3]
    of_accel = np.zeros((*spare.shape[:2], instrument.accel.size))
    of_spare = np.concatenate([spare[:, :, :-1], of_accel, turns.duration[:, None, None] * free], axis=2)
    increments = Increments(
        C=rotation_matrix(phi) @ integrated.C,
        V=shared[:, 3:, -1],
        P=np.zeros((0, 3)),
        columns=np.concatenate([columns[:, :v], of_spare], axis=1),
    )
    out = _rows_of_increments(problem, point, "turn", increments, turns.duration)
    out[:, v:, -1] = spare[:, :, -1]
    if growing is not None:
        growing[:, :3] = inverse_left_jacobian(out[:, :3, -1]) @ by_turn @ growing[:, :3]
        growing = np.concatenate([growing[:, :v], np.zeros((*spare.shape[:2], growing.shape[2]))], axis=1)
    return out, growing


def _rows_of_increments(problem: Problem, point: Point, kind: str, increments: Increments, T: Array) -> Array:
    """Return the rows of turns or links of durations T (K,), (13) and (14), for stations without velocity.

    The `increments` have columns for the parameters of the session, gravity and the common parameters, and then for the
    biases."""
    C, columns, d = increments.C, increments.columns, problem.station_columns
    rows = problem.zero_rows(kind, columns.shape[1])
    first, shared, biases = problem.first_station[kind], columns.shape[2] - problem.sensors, problem.bias_columns
    rows[:, :, -1 - shared : -1] = columns[:, :, :shared]
    after = problem.bias_after if kind == "turn" else 0.5
    rows[:, :, biases] = (1.0 - after) * columns[:, :, shared:]
    rows[:, :, biases.start + d : biases.stop + d] = after * columns[:, :, shared:]

    start, end, basis = point.attitudes[first], point.attitudes[first + 1], bases(point.attitudes[first])
    r = rotation_vector(C @ np.swapaxes(end, 1, 2) @ rotation_matrix(-T[:, None] * problem.earth) @ start)
    left = inverse_left_jacobian(r)
    rows[:, :3] = left @ rows[:, :3]
    rows[:, :3, :3], rows[:, :3, d : d + 3] = -np.swapaxes(left, 1, 2) @ basis, left @ C @ bases(end)
    rows[:, :3, -1] = r

    def subtract_gravity(at: slice, observed: Array, gained: Array, by_earth: Array) -> None:
        """Fill in the rows of increments by gravity, Lᵀ (1 + `by_earth`) `gained` in the body at the start.

        `gained` (K, 3) is vertical, `by_earth` (K, 3, 3) the effect of the Earth's rotation, which alone depends on
        the heading."""
        vertical, added = ((each[:, None] @ start)[:, 0] for each in (gained, (by_earth @ gained[:, :, None])[:, :, 0]))
        predicted = vertical + added
        rows[:, at, :2], rows[:, at, 2:3] = skew(predicted) @ basis[:, :, :2], skew(added) @ basis[:, :, 2:]
        if problem.observations.site.gravity_u > 0.0:
            rows[:, at, -2 - len(point.values)] = predicted / point.gravity
        rows[:, at, -1] = observed - predicted

    # ∫ e^{[Ω×]s} ds = T (1 + [x×]/2 + [x×]²/6) and ∬ e^{[Ω×]s} ds² = T²/2 (1 + [x×]/3 + [x×]²/12), x = Ω T
    x, gained = skew(T[:, None] * problem.earth), point.gravity * T[:, None] * UP
    if kind == "link" or problem.instrument.in_velocities:
        subtract_gravity(slice(3, 6), increments.V, gained, x / 2.0 + x @ x / 6.0)
    if kind == "link":
        subtract_gravity(slice(6, 9), increments.P, 0.5 * T[:, None] * gained, x / 3.0 + x @ x / 12.0)
    return rows


def _link_rows(
    problem: Problem, point: Point, parts: IntegratedTurns, model: tuple[Array, Array]
) -> tuple[Array, RowNoise]:
    """Return the rows of the links, and their noise: the residuals (41) of rotation, velocity and position.

    Coriolis forces are left out: they are below 5 µg at velocities of a hand. At a rest the velocity is zero, and
    positions are not compared, because a device is put down anywhere. F are the `support_columns`, whose derivatives by
    the attitude are left out."""
    links, d = problem.observations.links, problem.station_columns
    assert links is not None
    i, T, J, by_part = links.before, links.duration, len(links), parts.rows(problem.instrument, point.values, model)
    by_part = np.concatenate([by_part[:, :, :-1], parts.paths[..., CONSTANT], by_part[:, :, -1:]], axis=2)
    moments = parts.moments
    by_part, C_p, V_p, P_p, T_p = (
        x.reshape(J, PARTS, *x.shape[1:]) for x in (by_part, moments.C, moments.V, moments.P, moments.T)
    )
    total = joined_parts(by_part, C_p, V_p, P_p, T_p)
    C, start, basis = total.C, point.attitudes[i], bases(point.attitudes[i])
    moves = np.ones((len(point.attitudes), 1))
    moves[problem.station] = 0.0
    v_i, v_j = (moves * point.velocities)[i], (moves * point.velocities)[i + 1]
    turned = (C @ v_j[:, :, None])[:, :, 0]
    lever, bending = np.split(point.local[0, -LEVER_COLUMNS - SUPPORT_COLUMNS :], [LEVER_COLUMNS])
    columns = np.concatenate([np.zeros((J, 9, 1 + len(problem.local_u))), total.columns], axis=2)
    columns[:, 3:6] += skew(turned) @ columns[:, :3]
    columns[:, 6:] += skew(C @ lever) @ columns[:, :3]
    rows = _rows_of_increments(problem, point, "link", replace(total, columns=columns), T)

    to_body = np.swapaxes(start, 1, 2)
    rows[:, 3:6, 3:6], rows[:, 3:6, d + 3 : d + 6] = -moves[i, :, None] * np.eye(3), moves[i + 1, :, None] * C
    rows[:, 3:6, -1] += v_i - turned
    apart = (to_body @ (point.displacements[i + 1] - point.displacements[i])[:, :, None])[:, :, 0]
    rows[:, 6:, :2] += skew(apart) @ basis[:, :, :2]  # zero by heading: displacements turn with it
    rows[:, 6:, 3:6] = -T[:, None, None] * np.eye(3)
    rows[:, 6:, d - 3 : d], rows[:, 6:, 2 * d - 3 : 2 * d] = -to_body, to_body
    support = to_body @ np.diff(support_columns(point.attitudes), axis=0)[i]
    end = -2 - len(point.values)
    rows[:, 6:, end - SUPPORT_COLUMNS : end] = support
    rows[:, 6:, end - SUPPORT_COLUMNS - LEVER_COLUMNS : end - SUPPORT_COLUMNS] = C - np.eye(3)
    rows[:, 6:, -1] += lever - C @ lever + v_i * T[:, None] - support @ bending
    rows[~links.free, 6:] = 0.0
    Z = np.concatenate(noise_of_links(C_p, V_p, P_p, T_p, (links.gyro_density, links.accel_density)), axis=2)
    return rows, _link_noise(problem, Z)


def _link_noise(problem: Problem, Z: Array) -> RowNoise:
    """Return the noise of links by a root Z (J, 9, ·) of their covariance.

    Z has columns for gyros, then for accelerometers; both are also directions of components of variance."""
    links = problem.observations.links
    assert links is not None
    Z[~links.free, 6:] = 0.0
    N, component = Z @ np.swapaxes(Z, 1, 2), np.repeat([SCATTER.index(name) for name in LINK_SCATTER], Z.shape[2] // 2)
    N[~links.free, 6:, 6:] = np.eye(3)
    N[:, :3, :3] += (links.duration**2 * unknown_earth_variance(problem))[:, None, None] * np.eye(3)
    return RowNoise(sources={"link.noise": N}, directions=Z, component=component, weight=np.ones(len(Z)))


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
    problem: Problem, point: Point, integrated: IntegratedTurns, model: tuple[Array, Array]
) -> tuple[Array, Array]:
    """Return rows (K, n − 3, ·) of turns in the directions of n gyros that no rate explains, without the columns of
    stations, and these directions.

    The residual is ∫ (ŷ − Σ_b K_b β_b) dt over all functions b but the rate."""
    readings, gyro, turns = problem.observations.turn_readings, problem.instrument.gyro, problem.observations.turns
    assert gyro is not None
    assert turns is not None
    shared, m = len(problem.local_u) + len(point.values) + 2, len(point.values)
    if readings is None:
        return np.zeros((len(turns), 0, shared)), np.zeros((0, gyro.size))
    K, D = (of[problem.instrument.accel.size :] for of in model)
    free, beta = left_null_space(K[:, RATE]), integrated.in_body(gyro.size)
    beta[..., CONSTANT], beta[..., RATE] = turns.duration[:, None], 0.0
    y = readings.integral - np.einsum("kpb,pb->kp", beta, K)
    beta[..., RATE] = (y @ np.linalg.pinv(K[:, RATE]).T)[:, None]
    rows = np.zeros((len(y), gyro.size, shared))
    rows[:, :, -1 - m : -1] = np.einsum("kpb,pbm->kpm", beta, D)
    rows[:, :, -1] = y
    _add_changes(problem, point, rows, 1)
    return free @ rows, free


def _attitude_rows(problem: Problem, point: Point) -> Array:
    """Return rows of log(Lᵀ L_nominal), or of the tilt if the programme is unordered and fixes only the vertical."""
    programme, position = problem.observations.programme, problem.observations.position
    assert programme is not None
    assert position is not None
    nominal = np.array([programme.positions[i].matrix for i in position])
    attitudes = point.attitudes[problem.station]
    basis = bases(attitudes)
    rows = problem.zero_rows("attitude", 3)
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
