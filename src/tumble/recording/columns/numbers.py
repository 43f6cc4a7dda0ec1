"""Identification of sensors among columns without meaningful names, by their numbers.

Every hypothesis takes three adjacent columns as accelerometers and three as gyros; the one with the least cost over the
whole recording is chosen. The cost is −2 ln of a likelihood, up to a constant common to all hypotheses. At rest
accelerometer vectors have one length about a zero, in a unit or in counts of data sheets, with little scatter; as the
body turns, their means spread over a sphere. Gyros read one vector at every rest, and turn that of the accelerometers:
da = −ω × a. The three sensors of a kind have equal noise. Times, counters and unit vectors of a filter are excluded.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import product
from types import SimpleNamespace

import numpy as np

from tumble.recording.columns.names import ACCEL, GYRO, Columns, Sensors, in_axis_order
from tumble.recording.columns.scales import CANDIDATES, PRIORS, SCALE_TOLERANCE
from tumble.units import Array, BoolArray

_ARRAY_ELEMENT = re.compile(r"(.*)\[\d+\]")
_BLOCK = 25  # rows
_QUIET_SHARE = 0.4  # of the blocks
_FEWEST_ROWS = 200
_RESTART_SHARE = 1e-3  # of the steps of a counter
_RISING_SHARE, _RISING_SHARE_OF_SECONDS = 0.02, 1e-4  # of the steps of a time, and of a time in whole seconds
DATES = 1.1e9, 2.2e9
"""s since 1970: 2004 to 2039."""
_UNIT_VECTOR_SPREAD = 1e-5  # of the length of a vector of constant length
_QUATERNION_SPREAD, _QUATERNION_OFF_UNITY, _QUATERNION_CHANGE = 3e-3, 5e-3, 0.05
"""Rounded quaternions: spread of their length, offset of its mean from 1, and least spread of each element."""

_PRIOR = SimpleNamespace(**PRIORS["columns"])
"""Standard deviations and costs."""
_LEAST_MOVE, _LARGEST_MOVE, _FEWEST_MOVES = 0.05, 0.3, 20
"""Least change of the vector between blocks, of gravity, for a test of gyros, and least number of changes."""
_LEAST_MOTION = 0.01  # of gravity: least scatter of each accelerometer of a body that is never at rest
_LENGTH_IN_MOTION, _SPREAD_IN_MOTION = 0.12, 0.4
"""For a moving body, of gravity: tolerance of the median length of block means, and limit of their spread."""
_ONE_WAY_SHARE = 0.05
"""Half of the steps of a sensor fall; at most 1 of 20 does by chance once in 50,000 cases."""

MIDDLES = tuple(PRIORS["numbers"]["middles"])
"""Zeros of converters without a sign."""

Triple = tuple[int, int, int]
"""Indices of three adjacent columns."""


@dataclass(frozen=True, kw_only=True, slots=True)
class _Hypothesis:
    """Columns of accelerometers and gyros, their cost, and the parts of it that concern the accelerometers and the
    turning of their vector by the gyros."""

    cost: float
    accel_cost: float
    accel: Triple
    gyro: Triple | None
    turning: float = 0.0


def guess_remarks(columns: Columns, named: Collection[str] = ()) -> list[str]:
    """Return a sentence on each kind of sensor that was identified by numbers and is not in `named`."""
    triads = {kind: s for kind, s in columns.triads.items() if kind not in named}
    return [f"{kind}: columns {', '.join(s.columns)}, by their numbers (a guess)" for kind, s in triads.items()]


def columns_by_data(names: Sequence[str], table: Array) -> Columns:
    """Identify the columns of a table (m, n) by their numbers, NaN in columns of text.

    There are no triads if no columns resemble accelerometers."""
    if not len(table):
        return Columns(time=None, time_unit=None, triads={})
    growing = [j for j in range(len(names)) if grows(table[:, j])]
    others = [j for j in range(len(names)) if j not in growing]
    time = time_by_data(names, table) or (names[growing[0]] if growing else None)
    ranked = _ranked_hypotheses(names, table, others)
    if not ranked:
        return Columns(time=time, time_unit=None, triads=_triads_in_motion(names, table, others))
    best, *rivals = ranked
    triads = {
        kind: Sensors(columns=in_axis_order([names[j] for j in triple]), unit=None)
        for kind, triple in ((ACCEL, best.accel), (GYRO, best.gyro))
        if triple is not None
    }
    # the rivals are a log without accelerometers, and the second hypothesis
    margin = min([_PRIOR.limit - best.accel_cost, *(rival.cost - best.cost for rival in rivals[:1])])
    return Columns(
        time=time,
        time_unit=None,
        triads=triads,
        ambiguous=margin < _PRIOR.ambiguous,
        turning=best.turning < _PRIOR.turning,
    )


def _ranked_hypotheses(names: Sequence[str], table: Array, columns: Sequence[int]) -> list[_Hypothesis]:
    """Return all hypotheses in the order of their cost."""
    filled = [j for j in columns if np.isfinite(table[:, j]).mean() > 0.5]
    attitudes = _attitudes(table, filled)
    candidates = []  # columns that rise and fall, unlike clocks, counters and position numbers
    for j in filled:
        steps = np.diff(table[np.isfinite(table[:, j]), j])
        rises, falls = np.count_nonzero(steps > 0.0), np.count_nonzero(steps < 0.0)
        if j not in attitudes and rises + falls > 0 and min(rises, falls) > _ONE_WAY_SHARE * max(rises, falls):
            candidates.append(j)
    triples = [(j, j + 1, j + 2) for j in candidates if j + 1 in candidates and j + 2 in candidates]
    triples = [triple for triple in triples if differ_in_axis_alone([names[j] for j in triple])]
    if not triples or len(table) < _FEWEST_ROWS or not (quiet := _quiet_blocks(table[:, candidates])).any():
        return []
    noise = dict[Triple, float]()
    for triple in triples:  # a constant column has half the least step as noise
        levels = [np.unique(column[np.isfinite(column)]) for column in table[:, triple].T]
        scatter = zip(_rests(table[:, triple], quiet)[1], levels, strict=True)
        sizes = [max(float(s), 0.5 * float(np.diff(level).min())) for s, level in scatter]
        noise[triple] = min(float(np.std(np.log(sizes))) ** 2 / _PRIOR.noise**2, _PRIOR.most)
    # adjacent columns are counted in triples
    first = {j: next(k for k in range(j, -1, -1) if k - 1 not in candidates) for j in candidates}
    off_triple = {triple: _PRIOR.off_triple * ((triple[0] - first[triple[0]]) % 3 != 0) for triple in triples}
    hypotheses: list[_Hypothesis] = []
    for accel in triples:
        # next to results of a filter, accelerometers are in a unit or in counts of data sheets
        cost = _cost_of_accelerometers(table[:, accel], quiet, filtered=bool(attitudes))
        cost += noise[accel] + off_triple[accel]
        hypotheses.append(_Hypothesis(cost=cost, accel_cost=cost, accel=accel, gyro=None))
        for gyro in triples if cost <= _PRIOR.carried + _PRIOR.limit else ():
            if not set(gyro) & set(accel):
                turning = _cost_of_turning(table[:, gyro], table[:, accel], quiet)
                gyro_cost = turning + _cost_of_gyros(table[:, gyro], quiet) + noise[gyro] + off_triple[gyro]
                gyro_cost -= _PRIOR.no_gyros
                gyro_cost += _PRIOR.before * (gyro[0] < accel[0])
                gyro_cost += _PRIOR.between * (abs(gyro[0] - accel[0]) // 3 - 1)
                gyro_cost += _PRIOR.askew * ((gyro[0] - accel[0]) % 3 != 0)
                gyro_cost += _PRIOR.later * (min(gyro[0], accel[0]) >= first[accel[0]] + 3)
                accel_cost = cost + min(turning, 0.0)
                both = _Hypothesis(
                    cost=cost + gyro_cost, accel_cost=accel_cost, accel=accel, gyro=gyro, turning=turning
                )
                hypotheses.append(both)
    return sorted((h for h in hypotheses if h.accel_cost <= _PRIOR.limit), key=lambda h: h.cost)


def _triads_in_motion(names: Sequence[str], table: Array, columns: Sequence[int]) -> dict[str, Sensors]:
    """Return the sensors of a recording without rests, in three or six varying columns.

    Accelerometers are the only triple whose length is mostly that of gravity in some unit."""
    filled = [j for j in columns if np.isfinite(table[:, j]).mean() > 0.5]
    varying = [j for j in filled if np.nanstd(table[:, j]) > 0.0]
    triples = [tuple(varying[k : k + 3]) for k in range(0, len(varying), 3)]
    if len(varying) not in (3, 6) or any(triple[2] - triple[0] != 2 for triple in triples) or len(table) < _FEWEST_ROWS:
        return {}
    if not all(differ_in_axis_alone([names[j] for j in triple]) for triple in triples) or _attitudes(table, varying):
        return {}
    units = [c.value for c in CANDIDATES[ACCEL] if c.unit is not None and not c.increment]
    reads_gravity = []
    for triple in triples:
        rows = table[np.isfinite(table[:, triple]).all(axis=1)][:, triple]
        if len(rows) < _BLOCK:
            return {}
        lengths = np.linalg.norm(_blocks(rows)[0], axis=1)
        length, spread = float(np.median(lengths)), float(lengths.std())
        moves = float(rows.std(axis=0).min()) > _LEAST_MOTION * length
        in_unit = min(abs(np.log(length / unit)) for unit in units) < _LENGTH_IN_MOTION
        reads_gravity.append(moves and in_unit and spread < _SPREAD_IN_MOTION * length)
    if reads_gravity.count(True) != 1:
        return {}
    accel_first = sorted(triples, key=lambda triple: not reads_gravity[triples.index(triple)])
    return {
        kind: Sensors(columns=in_axis_order([names[j] for j in triple]), unit=None)
        for kind, triple in zip((ACCEL, GYRO), accel_first, strict=False)
    }


def _cost_of_accelerometers(columns: Array, quiet: BoolArray, *, filtered: bool) -> float:
    """Return the cost of three columns (m, 3) as accelerometers, without regard to gyros."""
    means, scatter = _rests(columns, quiet)
    numbers = columns[np.isfinite(columns)]
    whole = bool((numbers == np.floor(numbers)).all())
    centres = [(middle * np.ones(3), 0.0) for middle in (0.0, *(MIDDLES if whole and (means > 0.0).all() else ()))]
    spread = float(np.linalg.norm(means.std(axis=0)))
    if len(means) > 3 and spread > 0.0:  # the centre of the sphere through the means
        design = np.column_stack([2.0 * means, np.ones(len(means))])
        centres.append((np.linalg.lstsq(design, (means**2).sum(axis=1), rcond=None)[0][:3], 1.0))
    costs = []
    for centre, is_free in centres:
        lengths = np.linalg.norm(means - centre, axis=1)
        length = float(lengths.mean())
        if not length > 0.0 or not np.isfinite(length):
            continue
        uneven = float(lengths.std()) / length
        scale = min(
            (np.log(length / c.value) / SCALE_TOLERANCE) ** 2
            + (0.0 if c.unit else _PRIOR.counted + _PRIOR.rare * (not c.common))
            for c in CANDIDATES[ACCEL]
            if c.unit or whole
        )
        scale = scale if scale < _PRIOR.most + _PRIOR.counted + _PRIOR.rare else np.inf if filtered else _PRIOR.no_scale
        sphere = 2.0 * np.log(min(1.0, max(uneven, _PRIOR.length / 5.0) * length / max(spread, 1e-300)))
        zero = is_free * float(np.abs(centre).max()) / (_PRIOR.zero * length)
        shaken = float(np.linalg.norm(scatter)) / (_PRIOR.scatter * length)
        costs.append((uneven / _PRIOR.length) ** 2 + scale + sphere + zero**2 + min(shaken**2, _PRIOR.most))
    return float(min(costs, default=np.inf))


def _cost_of_gyros(columns: Array, quiet: BoolArray) -> float:
    """Return the cost of changes of three columns from rest to rest, and of a large mean at rest."""
    means, _ = _rests(columns, quiet)
    spread = float(np.linalg.norm(columns[np.isfinite(columns).all(axis=1)].std(axis=0)))
    change = float(np.linalg.norm(means.std(axis=0))) / max(_PRIOR.gyro_change * spread, 1e-300)
    bias = float(np.linalg.norm(np.median(means, axis=0))) / max(spread, 1e-300)
    return float(min(change**2, _PRIOR.most) + _PRIOR.bias * np.log1p(bias))


def _cost_of_turning(rates: Array, accel: Array, quiet: BoolArray) -> float:
    """Return the cost of three columns as gyros that turn the vector of the accelerometers (m, 3).

    It follows from the share of the changes of the vector that da = −(M ω) × a explains, with any scales and axes M; it
    is negative for more than half, and 0 without enough changes."""
    rates = rates - np.median(_rests(rates, quiet)[0], axis=0)
    complete = np.isfinite(rates).all(axis=1) & np.isfinite(accel).all(axis=1)
    rates, accel = rates[complete], accel[complete]
    if not len(accel):
        return 0.0
    length = float(np.median(np.linalg.norm(accel, axis=1))) or 1.0
    width = 1
    while (blocks := len(accel) // width) >= 4 * _FEWEST_MOVES:
        a = accel[: blocks * width].reshape(blocks, width, 3).mean(axis=1) / length
        change = np.diff(a, axis=0)
        size = np.linalg.norm(change, axis=1)
        rank = max(_FEWEST_MOVES, blocks // 200)
        if np.partition(size, -rank)[-rank] >= 2.0 * _LEAST_MOVE:
            break
        width *= 2
    else:
        return 0.0
    moves = (size > max(_LEAST_MOVE, 5.0 * float(np.median(size)))) & (size < _LARGEST_MOVE)
    if np.count_nonzero(moves) < _FEWEST_MOVES:
        return 0.0
    w = rates[: blocks * width].reshape(blocks, width, 3).mean(axis=1)
    middle, rate = 0.5 * (a[1:] + a[:-1])[moves], 0.5 * (w[1:] + w[:-1])[moves]
    axes = np.eye(3)
    rows = np.stack([np.cross(middle, axes[i]) * rate[:, [j]] for i in range(3) for j in range(3)], axis=2)
    wanted = change[moves].reshape(-1)
    matrix = rows.reshape(len(wanted), 9)
    matrix = matrix / np.maximum(np.linalg.norm(matrix, axis=0), 1e-300)
    residual = wanted - matrix @ np.linalg.lstsq(matrix, wanted, rcond=None)[0]
    return float(_PRIOR.carried * (residual @ residual / (wanted @ wanted) - 0.5))


def differ_in_axis_alone(names: Sequence[str]) -> bool:
    """Return whether three names differ in one word or letter, like those of axes and unlike TRSS, TQly and TSNR."""
    arrays = {match[1] if (match := _ARRAY_ELEMENT.fullmatch(name)) else "" for name in names}  # `imu/fb`
    if len(arrays) > 1:
        return False
    parts = [re.findall(r"[^\W\d_]+|\d+", name.lower()) for name in names]
    if len(set(map(len, parts))) != 1:
        return False
    different = [words for words in zip(*parts, strict=True) if len(set(words)) > 1]
    if len(different) != 1 or all(word.isdecimal() for word in different[0]):
        return len(different) <= 1
    same_length = len(set(map(len, different[0]))) == 1
    return same_length and sum(len(set(letters)) > 1 for letters in zip(*different[0], strict=True)) == 1


def _attitudes(table: Array, columns: Sequence[int]) -> set[int]:
    """Return columns of quaternions and of unit or gravity vectors of a filter: their length never changes."""
    attitudes: set[int] = set()
    for width, first in product((4, 3), columns):
        run = [first + k for k in range(width)]
        rows = table[:0]
        if set(run) <= set(columns) - attitudes:
            rows = table[np.isfinite(table[:, run]).all(axis=1)][:, run]
        if len(rows):
            length, spread = np.linalg.norm(rows, axis=1), rows.std(axis=0)
            near_unity = abs(length.mean() - 1.0) < _QUATERNION_OFF_UNITY
            is_quaternion = width == 4 and near_unity and spread.min() > _QUATERNION_CHANGE
            tolerance = _QUATERNION_SPREAD if is_quaternion else _UNIT_VECTOR_SPREAD
            if length.std() < min(tolerance * length.mean(), 0.1 * spread.max()):
                attitudes |= set(run)
    return attitudes


def time_by_data(names: Sequence[str], table: Array) -> str | None:
    """Return the first column of a table (m, n) that grows like a time and is no counter of samples; None without."""
    for name, column in zip(names, table.T, strict=True):
        if grows(column):
            steps = np.diff(column[np.isfinite(column)])
            if np.median(steps) != 1.0 or (steps != np.floor(steps)).any():
                return name
    return None


def grows(column: Array) -> bool:
    """Return whether a column grows at an even pace, and falls only where a counter restarts."""
    numbers = column[np.isfinite(column)]
    steps = np.diff(numbers)
    restarts = steps < -0.5 * np.ptp(numbers) if len(numbers) else np.zeros(0, dtype=bool)
    if 0 < np.count_nonzero(restarts) <= max(1.0, _RESTART_SHARE * len(steps)):
        steps[restarts] = np.median(steps)
    is_date = len(numbers) > 0 and DATES[0] < numbers[0] < DATES[1]
    least_rising = _RISING_SHARE_OF_SECONDS if is_date else _RISING_SHARE
    if len(steps) < 10 or (steps < 0.0).any() or np.mean(steps > 0.0) < least_rising:
        return False
    r = np.corrcoef(np.arange(len(steps) + 1), np.concatenate([[0.0], np.cumsum(steps)]))[0, 1]
    return bool(r > 0.95)


def _blocks(columns: Array) -> tuple[Array, Array]:
    """Return means and standard deviations of blocks of rows."""
    blocks = columns[: len(columns) // _BLOCK * _BLOCK].reshape(-1, _BLOCK, columns.shape[1])
    with np.errstate(invalid="ignore"):
        return blocks.mean(axis=1), blocks.std(axis=1)


def _quiet_blocks(columns: Array) -> BoolArray:
    """Return which blocks of rows have the least scatter in all columns."""
    _, scatter = _blocks(columns)
    complete = np.asarray(np.isfinite(scatter).all(axis=1))
    if not complete.any():
        return complete
    typical = np.median(scatter[complete], axis=0)
    largest = np.max(scatter / np.where(typical > 0.0, typical, 1.0), axis=1)
    return np.asarray(complete & (largest <= np.quantile(largest[complete], _QUIET_SHARE)))


def _rests(columns: Array, quiet: BoolArray) -> tuple[Array, Array]:
    """Return means of the quiet blocks, and the median scatter (3,) in them."""
    means, scatter = _blocks(columns)
    used = quiet & np.isfinite(means).all(axis=1)
    return means[used], np.median(scatter[used], axis=0)
