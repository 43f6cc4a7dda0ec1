"""Sensors drawn at random: what they read of a rate and a force, what their biases do in time, and their noise.

    y = diag(1 + k) A(γ) f + b + K₂ f² + K₃ f³ + κ |f| + X f f + m (f * e^(−t/τ))/τ             accelerometers
    y = diag(1 + k) A(γ) ω + b + G f + κ |ω| + c ω³                                             gyros

with f at each accelerometer's own place and time, and the axes matrix A of unit rows that lean by γ towards the others.
What is above the 21 of the linear model is drawn anew of every device, in the sizes that are usual of its grade.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, lfilter, lfilter_zi

from evidence.simulated.motion import DEG, UP, Array, Course, into_body

G0 = 9.80665
HOUR = DEG / 3600.0  # 1 °/h
ACCEL_AXES = ("yx", "zx", "zy")
GYRO_AXES = ("xy", "xz", "yx", "yz", "zx", "zy")
NODES, SHARES = np.array([-np.sqrt(0.15), 0.0, np.sqrt(0.15)]), np.array([5.0, 8.0, 5.0]) / 18.0
"""Gauss's rule of three nodes for the mean over an interval, in intervals from its middle."""
SCALE_PER_KELVIN = 100e-6
"""1/K, standard deviation of the change of an accelerometer's scale factor."""
FINE = 8
"""Samples an interval where a sensor's own filter is simulated."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Grade:
    """Standard deviations over devices, densities of white noise (m/s²/√Hz, rad/s/√Hz) and sizes of in-run biases. The
    terms beyond the linear model of MEMS have the sizes that were found in real chips (studies/chip_priors.py)."""

    accel: tuple[float, float, float]  # bias, scale factor, axes
    gyro: tuple[float, float, float]
    white: tuple[float, float]
    quadratic: float  # m/s² at 1 g, each of the three
    cubic: float
    asymmetry: tuple[float, float]
    g_sensitivity: float  # rad/s at 1 g
    lever: float  # m
    delay: float  # s, between the kinds
    single_delay: float  # s, between accelerometers
    per_kelvin: tuple[float, float]
    in_run: tuple[float, float]


GRADES = {
    "navigation": Grade(
        accel=(2e-3, 1e-4, 1e-4), gyro=(0.1 * HOUR, 1e-4, 5e-5), white=(1e-4, 0.003 * DEG / 60.0),
        quadratic=30e-6 * G0, cubic=10e-6 * G0, asymmetry=(20e-6, 10e-6), g_sensitivity=0.05 * HOUR, lever=0.03,
        delay=1e-3, single_delay=20e-6, per_kelvin=(20e-6 * G0, 0.01 * HOUR), in_run=(5e-6, 0.002 * HOUR),
    ),
    "tactical": Grade(
        accel=(2e-2, 5e-4, 5e-4), gyro=(5.0 * HOUR, 5e-4, 5e-4), white=(3e-4, 0.1 * DEG / 60.0),
        quadratic=50e-6 * G0, cubic=30e-6 * G0, asymmetry=(50e-6, 100e-6), g_sensitivity=5.0 * HOUR, lever=0.03,
        delay=3e-3, single_delay=100e-6, per_kelvin=(50e-6 * G0, 1.0 * HOUR), in_run=(5e-5, 0.2 * HOUR),
    ),
    "mems": Grade(
        accel=(5e-2, 6e-3, 4e-3), gyro=(1e-2, 6e-3, 4e-3), white=(1.5e-3, 0.01 * DEG),
        quadratic=50e-6 * G0, cubic=100e-6 * G0, asymmetry=(50e-6, 100e-6), g_sensitivity=30.0 * HOUR, lever=0.005,
        delay=5e-3, single_delay=300e-6, per_kelvin=(300e-6 * G0, 80.0 * HOUR), in_run=(3e-4, 5.0 * HOUR),
    ),
    "consumer": Grade(
        accel=(0.3, 1.5e-2, 1e-2), gyro=(2e-2, 2e-2, 1e-2), white=(3e-3, 0.03 * DEG),
        quadratic=50e-6 * G0, cubic=100e-6 * G0, asymmetry=(50e-6, 100e-6), g_sensitivity=30.0 * HOUR, lever=0.01,
        delay=5e-3, single_delay=500e-6, per_kelvin=(1e-3 * G0, 200.0 * HOUR), in_run=(1e-3, 20.0 * HOUR),
    ),
}  # fmt: skip


@dataclass(frozen=True, kw_only=True, slots=True)
class Process:
    """What the biases do within a session: none, white (anew at every rest), markov, walk, flicker or exponential (a
    warm-up nobody measures); its standard deviation in those usual of the grade, and its memory, s."""

    form: str = "none"
    size: float = 1.0
    memory: float = 100.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Sweep:
    """How a device that lies still changes its temperature: by how much, K, and by how much later than the thermometer
    its sensors do, s, each drawn evenly between two bounds; whether it warms, cools or does both; whether the
    thermometer shows whole degrees."""

    span: tuple[float, float] = (5.0, 60.0)
    lag: tuple[float, float] = (0.0, 200.0)
    way: Literal["warming", "cooling", "both"] = "warming"
    whole: bool = False


@dataclass(frozen=True, kw_only=True, slots=True)
class Magnetometer:
    """m = S Lᵀ h + b in the field h, µT, at the middle of a sample: standard deviations of the hard iron b, µT, and of
    the elements of S − 1, the soft iron; noise of a sample, µT, and by how much it is late, s, drawn about nothing."""

    hard: float = 20.0
    soft: float = 0.02
    noise: float = 0.5
    late: float = 2e-3


@dataclass(frozen=True, kw_only=True, slots=True)
class Sensors:
    """Which device, and what of it is unusual."""

    grade: str = "mems"
    rate: float = 100.0
    beyond: float = 1.0
    """How many times its usual size everything above the 21 is."""
    in_run: Process = Process()
    warming: tuple[float, float, float] = (0.0, 300.0, 0.0)
    """K from beginning to end, time constant, s, and s by which the sensors lag behind the thermometer."""
    thermometer: bool = True
    """Whether one that is there, where it warms, is in the log."""
    cutoff: float = 0.0
    """Hz of a Butterworth low-pass of second order before both kinds are sampled; 0 is none."""
    instantaneous: bool = False
    """A sample is the reading at its time, not the mean since the one before."""
    accel_delay: float | None = None
    """s by which all accelerometers are late, in place of a drawn one."""
    scatter_of_one: float = 0.0
    """m/s², steps of the x accelerometer from rest to rest."""
    jump: float = 0.0
    """rad/s by which the biases of the gyros jump half way."""
    gyro_cubic: float = 0.0
    """Relative error of the gyros' scale factors at 100 °/s, which goes with the square of the rate."""
    cross: float = 0.0
    """m/s² at 1 g, of every product of two forces in every accelerometer."""
    remembers: tuple[float, float] = (0.0, 60.0)
    """Share of its force that an accelerometer reads again late, and its time constant, s."""
    sweep: Sweep | None = None
    magnetometer: Magnetometer | None = None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Readings:
    """Of all samples: times (N,), accelerometers and gyros (N, 3), what the thermometer shows (N,), and the true 21;
    of a sweep the temperatures at which changes are true, °C; the magnetometer (N, 3) and the field, µT."""

    time: Array
    accel: Array
    gyro: Array
    temperature: Array | None
    truth: dict[str, float]
    ends: tuple[float, float, float] | None = None
    mag: Array | None = None
    mag_field: float | None = None


