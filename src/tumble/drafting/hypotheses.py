"""One cost for every hypothesis of what a log is: units or counts of accelerometers and gyros, the times or the rate of
its rows, the order and signs of the gyros' columns.

Each predicts numbers of the recording: gravity has the length L_h in raw numbers, a turn of one radian the sum Q_h of
the gyros'. A hypothesis costs −2 times the logarithm of its probability, up to what all have in common:

    (ln L/L_h)² / s²  +  min over δ of [turns(ln Q_h + δ) + δ²/s²]  +  what gyros do not read  +  what it assumes,

with s the usual scale error of a device. What it assumes is how often units, counts and rates are met in logs that do
not say them (`recording/columns/scales.py`, `drafting/times.py`); a unit in the name of a column is believed. A scale
or a rate of no table is taken as it is found, and pays for all it might have been: the density of a Gaussian of width s
over an even one of so many orders of magnitude, 2 ln(range / (s √2π)).

The log is read once, as raw numbers at a rate that need not be its own; rests are found by the accelerometers, whose
scatter needs no unit. The rests give the length of gravity, the zero about which it turns and the gyros' readings, the
turns between them the likelihood of Q (`turn_likelihood`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise

import numpy as np

from tumble.diagnosis.turn_likelihood import (
    MOST_TURNS,
    WIDTHS,
    TurnLikelihood,
    Widths,
    cost_of_free_scale,
    ends_tilted,
    turn_likelihoods,
)
from tumble.drafting.draft import Draft
from tumble.drafting.times import ASSUMED_RATE, RATES_OF_LOGS, UNUSUAL, USUAL_RATES, Times, at_rate
from tumble.errors import TumbleError
from tumble.recording.columns.names import ACCEL, GYRO
from tumble.recording.columns.numbers import MIDDLES
from tumble.recording.columns.scales import CANDIDATES, FASTEST, MET, NEAR, ON_NO_SHEET, ONE, KnownScale, off_table
from tumble.recording.log import open_log
from tumble.reduction.blocks.reducer import Reduction, reduce_log
from tumble.reduction.blocks.tuning import USUAL, Tuning
from tumble.reduction.rests.rests import sphere_through
from tumble.reduction.rests.segmentation import Stretch, find_rests
from tumble.rotation import unit_vector
from tumble.run.observed import LARGEST_SQUARED, Progress
from tumble.sensors.model import Block
from tumble.units import ACCEL_UNITS, DEGREE, G_STANDARD, GYRO_UNITS, Array

_TRIAD = Block(kind="accel", axes=np.eye(3))
_CLIPPED, _BELOW = 3, 0.97
_NO_OFFSET, _LEAST_SINGULAR, _ALIKE = 0.3, 0.05, 0.05
_MOVING = 0.2
"""What the median magnitude of accelerometers that are never at rest may be off gravity, part of it."""
_UNEVEN, _STEPS_TO_CENTRE = 0.01, 4
"""What readings of one g differ by from attitude to attitude, part of it, beside their offsets."""
_USUAL = 0.8
"""The quantile of what the gyros read in a turn that is taken as that of its midst."""
_RATES = 0.25, 1.0, 4.0
"""Times the assumed rate: where the rate is unclear, rests are sought by these; by too high a one they seem too
short."""

_RATE_RANGE = math.log(RATES_OF_LOGS[1] / RATES_OF_LOGS[0])
"""The range of the logarithm of a rate of which nothing is known."""
COUNTS = KnownScale(value=1.0, shares=(1.0, 1.0))
"""Of gyros that nothing turned, whatever they are worth."""
_ZERO = 0.1
"""Standard deviation of the zero of accelerometers in a unit, part of gravity."""
_RAW_IN_A_UNIT = 0.1
"""Share of sensors that are in a unit though their name says that they are raw: `gyroADC` of Betaflight."""
_FEWEST_COUNTS = 2.0
"""Per g, with which accelerometers tell anything."""
_HOPELESS = 40.0
"""An accelerometer's unit that costs so much more than the best is not combined with others."""
_LARGEST_BIAS, _LARGEST_NOISE = 20.0 * DEGREE, 0.17 * DEGREE
"""rad/s: of small gyros, and how they scatter in a second."""
_BEYOND = 0.25
"""Standard deviation of ln of what is read beyond these."""
_AT_MOST = 12.0
"""What that costs: the device may have moved without its accelerometers showing it."""
SHORT_REST = 0.6
"""s: rests are no shorter, at the median."""
_ON_A_TABLE = 0.015
"""m/s² in a second: accelerometers that scatter more are held in a hand, or on a machine that runs."""
_TOO_FAST, _IN_STEPS = 30.0, -12.0
"""What it costs to read more than any gyro can, and that readings are multiples of a step of data sheets in °/s."""


