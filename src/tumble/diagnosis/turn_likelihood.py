"""How well gyros carry the vertical from rest to rest, whatever their unit, scale, rate and columns: the one cost of
hypotheses about them, of a log that says little (`drafting`) and of a session that says it wrongly
(`carried_vertical`).

Over turns between rests in other attitudes the gyros must carry the vertical, which tells Q, the sum of their numbers
over a turn of one radian:

    −2 ln L(Q) = −2 Σ_k ln(ε + (1 − ε) f(cos m_k; κ_k)),   f(c; κ) = 2κ / (1 − e^{−2κ}) · e^{κ (c − 1)},

m_k the angle by which turn k misses the vertical, f the von Mises–Fisher density of a direction about the one expected,
over that of any direction, 1/κ_k = σ² + (α θ_k)² its variance after a turn by θ_k = path / Q, and ε the share of turns
that are damaged. With many turns it is one narrow valley, with one turn several: a turn by 2π − θ carries alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations, product

import numpy as np

from tumble.units import DEGREE, Array

_STEPS = 192  # rotations that a turn is made of at most: of a whole revolution 2° each
_TOGETHER = 4  # so many of them are taken as one, and so many steps of the grid, where exchanges are first looked at
MOST_TURNS = 24  # the shortest turns, which tell
_MOST_MISFIT = 9.0  # of a turn
_GRID = 0.015  # of ln Q
_PATHS = 40.0, 0.03  # rad, of the median turn, at both ends of the grid
_TILTED = math.cos(8.0 * DEGREE)
_MOST_EXCHANGES = 4
_SCALES = math.log(1e6)  # the range of the logarithm of a scale of which nothing is known


@dataclass(frozen=True, kw_only=True, slots=True)
class Widths:
    """What the cost of a hypothesis hangs on, in one record, so that a study can sweep it."""

    scale: float = 0.015
    """Standard deviation of ln of a scale factor over its nominal value: ±3 % in data sheets of MEMS."""
    offset: float = 0.03
    """The same of the length of gravity where rests do not show the zero: offsets of 50 mg on three axes."""
    vertical: float = 0.06  # Standard deviation of a vertical, rad: offsets of 50 mg before and behind a turn
    axes: float = 0.03  # The same, part of the angle of a turn: axes and scale factors of small sensors
    damaged: float = 0.05  # Share of turns of which the gyros do not say where they led: clipped, cut, torn
    exchanged: float = 0.03  # Share of logs whose gyros have other axes or signs, chosen by hand
    named_wrongly: float = 0.003  # Share of gyros in another unit than their name says, chosen by hand
    turning: float = 1.2
    """Standard deviation of ln of the rate of turning by hand or on a table over 1 rad/s, from 10 to 500 °/s."""
    near: float = 6.0
    """Two candidates are near each other up to this difference of their cost: the second is 20 times less likely."""


WIDTHS = Widths()


def cost_of_free_scale(deviation: float, range_of_logarithm: float = _SCALES) -> float:
    """What it costs that a number may be any in a range of its logarithm, against one of a table: the density of a
    Gaussian of this standard deviation over an even one."""
    return 2.0 * math.log(range_of_logarithm / (deviation * math.sqrt(2.0 * math.pi)))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TurnLikelihood:
    """−2 ln L (G,) over an even grid of ln Q (G,), and that of gyros that turn nothing, with an `exchange` (3, 3) of
    the gyros' columns and signs, reading = exchange · rate, which itself costs `exchanged`."""

    log_q: Array
    cost: Array
    misfit: Array
    """The squares of what the turns miss, over variances that do not depend on Q, which pull it neither up nor down."""
    unturned: float
    exchange: Array
    exchanged: float

    @property
    def least(self) -> float:
        """The least cost, the exchange included."""
        return float(self.cost.min()) + self.exchanged

    def of_nominal(self, deviation: float) -> TurnLikelihood:
        """The same over a nominal Q: the least over δ of cost(ln Q + δ) + (δ / deviation)²."""
        shifts = np.linspace(-4.0, 4.0, 2 * round(8.0 * deviation / _GRID) + 1)
        costs = [np.interp(self.log_q + deviation * d, self.log_q, self.cost) + d**2 for d in shifts]
        return replace(self, cost=np.min(costs, axis=0))

    def at(self, log_q: float) -> float:
        """The cost of one ln Q, and of the exchange."""
        return float(np.interp(log_q, self.log_q, self.cost, left=0.0, right=self.unturned)) + self.exchanged

    def found(self, log_q: float | None = None, within: float = 0.1) -> float:
        """Q with which the turns miss least, near the least cost of all or within so much of one ln Q."""
        log_q = float(self.log_q[np.argmin(self.cost)]) if log_q is None else log_q
        near = np.flatnonzero(np.abs(self.log_q - log_q) <= within)
        if not len(near):
            return float(np.exp(log_q))
        k = int(near[np.argmin(self.misfit[near])])
        a, b, c = (float(self.misfit[min(max(k + j, 0), len(self.misfit) - 1)]) for j in (-1, 0, 1))
        peak = 0.5 * (a - c) / (a - 2.0 * b + c) if b < min(a, c) else 0.0  # of the parabola through three points
        return float(np.exp(self.log_q[k] + _GRID * peak))


