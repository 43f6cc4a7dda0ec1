"""One inference: the score is the derivative of the likelihood, the elimination is that of everything at once, the
maximum does not depend on the start, and the integral is what a sampler finds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

import tumble
from tests.support import study
from tests.support.plain_rows import covariances as noise_covariances
from tests.support.plain_rows import directions, plain_rows
from tests.support.wandering_biases import middles
from tumble.diagnosis.verdict import verdict
from tumble.inference import joint as of_joint
from tumble.inference.fits import sigmas
from tumble.inference.hyperparameters import (
    Hyperparameter,
    derivatives,
    solution_at,
)
from tumble.inference.integral import Folded, members_of, pareto_smoothed, posterior, triangles
from tumble.inference.joint import joint
from tumble.inference.linearisation import Linearisation, linearise
from tumble.inference.maximum import Maximum, maximise, without_outliers
from tumble.inference.noise import VarianceComponents
from tumble.inference.normal_equations import Solution, session_mean_bias, solve
from tumble.inference.problem import NO_PRIOR, Problem, instruments_of
from tumble.inference.start import initial_linearisation
from tumble.planning.setup import Setup
from tumble.programme.positions import from_attitudes, programme
from tumble.reduction.observations import Observations, join_sessions
from tumble.rotation import unit_vector
from tumble.sensors.model import Block
from tumble.sensors.parameters import usual_sizes
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import Scenario, draw_further, scenario_of
from tumble.units import Array, BoolArray

PYRAMID = np.array([[0.8 * np.cos(a), 0.8 * np.sin(a), 0.6] for a in np.arange(4) * np.pi / 2.0])


def by_hand(positions: int = 12, seed: int = 1) -> Scenario:
    """A MEMS unit, turned by hand."""
    return scenario_of(Setup.of(grade="mems", positions=positions, rest=5.0), np.random.default_rng([seed, 1]))


def observed(scenario: Scenario, seed: int = 1, *, full: bool = False) -> Observations:
    """A session of it, of the linear model or of all groups."""
    session = simulate_observations(scenario, np.random.default_rng([seed, 2]))
    return replace(session, usual=usual_sizes("mems") if full else {})


def without_gyros(session: Observations, usual: dict[str, float]) -> Observations:
    """Accelerometers alone, with groups of such sizes."""
    N = len(session.rests)
    rests = replace(session.rests, gyro=np.empty((N, 0)), gyro_covariance=np.empty((N, 0, 0)))
    return replace(session, gyro_block=None, turns=None, turn_samples=None, rests=rests, usual=usual)


def accelerometers_alone() -> Observations:
    """Twelve rests, with groups twice as large as usual."""
    scenario, usual = by_hand(15), {"accel.quadratic": 5e-6, "accel.cubic": 5e-7}
    accel, gyro = scenario.accel, scenario.gyro
    more = draw_further({name: 2.0 * size for name, size in usual.items()}, accel, gyro, np.random.default_rng(4))
    return without_gyros(observed(replace(scenario, truth=dict(scenario.truth) | more)), usual)


def two_sessions() -> Observations:
    """Of one unit, each with a launch of its own."""
    both = [observed(by_hand(9), seed, full=True) for seed in (1, 2)]
    return join_sessions(both, ["a", "b"], [np.arange(len(each.rests)) for each in both])


def of_pyramids() -> Observations:
    """Four accelerometers and four gyros, with samples that alias."""
    plain, rng = by_hand(9), np.random.default_rng(3)
    accel, gyro = Block(kind="accel", axes=PYRAMID), Block(kind="gyro", axes=PYRAMID)
    names = accel.names + gyro.names
    truth = dict(zip(names, 0.003 * rng.standard_normal(len(names)), strict=True))
    session = observed(replace(plain, accel=accel, gyro=gyro, truth=truth), full=True)
    assert session.turns is not None
    return replace(session, turns=replace(session.turns, aliased=np.linspace(1e-9, 1e-8, len(session.turns))))


SESSIONS = {"pyramids": of_pyramids, "accelerometers": accelerometers_alone, "two sessions": two_sessions}


def started(session: Observations) -> Linearisation:
    """The rows of a session at its start."""
    instrument, local = instruments_of(session)
    problem = Problem.of(session, NO_PRIOR, instrument=instrument, local=local, usual=session.usual)
    return initial_linearisation(problem)


def fitted_of(session: Observations) -> Maximum:
    return maximise(started(session))


def away_from_bounds(entries: Sequence[Hyperparameter], seed: int = 5) -> Array:
    """φ where nothing is at its most likely, and no size at its bound."""
    rng = np.random.default_rng(seed)
    return np.array([0.5 if h.bounded else h.centre for h in entries]) + 0.3 * rng.uniform(-1.0, 1.0, len(entries))


def covariances(step: Solution, unknowns: slice) -> Array:
    """Covariances of some unknowns of each rest, and with those of the next (2, N, k, k)."""
    sensitivity, parts = step.equations.sensitivity[:, unknowns, :-1], enumerate(step.problem.session_spans)
    root = np.concatenate([sensitivity[part.stations] @ step.roots[s] for s, part in parts])
    out = step.conditional_covariances[:, :, unknowns, unknowns].copy()
    out[0] += root @ np.swapaxes(root, 1, 2)
    out[1, :-1] += root[:-1] @ np.swapaxes(root[1:], 1, 2)
    return out


# -------------------- the score --------------------


@pytest.mark.parametrize("name", SESSIONS)
def test_the_score_is_the_derivative_of_the_likelihood(name: str) -> None:
    """By central differences at one linearisation, of every kind of hyperparameter there is."""
    at = started(SESSIONS[name]())
    entries = maximise(at, iterations=1).hyperparameters
    phi, step = away_from_bounds(entries), 1e-4
    gradient, *_ = derivatives(entries, solution_at(at, entries, phi))
    kinds = dict[tuple[object, ...], list[int]]()
    for i, h in enumerate(entries):
        key = (h.kind,) if h.bounded else (h.kind, h.name)
        kinds.setdefault(key, []).append(i)
    some = [i for members in kinds.values() for i in (members[0], members[-1])]
    for i in sorted(set(some)):
        by_one = step * np.eye(len(phi))[i]
        more, less = (solution_at(at, entries, phi + sign * by_one) for sign in (1.0, -1.0))
        numeric = (more.log_posterior - less.log_posterior) / (2.0 * step)
        assert gradient[i] == pytest.approx(numeric, rel=1e-5, abs=1e-4), entries[i].name


def test_the_score_is_the_derivative_with_rows_that_count_less_and_rows_left_out() -> None:
    """By central differences, with the weights of a robust fit; what is left out shows nothing of any scatter."""
    at, rng = started(observed(by_hand())), np.random.default_rng(0)
    weights = {kind: rng.uniform(0.1, 1.0, len(w)) for kind, w in at.noise.weights.items()}
    weights["accel"][3], weights["turn"][5] = 1e-6, 1e-6
    entries, step = maximise(at, iterations=1).hyperparameters, 1e-4
    at, phi = replace(at, noise=at.noise.weighted(weights)), away_from_bounds(entries)
    here = solution_at(at, entries, phi)
    gradient, *_ = derivatives(entries, here)
    for i, h in enumerate(entries):
        by_one = step * np.eye(len(phi))[i]
        more, less = (solution_at(at, entries, phi + sign * by_one) for sign in (1.0, -1.0))
        numeric = (more.log_posterior - less.log_posterior) / (2.0 * step)
        assert gradient[i] == pytest.approx(numeric, rel=1e-5, abs=1e-3), h.name


def test_sessions_of_the_score_have_every_kind_of_hyperparameter() -> None:
    """Of scatter all eight, and of the others every kind."""
    found = [h for make in SESSIONS.values() for h in maximise(started(make()), iterations=1).hyperparameters]
    assert {h.name for h in found if h.kind == "scatter"} == {
        *("accel", "gyro", "turn", "velocity", "apart", "jumps", "aliased", "aliased_apart")
    }
    assert {h.kind for h in found} == {"scatter", "process", "time", "sensor", "group", "local group"}


# -------------------- the elimination --------------------


def with_turns(session: Observations, keep: BoolArray, rests: int) -> Observations:
    """Some of the turns of a session, and its first rests."""
    turns, samples, every = session.turns, session.turn_samples, session.rests
    assert turns is not None
    assert samples is not None
    values = {field.name: getattr(every, field.name) for field in fields(every)}
    first: dict[str, Any] = {name: value[:rests] for name, value in values.items() if value is not None}
    return replace(
        session,
        rests=replace(every, **first),
        turns=type(turns)(**{field.name: getattr(turns, field.name)[keep] for field in fields(turns)}),
        turn_samples=replace(samples, start=samples.start[keep], stop=samples.stop[keep]),
    )


def in_two_files(session: Observations, after: int) -> Observations:
    """The session in two files: the turn between them is in none."""
    assert session.turns is not None
    parts = with_turns(session, session.turns.first != after, len(session.rests))
    return replace(parts, rests=replace(parts.rests, file=(np.arange(len(parts.rests)) > after).astype(np.int64)))


def everything_at_once(at: Linearisation, components: VarianceComponents) -> tuple[Array, Array, float]:
    """By ordinary weighted least squares with biases of every rest whose covariance is σ² exp(−|Δt|/τ), written down:
    estimates and covariance of the angles of all rests, of gravity and the parameters, and of the biases (SI) rest by
    rest, and twice the negative logarithm of the restricted likelihood."""
    problem, rows, noise, plain = at.problem, at, at.noise, plain_rows(at)
    observations = problem.observations
    turns, n, N = observations.turns, problem.sensors, len(plain.rest)
    assert turns is not None
    p = len(rows.prior) - 1
    lines, residual, determinant = [], [], 0.0
    for which, own, N_of_kind, (Z, of) in zip(
        ("rest", "turn"), (plain.rest, plain.turn), noise_covariances(noise), directions(noise), strict=True
    ):
        for k, row in enumerate(own):
            V = N_of_kind[k] + (Z[k] * components.variances[of]) @ Z[k].T
            L = np.linalg.cholesky(V)
            determinant += np.linalg.slogdet(V)[1]
            i, wide = (k, 3) if which == "rest" else (int(turns.first[k]), 6)
            block = np.zeros((len(row), 3 * N + p + N * n))
            block[:, 3 * i : 3 * i + wide], block[:, 3 * N : 3 * N + p] = row[:, :wide], row[:, wide:-1]
            for j in (i,) if which == "rest" else (i, i + 1):
                first = 3 * N + p + j * n
                block[:, first : first + n] = np.eye(len(row), n) if which == "rest" else 0.5 * rows.bias[k]
            lines.append(np.linalg.solve(L, block))
            residual.append(np.linalg.solve(L, row[:, -1]))
    A, y = np.concatenate(lines), np.concatenate(residual)
    prior = rows.prior[:-1]
    information, right = A.T @ A, A.T @ y
    inside = slice(3 * N, 3 * N + p)
    information[inside, inside] += prior[:, :-1].T @ prior[:, :-1]
    right[inside] += prior[:, :-1].T @ prior[:, -1]
    time, file = middles(observations), observations.rests.file
    sigma, tau = components.of_states(problem.instrument.accel.size, n - problem.instrument.accel.size)
    for s in range(n):
        C = sigma[s] ** 2 * np.exp(-np.abs(time[:, None] - time) / tau[s]) * (file[:, None] == file)
        states = 3 * N + p + s + n * np.arange(N)
        information[np.ix_(states, states)] += np.linalg.inv(C)
        determinant += np.linalg.slogdet(C)[1]
    scale = np.sqrt(np.diag(information))
    scaled = information / np.outer(scale, scale)
    covariance = np.linalg.inv(scaled) / np.outer(scale, scale)
    values = np.linalg.solve(scaled, right / scale) / scale
    determinant += np.linalg.slogdet(scaled)[1] + 2.0 * np.log(scale).sum()
    sizes = problem.prior_u[1 + problem.instrument.linear_count :]
    square = float(y @ y + prior[:, -1] @ prior[:, -1] - right @ values)
    return values, covariance, square + determinant + 2.0 * float(np.log(sizes).sum())


IN_RUN = VarianceComponents(
    turn=1e-5,
    velocity=1e-3,
    accel_in_run=8e-4,
    gyro_in_run=1e-4,
    accel_time=60.0,
    gyro_time=400.0,
    unlike=np.array([1.0, 2.0, 1.0, 1.0, 1.0, 3.0]),
)


@pytest.mark.parametrize("cut", [False, True], ids=["one file", "two files"])
def test_states_of_biases_are_those_of_everything_at_once(cut: bool) -> None:
    """Values and covariances of parameters and states, the restricted likelihood, and the biases as the means over the
    session."""
    session = observed(by_hand(9), full=True)
    at = started(in_two_files(session, 4) if cut else session)
    problem, step = at.problem, solve(at, IN_RUN)
    values, covariance, deviance = everything_at_once(at, IN_RUN)
    again, _, other = everything_at_once(at, replace(IN_RUN, gyro_time=100.0, turn=5e-5))
    N, n, p = len(problem.chain), problem.sensors, len(at.prior) - 1
    u = np.sqrt(np.diag(covariance))
    inside, states = slice(3 * N, 3 * N + p), slice(3 * N + p, None)
    sigma, _ = IN_RUN.of_states(3, 3)
    assert step.parameters / u[inside] == pytest.approx(values[inside] / u[inside], abs=1e-4, rel=1e-5)
    size = np.outer(u[inside], u[inside])
    np.testing.assert_allclose(step.covariance / size, covariance[inside, inside] / size, atol=1e-5)
    np.testing.assert_allclose(
        (step.unknowns[:, 3:] * sigma).ravel() / u[states], values[states] / u[states], atol=1e-4, rtol=1e-5
    )
    own = np.diagonal(covariances(step, slice(3, None))[0], axis1=1, axis2=2)
    np.testing.assert_allclose(np.sqrt(own).ravel() * np.tile(sigma, N), u[states], rtol=1e-5)
    changed = solve(at, replace(IN_RUN, gyro_time=100.0, turn=5e-5))
    assert changed.deviance - step.deviance == pytest.approx(other - deviance, abs=1e-3)
    assert np.abs(again - values).max() > 0.0
    mean = np.zeros((n, len(values)))
    mean[np.arange(n), 3 * N + 1 + problem.biases] = 1.0
    for s in range(n):
        mean[s, 3 * N + p + s + n * np.arange(N)] = 1.0 / N
    by, noise = session_mean_bias(step.equations)
    more, apart = by @ np.append(step.parameters, -1.0), np.einsum("ibd,icd->bc", noise, noise)
    to_session = np.eye(n, p, 1)
    to_session[:] = 0.0
    to_session[np.arange(n), 1 + problem.biases] = 1.0
    to_session += by[:, :-1]
    expected = mean @ covariance @ mean.T
    scale = np.sqrt(np.diag(expected))
    found = step.parameters[1 + problem.biases] + more
    np.testing.assert_allclose(found / scale, (mean @ values) / scale, atol=1e-4, rtol=1e-5)
    np.testing.assert_allclose(
        (to_session @ step.covariance @ to_session.T + apart) / np.outer(scale, scale),
        expected / np.outer(scale, scale),
        atol=1e-5,
    )


def test_a_session_in_two_files_is_the_same_but_for_the_chain_that_begins_anew() -> None:
    """With biases that forget within a turn nothing begins anew: step, covariance and likelihood are then those of a
    session in one file without the turn."""
    session = observed(by_hand(9))
    two = in_two_files(session, 4)
    one = replace(two, rests=replace(two.rests, file=np.zeros_like(two.rests.file)))
    short, long = (replace(IN_RUN, accel_time=t, gyro_time=t) for t in (0.1, 300.0))
    steps = []
    for each in (one, two):
        at = started(each)
        steps.append([solve(at, c) for c in (short, long)])
        begins = at.with_components(long).noise.state_rho[4]
        assert np.all(begins == 0.0) == (each is two)
    u = np.sqrt(np.diag(steps[0][0].covariance))
    np.testing.assert_allclose(steps[1][0].parameters / u, steps[0][0].parameters / u, atol=1e-6)
    np.testing.assert_allclose(
        steps[1][0].covariance / np.outer(u, u), steps[0][0].covariance / np.outer(u, u), atol=1e-6
    )
    assert steps[1][0].deviance == pytest.approx(steps[0][0].deviance, abs=1e-6)
    assert abs(steps[1][1].deviance - steps[0][1].deviance) > 1e-3
    whole, cut = joint(one), joint(two)
    assert np.abs((whole.values - cut.values) / cut.u).max() < 0.5
    np.testing.assert_allclose(cut.u, whole.u, rtol=0.25)


# -------------------- the maximum --------------------


@pytest.mark.parametrize("name", ["by hand", *SESSIONS])
def test_two_starts_have_one_maximum(name: str) -> None:
    """From above and from below everything that is likely: ℓ within a fifth, and the parameters within a fifth of u."""
    at = started(SESSIONS[name]() if name in SESSIONS else observed(by_hand()))
    first = maximise(at)
    found = [first]
    for away in (-1.5, 1.5):
        phi = np.array([max(away, 0.0) if h.bounded else h.centre + away for h in first.hyperparameters])
        found.append(maximise(at, phi))
    linear = slice(at.problem.instrument.linear_count)
    u = np.sqrt(first.solution.covariance.diagonal()[1:])[linear]
    for each in found:
        assert each.converged
        assert each.solution.log_posterior == pytest.approx(float(first.solution.log_posterior), abs=0.2)
        np.testing.assert_allclose((each.point.values - first.point.values)[linear] / u, 0.0, atol=0.2)


def test_a_status_that_ran_out_is_not_converged_and_not_accepted(monkeypatch: pytest.MonkeyPatch) -> None:
    session = observed(by_hand())
    short = maximise(started(session), iterations=1)
    assert not short.converged
    assert not short.converged
    assert joint(session).converged
    monkeypatch.setattr(of_joint, "MAX_ITERATIONS", 1)
    found = joint(session)
    assert not found.converged
    assert not verdict(found, session).accepted


def test_more_rests_never_make_the_mean_of_a_process_worse() -> None:
    """With the same components, u of every bias as the mean of its process falls with every rest, however long the
    process lasts."""
    session = observed(by_hand(14))
    point = started(session).point
    for seconds in (3.0, 100.0, 3000.0):
        before = np.full(6, np.inf)
        for count in (8, 10, 12, 14):
            at = started(with_turns(session, np.arange(13) < count - 1, count))
            here = linearise(at.problem, replace(point, attitudes=point.attitudes[:count]), at.integrated)
            step = solve(here, replace(IN_RUN, accel_time=seconds, gyro_time=seconds))
            u = np.sqrt(step.covariance.diagonal()[1:][at.problem.biases])
            assert np.all(u < before * (1.0 + 1e-6))
            before = u


# -------------------- what does not fit --------------------


def test_the_farthest_of_many_rests_is_no_outlier() -> None:
    """In 240 rests and 239 turns something is beyond 3 sigmas by chance: the maximum is taken once."""
    codes = [position.attitude for position in programme("rough-table").positions]
    setup = replace(Setup.of(grade="tactical"), programme=from_attitudes(codes * 16))
    fitted = fitted_of(observed(scenario_of(setup, np.random.default_rng(1)), 1))
    assert 3.0 < np.concatenate(list(sigmas(fitted.solution).values())).max() < 3.7
    assert without_outliers(fitted) is fitted


def test_a_robust_fit_settles() -> None:
    """Weights and scatter agree in fewer steps than there may be."""
    fitted = fitted_of(observed(by_hand()))
    robust = maximise(fitted.linearisation, fitted.phi, robust=True)
    assert robust.converged
    assert len(robust.increments) < 15


def test_a_spoilt_turn_is_left_out_and_named_and_moves_nothing() -> None:
    """One of 29, by 30 times its noise about a level axis, and by 300."""
    session = observed(by_hand(30))
    undisturbed = joint(session)
    assert undisturbed.left_out is not None
    assert not any(
        each.any() for each in (undisturbed.left_out.accel, undisturbed.left_out.gyro, undisturbed.left_out.turn)
    )
    turns, samples = session.turns, session.turn_samples
    assert turns is not None
    assert samples is not None
    noise = float(np.sqrt(np.trace(turns.covariance[11]) / 3.0))
    level = unit_vector(np.cross(session.rests.accel[11], [0.6, -0.48, 0.64]))
    for times in (30.0, 300.0):
        rates, forces, dt = (each.copy() for each in samples.samples.read(0, samples.samples.count))
        own = slice(int(samples.start[11]), int(samples.stop[11]))
        rates[own] += times * noise * level / dt[own].sum()
        other = type(samples.samples)()
        other.append(rates, forces, dt)
        spoilt = replace(session, turn_samples=replace(samples, samples=other))
        found = joint(spoilt)
        assert found.left_out is not None
        assert np.flatnonzero(found.left_out.turn).tolist() == [11]
        assert not found.left_out.accel.any()
        assert not found.left_out.gyro.any()
        assert np.abs((found.values - undisturbed.values) / undisturbed.u).max() < 1.0
        assert np.all(found.u < 1.3 * undisturbed.u)
        said = verdict(found, spoilt)
        assert any("turn from rest 12 to rest 13" in each for each in said.reasons + said.remarks)


# -------------------- the integral --------------------


def test_the_integral_is_the_same_to_the_last_digit() -> None:
    first, second = (posterior(fitted_of(observed(by_hand(9)))) for _ in range(2))
    for name in ("step", "covariance", "degrees", "process_step", "process_covariance", "hyperparameters"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert first.integral == second.integral


@pytest.mark.weekly
def test_the_integral_is_that_of_a_sampler() -> None:
    """Means within 0.1 u, u within 10 % of those of a Metropolis sampler of φ with exact conditionals: accelerometers
    alone, where what is not known of the model matters the most."""
    fitted = fitted_of(without_gyros(observed(by_hand(15)), {"accel.quadratic": 5e-6}))
    found = study("metropolis").compared(fitted, draws=3000, seed=2)
    assert found.means < 0.1
    assert found.u < 0.1


@pytest.mark.parametrize("name", SESSIONS)
def test_sizes_folded_into_a_triangle_are_those_of_the_whole_elimination(name: str) -> None:
    """ℓ, step and covariance, biases being those of the session, at two sizes of groups that share a triangle."""
    fitted = fitted_of(SESSIONS[name]())
    hyperparameters = fitted.hyperparameters
    groups = np.array([i for i, h in enumerate(hyperparameters) if h.kind == "group"])
    phi = np.tile(away_from_bounds(hyperparameters), (2, 1))
    phi[1, groups] += 0.7
    members, element = members_of(fitted, groups)
    every = triangles(fitted.linearisation, hyperparameters, phi[:1], members)
    sizes = fitted.problem.usual_u[1 + members] * np.exp(phi[:, element])
    folded = Folded.of(every.information[0], every.right[0], sizes)
    own = slice(1 + len(fitted.problem.instrument.names))  # without the biases as means of their processes
    alpha, gamma, omega = every.alpha[0, own], every.gamma[0, own], every.omega[0, own, own]
    for k in range(2):
        solution = solution_at(fitted.linearisation, hyperparameters, phi[k])
        step, covariance = solution.session_step, solution.session_covariance
        u = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        likelihood = folded.log_likelihood[k] - 0.5 * every.deviance[0]
        assert likelihood == pytest.approx(-0.5 * float(solution.deviance), abs=1e-6)
        np.testing.assert_allclose((alpha + gamma @ folded.values[k] - step)[1:] / u[1:], 0.0, atol=1e-6)
        whole = omega + gamma @ folded.covariance(np.eye(2)[k]) @ gamma.T
        np.testing.assert_allclose((whole - covariance) / np.outer(u, u), 0.0, atol=1e-6)


def test_a_posterior_that_the_proposal_misses_is_found_in_rounds(data: Path) -> None:
    """A chip that is turned by hand while its biases drift: 304 points of the proposal give half the u of the axes. The
    reference is of 16 Metropolis chains of 1,200 steps, whose means differ by 0.26 u for accel.axis.zx."""
    log = pl.read_parquet(data / "mimu4444" / "exp_3.parquet")
    accel, gyro = (log.select(f"{kind}6{axis}" for axis in "xyz").to_numpy() for kind in "ag")
    found = tumble.calibrate(accel=accel / 2048.0 * 9.80665, gyro=np.radians(gyro / 16.4), time=log["t"].to_numpy())
    reference = {"yx": (69.9e-6, 232e-6), "zx": (-2200.7e-6, 300e-6), "zy": (-3429.2e-6, 210e-6)}
    for pair, (value, u) in reference.items():
        axis = found[f"accel.axis.{pair}"]
        assert axis.value == pytest.approx(value, abs=0.7 * u)
        assert axis.u is not None
        assert 0.65 * u < axis.u < 1.3 * u


def test_the_integral_is_wider_than_the_maximum() -> None:
    fitted = fitted_of(accelerometers_alone())
    whole, alone = posterior(fitted), posterior(fitted, integrate=False)
    linear = slice(1, 10)
    ratio = np.sqrt(np.diag(whole.covariance)[linear] / np.diag(alone.covariance)[linear])
    assert np.all(ratio > 0.98)
    assert ratio.max() > 1.02
    assert whole.integral.effective > 0.2 * whole.integral.points
    assert whole.integral.pareto < 0.7


def test_weights_and_their_shape_are_those_of_the_distribution_they_are_from() -> None:
    """Equal weights are all effective; of half of them the half; and the shape of Pareto's distribution is found."""
    weight, shape = pareto_smoothed(np.full(128, -700.0))
    assert 1.0 / (weight**2).sum() == pytest.approx(128.0)
    assert shape == 0.0
    weight, _ = pareto_smoothed(np.where(np.arange(128) % 2 == 0, 3.0, -1e4))
    assert 1.0 / (weight**2).sum() == pytest.approx(64.0)
    chance = (np.arange(20000) + 0.5) / 20000
    for k in (0.2, 0.5, 0.9):
        log_weight = -k * np.log1p(-chance)
        weight, shape = pareto_smoothed(np.random.default_rng(1).permutation(log_weight))
        assert shape == pytest.approx(k, abs=0.1)
        assert weight.sum() == pytest.approx(1.0)
        assert weight.max() <= np.exp(log_weight.max()) / np.exp(log_weight).sum() * 1.5
