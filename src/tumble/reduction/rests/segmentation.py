"""Rests and turns of a log.

`find_rests` works on the blocks of a `Reduction` and derives its limits from the whole log, with the factors of
`Tuning`:

1. The gyro level at rest is the densest point of the one-second means of the rate where the accelerometer scatter is
   within `quiet_factor` of its floor: turns have many directions, whereas all rests read the bias (and the Earth's
   rate, within 2Ω), and slow turns that fill most of a log are not quiet.
2. The noise floor of the distance from that level is a clipped median, started from the tenth percentile, or from the
   second if that yields no rest (a device in the hand rests only now and then). A block belongs to a rest if its
   distance is below `floor_factor` floors (plus 2Ω for the Earth's rate) and the accelerometer scatter in the same
   second is below `scatter_factor` times its own floor. Vibration that averages out over a second raises the floors
   and the quantities alike. The level is interpolated between the rests, so that it follows slow drift, and the search
   is repeated.
3. A rest is extended block by block while single blocks stay within `edge` standard deviations of its mean, and then
   shortened at both ends by a margin for settling, except where the file begins or ends. The time between two rests of
   a file is a turn.
4. Gyros with g-sensitivity have another level in every attitude, and gyros that warm up in every rest. Quiet and steady
   stretches off the level are therefore examined again (`gyro_levels`): if a linear function of specific force and time
   explains their levels, it is subtracted from the rates, and steps 1 and 2 are repeated. A stretch is accepted only if
   the other stretches predict its level, so that a slow turn about the vertical remains a turn.
5. If nearly all stretches are too short, the log is searched again with windows of half a second and margins of a
   tenth; a rest then lasts at least `short_rest` between its margins. If nothing rests, windows of two tenths find
   moments of rest, which are only reported as too short.
6. A stretch in which the vertical moves by more than `tilt`, plus the change allowed for the temperature of the
   accelerometer biases, is not a rest. In a log without rests the floors are those of motion, so that a slow turn
   passes the tests above.
7. A rest in which a reading steps to another level, because of a knock or a jump of a bias, is divided there. The
   change from the mean over a time to that over the next, an eighth of the median rest or a window, is compared with
   its median size in this rest and in all rests. Unlike a drift, a step has this size (by half to twice) also between
   the means of all that is before and after it, and at least half of it over a third of the time. Rests of less than
   six such times, whose parts would hardly be rests, are not divided.

Without gyros, the accelerometer scatter decides, together with the step between the means of neighbouring seconds,
which reveals a turn about a nearly vertical axis by its small tilt.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import ClassVar, Literal

import numpy as np

from tumble.earth import EARTH_RATE
from tumble.programme.positions import Programme
from tumble.recording.rows.gaps import Gap
from tumble.reduction.blocks.reducer import ChannelState, FileBlocks, Reduction
from tumble.reduction.blocks.tuning import USUAL, Tuning
from tumble.reduction.rests.gyro_levels import OffLevel, Span, core, level_function
from tumble.rotation import onto_body
from tumble.sensors.model import Block
from tumble.units import DEGREE, Array, BoolArray, IntArray

DENSITY_POINTS = 1000  # points among which the densest is sought
ACCEL_ROUNDING = 1e-5  # m/s²: rounding of block means from single-precision increments
GYRO_ROUNDING = 1e-7  # rad/s: the same
LONGEST_LIST = 20  # stretches that a message lists one by one
FEWEST_CHANGES = 24  # independent changes that show how large they usually are
EXTENSION_STRIDE = 256  # blocks compared at a time when a span is extended
NORMAL_MEDIAN = 0.6745  # of the absolute value of a standard normal variable

Fails = Literal["duration", "scatter", "vertical", "level"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Stretch:
    """A quiet stretch of a log: a rest, or a stretch that fails a criterion.

    `file`, `first`, `last`: blocks first … last − 1 of a file. `start`, `stop`: its times, s. `reaches_end`: whether it
    reaches the end of the log, up to a single block, which may be off by chance. `fails`: the criterion that it fails
    (its duration, the accelerometer scatter, the constancy of the vertical or the gyro level), None for a rest.
    `reason`: the same in words, with the number that decided."""

    json_fields: ClassVar = ("file", "start", "stop", "fails", "reason")

    file: int
    first: int
    last: int
    start: float
    stop: float
    reaches_end: bool = False
    fails: Fails | None = None
    reason: str = ""

    @staticmethod
    def between(f: FileBlocks, start: float, stop: float) -> Stretch:
        """Return the whole blocks of a file between two times, s."""
        first = int(np.searchsorted(f.edges, start - 1e-9))
        last = int(np.searchsorted(f.edges, stop + 1e-9, side="right")) - 1
        return Stretch.of_blocks(f, (first, last))

    @staticmethod
    def of_blocks(f: FileBlocks, span: Span, fails: Fails | None = None, reason: str = "") -> Stretch:
        """Return the stretch of a span of blocks of a file."""
        start, stop = (float(f.edges[i]) for i in span)
        return Stretch(file=f.file, first=span[0], last=span[1], start=start, stop=stop, fails=fails, reason=reason)

    @staticmethod
    def too_short(f: FileBlocks, span: Span, tuning: Tuning) -> Stretch:
        """Return a motionless span of blocks that is too short for a rest."""
        length = f.edges[span[1]] - f.edges[span[0]]
        reason = f"{length:.1f} s is too short: rests of {tuning.rest_seconds} s are long enough"
        return Stretch.of_blocks(f, span, "duration", reason)


def gap_between(before: Stretch, after: Stretch, samples: int, what: str, why: str) -> Gap:
    """Return the turn between two rests as a gap of the log; `samples` is the number of samples that cause it."""
    at, stop = before.stop, after.start
    return Gap(file=before.file, row=0, time=at, samples=samples, what=what, stop=stop, integrable=False, why=why)


def breaking_gap(before: Stretch, after: Stretch, gaps: tuple[Gap, ...]) -> Gap | None:
    """Return the last gap between two rests of a file over which the gyros cannot be integrated."""
    for gap in reversed(gaps):
        in_file = gap.file == before.file == after.file
        if in_file and not gap.integrable and gap.time < after.start and gap.stop > before.stop:
            return gap
    return None


@dataclass(frozen=True, kw_only=True, slots=True)
class Segmentation:
    """The rests of a log.

    `rests`, `rejected`: the rests, and the quiet stretches that are no rests, in order of time. `rate_limit`,
    `scatter_limit`: limits of motion, for the distance of the rate from its level at rest, rad/s (None without gyros),
    and for the scatter of the specific force, m/s². `jump`: jump of the gyro level at rest (3,), rad/s, if there is
    one, and `jump_at`: file and start, s, of the rest after it. `stated_rate`: sample rate, Hz, of a log without time
    stamps, on which durations depend. `tuning`: thresholds of the search. `still_at_end`: whether the device is
    motionless at the end of the log, also if the session excludes that time. `programme`, `position`: the programme to
    which the rests were matched, and the position index (N,) of each rest in it."""

    json_fields: ClassVar = ("scatter_limit", "rate_limit", "rejected")

    rests: tuple[Stretch, ...]
    rejected: tuple[Stretch, ...]
    rate_limit: float | None
    scatter_limit: float
    jump: Array | None = None
    jump_at: tuple[int, float] = 0, 0.0
    stated_rate: float | None = None
    tuning: Tuning = USUAL
    still_at_end: bool = False
    programme: Programme | None = None
    position: IntArray | None = None

    @property
    def lasting(self) -> bool:
        """Whether the last rest reaches the end of the log."""
        return bool(self.rests) and self.rests[-1].reaches_end

    @property
    def rests_before_jump(self) -> int:
        """Number of rests before the jump of the gyro level, 0 if no jump lies between two rests."""
        if self.jump is None:
            return 0
        before = sum((r.file, r.start) < self.jump_at for r in self.rests)
        return before if before < len(self.rests) else 0

    def jumped(self) -> tuple[str, ...]:
        """Return a sentence on the jump of the gyro level between two rests, with a remedy, if there is one."""
        before = self.rests_before_jump
        if self.jump is None or not before:
            return ()
        return (
            f"the level of the gyros at rest jumps by {np.linalg.norm(self.jump) / DEGREE:.2g} °/s between rest "
            f"{before} (to {self.rests[before - 1].stop:z.1f} s) and rest {before + 1} (from "
            f"{self.rests[before].start:z.1f} s) and stays there: a driver that measured the bias anew, or another "
            f"device; calibrate the {before} rests before it and the {len(self.rests) - before} after it as launches "
            "of their own, each with the times of the others in [[exclude]]",
        )

    @property
    def shaken(self) -> tuple[Stretch, ...]:
        """Stretches in which the gyros are at rest and the accelerometers are shaken; none if the rate limit allows a
        turn by more than `tilt` within a window, since the device may then be moving."""
        if self.rate_limit is None or self.rate_limit * self.tuning.window > self.tuning.tilt:
            return ()
        return self._failing("scatter", "vertical")

    def _failing(self, *criteria: Fails) -> tuple[Stretch, ...]:
        return tuple(stretch for stretch in self.rejected if stretch.fails in criteria)

    @property
    def _too_short(self) -> str:
        return f"too short: rests of {self.tuning.rest_seconds} s are long enough"

    def passed_over(self) -> tuple[str, ...]:
        """Return sentences that count the stretches that were nearly rests, by the criterion that they fail."""
        by = "" if self.stated_rate is None else f", by log.rate_hz = {self.stated_rate:g}, which no time confirms"
        sentences = []
        for why, stretches in (
            (self._too_short + by, self._failing("duration")),
            ("discarded because the gyros read otherwise than at rest", self._failing("level")),
            ("shaken: the gyros are at rest, the accelerometers are not; put it where nothing vibrates", self.shaken),
        ):
            if seconds := sorted(r.stop - r.start for r in stretches):
                similar = seconds[-1] - seconds[0] < 0.05
                length = f"{seconds[0]:.1f} s" if similar else f"{seconds[0]:.1f}–{seconds[-1]:.1f} s"
                several = f"{len(seconds)} quiet stretches of {length} are"
                sentences.append(f"{f'a quiet stretch of {length} is' if len(seconds) == 1 else several} {why}")
        return tuple(sentences)

    def unused(self) -> tuple[str, ...]:
        """Return a sentence for each failed criterion, with the times and total duration of the stretches."""
        reasons: dict[Fails, str] = {
            "level": "the accelerometers are quiet, but the gyros read otherwise than at rest",
            "scatter": "the gyros are quiet, but the accelerometers are not",
            "vertical": f"the vertical moves by more than {self.tuning.tilt / DEGREE:g}°",
            "duration": self._too_short,
        }
        sentences = []
        for fails, why in reasons.items():
            if quiet := self._failing(fails):
                spans = ", ".join(f"{r.start:z.1f}–{r.stop:z.1f}" for r in quiet[:LONGEST_LIST])
                more = f" and {len(quiet) - LONGEST_LIST} more" if len(quiet) > LONGEST_LIST else ""
                total, because = sum(r.stop - r.start for r in quiet), quiet[0].reason if len(quiet) == 1 else why
                sentences.append(f"not used as rests: {spans} s{more}, {total:.1f} s in all: {because}")
        return tuple(sentences)


def find_rests(reduction: Reduction, accel: Block, gyro: Block | None) -> Segmentation:
    """Return the rests of a log, or of a part of it, the rejected stretches, and the limits derived from the whole log.

    Without `gyro` the accelerometers alone are used."""
    tuning = reduction.tuning
    usual = _RestSearch(reduction, accel, gyro, tuning).run()
    n_short = sum(r.fails == "duration" and r.stop - r.start >= tuning.short_rest for r in usual.rejected)
    if not usual.rests and not n_short:
        # lower floors, for a device that moves most of the time
        low_floors = _RestSearch(reduction, accel, gyro, replace(tuning, quiet_share=tuning.few_share)).run()
        if low_floors.rests:
            return replace(low_floors, tuning=tuning)
        shortest = replace(tuning, window=tuning.moment, rest=tuning.moment, margin_least=0.0, margin_fraction=0.0)
        moments = _RestSearch(reduction, accel, gyro, shortest).run().rests
        rejected = tuple(Stretch.too_short(reduction.by_file[r.file], (r.first, r.last), tuning) for r in moments)
        return replace(usual, rejected=rejected or usual.rejected)
    if n_short <= 2 * len(usual.rests):
        return usual
    rest = max(tuning.short_rest, tuning.short_samples / reduction.rate)
    short = replace(tuning, window=tuning.short_window, rest=rest, margin_least=tuning.short_margin)
    again = _RestSearch(reduction, accel, gyro, short).run()
    # the usual thresholds are kept for the advice on how long to lie still
    return replace(again, tuning=tuning) if len(again.rests) >= len(usual.rests) + tuning.fewest_short else usual


class _RestSearch:
    """The search of a log with one set of thresholds. Blocks are counted through all files.

    `edges`: first block of each file, and the number of all K blocks. `window`: blocks of a window. `force`, `rate`:
    block means (K, 3) of the specific force, m/s², and of the rate, rad/s (None without gyros), in the body. `start`,
    `stop`: times of the blocks (K,), s. `force_step`, `rate_step`: changes of the means without motion, by the
    resolution of the channels."""

    def __init__(self, reduction: Reduction, accel: Block, gyro: Block | None, tuning: Tuning) -> None:
        self.files, self.tuning, self.usual = reduction.files, tuning, reduction.tuning
        self.edges = np.cumsum([0, *map(len, self.files)]).tolist()
        self.window = max(2, round(tuning.window * reduction.rate / self.files[0].size))
        # column-major: sums over rows of three numbers are slow
        self.force = np.asfortranarray(np.vstack([f.accel.means for f in self.files]) @ onto_body(accel.axes).T)
        self.rate: Array | None = None
        if gyro is not None:
            self.rate = np.asfortranarray(np.vstack([f.gyro.means for f in self.files]) @ onto_body(gyro.axes).T)
        self.start, self.stop = (
            np.concatenate([f.edges[part] for f in self.files]) for part in (slice(-1), slice(1, None))
        )
        self.force_step = ACCEL_ROUNDING + _resolution(reduction.accel_channels)
        self.rate_step = GYRO_ROUNDING + _resolution(reduction.gyro_channels)

    def run(self) -> Segmentation:
        """Carry out all steps of the module docstring but the fifth, which belongs to `find_rests`."""
        tuning, window, rate = self.tuning, self.window, self.rate
        _, scatter = _moving(self.force, window, self.edges)
        floor = self._floor(scatter)
        factor = tuning.floor_factor if rate is None else tuning.scatter_factor
        scatter_limit = factor * floor + self.force_step
        is_calm = scatter < scatter_limit
        if rate is None:
            step = _steps(self.force, window, self.edges)
            is_still = step < tuning.floor_factor * self._floor(step) + self.force_step
            return self._segmentation(self._runs(is_calm & is_still), None, scatter_limit, None, [])
        is_quiet = scatter < tuning.quiet_factor * floor + self.force_step
        spans, is_still, rate_limit = self._find_still(rate, is_calm, is_quiet)
        off = self._find_off_level(rate, is_calm, spans, rate_limit)
        # the limit for levels of whole stretches, from the noise within them
        cores = [slice(*core(i, j, window)) for i, j in (*(s for s in spans if s[1] - s[0] >= 2 * window), *off)]
        noise = [np.sqrt(rate[span].var(axis=0).sum() / window) for span in cores]
        noise_limit = self._rate_limit(np.array([*noise, 0.0]))
        middle = 0.5 * (self.start + self.stop)
        time = (2.0 * middle - middle.min() - middle.max()) / max(float(np.ptp(middle)), 1e-9)
        found = level_function(rate, self.force, time, spans, off, noise_limit, window, tuning)
        step_at, step = np.inf, np.zeros(3)
        if found is not None:
            rate, accepted, step_at, step = found
            spans, is_still, rate_limit = self._find_still(rate, is_calm, is_quiet)
            spans = _overlapping(spans, accepted)
            off = self._find_off_level(rate, is_calm, spans, rate_limit)
        rejected = []
        for span, offset in off.items():
            reason = (
                f"the accelerometers are quiet, but the gyros read {np.linalg.norm(offset) / DEGREE:.2g} °/s off "
                f"their level at rest, more than {rate_limit / DEGREE:.2g} °/s: a slow turn, or a bias that depends on "
                "attitude"
            )
            rejected.append(Stretch.of_blocks(*self._in_file(span), "level", reason))
        for i, j in self._runs(is_still):
            if not is_calm[i:j].any() and self._seconds(i, j) >= tuning.rest:
                reason = f"accelerometer scatter {scatter[i:j].max():.2g} m/s^2 within a second is above "
                reason += f"{scatter_limit:.2g} m/s^2"
                rejected.append(Stretch.of_blocks(*self._in_file((i, j)), "scatter", reason))
        whole = self._segmentation(spans, rate, scatter_limit, rate_limit, rejected)
        first_block = {f.file: edge for f, edge in zip(self.files, self.edges, strict=False)}
        for rest in whole.rests:
            if time[first_block[rest.file] + (rest.first + rest.last) // 2] > step_at:
                return replace(whole, jump=step, jump_at=(rest.file, rest.start))
        return whole  # without a jump, or if all stretches after it are too short

    def _runs(self, flags: BoolArray) -> list[Span]:
        """Return [first, last) of every run of true values within a file."""
        return [(a + i, a + j) for a, b in pairwise(self.edges) for i, j in _runs(flags[a:b])]

    def _seconds(self, first: int, last: int) -> float:
        """Return the duration of blocks first … last − 1 of a file, s."""
        return float(self.stop[last - 1] - self.start[first])

    def _in_file(self, span: Span) -> tuple[FileBlocks, Span]:
        """Return the file of a span, and the span in its blocks."""
        k = bisect_right(self.edges, span[0]) - 1
        return self.files[k], (span[0] - self.edges[k], span[1] - self.edges[k])

    def _find_still(self, rate: Array, is_calm: BoolArray, is_quiet: BoolArray) -> tuple[list[Span], BoolArray, float]:
        """Return the spans that are calm and do not turn, the blocks that do not turn, and the rate limit, rad/s."""
        smooth, _ = _moving(rate, self.window, self.edges)
        quiet = np.concatenate([a + np.flatnonzero(is_quiet[a:b])[:: self.window] for a, b in pairwise(self.edges)])
        level = np.broadcast_to(_densest(smooth[quiet]), smooth.shape)
        spans, is_still, limit = list[Span](), is_calm, 0.0
        for _ in range(5):  # the level follows slow drift from rest to rest
            distance = np.linalg.norm(smooth - level, axis=1)
            limit = self._rate_limit(distance[is_quiet])
            is_still = distance < limit
            previous, spans = spans, self._runs(is_still & is_calm)
            if spans == previous:
                break
            level = self._interpolated_level(rate, spans, level)
        return spans, is_still, limit

    def _find_off_level(self, rate: Array, is_calm: BoolArray, spans: list[Span], limit: float) -> OffLevel:
        """Return quiet, steady stretches whose gyros are off the level at rest by `limit` to `level_spread`, and in
        which the vertical moves less than a turn at that rate would move it."""
        if not spans:
            return {}
        tuning, window, out = self.tuning, self.window, OffLevel()
        default = np.concatenate([rate[i:j] for i, j in spans]).mean(axis=0)
        level = self._interpolated_level(rate, spans, np.broadcast_to(default, rate.shape))
        _, scatter = _moving(rate, window, self.edges)
        for i, j in self._runs(is_calm & (scatter < tuning.scatter_factor * self._floor(scatter))):
            seconds = self._seconds(i, j)
            covered = sum(min(j, b) - max(i, a) for a, b in _overlapping(spans, [(i, j)]))
            if seconds < tuning.rest or j - i < 2 * window or covered > 0.5 * (j - i):
                continue
            offset = rate[slice(*core(i, j, window))].mean(axis=0) - level[(i + j) // 2]
            first, last = self.force[i : i + window].mean(axis=0), self.force[j - window : j].mean(axis=0)
            moved, size = float(np.linalg.norm(last - first)), float(np.linalg.norm(first))
            by_turn = float(np.linalg.norm(np.cross(offset, first))) * (seconds - tuning.window)
            vertical_stays = moved < max(tuning.vertical_moves * by_turn, tuning.vertical_stays * size)
            if limit < float(np.linalg.norm(offset)) < tuning.level_spread and vertical_stays:
                out[i, j] = offset
        return out

    def _rate_limit(self, distances: Array) -> float:
        """Return the largest distance of the gyros from their level at rest, rad/s, given those of quiet blocks."""
        return self.tuning.floor_factor * self._floor(distances) + 2.0 * EARTH_RATE + self.rate_step

    def _floor(self, values: Array) -> float:
        """Return the median of positive values clipped at `floor_factor` medians, started from `quiet_share`."""
        floor = float(np.quantile(values, self.tuning.quiet_share))
        for _ in range(50):
            median = float(np.median(values[values <= self.tuning.floor_factor * floor]))
            if abs(median - floor) <= 1e-6 * floor:
                break
            floor = median
        return floor

    def _interpolated_level(self, rate: Array, spans: list[Span], default: Array) -> Array:
        """Return the gyro level (K, 3) at every block, interpolated between the means of long spans of its file."""
        out = default.copy()
        for a, b in pairwise(self.edges):
            long = [(i, j) for i, j in spans if a <= i < b and j - i >= self.tuning.level_blocks]
            if long:
                centres, means = [0.5 * (i + j) for i, j in long], np.array([rate[i:j].mean(axis=0) for i, j in long])
                out[a:b] = np.column_stack([np.interp(np.arange(a, b), centres, column) for column in means.T])
        return out

    def _segmentation(
        self,
        spans: list[Span],
        rate: Array | None,
        scatter_limit: float,
        rate_limit: float | None,
        rejected: list[Stretch],
    ) -> Segmentation:
        """Extend the spans, remove the margins, and keep those that are long enough and do not tilt."""
        tuning, rests = self.tuning, list[Stretch]()
        for span in self._divided_at_steps(self._extended(spans, rate), rate):
            (f, (first, last)), force, duration = self._in_file(span), self.force[slice(*span)], self._seconds(*span)
            margin = tuning.margin_of(duration)
            before, after = margin if first > 0 else 0.0, margin if last < len(f) else 0.0
            rest = Stretch.between(f, f.edges[first] + before, f.edges[last] - after)
            too_short = duration - before - after < tuning.rest - 1e-9
            mean = force.mean(axis=0)
            off = np.linalg.norm(_moving(force, self.window, [0, len(force)])[0] - mean, axis=1).max()
            tilt = float(off / np.linalg.norm(mean))
            warming = 0.0 if f.temperature is None else float(np.ptp(f.temperature[first:last], axis=0).max())
            tilt_limit = tuning.tilt + tuning.tilt_per_kelvin * warming
            if too_short or rest.last - rest.first < tuning.fewest_blocks:
                if duration > 0.5:  # s: a shorter one is no attempt at a rest
                    rejected.append(Stretch.too_short(f, (first, last), self.usual))
            elif tilt > tilt_limit:
                at_most = f"in a rest at most {tilt_limit / DEGREE:.2g}°"
                reason = f"the vertical moves by {tilt / DEGREE:.0f}°, {at_most}"
                rejected.append(Stretch.of_blocks(f, (first, last), "vertical", reason))
            else:
                rests.append(replace(rest, reaches_end=f is self.files[-1] and rest.last >= len(f) - 1))
        return Segmentation(
            rests=tuple(rests),
            still_at_end=bool(rests) and rests[-1].reaches_end,
            rejected=tuple(sorted(rejected, key=lambda r: (r.file, r.start))),
            rate_limit=rate_limit,
            scatter_limit=scatter_limit,
            tuning=tuning,
        )

    def _extended(self, spans: list[Span], rate: Array | None) -> list[Span]:
        """Move the ends of spans, blurred by half a window, to where single blocks are more than `edge` standard
        deviations off the mean of the span, and merge those that overlap."""
        merged = list[Span]()
        for start, stop in sorted(self._extended_span(span, rate) for span in spans):
            if merged and start < merged[-1][1]:
                merged[-1] = merged[-1][0], max(stop, merged[-1][1])
            elif stop > start:
                merged.append((start, stop))
        return merged

    def _extended_span(self, span: Span, rate: Array | None) -> Span:
        """Return a span with its ends moved."""
        first, last = span
        tenth, half = (last - first) // 10, min(self.window, last - first) // 2
        k = bisect_right(self.edges, first)  # the file is blocks edges[k − 1] … edges[k] − 1
        signals = []
        for values, rounding in ((self.force, self.force_step), (rate, self.rate_step)):
            if values is not None:
                inner = values[first + tenth : last - tenth]
                limit = self.tuning.edge * np.sqrt(inner.var(axis=0).sum()) + rounding
                signals.append((values, inner.mean(axis=0), limit))

        def end(block: int, way: int) -> int:
            """Return the first block unlike the span, backwards (way = −1) or forwards (1) from one within it."""
            while True:
                edge = min(max(block + way * EXTENSION_STRIDE, self.edges[k - 1]), self.edges[k])
                rows = slice(min(edge, block), max(edge, block))
                like = [np.linalg.norm(values[rows] - mean, axis=1) <= limit for values, mean, limit in signals]
                unlike = np.flatnonzero(~np.logical_and.reduce(like)[::way])
                if edge == block or len(unlike):
                    return block + way * int(unlike[0]) if len(unlike) else block
                block = edge

        return end(first + half, -1), end(last - half, 1)

    def _divided_at_steps(self, spans: list[Span], rate: Array | None) -> list[Span]:
        """Divide spans in which a reading steps to another level, as by a knock or a jump of a bias (step 7)."""
        readings = self.force if rate is None else np.hstack([self.force, rate])
        resolution = np.repeat([self.force_step, self.rate_step], 3)[: readings.shape[1]]
        blurred = self.window // 2  # blocks at either end of a span that may belong to a turn
        inner = {(first, last): readings[first + blurred : last - blurred] for first, last in spans}
        side = max(self.window, int(np.median([len(part) for part in inner.values()] or [0])) // 8)
        inner = {span: part for span, part in inner.items() if len(part) >= 6 * side}
        if sum(map(len, inner.values())) < FEWEST_CHANGES * side:
            return spans
        usual = np.median(np.abs(np.concatenate([_changes(part, side) for part in inner.values()])), axis=0)
        divided = list[Span]()
        for first, last in spans:
            part = inner.get((first, last))
            at = None if part is None else self._step_in(part, side, usual, resolution)
            divided += pairwise([first, last] if at is None else [first, first + blurred + at, last])
        return divided

    def _step_in(self, readings: Array, side: int, usual: Array, resolution: Array) -> int | None:
        """Return the block at which one of the readings (m, c) steps to another level, None if none does.

        `usual`: median sizes (c,) of the changes over `side` blocks in all rests."""
        change = _changes(readings, side)
        beyond = (np.abs(change) - resolution) / np.maximum(usual, 1e-300)
        row, c = np.unravel_index(np.argmax(beyond), beyond.shape)
        step, at, reading = change[row, c], side + int(row), readings[:, [c]]
        without_step = _changes(reading - step * (np.arange(len(reading))[:, None] >= at), side)
        sigma = max(usual[c], float(np.median(np.abs(without_step)))) / NORMAL_MEDIAN
        third = max(side // 3, 1)
        near = reading[at : at + third].mean() - reading[at - third : at].mean()
        whole = reading[at:].mean() - reading[:at].mean()
        is_large = abs(step) - resolution[c] > self.tuning.step_beyond * sigma
        return at if is_large and near / step > 0.5 and 0.5 < whole / step < 2.0 else None


def _overlapping(spans: list[Span], others: list[Span]) -> list[Span]:
    """Return the spans that overlap one of the others."""
    return [(i, j) for i, j in spans if any(i < b and a < j for a, b in others)]


def _resolution(channels: Sequence[ChannelState]) -> float:
    """Return the change of a vector by one step of all its channels."""
    return float(np.linalg.norm([channel.step for channel in channels if np.isfinite(channel.step)]))


def _moving(values: Array, window: int, edges: Sequence[int]) -> tuple[Array, Array]:
    """Return the mean (K, n) over `window` rows about each row, at the ends over the first and the last `window` rows,
    and the root of the summed variances of the columns (K,) over the same rows; `edges` as in `_RestSearch`."""
    window = min(window, len(values))
    mean = sliding_mean(values, window)
    scatter = np.sqrt(sliding_variance(values, mean, window).sum(axis=1))
    about = _rows_about(edges, window // 2, window)
    return mean[about], scatter[about]


def _steps(values: Array, window: int, edges: Sequence[int]) -> Array:
    """Return the size (K,) of the change of the mean from the `window` rows before each row to those after it."""
    width = min(window, len(values) // 2)
    mean = sliding_mean(values, width)
    step = np.linalg.norm(mean[width:] - mean[:-width], axis=1)
    return np.asarray(step[_rows_about(edges, width, 2 * width)])


def _rows_about(edges: Sequence[int], before: int, size: int) -> IntArray:
    """Return the first of `size` rows about each row (K,), of which `before` are before it, within its file if that is
    long enough."""
    rows = [np.clip(np.arange(a, b) - before, a, max(b - size, a)) for a, b in pairwise(edges)]
    return np.minimum(np.concatenate(rows), edges[-1] - size)


def _changes(values: Array, side: int) -> Array:
    """Return the means over `side` rows less those over `side` rows before them (m, c)."""
    total = np.cumsum(np.vstack([values[:1], values]) - values[0], axis=0)
    return np.asarray(total[2 * side :] - 2.0 * total[side:-side] + total[: -2 * side]) / side


def sliding_mean(values: Array, window: int) -> Array:
    """Return the mean of every `window` consecutive rows."""
    out = np.zeros((len(values) - window + 1, values.shape[1]), order="F")
    for i in range(window):
        out += values[i : len(out) + i]
    return out / window


def sliding_variance(values: Array, mean: Array, window: int) -> Array:
    """Return the variance of every `window` consecutive rows about their mean."""
    out = np.zeros_like(mean)
    for i in range(window):
        out += (values[i : len(out) + i] - mean) ** 2
    return out / window


def _densest(points: Array) -> Array:
    """Return the point with the nearest neighbours among at most DENSITY_POINTS evenly spread ones."""
    points = points[:: -(-len(points) // DENSITY_POINTS)]
    neighbour = min(len(points) - 1, max(3, len(points) // 20))
    squares = sum(np.subtract.outer(column, column) ** 2 for column in points.T)
    return np.asarray(points[np.argmin(np.partition(squares, neighbour, axis=1)[:, neighbour])])


def _runs(flags: BoolArray) -> list[Span]:
    """Return [first, last) of every run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
    return [(int(i), int(j)) for i, j in edges.reshape(-1, 2)]
