"""Tables of readings: laboratories write down averaged voltages, one row per position.

READINGS.csv has a header with the names of three columns, one per channel, and a row of three numbers per position; of
a wider one, such as a log, the three are taken that are named as the sensors are. The readings become SI by the nominal
scale, whose sign is the polarity of the channel, and the triad is calibrated by the ellipsoid method. Accelerometers at
rest, magnetometers, and gyros on a table that turns at a constant rate are the same problem with another modulus.

The ellipsoid does not show polarity: y and −y of a channel lie equally well on it. It comes from the nominal scale, or
from positions of which it is roughly known where the vector pointed. Where an odd number of channels is negative, the
readings as written are the mirror image of a right-handed triad, and the fit needs a reflection, which is said.

Positions are blocks of rows, each block once.

A block is N rows of one position, N = 1 unless stated. Its reading is the mean; the covariance of a mean comes from the
scatter within all blocks, which is taken to be the same in each. Blocks that are equal to the last digit are copies of
one reading, not several, and count once.

A table of more rows than anyone puts a device into positions is a recording of one that is waved about, as compass
calibrations are made. Its rows err alike in neighbours, so that it is judged by BLOCKS stretches of it, not by rows.

No reading is known better than the last digit it is written with: its standard uncertainty is at least the step of that
digit over √12, and a mean of several has the same.

Source: JCGM 100:2008 (GUM), F.2.2.1.
"""

from __future__ import annotations

import csv
import hashlib
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypedDict, Unpack

import numpy as np

from tumble.documents import check_regular
from tumble.earth import NORMAL_GRAVITY_U
from tumble.errors import InputError
from tumble.recording.columns.names import columns_by_name
from tumble.units import ACCEL_UNITS, G_STANDARD, GYRO_UNITS, MAGNETIC_UNITS, Array, IntArray

Sensor = Literal["accel", "gyro", "mag"]


TELLING = 0.3
"""A channel's polarity is told by a position in which the vector has at least this part along it, in the fit and as
stated."""

EARTH_GRAVITY = (9.7, 9.9)
"""m/s², between which gravity is on Earth."""

LARGEST_GRAVITY_U = 0.1
"""m/s², of the standard uncertainty of gravity; it is less all over the Earth."""

LARGEST_U = 0.5
"""Of the standard uncertainty of another modulus, in parts of it."""

THE_FIELD = "field"
"""The unit of a magnetometer's result where nothing says what its raw readings are per: the field is 1."""

LARGEST = 1e30
"""No reading is as large: its powers would leave the range of numbers."""

