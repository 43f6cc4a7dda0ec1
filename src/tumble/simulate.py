"""Session folders with known truth: an IMU with given errors goes through a programme, or through a hand.

Every move is a rotation about an axis fixed in the geographic frame, with the smooth angle θ(t) of `Profile`;
between moves the table stands still, and all the time the Earth turns. With n and θ of the move and L₀ the
attitude at its start (body → geographic),

    L(t) = exp([nθ×]) L₀,   ω = n θ̇ + Ω,   f = (g + v) e_U        geographic frame; v: vibration, vertical

A sample is the mean over the interval that ends at its time stamp, in the body frame. Since Lᵀn is constant,

    mean Lᵀω = L₀ᵀ( n Δθ/h + mean(R)ᵀ Ω ),   mean Lᵀf = L₀ᵀ mean((g + v) Rᵀ) e_U
    Rᵀ = nnᵀ + cos θ (I − nnᵀ) − sin θ [n×]

so that a move is three scalar series: Δθ, and the means of cos θ and sin θ. The means are Gauss–Legendre
sums over panels that end wherever a sample ends or θ(t) is not smooth, exact to rounding; moves need not
begin or end with a sample. `reading = matrix @ mean + bias + noise`. There are no lever arms.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tumble.earth import earth_rate, normal_gravity
from tumble.errors import InputError
from tumble.grades import NoiseModel
from tumble.grades import grade as typical
from tumble.model import Block, SensorModel
from tumble.programme import ANY_MOVE, BUILT_IN, Move, Programme, programme
from tumble.rotation import rotation_matrix, rotation_vector
from tumble.session import write_session
from tumble.units import DEGREE, Array

LogFormat = Literal["parquet", "csv"]

_UP = np.array([0.0, 1.0, 0.0])
_LEGENDRE = np.polynomial.legendre.leggauss(6)
_NODES, _WEIGHTS = 0.5 * (_LEGENDRE[0] + 1.0), 0.5 * _LEGENDRE[1]
"""Six Gauss–Legendre nodes and weights on 0…1."""
_PANELS_PER_CYCLE = 4.0
_MAX_CYCLES_PER_SAMPLE = 10.0
_MAX_SAMPLES = 30_000_000
"""Eight hours at 1 kHz, 1.5 GB."""
_CHUNK = 1 << 13
"""Samples made at a time."""


# -------------------- the scenario --------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class Profile:
    """Duration of the first and of the other rests, s; rate of the moves, rad/s, reached and left in `ramp` s
    along a raised cosine (a short move keeps the ramps and is slower); sample rate, Hz."""

    first_rest: float
    rest: float
    rate: float
    ramp: float
    sample_rate: float

    def duration(self, angle: float) -> float:
        """How long a move through this angle (rad) takes, s."""
        return max(abs(angle) / self.rate, self.ramp) + self.ramp

    def angle(self, t: Array, total: float) -> Array:
        """Angle, rad, at times t, s, after the start of a move through `total`: zero before, total after."""
        T = self.duration(total)
        t = np.clip(t, 0.0, T)
        late = t > 0.5 * T
        s = np.where(late, T - t, t)  # the second half mirrors the first
        into = np.minimum(s, self.ramp)
        ramp = 0.5 * into - self.ramp / (2.0 * np.pi) * np.sin(np.pi * into / self.ramp)
        gone = total / (T - self.ramp) * (ramp + (s - into))
        return np.asarray(np.where(late, total - gone, gone))


@dataclass(frozen=True, kw_only=True, slots=True)
class Site:
    """Latitude, rad; height, m; true local gravity, m/s², as the session will state it with uncertainty
    `gravity_u`."""

    latitude: float
    height: float
    gravity: float
    gravity_u: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Vibration:
    """A vertical vibration throughout the log: amplitude of the specific force, m/s², and frequency, Hz."""

    amplitude: float = 0.0
    frequency: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True)
class OnTable:
    """A programme on a rough table. Errors are rotations, rad, uniform within ± about each axis: one of the
    mounting for the launch (body axes), and one of the table for every position (geographic axes)."""

    programme: Programme
    table_error: float
    mounting_error: float


@dataclass(frozen=True, kw_only=True, slots=True)
class HandHeld:
    """So many random positions, each with any orientation."""

    positions: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Scenario:
    """Everything a simulated session is made of, apart from chance. `truth`: values by parameter name of both
    blocks; it goes into truth.json."""

    course: OnTable | HandHeld
    accel: Block
    gyro: Block
    truth: Mapping[str, float]
    noise: NoiseModel
    profile: Profile
    site: Site
    vibration: Vibration
    serial: str


ON_TABLE = Profile(first_rest=60.0, rest=60.0, rate=10 * DEGREE, ramp=1.0, sample_rate=100.0)
IN_HAND = Profile(first_rest=40.0, rest=5.0, rate=80 * DEGREE, ramp=0.5, sample_rate=100.0)


def draw_parameters(grade: str, blocks: Sequence[Block], rng: np.random.Generator) -> dict[str, float]:
    """True values by parameter name for blocks of a grade, Gaussian with the grade's spreads.

    Raises InputError for a grade that does not exist."""
    values: dict[str, float] = {}
    for block in blocks:
        spread = getattr(typical(grade), block.kind)
        for name in block.names:
            values[name] = float(getattr(spread, name.split(".")[1]) * rng.standard_normal())
    return values


# -------------------- recordings --------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class Recording:
    """A simulated log and what really happened. `time` (N,), s; `accel` (N, n), m/s²; `gyro` (N, n), rad/s;
    `attitudes` (R, 3, 3), true body → geographic at the rests; `rests` (R, 2), their start and stop, s;
    `moves` (R − 1, 3), rotation vectors in the geographic frame, rad; `positions` (R,), which position of the
    programme each rest is (of the random ones, if hand-held)."""

    time: Array
    accel: Array
    gyro: Array
    attitudes: Array
    rests: Array
    moves: Array
    positions: tuple[int, ...]


def record(scenario: Scenario, rng: np.random.Generator) -> Recording:
    """Run a scenario in memory. Attitudes and times do not depend on the noise.

    Raises InputError, one line, if the scenario is impossible or too long."""
    geometry, noise = rng.spawn(2)
    way = itinerary(scenario, geometry)
    samples = way.rests[-1, 1] * scenario.profile.sample_rate
    if not samples <= _MAX_SAMPLES:
        raise InputError(f"session: expected at most {_MAX_SAMPLES:g} samples, found {samples:.3g}")
    time, accel, gyro = _readings(scenario, way.attitudes, way.moves, way.rests, noise)
    return Recording(
        time=time,
        accel=accel,
        gyro=gyro,
        attitudes=way.attitudes,
        rests=way.rests,
        moves=way.moves,
        positions=way.positions,
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class Itinerary:
    """Where a simulated device rests and how it gets there: `attitudes`, `rests`, `moves` and `positions` as in a
    `Recording`; `programmed` (R − 1,): whether the programme prescribes the turn."""

    attitudes: Array
    rests: Array
    moves: Array
    positions: tuple[int, ...]
    programmed: tuple[bool, ...]


def itinerary(scenario: Scenario, rng: np.random.Generator) -> Itinerary:
    """Attitudes, moves and times of a scenario. Raises InputError, one line, if the scenario is impossible."""
    _check(scenario)
    positions, attitudes, nominal = _attitudes(scenario.course, rng)
    moves = np.array([_move(a, b, m) for a, b, m in zip(attitudes[:-1], attitudes[1:], nominal, strict=True)])
    moves = moves.reshape(-1, 3)
    return Itinerary(
        attitudes=attitudes,
        rests=_timetable(scenario.profile, moves),
        moves=moves,
        positions=positions,
        programmed=tuple(move.axis is not None for move in nominal),
    )


def _attitudes(course: OnTable | HandHeld, rng: np.random.Generator) -> tuple[tuple[int, ...], Array, tuple[Move, ...]]:
    """Which position comes when, the true attitudes (R, 3, 3), and the nominal moves between them."""
    if isinstance(course, HandHeld):
        n = course.positions
        return tuple(range(n)), _random_rotations(n, rng), (ANY_MOVE,) * (n - 1)
    n = len(course.programme.positions)
    order = np.arange(n) if course.programme.ordered else rng.permutation(n)
    nominal = np.array([course.programme.positions[i].matrix for i in order])
    if not course.programme.ordered:
        nominal = rotation_matrix(rng.uniform(-np.pi, np.pi, (n, 1)) * _UP) @ nominal
    mounting = rotation_matrix(course.mounting_error * rng.uniform(-1.0, 1.0, 3))
    table = rotation_matrix(course.table_error * rng.uniform(-1.0, 1.0, (n, 3)))
    return tuple(order.tolist()), table @ nominal @ mounting, course.programme.moves


def _random_rotations(n: int, rng: np.random.Generator) -> Array:
    """n rotation matrices, uniform over all orientations."""
    q = rng.standard_normal((n, 4))
    q /= np.linalg.norm(q, axis=1)[:, None]
    angle = 2.0 * np.arctan2(np.linalg.norm(q[:, 1:], axis=1), q[:, 0])
    axis = q[:, 1:] / np.linalg.norm(q[:, 1:], axis=1)[:, None]
    return rotation_matrix(angle[:, None] * axis)


def _move(start: Array, end: Array, nominal: Move) -> Array:
    """Rotation vector, geographic frame, rad, of the rotation from one true attitude to the next: of the two
    ways round, the one nearer to the nominal move, or the shorter one if any movement will do."""
    vector = rotation_vector(end @ start.T)
    angle = float(np.linalg.norm(vector))
    if nominal.axis is None or nominal.angle is None or angle == 0.0:
        return vector
    other = vector * (1.0 - 2.0 * np.pi / angle)
    wanted = nominal.angle * nominal.axis
    return min(vector, other, key=lambda way: float(np.linalg.norm(way - wanted)))


def _timetable(profile: Profile, moves: Array) -> Array:
    """Start and stop of every rest, s, shape (R, 2)."""
    rests = np.full(len(moves) + 1, profile.rest)
    rests[0] = profile.first_rest
    durations = [profile.duration(float(np.linalg.norm(move))) for move in moves]
    stops = np.cumsum(rests + np.concatenate([[0.0], durations]))
    return np.column_stack([stops - rests, stops])


def _readings(
    scenario: Scenario, attitudes: Array, moves: Array, rests: Array, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Time and readings of both blocks, piece by piece: rest, move, rest, …

    A sample belongs to a rest if all of its interval does."""
    fs = scenario.profile.sample_rate
    edges = np.column_stack([np.ceil(rests[:, 0] * fs - 1e-6), np.floor(rests[:, 1] * fs + 1e-6)]).astype(int)
    N = int(edges[-1, 1])
    accel, gyro = _sensors(scenario, N, rng)
    for i, L in enumerate(attitudes):
        accel.draw_bias()
        gyro.draw_bias()
        for first, last in _chunks(edges[i, 0], edges[i, 1]):
            force, rate = _at_rest(scenario, L, first, last)
            accel.put(first, last, force)
            gyro.put(first, last, rate)
        for first, last in _chunks(edges[i, 1], edges[i + 1, 0]) if i < len(moves) else ():
            force, rate = _in_move(scenario, L, moves[i], float(rests[i, 1]), first, last)
            accel.put(first, last, force)
            gyro.put(first, last, rate)
    return np.arange(1, N + 1) / fs, accel.readings.T, gyro.readings.T


