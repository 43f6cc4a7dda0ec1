"""Scenarios: an IMU with given errors in the positions of a programme, or in random ones by hand.

Every move is a rotation about an axis fixed in the geographic frame by the smooth angle θ(t) of `Profile`. The table is
still between moves.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from functools import cached_property
from typing import Any

import numpy as np

from tumble.errors import InputError
from tumble.planning.itinerary import Itinerary
from tumble.planning.setup import ACCEL, GYRO, Setup
from tumble.programme.positions import ANY_MOVE, Move, Programme
from tumble.recording.session import Site
from tumble.rotation import UP, rotation_matrix, rotation_vector_near
from tumble.sensors.grades import Grade, spread_of
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import Block
from tumble.sensors.parameters import Variable, group_name
from tumble.simulation.temperature_profile import Climate
from tumble.units import DEGREE, Array

_MAX_CYCLES_PER_SAMPLE = 10.0
MOST_POSITIONS = 100_000  # by hand


@dataclass(frozen=True, kw_only=True, slots=True)
class Profile:
    """Angle of a move: a rate, rad/s, with raised-cosine ramps, s, which short moves keep at a lower rate."""

    rate: float
    ramp: float

    def duration(self, angle: float) -> float:
        """Return the duration of a move by an angle, rad, in s."""
        return max(abs(angle) / self.rate, self.ramp) + self.ramp

    def angle(self, t: Array, total: float) -> Array:
        """Return the angle, rad, at times t, s, after the start of a move by `total`: zero before, total after."""
        T = self.duration(total)
        t = np.clip(t, 0.0, T)
        late = t > 0.5 * T
        s = np.where(late, T - t, t)  # the second half mirrors the first
        into = np.minimum(s, self.ramp)
        ramp = 0.5 * into - self.ramp / (2.0 * np.pi) * np.sin(np.pi * into / self.ramp)
        gone = total / (T - self.ramp) * (ramp + (s - into))
        return np.asarray(np.where(late, total - gone, gone))

    def rates(self, t: Array, total: float) -> tuple[Array, Array]:
        """Return rate, rad/s, and angular acceleration, rad/s², at times t, s: the derivatives of `angle`."""
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


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """Everything that determines a simulated session except random numbers.

    Errors of mounting and table are rotations uniform within ± about each axis, of the mounting once (body axes), of
    the table for every position (geographic axes).
    """

    setup: Setup  # whose spreads are not used
    accel: Block
    gyro: Block
    truth: Mapping[str, float]  # true values of all parameters by name, SI, as in truth.json
    vibration: Vibration  # throughout the log
    serial: str
    climate: Climate | None = None  # temperatures, with which parameters change

    def changed(self, **setup: Any) -> Scenario:
        """Return the scenario with other values of its set-up."""
        return replace(self, setup=replace(self.setup, **setup))

    @property
    def programme(self) -> Programme | None:
        """The programme on the table; None by hand."""
        return self.setup.programme if self.setup.by_hand is None else None

    @property
    def site(self) -> Site:
        """Site of the recording."""
        s = self.setup
        return Site(latitude=s.latitude, height=s.height, gravity=s.gravity, gravity_u=s.gravity_u)

    @property
    def profile(self) -> Profile:
        """Profile of its moves."""
        return Profile(rate=self.setup.turn_rate, ramp=self.setup.ramp)

    @cached_property
    def instrument(self) -> Instrument:
        """The instrument with all parameters that have true values."""
        thermal: tuple[Variable, ...] = ("temperature", "temperature²", "hysteresis")
        variables: tuple[Variable, ...] = ("time", *(() if self.climate is None else thermal))
        return Instrument.of(self.accel, self.gyro, tuple({group_name(name) for name in self.truth}), variables)

    @property
    def names(self) -> tuple[str, ...]:
        """Names (m,) of the parameters of the instrument."""
        return self.instrument.names

    @cached_property
    def values(self) -> Array:
        """True values (m,) of the parameters, in the order of `names`."""
        return np.array([self.truth[name] for name in self.names])


def scenario_of(
    setup: Setup, rng: np.random.Generator, *, serial: str = "simulated", vibration: Vibration = NO_VIBRATION
) -> Scenario:
    """Draw a scenario of a set-up: triads along the body axes, with random errors of its spreads."""
    linear = draw_parameters(setup, (ACCEL, GYRO), rng)
    truth = linear | draw_further(setup.further, ACCEL, GYRO, rng)
    return Scenario(setup=setup, accel=ACCEL, gyro=GYRO, truth=truth, vibration=vibration, serial=serial)


def draw_parameters(instrument: Setup | Grade, blocks: Sequence[Block], rng: np.random.Generator) -> dict[str, float]:
    """Draw true values of the parameters of blocks by name, Gaussian with the spreads of a set-up or a grade."""
    names = [name for block in blocks for name in block.names]
    return {name: spread_of(instrument, name) * float(rng.standard_normal()) for name in names}


def draw_further(spreads: Mapping[str, float], accel: Block, gyro: Block, rng: np.random.Generator) -> dict[str, float]:
    """Draw true values of groups beyond the linear model by name, Gaussian with standard deviations `spreads`, SI."""
    instrument = Instrument.of(accel, gyro, tuple(spreads))
    return {
        name: float(spreads[group.name] * rng.standard_normal())
        for group in instrument.further
        for name in group.names(instrument.block(group))
    }


def itinerary(scenario: Scenario, rng: np.random.Generator) -> Itinerary:
    """Draw the attitudes, moves and times of a scenario; raise InputError if it is impossible.

    Of the two ways round, a move takes the one closer to that of the programme, or the shorter one if any is allowed.
    """
    _check(scenario)
    setup, profile = scenario.setup, scenario.profile
    positions, attitudes, nominal = _attitudes(setup, rng)
    listed = [np.zeros(3) if move.axis is None or move.angle is None else move.angle * move.axis for move in nominal]
    turned = attitudes[1:] @ np.swapaxes(attitudes[:-1], 1, 2)
    moves = rotation_vector_near(turned, np.reshape(listed, (-1, 3)))  # near zero: the shorter way
    rests = np.full(len(moves) + 1, setup.rest)
    rests[0] = max(setup.rest, setup.first_rest)
    durations = [profile.duration(angle) for angle in np.linalg.norm(moves, axis=1).tolist()]
    with np.errstate(over="ignore"):  # a session that is too long is refused later
        stops = np.cumsum(rests + np.concatenate([[0.0], durations]))
    return Itinerary(
        attitudes=attitudes,
        rests=np.column_stack([stops - rests, stops]),
        moves=moves,
        turned=np.ones(len(moves), dtype=bool),
        still=np.zeros(len(moves)),
        positions=positions,
    )


def _attitudes(setup: Setup, rng: np.random.Generator) -> tuple[tuple[int, ...], Array, tuple[Move, ...]]:
    """Return the order of the positions, the true attitudes (R, 3, 3), and the nominal moves between them.

    By hand the attitudes are uniform over all orientations, from quaternions with Gaussian components."""
    if (n := setup.by_hand) is not None:
        from scipy.spatial.transform import Rotation

        drawn = Rotation.from_quat(rng.standard_normal((n, 4)), scalar_first=True).as_matrix()
        return tuple(range(n)), np.asarray(drawn), (ANY_MOVE,) * (n - 1)
    programme, n = setup.programme, len(setup.programme.positions)
    order = np.arange(n) if programme.ordered else rng.permutation(n)
    nominal = np.array([programme.positions[i].matrix for i in order])
    if not programme.ordered:
        nominal = rotation_matrix(rng.uniform(-np.pi, np.pi, (n, 1)) * UP) @ nominal
    mounting = rotation_matrix(setup.mounting_error * rng.uniform(-1.0, 1.0, 3))
    table = rotation_matrix(setup.table_error * rng.uniform(-1.0, 1.0, (n, 3)))
    return tuple(order.tolist()), table @ nominal @ mounting, programme.moves


def _check(scenario: Scenario) -> None:
    """Raise InputError for a scenario of which nothing can be recorded."""
    setup, vibration = scenario.setup, scenario.vibration
    sizes = (("sample rate", setup.sample_rate, "Hz"), ("rate", setup.turn_rate / DEGREE, "deg/s"))
    for what, value, unit in (*sizes, ("ramp", setup.ramp, "s")):
        if not 0.0 < value < math.inf:
            raise InputError(f"{what}: expected more than 0, in {unit}, found {value:g}")
    shortest = 2.0 / setup.sample_rate
    for what, rest in (("first rest", max(setup.rest, setup.first_rest)), ("rest", setup.rest)):
        if not shortest <= rest < math.inf:
            raise InputError(f"{what}: expected at least two samples, {shortest:g} s, found {rest:g} s")
    highest, by_hand = _MAX_CYCLES_PER_SAMPLE * setup.sample_rate, setup.by_hand
    if vibration.amplitude > 0.0 and not 0.0 < vibration.frequency <= highest:
        raise InputError(
            f"vibration: expected more than 0 and at most {highest:g} Hz (ten cycles a sample), "
            f"found {vibration.frequency:g} Hz"
        )
    if by_hand is not None and not 1 <= by_hand <= MOST_POSITIONS:
        least = "least 1" if by_hand < 1 else f"most {MOST_POSITIONS}"
        raise InputError(f"positions: expected at {least}, found {Decimal(by_hand):.6g}")
    for what, error in (("table error", setup.table_error), ("mounting error", setup.mounting_error)):
        if by_hand is None and not 0.0 <= error < math.inf:
            raise InputError(f"{what}: expected 0 or more, in deg, found {error / DEGREE:g}")
    missing = sorted(set(scenario.names) ^ set(scenario.truth))
    if missing:
        raise InputError(
            f"truth: expected a value for every parameter and no other, found a difference in {missing[0]}"
        )
