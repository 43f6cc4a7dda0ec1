"""Components of variance beyond the noise within rests, the noise of rows with them, and the weights that follow."""

from __future__ import annotations

from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from tumble.estimation.elimination import whitening
from tumble.units import Array, IntArray

COMPONENTS = (
    *("accel", "gyro", "turn", "velocity", "apart", "jumps", "aliased", "aliased_apart"),
    *("accel_wandering", "gyro_wandering"),
)
"""The components of variance, in the order of `Scatter`."""
_components_of = attrgetter(*COMPONENTS)
OF_TURNS = slice(2, 8)
"""Those that concern turns alone."""
WANDERING = 8
"""How far those of sensors that wander stand from those of the others of their kind."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Scatter:
    """Standard deviations on top of the noise within rests: of a bias of the accelerometers (m/s²) and gyros (rad/s)
    from rest to rest, of the rotations (rad) and velocities (m/s) of turns, of the integrals (rad) of gyros beyond the
    rotation of the body, c of (A3), the error of the integral over a jump between samples in parts of its size times
    the interval, the error of a rotation in parts of what `aliased` samples would make it, that of what gyros say
    beyond it in the same parts, and of a bias from rest to rest of the accelerometers and gyros that wander more than
    the others."""

    accel: float = 0.0
    gyro: float = 0.0
    turn: float = 0.0
    velocity: float = 0.0
    apart: float = 0.0
    jumps: float = 0.0
    aliased: float = 0.0
    aliased_apart: float = 0.0
    accel_wandering: float = 0.0
    gyro_wandering: float = 0.0

    @property
    def variances(self) -> Array:
        """The squares, in the order of COMPONENTS."""
        return np.array(_components_of(self)) ** 2

    @property
    def of_turns(self) -> float:
        """The largest number of those that concern turns alone: whether there is any."""
        return float(max(getattr(self, name) for name in COMPONENTS[OF_TURNS]))

    @staticmethod
    def of_variances(variances: Array) -> Scatter:
        """The scatter of these squares."""
        return Scatter(**dict(zip(COMPONENTS, np.sqrt(variances).tolist(), strict=True)))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Noise:
    """Covariance of the rows without scatter, of the rests (N, r, r) and of the merged rows (K, r + t, r + t), and the
    directions Z (N, r, q), (K, r + t, q) of the components of variance, each with the place in COMPONENTS of the one it
    belongs to: Σ = N + Σ v Z Zᵀ."""

    rest: Array
    merged: Array
    rest_directions: tuple[Array, IntArray]
    merged_directions: tuple[Array, IntArray]

    def weights(self, scatter: Scatter) -> Weights:
        """The weights of the rows with a scatter."""
        variances = scatter.variances
        return Weights(
            rest=whitening(self.rest, *self.rest_directions, variances),
            merged=whitening(self.merged, *self.merged_directions, variances),
        )

    def variances_at_rest(self, scatter: Scatter) -> Array:
        """The variances of the rows of the rests (N, r) with a scatter, and"""
        return _variances(self.rest, self.rest_directions, scatter)

    def variances_merged(self, scatter: Scatter) -> Array:
        """those of the merged rows (K, r + t)."""
        return _variances(self.merged, self.merged_directions, scatter)


def _variances(noise: Array, directions: tuple[Array, IntArray], scatter: Scatter) -> Array:
    """The diagonals (N, n) of N + Σ v Z Zᵀ."""
    Z, component = directions
    return np.asarray(np.diagonal(noise, axis1=1, axis2=2) + Z**2 @ scatter.variances[component])


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Weights:
    """Inverses of the Cholesky factors of the covariances of the rows: of the rests (N, r, r), which count where no
    turn follows, and of the merged rows of rests and turns (K, r + t, r + t)."""

    rest: Array
    merged: Array
