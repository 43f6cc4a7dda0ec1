"""ArduPilot over temperature: the parameter file of `ardupilot` with the temperature calibration of the IMU that
was recorded, here the first.

    P(t) = (C1 t + C2 t² + C3 t³) · 1e-6, t = T − 35 degC; C1 is INS_TCAL1_ACC1_X and so on, of gyros INS_TCAL1_GYR1_X
    (reading − P(T) + P(INS_ACC1_CALTEMP) − INS_ACCOFFS_X) · INS_ACCSCAL_X
    reading − P(T) + P(INS_GYR1_CALTEMP) − INS_GYROFFS_X

with both temperatures kept within INS_TCAL1_TMIN … TMAX, in m/s² and rad/s; T is the temperature of the IMU itself.
The calibration's reference is CALTEMP, so that a curve about T₀ is turned into one about 35 degC.

Source: ArduPilot, parameter reference, INS_TCAL1_; library AP_InertialSensor, temperature calibration.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tumble.calibration.calibration_file import Calibration
from tumble.errors import InputError
from tumble.export.ardupilot import ESTIMATED_ANEW, MOST, NUMBER_INSIDE, parameters
from tumble.export.autopilot import sensors_of, single, whose, written
from tumble.export.exported import Exported, origin
from tumble.export.thermal import Thermal, thermal
from tumble.units import Array

ORIGIN = 35.0
"""degC, about which ArduPilot's polynomials are."""
SCALE = 1e-6
"""What its coefficients are worth, SI."""
LETTERS = {"accel": "ACC", "gyro": "GYR"}


def ardupilot_thermal(calibration: Calibration, imu: int | None = None) -> Exported:
    """The .param file of a calibration over temperature; `imu` is the number of the IMU, from 1, where the recording
    has not said it."""
    found, sensors = (
        thermal(calibration, "ardupilot-thermal", (("accel", "gyro"),)),
        sensors_of(calibration, imu, "ardupilot-thermal", MOST),
    )
    numbers = {kind: sensors[kind].number for kind in found.slopes}
    if max(numbers.values()) > NUMBER_INSIDE:
        raise InputError(
            f"export to ardupilot-thermal: expected one of the first {NUMBER_INSIDE} IMUs, found a recording of IMU "
            f"{max(numbers.values())}"
        )

    def offsets(kind: str, temperature: Array) -> Array:
        return _offsets(found, kind, temperature)

    losses = (
        *found.losses(offsets),
        *found.held.losses,
        *([ESTIMATED_ANEW] if "gyro" in found.slopes else []),
        *whose(calibration, imu),
    )
    comments = [
        *origin(calibration),
        *(
            f"offsets and scales are those at {found.reference(kind):g} degC, INS_{LETTERS[kind]}{number}_CALTEMP"
            for kind, number in list(numbers.items())[:1]
        ),
        *found.examples(offsets),
        *losses,
    ]
    rows = parameters(found.held, sensors)
    rows += [(f"INS_TCAL{number}_ENABLE", "1") for number in sorted(set(numbers.values()))]
    rows += _ends(found, numbers)
    for kind, number in numbers.items():
        rows += _of_kind(found, kind, number)
    lines = [f"{name},{value}" for name, value in rows]
    return Exported(content="\n".join([*(f"# {c}" for c in comments), *lines, ""]).encode(), losses=losses)


def _ends(found: Thermal, numbers: Mapping[str, int]) -> list[tuple[str, str]]:
    """The measured range, and the temperature of the offsets and scales."""
    ends: dict[str, float] = {}
    for number in sorted(set(numbers.values())):
        ends |= {f"INS_TCAL{number}_TMIN": found.measured.low, f"INS_TCAL{number}_TMAX": found.measured.high}
    ends |= {f"INS_{LETTERS[kind]}{number}_CALTEMP": found.reference(kind) for kind, number in numbers.items()}
    return list(zip(ends, written(np.array(list(ends.values()))), strict=True))


def _of_kind(found: Thermal, kind: str, number: int) -> list[tuple[str, str]]:
    """The coefficients of the accelerometers or the gyros."""
    return [
        (f"INS_TCAL{number}_{LETTERS[kind]}{degree}_{axis}", value)
        for degree, column in enumerate(_coefficients(found, kind).T, 1)
        for axis, value in zip("XYZ", written(column), strict=True)
    ]


def _coefficients(found: Thermal, kind: str) -> Array:
    """C1, C2, C3 (3, 3) of the axes: θ₁ (t − d) + θ₂ (t − d)² with d = T₀ − 35, without what does not depend on t."""
    linear, square = found.slopes[kind].T
    d = found.reference(kind) - ORIGIN
    return np.stack([linear - 2.0 * square * d, square, np.zeros(3)], axis=1) / SCALE


def _offsets(found: Thermal, kind: str, temperature: Array) -> Array:
    """Everything that ArduPilot takes off the readings, (N, 3), from the numbers in the file."""
    low, high, reference = np.array(
        [found.measured.low, found.measured.high, found.reference(kind)], dtype=np.float32
    ).astype(float)
    C = single(_coefficients(found, kind))

    def P(at: Array) -> Array:
        t = (np.clip(at, low, high) - ORIGIN)[:, None]
        return np.asarray((C[:, 0] * t + C[:, 1] * t**2 + C[:, 2] * t**3) * SCALE)

    return P(temperature) - P(np.array([reference])) + found.held.offset[kind]
