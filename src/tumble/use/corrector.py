"""Correction of a stream of readings with the whole model of a calibration, sample by sample or in blocks.

Each sample is corrected at the temperature of its sensors, which follow the thermometer with the lags of the
calibration. If accelerometers have lever arms and there are gyros, the specific force is transferred to the place of
the last accelerometer,

    f = f_p − ω̇ × r − ω × (ω × r),     ω̇ᵢ = (ωᵢ₊₁ − ωᵢ₋₁) / (tᵢ₊₁ − tᵢ₋₁)

so that a sample is corrected one sample later. If its neighbours are more than LONGEST_STEP intervals apart, or in the
wrong order, ω̇ is unknown and the sample is not transferred. Delays of the accelerometers are not corrected.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import inf, nan

import numpy as np
import numpy.typing as npt

from tumble.arguments import array_of, checked
from tumble.brief import Brief
from tumble.errors import InputError
from tumble.files import FilePath
from tumble.recording.arrays import check_kelvin
from tumble.result.accepted import accepted_part
from tumble.result.calibration import Calibration, calibration_from
from tumble.sensors.compensation import Compensator
from tumble.sensors.fixed_point import TOO_FAST, TOO_MUCH, TOO_WARM, WIDTH, advance
from tumble.sensors.model import Block
from tumble.units import G_STANDARD, ZERO_CELSIUS, Array, BoolArray

LONGEST_STEP = 3.5
"""Largest distance, in intervals, of the neighbours from which the angular acceleration of a sample is computed."""
CLOCK_RESTART = 1.0
"""s. If a stamp is earlier than the last one by more, the clock has restarted; a sample that is less late is
dropped."""
MARGIN = 0.1
"""Relative margin of the calibrated rate and force, for noise and vibration."""
_ROWS = 1 << 12
"""Rows corrected at a time: intermediate results fit the cache of a core."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, repr=False)
class Corrected(Brief):
    """Corrected samples, as views of memory that the next block overwrites.

    `time` (N,) are stamps, s, `force` (N, 3) specific forces, m/s², and `rate` (N, 3) angular rates, rad/s, None
    without gyros. `flags` (N,) are sums of 1, 2 and 4 for a temperature, a rate and a force outside the calibrated
    range. `temperature` (N, T), K, is that of the sensors that follow each thermometer; if accelerometers and gyros
    have different lags it is (N, 2 T), those of the accelerometers first."""

    time: Array
    force: Array
    rate: Array | None
    flags: Array
    temperature: Array

    def __len__(self) -> int:
        """Number of samples."""
        return len(self.time)

    @property
    def outside(self) -> dict[str, BoolArray]:
        """Whether samples (N,) are outside the calibrated "temperature", "rate" and "force"."""
        bits = self.flags.astype(np.int64)
        names = {"temperature": TOO_WARM, "rate": TOO_FAST, "force": TOO_MUCH}
        return {name: (bits & bit) != 0 for name, bit in names.items()}


@dataclass(frozen=True, kw_only=True, slots=True)
class Ranges:
    """Calibrated ranges: lowest and highest `temperature`, °C, largest `rate`, rad/s, and largest `force`, m/s².

    A range that is not known is infinite."""

    temperature: tuple[float, float] = (-inf, inf)
    rate: float = inf
    force: float = inf

    @staticmethod
    def of(calibration: Calibration) -> Ranges:
        """Return the temperatures of the rests and, with MARGIN, the rate of the turns and gravity."""
        prediction, site = calibration.prediction, calibration.provenance.site
        rate = inf if prediction is None or prediction.at_rate is None else (1.0 + MARGIN) * prediction.at_rate
        force = (1.0 + MARGIN) * (G_STANDARD if site is None else site.gravity)
        return Ranges(temperature=calibration.temperature_range or (-inf, inf), rate=rate, force=force)


