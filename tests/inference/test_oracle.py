"""ℓ, its score, the estimate and its uncertainty are those of dense matrices in which the attitudes are projected out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

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
from tumble.inference.hyperparameters import components_of
from tumble.inference.integral import conditional
from tumble.inference.maximum import Evaluated, maximum
from tumble.planning.setup import Setup
from tumble.reduction.observations import Observations
from tumble.sensors.parameters import usual_sizes
from tumble.simulation.scenario import scenario_of


def on_a_table(seed: int, programme: str = "rough-table", *, full: bool = False) -> Observations:
    setup = Setup.of(grade="tactical", programme=programme)
    return observed(scenario_of(setup, np.random.default_rng([seed, 1])), seed, full=full)


MADE: dict[str, Callable[[int], Observations]] = {
    "by hand": lambda seed: observed(by_hand(seed=seed), seed),
    "by hand, all groups": lambda seed: observed(by_hand(9, seed), seed, full=True),
    "table": on_a_table,
    "table, all groups": lambda seed: on_a_table(seed, full=True),
    "cube, accelerometers": lambda seed: without_gyros(on_a_table(seed, "cube-26", full=True), usual_sizes("mems")),
    "two files": lambda seed: in_two_files(observed(by_hand(9, seed), seed, full=True), 4),
    **{name: lambda _, make=make: make() for name, make in SESSIONS.items()},
}


@pytest.mark.parametrize(("name", "seed"), [(name, seed) for name in MADE for seed in range(1, 2 if name in SESSIONS else 4)])
def test_likelihood_score_and_estimate_are_those_of_dense_matrices(name: str, seed: int) -> None:
    problem, start = started(MADE[name](seed))
    if seed == 3:  # biases that are anew at every rest
        problem = replace(problem, bias_after=1.0)
    fitted = maximum(problem, start, iterations=1)
    entries, at = fitted.entries, fitted.at
    phi, S, q = away_from_bounds(entries, seed), len(problem.parts), len(problem.own_known)
    here = Evaluated.of(problem, entries, at, phi)
    sizes, expected = here.problem.measured[1], here.problem.measured[0] - np.append(at.point.gravity, at.point.values)
    priors = np.append(np.tile(here.problem.own_known, S), sizes), np.append(-at.point.own.ravel(), expected)
    found = dense(problem, at.rows, at.noise, components_of(entries, phi), priors)

    # the likelihood and its score
    assert here.known.deviance == pytest.approx(found.deviance, abs=1e-9)
    for h, slope, of_prior in zip(entries, here.gradient, entries.prior(phi)[1], strict=True):
        if h.place in ("scatter", "in-run", "time"):
            by = found.by_component[h.name]
        elif h.place == "unlike":
            by = float(found.by_sensor[h.members].sum())
        elif h.place == "group":
            by = float(found.by_prior[S * q + 1 :][h.members].sum())
        else:
            by = float(found.by_prior[: S * q].reshape(S, q)[:, h.members].sum())
        assert slope == pytest.approx(by + of_prior, abs=1e-7, rel=1e-9), h.name

    # the estimate, and that with the biases of the session
    x, session, shared = np.append(here.known.own, here.known.parameters), conditional(here), slice(S * q, None)
    u = np.sqrt(np.maximum(np.diag(found.covariance), 1e-300))
    np.testing.assert_allclose((x - found.x)[u > 1e-100] / u[u > 1e-100], 0.0, atol=1e-9)
    for ours, theirs in (
        (here.step.covariance, found.covariance[shared, shared]),
        (session.covariance, found.session_covariance[shared, shared]),
    ):
        size = np.sqrt(np.maximum(np.diag(theirs), 1e-300))
        np.testing.assert_allclose((ours - theirs) / np.outer(size, size), 0.0, atol=1e-9)
    off = (session.step - found.session_x[shared])[1:]
    np.testing.assert_allclose(off / np.sqrt(np.diag(found.session_covariance)[shared])[1:], 0.0, atol=1e-9)
