"""Is anything wrong accepted without a word, when an instrument or a log departs from the model?

Sessions are simulated here, sample by sample and with kinematics of their own: an analytic attitude between the
positions, means of the readings over the interval by Gauss's rule with three nodes, then the departure, noise, and
what became of the samples. Each departure of the table is tried at its size and at three times it, in three settings:
`rough-table` with a navigation unit (1e-4 m/s²/√Hz, 0.003 °/√h, rests of 60 s, 50 Hz), `cube-26` and thirty positions
in the hand with a MEMS unit (rests of 5 s, 100 Hz). Instruments have every group of parameters at its usual size.

What is asked: of the 21 parameters of the sessions that are accepted without a remark, the rms of (value − truth)/u
and the share beyond 3 u; what is refused; and of the sessions accepted with scatter, how often the cause is among the
first two that are named.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy.signal import lfilter
from stored import shown, store

from tumble.diagnosis.findings import causes_of
from tumble.diagnosis.misfit import misfit
from tumble.diagnosis.verdict import verdict
from tumble.earth import earth_rate, normal_gravity
from tumble.inference.estimate import Outcome
from tumble.inference.joint import joint
from tumble.programme.positions import programme
from tumble.recording.session import Site
from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.reduction.blocks.reducer import ChannelState
from tumble.reduction.noise.coloured_noise import WHITE
from tumble.reduction.noise.rounding import Rounding, rounding
from tumble.reduction.observations import Observations
from tumble.reduction.rests.rests import Rests
from tumble.reduction.turns.moments import BlockCompensation, Compensation, integrate
from tumble.reduction.turns.turns import Turns, TurnSamples, aliased_rotations
from tumble.rotation import rotation_matrix, rotation_vector
from tumble.sensors.grades import GRADES
from tumble.sensors.model import Block
from tumble.sensors.parameters import groups, usual_sizes
from tumble.units import DEGREE, DEGREE_PER_HOUR, G_STANDARD, Array, IntArray

MICRO_G = 1e-6 * G_STANDARD
ACCEL, GYRO = Block(kind="accel", axes=np.eye(3)), Block(kind="gyro", axes=np.eye(3))
LATITUDE = 56.8 * DEGREE
GRAVITY = normal_gravity(LATITUDE, 200.0)
STILL = 0.5  # s, at both ends of a turn
RAMP = 2.0  # s, from rest to the full rate of the table
NODES = np.array([-np.sqrt(0.15), 0.0, np.sqrt(0.15)])  # of the middle of the interval, in intervals
SHARES = np.array([5.0, 8.0, 5.0]) / 18.0
PLAY = 0.1 * G_STANDARD / 2.0  # m/s²: half the width of the play of a hysteresis


# ---------------------------------------------------------------- settings and departures


@dataclass(frozen=True, kw_only=True, slots=True)
class Setting:
    """Positions, timing, and the noise of the instrument: densities, m/s²/√Hz and rad/s/√Hz."""

    name: str
    grade: str
    accel_noise: float
    gyro_noise: float
    rest: float
    rate: float


SETTINGS = (
    Setting(
        name="rough-table",
        grade="navigation",
        accel_noise=1e-4,
        gyro_noise=0.003 * DEGREE / 60.0,
        rest=60.0,
        rate=50.0,
    ),
    Setting(name="cube-26", grade="mems", accel_noise=1.5e-3, gyro_noise=0.01 * DEGREE, rest=5.0, rate=100.0),
    Setting(name="by hand", grade="mems", accel_noise=1.5e-3, gyro_noise=0.01 * DEGREE, rest=5.0, rate=100.0),
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Departure:
    """What an instrument or a log has beyond the model; SI. `quadratic` K₂ and `cubic` K₃ of the accelerometers, halves
    of the differences between + and − scale factors, `nonlinearity` of the gyros: ν in ω (1 + ν (ω/10 °/s)²),
    `hysteresis` by the play of the own force, `memory` of the own force over 60 s, changes over
    the session, the noise of a gyro in steps of its `resolution` (0: fine), shares of samples `lost` and `held`."""

    name: str
    causes: tuple[str, ...] = ()
    quadratic: float = 0.0
    cubic: float = 0.0
    accel_asymmetry: float = 0.0
    gyro_asymmetry: float = 0.0
    nonlinearity: float = 0.0
    hysteresis: float = 0.0
    memory: float = 0.0
    scale_drift: float = 0.0
    accel_bias_drift: float = 0.0
    gyro_bias_drift: float = 0.0
    resolution: float = 0.0
    lost: float = 0.0
    held: float = 0.0

    def times(self, factor: float) -> Departure:
        """The same, so many times as large."""
        sizes = {
            name: factor * getattr(self, name) for name in self.__slots__ if isinstance(getattr(self, name), float)
        }
        return replace(self, **sizes)


CLEAN = Departure(name="none")
DEPARTURES = (
    Departure(name="K₂ 10 µg/g²", quadratic=10.0 * MICRO_G / G_STANDARD**2),
    Departure(name="K₂ 0.3 mg/g²", quadratic=300.0 * MICRO_G / G_STANDARD**2),
    Departure(name="accelerometer ± scales 20 ppm apart", accel_asymmetry=10e-6),
    Departure(name="K₃ 10 µg/g³", cubic=10.0 * MICRO_G / G_STANDARD**3),
    Departure(name="gyro ± scales 10 ppm apart", gyro_asymmetry=5e-6),
    Departure(name="gyro nonlinearity 20 ppm at 10 °/s", nonlinearity=20e-6, causes=("gyro nonlinearity",)),
    Departure(name="hysteresis 10 µg", hysteresis=10.0 * MICRO_G, causes=("hysteresis", "memory")),
    Departure(name="memory 50 ppm over 60 s", memory=50e-6, causes=("memory", "hysteresis")),
    Departure(name="gyro steps, noise 0.3 of one", resolution=1.0 / 0.3, causes=("quantisation",)),
    Departure(name="0.2 % of samples lost", lost=0.002, causes=("lost samples",)),
    Departure(name="1 % of samples lost", lost=0.01, causes=("lost samples",)),
    Departure(name="scales drift by 20 ppm", scale_drift=20e-6, causes=("scale-factor drift",)),
    Departure(
        name="biases drift by 50 µg, 0.1 °/h",
        accel_bias_drift=50.0 * MICRO_G,
        gyro_bias_drift=0.1 * DEGREE_PER_HOUR,
        causes=("drift", "warm-up"),
    ),
    Departure(name="1 % of samples held", held=0.01, causes=("lost samples",)),
)


# ---------------------------------------------------------------- the way


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Way:
    """A turn from attitude `start` (body → geographic) by the rotation vector `path` (geographic, rad) in `duration`
    seconds; `ramp` of them to and from the full rate, all of them half and half if 0; `push` the peak velocity, m/s."""

    start: Array
    path: Array
    duration: float
    ramp: float
    push: Array

    def at(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """Attitude (S, 3, 3), rate about the path and its change, and acceleration (S, 3), geographic."""
        T, r = self.duration, self.ramp if self.ramp else 0.5 * self.duration
        x = np.clip(t, 0.0, T)
        early, late = np.minimum(x, r), np.minimum(T - x, r)
        w = 1.0 / (T - r)
        rate = np.where(x < r, _swing(early, r)[1], np.where(x > T - r, _swing(late, r)[1], 1.0)) * w
        turn = w * np.where(x < r, _swing(early, r)[0], np.where(x > T - r, T - r - _swing(late, r)[0], x - 0.5 * r))
        change = w * np.where(x < r, _swing(early, r)[2], np.where(x > T - r, -_swing(late, r)[2], 0.0))
        moving = (t > 0.0) & (t < T)
        pushed = np.where(moving, np.pi / T * np.sin(2.0 * np.pi * x / T), 0.0)
        L = rotation_matrix(turn[:, None] * self.path) @ self.start
        return L, rate[:, None] * self.path, change[:, None] * self.path, pushed[:, None] * self.push


def _swing(t: Array, r: float) -> tuple[Array, Array, Array]:
    """Angle, rate and acceleration at t of a rate that rises from 0 to 1 in r seconds like 1 − cos."""
    phase = np.pi * t / r
    return 0.5 * (t - r / np.pi * np.sin(phase)), 0.5 * (1.0 - np.cos(phase)), 0.5 * np.pi / r * np.sin(phase)


def ways_of(setting: Setting, rng: np.random.Generator) -> list[Way]:
    """The turns of a session; the last one is none, from where the last rest is."""
    attitudes, nominal = _positions(setting, rng)
    ways = []
    for k in range(len(attitudes) - 1):
        path = rotation_vector(attitudes[k + 1] @ attitudes[k].T)
        if nominal[k] is not None and path @ nominal[k] < 0.0:
            path = path * (1.0 - 2.0 * np.pi / float(np.linalg.norm(path)))
        angle = float(np.linalg.norm(path))
        if setting.name == "rough-table":
            ways.append(_way(attitudes[k], path, angle / (9.5 * DEGREE) + RAMP, RAMP, np.zeros(3)))
        else:
            push = rng.normal(0.0, 0.2, 3)
            ways.append(_way(attitudes[k], path, angle / (rng.uniform(50.0, 120.0) * DEGREE) + 0.5, 0.0, push))
    return [*ways, _way(attitudes[-1], np.zeros(3), 4.0 * RAMP, RAMP, np.zeros(3))]


def _way(start: Array, path: Array, duration: float, ramp: float, push: Array) -> Way:
    return Way(start=start, path=path, duration=duration, ramp=ramp, push=push)


def _positions(setting: Setting, rng: np.random.Generator) -> tuple[list[Array], list[Array | None]]:
    """Attitudes of the rests, and the nominal rotation vectors between them where there are any."""
    if setting.name == "by hand":
        return [rotation_matrix(_anyhow(rng)) for _ in range(30)], [None] * 29
    listed = programme(setting.name)
    off = (1.0 if setting.name == "rough-table" else 3.0) * DEGREE
    attitudes = [rotation_matrix(rng.normal(0.0, off, 3)) @ p.matrix for p in listed.positions]
    nominal = [None if m.axis is None or m.angle is None else m.axis * m.angle for m in listed.moves]
    return attitudes, nominal


def _anyhow(rng: np.random.Generator) -> Array:
    """The rotation vector of a random attitude."""
    q = rng.standard_normal(4)
    q /= np.linalg.norm(q)
    return np.asarray(2.0 * np.arccos(q[0]) * q[1:] / np.linalg.norm(q[1:]))


# ---------------------------------------------------------------- the instrument


def truth_of(setting: Setting, rng: np.random.Generator) -> dict[str, float]:
    """An instrument of the grade: parameters of the linear model and of the further groups at their usual size, but
    nothing that changes within the session."""
    grade, out = GRADES[setting.grade], {}
    for block, spread in ((ACCEL, grade.accel), (GYRO, grade.gyro)):
        for name in block.names:
            what = name.split(".")[1]
            out[name] = float(rng.normal(0.0, getattr(spread, what)))
    for group in groups():
        if group.kind in ("accel", "gyro") and not group.linear and group.base is None:
            for name in group.names(ACCEL if group.kind == "accel" else GYRO):
                out[name] = float(rng.normal(0.0, group.usual[setting.grade])) if setting.grade in group.usual else 0.0
    return out


def _of(truth: dict[str, float], group: str, names: str = "x y z") -> Array:
    return np.array([truth[f"{group}.{name}"] for name in names.split()])


def readings_of(way: Way, t: Array, truth: dict[str, float], off: Departure) -> tuple[Array, Array, Array]:
    """What the accelerometers (S, 3) and gyros (S, 3) would read at instants t, without what depends on time, and the
    own specific forces."""
    accel, gyro = (b.model(np.array([truth[n] for n in b.names])) for b in (ACCEL, GYRO))
    force = np.column_stack([_force(way, t - _late(truth, sensor), truth, sensor) for sensor in "xyz"])
    own = force @ accel.matrix.T
    w = (
        own
        + accel.bias
        + (_of(truth, "accel.asymmetry") + off.accel_asymmetry) * np.abs(force)
        + (_of(truth, "accel.quadratic") + off.quadratic) * force**2
        + (_of(truth, "accel.cubic") + off.cubic) * force**3
    )
    L, turning, _, push = way.at(t)
    rate = np.einsum("sji,sj->si", L, turning + np.array(earth_rate(LATITUDE)))
    felt = np.einsum("sji,sj->si", L, push + np.array([0.0, GRAVITY, 0.0]))
    G = np.array([[truth[f"gyro.g_sensitivity.{p}{q}"] for q in "xyz"] for p in "xyz"])
    bent = rate + (_of(truth, "gyro.cubic") + off.nonlinearity / (10.0 * DEGREE) ** 2) * rate**3
    asymmetry = _of(truth, "gyro.asymmetry") + off.gyro_asymmetry
    return w, bent @ gyro.matrix.T + gyro.bias + felt @ G.T + asymmetry * np.abs(rate), force


def _late(truth: dict[str, float], sensor: str) -> float:
    """By how much an accelerometer is late, s."""
    return truth["accel.delay"] + truth.get(f"accel.delay.{sensor}", 0.0)


def _force(way: Way, t: Array, truth: dict[str, float], sensor: str) -> Array:
    """The component (S,) of the specific force that an accelerometer has to read, at its own place."""
    L, turning, changing, push = way.at(t)
    rate = np.einsum("sji,sj->si", L, turning + np.array(earth_rate(LATITUDE)))
    change = np.einsum("sji,sj->si", L, changing)
    force = np.einsum("sji,sj->si", L, push + np.array([0.0, GRAVITY, 0.0]))
    if sensor != "z":
        r = _of(truth, f"accel.lever.{sensor}")
        force += np.cross(change, r) + np.cross(rate, np.cross(rate, r))
    return np.asarray(force[:, "xyz".index(sensor)])


# ---------------------------------------------------------------- a session


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Samples:
    """Mean readings of every interval, and of which rest (≥ 0) or, as −1 − k, turn k it is."""

    accel: Array
    gyro: Array
    own: Array
    part: IntArray


def sampled(setting: Setting, ways: list[Way], truth: dict[str, float], off: Departure) -> Samples:
    """The readings of a session without noise and without what depends on time."""
    dt, columns, parts = 1.0 / setting.rate, [], []
    resting = round(setting.rest * setting.rate)
    for k, way in enumerate(ways):
        still = [np.broadcast_to(x, (resting, 3)) for x in readings_of(way, np.array([-10.0]), truth, off)]
        columns.append(still)
        parts.append(np.full(resting, k))
        if k == len(ways) - 1:
            break
        n = round((way.duration + 2.0 * STILL) * setting.rate)
        middle = (np.arange(n) + 0.5) * dt - STILL
        nodes = (middle[:, None] + NODES * dt).ravel()
        read = readings_of(way, nodes, truth, off)
        columns.append([np.einsum("nkc,k->nc", x.reshape(n, 3, 3), SHARES) for x in read])
        parts.append(np.full(n, -1 - k))
    accel, gyro, own = (np.concatenate(c) for c in zip(*columns, strict=True))
    return Samples(accel=accel, gyro=gyro, own=own, part=np.concatenate(parts))


def departed(setting: Setting, samples: Samples, off: Departure, rng: np.random.Generator) -> Samples:
    """With what depends on time, noise, steps, and lost and held samples."""
    accel, gyro, own, part = samples.accel, samples.gyro, samples.own, samples.part
    passed = np.linspace(-0.5, 0.5, len(part))[:, None]
    accel = accel * (1.0 + off.scale_drift * passed) + off.accel_bias_drift * passed
    gyro = gyro * (1.0 + off.scale_drift * passed) + off.gyro_bias_drift * passed
    if off.hysteresis:
        accel = accel + off.hysteresis * _played(own)
    if off.memory:
        share = 1.0 / (60.0 * setting.rate)
        slow = lfilter([share], [1.0, share - 1.0], own - own[0], axis=0) + own[0]
        accel = accel + off.memory * (slow - own)
    root = np.sqrt(setting.rate)
    accel = accel + setting.accel_noise * root * rng.standard_normal(accel.shape)
    gyro = gyro + setting.gyro_noise * root * rng.standard_normal(gyro.shape)
    if off.resolution:
        step = off.resolution * setting.gyro_noise * root
        gyro = step * np.round(gyro / step)
    if off.held:
        held = np.flatnonzero(rng.random(len(part)) < off.held)
        for i in held[held > 0]:
            accel[i], gyro[i] = accel[i - 1], gyro[i - 1]
    kept = rng.random(len(part)) >= off.lost
    return Samples(accel=accel[kept], gyro=gyro[kept], own=own[kept], part=part[kept])


def _played(own: Array) -> Array:
    """Where in a play of ±PLAY the own forces (S, 3) are, −1 … 1."""
    out = np.empty_like(own)
    for p in range(3):
        middle, column, moving = float(own[0, p]), out[:, p], np.flatnonzero(np.diff(own[:, p], prepend=np.inf))
        values = own[:, p].tolist()
        found = []
        for i in moving.tolist():
            middle = min(max(middle, values[i] - PLAY), values[i] + PLAY)
            found.append((values[i] - middle) / PLAY)
        column[:] = np.repeat(found, np.diff(np.append(moving, len(own))))
    return out


def observed(setting: Setting, samples: Samples) -> Observations:
    """Rests and turns: means, with the noise that the samples show, and the samples of the turns."""
    part, dt = samples.part, 1.0 / setting.rate
    count = int(part.max()) + 1
    time = dt * np.arange(len(part) + 1)
    spans = [np.flatnonzero(part == i) for i in range(count)]
    first, last = np.array([s[0] for s in spans]), np.array([s[-1] + 1 for s in spans])
    rounded = {kind: _rounded(getattr(samples, kind), spans, setting.rate) for kind in ("accel", "gyro")}
    rests = _rests(samples, spans, time[first], time[last], rounded)
    start, stop = last[:-1], first[1:]
    stored = MotionSamples()
    stored.append(samples.gyro, samples.accel, np.full(len(part), dt))
    turn_samples = TurnSamples(samples=stored, start=start, stop=stop)
    nominal = Compensation(
        gyro=BlockCompensation.of(GYRO.axes, GYRO.nominal()),
        accel=BlockCompensation.of(ACCEL.axes, ACCEL.nominal()),
        g_sensitivity=np.zeros((3, 3)),
        delay=0.0,
    )
    moments = integrate(turn_samples.pieces(), count - 1, nominal)
    T = time[stop] - time[start]
    white = [dt * np.mean([values[s].var(axis=0) for s in spans]) for values in (samples.gyro, samples.accel)]
    covariance = white[0] * T[:, None, None] * np.eye(3)
    turns = Turns(
        first=np.arange(count - 1),
        last=np.arange(1, count),
        duration=T,
        C=moments.C,
        M=moments.Phi[..., 1:4],
        B=moments.Phi[..., 0],
        covariance=covariance,
        moment_ratio=np.full(count - 1, WHITE),
        velocity_covariance=white[1] * T[:, None, None] * np.eye(3),
        jumps=moments.jumps,
        aliased=aliased_rotations(turn_samples, covariance),
    )
    return Observations(
        accel_block=ACCEL,
        gyro_block=GYRO,
        site=Site(latitude=LATITUDE, height=200.0, gravity=GRAVITY, gravity_u=0.0),
        rests=rests,
        turns=turns,
        turn_samples=turn_samples,
        programme=None,
        position=None,
        rounding=rounded,
        usual=usual_sizes(setting.grade),
    )


def _rounded(values: Array, spans: list[IntArray], rate: float) -> Rounding:
    """What the resolution of channels does, as the reduction has it from samples some 0.1 s apart."""
    apart = round(0.1 * rate)
    channels = []
    for column in values.T:
        steps = np.abs(np.diff(column))
        channels.append(
            ChannelState(
                samples=len(column),
                minimum=float(column.min()),
                maximum=float(column.max()),
                repeats=int(np.sum(steps == 0.0)),
                run=0,
                run_stop=0.0,
                run_value=0.0,
                step=float(steps[steps > 0.0].min()),
                extreme_run=0,
                extreme_stop=0.0,
            )
        )
    return rounding(values[::apart], [values[s][::apart] for s in spans], channels)


def _rests(
    samples: Samples, spans: list[IntArray], start: Array, stop: Array, rounded: Mapping[str, Rounding]
) -> Rests:
    seconds = stop - start
    read = {}
    for kind in ("accel", "gyro"):
        values = getattr(samples, kind)
        mean = np.array([values[s].mean(axis=0) for s in spans])
        variance = np.mean([values[s].var(axis=0, ddof=1) for s in spans], axis=0)
        covariance = np.array([np.diag(variance / len(s) + rounded[kind].rest_u ** 2) for s in spans])
        read |= {
            kind: mean,
            f"{kind}_covariance": covariance,
            f"{kind}_drift": np.zeros_like(mean),
            f"{kind}_noise": np.sqrt(np.diagonal(covariance, axis1=1, axis2=2) * seconds[:, None]),
        }
    return Rests(file=np.zeros(len(spans), dtype=int), start=start, stop=stop, temperatures=None, **read)


def session(setting: Setting, off: Departure, seed: int) -> tuple[Observations, dict[str, float]]:
    """One session with a departure, and the true parameters."""
    rng = np.random.default_rng([SETTINGS.index(setting), seed])
    truth, ways = truth_of(setting, rng), ways_of(setting, rng)
    return observed(setting, departed(setting, sampled(setting, ways, truth, off), off, rng)), truth


# ---------------------------------------------------------------- what tumble says


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Said:
    """Of one session: normalised errors (21,) of the linear parameters, the outcome, and the causes named."""

    error: Array
    outcome: Outcome
    causes: tuple[str, ...]


def said_of(seed: int, place: int, line: int) -> Said:
    """What is said of one session in a setting, of a line of the table."""
    setting, (departure, size) = SETTINGS[place], LINES[line]
    off = departure.times(size)
    observations, truth = session(setting, off, seed)
    estimate = joint(observations)
    outcome = verdict(estimate, observations)
    found = misfit(estimate) if outcome.verdict == "accepted with scatter" else ()
    count = len(ACCEL.names) + len(GYRO.names)
    true = np.array([truth[name] for name in estimate.names[:count]])
    return Said(
        error=(estimate.values[:count] - true) / estimate.u[:count],
        outcome=outcome,
        causes=causes_of(found),
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class Line:
    """One line of the result: shares of sessions that are accepted, accepted with scatter and refused; of those
    accepted the rms normalised error and the share beyond 3 u; of those with scatter the share with the right cause
    among the first two."""

    accepted: float
    scatter: float
    refused: float
    rms: float
    beyond: float
    right: float

    @staticmethod
    def of(sessions: list[Said], off: Departure) -> Line:
        """The line of some sessions."""
        by = {v: [s for s in sessions if s.outcome.verdict == v] for v in VERDICTS}
        errors = np.array([s.error for s in by["accepted"]]).ravel()
        with_scatter = by["accepted with scatter"]
        right = [any(cause in off.causes for cause in s.causes[:2]) for s in with_scatter if off.causes]
        return Line(
            accepted=len(by["accepted"]) / len(sessions),
            scatter=len(with_scatter) / len(sessions),
            refused=len(by["not accepted"]) / len(sessions),
            rms=float(np.sqrt(np.mean(errors**2))) if len(errors) else 0.0,
            beyond=float(np.mean(np.abs(errors) > 3.0)) if len(errors) else 0.0,
            right=float(np.mean(right)) if right else 1.0,
        )

    @property
    def good(self) -> bool:
        """Whether nothing wrong is accepted without a word, and what is with scatter has its cause named."""
        silent = self.rms <= MOST_RMS and self.beyond <= MOST_BEYOND
        return silent and self.right >= MOSTLY


VERDICTS = ("accepted", "accepted with scatter", "not accepted")
MOST_RMS, MOST_BEYOND, MOSTLY = 1.25, 0.02, 0.8
LINES = [(CLEAN, 1.0), *((off, size) for off in DEPARTURES for size in (1.0, 3.0))]
"""Departures and how many times their size, of the table."""
HEAD = ["departure", "setting", "N", "accepted, with scatter, refused", "rms", "beyond 3 u", "cause named"]


def main(arguments: list[str]) -> int:
    """Print the table and the answer. Arguments: sessions a line (default 40) and --store, or --short."""
    short = "--short" in arguments
    counts = [int(each) for each in arguments if each.isdigit()]
    count, rows, bad = 1 if short else counts[0] if counts else 40, [HEAD], list[str]()
    with ProcessPoolExecutor() as pool:
        for i, (departure, size) in enumerate(LINES):
            if short and departure is not CLEAN and size == 1.0:
                continue
            for place, setting in enumerate(SETTINGS[:1] if short else SETTINGS):
                many = count if departure is not CLEAN else 5 * count
                sessions = list(pool.map(partial(said_of, place=place, line=i), range(many)))
                line = Line.of(sessions, departure)
                name = departure.name if size == 1.0 else f"{departure.name}, × {size:.0f}"
                shares = f"{line.accepted:.0%}, {line.scatter:.0%}, {line.refused:.0%}"
                judged = [f"{line.rms:.2f}", f"{line.beyond:.1%}"] if line.accepted else ["", ""]
                right = f"{line.right:.0%}" if line.scatter and departure.causes else ""
                rows.append([name, setting.name, str(many), shares, *judged, right])
                print(*rows[-1], "" if line.good else "!", sep=" | ", flush=True)
                if not line.good:
                    bad.append(f"{name} ({setting.name})")
    print(shown(rows))
    if "--store" in arguments:
        store("departures", {"verdicts": rows}, seed="from 0", N=str(count))
    print(f"Is anything wrong accepted without a word? {'; '.join(bad) or 'Only what no turn of the session shows.'}")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
