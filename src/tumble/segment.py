"""Rests and turns in a log.

The log is fed chunk by chunk to a `Reducer`, which keeps the means of short blocks (0.1 s or less), the state of
each channel and the gyro increments of every sample; a block is defined by the sample number in its file, so
chunks of any size give the same blocks. When the stream has ended, `find_rests` sets its thresholds from the
whole:

1. The level of the gyros at rest is the densest point of the one-second means of the angular rate where the
   accelerometers are quiet, their scatter within QUIET_FACTOR of its floor: turns go many ways, rests all read the
   bias (and the Earth's rate, within 2Ω), and slow turns that take most of the log are not quiet.
2. The noise floor of the distance from that level is a clipped median, started from the tenth percentile. A
   block belongs to a rest where the distance is below FLOOR_FACTOR floors (and 2Ω for the Earth's rate), and
   the scatter of the accelerometers in the same second below SCATTER_FACTOR of its own floor. Vibration that
   averages out over a second raises both floors and their quantities alike, so nothing has to be set by hand.
   The level follows slow drift: it is interpolated between the rests found, and the search repeated.
3. A rest is extended block by block while single blocks stay within EDGE_SIGMAS of its own mean, then
   shortened by a margin for settling at both ends, except where the file itself begins or ends. What lies between two
   rests of a file is a turn.
4. What seemed a rest while the vertical moved by more than TILT_LIMIT is none: where nothing rests, the floors
   are those of the movement.

Without gyros only the accelerometers decide: their scatter, and the step between the means of two neighbouring
seconds, which shows a turn about a nearly vertical axis by the little it tilts.
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

from tumble import _kernels
from tumble.earth import EARTH_RATE
from tumble.log import Chunk, Log
from tumble.model import Block
from tumble.units import DEGREE, Array, BoolArray, IntArray

BLOCK_SECONDS = 0.1
WINDOW_SECONDS = 1.0
FLOOR_FACTOR = 5.0
SCATTER_FACTOR = 10.0
QUIET_FACTOR = 2.0
EDGE_SIGMAS = 4.0
MIN_REST_SECONDS = 2.0
DENSITY_POINTS = 1000
MARGIN_FRACTION = 0.05
MARGIN_SECONDS = (0.2, 1.0)
TILT_LIMIT = 2.0 * DEGREE
ACCEL_ROUNDING = 1e-5  # m/s²: what single-precision increments leave in a block mean
GYRO_ROUNDING = 1e-7  # rad/s
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


@dataclass(frozen=True, kw_only=True, slots=True)
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


@dataclass(frozen=True, kw_only=True, slots=True)
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


@dataclass(frozen=True, kw_only=True, slots=True)
class RestSpan:
    """A rest found: blocks [first, last) of a file, start and stop in s."""

    file: int
    first: int
    last: int
    start: float
    stop: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Rejected:
    """A quiet stretch that is not a rest, and the number that decided."""

    file: int
    start: float
    stop: float
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Segmentation:
    """Rests of a log in the order of time, what was rejected, and the thresholds that were found:
    rate_limit (rad/s; None without gyros) and scatter_limit (m/s²)."""

    rests: tuple[RestSpan, ...]
    rejected: tuple[Rejected, ...]
    rate_limit: float | None
    scatter_limit: float


def find_rests(reduction: Reduction, accel: Block, gyro: Block | None) -> Segmentation:
    """The rests of a reduced log (module docstring)."""
    coarse = _resolution(reduction.accel_channels, ACCEL_ROUNDING), _resolution(reduction.gyro_channels, GYRO_ROUNDING)
    size = reduction.files[0].size
    window = max(2, round(WINDOW_SECONDS * reduction.rate / size))
    to_body = np.linalg.pinv(accel.axes).T
    specific_force = [f.accel @ to_body for f in reduction.files]
    scatter = [_moving_scatter(a, window) for a in specific_force]
    floor = _floor(np.concatenate(scatter))
    scatter_limit = (SCATTER_FACTOR if gyro else FLOOR_FACTOR) * floor + coarse[0]
    calm = [s < scatter_limit for s in scatter]
    if gyro is None:
        step = [_moving_step(a, window) for a in specific_force]
        step_limit = FLOOR_FACTOR * _floor(np.concatenate(step)) + coarse[0]
        spans = [_runs(c & (s < step_limit)) for c, s in zip(calm, step, strict=True)]
        return _assemble(reduction, specific_force, None, spans, coarse, window, scatter_limit, None, [])
    gyro_to_body = np.linalg.pinv(gyro.axes).T
    rates = [f.gyro @ gyro_to_body for f in reduction.files if f.gyro is not None]
    quiet = [s < QUIET_FACTOR * floor + coarse[0] for s in scatter]
    spans, rate_limit = _still_spans(rates, calm, quiet, coarse[1], window)
    unmoved, _ = _still_spans(rates, None, quiet, coarse[1], window)
    restless = [
        Rejected(
            file=f.file,
            start=float(f.edges[i]),
            stop=float(f.edges[j]),
            reason=f"accelerometer scatter {s[i:j].max():.2g} m/s^2 within a second is above {scatter_limit:.2g} m/s^2",
        )
        for f, s, still, c in zip(reduction.files, scatter, unmoved, calm, strict=True)
        for i, j in still
        if not c[i:j].any() and f.edges[j] - f.edges[i] >= MIN_REST_SECONDS
    ]
    return _assemble(reduction, specific_force, rates, spans, coarse, window, scatter_limit, rate_limit, restless)


def _resolution(channels: tuple[ChannelState, ...], rounding: float) -> float:
    """What the steps of coarse channels may do to a block mean without anything moving."""
    steps = [channel.step for channel in channels if np.isfinite(channel.step)]
    return rounding + float(np.linalg.norm(steps))


def _still_spans(
    rates: list[Array], calm: list[BoolArray] | None, quiet: list[BoolArray], coarse: float, window: int
) -> tuple[list[list[tuple[int, int]]], float]:
    """Stretches of blocks in which the body does not turn, per file, and the limit of the rate, rad/s."""
    smooth = [_moving_mean(w, window) for w in rates]
    in_quiet = np.concatenate(quiet)
    densest = _densest(np.concatenate([s[::window][q[::window]] for s, q in zip(smooth, quiet, strict=True)]))
    level = [np.broadcast_to(densest, s.shape) for s in smooth]
    spans: list[list[tuple[int, int]]] = [[] for _ in rates]
    limit = 0.0
    for _ in range(5):  # the level follows slow drift from rest to rest
        distance = [np.linalg.norm(s - at, axis=1) for s, at in zip(smooth, level, strict=True)]
        limit = FLOOR_FACTOR * _floor(np.concatenate(distance)[in_quiet]) + 2.0 * EARTH_RATE + coarse
        still = [d < limit for d in distance]
        if calm is not None:
            still = [a & b for a, b in zip(still, calm, strict=True)]
        found = [_runs(s) for s in still]
        if found == spans:
            break
        spans = found
        level = [_interpolated_level(w, f, at) for w, f, at in zip(rates, spans, level, strict=True)]
    return spans, limit


def _interpolated_level(rate: Array, spans: list[tuple[int, int]], default: Array) -> Array:
    """The gyro level of every block, interpolated between the means of the stretches found."""
    long = [(i, j) for i, j in spans if j - i >= 10]
    if not long:
        return default
    centres = np.array([0.5 * (i + j) for i, j in long])
    means = np.array([rate[i:j].mean(axis=0) for i, j in long])
    blocks = np.arange(len(rate))
    return np.column_stack([np.interp(blocks, centres, means[:, c]) for c in range(rate.shape[1])])


def _assemble(
    reduction: Reduction,
    specific_force: list[Array],
    rates: list[Array] | None,
    spans: list[list[tuple[int, int]]],
    coarse: tuple[float, float],
    window: int,
    scatter_limit: float,
    rate_limit: float | None,
    rejected: list[Rejected],
) -> Segmentation:
    """Extend the stretches found, take the margins off, and keep those that are long enough."""
    rests: list[RestSpan] = []
    for k, (f, force, found) in enumerate(zip(reduction.files, specific_force, spans, strict=True)):
        signals = [(force, coarse[0])] if rates is None else [(force, coarse[0]), (rates[k], coarse[1])]
        for first, last in _merged([_extended(signals, i, j, window) for i, j in found]):
            duration = float(f.edges[last] - f.edges[first])
            margin = float(np.clip(MARGIN_FRACTION * duration, *MARGIN_SECONDS))
            before = margin if first > 0 else 0.0
            after = margin if last < len(f.edges) - 1 else 0.0
            if duration - before - after < MIN_REST_SECONDS:
                if duration > 0.5:
                    reason = f"{duration:.1f} s is too short for a rest of {MIN_REST_SECONDS:g} s and its margins"
                    rejected.append(
                        Rejected(file=f.file, start=float(f.edges[first]), stop=float(f.edges[last]), reason=reason)
                    )
                continue
            tilt = _tilt(force[first:last], window)
            if tilt > TILT_LIMIT:
                reason = f"the vertical moves by {tilt / DEGREE:.0f}°, in a rest at most {TILT_LIMIT / DEGREE:g}°"
                rejected.append(
                    Rejected(file=f.file, start=float(f.edges[first]), stop=float(f.edges[last]), reason=reason)
                )
                continue
            rests.append(_span(f, f.edges[first] + before, f.edges[last] - after))
    return Segmentation(
        rests=tuple(rests),
        rejected=tuple(sorted(rejected, key=lambda r: (r.file, r.start))),
        rate_limit=rate_limit,
        scatter_limit=scatter_limit,
    )


def stated_rest(reduction: Reduction, start: float, stop: float) -> RestSpan:
    """A rest at stated times (s) of the first file, to whole blocks inside them."""
    return _span(reduction.files[0], start, stop)


def _span(f: FileBlocks, start: float, stop: float) -> RestSpan:
    """The whole blocks between two times of a file."""
    first = int(np.searchsorted(f.edges, start - 1e-9))
    last = int(np.searchsorted(f.edges, stop + 1e-9, side="right")) - 1
    return RestSpan(file=f.file, first=first, last=last, start=float(f.edges[first]), stop=float(f.edges[last]))


def _extended(signals: list[tuple[Array, float]], first: int, last: int, window: int) -> tuple[int, int]:
    """A stretch of blocks with its ends set where single blocks leave EDGE_SIGMAS of its own scatter: the moving
    window has blurred them by half its length."""
    tenth = (last - first) // 10
    inside = np.ones(len(signals[0][0]), dtype=bool)
    for values, rounding in signals:
        core = values[first + tenth : last - tenth]
        mean, sigma = core.mean(axis=0), np.sqrt(core.var(axis=0).sum())
        inside &= np.linalg.norm(values - mean, axis=1) <= EDGE_SIGMAS * sigma + rounding
    half = min(window, last - first) // 2
    before, after = inside[: first + half][::-1], inside[last - half :]
    start = first + half - (len(before) if before.all() else int(np.argmin(before)))
    stop = last - half + (len(after) if after.all() else int(np.argmin(after)))
    return start, stop


def _tilt(force: Array, window: int) -> float:
    """How far (rad) the one-second means of the specific force (K, 3) go from the mean of all."""
    mean = force.mean(axis=0)
    return float(np.linalg.norm(_moving_mean(force, window) - mean, axis=1).max() / np.linalg.norm(mean))


def _merged(spans: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Stretches in order, overlapping ones joined."""
    out: list[tuple[int, int]] = []
    for first, last in sorted(spans):
        if out and first < out[-1][1]:
            out[-1] = (out[-1][0], max(last, out[-1][1]))
        elif last > first:
            out.append((first, last))
    return out


