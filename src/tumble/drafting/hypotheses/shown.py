"""What a recording shows of its sensors before any unit, scale or rate is known.

The log is read once, as raw numbers at a rate that need not be its own, and rests are told by the accelerometers, whose
scatter needs no unit. Of the rests come the length of gravity in raw numbers, the zero about which it turns, and what
the gyros read. Over the turns between them the gyros must carry the vertical, which tells Q, the sum of a gyro's raw
numbers over a turn of one radian:

    −2 ln L(Q) = −2 Σ_k ln(ε + (1 − ε) f(cos m_k; κ_k)),   f(c; κ) = 2κ / (1 − e^{−2κ}) · e^{κ (c − 1)},

m_k the angle by which turn k misses the vertical, f the von Mises–Fisher density of a direction about the one expected,
over that of any direction, 1/κ_k = σ² + (α θ_k)² its variance after a turn by θ_k = path / Q, and ε the share of turns
that are damaged. With many turns it is one narrow valley, with one turn several: a turn by 2π − θ carries alike.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from tumble.diagnosis.carried_vertical import signed_permutations
from tumble.drafting.draft import Draft
from tumble.drafting.times import ASSUMED_RATE
from tumble.errors import TumbleError
from tumble.recording.columns.names import ACCEL
from tumble.recording.columns.numbers import MIDDLES
from tumble.recording.columns.scales import NEAR, off_table
from tumble.recording.log import open_log
from tumble.reduction.blocks.reducer import Reduction, reduce_log
from tumble.reduction.blocks.tuning import USUAL, Tuning
from tumble.reduction.rests.rests import sphere_through
from tumble.reduction.rests.segmentation import RestSpan, find_rests
from tumble.rotation import unit_vector
from tumble.run.observed import LARGEST_SQUARED, Progress
from tumble.sensors.model import Block
from tumble.units import DEGREE, Array

_TRIAD = Block(kind="accel", axes=np.eye(3))
_STEPS = 192
"""Rotations that a turn is made of: of a whole revolution 2° each."""
_MOST_TURNS = 24
_MOST_MISFIT = 9.0  # of a turn
_GRID = 0.015  # of ln Q
_PATHS = 40.0, 0.03  # rad, of the median turn, at both ends of the grid
_TURNED = math.cos(8.0 * DEGREE)
_CLIPPED, _BELOW = 3, 0.97
_NO_OFFSET, _LEAST_SINGULAR, _ALIKE = 0.3, 0.05, 0.05
_UNEVEN, _STEPS_TO_CENTRE = 0.01, 4
"""What readings of one g differ by from attitude to attitude, part of it, beside their offsets."""
_USUAL = 0.8
"""The quantile of what the gyros read in a turn that is taken as that of its midst."""
_MOST_EXCHANGES = 4
_RATES = 0.25, 1.0, 4.0
"""Times the assumed rate: where the rate is unclear, rests are sought by these; by too high a one they seem too
short."""


def _width(value: float, words: str, why: str) -> Any:
    return field(default=value, metadata={"words": words, "why": why})


@dataclass(frozen=True, kw_only=True, slots=True)
class Widths:
    """What the cost of a hypothesis hangs on, in one record, so that a study can sweep it."""

    # fmt: off
    scale: float = _width(
        0.015, "standard deviation of ln of a scale factor over its nominal value", "±3 % in data sheets of MEMS")
    offset: float = _width(
        0.03, "the same of the length of gravity where rests do not show the zero", "offsets of 50 mg on three axes")
    vertical: float = _width(
        0.06, "standard deviation of a vertical, rad", "offsets of 50 mg before and behind a turn")
    axes: float = _width(0.03, "the same, part of the angle of a turn", "axes and scale factors of small sensors")
    damaged: float = _width(0.05, "share of turns of which the gyros do not say where they led", "clipped, cut, torn")
    exchanged: float = _width(0.03, "share of logs whose gyros have other axes or signs", "chosen by hand")
    named_wrongly: float = _width(0.003, "share of gyros in another unit than their name says", "chosen by hand")
    turning: float = _width(1.2, "standard deviation of ln of the rate of turning by hand or on a table over 1 rad/s",
                            "from 10 to 500 °/s")
    near: float = _width(6.0, "two candidates are near each other up to this difference of their cost",
                         "the second is 20 times less likely, as of columns")
    # fmt: on


WIDTHS = Widths()


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TurnLikelihood:
    """−2 ln L (G,) over an even grid of ln Q (G,), and that of gyros that turn nothing, with an `exchange` of the
    gyros' columns and signs (3, 3), which itself costs `exchanged`."""

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

    def found(self, log_q: float | None = None, within: float = 0.0) -> float:
        """Q with which the turns miss least, near the least cost of all or within so much of one ln Q."""
        log_q, within = (float(self.log_q[np.argmin(self.cost)]), 0.1) if log_q is None else (log_q, within)
        near = np.flatnonzero(np.abs(self.log_q - log_q) <= within)
        if not len(near):
            return float(np.exp(log_q))
        k = int(near[np.argmin(self.misfit[near])])
        a, b, c = (float(self.misfit[min(max(k + j, 0), len(self.misfit) - 1)]) for j in (-1, 0, 1))
        peak = 0.5 * (a - c) / (a - 2.0 * b + c) if b < min(a, c) else 0.0  # of the parabola through three points
        return float(np.exp(self.log_q[k] + _GRID * peak))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Shown:
    """What a recording shows, in raw numbers, with Q and durations counted at `rate`, Hz: how many `rests` and `turns`
    there are; the `length` of gravity, its standard uncertainty, part of it, and the `zero` of the accelerometers; at
    the rests (N, 3) the directions of the vertical and what the gyros read, and the scatter of a sample, of the
    accelerometers as part of gravity; what the gyros read in the midst of a turn, and the profiles of the turns, that
    with the columns as they are first. `by_rate` has the number of rests by trial rates, Hz, where that is unclear."""

    rate: float
    length: float
    length_u: float
    rests: int = 0
    turns: int = 0
    zero: Sequence[float] = (0.0, 0.0, 0.0)
    up: Array = field(default_factory=lambda: np.empty((0, 3)))
    gyro: Array = field(default_factory=lambda: np.empty((0, 3)))
    samples: Array = field(default_factory=lambda: np.empty(0))
    accel_scatter: float = 0.0
    gyro_scatter: float = 0.0
    turning: float = 0.0
    profiles: tuple[TurnLikelihood, ...] = ()
    by_rate: Mapping[float, int] = field(default_factory=dict)

    @property
    def bias(self) -> Array:
        """What the gyros read at rest (3,)."""
        return np.median(self.gyro, axis=0) if len(self.gyro) else np.zeros(3)


