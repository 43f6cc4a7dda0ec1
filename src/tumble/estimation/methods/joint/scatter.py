"""Scatter on top of the noise within rests, by restricted maximum likelihood.

With D = ∂Σ/∂σ² and P the projector onto residuals (A3): score ½(rᵀPDPr − tr PD), information ½ tr PDPD of which the
part within a rest and its turn is taken. A component counts where chance alone would exceed its score less often than
SCATTER_PROBABILITY.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from tumble.estimation.likelihood import COMPONENTS, Noise, Problem, Scatter, Weights
from tumble.estimation.methods.joint.iteration import At
from tumble.estimation.residual_loops import score
from tumble.estimation.step import Left, Step, left
from tumble.units import Array, BoolArray

SCATTER_PROBABILITY = 0.25
"""A component of scatter is estimated where chance alone would exceed its score less often than this. A limit at the
median would find scatter in most sessions that have none, and give intervals that cover too much; a strict one would
miss scatter that is there."""
SCATTER_STEPS = 40
CLOSELY = 5e-4  # of the standard deviation of a component of variance: what a step would still change
ROUGHLY = 0.005  # likewise, where priors that are about to be widened will change it anyway
FURTHEST = 1e3  # of it, that a step may go: two components that nearly are one would send each other anywhere
LEAST_DEGREES = 0.5
"""Of freedom: a component of scatter of which the fit leaves less is not estimated. It is by what is left of it, in the
end by rounding, that its variance would be divided."""
SHARES = (0.25, 3.0)  # what a step of scoring may be of that by the information


def seen_components(problem: Problem, noise: Noise, after: Left, weight: Weights) -> BoolArray:
    """Whether a fit leaves something of each component (c,) of scatter."""
    degrees, last = np.zeros(len(COMPONENTS)), problem.link < 0
    at_rest, of_rest = noise.rest_directions
    rows = (weight.rest[last], after.rest[1][last]), (weight.merged, after.merged[1])
    for (W, covariance), (Z, of) in zip(rows, ((at_rest[last], of_rest), noise.merged_directions), strict=True):
        WZ = W @ Z
        whole, left_of = (WZ**2).sum(axis=1), (WZ * (covariance @ WZ)).sum(axis=1)
        np.add.at(degrees, of, (left_of / np.where(whole > 0.0, whole, 1.0)).sum(axis=0))
    return np.asarray(degrees > LEAST_DEGREES)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Scattered:
    """The components of scatter, the covariance (c, c) of their variances, the step with them and what it leaves, and
    the `share` of a step of scoring that was right."""

    scatter: Scatter
    components: Array
    step: Step
    left: Left
    share: float = 1.0

    @staticmethod
    def begun(step: Step, after: Left, scatter: Scatter, share: float = 1.0) -> Scattered:
        """Where a search begins, with a scatter."""
        none = np.zeros((len(COMPONENTS), len(COMPONENTS)))
        return Scattered(scatter=scatter, components=none, step=step, left=after, share=share)


def scatter_of(
    problem: Problem, at: At, begun: Scattered, seen: BoolArray, within: float, guess: Scatter | None = None
) -> Scattered:
    """The components of scatter that are `seen` (c,) by restricted maximum likelihood at one linearisation, from those
    with which it has `begun`, `within` so much; where there were none, by way of a `guess`. Steps of Fisher scoring,
    halved while the likelihood falls. The information lacks what rests and turns tell of each other: only a `share` of
    a step is right, the part that the change before was of how much less the scoring asked for after it, as if what it
    asks for were linear."""
    step, after, share, found, variance = begun.step, begun.left, begun.share, begun.scatter, begun.scatter.variances
    active, change, before = variance > 0.0, np.zeros_like(variance), np.zeros_like(variance)
    deviance, slope, information = step.deviance, *_scored(problem, at, step, after)
    if not active.any():
        size = np.sqrt(np.where(information.diagonal() > 0.0, information.diagonal(), np.inf))
        active = seen & (slope / size > -special.ndtri(SCATTER_PROBABILITY))
    for _ in range(SCATTER_STEPS):
        active &= (variance > 0.0) | (slope > 0.0)
        if not active.any():
            break
        scoring = np.zeros_like(variance)
        scoring[active] = np.linalg.solve(information[np.ix_(active, active)], slope[active])
        change[~active] = 0.0
        if change.any():
            expected, less = change @ information @ change, change @ information @ (before - scoring)
            share = float(np.clip(expected / less, *SHARES)) if less > 0.0 else SHARES[1]
        deviation = np.where(active, 1.0 / np.sqrt(np.where(active, information.diagonal(), 1.0)), np.inf)
        wanted = np.clip(variance + share * scoring, 0.0, variance + FURTHEST * deviation)
        if np.all(np.abs(wanted - variance) <= within * deviation):
            break
        if guess is not None and not variance.any():
            wanted = np.where(active & (guess.variances > 0.0), guess.variances, wanted)
        before, old = scoring, variance
        for _ in range(5):
            found, variance = Scatter.of_variances(wanted), wanted
            step = at.solved(problem, found)
            if step.deviance <= deviance + 1e-6:
                break
            wanted = 0.5 * (wanted + old)
        after, change = left(problem, step), variance - old
        deviance, slope, information = step.deviance, *_scored(problem, at, step, after)
    active = variance > 0.0
    components = np.zeros((len(COMPONENTS), len(COMPONENTS)))
    if active.any():
        components[np.ix_(active, active)] = np.linalg.inv(information[np.ix_(active, active)])
    return Scattered(scatter=found, components=components, step=step, left=after, share=share)


def _scored(problem: Problem, at: At, step: Step, after: Left) -> tuple[Array, Array]:
    """The score (c,) of the restricted likelihood and its information (c, c) with respect to the variances, at a step
    with them and what it leaves. Raises LinAlgError where residuals are beyond all measure."""
    weight, last = step.told.weights, problem.link < 0
    slope, information = np.zeros(len(COMPONENTS)), np.zeros((len(COMPONENTS),) * 2)
    (at_rest, of_rest), (Z, of_merged) = at.noise.rest_directions, at.noise.merged_directions
    score(weight.rest[last] @ at_rest[last], of_rest, (after.rest[0][last], after.rest[1][last]), slope, information)
    score(weight.merged @ Z, of_merged, after.merged, slope, information)
    if not (np.isfinite(slope).all() and np.isfinite(information).all()):
        raise np.linalg.LinAlgError("residuals are beyond all measure")
    return slope, information