def axes_matrix(angles: dict[str, float]) -> Array:
    """A(γ): row p is a unit vector that leans by γ_pq towards q, towards the first of the two others exactly."""
    c, s = ({pair: f(angles.get(pair, 0.0)) for pair in GYRO_AXES} for f in (np.cos, np.sin))
    return np.array([
        [c["xy"] * c["xz"], s["xy"], c["xy"] * s["xz"]],
        [c["yz"] * s["yx"], c["yz"] * c["yx"], s["yz"]],
        [s["zx"], c["zx"] * s["zy"], c["zx"] * c["zy"]],
    ])  # fmt: skip


def readings(sensors: Sensors, course: Course, device: np.random.Generator, noise: np.random.Generator) -> Readings:
    """What a device, drawn anew, reads on a course."""
    grade, many = GRADES[sensors.grade], sensors.beyond
    truth: dict[str, float] = {}
    matrix: dict[str, Array] = {}
    for kind, spread, pairs in (("accel", grade.accel, ACCEL_AXES), ("gyro", grade.gyro, GYRO_AXES)):
        bias, scale, angles = (size * device.normal(size=n) for size, n in zip(spread, (3, 3, len(pairs)), strict=True))
        truth |= {f"{kind}.bias.{axis}": float(b) for axis, b in zip("xyz", bias, strict=True)}
        truth |= {f"{kind}.scale.{axis}": float(k) for axis, k in zip("xyz", scale, strict=True)}
        truth |= {f"{kind}.axis.{pair}": float(angle) for pair, angle in zip(pairs, angles, strict=True)}
        matrix[kind] = np.diag(1.0 + scale) @ axes_matrix(dict(zip(pairs, angles, strict=True)))
    quadratic, cubic = many * grade.quadratic * device.normal(size=3), many * grade.cubic * device.normal(size=3)
    uneven = [many * size * device.normal(size=3) for size in grade.asymmetry]
    sensitive = many * grade.g_sensitivity / G0 * device.normal(size=(3, 3))
    levers = many * grade.lever * device.normal(size=(3, 3))
    levers[2] = 0.0
    late = many * grade.delay * device.normal() if sensors.accel_delay is None else sensors.accel_delay
    delays = late + many * grade.single_delay * np.array([*device.normal(size=2), 0.0])
    slopes = [many * size * device.normal(size=3) for size in grade.per_kelvin]
    products = sensors.cross * device.choice([-1.0, 1.0], (3, 3))

    dt = 1.0 / sensors.rate
    t: Array = dt * np.arange(1.0, int(course.duration * sensors.rate) + 1.0)
    filtered = sensors.cutoff > 0.0
    if filtered:
        fine: Array = dt * (np.arange(FINE * len(t)) + 0.5) / FINE
        all_times, shares = [fine], np.ones(1)
    elif sensors.instantaneous:
        all_times, shares = [t], np.ones(1)
    else:
        all_times, shares = [t - 0.5 * dt + node * dt for node in NODES], SHARES
    accel, gyro = np.zeros((len(all_times[0]), 3)), np.zeros((len(all_times[0]), 3))
    for times, share in zip(all_times, shares, strict=True):
        rate, at_origin = course.felt(times, np.zeros((1, 3)))
        a, g = np.empty_like(rate), rate @ matrix["gyro"].T + at_origin[:, 0] @ sensitive.T
        for p in range(3):
            force = course.felt(times - delays[p], levers[p : p + 1])[1][:, 0]
            own = force[:, p]
            a[:, p] = force @ matrix["accel"][p] + uneven[0][p] * np.abs(own)
            a[:, p] += quadratic[p] * (own / G0) ** 2 + cubic[p] * (own / G0) ** 3
            if sensors.cross:
                a[:, p] += (products[p] * force * np.roll(force, 1, axis=1)).sum(axis=1) / G0**2
        g += uneven[1] * np.abs(rate) + sensors.gyro_cubic * rate**3 / (100.0 * DEG) ** 2
        accel, gyro = accel + share * a, gyro + share * g
    if sensors.remembers[0]:
        part, memory = sensors.remembers
        decay = float(np.exp(-(all_times[0][1] - all_times[0][0]) / memory))
        accel = accel + part * lfilter([1.0 - decay], [1.0, -decay], accel, axis=0, zi=decay * accel[:1])[0]
    many_a_second = sensors.rate * (FINE if filtered else 1)
    accel = accel + grade.white[0] * np.sqrt(many_a_second) * noise.normal(size=accel.shape)
    gyro = gyro + grade.white[1] * np.sqrt(many_a_second) * noise.normal(size=gyro.shape)
    if filtered:
        b, a_ = butter(2, sensors.cutoff, fs=FINE * sensors.rate)
        start = lfilter_zi(b, a_)[:, None]
        accel, gyro = (
            lfilter(b, a_, y, axis=0, zi=start * y[:200].mean(axis=0))[0].reshape(len(t), FINE, 3).mean(axis=1)
            for y in (accel, gyro)
        )
    drifts, shown = _drifts(sensors, grade, slopes, t, course, noise)
    for kind, read, drift in (("accel", accel, drifts[0]), ("gyro", gyro, drifts[1])):
        bias = np.array([truth[f"{kind}.bias.{axis}"] for axis in "xyz"])
        read += bias + drift
        if shown is None or not sensors.thermometer:  # what a session can know is the bias it had over its rests
            means = [drift[(t > begin) & (t <= end)].mean(axis=0) for begin, end in course.rests]
            for axis, mean in zip("xyz", bias + np.mean(means, axis=0), strict=True):
                truth[f"{kind}.bias.{axis}"] = float(mean)
    made = Readings(time=t, accel=accel, gyro=gyro, temperature=shown if sensors.thermometer else None, truth=truth)
    if sensors.sweep is not None:
        made = swept(sensors.sweep, grade, made, course, noise)
    return made if sensors.magnetometer is None else magnetic(sensors.magnetometer, made, course, device, noise)


