"""Samples that are missing, or held in place of missing ones, in one turn or in all.

Without time stamps only the turns show that rows are missing. A turn lacks a rotation δ about its own axis a, so that
it does not carry the vertical from rest to rest. The specific force is turned by δ from there on, so the velocity
lacks

    ΔV = δ a × g u (T − s),    0 ≤ s ≤ T

if the samples are missing s after the start of a turn of duration T that begins with the vertical u; a device at rest
before and after gains no velocity. Both columns are fitted to each turn, and the smallest p-value is multiplied by the
number of turns. In a short session some parameters explain the rotations of its few turns. Then only the velocities
show the loss; an estimate of all groups of parameters uses them, one of the linear model does not.
"""

from __future__ import annotations

import numpy as np

from tumble.advice import Advised
from tumble.diagnosis.causes import SHORTEST_TURN, Cause, LinearisedSession
from tumble.diagnosis.findings import TURN_GROUPS, Finding
from tumble.diagnosis.projection import SumOfSquares, approximate_drops
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.linearisation import gained_in_turns
from tumble.recording.rows.gaps import REGULAR_HINT
from tumble.reduction.observations import Observations
from tumble.rotation import tangent_basis
from tumble.sensors.parameters import RATE
from tumble.units import Array

FEWEST_HELD = 3  # samples
JITTER_SIGMAS = 3.0  # standard deviations of a covariance between intervals that show jitter
ADDED_UP = 1.5  # deviation of time stamps from even ones over that of single intervals that shows measured intervals
SMALLEST_JITTER = 3e-3  # in intervals: jitter of time stamps that has no visible effect on turns


