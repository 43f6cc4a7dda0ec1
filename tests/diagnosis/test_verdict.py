"""Verdicts: what is larger than its noise is said, with its cause; what is wrong with one kind of sensor is not held
against the other; clean sessions are accepted without a word.

Sessions come from the study of departures, which simulates them sample by sample with kinematics of its own.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from pydantic import TypeAdapter

from tests.support import study
from tests.support.plain_rows import of_rests, plain_rows, with_residuals
from tests.support.shared import copy_of, session
from tumble.diagnosis.causes import memory_lag
from tumble.diagnosis.findings import causes_of
from tumble.diagnosis.misfit import misfit
from tumble.diagnosis.projection import (
    FALSE_ALARMS,
    Projection,
    SumOfSquares,
    holm_limit,
    north_rate_columns,
    projections,
)
from tumble.diagnosis.undetermined import parameter_list
from tumble.diagnosis.verdict import gravity_text, verdict
from tumble.documents import as_json
from tumble.earth import NORMAL_GRAVITY_U, normal_gravity
from tumble.inference.estimate import Estimate, Outcome
from tumble.inference.joint import joint
from tumble.inference.linearisation import linearise
from tumble.inference.noise import NO_COMPONENTS
from tumble.inference.normal_equations import solve
from tumble.planning.setup import Setup
from tumble.reduction.observations import Observations
from tumble.result.calibration import Calibration
from tumble.rotation import rotation_matrix
from tumble.run.calibrate import calibrate
from tumble.sensors.parameters import Terms
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import scenario_of
from tumble.units import DEGREE, Array

Samples = tuple[Array, Array]
"""Of accelerometers and gyros."""


@cache
def estimated(
    departure: str, size: float = 1.0, setting: int = 0, seed: int = 0, *, cubic: float | None = None
) -> tuple[Estimate, Observations]:
    """The estimate of a session with a departure of the study, and with `gyro.cubic` where its usual size is given."""
    s = study("departures")
    off = {each.name: each for each in (s.CLEAN, *s.DEPARTURES)}[departure].times(size)
    observations, _ = s.session(s.SETTINGS[setting], off, seed)
    if cubic is not None:
        observations = replace(observations, usual={**observations.usual, "gyro.cubic": cubic})
    return joint(observations), observations


@pytest.mark.parametrize("setting", [0, 1, 2])
def test_clean_sessions_are_accepted_without_a_word(setting: int) -> None:
    for seed in range(3):
        assert verdict(*estimated("none", setting=setting, seed=seed)).verdict == "accepted"


@pytest.mark.parametrize(
    ("departure", "size", "cause"),
    [
        ("hysteresis 10 µg", 3.0, "hysteresis"),
        ("gyro nonlinearity 20 ppm at 10 °/s", 3.0, "gyro nonlinearity"),
        ("1 % of samples lost", 1.0, "lost samples"),
        pytest.param("memory 50 ppm over 60 s", 3.0, "memory", marks=pytest.mark.weekly),
        pytest.param("biases drift by 50 µg, 0.1 °/h", 3.0, "drift", marks=pytest.mark.weekly),
        pytest.param("scales drift by 20 ppm", 3.0, "scale-factor drift", marks=pytest.mark.weekly),
        pytest.param("1 % of samples held", 1.0, "lost samples", marks=pytest.mark.weekly),
    ],
)
def test_departures_are_named(departure: str, size: float, cause: str) -> None:
    estimate, observations = estimated(departure, size)
    assert cause in causes_of(misfit(estimate))[:2]
    assert verdict(estimate, observations).verdict != "accepted"


@pytest.mark.parametrize("seed", [104, *(pytest.param(seed, marks=pytest.mark.weekly) for seed in (105, 127))])
def test_lost_samples_are_named_first_where_all_scatters(seed: int) -> None:
    assert causes_of(misfit(estimated("1 % of samples lost", setting=1, seed=seed)[0]))[0] == "lost samples"


def test_turns_beyond_the_model_are_refused_where_they_are_aliased_too() -> None:
    """The reason says both, and not that u contains it."""
    estimate, _ = estimated("1 % of samples lost")
    linearised = estimate.linearised
    assert linearised is not None
    observations, scatter = linearised.problem.observations, linearised.components.turn
    assert observations.turns is not None
    aliased = replace(observations.turns, aliased=np.full(len(observations.turns), scatter**2))
    problem = replace(linearised.problem, observations=replace(observations, turns=aliased))
    twice = replace(linearised, problem=problem).with_components(replace(linearised.components, aliased=2.0))
    refusals = (each.sentence for each in misfit(replace(estimate, linearised=twice)) if each.refuses)
    (said,) = [sentence for sentence in refusals if "where rates jump from sample to sample" in sentence]
    assert "more than 30: the model does not describe this" in said
    assert "u contains it" not in said


def test_lost_samples_are_refused() -> None:
    outcome = verdict(*estimated("0.2 % of samples lost", seed=1))
    assert outcome.verdict == "not accepted"
    assert any("samples are missing or held in the log" in reason for reason in outcome.reasons)


def _unstamped(seed: int) -> Samples:
    """Twelve positions by hand at 20 Hz, without time stamps."""
    setup = Setup.of(grade="mems", positions=12, rest=4.0, rate_deg_s=150.0, sample_rate=20.0)
    log = pl.read_parquet(session(replace(setup, first_rest=6.0), seed=seed) / "log.parquet")
    return log.select("ax", "ay", "az").to_numpy(), log.select("gx", "gy", "gz").to_numpy()


def _lost_in_turn(samples: Samples, turn: int, rows: int, terms: Terms = "linear") -> tuple[Calibration, Calibration]:
    """The result of a log without time stamps, and of the same without rows at the start of a turn."""
    accel, gyro = samples
    whole = calibrate(accel=accel, gyro=gyro, rate=20.0, latitude=0.9921, serial="A", terms=terms)
    start = round(whole.evidence.rests[whole.evidence.turns[turn].first].stop * 20.0)
    moving = start + int(np.argmax(np.linalg.norm(gyro[start:], axis=1) > 0.05))
    accel, gyro = (np.delete(each, range(moving, moving + rows), axis=0) for each in samples)
    return whole, calibrate(accel=accel, gyro=gyro, rate=20.0, latitude=0.9921, serial="A", terms=terms)


@pytest.mark.parametrize("terms", ["linear", "full"])
def test_rows_lost_at_the_start_of_a_turn_are_named(terms: Terms) -> None:
    """What the other turns of a short session cannot contradict: its velocity does."""
    whole, lost = _lost_in_turn(_unstamped(7), 8, 2, terms)
    assert whole.outcome.verdict == "accepted"
    assert lost.outcome.verdict == "not accepted"
    assert any("the turn from rest 9 to rest 10" in reason for reason in lost.outcome.reasons)


def test_a_loss_that_does_little_harm_is_named() -> None:
    """One row: its turn stands out, and no parameter errs by three times its u."""
    whole, lost = _lost_in_turn(_unstamped(11), 2, 1)
    assert whole.outcome.verdict == "accepted"
    assert lost.outcome.verdict == "accepted with scatter"
    assert any("the turn from rest 3 to rest 4" in remark for remark in lost.outcome.remarks)


def test_a_loss_is_looked_for_beside_a_warm_up() -> None:
    """The estimate of all groups takes what was lost for a warm-up as well."""
    _, lost = _lost_in_turn(_unstamped(8), 0, 1)
    assert lost.outcome.remarks


def _changed(seed: int, change: Callable[[Any, Array, Array], None]) -> tuple[Estimate, Observations]:
    """The estimate of a session by hand whose samples are changed; `change` has them and accelerometers and gyros."""
    s = study("departures")
    rng, setting = np.random.default_rng(seed), s.SETTINGS[1]
    truth, ways = s.truth_of(setting, rng), s.ways_of(setting, rng)
    samples = s.sampled(setting, ways, truth, s.CLEAN)
    accel, gyro = samples.accel.copy(), samples.gyro.copy()
    change(samples, accel, gyro)
    samples = s.departed(setting, replace(samples, accel=accel, gyro=gyro), s.CLEAN, rng)
    observations = s.observed(setting, samples)
    return joint(observations), observations


@pytest.mark.parametrize("seed", [0, 1])
def test_gyros_that_turn_against_the_accelerometers_are_named_and_nothing_else(seed: int) -> None:
    def shifted(samples: Any, _: Array, gyro: Array) -> None:
        after = slice(int(np.flatnonzero(samples.part == 9)[0]), None)
        gyro[after] = gyro[after] @ rotation_matrix(0.1 * DEGREE * np.array([0.6, 0.0, 0.8])).T

    estimate, observations = _changed(seed, shifted)
    assert causes_of(misfit(estimate)) == ("shift",)
    assert verdict(estimate, observations).gyro.verdict == "not accepted"


def test_accelerometers_that_are_late_by_another_time_in_each_turn_lack_no_samples() -> None:
    rng = np.random.default_rng(8)

    def late(samples: Any, accel: Array, _: Array) -> None:
        for turn in range(1, -int(samples.part.min()) + 1):
            rows = np.flatnonzero(samples.part == -turn)
            at = np.arange(len(rows))
            behind = at - rng.uniform(0.0, 2.0)  # samples
            accel[rows] = np.column_stack([np.interp(behind, at, accel[rows, p]) for p in range(3)])

    estimate, observations = _changed(1, late)
    assert "lost samples" not in causes_of(misfit(estimate))
    assert verdict(estimate, observations).verdict == "accepted with scatter"


def test_time_stamps_that_jitter_are_named_with_their_remedy(tmp_path: Path) -> None:
    """By 1 ms of 10, in a navigation unit's log of even rows: scatter, and none once the stamps are passed over."""
    folder = copy_of(session(Setup.of(grade="navigation", positions=12, rest=10.0), seed=1), tmp_path / "s")
    log = pl.read_parquet(folder / "log.parquet")
    jitter = 1e-3 * np.random.default_rng(3).standard_normal(log.height)
    log.with_columns(pl.col("t") + pl.Series(jitter)).write_parquet(folder / "log.parquet")
    scattering = calibrate(folder).outcome
    assert scattering.verdict == "accepted with scatter"
    (said,) = [remark for remark in scattering.remarks if remark.startswith("the rotations of the turns")]
    assert "the time stamps jitter by 1 ms: if the rows are equally spaced" in said
    assert "regular = true" in said
    stated = folder / "session.toml"
    stated.write_text(stated.read_text(encoding="utf-8").replace("[log]", "[log]\nregular = true"), encoding="utf-8")
    assert calibrate(folder).outcome.verdict == "accepted"


