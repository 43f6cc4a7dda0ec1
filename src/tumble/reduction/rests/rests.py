"""Rests: mean readings with covariance, drift, noise and temperatures, from the blocks of a log.

The covariance of a mean is that of coloured noise (`coloured_noise`), fitted to the means of the blocks within all
rests, and of rounding (`rounding`). What is not noise is taken off the blocks before: what goes with the temperature
(`warming`), and what a device that is held in the hand sways by (`sway`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal, TypeVar

import numpy as np

from tumble.reduction.blocks.reducer import ChannelState, Reduction
from tumble.reduction.noise.coloured_noise import ColouredNoise, fit_coloured_noise
from tumble.reduction.noise.rounding import Rounding, rounding
from tumble.reduction.rests.segmentation import Stretch
from tumble.reduction.rests.sway import Sway
from tumble.reduction.rests.thermometer import Thermometers
from tumble.reduction.rests.warming import KelvinAtLag, without_warming
from tumble.rotation import onto_body, tangent_basis
from tumble.sensors.model import Block
from tumble.units import Array, IntArray

ACCEL_FLOOR, GYRO_FLOOR = 1e-9, 1e-11
"""m/s² and rad/s: no mean is taken to be better known, a simulation without noise included."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rests:
    """Mean readings of N rests, with n sensors of a kind; 0 gyros where there are none.

    `file`, `start`, `stop`: file and times (N,), s. `accel`, `gyro`: mean readings (N, n), m/s² and rad/s, with
    their covariances (N, n, n). `accel_drift`, `gyro_drift`: changes of the readings (N, n) over each rest, slope
    times duration. `accel_noise`, `gyro_noise`: densities of the noise (N, n), unit/√Hz. `temperatures`: means
    (N, T) of the thermometers, K, None without any. `magnetometer`, `magnetometer_covariance`: mean readings (N, 3)
    in the unit of the magnetometer and their covariances (N, 3, 3), None without one."""

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
        """Rests of one file with mean readings (N, n) in white noise, by the densities for accelerometers and gyros."""

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


_Arrays = TypeVar("_Arrays", bound=Any)
"""Arrays of as many rows, or None."""


def rows_of(whole: _Arrays, rows: slice | IntArray) -> _Arrays:
    """Some rows of all arrays of a record."""
    columns = {field.name: getattr(whole, field.name) for field in fields(whole)}
    return replace(whole, **{name: None if values is None else values[rows] for name, values in columns.items()})


def reduced_rests(
    reduction: Reduction, spans: tuple[Stretch, ...], accel: Block, gyro: Block | None, sway: Sway | None = None
) -> tuple[Rests, list[Array], ColouredNoise | None, dict[str, Rounding]]:
    """Reduce the blocks of rests, at least one, to means with covariance.

    Returns
    -------
    rests
        The rests.
    accel_quiet
        Block means (K, n) of the accelerometers in each rest, m/s², to which their noise is fitted.
    gyro_noise
        The noise of the gyros. None without gyros.
    rounded
        For "accel" and "gyro", the resolution of the readings.
    """
    by_file, kinds = reduction.by_file, ("accel", "gyro", "magnetometer")
    pairs = [(by_file[s.file], slice(s.first, s.last)) for s in spans]
    series = {kind: [getattr(f, kind).means[span] for f, span in pairs] for kind in kinds}
    mean = {kind: np.array([getattr(f, kind).mean(span.start, span.stop) for f, span in pairs]) for kind in kinds}
    seconds = np.array([s.stop - s.start for s in spans])[:, None]
    kelvin = [f.temperature[span] for f, span in pairs if f.temperature is not None]
    of_lag: KelvinAtLag | None = None
    if len(kelvin) == len(pairs):
        thermometers, read = thermometers_of(reduction), np.concatenate(kelvin)
        file = np.repeat([s.file for s in spans], [len(of_rest) for of_rest in kelvin])
        time = np.concatenate([f.edges[1:][span] for f, span in pairs])

        def warmth(lag: float) -> Array:
            """Temperatures (K, T) at the blocks of all rests, with a lag behind the thermometers."""
            return read if lag == 0.0 else thermometers.means(file, time, time, lag).kelvin

        of_lag = warmth
    rounded: dict[str, Rounding] = {}

    def spread(kind: Literal["accel", "gyro", "magnetometer"], by_noise: Array, floor: float) -> Array:
        """Covariances (N, n, n) of the means by noise and rounding, which is added to `rounded`."""
        channels: Sequence[ChannelState] = getattr(reduction, f"{kind}_channels")
        ends = {f.file: getattr(f, kind).ends for f in reduction.files}
        every, of_rests = list(ends.values()), [ends[s.file][s.first : s.last] for s in spans]
        rounded[kind] = rounding(every[0] if len(every) == 1 else np.concatenate(every), of_rests, channels)
        return np.asarray(by_noise + np.diag(floor**2 + rounded[kind].rest_u ** 2))

    def of_means(noise: ColouredNoise, kind: str) -> Array:
        return np.array([noise.covariance_of_mean(len(s), i) for i, s in enumerate(series[kind])])

    def density(covariance: Array) -> Array:
        """Noise density (N, n), unit/√Hz, behind the covariance of the means."""
        return np.asarray(np.sqrt(np.diagonal(covariance, axis1=1, axis2=2) * seconds))

    accel_series = series["accel"]
    if sway is not None:
        accel_series = [y - force @ accel.axes.T for y, force in zip(accel_series, sway.force, strict=True)]
    accel_quiet = without_warming(accel_series, of_lag, accel.thermometer)
    accel_spread = spread("accel", accel_covariance(accel_quiet, accel), ACCEL_FLOOR)
    gyro_noise, gyro_spread = None, np.empty((len(spans), 0, 0))
    if gyro is not None:
        gyro_noise = fit_coloured_noise(without_warming(series["gyro"], of_lag, gyro.thermometer))
        gyro_spread = spread("gyro", of_means(gyro_noise, "gyro"), GYRO_FLOOR)
    field_spread = None
    if reduction.magnetometer_channels:
        field_noise = fit_coloured_noise(series["magnetometer"])
        field_spread = spread("magnetometer", of_means(field_noise, "magnetometer"), 0.0)
        del rounded["magnetometer"]
    rests = Rests(
        file=np.array([s.file for s in spans]),
        start=np.array([s.start for s in spans]),
        stop=np.array([s.stop for s in spans]),
        accel=mean["accel"],
        accel_covariance=accel_spread,
        accel_drift=drift(series["accel"]),
        accel_noise=density(accel_spread),
        gyro=mean["gyro"],
        gyro_covariance=gyro_spread,
        gyro_drift=drift(series["gyro"]),
        gyro_noise=density(gyro_spread),
        temperatures=None if of_lag is None else np.array([of_rest.mean(axis=0) for of_rest in kelvin]),
        magnetometer=None if field_spread is None else mean["magnetometer"],
        magnetometer_covariance=field_spread,
    )
    return rests, accel_quiet, gyro_noise, rounded


