"""Recordings of a board that lies still while it warms or cools, by formulas of their own, and the fit that autopilots
make of them.

Every sensor reads c + s₁ d + s₂ d² + s₃ d³ + a wandering bias + white noise, d = T − the middle of the range, T the
temperature of the sensor, which follows the thermometer with a lag.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tumble.sensors.model import SensorModel
from tumble.units import Array

G = 9.80665
DEGREE_PER_HOUR = np.pi / 180.0 / 3600.0
EARTH = 7.292115e-5 * np.sin(np.radians(50.0))
"""rad/s, upwards."""
TURN_SECONDS = 3.0
WHITE = {"accel": 1.5e-3, "gyro": np.radians(0.01)}
"""Densities, SI/√Hz."""
WANDERING = {"accel": 3e-4, "gyro": 5.0 * DEGREE_PER_HOUR}
"""Standard deviations of the wandering biases, SI."""
SLOPE = {"accel": 300e-6 * G, "gyro": 80.0 * DEGREE_PER_HOUR}
"""Those of the slopes, SI/K; what curvature and cube do at 60 K from the middle is as much."""
SCALE_SLOPE = 150e-6


@dataclass(frozen=True, kw_only=True)
class Warming:
    """A recording: times (N,), readings (N, 3) by kind, the temperature (N,), °C, that the thermometer reads; and what
    is true of it: the lags, the middle of the range, °C, by kind the coefficients (3, 3) of the readings in its first
    attitude and of the biases, by sensor and power, and the slopes (3,) of the accelerometers' scale factors."""

    time: Array
    accel: Array
    gyro: Array
    celsius: Array
    lag: dict[str, float]
    middle: float
    readings: dict[str, Array]
    biases: dict[str, Array]
    scales: Array

    @property
    def arrays(self) -> dict[str, Any]:
        """Those that `tumble.calibrate` takes."""
        of = {"accel": self.accel, "gyro": self.gyro, "time": self.time}
        return of | {"temperature": self.celsius + 273.15, "serial": "warm-1", "latitude": np.radians(50.0)}

    def changes(self, kind: str, celsius: Array) -> Array:
        """By how much the readings (K, 3) at temperatures (K,) of the sensors differ from those at the middle."""
        d = celsius - self.middle
        return np.stack([d, d**2, d**3], axis=1) @ self.readings[kind].T


def warming(
    seed: int,
    *,
    span: float,
    lag: float = 0.0,
    course: str = "warming",
    seconds: float = 1800.0,
    rate: float = 25.0,
    whole_degrees: bool = False,
    creep: float = 0.0,
    turns: int = 0,
    models: dict[str, SensorModel] | None = None,
) -> Warming:
    """A recording in which the temperature goes through a span, K: by an exponential ("warming", "cooling"), or in a
    "ramp" up and down. `creep`, rad/√s, lets the board tilt slowly; it is turned so many times by a quarter of a turn;
    its sensors are those of `models` in the middle of the range, else perfect but for their biases."""
    rng = np.random.default_rng(seed)
    time = np.arange(1, int(seconds * rate) + 1) / rate
    constant = rng.uniform(0.2, 0.4) * seconds
    risen = np.expm1(-time / constant) / np.expm1(-seconds / constant)
    passed = {"warming": risen, "cooling": 1.0 - risen, "ramp": 1.0 - np.abs(2.0 * time / seconds - 1.0)}[course]
    celsius = rng.uniform(-10.0, 30.0) + span * passed
    middle = 0.5 * float(celsius.min() + celsius.max())
    read = celsius + 0.05 * rng.standard_normal(len(time))
    up, rates = _attitudes(rng, time, turns)
    scales = SCALE_SLOPE * rng.standard_normal(3)
    lags, readings, biases, every = {}, {}, {}, {}
    for kind in ("accel", "gyro"):
        lags[kind] = lag * rng.uniform(0.7, 1.3)
        d = _behind(celsius, 1.0 / rate, lags[kind]) - middle
        biases[kind] = SLOPE[kind] * rng.standard_normal((3, 3)) * np.array([1.0, 1.0 / 60.0, 1.0 / 3600.0])
        readings[kind] = biases[kind].copy()
        series = np.stack([d, d**2, d**3], axis=1) @ biases[kind].T
        if kind == "accel":
            readings[kind][:, 0] += scales * G * up[0]
            series += scales * d[:, None] * G * up
        series += _wandering(rng, len(time), 1.0 / rate, WANDERING[kind], 300.0)
        series += WHITE[kind] * np.sqrt(rate) * rng.standard_normal(series.shape)
        true = G * up if kind == "accel" else rates + EARTH * up  # its level part is left out
        bias = {"accel": 5e-2, "gyro": 1e-2}[kind] * rng.standard_normal(3)
        every[kind] = series + (true + bias if models is None else models[kind].predict(true))
    if creep:
        tilt = creep * np.cumsum(rng.standard_normal((len(time), 3)), axis=0) / np.sqrt(rate)
        every["accel"] += np.cross(G * up, tilt)
    if whole_degrees:
        read = np.round(read)
    return Warming(
        time=time, accel=every["accel"], gyro=every["gyro"], celsius=read, lag=lags, middle=middle,
        readings=readings, biases=biases, scales=scales,
    )  # fmt: skip