def test_gyros_that_are_not_linear_leave_their_biases_and_are_at_fault_for_the_accelerometers() -> None:
    """Whose biases err by 2.3 u beside them, and are estimated alone then."""
    outcome = verdict(*estimated("gyro nonlinearity 20 ppm at 10 °/s", 3.0))
    assert outcome.gyro.verdict == "not accepted"
    assert not outcome.of("gyro.scale").accepted
    assert outcome.of("gyro.bias").accepted
    (reason,) = outcome.accel.reasons
    assert outcome.concerns[reason][0].startswith("gyro")


@pytest.mark.parametrize("size", [1.0, 3.0])
def test_gyros_that_are_not_linear_are_accepted_where_the_model_has_it(size: float) -> None:
    """20 and 60 ppm at 10 °/s, of which turns at one rate show next to nothing, stand in u of the scale factors."""
    usual = 10e-6 / (10.0 * DEGREE) ** 2
    estimate, observations = estimated("gyro nonlinearity 20 ppm at 10 °/s", size, cubic=usual)
    assert verdict(estimate, observations).verdict == "accepted"
    _, truth = study("departures").session(study("departures").SETTINGS[0], study("departures").CLEAN, 0)
    where = [estimate.names.index(f"gyro.scale.{axis}") for axis in "xyz"]
    error = estimate.values[where] - [truth[f"gyro.scale.{axis}"] for axis in "xyz"]
    assert np.all(np.abs(error) < 4.0 * estimate.u[where])
    assert np.all(estimate.u[where] > 3e-6)
    assert estimate.prediction is not None
    assert estimate.prediction.rate_u is not None
    assert estimate.prediction.at_rate is not None
    assert estimate.prediction.rate_u < estimate.prediction.at_rate * estimate.u[where].min()


