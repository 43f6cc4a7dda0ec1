"""When the rows of a log were taken: its time column and unit, whether the stamps can be believed, or its rate.

Stamps that repeat, bunch or jitter while the rows go on evenly are those of a slow clock or of a busy computer; the
rows are then the better clock (`regular`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from tumble.recording.rows.timed import leaping
from tumble.units import TIME_UNITS, Array

ASSUMED_RATE = 100.0
RATES_OF_LOGS = 2.0, 20_000.0
"""Hz."""
_SLOWEST = 0.5  # Hz, of a log that may be one
_SHORTEST_LOG = 2.0  # s
_CENTURY = 1.1e9, 2.2e9  # s since 1970: 2004 to 2039
_SLOW = 5.0  # Hz: at less, dates may be what a phone has been running for, in a thousandth of their unit
_BY_DATES = "by its dates"
_SHARE, _FREE = 2e-2, 3
_PAUSES, _PAUSE = 2e-3, 10.0
_LONGEST_DELAY = 0.1  # of the log: what is longer is a pause
_JITTER = 0.25
_UNEVEN = 3.0
_SHORTEST = 1e-9  # that stamps grow by in all, in any unit
_ANEW = 0.01
_RATE_IN_TEXT = re.compile(
    r"(?:rate|frequency|freq|fs|частота|abtastrate|采样率)\w*[^0-9\n]{0,20}?(\d+(?:[.,]\d+)?)\s*(?:k?Hz|Гц|赫兹|$)",
    re.IGNORECASE,
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Times:
    """Keys of [log] that say when rows were taken, what is said about it, the rate, Hz, and whether that is a guess;
    and whether the unit of a time column is one."""

    keys: dict[str, Any]
    said: tuple[str, ...]
    rate: float
    guessed: bool = False
    unit_guessed: bool = False


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Stamps:
    """All time stamps of a log, as they are; `clock`: s, from times of day."""

    column: str
    values: Array
    unit: str | None
    clock: bool = False


def times_without_column(rate: float | None, remarks: Sequence[str]) -> Times:
    """The rate of a log without times: as given, as its text says, or a guess."""
    if rate is not None:
        return Times(keys={"rate_hz": rate}, said=(f"no time column: rate_hz = {rate:g} as given",), rate=rate)
    for line in remarks:
        found = _RATE_IN_TEXT.search(line)
        stated = float(found[1].replace(",", ".")) if found else 0.0
        if stated >= RATES_OF_LOGS[0]:
            said = f"no time column: rate_hz = {stated:g}, from the line {line[:60]!r}"
            return Times(keys={"rate_hz": stated}, said=(said,), rate=stated)
    said = (
        f"no time column was found: rate_hz = {ASSUMED_RATE:g} is a guess, put the log's rate there (--sample-rate); "
        "every gyro scale factor depends on it"
    )
    return Times(keys={"rate_hz": ASSUMED_RATE}, said=(said,), rate=ASSUMED_RATE, guessed=True)


def times_of_column(stamps: Stamps) -> Times | None:
    """Unit and rate of a time column; None where it is none."""
    values = stamps.values[np.isfinite(stamps.values)]
    values = values[:-1] if len(values) > 3 and values[-1] < values[-2] else values  # of a line that was cut
    if len(values) < 3 or not grows_mostly(values):
        return None
    typical = _typical_step(values)
    if not 0.0 < typical < math.inf:
        return None
    taken, how, sure = _unit(stamps, typical)
    interval = typical * (1.0 if stamps.clock else TIME_UNITS[taken])
    keys: dict[str, Any] = {"time": stamps.column}
    if stamps.clock or taken != "s":
        keys["time_unit"] = "iso8601" if stamps.clock else taken
    whole = bool((values == np.floor(values)).all())  # fractions are of seconds, and no counts of samples or ticks
    guessed = whole and not stamps.clock and stamps.unit is None and how != _BY_DATES
    if not RATES_OF_LOGS[0] <= 1.0 / interval <= RATES_OF_LOGS[1]:
        sure = (*sure, f"time: {1.0 / interval:.3g} samples per second is no rate of a log: is the unit right?")
    uneven, rate = _unevenness(values, typical), 1.0 / interval
    said = f"time: column {stamps.column!r} in {'times of day' if stamps.clock else taken} ({how})"
    told = [f"{said}, {rate:.6g} samples per second"]
    if uneven is not None and not _even(values):
        told.append(f"time: {uneven}, and the rows are not equally spaced either: look at the log")
    elif uneven is not None:
        slope = np.polynomial.Polynomial.fit(np.arange(len(values)), values, 1).convert().coef[1]
        rate = 1.0 / (float(slope) * (1.0 if stamps.clock else TIME_UNITS[taken]))
        keys["regular"] = True
        told = [said, f"time: {uneven}, but the rows are equally spaced: regular = true, {rate:.6g} samples per second"]
    return Times(keys=keys, said=(*told, *sure), rate=rate, unit_guessed=guessed)


def grows_mostly(values: Array) -> bool:
    """Whether stamps grow, but for a few places at which a clock was started anew or rows are out of order."""
    steps = np.diff(values[np.isfinite(values)])
    return bool(steps[steps > 0.0].sum() > _SHORTEST and np.mean(steps < 0.0) <= _ANEW)


_OVERFLOWS = (65.536, 65536.0, 2.0**24, 2.0**32 / 1e6, 2.0**32 / 1e3, 2.0**32)
_MOST_OVERFLOWS = 10_000
_LATE = 50  # samples that may be lost where a counter starts anew
_MOST_RECORDINGS, _SHORTEST_RECORDING = 50, 50


def overflow_of(values: Array) -> float | None:
    """The number at which the counter behind time stamps starts anew, that of 16, 24 or 32 bits in its own unit or in
    thousands or millions of it; None where it does not, or where they fall otherwise too."""
    values = values[np.isfinite(values)]
    steps = np.diff(values)
    falls = np.flatnonzero(steps < 0.0)
    span = float(np.ptp(values)) if len(values) else 0.0
    if not len(falls) or len(falls) > _MOST_OVERFLOWS:
        return None
    usual = float(np.median(steps))
    for number in _OVERFLOWS:
        after = steps[falls] + number
        if span < number and ((after > 0.0) & (after < _LATE * usual)).all():
            return number
    return None


def recordings_of(values: Array) -> list[tuple[int, int]] | None:
    """First and last + 1 row of recordings that follow each other in a log, each with a clock that was started anew;
    None for one, and where stamps fall by little, or a stretch between falls is no recording. Single stamps that leap
    or fall back are no falls."""
    alone = leaping(values, -math.inf, 0.0)
    alone[1:-1] |= (values[1:-1] < values[:-2]) & (values[2:] > values[:-2])
    rows = np.flatnonzero(~alone)
    steps = np.diff(values[rows])
    falls = np.flatnonzero(steps < 0.0)
    if not 0 < len(falls) <= _MOST_RECORDINGS or (steps[falls] > -_LATE * np.median(steps)).any():
        return None
    edges = list(pairwise([0, *rows[falls + 1].tolist(), len(values)]))
    return edges if min(stop - start for start, stop in edges) >= _SHORTEST_RECORDING else None


def _typical_step(values: Array) -> float:
    """The step from row to row: the median, or the mean where the stamps are too coarse or come in bursts. A few steps
    that are far longer than all others are pauses and no part of the mean."""
    steps = np.diff(values)
    long = float(np.quantile(steps, 1.0 - _PAUSES))
    usual = steps[steps <= _PAUSE * long] if long > 0.0 else steps
    median, mean = float(np.median(steps)), float(usual.mean())
    again = np.mean(steps <= 0.0)
    burst = np.mean(steps < 0.5 * mean)
    return mean if median <= 1e-6 * mean or again > _SHARE or burst > 0.3 else median


def _unit(stamps: Stamps, step: float) -> tuple[str, str, tuple[str, ...]]:
    """The unit of time stamps, how it was found, and what is to be said where another is as likely."""
    if stamps.clock:
        return "s", "of a clock", ()
    if stamps.unit is not None:
        return stamps.unit, "by its name", ()
    steps = np.diff(stamps.values)
    counts = step == 1.0 and np.mean(steps == 1.0) > 1.0 - _SHARE
    low, high = float(np.nanmin(stamps.values)), float(np.nanmax(stamps.values))
    whole = math.inf if counts else high - low
    rates = {name: 1.0 / (step * size) for name, size in TIME_UNITS.items()}
    likely = [name for name, rate in rates.items() if _SLOWEST <= rate <= RATES_OF_LOGS[1]]
    since_1970 = ((name, TIME_UNITS[name]) for name in likely)
    dated = next((name for name, one in since_1970 if _CENTURY[0] < low * one and high * one < _CENTURY[1]), None)
    likely = [name for name in likely if whole * TIME_UNITS[name] >= _SHORTEST_LOG] or likely
    usual = [name for name in likely if 10.0 <= rates[name] <= 2000.0]
    if dated is not None and (rates[dated] > _SLOW or not set(usual) - {dated}):
        return dated, _BY_DATES, ()
    usual = usual or likely
    taken = usual[0] if usual else "s"
    others = [
        f"{name}: {rates[name]:.4g} Hz"
        for name in likely
        if name != taken and (name == dated or rates[name] >= RATES_OF_LOGS[0])
    ]
    sure = (f"time: the unit is a guess, possible too is {' or '.join(others)}",) if others else ()
    if counts:
        counted = f"time: column {stamps.column!r} grows by one a row, as a counter of samples does too: if it is one, "
        sure = (f"{counted}give the rate (--sample-rate)",)
    return taken, "by its steps", sure


def _unevenness(values: Array, typical: float) -> str | None:
    """What is wrong with time stamps as a clock; None where they will do."""
    steps = np.diff(values) / typical
    few = _FREE + _SHARE * len(steps)
    again, long = int(np.count_nonzero(steps <= 0.0)), int(np.count_nonzero(steps > 1.5))
    if again > few:
        return f"time stamps repeat ({again / len(steps):.0%} of them)"
    jitter = float(1.4826 * np.median(np.abs(steps - np.median(steps))))
    if long > few and np.mean(steps < 0.5) > _SHARE:
        return "time stamps come in bursts" if np.mean(steps < 0.3) > 0.3 else "time stamps jitter"
    return f"time stamps jitter by {jitter:.0%} of the interval" if jitter > _JITTER else None


def _even(values: Array) -> bool:
    """Whether rows are equally spaced: their stamps keep to a straight line, without steps, within what the worst delay
    of a stamp explains."""
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