def jitter_hint(observations: Observations) -> str:
    """Return the advice "; or the time stamps jitter …" if the stamps jitter about even rows, else an empty text.

    Intervals between such stamps have the covariance −σ² from one to the next, or over several intervals if the stamps
    are those of bursts. Lost samples, or a varying rate, have no such covariance."""
    intervals = _intervals(observations)
    if not intervals:
        return ""
    interval = float(np.median(np.concatenate(intervals)))
    off = [np.where(np.abs(dt - interval) < 0.5 * interval, dt - interval, 0.0) for dt in intervals]
    for burst in 2 ** np.arange(7):
        sums = [each[: len(each) // burst * burst].reshape(-1, burst).sum(axis=1) for each in off]
        products = np.concatenate([[0.0], *(each[1:] * each[:-1] for each in sums)])
        if -products.sum() > JITTER_SIGMAS * np.sqrt((products**2).sum()):
            jitter = float(np.sqrt(-products.sum() / (len(products) - 1)))
            if jitter > SMALLEST_JITTER * interval:
                return f"; or the time stamps jitter by {1e3 * jitter:.2g} ms: {REGULAR_HINT}"
            break
    return ""


def are_measured_intervals(observations: Observations) -> bool:
    """Return True if the time stamps follow intervals that vary, so that lost samples would show as gaps.

    The deviations of such stamps from even ones add up, to far more than that of a single interval; stamps that are
    counted, rounded, or jitter about even rows deviate by less."""
    single, added = [np.zeros(0)], [np.zeros(0)]
    for intervals in _intervals(observations):
        if len(intervals) > 2:
            count, time = np.arange(len(intervals)), np.cumsum(intervals)
            single.append(intervals / intervals.mean() - 1.0)
            added.append((time - np.polyval(np.polyfit(count, time, 1), count)) / intervals.mean())
    if len(single) == 1:
        return False
    spread, together = (float(np.sqrt(np.mean(np.concatenate(each) ** 2))) for each in (single, added))
    return together > ADDED_UP * max(spread, SMALLEST_JITTER)


def _intervals(observations: Observations) -> list[Array]:
    """Return the intervals (m,), s, between the samples of each turn."""
    turned = observations.turn_samples
    if turned is None:
        return []
    return [turned.samples.read(a, b)[2] for a, b in zip(turned.start.tolist(), turned.stop.tolist(), strict=True)]


def stamps_remedy(observations: Observations) -> str:
    """Return what to do about the time stamps of a log whose turns err as if samples were missing."""
    return jitter_hint(observations).removeprefix("; ") or "record with time stamps"


def lost_in_one_turn(session: LinearisedSession) -> list[Cause]:
    """Return a loss of samples in the likeliest turn of each session; none if time stamps would show it."""
    rows, in_velocities = session.linearised, session.problem.instrument.in_velocities
    if rows.integrated is None or not (any(session.has_turns) and session.observations.unstamped):
        return []
    axis = np.where(rows.integrated.moments.T[:, None] < SHORTEST_TURN, 0.0, _turn_axes(rows.integrated))
    rest, turn = (np.zeros((*each.shape, 2 if in_velocities else 1)) for each in rows.residuals)
    turn[:, :3, 0] = axis
    if in_velocities:
        turn[:, 3:6, 1] = np.cross(axis, gained_in_turns(rows.problem, rows.point))
    drops = approximate_drops(session.solution.equations.whitening["turn"] @ turn, *session.solution.residuals["turn"])
    chosen, words = np.zeros(len(turn)), list[dict[str, object]]()
    for part, observed in zip(session.problem.session_spans, session.observed, strict=True):
        words.append({"turn": "", "number": ""})
        if drops[part.turns].any() and observed.turns is not None:
            worst = int(np.argmax(drops[part.turns]))
            chosen[part.turns.start + worst] = 1.0
            words[-1] = {"turn": observed.turn_named(worst), "number": observed.turns.first[worst] + 1}
    columns = rest, turn * chosen[:, None, None]
    tried = max(part.turns.stop - part.turns.start for part in session.problem.session_spans)
    return [Cause(name="lost samples", kind=None, columns=columns, places=tried, words=words)]


def _turn_axes(integrated: IntegratedTurns) -> Array:
    """Return the axis (K, 3) of each turn, zero where nothing turned."""
    path = np.einsum("kipp->ki", integrated.moments.Phi[..., RATE])
    return np.asarray(path / np.maximum(np.linalg.norm(path, axis=1, keepdims=True), 1e-9))


def samples_held(observations: Observations) -> Finding | None:
    """Return the cause that whole samples repeat the one before, if that is not due to coarse resolution."""
    samples = observations.turn_samples
    if samples is None:
        return None
    turns = zip(samples.start.tolist(), samples.stop.tolist(), strict=True)
    readings = (np.column_stack(samples.samples.read(start, stop)[:2]) for start, stop in turns)
    equal = np.concatenate([np.zeros((0, 6), dtype=bool), *(each[1:] == each[:-1] for each in readings)])
    rows, same, fewest = len(equal), int(equal.all(axis=1).sum()), int(equal.sum(axis=0).min())
    if same < FEWEST_HELD or same < 0.8 * fewest or fewest > 0.5 * rows:
        return None
    return Finding(
        causes=("lost samples",),
        concerns=(),
        sentence=Advised(
            f"{same} of {rows} samples of the turns are copies of the one before, {100.0 * same / rows:.2g} %: the log "
            "holds the last sample where one is missing",
            "record all of them",
        ),
    )


def lost_in_all_turns(session: LinearisedSession, s: int) -> Finding:
    """Return the cause that samples are missing or held in the turns of session s, from the scatter of their rotations
    about their own axes, in proportion to the angle, against that across them.

    Lost samples also reduce the scale factors of the gyros by the share that is lost, and change their axes. This is
    not scatter, and its size is not known from scatter. Jitter of time stamps has either sign, and no such effect.
    The variance components of the estimate scatter alike in all directions."""
    integrated, observed, part = (
        session.linearised.integrated,
        session.observed[s],
        session.problem.session_spans[s].turns,
    )
    assert integrated is not None
    axis = _turn_axes(integrated)[part]
    angle = np.sqrt(integrated.moments.body_rates[part][:, [0, 3, 5]].sum(axis=1))[:, None, None]
    W = session.solution.equations.whitening["turn"][part, :, :3]
    residual, covariance = (each[part] for each in session.solution.residuals["turn"])
    along, across = (
        SumOfSquares.along(W @ (angle * directions), residual, covariance)
        for directions in (axis[..., None], np.swapaxes(tangent_basis(axis), 1, 2))
    )
    return Finding(
        causes=("lost samples",),
        concerns=("gyro",),
        p_value=along.p_value_against(across),
        by_group={} if jitter_hint(observed) else dict.fromkeys(TURN_GROUPS, np.inf),
        sentence=Advised(
            "turns that err about their own axis, with their angle: samples are missing or held in the log",
            stamps_remedy(observed),
        ),
    )
