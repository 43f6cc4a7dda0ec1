"""Noise of the rows of rests and turns: covariances, scatter along known directions, and in-run biases as a process.

Rows. The covariance of the rows of a rest or a turn is N of the noise of its samples and, along a few directions Z, the
variances v of the components of scatter, docs/explanation/mathematics.md (16) to (18):

    Σ = N + Σ_a v_a Z_a Z_aᵀ

Biases. The bias of a sensor at rest k is b + σ β_k, b its parameter, β a stationary Gauss–Markov chain of unit variance
(19),

    β_0 ~ N(0, 1),   β_{k+1} − ρ_k β_k ~ N(0, 1 − ρ_k²),   ρ_k = e^{−Δt/τ}

Δt is the time between the middles of two rests; a recording that begins anew begins the chain anew. A turn has
σ (β_k + β_{k+1})/2 or, where biases are anew at every rest and that is likelier, σ β_k or σ β_{k+1}. The β_k are
unknowns of the rests, their steps rows that join neighbouring rests as turns do, so that the elimination from rest to
rest has them at a cost that is linear in rests. τ short makes a scatter from rest to rest, τ long a random walk, in
which a drift is, and a warm-up of any shape.

The parameter b is the mean of the process, what the bias of another day or of the next minute is about; what was
observed is the mean over the rests of the session, b + σ mean β.
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
    "apart": ("rad", "what spare gyros say of the turns"),
    "jumps": ("1", "velocities over jumps between samples"),
    "aliased": ("1", "rotations over jumps between samples"),
    "aliased_apart": ("1", "what spare gyros say over jumps between samples"),
    "link_gyro": ("1", "noise of the gyros in motion, over that of its quiet parts"),
    "link_accel": ("1", "noise of the accelerometers in motion, over that of its quiet parts"),
    "mag": ("", "readings of the magnetometer, in its unit"),
}
SCATTER = tuple(SCATTER_WORDS)
"""The components of scatter, white from rest to rest and from turn to turn."""
TURN_SCATTER = SCATTER[2:8]
"""Those that concern turns alone."""
LINK_SCATTER = SCATTER[8:10]
"""Those of links."""
REST_SCATTER = SCATTER[:2]
"""Those of readings at rest."""
CORRELATION_TIME = 300.0
"""s: the usual correlation time of an in-run bias."""
DISPLACEMENT, DISPLACEMENT_TIME = 0.02, 0.5
"""m and s: the usual displacement of a device in the hand or on a pivot, and its correlation time."""

OMITTED = 2e-3
"""A row whose weight has a root below it is left out."""


def typical_noise(covariance: Array) -> float:
    """Standard deviation of a component of the median row, of covariances (N, n, n); 0 of none."""
    if not len(covariance):
        return 0.0
    return float(np.sqrt(np.median(np.trace(covariance, axis1=1, axis2=2)) / covariance.shape[1]))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class VarianceComponents:
    """Standard deviations of the components of variance beside the noise within rests.

    Parameters
    ----------
    accel, gyro
        Scatter of the readings at rest, m/s² and rad/s, from rest to rest.
    turn, velocity, apart
        Scatter of rotations, rad, and velocities, m/s, of turns, and of the integrals of gyros beyond the rotation of
        the body, rad.
    jumps
        The error of the integral over a jump between samples in parts of its size times the interval (18).
    aliased, aliased_apart
        The error of a rotation, and of what gyros say beyond it, in parts of what aliased samples would make it.
    mag
        Scatter of the readings of the magnetometer, in its unit, from station to station.
    accel_in_run, gyro_in_run, accel_time, gyro_time
        Size, SI, and correlation time, s, of the in-run bias of each kind of sensor.
    link_gyro, link_accel
        Noise of the samples in motion beside that of its quietest parts, over that.
    displacement, displacement_time
        Size, m, and correlation time, s, of the displacement of a device that is moved from where its pivot has it.
    unlike : (n,)
        How many times larger the scatter at rest and the in-run bias of a sensor are than those of its kind,
        accelerometers before gyros; 1 where empty.

    Notes
    -----
    Of a stack of components each number is an array (P,), `unlike` (P, n).
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
        """The squares of those of SCATTER."""
        return _stacked([getattr(self, name) for name in SCATTER]) ** 2

    @property
    def wanders(self) -> bool:
        """Whether biases are a process in time."""
        return bool(np.any(self.accel_in_run) or np.any(self.gyro_in_run))

    def in_run(self, accelerometers: int, gyros: int) -> tuple[Array, Array]:
        """Standard deviations and correlation times (n,) of the in-run biases of sensors, accelerometers first."""
        both = (self.accel_in_run, self.gyro_in_run), (self.accel_time, self.gyro_time)
        sigma, tau = (_stacked(list(kinds)).repeat((accelerometers, gyros), axis=-1) for kinds in both)
        return sigma * self.unlike if self.unlike.size else sigma, tau


NO_COMPONENTS = VarianceComponents()


