"""The library for firmware: its archive, its functions in fixed point compiled with gcc, its example against stubs."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.calibrated import HEXAD, calibration
from tumble.errors import InputError
from tumble.export import export_calibration
from tumble.export.firmware import FULL_SCALE, NAME
from tumble.result.calibration import Calibration
from tumble.result.parts import Parameter
from tumble.units import DEGREE, G_STANDARD, Array

N = 2000
SCALES = {"accel": FULL_SCALE[0] * G_STANDARD, "gyro": FULL_SCALE[1] * DEGREE}
STRICT = ["-O2", "-Wall", "-Wextra", "-Werror", "-Wconversion", "-Wno-unused-function"]

PROGRAM = """
#include <inttypes.h>
#include <stdio.h>
#include "imu_calibration.h"
int main(void)
{
    int32_t r[%(n)d], f[3], t[3];
    for (;;) {
        for (int i = 0; i < %(n)d; i++) if (scanf("%%" SCNd32, &r[i]) != 1) return 0;
        for (int i = 0; i < 3; i++) if (scanf("%%" SCNd32, &f[i]) != 1) return 0;
        imu_correct_%(kind)s_q31(r, %(force)st);
        printf("%%" PRId32 " %%" PRId32 " %%" PRId32 "\\n", t[0], t[1], t[2]);
    }
}
"""
ARDUINO = """
#include <cstdint>
struct Print { void begin(long) {} void print(float, int) {} void print(char) {} void println() {} };
static Print Serial;
static void delay(int) {}
"""


def beyond_linear(made: Calibration) -> Calibration:
    """With K₂, K₃, asymmetries and a g-sensitivity, as of a MEMS device."""
    sizes = {
        "accel.quadratic": (5e-5, "xyz", "s^2/m"),
        "accel.cubic": (1e-6, "xyz", "s^4/m^2"),
        "accel.asymmetry": (5e-4, "xyz", "1"),
        "gyro.asymmetry": (5e-4, "xyz", "1"),
        "gyro.g_sensitivity": (2e-4, [a + b for a in "xyz" for b in "xyz"], "rad*s/m"),
    }
    rng = np.random.default_rng(3)
    more = [
        Parameter(name=f"{group}.{suffix}", value=float(size * rng.standard_normal()), u=0.1 * size, unit=unit)
        for group, (size, suffixes, unit) in sizes.items()
        for suffix in suffixes
    ]
    return replace(made, parameters=(*made.parameters, *more), covariance=None)


def unpacked(made: Calibration, folder: Path) -> Path:
    """The folder of the library."""
    with zipfile.ZipFile(io.BytesIO(export_calibration(made, "firmware").content)) as archive:
        archive.extractall(folder)
    return folder / NAME


def compiler(name: str) -> str:
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is not installed")
    return found


def fixed_point(made: Calibration, kind: str, readings: Array, force: Array, folder: Path) -> Array:
    """What the compiled function makes of readings (N, n) in a true force (N, 3), SI."""
    library = unpacked(made, folder)
    text = (library / "src/imu_calibration.h").read_text()
    by_force = f"imu_correct_{kind}_q31(const int32_t reading[{readings.shape[1]}], const int32_t force[3]" in text
    names = {"n": readings.shape[1], "kind": kind, "force": "f, " if by_force else ""}
    (folder / "main.c").write_text(PROGRAM % names)
    program = folder / "program"
    words = [compiler("gcc"), "-std=c99", "-pedantic", *STRICT, f"-I{library / 'src'}", str(folder / "main.c")]
    subprocess.run([*words, "-o", str(program)], check=True)
    whole = np.rint(np.column_stack([readings / SCALES[kind], force / SCALES["accel"]]) * 2.0**31).astype(np.int64)
    given = "\n".join(" ".join(map(str, row)) for row in whole.tolist())
    printed = subprocess.run([program], input=given, capture_output=True, text=True, check=True).stdout
    return np.array([[int(v) for v in line.split()] for line in printed.splitlines()]) * SCALES[kind] / 2.0**31


@pytest.mark.parametrize("kind", ["accel", "gyro"])
@pytest.mark.parametrize(
    "made",
    [calibration(), calibration(accel=HEXAD, gyro=HEXAD), beyond_linear(calibration())],
    ids=["triad", "six sensors", "nonlinear"],
)
def test_fixed_point_is_within_ten_of_its_units(made: Calibration, kind: str, tmp_path: Path) -> None:
    rng = np.random.default_rng(11)
    part = 0.85 * SCALES[kind] * rng.uniform(-1.0, 1.0, (N, 3)) / np.sqrt(3.0)
    model = made.accel if kind == "accel" else made.gyro
    assert model is not None
    readings = model.predict(part)
    force = 5.0 * rng.standard_normal((N, 3))
    found = fixed_point(made, kind, readings, force, tmp_path)
    exact = made.compensator.force(readings) if kind == "accel" else made.compensator.rate(readings, force)
    assert np.abs(found - exact).max() < 10.0 * SCALES[kind] / 2.0**31


def test_fixed_point_stays_within_its_range(tmp_path: Path) -> None:
    ends = np.array([[1.0, -1.0, 1.0], [-1.0, -1.0, -1.0]]) * SCALES["accel"] * (1.0 - 2.0**-31)
    found = fixed_point(calibration(), "accel", ends, np.zeros((2, 3)), tmp_path)
    assert (np.sign(found) == np.sign(ends)).all()
    assert np.abs(found / SCALES["accel"]).min() > 0.9


@pytest.mark.parametrize("made", [calibration(), beyond_linear(calibration()), calibration(with_gyro=False)])
def test_the_example_compiles(made: Calibration, tmp_path: Path) -> None:
    library = unpacked(made, tmp_path)
    sketch = (library / "examples/Correct/Correct.ino").read_text()
    (tmp_path / "main.cpp").write_text(f"{ARDUINO}\n{sketch}\nint main() {{ setup(); loop(); }}\n")
    words = [compiler("g++"), "-std=c++11", *STRICT, f"-I{library / 'src'}", str(tmp_path / "main.cpp")]
    subprocess.run([*words, "-o", str(tmp_path / "program")], check=True)
    assert subprocess.run([str(tmp_path / "program")], check=False).returncode == 0


def test_every_build_system_finds_the_library(tmp_path: Path) -> None:
    library = unpacked(calibration(), tmp_path)
    properties = dict(line.split("=", 1) for line in (library / "library.properties").read_text().splitlines())
    assert {
        "name",
        "version",
        "author",
        "maintainer",
        "sentence",
        "paragraph",
        "category",
        "url",
        "architectures",
    } <= set(properties)
    assert json.loads((library / "library.json").read_text())["name"] == properties["name"] == NAME
    module = (library / "zephyr/module.yml").read_text()
    assert "cmake: zephyr" in module
    assert (library / "zephyr/CMakeLists.txt").exists()
    assert (library / f"src/{NAME}.h").exists()
    assert (
        export_calibration(calibration(), "firmware").content == export_calibration(calibration(), "firmware").content
    )


def test_a_full_scale_too_small_is_refused() -> None:
    with pytest.raises(InputError, match="expected bias within the full scale"):
        export_calibration(calibration(), "firmware", full_scale=(1e-3, 2000.0))
    with pytest.raises(InputError, match="expected g and deg/s above 0"):
        export_calibration(calibration(), "firmware", full_scale=(-1.0, 2000.0))
