"""The covariance by source: the sources together are the covariance, and each is what a session varies by in which it
alone does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from tests.inference.test_inference import by_hand, fitted_of, observed, two_sessions, without_gyros
from tumble.inference.elimination import given_others
from tumble.inference.hyperparameters import SCATTER, Weights, components_of, sized
from tumble.inference.in_run import InRun, mean_along
from tumble.inference.integral import conditional
from tumble.inference.joint import joint
from tumble.inference.likelihood import Problem, Rows
from tumble.inference.linearisation import with_priors
from tumble.inference.maximum import Maximum, without_outliers
from tumble.inference.step import Step, solve
from tumble.inference.uncertainty_budget import noise_roots
from tumble.methods.ellipsoid import ellipsoid
from tumble.planning.setup import Setup
from tumble.reduction.observations import Observations
from tumble.rotation import unit_vector
from tumble.sensors.parameters import usual_sizes
from tumble.simulation.scenario import scenario_of
from tumble.units import Array

N = 500
"""Draws: a standard deviation is then known to 3.2 %, so that 10 % is beyond three of these and a largest of twenty
sources still within; the seed is fixed."""


def rough_table(seed: int = 1) -> Observations:
    """The paper's programme, MEMS."""
    return observed(
        scenario_of(Setup.of(grade="mems", programme="rough-table"), np.random.default_rng([seed, 1])), full=True
    )


def without_latitude() -> Observations:
    """By hand, where the Earth's rate is not known."""
    session = observed(by_hand(), full=True)
    return replace(session, site=replace(session.site, latitude=None))


def with_an_outlier() -> Observations:
    """By hand, with a rest that does not fit and is weighed down."""
    session = observed(by_hand(15), full=True)
    accel = session.rests.accel.copy()
    accel[4] += 40.0 * np.sqrt(np.diagonal(session.rests.accel_covariance[4]))
    return replace(session, rests=replace(session.rests, accel=accel))


SESSIONS: dict[str, Callable[[], Observations]] = {
    "by hand": lambda: observed(by_hand(), full=True),
    "rough table": rough_table,
    "cube": lambda: without_gyros(
        observed(scenario_of(Setup.of(grade="mems", programme="cube-26"), np.random.default_rng([1, 1])), full=True),
        usual_sizes("mems"),
    ),
}
OTHERS: dict[str, Callable[[], Observations]] = {
    "no latitude": without_latitude,
    "an outlier": with_an_outlier,
    "two sessions": two_sessions,
}


@pytest.mark.parametrize("name", [*SESSIONS, *OTHERS])
def test_the_sources_are_the_covariance(name: str) -> None:
    """At given hyperparameters, that of the elimination, biases being those of the session."""
    fitted = fitted_of((SESSIONS | OTHERS)[name]())
    if name == "an outlier":
        fitted = without_outliers(fitted)
        assert fitted.at.noise.kept[0].min() < 1.0 or fitted.at.noise.kept[1].min() < 1.0
    problem, rows, weight = at_best(fitted)
    step = solve(problem, rows, weight)
    expected = step.covariance.copy()
    if step.told.process is not None and len(problem.parts) == 1:
        q, biases = len(problem.own_known), 1 + problem.biases
        _, along, noise = mean_along(step.told, given_others(step.told.factor))
        to_session = np.eye(len(expected))
        to_session[biases] += along[:, q:]
        expected = to_session @ expected @ to_session.T
        expected[np.ix_(biases, biases)] += np.einsum("ibd,icd->bc", noise, noise)
    found = conditional(fitted.best).covariances(noise_roots(fitted.free, fitted.at))
    u = np.sqrt(np.diag(expected)[1:])
    together = np.sum(list(found.values()), axis=0)[1:, 1:]
    np.testing.assert_allclose(together / np.outer(u, u), expected[1:, 1:] / np.outer(u, u), rtol=0.0, atol=1e-12)
    for source, covariance in found.items():
        smallest = np.linalg.eigvalsh(covariance[1:, 1:] / np.outer(u, u))[0]
        assert smallest > -1e-12, source


@pytest.mark.parametrize("name", [*SESSIONS, *OTHERS])
def test_the_sources_of_an_estimate_are_its_covariance(name: str) -> None:
    """With the hyperparameters integrated out."""
    estimate = joint((SESSIONS | OTHERS)[name]())
    assert estimate.budget is not None
    np.testing.assert_allclose(
        estimate.budget.covariances.sum(axis=0) / np.outer(estimate.u, estimate.u),
        estimate.covariance / np.outer(estimate.u, estimate.u),
        rtol=0.0,
        atol=1e-12,
    )
    assert len({each.name for each in estimate.budget.sources}) == len(estimate.budget.sources)


