"""Components of variance beside the noise within rests, and the weights of the rows with them.

The covariance of the rows of a rest or a turn is that of the noise of its samples and, along a few directions Z, the
components v of scatter, Σ = N + Σ v Z Zᵀ; the in-run biases are a process beside them (`tumble.inference.in_run`).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tumble.inference.elimination import whitening
from tumble.units import Array, IntArray

SCATTER_WORDS = {
    "accel": ("m/s^2", "readings of the accelerometers at rest"),
    "gyro": ("rad/s", "readings of the gyros at rest"),
    "turn": ("rad", "rotations of the turns"),
    "velocity": ("m/s", "velocities of the turns"),
    "apart": ("rad", "what spare gyros say of the turns"),
    "jumps": ("1", "velocities over jumps between samples"),
    "aliased": ("1", "rotations over jumps between samples"),
    "aliased_apart": ("1", "what spare gyros say over jumps between samples"),
}
SCATTER = tuple(SCATTER_WORDS)
"""The components of scatter, white from rest to rest and from turn to turn."""
OF_TURNS = SCATTER[2:]
"""Those that concern turns alone."""
CORRELATION_TIME = 300.0
"""s: the usual correlation time of an in-run bias."""
REST_MODES = {name: SCATTER_WORDS[name][1] for name in SCATTER[:2]}


def typical_noise(covariance: Array) -> float:
    """Standard deviation of a component of the median row, of covariances (N, n, n)."""
    return float(np.sqrt(np.median(np.trace(covariance, axis1=1, axis2=2)) / covariance.shape[1]))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Components:
    """Components of variance beside the noise within rests, as standard deviations: of the readings at rest of the
    accelerometers (m/s²) and gyros (rad/s) from rest to rest; of the rotations (rad) and velocities (m/s) of turns; of
    the integrals (rad) of gyros beyond the rotation of the body; c of docs/explanation/mathematics.md (18), the error
    of the integral over a jump between samples in parts of its size times the interval; the error of a rotation in
    parts of what `aliased` samples would make it, and that of what gyros say beyond it in the same parts. Then the
    in-run bias of each kind, a stationary Gauss–Markov process: its standard deviation and correlation time (s). By how
    many times the scatter at rest and the in-run bias of a sensor are larger than those of its kind is `unlike` (n,),
    accelerometers before gyros; 1 where empty. Of a stack of components each number is an array."""

    accel: float = 0.0
    gyro: float = 0.0
    turn: float = 0.0
    velocity: float = 0.0
    apart: float = 0.0
    jumps: float = 0.0
    aliased: float = 0.0
    aliased_apart: float = 0.0
    accel_in_run: float = 0.0
    gyro_in_run: float = 0.0
    accel_time: float = CORRELATION_TIME
    gyro_time: float = CORRELATION_TIME
    unlike: Array = field(default_factory=lambda: np.zeros(0))

    @property
    def variances(self) -> Array:
        """The squares of those of SCATTER."""
        return _stacked([getattr(self, name) for name in SCATTER]) ** 2

    @property
    def of_turns(self) -> float:
        """The largest number of those that concern turns alone: whether there is any."""
        return float(max(getattr(self, name) for name in OF_TURNS))

    @property
    def wanders(self) -> bool:
        """Whether biases are a process in time."""
        return bool(np.any(self.accel_in_run) or np.any(self.gyro_in_run))

    def in_run(self, accelerometers: int, gyros: int) -> tuple[Array, Array]:
        """Standard deviations and correlation times (n,) of the in-run biases of sensors, accelerometers first."""
        of = np.repeat([0, 1], [accelerometers, gyros])
        sigma = _stacked([self.accel_in_run, self.gyro_in_run])[..., of]
        tau = _stacked([self.accel_time, self.gyro_time])[..., of]
        return sigma * self.unlike if self.unlike.size else sigma, tau


NO_COMPONENTS = Components()


def _stacked(numbers: list[Any]) -> Array:
    """Numbers, some of which may be arrays (...), as one array (..., n)."""
    out = np.empty((*max((np.shape(each) for each in numbers), key=len), len(numbers)))
    for i, each in enumerate(numbers):
        out[..., i] = each
    return out


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Noise:
    """Covariance of the rows without scatter, of the rests (N, r, r) and of the turns (K, t, t), and the directions Z
    (N, r, q), (K, t, q) of the components of scatter, each with the place in SCATTER of the one it belongs to:
    Σ = N + Σ v Z Zᵀ. `kept` are the square roots (N, r), (K, t) of the weights that single rows have beside that: 1 but
    for those of rests and turns that do not fit."""

    rest: Array
    turn: Array
    rest_directions: tuple[Array, IntArray]
    turn_directions: tuple[Array, IntArray]
    kept: tuple[Array, Array]

    def at_rest(self, components: Components) -> tuple[Array, IntArray]:
        """The directions of the scatter at rest, those of sensors unlike others longer, and what they are of."""
        Z, of = self.rest_directions
        return (Z * components.unlike[..., None, None, :] if components.unlike.size else Z), of

    def weights(self, components: Components) -> Weights:
        """The weights of the rows with components of variance."""
        variances = components.variances
        rest = whitening(self.rest, *self.at_rest(components), variances) * self.kept[0][:, None]
        turn = whitening(self.turn, *self.turn_directions, variances) * self.kept[1][:, None]
        return Weights(rest=rest, turn=turn, components=components)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Weights:
    """Inverses of the Cholesky factors of the covariances of the rows of rests (N, r, r) and of turns (K, t, t), and
    the components of variance they are with."""

    rest: Array
    turn: Array
    components: Components