def _stacked(numbers: list[Any]) -> Array:
    """Numbers, some of which may be arrays (...), as one array (..., n)."""
    stack = max((each.shape for each in numbers if isinstance(each, np.ndarray)), key=len, default=())
    return np.stack([np.broadcast_to(each, stack) for each in numbers], axis=-1) if stack else np.array(numbers)


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseModel:
    """The noise of the rows at given components of variance.

    Parameters
    ----------
    rest, turn, link : (N, r, r), (K, t, t) and (J, l, l)
        Covariances N of the rows of rests, turns and links without scatter.
    rest_directions, turn_directions, link_directions : ((N, r, q), (q,)), …
        Directions Z of the components of scatter, each with the place in SCATTER of the one it belongs to.
    rest_weights, turn_weights, link_weights : (N, r), (K, t) and (J, l)
        Square roots of the weights that single rows have beside that: 1 but for those that do not fit.
    interval : (M,)
        Time, s, from the middle of each station to that of the next one, infinite where the chain of biases begins
        anew.
    displaced : (M,)
        The same of displacements, from node to node; None where no device is moved.
    follows : (M,)
        Whether a station of the same session follows.
    sensors : (2,)
        Numbers of accelerometers and of gyros.
    components
        The components of variance.
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
        """The same with other components of variance, and with what does not depend on these, made but once."""
        out = replace(self, components=components)
        vars(out).update(_seen=self._seen, whole=self.whole)
        return out

    @property
    def weights(self) -> tuple[Array, Array, Array]:
        """Square roots of the weights of the rows of rests, turns and links."""
        return self.rest_weights, self.turn_weights, self.link_weights

    def weighted(self, rest: Array, turn: Array, link: Array) -> NoiseModel:
        """The same with other square roots of the weights of single rows."""
        return replace(self, rest_weights=rest, turn_weights=turn, link_weights=link)

    @cached_property
    def variances(self) -> Array:
        """The variances (c,) of the components of SCATTER."""
        return self.components.variances

    @cached_property
    def whole(self) -> bool:
        """Whether all rows have their whole weight."""
        return all(bool(np.all(w == 1.0)) for w in self.weights)

    @cached_property
    def _seen(self) -> tuple[tuple[Array, IntArray], ...]:
        """The directions Z of the scatter of rests, turns and links, and their places in SCATTER. Rows that are left
        out have no scatter, of which they show nothing."""
        every = self.rest_directions, self.turn_directions, self.link_directions
        if self.whole:
            return every
        pairs = zip(every, self.weights, strict=True)
        return tuple((Z * (w > OMITTED)[:, :, None], place) for (Z, place), w in pairs)

    @cached_property
    def directions(self) -> tuple[tuple[Array, IntArray], ...]:
        """The same, those of sensors unlike others longer."""
        (Z, place), *others = self._seen
        unlike = self.components.unlike
        if not unlike.size:
            return self._seen
        longer = np.ones((*unlike.shape[:-1], Z.shape[-1]))
        longer[..., : unlike.shape[-1]] = unlike
        return (Z * longer[..., None, None, :], place), *others

    @property
    def weighted_directions(self) -> tuple[tuple[Array, IntArray], ...]:
        """The same, longer where rows count less: their whitening has the weights in it."""
        if self.whole:
            return self.directions
        each = zip(self.directions, self.weights, strict=True)
        return tuple((Z / w[:, :, None], place) for (Z, place), w in each)

    @cached_property
    def biases(self) -> int:
        """How many biases are states of the stations: n, or none where they do not wander."""
        return sum(self.sensors) if self.components.wanders else 0

    @cached_property
    def states(self) -> int:
        """How many states a station has: biases, then three displacements of a device that is moved."""
        return self.biases + (0 if self.displaced is None else 3)

    @cached_property
    def unknowns(self) -> int:
        """d, the unknowns of a station: three angles, three velocities of a device that is moved, and the states."""
        return 3 + self.states + (0 if self.displaced is None else 3)

    def whitening(self) -> tuple[Array, Array, Array]:
        """Inverses of the Cholesky factors of the covariances of the rows of rests (N, r, r), turns (K, t, t) and links
        (J, 9, 9)."""
        variances = self.variances
        every = zip((self.rest, self.turn, self.link), self.directions, self.weights, strict=True)
        rest, turn, link = (whitening(N, *directions, variances, w) for N, directions, w in every)
        return rest, turn, link

    def _of_states(self, of_biases: Array, of_displacements: Array | float) -> Array:
        """Values of all states, of those of the biases and of the displacements."""
        own = of_biases if self.biases else of_biases[..., :0]
        if self.displaced is None:
            return own
        displaced = np.broadcast_to(np.asarray(of_displacements)[..., None], (*of_biases.shape[:-1], 3))
        return np.concatenate([own, displaced], axis=-1)

    @cached_property
    def _in_run(self) -> tuple[Array, Array]:
        """Standard deviations and correlation times (n,) of the in-run biases."""
        return self.components.in_run(*self.sensors)

    @cached_property
    def state_sigma(self) -> Array:
        """σ (s,) of every state, SI."""
        return self._of_states(self._in_run[0], self.components.displacement)

    @cached_property
    def state_lapse(self) -> Array:
        """Δt/τ (M, s) of every state from every station to the next one."""
        tau = self._in_run[1]
        of_biases = np.asarray(self.interval[:, None] / tau[..., None, :])
        if self.displaced is None:
            return self._of_states(of_biases, 0.0)
        time = np.asarray(self.components.displacement_time)[..., None]
        return self._of_states(of_biases, self.displaced / time)

    @cached_property
    def state_rho(self) -> Array:
        """ρ (M, s), the correlation of every state with that at the next station."""
        return np.exp(-self.state_lapse)

    @cached_property
    def state_step(self) -> Array:
        """√(1 − ρ²) (M, s), the standard deviation of a step of the states."""
        return np.sqrt(-np.expm1(-2.0 * self.state_lapse))
