"""Model of magnetometer readings at the stations of a session, rests or nodes.

    m = S e^{τ[ω×]} v + b,   v = Lᵀ h,   h = F (cos I cos D, −sin I, cos I sin D)                               (47)

L is the attitude (body → north, up, east) and ω the rate there, S (3, 3) the sensitivity in the frame of the
accelerometers, with soft iron and the rotation of the magnetometer, b the hard iron, τ the delay of the readings, which
has no effect at rest, I the dip of the field and D its declination. The modulus F is fixed, because only its product
with S is observed. S and b are those of three sensors near the axes of `block`, with the six axis angles of gyros. The
declination is determined if the gyros observe the heading; otherwise it has its prior.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tumble.rotation import rotation_matrix, skew
from tumble.sensors.model import Block, SensorModel
from tumble.sensors.parameters import limits_of
from tumble.units import Array

# Prior standard deviations of dip and declination, rad, and delay, s: nine of ten places have a declination below 25°.
DIP_U, DECLINATION_U, DELAY_U = 1.0, 0.3, 0.02
OWN = 15  # unknowns of a magnetometer: the 12 parameters of its block, then dip, declination and delay
DIP, DECLINATION, DELAY = 12, 13, 14


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Magnetometer:
    """Magnetometer with axes near those of `block` in a field of modulus `field`, in its unit, and dip near `dip`,
    rad."""

    block: Block
    field: float
    dip: float

    @property
    def u(self) -> Array:
        """Prior standard deviations (OWN,) of the unknowns about zero."""
        limits = limits_of(self.block.names)
        limits[:3] *= self.field
        return np.concatenate([limits, [DIP_U, DECLINATION_U, DELAY_U]])

    def model(self, unknowns: Array) -> SensorModel:
        """Return sensitivity and bias at unknowns (OWN,)."""
        return self.block.model(unknowns[:DIP])

    def rows(self, unknowns: Array, attitudes: Array, basis: Array, rates: Array) -> tuple[Array, Array, Array]:
        """Return expected readings (K, 3), and derivatives by angles (K, 3, 3) and by the unknowns (K, 3, OWN).

        Parameters
        ----------
        unknowns : (OWN,)
            Values of the unknowns.
        attitudes, basis : (K, 3, 3)
            Attitudes, and the axes of their angles, in columns.
        rates : (K, 3)
            Rates of the body, rad/s.
        """
        model, jacobian = self.block.linearised(unknowns[:DIP])
        S, angles = model[:, :3], np.array([self.dip + unknowns[DIP], unknowns[DECLINATION]])
        (s, t), (c, d) = np.sin(angles), np.cos(angles)
        field = self.field * np.array([c * d, -s, c * t])  # h
        by_direction = self.field * np.array([[-s * d, -c * t], [-c, 0.0], [-s * t, c * d]])  # by dip and declination
        v, late = field @ attitudes, rotation_matrix(unknowns[DELAY] * rates)
        delayed = (late @ v[:, :, None])[:, :, 0]
        by_unknowns = np.empty((len(v), 3, OWN))
        by_unknowns[:, :, :DIP] = np.einsum("pqm,kq->kpm", jacobian, np.column_stack([delayed, np.ones(len(v))]))
        by_unknowns[:, :, DIP:DELAY] = S @ late @ np.swapaxes(attitudes, 1, 2) @ by_direction
        by_unknowns[:, :, DELAY] = np.cross(rates, delayed) @ S.T
        return delayed @ S.T + model[:, 3], S @ late @ skew(v) @ basis, by_unknowns
