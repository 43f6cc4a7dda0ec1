"""How often U covers the truth, and how often a device that is exactly at its limit passes.

Each trial draws a device (MEMS grade, positions by hand), simulates its sessions and calibrates them by the joint
method with the linear model. Rests scatter by a bias that is drawn anew at every rest, `scatter` times the usual one of
the grade. In several launches biases change from power-on to power-on by much more than a session's noise, the other
parameters do not; the error of gravity is common to them. All 21 parameters are judged, each against an upper limit
that lies exactly at its true value: the guard band promises that at most 2.275 % pass.

    python studies/coverage_of_limits.py [--short] [--store]
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from math import inf, sqrt

import numpy as np
from stored import shown, store

from tumble.inference.joint import joint
from tumble.lab.conformity import judge_value
from tumble.planning.setup import Setup
from tumble.result.coverage import expanded, gravity_sensitivity, u_and_degrees_of_mean
from tumble.result.parts import Parameter
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import Scenario, scenario_of
from tumble.units import Array

RUN_TO_RUN = {"accel": 0.02, "gyro": 2e-3}
"""Change of biases from power-on to power-on, m/s² and rad/s."""
GRAVITY_U = 1e-3
"""m/s²: about what the session itself knows of a scale factor."""

CORRELATED = 4.0
"""Values of one device are not independent: so many count as one."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Case:
    """Numbers of launches and rests, and the ratio of the scatter to the usual one."""

    launches: int
    rests: int
    scatter: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Outcome:
    """Parts of all judged values: within U of the truth, and passed at a limit that is the truth."""

    covered: float
    passed: float
    values: int


CASES = (
    *(Case(launches=n, rests=18, scatter=3.0) for n in (1, 2, 3, 5)),
    *(Case(launches=1, rests=n, scatter=10.0) for n in (9, 12, 18, 26)),
)


@dataclass(frozen=True, kw_only=True, slots=True)
class Launched:
    """The launches of a device: for each parameter of the first the values, what each launch knows of itself, its
    degrees of freedom, and what is common to all."""

    truth: dict[str, float]
    runs: list[tuple[list[Parameter], Array]]


def run(case: Case, trials: int, *, seed: int = 0) -> Outcome:
    """The outcome of a case over so many devices."""
    devices = _devices(case.launches, case.rests, case.scatter, trials, seed)
    covered, passed = [], []
    for device in devices:
        for parameter in _mean(device):
            U, truth = expanded(parameter) or inf, device.truth[parameter.name]
            covered.append(abs(parameter.value - truth) <= U)
            at_limit = judge_value(parameter.value, parameter.u, -inf, truth, parameter.dof)
            passed.append(at_limit == "pass")
    return Outcome(covered=float(np.mean(covered)), passed=float(np.mean(passed)), values=len(covered))


def _devices(launches: int, rests: int, scatter: float, trials: int, seed: int) -> list[Launched]:
    """So many devices."""
    setup = Setup.of(grade="mems", positions=rests, gravity_u=GRAVITY_U)
    noise = replace(
        setup.noise,
        accel_instability=scatter * setup.noise.accel_instability,
        gyro_instability=scatter * setup.noise.gyro_instability,
    )
    setup = replace(setup, noise=noise)
    return [_launched(setup, launches, np.random.default_rng([seed, launches, rests, t])) for t in range(trials)]


def _launched(setup: Setup, launches: int, rng: np.random.Generator) -> Launched:
    """A device and its launches."""
    scenario = scenario_of(setup, rng)
    off = scenario.site.gravity_u * rng.standard_normal()
    runs = [_session(scenario, off, launches, rng) for _ in range(launches)]
    return Launched(truth=dict(scenario.truth), runs=runs)


def _mean(device: Launched) -> list[Parameter]:
    """The parameters of the mean of launches."""
    runs = device.runs
    if len(runs) == 1:
        return runs[0][0]
    out = []
    for i, first in enumerate(runs[0][0]):
        common = float(np.mean([change[i] for _, change in runs]))
        own = [(max((run[i].u or 0.0) ** 2 - common**2, 0.0), run[i].dof) for run, _ in runs]
        values = np.array([run[i].value for run, _ in runs])
        u, dof = u_and_degrees_of_mean(own, float(values.std(ddof=1)), common)
        out.append(replace(first, value=float(values.mean()), u=u, dof=dof))
    return out


def _session(scenario: Scenario, off: float, launches: int, rng: np.random.Generator) -> tuple[list[Parameter], Array]:
    """The parameters of a launch where gravity was measured with the error `off`, and what u(g) changes in them."""
    changed = dict(scenario.truth)
    if launches > 1:
        for name in changed:
            kind, what, _ = name.split(".")
            changed[name] += RUN_TO_RUN[kind] * rng.standard_normal() if what == "bias" else 0.0
    launch = replace(scenario.changed(gravity_u=0.0), truth=changed)
    made = simulate_observations(launch, rng)
    site = replace(scenario.site, gravity=scenario.site.gravity + off)
    found = joint(replace(made, usual={}, site=site))
    assert found.degrees is not None
    parameters = [
        Parameter(name=name, value=float(value), u=float(u), unit=unit, dof=None if dof > 1e5 else float(dof))
        for name, value, u, unit, dof in zip(
            found.names, found.values, found.u, found.units, found.degrees, strict=True
        )
    ]
    return parameters, gravity_sensitivity(parameters, found.covariance, site)


def main(trials: int) -> int:
    """Print a line for each case, and the answer; 1 where the limits do not protect."""
    rows = [["launches", "rests", "scatter", "covered, %", "passed at the limit, %"]]
    protected = True
    for case in CASES:
        found = run(case, trials)
        shares = [f"{100.0 * share:.1f}" for share in (found.covered, found.passed)]
        rows.append([f"{case.launches}", f"{case.rests}", f"{case.scatter:.0f}", *shares])
        chance = 5.0 * sqrt(0.025 / found.values * CORRELATED)
        protected = protected and found.passed < 0.025 + chance
    print(shown(rows))
    if "--store" in sys.argv and trials >= 100:
        store("coverage_of_limits", {"limits": rows}, seed=1, N=trials)
    print(f"Does a device at its limit pass in 2.5 % at most? {'Yes, within chance' if protected else 'No'}")
    return 0 if protected else 1


if __name__ == "__main__":
    sys.exit(main(4 if "--short" in sys.argv else 100))