# -------------------- what rests and turns show --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Evidence:
    """Length of gravity, readings at rest and turns of a recording, in raw numbers, with durations counted at `rate`,
    Hz.

    `rests` and `turns` are counts; `length` is that of gravity, `length_u` its relative standard uncertainty, and
    `zero` the offset of the accelerometers. At the rests: readings of the gyros `gyro` (N, 3), numbers of `samples`
    (N,) and the scatter of a sample, for accelerometers relative to gravity. `turning` is the usual reading of the
    gyros in a turn, `profiles` the likelihoods of the turns, first that with the columns as they are."""

    rate: float
    length: float
    length_u: float
    rests: int = 0
    turns: int = 0
    zero: Sequence[float] = (0.0, 0.0, 0.0)
    gyro: Array = field(default_factory=lambda: np.empty((0, 3)))
    samples: Array = field(default_factory=lambda: np.empty(0))
    accel_scatter: float = 0.0
    gyro_scatter: float = 0.0
    turning: float = 0.0
    profiles: tuple[TurnLikelihood, ...] = ()

    @property
    def bias(self) -> Array:
        """Median reading of the gyros at rest (3,)."""
        return np.median(self.gyro, axis=0) if len(self.gyro) else np.zeros(3)


def evidence_of(draft: Draft, progress: Progress, widths: Widths = WIDTHS) -> Evidence:
    """Evidence of a draft's log.

    Where the rate is unclear, rows are counted instead of times, and rests are sought with windows for several rates;
    the trial is taken whose turns are least likely for gyros that read noise, or that has most rests."""
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
        return Evidence(rate=draft.rate, length=draft.magnitude, length_u=_MOVING)
    if ACCEL not in draft.triads:
        means = np.concatenate([file.accel.means for file in reduction.files])  # gyros, at rest most of the time
        middle = np.median(means, axis=0)
        scatter = 1.4826 * float(np.median(np.abs(means - middle))) * math.sqrt(reduction.files[0].size)
        return Evidence(rate=reduction.rate, length=1.0, length_u=_MOVING, gyro=middle[None], gyro_scatter=scatter)
    trials = [_with_windows(reduction, factor, draft.magnitude, widths) for factor in factors]
    return max(trials, key=lambda t: (max((p.unturned - p.least for p in t.profiles), default=0.0), t.rests))


def _with_windows(reduction: Reduction, factor: float, magnitude: float, widths: Widths) -> Evidence:
    """Evidence with rests sought in windows `factor` times as long; without rests, gravity has the given
    `magnitude`."""
    seconds = (f.name for f in fields(Tuning) if f.metadata["unit"] == "s")
    tuning = replace(USUAL, **{name: factor * getattr(USUAL, name) for name in seconds})
    channels, files = (*reduction.accel_channels, *reduction.gyro_channels), reduction.by_file
    spans: tuple[Stretch, ...] = ()
    if max(max(-c.minimum, c.maximum) for c in channels) < LARGEST_SQUARED:
        with np.errstate(invalid="ignore"):  # of a stretch of zeros
            found = find_rests(replace(reduction, tuning=tuning), _TRIAD, None).rests
        spans = tuple(s for s in found if files[s.file].accel.means[s.first : s.last].any())
    if not spans:
        return Evidence(rate=reduction.rate, length=magnitude, length_u=_MOVING)
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
    return Evidence(
        rate=reduction.rate,
        rests=len(spans),
        turns=len(turns),
        length=length,
        zero=zero,
        length_u=length_u,
        gyro=rates,
        samples=np.array([(s.last - s.first) * files[s.file].size for s in spans]),
        accel_scatter=scatters[0] / max(length, 1e-300),
        gyro_scatter=scatters[1],
        turning=float(np.median(readings)) if turns else 0.0,
        profiles=turn_likelihoods(turns, widths),
    )


