"""Does the joint estimate reach the Cramér–Rao bound, are its chi-square and its uncertainties right, and how far from
the bound are the other methods?

The set-up of the turntable paper: programme rough-table, rests of 120 s, half turns of 20 s, table and mounting
±1°, N_a = 10⁻⁴ m/s²/√Hz, N_g = 0.003 °/√h; errors of the instrument drawn anew in every run. Observations are made
directly from the truth, so that their noise is known. The bound is that of the same observations at the true values.

Ratio: rms error over runs and over the parameters of a group, over the rms bound. Chi-square: of all residuals against
the noise within rests, before any scatter is estimated. Coverage: how often |value − truth| < 1.96 u, by parameter,
with the u that the method gives, in which scatter and in-run biases are integrated over, although there are none.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from formulas_against_simulation import DEVICE
from stored import shown, store

from tests.support.staged import staged
from tumble.inference.estimate import Estimate
from tumble.inference.fits import TOTAL
from tumble.inference.integrated_turns import IntegratedTurns
from tumble.inference.joint import joint
from tumble.inference.linearisation import linearise
from tumble.inference.normal_equations import solve
from tumble.inference.problem import Point, Problem
from tumble.methods.paper.four_stages import scalar, sequential
from tumble.planning.setup import GROUPS, Setup
from tumble.reduction.observations import Observations
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import Scenario, itinerary, scenario_of
from tumble.units import DEGREE, Array

SETUP = Setup(
    latitude=56.8 * DEGREE,
    gravity=9.815817,
    gravity_u=0.0,
    rest=120.0,
    turn_rate=180.0 / 19.0 * DEGREE,
    noise=DEVICE.noise,
    accel=DEVICE.accel,
    gyro=DEVICE.gyro,
)
NAMES = ("nine programme turns", "all 14 turns")

PUBLISHED = {
    "sequential, pass 1": (8.1, 5.2, 4.8, 2.05, 1.55, 3.1),
    "sequential, pass 2": (1.16, 1.09, 1.36, 1.90, 1.04, 1.15),
    "sequential, pass 3": (1.13, 1.02, 1.35, 1.90, 1.03, 1.14),
    "scalar, pass 1": (1.59, 1.44, 1.51, 2.05, 1.55, 1.57),
    "scalar, pass 2": (1.59, 1.43, 1.51, 1.90, 1.03, 1.21),
    "joint": (1.04, 0.99, 0.97, 0.99, 0.99, 0.98),
}
"""§8, from 300 runs: authors, scalar 9 or. (est) + nominal H, ML."""

METHODS: Mapping[str, Callable[[Observations], Estimate]] = {
    "sequential, pass 1": lambda o: sequential(o, 1),
    "sequential, pass 2": lambda o: sequential(o, 2),
    "sequential, pass 3": lambda o: sequential(o, 3),
    "scalar, pass 1": lambda o: scalar(o, 1),
    "scalar, pass 2": lambda o: scalar(o, 2),
    "staged": staged,
    "joint": joint,
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Run:
    """A simulated session: its observations, the true values (m,) and the bound: a covariance (m, m) that no unbiased
    estimate from these observations can fall below."""

    observations: Observations
    truth: Array
    bound: Array

    @staticmethod
    def of(number: int, only_programmed: bool) -> Run:
        scenario = scenario_of(SETUP, np.random.default_rng([number, 0]))
        observations = simulate_observations(
            scenario, np.random.default_rng([number, 1]), only_programmed=only_programmed
        )
        truth = np.array([scenario.truth[name] for name in scenario.accel.names + scenario.gyro.names])
        return Run(observations=observations, truth=truth, bound=_bound(scenario, observations, truth, number))


def _bound(scenario: Scenario, observations: Observations, truth: Array, number: int) -> Array:
    """The covariance (m, m) of the step from the true values."""
    way = itinerary(scenario, np.random.default_rng([number, 1]).spawn(3)[0])
    point = Point(values=truth, gravity=scenario.site.gravity, attitudes=way.attitudes)
    problem = Problem.of(observations)
    rows = linearise(problem, point, IntegratedTurns.of(observations, problem.instrument, truth))
    step = solve(rows)
    return np.asarray(step.covariance[1:, 1:])


def members(names: tuple[str, ...]) -> list[Array]:
    """Indices of the parameters of each group."""
    return [np.flatnonzero([name.startswith(group) for name in names]) for group in GROUPS]


@dataclass(frozen=True, kw_only=True, slots=True)
class Result:
    """Of many joint estimates: ratio to the bound by group and its standard deviation by chance, mean and standard
    deviation of chi-square, coverage of the 95 % intervals by parameter, and the share of the runs with a scatter."""

    ratios: Array
    chance: Array
    chi_square: tuple[float, float]
    coverage: Array
    scattered: float
    iterations: int


def joint_result(runs: int, only_programmed: bool) -> Result:
    errors, bounds, u, chi_square, scattered, iterations = [], [], [], [], [], []
    for number in range(runs):
        run = Run.of(number, only_programmed)
        found = joint(run.observations)
        errors.append(found.values - run.truth)
        bounds.append(run.bound)
        u.append(found.u)
        chi_square.append(found.fits[TOTAL].chi_square)
        scattered.append(any(fit.scatter > 0.0 for fit in found.fits.values()))
        iterations.append(len(found.increments))
    error, bound = np.array(errors), np.array(bounds)
    groups = members(found.names)
    return Result(
        ratios=np.array([_ratio(error, bound, g) for g in groups]),
        chance=np.array([_chance(bound, g) for g in groups]),
        chi_square=(float(np.mean(chi_square)), float(np.std(chi_square))),
        coverage=np.mean(np.abs(error) < 1.959964 * np.array(u), axis=0),
        scattered=float(np.mean(scattered)),
        iterations=max(iterations),
    )


def _ratio(error: Array, bound: Array, group: Array) -> float:
    """The rms of errors (N, m) over that of bounds (N, m, m), of the parameters of a group."""
    variance = np.diagonal(bound, axis1=1, axis2=2)[:, group]
    return float(np.sqrt((error[:, group] ** 2).mean() / variance.mean()))


def _chance(bound: Array, group: Array) -> float:
    """The standard deviation of that ratio where errors are Gaussian with the bounds as covariances: half of that of
    the sum of their squares, √(2 Σ tr C²) / Σ tr C."""
    C = bound[:, group[:, None], group]
    return float(np.sqrt(2.0 * np.sum(C**2)) / (2.0 * np.trace(C, axis1=1, axis2=2).sum()))


def method_ratios(runs: int) -> dict[str, Array]:
    """Ratio to the bound of every method by group, with the nine programme turns."""
    errors: dict[str, list[Array]] = {name: [] for name in METHODS}
    bounds = []
    for number in range(runs):
        run = Run.of(number, only_programmed=True)
        bounds.append(run.bound)
        for name, method in METHODS.items():
            found = method(run.observations)
            errors[name].append(found.values - run.truth)
    bound = np.array(bounds)
    return {name: np.array([_ratio(np.array(e), bound, g) for g in members(found.names)]) for name, e in errors.items()}


def main(runs: int, few: int, *, kept: bool) -> int:
    """Print the tables and the answer; `kept`: store them."""
    print(f"joint, {runs} runs: rms error over the bound")
    bound_rows, method_rows = [["", *GROUPS]], [["", *GROUPS]]
    results = [joint_result(runs, only_programmed) for only_programmed in (True, False)]
    for name, result in zip(NAMES, results, strict=True):
        bound_rows.append([name, *(f"{ratio:.3f}" for ratio in result.ratios)])
    print(shown(bound_rows))
    for name, result, degrees in zip(NAMES, results, (51, 66), strict=True):
        print(
            f"{name}: chi-square {result.chi_square[0]:.2f} ± {result.chi_square[1]:.1f} for {degrees} degrees of "
            f"freedom; coverage of 95 % intervals {result.coverage.min():.1%} to {result.coverage.max():.1%}, mean "
            f"{result.coverage.mean():.1%}; a scatter in {result.scattered:.0%} of the runs; at most "
            f"{result.iterations} iterations"
        )
    print(f"\nall methods, {few} runs, nine programme turns; published (300 runs) in brackets")
    for name, ratios in method_ratios(few).items():
        published = PUBLISHED.get(name)
        cells = [
            f"{r:.2f}" + (f" ({p:.2f})" if published else "") for r, p in zip(ratios, published or ratios, strict=True)
        ]
        method_rows.append([name, *cells])
    print(shown(method_rows))
    if kept:
        figures = {
            f"{what}, {turns}": text
            for turns, result in zip(NAMES, results, strict=True)
            for what, text in (
                ("chi-square", f"{result.chi_square[0]:.2f}"), ("covered", f"{result.coverage.mean():.1%}"),
                ("least covered", f"{result.coverage.min():.1%}"), ("most covered", f"{result.coverage.max():.1%}"),
                ("iterations", f"{result.iterations}"),
            )
        }  # fmt: skip
        store("joint_bound", {"bound": bound_rows, "methods": method_rows}, figures, seed="from 0", N=f"{runs}, {few}")
    within = all(np.all(np.abs(r.ratios - 1.0) < np.maximum(0.05, 5.0 * r.chance)) for r in results)
    print(f"Does the joint estimate reach the bound? {'yes, in all six groups' if within else 'no'}.")
    return 0 if within else 1


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--short", action="store_true", help="40 and 4 runs")
    parser.add_argument("--runs", type=int, nargs=2, default=(5000, 1000), help="of joint, and of all methods")
    parser.add_argument("--store", action="store_true", help="keep the tables")
    given = parser.parse_args()
    sys.exit(main(*((40, 4) if given.short else given.runs), kept=given.store and not given.short))
