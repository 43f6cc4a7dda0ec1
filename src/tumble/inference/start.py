"""First linearisation of the joint method, in closed form.

Verticals are those of nominal accelerometers. Gyro parameters are found by one linear least-squares fit to the rests
and to the verticals carried along by the turns. Headings are carried along each chain of turns or links, and each chain
is rotated to the horizontal Earth's rate observed by the gyros.
"""

from __future__ import annotations

from itertools import accumulate

import numpy as np

from tumble.earth import EARTH_RATE
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.linearisation import Linearisation, linearise
from tumble.inference.normal_equations import solve
from tumble.inference.problem import Point, Problem
from tumble.reduction.turns.links import PARTS
from tumble.rotation import UP, rotation_matrix, skew, tangent_basis, unit_vector
from tumble.units import Array, IntArray

ROUGH_TURN = 1e-2  # rad: assumed error of the turns
ROUGH_DRIFT = 0.1  # assumed drift of the gyros, relative to the largest deviation of their rests from the median
ROUGH_EFFECT = 1e-3  # rad: acceptable second-order effect
WINDOW = 4  # links before and after a station over which the mean acceleration is taken as zero
VERTICAL = 1e-2  # squared horizontal part of a carried north below which any north is taken


def initial_linearisation(problem: Problem) -> Linearisation:
    """Return the linearisation of a problem at a point near its solution."""
    observations, instrument = problem.observations, problem.instrument
    values = problem.prior_mean[1:].copy()
    if problem.moves:
        return _initial_motion(problem, values)
    force = problem.accel_model(values).apply(observations.rests.accel)
    vertical = unit_vector(force)
    integrated = None
    if instrument.gyro is not None:
        integrated, values[instrument.own(instrument.gyro)] = _initial_gyros(problem, values, vertical)
    attitudes = headings(problem, vertical, values, integrated)
    local = np.zeros((len(problem.session_spans), len(problem.local_u)))
    point = Point(values=values, gravity=observations.site.gravity, attitudes=attitudes, local=local)
    return linearise(problem, point, integrated)


def _initial_gyros(problem: Problem, values: Array, vertical: Array) -> tuple[IntegratedTurns | None, Array]:
    """Return the turns integrated about gyro parameters fitted to rests and carried verticals, and the parameters."""
    observations, up, instrument = problem.observations, problem.earth[1], problem.instrument
    block = instrument.gyro
    assert block is not None
    places = instrument.own(block)
    median = np.median(observations.rests.gyro, axis=0)
    values = values.copy()
    values[places][: block.size] = median[block.channels]
    turns = observations.turns
    if turns is None:
        return None, values[places]
    integrated = IntegratedTurns.of(observations, instrument, values)
    derivative = np.einsum("ap,pqm->aqm", integrated.to_rate, block.jacobian(values[places]))
    by_turn = integrated.rows(instrument, values, instrument.linearised(values))[:, :3, places]
    back = np.einsum("kij,kj->ki", integrated.C, vertical[turns.last])
    rate = (observations.rests.gyro - median) @ integrated.to_rate.T
    rough = max(EARTH_RATE, ROUGH_DRIFT * float(np.abs(rate).max()))
    by_rest = np.einsum("aqm,iq->iam", derivative[:, :3], up * vertical) + derivative[:, 3]
    count = by_turn.shape[2]
    jacobian = np.concatenate([
        (skew(back) @ by_turn).reshape(-1, count) / ROUGH_TURN,
        by_rest.reshape(-1, count) / rough,
        np.diag(1.0 / problem.spread[places]),
    ])  # fmt: skip
    residual = np.concatenate([
        (vertical[turns.first] - back).ravel() / ROUGH_TURN,
        (rate - up * vertical).ravel() / rough,
        np.zeros(count),
    ])  # fmt: skip
    values[places] += np.linalg.solve(jacobian.T @ jacobian, jacobian.T @ residual)
    near = bool(np.all(integrated.second_order(integrated.gyro_offset(instrument, values))[0] < ROUGH_EFFECT))
    return (integrated if near else IntegratedTurns.of(observations, instrument, values)), values[places]


