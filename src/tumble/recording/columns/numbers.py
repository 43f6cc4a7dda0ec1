"""Columns without telling names, identified by their numbers: of all hypotheses, which three columns side by side are
accelerometers and which are gyros, the one of the least cost over the whole recording.

The cost is −2 times the logarithm of a likelihood, up to what all hypotheses have in common. Accelerometers read one
length at rest about a zero that is near none, in a unit or in counts of data sheets, and scatter little; as the body
turns their mean vectors spread over a sphere. Gyros read one and the same vector at rest, and turn the vector of the
accelerometers: da = −ω × a. The three sensors of a kind have the same noise. A time, a counter and a vector of a
filter are none of them.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from tumble.recording.columns.names import ACCEL, GYRO, Columns, Sensors, in_order
from tumble.recording.columns.scales import CANDIDATES, NEAR
from tumble.units import Array, BoolArray

_ELEMENT = re.compile(r"(.*)\[\d+\]")
_BLOCK = 25
_QUIET_SHARE = 0.4
_FEWEST_ROWS = 200
_ANEW = 1e-3
_CHANGES, _SECONDS = 0.02, 1e-4  # of the steps of a time; of one in whole seconds
CENTURY = 1.1e9, 2.2e9
"""s since 1970: 2004 to 2039."""
_SAME_NORM = 1e-5
_ROUNDED_NORM, _UNIT_NORM, _TURNED = 3e-3, 5e-3, 0.05
"""Of quaternions that are rounded: the spread of their length, how far its mean is from 1, and the least spread of
each of the four."""

# Standard deviations of what the cost weighs, as small sensors have it
_LENGTH = 0.05  # of gravity, from rest to rest: biases of 50 mg, scale errors of some percent
_ZERO = 0.25  # of gravity
_SCATTER = 0.02  # of gravity, of a sample at rest
_NOISE = 0.5  # logarithm of the noise of one axis over that of another
_STEADY = 0.25  # what gyros differ by at rest, over what they do in all
_COUNTED = 2.0  # −2 ln of the chance that a unit is a count of data sheets; with powers of two a sixth fit by chance
_RARE = 2.2  # −2 ln of 1 : 3, as rare counts are to common ones in `scales`
_NO_SCALE = 16.0  # in no unit, and in no counts
_CARRIED = 18.0  # gyros that turn the accelerometers' vector wholly, against some that do not at all
_AMID = 1.5  # three columns that are some of two threes
_BIAS = 0.5  # of gyros, a factor of e of their mean vector over what they do in all
_MOST = 9.0  # of a single deviation: three standard ones
_LIMIT = _COUNTED + _RARE + 1.0  # of accelerometers: rare counts, and one standard deviation
_NO_GYROS = 16.0  # a log of three more sensors without gyros
_BEFORE, _BETWEEN, _ASKEW, _LATER = 1.0, 4.0, 6.0, 8.0
"""What it costs that gyros stand before the accelerometers, three columns between the two, one or two, others before
both."""
_APART = 6.0
"""A hypothesis that costs so much more than another is 20 times less likely."""
_MOVES, _JUMPS, _FEWEST_MOVES = 0.05, 0.3, 20
"""Of gravity: changes of it from block to block that show gyros, those from which a position was skipped, and how
many of them tell."""

_MOVED = 0.01
"""Of gravity: what each accelerometer of a body that is never at rest scatters by, at least."""
_ABOUT_GRAVITY, _SHAKEN = 0.12, 0.4
"""Of gravity: what the median length of means over a block is off for a body that flies or walks, and their spread."""
_ONE_WAY = 0.05
"""Of the steps of a sensor half fall, whatever it is of: 1 of 20 and less by chance once in 50,000 times."""

MIDDLES = (128.0, 512.0, 2048.0, 8192.0, 32768.0, 2.0**23, 2.0**31)
"""Where a converter that knows no sign, and so writes nothing negative, has its zero."""

Run = tuple[int, int, int]
"""Three columns side by side."""


@dataclass(frozen=True, kw_only=True, slots=True)
class _Hypothesis:
    """Which columns are accelerometers and which gyros, None where none are, what that costs, and what of it the
    accelerometers do, less what the gyros' turning of their vector is worth."""

    cost: float
    of_accel: float
    accel: Run
    gyro: Run | None