class Stream:
    """Correction of the rows of one stream with sampling `interval`, s, and the sensors `blocks`.

    `thermometers` is the number of thermometers, which read `zero` at 0 °C: 273.15 in K, 0 in °C. Without `gyros` no
    rates are corrected. Samples outside the `ranges` are flagged. A stamp that is earlier than the last one by more
    than `clock_restart`, s, begins another stream: CLOCK_RESTART, or 0 for a log, whose stamps are in order. Readings
    and state are arrays that `tumble.sensors.fixed_point.advance` describes."""

    def __init__(
        self,
        compensator: Compensator,
        interval: float,
        *,
        blocks: tuple[Block, Block | None],
        thermometers: int,
        gyros: bool = True,
        ranges: Ranges | None = None,
        zero: float = 0.0,
        clock_restart: float = 0.0,
    ) -> None:
        ranges = ranges or Ranges()
        self.gyros = gyros and blocks[1] is not None and compensator.gyro is not None
        accel_thermometers, gyro_thermometers = (
            np.zeros(0, np.int64) if block is None else block.thermometer for block in blocks
        )
        lags = [compensator.lags.get(kind, 0.0) for kind in ("accel", "gyro")[: 1 + self.gyros]]
        lags = list(dict.fromkeys(lags)) if compensator.warm else [0.0]
        if len(lags) > 1:  # each thermometer with the lag of accelerometers, then with that of gyros
            gyro_thermometers = thermometers + gyro_thermometers
        self.moved = self.gyros and bool(np.any(compensator.levers))
        self.delay = int(self.moved)
        accel, gyro = compensator.solvers["accel"], compensator.solvers["gyro"] if self.gyros else None
        gyro_sheet = np.zeros((0, WIDTH)) if gyro is None else gyro.sheet
        gyro_steps, feels = (1, False) if gyro is None else (gyro.steps, gyro.feels)
        self._sensors = accel.sheet, gyro_sheet, accel_thermometers, gyro_thermometers, accel.steps, gyro_steps, feels
        limits = LONGEST_STEP * interval, ranges.rate**2, ranges.force**2
        self._settings = np.array([interval, *ranges.temperature, clock_restart, zero, *limits, nan])
        n, m = len(accel.sheet), len(gyro_sheet)
        followers = len(lags) * thermometers
        self._start = np.zeros(followers)  # temperatures of the sensors before the first sample, °C
        for block, numbers in ((compensator.accel, accel_thermometers), (compensator.gyro, gyro_thermometers)):
            if block is not None and block.kind in compensator.references and len(numbers) == block.size:
                self._start[numbers] = compensator.references[block.kind]
        self._state: tuple[Array, ...] = (
            np.zeros((2, 2 + 2 * n + m + followers + 9)),
            np.column_stack([np.zeros((followers, 2)), np.repeat(lags, thermometers)]),
            np.zeros(3),
            np.zeros((2, max(n, m))),
        )
        self._nothing = np.zeros((0, n)), np.zeros((0, m)), np.zeros(0), np.zeros((0, thermometers))
        self._no_temperature = self._nothing[3]  # rows of NaN, for readings without temperatures
        self._out: tuple[Array, ...] = np.zeros((0, 2 + followers)), np.zeros((0, 3)), np.zeros((0, 3))
        self._view = self._views(0)
        self.reset()

    def reset(self) -> None:
        """Begin another stream, but keep the count of dropped samples."""
        self._held = 0
        _, warmth, clock, _ = self._state
        warmth[:, 0], warmth[:, 1], clock[:2] = self._start, nan, (-inf, 0.0)

    @property
    def dropped(self) -> int:
        """Number of late samples that were dropped."""
        return int(self._state[2][2])

    def add(self, accel: Array, gyro: Array | None, time: Array | None, temperature: Array | None) -> Corrected:
        """Add readings (N, n) and (N, m), SI, and return the samples whose correction they complete.

        Stamps (N,), s, are by default those of a regular clock; temperatures (N, T) are in the unit of `zero`, NaN
        where they are lost."""
        count = len(accel)
        if count + 1 > len(self._out[0]):
            widths = (each.shape[1] for each in self._out)
            self._out = tuple(np.zeros((count + 1, width)) for width in widths)
            kept, *others = self._state
            rows = np.zeros((min(count, _ROWS) + 2, kept.shape[1]))
            rows[:2] = kept[:2]
            self._state, self._view = (rows, *others), self._views(0)
            self._no_temperature = np.full((min(count, _ROWS), self._no_temperature.shape[1]), nan)
        given, ready = (accel, gyro, time, temperature), 0
        for i in range(0, count, _ROWS):
            whole = count <= _ROWS  # the usual case of single samples is not sliced
            pieces = given if whole else tuple(None if each is None else each[i : i + _ROWS] for each in given)
            ready += self._advance(pieces, ready)
        return self._corrected(ready)

    def finish(self) -> Corrected:
        """Return the last sample if it is still pending, and begin another stream."""
        ready = self._advance(self._nothing, 0, last=True)
        self.reset()
        return self._corrected(ready)

    def _advance(self, pieces: tuple[Array | None, ...], done: int, *, last: bool = False) -> int:
        """Correct more samples after the first `done` of this call; return how many are ready."""
        absent = (*self._nothing[:3], self._no_temperature)
        rows = tuple(other if each is None else each for each, other in zip(pieces, absent, strict=True))
        out = self._out if not done else tuple(each[done:] for each in self._out)
        ready, self._held = advance(
            rows, self._sensors, self._settings, self._state, self._held, out, moved=self.moved, last=last
        )
        return ready

    def _corrected(self, ready: int) -> Corrected:
        if len(self._view.time) != ready:
            self._view = self._views(ready)
        return self._view

    def _views(self, ready: int) -> Corrected:
        stamps, force, rate = (each[:ready] for each in self._out)
        time, flags, temperature = stamps[:, 0], stamps[:, 1], stamps[:, 2:]
        rates = rate if self.gyros else None
        return Corrected(time=time, force=force, rate=rates, flags=flags, temperature=temperature)


