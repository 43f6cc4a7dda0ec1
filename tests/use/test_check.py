"""The field check: a calibration that still holds, and what has changed. How often it is right
`studies/field_check.py` counts."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner, Result
from scipy import stats

from tests.support.calibrated import of_device, with_fields
from tests.support.linear_instrument import stated_linear
from tests.support.shared import calibrated, copy_of, session
from tumble.cli import main
from tumble.errors import CalibrationError, InputError
from tumble.inference.estimate import Outcome
from tumble.inference.joint import joint
from tumble.methods.field_check import CHANCE, CheckResult, field_check
from tumble.planning.setup import Setup
from tumble.programme.positions import programme
from tumble.recording.session_file import read_session
from tumble.reduction.observations import Observations
from tumble.result.calibration import Calibration, read_calibration
from tumble.result.launch_variances import LaunchVariances, launch_variances
from tumble.result.parts import CalibratedDevice, CalibratedTemperature, Evidence, Launch, Parameter, Provenance
from tumble.run.calibrate import calibrate
from tumble.sensors.frames import FRAMES
from tumble.sensors.grades import TURN_ON, spread_of
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import Scenario, scenario_of
from tumble.simulation.session import simulate_session
from tumble.units import DEGREE, ZERO_CELSIUS
from tumble.use.check import check_calibration, prior_at_check

MG = 9.80665e-3
NOTHING: Mapping[str, float] = {}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A calibrated device, "calibration.json", and a session of it, "again"."""
    out = tmp_path_factory.mktemp("check")
    setup = Setup.of(grade="mems", positions=18)
    copy_of(session(setup, seed=3), out / "calibrated")
    calibrated(setup, seed=3).write(out / "calibration.json")
    simulate_session(out / "again", Setup.of(grade="mems", positions=4), seed=3)
    return out


@cache
def device(grade: str = "mems") -> tuple[Scenario, Calibration]:
    rng = np.random.default_rng(5)
    scenario = scenario_of(Setup.of(grade=grade, positions=18), rng)
    estimate = joint(simulate_observations(scenario, rng))
    template = Calibration(
        device=CalibratedDevice(serial=scenario.serial),
        method="joint",
        frame="accelerometer",
        parameters=(),
        covariance=estimate.covariance,
        accel=estimate.accel,
        gyro=estimate.gyro,
        outcome=Outcome(),
        evidence=Evidence(fits=estimate.fits),
        provenance=Provenance(site=scenario.site),
    )
    parameters = tuple(
        Parameter(name=n, value=float(v), u=float(u), unit=unit)
        for n, v, u, unit in zip(estimate.names, estimate.values, estimate.u, estimate.units, strict=True)
    )
    return scenario, replace(template, parameters=parameters)


def seen(
    rests: int, changed: Mapping[str, float] = NOTHING, *, turns: bool = True, grade: str = "mems"
) -> Observations:
    """A session of the device in which parameters have changed."""
    scenario, _ = device(grade)
    truth = dict(scenario.truth)
    for name, change in changed.items():
        truth[name] += change
    again = replace(scenario.changed(by_hand=rests), truth=truth)
    return simulate_observations(again, np.random.default_rng(1), only_programmed=not turns)


def result_of(observations: Observations) -> CheckResult:
    return field_check(observations, prior_at_check(device()[1], observations, "mems", {}))


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("accel.bias.y", 5 * MG),
        ("accel.scale.z", -5e-3),
        ("gyro.bias.x", -0.2 * DEGREE),
        ("gyro.scale.y", 5e-3),
        ("gyro.bias.z", 3.0 * DEGREE),
    ],
)
def test_a_change_is_named_with_its_size(name: str, size: float) -> None:
    found = result_of(seen(4, {name: size}))
    assert [change.name for change in found.changes] == [name]
    (change,) = found.changes
    assert abs(change.value - size) < 4.0 * change.u
    assert found.explained
    assert not found.valid