def _chunks(first: int, last: int) -> Iterator[tuple[int, int]]:
    """A range of samples in pieces of bounded length."""
    for start in range(int(first), int(last), _CHUNK):
        yield start, min(start + _CHUNK, int(last))


@dataclass(kw_only=True, slots=True)
class _Sensors:
    """One block at work: its readings (n, N) as they fill up, the noise `sigma` of a sample, and the bias it
    has in the current rest and move."""

    model: SensorModel
    sigma: float
    instability: float
    rng: np.random.Generator
    bias: Array
    readings: Array

    def draw_bias(self) -> None:
        self.bias = self.model.bias + self.instability * self.rng.standard_normal(len(self.model.bias))

    def put(self, first: int, last: int, true: Array) -> None:
        """Readings of true body vectors, shape (last − first, 3), or (1, 3) for all of them."""
        out = self.readings[:, first:last]
        out[:] = self.model.matrix @ true.T + self.bias[:, None]
        if self.sigma > 0.0:
            out += self.sigma * self.rng.standard_normal(out.shape)


def _sensors(scenario: Scenario, samples: int, rng: np.random.Generator) -> tuple[_Sensors, _Sensors]:
    """Accelerometers and gyros, ready to fill."""
    noise, root = scenario.noise, math.sqrt(scenario.profile.sample_rate)
    levels = ((noise.accel_white, noise.accel_instability), (noise.gyro_white, noise.gyro_instability))
    made = []
    for block, (white, instability), own in zip((scenario.accel, scenario.gyro), levels, rng.spawn(2), strict=True):
        model = block.model(np.array([scenario.truth[name] for name in block.names]))
        made.append(
            _Sensors(
                model=model,
                sigma=white * root,
                instability=instability,
                rng=own,
                bias=model.bias,
                readings=np.empty((block.size, samples)),
            )
        )
    return made[0], made[1]