def headings(problem: Problem, vertical: Array, values: Array, integrated: IntegratedTurns | None) -> Array:
    """Return attitudes (N, 3, 3) with these verticals, each chain rotated to the Earth's rate.

    With N', E' the axes of a chain of arbitrary heading, carried along by the turns, the rates at rest are
    ω − Ω_U u = δ + a N' + s E': linear in the error δ of the gyros, and in a and s of each chain."""
    observations, turns = problem.observations, problem.observations.turns
    if integrated is None or turns is None:
        attitudes = carried_attitudes(problem, vertical, np.zeros(0, dtype=np.int64), np.zeros((0, 3, 3)), np.zeros(0))
    else:
        attitudes = carried_attitudes(problem, vertical, turns.first, integrated.C, turns.duration)
    if observations.gyro_block is None or problem.earth[0] == 0.0:
        return attitudes
    rate = problem.gyro_model(values).apply(observations.rests.gyro) - problem.earth[1] * vertical
    chain = problem.chain
    first, size = np.flatnonzero(np.diff(chain, prepend=-1)), np.sqrt(np.bincount(chain))[:, None]
    level = attitudes[:, ::2]  # N' and E'
    observed = np.add.reduceat((level @ rate[:, :, None])[:, :, 0], first, axis=0) / size
    axes = np.add.reduceat(level, first, axis=0) / size[:, None]
    flat = axes.reshape(-1, 3)
    normal = len(rate) * np.eye(3) - flat.T @ flat
    error = np.linalg.lstsq(normal, rate.sum(axis=0) - flat.T @ observed.ravel(), 1e-6)[0]
    heading = unit_vector(observed - axes @ error)[chain]
    out = np.empty_like(attitudes)
    out[:, 0], out[:, 1] = (heading[:, None] @ level)[:, 0], vertical
    out[:, 2] = (skew(out[:, 0]) @ vertical[:, :, None])[:, :, 0]
    return out


def carried_attitudes(problem: Problem, vertical: Array, before: IntArray, C: Array, seconds: Array) -> Array:
    """Return attitudes (M, 3, 3) with these verticals (M, 3), with headings carried from station to station.

    Parameters
    ----------
    problem, vertical
        The problem, and the vertical in the body at each station.
    before : (K,)
        Stations that are connected to the next, in order.
    C, seconds : (K, 3, 3), (K,)
        Rotations in between, body at the end → body at the start, and their durations, s.
    """
    north, around = -tangent_basis(vertical)[:, 1], rotation_matrix(-seconds[:, None] * problem.earth[1] * UP)[:, 0]
    up = vertical[before + 1]
    turned = around[:, 0, None, None] * np.eye(3) + around[:, 2, None, None] * skew(vertical[before])
    onward = turned @ C @ (np.eye(3) - up[:, :, None] * up[:, None])  # carries a north and makes it level
    for i, carried in zip(before.tolist(), onward, strict=True):
        level = north[i] @ carried
        if level @ level > VERTICAL:
            north[i + 1] = level / np.sqrt(level @ level)
    return np.stack([north, vertical, np.cross(north, vertical)], axis=1)


