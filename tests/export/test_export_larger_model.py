"""Exports of a calibration with all groups of parameters: what they hold is applied, what they do not is sized."""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.export.test_export_c import PROGRAM, gcc
from tests.export.test_export_mat_csv import read_csv, read_mat
from tests.support.calibrated import HEXAD, calibration, warmed
from tests.support.exports import beside
from tests.use.test_applied_model import larger, read, truth
from tumble.export import FORMATS, export_calibration
from tumble.export.exported import not_held
from tumble.inference.prediction import Prediction
from tumble.result.calibration import Calibration
from tumble.result.temperature_curves import model_at
from tumble.units import DEGREE, G_STANDARD, Array

__all__ = ["gcc"]


def run(compiler: str, folder: Path, made: Calibration, kind: str, given: Array, *, warm: bool = False) -> Array:
    """What the compiled function in double makes of rows of readings, for gyros of forces after them, and of
    temperatures after these where it is `warm`."""
    (folder / "imu.h").write_bytes(export_calibration(made, "c").content)
    model = made.accel if kind == "accel" else made.gyro
    assert model is not None
    n, count = len(model.bias), given.shape[1]
    text = PROGRAM % {"n": n, "function": f"{kind}_at" if warm else kind, "digits": 10, "type": "double"}
    text = text.replace(f"r[{n}]", f"r[{count}]").replace(f"i < {n}", f"i < {count}")
    force, first = (f", r + {n}", n + 3) if kind == "gyro" else ("", n)
    celsius = "" if not warm else f", r[{first}]" if count == first + 1 else f", r + {first}"
    text = text.replace("(r, t)", f"(r{force}{celsius}, t)")
    (folder / "main.c").write_text(text)
    flags = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wno-unused-function"]
    subprocess.run([compiler, *flags, str(folder / "main.c"), "-o", str(folder / kind)], check=True)
    lines = "\n".join(" ".join(map(float.hex, row)) for row in given.tolist())
    out = subprocess.run([folder / kind], input=lines, capture_output=True, text=True, check=True).stdout
    return np.array([[float.fromhex(word) for word in line.split()[:3]] for line in out.splitlines()])


