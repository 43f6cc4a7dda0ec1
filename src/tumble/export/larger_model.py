"""What a format loses that has no place for the groups of parameters beyond the linear model, and how large that is.

The size is the largest change of a reading that a group makes, over all attitudes at 1 g, and for what only motion
shows at the rate of the session's turns.
"""

from __future__ import annotations

from collections.abc import Container

import numpy as np

from tumble.inference.prediction import directions
from tumble.result.calibration import Calibration
from tumble.sensors.instrument import Instrument, functions
from tumble.sensors.parameters import (
    FORCE,
    ParameterGroup,
    group_name,
    groups,
    positions_by_group,
    sensor_kind,
    within_kind,
)
from tumble.units import DEGREE, G_STANDARD, Array

USUAL_RATE = 100.0 * DEGREE
"""rad/s, where a calibration does not say how fast its turns were."""
NEGLIGIBLE = 0.1
"""Of the standard uncertainty of a reading: it adds less than √(1 + 0.1²) − 1 = 0.5 % to that."""
WARMER, HOUR = 10.0, 3600.0
"""K and s over which changes are stated."""
HEATING = 1.0 / 60.0
"""K/s at which the effect of a lag is stated."""
NO_PLACE = "no place in this file"
NOT_IN_MATRIX = "not in matrix and bias"


def not_held(calibration: Calibration, held: Container[str] = (), said: str = NO_PLACE) -> tuple[str, ...]:
    """A sentence for each group beyond the linear model that the calibration has and that is not `held`: those of
    accelerometers and those of gyros, of each the largest first; and one for all those that are NEGLIGIBLE."""
    absent = [kind for kind, model in (("accel", calibration.accel), ("gyro", calibration.gyro)) if model is None]
    if len(absent) == 2:
        return ()
    present = positions_by_group(p.name for p in calibration.parameters if sensor_kind(p.name) not in absent)
    lost = [group for group in groups() if not group.linear and group.name in present and group.name not in held]
    effects = [(group, *_largest(calibration, group)) for group in lost]
    effects.sort(key=lambda each: (each[0].kind, -each[1]))
    known, felt, rest = calibration.prediction, [], []
    u = {"accel": 0.0 if known is None else known.force_u, "gyro": 0.0 if known is None else known.rate_u or 0.0}
    for group, size, where in effects:
        words = group.words.partition(",")[0].replace("−", "-")
        if size < NEGLIGIBLE * u[group.kind]:
            rest.append(words)
            continue
        shown = f"{size / (1e-3 * G_STANDARD):.3g} mg" if group.kind == "accel" else f"{size / DEGREE:.3g} deg/s"
        felt.append(f"{words}: {said}, an error of up to {shown} {where}")
    if rest:
        felt.append(f"{'; '.join(rest)}: {said}, errors of less than a tenth of the standard uncertainty of a reading")
    return tuple(felt)


def session_rate(calibration: Calibration) -> float:
    """The rate, rad/s, of the turns of a session, or a usual one."""
    if calibration.prediction is None or calibration.prediction.at_rate is None:
        return USUAL_RATE
    return calibration.prediction.at_rate


def _largest(calibration: Calibration, group: ParameterGroup) -> tuple[float, str]:
    """The largest effect of a group on a reading, SI, and where."""
    rate = session_rate(calibration)
    at_rate = f"at {rate / DEGREE:.3g} deg/s"
    felt, where = (G_STANDARD, "in 1 g") if group.kind == "accel" else (rate, at_rate)
    compensator, values = calibration.compensator, {p.name: p.value for p in calibration.parameters}
    block = compensator.accel if group.kind == "accel" else compensator.gyro
    names = () if block is None else group.names(block)
    own = np.array([values[name] for name in values if name in names])
    if group.motion == "lever":
        return rate**2 * float(np.linalg.norm(own.reshape(-1, 3), axis=1).max()), at_rate
    if group.motion in ("delay", "single delay"):
        return rate * G_STANDARD * float(np.abs(own).max()), f"in 1 g {at_rate}"
    if group.variable == "lag":  # on a bias of the accelerometers
        slopes = [abs(value) for name, value in values.items() if group_name(name) == "accel.bias.t1"]
        return abs(float(own[0])) * HEATING * max(slopes, default=0.0), "at 1 K/min"
    if group.base is not None:  # a change of a bias or of a scale factor
        span, over = (HOUR, "after an hour") if group.variable == "time" else (WARMER, f"in {WARMER:.0f} K")
        if group.variable == "hysteresis":
            span, over = 1.0, "on the way up or down"
        change = float(np.abs(own).max()) * (WARMER**2 if group.variable == "temperature²" else span)
        return (change, over) if within_kind(group.base) == "bias" else (change * felt, f"{over} {where}")
    instrument = Instrument.of(compensator.accel, compensator.gyro, {group.name}, variables=())
    block = instrument.block(group)
    assert group.regressors is not None
    K = group.regressors(block) @ np.array([values.get(name, 0.0) for name in group.names(block)])
    up = np.concatenate([np.eye(3), -np.eye(3), directions()])  # in all attitudes at 1 g and at a rate about all axes
    effects = np.einsum("npb,pb->np", functions(block, G_STANDARD * up, rate * up), K)
    return float(np.abs(effects).max()), "in 1 g" if group.name == "gyro.g_sensitivity" else where


def g_sensitivity(calibration: Calibration) -> Array:
    """The g-sensitivity (n, 3) of the gyros by channel, rad/s per m/s²; zero where it is not known."""
    return np.array(calibration.compensator.gyro_coefficients[:, FORCE])


def still(sensitivity: Array) -> tuple[str, ...]:
    """What an example of gyros with g-sensitivity supposes."""
    return ("the example of the gyros is without acceleration",) if np.any(sensitivity) else ()
