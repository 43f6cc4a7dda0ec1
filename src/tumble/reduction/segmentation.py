"""Rests and turns in a log.

`find_rests` works on the blocks of a `Reduction` and sets its thresholds from the whole log:

1. The level of the gyros at rest is the densest point of the one-second means of the angular rate where the
   accelerometers are quiet, their scatter within QUIET_FACTOR of its floor: turns go many ways, rests all read the
   bias (and the Earth's rate, within 2Ω), and slow turns that take most of the log are not quiet.
2. The noise floor of the distance from that level is a clipped median, started from the tenth percentile. A
   block belongs to a rest where the distance is below FLOOR_FACTOR floors (and 2Ω for the Earth's rate), and
   the scatter of the accelerometers in the same second below SCATTER_FACTOR of its own floor. Vibration that
   averages out over a second raises both floors and their quantities alike, so nothing has to be set by hand.
   The level follows slow drift: it is interpolated between the rests found, and the search repeated.
3. A rest is extended block by block while single blocks stay within EDGE_SIGMAS of its own mean, then
   shortened by a margin for settling at both ends, except where the file itself begins or ends. What lies between two
   rests of a file is a turn.
4. Gyros that feel specific force have a level of their own in every attitude, those that warm in every rest. What
   is quiet and steady but off the level is therefore looked at again (`gyro_levels`): where a linear function of the
   specific force and of time explains the levels, it is taken off the rates, and steps 1 and 2 are repeated. Nothing is
   accepted but a stretch whose level the others predict: a slow turn about the vertical stays a turn.
5. A recording whose stretches are nearly all too short was made so: it is searched again with windows of half a second
   and margins of a tenth, and a rest is then what has SHORT_REST_SECONDS between them.
6. What seemed a rest while the vertical moved by more than TILT_LIMIT is none: where nothing rests, the floors
   are those of the movement.

Without gyros only the accelerometers decide: their scatter, and the step between the means of two neighbouring
seconds, which shows a turn about a nearly vertical axis by the little it tilts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tumble.earth import EARTH_RATE
from tumble.reduction.blocks import ChannelState, FileBlocks, Reduction
from tumble.reduction.gyro_levels import LevelFunction, OffLevel, Span, core, level_function, times_of
from tumble.sensors.model import Block
from tumble.units import DEGREE, Array, BoolArray, IntArray

WINDOW_SECONDS = 1.0
FLOOR_FACTOR = 5.0
SCATTER_FACTOR = 10.0
QUIET_FACTOR = 2.0
EDGE_SIGMAS = 4.0
MIN_REST_SECONDS = 2.0
FEWEST_BLOCKS = 2
"""Of samples that are further apart than margins are long, a rest of seconds may be none."""
SHORT_REST_SECONDS, SHORT_REST_SAMPLES, FEWEST_SHORT = 0.6, 40, 9
"""Between its margins, of a rest in a recording that has so many of them and hardly a longer one; from so many samples
the noise is known to 11 %."""
SHORT_WINDOW_SECONDS, SHORT_MARGIN_SECONDS = 0.5, 0.1
"""Of a recording of short rests: windows of a second have turns in them where a rest lasts no longer."""
LEVEL_SPREAD = 20.0 * DEGREE
"""rad/s: how far the level of gyros at rest may be from that in another attitude, or after biases have jumped, which in
sensors of the poorest grade are up to that."""
STAYS = 0.05 * DEGREE
DENSITY_POINTS = 1000
AT_A_TIME = 16
"""Points whose distances from all others stay in the cache."""
MARGIN_FRACTION = 0.05
MARGIN_SECONDS = (0.2, 1.0)
STILL_SECONDS = math.ceil(MIN_REST_SECONDS + 2.0 * MARGIN_SECONDS[0])
"""How long to lie still, so that a rest of MIN_REST_SECONDS is left between its margins."""
TILT_LIMIT = 2.0 * DEGREE
ACCEL_ROUNDING = 1e-5  # m/s²: what single-precision increments leave in a block mean
GYRO_ROUNDING = 1e-7  # rad/s


@dataclass(frozen=True, kw_only=True, slots=True)
class RestSpan:
    """A rest found: blocks [first, last) of a file, start and stop in s."""

    file: int
    first: int
    last: int
    start: float
    stop: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Rejected:
    """A quiet stretch that is not a rest, in what it fails (its duration, the scatter of the accelerometers, the
    constancy of the vertical, or the level of the gyros), and the number that decided."""

    file: int
    start: float
    stop: float
    fails: Literal["duration", "scatter", "vertical", "level"]
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True)
class LevelJump:
    """Where the first rest begins that has another level of the gyros, by a `size` in rad/s, than those before: its
    file and the time, s."""

    file: int
    time: float
    size: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Segmentation:
    """Rests of a log in the order of time, what was rejected, and the thresholds that were found:
    rate_limit (rad/s; None without gyros) and scatter_limit (m/s²)."""

    rests: tuple[RestSpan, ...]
    rejected: tuple[Rejected, ...]
    rate_limit: float | None
    scatter_limit: float
    jump: LevelJump | None = None
    stated_rate: float | None = None
    """Samples per second, Hz, where no time in the log shows them: what is a second, and so a rest, hangs on it."""

    def jumped(self) -> tuple[str, ...]:
        """That the level of the gyros at rest jumps once between two of the rests, and what to do; nothing where it
        does not."""
        if self.jump is None:
            return ()
        before = [r for r in self.rests if (r.file, r.start) < (self.jump.file, self.jump.time)]
        after = self.rests[len(before) :]
        if not before or not after:
            return ()
        last, first = len(before), len(before) + 1
        return (
            f"the level of the gyros at rest jumps by {self.jump.size / DEGREE:.2g} °/s between rest {last} (to "
            f"{before[-1].stop:z.1f} s) and rest {first} (from {after[0].start:z.1f} s) and stays there: a driver that "
            f"measured the bias anew, or another device; calibrate the {last} rests before it and the {len(after)} "
            "after it as launches of their own, each with the times of the others in [[exclude]]",
        )

    def passed_over(self) -> tuple[str, ...]:
        """Quiet stretches that were nearly rests, counted, in words: the too short ones, and those discarded for the
        level of the gyros."""
        short = [r for r in self.rejected if r.fails == "duration"]
        off = [r for r in self.rejected if r.fails == "level"]
        said = []
        if short:
            by = "" if self.stated_rate is None else f", by log.rate_hz = {self.stated_rate:g}, which no time confirms"
            said.append(f"{_counted(short)} too short: rests must be {STILL_SECONDS} s{by}")
        if off:
            said.append(f"{_counted(off)} discarded because the gyros read otherwise than at rest")
        return tuple(said)

    def unused(self) -> tuple[str, ...]:
        """Every quiet stretch that is not used as a rest, with its times and durations and why not: a sentence for each
        reason."""
        said = []
        for fails, why in _WHY.items():
            quiet = [r for r in self.rejected if r.fails == fails]
            if quiet:
                spans = [f"{r.start:z.1f}–{r.stop:z.1f}" for r in quiet[:MOST_SPANS]]
                more = f" and {len(quiet) - MOST_SPANS} more" if len(quiet) > MOST_SPANS else ""
                total = sum(r.stop - r.start for r in quiet)
                because = quiet[0].reason if len(quiet) == 1 else why
                said.append(f"not used as rests: {', '.join(spans)} s{more}, {total:.1f} s in all: {because}")
        return tuple(said)


_WHY = {
    "level": "the accelerometers are quiet, but the gyros read otherwise than at rest",
    "scatter": "the gyros are quiet, but the accelerometers are not",
    "vertical": f"the vertical moves by more than {TILT_LIMIT / DEGREE:g}°",
    "duration": f"too short: rests must be {STILL_SECONDS} s",
}
MOST_SPANS = 20
"""Stretches that are listed one by one."""


@dataclass(frozen=True, kw_only=True, slots=True)
class _Pace:
    """How a log is searched: windows of so many seconds, rests of at least so many between their margins, and the least
    of these."""

    window: float
    rest: float
    margin: float


def _counted(rejected: list[Rejected]) -> str:
    """Such as "17 quiet stretches of 1.0–2.3 s are"."""
    shortest, longest = min(r.stop - r.start for r in rejected), max(r.stop - r.start for r in rejected)
    length = f"{shortest:.1f} s" if longest - shortest < 0.05 else f"{shortest:.1f}–{longest:.1f} s"
    return (
        f"a quiet stretch of {length} is" if len(rejected) == 1 else f"{len(rejected)} quiet stretches of {length} are"
    )


def find_rests(reduction: Reduction, accel: Block, gyro: Block | None) -> Segmentation:
    """The rests of a reduced log (module docstring)."""
    usual = _Pace(window=WINDOW_SECONDS, rest=MIN_REST_SECONDS, margin=MARGIN_SECONDS[0])
    found = _found(reduction, accel, gyro, usual)
    short = sum(r.fails == "duration" and r.stop - r.start >= SHORT_REST_SECONDS for r in found.rejected)
    if short <= 2 * len(found.rests):
        return found
    least = max(SHORT_REST_SECONDS, SHORT_REST_SAMPLES / reduction.rate)
    again = _found(reduction, accel, gyro, _Pace(window=SHORT_WINDOW_SECONDS, rest=least, margin=SHORT_MARGIN_SECONDS))
    return again if len(again.rests) >= len(found.rests) + FEWEST_SHORT else found


def _found(reduction: Reduction, accel: Block, gyro: Block | None, pace: _Pace) -> Segmentation:
    """The rests of a reduced log that is searched at a pace."""
    coarse = _resolution(reduction.accel_channels, ACCEL_ROUNDING), _resolution(reduction.gyro_channels, GYRO_ROUNDING)
    size = reduction.files[0].size
    window = max(2, round(pace.window * reduction.rate / size))
    to_body = np.linalg.pinv(accel.axes).T
    specific_force = [_columns(f.accel @ to_body) for f in reduction.files]
    scatter = [_moving_scatter(a, window) for a in specific_force]
    floor = _floor(np.concatenate(scatter))
    scatter_limit = (SCATTER_FACTOR if gyro else FLOOR_FACTOR) * floor + coarse[0]
    calm = [s < scatter_limit for s in scatter]
    if gyro is None:
        step = [_moving_step(a, window) for a in specific_force]
        step_limit = FLOOR_FACTOR * _floor(np.concatenate(step)) + coarse[0]
        spans = [_runs(c & (s < step_limit)) for c, s in zip(calm, step, strict=True)]
        return _assemble(reduction, specific_force, None, spans, coarse, (window, pace), scatter_limit, None, [])
    gyro_to_body = np.linalg.pinv(gyro.axes).T
    rates = [_columns(f.gyro @ gyro_to_body) for f in reduction.files if f.gyro is not None]
    quiet = [s < QUIET_FACTOR * floor + coarse[0] for s in scatter]
    spans, unmoved, rate_limit = _still_spans(rates, calm, quiet, coarse[1], window)
    off = _off_level(reduction, specific_force, rates, calm, spans, rate_limit, (window, pace))
    noise_limit = _noise_limit(rates, spans, off, coarse[1], window)
    also = specific_force, times_of([f.edges for f in reduction.files])
    if (g := level_function(rates, also, spans, off, noise_limit, window)) is not None:
        rates = g.without(rates, *also)
        spans, unmoved, rate_limit = _still_spans(rates, calm, quiet, coarse[1], window)
        spans = [_overlapping(new, like) for new, like in zip(spans, g.accepted, strict=True)]
        off = _off_level(reduction, specific_force, rates, calm, spans, rate_limit, (window, pace))
    restless = [_rejected(reduction.files[s.place], s.first, s.last, "level", _off_reason(s, rate_limit)) for s in off]
    restless += [
        _rejected(
            f,
            i,
            j,
            "scatter",
            f"accelerometer scatter {s[i:j].max():.2g} m/s^2 within a second is above {scatter_limit:.2g} m/s^2",
        )
        for f, s, still, c in zip(reduction.files, scatter, unmoved, calm, strict=True)
        for i, j in still
        if not c[i:j].any() and f.edges[j] - f.edges[i] >= pace.rest
    ]
    searched = window, pace
    whole = _assemble(reduction, specific_force, rates, spans, coarse, searched, scatter_limit, rate_limit, restless)
    return whole if g is None or not np.any(g.step) else replace(whole, jump=_jump(whole, g, reduction))


def _jump(found: Segmentation, function: LevelFunction, reduction: Reduction) -> LevelJump:
    """The jump of a level function: where the first rest after it begins."""
    times = dict(zip((f.file for f in reduction.files), times_of([f.edges for f in reduction.files]), strict=True))
    after = next(r for r in found.rests if float(times[r.file][(r.first + r.last) // 2]) > function.step_at)
    return LevelJump(file=after.file, time=after.start, size=float(np.linalg.norm(function.step)))


def _off_reason(off: OffLevel, limit: float) -> str:
    rate = float(np.linalg.norm(off.rate)) / DEGREE
    return (
        f"the accelerometers are quiet, but the gyros read {rate:.2g} °/s off their level at rest, more than "
        f"{limit / DEGREE:.2g} °/s: a slow turn, or a bias that depends on attitude"
    )


def _resolution(channels: tuple[ChannelState, ...], rounding: float) -> float:
    """What the steps of coarse channels may do to a block mean without anything moving."""
    steps = [channel.step for channel in channels if np.isfinite(channel.step)]
    return rounding + float(np.linalg.norm(steps))


def _still_spans(
    rates: list[Array], calm: list[BoolArray], quiet: list[BoolArray], coarse: float, window: int
) -> tuple[list[list[Span]], list[list[Span]], float]:
    """Stretches of blocks, per file, in which the body is calm and does not turn, those in which it only does not turn,
    and the limit of the rate, rad/s."""
    smooth = [_moving_mean(w, window) for w in rates]
    in_quiet = np.concatenate(quiet)
    densest = _densest(np.concatenate([s[q][::window] for s, q in zip(smooth, quiet, strict=True)]))
    level = [np.broadcast_to(densest, s.shape) for s in smooth]
    spans: list[list[Span]] = [[] for _ in rates]
    still, limit = calm, 0.0
    for _ in range(5):  # the level follows slow drift from rest to rest
        distance = [np.linalg.norm(s - at, axis=1) for s, at in zip(smooth, level, strict=True)]
        limit = FLOOR_FACTOR * _floor(np.concatenate(distance)[in_quiet]) + 2.0 * EARTH_RATE + coarse
        still = [d < limit for d in distance]
        found = [_runs(s & c) for s, c in zip(still, calm, strict=True)]
        if found == spans:
            break
        spans = found
        level = [_interpolated_level(w, f, at) for w, f, at in zip(rates, spans, level, strict=True)]
    return spans, [_runs(s) for s in still], limit


def _off_level(
    reduction: Reduction,
    specific_force: list[Array],
    rates: list[Array],
    calm: list[BoolArray],
    spans: list[list[Span]],
    limit: float,
    searched: tuple[int, _Pace],
) -> list[OffLevel]:
    """Quiet stretches in which the gyros are steady, but off their level at rest by more than `limit` and less than
    LEVEL_SPREAD, and the vertical stays where a turn of that rate would not leave it."""
    window, pace = searched
    known = [w[i:j] for w, found in zip(rates, spans, strict=True) for i, j in found]
    if not known:
        return []
    default = np.concatenate(known).mean(axis=0)
    scatter = [_moving_scatter(w, window) for w in rates]
    steady_limit = SCATTER_FACTOR * _floor(np.concatenate(scatter))
    out = []
    for k, (f, w, s, c, force) in enumerate(zip(reduction.files, rates, scatter, calm, specific_force, strict=True)):
        level = _interpolated_level(w, spans[k], np.broadcast_to(default, w.shape))
        for i, j in _runs(c & (s < steady_limit)):
            seconds = float(f.edges[j] - f.edges[i])
            covered = sum(min(j, b) - max(i, a) for a, b in _overlapping(spans[k], [(i, j)]))
            if seconds < pace.rest or j - i < 2 * window or covered > 0.5 * (j - i):
                continue
            off = OffLevel(
                place=k, first=i, last=j, rate=w[slice(*core(i, j, window))].mean(axis=0) - level[(i + j) // 2]
            )
            stays = _stays(force[i:j], off.rate, seconds - pace.window, window)
            if limit < float(np.linalg.norm(off.rate)) < LEVEL_SPREAD and stays:
                out.append(off)
    return out


def _noise_limit(rates: list[Array], spans: list[list[Span]], off: list[OffLevel], coarse: float, window: int) -> float:
    """The limit of the distance of a level, rad/s, that the noise within stretches asks for."""
    of_rests = [(k, i, j) for k, found in enumerate(spans) for i, j in found if j - i >= 2 * window]
    of_rests += [(s.place, s.first, s.last) for s in off]
    stretches = [rates[k][slice(*core(i, j, window))] for k, i, j in of_rests]
    of_mean = [np.sqrt(w.var(axis=0).sum() / window) for w in stretches]
    return FLOOR_FACTOR * _floor(np.array([*of_mean, 0.0])) + 2.0 * EARTH_RATE + coarse


def _stays(force: Array, rate: Array, seconds: float, window: int) -> bool:
    """Whether the vertical moves by less than a third of what this rate (rad/s) would move it in so many seconds, from
    the first window to the last."""
    before, after = (part.mean(axis=0) for part in (force[:window], force[-window:]))
    size = float(np.linalg.norm(before))
    moved = float(np.linalg.norm(after - before))
    turned = float(np.linalg.norm(np.cross(rate, before))) * seconds
    return moved < max(turned / 3.0, STAYS * size)


def _overlapping(spans: list[Span], others: list[Span]) -> list[Span]:
    """The stretches that overlap one of the others."""
    return [(i, j) for i, j in spans if any(i < b and a < j for a, b in others)]


def _interpolated_level(rate: Array, spans: list[tuple[int, int]], default: Array) -> Array:
    """The gyro level of every block, interpolated between the means of the stretches found."""
    long = [(i, j) for i, j in spans if j - i >= 10]
    if not long:
        return default
    centres = np.array([0.5 * (i + j) for i, j in long])
    means = np.array([rate[i:j].mean(axis=0) for i, j in long])
    blocks = np.arange(len(rate))
    return np.column_stack([np.interp(blocks, centres, means[:, c]) for c in range(rate.shape[1])])


def _assemble(
    reduction: Reduction,
    specific_force: list[Array],
    rates: list[Array] | None,
    spans: list[list[Span]],
    coarse: tuple[float, float],
    searched: tuple[int, _Pace],
    scatter_limit: float,
    rate_limit: float | None,
    rejected: list[Rejected],
) -> Segmentation:
    """Extend the stretches found, take the margins off, and keep those that are long enough."""
    rests: list[RestSpan] = []
    whole, (window, pace) = [], searched
    for k, (force, found) in enumerate(zip(specific_force, spans, strict=True)):
        signals = [(force, coarse[0])] if rates is None else [(force, coarse[0]), (rates[k], coarse[1])]
        whole.append(_merged([_extended(signals, i, j, window) for i, j in found]))
    for f, force, found in zip(reduction.files, specific_force, whole, strict=True):
        for first, last in found:
            duration, before, after = _with_margins(f, first, last, pace.margin)
            span = rest_between(f, f.edges[first] + before, f.edges[last] - after)
            if duration - before - after < pace.rest - 1e-9 or span.last - span.first < FEWEST_BLOCKS:
                if duration > 0.5:
                    reason = f"{duration:.1f} s is too short: rests must be {STILL_SECONDS} s"
                    rejected.append(_rejected(f, first, last, "duration", reason))
                continue
            tilt = _tilt(force[first:last], window)
            if tilt > TILT_LIMIT:
                reason = f"the vertical moves by {tilt / DEGREE:.0f}°, in a rest at most {TILT_LIMIT / DEGREE:g}°"
                rejected.append(_rejected(f, first, last, "vertical", reason))
                continue
            rests.append(span)
    return Segmentation(
        rests=tuple(rests),
        rejected=tuple(sorted(rejected, key=lambda r: (r.file, r.start))),
        rate_limit=rate_limit,
        scatter_limit=scatter_limit,
    )


def margin_of(duration: float, least: float = MARGIN_SECONDS[0]) -> float:
    """What is taken off at each end of a stretch that lasts so long, s, where it borders on movement."""
    return float(np.clip(MARGIN_FRACTION * duration, least, MARGIN_SECONDS[1]))


def _with_margins(f: FileBlocks, first: int, last: int, least: float) -> tuple[float, float, float]:
    """How long a stretch is, and what is taken off at its beginning and end, s."""
    duration = float(f.edges[last] - f.edges[first])
    margin = margin_of(duration, least)
    return duration, margin if first > 0 else 0.0, margin if last < len(f.edges) - 1 else 0.0


def _rejected(
    f: FileBlocks, first: int, last: int, fails: Literal["duration", "scatter", "vertical", "level"], reason: str
) -> Rejected:
    return Rejected(file=f.file, start=float(f.edges[first]), stop=float(f.edges[last]), fails=fails, reason=reason)


def stated_rest(reduction: Reduction, start: float, stop: float) -> RestSpan:
    """A rest at stated times (s) of the first file, to whole blocks inside them."""
    return rest_between(reduction.files[0], start, stop)


def rest_between(f: FileBlocks, start: float, stop: float) -> RestSpan:
    """The whole blocks between two times of a file."""
    first = int(np.searchsorted(f.edges, start - 1e-9))
    last = int(np.searchsorted(f.edges, stop + 1e-9, side="right")) - 1
    return RestSpan(file=f.file, first=first, last=last, start=float(f.edges[first]), stop=float(f.edges[last]))


def _extended(signals: list[tuple[Array, float]], first: int, last: int, window: int) -> tuple[int, int]:
    """A stretch of blocks with its ends set where single blocks leave EDGE_SIGMAS of its own scatter: the moving
    window has blurred them by half its length."""
    tenth = (last - first) // 10
    cores = [values[first + tenth : last - tenth] for values, _ in signals]
    means, sigmas = [core.mean(axis=0) for core in cores], [np.sqrt(core.var(axis=0).sum()) for core in cores]

    def inside(rows: slice) -> BoolArray:
        each = [
            np.linalg.norm(values[rows] - mean, axis=1) <= EDGE_SIGMAS * sigma + rounding
            for (values, rounding), mean, sigma in zip(signals, means, sigmas, strict=True)
        ]
        return np.asarray(np.logical_and.reduce(each))

    half, blocks = min(window, last - first) // 2, len(signals[0][0])
    start, stop = first + half, last - half
    while start > 0 and (added := _run_at_end(inside(slice(max(0, start - _STRIDE), start)))):
        start -= added
        if added < _STRIDE:
            break
    while stop < blocks and (added := _run_at_end(inside(slice(stop, stop + _STRIDE))[::-1])):
        stop += added
        if added < _STRIDE:
            break
    return start, stop


_STRIDE = 256
"""Blocks that are looked at together where a stretch is extended."""


def _run_at_end(flags: BoolArray) -> int:
    """How many of the last flags in a row are true."""
    return len(flags) if flags.all() else int(np.argmin(flags[::-1]))


def _tilt(force: Array, window: int) -> float:
    """How far (rad) the one-second means of the specific force (K, 3) go from the mean of all."""
    mean = force.mean(axis=0)
    return float(np.linalg.norm(_moving_mean(force, window) - mean, axis=1).max() / np.linalg.norm(mean))


def _merged(spans: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Stretches in order, overlapping ones joined."""
    out: list[tuple[int, int]] = []
    for first, last in sorted(spans):
        if out and first < out[-1][1]:
            out[-1] = (out[-1][0], max(last, out[-1][1]))
        elif last > first:
            out.append((first, last))
    return out


