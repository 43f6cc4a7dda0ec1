"""A calibration of triads in another frame: what belongs to the axes turns, what belongs to a sensor stays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tumble.errors import CalibrationError, InputError
from tumble.result.coverage import degrees_through
from tumble.result.parts import Launch, Parameter, learned_fraction
from tumble.result.record import AnyCalibration, CalibrationData
from tumble.sensors.frames import Frame, Framed, carried_further, convert, frame_of, triad_axes
from tumble.sensors.instrument import Instrument
from tumble.sensors.model import Block
from tumble.sensors.parameters import LINEAR, THERMAL, group_name, sensor_kind
from tumble.units import Array

_VARIABLES = ("time", *THERMAL)
_LINEAR = frozenset(group.name for group in LINEAR)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Turned:
    """Parameters in the new frame: those of the linear model, and the derivative (r, r) of the `rest` after them with
    the same before, which also takes their values there."""

    framed: Framed
    carry: Array
    parameters: tuple[Parameter, ...]
    covariance: Array | None


def turned(
    blocks: tuple[Block, Block | None],
    frames: tuple[Frame, Frame],
    parameters: tuple[Parameter, ...],
    covariance: Array | None,
) -> Turned:
    """Parameters with their covariance taken from the first of two frames to the second."""
    own = len([p for p in parameters if group_name(p.name) in _LINEAR])
    rest = parameters[own:]
    framed = convert(
        *blocks,
        source=frames[0],
        values=np.array([p.value for p in parameters[:own]]),
        covariance=None if covariance is None else covariance[:own, :own],
        target=frames[1],
    )
    names, carry = [p.name for p in rest], np.eye(len(rest))
    instrument = Instrument.of(*blocks, {group_name(name) for name in names}, _VARIABLES)
    further = instrument.names[instrument.linear_count :]
    at = [names.index(name) for name in further if name in names]
    if len(at) == len(further):
        carry[np.ix_(at, at)] = carried_further(instrument, framed.rotation)
    if covariance is not None:
        count = len(framed.names)
        whole = np.zeros((count + len(rest), len(parameters)))
        whole[:count, :own], whole[count:, own:] = framed.jacobian, carry
        covariance = np.asarray(whole @ covariance @ whole.T)
    u = [None] * len(parameters) if covariance is None else np.sqrt(np.diag(covariance)).tolist()

    def degrees_of(jacobian: Array, before: tuple[Parameter, ...]) -> list[float | None]:
        return degrees_through(jacobian, np.array([p.u or 0.0 for p in before]), [p.dof for p in before])

    def learned(p: Parameter, u: float | None) -> float | None:
        known = p.learned is not None and p.prior is not None and u is not None
        return learned_fraction(u or 0.0, p.prior or 1.0) if known else p.learned

    degrees = degrees_of(framed.jacobian, parameters[:own])
    linear = tuple(
        Parameter(name=name, value=float(value), u=each, unit=unit, dof=dof)
        for name, value, each, unit, dof in zip(framed.names, framed.values, u, framed.units, degrees, strict=False)
    )
    values = carry @ np.array([p.value for p in rest])
    after = tuple(
        replace(p, value=float(value), u=each, deviation=None, learned=learned(p, each), dof=dof)
        for p, value, each, dof in zip(rest, values, u[len(linear) :], degrees_of(carry, rest), strict=True)
    )
    return Turned(framed=framed, carry=carry, parameters=linear + after, covariance=covariance)


def calibration_in(calibration: AnyCalibration, frame: str) -> AnyCalibration:
    """A calibration in another frame, see `Calibration.in_frame`."""
    if frame == calibration.frame:
        return calibration
    evidence = calibration.evidence
    missing = tuple(name for name in calibration.outcome.unobservable if sensor_kind(name) != "mag")
    missing = missing or (() if calibration.accel is not None else ("those of accelerometers",))
    if missing or calibration.accel is None:
        raise CalibrationError(f"frame {frame!r}: expected all parameters, found {', '.join(missing)} missing")

    def in_frame(result: CalibrationData | Launch) -> Turned:
        return turned((accel, gyro), frames, result.parameters, result.covariance)

    try:
        frames = frame_of(calibration.frame), frame_of(frame)
        accel = Block(kind="accel", axes=triad_axes(calibration.accel.matrix))
        gyro = None if calibration.gyro is None else Block(kind="gyro", axes=triad_axes(calibration.gyro.matrix))
        mean, launches = in_frame(calibration), [in_frame(launch) for launch in evidence.launches]
    except InputError as error:
        raise CalibrationError(str(error)) from error
    parameters = mean.parameters
    if launches:  # with the standard deviation from launch to launch
        by_launch = [{p.name: p.value for p in launch.parameters} for launch in launches]
        spread = {p.name: float(np.std([values[p.name] for values in by_launch], ddof=1)) for p in parameters}
        parameters = tuple(replace(p, run_to_run=spread[p.name]) for p in parameters)
    names, iterations = list(calibration), []
    for step in evidence.iterations:
        before = np.array([step.get(name, 0.0) for name in names])
        linear = len(before) - len(mean.carry)
        after = np.concatenate([mean.framed.jacobian @ before[:linear], mean.carry @ before[linear:]])
        iterations.append(dict(zip((p.name for p in parameters), after.tolist(), strict=True)))
    return replace(
        calibration,
        frame=frame,
        parameters=parameters,
        covariance=mean.covariance,
        accel=mean.framed.accel,
        gyro=mean.framed.gyro,
        evidence=replace(
            evidence,
            process_bias=(),
            budget=(),
            iterations=tuple(iterations),
            launches=tuple(
                replace(launch, parameters=each.parameters, covariance=each.covariance)
                for launch, each in zip(evidence.launches, launches, strict=True)
            ),
        ),
    )
