"""Observations of a planned recording without rests, of a device that is turned on a pivot or in the hand.

It turns at RATE about an axis that changes within AXIS_TIME, and is displaced as usual on a pivot or in the hand. The
rows are those of the links from node to node (`tumble.reduction.turns.links`). Expected uncertainties are means over
COURSES random motions.
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
"""m and s: root mean square displacement on a pivot (tripod head, ball joint) and in the hand, and its correlation
time."""
RATE, AXIS_TIME = 60.0 * DEGREE, 4.0  # rad/s, and s about one axis
SAMPLES = 20  # from node to node: a multiple of PARTS, which gives sensitivities to 1e-3
COURSES = 3  # random motions that are averaged
LONGEST = 3600.0  # s: of a planned motion


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
    links_in_motion = Links(
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
    return without_rests(links_in_motion, ACCEL, gyro, site), attitudes[::SAMPLES]