def test_hysteresis_of_accelerometers_leaves_the_biases_of_the_gyros() -> None:
    """Not their scale factors and axes, which turned verticals tell: by these 2.9 u rms are wrong with them."""
    outcome = verdict(*estimated("hysteresis 10 µg", 3.0))
    assert not outcome.accel.accepted
    assert not outcome.of("accel.axis").accepted
    assert [name for name in ("gyro.bias", "gyro.scale", "gyro.axis") if outcome.of(name)] == ["gyro.bias"]


def test_the_overall_verdict_is_the_worse_one() -> None:
    outcome = Outcome(
        reasons=("both", "bad gyros"), remarks=("noisy",), concerns={"bad gyros": ("gyro",), "noisy": ("gyro",)}
    )
    assert (outcome.verdict, outcome.accel.reasons, outcome.accel.remarks) == ("not accepted", ("both",), ())
    only_gyros = Outcome(reasons=("bad gyros",), concerns={"bad gyros": ("gyro",)})
    assert (only_gyros.accel.verdict, only_gyros.gyro.verdict) == ("accepted", "not accepted")
    noisy = Outcome(remarks=("noisy",), concerns={"noisy": ("gyro",)})
    assert (noisy.verdict, noisy.accepted, noisy.accel.verdict) == ("accepted with scatter", True, "accepted")


