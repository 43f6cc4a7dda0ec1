"""Scatter on top of the noise within rests, by restricted maximum likelihood.

With D = ∂Σ/∂σ² and P the projector onto residuals (A3): score ½(rᵀPDPr − tr PD), information ½ tr PDPD of which the
part within a rest and its turn is taken. A component counts where chance alone would exceed its score less often than
SCATTER_PROBABILITY.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import special

from tumble.estimation.components import COMPONENTS, Noise, Scatter, Weights
from tumble.estimation.likelihood import Problem
from tumble.estimation.methods.joint.iteration import At
from tumble.estimation.residual_loops import score
from tumble.estimation.step import Left, Step, left
from tumble.units import Array, BoolArray

SCATTER_PROBABILITY = 0.25
"""A component of scatter is estimated where chance alone would exceed its score less often than this. A limit at the
median would find scatter in most sessions that have none, and give intervals that cover too much; a strict one would
miss scatter that is there."""
SCATTER_SIGMAS = -float(special.ndtri(SCATTER_PROBABILITY))
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
    degrees, last = np.zeros(len(COMPONENTS)), problem.unlinked
    at_rest, of_rest = noise.rest_directions
    rows = (weight.rest[last], after.rest[1][last]), (weight.merged, after.merged[1])
    for (W, covariance), (Z, of) in zip(rows, ((at_rest[last], of_rest), noise.merged_directions), strict=True):
        WZ = W @ Z
        whole, left_of = (WZ**2).sum(axis=1), (WZ * (covariance @ WZ)).sum(axis=1)
        share = (left_of / np.where(whole > 0.0, whole, 1.0)).sum(axis=0)
        degrees += np.bincount(of, share, len(degrees))
    return np.asarray(degrees > LEAST_DEGREES)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Scattered:
    """The components of scatter, the step with them and what it leaves, the score (c,) of the likelihood there and its
    information (c, c), and the `share` of a step of scoring that was right."""

    scatter: Scatter
    step: Step
    left: Left
    slope: Array
    information: Array
    share: float = 1.0

    @staticmethod
    def of(problem: Problem, at: At, scatter: Scatter, step: Step, share: float = 1.0) -> Scattered:
        """What a step with a scatter leaves, and the score there."""
        after = left(problem, step)
        slope, information = _scored(problem, at, step, after)
        return Scattered(scatter=scatter, step=step, left=after, slope=slope, information=information, share=share)

    @property
    def components(self) -> Array:
        """The covariance (c, c) of the variances of the components that there are."""
        found, active = np.zeros_like(self.information), np.flatnonzero(self.scatter.variances)
        if active.size:
            own = np.ix_(active, active)
            found[own] = np.linalg.inv(self.information[own])
        return found


def scatter_of(
    problem: Problem, at: At, begun: Scattered, seen: BoolArray, within: float, guess: Scatter | None = None
) -> Scattered:
    """The components of scatter that are `seen` (c,) by restricted maximum likelihood at one linearisation, from those
    with which it has `begun`, `within` so much; where there were none, by way of a `guess`. Steps of Fisher scoring,
    halved while the likelihood falls. The information lacks what rests and turns tell of each other: only a `share` of
    a step is right, the part that the change before was of how much less the scoring asked for after it, as if what it
    asks for were linear."""
    found, share, variance = begun, begun.share, begun.scatter.variances
    active, change, before = variance > 0.0, np.zeros_like(variance), np.zeros_like(variance)
    if not active.any():
        active = seen & _shows(found)
    for _ in range(SCATTER_STEPS):
        slope, information = found.slope, found.information
        active &= (variance > 0.0) | (slope > 0.0)
        on = np.flatnonzero(active)
        if not on.size:
            break
        scoring, deviation = np.zeros_like(variance), np.full_like(variance, np.inf)
        scoring[on] = np.linalg.solve(information[on[:, None], on], slope[on])
        deviation[on] = 1.0 / np.sqrt(information[on, on])
        change[~active] = 0.0
        if change.any():
            expected, less = change @ information @ change, change @ information @ (before - scoring)
            share = min(max(float(expected / less), SHARES[0]), SHARES[1]) if less > 0.0 else SHARES[1]
        wanted = np.minimum(np.maximum(variance + share * scoring, 0.0), variance + FURTHEST * deviation)
        if np.all(np.abs(wanted - variance) <= within * deviation):
            break
        if guess is not None and not variance.any():
            wanted = np.where(active & (guess.variances > 0.0), guess.variances, wanted)
        before, old = scoring, variance
        found, variance = _likelier(problem, at, found, variance, wanted)
        change = variance - old
    return replace(found, share=share)


def _shows(found: Scattered) -> BoolArray:
    """Whether there is more of each component (c,) than chance would make."""
    own = found.information.diagonal()
    return np.asarray(found.slope > SCATTER_SIGMAS * np.sqrt(np.where(own > 0.0, own, np.inf)))


def _likelier(problem: Problem, at: At, found: Scattered, variance: Array, wanted: Array) -> tuple[Scattered, Array]:
    """The step with the variances (c,) that are wanted, or with others on the way there where these are less likely
    than those there are, and its variances."""
    for _ in range(5):
        tried, wanted = wanted, 0.5 * (wanted + variance)
        scatter = Scatter.of_variances(tried)
        step = at.solved(problem, scatter)
        if step.deviance <= found.step.deviance + 1e-6:
            break
    return Scattered.of(problem, at, scatter, step), tried


def _scored(problem: Problem, at: At, step: Step, after: Left) -> tuple[Array, Array]:
    """The score (c,) of the restricted likelihood and its information (c, c) with respect to the variances, at a step
    with them and what it leaves. Raises LinAlgError where residuals are beyond all measure."""
    weight, last = step.told.weights, problem.unlinked
    slope, information = np.zeros(len(COMPONENTS)), np.zeros((len(COMPONENTS),) * 2)
    (at_rest, of_rest), (Z, of_merged) = at.noise.rest_directions, at.noise.merged_directions
    score(weight.rest[last] @ at_rest[last], of_rest, (after.rest[0][last], after.rest[1][last]), slope, information)
    score(weight.merged @ Z, of_merged, after.merged, slope, information)
    if not (np.isfinite(slope).all() and np.isfinite(information).all()):
        raise np.linalg.LinAlgError("residuals are beyond all measure")
    return slope, information
