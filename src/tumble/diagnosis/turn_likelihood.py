"""Likelihood of the turns of gyros of unknown unit, scale, rate and columns: the cost of hypotheses about an unfamiliar
log (`drafting`) and about a session that may be stated wrongly (`carried_vertical`).

Gyros must carry the vertical through turns between rests in different attitudes. This determines Q, the sum of their
readings over a turn of one radian:

    −2 ln L(Q) = −2 Σ_k ln(ε + (1 − ε) f(cos m_k; κ_k)),   f(c; κ) = 2κ / (1 − e^{−2κ}) · e^{κ (c − 1)}

where m_k is the angle by which turn k misses the vertical, f the von Mises–Fisher density of a direction relative to
the uniform one, 1/κ_k = σ² + (α θ_k)² its variance after a turn by θ_k = path / Q, and ε the share of damaged turns.
With many turns L has one narrow maximum, with one turn several, as a turn by 2π − θ carries the vertical alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tumble.rotation import signed_permutations
from tumble.units import DEGREE, Array

MOST_STEPS = 192  # rotations per turn: 2° each in a whole revolution
COARSE = 4  # steps, and grid points, that are merged when all exchanges of columns are tried
MOST_TURNS = 24  # of the shortest turns, which carry most information
MOST_EXCHANGES = 4
LARGEST_MISFIT = 9.0  # of a turn
GRID = 0.015  # of ln Q
GRID_PATHS = 40.0, 0.03  # rad, of the median turn, at both ends of the grid
TILTED = math.cos(8.0 * DEGREE)  # largest cosine between verticals that differ
LARGEST_FACTOR = 4000.0  # of the readings of one column: °/h for °/s
SCALE_RANGE = math.log(1e6)  # range of the logarithm of an unknown scale


@dataclass(frozen=True, kw_only=True, slots=True)
class Widths:
    """Widths and probabilities of the priors of a hypothesis, in one record that a study can vary."""

    scale: float = 0.015
    """Standard deviation of ln of a scale factor over its nominal value: ±3 % in data sheets of MEMS."""
    offset: float = 0.03
    """The same for the length of gravity if rests do not determine the zero: offsets of 50 mg on three axes."""
    vertical: float = 0.06
    """Standard deviation of a vertical, rad: offsets of 50 mg before and after a turn."""
    axes: float = 0.03
    """The same, relative to the angle of a turn: axes and scale factors of small sensors."""
    damaged: float = 0.05
    """Share of turns that are clipped, cut or torn."""
    exchanged: float = 0.03
    """Share of logs whose gyros have other axes or signs; an estimate."""
    named_wrongly: float = 0.003
    """Share of gyros in another unit than their name says; an estimate."""
    turning: float = 1.2
    """Standard deviation of ln of the rate of turns over 1 rad/s, by hand or on a table: from 10 to 500 °/s."""
    near: float = 6.0
    """Difference of cost at which the second of two candidates is 20 times less likely."""


WIDTHS = Widths()


def cost_of_free_scale(deviation: float, range_of_logarithm: float = SCALE_RANGE) -> float:
    """Return the cost of a scale that may be anywhere in a range of its logarithm, relative to a tabulated one: the
    ratio of a Gaussian density of this standard deviation to a uniform one."""
    return 2.0 * math.log(range_of_logarithm / (deviation * math.sqrt(2.0 * math.pi)))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TurnLikelihood:
    """Likelihood of the turns over a grid of ln Q, for one assignment of the columns."""

    log_q: Array  # (G,), evenly spaced
    cost: Array  # (G,): −2 ln L
    misfit: Array  # (G,): squared angles that the turns miss, over variances that do not depend on Q, so without bias
    unturned: float  # cost of gyros that read no rotation
    exchange: Array  # (3, 3): reading = exchange · rate, a signed permutation
    exchanged: float  # its cost

    @staticmethod
    def of(log_q: Array, cosine: Array, angle: Array, widths: Widths, exchange: Array) -> TurnLikelihood:
        """Return the likelihood of K turns by `angle` (G + 1, K), rad, that miss the vertical by angles of this cosine
        (G + 1, K), the last without rotation."""
        kappa = 1.0 / (widths.vertical**2 + (widths.axes * angle) ** 2)
        density = 2.0 * kappa / -np.expm1(-2.0 * kappa) * np.exp(kappa * (np.minimum(cosine, 1.0) - 1.0))
        cost = -2.0 * np.log(widths.damaged + (1.0 - widths.damaged) * density).sum(axis=1)
        kappa_at_best = kappa[np.argmin(cost[:-1])]
        return TurnLikelihood(
            log_q=log_q,
            cost=cost[:-1],
            misfit=np.minimum(2.0 * kappa_at_best * (1.0 - cosine[:-1]), LARGEST_MISFIT).sum(axis=1),
            unturned=cost[-1],
            exchange=exchange,
            exchanged=0.0 if np.array_equal(exchange, np.eye(3)) else -2.0 * math.log(widths.exchanged / 47.0),
        )

    @property
    def least(self) -> float:
        """Least cost, with that of the exchange."""
        return float(self.cost.min()) + self.exchanged

    def of_nominal(self, deviation: float) -> TurnLikelihood:
        """Return the likelihood over a nominal Q: the least over δ of cost(ln Q + δ) + (δ / deviation)²."""
        shifts = np.linspace(-4.0, 4.0, 2 * round(8.0 * deviation / GRID) + 1)
        costs = [np.interp(self.log_q + deviation * d, self.log_q, self.cost) + d**2 for d in shifts]
        return replace(self, cost=np.min(costs, axis=0))

    def at(self, log_q: float) -> float:
        """Return the cost of one ln Q, with that of the exchange."""
        return float(np.interp(log_q, self.log_q, self.cost, left=0.0, right=self.unturned)) + self.exchanged

    def best_q(self, log_q: float | None = None, within: float = 0.1) -> float:
        """Return the Q of least misfit within an interval of ln Q, by default about the least cost."""
        log_q = float(self.log_q[np.argmin(self.cost)]) if log_q is None else log_q
        near = np.flatnonzero(np.abs(self.log_q - log_q) <= within)
        if not len(near):
            return float(np.exp(log_q))
        k = int(near[np.argmin(self.misfit[near])])
        a, b, c = (float(self.misfit[min(max(k + j, 0), len(self.misfit) - 1)]) for j in (-1, 0, 1))
        peak = 0.5 * (a - c) / (a - 2.0 * b + c) if b < min(a, c) else 0.0  # of the parabola through three points
        return float(np.exp(self.log_q[k] + GRID * peak))


def ends_tilted(before: Array, behind: Array) -> bool:
    """Return True if a turn changes the vertical (3,), so that it carries information."""
    return bool(before @ behind < TILTED)


def least_cost(turns: int, vertical: float) -> float:
    """Return the cost of a number of short turns that carry verticals with this standard deviation, rad, exactly."""
    return -2.0 * turns * math.log(2.0 / vertical**2)


def turn_likelihoods(
    turns: Sequence[tuple[Array, Array, Array]], widths: Widths = WIDTHS
) -> tuple[TurnLikelihood, ...]:
    """Return the likelihood of the columns as stated and, if that is poor, those of the best exchanges of columns.

    Parameters
    ----------
    turns
        For each turn the readings above their bias times the interval of each sample (m, 3), and the verticals (3,)
        before and after it. The shortest turns are used.
    widths
        Widths of the priors.

    Returns
    -------
    tuple of TurnLikelihood
        The first of the stated columns; empty if nothing turned.
    """
    steps, before, behind = _steps_of(turns)
    path = np.linalg.norm(steps, axis=2).sum(axis=1)
    middle = float(np.median(path)) if len(path) else 0.0
    if not 0.0 < middle < math.inf:
        return ()
    low, high = (math.log(middle / angle) for angle in GRID_PATHS)

    def likelihoods(exchanges: Sequence[Array], grid: float, merged: int, most: int) -> list[TurnLikelihood]:
        log_q = np.arange(low, high, grid)
        q = np.append(np.exp(log_q), np.inf)[:, None]
        sums = steps[:most].reshape(min(len(steps), most), -1, merged, 3).sum(axis=2)
        cosines = np.empty((len(exchanges), *(q / path[:most]).shape))
        for sign in (1.0, -1.0):  # mirrored gyros turn the other way
            signed = np.linalg.det(exchanges) * sign > 0.0
            if signed.any():
                start, end = (np.einsum("eij,kj->eki", np.array(exchanges)[signed], v[:most]) for v in (before, behind))
                cosines[signed] = _cosines(sign * sums, start, end, q)
        pairs = zip(exchanges, cosines, strict=True)
        return [TurnLikelihood.of(log_q, cosine, path[:most] / q, widths, exchange) for exchange, cosine in pairs]

    stated, *exchanges = sorted(signed_permutations(), key=lambda exchange: min(_explanations(exchange))[0])
    (first,) = likelihoods([stated], GRID, 1, MOST_TURNS)
    if first.least < 0.5 * least_cost(len(steps), widths.vertical):
        return (first,)
    rough = sorted(likelihoods(exchanges, COARSE * GRID, COARSE, MOST_TURNS // 2), key=lambda p: p.least)
    return first, *likelihoods([p.exchange for p in rough[:MOST_EXCHANGES]], GRID, 1, MOST_TURNS)


def column_likelihoods(
    turns: Sequence[tuple[Array, Array, Array]], axes: Array, factor: Array, widths: Widths = WIDTHS
) -> list[TurnLikelihood]:
    """Return for each gyro of a triad, with rows of `axes` (3, 3), the likelihood of the turns over the logarithm of
    the ratio by which its readings alone, those stated times `factor` (3,), are too large.

    `turns` and `widths` are those of `turn_likelihoods`."""
    steps, before, behind = _steps_of(turns)
    readings = factor * (steps.reshape(len(steps), -1, COARSE, 3).sum(axis=2) @ axes.T)
    log_ratio, likelihoods = np.arange(-math.log(LARGEST_FACTOR), math.log(LARGEST_FACTOR), GRID), []
    for column in range(3):
        scaled = np.tile(readings, (len(log_ratio) + 1, 1, 1, 1))
        scaled[..., column] /= np.append(np.exp(log_ratio), np.inf)[:, None, None]
        scaled = scaled @ np.linalg.inv(axes).T
        (cosine,) = _cosines(scaled, before[None], behind[None], np.ones(1))
        angle = np.linalg.norm(scaled, axis=3).sum(axis=2)
        likelihoods.append(TurnLikelihood.of(log_ratio, cosine, angle, widths, np.eye(3)))
    return likelihoods


def _steps_of(turns: Sequence[tuple[Array, Array, Array]]) -> tuple[Array, Array, Array]:
    """Return the shortest turns as sums of readings (K, B, 3), with the verticals (K, 3) before and after them."""
    turns = sorted(turns, key=lambda turn: len(turn[0]))[:MOST_TURNS]
    longest = min(MOST_STEPS, max((len(turn[0]) for turn in turns), default=0))
    steps = np.zeros((len(turns), -(-longest // COARSE) * COARSE, 3))
    for row, (sums, _, _) in zip(steps, turns, strict=True):
        edges = np.linspace(0, len(sums), min(MOST_STEPS, len(sums)), endpoint=False).astype(int)
        row[: len(edges)] = np.add.reduceat(sums, edges, axis=0)
    before, behind = (np.array([turn[end] for turn in turns]) for end in (1, 2))
    return steps, before, behind


def _cosines(steps: Array, before: Array, behind: Array, q: Array) -> Array:
    """Return the cosines (E, G, K) of the angles by which turns miss the vertical.

    Turns consist of rotations steps (K, B, 3) or (G, K, B, 3), over q (G, 1) or 1, from verticals `before` to `behind`
    (E, K, 3)."""
    length = np.linalg.norm(steps, axis=-1)
    axes = steps / np.maximum(length, 1e-300)[..., None]
    x, y, z = np.moveaxis(behind[:, None], -1, 0)  # carried back
    for k in reversed(range(steps.shape[-2])):
        angle, (u, v, w) = length[..., k] / q, np.moveaxis(axes[..., k, :], -1, 0)
        c, s = np.cos(angle), np.sin(angle)
        us, vs, ws, rest = u * s, v * s, w * s, 1.0 - c
        uv, uw, vw = u * v * rest, u * w * rest, v * w * rest
        x, y, z = (
            (c + u * u * rest) * x + (uv - ws) * y + (uw + vs) * z,
            (uv + ws) * x + (c + v * v * rest) * y + (vw - us) * z,
            (uw - vs) * x + (vw + us) * y + (c + w * w * rest) * z,
        )
    before_x, before_y, before_z = np.moveaxis(before[:, None], -1, 0)
    return np.asarray(before_x * x + before_y * y + before_z * z)


# -------------------- columns that are exchanged or have the wrong sign --------------------


def columns_text(exchange: Array) -> str:
    """Return the simplest explanations of a signed permutation of the gyros.

    Rates are pseudovectors: in a left-handed frame gyros read −ω of the turns that the accelerometers see."""
    explanations = _explanations(exchange)
    simplest = [words for changes, words in explanations if changes == min(explanations)[0]]
    text = f"{' or '.join(simplest)} (relative to the other sensors)"
    if np.array_equal(exchange, -np.eye(3)):
        text += (
            ", or both triads are left-handed: one axis of each is reversed (name it by axes in [log.accel] and "
            "[log.gyro], y as [[1, 0, 0], [0, -1, 0], [0, 0, 1]])"
        )
    return text


def _explanations(exchange: Array) -> list[tuple[int, str]]:
    """Return explanations of a signed permutation of the gyros, each with its number of changes.

    It is one of the gyros or, unless it is a mirror image, one of the accelerometers, whose directions turns determine
    up to a common sign."""
    matrices, explanations = [("gyro", exchange)], list[tuple[int, str]]()
    if np.linalg.det(exchange) > 0.0:
        matrices += [("accelerometer", exchange.T), ("accelerometer", -exchange.T)]
    for sensors, matrix in matrices:
        order = ["xyz"[k] for k in np.abs(matrix).argmax(axis=1)]
        moved = [axis for axis, read in zip("xyz", order, strict=True) if axis != read]
        wrong = [axis for axis, row in zip("xyz", matrix, strict=True) if row.sum() < 0.0]
        how = "are exchanged" if len(moved) == 2 else f"are in the order {', '.join(order)}"
        named = f" {' and '.join(moved)}" if len(moved) == 2 else ""
        parts = [f"the {sensors} columns{named} {how}"] if moved else []
        parts += [f"the sign of {sensors} {', '.join(wrong)} is wrong"] if wrong else []
        explanations.append((len(moved + wrong), " and ".join(parts)))
    return explanations
