"""Simulated recordings for evidence, by physics of their own: nothing of tumble is imported here.

A device is carried through rests and turns. Its attitude is an analytic function of time, L(t) = L₀ exp([a θ(t)]×)
with a smooth θ, its place another; rate and specific force at every sensor, lever arms and delays included, follow
from their derivatives, and a sample is the mean over its interval by Gauss's rule with three nodes. Then come the
sensors, what their biases do in time, the temperature, the driver and the clock.

Frames: n has the axes north, up, east; the body frame b is that of the accelerometers. Units are SI and radians.

    y = diag(1 + k) A(γ) f + b + K₂ f² + K₃ f³ + κ |f|               accelerometers, f at the sensor's place and time
    y = diag(1 + k) A(γ) ω + b + G f + κ |ω| + c ω³                  gyros
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

Array = np.ndarray
G0 = 9.80665
DEG = np.pi / 180.0
HOUR = DEG / 3600.0  # 1 °/h
EARTH = 7.292115e-5
LATITUDE = 52.1 * DEG
GRAVITY = 9.8123
UP = np.array([0.0, 1.0, 0.0])
NODES, SHARES = np.array([-np.sqrt(0.15), 0.0, np.sqrt(0.15)]), np.array([5.0, 8.0, 5.0]) / 18.0

NAMES = (
    *(f"{kind}.{what}.{s}" for kind in ("accel",) for what in ("bias", "scale") for s in "xyz"),
    *(f"accel.axis.{a}" for a in ("yx", "zx", "zy")),
    *(f"gyro.{what}.{s}" for what in ("bias", "scale") for s in "xyz"),
    *(f"gyro.axis.{a}" for a in ("xy", "xz", "yx", "yz", "zx", "zy")),
)
"""The 21, in the order of the calibration file."""


@dataclass(frozen=True, kw_only=True)
class Grade:
    """Standard deviations over devices of what is to be calibrated, densities of the white noise (m/s²/√Hz, rad/s/√Hz),
    and the usual sizes of everything else."""

    accel: tuple[float, float, float]  # bias, scale, axes
    gyro: tuple[float, float, float]
    white: tuple[float, float]
    quadratic: float  # m/s² at 1 g, each of the three
    cubic: float
    asymmetry: tuple[float, float]
    g_sensitivity: float  # rad/s at 1 g
    lever: float
    delay: float
    single_delay: float
    per_kelvin: tuple[float, float]  # slopes of the biases
    in_run: tuple[float, float]  # of the biases


GRADES = {
    "navigation": Grade(
        accel=(2e-3, 1e-4, 1e-4), gyro=(0.1 * HOUR, 1e-4, 5e-5), white=(1e-4, 0.003 * DEG / 60.0),
        quadratic=30e-6 * G0, cubic=10e-6 * G0, asymmetry=(20e-6, 10e-6), g_sensitivity=0.05 * HOUR, lever=0.03,
        delay=1e-3, single_delay=20e-6, per_kelvin=(20e-6 * G0, 0.01 * HOUR), in_run=(5e-6, 0.002 * HOUR),
    ),
    "tactical": Grade(
        accel=(2e-2, 5e-4, 5e-4), gyro=(5.0 * HOUR, 5e-4, 5e-4), white=(3e-4, 0.1 * DEG / 60.0),
        quadratic=100e-6 * G0, cubic=30e-6 * G0, asymmetry=(100e-6, 100e-6), g_sensitivity=5.0 * HOUR, lever=0.03,
        delay=3e-3, single_delay=100e-6, per_kelvin=(50e-6 * G0, 1.0 * HOUR), in_run=(5e-5, 0.2 * HOUR),
    ),
    "mems": Grade(
        accel=(5e-2, 6e-3, 4e-3), gyro=(1e-2, 6e-3, 4e-3), white=(1.5e-3, 0.01 * DEG),
        quadratic=500e-6 * G0, cubic=100e-6 * G0, asymmetry=(500e-6, 500e-6), g_sensitivity=0.1 * DEG, lever=0.005,
        delay=5e-3, single_delay=300e-6, per_kelvin=(300e-6 * G0, 80.0 * HOUR), in_run=(3e-4, 5.0 * HOUR),
    ),
}  # fmt: skip


RAIL = {"accel": 16.0 * G0, "gyro": 2000.0 * DEG}
"""Where the ranges of the sensors of a spiked recording end."""


@dataclass(frozen=True, kw_only=True)
class Spec:
    """What is recorded, with which device, and what goes wrong."""

    grade: str = "mems"
    programme: str = "hand"  # hand, table, cube
    rests: int = 30
    rest: float = 5.0
    first_rest: float = 20.0
    turn: float = 3.0  # s
    rate: float = 100.0
    groups: float = 1.0
    """How many times its usual size everything beyond the 21 is."""
    in_run: str = "none"
    """What the biases do: none, white (anew at every rest), markov, walk, flicker, exponential."""
    in_run_size: float = 1.0
    in_run_time: float = 100.0
    warming: tuple[float, float, float] = (0.0, 300.0, 0.0)
    """K from beginning to end, s of the exponential, s by which the sensors lag behind the thermometer; no thermometer
    where nothing warms."""
    scatter_of_one: float = 0.0
    """m/s²: steps of the x accelerometer from rest to rest."""
    spikes: int = 0
    spike: float = 0.0
    spiked: str = "accel"
    """So many single samples in turns, of accelerometers or gyros, are off by so much, m/s² or rad/s; where it is
    infinite they are at the rail of 16 g or 2000 °/s."""
    held: int = 0
    """So many samples in turns repeat the one before."""
    clock_ppm: float = 0.0
    dead_zone: float = 0.0  # rad/s: less than this a driver shows as nothing
    jump: float = 0.0  # rad/s: by which the biases of the gyros jump half way
    normalised: bool = False
    step: tuple[float, float] = (0.0, 0.0)
    """The last digit of the readings, m/s² and rad/s."""
    instantaneous: bool = False
    stated: dict[str, str] = field(default_factory=dict)
    """Lines of session.toml by their table."""


@dataclass(frozen=True, kw_only=True)
class Recording:
    """Stamps (N,), readings (N, 3) each, the thermometer's (N,) in °C where there is one, and the true 21."""

    time: Array
    accel: Array
    gyro: Array
    temperature: Array | None
    truth: dict[str, float]
    spec: Spec

    def write(self, folder: Path) -> Path:
        """A session folder."""
        folder.mkdir(parents=True)
        columns = [self.time, *self.accel.T, *self.gyro.T]
        head = "t,ax,ay,az,gx,gy,gz"
        if self.temperature is not None:
            columns, head = [*columns, self.temperature], head + ",T"
        np.savetxt(folder / "log.csv", np.column_stack(columns), delimiter=",", header=head, comments="", fmt="%.9g")
        tables = {
            "device": 'serial = "E-1"',
            "site": f"latitude_deg = {LATITUDE / DEG!r}\ngravity = {GRAVITY}\ngravity_u = 1e-7",
            "log": 'file = "log.csv"\ntime = "t"\nclock_ppm_u = 0.0',
            "log.accel": 'columns = ["ax", "ay", "az"]\nunit = "m/s^2"',
            "log.gyro": 'columns = ["gx", "gy", "gz"]\nunit = "rad/s"',
        }
        if self.temperature is not None:
            tables["log.temperature"] = 'columns = ["T"]\nunit = "degC"'
        for name, lines in self.spec.stated.items():
            tables[name] = (
                f"{tables[name]}\n{lines}" if name in tables and not lines.startswith("=") else lines.lstrip("=")
            )
        text = "format = 1\n\n" + "\n\n".join(f"[{name}]\n{lines}" for name, lines in tables.items() if lines)
        (folder / "session.toml").write_text(text + "\n", encoding="utf-8")
        return folder


