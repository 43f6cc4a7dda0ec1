"""One cost for every hypothesis of what a log is: units or counts of accelerometers and gyros, the times or the rate of
its rows, the order and signs of the gyros' columns.

Each predicts numbers of the recording: gravity has the length L_h in raw numbers, a turn of one radian the sum Q_h of
the gyros'. A hypothesis costs −2 times the logarithm of its probability, up to what all have in common:

    (ln L/L_h)² / s²  +  min over δ of [turns(ln Q_h + δ) + δ²/s²]  +  what gyros do not read  +  what it assumes,

s the usual scale error of a device. What it assumes is how often units, counts and rates are met in logs that do not
say them (`recording/columns/scales.py`, `drafting/times.py`); a unit in the name of a column costs nothing. A scale or
a rate of no table is taken as it is found, and pays for all it might have been: the density of a Gaussian of width s
over an even one of so many orders of magnitude, 2 ln(range / (s √2π)).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from tumble.diagnosis.turn_likelihood import WIDTHS, TurnLikelihood, Widths, cost_of_any
from tumble.drafting.draft import Draft
from tumble.drafting.hypotheses.shown import Shown
from tumble.drafting.times import RATES_OF_LOGS, UNUSUAL, USUAL_RATES, Times, at_rate
from tumble.earth import EARTH_RATE
from tumble.recording.columns.names import ACCEL, GYRO
from tumble.recording.columns.scales import CANDIDATES, FASTEST, ON_NO_SHEET, KnownScale
from tumble.units import ACCEL_UNITS, DEGREE, DEGREE_PER_HOUR, G_STANDARD, GYRO_UNITS

_RATES = math.log(RATES_OF_LOGS[1] / RATES_OF_LOGS[0])
"""The range of the logarithm of a rate of which nothing is known."""
_ODDS: Mapping[tuple[str | None, str | None], float] = {
    ("m/s^2", "rad/s"): 3.0, ("g", "deg/s"): 3.0, ("mg", "mdeg/s"): 5.0, ("m/s", "rad"): 30.0, ("m/s", "deg"): 30.0,
    ("m/s", "arcsec"): 30.0, ("cm/s^2", None): 5.0, (None, None): 30.0,
}  # fmt: skip
"""How much more often units of accelerometers and gyros come together than by themselves; None are counts."""
COUNTS = KnownScale(value=1.0, shares=(1.0, 1.0))
"""Of gyros that nothing turned, whatever they are worth."""
_ZERO = 0.1
"""Standard deviation of the zero of accelerometers in a unit, part of gravity."""
_RAW_IN_A_UNIT = 0.1
"""Share of sensors that are in a unit though their name says that they are raw: `gyroADC` of Betaflight."""
_HOPELESS = 40.0
"""An accelerometer's unit that costs so much more than the best is not combined with others."""
_LARGEST_BIAS, _LARGEST_NOISE = 20.0 * DEGREE, 0.17 * DEGREE
"""rad/s: of small gyros, and how they scatter in a second."""
_BEYOND = 0.25
"""Standard deviation of ln of what is read beyond these."""
SHORT_REST = 0.6
"""s: rests are no shorter, at the median."""
_ON_A_TABLE = 0.015
"""m/s² in a second: accelerometers that scatter more are held in a hand, or on a machine that runs."""
_TOO_FAST, _STEPS, _EARTH = 30.0, -12.0, -16.0
"""What it costs to read more than any gyro can; that readings are multiples of a step of data sheets in °/s, and that
they are the rate of the Earth: chances of 0.2 % and 0.03 %."""
_NEAR_EARTH, _APART = 0.15, math.cos(20.0 * DEGREE)
"""Of the Earth's rate: what a reading of it may be off. Cosine between verticals of attitudes that differ."""
_EARTH_UNITS = ("rad/s", "deg/s", "deg/h")
"""Increments are not tried: in one of their units the usual biases of small gyros are the Earth's rate."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Hypothesis:
    """What a log may be, and what that costs; the profile of the turns, None where there are none, has the exchange of
    the gyros' columns."""

    accel: KnownScale
    gyro: KnownScale | None
    times: Times
    profile: TurnLikelihood | None
    cost: float

    def differs(self, other: Hypothesis) -> set[str]:
        """The parts in which it is another than one."""
        parts = {
            ACCEL: self.accel != other.accel,
            GYRO: self.gyro != other.gyro,
            "time": self.times.keys != other.times.keys,
            "axes": self.profile is not other.profile,
        }
        return {part for part, unlike in parts.items() if unlike}


def ranked(shown: Shown, draft: Draft, widths: Widths = WIDTHS) -> list[Hypothesis]:
    """All hypotheses of a log that shows this, the cheapest first."""
    deviation = math.hypot(widths.scale, shown.length_u)
    accels = list(_assumed(ACCEL, draft, cost_of_any(deviation), widths))
    gyros = list(_assumed(GYRO, draft, cost_of_any(widths.scale), widths)) if GYRO in draft.triads else []
    if not shown.profiles:  # what counts are worth nothing tells
        counted = sum(math.exp(-0.5 * cost) for gyro, cost in gyros if gyro.unit is None and gyro.known)
        gyros = [(gyro, cost) for gyro, cost in gyros if gyro.unit is not None]
        gyros += [(COUNTS, -2.0 * math.log(counted))] if counted else []
    stated = draft.unit(ACCEL) is not None
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
                odds = _ODDS.get((accel.unit, gyro.unit), 1.0) if gyro is not None and gyro.known else 1.0
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
    draft: Draft, shown: Shown, gyros: list[tuple[KnownScale, float]], profile: TurnLikelihood | None, widths: Widths
) -> Iterator[tuple[Times, KnownScale | None, float]]:
    """Times with gyros and what these cost in them: by their turns, by what they read, and by what they assume. Where
    the rate may be any, that too with which the turns fit a unit best."""
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
                cost = of_rate - 2.0 * math.log(UNUSUAL) + cost_of_any(widths.scale, _RATES)
                trials = (*every, at_rate(float(f"{rate:.4g}"), cost))
        for times in trials:
            found, cost = gyro, assumed
            if profile is not None and not gyro.known:
                found = replace(gyro, value=float(f"{profile.found() * DEGREE / times.rate:.4g}"))
            if nominal is not None:
                cost += nominal.at(math.log(found.reads(times.rate) * times.rate / DEGREE))
            if profile is not None or gyro.unit is not None:
                cost += sum(of_reading for of_reading, _ in readings(shown, found, times.rate, draft, widths))
            yield times, found, cost


