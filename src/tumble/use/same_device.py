"""Sessions that a calibration is applied to, checked or verified with: of its device, with thermometers as it had them,
and what they have of rests."""

from __future__ import annotations

import numpy as np

from tumble.errors import InputError
from tumble.inference.variables import sensors_at
from tumble.recording.session import Session
from tumble.reduction.observations import Observations
from tumble.result.calibration import Calibration
from tumble.run.observed import Observed, inspect_session
from tumble.units import ZERO_CELSIUS, Array


def check_device(calibration: Calibration, session: Session) -> None:
    """Raises InputError for a session of another device than a calibration, and where sensors that change with
    temperature share thermometers otherwise than they did when the calibration was made; of a session without a
    thermometer nothing is said."""
    if session.device.serial != calibration.serial:
        raise InputError(
            f"{session.name}: expected a session of device {calibration.serial!r}, which was calibrated, found "
            f"{session.device.serial!r}"
        )
    known = session.log.temperature
    if known is None or (calibration.accel is None and calibration.gyro is None) or not calibration.compensator.warm:
        return
    compensator = calibration.compensator
    for made, now in ((compensator.accel, session.accel_block), (compensator.gyro, session.gyro_block)):
        if made is not None and now is not None and not np.array_equal(made.thermometer, now.thermometer):
            then = ", ".join(calibration.temperature.thermometers.get(made.kind, ())) or "one for all sensors"
            raise InputError(
                f"{session.name}: log.temperature.columns: expected a thermometer for each sensor {made.kind} as in "
                f"the calibration, {then}, found {', '.join(known.names(made.kind))}"
            )


def rests_of(
    calibration: Calibration, session: Session, *, otherwise: str = ""
) -> tuple[Observed, Observations, Array | None]:
    """What is seen in a session, its rests, and the temperatures (N, n), °C, of its accelerometers in them, which
    follow the thermometers with the calibration's lag; None where there are none. Raises InputError where nothing
    rests, with what to do `otherwise`."""
    observed = inspect_session(session)
    observations = observed.observations
    if observations is None or observed.faults:
        fault = observed.faults[0] if observed.faults else "no rests; look at it with `tumble inspect`"
        raise InputError(f"{session.name}: expected rests to verify with, found {fault}{otherwise}")
    kelvin, celsius = observations.rests.temperatures, None
    if kelvin is not None:
        lag = 0.0 if calibration.accel is None else calibration.compensator.lag
        celsius = sensors_at(observations, kelvin, lag)[:, observations.accel_block.thermometer] - ZERO_CELSIUS
    return observed, observations, celsius
