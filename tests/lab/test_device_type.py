"""A type learned from its units, and as a prior for the next one."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.optimize import brentq
from scipy.stats import chi2, norm, t

import tumble
from tumble.cli import main
from tumble.inference.estimate import Estimate
from tumble.inference.joint import joint
from tumble.lab.datasheet import tolerance_factor
from tumble.lab.device_type import DeviceType, KnownCalibration, with_type
from tumble.lab.registry.adding import add_calibration
from tumble.lab.registry.series import device_type
from tumble.lab.registry.store.connect import open_registry
from tumble.planning.bounds import stated
from tumble.planning.plan import plan
from tumble.planning.setup import Setup, with_all_groups
from tumble.reduction.observations import Observations
from tumble.result.parts import Parameter
from tumble.run.from_estimate import learned_in, parameters_of
from tumble.sensors.parameters import positions_by_group
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of

NAMES = ("gyro.bias.x", "gyro.bias.y", "gyro.bias.z")


def recorded(serial: object, values: np.ndarray, u: float, names: tuple[str, ...] = NAMES) -> KnownCalibration:
    """A unit with these values of the parameters."""
    parameters = [Parameter(name=n, value=v, u=u, unit="rad/s") for n, v in zip(names, values.tolist(), strict=True)]
    covariance = u**2 * np.eye(len(names))
    return KnownCalibration.of(parameters, covariance, serial=str(serial), logs={str(serial)}, in_run={})


@pytest.mark.parametrize("units", [3, 5, 12])
def test_exact_values_of_few_units_predict_by_student_t(units: int) -> None:
    """Eq. (4) with M: of one parameter n − 1 degrees of freedom, of three that share τ 3 (n − 1)."""
    rng = np.random.default_rng(units)
    values = 1e-4 * rng.standard_normal((units, 1))
    known = DeviceType(model="m", known=tuple(recorded(i, y, 1e-12, NAMES[:1]) for i, y in enumerate(values)))
    learned = known.learned()
    parameter, own = learned.parameters[NAMES[0]], float(learned.covariance[0, 0])
    s = float(values.std(ddof=1))
    for sizes in (0.5, 1.0, 2.0, 4.0):
        x = sizes * s * np.sqrt(1.0 + 1.0 / units)
        assert parameter.chance(x, own) == pytest.approx(2.0 * t.sf(sizes, units - 1), rel=0.15)
    assert parameter.between == pytest.approx(s, rel=0.03)


def test_parameters_of_a_group_share_what_units_differ_by_unless_they_contradict_it() -> None:
    one = 1e-4 * np.random.default_rng(1).standard_normal(12)
    alike = np.stack([one, one[::-1], np.roll(one, 5)], axis=1)
    for part, shared in ((np.array([1.0, 1.0, 1.0]), True), (np.array([1.0, 1.0, 30.0]), False)):
        units = tuple(recorded(i, y * part, 1e-7) for i, y in enumerate(alike))
        learned = DeviceType(model="m", known=units).learned()
        sizes = [learned.parameters[name].between for name in NAMES]
        assert (len(set(sizes)) == 1) == shared


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
        known.append(KnownCalibration.of(parameters, C, serial="1", logs=(), in_run={}))
    np.testing.assert_allclose(known[1].information, known[0].information, rtol=1e-8, atol=1e-3)
    np.testing.assert_allclose(known[1].shift, known[0].shift, rtol=1e-8)


def test_two_units_are_no_type_and_a_unit_says_nothing_of_itself() -> None:
    known = DeviceType(model="m", known=tuple(recorded(i, np.full(3, 1e-5 * i), 1e-7) for i in range(3)))
    assert len(known.learned().parameters) == 3
    assert known.without("1").units == 2
    assert not known.without("1").learned().parameters
    assert known.without("7", {"2"}).units == 2


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
        units.append(
            replace(KnownCalibration.of(parameters, C, serial=str(i), logs=(), in_run={}), says=frozenset(names))
        )
    learned = DeviceType(model="m", known=tuple(units)).learned()
    M, one = learned.covariance, np.ones(2)
    assert np.sqrt(np.diag(M)).min() > 5e-3
    assert np.sqrt(one @ M @ one) < 5e-4
    assert learned.mean.sum() == pytest.approx(2e-3, abs=2e-4)


# A small instrument: complete estimates


SETUP = Setup.of(grade="mems", positions=14, terms="full")


def estimated(number: int) -> tuple[Estimate, Observations, dict[str, float]]:
    """A unit of a type with a fifth of the usual spread about means of the usual spread."""
    rng = np.random.default_rng([5, number])
    mean, own = scenario_of(SETUP, np.random.default_rng(5)), scenario_of(SETUP, rng)
    truth = {name: mean.truth[name] + 0.2 * own.truth[name] for name in mean.truth}
    observations = simulate_observations(replace(own, truth=truth), rng)
    return joint(observations), observations, truth


@pytest.fixture(scope="module")
def type_of_eight() -> tuple[DeviceType, list[tuple[Estimate, Observations, dict[str, float]]]]:
    units = [estimated(number) for number in range(9)]
    known = []
    for number, (estimate, _, _) in enumerate(units):
        seen = np.flatnonzero(estimate.observable)
        every, covariance = parameters_of(estimate, seen, {}, learned_in(estimate)), estimate.covariance
        own = covariance[np.ix_(seen, seen)]
        known.append(KnownCalibration.of(every, own, serial=str(number), logs={str(number)}, in_run={}))
    return DeviceType(model="m", known=tuple(known)), units


def test_a_type_narrows_what_only_priors_say_and_its_budget_is_the_covariance(
    type_of_eight: tuple[DeviceType, list[tuple[Estimate, Observations, dict[str, float]]]],
) -> None:
    known, units = type_of_eight
    estimate, observations, truth = units[8]
    made, said = with_type(estimate, observations, known.without("8"))
    assert "8 other units of the type 'm' are a prior" in said[0]
    assert made.budget is not None
    np.testing.assert_allclose(made.budget.covariances.sum(axis=0), made.covariance, rtol=1e-9)
    assert "type" in {each.name for each in made.budget.sources}
    z = (made.values - np.array([truth[name] for name in made.names])) / made.u
    assert np.sqrt(np.mean(z[:21] ** 2)) < 1.6
    quadratic = [i for i, name in enumerate(made.names) if name.startswith("accel.quadratic.")]
    assert np.all(made.u[quadratic] < 0.8 * estimate.u[quadratic])
    assert np.all(made.u < 1.02 * estimate.u)


def test_an_outlier_of_five_standard_deviations_is_named_and_judged_by_itself(
    type_of_eight: tuple[DeviceType, list[tuple[Estimate, Observations, dict[str, float]]]],
) -> None:
    known, units = type_of_eight
    estimate, observations, _ = units[8]
    i, learned = estimate.names.index("accel.scale.y"), known.without("8").learned()
    parameter, place = learned.parameters["accel.scale.y"], list(learned.parameters).index("accel.scale.y")
    values = estimate.values.copy()
    values[i] = learned.mean[place] + 6.0 * np.hypot(parameter.between, estimate.u[i])
    made, said = with_type(replace(estimate, values=values), observations, known.without("8"))
    assert [sentence.split()[3] for sentence in said if sentence.startswith("unlike its type")] == ["accel.scale.y"]
    assert abs(made.values[i] - values[i]) < estimate.u[i]


def test_only_differences_from_the_type_count_however_large_its_scale_factor_errors_are(
    type_of_eight: tuple[DeviceType, list[tuple[Estimate, Observations, dict[str, float]]]],
) -> None:
    """With 2 % more of a scale factor, a hundred u, in all units of the type and in this one nothing else changes:
    what the integral over hyperparameters leaves of the prior in C beyond its own parameters is no lever."""
    known, units = type_of_eight
    estimate, observations, _ = units[8]
    i, values = estimate.names.index("accel.scale.y"), estimate.values.copy()
    values[i] += 0.02
    moved = []
    for each in known.without("8").known:
        more = np.array([0.02 * (name == "accel.scale.y") for name in each.names])
        moved.append(replace(each, shift=each.shift + each.information @ more))
    made, said = with_type(estimate, observations, known.without("8"))
    after, said_after = with_type(replace(estimate, values=values), observations, replace(known, known=tuple(moved)))
    change = after.values - made.values
    change[i] -= 0.02
    assert np.abs(change / made.u).max() < 0.05
    assert [line.split(" is ")[0] for line in said] == [line.split(" is ")[0] for line in said_after]


# As a plan has it


class Told:
    """What a type would say of two groups and a scale factor: standard deviations in parts of 1e-4, SI."""

    def __init__(self, sizes: dict[str, float]) -> None:
        self.sizes = sizes

    def prior(self, names: Sequence[str]) -> tuple[list[int], np.ndarray]:
        places = [i for i, name in enumerate(names) if name in self.sizes]
        u = 1e-4 * np.array([self.sizes[names[i]] for i in places])
        return places, np.outer(u, u) * (0.8 * np.eye(len(u)) + 0.2)


def test_a_plan_has_the_type_in_the_place_of_what_is_usual() -> None:
    """C⁻¹ less the precision of the type is what the recording says, whatever the type: nothing of the grade stays."""
    setup = with_all_groups(replace(Setup.of(grade="mems"), clock_u=0.0))
    setup = replace(setup, noise=replace(setup.noise, accel_instability=0.0, gyro_instability=0.0))
    names, said = stated(setup).names, []
    group = [name for name in names if name.startswith(("accel.quadratic.", "accel.cubic."))]
    for factor in (1.0, 7.0):
        told = Told(dict.fromkeys(("accel.scale.x", *group), factor))
        places, covariance = told.prior(names)
        C = stated(setup, device_type=told).covariance
        size = np.sqrt(np.diag(C))
        information = np.linalg.inv(C / np.outer(size, size)) / np.outer(size, size)
        information[np.ix_(places, places)] -= np.linalg.inv(covariance)
        said.append(information)
    size = np.sqrt(np.diag(said[0]))
    np.testing.assert_allclose(said[1] / np.outer(size, size), said[0] / np.outer(size, size), atol=1e-5)


def test_a_plan_expects_the_u_that_calibrate_has_of_a_unit_of_the_type(
    type_of_eight: tuple[DeviceType, list[tuple[Estimate, Observations, dict[str, float]]]],
) -> None:
    known, units = type_of_eight
    setup, made = Setup.of(grade="mems", programme="cube-14", terms="full"), []
    for number in range(20, 28):
        truth = {**units[number - 20][2]}
        observations = simulate_observations(
            replace(scenario_of(setup, np.random.default_rng(number)), truth=truth), np.random.default_rng(number)
        )
        made.append(with_type(joint(observations), observations, known.without(str(number - 20)))[0])
    planned, usual = stated(setup, device_type=known), stated(setup)
    for group, places in positions_by_group(made[0].names).items():
        u = np.sqrt(np.mean([each.u[places] ** 2 for each in made]))
        assert 0.7 < planned.rms(group) / u < 1.3, group
    for group in ("accel.bias", "accel.quadratic", "accel.asymmetry", "accel.lever"):
        assert planned.rms(group) < 0.75 * usual.rms(group)


# Through the registry


def unit(folder: Path, number: int) -> Path:
    """A session of a unit with a type."""
    session = tumble.simulate_session(folder / f"unit-{number}", Setup.of(grade="mems", positions=12), seed=number)
    stated = session / "session.toml"
    stated.write_text(stated.read_text().replace("[device]\n", '[device]\nmodel = "M-1"\n', 1))
    return session


def test_a_registry_is_a_prior_of_the_next_unit_and_what_it_made_is_no_evidence(tmp_path: Path) -> None:
    place, next_unit = str(tmp_path / "registry.sqlite"), unit(tmp_path, 9)
    for number in (1, 2, 3):
        calibration = tumble.calibrate(unit(tmp_path, number))
        with open_registry(place, create=True) as registry:
            add_calibration(registry, calibration)
        if number == 1:
            continue
        ran = CliRunner().invoke(main, ["calibrate", str(next_unit), "--registry", place, "--force", "--json"])
        assert ran.exit_code == 0, ran.output
        made = json.loads(ran.stdout)
        by_type = [note for note in made["notes"] if "'M-1'" in note]
        if number == 2:
            assert by_type == ["the type 'M-1' has 2 other units in the registry: no prior by fewer than 3"]
            assert "type" not in made["provenance"]
        else:
            assert by_type[0].startswith("3 other units of the type 'M-1' are a prior of ")
            assert made["provenance"]["type"] == "M-1"
    with open_registry(place) as registry:
        add_calibration(registry, tumble.read_calibration(next_unit / "calibration.json"))
        assert device_type(registry, "M-1").units == 3
        assert "device type" in plan(Setup.of(), device_type=device_type(registry, "M-1")).group("accel.scale").sources
        with pytest.raises(tumble.InputError, match="type 'M-2': expected at least 3 units, found 0"):
            plan(Setup.of(), device_type=device_type(registry, "M-2"))
    planned = CliRunner().invoke(main, ["plan", "--grade", "mems", "--registry", place, "--model", "M-1"])
    assert planned.exit_code == 0, planned.output
    assert "3 units of the type 'M-1'" in planned.output
    alone = CliRunner().invoke(main, ["plan", "--model", "M-1"])
    assert alone.exit_code == 2
    assert "--registry: expected with --model" in alone.stderr
    twice = ["calibrate", str(next_unit), str(next_unit), "--registry", place, "--out", str(tmp_path / "x.json")]
    refused = CliRunner().invoke(main, twice)
    assert refused.exit_code == 2
    assert "--registry: expected one session" in refused.stderr
    for ending in ("md", "html", "pdf"):
        out = tmp_path / f"sheet.{ending}"
        ran = CliRunner().invoke(main, ["registry", "datasheet", "M-1", "--registry", place, "--out", str(out)])
        assert ran.exit_code == 0, ran.output
        assert out.stat().st_size > 1000
    assert b"/Type/Pages/Count 1/" in (tmp_path / "sheet.pdf").read_bytes()
    assert "| accel.bias.x | zero-g offset | 3 |" in (tmp_path / "sheet.md").read_text()
    ran = CliRunner().invoke(main, ["registry", "datasheet", "M-1", "--registry", place, "--json"])
    rows = {row["name"]: row for row in json.loads(ran.stdout)["rows"]}
    bias = rows["accel.bias.x"]
    half = tolerance_factor(3) * bias["between"]
    assert bias["least"] <= bias["typical"] <= bias["most"]
    assert (bias["low"], bias["high"]) == pytest.approx((bias["typical"] - half, bias["typical"] + half))
    assert {"accel.in_run", "gyro.in_run"} <= set(rows)


@pytest.mark.parametrize(("n", "k"), [(2, 36.519), (3, 9.789), (5, 5.077), (10, 3.393), (20, 2.760), (30, 2.555)])
def test_tolerance_factors_are_those_of_the_tables(n: int, k: float) -> None:
    """Exact two-sided factors of 95 % with 95 % confidence: Odeh & Owen (1980), ISO 16269-6."""
    assert tolerance_factor(n) == pytest.approx(k, abs=6e-4)


@pytest.mark.parametrize(("n", "k"), [(5, 5.079), (10, 3.379), (20, 2.752), (30, 2.549)])
def test_older_tables_have_an_approximation_of_the_tolerance_factors(n: int, k: float) -> None:
    """Bowker (1947) by Wald and Wolfowitz: k = r √(ν/χ²), r about a mean that is 1/√n off; 0.5 % less."""
    off = 1.0 / np.sqrt(n)
    r = brentq(lambda r: norm.cdf(off + r) - norm.cdf(off - r) - 0.95, 1.0, 4.0)
    approximation = r * np.sqrt((n - 1.0) / chi2.ppf(0.05, n - 1))
    assert approximation == pytest.approx(k, abs=6e-4)
    assert tolerance_factor(n) == pytest.approx(approximation, rel=5e-3)
