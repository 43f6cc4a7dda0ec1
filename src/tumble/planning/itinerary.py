"""Planned and simulated recordings: attitudes, moves and times, and readings of perfect sensors in motion.

A turn is at a constant rate about an axis fixed in inertial space. With its rotation vector v in the body at its start,
its duration of T s, the attitude L₀ at its start and the Earth's rate Ω,

    ω = v/T,   C(t) = exp([ω×]t),   f(t) = g C(t)ᵀ L₀ᵀ exp([Ω×]t) e_U

A recording without rests is of a device on a pivot or in the hand (`Motion`). It turns at RATE about an axis that
changes within AXIS_TIME, and is displaced as usual there. The rows are those of the links from node to node
(`tumble.reduction.turns.links`). Expected uncertainties are means over COURSES random motions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Literal

import numpy as np
import scipy

from tumble.earth import earth_rate
from tumble.errors import InputError
from tumble.planning.setup import ACCEL, Setup
from tumble.recording.session import Site
from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.reduction.noise.coloured_noise import WHITE
from tumble.reduction.observations import Observations, without_rests
from tumble.reduction.turns.links import NODE_SECONDS, PARTS, Links
from tumble.reduction.turns.turns import AHEAD, Turns, TurnSamples
from tumble.rotation import rotation_matrix, rotation_vector, rotation_vector_near
from tumble.sensors.model import Block
from tumble.units import DEGREE, Array, BoolArray, IntArray, quantity

SAMPLES = 256  # of a turn, which give its moments to 1e-5
STILL = 8  # samples of the time without motion before and after a turn, each
Held = Literal["pivot", "hand"]
DISPLACEMENTS = {"pivot": (1e-3, 0.1), "hand": (0.1, 0.1)}
"""m and s: root mean square displacement on a pivot (tripod head, ball joint) and in the hand, and its correlation
time."""
RATE, AXIS_TIME = 60.0 * DEGREE, 4.0  # rad/s, and s about one axis
MOTION_SAMPLES = 20  # from node to node: a multiple of PARTS, which gives sensitivities to 1e-3
COURSES = 3  # random motions that are averaged
LONGEST = 3600.0  # s: of a planned motion


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Itinerary:
    """Rests in order, and the moves between them."""

    attitudes: Array  # (N, 3, 3), body → geographic
    rests: Array  # (N, 2): start and stop, s
    moves: Array  # (N − 1, 3): rotation vectors, geographic, rad
    turned: BoolArray  # (N − 1,): whether a move is a turn of the log
    still: Array  # (N − 1,): time without motion at both ends of a turn, s
    positions: tuple[int, ...] = ()  # of the rests in a programme

    @staticmethod
    def through(attitudes: Array, moves: Array, setup: Setup) -> Itinerary:
        """Return the itinerary through attitudes by moves, with the rests and the rate of a set-up; a zero move is no
        turn."""
        seconds = np.linalg.norm(moves, axis=1) / setup.turn_rate
        start = setup.rest * np.arange(len(attitudes)) + np.append(0.0, np.cumsum(seconds))
        return Itinerary(
            attitudes=attitudes,
            rests=np.column_stack([start, start + setup.rest]),
            moves=moves,
            turned=seconds > 0.0,
            still=np.zeros(len(moves)),
        )

    @property
    def first(self) -> IntArray:
        """The rests (K,) before the turns of the log."""
        return np.flatnonzero(self.turned)

    @property
    def seconds(self) -> Array:
        """Duration of the motion of the turns (K,), s."""
        k = self.first
        return np.asarray(self.rests[k + 1, 0] - self.rests[k, 1] - 2.0 * self.still[k])

    @property
    def middle(self) -> float:
        """Mean time of the rests, s, from the start of the session."""
        return float(self.rests.mean())

    def as_logged(self, ramp: float, margin: float) -> Itinerary:
        """Return the itinerary as found in a log, where turns have ramps, s, and the segmentation adds a margin, s, at
        both ends of every rest to the turns."""
        later = np.append(0.0, ramp * np.cumsum(self.turned))
        return Itinerary(
            attitudes=self.attitudes,
            rests=self.rests + later[:, None] + [margin, -margin],
            moves=self.moves,
            turned=self.turned,
            still=np.where(self.turned, self.still + 0.5 * ramp + margin, 0.0),
            positions=self.positions,
        )


def itinerary_of(setup: Setup) -> Itinerary:
    """Return the itinerary of a set-up's programme in the order listed, with the shortest move where any is allowed."""
    attitudes = np.array([position.matrix for position in setup.programme.positions])
    shortest = rotation_vector(attitudes[1:] @ np.swapaxes(attitudes[:-1], 1, 2))
    moves = [
        by_shortest if move.axis is None or move.angle is None else move.angle * move.axis
        for move, by_shortest in zip(setup.programme.moves, shortest, strict=True)
    ]
    return Itinerary.through(attitudes, np.array(moves).reshape(-1, 3), setup)


