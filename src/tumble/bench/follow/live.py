"""The log of a session as it grows: its blocks, the rests in them, and the faults of its samples."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from tumble.bench.follow.faults import Fault, SampleWatch
from tumble.bench.follow.progress import Blocks, File, Judged, Progress, Rest, grouped
from tumble.bench.follow.wishes import Task
from tumble.bench.record.recorder import NEXT_SECONDS, recorded_files
from tumble.errors import LogError
from tumble.recording.live.lines import Lines
from tumble.recording.live.samples import StreamedSamples
from tumble.recording.log import HEAD_ROWS, Chunk
from tumble.recording.session import Exclusion
from tumble.reduction.blocks.reducer import Reducer, Reduction
from tumble.reduction.rest_stream import rests_so_far
from tumble.units import Array

PIECE_BYTES = 1 << 18
_PIECES = 32
_SEARCH_GROWTH = 2e-4
"""Rests are searched for again when the log has grown by this part, which takes a tenth of a processor."""
_GROWN = 0.01
"""Part of its length by which a rest grows before it is judged again."""
_LATELY = 50
"""Blocks, 5 s."""
_MOST_FAULTS = 64
"""Faults of samples that are kept: nobody answers more, and a source that stutters for hours has one a second."""


class Live:
    """Follows the log of a task through the chain of a calibration.

    `now` is what the log says, None while there are no blocks; `faults` are the latest of the samples, of which
    `samples` were read and `lost` are missing between them. Of the `files` of the log, to which another may be added
    once the last has ended, `at` bytes of the present one were read. `trouble` says why the log cannot be followed; it
    is empty while it can."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._judged: dict[int, tuple[int, Judged]] = {}
        self._enough: list[tuple[int, int]] = []
        self.files = recorded_files(task.session.log)
        self._begin(StreamedSamples(task.session.log))

    def _begin(self, streamed: StreamedSamples) -> None:
        self.now: Progress | None = None
        self.faults: deque[Fault] = deque(maxlen=_MOST_FAULTS)
        self.samples = self.lost = 0
        self._reducer: Reducer | None = None
        self._watches: list[SampleWatch] = []
        self._gaps, self._number = 0, -1
        self._ended: Progress | None = None
        """Of the file before, where that the clock started anew is not reported yet."""
        self._begin_file(streamed)

    def _begin_file(self, streamed: StreamedSamples) -> None:
        """Go on with the next file of the log."""
        spec = self._task.session.log
        self.at, self._number, self._streamed = 0, self._number + 1, streamed
        self.trouble, self._unreadable = "", False
        self._lines = Lines(columns=spec.columns, clock=spec.time, refuse=lambda _: None)  # counted by who records it
        self._latest, self._shift = -math.inf, 0.0 if self.now is None else math.nan
        self._searched: tuple[int, tuple[Exclusion, ...]] = 0, ()

    @property
    def interval(self) -> float | None:
        """Time from sample to sample, s; None while too few have come to know it."""
        return self._streamed.interval

    def read(self, excluded: tuple[Exclusion, ...]) -> None:
        """Read what has come, and find the rests without the times that are left out.

        Once there are as many rows as a calibration takes the interval from, the log is read again with the interval of
        these: that of fewer may differ by rounding, and with it the blocks."""
        try:
            for _ in range(_PIECES):
                if self._unreadable or not self._read_piece():
                    if self._number == len(self.files) - 1:
                        break
                    self._go_on(excluded)
                elif self._number == 0 and self._streamed.head < HEAD_ROWS <= self.samples:
                    self._begin(StreamedSamples(self._task.session.log, head=HEAD_ROWS))
        except LogError as error:
            self._unreadable = True
            self.trouble = f"the log cannot be followed any further, what is received is recorded: {error}"
        self._look(excluded)

    def _look(self, excluded: tuple[Exclusion, ...]) -> None:
        """Find what the samples so far say."""
        if self._reducer is not None:
            reduction = replace(self._reducer.now(), gaps=tuple(self._streamed.gaps))
            if reduction.files and len(reduction.files[-1]):
                self.now = self._progress(reduction, excluded)
                self._report_restart(self.now)

    def _report_restart(self, progress: Progress) -> None:
        """Report that the clock started anew, once there is something of the next file.

        A rest of a programme that lasted ends there: it is kept if it was long enough, and begins anew otherwise. Where
        the log goes on for long already, this was settled before the page was opened."""
        file = progress.blocks.files[-1]
        if self._ended is None or file.number < self._number:
            return
        before, self._ended = self._ended, None
        current = before.current
        said = (
            f"the sensor's clock starts anew after {before.now:.0f} s, as when it is unplugged or reset; the recording "
            f"goes on in {self.files[self._number].name}"
        )
        fault = Fault(kind="gap", said=said, start=before.now, stop=before.now)
        if current is not None and self._task.programme is not None and len(progress.blocks) - file.first < _LATELY:
            enough = before.judged[-1].enough
            start, choices = (fault.start, ("keep_first",)) if enough else (current.start, ("again",))
            fault = replace(fault, kind="restart", start=start, choices=choices)
        self.faults.append(fault)

    def _go_on(self, excluded: tuple[Exclusion, ...]) -> None:
        """Go on with the next file, which was begun where the clock started anew."""
        self._look(excluded)
        self._ended = self.now
        streamed = StreamedSamples(self._task.session.log, interval=self.interval, file=self._number + 1)
        streamed.gaps = self._streamed.gaps
        self._begin_file(streamed)

    def _read_piece(self) -> bool:
        """Read the next lines of the log; whether there were any rows in them."""
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
        self._look_at_clock(rows)
        return True

    def _look_at_clock(self, rows: Array) -> None:
        """Say that the clock has gone back in a log of another program: until it is where it was, no sample is
        taken."""
        spec = self._task.session.log
        if spec.time is not None:
            behind = self._latest - float(rows[-1, spec.columns.index(spec.time)]) * spec.time_factor
            self.trouble = (
                f"the clock has gone back by {behind:.0f} s, and the page waits for it: such a log cannot be "
                f"calibrated, but --listen file:{self.files[-1].name} into another folder records a file for each clock"
                if behind > NEXT_SECONDS
                else ""
            )

    def _take(self, chunk: Chunk, interval: float) -> None:
        """Find the faults of samples, and feed them to the reduction."""
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
                said = f"gap of {stop - start:.1f} s at {start:.1f} s: {gap.samples} samples did not arrive"
                self.faults.append(Fault(kind="gap", said=said, start=start, stop=stop))
        self._gaps = len(self._streamed.gaps)

    def _progress(self, reduction: Reduction, excluded: tuple[Exclusion, ...]) -> Progress:
        """Progress of the session now.

        Rests are searched for when something is left out, and when the log has grown enough or grows no longer; between
        searches the rest that lasts goes on."""
        session, before = self._task.session, self.now
        blocks = Blocks.of(reduction, session)
        so_far = None if before is None else before.so_far
        searched, without = self._searched
        longer = len(blocks) - searched
        has_ended = before is not None and len(blocks) == len(before.blocks) and longer > 0
        if without != excluded or has_ended or longer > _SEARCH_GROWTH * len(blocks):
            so_far = rests_so_far(reduction, session.accel_block, session.gyro_block, excluded)
            self._searched = len(blocks), excluded
        before_file = {file.number: file.first for file in blocks.files}
        spans = () if so_far is None else so_far.rests
        rests = [Rest.of(blocks, *(before_file[s.file] + block for block in (s.first, s.last))) for s in spans]
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
        """Judge a rest; one that lasts again every half second, and later as it grows by a hundredth.

        A rest that was enough stays so: its uncertainty is known to some percent, and would cross the wanted one more
        than once."""
        last, judged = self._judged.get(rest.first, (0, None))
        if judged is None or not 0 <= rest.last - last < max(5.0, _GROWN * (rest.last - rest.first)):
            judged = Judged.of(reduction, file, rest, self._task.wanted)
            if judged.enough:
                self._enough.append((rest.first, rest.last))
            elif any(first < rest.last and rest.first < last for first, last in self._enough):
                judged = replace(judged, enough=True)
            self._judged[rest.first] = rest.last, judged
        return judged
