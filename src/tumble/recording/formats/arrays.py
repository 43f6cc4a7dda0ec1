"""MATLAB files, HDF5 and NumPy: arrays of numbers, identified by their names.

An array is named by its path (`imu/gyro`). One of three columns (or rows) is a triad `imu/gyro[0]` … `imu/gyro[2]`; one
of four, the first or last of which grows, is a time `imu/gyro/t` and a triad; a wider one is a table. Arrays of one
length form a table, whose sensors are identified by name, else by their numbers.
"""

from __future__ import annotations

import math
import struct
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import polars as pl
from scipy.io import loadmat
from scipy.io.matlab import MatlabOpaque, MatReadError

from tumble.errors import InputError
from tumble.recording.columns.names import ACCEL, Columns, columns_by_name
from tumble.recording.columns.numbers import columns_by_data, grows, guess_remarks
from tumble.recording.formats import TIME, Message
from tumble.recording.rows.gaps import is_reading
from tumble.recording.text.pieces import check_unpacked, largest_unpacked
from tumble.units import TIME_UNITS, Array

NOTHING = "no arrays named as accelerometers are, such as acc_x or accel (m, 3)"

_ROWS = 1 << 15
_SHORTEST = 10
_WIDEST = 32
_WHOLE = slice(0, 1 << 21)
_MATLAB_HEADER, _MATLAB_PACKED = 128, 15
_PIECE_BYTES = 1 << 20


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Column:
    """A column of a table: the name of an array, the array (NumPy or HDF5), and the column or row in it."""

    name: str
    array: Any
    axis: int | None

    def part(self, rows: slice) -> Array:
        """Return a part of the numbers, with NaN for those that are no readings."""
        shape, across = self.array.shape, 0 if self.axis is None else self.axis
        where = rows if len(shape) == 1 else (rows, across) if shape[0] >= shape[-1] else (across, rows)
        with np.errstate(over="ignore"):  # numbers of 80 bits beyond the range of 64
            numbers = np.asarray(self.array[where], dtype=np.float64)
        return np.where(is_reading(numbers), numbers, np.nan)


def messages(path: Path) -> list[Message]:
    """Return tables with inertial sensors, one for each length of arrays, those identified by name first."""
    arrays = {name: array for name, array in _arrays(path).items() if len(array.shape) in (1, 2)}
    by_name: list[Message] = []
    by_data: list[Message] = []
    for length in sorted({max(array.shape) for array in arrays.values()}, reverse=True):
        columns = dict(_columns({name: array for name, array in arrays.items() if max(array.shape) == length}))
        widths = Counter(column.name for name, column in columns.items() if name != f"{column.name}/t")
        named = columns_by_name([name for name, column in columns.items() if widths[column.name] <= len("xyz")])
        guessed, remark = ACCEL not in named.triads, ""
        if guessed:
            named, remark = _with_columns_by_data(columns, named)
        if length < _SHORTEST or not named.triads:
            continue
        factor = TIME_UNITS[named.time_unit or "s"]
        (by_data if guessed else by_name).append(
            Message(
                name=f"{length} rows",
                count=length,
                triads=named.triads,
                temperatures=named.temperatures,
                timed=named.time is not None,
                remark=remark,
                rows=partial(_rows, columns, length, named.time, factor),
            )
        )
    if not by_name and not by_data and path.suffix.lower() == ".mat" and not h5py.is_hdf5(path):
        opaque = [v for v in loadmat(path).values() if isinstance(v, MatlabOpaque)]
        kinds = {bytes(kind).decode(errors="replace") for v in opaque for kind in v["s2"]} & {"table", "timetable"}
        if kinds:
            kind = max(kinds)
            raise InputError(
                f"{path}: expected arrays of numbers, found a {kind}, which MATLAB alone reads: write it as text "
                f"there, write{kind}(T, 'log.csv')"
            )
    return by_name + by_data


def _columns(arrays: Mapping[str, Any]) -> Iterator[tuple[str, Column]]:
    """Yield the columns of arrays with their names."""
    for name, array in arrays.items():
        shape = array.shape
        if min((*shape, 1)) == 1 and np.prod(shape) == max(shape):
            yield name, Column(name=name, array=array, axis=None)
        elif 3 <= min(shape) <= _WIDEST:
            across = [Column(name=name, array=array, axis=axis) for axis in range(min(shape))]
            ends = (across[0], across[-1]) if len(across) == 4 else ()
            time = next((column for column in ends if grows(column.part(_WHOLE))), None)
            if time is not None:
                across.remove(time)
                yield f"{name}/t", time
            yield from ((f"{name}[{at}]", column) for at, column in enumerate(across))


