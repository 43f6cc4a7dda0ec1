"""Cost of the hypotheses about a log: units or counts of accelerometers and gyros, times or rate of its rows, order and
signs of the gyros' columns.

A hypothesis h predicts two quantities: the length L_h of gravity in raw numbers, and the sum Q_h of the gyros' raw
numbers over a turn of one radian. Its cost is −2 ln of its probability, up to a common constant:

    (ln L/L_h)² / s²  +  min over δ of [turns(ln Q_h + δ) + δ²/s²]  +  implausible readings  +  assumptions,

with s the usual scale error of a device. The cost of an assumption follows from the frequency of units, counts and
rates in logs that do not state them (`recording/columns/guesses.toml`); a unit in a column's name is
certain. A scale or rate that is in no table is taken from the measurement, at the cost of its prior: the density of a
Gaussian of width s relative to a uniform one over the orders of magnitude that were possible, 2 ln(range / (s √2π)).

The log is read once, as raw numbers at a rate that may be wrong. Rests are found by the accelerometers, whose relative
scatter needs no unit. They give the length of gravity, the zero of the accelerometers and the gyros' readings at rest;
the turns between them give the likelihood of Q (`turn_likelihood`). If rests are few and their turns do not fit,
moments of about 1 g in motion take their place.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np

from tumble.diagnosis.turn_likelihood import (
    MOST_TURNS,
    WIDTHS,
    TurnLikelihood,
    Widths,
    cost_of_free_scale,
    ends_tilted,
    least_cost,
    turn_likelihoods,
)
from tumble.drafting.foreign_log import HEAD_ROWS, Draft
from tumble.drafting.times import ASSUMED_RATE, RATE_LIMITS, UNLISTED_SHARE, USUAL_RATES, Times, at_rate
from tumble.errors import TumbleError
from tumble.recording.columns.names import ACCEL, GYRO
from tumble.recording.columns.numbers import MIDDLES
from tumble.recording.columns.scales import (
    CANDIDATES,
    COUNTS_PER_SI,
    FASTEST,
    PRIORS,
    SCALE_TOLERANCE,
    UNLISTED_COUNTS,
    SensorScale,
    resolution_in_deg_s,
)
from tumble.recording.log import open_log
from tumble.reduction.blocks.reducer import Reduction, reduce_log
from tumble.reduction.blocks.tuning import USUAL, Tuning
from tumble.reduction.rests.rests import sphere_through
from tumble.reduction.rests.segmentation import Stretch, find_rests
from tumble.rotation import unit_vector
from tumble.run.observed import FEWEST_RESTS, LARGEST_SQUARED, Progress
from tumble.sensors.model import Block
from tumble.units import ACCEL_UNITS, DEGREE, G_STANDARD, GYRO_UNITS, Array

_TRIAD = Block(kind="accel", axes=np.eye(3))
_CLIPPED_RUN, _BELOW_CLIPPING = 3, 0.97  # largest readings in a row; part of the largest reading
_NO_OFFSET, _LEAST_SINGULAR, _ALIKE = 0.3, 0.05, 0.05  # of gravity; of the largest singular value; of gravity
_LARGEST_UNEVEN, _LEAST_EXTENT = 0.1, 0.75
"""Of gravity, for a sphere with any centre: scatter of the lengths, and extent of the readings of each sensor."""
_LENGTH_IN_MOTION_U = 0.2
"""Relative standard uncertainty of gravity as the median magnitude of accelerometers that are never at rest."""
_VERTICAL_IN_MOTION, _TURN_IN_MOTION = 0.15, 1.5
"""Standard deviation of a vertical in motion, rad: 1.5 m/s² of a hand; s between two verticals."""
_UNEVEN, _CENTRE_STEPS = 0.01, 4
"""Relative differences of readings of one g between attitudes, without offsets; number of Gauss–Newton steps."""
_FAST_QUANTILE = 0.99  # of the largest readings of gyros in the first rows, without single outliers
_TURN_QUANTILE = 0.8  # of the readings in a turn; it represents the middle of the turn
_RATE_FACTORS = 0.25, 1.0, 4.0
"""Multiples of the assumed rate at which rests are sought if the rate is unclear; too high a rate shortens rests."""
_LN_RATE_RANGE = math.log(RATE_LIMITS[1] / RATE_LIMITS[0])
COUNTS = SensorScale(value=1.0, shares=(1.0, 1.0))
"""Counts of unknown scale, of gyros in a recording without turns."""
_PRIOR = SimpleNamespace(**PRIORS["readings"])
"""Standard deviations, shares and costs."""
_FEWEST_COUNTS = 2.0  # per g, of accelerometers in counts
_LARGEST_BIAS, _LARGEST_NOISE = 20.0 * DEGREE, 0.17 * DEGREE  # rad/s, of small gyros; noise in a mean over a second
SHORTEST_REST = 0.6  # s, at the median
_TABLE_NOISE = 0.015  # m/s² in a mean over a second; a hand or a running machine has more


# -------------------- evidence of rests and turns --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Evidence:
    """Length of gravity, readings at rest and turns of a recording, in raw numbers, with durations counted at `rate`.

    `rate` is in Hz. `length` is that of gravity, `length_u` its relative standard uncertainty, `zero` the offset of the
    accelerometers; `rests` and `turns` are numbers. Each rest has the readings of the gyros `gyro` (N, 3); `samples` is
    the median of their numbers of samples. The scatter is that of a sample, for accelerometers relative to gravity.
    `turning` is the typical reading of the gyros in a turn, `profiles` the likelihoods of the turns, the first with the
    columns unchanged. Of the first rows, `whole` is True for kinds of sensors that read whole numbers only, `largest`
    is a large reading of the gyros, and `step` the resolution of a data sheet, °/s, of which they are multiples."""

    rate: float
    length: float
    length_u: float = _LENGTH_IN_MOTION_U
    rests: int = 0
    turns: int = 0
    zero: Sequence[float] = (0.0, 0.0, 0.0)
    gyro: Array = field(default_factory=lambda: np.empty((0, 3)))
    samples: float = math.inf
    accel_scatter: float = 0.0
    gyro_scatter: float = 0.0
    turning: float = 0.0
    profiles: tuple[TurnLikelihood, ...] = ()
    whole: Mapping[str, bool] = field(default_factory=dict)
    largest: float = 0.0
    step: float | None = None

    @property
    def bias(self) -> Array:
        """Median reading of the gyros at rest (3,)."""
        return np.median(self.gyro, axis=0) if len(self.gyro) else np.zeros(3)

    def with_turns(self, turns: Sequence[tuple[Array, Array, Array]], widths: Widths) -> Evidence:
        """Return the evidence with these turns in place of any others."""
        readings = [np.quantile(np.linalg.norm(sums, axis=1), _TURN_QUANTILE) for sums, _, _ in turns]
        turning = float(np.median(readings)) if turns else 0.0
        return replace(self, turns=len(turns), turning=turning, profiles=turn_likelihoods(turns, widths))

    def is_good(self, vertical: float) -> bool:
        """Return True if rotations explain the turns, between verticals with this standard deviation, rad."""
        return min((p.least for p in self.profiles), default=0.0) < 0.5 * least_cost(self.turns, vertical)


def gather_evidence(draft: Draft, progress: Progress) -> Evidence:
    """Return the evidence of a draft's log.

    If the rate is unclear, rows are counted instead of times, and rests are sought with windows for several rates. The
    chosen trial has the turns that noise explains least, or the most rests."""
    head = {kind: draft.source.read(sensors.columns, rows=HEAD_ROWS) for kind, sensors in draft.triads.items()}
    whole = {kind: bool((r == np.floor(r))[np.isfinite(r)].all()) for kind, r in head.items()}
    rates = head[GYRO][np.isfinite(head[GYRO]).all(axis=1)] if GYRO in head else np.empty((0, 3))
    unread = Evidence(
        rate=draft.rate,
        length=draft.source.magnitude(next(iter(draft.triads.values())).columns),
        whole=whole,
        largest=float(np.quantile(np.abs(rates).max(axis=1), _FAST_QUANTILE)) if len(rates) else 0.0,
        step=resolution_in_deg_s(head[GYRO]) if GYRO in head and not whole[GYRO] else None,
    )
    ratio, factors, keys = draft.rate / ASSUMED_RATE, [1.0], dict[str, Any]()
    if draft.times.rivals:
        keys = {"time": None, "time_unit": None, "regular": None, "rate_hz": ASSUMED_RATE}
        nominal = round(min(max(ratio, 0.05), 20.0), 2)
        factors = sorted({*_RATE_FACTORS, nominal}, key=lambda f: abs(np.log(f / ratio)))
    session = draft.session(temperature=None, **keys)
    try:
        opened = open_log(session)
        reduction = reduce_log(opened, session.accel_block, session.gyro_block, progress(opened))
    except (TumbleError, np.linalg.LinAlgError):
        return unread
    unread = replace(unread, rate=reduction.rate)
    if ACCEL not in draft.triads:
        means = np.concatenate([file.accel.means for file in reduction.files])  # of gyros, mostly at rest
        middle = np.median(means, axis=0)
        scatter = 1.4826 * float(np.median(np.abs(means - middle))) * math.sqrt(reduction.files[0].size)
        return replace(unread, length=1.0, gyro=middle[None], gyro_scatter=scatter)
    trials = [_evidence_at(reduction, factor, unread, draft.widths) for factor in factors]
    best = max(trials, key=lambda t: (max((p.unturned - p.least for p in t.profiles), default=0.0), t.rests))
    if best.rests >= FEWEST_RESTS or best.is_good(draft.widths.vertical):
        return best
    moving = _evidence_in_motion(reduction, best, draft.widths)
    return moving if moving.turns >= FEWEST_RESTS and moving.is_good(_VERTICAL_IN_MOTION) else best


def _evidence_at(reduction: Reduction, factor: float, unread: Evidence, widths: Widths) -> Evidence:
    """Return the evidence with rests sought in windows `factor` times as long; that of the first rows without rests."""
    durations = (f.name for f in fields(Tuning) if f.metadata["unit"] == "s")
    tuning = replace(USUAL, **{name: factor * getattr(USUAL, name) for name in durations})
    channels, files = (*reduction.accel_channels, *reduction.gyro_channels), reduction.by_file
    spans: tuple[Stretch, ...] = ()
    if max(max(-c.minimum, c.maximum) for c in channels) < LARGEST_SQUARED:
        with np.errstate(invalid="ignore"):  # a stretch of zeros
            rests = find_rests(replace(reduction, tuning=tuning), _TRIAD, None).rests
        spans = tuple(s for s in rests if files[s.file].accel.means[s.first : s.last].any())
    if not spans:
        return unread
    accel = [files[s.file].accel.means[s.first : s.last] for s in spans]
    gyro = [files[s.file].gyro.means[s.first : s.last] for s in spans]
    length, length_u, zero, gravity = length_and_zero(np.array([blocks.mean(axis=0) for blocks in accel]), widths)
    up, rates = unit_vector(gravity), np.array([np.median(blocks, axis=0) for blocks in gyro])
    turns = _turns(reduction, spans, up, rates) if rates.size else []
    scatters = []  # of a sample, from the scatter of means of blocks
    for rests_of_kind in (accel, gyro):
        block_scatter = [np.sqrt(blocks.var(axis=0).mean()) for blocks in rests_of_kind if blocks.size]
        scatters.append(float(np.median(block_scatter)) * np.sqrt(reduction.files[0].size) if block_scatter else 0.0)
    at_rest = replace(
        unread,
        rests=len(spans),
        length=length,
        zero=zero,
        length_u=length_u,
        gyro=rates,
        samples=float(np.median([(s.last - s.first) * files[s.file].size for s in spans])),
        accel_scatter=scatters[0] / max(length, 1e-300),
        gyro_scatter=scatters[1],
    )
    return at_rest.with_turns(turns, widths)


def _evidence_in_motion(reduction: Reduction, at_rest: Evidence, widths: Widths) -> Evidence:
    """Return evidence with the turns of a device that hardly rests, between the pairs of blocks of every second or two
    whose specific force is nearest to gravity: it is the vertical to within `_VERTICAL_IN_MOTION`."""
    spans, up = list[Stretch](), list[Array]()
    every = max(round(_TURN_IN_MOTION / reduction.block_seconds), 2)
    for file in reduction.files:
        force = 0.5 * (file.accel.means[1:] + file.accel.means[:-1]) - at_rest.zero
        off = np.abs(np.linalg.norm(force, axis=1) / at_rest.length - 1.0)
        for start in range(0, len(force) - every + 1, every):
            pair = start + int(np.argmin(off[start : start + every]))
            if off[pair] < _VERTICAL_IN_MOTION:
                spans.append(Stretch.of_blocks(file, (pair + 1, pair + 1)))
                up.append(unit_vector(force[pair]))
    if not spans or not reduction.gyro_channels:
        return at_rest
    turns = _turns(reduction, tuple(spans), np.array(up), at_rest.bias[None])
    return at_rest.with_turns(turns, replace(widths, vertical=_VERTICAL_IN_MOTION))


def length_and_zero(means: Array, widths: Widths = WIDTHS) -> tuple[float, float, list[float], Array]:
    """Estimate gravity and the zero of accelerometers from mean readings (N, 3) at rest.

    Returns the raw numbers for one g with their relative standard uncertainty, the zero of each sensor to five digits,
    and the readings (N, 3) relative to the zero. The zero is the centre of the sphere through the readings, or exactly
    0 or the middle of a converter if the centre is near one of these or undetermined. The length solves |m − c| = r by
    least squares, with a prior for the offsets from a known zero, so that few rests do not shift it far."""
    length = float(np.median(np.linalg.norm(means, axis=1)))
    zero, offset = np.zeros(3), widths.offset
    if len(means) >= 4:
        alike = float(np.linalg.norm(means.std(axis=0))) < _ALIKE * length
        singular = np.linalg.svd(means - means.mean(axis=0), compute_uv=False)
        nominal_lengths = np.array([scale.value for scale in CANDIDATES[ACCEL] if not scale.increment])
        in_table = alike and np.abs(np.log(length / nominal_lengths)).min() < SCALE_TOLERANCE
        if singular[2] > _LEAST_SINGULAR * singular[0] and not in_table:
            centre, radius = sphere_through(means)
            uneven = float(np.linalg.norm(means - centre, axis=1).std()) / radius
            is_sphere = uneven < _LARGEST_UNEVEN and np.ptp(means, axis=0).min() > _LEAST_EXTENT * radius
            middles = MIDDLES if (means > 0.0).all() else ()
            nominal = next((m for m in (0.0, *middles) if np.abs(centre - m).max() < _NO_OFFSET * radius), None)
            if nominal is not None or is_sphere:
                zero = centre if nominal is None else np.full(3, nominal)
                offset = np.inf if nominal is None else max(offset, float(np.abs(centre - zero).max()) / radius)
    centre, length_u = zero, offset
    length = float(np.median(np.linalg.norm(means - zero, axis=1)))
    for _ in range(_CENTRE_STEPS if length > 0.0 else 0):
        away = means - centre
        design = np.vstack([np.column_stack([unit_vector(away), np.ones(len(away))]) / _UNEVEN, np.eye(4)[:3] / offset])
        residual = (np.linalg.norm(away, axis=1) / length - 1.0) / _UNEVEN
        inverse = np.linalg.pinv(design)
        *step, growth = inverse @ np.concatenate([residual, (zero - centre) / length / offset])
        centre, length_u = centre + length * np.array(step), float(np.linalg.norm(inverse[3]))
        length *= 1.0 + growth
    return length, length_u, [float(f"{z:.5g}") for z in zero], means - centre


def _turns(
    reduction: Reduction, spans: tuple[Stretch, ...], up: Array, rates: Array
) -> list[tuple[Array, Array, Array]]:
    """Return turns between rests of different attitude, the shortest first: integrals of the gyros above their bias
    (m, 3), and the vertical before and after.

    Turns with a clipped gyro are left out; such a gyro repeats its largest reading, and rarely reads slightly less."""
    files, samples, bias = reduction.by_file, reduction.samples, np.median(rates, axis=0)
    assert samples is not None
    candidates = []
    for k, (before, behind) in enumerate(pairwise(spans)):
        if before.file == behind.file and ends_tilted(up[k], up[k + 1]):
            blocks = files[before.file]
            rate, _, dt = samples.read(blocks.sample_at(before.last), blocks.sample_at(behind.first))
            if len(rate) >= _CLIPPED_RUN and np.isfinite(rate).all():
                candidates.append((k, rate, dt))
    limit = np.max([np.abs(rate).max(axis=0) for _, rate, _ in candidates], axis=0) if candidates else np.zeros(3)
    turns = []
    for k, rate, dt in sorted(candidates, key=lambda turn: len(turn[1])):
        at_limit, near_limit = np.abs(rate) == limit, np.abs(rate) > _BELOW_CLIPPING * limit
        in_a_row = (at_limit[2:] & at_limit[1:-1] & at_limit[:-2]).any(axis=0)
        if not (in_a_row & (2 * at_limit.sum(axis=0) > near_limit.sum(axis=0))).any():
            turns.append(((rate - bias) * (reduction.rate * dt)[:, None], up[k], up[k + 1]))
    return turns[:MOST_TURNS]


# -------------------- cost --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Hypothesis:
    """Scales and times of a log, and their cost. `profile` is the likelihood of the turns; None without turns."""

    accel: SensorScale
    gyro: SensorScale | None
    times: Times
    profile: TurnLikelihood | None
    cost: float

    def differs(self, other: Hypothesis) -> set[str]:
        """Return the parts in which two hypotheses differ."""
        parts = {
            ACCEL: self.accel != other.accel,
            GYRO: self.gyro != other.gyro,
            "time": self.times.keys != other.times.keys,
        }
        return {part for part, different in parts.items() if different}


def ranked_hypotheses(evidence: Evidence, draft: Draft) -> list[Hypothesis]:
    """Return all hypotheses about a log in the order of their cost."""
    widths = draft.widths
    deviation = math.hypot(widths.scale, evidence.length_u)
    has_accel = ACCEL in draft.triads
    accels = list(_assumed_scales(ACCEL, draft, evidence, deviation)) or [(COUNTS, 0.0)]
    gyros = list(_assumed_scales(GYRO, draft, evidence, widths.scale))
    if not evidence.profiles:  # nothing determines the scale of counts
        listed = sum(math.exp(-0.5 * cost) for gyro, cost in gyros if gyro.unit is None and gyro.listed)
        in_units = [(gyro, cost) for gyro, cost in gyros if gyro.unit is not None]
        gyros = [*([(COUNTS, -2.0 * math.log(listed))] if listed else []), *in_units]
    if has_accel and evidence.whole[ACCEL] and evidence.length < _FEWEST_COUNTS:
        accels = [(accel, cost) for accel, cost in accels if accel.unit is not None] or accels
    unit_stated = has_accel and ACCEL_UNITS[draft.unit(ACCEL) or "count"].kind != "raw"
    hypotheses = []
    for profile in evidence.profiles or (None,):
        for times, gyro, gyro_cost in _gyro_trials(draft, evidence, gyros, profile):
            short_rests = math.log(max(SHORTEST_REST * times.rate / evidence.samples, 1.0)) / _PRIOR.excess
            accel_trials = []
            for accel, assumption in accels:
                scale = accel if accel.listed else replace(accel, value=evidence.length)
                off = math.log(evidence.length / scale.reading(times.rate)) / deviation
                zero = max(map(abs, evidence.zero)) / (_PRIOR.zero * evidence.length) if accel.unit else 0.0
                pairs = PRIORS["pairs"].get(accel.unit or "count", {})
                paired = has_accel and gyro is not None and gyro.listed
                odds = pairs.get(gyro.unit or "count", 1.0) if paired and gyro is not None else 1.0
                misfit = 0.0 if unit_stated and accel.unit else off**2 + zero**2
                accel_trials.append((scale, assumption - 2.0 * math.log(odds) + misfit))
            least = min(cost for _, cost in accel_trials)
            common = times.cost + short_rests**2 + gyro_cost
            hypotheses += [
                Hypothesis(accel=accel, gyro=gyro, times=times, profile=profile, cost=common + cost)
                for accel, cost in accel_trials
                if cost < least + _PRIOR.hopeless
            ]
    return sorted(hypotheses, key=lambda hypothesis: hypothesis.cost)


def _gyro_trials(
    draft: Draft,
    evidence: Evidence,
    gyros: list[tuple[SensorScale, float]],
    profile: TurnLikelihood | None,
) -> Iterator[tuple[Times, SensorScale | None, float]]:
    """Yield times and gyro scales with the cost of turns, readings and assumptions.

    If the rate is unknown, the rate at which the turns fit a unit best is also tried; and with time stamps, that a unit
    in a name is wrong: its name stays, and the calibration refuses it with the unit that fits."""
    widths, assumed_times = draft.widths, (draft.times, *draft.times.rivals)
    nominal = None if profile is None else profile.of_nominal(widths.scale)
    if not gyros:
        yield from ((times, None, 0.0) for times in assumed_times)
    free_rate = next((times.cost - USUAL_RATES[times.rate] for times in assumed_times[1:] if not times.stamped), None)
    for gyro, assumption in gyros:
        trials = assumed_times
        if profile is not None and free_rate is not None and gyro.unit is not None and not gyro.increment:
            rate = profile.best_q() * DEGREE / gyro.value
            if RATE_LIMITS[0] <= rate <= RATE_LIMITS[1]:
                cost = free_rate - 2.0 * math.log(UNLISTED_SHARE) + cost_of_free_scale(widths.scale, _LN_RATE_RANGE)
                trials = (*assumed_times, at_rate(float(f"{rate:.4g}"), cost))
        for times in trials:
            scale, cost = gyro, assumption
            if profile is not None and not gyro.listed:
                scale = replace(gyro, value=float(f"{profile.best_q() * DEGREE / times.rate:.4g}"))
            if nominal is not None:
                cost += nominal.at(math.log(scale.reading(times.rate) * times.rate / DEGREE))
            if profile is not None or gyro.unit is not None:
                cost += _cost_of_readings(evidence, scale, times.rate, widths)
            yield times, scale, cost
        if nominal is not None and draft.times.stamped and draft.unit(GYRO) == gyro.unit is not None:
            for others in (o for o in CANDIDATES[GYRO] if o.unit not in (None, gyro.unit) and not o.increment):
                cost = nominal.at(math.log(others.reading(draft.rate) * draft.rate / DEGREE))
                cost += _cost_of_readings(evidence, others, draft.rate, widths)
                yield draft.times, gyro, cost - 2.0 * math.log(widths.named_wrongly)


def _assumed_scales(
    kind: str, draft: Draft, evidence: Evidence, deviation: float
) -> Iterator[tuple[SensorScale, float]]:
    """Yield the units and counts that sensors may have, each with the cost of the assumption; none without sensors.

    A unit in a name is certain; a name of raw numbers makes counts likelier. Counts in no data sheet may have any
    scale, at the cost of one with this standard `deviation`."""
    if kind not in draft.triads:
        return
    units, name = {ACCEL: ACCEL_UNITS, GYRO: GYRO_UNITS}[kind], draft.unit(kind)
    if name is not None and units[name].kind != "raw":
        one = COUNTS_PER_SI[kind] / units[name].factor
        yield SensorScale(value=one, unit=name, shares=(1.0, 1.0), increment=units[name].kind == "increment"), 0.0
    elif name == "V":
        yield UNLISTED_COUNTS, 0.0
    else:
        for scale in (*CANDIDATES[kind], UNLISTED_COUNTS):
            share = scale.shares[evidence.whole[kind]]
            share *= _PRIOR.named_raw_share if name is not None and scale.unit is not None else 1.0
            yield scale, -2.0 * math.log(share) + (0.0 if scale.listed else cost_of_free_scale(deviation))


def _cost_of_readings(evidence: Evidence, gyro: SensorScale, rate: float, widths: Widths) -> float:
    """Return the cost of a gyro scale by the bias, noise, range, turning rate and resolution of the readings."""
    one, root = DEGREE / gyro.reading(rate), math.sqrt(rate)
    limits = [(float(np.linalg.norm(evidence.bias)), _LARGEST_BIAS)] if gyro.unit is not None else []
    if evidence.accel_scatter * G_STANDARD / root < _TABLE_NOISE:
        limits.append((evidence.gyro_scatter / root, _LARGEST_NOISE))
    cost = 0.0
    for value, limit in limits:
        if value * one > limit:
            cost += min((math.log(value * one / limit) / _PRIOR.excess) ** 2, _PRIOR.most_excess)
    if evidence.largest * one > FASTEST:
        cost += _PRIOR.too_fast
    if evidence.turning:
        cost += (math.log(evidence.turning * one) / widths.turning) ** 2
    if gyro.unit == "deg/s" and evidence.step is not None:
        cost += _PRIOR.resolution
    return cost
