"""Half a calibration: the accelerometers or the gyros alone, where the others are not accepted.

It is a calibration like that of a device which has no others. What is taken out is named in `absent`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from tumble.errors import CalibrationError
from tumble.inference.estimate import Outcome
from tumble.result.parts import Launch, Parameter
from tumble.sensors.model import SensorKind
from tumble.sensors.parameters import sensor_kind
from tumble.units import Array

if TYPE_CHECKING:
    from tumble.result.calibration import Calibration

_Value = TypeVar("_Value")

WORDS: Mapping[SensorKind, str] = {"accel": "accelerometers", "gyro": "gyros"}
_FITS: Mapping[SensorKind, tuple[str, ...]] = {
    "accel": ("accelerometers", "velocities of turns"),
    "gyro": ("gyro rests", "gyro turns"),
}


def accepted_part(calibration: Calibration, name: str | None = None) -> Calibration:
    """A calibration that is accepted, or that of its accelerometers or its gyros alone, where these are. Raises
    CalibrationError where neither is, in which the calibration is called `name`."""
    if calibration.outcome.accepted:
        return calibration
    kinds = accepted_kinds(calibration)
    if len(kinds) != 1:
        raise CalibrationError(
            f"{name or f'calibration of {calibration.serial!r}'}: expected an accepted one, found: "
            f"{'; '.join(calibration.outcome.reasons)}"
        )
    return _alone(calibration, kinds[0])


def accepted_kinds(calibration: Calibration) -> tuple[SensorKind, ...]:
    """The kinds of sensors that a calibration has and whose values may be used."""
    kinds: list[SensorKind] = []
    if calibration.accel is not None and calibration.outcome.accel.accepted:
        kinds.append("accel")
    if calibration.gyro is not None and calibration.outcome.gyro.accepted:
        kinds.append("gyro")
    return tuple(kinds)


def accepted_accelerometers(calibration: Calibration, wanted_by: str) -> Calibration:
    """The accepted part of a calibration, which has accelerometers. Raises CalibrationError otherwise, for what they
    are `wanted_by`."""
    part = accepted_part(calibration)
    if part.accel is None:
        found = "; ".join(part.absent) or "none of accelerometers"
        raise CalibrationError(
            f"calibration of {part.serial!r}: expected accepted accelerometers, by which {wanted_by}, found {found}"
        )
    return part


def _alone(calibration: Calibration, kind: SensorKind) -> Calibration:
    """The sensors of one kind, with what belongs to no kind."""
    other: SensorKind = "gyro" if kind == "accel" else "accel"
    outcome = calibration.outcome
    own, refused = (outcome.accel, outcome.gyro) if kind == "accel" else (outcome.gyro, outcome.accel)
    parameters, covariance = _without(other, calibration.parameters, calibration.covariance)
    prediction = calibration.prediction
    return replace(
        calibration,
        parameters=parameters,
        covariance=covariance,
        accel=calibration.accel if kind == "accel" else None,
        gyro=calibration.gyro if kind == "gyro" else None,
        outcome=Outcome(
            remarks=own.remarks,
            unobservable=tuple(name for name in outcome.unobservable if sensor_kind(name) != other),
        ),
        absent=(f"{WORDS[other]} are absent, they were not accepted: {refused.reasons[0]}",),
        iterations=tuple(
            {name: value for name, value in step.items() if sensor_kind(name) != other}
            for step in calibration.iterations
        ),
        rests=tuple(
            replace(rest, accel=None) if kind == "gyro" else replace(rest, gyro=None) for rest in calibration.rests
        ),
        turns=() if kind == "accel" else calibration.turns,
        fits={name: fit for name, fit in calibration.fits.items() if name not in _FITS[other]},
        readings=_of_kind(calibration.readings, other),
        launches=tuple(_launch_alone(launch, other) for launch in calibration.launches),
        groups=tuple(group for group in calibration.groups if sensor_kind(group.name) != other),
        prediction=None if prediction is None or kind == "gyro" else replace(prediction, rate_u=None),
        references=_of_kind(calibration.references, other),
        thermometers=_of_kind(calibration.thermometers, other),
        imu=_of_kind(calibration.imu, other),
    )


def _launch_alone(launch: Launch, other: SensorKind) -> Launch:
    parameters, covariance = _without(other, launch.parameters, launch.covariance)
    return replace(
        launch,
        parameters=parameters,
        covariance=covariance,
        fits={name: fit for name, fit in launch.fits.items() if name not in _FITS[other]},
    )


def _of_kind(by_kind: Mapping[str, _Value], other: SensorKind) -> dict[str, _Value]:
    return {name: value for name, value in by_kind.items() if name != other}


def _without(
    other: SensorKind, parameters: tuple[Parameter, ...], covariance: Array | None
) -> tuple[tuple[Parameter, ...], Array | None]:
    """The parameters that are not of a kind of sensor, with their covariance."""
    at = [i for i, p in enumerate(parameters) if sensor_kind(p.name) != other]
    return tuple(parameters[i] for i in at), None if covariance is None else covariance[np.ix_(at, at)]
