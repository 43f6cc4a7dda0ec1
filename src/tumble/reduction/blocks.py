"""A log reduced to blocks: the means of 0.1 s or less, the state of each channel, and the gyro samples for the turns.

The log is fed chunk by chunk to a `Reducer`. A block is defined by the sample number in its file, so chunks of any size
give the same blocks.
"""

from __future__ import annotations

import os
import tempfile
import weakref
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import IO

import numpy as np

from tumble.recording.log import Chunk, Log
from tumble.reduction import kernels as _kernels
from tumble.sensors.model import Block
from tumble.units import Array

BLOCK_SECONDS = 0.1
IN_MEMORY_BYTES = 16 * 2**20


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelState:
    """What the samples of one channel say about its health, over a whole log, in SI."""

    samples: int
    minimum: float
    maximum: float
    repeats: int
    """Samples equal to the one before."""
    run: int
    """Longest row of equal samples, and where it ended (s, in its file)."""
    run_stop: float
    run_value: float
    step: float
    """Smallest step from one value to another: the resolution, where it is coarser than the noise."""
    extreme_run: int
    """Longest row of equal samples at the minimum or the maximum, and where it ended."""
    extreme_stop: float

    @property
    def unresolved(self) -> float:
        """Standard uncertainty of a mean from the resolution: step/√12 where more than half of the samples repeat the
        one before, so that noise does not average it out; else 0."""
        coarse = 2 * self.repeats > self.samples and np.isfinite(self.step)
        return self.step / np.sqrt(12.0) if coarse else 0.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Tail:
    """The samples after the last whole block of a file: their weighted `total` (n,); and the weights (K + 1,) of the
    blocks and of the tail in a mean."""

    total: Array
    weight: Array

    def mean(self, means: Array, first: int, last: int) -> Array:
        """Mean (n,) over blocks first … last − 1, with the tail where they end the file."""
        total, weight = self.weight[first:last] @ means[first:last], self.weight[first:last].sum()
        if last == len(means):
            total, weight = total + self.total, weight + self.weight[-1]
        return np.asarray(total / weight)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FileBlocks:
    """The blocks of one file: `edges` (K + 1) in s, means over K blocks of `size` samples each of the
    accelerometers (K, n) and gyros (K, n) in SI, of the temperature, and of the magnetometer (K, 3) in its unit."""

    file: int
    first_sample: int
    """Position of the file's first sample among the stored increments."""
    size: int
    edges: Array
    accel: Array
    gyro: Array | None
    temperature: Array | None
    accel_tail: Tail
    gyro_tail: Tail | None
    magnetometer: Array | None = None
    magnetometer_tail: Tail | None = None

    def accel_mean(self, first: int, last: int) -> Array:
        """Mean accelerometer reading (n,) over blocks first … last − 1, and over the tail where they end the file."""
        return self.accel_tail.mean(self.accel, first, last)

    def gyro_mean(self, first: int, last: int) -> Array:
        """Mean gyro reading (n,), likewise; empty without gyros."""
        if self.gyro is None or self.gyro_tail is None:
            return np.empty(0)
        return self.gyro_tail.mean(self.gyro, first, last)

    def magnetometer_mean(self, first: int, last: int) -> Array:
        """Mean magnetometer reading (3,), likewise; empty without one."""
        if self.magnetometer is None or self.magnetometer_tail is None:
            return np.empty(0)
        return self.magnetometer_tail.mean(self.magnetometer, first, last)