def test_a_group_is_judged_with_its_kind_and_a_kind_with_its_groups() -> None:
    concerns = {"biases jump": ("gyro.bias",), "noisy": ("gyro",), "wrong": ("accel.scale", "gyro.scale")}
    outcome = Outcome(reasons=("biases jump", "wrong"), remarks=("noisy", "rough"), concerns=concerns)
    assert outcome.gyro.reasons == ("biases jump", "wrong")
    assert (outcome.of("gyro.bias").reasons, outcome.of("gyro.bias.drift").reasons) == (("biases jump",),) * 2
    assert (outcome.of("gyro.axis").verdict, outcome.of("gyro.axis").remarks) == (
        "accepted with scatter",
        ("noisy", "rough"),
    )
    assert outcome.accel.reasons == outcome.of("accel.scale").reasons == ("wrong",)
    assert set(outcome.groups) == {"accel.bias", "accel.axis", "gyro.bias", "gyro.scale", "gyro.axis"}
    assert read(outcome) == outcome


def read(outcome: Outcome) -> Outcome:
    """An outcome as a calibration file has it, read again."""
    return TypeAdapter(Outcome).validate_json(json.dumps(as_json(outcome)))


def test_outcomes_come_back_from_their_content() -> None:
    outcome = Outcome(
        reasons=("both", "bad gyros"),
        remarks=("noisy", "drifting"),
        unobservable=("gyro.scale.x",),
        concerns={"drifting": ("accel.bias",), "bad gyros": ("gyro",), "noisy": ("gyro",)},
    )
    assert read(outcome) == outcome
    assert read(Outcome()) == Outcome()


