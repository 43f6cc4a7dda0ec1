"""The turns of a session about the parameters they were integrated with: how rotation and velocity change with others.

With the moments of a turn (`tumble.reduction.moments`) and s_p the column of sensor p in the left inverse, a change
ΔK of the coefficients of a reading turns C into exp([φ×]) C and adds to V,

    φ = −P_pb ΔK_pb,    ΔV = −Q_pb ΔK_pb,    P = Φ_ijb s_jp,    Q = Ψ_ijb s_jp of gyros, Φ_ijb s_jp of accelerometers
    (A6)

for every function b of every sensor p. Lever arms and delays enter V alone, Eqs. (6) and (7).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from tumble.estimation.array_levers import ArrayLevers, array_levers
from tumble.reduction.moments import (
    NO_AXES,
    BlockCompensation,
    Compensation,
    Moments,
    OwnAxes,
    delay_column,
    lever_columns,
    single_delay_columns,
)
from tumble.reduction.observations import Observations
from tumble.rotation import rotation_vector
from tumble.sensors.compensation import angular_rate, specific_force
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import Block, SensorModel
from tumble.sensors.parameters import CONSTANT, FORCE, FUNCTIONS, OWN_CUBE, OWN_SIZE, PAIRS, PRODUCTS, RATE, Motion
from tumble.units import G_STANDARD, Array, IntArray

SECOND_ORDER = 1e-7  # rad
SECOND_ORDER_SHARE = 0.01  # of the noise of a turn
VELOCITY_SHARE = 0.1  # of the noise of its velocity
CHANGES_SHARE = 0.1  # of the noise: second order of changes from turn to turn that are not integrated about


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TurnsAbout:
    """Turns and what they were integrated about: coefficients `rate` and `force` (n, 15) of the gyros and
    accelerometers, or (K, n, 15) where each turn has its own, and a `lateness` of the latter, s, common to all. Their
    moments, and by_phi (K, 3, n, 15) and by_velocity (K, 3, n, 15) of the gyros and by_force (K, 3, n, 15) of the
    accelerometers, P and Q of the module's docstring; `in_motion` are −∂V (K, 3, m) of lever arms and of delays."""

    rate: Array
    force: Array
    lateness: float
    moments: Moments
    by_phi: Array
    by_velocity: Array
    by_force: Array
    in_motion: Mapping[Motion, Array]
    to_rate: Array
    arrays: tuple[ArrayLevers, ...] = ()
    """What the accelerometers of arrays say of each other in motion."""
    growing: tuple[Array, Array, Array] | None = None
    """by_phi, by_velocity and by_force of coefficients that grow by 1 a second about the middle of the turns."""

    @staticmethod
    def of(
        observations: Observations, instrument: Instrument, values: Array, changes: tuple[Array, Array] | None = None
    ) -> TurnsAbout:
        """The turns of a session, integrated about these values, and about `changes` (K, n, 15) of the coefficients of
        the gyros and accelerometers in each turn."""
        accel, gyro = instrument.accel, instrument.gyro
        assert gyro is not None
        rate, force = instrument.coefficients(gyro, values), _compensable(accel, instrument.coefficients(accel, values))
        rate[:, PRODUCTS] = 0.0
        late = instrument.delay(values)

        def compensation(rate: Array, force: Array) -> Compensation:
            of_gyro, of_accel = _compensation(gyro, rate), _compensation(accel, force)
            g_sensitivity = of_gyro.to_body @ rate[:, FORCE]
            return Compensation(gyro=of_gyro, accel=of_accel, g_sensitivity=g_sensitivity, delay=late)

        about, own = compensation(rate, force), own_axes(instrument)
        if changes is None:
            moments = observations.moments_about(about, own)
        else:
            rate, force = rate + changes[0], force + changes[1]
            moments = observations.moments_about_each(list(map(compensation, rate, force)), own)
        lefts = about.gyro.left_inverse, about.accel.left_inverse
        turns = observations.turns
        assert turns is not None
        resting = specific_force(instrument, values, observations.rests.accel)
        turning = angular_rate(instrument, values, observations.rests.gyro, resting)
        ends = (resting[turns.first], resting[turns.last]), (turning[turns.first], turning[turns.last])
        growing = observations.growing_moments_about(about) if warms(instrument) else None
        about_turns = TurnsAbout.from_moments(moments, accel, (rate, force, late), lefts, ends, growing)
        if instrument.in_motion("lever") is None:
            return about_turns
        arrays = tuple(array_levers(each, instrument, values) for each in observations.arrays)
        return replace(about_turns, arrays=arrays)

    @staticmethod
    def from_moments(
        moments: Moments,
        accel: Block,
        about: tuple[Array, Array, float],
        lefts: tuple[Array, Array],
        ends: tuple[tuple[Array, Array], tuple[Array, Array]],
        growing: tuple[Array, Array] | None = None,
    ) -> TurnsAbout:
        """Turns of these moments, integrated about coefficients and a delay, with the left inverses (3, n) of gyros and
        accelerometers, and the specific forces, then the rates (K, 3), at rest at their `ends`; `growing` are the
        moments of what grows within the turns."""
        (to_rate, to_force), (forces, rates) = lefts, ends
        by_force = _paths(moments.Phi, to_force)
        by_phi, by_velocity = _paths(moments.Phi, to_rate), _paths(moments.Psi, to_rate)
        for by, own, to_body in (
            (by_force, moments.Phi_accel, to_force),
            (by_phi, moments.Phi_gyro, to_rate),
            (by_velocity, moments.Psi_gyro, to_rate),
        ):
            if own.shape[-1]:
                by[..., OWN_SIZE], by[..., OWN_CUBE] = _own(own[..., 0, :], to_body), _own(own[..., 1, :], to_body)
        return TurnsAbout(
            rate=about[0],
            force=about[1],
            lateness=about[2],
            moments=moments,
            by_phi=by_phi,
            by_velocity=by_velocity,
            by_force=by_force,
            in_motion={
                "lever": -lever_columns(moments, to_force, accel.axes, rates)[:, :, _lever_order(accel)],
                "delay": -delay_column(moments)[:, :, None],
                "single delay": -single_delay_columns(moments, to_force, accel.axes, forces)[:, :, accel.channels[:-1]],
            },
            to_rate=to_rate,
            growing=None if growing is None else _growing(growing, lefts),
        )

    @property
    def C(self) -> Array:
        """Rotations (K, 3, 3), body at the end → body at the start."""
        return self.moments.C

    def moved(self, instrument: Instrument, values: Array) -> tuple[Array, Array]:
        """φ (K, 3) and the velocity (K, 3) for other values of the parameters, to first order in their change."""
        gyro = instrument.gyro
        assert gyro is not None
        rate = instrument.coefficients(gyro, values) - self.rate
        force = instrument.coefficients(instrument.accel, values) - self.force
        phi = -_applied(self.by_phi, rate)
        V = self.moments.V - _applied(self.by_velocity, rate) - _applied(self.by_force, force)
        for motion, by in self.in_motion.items():
            if (own := instrument.in_motion(motion)) is not None:
                V = V - by @ (values[own] - (self.lateness if motion == "delay" else 0.0))
        return phi, V

    def columns(self, instrument: Instrument, values: Array) -> tuple[Array, Array]:
        """−∂φ/∂θ and −∂V/∂θ (K, 3, m) at values of the parameters."""
        gyro, accel = instrument.gyro, instrument.accel
        assert gyro is not None
        of_gyro, of_accel = instrument.derivative(gyro, values), instrument.derivative(accel, values)
        phi = np.tensordot(self.by_phi, of_gyro, axes=2)
        V = np.tensordot(self.by_velocity, of_gyro, axes=2) + np.tensordot(self.by_force, of_accel, axes=2)
        for motion, by in self.in_motion.items():
            if (own := instrument.in_motion(motion)) is not None:
                V[:, :, own] = by
        return phi, V

    def growing_columns(self, instrument: Instrument, values: Array) -> tuple[Array, Array] | tuple[None, None]:
        """The same (K, 3, m) of parameters that grow by 1 a second about the middle of the turns."""
        if self.growing is None or instrument.gyro is None:
            return None, None
        of_gyro, of_accel = (instrument.derivative(block, values) for block in (instrument.gyro, instrument.accel))
        by_phi, by_velocity, by_force = self.growing
        V = np.tensordot(by_velocity, of_gyro, axes=2) + np.tensordot(by_force, of_accel, axes=2)
        return np.tensordot(by_phi, of_gyro, axes=2), V

    def bias_columns(self) -> tuple[Array, Array]:
        """−∂φ/∂b and −∂V/∂b (K, 3, n) of the biases of the accelerometers, then of the gyros."""
        accel, gyro = self.by_force[..., CONSTANT], self.by_phi[..., CONSTANT]
        phi = np.concatenate([np.zeros_like(accel), gyro], axis=2)
        return phi, np.concatenate([accel, self.by_velocity[..., CONSTANT]], axis=2)

    def second_order(self, instrument: Instrument, values: Array, changes: Array | float = 0.0) -> tuple[Array, Array]:
        """About how much (K,) rotation, rad, and velocity, m/s, about other values, and `changes` (K, n, 15) of the
        coefficients of the gyros, err, being of first order."""
        gyro = instrument.gyro
        assert gyro is not None
        return self._second_order(instrument.coefficients(gyro, values) + changes - self.rate)

    def _second_order(self, change: Array) -> tuple[Array, Array]:
        sizes = np.sqrt((self.by_phi**2).sum(axis=1))  # (K, n, 15)
        phi = (sizes * np.abs(change)).sum(axis=(1, 2))
        rotation = 0.5 * phi**2
        return rotation, G_STANDARD * self.moments.T * rotation

    def good_for(
        self, instrument: Instrument, values: Array, noise: tuple[Array, Array], changes: Array | float = 0.0
    ) -> bool:
        """Whether first order does for other values, beside the noise (K,), rad and m/s, of the turns."""
        rotation, velocity = self.second_order(instrument, values, changes)
        few = np.minimum(SECOND_ORDER, SECOND_ORDER_SHARE * noise[0])
        return bool(np.all(rotation <= few) and np.all(velocity <= VELOCITY_SHARE * noise[1]))

    def small(self, changes: Array, noise: tuple[Array, Array]) -> bool:
        """Whether first order does for changes (K, n, 15) of the coefficients of the gyros from turn to turn."""
        rotation, velocity = self._second_order(changes)
        return bool(np.all(rotation <= CHANGES_SHARE * noise[0]) and np.all(velocity <= CHANGES_SHARE * noise[1]))


