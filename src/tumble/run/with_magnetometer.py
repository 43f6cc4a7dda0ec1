"""The parameters of the magnetometer beside those of a calibration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tumble.methods.magnetometer import NAMES as MAGNETOMETER_NAMES
from tumble.methods.magnetometer import magnetometer
from tumble.recording.session import Session
from tumble.reduction.observations import Observations
from tumble.result.calibration import Calibration
from tumble.result.parts import Parameter
from tumble.run.field_dip import exchanged_columns


def with_magnetometer(calibration: Calibration, session: Session, observations: Observations) -> Calibration:
    """A calibration with the parameters of the session's magnetometer, where it has one; where that cannot be
    calibrated, without them, and a note says why."""
    spec, covariance = session.log.magnetometer, calibration.covariance
    if spec is None:
        return calibration
    found = magnetometer(observations, spec.unit)
    if found.reasons or found.values is None or found.covariance is None or covariance is None:
        why = "; ".join(found.reasons) or "magnetometer: nothing says how well it is known"
        said = (f"{why}; the rest of the session is calibrated without it",)
        missing = replace(calibration.outcome, unobservable=calibration.outcome.unobservable + MAGNETOMETER_NAMES)
        return replace(calibration, outcome=missing, notes=calibration.notes + said)
    u, units = np.sqrt(np.diag(found.covariance)), (spec.unit,) * 3 + ("1",) * 3 + ("rad",) * 3
    parameters = tuple(
        Parameter(name=name, value=float(value), u=float(each), unit=unit)
        for name, value, each, unit in zip(MAGNETOMETER_NAMES, found.values, u, units, strict=True)
    )
    apart = np.zeros((len(covariance), 9))
    return replace(
        calibration,
        parameters=calibration.parameters + parameters,
        covariance=np.block([[covariance, apart], [apart.T, found.covariance]]),
        mag=found.model,
        fits=dict(calibration.fits) | found.fits,
        notes=calibration.notes + found.notes + exchanged_columns(calibration.accel, found.model, observations, spec),
    )
