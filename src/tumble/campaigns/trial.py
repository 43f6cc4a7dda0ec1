"""One trial of a campaign: a device is drawn, put through a programme, and calibrated by every method.

The random numbers of trial i come from the i-th child of the seed (numpy.random.SeedSequence), so its rows depend only
on the seed and i. All methods of a trial use the same observations.

Rests and turns are drawn directly from the truth (`simulate_observations`), with the true noise covariances. Errors of
the detection of rests and of the estimation of noise appear only with sampled logs: `tumble simulate`, `tumble fleet`.

A trial computes only the maximum of the likelihood, and a verdict by observability, convergence and the fit of rests
and turns. Simulated devices have no faults: a search for causes would only find false alarms, in less than 1 % of the
trials.
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
"""A point of the grid of a campaign: arguments of `Setup.of`, None for its defaults."""
ITERATIONS = 2  # of the methods of the paper


def setup_of(cell: Cell) -> Setup:
    """Return the set-up at a point of the grid."""
    return Setup.of(**{name: value for name, value in cell.items() if value is not None})


def random_numbers(seed: int, number: int) -> np.random.Generator:
    """Return the random number generator of a trial."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))


def session_rows(seed: int, methods: Sequence[Method], intervals: bool, number: int, cell: Cell) -> list[Row]:
    """Simulate trial `number` of a campaign at a point of its grid, and calibrate it by every method.

    With `intervals` u is integrated over the hyperparameters, as by `tumble.calibrate`; else it is u at the maximum of
    the likelihood. Returns a row for each method: whether it was accepted, the reasons if not, and for every parameter
    p `error.p`, its value minus the truth, `u.p`, and `bound.p`, the root of the Cramér–Rao bound of the observations,
    SI."""
    rng = random_numbers(seed, number)
    scenario = scenario_of(setup_of(cell), rng)
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
            if name in scenario.truth and (estimate.observable[i] or i >= linear):  # further groups have priors
                row[f"error.{name}"] = float(estimate.values[i]) - scenario.truth[name]
                row[f"u.{name}"] = float(estimate.u[i])
        rows.append(row)
    return rows


def _estimate(observations: Observations, method: Method, intervals: bool) -> Estimate:
    if method == "joint":
        return joint(observations, quick=not intervals)
    if method in METHODS:
        return METHODS[method](observations, intervals=intervals)
    return ITERATED_METHODS[method](observations, ITERATIONS, intervals=intervals)


def bound(scenario: Scenario, attitudes: Array, observations: Observations) -> dict[str, float]:
    """Return the roots of the Cramér–Rao bounds of the observable parameters by name, SI.

    They are those of the joint likelihood at the true parameters and `attitudes` (N, 3, 3). In-run instability is a
    bias that is constant from a rest through the turn after it; further groups of parameters have priors of their
    sizes."""
    instrument, truth = scenario.instrument, scenario.values
    problem = Problem.of(observations, instrument=instrument, usual=observations.usual)
    about = IntegratedTurns.of(observations, instrument, truth)
    point = Point(values=truth, gravity=scenario.setup.gravity, attitudes=attitudes)
    linearisation = linearise(problem, point, about, components_of(scenario.setup.noise))
    bounds = bound_by(linearisation, scenario.setup.turn_rate)
    return {name: float(u) for name, u in zip(bounds.names, bounds.u, strict=True) if np.isfinite(u)}