def _growing(moments: tuple[Array, Array], lefts: tuple[Array, Array]) -> tuple[Array, Array, Array]:
    """by_phi, by_velocity and by_force of coefficients that grow within the turns, of Φ and Ψ weighted with time."""
    Phi, Psi = moments
    return _paths(Phi, lefts[0]), _paths(Psi, lefts[0]), _paths(Phi, lefts[1])


def _applied(by: Array, change: Array) -> Array:
    """Σ by · ΔK (K, 3) of coefficients (n, 15), or (K, n, 15)."""
    return np.asarray(np.einsum("kipb,kpb->ki", by, np.broadcast_to(change, (len(by), *change.shape[-2:]))))


def warms(instrument: Instrument) -> bool:
    """Whether parameters grow with the temperature within a turn."""
    return any(group.variable == "temperature" for group in instrument.further)


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
    terms = np.column_stack([_square(block, K), K[:, OWN_CUBE], K[:, OWN_SIZE]])
    return BlockCompensation.of(block.axes, SensorModel(matrix=K[:, measured], bias=K[:, CONSTANT]), terms)


def _square(block: Block, K: Array) -> Array:
    """The part (n,) along each axis of a quadratic form in f, aᵀ (…) a: K₂ where it is K₂ (aᵀf)²."""
    by_pair = (block.axes[:, k] * block.axes[:, other] for k, other in PAIRS)
    return np.asarray(sum(K[:, b] * each for b, each in enumerate(by_pair, start=PRODUCTS.start)))


