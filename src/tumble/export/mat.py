"""A MATLAB file (version 5), which GNU Octave reads too: matrices, parameters, uncertainties and covariance.

true = accel_matrix \\ (reading - accel_bias)        columns: one sample each; least squares for more than three sensors
"""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from scipy.io import savemat

from tumble.calibration.calibration_file import Calibration
from tumble.export.exported import Exported, example, models, origin

LOSSES = ("rests, turns, launches and iterations of the calibration have no place in this file",)


def mat(calibration: Calibration) -> Exported:
    """The .mat file of a calibration."""
    parameters = calibration.parameters
    content: dict[str, Any] = {
        "serial": calibration.serial,
        "frame": calibration.frame,
        "about": "\n".join([*origin(calibration), "true = accel_matrix \\ (reading - accel_bias), SI", *LOSSES]),
        "parameter_name": np.array([p.name for p in parameters], dtype=object),
        "parameter_unit": np.array([p.unit for p in parameters], dtype=object),
        "parameter_value": np.array([p.value for p in parameters]),
        "parameter_u": np.array([np.nan if p.u is None else p.u for p in parameters]),
        "covariance": np.empty((0, 0)) if calibration.covariance is None else calibration.covariance,
    }
    for kind, model in models(calibration).items():
        worked = example(kind, model)
        content |= {
            f"{kind}_matrix": model.matrix,
            f"{kind}_bias": model.bias,
            f"{kind}_example_reading": worked.reading,
            f"{kind}_example_true": worked.true,
        }
    buffer = io.BytesIO()
    savemat(buffer, content, oned_as="column")  # type: ignore[arg-type]  # the stubs know file names only
    return Exported(content=buffer.getvalue(), losses=LOSSES)
