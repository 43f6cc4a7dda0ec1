"""The start of the joint method, in closed form.

Verticals from nominal accelerometers; gyro parameters by one linear least-squares pass over the rests and over the
verticals that the turns carry (the indirect method); headings carried along each chain of turns, and turned together by
what the gyros see of the horizontal Earth's rate.
"""

from __future__ import annotations

import numpy as np

from tumble.earth import EARTH_RATE
from tumble.inference.linearisation import Linearisation, linearise
from tumble.inference.problem import Point, Problem
from tumble.inference.turns_about import TurnsAbout
from tumble.reduction.turns.links import PARTS
from tumble.rotation import UP, rotation_matrix, skew, tangent_basis, unit_vector
from tumble.units import Array

ROUGH_TURN = 1e-2  # rad: what the start takes the turns to err by
ROUGH_DRIFT = 0.1  # of what gyros read at rest beyond the median: with it they drift, which no scale factor explains
ROUGH_EFFECT = 1e-3  # rad: second-order effect that the start puts up with
WINDOW = 4
"""Links on each side of a station over which its mean acceleration counts as none."""
VERTICAL = 1e-2  # a north with so little across the vertical is none, and any is taken


def start_of(problem: Problem) -> tuple[Linearisation, tuple[Array, ...]]:
    """The rows at a point near the solution, found in closed form, and the step there from zero."""
    observations, instrument = problem.observations, problem.instrument
    values = problem.prior_mean[1:].copy()
    if problem.moves:
        return _started_in_motion(problem, values)
    force = problem.accel_model(values).apply(observations.rests.accel)
    vertical = unit_vector(force)
    about = None
    if instrument.gyro is not None:
        about, values[instrument.own(instrument.gyro)] = _started_gyros(problem, values, vertical)
    attitudes = headings(problem, vertical, values, about)
    local = np.zeros((len(problem.parts), len(problem.local_u)))
    point = Point(values=values, gravity=observations.site.gravity, attitudes=attitudes, local=local)
    return linearise(problem, point, about), (values,)


def _started_gyros(problem: Problem, values: Array, vertical: Array) -> tuple[TurnsAbout | None, Array]:
    """Gyro parameters from the means of the rests and the verticals that the turns carry, linearised once, and the
    turns integrated about them."""
    observations, up, instrument = problem.observations, problem.earth[1], problem.instrument
    block = instrument.gyro
    assert block is not None
    own = instrument.own(block)
    median = np.median(observations.rests.gyro, axis=0)
    started = values.copy()
    started[own][: block.size] = median[block.channels]
    turns = observations.turns
    if turns is None:
        return None, started[own]
    about = TurnsAbout.of(observations, instrument, started)
    derivative = np.einsum("ap,pqm->aqm", about.to_rate, block.jacobian(started[own]))
    by_turn = about.rows(instrument, started, instrument.linearised(started), len(started))[:, :3, own]
    back = np.einsum("kij,kj->ki", about.C, vertical[turns.last])
    rate = (observations.rests.gyro - median) @ about.to_rate.T
    rough = max(EARTH_RATE, ROUGH_DRIFT * float(np.abs(rate).max()))
    by_rest = np.einsum("aqm,iq->iam", derivative[:, :3], up * vertical) + derivative[:, 3]
    count = by_turn.shape[2]
    jacobian = np.concatenate([
        (skew(back) @ by_turn).reshape(-1, count) / ROUGH_TURN,
        by_rest.reshape(-1, count) / rough,
        np.diag(1.0 / problem.spread[own]),
    ])  # fmt: skip
    residual = np.concatenate([
        (vertical[turns.first] - back).ravel() / ROUGH_TURN,
        (rate - up * vertical).ravel() / rough,
        np.zeros(count),
    ])  # fmt: skip
    started[own] += np.linalg.solve(jacobian.T @ jacobian, jacobian.T @ residual)
    near = bool(np.all(about.second_order(about.since(instrument, started))[0] < ROUGH_EFFECT))
    return (about if near else TurnsAbout.of(observations, instrument, started)), started[own]


def headings(problem: Problem, vertical: Array, values: Array, about: TurnsAbout | None) -> Array:
    """Attitudes (N, 3, 3) with these verticals. With N', E' the axes of a chain whose heading is any, carried along by
    the turns, the rates at rest are ω − Ω_U u = δ + a N' + s E', where the gyros still err by δ: linear in δ and in a
    and s of each chain."""
    observations, turns = problem.observations, problem.observations.turns
    north = -tangent_basis(vertical)[:, 1]
    if about is not None and turns is not None:
        around = rotation_matrix(-turns.duration[:, None] * problem.earth[1] * UP)
        for i, k in zip(turns.first.tolist(), range(len(turns)), strict=True):
            before = np.array([north[i], vertical[i], np.cross(north[i], vertical[i])])
            after = (around[k] @ before @ about.C[k])[0]
            level = after - (after @ vertical[i + 1]) * vertical[i + 1]
            if level @ level > VERTICAL:
                north[i + 1] = level / np.sqrt(level @ level)
    attitudes = np.stack([north, vertical, np.cross(north, vertical)], axis=1)
    if observations.gyro_block is None or problem.earth[0] == 0.0:
        return attitudes
    rate = problem.gyro_model(values).apply(observations.rests.gyro) - problem.earth[1] * vertical
    chain = problem.chain
    first, size = np.flatnonzero(np.diff(chain, prepend=-1)), np.sqrt(np.bincount(chain))[:, None]
    level = attitudes[:, ::2]  # N' and E'
    seen = np.add.reduceat((level @ rate[:, :, None])[:, :, 0], first, axis=0) / size
    axes = np.add.reduceat(level, first, axis=0) / size[:, None]
    flat = axes.reshape(-1, 3)
    normal = len(rate) * np.eye(3) - flat.T @ flat
    error = np.linalg.lstsq(normal, rate.sum(axis=0) - flat.T @ seen.ravel(), 1e-6)[0]
    heading = unit_vector(seen - axes @ error)[chain]
    out = np.empty_like(attitudes)
    out[:, 0], out[:, 1] = (heading[:, None] @ level)[:, 0], vertical
    out[:, 2] = (skew(out[:, 0]) @ vertical[:, :, None])[:, :, 0]
    return out