def _moving_mean(values: Array, window: int) -> Array:
    """Mean over the `window` rows about each row, at the ends over the first and the last `window` rows."""
    window = min(window, len(values))
    return _inner_mean(values, window)[_window_of(len(values), window)]


def _moving_scatter(values: Array, window: int) -> Array:
    """Root of the summed variances of the columns in the same windows."""
    window = min(window, len(values))
    inside = len(values) - window + 1
    mean, variance = _inner_mean(values, window), np.zeros(inside)
    for i in range(window):
        variance += ((values[i : inside + i] - mean) ** 2).sum(axis=1)
    return np.asarray(np.sqrt(variance / window)[_window_of(len(values), window)])


def _moving_step(values: Array, window: int) -> Array:
    """Distance between the means of the `window` rows before and behind each row, at the ends that of the nearest."""
    window = min(window, len(values) // 2)
    mean = _inner_mean(values, window)
    step = np.linalg.norm(mean[window:] - mean[:-window], axis=1)
    return np.asarray(step[np.clip(np.arange(len(values)) - window, 0, len(step) - 1)])


def _inner_mean(values: Array, window: int) -> Array:
    """Mean of every `window` consecutive rows."""
    out = np.zeros((len(values) - window + 1, values.shape[1]))
    for i in range(window):
        out += values[i : len(out) + i]
    return out / window


def _window_of(rows: int, window: int) -> IntArray:
    """First row of the window that belongs to each row."""
    return np.clip(np.arange(rows) - window // 2, 0, rows - window)


def _densest(points: Array) -> Array:
    """The point of a cloud with the nearest neighbours, from at most DENSITY_POINTS of them evenly spread."""
    points = points[:: -(-len(points) // DENSITY_POINTS)]
    squares = sum((column[:, None] - column) ** 2 for column in points.T)
    neighbour = min(len(points) - 1, max(3, len(points) // 20))
    return np.asarray(points[np.argmin(np.partition(squares, neighbour, axis=1)[:, neighbour])])


def _floor(values: Array) -> float:
    """The level of the quiet part of a positive quantity: a median clipped at FLOOR_FACTOR times itself, started
    from the tenth percentile."""
    floor = float(np.quantile(values, 0.1))
    for _ in range(50):
        inside = values[values <= FLOOR_FACTOR * floor]
        median = float(np.median(inside))
        if abs(median - floor) <= 1e-6 * floor:
            break
        floor = median
    return floor


def _runs(flags: BoolArray) -> list[tuple[int, int]]:
    """[first, last) of every row of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
    return [(int(i), int(j)) for i, j in edges.reshape(-1, 2)]
