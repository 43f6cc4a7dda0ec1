"""The log of a session as it grows: its blocks, the rests in them, and the faults of its samples."""

from __future__ import annotations

from collections import deque
from dataclasses import replace

from tumble.bench.follow.faults import Fault, SampleWatch
from tumble.bench.follow.progress import Blocks, Judged, Progress, Rest, grouped
from tumble.bench.follow.wishes import Task
from tumble.bench.record.recorder import growing_file
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
_BACK_SECONDS = 5.0
"""A clock that goes back by more has started anew, or had gone wrong before."""
_MOST_FAULTS = 64
"""Faults of samples that are kept: nobody answers more, and a source that stutters for hours has one a second."""


class Live:
    """Follows the log of a task through the chain of a calibration.

    Attributes
    ----------
    now : Progress or None
        What the log says; None while there are no blocks.
    faults : deque of Fault
        Faults of the samples, the latest.
    samples, lost : int
        Samples that were read, and that are missing between them.
    at : int
        Bytes of the log that were read.
    trouble : str
        Why the log cannot be followed; empty while it can.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        self._judged: dict[int, tuple[int, Judged]] = {}
        self._enough: list[tuple[int, int]] = []
        self._begin(StreamedSamples(task.session.log))

    def _begin(self, streamed: StreamedSamples) -> None:
        self.now: Progress | None = None
        self.faults: deque[Fault] = deque(maxlen=_MOST_FAULTS)
        self.samples = self.lost = 0
        self.trouble, self._unreadable = "", False
        spec = self._task.session.log
        self.at, self._path, self._streamed = 0, growing_file(spec), streamed
        self._lines = Lines(columns=spec.columns, clock=spec.time, refuse=lambda _: None)  # counted by who records it
        self._reducer: Reducer | None = None
        self._gaps, self._latest = 0, 0.0
        self._watches: list[SampleWatch] = []
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
                    break
                if self._streamed.head < HEAD_ROWS <= self.samples:
                    self._begin(StreamedSamples(self._task.session.log, head=HEAD_ROWS))
        except LogError as error:
            self._unreadable = True
            self.trouble = f"the log cannot be followed any further, what is received is recorded: {error}"
        if self._reducer is not None:
            reduction = replace(self._reducer.now(), gaps=tuple(self._streamed.gaps))
            if reduction.files and len(reduction.files[-1]):
                self.now = self._progress(reduction, excluded)

    def _read_piece(self) -> bool:
        """Read the next lines of the log; whether there were any rows in them."""
        with self._path.open("rb") as file:
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
        """Report a clock that goes back: until it is where it was, the reader of the log takes no sample."""
        spec = self._task.session.log
        if spec.time is None or not self.samples:
            return
        time = float(rows[-1, spec.columns.index(spec.time)]) * spec.time_factor
        if time >= self._latest - _BACK_SECONDS:
            self.trouble = ""
            return
        if not self.trouble:
            at = self._latest
            said = (
                f"the clock goes back from {at:.1f} s to {time:.1f} s: another power-on, or wrong times before; what "
                "follows is recorded, but such a log cannot be calibrated: record anew"
            )
            self.faults.appendleft(Fault(kind="clock", said=said, start=at, stop=at, choices=("anew", "go_on")))
        self.trouble = f"the clock is {self._latest - time:.0f} s behind: the page waits for it"

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
        for watch, readings in zip(self._watches, (chunk.accel, chunk.gyro), strict=False):
            if readings is not None:
                self.faults += watch.look(chunk.time, readings)
        self._reducer.feed(chunk)
        self.samples += len(chunk.time)
        self._latest = float(chunk.time[-1])
        for gap in self._streamed.gaps[self._gaps :]:
            self.lost += gap.samples
            if not gap.integrable:
                start = gap.time - interval
                said = f"gap of {gap.stop - start:.1f} s at {start:.1f} s: {gap.samples} samples did not arrive"
                self.faults.append(Fault(kind="gap", said=said, start=start, stop=gap.stop))
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
        rests = [] if so_far is None else [Rest.of(blocks, span.first, span.last) for span in so_far.rests]
        if so_far is not None and so_far.lasting:
            rests[-1] = Rest.of(blocks, rests[-1].first, len(blocks))
        groups = grouped(blocks, rests)
        return Progress(
            reduction=reduction,
            blocks=blocks,
            so_far=so_far,
            groups=groups,
            judged=tuple(self._judge(reduction, rest) for rest in (groups[-1][-2:] if groups else ())),
        )

    def _judge(self, reduction: Reduction, rest: Rest) -> Judged:
        """Judge a rest; one that lasts again every half second, and later as it grows by a hundredth.

        A rest that was enough stays so: its uncertainty is known to some percent, and would cross the wanted one more
        than once."""
        last, judged = self._judged.get(rest.first, (0, None))
        if judged is None or not 0 <= rest.last - last < max(5.0, _GROWN * (rest.last - rest.first)):
            judged = Judged.of(reduction, rest, self._task.wanted)
            if judged.enough:
                self._enough.append((rest.first, rest.last))
            elif any(first < rest.last and rest.first < last for first, last in self._enough):
                judged = replace(judged, enough=True)
            self._judged[rest.first] = rest.last, judged
        return judged