def _compensable(block: Block, K: Array) -> Array:
    """The coefficients that samples of accelerometers are compensated with: of the products of forces, the square along
    each axis."""
    out, square = K.copy(), _square(block, K)
    for b, (k, other) in enumerate(PAIRS, start=PRODUCTS.start):
        out[:, b] = (1.0 if k == other else 2.0) * square * block.axes[:, k] * block.axes[:, other]
    out[:, RATE] = 0.0
    return out


def _paths(moments: Array, left_inverse: Array) -> Array:
    """Σ_j M_ijb s_jp (K, 3, n, 15) of moments (K, 3, 3, ·) of the first functions."""
    out = np.zeros((len(moments), 3, left_inverse.shape[1], FUNCTIONS))
    out[..., : moments.shape[-1]] = np.swapaxes(moments.swapaxes(2, 3) @ left_inverse, 2, 3)
    return out


def _own(moments: Array, left_inverse: Array) -> Array:
    """Σ_j M_ijp s_jp (K, 3, n)."""
    return np.asarray(np.einsum("kijp,jp->kip", moments, left_inverse))


def _lever_order(block: Block) -> IntArray:
    """Where the lever arms of all sensors but the last stand, in the order of their names, among those by channel."""
    return np.asarray((3 * block.channels[:-1, None] + np.arange(3)).ravel(), dtype=np.int64)
