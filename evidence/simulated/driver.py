"""What happens between the sensors and the file: filters of software, steps and ranges, faults, lost rows, clocks."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from evidence.simulated.device import G0, Readings
from evidence.simulated.motion import DEG, UP, Course, into_body


@dataclass(frozen=True, kw_only=True, slots=True)
class Driver:
    """What is done to the readings, in this order."""

    smoothing: float = 0.0
    """s, time constant of an exponential average of accelerometers and gyros."""
    without_gravity: bool = False
    """The accelerometers' output is the "linear acceleration" of a fusion filter."""
    normalised: bool = False
    """Accelerometers of the length of gravity always."""
    zeroed: float = 0.0
    """s of every rest whose mean a driver takes off the gyros from then on, as their bias."""
    dead_zone: float = 0.0
    """rad/s, less than which becomes nothing."""
    spikes: int = 0
    """So many single readings of accelerometers or gyros, at rest or not, are off by up to half of the range."""
    held: int = 0
    """So many samples repeat the one before."""
    step: tuple[float, float] = (0.0, 0.0)
    """The last digit of readings, m/s² and rad/s."""
    limit: tuple[float, float] = (16.0 * G0, 2000.0 * DEG)
    """Where readings end."""
    accel_factor: float = 1.0
    gyro_factor: float = 1.0
    """Of units that are not those the file is said to have."""
    mirrored: bool = False
    """The y axes of both kinds point the other way: a left-handed frame."""
    swapped_gyros: bool = False
    """The gyros' x and y channels are exchanged."""
    lost: float = 0.0
    """Share of the rows that are lost."""
    twice: float = 0.0
    """Share of the rows that come twice, with one stamp."""
    counted: bool = False
    """Stamps are row numbers times the nominal interval, whatever was lost."""
    clock_ppm: float = 0.0
    """Standard deviation of the error of the clock's rate."""
    clock_error_ppm: float = 0.0
    """An error of it that is not drawn."""
    clock_ppm_u: float | None = None
    """What is stated of the clock."""
    jitter: float = 0.0
    """s, standard deviation of the stamps of rows that are equally spaced."""


def through(driver: Driver, made: Readings, course: Course, rng: np.random.Generator) -> Readings:
    """Readings as they stand in the file."""
    t, accel, gyro = made.time, made.accel.copy(), made.gyro.copy()
    dt = t[1] - t[0]
    if driver.smoothing:
        decay = np.exp(-dt / driver.smoothing)
        accel, gyro = (lfilter([1.0 - decay], [1.0, -decay], y, axis=0, zi=decay * y[:1])[0] for y in (accel, gyro))
    if driver.without_gravity:
        attitudes = np.concatenate([course.pose(part)[0] for part in np.array_split(t, 8)])
        accel -= course.gravity * into_body(attitudes, UP)
    if driver.normalised:
        accel *= course.gravity / np.linalg.norm(accel, axis=1, keepdims=True)
    truth = dict(made.truth)
    if driver.zeroed:
        taken_off, at_rests = np.zeros_like(gyro), []
        for begin, end in course.rests:
            there, later = (t > begin) & (t <= end), t > begin + driver.zeroed
            taken_off[later] = gyro[there & ~later].mean(axis=0)
            at_rests.append(taken_off[there & (t > course.rests[0][0] + driver.zeroed)].mean(axis=0))
        gyro -= taken_off
        for axis, mean in zip("xyz", np.mean(at_rests, axis=0), strict=True):
            truth[f"gyro.bias.{axis}"] -= float(mean)
    if driver.dead_zone:
        gyro = np.where(np.abs(gyro) < driver.dead_zone, 0.0, gyro)
    for i in rng.choice(len(t), driver.spikes, replace=False) if driver.spikes else ():
        read, limit = ((accel, driver.limit[0]), (gyro, driver.limit[1]))[int(rng.integers(2))]
        read[i, rng.integers(3)] += rng.uniform(-0.5, 0.5) * limit
    for i in rng.choice(np.arange(1, len(t)), driver.held, replace=False) if driver.held else ():
        accel[i], gyro[i] = accel[i - 1], gyro[i - 1]
    for read, step, limit in zip((accel, gyro), driver.step, driver.limit, strict=True):
        if step:
            read[:] = step * np.round(read / step)
        np.clip(read, -limit, limit, out=read)
    accel, gyro = accel * driver.accel_factor, gyro * driver.gyro_factor
    if driver.mirrored:
        accel, gyro = accel * np.array([1.0, -1.0, 1.0]), gyro * np.array([1.0, -1.0, 1.0])
    if driver.swapped_gyros:
        gyro = gyro[:, [1, 0, 2]]
    ppm = driver.clock_error_ppm + driver.clock_ppm * rng.normal()
    stamps = t * (1.0 + 1e-6 * ppm) + driver.jitter * np.clip(rng.normal(size=len(t)), -3.0, 3.0)
    rows = _rows(driver, len(t), rng)
    return replace(
        made,
        time=dt * (np.arange(len(rows)) + 1.0) if driver.counted else stamps[rows],
        accel=accel[rows],
        gyro=gyro[rows],
        temperature=None if made.temperature is None else made.temperature[rows],
        mag=None if made.mag is None else made.mag[rows],
        truth=truth,
    )


def _rows(driver: Driver, count: int, rng: np.random.Generator) -> npt.NDArray[np.int64]:
    """Numbers of the rows that reach the file."""
    rows = np.arange(count)
    if driver.lost:
        kept = rng.random(count) >= driver.lost
        kept[[0, -1]] = True
        rows = rows[kept]
    if driver.twice:
        rows = np.repeat(rows, 1 + (rng.random(len(rows)) < driver.twice))
    return rows
