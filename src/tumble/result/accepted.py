"""The accepted part of a calibration: accelerometers or gyros alone if the others are not accepted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from tumble.errors import CalibrationError
from tumble.inference.estimate import Fit, Judgement, Outcome
from tumble.result.parts import Evidence, Launch
from tumble.result.record import AnyCalibration, CalibrationData
from tumble.sensors.model import WORDS, SensorKind, SensorModel
from tumble.sensors.parameters import sensor_kind

_Value = TypeVar("_Value")

_FITS: Mapping[SensorKind, tuple[str, ...]] = {
    "accel": ("accelerometers", "velocities of turns"),
    "gyro": ("gyro rests", "gyro turns"),
}


def accepted_part(calibration: AnyCalibration) -> AnyCalibration:
    """Return a calibration unchanged, or that of its accelerometers or gyros alone if only these are accepted.

    Sensors left out are named in `provenance.absent`. Raises CalibrationError if neither is accepted."""
    if calibration.outcome.accepted:
        return calibration
    kinds = accepted_kinds(calibration)
    if len(kinds) != 1:
        raise CalibrationError(
            f"calibration of {calibration.serial!r}: expected an accepted one, found: "
            f"{'; '.join(calibration.outcome.reasons)}"
        )
    kind = kinds[0]
    other: SensorKind = "gyro" if kind == "accel" else "accel"
    outcome, prediction = calibration.outcome, calibration.prediction
    evidence, provenance = calibration.evidence, calibration.provenance
    without: dict[str, Any] = {other: None}
    kept, refused = (outcome.accel, outcome.gyro) if kind == "accel" else (outcome.gyro, outcome.accel)

    def of_kind(by_kind: Mapping[str, _Value]) -> dict[str, _Value]:
        return {name: value for name, value in by_kind.items() if name != other}

    def estimates(result: CalibrationData | Launch) -> dict[str, Any]:
        kept = [i for i, p in enumerate(result.parameters) if sensor_kind(p.name) != other]
        return {
            "parameters": tuple(result.parameters[i] for i in kept),
            "covariance": None if result.covariance is None else result.covariance[np.ix_(kept, kept)],
        }

    def fits(result: Evidence | Launch) -> dict[str, Fit]:
        return {name: fit for name, fit in result.fits.items() if name not in _FITS[other]}

    return replace(
        calibration,
        **estimates(calibration),
        **without,
        outcome=Outcome(
            remarks=kept.remarks,
            concerns={sentence: on for sentence, on in outcome.concerns.items() if sentence in kept.remarks},
            unsteady=tuple(sentence for sentence in outcome.unsteady if sentence in kept.remarks),
            unobservable=tuple(name for name in outcome.unobservable if sensor_kind(name) != other),
        ),
        evidence=replace(
            evidence,
            fits=fits(evidence),
            iterations=tuple(
                {name: value for name, value in step.items() if sensor_kind(name) != other}
                for step in evidence.iterations
            ),
            rests=tuple(replace(rest, **without) for rest in evidence.rests),
            turns=() if kind == "accel" else evidence.turns,
            launches=tuple(replace(launch, **estimates(launch), fits=fits(launch)) for launch in evidence.launches),
        ),
        provenance=replace(
            provenance,
            readings=of_kind(provenance.readings),
            absent=(f"{WORDS[other]} are absent, they were not accepted: {refused.reasons[0]}",),
        ),
        groups=tuple(group for group in calibration.groups if sensor_kind(group.name) != other),
        prediction=None if prediction is None or kind == "gyro" else replace(prediction, rate_u=None),
        device=replace(calibration.device, imu=of_kind(calibration.imu)),
        temperature=replace(
            calibration.temperature,
            references=of_kind(calibration.temperature.references),
            thermometers=of_kind(calibration.temperature.thermometers),
        ),
    )


def accepted_kinds(calibration: CalibrationData) -> tuple[SensorKind, ...]:
    """Return the kinds of sensors of a calibration that are accepted."""
    outcome = calibration.outcome
    judged: tuple[tuple[SensorKind, SensorModel | None, Judgement], ...] = (
        ("accel", calibration.accel, outcome.accel),
        ("gyro", calibration.gyro, outcome.gyro),
    )
    return tuple(kind for kind, model, judgement in judged if model is not None and judgement.accepted)