def _at_rest(scenario: Scenario, L: Array, first: int, last: int) -> tuple[Array, Array]:
    """Mean specific force and rate, body frame, of samples [first, last) at rest: (1, 3), or with vibration
    the force of every sample."""
    site, vibration, fs = scenario.site, scenario.vibration, scenario.profile.sample_rate
    up, rate = L.T @ _UP, L.T @ np.array(earth_rate(site.latitude))
    force = np.full(1, site.gravity)
    if vibration.amplitude > 0.0:
        middle = (np.arange(first, last) + 0.5) / fs
        mean = vibration.amplitude * np.sinc(vibration.frequency / fs)
        force = site.gravity + mean * np.sin(2.0 * np.pi * vibration.frequency * middle)
    return force[:, None] * up, rate[None, :]


def _in_move(scenario: Scenario, L: Array, move: Array, start: float, first: int, last: int) -> tuple[Array, Array]:
    """Mean specific force and rate, body frame, (last − first, 3), of samples of a move from attitude L that
    starts at time `start`. The formulas are those at the head of the module."""
    profile, fs = scenario.profile, scenario.profile.sample_rate
    total = float(np.linalg.norm(move))
    n = move / total if total > 0.0 else _UP
    whole = math.floor(start * fs)  # time within the move, in samples, so that nothing is lost late in a log
    passed = (first - whole) - (start * fs - whole)
    samples = np.arange(last - first + 1.0)
    turned = np.diff(profile.angle((samples + passed) / fs, total)) * fs
    panels = _panels(scenario, total, passed, last - first)
    nodes = panels[:-1, None] + np.diff(panels)[:, None] * _NODES
    theta = profile.angle((nodes + passed) / fs, total)
    ones, cosine, sine = np.ones_like(theta), np.cos(theta), np.sin(theta)
    force = scenario.site.gravity + _vibration(scenario, nodes, first)
    w = _means(np.stack([ones, cosine, sine]), panels, samples)
    f = _means(force * np.stack([ones, cosine, sine]), panels, samples)
    earth = np.array(earth_rate(scenario.site.latitude))
    return f @ _turning(n, _UP) @ L, (w @ _turning(n, earth) + np.outer(turned, n)) @ L


