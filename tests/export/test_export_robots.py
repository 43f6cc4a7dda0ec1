"""Constants for Fusion, compiled against its formula; the parameters of Autoware's node, as it applies them."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.support.calibrated import calibration
from tumble.export import export_calibration
from tumble.units import DEGREE, G_STANDARD, Array

FUSION = """
#include <stdio.h>
typedef union { float array[3]; struct { float x, y, z; } axis; } FusionVector;
typedef union { float array[3][3]; } FusionMatrix;
#include "fusion.h"
static FusionVector FusionCalibrationInertial(FusionVector u, FusionMatrix m, FusionVector s, FusionVector o)
{
    FusionVector v, out;
    for (int i = 0; i < 3; i++) v.array[i] = (u.array[i] - o.array[i]) * s.array[i];
    for (int i = 0; i < 3; i++)
        out.array[i] = m.array[i][0] * v.array[0] + m.array[i][1] * v.array[1] + m.array[i][2] * v.array[2];
    return out;
}
int main(void)
{
    FusionVector a, g;
    while (scanf("%f %f %f %f %f %f", a.array, a.array + 1, a.array + 2, g.array, g.array + 1, g.array + 2) == 6) {
        a = FusionCalibrationInertial(a, accelerometerMisalignment, accelerometerSensitivity, accelerometerOffset);
        g = FusionCalibrationInertial(g, gyroscopeMisalignment, gyroscopeSensitivity, gyroscopeOffset);
        printf("%.9g %.9g %.9g %.9g %.9g %.9g\\n", a.axis.x, a.axis.y, a.axis.z, g.axis.x, g.axis.y, g.axis.z);
    }
}
"""


@pytest.mark.parametrize("seed", range(3))
def test_fusion_gets_the_true_vectors(seed: int, tmp_path: Path) -> None:
    gcc = shutil.which("gcc")
    if gcc is None:
        pytest.skip("gcc is not installed")
    made, rng = calibration(seed), np.random.default_rng(seed)
    assert made.accel is not None
    assert made.gyro is not None
    true = {"accel": G_STANDARD * rng.standard_normal((100, 3)), "gyro": 2.0 * rng.standard_normal((100, 3))}
    readings = [made.accel.predict(true["accel"]) / G_STANDARD, made.gyro.predict(true["gyro"]) / DEGREE]
    (tmp_path / "fusion.h").write_bytes(export_calibration(made, "fusion").content)
    (tmp_path / "main.c").write_text(FUSION)
    words = [gcc, "-std=c11", "-O1", "-Wall", "-Werror", str(tmp_path / "main.c"), "-o", str(tmp_path / "program")]
    subprocess.run(words, check=True)
    given = "\n".join(" ".join(f"{v:.9g}" for v in row) for row in np.column_stack(readings))
    printed = subprocess.run([tmp_path / "program"], input=given, capture_output=True, text=True, check=True).stdout
    found: Array = np.array([[float(v) for v in line.split()] for line in printed.splitlines()])
    np.testing.assert_allclose(found[:, :3] * G_STANDARD, true["accel"], atol=1e-5)
    np.testing.assert_allclose(found[:, 3:] * DEGREE, true["gyro"], atol=2e-6)


def test_autoware_takes_the_bias_off() -> None:
    made = calibration()
    assert made.gyro is not None
    (node,) = yaml.safe_load(export_calibration(made, "autoware").content).values()
    offset = [node["ros__parameters"][f"angular_velocity_offset_{axis}"] for axis in "xyz"]
    np.testing.assert_allclose(made.gyro.predict(np.zeros((1, 3)))[0] - offset, 0.0, atol=1e-15)
