"""The MATLAB file and the CSV table: everything comes back, and gives the true vectors."""

from __future__ import annotations

import csv
import io
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat

from tests.support.calibrated import HEXAD, calibration
from tumble.export import export_calibration
from tumble.result.calibration import Calibration


def read_mat(made: Calibration) -> dict[str, Any]:
    content: dict[str, Any] = loadmat(io.BytesIO(export_calibration(made, "mat").content), squeeze_me=False)  # type: ignore[arg-type]
    return content


def read_csv(made: Calibration) -> dict[str, dict[str, str]]:
    """Rows by name."""
    lines = [line for line in export_calibration(made, "csv").content.decode().splitlines() if not line.startswith("#")]
    return {row["name"]: row for row in csv.DictReader(lines)}


@pytest.mark.parametrize("made", [calibration(), calibration(accel=HEXAD), calibration(with_gyro=False)])
def test_matlab_gets_the_true_vectors(made: Calibration) -> None:
    """true = accel_matrix \\ (reading - accel_bias): samples are columns, as MATLAB has them."""
    content = read_mat(made)
    true = np.random.default_rng(1).standard_normal((3, 20))
    for kind, model in (("accel", made.accel), ("gyro", made.gyro)):
        if model is None:
            assert f"{kind}_matrix" not in content
            continue
        reading = model.predict(true.T).T
        solved = np.linalg.lstsq(content[f"{kind}_matrix"], reading - content[f"{kind}_bias"])[0]
        np.testing.assert_allclose(solved, true, atol=1e-12)
        example = content[f"{kind}_example_reading"] - content[f"{kind}_bias"]
        np.testing.assert_allclose(
            np.linalg.lstsq(content[f"{kind}_matrix"], example)[0], content[f"{kind}_example_true"], atol=1e-12
        )


def test_matlab_gets_names_values_uncertainties_and_covariance() -> None:
    made = calibration()
    content = read_mat(made)
    assert [str(cell[0][0]) for cell in content["parameter_name"]] == [p.name for p in made.parameters]
    assert content["parameter_value"][:, 0].tolist() == [p.value for p in made.parameters]
    assert content["parameter_u"][:, 0].tolist() == [p.u for p in made.parameters]
    np.testing.assert_array_equal(content["covariance"], made.covariance)
    assert str(content["frame"][0]) == "accelerometer"


def test_without_uncertainties_matlab_gets_nan_and_an_empty_covariance() -> None:
    made = calibration()
    bare = replace(made, parameters=tuple(replace(p, u=None) for p in made.parameters), covariance=None)
    assert np.isnan(read_mat(bare)["parameter_u"]).all()
    assert read_mat(bare)["covariance"].size == 0


@pytest.mark.parametrize("made", [calibration(), calibration(accel=HEXAD)])
def test_the_table_gives_the_true_vectors(made: Calibration) -> None:
    """reading = matrix · true + bias, rows and columns counted from 1."""
    rows = read_csv(made)
    assert made.accel is not None
    n = len(made.accel.bias)
    matrix = np.array([[float(rows[f"accel.matrix.{p}.{q}"]["value"]) for q in (1, 2, 3)] for p in range(1, n + 1)])
    bias = np.array([float(rows[f"accel.bias_of.{p}"]["value"]) for p in range(1, n + 1)])
    true = np.random.default_rng(2).standard_normal((20, 3))
    np.testing.assert_allclose(true @ matrix.T + bias, made.accel.predict(true), atol=1e-14)
    reading = np.array([float(rows[f"accel.example.reading.{p}"]["value"]) for p in range(1, n + 1)])
    expected = [float(rows[f"accel.example.true.{q}"]["value"]) for q in (1, 2, 3)]
    np.testing.assert_allclose(np.linalg.lstsq(matrix, reading - bias)[0], expected, atol=1e-12)


def test_the_table_holds_every_parameter_with_u_unit_and_covariance_to_the_last_digit() -> None:
    made = calibration()
    rows = read_csv(made)
    assert made.covariance is not None
    names = [p.name for p in made.parameters]
    for i, p in enumerate(made.parameters):
        row = rows[p.name]
        assert (float(row["value"]), float(row["u"]), row["unit"]) == (p.value, p.u, p.unit)
        assert [float(row[name]) for name in names] == made.covariance[i].tolist()