def at_best(fitted: Maximum) -> tuple[Problem, Rows, Weights]:
    """The problem, rows and weights at the maximum."""
    components = components_of(fitted.entries, fitted.best.phi)
    problem = sized(fitted.free, fitted.entries, fitted.best.phi)
    rows = with_priors(fitted.at.rows, problem, fitted.at.point, fitted.at.about)
    return problem, rows, fitted.at.noise.weights(components)


@pytest.mark.parametrize("name", SESSIONS)
def test_every_source_is_what_a_session_varies_by_where_it_alone_does(name: str) -> None:
    """N = 500 sessions of each source: readings, rotations, velocities, biases or what is known beforehand drawn from
    it, all else without error, and estimated."""
    fitted = fitted_of(SESSIONS[name]())
    problem = at_best(fitted)[0]
    expected = conditional(fitted.best).covariances(noise_roots(fitted.free, fitted.at))
    whole = np.sqrt(np.sum([np.diag(each) for each in expected.values()], axis=0))[1:]
    draw, seen = Drawn(fitted, problem, np.random.default_rng(7)), 0
    for source, covariance in expected.items():
        u = np.sqrt(np.diag(covariance))[1:]
        matters = u > 0.05 * whole
        if not matters.any():
            continue
        errors = np.array([draw.error(source) for _ in range(N)])[:, 1:]
        found = np.sqrt(np.mean(errors**2, axis=0))
        assert np.median(found[matters] / u[matters]) == pytest.approx(1.0, abs=0.1), source
        assert np.all(np.abs(found[matters] / u[matters] - 1.0) < 0.2), source
        seen += 1
    assert seen >= 6


class Drawn:
    """Sessions in which one source alone varies, and what is estimated from them less what is true."""

    def __init__(self, fitted: Maximum, problem: Problem, rng: np.random.Generator) -> None:
        self.fitted, self.problem, self.rng = fitted, problem, rng
        self.components = components_of(fitted.entries, fitted.best.phi)
        point, about = fitted.at.point, fitted.at.about
        rows = with_priors(fitted.at.rows, problem, point, about)
        rest, turn = rows.rest.copy(), rows.turn.copy()
        rest[..., -1], turn[..., -1] = 0.0, 0.0
        prior = rows.prior.copy()
        prior[:, -1] = 0.0
        self.rows, self.weight = (
            replace(rows, rest=rest, turn=turn, prior=prior),
            fitted.at.noise.weights(self.components),
        )

    def error(self, source: str) -> Array:
        """The error of gravity and the parameters by one draw."""
        rest, turn, prior = self.rows.rest.copy(), self.rows.turn.copy(), self.rows.prior.copy()
        problem, noise, n = self.problem, self.fitted.at.noise, self.problem.instrument.accel.size
        truth = np.zeros(len(problem.measured[0]))
        kind, _, what = source.partition(".")
        if what == "noise" and kind in ("accel", "gyro"):
            own = slice(n) if kind == "accel" else slice(n, problem.sensors)
            rest[:, own, -1] += self._of(noise.rest[:, own, own])
        elif source == "turn.accel.noise":
            assert problem.observations.turns is not None
            turn[:, 3:6, -1] += self._of(problem.observations.turns.velocity_covariance)
        elif source == "turn.gyro.noise":
            turns, whole = problem.observations.turns, noise.turn.copy()
            assert turns is not None
            if problem.instrument.in_velocities:
                whole[:, 3:6, 3:6] -= turns.velocity_covariance
            turn[..., -1] += self._of(whole)
        elif what == "scatter":
            size, place = getattr(self.components, kind), SCATTER.index(kind)
            for (Z, of), out in ((noise.at_rest(self.components), rest), (noise.turn_directions, turn)):
                along = Z[:, :, of == place]
                out[..., -1] += size * (along @ self.rng.standard_normal((*along.shape[::2], 1)))[..., 0]
        elif what == "in_run":
            biases = self._biases(kind)
            rest[:, : problem.sensors, -1] += biases
            first = problem.before_turn
            turn[..., -1] += (self.rows.bias @ (0.5 * (biases[first] + biases[first + 1]))[..., None])[..., 0]
            truth[1 + problem.biases] = biases.mean(axis=0)
        else:
            assert kind in ("prior", "gravity"), source
            own, size = self._beforehand(source), problem.measured[1]
            draw = np.zeros(len(size))
            draw[own] = size[own] * self.rng.standard_normal(len(size[own]))
            prior[:-1, -1] = prior[:-1, :-1] @ draw
        step = solve(problem, replace(self.rows, rest=rest, turn=turn, prior=prior), self.weight)
        return self._of_session(step) - truth

    def _of(self, covariance: Array) -> Array:
        value, vectors = np.linalg.eigh(covariance)
        draw = self.rng.standard_normal(value.shape)
        return np.asarray((vectors @ (np.sqrt(np.maximum(value, 0.0)) * draw)[..., None])[..., 0])

    def _biases(self, kind: str) -> Array:
        """The in-run biases (N, n) of a kind of sensor at the rests, those of the other zero."""
        process, n = InRun.of(self.problem, self.components), self.problem.instrument.accel.size
        states = self.rng.standard_normal(process.rho.shape)
        for i in range(1, len(states)):
            states[i] = process.rho[i - 1] * states[i - 1] + process.deviation[i - 1] * states[i]
        of_kind = np.arange(len(process.sigma)) < n if kind == "accel" else np.arange(len(process.sigma)) >= n
        return np.asarray(states * process.sigma * of_kind)

    def _beforehand(self, source: str) -> slice:
        if source == "gravity":
            return slice(1)
        if source == "prior.linear":
            return slice(1, 1 + self.problem.instrument.linear_count)
        members = self.problem.instrument.members[source.removeprefix("prior.")]
        return slice(1 + members.start, 1 + members.stop)

    def _of_session(self, step: Step) -> Array:
        out = step.parameters.copy()
        if step.told.process is not None:
            values, along, _ = mean_along(step.told, given_others(step.told.factor))
            out[1 + self.problem.biases] += values + along @ step.parameters
        return out


