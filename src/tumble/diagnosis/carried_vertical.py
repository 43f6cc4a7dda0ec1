"""Faults of gyros that do not carry the vertical from rest to rest, and of accelerometers that are upside down.

The stated interpretation of the log competes with others by the likelihood of the turns (`turn_likelihood`): another
unit, another unit of time, exchanged columns or signs, any scale. Each costs what it assumes. The stated one costs
nothing, nor do scale errors of a size that calibration removes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from tumble.advice import Advised
from tumble.diagnosis.channels import scale_error
from tumble.diagnosis.observability import rough_directions
from tumble.diagnosis.turn_likelihood import (
    WIDTHS,
    TurnLikelihood,
    column_likelihoods,
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

MEDIAN_MISS = 0.25  # rad: nominal gyros miss the vertical by less at the median, unless unit, sign or column are wrong
LARGEST_MISS = 0.5  # rad: in a half turn, more than bias, scale and axis errors of 5 % cause
LOST_TURNS = 0.25  # largest share of turns that are left out for it; more are a fault of the gyros
SMALL_SCALE_ERROR = 0.1  # that calibration removes
FASTEST_TURN = 10.0  # rad/s: by hand or on a table
LOG_RATES, SHORTEST_LOG = (0.5, 20_000.0), 2.0  # Hz and s, of a plausible log
BIAS_LIMIT = 100.0  # rad/s: no gyro measures as much
UPRIGHT = 20.0 * DEGREE  # largest angle between a rest and its position of the programme
_SIGN = "an accelerometer at rest with its axis up must read +g"


def vertical_faults(
    observations: Observations, session: Session, rate: float, g_sensitivity: float
) -> tuple[list[str], dict[int, str]]:
    """Return why nominal gyros do not carry the vertical from rest to rest, or why accelerometers are upside down.

    Single turns that lose the vertical are returned apart: for the rest before each, from 0, the reason to leave it
    out. `rate` is in samples per second, `g_sensitivity` the usual one of the gyros, rad·s/m."""
    turns, block, channels = observations.turns, observations.gyro_block, session.log.gyro
    if turns is None or block is None or channels is None or len(turns) == 0:
        return upside_down(observations, session, g_sensitivity), {}
    stated = SensorModel(matrix=block.nominal().matrix, bias=np.median(observations.rests.gyro, axis=0))
    force = observations.accel_block.nominal().apply(observations.rests.accel)
    vertical = unit_vector(force)
    miss = _missed_angles(observations, stated, vertical)
    if miss.max() < LARGEST_MISS:
        if (largest := float(np.abs(stated.bias).max())) > BIAS_LIMIT:
            offset = f"the gyros read {largest:.3g} rad/s at rest, as no gyro does: the offset of [log.gyro] is wrong"
            return [offset], {}
        return upside_down(observations, session, g_sensitivity), {}
    # an accelerometer bias of half a g moves a vertical by 30°; if this explains the angles, verticals are taken about
    # the centre of all readings
    about_centre = rough_directions(force)
    trial = _missed_angles(observations, stated, about_centre)
    if trial.mean() < 0.5 * min(float(miss.mean()), MEDIAN_MISS) and trial.max() < 0.5 * miss.max():
        vertical, miss = about_centre, trial
    missed = (
        "the gyros do not carry the vertical from rest to rest: they miss it by "
        f"{miss.max() / DEGREE:.0f}° at worst and by {np.median(miss) / DEGREE:.0f}° at the median of {len(miss)} turns"
    )
    angles = _angles_of_samples(observations, onto_body(block.axes) @ stated.bias)
    ends = zip(angles, vertical[turns.first], vertical[turns.last], strict=True)
    tilting = [turn for turn in ends if ends_tilted(*turn[1:])]
    likelihoods, scale, stated_cost = turn_likelihoods(tilting), 1.0, math.inf
    if likelihoods:
        scale = likelihoods[0].best_q(0.0, SMALL_SCALE_ERROR)
        stated_cost = likelihoods[0].at(math.log(scale))
        others = [*_interpretations(likelihoods, channels, session.log, rate, float(observations.rests.stop.max()))]
        others += _columns_of_other_scales(tilting, block.axes, channels) if block.triad else ()
        cost, text = min(others, key=lambda other: other[0])
        if cost < stated_cost:
            return [f"{missed}{text}"], {}
    if channels.raw and np.all(channels.scale == 1.0):
        as_raw = Advised(
            f"{missed}: log.gyro.scale is 1, as if the numbers were no raw ones",
            "write the counts per deg/s of the data sheet (16.4, 32.8, 65.5, 131 …), or let `tumble new` find them "
            "from the turns",
        )
        return [as_raw], {}
    miss = _missed_angles(observations, SensorModel(matrix=scale * stated.matrix, bias=stated.bias), vertical)
    turned = np.array([float(np.linalg.norm(of_samples, axis=1).sum()) for of_samples in angles])
    plausible = np.median(turned / turns.duration) < FASTEST_TURN
    per_half_turn = miss / np.maximum(1.0, turned / np.pi if plausible else 0.0)
    lost = np.flatnonzero(per_half_turn >= LARGEST_MISS)
    if np.median(per_half_turn) < MEDIAN_MISS and len(lost) <= LOST_TURNS * len(miss):
        words = (f"the gyros miss the vertical after it by {miss[k] / DEGREE:.0f}°" for k in lost)
        return upside_down(observations, session, g_sensitivity), dict(
            zip(turns.first[lost].tolist(), words, strict=True)
        )
    unknown = f"{missed}, and no other unit, scale, sign or order of columns explains it"
    return [Advised(unknown, "check the columns, the unit and [log.gyro] axes")], {}


def _angles_of_samples(observations: Observations, bias: Array) -> list[Array]:
    """Return for each turn the angles (m, 3), rad, of its samples by gyros of this bias (3,) in the body."""
    turns, samples = observations.turns, observations.turn_samples
    assert turns is not None
    assert samples is not None
    angles = [[np.zeros((0, 3))] for _ in range(len(turns))]
    for turn, rates, _, intervals in samples.by_piece():
        angles[turn].append((rates - bias) * intervals[:, None])
    return [np.concatenate(pieces) for pieces in angles]


def _interpretations(
    likelihoods: tuple[TurnLikelihood, ...], channels: Channels, log: LogSpec, rate: float, duration: float
) -> Iterator[tuple[float, str]]:
    """Yield other interpretations of the gyros as costs and texts; `rate` in Hz and `duration` in s are of the log."""
    nominal, wrong_unit = likelihoods[0].of_nominal(WIDTHS.scale), -2.0 * math.log(WIDTHS.named_wrongly)
    ratios = dict[str, float]()  # by which a unit is larger than the stated one
    for name, unit in GYRO_UNITS.items():
        listed = name in GyroTable.SCALE_PER and unit.kind == channels.unit.kind if channels.raw else unit.kind != "raw"
        if listed and unit != channels.unit:
            text = f'; the unit of [log.gyro] is not "{channels.unit_name}", "{name}" would fit'
            if channels.raw:
                text = f'; the scale of [log.gyro] is not per that unit; scale_per = "{name}" would fit'
            ratios[text] = unit.per_second(rate) / channels.unit.per_second(rate)
    for name, factor in {} if log.time is None or log.clock else TIME_UNITS.items():
        ratio = factor / log.time_factor
        if ratio != 1.0 and LOG_RATES[0] < rate / ratio < LOG_RATES[1] and duration * ratio > SHORTEST_LOG:
            ratios[f'; log.time_unit = "{name}" would fit'] = ratio
    yield from ((wrong_unit + nominal.at(-math.log(ratio)), text) for text, ratio in ratios.items())
    for exchanged in likelihoods[1:]:
        yield exchanged.of_nominal(WIDTHS.scale).at(0.0), f"; {columns_text(exchanged.exchange)}"
    ratio = likelihoods[0].best_q()
    text = f"; the gyros read about {ratio:.3g} times what they should"
    suspects = ["the nominal scale of [log.gyro]"] if channels.raw else []
    suspects += ["log.rate_hz"] if log.rate is not None else []
    text += f": {' or '.join(suspects)} is {scale_error(ratio)}" if suspects else ""
    yield wrong_unit + cost_of_free_scale(WIDTHS.scale) + likelihoods[0].at(math.log(ratio)), text


def _columns_of_other_scales(
    turns: Sequence[tuple[Array, Array, Array]], axes: Array, channels: Channels
) -> Iterator[tuple[float, str]]:
    """Yield, for each column of a triad of gyros, another scale of this column alone, as cost and text.

    A scale of counts may come from the same columns. Therefore those of counts are tried in rad/s and deg/s, too."""
    tried = {"": np.ones(3)}  # factors of the stated readings, by what is said of the unit
    if channels.raw:
        counts = channels.scale / channels.unit.factor
        tried |= {f" if they are in {name}": counts * GYRO_UNITS[name].factor for name in ("rad/s", "deg/s")}
    per = "" if channels.raw else f'unit = "count", scale_per = "{channels.unit_name}" and '
    for condition, factor in tried.items():
        likelihoods = column_likelihoods(turns, axes, factor)
        free = cost_of_free_scale(WIDTHS.scale) - 2.0 * math.log(WIDTHS.named_wrongly / len(likelihoods) / len(tried))
        for column, (name, likelihood) in enumerate(zip(channels.columns, likelihoods, strict=True)):
            ratio, scale = likelihood.best_q(), channels.scale / factor
            scale[column] *= ratio
            remedy = f"{per}scale = [{', '.join(f'{value:.4g}' for value in scale)}] in [log.gyro] would fit"
            if not channels.raw and channels.unit_name not in GyroTable.SCALE_PER:
                remedy = "divide it by this"
            text = (
                f"; column {name!r} reads about {ratio:.3g} times what it should, as in another unit or range than the "
                f"other columns{condition}: {remedy}"
            )
            if abs(math.log(ratio)) > SMALL_SCALE_ERROR:
                yield free + likelihood.at(math.log(ratio)), text


def _missed_angles(observations: Observations, gyro: SensorModel, vertical: Array) -> Array:
    """Return the angle (K,), rad, between the vertical (N, 3) before each turn and that after it, carried back by the
    gyros; π if it is not a number."""
    with np.errstate(invalid="ignore", over="ignore"):  # a wrong unit may make thousands of radians per sample
        turns = observations.turns_about(gyro)
    cosine = np.einsum("kij,kj,ki->k", turns.C, vertical[turns.last], vertical[turns.first])
    return np.asarray(np.arccos(np.clip(np.nan_to_num(cosine, nan=-1.0), -1.0, 1.0)))


# -------------------- up and down --------------------


def upside_down(observations: Observations, session: Session, g_sensitivity: float) -> list[str]:
    """Return a fault if all accelerometers have the wrong sign, by the programme or the vertical Earth's rate."""
    vertical = unit_vector(observations.accel_block.nominal().apply(observations.rests.accel))
    if session.programme is not None:
        listed = session.programme.listed
        expected = np.array([p.vertical_b for p in listed.positions])
        comparable = listed.ordered and len(expected) == len(vertical)
        if comparable and np.all(np.einsum("ij,ij->i", vertical, expected) < -np.cos(UPRIGHT)):
            return [f"all accelerometers have the wrong sign: every rest is the programme's upside down; {_SIGN}"]
    if _earth_reversed(observations, vertical, g_sensitivity):
        return [
            "the gyros see the vertical part of the Earth's rate with the wrong sign: all accelerometers have the "
            f"wrong sign, or site.latitude_deg has; {_SIGN}, and latitudes are positive in the north"
        ]
    return []