def test_gravity_that_no_place_has_is_refused_unless_confirmed() -> None:
    estimate, observations = estimated("none")
    wrong = replace(observations, site=replace(observations.site, gravity=observations.site.gravity + 0.0111))
    refused = verdict(estimate, wrong)
    assert not refused.accel.accepted
    assert refused.gyro.accepted
    assert [name for name in ("accel.bias", "accel.scale", "accel.axis") if not refused.of(name)] == ["accel.scale"]
    assert "+1110 mGal" in refused.reasons[0]
    assert verdict(estimate, wrong, gravity_confirmed=True).accepted
    assert gravity_text(observations.site).endswith("+0 mGal from normal gravity")  # measured, to 0.01 mGal
    unstated = replace(observations.site, gravity_u=NORMAL_GRAVITY_U)
    assert gravity_text(unstated).endswith("m/s^2, normal gravity assumed, u 31 ppm")
    assert 1e6 * unstated.gravity_u / unstated.gravity == pytest.approx(30.6, abs=0.1)
    assert gravity_text(replace(observations.site, latitude=None)).endswith("m/s^2")


def test_stated_gravity_that_few_places_have_is_remarked() -> None:
    """Normal gravity has a standard uncertainty of 30 mGal; 4.1 of these are 123 mGal."""
    estimate, observations = estimated("none")
    normal = normal_gravity(observations.site.latitude or 0.0, observations.site.height or 0.0)

    def found(gravity: float, u: float, *, confirmed: bool = False) -> list[str]:
        site = replace(observations.site, gravity=gravity, gravity_u=u)
        outcome = verdict(estimate, replace(observations, site=site), gravity_confirmed=confirmed)
        return [remark for remark in outcome.accel.remarks if remark.startswith("gravity")]

    assert found(normal + 117e-5, 5e-6) == []
    (said,) = found(normal - 123e-5, 5e-6)
    assert "-123 mGal from normal gravity at" in said
    assert "4.1 times the standard uncertainty of both" in said
    assert found(normal - 123e-5, 5e-6, confirmed=True) == []
    assert found(normal - 123e-5, 3e-4) == []
    at_unknown_height = replace(observations.site, height=None, gravity=normal - 300e-5, gravity_u=5e-6)
    assert verdict(estimate, replace(observations, site=at_unknown_height)).accel.remarks == ()


def test_a_latitude_that_the_gyros_contradict_is_named() -> None:
    s = study("departures")
    observations, _ = s.session(s.SETTINGS[0], s.CLEAN, 1)
    moved = replace(observations, site=replace(observations.site, latitude=observations.site.latitude + 0.01))
    assert causes_of(misfit(joint(moved)))[0] == "latitude"


def _projected(estimate: Estimate, rest: Array, turn: Array) -> Projection:
    """The projection of columns with the noise alone."""
    assert estimate.linearised is not None
    (found,) = projections(estimate.linearised, NO_COMPONENTS, rest, turn)
    return found


def test_what_is_known_poorly_is_said_and_refused_where_it_is_known_less_than_ten_times_better() -> None:
    """Noise of thirty times the usual: u is then some thousandths of scale factors and angles, and holds."""
    setup, off, said = Setup.of(grade="mems", positions=12, noise_factor=30.0), [], set()
    for seed in range(8):
        rng = np.random.default_rng(seed)
        scenario = scenario_of(setup, rng)
        observations = simulate_observations(scenario, rng)
        estimate = joint(observations)
        outcome = verdict(estimate, observations)
        worst = [
            float(known)
            for known in re.findall(r"known to ([0-9.]+) %", " ".join((*outcome.reasons, *outcome.remarks)))
        ]
        if max(worst) != 10.0:  # as it is printed
            assert outcome.verdict == ("not accepted" if max(worst) > 10.0 else "accepted with scatter")
        said.add(outcome.verdict)
        off.append(
            (estimate.values - [scenario.truth[name] for name in estimate.names])
            / np.sqrt(np.diag(estimate.covariance))
        )
    assert len(said) == 2
    assert 0.6 < np.sqrt(np.mean(np.square(off))) < 1.3  # of 168; false alarms below 1e-6 were all independent
    assert np.abs(off).max() < 5.5


