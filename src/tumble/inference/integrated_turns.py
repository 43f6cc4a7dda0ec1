"""Turns integrated about values of the parameters, and their derivatives by the parameters.

With the moments of a turn (`tumble.reduction.turns.moments`) and s_p the column of sensor p in the left inverse, a
change ΔK of the coefficients of readings changes the rotation C to exp([φ×]) C and adds ΔV to the velocity V,

    φ = −P_pb ΔK_pb,    ΔV = −Q_pb ΔK_pb,    P = Φ_ijb s_jp,    Q = Ψ_ijb s_jp of gyros, Φ_ijb s_jp of accelerometers
    (9)

summed over every function b of every sensor p. V depends on lever arms and delays by the columns of
docs/explanation/mathematics.md (10) and (11). If gyros respond to specific force, which is measured late and elsewhere,
φ depends on lever arms and delays by the same columns, with to_rate G s_p in place of s_p, G being the g-sensitivity;
for velocities this response is taken as growing in proportion to time.
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
from tumble.units import G_STANDARD, Array

# largest second-order effects, rad and relative to the noise, at which turns are not integrated again
SECOND_ORDER = 1e-7  # rad
SECOND_ORDER_SHARE = 0.01  # of the noise of a rotation
VELOCITY_SHARE = 0.1  # of the noise of a velocity
CHANGES_SHARE = 0.1  # of the noise, by changes of the coefficients from turn to turn

_FIRST, _SECOND = np.array(PAIRS).T
NONE = np.zeros(0)
# specific forces, then rates (K, 3), at rest at the start and at the end of the turns
Ends = tuple[tuple[Array, Array], tuple[Array, Array]]


@dataclass(frozen=True, kw_only=True, eq=False)
class IntegratedTurns:
    """Turns integrated about values of the parameters.

    Parameters
    ----------
    coefficients : (n, 15) or (K, n, 15)
        Coefficients of accelerometers and gyros about which all turns, or each, were integrated.
    lateness
        Delay of the accelerometers about which they were integrated, s.
    moments
        Moments of the turns.
    paths : (K, 6, n, 15)
        P above Q of the module's docstring.
    turn_only
        −∂φ above −∂V (K, 6, m) by lever arms and by delays.
    to_rate : (3, n)
        Left inverse of the gyros.
    arrays
        Likelihoods of the lever arms of arrays.
    growing : (K, 6, n, 15)
        `paths` of coefficients that grow by 1 per second about the middle of the turns.
    links
        Parts of the links of a moving device.
    """

    coefficients: Array
    lateness: float
    moments: Moments
    paths: Array
    turn_only: Mapping[Motion, Array]
    to_rate: Array
    arrays: tuple[ArrayLevers, ...] = ()
    growing: Array | None = None
    links: IntegratedTurns | None = None

    @staticmethod
    def of(
        observations: Observations, instrument: Instrument, values: Array, changes: Array | None = None
    ) -> IntegratedTurns:
        """Integrate the turns of a session about parameters `values` (m,), and `changes` (K, n, 15) of the coefficients
        in each turn."""
        accel, gyro, K = instrument.accel, instrument.gyro, instrument.linearised(values)[0].copy()
        assert gyro is not None
        square = _square(accel, K[: accel.size])[:, None]  # of products, compensation has squares along the axes only
        K[: accel.size, PRODUCTS] = np.where(_FIRST == _SECOND, 1.0, 2.0) * square * _products(accel)
        K[: accel.size, RATE], K[accel.size :, PRODUCTS] = 0.0, 0.0
        late, axes = instrument.delay(values), own_axes(instrument)

        def compensation(K: Array) -> Compensation:
            of_accel, of_gyro = _compensation(accel, K[: accel.size]), _compensation(gyro, K[accel.size :])
            g_sensitivity = of_gyro.to_body @ K[accel.size :, FORCE]
            return Compensation(gyro=of_gyro, accel=of_accel, g_sensitivity=g_sensitivity, delay=late)

        about, coefficients = compensation(K), K
        if changes is None:
            moments = observations.moments_about(about, axes)
        else:
            coefficients = K + changes
            moments = observations.moments_about(list(map(compensation, coefficients)), axes)
        lefts = about.gyro.left_inverse, about.accel.left_inverse
        turns = observations.turns
        assert turns is not None
        ends = None
        if instrument.in_velocities:
            resting = specific_force(instrument, values, observations.rests.accel)
            turning = angular_rate(instrument, values, observations.rests.gyro, resting)
            ends = (resting[turns.first], resting[turns.last]), (turning[turns.first], turning[turns.last])
        grows = any(group.variable == "temperature" for group in instrument.further)
        growing = observations.growing_moments_about(about) if grows else None
        out = IntegratedTurns.from_moments(moments, accel, (coefficients, late), lefts, ends, growing)
        if observations.links is not None:
            links = observations.links
            of_parts = integrate(links.samples.pieces(), len(links.samples.lengths), about, axes)
            at_ends = (links.forces[:, 0], links.forces[:, 1]), (links.rates[:, 0], links.rates[:, 1])
            out = replace(out, links=IntegratedTurns.from_moments(of_parts, accel, (K, late), lefts, at_ends))
        if ends is None:
            return out
        return replace(out, arrays=tuple(array_levers(array, instrument, values) for array in observations.arrays))

    @staticmethod
    @np.errstate(over="ignore", invalid="ignore")  # by damaged samples, whose turns are judged later
    def from_moments(
        moments: Moments,
        accel: Block,
        about: tuple[Array, float],
        lefts: tuple[Array, Array],
        ends: Ends | None,
        growing: tuple[Array, Array] | None = None,
    ) -> IntegratedTurns:
        """Return turns with these moments.

        Parameters
        ----------
        moments, accel
            Moments of the turns, and the block of accelerometers.
        about
            Coefficients and delay about which the turns were integrated.
        lefts : ((3, n), (3, n))
            Left inverses of gyros and of accelerometers.
        ends
            Forces and rates at both ends of the turns; None if velocities are not predicted.
        growing
            Moments of coefficients that grow within the turns.
        """
        along_axes = moments.Phi_accel, moments.Phi_gyro, moments.Psi_gyro
        return IntegratedTurns(
            coefficients=about[0],
            lateness=about[1],
            moments=moments,
            paths=_paths((moments.Phi, moments.Psi), lefts, along_axes),
            turn_only={} if ends is None else _turn_only_columns(moments, accel, about[0], lefts, ends),
            to_rate=lefts[0],
            growing=None if growing is None else _paths(growing, lefts),
        )

    @property
    def C(self) -> Array:
        """Rotations (K, 3, 3), body at the end → body at the start."""
        return self.moments.C

    def rotations(self, instrument: Instrument, values: Array, changes: Array | float = 0.0) -> Array:
        """Return rotations C (K, 3, 3), to first order, at `values` of the parameters and `changes` (K, n, 15) of the
        coefficients in each turn."""
        offset = instrument.linearised(values)[0] + changes - self.coefficients
        phi = -(self.paths[:, :3] * np.expand_dims(offset, -3)).sum(axis=(2, 3))
        return np.asarray(rotation_matrix(phi) @ self.C)

    def rows(self, instrument: Instrument, values: Array, model: tuple[Array, Array]) -> Array:
        """Return [−∂φ/∂θ | φ] above [−∂V/∂θ | V] (K, 6, m + 1) at `values` (m,), to first order.

        `model` is K and ∂K/∂θ there."""
        (K, D), m = model, len(values)
        out = np.zeros((len(self.paths), 6, m + 1))
        out[:, :, :m] = along_paths(self.paths, D)
        change = K - self.coefficients
        if change.ndim == 2:
            out[:, :, -1] = -along_paths(self.paths, change[..., None])[:, :, 0]
        else:
            out[:, :, -1] = -np.einsum("kipb,kpb->ki", self.paths, change)
        out[:, 3:, -1] += self.moments.V
        for motion, columns in self.turn_only.items():
            if (members := instrument.turn_only(motion)) is not None:
                out[:, :, members] = columns
                out[:, :, -1] -= columns @ (values[members] - (self.lateness if motion == "delay" else 0.0))
        return out

    def in_body(self, gyros: int) -> Array:
        """Return ∫ β_pb dt (K, n, 15) of the functions of the n gyros, in the body; 0 for sums that were not
        requested."""
        moments = self.moments
        out = np.zeros((len(moments), gyros, FUNCTIONS))
        out[..., : moments.body.shape[1]] = moments.body[:, None]
        if moments.body_gyro.shape[-1]:
            out[..., OWN_SIZE], out[..., OWN_CUBE] = moments.body_gyro[:, 0], moments.body_gyro[:, 1]
        return out

    @cached_property
    def _lengths(self) -> Array:
        """Lengths (K, n, 15) of the derivatives of φ by the coefficients of the gyros."""
        return np.asarray(np.sqrt((self.paths[:, :3, -self.to_rate.shape[1] :] ** 2).sum(axis=1)))

    def second_order(self, change: Array) -> tuple[Array, Array]:
        """Return approximate second-order errors (K,) of rotation, rad, and velocity, m/s, for a `change` (n, 15) or
        (K, n, 15) of the gyro coefficients."""
        rotation = 0.5 * (self._lengths * np.abs(change)).sum(axis=(1, 2)) ** 2
        return rotation, G_STANDARD * self.moments.T * rotation

    def gyro_offset(self, instrument: Instrument, values: Array) -> Array:
        """Return the gyro coefficients at `values` less those of the integration.

        Products of forces, in which the turns are linear, are left out."""
        gyro = instrument.gyro
        assert gyro is not None
        out = np.asarray(instrument.coefficients(gyro, values) - self.coefficients[..., -gyro.size :, :])
        out[..., PRODUCTS] = 0.0
        return out

    def valid_at(
        self, instrument: Instrument, values: Array, noise: tuple[Array, Array], changes: Array | float = 0.0
    ) -> bool:
        """Return True if first order suffices at `values`, with `changes` (K, n, 15) of the gyro coefficients.

        `noise` are standard deviations (K,) of rotations, rad, and velocities, m/s."""
        rotation, velocity = self.second_order(self.gyro_offset(instrument, values) + changes)
        limit = np.minimum(SECOND_ORDER, SECOND_ORDER_SHARE * noise[0])
        return bool(np.all(rotation <= limit) and np.all(velocity <= VELOCITY_SHARE * noise[1]))

    def are_small(self, changes: Array, noise: tuple[Array, Array]) -> bool:
        """Return True if first order suffices for `changes` (K, n, 15) of the gyro coefficients from turn to turn."""
        rotation, velocity = self.second_order(changes)
        return bool(np.all(rotation <= CHANGES_SHARE * noise[0]) and np.all(velocity <= CHANGES_SHARE * noise[1]))


def _turn_only_columns(
    moments: Moments, accel: Block, coefficients: Array, lefts: tuple[Array, Array], ends: Ends
) -> dict[Motion, Array]:
    """Return −∂φ above −∂V (K, 6, m) by lever arms and delays, with Σ s_p (1 + k) a_pᵀ = I of the accelerometers.

    φ depends on them through the response of the gyros, with these coefficients, to specific force."""
    (to_rate, to_force), (forces, rates) = lefts, ends
    order = (3 * accel.channels[:-1, None] + np.arange(3)).ravel()  # of the named lever arms, among those by channel
    mean = coefficients.reshape(-1, *coefficients.shape[-2:]).mean(axis=0)
    a = to_force.shape[1]
    rows = mean[:a, FORCE]

    def columns(left: Array) -> dict[Motion, Array]:
        return {
            "lever": lever_columns(moments, left, rows, rates)[:, :, order],
            "single delay": single_delay_columns(moments, left, rows, forces),
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


def along_paths(paths: Array, D: Array) -> Array:
    """Return Σ paths · D (K, 6, m) over sensors and functions, with D (n, 15, m)."""
    K, size = len(paths), D.shape[0] * D.shape[1]
    return np.asarray(paths.reshape(6 * K, size) @ D.reshape(size, D.shape[2])).reshape(K, 6, D.shape[2])


@lru_cache(maxsize=8)
def own_axes(instrument: Instrument) -> OwnAxes:
    """Return the axes along which the moments need sums of magnitudes and cubes."""
    used, gyro = instrument.used, instrument.gyro
    needed = {kind: bool(np.any(functions >= OWN_SIZE)) for kind, functions in used.items()}
    return OwnAxes(
        gyro=gyro.axes if gyro is not None and needed.get("gyro", False) else NO_AXES,
        accel=instrument.accel.axes if needed["accel"] else NO_AXES,
    )


def angles(moments: Moments) -> Array:
    """Return the angles (K,) of the turns, rad, 0 … π."""
    return np.asarray(np.linalg.norm(rotation_vector(moments.C), axis=1))


def _compensation(block: Block, K: Array) -> BlockCompensation:
    measured = FORCE if block.kind == "accel" else RATE
    terms = np.array([_square(block, K), K[:, OWN_CUBE], K[:, OWN_SIZE]]).T
    return BlockCompensation.of(block.axes, SensorModel(matrix=K[:, measured], bias=K[:, CONSTANT]), terms)


def _square(block: Block, K: Array) -> Array:
    """Return the quadratic form in f along each axis a, aᵀ (…) a (n,): K₂ if the form is K₂ (aᵀf)²."""
    return np.asarray((K[:, PRODUCTS] * _products(block)).sum(axis=1))


@lru_cache(maxsize=16)
def _products(block: Block) -> Array:
    """Return the products (n, 6) of the components of the axes, in the order of PAIRS."""
    return np.asarray(block.axes[:, _FIRST] * block.axes[:, _SECOND])


def _paths(
    moments: tuple[Array, Array], lefts: tuple[Array, Array], along_axes: tuple[Array, ...] = 3 * (NONE,)
) -> Array:
    """Return P above Q (K, 6, n, 15): Σ_j M_ijb s_jp with M = Φ and Ψ (K, 3, 3, ·).

    `along_axes` are sums (K, 3, 3, 2, ·) of magnitudes and cubes along the axes: Φ of accelerometers, Φ and Ψ of gyros;
    empty if not needed."""
    (Phi, Psi), (to_rate, to_force) = moments, lefts
    a = to_force.shape[1]
    out = np.zeros((len(Phi), 6, a + to_rate.shape[1], FUNCTIONS))
    targets = (out[:, 3:, :a], Phi, to_force), (out[:, :3, a:], Phi, to_rate), (out[:, 3:, a:], Psi, to_rate)
    for (path, M, left), sums in zip(targets, along_axes, strict=True):
        path[..., : M.shape[-1]] = left.T @ M
        if sums.size:
            path[..., [OWN_SIZE, OWN_CUBE]] = np.einsum("kijfp,jp->kipf", sums, left)
    return out