def _rotation(vector: Array) -> Array:
    """exp([v×]) (..., 3, 3)."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    x = np.zeros((*vector.shape[:-1], 3, 3))
    x[..., 0, 1], x[..., 0, 2], x[..., 1, 2] = -vector[..., 2], vector[..., 1], -vector[..., 0]
    x -= np.swapaxes(x, -1, -2)
    safe = np.where(angle > 1e-12, angle, 1.0)
    return np.eye(3) + np.sinc(angle / np.pi) * x + (1.0 - np.cos(angle)) / safe**2 * x @ x


def _vector(matrix: Array) -> Array:
    """The rotation vector of a matrix."""
    angle = np.arccos(np.clip(0.5 * (np.trace(matrix) - 1.0), -1.0, 1.0))
    if angle > np.pi - 1e-4:
        values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
        return angle * vectors[:, np.argmax(values)]
    skew = np.array([matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]])
    return 0.5 * skew if angle < 1e-9 else angle / (2.0 * np.sin(angle)) * skew


def _attitudes(spec: Spec, rng: np.random.Generator) -> list[Array]:
    """L of every rest."""
    if spec.programme == "hand":
        out = [np.linalg.qr(rng.normal(size=(3, 3)))[0] for _ in range(spec.rests)]
        return [L * np.linalg.det(L) for L in out]
    axes = {"N": np.array([1.0, 0, 0]), "U": UP, "E": np.array([0, 0, 1.0])}
    out = []
    for shift in range(3):  # X, Y or Z north, the next one up
        L = np.roll(np.eye(3), -shift, axis=0) if spec.programme == "table" else np.roll(np.eye(3), shift, axis=1)
        out.append(L)
        for axis, angle in (("N", 180.0), ("U", 180.0), ("N", -180.0)):
            L = _rotation(angle * DEG * axes[axis]) @ L
            out.append(L)
    oblique = [_rotation(45.0 * DEG * axes["N"]) @ np.roll(np.eye(3), -shift, axis=0) for shift in range(3)]
    out += oblique
    if spec.programme == "cube":
        directions = [np.array([x, y, z], float) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
        out = []
        for d in directions:
            if d.any():
                up = d / np.linalg.norm(d)
                north = np.linalg.qr(np.column_stack([up, rng.normal(size=3)]))[0][:, 1]
                out.append(np.stack([north, up, np.cross(north, up)]))
        out = [out[i] for i in rng.permutation(len(out))]
    off = rng.uniform(-1.0, 1.0, size=3) * DEG
    return [_rotation(rng.uniform(-1.0, 1.0, 3) * DEG) @ L @ _rotation(off) for L in out]


def _smooth(u: Array) -> tuple[Array, Array, Array]:
    """A step from 0 to 1 with its first and second derivative, at rest at both ends."""
    u = np.clip(u, 0.0, 1.0)
    return u**3 * (10.0 - 15.0 * u + 6.0 * u**2), 30.0 * u**2 * (1.0 - u) ** 2, 60.0 * u * (1.0 - 3.0 * u + 2.0 * u**2)


class _Motion:
    """Attitude, rates and forces of a course of rests and turns at any times."""

    def __init__(self, spec: Spec, rng: np.random.Generator) -> None:
        self.attitudes = _attitudes(spec, rng)
        n = len(self.attitudes)
        lengths = np.r_[spec.first_rest, np.full(n - 1, spec.rest)]
        self.turned = [_vector(a.T @ b) for a, b in zip(self.attitudes[:-1], self.attitudes[1:], strict=True)]
        self.begin = np.cumsum(lengths) + spec.turn * np.arange(n)  # of the turn after each rest
        self.rests = np.column_stack([self.begin - lengths, self.begin])
        self.turn = spec.turn
        self.moves = rng.uniform(-0.3, 0.3, (n - 1, 3)) if spec.programme == "hand" else np.zeros((n - 1, 3))
        self.duration = float(self.begin[-1])

    def at(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """L (N, 3, 3), ω and dω/dt in the body (N, 3), and the acceleration in n (N, 3)."""
        k = np.clip(np.searchsorted(self.begin, t, side="right") - 1, 0, len(self.turned) - 1)
        s, ds, dds = _smooth((t - self.begin[k]) / self.turn)
        axis, L0 = np.array(self.turned)[k], np.array(self.attitudes)[k]
        L = L0 @ _rotation(axis * s[:, None])
        earth = EARTH * np.array([np.cos(LATITUDE), np.sin(LATITUDE), 0.0])
        own = axis * (ds / self.turn)[:, None]
        of_earth = np.einsum("nji,j->ni", L, earth)
        change = axis * (dds / self.turn**2)[:, None] - np.cross(own, of_earth)
        return L, own + of_earth, change, self.moves[k] * (dds / self.turn**2)[:, None]

    def sensed(self, t: Array, levers: Array, delays: Array) -> tuple[Array, Array, Array]:
        """ω (N, 3) at times, each component of f (N, 3, 3) of all accelerometers at their places and times, [:, p] that
        at accelerometer p, and f (N, 3) that the gyros feel."""
        force = np.empty((len(t), 3, 3))
        for p in range(3):
            L, w, dw, a = self.at(t - delays[p])
            f = np.einsum("nji,nj->ni", L, a + GRAVITY * UP)
            force[:, p] = f + np.cross(dw, levers[p]) + np.cross(w, np.cross(w, levers[p]))
        L, w, _, a = self.at(t)
        return w, force, np.einsum("nji,nj->ni", L, a + GRAVITY * UP)


def _axes(g: dict[str, float]) -> Array:
    """A(γ), Eq. (1)."""
    c, s = (lambda name: np.cos(g.get(name, 0.0))), (lambda name: np.sin(g.get(name, 0.0)))
    return np.array([
        [c("xy") * c("xz"), s("xy"), c("xy") * s("xz")],
        [c("yz") * s("yx"), c("yz") * c("yx"), s("yz")],
        [s("zx"), c("zx") * s("zy"), c("zx") * c("zy")],
    ])  # fmt: skip


def _process(spec: Spec, size: float, t: Array, motion: _Motion, rng: np.random.Generator) -> Array:
    """What a bias does (N, 3) beside its constant."""
    sigma, tau, dt = size * spec.in_run_size, spec.in_run_time, t[1] - t[0]
    N = len(t)
    if spec.in_run == "none" or not sigma:
        return np.zeros((N, 3))
    if spec.in_run == "white":
        k = np.clip(np.searchsorted(motion.rests[:, 0] - motion.turn, t, side="right") - 1, 0, None)
        return sigma * rng.normal(size=(len(motion.rests), 3))[k]
    if spec.in_run == "exponential":
        return sigma * rng.normal(size=3) * np.exp(-t / tau)[:, None]
    from scipy.signal import lfilter

    white = rng.normal(size=(N, 3))
    if spec.in_run == "walk":  # σ over the session
        return sigma * np.cumsum(white, axis=0) / np.sqrt(N)
    if spec.in_run == "markov":
        a = np.exp(-dt / tau)
        first = rng.normal(size=(1, 3)) * a
        return sigma * lfilter([np.sqrt(1.0 - a * a)], [1.0, -a], white, axis=0, zi=first)[0]
    if spec.in_run == "flicker":  # a sum of octaves
        out = np.zeros((N, 3))
        for octave in range(10):
            a = np.exp(-dt / (2.0**octave))
            first = rng.normal(size=(1, 3)) * a
            out += lfilter([np.sqrt(1.0 - a * a)], [1.0, -a], rng.normal(size=(N, 3)), axis=0, zi=first)[0]
        return sigma * out / np.sqrt(10.0)
    raise ValueError(spec.in_run)


def record(spec: Spec, seed: int) -> Recording:
    """A recording of a device drawn anew."""
    rng = np.random.default_rng([20261123, seed])
    grade, motion = GRADES[spec.grade], _Motion(spec, rng)
    truth = {}
    for kind, (bias, scale, axis) in (("accel", grade.accel), ("gyro", grade.gyro)):
        for name in (each for each in NAMES if each.startswith(kind)):
            size = {"bias": bias, "scale": scale, "axis": axis}[name.split(".")[1]]
            truth[name] = float(size * rng.normal())
    many = spec.groups
    quadratic, cubic = many * grade.quadratic * rng.normal(size=3), many * grade.cubic * rng.normal(size=3)
    uneven = [many * size * rng.normal(size=3) for size in grade.asymmetry]
    sensitive = many * grade.g_sensitivity / G0 * rng.normal(size=(3, 3))
    levers = many * grade.lever * rng.normal(size=(3, 3))
    levers[2] = 0.0
    delays = many * (grade.delay * rng.normal() + grade.single_delay * np.r_[rng.normal(size=2), 0.0])
    slopes = [many * size * rng.normal(size=3) for size in grade.per_kelvin]

    dt = 1.0 / spec.rate
    t = dt * np.arange(1, int(motion.duration * spec.rate) + 1)
    nodes = (0.0,) if spec.instantaneous else NODES
    shares = (1.0,) if spec.instantaneous else SHARES
    of = {
        kind: _axes({n.split(".")[2]: v for n, v in truth.items() if n.startswith(f"{kind}.axis")})
        for kind in ("accel", "gyro")
    }
    matrix = {kind: np.diag([1.0 + truth[f"{kind}.scale.{s}"] for s in "xyz"]) @ of[kind] for kind in of}
    accel, gyro = np.zeros((len(t), 3)), np.zeros((len(t), 3))
    for node, share in zip(nodes, shares, strict=True):
        w, f, felt = motion.sensed(t - 0.5 * dt + node * dt if not spec.instantaneous else t, levers, delays)
        own = np.einsum("npp->np", f)
        read = np.einsum("pj,npj->np", matrix["accel"], f)
        read += quadratic * (own / G0) ** 2 + cubic * (own / G0) ** 3 + uneven[0] * np.abs(own)
        accel += share * read
        gyro += share * (w @ matrix["gyro"].T + felt @ sensitive.T + uneven[1] * np.abs(w))
    biases = {kind: np.array([truth[f"{kind}.bias.{s}"] for s in "xyz"]) for kind in ("accel", "gyro")}
    drift = {
        "accel": _process(spec, grade.in_run[0], t, motion, rng),
        "gyro": _process(spec, grade.in_run[1], t, motion, rng),
    }
    if spec.scatter_of_one:
        k = np.clip(np.searchsorted(motion.rests[:, 0] - motion.turn, t, side="right") - 1, 0, None)
        drift["accel"][:, 0] += spec.scatter_of_one * rng.normal(size=len(motion.rests))[k]
    if spec.jump:
        drift["gyro"] += np.where(t > 0.5 * motion.duration, 1.0, 0.0)[:, None] * spec.jump * rng.choice([-1.0, 1.0], 3)
    shown = None
    warm, settle, lag = spec.warming
    if warm:
        shown = 22.0 + warm * (1.0 - np.exp(-t / settle))
        felt = shown
        if lag:  # the sensors follow the thermometer
            slow = lag if abs(settle - lag) > 1e-6 else lag * 1.001
            felt = 22.0 + warm * (1.0 - (settle * np.exp(-t / settle) - slow * np.exp(-t / slow)) / (settle - slow))
        reference = np.mean([shown[(t > a) & (t < b)].mean() for a, b in motion.rests])
        for kind, slope in zip(("accel", "gyro"), slopes, strict=True):
            drift[kind] = drift[kind] + (felt - reference)[:, None] * slope
        shown = shown + 0.01 * rng.normal(size=len(t))
    resting = np.zeros(len(t), dtype=bool)
    for a, b in motion.rests:
        resting |= (t > a) & (t <= b)
    if not warm:  # what a bias was over the rests is what a session can know
        means = {
            k: np.mean([drift[k][(t > a) & (t <= b)].mean(axis=0) for a, b in motion.rests], axis=0) for k in drift
        }
        for kind, mean in means.items():
            for s, value in zip("xyz", mean, strict=True):
                truth[f"{kind}.bias.{s}"] += float(value)
    accel += biases["accel"] + drift["accel"] + grade.white[0] * np.sqrt(spec.rate) * rng.normal(size=accel.shape)
    gyro += biases["gyro"] + drift["gyro"] + grade.white[1] * np.sqrt(spec.rate) * rng.normal(size=gyro.shape)
    moving = np.flatnonzero(~resting & (np.roll(resting, 20) == resting) & (np.roll(resting, -20) == resting))
    for i in rng.choice(moving, spec.spikes, replace=False) if spec.spikes else ():
        readings, p = {"accel": accel, "gyro": gyro}[spec.spiked], rng.integers(3)
        spiked = readings[i, p] + spec.spike * rng.choice([-1.0, 1.0])
        readings[i, p] = RAIL[spec.spiked] if np.isinf(spec.spike) else spiked
    for i in rng.choice(moving, spec.held, replace=False) if spec.held else ():
        accel[i], gyro[i] = accel[i - 1], gyro[i - 1]
    if spec.dead_zone:
        gyro = np.where(np.abs(gyro) < spec.dead_zone, 0.0, gyro)
    if spec.normalised:
        accel = GRAVITY * accel / np.linalg.norm(accel, axis=1, keepdims=True)
    for readings, step in ((accel, spec.step[0]), (gyro, spec.step[1])):
        if step:
            readings[:] = step * np.round(readings / step)
    stamps = t * (1.0 + 1e-6 * spec.clock_ppm)
    return Recording(time=stamps, accel=accel, gyro=gyro, temperature=shown, truth=truth, spec=spec)
