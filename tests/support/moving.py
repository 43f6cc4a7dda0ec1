"""Recordings of a device that never lies still, by motion that shares nothing with the estimate.

The body turns about an axis that wanders smoothly; where it is follows from what holds it: a pivot (a tripod head, a
ball joint) from which it hangs by a lever and which itself trembles, or a hand that sways about a place by a few
harmonics. Navigation frame north, up, east; readings are means over the samples, from steps ten times as fine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from tumble.units import Array

G = 9.81
EARTH_RATE = 7.292115e-5
STEPS = 10
"""Steps a sample."""
UP = np.array([0.0, 1.0, 0.0])
STEP_ASIDE = np.array([0.1, 0.0, -0.1])
"""Way from one place at which `lay` puts a device down to the next, m."""


@dataclass(frozen=True, kw_only=True)
class Noise:
    """Densities m/s²/√Hz and rad/s/√Hz, and in-run biases, m/s² and rad/s, of a correlation time, s."""

    accel: float = 1.5e-3
    gyro: float = np.radians(0.01)
    accel_in_run: float = 3e-4
    gyro_in_run: float = np.radians(5.0) / 3600.0
    time: float = 300.0


@dataclass(frozen=True, kw_only=True)
class Motion:
    """How a device is moved: for `seconds` at about a `rate`, rad/s, about axes that last for `axis_time` s; on a
    `lever`, m, from a pivot that sways, or in a hand that does, by `sway` m (root mean square of the distance) of
    harmonics about `frequency` Hz; `rests` of 3 s are spread over it, in which it lies still, or, held in the hand,
    trembles by `tremor` rad/s and sways by `held` m of harmonics five times as fast (root mean squares). `follows` m is
    the vertical displacement proportional to (up · x)², by which a stand sags, `bends` m that of an arm along x, whose
    end gives way to the weight across it; `drift` m/s a uniform motion; `regrip` m
    a step of the place in the middle, over a second."""

    seconds: float = 120.0
    rate: float = np.radians(60.0)
    axis_time: float = 4.0
    lever: Sequence[float] = (0.10, 0.05, -0.03)
    sway: float = 1e-3
    frequency: float = 1.0
    rests: int = 0
    tremor: float = 0.0
    held: float = 0.0
    follows: float = 0.0
    bends: float = 0.0
    drift: Sequence[float] = (0.0, 0.0, 0.0)
    regrip: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Readings (S, 3), m/s² and rad/s, their rate, Hz, the true sensitivities and biases, and the gravity."""

    accel: Array
    gyro: Array
    rate: float
    accel_matrix: Array
    accel_bias: Array
    gyro_matrix: Array
    gyro_bias: Array
    attitudes: Array
    gravity: float = G
    truth: dict[str, float] = field(default_factory=dict)


def record(
    motion: Motion, seed: int, *, rate: float = 200.0, noise: Noise = Noise(), errors: float = 1.0,
    further: float = 0.0, latitude: float | None = None,
) -> Recording:  # fmt: skip
    """A recording of an instrument with errors drawn at random: biases 0.05 m/s² and 0.6 °/s, scale factors 0.6 %, axes
    4 mrad, times `errors`; accelerometer axes are a lower triangle, so that the first is the body's. Times `further`,
    what else the data sheets of such chips state: 50 µg/g², 100 µg/g³, 50 and 100 ppm of asymmetry, 30 °/h/g, 5 mm
    between accelerometers, and their delays of 5 ms in common and of 0.3 ms each. At a `latitude` the Earth turns."""
    rng = np.random.default_rng(seed)
    n = int(motion.seconds * rate)
    h = 1.0 / (rate * STEPS)
    t = np.asarray((np.arange(n * STEPS) + 0.5) * h)  # the middles of the steps
    knots = int(motion.seconds / motion.axis_time) + 4
    axis = CubicSpline(np.arange(knots) * motion.axis_time, rng.normal(size=(knots, 3)))(t + motion.axis_time)
    omega = motion.rate * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    still = np.ones_like(t)
    for k in range(motion.rests):
        centre = (k + 0.5) * motion.seconds / motion.rests
        still *= _smooth(np.asarray((np.abs(t - centre) - 1.5) / 0.5))
    omega = omega * still[:, None]
    trembling = np.zeros((len(t), 3))
    if motion.tremor or motion.held:  # a place beside that of the turns, since draws are others without
        hand, other = replace(motion, frequency=5.0 * motion.frequency), np.random.default_rng((seed, 1))
        omega += (1.0 - still[:, None]) * _sway(replace(hand, sway=motion.tremor), t, other)
        trembling = (1.0 - still[:, None]) * _sway(replace(hand, sway=motion.held), t, other)
    C = _attitudes(omega, h, Rotation.random(random_state=seed).as_matrix())
    position = C @ np.array(motion.lever) + _sway(motion, t, rng) * still[:, None] + trembling
    position += np.outer(t, motion.drift)
    up_x = C[:, 1, 0]
    position += motion.follows * (up_x**2)[:, None] * UP
    position -= motion.bends * (UP - C[:, :, 0] * up_x[:, None])
    position += motion.regrip * _smooth(t - 0.5 * motion.seconds)[:, None] * np.array([0.6, 0.0, 0.8])
    return _read(omega, position, C, (rng, np.random.default_rng((seed, 2))), rate, noise, errors, further, latitude)


