"""What columns without telling names are, by their numbers.

Where the body rests, accelerometers read a vector of one length in many directions, and gyros one and the same small
vector. So of three columns side by side the means over quiet stretches spread as far as the readings themselves for
accelerometers, and hardly at all for gyros. Of a body that never moves the accelerometers are those that read one
gravity. A time grows from row to row.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

import numpy as np

from tumble.recording.formats.columns import ACCEL, GYRO, Columns, in_order
from tumble.recording.formats.message import Sensors
from tumble.units import G_STANDARD, Array, BoolArray

_ELEMENT = re.compile(r"(.*)\[\d+\]")
_BLOCK = 25
_QUIET_SHARE = 0.4
_SAME_LENGTH = 0.15
_STEADY = 0.25
_FEWEST_ROWS = 200
_ANEW = 1e-3
_STILL = 0.05
_SAME_NORM = 1e-5
_ROUNDED_NORM, _UNIT_NORM, _TURNED = 3e-3, 5e-3, 0.05
"""Of quaternions that are rounded: the spread of their length, how far its mean is from 1, and the least spread of
each of the four."""
_NEAR, _OFF, _UNSTEADY = 0.06, 0.25, 0.6
_PLAIN, _STRANGEST = 2, 3
_THERMOMETER = 5.0

ACCEL_STEPS: tuple[float, ...] = tuple(sorted([*(float(2**k) for k in range(5, 18)), 800.0, 1200.0, 1e3 / 0.732, 1e6]))
"""Counts per g of data sheets: powers of two (which 0.061, 0.122 … mg per count are too), and others."""

MIDDLES = (128.0, 512.0, 2048.0, 8192.0, 32768.0, 2.0**23, 2.0**31)
"""Where a converter that knows no sign, and so writes nothing negative, has its zero."""


def columns_by_data(names: Sequence[str], read: Array) -> Columns:
    """What the columns (m, n) of a table with these names are; no triads where nothing looks like accelerometers.
    Columns of no numbers are NaN."""
    if not len(read):
        return Columns(time=None, time_unit=None, triads={}, temperatures=(), others=())
    growing = [j for j in range(len(names)) if grows(read[:, j])]
    numbers = [
        j
        for j in range(len(names))
        if j not in growing and np.isfinite(read[:, j]).mean() > 0.5 and _varies(read[:, j])
    ]
    attitudes = _attitudes(read, numbers)
    numbers = [j for j in numbers if j not in attitudes]
    runs = [(j, j + 1, j + 2) for j in numbers if j + 1 in numbers and j + 2 in numbers]
    runs = [run for run in runs if _are_one_sensor([names[j] for j in run])]
    runs.sort(key=lambda run: _is_amid(run, numbers))
    found: dict[str, Run] = {}
    if runs and len(read) >= _FEWEST_ROWS:
        found = _sensors(read, runs, _quiet(read[:, numbers]), fused=bool(attitudes)) or _at_rest(read, runs)
    return Columns(
        time=_time([names[j] for j in growing], read[:, growing]),
        time_unit=None,
        triads={kind: Sensors(columns=in_order([names[j] for j in run]), unit=None) for kind, run in found.items()},
        temperatures=(),
        others=(),
    )


def _are_one_sensor(names: Sequence[str]) -> bool:
    """Whether three names differ in one word or letter alone, as those of the axes of a sensor do: TRSS, TQly and TSNR
    do not."""
    if len({_array(name) for name in names}) > 1:
        return False
    parts = [re.findall(r"[^\W\d_]+|\d+", name.lower()) for name in names]
    if len(set(map(len, parts))) != 1:
        return False
    apart = [three for three in zip(*parts, strict=True) if len(set(three)) > 1]
    if len(apart) != 1 or all(word.isdecimal() for word in apart[0]):
        return len(apart) <= 1
    return len(set(map(len, apart[0]))) == 1 and sum(len(set(of)) > 1 for of in zip(*apart[0], strict=True)) == 1


def _array(name: str) -> str:
    """The array that a column is of, `imu/fb` of `imu/fb[2]`; nothing for others."""
    found = _ELEMENT.fullmatch(name)
    return found[1] if found else ""


Run = tuple[int, int, int]
"""Three columns side by side."""


def _is_amid(run: Run, numbers: Sequence[int]) -> bool:
    """Whether three columns are some of two threes, where columns side by side are counted in threes."""
    first = run[0]
    while first - 1 in numbers:
        first -= 1
    return (run[0] - first) % len(run) != 0


def _attitudes(read: Array, numbers: Sequence[int]) -> set[int]:
    """Columns of quaternions, rounded ones too, and of vectors of unit length or of gravity that a filter has made:
    three or four whose length is one and the same in motion too, which no sensor reads."""
    found: set[int] = set()
    for width in (4, 3):
        for first in numbers:
            run = [first + k for k in range(width)]
            if not found & set(run) and set(run) <= set(numbers) and _turns_alone(read[:, run]):
                found |= set(run)
    return found


def _turns_alone(columns: Array) -> bool:
    """Whether vectors change their direction, and never their length."""
    columns = columns[np.isfinite(columns).all(axis=1)]
    if not len(columns):
        return False
    length, spread = np.linalg.norm(columns, axis=1), columns.std(axis=0)
    four = columns.shape[1] == len("wxyz") and abs(length.mean() - 1.0) < _UNIT_NORM and spread.min() > _TURNED
    alike = _ROUNDED_NORM if four else _SAME_NORM
    return bool(length.std() < min(alike * length.mean(), 0.1 * spread.max()))


def _sensors(read: Array, runs: Sequence[Run], quiet: BoolArray, *, fused: bool) -> dict[str, Run]:
    """Accelerometers, which of those that read one length are those that read it as gravity, and the gyros that are
    next to them, behind them first. What is in no unit and no counts of data sheets is none beside what a filter has
    `fused`, without gyros, and where three others read gravity in a unit."""
    kinds = {run: _kind(read[:, run], quiet) for run in runs}
    accels = [run for run in runs if kinds[run] == ACCEL]
    strangeness = {run: _strangeness(read[:, run], quiet) for run in runs} if accels else {}
    told = min(accels, key=strangeness.__getitem__, default=None)
    if told is None:
        return {}
    # where one axis reads nearly all of gravity, two of three and another have its length too
    strange = strangeness[told]
    accel = next(run for run in runs if set(run) & set(told) and strangeness[run] <= strange)
    gyros = [run for run in runs if kinds[run] == GYRO and not set(run) & set(accel)]
    next_to = min(gyros, key=lambda run: (run[0] < accel[0], abs(run[0] - accel[0])), default=None)
    others = (run for run in runs if run != accel)
    if strange >= _STRANGEST and (fused or next_to is None or any(strangeness[run] < _PLAIN for run in others)):
        return {}
    if next_to is None:
        return {ACCEL: accel}
    return {ACCEL: accel, GYRO: _without_thermometer(next_to, gyros, lambda run: _unrest(read[:, run], quiet))}


def _without_thermometer(run: Run, gyros: Sequence[Run], unrest: Callable[[Run], Array]) -> Run:
    """Three gyros, or where the first column is a thermometer between accelerometers and gyros the three behind it: its
    means differ from rest to rest far more than theirs, in parts of what it does in all."""
    behind = (run[1], run[2], run[2] + 1)
    if behind not in gyros:
        return run
    first, *others = unrest(run)
    last = unrest(behind)[2]
    return behind if first > _THERMOMETER * max(*others, last) else run


def _strangeness(columns: Array, quiet: BoolArray) -> int:
    """How unlike those of accelerometers the readings of three columns are whose length is one at rest: in no unit and
    no counts of data sheets, or with a zero far off, as magnetometers with iron about have it."""
    means = _rests(columns, quiet)
    read = columns[np.isfinite(columns)]
    counts = ACCEL_STEPS if (read == np.floor(read)).all() else ()
    ones = (G_STANDARD,), (1.0, 1e3), counts

    def strange(centre: Array | float) -> int:
        lengths = np.linalg.norm(means - centre, axis=1)
        length = float(lengths.mean())
        off = min(float(np.abs(centre - middle).max()) for middle in (0.0, *(MIDDLES if (means > 0.0).all() else ())))
        near = next((k for k, values in enumerate(ones) if _is_near(length, values)), len(ones))
        return near + len(ones) * (off > _OFF * length or lengths.std() > _SAME_LENGTH * length)

    return min(strange(0.0), strange(_centre(means)))  # a sphere is not seen from one side


def _is_near(length: float, ones: Sequence[float]) -> bool:
    return any(abs(length / one - 1.0) < _NEAR for one in ones)


def _at_rest(read: Array, runs: Sequence[Run]) -> dict[str, Run]:
    """What columns are where nothing ever moves: accelerometers read one gravity, gyros, beside them, the least of what
    they scatter by."""
    still = [run for run in runs if _reads_gravity(read[:, run])]
    if not still:
        return {}
    beside = [run for run in runs if not set(run) & set(still[0])]
    return {ACCEL: still[0]} | ({GYRO: min(beside, key=lambda run: _share(read[:, run]))} if beside else {})


def _share(columns: Array) -> float:
    """The mean vector that three columns read, in parts of what they scatter by."""
    scatter = float(np.linalg.norm(np.nanstd(columns, axis=0)))
    return float(np.linalg.norm(np.nanmean(columns, axis=0))) / scatter if scatter > 0.0 else np.inf


def _reads_gravity(columns: Array) -> bool:
    """Whether three columns read gravity in m/s², g or thousandths of it, and always nearly the same."""
    length = float(np.linalg.norm(np.nanmedian(columns, axis=0)))
    steady = float(np.nanstd(columns, axis=0).max()) < _STILL * length
    return steady and any(abs(length / one - 1.0) < _STILL for one in (G_STANDARD, 1.0, 1e3))


def time_by_data(names: Sequence[str], read: Array) -> str | None:
    """The column of a table (m, n) that is a time; None where none grows as one, or only a counter of samples."""
    growing = [j for j in range(len(names)) if grows(read[:, j]) and not _counts(read[:, j])]
    return names[growing[0]] if growing else None


def _time(names: Sequence[str], read: Array) -> str | None:
    """The time among columns that grow: the first that is no counter of samples, else the first."""
    return time_by_data(names, read) or (names[0] if names else None)


def _varies(column: Array) -> bool:
    """Whether the readings of a column are not all the same."""
    return bool(np.ptp(column[np.isfinite(column)]) > 0.0)


def _counts(column: Array) -> bool:
    """Whether a column grows by one from row to row, but for lost rows."""
    steps = np.diff(column[np.isfinite(column)])
    return bool((steps == np.floor(steps)).all() and np.median(steps) == 1.0)


def grows(column: Array) -> bool:
    """Whether a column is a time: it grows at an even pace, and never falls but where a counter starts anew."""
    read = column[np.isfinite(column)]
    steps = np.diff(read)
    anew = steps < -0.5 * np.ptp(read) if len(read) else np.zeros(0, dtype=bool)
    if 0 < np.count_nonzero(anew) <= max(1.0, _ANEW * len(steps)):
        steps[anew] = np.median(steps)
    if len(steps) < 10 or (steps < 0.0).any() or np.mean(steps > 0.0) < 0.02:
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


def _rests(columns: Array, quiet: BoolArray) -> Array:
    """Means of the quiet blocks."""
    means = _means(columns)[0][quiet]
    return np.asarray(means[np.isfinite(means).all(axis=1)])


def _kind(columns: Array, quiet: BoolArray) -> str | None:
    """What three columns side by side are."""
    means = _rests(columns, quiet)
    if not len(means):
        return None
    everything = columns[np.isfinite(columns).all(axis=1)].std(axis=0)
    if np.linalg.norm(means.std(axis=0)) < _STEADY * np.linalg.norm(everything):
        return GYRO if _unrest(columns, quiet).max() < _UNSTEADY else None
    length = np.linalg.norm(means - _centre(means), axis=1)
    return ACCEL if length.std() < _SAME_LENGTH * length.mean() else None


def _unrest(columns: Array, quiet: BoolArray) -> Array:
    """How much the readings at rest differ from one rest to another, (3,), in parts of how much they do in all."""
    everything = columns[np.isfinite(columns).all(axis=1)].std(axis=0)
    return np.asarray(_rests(columns, quiet).std(axis=0) / np.where(everything > 0.0, everything, 1.0))


def _centre(means: Array) -> Array:
    """Centre (3,) of the sphere through points (m, 3)."""
    rows = np.column_stack([2.0 * means, np.ones(len(means))])
    return np.asarray(np.linalg.lstsq(rows, (means**2).sum(axis=1), rcond=None)[0][:3])
