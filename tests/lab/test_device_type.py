"""A type by its units, as a prior for the next one, and its data sheet."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import tumble
from tumble.cli import main
from tumble.inference.estimate import Estimate
from tumble.inference.joint import joint
from tumble.inference.prior import DevicePrior, with_prior
from tumble.lab.datasheet import tolerance_factor
from tumble.lab.device_type import Unit, prior_of, unit_of_parameters
from tumble.lab.registry.registry import open_registry
from tumble.planning.setup import Setup
from tumble.reduction.observations import Observations
from tumble.result.parts import Parameter
from tumble.run.from_estimate import build_parameters
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of

NAMES = ("gyro.bias.x", "gyro.bias.y", "gyro.bias.z")


def recorded(serial: object, values: np.ndarray, u: float, names: tuple[str, ...] = NAMES) -> Unit:
    """A unit with these values of the parameters."""
    parameters = [Parameter(name=n, value=v, u=u, unit="rad/s") for n, v in zip(names, values.tolist(), strict=True)]
    return unit_of_parameters(parameters, u**2 * np.eye(len(names)), serial=str(serial), in_run={})


@pytest.mark.parametrize("units", [3, 5, 12])
def test_exact_values_give_the_mean_and_the_standard_deviation_of_the_units(units: int) -> None:
    """Of one parameter: b = s², M = b/n and n − 1 degrees of freedom, before the standard error b √(2n)/(n − 1)."""
    values = 1e-4 * np.random.default_rng(units).standard_normal((units, 1))
    prior = prior_of([recorded(i, y, 1e-9, NAMES[:1]) for i, y in enumerate(values)], "m")
    s2 = float(values.var(ddof=1))
    b = s2 * (1.0 + np.sqrt(2.0 * units) / (units - 1.0))
    assert prior.mean[0] == pytest.approx(values.mean(), rel=1e-3)
    assert prior.covariance[0, 0] == pytest.approx(b * (1.0 + 1.0 / units), rel=2e-3)
    assert prior.degrees[0] == pytest.approx(units - 1.0, rel=1e-3)


@pytest.mark.parametrize(("units", "noise"), [(3, 0.1), (3, 1.0), (8, 0.3), (20, 1.0)])
def test_the_next_unit_is_within_the_prior_as_often_as_stated(units: int, noise: float) -> None:
    """N = 150 types of three parameters, recorded with `noise` times what units differ by. At least 95.45 % less four
    standard deviations of the count."""
    rng, inside = np.random.default_rng(units), []
    for _ in range(150):
        values = 1e-4 * rng.standard_normal((units + 1, 3))
        seen = values[:units] + noise * 1e-4 * rng.standard_normal((units, 3))
        prior = prior_of([recorded(i, y, noise * 1e-4, NAMES) for i, y in enumerate(seen)], "m")
        inside.extend(np.abs(values[units] - prior.mean) < 2.0 * np.sqrt(np.diag(prior.covariance)))
    assert np.mean(inside) > 0.9545 - 4.0 * np.sqrt(0.0434 / len(inside))


def test_a_parameter_that_differs_more_than_its_group_has_a_variance_of_its_own() -> None:
    values = 1e-4 * np.random.default_rng(1).standard_normal((12, 3)) * np.array([1.0, 1.0, 30.0])
    size = np.sqrt(np.diag(prior_of([recorded(i, y, 1e-7) for i, y in enumerate(values)], "m").covariance))
    assert size[2] > 0.9 * values[:, 2].std(ddof=1)
    assert size[:2].max() < size[2]


def test_what_was_usual_of_a_grade_is_taken_out_of_the_evidence() -> None:
    """C⁻¹ = Λ + P: the information of a recording is the same with and without a prior, whatever their correlations."""
    rng = np.random.default_rng(2)
    A = rng.standard_normal((6, 4)) * 1e3
    names = ("accel.bias.x", "accel.bias.y", "accel.quadratic.x", "accel.quadratic.y")
    x, P = 1e-3 * rng.standard_normal(4), np.array([0.0, 0.0, 1e6, 1e6])
    known = []
    for precision in (np.zeros(4), P):
        C = np.asarray(np.linalg.inv(A.T @ A + np.diag(precision)))
        values = C @ (A.T @ A @ x)
        parameters = [
            Parameter(name=n, value=v, u=float(np.sqrt(c)), unit="1", prior=float(p**-0.5) if p else None)
            for n, v, c, p in zip(names, values.tolist(), np.diag(C), precision, strict=True)
        ]
        known.append(unit_of_parameters(parameters, C, serial="1", in_run={}))
    np.testing.assert_allclose(known[1].information, known[0].information, rtol=1e-8, atol=1e-3)
    np.testing.assert_allclose(known[1].shift, known[0].shift, rtol=1e-8)


def test_means_that_no_recording_tells_apart_stay_unknown_however_many_units() -> None:
    """Of a bias and K₂ that are seen as their sum alone; their sum is known."""
    names = ("accel.bias.x", "accel.quadratic.x")
    rng, P = np.random.default_rng(3), np.array([0.0, 1e4])
    units = []
    for i in range(30):
        C = np.asarray(np.linalg.inv(np.full((2, 2), 1e10) + np.diag([1e-2, P[1]])))
        values = C @ (1e10 * np.full(2, 2e-3 + 1e-4 * rng.standard_normal()))
        parameters = [
            Parameter(name=n, value=v, u=float(np.sqrt(c)), unit="1", prior=1e-2 if p else None)
            for n, v, c, p in zip(names, values.tolist(), np.diag(C), P, strict=True)
        ]
        units.append(unit_of_parameters(parameters, C, serial=str(i), in_run={}))
    prior, one = prior_of(units, "m"), np.ones(2)
    assert np.sqrt(np.diag(prior.covariance)).min() > 5e-3
    assert np.sqrt(one @ prior.covariance @ one) < 5e-4
    assert prior.mean.sum() == pytest.approx(2e-3, abs=2e-4)


def test_two_units_are_no_type() -> None:
    units = [recorded(i, np.full(3, 1e-5 * i), 1e-7) for i in range(3)]
    assert len(prior_of(units, "m").names) == 3
    assert prior_of(units[:2], "m").names == ()


# A small instrument: complete estimates


SETUP = Setup.of(grade="mems", positions=14, terms="full")
Estimated = tuple[Estimate, Observations, dict[str, float]]


def estimated(number: int) -> Estimated:
    """A unit of a type with a fifth of the usual spread about means of the usual spread."""
    rng = np.random.default_rng([5, number])
    mean, own = scenario_of(SETUP, np.random.default_rng(5)), scenario_of(SETUP, rng)
    truth = {name: mean.truth[name] + 0.2 * own.truth[name] for name in mean.truth}
    observations = simulate_observations(replace(own, truth=truth), rng)
    return joint(observations), observations, truth


@pytest.fixture(scope="module")
def units() -> list[Estimated]:
    return [estimated(number) for number in range(9)]


@pytest.fixture(scope="module")
def prior(units: list[Estimated]) -> DevicePrior:
    """Of the ninth unit by the eight others."""
    return prior_of([seen_in(estimate, str(i)) for i, (estimate, _, _) in enumerate(units[:8])], "m")


def seen_in(estimate: Estimate, serial: str, more: float = 0.0) -> Unit:
    """What an estimate says of a unit whose scale factor y is larger by so much."""
    seen = np.flatnonzero(estimate.observable)
    every = [replace(p, value=p.value + more * (p.name == "accel.scale.y")) for p in build_parameters(estimate, seen)]
    return unit_of_parameters(every, estimate.covariance[np.ix_(seen, seen)], serial=serial, in_run={})


def test_a_type_narrows_what_only_priors_say_and_its_budget_is_the_covariance(
    units: list[Estimated], prior: DevicePrior
) -> None:
    estimate, observations, truth = units[8]
    made, notes = with_prior(estimate, observations, prior)
    assert "8 other units of the type 'm' are a prior" in notes[0]
    assert made.budget is not None
    np.testing.assert_allclose(made.budget.covariances.sum(axis=0), made.covariance, rtol=1e-9)
    assert "type" in {each.name for each in made.budget.sources}
    z = (made.values - np.array([truth[name] for name in made.names])) / made.u
    assert np.sqrt(np.mean(z[:21] ** 2)) < 1.6
    of_type = [i for i, name in enumerate(made.names) if name.startswith(("accel.lever.", "gyro.g_sensitivity."))]
    assert np.all(made.u[of_type] < 0.9 * estimate.u[of_type])
    assert np.all(made.u < 1.02 * estimate.u)


def test_an_outlier_is_named_and_judged_by_itself(units: list[Estimated], prior: DevicePrior) -> None:
    """Seven standard deviations of the units and of the recording off the mean."""
    estimate, observations, _ = units[8]
    i, k = estimate.names.index("accel.scale.y"), prior.names.index("accel.scale.y")
    values = estimate.values.copy()
    values[i] = prior.mean[k] + 7.0 * np.hypot(np.sqrt(prior.covariance[k, k]), estimate.u[i])
    made, notes = with_prior(replace(estimate, values=values), observations, prior)
    assert [note.split()[3] for note in notes if note.startswith("unlike its type")] == ["accel.scale.y"]
    assert abs(made.values[i] - values[i]) < estimate.u[i]


def test_only_differences_from_the_type_count_however_large_its_scale_factor_errors_are(
    units: list[Estimated], prior: DevicePrior
) -> None:
    """With 2 % more of a scale factor, a hundred u, in all units of the type and in this one nothing else changes:
    what the integral over hyperparameters leaves of the prior in C beyond its own parameters is no lever."""
    estimate, observations, _ = units[8]
    i, values = estimate.names.index("accel.scale.y"), estimate.values.copy()
    values[i] += 0.02
    moved = prior_of([seen_in(each, str(n), 0.02) for n, (each, _, _) in enumerate(units[:8])], "m")
    made, notes = with_prior(estimate, observations, prior)
    after, notes_after = with_prior(replace(estimate, values=values), observations, moved)
    change = after.values - made.values
    change[i] -= 0.02
    assert np.abs(change / made.u).max() < 0.05
    assert [note.split(" is ")[0] for note in notes] == [note.split(" is ")[0] for note in notes_after]


# Through the registry


def unit(folder: Path, number: int) -> Path:
    """A session of a unit with a type."""
    session = tumble.simulate_session(folder / f"unit-{number}", Setup.of(grade="mems", positions=12), seed=number)
    text = (session / "session.toml").read_text()
    (session / "session.toml").write_text(text.replace("[device]\n", '[device]\nmodel = "M-1"\n', 1))
    return session


def run(*words: object) -> tuple[int, str, str]:
    done = CliRunner().invoke(main, [str(word) for word in words])
    return done.exit_code, done.stdout, done.stderr


def test_a_registry_is_a_prior_of_the_next_unit_and_what_it_made_is_no_evidence(tmp_path: Path) -> None:
    place, next_unit = tmp_path / "registry.sqlite", unit(tmp_path, 9)
    for number in (1, 2, 3):
        calibration = tumble.calibrate(unit(tmp_path, number))
        with open_registry(place, create=True) as registry:
            registry.add_calibration(calibration)
        if number == 1:
            continue
        status, text, talk = run("calibrate", next_unit, "--registry", place, "--force", "--json")
        assert status == 0, talk
        made = json.loads(text)
        by_type = [note for note in made["notes"] if "'M-1'" in note]
        if number == 2:
            assert by_type == ["no prior by 2 other units of the type 'M-1', fewer than 3"]
            assert "prior" not in made["provenance"]
        else:
            assert by_type[0].startswith("3 other units of the type 'M-1' are a prior of ")
            assert made["provenance"]["prior"] == "3 other units of the type 'M-1'"
    with open_registry(place) as registry:
        registry.add_calibration(next_unit / "calibration.json")
        assert registry.prior("M-1").words == "3 other units of the type 'M-1'"
        assert registry.prior("M-1", without="mems-2").names == ()
        assert registry.prior("M-2").words == "0 other units of the type 'M-2', fewer than 3"
    linear = run("calibrate", next_unit, "--registry", place, "--terms", "linear")
    assert linear[0] == 2
    assert "--registry: expected one session and the method joint" in linear[2]
    status, text, talk = run("registry", "show", "--type", "M-1", "--registry", place, "-o", tmp_path / "sheet.html")
    assert status == 0, talk
    line = next(line for line in text.splitlines() if line.startswith("accel.bias.x"))
    assert line.split()[1:4] == ["zero-g", "offset", "3"]
    assert "zero-g offset" in (tmp_path / "sheet.html").read_text(encoding="utf-8")
    rows = {
        row["name"]: row
        for row in json.loads(run("registry", "show", "--type", "M-1", "--registry", place, "--json")[1])["rows"]
    }
    bias = rows["accel.bias.x"]
    half = tolerance_factor(3) * bias["between"]
    assert bias["least"] <= bias["typical"] <= bias["most"]
    assert (bias["low"], bias["high"]) == pytest.approx((bias["typical"] - half, bias["typical"] + half))
    assert {"accel.in_run", "gyro.in_run"} <= set(rows)


@pytest.mark.parametrize(("n", "k"), [(2, 36.519), (3, 9.789), (5, 5.077), (10, 3.393), (20, 2.760), (30, 2.555)])
def test_tolerance_factors_are_those_of_the_tables(n: int, k: float) -> None:
    """Exact two-sided factors of 95 % with 95 % confidence: Odeh & Owen (1980), ISO 16269-6."""
    assert tolerance_factor(n) == pytest.approx(k, abs=6e-4)
