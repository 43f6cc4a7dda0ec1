"""Rests: their mean readings with covariance, drift, noise and temperatures, from the blocks of a log."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.reduction.blocks.reducer import Reduction
from tumble.reduction.noise.coloured_noise import ColouredNoise, fit_coloured_noise
from tumble.reduction.noise.rounding import Rounding
from tumble.reduction.rests.rest_noise import accel_covariance, channel_rounding, density, drift
from tumble.reduction.rests.segmentation import RestSpan
from tumble.reduction.rests.thermometer import Thermometers
from tumble.reduction.rests.warming import KelvinAtLag, without_warming
from tumble.sensors.model import Block
from tumble.units import Array, IntArray

ACCEL_FLOOR = 1e-9  # m/s²
GYRO_FLOOR = 1e-11  # rad/s


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rests:
    """N rests: file, start and stop (s), mean readings and their covariances in SI; drift is the change of a
    reading over the rest (slope times duration) and noise its density, unit/√Hz. The gyro arrays are empty
    (N, 0) where there are no gyros; the mean `temperatures` are those of the thermometers (N, T), K; the magnetometer's
    mean readings and their covariances are in its unit. None where there are none."""

    file: IntArray
    start: Array
    stop: Array
    accel: Array
    accel_covariance: Array
    accel_drift: Array
    accel_noise: Array
    gyro: Array
    gyro_covariance: Array
    gyro_drift: Array
    gyro_noise: Array
    temperatures: Array | None
    magnetometer: Array | None = None
    magnetometer_covariance: Array | None = None

    def __len__(self) -> int:
        return len(self.start)

    @staticmethod
    def of_white_noise(
        start: Array,
        stop: Array,
        *,
        accel: Array,
        gyro: Array,
        densities: tuple[float, float],
        temperatures: Array | None = None,
    ) -> Rests:
        """Rests of one file with these mean readings (N, n), in white noise of these densities of the accelerometers
        and the gyros."""

        def covariance(readings: Array, density: float, floor: float) -> Array:
            variance = density**2 / (stop - start) + floor**2
            return np.asarray(variance[:, None, None] * np.eye(readings.shape[1]))

        return Rests(
            file=np.zeros(len(start), dtype=np.int64),
            start=start,
            stop=stop,
            accel=accel,
            accel_covariance=covariance(accel, densities[0], ACCEL_FLOOR),
            accel_drift=np.zeros_like(accel),
            accel_noise=np.full_like(accel, densities[0]),
            gyro=gyro,
            gyro_covariance=covariance(gyro, densities[1], GYRO_FLOOR),
            gyro_drift=np.zeros_like(gyro),
            gyro_noise=np.full_like(gyro, densities[1]),
            temperatures=temperatures,
        )

    @property
    def temperature(self) -> Array | None:
        """The mean over the thermometers (N,), K."""
        return None if self.temperatures is None else np.asarray(self.temperatures.mean(axis=1))


def reduced_rests(
    reduction: Reduction, spans: tuple[RestSpan, ...], accel: Block, gyro: Block | None
) -> tuple[Rests, list[Array], ColouredNoise | None, dict[str, Rounding]]:
    """The rests at these spans, at least one, what their noise is fitted to of the accelerometers, the noise of the
    gyros and the rounding by kind of channel."""
    by_file, kinds = reduction.by_file, ("accel", "gyro", "magnetometer")
    pairs = [(by_file[s.file], slice(s.first, s.last)) for s in spans]
    series = {kind: [getattr(f, kind).means[span] for f, span in pairs] for kind in kinds}
    mean = {kind: np.array([getattr(f, kind).mean(span.start, span.stop) for f, span in pairs]) for kind in kinds}
    durations = np.array([s.stop - s.start for s in spans])
    kelvin = [f.temperature[span] for f, span in pairs if f.temperature is not None]
    of_lag: KelvinAtLag | None = None
    if len(kelvin) == len(pairs):
        thermometers, read = thermometers_of(reduction), np.concatenate(kelvin)
        file = np.repeat([s.file for s in spans], [len(each) for each in kelvin])
        time = np.concatenate([f.edges[1:][span] for f, span in pairs])

        def warmth(lag: float) -> Array:
            """What follows each thermometer."""
            return read if lag == 0.0 else thermometers.means(file, time, time, lag).kelvin

        of_lag = warmth
    accel_quiet = without_warming(series["accel"], of_lag, accel.thermometer)
    rounded = {"accel": channel_rounding(reduction, spans, "accel")}
    accel_spread = accel_covariance(accel_quiet, accel) + np.diag(ACCEL_FLOOR**2 + rounded["accel"].of_rest ** 2)
    gyro_noise, gyro_spread = None, np.empty((len(spans), 0, 0))
    if gyro is not None:
        gyro_noise = fit_coloured_noise(without_warming(series["gyro"], of_lag, gyro.thermometer))
        rounded["gyro"] = channel_rounding(reduction, spans, "gyro")
        gyro_spread = _spread(gyro_noise, series["gyro"], rounded["gyro"], GYRO_FLOOR)
    field_spread = None
    if reduction.magnetometer_channels:
        rounding, noise = channel_rounding(reduction, spans, "magnetometer"), fit_coloured_noise(series["magnetometer"])
        field_spread = _spread(noise, series["magnetometer"], rounding, 0.0)
    rests = Rests(
        file=np.array([s.file for s in spans]),
        start=np.array([s.start for s in spans]),
        stop=np.array([s.stop for s in spans]),
        accel=mean["accel"],
        accel_covariance=accel_spread,
        accel_drift=drift(series["accel"]),
        accel_noise=density(accel_spread, durations),
        gyro=mean["gyro"],
        gyro_covariance=gyro_spread,
        gyro_drift=drift(series["gyro"]),
        gyro_noise=density(gyro_spread, durations),
        temperatures=None if of_lag is None else np.array([each.mean(axis=0) for each in kelvin]),
        magnetometer=None if field_spread is None else mean["magnetometer"],
        magnetometer_covariance=field_spread,
    )
    return rests, accel_quiet, gyro_noise, rounded


def _spread(noise: ColouredNoise, series: list[Array], rounding: Rounding, floor: float) -> Array:
    """Covariances (N, n, n) of the means of rests by noise and rounding."""
    by_noise = np.array([noise.covariance_of_mean(len(s), i) for i, s in enumerate(series)])
    return np.asarray(by_noise + np.diag(floor**2 + rounding.of_rest**2))


def thermometers_of(reduction: Reduction) -> Thermometers:
    """The records of the thermometers: a temperature is that at the end of a block."""
    return Thermometers.of({f.file: (f.edges[1:], f.temperature) for f in reduction.files if f.temperature is not None})