# Turns at a constant rate


def inertial_turns(start: Array, end: Array, moves: Array, seconds: Array, latitude: float) -> Array:
    """Return the rotation vectors (K, 3), rad, of the body in inertial space, in the body at the start.

    Turns are from attitudes `start` to `end` (K, 3, 3), body → geographic, in `seconds` (K,), the way round that is
    closer to the moves (K, 3), geographic rotation vectors."""
    back = np.swapaxes(start, 1, 2)
    earth = rotation_matrix(seconds[:, None] * np.array(earth_rate(latitude)))
    return rotation_vector_near(back @ earth @ end, np.einsum("kij,kj->ki", back, moves))


def white_turns(first: IntArray, T: Array, covariance: Array, velocity_variance: Array) -> Turns:
    """Return turns, not yet integrated, after the rests `first` (K,) in T (K,) s, with the covariance of the rotations
    (K, 3, 3), rad², and the variance of the velocities (K,), (m/s)², by white noise."""
    K = len(T)
    return Turns(
        first=first,
        last=first + 1,
        duration=T,
        C=np.broadcast_to(np.eye(3), (K, 3, 3)),
        M=np.zeros((K, 3, 3, 3)),
        B=np.zeros((K, 3, 3)),
        covariance=covariance,
        moment_ratio=np.full(K, WHITE),
        velocity_covariance=velocity_variance[:, None, None] * np.eye(3),
        jumps=np.zeros(K),
        aliased=np.zeros(K),
    )


def steady_samples(vector: Array, T: Array, start: Array, setup: Setup, still: Array) -> TurnSamples:
    """Return samples of turns at a constant rate by perfect sensors.

    Parameters
    ----------
    vector : (K, 3)
        Rotation vectors in inertial space, in the body at the start, rad.
    T : (K,)
        Durations of the motion, s.
    start : (K, 3, 3)
        Attitudes at the start, body → geographic.
    setup
        Set-up with latitude and gravity.
    still : (K,)
        Time without motion before and after each turn, s.
    """
    K, at_ends = len(T), STILL if still.any() else 0
    ends = np.repeat(still[:, None] / max(at_ends, 1), at_ends, axis=1)
    dt = np.concatenate([ends, np.repeat(T[:, None] / SAMPLES, SAMPLES, axis=1), ends], axis=1)
    when = np.cumsum(dt, axis=1) - 0.5 * dt
    part = (when - still[:, None]) / T[:, None]
    moving = (part > 0.0) & (part < 1.0)
    rate = moving[:, :, None] * (vector / T[:, None])[:, None]
    C = rotation_matrix(np.clip(part, 0.0, 1.0)[:, :, None] * vector[:, None])
    up = rotation_matrix(when[:, :, None] * np.array(earth_rate(setup.latitude)))[..., 1] @ start
    force = setup.gravity * np.einsum("knij,kni->knj", C, up)
    samples, before = MotionSamples(), ((0, 0), (AHEAD, 0))  # the first step of a turn needs samples before it
    rate, force = (np.pad(each, (*before, (0, 0)), mode="edge") for each in (rate, force))
    samples.append(rate.reshape(-1, 3), force.reshape(-1, 3), np.pad(dt, before, mode="edge").ravel())
    first = AHEAD + rate.shape[1] * np.arange(K)
    return TurnSamples(samples=samples, start=first, stop=first + rate.shape[1] - AHEAD)


# Motion without rests


