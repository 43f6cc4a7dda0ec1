"""The readings of a magnetometer at the stations of a session, rests or nodes.

    m = S e^{τ[ω×]} v + b,   v = Lᵀ h,   h = F (cos I cos D, −sin I, cos I sin D)                               (47)

L is the attitude (body → north, up, east) and ω the rate there, S (3, 3) the sensitivity in the frame of the
accelerometers, which contains the soft iron and the rotation of the magnetometer, b the hard iron, τ the delay of the
readings, which a rest does not show, I the dip of the field and D its declination. The modulus F is fixed, for only
its product with S is seen. S and b are those of three sensors near the axes of `block`, with the six axis angles of
gyros. The declination is that of the heading where gyros see it, and has its prior else.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.rotation import rotation_matrix, skew
from tumble.sensors.model import Block, SensorModel
from tumble.sensors.parameters import limits_of
from tumble.units import Array

DIP_U, DECLINATION_U, DELAY_U = 1.0, 0.3, 0.02
"""Standard deviations of the priors of the dip and the declination, rad, and of the delay, s: nine of ten places have a
declination below 25°."""
OWN = 15
"""Unknowns of a magnetometer: the 12 parameters of its block, dip, declination and delay."""
DIP, DECLINATION, DELAY = 12, 13, 14
"""Where these stand."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Magnetometer:
    """A magnetometer whose axes are near those of a `block`, in a field of modulus `field`, in its unit, and of about
    the dip `dip`, rad."""

    block: Block
    field: float
    dip: float

    @property
    def u(self) -> Array:
        """Standard deviations (OWN,) of the unknowns beforehand, about zero."""
        limits = limits_of(self.block.names)
        limits[:3] *= self.field
        return np.concatenate([limits, [DIP_U, DECLINATION_U, DELAY_U]])

    def parameters(self, own: Array) -> Array:
        """The parameters (12,) of the block, of unknowns (OWN,)."""
        return own[:DIP]

    def model(self, own: Array) -> SensorModel:
        """Sensitivity and bias, of unknowns (OWN,)."""
        return self.block.model(self.parameters(own))

    def north_up_east(self, own: Array) -> tuple[Array, Array]:
        """The field (3,), and its derivatives (3, 2) by dip and declination."""
        dip, declination = self.dip + own[DIP], own[DECLINATION]
        (s, c), (t, d) = ((np.sin(x), np.cos(x)) for x in (dip, declination))
        field = np.array([c * d, -s, c * t])
        return self.field * field, self.field * np.array([[-s * d, -c * t], [-c, 0.0], [-s * t, c * d]])

    def rows(self, own: Array, attitudes: Array, basis: Array, rates: Array) -> tuple[Array, Array, Array]:
        """Readings that are expected, and their derivatives.

        Parameters
        ----------
        own : (OWN,)
            Unknowns.
        attitudes, basis : (K, 3, 3)
            Attitudes, and the axes of the angles that change them, in columns.
        rates : (K, 3)
            Rates of the body, rad/s.

        Returns
        -------
        expected, by_angles, by_own : (K, 3), (K, 3, 3), (K, 3, OWN)
        """
        model, jacobian = self.block.linearised(self.parameters(own))
        S, (field, by_direction) = model[:, :3], self.north_up_east(own)
        v, late = field @ attitudes, rotation_matrix(own[DELAY] * rates)
        seen = (late @ v[:, :, None])[:, :, 0]
        by_own = np.empty((len(v), 3, OWN))
        by_own[:, :, :DIP] = np.einsum("pqm,kq->kpm", jacobian, np.column_stack([seen, np.ones(len(v))]))
        by_own[:, :, DIP:DELAY] = S @ late @ np.swapaxes(attitudes, 1, 2) @ by_direction
        by_own[:, :, DELAY] = np.cross(rates, seen) @ S.T
        return seen @ S.T + model[:, 3], S @ late @ skew(v) @ basis, by_own
