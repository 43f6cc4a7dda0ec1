"""One trial of a campaign: a device is drawn, put through a programme, and calibrated by every method.

The random numbers of trial i come from the i-th child of the seed (numpy.random.SeedSequence), so that its rows depend
on the seed and i alone. All methods of a trial see the same observations.

Rests and turns are drawn directly from the truth (`simulate_observations`), with the true noise covariances. What the
detection of rests and the estimation of the noise may spoil shows where sampled logs are calibrated: `tumble simulate`
and `tumble fleet`.

A trial has the maximum of the likelihood alone, and a verdict by what is determined, by convergence, and by the rests
and turns that do not fit. Simulated devices have no faults: a search for causes behind their residuals would find false
alarms only, in less than one of a hundred trials.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tumble.campaigns.engine import Row
from tumble.diagnosis.verdict import verdict
from tumble.errors import InputError
from tumble.inference.estimate import Estimate
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.joint import joint
from tumble.inference.linearisation import linearise
from tumble.inference.problem import Point, Problem
from tumble.planning.bounds import bound_by, components_of
from tumble.planning.setup import Setup
from tumble.reduction.observations import Observations
from tumble.run.calibrate import ITERATED_METHODS, METHODS, Method
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import Scenario, itinerary, scenario_of
from tumble.units import Array

Cell = Mapping[str, Any]
"""A point of a campaign's grid: the arguments of `Setup.of` by axis."""
ITERATIONS = 2
"""Of the methods of the paper."""


def random_numbers(seed: int, number: int) -> np.random.Generator:
    """The random numbers of a trial."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))


def session_rows(seed: int, methods: Sequence[Method], intervals: bool, number: int, cell: Cell) -> list[Row]:
    """Simulate trial `number` of a campaign at a point of its grid, and calibrate it by every method.

    With `intervals` joint, and what other methods take from it, is integrated over its hyperparameters, as
    `tumble.calibrate` does; else u is that at the maximum of the likelihood. Returns a row for each method: whether it
    was accepted, the reasons if not, and for every parameter p `error.p`, its value less the truth, `u.p`, and
    `bound.p`, the square root of the Cramér–Rao bound of the observations, SI."""
    rng = random_numbers(seed, number)
    scenario = scenario_of(Setup.of(**cell), rng)
    course = itinerary(scenario, random_numbers(seed, number).spawn(1)[0])
    observations = simulate_observations(scenario, rng, course=course)
    bounds = {f"bound.{name}": u for name, u in bound(scenario, course.attitudes, observations).items()}
    rows: list[Row] = []
    for method in methods:
        try:
            estimate = _estimate(observations, method, intervals)
        except (InputError, np.linalg.LinAlgError) as error:
            rows.append({"method": method, "error": f"{type(error).__name__}: {error}"} | bounds)
            continue
        reasons = verdict(replace(estimate, linearised=None), observations).reasons
        row: dict[str, Any] = {"method": method, "accepted": not reasons, "reasons": "; ".join(reasons)} | bounds
        linear = len(estimate.names) if estimate.instrument is None else estimate.instrument.linear_count
        for i, name in enumerate(estimate.names):
            if name in scenario.truth and (estimate.observable[i] or i >= linear):  # beyond: by their priors
                row[f"error.{name}"] = float(estimate.values[i]) - scenario.truth[name]
                row[f"u.{name}"] = float(estimate.u[i])
        rows.append(row)
    return rows


def _estimate(observations: Observations, method: Method, intervals: bool) -> Estimate:
    """The estimate of a method."""
    if method == "joint":
        return joint(observations, quick=not intervals)
    if method in METHODS:
        return METHODS[method](observations, intervals=intervals)
    return ITERATED_METHODS[method](observations, ITERATIONS, intervals=intervals)


def bound(scenario: Scenario, attitudes: Array, observations: Observations) -> dict[str, float]:
    """Square roots of the Cramér–Rao bounds of the parameters that observations determine, by name, SI.

    They are those of the joint likelihood at the true parameters and `attitudes` (N, 3, 3), with the true in-run
    instability as a bias that lasts from a rest through the turn after it, and the sizes of further groups as priors.
    """
    instrument, truth = scenario.instrument, scenario.values
    problem = Problem.of(observations, instrument=instrument, usual=observations.usual)
    about = IntegratedTurns.of(observations, instrument, truth)
    point = Point(values=truth, gravity=scenario.setup.gravity, attitudes=attitudes)
    seen = linearise(problem, point, about, components_of(scenario.setup.noise))
    least = bound_by(seen, scenario.setup.turn_rate)
    return {name: float(u) for name, u in zip(least.names, least.u, strict=True) if np.isfinite(u)}