def _initial_motion(problem: Problem, values: Array) -> Linearisation:
    """Return the first linearisation of a moving device.

    Over WINDOW links on each side of a station the mean acceleration is small, so that the sum of the velocities of the
    links, in the body there, is along the vertical. A gyro bias b rotates a vertical that is carried back by −∫ A b dt;
    b is fitted by least squares to the verticals of stations 2 WINDOW links apart."""
    observations, instrument, M = problem.observations, problem.instrument, len(problem.chain)
    block, chain, station = instrument.gyro, problem.chain, np.arange(M)
    assert block is not None
    places = instrument.own(block)

    # both ends of the window of each station within its chain, and pairs of stations of a chain 2 WINDOW apart
    low = np.maximum(station - WINDOW, np.searchsorted(chain, chain))
    high = np.minimum(station + WINDOW, np.searchsorted(chain, chain, side="right") - 1)
    here = station[: max(M - 2 * WINDOW, 0)]
    here = here[chain[here] == chain[here + 2 * WINDOW]]
    there = here + 2 * WINDOW
    for _ in range(2):
        C, V, T = _transitions(problem, IntegratedTurns.of(observations, instrument, values))
        A = np.array(list(accumulate(C[:-1], np.matmul, initial=np.eye(3))))  # body → axes of the first station
        At = np.swapaxes(A, 1, 2)
        velocity = np.concatenate([np.zeros((1, 3)), np.cumsum((A @ V[:, :, None])[:, :, 0], axis=0)])
        vertical = unit_vector((At @ (velocity[high] - velocity[low])[:, :, None])[:, :, 0] + 1e-12 * UP)
        vertical[problem.station] = unit_vector(problem.accel_model(values).apply(observations.rests.accel))
        integral = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(T[:, None, None] * A, axis=0)])  # ∫ A dt
        carried_back = (At[here] @ A[there] @ vertical[there][:, :, None])[:, :, 0]
        rows = skew(carried_back) @ At[here] @ (integral[there] - integral[here])
        if len(rows):
            bias = np.linalg.lstsq(rows.reshape(-1, 3), (vertical[here] - carried_back).ravel(), rcond=1e-6)[0]
            values[places][: block.size] += (block.axes @ bias)[block.channels]
    integrated = IntegratedTurns.of(observations, instrument, values)
    C, _, T = _transitions(problem, integrated)
    before = np.flatnonzero(chain[:-1] == chain[1:])
    point = Point(
        values=values,
        gravity=observations.site.gravity,
        attitudes=carried_attitudes(problem, vertical, before, C[before], T[before]),
        local=np.zeros((1, len(problem.local_u))),
        velocities=np.zeros((M, 3)),
        displacements=np.zeros((M, 3)),
    )
    if problem.earth[0] != 0.0:
        point = _turned_to_north(problem, point, integrated)
    return linearise(problem, point, integrated)


def _turned_to_north(problem: Problem, point: Point, integrated: IntegratedTurns) -> Point:
    """Return the point with the heading of each chain by the horizontal Earth's rate observed in motion.

    Heading steps of a linear solution, which are too short from far off, are proportional to sin e for an error e of
    the heading, and to −cos e a quarter of a turn further; their ratio gives e."""
    chain, none = problem.chain, np.zeros(1 + len(point.values))

    def turned(by: Array) -> Point:
        return point.moved(none, by[chain, None] * np.array([0.0, 0.0, 1.0]))

    steps = list[Array]()
    for quarters in range(2):
        rotated = turned(np.full(chain[-1] + 1, 0.5 * np.pi * quarters))
        angles = solve(linearise(problem, rotated, integrated)).angles[:, 2]
        steps.append(np.bincount(chain, angles) / np.bincount(chain))
    return turned(np.arctan2(steps[0], -steps[1]))


def _transitions(problem: Problem, integrated: IntegratedTurns) -> tuple[Array, Array, Array]:
    """Return rotations (M, 3, 3), velocities (M, 3) and durations (M,) from each station to the next; 1 and 0 if
    none."""
    links, turns, M = problem.observations.links, problem.observations.turns, len(problem.chain)
    assert links is not None
    assert integrated.links is not None
    C, V, T = np.tile(np.eye(3), (M, 1, 1)), np.zeros((M, 3)), np.zeros(M)
    parts = (x.reshape(len(links), PARTS, *x.shape[1:]) for x in (integrated.links.C, integrated.links.moments.V))
    for part_C, part_V in zip(*(np.swapaxes(x, 0, 1) for x in parts), strict=True):
        V[links.before] += (C[links.before] @ part_V[:, :, None])[:, :, 0]
        C[links.before] = C[links.before] @ part_C
    T[links.before] = links.duration
    if turns is not None and len(turns):
        C[problem.before_turn], V[problem.before_turn] = integrated.C, integrated.moments.V
        T[problem.before_turn] = turns.duration
    return C, V, T