def guesses(columns: Columns, named: Collection[str] = ()) -> list[str]:
    """A sentence on each kind of sensors that was identified by numbers and is not `named`."""
    triads = {kind: s for kind, s in columns.triads.items() if kind not in named}
    return [f"{kind}: columns {', '.join(s.columns)}, by their numbers (a guess)" for kind, s in triads.items()]


def columns_by_data(names: Sequence[str], read: Array) -> Columns:
    """What the columns (m, n) of a table with these names are; no triads where nothing looks like accelerometers.
    Columns of no numbers are NaN."""
    if not len(read):
        return Columns(time=None, time_unit=None, triads={})
    growing = [j for j in range(len(names)) if grows(read[:, j])]
    time = time_by_data(names, read) or (names[growing[0]] if growing else None)
    ranked = _hypotheses(names, read, [j for j in range(len(names)) if j not in growing])
    if not ranked:
        triads = _of_gravity_alone(names, read, [j for j in range(len(names)) if j not in growing])
        return Columns(time=time, time_unit=None, triads=triads)
    best, *others = ranked
    triads = {
        kind: Sensors(columns=in_order([names[j] for j in run]), unit=None)
        for kind, run in ((ACCEL, best.accel), (GYRO, best.gyro))
        if run is not None
    }
    # without any accelerometers, or with others
    next_cost = min([_LIMIT - best.of_accel, *(rival.cost - best.cost for rival in others[:1])])
    return Columns(time=time, time_unit=None, triads=triads, unsure=next_cost < _APART)


