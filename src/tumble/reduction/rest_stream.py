"""The rests of a log that grows and of a stream without an end.

The samples are reduced to blocks, and rests are searched for among the blocks, by the same functions as in a log that
is complete (`Reducer`, `without_blemishes`, `find_rests`, `observe`). The result depends on the samples alone, not on
the chunks in which they came.

`rests_so_far` searches the whole log, with windows of half a second and no margins: a rest is found half a second after
it has begun, and its end as soon as something moves. A calibration has longer windows, and leaves out the ends of a
rest.

A `RestStream` searches a window every SEARCH blocks, and once this is WINDOW blocks long the oldest blocks are dropped,
but for the last CARRIED and those of a rest that lasts. The noise floors by which rest is told from movement are those
of the window, where a complete log has those of all its blocks. A rest that lasts is cut every LONGEST seconds.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
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

SEARCH = 200
"""Blocks, 20 s, between two searches."""
WINDOW = 6000
"""Blocks, 10 min, that are searched at most."""
CARRIED = 600
"""Blocks, 1 min, that stay at least when the oldest ones are dropped."""
FEWEST = 30
"""Blocks, 3 s, from which on rests are searched for."""
FEWEST_OF_MEAN = 10
"""Blocks, 1 s, of a rest from which on the noise of its mean is estimated."""
SETTLED = 30
"""Blocks, 3 s, without rest after which a rest has ended."""
BEFORE_REST = 5.0
"""Time (s) before a rest that lasts which stays in the window."""
LONGEST = 300.0
"""Duration (s) of the longest rest; what lasts longer is several."""


def rests_so_far(
    reduction: Reduction, accel: Block, gyro: Block | None, excluded: tuple[Exclusion, ...] = ()
) -> Segmentation | None:
    """Find the rests of a log so far.

    Parameters
    ----------
    reduction
        The reduction of the log so far, `Reducer.now()`.
    accel, gyro
        Sensors of the session.
    excluded
        Stretches of time to leave out. The longest part of a rest remains.

    Returns
    -------
    Segmentation or None
        The rests that have ended and are as long as a calibration asks, and last the one that lasts, if one does. None
        while the log is shorter than FEWEST blocks.
    """
    if sum(map(len, reduction.files)) < FEWEST:
        return None
    usual = reduction.tuning
    quick = replace(usual, window=usual.short_window, rest=usual.short_window, margin_least=0.0, margin_fraction=0.0)
    with np.errstate(over="ignore", invalid="ignore"):  # of damaged samples
        reduction = replace(without_blemishes(reduction), tuning=quick)
        found = without_times(reduction, find_rests(reduction, accel, gyro), excluded)
    shortest = usual.rest + 2.0 * usual.margin_least - 1e-9
    return replace(
        found, rests=tuple(each for each in found.rests if each.reaches_end or each.stop - each.start >= shortest)
    )


def mean_so_far(file: FileBlocks, first: int, last: int) -> dict[str, tuple[float, float]]:
    """Estimate how well the mean of a rest is known, from the noise in this rest alone.

    Parameters
    ----------
    file
        The blocks of its file so far.
    first, last
        Blocks first … last − 1 of these.

    Returns
    -------
    dict
        For "accel" and "gyro" the standard uncertainty of the mean, m/s² or rad/s, the largest of the channels, and the
        same after twice the time. Without what does not exist, and while the rest is shorter than FEWEST_OF_MEAN.
    """
    out = dict[str, tuple[float, float]]()
    for kind, series in (("accel", file.accel), ("gyro", file.gyro)):
        means = series.means[first:last]
        if len(means) >= FEWEST_OF_MEAN and means.shape[1]:
            noise = fit_coloured_noise([means])
            now, twice = (float(np.sqrt(noise.variance_of_mean(k * len(means)).max())) for k in (1.0, 2.0))
            out[kind] = now, twice
    return out


class RestStream:
    """Finds the rests in a stream of samples without an end.

    Parameters
    ----------
    rate
        Samples per second.
    accel, gyro
        The accelerometers and the gyros; None without gyros.
    site
        Where the sensors are.
    increments
        For each kind of sensor whether a sample is an increment over its interval.
    """

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
        self._reducer = Reducer(rate=rate, accel=accel, gyro=gyro, increments=increments)
        self._step = SEARCH * self._reducer.size
        self._samples = 0
        self._given_until = -np.inf
        """End (s) of the last rest that was given out."""

    def feed(self, chunk: Chunk) -> list[Observations]:
        """Add samples of the stream.

        Parameters
        ----------
        chunk
            The next samples, all of the same file.

        Returns
        -------
        list of Observations
            The rests that have ended since the last search, one in each.
        """
        ended = list[Observations]()
        while len(chunk.time):
            count = min(len(chunk.time), self._step - self._samples % self._step)
            self._reducer.feed(chunk.part(slice(0, count)))
            chunk = chunk.part(slice(count, None))
            self._samples += count
            if self._samples % self._step == 0:
                ended += self._search()
        return ended

    def finish(self) -> list[Observations]:
        """The rests that have not been given out, with one that lasts at the end of the stream."""
        return self._search(finished=True)

    def _search(self, *, finished: bool = False) -> list[Observations]:
        reduction = self._reducer.now()
        if not reduction.files or len(reduction.files[-1]) < FEWEST:
            return []
        with np.errstate(over="ignore", invalid="ignore"):  # of damaged samples
            reduction = without_blemishes(reduction)
            segmentation = find_rests(reduction, self._accel, self._gyro)
        file, tuning = reduction.files[-1], segmentation.tuning
        count, lasting_since = len(file), float(file.edges[-1])
        before, ended = list[Stretch](), list[Stretch]()
        for span in segmentation.rests:
            start = max(span.start, self._given_until)
            while span.stop - start >= LONGEST:
                ended.append(Stretch.between(file, start, start + LONGEST))
                start = self._given_until = ended[-1].stop
            over = finished or span.last < count - SETTLED
            if over and span.stop - start >= tuning.rest:
                ended.append(Stretch.between(file, start, span.stop))
                self._given_until = ended[-1].stop
            elif not over:
                lasting_since = min(lasting_since, start)
            if span.stop <= self._given_until and span.start < self._given_until:
                before.append(span)
        ended = [span for span in ended if span.last - span.first >= tuning.fewest_blocks]
        others = [s for s in before if all(s.stop <= new.start or new.stop <= s.start for new in ended)]
        spans = tuple(sorted([*others, *ended], key=lambda span: span.first))
        out = list[Observations]()
        if ended:  # the noise is that of all rests of the window
            seen = observe(replace(reduction, samples=None), spans, self._accel, self._gyro, self._site, ())
            out = [seen.of_rest(spans.index(span)) for span in ended]
        if count >= WINDOW:
            first = max(min(lasting_since - BEFORE_REST, float(file.edges[count - CARRIED])), self._given_until)
            self._reducer.forget(int(np.searchsorted(file.edges, first)))
        return out
