"""Rests: mean readings with covariance, drift, noise and temperatures, from the blocks of a log.

The covariance of a mean is that of coloured noise (`coloured_noise`), fitted to the block means within all rests, and
of rounding (`rounding`). What is not noise is subtracted from the blocks before: the dependence on temperature
(`warming`), and the sway of a device in the hand (`sway`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeVar

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

FLOORS = {"accel": 1e-9, "gyro": 1e-11}  # m/s², rad/s: smallest standard uncertainty, even of a noise-free simulation


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Rests:
    """Mean readings of N rests, with n sensors of a kind (n = 0 for missing gyros).

    `file`, `start`, `stop`: file and times (N,), s. `accel`, `gyro`: mean readings (N, n), m/s² and rad/s, with
    covariances (N, n, n). `accel_drift`, `gyro_drift`: changes of the readings over each rest (N, n), slope times
    duration. `accel_noise`, `gyro_noise`: noise densities (N, n), unit/√Hz. `temperatures`: means of the thermometers
    (N, T), K, None without any. `magnetometer`: mean readings (N, 3) in their unit, with covariances (N, 3, 3), None
    without one."""

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
        """Return rests of one file with mean readings (N, n) in white noise of these densities of accelerometers and
        gyros."""
        columns = dict[str, Any]()
        for kind, readings, density in zip(FLOORS, (accel, gyro), densities, strict=True):
            variance = density**2 / (stop - start) + FLOORS[kind] ** 2
            covariance = variance[:, None, None] * np.eye(readings.shape[1])
            columns |= _columns_of(kind, readings, covariance, np.zeros_like(readings), np.full_like(readings, density))
        file = np.zeros(len(start), dtype=np.int64)
        return Rests(file=file, start=start, stop=stop, temperatures=temperatures, **columns)

    @property
    def temperature(self) -> Array | None:
        """Mean over the thermometers (N,), K."""
        return None if self.temperatures is None else np.asarray(self.temperatures.mean(axis=1))


def _columns_of(kind: str, readings: Array, covariance: Array, change: Array, density: Array) -> dict[str, Array]:
    """Return the columns of `Rests` for the accelerometers or the gyros."""
    return {kind: readings, f"{kind}_covariance": covariance, f"{kind}_drift": change, f"{kind}_noise": density}


_Arrays = TypeVar("_Arrays", bound=Any)


def rows_of(record: _Arrays, rows: slice | IntArray) -> _Arrays:
    """Return some rows of all arrays of a record, whose fields are arrays with equally many rows, or None."""
    columns = {field.name: getattr(record, field.name) for field in fields(record)}
    return replace(record, **{name: None if values is None else values[rows] for name, values in columns.items()})


def reduced_rests(
    reduction: Reduction, spans: tuple[Stretch, ...], accel: Block, gyro: Block | None, sway: Sway | None = None
) -> tuple[Rests, dict[str, ColouredNoise], dict[str, Rounding]]:
    """Reduce the blocks of at least one rest to means with covariance.

    Besides the rests, return the noise of the block means and the resolution of the readings, of "accel" and "gyro";
    no noise without gyros."""
    pairs = [(reduction.by_file[s.file], slice(s.first, s.last)) for s in spans]
    seconds = np.array([s.stop - s.start for s in spans])[:, None]
    kelvin = [f.temperature[span] for f, span in pairs if f.temperature is not None]
    kelvin_at_lag: KelvinAtLag | None = None
    if len(kelvin) == len(pairs):
        thermometers, read = thermometers_of(reduction), np.concatenate(kelvin)
        file = np.repeat([s.file for s in spans], [len(part) for part in kelvin])
        time = np.concatenate([f.edges[1:][span] for f, span in pairs])

        def warmth(lag: float) -> Array:
            """Return temperatures (K, T) at the blocks of all rests, with a lag behind the thermometers, s."""
            return read if lag == 0.0 else thermometers.means(file, time, time, lag).kelvin

        kelvin_at_lag = warmth
    columns, noise, rounded = dict[str, Any](), dict[str, ColouredNoise](), dict[str, Rounding]()
    for kind, block in (("accel", accel), ("gyro", gyro), ("magnetometer", None)):
        channels: Sequence[ChannelState] = getattr(reduction, f"{kind}_channels")
        if not channels:
            if kind == "gyro":
                none = np.zeros((len(spans), 0))
                columns |= _columns_of(kind, none, np.zeros((len(spans), 0, 0)), none, none)
            continue
        mean = np.array([getattr(f, kind).mean(span.start, span.stop) for f, span in pairs])
        series = [getattr(f, kind).means[span] for f, span in pairs]
        quiet = series
        if kind == "accel" and sway is not None:
            quiet = [y - force @ accel.axes.T for y, force in zip(series, sway.force, strict=True)]
        if block is not None:
            quiet = without_warming(quiet, kelvin_at_lag, block.thermometer)
        if kind != "accel" or gyro is not None:  # that of accelerometers is for the velocities of turns
            noise[kind] = fit_coloured_noise(quiet)
        if kind == "accel":
            covariance = accel_covariance(quiet, accel)
        else:
            covariance = np.array([noise[kind].covariance_of_mean(len(s), i) for i, s in enumerate(series)])
        ends = {f.file: getattr(f, kind).ends for f in reduction.files}
        in_rests = [ends[s.file][s.first : s.last] for s in spans]
        rounded[kind] = rounding(np.concatenate([*ends.values()]), in_rests, channels)
        covariance = covariance + np.diag(FLOORS.get(kind, 0.0) ** 2 + rounded[kind].rest_u ** 2)
        if kind == "magnetometer":
            columns |= {kind: mean, f"{kind}_covariance": covariance}
        else:
            density = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2) * seconds)
            columns |= _columns_of(kind, mean, covariance, drift(series), density)
    rests = Rests(
        file=np.array([s.file for s in spans]),
        start=np.array([s.start for s in spans]),
        stop=np.array([s.stop for s in spans]),
        temperatures=None if kelvin_at_lag is None else np.array([part.mean(axis=0) for part in kelvin]),
        **columns,
    )
    rounded.pop("magnetometer", None)
    return rests, noise, rounded


def thermometers_of(reduction: Reduction) -> Thermometers:
    """Return the records of the thermometers, at the ends of the blocks."""
    return Thermometers.of({f.file: (f.edges[1:], f.temperature) for f in reduction.files if f.temperature is not None})


def accel_covariance(series: list[Array], block: Block) -> Array:
    """Return covariances (N, n, n) of the mean accelerometer readings, from the block means (K, n) within each rest.

    A slow tilt of the body appears in the horizontal directions, where it would count as sensor noise; the vertical,
    and for n > 3 the directions that no specific force explains, are free of it to first order. The noise is therefore
    estimated separately for the two kinds of directions. Channels are first divided by their noise from block to block,
    and a rough bias, which would rotate the directions, is subtracted."""
    size = np.sqrt(np.median([np.diff(s, axis=0).var(axis=0) for s in series], axis=0))
    size = np.where(size > 0.0, size, 1.0)
    mean = np.array([s.mean(axis=0) for s in series])
    force = mean @ onto_body(block.axes).T
    # the centre of the sphere through the specific forces is the bias, if they determine it
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
    """Return the change of the readings over each rest: least-squares slope times duration."""
    out = []
    for s in series:
        x = np.arange(len(s)) - 0.5 * (len(s) - 1)
        out.append(x @ s / (x @ x) * len(s))
    return np.array(out)


def sphere_through(points: Array, least: float | None = None) -> tuple[Array, float]:
    """Fit a sphere to points (N, 3), and return its centre (3,) and radius: the bias and scale of readings of a vector
    of constant length.

    |y|² = 2 y·c + r² − |c|² is solved by least squares about the mean. Directions in which the points vary by less than
    the fraction `least` of the widest have the mean as centre."""
    mean = points.mean(axis=0)
    offsets = points - mean
    square = (offsets**2).sum(axis=1)
    centre = np.linalg.lstsq(2.0 * offsets, square - square.mean(), rcond=least)[0]
    return mean + centre, float(np.sqrt(square.mean() + centre @ centre))