def length_and_zero(means: Array, widths: Widths = WIDTHS) -> tuple[float, float, list[float], Array]:
    """Length of gravity and zero of accelerometers from mean readings (N, 3) at rest.

    The zero is the centre of the sphere through the readings, or exactly 0 or the middle of a converter if the centre
    is near to that, or if the readings determine no sphere. The length is a least-squares solution of |m − c| = r with
    offsets of the usual size from a known zero, so that few rests do not move it far.

    Returns the raw numbers for one g with their relative standard uncertainty, the zero of each sensor, to five digits,
    and the readings (N, 3) relative to the centre."""
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
    reduction: Reduction, spans: tuple[Stretch, ...], up: Array, rates: Array
) -> list[tuple[Array, Array, Array]]:
    """Turns between rests of different attitude, the shortest first: integrals of the gyros above their bias (m, 3),
    and the vertical before and after.

    Turns are left out in which a gyro is clipped: it reads its largest value of all turns several times in a row, and
    rarely a little less."""
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


# -------------------- what that costs --------------------


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Hypothesis:
    """Units, scales and times that a log may have, and their cost. `profile`, None without turns, has the exchange of
    the gyros' columns."""

    accel: KnownScale
    gyro: KnownScale | None
    times: Times
    profile: TurnLikelihood | None
    cost: float

    def differs(self, other: Hypothesis) -> set[str]:
        """The parts in which two hypotheses differ."""
        parts = {
            ACCEL: self.accel != other.accel,
            GYRO: self.gyro != other.gyro,
            "time": self.times.keys != other.times.keys,
            "axes": self.profile is not other.profile,
        }
        return {part for part, unlike in parts.items() if unlike}


def ranked(shown: Evidence, draft: Draft, widths: Widths = WIDTHS) -> list[Hypothesis]:
    """All hypotheses of a log, the least cost first."""
    deviation = math.hypot(widths.scale, shown.length_u)
    with_accel = ACCEL in draft.triads
    accels = list(_assumed(ACCEL, draft, cost_of_free_scale(deviation))) if with_accel else [(COUNTS, 0.0)]
    gyros = list(_assumed(GYRO, draft, cost_of_free_scale(widths.scale))) if GYRO in draft.triads else []
    if not shown.profiles:  # what counts are worth nothing tells
        counted = sum(math.exp(-0.5 * cost) for gyro, cost in gyros if gyro.unit is None and gyro.known)
        units = [(gyro, cost) for gyro, cost in gyros if gyro.unit is not None]
        gyros = [*([(COUNTS, -2.0 * math.log(counted))] if counted else []), *units]
    if with_accel and draft.whole[ACCEL] and shown.length < _FEWEST_COUNTS:
        accels = [(accel, assumed) for accel, assumed in accels if accel.unit is not None] or accels
    stated = with_accel and ACCEL_UNITS[draft.unit(ACCEL) or "count"].kind != "raw"
    samples = float(np.median(shown.samples)) if shown.rests else np.inf
    out = []
    for profile in shown.profiles or (None,):
        for times, gyro, gyro_cost in _with_gyros(draft, shown, gyros, profile, widths):
            shorter = math.log(max(SHORT_REST * times.rate / samples, 1.0)) / _BEYOND
            of_accel = []
            for accel, assumed in accels:
                taken = accel if accel.known else replace(accel, value=shown.length)
                off = math.log(shown.length / taken.reads(times.rate)) / deviation
                away = max(map(abs, shown.zero)) / (_ZERO * shown.length) if accel.unit else 0.0
                paired = with_accel and gyro is not None and gyro.known
                pairs = MET["pairs"].get(accel.unit or "count", {})
                odds = pairs.get(gyro.unit or "count", 1.0) if paired and gyro is not None else 1.0
                cost = assumed - 2.0 * math.log(odds) + (0.0 if stated and accel.unit else off**2 + away**2)
                of_accel.append((taken, cost))
            least = min(cost for _, cost in of_accel)
            before = times.cost + shorter**2 + gyro_cost
            out += [
                Hypothesis(accel=accel, gyro=gyro, times=times, profile=profile, cost=before + cost)
                for accel, cost in of_accel
                if cost < least + _HOPELESS
            ]
    return sorted(out, key=lambda hypothesis: hypothesis.cost)


