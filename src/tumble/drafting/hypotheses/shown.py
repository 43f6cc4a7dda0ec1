"""What a recording shows of its sensors before any unit, scale or rate is known.

The log is read once, as raw numbers at a rate that need not be its own, and rests are told by the accelerometers, whose
scatter needs no unit. Of the rests come the length of gravity in raw numbers, the zero about which it turns, and what
the gyros read; of the turns between them the likelihood of the sum of a gyro's numbers over a radian
(`turn_likelihood`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise

import numpy as np

from tumble.diagnosis.turn_likelihood import (
    MOST_TURNS,
    WIDTHS,
    TurnLikelihood,
    Widths,
    ends_tilted,
    turn_likelihoods,
)
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
from tumble.units import Array

_TRIAD = Block(kind="accel", axes=np.eye(3))
_CLIPPED, _BELOW = 3, 0.97
_NO_OFFSET, _LEAST_SINGULAR, _ALIKE = 0.3, 0.05, 0.05
_UNEVEN, _STEPS_TO_CENTRE = 0.01, 4
"""What readings of one g differ by from attitude to attitude, part of it, beside their offsets."""
_USUAL = 0.8
"""The quantile of what the gyros read in a turn that is taken as that of its midst."""
_RATES = 0.25, 1.0, 4.0
"""Times the assumed rate: where the rate is unclear, rests are sought by these; by too high a one they seem too
short."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Shown:
    """What a recording shows, in raw numbers, with Q and durations counted at `rate`, Hz: how many `rests` and `turns`
    there are; the `length` of gravity, its standard uncertainty, part of it, and the `zero` of the accelerometers; at
    the rests (N, 3) the directions of the vertical and what the gyros read, and the scatter of a sample, of the
    accelerometers as part of gravity; what the gyros read in the midst of a turn, and the likelihoods of the turns,
    that with the columns as they are first. `by_rate` has the number of rests by trial rates, Hz, where that is
    unclear."""

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
    windows that fit several rates: those are taken whose turns tell most, by how much less they cost than if the gyros
    turned nothing, or that show most rests."""
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
    trials = [_with_windows(reduction, factor, draft.magnitude, widths) for factor in factors]
    counts = {ASSUMED_RATE * factor: trial.rests for factor, trial in zip(factors, trials, strict=True)}
    most = max(trials, key=lambda t: (max((p.unturned - p.least for p in t.profiles), default=0.0), t.rests))
    return replace(most, by_rate=counts if len(factors) > 1 else {})


def _with_windows(reduction: Reduction, factor: float, magnitude: float, widths: Widths) -> Shown:
    """What a reduction shows whose rests are sought with windows that fit `factor` times its rate; where there are
    none, gravity has the `magnitude` of what is read."""
    seconds = (f.name for f in fields(Tuning) if f.metadata["unit"] == "s")
    tuning = replace(USUAL, **{name: factor * getattr(USUAL, name) for name in seconds})
    channels, files = (*reduction.accel_channels, *reduction.gyro_channels), reduction.by_file
    spans: tuple[RestSpan, ...] = ()
    if max(max(-c.minimum, c.maximum) for c in channels) < LARGEST_SQUARED:
        spans = find_rests(replace(reduction, tuning=tuning), _TRIAD, None).rests
    if not spans:
        return Shown(rate=reduction.rate, length=magnitude, length_u=widths.offset)
    accel = [files[s.file].accel.means[s.first : s.last] for s in spans]
    gyro = [files[s.file].gyro.means[s.first : s.last] for s in spans]
    length, length_u, zero, gravity = length_and_zero(np.array([blocks.mean(axis=0) for blocks in accel]), widths)
    up, rates = unit_vector(gravity), np.array([np.median(blocks, axis=0) for blocks in gyro])
    turns = _turns(reduction, spans, up, rates) if rates.size else []
    scatters = []  # of a sample, by that of the means of blocks
    for of_rests in (accel, gyro):
        of_blocks = [np.sqrt(blocks.var(axis=0).mean()) for blocks in of_rests if blocks.size]
        scatters.append(float(np.median(of_blocks)) * np.sqrt(reduction.files[0].size) if of_blocks else 0.0)
    readings = [np.quantile(np.linalg.norm(sums, axis=1), _USUAL) for sums, _, _ in turns]
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
        accel_scatter=scatters[0] / max(length, 1e-300),
        gyro_scatter=scatters[1],
        turning=float(np.median(readings)) if turns else 0.0,
        profiles=turn_likelihoods(turns, widths),
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


def _turns(
    reduction: Reduction, spans: tuple[RestSpan, ...], up: Array, rates: Array
) -> list[tuple[Array, Array, Array]]:
    """What the gyros read above their bias, at the nominal interval, in turns (m, 3) that end with another side up, and
    the verticals before and behind them, the shortest first; but for turns in which a gyro is clipped: it reads the
    most it reads in any of them several times in a row, and seldom a little less."""
    files, samples, bias = reduction.by_file, reduction.samples, np.median(rates, axis=0)
    assert samples is not None
    read = []
    for k, (before, behind) in enumerate(pairwise(spans)):
        if before.file == behind.file and ends_tilted(up[k], up[k + 1]):
            blocks = files[before.file]
            rate, _, dt = samples.read(blocks.sample_at(before.last), blocks.sample_at(behind.first))
            if len(rate) >= _CLIPPED and np.isfinite(rate).all():
                read.append((k, rate, dt))
    limit = np.max([np.abs(rate).max(axis=0) for _, rate, _ in read], axis=0) if read else np.zeros(3)
    turns = []
    for k, rate, dt in sorted(read, key=lambda turn: len(turn[1])):
        ends, below = np.abs(rate) == limit, np.abs(rate) > _BELOW * limit
        rows = (ends[2:] & ends[1:-1] & ends[:-2]).any(axis=0)
        if not (rows & (2 * ends.sum(axis=0) > below.sum(axis=0))).any():
            turns.append(((rate - bias) * (reduction.rate * dt)[:, None], up[k], up[k + 1]))
    return turns[:MOST_TURNS]