def _turning(n: Array, vector: Array) -> Array:
    """Rows a, b, c with Rᵀ vector = a + b cos θ + c sin θ, R the rotation by θ about n."""
    along = n * (n @ vector)
    return np.stack([along, vector - along, -np.cross(n, vector)])


def _means(values: Array, panels: Array, samples: Array) -> Array:
    """Means over every sample, (samples, k), of k series given at the nodes of every panel, (k, P, 6)."""
    integrals = (values @ _WEIGHTS) * np.diff(panels)
    return np.asarray(np.add.reduceat(integrals, np.searchsorted(panels, samples[:-1]), axis=1).T)


def _panels(scenario: Scenario, total: float, passed: float, samples: int) -> Array:
    """Borders of the quadrature panels of a piece of a move, in samples from its beginning: every sample's
    ends, quarters of the vibration's cycle, and where the ramps begin and end."""
    profile, vibration = scenario.profile, scenario.vibration
    each = 1
    if vibration.amplitude > 0.0:
        each += math.ceil(_PANELS_PER_CYCLE * vibration.frequency / profile.sample_rate)
    T = profile.duration(total)
    kinks = np.array([0.0, profile.ramp, T - profile.ramp, T]) * profile.sample_rate - passed
    inside = kinks[(kinks > 0.0) & (kinks < samples)]
    return np.unique(np.concatenate([np.arange(samples * each + 1) / each, inside]))


def _vibration(scenario: Scenario, nodes: Array, first: int) -> Array:
    """Specific force of the vibration, m/s², at `nodes`, samples after sample `first` begins."""
    vibration = scenario.vibration
    if vibration.amplitude == 0.0:
        return np.zeros(1)
    t = (first + nodes) / scenario.profile.sample_rate
    return np.asarray(vibration.amplitude * np.sin(2.0 * np.pi * vibration.frequency * t))


# -------------------- session folders --------------------


