"""A stream of readings corrected live with the whole model of a calibration, sample by sample or in blocks.

Each sample is corrected at the temperature of its sensors, which follow the thermometer with the calibration's lag.
Where accelerometers have lever arms and the rate is read, they are moved to the last one,

    f = f_p − ω̇ × r − ω × (ω × r),     ω̇ᵢ = (ωᵢ₊₁ − ωᵢ₋₁) / (tᵢ₊₁ − tᵢ₋₁)

so that a sample is correct when the next one is there: `delay` is 1. Neighbours more than LONGEST_STEP usual intervals
apart, or in the wrong order, say nothing of ω̇, and the sample between them stays where its sensors are. The delays of
the accelerometers are not undone. `apply_to_session` corrects a log with the same stream.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, inf, nan

import numpy as np
import numpy.typing as npt

from tumble.errors import CalibrationError, InputError
from tumble.files import FilePath
from tumble.recording.arrays import check_kelvin
from tumble.result.accepted import accepted_part
from tumble.result.calibration import Calibration, calibration_from
from tumble.rotation import left_inverse
from tumble.sensors.compensation import Compensator
from tumble.sensors.fixed_point import ACROSS, ALONG, TOO_FAST, TOO_MUCH, TOO_WARM, WIDTH, advance
from tumble.sensors.instrument import Instrument, functions, measured_by
from tumble.sensors.parameters import FORCE, group_name
from tumble.units import G_STANDARD, ZERO_CELSIUS, Array, BoolArray, IntArray

LONGEST_STEP = 3.5
"""Of usual intervals: neighbours on either side that are further apart say nothing of the angular acceleration."""
LATEST = 1.0
"""s: a sample whose stamp is not after the last one is late and dropped; one that is earlier by more is of a clock that
was started anew."""
MARGIN = 0.1
"""Of the rate and the force of a calibration, beyond which a sample is outside of them: noise and vibration are not."""
_ROWS = 1 << 12
"""Rows that are corrected at a time: what is made of them on the way fits the cache of a core."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Corrected:
    """Samples (N,) in the order in which they came: `time`, s; specific force (N, 3), m/s²; angular rate (N, 3), rad/s,
    None without gyros; `flags` (N,), the sum of 1 for a temperature, 2 for a rate and 4 for a force outside of what
    was calibrated; and `temperature` (N, T), K, of the sensors that follow each thermometer. All are views of memory
    that the next block writes over."""

    time: Array
    force: Array
    rate: Array | None
    flags: Array
    temperature: Array

    def __len__(self) -> int:
        """How many samples there are."""
        return len(self.time)

    @property
    def outside(self) -> dict[str, BoolArray]:
        """Which samples (N,) are outside the "temperature", "rate" and "force" that were calibrated."""
        bits = self.flags.astype(np.int64)
        names = {"temperature": TOO_WARM, "rate": TOO_FAST, "force": TOO_MUCH}
        return {name: (bits & bit) != 0 for name, bit in names.items()}


@dataclass(frozen=True, kw_only=True, slots=True)
class Ranges:
    """What was calibrated: `temperature`, °C, lowest and highest; largest `rate`, rad/s, and specific `force`, m/s²;
    infinite where the calibration does not know."""

    temperature: tuple[float, float] = (-inf, inf)
    rate: float = inf
    force: float = inf

    @staticmethod
    def of(calibration: Calibration) -> Ranges:
        """Temperatures of the rests, and, with MARGIN, the rate of the turns and the gravity of the site."""
        known, site = calibration.prediction, calibration.site
        rate = inf if known is None or known.at_rate is None else (1.0 + MARGIN) * known.at_rate
        force = (1.0 + MARGIN) * (G_STANDARD if site is None else site.gravity)
        return Ranges(temperature=calibration.temperature_range or (-inf, inf), rate=rate, force=force)


