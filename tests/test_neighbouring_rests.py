"""Gyros of an array whose biases are alike in neighbouring rests: a correlation that is found, in u, and no excuse for
what a cause explains."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from test_wandering import of_six

from tumble.inference.by_session import each_session
from tumble.estimation.causes.neighbouring_rests import Neighbours, common_to_neighbours, neighbours
from tumble.estimation.causes.projection import Projection
from tumble.estimation.diagnosis.misfit import misfit
from tumble.estimation.diagnosis.verdict import verdict
from tumble.estimation.estimate import Estimate
from tumble.inference.joint import joint
from tumble.reduction.observations import Observations
from tumble.units import Array


def unstable(seed: int, correlation: float, settles: float = 0.0) -> Observations:
    """Six gyros by hand whose biases differ from rest to rest by three times their noise, with a correlation of
    neighbours that lasts, and settle by so many times more over six rests."""
    seen, rng = of_six(seed, 0.0), np.random.default_rng([77, seed])
    own = rng.standard_normal(seen.rests.gyro.shape)
    for before, after in pairwise(own):
        after *= np.sqrt(1.0 - correlation**2)
        after += correlation * before
    own = 3.0 * own + settles * rng.choice([-1.0, 1.0], 6) * np.exp(-np.arange(len(own)) / 6.0)[:, None]
    gyro = seen.rests.gyro + np.sqrt(np.median(seen.rests.gyro_covariance[:, 0, 0])) * own
    return replace(seen, rests=replace(seen.rests, gyro=gyro))


def gyros_of(found: Estimate) -> Neighbours:
    assert found.linearised is not None
    alone = next(each_session(found.linearised))
    return list(neighbours(alone, Projection(alone, alone.scatter)))[-1]


def joining(of: Neighbours) -> Array:
    """J, in full."""
    J = np.zeros_like(of.covariance)
    J[of.before, of.after] = J[of.after, of.before] = 1.0
    return J


def test_an_instability_that_lasts_is_said_and_u_contains_it() -> None:
    seen = unstable(101, 0.6)
    found = joint(seen)
    of, said = gyros_of(found), verdict(found, seen)
    assert 0.2 < of.alone <= 0.5
    assert said.verdict == "accepted with scatter"
    assert any(remark.startswith("biases of the gyros are alike in neighbouring rests") for remark in said.remarks)
    assert found.linearised is not None
    biases = [i for i, name in enumerate(found.names) if name.startswith("gyro.bias.") and name.count(".") == 2]
    without = np.diag(found.covariance - common_to_neighbours(found.linearised))[biases]
    assert np.all(found.u[biases] > 1.15 * np.sqrt(without))
    assert np.linalg.eigvalsh(found.covariance / np.outer(found.u, found.u)).min() > -1e-9


def test_the_score_is_that_of_the_whole_matrix() -> None:
    of = gyros_of(joint(unstable(101, 0.6)))
    J, y, M = joining(of), of.along, of.covariance
    score, information = 0.5 * (y @ J @ y - np.trace(J @ M)), 0.5 * np.trace(J @ M @ J @ M)
    assert of.alone == pytest.approx(min(score / information, 0.5), rel=1e-9)
    columns = np.random.default_rng(1).standard_normal((len(y), 3))
    assert of.joined(columns) == pytest.approx(columns.T @ J @ columns)


def test_biases_that_are_independent_are_not_alike() -> None:
    for seed in range(3):
        found = joint(unstable(seed, 0.0))
        assert gyros_of(found).alone == 0.0
        assert found.linearised is not None
        assert not common_to_neighbours(found.linearised).any()


def test_biases_that_settle_are_refused_all_the_same() -> None:
    seen = unstable(101, 0.0, settles=20.0)
    found = joint(seen)
    assert gyros_of(found).alone > 0.0
    assert not verdict(found, seen).gyro.accepted
    judged = misfit(found, seen)
    assert judged is not None
    assert any("settle" in reason for _, reason in judged.reasons)
