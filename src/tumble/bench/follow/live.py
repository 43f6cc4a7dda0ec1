"""The log of a session as it grows: its blocks, the rests in them, and the faults of its samples."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np

from tumble.bench.follow.faults import Fault, SampleWatch
from tumble.bench.follow.rests import Blocks, Judged, Progress, Rest, StillLimits, calm_since, grouped
from tumble.bench.follow.samples import Clock
from tumble.bench.follow.wishes import Task
from tumble.bench.record.recorder import growing_file
from tumble.recording.live.lines import Lines
from tumble.recording.log import HEAD_ROWS, Chunk
from tumble.recording.session import Exclusion
from tumble.reduction.blocks.reducer import Reducer, Reduction
from tumble.reduction.rests.blemishes import without_blemishes
from tumble.reduction.rests.matching import without_times
from tumble.reduction.rests.segmentation import RestSpan, find_rests

PIECE_BYTES = 1 << 18
_PIECES = 32
_LEAST_BLOCKS = 30
_GROWN = 0.01
"""Of the length of a log: by so much it grows between searches where nothing else asks for one, so that all of them
together cost as much as a hundred of its whole length."""
_LEVEL_BLOCKS = 600
"""At the end of a rest: their rate is what the gyros read at rest now, however far they have drifted since it began."""
_MOST_FAULTS = 64
"""Faults of samples that are kept: nobody answers more, and a source that stutters for hours has one a second."""


class Live:
    """Follows the log of a task through the chain of a calibration. `now` is what it says, None while there are no
    blocks; `faults` are those seen in its samples, of which `samples` were read, up to the byte `at`, and `lost` are
    missing."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._ended: dict[tuple[int, int], Rest] = {}
        self._judged: dict[int, tuple[int, Judged]] = {}
        self._enough: list[tuple[int, int]] = []
        self._begin(Clock(task.session.log))

    def _begin(self, clock: Clock) -> None:
        self.now: Progress | None = None
        self.faults: deque[Fault] = deque(maxlen=_MOST_FAULTS)
        self.samples = self.lost = 0
        spec = self._task.session.log
        self.at, self._path, self._clock = 0, growing_file(spec), clock
        self._lines = Lines(columns=spec.columns, clock=spec.time, refuse=lambda _: None)  # counted by who records it
        self._reducer: Reducer | None = None
        self._gaps = 0
        self._watches: list[SampleWatch] = []
        self._searched: tuple[object, ...] = ()
        self._searched_blocks = 0

    @property
    def interval(self) -> float | None:
        """Time from sample to sample, s; None while too few have come to know it."""
        return self._clock.interval

    def read(self, excluded: tuple[Exclusion, ...]) -> None:
        """Read what has come, without the times that are left out. Once there are as many rows as the calibration takes
        the interval from, the log is read again with theirs: of fewer it may differ by its rounding, and with it
        where a window ends."""
        for _ in range(_PIECES):
            with self._path.open("rb") as file:
                file.seek(self.at)
                data = file.read(PIECE_BYTES)
            data = data[: data.rfind(b"\n") + 1]
            self.at += len(data)
            rows = self._lines.numbers(data)
            if not len(rows):
                break
            chunk = self._clock.samples(rows)
            if chunk is not None and self._clock.interval is not None:
                self._take(chunk, self._clock.interval)
            if self._clock.head < HEAD_ROWS <= self.samples:
                self._begin(Clock(self._task.session.log, head=HEAD_ROWS))
        if self._reducer is not None:
            reduction = replace(self._reducer.now(), gaps=tuple(self._clock.gaps))
            if reduction.files:
                self.now = self._progress(reduction, excluded)

    def _take(self, chunk: Chunk, interval: float) -> None:
        """Look at samples, and feed them to the reduction."""
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
        for gap in self._clock.gaps[self._gaps :]:
            self.lost += gap.samples
            if not gap.integrable:
                start = gap.time - interval
                said = f"gap of {gap.stop - start:.1f} s at {start:.1f} s: {gap.samples} samples did not arrive"
                self.faults.append(Fault(kind="gap", said=said, start=start, stop=gap.stop))
        self._gaps = len(self._clock.gaps)

    def _progress(self, reduction: Reduction, excluded: tuple[Exclusion, ...]) -> Progress:
        """What the log says now. Rests are looked for in the whole of it, as the calibration looks for them, whenever
        others may be found: when movement begins or ends, a rest becomes long enough, something is left out, the log
        has grown by a hundredth, or has ended."""
        session, before = self._task.session, self.now
        blocks = Blocks.of(reduction, session)
        spans: tuple[RestSpan, ...] = ()
        limits: StillLimits | None = None
        calm_from: int | None = None
        if before is not None and before.limits is not None:
            spans, limits = before.spans, before.limits
            known = () if before.calm_from is None else (before.calm_from, len(before.blocks))
            calm_from = calm_since(blocks, limits, *known)
        current = _lasting(blocks, calm_from, excluded)
        seen = calm_from, current is not None and self._judge(reduction, current).enough, excluded
        longer = len(blocks) - self._searched_blocks
        has_ended = before is not None and len(blocks) == len(before.blocks) and longer > 0
        due = seen != self._searched or has_ended or longer > _GROWN * len(blocks)
        if due and len(blocks) >= _LEAST_BLOCKS:
            sound = without_blemishes(reduction)
            segmentation = find_rests(sound, session.accel_block, session.gyro_block)
            segmentation = without_times(sound, segmentation, excluded)
            spans, level = segmentation.rests, None
            if blocks.rate is not None and spans:
                level = blocks.rate[max(spans[-1].first, spans[-1].last - _LEVEL_BLOCKS) : spans[-1].last].mean(axis=0)
            limits = StillLimits(scatter=segmentation.scatter_limit, rate=segmentation.rate_limit, level=level)
            calm_from = calm_since(blocks, limits)
            current = _lasting(blocks, calm_from, excluded)
            seen = calm_from, current is not None and self._judge(reduction, current).enough, excluded
            self._searched, self._searched_blocks = seen, len(blocks)
        ended = [(span.first, span.last) for span in spans if calm_from is None or span.last <= calm_from]
        self._ended = {each: self._ended.get(each) or Rest.of(blocks, *each) for each in ended}
        groups = grouped(blocks, [*self._ended.values(), *([] if current is None else [current])])
        return Progress(
            reduction=reduction,
            blocks=blocks,
            spans=spans,
            limits=limits,
            calm_from=calm_from,
            groups=groups,
            lasts=current is not None,
            judged=tuple(self._judge(reduction, rest) for rest in (groups[-1][-2:] if groups else ())),
        )

    def _judge(self, reduction: Reduction, rest: Rest) -> Judged:
        """How good a rest is; of one that lasts, anew every half second, later as it grows by a hundredth. What was
        enough stays so: u is known to some percent and crosses the wanted one more than once, and the rest that is
        found in the end is shorter by its margins."""
        last, judged = self._judged.get(rest.first, (0, None))
        if judged is None or not 0 <= rest.last - last < max(5.0, _GROWN * (rest.last - rest.first)):
            judged = Judged.of(reduction, rest, self._task.wanted)
            if judged.enough:
                self._enough.append((rest.first, rest.last))
            elif any(first < rest.last and rest.first < last for first, last in self._enough):
                judged = replace(judged, enough=True)
            self._judged[rest.first] = rest.last, judged
        return judged


def _lasting(blocks: Blocks, calm_from: int | None, excluded: tuple[Exclusion, ...]) -> Rest | None:
    """The rest that lasts, after what is left out of it; None where something moves, or nothing is left."""
    if calm_from is None:
        return None
    first = calm_from
    for one in excluded:
        if one.start is not None and one.stop is not None and one.stop > blocks.edges[first]:
            if math.isinf(one.stop) and one.start <= blocks.edges[-1]:
                return None
            if one.start < blocks.edges[-1]:
                first = max(first, int(np.searchsorted(blocks.edges, one.stop - 1e-9)))
    return Rest.of(blocks, first, len(blocks)) if len(blocks) - first >= 3 else None