def shown_by(draft: Draft, progress: Progress, widths: Widths = WIDTHS) -> Shown:
    """What the log of a draft shows. Where its rate is unclear the rows are the clock, and rests are sought with
    windows that fit several rates: those are taken whose turns tell most."""
    log = {key: value for key, value in draft.log.items() if key != "temperature"}
    stated, factors = draft.times.rate / ASSUMED_RATE, [1.0]
    if draft.times.rivals:
        log = {key: value for key, value in log.items() if key not in ("time", "time_unit", "regular")}
        log["rate_hz"] = ASSUMED_RATE
        factors = sorted({*_RATES, round(min(max(stated, 0.05), 20.0), 2)}, key=lambda f: abs(np.log(f / stated)))
    session = replace(draft, content={**draft.content, "log": log}).session()
    try:
        opened = open_log(session)
        reduction = reduce_log(opened, session.accel_block, session.gyro_block, progress(opened))
    except (TumbleError, np.linalg.LinAlgError):
        return Shown(rate=draft.rate, length=draft.magnitude, length_u=widths.offset)
    trials = {factor: _with_windows(reduction, factor, draft.magnitude, widths) for factor in factors}

    def told(factor: float) -> tuple[float, int]:
        """What the turns tell: how much less they cost than if the gyros turned nothing; and the number of rests."""
        shown = trials[factor]
        return max((p.unturned - p.least for p in shown.profiles), default=0.0), shown.rests

    counts = {ASSUMED_RATE * factor: trials[factor].rests for factor in factors} if len(factors) > 1 else {}
    return replace(trials[max(factors, key=told)], by_rate=counts)


