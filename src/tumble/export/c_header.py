"""A C header (C99, C++): bias and inverse matrix as constants, and functions that apply them, in double and in float.

    out = inverse · (reading − bias)        inverse = M⁻¹, or the pseudo-inverse for more than three sensors

The sum runs from the first sensor to the last. Nothing needs a library.
"""

from __future__ import annotations

import numpy as np

from tumble.calibration.calibration_file import Calibration
from tumble.export.exported import NO_UNCERTAINTY, Exported, example, inverse_of, models, numbers, origin, shown
from tumble.sensors.model import SensorModel
from tumble.units import Array

UNITS = {"accel": "m/s^2", "gyro": "rad/s"}

_FUNCTION = """\
/* {what}, {unit}, from readings of {n} sensors in {unit} */
static inline void imu_correct_{kind}{suffix}(const {type} reading[{n}], {type} out[3])
{{
    static const {type} bias[{n}] = {{{bias}}};
    static const {type} inverse[3][{n}] = {{
{rows}
    }};
    for (int i = 0; i < 3; i++) {{
        {type} sum = 0;
        for (int j = 0; j < {n}; j++) {{
            sum += inverse[i][j] * (reading[j] - bias[j]);
        }}
        out[i] = sum;
    }}
}}
"""

_WHAT = {"accel": "true specific force", "gyro": "true angular rate"}


def c_header(calibration: Calibration) -> Exported:
    """The header of a calibration."""
    known = models(calibration)
    losses = (NO_UNCERTAINTY, "the functions in float have 7 digits; use those in double where that matters")
    comments = [*origin(calibration), *_examples(known), *losses]
    lines = ["#ifndef IMU_CALIBRATION_H", "#define IMU_CALIBRATION_H", ""]
    lines += ["/*", *(f" * {line}" for line in comments), " */", ""]
    for kind, model in known.items():
        lines += [_function(kind, model, single=single) for single in (False, True)]
    lines += ["#endif", ""]
    return Exported(content="\n".join(lines).encode(), losses=losses)


def _examples(known: dict[str, SensorModel]) -> list[str]:
    out = []
    for kind, model in known.items():
        worked = example(kind, model)
        out.append(f"example {kind}: reading {shown(worked.reading)} is {shown(worked.true.round(9))} {UNITS[kind]}")
    return out


def _function(kind: str, model: SensorModel, *, single: bool) -> str:
    inverse = inverse_of(model)
    return _FUNCTION.format(
        what=_WHAT[kind],
        unit=UNITS[kind],
        n=len(model.bias),
        kind=kind,
        suffix="f" if single else "",
        type="float" if single else "double",
        bias=_constants(model.bias, single=single),
        rows=",\n".join(f"        {{{_constants(row, single=single)}}}" for row in inverse),
    )


def _constants(values: Array, *, single: bool) -> str:
    """Numbers as C constants that read back to the same ones."""
    if not single:
        return ", ".join(map(repr, numbers(values)))
    return ", ".join(f"{value!s}f" for value in values.astype(np.float32))
