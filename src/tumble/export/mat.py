"""A MATLAB file (version 5), which GNU Octave reads too: matrices, parameters, uncertainties and covariance.

true = accel_matrix \\ (reading - accel_bias)        columns: one sample each; least squares for more than three sensors
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.io import savemat

from tumble.calibration.calibration_file import Calibration
from tumble.calibration.results import Parameter
from tumble.export.exported import Exported, example, models, origin
from tumble.export.larger_model import NOT_IN_MATRIX, not_held
from tumble.units import Array

LOSSES = ("rests, turns, launches and iterations of the calibration have no place in this file",)


def mat(calibration: Calibration) -> Exported:
    """The .mat file of a calibration."""
    parameters = calibration.parameters
    losses = (*LOSSES, *not_held(calibration, said=NOT_IN_MATRIX))
    content: dict[str, Any] = {
        "serial": calibration.serial,
        "frame": calibration.frame,
        "about": "\n".join([*origin(calibration), "true = accel_matrix \\ (reading - accel_bias), SI", *losses]),
        "parameter_name": np.array([p.name for p in parameters], dtype=object),
        "parameter_unit": np.array([p.unit for p in parameters], dtype=object),
        "parameter_value": np.array([p.value for p in parameters]),
        **_known_before(parameters),
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
    return Exported(content=buffer.getvalue(), losses=losses)


def _known_before(parameters: Sequence[Parameter]) -> dict[str, Array]:
    """Prior, learned fraction, coverage factor and degrees of freedom; NaN where there is none."""
    return {
        "parameter_prior": np.array([np.nan if p.prior is None else p.prior for p in parameters]),
        "parameter_learned": np.array([np.nan if p.learned is None else p.learned for p in parameters]),
        "parameter_k": np.array([np.nan if p.k is None else p.k for p in parameters]),
        "parameter_dof": np.array([np.nan if p.dof is None else p.dof for p in parameters]),
    }
