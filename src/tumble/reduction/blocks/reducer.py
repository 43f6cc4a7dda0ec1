"""A log reduced to blocks: means over at most 0.1 s, the state of each channel, and the samples for the turns.

A log is fed chunk by chunk to a `Reducer`. Blocks are counted in samples from the beginning of a file, so that chunks
of any size give the same blocks.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import chain
from types import MappingProxyType

import numpy as np

from tumble.errors import LogError
from tumble.recording.log import Chunk, Log
from tumble.recording.log_source import one_ahead
from tumble.recording.rows.gaps import Gap
from tumble.reduction import kernels as _kernels
from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.reduction.blocks.tuning import USUAL, Tuning
from tumble.reduction.turns.array_motion import FEWEST_OF_ARRAY
from tumble.rotation import onto_body
from tumble.sensors.model import Block, left_null_space
from tumble.units import Array, BoolArray, IntArray

BLOCK_SECONDS = 0.1
SHORTEST_HELD_RUN = 6  # repeated rows in a run that cost a turn; fewer lost samples are bridged
MOST_HELD = 0.05  # fraction of the rows of a log up to which those that repeat can be held
HELD_TOGETHER = 0.8  # least ratio of repeated rows to the repeats of any channel if channels repeat only together
FREQUENT_REPEATS = 0.7  # of the samples of every channel: more show coarse channels, or a log faster than its sensors
MOST_RUNS = 1000  # of repeated rows that are kept; more show how a log is sampled
HELD_BY_CHANCE = 1e-3  # greatest expected number of such runs in a log if its channels repeat independently
GAP_INTERVALS = 2.0  # uncovered time between two samples, in sample intervals, beyond which it is a gap, not jitter


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelState:
    """Range and repeated values of one channel over a whole log, SI."""

    samples: int
    minimum: float
    maximum: float
    repeats: int  # samples equal to the one before
    run: int  # length of the longest run of equal samples, its end in its file, s, and its value
    run_stop: float
    run_value: float
    step: float  # smallest step from one value to another: the resolution, if that is coarser than the noise
    extreme_run: int  # length of the longest run of equal samples at the minimum or maximum, and its end, s
    extreme_stop: float

    @staticmethod
    def of(row: list[float]) -> ChannelState:
        """Return the state from a row of the numbers that `block_sums` updates."""
        samples, minimum, maximum, repeats, _, _, run, run_stop, run_value, *extreme, step = row
        extreme_run, extreme_stop = max(extreme[2:], extreme[:2], key=lambda length_and_end: length_and_end[0])
        return ChannelState(
            samples=int(samples), minimum=minimum, maximum=maximum, repeats=int(repeats), run=int(run),
            run_stop=run_stop, run_value=run_value, step=step, extreme_run=int(extreme_run), extreme_stop=extreme_stop,
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ChannelSeries:
    """The n channels of one kind over the K blocks of a file (n = 0 if there are none).

    `means`, `ends`: means of the blocks (K, n), and their last samples (K, n), which show the resolution. `weights`:
    weights of the blocks in a mean (K,). `tail_total`, `tail_weight`: weighted sum (n,) and weight of the samples
    after the last whole block."""

    means: Array
    ends: Array
    weights: Array
    tail_total: Array
    tail_weight: float

    def mean(self, first: int, last: int) -> Array:
        """Return the mean (n,) over blocks first … last − 1, including the tail if they end the file."""
        total, weight = self.weights[first:last] @ self.means[first:last], self.weights[first:last].sum()
        if last == len(self.means):
            total, weight = total + self.tail_total, weight + self.tail_weight
        return np.asarray(total / weight)


def extremes(channels: tuple[ChannelState, ...]) -> Array:
    """Return the smallest and the largest readings (2, n) of channels, SI."""
    return np.array([[channel.minimum for channel in channels], [channel.maximum for channel in channels]])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FileBlocks:
    """The K blocks of one file.

    `file`, `first_sample`: its number, and the index of its first sample among the stored ones. `size`: samples of a
    block. `edges`: edges of the blocks (K + 1,), s. `accel`, `gyro`, `magnetometer`: the channels, SI, or in the unit
    of the magnetometer. `temperature`: temperatures at the ends of the blocks (K, T), K, None without thermometers."""

    file: int
    first_sample: int
    size: int
    edges: Array
    accel: ChannelSeries
    gyro: ChannelSeries
    magnetometer: ChannelSeries
    temperature: Array | None

    def __len__(self) -> int:
        return len(self.edges) - 1

    def sample_at(self, block: int) -> int:
        """Return the index of the first sample of a block among the stored ones."""
        return self.first_sample + self.size * block


@dataclass(frozen=True, kw_only=True, slots=True)
class Blemish:
    """Blocks first … last − 1 of a file, beginning at `start`, s, with their number of bad `samples`."""

    file: int
    first: int
    last: int
    start: float
    samples: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Reduction:
    """A log, or the part of it that has been read, reduced to blocks.

    `samples`: the samples for the turns, None without gyros. `lost`: lost samples by long intervals, without those that
    were bridged on reading. `repeated_rows`: rows in which all accelerometers and gyros repeat the row before, `runs`:
    their runs of SHORTEST_HELD_RUN rows and more, as gaps. `gaps`: gaps of the log. `blemishes`: blocks with bad
    samples, which have no weight. `tuning`: thresholds of the search for rests and bad samples. `clock_rate`: true
    seconds per second of the log's clock. Times are by this clock, intervals of samples in true seconds."""

    rate: float
    files: tuple[FileBlocks, ...]
    accel_channels: tuple[ChannelState, ...]
    gyro_channels: tuple[ChannelState, ...]
    samples: MotionSamples | None
    magnetometer_channels: tuple[ChannelState, ...]
    lost: int
    repeated_rows: int
    runs: tuple[Gap, ...] = ()
    gaps: tuple[Gap, ...] = ()
    blemishes: tuple[Blemish, ...] = ()
    tuning: Tuning = USUAL
    clock_rate: float = 1.0

    @property
    def by_file(self) -> dict[int, FileBlocks]:
        """The blocks of each file by its number."""
        return {f.file: f for f in self.files}

    @property
    def block_seconds(self) -> float:
        """Duration of a block, s."""
        return self.files[0].size / self.rate

    @property
    def held(self) -> int:
        """Number of repeated rows, if they are more than coarse channels have by chance, else 0.

        Rows are held if hardly any channel repeats without all the others, or if channels that repeat independently in
        a `held_share` of the log would rarely do so together."""
        samples, rows = self.accel_channels[0].samples, self.repeated_rows
        fewest = min(channel.repeats for channel in self.accel_channels + self.gyro_channels)
        together = rows >= HELD_TOGETHER * fewest and fewest <= FREQUENT_REPEATS * samples
        return rows if together or rows > 3.0 * self._runs_by_chance(1) + 3.0 else 0

    @property
    def held_runs(self) -> tuple[Gap, ...]:
        """Runs of repeated rows that independent channels hardly have by chance, as gaps.

        None if many rows repeat: then rounding hides the noise of a device at rest, or each sample is logged often."""
        if self.repeated_rows > MOST_HELD * self.accel_channels[0].samples:
            return ()
        return tuple(gap for gap in self.runs if self._runs_by_chance(gap.samples) < HELD_BY_CHANCE)

    def _runs_by_chance(self, length: int) -> float:
        """Return the expected number of runs of rows that repeat, at rest, if channels repeat independently."""
        at_rest = self.tuning.held_share * self.accel_channels[0].samples
        channels = self.accel_channels + self.gyro_channels
        shares = [min(1.0, channel.repeats / max(at_rest, 1.0)) for channel in channels]
        return float(at_rest * np.prod(shares) ** length)