def _with_windows(reduction: Reduction, factor: float, magnitude: float, widths: Widths) -> Shown:
    """What a reduction shows whose rests are sought with windows that fit `factor` times its rate; where there are
    none, gravity has the `magnitude` of what is read."""
    seconds = (f.name for f in fields(Tuning) if f.metadata["unit"] == "s")
    tuning = replace(USUAL, **{name: factor * getattr(USUAL, name) for name in seconds})
    channels, files = (*reduction.accel_channels, *reduction.gyro_channels), reduction.by_file
    spans: tuple[RestSpan, ...] = ()
    if max(max(-c.minimum, c.maximum) for c in channels) < LARGEST_SQUARED:
        spans = find_rests(replace(reduction, tuning=tuning), _TRIAD, None).rests
    accel = [files[s.file].accel.means[s.first : s.last] for s in spans]
    gyro = [files[s.file].gyro.means[s.first : s.last] for s in spans]
    means = np.array([blocks.mean(axis=0) for blocks in accel]).reshape(-1, 3)
    rates = np.array([np.median(blocks, axis=0) for blocks in gyro]) if spans else np.empty((0, 3))

    def scatter(of_rests: list[Array]) -> float:
        """Of a sample, by that of the means of blocks."""
        of_blocks = [np.sqrt(blocks.var(axis=0).mean()) for blocks in of_rests if blocks.size]
        return float(np.median(of_blocks)) * np.sqrt(reduction.files[0].size) if of_blocks else 0.0

    length, length_u, zero, gravity = magnitude, widths.offset, [0.0] * 3, means
    if spans:
        length, length_u, zero, gravity = length_and_zero(means, widths)
    up = unit_vector(gravity)
    turns = _turns(reduction, spans, up, rates) if rates.size else []
    return Shown(
        rate=reduction.rate,
        rests=len(spans),
        turns=len(turns),
        length=length,
        zero=zero,
        length_u=length_u,
        up=up,
        gyro=rates,
        samples=np.array([(s.last - s.first) * files[s.file].size for s in spans]),
        accel_scatter=scatter(accel) / max(length, 1e-300),
        gyro_scatter=scatter(gyro),
        turning=float(np.median([turn.reading for turn in turns])) if turns else 0.0,
        profiles=_profiles(turns, widths) if turns else (),
    )


def length_and_zero(means: Array, widths: Widths = WIDTHS) -> tuple[float, float, list[float], Array]:
    """Numbers per g of accelerometers, their standard uncertainty as part of them, zeros (3,), and the vectors of
    gravity (N, 3), from mean readings (N, 3) at rest. The zero is the centre of their sphere, or none or the middle of
    a converter where the centre is near to that, or where they draw no sphere: a known length in one attitude does not.
    Gravity is about the centre c of |m − c| = r, for offsets from a known zero as they are usual, so that few rests do
    not move it far."""
    length = float(np.median(np.linalg.norm(means, axis=1)))
    zero, offset = np.zeros(3), widths.offset
    if len(means) >= 4:
        alike = float(np.linalg.norm(means.std(axis=0))) < _ALIKE * length
        spread = np.linalg.svd(means - means.mean(axis=0), compute_uv=False)
        if spread[2] > _LEAST_SINGULAR * spread[0] and not (alike and off_table(ACCEL, length) < NEAR):
            centre, radius = sphere_through(means)
            middles = MIDDLES if (means > 0.0).all() else ()
            known = next((m for m in (0.0, *middles) if np.abs(centre - m).max() < _NO_OFFSET * radius), None)
            zero = centre if known is None else np.full(3, known)
            offset = np.inf if known is None else max(offset, float(np.abs(centre - zero).max()) / radius)
    centre, length_u = zero, offset
    length = float(np.median(np.linalg.norm(means - zero, axis=1)))
    for _ in range(_STEPS_TO_CENTRE if length > 0.0 else 0):
        away = means - centre
        rows = np.vstack([np.column_stack([unit_vector(away), np.ones(len(away))]) / _UNEVEN, np.eye(4)[:3] / offset])
        left = (np.linalg.norm(away, axis=1) / length - 1.0) / _UNEVEN
        inverse = np.linalg.pinv(rows)
        *moved, longer = inverse @ np.concatenate([left, (zero - centre) / length / offset])
        centre, length_u = centre + length * np.array(moved), float(np.linalg.norm(inverse[3]))
        length *= 1.0 + longer
    return length, length_u, [float(f"{z:.5g}") for z in zero], means - centre


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Turn:
    """The sums (B, 3) of the gyros' readings in the steps of a turn, the verticals (3,) before and behind it, and what
    the gyros read in its midst."""

    steps: Array
    before: Array
    behind: Array
    reading: float