def test_every_source_of_the_ellipsoid_is_what_it_varies_by_where_it_alone_does() -> None:
    """N = 500 sets of readings in 26 positions of a cube for noise, gravity and each group that is taken as nothing,
    whose terms are written down here; u by noise is that of every fit by its own residuals."""
    session = SESSIONS["cube"]()
    session = replace(session, site=replace(session.site, gravity_u=1e-3))
    estimate, rests, rng = ellipsoid(session), session.rests, np.random.default_rng(8)
    assert estimate.budget is not None
    force = session.site.gravity * unit_vector(estimate.accel.apply(rests.accel))
    readings, roots = estimate.accel.predict(force), np.linalg.cholesky(rests.accel_covariance)
    time, seen = 0.5 * (rests.start + rests.stop), list[str]()
    time = (time - time.mean())[:, None]
    terms = {
        "accel.quadratic": readings**2,
        "accel.cubic": readings**3,
        "accel.asymmetry": np.abs(readings),
        "accel.bias.drift": np.broadcast_to(time, readings.shape),
        "accel.scale.drift": time * readings,
    }
    for source, covariance in zip(estimate.budget.sources, estimate.budget.covariances, strict=True):
        own, errors, variances = np.sqrt(np.diag(covariance)[:9]), [], []
        if np.all(own < 0.05 * estimate.u[:9]):
            continue
        seen.append(source.name)
        for _ in range(N):
            if source.name == "fit":
                read = readings + (roots @ rng.standard_normal((*readings.shape, 1)))[..., 0]
            elif source.name == "gravity":
                read = estimate.accel.predict(force * (1.0 + 1e-3 * rng.standard_normal() / session.site.gravity))
            else:
                group = source.name.removeprefix("prior.")
                read = readings + session.usual[group] * rng.standard_normal(3) * terms[group]
            found = ellipsoid(replace(session, rests=replace(rests, accel=read), usual={}))
            errors.append(found.values - estimate.values[:9])
            assert found.budget is not None
            variances.append(np.diag(found.budget.covariances[0]))
        rms = np.sqrt(np.mean(np.square(errors), axis=0))
        u = own if source.name != "fit" else np.sqrt(np.mean(variances, axis=0))
        matters = u > 0.05 * estimate.u[:9]
        assert np.median(rms[matters] / u[matters]) == pytest.approx(1.0, abs=0.1), source.name
        assert np.all(np.abs(rms[matters] / u[matters] - 1.0) < 0.2), source.name
    assert len(seen) >= 5