class _RepeatedRows:
    """Rows in which all accelerometers and gyros repeat the row before: their number, and their runs as gaps."""

    def __init__(self) -> None:
        self.count, self.runs = 0, list[Gap]()
        self.begin_file()

    def begin_file(self) -> None:
        """Begin a file: its first row repeats none."""
        self.last: tuple[Array, ...] = ()  # readings of the last row
        self.length, self.since = 0, 0.0  # rows of the run under way, and its start, s

    def feed(self, chunk: Chunk, readings: tuple[Array, ...]) -> None:
        """Add the rows of a chunk, with the `readings` (m, n) of accelerometers and gyros."""
        rows = np.flatnonzero(chunk.accel[1:, 0] == chunk.accel[:-1, 0])
        for values in readings:
            rows = rows[(values[rows + 1] == values[rows]).all(axis=1)]
        repeats = np.zeros(len(chunk.time), dtype=bool)
        repeats[rows + 1] = True
        if self.last:
            repeats[0] = all(np.array_equal(v[0], last) for v, last in zip(readings, self.last, strict=True))
        self.last = tuple(values[-1].copy() for values in readings)
        self.count += int(np.count_nonzero(repeats))
        self._add_runs(chunk, repeats)

    def _add_runs(self, chunk: Chunk, repeats: BoolArray) -> None:
        """Add the runs of repeated rows of a chunk; one at its end is under way in the next chunk."""
        before, since = self.length, self.since  # the rows of a run under way have negative numbers here
        edges = np.flatnonzero(np.diff(repeats, prepend=before > 0, append=False))
        runs = np.concatenate([[-before] * (before > 0), edges]).astype(int).reshape(-1, 2)
        self.length = 0
        for start, stop in runs[(runs[:, 1] - runs[:, 0] >= SHORTEST_HELD_RUN) | (runs[:, 1] == len(repeats))].tolist():
            length, time = stop - start, since if start < 0 else float(chunk.time[start])
            if stop == len(repeats):
                self.length, self.since = length, time
            elif len(self.runs) < MOST_RUNS:
                why = f"{length} of its samples repeat the one before, as held in place of lost ones"
                gap = Gap(file=chunk.file, row=0, time=time, samples=length, what="held samples", why=why)
                self.runs.append(replace(gap, stop=float(chunk.time[stop]), integrable=False))


