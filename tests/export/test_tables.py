"""The MATLAB file and the tables: everything comes back, and gives the true vectors."""

from __future__ import annotations

import csv
import io
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat

from tests.support.calibrated import HEXAD, calibration, warmed
from tumble.export import export_calibration
from tumble.result.calibration import Calibration
from tumble.result.temperature_curves import temperature_curve
from tumble.units import G_STANDARD


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


# -------------------- over temperature --------------------


def test_the_table_reads_back_to_the_curves_and_names_its_example() -> None:
    made = warmed(calibration())
    exported = export_calibration(made, "csv-thermal")
    lines = exported.content.decode().splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    T = np.array([float(row["temperature_degC"]) for row in rows])
    assert made.reference_temperature is not None
    assert {-18.5, made.reference_temperature, 57.25, 20.0} <= set(T.tolist())
    assert T.min() == -18.5
    assert T.max() == 57.25
    for name in (f"{kind}.{what}.{s}" for kind in ("accel", "gyro") for what in ("bias", "scale") for s in "xyz"):
        np.testing.assert_allclose(
            [float(row[name]) for row in rows], temperature_curve(made, name, T).value, rtol=1e-8
        )
        d, u = T - made.reference_temperature, {p.name: p.u or 0.0 for p in made.parameters}
        own = np.sqrt(u[name] ** 2 + (u[f"{name}.t1"] * d) ** 2 + (u[f"{name}.t2"] * d**2) ** 2)
        np.testing.assert_allclose([float(row[f"U({name})"]) for row in rows], 2.0 * own, rtol=1e-3)
    assert any(line.startswith("# example gyro at 57.2 degC: reading") for line in lines)
    fine = np.linspace(T[0], T[-1], 5001)
    error = max(
        float(
            np.abs(
                np.interp(fine, T, temperature_curve(made, n, T).value) - temperature_curve(made, n, fine).value
            ).max()
        )
        for n in (f"accel.bias.{s}" for s in "xyz")
    )
    stated = re.search(r"within ([\d.e-]+) mg", exported.losses[0])
    assert stated is not None
    assert error == pytest.approx(1e-3 * G_STANDARD * float(stated[1]), rel=0.01)


def test_the_table_holds_six_sensors_and_accelerometers_alone() -> None:
    axes = HEXAD / np.linalg.norm(HEXAD, axis=1)[:, None]
    for made in (warmed(calibration(accel=axes, gyro=axes)), warmed(calibration(with_gyro=False))):
        assert b"temperature_degC,accel.bias." in export_calibration(made, "csv-thermal").content


def test_a_curve_without_covariance_has_no_band() -> None:
    made = replace(warmed(calibration()), covariance=None)
    assert temperature_curve(made, "accel.bias.x", np.array([0.0, 20.0])).expanded is None
