"""A group of parameters that is entered in the table, and in nothing else, is everywhere: a constant of each
accelerometer times the square of the force along body X."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tumble.errors import InputError
from tumble.inference.joint import joint
from tumble.planning.plan import plan
from tumble.planning.setup import Setup
from tumble.result.calibration import read_calibration
from tumble.run.calibrate import calibrate
from tumble.sensors import parameters
from tumble.sensors.model import Block, SensorKind
from tumble.sensors.parameters import FUNCTIONS, PAIRS, PRODUCTS, RATE, ParameterGroup, group_of
from tumble.simulation.observations import simulate_observations
from tumble.simulation.recording import record
from tumble.simulation.scenario import Scenario, scenario_of
from tumble.simulation.session import read_truth, simulate_session
from tumble.units import Array
from tumble.views.calibration import calibration_blocks
from tumble.views.render.terminal import text_of
from tumble.views.report.document import write_report

NAME = "accel.of_x"
NAMES = tuple(f"{NAME}.{sensor}" for sensor in "xyz")
SIZE = 5e-5
"""s²/m, over instruments."""


def by_square(axis: int) -> Callable[[Block], Array]:
    """∂K/∂θ (n, 15, n) of a block, one parameter a sensor, by the square of the force along a body axis."""

    def regressors(block: Block) -> Array:
        out = np.zeros((block.size, FUNCTIONS, block.size))
        out[block.channels, PRODUCTS.start + PAIRS.index((axis, axis)), np.arange(block.size)] = 1.0
        return out

    return regressors


def group_by_square(
    name: str, kind: SensorKind, unit: str, words: str, axis: int, limit: float, size: float
) -> ParameterGroup:
    """A group of sensors by the square of the force along an axis, of the same usual size in every grade."""
    return ParameterGroup(
        name=name,
        kind=kind,
        unit=unit,
        words=words,
        suffixes=lambda block: block.sensors,
        limit=limit,
        usual=dict.fromkeys(("navigation", "tactical", "mems", "consumer"), size),
        regressors=by_square(axis),
    )


def g_squared(size: float) -> ParameterGroup:
    """The sensitivity of gyros to the square of the force along Z."""
    words = "gyros by the square of the force along Z"
    return group_by_square("gyro.g2", "gyro", "rad s^3/m^2", words, 2, 1e-3, size)


@pytest.fixture(autouse=True)
def made_up(monkeypatch: pytest.MonkeyPatch) -> ParameterGroup:
    """The group, in the table while a test runs."""
    words = "accelerometers by the square of the force along X"
    group = group_by_square(NAME, "accel", "s^2/m", words, 0, 1e-2, SIZE)
    monkeypatch.setattr(parameters, "FURTHER", [*parameters.FURTHER, group])
    return group


def test_gyros_have_one_of_products_of_forces(monkeypatch: pytest.MonkeyPatch) -> None:
    """A g²-sensitivity of 30 °/h/g², which turns by far more than first order leaves to what is integrated anew."""
    size = float(np.radians(30.0)) / 3600.0 / 9.81**2
    monkeypatch.setattr(parameters, "FURTHER", [*parameters.FURTHER, g_squared(size)])
    scenario = drawn()
    estimate = joint(simulate_observations(scenario, np.random.default_rng(5)), intervals=False)
    assert estimate.converged
    where = [estimate.names.index(f"gyro.g2.{sensor}") for sensor in "xyz"]
    truth = np.array([scenario.truth[f"gyro.g2.{sensor}"] for sensor in "xyz"])
    assert np.all(np.abs(estimate.values[where] - truth) < 6.0 * estimate.u[where])
    assert np.all(estimate.u[where] < size)


def test_accelerometers_have_none_of_rates(monkeypatch: pytest.MonkeyPatch, made_up: ParameterGroup) -> None:
    """A correction knows the rate only once it has the force, and would silently leave such a term."""

    def by_rate(block: Block) -> Array:
        return np.roll(by_square(0)(block), RATE.start - PRODUCTS.start, axis=1)

    monkeypatch.setattr(parameters, "FURTHER", [*parameters.FURTHER[:-1], replace(made_up, regressors=by_rate)])
    with pytest.raises(InputError, match=r"accel\.of_x: expected no terms in the rate"):
        record(drawn(), np.random.default_rng(4))


def drawn() -> Scenario:
    """A scenario of all groups on a cube."""
    return scenario_of(Setup.of(programme="cube-26", terms="full", gravity_u=0.0), np.random.default_rng(3))


def test_it_is_simulated() -> None:
    scenario = drawn()
    assert set(NAMES) < set(scenario.truth)
    assert all(scenario.truth[name] != 0.0 for name in NAMES)
    without = {name: 0.0 if name in NAMES else value for name, value in scenario.truth.items()}
    recordings = [record(one, np.random.default_rng(4)) for one in (scenario, replace(scenario, truth=without))]
    change = recordings[0].accel - recordings[1].accel
    along = recordings[0].accel[:, 0]
    expected = np.outer(along**2, [scenario.truth[name] for name in NAMES])  # of readings, which have errors themselves
    np.testing.assert_allclose(change, expected, rtol=0.0, atol=0.01 * np.abs(expected).max())


def test_it_is_estimated() -> None:
    scenario = drawn()
    estimate = joint(simulate_observations(scenario, np.random.default_rng(5)))
    where = [estimate.names.index(name) for name in NAMES]
    truth = np.array([scenario.truth[name] for name in NAMES])
    assert estimate.covariance.shape == (len(estimate.names),) * 2
    assert np.all(estimate.u[where] < 0.2 * SIZE)
    assert np.all(np.abs(estimate.values[where] - truth) < 6.0 * estimate.u[where])
    finding = next(one for one in estimate.groups if one.name == NAME)
    assert finding.kept
    assert finding.prior == SIZE


def test_it_is_planned() -> None:
    found = plan(Setup.of(programme="cube-26")).group(NAME)
    assert tuple(found.parameters) == tuple(NAMES)
    assert found.spread == SIZE
    assert found.u < 0.2 * SIZE


def test_it_is_in_file_table_and_report(tmp_path: Path) -> None:
    """A session of samples, calibrated; the file, the terminal and the report."""
    setup = Setup.of(programme="cube-26", terms="full", grade="mems", rest=5.0, sample_rate=50.0)
    found = calibrate(simulate_session(tmp_path / "session", setup, seed=6))
    file = tmp_path / "calibration.json"
    found.write(file)
    content = json.loads(file.read_text(encoding="utf-8"))
    assert set(NAMES) < {p["name"] for p in content["parameters"]}
    finding = next(group for group in content["groups"] if group["name"] == NAME)
    assert finding["kept"]
    assert finding["prior"] == SIZE
    assert set(content["accel"]["of_x"]) == set("xyz")
    assert read_calibration(file)[NAMES[1]].prior == pytest.approx(SIZE * finding["prior_widened"])
    for every in (False, True):
        said = text_of(calibration_blocks(read_calibration(file), every=every), 100)
        assert (NAME in said) == every
        assert all((name in said) == every for name in NAMES)
    write_report([file], tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "accelerometers by the square of the force along X" in page
    assert all(f">{name}</td>" in page for name in NAMES)


def test_it_has_its_entry() -> None:
    assert group_of(NAMES[0]).words == "accelerometers by the square of the force along X"


def test_it_is_in_the_file_the_table_and_the_report(tmp_path: Path) -> None:
    """Through a session folder and the whole chain."""
    setup = Setup.of(grade="tactical", programme="cube-14", rest=5.0, rate_deg_s=60.0, sample_rate=50.0, terms="full")
    folder = simulate_session(tmp_path / "session", setup, seed=3)
    assert set(NAMES) < set(read_truth(folder / "truth.json"))
    calibration = calibrate(folder)
    assert set(NAMES) < {parameter.name for parameter in calibration.parameters}
    calibration.write(tmp_path / "calibration.json")
    written = json.loads((tmp_path / "calibration.json").read_text(encoding="utf-8"))
    assert set(NAMES) < set(json.dumps(written).split('"'))
    back = read_calibration(tmp_path / "calibration.json")
    assert set(NAMES) < {parameter.name for parameter in back.parameters}
    assert NAME in str(calibration.table())
    write_report(tmp_path / "calibration.json", tmp_path / "report.html")
    assert NAMES[0] in (tmp_path / "report.html").read_text(encoding="utf-8")