def swept(sweep: Sweep, grade: Grade, made: Readings, course: Course, rng: np.random.Generator) -> Readings:
    """Readings at rest that change with the temperature T of the sensors, about the middle of the range,

        b(T) = s₁ d + s₂ d² + s₃ d³ (+ k₁ d f, of accelerometers),      λ dT/dt = T of the thermometer − T

    with true changes from the middle to a tenth of the range from either end: `change`, of the readings, and `thermal`,
    of the biases alone."""
    t, dt = made.time, made.time[1] - made.time[0]
    span, long = rng.uniform(*sweep.span), float(t[-1])
    constant = rng.uniform(0.2, 0.4) * long * (0.5 if sweep.way == "both" else 1.0)
    half = 0.5 * long if sweep.way == "both" else long
    risen = np.expm1(-np.minimum(t, half) / constant) / np.expm1(-half / constant)
    if sweep.way == "both":
        risen *= np.exp(-np.maximum(t - half, 0.0) / constant)
    outside = rng.uniform(-10.0, 30.0) + span * (1.0 - risen if sweep.way == "cooling" else risen)
    low, middle, high = float(outside.min()), 0.5 * float(outside.min() + outside.max()), float(outside.max())
    ends = middle + 0.8 * (low - middle), middle, middle + 0.8 * (high - middle)
    powers, truth = np.arange(1, 4)[:, None], dict(made.truth)
    force = course.gravity * into_body(course.attitudes[:1], UP)[0]
    lag = rng.uniform(*sweep.lag)
    changed: dict[str, Array] = {}
    for kind, size in zip(("accel", "gyro"), grade.per_kelvin, strict=True):
        slopes = size * rng.normal(size=(3, 3)) * np.array([1.0, 1.0 / 60.0, 1.0 / 3600.0])
        scale = SCALE_PER_KELVIN * rng.normal(size=3) * force if kind == "accel" else np.zeros(3)
        decay = float(np.exp(-dt / (max(lag, 1e-6) * rng.uniform(0.7, 1.3))))
        inside = outside[0] + lfilter([1.0 - decay], [1.0, -decay], outside - outside[0])
        for name, coefficients in (("thermal", slopes), ("change", slopes + np.outer(scale, [1.0, 0.0, 0.0]))):
            for end, at in zip(("low", "high"), (ends[0], ends[2]), strict=True):
                values = coefficients @ (at - middle) ** np.arange(1.0, 4.0)
                truth |= {f"{kind}.{name}.{axis}.{end}": float(v) for axis, v in zip("xyz", values, strict=True)}
        changed[kind] = ((slopes + np.outer(scale, [1.0, 0.0, 0.0])) @ (inside - middle) ** powers).T
    shown = outside + 0.05 * rng.normal(size=len(t))
    return replace(
        made, accel=made.accel + changed["accel"], gyro=made.gyro + changed["gyro"], ends=ends, truth=truth,
        temperature=np.round(shown) if sweep.whole else shown,
    )  # fmt: skip


