"""The compiled model of a triad with its derivatives: sensing axes by Eq. (1), times scale factors.

The axis of a sensor that nominally senses body axis a leans by an angle ν towards the next axis, in the order x, y, z,
x, and by an angle β back towards the one before. Its components are

    cos ν cos β along a,    sin ν along the next,    cos ν sin β along the one before                              (1)

It is Python and runs as it stands; see `tumble.reduction.kernels`. `triad_axes.pxd` says what of it is compiled.
"""

from __future__ import annotations

from tumble.units import Array, IntArray

try:
    import cython
except ImportError:
    from tumble import uncompiled as cython

if not cython.compiled:
    from numpy import cos, sin


def linearise(axes: Array, channels: IntArray, angles: IntArray, values: Array, model: Array, jacobian: Array) -> None:
    """Fill in [matrix | bias] (3, 4) of a triad with nominal `axes` (3, 3) at values of the parameters (m,), bias,
    scale-factor error and angles, and its derivative (3, 4, m), which begins as zeros. `channels` (3,) are those that
    sense body axis 0, 1, 2, and `angles` (3, 2) where ν and β of each stand among the parameters, −1 where it is 0."""
    for a in range(3):
        p, after, before = channels[a], (a + 1) % 3, (a + 2) % 3
        sign = axes[p, a]
        gain = sign * (1.0 + values[3 + a])
        first, second = angles[a, 0], angles[a, 1]
        onward = values[first] if first >= 0 else 0.0
        back = values[second] if second >= 0 else 0.0
        x, y, z = cos(onward) * cos(back), sin(onward), cos(onward) * sin(back)
        model[p, a], model[p, after], model[p, before], model[p, 3] = gain * x, gain * y, gain * z, values[a]
        jacobian[p, 3, a] = 1.0
        jacobian[p, a, 3 + a], jacobian[p, after, 3 + a], jacobian[p, before, 3 + a] = sign * x, sign * y, sign * z
        if first >= 0:
            jacobian[p, a, first], jacobian[p, after, first] = -gain * y * cos(back), gain * cos(onward)
            jacobian[p, before, first] = -gain * y * sin(back)
        if second >= 0:
            jacobian[p, a, second], jacobian[p, before, second] = -gain * z, gain * x
