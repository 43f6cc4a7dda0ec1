"""The growing log of a session: its blocks, rests, and faults of its samples."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from tumble.bench.follow.faults import Fault, SampleWatch
from tumble.bench.follow.progress import Blocks, File, Judged, Progress, Rest, grouped
from tumble.bench.follow.task import Task
from tumble.bench.record.recorder import NEXT_SECONDS, recorded_files
from tumble.errors import LogError
from tumble.recording.live.lines import Lines
from tumble.recording.live.samples import StreamedSamples
from tumble.recording.log import HEAD_ROWS, Chunk
from tumble.recording.session import Exclusion
from tumble.reduction.blocks.reducer import Reducer, Reduction
from tumble.reduction.rest_stream import rests_so_far

PIECE_BYTES = 1 << 18
_PIECES = 32
_SEARCH_GROWTH = 2e-4  # relative growth of the log before the next search for rests: a tenth of a processor
_JUDGE_GROWTH = 0.01  # relative growth of a rest before it is judged again
_RECENT_BLOCKS = 50  # 5 s
_MAX_FAULTS = 64  # kept faults of samples; an unsteady source can cause one per second for hours


class Live:
    """Follows the log of a task by the same reduction to blocks as a calibration.

    `now` is the progress, None before the first block; `faults` are the latest faults of samples, of which `samples`
    were read and `lost` are missing. `at` bytes were read of the current one of the `files`, whose number may grow.
    `trouble` is the reason why the log cannot be followed, or empty."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._judged: dict[int, tuple[int, Judged]] = {}
        self._enough: list[tuple[int, int]] = []
        self.files = recorded_files(task.session.log)
        self._begin(StreamedSamples(task.session.log))

    def _begin(self, streamed: StreamedSamples) -> None:
        self.now: Progress | None = None
        self.faults: deque[Fault] = deque(maxlen=_MAX_FAULTS)
        self.samples = self.lost = 0
        self._reducer: Reducer | None = None
        self._watches: list[SampleWatch] = []
        self._gaps, self._number = 0, -1
        self._ended: Progress | None = None  # at the end of the file before, until the restart is reported
        self._begin_file(streamed)

    def _begin_file(self, streamed: StreamedSamples) -> None:
        """Begin with the next file of the log."""
        spec = self._task.session.log
        self.at, self._number, self._streamed = 0, self._number + 1, streamed
        self.trouble, self._unreadable = "", False
        self._lines = Lines(columns=spec.columns, clock=spec.time, refuse=lambda _: None)  # counted by the recorder
        self._latest, self._shift = -math.inf, 0.0 if self.now is None else math.nan
        self._searched: tuple[int, tuple[Exclusion, ...]] = 0, ()

    @property
    def interval(self) -> float | None:
        """Sampling interval, s; None before it is known."""
        return self._streamed.interval

    def read(self, excluded: tuple[Exclusion, ...]) -> None:
        """Read new data, and find the rests without the exclusions.

        A calibration takes the sampling interval from the first HEAD_ROWS rows. The interval of fewer rows may differ
        by rounding, and with it the blocks; so the log is read again once there are as many."""
        try:
            for _ in range(_PIECES):
                if self._unreadable or not self._read_piece():
                    if self._number == len(self.files) - 1:
                        break
                    self._update(excluded)
                    self._ended = self.now  # after a restart of the clock
                    streamed = StreamedSamples(self._task.session.log, interval=self.interval, file=self._number + 1)
                    streamed.gaps = self._streamed.gaps
                    self._begin_file(streamed)
                elif self._number == 0 and self._streamed.head < HEAD_ROWS <= self.samples:
                    self._begin(StreamedSamples(self._task.session.log, head=HEAD_ROWS))
        except LogError as error:
            self._unreadable = True
            self.trouble = f"the log cannot be followed any further, what is received is recorded: {error}"
        self._update(excluded)

    def _update(self, excluded: tuple[Exclusion, ...]) -> None:
        """Update the progress by the samples so far."""
        if self._reducer is not None:
            reduction = replace(self._reducer.now(), gaps=tuple(self._streamed.gaps))
            if reduction.files and len(reduction.files[-1]):
                self.now = self._progress(reduction, excluded)
                self._report_restart(self.now)

    def _report_restart(self, progress: Progress) -> None:
        """Report a restart of the clock as a fault, once there are data in the next file.

        A rest of a programme ends there: it is kept if it was long enough, and else begins anew. If the next file is
        already long, the operator settled this before the page was opened."""
        file = progress.blocks.files[-1]
        if self._ended is None or file.number < self._number:
            return
        before, self._ended = self._ended, None
        current = before.current
        text = (
            f"the sensor's clock starts anew after {before.now:.0f} s, as when it is unplugged or reset; the recording "
            f"goes on in {self.files[self._number].name}"
        )
        fault = Fault(kind="gap", said=text, start=before.now, stop=before.now)
        if (
            current is not None
            and self._task.programme is not None
            and len(progress.blocks) - file.first < _RECENT_BLOCKS
        ):
            enough = before.judged[-1].enough
            start, choices = (fault.start, ("keep_first",)) if enough else (current.start, ("again",))
            fault = replace(fault, kind="restart", start=start, choices=choices)
        self.faults.append(fault)

    def _read_piece(self) -> bool:
        """Read the next lines of the log, and return True if there were any rows."""
        with self.files[self._number].open("rb") as file:
            file.seek(self.at)
            data = file.read(PIECE_BYTES)
        data = data[: data.rfind(b"\n") + 1]
        self.at += len(data)
        rows = self._lines.numbers(data)
        if not len(rows):
            return False
        chunk = self._streamed.feed(rows)
        if chunk is not None and self._streamed.interval is not None:
            self._take(chunk, self._streamed.interval)
        spec = self._task.session.log
        if spec.time is not None:  # which may go back in the log of another program; no samples are taken meanwhile
            behind = self._latest - float(rows[-1, spec.columns.index(spec.time)]) * spec.time_factor
            self.trouble = (
                f"the clock has gone back by {behind:.0f} s, and the page waits for it: such a log cannot be "
                f"calibrated, but --listen file:{self.files[-1].name} into another folder records a file for each clock"
                if behind > NEXT_SECONDS
                else ""
            )
        return True

    def _take(self, chunk: Chunk, interval: float) -> None:
        """Search samples for faults, and feed them to the reduction."""
        session, log = self._task.session, self._task.session.log
        if self._reducer is None:
            self._reducer = Reducer(
                rate=1.0 / interval,
                accel=session.accel_block,
                gyro=session.gyro_block,
                increments=log.increments,
            )
            kinds = [log.accel] if log.gyro is None else [log.accel, log.gyro]
            self._watches = [SampleWatch(channels.columns, channels.range, interval) for channels in kinds]
        if math.isnan(self._shift) and self.now is not None:
            self._shift = self.now.now - float(chunk.time[0] - chunk.dt[0])
        for watch, readings in zip(self._watches, (chunk.accel, chunk.gyro), strict=False):
            if readings is not None:
                self.faults += watch.look(chunk.time + self._shift, readings)
        self._reducer.feed(chunk)
        self.samples += len(chunk.time)
        self._latest = float(chunk.time[-1])
        for gap in self._streamed.gaps[self._gaps :]:
            self.lost += gap.samples
            if not gap.integrable:
                start, stop = gap.time - interval + self._shift, gap.stop + self._shift
                text = f"gap of {stop - start:.1f} s at {start:.1f} s: {gap.samples} samples did not arrive"
                self.faults.append(Fault(kind="gap", said=text, start=start, stop=stop))
        self._gaps = len(self._streamed.gaps)

    def _progress(self, reduction: Reduction, excluded: tuple[Exclusion, ...]) -> Progress:
        """Return the progress of the session.

        Rests are searched for after a new exclusion, and when the log has grown enough or has stopped growing; between
        searches the current rest is extended."""
        session, before = self._task.session, self.now
        blocks = Blocks.of(reduction, session)
        so_far = None if before is None else before.so_far
        searched, searched_excluded = self._searched
        growth = len(blocks) - searched
        has_ended = before is not None and len(blocks) == len(before.blocks) and growth > 0
        if searched_excluded != excluded or has_ended or growth > _SEARCH_GROWTH * len(blocks):
            so_far = rests_so_far(reduction, session.accel_block, session.gyro_block, excluded)
            self._searched = len(blocks), excluded
        first_blocks = {file.number: file.first for file in blocks.files}
        spans = () if so_far is None else so_far.rests
        rests = [Rest.of(blocks, *(first_blocks[s.file] + block for block in (s.first, s.last))) for s in spans]
        if so_far is not None and so_far.lasting:
            rests[-1] = Rest.of(blocks, rests[-1].first, len(blocks))
        groups = grouped(blocks, rests)
        return Progress(
            reduction=reduction,
            blocks=blocks,
            so_far=so_far,
            groups=groups,
            judged=tuple(
                self._judge(reduction, blocks.file_of(rest.first), rest) for rest in (groups[-1][-2:] if groups else ())
            ),
        )

    def _judge(self, reduction: Reduction, file: File, rest: Rest) -> Judged:
        """Judge a rest; the current one again every half second, later after growth by one per cent.

        A rest that was long enough remains so: its u is uncertain by some per cent and could cross the wanted u
        repeatedly."""
        last, judged = self._judged.get(rest.first, (0, None))
        if judged is None or not 0 <= rest.last - last < max(5.0, _JUDGE_GROWTH * (rest.last - rest.first)):
            judged = Judged.of(reduction, file, rest, self._task.wanted)
            if judged.enough:
                self._enough.append((rest.first, rest.last))
            elif any(first < rest.last and rest.first < last for first, last in self._enough):
                judged = replace(judged, enough=True)
            self._judged[rest.first] = rest.last, judged
        return judged