def test_two_changes_are_found_together() -> None:
    found = result_of(seen(5, {"accel.bias.x": 10 * MG, "gyro.bias.y": 0.4 * DEGREE}))
    sizes = {change.name: change.value for change in found.changes}
    assert sizes.keys() == {"accel.bias.x", "gyro.bias.y"}
    assert sizes["accel.bias.x"] == pytest.approx(10 * MG, rel=0.3)
    assert sizes["gyro.bias.y"] == pytest.approx(0.4 * DEGREE, rel=0.3)


def test_what_the_rests_do_not_show_is_not_judged() -> None:
    found = result_of(seen(3, turns=False))
    assert not [name for name in found.tests if name.startswith(("gyro.scale", "gyro.axis"))]
    assert found.valid


def test_a_rest_that_moved_is_explained_by_no_change() -> None:
    observations = seen(5)
    accel = observations.rests.accel.copy()
    accel[2] *= 1.02
    found = result_of(replace(observations, rests=replace(observations.rests, accel=accel)))
    assert not found.valid


def test_the_update_is_nearer_to_the_truth() -> None:
    size = 0.3 * DEGREE
    found, (scenario, calibration) = result_of(seen(5, {"gyro.bias.x": size})), device()
    i = scenario.names.index("gyro.bias.x")
    truth = scenario.truth["gyro.bias.x"] + size
    assert abs(found.values[i] - truth) < 4.0 * np.sqrt(found.covariance[i, i])
    assert np.sqrt(found.covariance[i, i]) < 0.02 * DEGREE
    assert abs(calibration["gyro.bias.x"].value - truth) > 0.2 * DEGREE


def test_a_gravity_that_both_state_is_in_the_scale_factors() -> None:
    here = replace(seen(3), site=device()[0].site)
    shared = prior_at_check(device()[1], here, "mems", {})
    apart = prior_at_check(with_fields(device()[1], site=None), here, "mems", {})
    i = 1 + shared.instrument.names.index("accel.scale.x")
    assert shared.covariance[0, i] < 0.0
    assert apart.covariance[0, i] == 0.0


def test_parameters_are_taken_to_the_temperature_of_the_check() -> None:
    observations, calibration = seen(3), device()[1]
    warm = np.full((3, 1), 40.0 + ZERO_CELSIUS)
    here = replace(observations, rests=replace(observations.rests, temperatures=warm))
    cold = replace(calibration, temperature=CalibratedTemperature(reference=20.0))
    known, same = (
        prior_at_check(c, here, "mems", {})
        for c in (cold, replace(calibration, temperature=CalibratedTemperature(reference=40.0)))
    )
    i = 1 + known.instrument.names.index("accel.bias.x")
    more = known.covariance[i, i] - same.covariance[i, i]
    assert np.sqrt(more) == pytest.approx(np.hypot(20.0 * 0.3 * MG, 20.0**2 * 0.3 * MG / 60.0), rel=1e-6)


def test_curvatures_of_the_calibration_are_used() -> None:
    """b(T) = b + θ₁ (T − T₀) + θ₂ (T − T₀)², with u of the curvature as the calibration has it."""
    observations, calibration = seen(3), device()[1]
    warm = np.full((3, 1), 40.0 + ZERO_CELSIUS)
    here = replace(observations, rests=replace(observations.rests, temperatures=warm))
    unit = {"t1": "m/s^2/K", "t2": "m/s^2/K^2"}
    values = {"t1": 0.5 * MG, "t2": -0.01 * MG}
    more = tuple(
        Parameter(name=f"accel.bias.{x}.{ending}", value=values[ending], u=1e-3 * MG, unit=unit[ending])
        for x in "xyz"
        for ending in values
    )
    assert calibration.covariance is not None
    m, n = len(calibration.parameters), len(more)
    covariance = np.zeros((m + n, m + n))
    covariance[:m, :m], covariance[m:, m:] = calibration.covariance, (1e-3 * MG) ** 2 * np.eye(n)
    parameters = (*calibration.parameters, *more)
    warmed = replace(
        calibration, parameters=parameters, covariance=covariance, temperature=CalibratedTemperature(reference=20.0)
    )
    known = prior_at_check(warmed, here, "mems", {})
    by_name = dict(zip(known.instrument.names, known.values.tolist(), strict=True))
    assert by_name["accel.bias.x"] - calibration["accel.bias.x"].value == pytest.approx(6.0 * MG)
    assert by_name["accel.bias.x.t1"] == pytest.approx(0.1 * MG)


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(main, list(map(str, words)))