class Stream:
    """The rows of one stream on their way through the model of a compensator. `thermometers` are the numbers of those
    of accelerometers and gyros, of `heat` there are; `gyros` whether rates are read."""

    def __init__(
        self,
        compensator: Compensator,
        interval: float,
        *,
        gyros: bool,
        thermometers: tuple[IntArray, IntArray],
        heat: int,
        ranges: Ranges | None = None,
        zero: float = 0.0,
        latest: float = 0.0,
    ) -> None:
        ranges, lag = ranges or Ranges(), compensator.lag if compensator.warm else 0.0
        self.gyros = gyros and compensator.gyro is not None
        self.moved = self.gyros and bool(np.any(compensator.levers))
        self.delay = int(self.moved)
        accel, rates = compensator.accelerometers, compensator.gyros if self.gyros else None
        n, m = len(accel.sheet), 0 if rates is None else len(rates.sheet)
        sheet = np.zeros((0, WIDTH)) if rates is None else rates.sheet
        steps, feels = (1, False) if rates is None else (rates.steps, rates.feels)
        self._sensors = accel.sheet, sheet, *thermometers, accel.steps, steps, feels
        kept = exp(-interval / abs(lag)) if lag else 0.0
        limits = LONGEST_STEP * interval, ranges.rate**2, ranges.force**2
        self._settings = np.array([interval, lag, kept, *ranges.temperature, latest, zero, *limits, nan])
        self._start = np.zeros(heat)
        for block, own in zip((compensator.accel, compensator.gyro), thermometers, strict=True):
            if block is not None and block.kind in compensator.references and len(own) == block.size:
                self._start[own] = compensator.references[block.kind]
        self._state: tuple[Array, ...] = (
            np.zeros((2, 2 + 2 * n + m + heat + 9)),
            np.zeros((heat, 2)),
            np.zeros(3),
            np.zeros((2, max(n, m))),
        )
        self._nothing = np.zeros((0, n)), np.zeros((0, m)), np.zeros(0), np.zeros((0, heat))
        self._lost = self._nothing[3]
        self._out: tuple[Array, ...] = np.zeros((0, 2 + heat)), np.zeros((0, 3)), np.zeros((0, 3))
        self._view = self._views(0)
        self.reset()

    def reset(self) -> None:
        """Forget all samples; those that were dropped stay counted."""
        self._held = 0
        _, warmth, clock, _ = self._state
        warmth[:, 0], warmth[:, 1], clock[:2] = self._start, nan, (-inf, 0.0)

    @property
    def dropped(self) -> int:
        """How many late samples were dropped."""
        return int(self._state[2][2])

    def add(self, accel: Array, gyro: Array | None, time: Array | None, celsius: Array | None) -> Corrected:
        """The samples that are correct now, with new ones: readings (N, n) and (N, m), stamps (N,), those of a regular
        clock where None, and temperatures (N, T), lost ones not a number."""
        count = len(accel)
        if count + 1 > len(self._out[0]):
            widths = (each.shape[1] for each in self._out)
            self._out = tuple(np.zeros((count + 1, width)) for width in widths)
            kept, *others = self._state
            rows = np.zeros((min(count, _ROWS) + 2, kept.shape[1]))
            rows[:2] = kept[:2]
            self._state, self._view = (rows, *others), self._views(0)
            self._lost = np.full((min(count, _ROWS), len(self._start)), nan)
        ready = 0
        pieces: tuple[Array | None, ...] = (accel, gyro, time, celsius)
        for i in range(0, count, _ROWS):
            if count > _ROWS:
                pieces = tuple(
                    None if given is None else given[i : i + _ROWS] for given in (accel, gyro, time, celsius)
                )
            ready += self._advance(pieces, ready)
        return self._corrected(ready)

    def finish(self) -> Corrected:
        """The last sample, where one waits; the next one begins another stream."""
        ready = self._advance(self._nothing, 0, last=True)
        self.reset()
        return self._corrected(ready)

    def _advance(self, given: tuple[Array | None, ...], begun: int, *, last: bool = False) -> int:
        """How many samples more than those that were `begun` with are correct, with some more."""
        absent = (*self._nothing[:3], self._lost)
        rows = tuple(other if each is None else each for each, other in zip(given, absent, strict=True))
        out = self._out if not begun else tuple(each[begun:] for each in self._out)
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
    """Corrects the readings of a device as they come, with the whole model of its calibration: the numbers that
    `apply_to_session` gives for the whole log, however it is cut.

    Parameters
    ----------
    calibration
        One that was accepted, or its file. Where the accelerometers or the gyros alone were, the others stay: without
        accelerometers the specific force is not a number.
    sample_rate
        Samples a second; that of the recording of the calibration where None.

    Raises
    ------
    CalibrationError
        Where nothing was accepted.
    InputError
        Where the sample rate is neither given nor known, or not positive.

    Notes
    -----
    A stamp that is not after the last one is late: its sample is dropped, and counted in `dropped`. One that is earlier
    by more than LATEST, 1 s, is of a clock that was started anew, as after a restart of the device, which is a gap.
    Across a gap ω̇ is not known. What lags behind a thermometer
    follows it by the stamps.

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

    def __init__(self, calibration: Calibration | FilePath, *, sample_rate: float | None = None) -> None:
        """Of a calibration or its file, at so many samples a second."""
        self.calibration = accepted_part(calibration_from(calibration))
        rate = self.calibration.sample_rate if sample_rate is None else sample_rate
        if rate is None or not 0.0 < rate < inf:
            raise InputError(f"sample_rate: expected samples a second, found {rate}; give sample_rate=")
        self.sample_rate = rate
        """Samples a second."""
        self.ranges = Ranges.of(self.calibration)
        """Beyond which samples are flagged."""
        self._compensator = compensator = self.calibration.compensator
        blocks = compensator.accel, compensator.gyro
        of_accel, of_gyro = (np.zeros(0, int) if block is None else block.thermometer for block in blocks)
        self.thermometers = 1 + int(max(*of_accel, *of_gyro))
        """How many thermometers its readings come with."""
        self._sizes = [0 if block is None else block.size for block in blocks]
        self._stream = Stream(
            compensator,
            1.0 / rate,
            gyros=True,
            thermometers=(of_accel, of_gyro),
            heat=self.thermometers,
            ranges=self.ranges,
            zero=ZERO_CELSIUS,
            latest=LATEST,
        )

    @property
    def delay(self) -> int:
        """By how many samples a corrected one comes later: 1 where lever arms are taken off, for ω̇ needs the next rate,
        else 0. No more of the past is needed than two samples and the temperature."""
        return self._stream.delay

    @property
    def dropped(self) -> int:
        """How many late samples were dropped."""
        return self._stream.dropped

    def reset(self) -> None:
        """Forget all samples: the next one begins another stream, as warm as the thermometer."""
        self._stream.reset()

    def add(
        self,
        accel: npt.ArrayLike,
        gyro: npt.ArrayLike | None = None,
        *,
        time: npt.ArrayLike | None = None,
        temperature: npt.ArrayLike | None = None,
    ) -> Corrected:
        """The samples that are correct now, with one more, (n,), or a block of them, (N, n).

        Parameters
        ----------
        accel, gyro
            Readings, SI after nominal scale and offset, increments divided by their interval. What is not finite stays
            so. Float64 arrays are read where they are.
        time
            Stamps, s, one for each sample; where None, those of a regular clock.
        temperature
            K, one for each sample, or of several thermometers (T,) or (N, T), in the order in which the calibration's
            `thermometers` names them. Without it, or where it is not a number, the last one known counts, else the
            reference.

        Returns
        -------
        Corrected
            Views, which the next call writes over.

        Raises
        ------
        InputError
            For other shapes, and temperatures that are not in kelvin."""
        readings = self._rows("accel", accel, self._sizes[0])
        turned = None if gyro is None and not self._sizes[1] else self._rows("gyro", gyro, self._sizes[1])
        count = len(readings)
        stamps = None if time is None else np.atleast_1d(np.asarray(time, dtype=float))
        if (turned is not None and len(turned) != count) or (stamps is not None and stamps.shape != (count,)):
            raise InputError(
                f"expected as many gyro readings and stamps as there are accel readings, {count}, found "
                f"{'none' if turned is None else len(turned)} and {'none' if stamps is None else stamps.shape}"
            )
        kelvin = None
        if temperature is not None:
            kelvin = np.asarray(temperature, dtype=float)
            if kelvin.size != count * self.thermometers:
                raise InputError(
                    f"temperature: expected {self.thermometers} for each of {count} samples, found the shape "
                    f"{kelvin.shape}"
                )
            kelvin = kelvin.reshape(count, self.thermometers)
            check_kelvin(kelvin)
        corrected = self._stream.add(readings, turned, stamps, kelvin)
        return self._known(corrected)

    def finish(self) -> Corrected:
        """The last sample, where one waits for the next, its ω̇ by the one before; what follows is another stream."""
        return self._known(self._stream.finish())

    def covariance(self, force: Array, rate: Array | None = None, celsius: float | None = None) -> Array:
        """The covariance of one corrected sample, (3, 3) of the specific force, or (6, 6) with that of the rate, SI.

        It is what the calibration's u leaves at this force, rate and temperature (the reference where None), with
        biases as the next recording meets them, and the noise of a sample: d² · sample_rate of the density d that the
        rests of the calibration have, with what ω̇ adds where lever arms are taken off. The u of lever arms and delays,
        which needs the motion, is not in it. Of accelerometers that are absent it is not a number.

        Raises CalibrationError for a calibration without covariance."""
        given, own = self.calibration.in_frame("accelerometer"), self._compensator
        if given.covariance is None:
            raise CalibrationError(f"{given.serial}: expected a calibration with covariance, found none")
        there = given.compensator
        turned = left_inverse(own.accel_coefficients[:, FORCE]) @ there.accel_coefficients[:, FORCE]
        felt, spun = turned.T @ np.asarray(force), turned.T @ (np.zeros(3) if rate is None else np.asarray(rate))
        variables = "temperature", "temperature²", "hysteresis"
        instrument = Instrument.of(there.accel, there.gyro, {group_name(name) for name in given}, variables=variables)
        values = np.array([given[name].value if name in given else 0.0 for name in instrument.names])
        known = [i for i, name in enumerate(instrument.names) if name in given]
        names = [instrument.names[i] for i in known]
        reference = given.reference_temperature
        warmer = 0.0 if celsius is None or reference is None else celsius - reference
        beta = np.concatenate([functions(block, felt[None], spun[None])[0] for block in instrument.blocks])
        J = (beta[:, None] @ derivative(instrument, values, warmer)[:, :, known])[:, 0]
        parameters = np.array(given.covariance_of(names))
        for bias in given.process_bias:
            if bias.name in names:
                parameters[(names.index(bias.name),) * 2] = max(given[bias.name].u or 0.0, bias.next_u) ** 2
        kinds = ("accel", "gyro")[: len(instrument.blocks)]
        density = [
            white_noise(given).get(kind, np.zeros(b.size)) for kind, b in zip(kinds, instrument.blocks, strict=True)
        ]
        noise = np.diag(np.concatenate(density) ** 2 * self.sample_rate)
        onto = np.zeros((3 * len(kinds), len(noise)))
        for k, (block, K) in enumerate(
            zip(instrument.blocks, (there.accel_coefficients, there.gyro_coefficients), strict=False)
        ):
            onto[3 * k : 3 * k + 3, instrument.rows(block)] = turned @ left_inverse(K[:, measured_by(block)])
        out = onto @ (J @ parameters @ J.T + noise) @ onto.T
        if self._stream.moved:  # of a central difference over two samples, var(ω̇) = var(ω) · 2 / (2 h)²
            across = onto[:3, : there.accel.size] @ there.accelerometers.sheet[:, ACROSS:ALONG] @ turned.T
            out[:3, :3] += 0.5 * self.sample_rate**2 * across @ (onto @ noise @ onto.T)[3:, 3:] @ across.T
        if given.accel is None:
            out[:3], out[:, :3] = nan, nan
        return np.asarray(out if rate is not None else out[:3, :3])

    def _known(self, corrected: Corrected) -> Corrected:
        if self.calibration.accel is None:
            corrected.force[:] = nan
        return corrected

    @staticmethod
    def _rows(kind: str, given: npt.ArrayLike | None, sensors: int) -> Array:
        """Readings (N, n)."""
        readings = np.asarray(given, dtype=float)
        if readings.ndim == 1:
            readings = readings[None]
        if readings.ndim != 2 or readings.shape[1] != sensors:
            raise InputError(
                f"{kind} readings: expected {sensors} numbers a sample, one for each sensor of the calibration, found "
                f"{'none' if given is None else f'an array of shape {np.shape(given)}'}"
            )
        return readings


def white_noise(given: Calibration) -> dict[str, Array]:
    """The density (n,) of the white noise of "accel" and "gyro", unit/√Hz, as the rests have it, where they do."""
    white = {}
    for kind in ("accel", "gyro"):
        rests = [sensors.noise for rest in given.rests if (sensors := getattr(rest, kind)) is not None]
        if rests:
            white[kind] = np.sqrt(np.mean(np.square(rests), axis=0))
    return white


def derivative(instrument: Instrument, values: Array, warmer: float) -> Array:
    """∂K/∂θ (n, 15, m) of accelerometers and gyros about the calibration, of slopes, curvatures and hysteresis that of
    the parameters which they change, at a temperature so many K from the reference."""
    D = instrument.linearised(values)[1].copy()
    by = {"temperature": warmer, "temperature²": warmer**2, "hysteresis": float(warmer != 0.0)}
    for own, base, variable in instrument.changes:
        D[:, :, own] = by[variable] * D[:, :, base]
    return D