def test_a_projection_is_that_of_all_unknowns_at_once() -> None:
    """Against least squares with the columns of all attitudes, parameters and causes side by side."""
    estimate = joint(replace(estimated("none")[1], usual={}))
    linearised = estimate.linearised
    assert linearised is not None
    problem, rows = linearised.problem, plain_rows(linearised)
    rng, (N, r), (K, t) = np.random.default_rng(2), rows.rest.shape[:2], rows.turn.shape[:2]
    rest, turn = rng.normal(0.0, 1e-4, (N, r, 2)), rng.normal(0.0, 1e-4, (K, t, 2))
    W, prior = solve(linearised, NO_COMPONENTS).equations.whitening, linearised.prior
    W_rest, W_turn, p = of_rests(W), W["turn"], len(prior) - 1
    A = np.zeros((N * r + K * t + p, 3 * N + p + 3))
    for i in range(N):
        A[i * r : (i + 1) * r, 3 * i : 3 * i + 3] = W_rest[i] @ rows.rest[i, :, :3]
        A[i * r : (i + 1) * r, 3 * N :] = W_rest[i] @ np.hstack([rows.rest[i, :, 3:-1], rest[i], rows.rest[i, :, -1:]])
    for k, i in enumerate(problem.before_turn):
        own = slice(N * r + k * t, N * r + (k + 1) * t)
        A[own, 3 * i : 3 * i + 6] = W_turn[k] @ rows.turn[k, :, :6]
        A[own, 3 * N :] = W_turn[k] @ np.hstack([rows.turn[k, :, 6:-1], turn[k], rows.turn[k, :, -1:]])
    A[-p:, 3 * N : 3 * N + p], A[-p:, -1] = prior[:-1, :-1], prior[:-1, -1]
    A = np.delete(np.delete(A, -p, axis=0), 3 * N, axis=1)  # gravity, which is exact here
    unknowns, columns, residual = A[:, :-3], A[:, -3:-1], A[:, -1]
    Q, R = np.linalg.qr(unknowns)
    B, e = columns - Q @ (Q.T @ columns), residual - Q @ (Q.T @ residual)
    projection = _projected(estimate, rest, turn)
    block, length = projection.triangle, projection.length
    np.testing.assert_allclose(block.T @ block, B.T @ B / np.outer(length, length), rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(block.T @ projection.residual, B.T @ e / length, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(projection.chi_square, e @ e, rtol=1e-6)
    of_rows = 1.0 - (Q[: N * r + K * t] ** 2).sum(axis=1)  # redundancy numbers, priors not counted
    assert projection.degrees == pytest.approx(of_rows.sum())
    u = np.sqrt(np.linalg.inv(R.T @ R).diagonal())[3 * N :]
    np.testing.assert_allclose(projection.u, u, rtol=1e-5)
    explained = projection.fit(slice(0, 2))
    assert explained is not None
    expected = np.linalg.solve(B.T @ B, B.T @ e)
    np.testing.assert_allclose(explained.values, expected, rtol=1e-4)
    without = np.linalg.solve(R, Q.T @ (columns @ expected))[3 * N :]
    np.testing.assert_allclose(explained.shift / u, without / u, rtol=1e-4, atol=1e-6)


def test_the_rate_along_north_is_predicted_at_rest_and_in_the_turns() -> None:
    """What it predicts is by how much residuals are larger without it, to the size of the errors of the sensors."""
    estimate, _ = estimated("none", setting=2)
    linearised = estimate.linearised
    assert linearised is not None
    problem = linearised.problem
    still = replace(problem, earth=problem.earth * np.array([0.0, 1.0, 1.0]))
    without = linearise(still, linearised.point, linearised.integrated)
    for found, there, here in zip(north_rate_columns(linearised), without.residuals, linearised.residuals, strict=True):
        expected = there - here
        assert np.abs(expected).max() > 0.0
        for rows in (slice(0, 3), slice(3, 6)):
            np.testing.assert_allclose(found[:, rows], expected[:, rows], atol=0.05 * np.abs(expected[:, rows]).max())


def test_a_cause_that_is_put_in_comes_out() -> None:
    """A column that is added to the residuals is found with its size."""
    estimate, _ = estimated("none", setting=1)
    linearised = estimate.linearised
    assert linearised is not None
    rows, rng = linearised, np.random.default_rng(1)
    rest, turn = (rng.normal(0.0, 1e-4, (*each.shape, 2)) for each in rows.residuals)
    values = np.array([1.0, -0.5])
    shifted = with_residuals(rows, *(r + c @ values for r, c in zip(rows.residuals, (rest, turn), strict=True)))
    before = _projected(estimate, rest, turn).fit(slice(0, 2))
    after = _projected(replace(estimate, linearised=shifted), rest, turn)
    found = after.fit(slice(0, 2))
    assert before is not None
    assert found is not None
    np.testing.assert_allclose(found.values - before.values, values, rtol=1e-6)


def test_chances_of_sums_of_squares() -> None:
    """Exact where directions are of one length and the projector is one; cautious otherwise."""
    from scipy.special import chdtrc

    rng = np.random.default_rng(7)
    residual, eye = rng.standard_normal((4, 3)), np.broadcast_to(np.eye(3), (4, 3, 3))
    found = SumOfSquares.along(2.0 * eye, residual, eye)
    assert (found.mean, found.half_variance) == pytest.approx((4.0 * 12, 16.0 * 12))
    assert found.p_value == pytest.approx(chdtrc(12, float((residual**2).sum())))
    sizes = np.array([3.0, 1.0, 0.2])
    draws = rng.standard_normal((200_000, 3)) ** 2 @ sizes**2
    one, directions = np.eye(3)[None], np.diag(sizes)[None]
    for limit in (20.0, 40.0):
        far = SumOfSquares.along(directions, np.array([[np.sqrt(limit) / 3.0, 0.0, 0.0]]), one)
        assert far.p_value == pytest.approx(np.mean(draws > limit), rel=0.25)


def test_many_tests_are_judged_by_one_rule() -> None:
    """By Holm's: at the least probability the limit is divided by all, and then by one fewer each time."""
    assert holm_limit([]) == 0.0
    assert holm_limit([FALSE_ALARMS / 9.9] + 9 * [1.0]) == 0.0
    assert holm_limit([FALSE_ALARMS / 10.1] + 9 * [1.0]) == FALSE_ALARMS / 10.1
    assert holm_limit([1e-9, FALSE_ALARMS / 9.1, *(8 * [1.0])]) == FALSE_ALARMS / 9.1


def test_parameters_are_listed_by_name_or_where_they_are_many_counted() -> None:
    few = ("accel.axis.yx", "accel.axis.zx")
    assert parameter_list(few) == "accel.axis.yx, accel.axis.zx"
    many = (*(f"accel.bias.{i}" for i in range(12)), *(f"accel.scale.{i}" for i in range(16)))
    assert parameter_list(many) == "accel.bias (12), accel.scale (16)"


def test_memories_are_the_same_in_one_go_and_step_by_step() -> None:
    rng, passed = np.random.default_rng(1), np.array([0.0, 1e-6, 0.03, 5.0])
    begin, targets = rng.normal(size=(4, 3)), rng.normal(size=(24, 3))
    behind, end = memory_lag(begin, targets, passed)
    slow = begin
    for j, target in enumerate(targets):
        mean, slow = memory_lag(slow, target[None], passed)
        assert behind[:, j] == pytest.approx(mean[:, 0], abs=1e-13)
    assert end == pytest.approx(slow, abs=1e-13)
