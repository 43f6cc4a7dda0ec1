"""The C header, compiled with gcc and run."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.support.calibrated import HEXAD, calibration, warmed
from tumble.export import export_calibration
from tumble.export.c_header import LAG_EXAMPLE
from tumble.reduction.rests.thermometer import followed
from tumble.result.calibration import Calibration
from tumble.result.parts import Parameter
from tumble.sensors.model import SensorModel
from tumble.units import Array

N = 1000
DIGITS = 10
"""Significant digits that the program prints: the order of a sum of three shows in the sixteenth."""

PROGRAM = """
#include <stdio.h>
#include "imu.h"
int main(void)
{
    %(type)s r[%(n)d], t[3];
    double x;
    for (;;) {
        for (int i = 0; i < %(n)d; i++) {
            if (scanf("%%lf", &x) != 1) return 0;
            r[i] = (%(type)s)x;
        }
        imu_correct_%(function)s(r, t);
        printf("%%a %%a %%a %%.%(digits)dg %%.%(digits)dg %%.%(digits)dg\\n", t[0], t[1], t[2], t[0], t[1], t[2]);
    }
}
"""


@pytest.fixture(scope="module")
def gcc() -> str:
    found = shutil.which("gcc")
    if found is None:
        pytest.skip("gcc is not installed")
    return found


def compiled(gcc: str, folder: Path, made: Calibration, program: str, rows: Array) -> list[str]:
    """The lines that a program with the header of a calibration prints of rows of numbers."""
    (folder / "imu.h").write_bytes(export_calibration(made, "c").content)
    (folder / "main.c").write_text(program)
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wno-unused-function"]
    subprocess.run([gcc, *flags, str(folder / "main.c"), "-o", str(folder / "main")], check=True)
    given = "\n".join(" ".join(map(float.hex, row)) for row in rows.tolist())
    return subprocess.run(
        [folder / "main"], input=given, capture_output=True, text=True, check=True
    ).stdout.splitlines()


def run(gcc: str, folder: Path, made: Calibration, function: str, readings: Array) -> tuple[Array, list[str]]:
    """What the compiled function makes of readings: exact values (m, 3), and each line as printed."""
    names = {"n": readings.shape[1], "function": function, "digits": DIGITS}
    program = PROGRAM % (names | {"type": "float" if function.endswith("f") else "double"})
    lines = compiled(gcc, folder, made, program, readings)
    exact = np.array([[float.fromhex(word) for word in line.split()[:3]] for line in lines])
    return exact, [" ".join(line.split()[3:]) for line in lines]


def by_hand(model: SensorModel, readings: Array, dtype: type[np.float32 | np.float64]) -> Array:
    """inverse · (reading − bias), summed from the first sensor to the last in this precision."""
    square = len(model.bias) == 3
    inverse = (np.linalg.inv(model.matrix) if square else np.linalg.pinv(model.matrix)).astype(dtype)
    bias = model.bias.astype(dtype)
    true = np.zeros((len(readings), 3), dtype=dtype)
    for p in range(len(bias)):
        true += inverse[:, p] * (readings[:, [p]].astype(dtype) - bias[p])
    return true.astype(float)


@pytest.mark.parametrize("kind", ["accel", "gyro"])
@pytest.mark.parametrize("axes", [None, HEXAD], ids=["triad", "six sensors"])
def test_the_output_is_the_librarys_to_the_last_printed_digit(
    tmp_path: Path, gcc: str, kind: str, axes: Array | None
) -> None:
    made = calibration(accel=axes, gyro=axes)
    model = made.accel if kind == "accel" else made.gyro
    assert model is not None
    true = (20.0 if kind == "accel" else 5.0) * np.random.default_rng(7).standard_normal((N, 3))
    readings = model.predict(true)
    exact, printed = run(gcc, tmp_path, made, kind, readings)
    assert printed == [" ".join(f"{x:.{DIGITS}g}" for x in row) for row in model.apply(readings).tolist()]
    np.testing.assert_array_equal(exact, by_hand(model, readings, np.float64))
    np.testing.assert_allclose(exact, true, atol=1e-13 * 20.0)


@pytest.mark.parametrize("kind", ["accel", "gyro"])
def test_in_float_the_output_is_that_of_single_precision_to_the_bit(tmp_path: Path, gcc: str, kind: str) -> None:
    made = calibration()
    model = made.accel if kind == "accel" else made.gyro
    assert model is not None
    true = (20.0 if kind == "accel" else 5.0) * np.random.default_rng(8).standard_normal((N, 3))
    readings = model.predict(true)
    exact, _ = run(gcc, tmp_path, made, f"{kind}f", readings)
    np.testing.assert_array_equal(exact, by_hand(model, readings, np.float32))
    assert np.abs(exact - true).max() < 3.0 * np.finfo(np.float32).eps * np.abs(readings).max()


def test_the_examples_in_the_comment_are_right() -> None:
    made = calibration()
    text = export_calibration(made, "c").content.decode()
    found = re.findall(r"example (\w+): reading ([-\d. e]+) is ([-\d. e]+) ", text)
    assert [kind for kind, _, _ in found] == ["accel", "gyro"]
    for kind, reading, true in found:
        model = made.accel if kind == "accel" else made.gyro
        assert model is not None
        np.testing.assert_allclose(
            model.apply(np.array(reading.split(), dtype=float)), np.array(true.split(), dtype=float), atol=1e-9
        )


def test_accelerometers_alone_have_no_function_for_gyros() -> None:
    header = export_calibration(calibration(with_gyro=False), "c").content.decode()
    assert "gyro" not in header.replace("gyros: not known, left as they are", "")


LAGGING = """
#include <stdio.h>
#include "imu.h"
int main(void)
{
    imu_thermometer state = {0};
    double celsius, seconds;
    while (scanf("%lf %lf", &celsius, &seconds) == 2) {
        printf("%a\\n", imu_gyro_celsius(&state, celsius, seconds));
    }
    return 0;
}
"""


@pytest.mark.parametrize("lag", [73.0, -40.0])
def test_the_lag_is_followed_as_the_library_does(tmp_path: Path, gcc: str, lag: float) -> None:
    """Over steps from milliseconds to hours; without a lag among the parameters there is no such function."""
    made = warmed(calibration())
    parameter = Parameter(name="gyro.lag", value=lag, u=1.0, unit="s")
    assert made.covariance is not None
    n = len(made.parameters)
    covariance = np.eye(n + 1)
    covariance[:n, :n] = made.covariance
    made = replace(made, parameters=(*made.parameters, parameter), covariance=covariance)
    exported = export_calibration(made, "c")
    assert not any("lag" in loss for loss in exported.losses)
    assert "imu_accel_celsius" not in exported.content.decode()

    def run_on(readings: Array) -> Array:
        return np.array(list(map(float.fromhex, compiled(gcc, tmp_path, made, LAGGING, readings))))

    rng = np.random.default_rng(1)
    celsius, steps = 20.0 + np.cumsum(rng.normal(size=400)), 10.0 ** rng.uniform(-3.0, 4.0, 400)
    expected = [celsius[0]]
    for i in range(1, 400):
        before = expected[-1] if lag > 0.0 else 2.0 * celsius[i - 1] - expected[-1]
        now = followed(celsius[i - 1 : i + 1], float(steps[i]), abs(lag), first=float(before))[1]
        expected.append(now if lag > 0.0 else 2.0 * celsius[i] - now)
    found = run_on(np.column_stack([celsius, steps]))
    np.testing.assert_allclose(found, expected, rtol=1e-11)
    stated = re.search(r"the sensors have ([-0-9. ]+)", exported.content.decode())
    assert stated is not None
    np.testing.assert_allclose(run_on(np.array(LAG_EXAMPLE)), [float(word) for word in stated[1].split()], atol=1e-9)
    assert "imu_thermometer" not in export_calibration(warmed(calibration()), "c").content.decode()
