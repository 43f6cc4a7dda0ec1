"""The best a programme allows: the Cramér–Rao bound of the joint likelihood, before anything is measured.

The rows are those of `tumble.estimation.likelihood`, taken at perfect sensors and at the attitudes of the programme,
which are eliminated: so the bound is the covariance that `joint` would state for an exact programme. What a log has
of it: the rests, with white noise and in-run instability in their covariances (the instability of the gyros lasts
through the turn that follows), and the moves between them, all of which the gyros record. A move goes about one axis
at a constant rate; the body turns about a fixed axis in inertial space, so that with v the rotation vector of the
turn in the body at its start, the Earth's rotation included, and T its duration,

    C = exp([v×]),   B = ∫ C dt = T J_l(v),   M = ∫ C ⊗ ω dt = J_l(v) ⊗ v

with J_l the left Jacobian of the rotation group. Errors of table and mounting are not in the bound: the attitudes are
unknowns, and where they are a degree or two off it changes by parts of a thousand.

How well the parameters are seen together is judged in natural units, biases as parts of gravity and of the rate of the
turns, scale-factor errors as they are, angles in rad: `condition` is that of the whitened Jacobian, `worst` the
combination of unit length that is determined worst. For accelerometers alone that is the matrix H of Eq. (13).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tumble.errors import InputError
from tumble.estimation.elimination import eliminate
from tumble.estimation.estimate import least_squares
from tumble.estimation.likelihood import Point, Problem, Scatter, TurnsAbout, Weights, left_jacobian, linearise, weights
from tumble.planning.inertial_turns import inertial_turns
from tumble.planning.setup import Setup, check_setup
from tumble.recording.session import Site
from tumble.reduction.observations import ACCEL_FLOOR, GYRO_FLOOR, TURN_FLOOR, Observations, Rests, Turns
from tumble.rotation import rotation_matrix, rotation_vector
from tumble.sensors.model import Block
from tumble.units import Array, BoolArray, IntArray

ACCEL, GYRO = (Block(kind=kind, axes=np.eye(3)) for kind in ("accel", "gyro"))
"""The triads of a set-up."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Course:
    """Where a device rests and how it gets there: attitudes (N, 3, 3), body → geographic, of the rests in order, and
    the turns that a log has between a rest `first` (K,) and the next: rotation vectors `moves` (K, 3), geographic, rad,
    and `seconds` (K,)."""

    attitudes: Array
    first: IntArray
    moves: Array
    seconds: Array


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Bound:
    """Least possible covariance (m, m) of the parameters, SI, in the order of `names`. `observable` marks the
    parameters that are determined, and only these mean anything; `null` (q, m) are the combinations that are not,
    `worst` (m,) the unit combination determined worst and `worst_u` how well, both in natural units, whose sizes in SI
    are `natural` (m,). `condition` is infinite where a combination is not determined."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    covariance: Array
    observable: BoolArray
    natural: Array
    null: Array
    condition: float
    worst: Array
    worst_u: float

    @property
    def u(self) -> Array:
        """Least standard uncertainties (m,), SI; infinite where a parameter is not determined."""
        return np.where(self.observable, np.sqrt(np.diag(self.covariance)), np.inf)

    @property
    def rank(self) -> int:
        """How many combinations of the parameters are determined."""
        return len(self.names) - len(self.null)

    def rms(self, group: str) -> float:
        """Root mean square of the u of a group such as "accel.bias", SI; infinite where one of it is not determined.
        Raises KeyError for a group that is not there."""
        members = [name.startswith(f"{group}.") for name in self.names]
        if not any(members):
            raise KeyError(group)
        return float(np.sqrt(np.mean(self.u[members] ** 2)))

    @property
    def groups(self) -> tuple[str, ...]:
        """The kinds of parameters there are, in order."""
        return tuple(dict.fromkeys(name.rpartition(".")[0] for name in self.names))


def bound(setup: Setup, *, gyros: bool = True) -> Bound:
    """The bound of a set-up's programme, with gyros and all moves, or of accelerometers alone.

    Raises InputError for values that make no sense, and where there is no noise.

    >>> import tumble
    >>> setup = tumble.Setup.of(rest=120.0)
    >>> found = tumble.bound(setup)
    >>> found.rank == len(found.names)
    True
    """
    return bound_of(course_of(setup), setup, gyros=gyros)


def bound_of(course: Course, setup: Setup, *, gyros: bool = True) -> Bound:
    """The bound of a course; of the set-up, all but programme, table and mounting counts. Raises InputError."""
    seen = view(course, setup, gyros=gyros)
    solution = least_squares(seen.information(), np.zeros(len(seen.problem.spread)), seen.problem.spread)
    blocks = blocks_of(gyros)
    units = tuple(unit for block in blocks for unit in block.units)
    natural = _natural_units(setup, units)
    size, direction = np.linalg.eigh(solution.covariance / np.outer(natural, natural))
    null = solution.null * seen.problem.spread / natural
    null /= np.linalg.norm(null, axis=1, keepdims=True)
    worst = null[0] if len(null) else direction[:, -1]
    return Bound(
        names=tuple(name for block in blocks for name in block.names),
        units=units,
        covariance=solution.covariance,
        observable=solution.observable,
        natural=natural,
        null=null,
        condition=np.inf if len(null) else float(np.sqrt(size[-1] / size[0])),
        worst=worst * np.sign(worst[np.argmax(np.abs(worst))]),
        worst_u=np.inf if len(null) else float(np.sqrt(size[-1])),
    )


def blocks_of(gyros: bool) -> tuple[Block, ...]:
    """The triads that are calibrated: accelerometers, with gyros or alone."""
    return (ACCEL, GYRO) if gyros else (ACCEL,)


def _natural_units(setup: Setup, units: Sequence[str]) -> Array:
    """Sizes (m,) in SI of the units in which parameters are compared: gravity, the rate of the turns, 1, 1 rad."""
    sizes = {"m/s^2": setup.gravity, "rad/s": setup.turn_rate, "1": 1.0, "rad": 1.0}
    return np.array([sizes[unit] for unit in units])


# The course of a programme


def course_of(setup: Setup) -> Course:
    """The positions of a set-up's programme in the order listed, with the programme's turns and, where any move will
    do, the shortest, all at the rate of the set-up."""
    attitudes = np.array([position.matrix for position in setup.programme.positions])
    shortest = rotation_vector(attitudes[1:] @ np.swapaxes(attitudes[:-1], 1, 2))
    moves = np.array(
        [
            way if move.axis is None or move.angle is None else move.angle * move.axis
            for move, way in zip(setup.programme.moves, shortest, strict=True)
        ]
    ).reshape(-1, 3)
    return course_through(attitudes, moves, setup)


def course_through(attitudes: Array, moves: Array, setup: Setup) -> Course:
    """The course through attitudes (N, 3, 3) by rotation vectors (N − 1, 3) at the rate of a set-up; where nothing
    moves the log has no turn."""
    seconds = np.linalg.norm(moves, axis=1) / setup.turn_rate
    first = np.flatnonzero(seconds > 0.0)
    return Course(attitudes=attitudes, first=first, moves=moves[first], seconds=seconds[first])


# What the likelihood sees of it


@dataclass(frozen=True, kw_only=True, slots=True)
class View:
    """A course as the likelihood sees it: problem, point, turns and weights."""

    problem: Problem
    point: Point
    about: TurnsAbout | None
    weights: Weights

    def information(self) -> Array:
        """A square root (m, m), a triangle, of what the course says of the parameters."""
        rest, turn = self.whitened()
        p, gravity_u = rest.shape[2] - 4, self.problem.observations.site.gravity_u
        triangle, factor = np.zeros((p + 1, p + 1)), np.empty((len(rest), 3, 7 + p))
        triangle[0, 0] = 1.0 / gravity_u if gravity_u > 0.0 else 0.0
        eliminate(rest, turn, self.problem.link, factor, triangle)
        return triangle[1:-1, 1:-1]

    def whitened(self) -> tuple[Array, Array]:
        """The whitened rows of the rests (N, r, 3 + p + 1) and turns (K, t, 6 + p + 1), see
        `tumble.estimation.elimination`."""
        rows = linearise(self.problem, self.point, self.about)
        return self.weights.rest @ rows.rest, self.weights.turn @ rows.turn


def view(course: Course, setup: Setup, *, gyros: bool) -> View:
    """The rows' ingredients at perfect sensors and the attitudes of the course. Raises InputError."""
    _check(setup, gyros)
    turns = _turns(course, setup) if gyros and len(course.first) else None
    observations = Observations(
        accel_block=ACCEL,
        gyro_block=GYRO if gyros else None,
        site=Site(latitude=setup.latitude, height=0.0, gravity=setup.gravity, gravity_u=setup.gravity_u),
        rests=_rests(course, setup, gyros),
        turns=turns,
        turn_samples=None,
        programme=None,
        position=None,
    )
    problem = Problem.of(observations)
    point = Point(values=np.zeros(len(problem.spread)), gravity=setup.gravity, attitudes=course.attitudes)
    scatter = Scatter(accel=setup.noise.accel_instability, gyro=setup.noise.gyro_instability)
    return View(
        problem=problem,
        point=point,
        about=None if turns is None else TurnsAbout(turns=turns, model=GYRO.nominal(), to_rate=np.eye(3)),
        weights=weights(problem, scatter),
    )


