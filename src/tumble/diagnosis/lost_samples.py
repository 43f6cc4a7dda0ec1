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

from dataclasses import replace
from typing import Any

import numpy as np

from tumble.diagnosis.causes import Candidate, Cause
from tumble.diagnosis.linearised_session import SHORTEST_TURN, LinearisedSession
from tumble.diagnosis.projection import SumOfSquares, falls_by_place, judged_solution
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.linearisation import Linearisation
from tumble.inference.noise import SCATTER, VarianceComponents
from tumble.inference.normal_equations import Solution
from tumble.recording.rows.gaps import REGULAR_HINT
from tumble.reduction.observations import Observations
from tumble.rotation import tangent_basis
from tumble.sensors.parameters import RATE
from tumble.units import Array

OF_TURNS = ("gyro.scale", "gyro.axis")
"""Groups of parameters that turns tell."""
FEWEST_HELD = 3
LEAST = 1e-12
"""Of a mean square of residuals in units of their noise: less is none."""
ROUNDS = 4
"""Of the scatter of turns that are to blame for all."""
CLEARLY = 3.0
"""Standard deviations of a covariance that is there."""
JITTERING = 3e-3
"""Of an interval: time stamps that jitter by less are right, as far as any turn shows."""


def stamps_remedy(jitter: str) -> str:
    """What to do about the stamps of a log whose turns err as if samples were missing, by what `jittering` says."""
    return jitter.removeprefix("; ") or "record with time stamps"


