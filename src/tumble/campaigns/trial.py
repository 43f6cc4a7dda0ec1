"""One trial of a campaign: a device is drawn, put through a programme, and calibrated by every method.

The random numbers of trial i come from the i-th child of the seed (numpy.random.SeedSequence), so that its rows depend
on the seed and i alone. All methods of a trial see the same observations.

Source "observations": rests and turns are drawn directly from the truth (`simulate_observations`), with the true noise
covariances. Source "log": a sampled log goes through the whole chain, detection of rests and estimation of the noise
included, about a hundred times as slowly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, Literal

import numpy as np

from tumble.campaigns.engine import Row
from tumble.diagnosis.verdict import verdict
from tumble.errors import InputError
from tumble.inference.joint import joint
from tumble.inference.likelihood import Point, Problem
from tumble.inference.linearisation import linearised
from tumble.inference.turns_about import TurnsAbout
from tumble.planning.bounds import bound_by, components_of
from tumble.planning.setup import Setup
from tumble.recording.session import Session
from tumble.reduction.observations import Observations
from tumble.run.calibrate import ITERATED_METHODS, METHODS, Method, calibrate
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import Scenario, itinerary, scenario_of
from tumble.simulation.session import session_in_memory
from tumble.units import Array

Source = Literal["observations", "log"]
Cell = Mapping[str, Any]
"""A point of a campaign's grid: the arguments of `Setup.of` by axis."""
Values = Mapping[str, tuple[float, float | None]]
"""Value and standard uncertainty by parameter, SI."""
ITERATIONS = 2
"""Of the methods of the paper."""


def random_numbers(seed: int, number: int) -> np.random.Generator:
    """The random numbers of a trial."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(number,)))


def session_rows(
    seed: int, source: Source, methods: Sequence[Method], intervals: bool, number: int, cell: Cell
) -> list[Row]:
    """Simulate one trial and calibrate it by every method.

    Parameters
    ----------
    seed, number
        Seed of the campaign and number of the trial.
    source
        Where the observations come from.
    methods
        Methods of calibration.
    intervals
        Whether the joint method integrates over its hyperparameters for u; else u is that at the maximum.
    cell
        Point of the grid.

    Returns
    -------
    list of Row
        One row a method: whether it was accepted, the reasons if not, and for every parameter p `error.p`, its value
        less the truth, `u.p`, and, of observations, `bound.p`, the square root of the Cramér–Rao bound, SI.
    """
    rng = random_numbers(seed, number)
    scenario = scenario_of(Setup.of(**cell), rng)
    bounds: dict[str, float] = {}
    if source == "log":
        calibrated = partial(_from_log, session_in_memory(scenario, rng))
    else:
        course = itinerary(scenario, random_numbers(seed, number).spawn(1)[0])  # that of simulate_observations
        observations = simulate_observations(scenario, rng)
        calibrated = partial(_from_observations, observations, intervals)
        bounds = {f"bound.{name}": u for name, u in bound(scenario, course.attitudes, observations).items()}
    rows: list[Row] = []
    for method in methods:
        try:
            reasons, values = calibrated(method)
        except (InputError, np.linalg.LinAlgError) as error:
            rows.append({"method": method, "error": f"{type(error).__name__}: {error}"} | bounds)
            continue
        row: dict[str, Any] = {"method": method, "accepted": not reasons, "reasons": "; ".join(reasons)} | bounds
        for name in values.keys() & scenario.truth.keys():
            value, u = values[name]
            row |= {f"error.{name}": value - scenario.truth[name], f"u.{name}": u}
        rows.append(row)
    return rows


def _from_observations(observations: Observations, intervals: bool, method: Method) -> tuple[Sequence[str], Values]:
    """Reasons against the estimate of a method, and its values; those beyond the linear model in any case."""
    if method == "joint":
        estimate = joint(observations, intervals=intervals)
    elif method in METHODS:
        estimate = METHODS[method](observations)
    else:
        estimate = ITERATED_METHODS[method](observations, ITERATIONS)
    linear = len(estimate.names) if estimate.instrument is None else estimate.instrument.linear_count
    return verdict(estimate, observations).reasons, {
        name: (float(estimate.values[i]), float(estimate.u[i]))
        for i, name in enumerate(estimate.names)
        if estimate.observable[i] or i >= linear
    }


def _from_log(session: Session, method: Method) -> tuple[Sequence[str], Values]:
    """The same of a log, through the whole chain."""
    calibration = calibrate(session, method=method)
    return calibration.outcome.reasons, {p.name: (p.value, p.u) for p in calibration.parameters}


def bound(scenario: Scenario, attitudes: Array, observations: Observations) -> dict[str, float]:
    """Square roots of the Cramér–Rao bounds of the parameters that observations determine.

    Parameters
    ----------
    scenario
        The true instrument and site.
    attitudes : (N, 3, 3)
        True attitudes of the rests.
    observations
        What was simulated of it.

    Returns
    -------
    dict
        By parameter, SI. They are those of the joint likelihood at the truth, with the true in-run instability as a
        bias that lasts from a rest through the turn after it, and the sizes of further groups as priors.
    """
    instrument, truth = scenario.instrument, scenario.values
    problem = Problem.of(observations, instrument=instrument, usual=observations.usual)
    about = TurnsAbout.of(observations, instrument, truth)
    point = Point(values=truth, gravity=scenario.setup.gravity, attitudes=attitudes)
    seen = linearised(problem, point, about, components_of(scenario.setup.noise))
    least = bound_by(seen, scenario.setup.turn_rate)
    return {name: float(u) for name, u in zip(least.names, least.u, strict=True) if np.isfinite(u)}