class _Channels:
    """Running block sums and channel states of the n sensors of one kind.

    Samples that came as increments have the weight of their intervals in a mean, samples that came as rates equal
    weights, whatever their time stamps."""

    def __init__(self, sensors: int, size: int, *, increments: bool) -> None:
        self.size, self.increments = size, increments
        self.state = _kernels.new_channel_state(sensors)
        self.begin_file()

    def begin_file(self) -> None:
        self.sums, self.filled = np.zeros(len(self.state)), np.zeros(1, dtype=np.int64)

    def feed(self, samples: Array | None, chunk: Chunk, ends: IntArray, seconds: Array) -> tuple[Array, Array, Array]:
        """Add samples (m, n), of which those at `ends` (k,) complete blocks of `seconds` (k,). Return the means of
        these blocks (k, n), their last samples (k, n), and their weights (k, 1)."""
        values = samples if len(self.state) and samples is not None else np.empty((len(chunk.dt), 0))
        weight = chunk.dt if self.increments else np.broadcast_to(1.0, len(chunk.dt))
        out = np.empty((len(ends), len(self.sums)))
        _kernels.block_sums(values, chunk.time, weight, self.size, self.sums, self.filled, self.state, out)
        weights = seconds[:, None] if self.increments else np.full((len(ends), 1), float(self.size))
        return out / weights, values[ends], weights

    def series(self, seconds: float, means: Array, ends: Array, weights: Array) -> ChannelSeries:
        """Return the channels over the blocks of the file; the tail after the last block covers `seconds`."""
        return ChannelSeries(
            means=means,
            ends=ends,
            weights=weights[:, 0],
            tail_total=self.sums.copy(),
            tail_weight=seconds if self.increments else float(self.filled[0]),
        )

    def states(self) -> tuple[ChannelState, ...]:
        """Return the states of the channels."""
        return tuple(map(ChannelState.of, self.state.tolist()))


