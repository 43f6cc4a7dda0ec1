"""A library for firmware, one archive: for Arduino ("Add .ZIP library"), PlatformIO and as a module of Zephyr. It holds
the C header (`c_header`), the same functions in fixed point, and an example.

In fixed point readings and results are 32-bit fractions of a full scale F, x = F q / 2³¹; a converter's 16 bits are its
upper half. With the inverse in parts of 2²⁹ and all else in parts of 2³¹, in 64-bit sums,

    q ← Σ inverse (q_reading − bias − a |own| − c F² own³ − …),    rounded to nearest, and kept within ±1

which is within some units of 2⁻³¹ F of the functions in double: 16 g / 2³¹ = 73 nm/s².
"""

from __future__ import annotations

import io
import json
import zipfile

import numpy as np

from tumble import __version__
from tumble.errors import InputError
from tumble.export.c_header import WHAT, beyond_linear, c_header, constant
from tumble.export.exported import Exported, models, origin
from tumble.result.calibration import Calibration
from tumble.sensors.compensation import FIXED_POINT_STEPS
from tumble.sensors.model import SensorKind
from tumble.units import DEGREE, G_STANDARD

NAME = "TumbleIMU"
FULL_SCALE = (16.0, 2000.0)
"""g and °/s: the range of most chips."""
BITS = {"inverse": 29, "axis": 30}
"""Of what is not in parts of 2³¹."""

_SHARED = """\
/* a product in parts of 2^bits, rounded to nearest */
static inline int64_t imu_scaled(int64_t product, int bits)
{
    const int64_t half = (int64_t)1 << (bits - 1);
    return product >= 0 ? (product + half) >> bits : -((half - product) >> bits);
}

static inline int64_t imu_within(int64_t value)
{
    return value > INT32_MAX ? INT32_MAX : value < INT32_MIN ? INT32_MIN : value;
}
"""

_FUNCTION = """\
/* {what}, in parts of {scale} / 2^31, from readings of {n} sensors likewise{needs} */
static inline void imu_correct_{kind}_q31(const int32_t reading[{n}], {argument}int32_t out[3])
{{
{tables}    int64_t left[{n}], true_value[3];
    for (int j = 0; j < {n}; j++) {{
        left[j] = (int64_t)reading[j] - bias[j]{first};
    }}
    for (int step = 0; step <= {steps}; step++) {{
        for (int i = 0; i < 3; i++) {{
            int64_t sum = 0;
            for (int j = 0; j < {n}; j++) {{
                sum += inverse[i][j] * left[j];
            }}
            true_value[i] = imu_within(imu_scaled(sum, 29));
        }}
{beyond}    }}
    for (int i = 0; i < 3; i++) {{
        out[i] = (int32_t)true_value[i];
    }}
}}
"""

_BEYOND = """\
        for (int j = 0; j < {n}; j++) {{
            const int64_t own = imu_scaled(
                axis[j][0] * true_value[0] + axis[j][1] * true_value[1] + axis[j][2] * true_value[2], 30);
            const int64_t cube = imu_scaled(imu_scaled(own * own, 31) * own, 31);
            left[j] = (int64_t)reading[j] - bias[j]{first} - imu_scaled((own < 0 ? -own : own) * asymmetry[j], 31)
                - imu_scaled(cube * cubic[j], 31);
{more}        }}
"""

_QUADRATIC = """\
            for (int k = 0, at = 0; k < 3; k++) {
                for (int l = k; l < 3; l++, at++) {
                    left[j] -= imu_scaled(imu_scaled(true_value[k] * true_value[l], 31) * quadratic[j][at], 31);
                }
            }
"""

_SKETCH = """\
// Correct: the readings of an IMU, corrected. Put in the lines of your sensor's library.
#include <{name}.h>

static void read_sensor(float accel[3], float gyro[3])  // in m/s^2 and rad/s, as they were recorded
{{
    for (int i = 0; i < 3; i++) {{
        accel[i] = 0;
        gyro[i] = 0;
    }}
}}

void setup()
{{
    Serial.begin(115200);
}}

void loop()
{{
    float accel[{accel}], gyro[{gyro}], corrected[3];
    read_sensor(accel, gyro);
{calls}
    delay(10);
}}
"""

_PRINTED = """\
    for (int i = 0; i < 3; i++) {
        Serial.print(corrected[i], 6);
        Serial.print(' ');
    }"""


