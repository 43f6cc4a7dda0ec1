"""The unit of gyros that no turn tells, by what they read at rest: no gyro has a bias of 20 °/s, nor scatters by
0.17 °/s in a second on a table. What reads more in rad/s is in deg/s."""

from __future__ import annotations

import numpy as np

from tumble.reduction.observations import Observations
from tumble.units import DEGREE

_LARGEST_BIAS = 20.0 * DEGREE
_LARGEST_NOISE = 0.17 * DEGREE  # rad/s in a second
_ON_A_TABLE = 0.015
"""m/s² in a second: accelerometers that scatter more are held in a hand, or on a machine that runs."""


def more_than_gyros_read(observations: Observations) -> str | None:
    """Why gyros read more at rest than they do in rad/s, in words; None where they do not."""
    rests = observations.rests
    bias = float(np.median(np.linalg.norm(rests.gyro, axis=1)))
    of_gyro, of_accel = (
        float(np.median(np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 3.0 * (rests.stop - rests.start))))
        for covariance in (rests.gyro_covariance, rests.accel_covariance)
    )
    if bias > _LARGEST_BIAS:
        return f"at rest they read {bias:.3g}, which in rad/s would be {bias / DEGREE:.3g} °/s"
    if of_gyro > _LARGEST_NOISE and of_accel < _ON_A_TABLE:
        return f"at rest they scatter by {of_gyro:.2g} in a second, which in rad/s would be {of_gyro / DEGREE:.2g} °/s"
    return None