def _hypotheses(names: Sequence[str], read: Array, columns: Sequence[int]) -> list[_Hypothesis]:
    """All hypotheses, the cheapest first. Beside what a filter has fused, accelerometers are in a unit or counts of
    data sheets."""
    filled = [j for j in columns if np.isfinite(read[:, j]).mean() > 0.5]
    attitudes = _attitudes(read, filled)
    numbers = []  # that rise and fall: clocks, counters and the numbers of positions nearly always do the one
    for j in filled:
        steps = np.diff(read[np.isfinite(read[:, j]), j])
        rises, falls = np.count_nonzero(steps > 0.0), np.count_nonzero(steps < 0.0)
        if j not in attitudes and rises + falls > 0 and min(rises, falls) > _ONE_WAY * max(rises, falls):
            numbers.append(j)
    runs = [(j, j + 1, j + 2) for j in numbers if j + 1 in numbers and j + 2 in numbers]
    runs = [run for run in runs if _are_one_sensor([names[j] for j in run])]
    if not runs or len(read) < _FEWEST_ROWS or not (quiet := _quiet(read[:, numbers])).any():
        return []
    noise = {run: _unlike_noise(read[:, run], quiet) for run in runs}
    # where columns side by side are counted in threes, three are some of two threes
    first = {j: next(k for k in range(j, -1, -1) if k - 1 not in numbers) for j in numbers}
    amid = {run: _AMID * ((run[0] - first[run[0]]) % len(run) != 0) for run in runs}
    found: list[_Hypothesis] = []
    for accel in runs:
        cost = _cost_of_accelerometers(read[:, accel], quiet, fused=bool(attitudes)) + noise[accel] + amid[accel]
        found.append(_Hypothesis(cost=cost, of_accel=cost, accel=accel, gyro=None))
        for gyro in runs if cost <= _CARRIED + _LIMIT else ():
            if not set(gyro) & set(accel):
                carried = _cost_of_turns(read[:, gyro], read[:, accel], quiet)
                beside = carried + _unsteady(read[:, gyro], quiet) + noise[gyro] + amid[gyro] - _NO_GYROS
                beside += _BEFORE * (gyro[0] < accel[0]) + _BETWEEN * (abs(gyro[0] - accel[0]) // 3 - 1)
                beside += _ASKEW * ((gyro[0] - accel[0]) % 3 != 0)
                beside += _LATER * (min(gyro[0], accel[0]) >= first[accel[0]] + len("xyz"))
                of_accel = cost + min(carried, 0.0)
                found.append(_Hypothesis(cost=cost + beside, of_accel=of_accel, accel=accel, gyro=gyro))
    return sorted((h for h in found if h.of_accel <= _LIMIT), key=lambda h: h.cost)


def _of_gravity_alone(names: Sequence[str], read: Array, columns: Sequence[int]) -> dict[str, Sensors]:
    """Sensors of a log that is never at rest, and has three or six columns beside times and constants: accelerometers
    are the three, in a unit, whose length is about that of gravity most of the time, gyros the others; none where that
    is not clear."""
    filled = [j for j in columns if np.isfinite(read[:, j]).mean() > 0.5]
    varying = [j for j in filled if np.nanstd(read[:, j]) > 0.0]
    runs = [tuple(varying[k : k + 3]) for k in range(0, len(varying), 3)]
    if len(varying) not in (3, 6) or any(run[2] - run[0] != 2 for run in runs) or len(read) < _FEWEST_ROWS:
        return {}
    if not all(_are_one_sensor([names[j] for j in run]) for run in runs) or _attitudes(read, varying):
        return {}
    units = [c.value for c in CANDIDATES[ACCEL] if c.unit is not None and not c.increment]
    like = []
    for run in runs:
        rows = read[np.isfinite(read[:, run]).all(axis=1)][:, run]
        if len(rows) < _BLOCK:
            return {}
        lengths = np.linalg.norm(_means(rows)[0], axis=1)
        length, spread = float(np.median(lengths)), float(lengths.std())
        moved = float(rows.std(axis=0).min()) > _MOVED * length
        near = min(abs(np.log(length / unit)) for unit in units) < _ABOUT_GRAVITY
        like.append(moved and near and spread < _SHAKEN * length)
    if like.count(True) != 1:
        return {}
    in_order_of = sorted(range(len(runs)), key=lambda k: not like[k])
    return {
        kind: Sensors(columns=in_order([names[j] for j in runs[k]]), unit=None)
        for kind, k in zip((ACCEL, GYRO), in_order_of, strict=False)
    }


def _cost_of_accelerometers(columns: Array, quiet: BoolArray, *, fused: bool) -> float:
    """What it costs to take three columns for accelerometers, by themselves."""
    means, scatter = _rests(columns, quiet)
    read = columns[np.isfinite(columns)]
    whole = bool((read == np.floor(read)).all())
    centres = [(middle * np.ones(3), 0.0) for middle in (0.0, *(MIDDLES if whole and (means > 0.0).all() else ()))]
    spread = float(np.linalg.norm(means.std(axis=0)))
    if len(means) > len("xyz") and spread > 0.0:
        rows = np.column_stack([2.0 * means, np.ones(len(means))])  # of the sphere through the means
        centres.append((np.linalg.lstsq(rows, (means**2).sum(axis=1), rcond=None)[0][:3], 1.0))
    costs = []
    for centre, free in centres:
        lengths = np.linalg.norm(means - centre, axis=1)
        length = float(lengths.mean())
        if not length > 0.0 or not np.isfinite(length):
            continue
        uneven = float(lengths.std()) / length
        scale = min(
            (np.log(length / c.value) / NEAR) ** 2 + (0.0 if c.unit else _COUNTED + _RARE * (not c.common))
            for c in CANDIDATES[ACCEL]
            if c.unit or whole
        )
        scale = scale if scale < _MOST + _COUNTED + _RARE else np.inf if fused else _NO_SCALE
        sphere = 2.0 * np.log(min(1.0, max(uneven, _LENGTH / 5.0) * length / max(spread, 1e-300)))
        zero = free * float(np.abs(centre).max()) / (_ZERO * length)
        shaken = float(np.linalg.norm(scatter)) / (_SCATTER * length)
        costs.append((uneven / _LENGTH) ** 2 + scale + sphere + zero**2 + min(shaken**2, _MOST))
    return float(min(costs, default=np.inf))


def _unsteady(columns: Array, quiet: BoolArray) -> float:
    """What it costs that three columns differ from rest to rest, as gyros do not, and read much beside what they vary
    by."""
    means, _ = _rests(columns, quiet)
    everything = float(np.linalg.norm(columns[np.isfinite(columns).all(axis=1)].std(axis=0)))
    of_rests = float(np.linalg.norm(means.std(axis=0))) / max(_STEADY * everything, 1e-300)
    bias = float(np.linalg.norm(np.median(means, axis=0))) / max(everything, 1e-300)
    return min(of_rests**2, _MOST) + _BIAS * float(np.log1p(bias))


def _cost_of_turns(rates: Array, accel: Array, quiet: BoolArray) -> float:
    """What it costs to say that three columns turn the vector of the accelerometers (m, 3), which is worth something
    where they do; nothing where too little turns. They turn it by the share of its changes that the rates (m, 3),
    whatever their scales and axes, explain as a turn, da = −(M ω) × a."""
    rates = rates - np.median(_rests(rates, quiet)[0], axis=0)
    known = np.isfinite(rates).all(axis=1) & np.isfinite(accel).all(axis=1)
    rates, accel = rates[known], accel[known]
    if not len(accel):
        return 0.0
    length = float(np.median(np.linalg.norm(accel, axis=1))) or 1.0
    width = 1
    while (blocks := len(accel) // width) >= 4 * _FEWEST_MOVES:
        a = accel[: blocks * width].reshape(blocks, width, 3).mean(axis=1) / length
        change = np.diff(a, axis=0)
        size = np.linalg.norm(change, axis=1)
        rank = max(_FEWEST_MOVES, blocks // 200)
        if np.partition(size, -rank)[-rank] >= 2.0 * _MOVES:
            break
        width *= 2
    else:
        return 0.0
    moves = (size > max(_MOVES, 5.0 * float(np.median(size)))) & (size < _JUMPS)
    if np.count_nonzero(moves) < _FEWEST_MOVES:
        return 0.0
    w = rates[: blocks * width].reshape(blocks, width, 3).mean(axis=1)
    middle, rate = 0.5 * (a[1:] + a[:-1])[moves], 0.5 * (w[1:] + w[:-1])[moves]
    axes = np.eye(3)
    rows = np.stack([np.cross(middle, axes[i]) * rate[:, [j]] for i in range(3) for j in range(3)], axis=2)
    wanted = change[moves].reshape(-1)
    matrix = rows.reshape(len(wanted), 9)
    matrix = matrix / np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    left = wanted - matrix @ np.linalg.lstsq(matrix, wanted, rcond=None)[0]
    return _CARRIED * (float(left @ left) / float(wanted @ wanted) - 0.5)


def _unlike_noise(columns: Array, quiet: BoolArray) -> float:
    """What it costs that the noises of three columns at rest differ; of a column that reads one number, half of the
    least of its steps."""
    _, scatter = _rests(columns, quiet)
    steps = [np.diff(np.unique(column[np.isfinite(column)])) for column in columns.T]
    noise = [max(float(s), 0.5 * float(step.min())) for s, step in zip(scatter, steps, strict=True)]
    return min(float(np.std(np.log(noise))) ** 2 / _NOISE**2, _MOST)


def _are_one_sensor(names: Sequence[str]) -> bool:
    """Whether three names differ in one word or letter alone, as those of the axes of a sensor do: TRSS, TQly and TSNR
    do not."""
    arrays = {found[1] if (found := _ELEMENT.fullmatch(name)) else "" for name in names}  # `imu/fb` of `imu/fb[2]`
    if len(arrays) > 1:
        return False
    parts = [re.findall(r"[^\W\d_]+|\d+", name.lower()) for name in names]
    if len(set(map(len, parts))) != 1:
        return False
    apart = [three for three in zip(*parts, strict=True) if len(set(three)) > 1]
    if len(apart) != 1 or all(word.isdecimal() for word in apart[0]):
        return len(apart) <= 1
    return len(set(map(len, apart[0]))) == 1 and sum(len(set(of)) > 1 for of in zip(*apart[0], strict=True)) == 1


def _attitudes(read: Array, numbers: Sequence[int]) -> set[int]:
    """Columns of quaternions, rounded ones too, and of vectors of unit length or of gravity that a filter has made:
    three or four that change their direction, and never their length, in motion too, which no sensor reads."""
    found: set[int] = set()
    for width, first in product((len("wxyz"), len("xyz")), numbers):
        run = [first + k for k in range(width)]
        columns = read[np.isfinite(read[:, run]).all(axis=1)][:, run] if set(run) <= set(numbers) - found else read[:0]
        if len(columns):
            length, spread = np.linalg.norm(columns, axis=1), columns.std(axis=0)
            four = width == len("wxyz") and abs(length.mean() - 1.0) < _UNIT_NORM and spread.min() > _TURNED
            alike = _ROUNDED_NORM if four else _SAME_NORM
            if length.std() < min(alike * length.mean(), 0.1 * spread.max()):
                found |= set(run)
    return found


def time_by_data(names: Sequence[str], read: Array) -> str | None:
    """The column of a table (m, n) that is a time; None where none grows as one, or only a counter of samples."""
    for name, column in zip(names, read.T, strict=True):
        if grows(column):
            steps = np.diff(column[np.isfinite(column)])
            if np.median(steps) != 1.0 or (steps != np.floor(steps)).any():  # else it counts, but for lost rows
                return name
    return None


def grows(column: Array) -> bool:
    """Whether a column is a time: it grows at an even pace, and never falls but where a counter starts anew."""
    read = column[np.isfinite(column)]
    steps = np.diff(read)
    anew = steps < -0.5 * np.ptp(read) if len(read) else np.zeros(0, dtype=bool)
    if 0 < np.count_nonzero(anew) <= max(1.0, _ANEW * len(steps)):
        steps[anew] = np.median(steps)
    dated = len(read) > 0 and CENTURY[0] < read[0] < CENTURY[1]
    if len(steps) < 10 or (steps < 0.0).any() or np.mean(steps > 0.0) < (_SECONDS if dated else _CHANGES):
        return False
    r = np.corrcoef(np.arange(len(steps) + 1), np.concatenate([[0.0], np.cumsum(steps)]))[0, 1]
    return bool(r > 0.95)


def _means(columns: Array) -> tuple[Array, Array]:
    """Means and scatters of blocks of rows."""
    blocks = columns[: len(columns) // _BLOCK * _BLOCK].reshape(-1, _BLOCK, columns.shape[1])
    with np.errstate(invalid="ignore"):
        return blocks.mean(axis=1), blocks.std(axis=1)


def _quiet(columns: Array) -> BoolArray:
    """The blocks of rows in which all columns scatter least."""
    _, scatter = _means(columns)
    read = np.asarray(np.isfinite(scatter).all(axis=1))
    if not read.any():
        return read
    size = np.median(scatter[read], axis=0)
    largest = np.max(scatter / np.where(size > 0.0, size, 1.0), axis=1)
    return np.asarray(read & (largest <= np.quantile(largest[read], _QUIET_SHARE)))


def _rests(columns: Array, quiet: BoolArray) -> tuple[Array, Array]:
    """Means of the quiet blocks, and the median scatter (3,) in them."""
    means, scatter = _means(columns)
    known = quiet & np.isfinite(means).all(axis=1)
    return means[known], np.median(scatter[known], axis=0)
