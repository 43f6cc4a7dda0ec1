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
from tumble.rotation import UP, rotation_matrix, skew, tangent_basis, unit_vector
from tumble.units import Array

ROUGH_TURN = 1e-2  # rad: what the start takes the turns to err by
ROUGH_EFFECT = 1e-3  # rad: second-order effect that the start puts up with
VERTICAL = 1e-2  # a north with so little across the vertical is none, and any is taken


def start_of(problem: Problem) -> tuple[Linearisation, tuple[Array, ...]]:
    """The rows at a point near the solution, found in closed form, and the step there from zero."""
    observations, instrument = problem.observations, problem.instrument
    values = problem.prior_mean[1:].copy()
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
    by_rest = np.einsum("aqm,iq->iam", derivative[:, :3], up * vertical) + derivative[:, 3]
    count = by_turn.shape[2]
    jacobian = np.concatenate([
        (skew(back) @ by_turn).reshape(-1, count) / ROUGH_TURN,
        by_rest.reshape(-1, count) / EARTH_RATE,
        np.diag(1.0 / problem.spread[own]),
    ])  # fmt: skip
    residual = np.concatenate([
        (vertical[turns.first] - back).ravel() / ROUGH_TURN,
        (rate - up * vertical).ravel() / EARTH_RATE,
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