def firmware(calibration: Calibration, full_scale: tuple[float, float] | None = None) -> Exported:
    """The archive of a calibration, its fixed point for readings up to ±`full_scale`, g and °/s. Raises InputError
    where a number has no place in it."""
    accel, gyro = full_scale or FULL_SCALE
    scales: dict[SensorKind, float] = {"accel": accel * G_STANDARD, "gyro": gyro * DEGREE}
    if not (accel > 0.0 and gyro > 0.0):
        raise InputError(f"--full-scale: expected g and deg/s above 0, found {accel:g},{gyro:g}")
    known = models(calibration)
    fixed = [_SHARED, *(_function(calibration, kind, scales) for kind in known)]
    defined = [f"#define IMU_{kind.upper()}_FULL_SCALE {scales[kind]!r}" for kind in known]
    header = c_header(calibration, includes=("<stdint.h>",), more=(*defined, "", *fixed))
    losses = (
        *header.losses,
        f"functions in fixed point are for readings within {accel:g} g and {gyro:g} deg/s, at the reference "
        "temperature",
    )
    by_force = "gyro" in known and "by_force" in beyond_linear(calibration.compensator, "gyro")
    calls = [f"    imu_correct_accelf(accel, corrected);\n{_PRINTED}"] * ("accel" in known)
    if "gyro" in known and not (by_force and "accel" not in known):
        force = "accel_corrected, " if by_force else ""
        taken = "    float accel_corrected[3];\n    imu_correct_accelf(accel, accel_corrected);\n" if by_force else ""
        calls.append(f"{taken}    imu_correct_gyrof(gyro, {force}corrected);\n{_PRINTED}\n    Serial.println();")
    sizes = {kind: max(3, len(known[kind].bias)) if kind in known else 3 for kind in scales}
    about = "\n".join(f"* {line}" for line in (*origin(calibration), *losses))
    described = "Corrects the readings of an IMU by its calibration"
    properties = {
        "name": NAME,
        "version": __version__,
        "author": "tumble contributors",
        "maintainer": "tumble contributors",
        "sentence": f"{described}.",
        "paragraph": "Made for one device by `tumble export --to firmware`.",
        "category": "Sensors",
        "url": "https://example.org/tumble",
        "architectures": "*",
        "includes": f"{NAME}.h",
    }
    files = {
        "src/imu_calibration.h": header.content.decode(),
        f"src/{NAME}.h": '#ifndef TUMBLE_IMU_H\n#define TUMBLE_IMU_H\n\n#include "imu_calibration.h"\n\n#endif\n',
        "examples/Correct/Correct.ino": _SKETCH.format(name=NAME, calls="\n".join(calls), **sizes),
        "library.properties": "".join(f"{key}={value}\n" for key, value in properties.items()),
        "library.json": json.dumps(
            {"name": NAME, "version": __version__, "description": described, "frameworks": "*", "platforms": "*"},
            indent=2,
        ),
        "zephyr/module.yml": "name: tumble_imu\nbuild:\n  cmake: zephyr\n  kconfig: zephyr/Kconfig\n",
        "zephyr/Kconfig": f'config TUMBLE_IMU\n\tbool "{described}"\n',
        "zephyr/CMakeLists.txt": "if(CONFIG_TUMBLE_IMU)\n  zephyr_include_directories(../src)\nendif()\n",
        "README.md": f"# {NAME}\n\n{described}: of one device, by `#include <{NAME}.h>`.\n\n{about}\n",
    }
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_STORED) as out:
        for name, content in files.items():
            out.writestr(zipfile.ZipInfo(f"{NAME}/{name}", (1980, 1, 1, 0, 0, 0)), content)
    return Exported(content=archive.getvalue(), losses=losses)


def _function(calibration: Calibration, kind: SensorKind, scales: dict[SensorKind, float]) -> str:
    """The function of the sensors of a kind in fixed point. Raises InputError for numbers that do not fit 32 bits."""
    model, F, beyond = models(calibration)[kind], scales[kind], beyond_linear(calibration.compensator, kind)
    if np.abs(model.inverse()).sum(axis=1).max() >= 4.0:
        raise InputError("export to firmware: expected a sensitivity near 1, found one far below; scale the readings")
    size = {"bias": 1.0 / F, "cubic": F**2, "quadratic": F, "by_force": scales["accel"] / F}  # in parts of F
    tables = ""
    for name, values in {"bias": model.bias, "inverse": model.inverse(), **beyond}.items():
        whole = np.rint(values * size.get(name, 1.0) * 2.0 ** BITS.get(name, 31))
        if np.abs(whole).max() > 2.0**31 - 1.0:
            found = np.abs(values).max() * size.get(name, 1.0)
            raise InputError(
                f"export to firmware: expected {name} within the full scale, found {found:.3g} of it; give a larger "
                "--full-scale"
            )
        tables += constant("int32_t", name, whole, lambda row: ", ".join(f"{int(v)}" for v in row))
    by_force, n = "by_force" in beyond, len(model.bias)
    felt = "".join(f"\n            - imu_scaled((int64_t)by_force[j][{k}] * force[{k}], 31)" for k in range(3))
    first = felt if by_force else ""
    more = _QUADRATIC if kind == "accel" else ""
    return _FUNCTION.format(
        what=WHAT[kind],
        scale=f"IMU_{kind.upper()}_FULL_SCALE",
        n=n,
        kind=kind,
        needs=" and the true specific force, in parts of IMU_ACCEL_FULL_SCALE" if by_force else "",
        argument="const int32_t force[3], " if by_force else "",
        tables=tables,
        first=first,
        steps=FIXED_POINT_STEPS if beyond else 0,
        beyond=_BEYOND.format(n=n, first=first, more=more) if beyond else "",
    )
