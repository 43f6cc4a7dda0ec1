"""How uncertain the parameters are by what errs alike in a whole session, so that no residual shows it.

Rounding. Where noise does not cover the steps L of a channel, the mean of many samples errs by a sawtooth of the place
of the true value between two steps (`tumble.reduction.noise.rounding`). Rests that read the same err by the same, and
so does a turn about another axis: the error is one of the bias. Of rests whose true values scatter by s the part
e^(−2π²s²/L²) of it is common, of accelerometers in several attitudes nothing. Readings scatter by up to
1 + 2 Σ_k e^(−2π²k²σ²/L²) times as much as the true values, which between two steps they do.

Time base. A clock that is fast by ε makes every turn longer by ε, and with it every scale factor of the gyros larger,
unless their increments are angles already. Accelerometers are compared with gravity, whatever the time; but what is an
increment of velocity divided by its interval is less by ε. Biases, delays and levers change by ε of themselves, which
is nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from tumble.sensors.instrument import Instrument
from tumble.sensors.parameters import group_name
from tumble.units import Array

if TYPE_CHECKING:
    from tumble.reduction.noise.rounding import Rounding
    from tumble.reduction.observations import Observations

_HARMONICS = np.arange(1, 40)


def common_covariances(observations: Observations, instrument: Instrument) -> dict[str, Array]:
    """Covariances (m, m) of the parameters by rounding and by the time base (`clock`), on top of that by noise."""
    by_clock, u = by_time_base(instrument.names, observations.by_clock), np.zeros(len(instrument.names))
    for block, readings in ((instrument.accel, observations.rests.accel), (instrument.gyro, observations.rests.gyro)):
        if block is not None and block.kind in observations.rounding:
            size = common_rounding(observations.rounding[block.kind], readings)
            u[instrument.group_columns(f"{block.kind}.bias")] = size[block.channels]
    return {"rounding": np.diag(u**2), "clock": np.outer(by_clock, by_clock)}


def common_rounding(rounding: Rounding, readings: Array) -> Array:
    """Standard uncertainty (n,) of what is common to the mean readings (N, n) of all rests by rounding."""
    step = np.where(rounding.step > 0.0, rounding.step, 1.0)
    smoothed = np.exp(-2.0 * (np.pi * np.outer(rounding.noise / step, _HARMONICS)) ** 2)
    scatter = readings.std(axis=0) / step / (1.0 + 2.0 * smoothed.sum(axis=1))
    return np.asarray(rounding.common_u * np.exp(-2.0 * (np.pi * scatter) ** 2))


def clocked(clock_u: float, increments: Mapping[str, bool]) -> dict[str, float]:
    """What one standard uncertainty of the time base, relative, changes in parameters, by group; `increments` says of
    each kind of sensor whether its readings were."""
    sizes = {"gyro.scale": clock_u * (not increments.get("gyro", True)), "accel.scale": -clock_u * increments["accel"]}
    return {group: size for group, size in sizes.items() if size != 0.0}


def by_time_base(names: Sequence[str], by_clock: Mapping[str, float]) -> Array:
    """The same in parameters of these names (m,)."""
    return np.array([by_clock.get(group_name(name), 0.0) for name in names])
