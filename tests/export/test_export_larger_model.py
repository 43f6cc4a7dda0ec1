"""Exports of a calibration with all groups of parameters: what targets hold is applied, what they do not is sized."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.export.test_export_c import PROGRAM, compiled, gcc
from tests.export.test_tables import read_csv, read_mat
from tests.support.calibrated import HEXAD, calibration, warmed
from tests.support.exports import FORMATS, beside
from tests.use.test_applied_model import larger, read, truth
from tumble.export import export_calibration
from tumble.export.exported import not_held
from tumble.inference.prediction import Prediction
from tumble.result.calibration import Calibration
from tumble.result.temperature_curves import model_at
from tumble.sensors.parameters import beyond_linear, group_name
from tumble.units import DEGREE, G_STANDARD, Array

__all__ = ["gcc"]


def run(compiler: str, folder: Path, made: Calibration, kind: str, given: Array, *, warm: bool = False) -> Array:
    """What the compiled function in double makes of rows of readings, for gyros of forces after them, and of
    temperatures after these where it is `warm`."""
    model = made.accel if kind == "accel" else made.gyro
    assert model is not None
    n, count = len(model.bias), given.shape[1]
    text = PROGRAM % {"n": n, "function": f"{kind}_at" if warm else kind, "digits": 10, "type": "double"}
    text = text.replace(f"r[{n}]", f"r[{count}]").replace(f"i < {n}", f"i < {count}")
    force, first = (f", r + {n}", n + 3) if kind == "gyro" else ("", n)
    celsius = "" if not warm else f", r[{first}]" if count == first + 1 else f", r + {first}"
    text = text.replace("(r, t)", f"(r{force}{celsius}, t)")
    lines = compiled(compiler, folder, made, text, given)
    return np.array([[float.fromhex(word) for word in line.split()[:3]] for line in lines])


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


HELD = {"c": 14, "imucal": 1, "kalibr": 1, "px4-thermal": 4, "ardupilot-thermal": 4, "csv-thermal": 8}
"""How many of the 17 groups beyond the linear model, 21 with curvatures over temperature, a target holds."""


@pytest.mark.parametrize("to", FORMATS)
def test_every_target_counts_the_groups_that_it_does_not_hold(to: str) -> None:
    made = larger(leave=())[0]
    made = warmed(made, curved=False) if to.endswith("-thermal") else made
    losses = export_calibration(made, to, **beside(to)).losses
    note = next((loss for loss in losses if loss.startswith(("not in matrix", "no place"))), "")
    named = len(re.findall(r" (?:mg|deg/s)(?: [^;()]*)?\)", note))
    others = sum(int(count) for count in re.findall(r"(\d+) more groups? of at most", note))
    groups = {group_name(p.name) for p in made.parameters if beyond_linear(p.name)}
    assert named + others == len(groups) - HELD.get(to, 0)
    assert note.isascii()


def test_the_size_of_what_is_lost_is_that_of_the_readings() -> None:
    """The square of 1 g for the quadratic term; of the g-sensitivity of a gyro the length of its row."""
    made, _, _ = larger()
    by_name = {p.name: p.value for p in made.parameters}
    quadratic = max(abs(v) for n, v in by_name.items() if n.startswith("accel.quadratic")) * G_STANDARD**2
    rows = [[by_name[f"gyro.g_sensitivity.{s}{c}"] for c in "xyz"] for s in "xyz"]
    sensitivity = max(np.linalg.norm(row) for row in rows) * G_STANDARD
    (said,) = not_held(keeping(made, "accel.quadratic", "gyro.g_sensitivity"))
    assert f"quadratic nonlinearity ({quadratic / (1e-3 * G_STANDARD):.3g} mg in 1 g)" in said
    found = float(said.partition("g-sensitivity (")[2].split()[0])
    assert 0.98 * sensitivity / DEGREE < found <= 1.01 * sensitivity / DEGREE


def keeping(made: Calibration, *groups: str) -> Calibration:
    """A calibration without the groups beyond the linear model but for these."""
    parameters = (p for p in made.parameters if not beyond_linear(p.name) or group_name(p.name) in groups)
    return replace(made, parameters=tuple(parameters), covariance=None)


def test_imucal_holds_the_g_sensitivity() -> None:
    made, _, _ = larger()
    content = json.loads(export_calibration(made, "imucal").content)
    G = np.array(content["K_ga"]) * DEGREE
    np.testing.assert_allclose(G, made.compensator.gyro_coefficients[:, 4:7], rtol=1e-14)
    assert np.any(G)


def test_the_largest_are_named_and_the_others_have_a_bound() -> None:
    made = larger()[0]
    (said,) = not_held(replace(made, prediction=None))
    sizes = [float(size) for size in re.findall(r"([\d.e-]+) mg", said.partition("of the gyros")[0])]
    assert sizes == sorted(sizes, reverse=True)
    known = Prediction(force_u=1e3, rate_u=None, at_rate=None)
    (said,) = not_held(replace(made, prediction=known))
    assert re.match(rf"not in matrix and bias: of the accelerometers \d+ groups of at most {sizes[0]} mg;", said)