class Reducer:
    """Incremental reduction of a log at a `rate`, Hz, to blocks; `now` returns the result so far.

    `increments`: by kind of sensor, whether a sample is an increment over its interval. `magnetometer`: whether there
    is one. `clock_rate`: seconds per second of the log's clock."""

    def __init__(
        self,
        *,
        rate: float,
        accel: Block,
        gyro: Block | None,
        increments: Mapping[str, bool] = MappingProxyType({}),
        magnetometer: bool = False,
        clock_rate: float = 1.0,
    ) -> None:
        self.rate, self.clock_rate = rate, clock_rate
        self.size = max(1, int(BLOCK_SECONDS * rate * (1.0 + 1e-9)))
        sensors = {"accel": accel.size, "gyro": gyro.size if gyro else 0, "magnetometer": 3 if magnetometer else 0}
        self._channels = {
            kind: _Channels(n, self.size, increments=increments.get(kind, False)) for kind, n in sensors.items()
        }
        is_array = gyro is not None and accel.size >= FEWEST_OF_ARRAY
        self._null_spaces = [left_null_space(block.axes) for block in (accel, gyro) if block is not None and is_array]
        self._to_body = [onto_body(block.axes).T for block in (accel, gyro) if block is not None]
        self._stored = MotionSamples(sum(map(len, self._null_spaces))) if gyro else None
        self._repeated, self._lost = _RepeatedRows(), 0
        self._files: list[FileBlocks] = []  # the complete ones
        # the present file: its number, its first sample among all, its samples so far, and the end of the last, s
        self._file, self._first, self._count, self._stop = -1, 0, 0, 0.0
        # the end of its last whole block, s, and the time after it that no sample covers, s
        self._edge, self._uncovered = 0.0, 0.0
        self._blocks, self._columns = list[Array](), np.zeros(0, dtype=np.int64)  # tables of blocks, and their parts

    def feed(self, chunk: Chunk) -> None:
        """Add the next samples of the log."""
        if chunk.file != self._file:
            self._begin_file(chunk)
        self._add_blocks(chunk)
        readings = (chunk.accel,) if chunk.gyro is None else (chunk.accel, chunk.gyro)
        if self._stored is not None and chunk.gyro is not None:
            # components of an array's readings that no force or rate explains
            spare = [v @ null_space.T for v, null_space in zip(readings, self._null_spaces, strict=False)]
            forces, rates = (v @ to_body for v, to_body in zip(readings, self._to_body, strict=True))
            self._stored.append(rates, forces, chunk.dt, np.hstack(spare) if spare else None)
        self._repeated.feed(chunk, readings)
        late = chunk.dt[chunk.dt > 1.5 / self.rate]
        self._lost += int(np.round(late * self.rate).sum()) - len(late)
        self._count += len(chunk.time)
        self._stop = float(chunk.time[-1])

    def _add_blocks(self, chunk: Chunk) -> None:
        """Add the samples of a chunk to the blocks, the last of which may remain incomplete."""
        uncovered = chunk.time - chunk.dt - np.append(self._stop, chunk.time[:-1])  # time before each sample, s
        uncovered[uncovered <= GAP_INTERVALS / self.rate] = 0.0
        block = (self._count % self.size + np.arange(len(uncovered))) // self.size
        ends = np.arange(self.size - 1 - self._count % self.size, len(chunk.time), self.size)
        uncovered = np.bincount(block, uncovered, minlength=len(ends) + 1)
        uncovered[0] += self._uncovered
        edges = np.append(self._edge, chunk.time[ends])
        seconds = self.clock_rate * np.diff(edges) - uncovered[: len(ends)]
        self._edge, self._uncovered = float(edges[-1]), float(uncovered[len(ends)])
        by_kind = [x.feed(getattr(chunk, kind), chunk, ends, seconds) for kind, x in self._channels.items()]
        kelvin = np.empty((len(ends), 0)) if chunk.temperature is None else chunk.temperature[ends]
        if len(ends):
            self._blocks.append(np.hstack([edges[1:, None], kelvin, *chain.from_iterable(by_kind)]))

    def _begin_file(self, chunk: Chunk) -> None:
        """Begin the file of a chunk. The first row of its table is that before the first block."""
        if self._file >= 0:
            self._files.append(self._file_so_far())
        for channels in self._channels.values():
            channels.begin_file()
        self._repeated.begin_file()
        self._file, self._first, self._count = chunk.file, self._first + self._count, 0
        self._edge = self._stop = float(chunk.time[0] - chunk.dt[0])
        self._uncovered, n_thermometers = 0.0, 0 if chunk.temperature is None else chunk.temperature.shape[1]
        sensors = [len(channels.state) for channels in self._channels.values()]
        widths = 1, n_thermometers, *(width for n in sensors for width in (n, n, 1))
        self._columns = np.cumsum(widths)
        self._blocks = [np.append(self._edge, np.zeros(self._columns[-1] - 1))[None]]

    def _file_so_far(self) -> FileBlocks:
        """Return the blocks of the present file so far."""
        if len(self._blocks) > 1:
            self._blocks = [np.concatenate(self._blocks)]
        edges, temperature, *blocks = np.split(self._blocks[0], self._columns[:-1], axis=1)
        tail_seconds = self.clock_rate * (self._stop - self._edge) - self._uncovered
        return FileBlocks(
            file=self._file,
            first_sample=self._first,
            size=self.size,
            edges=edges[:, 0],
            temperature=temperature[1:] if temperature.shape[1] else None,
            **{
                kind: channels.series(tail_seconds, *(x[1:] for x in blocks[3 * i : 3 * i + 3]))
                for i, (kind, channels) in enumerate(self._channels.items())
            },
        )

    def now(self) -> Reduction:
        """Return the reduction of the samples so far, identical to that of a log which ends here.

        More samples may be added. The blocks are copied once if there are new ones."""
        return Reduction(
            rate=self.rate,
            files=(*self._files, self._file_so_far()) if self._file >= 0 else (),
            accel_channels=self._channels["accel"].states(),
            gyro_channels=self._channels["gyro"].states(),
            samples=self._stored,
            magnetometer_channels=self._channels["magnetometer"].states(),
            lost=self._lost,
            repeated_rows=self._repeated.count,
            runs=tuple(self._repeated.runs),
            clock_rate=self.clock_rate,
        )


def reduce_log(
    log: Log, accel: Block, gyro: Block | None, chunks: Iterable[Chunk] | None = None, tuning: Tuning = USUAL
) -> Reduction:
    """Read a log once and reduce it; its samples are `chunks`, by default `log.chunks()`.

    `tuning` has the thresholds of the search for rests and bad samples. Raises LogError if gaps leave no block."""
    spec = log.session.log
    reducer = Reducer(
        rate=log.rate,
        accel=accel,
        gyro=gyro,
        increments=spec.increments,
        magnetometer=spec.magnetometer is not None,
        clock_rate=spec.clock_rate,
    )
    for chunk in one_ahead(iter(log.chunks() if chunks is None else chunks)):
        reducer.feed(chunk)
    reduction = reducer.now()
    if not any(len(file) for file in reduction.files):
        raise LogError(
            f"{log.name}: expected stretches of {BLOCK_SECONDS:g} s and longer without a gap, found none; record again"
        )
    reduction = replace(reduction, tuning=tuning)
    return replace(reduction, gaps=(*log.gaps, *reduction.held_runs))