class GyroSamples:
    """The gyro samples of a log, kept for the turns: body rates (rad/s) from nominal sensors and the interval (s) of
    each sample, as the log gave them while they are few, in a temporary file beyond IN_MEMORY_BYTES."""

    _BYTES = 4 * 8  # a sample

    def __init__(self) -> None:
        self._chunks: list[tuple[Array, Array]] = []
        self._starts: list[int] = []
        self._files: tuple[IO[bytes], IO[bytes]] | None = None
        self.count = 0

    def append(self, rates: Array, dt: Array) -> None:
        """Add samples: mean body rates (m, 3) rad/s over intervals dt (m,) s."""
        self._chunks.append((rates, dt))
        self._starts.append(self.count)
        self.count += len(dt)
        if self._files is not None or self.count * self._BYTES > IN_MEMORY_BYTES:
            self._spill()

    def _spill(self) -> None:
        """Move what is in memory to the files."""
        if self._files is None:
            self._files = tempfile.TemporaryFile(), tempfile.TemporaryFile()  # noqa: SIM115
            for opened in self._files:
                weakref.finalize(self, opened.close)
        for rates, dt in self._chunks:
            for file, values in zip(self._files, (rates, dt), strict=True):
                file.seek(0, os.SEEK_END)
                file.write(np.ascontiguousarray(values).data)
        self._chunks, self._starts = [], []

    def read(self, start: int, stop: int) -> tuple[Array, Array]:
        """Increments (m, 3), rad, and intervals (m,), s, of samples start … stop − 1."""
        if self._files is not None:
            rates, dt = (_values_at(file, width, start, stop) for file, width in zip(self._files, (3, 1), strict=True))
            return rates.reshape(-1, 3) * dt[:, None], dt
        first, last = bisect_right(self._starts, start) - 1, bisect_left(self._starts, stop)
        rates = np.concatenate([rates for rates, _ in self._chunks[first:last]])
        dt = np.concatenate([dt for _, dt in self._chunks[first:last]])
        part = slice(start - self._starts[first], stop - self._starts[first])
        return rates[part] * dt[part, None], dt[part]


def _values_at(file: IO[bytes], width: int, start: int, stop: int) -> Array:
    """Rows start … stop − 1, `width` numbers each, of a file of numbers."""
    file.seek(8 * width * start)
    return np.frombuffer(file.read(8 * width * (stop - start)))


@dataclass(frozen=True, kw_only=True, slots=True)
class Reduction:
    """A log reduced to blocks."""

    rate: float
    files: tuple[FileBlocks, ...]
    accel_channels: tuple[ChannelState, ...]
    gyro_channels: tuple[ChannelState, ...]
    samples: GyroSamples | None
    magnetometer_channels: tuple[ChannelState, ...] = ()