def lay(
    ups: Array, seed: int, *, tilt: float = np.radians(1.0), lift: float = 0.15,
    rest: tuple[float, float] = (6.0, 12.0), move: tuple[float, float] = (2.5, 6.0), further: float = 1.0,
) -> Recording:  # fmt: skip
    """A recording of an instrument that is laid by hand from one face to the next, up along `ups` (R, 3) in the body
    but for `tilt` rad, in any heading. It rests for `rest` s; in between, within `move` s, it is lifted by about `lift`
    m, turned by an unsteady hand, and put down a decimetre away."""
    rng, rate = np.random.default_rng((seed, 3)), 200.0
    h = 1.0 / (rate * STEPS)
    attitudes, places, at, where = [], [], Rotation.identity(), np.zeros(3)
    for k, up in enumerate(ups):
        level = Rotation.align_vectors([UP], [up])[0]
        tilted = Rotation.from_rotvec(tilt * rng.normal(size=3) * [1.0, 0.0, 1.0]) * level
        then, there = Rotation.from_rotvec(rng.uniform(-np.pi, np.pi) * UP) * tilted, where + STEP_ASIDE
        if k:
            x = np.linspace(0.0, 1.0, STEPS * int(rng.uniform(*move) * rate))
            unsteady = 0.12 * rng.normal(size=3) * np.sin(np.pi * rng.integers(1, 4, 3) * x[:, None]) ** 2
            turned = Rotation.from_rotvec(_smooth(x)[:, None] * (at.inv() * then).as_rotvec())
            attitudes.append(at * turned * Rotation.from_rotvec(unsteady))
            up_and_down = lift * rng.uniform(0.7, 1.3) * _smooth(2.0 * np.minimum(x, 1.0 - x))
            places.append(where + _smooth(x)[:, None] * (there - where) + up_and_down[:, None] * UP)
        n = STEPS * int(rng.uniform(*rest) * rate)
        attitudes.append(Rotation.from_quat(np.tile(then.as_quat(), (n, 1))))
        places.append(np.tile(there, (n, 1)))
        at, where = then, there
    path, position = Rotation.concatenate(attitudes), np.concatenate(places)
    n = (len(position) - 1) // STEPS * STEPS
    omega = (path[:n].inv() * path[1 : n + 1]).as_rotvec() / h
    C = (path[:n] * Rotation.from_rotvec(0.5 * h * omega)).as_matrix()
    middle = 0.5 * (position[:n] + position[1 : n + 1])
    return _read(omega, middle, C, (rng, np.random.default_rng((seed, 4))), rate, Noise(), 1.0, further, None)


