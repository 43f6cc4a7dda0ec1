"""Which rests and turns fit.

A rest or turn is judged by how much chi-square falls without it, as Gaussian sigmas of the same probability (F where
the scale is estimated too). One bad rest of few hides behind the scatter it makes. So where a group scatters and one of
it stands out before the scatter is allowed for, everything is estimated again without it, and so on; then these are
judged by what the others predict.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from scipy import special

from tumble.estimation.components import Scatter, Weights
from tumble.estimation.estimate import FIT_SIGMAS
from tumble.estimation.likelihood import Problem, noise_of
from tumble.estimation.methods.joint.fit import GROUPS, Fitted, fit_of
from tumble.estimation.methods.joint.iteration import LEFT_OUT, At, Out
from tumble.estimation.step import Left
from tumble.units import Array, BoolArray

FREE = 0.01  # of the variance of the noise: directions in which residuals have less say nothing
ROUNDED = 1e-9  # of the largest: directions of a projector below it are rounding
STANDS_OUT = 8.0  # times the median fall of chi-square of its group: of 15 without a bad one, 1 % have such a one
LEAST_CHANCE = 1e-300
MOST_LEFT_OUT = 6
"""Rests and turns that an estimate leaves out at most."""
TURNS = 2
"""The number of the group of turns, after accelerometers and gyros at rest."""


def _judged(
    fitted: Fitted, left_of: tuple[Left, Weights], scatter: Scatter, groups: Iterable[int]
) -> Iterator[tuple[Array, Array]]:
    """Of the groups asked for of accelerometers (0) and gyros (1) at rest, by rest, and of the turns (2), by turn: by
    how much chi-square falls without them, and in how many directions they have residuals, where weights are those with
    a `scatter`."""
    problem, out, (after, weight) = fitted.problem, fitted.out, left_of
    n, last = problem.observations.accel_block.size, fitted.solved.last
    stop, r = n + problem.observations.rests.gyro.shape[1], after.rest[0].shape[1]
    plain = noise_of(problem, last.rows) if out.any else last.noise
    at_rest = _pulls(weight.rest, after.rest, last.noise.variances_at_rest(scatter), plain.rest)
    merged = _pulls(weight.merged, after.merged, last.noise.variances_merged(scatter), plain.merged)
    for of_rests, before_turns in zip(at_rest, _part(merged, slice(r)), strict=True):
        of_rests[problem.before_turn] = before_turns
    for group in groups:
        if group == TURNS:
            yield _falls(_part(merged, slice(r, None)), out.turn)
        else:
            yield _falls(_part(at_rest, (slice(n), slice(n, stop))[group]), out.rest)


_Pulls = tuple[Array, Array, Array, Array]
"""Of rows (N, r): the pull P r on them, P (N, r, r), their standard deviations, and what is added to their variances
where they are left out."""


def _pulls(W: Array, left_of: tuple[Array, Array], variances: Array, noise: Array) -> _Pulls:
    back = np.swapaxes(W, 1, 2)
    pull = (back @ left_of[0][:, :, None])[:, :, 0]
    return pull, back @ left_of[1] @ W, np.sqrt(variances), LEFT_OUT * np.diagonal(noise, axis1=1, axis2=2)


def _part(pulls: _Pulls, rows: slice) -> _Pulls:
    """The same of some of the rows."""
    pull, projector, size, left_out = pulls
    return pull[:, rows], projector[:, rows, rows], size[:, rows], left_out[:, rows]


def _falls(rows: _Pulls, left_out: BoolArray) -> tuple[Array, Array]:
    """Falls of chi-square (N,) without rows, see `_Pulls`, and directions (N,) in which they have residuals; of those
    that are left out, the chi-square of their readings about what all others predict."""
    pull, Q, size, inflation = rows
    if not pull.size:
        return np.zeros(len(left_out)), np.zeros(len(left_out), dtype=np.int64)
    variance, directions = np.linalg.eigh(Q * size[:, :, None] * size[:, None, :])
    seen = variance > FREE
    square = ((pull * size)[:, None] @ directions)[:, 0] ** 2
    fall = (square / np.where(seen, variance, np.inf)).sum(axis=1)
    count = seen.sum(axis=1)
    for i in np.flatnonzero(left_out):
        kept = variance[i] > ROUNDED * variance[i].max()
        along = directions[i][:, kept]
        spread = np.diag(1.0 / variance[i][kept])
        own = spread - along.T @ np.diag(inflation[i] / size[i] ** 2) @ along
        difference = spread @ along.T @ (pull[i] * size[i])
        fall[i], count[i] = difference @ np.linalg.solve(own, difference), len(difference)
    return fall, count


def sigmas_of(fitted: Fitted, scatter: Scatter) -> tuple[Array, Array, Array]:
    """How far each rest is from the fit by its accelerometers and by its gyros (N,), and each turn (K,), in sigmas.
    Groups that have a `scatter` when nothing is left out are judged by their own scale: that they have none without
    some of them may be by choice of these."""
    out, found = fitted.out, []
    judged = _judged(fitted, fitted.left, fitted.scatter, range(TURNS + 1))
    scales = (scatter.accel, scatter.gyro, scatter.of_turns)
    for (fall, count), left_out, name, scale in zip(
        judged, (out.rest, out.rest, out.turn), GROUPS[:3], scales, strict=True
    ):
        degrees = fitted.fits[name].degrees if name in fitted.fits else 0.0
        k = np.maximum(count, 1)
        others = np.maximum(degrees - k * max(1, left_out.sum()), 1.0)  # what was chosen has taken the largest with it
        chance = special.fdtrc(k, others, fall / k) if scale > 0.0 else special.chdtrc(k, fall)
        found.append(0.0 - special.ndtri(0.5 * np.maximum(chance, LEAST_CHANCE)))
    accel, gyro, turn = found
    return accel, gyro, turn


def _suspect(fitted: Fitted) -> Out | None:
    """With the rest or turn left out too that stands out most among those of a group that scatters, before the scatter
    is allowed for; None where none does."""
    most, found, out, scatter = STANDS_OUT, None, fitted.out, fitted.scatter
    scales = (scatter.accel, scatter.gyro, scatter.of_turns)
    scattering = [group for group, scale in enumerate(scales) if scale > 0.0]
    if not scattering:
        return None
    judged = _judged(fitted, fitted.without, Scatter(), scattering)
    for group, (fall, count) in zip(scattering, judged, strict=True):
        candidates = (count > 0) & ~(out.turn if group == TURNS else out.rest)
        if candidates.sum() < 3:
            continue
        size = np.where(candidates, fall / np.maximum(count, 1), 0.0)
        ratio = size / np.median(size[candidates])
        worst = int(np.argmax(ratio))
        if ratio[worst] > most:
            most, found = float(ratio[worst]), (group, worst)
    if found is None:
        return None
    rest, turn = out.rest.copy(), out.turn.copy()
    (turn if found[0] == TURNS else rest)[found[1]] = True
    return Out(rest=rest, turn=turn)


def without_misfits(everything: Fitted, most: int) -> Fitted:
    """The fit without what does not fit. Suspects, `most` of them, are left out one after the other, for they hide each
    other; those that the others confirm stay out."""
    fitted = everything
    for _ in range(most):
        suspect = _suspect(fitted)
        if suspect is None:
            break
        fitted = _again(everything.problem, fitted, suspect)
    if fitted is everything:
        return everything
    by_accel, by_gyro, turn = sigmas_of(fitted, everything.scatter)
    rest = np.maximum(by_accel, by_gyro)
    confirmed = Out(rest=fitted.out.rest & (rest > FIT_SIGMAS), turn=fitted.out.turn & (turn > FIT_SIGMAS))
    count = confirmed.rest.sum() + confirmed.turn.sum()
    if count == 0:
        return everything
    if count == fitted.out.rest.sum() + fitted.out.turn.sum():
        return fitted
    return _again(everything.problem, fitted, confirmed)


def _again(problem: Problem, fitted: Fitted, out: Out) -> Fitted:
    """The fit with something else left out."""
    return fit_of(problem, At.of(problem, fitted.solved.point, fitted.solved.last.about, out), guess=fitted.scatter)
