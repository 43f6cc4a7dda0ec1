"""Whether gyros carry the vertical from rest to rest, and if not, which unit, scale, sign or order of the columns would
make them; and whether up is up.

What the session states is a hypothesis beside others, all weighed by the likelihood of the turns (`turn_likelihood`):
another unit, another unit of the times, an exchange of columns and signs, any scale. Each costs what it assumes; the
stated one costs nothing, nor do scale errors that a calibration is for.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from tumble.diagnosis.channels import times_wrong
from tumble.diagnosis.observability import rough_directions
from tumble.diagnosis.turn_likelihood import (
    WIDTHS,
    TurnLikelihood,
    columns_text,
    cost_of_free_scale,
    ends_tilted,
    turn_likelihoods,
)
from tumble.earth import EARTH_RATE
from tumble.recording.session import Channels, LogSpec, Session
from tumble.recording.session.log_tables import GyroTable
from tumble.reduction.observations import Observations
from tumble.rotation import onto_body, unit_vector
from tumble.sensors.model import SensorModel
from tumble.units import DEGREE, GYRO_UNITS, TIME_UNITS, Array

CARRIED = 0.25
"""rad: the turns of nominal gyros miss the vertical by less at the median, unless a unit, a sign or a column is
wrong."""
EVIDENT = 0.5
"""rad: no half turn of nominal gyros misses the vertical by as much: bias, scale and axis errors of 5 % leave less."""
SMALL_SCALE_ERROR = 0.1  # scale-factor errors that a calibration is for
FASTEST_TURN = 10.0  # rad/s: by hand or on a table
_RATES, _SHORTEST_LOG = (0.5, 20_000.0), 2.0  # hz, and s, of a log that is one
BIAS_LIMIT = 100.0  # rad/s: what no gyro measures, let alone as its bias
UPRIGHT = 20.0 * DEGREE
"""How far a rest may be from its position of the programme to count as that position, or as it upside down."""
_SIGN = "an accelerometer at rest with its axis up must read +g"


def sense_faults(observations: Observations, session: Session, rate: float) -> list[str]:
    """Whether nominal gyros carry the vertical from rest to rest, and if not, which unit, scale, sign or exchange of
    columns would make them; and whether up is up. `rate`: samples per second."""
    turns, block, channels = observations.turns, observations.gyro_block, session.log.gyro
    if turns is None or block is None or channels is None or len(turns) == 0:
        return upside_down(observations, session)
    stated = SensorModel(matrix=block.nominal().matrix, bias=np.median(observations.rests.gyro, axis=0))
    force = observations.accel_block.nominal().apply(observations.rests.accel)
    vertical = unit_vector(force)
    miss = _misses(observations, stated, vertical)
    if miss.max() < EVIDENT:
        if (largest := float(np.abs(stated.bias).max())) > BIAS_LIMIT:
            return [f"the gyros read {largest:.3g} rad/s at rest, as no gyro does: the offset of [log.gyro] is wrong"]
        return upside_down(observations, session)
    # half a g of bias of the accelerometers moves a vertical by 30°: where that explains what the gyros miss, verticals
    # are those about the centre of all readings
    about_centre = rough_directions(force)
    trial = _misses(observations, stated, about_centre)
    if trial.mean() < 0.5 * min(float(miss.mean()), CARRIED) and trial.max() < 0.5 * miss.max():
        vertical, miss = about_centre, trial
    lost = (
        "the gyros do not carry the vertical from rest to rest: they miss it by "
        f"{miss.max() / DEGREE:.0f}° at worst and by {np.median(miss) / DEGREE:.0f}° at the median of {len(miss)} turns"
    )
    likelihoods = turn_likelihoods(list(_tilted_turns(observations, stated.bias, vertical)))
    seconds = float(observations.rests.stop.max())
    others = sorted(_others(likelihoods, channels, session.log, rate, seconds), key=lambda other: other[0])
    nominal, unexplained = 1.0, math.inf
    if likelihoods:
        nominal = likelihoods[0].found(0.0, SMALL_SCALE_ERROR)
        unexplained = likelihoods[0].at(math.log(nominal))
    if others and others[0][0] < unexplained:
        return [f"{lost}{others[0][1]}"]
    if channels.raw and np.all(channels.scale == 1.0):
        return [
            f"{lost}: log.gyro.scale is 1, as if the numbers were no raw ones; write the counts per deg/s of "
            "the data sheet (16.4, 32.8, 65.5, 131 …), or let `tumble new` find them from the turns"
        ]
    miss = _misses(observations, SensorModel(matrix=nominal * stated.matrix, bias=stated.bias), vertical)
    per_half_turn = miss / np.maximum(1.0, _turned(observations, stated) / np.pi)
    if np.median(per_half_turn) < CARRIED:
        return [
            f"the gyros lose the vertical in {observations.turn_named(int(k))}: they miss it by "
            f"{miss[k] / DEGREE:.0f}°; look there for damaged or lost samples, or leave it out: [[exclude]] turn = "
            f"{int(turns.first[k]) + 1}"
            for k in np.flatnonzero(per_half_turn >= EVIDENT)
        ] or upside_down(observations, session)
    return [
        f"{lost}, and no other unit, scale, sign or order of columns explains it: check the columns, the unit "
        "and [log.gyro] axes"
    ]


def _tilted_turns(observations: Observations, bias: Array, vertical: Array) -> Iterator[tuple[Array, Array, Array]]:
    """Of each turn that ends with another side up the angles (m, 3), rad, of its samples by the stated gyros, and the
    verticals before and behind it."""
    turns, samples, block = observations.turns, observations.turn_samples, observations.gyro_block
    assert turns is not None
    assert samples is not None
    assert block is not None
    at_rest = onto_body(block.axes) @ bias
    angles: dict[int, list[Array]] = {}
    for pieces in samples.pieces():
        for turn, start, stop in zip(pieces.turn, pieces.start, pieces.stop, strict=True):
            part = (pieces.rates[start:stop] - at_rest) * pieces.intervals[start:stop, None]
            angles.setdefault(int(turn), []).append(part)
    for turn, parts in angles.items():
        before, behind = vertical[turns.first[turn]], vertical[turns.last[turn]]
        if ends_tilted(before, behind):
            yield np.concatenate(parts), before, behind


def _others(
    likelihoods: tuple[TurnLikelihood, ...], channels: Channels, log: LogSpec, rate: float, seconds: float
) -> Iterator[tuple[float, str]]:
    """What gyros may be other than the session states, as costs and in words; of a log of so many seconds."""
    if not likelihoods:
        return
    nominal, wrong = likelihoods[0].of_nominal(WIDTHS.scale), -2.0 * math.log(WIDTHS.named_wrongly)
    for name, unit in GYRO_UNITS.items():
        larger = unit.per_second(rate) / channels.unit.per_second(rate)
        if channels.raw:
            if name in GyroTable.SCALE_PER and unit.kind == channels.unit.kind and unit != channels.unit:
                fits = f'; the scale of [log.gyro] is not per that unit; scale_per = "{name}" would fit'
                yield wrong + nominal.at(-math.log(larger)), fits
        elif unit.kind != "raw" and unit != channels.unit:
            fits = f'; the unit of [log.gyro] is not "{channels.unit_name}", "{name}" would fit'
            yield wrong + nominal.at(-math.log(larger)), fits
    for name, factor in {} if log.time is None or log.clock else TIME_UNITS.items():
        longer = factor / log.time_factor
        if longer != 1.0 and _RATES[0] < rate / longer < _RATES[1] and seconds * longer > _SHORTEST_LOG:
            yield wrong + nominal.at(-math.log(longer)), f'; log.time_unit = "{name}" would fit'
    for exchanged in likelihoods[1:]:
        cost = exchanged.of_nominal(WIDTHS.scale).at(0.0)
        yield cost, f"; {columns_text(exchanged.exchange)}"
    ratio = likelihoods[0].found()
    said = f"; the gyros read about {ratio:.3g} times what they should"
    suspects = ["the nominal scale of [log.gyro]"] if channels.raw else []
    suspects += ["log.rate_hz"] if log.rate is not None else []
    said += f": {' or '.join(suspects)} is {times_wrong(ratio)}" if suspects else ""
    yield wrong + cost_of_free_scale(WIDTHS.scale) + likelihoods[0].at(math.log(ratio)), said


def _turned(observations: Observations, gyro: SensorModel) -> Array:
    """About how far (K,) each turn went at the usual rate, rad, whole revolutions included; nothing where that rate is
    none that a device is turned with."""
    with np.errstate(invalid="ignore", over="ignore"):
        turns = observations.turns_about(gyro)
        rate = float(np.median(np.nan_to_num(np.sqrt((turns.M**2).sum(axis=(1, 2, 3)))) / turns.duration))
    return turns.duration * (rate if rate < FASTEST_TURN else 0.0)


def _misses(observations: Observations, gyro: SensorModel, vertical: Array) -> Array:
    """Angles (K,), rad, between the vertical (N, 3) after each turn carried back by the gyros and the one before it; π
    where one is no number."""
    with np.errstate(invalid="ignore", over="ignore"):  # a wrong unit may make it thousands of radians a sample
        turns = observations.turns_about(gyro)
    cosine = np.einsum("kij,kj,ki->k", turns.C, vertical[turns.last], vertical[turns.first])
    return np.asarray(np.arccos(np.clip(np.nan_to_num(cosine, nan=-1.0), -1.0, 1.0)))


# -------------------- whether up is up --------------------


def upside_down(observations: Observations, session: Session) -> list[str]:
    """Whether all accelerometers have the wrong sign, by the programme or the vertical part of the Earth's rate."""
    vertical = unit_vector(observations.accel_block.nominal().apply(observations.rests.accel))
    if session.programme is not None:
        listed = session.programme.listed
        expected = np.array([p.vertical_b for p in listed.positions])
        comparable = listed.ordered and len(expected) == len(vertical)
        if comparable and np.all(np.einsum("ij,ij->i", vertical, expected) < -np.cos(UPRIGHT)):
            return [f"all accelerometers have the wrong sign: every rest is the programme's upside down; {_SIGN}"]
    if _earth_reversed(observations, vertical):
        return [
            "the gyros see the vertical part of the Earth's rate with the wrong sign: all accelerometers have the "
            f"wrong sign, or site.latitude_deg has; {_SIGN}, and latitudes are positive in the north"
        ]
    return []


def _earth_reversed(observations: Observations, vertical: Array) -> bool:
    """Whether û·ω = û·bias + s Ω sin B at rest says s = −1 and nothing near +1. The horizontal part of the Earth's
    rate is in none of it; gyros of lesser grades, and what they feel of specific force, are noise to it."""
    block, latitude = observations.gyro_block, observations.site.latitude
    if block is None or latitude is None or len(vertical) < 6:
        return False
    rate = np.einsum("ij,ij->i", block.nominal().apply(observations.rests.gyro), vertical)
    rows = np.column_stack([vertical, np.full(len(vertical), EARTH_RATE * np.sin(latitude))])
    found, _, rank, _ = np.linalg.lstsq(rows, rate)
    if rank < 4:
        return False
    scatter = ((rate - rows @ found) ** 2).sum() / (len(rate) - 4)
    slope, u = float(found[3]), float(np.sqrt(scatter * np.linalg.inv(rows.T @ rows)[3, 3]))
    return slope + 6.0 * u < 0.0 and abs(slope + 1.0) < 3.0 * u + 0.1