def ends_tilted(before: Array, behind: Array) -> bool:
    """Whether the vertical (3,) behind a turn is another than before it, so that it tells of the turn."""
    return bool(before @ behind < _TILTED)


def turn_likelihoods(
    turns: Sequence[tuple[Array, Array, Array]], widths: Widths = WIDTHS
) -> tuple[TurnLikelihood, ...]:
    """The likelihood of the columns as they are, and where that does not explain the turns those of the exchanges that
    do; none where nothing turned. Of each turn what the gyros read above their bias times the interval, sample by
    sample (m, 3), and the verticals (3,) before and behind it; the shortest are taken."""
    turns = sorted(turns, key=lambda turn: len(turn[0]))[:MOST_TURNS]
    longest = min(_STEPS, max((len(turn[0]) for turn in turns), default=0))
    steps = np.zeros((len(turns), -(-longest // _TOGETHER) * _TOGETHER, 3))
    for row, (sums, _, _) in zip(steps, turns, strict=True):
        edges = np.linspace(0, len(sums), min(_STEPS, len(sums)), endpoint=False).astype(int)
        row[: len(edges)] = np.add.reduceat(sums, edges, axis=0)
    path = np.linalg.norm(steps, axis=2).sum(axis=1)
    middle = float(np.median(path)) if turns else 0.0
    if not 0.0 < middle < math.inf:
        return ()
    before, behind = (np.array([turn[end] for turn in turns]) for end in (1, 2))
    low, high = (math.log(middle / angle) for angle in _PATHS)

    def likelihoods(exchanges: Sequence[Array], grid: float, together: int, most: int) -> list[TurnLikelihood]:
        log_q = np.arange(low, high, grid)
        q = np.append(np.exp(log_q), np.inf)[:, None]
        sums = steps[:most].reshape(min(len(turns), most), -1, together, 3).sum(axis=2)
        cosines = np.empty((len(exchanges), *(q / path[:most]).shape))
        for sense in (1.0, -1.0):  # gyros that are a mirror image turn the other way
            own = np.linalg.det(exchanges) * sense > 0.0
            if own.any():
                of_gyros = [np.einsum("eij,kj->eki", np.array(exchanges)[own], end[:most]) for end in (before, behind)]
                cosines[own] = _cosines(sense * sums, of_gyros[0], of_gyros[1], q)
        kappa = 1.0 / (widths.vertical**2 + (widths.axes * path[:most] / q) ** 2)
        most_density, out = 2.0 * kappa / -np.expm1(-2.0 * kappa), []
        for exchange, cosine in zip(exchanges, cosines, strict=True):
            density = most_density * np.exp(kappa * (np.minimum(cosine, 1.0) - 1.0))
            cost = -2.0 * np.log(widths.damaged + (1.0 - widths.damaged) * density).sum(axis=1)
            least = kappa[np.argmin(cost[:-1])]
            unlike = not np.array_equal(exchange, np.eye(3))
            out.append(
                TurnLikelihood(
                    log_q=log_q,
                    cost=cost[:-1],
                    misfit=np.minimum(2.0 * least * (1.0 - cosine[:-1]), _MOST_MISFIT).sum(axis=1),
                    unturned=cost[-1],
                    exchange=exchange,
                    exchanged=-2.0 * math.log(widths.exchanged / 47.0) if unlike else 0.0,
                )
            )
        return out

    as_they_are, *exchanges = signed_permutations()
    (first,) = likelihoods([as_they_are], _GRID, 1, MOST_TURNS)
    attainable = -2.0 * len(turns) * math.log(2.0 / widths.vertical**2)
    if first.least < 0.5 * attainable:
        return (first,)
    rough = sorted(likelihoods(exchanges, _TOGETHER * _GRID, _TOGETHER, MOST_TURNS // 2), key=lambda p: p.least)
    return first, *likelihoods([p.exchange for p in rough[:_MOST_EXCHANGES]], _GRID, 1, MOST_TURNS)


def _cosines(steps: Array, before: Array, behind: Array, q: Array) -> Array:
    """Cosines (E, G, K) of what turns by rotations of steps (K, B, 3) / q (G, 1) miss from verticals before them to
    those behind them, (E, K, 3) each."""
    length = np.linalg.norm(steps, axis=2)
    axes = steps / np.maximum(length, 1e-300)[..., None]
    x, y, z = np.moveaxis(behind[:, None], -1, 0)  # carried back
    for k in reversed(range(steps.shape[1])):
        angle, (u, v, w) = length[:, k] / q, axes[:, k].T
        c, s = np.cos(angle), np.sin(angle)
        us, vs, ws, rest = u * s, v * s, w * s, 1.0 - c
        uv, uw, vw = u * v * rest, u * w * rest, v * w * rest
        x, y, z = (
            (c + u * u * rest) * x + (uv - ws) * y + (uw + vs) * z,
            (uv + ws) * x + (c + v * v * rest) * y + (vw - us) * z,
            (uw - vs) * x + (vw + us) * y + (c + w * w * rest) * z,
        )
    of_x, of_y, of_z = np.moveaxis(before[:, None], -1, 0)
    return np.asarray(of_x * x + of_y * y + of_z * z)


# -------------------- columns that are exchanged or have the wrong sign --------------------


def signed_permutations() -> list[Array]:
    """All ways to exchange columns and signs, those with the fewest changes first."""
    orders, signs = permutations(range(3)), list(product((1.0, -1.0), repeat=3))
    every = [np.array(sign)[:, None] * np.eye(3)[list(order)] for order in orders for sign in signs]
    return sorted(every, key=lambda exchange: min(_readings(exchange))[0])


def columns_text(exchange: Array) -> str:
    """The simplest readings of a signed permutation of the gyros, in words."""
    readings = _readings(exchange)
    simplest = [words for changes, words in readings if changes == min(readings)[0]]
    return f"{' or '.join(simplest)} (relative to the other sensors)"


def _readings(exchange: Array) -> list[tuple[int, str]]:
    """What a signed permutation of the gyros may be, with the number of changes: theirs, or, unless it is a mirror
    image, one of the accelerometers, of which only the directions up to a common sign show in turns."""
    meant, readings = [("gyro", exchange)], list[tuple[int, str]]()
    if np.linalg.det(exchange) > 0.0:
        meant += [("accelerometer", exchange.T), ("accelerometer", -exchange.T)]
    for sensors, matrix in meant:
        order = ["xyz"[k] for k in np.abs(matrix).argmax(axis=1)]
        moved = [axis for axis, read in zip("xyz", order, strict=True) if axis != read]
        wrong = [axis for axis, row in zip("xyz", matrix, strict=True) if row.sum() < 0.0]
        how = "are exchanged" if len(moved) == 2 else f"are in the order {', '.join(order)}"
        named = f" {' and '.join(moved)}" if len(moved) == 2 else ""
        parts = [f"the {sensors} columns{named} {how}"] if moved else []
        parts += [f"the sign of {sensors} {', '.join(wrong)} is wrong"] if wrong else []
        readings.append((len(moved + wrong), " and ".join(parts)))
    return readings