_RAW = ("V", "count")
UNITS: Mapping[Sensor, Mapping[str, float]] = {
    "accel": {name: ACCEL_UNITS[name].factor for name in ("g", "m/s^2")},
    "gyro": {name: GYRO_UNITS[name].factor for name in ("deg/s", "deg/h", "rad/s")},
    "mag": dict.fromkeys(MAGNETIC_UNITS, 1.0),
}
"""Units of a reading, the first being the one a scale is per unless stated, and their factors to the unit of the
calibration: m/s², rad/s, or for magnetometers themselves."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ReadingsTable:
    """A table of readings: `values` (N, 3) as written, `lines` (N,) of the file they stand in, and of each column the
    step (3,) of the last digit that is written in it.

    Of positions that are blocks of so many `rows`, values are the means and lines those of the first row of each; the
    `covariance` (3, 3) of a reading is from the scatter within blocks, None where a block is one row, with its
    `degrees` of freedom; what was `left_out`, in words. Of a recording `stretch` (N,) is the number of the stretch that
    each row is in, None where rows are positions."""

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
    stretch: IntArray | None = None

    @property
    def resolution_u(self) -> Array:
        """Standard uncertainty (3,) of a reading from the last digit it is written with, in the unit of the table."""
        return np.asarray(self.steps / np.sqrt(12.0))

    @property
    def row_u(self) -> Array:
        """Standard uncertainty (3,) of a single row, from its last digit and the scatter within blocks, as above."""
        within = 0.0 if self.covariance is None else self.rows * np.diag(self.covariance)
        return np.sqrt(self.resolution_u**2 + within)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Nominal:
    """What the readings of a triad of `sensor` are worth: SI = value / scale, scale (3,) in the table's `unit` per SI
    unit (of magnetometers per `result_unit`), signed by polarity; and the length of the true vector, SI.

    `modulus_u` is the standard uncertainty of that length, None where the length is the unit of the result and none is
    stated. `per` is the unit a raw scale is per, of the size `per_factor` in SI; `estimated` says that the sizes of the
    scale were taken from the readings themselves; `assumed` are the columns whose polarity nothing states."""

    sensor: Sensor
    unit: str
    per: str
    per_factor: float
    scale: Array
    modulus: float
    modulus_u: float | None
    estimated: bool
    assumed: tuple[str, ...]

    @property
    def result_unit(self) -> str:
        """The unit of biases and corrected readings."""
        return {"accel": "m/s^2", "gyro": "rad/s", "mag": self.per}[self.sensor]

    def to_si(self, values: Array) -> Array:
        """Readings (N, 3) in the unit of the result."""
        return values / self.scale


# -------------------- reading the file --------------------


def table_of(readings: Array) -> ReadingsTable:
    """The table of readings (N, 3), each known to its last digit. Raises InputError for another shape."""
    if readings.ndim != 2 or readings.shape[1] != 3:
        raise InputError(f"--readings: expected an array (N, 3), a row per position, found the shape {readings.shape}")
    rows = [",".join(map(repr, row)) for row in readings.tolist()]
    return _parsed(Path("readings"), "\n".join(["x,y,z", *rows]), "accel")


def read_table(path: Path, sensor: Sensor = "accel") -> ReadingsTable:
    """The readings of a CSV file; of a wider one the columns that are named as those of a kind of sensors. Raises
    InputError, one line that names the file, the line and the column, for anything but a header of names and rows of
    finite numbers in three columns."""
    try:
        check_regular(path)
        content = path.read_bytes()
        table = _parsed(path, content.decode("utf-8-sig"), sensor)
        return replace(table, sha256=hashlib.sha256(content).hexdigest())
    except OSError as error:
        raise InputError(f"{path}: expected a table of readings, found: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path}: expected UTF-8 text, found {error.reason}; save the table as CSV in UTF-8"
        ) from error


def _parsed(path: Path, text: str, sensor: Sensor) -> ReadingsTable:
    """The table of a text."""
    reader = csv.reader(text.splitlines(), strict=True)
    try:
        rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise InputError(f"{path}: line {reader.line_num}: expected comma-separated numbers, found: {error}") from error
    if not rows:
        raise InputError(f"{path}: expected a header of three columns and a row per position, found an empty file")
    columns, width = tuple(cell.strip() for cell in rows[0][1]), len(rows[0][1])
    if width > 3 and (named := columns_by_name(columns).triads.get(sensor)) is not None:
        places = [columns.index(name) for name in named.columns]
        rows = [(line, [row[i] for i in places] if len(row) == width else row) for line, row in rows]
        columns = tuple(named.columns)
    if fault := _fault_of_header(columns):
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
    # the power of ten of the last digit of each: −3 of 1.250, 2 of 1.25e4
    last = [[int(power or 0) - len(digits.partition(".")[2]) for digits, _, power in row] for row in numbers]
    return ReadingsTable(
        path=path,
        columns=columns,
        values=np.array([[float(cell) for cell in row] for _, row in rows[1:]]),
        lines=tuple(line for line, _ in rows[1:]),
        sha256=hashlib.sha256(text.encode()).hexdigest(),
        steps=10.0 ** np.minimum(0, np.min(last, axis=0)),  # of whole numbers 1
    )


def _fault_of_header(names: tuple[str, ...]) -> str:
    """What was expected of the names of three columns, and what was found; empty where they are such."""
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


# -------------------- what the readings are worth --------------------


class ReadingsDescription(TypedDict, total=False):
    """What the readings of a table are.

    Attributes
    ----------
    sensor : {"accel", "gyro", "mag"}
        Kind of the sensors; default "accel".
    unit : str
        "V" (default) or "count", or a unit of what the sensors measure, such as "g" or "deg/s".
    scale : sequence of float
        Nominal output per unit, one number or three, signed by polarity; only for V and count, and by default from the
        readings themselves.
    scale_per : str
        Unit that the scale is per.
    gravity, gravity_u : float
        Gravity and its standard uncertainty, m/s², for accelerometers; by default gravity at the place is the unit and
        counts as 9.80665 m/s².
    modulus, modulus_u : float
        Rate of the table for gyros, or the field for magnetometers, with its standard uncertainty, in `unit` or
        `scale_per`; for raw readings of magnetometers without `scale_per` the field is the unit.
    directions : mapping of int to ndarray, shape (3,)
        Rough direction of the vector in positions by their numbers from 1, which gives the polarity of the columns.
    """

    sensor: Sensor
    unit: str
    scale: Sequence[float] | None
    scale_per: str | None
    gravity: float | None
    gravity_u: float | None
    modulus: float | None
    modulus_u: float | None
    directions: Mapping[int, Array]


def nominal_of(table: ReadingsTable, **described: Unpack[ReadingsDescription]) -> Nominal:
    """Nominal scale and true modulus of the readings of a table. Raises InputError if the description of the readings
    contradicts itself or the table."""
    sensor, unit = described.get("sensor", "accel"), described.get("unit", "V")
    scale, scale_per = described.get("scale"), described.get("scale_per")
    gravity, gravity_u = described.get("gravity"), described.get("gravity_u")
    modulus, modulus_u = described.get("modulus"), described.get("modulus_u")
    units = UNITS[sensor]
    if unit not in (*_RAW, *units):
        raise InputError(f"--unit: expected one of {', '.join((*_RAW, *units))} for --sensor {sensor}, found {unit!r}")
    if unit not in _RAW and (scale is not None or scale_per is not None):
        raise InputError(f"--scale: expected only with --unit V or count, found --unit {unit}")
    if sensor == "mag" and unit in _RAW and scale_per is None:
        if modulus not in (None, 1.0):
            raise InputError(f"--scale-per: expected the unit of --modulus, one of {', '.join(units)}, found none")
        units, modulus = {THE_FIELD: 1.0}, 1.0
    per = unit if unit not in _RAW else (scale_per or next(iter(units)))
    if per not in units:
        raise InputError(f"--scale-per: expected one of {', '.join(units)} for --sensor {sensor}, found {per!r}")

    # the length of the true vector, in the unit of the result
    factor = units[per]
    if sensor == "accel":
        if (modulus, modulus_u) != (None, None):
            raise InputError("--modulus: expected --gravity for accelerometers, found --modulus")
        length, length_u = _gravity(gravity, gravity_u)
    else:
        if (gravity, gravity_u) != (None, None):
            raise InputError(f"--gravity: expected --modulus for --sensor {sensor}, found --gravity")
        if modulus is None:
            what = {"gyro": "the rate of the table", "mag": "the field, or 1 where only ratios are wanted"}[sensor]
            raise InputError(f"--modulus: expected {what} for --sensor {sensor}, found none")
        if not 0.0 < modulus < LARGEST:
            raise InputError(f"--modulus: expected a positive number, found {modulus:g}")
        if modulus_u is not None and not 0.0 <= modulus_u <= LARGEST_U * modulus:
            raise InputError(
                f"--modulus-u: expected a number from 0 to {LARGEST_U:g} of the modulus, found {modulus_u:g}"
            )
        length, length_u = modulus * factor, None if modulus_u is None else modulus_u * factor

    # the output per unit: 1, as stated, or from the readings to three digits
    sizes, estimated = np.ones(3), unit in _RAW and scale is None
    if estimated:
        outputs = sizes_seen(table.values, length / factor)
        outputs = 0.5 * np.ptp(table.values, axis=0) / (length / factor) if outputs is None else outputs
        sizes = np.array([float(f"{s:.3g}") if s > 0.0 else 1.0 for s in outputs])
    elif scale is not None:
        if len(scale) not in (1, 3):
            raise InputError(f"--scale: expected one number or three, one per column, found {len(scale)}")
        sizes = np.broadcast_to(np.asarray(scale, dtype=float), 3)
        if not np.all((np.abs(sizes) > 1.0 / LARGEST) & (np.abs(sizes) < LARGEST)):
            raise InputError(f"--scale: expected numbers other than zero, found {', '.join(f'{s:g}' for s in sizes)}")
    signs, told_by = _polarity(table, sizes, described.get("directions", {}), free=estimated)
    return Nominal(
        sensor=sensor,
        unit=unit,
        per=per,
        per_factor=factor,
        scale=sizes * signs / factor,
        modulus=length,
        modulus_u=length_u,
        estimated=estimated,
        assumed=tuple(
            name for name, known_by in zip(table.columns, told_by, strict=True) if estimated and not known_by
        ),
    )


def _gravity(gravity: float | None, u: float | None) -> tuple[float, float | None]:
    """Gravity and its standard uncertainty, m/s²: that of gravity from latitude and height where none is stated."""
    if gravity is None:
        if u is not None:
            raise InputError("--gravity-u: expected --gravity with it, found it alone")
        return G_STANDARD, None
    if not EARTH_GRAVITY[0] <= gravity <= EARTH_GRAVITY[1]:
        raise InputError(f"--gravity: expected a number from 9.7 to 9.9 (m/s^2, on Earth), found {gravity:g}")
    if u is not None and not 0.0 <= u <= LARGEST_GRAVITY_U:
        raise InputError(f"--gravity-u: expected a number from 0 to {LARGEST_GRAVITY_U:g} (m/s^2), found {u:g}")
    return gravity, NORMAL_GRAVITY_U if u is None else u


def sizes_seen(values: Array, length: float) -> Array | None:
    """The output (3,) of the channels per unit of a vector of this length, from the ellipsoid through the readings
    (N, 3); None where they lie on none."""
    from tumble.methods.quadric import fit_many

    fit = fit_many(values[None])
    return np.linalg.norm(fit.models(length).matrix[0], axis=1) if fit.found[0] else None


def _polarity(table: ReadingsTable, sizes: Array, known: Mapping[int, Array], *, free: bool) -> tuple[Array, IntArray]:
    """Signs (3,) that roughly known positions give the channels, and the number of the position that told each, 0 for
    none; where `free` is false the signs must not differ from those of the scale."""
    from tumble.diagnosis.observability import rough_directions

    seen = rough_directions(table.values / sizes)
    signs, told = np.ones(3), np.zeros(3, dtype=int)
    for position, direction in known.items():
        if not 1 <= position <= len(seen):
            raise InputError(f"--position: expected a position from 1 to {len(seen)} of the table, found {position}")
        stated = direction / np.abs(direction).max()
        stated = stated / np.linalg.norm(stated)
        for p in np.flatnonzero((np.abs(stated) > TELLING) & (np.abs(seen[position - 1]) > TELLING)):
            sign = np.sign(stated[p] * seen[position - 1, p])
            column = table.columns[p]
            if told[p] and sign != signs[p]:
                raise InputError(
                    f"--position: positions {told[p]} and {position} contradict each other about the polarity of "
                    f"{column!r}; correct one of them"
                )
            if not free and sign < 0.0:
                raise InputError(
                    f"--position: position {position} shows {column!r} with the other polarity than its scale; change "
                    "the sign of its scale, or correct the position"
                )
            signs[p], told[p] = sign, position
    return signs, told


COPIES_SHOWN = 3
BLOCKS = 20
"""Of a recording: the fewer, the longer what errs alike may last, and the less is u itself known; twice the nine
parameters is the least that leaves each of them something to be judged by."""

CONSECUTIVE = 5 * BLOCKS
"""So many rows are a recording. A table with as many positions, of which each errs for itself, has the same u by blocks
but for the 16 % to which 19 degrees of freedom know it."""


def positions_of(table: ReadingsTable, rows_per_position: int = 1) -> ReadingsTable:
    """The table with a row a position, of so many rows each. Raises InputError where they do not go into the table."""
    N, rows = len(table.values), rows_per_position
    if rows < 1 or N % rows:
        raise InputError(
            f"--rows-per-position: expected a number that goes into the {N} rows of {table.path}, found {rows}"
        )
    blocks, lines = table.values.reshape(-1, rows, 3), table.lines[::rows]
    _, first, inverse = np.unique(blocks.reshape(len(blocks), -1), axis=0, return_index=True, return_inverse=True)
    once, equal = np.sort(first), first[inverse.ravel()]
    left_out: tuple[str, ...] = ()
    if len(again := np.flatnonzero(equal != np.arange(len(blocks)))):
        named = [f"line {lines[i]} as line {lines[equal[i]]}" for i in again[:COPIES_SHOWN]]
        named += [f"{len(again) - COPIES_SHOWN} more"] if len(again) > COPIES_SHOWN else []
        left_out = (
            f"{'rows' if rows == 1 else f'blocks of {rows} rows'} that repeat others to the last digit: {len(again)} "
            f"({', '.join(named)}); a copy is no further reading, and each counts once",
        )
    means, covariance = blocks[once].mean(axis=1), None
    if rows > 1:  # of the mean of a block, from the scatter within all blocks
        away = (blocks[once] - means[:, None]).reshape(-1, 3)
        covariance = np.asarray(away.T @ away / (len(once) * (rows - 1)) / rows)
    return replace(
        table,
        values=means,
        lines=tuple(lines[i] for i in once),
        covariance=covariance,
        rows=rows,
        degrees=len(once) * (rows - 1),
        left_out=left_out,
        stretch=np.arange(len(once)) * BLOCKS // len(once) if rows == 1 and len(once) >= CONSECUTIVE else None,
    )
