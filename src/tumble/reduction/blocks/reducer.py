"""A log reduced to blocks: the means of 0.1 s or less, the state of each channel, and the samples for the turns.

The log is fed chunk by chunk to a `Reducer`. A block is defined by the sample number in its file, so chunks of any size
give the same blocks.
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
from tumble.sensors.model import Block, beyond_body
from tumble.units import Array, IntArray

BLOCK_SECONDS = 0.1
UNRECORDED = 2.0
"""Samples: what is left between two samples beyond their interval is a gap, not jitter."""


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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ChannelSeries:
    """The channels of one kind over the K blocks of a file: their `means` (K, n), the last sample of each block, which
    shows their resolution, `ends` (K, n), and the `weights` (K,) of the blocks in a mean; of the samples after the last
    whole block the weighted total (n,) and the weight. n is 0 where there are none."""

    means: Array
    ends: Array
    weights: Array
    tail_total: Array
    tail_weight: float

    def mean(self, first: int, last: int) -> Array:
        """Mean (n,) over blocks first … last − 1, and over the tail where they end the file."""
        total, weight = self.weights[first:last] @ self.means[first:last], self.weights[first:last].sum()
        if last == len(self.means):
            total, weight = total + self.tail_total, weight + self.tail_weight
        return np.asarray(total / weight)


def extremes(channels: tuple[ChannelState, ...]) -> Array:
    """The least and the most (2, n) that channels read, SI."""
    return np.array([[channel.minimum for channel in channels], [channel.maximum for channel in channels]])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FileBlocks:
    """The K blocks of one file, of `size` samples each: their `edges` (K + 1) in s, the accelerometers and gyros in SI,
    the magnetometer in its unit, and the temperatures (K, T), K, with which the blocks end."""

    file: int
    first_sample: int
    """Position of the file's first sample among the stored increments."""
    size: int
    edges: Array
    accel: ChannelSeries
    gyro: ChannelSeries
    magnetometer: ChannelSeries
    temperature: Array | None

    def __len__(self) -> int:
        return len(self.edges) - 1

    def sample_at(self, block: int) -> int:
        """Position of a block's first sample among the stored increments."""
        return self.first_sample + self.size * block


@dataclass(frozen=True, kw_only=True, slots=True)
class Blemish:
    """Blocks first … last − 1 of a file, from `start` (s) on, with so many bad samples."""

    file: int
    first: int
    last: int
    start: float
    samples: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Reduction:
    """A log, or what there is of it so far, reduced to blocks."""

    rate: float
    files: tuple[FileBlocks, ...]
    accel_channels: tuple[ChannelState, ...]
    gyro_channels: tuple[ChannelState, ...]
    samples: MotionSamples | None
    magnetometer_channels: tuple[ChannelState, ...]
    lost: int
    """Samples that long intervals leave room for; those that were bridged when the log was read are not among them."""
    repeated_rows: int
    """Rows whose accelerometers and gyros all read what they read in the row before."""
    gaps: tuple[Gap, ...] = ()
    """Lost samples of the log, as it was read."""
    blemishes: tuple[Blemish, ...] = ()
    """Blocks with bad samples, which have no weight."""
    tuning: Tuning = USUAL
    """By which rests and bad samples are told from movement."""
    clock_rate: float = 1.0
    """Seconds in a second of the log's clock, which times are of; intervals of samples are in seconds."""

    @property
    def by_file(self) -> dict[int, FileBlocks]:
        """The blocks of each file by its number."""
        return {each.file: each for each in self.files}

    @property
    def block_seconds(self) -> float:
        """Duration of a block, s."""
        return self.files[0].size / self.rate

    @property
    def held(self) -> int:
        """Samples that are copies of the one before: the repeated rows, where they are more than chance makes of
        channels of coarse resolution, else 0.

        They are if hardly any channel repeats without all the others, or if channels that repeat independently in a
        `held_share` of the log would seldom do so together."""
        channels = self.accel_channels + self.gyro_channels
        samples, fewest = channels[0].samples, min(channel.repeats for channel in channels)
        share = self.tuning.held_share * samples
        chance = share * float(np.prod([min(1.0, channel.repeats / max(share, 1.0)) for channel in channels]))
        together = self.repeated_rows >= 0.8 * fewest and fewest <= 0.7 * samples
        return self.repeated_rows if together or self.repeated_rows > 3.0 * chance + 3.0 else 0