def test_a_session_is_checked(folder: Path) -> None:
    made, again = folder / "calibration.json", folder / "again"
    done = run("check", made, again)
    assert done.exit_code == 0, done.stderr
    assert "no change is detected; larger than these, it would be in nine of ten cases:\naccel.bias " in done.stdout
    assert "4 rests and 3 turns\n" in done.stdout
    assert done.stdout.count("rest ") == 4
    data = json.loads(run("check", made, again, "--json").stdout)
    assert (data["verdict"], data["reasons"], data["changes"], data["turns"]) == ("accepted", [], [], 3)
    largest = max(abs(each["change"]) / each["u"] for each in data["parameters"])
    assert data["largest"] == pytest.approx(largest)
    assert data["largest"] < data["limit"]
    assert max(abs(rest["sigmas"]) for rest in data["rests"]) < data["rest_limit"]


@pytest.mark.parametrize("form", ["names", "no names", "json"])
def test_a_log_is_checked_as_the_session_that_is_made_of_it(folder: Path, tmp_path: Path, form: str) -> None:
    made, log, rows = folder / "calibration.json", tmp_path / "field.csv", pl.read_parquet(folder / "again/log.parquet")
    if form == "json":
        rows.write_ndjson(log)
    else:
        rows.write_csv(log, include_header=form == "names")
    done = run("check", made, log)
    assert done.exit_code == 0, done.stderr
    assert "4 rests and 3 turns\n" in done.stdout
    assert (tmp_path / "field-session" / "session.toml").exists()
    described, stated = (read_session(path) for path in (tmp_path / "field-session", folder / "again"))
    assert described.device.serial == stated.device.serial
    assert described.site.latitude == pytest.approx(stated.site.latitude)


def test_a_long_table_shows_its_worst_positions_and_no_more_than_ten_sentences(folder: Path, tmp_path: Path) -> None:
    made, rng = folder / "calibration.json", np.random.default_rng(2)
    up = rng.normal(size=(60, 3))
    up *= 10.3 / np.linalg.norm(up, axis=1)[:, None]
    pl.DataFrame(up, schema=["ax", "ay", "az"]).write_csv(tmp_path / "positions.csv")
    done = run("check", made, tmp_path / "positions.csv")
    assert done.exit_code == 1
    assert "\nand 50 others with smaller ratios\n" in done.stdout
    assert done.stdout.count("(line ") == 10
    assert done.stderr.count("changed: position") == 10
    assert "changed: and 50 more" in done.stderr


def test_a_changed_calibration_ends_with_one(folder: Path) -> None:
    before = read_calibration(folder / "calibration.json")
    off = tuple(replace(p, value=p.value + 20 * MG) if p.name == "accel.bias.x" else p for p in before.parameters)
    replace(before, parameters=off).write(folder / "off.json")
    done = run("check", folder / "off.json", folder / "again")
    assert done.exit_code == 1
    assert "changed: accel.bias.x has changed by -" in done.stderr
    assert "; by chance with probability " in done.stderr


