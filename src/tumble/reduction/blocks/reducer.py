"""A log reduced to blocks: means over at most 0.1 s, the state of each channel, and the samples for the turns.

A log is fed chunk by chunk to a `Reducer`. Blocks are counted in samples from the beginning of a file, so that chunks
of any size give the same blocks.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from tumble.errors import LogError
from tumble.recording.log import Chunk, Log
from tumble.recording.log_source import one_ahead
from tumble.recording.rows.gaps import Gap
from tumble.reduction import kernels as _kernels
from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.reduction.blocks.tuning import USUAL, Tuning
from tumble.reduction.turns.array_motion import FEWEST
from tumble.rotation import onto_body
from tumble.sensors.model import Block, left_null_space
from tumble.units import Array, BoolArray, IntArray

BLOCK_SECONDS = 0.1
SHORTEST_HELD_RUN = 6  # repeated rows in a run that cost a turn; fewer lost samples are bridged
MOST_HELD = 0.05  # fraction of the rows of a log up to which those that repeat can be held
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
        channels = self.accel_channels + self.gyro_channels
        samples, fewest = channels[0].samples, min(channel.repeats for channel in channels)
        share, chance = self._repeats_by_chance
        together = self.repeated_rows >= 0.8 * fewest and fewest <= 0.7 * samples
        return self.repeated_rows if together or self.repeated_rows > 3.0 * share * chance + 3.0 else 0

    @property
    def held_runs(self) -> tuple[Gap, ...]:
        """Runs of repeated rows that independent channels hardly have by chance, as gaps.

        None if many rows repeat: then rounding hides the noise of a device at rest, or each sample is logged often."""
        if self.repeated_rows > MOST_HELD * self.accel_channels[0].samples:
            return ()
        share, chance = self._repeats_by_chance
        return tuple(gap for gap in self.runs if share * chance**gap.samples < HELD_BY_CHANCE)

    @property
    def _repeats_by_chance(self) -> tuple[float, float]:
        """Number of samples at rest, a `held_share` of the log, and probability that all channels repeat in one."""
        channels = self.accel_channels + self.gyro_channels
        share = self.tuning.held_share * channels[0].samples
        return share, float(np.prod([min(1.0, channel.repeats / max(share, 1.0)) for channel in channels]))


class _Growing:
    """An array to which rows are added; views that were given out stay as they are."""

    def __init__(self, width: int) -> None:
        self._values = np.empty((256, width))
        self._count = 0

    def add(self, rows: Array) -> None:
        stop = self._count + len(rows)
        if stop > len(self._values):
            larger = np.empty((max(stop, 2 * len(self._values)), self._values.shape[1]))
            larger[: self._count] = self._values[: self._count]
            self._values = larger
        self._values[self._count : stop] = rows
        self._count = stop

    def forget(self, count: int) -> None:
        """Drop the first `count` rows."""
        self._values = self._values[count:].copy()
        self._count -= count

    @property
    def rows(self) -> Array:
        return self._values[: self._count]


class _Channels:
    """Running block sums and channel states of one kind of sensor.

    Samples that came as increments have the weight of their intervals in a mean, samples that came as rates equal
    weights, whatever their time stamps."""

    def __init__(self, sensors: int, size: int, *, increments: bool) -> None:
        self.size, self.increments = size, increments
        self.state = _kernels.new_channel_state(sensors)
        self.begin_file()

    def begin_file(self) -> None:
        self.sums, self.filled = np.zeros(len(self.state)), np.zeros(1, dtype=np.int64)
        self.means, self.weights, self.ends = _Growing(len(self.state)), _Growing(1), _Growing(len(self.state))

    def feed(self, samples: Array | None, time: Array, dt: Array, ends: IntArray, seconds: Array) -> None:
        """Add samples (m, n), of which those at `ends` (k,) complete blocks of `seconds` (k,)."""
        values = samples if len(self.state) and samples is not None else np.empty((len(dt), 0))
        weight = dt if self.increments else np.broadcast_to(1.0, len(dt))
        out = np.empty((len(ends), len(self.sums)))
        _kernels.block_sums(values, time, weight, self.size, self.sums, self.filled, self.state, out)
        weights = seconds if self.increments else np.full(len(ends), float(self.size))
        self.means.add(out / weights[:, None])
        self.weights.add(weights[:, None])
        self.ends.add(values[ends])

    def forget(self, blocks: int) -> None:
        """Drop the first blocks of the file."""
        for rows in (self.means, self.weights, self.ends):
            rows.forget(blocks)

    def series(self, seconds: float) -> ChannelSeries:
        """Return the channels over the blocks of the file; the tail after the last block covers `seconds`."""
        return ChannelSeries(
            means=self.means.rows,
            ends=self.ends.rows,
            weights=self.weights.rows[:, 0],
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
        self.rate, self.accel, self.gyro, self.clock_rate = rate, accel, gyro, clock_rate
        self.size = max(1, int(BLOCK_SECONDS * rate * (1.0 + 1e-9)))
        self._channels = {
            "accel": _Channels(accel.size, self.size, increments=increments.get("accel", False)),
            "gyro": _Channels(gyro.size if gyro else 0, self.size, increments=increments.get("gyro", False)),
            "magnetometer": _Channels(3 if magnetometer else 0, self.size, increments=False),
        }
        self._files: list[FileBlocks] = []
        self._file, self._first, self._count, self._stop = -1, 0, 0, 0.0
        self._edges, self._temperature = _Growing(1), _Growing(1)
        self._uncovered: dict[int, float] = {}
        is_array = gyro is not None and accel.size >= FEWEST
        self._null_spaces = (left_null_space(accel.axes), left_null_space(gyro.axes)) if gyro and is_array else None
        self._to_body = [_to_body(block) for block in (accel, gyro) if block is not None]
        n_spare = sum(map(len, self._null_spaces)) if self._null_spaces else 0
        self._stored = MotionSamples(n_spare) if gyro else None
        self._lost = self._repeated = 0
        self._last: tuple[Array, ...] = ()
        self._runs, self._run = list[Gap](), (0, 0.0)  # of repeated rows; the length and start, s, of the present one

    def feed(self, chunk: Chunk) -> None:
        """Add the next samples of the log."""
        if chunk.file != self._file:
            if self._file >= 0:
                self._files.append(self._blocks())
            for channels in self._channels.values():
                channels.begin_file()
            self._file, self._first, self._count = chunk.file, self._first + self._count, 0
            self._edges, self._last, self._uncovered, self._run = _Growing(1), (), {}, (0, 0.0)
            self._temperature = _Growing(1 if chunk.temperature is None else chunk.temperature.shape[1])
            self._edges.add(np.array([[chunk.time[0] - chunk.dt[0]]]))
        # the time, s, in each block that no sample covers
        uncovered = chunk.time - chunk.dt
        uncovered[0] -= self._stop if self._count else float(chunk.time[0] - chunk.dt[0])
        uncovered[1:] -= chunk.time[:-1]
        for i in np.flatnonzero(uncovered > GAP_INTERVALS / self.rate).tolist():
            block = (self._count + i) // self.size
            self._uncovered[block] = self._uncovered.get(block, 0.0) + float(uncovered[i])
        ends = np.arange(self.size - 1 - self._count % self.size, len(chunk.time), self.size)
        before = len(self._edges.rows)
        self._edges.add(chunk.time[ends, None])
        seconds = self._covered(before - 1, self._edges.rows[before - 1 :, 0])
        for kind, channels in self._channels.items():
            channels.feed(getattr(chunk, kind), chunk.time, chunk.dt, ends, seconds)
        if self._stored is not None and self.gyro is not None and chunk.gyro is not None:
            spare = None
            if self._null_spaces is not None:  # components of an array's readings that no force or rate explains
                pairs = zip((chunk.accel, chunk.gyro), self._null_spaces, strict=True)
                spare = np.hstack([v @ null_space.T for v, null_space in pairs])
            forces, rates = (
                v if to is None else v @ to for v, to in zip((chunk.accel, chunk.gyro), self._to_body, strict=True)
            )
            self._stored.append(rates, forces, chunk.dt, spare)
        if chunk.temperature is not None:
            self._temperature.add(chunk.temperature[ends])
        # rows that are equal to the row before; the first row of a file has none before it
        readings = (chunk.accel,) if chunk.gyro is None else (chunk.accel, chunk.gyro)
        repeats = np.zeros(len(chunk.time), dtype=bool)
        if self._last:
            repeats[0] = all(np.array_equal(v[0], last) for v, last in zip(readings, self._last, strict=True))
        rows = np.flatnonzero(chunk.accel[1:, 0] == chunk.accel[:-1, 0])
        for values in readings:
            rows = rows[(values[rows + 1] == values[rows]).all(axis=1)]
        repeats[rows + 1] = True
        self._repeated += int(np.count_nonzero(repeats))
        self._add_runs(chunk, repeats)
        self._last = tuple(values[-1].copy() for values in readings)
        late = chunk.dt[chunk.dt > 1.5 / self.rate]
        self._lost += int(np.round(late * self.rate).sum()) - len(late)
        self._count += len(chunk.time)
        self._stop = float(chunk.time[-1])

    def _add_runs(self, chunk: Chunk, repeats: BoolArray) -> None:
        """Add the runs of rows (m,) of a chunk that repeat the row before; one at its end may go on in the next."""
        begun, since = self._run  # the rows of a run that began in an earlier chunk have negative numbers here
        edges = np.flatnonzero(np.diff(repeats, prepend=begun > 0, append=False))
        runs = np.concatenate([[-begun] * (begun > 0), edges]).astype(int).reshape(-1, 2)
        self._run = 0, 0.0
        for start, stop in runs[(runs[:, 1] - runs[:, 0] >= SHORTEST_HELD_RUN) | (runs[:, 1] == len(repeats))].tolist():
            length, time = stop - start, since if start < 0 else float(chunk.time[start])
            if stop == len(repeats):
                self._run = length, time
            elif len(self._runs) < MOST_RUNS:
                why = f"{length} of its samples repeat the one before, as held in place of lost ones"
                gap = Gap(file=chunk.file, row=0, time=time, samples=length, what="held samples", why=why)
                self._runs.append(replace(gap, stop=float(chunk.time[stop]), integrable=False))

    def _covered(self, first: int, edges: Array) -> Array:
        """Return the time (k,), s, covered by samples in the blocks from `first` on with these edges (k + 1,)."""
        seconds = self.clock_rate * np.diff(edges)
        for block, uncovered in self._uncovered.items():
            if first <= block < first + len(seconds):
                seconds[block - first] -= uncovered
        return seconds

    def _blocks(self) -> FileBlocks:
        """Return the blocks of the present file so far."""
        edges = self._edges.rows[:, 0]
        tail_seconds = float(self._covered(len(edges) - 1, np.append(edges[-1:], self._stop))[0])
        return FileBlocks(
            file=self._file,
            first_sample=self._first,
            size=self.size,
            edges=edges,
            temperature=self._temperature.rows if len(self._temperature.rows) else None,
            **{kind: channels.series(tail_seconds) for kind, channels in self._channels.items()},
        )

    def forget(self, blocks: int) -> None:
        """Drop the first `blocks` blocks of the present file, their samples, and all files before it.

        The other blocks, the channel states, which are those of all samples, and reductions that were given out do not
        change."""
        samples = blocks * self.size
        for channels in self._channels.values():
            channels.forget(blocks)
        self._edges.forget(blocks)
        if len(self._temperature.rows):
            self._temperature.forget(blocks)
        self._uncovered = {b - blocks: seconds for b, seconds in self._uncovered.items() if b >= blocks}
        if self._stored is not None:
            self._stored = self._stored.since(self._first + samples)
        self._files, self._first, self._count = [], 0, self._count - samples

    def now(self) -> Reduction:
        """Return the reduction of the samples so far, identical to that of a log which ends here.

        No block is copied, and more samples may be added."""
        return Reduction(
            rate=self.rate,
            files=(*self._files, self._blocks()) if self._file >= 0 else (),
            accel_channels=self._channels["accel"].states(),
            gyro_channels=self._channels["gyro"].states(),
            samples=self._stored,
            magnetometer_channels=self._channels["magnetometer"].states(),
            lost=self._lost,
            repeated_rows=self._repeated,
            runs=tuple(self._runs),
            clock_rate=self.clock_rate,
        )


def _to_body(block: Block) -> Array | None:
    """Return the matrix (n, 3) that takes readings (m, n) to body vectors (m, 3), None if it is the identity."""
    to_body = np.asarray(onto_body(block.axes).T, dtype=float)
    return None if np.array_equal(to_body, np.eye(3)) else to_body


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
