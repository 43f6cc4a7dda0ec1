"""Tables of readings, such as averaged voltages with one row per position.

READINGS.csv has a header with the names of three columns, one per accelerometer, and a row of three numbers per
position; in a wider table, such as a log, the three columns named as accelerometers are used. The nominal scale
converts readings to SI; its sign is the polarity of the channel.

The ellipsoid does not determine polarity: y and −y of a channel fit it equally well. Polarity comes from the nominal
scale, or from positions in which the direction of up is roughly known.

A position is a block of N rows, N = 1 unless stated. Its reading is the mean; the covariance of a mean comes from the
scatter within all blocks, taken to be the same in each. Blocks that are equal to the last digit are copies of one
reading and count once. The standard uncertainty of a reading, and of a mean of several, is at least the step of its
last digit over √12 (JCGM 100:2008, F.2.2.1).
"""

from __future__ import annotations

import csv
import hashlib
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np

from tumble.advice import Advised, advised
from tumble.diagnosis.observability import rough_directions
from tumble.documents import check_regular
from tumble.earth import NORMAL_GRAVITY_U
from tumble.errors import InputError
from tumble.recording.columns.names import columns_by_name
from tumble.recording.formats import is_recording
from tumble.recording.session import Channels, Site
from tumble.reduction.observations import Observations
from tumble.reduction.rests.rests import Rests
from tumble.sensors.model import Block
from tumble.units import ACCEL_UNITS, G_STANDARD, Array, IntArray, fitting_units
from tumble.usual_setup import MOVE, ON_TABLE