def _started_in_motion(problem: Problem, values: Array) -> tuple[Linearisation, tuple[Array, ...]]:
    """The start of a device that moves. Over some WINDOW links about a station its mean acceleration is small: the
    sum of their velocities, turned into the body there, is along the vertical. Gyro biases are those with which the
    vertical of one window is carried to that of the next ones; attitudes have these verticals, with headings carried
    along."""
    observations, instrument, M = problem.observations, problem.instrument, len(problem.link)
    links, block = observations.links, problem.instrument.gyro
    assert links is not None
    assert block is not None
    own = instrument.own(block)
    for _ in range(2):
        about = TurnsAbout.of(observations, instrument, values)
        assert about.links is not None
        C, V, T = _transitions(problem, about)
        A, turned = np.empty((M, 3, 3)), np.zeros((M, 3, 3))
        A[0] = np.eye(3)
        for k in range(M - 1):
            A[k + 1] = A[k] @ C[k]
        gained = np.concatenate([np.zeros((1, 3)), np.cumsum((A @ V[:, :, None])[:, :, 0], axis=0)])
        chain, every = problem.chain, np.arange(M)
        begin = np.searchsorted(chain, chain)
        end = np.searchsorted(chain, chain, side="right") - 1
        low, high = np.maximum(every - WINDOW, begin), np.minimum(every + WINDOW, end)
        vertical = unit_vector((np.swapaxes(A, 1, 2) @ (gained[high] - gained[low])[:, :, None])[:, :, 0] + 1e-12 * UP)
        at_rest = unit_vector(problem.accel_model(values).apply(observations.rests.accel))
        vertical[problem.station] = at_rest
        # the vertical of a station and that WINDOW stations later, in the body at the first: apart by ∫ A b dt
        swept = np.concatenate([np.zeros((1, 3, 3)), np.cumsum(T[:, None, None] * A, axis=0)])
        pairs = every[(every + 2 * WINDOW < M)]
        pairs = pairs[chain[pairs] == chain[np.minimum(pairs + 2 * WINDOW, M - 1)]]
        later = pairs + 2 * WINDOW
        back = (np.swapaxes(A[pairs], 1, 2) @ A[later] @ vertical[later][:, :, None])[:, :, 0]
        turned = np.swapaxes(A[pairs], 1, 2) @ (swept[later] - swept[pairs])
        rows, apart = (skew(back) @ turned).reshape(-1, 3), (vertical[pairs] - back).ravel()
        if len(rows):
            # a bias b turns `back` by −∫ A b dt × back
            bias = np.linalg.lstsq(rows.reshape(-1, 3), apart, rcond=1e-6)[0]
            values[own][: block.size] += (block.axes @ bias)[block.channels]
    about = TurnsAbout.of(observations, instrument, values)
    C, _, _ = _transitions(problem, about)
    north = -tangent_basis(vertical)[:, 1]
    for k in range(M - 1):
        if chain[k] == chain[k + 1]:
            level = C[k].T @ north[k]
            level = level - (level @ vertical[k + 1]) * vertical[k + 1]
            if level @ level > VERTICAL:
                north[k + 1] = level / np.sqrt(level @ level)
    attitudes = np.stack([north, vertical, np.cross(north, vertical)], axis=1)
    point = Point(
        values=values,
        gravity=observations.site.gravity,
        attitudes=attitudes,
        local=np.zeros((1, len(problem.local_u))),
        velocities=np.zeros((M, 3)),
        displacements=np.zeros((M, 3)),
    )
    return linearise(problem, point, about), (values,)


def _transitions(problem: Problem, about: TurnsAbout) -> tuple[Array, Array, Array]:
    """Rotations (M, 3, 3), velocities (M, 3) and durations (M,) from each station to the next one; of what nothing
    joins 1 and 0."""
    links, turns, M = problem.observations.links, problem.observations.turns, len(problem.link)
    assert links is not None
    assert about.links is not None
    C, V, T = np.tile(np.eye(3), (M, 1, 1)), np.zeros((M, 3)), np.zeros(M)
    parts = (x.reshape(len(links), PARTS, *x.shape[1:]) for x in (about.links.C, about.links.moments.V))
    for of_part, moved in zip(*(np.swapaxes(x, 0, 1) for x in parts), strict=True):
        V[links.before] += (C[links.before] @ moved[:, :, None])[:, :, 0]
        C[links.before] = C[links.before] @ of_part
    T[links.before] = links.duration
    if turns is not None and len(turns):
        C[problem.before_turn], V[problem.before_turn] = about.C, about.moments.V
        T[problem.before_turn] = turns.duration
    return C, V, T
