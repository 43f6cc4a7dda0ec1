"""Check of a calibration while its device is in use: each rest is tested when it ends.

The readings are reduced to rests by `RestStream`, at the temperatures of the sensors, which follow their thermometers
with the lag of the calibration (`Stream`). Each rest, of unknown attitude, is tested against the calibration and the
rests before it (`tumble.methods.rest_chain`). Steady movement, as in flight, can look like a noisy rest: a stretch with
more noise than MOVEMENT_NOISE_RATIO times that of the calibration's rests is not used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import TypeAlias

import numpy as np

from tumble.arguments import checked
from tumble.errors import InputError
from tumble.files import FilePath
from tumble.methods.rest_chain import MovedBias, RestChain
from tumble.recording.live.samples import SampleStream
from tumble.recording.live.sources import source_of
from tumble.recording.log import Chunk
from tumble.recording.session import Session
from tumble.recording.session_file import session_from
from tumble.reduction.observations import Observations
from tumble.reduction.rest_stream import RestStream
from tumble.result.calibration import Calibration, calibration_from
from tumble.rotation import unit_vector
from tumble.run.from_estimate import check_sensors, mean_temperature
from tumble.run.observed import grade_of
from tumble.sensors.parameters import usual_sizes
from tumble.units import ZERO_CELSIUS, Array, BoolArray
from tumble.use.apply import check_device
from tumble.use.check import (
    CheckedRest,
    FieldCheck,
    accepted_for_check,
    parameter_test_fields,
    prior_at_check,
)
from tumble.use.corrector import CLOCK_RESTART, Ranges, Stream

MOVEMENT_NOISE_RATIO = 10.0
"""Ratio to the noise of the calibration's rests above which a quiet stretch counts as movement."""
LONGEST_PAUSE = 2.0
"""s without a sample after which the device may have been moved."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Notice:
    """A sentence on the stream, at a `time`, s."""

    time: float
    text: str


Event: TypeAlias = CheckedRest | Notice


class StreamCheck:
    """Check of an accepted calibration with a stream whose columns, sensors and site a session describes.

    `rests` are the rests so far, with quiet stretches that are not used; `moved` are the biases that have changed
    during the stream. Raises CalibrationError for a calibration that is not accepted, has no uncertainties, or is in
    the frame of the case, and InputError for a session of another device or of other sensors."""

    def __init__(self, calibration: Calibration | FilePath, session: Session | FilePath, *, sample_rate: float) -> None:
        accepted, session = accepted_for_check(calibration), session_from(session)
        check_device(accepted, session)
        check_sensors(accepted, session)
        if accepted.gyro is not None and session.gyro_block is None:
            raise InputError(f"{session.name}: expected gyros, which the calibration has, found none")
        self.calibration = accepted.in_frame("accelerometer")
        self.session = session
        self.rate = sample_rate
        self.rests = list[CheckedRest]()
        self.moved = tuple[MovedBias, ...]()
        self._gyro = None if accepted.gyro is None else session.gyro_block
        self._ranges = Ranges.of(accepted)
        self._white = dict[str, Array]()  # noise densities (n,) in the rests of the calibration, SI/√Hz
        for kind in ("accel", "gyro"):
            sensors = (getattr(rest, kind) for rest in accepted.evidence.all_rests)
            if noise := [each.noise for each in sensors if each is not None]:
                self._white[kind] = np.sqrt(np.mean(np.square(noise), axis=0))
        thermometers = 1 if session.log.temperature is None else len(session.log.temperature.columns)
        self._stream = Stream(
            self.calibration.compensator,
            1.0 / sample_rate,
            blocks=(session.accel_block, self._gyro),
            gyros=False,
            thermometers=thermometers,
            ranges=self._ranges,
            zero=ZERO_CELSIUS,
            clock_restart=CLOCK_RESTART,
        )
        self._chain: RestChain | None = None
        self._grade = self._guessed_from = ""  # from the first rest
        self._restarted = False  # whether the next rest is the first of another power-on
        self._too_warm = False
        self._last_sample: tuple[int, float] | None = None  # number of its file, and time, s
        accel, increments = session.accel_block, session.log.increments
        self._new_rest_stream = partial(
            RestStream, rate=sample_rate, accel=accel, gyro=self._gyro, site=session.site, increments=increments
        )
        self._rest_stream = self._new_rest_stream()

    def feed(self, chunk: Chunk) -> list[Event]:
        """Add samples; return the rests that have ended, and notices, in the order of time."""
        events = list[Event]()
        cuts = (np.flatnonzero(np.diff(chunk.time) - 1.0 / self.rate > LONGEST_PAUSE) + 1).tolist()
        for begin, end in pairwise([0, *cuts, len(chunk.time)]):
            if end == begin:
                continue
            part = chunk.part(slice(begin, end))
            events += self._after_a_cut(part)
            self._last_sample = part.file, float(part.time[-1])
            corrected = self._stream.add(part.accel, None, part.time, part.temperature)
            events += self._temperature_notices(part.time, corrected.outside["temperature"])
            piece = replace(part, file=0, gyro=None if self._gyro is None else part.gyro)
            if part.temperature is not None:
                piece = replace(piece, temperature=corrected.temperature.copy())
            events += map(self._check_rest, self._rest_stream.feed(piece))
        return events

    def finish(self) -> list[Event]:
        """Return the last rest, at the end of the stream."""
        return [self._check_rest(rest) for rest in self._rest_stream.finish()]

    def _after_a_cut(self, part: Chunk) -> Iterator[Event]:
        """End the last rest if samples follow a pause or a restart of the clock, and yield it and a notice."""
        if self._last_sample is None:
            return
        file, last = self._last_sample
        first = float(part.time[0])
        restarted = first < last - CLOCK_RESTART or (part.file != file and first <= last)
        if not restarted and first - 1.0 / self.rate - last <= LONGEST_PAUSE:
            return
        yield from self.finish()
        self._rest_stream = self._new_rest_stream()
        text = f"nothing came for {first - last:.1f} s; the check goes on"
        if restarted:
            self._stream.reset()
            self._restarted = True
            text = "the clock begins anew: taken for another power-on"
        yield Notice(time=first, text=text)

    def _temperature_notices(self, time: Array, too_warm: BoolArray) -> Iterator[Notice]:
        """Yield a notice if the last sample is `too_warm` (N,) or too cold and the ones before were not, or reverse."""
        if len(too_warm) == 0 or too_warm[-1] == self._too_warm:
            return
        self._too_warm = bool(too_warm[-1])
        low, high = self._ranges.temperature
        where = "outside" if self._too_warm else "again within"
        since = np.flatnonzero(np.append(True, too_warm[1:] != too_warm[:-1]))[-1]
        text = f"temperature {where} {low:.1f} to {high:.1f} °C, which was calibrated"
        yield Notice(time=float(time[since]), text=text)

    def _check_rest(self, observations: Observations) -> CheckedRest:
        """Compare the only rest of the observations with gravity, and test it unless it is too noisy for a rest."""
        rests, block = observations.rests, observations.accel_block
        start, stop = float(rests.start[0]), float(rests.stop[0])
        kelvin = rests.temperatures
        celsius = None if kelvin is None else kelvin[:, block.thermometer] - ZERO_CELSIUS
        force = self.calibration.compensator.force(rests.accel, celsius)[0]
        size, (low, high) = float(np.linalg.norm(force)), self._ranges.temperature
        outside = {
            "temperature": celsius is not None and not np.all((low <= celsius) & (celsius <= high)),
            "force": size > self._ranges.force,
        }
        rest = CheckedRest(
            label=f"no rest ({start:z.1f}–{stop:z.1f} s)",
            difference=self.session.site.gravity - size,
            start=start,
            stop=stop,
            celsius=mean_temperature(observations),
            outside=tuple(name for name, is_outside in outside.items() if is_outside),
        )
        noise = {"accel": rests.accel_noise[0], "gyro": rests.gyro_noise[0]}
        for kind, white in self._white.items():
            times = float(np.max(noise[kind] / white)) if len(noise[kind]) else 0.0
            if times > MOVEMENT_NOISE_RATIO and not rest.why:
                rest = replace(rest, why=f"{kind} {times:.0f} times as noisy as in the rests of the calibration")
        if not rest.why:
            rest = self._tested(rest, observations, force)
        self.rests.append(rest)
        return rest

    def _tested(self, rest: CheckedRest, observations: Observations, force: Array) -> CheckedRest:
        """Test a rest with this corrected `force` (3,) against the calibration and the rests before it."""
        if not self._grade:
            self._grade, self._guessed_from = grade_of(self.session, observations)
        data_sheet = self.session.device.prior
        prior = prior_at_check(self.calibration, observations, self._grade, data_sheet)
        if self._chain is None:
            self._chain = RestChain(prior, usual_sizes(self._grade, data_sheet))
        judged = self._chain.add(observations, prior, apart=np.inf if self._restarted else None)
        self._restarted = False
        self.moved += judged.moved
        rest = replace(rest, label=f"rest {self._chain.rests} ({rest.start:z.1f}–{rest.stop:z.1f} s)", judged=judged)
        tests = [(test.u, name) for name, test in judged.tests.items() if name.startswith("accel")]
        if not tests:
            return rest
        u, name = min(tests)  # the accelerometer along the vertical, which is predicted best
        axis = self._chain.instrument.accel.axes[self._chain.instrument.names.index(name)]
        upward = float(
            axis @ unit_vector(force)
        )  # a change of the bias by 1 changes |f| by this, and g − |f| by minus it
        return replace(rest, u=u * abs(upward), sigmas=-judged.tests[name].sigmas * float(np.sign(upward)))

    def result(self) -> FieldCheck:
        """Return all rests so far as one check, with the biases that have moved among its changes.

        Raises InputError if there was no rest."""
        if self._chain is None:
            raise InputError(f"{self.session.name}: expected rests to check with, found none")
        origin = f" (guessed from {self._guessed_from}; state it as [device] grade)" if self._guessed_from else ""
        note = f"changes from one power-on to the next, and their rate: as usual for the grade {self._grade}{origin}"
        return FieldCheck(
            source=self.session.name,
            rests=tuple(self.rests),
            **parameter_test_fields(self._chain.result(self.moved)),
            notes=(*self.calibration.provenance.absent, note),
        )


@checked
def check_stream(
    calibration: Calibration | FilePath,
    listen: str,
    *,
    session: Session | FilePath | None = None,
    show: Callable[[Event], object] = lambda _: None,
) -> FieldCheck:
    """Check a calibration with a stream, until it ends or is interrupted (Ctrl-C).

    Parameters
    ----------
    calibration
        An accepted calibration with uncertainties, or its file.
    listen
        The source of the stream, see `tumble.recording.live.sources`: udp:PORT, serial:DEVICE:BAUD and others.
    session
        A session that describes columns, units and site of the stream, or its folder. By default it sends t, ax, ay,
        az, gx, gy, gz in s, m/s² and rad/s, and a temperature in °C if its first line names such a column, at the site
        of the calibration.
    show
        Called with every rest as soon as it has ended, and with notices.

    Returns
    -------
    FieldCheck
        All rests together.

    Raises
    ------
    InputError
        If the source cannot be opened, sends no samples or those of other sensors, or nothing rests.

    Examples
    --------
    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> calibration = tumble.calibrate(folder)
    >>> day = tumble.simulate_session("day", tumble.Setup.of(grade="mems", positions=4), seed=1, launch=2)
    >>> check = tumble.check_stream(calibration, "replay:day@max")
    >>> len(check.rests), check.verdict
    (4, 'accepted')
    """
    loaded, source = calibration_from(calibration), source_of(listen)
    described = source.session if session is None else session_from(session)
    if described is None and loaded.provenance.site is None:
        raise InputError(
            f"{listen}: expected a calibration with its site, found none; name a session with --session, which has the "
            "latitude and the columns"
        )
    site, gyros = loaded.provenance.site, loaded.gyro is not None
    samples = SampleStream(source, described, serial=loaded.serial, site=site, gyros=gyros)
    check: StreamCheck | None = None
    with suppress(KeyboardInterrupt):
        for chunk in samples.chunks():
            if check is None and samples.interval is not None:
                check = StreamCheck(loaded, samples.session, sample_rate=1.0 / samples.interval)
            for event in () if check is None else check.feed(chunk):
                show(event)
    if check is None:
        raise InputError(f"{listen}: expected rows of numbers, found fewer than show the interval of samples")
    for event in check.finish():
        show(event)
    return check.result()