def _moving_mean(values: Array, window: int) -> Array:
    """Mean over the `window` rows about each row, at the ends over the first and the last `window` rows."""
    window = min(window, len(values))
    return inner_mean(values, window)[_window_of(len(values), window)]


def _moving_scatter(values: Array, window: int) -> Array:
    """Root of the summed variances of the columns in the same windows."""
    window = min(window, len(values))
    variance = inner_variance(values, inner_mean(values, window), window).sum(axis=1)
    return np.asarray(np.sqrt(variance)[_window_of(len(values), window)])


def _moving_step(values: Array, window: int) -> Array:
    """Distance between the means of the `window` rows before and behind each row, at the ends that of the nearest."""
    window = min(window, len(values) // 2)
    mean = inner_mean(values, window)
    step = np.linalg.norm(mean[window:] - mean[:-window], axis=1)
    return np.asarray(step[np.clip(np.arange(len(values)) - window, 0, len(step) - 1)])


def inner_mean(values: Array, window: int) -> Array:
    """Mean of every `window` consecutive rows."""
    out = np.zeros((len(values) - window + 1, values.shape[1]), order="F")
    for i in range(window):
        out += values[i : len(out) + i]
    return out / window


def _columns(vectors: Array) -> Array:
    """The same vectors (K, 3), column after column in memory: sums over three numbers a row are slow."""
    return np.asfortranarray(vectors)


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
    neighbour = min(len(points) - 1, max(3, len(points) // 20))
    few = (points[i : i + AT_A_TIME] for i in range(0, len(points), AT_A_TIME))
    return np.asarray(points[np.argmin(np.concatenate([_to_neighbour(each, points, neighbour) for each in few]))])


def _to_neighbour(points: Array, others: Array, neighbour: int) -> Array:
    """Squared distances (m,) of points from the others that are their k-th neighbours, they themselves the 0-th."""
    squares = sum((own[:, None] - column) ** 2 for own, column in zip(points.T, others.T, strict=True))
    return np.asarray(np.partition(squares, neighbour, axis=1)[:, neighbour])


def _floor(values: Array) -> float:
    """The level of the quiet part of a positive quantity: a median clipped at FLOOR_FACTOR times itself, started
    from the tenth percentile."""
    floor = float(np.quantile(values, 0.1))
    for _ in range(50):
        inside = values[values <= FLOOR_FACTOR * floor]
        median = float(np.median(inside))
        if abs(median - floor) <= 1e-6 * floor:
            break
        floor = median
    return floor


def _runs(flags: BoolArray) -> list[tuple[int, int]]:
    """[first, last) of every row of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]])))
    return [(int(i), int(j)) for i, j in edges.reshape(-1, 2)]
