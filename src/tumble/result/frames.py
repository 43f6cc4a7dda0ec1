"""Conversion of a calibration of triads to another frame."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from tumble.errors import CalibrationError, InputError
from tumble.result.coverage import degrees_through
from tumble.result.parts import Launch, Parameter, learned_fraction
from tumble.result.record import AnyCalibration, CalibrationData
from tumble.sensors.frames import Frame, Framed, convert, frame_of, further_rotation, triad_axes
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import Block
from tumble.sensors.parameters import LINEAR, THERMAL, group_name, sensor_kind
from tumble.units import Array

_VARIABLES = ("time", *THERMAL)
_LINEAR = frozenset(group.name for group in LINEAR)


def _converted(
    result: CalibrationData | Launch, blocks: tuple[Block, Block | None], frames: tuple[Frame, Frame]
) -> tuple[dict[str, Any], Array, Framed]:
    """Convert parameters and covariance of a result from the first of two frames to the second.

    Also return the derivative (m, m) of the new parameters with respect to the old ones, and the converted linear
    model. Groups that belong to the axes are rotated, those that belong to a sensor are unchanged."""
    parameters, covariance = result.parameters, result.covariance
    linear = len([p for p in parameters if group_name(p.name) in _LINEAR])
    further = parameters[linear:]
    framed = convert(
        *blocks,
        source=frames[0],
        values=np.array([p.value for p in parameters[:linear]]),
        covariance=None if covariance is None else covariance[:linear, :linear],
        target=frames[1],
    )
    names, carry, count = [p.name for p in further], np.eye(len(further)), len(framed.names)
    instrument = Instrument.of(*blocks, {group_name(name) for name in names}, _VARIABLES)
    rotated = instrument.names[instrument.linear_count :]
    if set(rotated) <= set(names):
        indices = [names.index(name) for name in rotated]
        carry[np.ix_(indices, indices)] = further_rotation(instrument, framed.rotation)
    jacobian = np.zeros((count + len(further), len(parameters)))
    jacobian[:count, :linear], jacobian[count:, linear:] = framed.jacobian, carry
    old_u = np.array([p.u or 0.0 for p in parameters])
    degrees = degrees_through(jacobian, old_u, [p.dof for p in parameters])
    values = [*framed.values.tolist(), *(carry @ [p.value for p in further]).tolist()]
    u: list[float | None] = [None] * len(jacobian)
    if covariance is not None:
        covariance = np.asarray(jacobian @ covariance @ jacobian.T)
        u = np.sqrt(np.diag(covariance)).tolist()
    of_axes = (Parameter(name=n, value=0.0, unit=unit) for n, unit in zip(framed.names, framed.units, strict=True))
    converted = []
    for p, value, each, dof in zip((*of_axes, *further), values, u, degrees, strict=True):
        has_prior = p.learned is not None and p.prior is not None and each is not None
        learned = learned_fraction(each or 0.0, p.prior or 1.0) if has_prior else p.learned
        converted.append(replace(p, value=value, u=each, deviation=None, learned=learned, dof=dof))
    return {"parameters": tuple(converted), "covariance": covariance}, jacobian, framed


def calibration_in(calibration: AnyCalibration, frame: str) -> AnyCalibration:
    """Convert a calibration to another frame, see `Calibration.in_frame`."""
    if frame == calibration.frame:
        return calibration
    evidence = calibration.evidence
    missing = tuple(name for name in calibration.outcome.unobservable if sensor_kind(name) != "mag")
    missing = missing or (() if calibration.accel is not None else ("those of accelerometers",))
    if missing or calibration.accel is None:
        raise CalibrationError(f"frame {frame!r}: expected all parameters, found {', '.join(missing)} missing")
    try:
        frames = frame_of(calibration.frame), frame_of(frame)
        gyro = None if calibration.gyro is None else Block(kind="gyro", axes=triad_axes(calibration.gyro.matrix))
        blocks = Block(kind="accel", axes=triad_axes(calibration.accel.matrix)), gyro
        converted, jacobian, framed = _converted(calibration, blocks, frames)
        launches = tuple(replace(launch, **_converted(launch, blocks, frames)[0]) for launch in evidence.launches)
    except InputError as error:
        raise CalibrationError(str(error)) from error
    parameters = converted["parameters"]
    if launches:
        by_launch = [{p.name: p.value for p in launch.parameters} for launch in launches]
        spread = {p.name: float(np.std([values[p.name] for values in by_launch], ddof=1)) for p in parameters}
        parameters = tuple(replace(p, run_to_run=spread[p.name]) for p in parameters)
    steps = [jacobian @ [step.get(name, 0.0) for name in calibration] for step in evidence.iterations]
    return replace(
        calibration,
        frame=frame,
        parameters=parameters,
        covariance=converted["covariance"],
        accel=framed.accel,
        gyro=framed.gyro,
        evidence=replace(
            evidence,
            process_bias=(),
            budget=(),
            iterations=tuple({p.name: float(x) for p, x in zip(parameters, step, strict=True)} for step in steps),
            launches=launches,
        ),
    )
