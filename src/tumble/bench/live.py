"""The log of a session as it grows: followed to its blocks, the rests in them, and the faults of its samples."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from tumble.bench.chain import Blocks, Chain, known
from tumble.bench.course import Judged, Progress, Rest, StillLimits, calm_since, grouped, judged, rest_of
from tumble.bench.faults import Fault, channel_fault, gap_fault
from tumble.bench.follow import BRIDGED, Clock, Follower, SoundSamples
from tumble.bench.task import Task
from tumble.bench.watch import Watch
from tumble.recording.session import Exclusion
from tumble.reduction.blocks import Reduction
from tumble.reduction.segmentation import RestSpan, Segmentation

_WINDOW = 1200
_PIECES = 32
_MOST_FAULTS = 64
"""Faults of samples that are kept: nobody answers more, and a source that stutters for hours has one a second."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Followed:
    """What the log says so far: its blocks, the rests in them, and the limits of a calm block, None while there is too
    little to find rests in."""

    reduction: Reduction
    blocks: Blocks
    spans: tuple[RestSpan, ...] = ()
    limits: StillLimits | None = None


class Live:
    """Follows the log of a task. `now` is what it says, None while there are no blocks; `faults` are those seen in its
    samples, of which `samples` were read and `lost` are missing."""

    def __init__(self, task: Task) -> None:
        self.now: Followed | None = None
        self.faults: deque[Fault] = deque(maxlen=_MOST_FAULTS)
        self.samples = self.lost = 0
        self._task = task
        self._follower = Follower.of(task.session.log)
        self._clock = Clock(spec=task.session.log)
        self._chain: Chain | None = None
        self._watches: list[Watch] = []
        self._closed: dict[tuple[int, int], Rest] = {}
        self._judged: dict[tuple[int, int], Judged] = {}

    @property
    def at(self) -> int:
        """Bytes of the log that are read."""
        return self._follower.at

    @property
    def interval(self) -> float | None:
        """Time from sample to sample, s; None while too few have come to know it."""
        return self._clock.interval

    # -------------------- from the log to rests --------------------

    def read(self, excluded: tuple[Exclusion, ...]) -> None:
        """Read what has come, without the times that are left out."""
        for _ in range(_PIECES):
            rows = self._follower.rows()
            if not len(rows):
                break
            samples = self._clock.samples(rows)
            if samples is not None and self._clock.interval is not None:
                self._take(samples, self._clock.interval)
        reduction = None if self._chain is None else self._chain.now()
        if self._chain is not None and reduction is not None and reduction.files:
            self.now = self._followed(self._chain, reduction, excluded)

    def _take(self, samples: SoundSamples, interval: float) -> None:
        """Feed samples to the chain and look at each of them."""
        if self._chain is None:
            self._chain = Chain(self._task.session, interval)
            kinds = [each for each in (self._task.session.log.accel, self._task.session.log.gyro) if each is not None]
            self._watches = [Watch(channels.columns, channels.range, interval) for channels in kinds]
        readings = self._chain.feed(samples)
        self.samples += len(samples.time)
        self.lost += int(samples.lost.sum())
        for watch, values in zip(self._watches, readings, strict=False):
            if values is not None:
                self.faults += map(channel_fault, watch.look(samples.time, values))
        for i in np.flatnonzero(samples.lost > BRIDGED):
            self.faults.append(gap_fault(float(samples.time[i]), int(samples.lost[i]), float(samples.dt[i])))

    def _followed(self, chain: Chain, reduction: Reduction, excluded: tuple[Exclusion, ...]) -> Followed:
        blocks = chain.blocks(reduction)
        spans = () if self.now is None else self.now.spans
        limits = None if self.now is None else self.now.limits
        first = _looked_at_from(blocks, spans)
        found = chain.rests(reduction, excluded, first)
        if found is not None:
            spans = (*(span for span in spans if span.last <= first), *found.rests)
            limits = _limits_of(found, blocks, spans)
        return Followed(reduction=reduction, blocks=blocks, spans=spans, limits=limits)

    # -------------------- from rests to progress --------------------

    def progress(self, excluded: tuple[Exclusion, ...]) -> Progress | None:
        """How far the operator is; None while there is too little to see rests in."""
        now = self.now
        if now is None or now.limits is None:
            return None
        calm_from = calm_since(now.blocks, now.limits)
        current = None if calm_from is None else _lasting(now.blocks, calm_from, excluded)
        ended = [(span.first, span.last) for span in now.spans if calm_from is None or span.last <= calm_from]
        self._closed = {each: self._closed.get(each) or rest_of(now.blocks, *each) for each in ended}
        rests = [*self._closed.values(), *([] if current is None else [current])]
        groups = grouped(now.blocks, rests)
        return Progress(
            blocks=now.blocks,
            limits=now.limits,
            calm_from=calm_from,
            groups=groups,
            lasts=current is not None,
            judged=tuple(self._judge(now.reduction, rest) for rest in (groups[-1][-2:] if groups else ())),
        )

    def _judge(self, reduction: Reduction, rest: Rest) -> Judged:
        """How good a rest is; of a rest that lasts, anew every half second."""
        key = rest.first, rest.last // 5
        if key not in self._judged:
            self._judged = {k: v for k, v in self._judged.items() if k[0] != rest.first}
            found = known(reduction, rest.first, rest.last)
            self._judged[key] = judged(found, rest.stop - rest.start, self._task.wanted)
        return self._judged[key]


def _looked_at_from(blocks: Blocks, spans: tuple[RestSpan, ...]) -> int:
    """The block from which on rests are looked for: of a long log the end of a rest, some minutes ago."""
    if len(blocks) <= 5 * _WINDOW:
        return 0
    first = len(blocks) - _WINDOW
    return max([span.last for span in spans if span.last <= first], default=first)


def _limits_of(found: Segmentation, blocks: Blocks, spans: tuple[RestSpan, ...]) -> StillLimits:
    """The limits of a calm block, with the rate of the last rest."""
    level = None
    if blocks.rate is not None and spans:
        level = blocks.rate[spans[-1].first : spans[-1].last].mean(axis=0)
    return StillLimits(scatter=found.scatter_limit, rate=found.rate_limit, level=level)


def _lasting(blocks: Blocks, first: int, excluded: tuple[Exclusion, ...]) -> Rest | None:
    """The rest since block `first`, after what is left out of it; None if nothing is left."""
    for one in excluded:
        if one.start is not None and one.stop is not None and one.stop > blocks.edges[first]:
            if math.isinf(one.stop) and one.start <= blocks.edges[-1]:
                return None
            if one.start < blocks.edges[-1]:
                first = max(first, int(np.searchsorted(blocks.edges, one.stop - 1e-9)))
    return rest_of(blocks, first, len(blocks)) if len(blocks) - first >= 3 else None