class _Growing:
    """Rows that are added to an array; the views that were given out stay as they are."""

    def __init__(self, width: int) -> None:
        self._values = np.empty((256, width))
        self._count = 0

    def add(self, rows: Array) -> None:
        """Add rows (m, width)."""
        stop = self._count + len(rows)
        if stop > len(self._values):
            larger = np.empty((max(stop, 2 * len(self._values)), self._values.shape[1]))
            larger[: self._count] = self._values[: self._count]
            self._values = larger
        self._values[self._count : stop] = rows
        self._count = stop

    def forget(self, count: int) -> None:
        """Drop the first `count` rows; the views that were given out stay as they are."""
        self._values = self._values[count:].copy()
        self._count -= count

    @property
    def rows(self) -> Array:
        """All rows so far."""
        return self._values[: self._count]


class _Channels:
    """Running block sums and channel states of one kind of sensor. Samples that came as increments have the weight of
    their intervals in a mean, samples that came as rates one and the same weight, whatever their time stamps."""

    def __init__(self, sensors: int, size: int, *, increments: bool) -> None:
        self.size, self.increments = size, increments
        self.state = _kernels.new_channel_state(sensors)
        self.begin_file()

    def begin_file(self) -> None:
        """Blocks begin with the next sample."""
        self.sums, self.filled = np.zeros(len(self.state)), np.zeros(1, dtype=np.int64)
        self.means, self.weights, self.ends = _Growing(len(self.state)), _Growing(1), _Growing(len(self.state))

    def feed(self, samples: Array | None, time: Array, dt: Array, ends: IntArray, seconds: Array) -> None:
        """Add samples, of which `ends` (k,) are the last of their blocks, which take `seconds` (k,)."""
        values = samples if len(self.state) and samples is not None else np.empty((len(dt), 0))
        weight = dt if self.increments else np.ones(len(dt))
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
        """What there is of the file; what is left after the last block takes so many `seconds`."""
        return ChannelSeries(
            means=self.means.rows,
            ends=self.ends.rows,
            weights=self.weights.rows[:, 0],
            tail_total=self.sums.copy(),
            tail_weight=seconds if self.increments else float(self.filled[0]),
        )

    def states(self) -> tuple[ChannelState, ...]:
        """What the samples of each channel say, of the numbers that `block_sums` keeps."""
        out = []
        for row in self.state.tolist():
            samples, minimum, maximum, repeats, _, _, run, run_stop, run_value, *extremes, step = row
            extreme_run, extreme_stop = max(extremes[2:], extremes[:2], key=lambda extreme: extreme[0])
            out.append(
                ChannelState(
                    samples=int(samples), minimum=minimum, maximum=maximum, repeats=int(repeats), run=int(run),
                    run_stop=run_stop, run_value=run_value, step=step, extreme_run=int(extreme_run),
                    extreme_stop=extreme_stop,
                )
            )  # fmt: skip
        return tuple(out)


