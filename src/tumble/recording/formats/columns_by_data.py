"""What columns without telling names are, by their numbers.

Where the body rests, accelerometers read a vector of one length in many directions, and gyros one and the same small
vector. So of three columns side by side the means over quiet stretches spread as far as the readings themselves for
accelerometers, and hardly at all for gyros. Of a body that never moves the accelerometers are those that read one
gravity. A time grows from row to row.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tumble.recording.formats.columns import ACCEL, GYRO, Columns
from tumble.recording.formats.message import Sensors
from tumble.units import G_STANDARD, Array, BoolArray

_BLOCK = 25
_QUIET_SHARE = 0.4
_SAME_LENGTH = 0.15
_STEADY = 0.25
_FEWEST_ROWS = 200
_ANEW = 1e-3
_STILL = 0.05


def columns_by_data(names: Sequence[str], read: Array) -> Columns:
    """What the columns (m, n) of a table with these names are; no triads where nothing looks like accelerometers."""
    growing = [j for j in range(len(names)) if grows(read[:, j])]
    numbers = [
        j
        for j in range(len(names))
        if j not in growing and np.isfinite(read[:, j]).mean() > 0.5 and _varies(read[:, j])
    ]
    runs = [(j, j + 1, j + 2) for j in numbers if j + 1 in numbers and j + 2 in numbers]
    triads: dict[str, Sensors] = {}
    if runs and len(read) >= _FEWEST_ROWS:
        quiet = _quiet(read[:, numbers])
        used: set[int] = set()
        for run in runs:
            kind = None if used & set(run) else _kind(read[:, run], quiet)
            if kind is not None and kind not in triads:
                x, y, z = (names[j] for j in run)
                triads[kind] = Sensors(columns=(x, y, z), unit=None)
                used |= set(run)
        triads = triads if ACCEL in triads else _at_rest(names, read, runs)
    return Columns(
        time=_time([names[j] for j in growing], read[:, growing]),
        time_unit=None,
        triads=triads,
        temperatures=(),
        others=(),
    )


def _at_rest(names: Sequence[str], read: Array, runs: Sequence[tuple[int, int, int]]) -> dict[str, Sensors]:
    """What columns are where nothing ever moves: accelerometers read one gravity, gyros are beside them."""
    still = [run for run in runs if _reads_gravity(read[:, run])]
    if not still:
        return {}
    beside = [run for run in runs if not set(run) & set(still[0])]
    found = {ACCEL: still[0]} | ({GYRO: beside[0]} if beside else {})
    return {kind: Sensors(columns=(names[x], names[y], names[z]), unit=None) for kind, (x, y, z) in found.items()}


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


def _kind(columns: Array, quiet: BoolArray) -> str | None:
    """What three columns side by side are."""
    means = _means(columns)[0][quiet]
    means = means[np.isfinite(means).all(axis=1)]
    if not len(means):
        return None
    everything = columns[np.isfinite(columns).all(axis=1)]
    spread = np.linalg.norm(means.std(axis=0))
    if spread < _STEADY * np.linalg.norm(everything.std(axis=0)):
        return GYRO
    length = np.linalg.norm(means - _centre(means), axis=1)
    return ACCEL if length.std() < _SAME_LENGTH * length.mean() else None


def _centre(means: Array) -> Array:
    """Centre (3,) of the sphere through points (m, 3)."""
    rows = np.column_stack([2.0 * means, np.ones(len(means))])
    return np.asarray(np.linalg.lstsq(rows, (means**2).sum(axis=1), rcond=None)[0][:3])