def magnetic(
    magnetometer: Magnetometer, made: Readings, course: Course, device: np.random.Generator, noise: np.random.Generator
) -> Readings:
    """The same with a magnetometer in the field of a dipole: of 30 µT at the equator, turned by a declination."""
    sensitivity = np.eye(3) + magnetometer.soft * device.normal(size=(3, 3))
    bias, late = magnetometer.hard * device.normal(size=3), magnetometer.late * device.normal()
    declination = 10.0 * DEG * noise.normal()
    level, down = 30.0 * np.cos(course.latitude), 60.0 * np.sin(course.latitude)
    field = np.array([level * np.cos(declination), -down, level * np.sin(declination)])
    at = made.time - 0.5 * (made.time[1] - made.time[0]) - late  # the middle of a sample
    seen = np.concatenate([into_body(course.pose(part)[0], field) for part in np.array_split(at, 8)])
    mag = seen @ sensitivity.T + bias + magnetometer.noise * noise.normal(size=seen.shape)
    length = np.linalg.norm(sensitivity, axis=1)
    angles = angles_of_rows(sensitivity / length[:, None])
    truth = made.truth | {f"mag.bias.{axis}": float(b) for axis, b in zip("xyz", bias, strict=True)}
    truth |= {f"mag.scale.{axis}": float(k) for axis, k in zip("xyz", length - 1.0, strict=True)}
    truth |= {f"mag.axis.{pair}": angle for pair, angle in angles.items()}
    return replace(made, mag=mag, mag_field=float(np.linalg.norm(field)), truth=truth)