def _with_columns_by_data(columns: Mapping[str, Column], named: Columns) -> tuple[Columns, str]:
    """Identify columns by their numbers if no name identifies accelerometers, and return a remark.

    Triads identified by name are kept."""
    taken = {column for triad in named.triads.values() for column in triad.columns}
    free = {name: column for name, column in columns.items() if name not in taken}
    together = {name: column for name, column in free.items() if column.axis is not None} or free
    if not 0 < len(together) <= _WIDEST:
        return named, ""
    by_data = columns_by_data(list(together), np.column_stack([column.part(_WHOLE) for column in together.values()]))
    if ACCEL not in by_data.triads:
        return named, ""
    remark = "; ".join(guess_remarks(by_data, named.triads))
    return replace(named, triads={**by_data.triads, **named.triads}, time=named.time or by_data.time), remark


def _rows(columns: Mapping[str, Column], length: int, time: str | None, factor: float) -> Iterator[pl.DataFrame]:
    for start in range(0, length, _ROWS):
        part = slice(start, min(start + _ROWS, length))
        table = {name: column.part(part) for name, column in columns.items()}
        yield pl.DataFrame(table if time is None else {TIME: table.pop(time) * factor} | table)


def _arrays(path: Path) -> dict[str, Any]:
    """Return arrays of numbers by path."""
    if path.suffix.lower() in (".npy", ".npz"):
        try:
            if zipfile.is_zipfile(path):
                with zipfile.ZipFile(path) as archive:
                    check_unpacked(path, sum(member.file_size for member in archive.infolist()))
                with np.load(path) as read:
                    named = dict(read)
            else:  # mapped, so that a damaged header claims no memory
                named = {path.stem: np.load(path, mmap_mode="r")}
        except ValueError as error:
            # objects are not read, because reading them would run code from the file
            if "pickle" not in str(error) and "Python objects" not in str(error):
                raise
            raise InputError(
                f"{path}: expected arrays of numbers, found objects of Python; save the arrays themselves, np.savez("
                "file, t=t, acc=acc, gyro=gyro)"
            ) from None
        return dict(_nested(named))
    if path.suffix.lower() == ".mat" and not h5py.is_hdf5(path):
        check_unpacked(path, _bytes_of_matlab(path))
        try:
            return dict(_nested(loadmat(path, simplify_cells=True)))
        except (MatReadError, ValueError) as error:
            raise ValueError(f"not a MATLAB file: {error}") from None
    datasets: dict[str, Any] = {}

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "fiu":
            datasets[name] = item

    h5py.File(path).visititems(visit)  # stays open with its datasets
    check_unpacked(path, sum(math.prod(item.shape) * item.dtype.itemsize for item in datasets.values()))
    return datasets


def _bytes_of_matlab(path: Path) -> int:
    """Return the unpacked size of the elements of a MATLAB file of version 5, counted up to the limit, bytes."""
    unpacked, limit = 0, largest_unpacked(path)
    with path.open("rb") as stream:
        order = {b"IM": "<", b"MI": ">"}.get(stream.read(_MATLAB_HEADER)[-2:])
        while order is not None and len(tag := stream.read(8)) == 8 and unpacked <= limit:
            kind, size = struct.unpack(order + "II", tag)
            if kind != _MATLAB_PACKED:
                stream.seek(size, 1)
                continue
            unpack, packed = zlib.decompressobj(), stream.read(size)
            with suppress(zlib.error):  # reported by the reader
                while packed and unpacked <= limit:
                    unpacked += len(unpack.decompress(packed, _PIECE_BYTES))
                    packed = unpack.unconsumed_tail
    return unpacked


def _nested(content: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the arrays of a MATLAB file, also those in structures."""
    for name, value in content.items():
        if isinstance(value, np.ndarray) and value.dtype.names:
            value = {field: value[field] for field in value.dtype.names}
        objects = isinstance(value, np.ndarray) and value.dtype.kind == "O" and value.ndim == 1
        samples = list(value) if objects or isinstance(value, list) else []
        if samples and all(isinstance(sample, dict) for sample in samples):
            value = _stacked(samples)
        if isinstance(value, dict):
            yield from _nested(value, f"{prefix}{name}/")
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and not name.startswith("__"):
            yield prefix + name, value


def _stacked(samples: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return arrays of all samples from structures of one sample each, for fields of equal shape."""
    fields = {name: [np.asarray(sample.get(name, np.nan)) for sample in samples] for name in samples[0]}
    return {name: np.array(parts) for name, parts in fields.items() if len({part.shape for part in parts}) == 1}