def _assumed(kind: str, draft: Draft, unknown: float, widths: Widths) -> Iterator[tuple[KnownScale, float]]:
    """Units and counts of sensors with what they assume: of those whose name says a unit that alone, or of gyros,
    rarely, another; of those whose name says that they are raw, counts sooner. Counts of no data sheet may be any."""
    units, name = {ACCEL: ACCEL_UNITS, GYRO: GYRO_UNITS}[kind], draft.unit(kind)
    raw = name is not None and units[name].kind == "raw"
    for candidate in (*CANDIDATES[kind], ON_NO_SHEET):
        share = candidate.shares[draft.whole[kind]]
        if raw or name is None:
            share *= _RAW_IN_A_UNIT if raw and candidate.unit is not None else 1.0
            yield candidate, -2.0 * math.log(share) + (0.0 if candidate.known else unknown)
        elif candidate.unit == name:
            yield candidate, 0.0
        elif kind == GYRO and candidate.unit is not None:
            yield candidate, -2.0 * math.log(share * widths.named_wrongly)


def readings(
    shown: Shown, gyro: KnownScale, rate: float, draft: Draft, widths: Widths = WIDTHS
) -> list[tuple[float, str]]:
    """What speaks against gyros of a unit or scale, or for them, by what they would read, as costs and in words: biases
    of more than 20 °/s, 0.17 °/s in a second on a table, more than any range, turns as no hand makes, the Earth."""
    one = DEGREE / gyro.reads(rate)
    bias = float(np.linalg.norm(shown.bias))
    noise = shown.gyro_scatter / math.sqrt(rate)
    on_table = shown.accel_scatter * G_STANDARD / math.sqrt(rate) < _ON_A_TABLE
    out = []
    if gyro.unit is not None and bias * one > _LARGEST_BIAS:
        words = f"at rest they read {bias:.3g}, which in {gyro.unit} would be {bias * one / DEGREE:.3g} °/s"
        out.append(((math.log(bias * one / _LARGEST_BIAS) / _BEYOND) ** 2, words))
    if on_table and noise * one > _LARGEST_NOISE:
        words = f"at rest they scatter by {noise:.2g} in a second, which in {gyro.said} would be "
        out.append(((math.log(noise * one / _LARGEST_NOISE) / _BEYOND) ** 2, f"{words}{noise * one / DEGREE:.2g} °/s"))
    if draft.largest * one > FASTEST:
        out.append(
            (_TOO_FAST, f"no gyro reads the {draft.largest * one / DEGREE:.4g} °/s that they would in {gyro.said}")
        )
    if shown.turning:
        out.append(((math.log(shown.turning * one) / widths.turning) ** 2, ""))
    if gyro.unit == "deg/s" and draft.step is not None:
        out.append((_STEPS, f"their steps are {draft.step:.4g} °/s, a count of data sheets"))
    if not shown.profiles and gyro.unit in _EARTH_UNITS and (earth := reads_the_earth(shown, one, draft.latitude)):
        out.append((_EARTH, earth))
    return out


def reads_the_earth(shown: Shown, one: float, latitude: float | None) -> str | None:
    """How gyros at rest whose numbers are each `one`, rad/s, show the rate of the Earth, in words; None where they do
    not. Biases would have to have that length, and follow the attitude as the Earth does: about the vertical as much of
    it as the latitude, rad, says, or, where that is not known, as much in one attitude as in another."""
    if not shown.rests:
        return None
    rates = shown.gyro * one
    length, about = np.linalg.norm(rates, axis=1), (rates * shown.up).sum(axis=1)
    u = shown.gyro_scatter * one / np.sqrt(shown.samples)
    if latitude is not None:
        expected = EARTH_RATE * math.sin(latitude)
        likewise = f"the Earth: {expected / DEGREE_PER_HOUR:.1f} at this latitude"
    elif (shown.up @ shown.up.T).min() < _APART:
        expected, likewise = float(about.mean()), "alike in attitudes that differ"
    else:
        return None
    if max(np.abs(length - EARTH_RATE).max(), np.abs(about - expected).max(), u.max()) > _NEAR_EARTH * EARTH_RATE:
        return None
    read, vertical = float(length.mean()) / DEGREE_PER_HOUR, float(about.mean()) / DEGREE_PER_HOUR
    return (
        f"at rest they read {read:.1f} °/h (the Earth: {EARTH_RATE / DEGREE_PER_HOUR:.1f}), {vertical:.1f} about the "
        f"vertical ({likewise}); a guess, right where their biases are below 2 °/h"
    )
