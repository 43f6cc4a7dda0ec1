"""Samples that are missing, or held where one is missing, in all turns or in one.

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

from collections.abc import Iterator

import numpy as np

from tumble.estimation.causes.cause import UNSEEN, Cause
from tumble.estimation.causes.chances import fall_chance, ratio_chance, sum_of_squares
from tumble.estimation.causes.linearised_session import SHORTEST_TURN, LinearisedSession
from tumble.estimation.causes.projection import Projection
from tumble.inference.hyperparameters import Scatter
from tumble.inference.likelihood import Linearised, Point, Problem, instruments_of, noise_of
from tumble.inference.linearisation import linearise
from tumble.estimation.turns_about import TurnsAbout
from tumble.recording.gaps import REGULAR_HINT
from tumble.reduction.observations import Observations
from tumble.rotation import tangent_basis
from tumble.sensors.parameters import RATE
from tumble.units import DEGREE, Array

FEWEST_HELD = 3
JITTERING = 3e-3
"""Of an interval: time stamps that jitter by less are right, as far as any turn shows."""


def lost_samples(session: LinearisedSession, projection: Projection) -> Iterator[Cause]:
    """Samples that are copies of the one before, or else that turns lack: all of them, or one alone, where that is the
    more likely and no time stamps tell. The `projection` is that with the scatter of the estimate."""
    held = _held(session)
    if held is not None:
        yield held
    elif session.turned:
        found = [_lost_in_all_turns(session, projection)]
        if session.observations.unstamped and (one := lost_in_a_turn(session.linearised, projection)) is not None:
            found.append(one)
        yield min(found, key=lambda cause: cause.probability)


def stamps_remedy(observations: Observations) -> str:
    """What to do about the time stamps of a log whose turns err as if samples were missing."""
    return jittering(observations).removeprefix("; ") or "record with time stamps"


def jittering(observations: Observations) -> str:
    """What to try where time stamps jitter about even rows, for the turns err then as much as if the rows did."""
    jitter, interval = _jitter(observations)
    return (
        f"; or the time stamps jitter by {1e3 * jitter:.2g} ms: {REGULAR_HINT}" if jitter > JITTERING * interval else ""
    )


def _jitter(observations: Observations) -> tuple[float, float]:
    """By how much, s, the time stamps of the turns leave even times, and the interval of these, s: intervals that such
    stamps make have the covariance −σ² from one to the next, and lost samples or a rate that changes have not."""
    samples = observations.turn_samples
    if samples is None or not len(samples.start):
        return 0.0, 1.0
    each = [samples.samples.read(a, b)[2] for a, b in zip(samples.start.tolist(), samples.stop.tolist(), strict=True)]
    interval = float(np.median(np.concatenate(each)))
    off = [np.where(np.abs(dt - interval) < 0.5 * interval, dt - interval, 0.0) for dt in each]
    covariance = sum(float(e[1:] @ e[:-1]) for e in off) / max(1, sum(len(e) - 1 for e in off))
    return float(np.sqrt(max(0.0, -covariance))), interval


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
    damage = np.abs(projection.changes(columns[:, worst] @ values)[:m]) / projection.u[:m]
    return Cause(
        name="lost samples",
        concerns="both",
        probability=min(1.0, columns.shape[1] * fall_chance(projection, linearised.scatter, most, q)),
        damage=float(damage.max()),
        sentence=f"{observations.turn_named(worst)} errs about its own axis by {abs(values[0]) / DEGREE:.2g}°: samples "
        f"are missing or held there; leave it out by turn = {turns.first[worst] + 1} in [[exclude]], and record with "
        "time stamps",
    )


def _columns(linearised: Linearised, projection: Projection) -> Array:
    """The whitened columns (rows, K, q) of a loss in each turn: of the rotation, and, where velocities are seen, of
    what that does to them."""
    about, rows = linearised.about, linearised.rows
    assert about is not None
    path = np.einsum("kipp->ki", about.moments.Phi[..., RATE])
    size = np.linalg.norm(path, axis=1, keepdims=True)
    axis = np.where(about.moments.T[:, None] < SHORTEST_TURN, 0.0, path / np.maximum(size, 1e-9))
    q = 2 if linearised.problem.instrument.in_velocities else 1
    turn = np.zeros((*rows.turn.shape[:2], q))
    turn[:, :3, 0] = axis
    if q == 2:
        turn[:, 3:6, 1] = np.cross(axis, rows.gained)
    wide = projection.apart(np.zeros((*rows.rest.shape[:2], 0)), turn)
    return wide.reshape(len(wide), len(rows.rest), q)[:, projection.first]


def _held(session: LinearisedSession) -> Cause | None:
    """Samples of turns whose accelerometers and gyros all read what they read in the sample before, where that is not
    for want of resolution."""
    samples = session.observations.turn_samples
    if samples is None:
        return None
    rows = same = 0
    fewest = np.zeros(6, dtype=np.int64)
    for start, stop in zip(samples.start.tolist(), samples.stop.tolist(), strict=True):
        rates, forces, _ = samples.samples.read(start, stop)
        equal = [column[1:] == column[:-1] for column in (*rates.T, *forces.T)]
        rows, same = rows + len(equal[0]), same + int(np.count_nonzero(np.logical_and.reduce(equal)))
        fewest += [np.count_nonzero(column) for column in equal]
    if same < FEWEST_HELD or same < 0.8 * fewest.min() or fewest.min() > 0.5 * rows:
        return None
    return Cause(
        name="lost samples",
        concerns="both",
        probability=0.0,
        damage=0.0,
        sentence=f"{same} of {rows} samples of the turns are copies of the one before, {100.0 * same / rows:.2g} %: "
        "the log holds the last sample where one is missing; record all of them",
    )


def _lost_in_all_turns(session: LinearisedSession, projection: Projection) -> Cause:
    """Rotations of turns that err about their own axis, with the angle, more than across it: samples that are missing
    or held. Both are scatter, so that what is compared is one with the other."""
    about = session.linearised.about
    assert about is not None
    path = np.einsum("kipp->ki", about.moments.Phi[..., RATE])
    axis = path / np.maximum(np.linalg.norm(path, axis=1, keepdims=True), 1e-9)
    size = np.sqrt(about.moments.body_rates[:, [0, 3, 5]].sum(axis=1))[:, None]
    about_axis, across_it = axis[..., None], np.swapaxes(tangent_basis(axis), 1, 2)
    along, across = (_along(session, projection, size[..., None] * d) for d in (about_axis, across_it))
    return Cause(
        name="lost samples",
        concerns="both",
        probability=ratio_chance(along, across),
        damage=0.0,
        sentence="turns that err about their own axis, with their angle: samples are missing or held in the log; "
        + stamps_remedy(session.observations),
    )


def _along(session: LinearisedSession, projection: Projection, directions: Array) -> tuple[float, Array]:
    """The sum of squares along directions (K, 3, q) of the rotations, each turn's of sizes of their own."""
    rest, turn = session.nothing(directions.shape[2])
    turn[:, :3] = directions
    return sum_of_squares(projection, projection.apart(rest, turn))