class Corrector:
    """Correction of the readings of a device as they arrive, with the whole model of its calibration.

    For any division of the stream into blocks the results are those of `apply_to_session` for the whole log.

    Parameters
    ----------
    calibration
        An accepted calibration, or its file. If only the accelerometers or the gyros are accepted, the others are not
        corrected; without accelerometers the specific force is not a number.
    sample_rate
        Samples per second. By default that of the recording of the calibration.

    Raises
    ------
    CalibrationError
        If nothing is accepted.
    InputError
        If the sample rate is neither given nor known, or not positive.

    Notes
    -----
    A sample whose stamp is not after the last one is dropped, and counted in `dropped`. If it is earlier by more than
    CLOCK_RESTART (1 s), the clock has restarted, which is a gap. Across a gap ω̇ is unknown.

    Examples
    --------
    >>> import tumble
    >>> folder = tumble.simulate_session("session", tumble.Setup.of(grade="mems", positions=12), seed=1)
    >>> corrector = tumble.Corrector(tumble.calibrate(folder), sample_rate=100.0)
    >>> corrector.delay
    1
    >>> for k in range(3):
    ...     ready = corrector.add([0.1, 0.2, 9.8], [0.0, 0.01, 0.0], time=0.01 * k)
    ...     print(len(ready), ready.time)
    0 []
    1 [0.]
    1 [0.01]
    >>> corrector.finish().time
    array([0.02])
    """

    @checked
    def __init__(self, calibration: Calibration | FilePath, *, sample_rate: float | None = None) -> None:
        self.calibration = accepted_part(calibration_from(calibration))
        rate = self.calibration.provenance.sample_rate if sample_rate is None else sample_rate
        if rate is None or not 0.0 < rate < inf:
            raise InputError(f"sample_rate: expected samples a second, found {rate}; give sample_rate=")
        self.sample_rate = rate
        """Samples per second."""
        self.ranges = Ranges.of(self.calibration)
        """Ranges outside of which samples are flagged."""
        self._compensator = compensator = self.calibration.compensator
        blocks = compensator.accel, compensator.gyro
        self.thermometers = 1 + max(int(block.thermometer.max()) for block in blocks if block is not None)
        """Number of thermometers that the readings come with."""
        self._sizes = [0 if block is None else block.size for block in blocks]
        self._stream = Stream(
            compensator,
            1.0 / rate,
            blocks=blocks,
            thermometers=self.thermometers,
            ranges=self.ranges,
            zero=ZERO_CELSIUS,
            clock_restart=CLOCK_RESTART,
        )

    @property
    def delay(self) -> int:
        """Number of samples by which the output lags behind the input: 1 with lever arms, else 0."""
        return self._stream.delay

    @property
    def dropped(self) -> int:
        """Number of late samples that were dropped."""
        return self._stream.dropped

    def reset(self) -> None:
        """Begin another stream, with the sensors at the temperature of the thermometer."""
        self._stream.reset()

    def add(
        self,
        accel: npt.ArrayLike,
        gyro: npt.ArrayLike | None = None,
        *,
        time: npt.ArrayLike | None = None,
        temperature: npt.ArrayLike | None = None,
    ) -> Corrected:
        """Add one sample, (n,), or a block, (N, n), and return the samples whose correction it completes.

        Parameters
        ----------
        accel, gyro
            Readings, SI after nominal scale and offset; increments divided by their interval. Numbers that are not
            finite stay so.
        time
            Stamps, s, one for each sample. By default those of a regular clock.
        temperature
            Temperature, K, one for each sample, or those of several thermometers (T,) or (N, T) in the order of the
            calibration's `thermometers`. If it is absent or NaN, the last known one is used, else the reference.

        Returns
        -------
        Corrected
            Views, which the next call overwrites.

        Raises
        ------
        InputError
            For other shapes, and temperatures that are not in kelvin."""
        readings = self._rows("accel", accel, self._sizes[0])
        turned = None if gyro is None and not self._sizes[1] else self._rows("gyro", gyro, self._sizes[1])
        count = len(readings)
        stamps = np.array([time]) if isinstance(time, float) else None
        if time is not None and stamps is None:
            stamps = np.atleast_1d(array_of("time", time))
        if (turned is not None and len(turned) != count) or (stamps is not None and stamps.shape != (count,)):
            raise InputError(
                f"expected as many gyro readings and stamps as there are accel readings, {count}, found "
                f"{'none' if turned is None else len(turned)} and {'none' if stamps is None else stamps.shape}"
            )
        kelvin = None
        if temperature is not None:
            kelvin = array_of("temperature", temperature)
            if kelvin.size != count * self.thermometers:
                raise InputError(
                    f"temperature: expected {self.thermometers} for each of {count} samples, found the shape "
                    f"{kelvin.shape}"
                )
            kelvin = kelvin.reshape(count, self.thermometers)
            check_kelvin(kelvin)
        corrected = self._stream.add(readings, turned, stamps, kelvin)
        return self._without_absent(corrected)

    def finish(self) -> Corrected:
        """Return the last sample if it is still pending, with ω̇ from the previous one, and begin another stream."""
        return self._without_absent(self._stream.finish())

    def _without_absent(self, corrected: Corrected) -> Corrected:
        if self.calibration.accel is None:
            corrected.force[:] = nan
        return corrected

    @staticmethod
    def _rows(kind: str, given: npt.ArrayLike | None, sensors: int) -> Array:
        readings = np.zeros(0) if given is None else array_of(f"{kind} readings", given)
        if readings.ndim == 1:
            readings = readings[None]
        if readings.ndim != 2 or readings.shape[1] != sensors:
            raise InputError(
                f"{kind} readings: expected {sensors} numbers a sample, one for each sensor of the calibration, found "
                f"{'none' if given is None else f'an array of shape {readings.shape}'}"
            )
        return readings
