"""Rests and turns of a calibration: where they were, what the sensors read, and how well each fits."""

from __future__ import annotations

import numpy as np

from tumble.errors import InputError
from tumble.inference.estimate import Estimate
from tumble.reduction.observations import Observations
from tumble.reduction.rests.rests import Rests
from tumble.result.parts import RestResult, SensorsAtRest, TurnResult
from tumble.sensors.model import Block
from tumble.units import ZERO_CELSIUS, Array


def rest_results(estimate: Estimate, observations: Observations) -> tuple[RestResult, ...]:
    """The rests of a calibration, in their order. Raises InputError where the fit ran away, as it may where the rests
    are in nearly one attitude."""
    rests = observations.rests
    if not np.isfinite(estimate.rest_residual).all():
        raise InputError(
            f"expected rests in attitudes far apart, found {len(rests)} for which the fit comes to no finite values; "
            "put the device down in others too (`tumble programme` lists them)"
        )
    return tuple(
        RestResult(
            file=int(rests.file[i]),
            start=float(rests.start[i]),
            stop=float(rests.stop[i]),
            residual=float(estimate.rest_residual[i]),
            sigmas=float(estimate.rest_sigmas[i]),
            attitude=_attitude(observations, i),
            accel=_sensors_at_rest(
                rests.accel[i], rests.accel_noise[i], rests.accel_drift[i], _celsius(rests, i, observations.accel_block)
            ),
            gyro=_sensors_at_rest(
                rests.gyro[i], rests.gyro_noise[i], rests.gyro_drift[i], _celsius(rests, i, observations.gyro_block)
            ),
            temperature=None if rests.temperature is None else float(rests.temperature[i]) - ZERO_CELSIUS,
        )
        for i in range(len(rests))
    )


def _attitude(observations: Observations, rest: int) -> str | None:
    if observations.programme is None or observations.position is None:
        return None
    return observations.programme.positions[int(observations.position[rest])].attitude


def _sensors_at_rest(mean: Array, noise: Array, drift: Array, celsius: Array) -> SensorsAtRest | None:
    if len(mean) == 0:
        return None
    each = (tuple(values.tolist()) for values in (mean, noise, drift, celsius))
    return SensorsAtRest(**dict(zip(("mean", "noise", "drift", "temperature"), each, strict=True)))


def _celsius(rests: Rests, i: int, block: Block | None) -> Array:
    """Temperatures (n,), °C, of the sensors of a block at a rest; none where there is no thermometer."""
    if rests.temperatures is None or block is None:
        return np.empty(0)
    return np.asarray(rests.temperatures[i, block.thermometer] - ZERO_CELSIUS)


def turn_results(estimate: Estimate, observations: Observations) -> tuple[TurnResult, ...]:
    """The turns of a calibration, in their order; none of an estimate that has none."""
    if observations.turns is None or not len(estimate.turn_sigmas):
        return ()
    turns, rotations = observations.turns, _rotations(estimate, observations)
    angles = np.arccos(np.clip(0.5 * (np.trace(rotations, axis1=1, axis2=2) - 1.0), -1.0, 1.0))
    return tuple(
        TurnResult(
            first=int(turns.first[k]),
            last=int(turns.last[k]),
            duration=float(turns.duration[k]),
            angle=None if estimate.gyro is None else float(angles[k]),
            programmed=_programmed_angle(observations, int(turns.first[k]), int(turns.last[k])),
            sigmas=float(estimate.turn_sigmas[k]),
        )
        for k in range(len(turns))
        if turns.duration[k] > 0.0  # not between the parts of a rest
    )


def _rotations(estimate: Estimate, observations: Observations) -> Array:
    """Rotations (K, 3, 3) of the turns by the gyros of an estimate, nominal ones where it has none: as its likelihood
    has them, where it has one."""
    assert observations.turns is not None
    if estimate.gyro is None:
        return observations.turns.C
    linearised = estimate.linearised
    if linearised is None or linearised.about is None:
        return observations.turns_about(estimate.gyro).C
    return linearised.rotations


def _programmed_angle(observations: Observations, first: int, last: int) -> float | None:
    """Angle (rad, not negative) of the programme's turn from one rest to the next."""
    if observations.programme is None or observations.position is None or not observations.programme.ordered:
        return None
    before, after = int(observations.position[first]), int(observations.position[last])
    angle = observations.programme.moves[before].angle if after == before + 1 else None
    return None if angle is None else abs(angle)