def _turns(reduction: Reduction, spans: tuple[RestSpan, ...], up: Array, rates: Array) -> list[_Turn]:
    """Those that end with another side up and in which no gyro is clipped, one that reads the most it reads in any of
    them several times in a row, and seldom a little less; the shortest first."""
    files, samples, bias = reduction.by_file, reduction.samples, np.median(rates, axis=0)
    assert samples is not None
    tilted = [k for k in range(len(spans) - 1) if spans[k].file == spans[k + 1].file and up[k] @ up[k + 1] < _TURNED]
    read = {}
    for k in tilted:
        blocks = files[spans[k].file]
        turn = samples.read(blocks.sample_at(spans[k].last), blocks.sample_at(spans[k + 1].first))
        if len(turn[0]) >= _CLIPPED and np.isfinite(turn[0]).all():
            read[k] = turn
    limit = np.max([np.abs(turn[0]).max(axis=0) for turn in read.values()], axis=0) if read else np.zeros(3)
    turns = []
    for k, (rate, _, dt) in sorted(read.items(), key=lambda item: len(item[1][0])):
        ends, below = np.abs(rate) == limit, np.abs(rate) > _BELOW * limit
        rows = (ends[2:] & ends[1:-1] & ends[:-2]).any(axis=0)
        if (rows & (2 * ends.sum(axis=0) > below.sum(axis=0))).any():
            continue
        sums = (rate - bias) * (reduction.rate * dt)[:, None]
        edges = np.linspace(0, len(sums), min(_STEPS, len(sums)), endpoint=False).astype(int)
        steps = np.zeros((_STEPS, 3))
        steps[: len(edges)] = np.add.reduceat(sums, edges, axis=0)
        reading = float(np.quantile(np.linalg.norm(rate - bias, axis=1), _USUAL))
        turns.append(_Turn(steps=steps, before=up[k], behind=up[k + 1], reading=reading))
    return turns[:_MOST_TURNS]


def _profiles(turns: list[_Turn], widths: Widths) -> tuple[TurnLikelihood, ...]:
    """The profile of the columns as they are, and where that does not explain the turns those of the exchanges that
    do."""
    steps = np.array([turn.steps for turn in turns])
    before, behind = np.array([turn.before for turn in turns]), np.array([turn.behind for turn in turns])
    path = np.linalg.norm(steps, axis=2).sum(axis=1)
    middle = float(np.median(path))
    if not middle > 0.0:
        return ()
    low, high = (float(np.log(middle / angle)) for angle in _PATHS)

    def profile(exchange: Array, grid: float, every: int, most: int) -> TurnLikelihood:
        log_q = np.arange(low, high, grid)
        q = np.append(np.exp(log_q), np.inf)[:, None]
        sums = steps[:most].reshape(min(len(turns), most), -1, every, 3).sum(axis=2) @ exchange.T
        cosine = (_carried_back(sums, behind[:most], q) * before[:most].T[:, None, :]).sum(axis=0)
        kappa = 1.0 / (widths.vertical**2 + (widths.axes * path[:most] / q) ** 2)
        density = 2.0 * kappa / -np.expm1(-2.0 * kappa) * np.exp(kappa * (np.minimum(cosine, 1.0) - 1.0))
        cost = -2.0 * np.log(widths.damaged + (1.0 - widths.damaged) * density).sum(axis=1)
        least = kappa[np.argmin(cost[:-1])]
        misfit = np.minimum(2.0 * least * (1.0 - cosine[:-1]), _MOST_MISFIT).sum(axis=1)
        unlike = not np.array_equal(exchange, np.eye(3))
        exchanged = -2.0 * np.log(widths.exchanged / 47.0) if unlike else 0.0
        return TurnLikelihood(
            log_q=log_q, cost=cost[:-1], misfit=misfit, unturned=cost[-1], exchange=exchange, exchanged=exchanged
        )

    as_they_are, *exchanges = signed_permutations()
    first = profile(as_they_are, _GRID, 1, _MOST_TURNS)
    attainable = -2.0 * len(turns) * np.log(2.0 / widths.vertical**2)
    if first.least < 0.5 * attainable:
        return (first,)
    rough = sorted((profile(e, 4.0 * _GRID, 4, _MOST_TURNS // 2) for e in exchanges), key=lambda p: p.least)
    return first, *(profile(p.exchange, _GRID, 1, _MOST_TURNS) for p in rough[:_MOST_EXCHANGES])


def _carried_back(steps: Array, vertical: Array, q: Array) -> Array:
    """Verticals (K, 3) behind turns, (3, G, K) as they were before, by rotations of steps (K, B, 3) / q (G, 1)."""
    length = np.linalg.norm(steps, axis=2)
    axes = steps / np.maximum(length, 1e-300)[..., None]
    x, y, z = (np.broadcast_to(v, (len(q), len(vertical))) for v in vertical.T)
    for k in reversed(range(steps.shape[1])):
        angle, (u, v, w) = length[:, k] / q, axes[:, k].T
        c, s = np.cos(angle), np.sin(angle)
        along = (u * x + v * y + w * z) * (1.0 - c)
        x, y, z = (
            x * c + (v * z - w * y) * s + u * along,
            y * c + (w * x - u * z) * s + v * along,
            z * c + (u * y - v * x) * s + w * along,
        )
    return np.array([x, y, z])
