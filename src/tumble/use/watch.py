"""A calibration watched while its device is used: every rest of a flight or a day tests it, as `tumble check` would.

A stream is corrected by `tumble.Corrector`, which says what is outside of what was calibrated, and is reduced and
searched for rests as any log is (`find_rests`), at the temperatures of the sensors that the corrector has, in windows
of WINDOW blocks that are looked at every SEARCH blocks, so that memory does not grow and the same rests are found
however the stream is cut. A rest counts once it has ended; one that lasts counts anew every LONGEST seconds. Each is
judged by the rows of a field check against the calibration and what the rests before it have said
(`tumble.methods.rest_chain`). The calibration is never changed.

Rests need not be level, and the attitude is unknown in each. Where nothing rests, as in flight, the floors that
`find_rests` sets are those of the movement: what is noisier than SHAKEN times the rests of the calibration is no rest.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from tumble.errors import InputError
from tumble.files import FilePath
from tumble.methods.rest_chain import JudgedRest, MovedBias, RestChain
from tumble.recording.log import Chunk, open_log
from tumble.recording.session import Session
from tumble.recording.session_file import session_from
from tumble.reduction.blocks.reducer import Reducer
from tumble.reduction.observations import Observations, observe
from tumble.reduction.rests.blemishes import without_blemishes
from tumble.reduction.rests.matching import Match
from tumble.reduction.rests.segmentation import RestSpan, find_rests
from tumble.result.accepted import accepted_accelerometers
from tumble.result.calibration import Calibration, calibration_from
from tumble.rotation import unit_vector
from tumble.run.calibrate import grade_of
from tumble.run.from_estimate import reference_of
from tumble.sensors.parameters import usual_sizes
from tumble.units import Array, BoolArray
from tumble.use.check import FieldCheck, check_given, known_before
from tumble.use.corrector import LATEST, Corrector
from tumble.use.error_sources import white_noise

SEARCH = 200
"""Blocks, 20 s: how often rests are looked for."""
WINDOW = 6000
"""Blocks, 10 min: the most that is looked at together."""
SETTLED = 30
"""Blocks, 3 s, after which a rest has ended."""
CARRIED = 600
"""Blocks, 1 min, of a window that the next begins with, at least."""
LONGEST = 300.0
"""s: a rest that lasts counts anew after this time."""
SHAKEN = 10.0
"""Times the noise of the calibration's rests: more is movement."""
INTERRUPTED = 2.0
"""s without a sample: what was before and what comes after are apart, for the device may have been moved."""
FEWEST = 30
"""Blocks in which rests are looked for."""
_RANGES = ("temperature", "rate", "force")


@dataclass(frozen=True, kw_only=True, slots=True)
class WatchedRest:
    """A rest: its number, from 1, start and stop, s; temperature, °C, None without a thermometer; by how much the
    corrected specific force misses gravity, m/s², the standard uncertainty of what is predicted for it, and by how many
    of these it is off; what is `outside` of what was calibrated; and how it was `judged`. What turns out to be no rest
    has neither number nor judgement, but `why`."""

    number: int | None
    start: float
    stop: float
    celsius: float | None
    force: float
    force_u: float | None
    force_sigmas: float | None
    outside: tuple[str, ...]
    judged: JudgedRest | None
    why: str = ""

    @property
    def moved(self) -> tuple[MovedBias, ...]:
        """What is known to have moved with this rest."""
        return () if self.judged is None else self.judged.moved


@dataclass(frozen=True, kw_only=True, slots=True)
class Notice:
    """What is to be said of the stream at a time, s."""

    time: float
    text: str


Event = WatchedRest | Notice


