"""Noise of the residuals of rests and turns, and in-run biases as Gauss–Markov processes.

Residuals. The covariance of the residuals of a rest or a turn is that of the noise of its samples, N, plus components
of variance v_a along known directions Z_a, docs/explanation/mathematics.md (16) to (18):

    Σ = N + Σ_a v_a Z_a Z_aᵀ

Biases. The bias of a sensor at rest k is b + σ β_k, with the parameter b and a stationary Gauss–Markov chain β of unit
variance (19),

    β_0 ~ N(0, 1),   β_{k+1} − ρ_k β_k ~ N(0, 1 − ρ_k²),   ρ_k = e^{−Δt/τ}

Δt is the time between the middles of two rests; each file begins a new chain. The bias of a turn is
σ (β_k + β_{k+1})/2 or, if biases change at every rest and this is likelier, σ β_k or σ β_{k+1}. The β_k are unknowns of
the rests and their steps are rows that join neighbouring rests, as turns do, so that the cost of the elimination is
linear in the number of rests. With a short τ the process is a scatter from rest to rest; with a long τ it is a random
walk, which can follow a drift or a warm-up of any shape.

The parameter b is the mean of the process, which is the expected bias of another day. The bias of the session is the
mean over its rests, b + σ mean β.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from tumble.inference.elimination import whitening
from tumble.units import Array, BoolArray, IntArray

SCATTER_WORDS = {
    "accel": ("m/s^2", "readings of the accelerometers at rest"),
    "gyro": ("rad/s", "readings of the gyros at rest"),
    "turn": ("rad", "rotations of the turns"),
    "velocity": ("m/s", "velocities of the turns"),
    "apart": ("rad", "readings of the redundant gyros in turns"),
    "jumps": ("1", "velocities over jumps between samples"),
    "aliased": ("1", "rotations over jumps between samples"),
    "aliased_apart": ("1", "readings of the redundant gyros over jumps between samples"),
    "link_gyro": ("1", "noise of the gyros in motion, relative to quiet parts"),
    "link_accel": ("1", "noise of the accelerometers in motion, relative to quiet parts"),
    "mag": ("", "readings of the magnetometer, in its unit"),
}
SCATTER = tuple(SCATTER_WORDS)  # components of variance, independent between rests and between turns
REST_SCATTER, TURN_SCATTER, LINK_SCATTER = SCATTER[:2], SCATTER[2:8], SCATTER[8:10]
CORRELATION_TIME = 300.0  # s: usual correlation time of an in-run bias
DISPLACEMENT, DISPLACEMENT_TIME = 0.02, 0.5  # m, s: usual displacement in the hand or on a pivot, and correlation time
OMITTED = 2e-3  # square root of the weight below which a row is left out


def typical_noise(covariance: Array) -> float:
    """Return the median standard deviation of covariances (N, n, n), root mean square over components; 0 if N = 0."""
    if not len(covariance):
        return 0.0
    return float(np.sqrt(np.median(np.trace(covariance, axis1=1, axis2=2)) / covariance.shape[1]))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class VarianceComponents:
    """Standard deviations of the components of variance beside the noise within rests.

    For a stack of P sets of components each number is an array (P,), and `unlike` is (P, n).

    Parameters
    ----------
    accel, gyro
        Scatter of the readings from rest to rest, m/s² and rad/s.
    turn, velocity, apart
        Scatter of rotations, rad, and velocities, m/s, of turns, and of the integrals of spare gyros, rad.
    jumps
        Error of an integral over a jump between samples, relative to the jump times the sampling interval (18).
    aliased, aliased_apart
        Errors of rotations and of the integrals of spare gyros, relative to those of aliased samples.
    mag
        Scatter of the magnetometer from station to station, in its unit.
    accel_in_run, gyro_in_run, accel_time, gyro_time
        Standard deviation, SI, and correlation time, s, of the in-run bias of each kind of sensor.
    link_gyro, link_accel
        Additional noise of the samples in motion, relative to the noise of the quietest parts of the motion.
    displacement, displacement_time
        Standard deviation, m, and correlation time, s, of the displacement of a moving device from its pivot.
    unlike : (n,)
        Factors on the scatter at rest and in-run bias of each sensor, accelerometers first; empty if all are 1.
    """

    accel: float = 0.0
    gyro: float = 0.0
    turn: float = 0.0
    velocity: float = 0.0
    apart: float = 0.0
    jumps: float = 0.0
    aliased: float = 0.0
    aliased_apart: float = 0.0
    link_gyro: float = 0.0
    link_accel: float = 0.0
    mag: float = 0.0
    accel_in_run: float = 0.0
    gyro_in_run: float = 0.0
    accel_time: float = CORRELATION_TIME
    gyro_time: float = CORRELATION_TIME
    displacement: float = DISPLACEMENT
    displacement_time: float = DISPLACEMENT_TIME
    unlike: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def variances(self) -> Array:
        """Variances of the components in SCATTER."""
        return _stacked([getattr(self, name) for name in SCATTER]) ** 2

    @property
    def wanders(self) -> bool:
        """True if in-run biases are not all zero."""
        return bool(np.any(self.accel_in_run) or np.any(self.gyro_in_run))

    def in_run(self, accelerometers: int, gyros: int) -> tuple[Array, Array]:
        """Return standard deviations and correlation times (n,) of the in-run biases of all sensors."""
        by_kind = [self.accel_in_run, self.gyro_in_run], [self.accel_time, self.gyro_time]
        sigma, tau = (_stacked(numbers).repeat((accelerometers, gyros), axis=-1) for numbers in by_kind)
        return sigma * self.unlike if self.unlike.size else sigma, tau


NO_COMPONENTS = VarianceComponents()


def _stacked(numbers: list[Any]) -> Array:
    """Return n numbers, some of which may be arrays (…), as an array (…, n)."""
    shape = max((number.shape for number in numbers if isinstance(number, np.ndarray)), key=len, default=())
    out = np.empty((*shape, len(numbers)))
    for i, number in enumerate(numbers):
        out[..., i] = number
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseModel:
    """Noise of the residuals, with components of variance.

    Parameters
    ----------
    rest, turn, link : (N, r, r), (K, t, t) and (J, l, l)
        Covariances N of the residuals of rests, turns and links, without components of variance.
    rest_directions, turn_directions, link_directions : ((N, r, q), (q,)), …
        Directions Z of the components of variance, and the index of the component of each in SCATTER.
    rest_weights, turn_weights, link_weights : (N, r), (K, t) and (J, l)
        Square roots of weights of single rows, 1 except for outliers.
    interval : (M,)
        Time from the middle of each station to that of the next, s; infinite where a new chain of biases begins.
    displaced : (M,)
        The same for displacements, from node to node; None unless the device moves.
    follows : (M,)
        True if another station of the same session follows.
    sensors : (2,)
        Numbers of accelerometers and of gyros.
    components
        Components of variance.
    """

    rest: Array
    turn: Array
    link: Array
    rest_directions: tuple[Array, IntArray]
    turn_directions: tuple[Array, IntArray]
    link_directions: tuple[Array, IntArray]
    rest_weights: Array
    turn_weights: Array
    link_weights: Array
    interval: Array
    displaced: Array | None
    follows: BoolArray
    sensors: tuple[int, int]
    components: VarianceComponents = NO_COMPONENTS

    def at(self, components: VarianceComponents) -> NoiseModel:
        """Return the noise with other components of variance, keeping the cached properties that do not depend on
        them."""
        out = replace(self, components=components)
        vars(out).update(_unscaled_directions=self._unscaled_directions, whole=self.whole)
        return out

    @property
    def weights(self) -> tuple[Array, Array, Array]:
        """Square roots of the weights of rests, turns and links."""
        return self.rest_weights, self.turn_weights, self.link_weights

    def weighted(self, rest: Array, turn: Array, link: Array) -> NoiseModel:
        """Return the noise with other square roots of weights."""
        return replace(self, rest_weights=rest, turn_weights=turn, link_weights=link)

    @cached_property
    def variances(self) -> Array:
        """Variances (c,) of the components in SCATTER."""
        return self.components.variances

    @cached_property
    def whole(self) -> bool:
        """True if all rows have full weight."""
        return all(bool(np.all(w == 1.0)) for w in self.weights)

    @cached_property
    def _unscaled_directions(self) -> tuple[tuple[Array, IntArray], ...]:
        """Directions Z of rests, turns and links, zero in rows left out, and their indices in SCATTER."""
        directions = self.rest_directions, self.turn_directions, self.link_directions
        if self.whole:
            return directions
        pairs = zip(directions, self.weights, strict=True)
        return tuple((Z * (w > OMITTED)[:, :, None], place) for (Z, place), w in pairs)

    @cached_property
    def directions(self) -> tuple[tuple[Array, IntArray], ...]:
        """Directions Z of rests, turns and links, multiplied by the factors of single sensors."""
        (Z, place), *others = self._unscaled_directions
        unlike = self.components.unlike
        if not unlike.size:
            return self._unscaled_directions
        factors = np.ones((*unlike.shape[:-1], Z.shape[-1]))
        factors[..., : unlike.shape[-1]] = unlike
        return (Z * factors[..., None, None, :], place), *others

    @property
    def weighted_directions(self) -> tuple[tuple[Array, IntArray], ...]:
        """`directions` divided by the weights, for use with a whitening, which contains the weights."""
        if self.whole:
            return self.directions
        pairs = zip(self.directions, self.weights, strict=True)
        return tuple((Z / w[:, :, None], place) for (Z, place), w in pairs)

    @cached_property
    def biases(self) -> int:
        """Number of in-run biases among the states of a station."""
        return sum(self.sensors) if self.components.wanders else 0

    @cached_property
    def states(self) -> int:
        """Number of states of a station: in-run biases, then three displacements of a moving device."""
        return self.biases + (0 if self.displaced is None else 3)

    @cached_property
    def unknowns(self) -> int:
        """Number d of unknowns of a station: three angles, three velocities of a moving device, and the states."""
        return 3 + self.states + (0 if self.displaced is None else 3)

    def whitening(self) -> tuple[Array, Array, Array]:
        """Return inverse Cholesky factors of the covariances of rests (N, r, r), turns (K, t, t), links (J, l, l)."""
        kinds = zip((self.rest, self.turn, self.link), self.directions, self.weights, strict=True)
        rest, turn, link = (whitening(N, *directions, self.variances, w) for N, directions, w in kinds)
        return rest, turn, link

    def _with_displacements(self, biases: Array, displacements: Array | float) -> Array:
        """Return values of all states from those of n biases and of the displacements."""
        biases_only = biases if self.biases else biases[..., :0]
        if self.displaced is None:
            return biases_only
        displaced = np.broadcast_to(np.asarray(displacements)[..., None], (*biases.shape[:-1], 3))
        return np.concatenate([biases_only, displaced], axis=-1)

    @cached_property
    def _in_run(self) -> tuple[Array, Array]:
        return self.components.in_run(*self.sensors)

    @cached_property
    def state_sigma(self) -> Array:
        """Standard deviation σ (s,) of every state, SI."""
        return self._with_displacements(self._in_run[0], self.components.displacement)

    @cached_property
    def state_lapse(self) -> Array:
        """Δt/τ (M, s) of every state from each station to the next."""
        biases = np.asarray(self.interval[:, None] / self._in_run[1][..., None, :])
        if self.displaced is None:
            return self._with_displacements(biases, 0.0)
        return self._with_displacements(
            biases, self.displaced / np.asarray(self.components.displacement_time)[..., None]
        )

    @cached_property
    def state_rho(self) -> Array:
        """Correlation ρ (M, s) of every state with that at the next station."""
        return np.exp(-self.state_lapse)

    @cached_property
    def state_step(self) -> Array:
        """Standard deviation √(1 − ρ²) (M, s) of the step of every state."""
        return np.sqrt(-np.expm1(-2.0 * self.state_lapse))
