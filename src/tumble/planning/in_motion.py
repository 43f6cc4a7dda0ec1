"""The likelihood of a recording without rests, before it is made: a device that is turned on a pivot or in the hand.

It turns at RATE about an axis that wanders within AXIS_TIME, and stays where it is held to within a displacement that
is usual of a pivot or of a hand. Its rows are those of the links from node to node (`tumble.reduction.turns.links`).
What is expected is the mean over COURSES of such motion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import Literal

import numpy as np
import scipy

from tumble.errors import InputError
from tumble.planning.setup import ACCEL, Setup
from tumble.recording.session import Site
from tumble.reduction.blocks.motion_samples import MotionSamples
from tumble.reduction.observations import Observations, without_rests
from tumble.reduction.turns.links import NODE_SECONDS, PARTS, Links
from tumble.reduction.turns.turns import TurnSamples
from tumble.rotation import rotation_matrix
from tumble.sensors.model import Block
from tumble.units import DEGREE, Array, quantity

Held = Literal["pivot", "hand"]
DISPLACEMENTS = {"pivot": (1e-3, 0.1), "hand": (0.1, 0.1)}
"""m and s: how far a device on a pivot (tripod head, ball joint) and in the hand is from where it is held, root mean
square, and for how long."""
RATE, AXIS_TIME = 60.0 * DEGREE, 4.0
"""rad/s and s: at what rate it is turned, and for how long about one axis."""
SAMPLES = 20
"""Samples from node to node: a multiple of PARTS, which gives sensitivities to 1e-3."""
COURSES = 3
"""Motions of which the mean is taken."""
LONGEST = 3600.0
"""s: of a motion that is planned."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Motion:
    """A recording of so many `seconds` of a device that is turned without rests on a pivot, or in the hand, along one
    of the courses that it may take, by its number."""

    held: Held
    seconds: float
    course: int = 0

    def __post_init__(self) -> None:
        if not 2.0 * AXIS_TIME <= self.seconds <= LONGEST:
            raise InputError(
                f"{self.held}: expected from {2.0 * AXIS_TIME:g} s to {LONGEST:g} s of motion, found {self.seconds:g}"
            )

    @property
    def courses(self) -> list[Motion]:
        """The courses over which is averaged."""
        return [replace(self, course=course) for course in range(COURSES)]

    @property
    def displacement(self) -> tuple[float, float]:
        """Size of the displacement an axis, m, and its correlation time, s."""
        distance, time = DISPLACEMENTS[self.held]
        return distance / math.sqrt(3.0), time

    @property
    def assumption(self) -> str:
        """How the plan takes the device to be turned, in a sentence."""
        distance = 1e3 * DISPLACEMENTS[self.held][0]
        how = "on a pivot it trembles by" if self.held == "pivot" else "in the hand it stays within"
        return (
            f"the device is turned through all attitudes at {RATE / DEGREE:.0f} °/s; {how} {distance:g} mm (root mean "
            "square): less is better, and rests in between too"
        )


def motion_of(pivot: str | None, hand: str | None) -> Motion | None:
    """The motion of a text such as "120s" or "2min" for one of both; None without any. Raises InputError."""
    given: dict[Held, str] = {}
    if pivot is not None:
        given["pivot"] = pivot
    if hand is not None:
        given["hand"] = hand
    if len(given) > 1:
        raise InputError("--pivot, --hand: expected one of them, found both")
    for held, text in given.items():
        try:
            return Motion(held=held, seconds=quantity(text, {"s": 1.0, "min": 60.0, "": 1.0}))
        except ValueError as error:
            raise InputError(f"--{held}: {error}") from None
    return None


def observed_in_motion(motion: Motion, setup: Setup, gyro: Block) -> tuple[Observations, Array]:
    """Observations of a motion as perfect sensors make them, with the white noise of a set-up, and the attitudes
    (M, 3, 3) of its nodes."""
    rng, links = np.random.default_rng(motion.course), round(motion.seconds / NODE_SECONDS)
    count, interval = SAMPLES * links, NODE_SECONDS / SAMPLES
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
    starts = SAMPLES // PARTS * np.arange(PARTS * links)
    ends = np.minimum(np.stack([starts, starts + SAMPLES // PARTS], axis=1), count - 1)
    moved = Links(
        file=np.zeros(links + 1, dtype=np.int64),
        time=np.asarray(NODE_SECONDS * np.arange(links + 1)),
        rest=np.zeros(0, dtype=np.int64),
        before=np.arange(links),
        free=np.ones(links, dtype=bool),
        duration=np.full(links, NODE_SECONDS),
        samples=TurnSamples(samples=samples, start=starts, stop=starts + SAMPLES // PARTS),
        rates=rates[ends],
        forces=forces[ends],
        gyro_density=setup.noise.gyro_white**2,
        accel_density=setup.noise.accel_white**2,
    )
    site = Site(latitude=setup.latitude, height=0.0, gravity=setup.gravity, gravity_u=setup.gravity_u)
    return without_rests(moved, ACCEL, gyro, site), attitudes[::SAMPLES]
