"""Times of the rows of a log: the unit of the time column and whether its stamps are usable, or the sample rate.

Rival assumptions have a cost, −2 ln of their frequency in logs, and turns decide between them (`hypotheses`). Stamps
that repeat, bunch or jitter although rows are equally spaced are those of a coarse clock or a busy computer; the row
number is then the better clock (`regular`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np

from tumble.recording.columns.numbers import DATES
from tumble.recording.columns.scales import PRIORS
from tumble.recording.rows.timed import leaping
from tumble.units import TIME_UNITS, Array

ASSUMED_RATE = 100.0  # Hz
RATE_LIMITS = 2.0, 20_000.0  # Hz, of logs
_LEAST_RATE = 0.5  # Hz
_SHORTEST_LOG = 2.0  # s
_SLOW = 5.0  # Hz; in a slower log, dates may be the time since the start of a phone, in a thousandth of their unit
_BY_DATES = "by its dates"
_WEIGHTS = {float(rate): float(weight) for weight, rates in PRIORS["rates"].items() for rate in rates}
USUAL_RATES = {rate: -2.0 * math.log(weight / sum(_WEIGHTS.values())) for rate, weight in sorted(_WEIGHTS.items())}
"""Cost of each usual rate, Hz."""
_PRIOR = SimpleNamespace(**PRIORS["times"])
UNLISTED_SHARE: float = _PRIOR.unlisted_share
"""Share of logs with a rate that is not listed."""
_USUAL_BAND = 10.0, 2000.0  # Hz
_IRREGULAR_SHARE, _IRREGULAR_FREE = 2e-2, 3  # irregular steps that are tolerated: this number and this share
_PAUSE_SHARE, _PAUSE_FACTOR = 2e-3, 10.0  # a pause is longer than this factor times the (1 − share) quantile of steps
_NEAR_TYPICAL = 0.5  # of the typical step, for steps that are averaged: stamps in whole ms, without lost samples
_LONGEST_DELAY = 0.1  # of the log; longer delays are pauses
_JITTER = 0.25  # of the interval
_LINE_TOLERANCE = 3.0  # intervals, of stamps about a straight line, in addition to their delays
_FEWEST_STEPS = 10  # that grow; fewer tell no rate to some percent
_LEAST_GROWTH = 1e-9  # of stamps in all, in any unit
_FALLING_SHARE = 0.01  # of steps
_MOST_OVERFLOWS = 10_000
_LOST_AT_RESTART = 50  # samples that may be lost where a counter overflows
_MOST_RECORDINGS = 50  # in a log
_SHORTEST_RECORDING = 50  # rows
_RATE_IN_TEXT = re.compile(
    r"(?:rate|frequency|freq|fs|odr|\bat|частота|abtastrate|采样率)\w*[^0-9\n]{0,20}?(\d+(?:[.,]\d+)?)\s*(?:k?Hz|Гц|赫兹|$)",
    re.IGNORECASE,
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Times:
    """Times of rows: keys of [log], remarks, the rate, Hz, the cost of the assumption, and its rivals.

    `even`: stamps are even, or their rows equally spaced."""

    keys: dict[str, Any]
    remarks: tuple[str, ...]
    rate: float
    even: bool = True
    cost: float = 0.0
    rivals: tuple[Times, ...] = ()

    @property
    def stamped(self) -> bool:
        """Whether a column has the times."""
        return "time" in self.keys


def at_rate(rate: float, cost: float) -> Times:
    """Return the times of rows without usable stamps, at a rate in Hz."""
    return Times(keys={"rate_hz": rate}, remarks=(), rate=rate, cost=cost)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Stamps:
    """Time stamps of a log as written; with `clock` they are seconds converted from times of day."""

    column: str
    values: Array
    unit: str | None
    clock: bool = False


def times_without_column(rate: float | None, preamble: Sequence[str]) -> Times:
    """Return the times of a log without a time column: at the stated rate, that of the preamble, or a guess."""
    if rate is not None:
        return Times(keys={"rate_hz": rate}, remarks=(f"no time column: rate_hz = {rate:g} as given",), rate=rate)
    for line in preamble:
        match = _RATE_IN_TEXT.search(line)
        stated = float(match[1].replace(",", ".")) if match else 0.0
        if stated >= RATE_LIMITS[0]:
            remark = f"no time column: rate_hz = {stated:g}, from the line {line[:60]!r}"
            return Times(keys={"rate_hz": stated}, remarks=(remark,), rate=stated)
    remark = (
        f"no time column was found: rate_hz = {ASSUMED_RATE:g} is a guess, put the log's rate there (--sample-rate); "
        "every gyro scale factor depends on it"
    )
    rivals = tuple(at_rate(usual, cost) for usual, cost in USUAL_RATES.items() if usual != ASSUMED_RATE)
    return replace(at_rate(ASSUMED_RATE, USUAL_RATES[ASSUMED_RATE]), remarks=(remark,), rivals=rivals)


def times_of_column(stamps: Stamps) -> Times | None:
    """Return the unit and the rate of a time column; None if it does not grow like a time in any unit."""
    values = stamps.values[np.isfinite(stamps.values)]
    values = values[:-1] if len(values) > 3 and values[-1] < values[-2] else values  # the last line may be cut
    if len(values) < 3 or not grows_mostly(values):
        return None
    steps = np.diff(values)
    typical = _typical_step(steps)
    if not 0.0 < typical < math.inf or np.count_nonzero(steps > 0.0) < min(_FEWEST_STEPS, len(steps) // 2):
        return None
    units, how, doubts = _unit_costs(stamps, typical)
    if not units:
        return None
    fault = _fault_of_stamps(steps / typical)
    regular = fault is not None and _rows_are_equally_spaced(values)
    interval = typical
    near = np.abs(steps - typical) <= _NEAR_TYPICAL * typical
    if regular:
        interval = float(np.polynomial.Polynomial.fit(np.arange(len(values)), values, 1).convert().coef[1])
    elif fault is None and near.any():
        interval = float(steps[near].mean())
    trials = []
    for unit, cost in units.items():
        seconds = 1.0 if stamps.clock else TIME_UNITS[unit]
        rate, nominal = 1.0 / (interval * seconds), 1.0 / (typical * seconds)
        keys: dict[str, Any] = {"time": stamps.column}
        if stamps.clock or unit != "s":
            keys["time_unit"] = "iso8601" if stamps.clock else unit
        remarks = [f"time: column {stamps.column!r} in {'times of day' if stamps.clock else unit} ({how})"]
        if regular:
            keys["regular"] = True
            spaced = f"the rows are equally spaced: regular = true, {rate:.6g} samples per second"
            remarks.append(f"time: {fault}, but {spaced}")
        else:
            remarks[0] += f", {rate:.6g} samples per second"
            if fault is not None:
                remarks.append(f"time: {fault}, and the rows are not equally spaced either: look at the log")
        remarks += doubts
        if not RATE_LIMITS[0] <= nominal <= RATE_LIMITS[1]:
            remarks.append(f"time: {nominal:.3g} samples per second is no rate of a log: is the unit right?")
        trials.append(Times(keys=keys, remarks=tuple(remarks), rate=rate, even=regular or fault is None, cost=cost))
    first, *rivals = trials
    whole = bool((values == np.floor(values)).all())  # fractions are of seconds, not of samples or ticks
    if whole and not stamps.clock and stamps.unit is None and how != _BY_DATES:
        cost_of_counts = -2.0 * math.log(_PRIOR.counts_share if _grows_by_one(steps, typical) else _PRIOR.ticks_share)
        rivals += [at_rate(usual, cost + cost_of_counts) for usual, cost in USUAL_RATES.items()]
    return replace(first, rivals=tuple(rivals))


def _typical_step(steps: Array) -> float:
    """Return the median step, or the mean without pauses if stamps are coarse or come in bursts."""
    long = float(np.quantile(steps, 1.0 - _PAUSE_SHARE))
    usual = steps[steps <= _PAUSE_FACTOR * long] if long > 0.0 else steps
    median, mean = float(np.median(steps)), float(usual.mean())
    coarse = np.mean(steps <= 0.0) > _IRREGULAR_SHARE or np.mean(steps < 0.5 * mean) > 0.3
    return mean if median <= 1e-6 * mean or coarse else median


def are_even(values: Array) -> bool:
    """Return whether stamps are usable as a clock."""
    steps = np.diff(values)
    typical = _typical_step(steps)
    return typical > 0.0 and _fault_of_stamps(steps / typical) is None


def _fault_of_stamps(steps: Array) -> str | None:
    """Return why stamps are unusable as a clock, from steps in units of the typical one; None if they are even."""
    tolerated = _IRREGULAR_FREE + _IRREGULAR_SHARE * len(steps)
    jitter = float(1.4826 * np.median(np.abs(steps - np.median(steps))))
    if np.count_nonzero(steps <= 0.0) > tolerated:
        return f"time stamps repeat ({np.mean(steps <= 0.0):.0%} of them)"
    if np.count_nonzero(steps > 1.5) > tolerated and np.mean(steps < 0.5) > _IRREGULAR_SHARE:
        return "time stamps come in bursts" if np.mean(steps < 0.3) > 0.3 else "time stamps jitter"
    return f"time stamps jitter by {jitter:.0%} of the interval" if jitter > _JITTER else None


def _grows_by_one(steps: Array, typical: float) -> bool:
    return bool(typical == 1.0 and np.mean(steps == 1.0) > 1.0 - _IRREGULAR_SHARE)


def grows_mostly(values: Array) -> bool:
    """Return whether stamps grow, except where a clock restarts or rows are out of order."""
    steps = np.diff(values[np.isfinite(values)])
    return bool(steps[steps > 0.0].sum() > _LEAST_GROWTH and np.mean(steps < 0.0) <= _FALLING_SHARE)


def overflow_of(values: Array) -> float | None:
    """Return the number at which the counter behind stamps overflows; None if the falls are not of one size."""
    values = values[np.isfinite(values)]
    steps = np.diff(values)
    falls = np.flatnonzero(steps < 0.0)
    rising = steps[steps >= 0.0]
    if not 0 < len(falls) <= _MOST_OVERFLOWS or not len(rising):
        return None
    usual = float(rising.mean())
    for number in PRIORS["numbers"]["overflows"]:
        after = steps[falls] + number
        if float(np.ptp(values)) < number and ((after > 0.0) & (after < _LOST_AT_RESTART * usual)).all():
            return float(number)
    return None


def recordings_of(values: Array) -> list[tuple[int, int]] | None:
    """Return the ranges of rows of successive recordings in a log, each with a clock that restarts.

    None for one recording, and where a fall of the clock is small. Single stamps that leap or fall back are ignored,
    and a few first rows, before the clock was set, are left out."""
    single = leaping(values, -math.inf, 0.0)
    single[1:-1] |= (values[1:-1] < values[:-2]) & (values[2:] > values[:-2])
    rows = np.flatnonzero(~single)
    steps = np.diff(values[rows])
    falls = np.flatnonzero(steps < 0.0)
    if not 0 < len(falls) <= _MOST_RECORDINGS or (steps[falls] > -_LOST_AT_RESTART * np.median(steps)).any():
        return None
    edges = list(pairwise([0, *rows[falls + 1].tolist(), len(values)]))
    edges = edges if edges[0][1] >= _SHORTEST_RECORDING else edges[1:]
    return edges if min(stop - start for start, stop in edges) >= _SHORTEST_RECORDING else None


def _unit_costs(stamps: Stamps, step: float) -> tuple[dict[str, float], str, list[str]]:
    """Return the possible units of stamps with their costs, the likeliest first, how they were found, and doubts."""
    if stamps.clock:
        return {"s": 0.0}, "of a clock", []
    if stamps.unit is not None:
        return {stamps.unit: 0.0}, "by its name", []
    counts = _grows_by_one(np.diff(stamps.values), step)
    low, high = float(np.nanmin(stamps.values)), float(np.nanmax(stamps.values))
    rates = {name: 1.0 / (step * size) for name, size in TIME_UNITS.items()}
    costs = {name: cost for name, cost in _PRIOR.units.items() if _LEAST_RATE <= rates[name] <= RATE_LIMITS[1]}
    for name in list(costs):
        usual = _USUAL_BAND[0] <= rates[name] <= _USUAL_BAND[1]
        if TIME_UNITS[name] > 1.0 and not usual:  # times of a slow log are not in minutes
            del costs[name]
            continue
        short = (high - low) * TIME_UNITS[name] < _SHORTEST_LOG or (counts and rates[name] < RATE_LIMITS[0])
        costs[name] += _PRIOR.unusual_rate * (not usual) + _PRIOR.short_log * short
    dated = [name for name in costs if DATES[0] < low * TIME_UNITS[name] and high * TIME_UNITS[name] < DATES[1]]
    if dated and (rates[dated[0]] > _SLOW or min(costs.values()) >= _PRIOR.unusual_rate):
        return {dated[0]: 0.0}, _BY_DATES, []
    ranked = dict(sorted(costs.items(), key=lambda item: item[1]))
    counted = f"time: column {stamps.column!r} grows by one a row, as a counter of samples does too"
    return ranked, "by its steps", [f"{counted}: if it is one, give the rate (--sample-rate)"] if counts else []


def _rows_are_equally_spaced(values: Array) -> bool:
    """Return whether stamps stay near a straight line, without steps, as far as their largest delay explains."""
    index = np.arange(len(values), dtype=float)
    step = (values[-1] - values[0]) / (len(values) - 1)
    late = (values - values[0]) / step - index
    delay = float(np.max(np.diff(values)) / step)
    if delay > _LONGEST_DELAY * len(values):
        return False
    window = max(10, int(4 * delay))
    if len(values) < 3 * window:
        return bool(np.ptp(late) <= 2.0 * delay + _LINE_TOLERANCE)
    means = late[: len(late) // window * window].reshape(-1, window).mean(axis=1)
    near_line = np.ptp(late) <= 4.0 * delay + 2.0 * _LINE_TOLERANCE
    return bool(near_line and np.abs(np.diff(means)).max() <= delay + _LINE_TOLERANCE)