def test_every_frame_checks_alike(tmp_path: Path) -> None:
    """In that of the case, which nothing can be converted from, the rests alone decide."""
    faces = Setup.of(programme="cube-14", rest=8.0, rate_deg_s=40.0, sample_rate=50.0)
    own = simulate_session(tmp_path / "own", faces, seed=51)
    again = simulate_session(tmp_path / "again", replace(faces, programme=programme("cube-12")), seed=51, launch=2)
    found = {}
    for frame in FRAMES:
        made = calibrate(stated_linear(own), frame=frame)
        found[frame] = check_calibration(made, again)
    for frame, check in found.items():
        assert check.valid
        assert check.rests_agree is None
        for name in ("difference", "u"):
            values, expected = ([getattr(r, name) for r in each.rests] for each in (check, found["accelerometer"]))
            np.testing.assert_allclose(values, expected, rtol=1e-5, atol=1e-12)
        assert bool(check.parameters) == (frame != "case")


def test_the_rests_of_the_calibration_itself_check_nothing(folder: Path) -> None:
    done = run("check", folder / "calibration.json", folder / "calibrated")
    assert (done.exit_code, done.stdout) == (2, "")
    assert "found those it was made from; record a few rests in other attitudes" in done.stderr
    assert done.stderr.count("\n") == 1


def test_counts_that_are_worth_something_else_are_refused(folder: Path) -> None:
    made = read_calibration(folder / "calibration.json")
    readings = made.provenance.readings
    counts = replace(readings["accel"], unit="count", scale=(400.0,) * 3)
    counted = with_fields(made, readings={**readings, "accel": counts})
    with pytest.raises(InputError, match=r"log\.accel: expected the unit, scale and offset of the calibration"):
        check_calibration(counted, folder / "again")


def test_accelerometers_alone_are_checked(folder: Path) -> None:
    whole = read_calibration(folder / "calibration.json")
    own = [i for i, p in enumerate(whole.parameters) if p.name.startswith("accel.") and "lever" not in p.name]
    own = [i for i in own if "delay" not in whole.parameters[i].name]
    assert whole.covariance is not None
    alone = replace(
        whole,
        gyro=None,
        parameters=tuple(whole.parameters[i] for i in own),
        covariance=whole.covariance[np.ix_(own, own)],
    )
    found = check_calibration(alone, folder / "again")
    assert found.turns == 0
    assert found.valid
    assert not any(test.name.startswith("gyro") for test in found.parameters)


def test_another_device_and_a_refused_calibration_are_refused(folder: Path) -> None:
    calibration = read_calibration(folder / "calibration.json")
    with pytest.raises(InputError, match="expected a session of device 'other'"):
        check_calibration(of_device(calibration, serial="other"), folder / "again")
    with pytest.raises(CalibrationError, match="expected an accepted one"):
        check_calibration(replace(calibration, outcome=Outcome(reasons=("no",))), folder / "again")


def test_a_calibration_of_few_degrees_of_freedom_is_believed_less() -> None:
    """Where the calibration is most of what is not known, limits are higher, and not by more than if it were all."""
    _, calibration = device()
    assert calibration.covariance is not None
    vague = tuple(replace(p, u=10.0 * (p.u or 0.0)) for p in calibration.parameters)
    sure = replace(calibration, parameters=vague, covariance=100.0 * calibration.covariance)
    few = replace(sure, parameters=tuple(replace(p, dof=4.0) for p in vague))
    observations = seen(4)
    known = [prior_at_check(c, observations, "mems", {}) for c in (sure, few)]
    assert not known[0].covariance_u.any()
    i = known[1].instrument.names.index("accel.scale.y")
    own = next(p.u or 0.0 for p in vague if p.name == "accel.scale.y")
    assert known[1].covariance_u[1 + i, 1 + i] == pytest.approx(own**2 / 2.0)
    limits, part = [field_check(observations, each).limit for each in known], 0.5 * CHANCE / 21
    assert 1.1 * limits[0] < limits[1] < limits[0] * stats.t.isf(part, 4.0) / stats.norm.isf(part)