@dataclass(frozen=True, kw_only=True, slots=True)
class Motion:
    """A recording of a device that is turned without rests."""

    held: Held
    seconds: float
    course: int = 0  # number of the random motion

    def __post_init__(self) -> None:
        if not 2.0 * AXIS_TIME <= self.seconds <= LONGEST:
            raise InputError(
                f"{self.held}: expected from {2.0 * AXIS_TIME:g} s to {LONGEST:g} s of motion, found {self.seconds:g}"
            )

    @property
    def courses(self) -> list[Motion]:
        """The random motions whose results are averaged."""
        return [replace(self, course=course) for course in range(COURSES)]

    @property
    def displacement(self) -> tuple[float, float]:
        """Displacement along an axis, m, and its correlation time, s."""
        distance, time = DISPLACEMENTS[self.held]
        return distance / math.sqrt(3.0), time

    @property
    def assumption(self) -> str:
        """The assumed motion, in a sentence."""
        distance = 1e3 * DISPLACEMENTS[self.held][0]
        how = "on a pivot it trembles by" if self.held == "pivot" else "in the hand it stays within"
        return (
            f"the device is turned through all attitudes at {RATE / DEGREE:.0f} °/s; {how} {distance:g} mm (root mean "
            "square): less is better, and rests in between too"
        )


def motion_of(pivot: str | None, hand: str | None) -> Motion | None:
    """Return the motion of a duration such as "120s" or "2min"; None without any. Raises InputError."""
    if pivot is not None and hand is not None:
        raise InputError("--pivot, --hand: expected one of them, found both")
    held: Held = "hand" if pivot is None else "pivot"
    text = hand if pivot is None else pivot
    if text is None:
        return None
    try:
        return Motion(held=held, seconds=quantity(text, {"s": 1.0, "min": 60.0, "": 1.0}))
    except ValueError as error:
        raise InputError(f"--{held}: {error}") from None


def observed_in_motion(motion: Motion, setup: Setup, gyro: Block) -> tuple[Observations, Array]:
    """Return the observations of a motion by perfect sensors with the white noise of a set-up, and the attitudes
    (M, 3, 3) of its nodes."""
    rng, links = np.random.default_rng(motion.course), round(motion.seconds / NODE_SECONDS)
    count, interval = MOTION_SAMPLES * links, NODE_SECONDS / MOTION_SAMPLES
    knots = math.ceil(motion.seconds / AXIS_TIME) + 3
    middle = interval * (np.arange(count) + 0.5)
    axis = scipy.interpolate.CubicSpline(AXIS_TIME * np.arange(knots), rng.standard_normal((knots, 3)))(middle)
    rates = RATE * axis / np.linalg.norm(axis, axis=1, keepdims=True)
    first = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    first *= np.sign(np.linalg.det(first))
    attitudes = np.array(list(accumulate(rotation_matrix(interval * rates), np.matmul, initial=first)))
    forces = setup.gravity * (attitudes[:-1] @ rotation_matrix(0.5 * interval * rates))[:, 1]
    samples = MotionSamples()
    samples.append(rates, forces, np.full(count, interval))
    starts = MOTION_SAMPLES // PARTS * np.arange(PARTS * links)
    ends = np.minimum(np.stack([starts, starts + MOTION_SAMPLES // PARTS], axis=1), count - 1)
    links_in_motion = Links(
        file=np.zeros(links + 1, dtype=np.int64),
        time=np.asarray(NODE_SECONDS * np.arange(links + 1)),
        rest=np.zeros(0, dtype=np.int64),
        before=np.arange(links),
        free=np.ones(links, dtype=bool),
        duration=np.full(links, NODE_SECONDS),
        samples=TurnSamples(samples=samples, start=starts, stop=starts + MOTION_SAMPLES // PARTS),
        rates=rates[ends],
        forces=forces[ends],
        gyro_density=setup.noise.gyro_white**2,
        accel_density=setup.noise.accel_white**2,
    )
    site = Site(latitude=setup.latitude, height=0.0, gravity=setup.gravity, gravity_u=setup.gravity_u)
    return without_rests(links_in_motion, ACCEL, gyro, site), attitudes[::MOTION_SAMPLES]
