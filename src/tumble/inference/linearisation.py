"""Residuals and Jacobians of the likelihood at a point (`tumble.inference.likelihood`): rows of rests and turns, which
loops write (`tumble.inference.row_loops`), of spare gyros, of attitudes known beforehand, and of the priors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tumble.inference.elimination import fold
from tumble.inference.likelihood import Point, Problem, Rows, bases
from tumble.inference.row_loops import add_rests, add_turns, inverse_left_jacobian
from tumble.inference.turns_about import TurnsAbout
from tumble.inference.variables import GROWING
from tumble.rotation import UP, rotation_vector
from tumble.sensors.model import beyond_body
from tumble.sensors.parameters import CONSTANT, RATE
from tumble.units import Array


def linearise(problem: Problem, point: Point, about: TurnsAbout | None) -> Rows:
    """Residuals and Jacobians at a point; `about` is None where there are no turns."""
    problem = problem.warmed(point)
    model = problem.instrument.linearised(point.values)
    turn = np.zeros((0, problem.rows_of_turn, 8 + problem.width))
    bias = np.zeros((0, problem.rows_of_turn, problem.sensors))
    if about is not None:
        turn, bias = _turn_rows(problem, point, about, model)
    return Rows(
        rest=_rest_rows(problem, point, model),
        turn=turn,
        prior=priors(problem, point, about),
        bias=bias,
        gained=_gained(problem, point),
        own=-point.own / problem.own_known,
    )


def _gained(problem: Problem, point: Point) -> Array:
    """The velocity (K, 3), m/s, that gravity gives the turns, in the body at their start."""
    turns = problem.observations.turns
    if turns is None:
        return np.zeros((0, 3))
    return np.asarray(point.gravity * turns.duration[:, None] * (UP @ point.attitudes[turns.first]))


def with_priors(rows: Rows, problem: Problem, point: Point, about: TurnsAbout | None = None) -> Rows:
    """The same rows with the priors of a problem."""
    return replace(rows, prior=priors(problem, point, about), own=-point.own / problem.own_known)


def _rest_rows(problem: Problem, point: Point, model: tuple[Array, Array]) -> Array:
    """ŷ − Σ K β of all sensors, and the prior of the attitudes."""
    instrument, (K, D), n = problem.instrument, model, 0
    rests, N = problem.observations.rests, len(point.attitudes)
    known = problem.prior.attitude is not None
    rows = np.zeros((N, len(K) + 3 * known, 5 + problem.width))
    about = point.attitudes, point.gravity * UP, problem.earth
    for kind, block in enumerate(instrument.blocks):
        last = n + block.size
        observed = rests.accel if kind == 0 else rests.gyro
        own = K[n:last], D[n:last], instrument.used[block.kind]
        add_rests(about, (block.axes, kind), own, observed, rows, n)
        n = last
    if problem.observations.site.gravity_u == 0.0:
        rows[:, :, 3] = 0.0
    _add_changes(problem, point, rows[:, :n], 4, 0)
    if known:
        rows[:, n:] = _attitude_rows(problem, point)
    return rows


def _add_changes(
    problem: Problem, point: Point, rows: Array, first: int, place: int, growing: Array | None = None
) -> None:
    """Fill in the columns of rows (·, r, ·), those of parameters from `first` on, of what changes with time,
    temperature or launch: those of its base times what it goes with, at rest (`place` 0) or in the turns (1); and that
    of the lag, which moves the temperatures. What they add is taken off the residuals. `growing` are the columns
    (K, r, m) of what grows by 1 a second about the middle of the turns."""
    own, base = problem.changed
    if not len(own):
        return
    values = problem.changes_in(point, place)[:, :, None]
    every = [(place, rows[:, :, first + base])] + ([] if growing is None else [(GROWING, growing[:, :, base])])
    by = sum(problem.goes[of][:, None] * columns for of, columns in every)
    rows[:, :, first + own] = by
    rows[:, :, -1] -= (by @ values)[:, :, 0]
    if problem.by_lag and problem.lag is not None:
        warmer = sum(problem.going(problem.by_lag, of)[:, None] * columns for of, columns in every)
        rows[:, :, first + problem.lag] += (warmer @ values)[:, :, 0]


def at_reference(problem: Problem, point: Point, rows: Rows) -> Array:
    """Readings (N, n) of the accelerometers at rest as they would be at the reference temperature, in the middle of a
    session and without what differs from launch to launch."""
    accel = problem.observations.rests.accel
    by = rows.rest[:, : accel.shape[1], 4 + problem.changed[0]]
    return np.asarray(accel - (by @ problem.changes_in(point, 0)[:, :, None])[:, :, 0])


def _turn_rows(problem: Problem, point: Point, about: TurnsAbout, model: tuple[Array, Array]) -> tuple[Array, Array]:
    """Rotation and velocity of the turns, what more than three gyros say of themselves, and the coefficients of all for
    a bias of the accelerometers and gyros."""
    turns, instrument = problem.observations.turns, problem.instrument
    assert turns is not None
    by = about.rows(instrument, point.values, model, problem.width)
    _add_changes(problem, point, by, 0, 1, about.growing_columns(model[1]))
    (spare, free), t = _spare_rows(problem, point, about, model), 6 if instrument.in_velocities else 3
    rows = np.zeros((len(turns), problem.rows_of_turn, 8 + problem.width))
    bias = np.zeros((len(turns), problem.rows_of_turn, about.paths.shape[2]))
    ends, turned = (point.attitudes, turns.first, turns.last), (about.C, turns.duration, problem.earth_turned)
    place = problem.earth, point.gravity, instrument.in_velocities
    add_turns(ends, turned, place, (by, about.paths[..., CONSTANT]), rows, bias)
    if problem.observations.site.gravity_u == 0.0:
        rows[:, :, 6] = 0.0
    rows[:, t:, 7:] = spare
    bias[:, t:, instrument.accel.size :] = turns.duration[:, None, None] * free
    return rows, bias


def _spare_rows(problem: Problem, point: Point, about: TurnsAbout, model: tuple[Array, Array]) -> tuple[Array, Array]:
    """What n gyros say of themselves: ∫ (ŷ − Σ_b K_b β_b) dt of all functions but the rate has nothing in the n − 3
    directions that no rate explains. Rows (K, n − 3, ·) of the parameters, and these directions."""
    readings, gyro, turns = problem.observations.turn_readings, problem.instrument.gyro, problem.observations.turns
    assert gyro is not None
    assert turns is not None
    if readings is None:
        return np.zeros((len(turns), 0, 1 + problem.width)), np.zeros((0, gyro.size))
    K, D = (of[problem.instrument.accel.size :] for of in model)
    free, beta = beyond_body(K[:, RATE]), about.in_body(gyro.size)
    beta[..., CONSTANT], beta[..., RATE] = turns.duration[:, None], 0.0
    y = readings.integral - np.einsum("kpb,pb->kp", beta, K)
    beta[..., RATE] = (y @ np.linalg.pinv(K[:, RATE]).T)[:, None]
    rows = np.zeros((len(y), gyro.size, 1 + problem.width))
    rows[:, :, : len(point.values)] = np.einsum("kpb,pbm->kpm", beta, D)
    rows[:, :, -1] = y
    _add_changes(problem, point, rows, 0, 1)
    return free @ rows, free


def _attitude_rows(problem: Problem, point: Point) -> Array:
    """log(Lᵀ L_nominal); of a programme in any order, where only the vertical is known, its tilt."""
    programme, position = problem.observations.programme, problem.observations.position
    assert programme is not None
    assert position is not None
    nominal = np.array([programme.positions[i].matrix for i in position])
    basis = bases(point.attitudes)
    rows = np.zeros((len(nominal), 3, 5 + problem.width))
    if programme.ordered:
        e = rotation_vector(np.swapaxes(point.attitudes, 1, 2) @ nominal)
        rows[:, :, :3] = inverse_left_jacobian(e) @ basis
        rows[:, :, -1] = e
    else:
        across = -point.attitudes[:, [2, 0]]
        rows[:, :2, :3] = -np.cross(nominal[:, None, 1], across) @ basis
        rows[:, :2, -1] = np.einsum("iab,ib->ia", across, nominal[:, 1])
    return rows


def priors(problem: Problem, point: Point, about: TurnsAbout | None = None) -> Array:
    """Measured gravity and the prior of the parameters, whitened: a triangle, of a diagonal and a right-hand side; with
    what arrays say of themselves in motion."""
    expected, u = problem.measured
    known = u > 0.0
    rows = np.zeros((len(u) + 1, len(u) + 1))
    if problem.prior.covariance is None:
        rows[np.arange(len(u)), np.arange(len(u))] = np.where(known, 1.0 / np.where(known, u, 1.0), 0.0)
    else:
        rows[:-1, :-1] = root_of_inverse(problem.prior.covariance)
    rows[:-1, -1] = rows[:-1, :-1] @ (expected - np.append(point.gravity, point.values))
    for array in () if about is None else about.arrays:
        fold(np.insert(array.rows(problem.instrument, point.values), 0, 0.0, axis=1), rows)
    return rows


def root_of_inverse(covariance: Array) -> Array:
    """The triangle W with WᵀW = C⁻¹; zero where a quantity is exact."""
    known = np.flatnonzero(np.diag(covariance) > 0.0)
    index = np.ix_(known, known)
    size = np.sqrt(np.diag(covariance)[known])
    lower = np.linalg.cholesky(covariance[index] / np.outer(size, size))
    out = np.zeros_like(covariance)
    out[index] = np.linalg.qr(np.linalg.inv(lower), mode="r") / size
    return out
