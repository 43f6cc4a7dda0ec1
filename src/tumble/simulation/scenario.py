"""Scenarios: an IMU with given errors goes through a programme, or through a hand. `scenario_of` draws one from a
set-up.

Every move is a rotation about an axis fixed in the geographic frame, with the smooth angle θ(t) of `Profile`;
between moves the table stands still.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal

import numpy as np

from tumble.errors import InputError
from tumble.planning.itinerary import Itinerary
from tumble.planning.setup import ACCEL, GYRO, Setup
from tumble.programme.positions import ANY_MOVE, Move, Programme
from tumble.recording.session import Site
from tumble.rotation import UP, rotation_matrix, rotation_vector, rotation_vector_near
from tumble.sensors.grades import Grade, NoiseModel, spread_of
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import Block
from tumble.sensors.parameters import Variable, group_name
from tumble.simulation.temperature_profile import Climate
from tumble.units import DEGREE, Array

_MAX_CYCLES_PER_SAMPLE = 10.0


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

    def rates(self, t: Array, total: float) -> tuple[Array, Array]:
        """Rate, rad/s, and angular acceleration, rad/s², at times t, s: the derivatives of `angle`."""
        T = self.duration(total)
        moving, late = (t > 0.0) & (t < T), t > 0.5 * T
        into = np.clip(np.where(late, T - t, t), 0.0, self.ramp)
        full, phase = total / (T - self.ramp), np.pi * into / self.ramp
        change = 0.5 * np.pi / self.ramp * full * np.sin(phase) * np.where(late, -1.0, 1.0)
        return np.where(moving, 0.5 * full * (1.0 - np.cos(phase)), 0.0), np.where(moving, change, 0.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class Vibration:
    """A vertical vibration throughout the log: amplitude of the specific force, m/s², and frequency, Hz."""

    amplitude: float = 0.0
    frequency: float = 0.0


NO_VIBRATION = Vibration()


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
    blocks, and of the groups beyond the linear model that the instrument has; it goes into truth.json. `usual` are the
    standard deviations of such groups over instruments like this one. The site has a latitude. With a `climate` a
    recording has temperatures, and parameters that change with them do."""

    course: OnTable | HandHeld
    accel: Block
    gyro: Block
    truth: Mapping[str, float]
    noise: NoiseModel
    profile: Profile
    site: Site
    vibration: Vibration
    serial: str
    usual: Mapping[str, float] = field(default_factory=dict, hash=False)
    climate: Climate | None = None

    @property
    def latitude(self) -> float:
        """Latitude of the site, rad."""
        if self.site.latitude is None:
            raise InputError("site: expected a latitude, found none")
        return self.site.latitude

    @property
    def instrument(self) -> Instrument:
        """The instrument whose true values are given."""
        variables: tuple[Variable, ...] = ("time",)
        if self.climate is not None:
            variables = ("time", "temperature", "temperature²", "hysteresis")
        return Instrument.of(self.accel, self.gyro, tuple({group_name(name) for name in self.truth}), variables)

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters of the instrument."""
        return self.instrument.names

    @property
    def values(self) -> Array:
        """True values (m,) of the parameters, in the order of `names`."""
        return np.array([self.truth[name] for name in self.names])


def scenario_of(
    setup: Setup, rng: np.random.Generator, *, serial: str = "simulated", vibration: Vibration = NO_VIBRATION
) -> Scenario:
    """A scenario of a set-up: a triad of each kind along the body axes, with errors drawn from its spreads."""
    course: OnTable | HandHeld = OnTable(
        programme=setup.programme, table_error=setup.table_error, mounting_error=setup.mounting_error
    )
    linear = draw_parameters(setup, (ACCEL, GYRO), rng)
    return Scenario(
        course=course if setup.by_hand is None else HandHeld(positions=setup.by_hand),
        accel=ACCEL,
        gyro=GYRO,
        truth=linear | draw_further(setup.further, ACCEL, GYRO, rng),
        noise=setup.noise,
        profile=profile_of(setup),
        site=Site(latitude=setup.latitude, height=setup.height, gravity=setup.gravity, gravity_u=setup.gravity_u),
        vibration=vibration,
        serial=serial,
        usual=setup.further,
    )


def profile_of(setup: Setup) -> Profile:
    """The times of a set-up."""
    return Profile(
        first_rest=max(setup.rest, setup.first_rest),
        rest=setup.rest,
        rate=setup.turn_rate,
        ramp=setup.ramp,
        sample_rate=setup.sample_rate,
    )


def draw_parameters(instrument: Setup | Grade, blocks: Sequence[Block], rng: np.random.Generator) -> dict[str, float]:
    """True values by parameter name of blocks, Gaussian with the spreads of a set-up or a grade."""
    names = [name for block in blocks for name in block.names]
    return {name: spread_of(instrument, name) * float(rng.standard_normal()) for name in names}


def draw_further(spreads: Mapping[str, float], accel: Block, gyro: Block, rng: np.random.Generator) -> dict[str, float]:
    """True values by parameter name of groups beyond the linear model, Gaussian with these standard deviations, SI."""
    instrument = Instrument.of(accel, gyro, tuple(spreads))
    return {
        name: float(spreads[group.name] * rng.standard_normal())
        for group in instrument.further
        for name in group.names(instrument.block(group))
    }


def itinerary(scenario: Scenario, rng: np.random.Generator) -> Itinerary:
    """Attitudes, moves and times of a scenario; of the two ways round, a move goes the one nearer to the nominal move,
    or the shorter one if any movement will do. Raises InputError, one line, if the scenario is impossible."""
    _check(scenario)
    profile = scenario.profile
    positions, attitudes, nominal = _attitudes(scenario.course, rng)
    moves = np.empty((len(nominal), 3))
    for i, move in enumerate(nominal):
        turned = attitudes[i + 1] @ attitudes[i].T
        if move.axis is None or move.angle is None:
            moves[i] = rotation_vector(turned)
        else:
            moves[i] = rotation_vector_near(turned, move.angle * move.axis)
    rests = np.full(len(moves) + 1, profile.rest)
    rests[0] = profile.first_rest
    durations = [profile.duration(float(np.linalg.norm(move))) for move in moves]
    with np.errstate(over="ignore"):  # too long a session is refused after
        stops = np.cumsum(rests + np.concatenate([[0.0], durations]))
    return Itinerary(
        attitudes=attitudes,
        rests=np.column_stack([stops - rests, stops]),
        moves=moves,
        turned=np.ones(len(moves), dtype=bool),
        still=np.zeros(len(moves)),
        positions=positions,
    )


def _attitudes(course: OnTable | HandHeld, rng: np.random.Generator) -> tuple[tuple[int, ...], Array, tuple[Move, ...]]:
    """Which position comes when, the true attitudes (R, 3, 3), and the nominal moves between them. By hand they are
    uniform over all orientations: of quaternions of Gaussian components."""
    if isinstance(course, HandHeld):
        from scipy.spatial.transform import Rotation

        n = course.positions
        drawn = Rotation.from_quat(rng.standard_normal((n, 4)), scalar_first=True).as_matrix()
        return tuple(range(n)), np.asarray(drawn), (ANY_MOVE,) * (n - 1)
    n = len(course.programme.positions)
    order = np.arange(n) if course.programme.ordered else rng.permutation(n)
    nominal = np.array([course.programme.positions[i].matrix for i in order])
    if not course.programme.ordered:
        nominal = rotation_matrix(rng.uniform(-np.pi, np.pi, (n, 1)) * UP) @ nominal
    mounting = rotation_matrix(course.mounting_error * rng.uniform(-1.0, 1.0, 3))
    table = rotation_matrix(course.table_error * rng.uniform(-1.0, 1.0, (n, 3)))
    return tuple(order.tolist()), table @ nominal @ mounting, course.programme.moves


# -------------------- checks --------------------

MOST_POSITIONS = 100_000
"""By hand, of one session."""


def _check(scenario: Scenario) -> None:
    """Raise InputError if a scenario is one nothing can be recorded of."""
    profile, vibration = scenario.profile, scenario.vibration
    sizes = [("sample rate", profile.sample_rate, "Hz"), ("rate", profile.rate / DEGREE, "deg/s")]
    for what, value, unit in (*sizes, ("ramp", profile.ramp, "s")):
        if not 0.0 < value < math.inf:
            raise InputError(f"{what}: expected more than 0, in {unit}, found {value:g}")
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
    course = scenario.course
    if isinstance(course, HandHeld):
        if not 1 <= course.positions <= MOST_POSITIONS:
            least = "least 1" if course.positions < 1 else f"most {MOST_POSITIONS}"
            raise InputError(f"positions: expected at {least}, found {Decimal(course.positions):.6g}")
    else:
        for what, error in (("table error", course.table_error), ("mounting error", course.mounting_error)):
            if not 0.0 <= error < math.inf:
                raise InputError(f"{what}: expected 0 or more, in deg, found {error / DEGREE:g}")
    missing = sorted(set(scenario.names) ^ set(scenario.truth))
    if missing:
        raise InputError(
            f"truth: expected a value for every parameter and no other, found a difference in {missing[0]}"
        )