def _attitudes(rng: np.random.Generator, time: Array, turns: int) -> tuple[Array, Array]:
    """The vertical and the rate (N, 3), rad/s, in the body, which is turned so many times in TURN_SECONDS each."""
    up = rng.standard_normal(3)
    up /= np.linalg.norm(up)
    ups, rates = np.tile(up, (len(time), 1)), np.zeros((len(time), 3))
    for k in range(turns):
        axis = np.cross(up, rng.standard_normal(3))
        axis /= np.linalg.norm(axis)
        x = (time - time[-1] * (k + 1) / (turns + 1)) / TURN_SECONDS
        within = (x > 0.0) & (x < 1.0)
        angle = 0.5 * np.pi * np.clip(x - np.sin(2.0 * np.pi * np.clip(x, 0.0, 1.0)) / (2.0 * np.pi), 0.0, 1.0)
        rates[within] = (0.5 * np.pi / TURN_SECONDS * (1.0 - np.cos(2.0 * np.pi * x[within])))[:, None] * axis
        later = x > 0.0
        ups[later] = (np.cos(angle)[:, None] * up - np.sin(angle)[:, None] * np.cross(axis, up))[later]
        up = ups[-1]
    return ups, rates


def _behind(celsius: Array, step: float, lag: float) -> Array:
    """What follows with a time constant, in steps in which the temperature is straight."""
    if lag == 0.0:
        return celsius
    from scipy.signal import lfilter

    a, h = np.exp(-step / lag), lag / step * -np.expm1(-step / lag)
    driven = np.append(0.0, (1.0 - h) * (celsius[1:] - celsius[0]) + (h - a) * (celsius[:-1] - celsius[0]))
    return np.asarray(celsius[0] + lfilter([1.0], [1.0, -a], driven))


def _wandering(rng: np.random.Generator, count: int, step: float, size: float, constant: float) -> Array:
    """Gauss–Markov processes (count, 3)."""
    from scipy.signal import lfilter

    a = np.exp(-step / constant)
    driven = size * np.sqrt(-np.expm1(-2.0 * step / constant)) * rng.standard_normal((count, 3))
    driven[0] = size * rng.standard_normal(3)
    return np.asarray(lfilter([1.0], [1.0, -a], driven, axis=0))


def cubic_fit(celsius: Array, readings: Array, step: float = 1.0) -> Array:
    """Coefficients (4, 3) of the cubic, highest power first, by plain least squares of the readings over the
    thermometer, as ArduPilot (AccumulateThermal) and PX4 (process_sensor_caldata.py) fit it: PX4 takes the means of
    equal steps of temperature."""
    number = np.floor(celsius / step).astype(int)
    number -= number.min()
    count = np.bincount(number)
    seen = count > 0
    means = [np.bincount(number, column)[seen] / count[seen] for column in (celsius, *readings.T)]
    return np.polyfit(means[0] - celsius.mean(), np.stack(means[1:], axis=1), min(3, len(means[0]) - 1))


def known_u(recorded: Warming, kind: str, parts: int = 40) -> Array:
    """Standard deviations (2,) of the changes of a reading from the middle of the range to both ends by generalised
    least squares over the means of parts, with the sizes that slopes, noise and wandering biases really have; for a
    recording without lag."""
    T, constant = recorded.time[-1] / parts, 300.0
    of = np.linspace(0, len(recorded.time), parts + 1).astype(int)[:-1]
    d = recorded.celsius - recorded.middle
    columns = np.stack([np.add.reduceat(d**k, of) / np.diff(np.append(of, len(d))) for k in range(4)], axis=1)
    sizes = SLOPE[kind] * np.array([1e3, 1.0, 1.0 / 60.0, 1.0 / 3600.0])
    apart, x = np.abs(np.subtract.outer(np.arange(parts), np.arange(parts))) * T, T / constant
    V = np.exp(-apart / constant) * 2.0 * (np.cosh(x) - 1.0) / x**2
    np.fill_diagonal(V, 2.0 * (x + np.expm1(-x)) / x**2)
    V = WANDERING[kind] ** 2 * V + WHITE[kind] ** 2 / T * np.eye(parts)
    covariance = np.linalg.inv(columns.T @ np.linalg.solve(V, columns) + np.diag(sizes**-2.0))
    half = 0.5 * float(np.ptp(recorded.celsius))
    ends = np.array([[0.0, x, x**2, x**3] for x in (-half, half)])
    return np.sqrt(np.diag(ends @ covariance @ ends.T))
