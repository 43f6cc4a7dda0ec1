"""Is the posterior of the joint method what a sampler finds? Its means are; its u is within 2 %, root mean square over
the parameters of ten sessions, 8 % the largest, which is what 64 points can do: with 512 it is 1 %.

The joint method integrates over what the model does not know about itself, φ, by 64 points of a fixed sequence
(`tumble.inference.integral`). Here φ is sampled instead (Metropolis): the elements without a bound by a random walk,
all at once, with the steps of Haario's adaptation while it burns in, and after that each size by draws from its prior.
At every draw gravity and the parameters have their exact conditional mean and covariance, so that of them nothing is
left to chance. Sizes of which a session shows nothing stay those of the sheet, as they do in the integral: to take the
whole of their prior instead would make u up to 1.4 times as large.

Compared are, of every parameter of the linear model, biases being the means over the session, the means, in units of u,
and u. Sessions of five kinds, two of each: by hand, on a rough table, accelerometers alone with groups three times as
large as usual, biases that wander, and recorded ones, where the recordings are at hand.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tumble.inference.estimate import Outcome
from tumble.inference.hyperparameters import quadratic_forms, solution_at
from tumble.inference.integral import INFORMATIVE_GROUP, posterior
from tumble.inference.maximum import Maximum, maximise
from tumble.inference.normal_equations import Solution
from tumble.inference.problem import NO_PRIOR, Problem, instruments_of
from tumble.inference.start import initial_linearisation
from tumble.planning.setup import Setup
from tumble.reduction.observations import Observations
from tumble.run.observed import inspect_session, observations_for_calibration
from tumble.sensors.parameters import usual_sizes
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import draw_further, scenario_of
from tumble.units import Array

DATA = Path(__file__).parents[2] / "shared" / "data"
RECORDED = ("xsens-mti", "truth-handheld")


@dataclass(frozen=True, kw_only=True, slots=True)
class Compared:
    """The largest difference of means, in u, and of u, in parts of it, of the parameters of the linear model, and its
    root mean square; and the effective number of points of the integral and the accepted part of the draws."""

    means: float
    u: float
    u_rms: float
    effective: float
    accepted: float


def shown(fitted: Maximum) -> list[int]:
    """The elements of φ of which the session shows something, or that are no sizes."""
    out = list[int]()
    for i, h in enumerate(fitted.hyperparameters):
        phi = fitted.phi.copy()
        phi[i] += fitted.information[i, i] ** -0.5
        at_bound = h.bounded and fitted.phi[i] <= 0.0
        _, trace = quadratic_forms(fitted.hyperparameters, evaluated(fitted, phi))
        if not at_bound or 2.0 * trace[i] > INFORMATIVE_GROUP:
            out.append(i)
    return out


def evaluated(fitted: Maximum, phi: Array) -> Solution:
    """ℓ at φ."""
    return solution_at(fitted.linearisation, fitted.hyperparameters, phi)


def sampled(fitted: Maximum, draws: int, seed: int) -> tuple[Array, Array, float]:
    """Mean and covariance of gravity and the parameters by so many draws after a quarter as many that burn in, and the
    accepted part of the steps of the random walk."""
    rng, entries, burn = np.random.default_rng(seed), fitted.hyperparameters, draws // 4
    every = shown(fitted)
    walking, sizes = ([i for i in every if entries[i].bounded is bounded] for bounded in (False, True))
    phi, D = fitted.phi.copy(), len(walking)
    steps = np.linalg.inv(fitted.information[np.ix_(walking, walking)])
    value, path, accepted = evaluated(fitted, phi).log_posterior, list[Array](), 0
    means, within = list[Array](), np.zeros((1 + len(fitted.point.values),) * 2)
    for i in range(-burn, draws):
        if i < 0 and i % 50 == 0 and len(path) > 10 * D:
            steps = np.cov(np.array(path[len(path) // 3 :]).T) + 1e-6 * np.eye(D)
        tried = phi.copy()
        tried[walking] += np.linalg.cholesky(steps) @ rng.standard_normal(D) * 2.38 / np.sqrt(D)
        there = evaluated(fitted, tried).log_posterior
        if np.log(rng.uniform()) < there - value:
            phi, value = tried, there
            accepted += i >= 0
        for size in sizes:  # from the prior, so that of ℓ the likelihood alone counts
            tried = phi.copy()
            tried[size] = rng.normal(0.0, entries[size].within)
            there = evaluated(fitted, tried).log_posterior
            if (
                np.log(rng.uniform())
                < there - entries.log_prior(tried)[0, size] - value + entries.log_prior(phi)[0, size]
            ):
                phi, value = tried, there
        path.append(phi[walking])
        if i >= 0:
            here = evaluated(fitted, phi)
            means.append(here.session_step)
            within += here.session_covariance / draws
    return np.mean(means, axis=0), within + np.cov(np.array(means).T), accepted / draws


def compared(fitted: Maximum, *, draws: int, seed: int) -> Compared:
    """The integral about a maximum and a sampler."""
    integral = posterior(fitted)
    mean, covariance, accepted = sampled(fitted, draws, seed)
    linear = slice(1, 1 + fitted.problem.instrument.linear_count)
    u, other = (np.sqrt(np.diag(each))[linear] for each in (covariance, integral.covariance))
    return Compared(
        means=float(np.abs((integral.step - mean)[linear] / u).max()),
        u=float(np.abs(other / u - 1.0).max()),
        u_rms=float(np.sqrt(np.mean((other / u - 1.0) ** 2))),
        effective=integral.integral.effective,
        accepted=accepted,
    )


def fitted_of(session: Observations) -> Maximum:
    """The maximum of a session."""
    instrument, local = instruments_of(session)
    problem = Problem.of(session, NO_PRIOR, instrument=instrument, local=local, usual=session.usual)
    return maximise(initial_linearisation(problem))


def sessions(kind: str, seed: int) -> Observations:
    """A simulated session of a kind."""
    rng = np.random.default_rng([31, seed])
    setup = Setup.of(grade="mems", positions=12, rest=5.0)
    if kind == "rough table":
        setup = Setup.of(grade="tactical", programme="rough-table")
    scenario = scenario_of(setup, rng)
    usual = usual_sizes("tactical" if kind == "rough table" else "mems")
    if kind == "wandering":
        noise = replace(setup.noise, accel_instability=3e-3, gyro_instability=3e-4)
        scenario = scenario_of(replace(setup, noise=noise), rng)
    if kind == "accelerometers":
        few = {name: usual[name] for name in ("accel.quadratic", "accel.cubic", "accel.asymmetry")}
        more = draw_further({name: 3.0 * size for name, size in few.items()}, scenario.accel, scenario.gyro, rng)
        session = simulate_observations(replace(scenario, truth=dict(scenario.truth) | more), rng)
        N = len(session.rests)
        rests = replace(session.rests, gyro=np.empty((N, 0)), gyro_covariance=np.empty((N, 0, 0)))
        return replace(session, gyro_block=None, turns=None, turn_samples=None, rests=rests, usual=few)
    return replace(simulate_observations(scenario, rng), usual=usual if seed else {})


def every(count: int) -> Iterator[tuple[str, Observations]]:
    """So many sessions of each kind, and the recorded ones that are at hand."""
    for kind in ("accelerometers", "by hand", "rough table", "wandering"):
        for seed in range(count):
            yield kind, sessions(kind, seed)
    for name in RECORDED[:count] if DATA.is_dir() and count > 1 else ():
        observations = observations_for_calibration(inspect_session(DATA / name))
        if not isinstance(observations, Outcome):
            yield name, observations


def main() -> int:
    short = "--short" in sys.argv
    worst, squares = [0.0, 0.0], list[float]()
    print("session            means, u   u, parts   its rms   points   accepted")
    for name, session in list(every(2))[:1] if short else every(2):
        found = compared(fitted_of(session), draws=1500 if short else 3000, seed=1)
        line = f"{found.means:8.3f} {found.u:10.3f} {found.u_rms:9.3f} {found.effective:8.0f} {found.accepted:10.2f}"
        print(f"{name:18s} {line}", flush=True)
        worst = [max(worst[0], found.means), max(worst[1], found.u)]
        squares.append(found.u_rms**2)
    agrees = "Yes" if worst[0] < 0.1 and worst[1] < 0.05 else "No"
    by = f"means within {worst[0]:.2f} u, u within {100 * worst[1]:.0f} %, {100 * np.mean(squares) ** 0.5:.0f} % rms"
    print(f"Is the posterior what a sampler finds? {agrees}: {by}")
    return 0 if agrees == "Yes" else 1


if __name__ == "__main__":
    sys.exit(main())
