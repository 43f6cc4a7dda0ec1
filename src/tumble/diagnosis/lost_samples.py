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

from dataclasses import replace
from typing import Any

import numpy as np

from tumble.advice import Advised
from tumble.diagnosis.causes import SHORTEST_TURN, Candidate, LinearisedSession
from tumble.diagnosis.findings import Finding
from tumble.diagnosis.projection import SumOfSquares, approximate_drops, diagnostic_solution
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.linearisation import Linearisation
from tumble.inference.noise import SCATTER, VarianceComponents
from tumble.inference.normal_equations import Solution
from tumble.recording.rows.gaps import REGULAR_HINT
from tumble.reduction.observations import Observations
from tumble.rotation import tangent_basis
from tumble.sensors.parameters import RATE
from tumble.units import DEGREE, Array

TURN_GROUPS = ("gyro.scale", "gyro.axis")  # groups of parameters that are determined by turns
FEWEST_HELD = 3  # samples
LEAST_MEAN_SQUARE = 1e-12  # of residuals in units of their noise; less counts as this
SCATTER_ROUNDS = 4  # iterations of the scatter of turns
JITTER_SIGMAS = 3.0  # standard deviations of a covariance between intervals that show jitter
SMALLEST_JITTER = 3e-3  # in intervals: jitter of time stamps that has no visible effect on turns


def jitter_hint(observations: Observations) -> str:
    """Return the advice "; or the time stamps jitter …" if the stamps jitter about even rows, else an empty text.

    Intervals between such stamps have the covariance −σ² from one to the next, or over several intervals if the stamps
    are those of bursts. Lost samples, or a varying rate, have no such covariance."""
    samples = observations.turn_samples
    if samples is None or not len(samples.start):
        return ""
    intervals = [
        samples.samples.read(a, b)[2] for a, b in zip(samples.start.tolist(), samples.stop.tolist(), strict=True)
    ]
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


def stamps_remedy(observations: Observations) -> str:
    """Return what to do about the time stamps of a log whose turns err as if samples were missing."""
    return jitter_hint(observations).removeprefix("; ") or "record with time stamps"


def lost_in_one_turn(session: LinearisedSession, with_scatter: Solution) -> list[Candidate]:
    """Return a loss of samples in the turn of each session where it is most likely; none if time stamps would show it.

    `with_scatter` is the solution with the variance components of the estimate."""
    about, in_velocities = session.linearised.about, session.problem.instrument.in_velocities
    if about is None or not (any(session.has_turns) and session.observations.unstamped):
        return []
    axis = np.where(about.moments.T[:, None] < SHORTEST_TURN, 0.0, _turn_axes(about, slice(None)))
    rest, turn = session.zero_columns(2 if in_velocities else 1)
    turn[:, :3, 0] = axis
    if in_velocities:
        turn[:, 3:6, 1] = np.cross(axis, session.linearised.gained)
    drops = approximate_drops(with_scatter.equations.whitening["turn"] @ turn, *with_scatter.residuals["turn"])
    chosen, sentences = np.zeros(len(turn)), list[str]()
    for part, observed in zip(session.problem.parts, session.observed, strict=True):
        name = number = ""
        if drops[part.turns].any() and observed.turns is not None:
            worst = int(np.argmax(drops[part.turns]))
            chosen[part.turns.start + worst] = 1.0
            name, number = observed.turn_named(worst), str(observed.turns.first[worst] + 1)
        sentences.append(
            Advised(
                f"{name} errs about its own axis by {{size}}: samples are missing or held there",
                f"leave it out by turn = {number} in [[exclude]], and record with time stamps",
            )
        )
    return [
        Candidate(
            name="lost samples",
            concerns=(),
            columns=(rest, turn * chosen[:, None, None]),
            unit=(DEGREE, "°"),
            sentences=sentences,
            places=max(part.turns.stop - part.turns.start for part in session.problem.parts),
        )
    ]


def _turn_axes(about: IntegratedTurns, turns: slice) -> Array:
    """Return the axis (K, 3) of each turn, zero where nothing turned."""
    path = np.einsum("kipp->ki", about.moments.Phi[turns][..., RATE])
    return np.asarray(path / np.maximum(np.linalg.norm(path, axis=1, keepdims=True), 1e-9))


def samples_held(observations: Observations) -> Finding | None:
    """Return the cause that whole samples repeat the one before, if that is not due to coarse resolution."""
    samples = observations.turn_samples
    if samples is None:
        return None
    rows = same = 0
    same_in_column = np.zeros(6, dtype=np.int64)
    for start, stop in zip(samples.start.tolist(), samples.stop.tolist(), strict=True):
        rates, forces, _ = samples.samples.read(start, stop)
        equal = [column[1:] == column[:-1] for column in (*rates.T, *forces.T)]
        rows, same = rows + len(equal[0]), same + int(np.count_nonzero(np.logical_and.reduce(equal)))
        same_in_column += [np.count_nonzero(column) for column in equal]
    fewest = same_in_column.min()
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


def scatter_of_turns_only(linearised: Linearisation) -> Solution:
    """Solve with scatter in the rotations and velocities of turns alone, and groups of parameters of usual size.

    The estimate may have taken errors of rotations for scatter of rests or for large groups. Rotations and velocities
    have a scatter each, as late accelerometers affect velocities only. The scatter of jerky turns is kept, as it
    depends on the axis too and is determined from their samples."""
    noise = linearised.noise.rows["turn"]
    names = ("turn", "velocity") if linearised.problem.instrument.in_velocities else ("turn",)
    directions = {name: noise.directions[:, :, noise.component == SCATTER.index(name)] for name in names}
    components = VarianceComponents(aliased=linearised.components.aliased)
    solution = diagnostic_solution(linearised, components, usual_sizes=True)
    for step in range(SCATTER_ROUNDS):
        W, scatter = solution.equations.whitening["turn"], dict[str, Any]()
        for name in names:
            square = SumOfSquares.along(W @ directions[name], *solution.residuals["turn"])
            variance = getattr(components, name) ** 2 * square.square / max(square.mean, LEAST_MEAN_SQUARE)
            scatter[name] = float(np.sqrt(square.excess_variance if step == 0 else variance))
        components = replace(components, **scatter)
        solution = diagnostic_solution(linearised, components, usual_sizes=True)
    return solution


def lost_in_all_turns(session: LinearisedSession, s: int, turns_only: Solution) -> Finding:
    """Return the cause that samples are missing or held in the turns of session s, from the scatter of their rotations
    about their own axes, in proportion to the angle, against that across them.

    Lost samples also reduce the scale factors of the gyros by the share that is lost, and change their axes. This is
    not scatter, and its size is not known from scatter. Jitter of time stamps has either sign, and no such effect.
    `turns_only` is the solution of `scatter_of_turns_only`."""
    about, observed, part = session.linearised.about, session.observed[s], session.problem.parts[s].turns
    assert about is not None
    axis = _turn_axes(about, part)
    angle = np.sqrt(about.moments.body_rates[part][:, [0, 3, 5]].sum(axis=1))[:, None, None]
    W = turns_only.equations.whitening["turn"][part, :, :3]
    residual, covariance = (each[part] for each in turns_only.residuals["turn"])
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