class Watch:
    """Watches a calibration of a device by the stream of its readings.

    Parameters
    ----------
    calibration
        One that was accepted, with uncertainties, or its file.
    session
        What says the columns, sensors and site of the stream: a `Session` or its folder.
    sample_rate
        Samples a second.

    Raises
    ------
    CalibrationError
        For a calibration that was not accepted, has no uncertainties or is in the frame of the case.
    InputError
        For a session of another device or of other sensors.
    """

    def __init__(self, calibration: Calibration | FilePath, session: Session | FilePath, *, sample_rate: float) -> None:
        given, session = calibration_from(calibration), session_from(session)
        given = accepted_accelerometers(given, "a watch has its attitudes")
        check_given(given, session)
        if given.gyro is not None and session.gyro_block is None:
            raise InputError(f"{session.name}: expected gyros, which the calibration has, found none")
        self.calibration = given.in_frame("accelerometer")
        self.session, self.rate = session, sample_rate
        self.rests: int = 0
        """How many have been judged."""
        self.moved: tuple[MovedBias, ...] = ()
        self._frame, self._gyro = given.frame, None if given.gyro is None else session.gyro_block
        self._corrector = Corrector(given, sample_rate=sample_rate)
        self._white = white_noise(given)
        self._chain: RestChain | None = None
        self._grade = self._guessed_from = ""
        self._restarted = self._too_warm = False
        self._last: tuple[int, float] | None = None
        self._waiting: Chunk | None = None
        """What is not corrected yet."""
        self._begin(-np.inf)

    def _begin(self, done: float) -> None:
        """Begin a window, up to `done`, s, in which rests have been judged before."""
        self._reducer = Reducer(
            rate=self.rate,
            accel=self.session.accel_block,
            gyro=self._gyro,
            increments=self.session.log.increments,
        )
        self._kept: list[tuple[Chunk, Array, BoolArray]] = []
        """What the reducer was fed, corrected specific force (m, 3), and whether it is outside of each of _RANGES."""
        self._count, self._done = 0, done

    # -------------------- samples --------------------

    def feed(self, chunk: Chunk) -> list[Event]:
        """The next samples; what there is to say of them and of what was before."""
        out = list[Event]()
        dt, step = 1.0 / self.rate, SEARCH * self._reducer.size
        while len(chunk.time):
            first = float(chunk.time[0])
            if self._last is not None:
                file, last = self._last
                anew = first < last - LATEST or (chunk.file != file and first <= last)
                if anew or first - dt - last > INTERRUPTED:
                    out += self._search(ended=True)
                    self._begin(-np.inf)
                    self._waiting = None
                    text = f"nothing came for {first - last:.1f} s; the watch goes on"
                    if anew:
                        self._corrector.reset()
                        self._restarted, text = True, "the clock begins anew: taken for another power-on"
                    out.append(Notice(time=first, text=text))
            gaps = np.flatnonzero(np.diff(chunk.time) - dt > INTERRUPTED)
            waiting = 0 if self._waiting is None else len(self._waiting.time)
            count = step - self._count % step + self._corrector.delay - waiting
            count = min(count, len(chunk.time), int(gaps[0]) + 1 if len(gaps) else len(chunk.time))
            piece, chunk = chunk.part(slice(0, count)), chunk.part(slice(count, None))
            self._last = piece.file, float(piece.time[-1])
            out += self._take(piece)
            if self._count and self._count % step == 0:
                out += self._search()
        return out

    def _take(self, piece: Chunk) -> list[Event]:
        """Correct some samples, and feed what is corrected now to the reduction; that its temperature leaves what was
        calibrated, or is back."""
        heat = self._corrector.thermometers
        celsius = None if piece.temperature is None else piece.temperature[:, :heat]
        piece = replace(piece, file=0, gyro=None if self._gyro is None else piece.gyro)
        corrected = self._corrector.add(piece.accel, piece.gyro, time=piece.time, temperature=celsius)
        piece = piece if self._waiting is None else self._waiting.followed_by(piece)
        ready = len(piece.time) - self._corrector.delay
        piece, self._waiting = piece.part(slice(0, ready)), piece.part(slice(ready, None))
        if not ready:
            return []
        outside = np.column_stack([corrected.outside[name][-ready:] for name in _RANGES])
        if piece.temperature is not None:
            others = piece.temperature[:, heat:]
            piece = replace(piece, temperature=np.column_stack([corrected.temperature[-ready:], others]))
        self._feed(piece, corrected.force[-ready:].copy(), outside)
        too_warm = outside[:, 0]
        if too_warm[-1] == self._too_warm:
            return []
        self._too_warm = bool(too_warm[-1])
        low, high = self._corrector.ranges.temperature
        there = "outside" if self._too_warm else "again within"
        since = np.flatnonzero(np.append(True, too_warm[1:] != too_warm[:-1]))[-1]
        text = f"temperature {there} {low:.1f} to {high:.1f} °C, which was calibrated"
        return [Notice(time=float(piece.time[since]), text=text)]

    def _feed(self, piece: Chunk, force: Array, outside: BoolArray) -> None:
        self._kept.append((piece, force, outside))
        self._reducer.feed(piece)
        self._count += len(piece.time)

    # -------------------- rests --------------------

    def _search(self, *, ended: bool = False) -> list[Event]:
        """The rests that have ended since the last search, judged; all, where the stream has `ended` or is cut."""
        if self._count < FEWEST * self._reducer.size:
            return []
        with np.errstate(over="ignore", invalid="ignore"):
            reduction = without_blemishes(self._reducer.now())
            found = find_rests(reduction, self.session.accel_block, self._gyro)
        file, still = reduction.files[-1], found.tuning.rest
        K, lasting = len(file), float(file.edges[-1])
        spans, new = list[RestSpan](), list[RestSpan]()
        for span in found.rests:
            start = max(span.start, self._done)
            while span.stop - start >= LONGEST:
                new.append(RestSpan.between(file, start, start + LONGEST))
                start = self._done = new[-1].stop
            over = ended or span.last < K - SETTLED
            if over and span.stop - start >= still:
                new.append(RestSpan.between(file, start, span.stop))
                self._done = new[-1].stop
            elif not over:
                lasting = min(lasting, start)
            if span.stop <= self._done and span.start < self._done:
                spans.append(span)
        new = [span for span in new if span.last - span.first >= found.tuning.fewest_blocks]
        others = [s for s in spans if all(s.stop <= n.start or n.stop <= s.start for n in new)]
        every = tuple(sorted([*others, *new], key=lambda span: span.first))
        out = list[Event]()
        if new:
            match = Match(rests=every, programme=None, position=None)
            still_only = replace(reduction, samples=None)
            seen = observe(still_only, match, self.session.accel_block, self._gyro, self.session.site, ())
            out = [self._judged(seen, every.index(span)) for span in new]
        if K >= WINDOW:
            begin = max(min(lasting - 5.0, float(file.edges[K - CARRIED])), self._done)
            kept = self._kept
            self._begin(self._done)
            for piece, force, outside in kept:
                rows = int(np.searchsorted(piece.time, begin, side="right"))
                if rows < len(piece.time):
                    self._feed(piece.part(slice(rows, None)), force[rows:], outside[rows:])
        return out

    def _judged(self, seen: Observations, i: int) -> WatchedRest:
        """One of the rests that were seen, by the chain of those before."""
        rests, alone = seen.rests, seen.of_rest(i)
        start, stop = float(rests.start[i]), float(rests.stop[i])
        pieces, forces, flags = zip(*self._kept, strict=True)
        time = np.concatenate([piece.time for piece in pieces])
        within = (time > start) & (time <= stop)
        mean = np.concatenate(forces)[within].mean(axis=0) if within.any() else np.full(3, np.nan)
        shares = np.concatenate(flags)[within].mean(axis=0)
        outside = tuple(name for name, share in zip(_RANGES, shares, strict=True) if share > 0.5)
        at = reference_of(alone)
        rest = WatchedRest(
            number=None,
            start=start,
            stop=stop,
            celsius=at,
            force=float(np.linalg.norm(mean)) - self.session.site.gravity,
            force_u=None,
            force_sigmas=None,
            outside=outside,
            judged=None,
        )
        noise = {"accel": rests.accel_noise[i], "gyro": rests.gyro_noise[i]}
        for kind, white in self._white.items():
            times = float(np.max(noise[kind] / white)) if len(noise[kind]) else 0.0
            if times > SHAKEN:
                return replace(rest, why=f"{kind} {times:.0f} times as noisy as in the rests of the calibration")
        if not self._grade:
            self._grade, self._guessed_from = grade_of(self.session, alone)
        known = known_before(self.calibration, alone, self._grade, self.session.device.prior)
        if self._chain is None:
            self._chain = RestChain(known, usual_sizes(self._grade, self.session.device.prior))
        judged = self._chain.add(alone, known, apart=np.inf if self._restarted else None)
        self._restarted = False
        self.moved += judged.moved
        self.rests += 1
        along = [(test.u, name) for name, test in judged.tests.items() if name.startswith("accel")]
        if along:
            u, name = min(along)
            axis = self._chain.instrument.accel.axes[self._chain.instrument.names.index(name)]
            upward = float(axis @ unit_vector(mean))
            sigmas = judged.tests[name].sigmas * float(np.sign(upward))
            rest = replace(rest, force_u=u * abs(upward), force_sigmas=sigmas)
        return replace(rest, number=self.rests, judged=judged)

    # -------------------- the end --------------------

    def finish(self) -> list[Event]:
        """The stream has ended: the last rest too."""
        return self._search(ended=True)

    def check(self) -> FieldCheck:
        """All rests so far as one field check, with what has moved among its changes. Raises InputError where none was
        judged."""
        if self._chain is None:
            raise InputError(f"{self.session.name}: expected rests to test the calibration with, found none")
        origin = f", guessed from {self._guessed_from}; [device] grade says another" if self._guessed_from else ""
        return FieldCheck(
            calibration=self.calibration,
            session=self.session.name,
            sha256="",
            rests=self.rests,
            turns=0,
            result=self._chain.result(self.moved),
            notes=(
                *self.calibration.absent,
                f"what turning on again changes, and how fast that wanders: as usual of the grade {self._grade}"
                f"{origin}",
            ),
            frame=self._frame,
            instrument=self._chain.instrument,
            temperature=self.calibration.reference_temperature,
            references=self.calibration.temperature.references,
            site=self.session.site,
            circumstances=self.session.circumstances,
            sample_rate=self.rate,
        )


def watch_session(calibration: Calibration | FilePath, session: Session | FilePath) -> Iterator[Event]:
    """The same of a whole recording, a `Session` or its folder: what there is to say, in the order of time.

    >>> import tumble
    >>> calibration = tumble.calibrate(tumble.simulate_session("made", tumble.Setup.of(positions=12), seed=1))
    >>> day = tumble.simulate_session("day", tumble.Setup.of(positions=6), seed=1)
    >>> events = tumble.watch_session(calibration, day)
    >>> [event.number for event in events]
    [1, 2, 3, 4, 5, 6]
    """
    log = open_log(session_from(session))
    watch = Watch(calibration, log.session, sample_rate=log.rate)
    yield from watched(watch, log.chunks())


def watched(watch: Watch, chunks: Iterable[Chunk]) -> Iterator[Event]:
    """What there is to say of the samples of a stream until it ends."""
    for chunk in chunks:
        yield from watch.feed(chunk)
    yield from watch.finish()
