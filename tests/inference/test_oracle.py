"""ℓ, its score, the estimate and its uncertainty are those of dense matrices with the attitudes projected out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tests.inference.oracle import dense
from tests.inference.test_inference import (
    SESSIONS,
    away_from_bounds,
    by_hand,
    in_two_files,
    observed,
    started,
    without_gyros,
)
from tumble.inference.hyperparameters import (
    average_information,
    derivatives,
    solution_at,
)
from tumble.inference.maximum import maximise
from tumble.planning.setup import Setup
from tumble.reduction.observations import Observations
from tumble.sensors.parameters import usual_sizes
from tumble.simulation.scenario import scenario_of
from tumble.units import Array


def on_a_table(seed: int, programme: str = "rough-table", *, full: bool = False) -> Observations:
    setup = Setup.of(grade="tactical", programme=programme)
    return observed(scenario_of(setup, np.random.default_rng([seed, 1])), seed, full=full)


def one_of_its_kind(name: str, _: int) -> Observations:
    return SESSIONS[name]()


MADE: dict[str, Callable[[int], Observations]] = {
    "by hand": lambda seed: observed(by_hand(seed=seed), seed),
    "by hand, all groups": lambda seed: observed(by_hand(9, seed), seed, full=True),
    "table": on_a_table,
    "table, all groups": lambda seed: on_a_table(seed, full=True),
    "cube, accelerometers": lambda seed: without_gyros(on_a_table(seed, "cube-26", full=True), usual_sizes("mems")),
    "two files": lambda seed: in_two_files(observed(by_hand(9, seed), seed, full=True), 4),
    **{name: partial(one_of_its_kind, name) for name in SESSIONS},
}


EVERY = [(name, seed) for name in MADE for seed in range(1, 2 if name in SESSIONS else 4)]


@pytest.mark.parametrize(("name", "seed"), EVERY)
def test_likelihood_score_and_estimate_are_those_of_dense_matrices(name: str, seed: int) -> None:
    start = started(MADE[name](seed))
    if seed == 3:  # biases that are anew at every rest
        start = start.again(replace(start.problem, bias_after=1.0), start.point)
    fitted = maximise(start, iterations=1)
    hyperparameters, at = fitted.hyperparameters, fitted.linearisation
    phi, S, q = away_from_bounds(hyperparameters, seed), len(at.problem.session_spans), len(at.problem.local_u)
    here = solution_at(at, hyperparameters, phi)
    expected = here.problem.prior_mean - np.append(at.point.gravity, at.point.values)
    u = np.append(np.tile(here.problem.local_u, S), here.problem.prior_u)
    found = dense(here.problem, at, at.noise, here.components, (u, np.append(-at.point.local.ravel(), expected)))

    # the likelihood and its score
    assert here.deviance == pytest.approx(found.deviance, abs=1e-9)
    (gradient, *_), of_prior = derivatives(hyperparameters, here), hyperparameters.log_prior(phi)[1]
    variates = list[Array]()
    for h, slope in zip(hyperparameters, gradient - of_prior, strict=True):
        if h.kind in {"scatter", "process", "time"}:
            by, variate = found.by_component[h.name], found.variates[h.name]
        elif h.kind == "sensor":
            by, variate = float(found.by_sensor[h.members].sum()), found.variates_of_sensors[h.members].sum(axis=0)
        else:
            common = h.kind == "group"
            places = np.arange(S * q + 1, len(u)) if common else np.arange(S * q).reshape(S, q)
            members = places[..., h.members].ravel()
            by, variate = float(found.by_prior[members].sum()), found.variates_of_priors[members].sum(axis=0)
        assert slope == pytest.approx(by, abs=1e-7, rel=1e-9), h.name
        variates.append(variate)

    # average information, in units of its diagonal or of the 1 that a prior has
    Q = np.array(variates)
    expected_information = 0.5 * Q @ found.projector @ Q.T
    information = average_information(hyperparameters, here) - np.diag(hyperparameters.log_prior(phi)[2])
    size = np.sqrt(np.maximum(expected_information.diagonal(), 1.0))
    np.testing.assert_allclose((information - expected_information) / np.outer(size, size), 0.0, atol=1e-7)

    # the estimate, and that with the biases of the session
    x, shared = np.append(here.local, here.parameters), slice(S * q, None)
    seen, u = np.diag(found.covariance) > 0.0, np.sqrt(np.maximum(np.diag(found.covariance), 1e-300))
    np.testing.assert_allclose(((x - found.x) / u)[seen], 0.0, atol=1e-9)
    for ours, theirs in (
        (here.covariance, found.covariance[shared, shared]),
        (here.session_covariance, found.session_covariance[shared, shared]),
    ):
        size = np.sqrt(np.maximum(np.diag(theirs), 1e-300))
        np.testing.assert_allclose((ours - theirs) / np.outer(size, size), 0.0, atol=1e-9)
    off = (here.session_step - found.session_x[shared])[1:]
    np.testing.assert_allclose(off / np.sqrt(np.diag(found.session_covariance)[shared])[1:], 0.0, atol=1e-9)