@dataclass(frozen=True, kw_only=True, slots=True)
class Request:
    """What to simulate, in the words of the command line: a typical instrument of a `grade` in a built-in
    programme or, if `positions` is given, in the hand at so many random positions.

    `rest` (s), `rate_deg_s` and `sample_rate` (Hz) are those of `ON_TABLE` or `IN_HAND` where None. The
    errors of table and mounting do not apply in the hand. `noiseless` leaves out noise and instability."""

    grade: str = "navigation"
    programme: str = "rough-table"
    positions: int | None = None
    rest: float | None = None
    rate_deg_s: float | None = None
    sample_rate: float | None = None
    table_error_deg: float = 1.0
    mounting_error_deg: float = 1.0
    latitude_deg: float = 56.84
    noiseless: bool = False
    vibration: Vibration = Vibration()


def simulate_session(
    folder: Path, request: Request, *, seed: int, launch: int = 1, log_format: LogFormat = "parquet"
) -> Path:
    """Write a simulated session, session.toml, log and truth.json, into a new folder, and return the folder.

    The same request, seed and launch give the same numbers; another launch of a seed is the same device, put on the
    table and turned anew. Raises InputError, one line, for a request that cannot be
    met, and for a folder that holds a session already."""
    truth, course = np.random.default_rng(seed), np.random.default_rng([seed, launch])
    scenario = typical_scenario(request, truth, serial=f"{request.grade}-{seed}")
    return write_simulation(folder, scenario, course, log_format=log_format)


def typical_scenario(request: Request, rng: np.random.Generator, *, serial: str) -> Scenario:
    """The scenario of a request: a triad of each kind along the body axes, errors drawn from its grade."""
    grade = typical(request.grade)
    accel, gyro = (Block(kind=kind, axes=np.eye(3)) for kind in ("accel", "gyro"))
    return Scenario(
        course=_course(request),
        accel=accel,
        gyro=gyro,
        truth=draw_parameters(request.grade, (accel, gyro), rng),
        noise=NoiseModel() if request.noiseless else grade.noise,
        profile=_profile(request),
        site=_site(request.latitude_deg),
        vibration=request.vibration,
        serial=serial,
    )


def _course(request: Request) -> OnTable | HandHeld:
    if request.positions is not None:
        return HandHeld(positions=request.positions)
    return OnTable(
        programme=programme(request.programme),
        table_error=request.table_error_deg * DEGREE,
        mounting_error=request.mounting_error_deg * DEGREE,
    )


def _profile(request: Request) -> Profile:
    """The usual profile with what the request changes; on a table the first rest is like the others."""
    usual = ON_TABLE if request.positions is None else IN_HAND
    rest = usual.rest if request.rest is None else request.rest
    return Profile(
        first_rest=rest if request.positions is None else max(rest, usual.first_rest),
        rest=rest,
        rate=usual.rate if request.rate_deg_s is None else request.rate_deg_s * DEGREE,
        ramp=usual.ramp,
        sample_rate=usual.sample_rate if request.sample_rate is None else request.sample_rate,
    )


def _site(latitude_deg: float) -> Site:
    """A site 270 m up whose gravity, the normal one, has been measured."""
    if not abs(latitude_deg) <= 90.0:
        raise InputError(f"latitude: expected -90 to 90 degrees, found {latitude_deg:g}")
    latitude, height = latitude_deg * DEGREE, 270.0
    return Site(latitude=latitude, height=height, gravity=normal_gravity(latitude, height), gravity_u=1e-7)


def vibration_of(text: str) -> Vibration:
    """A vibration written as AMPLITUDE@HZ, such as "0.05@30" for 0.05 m/s² at 30 Hz."""
    amplitude, at, frequency = text.partition("@")
    try:
        found = Vibration(amplitude=float(amplitude), frequency=float(frequency))
    except ValueError:
        found = Vibration(amplitude=math.nan)
    if not at or not (0.0 <= found.amplitude < math.inf and 0.0 < found.frequency < math.inf):
        raise InputError(f"vibration: expected AMPLITUDE@HZ in m/s^2 and Hz, such as 0.05@30, found {text!r}")
    return found


def write_simulation(
    folder: Path, scenario: Scenario, rng: np.random.Generator, *, log_format: LogFormat = "parquet"
) -> Path:
    """Record a scenario and write it as a session folder, which must not hold a session yet.

    session.toml names a built-in programme, lists the positions of another, and names none for random ones.
    Raises InputError."""
    if (folder / "session.toml").exists():
        raise InputError(f"{folder}: expected a new folder, found a session in it; give another one")
    recording = record(scenario, rng)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _write_log(folder / f"log.{log_format}", scenario, recording)
        truth = {name: scenario.truth[name] for name in _names(scenario)}
        (folder / "truth.json").write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{folder}: expected a folder to write to, found: {error.strerror or error}") from None
    write_session(folder, _content(scenario, log_format))
    return folder