def thermometers_of(reduction: Reduction) -> Thermometers:
    """The records of the thermometers, at the ends of the blocks."""
    return Thermometers.of({f.file: (f.edges[1:], f.temperature) for f in reduction.files if f.temperature is not None})


def accel_covariance(series: list[Array], block: Block) -> Array:
    """Covariance (N, n, n) of the mean accelerometer readings, from the block means (K, n) within each rest.

    A slow tilt of the body shows in the horizontal directions, where it would pass for sensor noise; the vertical, and
    for n > 3 the directions that no specific force explains, are free of it to first order. The noise of the two kinds
    of direction is therefore estimated separately. Channels are first divided by their noise from block to block, and a
    rough bias is subtracted, which would turn the directions."""
    size = np.sqrt(np.median([np.diff(s, axis=0).var(axis=0) for s in series], axis=0))
    size = np.where(size > 0.0, size, 1.0)
    mean = np.array([s.mean(axis=0) for s in series])
    force = mean @ onto_body(block.axes).T
    # the centre of the sphere through the specific forces is the bias, where they determine it
    rows = np.column_stack([2.0 * force, np.ones(len(force))])
    (*centre, _), _, rank, singular = np.linalg.lstsq(rows, (force**2).sum(axis=1))
    determined = rank == 4 and len(force) >= 6 and singular[-1] > 0.1
    if determined and np.linalg.norm(centre) < 0.5 * np.linalg.norm(force, axis=1).mean():
        force = force - centre
    tilted = np.einsum("pk,ijk->ipj", block.axes, tangent_basis(force / np.linalg.norm(force, axis=1, keepdims=True)))
    basis, _ = np.linalg.qr(tilted / size[:, None], mode="complete")
    rotated = [s / size @ q for s, q in zip(series, basis, strict=True)]
    variance = np.empty_like(mean)
    for group in (slice(0, 2), slice(2, None)):
        columns = [column[:, None] for r in rotated for column in r[:, group].T]
        fit = fit_coloured_noise(columns)
        variances = [fit.covariance_of_mean(len(x), i)[0, 0] for i, x in enumerate(columns)]
        variance[:, group] = np.array(variances).reshape(len(series), -1).mean(axis=1, keepdims=True)
    scaled = basis * size[:, None]
    return np.asarray(scaled * variance[:, None, :] @ np.swapaxes(scaled, 1, 2))


def drift(series: list[Array]) -> Array:
    """Change of the readings over each rest: least-squares slope times duration."""
    out = []
    for s in series:
        x = np.arange(len(s)) - 0.5 * (len(s) - 1)
        out.append(x @ s / (x @ x) * len(s))
    return np.array(out)


def sphere_through(points: Array, least: float | None = None) -> tuple[Array, float]:
    """Centre (3,) and radius of the sphere nearest to points (N, 3), the bias and the scale where these are readings of
    a vector of constant length: |y|² = 2 y·c + r² − |c|² by least squares about their mean. Along directions in which
    they are spread by less than the part `least` of the widest the centre is their mean."""
    mean = points.mean(axis=0)
    away = points - mean
    square = (away**2).sum(axis=1)
    offset = np.linalg.lstsq(2.0 * away, square - square.mean(), rcond=least)[0]
    return mean + offset, float(np.sqrt(square.mean() + offset @ offset))