def _earth_reversed(observations: Observations, vertical: Array, g_sensitivity: float) -> bool:
    """Return True if a fit of û·ω = û·bias + s Ω sin B at rest gives s = −1 and excludes +1.

    The horizontal Earth's rate does not affect it. The g-sensitivity G adds ûᵀG û: its trace changes s, by g/√3 for
    elements of size g, and the rest scatters by g √(2/3). g is the usual size, or that of the scatter beyond the noise
    if this is larger."""
    block, rests, site = observations.gyro_block, observations.rests, observations.site
    if block is None or site.latitude is None or len(vertical) < 6:
        return False
    nominal, vertical_rate = block.nominal(), EARTH_RATE * np.sin(site.latitude)
    rate = np.einsum("ij,ij->i", nominal.apply(rests.gyro), vertical)
    rows = np.column_stack([vertical, np.full(len(vertical), vertical_rate)])
    solution, _, rank, _ = np.linalg.lstsq(rows, rate)
    if rank < 4:
        return False
    along = vertical @ nominal.inverse()
    noise = float(np.einsum("ij,ijk,ik->i", along, rests.gyro_covariance, along).mean())
    scatter = float(((rate - rows @ solution) ** 2).sum()) / (len(rate) - 4)
    by_force = max((g_sensitivity * site.gravity) ** 2, 1.5 * (scatter - noise)) / 3.0 / vertical_rate**2
    s, by_noise = float(solution[3]), max(scatter, noise) * float((np.linalg.pinv(rows)[3] ** 2).sum())
    u = math.sqrt(by_noise + by_force)
    return s - 1.0 < -6.0 * u and abs(s + 1.0) < 3.0 * u + 0.1