def jittering(observations: Observations) -> str:
    """What to try where time stamps jitter about even rows, for the turns err then as much as if the rows did.

    Times between such stamps have the covariance −σ² from one to the next, over one interval or over several where the
    stamps are of bursts; lost samples or a rate that changes have not."""
    samples = observations.turn_samples
    if samples is None or not len(samples.start):
        return ""
    every = [samples.samples.read(a, b)[2] for a, b in zip(samples.start.tolist(), samples.stop.tolist(), strict=True)]
    interval = float(np.median(np.concatenate(every)))
    off = [np.where(np.abs(dt - interval) < 0.5 * interval, dt - interval, 0.0) for dt in every]
    jitter = 0.0
    for count in 2 ** np.arange(7):
        sums = [each[: len(each) // count * count].reshape(-1, count).sum(axis=1) for each in off]
        products = np.concatenate([[0.0], *(each[1:] * each[:-1] for each in sums)])
        if -products.sum() > CLEARLY * np.sqrt((products**2).sum()):
            jitter = float(np.sqrt(-products.sum() / (len(products) - 1)))
            break
    return (
        f"; or the time stamps jitter by {1e3 * jitter:.2g} ms: {REGULAR_HINT}" if jitter > JITTERING * interval else ""
    )


def of_turns(session: LinearisedSession, whole: Solution) -> list[Candidate]:
    """A loss in the turn of each session that lacks samples most likely, by what is left of residuals with the
    components of variance of the estimate; none where time stamps would show it."""
    if not (any(session.turned) and session.observations.unstamped):
        return []
    turn = _columns(session)
    columns = whole.equations.turn_whitening @ turn
    falls = falls_by_place(np.eye(len(turn)), columns, *whole.turn_residuals)
    most, places = np.zeros(len(turn)), list[list[str]]()
    for part, observed in zip(session.problem.parts, session.observed, strict=True):
        places.append(["", ""])
        if falls[part.turns].any() and observed.turns is not None:
            worst = int(np.argmax(falls[part.turns]))
            most[part.turns.start + worst] = 1.0
            places[-1] = [observed.turn_named(worst), str(observed.turns.first[worst] + 1)]
    loss = session.nothing(turn.shape[2])[0], turn * most[:, None, None]
    tried = max(part.turns.stop - part.turns.start for part in session.problem.parts)
    return [Candidate(name="lost samples", concerns="both", columns=loss, places=places, tried=tried)]


def _turned_about(about: IntegratedTurns, turns: slice) -> Array:
    """The axis (K, 3) that each turn was about, of length 0 where nothing turned."""
    path = np.einsum("kipp->ki", about.moments.Phi[turns][..., RATE])
    axis = path / np.maximum(np.linalg.norm(path, axis=1, keepdims=True), 1e-9)
    return np.asarray(axis)


def _columns(session: LinearisedSession) -> Array:
    """The columns (K, t, q) of a loss in each turn: of the rotation, and, where velocities are seen, of what that does
    to them."""
    about, rows = session.linearised.about, session.linearised
    assert about is not None
    axis = np.where(about.moments.T[:, None] < SHORTEST_TURN, 0.0, _turned_about(about, slice(None)))
    seen = session.problem.instrument.in_velocities
    _, turn = session.nothing(2 if seen else 1)
    turn[:, :3, 0] = axis
    if seen:
        turn[:, 3:6, 1] = np.cross(axis, rows.gained)
    return turn


def samples_held(observations: Observations) -> Cause | None:
    """Samples of turns whose accelerometers and gyros all read what they read in the sample before, where that is not
    for want of resolution."""
    samples = observations.turn_samples
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
        sentence=f"{same} of {rows} samples of the turns are copies of the one before, {100.0 * same / rows:.2g} %: "
        "the log holds the last sample where one is missing; record all of them",
    )


def turns_to_blame(linearised: Linearisation) -> Solution:
    """What is left of residuals where rotations and velocities of turns alone scatter, each by as much as its residuals
    do, and groups of parameters are of their usual sizes: lost samples make rotations err, and an estimate may have
    taken that for rests that scatter, or for groups; accelerometers that are late err in velocities, and the rotations
    must not be blamed for it. What jerky turns err by, which goes with the axis too, is told by their samples."""
    Z, of = linearised.noise.turn_directions
    names = ("turn", "velocity") if linearised.problem.instrument.in_velocities else ("turn",)
    along = {name: Z[:, :, of == SCATTER.index(name)] for name in names}
    components = VarianceComponents(aliased=linearised.components.aliased)
    remaining = judged_solution(linearised, components, usual=True)
    for step in range(ROUNDS):
        W, scatter = remaining.equations.turn_whitening, dict[str, Any]()
        for name in names:
            square, before = SumOfSquares.along(W @ along[name], *remaining.turn_residuals), getattr(components, name)
            variance = square.excess if step == 0 else before**2 * square.square / max(square.mean, LEAST)
            scatter[name] = float(np.sqrt(variance))
        components = replace(components, **scatter)
        remaining = judged_solution(linearised, components, usual=True)
    return remaining


def lost_in_all_turns(session: LinearisedSession, s: int, blamed: Solution) -> Cause:
    """Rotations of turns of session s that err about their own axis, with the angle, more than across it, where turns
    are to blame: samples that are missing or held. Both are scatter, so that what is compared is one with the other.
    Every sample that is lost makes a turn shorter, so that scale factors of the gyros are less by the share that is
    lost, and err in their axes too, which the same turns tell: that is no scatter, and no scatter tells its size. Time
    stamps that jitter make turns err either way."""
    about, observed, part = session.linearised.about, session.observed[s], session.problem.parts[s].turns
    assert about is not None
    axis = _turned_about(about, part)
    size = np.sqrt(about.moments.body_rates[part][:, [0, 3, 5]].sum(axis=1))[:, None, None]
    W, (residual, covariance) = (
        blamed.equations.turn_whitening[part, :, :3],
        (each[part] for each in blamed.turn_residuals),
    )
    along, across = (
        SumOfSquares.along(W @ (size * of), residual, covariance)
        for of in (axis[..., None], np.swapaxes(tangent_basis(axis), 1, 2))
    )
    jitter = jittering(observed)
    return Cause(
        name="lost samples",
        concerns="gyro",
        probability=along.chance_beside(across),
        by_group={} if jitter else dict.fromkeys(OF_TURNS, np.inf),
        sentence="turns that err about their own axis, with their angle: samples are missing or held in the log; "
        + stamps_remedy(jitter),
    )