def angles_of_rows(rows: Array) -> dict[str, float]:
    """γ by pair of axes of rows (3, 3) of unit length: the inverse of `axes_matrix`."""
    x, y, z = rows
    return {
        "xy": float(np.arcsin(x[1])), "xz": float(np.arctan2(x[2], x[0])),
        "yx": float(np.arctan2(y[0], y[1])), "yz": float(np.arcsin(y[2])),
        "zx": float(np.arcsin(z[0])), "zy": float(np.arctan2(z[1], z[2])),
    }  # fmt: skip


def _drifts(
    sensors: Sensors, grade: Grade, slopes: list[Array], t: Array, course: Course, rng: np.random.Generator
) -> tuple[list[Array], Array | None]:
    """What the biases of both kinds (N, 3) do beside their constants, and what a thermometer shows (N,), °C."""
    turn_before = np.searchsorted(course.begin, t, side="right")  # a bias anew at a rest is so from the turn before
    drifts = [_process(sensors.in_run, size, t, turn_before, rng) for size in grade.in_run]
    if sensors.scatter_of_one:
        drifts[0][:, 0] += sensors.scatter_of_one * rng.normal(size=len(course.rests))[turn_before]
    if sensors.jump:
        sign = rng.choice([-1.0, 1.0], 3)
        drifts[1] += np.where(t > 0.5 * course.duration, 1.0, 0.0)[:, None] * sensors.jump * sign
    warm, settle, lag = sensors.warming
    if not warm:
        return drifts, None
    shown = 22.0 + warm * (1.0 - np.exp(-t / settle))
    inside = shown
    if lag:  # dT/dt = (shown − T)/lag from 22 °C
        slow = lag if abs(settle - lag) > 1e-6 else 1.001 * lag
        inside = 22.0 + warm * (1.0 - (settle * np.exp(-t / settle) - slow * np.exp(-t / slow)) / (settle - slow))
    at_rests = [shown[(t > begin) & (t < end)].mean() for begin, end in course.rests]
    for drift, slope in zip(drifts, slopes, strict=True):
        drift += (inside - np.mean(at_rests))[:, None] * slope
    return drifts, shown + 0.01 * rng.normal(size=len(t))


def _process(process: Process, usual: float, t: Array, rest: NDArray[np.intp], rng: np.random.Generator) -> Array:
    """What a bias does (N, 3); `rest` (N,) is the number of the rest that a sample belongs to."""
    sigma, dt, shape = process.size * usual, t[1] - t[0], (len(t), 3)

    def markov(memory: float) -> Array:
        a = np.exp(-dt / memory)
        begin = rng.normal(size=(1, 3)) * a
        out: Array = lfilter([np.sqrt(1.0 - a * a)], [1.0, -a], rng.normal(size=shape), axis=0, zi=begin)[0]
        return out

    match process.form:
        case "none":
            return np.zeros(shape)
        case "white":
            return np.asarray(sigma * rng.normal(size=(int(rest.max()) + 1, 3))[rest])
        case "markov":
            return sigma * markov(process.memory)
        case "walk":  # of this standard deviation at the end
            return np.asarray(sigma * np.cumsum(rng.normal(size=shape), axis=0) / np.sqrt(len(t)))
        case "flicker":  # equal Gauss–Markov processes, an octave apart
            return np.asarray(sigma * sum(markov(2.0**octave) for octave in range(10)) / np.sqrt(10.0))
        case "exponential":
            return np.asarray(sigma * rng.normal(size=3) * np.exp(-t / process.memory)[:, None])
    raise ValueError(process.form)
