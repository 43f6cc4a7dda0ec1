"""The turns of a session about the parameters they were integrated with: how rotation and velocity change with others.

With the moments of a turn (`tumble.reduction.turns.moments`) and s_p the column of sensor p in the left inverse, a
change ΔK of the coefficients of a reading turns C into exp([φ×]) C and adds to V,

    φ = −P_pb ΔK_pb,    ΔV = −Q_pb ΔK_pb,    P = Φ_ijb s_jp,    Q = Ψ_ijb s_jp of gyros, Φ_ijb s_jp of accelerometers
    (9)

for every function b of every sensor p. Lever arms and delays enter V by the columns of docs/explanation/mathematics.md
(10) and (11); and φ where gyros feel the specific force, which is known from readings that are late and taken
elsewhere: by the same columns with to_rate G s_p, G the g-sensitivity, in place of s_p. Velocities feel it as if it
grew with time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from tumble.inference.array_levers import ArrayLevers, array_levers
from tumble.reduction.observations import Observations
from tumble.reduction.turns.moments import (
    NO_AXES,
    BlockCompensation,
    Compensation,
    Moments,
    OwnAxes,
    delay_column,
    integrate,
    lever_columns,
    single_delay_columns,
)
from tumble.rotation import rotation_matrix, rotation_vector, skew
from tumble.sensors.compensation import angular_rate, specific_force
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import Block, SensorModel
from tumble.sensors.parameters import CONSTANT, FORCE, FUNCTIONS, OWN_CUBE, OWN_SIZE, PAIRS, PRODUCTS, RATE, Motion
from tumble.units import G_STANDARD, Array, IntArray

SECOND_ORDER = 1e-7  # rad
SECOND_ORDER_SHARE = 0.01  # of the noise of a turn
VELOCITY_SHARE = 0.1  # of the noise of its velocity
CHANGES_SHARE = 0.1  # of the noise: second order of changes from turn to turn that are not integrated about

_FIRST, _SECOND = np.array(PAIRS).T
NONE = np.zeros(0)

Ends = tuple[tuple[Array, Array], tuple[Array, Array]]
"""Specific forces, then rates (K, 3), at rest at the start and at the end of the turns."""


@dataclass(frozen=True, kw_only=True, eq=False)
class IntegratedTurns:
    """Turns and what they were integrated about: `coefficients` (n, 15) of the accelerometers and gyros, or (K, n, 15)
    where each turn has its own, and a `lateness` of the former, s, common to all. Their moments, and `paths`
    (K, 6, n, 15), P above Q of the module's docstring; `turn_only` are −∂φ above −∂V (K, 6, m) of lever arms and of
    delays."""

    coefficients: Array
    lateness: float
    moments: Moments
    paths: Array
    turn_only: Mapping[Motion, Array]
    to_rate: Array
    arrays: tuple[ArrayLevers, ...] = ()
    """What the accelerometers of arrays say of each other in motion."""
    growing: Array | None = None
    """Paths of coefficients that grow by 1 a second about the middle of the turns."""
    links: IntegratedTurns | None = None
    """The parts of the links of a device that moves."""

    @staticmethod
    def of(
        observations: Observations, instrument: Instrument, values: Array, changes: Array | None = None
    ) -> IntegratedTurns:
        """The turns of a session, integrated about these values, and about `changes` (K, n, 15) of the coefficients of
        the accelerometers and gyros in each turn."""
        accel, gyro, K = instrument.accel, instrument.gyro, instrument.all_coefficients(values).copy()
        assert gyro is not None
        K[: accel.size], K[accel.size :, PRODUCTS] = _compensable(accel, K[: accel.size]), 0.0
        late, own = instrument.delay(values), own_axes(instrument)

        def compensation(K: Array) -> Compensation:
            of_accel, of_gyro = _compensation(accel, K[: accel.size]), _compensation(gyro, K[accel.size :])
            g_sensitivity = of_gyro.to_body @ K[accel.size :, FORCE]
            return Compensation(gyro=of_gyro, accel=of_accel, g_sensitivity=g_sensitivity, delay=late)

        about, coefficients = compensation(K), K
        if changes is None:
            moments = observations.moments_about(about, own)
        else:
            coefficients = K + changes
            moments = observations.moments_about(list(map(compensation, coefficients)), own)
        lefts = about.gyro.left_inverse, about.accel.left_inverse
        turns = observations.turns
        assert turns is not None
        ends = None
        if instrument.in_velocities:
            resting = specific_force(instrument, values, observations.rests.accel)
            turning = angular_rate(instrument, values, observations.rests.gyro, resting)
            ends = (resting[turns.first], resting[turns.last]), (turning[turns.first], turning[turns.last])
        growing = observations.growing_moments_about(about) if warms(instrument) else None
        about_turns = IntegratedTurns.from_moments(moments, accel, (coefficients, late), lefts, ends, growing)
        if observations.links is not None:
            links = observations.links
            of_parts = integrate(links.samples.pieces(), len(links.samples.lengths), about, own)
            at_ends = (links.forces[:, 0], links.forces[:, 1]), (links.rates[:, 0], links.rates[:, 1])
            about_parts = IntegratedTurns.from_moments(of_parts, accel, (K, late), lefts, at_ends)
            about_turns = replace(about_turns, links=about_parts)
        if ends is None:
            return about_turns
        arrays = tuple(array_levers(each, instrument, values) for each in observations.arrays)
        return replace(about_turns, arrays=arrays)

    @staticmethod
    @np.errstate(over="ignore", invalid="ignore")  # of turns of damaged samples, which are judged later
    def from_moments(
        moments: Moments,
        accel: Block,
        about: tuple[Array, float],
        lefts: tuple[Array, Array],
        ends: Ends | None,
        growing: tuple[Array, Array] | None = None,
    ) -> IntegratedTurns:
        """Turns of these moments, integrated about coefficients and a delay, with the left inverses (3, n) of gyros and
        accelerometers, and what is at rest at their `ends`, None where velocities are not predicted; `growing` are the
        moments of what grows within the turns."""
        own = moments.Phi_accel, moments.Phi_gyro, moments.Psi_gyro
        return IntegratedTurns(
            coefficients=about[0],
            lateness=about[1],
            moments=moments,
            paths=_paths((moments.Phi, moments.Psi), lefts, own),
            turn_only={} if ends is None else _turn_only_columns(moments, accel, about[0], lefts, ends),
            to_rate=lefts[0],
            growing=None if growing is None else _paths(growing, lefts),
        )

    @property
    def C(self) -> Array:
        """Rotations (K, 3, 3), body at the end → body at the start."""
        return self.moments.C

    def rotations(self, instrument: Instrument, values: Array, changes: Array | float = 0.0) -> Array:
        """C at other values of the parameters, and with `changes` (K, n, 15) of the coefficients in each turn: to first
        order in what both are apart from what the turns were integrated about."""
        apart = instrument.all_coefficients(values) + changes - self.coefficients
        phi = -(self.paths[:, :3] * np.expand_dims(apart, -3)).sum(axis=(2, 3))
        return np.asarray(rotation_matrix(phi) @ self.C)

    @property
    def by_phi(self) -> Array:
        """P (K, 3, n, 15) of the gyros."""
        return self.paths[:, :3, -self.to_rate.shape[1] :]

    @property
    def by_force(self) -> Array:
        """Q (K, 3, n, 15) of the accelerometers."""
        return self.paths[:, 3:, : -self.to_rate.shape[1]]

    @property
    def by_velocity(self) -> Array:
        """Q (K, 3, n, 15) of the gyros."""
        return self.paths[:, 3:, -self.to_rate.shape[1] :]

    def rows(self, instrument: Instrument, values: Array, model: tuple[Array, Array], width: int) -> Array:
        """[−∂φ/∂θ | φ] and [−∂V/∂θ | V] (K, 6, width + 1) at values of the parameters, for which the `model` is K and
        ∂K/∂θ: to first order in their change. The columns between the parameters and the last are 0."""
        (K, D), m = model, len(values)
        out = np.zeros((len(self.paths), 6, width + 1))
        out[:, :, :m] = _times(self.paths, D)
        change = K - self.coefficients
        if change.ndim == 2:
            out[:, :, -1] = -_times(self.paths, change[..., None])[:, :, 0]
        else:
            out[:, :, -1] = -np.einsum("kipb,kpb->ki", self.paths, change)
        out[:, 3:, -1] += self.moments.V
        for motion, by in self.turn_only.items():
            if (own := instrument.turn_only(motion)) is not None:
                out[:, :, own] = by
                out[:, :, -1] -= by @ (values[own] - (self.lateness if motion == "delay" else 0.0))
        return out

    def in_body(self, gyros: int) -> Array:
        """∫ β_pb dt (K, n, 15) in the body of the functions of the n gyros; 0 of sums that were not asked for."""
        moments = self.moments
        out = np.zeros((len(moments), gyros, FUNCTIONS))
        out[..., : moments.body.shape[1]] = moments.body[:, None]
        if moments.body_gyro.shape[-1]:
            out[..., OWN_SIZE], out[..., OWN_CUBE] = moments.body_gyro[:, 0], moments.body_gyro[:, 1]
        return out

    def growing_columns(self, D: Array) -> Array | None:
        """−∂φ/∂θ and −∂V/∂θ (K, 6, m) of parameters, with ∂K/∂θ, that grow by 1 a second about the middle of the
        turns."""
        return None if self.growing is None else _times(self.growing, D)

    @cached_property
    def _sizes(self) -> Array:
        """How much the coefficients (K, n, 15) of the gyros turn the rotations."""
        return np.asarray(np.sqrt((self.by_phi**2).sum(axis=1)))

    def second_order(self, change: Array) -> tuple[Array, Array]:
        """About how much (K,) rotation, rad, and velocity, m/s, err about a `change` (n, 15) or (K, n, 15) of the
        coefficients of the gyros, being of first order."""
        rotation = 0.5 * (self._sizes * np.abs(change)).sum(axis=(1, 2)) ** 2
        return rotation, G_STANDARD * self.moments.T * rotation

    def since(self, instrument: Instrument, values: Array) -> Array:
        """By how much the coefficients of the gyros at these values differ from those of the turns; not those of
        products of forces, about which turns are not integrated: they are of first order wherever they are."""
        gyro = instrument.gyro
        assert gyro is not None
        out = np.asarray(instrument.coefficients(gyro, values) - self.coefficients[..., -gyro.size :, :])
        out[..., PRODUCTS] = 0.0
        return out

    def good_for(
        self, instrument: Instrument, values: Array, noise: tuple[Array, Array], changes: Array | float = 0.0
    ) -> bool:
        """Whether first order does for other values, and `changes` (K, n, 15) of the coefficients of the gyros, beside
        the noise (K,), rad and m/s, of the turns."""
        rotation, velocity = self.second_order(self.since(instrument, values) + changes)
        few = np.minimum(SECOND_ORDER, SECOND_ORDER_SHARE * noise[0])
        return bool(np.all(rotation <= few) and np.all(velocity <= VELOCITY_SHARE * noise[1]))

    def small(self, changes: Array, noise: tuple[Array, Array]) -> bool:
        """Whether first order does for changes (K, n, 15) of the coefficients of the gyros from turn to turn."""
        rotation, velocity = self.second_order(changes)
        return bool(np.all(rotation <= CHANGES_SHARE * noise[0]) and np.all(velocity <= CHANGES_SHARE * noise[1]))


def _turn_only_columns(
    moments: Moments, accel: Block, coefficients: Array, lefts: tuple[Array, Array], ends: Ends
) -> dict[Motion, Array]:
    """−∂φ above −∂V (K, 6, m) of what a turn alone sees of accelerometers that read (1 + k) a_p, so that
    Σ s_p (1 + k) a_pᵀ = I, and which the gyros of these coefficients feel."""
    (to_rate, to_force), (forces, rates), order = lefts, ends, _lever_order(accel)
    mean = coefficients.reshape(-1, *coefficients.shape[-2:]).mean(axis=0)
    a = to_force.shape[1]
    sensed = mean[:a, FORCE]

    def columns(left: Array) -> dict[Motion, Array]:
        return {
            "lever": lever_columns(moments, left, sensed, rates)[:, :, order],
            "single delay": single_delay_columns(moments, left, sensed, forces),
        }

    of_velocity, of_rotation = columns(to_force), columns(to_rate @ mean[a:, FORCE] @ to_force)
    of_velocity["delay"] = delay_column(moments)[:, :, None]
    of_rotation["delay"] = of_rotation["single delay"].sum(axis=2, keepdims=True)
    for each in (of_velocity, of_rotation):
        each["single delay"] = each["single delay"][:, :, accel.channels[:-1]]
    half = 0.5 * skew(moments.V)  # −½ φ × V
    return {
        motion: np.concatenate([by, -of_velocity[motion] - half @ by], axis=1) for motion, by in of_rotation.items()
    }


def _times(paths: Array, D: Array) -> Array:
    """Σ paths · D (K, 6, m) over sensors and functions, of D (n, 15, m)."""
    K, both = len(paths), D.shape[0] * D.shape[1]
    return np.asarray(paths.reshape(6 * K, both) @ D.reshape(both, D.shape[2])).reshape(K, 6, D.shape[2])


def warms(instrument: Instrument) -> bool:
    """Whether parameters grow with the temperature within a turn."""
    return any(group.variable == "temperature" for group in instrument.further)


@lru_cache(maxsize=8)
def own_axes(instrument: Instrument) -> OwnAxes:
    """The axes whose own sums an instrument needs."""
    used, gyro = instrument.used, instrument.gyro
    needed = {kind: bool(np.any(functions >= OWN_SIZE)) for kind, functions in used.items()}
    return OwnAxes(
        gyro=gyro.axes if gyro is not None and needed.get("gyro", False) else NO_AXES,
        accel=instrument.accel.axes if needed["accel"] else NO_AXES,
    )


def angles(moments: Moments) -> Array:
    """Angles (K,) of the turns, rad, 0 … π."""
    return np.asarray(np.linalg.norm(rotation_vector(moments.C), axis=1))


def _compensation(block: Block, K: Array) -> BlockCompensation:
    """The compensation of a block with these coefficients."""
    measured = FORCE if block.kind == "accel" else RATE
    terms = np.array([_square(block, K), K[:, OWN_CUBE], K[:, OWN_SIZE]]).T
    return BlockCompensation.of(block.axes, SensorModel(matrix=K[:, measured], bias=K[:, CONSTANT]), terms)


def _square(block: Block, K: Array) -> Array:
    """The part (n,) along each axis of a quadratic form in f, aᵀ (…) a: K₂ where it is K₂ (aᵀf)²."""
    return np.asarray((K[:, PRODUCTS] * _products(block)).sum(axis=1))


@lru_cache(maxsize=16)
def _products(block: Block) -> Array:
    """The products (n, 6) of the components of the axes, in the order of PAIRS."""
    return np.asarray(block.axes[:, _FIRST] * block.axes[:, _SECOND])


def _compensable(block: Block, K: Array) -> Array:
    """The coefficients that samples of accelerometers are compensated with: of the products of forces, the square along
    each axis."""
    out, square = K.copy(), _square(block, K)
    out[:, PRODUCTS] = np.where(_FIRST == _SECOND, 1.0, 2.0) * square[:, None] * _products(block)
    out[:, RATE] = 0.0
    return out


def _paths(moments: tuple[Array, Array], lefts: tuple[Array, Array], own: tuple[Array, ...] = 3 * (NONE,)) -> Array:
    """P above Q (K, 6, n, 15) of accelerometers and gyros: Σ_j M_ijb s_jp of Φ and Ψ (K, 3, 3, ·) of the first
    functions, and the left inverses of gyros and accelerometers; and of the `own` sums (K, 3, 3, 2, ·) of their sizes
    and cubes, Φ of accelerometers, Φ and Ψ of gyros, where there are any."""
    (Phi, Psi), (to_rate, to_force) = moments, lefts
    a = to_force.shape[1]
    out = np.zeros((len(Phi), 6, a + to_rate.shape[1], FUNCTIONS))
    targets = (out[:, 3:, :a], Phi, to_force), (out[:, :3, a:], Phi, to_rate), (out[:, 3:, a:], Psi, to_rate)
    for (by, M, left), sums in zip(targets, own, strict=True):
        by[..., : M.shape[-1]] = left.T @ M
        if sums.size:
            by[..., [OWN_SIZE, OWN_CUBE]] = np.einsum("kijfp,jp->kipf", sums, left)
    return out


def _lever_order(block: Block) -> IntArray:
    """Where the lever arms of all sensors but the last stand, in the order of their names, among those by channel."""
    return np.asarray((3 * block.channels[:-1, None] + np.arange(3)).ravel(), dtype=np.int64)
