"""The accepted part of a calibration: accelerometers or gyros alone if the others are not accepted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tumble.errors import CalibrationError
from tumble.inference.estimate import Judgement, Outcome
from tumble.result.parts import Launch
from tumble.result.record import AnyCalibration, CalibrationData
from tumble.sensors.model import WORDS, SensorKind, SensorModel

_NAMES = {"accel": ("accel", "velocities of turns"), "gyro": ("gyro",)}
"""First words of the names of parameters, groups and fits of each kind of sensors."""


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
    kind, other = (kinds[0], "gyro") if kinds[0] == "accel" else (kinds[0], "accel")
    outcome, prediction, temperature = calibration.outcome, calibration.prediction, calibration.temperature
    evidence, provenance, sentences = calibration.evidence, calibration.provenance, outcome.of(kind).remarks
    without: dict[str, Any] = {other: None}

    def of_kind(part: Any) -> Any:
        """Return the elements of a mapping or tuple whose names are not those of the other kind."""
        kept = [each for each in part if not getattr(each, "name", each).startswith(_NAMES[other])]
        return {name: part[name] for name in kept} if isinstance(part, Mapping) else tuple(kept)

    def estimates(result: CalibrationData | Launch) -> dict[str, Any]:
        parameters, C = of_kind(result.parameters), result.covariance
        places = [result.parameters.index(p) for p in parameters]
        return {"parameters": parameters, "covariance": None if C is None else C[np.ix_(places, places)]}

    return replace(
        calibration,
        **estimates(calibration),
        **without,
        outcome=Outcome(
            remarks=sentences,
            concerns={sentence: on for sentence, on in outcome.concerns.items() if sentence in sentences},
            unsteady=tuple(sentence for sentence in outcome.unsteady if sentence in sentences),
            unobservable=of_kind(outcome.unobservable),
        ),
        evidence=replace(
            evidence,
            fits=of_kind(evidence.fits),
            iterations=tuple(map(of_kind, evidence.iterations)),
            rests=tuple(replace(rest, **without) for rest in evidence.rests),
            turns=() if kind == "accel" else evidence.turns,
            launches=tuple(replace(x, **estimates(x), fits=of_kind(x.fits)) for x in evidence.launches),
        ),
        provenance=replace(
            provenance,
            readings=of_kind(provenance.readings),
            absent=(f"{WORDS[other]} are absent, they were not accepted: {outcome.of(other).reasons[0]}",),
        ),
        groups=of_kind(calibration.groups),
        prediction=None if prediction is None or kind == "gyro" else replace(prediction, rate_u=None),
        device=replace(calibration.device, imu=of_kind(calibration.imu)),
        temperature=replace(
            temperature,
            references=of_kind(temperature.references),
            thermometers=of_kind(temperature.thermometers),
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