class Reducer:
    """Takes a log chunk by chunk and keeps what segmentation and reduction need. It can be asked at any moment what it
    has (`now`), and goes on as if nobody had asked."""

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
        """`increments`: whether the readings of a kind of sensor came as increments per sample; `magnetometer`:
        whether there is one; `clock_rate`: seconds in a second of the log's clock."""
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
        self._unrecorded: dict[int, float] = {}
        self._beyond = (beyond_body(accel.axes), beyond_body(gyro.axes)) if gyro and accel.size >= FEWEST else None
        self._stored = MotionSamples(0 if self._beyond is None else sum(map(len, self._beyond))) if gyro else None
        self._lost = self._repeated = 0
        self._last: tuple[Array, ...] = ()

    def feed(self, chunk: Chunk) -> None:
        """Add the next samples of the log."""
        if chunk.file != self._file:
            if self._file >= 0:
                self._files.append(self._blocks())
            for channels in self._channels.values():
                channels.begin_file()
            self._file, self._first, self._count = chunk.file, self._first + self._count, 0
            self._edges, self._last, self._unrecorded = _Growing(1), (), {}
            self._temperature = _Growing(1 if chunk.temperature is None else chunk.temperature.shape[1])
            self._edges.add(np.array([[chunk.time[0] - chunk.dt[0]]]))
        # blocks in which time passed between two samples that no sample covers, and how much, s
        left = chunk.time - chunk.dt
        left[0] -= self._stop if self._count else float(chunk.time[0] - chunk.dt[0])
        left[1:] -= chunk.time[:-1]
        for i in np.flatnonzero(left > UNRECORDED / self.rate).tolist():
            block = (self._count + i) // self.size
            self._unrecorded[block] = self._unrecorded.get(block, 0.0) + float(left[i])
        ends = np.arange(self.size - 1 - self._count % self.size, len(chunk.time), self.size)
        before = len(self._edges.rows)
        self._edges.add(chunk.time[ends, None])
        seconds = self._covered(before - 1, self._edges.rows[before - 1 :, 0])
        for kind, channels in self._channels.items():
            channels.feed(getattr(chunk, kind), chunk.time, chunk.dt, ends, seconds)
        if self._stored is not None and self.gyro is not None and chunk.gyro is not None:
            spare = None
            if self._beyond is not None:  # of an array, what it reads beyond force and rate
                spare = np.hstack([v @ to.T for v, to in zip((chunk.accel, chunk.gyro), self._beyond, strict=True)])
            rates, forces = _in_body(self.gyro, chunk.gyro), _in_body(self.accel, chunk.accel)
            self._stored.append(rates, forces, chunk.dt, spare)
        if chunk.temperature is not None:
            self._temperature.add(chunk.temperature[ends])
        # rows that are equal to the ones before; the first of a file has none before it
        readings = (chunk.accel,) if chunk.gyro is None else (chunk.accel, chunk.gyro)
        if self._last:
            self._repeated += all(np.array_equal(v[0], last) for v, last in zip(readings, self._last, strict=True))
        rows = np.flatnonzero(chunk.accel[1:, 0] == chunk.accel[:-1, 0])
        for values in readings:
            rows = rows[(values[rows + 1] == values[rows]).all(axis=1)]
        self._repeated += len(rows)
        self._last = tuple(values[-1].copy() for values in readings)
        late = chunk.dt[chunk.dt > 1.5 / self.rate]
        self._lost += int(np.round(late * self.rate).sum()) - len(late)
        self._count += len(chunk.time)
        self._stop = float(chunk.time[-1])

    def _covered(self, first: int, edges: Array) -> Array:
        """The time (k,), s, that the samples of blocks with these edges (k + 1,) cover, from block `first` on."""
        seconds = self.clock_rate * np.diff(edges)
        for block, left in self._unrecorded.items():
            if first <= block < first + len(seconds):
                seconds[block - first] -= left
        return seconds

    def _blocks(self) -> FileBlocks:
        """The blocks of the present file so far."""
        edges = self._edges.rows[:, 0]
        left = float(self._covered(len(edges) - 1, np.append(edges[-1:], self._stop))[0])
        return FileBlocks(
            file=self._file,
            first_sample=self._first,
            size=self.size,
            edges=edges,
            temperature=self._temperature.rows if len(self._temperature.rows) else None,
            **{kind: channels.series(left) for kind, channels in self._channels.items()},
        )

    def forget(self, blocks: int) -> None:
        """Drop the first blocks of the present file, their samples, and all files before it.

        The other blocks stay as they are, and so do the states of the channels, which are those of all samples.
        Reductions that were given out keep what they have.

        Parameters
        ----------
        blocks
            How many blocks of the present file to drop, at most those that there are.
        """
        samples = blocks * self.size
        for channels in self._channels.values():
            channels.forget(blocks)
        self._edges.forget(blocks)
        if len(self._temperature.rows):
            self._temperature.forget(blocks)
        self._unrecorded = {b - blocks: seconds for b, seconds in self._unrecorded.items() if b >= blocks}
        if self._stored is not None:
            self._stored = self._stored.since(self._first + samples)
        self._files, self._first, self._count = [], 0, self._count - samples

    def now(self) -> Reduction:
        """The reduction of what was fed so far, to the bit that of a log which ends here. No block is copied; more may
        be fed afterwards."""
        return Reduction(
            rate=self.rate,
            files=(*self._files, self._blocks()) if self._file >= 0 else (),
            accel_channels=self._channels["accel"].states(),
            gyro_channels=self._channels["gyro"].states(),
            samples=self._stored,
            magnetometer_channels=self._channels["magnetometer"].states(),
            lost=self._lost,
            repeated_rows=self._repeated,
            clock_rate=self.clock_rate,
        )


def _in_body(block: Block, readings: Array) -> Array:
    """Readings (m, n) of a block as vectors (m, 3) in the body; themselves where its sensors are along its axes."""
    to_body = np.asarray(onto_body(block.axes).T, dtype=float)
    return readings if np.array_equal(to_body, np.eye(3)) else readings @ to_body


def reduce_log(
    log: Log, accel: Block, gyro: Block | None, chunks: Iterable[Chunk] | None = None, tuning: Tuning = USUAL
) -> Reduction:
    """Read a log once and reduce it; `chunks` stands in for `log.chunks()`, e.g. to show progress, and
    what follows goes by the `tuning`. Raises LogError where gaps leave nothing of it."""
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
    return replace(reduction, gaps=log.gaps, tuning=tuning)
