"""Rests: their mean readings with covariance, drift, noise and temperatures, from the blocks of a log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tumble.reduction.blocks.reducer import ChannelState, Reduction
from tumble.reduction.noise.coloured_noise import ColouredNoise, fit_coloured_noise
from tumble.reduction.noise.rounding import Rounding, rounding
from tumble.reduction.rests.segmentation import RestSpan
from tumble.reduction.rests.thermometer import Thermometers
from tumble.reduction.rests.warming import KelvinAtLag, without_warming
from tumble.rotation import tangent_basis
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
        rounded_field = channel_rounding(reduction, spans, "magnetometer")
        noise = fit_coloured_noise(series["magnetometer"])
        field_spread = _spread(noise, series["magnetometer"], rounded_field, 0.0)
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


def _spread(noise: ColouredNoise, series: list[Array], of_channels: Rounding, floor: float) -> Array:
    """Covariances (N, n, n) of the means of rests by noise and rounding."""
    by_noise = np.array([noise.covariance_of_mean(len(s), i) for i, s in enumerate(series)])
    return np.asarray(by_noise + np.diag(floor**2 + of_channels.of_rest**2))


def thermometers_of(reduction: Reduction) -> Thermometers:
    """The records of the thermometers: a temperature is that at the end of a block."""
    return Thermometers.of({f.file: (f.edges[1:], f.temperature) for f in reduction.files if f.temperature is not None})


# How uncertain mean readings are, from what the rests themselves show


def accel_covariance(series: list[Array], block: Block) -> Array:
    """Covariance (N, n, n) of the mean accelerometer readings.

    A rest in which the body slowly tilts shows it in the horizontal directions, where it would pass for sensor
    noise; the vertical, and for n > 3 the directions that no specific force explains, are free of it to first
    order. The two kinds of direction therefore have noises of their own. Channels are first divided by their
    noise from block to block; a rough bias is taken off first, lest it should turn the directions."""
    size = np.sqrt(np.median([np.diff(s, axis=0).var(axis=0) for s in series], axis=0))
    size = np.where(size > 0.0, size, 1.0)
    mean = np.array([s.mean(axis=0) for s in series])
    force = mean @ np.linalg.pinv(block.axes).T
    force = force - _rough_bias(force)
    tilted = np.einsum("pk,ijk->ipj", block.axes, tangent_basis(force / np.linalg.norm(force, axis=1, keepdims=True)))
    basis, _ = np.linalg.qr(tilted / size[:, None], mode="complete")
    rotated = [s / size @ q for s, q in zip(series, basis, strict=True)]
    variance = np.empty_like(mean)
    for group in (slice(0, 2), slice(2, None)):
        columns = [r[:, group][:, [c]] for r in rotated for c in range(r[:, group].shape[1])]
        fit = fit_coloured_noise(columns)
        each = [fit.covariance_of_mean(len(x), i)[0, 0] for i, x in enumerate(columns)]
        variance[:, group] = np.array(each).reshape(len(series), -1).mean(axis=1, keepdims=True)
    scaled = basis * size[:, None]
    covariance = scaled * variance[:, None, :] @ np.swapaxes(scaled, 1, 2)
    return np.asarray(covariance)


def _rough_bias(force: Array) -> Array:
    """The centre (3,) of the sphere through specific forces (N, 3) at rest; zero where they do not tell."""
    rows = np.column_stack([2.0 * force, np.ones(len(force))])
    solution, _, rank, singular = np.linalg.lstsq(rows, (force**2).sum(axis=1))
    size = float(np.linalg.norm(force, axis=1).mean())
    seen = rank == 4 and len(force) >= 6 and singular[-1] > 0.1
    return np.asarray(solution[:3]) if seen and float(np.linalg.norm(solution[:3])) < 0.5 * size else np.zeros(3)


def density(covariance: Array, seconds: Array) -> Array:
    """Noise density (N, n), unit/√Hz, behind the covariance of the means."""
    return np.sqrt(np.diagonal(covariance, axis1=1, axis2=2) * seconds[:, None])


def drift(series: list[Array]) -> Array:
    """Change of the readings over each rest: least-squares slope times duration."""
    out = []
    for s in series:
        x = np.arange(len(s)) - 0.5 * (len(s) - 1)
        out.append(x @ s / (x @ x) * len(s))
    return np.array(out)


def channel_rounding(
    reduction: Reduction, spans: tuple[RestSpan, ...], kind: Literal["accel", "gyro", "magnetometer"]
) -> Rounding:
    """The rounding of one kind of channels."""
    channels: Sequence[ChannelState] = getattr(reduction, f"{kind}_channels")
    ends = {f.file: getattr(f, kind).ends for f in reduction.files}
    rests = [ends[s.file][s.first : s.last] for s in spans]
    every = list(ends.values())
    return rounding(every[0] if len(every) == 1 else np.concatenate(every), rests, channels)
