"""Sessions that a calibration is applied to or checked with have thermometers as it had them."""

from __future__ import annotations

import numpy as np

from tumble.errors import InputError
from tumble.recording.session import Session
from tumble.result.calibration import Calibration


def check_thermometers(calibration: Calibration, session: Session) -> None:
    """Raises InputError where sensors that change with temperature share thermometers otherwise than they did when the
    calibration was made; of a session without a thermometer nothing is said."""
    known, compensator = session.log.temperature, calibration.compensator
    if known is None or not compensator.warm:
        return
    for made, now in ((compensator.accel, session.accel_block), (compensator.gyro, session.gyro_block)):
        if made is not None and now is not None and not np.array_equal(made.thermometer, now.thermometer):
            then = ", ".join(calibration.thermometers.get(made.kind, ())) or "one for all sensors"
            raise InputError(
                f"{session.name}: log.temperature.columns: expected a thermometer for each sensor {made.kind} as in "
                f"the calibration, {then}, found {', '.join(known.names(made.kind))}"
            )
