"""Rests of a growing log, and of an endless stream.

The samples are reduced to blocks, and rests are searched among the blocks, by the same functions as for a complete log
(`Reducer`, `without_blemishes`, `find_rests`, `observe`). The result depends only on the samples, not on the chunks.

`rests_so_far` searches the whole log, with windows of half a second and no margins: a rest is found half a second after
its beginning, and its end as soon as something moves. A calibration has longer windows, and omits the ends of a rest.

A `RestStream` searches a window every SEARCH blocks. Once it is WINDOW blocks long, the oldest blocks are dropped,
except for the last CARRIED and those of an ongoing rest, and the samples of the others are reduced anew. The noise
floors are those of the window rather than of all blocks of a log. An ongoing rest is cut every LONGEST seconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from types import MappingProxyType

import numpy as np

from tumble.recording.log import Chunk
from tumble.recording.session import Exclusion, Site
from tumble.reduction.blocks.reducer import FileBlocks, Reducer, Reduction
from tumble.reduction.noise.coloured_noise import fit_coloured_noise
from tumble.reduction.observations import Observations, observe
from tumble.reduction.rests.blemishes import without_blemishes
from tumble.reduction.rests.matching import without_times
from tumble.reduction.rests.segmentation import Segmentation, Stretch, find_rests
from tumble.sensors.model import Block

SEARCH = 200  # blocks, 20 s, between two searches
WINDOW = 6000  # blocks, 10 min, that are searched at most
CARRIED = 600  # blocks, 1 min, that are kept when the oldest ones are dropped
FEWEST = 30  # blocks, 3 s, from which rests are searched for
FEWEST_OF_MEAN = 10  # blocks, 1 s, of a rest from which the noise of its mean is estimated
END_BLOCKS = 30  # blocks, 3 s, without rest after which a rest has ended
BEFORE_REST = 5.0  # s before an ongoing rest that stay in the window
LONGEST = 300.0  # s: what lasts longer is several rests


def rests_so_far(
    reduction: Reduction, accel: Block, gyro: Block | None, excluded: tuple[Exclusion, ...] = ()
) -> Segmentation | None:
    """Return the rests of a log so far, outside of the excluded times; the longest part of a rest remains.

    They are the ended rests that are long enough for a calibration, followed by the ongoing rest, if there is one. The
    result is None while the log is shorter than FEWEST blocks."""
    if sum(map(len, reduction.files)) < FEWEST:
        return None
    usual = reduction.tuning
    quick = replace(usual, window=usual.short_window, rest=usual.short_window, margin_least=0.0, margin_fraction=0.0)
    with np.errstate(over="ignore", invalid="ignore"):  # damaged samples
        reduction = replace(without_blemishes(reduction), tuning=quick)
        segmentation = without_times(reduction, find_rests(reduction, accel, gyro), excluded)
    shortest = usual.rest + 2.0 * usual.margin_least - 1e-9
    return replace(
        segmentation, rests=tuple(r for r in segmentation.rests if r.reaches_end or r.stop - r.start >= shortest)
    )


def mean_so_far(file: FileBlocks, first: int, last: int) -> dict[str, tuple[float, float]]:
    """Return the standard uncertainties of the mean of a rest, blocks first … last − 1 of a file, from the noise in
    this rest alone.

    For "accel" and "gyro", m/s² or rad/s, the largest of the channels now and after twice the time. Empty while the
    rest is shorter than FEWEST_OF_MEAN."""
    out = dict[str, tuple[float, float]]()
    for kind, series in (("accel", file.accel), ("gyro", file.gyro)):
        means = series.means[first:last]
        if len(means) >= FEWEST_OF_MEAN and means.shape[1]:
            noise = fit_coloured_noise([means])
            now, twice = (float(np.sqrt(noise.variance_of_mean(k * len(means)).max())) for k in (1.0, 2.0))
            out[kind] = now, twice
    return out


class RestStream:
    """Incremental search for rests in an endless stream of samples at a `rate`, Hz.

    `increments`: by kind of sensor, whether a sample is an increment over its interval."""

    def __init__(
        self,
        *,
        rate: float,
        accel: Block,
        gyro: Block | None,
        site: Site,
        increments: Mapping[str, bool] = MappingProxyType({}),
    ) -> None:
        self._accel, self._gyro, self._site = accel, gyro, site
        self._new_reducer = partial(Reducer, rate=rate, accel=accel, gyro=gyro, increments=increments)
        self._reducer, self._window = self._new_reducer(), list[Chunk]()
        self._step = SEARCH * self._reducer.size
        self._samples = 0
        self._returned_until = -np.inf  # end of the last rest that was returned, s

    def feed(self, chunk: Chunk) -> list[Observations]:
        """Add the next samples of the stream, all of the same file, and return the rests that have ended since the last
        search, one in each."""
        ended = list[Observations]()
        while len(chunk.time):
            count = min(len(chunk.time), self._step - self._samples % self._step)
            self._add(chunk.part(slice(0, count)))
            chunk = chunk.part(slice(count, None))
            self._samples += count
            if self._samples % self._step == 0:
                ended += self._search()
        return ended

    def finish(self) -> list[Observations]:
        """Return the rests that have not been returned, including one that is ongoing at the end of the stream."""
        return self._search(finished=True)

    def _add(self, chunk: Chunk) -> None:
        """Add samples to the window."""
        self._reducer.feed(chunk)
        self._window.append(chunk)

    def _drop(self, blocks: int) -> None:
        """Drop the first blocks of the window."""
        window, n_dropped = self._window, blocks * self._reducer.size
        self._reducer, self._window = self._new_reducer(), []
        for chunk in window:
            if n_dropped < len(chunk.time):
                self._add(chunk.part(slice(n_dropped, None)))
            n_dropped = max(n_dropped - len(chunk.time), 0)

    def _search(self, *, finished: bool = False) -> list[Observations]:
        reduction = self._reducer.now()
        if not reduction.files or len(reduction.files[-1]) < FEWEST:
            return []
        with np.errstate(over="ignore", invalid="ignore"):  # damaged samples
            reduction = without_blemishes(reduction)
            segmentation = find_rests(reduction, self._accel, self._gyro)
        file, tuning = reduction.files[-1], segmentation.tuning
        count, ongoing_since = len(file), float(file.edges[-1])
        returned, ended = list[Stretch](), list[Stretch]()  # in this window: before, and now
        for span in segmentation.rests:
            start = max(span.start, self._returned_until)
            while span.stop - start >= LONGEST:
                ended.append(Stretch.between(file, start, start + LONGEST))
                start = self._returned_until = ended[-1].stop
            over = finished or span.last < count - END_BLOCKS
            if over and span.stop - start >= tuning.rest:
                ended.append(Stretch.between(file, start, span.stop))
                self._returned_until = ended[-1].stop
            elif not over:
                ongoing_since = min(ongoing_since, start)
            if span.stop <= self._returned_until and span.start < self._returned_until:
                returned.append(span)
        ended = [span for span in ended if span.last - span.first >= tuning.fewest_blocks]
        others = [s for s in returned if all(s.stop <= new.start or new.stop <= s.start for new in ended)]
        spans = tuple(sorted([*others, *ended], key=lambda span: span.first))
        out = list[Observations]()
        if ended:  # the noise is that of all rests of the window
            observations = observe(replace(reduction, samples=None), spans, self._accel, self._gyro, self._site, ())
            out = [observations.of_rest(spans.index(span)) for span in ended]
        if count >= WINDOW:
            first = max(min(ongoing_since - BEFORE_REST, float(file.edges[count - CARRIED])), self._returned_until)
            self._drop(int(np.searchsorted(file.edges, first)))
        return out