class _Channels:
    """Running block sums and channel states of one kind of sensor. Samples that came as increments have the weight of
    their intervals in a mean, samples that came as rates one and the same weight, whatever their time stamps."""

    def __init__(self, sensors: int, size: int, increments: bool) -> None:
        self.size = size
        self.increments = increments
        self.sums = np.zeros(sensors)
        self.filled = np.zeros(1, dtype=np.int64)
        self.state = _kernels.new_channel_state(sensors)
        self.blocks: list[Array] = []

    def feed(self, values: Array, time: Array, dt: Array) -> None:
        weight = dt if self.increments else np.ones(len(dt))
        out = np.empty(((len(values) + self.size) // self.size, len(self.sums)))
        count = _kernels.block_sums(values, time, weight, self.size, self.sums, self.filled, self.state, out)
        self.blocks.append(out[:count])

    def end_file(self, edges: Array) -> tuple[Array, Tail]:
        """Means of the blocks of the file, and what was left; `edges` (K + 2,) of the blocks and the file's end."""
        count = len(edges) - 2
        weight = np.diff(edges) if self.increments else np.append(np.full(count, float(self.size)), self.filled)
        means = np.concatenate(self.blocks) / weight[:count, None]
        tail = Tail(total=self.sums, weight=weight)
        self.blocks, self.filled[0], self.sums = [], 0, np.zeros_like(self.sums)
        return means, tail

    def states(self) -> tuple[ChannelState, ...]:
        return tuple(_channel_state(row) for row in self.state)


def _channel_state(row: Array) -> ChannelState:
    at_minimum, at_maximum = row[9:11], row[11:13]
    extreme = at_minimum if at_minimum[0] > at_maximum[0] else at_maximum
    return ChannelState(
        samples=int(row[0]),
        minimum=float(row[1]),
        maximum=float(row[2]),
        repeats=int(row[3]),
        run=int(row[6]),
        run_stop=float(row[7]),
        run_value=float(row[8]),
        step=float(row[13]),
        extreme_run=int(extreme[0]),
        extreme_stop=float(extreme[1]),
    )


class Reducer:
    """Takes a log chunk by chunk and keeps what segmentation and reduction need."""

    def __init__(
        self,
        *,
        rate: float,
        accel: Block,
        gyro: Block | None,
        increments: tuple[bool, bool] = (False, False),
        magnetometer: bool = False,
    ) -> None:
        """`increments`: whether accelerometers and gyros came as increments per sample; `magnetometer`: whether there
        is one."""
        self.rate = rate
        self.size = max(1, int(BLOCK_SECONDS * rate * (1.0 + 1e-9)))
        self._accel = _Channels(accel.size, self.size, increments[0])
        self._gyro = _Channels(gyro.size, self.size, increments[1]) if gyro else None
        self._magnetometer = _Channels(3, self.size, increments=False) if magnetometer else None
        self._to_body = np.linalg.pinv(gyro.axes).T if gyro else np.eye(3)
        self._along_body = np.array_equal(self._to_body, np.eye(3))
        self._temperature: list[Array] = []
        self._times: list[Array] = []
        self._files: list[FileBlocks] = []
        self._file = -1
        self._first = 0
        self._count = 0
        self._start = self._stop = 0.0
        self._stored = GyroSamples() if gyro else None

    def feed(self, chunk: Chunk) -> None:
        """Add the next samples of the log."""
        if chunk.file != self._file:
            self._end_file()
            self._file, self._start = chunk.file, float(chunk.time[0] - chunk.dt[0])
            self._first, self._count = self._first + self._count, 0
        self._accel.feed(chunk.accel, chunk.time, chunk.dt)
        if self._gyro and self._stored is not None and chunk.gyro is not None:
            self._gyro.feed(chunk.gyro, chunk.time, chunk.dt)
            body = chunk.gyro if self._along_body else chunk.gyro @ self._to_body
            self._stored.append(body, chunk.dt)
        if self._magnetometer and chunk.magnetometer is not None:
            self._magnetometer.feed(chunk.magnetometer, chunk.time, chunk.dt)
        ends = np.arange(self.size - 1 - self._count % self.size, len(chunk.time), self.size)
        self._times.append(chunk.time[ends])
        if chunk.temperature is not None:
            self._temperature.append(chunk.temperature[ends])
        self._count += len(chunk.time)
        self._stop = float(chunk.time[-1])

    def _end_file(self) -> None:
        if self._file < 0:
            return
        edges = np.concatenate([[self._start], *self._times, [self._stop]])
        accel, accel_tail = self._accel.end_file(edges)
        gyro, gyro_tail = self._gyro.end_file(edges) if self._gyro else (None, None)
        field, field_tail = self._magnetometer.end_file(edges) if self._magnetometer else (None, None)
        self._files.append(
            FileBlocks(
                file=self._file,
                first_sample=self._first,
                size=self.size,
                edges=edges[:-1],
                accel=accel,
                gyro=gyro,
                temperature=np.concatenate(self._temperature) if self._temperature else None,
                accel_tail=accel_tail,
                gyro_tail=gyro_tail,
                magnetometer=field,
                magnetometer_tail=field_tail,
            )
        )
        self._times, self._temperature = [], []

    def finish(self) -> Reduction:
        """The reduction of all that was fed."""
        self._end_file()
        self._file = -1
        return Reduction(
            rate=self.rate,
            files=tuple(self._files),
            accel_channels=self._accel.states(),
            gyro_channels=self._gyro.states() if self._gyro else (),
            samples=self._stored,
            magnetometer_channels=self._magnetometer.states() if self._magnetometer else (),
        )


def reduce_log(log: Log, accel: Block, gyro: Block | None, chunks: Iterable[Chunk] | None = None) -> Reduction:
    """Read a log once and reduce it; `chunks` stands in for `log.chunks()`, e.g. to show progress."""
    spec = log.session.log
    kinds = [channels is not None and channels.unit.kind == "increment" for channels in (spec.accel, spec.gyro)]
    reducer = Reducer(
        rate=log.rate,
        accel=accel,
        gyro=gyro,
        increments=(kinds[0], kinds[1]),
        magnetometer=spec.magnetometer is not None,
    )
    for chunk in _one_ahead(iter(log.chunks() if chunks is None else chunks)):
        reducer.feed(chunk)
    return reducer.finish()


def _one_ahead(chunks: Iterator[Chunk]) -> Iterator[Chunk]:
    """The same chunks; the next one is read while this one is worked on."""
    with ThreadPoolExecutor(max_workers=1) as beside:
        ahead = beside.submit(next, chunks, None)
        while (chunk := ahead.result()) is not None:
            ahead = beside.submit(next, chunks, None)
            yield chunk
