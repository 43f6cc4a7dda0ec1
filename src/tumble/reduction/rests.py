"""Rests: their mean readings with covariance, drift, noise and temperatures, from the blocks of a log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tumble.reduction.blocks import FileBlocks, Reduction
from tumble.reduction.coloured_noise import ColouredNoise, fit_coloured_noise
from tumble.reduction.rest_noise import accel_covariance, channel_rounding, density, drift
from tumble.reduction.rounding import Rounding
from tumble.reduction.segmentation import RestSpan
from tumble.reduction.thermometer import Thermometers
from tumble.reduction.warming import KelvinAtLag, without_warming
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

    @property
    def temperature(self) -> Array | None:
        """The mean over the thermometers (N,), K."""
        return None if self.temperatures is None else np.asarray(self.temperatures.mean(axis=1))


def reduced_rests(
    reduction: Reduction, spans: tuple[RestSpan, ...], accel: Block, gyro: Block | None
) -> tuple[Rests, list[Array], ColouredNoise | None, dict[str, Rounding]]:
    """The rests at these spans, at least one, what their noise is fitted to of the accelerometers, the noise of the
    gyros and the rounding by kind of channel."""
    by_file = reduction.by_file
    blocks = [by_file[s.file] for s in spans]
    durations = np.array([s.stop - s.start for s in spans])
    accel_series, gyro_series, temperatures = _series(blocks, spans)
    warmth = _warmth(reduction, blocks, spans, temperatures)
    accel_quiet = without_warming(accel_series, warmth, accel.thermometer)
    rounded = {"accel": channel_rounding(reduction, spans, "accel")}
    accel_spread = accel_covariance(accel_quiet, accel) + np.diag(ACCEL_FLOOR**2 + rounded["accel"].of_rest ** 2)
    gyro_noise, gyro_spread = None, np.empty((len(spans), 0, 0))
    if gyro is not None:
        gyro_noise = fit_coloured_noise(without_warming(gyro_series, warmth, gyro.thermometer))
        rounded["gyro"] = channel_rounding(reduction, spans, "gyro")
        gyro_spread = np.array([gyro_noise.covariance_of_mean(len(s), i) for i, s in enumerate(gyro_series)])
        gyro_spread += np.diag(GYRO_FLOOR**2 + rounded["gyro"].of_rest ** 2)
    magnetometer, magnetometer_covariance = _magnetometer(reduction, blocks, spans)
    rests = Rests(
        file=np.array([s.file for s in spans]),
        start=np.array([s.start for s in spans]),
        stop=np.array([s.stop for s in spans]),
        accel=np.array([f.accel.mean(s.first, s.last) for f, s in zip(blocks, spans, strict=True)]),
        accel_covariance=accel_spread,
        accel_drift=drift(accel_series),
        accel_noise=density(accel_spread, durations),
        gyro=np.array([f.gyro.mean(s.first, s.last) for f, s in zip(blocks, spans, strict=True)]),
        gyro_covariance=gyro_spread,
        gyro_drift=drift(gyro_series),
        gyro_noise=density(gyro_spread, durations),
        temperatures=None if temperatures is None else np.array([each.mean(axis=0) for each in temperatures]),
        magnetometer=magnetometer,
        magnetometer_covariance=magnetometer_covariance,
    )
    return rests, accel_quiet, gyro_noise, rounded


def _series(
    blocks: Sequence[FileBlocks], spans: tuple[RestSpan, ...]
) -> tuple[list[Array], list[Array], list[Array] | None]:
    """Block means of the accelerometers and of the gyros in the rests at these spans, and their temperatures
    (K, T), K, where all rests have some."""
    pairs = list(zip(blocks, spans, strict=True))
    accel, gyro = ([getattr(f, kind).means[s.first : s.last] for f, s in pairs] for kind in ("accel", "gyro"))
    kelvin = [f.temperature[s.first : s.last] for f, s in pairs if f.temperature is not None]
    return accel, gyro, kelvin if len(kelvin) == len(pairs) else None


def _warmth(
    reduction: Reduction, blocks: Sequence[FileBlocks], spans: tuple[RestSpan, ...], kelvin: list[Array] | None
) -> KelvinAtLag | None:
    """From a lag to the temperatures, K, of what follows each thermometer in the rests at these spans, where it has
    itself `kelvin`; None where there are none."""
    if kelvin is None:
        return None
    thermometers, file = thermometers_of(reduction), np.repeat([s.file for s in spans], [len(each) for each in kelvin])
    read = np.concatenate(kelvin)
    time = np.concatenate([f.edges[1:][s.first : s.last] for f, s in zip(blocks, spans, strict=True)])
    return lambda lag: read if lag == 0.0 else thermometers.means(file, time, time, lag).kelvin


def thermometers_of(reduction: Reduction) -> Thermometers:
    """The records of the thermometers: a temperature is that at the end of a block."""
    return Thermometers.of({f.file: (f.edges[1:], f.temperature) for f in reduction.files if f.temperature is not None})


def _magnetometer(
    reduction: Reduction, blocks: list[FileBlocks], spans: tuple[RestSpan, ...]
) -> tuple[Array, Array] | tuple[None, None]:
    """Mean readings (N, 3) of the magnetometer in the rests and their covariances (N, 3, 3), in its unit."""
    if not reduction.magnetometer_channels:
        return None, None
    series = [f.magnetometer.means[s.first : s.last] for f, s in zip(blocks, spans, strict=True)]
    mean = np.array([f.magnetometer.mean(s.first, s.last) for f, s in zip(blocks, spans, strict=True)])
    noise = fit_coloured_noise(series)
    covariance = np.array([noise.covariance_of_mean(len(s), i) for i, s in enumerate(series)])
    return mean, covariance + np.diag(channel_rounding(reduction, spans, "magnetometer").of_rest ** 2)