def _check(setup: Setup, gyros: bool) -> None:
    """Raise InputError for values that make no sense, and where there is no noise."""
    check_setup(setup, 1)
    noise = setup.noise
    levels = {"accelerometers": noise.accel_white + noise.accel_instability}
    levels |= {"gyros": noise.gyro_white} if gyros else {}
    for sensors, level in levels.items():
        if level == 0.0:
            raise InputError(f"noise: expected {sensors} with noise, found none; without it there is no bound")


def _rests(course: Course, setup: Setup, gyros: bool) -> Rests:
    """Rests with the covariances of white noise, whose readings do not matter."""
    N, noise = len(course.attitudes), setup.noise
    accel = noise.accel_white**2 / setup.rest + ACCEL_FLOOR**2
    gyro = noise.gyro_white**2 / setup.rest + GYRO_FLOOR**2
    n = 3 if gyros else 0
    none = np.zeros(N)
    return Rests(
        file=np.zeros(N, dtype=np.int64),
        start=none,
        stop=none + setup.rest,
        accel=np.zeros((N, 3)),
        accel_covariance=np.broadcast_to(accel * np.eye(3), (N, 3, 3)),
        accel_drift=np.zeros((N, 3)),
        accel_noise=np.full((N, 3), noise.accel_white),
        gyro=np.zeros((N, n)),
        gyro_covariance=np.broadcast_to(gyro * np.eye(n), (N, n, n)),
        gyro_drift=np.zeros((N, n)),
        gyro_noise=np.full((N, n), noise.gyro_white),
        temperature=None,
    )


def _turns(course: Course, setup: Setup) -> Turns:
    """The turns as they are integrated with perfect gyros."""
    T, start, end = course.seconds, course.attitudes[course.first], course.attitudes[course.first + 1]
    v = inertial_turns(start, end, course.moves, T, setup.latitude)
    path = left_jacobian(v)
    variance = setup.noise.gyro_white**2 * T + TURN_FLOOR**2
    return Turns(
        first=course.first,
        last=course.first + 1,
        duration=T,
        C=rotation_matrix(v),
        M=np.einsum("kip,kq->kipq", path, v),
        B=T[:, None, None] * path,
        covariance=variance[:, None, None] * np.eye(3),
    )