@pytest.mark.parametrize("axes", [None, HEXAD / np.linalg.norm(HEXAD, axis=1)[:, None]], ids=["triad", "six sensors"])
def test_the_header_applies_what_the_library_does(tmp_path: Path, gcc: str, axes: Array | None) -> None:
    made, instrument, values = larger(accel=axes, gyro=axes)
    pairs = [truth(seed) for seed in (1, 2)]
    force, rate = (np.concatenate(each) for each in zip(*pairs, strict=True))
    accel, gyro = read(instrument, values, force, rate)
    found_f, found_w = made.apply(accel, gyro)
    assert found_w is not None
    assert len(accel) == 1000
    np.testing.assert_allclose(run(gcc, tmp_path, made, "accel", accel), found_f, rtol=0.0, atol=1e-12)
    rows = np.hstack([gyro, found_f])
    np.testing.assert_allclose(run(gcc, tmp_path, made, "gyro", rows), found_w, rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("axes", [None, HEXAD / np.linalg.norm(HEXAD, axis=1)[:, None]], ids=["triad", "six sensors"])
def test_the_header_applies_slopes_at_a_temperature_as_the_library_does(
    tmp_path: Path, gcc: str, axes: Array | None
) -> None:
    made, instrument, values = larger(accel=axes, gyro=axes)
    force, rate = truth(1)
    accel, gyro = read(instrument, values, force, rate)
    celsius = np.linspace(-20.0, 60.0, len(accel))
    found_f, found_w = made.apply(accel, gyro, temperature=celsius + 273.15)
    assert found_w is not None
    rows = np.hstack([accel, celsius[:, None]])
    np.testing.assert_allclose(run(gcc, tmp_path, made, "accel", rows, warm=True), found_f, rtol=0.0, atol=1e-12)
    rows = np.hstack([gyro, found_f, celsius[:, None]])
    np.testing.assert_allclose(run(gcc, tmp_path, made, "gyro", rows, warm=True), found_w, rtol=0.0, atol=1e-13)
    assert np.abs(found_f - made.apply(accel, gyro)[0]).max() > 1e-3
    assert "those in _at take it, in degC" in export_calibration(made, "c").content.decode()


def test_the_header_applies_curvatures_of_a_linear_model(tmp_path: Path, gcc: str) -> None:
    made, rng = warmed(calibration()), np.random.default_rng(1)
    true = rng.normal(size=(8, 3))
    for celsius in (-18.5, 30.0, 57.25):
        reading = model_at(made, "accel", celsius).predict(true)
        rows = np.hstack([reading, np.full((8, 1), celsius)])
        np.testing.assert_allclose(run(gcc, tmp_path, made, "accel", rows, warm=True), true, rtol=0.0, atol=1e-12)
    assert "measured from -18.5 to 57.2" in export_calibration(made, "c").content.decode()


def test_tables_hold_prior_learned_k_and_degrees_of_freedom() -> None:
    made, _, _ = larger()
    made = replace(made, parameters=tuple(replace(p, dof=7.0) for p in made.parameters))
    rows, content = read_csv(made), read_mat(made)
    for i, p in enumerate(made.parameters):
        row = rows[p.name]
        assert [row["prior"], row["learned"]] == ["" if v is None else repr(v) for v in (p.prior, p.learned)]
        assert (float(row["k"]), float(row["dof"])) == (p.k, p.dof)
        assert content["parameter_k"].ravel()[i] == p.k
        assert np.isnan(content["parameter_prior"].ravel()[i]) == (p.prior is None)


@pytest.mark.parametrize("to", [name for name in FORMATS if not name.endswith("-thermal")])
def test_every_format_says_what_it_loses_of_the_larger_model(to: str) -> None:
    made, _, _ = larger(leave=())
    said = export_calibration(made, to, **beside(to)).losses
    held = {"c": 14, "firmware": 14, "imucal": 1, "kalibr": 1}.get(to, 0)
    beyond = [s for s in said if "an error of up to" in s and (": no place" in s or ": not in matrix" in s)]
    assert len(beyond) == 17 - held
    assert all(s.isascii() for s in beyond)


@pytest.mark.parametrize("to", [name for name in FORMATS if name.endswith("-thermal")])
def test_formats_over_temperature_say_what_they_lose_of_the_larger_model(to: str) -> None:
    """Slopes are in them; the nine groups that do not change with temperature are not."""
    made = warmed(larger(leave=())[0])
    assert made.reference_temperature is not None
    lost = [s for s in export_calibration(made, to).losses if "no place in this file, an error of up to" in s]
    assert len(lost) == 9
    assert all("mg " in s or "deg/s " in s for s in lost)


def test_the_size_of_what_is_lost_is_that_of_the_readings() -> None:
    """The square of 1 g for the quadratic term; of the g-sensitivity of a gyro the length of its row."""
    made, _, _ = larger()
    by_name = {p.name: p.value for p in made.parameters}
    quadratic = max(abs(v) for n, v in by_name.items() if n.startswith("accel.quadratic")) * G_STANDARD**2
    rows = [[by_name[f"gyro.g_sensitivity.{s}{c}"] for c in "xyz"] for s in "xyz"]
    sensitivity = max(np.linalg.norm(row) for row in rows) * G_STANDARD
    said = " ".join(not_held(made))
    assert f"an error of up to {quadratic / (1e-3 * G_STANDARD):.3g} mg in 1 g" in said
    found = float(said.partition("g-sensitivity of the gyros: no place in this file, an error of up to ")[2].split()[0])
    assert 0.98 * sensitivity / DEGREE < found <= 1.01 * sensitivity / DEGREE


def test_parameters_that_a_file_lacks_count_as_zero() -> None:
    made, _, _ = larger()
    parameters = tuple(p for p in made.parameters if p.name != "accel.cubic.y")
    assert [s for s in not_held(replace(made, parameters=parameters)) if s.startswith("cubic")]


def test_imucal_holds_the_g_sensitivity() -> None:
    made, _, _ = larger()
    content = json.loads(export_calibration(made, "imucal").content)
    G = np.array(content["K_ga"]) * DEGREE
    np.testing.assert_allclose(G, made.compensator.gyro_coefficients[:, 4:7], rtol=1e-14)
    assert np.any(G)


def test_losses_far_below_the_uncertainty_of_a_reading_are_said_in_one_sentence() -> None:
    made = larger()[0]
    every = not_held(replace(made, prediction=None))
    known = not_held(replace(made, prediction=Prediction(force_u=1e3, rate_u=None, at_rate=None)))
    of_gyros = [said for said in every if "gyro" in said and "accelerometers after" not in said]
    assert list(known[:-1]) == of_gyros
    assert known[-1].endswith("errors of less than a tenth of the standard uncertainty of a reading")
    assert all(said.partition(":")[0] in known[-1] for said in every if said not in of_gyros)
