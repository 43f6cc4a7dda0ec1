"""Rests and turns in a log.

`find_rests` works on the blocks of a `Reduction` and sets its limits from the whole log, by its `Tuning`:

1. The level of the gyros at rest is the densest point of the one-second means of the angular rate where the
   accelerometers are quiet, their scatter within `quiet_factor` of its floor: turns have many directions, rests all
   read the bias (and the Earth's rate, within 2Ω), and slow turns that take most of the log are not quiet.
2. The noise floor of the distance from that level is a clipped median, started from the tenth percentile,
   or, where no rest is found with that, from the second: a device in the hand rests but now and then. A
   block belongs to a rest where the distance is below `floor_factor` floors (and 2Ω for the Earth's rate), and
   the scatter of the accelerometers in the same second below `scatter_factor` of its own floor. Vibration that
   averages out over a second raises both floors and their quantities alike, so nothing has to be set by hand.
   The level follows slow drift: it is interpolated between the rests found, and the search repeated.
3. A rest is extended block by block while single blocks stay within `edge` sigmas of its own mean, then
   shortened by a margin for settling at both ends, except where the file itself begins or ends. What lies between two
   rests of a file is a turn.
4. Gyros that feel specific force have another level in every attitude, those that warm in every rest. Quiet and steady
   stretches off the level are therefore examined again (`gyro_levels`): where a linear function of the specific force
   and of time explains the levels, it is subtracted from the rates, and steps 1 and 2 are repeated. A stretch is
   accepted only if the others predict its level: a slow turn about the vertical stays a turn.
5. A recording whose stretches are nearly all too short was made so: it is searched again with windows of half a second
   and margins of a tenth, and a rest then has at least `short_rest` between these. One in which nothing rests is
   searched for moments of rest with windows of two tenths, only to say that they are too short.
6. A stretch in which the vertical moves by more than `tilt`, and by what the biases of accelerometers change with its
   temperature, is no rest: where nothing rests, the floors are those of the movement.

Without gyros the accelerometers decide alone: by their scatter, and by the step between the means of two neighbouring
seconds, which shows a turn about a nearly vertical axis by the little it tilts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from tumble.earth import EARTH_RATE
from tumble.programme.positions import Programme
from tumble.recording.rows.gaps import Gap
from tumble.reduction.blocks.reducer import FileBlocks, Reduction
from tumble.reduction.blocks.tuning import USUAL, Tuning
from tumble.reduction.rests.gyro_levels import OffLevel, Span, core, level_function, times_of
from tumble.rotation import onto_body
from tumble.sensors.model import Block
from tumble.units import DEGREE, Array, BoolArray, IntArray

DENSITY_POINTS = 1000
AT_A_TIME = 16
"""Points whose distances from all others stay in the cache."""
ACCEL_ROUNDING = 1e-5  # m/s²: what single-precision increments leave in a block mean
GYRO_ROUNDING = 1e-7  # rad/s
MOST_SPANS = 20
"""Stretches that are listed one by one."""
_STRIDE = 256
"""Blocks that are looked at together where a stretch is extended."""

Fails = Literal["duration", "scatter", "vertical", "level"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Stretch:
    """A quiet stretch of a log: a rest, or what fails to be one.

    `file`, `first`, `last`: blocks first … last − 1 of a file. `start`, `stop`: its times, s. `lasts`: whether it
    reaches the end of the log, but for a single block, which may be off by chance. `fails`: what keeps it from being a
    rest, None of a rest: its duration, the scatter of the accelerometers, the constancy of the vertical or the level of
    the gyros. `reason`: the same in words, with the number that decided."""

    json_fields: ClassVar = ("file", "start", "stop", "fails", "reason")

    file: int
    first: int
    last: int
    start: float
    stop: float
    lasts: bool = False
    fails: Fails | None = None
    reason: str = ""

    @staticmethod
    def between(f: FileBlocks, start: float, stop: float) -> Stretch:
        """The whole blocks between two times of a file, s."""
        first = int(np.searchsorted(f.edges, start - 1e-9))
        last = int(np.searchsorted(f.edges, stop + 1e-9, side="right")) - 1
        return Stretch.of_blocks(f, (first, last))

    @staticmethod
    def of_blocks(f: FileBlocks, span: Span) -> Stretch:
        """The blocks of a span of a file."""
        start, stop = (float(f.edges[i]) for i in span)
        return Stretch(file=f.file, first=span[0], last=span[1], start=start, stop=stop)

    @staticmethod
    def rejected(f: FileBlocks, span: Span, fails: Fails, reason: str) -> Stretch:
        """The blocks of a span of a file, which are no rest."""
        return replace(Stretch.of_blocks(f, span), fails=fails, reason=reason)

    @staticmethod
    def too_short(f: FileBlocks, span: Span, tuning: Tuning) -> Stretch:
        """The blocks of a span of a file in which nothing moves, but not for long enough."""
        reason = f"{f.edges[span[1]] - f.edges[span[0]]:.1f} s is too short: rests of {tuning.still} s are long enough"
        return Stretch.rejected(f, span, "duration", reason)


def unrecorded(before: Stretch, after: Stretch, samples: int, what: str, why: str) -> Gap:
    """The gap that a turn between two rests is, if it counts as not recorded because of so many of its samples."""
    at, stop = before.stop, after.start
    return Gap(file=before.file, row=0, time=at, samples=samples, what=what, stop=stop, integrable=False, why=why)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LevelJump:
    """A jump of the level of the gyros at rest, by a `step` (3,), rad/s, at the beginning of a rest: its file and time,
    s."""

    file: int
    time: float
    step: Array


@dataclass(frozen=True, kw_only=True, slots=True)
class Segmentation:
    """The rests of a log.

    `rests`, `rejected`: the rests, and the quiet stretches that are none, in the order of time. `rate_limit`,
    `scatter_limit`: distance of the rate from its level at rest, rad/s, and scatter of the specific force, m/s², up
    to which nothing moves, the first None without gyros. `jump`: where the level of the gyros at rest jumps.
    `stated_rate`: samples per second, Hz, where no time in the log shows them: what is a second, and so a rest,
    hangs on it. `tuning`: thresholds of the search. `still`: whether nothing moves at the end of the log.
    `programme`, `position`: the programme that the rests were matched to, and the index (N,) of the position of
    each in it."""

    json_fields: ClassVar = ("scatter_limit", "rate_limit", "rejected")

    rests: tuple[Stretch, ...]
    rejected: tuple[Stretch, ...]
    rate_limit: float | None
    scatter_limit: float
    jump: LevelJump | None = None
    stated_rate: float | None = None
    tuning: Tuning = USUAL
    still: bool = False
    programme: Programme | None = None
    position: IntArray | None = None

    @property
    def lasting(self) -> bool:
        """Whether the last of the rests reaches the end of the log."""
        return bool(self.rests) and self.rests[-1].lasts

    def jumped(self) -> tuple[str, ...]:
        """A sentence on a jump of the level of the gyros between two of the rests, and what to do; none without it."""
        jump = self.jump
        before = 0 if jump is None else sum((r.file, r.start) < (jump.file, jump.time) for r in self.rests)
        if jump is None or not 0 < before < len(self.rests):
            return ()
        size = float(np.linalg.norm(jump.step))
        return (
            f"the level of the gyros at rest jumps by {size / DEGREE:.2g} °/s between rest {before} (to "
            f"{self.rests[before - 1].stop:z.1f} s) and rest {before + 1} (from {self.rests[before].start:z.1f} s) and "
            "stays there: a driver that measured the bias anew, or another device; calibrate the "
            f"{before} rests before it and the {len(self.rests) - before} after it as launches of their own, each with "
            "the times of the others in [[exclude]]",
        )

    @property
    def shaken(self) -> tuple[Stretch, ...]:
        """Stretches that are rests by the gyros, while the accelerometers are shaken. None where the gyros at rest are
        known so badly that in a window a device may turn by more than a rest may tilt: then it moves."""
        if self.rate_limit is None or self.rate_limit * self.tuning.window > self.tuning.tilt:
            return ()
        return tuple(stretch for stretch in self.rejected if stretch.fails in ("scatter", "vertical"))

    def passed_over(self) -> tuple[str, ...]:
        """Sentences that count the quiet stretches that were nearly rests: too short, off the level of the gyros, or
        shaken."""
        by = "" if self.stated_rate is None else f", by log.rate_hz = {self.stated_rate:g}, which no time confirms"
        too_short, off_level = (tuple(r for r in self.rejected if r.fails == fails) for fails in ("duration", "level"))
        reasons = {
            f"too short: rests of {self.tuning.still} s are long enough{by}": too_short,
            "discarded because the gyros read otherwise than at rest": off_level,
            "shaken: the gyros are at rest, the accelerometers are not; put it where nothing vibrates": self.shaken,
        }
        sentences = []
        for why, stretches in reasons.items():
            if seconds := sorted(r.stop - r.start for r in stretches):
                alike = seconds[-1] - seconds[0] < 0.05
                length = f"{seconds[0]:.1f} s" if alike else f"{seconds[0]:.1f}–{seconds[-1]:.1f} s"
                many = f"{len(seconds)} quiet stretches of {length} are"
                sentences.append(f"{f'a quiet stretch of {length} is' if len(seconds) == 1 else many} {why}")
        return tuple(sentences)

    def unused(self) -> tuple[str, ...]:
        """A sentence for each reason why quiet stretches are no rests, with their times and duration."""
        reasons: dict[Fails, str] = {
            "level": "the accelerometers are quiet, but the gyros read otherwise than at rest",
            "scatter": "the gyros are quiet, but the accelerometers are not",
            "vertical": f"the vertical moves by more than {self.tuning.tilt / DEGREE:g}°",
            "duration": f"too short: rests of {self.tuning.still} s are long enough",
        }
        sentences = []
        for fails, why in reasons.items():
            if quiet := [r for r in self.rejected if r.fails == fails]:
                spans = ", ".join(f"{r.start:z.1f}–{r.stop:z.1f}" for r in quiet[:MOST_SPANS])
                more = f" and {len(quiet) - MOST_SPANS} more" if len(quiet) > MOST_SPANS else ""
                total, because = sum(r.stop - r.start for r in quiet), quiet[0].reason if len(quiet) == 1 else why
                sentences.append(f"not used as rests: {spans} s{more}, {total:.1f} s in all: {because}")
        return tuple(sentences)


def find_rests(reduction: Reduction, accel: Block, gyro: Block | None) -> Segmentation:
    """Find the rests of a log, or of a part of it.

    Parameters
    ----------
    reduction
        The blocks of the log, with the thresholds of the search.
    accel, gyro
        The accelerometers and the gyros. None where the accelerometers are to decide alone.

    Returns
    -------
    Segmentation
        The rests, the stretches that are none, and the thresholds that were set from the whole log.
    """
    tuning = reduction.tuning
    usual = _RestSearch(reduction, accel, gyro, tuning).rests()
    short = sum(r.fails == "duration" and r.stop - r.start >= tuning.short_rest for r in usual.rejected)
    if not usual.rests and not short:
        few = _RestSearch(reduction, accel, gyro, tuning.for_few_rests).rests()
        if few.rests:
            return replace(few, tuning=tuning)
        moments = _RestSearch(reduction, accel, gyro, tuning.for_moments).rests().rests
        rejected = tuple(
            Stretch.too_short(reduction.by_file[one.file], (one.first, one.last), tuning) for one in moments
        )
        return replace(usual, rejected=rejected or usual.rejected)
    if short <= 2 * len(usual.rests):
        return usual
    again = _RestSearch(reduction, accel, gyro, tuning.for_short_rests(reduction.rate)).rests()
    # the advice how long to lie still is that for any other recording
    return replace(again, tuning=tuning) if len(again.rests) >= len(usual.rests) + tuning.fewest_short else usual


class _RestSearch:
    """The search of a log with one set of thresholds.

    `window`: blocks of a window. `forces`, `rates`: by file the block means (K, 3) of the specific force, m/s², and
    of the rate, rad/s, in the body. No rates without gyros. `force_step`, `rate_step`: changes of these by the
    resolution of the channels, without movement."""

    def __init__(self, reduction: Reduction, accel: Block, gyro: Block | None, tuning: Tuning) -> None:
        self.files, self.tuning, self.usual = reduction.files, tuning, reduction.tuning
        self.window = max(2, round(tuning.window * reduction.rate / self.files[0].size))
        # column after column in memory: sums over three numbers a row are slow
        self.forces = [np.asfortranarray(f.accel.means @ onto_body(accel.axes).T) for f in self.files]
        self.rates: list[Array] | None = None
        if gyro is not None:
            self.rates = [np.asfortranarray(f.gyro.means @ onto_body(gyro.axes).T) for f in self.files]
        self.force_step, self.rate_step = (
            rounding + float(np.linalg.norm([channel.step for channel in channels if np.isfinite(channel.step)]))
            for rounding, channels in (
                (ACCEL_ROUNDING, reduction.accel_channels),
                (GYRO_ROUNDING, reduction.gyro_channels),
            )
        )

    def rests(self) -> Segmentation:
        """Steps 1 to 4 and 6 of the module docstring."""
        tuning, window, rates = self.tuning, self.window, self.rates
        scatter = [_moving_scatter(force, window) for force in self.forces]
        floor = self._floor(np.concatenate(scatter))
        factor = tuning.floor_factor if rates is None else tuning.scatter_factor
        scatter_limit = factor * floor + self.force_step
        calm = [s < scatter_limit for s in scatter]
        if rates is None:
            step = []  # between the means of the windows before and after each block, at the ends that of the nearest
            for force in self.forces:
                wide = min(window, len(force) // 2)
                mean = inner_mean(force, wide)
                steps = np.linalg.norm(mean[wide:] - mean[:-wide], axis=1)
                step.append(steps[np.clip(np.arange(len(force)) - wide, 0, len(steps) - 1)])
            step_limit = tuning.floor_factor * self._floor(np.concatenate(step)) + self.force_step
            spans = [_runs(c & (s < step_limit)) for c, s in zip(calm, step, strict=True)]
            return self._assembled(spans, None, scatter_limit, None, [])
        quiet = [s < tuning.quiet_factor * floor + self.force_step for s in scatter]
        spans, unmoved, rate_limit = self._still(rates, calm, quiet)
        off = self._off_level(rates, calm, spans, rate_limit)
        # the limit for levels of whole stretches, from the noise within them
        stretches = [(k, i, j) for k, of_file in enumerate(spans) for i, j in of_file if j - i >= 2 * window]
        stretches += [(s.place, s.first, s.last) for s in off]
        noise = [np.sqrt(rates[k][slice(*core(i, j, window))].var(axis=0).sum() / window) for k, i, j in stretches]
        noise_limit = self._rate_limit(np.array([*noise, 0.0]))
        goes_with = self.forces, times_of([f.edges for f in self.files])
        level = level_function(rates, goes_with, spans, off, noise_limit, window, tuning)
        if level is not None:
            rates = level.without(rates, *goes_with)
            spans, unmoved, rate_limit = self._still(rates, calm, quiet)
            spans = [_overlapping(new, like) for new, like in zip(spans, level.accepted, strict=True)]
            off = self._off_level(rates, calm, spans, rate_limit)
        rejected = []
        for s in off:
            reason = (
                f"the accelerometers are quiet, but the gyros read {np.linalg.norm(s.rate) / DEGREE:.2g} °/s off "
                f"their level at rest, more than {rate_limit / DEGREE:.2g} °/s: a slow turn, or a bias that depends on "
                "attitude"
            )
            rejected.append(Stretch.rejected(self.files[s.place], (s.first, s.last), "level", reason))
        for f, shaken, still, c in zip(self.files, scatter, unmoved, calm, strict=True):
            for i, j in still:
                if not c[i:j].any() and f.edges[j] - f.edges[i] >= tuning.rest:
                    reason = f"accelerometer scatter {shaken[i:j].max():.2g} m/s^2 within a second is above "
                    rejected.append(Stretch.rejected(f, (i, j), "scatter", f"{reason}{scatter_limit:.2g} m/s^2"))
        whole = self._assembled(spans, rates, scatter_limit, rate_limit, rejected)
        if level is None or not np.any(level.step):
            return whole
        time = dict(zip((f.file for f in self.files), goes_with[1], strict=True))
        later = [r for r in whole.rests if float(time[r.file][(r.first + r.last) // 2]) > level.step_at]
        if not later:  # only stretches that are too short for a rest have the other level
            return whole
        return replace(whole, jump=LevelJump(file=later[0].file, time=later[0].start, step=level.step))

    def _still(
        self, rates: list[Array], calm: list[BoolArray], quiet: list[BoolArray]
    ) -> tuple[list[list[Span]], list[list[Span]], float]:
        """Stretches of blocks, by file, that are calm and do not turn, those that only do not turn, and the limit of
        the rate, rad/s."""
        smooth = [_moving_mean(w, self.window) for w in rates]
        in_quiet = np.concatenate(quiet)
        densest = _densest(np.concatenate([s[q][:: self.window] for s, q in zip(smooth, quiet, strict=True)]))
        level = [np.broadcast_to(densest, s.shape) for s in smooth]
        spans: list[list[Span]] = [[] for _ in rates]
        still, limit = calm, 0.0
        for _ in range(5):  # the level follows slow drift from rest to rest
            distance = [np.linalg.norm(s - at, axis=1) for s, at in zip(smooth, level, strict=True)]
            limit = self._rate_limit(np.concatenate(distance)[in_quiet])
            still = [d < limit for d in distance]
            before, spans = spans, [_runs(s & c) for s, c in zip(still, calm, strict=True)]
            if spans == before:
                break
            level = [self._interpolated_level(w, s, at) for w, s, at in zip(rates, spans, level, strict=True)]
        return spans, [_runs(s) for s in still], limit

    def _off_level(
        self, rates: list[Array], calm: list[BoolArray], spans: list[list[Span]], limit: float
    ) -> list[OffLevel]:
        """Quiet stretches with steady gyros, off their level at rest by more than `limit` and less than `level_spread`,
        in which the vertical moves by less than a turn of that rate would move it."""
        tuning, window = self.tuning, self.window
        at_rest = [w[i:j] for w, of_file in zip(rates, spans, strict=True) for i, j in of_file]
        if not at_rest:
            return []
        default = np.concatenate(at_rest).mean(axis=0)
        scatter = [_moving_scatter(w, window) for w in rates]
        steady_limit = tuning.scatter_factor * self._floor(np.concatenate(scatter))
        out = []
        for k, (f, w, s, c, force) in enumerate(zip(self.files, rates, scatter, calm, self.forces, strict=True)):
            level = self._interpolated_level(w, spans[k], np.broadcast_to(default, w.shape))
            for i, j in _runs(c & (s < steady_limit)):
                seconds = float(f.edges[j] - f.edges[i])
                covered = sum(min(j, b) - max(i, a) for a, b in _overlapping(spans[k], [(i, j)]))
                if seconds < tuning.rest or j - i < 2 * window or covered > 0.5 * (j - i):
                    continue
                rate = w[slice(*core(i, j, window))].mean(axis=0) - level[(i + j) // 2]
                first, last = force[i : i + window].mean(axis=0), force[j - window : j].mean(axis=0)
                moved, size = float(np.linalg.norm(last - first)), float(np.linalg.norm(first))
                turned = float(np.linalg.norm(np.cross(rate, first))) * (seconds - tuning.window)
                stays = moved < max(tuning.vertical_moves * turned, tuning.vertical_stays * size)
                if limit < float(np.linalg.norm(rate)) < tuning.level_spread and stays:
                    out.append(OffLevel(place=k, first=i, last=j, rate=rate))
        return out

    def _rate_limit(self, distances: Array) -> float:
        """The largest distance of the gyros from their level at rest, rad/s, from the distances of quiet blocks."""
        return self.tuning.floor_factor * self._floor(distances) + 2.0 * EARTH_RATE + self.rate_step

    def _floor(self, values: Array) -> float:
        """The level of the quiet part of a positive quantity: a median clipped at `floor_factor` times itself, started
        from the quantile `quiet_share`."""
        floor = float(np.quantile(values, self.tuning.quiet_share))
        for _ in range(50):
            median = float(np.median(values[values <= self.tuning.floor_factor * floor]))
            if abs(median - floor) <= 1e-6 * floor:
                break
            floor = median
        return floor

    def _interpolated_level(self, rate: Array, spans: list[Span], default: Array) -> Array:
        """The gyro level of every block, interpolated between the means of the stretches found."""
        long = [(i, j) for i, j in spans if j - i >= self.tuning.level_blocks]
        if not long:
            return default
        centres = np.array([0.5 * (i + j) for i, j in long])
        means = np.array([rate[i:j].mean(axis=0) for i, j in long])
        return np.column_stack([np.interp(np.arange(len(rate)), centres, column) for column in means.T])

    def _assembled(
        self,
        spans: list[list[Span]],
        rates: list[Array] | None,
        scatter_limit: float,
        rate_limit: float | None,
        rejected: list[Stretch],
    ) -> Segmentation:
        """Extend the stretches, remove the margins, and keep those that are long enough and do not tilt."""
        tuning, rests = self.tuning, list[Stretch]()
        for k, (f, force) in enumerate(zip(self.files, self.forces, strict=True)):
            signals = [(force, self.force_step)] + ([] if rates is None else [(rates[k], self.rate_step)])
            joined: list[Span] = []
            for first, last in sorted(self._extended(signals, i, j) for i, j in spans[k]):
                if joined and first < joined[-1][1]:
                    joined[-1] = joined[-1][0], max(last, joined[-1][1])
                elif last > first:
                    joined.append((first, last))
            for first, last in joined:
                duration = float(f.edges[last] - f.edges[first])
                margin = tuning.margin_of(duration)
                before, after = margin if first > 0 else 0.0, margin if last < len(f) else 0.0
                span = Stretch.between(f, f.edges[first] + before, f.edges[last] - after)
                too_short = duration - before - after < tuning.rest - 1e-9
                mean = force[first:last].mean(axis=0)
                off = np.linalg.norm(_moving_mean(force[first:last], self.window) - mean, axis=1).max()
                tilt = float(off / np.linalg.norm(mean))
                warmed = 0.0 if f.temperature is None else float(np.ptp(f.temperature[first:last], axis=0).max())
                if too_short or span.last - span.first < tuning.fewest_blocks:
                    if duration > 0.5:
                        rejected.append(Stretch.too_short(f, (first, last), self.usual))
                elif tilt > (limit := tuning.tilt + tuning.tilt_per_kelvin * warmed):
                    at_most = f"in a rest at most {limit / DEGREE:.2g}°"
                    reason = f"the vertical moves by {tilt / DEGREE:.0f}°, {at_most}"
                    rejected.append(Stretch.rejected(f, (first, last), "vertical", reason))
                else:
                    rests.append(replace(span, lasts=f is self.files[-1] and span.last >= len(f) - 1))
        return Segmentation(
            rests=tuple(rests),
            still=bool(rests) and rests[-1].lasts,
            rejected=tuple(sorted(rejected, key=lambda r: (r.file, r.start))),
            rate_limit=rate_limit,
            scatter_limit=scatter_limit,
            tuning=tuning,
        )

    def _extended(self, signals: list[tuple[Array, float]], first: int, last: int) -> Span:
        """A stretch of blocks whose ends are where single blocks are more than `edge` sigmas of its scatter off: the
        moving window has blurred them by half its length."""
        tenth = (last - first) // 10
        cores = [values[first + tenth : last - tenth] for values, _ in signals]
        means, sigmas = [core.mean(axis=0) for core in cores], [np.sqrt(core.var(axis=0).sum()) for core in cores]

        def end(block: int, way: int) -> int:
            """The first block that is unlike the stretch, backwards (−1) or forwards (1) from one within it."""
            while True:
                rows = slice(max(0, block - _STRIDE), block) if way < 0 else slice(block, block + _STRIDE)
                each = [
                    np.linalg.norm(values[rows] - mean, axis=1) <= self.tuning.edge * sigma + rounding
                    for (values, rounding), mean, sigma in zip(signals, means, sigmas, strict=True)
                ]
                inside = np.logical_and.reduce(each)[::way]
                alike = len(inside) if inside.all() else int(np.argmin(inside))
                block += way * alike
                if alike < _STRIDE:
                    return block

        half = min(self.window, last - first) // 2
        return end(first + half, -1), end(last - half, 1)


def _overlapping(spans: list[Span], others: list[Span]) -> list[Span]:
    """The spans that overlap one of the others."""
    return [(i, j) for i, j in spans if any(i < b and a < j for a, b in others)]


def _moving_mean(values: Array, window: int) -> Array:
    """Mean over the `window` rows about each row, at the ends over the first and the last `window` rows."""
    window = min(window, len(values))
    return inner_mean(values, window)[_window_of(len(values), window)]


def _moving_scatter(values: Array, window: int) -> Array:
    """Root of the summed variances of the columns in the same windows."""
    window = min(window, len(values))
    variance = inner_variance(values, inner_mean(values, window), window).sum(axis=1)
    return np.asarray(np.sqrt(variance)[_window_of(len(values), window)])


def inner_mean(values: Array, window: int) -> Array:
    """Mean of every `window` consecutive rows."""
    out = np.zeros((len(values) - window + 1, values.shape[1]), order="F")
    for i in range(window):
        out += values[i : len(out) + i]
    return out / window


def inner_variance(values: Array, mean: Array, window: int) -> Array:
    """Variance of every `window` consecutive rows about their mean."""
    out = np.zeros_like(mean)
    for i in range(window):
        out += (values[i : len(out) + i] - mean) ** 2
    return out / window


def _window_of(rows: int, window: int) -> IntArray:
    """First row of the window that belongs to each row."""
    return np.clip(np.arange(rows) - window // 2, 0, rows - window)


def _densest(points: Array) -> Array:
    """The point of a cloud with the nearest neighbours, from at most DENSITY_POINTS of them evenly spread."""
    points = points[:: -(-len(points) // DENSITY_POINTS)]
    neighbour, nearest = min(len(points) - 1, max(3, len(points) // 20)), []
    for i in range(0, len(points), AT_A_TIME):
        some = points[i : i + AT_A_TIME]
        squares = sum((own[:, None] - column) ** 2 for own, column in zip(some.T, points.T, strict=True))
        nearest.append(np.partition(squares, neighbour, axis=1)[:, neighbour])
    return np.asarray(points[np.argmin(np.concatenate(nearest))])


def _runs(flags: BoolArray) -> list[Span]:
    """[first, last) of every row of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
    return [(int(i), int(j)) for i, j in edges.reshape(-1, 2)]