def _read(
    omega: Array, position: Array, C: Array, draws: tuple[np.random.Generator, np.random.Generator], rate: float,
    noise: Noise, errors: float, further: float, latitude: float | None,
) -> Recording:  # fmt: skip
    """Readings of an instrument on a path of steps: rates (S, 3) in the body, positions (S, 3), attitudes (S, 3, 3)."""
    rng, own = draws
    h, n = 1.0 / (rate * STEPS), len(omega) // STEPS
    t = np.asarray((np.arange(len(omega)) + 0.5) * h)
    places = own.normal(0, 5e-3 * further, (3, 3)) * [[1.0], [1.0], [0.0]]
    delays = 5e-3 * further * own.normal() + own.normal(0, 3e-4 * further, 3) * [1.0, 1.0, 0.0]

    def averaged(each: Array) -> Array:
        return np.asarray(each.reshape(n, STEPS, 3).mean(axis=1))

    def sensed(place: Array, delay: float) -> Array:
        """Specific force (S, 3) at a place in the body, as it is read so late."""
        acceleration = np.gradient(np.gradient(position + C @ place, h, axis=0), h, axis=0)
        force = np.einsum("kji,kj->ki", C, acceleration + G * UP)
        late = force if delay == 0.0 else CubicSpline(t, force)(np.clip(t - delay, t[0], t[-1]))
        return averaged(late)

    forces = np.stack([sensed(place, delay) for place, delay in zip(places, delays.tolist(), strict=True)], axis=1)
    if latitude is not None:
        omega = omega + EARTH_RATE * np.array([np.cos(latitude), np.sin(latitude), 0.0]) @ C
    force, omega = sensed(np.zeros(3), 0.0), averaged(omega)
    scale, axes, bias = 6e-3 * errors, 4e-3 * errors, (0.05 * errors, np.radians(0.6) * errors)
    accel_matrix = np.eye(3) + np.diag(rng.normal(0, scale, 3)) + np.tril(rng.normal(0, axes, (3, 3)), -1)
    off = rng.normal(0, axes, (3, 3))
    gyro_matrix = np.eye(3) + np.diag(rng.normal(0, scale, 3)) + off - np.diag(np.diag(off))
    accel_bias, gyro_bias = rng.normal(0, bias[0], 3), rng.normal(0, bias[1], 3)
    quadratic, cubic, both_signs = (own.normal(0, further * size, 3) for size in (5e-5 / G, 1e-4 / G**2, 5e-5))
    of_gyros, by_force = (
        own.normal(0, 1e-4 * further, 3),
        own.normal(0, np.radians(30.0 / 3600.0) / G * further, (3, 3)),
    )
    along = np.einsum("kpp->kp", forces)
    read = np.einsum("kpj,pj->kp", forces, accel_matrix)
    read += quadratic * along**2 + cubic * along**3 + both_signs * np.abs(along)
    turned = omega @ gyro_matrix.T + of_gyros * np.abs(omega) + force @ by_force.T
    out = []
    for x, b, density, in_run in (
        (read, accel_bias, noise.accel, noise.accel_in_run), (turned, gyro_bias, noise.gyro, noise.gyro_in_run),
    ):  # fmt: skip
        wander = _gauss_markov(n, in_run, noise.time * rate, rng)
        out.append(x + b + wander + rng.normal(0, density * np.sqrt(rate), (n, 3)))
    return Recording(
        accel=out[0], gyro=out[1], rate=rate, accel_matrix=accel_matrix, accel_bias=accel_bias,
        gyro_matrix=gyro_matrix, gyro_bias=gyro_bias, attitudes=C[::STEPS],
    )  # fmt: skip


def _smooth(x: Array) -> Array:
    """0 below 0, 1 above 1, smooth between to the second derivative."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x**3 * (10.0 - 15.0 * x + 6.0 * x**2))


def _attitudes(omega: Array, h: float, first: Array) -> Array:
    """Attitudes (S, 3, 3) in the middle of each step of constant rates."""
    steps = Rotation.from_rotvec(omega * h).as_quat()
    out, (a, b, c, d) = np.empty((len(omega), 4)), Rotation.from_matrix(first).as_quat().tolist()
    for k, (x, y, z, w) in enumerate(steps.tolist()):
        a, b, c, d = (d * x + a * w + b * z - c * y, d * y - a * z + b * w + c * x, d * z + a * y - b * x + c * w,
             d * w - a * x - b * y - c * z)  # fmt: skip
        out[k] = a, b, c, d
    half = Rotation.from_rotvec(-0.5 * omega * h)
    return np.asarray((Rotation.from_quat(out) * half).as_matrix())


def _sway(motion: Motion, t: Array, rng: np.random.Generator) -> Array:
    """Positions (S, 3) of six harmonics."""
    out = np.zeros((len(t), 3))
    for _ in range(6):
        frequency, phase = motion.frequency * rng.uniform(0.4, 1.6), rng.uniform(0.0, 2.0 * np.pi, 3)
        amplitude = rng.normal(size=3) * motion.sway * np.sqrt(2.0 / 18.0)
        out += amplitude * np.sin(2.0 * np.pi * frequency * t[:, None] + phase)
    return out


def _gauss_markov(n: int, size: float, time: float, rng: np.random.Generator) -> Array:
    """A stationary Gauss–Markov process (n, 3)."""
    rho = np.exp(-1.0 / time)
    from scipy.signal import lfilter

    steps = rng.normal(0, size * np.sqrt(1.0 - rho**2), (n, 3))
    steps[0] = rng.normal(0, size, 3)
    return np.asarray(lfilter([1.0], [1.0, -rho], steps, axis=0))
