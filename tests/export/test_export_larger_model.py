"""Exports of a calibration with all groups of parameters: what targets hold is applied, what they do not is sized."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.export.test_export_c import PROGRAM, compiled, gcc
from tests.export.test_tables import read_csv, read_mat
from tests.result.test_applied_correction import by_formula
from tests.sensors.test_made_up_group import g_squared
from tests.support.calibrated import HEXAD, calibration, warmed
from tests.support.exports import FORMATS, beside
from tests.use.test_applied_model import larger, read, truth
from tumble.export import export_calibration
from tumble.result.calibration import Calibration
from tumble.result.correction import best_linear_model, session_rate
from tumble.rotation import unit_vector
from tumble.sensors import parameters
from tumble.sensors.model import SensorModel
from tumble.sensors.parameters import group_name, groups
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


def test_header_and_formula_apply_a_group_of_gyros_by_products_of_forces(
    tmp_path: Path, gcc: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(parameters, "FURTHER", [*parameters.FURTHER, g_squared(1e-4)])
    made, instrument, values = larger()
    force, rate = truth(1)
    accel, gyro = read(instrument, values, force, rate)
    found_f, found_w = made.apply(accel, gyro)
    assert found_w is not None
    assert np.abs(made["gyro.g2.x"].value) * 9.81**2 > 1e-4
    rows = np.hstack([gyro, found_f])
    np.testing.assert_allclose(run(gcc, tmp_path, made, "gyro", rows), found_w, rtol=0.0, atol=1e-13)
    content = json.loads(export_calibration(made, "json").content)["correction"]["gyro"]
    assert "by_products" in content["formula"]
    np.testing.assert_allclose(by_formula(content, gyro, found_f), found_w, rtol=0.0, atol=1e-9)


def test_the_header_applies_curvatures_of_a_linear_model(tmp_path: Path, gcc: str) -> None:
    made, rng = warmed(calibration()), np.random.default_rng(1)
    true = rng.normal(size=(8, 3))
    for celsius in (-18.5, 30.0, 57.25):
        reading = made.compensator.model("accel", celsius).predict(true)
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


HELD: dict[str, tuple[str, ...]] = dict.fromkeys(
    ("c", "csv-thermal", "json"), ("bias.t1", "bias.t2", "scale.t1", "scale.t2")
)
HELD |= dict.fromkeys(("px4-thermal", "ardupilot-thermal"), ("bias.t1", "bias.t2"))
"""Changes with temperature that a target holds."""


@pytest.mark.parametrize("to", FORMATS)
def test_every_target_names_what_moves_warms_and_drifts_that_it_does_not_hold(to: str) -> None:
    made = larger(leave=())[0]
    made = warmed(made, curved=False) if to.endswith("-thermal") else made
    losses = export_calibration(made, to, **beside(to)).losses
    note = "; ".join(loss for loss in losses if loss.startswith("not in "))
    present = {group_name(p.name) for p in made.parameters}
    expected = [
        group.words.partition(",")[0]
        for group in groups()
        if group.name in present and group.regressors is None and not group.linear and group.variable != "lag"
        if group.name.partition(".")[2] not in HELD.get(to, ())
    ]
    assert expected
    assert [words for words in expected if words not in note] == []
    assert note.isascii()


@pytest.mark.parametrize("kind", ["accel", "gyro"])
def test_the_matrix_and_bias_of_a_linear_format_fit_the_whole_model_best(kind: Any) -> None:
    """No other matrix leaves less over the sphere of 1 g, or of gyros with the bias at rest over the rates up to that
    of the session; what a target then says is what an independent sum of the terms gives."""
    made, instrument, values = larger()
    best, plain, rate = best_linear_model(made, kind), (made.accel, made.gyro)[kind == "gyro"], session_rate(made)
    up = unit_vector(np.random.default_rng(3).standard_normal((20_000, 3)))
    up, across = np.concatenate([up, -up]), np.concatenate([up, up])[:, [1, 2, 0]]
    if kind == "accel":
        readings, true = read(instrument, values, G_STANDARD * up, np.zeros_like(up))[0], G_STANDARD * up
    else:
        true = rate * across * np.tile([1 / 3, 2 / 3, 1.0], len(up) // 3 + 1)[: len(up), None]
        readings = read(instrument, values, G_STANDARD * up, true)[1]

    def rms(model: SensorModel) -> float:
        return float(np.sqrt(np.mean((model.apply(readings) - true) ** 2)))

    assert plain is not None
    assert rms(best) < (0.8 if kind == "accel" else 1.0) * rms(plain)
    for step in np.random.default_rng(4).standard_normal((20, 3, 4)) * 1e-4:
        bias = best.bias if kind == "gyro" else best.bias + G_STANDARD * step[:, 3]
        assert rms(best) < rms(SensorModel(matrix=best.matrix + step[:, :3], bias=bias))
    if kind == "accel":
        off = np.linalg.norm(best.apply(readings) - true, axis=1).max() / (1e-3 * G_STANDARD)
        said = " ".join(export_calibration(made, "imucal").losses)
        found = re.search(r"accelerometers by up to ([\d.]+) mg", said)
        assert found is not None
        assert float(found[1]) == pytest.approx(off, rel=0.02)


def test_a_calibration_without_further_groups_is_exported_as_it_is() -> None:
    made = calibration()
    assert best_linear_model(made, "accel") is made.accel
    assert best_linear_model(made, "gyro") is made.gyro


def test_imucal_holds_the_g_sensitivity() -> None:
    made, _, _ = larger()
    content = json.loads(export_calibration(made, "imucal").content)
    G = np.array(content["K_ga"]) * DEGREE
    np.testing.assert_allclose(G, made.compensator.gyro_coefficients[:, 4:7], rtol=1e-14)
    assert np.any(G)