def _with_gyros(
    draft: Draft, shown: Evidence, gyros: list[tuple[KnownScale, float]], profile: TurnLikelihood | None, widths: Widths
) -> Iterator[tuple[Times, KnownScale | None, float]]:
    """Times and gyros with the cost of their turns, readings and assumptions. Where the rate is free, so is the one for
    which the turns fit a unit best."""
    every = (draft.times, *draft.times.rivals)
    nominal = None if profile is None else profile.of_nominal(widths.scale)
    if not gyros:
        yield from ((times, None, 0.0) for times in every)
    of_rate = next((times.cost - USUAL_RATES[times.rate] for times in every[1:] if not times.stamped), None)
    for gyro, assumed in gyros:
        trials = every
        if profile is not None and of_rate is not None and gyro.unit is not None and not gyro.increment:
            rate = profile.found() * DEGREE / gyro.value
            if RATES_OF_LOGS[0] <= rate <= RATES_OF_LOGS[1]:
                cost = of_rate - 2.0 * math.log(UNUSUAL) + cost_of_free_scale(widths.scale, _RATE_RANGE)
                trials = (*every, at_rate(float(f"{rate:.4g}"), cost))
        for times in trials:
            found, cost = gyro, assumed
            if profile is not None and not gyro.known:
                found = replace(gyro, value=float(f"{profile.found() * DEGREE / times.rate:.4g}"))
            if nominal is not None:
                cost += nominal.at(math.log(found.reads(times.rate) * times.rate / DEGREE))
            if profile is not None or gyro.unit is not None:
                cost += cost_of_readings(shown, found, times.rate, draft, widths)
            yield times, found, cost


def _assumed(kind: str, draft: Draft, unknown: float) -> Iterator[tuple[KnownScale, float]]:
    """Units and counts that sensors may have, each with the cost of the assumption.

    A unit in a name is taken as given; a name that says raw makes counts likelier. Counts of no data sheet may have any
    scale, at the cost `unknown`."""
    units, name = {ACCEL: ACCEL_UNITS, GYRO: GYRO_UNITS}[kind], draft.unit(kind)
    if name is not None and units[name].kind != "raw":
        one = ONE[kind] / units[name].factor
        increment = units[name].kind == "increment"
        yield KnownScale(value=one, unit=name, shares=(1.0, 1.0), increment=increment), 0.0
    elif name == "V":
        yield ON_NO_SHEET, 0.0
    else:
        for candidate in (*CANDIDATES[kind], ON_NO_SHEET):
            share = candidate.shares[draft.whole[kind]]
            share *= _RAW_IN_A_UNIT if name is not None and candidate.unit is not None else 1.0
            yield candidate, -2.0 * math.log(share) + (0.0 if candidate.known else unknown)


def cost_of_readings(shown: Evidence, gyro: KnownScale, rate: float, draft: Draft, widths: Widths) -> float:
    """Cost of a unit or scale of gyros by their readings.

    Biases above 20 °/s, a scatter of 0.17 °/s in a second on a table, more than any range and turns faster than by hand
    speak against it, steps of a data sheet for it."""
    one, root = DEGREE / gyro.reads(rate), math.sqrt(rate)
    limits = [(float(np.linalg.norm(shown.bias)), _LARGEST_BIAS)] if gyro.unit is not None else []
    if shown.accel_scatter * G_STANDARD / root < _ON_A_TABLE:
        limits.append((shown.gyro_scatter / root, _LARGEST_NOISE))
    cost = 0.0
    for value, limit in limits:
        if value * one > limit:
            cost += min((math.log(value * one / limit) / _BEYOND) ** 2, _AT_MOST)
    if draft.largest * one > FASTEST:
        cost += _TOO_FAST
    if shown.turning:
        cost += (math.log(shown.turning * one) / widths.turning) ** 2
    if gyro.unit == "deg/s" and draft.step is not None:
        cost += _IN_STEPS
    return cost
