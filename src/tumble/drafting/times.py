"""Times of the rows of a log: the unit of its time column, whether its stamps are usable as a clock, or its rate. Rival
assumptions have a cost, −2 ln of how often they are met, and turns decide between them.

Stamps that repeat, bunch or jitter while the rows go on evenly come from a coarse clock or a busy computer; then the
row number is the better clock (`regular`)."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from tumble.recording.columns.numbers import CENTURY
from tumble.recording.columns.scales import MET
from tumble.recording.rows.timed import leaping
from tumble.units import TIME_UNITS, Array

ASSUMED_RATE = 100.0
RATES_OF_LOGS = 2.0, 20_000.0
"""Hz."""
_SLOWEST = 0.5  # Hz, of a log that may be one
_SHORTEST_LOG = 2.0  # s
_SLOW = 5.0  # Hz: at less, dates may be what a phone has been running for, in a thousandth of their unit
_BY_DATES = "by its dates"
_WEIGHTS = {float(rate): float(weight) for weight, rates in MET["rates"].items() for rate in rates}
USUAL_RATES = {rate: -2.0 * math.log(weight / sum(_WEIGHTS.values())) for rate, weight in sorted(_WEIGHTS.items())}
"""What it costs that a log has one of the usual rates, Hz."""
UNUSUAL = 0.03
"""Share of logs at another rate."""
_TICKS, _COUNTS = 0.02, 0.4
"""Share of whole numbers without a unit that are ticks of a clock, and of those growing by one that count samples."""
_UNITS_IN_ORDER = {"s": 0.0, "ms": 0.5, "us": 1.0, "ns": 1.5, "min": 6.0, "h": 8.0}
_USUAL_BAND = 10.0, 2000.0  # Hz
_UNLIKELY_RATE, _UNLIKELY_SPAN = 5.0, 8.0  # in a log that is shorter than any, or counts seconds
_SHARE, _FREE = 2e-2, 3
_PAUSES, _PAUSE = 2e-3, 10.0
_LONGEST_DELAY = 0.1  # of the log: what is longer is a pause
_JITTER = 0.25
_UNEVEN = 3.0
_SHORTEST = 1e-9  # that stamps grow by in all, in any unit
_ANEW = 0.01
_RATE_IN_TEXT = re.compile(
    r"(?:rate|frequency|freq|fs|\bat|частота|abtastrate|采样率)\w*[^0-9\n]{0,20}?(\d+(?:[.,]\d+)?)\s*(?:k?Hz|Гц|赫兹|$)",
    re.IGNORECASE,
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Times:
    """Times of rows: keys of [log], remarks, the rate, Hz, the cost of the assumption, and its rivals."""

    keys: dict[str, Any]
    remarks: tuple[str, ...]
    rate: float
    cost: float = 0.0
    rivals: tuple[Times, ...] = ()

    @property
    def stamped(self) -> bool:
        """Whether a column has the times."""
        return "time" in self.keys


def at_rate(rate: float, cost: float) -> Times:
    """Rows without usable stamps, at a rate, Hz."""
    return Times(keys={"rate_hz": rate}, remarks=(), rate=rate, cost=cost)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Stamps:
    """All time stamps of a log as written; `clock`: seconds from times of day."""

    column: str
    values: Array
    unit: str | None
    clock: bool = False


def times_without_column(rate: float | None, preamble: Sequence[str]) -> Times:
    """Times of a log without time column: the rate as stated, as a line of its preamble says, or a guess."""
    if rate is not None:
        return Times(keys={"rate_hz": rate}, remarks=(f"no time column: rate_hz = {rate:g} as given",), rate=rate)
    for line in preamble:
        found = _RATE_IN_TEXT.search(line)
        stated = float(found[1].replace(",", ".")) if found else 0.0
        if stated >= RATES_OF_LOGS[0]:
            remark = f"no time column: rate_hz = {stated:g}, from the line {line[:60]!r}"
            return Times(keys={"rate_hz": stated}, remarks=(remark,), rate=stated)
    remark = (
        f"no time column was found: rate_hz = {ASSUMED_RATE:g} is a guess, put the log's rate there (--sample-rate); "
        "every gyro scale factor depends on it"
    )
    others = tuple(at_rate(usual, cost) for usual, cost in USUAL_RATES.items() if usual != ASSUMED_RATE)
    assumed = at_rate(ASSUMED_RATE, USUAL_RATES[ASSUMED_RATE])
    return replace(assumed, remarks=(remark,), rivals=others)


def times_of_column(stamps: Stamps) -> Times | None:
    """Unit and rate of a time column; None if it does not grow as times do."""
    values = stamps.values[np.isfinite(stamps.values)]
    values = values[:-1] if len(values) > 3 and values[-1] < values[-2] else values  # of a line that was cut
    if len(values) < 3 or not grows_mostly(values):
        return None
    steps = np.diff(values)
    typical = _typical(steps)
    if not 0.0 < typical < math.inf:
        return None
    units, how, doubts = _units(stamps, typical)
    uneven = _uneven(steps / typical)
    regular = uneven is not None and _even(values)
    line = np.polynomial.Polynomial.fit(np.arange(len(values)), values, 1).convert() if regular else None
    every = []
    for unit, cost in units.items():
        one = 1.0 if stamps.clock else TIME_UNITS[unit]
        nominal = 1.0 / (typical * one)
        rate = nominal if line is None else 1.0 / (float(line.coef[1]) * one)
        keys: dict[str, Any] = {"time": stamps.column}
        if stamps.clock or unit != "s":
            keys["time_unit"] = "iso8601" if stamps.clock else unit
        remarks = [f"time: column {stamps.column!r} in {'times of day' if stamps.clock else unit} ({how})"]
        per_second = f"{rate:.6g} samples per second"
        if regular:
            keys["regular"] = True
            remarks.append(f"time: {uneven}, but the rows are equally spaced: regular = true, {per_second}")
        else:
            remarks[0] += f", {per_second}"
            if uneven is not None:
                remarks.append(f"time: {uneven}, and the rows are not equally spaced either: look at the log")
        remarks += doubts
        if not RATES_OF_LOGS[0] <= nominal <= RATES_OF_LOGS[1]:
            remarks.append(f"time: {nominal:.3g} samples per second is no rate of a log: is the unit right?")
        every.append(Times(keys=keys, remarks=tuple(remarks), rate=rate, cost=cost))
    first, *others = every
    whole = bool((values == np.floor(values)).all())  # fractions are of seconds, and no counts of samples or ticks
    if whole and not stamps.clock and stamps.unit is None and how != _BY_DATES:
        ticks = -2.0 * math.log(_COUNTS if _counts(steps, typical) else _TICKS)
        others += [at_rate(usual, cost + ticks) for usual, cost in USUAL_RATES.items()]
    return replace(first, rivals=tuple(others))


def _typical(steps: Array) -> float:
    """Typical step between rows: the median, or where stamps are coarse or come in bursts the mean without long
    pauses."""
    long = float(np.quantile(steps, 1.0 - _PAUSES))
    usual = steps[steps <= _PAUSE * long] if long > 0.0 else steps
    median, mean = float(np.median(steps)), float(usual.mean())
    coarse = np.mean(steps <= 0.0) > _SHARE or np.mean(steps < 0.5 * mean) > 0.3
    return mean if median <= 1e-6 * mean or coarse else median


def _uneven(parts: Array) -> str | None:
    """What makes stamps unusable as a clock, by their steps relative to the typical one; None for even ones."""
    few, jitter = _FREE + _SHARE * len(parts), float(1.4826 * np.median(np.abs(parts - np.median(parts))))
    if np.count_nonzero(parts <= 0.0) > few:
        return f"time stamps repeat ({np.mean(parts <= 0.0):.0%} of them)"
    if np.count_nonzero(parts > 1.5) > few and np.mean(parts < 0.5) > _SHARE:
        return "time stamps come in bursts" if np.mean(parts < 0.3) > 0.3 else "time stamps jitter"
    return f"time stamps jitter by {jitter:.0%} of the interval" if jitter > _JITTER else None


def _counts(steps: Array, typical: float) -> bool:
    """Whether stamps grow by one per row."""
    return bool(typical == 1.0 and np.mean(steps == 1.0) > 1.0 - _SHARE)


def grows_mostly(values: Array) -> bool:
    """Whether stamps grow, except where a clock starts anew or rows are out of order."""
    steps = np.diff(values[np.isfinite(values)])
    return bool(steps[steps > 0.0].sum() > _SHORTEST and np.mean(steps < 0.0) <= _ANEW)


def past_midnight(values: Array) -> Array:
    """Times of day, s, that go on past midnight."""
    return np.asarray(values + 86400.0 * np.cumsum(np.diff(values, prepend=values[:1]) < -43200.0))


_OVERFLOWS = (3600.0, 65.536, 65536.0, 2.0**24, 2.0**32 / 1e6, 2.0**32 / 1e3, 2.0**32)
_MOST_OVERFLOWS = 10_000
_LATE = 50  # samples that may be lost where a counter starts anew
_MOST_RECORDINGS, _SHORTEST_RECORDING = 50, 50


def overflow_of(values: Array) -> float | None:
    """The number at which the counter behind time stamps overflows: 2^16, 2^24 or 2^32 in its own unit, in thousands or
    in millions of it, or an hour; None if the falls are not of one size."""
    values = values[np.isfinite(values)]
    steps = np.diff(values)
    falls = np.flatnonzero(steps < 0.0)
    span = float(np.ptp(values)) if len(values) else 0.0
    if not len(falls) or len(falls) > _MOST_OVERFLOWS:
        return None
    usual = float(steps[steps >= 0.0].mean())
    for number in _OVERFLOWS:
        after = steps[falls] + number
        if span < number and ((after > 0.0) & (after < _LATE * usual)).all():
            return number
    return None


def recordings_of(values: Array) -> list[tuple[int, int]] | None:
    """First and last + 1 row of successive recordings in a log, each with a clock that starts anew; None for one
    recording, and if a fall is small or a stretch between falls too short. Single stamps that leap or fall back do not
    count."""
    alone = leaping(values, -math.inf, 0.0)
    alone[1:-1] |= (values[1:-1] < values[:-2]) & (values[2:] > values[:-2])
    rows = np.flatnonzero(~alone)
    steps = np.diff(values[rows])
    falls = np.flatnonzero(steps < 0.0)
    if not 0 < len(falls) <= _MOST_RECORDINGS or (steps[falls] > -_LATE * np.median(steps)).any():
        return None
    edges = list(pairwise([0, *rows[falls + 1].tolist(), len(values)]))
    return edges if min(stop - start for start, stop in edges) >= _SHORTEST_RECORDING else None


def _units(stamps: Stamps, step: float) -> tuple[dict[str, float], str, list[str]]:
    """Units that time stamps may have, with the cost of each, the likeliest first; how they were determined; and
    doubts."""
    if stamps.clock:
        return {"s": 0.0}, "of a clock", []
    if stamps.unit is not None:
        return {stamps.unit: 0.0}, "by its name", []
    counts = _counts(np.diff(stamps.values), step)
    low, high = float(np.nanmin(stamps.values)), float(np.nanmax(stamps.values))
    rates = {name: 1.0 / (step * size) for name, size in TIME_UNITS.items()}
    costs = {name: cost for name, cost in _UNITS_IN_ORDER.items() if _SLOWEST <= rates[name] <= RATES_OF_LOGS[1]}
    for name in list(costs):
        usual = _USUAL_BAND[0] <= rates[name] <= _USUAL_BAND[1]
        if TIME_UNITS[name] > 1.0 and not usual:  # nobody writes the times of a slow log in minutes
            del costs[name]
            continue
        unlikely = (high - low) * TIME_UNITS[name] < _SHORTEST_LOG or (counts and rates[name] < RATES_OF_LOGS[0])
        costs[name] += _UNLIKELY_RATE * (not usual) + _UNLIKELY_SPAN * unlikely
    dated = [name for name in costs if CENTURY[0] < low * TIME_UNITS[name] and high * TIME_UNITS[name] < CENTURY[1]]
    if dated and (rates[dated[0]] > _SLOW or min(costs.values()) >= _UNLIKELY_RATE):
        return {dated[0]: 0.0}, _BY_DATES, []
    ranked = dict(sorted(costs.items(), key=lambda item: item[1])) or {"s": 0.0}
    counted = f"time: column {stamps.column!r} grows by one a row, as a counter of samples does too"
    return ranked, "by its steps", [f"{counted}: if it is one, give the rate (--sample-rate)"] if counts else []


def _even(values: Array) -> bool:
    """Whether rows are equally spaced: their stamps stay about a straight line, without steps, within what the largest
    delay of a stamp explains."""
    index = np.arange(len(values), dtype=float)
    step = (values[-1] - values[0]) / (len(values) - 1)
    late = (values - values[0]) / step - index
    delay = float(np.max(np.diff(values)) / step)
    if delay > _LONGEST_DELAY * len(values):
        return False
    window = max(10, int(4 * delay))
    if len(values) < 3 * window:
        return bool(np.ptp(late) <= 2.0 * delay + _UNEVEN)
    blocks = late[: len(late) // window * window].reshape(-1, window).mean(axis=1)
    return bool(np.ptp(late) <= 4.0 * delay + 2.0 * _UNEVEN and np.abs(np.diff(blocks)).max() <= delay + _UNEVEN)