def of_bias(degrees: int, size: float, *logs: str) -> LaunchVariances:
    """Launches whose standard deviation of the X bias is this, m/s²."""
    return LaunchVariances(serial="x", logs=frozenset(logs), degrees=degrees, variances={"accel.bias.x": size**2})


def test_launches_of_other_calibrations_of_the_device_count_and_those_of_this_one_once() -> None:
    """s² = (4 s_g² + ν s_L²)/(4 + ν), twice of a single launch, by all launches that are known."""
    _, calibration = device()
    i = 1 + prior_at_check(calibration, seen(3), "mems", {}).instrument.names.index("accel.bias.x")
    u2 = next(p.u or 0.0 for p in calibration.parameters if p.name == "accel.bias.x") ** 2
    usual = spread_of(TURN_ON["mems"], "accel.bias.x") ** 2
    several = with_fields(
        calibration,
        launches=tuple(
            Launch(session=log, parameters=calibration.parameters, covariance=None, log_sha256=log) for log in "ab"
        ),
        parameters=tuple(replace(p, run_to_run=3e-5) for p in calibration.parameters),
    )
    others = (of_bias(3, 1e-5, "a"), of_bias(4, 2e-5, "c"), of_bias(4, 2e-5, "d"))
    for made, factor, pooled in (
        (calibration, 2.0, (4.0 * usual + 3 * 1e-5**2 + 8 * 2e-5**2) / 15.0),
        (several, 1.0, (4.0 * usual + 1 * 3e-5**2 + 8 * 2e-5**2) / 13.0),
    ):
        known = prior_at_check(made, seen(3), "mems", {}, others)
        assert known.covariance[i, i] == pytest.approx(factor * pooled + u2, rel=1e-6)


def test_launches_that_agree_make_a_smaller_change_a_change(folder: Path) -> None:
    """The bias of the calibration is 2.5 mg off: nothing beside what MEMS devices usually do, much for this one, of
    which the launches are known."""
    before = read_calibration(folder / "calibration.json")
    off = tuple(replace(p, value=p.value + 2.5 * MG) if p.name == "accel.bias.x" else p for p in before.parameters)
    replace(before, parameters=off).write(folder / "slightly.json")
    assert run("check", folder / "slightly.json", folder / "again").exit_code == 0
    launches = tuple(
        Launch(session=f"{i}", parameters=before.parameters, covariance=before.covariance, log_sha256=f"{i:x}" * 64)
        for i in range(13)
    )
    calm = tuple(replace(p, run_to_run=0.02 * (p.u or 0.0)) for p in before.parameters)
    variances = launch_variances(with_fields(before, parameters=calm, launches=launches))
    assert variances is not None
    found = check_calibration(folder / "slightly.json", folder / "again", launches=[variances])
    assert any("or as from launch to launch of 13 launches of the device" in note for note in found.notes)
    assert [change.name for change in found.changes] == ["accel.bias.x"]


def test_deviations_of_few_launches_are_believed_less() -> None:
    _, calibration = device()
    launch = Launch(session="a", parameters=calibration.parameters, covariance=None, log_sha256="")
    launched = with_fields(
        calibration,
        launches=(launch,) * 3,
        parameters=tuple(replace(p, run_to_run=0.1) for p in calibration.parameters),
    )
    i = 1 + prior_at_check(launched, seen(3), "mems", {}).instrument.names.index("gyro.bias.z")
    alike = replace(launched, parameters=tuple(replace(p, run_to_run=0.0) for p in calibration.parameters))
    usual = (0.02 * DEGREE) ** 2 * 4.0 / 6.0
    for made, expected in ((launched, 0.1**2 / np.sqrt(2.0)), (alike, usual / np.sqrt(6.0))):
        found = prior_at_check(made, seen(3), "mems", {}).covariance_u[i, i]
        assert found == pytest.approx(expected)
