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

from collections.abc import Mapping
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
# Kinds of rows of the likelihood, with the number of stations whose unknowns each row has: readings and attitudes at a
# station, and turns and links from a station to the next.
STATIONS = {"accel": 1, "gyro": 1, "attitude": 1, "mag": 1, "turn": 2, "link": 2}
DISPLACEMENT, DISPLACEMENT_TIME = 0.02, 0.5  # m, s: usual displacement in the hand or on a pivot, and correlation time
OMITTED = 4e-6  # weight below which a row is left out


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

    def of_states(self, accelerometers: int, gyros: int, displacements: int = 0) -> tuple[Array, Array]:
        """Return standard deviations and correlation times (s,) of these numbers of in-run biases and displacements."""
        counts = accelerometers, gyros, displacements
        sizes = [self.accel_in_run, self.gyro_in_run, self.displacement]
        times = [self.accel_time, self.gyro_time, self.displacement_time]
        sigma, tau = (_stacked(numbers).repeat(counts, axis=-1) for numbers in (sizes, times))
        sigma[..., : self.unlike.shape[-1]] *= self.unlike
        return sigma, tau


NO_COMPONENTS = VarianceComponents()


def _stacked(numbers: list[Any]) -> Array:
    """Return n numbers, some of which may be arrays (…), as an array (…, n)."""
    shape = max((number.shape for number in numbers if isinstance(number, np.ndarray)), key=len, default=())
    out = np.empty((*shape, len(numbers)))
    for i, number in enumerate(numbers):
        out[..., i] = number
    return out


@dataclass(frozen=True, kw_only=True, eq=False)
class RowNoise:
    """Noise of the rows of one kind: K blocks of r rows, which are independent of each other.

    Parameters
    ----------
    sources : (K, r, r)
        Covariances by source of uncertainty. Their sum is N, the noise without components of variance.
    directions, component : (K, r, q) and (q,)
        Directions Z of the components of variance, and the index of the component of each in SCATTER.
    weight : (K,)
        Weights, 1 except for outliers.
    """

    sources: Mapping[str, Array]
    directions: Array
    component: IntArray
    weight: Array

    @cached_property
    def covariance(self) -> Array:
        """The covariances N (K, r, r)."""
        return np.asarray(sum(self.sources.values()))

    @cached_property
    def whole(self) -> bool:
        """True if all blocks have full weight."""
        return bool(np.all(self.weight == 1.0))

    @cached_property
    def kept_directions(self) -> Array:
        """Directions Z, zero in blocks left out."""
        return self.directions if self.whole else self.directions * (self.weight > OMITTED)[:, None, None]

    @cached_property
    def root_weights(self) -> Array:
        """Square roots of the weights of single rows (K, r)."""
        return np.repeat(np.sqrt(self.weight)[:, None], self.directions.shape[1], axis=1)


@dataclass(frozen=True, kw_only=True, eq=False)
class NoiseModel:
    """Noise of the residuals, with components of variance.

    Parameters
    ----------
    rows
        Noise of the rows of each kind.
    interval : (M, n) or (M, n + 3)
        Time from each station to the next, s, for the bias of every sensor and, if the device moves, its displacements;
        infinite where a new chain begins. It is the time between the middles of two rests.
    follows : (M,)
        True if another station of the same session follows.
    sensors : (2,)
        Numbers of accelerometers and of gyros.
    components
        Components of variance.
    """

    rows: Mapping[str, RowNoise]
    interval: Array
    follows: BoolArray
    sensors: tuple[int, int]
    components: VarianceComponents = NO_COMPONENTS

    @property
    def weights(self) -> dict[str, Array]:
        """Weights (K,) of the blocks, by kind of rows."""
        return {kind: rows.weight for kind, rows in self.rows.items()}

    @property
    def whole(self) -> bool:
        """True if all rows have full weight."""
        return all(rows.whole for rows in self.rows.values())

    def weighted(self, weights: Mapping[str, Array]) -> NoiseModel:
        """Return the noise with other weights (K,) of some kinds of rows."""
        return replace(self, rows={k: replace(r, weight=weights.get(k, r.weight)) for k, r in self.rows.items()})

    @cached_property
    def variances(self) -> Array:
        """Variances (c,) of the components in SCATTER."""
        return self.components.variances

    @cached_property
    def places(self) -> dict[str, slice]:
        """Places of the accelerometers and of the gyros among all sensors."""
        accelerometers, gyros = self.sensors
        return {"accel": slice(accelerometers), "gyro": slice(accelerometers, accelerometers + gyros)}

    @cached_property
    def directions(self) -> dict[str, Array]:
        """Directions Z (K, r, q) by kind of rows, with the factors of single sensors, and zero in blocks left out."""
        out, unlike = {kind: rows.kept_directions for kind, rows in self.rows.items()}, self.components.unlike
        for kind in self.places.keys() & out.keys() if unlike.size else ():
            out[kind] = out[kind] * unlike[..., None, None, self.places[kind]]
        return out

    @property
    def moves(self) -> bool:
        """True if the device moves; then stations have velocities and displacements."""
        return bool(self.interval.shape[1] > sum(self.sensors))

    @cached_property
    def biases(self) -> int:
        """Number of in-run biases among the states of a station."""
        return sum(self.sensors) if self.components.wanders else 0

    @cached_property
    def states(self) -> int:
        """Number of states of a station: in-run biases, then three displacements of a moving device."""
        return self.biases + 3 * self.moves

    @cached_property
    def unknowns(self) -> int:
        """Number d of unknowns of a station: three angles, three velocities of a moving device, and the states."""
        return 3 + 3 * self.moves + self.states

    def whitening(self) -> dict[str, Array]:
        """Return inverse Cholesky factors (K, r, r) of the covariances, by kind of rows."""
        return {
            kind: whitening(rows.covariance, self.directions[kind], rows.component, self.variances, rows.root_weights)
            for kind, rows in self.rows.items()
        }

    @cached_property
    def _of_states(self) -> tuple[Array, Array]:
        return self.components.of_states(*self.sensors, 3 * self.moves)

    @property
    def state_sigma(self) -> Array:
        """Standard deviation σ (s,) of every state, SI."""
        sigma, _ = self._of_states
        return sigma[..., sigma.shape[-1] - self.states :]

    @cached_property
    def state_lapse(self) -> Array:
        """Δt/τ (M, s) of every state from each station to the next."""
        first = self.interval.shape[1] - self.states
        return np.asarray(self.interval[:, first:] / self._of_states[1][..., None, first:])

    @cached_property
    def state_rho(self) -> Array:
        """Correlation ρ (M, s) of every state with that at the next station."""
        return np.exp(-self.state_lapse)

    @cached_property
    def state_step(self) -> Array:
        """Standard deviation √(1 − ρ²) (M, s) of the step of every state."""
        return np.sqrt(-np.expm1(-2.0 * self.state_lapse))