POLARITY_COMPONENT = 0.3  # least component of up along a channel for a position that determines its polarity
EARTH_GRAVITY = (9.7, 9.9)  # m/s², range on Earth
LARGEST_GRAVITY_U = 0.1  # m/s², more than gravity varies on Earth
LARGEST = 1e30  # of a reading; powers of larger numbers overflow
COPIES_SHOWN = 3
_FEWEST_SAMPLES = 50  # rows of a log
RAW = ("V", "count")
UNITS = {name: ACCEL_UNITS[name].factor for name in ("g", "m/s^2")}
"""Units of a reading, and of the input in a scale, with their sizes in m/s²."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ReadingsTable:
    """A table of readings (N, 3) as written, with their `lines` in the file and the `steps` (3,) of the last digits.

    If positions have several `rows`, values are their means and lines those of the first rows; `covariance` (3, 3) is
    that of a mean from the scatter within positions, with its `degrees` of freedom. `left_out` are notes on copies."""

    path: Path
    columns: tuple[str, ...]
    values: Array
    lines: tuple[int, ...]
    sha256: str
    steps: Array
    rows: int = 1
    covariance: Array | None = None
    degrees: int = 0
    left_out: tuple[str, ...] = ()

    @property
    def resolution_u(self) -> Array:
        """Standard uncertainty (3,) of a reading by its last digit, in the unit of the table."""
        return np.asarray(self.steps / np.sqrt(12.0))

    @property
    def row_u(self) -> Array:
        """Standard uncertainty (3,) of a single row, by its last digit and the scatter within positions."""
        within = 0.0 if self.covariance is None else self.rows * np.diag(self.covariance)
        return np.sqrt(self.resolution_u**2 + within)


def table_of(readings: Array) -> ReadingsTable:
    """Return the table of readings (N, 3), each known to its last digit. Raises InputError for another shape."""
    if readings.ndim != 2 or readings.shape[1] != 3:
        raise InputError(f"--readings: expected an array (N, 3), a row per position, found the shape {readings.shape}")
    rows = [",".join(map(repr, row)) for row in readings.tolist()]
    return _parsed(Path("readings"), "\n".join(["x,y,z", *rows]))


def is_table(path: Path) -> bool:
    """Return whether a file is a table of readings, one row per position, and no log.

    A table of many rows has three columns, or names of accelerometers, and no column of times or of gyros."""
    if not path.is_file() or is_recording(path):
        return False
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        names = [cell.strip() for cell in file.readline().split(",")]
        rows = sum(1 for _ in islice(file, _FEWEST_SAMPLES))
    named = columns_by_name(names)
    accelerometers = len(names) == 3 or "accel" in named.triads
    return rows < _FEWEST_SAMPLES or (accelerometers and named.time is None and "gyro" not in named.triads)


def read_table(path: Path) -> ReadingsTable:
    """Read a table of readings from a CSV file.

    Raises InputError, which names the file, the line and the column, for anything but a header of names and rows of
    finite numbers in three columns."""
    try:
        check_regular(path)
        content = path.read_bytes()
        table = _parsed(path, content.decode("utf-8-sig"))
        return replace(table, sha256=hashlib.sha256(content).hexdigest())
    except OSError as error:
        raise InputError(f"{path}: expected a table of readings, found: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: expected UTF-8 text, found {error.reason}; save the table as CSV in UTF-8"
        ) from error


def _parsed(path: Path, text: str) -> ReadingsTable:
    reader = csv.reader(text.splitlines(), strict=True)
    try:
        rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: expected comma-separated numbers, found: {error}") from error
    if not rows:
        raise InputError(f"{path}: expected a header of three columns and a row per position, found an empty file")
    columns, width = tuple(cell.strip() for cell in rows[0][1]), len(rows[0][1])
    if width > 3 and (named := columns_by_name(columns).triads.get("accel")) is not None:
        places = [columns.index(name) for name in named.columns]
        rows = [(line, [row[i] for i in places] if len(row) == width else row) for line, row in rows]
        columns = tuple(named.columns)
    if fault := _header_fault(columns):
        raise InputError(f"{path}: line {rows[0][0]}: expected {fault}")
    if len(rows) == 1:
        raise InputError(f"{path}: expected a row per position below the header, found none")
    for line, row in rows[1:]:
        if len(row) != len(columns):
            raise InputError(f"{path}: line {line}: expected three numbers, one per column, found {len(row)} values")
        for column, cell in zip(columns, row, strict=True):
            if not abs(_number(cell)) < LARGEST:
                value = repr(cell.strip()[:40]) if cell.strip() else "an empty value"
                place = f"{path}: line {line}, column {column!r}"
                raise InputError(f"{place}: expected a number, found {value}; correct the row")
    numbers = [[cell.strip().lower().partition("e") for cell in row] for _, row in rows[1:]]
    # power of ten of the last digit of each: −3 for 1.250, 2 for 1.25e4
    last_digits = [[int(power or 0) - len(digits.partition(".")[2]) for digits, _, power in row] for row in numbers]
    return ReadingsTable(
        path=path,
        columns=columns,
        values=np.array([[float(cell) for cell in row] for _, row in rows[1:]]),
        lines=tuple(line for line, _ in rows[1:]),
        sha256=hashlib.sha256(text.encode()).hexdigest(),
        steps=10.0 ** np.minimum(0, np.min(last_digits, axis=0)),  # 1 for whole numbers
    )


def _header_fault(names: tuple[str, ...]) -> str:
    """Return what was expected of the header and what was found; empty if it is right."""
    if len(names) == 1 and any(mark in names[0] for mark in ";\t"):
        return f"commas between the columns, found {names[0][:40]!r}; save as CSV with commas"
    if len(names) != 3:
        return (
            f"a header of three columns, one per channel, found {len(names)}, none three of them named as the sensors "
            "are (ax, ay, az); a log with rests and turns is for `tumble calibrate`"
        )
    if not any(math.isnan(_number(name)) for name in names):
        return "a header with the names of three columns, found numbers; put one above"
    if "" in names:
        return f"names of three columns, found an empty one in column {names.index('') + 1}"
    name, count = Counter(names).most_common(1)[0]
    return f"three different columns, found {name!r} {count} times" if count > 1 else ""


def _number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan


def positions_of(table: ReadingsTable, rows_per_position: int = 1) -> ReadingsTable:
    """Return the table with one row per position, the mean of `rows_per_position` rows.

    Raises InputError if the number of rows is no multiple of it."""
    N, rows = len(table.values), rows_per_position
    if rows < 1 or N % rows:
        raise InputError(
            f"--rows-per-position: expected a number that goes into the {N} rows of {table.path}, found {rows}"
        )
    blocks, lines = table.values.reshape(-1, rows, 3) + 0.0, table.lines[::rows]
    first = dict[bytes, int]()
    original = [first.setdefault(block.tobytes(), i) for i, block in enumerate(blocks)]
    distinct, copies, left_out = list(first.values()), [i for i, j in enumerate(original) if i != j], tuple[str, ...]()
    if copies:
        named = [f"line {lines[i]} as line {lines[original[i]]}" for i in copies[:COPIES_SHOWN]]
        named += [f"{len(copies) - COPIES_SHOWN} more"] if len(copies) > COPIES_SHOWN else []
        left_out = (
            f"{'rows' if rows == 1 else f'blocks of {rows} rows'} that repeat others to the last digit: {len(copies)} "
            f"({', '.join(named)}); a copy is no further reading, and each counts once",
        )
    means, covariance, degrees = blocks[distinct].mean(axis=1), None, len(distinct) * (rows - 1)
    if rows > 1:
        residuals = (blocks[distinct] - means[:, None]).reshape(-1, 3)
        covariance = np.asarray(residuals.T @ residuals / degrees / rows)
    return replace(
        table,
        values=means,
        lines=tuple(lines[i] for i in distinct),
        covariance=covariance,
        rows=rows,
        degrees=degrees,
        left_out=left_out,
    )


def table_rests(readings: Array, covariance: Array, block: Block, site: Site) -> Observations:
    """Return mean readings (N, 3), m/s², with the covariance (3, 3) of each, as rests at the pace of an operator's
    sheet."""
    N = len(readings)
    empty, start = np.zeros((N, 0)), np.asarray(np.arange(N) * (ON_TABLE.rest + MOVE))
    rests = Rests.of_white_noise(start, start + ON_TABLE.rest, accel=readings, gyro=empty, densities=(0.0, 0.0))
    covariances = np.broadcast_to(covariance, (N, 3, 3))
    rests = replace(rests, accel_covariance=covariances, accel_drift=empty, accel_noise=empty)
    return Observations(accel_block=block, gyro_block=None, site=site, rests=rests)


# -------------------- unit, scale and gravity --------------------


def site_of(gravity: float | None, gravity_u: float | None) -> tuple[Site, str]:
    """Return the site of a stated gravity, m/s², or that of gravity as the unit, with a note on it.

    Raises InputError for a gravity that no place on Earth has."""
    if gravity is None and gravity_u is not None:
        raise InputError("--gravity-u: expected --gravity with it, found it alone")
    if gravity is not None and not EARTH_GRAVITY[0] <= gravity <= EARTH_GRAVITY[1]:
        raise InputError(f"--gravity: expected a number from 9.7 to 9.9 (m/s^2, on Earth), found {gravity:g}")
    if gravity_u is not None and not 0.0 <= gravity_u <= LARGEST_GRAVITY_U:
        raise InputError(f"--gravity-u: expected a number from 0 to {LARGEST_GRAVITY_U:g} (m/s^2), found {gravity_u:g}")
    if gravity is None:
        found = (
            "gravity is not stated: the unit is g at the place of the readings, printed as 9.80665 m/s^2; u does not "
            "include the difference, up to 0.3 %"
        )
        site = Site(latitude=None, height=None, gravity=G_STANDARD, gravity_u=0.0, gravity_is_unit=True)
        return site, Advised(found, "for values in m/s^2 give --gravity and --gravity-u")
    u = NORMAL_GRAVITY_U if gravity_u is None else gravity_u
    note = f"gravity {gravity:.9g} m/s^2 with u = {u:.2g} m/s^2, in all scale factors"
    site = Site(latitude=None, height=None, gravity=gravity, gravity_u=u)
    return site, note if u else "gravity is taken as exact, as stated"


def channels_of(
    table: ReadingsTable,
    gravity: float,
    *,
    unit: str,
    scale: Sequence[float] | None,
    scale_per: str | None,
    directions: Mapping[int, Array],
) -> tuple[Channels, list[str]]:
    """Return the columns of a table with unit and nominal scale by the arguments of `calibrate_readings`, and notes on
    the scale and polarity that are not stated.

    Raises InputError if these contradict each other or the table."""
    if unit not in (*RAW, *UNITS):
        raise InputError(f"--unit: expected one of {', '.join((*RAW, *UNITS))}, found {unit!r}")
    if unit not in RAW and (scale is not None or scale_per is not None):
        raise InputError(f"--scale: expected only with --unit V or count, found --unit {unit}")
    per = unit if unit not in RAW else scale_per or "g"
    if per not in UNITS:
        raise InputError(f"--scale-per: expected one of {', '.join(UNITS)}, found {per!r}")

    # output per unit: 1, as stated, or from the readings to three digits
    sizes, stated = np.ones(3), unit not in RAW or scale is not None
    if not stated:
        outputs = fitted_outputs(table.values, gravity / UNITS[per])
        outputs = 0.5 * np.ptp(table.values, axis=0) / (gravity / UNITS[per]) if outputs is None else outputs
        sizes = np.array([float(f"{s:.3g}") if s > 0.0 else 1.0 for s in outputs])
    elif scale is not None:
        if len(scale) not in (1, 3):
            raise InputError(f"--scale: expected one number or three, one per column, found {len(scale)}")
        sizes = np.broadcast_to(np.asarray(scale, dtype=float), 3)
        if not np.all((np.abs(sizes) > 1.0 / LARGEST) & (np.abs(sizes) < LARGEST)):
            raise InputError(f"--scale: expected numbers other than zero, found {', '.join(f'{s:g}' for s in sizes)}")
    signs, shown_by = _polarity(table, sizes, directions, free=not stated)
    channels = Channels(
        columns=table.columns,
        unit=ACCEL_UNITS[per],
        unit_name=unit,
        scale=sizes * signs,
        offset=np.zeros(3),
        axes=np.eye(3),
        scale_stated=stated,
    )
    notes = list[str]()
    if not stated:
        numbers, fitting = ", ".join(f"{s:.6g}" for s in channels.scale), fitting_units(sizes / UNITS[per], UNITS)
        also = f"{' or '.join(f'--unit {unit}' for unit in fitting)} would fit" if fitting else ""
        notes.append(advised(f"no nominal scale was stated: {numbers} {unit}/{per} was taken from the readings", also))
        if assumed := [name for name, position in zip(table.columns, shown_by, strict=True) if not position]:
            sentence = f"polarity of {', '.join(assumed)}: taken as positive, since the readings do not show it"
            notes.append(Advised(sentence, "state it with --scale or --position"))
    if negative := [name for name, s in zip(table.columns, channels.scale, strict=True) if s < 0.0]:
        mirrored = (
            "; as they are written, the readings are the mirror image of a right-handed triad, so the fit needs a "
            "reflection"
        )
        odd = mirrored if len(negative) % 2 else ""
        notes.append(f"polarity of {', '.join(negative)}: negative, as the scale or the positions state{odd}")
    return channels, notes


def unit_of_scale(channels: Channels) -> str:
    """Return the name of the unit of the input in the nominal scale of a table."""
    return next(name for name, size in UNITS.items() if size == channels.unit.factor)


def fitted_outputs(values: Array, length: float) -> Array | None:
    """Return the outputs (3,) of the channels per unit of a vector of this length, by the ellipsoid through readings
    (N, 3); None if they lie on none."""
    from tumble.methods.quadric import fit_many

    fit = fit_many(values[None])
    return np.linalg.norm(fit.models(length).matrix[0], axis=1) if fit.found[0] else None


def _polarity(
    table: ReadingsTable, sizes: Array, directions: Mapping[int, Array], *, free: bool
) -> tuple[Array, IntArray]:
    """Return the signs (3,) of the channels from rough directions of up, and the position that determines each, 0 for
    none. Unless `free`, they must be those of the scale."""
    read = rough_directions(table.values / sizes)
    signs, shown_by = np.ones(3), np.zeros(3, dtype=int)
    for position, direction in directions.items():
        if not 1 <= position <= len(read):
            raise InputError(f"--position: expected a position from 1 to {len(read)} of the table, found {position}")
        stated = direction / np.abs(direction).max()
        stated = stated / np.linalg.norm(stated)
        is_along = np.minimum(np.abs(stated), np.abs(read[position - 1])) > POLARITY_COMPONENT
        for p in np.flatnonzero(is_along):
            sign, column = np.sign(stated[p] * read[position - 1, p]), table.columns[p]
            if shown_by[p] and sign != signs[p]:
                raise InputError(
                    f"--position: positions {shown_by[p]} and {position} contradict each other about the polarity of "
                    f"{column!r}; correct one of them"
                )
            if not free and sign < 0.0:
                raise InputError(
                    f"--position: position {position} shows {column!r} with the other polarity than its scale; change "
                    "the sign of its scale, or correct the position"
                )
            signs[p], shown_by[p] = sign, position
    return signs, shown_by
