"""How often a field check calls a good calibration changed, and how often it finds a change.

Each trial draws a device of MEMS grade with all groups of parameters, calibrates it by hand (18 rests, the joint
method, full model), turns it on again, by which its parameters change as is usual of the grade, and checks it with
three, four and five rests in any attitude, with and without the turns between them. Then one parameter of one axis,
drawn, has changed: 0.5 % of scale, 5 mg, 0.2 °/s.

    python studies/field_check.py [--short] [--store]
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from stored import shown, store

from tumble.inference.estimate import Estimate, Outcome
from tumble.inference.joint import joint
from tumble.methods.field_check import CheckResult, field_check
from tumble.planning.setup import Setup
from tumble.result.calibration import Calibration
from tumble.result.parts import CalibratedDevice, Evidence, Parameter
from tumble.sensors.grades import TURN_ON, spread_of
from tumble.simulation.observations import simulate_observations
from tumble.simulation.scenario import Scenario, scenario_of
from tumble.units import DEGREE, G_STANDARD
from tumble.use.check import prior_at_check

GRADE = "mems"
CHANGES = {
    "accel.bias": 5e-3 * G_STANDARD,
    "accel.scale": 5e-3,
    "gyro.bias": 0.2 * DEGREE,
    "gyro.scale": 5e-3,
}
"""SI, of one axis."""
NOTHING = "nothing"
CALIBRATED_WITH = 18
SIGMAS = 4.0
"""By how much a share may miss its claim."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Case:
    """A check of so many rests; without their turns the gyros' scale factors are not seen."""

    rests: int
    turns: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class Share:
    """Of so many checks: found changed, and the right parameter named first or beside it."""

    checks: int
    found: int
    named: int

    @property
    def part(self) -> float:
        """Found, of all."""
        return self.found / self.checks


CASES = tuple(Case(rests=rests, turns=turns) for turns in (True, False) for rests in (3, 4, 5))


def device(rng: np.random.Generator) -> tuple[Scenario, Calibration]:
    """A device and its calibration."""
    scenario = scenario_of(Setup.of(grade=GRADE, positions=CALIBRATED_WITH, terms="full"), rng)
    return scenario, calibration_of(joint(simulate_observations(scenario, rng)), scenario)


def calibration_of(estimate: Estimate, scenario: Scenario) -> Calibration:
    """What a check needs of a calibration."""
    seen = np.flatnonzero(estimate.observable)
    degrees = estimate.degrees
    assert degrees is not None
    return Calibration(
        device=CalibratedDevice(serial=scenario.serial),
        method=estimate.method,
        frame="accelerometer",
        parameters=tuple(
            Parameter(
                name=estimate.names[i],
                value=float(estimate.values[i]),
                u=float(estimate.u[i]),
                unit=estimate.units[i],
                dof=float(degrees[i]),
            )
            for i in seen
        ),
        covariance=estimate.covariance[np.ix_(seen, seen)],
        accel=estimate.accel,
        gyro=estimate.gyro,
        outcome=Outcome(),
        evidence=Evidence(fits=estimate.fits),
    )


def turned_on_again(scenario: Scenario, rng: np.random.Generator) -> dict[str, float]:
    """The true values after the next power-on: those of the calibration are of one that was as far from the mean."""
    linear = scenario.names[: scenario.instrument.linear_count]
    change = np.sqrt(2.0) * rng.standard_normal(len(linear))
    return dict(scenario.truth) | {
        name: scenario.truth[name] + spread_of(TURN_ON[GRADE], name) * by
        for name, by in zip(linear, change.tolist(), strict=True)
    }


def checked(
    scenario: Scenario, calibration: Calibration, case: Case, truth: dict[str, float], rng: np.random.Generator
) -> CheckResult:
    """The result of a check of a device with these true values."""
    again = replace(scenario.changed(by_hand=case.rests), truth=truth)
    observations = simulate_observations(again, rng, only_programmed=not case.turns)
    return field_check(observations, prior_at_check(calibration, observations, GRADE, {}))


def trials(
    count: int, groups: tuple[str, ...], cases: tuple[Case, ...] = CASES, *, seed: int = 0
) -> Iterator[tuple[Case, str, bool, bool]]:
    """Of every check: the case, which of the groups has changed (NOTHING: none), whether a change was found and
    named."""
    for trial in range(count):
        rng = np.random.default_rng([seed, trial])
        scenario, calibration = device(rng)
        for case in cases:
            for group in groups:
                if group == "gyro.scale" and not case.turns:
                    continue
                truth = turned_on_again(scenario, rng)
                name = f"{group}.{rng.choice(list('xyz'))}"
                if group != NOTHING:
                    truth[name] += CHANGES[group] * rng.choice([-1.0, 1.0])
                found = checked(scenario, calibration, case, truth, rng)
                named = any(name in (change.name, *change.others) for change in found.changes)
                yield case, group, not found.valid, named


def shares(
    count: int, groups: tuple[str, ...], cases: tuple[Case, ...] = CASES, *, seed: int = 0
) -> dict[tuple[Case, str], Share]:
    """The shares of all cases and changes."""
    out: dict[tuple[Case, str], Share] = {}
    for case, group, found, named in trials(count, groups, cases, seed=seed):
        before = out.get((case, group), Share(checks=0, found=0, named=0))
        out[case, group] = Share(
            checks=before.checks + 1, found=before.found + found, named=before.named + (found and named)
        )
    return out


def main() -> int:
    """Print the shares, and whether they are what the check promises."""
    unchanged, changed = (6, 2) if "--short" in sys.argv else (150, 30)
    found = shares(unchanged, (NOTHING,), seed=1) | shares(changed, tuple(CHANGES), seed=2)
    groups = (NOTHING, *CHANGES)
    rows = [["rests", "turns", "false alarms", "5 mg", "0.5 % accelerometer", "0.2 °/s", "0.5 % gyro", "rightly named"]]
    for case in CASES:
        cells = [
            f"{found[case, g].found} of {found[case, g].checks}" if (case, g) in found else "not seen" for g in groups
        ]
        right = [found[case, g] for g in CHANGES if (case, g) in found]
        named = f"{sum(share.named for share in right)} of {sum(share.found for share in right)}"
        rows.append([f"{case.rests}", "yes" if case.turns else "no", *cells, named])
    print(shown(rows))
    alarms = [share for (_, group), share in found.items() if group == NOTHING]
    total, checks = sum(s.found for s in alarms), sum(s.checks for s in alarms)
    allowed = 0.01 * checks + SIGMAS * np.sqrt(0.01 * checks)
    weakest = min(s.part for (case, group), s in found.items() if group != NOTHING and case.turns)
    holds = total <= allowed and weakest >= 0.9 - SIGMAS * np.sqrt(0.09 / changed)
    print(f"false alarms {total} of {checks}; with the turns, the change found least often: {100.0 * weakest:.0f} %")
    if "--store" in sys.argv and "--short" not in sys.argv:
        store("field_check", {"checks": rows}, {"alarms": f"{total}", "checks": f"{checks}"}, seed="1, 2", N="150, 30")
    answer = "Yes" if holds else "No"
    print(f"Does a check find these changes in 90 %, and in 1 % one that is none? {answer}")
    return 0 if holds else 1


if __name__ == "__main__":
    sys.exit(main())
