"""Samples that are missing or held in one turn.

Without time stamps nothing in a log says that rows are missing. A turn says it: what it lacks is a rotation δ about its
own axis a, so that it does not carry the vertical from rest to rest; and of the specific force, which turned by δ from
there on, the velocity has lost

    ΔV = δ a × g u (T − s),    0 ≤ s ≤ T

where the samples were lost after s of a turn that began with the vertical u and lasted T: a device that rests before
and after has gained none. Both are tested, as every cause, for each turn by itself, and the least probability times the
number of turns is taken. For the few turns of a short session there are always parameters that explain their rotations,
and then the velocities alone show it: they are in an estimate of all groups of parameters, and not in that of the
linear model.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tumble.estimation.causes import SHORTEST_TURN, UNSEEN, Cause, Projection, apart, chance
from tumble.estimation.likelihood import (
    Linearised,
    Point,
    Problem,
    Scatter,
    instruments_of,
    linearise,
    noise_of,
)
from tumble.estimation.turns_about import TurnsAbout
from tumble.reduction.observations import Observations
from tumble.sensors.parameters import RATE
from tumble.units import DEGREE, Array


def with_one_turn(found: Sequence[Cause], linearised: Linearised, projection: Projection) -> list[Cause]:
    """Causes, in which, of a log without time stamps, samples lost in one turn stand for samples lost in all, where
    they are the more likely; the `projection` is that with the scatter of the estimate."""
    everywhere = next((cause for cause in found if cause.name == "lost samples"), None)
    if everywhere is None or not linearised.problem.observations.unstamped:  # nothing is turned, or time tells
        return list(found)
    one = lost_in_a_turn(linearised, projection)
    if one is None or one.probability >= everywhere.probability:
        return list(found)
    return sorted([*(cause for cause in found if cause is not everywhere), one], key=lambda cause: cause.probability)


def with_all_groups(linear: Linearised, observations: Observations) -> Linearised:
    """The likelihood of all groups of parameters whose usual size the observations know, without scatter, at the
    estimate of the linear model: one step from its solution."""
    instrument, own = instruments_of(observations)
    problem = Problem.of(observations, instrument=instrument, own=own, usual=observations.usual)
    values, first = problem.measured[0][1:].copy(), instrument.linear_count
    values[:first] = linear.point.values[:first]
    point = Point(
        values=values,
        gravity=linear.point.gravity,
        attitudes=linear.point.attitudes,
        own=np.zeros((len(problem.parts), len(problem.own_known))),
    )
    about = None if linear.about is None else TurnsAbout.of(observations, instrument, values)
    rows = linearise(problem, point, about)
    noise = noise_of(problem, rows)
    return Linearised(problem=problem, point=point, about=about, rows=rows, noise=noise, scatter=Scatter())


def lost_in_a_turn(linearised: Linearised, projection: Projection) -> Cause | None:
    """The turn that lacks samples most likely; None where the session sees that of no turn."""
    if not len(linearised.rows.turn):
        return None
    columns = _columns(linearised, projection)
    left = projection.left_of(columns.reshape(len(columns), -1)).reshape(-1, *columns.shape[1:])
    worst, most, values, q = -1, 0.0, np.zeros(0), columns.shape[2]
    length = np.maximum(np.sqrt((columns**2).sum(axis=0)), 1e-300)
    for k in range(columns.shape[1]):
        B = left[:, k] / length[k]
        G, along = B.T @ B, B.T @ projection.residual
        if np.linalg.eigvalsh(G)[0] <= UNSEEN**2:
            continue
        found = np.linalg.solve(G, along)
        if (fall := float(along @ found)) > most:
            worst, most, values = k, fall, found / length[k]
    if worst < 0:
        return None
    observations, turns = linearised.problem.observations, linearised.problem.observations.turns
    assert turns is not None
    m = linearised.problem.instrument.linear_count
    damage = np.abs(projection.change(columns[:, worst], values)[:m]) / projection.u[:m]
    return Cause(
        name="lost samples",
        concerns="both",
        probability=min(1.0, columns.shape[1] * chance(projection, linearised.scatter, most, q)),
        damage=float(damage.max()),
        sentence=f"{observations.turn_named(worst)} errs about its own axis by {abs(values[0]) / DEGREE:.2g}°: samples "
        f"are missing or held there; leave it out by turn = {turns.first[worst] + 1} in [[exclude]], and record with "
        "time stamps",
    )


def _columns(linearised: Linearised, projection: Projection) -> Array:
    """The whitened columns (rows, K, q) of a loss in each turn: of the rotation, and, where velocities are seen, of
    what that does to them."""
    about, rows, L = linearised.about, linearised.rows, linearised.point.attitudes
    assert about is not None
    path = np.einsum("kipp->ki", about.moments.Phi[..., RATE])
    size = np.linalg.norm(path, axis=1, keepdims=True)
    axis = np.where(about.moments.T[:, None] < SHORTEST_TURN, 0.0, path / np.maximum(size, 1e-9))
    q = 2 if linearised.problem.instrument.in_velocities else 1
    turn = np.zeros((*rows.turn.shape[:2], q))
    turn[:, :3, 0] = axis
    if q == 2:
        straight = (linearised.point.gravity * about.moments.T)[:, None] * L[projection.first, 1]
        turn[:, 3:6, 1] = np.cross(axis, straight)
    wide = apart(projection, np.zeros((*rows.rest.shape[:2], 0)), turn)
    return wide.reshape(len(wide), len(rows.rest), q)[:, projection.first]