def _names(scenario: Scenario) -> tuple[str, ...]:
    return scenario.accel.names + scenario.gyro.names


def _columns(block: Block) -> list[str]:
    """Column names of a block: ax, ay, az if it is along the body axes, else a0, a1, …"""
    along = np.array_equal(block.axes, np.eye(3))
    return [f"{block.kind[0]}{'xyz'[p] if along else p}" for p in range(block.size)]


def _write_log(file: Path, scenario: Scenario, recording: Recording) -> None:
    """The log in SI; float64 survives in both formats."""
    import polars as pl  # heavy, and only needed here

    columns = {"t": recording.time}
    columns |= dict(zip(_columns(scenario.accel), recording.accel.T, strict=True))
    columns |= dict(zip(_columns(scenario.gyro), recording.gyro.T, strict=True))
    frame = pl.DataFrame(columns)
    if file.suffix == ".csv":
        frame.write_csv(file)
    else:
        frame.write_parquet(file)


def _content(scenario: Scenario, log_format: LogFormat) -> dict[str, Any]:
    """What session.toml says."""
    site = scenario.site
    content: dict[str, Any] = {
        "format": 1,
        "device": {"serial": scenario.serial},
        "site": {
            "latitude_deg": round(site.latitude / DEGREE, 12),
            "height_m": site.height,
            "gravity": site.gravity,
            "gravity_u": site.gravity_u,
        },
        "log": {
            "file": f"log.{log_format}",
            "time": "t",
            "accel": _block_content(scenario.accel, "m/s^2"),
            "gyro": _block_content(scenario.gyro, "rad/s"),
        },
    }
    if isinstance(scenario.course, OnTable):
        content["programme"] = _programme_content(scenario.course.programme)
    return content


def _block_content(block: Block, unit: str) -> dict[str, Any]:
    content: dict[str, Any] = {"columns": _columns(block), "unit": unit}
    if not np.array_equal(block.axes, np.eye(3)):
        content["axes"] = block.axes.tolist()
    return content


def _programme_content(listed: Programme) -> dict[str, Any]:
    if listed.name in BUILT_IN:
        return {"name": listed.name}
    return {"position": [{"attitude": position.attitude} for position in listed.positions]}


# -------------------- checks --------------------


def _check(scenario: Scenario) -> None:
    """Raise InputError if a scenario is one nothing can be recorded of."""
    profile, vibration = scenario.profile, scenario.vibration
    _expect("sample rate", profile.sample_rate, "Hz")
    _expect("rate", profile.rate / DEGREE, "deg/s")
    _expect("ramp", profile.ramp, "s")
    shortest = 2.0 / profile.sample_rate
    for what, rest in (("first rest", profile.first_rest), ("rest", profile.rest)):
        if not shortest <= rest < math.inf:
            raise InputError(f"{what}: expected at least two samples, {shortest:g} s, found {rest:g} s")
    highest = _MAX_CYCLES_PER_SAMPLE * profile.sample_rate
    if vibration.amplitude > 0.0 and not 0.0 < vibration.frequency <= highest:
        raise InputError(
            f"vibration: expected more than 0 and at most {highest:g} Hz (ten cycles a sample), "
            f"found {vibration.frequency:g} Hz"
        )
    if isinstance(scenario.course, HandHeld):
        if scenario.course.positions < 1:
            raise InputError(f"positions: expected at least 1, found {scenario.course.positions}")
    else:
        _expect("table error", scenario.course.table_error / DEGREE, "deg", zero=True)
        _expect("mounting error", scenario.course.mounting_error / DEGREE, "deg", zero=True)
    missing = sorted(set(_names(scenario)) ^ set(scenario.truth))
    if missing:
        raise InputError(
            f"truth: expected a value for every parameter and no other, found a difference in {missing[0]}"
        )


def _expect(what: str, value: float, unit: str, *, zero: bool = False) -> None:
    """Raise InputError unless a value is finite and positive, or zero where that is allowed."""
    if not (0.0 < value < math.inf or (zero and value == 0.0)):
        least = "0 or more" if zero else "more than 0"
        raise InputError(f"{what}: expected {least}, in {unit}, found {value:g}")
